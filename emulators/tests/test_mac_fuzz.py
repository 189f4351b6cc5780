"""Any bytes and any treatment: a MAC twin survives them (ledger §3.1, §4)."""

import contextlib
import random
import time
from typing import Any

import pytest
from mac_bench import MS, MacBench, S

from axistwin.devices.mac.axis.quirks import QUIRKS
from axistwin.devices.mac.serial.device import MacSerial
from axistwin.devices.mac.serial.framing import request
from axistwin.errors import UsageError
from axistwin.kernel.effects import Effect, Transmit
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk, LineFormat

pytestmark = pytest.mark.strength

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


def test_ten_million_bytes_pass_in_seconds() -> None:
    """Random bytes cost next to nothing."""
    data = random.Random(3).randbytes(10_000_000)
    device = MacSerial("mac23", 0)
    begun = time.process_time()
    at = 0
    while at < len(data):
        piece = data[at : at + 65536]
        size = max(1, device.quiet_prefix(piece))
        device.receive(Chunk(at * 260_416, piece[:size], LineFormat(38400)))
        at += size
    assert time.process_time() - begun < 10


# ---- any treatment ----

PERIODS = (1, 2, 16, 0x320, 0x1000, 0xFFFF)
NUMBERS = (0, 1, -1, 5, 100, -3000, 100_000, 0x3FFFFFFF, -0x40000000, 0x7FFFFFFF, -0x80000000)
WAKES_MAX = 60
"""How often a module may wake after one treatment, until the next one 20 s later."""


class Bounded(MacBench):
    """A bench that notices when its module wakes too often."""

    wakes = 0

    def take(self, effects: list[Effect]) -> bytes:
        """Note effects, and that there was a call."""
        self.wakes += 1
        assert self.wakes <= WAKES_MAX, f"too many events: {self.device.quirks}"
        return super().take(effects)


def any_quirks(chance: random.Random) -> dict[str, Any]:
    """A setting with some readings other than the default ones."""
    chosen: dict[str, Any] = {}
    for name, quirk in QUIRKS.items():
        if quirk.kind in ("choice", "bool") and chance.random() < 0.3:
            chosen[name] = chance.choice(quirk.allowed)
    chosen["position_overflow"] = chance.choice(("wrap", "saturate"))
    chosen["brake_increments"] = chance.choice(("plant", "0", "7", "65535"))
    chosen["boot_time_ms"] = chance.choice((0, 10, 2000))
    chosen["reply_latency_us"] = chance.choice((0, 1000))
    chosen["imax_value"] = chance.choice((0x80, 0x80, 0x20, 0xFF))
    chosen["factory_ramp"] = chance.choice((0, 0, 1, 3))
    chosen["factory_stops"] = chance.choice((0, 8, 9))
    return chosen


def any_parameters(chance: random.Random, index: int) -> int:
    """Parameters that make sense to ``index`` more often than not."""
    period, number = chance.choice(PERIODS), chance.choice(NUMBERS)
    match index:
        case 0x15:
            return chance.choice((0, 0xF6)) << 16 | chance.choice((period, period, 0))
        case 0x16 | 0x1E:
            return (chance.choice((0, 1, 200, -200, 0x7FFF, -0x8000)) & 0xFFFF) << 16 | period
        case 0x0D:
            return period
        case 0x0F:
            return chance.choice((0, 1, 3, 255))
        case 0x09 | 0x0A | 0x13:
            return number + chance.randrange(-3, 4) & 0xFFFFFFFF
        case 0x02 | 0x03 | 0x07 | 0x1B:
            return chance.choice((0, 1, 1, 8, 9))
        case _:
            return chance.choice((0, 1, 0x40, chance.getrandbits(32)))


MOTION = (0x10, 0x11, 0x13, 0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1E, 0x0B)
RARE = (0x00, 0x01, 0x08, 0x1B)
SETTINGS = (0x02, 0x03, 0x07, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x1C)


