"""What a motion is made by: the readings of the manual, the ramp, and the settings in force."""

from dataclasses import dataclass, fields
from fractions import Fraction
from typing import Literal

AXES = range(4)
SPEED_MIN = 2
SPEED_MAX = 100_000

Quad = tuple[int, int, int, int]
"""One whole number for each axis, M1 first."""


@dataclass(frozen=True, slots=True)
class MotionRules:
    """The switches of the ledger that shape a motion; defaults are the ledger's."""

    accel_scale: Literal["1.0", "0.5"] = "1.0"
    multiplex_cap: Literal["clip", "error", "none"] = "clip"
    dda_phase: Literal["half", "zero", "full"] = "half"
    step_phase: Literal["end", "start"] = "end"
    arc_ramp: bool = False
    arc_rate: Literal["dominant_tick", "tangential"] = "dominant_tick"
    arc_radius_tol: str = "2.5"
    arc_zero_sweep: Literal["full", "none"] = "full"
    helix_zero_final: Literal["full", "none"] = "full"
    cc_margin_scope: Literal["per_axis_pair", "per_axis_equal", "major_only"] = "per_axis_pair"
    cc_corner_speed: Literal["start_speed", "margin"] = "start_speed"
    contour_pulses: Literal["paced", "ignored", "error"] = "paced"
    pause_decel: bool = True
    backlash_counts: bool = False
    backlash_speed: Literal["v", "start"] = "v"
    backlash_arc: Literal["start_only", "quadrants"] = "start_only"
    threader_start: Literal["index", "first_pulse"] = "index"
    sync_ratio: Literal["major_step", "tick"] = "major_step"
    tap_rounding: Literal["floor", "nearest"] = "floor"

    @classmethod
    def of(cls, quirks: object) -> "MotionRules":
        """The rules among the attributes of ``quirks``, which has all of them."""
        return cls(**{field.name: getattr(quirks, field.name) for field in fields(cls)})

    @property
    def radius_tolerance(self) -> Fraction:
        """How far the radii of start and destination may differ, in steps."""
        return Fraction(self.arc_radius_tol)


DEFAULT_RULES = MotionRules()


@dataclass(frozen=True, slots=True)
class SpeedProfile:
    """Command F: start and end speed [2..100000 steps/s], acceleration [>= 1 steps/s²]."""

    start: int = 1000
    end: int = 5000
    acceleration: int = 10_000

    def __post_init__(self) -> None:
        assert 1 <= self.start <= self.end, f"no ramp from {self.start} to {self.end}"
        assert self.acceleration >= 1, f"an acceleration of {self.acceleration}"


@dataclass(frozen=True, slots=True)
class MoveSettings:
    """What is in force when a motion is accepted."""

    rules: MotionRules = DEFAULT_RULES
    profile: SpeedProfile = SpeedProfile()
    speed: int = 2000
    """Command V, steps/s of the major axis; negative: external pulses."""
    multiplex: int = 1
    lash: Quad = (0, 0, 0, 0)
    """Backlash in steps, >= 0."""
    lash_memory: Quad = (1, 1, 1, 1)
    """The direction of each axis' last motion, +1 or -1."""
    feed_permille: int = 1000
    """How much of the speed the pot leaves [0..1000]; 1000 if it is not in use."""

    @property
    def twice_acceleration(self) -> int:
        """2·a·κ in steps/s² (MN4-AMB-25), what the squared speed gains in a step."""
        doubled = self.rules.accel_scale == "1.0"
        return self.profile.acceleration * (2 if doubled else 1)

    def cap(self, speed: int, multiplex: int, feed_permille: int) -> int:
        """The top speed for a programmed ``speed`` (MN4-CMD-V-03, MN4-MOT-04, MN4-IO-01)."""
        scaled = max(SPEED_MIN, abs(speed) * feed_permille // 1000)
        capped = min(scaled, self.profile.end)
        if multiplex > 1 and self.rules.multiplex_cap != "none":
            capped = min(capped, SPEED_MAX // multiplex)
        return capped
