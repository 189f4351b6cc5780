"""A host program's sleeping and its clocks: moved in virtual time, or only watched.

While a host's time is on, these ask it instead of the machine, in the threads that take part:

- ``time.sleep``, ``monotonic``, ``perf_counter``, ``time``, and the same with ``_ns``, also where a
  module has them by ``from time import sleep``;
- ``threading``: ``Condition.wait``, and with it ``Event``, ``Semaphore``, ``Barrier``, ``Timer``,
  ``queue.Queue`` and the results of futures; ``Thread.join``;
- asyncio's loops, whose time and selector are the above.

``time.time`` goes on from the present date.  Not moved, for they wait in C: ``Lock.acquire`` with a
time-out, sockets, subprocesses; and ``datetime.now``, which has a clock of its own.

While somebody watches, nothing is moved: what is slept in real time is counted, so that a test that
fails can say so.
"""

import queue
import selectors
import sys
import threading
import time
import weakref
from _thread import get_ident
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, Final

from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.runtime.host.time import HostTime, Participant

OWN_TIME: Final = (
    "axistwin",
    "axistwin_conformance",
    "_pytest",
    "pytest",
    "pluggy",
    "xdist",
    "execnet",
    "hypothesis",
)
"""Packages whose modules keep the machine's clocks."""

really_sleep: Final = time.sleep
_real_wait = threading.Condition.wait
_real_start = threading.Thread.start
_real_join = threading.Thread.join
_real_select = selectors.DefaultSelector.select

HOST: Final = HostTime()
"""The time of this process, if somebody uses it."""

_users: list[object] = []
_epoch_ns: dict[str, Nanos] = {}
_slept_s: dict[int, float] | None = None
_undo: list[tuple[Any, str, Any]] = []
_participants: "weakref.WeakKeyDictionary[threading.Thread, Participant]" = (
    weakref.WeakKeyDictionary()
)


def use(user: object) -> None:
    """Keep the host's time on until ``release`` of the same user."""
    if not _users:
        _searched.clear()
        for name in _NAMES:
            _epoch_ns[name] = _REAL[f"{name}_ns"]() - HOST.now_ns
        HOST.start()
        _patch()
    if not any(each is user for each in _users):
        _users.append(user)


def release(user: object) -> None:
    """The last user's release turns it off."""
    _users[:] = [each for each in _users if each is not user]
    if not _users and HOST.is_on:
        HOST.stop()
        _restore()


def users() -> list[object]:
    """Those who keep the host's time on."""
    return list(_users)


def watch() -> None:
    """Count from now on what is slept in real time."""
    global _slept_s  # noqa: PLW0603 - there is one ``time.sleep``
    if _slept_s is None:
        _slept_s = {}
        _patch()


def stop_watching() -> None:
    """Count no more."""
    global _slept_s  # noqa: PLW0603
    if _slept_s is not None:
        _slept_s = None
        _restore()


def slept_s() -> float:
    """Seconds that the thread that slept most did so while somebody watched."""
    return max((_slept_s or {}).values(), default=0.0)


# -- what stands in their places ---------------------------------------------------------------


def _mine() -> HostTime | None:
    """The host's time, if the present thread takes part in it."""
    return HOST if HOST.is_on and HOST.current() is not None else None


@contextmanager
def _counted(timeout: float | None) -> Iterator[None]:
    """What sleeps in real time for ``timeout`` seconds, None: who knows."""
    watched, began_ns = _slept_s, _REAL["monotonic_ns"]()
    yield
    if watched is not None and timeout is not None:
        slept = (_REAL["monotonic_ns"]() - began_ns) / NS_PER_S
        watched[get_ident()] = watched.get(get_ident(), 0.0) + slept


def _sleep(seconds: float) -> None:
    host = _mine()
    if host is None or seconds < 0:  # which is an error
        with _counted(seconds):
            really_sleep(seconds)
    else:
        host.wait(host.span_until(seconds))


def _clock_ns(name: str) -> Callable[[], int]:
    real = _REAL[f"{name}_ns"]

    def clock_ns() -> int:
        host = _mine()
        return real() if host is None else _epoch_ns[name] + host.look()

    return clock_ns


def _clock(name: str) -> Callable[[], float]:
    real = _REAL[name]

    def clock() -> float:
        host = _mine()
        return real() if host is None else (_epoch_ns[name] + host.look()) / NS_PER_S

    return clock


class _Waiter:
    """Stands for the lock that ``Condition.notify`` releases."""

    def __init__(self, host: HostTime) -> None:
        self._host = host
        self.is_released = False

    def release(self) -> None:
        self.is_released = True
        self._host.nudge()


