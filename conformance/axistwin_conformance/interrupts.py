"""Ctrl-C, SIGTERM and SIGHUP end a run in the same way: stopped, put back, reported.

Python drops what a signal's handler raises while a finaliser runs, or a callback of the garbage
collector (Hypothesis has one).  An interrupt that comes there is tried again a moment later,
until it comes where it is heard.
"""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
import weakref
from collections.abc import Iterator
from types import FrameType
from typing import Final

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNALS: Final = (*ENDING, signal.SIGALRM)  # the last one: to try again
RETRY_S: Final = 0.01
FINALISERS: Final = ("__del__", "_remove", "remove")  # by name; the last two: of weak references
WEAKREF_FILES: Final = (weakref.__file__, "_weakrefset.py")


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """In the block each of these signals raises KeyboardInterrupt, unless it is ignored already, as
    a shell's background jobs and nohup have it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    interrupter = _Interrupter()
    gc.callbacks.append(interrupter.note)
    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, interrupter)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        gc.callbacks.remove(interrupter.note)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ignore them while a device is made safe (bounded by time-outs)."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in before:
        signal.signal(number, signal.SIG_IGN)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class _Interrupter:
    """The handler of the signals, and a callback of the garbage collector."""

    def __init__(self) -> None:
        self._is_collecting = False  # a collection runs finalisers of all kinds

    def note(self, phase: str, info: object) -> None:
        """A collection begins or ends."""
        self._is_collecting = phase == "start"

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self._is_collecting or _is_dropped(frame):
            signal.setitimer(signal.ITIMER_REAL, RETRY_S)
        else:
            raise KeyboardInterrupt


def _is_dropped(frame: FrameType | None) -> bool:
    """True where nobody would hear of what is raised."""
    callbacks = {getattr(one, "__code__", None) for one in gc.callbacks}
    while frame is not None:
        code = frame.f_code
        if code in callbacks or code.co_name == "__del__":
            return True
        if code.co_name in FINALISERS and code.co_filename.endswith(WEAKREF_FILES):
            return True
        frame = frame.f_back
    return False
