"""Bytes of an MN400's line in words, and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.devices.mn400.grammar import COMMANDS
from axistwin.devices.mn400.link.decode import compose, explain
from axistwin.devices.mn400.link.packets import packet
from axistwin.errors import UsageError


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ("81 4D 31 30 30 30 81 10", "Mover 1000 (board 1)"),
        (
            "81 2A 03 00 81 2F 81 2A 16 00 81 42",
            "PollDevices: START (board 1); PollDevices: PRESENT (board 1)",
        ),
        ("80 4B 80 4B", "Release (all boards)"),
        ("85 7E 12 00 85 1A", "SetBaudRate: BAUDCHANGEOK (board 5)"),
        ("81 4B 10 81 5D", "Release: NOMOVEPENDING (board 1)"),
        (
            "81 45 35 2C 2D 37 06 81 02",
            "ReadPosition = 5,-7 (board 1) [checksum wrong, 12h is right]",
        ),
        ("81 65 81 67", "ReadPosition (board 1)"),
        ("81 04 81 06", "EndOfProgram (board 1)"),
        ("81 57 0C 00 81 65", "command 'W': INVALIDCOMMAND (board 1)"),
        ("81 00 13 00 81 15", "command 00h: TIMEOUT (board 1)"),
        ("81 4C 01 02 81 51", "LoadCount 01 02 (board 1)"),
        ("00 41 81 2A 81 2C 7F", "00 41; PollDevices (board 1); 7F"),
        ("81 2A", "81 2A [incomplete: the closing address and the checksum are missing]"),
        ("81 2A 81", "81 2A 81 [incomplete: the checksum is missing]"),
        ("81 81 2A 81 2C", "81; PollDevices (board 1)"),
        ("82 4D 31 81 2A 81 2C", "82 4D 31; PollDevices (board 1)"),
        ("81 2A 81 81 2A 81 2C", "81 2A 81; PollDevices (board 1)"),
    ],
)
def test_bytes_in_words(written: str, words: str) -> None:
    """Requests, replies, wrong sums, what breaks off, and what is no packet."""
    assert explain(bytes.fromhex(written)) == words


@given(st.binary(max_size=40))
def test_whatever_comes_is_explained(data: bytes) -> None:
    """It never fails, and leaves nothing out."""
    assert bool(explain(data)) == bool(data)


@pytest.mark.parametrize("letter", COMMANDS)
def test_words_for_each_command_lead_back_to_it(letter: str) -> None:
    """By its name as it is explained, and as the manual writes it."""
    raw = packet(3, letter.encode() + b"1,-2")
    assert compose(explain(raw), 1) == raw
    assert compose(f"{letter}1,-2", 3) == raw


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("m1000", "81 6D 31 30 30 30 81 30"),
        ("Mover 1000, 5 (all boards)", "80 4D 31 30 30 30 2C 35 80 6F"),
        ("(50", "81 28 35 30 81 0F"),
        ("EndOfProgram", "81 04 81 06"),
        ("*  (board 127)", "FF 2A FF 28"),
    ],
)
def test_words_in_bytes(text: str, written: str) -> None:
    """A board in brackets goes before the one that is asked otherwise."""
    assert compose(text, 1) == bytes.fromhex(written)


@pytest.mark.parametrize("text", ["", "Moverr 5", "W5", "M5 (board 128)", "Mé"])
def test_what_is_no_command_is_a_mistake(text: str) -> None:
    """One clear line."""
    with pytest.raises(UsageError) as told:
        compose(text, 1)
    assert "\n" not in str(told.value)
