"""What may be true of one axis, for the travel guard: where its shaft is, and where it may go."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.families.mac.axis.model.kinematics import RAMP_LEVELS

FACTORY_PERIOD: Final = 0x0320
SLOWEST_TICKS: Final = 0xFFFF  # an increment at the slowest speed that can be asked for
SLOWEST_LEVEL_TICKS: Final = RAMP_LEVELS * SLOWEST_TICKS  # at the foot of the slowest ramp

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
    directions `directions`.  `held`: an endless motion that waits for 11h.  `may_move`: something
    may still be under way or stored; `segment_speed`: of the fastest segment among it.  `edge`: the
    counter where the reference contact was worked since it was read; `is_cut`: the supply was cut
    since then.  `is_worked`: the rig has done anything since then.  `begun_ns`: when a motion was
    last asked for; `begun_by`: the command that did.  `is_still`: it was seen to stand still since.
    `slowest_ticks`: what an increment of any motion asked for since it last was takes at most.
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
    is_armed: bool = False
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

    def level_ticks(self, index: int, parameter: int) -> int:
        """What an increment takes at the foot of the ramp of a motion asked for."""
        if not self.coefficient or index == 0x16:
            return 0  # no slower than any speed that can be asked for
        return RAMP_LEVELS * (parameter & 0xFFFF if index == 0x15 else self.period)

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
            is_armed=self.is_armed or other.is_armed,
            may_move=self.may_move or other.may_move,
            segment_speed=max(self.segment_speed, other.segment_speed),
            is_still=self.is_still and other.is_still,
            slowest_ticks=max(self.slowest_ticks, other.slowest_ticks),
        )
