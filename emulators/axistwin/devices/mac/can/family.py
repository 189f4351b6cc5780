"""The MAC23 motor with controller, on a CAN bus."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Final

from axistwin.devices.family import Carrier, DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import ControlTable
    from axistwin.devices.mac.can.device import MacCan
    from axistwin.devices.switches import Quirk
    from axistwin.wire.can_frame import CanFrame


class MacCanFamily(Family):
    """SDO requests over the axis core."""

    carrier: ClassVar[Carrier] = "can"

    def quirks(self) -> "Mapping[str, Quirk]":
        """Those of the axis and of the bus."""
        from axistwin.devices.mac.can.quirks import CAN_QUIRKS

        return CAN_QUIRKS

    def make(self, model: str, address: int, options: DeviceOptions) -> "MacCan":
        """A module."""
        from axistwin.devices.mac.can.device import MacCan
        from axistwin.devices.mac.can.quirks import parse_can_quirks

        quirks = parse_can_quirks(options.quirks)
        return MacCan(address, quirks=quirks, cells=options.cells, skew_ns=options.skew_ns)

    def controls(self) -> "ControlTable":
        """Those of every MAC module."""
        from axistwin.devices.mac.controls import MAC

        return MAC

    def explain(self, data: "CanFrame") -> str:
        """A frame in words."""
        from axistwin.devices.mac.can.decode import explain_frame

        return explain_frame(data)


MODELS: Final = (
    Model(
        "mac23-can",
        "MAC23 motor with controller, 2000 increments per turn, on a CAN bus",
        MacCanFamily(),
        addresses=range(1, 0x80),
        default_address=1,
        default_baud=125_000,
    ),
)
