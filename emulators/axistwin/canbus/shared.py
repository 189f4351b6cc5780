"""The buses of this process, which several ports share, and their periodic tasks."""

import atexit
import contextlib
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from typing import Protocol

from axistwin import catalog
from axistwin.canbus.channel import ChannelRequest
from axistwin.errors import AxistwinError, UsageError
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.runtime.bus import Bus
from axistwin.runtime.host import patches


class Task(Protocol):
    """Something to be done in virtual time, whoever lets it pass."""

    due_ns: Nanos

    def run(self, now: Nanos) -> None:
        """Do it; it is due later then, or removed."""


class SharedBus:
    """A bus, the options it was made with, and the periodic tasks of all who have it open."""

    def __init__(self, request: ChannelRequest) -> None:
        options = self.options = request.options
        self.name = request.name
        self.users = 0
        self._tasks: list[Task] = []
        self._tasks_lock = threading.RLock()
        self.bus: Bus = catalog.build_bus(**options.arguments(), bitrate=options.bitrate)
        _known.add(self)
        self.epoch_ns = 0
        if not self.bus.is_virtual:
            self.epoch_ns = time.time_ns() - self.bus.sync()

    def bits_ns(self, bits: int) -> Nanos:
        """How long ``bits`` take."""
        return -(-bits * NS_PER_S // self.bus.bitrate)

    def wait(
        self, until_ns: Nanos | None, port: int | None, stop: Callable[[], bool] = lambda: False
    ) -> Nanos:
        """``Bus.wait``, which stops for what is due of periodic tasks."""
        sweep()
        due_ns = min((task.due_ns for task in tuple(self._tasks)), default=None)
        if due_ns is None or (until_ns is not None and until_ns < due_ns):
            return self.bus.wait(until_ns, port, stop=stop)
        now = self.bus.wait(due_ns, port, stop=stop)
        with self._tasks_lock:  # whoever else let this time pass
            for task in tuple(self._tasks):
                if task.due_ns <= now:
                    task.run(now)
        return now

    def advance(self, duration_ns: Nanos, stop: Callable[[], bool] = lambda: False) -> None:
        """Let ``duration_ns`` (>= 0) pass, or less when ``stop()`` comes true and it is woken."""
        now = self.bus.sync()
        until_ns = now + duration_ns
        while now < until_ns and not stop():
            now = self.wait(until_ns, None, stop)

    def add_task(self, task: Task) -> None:
        """Let ``task`` be due from now on."""
        with self._tasks_lock:
            if task not in self._tasks:
                self._tasks.append(task)

    def remove_task(self, task: Task) -> None:
        """Forget ``task``, if it is known."""
        with self._tasks_lock:
            if task in self._tasks:
                self._tasks.remove(task)


_registry_lock = threading.Lock()
_shared: dict[str, SharedBus] = {}
_known: "weakref.WeakSet[SharedBus]" = weakref.WeakSet()


def open_bus(request: ChannelRequest) -> SharedBus:
    """The bus that ``request`` asks for, new or shared.  Raises UsageError and StateError."""
    sweep()
    with _registry_lock:
        found = _shared.get(request.name)
        if found is None:
            if not request.options.devices:
                raise UsageError(
                    f"there is no bus {request.name}, not yet or not any more; name devices to "
                    f"make one, such as mac23-can:1?bus={request.name}"
                )
            found = _shared[request.name] = SharedBus(request)
        for name in sorted(request.given):
            wanted, has = getattr(request.options, name), getattr(found.options, name)
            if wanted != has:
                raise UsageError(
                    f"bus {found.name} is open already: {name} is {has}, not {wanted}; "
                    "shut that down, or choose another bus=NAME"
                )
        found.users += 1
        if found.options.host_clock:
            patches.use(found)
        return found


def close_bus(shared: SharedBus) -> None:
    """One port less; the last one closes the bus.  Raises StateError."""
    with _registry_lock:
        shared.users -= 1
        if shared.users:
            return
        del _shared[shared.name]
    patches.release(shared)
    shared.bus.close()


_abandoned: deque[tuple[SharedBus, int]] = deque()


def abandon(shared: SharedBus, port: int) -> None:
    """Leave it to ``sweep`` to take ``port`` off its bus; safe in the midst of anything."""
    _abandoned.append((shared, port))


def sweep() -> None:
    """Take the ports off their buses that nobody can use any more."""
    while _abandoned:
        try:
            shared, port = _abandoned.popleft()
        except IndexError:  # another thread does it
            return
        with contextlib.suppress(AxistwinError):  # there is nobody to be told
            shared.bus.detach(port)
        with contextlib.suppress(AxistwinError):
            close_bus(shared)


atexit.register(sweep)


def open_names() -> list[str]:
    """The names of all buses that are open."""
    with _registry_lock:
        return list(_shared)


def known() -> list[SharedBus]:
    """All buses that anybody refers to, those that are shut down included."""
    with _registry_lock:
        return list(_known)
