"""The disk behind the cells: what was acknowledged as stored is there after a crash.

Files, in the folder given with ``--state``
-------------------------------------------
- ``lock``: locked while a process uses the folder, so that two twins never write one memory.
- ``mac23-0.state``: all cells of one device, for people to read.  Replaced as a whole: written
  under another name, synchronised, renamed, the folder synchronised, before the write returns.
- ``mac23-0.live``: what changes by itself (the position of an axis that moves), in two places
  written in turn and not synchronised.  The operating system keeps it when this process is killed.

Rules
-----
1. Every write has a sequence number; of several copies of a cell the newest holds.
2. A file that cannot be read as a whole is an error for the user, and stays untouched byte for
   byte.  Of the two places in ``.live`` one may be torn: the other one holds then.
3. A file half written under its other name is what a kill leaves behind; it was never
   acknowledged, and is removed when the device is there again.
4. Nothing of anybody else's is touched: links are not followed, a ``lock`` of other content is
   refused, and only the owner may write what is made here, whatever the umask.
"""

import contextlib
import fcntl
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias, TypeVar

from axistwin.errors import StateError
from axistwin.memory.record import (
    ENTRY_SIZE,
    Record,
    RecordError,
    decode,
    decode_entry,
    encode,
    encode_entry,
)

_TEMPORARY = ".new"
_FILE_MODE, _FOLDER_MODE = 0o644, 0o755
_LOCK_BYTES_MAX = 32
_Result = TypeVar("_Result")


class MemoryStorage:
    """No disk: the cells live as long as the process."""

    is_volatile = True
    """Whether everything is forgotten at the end of the process."""

    def slot(self, name: str, model: str) -> "MemorySlot":
        """A new, empty slot."""
        return MemorySlot()

    def close(self) -> None:
        """Nothing to let go of."""


class MemorySlot:
    """Cells in this process's memory."""

    def __init__(self) -> None:
        self.cells: dict[str, int] = {}

    def save(self, cells: Mapping[str, int], *, durable: bool) -> None:
        """Keep ``cells``."""
        self.cells.update(cells)


