"""``--capture``: what is said on the line, as text.

One line per burst (bytes in one direction without a pause)::

       1520.312 > 02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03  0: 20h position?
       1531.250 < 06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A  0: position 0

Milliseconds of the twin's time, ``>`` from the host or ``<`` to it, all bytes in hex, two spaces,
and what they mean.  A line that begins with ``#`` is a remark: the date at which a run began.

A recording that cannot begin is a mistake of the user's.  One that cannot go on, because the disk
is full, ends there and is told of once; the line goes on, since more depends on it.
"""

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.line import Line
from axistwin.runtime.loop import Loop
from axistwin.runtime.transcript import ARROWS, Burst, Direction, Transcript

# A reply may reach us in pieces, late when the machine is busy; the other direction ends it anyway.
PAUSE_NS: Nanos = 50 * NS_PER_MS
_FLUSH_S = 0.05


class Recorder(Transcript):
    """A transcript that is also written to ``file``, burst by burst, in ``loop``'s thread.

    on_failure: called with the reason, once, when the file cannot be written any more.
    """

    def __init__(
        self,
        file: TextIO,
        explain: Callable[[bytes], str],
        loop: Loop,
        on_failure: Callable[[str], None],
    ) -> None:
        super().__init__(pause_ns=PAUSE_NS)
        self.on_burst = self._write_burst
        self._file = file
        self._explain_bytes = explain
        self._loop = loop
        self._on_failure = on_failure
        self._has_failed = False
        self._flushing = False
        self._added_s = 0.0

    def add(self, time_ns: Nanos, direction: Direction, data: bytes, note: str = "") -> None:
        """Keep ``data``; it joins the last burst unless that went the other way or is over."""
        super().add(time_ns, direction, data, note)
        self._added_s = time.monotonic()
        if not self._flushing:
            self._flushing = True
            self._loop.call_later(_FLUSH_S, self._flush_later)

    def _write_burst(self, burst: Burst) -> None:
        """Write a burst that is over."""
        data = burst.data
        text = (
            f"{burst.time_ns / NS_PER_MS:12.3f} {ARROWS[burst.direction]} {data.hex(' ').upper()}"
        )
        self._write(f"{text}  {burst.note or self._explain_bytes(data)}".rstrip() + "\n")

    def end(self) -> None:
        """Write what is left, and close the file."""
        self.flush()
        self._flush()
        with contextlib.suppress(OSError):  # told by the flush
            self._file.close()

    def _flush_later(self) -> None:
        self._flushing = time.monotonic() - self._added_s < _FLUSH_S
        if self._flushing:  # the burst may go on
            self._loop.call_later(_FLUSH_S, self._flush_later)
        else:
            self.flush()
        self._flush()

    def _flush(self) -> None:
        self._write("")

    def _write(self, text: str) -> None:
        """Write ``text``, or, if it is empty, all that waits to be written."""
        if self._has_failed:
            return
        try:
            if text:
                self._file.write(text)
            else:
                self._file.flush()
        except OSError as error:
            self._has_failed = True
            self._on_failure(error.strerror or str(error))


@contextlib.contextmanager
def recording(
    line: Line,
    path: str | None,
    explain: Callable[[bytes], str],
    loop: Loop,
    on_failure: Callable[[str], None],
) -> Iterator[None]:
    """Append what is said on ``line`` to the file at ``path``, if any.  Raises UsageError.

    on_failure: called with the reason, once, when the recording has to end early.
    """
    if path is None:
        yield
        return
    recorder = Recorder(_begin(path), explain, loop, on_failure)
    line.transcript = recorder
    try:
        yield
    finally:
        recorder.end()


def _begin(path: str) -> TextIO:
    """The file at ``path`` with the date of this run appended.  Raises UsageError."""
    try:
        file = Path(path).open("a", encoding="utf-8")  # noqa: SIM115
        try:
            file.write(f"# {time.strftime('%Y-%m-%d %H:%M:%S %z')}\n")
            file.flush()
        except OSError:
            with contextlib.suppress(OSError):
                file.close()
            raise
    except OSError as error:
        raise UsageError(
            f"capture {path}: cannot be written ({error.strerror}); choose another file"
        ) from None
    return file
