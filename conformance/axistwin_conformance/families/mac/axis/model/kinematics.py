"""What the axis must do, in closed form: how many steps are done at a time, when step n is done.

Written from chapter 5 of the ledger.  All times are whole ticks of 0.125 µs, all distances whole
increments ("steps").  Increment i takes T(i) ticks; it counts when it ends.

    period     16P  16P/2 16P/3 ...                       P  = full speed
               |----|--|-|  climb, 15 levels  |.. cruise ..|  descent, mirrored  |
    steps       AA  2AA 3AA   ... 15AA  = 120·AA = N

A profile is a row of runs (count, period), so the longest motion costs as much as the shortest.

What the manual leaves open is a field of `Law`, its default first.  Rounding (MACS-AMB-43) cannot
be seen on a serial line, so every prediction exists twice: rounded up, the slow one, and rounded
down, the fast one; a real axis lies between them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final, Generic, Self, TypeVar, overload

TICK_NS: Final = 125
TICKS_PER_SECOND: Final = 8_000_000
RAMP_INCREMENTS_PER_COEFFICIENT: Final = 120  # MACS-CMD-0F-01
RAMP_LEVELS: Final = 16
CATCH_UP_UNIT_TICKS: Final = 1600  # 200 µs, MACS-CMD-0E-01


Value = TypeVar("Value")


class once(Generic[Value]):  # noqa: N801 - used like `property`
    """An attribute computed when it is first asked for: `cached_property` without its lock, which
    costs more than most of what is computed here."""

    def __init__(self, compute: Callable[[Any], Value]) -> None:
        self._compute, self._name, self.__doc__ = compute, compute.__name__, compute.__doc__

    @overload
    def __get__(self, instance: None, owner: type) -> Self: ...

    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...

    def __get__(self, instance: object | None, owner: type) -> Self | Value:
        if instance is None:
            return self
        value = instance.__dict__[self._name] = self._compute(instance)
        return value


@dataclass(frozen=True, slots=True)
class Law:
    """The readings of §5.11 that shape a profile; `rounding` picks one edge of the prediction."""

    ramp: str = "equal_time"  # or "equal_increments", MACS-AMB-42
    triangle: str = "mirror"  # or "shared_peak", §5.11
    change: str = "ramp_length"  # or "constant_acceleration", "step", MACS-AMB-44
    stop: str = "climbed"  # or "ramp_length", MACS-AMB-45
    step: str = "end"  # or "start": when an increment counts, MACS-AMB-41; or "either", untold
    rounding: str = "half_up"  # or "down", "up", MACS-AMB-43

    @property
    def leads(self) -> tuple[bool, ...]:
        """Whether an increment may count when it ends, and whether when it begins."""
        return {"end": (False,), "start": (True,), "either": (False, True)}[self.step]


def divide(numerator: int, denominator: int, rounding: str) -> int:
    """Divide two positive numbers with the named rounding."""
    if rounding == "down":
        return numerator // denominator
    if rounding == "up":
        return -(-numerator // denominator)
    return (2 * numerator + denominator) // (2 * denominator)


@dataclass(slots=True, unsafe_hash=True)
class EvenRun:
    """`count` increments of `period` ticks each; an endless run has count None.  A value."""

    count: int | None
    period: int


@dataclass(unsafe_hash=True)
class Profile:
    """A row of runs, a value.  Only the last run may be endless."""

    runs: tuple[EvenRun, ...]

    @once
    def _starts(self) -> tuple[list[int], list[int]]:
        """Steps and ticks at which each run begins."""
        done, passed = 0, 0
        steps, ticks = [0], [0]
        for run in self.runs:
            if run.count is None:
                break
            done += run.count
            passed += run.count * run.period
            steps.append(done)
            ticks.append(passed)
        return steps, ticks

    @property
    def turns(self) -> list[int]:
        """The ticks at which each run begins, and the last one ends."""
        return self._starts[1]

    @once
    def is_endless(self) -> bool:
        """True if the motion goes on until something stops it."""
        return bool(self.runs) and self.runs[-1].count is None

    @once
    def steps(self) -> int | None:
        """All increments of the motion; None if endless."""
        return None if self.is_endless else self._starts[0][-1]

    @once
    def ticks(self) -> int | None:
        """The duration of the motion; None if endless."""
        return None if self.is_endless else self._starts[1][-1]

    def steps_by(self, ticks: int) -> int:
        """Increments complete `ticks` after the start: max{n : C(n) ≤ ticks}."""
        if ticks < 0 or not self.runs:
            return 0
        first_steps, first_ticks = self._starts
        at = bisect_right(first_ticks, ticks) - 1
        if at >= len(self.runs):
            return first_steps[-1]
        return first_steps[at] + (ticks - first_ticks[at]) // max(1, self.runs[at].period)

    def ticks_of(self, steps: int) -> int:
        """C(n): the ticks after which `steps` increments are complete (within the motion)."""
        first_steps, first_ticks = self._starts
        at = min(bisect_right(first_steps, steps) - 1, len(self.runs) - 1)
        if at < 0:
            return 0
        return first_ticks[at] + (steps - first_steps[at]) * self.runs[at].period

    def period_of(self, step: int) -> int:
        """T(i): the period of increment number `step`, counted from 0."""
        at = min(bisect_right(self._starts[0], step) - 1, len(self.runs) - 1)
        return self.runs[at].period

    def first(self, steps: int) -> Profile:
        """The first `steps` increments only."""
        first_steps, first_ticks = self._starts
        at = bisect_right(first_steps, steps) - 1
        left = steps - first_steps[at]
        if at == len(self.runs) or not left:
            return Profile(self.runs[:at])
        last = EvenRun(left, self.runs[at].period)
        shorter = Profile((*self.runs[:at], last))
        passed = first_ticks[at] + left * last.period
        vars(shorter)["_starts"] = [*first_steps[: at + 1], steps], [*first_ticks[: at + 1], passed]
        return shorter

    def then(self, more: Iterable[EvenRun]) -> Profile:
        """This motion, which must have an end, and then `more`."""
        assert not self.is_endless, "nothing follows an endless run"
        return Profile(self.runs + _tidy(more))


def _tidy(runs: Iterable[EvenRun]) -> tuple[EvenRun, ...]:
    return tuple([run for run in runs if run.count is None or run.count > 0])


# --- the ramp ------------------------------------------------------------------------------------
#
# The same few ramps are asked for all the time, and each motion twice: at both edges of a window.


@lru_cache(maxsize=1024)
def ramp(period: int, coefficient: int, law: Law) -> tuple[EvenRun, ...]:
    """The climb from rest to `period`: levels of k/16 of the full speed (§5.2)."""
    if law.ramp == "equal_time":
        counts = [level * coefficient for level in range(1, RAMP_LEVELS)]
    else:
        edges = [15 * coefficient * level // 2 for level in range(RAMP_LEVELS + 1)]
        counts = [after - before for before, after in pairwise(edges)]
    return _tidy(
        EvenRun(count, divide(RAMP_LEVELS * period, level, law.rounding))
        for level, count in enumerate(counts, start=1)
    )


def ramp_increments(coefficient: int) -> int:
    """N, the increments of a whole ramp (MACS-CMD-0F-01)."""
    return RAMP_INCREMENTS_PER_COEFFICIENT * coefficient


def _mirrored(runs: Sequence[EvenRun]) -> list[EvenRun]:
    return list(reversed(runs))


@lru_cache(maxsize=1024)
def _descent(base: int, coefficient: int, law: Law, climbed: int) -> list[EvenRun]:
    """The way down from the level that `climbed` increments of a ramp lead to."""
    return _mirrored(Profile(ramp(base, coefficient, law)).first(climbed).runs)


@lru_cache(maxsize=1024)
def move(distance: int, period: int, coefficient: int, law: Law) -> Profile:
    """A point-to-point move over `distance` ≥ 0 increments: T(i) of §5.3."""
    climb = Profile(ramp(period, coefficient, law))
    length = ramp_increments(coefficient)
    up, down = min(length, (distance + 1) // 2), min(length, distance // 2)
    rising, falling = climb.first(up), climb.first(down)
    if law.triangle == "shared_peak" and up == down and up > 0 and distance <= 2 * length:
        peak = climb.period_of(up) if up < length else period
        rising, falling = (
            part.first(up - 1).then([EvenRun(1, peak)]) for part in (rising, falling)
        )
    cruise = EvenRun(distance - up - down, period)
    return Profile(_tidy([*rising.runs, cruise, *_mirrored(falling.runs)]))


@lru_cache(maxsize=1024)
def climb_and_cruise(period: int, coefficient: int, law: Law) -> Profile:
    """The endless motion of 15h from rest: climb, then `period` for ever (§5.7)."""
    return Profile((*ramp(period, coefficient, law), EvenRun(None, period)))


@lru_cache(maxsize=1024)
def transition(before: int, after: int, coefficient: int, law: Law) -> tuple[EvenRun, ...]:
    """The increments that lead from period `before` to `after` (§5.7), without the cruise."""
    if law.change == "step" or coefficient == 0:
        return ()
    runs, last = [], 0
    for level in range(1, RAMP_LEVELS):
        edge_units = after * (16 * level - level * (level + 1) // 2)
        edge_units += before * level * (level + 1) // 2
        if law.change == "constant_acceleration":  # of the climb to the speed before: no exact rule
            edge = coefficient * edge_units * abs(before - after) // (after * after)
        else:
            edge = coefficient * edge_units // (before + after)
        speed_units = (RAMP_LEVELS - level) * after + level * before
        period = divide(RAMP_LEVELS * before * after, speed_units, law.rounding)
        runs.append(EvenRun(edge - last, period))
        last = edge
    return tuple(runs)


# --- motions that are changed or stopped under way -----------------------------------------------


@dataclass
class Course:
    """A motion of 13h, 14h or 15h with what a later command must know of its past; a value, not
    frozen for the sake of speed.

    `base`: the period the ramp is built from; `coefficient`: AA; `distance`: of 13h and 14h only;
    `changed_at`, `changed_until`: the steps between which a speed change happens, if one was
    ordered, and `before`, the course it changed; `descent_at`: the step from which an ordered
    stop slows the axis down.
    """

    profile: Profile
    base: int
    coefficient: int
    law: Law
    distance: int | None = None
    changed_at: int | None = None
    changed_until: int = 0
    before: Course | None = None
    descent_at: int | None = None

    @classmethod
    def to_position(cls, distance: int, period: int, coefficient: int, law: Law) -> Course:
        """A 13h or 14h over `distance` ≥ 0 increments."""
        profile = move(distance, period, coefficient, law)
        return cls(profile, period, coefficient, law, distance=distance)

    @classmethod
    def endless(cls, period: int, coefficient: int, law: Law) -> Course:
        """A 15h from rest."""
        return cls(climb_and_cruise(period, coefficient, law), period, coefficient, law)

    @property
    def is_plain(self) -> bool:
        """True if nothing has changed it since it began."""
        return self.changed_at is None and self.descent_at is None

    def rounded(self, law: Law) -> Course:
        """A plain course, as another rounding makes it."""
        if self.distance is None:
            return Course.endless(self.base, self.coefficient, law)
        return Course.to_position(self.distance, self.base, self.coefficient, law)

    def _climbed(self, done: int) -> int:
        """The ramp counter j after `done` increments, none of them of a descent."""
        length = ramp_increments(self.coefficient)
        if self.changed_at is not None:
            return length
        limit = length if self.distance is None else min(length, self.distance // 2)
        return min(done, limit)

    def _is_descending(self, done: int) -> bool:
        if self.descent_at is not None:
            return done >= self.descent_at  # a second stop in that very increment adds nothing
        if self.distance is None:
            return False
        return done > self.distance - min(ramp_increments(self.coefficient), self.distance // 2)

    def stopped(self, ticks: int) -> Course:
        """The course when 17h, or 15h with period 0, arrives `ticks` after the start.

        The increment in progress is finished first; then the climbed increments are descended.
        """
        done = self.profile.steps_by(ticks) + 1
        if self.before is not None and done == self.changed_at:
            return self.before.stopped(ticks)  # the change had not begun: nothing to descend from
        whole = self.profile.steps
        if (whole is not None and done >= whole) or self._is_descending(done):
            return self
        climbed = self._climbed(done)
        base = self.base
        if self.changed_at is not None and done <= self.changed_until:
            base = self.profile.period_of(done - 1)  # from the level in use
        if self.law.stop == "ramp_length":
            climbed = ramp_increments(self.coefficient)
        descent = _descent(base, self.coefficient, self.law, climbed)
        profile = self.profile.first(done).then(descent)
        return Course(
            profile,
            self.base,
            self.coefficient,
            self.law,
            None,
            self.changed_at,
            self.changed_until,
            self.before,
            done,
        )

    def changed(self, ticks: int, period: int) -> Course:
        """The course when 15h asks for `period` > 0, `ticks` after the start."""
        done = self.profile.steps_by(ticks) + 1
        before = self.profile.period_of(done - 1)
        runs = transition(before, period, self.coefficient, self.law)
        profile = self.profile.first(done).then([*runs, EvenRun(None, period)])
        length = sum(run.count or 0 for run in runs)
        return Course(
            profile,
            period,
            self.coefficient,
            self.law,
            changed_at=done,
            before=self,
            changed_until=done + length,
        )
