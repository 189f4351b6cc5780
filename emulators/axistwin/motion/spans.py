"""Stretches of time in which the shaft's position is one closed formula.

The future of a shaft is a row of spans, each valid from ``start_ns`` up to (not including)
``end_ns``, where the next begins; None: for good.  Positions are whole increments and change
monotonically inside a span.
"""

from bisect import bisect_left
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor
from typing import Final, NamedTuple, Protocol

from axistwin.kernel.time import Nanos
from axistwin.motion.trajectory import TICK_NS, SetPoint, Trajectory

NO_SPEED: Final = Fraction(0)


def nearest_increment(exact: Fraction, direction: int) -> int:
    """Where a shaft that moved in ``direction`` settles: the nearest increment, halves forward."""
    return direction * floor(direction * exact + Fraction(1, 2))


class Span(Protocol):
    """What all spans offer; times given lie inside the span."""

    @property
    def start_ns(self) -> Nanos:
        """When it begins."""

    @property
    def end_ns(self) -> Nanos | None:
        """When the next one begins; None: never."""

    def position_at(self, now_ns: Nanos) -> int:
        """The position in increments."""

    def exact_at(self, now_ns: Nanos) -> Fraction:
        """The position with the part of the next increment that is under way."""

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """The signed speed in increments per nanosecond."""

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at ``position``, were the span endless; None: never."""


class Still(NamedTuple):  # made for every look at a shaft: a third of a frozen dataclass's time
    """The shaft does not move."""

    start_ns: Nanos
    end_ns: Nanos | None
    position: int

    def position_at(self, now_ns: Nanos) -> int:
        """The one position there is."""
        return self.position

    def exact_at(self, now_ns: Nanos) -> Fraction:
        """The one position there is."""
        return Fraction(self.position)

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """None."""
        return NO_SPEED

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """At once or never."""
        return after_ns if position == self.position else None


class Following(NamedTuple):
    """The shaft makes every step of the set-point, ``offset`` increments away from its count."""

    start_ns: Nanos
    end_ns: Nanos | None
    set_point: SetPoint
    offset: int

    def position_at(self, now_ns: Nanos) -> int:
        """The set-point's count, displaced."""
        return self.offset + self.set_point.displacement_at(now_ns)

    def exact_at(self, now_ns: Nanos) -> Fraction:
        """The position and the part of the set-point's increment under way."""
        return self.state_at(now_ns)[0]

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """The set-point's speed."""
        return self.state_at(now_ns)[1]

    def state_at(self, now_ns: Nanos) -> tuple[Fraction, Fraction]:
        """``exact_at`` and ``speed_at``."""
        leg, position = self.set_point.leg_at(now_ns), self.position_at(now_ns)
        if not leg.direction:
            return Fraction(position), NO_SPEED
        period_ns = leg.period_ticks * TICK_NS
        part_ns = (now_ns - leg.start_ns) % period_ns
        exact = Fraction(position * period_ns + leg.direction * part_ns, period_ns)
        return exact, Fraction(leg.direction, period_ns)

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """When the set-point gets there."""
        return self.set_point.reach_ns(position - self.offset, after_ns)


@dataclass(frozen=True, slots=True)
class Stepping:
    """The shaft makes the steps of a trajectory of its own: the catch-up."""

    start_ns: Nanos
    end_ns: Nanos | None
    trajectory: Trajectory
    origin: int

    def position_at(self, now_ns: Nanos) -> int:
        """Where the steps have taken it."""
        return self.origin + self.trajectory.displacement_at(now_ns)

    def exact_at(self, now_ns: Nanos) -> Fraction:
        """Whole increments: between two steps of the catch-up the shaft rests."""
        return Fraction(self.position_at(now_ns))

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """The rate of the steps."""
        period_ticks = self.trajectory.pieces[0].period_ticks
        return Fraction(self.trajectory.direction, period_ticks * TICK_NS)

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """When the steps get there."""
        return self.trajectory.reach_ns(position - self.origin, after_ns)


@dataclass(frozen=True, slots=True)
class Arc:
    """Constant acceleration, in one ``direction`` (+1 or -1), the speed never changing sign.

    ``exact`` in increments, ``speed`` in inc/ns, ``acceleration`` in inc/ns², all at ``start_ns``.
    An increment counts when it is complete.  Without an end there is no acceleration.
    """

    start_ns: Nanos
    end_ns: Nanos | None
    direction: int
    exact: Fraction
    speed: Fraction
    acceleration: Fraction

    def position_at(self, now_ns: Nanos) -> int:
        """The increments complete."""
        return self.direction * floor(self.direction * self.exact_at(now_ns))

    def exact_at(self, now_ns: Nanos) -> Fraction:
        """x + v·t + a·t²/2."""
        elapsed = now_ns - self.start_ns
        return self.exact + (self.speed + self.acceleration * elapsed / 2) * elapsed

    def speed_at(self, now_ns: Nanos) -> Fraction:
        """v + a·t."""
        return self.speed + self.acceleration * (now_ns - self.start_ns)

    @property
    def rest(self) -> int:
        """Where a shaft settles that comes to rest at the end; there must be one."""
        assert self.end_ns is not None, "an endless arc has no place of rest"
        return nearest_increment(self.exact_at(self.end_ns), self.direction)

    def reach_ns(self, position: int, after_ns: Nanos) -> Nanos | None:
        """The first whole nanosecond at or beyond ``position``; None also if that is at the end."""
        ahead = self.direction * (position - self.position_at(after_ns))
        if ahead <= 0:
            return after_ns if ahead == 0 else None
        if self.end_ns is None:
            return self.start_ns + ceil((position - self.exact) / self.speed)
        times = range(after_ns, self.end_ns)
        index = bisect_left(
            times, self.direction * position, key=lambda t: self.direction * self.position_at(t)
        )
        return times[index] if index < len(times) else None
