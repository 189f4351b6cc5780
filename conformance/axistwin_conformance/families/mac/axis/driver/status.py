"""What the answers of an axis say about its state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.families.mac.axis.driver.client import AxisClient

# cc and dd of 27h: which byte and bit shows which bare input (§5.9).
INPUT_BITS: Final[Mapping[str, tuple[int, int]]] = {
    "positive_stop": (2, 0x20),
    "negative_stop": (3, 0x40),
    "reference": (3, 0x20),
}


class AxisStatus:
    """The answers 21h and 27h of one module, bit by bit."""

    def __init__(self, client: AxisClient) -> None:
        self._client = client

    def is_busy(self) -> bool:
        """The inverted bit 3 of 27h byte 3 (MACS-Q-27-03)."""
        return not self._client.data_bytes(0x27)[2] & 0x08

    def faults(self) -> int:
        """The byte dd of 21h without what is reserved."""
        return self._client.data_bytes(0x21)[0] & self._client.face.faults

    def memories(self) -> int:
        """The byte hh of 21h."""
        return self._client.data_bytes(0x21)[3]

    def inputs(self) -> dict[str, bool]:
        """The bare inputs, by 27h."""
        data = self._client.data_bytes(0x27)
        return {name: bool(data[byte] & bit) for name, (byte, bit) in INPUT_BITS.items()}

    def stopped_on(self) -> int:
        """The byte ff of 21h without what is reserved, which stops ended the motion: five bits,
        since the map may be shifted."""
        ff = self._client.data_bytes(0x21)[1]
        return ff & (0x0F if ff & 0xE0 else 0x1F)