class Storage:
    """The folder ``directory``, created when missing and locked against other processes.

    Raises StateError when it cannot be used.
    """

    is_volatile = False

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        if not os.fspath(directory):
            raise StateError("state: needs the name of a folder, such as ./memory")
        self.directory = Path(directory)
        self._slots: dict[str, FileSlot] = {}
        with _clear(self.directory, "cannot be used", "choose another folder"):
            for folder in (*reversed(self.directory.parents), self.directory):
                if not folder.is_dir():
                    folder.mkdir(_FOLDER_MODE, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
            self._lock = os.open(self.directory / "lock", flags, _FILE_MODE)
        self._folder = -1
        try:
            self._claim()
            with _clear(self.directory, "cannot be used", "choose another folder"):
                self._folder = os.open(self.directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        except BaseException:
            self.close()
            raise

    def slot(self, name: str, model: str) -> "FileSlot":
        """The memory kept under ``name``, or ``name-2``, ``name-3`` … when given before.

        Raises StateError when there is one which cannot be read or belongs to something else.
        """
        stem, count = name, 1
        while stem in self._slots:
            count += 1
            stem = f"{name}-{count}"
        slot = FileSlot(self.directory / stem, model, self._folder)
        self._slots[stem] = slot
        return slot

    def close(self) -> None:
        """Close all files and unlock the folder."""
        for slot in self._slots.values():
            slot.close()
        self._slots.clear()
        for fd in (self._folder, self._lock):
            if fd >= 0:
                os.close(fd)
        self._folder = self._lock = -1

    def _claim(self) -> None:
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(self._lock, _LOCK_BYTES_MAX, 0).decode("ascii", "replace").strip()
            raise StateError(
                f"state {self.directory}: in use by another axistwin (process {owner or 'unknown'})"
                "; stop it or choose another folder"
            ) from None
        except OSError as error:  # a file system without locks
            raise StateError(
                f"state {self.directory}: cannot be locked ({error.strerror});"
                " choose a folder on another disk"
            ) from None
        content = os.pread(self._lock, _LOCK_BYTES_MAX + 1, 0)
        if content and not (content.endswith(b"\n") and content[:-1].isdigit()):
            raise StateError(
                f"state {self.directory}: the file 'lock' there is not axistwin's; "
                "choose another folder"
            )
        # A disk without room for a number has none for a memory either: better told now.
        with _clear(self.directory, "cannot be written", "make room, or choose another folder"):
            os.ftruncate(self._lock, 0)
            os.pwrite(self._lock, f"{os.getpid()}\n".encode(), 0)


class FileSlot:
    """The files ``stem``.state and ``stem``.live; see the rules above.

    ``cells``: all as written last; empty for a device that was never stored.
    """

    def __init__(self, stem: Path, model: str, folder: int) -> None:
        self._model = model
        self._folder = folder
        self._state = stem.with_name(stem.name + ".state")
        self._live = stem.with_name(stem.name + ".live")
        self._live_fd = -1
        for path in (self._state, self._live):
            with _clear(path, "cannot be used", "choose another folder"):
                _temporary(path).unlink(missing_ok=True)
        state = self._read(self._state, self._decode_state)
        live = self._read(self._live, self._decode_live)
        if state is None and live is not None:
            raise StateError(
                f"state {self._live}: there is no {self._state.name} beside it; "
                "restore that, or remove this file to start anew"
            )
        self._stored = dict(state.cells) if state is not None else {}
        self.cells: dict[str, int] = dict(self._stored)
        self._sequence = state.sequence if state is not None else 0
        self._is_live_newer = live is not None and live.sequence > self._sequence
        if live is not None and self._is_live_newer:
            self._sequence = live.sequence
            self.cells.update(live.cells)

    def save(self, cells: Mapping[str, int], *, durable: bool) -> None:
        """Write ``cells``: durable ones, or the first ever, with all others as a new record.

        A durable write is on disk when this returns.  Raises StateError.
        """
        self.cells.update(cells)
        if durable or not self._stored:
            if self._is_live_newer or self._stored != self.cells:
                self._write_state()
            return
        # What was written live since the record has to stay in the entry, which is replaced.
        live = {
            name: value for name, value in self.cells.items() if self._stored.get(name) != value
        }
        live.update(cells)
        sequence = self._sequence + 1
        entry = encode_entry(Record(self._model, sequence, live))
        if entry is None:
            self._write_state()
        else:
            with _clear(self._live, "cannot be written", "make room, or check the disk"):
                self._write_live(entry, sequence)
            self._sequence = sequence  # a write that failed is tried again in the same place
            self._is_live_newer = True

    def close(self) -> None:
        """Close the files."""
        if self._live_fd >= 0:
            os.close(self._live_fd)
            self._live_fd = -1

    def _write_state(self) -> None:
        sequence = self._sequence + 1
        data = encode(Record(self._model, sequence, self.cells))
        with _clear(self._state, "cannot be written", "make room, or check the disk"):
            self._replace(self._state, data)
        self._sequence = sequence
        self._stored = dict(self.cells)
        self._is_live_newer = False

    def _write_live(self, entry: bytes, sequence: int) -> None:
        if self._live_fd < 0:
            if not self._live.exists():
                self._replace(self._live, entry + entry)
            self._live_fd = os.open(self._live, os.O_WRONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
        written = os.pwrite(self._live_fd, entry, ENTRY_SIZE * (sequence % 2))
        if written != ENTRY_SIZE:
            raise OSError(None, "no room")

    def _replace(self, path: Path, data: bytes) -> None:
        """Give ``path`` the content ``data``: all of it or, whatever happens, none."""
        new = _temporary(path)
        try:
            with open(new, "xb", buffering=0, opener=_new_file) as file:
                rest = memoryview(data)
                while rest:
                    rest = rest[file.write(rest) :]
                os.fsync(file.fileno())
            new.replace(path)
        except OSError:
            with contextlib.suppress(OSError):  # it takes room where there is none
                new.unlink(missing_ok=True)
            raise
        os.fsync(self._folder)

    def _read(self, path: Path, decoder: Callable[[bytes], _Result]) -> _Result | None:
        """What ``path`` holds, or None if there is no such file.  Raises StateError."""
        with _clear(path, "cannot be read", "allow it, or choose another folder"):
            try:
                data = path.read_bytes()
            except FileNotFoundError:
                return None
        try:
            return decoder(data)
        except RecordError as error:
            raise StateError(
                f"state {path}: {error}; it was left as it is: "
                f"restore a good copy, or remove {path.stem}.* to start with factory values"
            ) from None

    def _decode_state(self, data: bytes) -> Record:
        return decode(data, self._model)

    def _decode_live(self, data: bytes) -> Record:
        """The newest of the two entries that is whole."""
        if len(data) != 2 * ENTRY_SIZE:
            raise RecordError(f"it has {len(data)} bytes instead of {2 * ENTRY_SIZE}")
        records: list[Record] = []
        reason: RecordError | None = None
        for start in (0, ENTRY_SIZE):
            try:
                records.append(decode_entry(data[start : start + ENTRY_SIZE], self._model))
            except RecordError as error:
                reason = error
        if not records:
            assert reason is not None
            raise reason
        return max(records, key=lambda record: record.sequence)


def _temporary(path: Path) -> Path:
    """Where the next content of ``path`` is written."""
    return path.with_name(path.name + _TEMPORARY)


def _new_file(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_CLOEXEC, _FILE_MODE)


Slot: TypeAlias = MemorySlot | FileSlot
"""The memory of one device."""

Stores: TypeAlias = MemoryStorage | Storage
"""Where slots come from."""


@contextlib.contextmanager
def _clear(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Turn what the operating system refuses into one line for the user."""
    try:
        yield
    except OSError as error:
        raise StateError(f"state {path}: {what} ({error.strerror}); {remedy}") from None
