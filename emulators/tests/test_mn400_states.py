"""Every command in every state of an MN400: the cells of ledger §4.1 on the wire."""

import pytest
from mn400_bench import Mn400Bench
from mn400_effects import line_of
from mn400_state_table import REACHED, cells

TABLE = cells()

REPLIES = {
    "D": "S D",
    "Dq": "S D",
    "Dp": "S D",
    "Db": "S D",
    "Ds": "S D",
    "D0": "S D",
    "PR": "S PR",
    "NP": "S NP",
    "MP": "S MP",
    "BC": "S BC",
    "BY": "S BY",
    "IC": "IC",
    "IP": "S IP",
}
"""What is heard for each word of the table; values and repeats are looked at apart."""


def reach(state: str, *first: str) -> Mn400Bench:
    """A board in ``state``, told ``first`` before."""
    bench = Mn400Bench()
    for line in (*first, *REACHED[state]):
        assert bench.say(line) == "S D"
    assert bench.device.describe(bench.now).state == state
    return bench


@pytest.mark.parametrize("state", REACHED)
def test_every_command_is_answered_as_the_table_says(state: str) -> None:
    """Forty commands, each to a board that was brought into the state anew."""
    for (letter, column), word in TABLE.items():
        if column != state:
            continue
        bench = reach(state)
        told = bench.say("~0" if letter == "~" else line_of(letter, state))
        where = (letter, state, told)
        if word == "V":
            assert told.startswith("S "), where
            assert len(told) > 2, where
        elif word == "V*":
            assert told == "S", where  # the program is empty
        elif word == "R&":
            assert told == ("D" if REACHED[state] else ""), where
        else:
            assert told == REPLIES[word], where


def test_the_end_of_hold_and_of_a_motion_lead_back() -> None:
    """What the arrows of the table do not show."""
    assert Mn400Bench().say("U") == "S D"
    for before, line, after in (("HLD", "H0", "RDY"), ("HPD", "K", "MOV"), ("ABT", "M1", "RDY")):
        bench = reach(before)
        assert bench.say(line) == "S D"
        assert bench.device.describe(bench.now).state == after
    bench = reach("HPD")
    bench.say("K")
    bench.wait(5000)
    assert bench.device.describe(bench.now).state == "HLD"


@pytest.mark.parametrize("state", REACHED)
def test_unknown_commands_and_ends_of_entry(state: str) -> None:
    """Ledger §4.2: refused alone, or in the entry of a program behind START."""
    is_entered = state in ("PRG", "CFG")
    for letter in "OW5!\"#$%',-<>@\\]^_`":
        assert reach(state).say(letter) == ("S IP" if is_entered else "IC"), letter
    ended = {"PRG": "S D", "CFG": "S IP"}
    assert reach(state).say("\x04") == ended.get(state, "IC")


@pytest.mark.parametrize("state", REACHED)
def test_a_wrong_sum_has_no_effect_in_any_state(state: str) -> None:
    """The code alone, and the same state (MN4-PKT-05)."""
    bench = reach(state)
    assert bench.ask(bytes.fromhex("81 51 81 52")) == bytes.fromhex("81 51 07 00 81 5A")
    assert bench.device.describe(bench.now).state == state


ABORTED = ("ABT", "2", "1")
HALTED = ("ABT", "0", "1")
EVENTS = {
    "limit": {
        **dict.fromkeys(("MOV", "QUE", "CCX", "THR", "RUN"), ABORTED),
        **{state: (state, "0", "0") for state in ("RDY", "PAU", "PRG", "CFG", "HPD", "JOG")},
    },
    "shield": {
        **dict.fromkeys(("MOV", "QUE", "CCX", "THR", "RUN", "PAU"), HALTED),
        **{state: (state, "0", "0") for state in ("RDY", "PRG", "CFG", "HPD", "JOG")},
    },
    "shield with ;1": {
        **dict.fromkeys(("MOV", "QUE", "CCX", "THR", "RUN", "PAU"), ("PAU", "0", "0")),
        **{state: (state, "0", "0") for state in ("RDY", "PRG", "CFG", "HPD", "JOG")},
    },
}
"""Ledger §4.2: the state, the exit code and the abort flag behind an event."""


@pytest.mark.parametrize("event", EVENTS)
def test_events_lead_where_the_second_table_says(event: str) -> None:
    """A limit towards which it goes, and the shield by either mode, in every state."""
    for before, (after, exit_code, flag) in EVENTS[event].items():
        bench = reach(before, *([";1"] if event.endswith("1") else []))
        bench.switch("m1_plus" if event == "limit" else "shield")
        bench.wait(100)
        seen = bench.device.describe(bench.now)
        assert (before, seen.state, str(seen.exit_code)) == (before, after, exit_code)
        assert bench.device.flag_at(bench.now, "stop") == (flag == "1")
        if after == "PAU" and event.endswith("1") and before != "PAU":
            bench.switch("shield", on=False)
            assert bench.device.describe(bench.now).state == before
        if before == "HPD":
            assert bench.say("K") == "S D"
            stood = bench.peek()
            code = bench.device.describe(bench.now).exit_code
            bench.wait(100)
            assert (bench.peek(), code) == (stood, 2 if event == "limit" else 0)
            assert stood == [0, 0, 0, 0]
        if before == "PAU" and event == "limit":
            stood = bench.peek()
            bench.say("}")
            assert bench.value("/") == "2"
            assert bench.peek() == stood
        if before == "PAU" and event.endswith("1"):
            bench.switch("shield", on=False)
            assert bench.device.describe(bench.now).state == "PAU", "{ is not taken back"


@pytest.mark.parametrize("state", REACHED)
def test_a_power_cycle_leads_out_of_every_state(state: str) -> None:
    """Everything volatile is gone; a half entered program never was."""
    bench = reach(state)
    bench.say("M1")
    bench.power_cycle()
    assert bench.value("E") == "0,0,0,0"
    assert bench.value(":") == "1,0,0,0,0"
    assert bench.device.describe(bench.now).state == "RDY"
    assert bench.say("R") in ("S", "S M5000")
