"""Faults of states: hold, the queue, entries of contours, pause and quit (RSP, STM, CMD)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400.commands import ContourEntry, Interpreter
from axistwin.devices.mn400.motion import SpeedProfile, VectorMotion
from axistwin.devices.mn400.motion.pace import TimedPace
from axistwin.devices.mn400.motion.timeline import FINE
from axistwin.devices.mn400.mover import Mover, Waiting
from axistwin.devices.mn400.orders import BoardSettings, MotionOrder, MoveStart, StoredSegment
from zoo_mn400.planting import (
    Any_,
    BoardState,
    MonkeyPatch,
    Treatment,
    around,
    board_mutant,
    cells,
    commands,
    settles,
)

MOVING = (BoardState.MOV, BoardState.QUE)


@board_mutant("MN4-RSP-06", traps=(2,))
def moving_boards_are_busy(patch: MonkeyPatch) -> None:
    """A second M during the first draws BUSY."""
    cells(patch, "M", MOVING, Treatment.BUSY)


@board_mutant("MN4-STM-02")
def reads_are_busy_in_motion(patch: MonkeyPatch) -> None:
    """S and / wait for the end of a move: BUSY."""
    cells(patch, "S/", MOVING, Treatment.BUSY)


@board_mutant("MN4-RSP-09", traps=(32,))
def settings_are_served_while_a_move_is_pending(patch: MonkeyPatch) -> None:
    """V with hold on and a move pending draws START and DONE."""
    cells(patch, "VXIL", [BoardState.HPD], Treatment.NOW)


@board_mutant("MN4-CMD-H-01")
def hold_holds_nothing(patch: MonkeyPatch) -> None:
    """With hold on a move runs."""
    cells(patch, "MA+T", [BoardState.HLD], Treatment.NOW)


@board_mutant("MN4-CMD-K-01", "MN4-CMD-K-03")
def what_is_held_is_dropped(patch: MonkeyPatch) -> None:
    """A move under hold is answered and forgotten; K has nothing to run."""

    def act(go: Any_, one: Interpreter, pending: Any) -> Any:
        return go(lambda now: None)

    around(patch, Interpreter, "_keep", act)


@board_mutant("MN4-CMD-H-02")
def h0_leaves_hold_on(patch: MonkeyPatch) -> None:
    """Only a power cycle turns it off."""
    commands(patch, "H", lambda go, one, line, given: go((1,)))


@board_mutant("MN4-CMD-H-03")
def hold_keeps_loads_back(patch: MonkeyPatch) -> None:
    """With hold on L is answered and not done."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return None if one.is_holding else go()

    commands(patch, "L", act)


@board_mutant("MN4-CMD-CC-03")
def loads_are_done_in_a_contour(patch: MonkeyPatch) -> None:
    """L between ( and ) is refused, and loads."""

    def act(go: Any_, one: Interpreter, line: Any, known: Any) -> Any:
        if known.letter == "L":
            one._mover.load(line.now, (9, 9, 9, 9))
        return go()

    around(patch, Interpreter, "_unsupported", act)


