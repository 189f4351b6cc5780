"""The families of devices: their models, and how each is made when it is asked for.

A new family registers here, with one ``Family`` and its models.  Its modules are imported when a
model of it is used, not before: listing the models costs nothing.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, Protocol, TypeAlias

from axistwin.devices.base import (
    ControllerSerialDevice,
    MotionCanDevice,
    MotionSerialDevice,
    TwinDevice,
)
from axistwin.kernel.time import Nanos
from axistwin.runtime.twin import ControllerTwin, MotionTwin, Twin
from axistwin.wire.can_frame import CanFrame

Value: TypeAlias = str | int | bool
"""A quirk's value: text as on a command line, or what TOML makes of it."""

Carrier: TypeAlias = Literal["serial", "can"]
"""What a device is reached over."""

DEFAULT_BITRATE = 125_000
"""Of a bus, bits per second."""


class Quirk(Protocol):
    """One switch: a point that the manuals leave open, with its readings, default first."""

    @property
    def name(self) -> str:
        """As in ``--quirk NAME=VALUE``."""

    @property
    def source(self) -> str:
        """ID in the requirement ledger."""

    @property
    def doc(self) -> str:
        """The meaning, in one line."""

    @property
    def allowed(self) -> tuple[str, ...]:
        """The values, or one text that describes a range."""

    @property
    def default(self) -> str:
        """As a user would write it."""

    def parse(self, value: Value) -> Value:
        """The setting that ``value`` means.  Raises UsageError."""


class _Maker(Protocol):
    """Builds a device of a family: model, address, quirks by name, cells, skew."""

    def __call__(
        self,
        model: str,
        address: int,
        *,
        quirks: Mapping[str, Value],
        cells: Mapping[str, int],
        skew_ns: Nanos,
        alone: bool,
    ) -> TwinDevice: ...


@dataclass(frozen=True, slots=True)
class Family:
    """What the models of a family share, each loaded when it is asked for.

    make: of a ``SerialDevice`` or ``CanDevice``, as ``carrier`` says.
    handle: what a user works a device with, as its kind wants.
    explain: bytes of a serial line, or a ``CanFrame``, in words.
    """

    quirks: Callable[[], Mapping[str, Quirk]]
    make: _Maker
    explain: Callable[[Any], str]
    carrier: Carrier = "serial"
    handle: type[Twin] = MotionTwin


@dataclass(frozen=True, slots=True)
class Model:
    """One kind of device.

    default_baud: the rate it leaves the factory with; on a bus, the one that is used unless another
    is given.  bauds: those that the device itself can be set to, bits per second; none on a bus.
    """

    name: str
    description: str
    addresses: range
    default_address: int
    default_baud: int
    bauds: tuple[int, ...]
    family: Family

    @property
    def quirks(self) -> Mapping[str, Quirk]:
        """All switches by name."""
        return self.family.quirks()

    @property
    def carrier(self) -> Carrier:
        """What it is reached over."""
        return self.family.carrier

    @property
    def has_program(self) -> bool:
        """Whether a user's program runs in it."""
        return issubclass(self.family.handle, ControllerTwin)

    def make(
        self,
        address: int,
        *,
        quirks: Mapping[str, Value] | None = None,
        cells: Mapping[str, int] | None = None,
        skew_ns: Nanos = 0,
        alone: bool = True,
    ) -> TwinDevice:
        """A device at ``address``, with ``cells`` in place of what the factory stored.

        skew_ns: how much later than its siblings it answers.  alone: no other is on its line.
        Raises UsageError for bad quirks.
        """
        return self.family.make(
            self.name,
            address,
            quirks=quirks or {},
            cells=cells or {},
            skew_ns=skew_ns,
            alone=alone,
        )

    def explain(self, data: bytes | CanFrame) -> str:
        """The frames in ``data``, of either direction, in words; on a bus, the frame ``data``."""
        return self.family.explain(data)


@cache
def _mac_quirks() -> Mapping[str, Quirk]:
    from axistwin.devices.mac.axis.quirks import QUIRKS

    return QUIRKS


