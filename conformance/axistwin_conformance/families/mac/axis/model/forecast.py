"""Where the axis may be, when all we know are time windows.

The host knows when an exchange began and ended; the module took the command over, or read its
counter, at some instant in between (`TimeWindow`).  A `Timeline` is one exact possible history; a
`Forecast` holds the extreme ones, both edges of every window and both roundings of every period.
A real axis lies between them: later start, slower periods and earlier stops only ever put it
further back, so the extremes bound the rest.  One thing breaks that order: a speed change waits for
the end of the increment in progress, and a history that is behind, but comes to that end sooner,
gets ahead.  So where a change is taken over, those histories are kept too (`Forecast.changes_in`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final, NamedTuple

from axistwin_conformance.families.mac.axis.model.kinematics import (
    TICK_NS,
    Course,
    EvenRun,
    Law,
    Profile,
    once,
)

ROUNDINGS: Final = ("down", "up")
NEVER_NS: Final = 1 << 62
RESTING: Final = frozenset({"HD"})
ALL_ALIKE: Final = {mode: frozenset({mode}) for mode in ("PO", "VE", "IN")}


class TimeWindow(NamedTuple):
    """An instant known to lie in [earliest_ns, latest_ns] of the target's clock."""

    earliest_ns: int
    latest_ns: int

    @property
    def edges(self) -> tuple[int, int]:
        """Both ends."""
        return self

    def __str__(self) -> str:
        return f"{self.earliest_ns / 1e6:.3f}..{self.latest_ns / 1e6:.3f} ms"


class Segment(NamedTuple):
    """A 16h (steps signed) or a 1Eh (moves False): |steps| periods of `period` ticks."""

    steps: int
    period: int
    moves: bool = True

    @property
    def duration_ns(self) -> int:
        """n·VVVV ticks, steps or none (MACS-CMD-1E-01)."""
        return abs(self.steps) * self.period * TICK_NS


class Leg(NamedTuple):
    """One piece of a timeline: a profile from a place, a time and in a direction (0: none)."""

    start_ns: int
    origin: int
    direction: int
    profile: Profile

    def position_at(self, now_ns: int) -> int:
        """The counter at that time, this leg alone."""
        return self.origin + self.direction * self.profile.steps_by(
            (now_ns - self.start_ns) // TICK_NS
        )

    @property
    def end_ns(self) -> int | None:
        """When the leg is over; None for an endless one."""
        ticks = self.profile.ticks
        return None if ticks is None else self.start_ns + ticks * TICK_NS

    @property
    def final(self) -> int | None:
        """Where it ends."""
        steps = self.profile.steps
        return None if steps is None else self.origin + self.direction * steps


