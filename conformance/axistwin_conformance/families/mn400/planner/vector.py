"""Vector moves: up to four axes that start and end together (MN4-CMD-M-01).

The major axis is the lowest-numbered one of those with the most steps.  Speeds are its speeds; the
others follow in proportion, never more than a step away from it (MN4-MOT-01).  Where an axis may be
at a time is a window, since nobody has written in which phase the interpolation begins (MN4-AMB-65)
and at which end of its period a step comes (MN4-AMB-71).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import ceil, floor
from typing import Final

from axistwin_conformance.families.mn400.planner.speed import (
    MotionProfile,
    SpeedPlan,
    ramped,
)

AXES: Final = 4
MAX_RATE: Final = 100_000  # steps/s of interpolation, over all multiplexes (MN4-MOT-04)
BOTH: Final = 2  # at least so many axes make a multi-axis move

Window = tuple[int, int]  # the lowest and the highest admissible position


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """With what a move is begun: `speed` in steps/s (more than 0), the profile, the multiplex.

    `is_clipped`: a multiplex above 1 lowers the greatest rate (MN4-AMB-65).
    """

    speed: int
    profile: MotionProfile
    multiplex: int = 1
    is_clipped: bool = True


def major_length(displacements: Sequence[int]) -> int:
    """How many steps the major axis makes."""
    return max((abs(one) for one in displacements), default=0)


def axis_window(displacement: int, length: int, low: int, high: int) -> Window:
    """Where an axis may be, from the start of a move of `length` major steps, when at least `low`
    and at most `high` are made: within a step of its share, and where it belongs at the end."""
    total = abs(displacement)
    if not total or total == length:
        least, most = min(low, total), min(high, total)
    else:
        share = Fraction(total, length)
        least = total if low == length else max(0, ceil(share * low - 1))
        most = min(total, floor(share * high + 1)) if high else 0
    return (least, most) if displacement >= 0 else (-most, -least)


@dataclass(frozen=True)
class VectorMove:
    """One move: its displacements in steps, one for each axis, and its settings."""

    displacements: tuple[int, ...]
    settings: MotionSettings

    @property
    def length(self) -> int:
        """Steps of the major axis."""
        return major_length(self.displacements)

    @property
    def major(self) -> int:
        """The major axis, from 0."""
        return [abs(one) for one in self.displacements].index(self.length)

    @property
    def is_multi_axis(self) -> bool:
        """True if two axes move at least."""
        return sum(one != 0 for one in self.displacements) >= BOTH

    @property
    def is_phased(self) -> bool:
        """True if a step of the major axis is several ticks, of which any may be the one that makes
        it (MN4-AMB-65)."""
        return self.is_multi_axis and self.settings.multiplex > 1

    @cached_property
    def speed(self) -> int:
        """The speed that it is given, lowered where interpolation is finer (MN4-MOT-04)."""
        settings = self.settings
        is_capped = self.is_multi_axis and settings.multiplex > 1 and settings.is_clipped
        highest = MAX_RATE // settings.multiplex if is_capped else MAX_RATE
        return min(settings.speed, highest)

    @cached_property
    def plan(self) -> SpeedPlan:
        """Its speed over time."""
        return ramped(self.length, self.speed, self.settings.profile)

    def windows(
        self, first: Fraction, last: Fraction, *, is_early: bool = False
    ) -> tuple[Window, ...]:
        """Where each axis may be, from its start, at some time between the two.

        `is_early`: steps come at the beginning of their periods.
        """
        low, high = self.plan.steps_within(first, last, is_early=is_early or self.is_phased)
        return tuple(axis_window(one, self.length, low, high) for one in self.displacements)

    def counted(self, first: Fraction, last: Fraction) -> Window:
        """How many phantom steps a measurement may count between the two times: those of the major
        axis times the multiplex, give or take the multiplex (MN4-MEA-03); none where one axis moves
        alone (MN4-CMD-E-04)."""
        if not self.is_multi_axis:
            return 0, 0
        steps = self.plan.travelled(last) - self.plan.travelled(first)
        factor = self.settings.multiplex
        return max(0, ceil(factor * (steps - 1))), floor(factor * (steps + 1))


# --- backlash -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BacklashState:
    """Backlash steps and the remembered direction (1 or -1) of each axis."""

    steps: tuple[int, ...] = (0,) * AXES
    memory: tuple[int, ...] = (1,) * AXES

    def compensation(self, displacements: Sequence[int]) -> tuple[int, ...]:
        """What each axis makes before a move, in the direction of the move (MN4-BKL-01)."""
        return tuple(
            _sign(one) * lash if one and _sign(one) != before else 0
            for one, lash, before in zip(displacements, self.steps, self.memory, strict=True)
        )

    def after(self, displacements: Sequence[int]) -> BacklashState:
        """What is remembered after a move; an axis that stands keeps its memory (MN4-BKL-02)."""
        kept = zip(displacements, self.memory, strict=True)
        return BacklashState(self.steps, tuple(_sign(one) or before for one, before in kept))


def _sign(number: int) -> int:
    return (number > 0) - (number < 0)


def compensated(
    displacements: Sequence[int], settings: MotionSettings, backlash: BacklashState
) -> tuple[VectorMove, VectorMove]:
    """A move and the compensation before it, which is a vector move of its own (of no steps where
    none is needed), at the same speed and profile."""
    before = VectorMove(backlash.compensation(displacements), settings)
    return before, VectorMove(tuple(displacements), settings)
