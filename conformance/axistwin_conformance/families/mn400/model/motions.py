"""What moves when: motions in a row, each with the window in which it begins.

Times are seconds on one clock, as fractions.  A command is accepted at some time between its
sending and its reply, and a queued motion begins when the one before has ended; so each begins
within a window, and where an axis is at a time is a window too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final

from axistwin_conformance.families.mn400.planner.circle import CircleMove
from axistwin_conformance.families.mn400.planner.contour import ContourMove
from axistwin_conformance.families.mn400.planner.speed import SpeedPlan
from axistwin_conformance.families.mn400.planner.vector import AXES, VectorMove, Window

STILL: Final = (0, 0)
ENDLESS: Final = Fraction(10**9)  # seconds: nobody waits so long
# By how much less a board may have moved until a pause than its replies let one think.
PAUSE_LAG_S: Final = Fraction(1, 20)
PAUSE_ERROR: Final = Fraction(1, 100)

Place = tuple[Window, ...]  # of all axes
Span = tuple[Fraction, Fraction]  # the earliest and the latest time, or the least and most seconds


class PlannedMotion(ABC):
    """One motion, from its start: how long it takes, where it leads, where it may be."""

    displacements: tuple[int, ...]

    @property
    @abstractmethod
    def span(self) -> Span:
        """The least and the greatest duration."""

    @property
    def is_steady(self) -> bool:
        """True if it runs at start speed at most, so that a pause stops it at once and it goes on
        at its speed (MN4-PAU-01)."""
        return False

    @abstractmethod
    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """Where each axis may be at some time between the two, from its beginning."""


@dataclass
class CompensatedMotion(PlannedMotion):
    """Another motion with the compensation of backlash before it; `is_counted`: the counters tell
    of that (MN4-AMB-58)."""

    before: VectorMove
    motion: PlannedMotion
    is_counted: bool = False

    def __post_init__(self) -> None:
        self.displacements = tuple(
            map(sum, zip(self._lost, self.motion.displacements, strict=True))
        )

    @property
    def _lost(self) -> tuple[int, ...]:
        return self.before.displacements if self.is_counted else (0,) * AXES

    @property
    def span(self) -> Span:
        """Compensation and motion."""
        lost, (least, most) = self.before.plan.seconds, self.motion.span
        return lost + least, lost + most

    @property
    def is_steady(self) -> bool:
        """Both of it."""
        return is_flat(self.before.plan) and self.motion.is_steady

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """First the compensation, then the motion from where that leads."""
        lost = self.before.plan.seconds
        still = exactly(self._lost)
        places = []
        if first <= lost:
            places.append(self.before.windows(first, last) if self.is_counted else still)
        if last >= lost:
            places.append(added(still, self.motion.windows(first - lost, last - lost)))
        return hull(*places)


@dataclass
class VectorMotion(PlannedMotion):
    """A vector move."""

    move: VectorMove
    is_early: bool = False

    def __post_init__(self) -> None:
        self.displacements = self.move.displacements

    @property
    def span(self) -> Span:
        """Of all its steps; less by one where steps come early (MN4-AMB-71)."""
        is_early = self.is_early or self.move.is_phased
        return self.move.plan.last_step_time(is_early=is_early), self.move.plan.seconds

    @property
    def is_steady(self) -> bool:
        """Without ramps."""
        return is_flat(self.move.plan)

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """All axes on its chord."""
        return self.move.windows(first, last, is_early=self.is_early)


@dataclass
class CircleMotion(PlannedMotion):
    """An arc or a helix; `plane`: the motors of X, Y and the traverse, from 0."""

    circle: CircleMove
    plane: tuple[int, int, int]

    def __post_init__(self) -> None:
        self.displacements = tuple(low for low, _ in self._placed(self._ends))

    @property
    def span(self) -> Span:
        """As the lattice path may differ from the ideal one."""
        return self.circle.seconds

    @property
    def is_steady(self) -> bool:
        """Only below the start speed: above it an arc may brake for a pause."""
        rules = self.circle.rules
        return min(rules.speed, rules.profile.end) <= rules.profile.start

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """Of all four motors; those outside of the plane stand (MN4-ARC-08)."""
        return self._placed(self.circle.windows(first, last))

    @property
    def _ends(self) -> tuple[Window, ...]:
        return tuple((one, one) for one in (*self.circle.end, self.circle.traverse))

    def _placed(self, of_plane: Sequence[Window]) -> tuple[Window, ...]:
        """Windows of X, Y and the traverse, at the motors that these are."""
        moved = list(zip(self.plane, of_plane, strict=True))[: 3 if self.circle.traverse else 2]
        placed = dict(moved)
        return tuple(placed.get(motor, STILL) for motor in range(AXES))


@dataclass
class ContourMotion(PlannedMotion):
    """A contour."""

    contour: ContourMove
    is_early: bool = False

    def __post_init__(self) -> None:
        self.displacements = self.contour.displacements

    @property
    def span(self) -> Span:
        """It has one duration, but for its last step."""
        seconds = self.contour.seconds
        last = self.contour.plans[-1] if self.contour.plans else None
        if last is None:
            return seconds, seconds
        return seconds - last.seconds + last.last_step_time(is_early=self.is_early), seconds

    @property
    def is_steady(self) -> bool:
        """Without ramps in any segment."""
        return all(map(is_flat, self.contour.plans))

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """From segment to segment."""
        return self.contour.windows(first, last, is_early=self.is_early)


class PacedMotion(PlannedMotion):
    """A motion that waits for pulses, of which there are none (MN4-THR-04)."""

    def __init__(self, displacements: Sequence[int]) -> None:
        self.displacements = tuple(displacements)

    @property
    def span(self) -> Span:
        """It does not end."""
        return ENDLESS, ENDLESS

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """Nowhere but where it has begun."""
        return (STILL,) * AXES


class RestOfMotion(PlannedMotion):
    """What is left of a motion that was paused: nobody knows exactly how much.

    `gone`: for how long it has been under way, at least when it was paused, and at most by now, as
    if it had gone on meanwhile: no pause makes it end earlier.  What runs at one speed and stops at
    once goes on as it was.  Else it takes no longer than the whole of a vector move did, for it
    ramps as one does (MN4-PAU-01); of other motions it may take twice as long.
    """

    def __init__(self, whole: PlannedMotion, gone: Span) -> None:
        self.displacements = whole.displacements
        self.whole, self.gone = whole, gone
        least, most = whole.span
        self._least = Fraction(0) if most >= ENDLESS else max(Fraction(0), least - gone[1])
        if self.is_steady:
            self._most = max(Fraction(0), most - gone[0])
        else:
            self._most = most * (1 if isinstance(whole, VectorMotion) else 2)

    @property
    def is_steady(self) -> bool:
        """As the whole of it."""
        return self.whole.is_steady

    @property
    def span(self) -> Span:
        """What the pause has left of it."""
        return self._least, self._most

    def windows(self, first: Fraction, last: Fraction) -> tuple[Window, ...]:
        """From the start of the whole: from where it was paused to where it would be without."""
        more = max(Fraction(0), first) if self.is_steady else Fraction(0)
        return self.whole.windows(self.gone[0] + more, self.gone[1] + max(Fraction(0), last))


# --- in a row -------------------------------------------------------------------------------------


def is_flat(plan: SpeedPlan) -> bool:
    """True for a plan without ramps."""
    return all(phase.entry == phase.leaving for phase in plan.phases)


def exactly(position: Iterable[int]) -> Place:
    """A place that is known."""
    return tuple((one, one) for one in position)


def added(place: Place, windows: Sequence[Window]) -> Place:
    """A place, moved by what lies within these windows."""
    pairs = zip(place, windows, strict=True)
    return tuple((at[0] + by[0], at[1] + by[1]) for at, by in pairs)


def hull(*places: Place) -> Place:
    """The least box that holds all of them."""
    columns = zip(*places, strict=True)
    return tuple((min(one)[0], max(high for _, high in one)) for one in columns)


@dataclass(frozen=True, slots=True)
class ScheduledMotion:
    """A motion with the window in which it begins, from where, and where it leads; `memory`: the
    directions that are remembered behind it (MN4-BKL-02)."""

    motion: PlannedMotion
    begins: Span
    base: Place
    end: Place
    memory: tuple[int, ...] = ()

    @property
    def ends(self) -> Span:
        """The earliest and the latest time at which its last step is made."""
        least, most = self.motion.span
        return self.begins[0] + least, self.begins[1] + most

    def place(self, first: Fraction, last: Fraction) -> Place:
        """Where the axes may be at some time between the two."""
        if first >= self.ends[1]:
            return self.end
        windows = self.motion.windows(first - self.begins[1], last - self.begins[0])
        return added(self.base, windows)


class MotionTimeline:
    """All motions that were accepted, and where the axes are."""

    def __init__(self, place: Place = (STILL,) * AXES) -> None:
        self.place = place  # before all motions
        self.motions: list[ScheduledMotion] = []
        self.held: list[ScheduledMotion] = []  # paused, and what waits behind it
        self.began = Fraction(0)  # when the first of them was accepted since all stood
        self.paused: Span = (Fraction(0), Fraction(0))  # when that was, of what is held

    @property
    def end(self) -> Place:
        """Where the axes are when all is over."""
        rows = self.motions or self.held
        return rows[-1].end if rows else self.place

    @property
    def ends(self) -> Span | None:
        """When all is over; None: nothing moves."""
        return self.motions[-1].ends if self.motions else None

    def add(
        self, motion: PlannedMotion, accepted: Span, memory: tuple[int, ...] = ()
    ) -> ScheduledMotion:
        """A motion was accepted at some time of this span; it begins behind all others."""
        if self.held:  # it waits behind what is paused (MN4-PAU-04)
            end = added(self.end, exactly(motion.displacements))
            scheduled = ScheduledMotion(motion, accepted, self.end, end, memory)
            self.held.append(scheduled)
            return scheduled
        before = self.ends
        if before is None:
            self.began = accepted[0]
        else:
            accepted = max(accepted[0], before[0]), max(accepted[1], before[1])
        end = added(self.end, exactly(motion.displacements))
        scheduled = ScheduledMotion(motion, accepted, self.end, end, memory)
        self.motions.append(scheduled)
        return scheduled

    def forget(self, first: Fraction) -> None:
        """Leave out what was over for certain before a time."""
        while self.motions and self.motions[0].ends[1] <= first:
            self.place = self.motions.pop(0).end

    def may_run(self, now: Span) -> bool:
        """True if something may be moving at some time of this span."""
        ends = self.ends
        return ends is not None and ends[1] > now[0]

    def must_run(self, now: Span) -> bool:
        """True if something is moving throughout this span, whatever the windows hold.

        What asks now was sent behind what was accepted before: the first motion has begun.
        """
        ends = self.ends
        return ends is not None and ends[0] > now[1]

    def waiting(self, now: Span) -> tuple[int, int]:
        """How many motions have not begun, at least and at most."""
        least = sum(one.begins[0] > now[1] for one in self.motions)
        most = sum(one.begins[1] > now[0] for one in self.motions)
        return least, most

    def where(self, now: Span) -> Place:
        """Where the axes may be at some time of this span."""
        first, last = now
        places = [self.place] if not self.motions or self.motions[0].begins[1] > first else []
        for one in self.motions:
            if one.begins[0] <= last and (one.ends[1] > first or one is self.motions[-1]):
                places.append(one.place(first, last))
        return hull(*places) if places else self.place

    def pause(self, now: Span, braking: Fraction) -> None:
        """What moves comes to rest within so many seconds, and all that is left is held."""
        self.forget(now[0])
        place = self.where((now[0], now[1] + braking))
        self.held, self.motions, self.place = self.motions, [], place
        self.paused = now

    def resume(self, now: Span) -> None:
        """What was held goes on, one motion behind the other."""
        held, self.held = self.held, []
        for index, one in enumerate(held):
            has_begun = index == 0 or one.begins[0] < self.paused[1]  # for all that is known
            motion = RestOfMotion(one.motion, self._gone(one, now)) if has_begun else one.motion
            begins = now
            if self.motions:
                ends = self.motions[-1].ends
                begins = max(now[0], ends[0]), max(now[1], ends[1])
            self.motions.append(replace(one, motion=motion, begins=begins))

    def _gone(self, held: ScheduledMotion, now: Span) -> Span:
        """For how long what is held was under way: until it was paused, and until now."""
        least = (self.paused[0] - held.begins[1]) * (1 - PAUSE_ERROR) - PAUSE_LAG_S
        return max(Fraction(0), least), max(Fraction(0), now[1] - held.begins[0])

    def stop(self, now: Span, place: Place | None = None, *, flushes: bool = True) -> None:
        """All motion ends and the queue is empty, at some time of this span (MN4-CMD-Q-02); or what
        waited goes on behind the motion that ends (MN4-AMB-62)."""
        waiting = (self.motions or self.held)[1:]
        self.place = self.where(now) if place is None else place
        self.motions.clear()
        self.held.clear()
        for one in () if flushes else waiting:
            self.add(one.motion, now, one.memory)

    def shift(self, before: Place, after: Place) -> None:
        """The counters that were there are here now; what moves goes on."""
        pairs = list(zip(before, after, strict=True))
        by = tuple((0, 0) if at == to else (to[0] - at[1], to[1] - at[0]) for at, to in pairs)
        self.place = added(self.place, by)
        for rows in (self.motions, self.held):
            rows[:] = [
                replace(one, base=added(one.base, by), end=added(one.end, by)) for one in rows
            ]

    def observe(self, position: Sequence[int]) -> None:
        """The axes are at rest there, as they have told."""
        self.place = exactly(position)
        self.motions.clear()
