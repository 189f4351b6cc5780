"""Ten million bytes of noise and damaged packets do not disturb a controller."""

import gc
import random
import sys
from collections.abc import Iterator

import pytest
import serial
from msc_bench import (
    ACK,
    NAK,
    SETTLE_MS,
    bread,
    broken,
    bwrite,
    dread,
    dwrite,
    flag,
    rflags,
    rqstat,
)
from mutated_bytes import mutated

import axistwin as _axistwin  # noqa: F401  registers the URL scheme
from axistwin.devices.msc.packets import body_length, is_sum_right, packet

pytestmark = pytest.mark.strength

TOTAL_BYTES = 10_000_000
REPLY_NAMES = (b"BREAD", b"DREAD", b"RFLAG", b"RFLAGS", b"RQSTAT")


def any_packet(rng: random.Random) -> bytes:
    """A good packet, or one that could be."""
    unit = rng.choice((1, 1, 1, 2, 0, rng.randrange(256)))
    number = rng.randrange(0x8000)
    kind = rng.randrange(11)
    if kind == 0:
        return bwrite(number & 0x3FFC, [rng.getrandbits(31) - (1 << 30) for _ in range(32)], unit)
    if kind == 1:
        return packet(unit, rng.randbytes(rng.randrange(300)), rng.randrange(0x10000))
    return (
        dread(number, unit),
        dwrite(number & ~3, rng.getrandbits(31) - (1 << 30), unit),
        bread(number, unit),
        flag("RFLAG", rng.randrange(300), unit),
        flag("SFLAG", rng.randrange(300), unit),
        flag("CFLAG", rng.randrange(300), unit),
        rflags(unit),
        rqstat(unit),
        broken(rqstat(unit)),
    )[kind - 2]


def noise(rng: random.Random) -> Iterator[bytes]:
    """Random stretches, single packets, good and mutated, and answers; TOTAL_BYTES in all."""
    sent = 0
    while sent < TOTAL_BYTES:
        kind = rng.random()
        if kind < 0.002:
            piece = rng.randbytes(5_000)
        elif kind < 0.2:
            piece = rng.choice((ACK, NAK, b"\x02", rng.randbytes(3)))
        else:
            piece = mutated(any_packet(rng), rng)
        sent += len(piece)
        yield piece


class Judge:
    """Takes what a unit 1 sends and refuses all that it may not."""

    def __init__(self) -> None:
        self.rest = b""
        self.signs = self.packets = 0

    def take(self, data: bytes) -> None:
        """Single ACK and NAK, and whole packets of unit 1 with the right sum."""
        data, at = self.rest + data, 0
        while at < len(data):
            if data[at : at + 1] in (ACK, NAK):
                self.signs += 1
                at += 1
                continue
            assert data[at] == 2, data[at : at + 20]
            if len(data) < at + 8 or len(data) < (end := at + 8 + body_length(data[at : at + 6])):
                break
            raw = data[at:end]
            assert raw[1] == 1, raw
            assert is_sum_right(raw), raw
            assert raw[6:].split(b",")[0] in REPLY_NAMES, raw
            self.packets += 1
            at = end
        self.rest = data[at:]


def test_ten_million_bytes_of_noise_leave_a_controller_that_answers() -> None:
    """No exception, no byte out of turn, flat memory, RQSTAT is answered after the settle time."""
    rng, judge = random.Random(1996), Judge()
    url = "axistwin://msc-250?time=virtual&seed=1996"
    with serial.serial_for_url(url, baudrate=9600, timeout=0.7) as port:
        sent = starts = early_blocks = 0
        for piece in noise(rng):
            port.write(piece)
            port.flush()
            starts += piece.count(b"\x02")
            judge.take(bytes(port.read(160)))
            if rng.random() < 0.3:
                judge.take(bytes(port.read(20_000)))
            sent += len(piece)
            if not early_blocks and sent > TOTAL_BYTES // 2:
                gc.collect()
                early_blocks = sys.getallocatedblocks()
        port.timeout = SETTLE_MS / 1000
        judge.take(bytes(port.read(2000)))
        gc.collect()
        growth = sys.getallocatedblocks() - early_blocks
        assert growth < 20_000, f"{growth} more objects than after half of the noise"
        assert not judge.rest
        assert judge.signs <= starts  # each STX starts a packet or is part of one
        assert judge.signs > 20_000, "the noise never reached the unit"
        assert judge.packets > 5_000, "nothing was ever answered"
        port.write(rqstat())
        port.timeout = 0.5
        answer = bytes(port.read(24))
        assert answer[:1] == ACK, answer
        assert is_sum_right(answer[1:]), answer


def test_noise_without_an_stx_draws_nothing() -> None:
    """MSC-PROP-15, a hundred thousand bytes."""
    rng = random.Random(3)
    with serial.serial_for_url("axistwin://msc-250?time=virtual", timeout=200) as port:
        port.write(rng.randbytes(100_000).replace(b"\x02", b""))
        assert port.read(1) == b""
