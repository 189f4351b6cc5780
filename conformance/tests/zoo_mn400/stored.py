"""Faults of what is stored, and of the supply (NVM, PWR)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.commands import Interpreter, Refusal
from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.grammar import ParameterError
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Origin
from axistwin.devices.mn400.link.receiver import Flaw, Request
from axistwin.devices.mn400.link.sender import ReplySender
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.readout import ReadOut
from axistwin.devices.mn400.store import ProgramStore
from zoo_mn400.planting import (
    Any_,
    BoardState,
    MonkeyPatch,
    Treatment,
    around,
    board_mutant,
    cells,
    commands,
    judges,
)

# --- what is entered ------------------------------------------------------------------------------


@board_mutant("MN4-NVM-01", traps=(37,))
def lines_are_carried_out_when_entered(patch: MonkeyPatch) -> None:
    """L between Z and Ctrl-D loads the counters, and is stored."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        if one.entry == "program" and line.raw[:1] in b"Ll":
            one._mover.load(line.now, (7, 7, 7, 7))
        return go()

    around(patch, Interpreter, "_store_line", act)


def _acts_on_settings(patch: MonkeyPatch, entry: str) -> None:
    """Let settings act, too, which are entered as lines."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        found = go()
        if one.entry == entry and line.raw[:1].upper() in b"VFIXBDP":
            part, one.entry = one.entry, None
            one.obey(line.now, line.raw, line.origin)
            one.entry = part
        return found

    around(patch, Interpreter, "_store_line", act)


@board_mutant("MN4-NVM-01", traps=(37,))
def settings_act_when_a_program_is_entered(patch: MonkeyPatch) -> None:
    """V and the like between Z and Ctrl-D are stored, and set something."""
    _acts_on_settings(patch, "program")


@board_mutant("MN4-STM-04", "MN4-NVM-02")
def reads_are_served_in_an_entry(patch: MonkeyPatch) -> None:
    """E and ? between Z and Ctrl-D are answered and not stored."""
    cells(patch, "E?", [BoardState.PRG], Treatment.VALUE)


@board_mutant("MN4-CMD-Q-04", "MN4-STM-04", traps=(36,))
def quit_ends_the_entry_of_a_program(patch: MonkeyPatch) -> None:
    """Q between Z and Ctrl-D ends it."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        return one.end_entry(line) if letter == "Q" and one.entry == "program" else go()

    judges(patch, act)


