"""The lenient grammar of the serial line: each departure is named, and mended; nothing else is
taken for a reply."""

from __future__ import annotations

import itertools
import random
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.core.lenient import Mending
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.lenient import MOST_DEPARTURES, lenient

pytestmark = pytest.mark.strength

ADDRESSES = (0x00, 0x05, 0x10, 0x7F)
NUMBERS = (0x740001AB, 0, 1, 0xFFFFFFFF, 0x03E81000, 0x00ABCDEF, 0x80000000)
QUERIES = range(0x20, 0x2A)
COMMAND = 0x18
ACCEPTED, REFUSED = b"\x06\x13\x1a", b"\x06\x13\x17"

Made = tuple[str, str, bytes, bool]  # requirement, name, what comes, whether it can be mended


@dataclass(frozen=True)
class Answer:
    """A sound answer, field by field."""

    address: bytes
    digit: bytes
    data: bytes
    length: bytes = b"011"
    xon: bytes = b"\x1a"

    @property
    def body(self) -> bytes:
        """What the sum covers."""
        return self.address + self.digit + self.data

    def put(
        self, *, body: bytes | None = None, check: bytes | None = None, length: bytes | None = None,
        head: bytes = b"\x06\x13\x02", end: bytes = b"\x03", xon: bytes | None = None,
    ) -> bytes:  # fmt: skip
        """The bytes, with some of them changed; the sum is that of what is sent."""
        body = self.body if body is None else body
        check = _sum(body) if check is None else check
        length = self.length if length is None else length
        return head + length + body + check + end + (self.xon if xon is None else xon)


def _sum(data: bytes) -> bytes:
    return b"%02X" % (sum(data) % 256)


def framing(one: Answer) -> Iterator[Made]:
    """What is wrong around the digits."""
    form, flow = "MACS-REPLY-07", "MACS-LINE-02"
    yield form, "acknowledgement", one.put(head=b"\x13\x02"), True
    yield form, "acknowledgement", one.put(head=b"\x07\x13\x02"), True
    yield flow, "Xoff", one.put(head=b"\x06\x02"), True
    yield form, "Xoff", one.put(head=b"\x06\x14\x02"), True
    yield form, "start byte", one.put(head=b"\x06\x13"), True
    yield form, "start byte", one.put(head=b"\x06\x13\x01"), True
    yield form, "end byte", one.put(end=b""), True
    yield form, "end byte", one.put(end=b"\x04"), True
    yield flow, "Xon", one.put(xon=b""), True
    for other in (b"\x17", b"\x18", b"\x00", b"\x03"):
        yield form, "Xon", one.put(xon=other), True
    for length in (b"021", b"017", b"012", b"00B", b"13", b"11", b"0011", b""):
        yield "MACS-REPLY-10", "length", one.put(length=length), True
    if one.length == b"011" and one.digit != b"8":
        yield "MACS-REPLY-10", "length", one.put(length=b"014"), True


def fields(one: Answer) -> Iterator[Made]:
    """What is wrong in what the sum covers, which is that of what is sent or of what was meant."""
    rest, check = one.digit + one.data, _sum(one.body)
    own = one.address
    for address in (
        b"33", b"FF", own[1:], own[:1], b"00" + own, own + b"00", b"0" + own, own + b"0", b"",
    ):  # fmt: skip
        if address != one.address:
            yield "MACS-REPLY-08", "address", one.put(body=address + rest), True
            yield "MACS-REPLY-08", "address", one.put(body=address + rest, check=check), True
    digits = [b"F", b"2" + one.digit, b"0" + one.digit, one.digit + b"0", one.digit + b"F"]
    if not one.data.startswith(one.digit):  # else nobody can tell which of the two is missing
        digits.append(b"")
    for digit in digits:
        body = one.address + digit + one.data
        yield "MACS-REPLY-09", "digit", one.put(body=body), True
        yield "MACS-REPLY-09", "digit", one.put(body=body, check=check), True
    bare = one.data.lstrip(b"0") or b"0"
    if bare != one.data:
        yield "MACS-REPLY-07", "data", one.put(body=one.address + one.digit + bare), True
    for more in (b"0", b"00", b"F" * 8 if one.data >= b"8" else b"0" * 8):
        body = one.address + one.digit + more + one.data
        yield "MACS-REPLY-07", "data", one.put(body=body), True
        yield "MACS-REPLY-07", "data", one.put(body=body, check=check), True


