"""What owns a network in any kind of time: its clock, its storage, its twins and who looks on.

Rules
-----
1. Whoever looks, pushes time first: every method runs the network up to the clock's present time.
2. What the devices want stored is written, in their order, before anything that came after it can
   be read.  When it cannot be written, nothing can be read any more: the error is raised, again and
   again, since an acknowledgement would be a lie.
3. Before a host is given anything while an axis moves, its position is saved too: whatever the host
   was told outlives a kill.
4. Any thread may call anything.  ``on_change`` tells the one that keeps an alarm when the next
   event may have come nearer.
"""

import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import (
    Any,
    ClassVar,
    Final,
    Generic,
    Self,
    TypeAlias,
    TypedDict,
    TypeVar,
    Unpack,
    cast,
)

from axistwin.devices.base import TwinDevice
from axistwin.devices.controls import POWER, ControlTable
from axistwin.devices.motion_controls import MOTION
from axistwin.errors import StateError, UnknownNameError
from axistwin.kernel.effects import Effect, Store, Trace
from axistwin.kernel.time import Nanos
from axistwin.runtime.any_twin import AnyTwin
from axistwin.runtime.clock import Clock
from axistwin.runtime.device_network import DeviceNetwork
from axistwin.runtime.storage import Slot, Stores
from axistwin.runtime.transcript import Message, MessageSubscriber
from axistwin.runtime.twin import handle_class
from axistwin.wire.faults import FaultAct, FaultReport
from axistwin.wire.wire_fault import FaultDirection, FaultKind, make_fault

JOURNAL_MAX: Final = 1000
HAND: Final = "test"
"""Who does in the journal what is done by hand."""

Subscriber: TypeAlias = Callable[[AnyTwin, Trace], None]
WorkSubscriber: TypeAlias = Callable[[AnyTwin, "ControlWorked"], None]
FaultSubscriber: TypeAlias = Callable[[FaultAct], None]


@dataclass(frozen=True, slots=True)
class ControlWorked:
    """``control`` was worked at ``time_ns``; ``value``: as it is then, None if it is not read."""

    time_ns: Nanos
    control: str
    value: Any


class FaultSelection(TypedDict, total=False):
    """The fields of ``WireFault`` beside its kind."""

    direction: FaultDirection | None
    message: str
    hex: str
    count: int | None
    chance: float | None
    per_s: float | None
    duration_ms: float | None


@dataclass(frozen=True, slots=True)
class Station:
    """A device of a network: what it is called (``mac23:0``), its model, and its memory.

    controls: what a user can work and see of it.
    """

    name: str
    model: str
    device: TwinDevice
    slot: Slot
    controls: ControlTable = MOTION


Told = TypeVar("Told", bound=Callable[..., None])
Net = TypeVar("Net", bound=DeviceNetwork[Any])


class LineFaults:
    """The faults of the wire of ``simulation``: what goes wrong on it, and how often it has.

    Iterate for a ``FaultReport`` of each, with what it has done so far.
    """

    def __init__(self, simulation: "Simulation[Any]", network: DeviceNetwork[Any]) -> None:
        self._simulation, self._network = simulation, network

    def add(self, kind: FaultKind, **selection: Unpack[FaultSelection]) -> int:
        """Have a fault act from now on, by the fields of ``WireFault``; its number.

        It acts on the next message, unless told otherwise: ``add("drop", direction="to_host")``
        loses the next reply.  Raises UsageError.
        """
        fault = make_fault(self._network.faults.wire, kind=kind, **selection)
        with self._simulation.changing():
            number = self._network.add_fault(fault)
        self._simulation.note(f"faults.add: {number} {fault}")
        return number

    def remove(self, number: int) -> FaultReport:
        """Take a fault away, and end what it is doing; what it has done.

        Raises UnknownNameError.
        """
        with self._simulation.changing():
            report = self._network.remove_fault(number)
        self._simulation.note(f"faults.remove: {number}")
        return report

    def clear(self) -> None:
        """Take all away."""
        for report in self:
            self.remove(report.number)

    @property
    def acted(self) -> Mapping[FaultKind, int]:
        """How many times faults of each kind have acted, removed ones included."""
        with self._simulation.present():
            return dict(self._network.faults.acted)

    def __getitem__(self, number: int) -> FaultReport:
        for report in self:
            if report.number == number:
                return report
        raise UnknownNameError(f"no fault {number}: known: {[each.number for each in self]}")

    def __iter__(self) -> Iterator[FaultReport]:
        with self._simulation.present():
            return iter(self._network.faults.reports())

    def __len__(self) -> int:
        return len(self._network.faults.reports())


