"""A set-point as a closed formula of time, in both directions.

Rules and theory
----------------
1. The unit of time is the tick of 0.125 µs = 125 ns; every increment of a set-point takes a whole
   number of ticks, its *period* (MACS ledger §1).
2. A trajectory is a short list of pieces, each "n increments of the same period", run one after
   the other in one direction without a gap.  The last piece may be endless.
3. With C(n) = ticks of the first n increments, increment n is complete at ``start + C(n)``; the
   count at time t is max{n : C(n) <= t - start} (ledger §5.1).  Both are a search in the running
   sums of the pieces and one division: the cost is O(log pieces), whatever the age of the motion.
4. Whether the counter changes at the end of an increment or at its start is open (MACS-AMB-41);
   ``StepPhase`` chooses.  The increment itself always lasts from start to end.

    count
      3 |                 ┌────── end phase: steps at the ends of the increments
      2 |         ┌───────┘
      1 |   ┌─────┘
      0 └───┴─────┴───────┴──────> t
        t0  C(1)  C(2)    C(3)

A motion that is planned anew while it runs goes on as a new trajectory that begins with the
increment in progress and knows how many came ``before``; counts and times stay continuous and
nothing grows with the number of changes.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple, Protocol

from axistwin.kernel.time import Nanos

TICK_NS: Nanos = 125


class StepPhase(StrEnum):
    """When an increment is counted: when it is complete, or when it begins (MACS-AMB-41)."""

    END = "end"
    START = "start"


class Piece(NamedTuple):
    """``increments`` (at least 1, or None for endless) of ``period_ticks`` each (at least 1)."""

    increments: int | None
    period_ticks: int


class Leg(NamedTuple):
    """A stretch of constant set-point speed, for whoever follows the set-point.

    ``direction`` is 0 for a stretch at rest.  ``end_ns`` is None for an endless one.
    ``displacement`` is the signed count when the leg starts, steps counted at their ends.
    """

    start_ns: Nanos
    end_ns: Nanos | None
    direction: int
    period_ticks: int
    displacement: int


class SetPoint(Protocol):
    """What can be followed: a signed displacement as a function of time."""

    def displacement_at(self, now_ns: Nanos) -> int:
        """Signed increments counted by ``now_ns``."""

    def reach_ns(self, displacement: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at which the count is ``displacement``, as planned now.

        None: never.
        """

    def leg_at(self, now_ns: Nanos) -> Leg:
        """The stretch of constant speed at ``now_ns``, as planned now."""

    def legs(self, from_ns: Nanos) -> Iterator[Leg]:
        """The stretches of constant speed from the one at ``from_ns`` on, as planned now."""

    def heads_ns(self, direction: int, from_ns: Nanos) -> Nanos | None:
        """When the first leg from ``from_ns`` on that goes in ``direction`` starts; None: none."""

    @property
    def end_ns(self) -> Nanos | None:
        """When the last planned increment is complete; None: never."""


def merged(pieces: Iterable[Piece]) -> tuple[Piece, ...]:
    """The same increments with empty pieces dropped and neighbours of one period joined."""
    result: list[Piece] = []
    last_ticks = 0
    for piece in pieces:
        increments, period_ticks = piece
        if increments == 0:
            continue
        if period_ticks == last_ticks:
            before = result.pop().increments
            together = None if before is None or increments is None else before + increments
            piece = Piece(together, period_ticks)
        result.append(piece)
        last_ticks = period_ticks
    return tuple(result)


