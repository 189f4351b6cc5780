"""What becomes of every command in every state of an MN400: the effects of ledger §4.1."""

from dataclasses import dataclass
from functools import cache

import pytest
from mn400_bench import REPLY_MS, Mn400Bench
from mn400_effects import MOTIONS, SETTINGS, line_of, rest, shown
from mn400_state_table import REACHED, arrows, cells

from axistwin.devices.mn400.device import BoardSnapshot
from axistwin.devices.mn400.link.packets import packet

TABLE = cells()
ARROWS = arrows()

BEFORE = {"U": ("Z", "M3000", "\x04")}
NO_EFFECT = {"D0", "V", "V*", "PR", "NP", "MP", "BY", "IC", "IP", "R&"}


@dataclass(frozen=True)
class Seen:
    """A board after a command, and what it comes to: at once, on the way to rest, and at rest."""

    snapshot: BoardSnapshot
    at_once: tuple[object, ...]
    visited: list[str]
    at_rest: tuple[object, ...]
    counters: list[int]
    lines: list[str]
    value: object
    """Of what the command sets, if it does."""


@cache
def seen(letter: str, state: str, is_sent: bool = True) -> Seen:
    """In ``state``, ``letter`` is sent, or else nothing."""
    bench = Mn400Bench()
    bench.say(*BEFORE.get(letter, ()), *REACHED[state])
    assert bench.device.describe(bench.now).state == state
    if is_sent:
        bench.ask(packet(1, line_of(letter, state).encode()))
    else:
        bench.wait(REPLY_MS)
    snapshot, at_once = bench.device.describe(bench.now), shown(bench)
    visited = rest(bench)
    described = bench.device.describe(bench.now)
    final = shown(bench)
    value = SETTINGS[letter][1](bench) if letter in SETTINGS else None
    lines = described.program_lines + described.configuration_lines
    return Seen(snapshot, at_once, visited, final, described.counters, lines, value)


def columns(*words: str) -> list[tuple[str, str]]:
    """The cells with these words."""
    return [cell for cell, word in TABLE.items() if word in words]


@pytest.mark.parametrize("state", REACHED)
def test_what_has_no_effect_leaves_no_trace(state: str) -> None:
    """A board that was refused, or read, goes on as one to which nothing was sent."""
    for letter, column in columns(*NO_EFFECT):
        if column == state:
            assert seen(letter, state) == seen(letter, state, False), letter


@pytest.mark.parametrize("letter", sorted({letter for letter, _ in TABLE}))
def test_each_command_leads_where_the_arrows_say(letter: str) -> None:
    """At once; a command that is queued behind a move shows as such."""
    for state in REACHED:
        queued = (TABLE[letter, state], state) == ("Dq", "MOV")
        after = ARROWS.get((letter, state), "QUE" if queued else state)
        if (letter, state) == ("U", "HLD"):
            after = "HPD"  # the program runs, and its move is held
        assert seen(letter, state).snapshot.state == after, state


@pytest.mark.parametrize("letter", SETTINGS)
def test_what_is_set_is_set(letter: str) -> None:
    """In every state that takes it, and to the same value; elsewhere it stays."""
    default, changed = seen(letter, "RDY", False).value, seen(letter, "RDY").value
    assert default != changed
    for state in REACHED:
        is_taken = TABLE[letter, state] in ("D", "Dq", "Db", "BC")
        assert seen(letter, state).value == (changed if is_taken else default), state


@pytest.mark.parametrize("letter", "CL")
def test_what_is_queued_shows_only_behind_the_motion(letter: str) -> None:
    """Outputs and counters are those of before until then."""
    for other, state in columns("Dq"):
        if other == letter:
            with_it, without = seen(letter, state).snapshot, seen(letter, state, False).snapshot
            assert with_it.outputs == without.outputs, state
            assert with_it.counters == without.counters, state


@pytest.mark.parametrize("letter", MOTIONS)
def test_a_motion_that_is_taken_is_made_in_the_end(letter: str) -> None:
    """All of it, behind what was there; what is stored is not made."""
    way = MOTIONS[letter][1]
    for state in REACHED:
        is_taken = TABLE[letter, state] in ("D", "Dq", "Dp", "Db")
        more = way if is_taken else (0, 0, 0, 0)
        without = seen(letter, state, False).counters
        expected = [a + b for a, b in zip(without, more, strict=True)]
        assert seen(letter, state).counters == expected, state


@pytest.mark.parametrize("state", ["PRG", "CFG"])
def test_what_is_stored_is_a_line_and_nothing_else(state: str) -> None:
    """Verbatim behind the others, and without any other effect."""
    for letter, column in columns("Ds"):
        if column == state:
            with_it, without = seen(letter, state), seen(letter, state, False)
            assert with_it.lines == [*without.lines, line_of(letter, state)], letter
            assert with_it.at_once == without.at_once, letter
            assert with_it.value == without.value, letter


@pytest.mark.parametrize("letter", "({}H|")
def test_what_concerns_the_way_leaves_the_end(letter: str) -> None:
    """A motion is made to its end behind a bracket, a pause, a hold or a cleared code."""
    for (other, state), word in TABLE.items():
        if other == letter and word == "D":
            with_it, without = seen(letter, state), seen(letter, state, False)
            assert with_it.counters == without.counters, state
            assert ("HLD" in with_it.visited) == (letter == "H" or state == "HLD"), state


def test_quit_leaves_everything_where_it_is() -> None:
    """No step more, in every state that has a motion; entries are empty."""
    for state in ("MOV", "QUE", "PAU", "CCB", "CCX", "RUN", "THR"):
        after = seen("Q", state)
        assert after.counters == after.snapshot.counters, state
        assert after.counters != seen("Q", state, False).counters, state


@pytest.mark.parametrize("state", ["RDY", "HLD", "ABT"])
def test_a_program_runs_where_it_may(state: str) -> None:
    """To its end; its moves wait where hold is on."""
    moved = seen("U", state).counters[0] - seen("U", state, False).counters[0]
    assert moved == 3000
    assert seen("U", state).at_once[-1], "the output for it is on"


@pytest.mark.parametrize("state", REACHED)
def test_a_cleared_exit_code_is_clear(state: str) -> None:
    """| where it is taken; elsewhere the code of the last motion stays."""
    bench = Mn400Bench()
    bench.switch("m1_plus")
    bench.say("M1")
    bench.switch("m1_plus", on=False)
    bench.say(*REACHED[state])
    before = bench.device.describe(bench.now).exit_code
    assert before == (0 if state == "ABT" else 2)
    bench.say("|")
    is_taken = TABLE["|", state] == "D"
    assert bench.device.describe(bench.now).exit_code == (0 if is_taken else before)
