"""The lamp's model, and how it is made."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from axistwin.devices.family import DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import ControlTable
    from axistwin.devices.switches import Quirk

    from .device import Lamp


class ToyFamily(Family):
    """Lines of text on a serial line."""

    def quirks(self) -> "Mapping[str, Quirk]":
        """Two."""
        from .device import QUIRKS

        return QUIRKS

    def make(self, model: str, address: int, options: DeviceOptions) -> "Lamp":
        """A lamp."""
        from axistwin.devices.switches import parse_settings

        from .device import QUIRKS, Lamp, LampQuirks

        quirks = parse_settings(LampQuirks, QUIRKS, options.quirks)
        return Lamp(quirks, options.cells.get("level", 0))

    def controls(self) -> "ControlTable":
        """Its level, and the button on it."""
        from .controls import LAMP

        return LAMP

    def explain(self, data: bytes) -> str:
        """Lines in words."""
        from .device import explain

        return explain(data)


MODELS: Final = (Model("toy", "a lamp", ToyFamily(), range(1), 0, 9600, (9600,)),)
