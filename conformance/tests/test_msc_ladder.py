"""A unit that answers the engine itself wrongly, in whatever way: judged by that, and by the rest.

`spoil` of the twin's port turns what the unit sends; each thing is wrong every time.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import pytest
from msc_twin import TwinPort, session_on, target_of

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.lenient import COMPLETENESS, Lenient, Mending, ReplyDeparture
from axistwin_conformance.engine.result import RequirementResult, Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, STX
from axistwin_conformance.families.msc.replies.lenient import lenient

pytestmark = pytest.mark.strength

Turn = Callable[[bytes], bytes]
FAIL = Verdict.FAIL
IDS = ("MSC-RQSTAT-02", "MSC-DREAD-02", "MSC-CMD-04", "MSC-RFLAG-02", "MSC-PKT-12", "MSC-LNK-09")


def summed(raw: bytes, value: int | None = None) -> bytes:
    """The packet under its right sum, or under another."""
    return raw[:-2] + codec.u16(codec.checksum(raw[1:-2]) if value is None else value)


def xored(raw: bytes) -> int:
    """Another idea of a sum."""
    value = 0
    for byte in raw[1:-2]:
        value ^= byte
    return value


def body_of(raw: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """The packet with another body, sound in all else."""
    return codec.packet(raw[1], change(raw[6:-2]))


def named(name: bytes, change: Callable[[bytes], bytes]) -> Turn:
    """What becomes of the packets of one command."""
    return lambda raw: change(raw) if raw[6:].startswith(name + b",") else raw


WRONG: dict[str, tuple[Turn, str]] = {
    "start byte 03": (lambda raw: b"\x03" + raw[1:], "MSC-PKT-02"),
    "no start byte": (lambda raw: raw[1:], "MSC-PKT-02"),
    "no block number": (lambda raw: raw[:4] + raw[6:], "MSC-PKT-01"),
    "unit 2": (lambda raw: summed(raw[:1] + b"\x02" + raw[2:]), "MSC-PKT-18"),
    "unit 0": (lambda raw: summed(raw[:1] + b"\x00" + raw[2:]), "MSC-PKT-18"),
    "length counts the header": (
        lambda raw: summed(raw[:2] + codec.u16(len(raw) - 2) + raw[4:]), "MSC-PKT-06",
    ),
    "length leaves the comma out": (
        lambda raw: summed(raw[:2] + codec.u16(len(raw) - 9) + raw[4:]), "MSC-PKT-06",
    ),
    "length low byte first": (
        lambda raw: summed(raw[:2] + raw[3:4] + raw[2:3] + raw[4:]), "MSC-PKT-08",
    ),
    "sum over the start byte": (lambda raw: summed(raw, sum(raw[:-2])), "MSC-PKT-12"),
    "sum without the unit": (lambda raw: summed(raw, sum(raw[2:-2])), "MSC-PKT-12"),
    "sum over the body": (lambda raw: summed(raw, sum(raw[6:-2])), "MSC-PKT-12"),
    "sum of eight bits": (lambda raw: summed(raw, sum(raw[1:-2]) & 0xFF), "MSC-PKT-12"),
    "sum in two's complement": (lambda raw: summed(raw, -sum(raw[1:-2])), "MSC-PKT-12"),
    "sum by exclusive or": (lambda raw: summed(raw, xored(raw)), "MSC-PKT-12"),
    "sum low byte first": (lambda raw: raw[:-2] + raw[:-3:-1], "MSC-PKT-11"),
    "sum in digits": (lambda raw: raw[:-2] + raw[-2:].hex().upper().encode(), "MSC-PKT-11"),
    "sum in one byte": (lambda raw: raw[:-2] + raw[-1:], "MSC-PKT-11"),
    "no sum": (lambda raw: raw[:-2], "MSC-PKT-11"),
    "no comma": (lambda raw: body_of(raw, lambda body: body.replace(b",", b"", 1)), "MSC-CMD-04"),
    "semicolon": (lambda raw: body_of(raw, lambda body: body.replace(b",", b";", 1)), "MSC-CMD-04"),
    "status of two bytes": (
        named(b"RQSTAT", lambda raw: body_of(raw, lambda body: body[:9])), "MSC-RQSTAT-01",
    ),
    "status of twelve bytes": (
        named(b"RQSTAT", lambda raw: body_of(raw, lambda body: body + bytes(4))), "MSC-RQSTAT-01",
    ),
    "flag on is FFFF": (
        named(b"RFLAG", lambda raw: body_of(raw, lambda body: body[:6] + b"\xff\xff")),
        "MSC-RFLAG-02",
    ),
    "flag in digits": (
        named(b"RFLAG", lambda raw: body_of(raw, lambda body: body[:6] + b"0" + b"%d" % body[7])),
        "MSC-RFLAG-02",
    ),
    "another name": (
        lambda raw: body_of(raw, lambda body: b"X" + body[1:]), "MSC-CMD-04",
    ),
    "name with a letter twice": (lambda raw: raw[:8] + raw[7:], "MSC-CMD-04"),
    "name without a letter": (lambda raw: raw[:7] + raw[8:], "MSC-CMD-04"),
    "a letter of the name in lower case": (
        lambda raw: raw[:7] + raw[7:8].lower() + raw[8:], "MSC-CMD-04",
    ),
    "cut short": (lambda raw: raw[:5], "MSC-PKT-01"),
    "no packet": (lambda raw: b"", "MSC-CMD-05"),
}  # fmt: skip
SIGNS: dict[str, tuple[bytes, str]] = {
    "no ACK": (b"", "MSC-LNK-01"),
    "another sign": (b"\x0b", "MSC-LNK-01"),
    "ACK twice": (ACK + ACK, "MSC-LNK-04"),
    "eight bytes behind ACK": (ACK + bytes(8), "MSC-LNK-01"),
}


def of_packets(turn: Turn) -> Turn:
    """What becomes of packets; signs stay."""
    return lambda data: data if len(data) == 1 else turn(data)


def of_signs(instead: bytes) -> Turn:
    """What is said for ACK."""
    return lambda data: instead if data == ACK else data


def behind() -> Turn:
    """The ACK comes behind the packet."""
    return lambda data: data + ACK if data[:1] == STX else b"" if data == ACK else data


TURNS = {name: (of_packets(turn), wanted) for name, (turn, wanted) in WRONG.items()}
TURNS |= {name: (of_signs(sign), wanted) for name, (sign, wanted) in SIGNS.items()}
TURNS["ACK behind"] = behind(), "MSC-LNK-07"
UNMENDABLE = {"another name", "cut short", "no packet"}
# What else is wrong with it, or is seen of it where a check reads what nobody has mended.
ALSO = {
    "no block number": {"MSC-LNK-12"},  # a shorter packet is over sooner
    "sum in digits": {"MSC-LNK-01", "MSC-LNK-12"},
    "sum in one byte": {"MSC-LNK-12"},
    "no sum": {"MSC-LNK-12"},
    "status of two bytes": {"MSC-CMD-12"},
    "status of twelve bytes": {"MSC-CMD-12"},
    "ACK behind": {"MSC-LNK-10", "MSC-LNK-11", "MSC-LNK-12"},  # also behind a repeat
}


def judged(turn: Turn, *, is_lossless: bool) -> Result:
    """A passive run over a line with that unit."""
    port = TwinPort(has_rflags=False)
    port.data = {address: address * 77_777 + 1 for address in range(0, 4096, 4)}
    port.flags = {0, 130}
    port.spoil = turn
    options = make_options(
        model="msc-generic", port="/dev/ttyUSB0", variables=range(2048, 3072), ids=IDS,
        level="quick",
    )  # fmt: skip
    engine = Engine(options, lambda neighbours: target_of(port, is_lossless=is_lossless))
    return engine.run(lambda event: None)


def failed(result: Result) -> set[str]:
    """The requirements that failed."""
    return {one.requirement.id for one in result.requirements if one.verdict is FAIL}


def of(result: Result, name: str) -> RequirementResult:
    """What came of one requirement."""
    return next(one for one in result.requirements if one.requirement.id == name)


@pytest.mark.parametrize("is_lossless", [True, False])
@pytest.mark.parametrize("name", TURNS)
def test_a_unit_wrong_in_one_thing_fails_that_and_is_judged_in_the_rest(
    name: str, is_lossless: bool
) -> None:
    """Exit 1 with that requirement alone; what rests on unreadable replies is not run, because."""
    turn, requirement = TURNS[name]
    result = judged(turn, is_lossless=is_lossless)
    assert result.exit_status == 1, result.sentence
    assert requirement in failed(result)
    if name not in UNMENDABLE:
        assert failed(result) - ALSO.get(name, set()) == {requirement}
        assert of(result, "MSC-LNK-09").verdict is Verdict.PASS
    elif not is_lossless:
        assert of(result, "MSC-LNK-09").verdict is Verdict.NOT_RUN
        assert f"because {requirement} fails: " in of(result, "MSC-LNK-09").reason


def seven_bits(raw: bytes) -> bytes:
    """What a line of seven bits leaves of it."""
    return bytes(byte & 0x7F for byte in raw)


@pytest.mark.parametrize("is_lossless", [True, False])
def test_a_line_of_seven_bits_is_a_failure(is_lossless: bool) -> None:
    """The status goes through it unharmed, so that it is met amid the readings."""
    result = judged(of_packets(seven_bits), is_lossless=is_lossless)
    assert result.exit_status == 1, result.sentence
    assert failed(result)


@pytest.mark.parametrize("after", range(1, 12, 3))
def test_a_unit_that_departs_from_some_reply_on_is_judged(after: int) -> None:
    """Whatever the engine is about to learn then: who it is, how long an exchange takes."""
    signs: list[bytes] = []

    def later(data: bytes) -> bytes:
        signs.extend([data] * (data == ACK))
        return data * 2 if len(signs) > after else data

    result = judged(later, is_lossless=False)
    assert result.exit_status == 1, result.sentence
    assert "MSC-LNK-04" in failed(result)


@pytest.mark.parametrize("says", [b"ERROR 7\r\n", b"\x06\x13\x17", b"\x99" * 30, NAK])
def test_another_protocol_is_none_of_a_failing_unit(says: bytes) -> None:
    """Exit 3, as for silence: nothing of it is this protocol's."""
    result = judged(lambda data: says if data == ACK else b"", is_lossless=False)
    assert result.exit_status == 3, result.sentence
    assert failed(result) == set()


