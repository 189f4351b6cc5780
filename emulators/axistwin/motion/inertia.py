"""A shaft that cannot change its speed at once.

Theory (MACS ledger §5.4)
-------------------------
Torque M on inertia J accelerates by α = M/J rad/s², which is a = α·R/2π inc/s² with R increments
per turn.  The drive lets the real speed slew towards the set-point's speed at that rate:

    speed      ┌──────────── set-point            lag grows by v²/2a while speeding up,
             ╱ │         │╲                       and shrinks by as much while slowing down,
           ╱   │ set     │  ╲  real               so a move still ends where it should
    ──────┴────┘         └────┴──────>

Rules
-----
1. A load torque works against speeding up and for slowing down.
2. The shaft never passes its set-point: on it, it slows down with it (the drive brakes as hard as
   it must).  Behind it, it slows down at the rate above.
3. The shaft comes to rest on the nearest increment.
4. Speed and position between increments are rational; whenever the speed has changed they are cut
   to 2^-48 inc and 2^-96 inc/ns, so that numbers do not grow with the length of a motion.
"""

from bisect import bisect_left
from collections.abc import Generator
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor

from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.motion.spans import Arc, Following, Span, Still, nearest_increment
from axistwin.motion.trajectory import TICK_NS, Leg, SetPoint

TWO_PI = Fraction(2 * 355, 113)  # 2π to 1 part in 10^7
KG_M2_PER_KG_CM2 = Fraction(1, 10_000)
EXACT_GRID = 1 << 48
SPEED_GRID = 1 << 96


@dataclass(frozen=True, slots=True)
class Mechanics:
    """What an inertial shaft is made of.

    ``friction_nm`` is the torque that slows an unpowered shaft down (> 0).
    """

    increments_per_turn: int
    rotor_inertia_kgcm2: Fraction
    friction_nm: Fraction = Fraction(2, 100)

    def acceleration(self, torque_nm: Fraction, load_inertia_kgcm2: Fraction) -> Fraction:
        """The rate (whole inc/s², as inc/ns²) that ``torque_nm`` gives rotor and load."""
        inertia_kgm2 = (self.rotor_inertia_kgcm2 + load_inertia_kgcm2) * KG_M2_PER_KG_CM2
        rate = floor(torque_nm / inertia_kgm2 * self.increments_per_turn / TWO_PI)
        return Fraction(rate, NS_PER_S**2)


def cut(value: Fraction, grid: int, direction: int) -> Fraction:
    """``value`` on a grid of 1/``grid``, rounded backward as seen in ``direction``."""
    return Fraction(direction * floor(direction * value * grid), grid)


def leg_speed(leg: Leg) -> Fraction:
    """The signed speed of a leg in increments per nanosecond."""
    return Fraction(leg.direction, leg.period_ticks * TICK_NS) if leg.direction else Fraction(0)