def sums(one: Answer) -> Iterator[Made]:
    """Sums that cover something else, are formed in another way, or are not there."""
    body, right = one.body, sum(one.body) % 256
    exclusive = 0
    for byte in body:
        exclusive ^= byte
    for value in (
        sum(one.length + body), sum(b"\x02" + one.length + body),
        sum(b"\x02" + one.length + body + b"\x03"), sum(body + b"\x03"), sum(body[2:]),
        sum(one.data), -right, ~right, right & 0x7F, exclusive, right + 1,
        sum(int(body[at : at + 1], 16) for at in range(len(body))),
    ):  # fmt: skip
        if value % 256 != right:
            yield "MACS-REPLY-07", "checksum", one.put(check=b"%02X" % (value % 256)), True
    if (turned := _sum(body)[::-1]) != _sum(body):
        yield "MACS-REPLY-07", "checksum", one.put(check=turned), True
    yield "MACS-REPLY-07", "checksum", one.put(check=b""), True
    yield "MACS-REPLY-07", "checksum", one.put(check=_sum(body)[:1] + b"\xce"), True
    yield "MACS-REPLY-07", "data", one.put(body=body[:5] + b"\xcf" + body[6:]), False
    yield "MACS-REPLY-07", "checksum", one.put(check=b"%X" % sum(body)), True
    yield "MACS-REPLY-07", "checksum", one.put(check=b"%04X" % sum(body)), True
    if right < 0x30 or right > 0x46:
        yield "MACS-REPLY-07", "checksum", one.put(check=bytes([right])), True


def whole(one: Answer) -> Iterator[Made]:
    """What concerns the reply as a whole."""
    sound = one.put()
    message = sound[2:-1]
    for top in (
        bytes(byte | 0x80 for byte in sound),
        bytes(byte | (byte.bit_count() % 2) << 7 for byte in sound),
        bytes(byte | (1 - byte.bit_count() % 2) << 7 for byte in sound),
    ):
        yield "MACS-LINE-01", "data bits", top, True
    for mark in b", ;":
        apart = bytes([mark]).join([one.length, one.address, one.digit, one.data, _sum(one.body)])
        came = b"\x06\x13\x02" + apart + b"\x03" + one.xon
        yield "MACS-REPLY-07", "separator", came, True
    for around in (
        (b"", b"\x06\x13" + one.xon), (b"", one.xon + b"\x06\x13"), (b"\x13", one.xon + b"\x06"),
        (b"\x06\x13" + one.xon, b""), (b"\x13\x06", one.xon), (one.xon + b"\x06\x13", b""),
    ):  # fmt: skip
        yield "MACS-REPLY-07", "order", around[0] + message + around[1], True
    for came in (sound * 2, sound * 3, ACCEPTED + sound, sound + ACCEPTED):
        yield "MACS-REPLY-12", "number", came, True
    for before, behind in ((b"\x55", b""), (b"", b"\x55"), (b"", b"\r\n"), (b"\xff", b"\0\0")):
        yield "MACS-REPLY-12", "surplus", before + sound + behind, True
    for count in range(2, 20):
        yield "MACS-REPLY-07", "completeness", sound[:count], False
    lower = one.body.lower()
    if lower != one.body:
        yield "MACS-FRAME-04", "case", one.put(body=lower, check=_sum(lower).lower()), True
        yield "MACS-FRAME-04", "case", one.put(body=lower, check=_sum(one.body)), True
        yield "MACS-FRAME-04", "case", one.put(body=lower), True


