"""Faults of what something leaves behind: a refusal, a packet for another board, a pause, a Q, a
motion, and shows only by what comes next."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400.commands import Interpreter, Refusal
from axistwin.devices.mn400.device import Mn400Board
from axistwin.devices.mn400.grammar import COMMANDS, ParameterError
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Answer, Origin
from axistwin.devices.mn400.link.receiver import Flaw, PacketReceiver
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import ZERO, MotionOrder, added
from zoo_mn400.planting import (
    Any_,
    MonkeyPatch,
    around,
    board_mutant,
    commands,
    judges,
    plans,
    settles,
)

AXIS_3 = 2

# --- packets --------------------------------------------------------------------------------------


@board_mutant("MN4-PKT-08")
def a_refusal_switches_the_receiver_off(patch: MonkeyPatch) -> None:
    """What comes while INVALIDCOMMAND is being sent is lost."""

    def act(go: Any_, board: Any, request: Any) -> None:
        if request.time_ns < getattr(board, "deaf_until_ns", 0):
            return
        go()
        if request.payload[:1].upper().decode() not in COMMANDS:
            board.deaf_until_ns = request.time_ns + board.line_format.span_ns(6)

    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-PKT-06")
def another_board_is_told_to_quit(patch: MonkeyPatch) -> None:
    """Q to any other id ends the motion, without a reply."""

    def concerns(go: Any_, one: PacketReceiver, opening: int) -> bool:
        own = bool(go())
        one.__dict__["is_other"] = not own
        return True

    def act(go: Any_, board: Any, request: Any) -> None:
        if not board._receiver.is_other:
            go()
        elif request.payload == b"Q" and request.flaw is Flaw.NONE:
            board.mover.quit(request.time_ns)

    around(patch, PacketReceiver, "_concerns", concerns)
    around(patch, Mn400Board, "_serve", act)


@board_mutant("MN4-CMD-RTX-01")
def what_all_are_told_is_not_repeated(patch: MonkeyPatch) -> None:
    """& behind a reply to id 0 gives what the board has said before that."""

    def serve(go: Any_, board: Any, request: Any) -> None:
        if request.payload != b"&":
            if request.is_for_all and not getattr(board, "was_for_all", False):
                board.said_before = board._serial.last
            board.was_for_all = request.is_for_all
        go()

    def last(go: Any_, board: Any, origin: Any) -> Any:
        return board.said_before if getattr(board, "was_for_all", False) else go()

    around(patch, Mn400Board, "_serve", serve)
    around(patch, Mn400Board, "last_message", last)


@board_mutant("MN4-PKT-05", "MN4-PAR-07")
def parameters_under_a_wrong_sum_are_kept(patch: MonkeyPatch) -> None:
    """The next M takes what it leaves out from an M under a wrong sum."""

    def flawed(go: Any_, board: Any, request: Any) -> Any:
        if request.flaw is Flaw.CHECKSUM and request.payload[:1] == b"M":
            board.interpreter.kept = request.payload[1:].decode().split(",")
        return go()

    def act(go: Any_, one: Any, line: Any, given: Any) -> Any:
        kept = [int(text) if text else None for text in getattr(one, "kept", [])]
        one.kept = []
        kept += [None] * (len(given) - len(kept))
        return go([new if old is None else old for old, new in zip(given, kept, strict=True)])

    around(patch, Mn400Board, "_answer_to_rest", flawed)
    commands(patch, "M", act)


@board_mutant("MN4-CMD-POLL-02")
def a_slot_is_that_of_the_low_three_bits(patch: MonkeyPatch) -> None:
    """Replies to a poll wait for as many slots as the id has in its low three bits."""

    def act(go: Any_, board: Any, letter: str, payload: bytes) -> int:
        waits, slot_ns = int(board.address) - 1, int(go())
        return slot_ns * (waits % 8) // max(1, waits)

    around(patch, Mn400Board, "_slot_ns", act)


@board_mutant("MN4-CMD-BAUD-01", "MN4-ERR-05")
def a_wrong_sum_sets_the_rate_of_power_on(patch: MonkeyPatch) -> None:
    """Behind CHKSUMERROR the board talks 9600 baud."""

    def act(go: Any_, board: Any, request: Any) -> None:
        if getattr(board, "has_fallen_back", False):
            board.has_fallen_back = False
            if board._rate:
                board.set_rate(0)
                return
        board.has_fallen_back = request.flaw is Flaw.CHECKSUM
        go()

    around(patch, Mn400Board, "_serve", act)


# --- settings and the queue -----------------------------------------------------------------------


@board_mutant("MN4-CMD-I-01")
def an_absolute_mode_that_is_set_again_ends(patch: MonkeyPatch) -> None:
    """A second I of absolute mode sets the relative one."""
    settles(
        patch,
        "I",
        lambda after, before: replace(after, is_absolute=after.is_absolute > before.is_absolute),
    )


def _behind_motion(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(mover, order)` be done where a motion has begun."""

    def begin(go: Any_, mover: Mover, now: int, order: MotionOrder) -> None:
        go()
        act(mover, order)

    around(patch, Mover, "_begin", begin)


