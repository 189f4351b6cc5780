"""Frames of a CAN bus in words."""

import random

import pytest

from axistwin.devices.mac.can.decode import explain_frame
from axistwin.wire.can_frame import CanFrame


@pytest.mark.parametrize(
    ("identifier", "data", "words"),
    [
        (0x601, "4000200000000000", "2000h position? -> module 1"),
        (0x600, "2310200000000000", "2010h wait for synchronisation -> all modules"),
        (0x603, "23132000FFFFFC18", "2013h go to position -1000 -> module 3"),
        (0x601, "2308200000000005", "2008h (unassigned) -> module 1"),
        (0x601, "4008200000000000", "2008h (unassigned)? -> module 1"),
        (0x601, "2300100000000000", "1000h (unassigned) -> module 1"),
        (0x601, "2F00200500000000", "2000h sub-index 05h by command byte 2Fh -> module 1"),
        (0x601, "40", "request of 1 byte -> module 1 [8 are right]"),
        (0x601, "40002000", "request of 4 bytes -> module 1 [8 are right]"),
        (0x581, "42002000FFFFFC18", "2000h position = -1000 (module 1)"),
        (0x581, "43002000000003E8", "2000h position = 1000 (module 1)"),
        (0x583, "6013200000000000", "2013h accepted (module 3)"),
        (0x583, "8013200000000000", "2013h refused (module 3)"),
        (0x583, "8013200022000008", "2013h refused, abort code 08000022h (module 3)"),
        (0x583, "8013", "reply of 2 bytes (module 3) [8 are right]"),
        (0x701, "00", "boot-up (module 1)"),
        (0x081, "2032052000000000", "emergency 3220h, status 20 00 00 00 (module 1)"),
        (0x0FF, "0000000000000000", "lifebeat, no error (module 127)"),
        (0x081, "", "emergency without data (module 1)"),
        (0x081, "203205", "emergency of 3 bytes (module 1) [8 are right]"),
        (0x081, "00", "emergency of 1 byte (module 1) [8 are right]"),
        (0x080, "", "SYNC: synchronise -> all modules"),
        (0x7E5, "0401", "address procedure: begin"),
        (0x7E5, "1155", "address procedure: address 85"),
        (0x7E5, "0400", "address procedure: take over"),
        (0x7E5, "17", "address procedure: unknown service"),
        (0x7E5, "04", "address procedure: request of 1 byte [2 at least are right]"),
        (0x7E5, "11", "address procedure: request of 1 byte [2 at least are right]"),
        (0x7E4, "11", "address procedure: reply of 1 byte [2 at least are right]"),
        (0x7E4, "1100000000000000", "address procedure: address taken"),
        (0x7E4, "1101000000000000", "address procedure: refused"),
        (0x123, "00", ""),
        (0x700, "", ""),
    ],
)
def test_a_frame_is_told_in_words(identifier: int, data: str, words: str) -> None:
    """Object, meaning, module."""
    assert explain_frame(CanFrame(identifier, bytes.fromhex(data))) == words


def test_what_no_module_hears_is_told_as_such() -> None:
    """Extended and remote frames (MACC-ID-02)."""
    assert explain_frame(CanFrame(0x601, is_extended=True)) == "ignored: extended frame"
    assert explain_frame(CanFrame(0x601, is_remote=True)) == "ignored: remote frame"


def test_no_frame_is_too_strange() -> None:
    """Any identifier with any data has one line, perhaps an empty one."""
    seeded = random.Random(7)
    for identifier in range(0x800):
        data = seeded.randbytes(seeded.randrange(9))
        assert "\n" not in explain_frame(CanFrame(identifier, data))
