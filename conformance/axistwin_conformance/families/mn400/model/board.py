"""One board as the suite expects it: what may answer a command now, and what is true after it.

    expect(text, now) ─▶ the admissible replies, and by which requirement
    accept(text, now)    the command has drawn what was expected: take its effect over

`now` is the span of time in which the board may have carried the command out.  Where the span does
not tell in which state it was (a move may just have ended), the replies of all those states are
admissible.  Where a cell of the table is an interpretation, so is what is expected there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Final

from axistwin_conformance.families.mn400.codec import END_OF_PROGRAM
from axistwin_conformance.families.mn400.grammar import (
    DEFAULT_MARGIN,
    OPEN_REFUSALS,
    ParsedCommand,
    ReadingOf,
    Refusal,
    ReplyForm,
    arc_radii_differ,
    read_command,
    rule_of,
)
from axistwin_conformance.families.mn400.model.motions import (
    CircleMotion,
    CompensatedMotion,
    ContourMotion,
    MotionTimeline,
    PacedMotion,
    Place,
    PlannedMotion,
    Span,
    VectorMotion,
    exactly,
)
from axistwin_conformance.families.mn400.model.settings import BoardSettings, power_on
from axistwin_conformance.families.mn400.model.states import (
    REPLIES,
    BoardState,
    CellOutcome,
    StateCell,
    state_table,
)
from axistwin_conformance.families.mn400.planner.circle import CircleMove
from axistwin_conformance.families.mn400.planner.contour import (
    ContourMove,
    ContourRules,
    ContourSegment,
    MarginScope,
)
from axistwin_conformance.families.mn400.planner.pulses import can_be_threaded
from axistwin_conformance.families.mn400.planner.vector import AXES, VectorMove

Reply = tuple[str, ...]  # what each packet says: the name of its code, or "data"
ENTRIES: Final = (BoardState.PRG, BoardState.CFG)
MOTIONS: Final = "A+MT"  # what asks for motion; ) does where a contour is entered
REFUSED_LINES: Final = "Z."  # no line of a program (MN4-AMB-54)
START: Final = "START"


@dataclass(frozen=True, slots=True)
class Expectation:
    """What a command may draw: the admissible replies, and whose business that is.

    `is_open`: the manual is silent here, so that another reply is told and no failure.
    """

    replies: frozenset[Reply]
    requirement: str
    is_open: bool = False


@dataclass
class ContourEntry:
    """A contour that is being entered: its margin, the segments so far, and the speed in force."""

    margin: int
    speed: int
    segments: list[ContourSegment] = field(default_factory=list)


class BoardModel:
    """What is known of one board."""

    def __init__(self, reading: ReadingOf, settings: BoardSettings | None = None) -> None:
        self.reading = reading
        self.settings = power_on(reading) if settings is None else settings
        self.timeline = MotionTimeline()
        self.pending: ParsedCommand | PlannedMotion | None = None
        self.contour: ContourEntry | None = None
        self.entry: BoardState | None = None  # PRG or CFG
        self.lines: list[str] = []  # of the entry
        self.program: tuple[str, ...] | None = None  # as stored; None: unknown
        self.is_jogging = False
        self.is_paused = False
        self.is_pause_sure = True  # False: what was to be paused may have been over
        self.is_running = False  # the stored program may run
        self.was_aborted = False

    # --- in what state it may be ------------------------------------------------------------------

    def states(self, now: Span) -> frozenset[BoardState]:
        """All states in which it may be at some time of this span."""
        if self.entry is not None:
            return frozenset({self.entry})
        if self.contour is not None:
            return frozenset({BoardState.CCB})
        if self.pending is not None:
            return frozenset({BoardState.HPD})
        if self.is_jogging:
            return frozenset({BoardState.JOG})
        return frozenset(self._of_motion(now))

    def _of_motion(self, now: Span) -> Iterator[BoardState]:
        if self.is_paused:
            yield BoardState.PAU
        elif self.timeline.may_run(now):
            yield from self._running(now)
        if self.is_running:
            yield BoardState.RUN
        if self.is_paused:
            is_resting = not self.is_pause_sure
        else:
            is_resting = not self.timeline.must_run(now)
        if is_resting:
            yield self._resting()

    def _resting(self) -> BoardState:
        if self.settings.holds:
            return BoardState.HLD
        return BoardState.ABT if self.was_aborted else BoardState.RDY

    def _running(self, now: Span) -> Iterator[BoardState]:
        motion = self.timeline.motions[0].motion
        if isinstance(motion, PacedMotion):
            yield BoardState.THR
        elif isinstance(_bare(motion), ContourMotion):
            yield BoardState.CCX
        else:
            least, most = self.timeline.waiting(now)
            if least == 0:
                yield BoardState.MOV
            if most:
                yield BoardState.QUE

    # --- what a command may draw ------------------------------------------------------------------

    def expect(self, text: str, now: Span) -> Expectation:
        """What a sound request with this text may draw."""
        letter = text[:1].upper()
        if letter == "&" and (self.entry is None or self.reading("retransmit_in_entry") != "store"):
            return Expectation(frozenset({("data",), ("DONE",), ()}), "MN4-CMD-RTX-01")
        if self.entry is not None:
            return self._of_line(text)
        if rule_of(text) is None or self._is_missing(letter):
            return self._error("INVALIDCOMMAND", "MN4-ERR-01", is_recognised=False)
        found = [self._of_state(letter, text, state) for state in self._states_for(letter, now)]
        replies = frozenset(reply for one in found for reply in one.replies)
        return Expectation(replies, found[0].requirement, any(one.is_open for one in found))

    def _is_missing(self, letter: str) -> bool:
        """True for a command that not every board has (MN4-AMB-38)."""
        return letter in (";", ":") and self.reading("has_feedhold_cmds") == "false"

    def expect_in(self, text: str, state: BoardState) -> Expectation:
        """What a command may draw in a state, whatever else is known."""
        if rule_of(text) is None or self._is_missing(text[:1]):
            return self._error("INVALIDCOMMAND", "MN4-ERR-01", is_recognised=False)
        return self._of_state(text[:1].upper(), text, state)

    def _states_for(self, letter: str, now: Span) -> frozenset[BoardState]:
        """The states by which a command is judged: with hold on, what asks for motion is kept even
        while a released motion runs."""
        states = self.states(now)
        keeps = self._keeps(letter) and BoardState.HPD not in states
        return frozenset({BoardState.HLD}) if keeps and not states & {BoardState.CCB} else states

    def _keeps(self, letter: str) -> bool:
        """True if hold keeps that command now (MN4-AMB-18)."""
        return self.settings.holds and letter in self.reading("hold_scope")

    def _of_state(self, letter: str, text: str, state: BoardState) -> Expectation:
        cell = self._cell(letter, state)
        if state is BoardState.HPD and cell.outcome is CellOutcome.MOVE_PENDING:
            return Expectation(frozenset({(START, "MOVEPENDING")}), "MN4-RSP-09", cell.is_open)
        if state is BoardState.CCB and cell.outcome is CellOutcome.UNKNOWN:
            if self.reading("cc_unsupported") == "executed" and letter != "(":
                served = self._of_state(letter, text, BoardState.RDY)
                return Expectation(served.replies, "MN4-CMD-CC-03", is_open=True)
            return self._unsupported()
        if cell.outcome is CellOutcome.BUSY:
            return self._error("BUSY", "MN4-ERR-06", is_open=cell.is_open)
        refusal = self._refusal(text)
        if refusal is not None:
            is_open = refusal.requirement in OPEN_REFUSALS
            return self._error("PARA_ERROR", refusal.requirement, is_open=is_open)
        return Expectation(self._replies(letter, cell), _requirement(letter), cell.is_open)

    def _cell(self, letter: str, state: BoardState) -> StateCell:
        """The cell of the table, in the reading of this board (MN4-AMB-16)."""
        if state is BoardState.HLD and letter in MOTIONS and not self._keeps(letter):
            state = BoardState.RDY
        cell = state_table()[letter, state]
        exempt = self.reading("movepending_exempt").replace("&", "")
        if state is BoardState.HPD and letter in exempt and letter != "K":
            return state_table()[letter, BoardState.HLD]
        return cell

    def _replies(self, letter: str, cell: StateCell) -> frozenset[Reply]:
        """What a command draws that is carried out."""
        reply = REPLIES[cell.outcome]
        if (
            cell.outcome is CellOutcome.PENDING
            and self.reading("pending_move_reply") == "movepending"
        ):
            reply = (START, "MOVEPENDING")
        if letter == "K" and cell.outcome is CellOutcome.DONE:
            is_done = self.reading("release_reply") == "done"
            reply = (START, "DONE" if is_done else "MOVEPENDING")
        if cell.outcome is CellOutcome.BAUD and self.reading("baud_reply") == "plus_done":
            reply = (*reply, "DONE")
        return frozenset({reply})

    def _unsupported(self) -> Expectation:
        """What a contour does not take (MN4-AMB-32)."""
        replies: dict[str, Reply] = {
            "invalidcommand": ("INVALIDCOMMAND",),
            "busy": (START, "BUSY"),
            "ignored": (START, "DONE"),
        }
        reading = self.reading("cc_unsupported")
        admissible = {replies[reading]} if reading in replies else {*replies.values()}
        if reading == "invalidcommand" and self.reading("error_start_policy") == "always":
            admissible = {(START, "INVALIDCOMMAND")}
        return Expectation(frozenset(admissible), "MN4-CMD-CC-03", is_open=True)

    def _error(
        self, code: str, requirement: str, *, is_recognised: bool = True, is_open: bool = False
    ) -> Expectation:
        """An error, with the START that this board sends before it (MN4-AMB-04)."""
        policy = self.reading("error_start_policy")
        has_start = policy == "always" or (policy == "after_accept" and is_recognised)
        reply = (START, code) if has_start else (code,)
        return Expectation(frozenset({reply}), requirement, is_open)

    def _of_line(self, text: str) -> Expectation:
        """What a line of a program, or of the configuration, draws."""
        letter = text[:1].upper()
        is_end = text == (END_OF_PROGRAM if self.entry is BoardState.PRG else letter)
        if is_end and (self.entry is BoardState.PRG or letter == "Q"):
            return Expectation(frozenset({(START, "DONE")}), "MN4-NVM-01")
        is_unknown = rule_of(text) is None or self._is_missing(letter)
        if self.reading("prog_check") == "entry" and (is_unknown or letter in REFUSED_LINES):
            return self._error("INVALIDPROGCOMM", "MN4-NVM-06", is_open=True)
        # What ends a program is no line of one: another entry may refuse it in any reading.
        is_open = text == END_OF_PROGRAM
        return Expectation(frozenset({(START, "DONE")}), "MN4-STM-04", is_open)

    # --- parameters that the state decides about --------------------------------------------------

    def _refusal(self, text: str) -> Refusal | None:
        """Why the parameters of a text are refused now."""
        read = read_command(text, self.reading)
        if isinstance(read, Refusal):
            return read
        if read.letter in "A+":
            return self._refused_circle(read)
        if read.letter == "P" and self.reading("plane_z_check") == "at_plane":
            x, y, z = self.settings.after(read, self.reading).plane
            kept = Refusal("the traverse motor is in the plane", "MN4-CMD-P-03")
            return kept if z in (x, y) else None
        if read.letter == "F" and self.reading("speed_range_policy") != "clip":
            start, end, _ = self.settings.after(read, self.reading).profile
            return Refusal("start above end", "MN4-CMD-F-02") if start > end else None
        if read.letter != "T" or self.reading("threader_overrate") != "para_error":
            return None
        if can_be_threaded(self._displacements(read), read.value(AXES)):
            return None
        return Refusal("more steps than pulses", "MN4-THR-05")

    def _refused_circle(self, command: ParsedCommand) -> Refusal | None:
        x, y, z = self.settings.plane
        if command.letter == "+" and z in (x, y) and self.reading("plane_z_check") == "at_helix":
            return Refusal("the traverse motor is in the plane", "MN4-CMD-HEL-04")
        centre, end = self._of_circle(command)
        return arc_radii_differ(centre, end, Fraction(self.reading("arc_radius_tol")))

    def _of_circle(self, command: ParsedCommand) -> tuple[tuple[int, int], tuple[int, int]]:
        """Centre and end from the start (MN4-CMD-A-02, MN4-AMB-30)."""
        points = [command.value(index) for index in range(4)]
        fields = self.reading("helix_abs_fields") if command.letter == "+" else "center_dest"
        if self.settings.is_absolute and fields != "none":
            here = [self._here(self.settings.plane[axis]) for axis in (0, 1)] * 2
            omitted = [command.values[index] is None for index in range(4)]
            pairs = zip(points, here, omitted, strict=True)
            points = [0 if is_left_out else at - base for at, base, is_left_out in pairs]
        return (points[0], points[1]), (points[2], points[3])

    def _here(self, axis: int) -> int:
        """Where an axis is when the motion begins; the middle of what is known."""
        low, high = self.timeline.end[axis]
        return (low + high) // 2

    def _displacements(self, command: ParsedCommand) -> tuple[int, ...]:
        """How far each axis goes; one that is left out stands in both modes (MN4-PAR-06)."""
        is_absolute = self.settings.is_absolute
        return tuple(
            0 if one is None else one - (self._here(axis) if is_absolute else 0)
            for axis, one in enumerate(command.values[:AXES])
        )

    # --- what is true afterwards ------------------------------------------------------------------

    def accept(self, text: str, now: Span) -> None:
        """The command has drawn what stands for its being carried out."""
        letter = text[:1].upper()
        if self.entry is not None:
            self._take_line(text)
            return
        command = read_command(text, self.reading)
        if isinstance(command, Refusal):
            return
        self.timeline.forget(now[0])
        if self.contour is not None:
            self._take_segment(command, now)
        elif letter == "K":
            self._release(now)
        elif self._keeps(letter) and (letter in MOTIONS or letter in _ENTERING):
            self.pending = command
        elif letter in MOTIONS:
            self._run(self._motion(command), now)
        elif letter == "L":
            self._load(command, now)
        elif letter in _ENTERING:
            _ENTERING[letter](self, command)
        elif letter in "Q{}":
            {"Q": self._quit, "{": self._pause, "}": self._resume}[letter](now)
        else:
            self.settings = self.settings.after(command, self.reading)

    def _take_line(self, text: str) -> None:
        is_program = self.entry is BoardState.PRG
        is_end = text == END_OF_PROGRAM if is_program else text[:1].upper() == "Q"
        if not is_end:
            self.lines.append(text)
            return
        if is_program:
            self.program = tuple(self.lines)
        self.entry, self.lines = None, []

    def _take_segment(self, command: ParsedCommand, now: Span) -> None:
        """M and V within a contour; ) runs it, Q forgets it (MN4-CMD-CC-02, MN4-CMD-CC-04)."""
        assert self.contour is not None, "only asked while one is entered"
        entry = self.contour
        if command.letter == "M":
            self.contour.segments.append(ContourSegment(self._of_segment(command), entry.speed))
        elif command.letter == "V":
            entry.speed = command.value(0)
        elif command.letter == ")":
            self.contour = None
            self.settings = replace(self.settings, speed=entry.speed)  # MN4-CMD-CC-07
            motion = self._contour_motion(entry)
            if self._keeps(")") and motion is not None:
                self.pending = motion
            else:
                self._run(motion, now)
        elif command.letter == "Q":
            self.contour = None
            if self.reading("quit_in_entry") == "both":
                self._quit(now)

    def _of_segment(self, command: ParsedCommand) -> tuple[int, ...]:
        """A segment's displacements; in absolute mode from where the ones before it lead."""
        assert self.contour is not None, "only asked while one is entered"
        if not self.settings.is_absolute:
            return self._displacements(command)
        gone = [sum(one.displacements[axis] for one in self.contour.segments) for axis in range(4)]
        rows = zip(command.values, self._displacements(command), gone, strict=True)
        return tuple(0 if was is None else by - done for was, by, done in rows)

    def _contour_motion(self, entry: ContourEntry) -> PlannedMotion | None:
        rules = ContourRules(
            entry.margin,
            self.settings.motion_profile(self.reading),
            MarginScope(self.reading("cc_margin_scope")),
            has_hard_corners=self.reading("cc_corner_speed") != "margin",
        )
        if any(one.speed < 0 for one in entry.segments):
            return PacedMotion((0,) * AXES)
        contour = ContourMove(entry.segments, rules)
        if not contour.plans:
            return None
        rows = [one.displacements for one in contour.segments]
        # With a multiplex any of the ticks of a step may make it (MN4-AMB-65).
        is_early = self._is_early or self.settings.multiplex > 1
        motion = ContourMotion(contour, is_early=is_early)
        return self._compensated(motion, _first_moves(rows), _first_moves(rows[::-1]))

    @property
    def _is_early(self) -> bool:
        return self.reading("step_phase") == "start"

    def _motion(self, command: ParsedCommand) -> PlannedMotion:
        """What a motion command asks for, with the settings in force (MN4-STM-07)."""
        if command.letter == "T" or self.settings.is_synced:
            return PacedMotion((0,) * AXES)
        if command.letter == "M":
            return self._vector(self._displacements(command))
        centre, end = self._of_circle(command)
        traverse = command.value(5)
        if command.letter == "+" and self.settings.is_absolute and command.values[5] is not None:
            is_place = self.reading("helix_abs_fields") == "all"
            traverse -= self._here(self.settings.plane[2]) if is_place else 0
        helix = {"traverse": traverse, "turns": command.value(6)}
        rules = self.settings.circle(self.reading)
        if command.letter == "+":
            rules = replace(rules, is_full_at_zero=self.reading("helix_zero_final") == "full")
        circle = CircleMove(centre, end, command.value(4), rules, **helix)
        first, last = list((0,) * AXES), list((0,) * AXES)
        for signs, is_end in ((first, False), (last, True)):
            x, y, z = self.settings.plane
            signs[z] = circle.traverse
            signs[x], signs[y] = circle.signs(is_end=is_end)
        return self._compensated(CircleMotion(circle, self.settings.plane), first, last)

    def _vector(self, displacements: tuple[int, ...]) -> PlannedMotion:
        move = VectorMove(displacements, self.settings.motion(self.reading))
        motion = VectorMotion(move, is_early=self._is_early)
        return self._compensated(motion, displacements, displacements)

    def _compensated(
        self, motion: PlannedMotion, first: Sequence[int], last: Sequence[int]
    ) -> PlannedMotion:
        """A motion behind the compensation of backlash that it needs, by the directions in which
        each axis begins and ends (MN4-BKL-01, MN4-BKL-06, MN4-BKL-07)."""
        backlash, settings = self.settings.backlash, self.settings.motion(self.reading)
        if self.reading("backlash_speed") == "start":
            settings = replace(settings, speed=min(settings.speed, settings.profile.start))
        before = VectorMove(backlash.compensation(first), settings)
        self.settings = replace(self.settings, backlash=backlash.after(last))
        is_counted = self.reading("backlash_counts") == "true"
        return CompensatedMotion(before, motion, is_counted) if before.length else motion

    def _run(self, motion: PlannedMotion | None, now: Span) -> None:
        if motion is not None:
            self.was_aborted = False
            self.timeline.add(motion, now, self.settings.backlash.memory)

    def _release(self, now: Span) -> None:
        held, self.pending = self.pending, None
        if held is None:
            return
        if isinstance(held, PlannedMotion):
            self._run(held, now)
        elif held.letter in MOTIONS:
            self._run(self._motion(held), now)
        else:
            _ENTERING[held.letter](self, held)
        if self.reading("hold_after_release") == "one_shot":
            self.settings = replace(self.settings, holds=False)

    def _load(self, command: ParsedCommand, now: Span) -> None:
        """Counters from here on; those of motions that still run come before it in the queue, or
        are loaded as they run (MN4-AMB-52)."""
        left_out = (0, 0) if self.reading("omitted_param") == "zero" else None
        is_queued = self.reading("queue_modal") == "true"
        here = self.timeline.end if is_queued else self.where(now)
        pairs = zip(here, command.values, strict=True)
        place: Place = tuple((left_out or was) if one is None else (one, one) for was, one in pairs)
        rows = self.timeline.motions or self.timeline.held
        if rows and not is_queued:
            self.timeline.shift(here, place)
        elif rows:  # behind what is paused, too
            rows[-1] = replace(rows[-1], end=place)
        else:
            self.timeline.place = place

    def _pause(self, now: Span) -> None:
        """At rest it does nothing and is not kept (MN4-CMD-PAU-04)."""
        if self.is_paused or not self.timeline.may_run(now):
            return
        self.is_paused, self.is_pause_sure = True, self.timeline.must_run(now)
        profile = self.settings.motion_profile(self.reading)
        is_ramped = self.reading("pause_decel") == "true"
        braking = (profile.end - profile.start) / profile.acceleration if is_ramped else Fraction(0)
        self.timeline.pause(now, braking)

    def _resume(self, now: Span) -> None:
        if self.is_paused:
            self.is_paused = False
            self.timeline.resume(now)

    def _quit(self, now: Span) -> None:
        self.was_aborted = self.timeline.may_run(now) or self.is_paused or self.is_running
        self.is_paused = self.is_running = False
        self.pending = None  # only a board that serves Q meanwhile comes here (MN4-AMB-16)
        flushes = self.reading("quit_flushes_queue") == "true"
        rows = self.timeline.motions or self.timeline.held
        if rows and flushes:  # what never moved is not remembered (MN4-BKL-02)
            backlash = replace(self.settings.backlash, memory=rows[0].memory)
            self.settings = replace(self.settings, backlash=backlash)
        self.timeline.stop(now, flushes=flushes)

    # --- what it tells ----------------------------------------------------------------------------

    def where(self, now: Span) -> Place:
        """What E may tell of each axis at some time of this span."""
        return self.timeline.where(now)

    def observe(self, position: tuple[int, ...]) -> None:
        """E has told where the axes are, and they stand."""
        self.timeline.observe(position)

    def loaded(self, text: str, counters: tuple[int, ...]) -> tuple[int, ...]:
        """What the counters are after an L, at rest; the same after any other text."""
        self.load(counters)
        command = read_command(text, self.reading)
        if isinstance(command, ParsedCommand) and command.letter == "L":
            self._load(command, (Fraction(0), Fraction(0)))
        return tuple(low for low, _ in self.timeline.end)

    def load(self, position: tuple[int, ...]) -> None:
        """The counters are known to be these."""
        self.timeline = MotionTimeline(exactly(position))


