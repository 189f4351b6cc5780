"""The lenient grammar of the bus: each departure is named, and mended; nothing else is taken for a
reply."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.core.lenient import Lenient
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.lenient import lenient
from axistwin_conformance.transport.can_frame import Frame

ADDRESSES = (1, 2, 0x40, 0x7F)
NUMBERS = (0x740001AB, 0, 1, 0xFFFFFFFF, 0x03E81000)
LIFEBEAT = Frame(0x081, bytes(8))
REASON = bytes.fromhex("22 00 00 08")  # a reason of the standard for a refusal

Made = tuple[str, str, tuple[Frame, ...], bool]  # requirement, name, what comes, whether mended


def read(
    request: CanRequest, *frames: Frame, after_ns: int = 0, spelling: str = "42h"
) -> Lenient | None:
    """What the grammar makes of these frames."""
    packed = b"".join(frame.pack() for frame in frames)
    return lenient(request.frame().pack(), packed, {"upload_scs": spelling}, after_ns)


def named(told: Lenient | None) -> list[tuple[str, str]]:
    """What departs."""
    assert told is not None
    return [(one.requirement, one.name) for one in told.departures]


def reply(request: CanRequest, command: int, data: bytes = codec.ZEROS) -> Frame:
    """The sound reply that begins so."""
    head = bytes([command, request.index_low, request.index_high, request.sub_index])
    return Frame(codec.REPLY + (request.address or 1), head + data)


def exchanges() -> Iterator[tuple[CanRequest, Frame]]:
    """Requests, and every reply of a sound module."""
    for address in ADDRESSES:
        for index in codec.UPLOADS:
            for number in NUMBERS:
                for command in codec.ANSWER_SPELLINGS:
                    request = codec.request(address, index)
                    yield request, reply(request, command, number.to_bytes(4, "big"))
        for index in codec.DOWNLOADS:
            request = codec.request(address, index, 7)
            yield request, reply(request, codec.ACCEPTED)
            yield request, reply(request, codec.REFUSED)
            yield request, reply(request, codec.REFUSED, REASON)
        request = codec.request(address, 0x20, 0, 3)
        yield request, reply(request, 0x42, bytes(4))


def departures(request: CanRequest, sound: Frame) -> Iterator[Made]:
    """All in which one frame can be wrong, one thing each."""
    is_upload = request.command == codec.UPLOAD
    form = "MACC-SDO-03" if is_upload else "MACC-SDO-01"
    data, own = sound.data, sound.identifier
    is_refusal = data[0] == codec.REFUSED

    def turned(*changes: tuple[int, int]) -> Frame:
        changed = bytearray(data)
        for at, value in changes:
            changed[at] = value
        return Frame(own, bytes(changed))

    for identifier in (own + 0x80, codec.REPLY, own ^ 1, 0x700 + request.address, 0x123):
        yield "MACC-ID-01", "identifier", (Frame(identifier, data),), True
    yield "MACC-ID-01", "form", (Frame(own, data, is_extended=True),), True
    for length in (4, 5, 7) if data[4:] != REASON else ():
        yield form, "length", (Frame(own, data[:length]),), not is_upload or is_refusal
    low, high, sub = data[1:4]
    if low != high:
        yield form, "byte order", (turned((1, high), (2, low)),), True
    yield form, "index", (turned((1, low ^ 0x10)),), True
    yield form, "index", (turned((2, 0x21)),), True
    yield form, "sub-index", (turned((3, sub + 1)),), True
    if is_upload and not is_refusal:
        for command in (0x4F, 0x4B, 0x47, 0x41):
            yield form, "command specifier", (turned((0, command)),), True
        yield form, "command specifier", (turned((0, 0x60)),), any(data[4:])
        yield form, "command specifier", (turned((0, 0x40)),), False
        done = turned((0, 0x60), (4, 0), (5, 0), (6, 0), (7, 0))
        yield "MACC-SDO-06", "number", (sound, done), True
        yield "MACC-SDO-06", "number", (done, sound), True
    else:
        yield form, "command specifier", (turned((0, data[0] + 1)),), True
        yield form, "command specifier", (turned((0, 0xE0)),), is_upload
    if data[0] == codec.ACCEPTED:
        yield form, "data", (turned((4, 1), (7, 9)),), True
    if is_refusal and not any(data[4:]):
        yield "MACC-SDO-02", "abort code", (turned((4, 8), (7, 0x22)),), True
    yield "MACC-SDO-06", "number", (sound, sound), True


def test_a_sound_reply_has_no_departure() -> None:
    """In any reading; what is said unasked, and what others say, stays beside it."""
    foreign = Frame(0x5A0, bytes.fromhex("43 00 10 00 91 01 0F 00"))
    for request, sound in exchanges():
        assert read(request, sound) == Lenient((), sound.pack())
        told = read(request, LIFEBEAT, sound, foreign)
        assert told == Lenient((), LIFEBEAT.pack() + sound.pack() + foreign.pack())


@pytest.mark.strength
def test_each_departure_is_named_and_mended() -> None:
    """One name each, and the frame of a sound module instead."""
    for request, sound in exchanges():
        for requirement, name, came, is_mended in departures(request, sound):
            told = read(request, *came, spelling=f"{sound.data[0]:02X}h")
            assert named(told) == [(requirement, name)], f"{came} to {request}: {told}"
            assert told is not None
            assert told.mended == (sound.pack() if is_mended else b""), f"{came} to {request}"
            for one in told.departures:
                assert one.expected != one.actual


@pytest.mark.strength
def test_a_byte_too_many_or_too_few_in_the_head_moves_what_is_behind_it() -> None:
    """It is one departure, of the form; what it has pushed out of the frame is not made up."""
    for request, sound in exchanges():
        if sound.data[4:] == REASON:
            continue
        is_upload = request.command == codec.UPLOAD
        form = "MACC-SDO-03" if is_upload else "MACC-SDO-01"
        data = sound.data
        for at in range(2):
            longer = Frame(sound.identifier, (data[:at] + data[at:][:1] + data[at:])[:8])
            told = read(request, longer, spelling=f"{data[0]:02X}h")
            assert told is not None, f"{longer} to {request}"
            assert {one.requirement for one in told.departures} == {form}
            assert told.mended in (b"", sound.pack())
        shorter = Frame(sound.identifier, data[1:])
        told = read(request, shorter, spelling=f"{data[0]:02X}h")
        assert told is not None, f"{shorter} to {request}"
        assert (form, "length") in named(told)
        assert told.mended in (b"", sound.pack())


def test_an_upload_that_is_refused_departs() -> None:
    """It is handed on as the refusal it is; with a sub-index a module may do so."""
    request = codec.request(1, 0x24)
    told = read(request, reply(request, codec.REFUSED))
    assert named(told) == [("MACC-SDO-03", "command specifier")]
    assert told is not None
    assert told.mended == reply(request, codec.REFUSED).pack()
    chosen = codec.request(1, 0x24, 0, 3)
    assert named(read(chosen, reply(chosen, codec.REFUSED))) == []


def test_the_reply_to_all_comes_from_module_1() -> None:
    """Under either identifier (MACC-AMB-03)."""
    request = codec.request(0, 0x20)
    sound = reply(request, 0x42)
    assert named(read(request, sound)) == []
    assert named(read(request, Frame(0x601, sound.data))) == []
    assert named(read(request, Frame(0x582, sound.data))) == [("MACC-ID-01", "identifier")]


@pytest.mark.parametrize(("after_ns", "count"), [(400_000_000, 0), (700_000_000, 1)])
def test_who_replies_when_the_motion_is_over_departs(after_ns: int, count: int) -> None:
    """And who takes his time over an upload does not."""
    request, upload = codec.request(1, 0x13, 1000), codec.request(1, 0x20)
    told = read(request, reply(request, codec.ACCEPTED), after_ns=after_ns)
    assert named(told) == [("MACC-SDO-13", "moment")] * count
    assert named(read(upload, reply(upload, 0x42), after_ns=after_ns)) == []


UPLOAD = codec.request(1, 0x24)
STRANGERS = {
    "silence": (),
    "echo": (UPLOAD.frame(),),
    "unasked": (LIFEBEAT, Frame(0x701, b"\0")),
    "another node of CANopen": (reply(UPLOAD, 0x80, bytes.fromhex("00 00 02 06")),),
    "another node's reply": (Frame(0x5A0, bytes.fromhex("43 00 10 00 91 01 0F 00")),),
    "another protocol": (Frame(0x18EAFF01, b"\x00\xee\x00", True),),
    "a remote frame": (Frame(0x581, is_remote=True, asked_length=8),),
    "an empty frame": (Frame(0x581),),
    "garbage": (Frame(0x581, bytes.fromhex("11 22 33 44 55 66 77 88")),),
    "forty at once": (Frame(0x581, b"\x60\x13\x20\x00" + bytes(4)),) * 40,
    "a babbler": (Frame(0x581, bytes.fromhex("42 20 20 00 12 34 56 78")),) * 9,
}


@pytest.mark.parametrize("name", STRANGERS)
def test_what_is_no_reply_is_none(name: str) -> None:
    """Silence, echo, others, and who never stops talking."""
    assert read(UPLOAD, *STRANGERS[name]) is None


def test_who_is_known_for_a_module_may_have_no_such_object() -> None:
    """Then it has failed; before that it is another node."""
    sent, came = UPLOAD.frame().pack(), STRANGERS["another node of CANopen"][0].pack()
    told = lenient(sent, came, is_identified=True)
    assert named(told) == [("MACC-SDO-03", "command specifier")]


def test_the_reply_to_an_unsound_request_is_not_read() -> None:
    """Anything may come of it."""
    sound = reply(UPLOAD, 0x42).pack()
    for request in (b"", b"\0", Frame(0x080).pack(), Frame(0x601, b"\x40\x04\x20").pack()):
        assert lenient(request, sound) is None


def test_random_frames_are_no_reply() -> None:
    """Whatever their identifier, that of replies included."""
    chance = random.Random(14)
    for _ in range(5000):
        identifier = chance.choice((0x581, chance.randrange(0x800)))
        frames = [Frame(identifier, chance.randbytes(chance.randrange(9))) for _ in range(2)]
        assert read(codec.request(1, chance.choice((0x24, 0x18))), *frames) is None


@settings(max_examples=300)
@given(index=st.integers(0, 0x2F), packed=st.binary(max_size=60))
def test_nothing_that_comes_makes_it_fall_over(index: int, packed: bytes) -> None:
    """Bytes that are no frames included."""
    request = codec.request(1, index).frame().pack()
    assert lenient(request, packed) is None or packed
