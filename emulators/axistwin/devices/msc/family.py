"""MSC motion system controllers, on their executive port."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from axistwin.devices.family import DeviceOptions, Family, Model

if TYPE_CHECKING:
    from axistwin.devices.controls import ControlTable
    from axistwin.devices.msc.controller import MscController
    from axistwin.devices.switches import Quirk


class MscFamily(Family):
    """Packets, flags, variables, and a macroprogram."""

    def quirks(self) -> "Mapping[str, Quirk]":
        """Those of every MSC."""
        from axistwin.devices.msc.quirks import QUIRKS

        return QUIRKS

    def make(self, model: str, address: int, options: DeviceOptions) -> "MscController":
        """A controller; the address is the setting of its switch."""
        from axistwin.devices.msc.controller import MscController
        from axistwin.devices.msc.quirks import parse_quirks

        return MscController(
            model,
            address,
            quirks=parse_quirks(options.quirks),
            cells=options.cells,
            skew_ns=options.skew_ns,
            alone=options.alone,
        )

    def controls(self) -> "ControlTable":
        """Flags, variables, status, program."""
        from axistwin.devices.msc.controls import MSC

        return MSC

    def explain(self, data: bytes) -> str:
        """Packets in words."""
        from axistwin.devices.msc.decode import explain

        return explain(data)

    def compose(self, text: str, address: int) -> bytes:
        """A packet."""
        from axistwin.devices.msc.decode import compose

        return compose(text, address)

    def completed(self, data: bytes) -> bytes:
        """A packet with its sum."""
        from axistwin.devices.msc.packets import completed

        return completed(data)

    def acknowledgement(self, reply: bytes) -> bytes:
        """ACK for a packet, which is repeated without (MSC-LNK-09)."""
        from axistwin.devices.msc.packets import ACK_BYTE, is_packet

        return ACK_BYTE if is_packet(reply) else b""


_DESCRIPTIONS: Final = {
    "msc-250": "MSC-250 motion system controller",
    "msc-850-32": "MSC-850/32 motion system controller",
    "msc-850": "MSC-850 motion system controller, without RFLAGS",
    "msc-generic": "any other MSC motion system controller, without RFLAGS",
}

MODELS: Final = tuple(
    Model(
        name,
        f"{description}, executive port",
        MscFamily(),
        addresses=range(1, 16),
        default_address=1,
        default_baud=9600,
        bauds=(9600,),
    )
    for name, description in _DESCRIPTIONS.items()
)
