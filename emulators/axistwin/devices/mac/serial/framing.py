"""Expert frames as the module sees them: requests taken apart, replies put together.

    request  Stx 0 1 4 aa ii ss pppppppp cc Etx                21 bytes
    accepted Ack Xoff Xon            refused Ack Xoff Xonerror      3 bytes
    bad sum  Nack                                               1 byte
    answer   Ack Xoff Stx 0 1 1 aa i dddddddd cc Etx Xon       21 bytes

The sum runs over the characters aa..pppppppp (aa i dddddddd in an answer), modulo 100h, as two
upper-case digits (MACS-FRAME-03).  Digits are checked one by one before ``int`` sees them: alone it
would let ``+1``, `` 1`` and ``1_0`` pass (ledger §8.10).
"""

from functools import lru_cache
from typing import Final, NamedTuple

STX: Final = b"\x02"
ETX: Final = 0x03
ACK: Final = b"\x06"
NACK: Final = b"\x15"
XOFF: Final = b"\x13"

REQUEST_BYTES: Final = 21
GENERAL_ADDRESS: Final = 0xFF
ADDRESS_MAX: Final = 0x7F
REQUEST_LENGTH_FIELD: Final = b"014"
ANSWER_LENGTH_FIELD: Final = b"011"

HEX: Final[tuple[bytes, ...]] = tuple(b"%02X" % value for value in range(256))
UPPER: Final[dict[bytes, int]] = {text: value for value, text in enumerate(HEX)}
"""Two upper-case digits to their value."""

_UPPER_DIGITS = b"0123456789ABCDEF"
_DIGITS = b"0123456789ABCDEFabcdef"
ANY_CASE: Final[dict[bytes, int]] = {
    bytes((high, low)): int(bytes((high, low)), 16) for high in _DIGITS for low in _DIGITS
}
"""Two digits of either case to their value (``lowercase_hex`` = accept)."""


def checksum(characters: bytes) -> bytes:
    """The two digits cc of ``characters`` (MACS-FRAME-03)."""
    return HEX[sum(characters) & 0xFF]


def request(address: int, index: int, parameters: int = 0, sub_index: int = 0) -> bytes:
    """The request frame of a well-behaved host, all fields as numbers."""
    body = b"%02X%02X%02X%08X" % (address, index, sub_index, parameters & 0xFFFFFFFF)
    return b"\x02014" + body + checksum(body) + b"\x03"


class Request(NamedTuple):
    """What 21 bytes that begin with Stx say; None for what is not two digits."""

    address: int | None
    command: int | None
    is_framed: bool
    is_sum_right: bool


@lru_cache(maxsize=1024)  # a host that polls says the same all the time
def take_apart(frame: bytes, any_case: bool) -> Request:
    """``frame``, 21 bytes, as a module reads it that takes ``any_case`` of digits or upper only."""
    values = ANY_CASE if any_case else UPPER
    told = frame[18:20].upper() if any_case else frame[18:20]
    return Request(
        values.get(frame[4:6]),
        values.get(frame[6:8]),
        is_framed(frame),
        checksum(frame[4:18]) == told,
    )


def is_framed(frame: bytes) -> bool:
    """Whether 21 bytes that begin with Stx have the length field and Etx (MACS-FRAME-12)."""
    return frame[20] == ETX and frame[1:4] == REQUEST_LENGTH_FIELD


def number(digits: bytes, *, any_case: bool) -> int | None:
    """The value of hex ``digits``, first digit first; None where one is no digit."""
    if digits.translate(None, _DIGITS if any_case else _UPPER_DIGITS):
        return None
    return int(digits, 16)


@lru_cache(maxsize=256)
def answer(
    address: bytes, digit: bytes, data: int, length: bytes = ANSWER_LENGTH_FIELD, xon: int = 0x1A
) -> bytes:
    """The answer to a query: ``address`` and ``digit`` as characters, ``data`` unsigned 32 bit."""
    body = b"%b%b%08X" % (address, digit, data)
    return b"\x06\x13\x02%b%b%b\x03%c" % (length, body, HEX[sum(body) & 0xFF], xon)


def is_one_frame(data: bytes) -> bool:
    """Whether ``data`` is a frame and nothing else, what ``next_frame`` would find out too."""
    return len(data) == REQUEST_BYTES and data.rfind(STX) == 0


def next_frame(buffer: bytes, after: int) -> tuple[int, int]:
    """Start and end of the first whole frame from ``after`` on.

    (-1, n) if there is none: bytes before n can be forgotten, from n on a frame may grow.
    """
    start = buffer.find(STX, after)
    while start >= 0:
        end = start + REQUEST_BYTES
        again = buffer.rfind(STX, start + 1, end)
        if again < 0:
            return (start, end) if end <= len(buffer) else (-1, start)
        start = again
    return -1, len(buffer)
