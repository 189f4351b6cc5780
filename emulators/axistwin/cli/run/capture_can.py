"""``--capture`` of a CAN bus: every frame on it, as ``candump -l`` writes it.

    (1795284668.861751) vcan0 601#4000200000000000 T
    (1795284668.863711) vcan0 581#4200200000000000 R

Seconds since the epoch at which the frame was complete, the name of the bus, the frame; ``T`` was
sent by a host, ``R`` by a module.  python-can's writer makes the lines; its reader and can-utils
read them.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Iterator
from typing import TextIO, cast

import can

from axistwin.cli.run.capture import FLUSH_S, CaptureFile
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.ports.can_message import message_of
from axistwin.runtime.bus import Bus, Passed
from axistwin.runtime.serving.loop import LoopShare

CHANNEL = "vcan0"


class BusRecorder:
    """Writes the frames that it is given, from any thread, to ``file`` in ``loop``'s thread."""

    def __init__(self, file: CaptureFile, loop: LoopShare, epoch_ns: Nanos) -> None:
        self._file = file
        self._writer = can.CanutilsLogWriter(cast(TextIO, file), channel=CHANNEL, append=True)
        self._loop = loop
        self._epoch_ns = epoch_ns
        self._waiting: deque[Passed] = deque()
        self._flushing = False

    def take(self, passed: Passed) -> None:
        """A frame was on the bus."""
        self._waiting.append(passed)
        if not self._flushing:
            self._flushing = True
            self._loop.call_soon(self._loop.call_later, FLUSH_S, self._flush_later)

    def end(self) -> None:
        """Write what is left, and close the file."""
        self._write()
        self._file.close()

    def _flush_later(self) -> None:
        self._flushing = False
        self._write()
        self._file.flush()

    def _write(self) -> None:
        while self._waiting:
            passed = self._waiting.popleft()
            time_s = (self._epoch_ns + passed.end_ns) / NS_PER_S
            self._writer.on_message_received(
                message_of(passed.frame, time_s=time_s, is_rx=not passed.from_host)
            )


@contextlib.contextmanager
def recording_bus(
    bus: Bus, path: str, loop: LoopShare, epoch_ns: Nanos, on_failure: Callable[[str], None]
) -> Iterator[None]:
    """Append what is on ``bus`` to the file at ``path``.  Raises UsageError.

    epoch_ns: what to add to the time of the bus.
    on_failure: called with the reason, once, when the recording has to end early.
    """
    recorder = BusRecorder(CaptureFile(path, "", on_failure), loop, epoch_ns)
    unsubscribe = bus.subscribe_frames(recorder.take)
    try:
        yield
    finally:
        unsubscribe()
        recorder.end()
