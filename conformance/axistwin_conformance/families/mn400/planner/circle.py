"""Arcs and helices: two motors on a circle, a third one along (MN4-ARC, MN4-HEL).

A circle is gone along in ticks.  In the manual's likeliest reading a tick is a step of whichever
axis is the faster one there, so that a full circle has 8R / sqrt(2) of them; in the other one the
speed is that along the path (MN4-AMB-27).  Where a position may be is a window: a box around the
stretch of the ideal circle that may be reached by then, wider by what an axis may stray from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import asin, atan2, ceil, cos, floor, hypot, pi, sin, sqrt, tau
from typing import Final

from axistwin_conformance.families.mn400.planner.speed import (
    MotionProfile,
    SpeedPlan,
    constant,
    ramped,
)
from axistwin_conformance.families.mn400.planner.vector import Window

CLOCKWISE: Final = 1  # the direction of A and + (MN4-CMD-A-03)
STRAY: Final = 1.5  # steps an axis may be off the circle (MN4-ARC-04)
QUARTER: Final = pi / 2
TICKS_OF_QUARTER: Final = sqrt(2)  # of a circle of radius 1
TICKS_OFF: Final = 1.0  # by which a count of ticks may differ in each octant
ANGLE_OFF: Final = 1e-9

Point = tuple[int, int]


@dataclass(frozen=True, slots=True)
class CircleRules:
    """With what a circle is gone along: `speed` in steps/s, the profile, and how the manual's open
    places are read (MN4-AMB-26, MN4-AMB-27, MN4-AMB-29)."""

    speed: int
    profile: MotionProfile
    is_tangential: bool = False
    is_ramped: bool = False
    is_full_at_zero: bool = True


@dataclass(frozen=True)
class CircleMove:
    """An arc, or with `traverse` or `turns` a helix; all from its start, in steps.

    `centre`, `end`: of the plane's X and Y.  `direction`: 1 clockwise, -1 counter-clockwise.
    `turns`: full revolutions before the final arc.  `traverse`: of the third motor.
    """

    centre: Point
    end: Point
    direction: int
    rules: CircleRules
    traverse: int = 0
    turns: int = 0

    # --- its shape --------------------------------------------------------------------------------

    @cached_property
    def radius(self) -> float:
        """From the start to the centre."""
        return hypot(*self.centre)

    @cached_property
    def stray(self) -> float:
        """How far a position may be off the circle; more where its two radii differ."""
        end_radius = hypot(self.end[0] - self.centre[0], self.end[1] - self.centre[1])
        return STRAY + abs(end_radius - self.radius)

    @cached_property
    def first_angle(self) -> float:
        """The angle of the start, seen from the centre."""
        return atan2(-self.centre[1], -self.centre[0])

    @cached_property
    def sweep(self) -> float:
        """The angle gone through in all, without its sign."""
        last = atan2(self.end[1] - self.centre[1], self.end[0] - self.centre[0])
        turned = (self.first_angle - last) * self.direction % tau
        if self.end == (0, 0):
            turned = tau if self.rules.is_full_at_zero else 0.0
        return turned + tau * self.turns

    def _angle(self, gone: float) -> float:
        """The angle after so much of the sweep."""
        return self.first_angle - self.direction * gone

    def point(self, gone: float) -> tuple[float, float]:
        """The ideal position after so much of the sweep."""
        angle = self._angle(gone)
        x, y = self.centre
        return x + self.radius * cos(angle), y + self.radius * sin(angle)

    def signs(self, *, is_end: bool) -> tuple[int, int]:
        """In which direction X and Y move at the start, or at the end; where one of them turns
        round there, the direction that it has beside that place."""
        angle = self._angle(self.sweep if is_end else 0.0)
        speeds = self.direction * sin(angle), -self.direction * cos(angle)
        aside = (cos(angle), sin(angle)) if is_end else (-cos(angle), -sin(angle))
        x, y = (
            speed if abs(speed) > ANGLE_OFF else beside
            for speed, beside in zip(speeds, aside, strict=True)
        )
        return (1 if x > 0 else -1), (1 if y > 0 else -1)

    # --- its time ---------------------------------------------------------------------------------

    @cached_property
    def circle_ticks(self) -> float:
        """Steps of the locally faster axis from start to end."""
        gone = _dominant(self._angle(self.sweep)) - _dominant(self.first_angle)
        return self.radius * abs(gone)

    @cached_property
    def ticks(self) -> float:
        """What its speed counts: ticks of the circle, or the way along it; those of the traverse
        where there are more."""
        path = self.radius * self.sweep if self.rules.is_tangential else self.circle_ticks
        return max(path, float(abs(self.traverse)))

    @cached_property
    def ticks_off(self) -> float:
        """By how many ticks a lattice path may differ from the ideal count."""
        octants = self.sweep / (QUARTER / 2) + 1
        return 1 + octants * TICKS_OFF + 2 * (self.stray - STRAY)

    @cached_property
    def plan(self) -> SpeedPlan:
        """Its speed over time: the lower of speed and end speed throughout (MN4-MOT-13), unless
        this board ramps arcs (MN4-AMB-26)."""
        length = Fraction(self.ticks).limit_denominator(1 << 20)
        if self.rules.is_ramped:
            return ramped(length, self.rules.speed, self.rules.profile)
        return constant(length, Fraction(min(self.rules.speed, self.rules.profile.end)))

    @property
    def seconds(self) -> tuple[Fraction, Fraction]:
        """The least and the greatest duration."""
        slowest = self.plan.phases[0].entry if self.plan.phases else Fraction(1)
        off = Fraction(self.ticks_off) / slowest
        return max(Fraction(0), self.plan.seconds - off), self.plan.seconds + off

    # --- where it may be --------------------------------------------------------------------------

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, Window, Window]:
        """Where X, Y and the traverse motor may be at some time between the two, from the start."""
        begun = max(0.0, float(self.plan.travelled(first)) - self.ticks_off)
        done = float(self.plan.travelled(last)) + self.ticks_off
        if last <= 0:
            return (0, 0), (0, 0), (0, 0)
        if first > self.seconds[1]:
            x, y = self.end
            return (x, x), (y, y), (self.traverse, self.traverse)
        least, most = self._gone(begun), self._gone(done)
        points = [self.point(gone) for gone in self._corners(least, most)]
        if most >= self.sweep - ANGLE_OFF:
            points.append((float(self.end[0]), float(self.end[1])))
        x_window, y_window = (_box(axis, self.stray) for axis in zip(*points, strict=True))
        return x_window, y_window, self._traverse(least, most)

    def _gone(self, ticks: float) -> float:
        """How much of the sweep is gone through after so many ticks."""
        if ticks >= self.ticks:
            return self.sweep
        share = ticks / self.ticks
        if self.rules.is_tangential or not self.radius:
            return share * self.sweep
        way = _dominant(self.first_angle) - self.direction * share * self.circle_ticks / self.radius
        return min(self.sweep, abs(_angle_of(way) - self.first_angle))

    def _corners(self, least: float, most: float) -> Iterator[float]:
        """Both ends of a stretch, and all places of it where an axis turns round."""
        yield least
        yield most
        lowest, highest = sorted((self._angle(least), self._angle(most)))
        for quarter in range(ceil(lowest / QUARTER), floor(highest / QUARTER) + 1):
            yield abs(quarter * QUARTER - self.first_angle)

    def _traverse(self, least: float, most: float) -> Window:
        """Of the third motor, in proportion to the angle (MN4-HEL-02)."""
        if not self.traverse or not self.sweep:
            return 0, self.traverse
        ends = sorted(self.traverse * gone / self.sweep for gone in (least, most))
        low, high = floor(ends[0]) - 1, ceil(ends[1]) + 1
        way = (min(0, self.traverse), max(0, self.traverse))
        return max(low, way[0]), min(high, way[1])


def _box(values: Sequence[float], stray: float) -> Window:
    return ceil(min(values) - stray), floor(max(values) + stray)


def _dominant(angle: float) -> float:
    """Steps of the faster axis of a circle of radius 1 from the angle 0 to this one."""
    quarter = round(angle / QUARTER)
    return quarter * TICKS_OF_QUARTER + sin(angle - quarter * QUARTER)


def _angle_of(steps: float) -> float:
    """The angle to which so many of these steps lead."""
    quarter = round(steps / TICKS_OF_QUARTER)
    rest = steps - quarter * TICKS_OF_QUARTER
    return quarter * QUARTER + asin(max(-1.0, min(1.0, rest)))
