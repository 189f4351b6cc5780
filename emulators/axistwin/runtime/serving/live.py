"""What happens to the devices of a rack, as events for whoever looks on.

Rules
-----
1. A watcher first gets a ``DeviceShown`` of each device that it watches, then changes only.
2. Devices tell few things by themselves: the rest is looked at every ``LOOK_S``, or every
   ``REST_S`` where nothing has changed for ``ACTIVE_S``; nobody watches, nobody looks.
3. Everything here runs in the rack's loop.  A watcher must not wait.
4. What is set from outside, by whatever way, is told even if it is as it was: whoever looked on
   may show less.
5. Messages of a line (``traffic``) are told to whoever asks for them, ``LOOK_S`` apart.
"""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

from axistwin.kernel.effects import Trace
from axistwin.kernel.time import Nanos
from axistwin.runtime.any_twin import AnyTwin
from axistwin.runtime.serving.rack import Rack, RackDevice
from axistwin.runtime.serving.traffic import LineTraffic, WatchedLine
from axistwin.runtime.simulation import ControlWorked

LOOK_S = 0.05
REST_S = 0.25
ACTIVE_S = 1.0


@dataclass(frozen=True, slots=True)
class DeviceShown:
    """All that can be seen of a device at one instant of its line."""

    event: ClassVar[str] = "snapshot"
    device: str
    time_ns: Nanos
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ValuesChanged:
    """The values of a device that are not what they were when it was last looked at."""

    event: ClassVar[str] = "changed"
    device: str
    time_ns: Nanos
    values: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class ControlSet:
    """A control was set, or worked, from outside; ``value``: as it is then, None if not read."""

    event: ClassVar[str] = "set"
    device: str
    time_ns: Nanos
    control: str
    value: Any


@dataclass(frozen=True, slots=True)
class DeviceTold:
    """A device told something by itself: what ``kind`` of thing, and in words."""

    event: ClassVar[str] = "told"
    device: str
    time_ns: Nanos
    kind: str
    text: str


@dataclass(frozen=True, slots=True)
class LineTold:
    """A line has news, such as a client that comes or goes, or that it has failed."""

    event: ClassVar[str] = "line"
    line: str
    kind: str
    details: Mapping[str, Any]


RackEvent: TypeAlias = (
    DeviceShown | ValuesChanged | ControlSet | DeviceTold | LineTold | LineTraffic
)
Watcher: TypeAlias = Callable[[RackEvent], None]


@dataclass(slots=True)
class _Watched:
    """A device that somebody watches."""

    device: RackDevice
    values: dict[str, Any]
    watchers: list[Watcher] = field(default_factory=list)
    active_until_s: float = 0.0
    looked_s: float = 0.0
    unsubscribe: Callable[[], object] = lambda: None