def _make_mac(
    model: str,
    address: int,
    *,
    quirks: Mapping[str, Value],
    cells: Mapping[str, int],
    skew_ns: Nanos,
    alone: bool,
) -> MotionSerialDevice:
    from axistwin.devices.mac.axis.quirks import parse_quirks
    from axistwin.devices.mac.serial.device import MacSerial

    settings = parse_quirks(quirks)
    return MacSerial(model, address, quirks=settings, cells=cells, skew_ns=skew_ns, alone=alone)


def _explain_mac(data: bytes) -> str:
    from axistwin.devices.mac.serial.decode import explain

    return explain(data)


@cache
def _mac_can_quirks() -> Mapping[str, Quirk]:
    from axistwin.devices.mac.can.quirks import CAN_QUIRKS

    return CAN_QUIRKS


def _make_mac_can(
    model: str,
    address: int,
    *,
    quirks: Mapping[str, Value],
    cells: Mapping[str, int],
    skew_ns: Nanos,
    alone: bool,
) -> MotionCanDevice:
    from axistwin.devices.mac.can.device import MacCan
    from axistwin.devices.mac.can.quirks import parse_can_quirks

    return MacCan(address, quirks=parse_can_quirks(quirks), cells=cells, skew_ns=skew_ns)


def _explain_mac_can(frame: CanFrame) -> str:
    from axistwin.devices.mac.can.decode import explain_frame

    return explain_frame(frame)


@cache
def _msc_quirks() -> Mapping[str, Quirk]:
    from axistwin.devices.msc.quirks import QUIRKS

    return QUIRKS


def _make_msc(
    model: str,
    address: int,
    *,
    quirks: Mapping[str, Value],
    cells: Mapping[str, int],
    skew_ns: Nanos,
    alone: bool,
) -> ControllerSerialDevice:
    from axistwin.devices.msc.controller import MscController
    from axistwin.devices.msc.quirks import parse_quirks

    settings = parse_quirks(quirks)
    return MscController(model, address, quirks=settings, cells=cells, skew_ns=skew_ns, alone=alone)


def _explain_msc(data: bytes) -> str:
    from axistwin.devices.msc.decode import explain

    return explain(data)


_MAC = Family(_mac_quirks, _make_mac, _explain_mac)
_MAC_CAN = Family(_mac_can_quirks, _make_mac_can, _explain_mac_can, carrier="can")
_MSC = Family(_msc_quirks, _make_msc, _explain_msc, handle=ControllerTwin)


def _mac(name: str, description: str) -> Model:
    return Model(
        name,
        f"{description}, serial expert frames",
        addresses=range(0x80),
        default_address=0,
        default_baud=38400,
        bauds=(9600, 19200, 38400),
        family=_MAC,
    )


def _msc(name: str, description: str) -> Model:
    return Model(
        name,
        f"{description}, executive port",
        addresses=range(1, 16),
        default_address=1,
        default_baud=9600,
        bauds=(9600,),
        family=_MSC,
    )


MODELS: dict[str, Model] = {
    model.name: model
    for model in (
        _mac("mac23", "MAC23 motor with controller, 2000 increments per turn"),
        _mac("mac34-1", "MAC34 motor with controller, 10000 increments per turn, to 102 V"),
        _mac("mac34-2", "MAC34 motor with controller, 10000 increments per turn, to 204 V"),
        Model(
            "mac23-can",
            "MAC23 motor with controller, 2000 increments per turn, on a CAN bus",
            addresses=range(1, 0x80),
            default_address=1,
            default_baud=DEFAULT_BITRATE,
            bauds=(),
            family=_MAC_CAN,
        ),
        _msc("msc-250", "MSC-250 motion system controller"),
        _msc("msc-850-32", "MSC-850/32 motion system controller"),
        _msc("msc-850", "MSC-850 motion system controller, without RFLAGS"),
        _msc("msc-generic", "any other MSC motion system controller, without RFLAGS"),
    )
}
"""All models by name."""
