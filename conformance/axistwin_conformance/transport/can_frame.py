"""Frames of a classical CAN bus: as values, and as bytes.

Gate, travel guard, meter, transcript and recordings of the engine take bytes, whatever carries
them.  A frame packed for them tells its own length, so that several may stand in a row:

    4 bytes   identifier, most significant first; top bit: 29-bit form, next bit: remote
    1 byte    length; of a remote frame the one it asks for
    n bytes   data
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

MOST_BYTES: Final = 8
STANDARD_IDENTIFIERS: Final = range(1 << 11)
EXTENDED_IDENTIFIERS: Final = range(1 << 29)

_EXTENDED: Final = 1 << 31
_REMOTE: Final = 1 << 30
_HEAD_BYTES: Final = 5


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame.

    `identifier`: 11 bits, or 29 if `is_extended`.  `data`: up to 8 bytes, none if `is_remote`.
    `asked_length`: how many bytes a remote frame asks for, 0..8.  Raises ValueError for what no
    CAN controller could send (our mistake).
    """

    identifier: int
    data: bytes = b""
    is_extended: bool = False
    is_remote: bool = False
    asked_length: int = 0

    def __post_init__(self) -> None:
        known = EXTENDED_IDENTIFIERS if self.is_extended else STANDARD_IDENTIFIERS
        if self.identifier not in known:
            raise ValueError(f"identifier {self.identifier:X}h is outside 0..{known[-1]:X}h")
        if len(self.data) > MOST_BYTES or not 0 <= self.asked_length <= MOST_BYTES:
            raise ValueError(f"{self.identifier:X}h: a frame carries 0 to {MOST_BYTES} bytes")
        if self.data if self.is_remote else self.asked_length:
            raise ValueError(f"{self.identifier:X}h: a remote frame asks for data, others carry it")

    @property
    def length(self) -> int:
        """The length field."""
        return self.asked_length if self.is_remote else len(self.data)

    @property
    def is_plain(self) -> bool:
        """True for a data frame with an 11-bit identifier."""
        return not (self.is_extended or self.is_remote)

    @property
    def least_bits(self) -> int:
        """How many bits it has on the bus at least: without stuffing, up to the end of frame."""
        return (64 if self.is_extended else 44) + 8 * len(self.data)

    def pack(self) -> bytes:
        """Give the bytes that stand for the frame."""
        head = self.identifier | _EXTENDED * self.is_extended | _REMOTE * self.is_remote
        return head.to_bytes(4, "big") + bytes([self.length]) + self.data

    @property
    def candump(self) -> str:
        """The frame as candump's log has it: 581#6013200000000000, 123#R8."""
        digits = 8 if self.is_extended else 3
        body = f"R{self.length}" if self.is_remote else self.data.hex().upper()
        return f"{self.identifier:0{digits}X}#{body}"

    def __str__(self) -> str:
        digits = 8 if self.is_extended else 3
        body = f"remote, {self.length}" if self.is_remote else self.data.hex(" ").upper()
        return f"{self.identifier:0{digits}X}h [{self.length}] {body}".rstrip()


def unpack(packed: bytes) -> Frame:
    """Give the one frame these bytes stand for; raises ValueError for any other bytes."""
    frames = unpack_all(packed)
    if len(frames) != 1:
        raise ValueError(f"{packed.hex(' ')} holds {len(frames)} frames, not one")
    return frames[0]


def unpack_all(packed: bytes) -> tuple[Frame, ...]:
    """Give the frames that stand in a row; raises ValueError if they do not end where bytes do."""
    return tuple(_frames(packed))


def _frames(packed: bytes) -> Iterator[Frame]:
    at = 0
    while at < len(packed):
        if at + _HEAD_BYTES > len(packed):
            raise ValueError(f"{packed.hex(' ')} ends within the head of a frame")
        head, length = int.from_bytes(packed[at : at + 4], "big"), packed[at + 4]
        at += _HEAD_BYTES
        is_remote = bool(head & _REMOTE)
        data = b"" if is_remote else packed[at : at + length]
        if not is_remote and len(data) != length:
            raise ValueError(f"{packed.hex(' ')} ends within the data of a frame")
        at += len(data)
        yield Frame(
            head & (_REMOTE - 1), data, bool(head & _EXTENDED), is_remote, length * is_remote
        )
