"""Packets of the executive port: their bytes, their sum, whom they concern (ledger §2.2).

    02 | unit | length, 2 | block number, 2 | body: name, comma, values | sum, 2

Everything is sent high byte first (MSC-PKT-14).  Length counts the body alone (MSC-PKT-06); the sum
is that of all bytes from the unit number to the end of the body (MSC-PKT-12).  Nothing is escaped:
after the first byte the length alone tells where a packet ends (MSC-PKT-15).
"""

from enum import Enum
from typing import Final

from axistwin.devices.msc.quirks import MscQuirks

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


class Whom(Enum):
    """Whom a unit number concerns, for this unit."""

    OWN = "own"
    OTHER = "other"
    REFUSED = "refused"  # answered with NAK
    ALL = "all"  # obeyed in silence


def concerned(unit: int, quirks: MscQuirks, *, is_rs232: bool) -> tuple[Whom, ...]:
    """Whom each value of the unit byte concerns, seen from ``unit``.

    On RS-232 the number is 1, and 2..15 are as another unit's (MSC-AMB-12); there is no 0 and
    nothing above 15 (MSC-AMB-13).
    """
    own = 1 if is_rs232 else unit
    unchecked = {"silent": Whom.OTHER, "nak": Whom.REFUSED, "ignore": Whom.OWN}
    others = unchecked[quirks.rs232_unit_check] if is_rs232 else Whom.OTHER
    strange = {"silent": Whom.OTHER, "nak": Whom.REFUSED, "broadcast": Whom.ALL}
    invalid = strange[quirks.invalid_unit]
    return tuple(
        Whom.OWN if byte == own else others if byte in UNITS else invalid for byte in range(256)
    )


def completed(data: bytes) -> bytes:
    """``data``, a packet without its sum, with it; anything else as it is."""
    if len(data) >= HEADER_BYTES and len(data) == HEADER_BYTES + body_length(data):
        return data + (sum(data[1:]) & 0xFFFF).to_bytes(CHECKSUM_BYTES, "big")
    return data


def is_packet(data: bytes) -> bool:
    """Whether a unit's answer ends with a whole packet, which wants an acknowledgement."""
    begun = data[data.find(b"\x02") :] if b"\x02" in data else b""
    return len(begun) >= FRAME_BYTES and len(begun) == FRAME_BYTES + body_length(begun)
