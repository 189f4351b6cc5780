"""A CAN frame, and how many bits it takes on the wire: CRC and stuffing exact to the bit.

A classical frame (ISO 11898-1), most significant bits first, 0 dominant:

    standard   SOF | identifier 11       RTR | IDE r0   | DLC 4 | data | CRC 15 | 1 ACK 1 | EOF 7
    extended   SOF | base 11 SRR IDE | extension 18 RTR | r1 r0 | DLC 4 | ...
               |<------------------- stuffed --------------------------------->|

Rules
-----
1. From SOF to the end of the CRC a bit of the other value follows five equal ones; that bit counts
   as the first of the next run.  A run that ends with the CRC is stuffed too.
2. The CRC (x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1) is taken over the bits before stuffing.
3. Whatever is dominant earlier wins the arbitration: the lower identifier, data before remote,
   standard before extended of the same base.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

INTERMISSION_BITS: Final = 3
"""Recessive bits after every frame before the next one may begin."""

UNSTUFFED_TAIL_BITS: Final = 10
"""CRC delimiter, ACK slot and delimiter, end of frame: never stuffed."""

STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFFFFFF
DATA_BYTES_MAX: Final = 8

_POLYNOMIAL: Final = 0x4599
_CRC_BITS: Final = 15


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One classical data or remote frame.

    identifier: 11 bits, or 29 if ``is_extended``.  data: 0..8 bytes, none in a remote frame.
    length: what the data length code says, 0..8; left out: as many as ``data`` has.
    Raises ValueError for what no controller could send.
    """

    identifier: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    length: int = -1

    def __post_init__(self) -> None:
        size = len(self.data)
        if self.length < 0:
            object.__setattr__(self, "length", size)
        if not 0 <= self.identifier <= (EXTENDED_MAX if self.is_extended else STANDARD_MAX):
            bits = 29 if self.is_extended else 11
            raise ValueError(f"identifier {self.identifier:X}h does not fit into {bits} bits")
        if self.length > DATA_BYTES_MAX:
            raise ValueError(f"length {self.length}: a CAN frame carries 0 to 8 bytes")
        if size != (0 if self.is_remote else self.length):
            raise ValueError(
                f"{size} bytes of data in a frame of length {self.length}: "
                "a data frame has as many as its length says, a remote frame none"
            )

    def __str__(self) -> str:
        """As candump writes it: ``601#4000200000000000``, ``00000123#R8``."""
        shown = f"{self.identifier:08X}#" if self.is_extended else f"{self.identifier:03X}#"
        if self.is_remote:
            return f"{shown}R{self.length or ''}"
        return shown + self.data.hex().upper()


# ---- arbitration ---------------------------------------------------------------------------------


def arbitration_key(frame: CanFrame) -> int:
    """The arbitration field as a number: of frames that begin together the lowest wins (rule 3).

    Two frames have the same key if nothing before the control field tells them apart.
    """
    if not frame.is_extended:
        return frame.identifier << 21 | frame.is_remote << 20
    base, extension = frame.identifier >> 18, frame.identifier & 0x3FFFF
    return base << 21 | 0b11 << 19 | extension << 1 | frame.is_remote


# ---- bits ----------------------------------------------------------------------------------------


def crc_15(data: bytes, crc: int = 0) -> int:
    """The check sequence over whole bytes, beginning from ``crc`` (rule 2).

    Zeros in front of a message change nothing, so a field of any width can be padded on the left.
    """
    for byte in data:
        crc = (crc << 8 & 0x7FFF) ^ _CRC_TABLE[(crc >> 7 ^ byte) & 0xFF]
    return crc


def _crc_of_byte(byte: int) -> int:
    crc = byte << 7
    for _ in range(8):
        crc = (crc << 1) ^ (_POLYNOMIAL if crc & 0x4000 else 0)
        crc &= 0x7FFF
    return crc


_CRC_TABLE: Final = tuple(_crc_of_byte(byte) for byte in range(256))

# A run is (value of the last bit) * 5 + (its length - 1).  Four bits at a time: the run they lead
# to, and the bits as sent, behind a leading 1 that marks where they begin.
_RUNS: Final = range(10)
_IDLE_RUN: Final = 5  # a single recessive bit


def _stuff_four(run: int, four: int) -> tuple[int, int]:
    """The run after four more bits, and these bits with those stuffed in (rule 1)."""
    value, length, sent = run // 5, run % 5 + 1, 1
    for shift in (3, 2, 1, 0):
        bit = four >> shift & 1
        value, length = (bit, length + 1) if bit == value else (bit, 1)
        sent = sent << 1 | bit
        if length == 5:
            value, length = 1 - value, 1
            sent = sent << 1 | value
    return value * 5 + length - 1, sent


_STUFFED: Final = tuple(tuple(_stuff_four(run, four) for four in range(16)) for run in _RUNS)
_SENT_BITS: Final = tuple(tuple(sent.bit_length() - 1 for _, sent in row) for row in _STUFFED)
_NEXT_RUN: Final = tuple(tuple(run for run, _ in row) for row in _STUFFED)


def _unstuffed(frame: CanFrame) -> tuple[int, int]:
    """SOF to the end of the CRC before stuffing: the bits as a number, and how many."""
    if frame.is_extended:
        base, extension = frame.identifier >> 18, frame.identifier & 0x3FFFF
        head = base << 20 | 0b11 << 18 | extension
        head, bits = (head << 1 | frame.is_remote) << 6 | frame.length, 39
    else:
        head, bits = (frame.identifier << 1 | frame.is_remote) << 6 | frame.length, 19
    bits += 8 * len(frame.data)
    field = head << 8 * len(frame.data) | int.from_bytes(frame.data, "big")
    crc = crc_15(field.to_bytes((bits + 7) // 8, "big"))
    return field << _CRC_BITS | crc, bits + _CRC_BITS


@lru_cache(maxsize=4096)  # a bus carries the same few frames again and again
def wire_bits(frame: CanFrame) -> int:
    """How many bits ``frame`` takes, stuff bits included, from SOF to the last bit of EOF.

    Without the intermission that follows.  44 to 132 bits for a standard frame.
    """
    field, bits = _unstuffed(frame)
    padding = -bits % 4  # recessive bits in front, as the idle bus has them: they stuff nothing
    field |= ((1 << padding) - 1) << bits
    run, sent = _IDLE_RUN, UNSTUFFED_TAIL_BITS - padding
    for shift in range(bits + padding - 4, -1, -4):
        four = field >> shift & 0xF
        sent += _SENT_BITS[run][four]
        run = _NEXT_RUN[run][four]
    return sent


def stuffed_bits(frame: CanFrame) -> str:
    """The bits as sent, ``0`` dominant, from SOF to the end of the CRC."""
    field, bits = _unstuffed(frame)
    padding = -bits % 4
    field |= ((1 << padding) - 1) << bits
    run, sent = _IDLE_RUN, ""
    for shift in range(bits + padding - 4, -1, -4):
        run, four = _STUFFED[run][field >> shift & 0xF]
        sent += f"{four:b}"[1:]
    return sent[padding:]