def answers() -> Iterator[tuple[bytes, Answer]]:
    """Queries, and what a sound module answers, in any reading of the manual."""
    for address in ADDRESSES:
        for index, number in zip(QUERIES, itertools.cycle(NUMBERS), strict=False):
            asked = b"%02X" % address, b"%X" % (index & 0xF), b"%08X" % number
            yield codec.frame(address, index, 0), Answer(*asked)
    for spelling in (
        Answer(b"05", b"0", b"00000007", xon=b"\x11"), Answer(b"05", b"2", b"12345678"),
        Answer(b"05", b"8", b"1234567F", b"014"),
    ):  # fmt: skip
        index = 0x23 if spelling.digit == b"2" else 0x20 + int(spelling.digit)
        yield codec.frame(5, index, 0), spelling


def readings_of(one: Answer) -> dict[str, str]:
    """What is known of the module that answers so."""
    digit = one.digit.decode() if one.digit in b"23" else "3"
    known = {"xon_byte": f"{one.xon.hex().upper()}h", "reply23_digit": digit}
    return known | {"reply28_length": one.length.decode()}


def test_a_sound_answer_has_no_departure() -> None:
    """In any reading of the manual."""
    for request, one in answers():
        read = lenient(request, one.put())
        assert read is not None
        assert read.departures == ()
        assert read.mended == one.put()


@pytest.mark.parametrize("table", [framing, fields, sums, whole], ids=lambda one: one.__name__)
def test_each_departure_of_an_answer_is_named_and_mended(table: object) -> None:
    """One name each; where two departures give the same bytes, one of theirs."""
    for request, one in answers():
        same: dict[bytes, set[tuple[str, str]]] = defaultdict(set)
        for every in (framing, fields, sums, whole):
            for requirement, name, came, _ in every(one):
                same[came].add((requirement, name))
        assert callable(table)
        for requirement, name, came, is_mended in table(one):
            read = lenient(request, came, readings_of(one))
            told = f"{requirement} {name}: {came!r} to {request!r}"
            assert read is not None, told
            assert len(read.departures) == 1, f"{told}: {read.departures}"
            seen = read.departures[0]
            assert (seen.requirement, seen.name) in same[came], f"{told}: {seen}"
            assert read.mended == (one.put() if is_mended else b""), f"{told}: {read}"
            assert seen.expected != seen.actual


COMMANDS: dict[bytes, tuple[str, str, bytes]] = {
    bytes.fromhex("06 1A"): ("MACS-LINE-02", "Xoff", ACCEPTED),
    bytes.fromhex("06 17"): ("MACS-LINE-02", "Xoff", REFUSED),
    bytes.fromhex("13 1A"): ("MACS-REPLY-01", "acknowledgement", ACCEPTED),
    bytes.fromhex("15 13 1A"): ("MACS-REPLY-01", "acknowledgement", ACCEPTED),
    bytes.fromhex("06 14 17"): ("MACS-REPLY-01", "Xoff", REFUSED),
    bytes.fromhex("06 13 19"): ("MACS-REPLY-01", "Xon", b""),
    bytes.fromhex("06 13"): ("MACS-REPLY-01", "completeness", b""),
    bytes.fromhex("06 93 17"): ("MACS-LINE-01", "data bits", REFUSED),
    bytes.fromhex("1A 06 13"): ("MACS-REPLY-01", "order", ACCEPTED),
    bytes.fromhex("13 06 17"): ("MACS-REPLY-01", "order", REFUSED),
    bytes.fromhex("06 13 1A 06 13 1A"): ("MACS-REPLY-12", "number", ACCEPTED),
    bytes.fromhex("06 13 1A 55"): ("MACS-REPLY-12", "surplus", ACCEPTED),
    bytes.fromhex("00 06 13 17"): ("MACS-REPLY-12", "surplus", REFUSED),
    bytes.fromhex("15"): ("MACS-REPLY-01", "form", b"\x15"),
    Answer(b"05", b"8", b"00000000").put(): ("MACS-REPLY-01", "form", ACCEPTED),
}


