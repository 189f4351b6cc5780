"""A noisy line before the built-in twin: bytes are lost, corrupted or late, in both directions."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import serial
from port_in_front import PortInFront
from small_scratch import small_scratch

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

LATEST_NS = 60_000_000  # a byte may come that late: more than the pause after a forbidden frame
FATES = ("lost", "corrupted", "late")
STORED_QUERIES = (0x22, 0x23, 0x25, 0x26)


class NoisyPort(PortInFront):
    """The built-in twin's port with one byte in `every` hit by one of `fates`."""

    def __init__(self, port: Any, every: int, seed: int, fates: Sequence[str] = FATES) -> None:
        super().__init__(port)
        self.every = every
        self.random = random.Random(seed)
        self.fates = fates
        self.hits = 0
        self._arrived: deque[tuple[int, int]] = deque()  # from when on, byte
        self.found = self._stored()
        self.left: tuple[object, ...] = ()  # what is stored when the suite closes the port

    def _spoil(self, byte: int) -> tuple[bytes, int]:
        """What becomes of a byte, and how late (ns)."""
        if self.random.randrange(self.every):
            return bytes([byte]), 0
        self.hits += 1
        match self.random.choice(self.fates):
            case "lost":
                return b"", 0
            case "corrupted":
                return bytes([byte ^ self.random.randrange(1, 256)]), 0
            case _:
                return bytes([byte]), self.random.randrange(LATEST_NS)

    def write(self, data: bytes) -> int:
        """Send what noise leaves of the bytes; a late one holds up those behind it."""
        whole = b""
        for byte in data:
            kept, late_ns = self._spoil(byte)
            if late_ns:
                self.port.write(whole)
                whole = b""
                self._let_pass(late_ns)
            whole += kept
        self.port.write(whole)
        return len(data)

    def read(self, size: int = 1) -> bytes:
        """Read what noise leaves, as pyserial does."""
        deadline_ns = self.virtual_time_ns + round((self.timeout or 0) * 1e9)
        taken = b""
        self._collect(0)
        while True:
            while (
                self._arrived and self._arrived[0][0] <= self.virtual_time_ns and len(taken) < size
            ):
                taken += bytes([self._arrived.popleft()[1]])
            left_ns = deadline_ns - self.virtual_time_ns
            if len(taken) == size or left_ns <= 0:
                return taken
            if self._arrived:
                left_ns = max(1, min(left_ns, self._arrived[0][0] - self.virtual_time_ns))
            self._collect(left_ns, size - len(taken))

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""
        self._collect(0)
        return sum(ready_ns <= self.virtual_time_ns for ready_ns, _ in self._arrived)

    def close(self) -> None:
        """Look at what is stored, then close."""
        self.left = self._stored()
        self.port.close()

    def _stored(self) -> tuple[object, ...]:
        """The answers to the queries of stored parameters and of the counter, without noise."""
        rate, self.port.baudrate = self.port.baudrate, 38400
        self.port.timeout = 0.5
        self.port.read(4096)
        answers = []
        for index in (*STORED_QUERIES, 0x20):
            summed = b"00%02X0000000000" % index
            self.port.write(b"\x02014" + summed + b"%02X\x03" % (sum(summed) % 256))
            answers.append(bytes(self.port.read(21)))
        self.port.baudrate = rate
        return tuple(answers)

    def _let_pass(self, duration_ns: int) -> None:
        until_ns = self.virtual_time_ns + duration_ns
        while (left_ns := until_ns - self.virtual_time_ns) > 0:
            self._collect(left_ns)

    def _collect(self, timeout_ns: int, count: int = 1) -> None:
        """Take what comes within the time into the queue, until there are so many bytes."""
        self.port.timeout = timeout_ns / 1e9
        for byte in self.port.read(count) + self.port.read(self.port.in_waiting):
            kept, late_ns = self._spoil(byte)
            before_ns = self._arrived[-1][0] if self._arrived else 0
            ready_ns = max(before_ns, self.virtual_time_ns + late_ns)
            self._arrived.extend((ready_ns, one) for one in kept)


@dataclass(frozen=True, slots=True)
class NoisyRun:
    """What came of a run behind a noisy line, and the ports it used."""

    result: Result
    ports: tuple[NoisyPort, ...]

    @property
    def hits(self) -> int:
        """How many bytes noise has hit."""
        return sum(port.hits for port in self.ports)

    @property
    def is_put_back(self) -> bool:
        """True if the twin stores at the end what it stored before."""
        return all(port.left == port.found for port in self.ports)


def noisy_run(
    every: int,
    seed: int,
    *words: str,
    level: str = "quick",
    fates: Sequence[str] = FATES,
    model: str = "mac23",
    engine: type[Engine] = Engine,
    port: type[NoisyPort] = NoisyPort,
    **quirks: str,
) -> NoisyRun:
    """Judge the built-in twin behind a noisy line."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(model=model, ids=words, level=level, seed=seed, **small_scratch(model))
    ports: list[NoisyPort] = []

    def open_noisy(neighbours: tuple[int, ...]) -> SerialTransport:
        url = options.family.twin_url(options.model, options.address, neighbours)
        url += "".join(f"&quirk.{name}={value}" for name, value in quirks.items())
        inner = serial.serial_for_url(url, baudrate=options.rate or 38400)
        ports.append(port(inner, every, seed + len(ports), fates))
        return SerialTransport(ports[-1], url, is_builtin=True, is_lossless=False)

    result = engine(options, open_noisy).run(lambda event: None)
    return NoisyRun(result, tuple(ports))
