"""A failure is one sentence: what the device did, under which condition, what is expected."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.wording import Observation, shown_exchange, telling
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.words import answer_words, request_words
from axistwin_conformance.families.mac.can import codec as can_codec
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.msc import codec as msc_codec

MS = 1_000_000

in_words = find_family("mac23").in_words


def sentence(*given: Any, **named: Any) -> str:
    """What a failure says."""
    return telling(*given, **named).sentence


def host(time_ms: int, index: int, parameter: int = 0, address: int = 0) -> Record:
    """A request."""
    data = codec.frame(address, index, parameter)
    return Record(time_ms * MS, Direction.HOST, data)


def mark(text: str, time_ms: int = 0) -> Record:
    """A line of the transcript that nobody sent."""
    return Record(time_ms * MS, Direction.NOTE, text=text)


def test_what_led_there_is_told_and_the_rest_is_not() -> None:
    """The motion, the last command that changed something, what was done to the rig; no query."""
    records = [
        host(0, 0x0F, 5),
        host(10, 0x13, -500),
        host(20, 0x20),
        mark("rig: the shaft was held", 40),
        host(60, 0x18),
        host(70, 0x21),
        host(500, 0x20),
    ]
    assert sentence(records, in_words, ("-4..-2",), "7") == (
        "After 13h (go to position -500) and the shaft was held, 440 ms after 18h (stop without"
        " ramp), 20h (position) read 7 increments; expected -4 to -2 increments."
    )


def test_a_stored_value_does_not_lead_to_a_refusal() -> None:
    """It may lead to an answer."""
    records = [host(0, 0x13, 9), host(5, 0x0F, 5), host(6, 0x02)]
    told = sentence(records, in_words, ("a refusal",), "accepted")
    assert told.startswith("6 ms after 13h (go to position 9), 02h (torque at rest 0): accepted; ")
    told = sentence([*records, host(9, 0x26)], in_words, ("5",), "6")
    assert told.startswith("After 02h (torque at rest 0), 26h (ramp, torque, modes, tolerance): 6")


def test_a_power_cycle_is_one_cause() -> None:
    """Not two acts of the rig."""
    records = [mark(f"rig: the power was switched {way}", 0) for way in ("off", "on")]
    told = sentence([*records, host(9, 0x20)], in_words, ("4",), "5")
    assert told.startswith("After a power cycle, 20h (position) read 5 increments; ")


def test_what_another_check_has_sent_is_not_told() -> None:
    """The check begins with a mark."""
    records = [host(0, 0x13, 9), mark("check other"), host(5, 0x20)]
    assert sentence(records, in_words, ("an answer",), "").startswith("20h (position): nothing")


def test_a_check_names_the_request_that_it_judged() -> None:
    """It need not be the last one: the words and the lines shown are about that one."""
    judged = host(2, 0x02)
    reply = Record(3 * MS, Direction.DEVICE, b"\x06\x13\x1a")
    records = [mark("check this"), host(0, 0x13, 9), judged, reply, host(4, 0x18)]
    seen = Observation("{request} was accepted", request=judged.data, is_whole=False)
    told = telling(records, in_words, ("a refusal",), seen)
    assert told.sentence == (
        "2 ms after 13h (go to position 9), 02h (torque at rest 0) was accepted; expected a"
        " refusal."
    )
    assert told.decisive == (1, 2, 3)
    assert told.by_hand == (1, 2)


def test_a_check_that_says_all_itself_is_not_added_to() -> None:
    """The causes it names are among the lines shown."""
    records = [host(0, 0x0F, 5), host(1, 0x13, 9), host(2, 0x26)]
    seen = Observation("the ramp was 10", wanted="5", causes=("0Fh (",))
    told = telling(records, in_words, ("ramp 5",), seen)
    assert told.sentence == "The ramp was 10; expected 5."
    assert told.decisive == (0, 2)


def test_what_a_check_names_stands_beside_what_is_likely() -> None:
    """Where the clause leaves the condition open; each once, in the order of time."""
    records = [host(0, 0x0F, 5), host(1, 0x0D, 900), host(2, 0x13, 9), host(60, 0x20)]
    for causes in (("0Fh (",), ("0Fh (", "13h (")):
        seen = Observation("{request} read 3", wanted="9", causes=causes, is_whole=False)
        told = telling(records, in_words, ("9",), seen)
        assert told.sentence == (
            "After 0Fh (ramp coefficient 5), 58 ms after 13h (go to position 9),"
            " 20h (position) read 3; expected 9."
        )
        assert told.decisive == (0, 2, 3)


def test_silence_says_how_long_was_waited() -> None:
    """As the transcript has it."""
    silence = Record(0, Direction.SILENCE, text="nothing for 512 ms")
    seen = Observation("{request} got no reply{waited}")
    told = sentence([host(0, 0x20), silence], in_words, ("an answer",), seen)
    assert told == "20h (position) got no reply within 512 ms; expected an answer."


def test_by_hand_sends_all_that_changed_something_and_says_where_that_is_not_enough() -> None:
    """Of settings the last of each; no queries but the one that is judged."""
    records = [host(0, 0x0F, 5), host(1, 0x0F, 6), host(2, 0x21), host(3, 0x13, 9), host(4, 0x20)]
    assert telling(records, in_words, ("1",), "2").by_hand == (1, 3, 4)
    rig = [mark("rig: the shaft was held"), *records]
    told = telling(rig, in_words, ("1",), "2")
    assert told.by_hand == (0, 2, 4, 5)  # the shaft is held between them
    assert told.no_hand.startswith("not with 'axistwin send' alone")
    many = [host(n, 0x13, n) for n in range(30)]
    assert telling(many, in_words, ("1",), "2").no_hand.startswith("too long to type (29 steps ")


def test_by_hand_leaves_out_what_was_refused_and_stops_of_what_did_not_move() -> None:
    """A refused request has changed nothing, and one stop is enough."""
    refused = Record(3 * MS, Direction.DEVICE, b"\x06\x13\x17")
    sent = [host(0, 0x18), host(1, 0x0F, 5), host(2, 0x0F, 6), refused, host(4, 0x18)]
    moved = [*sent, host(5, 0x13, 9), host(6, 0x18), host(7, 0x20)]
    assert telling(moved, in_words, ("1",), "2").by_hand == (1, 5, 6, 7)


def test_abbreviations_of_the_manual_are_spelt_out() -> None:
    """Once; what a glossary does not have stays."""
    told = sentence([], in_words, ("dd 01 and dd 02",), "ff 00", "", {"dd": "fault byte dd"})
    assert told == "Seen: ff 00; expected fault byte dd 01 and dd 02."


def test_a_number_of_increments_is_no_position() -> None:
    """What is expected says what came."""
    told = sentence([host(0, 0x20)], in_words, ("at rest 53..54 increments on",), "51")
    assert told.endswith("read 51 increments; expected at rest 53 to 54 increments on.")


def test_without_any_request_the_sentence_begins_with_what_was_seen() -> None:
    """Nobody was asked; lists are told as people do."""
    assert sentence([], in_words, ("a", "b"), "") == "Seen: nothing; expected a or b."
    assert sentence([], in_words, ("a",), "['c', 'd']") == "Seen: c, d; expected a."


def test_a_range_of_one_value_is_that_value_and_a_remark_stands_behind() -> None:
    """Unless it is a story."""
    told = sentence([host(0, 0x20)], in_words, ("at rest at 5..5",), "6", "It was asked twice")
    assert told.endswith("read 6 increments; expected at rest at 5 (It was asked twice).")
    assert "story" not in sentence([], in_words, ("a",), "b", "story " * 100)


@pytest.mark.parametrize(
    ("index", "parameter", "words"),
    [
        (0x13, 0xFFFFFE0C, "13h (go to position -500)"),
        (0x15, 0x00F60640, "15h (velocity counter-clockwise at period 1600 × 0.125 µs)"),
        (0x16, 0xFFE00640, "16h (segment of -32 steps at period 1600 × 0.125 µs)"),
        (0x18, 0, "18h (stop without ramp)"),
        (0x1C, 10, "1Ch (tolerance 10)"),
        (0x0C, 0xABCDEF40, "0Ch (torque limit ABCDEF40h)"),
        (0x20, 0, "20h (position)"),
        (0x12, 0, "12h (not used 00000000h)"),
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
        "RQSTAT: nothing; expected"
    )


def test_requests_of_a_bus_are_told_by_direction_and_index() -> None:
    """A download and an upload share their numbers; what is no transfer is told as it is."""
    told = find_family("mac23-can").in_words
    upload, download = (can_codec.request(1, index, 5).frame().pack() for index in (0x20, 0x13))
    assert told(download, b"").request == "download 2013h (go to position 5)"
    assert told(upload, b"").request.startswith("upload 2000h (position")
    assert told(can_codec.sync().pack(), b"").request == "SYNC"


@pytest.mark.parametrize("name", ["mac_serial", "mac_can", "msc"])
def test_every_source_is_told_in_words(name: str) -> None:
    """Title and place, no abbreviation."""
    for one in load_ledger(name).requirements.values():
        assert one.where
        assert not {"S", "C", "FAM", "DTP", "GEN", "EX"}.intersection(one.where.split(", "))
        assert "DTS-" not in one.where
        assert "PDS-" not in one.where


def test_what_a_start_begins_is_shown_beside_it() -> None:
    """The command that makes a motion wait, and the motion; not what is over."""
    waits = [host(0, 0x10), host(1, 0x13, 60), host(2, 0x11), host(3, 0x20)]
    told = telling(waits, in_words, ("4..6",), "0")
    assert told.sentence.startswith(
        "After 10h (wait for synchro) and 13h (go to position 60), 1 ms after 11h (synchro), 20h"
    )
    assert told.decisive == (0, 1, 2, 3)
    over = [*waits[:3], host(4, 0x18), host(5, 0x13, 0), host(6, 0x20)]
    assert telling(over, in_words, ("4..6",), "0").decisive == (4, 5)


def test_of_a_short_sequence_every_operation_is_shown_and_sent_again() -> None:
    """It has been shrunk to those that it takes, twice the same one included."""
    msc = find_family("msc-250").in_words
    sets, asks = (
        msc_codec.packet(1, msc_codec.sflag(184)),
        msc_codec.packet(1, msc_codec.rflag(184)),
    )
    sent = [Record(n, Direction.HOST, data) for n, data in enumerate((sets, sets, asks), 1)]
    told = telling([mark("operations begin here: 2"), *sent], msc, ("on",), "off")
    assert told.sentence == "After SFLAG 184 and SFLAG 184, RFLAG 184: off; expected on."
    assert told.decisive == told.by_hand == (1, 2, 3)
    long = [Record(n, Direction.HOST, data) for n, data in enumerate([*[sets] * 9, asks])]
    told = telling([mark("operations begin here: 9"), *long], msc, ("on",), "off")
    assert told.decisive == (9, 10)


def answered(time_ms: int, digits: str = "06 13 1A") -> Record:
    """A reply."""
    return Record(time_ms * MS, Direction.DEVICE, bytes.fromhex(digits))


AT_37 = "06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 32 35 31 37 03 1A"


def test_the_place_where_a_move_began_comes_first() -> None:
    """As the device showed it before anything changed it, even 0; nothing where nothing moves."""
    records = [host(0, 0x20), answered(1, AT_37), host(2, 0x0F, 1), host(4, 0x13, 80)]
    later = [host(6, 0x20), answered(7, AT_37.replace("32 35 31 37", "30 30 31 30"))]
    told = telling([*records, *later, host(8, 0x18)], in_words, ("acceptance",), "nothing")
    assert [one.text for one in told.before] == ["go to 37", "wait 1370 ms"]
    at_0 = answered(1, "06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")
    told = telling([records[0], at_0, *records[2:], *later, host(8, 0x18)], in_words, ("1",), "2")
    assert [one.text for one in told.before] == ["go to 0", "wait 1000 ms"]
    assert telling([*records[:2], host(2, 0x25)], in_words, ("1",), "2").before == ()
    asked = [records[0], at_0, host(2, 0x20)]
    assert telling(asked, in_words, ("1",), "2").before == ()


def test_by_hand_sends_only_what_the_last_request_depends_on() -> None:
    """The move depends on its speed, which depends on nothing; a motor is on from the start."""
    sent = [host(0, 0x1A), host(1, 0x0C, 9), host(2, 0x19), host(3, 0x0D, 900), host(4, 0x1C, 3)]
    moved = [*sent, host(5, 0x13, 9), host(6, 0x20)]
    assert telling(moved, in_words, ("1",), "2").by_hand == (3, 5, 6)
    assert telling([*moved[:-1], host(6, 0x27)], in_words, ("1",), "2").by_hand == (3, 4, 5, 6)
    assert telling([*sent, host(5, 0x0D, 8), host(6, 0x25)], in_words, ("1",), "2").by_hand == (
        5,
        6,
    )


def test_what_was_set_earlier_in_the_run_is_set_first() -> None:
    """Unless the run found it so, or nothing depends on it; an axis that has moved goes back."""
    speeds = "06 13 02 30 31 31 30 30 35 30 35 30 30 30 30 30 35 31 46 03 1A"
    begun = [host(0, 0x25), answered(1, speeds), host(2, 0x0D, 900), answered(3)]
    more = [host(4, 0x1C, 3), answered(5), host(6, 0x0E, 0x500), answered(7)]
    run = [*begun, *more, host(8, 0x16, 0x0005_1000), answered(9)]
    check = [mark("check this", 20), host(20, 0x20), answered(21, AT_37)]
    moves = [*check, host(22, 0x16, 0x0005_1000), host(23, 0x20)]
    told = telling(moves, in_words, ("1",), "2", history=lambda: [*run, *moves])
    assert [one.data or one.text for one in told.before] == [
        run[2].data, run[8].data, "wait 2500 ms", "go to 37", "wait 1370 ms",
    ]  # fmt: skip
    asks = [*check, host(22, 0x23)]
    assert telling(asks, in_words, ("1",), "2", history=lambda: [*run, *asks]).before == ()


def test_what_a_stop_has_not_changed_was_so_before_it() -> None:
    """An exchange that is quoted ends with the first look, not with the last."""
    digits = "06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 32 35 31 37 03 1A"
    answers = [Record(n * MS, Direction.DEVICE, bytes.fromhex(digits)) for n in range(9)]
    moves = [host(0, 0x09, 36), host(1, 0x13, 99)]
    looks = [host(2, 0x20), answers[3], host(4, 0x18), host(5, 0x20), answers[6], host(7, 0x03)]
    assert shown_exchange([*moves, *looks], in_words, ("09h",)) == (*moves, *looks[:2])
    asked_twice = [host(0, 0x20), answers[1], host(2, 0x1F), host(3, 0x20), answers[4]]
    assert shown_exchange(asked_twice, in_words) == tuple(asked_twice[2:])
    assert shown_exchange([], in_words) == ()


def test_a_bare_byte_has_the_name_that_the_expected_one_has() -> None:
    """Both in one notation; a number without a name stays as it is."""
    told = sentence([host(0, 0x21)], in_words, ("dd 01",), "00", glossary={"dd": "fault byte"})
    assert told == "21h (status): fault byte 00; expected fault byte 01."
    told = sentence([host(0, 0x21)], in_words, ("dd 01",), "000", glossary={"dd": "fault byte"})
    assert told == "21h (status): 000; expected fault byte 01."


def test_an_earlier_exchange_stands_before_that_of_the_check() -> None:
    """Under its note, with the rule that was applied; both are sent by hand."""
    before = (mark("earlier in this run, the device refused it:"), host(0, 0x0F, 5))
    records = [mark("check this"), host(900, 0x0F, 6), host(901, 0x20)]
    seen = Observation("{request} was odd", rule="The same.", earlier=before, causes=("0Fh",))
    told = telling(records, in_words, ("the same",), seen)
    found = told.finding("MACS-LINE-01", ("the same",), seen, "", records, 60)
    texts = [record.text for record in found.transcript if record.text]
    assert texts == [before[0].text, "in this check:", "check this"]
    assert [found.transcript[n].data for n in found.decisive if found.transcript[n].data] == [
        before[1].data, records[1].data, records[2].data,
    ]  # fmt: skip
    assert [found.transcript[n] for n in found.by_hand] == [before[1], *records[1:]]
    assert found.rule == "The same."