class Simulation(ABC, Generic[Net]):
    """The devices of ``stations`` on ``network``, which belongs to this object from now on.

    Every method raises StateError once the storage has failed.
    """

    _noun: ClassVar[str]
    """What messages call it."""

    def __init__(
        self, network: Net, clock: Clock, storage: Stores, stations: Sequence[Station]
    ) -> None:
        self.clock = clock
        self._network = network
        self._storage = storage
        self._stations = tuple(stations)
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._on_change: Callable[[], None] | None = None
        self._subscribers: list[Subscriber] = []
        self._work_subscribers: list[WorkSubscriber] = []
        self._fault_subscribers: list[FaultSubscriber] = []
        self.faults = LineFaults(self, network)
        self.journal: deque[tuple[Nanos, str, object]] = deque(maxlen=JOURNAL_MAX)
        """When, who and what: done to the devices by hand, and told by them; for a transcript."""
        self._failure: StateError | None = None
        self._wakes = 0
        self._sleepers = 0
        self._is_closed = False
        self.twins: list[AnyTwin] = []
        for index, station in enumerate(self._stations):
            make = handle_class(station.controls)
            twin = make(self, index, station.name, station.model, station.device)
            self.twins.append(cast(AnyTwin, twin))

    # -- time ---------------------------------------------------------------------------------

    @property
    def is_virtual(self) -> bool:
        """Whether time passes only by ``advance`` and by waiting."""
        return self.clock.is_virtual

    @property
    def is_volatile(self) -> bool:
        """Whether the cells are forgotten at the end of the process."""
        return self._storage.is_volatile

    def sync(self) -> Nanos:
        """Do all that is due by the clock's present time; returns that time."""
        now = self.clock.now_ns()
        if now == self._network.settled_ns and self._failure is None:
            return now  # by far the most common, and no reason to wait for another thread
        with self._lock:
            return self._sync()

    def _sync(self) -> Nanos:
        """``sync`` by who has the lock."""
        if self._failure is not None:
            raise self._failure
        now = self._now_ns()
        if now != self._network.settled_ns:
            self._network.run_until(now)
            self._settle()
        return now

    def _now_ns(self) -> Nanos:
        """The clock's present time, which the network may be ahead of."""
        now = self.clock.now_ns()
        if now == self._network.settled_ns:
            return now
        reached = self._network.now_ns
        return now if now > reached else reached

    def _settle(self) -> None:
        """Perform what the network's parts want done, before anything is readable (rules 2, 3)."""
        network = self._network
        if network.has_effects:
            self._perform(network.take_effects())
        if network.faults.has_acts:
            self._tell_acts(network.faults.take_acts())
        if self._note_readable() and not self._storage.is_volatile:
            self.save_moving()

    @abstractmethod
    def _note_readable(self) -> bool:
        """Whether there is more to read than last time."""

    @property
    def is_moving(self) -> bool:
        """Whether an axis moves: ``save_moving`` is then worth calling from time to time."""
        with self._lock:
            now = self._network.now_ns
            return any(station.device.is_moving(now) for station in self._stations)

    @abstractmethod
    def next_event_ns(self) -> Nanos | None:
        """When ``sync`` should be called next; None: not before something changes."""

    def advance(self, duration_ns: Nanos) -> Nanos:
        """Let ``duration_ns`` pass, which takes real time unless it is virtual."""
        return self.advance_to(self.sync() + duration_ns)

    def advance_to(self, until_ns: Nanos) -> Nanos:
        """Let time pass until ``until_ns``; returns the present time, which may be later."""
        while True:
            now = self._pass_time(until_ns)
            if now >= until_ns:
                return now

    @abstractmethod
    def _pass_time(self, until_ns: Nanos) -> Nanos:
        """Let time pass until then at most, whatever can be read; returns the time reached."""

    def _sleep(self, due: Nanos | None) -> None:
        """Wait for ``due``, or for a change."""
        self._sleepers += 1
        try:
            self._changed.wait(None if due is None else self.clock.delay_s(due))
        finally:
            self._sleepers -= 1

    def wake(self) -> None:
        """Make every wait under way return; from any thread."""
        with self._changed:
            self._wakes += 1
            self._changed.notify_all()

    # -- others who take part -----------------------------------------------------------------

    def on_change(self, callback: Callable[[], None] | None) -> None:
        """Call ``callback`` from now on whenever ``next_event_ns`` may have come nearer.

        It is called in the thread that caused the change and must not wait.
        """
        self._on_change = callback

    def subscribe(self, subscriber: Subscriber) -> Callable[[], None]:
        """Give every trace of a device to ``subscriber``; call what is returned to end that."""
        return self._added(self._subscribers, subscriber)

    def subscribe_worked(self, subscriber: WorkSubscriber) -> Callable[[], None]:
        """As ``subscribe``, for every control that is worked, by whatever way.

        It is called with the line locked, before what follows from that is told.
        """
        return self._added(self._work_subscribers, subscriber)

    def subscribe_faults(self, subscriber: FaultSubscriber) -> Callable[[], None]:
        """As ``subscribe``, for what faults of the wire do; it is called with the line locked."""
        return self._added(self._fault_subscribers, subscriber)

    def _tell_acts(self, acts: Sequence[FaultAct]) -> None:
        for act in acts:
            who = f"fault {act.number} ({act.kind})"
            self.journal.append((act.time_ns, who, act.text))
            for subscriber in tuple(self._fault_subscribers):
                subscriber(act)

    def _added(self, subscribers: list[Told], subscriber: Told) -> Callable[[], None]:
        """Add ``subscriber``; what is returned takes it away again."""
        with self._lock:
            subscribers.append(subscriber)

        def unsubscribe() -> None:
            with self._lock:
                subscribers.remove(subscriber)

        return unsubscribe

    def note(self, text: str) -> None:
        """Put what is done by hand, now, into the journal."""
        self.journal.append((self.sync(), HAND, text))

    def tell_worked(self, index: int, name: str, value: Callable[[], Any]) -> None:
        """Tell who looks on that control ``name`` of device ``index`` was worked; its value."""
        with self._lock:
            if not self._work_subscribers:
                return
            worked = ControlWorked(self._network.now_ns, name, value())
            for subscriber in tuple(self._work_subscribers):
                subscriber(self.twins[index], worked)

    # -- what was said ------------------------------------------------------------------------

    @abstractmethod
    def subscribe_messages(self, subscriber: MessageSubscriber) -> Callable[[], None]:
        """Give every message that is complete from now on to ``subscriber``; call what is returned
        to end that.

        It is called in any thread, with the lock, and must not wait.
        """

    @property
    @abstractmethod
    def messages(self) -> list[Message]:
        """The last messages."""

    @abstractmethod
    def explain(self, content: Any) -> str:
        """What bytes of this line, or a frame of this bus, say; empty if nobody knows."""

    def flush_messages(self, *, at_once: bool = False) -> None:
        """Have subscribers told of what is complete now; ``at_once``: also of what may go on."""
        self.sync()

    # -- memory -------------------------------------------------------------------------------

    def save_moving(self) -> None:
        """Save, not durably, what has changed by itself: the positions of axes that move."""
        with self._lock:
            now = self._network.now_ns
            for station in self._stations:
                if station.device.is_moving(now):
                    self._save_changed(station, now, durable=False)

    def close(self) -> None:
        """Save everything and let go of the storage.  Raises StateError if that fails."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            try:
                if self._failure is None:
                    now = self.sync()
                    for station in self._stations:
                        self._save_changed(station, now, durable=True)
            finally:
                self._storage.close()
                if self._failure is None:
                    self._failure = StateError(f"the {self._noun} is closed; build a new one")
            self.wake()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- for the twins ------------------------------------------------------------------------

    @contextmanager
    def present(self) -> Iterator[Nanos]:
        """The network at its present time, which stands still in the block."""
        with self._lock:
            yield self.sync()

    @contextmanager
    def changing(self) -> Iterator[Nanos]:
        """The network at its present time, to be changed from outside by what is in the block."""
        with self._changed:
            yield self.sync()
            self.sync()
            self._tell()

    def act(self, index: int, action: Callable[[Nanos], Sequence[Effect]]) -> Nanos:
        """Have ``action`` do something to device ``index`` now, and perform its effects; when."""
        with self.changing() as now:
            self._network.perform(index, action(now))
            self._save_changed(self._stations[index], now, durable=False)  # a hand moves shafts
        return now

    def set_power(self, index: int, on: bool) -> Nanos:
        """Apply or cut the supply of device ``index`` now; what it kept by itself is on disk.

        Returns when that was.
        """
        with self.changing() as now:
            self.tell_worked(index, POWER.name, lambda: on)
            if on:
                self._network.power_on(index)
            else:
                self._network.power_off(index)
                self._save_changed(self._stations[index], now, durable=False)
        return now

    def _tell(self) -> None:
        """Something new may be due: tell those who wait for time or keep an alarm."""
        if self._sleepers:
            self._changed.notify_all()
        if self._on_change is not None:
            self._on_change()

    def _perform(self, effects: Sequence[tuple[int, Store | Trace]]) -> None:
        for index, effect in effects:
            if isinstance(effect, Store):
                self._save(self._stations[index], dict(effect.cells), durable=effect.durable)
            else:
                self.journal.append((effect.time_ns, self._stations[index].name, effect))
                for subscriber in tuple(self._subscribers):
                    subscriber(self.twins[index], effect)

    def _save_changed(self, station: Station, now: Nanos, *, durable: bool) -> None:
        saved = station.slot.cells
        cells = station.device.cells(now)
        changed = {name: value for name, value in cells.items() if saved.get(name) != value}
        if changed or durable:
            self._save(station, changed, durable=durable)

    def _save(self, station: Station, cells: Mapping[str, int], *, durable: bool) -> None:
        try:
            station.slot.save(cells, durable=durable)
        except StateError as error:
            self._failure = error
            raise


def earliest(first: Nanos | None, second: Nanos | None) -> Nanos | None:
    """The earlier of two times that may never come."""
    if first is None or second is None:
        return first if second is None else second
    return min(first, second)