def first_increments(pieces: Sequence[Piece], count: int) -> tuple[Piece, ...]:
    """The first ``count`` (>= 0) increments of ``pieces``; fewer if there are not that many."""
    result: list[Piece] = []
    for piece in pieces:
        if count <= 0:
            break
        taken = count if piece.increments is None else min(count, piece.increments)
        result.append(Piece(taken, piece.period_ticks))
        count -= taken
    return tuple(result)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Increments in one ``direction`` (+1 or -1) from ``start_ns`` on.

    ``before`` increments of the same motion were counted earlier; counts and increment numbers
    include them, so increment numbers run from ``before + 1``.
    """

    start_ns: Nanos
    direction: int
    pieces: tuple[Piece, ...]
    step_phase: StepPhase = StepPhase.END
    before: int = 0
    is_endless: bool = field(init=False, repr=False, compare=False)
    """Whether the last piece has no end."""
    end_ns: Nanos | None = field(init=False, repr=False, compare=False)
    """When the last increment is complete (``start_ns`` if there is none); None: never."""
    _counts: list[int] = field(init=False, repr=False, compare=False)
    _ticks: list[int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        assert self.direction in (-1, 1), f"direction {self.direction} is neither +1 nor -1"
        assert self.before >= 0, f"{self.before} increments before the start"
        count = elapsed = 0
        counts, ticks, is_endless = [0], [0], False
        for increments, period_ticks in self.pieces:
            assert period_ticks >= 1, f"period below 1 in {self.pieces}"
            assert not is_endless, f"endless piece inside {self.pieces}"
            if increments is None:
                is_endless = True
                continue
            assert increments >= 1, f"empty piece in {self.pieces}"
            count += increments
            elapsed += increments * period_ticks
            counts.append(count)
            ticks.append(elapsed)
        end_ns = None if is_endless else self.start_ns + elapsed * TICK_NS
        object.__setattr__(self, "_counts", counts)
        object.__setattr__(self, "_ticks", ticks)
        object.__setattr__(self, "is_endless", is_endless)
        object.__setattr__(self, "end_ns", end_ns)

    @property
    def total_increments(self) -> int | None:
        """The count when the motion is over, ``before`` included; None if it never is."""
        return None if self.is_endless else self.before + self._counts[-1]

    def completed_at(self, now_ns: Nanos) -> int:
        """Increments complete by ``now_ns``, whatever the step phase (>= ``before``)."""
        ticks = (now_ns - self.start_ns) // TICK_NS
        if ticks < 0:
            return self.before
        index = bisect_right(self._ticks, ticks) - 1
        count = self.before + self._counts[index]
        if index < len(self.pieces):
            count += (ticks - self._ticks[index]) // self.pieces[index].period_ticks
        return count

    def increments_at(self, now_ns: Nanos) -> int:
        """Increments counted by ``now_ns``, each at its end or its start as ``step_phase`` says."""
        count = self.completed_at(now_ns)
        if self.step_phase is StepPhase.END or now_ns < self.start_ns:
            return count
        return count if count == self.total_increments else count + 1

    def end_of_increment_ns(self, n: int) -> Nanos:
        """When increment ``n`` is complete; ``before < n <= total_increments``."""
        assert n > self.before, f"increment {n} is over before the start of {self}"
        return self.boundary_ns(n)

    def step_ns(self, n: int) -> Nanos:
        """When increment ``n`` is counted: its end or its start; range as above."""
        end_ns = self.end_of_increment_ns(n)
        return end_ns if self.step_phase is StepPhase.END else self.boundary_ns(n - 1)

    def period_at(self, now_ns: Nanos) -> int | None:
        """Period in ticks of the increment in progress; None before the start and when over."""
        index = bisect_right(self._ticks, (now_ns - self.start_ns) // TICK_NS) - 1
        return self.pieces[index].period_ticks if 0 <= index < len(self.pieces) else None

    def period_of(self, n: int) -> int:
        """Period in ticks of increment ``n``; range as for ``end_of_increment_ns``."""
        index = bisect_right(self._counts, n - 1 - self.before) - 1
        assert 0 <= index < len(self.pieces), f"no increment {n} in {self}"
        return self.pieces[index].period_ticks

    def cut(self, n: int) -> "Trajectory":
        """Only the increments up to and including number ``n`` (``n`` >= ``before``)."""
        assert n >= self.before, f"increment {n} is over before the start of {self}"
        pieces = first_increments(self.pieces, n - self.before)
        return Trajectory(self.start_ns, self.direction, pieces, self.step_phase, self.before)

    def boundary_ns(self, n: int) -> Nanos:
        """When ``n`` increments are complete; ``before <= n <= total_increments``."""
        total = self.total_increments
        assert n >= self.before, f"increment {n} is over before the start of {self}"
        assert total is None or n <= total, f"no increment {n} in {self}"
        own = n - self.before
        if own == 0:
            return self.start_ns
        index = min(bisect_right(self._counts, own) - 1, len(self.pieces) - 1)
        within = (own - self._counts[index]) * self.pieces[index].period_ticks
        return self.start_ns + (self._ticks[index] + within) * TICK_NS

    def displacement_at(self, now_ns: Nanos) -> int:
        """Signed increments counted by ``now_ns``: direction times ``increments_at``."""
        return self.direction * self.increments_at(now_ns)

    def reach_ns(self, displacement: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at which the count is ``displacement``; None: never."""
        n = self.direction * displacement
        present = self.increments_at(after_ns)
        if n == present:
            return after_ns
        total = self.total_increments
        if n < present or (total is not None and n > total):
            return None
        return self.step_ns(n)

    def leg_at(self, now_ns: Nanos) -> Leg:
        """The piece in progress as a leg; at rest before the start, and when all is over."""
        index = bisect_right(self._ticks, (now_ns - self.start_ns) // TICK_NS) - 1
        if 0 <= index < len(self.pieces):
            return self._leg(index)
        return next(self.legs(now_ns))

    def legs(self, from_ns: Nanos) -> Iterator[Leg]:
        """The pieces as legs, from the one at ``from_ns`` on; at rest before, and after the end."""
        origin = self.direction * self.before
        if from_ns < self.start_ns:
            yield Leg(from_ns, self.start_ns, 0, 0, origin)
        first = bisect_right(self._ticks, (from_ns - self.start_ns) // TICK_NS) - 1
        for index in range(max(0, first), len(self.pieces)):
            yield self._leg(index)
        if self.end_ns is not None:
            total = origin + self.direction * self._counts[-1]
            yield Leg(max(self.end_ns, self.start_ns), None, 0, 0, total)

    def heads_ns(self, direction: int, from_ns: Nanos) -> Nanos | None:
        """When the first leg from ``from_ns`` on that goes in ``direction`` starts; None: none."""
        if direction != self.direction:
            return None
        return next((leg.start_ns for leg in self.legs(from_ns) if leg.direction), None)

    def _leg(self, index: int) -> Leg:
        """Piece ``index`` as a leg."""
        ticks, start_ns = self._ticks, self.start_ns
        end_ns = start_ns + ticks[index + 1] * TICK_NS if index + 1 < len(ticks) else None
        displacement = self.direction * (self.before + self._counts[index])
        period_ticks = self.pieces[index].period_ticks
        return Leg(
            start_ns + ticks[index] * TICK_NS, end_ns, self.direction, period_ticks, displacement
        )