@dataclass(slots=True)
class Chase:
    """A shaft on its way behind a set-point of which count 0 lies at ``base``.

    ``exact`` and ``speed`` (inc/ns) describe it at ``now_ns``; ``on_set_point``: it makes every
    step of the set-point.  ``speeding`` and ``slowing`` are the rates of change in inc/ns² (> 0).
    """

    set_point: SetPoint
    base: int
    now_ns: Nanos
    exact: Fraction
    speed: Fraction
    on_set_point: bool
    speeding: Fraction
    slowing: Fraction

    def spans(self) -> Generator[Span, None, int | None]:
        """The spans until shaft and set-point rest for good; returns where, None if they never do.

        To be asked for once.
        """
        for leg in self.set_point.legs(self.now_ns):
            while leg.end_ns is None or self.now_ns < leg.end_ns:
                span = self._next_span(leg)
                if span is None:
                    break
                yield span
                if span.end_ns is None:
                    return None
                self.now_ns = span.end_ns
        return nearest_increment(self.exact, 1)

    def _next_span(self, leg: Leg) -> Span | None:
        """The span that begins now; None: at rest for good."""
        goal = leg_speed(leg)
        set_exact = self.base + leg.displacement + goal * (self.now_ns - leg.start_ns)
        if self.on_set_point:
            self.exact = set_exact
            if self._keeps_up(goal):
                self.speed = goal
                if goal == 0 and leg.end_ns is None:
                    return None
                return Following(self.now_ns, leg.end_ns, self.set_point, self.base)
            self.on_set_point = False
        return self._free_span(leg, goal, set_exact)

    def _keeps_up(self, goal: Fraction) -> bool:
        """Whether the new speed of the set-point is no faster and no other way."""
        return goal == self.speed or (abs(goal) <= abs(self.speed) and goal * self.speed >= 0)

    def _free_span(self, leg: Leg, goal: Fraction, set_exact: Fraction) -> Span | None:
        """The span of a shaft that is not on its set-point, or is about to leave it."""
        if self.speed == goal:
            return self._steady_span(leg, goal, set_exact)
        direction = _sign(self.speed) or _sign(goal)
        if abs(goal) > abs(self.speed) and goal * self.speed >= 0:
            return self._arc(leg, direction, goal, self.speeding * direction, None)
        goal = goal if goal * self.speed > 0 else Fraction(0)
        if direction * (set_exact - self.exact) <= 0:
            # On its set-point or beyond: it slows down at once.
            self._arrive(goal, direction)
            return self._next_span(leg)
        return self._arc(leg, direction, goal, -self.slowing * direction, set_exact)

    def _steady_span(self, leg: Leg, goal: Fraction, set_exact: Fraction) -> Span | None:
        """The span of a shaft that has the set-point's speed."""
        if set_exact == self.exact:
            self.on_set_point = True
            return self._next_span(leg)
        if goal == 0:
            position = nearest_increment(self.exact, 1)
            return None if leg.end_ns is None else Still(self.now_ns, leg.end_ns, position)
        start_ns, exact = self.now_ns, self.exact
        if leg.end_ns is not None:
            self.exact = exact + goal * (leg.end_ns - start_ns)
        return Arc(start_ns, leg.end_ns, leg.direction, exact, goal, Fraction(0))

    def _arc(
        self,
        leg: Leg,
        direction: int,
        goal: Fraction,
        rate: Fraction,
        set_exact: Fraction | None,
    ) -> Span:
        """Slew towards the speed ``goal``; with ``set_exact``, no further than the set-point."""
        arrival_ns = self.now_ns + ceil((goal - self.speed) / rate)
        end_ns = arrival_ns if leg.end_ns is None else min(arrival_ns, leg.end_ns)
        arc = Arc(self.now_ns, end_ns, direction, self.exact, self.speed, rate)
        meets = False
        if set_exact is not None:
            met_ns = _meeting_ns(arc, set_exact, leg_speed(leg), end_ns)
            meets = met_ns < end_ns
            end_ns = met_ns
        arc = Arc(self.now_ns, end_ns, direction, self.exact, self.speed, rate)
        self.exact = cut(arc.exact_at(end_ns), EXACT_GRID, direction)
        self.speed = cut(arc.speed_at(end_ns), SPEED_GRID, direction)
        if meets:
            # The set-point as it is at the meeting; a nanosecond's way is all that is cut off.
            assert set_exact is not None
            self.exact = set_exact + leg_speed(leg) * (end_ns - arc.start_ns)
        if meets or end_ns == arrival_ns:
            self._arrive(goal, direction)
        return arc

    def _arrive(self, goal: Fraction, direction: int) -> None:
        """Have the speed ``goal``; a shaft that comes to rest settles on an increment."""
        self.speed = goal
        if goal == 0:
            self.exact = Fraction(nearest_increment(self.exact, direction))


def _meeting_ns(arc: Arc, set_exact: Fraction, set_speed: Fraction, end_ns: Nanos) -> Nanos:
    """First time < ``end_ns`` at which the shaft has come up to the set-point, else ``end_ns``."""

    def is_there(now_ns: Nanos) -> bool:
        set_point = set_exact + set_speed * (now_ns - arc.start_ns)
        return arc.direction * (arc.exact_at(now_ns) - set_point) >= 0

    times = range(arc.start_ns, end_ns)
    index = bisect_left(times, True, key=is_there)
    return times[index] if index < len(times) else end_ns


def _sign(value: Fraction) -> int:
    return (value > 0) - (value < 0)
