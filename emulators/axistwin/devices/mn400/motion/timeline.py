r"""Where a motion is along its path at any time, in fixed-point integers.

Theory
------
A motion runs along one coordinate x, in ticks: one tick is a step of the major axis, or 1/m of it
with a multiplex of m.  Between two points the squared speed is linear in x (constant acceleration,
MN4-MOT-10), so a *glide* is two points and two speeds, and everything follows in closed form:

    v(x) = √(v0² + (v1² - v0²)·(x - x0)/(x1 - x0))        t(x) = t0 + 2·(x - x0)/(v0 + v(x))
    v(t) = v0 + (v1 - v0)·(t - t0)/T                      x(t) = x0 + (v0 + v(t))/2·(t - t0)

      v │      v1____v0          One formula serves ramps and cruises: with v0 = v1 the glide
        │     /        \         takes (x1 - x0)/v0.
        │  v0/          \v1
        └────┴──────────┴────> x

Units: x in 2^-40 ticks, v in 2^-40 ticks/s, t in 2^-32 ns.  An hour's rounding is far below 1 ns.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import isqrt
from operator import attrgetter
from typing import NamedTuple

from axistwin.kernel.time import NS_PER_S, Nanos

FINE = 40
ONE = 1 << FINE
"""A tick, a step or a step per second, in fixed point."""
TIME_FINE = 32
SECOND = NS_PER_S << TIME_FINE
HALF_NANO = 1 << (TIME_FINE - 1)


class Glide(NamedTuple):
    """Constant acceleration from (t0, x0, v0) to (x1, v1); x1 > x0 and v0 + v1 > 0."""

    t0: int
    x0: int
    x1: int
    v0: int
    v1: int

    def speed_at_x(self, x: int) -> int:
        """Speed at ``x`` within the glide."""
        if self.v0 == self.v1:
            return self.v0
        squared = self.v0 * self.v0
        gain = self.v1 * self.v1 - squared
        return isqrt(squared + gain * (x - self.x0) // (self.x1 - self.x0))

    def time_of(self, x: int) -> int:
        """When ``x``, which is within the glide, is reached."""
        distance = x - self.x0
        if not distance:
            return self.t0
        return self.t0 + 2 * distance * SECOND // (self.v0 + self.speed_at_x(x))

    def x_at(self, t: int) -> int:
        """Where the motion is at ``t``; beyond the glide: at its end."""
        elapsed = t - self.t0
        mean = self.v0 + self.speed_at(t)
        return min(self.x1, self.x0 + mean * elapsed // (2 * SECOND))

    def speed_at(self, t: int) -> int:
        """Speed at ``t`` within the glide."""
        duration = 2 * (self.x1 - self.x0) * SECOND // (self.v0 + self.v1)
        elapsed = min(t - self.t0, duration)
        return self.v0 + (self.v1 - self.v0) * elapsed // max(duration, 1)


class GlideShape(NamedTuple):
    """A glide without its place: distance and both speeds."""

    distance: int
    v0: int
    v1: int


@dataclass(frozen=True)
class Timeline:
    """Glides one behind the other from (t = 0, ``x0``) on; at their end the motion rests."""

    x0: int
    glides: tuple[Glide, ...]

    @classmethod
    def of(cls, x0: int, pieces: Iterable[GlideShape]) -> "Timeline":
        """The timeline of ``pieces`` from ``x0`` on; those of no length are left out."""
        glides = []
        t, x = 0, x0
        for distance, v0, v1 in pieces:
            if distance > 0:
                glide = Glide(t, x, x + distance, v0, v1)
                glides.append(glide)
                x += distance
                t = glide.time_of(x)
        return cls(x0, tuple(glides))

    @cached_property
    def x1(self) -> int:
        """Where the motion comes to rest."""
        return self.glides[-1].x1 if self.glides else self.x0

    @cached_property
    def duration_ns(self) -> Nanos:
        """How long it takes to rest."""
        return self.time_of(self.x1) or 0

    def time_of(self, x: int) -> Nanos | None:
        """When ``x`` is reached, in ns from the start on; None: it is not.

        What lies ahead comes a nanosecond later at the earliest: a step that is near when a motion
        is changed is a step of the motion that follows.
        """
        if x <= self.x0:
            return 0
        if x > self.x1:
            return None
        index = bisect_left(self.glides, x, key=attrgetter("x1"))
        return max(1, nearest_ns(self.glides[index].time_of(x)))

    def x_at(self, elapsed_ns: Nanos) -> int:
        """x after ``elapsed_ns`` >= 0."""
        t = elapsed_ns << TIME_FINE
        index = bisect_right(self._begins, t) - 1
        return self.x0 if index < 0 else self.glides[index].x_at(t)

    def state_at(self, elapsed_ns: Nanos) -> tuple[int, int]:
        """(x, speed) after ``elapsed_ns`` >= 0; speed 0 only at the final rest."""
        x, t = self.x_at(elapsed_ns), elapsed_ns << TIME_FINE
        index = bisect_right(self._begins, t) - 1
        return x, 0 if index < 0 or x == self.x1 else max(1, self.glides[index].speed_at(t))

    @cached_property
    def _begins(self) -> list[int]:
        """When each glide begins."""
        return [glide.t0 for glide in self.glides]


def nearest_ns(t: int) -> Nanos:
    """The nanosecond nearest to ``t``."""
    return (t + HALF_NANO) >> TIME_FINE
