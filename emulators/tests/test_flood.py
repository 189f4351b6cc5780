"""Ten million bytes of noise and damaged frames do not disturb a twin."""

import gc
import random
import sys
from collections.abc import Iterator

import pytest
import serial
from mac_frames import ACCEPTED, NACK, REFUSED, request
from mutated_bytes import mutated

import axistwin as _axistwin  # noqa: F401  registers the URL scheme

pytestmark = pytest.mark.strength

TOTAL_BYTES = 10_000_000


def noise(rng: random.Random) -> Iterator[bytes]:
    """Random stretches and single mutated frames, TOTAL_BYTES in all.

    Address (08h) and rate (1Bh) stay out of it, so that where to ask in the end is known.
    """
    indices = [index for index in range(0x40) if index not in (0x08, 0x1B)]
    sent = 0
    while sent < TOTAL_BYTES:
        if rng.random() < 0.001:
            piece = rng.randbytes(10_000)
        else:
            address = rng.choice((0x00, 0xFF, rng.randrange(256)))
            piece = mutated(request(rng.choice(indices), rng.getrandbits(32), address), rng)
        sent += len(piece)
        yield piece


def assert_replies_only(received: bytes) -> None:
    """Nothing but whole replies: what a module at 0 may say, in one piece each."""
    place = 0
    while place < len(received):
        rest = received[place : place + 21]
        if rest[:1] == NACK:
            place += 1
        elif rest[:3] in (ACCEPTED, REFUSED):
            place += 3
        else:
            assert rest.startswith(b"\x06\x13\x02011"), rest
            assert rest.endswith(b"\x03\x1a"), rest
            assert len(rest) == 21, rest
            place += 21


def ask_position(port: serial.SerialBase) -> bytes:
    """Re-initialise the module, wait until it hears again, and ask where it is."""
    port.timeout = 3
    port.write(request(0x00))
    assert port.read(3) == ACCEPTED
    assert port.read(1) == b""
    port.write(request(0x20))
    return bytes(port.read(21))


def test_ten_million_bytes_of_noise_leave_a_twin_that_answers() -> None:
    """No exception, only whole replies, flat memory, and a good query afterwards is answered."""
    rng = random.Random(2006)
    url = "axistwin://mac23:0?time=virtual&seed=2006"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.012) as port:
        sent = early_blocks = replies = 0
        for piece in noise(rng):
            port.write(piece)
            port.flush()
            received = bytes(port.read(64))
            assert_replies_only(received)
            replies += len(received)
            sent += len(piece)
            if not early_blocks and sent > TOTAL_BYTES // 5:
                gc.collect()
                early_blocks = sys.getallocatedblocks()
        gc.collect()
        growth = sys.getallocatedblocks() - early_blocks
        assert growth < 20_000, f"{growth} more objects than after a fifth of the noise"
        assert replies > 100_000, "the noise never reached the module"
        port.read(10_000)
        answer = ask_position(port)
        assert answer.startswith(b"\x06\x13\x02011000"), answer
