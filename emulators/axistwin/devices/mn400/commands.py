"""Lines into effects and replies: steps 4 to 9 of ledger §2.7, and every command of §3.6.

Rules
-----
1. The order of judgement: & first, then unknown commands, a pending motion, the entry of a program
   or contour, what the state allows, the grammar, the ranges.  Only then anything changes.
2. START precedes every answer to a known command; an unknown one is refused alone
   (MN4-ERR-03, MN4-AMB-04).
3. DONE follows at once, never at the end of a motion (MN4-RSP-05), unless ``motion_done`` says so:
   then it follows there, for who has set the motion going.  A value is that of the moment in which
   START has left (MN4-RSP-15).
4. A line of the user program is judged as a live command would be if no program ran; one that is
   refused ends the program (MN4-AMB-54).  The next line is due when the axes are at rest.
"""

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, TypeAlias

from axistwin.devices.mn400.acceptance import TABLE, BoardState, Treatment
from axistwin.devices.mn400.grammar import (
    Arguments,
    BoardCommand,
    NoSuchOutputError,
    ParameterError,
    arguments,
    commands,
)
from axistwin.devices.mn400.inputs import Inputs
from axistwin.devices.mn400.jog import Jogger
from axistwin.devices.mn400.link.packets import REASONS, ReturnCode
from axistwin.devices.mn400.link.ports import Answer, BoardLine, Origin, Port, started, status_part
from axistwin.devices.mn400.link.sender import Reply, ReplyPart
from axistwin.devices.mn400.mover import MotionOutcome, Mover, QueueFullError, Waiting
from axistwin.devices.mn400.orders import MotionOrder, StoredSegment, change_of
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.devices.mn400.readout import ReadOut
from axistwin.devices.mn400.store import Cells, ProgramStore
from axistwin.kernel.time import Nanos

OUTPUTS: Final = 8
Entry: TypeAlias = Literal["program", "config", "contour"]
_FLAG_LETTERS: Final = "{}"
_NOT_OWN: Final = "QU"
"""What a line of a program means as a live command does: it ends the program."""
_ENDS: Final = {"04": b"\x04", "14": b"\x14", "both": b"\x04\x14"}


@dataclass(slots=True)
class ContourEntry:
    """What was sent since (."""

    margin: int
    speed: int
    segments: list[StoredSegment] = field(default_factory=list)


_ENDINGS: Final[Mapping[MotionOutcome, ReturnCode]] = {
    "completed": ReturnCode.DONE,
    "aborted": ReturnCode.MOVE_ABORT,
    "quit": ReturnCode.MOVE_STOPPED,
}
"""How a motion ended, where that is answered (``motion_done``)."""
_LETTERS: Final = bytes(range(256)).upper().decode("latin-1")
"""The commands that bytes stand for."""
_OUT_OF_PLACE: Final = (Treatment.MOVE_PENDING, Treatment.INVALID)
_UNREAD: Final = (Treatment.BUSY, Treatment.STORED, Treatment.INVALID_LINE)
_ANSWERED_LATE: Final = (Origin.SERIAL, Origin.USB, Origin.CONFIG)


class Refusal(Exception):  # noqa: N818  no error of this program
    """The line is refused with ``code``; is_alone: without START."""

    def __init__(self, code: ReturnCode, *, is_alone: bool = False) -> None:
        super().__init__(code)
        self.code = code
        self.is_alone = is_alone