def revive(bench: MacBench) -> None:
    """Supply, reset input, faults and rate as they should be; then two seconds."""
    device, now = bench.device, bench.now
    bench.take(device.set_temperature(now, 25_000))
    for name in ("amplifier", "encoder", "reset"):
        with contextlib.suppress(UsageError):
            act = device.set_input if name == "reset" else device.set_fault
            bench.take(act(now, name, False))
    bench.take(device.power_off(now))
    bench.take(device.power_on(now))
    bench.advance(2 * S)


def treat(bench: MacBench, chance: random.Random) -> None:
    """Do one thing to the module, over the wire or by hand."""
    device, now = bench.device, bench.now
    if bench.state()[:2] in ("of", "RI", "DJ") and chance.random() < 0.3:
        revive(bench)
        return
    match chance.randrange(20):
        case 0:
            device_load = Load(
                torque_nm=chance.choice((0, 0, 0.5, 2)),
                inertia_kgcm2=chance.choice((0, 1)),
                held=chance.random() < 0.3,
            )
            bench.take(device.set_load(now, device_load))
        case 1:
            bench.take(device.push(now, chance.choice((1, -1, 40, -500))))
        case 2:
            name = chance.choice(("reference", "positive_stop", "negative_stop"))
            bench.take(device.set_input(now, name, chance.random() < 0.5))
        case 3 if chance.random() < 0.3:
            switch = chance.choice((device.power_off, device.power_on))
            bench.take(switch(now))
        case 4 if chance.random() < 0.3:
            with contextlib.suppress(UsageError):
                bench.take(device.set_input(now, "reset", chance.random() < 0.5))
        case 5 if chance.random() < 0.3:
            with contextlib.suppress(UsageError):
                fault = chance.choice(("micro_cut", "amplifier", "encoder"))
                bench.take(device.set_fault(now, fault, chance.random() < 0.3))
        case 6:
            bench.take(device.set_temperature(now, chance.choice((25,) * 9 + (100,)) * 1000))
        case 7:
            bench.take(device.set_supply(now, chance.choice((24, 24, 8, 50)) * 1000))
        case _:
            groups = (MOTION, MOTION, MOTION, SETTINGS, (0x20, 0x21, 0x26, 0x27, 0x28, 0x29), RARE)
            index = chance.choice(chance.choices(groups, (30, 30, 30, 20, 20, 1))[0])
            bench.ask(index, any_parameters(chance, index), address=chance.choice((0, 0xFF)))


def look(bench: MacBench) -> None:
    """Everything that can be seen is seen, and what is stored could be taken over."""
    device, now = bench.device, bench.now
    told = device.describe(now)
    cells = dict(device.cells(now))
    assert -(1 << 30) <= told["position"] < 1 << 30
    assert MacSerial(device.model, 0, quirks=device.quirks, cells=cells).cells(0) == cells
    moving = device.is_moving(now)
    assert not (moving and told["state"] in ("off", "HD+AR", "HD") and not told["powered"])


def lives(seed: str, steps: int) -> None:
    """One module's life: random readings, random treatment."""
    chance = random.Random(seed)
    quirks = any_quirks(chance)
    place = chance.choice((0, 600, 0x3FFFFF00, -0x3FFFFF00))
    superior, inferior = chance.choice(((place + 500, place - 500), (0x7FFFFFFF, -0x7FFFFFFF)))
    cells = {"position": place, "superior_stop": superior, "inferior_stop": inferior}
    model = chance.choice(("mac23", "mac34-1", "mac34-2"))
    bench = Bounded(model, cells=cells, **quirks)
    for _ in range(steps):
        bench.wakes = 0
        treat(bench, chance)
        bench.address = bench.device.address
        bench.run_until(bench.now + chance.choice((0, 1, 30, 1000, 20_000)) * MS)
        look(bench)


@pytest.mark.parametrize("seed", range(5))
def test_any_treatment_is_survived(seed: int) -> None:
    """No exception, no runaway, whatever the readings: a short walk."""
    for life in range(6):
        lives(f"{seed}/{life}", 60)


@pytest.mark.parametrize("seed", range(10))
def test_any_treatment_is_survived_for_long(seed: int) -> None:
    """The same, longer."""
    for life in range(40):
        lives(f"long/{seed}/{life}", 150)
