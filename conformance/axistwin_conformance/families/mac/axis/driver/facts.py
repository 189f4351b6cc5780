"""What differs between the models on the wire."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.core.session import Run, Session

PLAUSIBLE_CELSIUS: Final = (-20.0, 90.0)  # a MAC at rest; the models' scales differ by 70 degrees


@dataclass(frozen=True, slots=True)
class MacFacts:
    """What differs between the models on the wire (§5.9): temperature = gain·tt + offset, supply =
    vv·volts_per_count, the shaft's resolution, and Imax where the manual lets it be derived."""

    increments_per_turn: int
    celsius_gain: float
    celsius_offset: float
    volts_per_count: float
    imax: int | None

    @property
    def is_mac23(self) -> bool:
        """True for the motor with 2000 increments per turn, on whichever face."""
        return self.increments_per_turn == 2000

    def celsius(self, tt: int) -> float:
        """Read byte tt of answer 27h."""
        return self.celsius_gain * tt + self.celsius_offset

    def volts(self, vv: int) -> float:
        """Read byte vv of answer 27h."""
        return vv * self.volts_per_count


def facts_of(session: Session) -> MacFacts:
    """The facts of the model under test."""
    facts = session.run.model.facts
    assert isinstance(facts, MacFacts)
    return facts


def implausible(run: Run, tt: int, celsius: float) -> tuple[str, str, str]:
    """What a module has broken that tells a temperature which no MAC can have."""
    (requirement,) = run.ledger.own(("MACS-Q-27-01",))
    coldest, hottest = PLAUSIBLE_CELSIUS
    expected = f"a temperature from {coldest:.0f} to {hottest:.0f} °C"
    return requirement, expected, f"temperature byte {tt:02X}h would mean {celsius:.0f} °C"


def is_plausible(celsius: float) -> bool:
    """Whether a MAC can have that temperature."""
    return PLAUSIBLE_CELSIUS[0] <= celsius <= PLAUSIBLE_CELSIUS[1]
