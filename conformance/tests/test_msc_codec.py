"""Packets of the MSC executive port, both ways, sound and broken."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.families.msc import codec

BODIES = (
    codec.bread(2048), codec.bwrite(2048, range(1, 33)), codec.cflag(200), codec.dread(2008),
    codec.dwrite(2008, 1234), codec.rflag(200), codec.RFLAGS, codec.RQSTAT, codec.sflag(200),
)  # fmt: skip


def test_the_manuals_example_is_built_byte_for_byte() -> None:
    """1234 to address 2008 of unit 1: 21 bytes, sum 958."""
    raw = codec.packet(1, codec.dwrite(2008, 1234))
    assert raw.hex(" ").upper() == "02 01 00 0D 00 00 44 57 52 49 54 45 2C 07 D8 00 00 04 D2 03 BE"
    assert int.from_bytes(raw[-2:], "big") == 958


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.partition(b",")[0].decode())
def test_a_request_has_the_size_of_its_command_and_is_taken_apart_again(body: bytes) -> None:
    """All nine: name, payload and size are told by the packet itself."""
    one = codec.parse(codec.packet(7, body, 0x1234))
    assert one is not None
    assert (one.unit, one.block, one.body) == (7, 0x1234, body)
    assert one.is_request
    assert len(one.raw) == codec.REQUEST_BYTES[one.name]
    assert one.flaws == ()


def test_the_sizes_are_those_of_the_manuals_notation() -> None:
    """BWRITE has the longest request, BREAD the longest reply."""
    assert codec.REQUEST_BYTES["BWRITE"] == 145
    assert codec.REPLY_BYTES == {
        "BREAD": 142, "DREAD": 18, "RFLAG": 16, "RFLAGS": 47, "RQSTAT": 23,
    }  # fmt: skip


@given(st.integers(-(1 << 31), (1 << 31) - 1), st.integers(0, 0xFFFF))
def test_numbers_are_spelt_high_byte_first(value: int, number: int) -> None:
    """Values are signed, addresses are not; both come back."""
    one = codec.parse(codec.packet(1, codec.dwrite(number, value)))
    assert one is not None
    assert one.numbers[0] == number
    assert one.payload[2:] == value.to_bytes(4, "big", signed=True)
    reply = codec.parse(codec.packet(1, codec.body("DREAD", codec.i32(value))))
    assert reply is not None
    assert reply.values == (value,)


@given(st.sampled_from(BODIES), st.integers(1, 0xFFFF))
def test_a_wrong_checksum_is_named(body: bytes, offset: int) -> None:
    """Any offset spoils it, and nothing else is said to be wrong."""
    one = codec.parse(codec.with_wrong_checksum(codec.packet(1, body), offset))
    assert one is not None
    assert not one.is_sound
    assert len(one.flaws) == 1
    assert "checksum" in one.flaws[0]


def test_a_packet_can_lie_about_its_length() -> None:
    """The length is sent as given, under a sum that fits what is sent."""
    raw = codec.packet(1, codec.RQSTAT, length=241)
    one = codec.parse(raw)
    assert one is not None
    assert one.length == 241
    assert one.checksum == sum(raw[1:-2])
    assert "length 241 over 7 bytes" in one.flaws


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.partition(b",")[0].decode())
def test_a_packet_tells_what_it_is_still_missing(body: bytes) -> None:
    """Complete exactly with its last byte, and never asking for more than there is."""
    raw = codec.packet(1, body)
    for length in range(len(raw)):
        assert 0 < codec.missing_bytes(raw[:length]) <= len(raw) - length
    assert codec.missing_bytes(raw) == 0


@pytest.mark.parametrize("raw", [b"", b"\x02", b"\x02\x01\x00\x00\x00\x00\x00", b"\x15" * 20])
def test_what_cannot_be_a_packet_is_none(raw: bytes) -> None:
    """Too short, or begun by something else."""
    assert codec.parse(raw) is None


@pytest.mark.parametrize(
    ("body", "is_request"),
    [
        (codec.RQSTAT + b"x", False),
        (b"RQSTAT", False),
        (b"rqstat,", False),
        (codec.body("ZZZZZZ"), False),
        (codec.body("DREAD", b"\x00"), False),
        (codec.body("DREAD", b",,"), True),
        (codec.bwrite(0, range(31)), False),
    ],
)
def test_only_what_a_unit_must_serve_is_a_request(body: bytes, is_request: bool) -> None:
    """The nine names in their spelling, with a comma and the right size."""
    one = codec.parse(codec.packet(1, body))
    assert one is not None
    assert one.is_request is is_request


def test_flags_are_numbered_byte_by_byte_from_the_low_bit() -> None:
    """The ledger's example: 1, 9, 30, 100, 131, 200, 254."""
    states = bytes.fromhex(
        "02 02 00 40 00 00 00 00 00 00 00 00 10 00 00 00 08 00 00 00 00 00 00 00 00 01 00 00 00"
        "00 00 40"
    )
    assert codec.flags_on(states) == {1, 9, 30, 100, 131, 200, 254}


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (codec.ACK, "ACK"),
        (codec.NAK + codec.NAK, "NAK, NAK"),
        (
            codec.ACK + codec.packet(1, codec.body("DREAD", codec.i32(-5))),
            "ACK, unit 1: DREAD = -5",
        ),
        (codec.packet(6, codec.body("RQSTAT", codec.u16(65), bytes(6))),
         "unit 6: RQSTAT = 0041h, then 00 00 00 00 00 00"),
        (codec.packet(1, codec.body("RFLAGS", b"\x02" + bytes(31))), "unit 1: RFLAGS = 1 on"),
        (codec.with_wrong_checksum(codec.packet(1, codec.RQSTAT)),
         "unit 1: RQSTAT; checksum 0214h instead of 0213h"),
        (b"\x06\x02\x01", "ACK, 2 bytes: 02 01"),
    ],
)  # fmt: skip
def test_what_is_said_is_put_into_words(data: bytes, words: str) -> None:
    """Signs, packets and what is neither, in the order in which they came."""
    assert codec.explain(data) == words


def test_requests_are_put_into_words() -> None:
    """A write tells what goes where, a broken packet its bytes."""
    assert (
        codec.explain_request(codec.packet(1, codec.dwrite(2008, -1))) == "unit 1: DWRITE 2008 = -1"
    )
    assert codec.explain_request(codec.packet(1, codec.sflag(200), 0x1234)) == (
        "unit 1: SFLAG 200 (block 1234h)"
    )
    assert codec.explain_request(b"\x02\x01") == "a packet broken off after 2 bytes (02 01)"
    assert codec.explain_request(b"") == "nothing sent"
    block = codec.explain_request(codec.packet(1, codec.bwrite(2048, range(32))))
    assert block.startswith("unit 1: BWRITE 2048 = 0 1 2 ")


@given(st.binary(max_size=60))
def test_words_are_found_for_any_bytes(data: bytes) -> None:
    """Nothing that a line may bring makes the reports fall over."""
    assert (codec.explain(data) != "") is (data != b"")
    assert codec.explain_request(data)
