"""MAC23 and MAC34 motors with controller, on a serial line."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from axistwin.devices.family import DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import AxisReadout, ControlTable
    from axistwin.devices.mac.serial.device import MacSerial
    from axistwin.devices.switches import Quirk


class MacSerialFamily(Family):
    """Expert frames over the axis core; ``model``: whose units bytes are told in, if one's."""

    unit_named = r"\bmodule (\d+)"

    def __init__(self, model: str = "") -> None:
        self._model = model

    def of_any_model(self) -> "MacSerialFamily":
        """The same without units."""
        return MacSerialFamily()

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

    def axis_readout(self) -> "AxisReadout":
        """The counter."""
        from axistwin.devices.mac.controls import AXIS

        return AXIS

    def explain(self, data: bytes) -> str:
        """Frames and replies in words."""
        from axistwin.devices.mac.axis.models import MODELS
        from axistwin.devices.mac.serial.decode import explain

        return explain(data, MODELS.get(self._model))

    def compose(self, text: str, address: int) -> bytes:
        """A request."""
        from axistwin.devices.mac.phrases import parse_phrase
        from axistwin.devices.mac.serial.framing import request

        asked = parse_phrase(text)
        to = address if asked.address is None else asked.address
        return request(to, asked.command, asked.parameters, asked.sub_index)

    def is_whole(self, reply: bytes) -> bool:
        """True for a Nack, an acknowledgement, and an acknowledgement with its answer."""
        from axistwin.devices.mac.serial.framing import is_whole_reply

        return is_whole_reply(reply)

    def completed(self, data: bytes) -> bytes:
        """A request with sum and Etx."""
        from axistwin.devices.mac.serial.framing import completed

        return completed(data)


_DESCRIPTIONS: Final = {
    "mac23": "MAC23 motor with controller, 2000 increments per turn",
    "mac34-1": "MAC34 motor with controller, 10000 increments per turn, to 102 V",
    "mac34-2": "MAC34 motor with controller, 10000 increments per turn, to 204 V",
}

MODELS: Final = tuple(
    Model(
        name,
        description,
        MacSerialFamily(name),
        addresses=range(0x80),
        default_address=0,
        default_baud=38400,
        bauds=(9600, 19200, 38400),
    )
    for name, description in _DESCRIPTIONS.items()
)