@pytest.mark.parametrize("came", COMMANDS, ids=lambda one: one.hex(" "))
def test_each_departure_of_a_short_reply_is_named_and_mended(came: bytes) -> None:
    """To a command."""
    requirement, name, mended = COMMANDS[came]
    read = lenient(codec.frame(5, COMMAND, 0), came)
    assert read is not None
    assert [(one.requirement, one.name) for one in read.departures] == [(requirement, name)]
    assert read.mended == mended


@pytest.mark.parametrize("came", [ACCEPTED, REFUSED, b"\x06\x13\x11", b"\x06\x13\x18"])
def test_an_acknowledgement_is_sound_after_a_command_and_no_answer_to_a_query(came: bytes) -> None:
    """In any reading; and a query with a parameter may be refused."""
    told = lenient(codec.frame(5, COMMAND, 0), came)
    assert told is not None
    assert (told.departures, told.mended) == ((), came)
    told = lenient(codec.frame(5, 0x24, 0), came)
    assert told is not None
    assert [(one.requirement, one.name) for one in told.departures] == [("MACS-REPLY-07", "form")]
    asked = lenient(codec.frame(5, 0x24, 1), came)
    assert asked is not None
    assert bool(asked.departures) is (codec.parse(came).kind is ReplyKind.ACCEPTED)


def test_swallowed_flow_control_is_two_departures() -> None:
    """Who swallows 13h and 11h leaves the 06 of an acknowledgement, and more of an answer."""
    short = lenient(codec.frame(5, COMMAND, 0), b"\x06")
    assert short is not None
    assert [one.name for one in short.departures] == ["Xoff", "Xon"]
    assert short.mended == b"\x06\x13\x11"
    one = Answer(b"05", b"0", b"00000007", xon=b"\x11")
    came = one.put(head=b"\x06\x02", xon=b"")
    read = lenient(codec.frame(5, 0x20, 0), came, {"xon_byte": "11h"})
    assert read is not None
    assert {told.requirement for told in read.departures} == {"MACS-LINE-02"}
    assert read.mended == one.put()


def test_the_bytes_of_the_speeds_in_the_other_order_are_seen() -> None:
    """The only answer with a byte that is always 00 (MACS-Q-25-01)."""
    one = Answer(b"05", b"5", b"0A000320")
    turned = Answer(b"05", b"5", b"2003000A")
    read = lenient(codec.frame(5, 0x25, 0), turned.put())
    assert read is not None
    assert [(told.requirement, told.name) for told in read.departures] == [
        ("MACS-FRAME-05", "byte order")
    ]
    assert read.mended == one.put()


@pytest.mark.parametrize(("after_ns", "count"), [(400_000_000, 0), (700_000_000, 1)])
def test_who_acknowledges_when_the_motion_is_over_departs(after_ns: int, count: int) -> None:
    """And who takes his time to answer a query does not: no reply time is specified."""
    read = lenient(codec.frame(5, 0x13, 1000), ACCEPTED, {}, after_ns)
    assert read is not None
    assert [one.requirement for one in read.departures] == ["MACS-REPLY-14"] * count
    assert read.mended == ACCEPTED
    slow = lenient(codec.frame(5, 0x20, 0), Answer(b"05", b"0", b"00000000").put(), {}, after_ns)
    assert slow is not None
    assert slow.departures == ()


def test_the_sum_tells_what_it_covers() -> None:
    """In words, for whoever has to find the mistake."""
    one = Answer(b"05", b"0", b"000003E8")
    for value, words in (
        (sum(one.length + one.body), "of the length field too"),
        (sum(one.body[2:]), "without the address"), (-sum(one.body), "negated"),
    ):  # fmt: skip
        read = lenient(codec.frame(5, 0x20, 0), one.put(check=b"%02X" % (value % 256)))
        assert read is not None
        assert read.departures[0].actual == f"{value % 256:02X}, {words}"


