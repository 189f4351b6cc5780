"""What a line and a bus of devices have in common: who is woken, and what is left to the shell."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Generic, TypeVar

from axistwin.devices.base import Device
from axistwin.kernel.effects import Effect, Store, Trace
from axistwin.kernel.schedule import Schedule
from axistwin.kernel.time import Nanos
from axistwin.wire.faults import Disturbance, FaultReport, WireFaults
from axistwin.wire.wire_fault import WireFault

DeviceT = TypeVar("DeviceT", bound=Device)


class _ScheduledDevice:
    """Wakes device ``index`` of a network and has ``apply`` perform its effects."""

    __slots__ = ("_apply", "_device", "_index", "next_event")

    def __init__(
        self, device: Device, index: int, apply: Callable[[int, Sequence[Effect]], None]
    ) -> None:
        self._device = device
        self._index = index
        self._apply = apply
        self.next_event = device.next_event

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``."""
        self._apply(self._index, self._device.wake(now))


class _ScheduledFaults:
    """Wakes ``network`` for what the faults of its wire do by themselves."""

    __slots__ = ("_network",)

    def __init__(self, network: "DeviceNetwork[Any]") -> None:
        self._network = network

    def next_event(self) -> Nanos | None:
        """When one is due."""
        return self._network.next_disturbance()

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``."""
        self._network.disturb(now)


class DeviceNetwork(ABC, Generic[DeviceT]):
    """``devices`` and what connects them.  Pure: the shell says how late it is.

    ``faults``: those of the wire; ``add_fault`` and ``remove_fault`` change them.
    ``settled_ns``: the time at which nothing is left to be done, until something else is done.
    """

    def __init__(self, devices: Sequence[DeviceT], start_ns: Nanos, faults: WireFaults) -> None:
        self.devices = tuple(devices)
        self.faults = faults
        self.settled_ns: Nanos | None = None
        self._effects: list[tuple[int, Store | Trace]] = []
        parts = [_ScheduledDevice(each, at, self.apply) for at, each in enumerate(self.devices)]
        self._schedule = Schedule([*parts, _ScheduledFaults(self)], start_ns)

    @property
    def now_ns(self) -> Nanos:
        """The time up to which everything has happened."""
        return self._schedule.now

    @abstractmethod
    def run_until(self, now: Nanos) -> None:
        """Let everything happen that is due by ``now``, then stand at ``now``."""

    @abstractmethod
    def apply(self, index: int, effects: Iterable[Effect]) -> None:
        """Put ``effects`` on the wire or in the queue; the caller sees to the next event."""

    def perform(self, index: int, effects: Iterable[Effect]) -> None:
        """Perform the effects of a method of device ``index`` called from outside at ``now_ns``."""
        self.apply(index, effects)
        self._schedule.touch(index)

    @property
    def has_effects(self) -> bool:
        """Whether there is something to take."""
        return bool(self._effects)

    def take_effects(self) -> list[tuple[int, Store | Trace]]:
        """The stores and traces since last time with their device's index, in order."""
        effects, self._effects = self._effects, []
        return effects

    def power_off(self, index: int) -> None:
        """Cut the supply of device ``index`` now; what it is sending breaks off."""
        self._switch(index, on=False)
        self.perform(index, self.devices[index].power_off(self.now_ns))

    def power_on(self, index: int) -> None:
        """Supply device ``index`` from now on."""
        self._switch(index, on=True)
        self.perform(index, self.devices[index].power_on(self.now_ns))

    @abstractmethod
    def _switch(self, index: int, *, on: bool) -> None:
        """Have what drives the wire for device ``index`` take part, or not."""

    # -- what goes wrong on the wire --

    def add_fault(self, fault: WireFault) -> int:
        """Have ``fault`` act from now on; its number.  Raises UsageError."""
        number = self.faults.add(fault, self.now_ns)
        self._touch_faults()
        return number

    def remove_fault(self, number: int) -> FaultReport:
        """Take the fault with that number away.  Raises UnknownNameError."""
        report = self.faults.remove(number)
        self._touch_faults()
        return report

    def _touch_faults(self) -> None:
        self.settled_ns = None
        self._schedule.touch(len(self.devices))

    def next_disturbance(self) -> Nanos | None:
        """When something is next due that comes of no device."""
        return self.faults.next_event()

    def disturb(self, now: Nanos) -> None:
        """Do to the wire what comes of no device, and is due ``now``."""
        for disturbance in self.faults.take_due(now):
            self._disturb(disturbance)

    @abstractmethod
    def _disturb(self, disturbance: Disturbance) -> None:
        """Do to the wire what a fault wants now."""
