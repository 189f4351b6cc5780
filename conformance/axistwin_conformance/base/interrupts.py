"""Ctrl-C, SIGTERM and SIGHUP end a run in the same way: stopped, put back, reported.

Python drops what a signal's handler raises while a finaliser runs, or a callback of the garbage
collector (Hypothesis has one), and takes it for a mistake of a module that is being imported.  An
interrupt that comes there is tried again a moment later, until it comes where it is heard.

While a device is made safe (`held_back`) the next one is a wish to be quick (`is_hurried`), unless
it comes in the same breath: an axis that is being driven back is stopped where it is, the rest is
still put back.  What has not ended `GRACE_S` later, or at one more interrupt, is cut short.

When a run is over (`run_is_over`) there is nothing left to be ended early but its words: the first
one then changes nothing, so that a verdict that was reached is told and written.
"""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Final

ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIGNALS: Final = (*ENDING, signal.SIGALRM)  # the last one: to try again
RETRY_S: Final = 0.01
GRACE_S: Final = 5.0  # to put parameters back takes 2 s on a slow line; on a dead one it never ends
BREATH_S: Final = 0.3  # a key pressed twice, or a wrapper that hands on what has come already
AGAIN_S: Final = 1.0  # sooner it is the same impatience: by then most is put back
LAST_S: Final = 2.0  # what is done after the cut: a stop
WEAK_REFERENCES: Final = (weakref.__file__, "_weakrefset.py")
CALLED_BY_THEM: Final = ("_remove", "remove")  # when what they refer to is gone
IMPORTING: Final = "<frozen importlib"  # the file of what imports


class CutShort(BaseException):
    """Nobody waits any longer for the device to be made safe; not an Exception, so that nothing
    takes it for trouble on the way."""


@contextlib.contextmanager
def heeded() -> Iterator[None]:
    """In the block each of these signals raises KeyboardInterrupt, unless it is ignored already, as
    a shell's background jobs and nohup have it."""
    interrupter = _Interrupter()
    _interrupters.append(interrupter)
    try:
        with _heard_by(interrupter):
            yield
    finally:
        _interrupters.remove(interrupter)


def run_is_over() -> None:
    """From here to the end of the block of `heeded` a first one is let pass, a later one heard."""
    for interrupter in _interrupters:
        interrupter.let_pass()


_interrupters: Final[list[_Interrupter]] = []  # what is heeded, one in another
_clean_ups: Final[list[_CleanUp]] = []  # that are going on, one in another


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """In the block, in which a device is made safe, they only hurry; see above.  `CutShort`, if
    nobody catches it, ends the block."""
    clean_up = _CleanUp()
    _clean_ups.append(clean_up)
    try:
        with contextlib.suppress(CutShort), _heard_by(clean_up):
            yield
    finally:
        _clean_ups.remove(clean_up)


def is_held_back() -> bool:
    """True while a device is made safe."""
    return bool(_clean_ups)


def is_hurried() -> bool:
    """True if somebody has interrupted what makes the device safe: nothing long must begin, and
    what has, ends."""
    return any(clean_up.hurried_s is not None for clean_up in _clean_ups)


@contextlib.contextmanager
def _heard_by(handler: _Handler) -> Iterator[None]:
    gc.callbacks.append(handler.note)
    try:
        with _handled_by(handler):
            try:
                yield
            finally:
                _forget_retry()
    finally:
        gc.callbacks.remove(handler.note)


@contextlib.contextmanager
def _handled_by(
    handler: Callable[[int, FrameType | None], None],
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


class _Handler:
    """A handler of the signals, and a callback of the garbage collector."""

    def __init__(self) -> None:
        self._is_collecting = False  # a collection runs finalisers of all kinds

    def note(self, phase: str, info: object) -> None:
        """A collection begins or ends."""
        self._is_collecting = phase == "start"

    def __call__(self, number: int, frame: FrameType | None) -> None:
        raise NotImplementedError

    def _raise(self, what: type[BaseException], frame: FrameType | None) -> None:
        """Raise it, now or where it is heard."""
        if self._is_collecting or _is_dropped(frame):
            signal.setitimer(signal.ITIMER_REAL, RETRY_S)
        else:
            raise what


class _Interrupter(_Handler):
    """What a signal does to a run; `_passed_s`: when one came that was let pass."""

    def __init__(self) -> None:
        super().__init__()
        self._is_over = False
        self._passed_s: float | None = None

    def let_pass(self) -> None:
        """The run is over; see `run_is_over`."""
        _forget_retry()
        self._is_over = True

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if not self._is_over or number == signal.SIGALRM:
            self._raise(KeyboardInterrupt, frame)
        elif self._passed_s is None:
            self._passed_s = now_s
        elif now_s - self._passed_s >= AGAIN_S:
            self._raise(KeyboardInterrupt, frame)


class _CleanUp(_Handler):
    """What a signal does to what makes a device safe; `hurried_s`: when the first one came."""

    def __init__(self) -> None:
        super().__init__()
        self._begun_s = time.monotonic()
        self.hurried_s: float | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now_s = time.monotonic()
        if self.hurried_s is None:
            if number != signal.SIGALRM and now_s - self._begun_s >= BREATH_S:
                self.hurried_s = now_s
                signal.setitimer(signal.ITIMER_REAL, GRACE_S)
        elif number == signal.SIGALRM or now_s - self.hurried_s >= AGAIN_S:
            signal.setitimer(signal.ITIMER_REAL, LAST_S)  # or what is done then had no end
            self._raise(CutShort, frame)


def _is_dropped(frame: FrameType | None) -> bool:
    """True where nobody would hear of what is raised."""
    callbacks = {getattr(callback, "__code__", None) for callback in gc.callbacks}
    while frame is not None:
        code = frame.f_code
        if code in callbacks or code.co_name == "__del__":
            return True
        if code.co_filename.startswith(IMPORTING):
            return True
        if code.co_name in CALLED_BY_THEM and code.co_filename.endswith(WEAK_REFERENCES):
            return True
        frame = frame.f_back
    return False
