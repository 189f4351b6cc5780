"""How far and how fast a run may move axes: two options, shared by the families that have axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from axistwin_conformance.core.option_types import Count
from axistwin_conformance.core.settings import Envelope, FamilyOption, Settings

MOST_TRAVEL: Final = 1 << 31  # increments: from one end of an axis's counter to the other
MOST_SPEED: Final = 8_000_000  # increments per second: the shortest period of a MAC, of one tick
TWIN_TRAVEL: Final = 1_000_000
TWIN_SPEED: Final = 1_000_000

MAX_TRAVEL: Final = FamilyOption(
    "max-travel",
    Count(1, MOST_TRAVEL),
    "STEPS",
    "Move each axis at most this far from the start position, in increments or steps; up to"
    f" {MOST_TRAVEL}.",
    100,
    " {value}: the suite drives no axis of {a_model}",
)
MAX_SPEED: Final = FamilyOption(
    "max-speed",
    Count(1, MOST_SPEED),
    "STEPS/S",
    f"Move at most this fast, in increments or steps per second; up to {MOST_SPEED}.",
    110,
    " {value}: the suite drives no axis of {a_model}",
)


@dataclass(frozen=True, slots=True)
class TravelSettings(Settings):
    """The bounds of motion; `unit`: what they are counted in."""

    envelope: Envelope
    eeprom_budget: int | None = None
    unit: str = "increments"

    def words(self, *, is_builtin: bool) -> list[str]:
        """Both bounds of motion, and the budget if there is one; nothing to the built-in twin."""
        if is_builtin:
            return []
        bounds = {
            "--max-travel": self.envelope.max_travel,
            "--max-speed": self.envelope.max_speed,
            "--eeprom-budget": self.eeprom_budget,
        }
        return [
            word
            for option, bound in bounds.items()
            if bound is not None
            for word in (option, str(bound))
        ]

    def within(self, safety: str) -> str:
        """How far and how fast axes are moved."""
        if safety != "motion":
            return ""
        if not self.envelope.is_guarded:
            return "without bounds: a twin cannot be harmed"
        return (
            f"not further than {self.envelope.max_travel} {self.unit} from where the axis is"
            f" found (--max-travel), not faster than {self.envelope.max_speed} per second"
            " (--max-speed)"
        )


def envelope(
    given: Mapping[str, Any], travel: int, speed: int, *, is_builtin: bool, is_twin: bool
) -> Envelope:
    """The bounds given; else `travel` and `speed` for a device, wide ones for the built-in twin.
    Enforced unless nobody has asked for any and a twin is moved."""
    asked_travel, asked_speed = given.get("max_travel"), given.get("max_speed")
    return Envelope(
        asked_travel or (TWIN_TRAVEL if is_builtin else travel),
        asked_speed or (TWIN_SPEED if is_builtin else speed),
        is_guarded=bool(asked_travel or asked_speed) or not is_twin,
    )
