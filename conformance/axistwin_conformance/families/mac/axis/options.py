"""The options of an axis: how far and how fast it may move, and how often its EEPROM is written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

import click

from axistwin_conformance.base.write_budget import DEFAULT_BUDGET
from axistwin_conformance.core.settings import FamilyOption, FamilyOptions
from axistwin_conformance.core.travel import MAX_SPEED, MAX_TRAVEL, TravelSettings, envelope

BENCH_TRAVEL: Final = 2000  # increments: one turn of a MAC23, a fifth of a MAC34
BENCH_SPEED: Final = 10_000  # increments per second: 300 rpm on a MAC23


class AxisSettings(TravelSettings):
    """The bounds of an axis, and the budget of its EEPROM."""

    def within(self, safety: str) -> str:
        """How far and how fast it is moved, how often its EEPROM is written."""
        if safety == "stored":
            budget = self.eeprom_budget
            most = "any number of" if budget is None else f"at most {budget}"
            return (
                f"read first and put back; {most} EEPROM writes (--eeprom-budget), but what puts"
                " back is always written"
            )
        return TravelSettings.within(self, safety)


class AxisOptions(FamilyOptions):
    """The bounds of an axis; enforced unless nobody has asked for any and a twin is moved."""

    declared: ClassVar = (
        MAX_TRAVEL,
        MAX_SPEED,
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
        budget = given.get("eeprom_budget")
        bounds = envelope(given, BENCH_TRAVEL, BENCH_SPEED, is_builtin=is_builtin, is_twin=is_twin)
        return AxisSettings(bounds, DEFAULT_BUDGET if budget is None and not is_twin else budget)


OPTIONS: Final = AxisOptions()