@dataclass
class Timeline:
    """One exact history: at rest at `origin`, or under way from there since `start_ns`.

    A value: nobody changes one.  Some are made of every command, and freezing them would take
    twice as long as making them.

    `mode`: "HD" at rest, "PO", "VE" or "IN".  `course` belongs to PO and VE.  `segments`: of IN the
    row being executed, of PO and VE what waits for the axis to come to rest (MACS-AMB-31).
    `stops`: the software stops (inferior, superior) if enabled.  `ff`: what 21h told of stops
    before this motion, `doubt` the bits of it that nobody can tell.  `leads`: an increment counts
    when it begins (MACS-AMB-41).  `after`: at rest, the mode of the motion that ended here, as long
    as nobody has read where that is.
    """

    mode: str
    origin: int
    start_ns: int = 0
    direction: int = 0
    course: Course | None = None
    segments: tuple[Segment, ...] = ()
    stops: tuple[int, int] | None = None
    ff: int = 0
    leads: bool = False
    doubt: int = 0
    after: str = field(default="HD", compare=False)

    def __hash__(self) -> int:
        course = self.course
        shape = 0 if course is None else (course.law.rounding, course.changed_at, course.descent_at)
        return hash((self.origin, self.start_ns, self.direction, self.ff, shape))

    @once
    def _only(self) -> Leg | None:
        """The only leg, where nothing is behind the course and nothing may cut it short."""
        if self.course is None or self.stops is not None or self.segments:
            return None
        return Leg(self.start_ns, self.origin, self.direction, self.course.profile)

    @once
    def legs(self) -> tuple[Leg, ...]:
        """All legs in order, cut short where a software stop ends the motion (MACS-STOP-03)."""
        if self._only is not None:
            return (self._only,)
        place, now_ns = self.origin, self.start_ns
        legs: list[Leg] = []
        if self.course is not None:
            leg, hit = self._cut(Leg(now_ns, place, self.direction, self.course.profile))
            legs.append(leg)
            if hit or leg.end_ns is None or leg.final is None:
                return tuple(legs)
            place, now_ns = leg.final, leg.end_ns
        for segment in self.segments:
            leg, hit = self._cut(_leg(segment, now_ns, place))
            legs.append(leg)
            if hit:
                break
            assert leg.final is not None
            place, now_ns = leg.final, now_ns + segment.duration_ns
        return tuple(legs)

    def turns_in(self, window: TimeWindow) -> tuple[int, ...]:
        """The edges of a window, and when the axis may turn round in between: its extreme places
        are at some of these."""
        if not self.segments:
            return window
        ends_ns = [leg.end_ns for leg in self.legs if leg.end_ns is not None]
        earliest_ns, latest_ns = window
        return (*window, *[end_ns for end_ns in ends_ns if earliest_ns < end_ns < latest_ns])

    def levels_in(self, window: TimeWindow) -> tuple[int, ...]:
        """The edges of a window, and the last instants of one period and the first of another in
        between: what a change leads to is at its extremes at some of these."""
        if self.course is None:
            return window
        earliest_ns, latest_ns = window
        starts_ns = [self.start_ns + ticks * TICK_NS for ticks in self.course.profile.turns]
        met_ns = [each for each in starts_ns if earliest_ns < each <= latest_ns]
        return (*window, *[near_ns for each in met_ns for near_ns in (each - 1, each)])

    def _cut(self, leg: Leg) -> tuple[Leg, bool]:
        """Cut the leg at the first step beyond a software stop in its direction (§5.8)."""
        if self.stops is None or leg.direction == 0:
            return leg, False
        inferior, superior = self.stops
        room = superior - leg.origin if leg.direction > 0 else leg.origin - inferior
        allowed = max(0, room + 1)
        steps = leg.profile.steps
        if steps is not None and steps < allowed:
            return leg, False
        if steps == 0:
            return leg, False
        return leg._replace(profile=leg.profile.first(allowed)), True

    @once
    def hit(self) -> int:
        """The direction in which a software stop ends this motion; 0 if none does."""
        if self.stops is None or not self.legs:
            return 0
        last = self.legs[-1]
        if last.final is None or last.direction == 0:
            return 0
        beyond = last.final > self.stops[1] if last.direction > 0 else last.final < self.stops[0]
        return last.direction if beyond else 0

    @property
    def end_ns(self) -> int | None:
        """When the axis comes to rest; None if only a command can stop it."""
        return self.legs[-1].end_ns if self.legs else self.start_ns

    @once
    def final(self) -> int | None:
        """Where it comes to rest."""
        return self.legs[-1].final if self.legs else self.origin

    @once
    def over_ns(self) -> int:
        """From when on the axis is at rest: `end_ns` as a number."""
        if self.mode == "HD":
            return -NEVER_NS
        end_ns = self.end_ns if self._only is None else self._only.end_ns
        return NEVER_NS if end_ns is None else end_ns

    @once
    def _segments_from_ns(self) -> int:
        """When the interpolator takes over what waits for the end of a 13h, 14h or 15h."""
        end_ns = self.legs[0].end_ns if self.course is not None and self.segments else None
        return NEVER_NS if end_ns is None else end_ns

    def _leg_at(self, now_ns: int) -> Leg | None:
        """The last leg that has begun."""
        if self._only is not None:
            return self._only if self.start_ns <= now_ns else None
        for leg in reversed(self.legs):
            if leg.start_ns <= now_ns:
                return leg
        return None

    def position_at(self, now_ns: int) -> int:
        """The counter at that time."""
        leg = self._leg_at(now_ns)
        if leg is None:
            return self.origin
        place = leg.position_at(now_ns)
        return place + leg.direction if self.leads and now_ns < self.over_ns else place

    def places_at(self, now_ns: int) -> tuple[int, int]:
        """The counter at that time, if an increment counts at its end and if at its beginning."""
        place = self.position_at(now_ns)
        if now_ns >= self.over_ns:
            return place, place
        leg = self._leg_at(now_ns)
        return place, place if leg is None else place + leg.direction

    def is_running(self, now_ns: int) -> bool:
        """True before the end of the motion (MACS-STATE-01)."""
        return now_ns < self.over_ns

    def mode_at(self, now_ns: int) -> str:
        """PO, VE or IN while running, else HD."""
        if now_ns >= self.over_ns:
            return "HD"
        return self.mode if now_ns < self._segments_from_ns else "IN"

    def waiting(self, now_ns: int) -> int:
        """How many segments are stored and not yet taken by the interpolator."""
        first = 1 if self.course is not None else 0
        begun = len(self.legs)
        while begun > first and self.legs[begun - 1].start_ns > now_ns:
            begun -= 1
        return len(self.segments) - max(0, begun - first)

    def turned(self, mode: str, course: Course | None, segments: tuple[Segment, ...]) -> Timeline:
        """This motion, from the same beginning, on another course or with another row."""
        return Timeline(
            mode,
            self.origin,
            self.start_ns,
            self.direction,
            course,
            segments,
            self.stops,
            self.ff,
            self.leads,
            self.doubt,
        )

    def steps_by(self, now_ns: int) -> int:
        """How many increments of its course are complete at that time."""
        return 0 if self.course is None else self.course.profile.steps_by(_ticks(self, now_ns))

    def ending(self, step: int, now_ns: int) -> Timeline:
        """This motion, begun so that its course completes that increment at that time."""
        assert self.course is not None, "a row keeps no phase"
        return replace(self, start_ns=now_ns - self.course.profile.ticks_of(step) * TICK_NS)

    def followed_by(self, segment: Segment) -> Timeline:
        """This motion with a segment more at the end of the row."""
        longer = self.turned(self.mode, self.course, (*self.segments, segment))
        legs, end_ns, place = self.legs, self._row_end_ns, self.final
        if not self.hit and end_ns is not None and place is not None:  # the legs so far stay
            vars(longer)["legs"] = (*legs, longer._cut(_leg(segment, end_ns, place))[0])
        return longer

    @property
    def _row_end_ns(self) -> int | None:
        """When a further segment would begin; None if unknown."""
        if not self.segments or not self.legs:
            return self.end_ns if self.course is not None else None
        return self.legs[-1].start_ns + self.segments[-1].duration_ns

    def at_rest(self, now_ns: int) -> Timeline:
        """This history, abandoned now: at rest where the axis is, everything dropped."""
        if self.mode == "HD":
            return self
        ff, doubt = self.stopped_on(now_ns)
        place = self.position_at(now_ns)
        after = "IN" if now_ns >= self._segments_from_ns else self.mode
        return Timeline("HD", place, ff=ff, doubt=doubt, after=after)

    def read(self, position: int) -> Timeline:
        """This rest, at the place that the module has told."""
        return Timeline("HD", position, ff=self.ff, doubt=self.doubt)

    def described(self, ff: int) -> Timeline:
        """This rest, with the stops that the module has told."""
        return Timeline("HD", self.origin, ff=ff, after=self.after)

    @once
    def _is_tied(self) -> bool:
        """True if the motion would have been over with the very increment that led beyond a stop:
        what ended it is not said."""
        legs, has_course = self.legs, self.course is not None
        if not legs or len(legs) < has_course + len(self.segments):
            return False
        course = self.course.profile.steps if self.course is not None else None
        asked = abs(self.segments[-1].steps) if self.segments else course
        return asked == legs[-1].profile.steps

    def stopped_on(self, now_ns: int) -> tuple[int, int]:
        """The byte ff of 21h, bit 1 superior, bit 0 inferior software stop (§5.9), and the bits
        that may be set as well."""
        if now_ns < self.over_ns or self.mode == "HD":
            return self.ff, self.doubt
        bit = {1: 0x02, -1: 0x01, 0: 0}[self.hit]
        if bit and self._is_tied:
            return self.ff, self.doubt | bit
        return self.ff | bit, self.doubt


