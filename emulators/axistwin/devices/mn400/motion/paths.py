"""Where each axis steps along the coordinate x: straight paths, and several paths in a row.

Rules
-----
1. A path knows, for each axis, the place of its n-th step and how many steps lie up to a place.
   Both are formulas; no path is walked.
2. A straight path is the DDA of the ledger (§5.1): an accumulator per axis starts at a phase, each
   of the N ticks adds |d|; at N or above N is subtracted and the axis steps.  So after j ticks

       count(j) = floor((phase + j·|d|) / N)        tick(n) = ceil((n·N - phase) / |d|)

   The phase is a share of what the major axis adds in a tick, half of it by default.  Hence with
   each multiplex m and each phase the major axis makes its k-th step at tick k·m, which is when
   ∫v dt = k (§5.2), and all axes stay within one step of the chord.  A share of N would do neither.
3. Compensation of backlash is a path whose steps are not commanded.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Literal, NamedTuple, Protocol

from axistwin.devices.mn400.motion.rules import AXES, Quad
from axistwin.devices.mn400.motion.timeline import FINE


class Path(Protocol):
    """A way of four axes from x = 0 to ``length``."""

    @property
    def length(self) -> int:
        """Where the path ends, in fixed-point ticks."""

    @property
    def is_commanded(self) -> bool:
        """False: compensation, which the counters do not see."""

    def total(self, axis: int) -> int:
        """All steps of ``axis``, in both directions."""

    def place(self, axis: int, n: int) -> int:
        """x of the ``n``-th step [1..total]."""

    def taken(self, axis: int, x: int) -> int:
        """How many steps have a place up to and including ``x``."""

    def displacement(self, axis: int, n: int) -> int:
        """Where ``axis`` is after ``n`` steps [0..total]."""

    def heading(self, axis: int, n: int) -> int:
        """Direction of the ``n``-th step: +1 or -1."""

    def last_alike(self, axis: int, n: int) -> int:
        """The last of the steps from the ``n``-th on that go without a break in its direction."""


@dataclass(frozen=True, slots=True)
class StraightPath:
    """``displacements`` interpolated over ``ticks`` (at least the largest of them)."""

    displacements: Quad
    ticks: int
    phase: int
    """What the accumulators start at [0..ticks - 1]."""
    is_commanded: bool = True

    @classmethod
    def over(
        cls,
        displacements: Quad,
        ticks: int,
        dda_phase: Literal["half", "zero", "full"] = "half",
        multiplex: int = 1,
        is_commanded: bool = True,
    ) -> "StraightPath":
        """The path with the accumulators' start of that reading (MN4-AMB-65).

        multiplex: the ticks of a step of the major axis.
        """
        added = ticks // multiplex
        phase = {"half": added // 2, "zero": 0, "full": max(added - 1, 0)}[dda_phase]
        return cls(displacements, ticks, phase, is_commanded)

    @property
    def length(self) -> int:
        """Where the path ends."""
        return self.ticks << FINE

    def total(self, axis: int) -> int:
        """All steps of ``axis``."""
        return abs(self.displacements[axis])

    def place(self, axis: int, n: int) -> int:
        """x of the ``n``-th step."""
        return -((self.phase - n * self.ticks) // self.total(axis)) << FINE

    def taken(self, axis: int, x: int) -> int:
        """Steps up to and including ``x``."""
        if not self.ticks:
            return 0
        done = self.phase + (x >> FINE) * self.total(axis)
        return max(0, min(done // self.ticks, self.total(axis)))

    def displacement(self, axis: int, n: int) -> int:
        """Where ``axis`` is after ``n`` steps."""
        return n if self.displacements[axis] > 0 else -n

    def heading(self, axis: int, n: int) -> int:
        """Always the sign of the displacement."""
        return 1 if self.displacements[axis] > 0 else -1

    def last_alike(self, axis: int, n: int) -> int:
        """Always the last."""
        return self.total(axis)


@dataclass(frozen=True, slots=True)
class PathSlice:
    """What of ``path`` lies behind ``x0``, up to and including ``x1``."""

    path: Path
    x0: int
    x1: int
    is_commanded: bool = True

    @property
    def length(self) -> int:
        """Where the slice ends, from its start."""
        return self.x1 - self.x0

    def _before(self, axis: int) -> int:
        return self.path.taken(axis, self.x0)

    def total(self, axis: int) -> int:
        """All steps of ``axis``."""
        return self.path.taken(axis, self.x1) - self._before(axis)

    def place(self, axis: int, n: int) -> int:
        """x of the ``n``-th step."""
        return self.path.place(axis, self._before(axis) + n) - self.x0

    def taken(self, axis: int, x: int) -> int:
        """Steps up to and including ``x``."""
        return self.path.taken(axis, min(self.x0 + x, self.x1)) - self._before(axis)

    def displacement(self, axis: int, n: int) -> int:
        """Where ``axis`` is after ``n`` steps."""
        before = self._before(axis)
        moved = self.path.displacement(axis, before + n)
        return moved - self.path.displacement(axis, before)

    def heading(self, axis: int, n: int) -> int:
        """Direction of the ``n``-th step."""
        return self.path.heading(axis, self._before(axis) + n)

    def last_alike(self, axis: int, n: int) -> int:
        """The last step from the ``n``-th on in its direction."""
        before = self._before(axis)
        return min(self.path.last_alike(axis, before + n) - before, self.total(axis))


class MotorStep(NamedTuple):
    """One pulse at a motor: when, and in which direction."""

    at_ns: int
    direction: int
    is_commanded: bool
    """False: compensation of backlash."""


class PathChain:
    """Paths one behind the other; steps are numbered through, compensation included."""

    def __init__(self, paths: Sequence[Path], early: int = 0) -> None:
        """``early``: each step comes so much before its place (MN4-AMB-71, in fixed-point x)."""
        self.paths = tuple(paths)
        self._early = early
        self.starts = (0, *accumulate(path.length for path in paths))
        self._steps = [(0, *accumulate(path.total(axis) for path in paths)) for axis in AXES]
        self._commanded = [
            (0, *accumulate(path.total(axis) if path.is_commanded else 0 for path in paths))
            for axis in AXES
        ]
        self._displacements = [
            (0, *accumulate(path.displacement(axis, path.total(axis)) for path in paths))
            for axis in AXES
        ]
        self._targets = [
            (0, *accumulate(_commanded_displacement(path, axis) for path in paths)) for axis in AXES
        ]
        self._phantoms = (
            0,
            *accumulate(path.length if _is_phantom(path) else 0 for path in paths),
        )

    @property
    def length(self) -> int:
        """Where the last path ends."""
        return self.starts[-1]

    def total(self, axis: int) -> int:
        """All steps of ``axis``."""
        return self._steps[axis][-1]

    def net(self, axis: int) -> int:
        """Commanded displacement of ``axis``."""
        return self._targets[axis][-1]

    def _of_step(self, axis: int, n: int) -> tuple[int, Path, int]:
        """(index, path, number in the path) of the ``n``-th step."""
        index = bisect_left(self._steps[axis], n) - 1
        return index, self.paths[index], n - self._steps[axis][index]

    def place(self, axis: int, n: int) -> int:
        """x of the ``n``-th step [1..total]."""
        index, path, inner = self._of_step(axis, n)
        return max(0, self.starts[index] + path.place(axis, inner) - self._early)

    def taken(self, axis: int, x: int) -> int:
        """Steps up to and including ``x``; negative: none."""
        if x < 0 or not self.paths:
            return 0
        x += self._early
        index = min(bisect_right(self.starts, x), len(self.paths)) - 1
        steps = self._steps[axis]
        if steps[index] == steps[-1]:  # none any more
            return steps[index]
        return steps[index] + self.paths[index].taken(axis, x - self.starts[index])

    def displacement(self, axis: int, n: int, with_compensation: bool) -> int:
        """Where the counter of ``axis`` is after ``n`` steps."""
        if not n:
            return 0
        index, path, inner = self._of_step(axis, n)
        sums = self._displacements if with_compensation else self._targets
        counts = with_compensation or path.is_commanded
        return sums[axis][index] + (path.displacement(axis, inner) if counts else 0)

    def phantoms(self, x: int) -> int:
        """Ticks of commanded paths of more than one axis, up to and including ``x``."""
        if x <= 0 or not self.paths:
            return 0
        index = min(bisect_right(self.starts, x), len(self.paths)) - 1
        inner = x - self.starts[index] if _is_phantom(self.paths[index]) else 0
        return (self._phantoms[index] + inner) >> FINE

    def commanded(self, axis: int, n: int) -> int:
        """How many of the first ``n`` steps are commanded."""
        if not n:
            return 0
        index, path, inner = self._of_step(axis, n)
        return self._commanded[axis][index] + (inner if path.is_commanded else 0)

    def number_of(self, axis: int, commanded: int) -> int | None:
        """The number, compensation included, of a commanded step; None: there are fewer."""
        sums = self._commanded[axis]
        if not 1 <= commanded <= sums[-1]:
            return None
        index = bisect_left(sums, commanded) - 1
        return self._steps[axis][index] + commanded - sums[index]

    def step(self, axis: int, n: int) -> tuple[int, bool]:
        """(direction, is commanded) of the ``n``-th step."""
        _, path, inner = self._of_step(axis, n)
        return path.heading(axis, inner), path.is_commanded

    def slope(self, axis: int, n: int, x: int, reach: int) -> float:
        """Displacement for each unit of x where ``x`` is, over some steps around the ``n``-th."""
        index = min(bisect_right(self.starts, x), len(self.paths)) - 1
        path, total = self.paths[index], self.paths[index].total(axis)
        near = min(max(n - self._steps[axis][index], 1), total)
        first, last = max(1, near - reach), min(near + reach, total)
        if isinstance(path, StraightPath) or last - first < 2:
            return path.displacement(axis, total) / path.length
        moved = path.displacement(axis, last) - path.displacement(axis, first)
        return moved / (path.place(axis, last) - path.place(axis, first))

    def next_in_direction(self, axis: int, n: int, direction: int) -> int | None:
        """The first step from the ``n``-th on that goes in ``direction`` (0: any); None: none."""
        while n <= self.total(axis):
            index, path, inner = self._of_step(axis, n)
            if direction in (0, path.heading(axis, inner)):
                return n
            n = self._steps[axis][index] + path.last_alike(axis, inner) + 1
        return None


def _commanded_displacement(path: Path, axis: int) -> int:
    return path.displacement(axis, path.total(axis)) if path.is_commanded else 0


def _is_phantom(path: Path) -> bool:
    """Whether the ticks of ``path`` count for a measurement of speed (MN4-CMD-E-03)."""
    return path.is_commanded and sum(path.total(axis) > 0 for axis in AXES) > 1
