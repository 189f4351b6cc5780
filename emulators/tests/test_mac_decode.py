"""Frames in words, either direction; anything else as hex."""

import random

import pytest

from axistwin import catalog, testing
from axistwin.devices.mac.serial.decode import explain
from axistwin.devices.mac.serial.framing import answer, request
from axistwin.runtime.transcript import Transcript


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (request(0, 0x13, 10_000), "13h go to position 10000 -> module 0"),
        (request(5, 0x13, -1), "13h go to position -1 -> module 5"),
        (request(0, 0x15, 0x00F60320), "15h velocity -, period 800 -> module 0"),
        (request(0, 0x15, 0), "15h velocity 0: stop -> module 0"),
        (request(0xFF, 0x11), "11h synchronise -> all modules"),
        (request(1, 0x1E, 0x03E81000), "1Eh virtual segment 1000 steps at period 4096 -> module 1"),
        (request(1, 0x16, 0xFFFF1000), "16h segment -1 steps at period 4096 -> module 1"),
        (request(0, 0x20), "20h position? -> module 0"),
        (request(0, 0x28, 0, 0xAF), "28h RAM? at AFh -> module 0"),
        (request(0, 0x12), "12h (unassigned) -> module 0"),
        (request(0, 0x1B, 1), "1Bh 9600 baud -> module 0"),
        (request(0, 0x03, 9), "03h hardware, software stops -> module 0"),
    ],
)
def test_a_request_is_told_in_words(frame: bytes, words: str) -> None:
    """Index, meaning, module."""
    assert explain(frame) == words


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ("mac23", "temperature 25.0 °C (60h), supply 24.0 V (73h)"),
        ("mac34-1", "temperature 95.2 °C (60h), supply 46.0 V (73h)"),
        ("mac34-2", "temperature 95.2 °C (60h), supply 92.0 V (73h)"),
    ],
)
def test_measures_are_told_in_the_units_of_the_model(model: str, words: str) -> None:
    """Each has scales of its own; on a line with several, only the bytes are sure."""
    reply = answer(b"00", b"7", 0x60730860)
    assert words in catalog.find_model(model).explain(reply)
    with testing.start(f"{model}:0", f"{model}:1", time="virtual") as line:
        transcript = line.line.transcript
        assert isinstance(transcript, Transcript)
        transcript.add(0, "device", reply)
        assert words in line.transcript
    other = "mac23" if model != "mac23" else "mac34-1"
    with testing.start(f"{model}:0", f"{other}:1", time="virtual") as line:
        transcript = line.line.transcript
        assert isinstance(transcript, Transcript)
        transcript.add(0, "device", reply)
        assert "temperature 60h, supply 73h, " in line.transcript


@pytest.mark.parametrize(
    ("reply", "words"),
    [
        (b"\x06\x13\x1a", "accepted"),
        (b"\x06\x13\x17", "refused"),
        (b"\x15", "Nack"),
        (answer(b"05", b"0", 0xFFFFFC18), "20h position = -1000 (module 5)"),
        (answer(b"FF", b"0", 7), "20h position = 7 (general)"),
        (answer(b"00", b"1", 0x10020080), "21h status = 10 02 00 80 (module 0)"),
        (answer(b"00", b"5", 0x05000320), "25h speeds = catch-up 5, period 800 (module 0)"),
        (
            answer(b"00", b"6", 0x0A601900),
            "26h modes = ramp 10, torque 60h, mode 19h, tolerance 0 (module 0)",
        ),
        (
            answer(b"00", b"7", 0x60732860),
            (
                "27h measures = temperature 60h, supply 73h, not busy, "
                "positive stop, negative stop, reference (module 0)"
            ),
        ),
    ],
)
def test_a_reply_is_told_in_words(reply: bytes, words: str) -> None:
    """The three short ones, Nack, and answers with their values."""
    assert explain(reply) == words


def test_a_wrong_sum_is_pointed_out() -> None:
    """With the right one."""
    frame = request(0, 0x20)
    assert explain(frame[:18] + b"00\x03") == (
        "20h position? -> module 0 [checksum wrong, A2 is right]"
    )


def test_frames_in_a_row_and_garbage_between_them() -> None:
    """Each frame told, the rest as hex."""
    data = b"\xff\x00" + request(0, 0x19) + b"\x06\x13\x1a" + b"\x02\x30"
    told = "02 30 [incomplete: 19 of 21 bytes are missing]"
    assert explain(data) == f"FF 00; 19h motor on -> module 0; accepted; {told}"
    assert explain(b"") == ""


def test_a_frame_that_breaks_off_is_told_with_what_is_missing() -> None:
    """Requests and answers, wherever they end or have lost a byte; short replies by their bytes."""
    for frame in (request(5, 0x13, -1), answer(b"05", b"0", 0xFFFFFC18)):
        for count in range(3, 21):
            verb = "is" if count == 20 else "are"
            told = f"[incomplete: {21 - count} of 21 bytes {verb} missing]"
            assert explain(frame[:count]) == f"{frame[:count].hex(' ').upper()} {told}"
        assert explain(frame[:9] + frame[10:]).endswith("[incomplete: 1 of 21 bytes is missing]")
        assert explain(frame[:9] + frame).startswith(explain(frame[:9]) + "; ")
        assert explain(b"\xff" + frame[:9]).endswith("[incomplete: 12 of 21 bytes are missing]")
    assert explain(b"\x02") == "02 [incomplete: 20 of 21 bytes are missing]"
    assert explain(b"\x06") == "06 [incomplete: Xoff is missing, and what follows it]"
    assert explain(b"\x06\x13") == "06 13 [incomplete: Xon, Xonerror or an answer is missing]"
    assert explain(b"\xff\x06\x13") == "FF 06 13"
    assert explain(request(5, 0x13)[:12] * 2).count("9 of 21 bytes are missing") == 2


def test_no_bytes_make_it_fail() -> None:
    """20 000 random and damaged bytes."""
    chance = random.Random(11)
    for _ in range(200):
        frame = bytearray(request(0, chance.randrange(256), chance.getrandbits(32)))
        frame[chance.randrange(21)] = chance.randrange(256)
        assert explain(bytes(frame))
        assert explain(chance.randbytes(100))


def test_every_assigned_index_has_a_name() -> None:
    """No command or query of the ledger is told as unassigned."""
    assigned = {*range(0x2A)} - {0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F}
    for index in range(0x30):
        assert ("(unassigned)" in explain(request(0, index))) == (index not in assigned)