def _leg(segment: Segment, start_ns: int, origin: int) -> Leg:
    direction = (segment.steps > 0) - (segment.steps < 0) if segment.moves else 0
    return Leg(start_ns, origin, direction, _evenly(abs(segment.steps), segment.period))


@lru_cache(maxsize=1024)
def _evenly(steps: int, period: int) -> Profile:
    """The profile of one segment."""
    return Profile((EvenRun(steps, period),) if steps else ())


@dataclass
class Forecast:
    """The extreme timelines that everything heard so far admits; a value, like each of them."""

    timelines: tuple[Timeline, ...]

    @classmethod
    def rest(cls, position: int) -> Forecast:
        """At rest at a known place."""
        return cls((Timeline("HD", position),))

    @classmethod
    def started(
        cls,
        window: TimeWindow,
        origin: int,
        direction: int,
        course: Callable[[Law], Course],
        law: Law,
        mode: str = "PO",
        stops: tuple[int, int] | None = None,
    ) -> Forecast:
        """A motion of 13h, 14h (mode PO) or 15h (VE) that began in the window."""
        return cls.of(
            Timeline(
                mode,
                origin,
                edge,
                direction,
                course(replace(law, rounding=rounding)),
                stops=stops,
                leads=leads,
            )
            for edge in window.edges
            for rounding in ROUNDINGS
            for leads in law.leads
        )

    @classmethod
    def of(cls, timelines: Iterable[Timeline]) -> Forecast:
        """Collect timelines, each once."""
        all_of_them = tuple(timelines)
        return cls(all_of_them if len(all_of_them) == 1 else tuple(dict.fromkeys(all_of_them)))

    @once
    def over_ns(self) -> int:
        """From when on the axis is at rest for certain."""
        return max([timeline.over_ns for timeline in self.timelines])

    @once
    def mode(self) -> str:
        """The mode in which all timelines begin; "" if they differ."""
        modes = {timeline.mode for timeline in self.timelines}
        return modes.pop() if len(modes) == 1 else ""

    @once
    def steady_until_ns(self) -> int:
        """Until when all timelines are surely still in `mode`."""
        if not self.mode:
            return -NEVER_NS
        return min(
            [min(timeline.over_ns, timeline._segments_from_ns) for timeline in self.timelines]
        )

    @once
    def is_in_one_place(self) -> bool:
        """True if all histories come to rest at the same place."""
        return len({timeline.final for timeline in self.timelines}) == 1

    @once
    def rested(self) -> Forecast:
        """What is left of it from `over_ns` on."""
        if self.over_ns == -NEVER_NS:
            return self
        return Forecast.of([timeline.at_rest(self.over_ns) for timeline in self.timelines])

    @once
    def places(self) -> tuple[int, int]:
        """The lowest and the highest counter that may be read from `over_ns` on."""
        origins = [timeline.origin for timeline in self.rested.timelines]
        return min(origins), max(origins)

    @once
    def stops_reported(self) -> frozenset[int]:
        """What 21h may tell of the software stops from `over_ns` on."""
        return frozenset(
            [
                ff
                for timeline in self.rested.timelines
                for ff in (timeline.ff, timeline.ff | timeline.doubt)
            ]
        )

    def changes_in(self, window: TimeWindow) -> Iterator[tuple[Timeline, int]]:
        """The histories, each with the instants of the window that bound what a change of course
        leads to that is taken over then.

        With either edge come those between these histories in which an increment ends right after
        it, or right at it: there the change begins at once.
        """
        for timeline in self.timelines:
            for moment in timeline.levels_in(window):
                yield timeline, moment
        for edge in dict.fromkeys(window):
            under_way = [each for each in self.timelines if each.mode_at(edge) in ("PO", "VE")]
            done = [each.steps_by(edge) for each in under_way]
            for timeline, steps in zip(under_way, done, strict=True):
                if steps > min(done):
                    yield timeline.ending(steps, edge + 1), edge
                if steps < max(done):
                    yield timeline.ending(steps + 1, edge), edge

    def stopped(self, window: TimeWindow) -> Forecast:
        """17h, or 15h with period 0, was taken over in the window."""
        return Forecast.of([slowed_down(each, moment) for each, moment in self.changes_in(window)])

    def halted(self, window: TimeWindow) -> Forecast:
        """18h was taken over in the window: the axis stands where it is (§5.7)."""
        described = {(timeline.ff, timeline.doubt) for timeline in self.timelines}
        if window.latest_ns >= self.steady_until_ns or len(described) > 1:
            return Forecast.of(
                [
                    timeline.at_rest(moment)
                    for timeline in self.timelines
                    for moment in timeline.turns_in(window)
                ]
            )
        # Nothing but the place differs, and only how far it may be on either side counts.
        places = {
            timeline.position_at(moment): (timeline, moment)
            for timeline in self.timelines
            for moment in timeline.turns_in(window)
        }
        extremes = (places[min(places)], places[max(places)])
        return Forecast.of([timeline.at_rest(moment) for timeline, moment in extremes])

    def changed(self, window: TimeWindow, period: int) -> Forecast:
        """15h with a new period was taken over in the window, during 13h, 14h or 15h."""
        return Forecast.of(
            [speed_changed(each, moment, period) for each, moment in self.changes_in(window)]
        )

    def bounds(self, window: TimeWindow) -> tuple[int, int]:
        """The lowest and the highest counter that may be read in the window.

        One step more than done is admissible: whether an increment counts at its beginning or at
        its end cannot be told on a serial line (MACS-AMB-41).
        """
        earliest_ns, latest_ns = window
        if earliest_ns >= self.over_ns:
            return self.places
        seen: list[int] = []
        for timeline in self.timelines:
            seen += timeline.places_at(earliest_ns)
            if earliest_ns < timeline.over_ns and latest_ns != earliest_ns:
                for time_ns in timeline.turns_in(window)[1:]:
                    seen += timeline.places_at(time_ns)
        return min(seen), max(seen)

    @property
    def end(self) -> TimeWindow | None:
        """When the axis comes to rest; None if only a command can stop it."""
        ends = [timeline.end_ns for timeline in self.timelines]
        known = [end for end in ends if end is not None]
        return TimeWindow(min(known), max(known)) if len(known) == len(ends) else None

    @property
    def final(self) -> tuple[int, int]:
        """The bounds of the place where the axis comes to rest."""
        finals = [timeline.final for timeline in self.timelines]
        known = [final for final in finals if final is not None]
        assert len(known) == len(finals), "an endless motion has no final place"
        return min(known), max(known)

    def ends_after(self, now_ns: int) -> list[int]:
        """When motions, and stages of motions, will be over."""
        ends = {leg.end_ns for timeline in self.timelines for leg in timeline.legs}
        return sorted(end for end in ends if end is not None and end > now_ns)

    def modes(self, window: TimeWindow) -> frozenset[str]:
        """The states the axis may be in within the window."""
        earliest_ns, latest_ns = window
        if earliest_ns >= self.over_ns:
            return RESTING
        if latest_ns < self.steady_until_ns:
            return ALL_ALIKE[self.mode]
        return frozenset(
            [timeline.mode_at(edge) for timeline in self.timelines for edge in window.edges]
        )


def _ticks(timeline: Timeline, now_ns: int) -> int:
    return max(0, now_ns - timeline.start_ns) // TICK_NS


def slowed_down(timeline: Timeline, now_ns: int, *, drops_segments: bool = False) -> Timeline:
    """A history in which 17h, or 15h with period 0, was taken over then.

    What waits for the end of the motion runs when the axis rests, or is dropped (MACS-AMB-77).
    """
    if timeline.course is None or timeline.mode_at(now_ns) not in ("PO", "VE"):
        return timeline
    course = timeline.course.stopped(_ticks(timeline, now_ns))
    return timeline.turned(timeline.mode, course, () if drops_segments else timeline.segments)


def speed_changed(timeline: Timeline, now_ns: int, period: int) -> Timeline:
    """A history in which 15h with a new period was taken over then."""
    if timeline.course is None or timeline.mode_at(now_ns) not in ("PO", "VE"):
        return timeline
    course = timeline.course.changed(_ticks(timeline, now_ns), period)
    return timeline.turned("VE", course, timeline.segments)
