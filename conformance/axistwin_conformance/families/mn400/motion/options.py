"""The options of an MN400: how far and how fast its axes may move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from axistwin_conformance.core.settings import FamilyOptions
from axistwin_conformance.core.travel import MAX_SPEED, MAX_TRAVEL, TravelSettings, envelope

BENCH_TRAVEL: Final = 3000  # steps: fifteen turns of a motor with 200 of them
BENCH_SPEED: Final = 5000  # steps per second: the end speed of the profile at power-on


class BoardOptions(FamilyOptions):
    """The bounds of each axis; enforced unless nobody has asked for any and a twin is moved."""

    declared: ClassVar = (MAX_TRAVEL, MAX_SPEED)

    def settings(
        self, given: Mapping[str, Any], *, is_builtin: bool, is_twin: bool
    ) -> TravelSettings:
        """The bounds given, else cautious ones for a device, wide ones for the built-in twin."""
        bounds = envelope(given, BENCH_TRAVEL, BENCH_SPEED, is_builtin=is_builtin, is_twin=is_twin)
        return TravelSettings(bounds, unit="steps")


OPTIONS: Final = BoardOptions()
