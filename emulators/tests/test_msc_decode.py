"""Bytes of an executive port in words."""

import random

import pytest
from msc_bench import bread, broken, bwrite, dread, dwrite, flag, rflags, rqstat

from axistwin.devices.msc.decode import explain
from axistwin.devices.msc.packets import packet


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x06", "ACK"),
        (b"\x15", "NAK"),
        (rqstat(), "RQSTAT (unit 1)"),
        (rqstat(6, block=0x1234), "RQSTAT (unit 6, block 1234h)"),
        (
            b"\x06" + packet(1, b"RQSTAT,\0\x41" + bytes(6)),
            "ACK; RQSTAT = 65 (running, auto_start) (unit 1)",
        ),
        (packet(1, b"RQSTAT," + bytes(8)), "RQSTAT = 0 (unit 1)"),
        (packet(1, b"RQSTAT," + bytes(6)), "RQSTAT = 0 (unit 1)"),
        (dread(2008), "DREAD at 2008? (unit 1)"),
        (packet(1, b"DREAD,\xff\xff\xff\xff"), "DREAD = -1 (unit 1)"),
        (dwrite(2008, 1234), "DWRITE at 2008: 1234 (unit 1)"),
        (bread(2048, 3), "BREAD at 2048? (unit 3)"),
        (bwrite(2048, range(1, 33)), "BWRITE at 2048: 1 2 3 4 and 28 more (unit 1)"),
        (packet(1, b"BREAD," + bytes(128)), "BREAD = 0 0 0 0 and 28 more (unit 1)"),
        (flag("SFLAG", 200), "SFLAG 200 (unit 1)"),
        (flag("CFLAG", 200), "CFLAG 200 (unit 1)"),
        (flag("RFLAG", 200), "RFLAG 200? (unit 1)"),
        (flag("RFLAG", 1), "RFLAG 1? (or = on) (unit 1)"),
        (flag("RFLAG", 0), "RFLAG 0? (or = off) (unit 1)"),
        (rflags(), "RFLAGS (unit 1)"),
        (packet(1, b"RFLAGS," + bytes(32)), "RFLAGS = on: none (unit 1)"),
        (packet(1, b"RFLAGS,\x02\x02" + bytes(30)), "RFLAGS = on: 1 9 (unit 1)"),
        (broken(rqstat()), "RQSTAT (unit 1) [checksum wrong, 0213h is right]"),
        (rqstat(0), "RQSTAT (unit 0, which is none)"),
        (packet(1, b"ZZ"), "body 5A 5A (unit 1)"),
        (packet(1, b"DREAD,\0"), "body 44 52 45 41 44 2C 00 (unit 1)"),
        (packet(1, b""), "no body (unit 1)"),
        (b"\x00\x06\xff", "00 06 FF"),
        (b"A" + rqstat() + b"A\x02", "41; RQSTAT (unit 1); 41 02"),
        (b"\x15" + rqstat() + b"\x06\x06", "NAK; RQSTAT (unit 1); ACK; ACK"),
        (b"\x02\x01\xff\xff\0\0\0\0\0", "02 01 FF FF 00 00 00 00 00"),
        (b"", ""),
    ],
)
def test_everything_has_its_words(data: bytes, words: str) -> None:
    """Either direction; what is no packet as hex; a wrong sum is told."""
    assert explain(data) == words


HEADER_LACKS = "of 6 bytes of the header are missing, and the rest"
BODY_LACKS = "of 7 bytes of the body are missing, and the checksum"


@pytest.mark.parametrize(
    ("count", "missing"),
    [
        (1, f"5 {HEADER_LACKS}"),
        (2, f"4 {HEADER_LACKS}"),
        (5, f"1 {HEADER_LACKS.replace('are', 'is')}"),
        (6, f"7 {BODY_LACKS}"),
        (9, f"4 {BODY_LACKS}"),
        (12, f"1 {BODY_LACKS.replace('are', 'is')}"),
        (13, "the checksum is missing"),
        (14, "1 of 2 bytes of the checksum is missing"),
    ],
)
def test_a_packet_that_breaks_off_is_told_with_what_is_missing(count: int, missing: str) -> None:
    """Alone, behind an answer, and before a packet that is whole."""
    begun = rqstat()[:count]
    words = f"{begun.hex(' ').upper()} [incomplete: {missing}]"
    assert explain(begun) == words
    assert explain(b"\x06" + begun) == f"ACK; {words}"
    long = bwrite(8, range(32))[:40]
    assert explain(long + rqstat()).endswith(
        "[incomplete: 103 of 137 bytes of the body are missing, and the checksum]; RQSTAT (unit 1)"
    )


def test_a_beginning_amid_noise_is_told_only_with_its_header() -> None:
    """A single 02h is seen in any noise."""
    assert explain(b"AB" + rqstat()[:5]) == "41 42 02 01 00 07 00"
    assert explain(b"AB" + rqstat()[:8]).endswith("[incomplete: 5 " + BODY_LACKS + "]")
    assert explain(b"\x02\x10") == "02 10", "no unit has that number"


def test_any_bytes_are_explained_in_one_line() -> None:
    """It never fails."""
    rng = random.Random(5)
    for _ in range(3000):
        data = bytearray(rng.choice((rqstat(), bwrite(8, range(32)), rflags(), rng.randbytes(40))))
        for _ in range(rng.randrange(3)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        assert "\n" not in explain(bytes(data))
