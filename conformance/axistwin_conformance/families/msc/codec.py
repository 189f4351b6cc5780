"""Packets of the MSC executive port: requests to send, sound or not, and replies to take apart.

    02 | unit | length, 2 | block, 2 | body: NAME , values | checksum, 2      (MSC-PKT-01)

The length counts the body, the checksum is the plain sum of everything between the first byte and
itself, and every number goes high byte first.  One packet draws one bare character, 06h or 15h;
five of the nine commands then draw a packet of the same form (MSC-CMD-05).

Building never refuses anything: a conformance suite must be able to send every broken packet.
Parsing never raises: what does not fit has its flaws listed, so that a check can tell a wrong
length from a wrong checksum.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

STX: Final = b"\x02"
ACK: Final = b"\x06"
NAK: Final = b"\x15"
COMMA: Final = b","

HEADER_BYTES: Final = 6
CHECKSUM_BYTES: Final = 2
AROUND_BODY: Final = HEADER_BYTES + CHECKSUM_BYTES
MAX_BODY: Final = 240  # MSC-PKT-10
MAX_PACKET: Final = MAX_BODY + AROUND_BODY
UNITS: Final = range(1, 16)  # MSC-PKT-03
FLAGS: Final = range(256)  # MSC-FLG-01
BLOCK_VALUES: Final = 32  # MSC-BREAD-02, MSC-BWRITE-01
VALUE_BYTES: Final = 4
MOST_STRAYS: Final = 32  # bytes before a packet that are worth reading

READS: Final = ("BREAD", "DREAD", "RFLAG", "RFLAGS", "RQSTAT")
WRITES: Final = ("BWRITE", "CFLAG", "DWRITE", "SFLAG")
NAMES: Final = tuple(sorted((*READS, *WRITES)))  # MSC-CMD-06
IMPOSSIBLE_NAME: Final = "ZZZZZZ"  # what no maker calls a command: names must never be guessed

# What a body holds behind its comma (§2.4).
REQUEST_PAYLOADS: Final[Mapping[str, int]] = {
    "BREAD": 2, "BWRITE": 2 + BLOCK_VALUES * VALUE_BYTES, "CFLAG": 2, "DREAD": 2,
    "DWRITE": 2 + VALUE_BYTES, "RFLAG": 2, "RFLAGS": 0, "RQSTAT": 0, "SFLAG": 2,
}  # fmt: skip
REPLY_PAYLOADS: Final[Mapping[str, int]] = {
    "BREAD": BLOCK_VALUES * VALUE_BYTES, "DREAD": VALUE_BYTES, "RFLAG": 2, "RFLAGS": 32,
    "RQSTAT": 8,
}  # fmt: skip
# The whole packets, and what a reply has by the notation of the manual (MSC-AMB-38).
REQUEST_BYTES: Final[Mapping[str, int]] = {
    name: AROUND_BODY + len(name) + 1 + size for name, size in REQUEST_PAYLOADS.items()
}
REPLY_BYTES: Final[Mapping[str, int]] = {
    name: AROUND_BODY + len(name) + 1 + size for name, size in REPLY_PAYLOADS.items()
}


def u16(number: int) -> bytes:
    """Spell an address, a flag number, a length: two bytes, high byte first, modulo 65536."""
    return (number & 0xFFFF).to_bytes(2, "big")


def i32(number: int) -> bytes:
    """Spell a value: four bytes in two's complement, high byte first, modulo 2 to the 32nd."""
    return (number & 0xFFFF_FFFF).to_bytes(VALUE_BYTES, "big")


def signed(number: int) -> int:
    """What remains of a number in a variable of 32 bits."""
    return (number + 0x8000_0000 & 0xFFFF_FFFF) - 0x8000_0000


def checksum(data: bytes) -> int:
    """The plain sum of these bytes, modulo 65536 (MSC-PKT-12)."""
    return sum(data) & 0xFFFF


def body(name: str, *fields: bytes) -> bytes:
    """A body: the name, the comma, the values one after another."""
    return name.encode("latin-1") + COMMA + b"".join(fields)


def name_of(body: bytes) -> str:
    """All of a body before its first comma (MSC-CMD-07)."""
    return body.partition(COMMA)[0].decode("latin-1")