def _set_speed(mover: Mover, speed: int) -> None:
    mover.settings = replace(mover.settings, speed=speed)
    mover.accepted = replace(mover.accepted, speed=speed)


@board_mutant("MN4-CMD-V-01")
def an_arc_leaves_its_end_speed(patch: MonkeyPatch) -> None:
    """Behind an arc that the end speed has made slower V is that one."""

    def act(mover: Mover, order: MotionOrder) -> None:
        if order.letter == "A" and mover.settings.speed > mover.settings.top:
            _set_speed(mover, mover.settings.top)

    _behind_motion(patch, act)


@board_mutant("MN4-STM-01")
def a_move_of_no_steps_empties_the_queue(patch: MonkeyPatch) -> None:
    """What waits behind it is lost."""

    def act(mover: Mover, order: MotionOrder) -> None:
        if order.letter == "M" and not any(order.arguments):
            mover.queue.clear()

    _behind_motion(patch, act)


@board_mutant("MN4-STM-01")
def moves_are_refused_in_an_arc(patch: MonkeyPatch) -> None:
    """M while an arc runs draws BUSY."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        order = one._mover.order
        if letter == "M" and order is not None and order.letter == "A":
            raise Refusal(ReturnCode.BUSY)
        answer: Answer = go()
        return answer

    judges(patch, act)


@board_mutant("MN4-MOT-02")
def periods_are_whole_tens_of_microseconds(patch: MonkeyPatch) -> None:
    """A step takes no more than it should, in such units."""

    def act(go: Any_, mover: Mover, now: int, order: MotionOrder) -> Any:
        speed = order.settings.speed
        faster = 100_000 // max(1, 100_000 // speed) if speed > 0 else speed
        return go(now, replace(order, settings=replace(order.settings, speed=faster)))

    around(patch, Mover, "_plan", act)


# --- pauses and Q ---------------------------------------------------------------------------------


@board_mutant("MN4-CMD-PAU-02")
def pauses_are_counted(patch: MonkeyPatch) -> None:
    """Behind two { it takes two }."""

    def pause(go: Any_, mover: Any, now: int, *reason: Any) -> None:
        mover.pauses = getattr(mover, "pauses", 0) + 1 if mover.is_paused else 0
        go()

    def resume(go: Any_, mover: Any, now: int, *reason: Any) -> None:
        if getattr(mover, "pauses", 0) and mover.is_paused:
            mover.pauses -= 1
        else:
            go()

    around(patch, Mover, "pause", pause)
    around(patch, Mover, "resume", resume)


@board_mutant("MN4-CMD-V-01")
def a_resume_leaves_the_start_speed(patch: MonkeyPatch) -> None:
    """Behind a move that was paused V is the start speed."""

    def act(go: Any_, mover: Mover, now: int, *reason: Any) -> None:
        if mover.is_paused:
            _set_speed(mover, mover.settings.start)
        go()

    around(patch, Mover, "resume", act)


@board_mutant("MN4-RSP-14")
def a_resumed_motion_tells_its_end(patch: MonkeyPatch) -> None:
    """When a motion is over that was paused, DONE comes unasked."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        order = one._mover.order
        found = go()
        if order is not None:
            one._unanswered.append((order, line._replace(command=ord("M"))))
        return found

    commands(patch, "}", act)


@board_mutant("MN4-MEA-02", "MN4-MEA-03")
def a_resumed_motion_is_not_measured(patch: MonkeyPatch) -> None:
    """E1 and E2 count no ticks of a motion that was paused."""

    def resume(go: Any_, mover: Any, now: int, *reason: Any) -> None:
        mover.resumed = mover.order, mover.phantom_at(now)
        go()

    def phantom(go: Any_, mover: Any, now: int) -> int:
        order, count = getattr(mover, "resumed", (None, 0))
        return int(count if order is not None and order is mover.order else go())

    around(patch, Mover, "resume", resume)
    around(patch, Mover, "phantom_at", phantom)


@board_mutant("MN4-CMD-N-02")
def what_is_left_of_two_motions_adds_up(patch: MonkeyPatch) -> None:
    """N behind a second motion that Q has ended tells the rest of the first as well."""

    def act(go: Any_, mover: Any, now: int) -> None:
        go()
        mover._left = (
            added(mover._left, getattr(mover, "rests", ZERO)) if mover.is_aborted else ZERO
        )
        mover.rests = mover._left

    around(patch, Mover, "_finish", act)


@board_mutant("MN4-CMD-SW-01")
def a_refusal_is_an_abort(patch: MonkeyPatch) -> None:
    """A PARA_ERROR sets AbortFlag."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        try:
            return go()
        except ParameterError:
            one._mover.is_aborted = True
            raise

    judges(patch, act)


@board_mutant("MN4-BKL-02")
def a_quit_forgets_the_directions(patch: MonkeyPatch) -> None:
    """Behind a motion that Q has ended every axis is remembered as going up."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        was_busy = mover.is_busy
        go()
        if was_busy and not mover.is_busy:
            mover._memory = (1, 1, 1, 1)

    around(patch, Mover, "quit", act)


