"""The server's event loop: descriptors, and what to call when they are ready.

asyncio's loop would do, but it takes longer for one event than a twin takes for a whole exchange,
and longer to import than everything else together.  A server needs no tasks, transports or
executors: only what stands here.

Rules
-----
1. Callbacks run in the thread of ``run``, one after the other.  An error in one ends ``run``, but
   for those of a ``LoopShare``: there it ends what that share serves.
2. Everything is level-triggered: a descriptor that is still ready is served again.
3. Hang-ups and errors of a descriptor are told to its reader, or to its writer if it has none.
4. ``call_soon`` and ``stop`` may be called from any thread and from signal handlers; everything
   else only where the loop runs, or before it does.
"""

import contextlib
import heapq
import os
import select
import signal
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from types import MappingProxyType
from typing import Any, Protocol, TypeAlias

from axistwin.runtime.serving.opens import OpenWatches

_EVENTS_MAX = 64
_FOREVER_S = -1.0


Callback: TypeAlias = Callable[[], object]
OnFailure: TypeAlias = Callable[[Exception], object]


def _pass_on(error: Exception) -> None:
    raise error


class _HasDescriptor(Protocol):
    def fileno(self) -> int: ...


_Watch: TypeAlias = tuple[Callback, OnFailure]


class Loop:
    """Waits for descriptors, for a time, or to be told something.  Owned by one thread."""

    def __init__(self) -> None:
        self._epoll = select.epoll()
        self._readers: dict[int, _Watch] = {}
        self._writers: dict[int, _Watch] = {}
        self._soon: deque[Callable[[], object]] = deque()
        self._later: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = count()
        self._opens: OpenWatches | None = None
        self._is_stopped = False
        self.has_server = False
        self._signals: dict[signal.Signals, Any] = {}
        self._wakeup_before = -1
        # A pipe and not an eventfd, since that is what ``set_wakeup_fd`` can write to.
        self._woken, self._wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self.add_reader(self._woken, self._drain)

    # -- descriptors --

    def add_reader(
        self, fd: int | _HasDescriptor, callback: Callback, on_failure: OnFailure = _pass_on
    ) -> None:
        """Call ``callback`` whenever ``fd`` can be read, in place of what was called before.

        on_failure: called with what ``callback`` raises; otherwise that ends ``run``.
        """
        self._watch(self._readers, fd, (callback, on_failure))

    def add_writer(
        self, fd: int | _HasDescriptor, callback: Callback, on_failure: OnFailure = _pass_on
    ) -> None:
        """Call ``callback`` whenever ``fd`` can be written, as ``add_reader``."""
        self._watch(self._writers, fd, (callback, on_failure))

    def remove_reader(self, fd: int | _HasDescriptor) -> None:
        """Do not wait for ``fd`` to be readable; it need not have a reader."""
        self._forget(self._readers, fd)

    def remove_writer(self, fd: int | _HasDescriptor) -> None:
        """Do not wait for ``fd`` to be writable; it need not have a writer."""
        self._forget(self._writers, fd)

    def _watch(self, watches: dict[int, _Watch], fd: int | _HasDescriptor, watch: _Watch) -> None:
        number = fd if isinstance(fd, int) else fd.fileno()
        is_known = number in self._readers or number in self._writers
        watches[number] = watch
        set_events = self._epoll.modify if is_known else self._epoll.register
        set_events(number, self._events(number))

    def _forget(self, watches: dict[int, _Watch], fd: int | _HasDescriptor) -> None:
        number = fd if isinstance(fd, int) else fd.fileno()
        if watches.pop(number, None) is None:
            return
        events = self._events(number)
        if events:
            self._epoll.modify(number, events)
        else:
            self._epoll.unregister(number)

    def _events(self, number: int) -> int:
        reads = select.EPOLLIN if number in self._readers else 0
        return reads | (select.EPOLLOUT if number in self._writers else 0)

    # -- files --

    def add_open_watch(self, path: str, callback: Callback) -> int:
        """Call ``callback`` when ``path`` has been opened; returns what to remove.

        Several opens may be told as one.  Raises OSError.
        """
        if self._opens is None:
            self._opens = OpenWatches()
            self.add_reader(self._opens, self._opens.tell)
        return self._opens.add(path, callback)

    def remove_open_watch(self, number: int) -> None:
        """Undo ``add_open_watch``."""
        assert self._opens is not None
        self._opens.remove(number)

    # -- times, and other threads --

    def call_soon(self, callback: Callable[..., object], *arguments: object) -> None:
        """Call ``callback`` with ``arguments`` before the loop waits again; from any thread."""
        self._soon.append(lambda: callback(*arguments))
        with contextlib.suppress(OSError):  # full, so that it wakes anyway; or closed
            os.write(self._wake, b"\0")

    def call_later(
        self, delay_s: float, callback: Callable[..., object], *arguments: object
    ) -> None:
        """Call ``callback`` with ``arguments`` in ``delay_s`` seconds, or up to 1 ms later."""
        due_s = time.monotonic() + delay_s
        heapq.heappush(self._later, (due_s, next(self._numbers), lambda: callback(*arguments)))

    def install_signal_handlers(
        self,
        stop_on: Sequence[signal.Signals],
        calls: Mapping[signal.Signals, Callback] = MappingProxyType({}),
    ) -> None:
        """From now on these signals make ``run`` return, until ``close``; in the main thread, once.

        calls: what other signals have called in ``run``, soon.

        One of ``stop_on`` before ``run`` makes it return at once; a second one before the loop
        ``has_server`` is KeyboardInterrupt: the start takes too long.
        """
        # Also wakes for a signal that comes between the last instruction and the wait.
        self._wakeup_before = signal.set_wakeup_fd(self._wake, warn_on_full_buffer=False)
        self._signals = {number: signal.signal(number, self._stop_by_signal) for number in stop_on}
        for number, callback in calls.items():
            self._signals[number] = signal.signal(
                number, lambda *_, callback=callback: self.call_soon(callback)
            )

    def _stop_by_signal(self, number: int, frame: object) -> None:
        if self._is_stopped and not self.has_server:
            raise KeyboardInterrupt
        self.stop()

    # -- life --

    def run(self) -> None:
        """Serve until ``stop``.  Raises what a callback raises."""
        poll, readers, writers = self._epoll.poll, self._readers, self._writers
        readable, writable = select.EPOLLIN, select.EPOLLOUT
        timeout_s = _FOREVER_S
        while True:
            if self._soon or self._later:
                timeout_s = self._call_due()
            if self._is_stopped:
                return
            for fd, events in poll(timeout_s, _EVENTS_MAX):
                # Looked up now: an earlier callback may have removed this one.
                watch = readers.get(fd)
                if watch is not None and events != writable:
                    callback, on_failure = watch
                    try:
                        callback()
                    except Exception as error:
                        on_failure(error)
                if events != readable:
                    watch = writers.get(fd)
                    if watch is not None:
                        callback, on_failure = watch
                        try:
                            callback()
                        except Exception as error:
                            on_failure(error)

    def stop(self) -> None:
        """Make ``run`` return soon; from any thread, also before it runs or when it is closed."""
        self._is_stopped = True
        self.call_soon(int)

    def close(self) -> None:
        """Give everything back.  Only when it does not run; the descriptors stay open."""
        if self._signals:
            signal.set_wakeup_fd(self._wakeup_before)
        for number, previous in self._signals.items():
            signal.signal(number, previous)
        self._signals.clear()
        self._epoll.close()
        if self._opens is not None:
            self._opens.close()
        woken, wake = self._woken, self._wake
        self._woken = self._wake = -1  # first: another thread may want to wake us just now
        os.close(woken)
        os.close(wake)

    def _call_due(self) -> float:
        """Call what is due; returns how long there is to wait then."""
        while self._soon:
            self._soon.popleft()()
        now = time.monotonic()
        while self._later and self._later[0][0] <= now:
            heapq.heappop(self._later)[2]()
        if self._soon:
            return 0.0
        return max(0.0, self._later[0][0] - now) if self._later else _FOREVER_S

    def _drain(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._woken, 4096)