@board_mutant("MN4-NVM-01", traps=(36,))
def ctrl_d_is_answered_and_ends_nothing(patch: MonkeyPatch) -> None:
    """Behind Ctrl-D the entry goes on until the next one."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        one.is_warned = not getattr(one, "is_warned", False)  # type: ignore[attr-defined]
        return one._started(line, ReturnCode.DONE) if one.is_warned else go()  # type: ignore[attr-defined]

    around(patch, Interpreter, "end_entry", act)


@board_mutant("MN4-NVM-02")
def lines_are_listed_backwards(patch: MonkeyPatch) -> None:
    """R begins with the last line."""

    def listing(go: Any_, readout: ReadOut, line: Any) -> Any:
        answer = go()
        return answer._replace(parts=[answer.parts[0], *answer.parts[:0:-1]])

    around(patch, ReadOut, "listing", listing)


@board_mutant("MN4-NVM-02")
def the_last_line_is_not_listed(patch: MonkeyPatch) -> None:
    """R ends one line early."""

    def act(go: Any_, readout: ReadOut, line: Any) -> Any:
        answer = go()
        return answer._replace(parts=answer.parts[:-1]) if len(answer.parts) > 2 else answer

    around(patch, ReadOut, "listing", act)


@board_mutant("MN4-NVM-02")
def lines_are_kept_without_commas(patch: MonkeyPatch) -> None:
    """L5,-6 is stored as L5-6."""

    def act(go: Any_, store: ProgramStore, part: str, line: bytes) -> Any:
        return go(part, line.replace(b",", b""))

    around(patch, ProgramStore, "add", act)


@board_mutant("MN4-NVM-03")
def a_new_program_is_appended(patch: MonkeyPatch) -> None:
    """Z goes on behind the lines that are there."""

    def act(go: Any_, store: ProgramStore, part: Any) -> Any:
        found = go()
        store._entry = list(store.lines(part)) if part == "program" else []
        return found

    around(patch, ProgramStore, "begin", act)


@board_mutant("MN4-NVM-03")
def a_program_is_volatile(patch: MonkeyPatch) -> None:
    """A power cut empties it."""

    def act(go: Any_, board: Mn400Board, now: int) -> Any:
        board.store.put("program", ())
        return go()

    around(patch, Mn400Board, "power_off", act)


@board_mutant("MN4-PKT-05", "MN4-STM-04")
def a_line_with_a_wrong_sum_is_stored(patch: MonkeyPatch) -> None:
    """It is refused, and kept all the same."""

    def act(go: Any_, board: Mn400Board, request: Request) -> None:
        if request.flaw is Flaw.CHECKSUM and board.interpreter.entry == "program":
            board.store.add("program", request.payload)
        go()

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-NVM-08")
def each_program_has_a_memory_of_its_own(patch: MonkeyPatch) -> None:
    """What the configuration takes is not missing to the program."""

    def act(go: Any_, store: ProgramStore, part: Any, line: bytes) -> Any:
        kept = store._lines["config"]
        store._lines["config"] = ()
        try:
            return go()
        finally:
            store._lines["config"] = kept

    around(patch, ProgramStore, "add", act)


@board_mutant("MN4-NVM-11")
def a_configuration_empties_the_program(patch: MonkeyPatch) -> None:
    """. makes room first."""

    def act(go: Any_, store: ProgramStore, part: Any) -> Any:
        if part == "config":
            store._lines["program"] = ()
        return go()

    around(patch, ProgramStore, "begin", act)


@board_mutant("MN4-NVM-11")
def a_program_empties_the_configuration(patch: MonkeyPatch) -> None:
    """Z makes room first."""

    def act(go: Any_, store: ProgramStore, part: Any) -> Any:
        if part == "program":
            store._lines["config"] = ()
        return go()

    around(patch, ProgramStore, "begin", act)


def _ends_entry(patch: MonkeyPatch, entry: str, change: Any_) -> None:
    """Let `change(store)` be done before the entry of that part is over."""

    def act(go: Any_, store: ProgramStore, part: Any) -> Any:
        if part == entry:
            change(store)
        return go()

    around(patch, ProgramStore, "end", act)


@board_mutant("MN4-NVM-11")
def a_program_at_its_end_empties_the_configuration(patch: MonkeyPatch) -> None:
    """Ctrl-D writes the program over it."""

    _ends_entry(patch, "program", lambda store: store._lines.update(config=()))


@board_mutant("MN4-NVM-11")
def a_long_configuration_empties_the_program(patch: MonkeyPatch) -> None:
    """One of more than three lines is written over it."""

    def change(store: ProgramStore) -> None:
        if len(store._entry) > 3:
            store._lines["program"] = ()

    _ends_entry(patch, "config", change)


# --- what runs ------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-U-01")
def a_program_is_not_run(patch: MonkeyPatch) -> None:
    """U is answered, and nothing happens."""
    commands(patch, "U", lambda go, one, line, given: None)


@board_mutant("MN4-CMD-U-01")
def a_program_runs_in_circles(patch: MonkeyPatch) -> None:
    """Behind its last line it begins anew."""

    def act(go: Any_, one: Interpreter, now: int) -> Any:
        if one.program is not None and len(one.program) == 0 and not one._mover.is_busy:
            one.program.extend(one._store.lines("program"))
        return go()

    around(patch, Interpreter, "run_program", act)


@board_mutant("MN4-NVM-10", "MN4-CMD-U-01")
def the_last_speed_of_a_program_is_that_of_all_moves(patch: MonkeyPatch) -> None:
    """The settings of a program are taken before its moves."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        found = go()
        if one.program is not None:
            lines = list(one.program)
            one.program.clear()
            one.program.extend(sorted(lines, key=lambda text: text[:1] in b"Mm"))
        return found

    commands(patch, "U", act)


@board_mutant("MN4-NVM-13")
def the_first_line_of_a_program_is_answered(patch: MonkeyPatch) -> None:
    """A program of three lines says DONE when it begins."""

    def act(go: Any_, one: Interpreter, now: int) -> Any:
        lines = None if one.program is None else len(one.program)
        parts = go()
        if lines == 3:
            parts.append(one._status(ord("E"), ReturnCode.DONE))
        return parts

    around(patch, Interpreter, "run_program", act)


@board_mutant("MN4-CMD-Q-05", traps=(40,))
def quit_ends_a_move_and_not_its_program(patch: MonkeyPatch) -> None:
    """Behind Q the program goes on with its next line."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        program = one.program
        found = go()
        if line.origin is Origin.SERIAL:
            one.program, one._mover.was_flushed = program, False
        return found

    around(patch, Interpreter, "_quit", act)
    around(patch, Interpreter, "__init__", _with_own_quit)


def _with_own_quit(go: Any_, one: Interpreter, *given: Any) -> None:
    go()
    one._acts["Q"] = one._quit


@board_mutant("MN4-CMD-PAU-03")
def a_pause_ends_a_program(patch: MonkeyPatch) -> None:
    """Behind { and } the current move is made, and no other."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        one.program = None
        return go()

    commands(patch, "{", act)


