"""Where the axis may be, when all we know are time windows.

The host knows when an exchange began and ended; the module took the command over, or read its
counter, at some instant in between (`Window`).  A `Timeline` is one exact possible history; a
`Forecast` holds the extreme ones, both edges of every window and both roundings of every period.
A real axis lies between them: later start, slower periods and earlier stops only ever put it
further back, so the extremes bound the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, NamedTuple

from axistwin_conformance.mac_serial.motion import TICK_NS, Course, Law, Profile, Run

ROUNDINGS: Final = ("down", "up")


class Window(NamedTuple):
    """An instant known to lie in [earliest_ns, latest_ns] of the target's clock."""

    earliest_ns: int
    latest_ns: int

    @property
    def edges(self) -> tuple[int, int]:
        """Both ends."""
        return self

    def __str__(self) -> str:
        return f"{self.earliest_ns / 1e6:.3f}..{self.latest_ns / 1e6:.3f} ms"


@dataclass(frozen=True, slots=True)
class Segment:
    """A 16h (steps signed) or a 1Eh (moves False): |steps| periods of `period` ticks."""

    steps: int
    period: int
    moves: bool = True

    @property
    def duration_ns(self) -> int:
        """n·VVVV ticks, steps or none (MACS-CMD-1E-01)."""
        return abs(self.steps) * self.period * TICK_NS


@dataclass(frozen=True, slots=True)
class Leg:
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