class Interpreter:
    """Everything that commands reach, of one board.

    ``cells`` are to be stored; ``refused`` tells what was refused, and why.
    """

    def __init__(
        self,
        quirks: Mn400Quirks,
        port: Port,
        inputs: Inputs,
        mover: Mover,
        jogger: Jogger,
        store: ProgramStore,
    ) -> None:
        self._quirks = quirks
        self._port = port
        self._inputs = inputs
        self._mover = mover
        self._jogger = jogger
        self._store = store
        self.readout = ReadOut(quirks, port, inputs, mover, jogger, store)
        self._commands = commands(quirks)
        self._ends = _ENDS[quirks.eof_byte]
        self._packed_ends = self._ends.decode() if quirks.eof_framing != "raw" else ""
        self._acts: dict[str, Callable[[BoardLine, Arguments], ReturnCode | None]] = {
            "|": self._clear_exit_code,
            "C": self._control,
            ";": self._feed_hold,
            "H": self._hold,
            "J": self._jog,
            "L": self._load,
            "D": self._direct,
            "{": self._pause,
            "}": self._resume,
            "Z": self._enter_program,
            ".": self._enter_config,
            "Q": self._quit,
            "K": self._release,
            "U": self._run,
            "(": self._begin_contour,
            ")": self._end_contour,
        }
        self.cells: list[tuple[str, int]] = []
        self.refused: list[str] = []
        self.reset()

    def reset(self) -> None:
        """As at power-up."""
        self.entry: Entry | None = None
        self.contour: ContourEntry | None = None
        self.is_holding = False
        self.pending: Callable[[BoardLine], None] | None = None
        self._unanswered: list[tuple[MotionOrder, BoardLine]] = []
        self.program: deque[bytes] | None = None
        is_on = self._quirks.power_on_outputs == "on"
        self.outputs = [is_on] * OUTPUTS

    # -- states --

    def state(self, letter: str = "", origin: Origin = Origin.SERIAL) -> BoardState:
        """The column of the table that judges ``letter``."""
        if self.entry in ("program", "config"):
            return BoardState.PRG if self.entry == "program" else BoardState.CFG
        if self.pending is not None:
            return BoardState.HPD
        if self.program is not None and (origin is not Origin.PROGRAM or letter in _NOT_OWN):
            return BoardState.PAU if self._mover.is_paused else BoardState.RUN
        if self.entry == "contour":
            return BoardState.CCB
        return self._moving_state(letter)

    def _moving_state(self, letter: str) -> BoardState:
        """The column, if nothing is entered and nothing pending."""
        mover = self._mover
        if mover.order is None and not (self.is_holding or self._jogger.is_on):
            return BoardState.ABT if mover.is_aborted else BoardState.RDY
        command = self._commands.get(letter)
        is_held = command is not None and command.is_motion and self.is_holding
        if mover.is_paused and not is_held:
            return BoardState.PAU
        if self._jogger.is_on:
            return BoardState.JOG
        if is_held or (self.is_holding and not mover.is_busy):
            return BoardState.HLD
        if mover.order is not None:
            if mover.order.letter == ")":
                return BoardState.CCX
            if mover.is_waiting_for_pulses:
                return BoardState.THR
            return BoardState.QUE if mover.queue else BoardState.MOV
        return BoardState.ABT if mover.is_aborted else BoardState.RDY

    # -- lines --

    def obey(self, now: Nanos, payload: bytes, origin: Origin, is_for_all: bool = False) -> Answer:
        """Judge and obey one line, at least one character."""
        sent = payload
        if b" " in payload and self._quirks.space_policy == "skip":
            sent = payload.replace(b" ", b"")
        command = (sent or payload)[0]
        letter = _LETTERS[command]
        if self._quirks.echo_case != "as_sent":
            command = ord(letter)
        line = BoardLine(now, command, sent[1:], payload, origin, is_for_all)
        try:
            return self._answer(line, letter)
        except NoSuchOutputError:
            is_own = self._quirks.mn100_codes
            code = ReturnCode.NOT_AVAILABLE if is_own else ReturnCode.PARA_ERROR
            return self.refusal(command, code, payload)
        except ParameterError:
            return self.refusal(command, ReturnCode.PARA_ERROR, payload)
        except QueueFullError:
            is_busy = self._quirks.queue_full_code == "busy"
            code = ReturnCode.BUSY if is_busy else ReturnCode.SLAVEBUFFOV
            return self.refusal(command, code, payload)
        except Refusal as refusal:
            return self.refusal(command, refusal.code, payload, is_alone=refusal.is_alone)

    def refusal(
        self, command: int, code: ReturnCode, payload: bytes, *, is_alone: bool = False
    ) -> Answer:
        """The answer to a line that is refused (rule 2)."""
        why = REASONS[code].format(state=self.state().value)
        self.refused.append(f"refused {payload.decode('ascii', 'replace')!r}: {why}")
        policy = self._quirks.error_start_policy
        has_start = policy == "always" or (policy == "after_accept" and not is_alone)
        parts = [self._status(command, ReturnCode.START)] if has_start else []
        return Answer([*parts, self._status(command, code)], code)

    def _status(self, command: int, code: ReturnCode) -> ReplyPart:
        return status_part(self._port.address, command, code)

    def _started(self, line: BoardLine, code: ReturnCode) -> Answer:
        """START and ``code``, which may have to wait for the end of a motion (rule 3)."""
        waiting = self._unanswered
        if waiting and code is ReturnCode.DONE and any(waits is line for _, waits in waiting):
            return Answer([self._status(line.command, ReturnCode.START)], code)
        if self._mover.is_aborted and self._quirks.move_abort_use == "while_aborted":
            code = ReturnCode.MOVE_ABORT if code is ReturnCode.DONE else code
        return started(self._port.address, line.command, code)

    def _answer(self, line: BoardLine, letter: str) -> Answer:
        """Judge a line (rule 1).  Raises what ``obey`` tells."""
        quirks = self._quirks
        is_entered = self.entry in ("program", "config")
        if letter == "&" and not (is_entered and quirks.retransmit_in_entry == "store"):
            return self._repeat(line)
        if letter in self._packed_ends:
            if self.entry == "program":
                return self.end_entry(line)
            raise _unknown(is_entered)
        known = self._commands.get(letter)
        if known is None:
            if is_entered and quirks.prog_check == "run":
                return self._store_line(line)
            raise _unknown(is_entered)
        if letter == "&":
            return self._store_line(line)
        treatment = TABLE[letter, self.state(letter, line.origin)]
        if treatment in _OUT_OF_PLACE:
            if treatment is Treatment.INVALID:
                return self._unsupported(line, known)
            if letter not in quirks.movepending_exempt:
                return self._started(line, ReturnCode.MOVEPENDING)
            treatment = Treatment.NOW
        return self._treat(line, known, treatment)

    def _unsupported(self, line: BoardLine, known: BoardCommand) -> Answer:
        """A command that cannot stand between ( and ) (MN4-AMB-32)."""
        policy = self._quirks.cc_unsupported
        if policy == "busy":
            raise Refusal(ReturnCode.BUSY)
        if policy == "ignored":
            return self._started(line, ReturnCode.DONE)
        if policy == "executed" and known.letter != "(":
            treatment = TABLE[known.letter, self._moving_state(known.letter)]
            return self._treat(line, known, treatment)
        raise Refusal(ReturnCode.INVALIDCOMMAND, is_alone=True)

    def _treat(self, line: BoardLine, known: BoardCommand, treatment: Treatment) -> Answer:
        """Do what the table says."""
        if treatment in _UNREAD:
            return self._leave_unread(line, treatment)
        given = arguments(known, line.text, self._quirks)
        if treatment is Treatment.POLL:
            return self._started(line, ReturnCode.PRESENT)
        if treatment is Treatment.VALUE:
            return self.readout.value(line, known.letter, given)
        if treatment is Treatment.LISTING:
            return self.readout.listing(line)
        if treatment is Treatment.NOTHING_PENDING:
            return self._started(line, ReturnCode.NOMOVEPENDING)
        if treatment is Treatment.BAUD:
            return self._set_rate(line, given)
        if known.letter == "=":
            return self._set_address(line, given)
        code = self._act(line, known, given, treatment)
        return self._started(line, ReturnCode.DONE if code is None else code)

    def _leave_unread(self, line: BoardLine, treatment: Treatment) -> Answer:
        """Refuse or store a line, whatever its parameters are."""
        if treatment is Treatment.BUSY:
            raise Refusal(ReturnCode.BUSY)
        if treatment is Treatment.INVALID_LINE and self._quirks.prog_check != "run":
            raise Refusal(ReturnCode.INVALIDPROGCOMM)
        return self._store_line(line)

    def _act(
        self, line: BoardLine, known: BoardCommand, given: Arguments, treatment: Treatment
    ) -> ReturnCode | None:
        """Carry a command out; a code in place of DONE."""
        if treatment is Treatment.VOID and known.letter not in _FLAG_LETTERS:
            return None
        if treatment is Treatment.BUFFERED:
            self._buffer(line, known.letter, given)
            return None
        if treatment is Treatment.QUEUED and self._quirks.queue_modal and not known.is_motion:
            self._mover.make_room()
        if known.is_motion:
            order = MotionOrder(known.letter, given, self._mover.accepted)
            return self._move(line, order, is_kept=treatment is Treatment.PENDING)
        act = self._acts.get(known.letter)
        if act is not None:
            is_kept = self.is_holding and treatment is Treatment.NOW
            if is_kept and known.letter in "UJ" and known.letter in self._quirks.hold_scope:
                return self._keep(
                    lambda released: _ignore(act(line._replace(now=released.now), given))
                )
            return act(line, given)
        change = change_of(known.letter, given, self._quirks, self._mover.accepted)
        self._mover.set(line.now, Waiting(change))
        return None

    # -- motion, hold --

    def _move(self, line: BoardLine, order: MotionOrder, *, is_kept: bool) -> ReturnCode | None:
        """Run a motion, or keep it."""
        mover = self._mover
        mover.check(line.now, order)
        if is_kept and order.letter in self._quirks.hold_scope:
            return self._keep(lambda released: self._start(released, order))
        if mover.is_busy:
            mover.make_room()
        self._start(line, order)
        return None

    def _start(self, line: BoardLine, order: MotionOrder) -> None:
        """Run a motion now, or behind what runs; ``line`` has set it going."""
        if self._quirks.motion_done == "at_end" and line.origin in _ANSWERED_LATE:
            self._unanswered.append((order, line))
        self._mover.take(line.now, order)

    def late_answers(self) -> list[tuple[BoardLine, ReplyPart]]:
        """What is to be told of motions that are over, and to whom (rule 3)."""
        ended = self._mover.ended
        if not ended:
            return []
        self._mover.ended = []
        answers = []
        for over, outcome in ended:
            waiting = [
                number for number, (order, _) in enumerate(self._unanswered) if order is over
            ]
            if waiting:
                _, line = self._unanswered.pop(waiting[0])
                answers.append((line, self._status(line.command, _ENDINGS[outcome])))
        return answers

    def _keep(self, pending: Callable[[BoardLine], None]) -> ReturnCode | None:
        """Keep it until K (MN4-CMD-H-01, MN4-AMB-17)."""
        self.pending = pending
        is_told = self._quirks.pending_move_reply == "movepending"
        return ReturnCode.MOVEPENDING if is_told else None

    def _release(self, line: BoardLine, _: Arguments) -> ReturnCode | None:
        """K: run what is pending (MN4-CMD-K-01, MN4-CMD-K-02)."""
        pending, self.pending = self.pending, None
        if self._quirks.hold_after_release == "one_shot":
            self.is_holding = False
        if pending is not None:
            pending(line)
        is_told = self._quirks.release_reply == "movepending"
        return ReturnCode.MOVEPENDING if is_told else None

    def _hold(self, line: BoardLine, given: Arguments) -> None:
        """H (MN4-AMB-14); off releases what is pending."""
        mode = given[0] if given else None
        if mode is None:
            is_toggled = self._quirks.hold_bare_arg == "toggle"
            mode = 0 if is_toggled and self.is_holding else 1
        self.is_holding = bool(mode)
        if not self.is_holding and self.pending is not None:
            self._release(line, given)

    def _quit(self, line: BoardLine, _: Arguments) -> ReturnCode | None:
        """Q: ends the entry, or the motion, the jog or the program."""
        if self.entry == "config":
            self._close_entry()
            return None
        was_entered, self.entry, self.contour = self.entry == "contour", None, None
        if was_entered and self._quirks.quit_in_entry == "entry_only":
            return None
        self.pending = None
        self.program = None
        self._jogger.stop(line.now, is_ramped=self._quirks.quit_decel)
        self._mover.quit(line.now)
        return None

    def _pause(self, line: BoardLine, _: Arguments) -> None:
        self._mover.pause(line.now)

    def _resume(self, line: BoardLine, _: Arguments) -> None:
        self._mover.resume(line.now)

    def _jog(self, line: BoardLine, given: Arguments) -> None:
        self.set_jog(line.now, bool(given[0]))

    def set_jog(self, now: Nanos, is_on: bool) -> None:
        """Enter or leave jog mode; what jogs stops."""
        if not is_on:
            self._jogger.stop(now)
        self._jogger.is_on = is_on

    def _run(self, line: BoardLine, _: Arguments) -> None:
        """U (MN4-CMD-U-01, MN4-CMD-U-02)."""
        lines = self._store.lines("program")
        self.program = deque(lines) if lines else None

    def run_program(self, now: Nanos) -> list[ReplyPart]:
        """The lines of the user program that are due (rule 4); what they say."""
        parts: list[ReplyPart] = []
        mover = self._mover
        if mover.was_flushed:
            self.program, mover.was_flushed = None, False
        while self.program is not None and not mover.is_busy and self.pending is None:
            if not self.program:
                self.program = None
                break
            answer = self.obey(now, self.program.popleft(), Origin.PROGRAM)
            if self._quirks.program_replies:
                parts += answer.parts
            if answer.code not in _OBEYED or mover.was_flushed:
                self.program, mover.was_flushed = None, False
        return parts

    # -- contours --

    def _begin_contour(self, _: BoardLine, given: Arguments) -> None:
        """( (MN4-CMD-CC-01)."""
        margin = given[0]
        assert margin is not None
        self.entry, self.contour = "contour", ContourEntry(margin, self._mover.accepted.speed)

    def _buffer(self, line: BoardLine, letter: str, given: Arguments) -> None:
        """M and V between ( and ) (MN4-CMD-CC-02)."""
        contour, mover = self.contour, self._mover
        assert contour is not None
        if letter == "V":
            assert given[0] is not None
            contour.speed = given[0]
            return
        segment = StoredSegment(given, contour.speed)
        if self._quirks.cc_axis4 == "error":
            longest = self._contour_order(segment).path(mover.expected(line.now))[-1].displacement
            if abs(longest[3]) > max(map(abs, longest[:3])):
                raise ParameterError
        if len(contour.segments) >= self._quirks.cc_capacity:
            raise QueueFullError
        contour.segments.append(segment)

    def _contour_order(self, *more: StoredSegment) -> MotionOrder:
        contour = self.contour
        assert contour is not None
        segments = (*contour.segments, *more)
        return MotionOrder(")", (), self._mover.accepted, segments, contour.margin)

    def _end_contour(self, line: BoardLine, _: Arguments) -> ReturnCode | None:
        """): run it, or keep it; the last V stays (MN4-CMD-CC-05, MN4-CMD-CC-07)."""
        contour = self.contour
        assert contour is not None
        code = None
        if contour.segments:
            code = self._move(line, self._contour_order(), is_kept=self.is_holding)
        self.entry = self.contour = None
        speed = contour.speed
        if speed != self._mover.accepted.speed:
            self._mover.set(line.now, Waiting(lambda settings: replace(settings, speed=speed)))
        return code

    # -- settings --

    def _control(self, line: BoardLine, given: Arguments) -> None:
        """C: an output (MN4-CMD-C-01)."""
        port, state = given
        assert port is not None
        is_on = state == self._quirks.output_on_state

        def act(_: Nanos) -> None:
            self.outputs[port - 1] = is_on

        self._mover.set(line.now, Waiting(act=act))

    def _load(self, line: BoardLine, given: Arguments) -> None:
        """L: the counters."""
        mover, jogger = self._mover, self._jogger

        def act(now: Nanos) -> None:
            mover.load(now, given, jogger.moved_at(now))

        mover.set(line.now, Waiting(act=act, moves_counters_to=given))

    def _direct(self, line: BoardLine, given: Arguments) -> None:
        """D: the remembered directions."""
        mover = self._mover
        mover.set(line.now, Waiting(act=lambda now: mover.remember(now, given)))

    def _feed_hold(self, _: BoardLine, given: Arguments) -> None:
        self._mover.has_feed_hold = bool(given[0])

    def _clear_exit_code(self, _: BoardLine, given: Arguments) -> None:
        self._mover.exit_code, self._mover.is_aborted = 0, False

    def _set_address(self, line: BoardLine, given: Arguments) -> Answer:
        """=: START from the old number, DONE from the new one (MN4-CMD-ADDR-01)."""
        quirks, number = self._quirks, given[0]
        assert number is not None
        if number != 1 and not quirks.address_settable:
            raise ParameterError
        if line.is_for_all and quirks.broadcast_setaddr == "refused":
            raise ParameterError
        start = self._status(line.command, ReturnCode.START)
        self._port.address = number
        return Answer([start, self._started(line, ReturnCode.DONE).parts[1]])

    def _set_rate(self, line: BoardLine, given: Arguments) -> Answer:
        """~: START at the old rate, BAUDCHANGEOK at the new one (MN4-CMD-BAUD-01)."""
        (number,) = given
        assert number is not None
        address, command = self._port.address, line.command

        def change(_: Nanos) -> Reply:
            self._port.set_rate(number)
            return Reply(address, command, ReturnCode.BAUDCHANGEOK)

        parts = [self._status(command, ReturnCode.START), ReplyPart(change)]
        if self._quirks.baud_reply == "plus_done":
            parts.append(self._status(command, ReturnCode.DONE))
        return Answer(parts, ReturnCode.BAUDCHANGEOK)

    def _repeat(self, line: BoardLine) -> Answer:
        """&: the last message once more."""
        arguments(self._commands["&"], line.text, self._quirks)
        return self.readout.retransmit(line)

    # -- stored programs --

    def _enter_program(self, _: BoardLine, given: Arguments) -> None:
        self._enter("program")

    def _enter_config(self, _: BoardLine, given: Arguments) -> None:
        self._enter("config")

    def _enter(self, part: Literal["program", "config"]) -> None:
        self.entry = part
        self._keep_cells(self._store.begin(part))

    def _store_line(self, line: BoardLine) -> Answer:
        """One more line of what is entered (MN4-NVM-01, MN4-NVM-09)."""
        assert self.entry == "program" or self.entry == "config"
        text = line.raw.replace(b" ", b"") if self._quirks.space_policy == "skip" else line.raw
        cells = self._store.add(self.entry, text)
        if cells is None:
            raise Refusal(ReturnCode.MEMORY_FULL)
        self._keep_cells(cells)
        return self._started(line, ReturnCode.DONE)

    def end_entry(self, line: BoardLine) -> Answer:
        """The program is complete."""
        self._close_entry()
        return self._started(line, ReturnCode.DONE)

    def _close_entry(self) -> None:
        """What was entered replaces the previous program."""
        assert self.entry == "program" or self.entry == "config"
        self._keep_cells(self._store.end(self.entry))
        self.entry = None

    def _keep_cells(self, cells: Cells) -> None:
        self.cells.extend(cells)

    @property
    def raw_ends(self) -> bytes:
        """The bytes that end an entry by themselves now (MN4-AMB-13)."""
        is_raw = self.entry == "program" and self._quirks.eof_framing != "packet"
        return self._ends if is_raw else b""


_OBEYED: Final = (
    ReturnCode.DONE,
    ReturnCode.MOVE_ABORT,
    ReturnCode.BAUDCHANGEOK,
    ReturnCode.PRESENT,
    ReturnCode.MOVEPENDING,
    ReturnCode.NOMOVEPENDING,
)
"""How a line ends that does not end its program."""


def _ignore(_: object) -> None:
    """Nothing of it is wanted."""


def _unknown(is_entered: bool) -> Refusal:
    """How an unknown command is refused (MN4-ERR-01)."""
    if is_entered:
        return Refusal(ReturnCode.INVALIDPROGCOMM)
    return Refusal(ReturnCode.INVALIDCOMMAND, is_alone=True)