def packet(
    unit: int,
    body: bytes,
    block: int = 0,
    *,
    length: int | None = None,
    checksum: int | None = None,
) -> bytes:
    """Give the bytes of a packet; `length` and `checksum` None stand for the right ones.

    A given checksum is sent as it is; a wrong length under a right checksum is summed as sent.
    """
    size = len(body) if length is None else length
    summed = bytes([unit & 0xFF]) + u16(size) + u16(block) + body
    return STX + summed + u16(sum(summed) if checksum is None else checksum)


def with_wrong_checksum(raw: bytes, offset: int = 1) -> bytes:
    """The packet with its checksum off by so much (1..65535)."""
    return raw[:-CHECKSUM_BYTES] + u16(checksum(raw[1:-CHECKSUM_BYTES]) + offset)


# --- the nine bodies ------------------------------------------------------------------------------

RFLAGS: Final = body("RFLAGS")
RQSTAT: Final = body("RQSTAT")


def dread(address: int) -> bytes:
    """Read one value."""
    return body("DREAD", u16(address))


def bread(address: int) -> bytes:
    """Read 32 values."""
    return body("BREAD", u16(address))


def dwrite(address: int, value: int) -> bytes:
    """Write one value."""
    return body("DWRITE", u16(address), i32(value))


def bwrite(address: int, values: Iterable[int]) -> bytes:
    """Write the values, 32 of them unless a broken body is meant."""
    return body("BWRITE", u16(address), *map(i32, values))


def rflag(number: int) -> bytes:
    """Read one flag."""
    return body("RFLAG", u16(number))


def sflag(number: int) -> bytes:
    """Turn a flag on."""
    return body("SFLAG", u16(number))


def cflag(number: int) -> bytes:
    """Turn a flag off."""
    return body("CFLAG", u16(number))


# --- taking apart ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet taken apart: `raw` whole, `length` and `checksum` as sent, `body` all between."""

    raw: bytes
    unit: int
    length: int
    block: int
    body: bytes
    checksum: int

    @property
    def name(self) -> str:
        """All before the first comma (MSC-CMD-07); the whole body if there is none."""
        return name_of(self.body)

    @property
    def payload(self) -> bytes:
        """All behind the first comma (MSC-CMD-08)."""
        return self.body.partition(COMMA)[2]

    @property
    def values(self) -> tuple[int, ...]:
        """The payload as signed 32-bit values; what is left over at the end is no value."""
        count = len(self.payload) // VALUE_BYTES
        return struct.unpack(f">{count}i", self.payload[: count * VALUE_BYTES])

    @property
    def numbers(self) -> tuple[int, ...]:
        """The payload as unsigned 16-bit numbers."""
        count = len(self.payload) // 2
        return struct.unpack(f">{count}H", self.payload[: count * 2])

    @property
    def flaws(self) -> tuple[str, ...]:
        """What is wrong with it as a packet, whatever its body means."""
        right = checksum(self.raw[1:-CHECKSUM_BYTES])
        flaws = {
            f"unit {self.unit}": self.unit not in UNITS,
            f"length {self.length} over {len(self.body)} bytes": self.length != len(self.body),
            f"a body of {len(self.body)} bytes": len(self.body) > MAX_BODY,
            f"checksum {self.checksum:04X}h instead of {right:04X}h": self.checksum != right,
        }
        return tuple(text for text, is_wrong in flaws.items() if is_wrong)

    @property
    def is_sound(self) -> bool:
        """True for a packet without flaws."""
        return not self.flaws

    @property
    def is_request(self) -> bool:
        """True if a unit can do nothing but serve it: sound, a name, and the size it must have."""
        return self.is_sound and REQUEST_PAYLOADS.get(self._exact_name) == len(self.payload)

    @property
    def _exact_name(self) -> str:
        return self.name if COMMA in self.body else ""

    def __str__(self) -> str:
        return explain_packet(self)


def bytes_of(packet: Packet | None, strays: bytes) -> bytes:
    """All that came: a packet, if there was one, and what stood before it."""
    return strays + (packet.raw if packet else b"")


@lru_cache(maxsize=4096)
def parse(raw: bytes) -> Packet | None:
    """Take bytes apart that are to be one packet; None for what cannot be one: too short, or begun
    by something else than 02h."""
    if len(raw) < AROUND_BODY or raw[:1] != STX:
        return None
    unit, length, block = struct.unpack(">xBHH", raw[:HEADER_BYTES])
    inner, check = raw[HEADER_BYTES:-CHECKSUM_BYTES], raw[-CHECKSUM_BYTES:]
    return Packet(raw, unit, length, block, inner, int.from_bytes(check, "big"))


