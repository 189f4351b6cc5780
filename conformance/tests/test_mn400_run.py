"""Whole runs of the engine on a small MN400: identity, readings, checks, what is put back."""

from __future__ import annotations

from typing import Any

import pytest
from mn400_board import SmallBoard

from axistwin_conformance.base import events
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.plan import Options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.safety import danger
from axistwin_conformance.transport.serial import SerialTransport

PORT = "/dev/ttyS9"


def run(board: SmallBoard, words: tuple[str, ...] = (), **changes: Any) -> Result:
    """Judge a board as a real one, with what is passive."""
    given: dict[str, Any] = {
        "family": Mn400(),
        "model": "mn400",
        "endpoint": PORT,
        "address": board.board,
        "neighbours": (),
        "rate": 9600,
        "allowed": frozenset({"passive"}),
        "level": "full",
        "seed": 5,
        "words": words,
    } | changes
    seen: list[events.Event] = []
    engine = Engine(Options(**given), lambda neighbours: SerialTransport(board, PORT))
    return engine.run(seen.append)


def of_verdict(result: Result, verdict: Verdict) -> set[str]:
    """The requirements with that verdict."""
    return {one.requirement.id for one in result.requirements if one.verdict is verdict}


def failed(result: Result) -> set[str]:
    """The requirements that fail."""
    return of_verdict(result, Verdict.FAIL)


def test_a_sound_board_conforms() -> None:
    """Its counters and its feed hold are as they were."""
    board = SmallBoard()
    board.counters, board.feed_hold = [5, -6, 7, 8], 1
    result = run(board)
    assert failed(result) == set()
    assert not result.problems
    assert (board.counters, board.feed_hold) == ([5, -6, 7, 8], 1)
    assert len(of_verdict(result, Verdict.PASS)) > 50


@pytest.mark.strength
def test_nothing_that_moves_or_stores_is_sent_without_leave() -> None:
    """Of all frames of a run none asks for more than is passive."""
    board = SmallBoard()
    run(board)
    sound = [packet for packet in codec.packets(board.received)[0] if packet.is_sound]
    assert len(sound) > 1000
    for packet in sound:
        assert danger(packet.text, 1, 9600) == "passive", packet.text


@pytest.mark.strength
@pytest.mark.parametrize(
    ("switch", "reading"),
    [
        ("data_packet_trailer", "none"), ("outcome_null", "false"),
        ("error_start_policy", "always"), ("error_start_policy", "never"),
        ("shield_status_sense", "switch"), ("baud_reply", "plus_done"),
        ("omitted_param", "zero"), ("long_min", "-2147483648"), ("plane_base", "0"),
        ("speed_range_policy", "clip"), ("cc_unsupported", "busy"),
    ],
)  # fmt: skip
def test_a_board_of_another_reading_conforms(switch: str, reading: str) -> None:
    """The probe finds it, and the checks hold the board to it."""
    result = run(SmallBoard(1, **{switch: reading}))
    assert failed(result) == set()
    assert result.readings[switch] == reading


def test_silence_and_another_protocol_are_told() -> None:
    """Nothing is judged of a board that is not there."""
    board = SmallBoard()
    board.spoil = lambda packet: b""
    result = run(board)
    assert (result.exit_status, of_verdict(result, Verdict.PASS)) == (3, set())
    talker = SmallBoard()
    talker.spoil = lambda packet: b"OK\r\n"
    result = run(talker)
    assert (result.exit_status, of_verdict(result, Verdict.PASS)) == (3, set())


@pytest.mark.strength
def test_a_wrong_sum_in_every_reply_fails_once_and_hides_nothing() -> None:
    """The rest is judged of the replies as they should have been."""
    board = SmallBoard()
    board.spoil = codec.with_wrong_checksum
    result = run(board)
    assert failed(result) == {"MN4-PKT-03"}
    assert "MN4-CMD-L-01" in of_verdict(result, Verdict.PASS)
