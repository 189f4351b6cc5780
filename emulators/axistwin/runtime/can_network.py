"""One CAN bus with its devices and any number of host ports: everything that happens, in order.

    port 0 --+            +-- devices[0]
    port 1 --+-- CanBus --+-- devices[1]      each port is a controller of its own

Rules
-----
1. Events run in the order of time.  At one nanosecond: first the devices that want to be woken, by
   index, then the bus.  So everybody has offered what is ready before the bus arbitrates.
2. A frame reaches those who sent it, then all who heard it, in the order of their stations; what a
   device does then is offered before the bus goes on.
3. A ``SendFrame`` waits in the device's controller; ``Silence`` takes back what is not on the bus.
   ``Store`` and ``Trace`` are queued for the shell, which must perform the stores before it passes
   on any frame.
4. A powered device is on the bus and acknowledges, whether its firmware listens or not.
5. A port keeps ``PORT_QUEUE_FRAMES`` frames; what comes when they are not taken is lost to this
   port alone, and counted.
6. Whoever calls a device's methods from outside does so at ``now_ns``, and hands the effects to
   ``perform``.  The supply goes through ``power_off`` and ``power_on`` here: the bus must know.
7. Faults of the wire act on what the listeners get of a frame that was on the bus: its sender knows
   nothing of it, and the record has the frame as it was.  What one delays, later ones of its
   direction wait for.  Error frames and a dominant bus are the bus' own.
"""

from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple, TypeAlias

from axistwin.devices.base import CanDevice
from axistwin.kernel.effects import Effect, SendFrame, Silence, Store, Trace
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import Nanos
from axistwin.runtime.device_network import DeviceNetwork
from axistwin.wire.can_bus import CanBus, Change, ControllerState, Fault, Happening, Heard
from axistwin.wire.can_frame import CanFrame
from axistwin.wire.faults import Disturbance, WireFaults

PORT_QUEUE_FRAMES: Final = 4096
"""Frames, and as many error reports, that a port keeps for a host that does not take them."""

MANY_STEPS: Final = 512
"""So many that it is asked whether time runs away from who computes it."""

HEARD_MAX: Final = 65536
"""Frames kept for the record until somebody takes them."""


class Arrival(NamedTuple):
    """A frame at a host's port, complete at ``end_ns``; ``is_own``: the port sent it itself."""

    end_ns: Nanos
    frame: CanFrame
    is_own: bool = False


ErrorReport: TypeAlias = Fault | Change
"""A frame that failed, or a new state of the port's own controller."""


class _Port:
    """A host's end: its controller's station, and what has arrived."""

    __slots__ = ("arrivals", "dropped", "errors", "hears_errors", "hears_own")

    def __init__(self, hears_own: bool, hears_errors: bool) -> None:
        self.hears_own = hears_own
        self.hears_errors = hears_errors
        self.arrivals: deque[Arrival] = deque()
        self.errors: deque[ErrorReport] = deque(maxlen=PORT_QUEUE_FRAMES)
        self.dropped = 0


