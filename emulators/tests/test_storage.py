import errno
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.errors import StateError
from axistwin.memory.record import ENTRY_SIZE, Record, encode
from axistwin.runtime.storage import MemoryStorage, Storage

CELLS = {"address": 0, "period": 800, "position": 0}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder that holds the memory of mac23-0, its position saved live twice."""
    storage = Storage(tmp_path / "state")
    slot = storage.slot("mac23-0", "mac23")
    slot.save(CELLS, durable=True)
    slot.save({"position": 10}, durable=False)
    slot.save({"position": 20}, durable=False)
    storage.close()
    return tmp_path / "state"


def reopened(folder: Path, name: str = "mac23-0", model: str = "mac23") -> dict[str, int]:
    """The cells as the next process finds them."""
    storage = Storage(folder)
    try:
        return dict(storage.slot(name, model).cells)
    finally:
        storage.close()


def write(folder: Path, cells: dict[str, int]) -> None:
    """Store ``cells`` of mac23-0, and its position live, as a process does."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    slot.save(cells, durable=True)
    slot.save({"position": 30}, durable=False)
    storage.close()


def test_a_new_slot_is_empty_and_writes_nothing(tmp_path: Path) -> None:
    """Only a write makes files; the folder itself is made with its parents."""
    storage = Storage(tmp_path / "a" / "b")
    assert storage.slot("mac23-0", "mac23").cells == {}
    storage.close()
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["lock"]


def test_what_was_written_is_there_after_a_restart(folder: Path) -> None:
    """Durable cells and the newest live position are read back."""
    assert reopened(folder) == {"address": 0, "period": 800, "position": 20}


def test_a_durable_write_is_newer_than_the_live_ones_before_it(folder: Path) -> None:
    """A counter set to 0 durably is not overtaken by an older saved position."""
    storage = Storage(folder)
    storage.slot("mac23-0", "mac23").save({"position": 0}, durable=True)
    storage.close()
    assert reopened(folder)["position"] == 0


def test_a_live_cell_survives_durable_writes_of_others(folder: Path) -> None:
    """A record holds all cells, those saved live included."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    slot.save({"position": 30}, durable=False)
    slot.save({"period": 900}, durable=True)
    slot.save({"address": 7}, durable=False)
    storage.close()
    assert reopened(folder) == {"address": 7, "period": 900, "position": 30}


def test_several_live_cells_do_not_forget_one_another(folder: Path) -> None:
    """An entry replaces the one before, so it carries what that one told too."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    slot.save({"position": 31}, durable=False)
    for period in range(5):
        slot.save({"period": period}, durable=False)
    storage.close()
    assert reopened(folder) == {"address": 0, "period": 4, "position": 31}


def test_live_cells_too_big_for_an_entry_become_a_record(folder: Path) -> None:
    """Nothing is dropped for want of room."""
    many = {f"cell_{i}": i for i in range(50)}
    storage = Storage(folder)
    storage.slot("mac23-0", "mac23").save(many, durable=False)
    storage.close()
    assert reopened(folder) == {**CELLS, "position": 20, **many}


steps = st.one_of(
    st.just("restart"),
    st.tuples(
        st.dictionaries(st.sampled_from("abc"), st.integers(0, 3), min_size=1), st.booleans()
    ),
)


@pytest.mark.strength
@settings(max_examples=60)
@given(st.lists(steps, max_size=12))
def test_whatever_is_written_in_whatever_way_is_found_again(
    tmp_path_factory: pytest.TempPathFactory, history: list[Any]
) -> None:
    """After any mix of durable and live writes and restarts every cell has its last value."""
    folder = tmp_path_factory.mktemp("state")
    storage = Storage(folder)
    slot = storage.slot("x", "mac23")
    expected: dict[str, int] = {}
    for step in [*history, "restart"]:
        if step == "restart":
            storage.close()
            storage = Storage(folder)
            slot = storage.slot("x", "mac23")
        else:
            cells, durable = step
            slot.save(cells, durable=durable)
            expected.update(cells)
        assert slot.cells == expected
    storage.close()


