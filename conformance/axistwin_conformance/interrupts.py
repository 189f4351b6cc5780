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
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNALS: Final = (*ENDING, signal.SIGALRM)  # the last one: to try again
RETRY_S: Final = 0.01
WEAK_REFERENCES: Final = (weakref.__file__, "_weakrefset.py")
CALLED_BY_THEM: Final = ("_remove", "remove")  # when what they refer to is gone


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """In the block each of these signals raises KeyboardInterrupt, unless it is ignored already, as
    a shell's background jobs and nohup have it."""
    interrupter = _Interrupter()
    gc.callbacks.append(interrupter.note)
    try:
        with _handled_by(interrupter):
            try:
                yield
            finally:
                _forget_retry()
    finally:
        gc.callbacks.remove(interrupter.note)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Ignore them while a device is made safe (bounded by time-outs)."""
    with _handled_by(signal.SIG_IGN):
        yield


@contextlib.contextmanager
def _handled_by(
    handler: Callable[[int, FrameType | None], None] | signal.Handlers,
) -> Iterator[None]:
    """Let the signals that are not ignored already go there; only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard = {number: signal.getsignal(number) for number in SIGNALS}
    before = {number: one for number, one in heard.items() if one is not signal.SIG_IGN}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, one in before.items():
            signal.signal(number, one)


def _forget_retry() -> None:
    """What is to be tried again would end the process once nobody handles it."""
    if threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_REAL, 0)


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
        if code.co_name in CALLED_BY_THEM and code.co_filename.endswith(WEAK_REFERENCES):
            return True
        frame = frame.f_back
    return False