def _wait(condition: Any, timeout: float | None = None) -> bool:
    host = _mine()
    if host is None or not condition._is_owned():  # which is an error
        with _counted(timeout):
            return _real_wait(condition, timeout)
    waiter = _Waiter(host)
    condition._waiters.append(waiter)
    state = condition._release_save()
    try:
        host.wait(host.span_until(timeout), lambda: waiter.is_released)
    finally:
        condition._acquire_restore(state)
        if not waiter.is_released:
            condition._waiters.remove(waiter)
    return waiter.is_released


def _start(thread: threading.Thread) -> None:
    host = _mine()
    if host is None:
        _real_start(thread)
        return
    newcomer = host.expect()
    run = thread.run

    def run_in_turn() -> None:
        del thread.run
        host.begin(newcomer)
        try:
            run()
        finally:
            host.leave(newcomer)

    thread.run = run_in_turn  # type: ignore[method-assign]
    _participants[thread] = newcomer
    try:
        _real_start(thread)
    except BaseException:
        del thread.run
        host.leave(newcomer)
        raise
    host.wait(host.now_ns)  # until it waits for something, or has ended


def _join(thread: threading.Thread, timeout: float | None = None) -> None:
    host, other = _mine(), _participants.get(thread)
    if host is None or other is None or other is host.current():  # the last is an error
        _real_join(thread, timeout)
        return
    host.wait(host.span_until(timeout), lambda: host.has_left(other))
    if host.has_left(other):
        _real_join(thread)


def _select(selector: Any, timeout: float | None = None) -> Any:
    host = _mine()
    if host is None:
        with _counted(timeout):
            return _real_select(selector, timeout)
    found = _real_select(selector, 0)
    if not found:
        host.wait(host.span_until(timeout), lambda: bool(_real_select(selector, 0)))
        found = _real_select(selector, 0)
    return found


# -- putting them there ------------------------------------------------------------------------

_NAMES = ("monotonic", "perf_counter", "time")
_REAL: Final[dict[str, Any]] = {
    name: getattr(time, name) for each in _NAMES for name in (each, f"{each}_ns")
}
_MOVED: Final[dict[str, Callable[..., Any]]] = {
    "sleep": _sleep,
    **{name: _clock(name) for name in _NAMES},
    **{f"{name}_ns": _clock_ns(name) for name in _NAMES},
}
_FUNCTIONS: Final[dict[int, Callable[..., Any]]] = {
    id(real): _MOVED[name] for name, real in (("sleep", really_sleep), *_REAL.items())
}
"""What stands in for a function of ``time``, by identity."""

_METHODS: Final[tuple[tuple[Any, str, Any], ...]] = (
    (threading.Condition, "wait", _wait),
    (threading.Thread, "start", _start),
    (threading.Thread, "join", _join),
    (selectors.DefaultSelector, "select", _select),
    (queue, "SimpleQueue", queue._PySimpleQueue),  # type: ignore[attr-defined]  # not in C
)
_REAL_FUNCTIONS: Final = {
    id(moved): real for real, moved in ((getattr(time, name), _MOVED[name]) for name in _MOVED)
}
_searched: dict[str, tuple[int, tuple[str, ...]]] = {}
"""Name of a module -> its identity, and what it calls those functions."""


def _patch() -> None:
    """Put everything in its place."""
    if not _undo:
        for owner, name, moved in _METHODS:
            _undo.append((owner, name, getattr(owner, name)))
            setattr(owner, name, moved)
    _replace(_FUNCTIONS)


def _restore() -> None:
    """Put everything back, if nobody needs it any more."""
    if not HOST.is_on and _slept_s is None:
        while _undo:
            setattr(*_undo.pop())
        _replace(_REAL_FUNCTIONS)


def _replace(others: dict[int, Callable[..., Any]]) -> None:
    """In every module of the program, also one that came while the others were there."""
    for module_name, module in tuple(sys.modules.items()):
        known_id, names = _searched.get(module_name, (0, ()))
        if known_id != id(module):
            names = _search(module_name, module)
            _searched[module_name] = id(module), names
        for name in names:
            stands_there = getattr(module, name, None)
            if (instead := others.get(id(stands_there))) is not None:
                setattr(module, name, instead)


def _search(module_name: str, module: object) -> tuple[str, ...]:
    """What a module of the program calls the functions of ``time``, or what stands for them."""
    if not isinstance(module, ModuleType) or module_name.partition(".")[0] in OWN_TIME:
        return ()
    return tuple(
        name
        for name, value in tuple(vars(module).items())
        if type(value) in (BuiltinFunctionType, FunctionType)
        and (id(value) in _FUNCTIONS or id(value) in _REAL_FUNCTIONS)
    )
