"""A bus in front of the built-in twin's: what stands between suite and twin in tests on CAN."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import can

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.transport.can import CanTransport, split_words

BITRATE = 125_000
LATEST_NS = 60_000_000
FATES = ("lost", "late", "twice")


def twin_bus(words: str) -> Any:
    """The bus object of a twin in virtual time; `words` as `--can` takes them."""
    interface, channel, _ = split_words(words)
    return can.Bus(channel, interface, ignore_config=True, bitrate=BITRATE)


class BusInFront:
    """Hands on what a `CanTransport` asks of `bus` beside sending and receiving."""

    def __init__(self, bus: Any) -> None:
        self.bus = bus
        self.found = self.stored()

    @property
    def virtual_time_ns(self) -> int:
        """The twin's clock."""
        return int(self.bus.virtual_time_ns)

    @property
    def twins(self) -> Any:
        """The twins behind it."""
        return self.bus.twins

    def stored(self) -> list[dict[str, Any]]:
        """What each twin's EEPROM holds; the counter is no parameter."""
        return [
            {name: cell for name, cell in twin.cells.items() if name != "position"}
            for twin in self.bus.twins
        ]


class NoisyBus(BusInFront):
    """The built-in twin's bus with one frame in `every` hit by one of `fates`, either way.

    A frame that CAN carries is never wrong: it is lost in the adapter, late behind one that the
    program was slow to fetch, or there twice, as when the last bit of an acknowledged one is hit.
    """

    def __init__(self, bus: Any, every: int, seed: int, fates: Sequence[str] = ("lost",)) -> None:
        super().__init__(bus)
        self.every, self.fates = every, fates
        self.random = random.Random(seed)
        self.hits = 0
        self.left: list[dict[str, Any]] = []
        self._arrived: deque[tuple[int, can.Message]] = deque()  # from when on, frame

    def _fate(self) -> str:
        if self.random.randrange(self.every):
            return ""
        self.hits += 1
        return self.random.choice(self.fates)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send what noise leaves of it."""
        match self._fate():
            case "lost":
                return
            case "late":
                self._let_pass(self.random.randrange(LATEST_NS))
            case "twice":
                self.bus.send(msg, timeout)
        self.bus.send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """Return what noise leaves."""
        deadline_ns = self.virtual_time_ns + round((timeout or 0) * 1e9)
        while True:
            self._collect(0)
            now_ns = self.virtual_time_ns
            if self._arrived and self._arrived[0][0] <= now_ns:
                return self._arrived.popleft()[1]
            left_ns = deadline_ns - now_ns
            if left_ns <= 0:
                return None
            if self._arrived:
                left_ns = min(left_ns, self._arrived[0][0] - now_ns)
            self._collect(left_ns)

    def shutdown(self) -> None:
        """Look at what is stored, then close."""
        self.left = self.stored()
        self.bus.shutdown()

    def _let_pass(self, duration_ns: int) -> None:
        until_ns = self.virtual_time_ns + duration_ns
        while (left_ns := until_ns - self.virtual_time_ns) > 0:
            self._collect(left_ns)

    def _collect(self, timeout_ns: int) -> None:
        """Take the next frame, if it comes within the time, into the queue."""
        message = self.bus.recv(timeout_ns / 1e9)
        if message is None:
            return
        fate = self._fate()
        if fate == "lost":
            return
        late_ns = self.random.randrange(LATEST_NS) if fate == "late" else 0
        before_ns = self._arrived[-1][0] if self._arrived else 0
        ready_ns = max(before_ns, self.virtual_time_ns + late_ns)
        self._arrived.extend([(ready_ns, message)] * (1 + (fate == "twice")))


@dataclass(frozen=True, slots=True)
class NoisyRun:
    """What came of a run behind a noisy bus, and the buses it used."""

    result: Result
    buses: tuple[NoisyBus, ...]

    @property
    def hits(self) -> int:
        """How many frames noise has hit."""
        return sum(bus.hits for bus in self.buses)

    @property
    def is_put_back(self) -> bool:
        """True if the twins store at the end what they stored before."""
        return all(bus.left == bus.found for bus in self.buses)


def noisy_run(
    every: int,
    seed: int,
    *words: str,
    level: str = "quick",
    fates: Sequence[str] = ("lost",),
    **quirks: str,
) -> NoisyRun:
    """Judge the built-in twin behind a noisy bus."""
    options = make_options(model="mac23-can", ids=words, level=level, seed=seed)
    buses: list[NoisyBus] = []

    def open_noisy(neighbours: tuple[int, ...]) -> CanTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        url += "".join(f"&quirk.{name}={value}" for name, value in quirks.items())
        buses.append(NoisyBus(twin_bus(url), every, seed + len(buses), fates))
        return CanTransport(
            buses[-1], url, is_spontaneous=codec.is_spontaneous, bitrate=BITRATE, is_builtin=True,
            is_lossless=False,
        )  # fmt: skip

    result = Engine(options, open_noisy).run(lambda event: None)
    return NoisyRun(result, tuple(buses))
