"""Texts for an MN400: the edges of every command, drawn ones, and what they may do to a board."""

from __future__ import annotations

import random
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.boundaries import (
    COUNTER_BOUNDS,
    SPELLINGS,
    edges,
    optional_parameters,
    sound_values,
    typed,
)
from axistwin_conformance.families.mn400.grammar import (
    COMMANDS,
    ParsedCommand,
    Refusal,
    read_command,
)
from axistwin_conformance.families.mn400.model.draws import DRAW_BYTES, drawn, drawn_at_random
from axistwin_conformance.families.mn400.safety import danger, objection, texts

LEDGER = load_ledger("mn400")
LETTERS = tuple(COMMANDS)
REACH = 50


def reading(switch: str) -> str:
    """The default."""
    return LEDGER.ambiguity_of(switch).default_of(switch)


@pytest.mark.parametrize("letter", LETTERS)
def test_the_sound_values_of_a_command_are_accepted(letter: str) -> None:
    """And as many as it has parameters."""
    values = sound_values(COMMANDS[letter])
    assert isinstance(read_command(typed(letter, values), reading), ParsedCommand)
    assert len(values) == len(COMMANDS[letter].parameters)


@pytest.mark.parametrize("letter", LETTERS)
def test_the_edges_of_a_command_lie_on_both_sides(letter: str) -> None:
    """Something is accepted, something refused, each refusal by a requirement that exists."""
    made = [read_command(text, reading) for text in edges(letter)]
    refused = [one for one in made if isinstance(one, Refusal)]
    assert len(refused) < len(made)
    assert refused
    assert all(one.requirement in LEDGER.requirements for one in refused)
    parameters = COMMANDS[letter].parameters
    assert len(made) >= 4 + 30 * len(parameters)


def test_what_a_cast_would_let_pass_is_among_the_edges() -> None:
    """Traps 30 and 44."""
    assert {"B65537,0,0,0", "B0,0,0,-32768"} <= {*edges("B")}
    assert {"L4294967297,0,0,0", "L-,0,0,0", "L+1,0,0,0", "L1.0,0,0,0"} <= {*edges("L")}
    assert {"D-1,0,1,1", "D1,0,1,1"} & {*edges("D")}
    assert {"X0", "X3", "X5"} <= {*edges("X")}
    for value in COUNTER_BOUNDS:
        made = read_command(f"L{value}", reading)
        assert isinstance(made, ParsedCommand) is (abs(value) <= 2147483647)


@pytest.mark.parametrize(("text", "value"), SPELLINGS)
def test_a_number_may_be_spelt_so(text: str, value: int) -> None:
    """Leading zeros, and a zero below zero."""
    made = read_command(f"L{text}", reading)
    assert isinstance(made, ParsedCommand)
    assert made.values[0] == value


def test_what_may_be_left_out_is_what_the_ledger_says() -> None:
    """Motion, modal rows of four, and the optional ones."""
    assert {letter: optional_parameters(letter) for letter in LETTERS if
            optional_parameters(letter)} == {
        "A": 4, "(": 1, "+": 6, "H": 1, "L": 4, "M": 4, "F": 3, "E": 1, "B": 4, "D": 4, "P": 1,
        "T": 5,
    }  # fmt: skip


@given(st.binary(max_size=DRAW_BYTES))
def test_any_bytes_are_a_command_within_reach(data: bytes) -> None:
    """What a board would carry out goes no further than it may."""
    text = drawn(data, LETTERS, REACH)
    made = read_command(text, reading)
    if not isinstance(made, ParsedCommand) or made.letter not in "MA+T":
        return
    steps = {"A": 4, "+": 4, "M": 4, "T": 4}[made.letter]
    assert all(abs(one or 0) <= REACH for one in made.values[:steps])
    if made.letter == "+":
        assert abs(made.value(5)) <= REACH


def test_draws_reach_every_command_and_every_kind_of_refusal() -> None:
    """Mostly sound; the same seed draws the same."""
    source = random.Random(5)
    made = [drawn_at_random(source, LETTERS, REACH) for _ in range(6000)]
    again = random.Random(5)
    assert made == [drawn_at_random(again, LETTERS, REACH) for _ in range(6000)]
    read = [read_command(text, reading) for text in made]
    letters = Counter(one.letter for one in read if isinstance(one, ParsedCommand))
    assert {*letters} == {*LETTERS}
    refused = {one.requirement for one in read if isinstance(one, Refusal)}
    assert refused >= {
        "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-04", "MN4-PAR-05", "MN4-PAR-09", "MN4-ERR-01",
        "MN4-CMD-X-01", "MN4-CMD-D-01",
    }  # fmt: skip
    assert sum(letters.values()) > 3000


@pytest.mark.parametrize(
    ("text", "needed"),
    [
        ("E", "passive"), ("M", "passive"), ("M,,", "passive"), ("M0", "motion"), ("m5", "motion"),
        ("A1", "motion"), ("U", "motion"), ("C1,0", "motion"), ("}", "motion"), ("J1", "motion"),
        ("J0", "passive"), ("K", "passive"), ("Q", "passive"), ("Z", "stored"), ("z", "stored"),
        (".", "destructive"), ("=1", "passive"), ("=0", "passive"), ("=128", "passive"),
        ("=5", "destructive"), ("~0", "passive"), ("~5", "passive"), ("~4", "destructive"),
        ("~", "passive"), ("=5x", "destructive"), ("\x04", "passive"), ("L1,2,3,4", "passive"),
        ("T1,0,0,0,9", "motion"), ("V5", "passive"), ("", "passive"), ("j01", "motion"),
    ],
)  # fmt: skip
def test_a_command_has_the_class_of_what_it_may_do(text: str, needed: str) -> None:
    """Of board 1 at 9600 baud."""
    assert danger(text, 1, 9600) == needed


@pytest.mark.parametrize(
    "data",
    [
        codec.request(1, "M5"),
        codec.with_wrong_checksum(codec.request(1, "M5")),
        codec.request(7, "M5"),
        codec.request(1, "M5")[:3],
        codec.request(1, "E") + codec.request(1, "M5"),
        codec.request(1, "M5", closing=0x82),
        bytes([0x81, 0x2A, 0x81]) + codec.request(1, "Q") + codec.request(1, "U"),
    ],
)
def test_a_motion_hidden_in_broken_bytes_is_found(data: bytes) -> None:
    """A board that does not look at sums, ids and ends would carry it out."""
    assert objection(data, frozenset({"passive"}), 1, 9600) is not None
    assert objection(data, frozenset({"passive", "motion"}), 1, 9600) is None


def test_the_sum_of_a_sound_packet_is_no_command() -> None:
    """A poll whose sum is an M is a poll."""
    for board in codec.IDS:
        for text in ("*", "E", "?", "Q", "V500", codec.with_checksum(board, ord("M"))):
            raw = codec.request(board, text)
            assert texts(raw) == (text,)
            assert objection(raw, frozenset({"passive"}), board, 9600) is None