@dataclass(frozen=True)
class Timeline:
    """One exact history: at rest at `origin`, or under way from there since `start_ns`.

    `mode`: "HD" at rest, "PO", "VE" or "IN".  `course` belongs to PO and VE.  `segments`: of IN the
    row being executed, of PO and VE what waits for the axis to come to rest (MACS-AMB-31).
    `stops`: the software stops (inferior, superior) if enabled.  `ff`: what 21h told of stops
    before this motion.  `leads`: an increment counts when it begins (MACS-AMB-41).
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

    @cached_property
    def legs(self) -> tuple[Leg, ...]:
        """All legs in order, cut short where a software stop ends the motion (MACS-STOP-03)."""
        legs: list[Leg] = []
        place, now_ns = self.origin, self.start_ns
        if self.course is not None:
            leg, hit = self._cut(Leg(now_ns, place, self.direction, self.course.profile))
            legs.append(leg)
            if hit or leg.end_ns is None or leg.final is None:
                return tuple(legs)
            place, now_ns = leg.final, leg.end_ns
        for segment in self.segments:
            direction = (segment.steps > 0) - (segment.steps < 0) if segment.moves else 0
            profile = Profile((Run(abs(segment.steps), segment.period),) if segment.steps else ())
            leg, hit = self._cut(Leg(now_ns, place, direction, profile))
            legs.append(leg)
            if hit:
                break
            assert leg.final is not None
            place, now_ns = leg.final, now_ns + segment.duration_ns
        return tuple(legs)

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
        return replace(leg, profile=leg.profile.first(allowed)), True

    @cached_property
    def hit(self) -> int:
        """The direction in which a software stop ends this motion; 0 if none does."""
        if not self.legs or self.stops is None:
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

    @property
    def final(self) -> int | None:
        """Where it comes to rest."""
        return self.legs[-1].final if self.legs else self.origin

    def position_at(self, now_ns: int) -> int:
        """The counter at that time."""
        place = self.origin
        for leg in self.legs:
            if leg.start_ns > now_ns:
                break
            place = leg.position_at(now_ns)
        if self.leads and self.start_ns <= now_ns and self.is_running(now_ns):
            place += _heading(self, now_ns)
        return place

    def is_running(self, now_ns: int) -> bool:
        """True before the end of the motion (MACS-STATE-01)."""
        end_ns = self.end_ns
        return self.mode != "HD" and (end_ns is None or now_ns < end_ns)

    def mode_at(self, now_ns: int) -> str:
        """PO, VE or IN while running, else HD."""
        if not self.is_running(now_ns):
            return "HD"
        if self.course is not None and self.segments:
            end_ns = self.legs[0].end_ns
            return self.mode if end_ns is None or now_ns < end_ns else "IN"
        return self.mode

    def waiting(self, now_ns: int) -> int:
        """How many segments are stored and not yet taken by the interpolator."""
        first = 1 if self.course is not None else 0
        begun = sum(leg.start_ns <= now_ns for leg in self.legs[first:])
        return len(self.segments) - begun

    def at_rest(self, now_ns: int) -> Timeline:
        """This history, abandoned now: at rest where the axis is, everything dropped."""
        return Timeline("HD", self.position_at(now_ns), ff=self.stopped_on(now_ns))

    def stopped_on(self, now_ns: int) -> int:
        """The byte ff of 21h: bit 1 superior, bit 0 inferior software stop (§5.9)."""
        if self.mode == "HD" or self.is_running(now_ns):
            return self.ff
        return self.ff | {1: 0x02, -1: 0x01, 0: 0}[self.hit]


@dataclass(frozen=True)
class Forecast:
    """The extreme timelines that everything heard so far admits."""

    timelines: tuple[Timeline, ...]

    @classmethod
    def rest(cls, position: int) -> Forecast:
        """At rest at a known place."""
        return cls((Timeline("HD", position),))

    @classmethod
    def started(
        cls,
        window: Window,
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
                leads=law.step == "start",
            )
            for edge in window.edges
            for rounding in ROUNDINGS
        )

    @classmethod
    def of(cls, timelines: Iterable[Timeline]) -> Forecast:
        """Collect timelines, each once."""
        return cls(tuple(dict.fromkeys(timelines)))

    def map(self, window: Window, change: Callable[[Timeline, int], Timeline]) -> Forecast:
        """Apply something that happened in the window to every timeline, at both edges."""
        return Forecast.of(
            change(timeline, edge) for timeline in self.timelines for edge in window.edges
        )

    def stopped(self, window: Window) -> Forecast:
        """17h, or 15h with period 0, was taken over in the window."""
        return self.map(window, _ramped_stop)

    def halted(self, window: Window) -> Forecast:
        """18h was taken over in the window: the axis stands where it is (§5.7)."""
        return self.map(window, lambda timeline, edge: timeline.at_rest(edge))

    def changed(self, window: Window, period: int) -> Forecast:
        """15h with a new period was taken over in the window, during 13h, 14h or 15h."""
        return self.map(window, lambda timeline, edge: _speed_change(timeline, edge, period))

    def bounds(self, window: Window) -> tuple[int, int]:
        """The lowest and the highest counter that may be read in the window.

        One step more than done is admissible: whether an increment counts at its beginning or at
        its end cannot be told on a serial line (MACS-AMB-41).
        """
        seen = []
        for timeline in self.timelines:
            for edge in window.edges:
                seen.append(timeline.position_at(edge))
                if timeline.is_running(edge):
                    seen.append(timeline.position_at(edge) + _heading(timeline, edge))
        return min(seen), max(seen)

    @property
    def end(self) -> Window | None:
        """When the axis comes to rest; None if only a command can stop it."""
        ends = [timeline.end_ns for timeline in self.timelines]
        known = [end for end in ends if end is not None]
        return Window(min(known), max(known)) if len(known) == len(ends) else None

    @property
    def final(self) -> tuple[int, int]:
        """The bounds of the place where the axis comes to rest."""
        finals = [timeline.final for timeline in self.timelines]
        known = [final for final in finals if final is not None]
        assert len(known) == len(finals), "an endless motion has no final place"
        return min(known), max(known)

    def modes(self, window: Window) -> frozenset[str]:
        """The states the axis may be in within the window."""
        return frozenset(
            timeline.mode_at(edge) for timeline in self.timelines for edge in window.edges
        )


def _heading(timeline: Timeline, now_ns: int) -> int:
    heading = 0
    for leg in timeline.legs:
        if leg.start_ns <= now_ns:
            heading = leg.direction
    return heading


def _ticks(timeline: Timeline, now_ns: int) -> int:
    return max(0, now_ns - timeline.start_ns) // TICK_NS


def _ramped_stop(timeline: Timeline, now_ns: int) -> Timeline:
    if timeline.course is None or timeline.mode_at(now_ns) not in ("PO", "VE"):
        return timeline
    course = timeline.course.stopped(_ticks(timeline, now_ns))
    return replace(timeline, course=course, segments=())  # what waits is dropped (MACS-AMB-51)


def _speed_change(timeline: Timeline, now_ns: int, period: int) -> Timeline:
    if timeline.course is None or timeline.mode_at(now_ns) not in ("PO", "VE"):
        return timeline
    course = timeline.course.changed(_ticks(timeline, now_ns), period)
    return replace(timeline, mode="VE", course=course)
