"""Packets of the executive port: their bytes and their sum (ledger §2.2).

    02 | unit | length, 2 | block number, 2 | body: name, comma, values | sum, 2

Everything is sent high byte first (MSC-PKT-14).  Length counts the body alone (MSC-PKT-06); the sum
is that of all bytes from the unit number to the end of the body (MSC-PKT-12).  Nothing is escaped:
after the first byte the length alone tells where a packet ends (MSC-PKT-15).
"""

from typing import Final

STX, ACK, NAK = 0x02, 0x06, 0x15
ACK_BYTE, NAK_BYTE = bytes((ACK,)), bytes((NAK,))

HEADER_BYTES: Final = 6
CHECKSUM_BYTES: Final = 2
FRAME_BYTES: Final = HEADER_BYTES + CHECKSUM_BYTES
"""What a packet has beside its body (MSC-PKT-16)."""

BODY_MAX: Final = 240
"""Bytes of a body (MSC-PKT-10)."""

UNITS: Final = range(1, 16)
"""Unit numbers (MSC-PKT-03)."""


def packet(unit: int, body: bytes, block: int = 0) -> bytes:
    """A packet of or for ``unit`` with ``body`` and the sum that fits."""
    inner = b"%c%c%c%c%c%b" % (unit, len(body) >> 8, len(body) & 255, block >> 8, block & 255, body)
    total = sum(inner)
    return b"\x02%b%c%c" % (inner, total >> 8 & 255, total & 255)


def is_sum_right(raw: bytes) -> bool:
    """Whether the last two bytes of a packet are the sum of those between them and the STX."""
    high, low = raw[-2], raw[-1]
    return (sum(raw) - STX - high - low) & 0xFFFF == high << 8 | low


def body_length(raw: bytes | bytearray) -> int:
    """What the header of a packet announces; ``raw`` has at least four bytes."""
    return raw[2] << 8 | raw[3]
