"""What the answers of an axis say about its state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.families.mac.axis.driver.client import AxisClient
from axistwin_conformance.families.mac.axis.driver.facts import (
    facts_of,
    implausible,
    is_plausible,
)

# cc and dd of 27h: which byte and bit shows which bare input (§5.9).
INPUT_BITS: Final[Mapping[str, tuple[int, int]]] = {
    "positive_stop": (2, 0x20),
    "negative_stop": (3, 0x40),
    "reference": (3, 0x20),
}
STOPS: Final = 0x0F  # of ff of 21h: the four stops, in the layout of the CAN manual
UNNAMED_STOPS: Final = 0xE0  # and what is reserved in either layout


class AxisStatus:
    """The answers 21h and 27h of one module, bit by bit."""

    def __init__(self, client: AxisClient) -> None:
        self._client = client

    def is_busy(self) -> bool:
        """The inverted bit 3 of 27h byte 3 (MACS-Q-27-03)."""
        return not self._measures()[2] & 0x08

    def faults(self) -> int:
        """The byte dd of 21h without what is reserved."""
        return self._client.data_bytes(0x21)[0] & self._client.face.faults

    def memories(self) -> int:
        """The byte hh of 21h."""
        return self._client.data_bytes(0x21)[3]

    def inputs(self) -> dict[str, bool]:
        """The bare inputs, by 27h."""
        data = self._measures()
        return {name: bool(data[byte] & bit) for name, (byte, bit) in INPUT_BITS.items()}

    def _measures(self) -> tuple[int, int, int, int]:
        """The bytes of 27h.  Whoever asks, and for whichever of them: a temperature that no MAC can
        have is wrong, unless a rig has made it."""
        data, session = self._client.data_bytes(0x27), self._client.session
        run, celsius = session.run, facts_of(session).celsius(data[0])
        is_made = run.rig is not None and run.rig.is_disturbed
        if not is_plausible(celsius) and not is_made:
            run.violations.append(implausible(run, data[0], celsius))
        return data

    def stopped_on(self) -> int:
        """The byte ff of 21h without what is reserved, which stops ended the motion: four bits,
        which may be shifted by one.  Bits that nothing names may be ones (MACS-AMB-59)."""
        ff = self._client.data_bytes(0x21)[1]
        if not ff & UNNAMED_STOPS:
            return ff & (STOPS | STOPS << 1)
        layout = self._client.session.readings.get("status_ff_layout")
        if layout is None:  # all ones around the four bits tell where these are
            is_shifted = ff & ~(STOPS << 1) == 0xFF & ~(STOPS << 1)
            return ff & (STOPS << 1 if is_shifted and not ff & 0x10 else STOPS)
        return ff & (STOPS << 1 if layout == "shifted" else STOPS)