@board_mutant("MN4-CMD-T-03")
def a_thread_cannot_be_quit(patch: MonkeyPatch) -> None:
    """Q is answered and does not end a T that waits for pulses."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        order = one._mover.order
        return None if order is not None and order.letter == "T" else go()

    commands(patch, "Q", act)


@board_mutant("MN4-CMD-D-02")
def the_direction_of_axis_3_cannot_be_set(patch: MonkeyPatch) -> None:
    """D leaves it as it is."""

    def act(go: Any_, mover: Mover, now: int, directions: Any) -> None:
        go(now, [None if axis == AXIS_3 else one for axis, one in enumerate(directions)])

    around(patch, Mover, "remember", act)


# --- hold and contours ----------------------------------------------------------------------------


@board_mutant("MN4-CMD-H-02")
def hold_cannot_be_ended_in_motion(patch: MonkeyPatch) -> None:
    """H0 while a move runs is answered, and hold stays on."""
    commands(
        patch,
        "H",
        lambda go, one, line, given: None if one._mover.is_busy and given == (0,) else go(),
    )


@board_mutant("MN4-CMD-K-01")
def a_held_arc_runs_in_the_plane_of_power_on(patch: MonkeyPatch) -> None:
    """Whatever P has set."""

    move = Interpreter._move

    def act(one: Interpreter, line: Any, order: MotionOrder, *, is_kept: bool) -> Any:
        settings = replace(order.settings, plane=(0, 2, 1)) if is_kept else order.settings
        return move(one, line, replace(order, settings=settings), is_kept=is_kept)

    patch.setattr(Interpreter, "_move", act)


@board_mutant("MN4-CMD-CC-02")
def a_contour_knows_capitals_alone(patch: MonkeyPatch) -> None:
    """Between ( and ) m and v draw INVALIDCOMMAND."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Answer:
        if one.entry == "contour" and line.raw[:1].islower():
            raise Refusal(ReturnCode.INVALIDCOMMAND, is_alone=True)
        answer: Answer = go()
        return answer

    judges(patch, act)


@board_mutant("MN4-CC-01")
def a_bad_segment_is_stored_to_its_mistake(patch: MonkeyPatch) -> None:
    """An M that is refused between ( and ) is a segment of what stands before the mistake."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        try:
            return go()
        except ParameterError:
            if one.entry == "contour" and letter == "M":
                first = int(line.text.split(b",")[0])
                one._buffer(line, "M", (first, None, None, None))
            raise

    judges(patch, act)


@board_mutant("MN4-CC-01")
def a_contour_ends_at_a_segment_of_no_steps(patch: MonkeyPatch) -> None:
    """Segments behind it are not made."""

    def act(go: Any_, now: int, settings: Any, segments: Any, margin: int) -> Any:
        lengths = [any(segment.displacement) for segment in segments]
        count = lengths.index(False) if False in lengths else len(lengths)
        return go(now, settings, segments[: max(1, count)], margin)

    plans(patch, "contour", act)


@board_mutant("MN4-CC-01")
def a_contour_ends_when_the_next_is_opened(patch: MonkeyPatch) -> None:
    """( while one runs ends it."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        order = one._mover.order
        if order is not None and order.letter == ")":
            one._mover.quit(line.now)
        return go()

    commands(patch, "(", act)


# --- helices and programs -------------------------------------------------------------------------


@board_mutant("MN4-HEL-02")
def turns_are_counted_in_8_bits(patch: MonkeyPatch) -> None:
    """A helix of 257 turns makes one."""
    plans(patch, "helix", lambda go, *given: go(*given[:-1], given[-1] & 0xFF))


def _runs(patch: MonkeyPatch, act: Any_) -> None:
    """Let a line of a running program be done by `act(go, interpreter, payload)`."""

    def obey(go: Any_, one: Any, now: int, payload: bytes, origin: Any, *rest: Any) -> Any:
        return act(go, one, payload) if origin is Origin.PROGRAM else go()

    around(patch, Interpreter, "obey", obey)


@board_mutant("MN4-CMD-U-01", "MN4-NVM-10")
def lines_in_small_letters_are_passed_over(patch: MonkeyPatch) -> None:
    """They are listed, and do nothing when the program runs."""
    _runs(patch, lambda go, one, payload: Answer([]) if payload[:1].islower() else go())


@board_mutant("MN4-CMD-U-01", "MN4-CC-01")
def a_contour_of_a_program_loses_its_last_segment(patch: MonkeyPatch) -> None:
    """One that comes from the line has them all."""

    def act(go: Any_, one: Any, payload: bytes) -> Any:
        if payload == b")" and one.contour is not None:
            one.contour.segments.pop()
        return go()

    _runs(patch, act)


@board_mutant("MN4-CMD-U-01")
def a_program_ends_with_its_255th_line(patch: MonkeyPatch) -> None:
    """All behind it are listed, and not run."""

    def act(go: Any_, one: Any, line: Any, given: Any) -> Any:
        found = go()
        while one.program is not None and len(one.program) > 255:
            one.program.pop()
        return found

    commands(patch, "U", act)
