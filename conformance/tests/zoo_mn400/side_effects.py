"""Faults of what a command does beside its own business: Q at rest, a refusal, H or K in motion."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.grammar import ParameterError
from axistwin.devices.mn400.mover import Mover, QueueFullError
from axistwin.devices.mn400.orders import ZERO
from zoo_mn400.planting import (
    Any_,
    BoardState,
    MonkeyPatch,
    around,
    board_mutant,
    commands,
    judges,
)


def _quits_at_rest(patch: MonkeyPatch, act: Any_) -> None:
    """Let a Q that finds no motion, and nothing entered, do `act(mover)` as well."""

    def quit_(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        if one.entry is None and not one._mover.is_busy:
            act(one._mover)
        return go()

    commands(patch, "Q", quit_)


@board_mutant("MN4-CMD-Q-03")
def a_quit_at_rest_clears_what_is_left(patch: MonkeyPatch) -> None:
    """N is 0 behind a second Q."""

    def act(mover: Mover) -> None:
        mover._left = ZERO

    _quits_at_rest(patch, act)


@board_mutant("MN4-CMD-Q-03")
def a_quit_at_rest_sets_the_abort_flag(patch: MonkeyPatch) -> None:
    """AbortFlag is 1 behind a Q that has ended nothing."""

    def act(mover: Mover) -> None:
        mover.is_aborted = True

    _quits_at_rest(patch, act)


@board_mutant("MN4-CMD-SW-01")
def a_quit_in_a_pause_sets_no_abort_flag(patch: MonkeyPatch) -> None:
    """AbortFlag is 0 behind { and Q."""

    def quit_(go: Any_, mover: Mover, now: int) -> None:
        was_paused = mover.is_paused
        go()
        if was_paused:
            mover.is_aborted = False

    around(patch, Mover, "quit", quit_)


@board_mutant("MN4-STM-03")
def a_full_queue_drops_its_last_as_well(patch: MonkeyPatch) -> None:
    """What is beyond its length draws SLAVEBUFFOV, and the command before it is lost too."""

    def act(go: Any_, mover: Mover) -> None:
        try:
            go()
        except QueueFullError:
            mover.queue.pop()
            raise

    around(patch, Mover, "make_room", act)


@board_mutant("MN4-ERR-02")
def a_refusal_drops_what_waits_last(patch: MonkeyPatch) -> None:
    """A PARA_ERROR in motion takes the last queued command with it."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        try:
            return go()
        except ParameterError:
            if one._mover.queue:
                one._mover.queue.pop()
            raise

    judges(patch, act)


@board_mutant("MN4-CMD-H-01")
def hold_drops_what_waits(patch: MonkeyPatch) -> None:
    """H in motion empties the queue."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        found = go()
        if one.is_holding:
            one._mover.queue.clear()
        return found

    commands(patch, "H", act)


@board_mutant("MN4-RSP-09")
def a_pause_that_is_refused_pauses(patch: MonkeyPatch) -> None:
    """{ with a move pending draws MOVEPENDING, and pauses the move that runs."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        if letter == "{" and one.state(letter) is BoardState.HPD:
            one._mover.pause(line.now)
        return go()

    judges(patch, act)


@board_mutant("MN4-CMD-K-01")
def a_release_in_motion_loses_its_move(patch: MonkeyPatch) -> None:
    """K while a move runs that was released before is answered, and drops what was pending."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        if one._mover.is_busy and one.pending is not None:
            one.pending = lambda released: None
        return go()

    around(patch, Interpreter, "_release", act)
