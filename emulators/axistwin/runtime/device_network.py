"""What a line and a bus of devices have in common: who is woken, and what is left to the shell."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import Generic, TypeVar

from axistwin.devices.base import Device
from axistwin.kernel.effects import Effect, Store, Trace
from axistwin.kernel.schedule import Schedule
from axistwin.kernel.time import Nanos

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


class DeviceNetwork(ABC, Generic[DeviceT]):
    """``devices`` (one at least) and what connects them.  Pure: the shell says how late it is.

    ``settled_ns``: the time at which nothing is left to be done, until something else is done.
    """

    def __init__(self, devices: Sequence[DeviceT], start_ns: Nanos) -> None:
        assert devices, "a network has at least one device"
        self.devices = tuple(devices)
        self.settled_ns: Nanos | None = None
        self._effects: list[tuple[int, Store | Trace]] = []
        parts = [_ScheduledDevice(each, at, self.apply) for at, each in enumerate(self.devices)]
        self._schedule = Schedule(parts, start_ns)

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
