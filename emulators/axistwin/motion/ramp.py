"""The 16-level ramp of the MAC family: periods, profiles, and planning anew in mid-motion.

Theory (MACS ledger §5.2, §5.3, §5.7)
-------------------------------------
A ramp of coefficient AA is N = 120·AA increments long.  Speed rises over 16 levels k/16 of the
full speed, the 16th being full speed itself.  Constant acceleration gives every level the same
time, hence increments in proportion to k: 1+2+…+15 = 120.

    period of level k    A = round(16·P / k)             P = period at full speed, in ticks
    level of counter j   k = min{k : AA·k(k+1)/2 > j}    j = ramp increments climbed, 0..N

                 ┌────────────┐            increments  k·AA each level, 120·AA in all
              ┌──┘  cruise, P └──┐         ticks       16·AA·P each level, 240·AA·P in all
           ┌──┘                  └──┐
    ───────┘ climb, j -> N   j -> 0 └───

With r increments left, what comes next at an increment's end is (incremental form of §5.3)

    r >= j+2 and j < N    climb:    period A[j],   then j+1
    else r >= j+1         hold:     period A[j], or P if j = N
    else                  descend:  period A[j-1], then j-1

so from any (j, r) the whole remainder is one climb, one hold and one descent, and is written down
at once (``plan``).  If r < j (the origin was moved under way) the descent passes the target.

Rules
-----
1. The increment in progress is finished first, on its period; whatever changes, changes at its end.
2. ``RampedMotion`` is immutable.  ``stop``, ``change_speed`` and ``retarget`` give the motion that
   follows, with equal counts up to the end of the increment in progress.
3. AA = 0: no ramp in either direction; changes and stops act at the next increment.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import lru_cache
from itertools import chain
from operator import sub
from typing import NamedTuple

from axistwin.kernel.time import Nanos
from axistwin.motion.trajectory import Piece, StepPhase, Trajectory, merged

FULL_LEVEL = 16
INCREMENTS_PER_AA = 120


class RampLaw(StrEnum):
    """How the 16 levels share the ramp's increments (MACS-AMB-42)."""

    EQUAL_TIME = "equal_time"
    EQUAL_INCREMENTS = "equal_increments"