def test_bytes_that_differ_each_time_are_noise() -> None:
    """A sum that is wrong in another way with every packet accuses nobody."""
    draw = random.Random(1)

    def spoilt(raw: bytes) -> bytes:
        return raw[:-2] + codec.u16(draw.randrange(1 << 16))

    result = judged(of_packets(spoilt), is_lossless=False)
    assert failed(result) == set()
    assert result.exit_status == 3


# --- what cannot be read is not written -----------------------------------------------------------


@pytest.mark.parametrize("is_lossless", [True, False])
@pytest.mark.parametrize(
    ("model", "name", "number"),
    [("msc-250", "BREAD", 1280), ("msc-generic", "RFLAG", 134), ("msc-generic", "BREAD", 1024)],
)
def test_a_refused_read_of_what_is_to_be_put_back_is_judged_and_left_alone(
    model: str, name: str, number: int, is_lossless: bool
) -> None:
    """The rest of what was named is used; nothing is written to what was not told."""
    port = TwinPort(has_rflags=model == "msc-250")
    served, written = port.served, set()

    def refusing(one: codec.Packet) -> bytes | None:
        if one.name in ("DWRITE", "BWRITE", "SFLAG", "CFLAG"):
            written.add(one.numbers[0])
        return None if (one.name, one.numbers[:1]) == (name, (number,)) else served(one)

    port.served = refusing
    options = make_options(
        model=model, port="/dev/ttyUSB0", variables=range(1024, 2048), flags=range(128, 140),
        allow="stored", level="quick", ids=("MSC-DWRITE-02", "MSC-BWRITE-02", "MSC-SFLAG-02"),
    )  # fmt: skip
    engine = Engine(options, lambda neighbours: target_of(port, is_lossless=is_lossless))
    result = engine.run(lambda event: None)
    assert result.exit_status == 1, result.sentence
    assert failed(result) == {"MSC-LNK-01"}
    assert of(result, "MSC-DWRITE-02").verdict is Verdict.PASS
    assert of(result, "MSC-SFLAG-02").verdict is Verdict.PASS
    assert written
    assert written.isdisjoint(range(number, number + 32) if name == "BREAD" else {number})


