"""Continuous contours: the fastest speeds at which all segments run as one motion.

Unknown are the entry speed u and the leaving speed w of each segment, in steps/s of its own major
axis.  All bounds on them are monotone, so lowering every value until nothing changes gives the
greatest values that keep all of them:

1. the first u and the last w are at most the start speed; no speed is above its segment's cap
2. within a segment one speed can be reached from the other by the acceleration
3. a soft junction lets each of axes 1 to 3 jump by the margin at most (MN4-CC-04)
4. a hard junction has at most the start speed on either side (MN4-CC-07)

Junctions are soft at first; the slowest of those that would be slower than the start speed is made
hard, and all is done again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from itertools import pairwise, product
from math import floor
from typing import Final

from axistwin_conformance.families.mn400.planner.speed import (
    MotionProfile,
    SpeedPlan,
    between,
    constant,
    root,
)
from axistwin_conformance.families.mn400.planner.vector import (
    AXES,
    Window,
    axis_window,
    major_length,
)

PLANNED_AXES: Final = 3  # the 4th is outside of all speed limits (MN4-CC-08)
SPEED_GRID: Final = 1 << 30  # speeds are cut off to 2^-30 steps/s, so that lowering comes to an end


class MarginScope(StrEnum):
    """To what the margin of a contour applies (MN4-AMB-31)."""

    PER_AXIS_PAIR = "per_axis_pair"
    PER_AXIS_EQUAL = "per_axis_equal"
    MAJOR_ONLY = "major_only"


@dataclass(frozen=True, slots=True)
class ContourRules:
    """The margin (steps/s), the profile, and how the manual's open places are read.

    `has_hard_corners`: a corner beyond the margin falls back to the start speed (MN4-AMB-33).
    """

    margin: int
    profile: MotionProfile
    scope: MarginScope = MarginScope.PER_AXIS_PAIR
    has_hard_corners: bool = True


@dataclass(frozen=True, slots=True)
class ContourSegment:
    """One M of a contour, with the V before it: displacements in steps, speed in steps/s."""

    displacements: tuple[int, ...]
    speed: int

    @property
    def length(self) -> int:
        """Steps of its major axis, of all four."""
        return major_length(self.displacements)

    def ratio(self, axis: int) -> Fraction:
        """How far an axis goes in a step of the major one."""
        return Fraction(self.displacements[axis], self.length)


@dataclass(slots=True)
class PlannedSegment:
    """A segment with its cap and its two speeds, which are lowered until they fit."""

    segment: ContourSegment
    cap: Fraction
    entry: Fraction
    leaving: Fraction

    def lower(self, entry: Fraction | None = None, leaving: Fraction | None = None) -> bool:
        """Lower speeds to what is given, where that is lower; True if one changed."""
        before = self.entry, self.leaving
        if entry is not None:
            self.entry = min(self.entry, _cut(entry))
        if leaving is not None:
            self.leaving = min(self.leaving, _cut(leaving))
        return before != (self.entry, self.leaving)

    def plan(self, profile: MotionProfile) -> SpeedPlan:
        """Its speed over time."""
        steps = Fraction(self.segment.length)
        if self.cap <= profile.start:
            return constant(steps, self.cap)
        squares = self.entry**2 + self.leaving**2
        peak = root((2 * profile.acceleration * steps + squares) / 2)
        top = max(min(self.cap, peak), self.entry, self.leaving)
        return between(steps, self.entry, top, self.leaving, profile)


def _cut(speed: Fraction) -> Fraction:
    return Fraction(floor(speed * SPEED_GRID), SPEED_GRID)


def planned(segments: Sequence[ContourSegment], rules: ContourRules) -> list[PlannedSegment]:
    """The segments of a contour with their speeds; those of no length are left out."""
    kept = [segment for segment in segments if segment.length]
    hard: set[int] = set()
    while True:
        plans = _fastest(kept, rules, hard)
        slow = _too_slow(plans, rules, hard)
        if not slow:
            return plans
        hard.add(min(slow, key=lambda index: slow[index]))


def _fastest(
    segments: Sequence[ContourSegment], rules: ContourRules, hard: set[int]
) -> list[PlannedSegment]:
    """The greatest speeds that keep rules 1 to 4."""
    profile = rules.profile
    plans = []
    for segment in segments:
        cap = Fraction(min(segment.speed, profile.end))
        plans.append(PlannedSegment(segment, cap, cap, cap))
    if plans:
        plans[0].lower(entry=Fraction(profile.start))
        plans[-1].lower(leaving=Fraction(profile.start))
    while _lowered(plans, rules, hard):
        pass
    return plans


def _lowered(plans: Sequence[PlannedSegment], rules: ContourRules, hard: set[int]) -> bool:
    """Lower what any rule asks to be lower; True if something was."""
    changed = [_ramp(plan, rules.profile) for plan in plans]
    for index, (before, after) in enumerate(pairwise(plans)):
        if index in hard:
            start = Fraction(rules.profile.start)
            changed += [before.lower(leaving=start), after.lower(entry=start)]
        else:
            changed.append(_soft(before, after, rules))
    return any(changed)


def _ramp(plan: PlannedSegment, profile: MotionProfile) -> bool:
    """Rule 2: what can be reached within the segment."""
    if plan.cap <= profile.start:
        return False  # it runs at its cap throughout
    gained = 2 * profile.acceleration * plan.segment.length
    is_lower = plan.lower(leaving=root(plan.entry**2 + gained))
    return plan.lower(entry=root(plan.leaving**2 + gained)) or is_lower


def _soft(before: PlannedSegment, after: PlannedSegment, rules: ContourRules) -> bool:
    """Rule 3: no axis jumps by more than the margin."""
    if rules.scope is MarginScope.PER_AXIS_EQUAL:
        return _equal(before, after, rules.margin)
    margin = Fraction(rules.margin)
    jumps = tuple(_jumps(before.segment, after.segment, rules.scope, margin))
    changed = [before.lower(leaving=jump.leaving_at_once) for jump in jumps]
    changed += [after.lower(entry=jump.entry_at_once) for jump in jumps]
    # Two axes may lower each other's bound without end: where that comes to is known.
    for one, other in product(jumps, jumps):
        changed += [before.lower(leaving=one.leaving_limit(other))]
        changed += [after.lower(entry=one.entry_limit(other))]
    changed += [after.lower(entry=jump.entry_bound(before.leaving)) for jump in jumps]
    changed += [before.lower(leaving=jump.leaving_bound(after.entry)) for jump in jumps]
    return any(changed)


@dataclass(frozen=True, slots=True)
class AxisJump:
    """How one axis bounds the speeds on both sides of a junction; None: not at all.

    `old`, `new`: how far it goes in a step of the major axis before and after, without signs;
    `is_reversal`: it turns round, and each side is left half of the margin.
    """

    old: Fraction
    new: Fraction
    margin: Fraction
    is_reversal: bool

    @property
    def leaving_at_once(self) -> Fraction | None:
        """The bound on the speed before, whatever the one after is."""
        return self.margin / 2 / self.old if self.is_reversal else None

    @property
    def entry_at_once(self) -> Fraction | None:
        """The bound on the speed after, whatever the one before is."""
        return self.margin / 2 / self.new if self.is_reversal else None

    def entry_bound(self, leaving: Fraction) -> Fraction | None:
        """The bound on the speed after a junction that is left at this one."""
        if self.is_reversal or not self.new:
            return None
        return (self.old * leaving + self.margin) / self.new

    def leaving_bound(self, entry: Fraction) -> Fraction | None:
        """The bound on the speed before a junction that is entered at this one."""
        if self.is_reversal or not self.old:
            return None
        return (self.new * entry + self.margin) / self.old

    def leaving_limit(self, other: AxisJump) -> Fraction | None:
        """What the speed before comes to if this axis bounds it and the other one that after."""
        if self.is_reversal or other.is_reversal or not self.old or not other.new:
            return None
        gain = self.new * other.old / (self.old * other.new)
        bound = (self.new * other.margin / other.new + self.margin) / self.old
        return bound / (1 - gain) if gain < 1 else None

    def entry_limit(self, other: AxisJump) -> Fraction | None:
        """What the speed after comes to if this axis bounds it and the other one that before."""
        if self.is_reversal or other.is_reversal or not self.new or not other.old:
            return None
        gain = self.old * other.new / (self.new * other.old)
        bound = (self.old * other.margin / other.old + self.margin) / self.new
        return bound / (1 - gain) if gain < 1 else None


def _jumps(
    before: ContourSegment, after: ContourSegment, scope: MarginScope, margin: Fraction
) -> Iterator[AxisJump]:
    """What each axis that the margin is about bounds."""
    axes = {*range(PLANNED_AXES)}
    if scope is MarginScope.MAJOR_ONLY:
        axes &= {_major(before), _major(after)}
    for axis in axes:
        old, new = before.ratio(axis), after.ratio(axis)
        yield AxisJump(abs(old), abs(new), margin, old * new < 0)


def _major(segment: ContourSegment) -> int:
    sizes = [abs(one) for one in segment.displacements]
    return sizes.index(max(sizes))


def _equal(before: PlannedSegment, after: PlannedSegment, margin: int) -> bool:
    """Another reading: one speed on both sides, at which no axis jumps beyond the margin."""
    speed = min(before.leaving, after.entry)
    for axis in range(PLANNED_AXES):
        jump = abs(after.segment.ratio(axis) - before.segment.ratio(axis))
        speed = min(speed, margin / jump) if jump else speed
    is_lower = before.lower(leaving=speed)
    return after.lower(entry=speed) or is_lower


def _too_slow(
    plans: Sequence[PlannedSegment], rules: ContourRules, hard: set[int]
) -> dict[int, Fraction]:
    """The soft junctions that are slower than what a hard one has, each with the share of that
    which is left: the slowest one is the reason why its neighbours are slow."""
    start = Fraction(rules.profile.start)
    slow = {}
    for index, (before, after) in enumerate(pairwise(plans)):
        share = min(before.leaving / min(start, before.cap), after.entry / min(start, after.cap))
        if rules.has_hard_corners and index not in hard and share < 1:
            slow[index] = share
    return slow


class ContourMove:
    """A contour that runs: its segments one behind the other."""

    def __init__(self, segments: Sequence[ContourSegment], rules: ContourRules) -> None:
        self.segments = [one.segment for one in planned(segments, rules)]
        self.plans = [one.plan(rules.profile) for one in planned(segments, rules)]

    @property
    def seconds(self) -> Fraction:
        """From its beginning to its last step."""
        return sum((plan.seconds for plan in self.plans), Fraction(0))

    @property
    def displacements(self) -> tuple[int, ...]:
        """The sum of all segments (MN4-CC-01)."""
        rows = [(0,) * AXES, *(one.displacements for one in self.segments)]
        return tuple(map(sum, zip(*rows, strict=True)))

    def windows(
        self, first: Fraction, last: Fraction, *, is_early: bool = False
    ) -> tuple[Window, ...]:
        """Where each axis may be, from the start, at some time between the two."""
        base: tuple[int, ...] = (0,) * AXES
        boxes: list[tuple[Window, ...]] = []
        for index, (segment, plan) in enumerate(zip(self.segments, self.plans, strict=True)):
            is_last = index == len(self.plans) - 1
            if last >= 0 and (first <= plan.seconds or is_last):
                low, high = plan.steps_within(first, last, is_early=is_early)
                moved = (
                    axis_window(one, segment.length, low, high) for one in segment.displacements
                )
                rows = zip(base, moved, strict=True)
                boxes.append(tuple((at + box[0], at + box[1]) for at, box in rows))
            base = tuple(map(sum, zip(base, segment.displacements, strict=True)))
            first, last = first - plan.seconds, last - plan.seconds
        if not boxes:
            return tuple((one, one) for one in base)
        rows_of_axis = zip(*boxes, strict=True)
        return tuple((min(row)[0], max(high for _, high in row)) for row in rows_of_axis)
