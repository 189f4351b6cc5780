"""Arcs and helices: a way along a lattice circle, a tail to the exact destination, a traverse.

Rules
-----
1. Clockwise is from Y to X, with X to the right and Y up in the order of P (MN4-ARC-01).  The
   other direction is the mirror image.
2. The arc follows the points of the lattice circle through its start.  A rounded destination lies
   beside it; the last few ticks go straight to it, so that it is exact and no axis makes more than
   one step in a tick (MN4-ARC-03, MN4-ARC-04).
3. The traverse follows the swept angle of all turns, not the ticks (MN4-HEL-02): its n-th step
   lies where the angle is (n - 1/2)/|zd| of the whole, between the ticks if need be.
4. A helix takes as many ticks as the circle or the traverse, whichever are more.  If the traverse,
   it is the traverse that steps with each tick, and x goes with the angle: both are even.
5. ``arc_rate`` tangential: x is the length along the circle in place of ticks (MN4-AMB-27).
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import atan2, tau
from typing import NamedTuple

from axistwin.devices.mn400.motion.circle import LatticeCircle
from axistwin.devices.mn400.motion.lookahead import Stretch
from axistwin.devices.mn400.motion.motion import VectorMotion
from axistwin.devices.mn400.motion.moves import Part, assembled, compensation
from axistwin.devices.mn400.motion.paths import Path, PathSlice, StraightPath
from axistwin.devices.mn400.motion.rules import AXES, MotionRules, MoveSettings, Quad
from axistwin.devices.mn400.motion.timeline import FINE, ONE
from axistwin.kernel.time import Nanos

TAIL_MAX = 4
"""How many ticks before the end the tail may begin."""

SURELY = 1 / 256
"""Of a step: so near to one, and rounding decides whether it is made (it is far less)."""

Point = tuple[int, int]


class Plane(NamedTuple):
    """Command P: the X and Y motors and the traverse motor, counted from 0."""

    x: int = 0
    y: int = 2
    z: int = 1


class Turn(NamedTuple):
    """What an arc is made of, seen from the centre and clockwise."""

    circle: LatticeCircle
    first: int
    """Tick of the start, from the top."""
    ticks: int
    """Ticks along the circle; the tail comes behind."""
    sweep: float
    """The whole angle, turns included."""


@dataclass(frozen=True)
class ArcPath:
    """An arc of ``plane``; steps are numbered along the way, in both directions."""

    plane: Plane
    turn: Turn
    tail: StraightPath
    """From the circle to the destination: axis 0 is x, axis 1 is y."""
    is_clockwise: bool
    traverse: int
    length: int
    """Where the arc ends, in fixed point."""
    is_by_angle: bool
    """x goes with the swept angle, not with the ticks of the circle."""
    is_commanded: bool = True

    @cached_property
    def ticks(self) -> int:
        """Ticks of the circle and the tail."""
        return self.turn.ticks + self.tail.ticks

    def total(self, axis: int) -> int:
        """All steps of ``axis``."""
        if axis == self._traverse_axis:
            return abs(self.traverse)
        if (shift := self._shifts[axis]) is None:
            return 0
        return self._on_circle[shift][1] + self.tail.total(_tail_axis(shift))

    def place(self, axis: int, n: int) -> int:
        """x of the ``n``-th step."""
        if axis == self._traverse_axis:
            return self._place_of_traverse(n)
        shift = self._shifts[axis]
        assert shift is not None, "a step of an axis outside the plane"
        circle, first, ticks, _ = self.turn
        before, on_circle, _ = self._on_circle[shift]
        if n <= on_circle:
            return self._place_of_tick(circle.tick_of(before + n) - first - shift)
        tail_tick = self.tail.place(_tail_axis(shift), n - on_circle) >> FINE
        return self._place_of_tick(ticks + tail_tick)

    def taken(self, axis: int, x: int) -> int:
        """Steps up to and including ``x``."""
        if axis == self._traverse_axis:
            return self._traversed(x) if self.traverse else 0
        if (shift := self._shifts[axis]) is None:
            return 0
        tick = self._tick_at(x)
        circle, first, ticks, _ = self.turn
        before, on_circle, _ = self._on_circle[shift]
        if tick <= ticks:
            return circle.steps_until(first + shift + tick) - before
        return on_circle + self.tail.taken(_tail_axis(shift), (tick - ticks) << FINE)

    def displacement(self, axis: int, n: int) -> int:
        """Where ``axis`` is after ``n`` steps."""
        if axis == self._traverse_axis:
            return n if self.traverse > 0 else -n
        if (shift := self._shifts[axis]) is None:
            return 0
        circle = self.turn.circle
        before, most, start = self._on_circle[shift]
        on_circle = min(n, most)
        here = circle.after(before + on_circle) if on_circle else start
        on_tail = self.tail.displacement(_tail_axis(shift), n - on_circle)
        return self._mirror(shift) * (here - start + on_tail)

    def heading(self, axis: int, n: int) -> int:
        """Direction of the ``n``-th step."""
        if axis == self._traverse_axis:
            return 1 if self.traverse > 0 else -1
        shift = self._shifts[axis]
        assert shift is not None, "a step of an axis outside the plane"
        before, on_circle, _ = self._on_circle[shift]
        if n > on_circle:
            return self._mirror(shift) * self.tail.heading(_tail_axis(shift), 1)
        return self._mirror(shift) * self.turn.circle.heading(before + n)

    def last_alike(self, axis: int, n: int) -> int:
        """The last step from the ``n``-th on before the axis turns round, or the tail begins."""
        shift = self._shifts[axis]
        if shift is None:
            return self.total(axis)
        before, on_circle, _ = self._on_circle[shift]
        if n > on_circle:
            return self.total(axis)
        return min(on_circle, self.turn.circle.last_alike(before + n) - before)

    @cached_property
    def _shifts(self) -> tuple[int | None, ...]:
        """How far ahead of x's, along the circle, each axis' place is; None: not in the plane."""
        place = {self.plane.y: self.turn.circle.quarter, self.plane.x: 0}
        return tuple(map(place.get, AXES))

    @cached_property
    def _traverse_axis(self) -> int | None:
        """P1,2 is legal while the traverse motor is still 2: then it has no traverse."""
        return self.plane.z if self._shifts[self.plane.z] is None else None

    def _mirror(self, shift: int) -> int:
        return 1 if shift or self.is_clockwise else -1

    @cached_property
    def _on_circle(self) -> Mapping[int, tuple[int, int, int]]:
        """By shift: steps from the top to the start, from there to the tail; where the start is."""
        circle, first, ticks, _ = self.turn
        before = {shift: circle.steps_until(first + shift) for shift in (0, circle.quarter)}
        return {
            shift: (
                steps,
                circle.steps_until(first + shift + ticks) - steps,
                circle.across(first + shift),
            )
            for shift, steps in before.items()
        }

    def _place_of_tick(self, tick: int) -> int:
        """x at the end of ``tick`` [0..ticks]."""
        if not self.is_by_angle:
            return -(-tick * self.length // self.ticks)
        circle, first, ticks, _ = self.turn
        x = self.length * ticks // self.ticks
        if tick >= ticks:
            return x + (self.length - x) * (tick - ticks) // max(1, self.tail.ticks)
        first %= circle.quarter  # each quarter alike, also where floats are rounded
        start = circle.smooth_angle(first)
        swept, whole = (circle.smooth_angle(first + n) - start for n in (tick, ticks))
        return min(x, int(x * (swept / whole)))

    def _tick_at(self, x: int) -> int:
        """The last tick that ends up to ``x``."""
        if not self.ticks:  # it ends where it begins (MN4-AMB-29)
            return 0
        if not self.is_by_angle:
            return min(x * self.ticks // self.length, self.ticks)
        return bisect_right(range(1, self.ticks + 1), x, key=self._place_of_tick)

    def _traversed(self, x: int) -> int:
        """Steps of the traverse motor up to ``x``."""
        circle, _, _, sweep = self.turn
        share = min(max(x, 0) / self.length, 1.0)
        if sweep and not self.is_by_angle:
            first, start, whole = self._smooth
            share = (circle.smooth_angle(first + whole * share) - start) / sweep
        last = abs(self.traverse)
        n, beyond = divmod(last * share + 0.5, 1)
        n = int(n)
        if SURELY < beyond < 1 - SURELY:
            return n
        while n < last and self._place_of_traverse(n + 1) <= x:
            n += 1
        while n and self._place_of_traverse(n) > x:
            n -= 1
        return n

    def _place_of_traverse(self, n: int) -> int:
        """x of the ``n``-th step of the traverse motor."""
        circle, _, _, sweep = self.turn
        share = (2 * n - 1) / (2 * abs(self.traverse))
        if sweep and not self.is_by_angle:
            first, start, whole = self._smooth
            share = (circle.smooth_tick(start + sweep * share) - first) / whole
        return min(self.length, int(self.length * share))

    @cached_property
    def _smooth(self) -> tuple[int, float, float]:
        """Tick of the start in its quarter, its angle, and the ticks of the whole angle."""
        circle, first, _, sweep = self.turn
        first %= circle.quarter
        start = circle.smooth_angle(first)
        return first, start, circle.smooth_tick(start + sweep) - first


def arc_is_round(rules: MotionRules, center: Point, destination: Point) -> bool:
    """Whether start and destination have one radius, within the tolerance (MN4-ARC-02)."""
    squared, other = _square(center), _square(_minus(destination, center))
    tolerance = rules.radius_tolerance
    # |√a - √b| <= t  is  a + b - t² <= 2·√(a·b)
    excess = squared + other - tolerance**2
    return squared > 0 and other > 0 and (excess <= 0 or excess**2 <= 4 * squared * other)


def arc(
    now_ns: Nanos,
    settings: MoveSettings,
    plane: Plane,
    center: Point,
    destination: Point,
    clockwise: bool,
) -> VectorMotion:
    """An arc around ``center`` to ``destination``, both seen from the start (MN4-CMD-A-01)."""
    return helix(now_ns, settings, plane, center, destination, clockwise)


def helix(
    now_ns: Nanos,
    settings: MoveSettings,
    plane: Plane,
    center: Point,
    destination: Point,
    clockwise: bool,
    traverse: int = 0,
    turns: int = 0,
) -> VectorMotion:
    """``turns`` [>= 0] whole turns and an arc, while plane.z makes ``traverse`` steps."""
    rules = settings.rules
    keeps_zero = rules.arc_zero_sweep == "full"
    if turns:
        keeps_zero = rules.helix_zero_final == "full"
    path = arc_path(
        rules,
        plane,
        center,
        destination,
        is_clockwise=clockwise,
        traverse=traverse,
        turns=turns,
        is_full_at_zero=keeps_zero,
        is_pulsed=settings.speed < 0,
    )
    directions = [path.heading(axis, 1) if path.total(axis) else 0 for axis in AXES]
    first, second, third, fourth = directions
    lash = compensation(settings, (first, second, third, fourth))
    return assembled(now_ns, settings, [*lash, *_parts(settings, path)])


def _parts(settings: MoveSettings, path: ArcPath) -> Iterator[Part]:
    """The arc in one, or cut where an axis with backlash turns round (MN4-AMB-58)."""
    cuts: dict[int, list[int]] = {}
    if settings.rules.backlash_arc == "quadrants":
        for axis in AXES:
            for before, x in _reversals(path, axis) if settings.lash[axis] else ():
                cuts.setdefault(x, [0, 0, 0, 0])[axis] = before
    x0 = 0
    for x in [*sorted(cuts), path.length]:
        part = PathSlice(path, x0, x) if cuts else path
        stretch = Stretch(
            _ends(part), part.length, settings.speed, 1, is_ramped=settings.rules.arc_ramp
        )
        yield Part(part, stretch, settings.speed < 0)
        if x in cuts:
            first, second, third, fourth = cuts[x]
            turning = (-first, -second, -third, -fourth)
            yield from compensation(settings, turning, (first, second, third, fourth))
        x0 = x


def _reversals(path: ArcPath, axis: int) -> Iterator[tuple[int, int]]:
    """(direction up to there, x) of each place, between two ticks, where ``axis`` turns round."""
    last = 0
    while last < path.total(axis):
        if last and path.heading(axis, last) != path.heading(axis, last + 1):
            tick_start = (path.place(axis, last + 1) - 1) >> FINE << FINE
            yield path.heading(axis, last), max(path.place(axis, last), tick_start)
        last = path.last_alike(axis, last + 1)


def arc_path(
    rules: MotionRules,
    plane: Plane,
    center: Point,
    destination: Point,
    *,
    is_clockwise: bool,
    traverse: int,
    turns: int,
    is_full_at_zero: bool,
    is_pulsed: bool = False,
) -> ArcPath:
    """The way of an arc; ``is_full_at_zero``: a sweep of nothing is a whole turn (MN4-AMB-29)."""
    start, goal = _minus((0, 0), center), _minus(destination, center)
    if not is_clockwise:
        start, goal = (-start[0], start[1]), (-goal[0], goal[1])
    circle = LatticeCircle.of(_square(start))
    first = circle.tick_at(*start)
    sweep, ticks = _final_sweep(circle, start, goal, is_full_at_zero)
    ticks, tail = _tail_to(circle, first, ticks, goal, rules)
    ticks += 4 * circle.quarter * turns
    sweep += tau * turns
    length = (ticks + tail.ticks) << FINE
    is_tangential = rules.arc_rate == "tangential" and not is_pulsed
    if is_tangential:
        length = int(sweep * _square(start) ** 0.5 * ONE)
    is_led_by_traverse = sweep > 0 and abs(traverse) << FINE > length
    return ArcPath(
        plane,
        Turn(circle, first, ticks, sweep),
        tail,
        is_clockwise,
        traverse,
        max(length, abs(traverse) << FINE),
        is_tangential or is_led_by_traverse,
    )


def _final_sweep(
    circle: LatticeCircle, start: Point, goal: Point, is_full_at_zero: bool
) -> tuple[float, int]:
    """(angle, ticks) clockwise from ``start`` to ``goal``."""
    cross = start[0] * goal[1] - start[1] * goal[0]
    ahead = start[0] * goal[0] + start[1] * goal[1]
    turn = 4 * circle.quarter
    if cross == 0 and ahead > 0:
        return (tau, turn) if is_full_at_zero else (0.0, 0)
    sweep = atan2(-cross, ahead) % tau
    ticks = (circle.tick_at(*goal) - circle.tick_at(*start)) % turn
    # Where rounding took both to one point of the lattice, or past it, the angle decides.
    if cross < 0 and ticks > 3 * circle.quarter:
        ticks = 0
    if cross > 0 and ticks < circle.quarter:
        ticks += turn
    return sweep, ticks


def _tail_to(
    circle: LatticeCircle, first: int, ticks: int, goal: Point, rules: MotionRules
) -> tuple[int, StraightPath]:
    """(ticks on the circle, the way from there to the goal).

    The tail begins as late as it can without taking more than ``ticks`` in all, or, if it cannot,
    where it takes the fewest.
    """

    def tails() -> Iterator[tuple[int, int, Point]]:
        for back in range(min(TAIL_MAX, circle.quarter // 2, ticks) + 1):
            tick = first + ticks - back
            point = circle.across(tick), circle.across(tick + circle.quarter)
            left = _minus(goal, point)
            yield max(ticks, ticks - back + max(map(abs, left))), back, left

    _, back, (x, y) = min(tails())
    tail = StraightPath.over((x, y, 0, 0), max(abs(x), abs(y), back), rules.dda_phase)
    return ticks - back, tail


def _ends(path: Path) -> Quad:
    first, second, third, fourth = (path.displacement(axis, path.total(axis)) for axis in AXES)
    return first, second, third, fourth


def _tail_axis(shift: int) -> int:
    return 1 if shift else 0


def _minus(point: Point, other: Point) -> Point:
    return point[0] - other[0], point[1] - other[1]


def _square(point: Point) -> int:
    return point[0] ** 2 + point[1] ** 2
