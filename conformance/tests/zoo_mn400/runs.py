"""Faults of programs that run more than once, or have run (CMD-U, NVM)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from zoo_mn400.planting import Any_, MonkeyPatch, around, board_mutant, commands


@board_mutant("MN4-CMD-U-01")
def a_second_run_begins_with_the_second_line(patch: MonkeyPatch) -> None:
    """The first one is run by the first U alone."""

    def act(go: Any_, one: Any, line: Any, given: Any) -> Any:
        found = go()
        if getattr(one, "has_run", False) and one.program is not None:
            one.program.popleft()
        one.has_run = True
        return found

    commands(patch, "U", act)


@board_mutant("MN4-CMD-U-01")
def a_run_goes_on_behind_the_line_that_was_quit(patch: MonkeyPatch) -> None:
    """U behind Q runs what was left of the program."""

    def ended(go: Any_, one: Any, line: Any, given: Any) -> Any:
        one.left = one.program
        return go()

    def begun(go: Any_, one: Any, line: Any, given: Any) -> Any:
        found = go()
        left, one.left = getattr(one, "left", None), None
        one.program = left or one.program
        return found

    commands(patch, "Q", ended)
    commands(patch, "U", begun)


def _ends_run(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(interpreter)` be done when a program has come to its end."""

    def run(go: Any_, one: Interpreter, now: int) -> Any:
        is_running = one.program is not None
        found = go()
        if is_running and one.program is None:
            act(one)
        return found

    around(patch, Interpreter, "run_program", run)


@board_mutant("MN4-CMD-U-01")
def the_end_of_a_program_is_an_abort(patch: MonkeyPatch) -> None:
    """AbortFlag is set behind its last line."""

    def act(one: Interpreter) -> None:
        one._mover.is_aborted = True

    _ends_run(patch, act)


@board_mutant("MN4-NVM-10", "MN4-CMD-U-01")
def the_speed_of_a_program_ends_with_it(patch: MonkeyPatch) -> None:
    """Behind its last line V is what it is at power-on."""

    def act(one: Interpreter) -> None:
        mover = one._mover
        mover.settings = mover.accepted = replace(mover.settings, speed=2000)

    _ends_run(patch, act)