class Rounding(StrEnum):
    """How a level's period becomes whole ticks (MACS-AMB-43)."""

    HALF_UP = "half_up"
    FLOOR = "floor"
    CEIL = "ceil"

    def divide(self, dividend: int, divisor: int) -> int:
        """``dividend / divisor`` as an integer; both positive."""
        if self is Rounding.FLOOR:
            return dividend // divisor
        if self is Rounding.CEIL:
            return -(-dividend // divisor)
        return (2 * dividend + divisor) // (2 * divisor)

    def divide_by_each(self, dividend: int, divisors: Iterable[int]) -> list[int]:
        """``divide`` by each of ``divisors``."""
        if self is Rounding.HALF_UP:
            return [(2 * dividend + divisor) // (2 * divisor) for divisor in divisors]
        return [self.divide(dividend, divisor) for divisor in divisors]


class TriangleLaw(StrEnum):
    """The top of a move too short for full speed (ledger §5.11).

    MIRROR: the second half mirrors the first, an odd middle increment runs on the level reached.
    SHARED_PEAK: where two increments share the middle, both run at the next counter's level.
    """

    MIRROR = "mirror"
    SHARED_PEAK = "shared_peak"


class ChangeLaw(StrEnum):
    """A change of speed in motion (MACS-AMB-44): its length in increments.

    RAMP_LENGTH: always N.  CONSTANT_ACCELERATION: as many as the acceleration of the ramp from
    rest takes for that difference of speeds.  STEP: none, the next increment has the new period.
    """

    RAMP_LENGTH = "ramp_length"
    CONSTANT_ACCELERATION = "constant_acceleration"
    STEP = "step"


class StopLaw(StrEnum):
    """A ramped stop in mid-ramp (MACS-AMB-45): descend what was climbed, or always N increments."""

    CLIMBED = "climbed"
    RAMP_LENGTH = "ramp_length"


@dataclass(frozen=True, slots=True)
class RampRules:
    """The readings of the manual that a ramp is built by; defaults are the ledger's."""

    ramp_law: RampLaw = RampLaw.EQUAL_TIME
    rounding: Rounding = Rounding.HALF_UP
    triangle_law: TriangleLaw = TriangleLaw.MIRROR
    change_law: ChangeLaw = ChangeLaw.RAMP_LENGTH
    stop_law: StopLaw = StopLaw.CLIMBED
    step_phase: StepPhase = StepPhase.END


DEFAULT_RULES = RampRules()


def ramp_length(aa: int) -> int:
    """N, the increments of a whole ramp of coefficient ``aa`` [0..255]."""
    return INCREMENTS_PER_AA * aa


@lru_cache(maxsize=256)
def level_bounds(length: int, law: RampLaw) -> tuple[int, ...]:
    """Where each level ends, in increments of a ramp of ``length`` (a multiple of 120) from rest.

    15 entries under equal time, 16 under equal increments; the last is ``length``.
    """
    if law is RampLaw.EQUAL_INCREMENTS:
        return tuple(length * k // FULL_LEVEL for k in range(1, FULL_LEVEL + 1))
    aa = length // INCREMENTS_PER_AA
    return tuple(aa * k * (k + 1) // 2 for k in range(1, FULL_LEVEL))


@dataclass(frozen=True, slots=True)
class Ramp:
    """The table A for one full-speed period: the period of every ramp increment."""

    period_ticks: int
    aa: int
    rules: RampRules = DEFAULT_RULES
    length: int = field(init=False, repr=False, compare=False)
    """N: the ramp counter at full speed."""
    _bounds: tuple[int, ...] = field(init=False, repr=False, compare=False)
    _whole: list[Piece] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        length = ramp_length(self.aa)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "_bounds", level_bounds(length, self.rules.ramp_law))
        object.__setattr__(self, "_whole", [])

    def at(self, period_ticks: int) -> "Ramp":
        """The same ramp to another full speed."""
        return Ramp(period_ticks, self.aa, self.rules)

    def level_at(self, counter: int) -> int:
        """The level [1..16] of the increment that a climb starts at ``counter`` [0..N]."""
        return FULL_LEVEL if counter >= self.length else bisect_right(self._bounds, counter) + 1

    def level_period(self, level: int) -> int:
        """The period in ticks of ``level`` [1..16]."""
        return self.rules.rounding.divide(FULL_LEVEL * self.period_ticks, level)

    def period_at(self, counter: int) -> int:
        """A[counter], and P at N; the period on which the speed is held at that counter."""
        return self.level_period(self.level_at(counter))

    def climb(self, low: int, high: int) -> list[Piece]:
        """The increments that take the counter from ``low`` up to ``high`` (<= N)."""
        if low >= high:
            return []
        whole = self._levels
        first, last = bisect_right(self._bounds, low), bisect_left(self._bounds, high)
        pieces = whole[first : last + 1]
        if low:
            ahead = (self._bounds[first] if first < last else high) - low
            pieces[0] = Piece(ahead, pieces[0].period_ticks)
        if first < last or not low:
            begin = self._bounds[last - 1] if last else 0
            pieces[-1] = Piece(high - begin, pieces[-1].period_ticks)
        return pieces

    @property
    def _levels(self) -> list[Piece]:
        """The climb to N, level by level; found out when it is first needed."""
        if not self._whole:
            ends, full_ticks = self._bounds, FULL_LEVEL * self.period_ticks
            levels = range(1, len(ends) + 1)
            periods = self.rules.rounding.divide_by_each(full_ticks, levels)
            self._whole.extend(map(Piece, map(sub, ends, (0, *ends)), periods))
        return self._whole

    def descend(self, high: int) -> list[Piece]:
        """The increments that take the counter from ``high`` down to 0: the climb mirrored."""
        return self.climb(0, high)[::-1]


class Phase(NamedTuple):
    """Increments in which the ramp counter changes evenly.

    ``counter`` is j before the first of them, ``slope`` its change with each (+1, 0, -1).
    ``ramp`` is what the counter counts on; None in a transition between two speeds, where the
    level in use is itself taken for full speed.
    """

    pieces: tuple[Piece, ...]
    counter: int
    slope: int
    ramp: Ramp | None

    @property
    def increments(self) -> int | None:
        """How many increments the phase has; None for an endless one."""
        total = 0
        for increments, _ in self.pieces:
            if increments is None:
                return None
            total += increments
        return total


def plan(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
    """The rest of a move from an increment's end: ``counter`` climbed, ``remaining`` to go.

    ``remaining`` may be below ``counter``, even negative: then the descent passes the target.
    """
    spare = max(0, remaining - counter)
    climbed = min(ramp.length - counter, spare // 2)
    peak = counter + climbed
    held = spare - 2 * climbed
    up = tuple(ramp.climb(counter, peak))
    down = tuple(ramp.descend(peak)) if counter else up[::-1]
    shared = ramp.rules.triangle_law is TriangleLaw.SHARED_PEAK
    if shared and held == 0 and climbed and peak < ramp.length:
        up, down = _share_peak(ramp, counter, peak)
    hold = (Piece(held, ramp.period_at(peak)),) if held else ()
    return (
        Phase(up, counter, 1, ramp),
        Phase(hold, peak, 0, ramp),
        Phase(down, peak, -1, ramp),
    )


def _share_peak(ramp: Ramp, low: int, peak: int) -> tuple[tuple[Piece, ...], tuple[Piece, ...]]:
    """Climb and descent whose two middle increments run one counter higher than mirrored ones."""
    top = Piece(1, ramp.period_at(peak))
    up = merged((*ramp.climb(low, peak - 1), top))
    down = merged((top, *ramp.descend(peak - 1)))
    return up, down


def plan_endless(ramp: Ramp, counter: int = 0) -> tuple[Phase, ...]:
    """Climb from ``counter`` to full speed and stay there."""
    return (
        Phase(tuple(ramp.climb(counter, ramp.length)), counter, 1, ramp),
        Phase((Piece(None, ramp.period_ticks),), ramp.length, 0, ramp),
    )


def joined(phases: Sequence[Phase]) -> tuple[Piece, ...]:
    """The increments of ``phases`` as merged pieces."""
    return merged(chain.from_iterable([phase.pieces for phase in phases]))


def stop_pieces(
    counter: int, period_ticks: int, aa: int, rules: RampRules = DEFAULT_RULES
) -> tuple[Piece, ...]:
    """The descent to rest of an axis that has climbed ``counter`` [0..N] increments."""
    return merged(Ramp(period_ticks, aa, rules).descend(counter))


_SHARES = [(FULL_LEVEL * k - k * (k + 1) // 2, k * (k + 1) // 2) for k in range(1, FULL_LEVEL)]
"""What the two speeds contribute to the end of each level of a transition (ledger §5.7)."""


def change_length(
    old_ticks: int, new_ticks: int, aa: int, rules: RampRules, first_ticks: int
) -> int:
    """Increments of the transition between two speeds, by the rules' change law (MACS-AMB-44).

    ``first_ticks`` is the full-speed period of the ramp from rest whose acceleration counts.
    """
    if rules.change_law is ChangeLaw.STEP:
        return 0
    length = ramp_length(aa)
    if rules.change_law is ChangeLaw.RAMP_LENGTH:
        return length
    # v² = 2·a·s: from rest to 1/first in N increments, so N·first²·|1/new² - 1/old²| here.
    difference = abs(old_ticks**2 - new_ticks**2) * first_ticks**2
    return length * difference // (old_ticks * new_ticks) ** 2


def change_pieces(
    old_ticks: int,
    new_ticks: int,
    aa: int,
    rules: RampRules = DEFAULT_RULES,
    first_ticks: int | None = None,
) -> tuple[Piece, ...]:
    """The transition from period ``old_ticks`` to ``new_ticks`` in motion (ledger §5.7).

    15 levels linear in speed, equal in time; from rest it would be table A.  Under equal
    increments 16 levels of equal share.  Empty for AA = 0.  ``first_ticks`` (default: the new
    period) matters to constant acceleration only.
    """
    length = change_length(old_ticks, new_ticks, aa, rules, first_ticks or new_ticks)
    if not length:
        return ()
    if rules.ramp_law is RampLaw.EQUAL_INCREMENTS:
        ends = [length * k // FULL_LEVEL for k in range(1, FULL_LEVEL + 1)]
    else:  # b_k of ledger §5.7
        total = INCREMENTS_PER_AA * (old_ticks + new_ticks)
        ends = [
            length * (new_ticks * to_come + old_ticks * passed) // total
            for to_come, passed in _SHARES
        ]
    dividend, difference = FULL_LEVEL * old_ticks * new_ticks, old_ticks - new_ticks
    speeds = [FULL_LEVEL * new_ticks + k * difference for k in range(1, len(ends) + 1)]
    periods = rules.rounding.divide_by_each(dividend, speeds)
    return merged(map(Piece, map(sub, ends, (0, *ends)), periods))


class Boundary(NamedTuple):
    """The axis at the end of increment ``number``, the one in progress: here plans change.

    ``counter`` and ``ramp`` hold from there on.  ``running_ticks`` is the period of the increment
    in progress; None when the motion has not begun.
    """

    number: int
    end_ns: Nanos
    counter: int
    ramp: Ramp
    running_ticks: int | None


@dataclass(frozen=True, slots=True)
class RampedMotion:
    """A motion with ramps, to a target or endless, and all that may become of it.

    ``target`` is the count at which the target lies (None: no target); ``stopping`` tells that a
    ramped stop was ordered.  ``first_ticks`` is the full-speed period of the ramp from rest.
    Built by ``to_target``, ``endless`` or ``taking_over``.
    """

    trajectory: Trajectory
    phases: tuple[Phase, ...]
    ramp: Ramp
    target: int | None
    first_ticks: int
    stopping: bool = False

    @classmethod
    def to_target(
        cls, start_ns: Nanos, direction: int, distance: int, ramp: Ramp
    ) -> "RampedMotion":
        """A move from rest by ``distance`` (>= 0) increments in ``direction`` (+1 or -1)."""
        assert distance >= 0, f"distance {distance} is negative; the sign belongs to the direction"
        phases = plan(ramp, 0, distance)
        trajectory = Trajectory(start_ns, direction, joined(phases), ramp.rules.step_phase)
        return cls(trajectory, phases, ramp, distance, ramp.period_ticks)

    @classmethod
    def at_rest(cls, start_ns: Nanos, direction: int, ramp: Ramp) -> "RampedMotion":
        """What a stop leaves of a motion whose profile was over: no way to go, no target ahead."""
        return replace(cls.to_target(start_ns, direction, 0, ramp), stopping=True)

    @classmethod
    def endless(cls, start_ns: Nanos, direction: int, ramp: Ramp) -> "RampedMotion":
        """An endless motion from rest in ``direction`` at the ramp's full speed."""
        phases = plan_endless(ramp)
        trajectory = Trajectory(start_ns, direction, joined(phases), ramp.rules.step_phase)
        return cls(trajectory, phases, ramp, None, ramp.period_ticks)

    @classmethod
    def taking_over(
        cls, step_start_ns: Nanos, direction: int, running_ticks: int, ramp: Ramp
    ) -> "RampedMotion":
        """An endless motion out of one at constant speed that had no ramp (MACS-AMB-30).

        The increment in progress began at ``step_start_ns`` on ``running_ticks`` and is number 1;
        then comes the transition to the ramp's full speed.
        """
        running = ramp.at(running_ticks)
        progress = Phase((Piece(1, running_ticks),), ramp.length, 0, running)
        first_ticks = ramp.period_ticks
        phases = (progress, *_plan_change(running_ticks, ramp, first_ticks))
        trajectory = Trajectory(step_start_ns, direction, joined(phases), ramp.rules.step_phase)
        return cls(trajectory, phases, ramp, None, first_ticks)

    @property
    def end_ns(self) -> Nanos | None:
        """When the profile is over; None for an endless one."""
        return self.trajectory.end_ns

    @property
    def overshoot(self) -> int:
        """Increments by which the profile ends beyond its target (>= 0)."""
        total = self.trajectory.total_increments
        return 0 if total is None or self.target is None else total - self.target

    def is_over(self, now_ns: Nanos) -> bool:
        """Whether the profile is complete at ``now_ns``."""
        return self.end_ns is not None and now_ns >= self.end_ns

    def counter_at(self, now_ns: Nanos) -> int:
        """j, the ramp increments climbed, as of the increments complete at ``now_ns``."""
        return self._state_after(self.trajectory.completed_at(now_ns))[0]

    def level_at(self, now_ns: Nanos) -> int:
        """Level [0..16] of the increment in progress on its ramp; 0 at rest, 16 in a transition."""
        running_ticks = self.trajectory.period_at(now_ns)
        if running_ticks is None:
            return 0
        ramp = self._state_after(self.trajectory.completed_at(now_ns) + 1)[1]
        levels = (k for k in range(1, FULL_LEVEL) if ramp.level_period(k) <= running_ticks)
        return next(levels, FULL_LEVEL)

    def stop(self, now_ns: Nanos) -> "RampedMotion":
        """Ramp down from the increment in progress on; its end is the new target (MACS-CMD-17-01).

        A motion that is over, or is stopping already, stays as it is.
        """
        if self.stopping or self.is_over(now_ns):
            return self
        at = self._boundary(now_ns)
        if at.running_ticks is not None and self._stops_on_whole_ramp(at):
            ramp = at.ramp.at(at.running_ticks)
            descent = Phase(tuple(ramp.descend(ramp.length)), ramp.length, -1, ramp)
        else:
            descent = Phase(tuple(at.ramp.descend(at.counter)), at.counter, -1, at.ramp)
        trajectory, phases = self._going_on(at, (descent,))
        target = trajectory.total_increments
        return RampedMotion(trajectory, phases, at.ramp, target, self.first_ticks, stopping=True)

    def change_speed(self, now_ns: Nanos, period_ticks: int) -> "RampedMotion":
        """Go on endlessly at ``period_ticks`` (>= 1), same direction (MACS-CMD-15-02, ledger §5.7).

        The motion must not be over.  A target and an ordered stop are given up.
        """
        assert not self.is_over(now_ns), "a motion that is over has no speed to change"
        at = self._boundary(now_ns)
        ramp = self.ramp.at(period_ticks)
        if at.running_ticks is None:
            return RampedMotion.endless(at.end_ns, self.trajectory.direction, ramp)
        phases = _plan_change(at.running_ticks, ramp, self.first_ticks)
        return RampedMotion(*self._going_on(at, phases), ramp, None, self.first_ticks)

    def retarget(self, now_ns: Nanos, remaining: int) -> "RampedMotion":
        """Let the target lie ``remaining`` increments ahead of the present count.

        Negative: it lies behind.  For a running move whose origin was moved (MACS-AMB-52, -53).
        A motion that is stopping, over or without a target stays as it is.  A target short of the
        braking distance is passed (``overshoot``).
        """
        if self.stopping or self.target is None or self.is_over(now_ns):
            return self
        target = self.trajectory.increments_at(now_ns) + remaining
        at = self._boundary(now_ns)
        phases = plan(at.ramp, at.counter, target - at.number)
        return RampedMotion(*self._going_on(at, phases), at.ramp, target, self.first_ticks)

    def returning(self) -> "RampedMotion | None":
        """The move from rest, back to a target that was passed; None if it was not.

        It starts when this one is over (ledger §5.3).
        """
        end_ns = self.end_ns
        if end_ns is None or self.overshoot <= 0:
            return None
        return RampedMotion.to_target(end_ns, -self.trajectory.direction, self.overshoot, self.ramp)

    def _state_after(self, count: int) -> tuple[int, Ramp]:
        """Ramp counter and ramp after ``count`` increments of the motion."""
        assert self.phases, "a motion has at least one phase"
        left = count - self.trajectory.before
        counter, ramp = self.phases[0].counter, self.phases[0].ramp or self.ramp
        for phase in self.phases:
            if not left:
                break
            increments = phase.increments
            taken = left if increments is None or left < increments else increments
            if taken:
                counter = phase.counter + phase.slope * taken
                ramp = phase.ramp or self._level_in_use(count)
            left -= taken
        return counter, ramp

    def _level_in_use(self, count: int) -> Ramp:
        """The ramp of which increment ``count``, in a transition, is the full speed."""
        return self.ramp.at(self.trajectory.period_of(count))

    def _stops_on_whole_ramp(self, at: Boundary) -> bool:
        """Whether a stop takes N increments from the level in use, not those climbed."""
        if self.ramp.rules.stop_law is StopLaw.CLIMBED:
            return False
        descending = self.target is not None and self.target - at.number <= at.counter
        return at.counter < at.ramp.length and not descending

    def _boundary(self, now_ns: Nanos) -> Boundary:
        """Where the increment in progress ends (the start, if none is); the motion is not over."""
        trajectory = self.trajectory
        if now_ns < trajectory.start_ns:
            counter, ramp = self._state_after(trajectory.before)
            return Boundary(trajectory.before, trajectory.start_ns, counter, ramp, None)
        count = trajectory.completed_at(now_ns) + 1
        counter, ramp = self._state_after(count)
        running_ticks = trajectory.period_at(now_ns)
        return Boundary(count, trajectory.boundary_ns(count), counter, ramp, running_ticks)

    def _going_on(
        self, at: Boundary, phases: tuple[Phase, ...]
    ) -> tuple[Trajectory, tuple[Phase, ...]]:
        """This motion up to the boundary ``at``, then ``phases``: anew, with all its phases."""
        old, start_ns, before = self.trajectory, at.end_ns, at.number
        if at.running_ticks is not None:
            start_ns, before = old.boundary_ns(at.number - 1), at.number - 1
            progress = Phase((Piece(1, at.running_ticks),), at.counter, 0, at.ramp)
            phases = (progress, *phases)
        pieces = joined(phases)
        return Trajectory(start_ns, old.direction, pieces, old.step_phase, before), phases


def _plan_change(running_ticks: int, ramp: Ramp, first_ticks: int) -> tuple[Phase, ...]:
    """From the period ``running_ticks`` to the ramp's full speed, and on without end."""
    pieces = change_pieces(running_ticks, ramp.period_ticks, ramp.aa, ramp.rules, first_ticks)
    return (
        Phase(pieces, ramp.length, 0, None),
        Phase((Piece(None, ramp.period_ticks),), ramp.length, 0, ramp),
    )
