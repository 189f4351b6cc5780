"""The options of an axis: how far and how fast it may move, and how often its EEPROM is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import click

from axistwin_conformance.base.write_budget import DEFAULT_BUDGET
from axistwin_conformance.core.option_types import Count
from axistwin_conformance.core.settings import Envelope, FamilyOption, FamilyOptions, Settings

MOST_TRAVEL: Final = 1 << 31  # increments: from one end of an axis's counter to the other
MOST_SPEED: Final = 8_000_000  # increments per second: the shortest period there is, of one tick
BENCH_TRAVEL: Final = 2000  # increments: one turn of a MAC23, a fifth of a MAC34
BENCH_SPEED: Final = 10_000  # increments per second: 300 rpm on a MAC23
TWIN_TRAVEL: Final = 1_000_000
TWIN_SPEED: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class AxisSettings(Settings):
    """The bounds of an axis."""

    envelope: Envelope
    eeprom_budget: int | None = None

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
        """How far and how fast it is moved, how often its EEPROM is written."""
        if safety == "motion":
            if not self.envelope.is_guarded:
                return "without bounds: a twin cannot be harmed"
            return (
                f"not further than {self.envelope.max_travel} increments from where the axis is"
                f" found (--max-travel), not faster than {self.envelope.max_speed} per second"
                " (--max-speed)"
            )
        if safety == "stored":
            budget = self.eeprom_budget
            most = "any number of" if budget is None else f"at most {budget}"
            return (
                f"read first and put back; {most} EEPROM writes (--eeprom-budget), but what puts"
                " back is always written"
            )
        return ""


class AxisOptions(FamilyOptions):
    """The bounds of an axis; enforced unless nobody has asked for any and a twin is moved."""

    declared: ClassVar = (
        FamilyOption(
            "max-travel",
            Count(1, MOST_TRAVEL),
            "STEPS",
            f"Move at most this far from the start position, in increments; up to {MOST_TRAVEL}.",
            100,
            " {value}: the suite drives no axis of {a_model}",
        ),
        FamilyOption(
            "max-speed",
            Count(1, MOST_SPEED),
            "STEPS/S",
            f"Move at most this fast, in increments per second; up to {MOST_SPEED}.",
            110,
            " {value}: the suite drives no axis of {a_model}",
        ),
        FamilyOption(
            "eeprom-budget",
            click.IntRange(min=0),
            "N",
            f"Maximum number of EEPROM writes. Default: {DEFAULT_BUDGET}, no limit on a twin."
            " Restoring is exempt.",
            300,
            " {value}: {model} has no EEPROM that the suite writes",
        ),
    )

    def settings(
        self, given: Mapping[str, Any], *, is_builtin: bool, is_twin: bool
    ) -> AxisSettings:
        """The bounds given, else cautious ones for a device, wide ones for the built-in twin."""
        travel, speed = given.get("max_travel"), given.get("max_speed")
        budget = given.get("eeprom_budget")
        envelope = Envelope(
            travel or (TWIN_TRAVEL if is_builtin else BENCH_TRAVEL),
            speed or (TWIN_SPEED if is_builtin else BENCH_SPEED),
            is_guarded=bool(travel or speed) or not is_twin,
        )
        return AxisSettings(envelope, DEFAULT_BUDGET if budget is None and not is_twin else budget)


OPTIONS: Final = AxisOptions()
