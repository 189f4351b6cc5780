"""Speed over time: ramps between start speed and speed, as the profile has them.

A plan is a row of phases of constant acceleration.  Its first and last speed is the start speed, or
the speed itself where that is lower: then there are no ramps (MN4-MOT-10 to MN4-MOT-12).

    ramp length   n = (v^2 - S^2) / 2a        ramp time   (v - S) / a
    too short     peak = sqrt(S^2 + a L), where two ramps are longer than L
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import floor, isqrt
from typing import Final

ROOT_GRID: Final = 1 << 40
ZERO: Final = Fraction(0)


def root(square: Fraction) -> Fraction:
    """The square root, cut off to a grid of 2^-40."""
    scaled = square.numerator * ROOT_GRID * ROOT_GRID // square.denominator
    return Fraction(isqrt(scaled), ROOT_GRID)


@dataclass(frozen=True, slots=True)
class MotionProfile:
    """What F has set: `start` and `end` in steps/s, `acceleration` in steps/s^2.

    `acceleration` is the one that is in effect: what F was given times `accel_scale` (MN4-AMB-25).
    """

    start: int = 1000
    end: int = 5000
    acceleration: Fraction = Fraction(10_000)

    def ramp_length(self, low: Fraction, high: Fraction) -> Fraction:
        """How many steps it takes from one speed to another."""
        return (high * high - low * low) / (2 * self.acceleration)


DEFAULT_PROFILE: Final = MotionProfile()  # MN4-CMD-F-01


@dataclass(frozen=True, slots=True)
class SpeedPhase:
    """A stretch of constant acceleration: `seconds` long, from speed `entry` to speed `leaving`."""

    seconds: Fraction
    entry: Fraction
    leaving: Fraction

    @property
    def length(self) -> Fraction:
        """How many steps it makes."""
        return (self.entry + self.leaving) / 2 * self.seconds

    @property
    def acceleration(self) -> Fraction:
        """Steps/s^2; below 0 it brakes."""
        return (self.leaving - self.entry) / self.seconds

    def travelled(self, seconds: Fraction) -> Fraction:
        """Steps made so long after its beginning."""
        return self.entry * seconds + self.acceleration * seconds * seconds / 2

    def time_of(self, steps: Fraction) -> Fraction:
        """When so many steps of it are made."""
        if self.entry == self.leaving:
            return steps / self.entry
        speed = root(max(ZERO, self.entry**2 + 2 * self.acceleration * steps))
        return (speed - self.entry) / self.acceleration


class SpeedPlan:
    """Phases in a row, each beginning at the speed at which the one before has ended, or jumping
    from it as a contour's margin allows."""

    def __init__(self, *phases: SpeedPhase) -> None:
        self.phases = tuple(phase for phase in phases if phase.seconds > 0)

    @cached_property
    def seconds(self) -> Fraction:
        """From its beginning to its last step."""
        return sum((phase.seconds for phase in self.phases), ZERO)

    @cached_property
    def length(self) -> Fraction:
        """How many steps the major axis makes in all."""
        return sum((phase.length for phase in self.phases), ZERO)

    @property
    def peak(self) -> Fraction:
        """Its greatest speed; 0 for no motion."""
        speeds = (max(phase.entry, phase.leaving) for phase in self.phases)
        return max(speeds, default=ZERO)

    def travelled(self, seconds: Fraction) -> Fraction:
        """Steps of the major axis made by then."""
        made = ZERO
        for phase in self.phases:
            if seconds <= phase.seconds:
                return made + (phase.travelled(seconds) if seconds > 0 else 0)
            made += phase.length
            seconds -= phase.seconds
        return made

    def speed_at(self, seconds: Fraction) -> Fraction:
        """How fast the major axis is then; 0 before and after."""
        for phase in self.phases:
            if 0 <= seconds < phase.seconds:
                return phase.entry + phase.acceleration * seconds
            seconds -= phase.seconds
        return ZERO

    def time_of(self, steps: Fraction) -> Fraction:
        """When so many steps are made; when it ends, for more than there are."""
        begun = ZERO
        for phase in self.phases:
            if steps <= phase.length:
                return begun + phase.time_of(max(steps, ZERO))
            begun += phase.seconds
            steps -= phase.length
        return begun

    def steps_within(self, first: Fraction, last: Fraction, *, is_early: bool) -> tuple[int, int]:
        """The fewest and the most whole steps made at some time between the two.

        `is_early`: the k-th step comes at the beginning of its period (MN4-AMB-71), so that one
        more may be made at any time.
        """
        low, high = floor(self.travelled(first)), floor(self.travelled(last))
        more = 1 if is_early and last > 0 else 0
        return low, min(high + more, floor(self.length))

    def last_step_time(self, *, is_early: bool) -> Fraction:
        """When the last step is issued."""
        return self.time_of(self.length - 1) if is_early and self.length >= 1 else self.seconds


def constant(length: Fraction, speed: Fraction) -> SpeedPlan:
    """So many steps at one speed."""
    return SpeedPlan(SpeedPhase(length / speed, speed, speed))


def ramped(length: int | Fraction, speed: int, profile: MotionProfile) -> SpeedPlan:
    """A move of so many steps of the major axis at a speed (steps/s, more than 0), by the profile.

    Above the end speed the end speed is taken; below the start speed there is no ramp.
    """
    steps, start = Fraction(length), Fraction(profile.start)
    top = Fraction(min(speed, profile.end))
    if steps <= 0:
        return SpeedPlan()
    if top <= start:
        return constant(steps, top)
    ramp = profile.ramp_length(start, top)
    if 2 * ramp > steps:
        top = root(start * start + profile.acceleration * steps)
        return between(steps, start, top, start, profile)
    return between(steps, start, top, start, profile)


def between(
    steps: Fraction, entry: Fraction, top: Fraction, leaving: Fraction, profile: MotionProfile
) -> SpeedPlan:
    """So many steps that begin at one speed, reach `top` and end at another; what neither ramp
    takes is made at `top`."""
    up, down = profile.ramp_length(entry, top), profile.ramp_length(leaving, top)
    cruise = max(ZERO, steps - up - down)
    return SpeedPlan(
        SpeedPhase((top - entry) / profile.acceleration, entry, top),
        SpeedPhase(cruise / top, top, top),
        SpeedPhase((top - leaving) / profile.acceleration, top, leaving),
    )


@dataclass(frozen=True, slots=True)
class Halt:
    """A move brought to rest: how many steps of the major axis are made, and when it stands."""

    steps: Fraction
    seconds: Fraction


def halted(plan: SpeedPlan, at: Fraction, profile: MotionProfile, *, is_ramped: bool) -> Halt:
    """Where a move stands that is told to stop at a time.

    `is_ramped`: it brakes to the start speed first, where it is faster (MN4-PAU-01); it never goes
    beyond its end (MN4-PAU-02).
    """
    made, speed, start = plan.travelled(at), plan.speed_at(at), Fraction(profile.start)
    if not is_ramped or speed <= start:
        return Halt(made, min(at, plan.seconds))
    more = profile.ramp_length(start, speed)
    braking = (speed - start) / profile.acceleration
    return Halt(min(made + more, plan.length), at + braking)
