"""MAC23 and MAC34 motors with controller, on a serial line."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from axistwin.devices.family import DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import ControlTable
    from axistwin.devices.mac.serial.device import MacSerial
    from axistwin.devices.switches import Quirk


class MacSerialFamily(Family):
    """Expert frames over the axis core."""

    def quirks(self) -> "Mapping[str, Quirk]":
        """Those of the axis and of expert frames."""
        from axistwin.devices.mac.axis.quirks import QUIRKS

        return QUIRKS

    def make(self, model: str, address: int, options: DeviceOptions) -> "MacSerial":
        """A module."""
        from axistwin.devices.mac.axis.quirks import parse_quirks
        from axistwin.devices.mac.serial.device import MacSerial

        return MacSerial(
            model,
            address,
            quirks=parse_quirks(options.quirks),
            cells=options.cells,
            skew_ns=options.skew_ns,
            alone=options.alone,
        )

    def controls(self) -> "ControlTable":
        """Those of every MAC module."""
        from axistwin.devices.mac.controls import MAC

        return MAC

    def explain(self, data: bytes) -> str:
        """Frames and replies in words."""
        from axistwin.devices.mac.serial.decode import explain

        return explain(data)


_DESCRIPTIONS: Final = {
    "mac23": "MAC23 motor with controller, 2000 increments per turn",
    "mac34-1": "MAC34 motor with controller, 10000 increments per turn, to 102 V",
    "mac34-2": "MAC34 motor with controller, 10000 increments per turn, to 204 V",
}

MODELS: Final = tuple(
    Model(
        name,
        f"{description}, serial expert frames",
        MacSerialFamily(),
        addresses=range(0x80),
        default_address=0,
        default_baud=38400,
        bauds=(9600, 19200, 38400),
    )
    for name, description in _DESCRIPTIONS.items()
)
