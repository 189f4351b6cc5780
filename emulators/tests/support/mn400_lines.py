"""Commands of an MN400 that are drawn, and what a board makes of a stream of bytes."""

import random
from collections.abc import Iterator
from typing import NamedTuple

from axistwin.devices.mn400.grammar import COMMANDS

LETTERS = [*(letter for letter in COMMANDS if letter != "."), *"MMMVV(({}QAKH", "\x04", "W"]
NUMBERS = ("", "0", "1", "-1", "2", "4", "50", "100", "-100", "300", "-3000", "5000", "99999")

PAYLOAD_MAX = 80
EVERYBODY = 0x80


def drawn_line(rng: random.Random) -> bytes:
    """A command with more or less fitting parameters."""
    letter = rng.choice(LETTERS)
    count = rng.choice((0, 1, 1, 2, 4, 5, 6, 7))
    command = COMMANDS.get(letter)
    if command is not None and rng.random() < 0.7:
        count = len(command.parameters)
    line: str = letter + ",".join(rng.choice(NUMBERS) for _ in range(count))
    return line.encode()


class Heard(NamedTuple):
    """A packet that a board answers; flaw: the code that is all the answer, or 0."""

    command: int
    flaw: int
    payload: bytes


class ReferenceReceiver:
    """Ledger §2.7, steps 1 to 3 and 10, byte by byte, for board ``number``."""

    def __init__(self, number: int) -> None:
        self._own = 0x80 | number
        self._frame = b""
        """From the opening on; empty outside a packet."""
        self._is_closed = False

    def take(self, data: bytes) -> Iterator[Heard]:
        """What ``data`` completes."""
        for byte in data:
            frame = self._frame
            if byte >= 0x80:
                self._is_closed = len(frame) > 1 and byte == frame[0] and not self._is_closed
                self._frame = frame + bytes((byte,)) if self._is_closed else bytes((byte,))
            elif self._is_closed:
                yield from self._complete(byte)
            elif frame:
                self._frame = frame + bytes((byte,))

    def _complete(self, given: int) -> Iterator[Heard]:
        frame, payload = self._frame, self._frame[1:-1]
        self._frame, self._is_closed = b"", False
        if frame[0] not in (self._own, EVERYBODY):
            return
        flaw = 0
        if len(payload) > PAYLOAD_MAX:
            flaw = 0x15
        elif sum(frame) & 0x7F != given:
            flaw = 0x07
        yield Heard(payload.upper()[0], flaw, payload)

    def give_up(self) -> Iterator[Heard]:
        """Half a second of silence."""
        frame, self._frame, self._is_closed = self._frame, b"", False
        payload = frame[1:].rstrip(bytes((self._own,)))
        if frame[:1] == bytes((self._own,)) and payload:
            yield Heard(payload.upper()[0], 0x13, payload)