REQUEST = codec.frame(5, 0x24, 0)
STRANGERS = {
    "silence": b"",
    "echo": REQUEST,
    "echo and an answer": REQUEST + Answer(b"05", b"4", b"00000000").put(),
    "a banner": b"ERR 1: unknown command\r\n",
    "a prompt": b"> ",
    "a packet of a motion controller": bytes.fromhex("02 01 00 0D 00 00 44 57 52 49 54 45 2C"),
    "its acknowledgement": b"\x06",
    "a binary protocol": b"\xa5\x5a\x80\x00\x01",
    "a register protocol": bytes.fromhex("01 03 04 00 00 12 34 F6 84"),
    "its ASCII form": b":010304000012346D\r\n",
    "a receiver of satellites": b"$GPGGA,092750.000,5321.6802,N,00630.3372,W,1,8,1.03*76\r\n",
    "a module at another rate": bytes.fromhex("80 78 00 F8 80 80 78 F8"),
    "a flood": ACCEPTED * 1000,
}


@pytest.mark.parametrize("name", STRANGERS)
def test_what_is_no_reply_is_none(name: str) -> None:
    """Silence, what comes back, and other protocols."""
    assert lenient(REQUEST, STRANGERS[name]) is None


def test_the_reply_to_an_unsound_request_is_not_read() -> None:
    """Anything may come of it."""
    sound = Answer(b"05", b"4", b"00000000").put()
    for request in (b"", REQUEST[:-1], REQUEST[:18] + b"00\x03", b"\x06\x13\x1a", REQUEST.lower()):
        assert lenient(request, sound) is None or request == REQUEST


def test_random_bytes_are_no_reply() -> None:
    """But for a Nack, which is one byte."""
    chance = random.Random(14)
    for _ in range(2000):
        came = chance.randbytes(chance.randrange(1, 40))
        request = codec.frame(5, chance.choice((0x24, COMMAND)), 0)
        assert lenient(request, came) is None or came in (b"\x15", b"\x06")


@settings(max_examples=300)
@given(
    index=st.integers(0, 0xFF),
    reply=st.lists(
        st.sampled_from(b"0123456789ABCDEFabcdef\x02\x03\x06\x13\x1a\x11\x15,\r\x80\xff")
    ),
)
def test_nothing_that_comes_makes_it_fall_over(index: int, reply: list[int]) -> None:
    """What it makes of a reply a module could have sent: at most so many departures."""
    read = lenient(codec.frame(5, index, 0), bytes(reply))
    if read is not None:
        assert len(read.departures) <= MOST_DEPARTURES
        assert codec.parse(read.mended).kind is not ReplyKind.GARBAGE


def test_no_byte_of_a_reply_makes_it_fall_over() -> None:
    """Whatever stands in its place, or if it is missing, or comes twice."""
    request, sound = codec.frame(5, 0x27, 0), Answer(b"05", b"7", b"00000007").put()
    for reply, at in [(one, at) for one in (sound, ACCEPTED) for at in range(len(one))]:
        before, behind = reply[:at], reply[at + 1 :]
        for put in (b"", reply[at : at + 1] * 2, b"\0", b"G", b"g", b"\x15", b"\x80", b"\xa4"):
            came = before + put + behind
            read = lenient(request, came)
            assert read is None or read.departures or read.mended == came


def test_of_a_beginning_no_more_is_handed_on_than_has_come() -> None:
    """Whoever has read a whole reply sends the next request, into the rest of this one."""
    request, sound = codec.frame(5, 0x20, 0), Answer(b"05", b"0", b"00000007").put()
    short = codec.frame(5, 0x24, 0), Answer(b"05", b"4", b"00000704", length=b"01").put()
    departing = lenient(*short)
    assert departing is not None
    known = {one.key: one for one in departing.departures}
    one = Mending(lenient, lambda _: True, known)
    one.begin(request)
    handed = b""
    for count, byte in enumerate(sound, 1):
        handed += one.hear(bytes([byte]))
        assert len(handed) <= count
    assert handed == sound
