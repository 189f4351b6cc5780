"""Between suite and twins of an MSC: everything that is sent, and what the twins hold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Any, Final

import serial
from port_in_front import PortInFront
from small_scratch import PROGRAM

from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.transport.serial import TWIN_HANDLER, SerialTransport

PORT: Final = "/dev/ttyMSC"  # what the suite takes for a real port
VARIABLES: Final = range(1024, 2048)
FLAGS: Final = range(128, 160)
NAMES: Final = frozenset(b"BREAD BWRITE CFLAG DREAD DWRITE RFLAG RFLAGS RQSTAT SFLAG".split())
WRITES: Final = re.compile(rb"(BWRITE|DWRITE|CFLAG|SFLAG),(?=(..))", re.DOTALL)


class MscWatch(PortInFront):
    """A port that the suite takes for a real one, in virtual time.

    `at_call`: told of each write and read.
    """

    def __init__(self, port: Any, at_call: Callable[[MscWatch], None]) -> None:
        super().__init__(port)
        self.sent: list[bytes] = []
        self._at_call = at_call
        for unit, twin in enumerate(port.twins):
            for address in VARIABLES[::4]:
                twin.variables[address] = address * 7919 * (unit + 1) - 20_000_000
            for number in FLAGS:
                twin.flags[number] = bool(number * 5 >> 2 & 1)
        self.before = self.held()

    @property
    def in_waiting(self) -> int:
        """Bytes that are there."""
        return int(self.port.in_waiting)

    def write(self, data: bytes) -> int:
        """Take down what is sent."""
        self._at_call(self)
        self.sent.append(bytes(data))
        return int(self.port.write(data))

    def read(self, size: int = 1) -> bytes:
        """Hand on what comes."""
        self._at_call(self)
        self.port.timeout = self.timeout
        return bytes(self.port.read(size))

    def close(self) -> None:
        """Stay open for questions."""

    def held(self) -> list[tuple[dict[int, int], dict[int, bool]]]:
        """What each unit holds of what may be written."""
        return [
            (
                {address: twin.variables[address] for address in VARIABLES[::4]},
                {number: twin.flags[number] for number in FLAGS},
            )
            for twin in self.port.twins
        ]

    def writes(self) -> Iterator[tuple[str, int]]:
        """Every write that any device could read out of what was sent: name, address or flag."""
        for one in WRITES.finditer(b"".join(self.sent)):
            yield one[1].decode(), int.from_bytes(one[2], "big")

    def strangers(self) -> set[bytes]:
        """The names, of packets whose checksum is right, that nobody has documented."""
        stream, found = b"".join(self.sent), set()
        for at in range(len(stream) - 8):
            size = int.from_bytes(stream[at + 2 : at + 4], "big")
            end = at + 6 + size
            if stream[at] != 2 or size > 240 or end + 2 > len(stream):
                continue
            if sum(stream[at + 1 : end]) & 0xFFFF == int.from_bytes(stream[end : end + 2], "big"):
                body = stream[at + 6 : end]
                found.add(body.partition(b",")[0] if b"," in body else body)
        return found - NAMES


def run_on_a_port(
    *words: str,
    allow: str = "stored",
    level: str = "full",
    seed: int = 0,
    model: str = "msc-250",
    at_call: Callable[[MscWatch], None] = lambda watch: None,
) -> tuple[Result, list[MscWatch]]:
    """A run against what the suite takes for a controller on a real port."""
    if TWIN_HANDLER not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.append(TWIN_HANDLER)
    options = make_options(
        model=model, ids=words, port=PORT, neighbours=(2,), allow=allow, variables=VARIABLES,
        flags=FLAGS, bench_program=PROGRAM, level=level, seed=seed,
    )  # fmt: skip
    watches: list[MscWatch] = []

    def open_watch(neighbours: tuple[int, ...]) -> SerialTransport:
        url = options.family.twin_url(model, options.address, neighbours)
        watches.append(MscWatch(serial.serial_for_url(url, baudrate=9600), at_call))
        return SerialTransport(watches[-1], PORT, is_lossless=False)  # as a real line may be

    return Engine(options, open_watch).run(lambda event: None), watches
