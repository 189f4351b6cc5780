"""Segments of constant speed, run back to back out of a short FIFO.

Theory (MACS ledger §5.6)
-------------------------
A segment is n steps of one period; step m ends m periods after the segment's start, and the next
segment starts on the very tick on which this one ends.  So the moment a segment is accepted, its
start is known:

    start = max(now, end of the segment before)

and the whole state at any time, FIFO occupancy included, is a function of the accepted segments.
Nothing has to be polled, and nothing can drift.

    accepted   s1 s2 s3 s4       s5 refused: three wait        s5
    executing  |--s1--|----s2----|-s3-|--s4--|                 |--s5--|
                                             └─ underrun: rest at the last step

Rules
-----
1. A stage of the FIFO frees on the tick on which the interpolator takes the segment
   (MACS-CMD-16-02).  Whether the executing one still occupies a stage is open (MACS-AMB-37).
2. A virtual segment takes its time and moves nothing (MACS-CMD-1E-01).
3. A segment of no steps takes its turn and no time (MACS-AMB-39).
4. What happens when the FIFO runs empty is open (MACS-AMB-40): ``Underrun``.
5. While it is ``hold``-ing, the interpolator stores and takes nothing (MACS-AMB-31).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from axistwin.kernel.time import Nanos
from axistwin.motion.trajectory import TICK_NS, Leg, Piece, StepPhase, Trajectory


class Underrun(StrEnum):
    """The FIFO is empty at the end of a segment (MACS-AMB-40).

    HALT: rest at the last step; a later segment starts afresh.  DECELERATE: slow down by the
    pieces given with the last segment.  ERROR: halt, and refuse segments until ``flush``.
    """

    HALT = "halt"
    DECELERATE = "decelerate"
    ERROR = "error"


@dataclass(frozen=True, slots=True)
class Segment:
    """``steps`` (signed) of ``period_ticks`` (>= 1) each; a ``virtual`` one only takes the time."""

    steps: int
    period_ticks: int
    virtual: bool = False

    def __post_init__(self) -> None:
        assert self.period_ticks >= 1, f"a period of {self.period_ticks} ticks is no speed"

    @property
    def duration_ns(self) -> Nanos:
        """How long the segment takes."""
        return abs(self.steps) * self.period_ticks * TICK_NS


class Step(NamedTuple):
    """A step in progress: when it began, its direction (+1, -1) and its period."""

    start_ns: Nanos
    direction: int
    period_ticks: int


class _Run(NamedTuple):
    """A stretch with a fixed place in time: a segment, or the slowing down after an underrun."""

    start_ns: Nanos
    end_ns: Nanos
    origin: int
    """Displacement when it starts."""
    trajectory: Trajectory | None
    """None for one that does not move."""
    descent: tuple[Piece, ...]
    """How the axis would slow down after it."""
    is_tail: bool = False

    def displacement_at(self, now_ns: Nanos) -> int:
        """Displacement at ``now_ns``, which is not before the start."""
        moved = self.trajectory.displacement_at(now_ns) if self.trajectory else 0
        return self.origin + moved


class Interpolator:
    """The segment FIFO and the set-point it makes.

    ``depth`` segments can wait; ``counts_executing`` makes the one in execution one of them.
    Displacements count from the creation of the interpolator on and are never reset.
    """

    def __init__(
        self,
        *,
        depth: int = 3,
        counts_executing: bool = False,
        underrun: Underrun = Underrun.HALT,
        step_phase: StepPhase = StepPhase.END,
    ) -> None:
        assert depth >= 1, f"a FIFO of {depth} stages"
        self.depth = depth
        self._counts_executing = counts_executing
        self._underrun = underrun
        self._step_phase = step_phase
        self._runs: list[_Run] = []
        self._pending: list[tuple[Segment, tuple[Piece, ...]]] = []
        self._holding = False
        self._fresh = True
        self._origin = 0
        self._end_ns: Nanos = 0

    def offer(self, now_ns: Nanos, segment: Segment, descent: tuple[Piece, ...] = ()) -> bool:
        """Accept ``segment``, or refuse it (False) because the FIFO is full or in error.

        ``descent`` is how the axis slows down if nothing follows (``Underrun.DECELERATE``).
        """
        if not self.has_room(now_ns):
            return False
        if self._underrun is not Underrun.DECELERATE or segment.virtual:
            descent = ()
        if self._holding:
            self._pending.append((segment, descent))
        else:
            self._place(now_ns, segment, descent)
        return True

    def has_room(self, now_ns: Nanos, *, released: bool = False) -> bool:
        """Whether ``offer`` would accept a segment; ``released``: after ``release`` at once."""
        stored = self.stored_at(now_ns)
        if released and self._pending and not self._counts_executing:
            stored -= 1  # the first is taken
        return not self.has_failed(now_ns) and stored < self.depth

    def stored_at(self, now_ns: Nanos) -> int:
        """Occupied stages at ``now_ns``."""
        counts, stored = self._counts_executing, len(self._pending)
        for run in self._runs:
            if (run.end_ns if counts else run.start_ns) > now_ns and not run.is_tail:
                stored += 1
        return stored

    def has_failed(self, now_ns: Nanos) -> bool:
        """Whether an underrun has ended the motion in error (only under ``Underrun.ERROR``)."""
        erring = self._underrun is Underrun.ERROR and not self._fresh
        return erring and now_ns > self.end_ns

    def is_executing(self, now_ns: Nanos) -> bool:
        """Whether a segment (or the slowing down after the last) runs at ``now_ns``."""
        return any(run.start_ns <= now_ns < run.end_ns for run in self._runs)

    def sets_out_at(self, now_ns: Nanos) -> bool:
        """Whether the axis starts to move at ``now_ns``, or turns round."""
        direction, ended_ns = 0, -1
        for run in self._runs:
            if run.trajectory is not None:
                goes_on = run.start_ns == ended_ns and run.trajectory.direction == direction
                if run.start_ns == now_ns:
                    return not goes_on
                direction, ended_ns = run.trajectory.direction, run.end_ns
        return False

    def step_in_progress(self, now_ns: Nanos) -> Step | None:
        """The step that runs at ``now_ns``; None at rest and during a virtual segment."""
        run = self._run_at(now_ns)
        if run is None or run.trajectory is None:
            return None
        period_ticks = run.trajectory.period_at(now_ns)
        if period_ticks is None:
            return None
        start_ns = run.trajectory.boundary_ns(run.trajectory.completed_at(now_ns))
        return Step(start_ns, run.trajectory.direction, period_ticks)

    def displacement_at(self, now_ns: Nanos) -> int:
        """Signed steps counted by ``now_ns``, which is not before the last ``run``."""
        run = self._run_at(now_ns)
        return self._origin if run is None else run.displacement_at(now_ns)

    def reach_ns(self, displacement: int, after_ns: Nanos) -> Nanos | None:
        """First time >= ``after_ns`` at which the count is ``displacement``; None: never."""
        if self.displacement_at(after_ns) == displacement:
            return after_ns
        for run in self._runs:
            if run.trajectory is None or run.end_ns <= after_ns:
                continue
            start_ns = max(after_ns, run.start_ns)
            reached = run.trajectory.reach_ns(displacement - run.origin, start_ns)
            if reached is not None:
                return reached
        return None

    def leg_at(self, now_ns: Nanos) -> Leg:
        """The stretch of constant speed at ``now_ns``, not before the last ``run``."""
        run = self._run_at(now_ns)
        if run is None or run.trajectory is None or now_ns >= run.end_ns:
            return next(self.legs(now_ns))
        leg = run.trajectory.leg_at(now_ns)
        return leg._replace(displacement=run.origin + leg.displacement) if run.origin else leg

    def legs(self, from_ns: Nanos) -> Iterator[Leg]:
        """The stretches of constant speed from ``from_ns`` on; not before the last ``run``."""
        reached_ns, displacement = from_ns, self.displacement_at(from_ns)
        for run in self._runs:
            if run.end_ns <= from_ns or run.end_ns == run.start_ns:
                continue
            if run.start_ns > reached_ns:
                yield Leg(reached_ns, run.start_ns, 0, 0, run.origin)
            if run.trajectory is None:
                yield Leg(run.start_ns, run.end_ns, 0, 0, run.origin)
            else:
                yield from _moving_legs(run.trajectory, max(from_ns, run.start_ns), run.origin)
            reached_ns, displacement = run.end_ns, run.displacement_at(run.end_ns)
        yield Leg(reached_ns, None, 0, 0, displacement)

    def heads_ns(self, direction: int, from_ns: Nanos) -> Nanos | None:
        """When the first leg from ``from_ns`` on that goes in ``direction`` starts; None: none."""
        starts = (leg.start_ns for leg in self.legs(from_ns) if leg.direction == direction)
        return next(starts, None)

    @property
    def end_ns(self) -> Nanos:
        """When the last placed segment ends (or ended)."""
        return self._runs[-1].end_ns if self._runs else self._end_ns

    def next_event(self) -> Nanos | None:
        """The next end of a segment that ``run`` has not seen; None if nothing is placed."""
        return self._runs[0].end_ns if self._runs else None

    def run(self, now_ns: Nanos) -> None:
        """Forget what is over at ``now_ns``; states at earlier times can no longer be asked for."""
        over = 0
        for run in self._runs:
            if run.end_ns > now_ns:
                break
            over += 1
        if over:
            last = self._runs[over - 1]
            self._origin, self._end_ns = last.displacement_at(last.end_ns), last.end_ns
            del self._runs[:over]

    def flush(self, now_ns: Nanos) -> None:
        """Rest where the axis stands at ``now_ns``; the step in progress and the FIFO are dropped.

        Ends an error and a hold.
        """
        self._origin = self.displacement_at(now_ns)
        self._end_ns = now_ns
        self._runs.clear()
        self._pending.clear()
        self._holding = False
        self._fresh = True

    def drop_stored(self, now_ns: Nanos) -> None:
        """Drop what waits in the FIFO; the segment in execution runs to its end."""
        self._pending.clear()
        self._runs = [run for run in self._runs if run.start_ns <= now_ns]
        if self._runs and self._runs[-1].end_ns > now_ns:
            self._append_tail(self._runs[-1])

    def hold(self) -> None:
        """Store what is offered from now on, and take nothing, until ``release``."""
        self._holding = True

    def release(self, now_ns: Nanos) -> None:
        """Start with the first stored segment at ``now_ns``."""
        pending, self._pending, self._holding = self._pending, [], False
        for segment, descent in pending:
            self._place(now_ns, segment, descent)

    def _run_at(self, now_ns: Nanos) -> _Run | None:
        """The stretch that began last by ``now_ns``; None if there is none that is remembered."""
        for run in reversed(self._runs):  # never more than a handful
            if run.start_ns <= now_ns:
                return run
        return None

    def _place(self, now_ns: Nanos, segment: Segment, descent: tuple[Piece, ...]) -> None:
        """Give ``segment`` its place behind everything that is placed already."""
        self._end_tail(now_ns)
        start_ns = max(now_ns, self.end_ns)
        origin = self._last_displacement()
        trajectory = None
        if segment.steps and not segment.virtual:
            direction = 1 if segment.steps > 0 else -1
            pieces = (Piece(abs(segment.steps), segment.period_ticks),)
            trajectory = Trajectory(start_ns, direction, pieces, self._step_phase)
        run = _Run(start_ns, start_ns + segment.duration_ns, origin, trajectory, descent)
        self._runs.append(run)
        self._append_tail(run)
        self._fresh = False

    def _last_displacement(self) -> int:
        """Where the last placed stretch ends."""
        if not self._runs:
            return self._origin
        last = self._runs[-1]
        return last.displacement_at(last.end_ns)

    def _append_tail(self, run: _Run) -> None:
        """Plan the slowing down after ``run``, in case nothing follows."""
        if run.is_tail or run.trajectory is None or not run.descent:
            return
        direction = run.trajectory.direction
        tail = Trajectory(run.end_ns, direction, run.descent, self._step_phase)
        assert tail.end_ns is not None, "a descent ends"
        origin = run.displacement_at(run.end_ns)
        self._runs.append(_Run(run.end_ns, tail.end_ns, origin, tail, (), is_tail=True))

    def _end_tail(self, now_ns: Nanos) -> None:
        """Let the slowing down end with its increment in progress, or not begin at all."""
        if not self._runs or not self._runs[-1].is_tail:
            return
        tail = self._runs[-1]
        assert tail.trajectory is not None, "a tail moves"
        if now_ns <= tail.start_ns:
            self._runs.pop()
        elif now_ns < tail.end_ns:
            cut = tail.trajectory.cut(tail.trajectory.completed_at(now_ns) + 1)
            assert cut.end_ns is not None, "a cut trajectory ends"
            self._runs[-1] = tail._replace(trajectory=cut, end_ns=cut.end_ns)


def _moving_legs(trajectory: Trajectory, from_ns: Nanos, origin: int) -> Iterator[Leg]:
    """The moving legs of ``trajectory``, displaced by ``origin``."""
    for leg in trajectory.legs(from_ns):
        if leg.direction:
            yield leg._replace(displacement=origin + leg.displacement)
