"""What a family of devices declares of itself, in its ``family.py``.

The catalog imports every ``family.py`` to list the models, and takes ``MODELS`` from it.  Whatever
else belongs to the family is imported in the methods below: listing the models loads no device.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeAlias

from axistwin.errors import UsageError
from axistwin.kernel.time import Nanos

if TYPE_CHECKING:
    from axistwin.devices.base import TwinDevice
    from axistwin.devices.controls import AxisReadout, ControlTable
    from axistwin.devices.switches import Quirk
    from axistwin.wire.can_frame import CanFrame

Value: TypeAlias = str | int | bool
"""A quirk's value: text as on a command line, or what TOML makes of it."""

Carrier: TypeAlias = Literal["serial", "can"]
"""What a device is reached over."""


@dataclass(frozen=True, slots=True)
class DeviceOptions:
    """How a device is made.

    quirks: by name.  cells: what it has stored, in place of what the factory stored.
    skew_ns: how much later than its siblings it answers.  alone: no other is on its line.
    """

    quirks: Mapping[str, Value] = field(default_factory=dict)
    cells: Mapping[str, int] = field(default_factory=dict)
    skew_ns: Nanos = 0
    alone: bool = True


class UsbIdentity(NamedTuple):
    """How a device shows itself on USB: a HID device with one unnumbered report each way.

    report_bytes: of either report.  product_name: its string descriptor.
    """

    vendor_id: int
    product_id: int
    report_bytes: int
    product_name: str


class Family(ABC):
    """What the models of a family share."""

    carrier: ClassVar[Carrier] = "serial"
    """Whether ``make`` gives a ``SerialDevice`` or a ``CanDevice``."""

    unit_named: ClassVar[str] = r"\bunit (\d+)"
    """Finds, as group 1, the address of a unit in what ``explain`` says."""

    usb: ClassVar[UsbIdentity | None] = None
    """Given if what ``make`` gives is a ``UsbDevice`` too."""

    @abstractmethod
    def quirks(self) -> "Mapping[str, Quirk]":
        """All switches by name."""

    @abstractmethod
    def make(self, model: str, address: int, options: DeviceOptions) -> "TwinDevice":
        """A device of ``model`` at ``address``.  Raises UsageError for bad quirks."""

    @abstractmethod
    def controls(self) -> "ControlTable":
        """What can be worked and seen of its devices."""

    def axis_readout(self) -> "AxisReadout | None":
        """How the motion of its devices is followed; None: they have no axes."""
        return None

    def of_any_model(self) -> "Family":
        """What explains bytes of a line with several of its models."""
        return self

    @abstractmethod
    def explain(self, data: Any) -> str:
        """Bytes of a serial line in either direction, or a ``CanFrame``, in words."""

    def compose(self, text: str, address: int) -> Any:
        """What ``text`` asks the device at ``address`` for, as ``explain`` takes it.

        Raises UsageError, by default for everything.
        """
        raise UsageError(f"{text!r}: this model has no words yet; write bytes in hex")

    def is_reply(self, request: Any, frame: Any) -> bool:
        """Whether ``frame``, heard on a bus behind ``request``, answers it."""
        return True

    def is_from_device(self, frame: Any) -> bool:
        """Whether devices send such a ``frame``, and hosts do not."""
        return False

    def completed(self, data: bytes) -> bytes:
        """A request with the checksum that it lacks; anything else as it is."""
        return data

    def acknowledgement(self, reply: bytes) -> bytes:
        """What a host says to ``reply``; empty for nothing, or while more of it is to come."""
        return b""

    def is_whole(self, reply: bytes) -> bool:
        """Whether nothing more belongs to ``reply``; False also where nobody can tell."""
        return False


@dataclass(frozen=True, slots=True)
class Model:
    """One kind of device.

    default_baud: the rate it leaves the factory with; on a bus, the one that is used unless another
    is given.  bauds: those that the device itself can be set to, bits per second; none on a bus.
    """

    name: str
    description: str
    family: Family
    addresses: range
    default_address: int
    default_baud: int
    bauds: tuple[int, ...] = ()

    @property
    def quirks(self) -> "Mapping[str, Quirk]":
        """All switches by name."""
        return self.family.quirks()

    @property
    def carrier(self) -> Carrier:
        """What it is reached over."""
        return self.family.carrier

    @property
    def usb(self) -> UsbIdentity | None:
        """What it is on USB; None: it has none."""
        return self.family.usb

    def make(self, address: int, options: DeviceOptions | None = None) -> "TwinDevice":
        """A device at ``address``.  Raises UsageError for bad quirks."""
        return self.family.make(self.name, address, options or DeviceOptions())

    def explain(self, data: "bytes | CanFrame") -> str:
        """The frames in ``data``, of either direction, in words; on a bus, the frame ``data``."""
        return self.family.explain(data)
