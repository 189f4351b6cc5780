"""An exact model of the module: for every state and command the set of admissible outcomes.

The model keeps what the module keeps (parameters, the synchronous mode) and a `Forecast` of the
motion.  When a command may have been taken over before or after the end of a motion, both replies
are admissible; the one that comes tells the model which history is true, and the others are
dropped.  So every reply is judged against everything heard before it.

The readings of ambiguities that the device has shown are an argument: the model holds the device to
them for the whole sequence.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.acceptance import (
    ACCEPTANCE,
    RUNNING,
    AcceptanceRow,
    outcome_of,
)
from axistwin_conformance.families.mac.axis.model.forecast import (
    NEVER_NS,
    RESTING,
    ROUNDINGS,
    Forecast,
    Segment,
    Timeline,
    TimeWindow,
    slowed_down,
    speed_changed,
)
from axistwin_conformance.families.mac.axis.model.kinematics import Course, Law, once
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS, SHOWN_BY

FIFO_STAGES: Final = 3
TARGET_EDGE: Final = 0x40000000
MOTIONS: Final = (0x13, 0x14, 0x15)
SEGMENTS: Final = (0x16, 0x1E)
RESHAPING: Final = frozenset({0x15, 0x17})  # what may come during a motion and alters its course
DROPPING: Final = (0x17, 0x18, 0x1A)
REINITIALISE: Final = 0x00
NOT_BUSY: Final = frozenset({False})
STOPPING: Final = frozenset(DROPPING)
ABANDONING: Final = frozenset({0x18, 0x1A, REINITIALISE})  # the axis stays where it then is
ACTING: Final = frozenset({*MOTIONS, *SEGMENTS, *DROPPING, REINITIALISE, 0x0B, 0x11})  # on the axis


@dataclass(slots=True)
class Parameters:
    """The stored parameters as the queries show them."""

    superior: int
    inferior: int
    catch_up: int
    period: int
    coefficient: int
    torque: int
    standby: int
    stops: int
    tolerance: int
    imax: int

    def answer(self, index: int) -> int:
        """The data of queries 22h, 23h, 25h, 26h (§5.9)."""
        return sum(field.shown(getattr(self, field.name)) for field in SHOWN_BY[index])

    @property
    def limits(self) -> tuple[int, int] | None:
        """The software stops, if enabled (MACS-CMD-03-01)."""
        return (self.inferior, self.superior) if self.stops & 8 else None


Laws = tuple[Law, ...]
Known = Callable[[str], int]  # switch → the number of its reading, 0 the default


def _default(switch: str) -> int:
    return 0


@dataclass
class AxisModel:
    """What is known of one module; `forecast` bounds where its axis is."""

    parameters: Parameters
    forecast: Forecast
    known: Known = _default
    law: Law = field(default_factory=Law)
    table: Mapping[int, AcceptanceRow] = field(default_factory=lambda: ACCEPTANCE)
    is_armed: bool = False
    preloaded: int | None = None  # index of the motion held back
    preload_parameter: int = 0
    _cells: dict[tuple[int, str], str] = field(default_factory=dict)
    _fixed: dict[tuple[int, str], ReplyKind | None] = field(default_factory=dict)
    _latest_begun: Forecast | None = None

    @once
    def _rounded(self) -> Laws:
        """Both roundings of the periods of a ramp: the fast one, the slow one."""
        return tuple(replace(self.law, rounding=rounding) for rounding in ROUNDINGS)

    # --- what may be said -------------------------------------------------------------------------

    def states(self, window: TimeWindow) -> frozenset[str]:
        """The states of the acceptance table the module may be in."""
        return frozenset(self._state(mode) for mode in self.forecast.modes(window))

    def name_of(self, modes: frozenset[str]) -> str:
        """What the states that the axis may be in are called in reports."""
        if modes is RESTING:
            return self._state("HD")
        if len(modes) == 1:
            return self._state(*modes)
        return "/".join(sorted([self._state(mode) for mode in modes]))

    def _state(self, mode: str) -> str:
        if mode != "HD":
            return mode
        return "PL" if self.preloaded is not None else "AR" if self.is_armed else "HD"

    def outcomes(self, index: int, parameter: int, window: TimeWindow) -> dict[ReplyKind, Forecast]:
        """Every admissible reply to a command taken over in the window, with what follows."""
        forecast, (earliest_ns, latest_ns) = self.forecast, window
        if earliest_ns >= forecast.over_ns:
            return self._outcomes_at_rest(index, parameter, window)
        if latest_ns < forecast.steady_until_ns and index not in SEGMENTS:
            # The mode is beyond doubt, and only what acts on the axis needs more than that.
            first = forecast.timelines[0]
            kind = self._reply(first, earliest_ns, index, parameter, forecast.mode)
            if index not in ACTING or kind is ReplyKind.REFUSED:
                return {kind: forecast}
            if index == 0x18:
                return {kind: forecast.halted(window)}
            return {kind: self._followed(forecast, window, index, parameter)}
        branches: dict[ReplyKind, list[Timeline]] = {}
        reported: Timeline | None = None  # a row that goes on is the same from either edge
        for timeline, edge in self._cases(forecast, window, index):
            mode = timeline.mode_at(edge)
            now = timeline.at_rest(edge) if mode == "HD" else timeline
            kind = self._reply(now, edge, index, parameter, self._state(mode))
            followers = branches.setdefault(kind, [])
            if kind is ReplyKind.ACCEPTED and index in ACTING:
                if now is not reported:
                    followers += self._effect(now, edge, index, parameter, self._rounded)
                if index in SEGMENTS and mode != "HD":
                    reported = now
            elif not followers or followers[-1] is not now:
                followers.append(now)
        return {kind: Forecast.of(timelines) for kind, timelines in branches.items()}

    def _outcomes_at_rest(
        self, index: int, parameter: int, window: TimeWindow
    ) -> dict[ReplyKind, Forecast]:
        """The same for an axis at rest: there is one reply, and only a start needs both edges."""
        rested, earliest_ns = self.forecast.rested, window.earliest_ns
        kind = self._reply(rested.timelines[0], earliest_ns, index, parameter, self._state("HD"))
        if kind is not ReplyKind.ACCEPTED or index not in ACTING or index in STOPPING:
            return {kind: rested}
        if (index in MOTIONS and not self.is_armed) or index == 0x11:
            return {kind: self._begun(rested, window, index, parameter)}
        return {kind: self._followed(rested, window, index, parameter)}

    def _begun(self, rested: Forecast, window: TimeWindow, index: int, parameter: int) -> Forecast:
        """A start, by what bounds it.

        Until something changes it, no motion is ahead of the one that starts first with periods
        rounded down, and none behind the one that starts last with periods rounded up.
        """
        down, up = self._rounded
        self._latest_begun = Forecast.of(
            [
                follower
                for timeline in rested.timelines
                for edge, laws in ((window.earliest_ns, (down,)), (window.latest_ns, (up,)))
                for follower in self._effect(timeline, edge, index, parameter, laws)
            ]
        )
        return self._latest_begun

    def _whole(self, forecast: Forecast) -> Forecast:
        """A forecast in which nothing is left out: of two courses that lie between the bounds of a
        start, one may be the extreme after a change."""
        if forecast is not self._latest_begun:
            return forecast
        return Forecast.of(
            [timeline for each in forecast.timelines for timeline in self._both(each)]
        )

    def _both(self, timeline: Timeline) -> list[Timeline]:
        """A start from rest by both roundings; any other timeline as it is."""
        course = timeline.course
        if course is None or not course.coefficient or timeline.segments or not course.is_plain:
            return [timeline]
        mode = timeline.mode
        return [timeline.turned(mode, course.rounded(law), ()) for law in self._rounded]

    def _followed(
        self, forecast: Forecast, window: TimeWindow, index: int, parameter: int
    ) -> Forecast:
        """What follows a command that is obeyed, whichever history is true."""
        return Forecast.of(
            [
                follower
                for timeline, edge in self._cases(forecast, window, index)
                for follower in self._effect(timeline, edge, index, parameter, self._rounded)
            ]
        )

    def _cases(
        self, forecast: Forecast, window: TimeWindow, index: int
    ) -> list[tuple[Timeline, int]]:
        """The histories with the instants of a window that bound what follows a command."""
        whole = self._whole(forecast)
        if index in RESHAPING:
            return list(whole.changes_in(window))
        turns = index in ABANDONING
        return [
            (timeline, moment)
            for timeline in whole.timelines
            for moment in (timeline.turns_in(window) if turns else window)
        ]

    def _content(self, index: int, state: str) -> str:
        """The cell of the acceptance table, in the readings of this device."""
        content = self._cells.get((index, state))
        if content is None:
            content = self.table[index].cell(state)
            for other, switch, number in self.table[index].readings(state):
                if self.known(switch) == number:
                    content = other
            self._cells[index, state] = content
        return content

    def _reply(self, now: Timeline, edge: int, index: int, parameter: int, state: str) -> ReplyKind:
        cell = (index, state)
        if cell not in self._fixed:
            self._fixed[cell] = self._reply_to_any(index, state)
        return self._fixed[cell] or self._reply_to(now, edge, index, parameter, state)

    def _reply_to_any(self, index: int, state: str) -> ReplyKind | None:
        """The reply in that state if it does not depend on the parameter or the motion."""
        if self._content(index, state) == "R":
            return ReplyKind.REFUSED
        depends = index in PARAMETERS or index in SEGMENTS or index in (0x07, 0x13, 0x15)
        return None if depends else outcome_of(self._content(index, state))

    def _reply_to(
        self, now: Timeline, edge: int, index: int, parameter: int, state: str
    ) -> ReplyKind:
        content = self._content(index, state)
        if index == 0x03 and parameter & 0xFF == 1 and state in RUNNING:
            content = "R"  # the one value that both lists mark
        if index == 0x15 and self._is_reversal(now, state, parameter):
            content = "R"
        if content == "R":
            return ReplyKind.REFUSED
        setting = PARAMETERS.get(index)
        if setting is not None:
            if not setting.is_valid(setting.taken(parameter), self.parameters.imax):
                return ReplyKind.REFUSED
        elif index in SEGMENTS:
            if not parameter & 0xFFFF or self._is_full(now, edge):
                return ReplyKind.REFUSED
        elif index == 0x13:
            if not -TARGET_EDGE <= signed(parameter) < TARGET_EDGE:
                return ReplyKind.REFUSED
        elif index == 0x07 and parameter & 0xFF > 1:
            return ReplyKind.REFUSED
        return outcome_of(content)

    def _is_reversal(self, now: Timeline, state: str, parameter: int) -> bool:
        """True for a 15h against the motion on a device that refuses those (MACS-AMB-28)."""
        is_refused = self.known("vel_reverse_cmd") == 1 and state == "VE"
        return is_refused and bool(parameter & 0xFFFF) and now.direction != _direction_of(parameter)

    def _is_full(self, now: Timeline, edge: int) -> bool:
        mode = now.mode_at(edge)
        if mode == "HD":
            return False
        executing = int(mode == "IN" and self.known("fifo_counts_executing") == 1)
        return now.waiting(edge) + executing >= FIFO_STAGES

    # --- what then happens to the axis ------------------------------------------------------------

    def _effect(
        self, now: Timeline, edge: int, index: int, parameter: int, laws: Laws
    ) -> list[Timeline]:
        """What follows if the command was taken over then; a start follows each of the laws."""
        is_resting = now.mode_at(edge) == "HD"
        if index in MOTIONS and is_resting and self.is_armed:
            # Accepted now, or when 11h comes: ff may stay so long.
            return [now, now.described(0)]
        if index in MOTIONS:
            return self._motion(now, edge, index, parameter, laws if is_resting else ())
        if index in SEGMENTS:
            return self._segment(now, index, parameter, edge, is_resting)
        if index == 0x11 and is_resting and self.preloaded is not None:
            return self._start(now, edge, self.preloaded, self.preload_parameter, laws)
        if index == 0x17:
            drops = self.known("segments_after_17h") == 1
            return [slowed_down(now, edge, drops_segments=drops)]
        if index in ABANDONING:
            rest = now.at_rest(edge)
            return [rest.described(0) if index == REINITIALISE else rest]
        if index == 0x0B:
            return [replace(now, origin=now.origin - now.position_at(edge))]
        return [now]

    def _motion(
        self, now: Timeline, edge: int, index: int, parameter: int, laws: Laws
    ) -> list[Timeline]:
        if laws:
            return self._start(now, edge, index, parameter, laws)
        # Only 15h gets here: 13h and 14h are refused while running.
        period = parameter & 0xFFFF
        return [speed_changed(now, edge, period) if period else slowed_down(now, edge)]

    def _start(
        self, now: Timeline, edge: int, index: int, parameter: int, laws: Laws
    ) -> list[Timeline]:
        parameters = self.parameters
        laws = (
            laws if parameters.coefficient else self._rounded[:1]
        )  # without ramp nothing is rounded
        origin = now.position_at(edge)
        if index == 0x15:
            period = parameter & 0xFFFF
            if not period:
                return [now, now.described(0)]
            direction = _direction_of(parameter)
            courses = [Course.endless(period, parameters.coefficient, law) for law in laws]
        else:
            target = 0 if index == 0x14 else signed(parameter)
            direction = (target > origin) - (target < origin)
            courses = [
                Course.to_position(
                    abs(target - origin), parameters.period, parameters.coefficient, law
                )
                for law in laws
            ]
        mode = "VE" if index == 0x15 else "PO"
        return [
            Timeline(mode, origin, edge, direction, course, stops=parameters.limits, leads=leads)
            for course in courses
            for leads in self.law.leads
        ]

    def _segment(
        self, now: Timeline, index: int, parameter: int, edge: int, is_resting: bool
    ) -> list[Timeline]:
        steps = signed(parameter >> 16, 16)
        segment = Segment(steps, parameter & 0xFFFF, moves=index == 0x16)
        if is_resting:
            origin = now.position_at(edge)
            stops = self.parameters.limits
            return [
                Timeline("IN", origin, edge, segments=(segment,), stops=stops, leads=leads)
                for leads in self.law.leads
            ]
        return [now.followed_by(segment)]

    # --- learning ---------------------------------------------------------------------------------

    def learn(self, index: int, parameter: int, kind: ReplyKind, after: Forecast) -> None:
        """Take over that the command got this (admissible) reply."""
        self.forecast = after
        if kind is not ReplyKind.ACCEPTED:
            return
        if index in PARAMETERS:
            setting = PARAMETERS[index]
            setattr(self.parameters, setting.name, setting.taken(parameter))
        elif index == 0x10:
            self.is_armed = True
        elif index in MOTIONS and self.is_armed and after.over_ns == -NEVER_NS:
            self.preloaded, self.preload_parameter = index, parameter
        elif (
            index in DROPPING
            or index == REINITIALISE
            or (index == 0x11 and self.preloaded is not None)
        ):
            self.is_armed, self.preloaded = False, None

    def bounds(self, window: TimeWindow) -> tuple[int, int]:
        """The admissible counter readings."""
        return self.forecast.bounds(window)

    def learn_position(self, position: int, window: TimeWindow) -> None:
        """An axis surely at rest is where it says, if that was admissible."""
        if window.earliest_ns >= self.forecast.over_ns:
            rested = self.forecast.rested
            if rested.places != (position, position) or rested.timelines[0].after != "HD":
                rested = Forecast.of([timeline.read(position) for timeline in rested.timelines])
            self.forecast = rested

    def stopped_on(self, window: TimeWindow) -> frozenset[int]:
        """The admissible values of ff."""
        if window.earliest_ns >= self.forecast.over_ns:
            return self.forecast.stops_reported
        described = [
            timeline.stopped_on(edge)
            for timeline in self.forecast.timelines
            for edge in window.edges
        ]
        return frozenset([ff for ff, _ in described] + [ff | doubt for ff, doubt in described])

    def learn_status(self, ff: int, window: TimeWindow) -> None:
        """What an axis surely at rest has told of its stops, stays so until the next motion."""
        if window.earliest_ns >= self.forecast.over_ns:
            rested = self.forecast.rested
            if rested.stops_reported != {ff}:
                rested = Forecast.of([timeline.described(ff) for timeline in rested.timelines])
            self.forecast = rested

    def busy(self, window: TimeWindow) -> frozenset[bool]:
        """The admissible values of busy (MACS-BUSY-01)."""
        if window.earliest_ns >= self.forecast.over_ns:
            return NOT_BUSY
        return frozenset(
            [
                left > self.parameters.tolerance
                for timeline in self.forecast.timelines
                for edge in window.edges
                for left in _steps_left(timeline, edge)
            ]
        )


def _steps_left(timeline: Timeline, edge: int) -> tuple[int, ...]:
    """Increments to the target of a 13h or 14h, counted at the end or the beginning of each."""
    if timeline.course is None or timeline.mode_at(edge) != "PO":
        return (-1,)
    left = (timeline.course.profile.steps or 0) - abs(timeline.position_at(edge) - timeline.origin)
    return left, left - 1


def _direction_of(parameter: int) -> int:
    """The direction a 15h asks for (MACS-CMD-15-01)."""
    return -1 if parameter >> 16 & 0xFF == 0xF6 else 1