class LoopShare:
    """The part of ``loop`` that one server has: what goes wrong in it concerns nobody else.

    on_failure: called with what a callback raises, in the loop's thread.
    """

    def __init__(self, loop: Loop, on_failure: Callable[[Exception], None]) -> None:
        self._loop = loop
        self._on_failure = on_failure
        self._is_closed = False

    def add_reader(self, fd: int | _HasDescriptor, callback: Callback) -> None:
        """As the loop's."""
        self._loop.add_reader(fd, callback, self._on_failure)

    def add_writer(self, fd: int | _HasDescriptor, callback: Callback) -> None:
        """As the loop's."""
        self._loop.add_writer(fd, callback, self._on_failure)

    def remove_reader(self, fd: int | _HasDescriptor) -> None:
        """As the loop's."""
        self._loop.remove_reader(fd)

    def remove_writer(self, fd: int | _HasDescriptor) -> None:
        """As the loop's."""
        self._loop.remove_writer(fd)

    def add_open_watch(self, path: str, callback: Callback) -> int:
        """As the loop's."""
        return self._loop.add_open_watch(path, self._guarded(callback))

    def remove_open_watch(self, number: int) -> None:
        """As the loop's."""
        self._loop.remove_open_watch(number)

    def call_soon(self, callback: Callable[..., object], *arguments: object) -> None:
        """As the loop's; from any thread."""
        self._loop.call_soon(self._guarded(lambda: callback(*arguments)))

    def call_later(
        self, delay_s: float, callback: Callable[..., object], *arguments: object
    ) -> None:
        """As the loop's."""
        self._loop.call_later(delay_s, self._guarded(lambda: callback(*arguments)))

    def close(self) -> None:
        """Call nothing more; descriptors are to be removed by who has added them."""
        self._is_closed = True

    def _guarded(self, callback: Callback) -> Callback:
        def call() -> None:
            if self._is_closed:
                return
            try:
                callback()
            except Exception as error:
                self._on_failure(error)

        return call
