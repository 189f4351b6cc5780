"""Hardware safety, seen from outside: everything a run sends and where the axis then is."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
import serial

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import Engine, Result
from axistwin_conformance.targets import TWIN_HANDLER, Target

TRAVEL = 2000
STORED_QUERIES = (0x22, 0x23, 0x25, 0x26)
# A counter cleared in motion is cleared somewhere within an exchange: 10 ms at 10 000 per second.
CLEARED_WITHIN = 100


@dataclass
class Wire:
    """The twin's port as the suite sees it, with a record of everything sent."""

    port: Any
    sent: list[bytes] = field(default_factory=list)
    shaft: int = 0
    furthest: int = 0
    asked: int = 0
    cleared: int = 0  # how many times in motion
    interrupt_at: int = -1

    def __post_init__(self) -> None:
        self._seen = self.counter

    def __getattr__(self, name: str) -> Any:
        """Everything else is the port's own."""
        return getattr(self.port, name)

    def __setattr__(self, name: str, value: Any) -> None:
        """The settings of the port go to the port."""
        target = self.port if name in ("timeout", "baudrate") else self
        object.__setattr__(target, name, value) if target is self else setattr(target, name, value)

    @property
    def counter(self) -> int:
        """Where the twin itself says it is."""
        return int(self.port.twins[0].position)

    @property
    def slack(self) -> int:
        """How far our idea of the shaft may be off."""
        return CLEARED_WITHIN * self.cleared

    def look(self) -> None:
        """Follow the shaft; a jump back to 0 is a cleared counter."""
        now = self.counter
        if self._is_clearing:
            self._is_clearing = False
            if abs(now) < CLEARED_WITHIN and abs(self._seen) > abs(now):
                self.cleared += self._seen != now and now != 0
                self._seen = 0
        self.shaft += now - self._seen
        self._seen = now
        self.furthest = max(self.furthest, abs(self.shaft))

    _is_clearing = False

    def write(self, data: bytes) -> int:
        """Record, look, send."""
        self.look()
        if len(self.sent) == self.interrupt_at:
            self.sent.append(b"interrupt")
            raise KeyboardInterrupt
        self.sent.append(data)
        index = executed(data)
        if index in (0x13, 0x14):
            target = int(data[10:18], 16) if index == 0x13 else 0
            target -= 1 << 32 if target >> 31 else 0
            self.asked = max(self.asked, abs(self.shaft + target - self._seen))
        self._is_clearing |= index == 0x0B
        return int(self.port.write(data))

    def read(self, size: int = 1) -> bytes:
        """Receive and look."""
        data = bytes(self.port.read(size))
        self.look()
        return data

    def ask(self, index: int) -> bytes:
        """A query of our own."""
        summed = b"00%02X0000000000" % index
        self.port.timeout = 0.5
        self.port.write(b"\x02014" + summed + b"%02X\x03" % (sum(summed) % 256))
        return bytes(self.port.read(21))


def executed(data: bytes) -> int | None:
    """The index of a frame that the module under test would execute."""
    is_whole = len(data) == 21 and data[:4] == b"\x02014" and data[20] == 3
    if not is_whole or data[18:20] != b"%02X" % (sum(data[4:18]) % 256):
        return None
    is_ours = data[4:6] in (b"00", b"FF") and set(data[4:18]) <= set(b"0123456789ABCDEF")
    return int(data[6:8], 16) if is_ours else None


def run(
    *words: str,
    watch: Callable[[Wire], None] = lambda wire: None,
    level: str = "full",
    seed: int = 0,
    monkeypatch: pytest.MonkeyPatch | None = None,
) -> tuple[Result, list[Wire]]:
    """Run against the built-in twin inside the envelope; its lines stay open for questions."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(
        model="mac23", ids=words, level=level, seed=seed, max_travel=TRAVEL, max_speed=10_000,
        allow="motion,stored,destructive",
    )  # fmt: skip
    wires: list[Wire] = []

    def open_wire(neighbours: tuple[int, ...]) -> Target:
        url = options.family.twin_url(options.model, options.address, neighbours)
        wire = Wire(serial.serial_for_url(url, baudrate=options.baud))
        watch(wire)
        wires.append(wire)
        target: Any = Target(wire, url, is_builtin=True)
        target.close = lambda: None
        return target  # type: ignore[no-any-return]

    return Engine(options, open_wire).run(lambda event: None), wires


def judge_travel(seed: int, level: str) -> None:
    """A whole run: nothing outside is asked for, the shaft never gets there."""
    result, wires = run(seed=seed, level=level)
    assert result.exit_status == 0, result.sentence
    for wire in wires:
        assert wire.sent
        assert wire.asked <= TRAVEL + wire.slack
        assert wire.furthest <= TRAVEL + wire.slack
    assert max(wire.furthest for wire in wires) > TRAVEL // 4, "there was motion"


def test_a_quick_run_never_leaves_the_envelope() -> None:
    """With --max-travel 2000 no position further away is asked for, or reached."""
    judge_travel(0, "quick")


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(20))
def test_a_full_run_never_leaves_the_envelope(seed: int) -> None:
    """Twenty seeds, everything but the rig."""
    judge_travel(seed, "full")


def interrupt_once(moment: int, *words: str, level: str) -> bool:
    """Interrupt the run as it sends for the `moment`th time; False if it was over before."""

    def arm(wire: Wire) -> None:
        wire.interrupt_at = moment
        before.append([wire.ask(index) for index in STORED_QUERIES])

    before: list[list[bytes]] = []
    result, wires = run(*words, watch=arm, level=level)
    hit = [wire for wire in wires if b"interrupt" in wire.sent]
    for wire, found in zip(wires, before, strict=True):
        assert [wire.ask(index) for index in STORED_QUERIES] == found
        place = wire.counter
        wire.ask(0x20)
        assert wire.counter == place, "at rest"
    for wire in hit:
        acts = {*range(4), 0x08, 0x09, 0x0A, *range(0x0C, 0x11), *range(0x13, 0x1D), 0x1E}
        if any(executed(data) in acts for data in wire.sent[: wire.sent.index(b"interrupt")]):
            after = wire.sent[wire.sent.index(b"interrupt") + 1 :]
            assert 0x18 in [executed(data) for data in after], "the stop was sent"
    assert not hit or result.exit_status == 130
    return bool(hit)


MOVING = ("MACS-CMD-13", "MACS-CMD-15", "MACS-CMD-16", "MACS-CMD-0D", "MACS-CMD-09")


def test_an_interrupt_at_any_moment_leaves_the_axis_at_rest_and_its_memory_as_it_was() -> None:
    """A few random moments of a short run."""
    moments = random.Random(3).sample(range(10, 900), 6)
    hits = [interrupt_once(moment, *MOVING, level="quick") for moment in moments]
    assert any(hits)


@pytest.mark.soak
@pytest.mark.parametrize("part", range(10))
def test_an_interrupt_at_two_hundred_random_moments(part: int) -> None:
    """Twenty of them here; all over a run of everything."""
    moments = random.Random(part).sample(range(4000), 20)
    hits = [interrupt_once(moment, level="quick") for moment in moments]
    assert sum(hits) > 10