class Live:
    """Tells watchers what happens to the devices of ``rack``."""

    def __init__(self, rack: Rack) -> None:
        self._rack = rack
        self._watched: dict[str, _Watched] = {}
        self._lines: dict[str, WatchedLine] = {}
        self._watchers: list[Watcher] = []
        self._is_looking = False
        self._due_s = 0.0  # when to look next
        rack.subscribe(self._line_told)

    def watch(
        self, devices: Collection[str], watcher: Watcher, lines: Collection[str] = ()
    ) -> Callable[[], None]:
        """Tell ``watcher`` of ``devices``, of all lines, and what goes over ``lines``.

        Call what is returned to end that.
        """
        self._watchers.append(watcher)
        for name in devices:
            device = self._rack.devices.get(name)  # its line may just have been removed
            if device is not None and device.server.failure is None:
                self._watch_device(device, watcher)
        for line in lines:
            self._watch_line(line, watcher)
        if not self._is_looking:
            self._is_looking = True
            self._due_s = time.monotonic() + LOOK_S
            self._rack.loop.call_later(LOOK_S, self._look)

        def leave() -> None:
            self._watchers.remove(watcher)
            for name in devices:
                self._leave_device(name, watcher)
            for line in lines:
                self._leave_line(line, watcher)

        return leave

    def touch(self, device: RackDevice) -> None:
        """Something was done to ``device``: look at it soon."""
        watched = self._watched.get(device.name)
        if watched is not None:
            watched.active_until_s = time.monotonic() + ACTIVE_S

    def _line_told(self, line: str, event: Mapping[str, object]) -> None:
        """Tell all watchers what a server reports of ``line``."""
        details = {name: value for name, value in event.items() if name != "event"}
        for watcher in tuple(self._watchers):
            watcher(LineTold(line, str(event["event"]), details))
        if event["event"] == "line_removed":
            gone = [name for name, each in self._watched.items() if each.device.line == line]
            for name in gone:
                watched = self._watched.pop(name)
                watched.unsubscribe()
                watched.watchers.clear()
            if line in self._lines:
                self._lines.pop(line).unsubscribe()

    # -- the lines ----------------------------------------------------------------------------

    def _watch_line(self, name: str, watcher: Watcher) -> None:
        server = self._rack.lines.get(name)
        if server is None or server.failure is not None:
            return
        if name not in self._lines:
            self._lines[name] = WatchedLine(name, server)
        self._on_line(self._lines[name], lambda line: line.join(watcher))

    def _leave_line(self, name: str, watcher: Watcher) -> None:
        line = self._lines.get(name)
        if line is None or watcher not in line.watchers:
            return
        line.watchers.remove(watcher)
        if not line.watchers:
            line.unsubscribe()
            del self._lines[name]

    def _on_line(self, line: WatchedLine, action: Callable[[WatchedLine], None]) -> None:
        """Do it; a line that fails ends alone."""
        try:
            action(line)
        except Exception as error:
            line.server.fail(error)

    # -- the devices --------------------------------------------------------------------------

    def _watch_device(self, device: RackDevice, watcher: Watcher) -> None:
        watched = self._watched.get(device.name)
        read = self._read(device)
        if read is None:
            return
        now_ns, values = read
        if watched is None:
            watched = self._watched[device.name] = _Watched(device, values)
            self._hear(watched)
        else:
            self._tell_changes(watched, now_ns, values)
        watcher(DeviceShown(device.name, now_ns, values))
        watched.watchers.append(watcher)

    def _leave_device(self, name: str, watcher: Watcher) -> None:
        watched = self._watched.get(name)
        if watched is None or watcher not in watched.watchers:
            return
        watched.watchers.remove(watcher)
        if not watched.watchers:
            watched.unsubscribe()
            del self._watched[name]

    def _hear(self, watched: _Watched) -> None:
        """Pass on what the device tells by itself."""
        device = watched.device

        def told(twin: AnyTwin, trace: Trace) -> None:
            if twin is device.twin:
                self.touch(device)
                tell(DeviceTold(device.name, trace.time_ns, type(trace).__name__, str(trace)))

        def worked(twin: AnyTwin, work: ControlWorked) -> None:
            if twin is device.twin:
                self.touch(device)
                tell(ControlSet(device.name, work.time_ns, work.control, work.value))

        def tell(event: RackEvent) -> None:
            # Perhaps in another thread, which has the line: later, in the loop's.
            self._rack.loop.call_soon(self._tell, watched, event)

        simulation = device.server.simulation
        ends = (simulation.subscribe(told), simulation.subscribe_worked(worked))
        watched.unsubscribe = lambda: [end() for end in ends]

    def _tell(self, watched: _Watched, event: RackEvent) -> None:
        for watcher in tuple(watched.watchers):
            watcher(event)

    # -- looking ------------------------------------------------------------------------------

    def _look(self) -> None:
        """Look at what is due, and again as long as somebody watches."""
        if not self._watchers:
            self._is_looking = False
            return
        now_s = time.monotonic()
        for watched in tuple(self._watched.values()):
            period_s = LOOK_S if now_s < watched.active_until_s else REST_S
            is_due = now_s - watched.looked_s > period_s - LOOK_S / 2  # a look may be early or late
            if is_due and watched.device.server.failure is None:
                watched.looked_s = now_s
                self._look_at(watched)
        for line in tuple(self._lines.values()):
            if line.server.failure is None:
                self._on_line(line, WatchedLine.report)
        # What looking takes is no part of the period, unless it takes most of it.
        now_s = time.monotonic()
        self._due_s = max(self._due_s + LOOK_S, now_s + LOOK_S / 2)
        self._rack.loop.call_later(self._due_s - now_s, self._look)

    def _look_at(self, watched: _Watched) -> None:
        read = self._read(watched.device)
        if read is not None:
            self._tell_changes(watched, *read)

    def _read(self, device: RackDevice) -> tuple[Nanos, dict[str, Any]] | None:
        """Its values now; None: its line has just failed."""
        try:
            return device.twin.controls.read_all(is_live=True)
        except Exception as error:  # a line that fails ends alone
            device.server.fail(error)
            return None

    def _tell_changes(self, watched: _Watched, now_ns: Nanos, values: dict[str, Any]) -> None:
        before = watched.values
        changed = {name: value for name, value in values.items() if before[name] != value}
        if not changed:
            return
        watched.values = values
        self.touch(watched.device)
        for watcher in tuple(watched.watchers):
            watcher(ValuesChanged(watched.device.name, now_ns, changed))