@board_mutant("MN4-CMD-CC-02", "MN4-CC-04", traps=(37,))
def segments_run_at_once(patch: MonkeyPatch) -> None:
    """M between ( and ) moves."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str, given: Any) -> None:
        if letter == "M":
            one._mover.take(line.now, MotionOrder("M", given, one._mover.accepted))
        else:
            go()

    around(patch, Interpreter, "_buffer", act)


@board_mutant("MN4-CMD-CC-04", traps=(23,))
def quit_keeps_the_speed_of_a_contour(patch: MonkeyPatch) -> None:
    """A V between ( and Q stays in force."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str, given: Any) -> None:
        go()
        if letter == "V":
            mover = one._mover
            mover.accepted = replace(mover.accepted, speed=given[0])
            mover.settings = replace(mover.settings, speed=given[0])

    around(patch, Interpreter, "_buffer", act)


@board_mutant("MN4-CC-01", traps=(23,))
def quit_leaves_segments_for_the_next_contour(patch: MonkeyPatch) -> None:
    """What ( ... Q has stored runs with the next ( and )."""

    def begin(go: Any_, one: Interpreter, line: Any, given: Any) -> None:
        left = getattr(one, "left", [])
        go()
        assert one.contour is not None
        one.contour.segments.extend(left)
        one.left = []  # type: ignore[attr-defined]

    def leave(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        if isinstance(one.contour, ContourEntry):
            one.left = list(one.contour.segments)  # type: ignore[attr-defined]
        return go()

    commands(patch, "(", begin)
    commands(patch, "Q", leave)


@board_mutant("MN4-CC-01")
def every_16th_place_of_a_contour_loses_its_segment(patch: MonkeyPatch) -> None:
    """The 17th segment is answered and lost, and so is the 33rd."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str, given: Any) -> None:
        go()
        contour = one.contour
        assert contour is not None
        count = getattr(one, "segments", 0) + 1 if len(contour.segments) > 1 else 1
        one.segments = count  # type: ignore[attr-defined]
        if letter == "M" and count > 16 and count % 16 == 1:
            contour.segments.pop()

    around(patch, Interpreter, "_buffer", act)


@board_mutant("MN4-CC-01", "MN4-CMD-M-02", "MN4-STM-01")
def a_contour_that_waits_begins_where_it_was_opened(patch: MonkeyPatch) -> None:
    """In absolute mode its first segment is planned from where the counters were at (."""

    def begin(go: Any_, one: Interpreter, line: Any, given: Any) -> None:
        go()
        one.opened_at = one._mover.position_at(line.now)  # type: ignore[attr-defined]

    def end(go: Any_, one: Interpreter, *more: Any) -> MotionOrder:
        order: MotionOrder = go()
        path = order.path(one.opened_at)  # type: ignore[attr-defined]
        segments = tuple(StoredSegment(each.displacement, each.speed) for each in path)
        settings = replace(order.settings, is_absolute=False)
        return replace(order, settings=settings, segments=segments)

    commands(patch, "(", begin)
    around(patch, Interpreter, "_contour_order", end)


@board_mutant("MN4-CMD-CC-07")
def a_contour_puts_the_speed_back(patch: MonkeyPatch) -> None:
    """The V of a contour is over with it."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        speed = one._mover.accepted.speed
        found = go()
        one._mover.accepted = replace(one._mover.accepted, speed=speed)
        if not one._mover.is_busy:
            one._mover.settings = replace(one._mover.settings, speed=speed)
        else:
            one._mover.queue.clear()
        return found

    commands(patch, ")", act)


@board_mutant("MN4-STM-08")
def two_moves_can_be_pending(patch: MonkeyPatch) -> None:
    """A second move on hold replaces the first."""
    cells(patch, "M", [BoardState.HPD], Treatment.PENDING)


@board_mutant("MN4-STM-03")
def the_queue_has_no_end(patch: MonkeyPatch) -> None:
    """What is beyond its length is forgotten without a word."""

    def act(go: Any_, mover: Mover) -> None:
        if len(mover.queue) >= mover._quirks.queue_depth:
            mover.queue.pop()

    around(patch, Mover, "make_room", act)


def _loses(patch: MonkeyPatch, every: int) -> None:
    """Let one in so many of the moves that wait for one another be taken and forgotten."""

    def act(go: Any_, mover: Mover, now: int, order: MotionOrder) -> None:
        waiting = getattr(mover, "waiting", 0) + 1 if mover.is_busy else 0
        mover.waiting = waiting  # type: ignore[attr-defined]
        if waiting % every != 1 or waiting < every:
            go()

    around(patch, Mover, "take", act)


@board_mutant("MN4-STM-01")
def every_16th_place_of_the_queue_loses_its_move(patch: MonkeyPatch) -> None:
    """The 17th move that waits is answered and lost, and so is the 33rd."""
    _loses(patch, 16)


@board_mutant("MN4-STM-01")
def the_last_place_of_the_queue_loses_its_move(patch: MonkeyPatch) -> None:
    """The 31st move that waits is answered and lost."""
    _loses(patch, 30)


@board_mutant("MN4-STM-01")
def queued_loads_are_lost(patch: MonkeyPatch) -> None:
    """L during a move is answered, and forgotten with it."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        return None if one._mover.is_busy else go()

    commands(patch, "L", act)


@board_mutant("MN4-CMD-Q-01", "MN4-CMD-CC-06", "MN4-CMD-Q-05", "MN4-CMD-T-03")
def quit_ends_no_move(patch: MonkeyPatch) -> None:
    """Q is answered, the move runs on."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        mover.queue.clear()

    around(patch, Mover, "quit", act)


@board_mutant("MN4-CMD-PAU-01", "MN4-CMD-CC-06", "MN4-CMD-PAU-03")
def a_pause_is_answered_only(patch: MonkeyPatch) -> None:
    """{ pauses nothing."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if reason != "command":
            go()

    around(patch, Mover, "pause", act)


@board_mutant("MN4-CMD-PAU-01")
def a_move_is_paused_but_once(patch: MonkeyPatch) -> None:
    """{ pauses nothing of a move that has been resumed."""

    resumed: list[object] = []

    def resume(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if mover.is_paused and reason == "command":
            resumed.append(mover.order)
        go()

    def pause(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if not any(mover.order is one for one in resumed):
            go()

    around(patch, Mover, "resume", resume)
    around(patch, Mover, "pause", pause)


@board_mutant("MN4-CMD-PAU-02", "MN4-PAU-02", "MN4-PAU-03", traps=(41,))
def a_resumed_move_begins_anew(patch: MonkeyPatch) -> None:
    """} makes the whole distance once more."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if mover.is_paused and reason == "command" and mover._motion is not None:
            mover._base = mover.position_at(now)
            mover._motion = None
        go()

    around(patch, Mover, "resume", act)


@board_mutant("MN4-CMD-PAU-02")
def a_resumed_move_is_counted_from_its_start(patch: MonkeyPatch) -> None:
    """} makes the whole distance once more, and the counters of before it are gone."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if mover.is_paused and reason == "command" and mover._motion is not None:
            mover._motion = None
        go()

    around(patch, Mover, "resume", act)


@board_mutant("MN4-CMD-M-02", "MN4-CMD-A-02", "MN4-CMD-I-01")
def there_is_one_coordinate_mode(patch: MonkeyPatch) -> None:
    """I is answered and sets nothing."""
    settles(patch, "I", lambda after, before: before)


@board_mutant("MN4-CMD-SW-02")
def a_pause_shows_on_no_flag(patch: MonkeyPatch) -> None:
    """PauseFlag and PauseState are 0 while a move is paused."""
    from zoo_mn400.planting import values

    def change(text: str, readout: Any, now: int) -> str:
        fields = text.split(",")
        return ",".join([*fields[:2], "0", "0", fields[4]])

    values(patch, ":", change)


@board_mutant("MN4-JOG-01", "MN4-CMD-G-01", "MN4-CMD-Y-01", "MN4-JOG-02", "MN4-CMD-J-01")
def jog_mode_is_not_entered(patch: MonkeyPatch) -> None:
    """J1 is answered, and the panel stays dead."""
    commands(patch, "J", lambda go, one, line, given: None)


@board_mutant("MN4-PAU-02", "MN4-PAU-03", "MN4-CMD-CC-06", "MN4-CMD-PAU-02", traps=(41,))
def a_resumed_move_makes_a_step_more(patch: MonkeyPatch) -> None:
    """} loses count of a step of axis 1."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if mover.is_paused and mover._motion is not None:
            first, *rest = mover._base
            mover._base = (first + 1, *rest)  # type: ignore[assignment]
        go()

    around(patch, Mover, "resume", act)


@board_mutant("MN4-CMD-Q-01", "MN4-QUIT-01")
def quit_counts_the_whole_move(patch: MonkeyPatch) -> None:
    """Behind Q the counters are where the move would have led."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        left = mover.left_at(now) if mover.is_busy else (0, 0, 0, 0)
        go()
        first, second, third, fourth = (
            base + rest for base, rest in zip(mover._base, left, strict=True)
        )
        mover._base = first, second, third, fourth

    around(patch, Mover, "quit", act)


@board_mutant("MN4-CMD-H-01")
def quit_ends_hold(patch: MonkeyPatch) -> None:
    """Behind a Q in motion hold is off."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        one.is_holding = one.is_holding and not one._mover.is_busy
        return go()

    commands(patch, "Q", act)


@board_mutant("MN4-CMD-SW-01")
def a_speed_clears_the_abort_flag(patch: MonkeyPatch) -> None:
    """AbortFlag is 0 behind Q and V."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        one._mover.is_aborted = False
        return go()

    commands(patch, "V", act)


# --- what Q drops ---------------------------------------------------------------------------------


def _flushes(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(mover, now, dropped)` be done behind a Q that has dropped what waited."""

    def quit_(go: Any_, mover: Mover, now: int) -> None:
        dropped = list(mover.queue) if mover._quirks.quit_flushes_queue else []
        go()
        act(mover, now, dropped)

    around(patch, Mover, "quit", quit_)


@board_mutant("MN4-BKL-02")
def a_motion_that_was_dropped_is_remembered(patch: MonkeyPatch) -> None:
    """Behind Q each axis has the direction in which the motions that waited would have ended."""

    def act(mover: Mover, now: int, dropped: Any) -> None:
        for order in (one for one in dropped if isinstance(one, MotionOrder)):
            start = MoveStart(now, mover.position_at(now), mover._memory, 1000)
            motion = order.plan(start, mover.rules, mover._quirks)
            assert motion.end_ns is not None
            mover._memory = motion.lash_memory_at(motion.end_ns)

    _flushes(patch, act)


@board_mutant("MN4-CMD-Q-02")
def loads_that_wait_are_done_by_quit(patch: MonkeyPatch) -> None:
    """Q drops moves; an L that waits loads the counters."""

    def act(mover: Mover, now: int, dropped: Any) -> None:
        for one in dropped:
            if isinstance(one, Waiting) and one.act is not None:
                one.act(now)

    _flushes(patch, act)


@board_mutant("MN4-QUIT-02")
def places_are_reached_from_the_end_of_what_was_dropped(patch: MonkeyPatch) -> None:
    """In absolute mode the first move behind Q goes as from where the moves that waited led."""

    def quit_(go: Any_, mover: Mover, now: int) -> None:
        end = mover.expected(now)
        is_dropped = any(isinstance(one, MotionOrder) for one in mover.queue)
        go()
        mover.planned = end if is_dropped else None  # type: ignore[attr-defined]

    def begin(go: Any_, mover: Mover, now: int, order: MotionOrder) -> None:
        planned, mover.planned = getattr(mover, "planned", None), None  # type: ignore[attr-defined]
        if planned is not None and order.letter == "M":
            settings = replace(order.settings, is_absolute=False)
            order = replace(order, arguments=order.vector(planned), settings=settings)
        go(now, order)

    around(patch, Mover, "quit", quit_)
    around(patch, Mover, "_begin", begin)


@board_mutant("MN4-CMD-A-02", "MN4-QUIT-02")
def an_arc_behind_quit_is_looked_at_from_where_the_move_was_to_end(patch: MonkeyPatch) -> None:
    """Whether it is round, in absolute mode, behind a move that Q has ended."""

    def quit_(go: Any_, mover: Mover, now: int) -> None:
        end = mover.expected(now)
        go()
        mover.planned = end  # type: ignore[attr-defined]

    def begin(go: Any_, mover: Mover, *given: Any) -> None:
        mover.planned = None  # type: ignore[attr-defined]
        go()

    def expected(go: Any_, mover: Mover, now: int) -> Any:
        planned = getattr(mover, "planned", None)
        return go() if planned is None or mover.is_busy else planned

    around(patch, Mover, "quit", quit_)
    around(patch, Mover, "_begin", begin)
    around(patch, Mover, "expected", expected)


# --- pauses ---------------------------------------------------------------------------------------


def _resumes(patch: MonkeyPatch, act: Any_) -> None:
    """Let } do `act(mover, motion, now)` before what it should, where it resumes a motion."""

    def acting(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if mover.is_paused and reason == "command" and mover._motion is not None:
            act(mover, mover._motion, now)
        go()

    around(patch, Mover, "resume", acting)


def _is_compensating(motion: VectorMotion, now: int) -> bool:
    chain = motion.chain
    return not chain.paths[0].is_commanded and motion._x_at(now) < chain.starts[1]


@board_mutant("MN4-CMD-PAU-02", "MN4-BKL-01")
def a_pause_drops_the_rest_of_a_compensation(patch: MonkeyPatch) -> None:
    """} behind a { within the compensation begins with the move."""

    def act(mover: Mover, motion: VectorMotion, now: int) -> None:
        if _is_compensating(motion, now):
            mover._motion = replace(motion, known_from=motion.chain.starts[1])

    _resumes(patch, act)


@board_mutant("MN4-CMD-PAU-02", "MN4-BKL-01")
def a_resumed_compensation_begins_anew(patch: MonkeyPatch) -> None:
    """} behind a { within the compensation makes all of it once more."""

    def act(mover: Mover, motion: VectorMotion, now: int) -> None:
        if _is_compensating(motion, now):
            mover._motion = None

    _resumes(patch, act)


@board_mutant("MN4-CMD-PAU-04", "MN4-MOT-10")
def a_resume_begins_the_ramp_of_a_move_anew(patch: MonkeyPatch) -> None:
    """} while a move runs unpaused lets it go on from the start speed."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        motion = mover._motion
        if motion is not None and not mover.is_paused and not motion.is_over_at(now):
            stopped = motion._changed(now, lambda pace, x: pace.stopped(now, x, False))
            mover._motion = replace(stopped, is_paused=True).resume(now)
            mover._watch(now)
        go()

    around(patch, Mover, "resume", act)


@board_mutant("MN4-CMD-PAU-01")
def a_pause_counts_the_step_it_is_in(patch: MonkeyPatch) -> None:
    """{ at start speed and below counts the next step, which is then left out."""

    def act(go: Any_, pace: TimedPace, now: int, x: int, ramped: bool) -> Any:
        place, _ = pace._state_at(now)
        unit = pace.stretches[0].multiplex << FINE
        return go(now, min(pace.x1, -(-max(x, place) // unit) * unit), ramped)

    around(patch, TimedPace, "stopped", act)


def _is_braking(mover: Mover, now: int) -> bool:
    """Whether a pause still brakes what it pauses."""
    return mover.is_paused and not mover.stands_at(now)


@board_mutant("MN4-CMD-Q-01")
def a_quit_is_lost_while_a_pause_brakes(patch: MonkeyPatch) -> None:
    """Q before the axes stand is answered, and } goes on with the move."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        if not _is_braking(mover, now):
            go()

    around(patch, Mover, "quit", act)


@board_mutant("MN4-CMD-PAU-02")
def a_resume_is_lost_while_a_pause_brakes(patch: MonkeyPatch) -> None:
    """} before the axes stand is answered, and the move stays paused."""

    def act(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        if reason != "command" or not _is_braking(mover, now):
            go()

    around(patch, Mover, "resume", act)


def _changes_what_is_paused(patch: MonkeyPatch, change: Any_) -> None:
    """Let } go on by `change(pace, settings)`, by the settings that were accepted last."""

    def act(mover: Mover, motion: VectorMotion, now: int) -> None:
        paces = [
            change(pace, mover.accepted) if isinstance(pace, TimedPace) else pace
            for pace in motion.paces
        ]
        mover._motion = replace(motion, paces=tuple(paces))

    _resumes(patch, act)


@board_mutant("MN4-CMD-V-05")
def a_speed_acts_on_the_move_that_is_paused(patch: MonkeyPatch) -> None:
    """} goes on at the V that came in the pause."""

    def change(pace: TimedPace, settings: BoardSettings) -> TimedPace:
        rows = tuple(one._replace(speed=settings.speed) for one in pace.stretches)
        return replace(pace, stretches=rows)

    _changes_what_is_paused(patch, change)


@board_mutant("MN4-CMD-F-03")
def a_profile_acts_on_the_move_that_is_paused(patch: MonkeyPatch) -> None:
    """} goes on by the F that came in the pause."""

    def change(pace: TimedPace, settings: BoardSettings) -> TimedPace:
        profile = SpeedProfile(settings.start, settings.top, settings.acceleration)
        return replace(pace, settings=replace(pace.settings, profile=profile))

    _changes_what_is_paused(patch, change)