# --- readings that were taken for faults ----------------------------------------------------------


@pytest.mark.parametrize(
    "quirk",
    ["block_overrun=partial", "block_overrun=wrap", "status_tail=4", "rs232_unit_check=nak"],
)
@pytest.mark.parametrize("ids", [("MSC-LNK-19", "MSC-RQSTAT-01", "MSC-BREAD-05")])
def test_a_reading_that_the_manual_admits_is_no_failure_on_a_port(
    quirk: str, ids: tuple[str, ...]
) -> None:
    """Named or judged, and nothing is written where nothing was named."""
    switch, value = quirk.split("=")
    readings: dict[str, Any] = {switch: value}
    port = TwinPort(program=True, **readings)
    options = make_options(
        model="msc-250", port="/dev/ttyUSB0", variables=range(1024, 5120), flags=range(128, 192),
        bench_program=(240, 6144), allow="motion,stored,rig", level="quick", ids=ids,
    )  # fmt: skip
    engine = Engine(options, lambda neighbours: target_of(port, is_lossless=False))
    result = engine.run(lambda event: None)
    assert result.problems == []
    assert result.exit_status == 0, result.sentence


# --- how replies are handed on --------------------------------------------------------------------

ASKED = codec.packet(1, codec.dread(8))
ANSWER = codec.packet(1, codec.body("DREAD", codec.i32(7)))


