"""A failure is one sentence: what was done, what is admissible, what came."""

from __future__ import annotations

import pytest

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.wording import sentence
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.words import answer_words, request_words
from axistwin_conformance.families.mac.can import codec as can_codec
from axistwin_conformance.families.mac.serial import codec

MS = 1_000_000

in_words = find_family("mac23").in_words


def host(time_ms: int, index: int, parameter: int = 0, address: int = 0) -> Record:
    """A request."""
    data = codec.frame(address, index, parameter)
    return Record(time_ms * MS, Direction.HOST, data)


def mark(text: str, time_ms: int = 0) -> Record:
    """A line of the transcript that nobody sent."""
    return Record(time_ms * MS, Direction.NOTE, text=text)


def test_commands_and_the_rig_are_told_and_queries_before_the_last_are_not() -> None:
    """At most three acts before the last request; one repeated at once is told with its number."""
    records = [
        host(0, 0x0F, 5),
        host(10, 0x13, -500),
        host(20, 0x20),
        host(30, 0x21),
        host(35, 0x18),
        host(36, 0x18),
        mark("rig: hold shaft on", 40),
        host(60, 0x21),
        host(500, 0x20),
    ]
    assert sentence(records, in_words, ("-4..-2",), "7") == (
        "After 13h go to position -500, then 2 times 18h stop without ramp, then rig: hold shaft"
        " on, then 460 ms later, 20h position: expected position -4 to -2; came position 7."
    )


def test_what_another_check_has_sent_is_not_told() -> None:
    """The check begins with a mark."""
    records = [host(0, 0x13, 9), mark("check other"), host(5, 0x20)]
    assert sentence(records, in_words, ("an answer",), "").startswith("After 20h position: ")


def test_readings_are_told_after_the_name_of_their_switch_and_lists_as_people_do() -> None:
    """Not each with its name; no brackets."""
    told = sentence([], in_words, ("xon_byte=11h", "xon_byte=13h", "xon_byte=1Ah"), "['a', 'b']")
    assert told == "Expected xon_byte=11h, 13h or 1Ah; came a, b."


def test_abbreviations_of_the_manual_are_spelt_out() -> None:
    """Once; what a glossary does not have stays."""
    told = sentence([], in_words, ("dd 01 and dd 02",), "ff 00", "", {"dd": "fault byte dd"})
    assert told == "Expected fault byte dd 01 and dd 02; came ff 00."


def test_what_was_done_to_the_rig_is_told_although_much_was_sent_since() -> None:
    """A fault that was provoked is why a command is refused."""
    acts = [mark("rig: micro cut"), *(host(1 + n, index) for n, index in enumerate((17, 24, 26)))]
    told = sentence([*acts, host(9, 0x02)], in_words, ("a",), "b")
    assert told.startswith("After rig: micro cut, then 11h synchro, then 18h stop without ramp, ")


def test_a_number_of_increments_is_no_position() -> None:
    """What is expected says what came."""
    told = sentence([host(0, 0x20)], in_words, ("at rest 53..54 increments on",), "51")
    assert told.endswith("expected at rest 53 to 54 increments on; came 51 increments.")


def test_without_any_request_the_sentence_begins_with_what_is_expected() -> None:
    """Nobody was asked."""
    assert sentence([], in_words, ("a", "b"), "") == "Expected a or b; came nothing."


def test_a_range_of_one_value_is_that_value_and_a_remark_stands_behind() -> None:
    """Unless it is a story."""
    told = sentence([host(0, 0x20)], in_words, ("at rest at 5..5",), "6", "It was asked twice")
    assert told.endswith("expected at rest at 5; came position 6. It was asked twice.")
    assert "story" not in sentence([], in_words, ("a",), "b", "story " * 100)


@pytest.mark.parametrize(
    ("index", "parameter", "words"),
    [
        (0x13, 0xFFFFFE0C, "13h go to position -500"),
        (0x15, 0x00F60640, "15h velocity counter-clockwise at period 1600"),
        (0x16, 0xFFE00640, "16h segment of -32 steps at period 1600"),
        (0x18, 0, "18h stop without ramp"),
        (0x1C, 10, "1Ch tolerance 10"),
        (0x0C, 0xABCDEF40, "0Ch torque limit ABCDEF40"),
        (0x20, 0, "20h position"),
        (0x12, 0, "12h unassigned 00000000"),
    ],
)
def test_parameters_are_told_in_the_units_of_the_command(
    index: int, parameter: int, words: str
) -> None:
    """What is no value of the command is told as it was sent."""
    assert request_words(index, parameter) == words


def test_the_fields_of_an_answer_are_told_by_name() -> None:
    """Each with its value; a number alone needs none."""
    assert "ramp coefficient 10" in answer_words(0x26, 0x0A600800)
    assert answer_words(0x20, 7) == ""


def test_a_receipt_of_the_host_is_nothing_that_was_done() -> None:
    """An MSC gets an ACK for every reply."""
    family = find_family("msc-250")
    records = [
        Record(0, Direction.HOST, b"\x02\x01\x00\x07\x00\x00RQSTAT,\x02\x13"),
        Record(MS, Direction.HOST, b"\x06"),
    ]
    assert sentence(records, family.in_words, ("one reply",), "nothing").startswith(
        "After RQSTAT: expected"
    )


def test_requests_of_a_bus_are_told_by_direction_and_index() -> None:
    """A download and an upload share their numbers; what is no transfer is told as it is."""
    told = find_family("mac23-can").in_words
    upload, download = (can_codec.request(1, index, 5).frame().pack() for index in (0x20, 0x13))
    assert told(download, b"").request == "download 2013h go to position 5"
    assert told(upload, b"").request.startswith("upload 2000h position")
    assert told(can_codec.sync().pack(), b"").request == "SYNC"


@pytest.mark.parametrize("name", ["mac_serial", "mac_can", "msc"])
def test_every_source_is_told_in_words(name: str) -> None:
    """Title and place, no abbreviation."""
    for one in load_ledger(name).requirements.values():
        assert one.where
        assert not {"S", "C", "FAM", "DTP", "GEN", "EX"}.intersection(one.where.split(", "))
        assert "DTS-" not in one.where
        assert "PDS-" not in one.where