@board_mutant("MN4-NVM-12")
def the_start_switch_runs_one_line(patch: MonkeyPatch) -> None:
    """It runs the third line of the program alone."""

    def act(go: Any_, board: Mn400Board, now: int, line: bytes) -> None:
        go()
        if line == b"U" and board.interpreter.program is not None:
            program = board.interpreter.program
            board.interpreter.program = type(program)(list(program)[2:3])

    around(patch, Mn400Board, "_work_panel", act)


# --- the configuration ----------------------------------------------------------------------------


@board_mutant("MN4-NVM-04", "MN4-DROP-11", traps=(12,))
def an_id_in_a_configuration_is_taken_at_once(patch: MonkeyPatch) -> None:
    """= between . and Q is stored, and acts."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        found = go()
        if one.entry == "config" and line.raw[:1] == b"=" and line.text.isdigit():
            one._port.address = int(line.text)
        return found

    around(patch, Interpreter, "_store_line", act)


@board_mutant("MN4-NVM-04", "MN4-CMD-Q-04", traps=(36,))
def ctrl_d_ends_a_configuration(patch: MonkeyPatch) -> None:
    """As it ends a program."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        if one.entry == "config" and letter == "\x04":
            one._close_entry()
            raise Refusal(ReturnCode.INVALIDPROGCOMM)
        return go()

    judges(patch, act)


@board_mutant("MN4-NVM-04", traps=(37,))
def settings_act_when_a_configuration_is_entered(patch: MonkeyPatch) -> None:
    """V and the like between . and Q are stored, and set something."""
    _acts_on_settings(patch, "config")


@board_mutant("MN4-NVM-04")
def the_quit_of_a_configuration_is_its_last_line(patch: MonkeyPatch) -> None:
    """Q ends the entry, and is stored."""
    _ends_entry(patch, "config", lambda store: store._entry.append(b"Q"))


@board_mutant("MN4-NVM-04")
def an_empty_configuration_replaces_nothing(patch: MonkeyPatch) -> None:
    """. and Q without a line between leave the lines of before."""

    def change(store: ProgramStore) -> None:
        store._entry = store._entry or list(store.lines("config"))

    _ends_entry(patch, "config", change)


@board_mutant("MN4-NVM-05")
def a_configuration_runs_once(patch: MonkeyPatch) -> None:
    """It is forgotten by the power-up at which it has run."""

    def act(go: Any_, board: Mn400Board, now: int) -> Any:
        found = go()
        board.store.put("config", ())
        return found

    around(patch, Mn400Board, "power_on", act)


@board_mutant("MN4-NVM-05")
def a_configuration_never_runs(patch: MonkeyPatch) -> None:
    """It is stored, and that is all."""

    def act(go: Any_, board: Mn400Board, now: int) -> Any:
        found = go()
        if now > 0:
            board._config.clear()
        return found

    around(patch, Mn400Board, "power_on", act)


@board_mutant("MN4-NVM-07", "MN4-DROP-11", traps=(12,))
def a_configuration_runs_in_silence(patch: MonkeyPatch) -> None:
    """Nothing is sent at power-up."""

    def act(go: Any_, board: Mn400Board, start: int, parts: Any, origin: Origin) -> None:
        if origin is Origin.CONFIG:
            for part in parts:
                if not hasattr(part.message, "address"):
                    part.message(start)
            return
        go()

    around(patch, Mn400Board, "_reply", act)


@board_mutant("MN4-NVM-07", "MN4-DROP-11", traps=(12,))
def a_configuration_answers_from_id_1(patch: MonkeyPatch) -> None:
    """What is sent at power-up is all from the id of power-on."""

    def act(go: Any_, board: Mn400Board, start: int, parts: Any, origin: Origin) -> None:
        if origin is Origin.CONFIG:
            parts = [
                part._replace(message=part.message._replace(address=1))
                if hasattr(part.message, "address")
                else part
                for part in parts
            ]
        go(start, parts, origin)

    around(patch, Mn400Board, "_reply", act)


