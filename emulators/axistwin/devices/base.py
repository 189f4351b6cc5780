"""What every device offers to whoever drives it: on a serial line, on a CAN bus.

The driver calls with the time; the device returns effects and says when it wants to be woken.
Calls arrive in the order of time.  A device never looks at anything but its arguments.
"""

from collections import deque
from collections.abc import Container, Mapping
from typing import TYPE_CHECKING, Any, Protocol, Self

from axistwin.devices.snapshot import Snapshot
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos
from axistwin.wire.framing import Chunk, LineFormat

if TYPE_CHECKING:
    from axistwin.wire.can_frame import CanFrame


class Device(Protocol):
    """What is told the time, can be switched off, and remembers."""

    def next_event(self) -> Nanos | None:
        """When the device next wants ``wake``, or None."""

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply: everything volatile is gone, nothing more is sent or heard."""

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply: start up from the nonvolatile cells."""

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells with their values at ``now`` (a moving axis' position included)."""

    def is_moving(self, now: Nanos) -> bool:
        """Whether cells change by themselves as time passes (the axis moves)."""


class Reception(Protocol):
    """What devices that have heard the same have of a message that is not complete."""

    def is_like(self, other: Any) -> bool:
        """Whether whoever has this is where those are who have ``other``."""

    def copy(self) -> Self:
        """The same, apart."""

    def quiet_prefix(self, data: bytes, addresses: Container[int]) -> int:
        """How many leading bytes of ``data`` complete no message that concerns ``addresses``."""

    def addressed(self, data: bytes, at_address: Mapping[int, list[int]]) -> list[int]:
        """Whom the last byte of ``data`` concerns, of those at their addresses."""

    def hear(self, data: bytes) -> None:
        """Take ``data``, which concerns nobody who shares this."""


class SharedListener(Protocol):
    """The part of a device that may share with others what all of them have heard."""

    reception: Any
    """A ``Reception`` of its family's own."""

    def heeded_address(self, now: Nanos) -> int | None:
        """The address of the messages that concern it; None: it cannot be told so simply now."""


class SerialDevice(Device, Protocol):
    """A device with a UART.

    What it may have beside (both are looked at once, by ``getattr``): ``listener``, a
    ``SharedListener``, saves asking it about messages for others; ``drops_bad_characters``, if
    true, tells that a character with a bad stop bit is as if it had never been.
    """

    @property
    def line_format(self) -> LineFormat:
        """Rate and framing that the UART uses now, in both directions."""

    @property
    def is_full_duplex(self) -> bool:
        """Whether each direction has wires of its own, so that both ends may send at a time."""

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` surely cause no effect, whatever follows.

        Lets the line hand over long stretches at once: the device will not react before the byte
        after that prefix.  0 is always a correct answer.
        """

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; byte i counts as heard at ``chunk.arrival_ns(i)``.

        At most the last byte of a chunk causes effects (the line keeps to ``quiet_prefix``).  A bad
        character comes alone, and only to who does not drop it.
        """


class UsbDevice(Protocol):
    """The part of a serial device that is a HID device on USB as well.

    reports: the IN reports that its host has not taken, oldest first.  A ``ReportReady`` tells of
    each one.
    """

    reports: deque[bytes]

    def receive_report(self, now: Nanos, data: bytes) -> list[Effect]:
        """Take an OUT report."""


class CanDevice(Device, Protocol):
    """A device with a CAN controller."""

    def accepts(self, frame: "CanFrame") -> bool:
        """Whether ``frame`` may have an effect here; False spares the call of ``receive``."""

    def receive(self, frame: "CanFrame", end_ns: Nanos) -> list[Effect]:
        """Take a frame of another station, complete at ``end_ns``."""

    def sent(self, frame: "CanFrame", end_ns: Nanos) -> list[Effect]:
        """Learn that ``frame``, a ``SendFrame`` of this device, was on the bus until ``end_ns``."""


class TwinDevice(Device, Protocol):
    """What a user can have a handle on; its family's table of controls names the rest of it."""

    def describe(self, now: Nanos) -> Snapshot:
        """Everything worth showing; at least ``address`` and ``state_text``."""
