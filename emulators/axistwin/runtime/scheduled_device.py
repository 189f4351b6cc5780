"""A device as a part of its network's schedule."""

from collections.abc import Callable, Sequence

from axistwin.devices.base import Device
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos


class ScheduledDevice:
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