def test_a_durable_write_is_synchronised_renamed_and_synchronised_in_this_order(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The file is on disk before its name changes, the name before the write returns."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    steps: list[str] = []
    fsync, replace = os.fsync, os.replace

    def spy_fsync(fd: int) -> None:
        steps.append("fsync folder" if Path(f"/proc/self/fd/{fd}").resolve().is_dir() else "fsync")
        fsync(fd)

    def spy_rename(self: Path, target: Path) -> Path:
        steps.append(f"{self.name} -> {target.name}")
        replace(self, target)
        return target

    monkeypatch.setattr(os, "fsync", spy_fsync)
    monkeypatch.setattr(Path, "replace", spy_rename)
    slot.save({"period": 1}, durable=True)
    assert steps == ["fsync", "mac23-0.state.new -> mac23-0.state", "fsync folder"]
    steps.clear()
    slot.save({"position": 99}, durable=False)
    assert steps == []
    storage.close()


def test_a_durable_write_of_what_is_stored_already_costs_nothing(folder: Path) -> None:
    """The record on disk holds it; it is not written again."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    slot.save({"period": 800}, durable=True)  # takes the live position in
    before = (folder / "mac23-0.state").stat().st_mtime_ns
    slot.save({"period": 800}, durable=True)
    assert (folder / "mac23-0.state").stat().st_mtime_ns == before
    storage.close()


def test_every_torn_state_file_is_an_error_and_is_left_untouched(folder: Path) -> None:
    """Cut at any length, the file is refused, and stays as it is, byte for byte."""
    path = folder / "mac23-0.state"
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(StateError, match=r"mac23-0\.state: it is .*left as it is.*restore"):
            reopened(folder)
        assert path.read_bytes() == whole[:length]


def test_every_flipped_byte_of_a_state_file_is_an_error(folder: Path) -> None:
    """Either the exact cells or an error: here always the error."""
    path = folder / "mac23-0.state"
    whole = path.read_bytes()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0x01
        path.write_bytes(damaged)
        with pytest.raises(StateError):
            reopened(folder)


@pytest.mark.strength
def test_of_two_live_entries_the_newest_whole_one_holds(folder: Path) -> None:
    """With any byte of the file damaged, one of the last two positions is found."""
    path = folder / "mac23-0.live"
    whole = path.read_bytes()
    assert len(whole) == 2 * ENTRY_SIZE
    found = set()
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 0x40
        path.write_bytes(damaged)
        found.add(reopened(folder)["position"])
    assert found == {10, 20}


def test_a_live_file_without_any_whole_entry_is_an_error(folder: Path) -> None:
    """Both places damaged, a cut file, an empty one: one clear line, nothing touched."""
    path = folder / "mac23-0.live"
    whole = path.read_bytes()
    broken = whole.replace(b"position", b"pasition")
    for data in (broken, whole[:-1], whole[:ENTRY_SIZE], b"", b"\0" * len(whole)):
        path.write_bytes(data)
        with pytest.raises(StateError, match=r"mac23-0\.live: it .*left as it is"):
            reopened(folder)
        assert path.read_bytes() == data


def test_a_live_file_without_its_record_is_an_error(folder: Path) -> None:
    """A position alone is no memory; the missing file is named."""
    (folder / "mac23-0.state").unlink()
    with pytest.raises(StateError, match=r"there is no mac23-0\.state beside it"):
        reopened(folder)


def test_a_file_of_another_model_is_an_error(folder: Path) -> None:
    """A MAC34 does not start from a MAC23's memory."""
    with pytest.raises(StateError, match="belongs to a mac23, not to a mac34-1"):
        reopened(folder, model="mac34-1")


def test_a_foreign_file_is_an_error_and_is_left_untouched(folder: Path) -> None:
    """What is not ours is not overwritten."""
    path = folder / "mac23-0.state"
    path.write_bytes(b"my thesis\n")
    with pytest.raises(StateError, match="no axistwin state"):
        reopened(folder)
    assert path.read_bytes() == b"my thesis\n"


def test_an_unreadable_file_is_an_error(folder: Path) -> None:
    """A folder in place of the file stands for everything the system refuses to read."""
    (folder / "mac23-0.state").unlink()
    (folder / "mac23-0.state").mkdir()
    with pytest.raises(StateError, match=r"mac23-0\.state: cannot be read \(Is a directory\)"):
        reopened(folder)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    """The path and the system's reason are told."""
    (tmp_path / "file").write_text("")
    with pytest.raises(StateError, match=r"cannot be used.*choose another folder"):
        Storage(tmp_path / "file" / "state")


def test_what_a_kill_leaves_behind_is_removed(folder: Path) -> None:
    """A half-written file under its other name was never acknowledged; others' files stay."""
    (folder / "mac23-0.state.new").write_bytes(encode(Record("mac23", 9, CELLS))[:50])
    (folder / "mac23-0.live.new").write_bytes(b"")
    (folder / "notes.new").write_text("mine")
    assert reopened(folder)["position"] == 20
    names = sorted(path.name for path in folder.iterdir())
    assert names == ["lock", "mac23-0.live", "mac23-0.state", "notes.new"]


def test_what_is_a_stranger_s_stays(folder: Path) -> None:
    """Only what is left of the devices that are there is removed, and a link is not followed."""
    (folder / "diary.state.new").write_text("mine")
    (folder / "diary.live.new").write_text("mine")
    (folder / "target").write_text("mine")
    (folder / "mac23-0.state.new").symlink_to("target")
    write(folder, {"torque": 3})
    assert (folder / "diary.state.new").read_text() == "mine"
    assert (folder / "diary.live.new").read_text() == "mine"
    assert (folder / "target").read_text() == "mine"
    assert not os.path.lexists(folder / "mac23-0.state.new")


@pytest.mark.parametrize("is_link", [True, False], ids=["link", "file"])
def test_a_lock_that_is_a_stranger_s_is_refused_and_left_untouched(
    tmp_path: Path, is_link: bool
) -> None:
    """It is told in one line, and has its content still."""
    (tmp_path / "diary").write_text("mine\n")
    if is_link:
        (tmp_path / "lock").symlink_to("diary")
    else:
        (tmp_path / "lock").write_text("mine\n")
    with pytest.raises(StateError, match="choose another folder"):
        Storage(tmp_path)
    assert (tmp_path / "lock").read_text() == "mine\n"
    assert (tmp_path / "diary").read_text() == "mine\n"


def test_only_the_owner_may_write_what_is_made(tmp_path: Path) -> None:
    """Whatever the umask."""
    before = os.umask(0)
    try:
        write(tmp_path / "new" / "memory", {"torque": 3})
    finally:
        os.umask(before)
    made = [tmp_path / "new", *(tmp_path / "new").rglob("*")]
    assert len(made) >= 4
    assert [path for path in made if path.stat().st_mode & 0o022] == []


def test_one_name_given_twice_gets_two_slots(tmp_path: Path) -> None:
    """Two modules at one address on one line have two memories, found again in order."""
    for turn in range(2):
        storage = Storage(tmp_path)
        slots = [storage.slot("mac23-0", "mac23") for _ in range(3)]
        for number, slot in enumerate(slots):
            assert slot.cells == ({"position": number} if turn else {})
            slot.save({"position": number}, durable=True)
        storage.close()
    assert (tmp_path / "mac23-0-3.state").exists()


def test_a_folder_in_use_is_refused_and_free_again_after_close(folder: Path) -> None:
    """Two processes never write one memory; the owner is named."""
    storage = Storage(folder)
    with pytest.raises(StateError, match=rf"in use by another axistwin \(process {os.getpid()}\)"):
        Storage(folder)
    storage.close()
    assert reopened(folder)["period"] == 800


HOLD = """
import sys
from axistwin.runtime.storage import Storage
storage = Storage(sys.argv[1])
print("held", flush=True)
sys.stdin.read()
"""


@pytest.mark.system
def test_the_lock_ends_with_its_process_however_that_ends(folder: Path) -> None:
    """After kill -9 of the owner the folder can be used at once."""
    command = [sys.executable, "-c", HOLD, str(folder)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, **pipes) as owner:  # type: ignore[call-overload]
        assert owner.stdout.readline() == b"held\n"
        with pytest.raises(StateError, match=f"process {owner.pid}"):
            Storage(folder)
        owner.kill()
    assert reopened(folder)["position"] == 20


def test_a_full_disk_is_an_error_and_keeps_the_old_record(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The write raises; the next process finds the cells as they were."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StateError, match=r"cannot be written \(No space left on device\)"):
        slot.save({"period": 1}, durable=True)
    monkeypatch.undo()
    storage.close()
    assert reopened(folder) == {"address": 0, "period": 800, "position": 20}


def test_a_short_live_write_is_an_error(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A position that was not written entirely is not taken for saved."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    monkeypatch.setattr(os, "pwrite", lambda fd, data, offset: len(data) - 1)
    with pytest.raises(StateError, match=r"mac23-0\.live: cannot be written"):
        slot.save({"position": 5}, durable=False)
    storage.close()


NO_ROOM = """
import resource, signal, sys
from axistwin.cli.main import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
main(["run", "mac23", "--tcp", "127.0.0.1:0", "--state", sys.argv[1]])
"""


@pytest.mark.system
def test_a_folder_without_room_is_told_in_one_line(tmp_path: Path) -> None:
    """Where no file may grow, a run ends at once, with the folder, the reason and what to do."""
    folder = tmp_path / "state"
    ended = subprocess.run(
        [sys.executable, "-c", NO_ROOM, str(folder)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (ended.returncode, ended.stdout) == (2, "")
    (line,) = ended.stderr.splitlines()
    assert f"state {folder}: cannot be written (File too large); make room, or" in line


def test_a_folder_that_cannot_be_locked_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """File systems without locks exist; nobody would keep a second process out."""

    def none_left(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", none_left)
    with pytest.raises(StateError, match=r"cannot be locked \(No locks available\); choose"):
        Storage(tmp_path)


@pytest.mark.parametrize("is_durable_first", [False, True])
def test_writes_that_fail_again_and_again_leave_what_was_saved_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch, is_durable_first: bool
) -> None:
    """Of live entries torn in the middle none is the newest whole one; what fits again holds."""
    storage = Storage(folder)
    slot = storage.slot("mac23-0", "mac23")
    whole = os.pwrite

    def half(fd: int, data: bytes, offset: int) -> int:
        return whole(fd, bytes(len(data) // 2), offset)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", half)
    monkeypatch.setattr(os, "fsync", full)
    for position in (5, 6, 7):
        with pytest.raises(StateError, match="cannot be written"):
            slot.save({"position": position}, durable=is_durable_first)
        with pytest.raises(StateError, match="cannot be written"):
            slot.save({"position": position}, durable=False)
    monkeypatch.undo()
    assert not list(folder.glob("*.new")), "it would take room where there is none"
    copy = folder.parent / "copy"
    shutil.copytree(folder, copy)
    assert reopened(copy)["position"] == 20
    slot.save({"position": 8}, durable=False)
    storage.close()
    assert reopened(folder)["position"] == 8


def test_memory_without_a_folder_lives_as_long_as_the_process() -> None:
    """Volatile storage says so, and keeps nothing for the next."""
    storage = MemoryStorage()
    slot = storage.slot("mac23-0", "mac23")
    slot.save(CELLS, durable=True)
    slot.save({"position": 4}, durable=False)
    assert slot.cells == {**CELLS, "position": 4}
    assert storage.is_volatile
    assert not storage.slot("mac23-0", "mac23").cells
    storage.close()


def test_a_folder_without_a_name_is_not_the_current_one() -> None:
    """One clear line that no option of any program is named in."""
    with pytest.raises(StateError, match="needs the name of a folder"):
        Storage("")