def missing_bytes(received: bytes) -> int:
    """How many more bytes the packet that begins so needs at least; 0: it is complete."""
    if not received:
        return HEADER_BYTES
    if received[:1] != STX:
        return 0
    if len(received) < HEADER_BYTES:
        return HEADER_BYTES - len(received)
    announced = int.from_bytes(received[2:4], "big")
    return max(0, AROUND_BODY + min(announced, MAX_BODY) - len(received))


def is_whole(raw: bytes) -> bool:
    """True for bytes that are a packet without flaws."""
    packet = parse(raw)
    return packet is not None and packet.is_sound


def flags_on(states: bytes) -> frozenset[int]:
    """The flags that the 32 bytes of an RFLAGS reply show on: flag f is bit f mod 8 of byte f / 8
    (MSC-RFLAGS-02)."""
    return frozenset(
        8 * index + bit
        for index, state in enumerate(states)
        for bit in range(8)
        if state >> bit & 1
    )


# --- words for reports ----------------------------------------------------------------------------

_SIGNS: Final = {ACK: "ACK", NAK: "NAK"}


def explain_packet(packet: Packet, *, is_request: bool = False) -> str:
    """A packet in words: ``unit 1: DREAD 1234``."""
    words = packet.name if packet.name.isprintable() else packet.body.hex(" ")
    if text := _values(packet):
        is_reply = not is_request and packet.name in READS
        words += f" = {text}" if is_reply else f" {text}"
    if packet.block:
        words += f" (block {packet.block:04X}h)"
    return "; ".join((f"unit {packet.unit}: {words}", *packet.flaws))


def _values(packet: Packet) -> str:
    """What is behind the comma, as far as its size tells what it is."""
    name, payload, size = packet.name, packet.payload, len(packet.payload)
    if name in ("BREAD", "BWRITE") and size == REQUEST_PAYLOADS["BWRITE"]:
        return f"{packet.numbers[0]} = {listed(struct.unpack('>32i', payload[2:]))}"
    if name == "BREAD" and size == REPLY_PAYLOADS["BREAD"]:
        return listed(packet.values)
    if name == "DWRITE" and size == REQUEST_PAYLOADS["DWRITE"]:
        return f"{packet.numbers[0]} = {int.from_bytes(payload[2:], 'big', signed=True)}"
    if name == "DREAD" and size == VALUE_BYTES:
        return str(packet.values[0])
    if name == "RFLAGS" and size == REPLY_PAYLOADS["RFLAGS"]:
        return f"{listed(sorted(flags_on(payload))) or 'none'} on"
    if name == "RQSTAT" and size >= 2:
        return f"{packet.numbers[0]:04X}h, then {payload[2:].hex(' ').upper()}"
    return str(packet.numbers[0]) if size == 2 else payload.hex(" ").upper()


def listed(values: Iterable[int]) -> str:
    """Values one after the other."""
    return " ".join(map(str, values))


def explain(data: bytes) -> str:
    """Put what a unit has said into words: its sign, its packet, and what is neither."""
    words = []
    while data:
        if data[:1] in _SIGNS:
            words.append(_SIGNS[data[:1]])
            data = data[1:]
            continue
        size = _whole(data)
        if not size:
            words.append(f"{len(data)} bytes: {data.hex(' ').upper()}")
            break
        packet = parse(data[:size])
        assert packet is not None, "a whole packet can be taken apart"
        words.append(str(packet))
        data = data[size:]
    return ", ".join(words)


def _whole(data: bytes) -> int:
    """The length of the packet these bytes begin with; 0: there is none, or not all of it."""
    if data[:1] != STX or missing_bytes(data):
        return 0
    return AROUND_BODY + min(int.from_bytes(data[2:4], "big"), MAX_BODY)


def explain_request(data: bytes) -> str:
    """Put what the host has sent into words."""
    if not data:
        return "nothing sent"
    if data in _SIGNS:
        return _SIGNS[data]
    packet, more = parse(data), missing_bytes(data)
    if data[:1] == STX and more:
        size = (
            f"{len(data)} of {len(data) + more} bytes" if len(data) >= 4 else f"{len(data)} bytes"
        )
        return f"a packet broken off after {size} ({data.hex(' ').upper()})"
    if packet is None:
        return f"{len(data)} bytes: {data.hex(' ').upper()}"
    return explain_packet(packet, is_request=True)
