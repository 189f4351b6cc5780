"""How fast each stretch of a motion may be entered and left: the look-ahead of the contours.

Theory (ledger §5.5)
--------------------
Stretch k has length L, a cap c, an entry speed u and an exit speed w, all in steps of its major
axis.  A straight move is a contour of one stretch.  Between neighbours lies a *seam*:

    ramp     w² <= u² + 2aL and u² <= w² + 2aL;  a flat stretch (c <= start speed, arcs): u = w
    soft     |ρ'·u' - ρ·w| <= margin for each axis: with r = ρ/ρ' the exit w allows entries from
             lo(w) = max(r·w - g/ρ') to hi(w) = min(r·w + g/ρ')
    hard     u' and w at most the speed of a corner, which is the start speed

         u'│        hi ╱ lo        The allowed pairs are a convex sliver from the origin to the
           │       ╱ ╱╱            point where lo and hi cross, if they do: a further cap.
           │    ╱╱ ╱               Up to there lo(w) <= hi(w), so that one sweep forward with hi
           │  ╱ ╱                  and one back with the inverse of lo reach the greatest plan.
           └──────────── w

Rules
-----
1. All seams begin soft.  One that leaves less than the corner's speed to either side, however slow
   its neighbours, becomes hard (MN4-CC-07).  Speeds only fall and seams only harden, hence the
   result does not depend on the order, and sweeps end when nothing changes.
2. All bounds are rounded down to 2^-40 steps/s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isqrt
from typing import NamedTuple

from axistwin.devices.mn400.motion.rules import MoveSettings, Quad
from axistwin.devices.mn400.motion.timeline import FINE, GlideShape

LIMITED_AXES = range(3)
"""The fourth axis is not considered at seams (MN4-CC-08)."""


class Stretch(NamedTuple):
    """A part of a motion with one programmed speed."""

    displacements: Quad
    length: int
    """Steps of the major axis, in fixed point."""
    speed: int
    """As programmed."""
    multiplex: int
    """Ticks in a step of the major axis."""
    is_ramped: bool = True
    is_joined: bool = False
    """Whether it goes on from the stretch before it without falling to start speed."""


@dataclass(frozen=True, slots=True)
class Seam:
    """What a seam allows: for each limited axis |enter·u' - leave·w| <= slack, and two caps."""

    lines: tuple[tuple[int, int, int], ...]
    """(leave, enter, slack) for each axis that moves the same way on both sides."""
    exit_cap: int
    entry_cap: int

    def highest_entry(self, w: int) -> int:
        """hi: the fastest entry behind an exit at ``w``."""
        entries = [(leave * w + slack) // enter for leave, enter, slack in self.lines]
        return min([self.entry_cap, *entries])

    def lowest_entry(self, w: int) -> int:
        """lo: the slowest entry behind an exit at ``w``."""
        return max([0, *(-((slack - leave * w) // enter) for leave, enter, slack in self.lines)])

    def highest_exit(self, u: int) -> int:
        """The fastest exit before an entry at ``u``, the inverse of lo."""
        exits = [(enter * u + slack) // leave for leave, enter, slack in self.lines]
        return min([self.exit_cap, *exits])


def _major(displacements: Quad) -> int:
    return max(range(4), key=lambda axis: (abs(displacements[axis]), -axis))


def seam_between(before: Quad, after: Quad, margin: int, settings: MoveSettings, top: int) -> Seam:
    """The seam between two displacements; ``top`` [fixed point] is faster than anything."""
    scope = settings.rules.cc_margin_scope
    long_before, long_after = (max(map(abs, one)) for one in (before, after))
    exits, entries, lines = [top], [top], []
    axes = list(LIMITED_AXES)
    if scope == "major_only":
        axes = sorted({_major(before), _major(after)})
    for axis in axes:
        leave, enter = abs(before[axis]) * long_after, abs(after[axis]) * long_before
        slack = margin * long_before * long_after << FINE
        is_reversal = before[axis] * after[axis] < 0
        if scope == "per_axis_equal":
            if difference := abs(before[axis] * long_after - after[axis] * long_before):
                exits.append(slack // difference)
        elif is_reversal or not (leave and enter):
            share = 2 if is_reversal else 1
            exits += [slack // (share * leave)] if leave else []
            entries += [slack // (share * enter)] if enter else []
        else:
            lines.append((leave, enter, slack))
    if scope == "per_axis_equal":
        lines, entries = [(1, 1, 0)], exits
    exit_cap, entry_cap = min(exits), min(entries)
    for leave_lo, enter_lo, slack in lines:
        for leave_hi, enter_hi, _ in lines:
            closing = leave_lo * enter_hi - leave_hi * enter_lo
            if closing > 0:
                exit_cap = min(exit_cap, slack * (enter_hi + enter_lo) // closing)
    seam = Seam(tuple(lines), exit_cap, entry_cap)
    return Seam(seam.lines, exit_cap, seam.highest_entry(exit_cap))


class Limits(NamedTuple):
    """Of one stretch: top speed, speed at its corners and at the ends of the motion; fixed."""

    cap: int
    corner: int
    end: int
    is_flat: bool
    gain: int
    """2·a·L: what the squared speed can gain."""

    def reachable(self, speed: int) -> int:
        """The speed at one end that a ramp reaches from ``speed`` at the other."""
        return speed if self.is_flat else isqrt(speed * speed + self.gain)

    def pieces(self, u: int, w: int, length: int) -> list[GlideShape]:
        """Ramp up, cruise and ramp down over ``length``, between ``u`` and ``w``."""
        if self.is_flat:
            return [GlideShape(length, u, u)]
        u2, w2 = u * u, w * w
        peak2 = max(u2, w2, min(self.cap * self.cap, (self.gain + u2 + w2) // 2))
        peak = isqrt(peak2)
        up = (peak2 - u2) * length // self.gain if self.gain else 0
        down = (peak2 - w2) * length // self.gain if self.gain else 0
        up = min(up, length)
        down = min(down, length - up)
        return [
            GlideShape(up, u, peak),
            GlideShape(length - up - down, peak, peak),
            GlideShape(down, peak, w),
        ]


def limits_of(stretch: Stretch, settings: MoveSettings, feed_permille: int) -> Limits:
    """The limits of ``stretch``, at that share of its speed."""
    cap = settings.cap(stretch.speed, stretch.multiplex, feed_permille) << FINE
    start = settings.profile.start << FINE
    is_flat = not stretch.is_ramped or cap <= start
    end = cap if is_flat else start
    has_slow_corners = settings.rules.cc_corner_speed == "margin" and not is_flat
    corner = min(end, 2 << FINE) if has_slow_corners else end
    gain = (settings.twice_acceleration * stretch.length) << FINE
    return Limits(cap, corner, end, is_flat, gain)


class SpeedPlan:
    """The fastest entries and exits of stretches, from ``entry`` (None: from rest) to rest."""

    def __init__(
        self, limits: Sequence[Limits], seams: Sequence[Seam | None], entry: int | None = None
    ) -> None:
        """``seams``: one fewer than limits; None: both sides come down to start speed."""
        self.limits = limits
        self.entries = [limit.cap for limit in limits]
        self.exits = list(self.entries)
        first = limits[0].end
        self.entries[0] = first if entry is None else min(limits[0].cap, max(entry, first))
        self.exits[-1] = limits[-1].end
        self.seams: list[Seam] = []
        for seam, (before, after) in zip(seams, pairwise(limits), strict=True):
            seam = seam or Seam((), before.end, after.end)
            self.seams.append(seam)
            if seam.exit_cap < before.corner or seam.entry_cap < after.corner:
                self._harden(len(self.seams) - 1)
        while self._forward() | self._backward():
            pass

    def _forward(self) -> bool:
        """Lower what the speeds before it do not reach; whether anything changed."""
        changed = False
        for index, limit in enumerate(self.limits):
            reachable = limit.reachable(self.entries[index])
            if reachable < self.exits[index]:
                self.exits[index], changed = reachable, True
            if index < len(self.seams):
                highest = self.seams[index].highest_entry(self.exits[index])
                changed |= self._lower(index, self.seams[index].exit_cap, highest)
        return changed

    def _backward(self) -> bool:
        """Lower what cannot slow down in time; whether anything changed."""
        changed = False
        for index in range(len(self.limits) - 1, -1, -1):
            reachable = self.limits[index].reachable(self.exits[index])
            if reachable < self.entries[index]:
                self.entries[index], changed = reachable, True
            if index:
                seam = self.seams[index - 1]
                highest = seam.highest_exit(self.entries[index])
                changed |= self._lower(index - 1, highest, seam.entry_cap)
        return changed

    def _lower(self, index: int, exit_top: int, entry_top: int) -> bool:
        """Lower both sides of a seam to the tops, or to its corner speeds if a top is below."""
        before, after = self.limits[index], self.limits[index + 1]
        if exit_top < before.corner or entry_top < after.corner:
            exit_top, entry_top = self._harden(index)
        changed = exit_top < self.exits[index] or entry_top < self.entries[index + 1]
        self.exits[index] = min(self.exits[index], exit_top)
        self.entries[index + 1] = min(self.entries[index + 1], entry_top)
        return changed

    def _harden(self, index: int) -> tuple[int, int]:
        """From now on both sides keep to their corner speeds, which are returned."""
        corners = self.limits[index].corner, self.limits[index + 1].corner
        self.seams[index] = Seam((), *corners)
        return corners