@board_mutant("MN4-NVM-06")
def a_configuration_does_not_move(patch: MonkeyPatch) -> None:
    """Moves in it are passed over at power-up."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, origin: Any, *rest: Any) -> Any:
        is_move = origin is Origin.CONFIG and payload[:1] in b"Mm"
        return go(now, b"M" if is_move else payload, origin, *rest)

    around(patch, Interpreter, "obey", act)


# --- lines that are no command --------------------------------------------------------------------


@board_mutant("MN4-NVM-07")
def a_bad_line_of_a_configuration_is_passed_over(patch: MonkeyPatch) -> None:
    """X3 in it draws nothing at power-up."""

    def act(go: Any_, one: Interpreter, now: int, payload: bytes, origin: Any, *rest: Any) -> Any:
        answer = go()
        is_bad = origin is Origin.CONFIG and answer.code is ReturnCode.PARA_ERROR
        return answer._replace(parts=[]) if is_bad else answer

    around(patch, Interpreter, "obey", act)


@board_mutant("MN4-ERR-02")
def a_bad_line_of_a_program_is_obeyed_in_part(patch: MonkeyPatch) -> None:
    """Of M5,6x what stands before the comma is made."""

    def act(go: Any_, one: Interpreter, line: Any, known: Any, how: Any) -> Any:
        try:
            return go()
        except ParameterError:
            if line.origin is not Origin.PROGRAM:
                raise
            return go(line._replace(text=line.text.partition(b",")[0]), known, how)

    around(patch, Interpreter, "_treat", act)


@board_mutant("MN4-NVM-02")
def a_bad_line_is_answered_and_not_stored(patch: MonkeyPatch) -> None:
    """M5,6x between Z and Ctrl-D draws START and DONE, and is not listed."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        if one.entry == "program" and line.text[-1:].isalpha():
            return one._started(line, ReturnCode.DONE)
        return go()

    around(patch, Interpreter, "_store_line", act)


# --- the supply -----------------------------------------------------------------------------------


@board_mutant("MN4-CMD-ADDR-03", "MN4-PWR-01", "MN4-PWR-03")
def an_id_is_kept(patch: MonkeyPatch) -> None:
    """= is for good."""

    def act(go: Any_, board: Mn400Board, now: int) -> None:
        address = board.address
        go()
        board.address = address if now > 0 else 1

    around(patch, Mn400Board, "_forget", act)


@board_mutant("MN4-CMD-BAUD-03", "MN4-PWR-01", "MN4-PHY-01")
def a_rate_is_kept(patch: MonkeyPatch) -> None:
    """~ is for good."""

    def act(go: Any_, board: Mn400Board, now: int) -> None:
        rate = board._rate
        go()
        if now > 0:
            board.set_rate(rate)

    around(patch, Mn400Board, "_forget", act)


def _kept(patch: MonkeyPatch, *names: str) -> None:
    """Let settings of the mover outlive the supply."""

    def act(go: Any_, mover: Mover) -> None:
        kept = {name: getattr(mover, name) for name in names if hasattr(mover, name)}
        go()
        for name, value in kept.items():
            setattr(mover, name, value)

    around(patch, Mover, "reset", act)


@board_mutant("MN4-PWR-01", "MN4-PWR-02", "MN4-PWR-03")
def settings_are_kept(patch: MonkeyPatch) -> None:
    """Speed, profile, backlash, plane and multiplex outlive the supply."""
    _kept(patch, "settings", "accepted")


@board_mutant("MN4-PWR-01", "MN4-PWR-03")
def directions_are_kept(patch: MonkeyPatch) -> None:
    """What an axis remembers of its last direction outlives the supply."""
    _kept(patch, "_memory")


@board_mutant("MN4-PWR-02")
def feed_hold_is_kept(patch: MonkeyPatch) -> None:
    """; outlives the supply."""
    _kept(patch, "has_feed_hold")


@board_mutant("MN4-PWR-02")
def a_contour_entry_is_kept(patch: MonkeyPatch) -> None:
    """Behind a power cycle ( is still open."""

    def act(go: Any_, one: Interpreter) -> None:
        contour = getattr(one, "contour", None)
        go()
        if contour is not None:
            one.entry, one.contour = "contour", contour

    around(patch, Interpreter, "reset", act)


@board_mutant("MN4-PWR-02")
def counters_are_kept(patch: MonkeyPatch) -> None:
    """They are those before the power cut."""
    _kept(patch, "_base")


@board_mutant("MN4-RSP-14")
def it_says_that_it_is_up(patch: MonkeyPatch) -> None:
    """DONE is sent at power-up."""

    def act(go: Any_, board: Mn400Board, now: int) -> Any:
        found = go()
        if now > 0:
            board._serial.send(now, [board.interpreter._status(ord("*"), ReturnCode.PRESENT)])
        return found

    around(patch, Mn400Board, "power_on", act)


@board_mutant("MN4-NVM-12")
def every_panel_input_runs_the_program(patch: MonkeyPatch) -> None:
    """Jog Res does what Start does."""

    def act(go: Any_, board: Mn400Board, now: int, name: str, on: bool) -> None:
        go(now, "start" if name.startswith("jog_res") else name, on)

    around(patch, Mn400Board, "_input_changed", act)


@board_mutant("MN4-PWR-02")
def what_was_said_last_outlives_the_supply(patch: MonkeyPatch) -> None:
    """& repeats it after power-up."""

    def act(go: Any_, sender: ReplySender, now: int) -> None:
        kept = sender.last
        go()
        sender.last = kept

    around(patch, ReplySender, "reset", act)
