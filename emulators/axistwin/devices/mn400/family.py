"""MN400 step and direction controllers, on their serial port and on USB."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from axistwin.devices.family import DeviceOptions, Family, Model, UsbIdentity

if TYPE_CHECKING:
    from axistwin.devices.controls import AxisReadout, ControlTable
    from axistwin.devices.mn400.device import Mn400Board
    from axistwin.devices.switches import Quirk


class Mn400Family(Family):
    """Packets, motions of four axes, and two stored programs."""

    unit_named = r"\bboard (\d+)"
    usb = UsbIdentity(0x0461, 0x0020, 64, "MN400")  # MN4-USB-01

    def quirks(self) -> "Mapping[str, Quirk]":
        """Those of every board."""
        from axistwin.devices.mn400.quirks import QUIRKS

        return QUIRKS

    def make(self, model: str, address: int, options: DeviceOptions) -> "Mn400Board":
        """A board that is at ``address`` when it has started."""
        from axistwin.devices.mn400.device import Mn400Board
        from axistwin.devices.mn400.quirks import parse_quirks

        return Mn400Board(
            address,
            quirks=parse_quirks(options.quirks),
            cells=options.cells,
            skew_ns=options.skew_ns,
            alone=options.alone,
        )

    def controls(self) -> "ControlTable":
        """Inputs, panel, outputs, pulses, USB."""
        from axistwin.devices.mn400.controls import MN400

        return MN400

    def axis_readout(self) -> "AxisReadout":
        """Four counters."""
        from axistwin.devices.mn400.controls import AXES

        return AXES

    def explain(self, data: bytes) -> str:
        """Packets in words."""
        from axistwin.devices.mn400.link.decode import explain

        return explain(data)

    def compose(self, text: str, address: int) -> bytes:
        """A packet."""
        from axistwin.devices.mn400.link.decode import compose

        return compose(text, address)

    def completed(self, data: bytes) -> bytes:
        """A packet with its sum."""
        from axistwin.devices.mn400.link.packets import completed

        return completed(data)


MODELS: Final = (
    Model(
        "mn400",
        "MN400 four-axis step and direction controller",
        Mn400Family(),
        addresses=range(1, 128),
        default_address=1,
        default_baud=9600,
        bauds=(9600, 19200, 38400, 57600, 115200),
    ),
)
