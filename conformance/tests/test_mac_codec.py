"""Frames of the MAC serial line, both ways, legal and not."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.base.ledger import family_folder
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.checks.replies import readdressed
from axistwin_conformance.sequences.golden import golden_rows

FIXTURES = Path(__file__).parents[2] / "fixtures" / "mac_serial"
GOLDEN = family_folder("mac_serial") / "golden" / "exchanges.toml"


def test_the_manuals_first_example_is_built_byte_for_byte() -> None:
    """300 rpm on module 00: the frame of the worked example, its misprints corrected."""
    frame = codec.request(0, 0x15, 0x0320).encode()
    assert frame == bytes.fromhex("02 303134 3030 3135 3030 3030303030333230 4142 03")


@pytest.mark.parametrize("golden", golden_rows("mac_serial"), ids=lambda golden: golden["name"])
def test_golden_requests_are_what_the_codec_builds(golden: Mapping[str, Any]) -> None:
    """Every golden request has 21 bytes and the sum written beside it."""
    frame = bytes.fromhex(golden["request"])
    fields = codec.SerialRequest(frame[4:6], frame[6:8], frame[8:10], frame[10:18])
    assert fields.encode() == frame
    assert sum(frame[4:18]) == int(golden["sum"], 16)
    assert readdressed(frame, int(frame[4:6], 16)) == frame


@pytest.mark.parametrize("golden", golden_rows("mac_serial"), ids=lambda golden: golden["name"])
def test_golden_replies_are_understood(golden: Mapping[str, Any]) -> None:
    """Every golden reply is accepted or an answer, and complete exactly at its last byte."""
    reply = bytes.fromhex(golden["reply"])
    assert codec.parse(reply).kind in (ReplyKind.ACCEPTED, ReplyKind.ANSWER)
    for length in range(len(reply)):
        assert 0 < codec.missing_bytes(reply[:length]) <= len(reply) - length
    assert codec.missing_bytes(reply) == 0


def test_the_shipped_golden_frames_are_those_of_the_fixtures() -> None:
    """The installed suite and the fixtures folder hold the same bytes."""
    assert (FIXTURES / "exchanges.toml").read_bytes() == GOLDEN.read_bytes()


def test_every_misprint_says_what_is_wrong_with_it() -> None:
    """A recorded misprint has the printed form, the place and the reason."""
    data = tomllib.loads(GOLDEN.read_text(encoding="utf-8"))
    misprints = [one for row in data["exchange"] for one in row.get("misprint", [])]
    assert len(misprints) >= 5
    assert all(one["printed"] and one["where"] and one["why"] for one in misprints)
    assert all(one["corrected"] and one["ambiguity"] for one in data["erratum"])


def test_a_wrong_checksum_stays_two_digits_and_wrong() -> None:
    """Any offset of 1..255 gives another checksum."""
    frame = codec.request(0x7F, 0x20)
    right = frame.encode()[18:20]
    spoilt = {frame.with_wrong_checksum(offset).encode()[18:20] for offset in range(1, 256)}
    assert len(spoilt) == 255
    assert right not in spoilt


def test_lower_case_frames_carry_their_own_sum() -> None:
    """In lower case the sum is that of the characters sent."""
    frame = codec.request(0xAB, 0x1E, 0xABCDEF01).in_lower_case().encode()
    assert frame[4:6] == b"ab"
    assert frame[18:20] == codec.two_digits(codec.checksum(frame[4:18]))


@pytest.mark.parametrize(
    ("received", "kind"),
    [
        ("", ReplyKind.SILENCE),
        ("15", ReplyKind.NACK),
        ("06 13 1A", ReplyKind.ACCEPTED),
        ("06 13 11", ReplyKind.ACCEPTED),
        ("06 13 17", ReplyKind.REFUSED),
        ("06 13 18", ReplyKind.REFUSED),
        ("06 13 00", ReplyKind.GARBAGE),
        ("06 13", ReplyKind.GARBAGE),
        ("15 15", ReplyKind.GARBAGE),
        ("1A", ReplyKind.GARBAGE),
    ],
)
def test_short_replies_are_told_apart(received: str, kind: ReplyKind) -> None:
    """Each short reply has its kind; both spellings of Xon and Xonerror are understood."""
    assert codec.parse(bytes.fromhex(received)).kind is kind


def test_the_spelling_of_xon_is_told() -> None:
    """The reading of AMB-01 and AMB-02 is named by the reply."""
    assert codec.parse(b"\x06\x13\x11").xon_spelling == "11h"
    assert codec.parse(b"\x06\x13\x17").xonerror_spelling == "17h"
    assert codec.parse(b"\x06\x13\x17").xon_spelling is None


ANSWER = bytes.fromhex("06 13 02 303131 3030 30 3030303030303030 3130 03 1A")


@pytest.mark.parametrize(
    ("offset", "byte", "flaw"),
    [
        (4, 0x32, "length field"),
        (6, 0x61, "digits"),
        (12, 0x31, "checksum"),
        (17, 0x32, "checksum"),
        (19, 0x04, "Etx"),
        (20, 0x17, "Xon"),
    ],
)
def test_each_flaw_of_an_answer_is_named(offset: int, byte: int, flaw: str) -> None:
    """An answer with one wrong byte is garbage that says what is wrong."""
    reply = codec.parse(ANSWER[:offset] + bytes([byte]) + ANSWER[offset + 1 :])
    assert reply.kind is ReplyKind.GARBAGE
    assert flaw in str(reply)


def test_no_byte_corrupted_lost_or_added_leaves_a_sum_right() -> None:
    """Garbage with the right sum is none of the line's; that of a number with a sign is right."""
    summed = b"002-3FFFFFF"
    signed = codec.ANSWER_START + b"011" + summed + b"%02X" % codec.checksum(summed) + b"\x03\x1a"
    assert codec.parse(signed).kind is ReplyKind.GARBAGE
    assert codec.is_summed(signed)
    answer = bytes.fromhex("06 13 02 303131 3030 36 3041363031303030 3245 03 1A")
    assert codec.is_summed(answer)
    hit = [answer[:at] + answer[at + 1 :] for at in range(len(answer))]
    for byte in range(256):
        hit += [answer[:at] + bytes([byte]) + answer[at + 1 :] for at in range(len(answer))]
        hit += [answer[:at] + bytes([byte]) + answer[at:] for at in range(len(answer) + 1)]
    garbage = [one for one in hit if codec.parse(one).kind is ReplyKind.GARBAGE]
    assert len(garbage) > 10_000
    assert not any(codec.is_summed(one) for one in garbage)


