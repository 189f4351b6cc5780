"""The packets of the MN400, both ways: built sound or broken, and taken apart whatever they are.

    request   ADDR  command  parameters              ADDR  checksum
    status    ADDR  command  return code  00         ADDR  checksum
    data      ADDR  command  value        trailer    ADDR  checksum

ADDR is 80h and the 7-bit id of the board; id 0 speaks to all.  The checksum is the sum of all bytes
before it, of which the low 7 bits are sent.  Whether a null stands behind a return code no checksum
can tell; what stands behind a value differs from device to device (MN4-AMB-01).

A reply has no length: it is over one byte after the next byte of 80h or more (`packet_end`).
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from typing import Final

ADDRESS_MARK: Final = 0x80
IDS: Final = range(1, 128)  # MN4-DROP-01
ALL_BOARDS: Final = 0
RATES: Final = (9600, 19200, 38400, 57600, 115200)  # by the number that ~ is given (MN4-PHY-01)
LEAST_PACKET: Final = 4  # ADDR, command, ADDR, checksum
STATUS_BYTES: Final = 6
NULL: Final = b"\x00"
OTHER_COUNTERS: Final = (0, 9, 99, 999, 9999, 99_999)  # of L, for `with_checksum`
FIRST_PRINTABLE: Final = 0x20  # what is below is a return code, or a trailer
END_OF_PROGRAM: Final = "\x04"  # as the command of a packet (MN4-AMB-12, MN4-AMB-13)
DEFAULT_TRAILER: Final = b"\x06"
DOT_NUL: Final = b".\x00"  # what stands for a comma and a zero in one reading of MN4-AMB-02
REVISION: Final = re.compile(r"MN400 V [0-9]+\.[0-9]+ / [0-9]+\.[0-9]+")  # MN4-CMD-FW-01
MOST_DIGITS: Final = 20  # of a number: more than any board holds
NUMBER: Final = re.compile(r"0|-?[1-9][0-9]*")  # MN4-RSP-10


class ReturnCode(IntEnum):
    """What a status packet says."""

    START = 0x03
    MOVE_ABORT = 0x04
    DONE = 0x05
    CHKSUMERROR = 0x07
    INVALIDCOMMAND = 0x0C
    INVALIDPROGCOMM = 0x0D
    PARA_ERROR = 0x0E
    NOMOVEPENDING = 0x10
    MOVEPENDING = 0x11
    BAUDCHANGEOK = 0x12
    TIMEOUT = 0x13
    BUSY = 0x14
    SLAVEBUFFOV = 0x15
    PRESENT = 0x16
    MEMORY_FULL = 0x1E


CODES: Final = frozenset(map(int, ReturnCode))


def number_in(text: str) -> int:
    """The number that a text of digits spells, at any length; of one far too wide for a board no
    more is kept than its sign and that it is too wide."""
    digits = text.removeprefix("-").lstrip("0")[:MOST_DIGITS] or "0"
    return -int(digits) if text.startswith("-") else int(digits)


def address_byte(board: int) -> int:
    """The byte that stands for an id (0 to 127)."""
    return ADDRESS_MARK | board


def checksum(data: bytes) -> int:
    """The sum of these bytes, its low 7 bits (MN4-PKT-03)."""
    return sum(data) & 0x7F


# --- building -------------------------------------------------------------------------------------


def request(
    board: int, text: str | bytes, *, closing: int | None = None, check: int | None = None
) -> bytes:
    """Give the bytes of a request: a command and its parameters as they are typed.

    Nothing of it is looked at: spaces, foreign characters and no command at all are sent as given.
    `closing`: the second address byte as it is to be sent; `check`: the checksum; None stands for
    the right ones.  A wrong second address is summed as sent.
    """
    payload = text.encode("latin-1") if isinstance(text, str) else text
    summed = bytes([address_byte(board)]) + payload
    summed += bytes([summed[0] if closing is None else closing])
    return summed + bytes([checksum(summed) if check is None else check])


def with_wrong_checksum(raw: bytes, offset: int = 1) -> bytes:
    """The packet with its checksum off by so much (1 to 127)."""
    return raw[:-1] + bytes([raw[-1] + offset & 0x7F])


def with_checksum(board: int, wanted: int) -> str:
    """A harmless command (L with counters that add up) whose request to a board has that checksum.

    Any of 0 to 127: the digits of three counters reach every one (MN4-PKT-04).  Raises ValueError
    for another number.
    """
    for last, third, first in itertools.product(OTHER_COUNTERS, OTHER_COUNTERS, range(1000)):
        text = f"L{first},0,{third},{last}"
        if request(board, text)[-1] == wanted:
            return text
    raise ValueError(f"no checksum is {wanted}: it has 7 bits")


def status(board: int, command: str, code: int, *, null: bool = True) -> bytes:
    """A status packet, as a board sends it."""
    return request(board, command.encode("latin-1") + bytes([code]) + (NULL if null else b""))


def data(board: int, command: str, value: str, trailer: bytes = DEFAULT_TRAILER) -> bytes:
    """A data packet, as a board sends it."""
    return request(board, (command + value).encode("latin-1") + trailer)


# --- taking apart ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class BoardPacket:
    """A packet taken apart: both address bytes and the checksum as sent, `payload` all between."""

    raw: bytes
    opening: int
    payload: bytes
    closing: int
    check: int

    @property
    def board(self) -> int:
        """The id in its first byte."""
        return self.opening & 0x7F

    @property
    def command(self) -> str:
        """Its command character; empty if there is none."""
        return self.payload[:1].decode("latin-1")

    @property
    def text(self) -> str:
        """All between the addresses, as typed: what a request says."""
        return self.payload.decode("latin-1")

    @property
    def code(self) -> int | None:
        """The return code of a status packet; None for any other."""
        rest = self.payload[1:]
        is_status = rest[:1] and rest[0] < FIRST_PRINTABLE and len(rest) <= 2
        return rest[0] if is_status and rest[0] in CODES else None

    @property
    def has_null(self) -> bool:
        """True for a status packet in the form of six bytes."""
        return self.payload[2:] == NULL

    @property
    def value(self) -> str:
        """What a data packet says: all that is printable behind the command, up to its trailer,
        with a comma and a zero where a period and a null stand for them (MN4-AMB-02)."""
        kept = self.payload[1 : len(self.payload) - len(self.trailer)]
        return kept.replace(DOT_NUL, b",0").decode("latin-1")

    @property
    def is_dotted(self) -> bool:
        """True if its value has a period and a null for a comma and a zero (MN4-AMB-02)."""
        return DOT_NUL in self.payload[1:]

    @property
    def trailer(self) -> bytes:
        """What stands behind the value (MN4-AMB-01): bytes below 20h before the second address; the
        null behind a period is of the value (MN4-AMB-02)."""
        count = 0
        for byte in reversed(self.payload[1:]):
            if byte >= FIRST_PRINTABLE:
                break
            count += 1
        begin = len(self.payload) - count
        return self.payload[begin + (self.payload[begin - 1 : begin + 1] == DOT_NUL) :]

    @property
    def fields(self) -> tuple[int, ...] | None:
        """The numbers of the value; None if it is not numbers with commas between (MN4-RSP-10)."""
        parts = self.value.split(",")
        if not all(NUMBER.fullmatch(part) for part in parts):
            return None
        return tuple(map(int, parts))

    @property
    def flaws(self) -> tuple[str, ...]:
        """What is wrong with it as a packet, whatever it says."""
        right = checksum(self.raw[:-1])
        flaws = {
            "no command": not self.payload,
            f"second address {self.closing:02X}h": self.closing != self.opening,
            f"checksum {self.check:02X}h, should be {right:02X}h": self.check != right,
        }
        return tuple(text for text, is_wrong in flaws.items() if is_wrong)

    @property
    def is_sound(self) -> bool:
        """True for a packet without flaws."""
        return not self.flaws


@lru_cache(maxsize=4096)
def parse(raw: bytes) -> BoardPacket | None:
    """Take bytes apart that are to be one packet; None for what cannot be one."""
    if len(raw) < LEAST_PACKET - 1 or packet_end(raw) != len(raw):
        return None
    return BoardPacket(raw, raw[0], raw[1:-2], raw[-2], raw[-1])


def packet_end(received: bytes) -> int:
    """How many bytes the packet has that begins here; 0: it is not over yet, or none begins.

    A packet is over with the byte behind its second address, whatever that byte is.
    """
    if not received or received[0] < ADDRESS_MARK:
        return 0
    for index in range(1, len(received) - 1):
        if received[index] >= ADDRESS_MARK:
            return index + 2
    return 0


def packets(received: bytes) -> tuple[tuple[BoardPacket, ...], bytes]:
    """The packets in what was received, and all bytes that belong to none, in their order."""
    found: list[BoardPacket] = []
    strays = b""
    for piece in _pieces(received):
        packet = parse(piece)
        if packet is None:
            strays += piece
        else:
            found.append(packet)
    return tuple(found), strays


def _pieces(received: bytes) -> Iterator[bytes]:
    """What was received, cut into packets and bytes outside of them."""
    while received:
        size = packet_end(received)
        if not size:
            # Before an address there are strays; behind one that has no end there is all the rest.
            size = next((i for i, byte in enumerate(received) if i and byte >= ADDRESS_MARK), 0)
            size = size if received[0] < ADDRESS_MARK and size else len(received)
        yield received[:size]
        received = received[size:]


def codes_of(found: Iterable[BoardPacket]) -> tuple[str, ...]:
    """What packets say, each by the name of its return code, or ``data``."""
    return tuple("data" if one.code is None else ReturnCode(one.code).name for one in found)
