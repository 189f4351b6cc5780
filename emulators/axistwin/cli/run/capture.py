"""``--capture`` of a serial line: what is said on it, as text.

One line per burst (bytes in one direction without a pause)::

       1520.312 > 02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03  0: 20h position?
       1531.250 < 06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A  0: position 0

Milliseconds of the twin's time, ``>`` from the host or ``<`` to it, all bytes in hex, two spaces,
and what they mean.  A line that begins with ``#`` is a remark: the date at which a run began.

A recording that cannot begin is a mistake of the user's.  One that cannot go on, because the disk
is full or a pipe is not read, ends there and is told of once; what is recorded goes on, since more
depends on it, and never waits for the file.
"""

import contextlib
import errno
import io
import os
import time
from collections.abc import Callable, Iterator

from axistwin.cli.run.outlet import Outlet
from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.line import Line
from axistwin.runtime.serving.line_server import PAUSE_NS
from axistwin.runtime.serving.loop import LoopShare
from axistwin.runtime.transcript import ARROWS, Burst, Direction, Transcript

ROOM_BYTES = 4 * 1024 * 1024
"""What waits for a slow file."""

_FAREWELL_S = 5.0
"""How long the rest of a recording may take at the end."""

FLUSH_S = 0.05
"""How long what was said may wait before it is in the file."""


class CaptureFile:
    """The text file at ``path``, to be written behind what it has.  Raises UsageError.

    heading: written at once.  on_failure: called with the reason, once, when the file cannot be
    written any more; nothing is written from then on.  It may be called in another thread.
    """

    def __init__(self, path: str, heading: str, on_failure: Callable[[str], None]) -> None:
        self._on_failure = on_failure
        self._has_failed = False
        self._text = io.StringIO()
        self._fd = -1
        try:
            # Or else the open would wait until somebody reads, if it is a pipe with a name.
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NONBLOCK
            self._fd = os.open(path, flags, 0o666)
            os.write(self._fd, heading.encode())
            os.set_blocking(self._fd, True)
        except OSError as error:
            if self._fd >= 0:
                os.close(self._fd)
            reason = "nobody reads it" if error.errno == errno.ENXIO else error.strerror
            raise UsageError(
                f"capture {path}: cannot be written ({reason}); choose another file"
            ) from None
        self._outlet = Outlet(
            self._fd, ROOM_BYTES, lambda error: self._fail(error.strerror or str(error))
        )

    def write(self, text: str) -> None:
        """Write ``text``, to be seen after the next ``flush``."""
        self._text.write(text)

    def flush(self) -> None:
        """Hand over to the disk what waits to be written."""
        text = self._text.getvalue()
        self._text = io.StringIO()
        if text and not self._has_failed and not self._outlet.put(text.encode()):
            self._fail("it does not take what is said as fast as it comes")

    def close(self) -> None:
        """Flush and close."""
        self.flush()
        if self._outlet.close(_FAREWELL_S):
            os.close(self._fd)
        else:  # still in use
            self._fail("it takes nothing")

    def _fail(self, reason: str) -> None:
        if not self._has_failed:
            self._has_failed = True
            self._on_failure(reason)


class Recorder(Transcript):
    """A transcript that is also written to ``file``, burst by burst, in ``loop``'s thread."""

    def __init__(self, file: CaptureFile, explain: Callable[[bytes], str], loop: LoopShare) -> None:
        super().__init__(pause_ns=PAUSE_NS)
        self.subscribe(self._write_burst)
        self._file = file
        self._explain_bytes = explain
        self._loop = loop
        self._flushing = False
        self._added_s = 0.0

    def add(self, time_ns: Nanos, direction: Direction, data: bytes, note: str = "") -> None:
        """Keep ``data``; it joins the last burst unless that went the other way or is over."""
        super().add(time_ns, direction, data, note)
        self._added_s = time.monotonic()
        if not self._flushing:
            self._flushing = True
            self._loop.call_later(FLUSH_S, self._flush_later)

    def _write_burst(self, burst: Burst) -> None:
        """Write a burst that is over."""
        data = burst.data
        text = (
            f"{burst.time_ns / NS_PER_MS:12.3f} {ARROWS[burst.direction]} {data.hex(' ').upper()}"
        )
        self._file.write(f"{text}  {burst.note or self._explain_bytes(data)}".rstrip() + "\n")

    def end(self) -> None:
        """Write what is left, and close the file."""
        self.flush()
        self._file.close()

    def _flush_later(self) -> None:
        self._flushing = time.monotonic() - self._added_s < FLUSH_S
        if self._flushing:  # the burst may go on
            self._loop.call_later(FLUSH_S, self._flush_later)
        else:
            self.flush()
        self._file.flush()


@contextlib.contextmanager
def recording_line(
    line: Line,
    path: str,
    explain: Callable[[bytes], str],
    loop: LoopShare,
    on_failure: Callable[[str], None],
) -> Iterator[None]:
    """Append what is said on ``line`` to the file at ``path``.  Raises UsageError.

    on_failure: called with the reason, once, when the recording has to end early.
    """
    heading = f"# {time.strftime('%Y-%m-%d %H:%M:%S %z')}\n"
    recorder = Recorder(CaptureFile(path, heading, on_failure), explain, loop)
    line.transcript = recorder
    try:
        yield
    finally:
        recorder.end()