def mending(*replies: bytes) -> Mending:
    """One that knows what these depart by."""
    session = session_on(TwinPort())

    def read(request: bytes, reply: bytes) -> Lenient | None:
        return lenient(session, request, reply)

    known: dict[tuple[str, str], ReplyDeparture] = {}
    for reply in replies:
        found = read(ASKED, reply)
        assert found is not None
        known |= {one.key: one for one in found.departures}
    made = Mending(read, lambda request: request == ASKED, known)
    made.begin(ASKED)
    return made


LOW_FIRST = ANSWER[:-2] + ANSWER[:-3:-1]


def test_a_reply_is_handed_on_mended_as_soon_as_it_is_whole() -> None:
    """Its sign and its first byte when they come, the rest with its last byte."""
    one = mending(ACK + LOW_FIRST)
    handed = [one.hear(bytes([byte])) for byte in ACK + LOW_FIRST]
    assert handed == [ACK, STX, *[b""] * (len(ANSWER) - 2), ANSWER[1:]]
    assert not one.is_holding


def test_a_reply_that_departs_by_anything_else_is_handed_on_as_it_came() -> None:
    """A wrong sum hides no wrong unit."""
    one = mending(ACK + LOW_FIRST)
    other = codec.packet(2, codec.body("DREAD", codec.i32(7)))
    wrong = ACK + other[:-2] + other[:-3:-1]
    assert one.hear(wrong) + one.give_up() == wrong


def test_repeats_are_mended_as_well() -> None:
    """By a time-out behind the reply, or to a NAK."""
    one = mending(ACK + LOW_FIRST)
    assert one.hear(ACK + LOW_FIRST + LOW_FIRST) == ACK + ANSWER + ANSWER
    one.begin(NAK)
    assert one.hear(LOW_FIRST) == ANSWER


def test_what_is_no_reply_is_handed_on_at_once() -> None:
    """To a packet that a unit need not serve."""
    one = mending(ACK + LOW_FIRST)
    one.begin(codec.with_wrong_checksum(ASKED))
    assert one.hear(NAK) == NAK
    assert not one.is_holding


def test_a_sound_reply_departs_by_nothing() -> None:
    """In any reading of the manual, of every command."""
    session = session_on(TwinPort())
    sound = [
        (codec.dread(8), ACK + ANSWER),
        (codec.dread(8), NAK),
        (codec.dwrite(8, 1), ACK),
        (codec.dwrite(8, 1), ACK + codec.packet(1, codec.body("DWRITE"))),
        (codec.RQSTAT, ACK + codec.packet(1, codec.body("RQSTAT", codec.u16(65), bytes(6)))),
        (codec.RQSTAT, ACK + codec.packet(1, codec.body("RQSTAT", codec.u16(65), bytes(4)), 9)),
        (codec.rflag(1), ACK + codec.packet(1, codec.body("RFLAG", codec.u16(1)))),
        (codec.RFLAGS, ACK + codec.packet(1, codec.body("RFLAGS", bytes(range(224, 256))))),
        (codec.bread(0), ACK + codec.packet(1, codec.body("BREAD", b"\x02\x06\x15," * 32))),
    ]
    for body, reply in sound:
        assert lenient(session, codec.packet(1, body), reply) == Lenient((), reply)
    assert lenient(session, ASKED, b"") is None
    found = lenient(session, ASKED, ACK)
    assert found is not None
    assert [one.name for one in found.departures] == [COMPLETENESS]
