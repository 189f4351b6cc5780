"""A program that does not come back is told of, with its line, and stopped as by an error.

While it runs nothing else does, signals included, so only a signal handler can look: it finds from
which call the program has not returned, and raises ``NeverReturns`` in the program's own line.
"""

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import axistwin
from axistwin.macroprogram.program import NeverReturns, calls_programs

PATIENCE_S = 5
"""How long a scan, or the loading of a file, may take."""

_OWN_FOLDER = str(Path(axistwin.__file__).parent)


class _Watchdog:
    """Looks once a second."""

    def __init__(self) -> None:
        self._call: FrameType | None = None
        self._looks = 0

    def look(self, number: int, frame: FrameType | None) -> None:
        """Raise NeverReturns if the present call of a program has been seen often enough."""
        call = _call_of_program(frame)
        self._looks = self._looks + 1 if call is not None and call is self._call else 0
        self._call = call  # held, so that no other call can be taken for it
        if self._looks >= PATIENCE_S:
            self._looks = 0
            raise NeverReturns(f"it did not come back for {PATIENCE_S} s; a scan ends with yield")


def _call_of_program(frame: FrameType | None) -> FrameType | None:
    """The frame that has called a user's program, if one is running."""
    is_users = False
    while frame is not None and not calls_programs(frame.f_code.co_filename):
        is_users = is_users or not frame.f_code.co_filename.startswith(_OWN_FOLDER)
        frame = frame.f_back
    return frame if is_users else None


@contextlib.contextmanager
def watching_programs() -> Iterator[None]:
    """Watch what runs in this thread, the main one, in the block; also inside such a block."""
    before = signal.signal(signal.SIGALRM, _Watchdog().look)
    timer_before = signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *timer_before)
        signal.signal(signal.SIGALRM, before)