def test_an_answer_of_28h_may_say_014() -> None:
    """The length printed for 28h is understood and told."""
    reply = codec.parse(ANSWER.replace(b"011", b"014"))
    assert (reply.kind, reply.length) == (ReplyKind.ANSWER, b"014")


@given(st.binary(max_size=40))
@settings(max_examples=300, database=None, derandomize=True)
def test_nothing_received_makes_the_parser_fail(data: bytes) -> None:
    """Whatever arrives is parsed, explained and accounted for."""
    assert codec.parse(data).raw == data
    assert codec.explain(data)
    assert codec.missing_bytes(data) >= 0


@given(st.integers(0, 255), st.integers(0, 255), st.integers(-(2**31), 2**32 - 1))
@settings(max_examples=200, database=None, derandomize=True)
def test_requests_hold_their_numbers(address: int, index: int, parameter: int) -> None:
    """A request spells its fields so that they read back."""
    frame = codec.request(address, index, parameter).encode()
    assert len(frame) == codec.REQUEST_BYTES
    assert (int(frame[4:6], 16), int(frame[6:8], 16)) == (address, index)
    assert int(frame[10:18], 16) == parameter & 0xFFFFFFFF
    assert "wrong checksum" not in codec.explain(frame)


def test_explanations_name_command_address_and_flaws() -> None:
    """A line of a report says who is asked for what, and what is wrong with the frame."""
    frame = codec.request(5, 0x13, -1000)
    assert codec.explain(frame.encode()) == "to module 05h: 13h (go to position -1000)"
    assert "checksum 34h instead of 33h" in codec.explain(frame.with_wrong_checksum().encode())
    assert "length field 011" in codec.explain(replace(frame, length=b"011").encode())
    assert "no frame" in codec.explain(frame.encode()[:-1])
    assert codec.explain(ANSWER) == "answer of module 00h to 20h: 0 increments"


def test_the_number_of_an_answer_is_had_without_its_reply() -> None:
    """The short way gives what the long one gives, also of what is no good answer."""
    summed = b"00" + b"0" + b"000003E8"
    good = b"\x06\x13\x02011" + summed + codec.two_digits(codec.checksum(summed)) + b"\x03\x1a"
    assert codec.parse(good).data == codec.answer_data(good) == 1000
    for at in range(len(good)):
        spoilt = good[:at] + bytes([good[at] ^ 0x40]) + good[at + 1 :]
        assert codec.answer_data(spoilt) == codec.parse(spoilt).data
    for short in (b"", b"\x15", b"\x06\x13\x1a", good[:-1]):
        assert codec.answer_data(short) is None
