"""What may be true of one axis, for the travel guard: where its shaft is, where it may go, and
whether its counter tells of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import signed
from axistwin_conformance.families.mac.axis.model.kinematics import (
    RAMP_LEVELS,
    TICKS_PER_SECOND,
)

FACTORY_PERIOD: Final = 0x0320
SLOWEST_TICKS: Final = 0xFFFF  # an increment at the slowest speed that can be asked for
SLOWEST_LEVEL_TICKS: Final = RAMP_LEVELS * SLOWEST_TICKS  # at the foot of the slowest ramp

ZERO_SLACK: Final = 2  # increments by which a cleared counter may swing
UNSHOWN: Final = 3  # motions in a row that the counter does not show: a stop bars one or two
UNSEEN: Final = "motions in a row have not changed its counter: the axis is moved no more"
STOPS_MODE: Final = 0x03  # 0: none of them
SHOWN_STEPS: Final = 16  # increments that any counter has counted of a motion of more
TICK_NS: Final = 1_000_000_000 // TICKS_PER_SECOND

Interval = tuple[int, int]


def join(*intervals: Interval) -> Interval:
    """The smallest interval around all of them."""
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def shift(interval: Interval, by: Interval) -> Interval:
    """Add two intervals."""
    return interval[0] + by[0], interval[1] + by[1]


@dataclass(frozen=True, slots=True)
class Axis:
    """What may be true of one axis.  Places are of the shaft, from where it was found.

    `reach`: where it is or may still go.  `counter`: what the counter was at `seen_ns`.  `tip`:
    where the last stored segment ends.  `target`: the counter a lone move goes to.  `speed`: of an
    endless motion (increments per second, 0: none) that may be running since `since_ns`, in the
    directions `directions`.  `is_armed`: by 10h, a motion held back or none; None: nobody knows.
    `is_filled`: if it is, a motion is held back.  `held`: it may be that endless one.  `may_move`:
    something may still be under way or stored; `segment_speed`: of the fastest segment among it.
    `edge`: the counter where the reference contact was worked since it was read; `is_cut`: the
    supply was cut since then.  `is_worked`: the rig has done anything since then.  `begun_ns`: when
    a motion was last asked for; `begun_by`: the command that did.  `is_still`: it was seen to stand
    still since.  `slowest_ticks`: what an increment of any motion asked for since it last was takes
    at most.
    """

    reach: Interval = (0, 0)
    counter: Interval = (0, 0)
    seen_ns: int = 0
    tip: Interval = (0, 0)
    offset: Interval = (0, 0)
    target: int | None = None
    period: int = FACTORY_PERIOD
    coefficient: int = 0
    speed: int = 0
    since_ns: int = 0
    begun_ns: int = 0
    directions: Interval = (0, 0)
    held: tuple[int, Interval] | None = None
    is_armed: bool | None = False
    is_filled: bool = False
    may_move: bool = False
    segment_speed: int = 0
    has_reference: bool = False
    edge: Interval | None = None
    is_cut: bool = False
    is_worked: bool = False
    begun_by: int = 0x13
    is_still: bool = False
    slowest_ticks: int = SLOWEST_LEVEL_TICKS

    def grown(self, now_ns: int) -> Axis:
        """The same with endless motion accounted for up to now."""
        if not self.speed:
            return self
        far = self.speed * max(0, now_ns - self.since_ns) // 1_000_000_000 + 1
        reach = (self.reach[0] + self.directions[0] * far, self.reach[1] + self.directions[1] * far)
        return replace(self, reach=reach, since_ns=now_ns)

    def counter_at(self, now_ns: int) -> Interval:
        """What the counter may be now, if nothing has cleared it since it was read."""
        if not self.may_move:
            return self.counter
        speed = max(self.speed, self.segment_speed, TICKS_PER_SECOND // self.period + 1)
        far = speed * max(0, now_ns - self.seen_ns) // 1_000_000_000 + ZERO_SLACK
        return self.counter[0] - far, self.counter[1] + far

    def level_ticks(self, index: int, parameter: int) -> int:
        """What an increment takes at the foot of the ramp of a motion asked for."""
        if not self.coefficient or index == 0x16:
            return 0  # no slower than any speed that can be asked for
        return RAMP_LEVELS * (parameter & 0xFFFF if index == 0x15 else self.period)

    def was_seen_at(self, counter: int) -> bool:
        """Whether it stood there when it was looked at, if nothing moved it that was asked to."""
        is_under_way = self.speed or self.segment_speed or self.is_worked
        return self.counter == (counter, counter) and not is_under_way

    def stepped(self, steps: int, coasting: int, period: int) -> Axis:
        """16h: one more segment is stored; behind the last one it may run on by so many."""
        end = shift(self.tip, (steps, steps))
        beyond = coasting if steps > 0 else -coasting
        tip = join(end, shift(end, (beyond, beyond)))
        return replace(
            self,
            reach=join(self.reach, tip),
            tip=tip,
            target=None,
            may_move=True,
            segment_speed=max(self.segment_speed, TICKS_PER_SECOND // period + 1),
        )

    def disarmed(self) -> Axis:
        """What 10h has begun is over."""
        return replace(self, held=None, is_armed=False, is_filled=False)

    def released(self, now_ns: int, *, is_permanent: bool) -> Axis:
        """11h: what is held runs, and nothing is armed any more, unless the device stays so; where
        nothing was held it may."""
        left = replace(self, held=None, is_filled=False)
        if not is_permanent:
            is_over = self.is_filled or self.is_armed is False
            left = replace(left, is_armed=False if is_over else None)
        if self.held is None:
            return left
        speed, directions = self.held
        return replace(
            left, speed=speed, directions=directions, since_ns=now_ns, may_move=True, target=None
        )

    def not_released(self) -> Axis:
        """11h is refused: what was to be held is not, and nothing may be armed (MACS-AMB-34)."""
        return self.disarmed() if self.is_filled else self.joined(self.disarmed())

    def joined(self, other: Axis) -> Axis:
        """Either of two; nobody knows which."""
        directions = join(self.directions, other.directions)
        return replace(
            other,
            reach=join(self.reach, other.reach),
            tip=join(self.tip, other.tip),
            counter=join(self.counter, other.counter),
            seen_ns=min(self.seen_ns, other.seen_ns),
            offset=join(self.offset, other.offset),
            target=self.target if self.target == other.target else None,
            period=min(self.period, other.period),
            coefficient=max(self.coefficient, other.coefficient),
            speed=max(self.speed, other.speed),
            since_ns=min(self.since_ns, other.since_ns) if self.speed else other.since_ns,
            directions=directions,
            held=self.held or other.held,
            is_armed=self.is_armed if self.is_armed is other.is_armed else None,
            is_filled=self.is_filled and other.is_filled,
            may_move=self.may_move or other.may_move,
            segment_speed=max(self.segment_speed, other.segment_speed),
            is_still=self.is_still and other.is_still,
            slowest_ticks=max(self.slowest_ticks, other.slowest_ticks),
        )


@dataclass(slots=True)
class Shown:
    """Whether the counter of one axis shows its motions: one that stands still while the shaft
    turns would let each motion begin where the last has ended.

    `due_ns`: when the motion that was begun last must have shown.  `unshown`: how many in a row
    have not.  `may_stop`: stops are switched on, and one may bar any motion.
    """

    counter: int | None = None
    due_ns: int | None = None
    unshown: int = 0
    may_stop: bool = False

    def heeded(self, axis: Axis, index: int, parameter: int, sent_ns: int, now_ns: int) -> None:
        """A command was accepted, some time between, by an axis of which that was known before."""
        if self.due_ns is not None and sent_ns < self.due_ns:
            self.due_ns = None  # whatever it was: too short a motion may show nothing
        if index == STOPS_MODE:
            self.may_stop = bool(parameter & 0xFF)
        steps = SHOWN_STEPS if index == 0x15 and parameter & 0xFFFF else 0
        if index in (0x13, 0x14):
            target = signed(parameter) if index == 0x13 else 0
            steps = min(SHOWN_STEPS, abs(target - axis.counter[0]))
        is_free = axis.is_armed is False and not (axis.may_move or self.may_stop)
        if steps > ZERO_SLACK and is_free:
            period = parameter & 0xFFFF if index == 0x15 else axis.period
            self.due_ns = now_ns + steps * RAMP_LEVELS * period * TICK_NS

    def seen(self, counter: int, sent_ns: int) -> str:
        """The counter was read then or later; why the axis must be moved no more, empty: it may."""
        if counter != self.counter:
            self.counter, self.due_ns, self.unshown = counter, None, 0
        elif self.due_ns is not None and sent_ns > self.due_ns:
            self.due_ns = None
            self.unshown += 1
        return f"{self.unshown} {UNSEEN}" if self.unshown >= UNSHOWN else ""
