r"""The lattice points of a circle, in the order of a clockwise turn, by formulas.

Theory (ledger §5.3)
--------------------
Around its centre a circle of squared radius ρ passes the axes at (0, r), r = round(√ρ).  Between
the diagonals one axis is dominant and makes a step with each tick; the other takes the nearest
point, y(x) = round(√(ρ - x²)).  With h the last x whose y(x) is not below it, a quarter from the
top to the right has Q = h + y(h) ticks, and after i of them the axis that leaves zero is at

        i <= h         i                        x dominant         top
        i >  h         y(Q - i)                 y dominant          ·──h
                                                                        \ y(h) - h = 0 or 1
    and the axis that comes to zero at the same of Q - i.               |
                                                                        · right, after Q

Each quarter is the one before with the axes exchanged, so everything about the whole turn, and any
number of turns, follows from this one function and its inverse.  x is at tick i what y is a quarter
earlier: y(i) = x(i + Q).
"""

from dataclasses import dataclass
from math import asin, cos, isqrt, pi, sin, sqrt

QUARTER = pi / 2
SIGNS = (1, 1, -1, -1)
"""Of x in the four quarters from the top, clockwise."""


@dataclass(frozen=True, slots=True)
class LatticeCircle:
    """A circle around the origin; ``squared`` is its radius to the second power, at least 1."""

    squared: int
    top: int
    """Where it passes the axes: steps of each axis in a quarter."""
    handover: int
    """h: the last tick in a quarter in which the axis that leaves zero is dominant."""
    quarter: int
    """Q: ticks of a quarter."""

    @classmethod
    def of(cls, squared: int) -> "LatticeCircle":
        """The circle of that squared radius."""
        handover = isqrt(squared // 2)
        while _nearest_root(squared - (handover + 1) ** 2) >= handover + 1:
            handover += 1
        ticks = handover + _nearest_root(squared - handover**2)
        return cls(squared, _nearest_root(squared), handover, ticks)

    def across(self, tick: int) -> int:
        """x after ``tick`` ticks from the top; y is ``across(tick + quarter)``."""
        number, inner = divmod(tick, self.quarter)
        return SIGNS[number % 4] * self._leaving(self.quarter - inner if number % 2 else inner)

    def steps_until(self, tick: int) -> int:
        """Steps of x in the first ``tick`` ticks from the top."""
        number, inner = divmod(tick, self.quarter)
        if number % 2:
            return (number + 1) * self.top - self._leaving(self.quarter - inner)
        return number * self.top + self._leaving(inner)

    def tick_of(self, n: int) -> int:
        """The tick from the top in which x makes its ``n``-th step [>= 1]."""
        number, inner = divmod(n - 1, self.top)
        base = number * self.quarter
        if number % 2:
            return base + self.quarter + 1 - self._first_at(self.top - inner)
        return base + self._first_at(inner + 1)

    def after(self, n: int) -> int:
        """x after its first ``n`` steps from the top."""
        number, inner = divmod(n, self.top)
        return SIGNS[number % 4] * (self.top - inner if number % 2 else inner)

    def heading(self, n: int) -> int:
        """Direction of x's ``n``-th step from the top."""
        return (1, -1, -1, 1)[(n - 1) // self.top % 4]

    def last_alike(self, n: int) -> int:
        """The last step of x, from the ``n``-th on, before it turns round."""
        return ((n - 1 + self.top) // (2 * self.top) * 2 + 1) * self.top

    def tick_at(self, x: int, y: int) -> int:
        """The tick [0..4Q) nearest to (x, y), which is not the origin, along the dominant axis."""
        number, leaving, coming = 0, x, y
        if x > 0 >= y:
            number, leaving, coming = 1, -y, x
        elif x <= 0 and y < 0:
            number, leaving, coming = 2, -x, -y
        elif x < 0 <= y:
            number, leaving, coming = 3, y, -x
        if leaving <= coming:
            inner = min(leaving, self.handover)
        else:
            inner = self.quarter - min(coming, self.handover)
        return (number * self.quarter + inner) % (4 * self.quarter)

    def smooth_tick(self, angle: float) -> float:
        """How many ticks from the top it is to ``angle``, clockwise and in radians, unrounded."""
        number, inner = divmod(angle, QUARTER)
        radius = self.quarter / sqrt(2)
        if inner <= QUARTER / 2:
            ticks = radius * sin(inner)
        else:
            ticks = self.quarter - radius * cos(inner)
        return number * self.quarter + ticks

    def smooth_angle(self, tick: float) -> float:
        """The angle after ``tick`` ticks from the top, not wrapped: the inverse of smooth_tick.

        It grows evenly, where that of the lattice point jumps.
        """
        number, inner = divmod(tick, self.quarter)
        radius = self.quarter / sqrt(2)
        if 2 * inner <= self.quarter:
            angle = asin(inner / radius)
        else:
            angle = QUARTER - asin((self.quarter - inner) / radius)
        return number * QUARTER + angle

    def _leaving(self, inner: int) -> int:
        """Of the axis that leaves zero: its place after ``inner`` ticks [0..Q] of a quarter."""
        if inner <= self.handover:
            return inner
        return _nearest_root(self.squared - (self.quarter - inner) ** 2)

    def _first_at(self, place: int) -> int:
        """The first tick of a quarter with the leaving axis at ``place`` [1..top] or beyond."""
        if place <= self.handover:
            return place
        return self.quarter - isqrt(self.squared - place * place + place - 1)


def _nearest_root(square: int) -> int:
    """The whole number nearest to the root; never a tie.  Of what is negative: -1."""
    return (isqrt(4 * square) + 1) // 2 if square >= 0 else -1
