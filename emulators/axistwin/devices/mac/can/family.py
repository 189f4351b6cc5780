"""The MAC23 motor with controller, on a CAN bus."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Final

from axistwin.devices.family import Carrier, DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import AxisReadout, ControlTable
    from axistwin.devices.mac.can.device import MacCan
    from axistwin.devices.switches import Quirk
    from axistwin.wire.can_frame import CanFrame


class MacCanFamily(Family):
    """SDO requests over the axis core."""

    carrier: ClassVar[Carrier] = "can"
    unit_named = r"\bmodule (\d+)"

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

    def axis_readout(self) -> "AxisReadout":
        """The counter."""
        from axistwin.devices.mac.controls import AXIS

        return AXIS

    def explain(self, data: "CanFrame") -> str:
        """A frame in words."""
        from axistwin.devices.mac.can.decode import explain_frame

        return explain_frame(data)

    def compose(self, text: str, address: int) -> "CanFrame":
        """A request."""
        from axistwin.devices.mac.axis.acceptance import SERIAL_ONLY
        from axistwin.devices.mac.can.device import (
            DOWNLOAD,
            INDEX_HIGH,
            QUERIES,
            REQUEST,
            UPLOAD,
        )
        from axistwin.devices.mac.phrases import GENERAL, parse_phrase
        from axistwin.errors import UsageError
        from axistwin.wire.can_frame import CanFrame

        asked = parse_phrase(text)
        if asked.command in SERIAL_ONLY:
            raise UsageError(f"{text!r}: {asked.command:02X}h is for modules on a serial line")
        to = address if asked.address is None else asked.address % GENERAL
        is_query = asked.command >= QUERIES
        head = bytes((UPLOAD, asked.command - QUERIES) if is_query else (DOWNLOAD, asked.command))
        data = head + bytes((INDEX_HIGH, asked.sub_index)) + asked.parameters.to_bytes(4, "big")
        return CanFrame(REQUEST + to, data)

    def is_reply(self, request: "CanFrame", frame: "CanFrame") -> bool:
        """A reply of the module that was asked, or to the procedure for addresses."""
        from axistwin.devices.mac.can.device import LMT_REPLY, LMT_REQUEST, REPLY, REQUEST

        if request.identifier == LMT_REQUEST:
            return frame.identifier == LMT_REPLY
        return frame.identifier - REPLY == request.identifier - REQUEST

    def is_from_device(self, frame: "CanFrame") -> bool:
        """By its identifier."""
        from axistwin.devices.mac.can.device import BOOT_UP, EMERGENCY, LMT_REPLY, REPLY

        if frame.identifier == LMT_REPLY:
            return True
        address = frame.identifier & 0x7F
        return bool(address) and frame.identifier - address in (REPLY, BOOT_UP, EMERGENCY)


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
