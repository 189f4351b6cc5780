"""The host's end of a line or bus of twins in virtual time."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from axistwin import catalog
from axistwin.devices.family import Model, Value
from axistwin.errors import UsageError
from axistwin.kernel.time import Nanos
from axistwin.runtime.bus import Bus
from axistwin.runtime.clock import VirtualClock
from axistwin.runtime.line import Line
from axistwin.wire.can_frame import CanFrame

_TRUTHS: Final = {"on": True, "true": True, "off": False, "false": False}


@dataclass(frozen=True, slots=True)
class TwinSetup:
    """Which twin gets the messages.  controls: their values before, by name."""

    model: Model
    address: int
    quirks: Mapping[str, Value]
    controls: Mapping[str, Any] = field(default_factory=dict)

    def open(self) -> HostPort:
        """A new twin, with its controls set, whose ``simulation`` is to be closed.

        Raises UsageError.
        """
        port = (_BusPort if self.model.carrier == "can" else _LinePort)(self)
        try:
            for name, value in self.controls.items():
                port.simulation.twins[0].controls[name].set(value)
        except BaseException:
            port.simulation.close()
            raise
        return port


class HostPort(ABC):
    """The host's end of a line or bus with one twin."""

    simulation: Line | Bus

    @abstractmethod
    def send(self, content: Any) -> None:
        """Send it."""

    @abstractmethod
    def listen(self, until_ns: Nanos) -> Nanos:
        """Let time pass until then, or until something has come; the present time."""

    @abstractmethod
    def received(self) -> list[Any]:
        """What has come since last time."""

    def joined(self, parts: list[Any]) -> list[Any]:
        """The pieces of a reply put together."""
        return parts

    @abstractmethod
    def is_complete(self, content: Any, reply: list[Any]) -> bool:
        """Whether ``reply`` answers ``content`` in full; False where only silence shows that."""


class _LinePort(HostPort):
    """Bytes; the host follows the rate of the twin."""

    def __init__(self, setup: TwinSetup) -> None:
        spec = catalog.DeviceSpec(setup.model.name, setup.address)
        self._family = setup.model.family
        self._line = catalog.build_line([spec], quirks=setup.quirks, clock=VirtualClock())
        self.simulation = self._line

    def send(self, content: bytes) -> None:
        """Send it at the rate of the twin."""
        self._line.host_format = self._line.device_format
        self._line.send(content)

    def listen(self, until_ns: Nanos) -> Nanos:
        """Until there is a byte."""
        return self._line.wait(until_ns)

    def received(self) -> list[bytes]:
        """All bytes that have come."""
        data = self._line.receive()
        return [data] if data else []

    def joined(self, parts: list[bytes]) -> list[bytes]:
        """Bytes of one reply are one."""
        return [b"".join(parts)] if parts else []

    def is_complete(self, content: bytes, reply: list[bytes]) -> bool:
        """As the family knows it."""
        return self._family.is_whole(b"".join(reply))


class _BusPort(HostPort):
    """Frames."""

    def __init__(self, setup: TwinSetup) -> None:
        spec = catalog.DeviceSpec(setup.model.name, setup.address)
        self._family = setup.model.family
        self._bus = catalog.build_bus([spec], quirks=setup.quirks, clock=VirtualClock())
        self.simulation = self._bus
        self._port = self._bus.attach()

    def send(self, content: CanFrame) -> None:
        """Queue it."""
        self._bus.send(self._port, content)

    def listen(self, until_ns: Nanos) -> Nanos:
        """Until there is a frame."""
        return self._bus.wait(until_ns, self._port)

    def received(self) -> list[CanFrame]:
        """The frames."""
        return [arrival.frame for arrival in self._bus.receive(self._port)]

    def is_complete(self, content: CanFrame, reply: list[CanFrame]) -> bool:
        """One frame that answers it."""
        return any(self._family.is_reply(content, frame) for frame in reply)


def parse_control(text: str) -> tuple[str, Any]:
    """A control and its value.  Raises UsageError."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not name or not equals:
        raise UsageError(f"--set {text!r}: write NAME=VALUE, such as spindle_hz=1000")
    if value.lower() in _TRUTHS:
        return name, _TRUTHS[value.lower()]
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return name, kind(value)
    return name, value