def _bare(motion: PlannedMotion) -> PlannedMotion:
    """A motion without the compensation before it."""
    return motion.motion if isinstance(motion, CompensatedMotion) else motion


def _first_moves(rows: Iterable[Sequence[int]]) -> tuple[int, ...]:
    """Of each axis the first displacement that is not 0."""
    return tuple(next((one for one in column if one), 0) for column in zip(*rows, strict=True))


def _enter_contour(board: BoardModel, command: ParsedCommand) -> None:
    margin = command.value(0, DEFAULT_MARGIN)
    board.contour = ContourEntry(margin, board.settings.speed)


def _enter_program(board: BoardModel, command: ParsedCommand) -> None:
    board.entry, board.lines = BoardState.PRG, []


def _enter_configuration(board: BoardModel, command: ParsedCommand) -> None:
    board.entry, board.lines = BoardState.CFG, []


def _jog(board: BoardModel, command: ParsedCommand) -> None:
    board.is_jogging = bool(command.value(0))


def _run_program(board: BoardModel, command: ParsedCommand) -> None:
    board.is_running = board.program != ()


_ENTERING: Final = {
    "(": _enter_contour, "Z": _enter_program, ".": _enter_configuration, "J": _jog,
    "U": _run_program,
}  # fmt: skip

# Whose business the answer to a command is that is carried out.
_OWN: Final = {
    "A": "MN4-CMD-A-01", "+": "MN4-CMD-HEL-01", "M": "MN4-CMD-M-01", "T": "MN4-CMD-T-03",
    "(": "MN4-CMD-CC-01", ")": "MN4-CMD-CC-05", "Q": "MN4-CMD-Q-03", "K": "MN4-ERR-04",
    "*": "MN4-CMD-POLL-01", "~": "MN4-CMD-BAUD-04", ":": "MN4-RSP-07", ";": "MN4-RSP-07",
}  # fmt: skip


def _requirement(letter: str) -> str:
    rule = rule_of(letter)
    is_data = rule is not None and rule.form in (ReplyForm.DATA, ReplyForm.LISTING)
    return _OWN.get(letter, "MN4-RSP-04" if is_data else "MN4-RSP-03")