class CanNetwork(DeviceNetwork[CanDevice]):
    """The bus, the devices on it, and the hosts' ports.

    bitrate: bits per second, > 0.  paced: frames take their time; otherwise none.
    ``arrivals_count``: how many frames have ever been put into ports.
    ``long_span_ns``: the time over which ``run_until`` went last if that was much work, else 0.
    """

    def __init__(
        self,
        devices: Sequence[CanDevice],
        *,
        bitrate: int,
        start_ns: Nanos = 0,
        paced: bool = True,
        faults: WireFaults | None = None,
    ) -> None:
        self._late: dict[bool, deque[tuple[Nanos, CanFrame, tuple[int, ...]]]] = {
            False: deque(),
            True: deque(),
        }
        """By whether they go to the hosts: frames that faults hold back, until when, for whom."""
        super().__init__(devices, start_ns, faults or WireFaults("can"))
        self.bitrate = bitrate
        self.is_paced = paced
        self.arrivals_count = 0
        self.long_span_ns: Nanos = 0
        self._bus = CanBus(bitrate if paced else None, start_ns, is_destroyed=self._is_destroyed)
        for index in range(len(self.devices)):
            station = self._bus.attach(start_ns)
            assert station == index
        self._ports: dict[int, _Port] = {}  # by station
        self._heard: deque[Heard] = deque(maxlen=HEARD_MAX)

    # -- time --

    def next_event(self) -> Nanos | None:
        """When something is next due, or None when nothing can happen any more by itself."""
        device_ns, bus_ns = self._schedule.next_event(), self._bus.next_event()
        if device_ns is None or bus_ns is None:
            return bus_ns if device_ns is None else device_ns
        return min(device_ns, bus_ns)

    def run_until(self, now: Nanos) -> None:
        """Let everything happen that is due by ``now``, then stand at ``now``."""
        assert now >= self.now_ns, f"time went back from {self.now_ns} to {now} ns"
        if now == self.settled_ns:
            return
        steps, began_ns = 0, self.now_ns
        due_ns = self.next_event()
        if due_ns is not None and due_ns <= now:  # by far the most common is that nothing is due
            while self._run_next(now):
                steps += 1
        self.long_span_ns = now - began_ns if steps >= MANY_STEPS else 0
        self._stand_at(now)
        self.settled_ns = now

    def run_until_heard(self, port: int | None, limit_ns: Nanos | None) -> Nanos:
        """Let things happen until ``port`` has something to take, but none behind ``limit_ns``.

        port: None for no port.  Stops earlier when there are effects, or much heard, to take and,
        without a limit, when nothing can happen any more by itself.  Returns the time reached, at
        which more may be due (``run_until``).
        """
        self.settled_ns = None
        horizon_ns = NEVER - 1 if limit_ns is None else limit_ns
        while not (
            self._effects
            or len(self._heard) > HEARD_MAX // 2
            or (port is not None and self.host_has_news(port))
        ):
            if not self._run_next(horizon_ns):
                if limit_ns is not None:
                    self._stand_at(limit_ns)
                break
        return self.now_ns

    def _run_next(self, limit_ns: Nanos) -> bool:
        """Do what is due first, if by ``limit_ns`` (rule 1); False if nothing is."""
        bus_ns = self._bus.next_event()
        if bus_ns is None or bus_ns > limit_ns:
            return self._schedule.run_next(limit_ns)
        if self._schedule.run_next(bus_ns):
            return True
        self._stand_at(bus_ns)
        for happening in self._bus.run_next(bus_ns):
            self._tell(happening)
        return True

    def _stand_at(self, now: Nanos) -> None:
        if now > self._schedule.now:
            self._schedule.now = now
        if now > self._bus.now_ns:
            self._bus.now_ns = now

    # -- what happens on the bus --

    def _tell(self, happening: Happening) -> None:
        if isinstance(happening, Heard):
            self._heard.append(happening)
            self._deliver(happening)
        elif isinstance(happening, Fault):
            for port in self._ports.values():
                self._report(port, happening)
        elif happening.station in self._ports:
            self._report(self._ports[happening.station], happening)

    def _deliver(self, heard: Heard) -> None:
        """Rule 2."""
        end_ns, frame, devices = heard.end_ns, heard.frame, self.devices
        for station in heard.senders:
            if station < len(devices):
                self.perform(station, devices[station].sent(frame, end_ns))
            elif self._ports[station].hears_own:
                self._arrive(self._ports[station], Arrival(end_ns, frame, is_own=True))
        if self.faults.is_idle and not self._is_holding:
            self._reach(end_ns, frame, heard.listeners)
        else:
            self._pass_on(heard)

    def _reach(self, end_ns: Nanos, frame: CanFrame, listeners: tuple[int, ...]) -> None:
        """``listeners`` get ``frame`` at ``end_ns``."""
        arrival, devices = Arrival(end_ns, frame), self.devices
        for station in listeners:
            if station >= len(devices):
                self._arrive(self._ports[station], arrival)
            elif devices[station].accepts(frame):
                self.perform(station, devices[station].receive(frame, end_ns))

    # -- what goes wrong on the bus (rule 7) --

    @property
    def _is_holding(self) -> bool:
        return bool(self._late[False] or self._late[True])

    def _is_of_device(self, station: int) -> bool:
        return station < len(self.devices)

    def _is_destroyed(self, now: Nanos, frame: CanFrame, sender: int) -> bool:
        """Whether an error frame destroys it."""
        if self.faults.is_idle:
            return False
        return self.faults.destroys(now, frame, to_host=self._is_of_device(sender))

    def _pass_on(self, heard: Heard) -> None:
        """Let the listeners get what the faults make of the frame, behind what is held back."""
        end_ns, frame, senders, listeners = heard
        to_host = self._is_of_device(senders[0])
        passage = self.faults.passage(end_ns, frame, to_host=to_host)
        late = self._late[to_host]
        for gap_ns, piece in [(0, frame)] if passage is None else passage.pieces:
            due_ns = max(end_ns + gap_ns, late[-1][0] if late else 0)
            if due_ns > end_ns:
                late.append((due_ns, piece, listeners))
            elif not self.faults.is_lost(end_ns, to_host=to_host):
                self._reach(end_ns, piece, listeners)
        self._touch_faults()

    def next_disturbance(self) -> Nanos | None:
        """Also when a frame that is held back is due."""
        due_ns = super().next_disturbance()
        for late in self._late.values():
            if late and (due_ns is None or late[0][0] < due_ns):
                due_ns = late[0][0]
        return due_ns

    def disturb(self, now: Nanos) -> None:
        """Also pass on the frames that were held back until ``now``."""
        super().disturb(now)
        for to_host, late in self._late.items():
            while late and late[0][0] <= now:
                _, frame, listeners = late.popleft()
                there = [each for each in listeners if self._bus.is_attached(each)]
                if not self.faults.is_lost(now, to_host=to_host):
                    self._reach(now, frame, tuple(there))

    def _disturb(self, disturbance: Disturbance) -> None:
        assert disturbance.kind == "busy", "what else a bus can have comes with frames"
        self._bus.hold_dominant(self.now_ns, self.now_ns + disturbance.value)

    def _arrive(self, port: _Port, arrival: Arrival) -> None:
        if len(port.arrivals) < PORT_QUEUE_FRAMES:
            port.arrivals.append(arrival)
            self.arrivals_count += 1
        else:
            port.dropped += 1

    def _report(self, port: _Port, report: ErrorReport) -> None:
        if port.hears_errors:
            port.errors.append(report)

    def take_heard(self) -> list[Heard]:
        """All frames since last time (the last ``HEARD_MAX`` at most), for the record."""
        if not self._heard:
            return []
        heard = list(self._heard)
        self._heard.clear()
        return heard

    # -- the devices --

    def apply(self, index: int, effects: Iterable[Effect]) -> None:
        """Put ``effects`` on the bus or in the queue; the caller sees to the next event."""
        self.settled_ns = None
        for effect in effects:
            if isinstance(effect, SendFrame):
                self._bus.offer(index, effect.frame, max(effect.start_ns, self.now_ns))
            elif isinstance(effect, Silence):
                if self._bus.is_attached(index):
                    self._bus.withdraw(index, self.now_ns)
            else:
                assert isinstance(effect, Store | Trace)
                self._effects.append((index, effect))

    def _switch(self, index: int, *, on: bool) -> None:
        (self._bus.join if on else self._bus.leave)(index, self.now_ns)

    # -- the hosts' ports --

    def attach(
        self, *, hears_own: bool = False, hears_errors: bool = False, acknowledges: bool = True
    ) -> int:
        """A new port: a controller on the bus from now on.  Returns its number.

        hears_own: it gets the frames that it sent itself, when they have left.
        hears_errors: ``host_take_errors`` has something to tell.
        acknowledges: see ``set_acknowledging``.
        """
        self.settled_ns = None
        port = self._bus.attach(self.now_ns)
        self._bus.set_acknowledging(port, self.now_ns, acknowledges=acknowledges)
        self._ports[port] = _Port(hears_own, hears_errors)
        return port

    def set_acknowledging(self, port: int, *, acknowledges: bool) -> None:
        """Whether a port acknowledges the frames of others."""
        self.settled_ns = None
        self._bus.set_acknowledging(port, self.now_ns, acknowledges=acknowledges)

    def detach(self, port: int) -> None:
        """Take a port off the bus; a frame it is sending breaks off."""
        self.settled_ns = None
        self._bus.leave(port, self.now_ns)
        del self._ports[port]

    def host_send(self, port: int, frame: CanFrame) -> None:
        """Queue ``frame`` behind what the port still sends."""
        assert port in self._ports
        self.settled_ns = None
        self._bus.offer(port, frame, self.now_ns)

    def host_backlog(self, port: int) -> int:
        """How many of the port's frames have not been sent yet, one under way included."""
        return self._bus.backlog(port)

    def host_purge_output(self, port: int) -> None:
        """Forget what the port still has to send; a frame under way is not tried again."""
        self.settled_ns = None
        self._bus.withdraw(port, self.now_ns)

    def host_has_news(self, port: int) -> bool:
        """Whether there is a frame or an error report to take."""
        waiting = self._ports[port]
        return bool(waiting.arrivals or waiting.errors)

    def host_take(self, port: int, limit: int | None = None) -> list[Arrival]:
        """Take the frames that have arrived by now, ``limit`` (>= 0) of them at most."""
        arrivals = self._ports[port].arrivals
        count = len(arrivals) if limit is None else min(limit, len(arrivals))
        return [arrivals.popleft() for _ in range(count)]

    def host_take_errors(self, port: int) -> list[ErrorReport]:
        """Take what the port's controller has to report: failed frames, its own new states."""
        errors = self._ports[port].errors
        reports = list(errors)
        errors.clear()
        return reports

    def host_dropped(self, port: int) -> int:
        """How many frames were lost because nobody took them (rule 5)."""
        return self._ports[port].dropped

    def host_state(self, port: int) -> ControllerState:
        """State of the port's controller: active, passive or off."""
        return self._bus.state(port)

    def host_counters(self, port: int) -> tuple[int, int]:
        """Transmit and receive error counter of the port's controller."""
        return self._bus.counters(port)
