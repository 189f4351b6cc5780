"""Any bytes and any treatment: a MAC twin survives them (ledger §3.1, §4)."""

import random
import time

import pytest
from mac_bench import MS, MacBench, S

from axistwin.devices.mac.framing import request
from axistwin.devices.mac.serial import MacSerial
from axistwin.kernel.effects import Transmit
from axistwin.wire.framing import Chunk, LineFormat

# ---- any bytes ----


def mutated_frames(chance: random.Random, size: int) -> bytes:
    """Frames with damage, mixed with noise, about ``size`` bytes."""
    parts: list[bytes] = []
    while sum(map(len, parts)) < size:
        frame = bytearray(
            request(
                chance.choice((0, 0, 5, 0xFF, 0x80)),
                chance.randrange(0x40),
                chance.getrandbits(32),
                chance.choice((0, 0, 0xAF)),
            )
        )
        for _ in range(chance.choice((0, 0, 0, 1, 2))):
            frame[chance.randrange(len(frame))] = chance.randrange(256)
        parts.append(bytes(frame[: chance.choice((21, 21, 21, 21, 7))]))
        parts.append(chance.randbytes(chance.choice((0, 0, 3, 40))))
    return b"".join(parts)


@pytest.mark.parametrize("seed", range(2))
def test_any_bytes_are_survived_and_answered_at_most_once_per_frame(seed: int) -> None:
    """50 000 bytes of mutated frames: no exception, no unsolicited byte, alive afterwards."""
    chance = random.Random(seed)
    bench = MacBench()
    for _ in range(25):
        data = mutated_frames(chance, 2000)
        sent = len(bench.late)
        for at in range(0, len(data), 97):
            bench.send(data[at : at + 97])
            bench.advance(chance.choice((0, 2, 30, 2500)) * MS)
        frames = data.count(b"\x02")
        assert len(bench.late) - sent <= frames
    bench.advance(3 * S)
    bench.send(b"\x02")
    position = bench.device.address
    assert len(bench.ask(0x20, address=position)) == 21


def test_quiet_prefixes_are_quiet_whatever_the_cut() -> None:
    """Fed byte by byte or in the longest stretches, the same replies at the same times."""
    chance = random.Random(7)
    data = mutated_frames(chance, 4000)
    line_format = LineFormat(38400)
    outcomes = []
    for step in (1, 5000):
        device = MacSerial("mac23", 0)
        sent: list[Transmit] = []
        at = 0
        while at < len(data):
            quiet = device.quiet_prefix(data[at : at + step])
            size = max(1, quiet)
            chunk = Chunk(S + line_format.span_ns(at), data[at : at + size], line_format)
            while (due := device.next_event()) is not None and due <= chunk.arrival_ns(0):
                device.wake(due)
            sent += [e for e in device.receive(chunk) if isinstance(e, Transmit)]
            at += size
        outcomes.append([effect.data for effect in sent if len(effect.data) < 21])
    assert outcomes[0] == outcomes[1]
    assert outcomes[0]


@pytest.mark.slow
def test_ten_million_bytes_pass_in_seconds() -> None:
    """Random bytes cost next to nothing."""
    data = random.Random(3).randbytes(10_000_000)
    device = MacSerial("mac23", 0)
    begun = time.perf_counter()
    at = 0
    while at < len(data):
        piece = data[at : at + 65536]
        size = max(1, device.quiet_prefix(piece))
        device.receive(Chunk(at * 260_416, piece[:size], LineFormat(38400)))
        at += size
    assert time.perf_counter() - begun < 10
