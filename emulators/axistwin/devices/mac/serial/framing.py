"""Expert frames as the module sees them: requests taken apart, replies put together.

    request  Stx 0 1 4 aa ii ss pppppppp cc Etx                21 bytes
    accepted Ack Xoff Xon            refused Ack Xoff Xonerror      3 bytes
    bad sum  Nack                                               1 byte
    answer   Ack Xoff Stx 0 1 1 aa i dddddddd cc Etx Xon       21 bytes

The sum runs over the characters aa..pppppppp (aa i dddddddd in an answer), modulo 100h, as two
upper-case digits (MACS-FRAME-03).  Digits are checked one by one before ``int`` sees them: alone it
would let ``+1``, `` 1`` and ``1_0`` pass (ledger §8.10).
"""

from collections.abc import Container, Iterable, Iterator, Mapping
from functools import lru_cache
from typing import Any, Final, NamedTuple

STX: Final = b"\x02"
ETX: Final = 0x03
ACK: Final = b"\x06"
NACK: Final = b"\x15"
XOFF: Final = b"\x13"
SHORT_REPLY_BYTES: Final = 3
ANSWER_BYTES: Final = 21

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


class MacRequest(NamedTuple):
    """What 21 bytes that begin with Stx say; None for what is not two digits."""

    address: int | None
    command: int | None
    is_framed: bool
    is_sum_right: bool


@lru_cache(maxsize=1024)  # a host that polls says the same all the time
def take_apart(frame: bytes, any_case: bool) -> MacRequest:
    """``frame``, 21 bytes, as a module reads it that takes ``any_case`` of digits or upper only."""
    values = ANY_CASE if any_case else UPPER
    told = frame[18:20].upper() if any_case else frame[18:20]
    return MacRequest(
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


class FrameReception:
    """The frame that is being heard, by all modules that have heard the same.

    any_case: how they read digits.  ``partial``: the bytes of the frame so far.
    """

    __slots__ = ("_seen", "_seen_request", "any_case", "partial")

    def __init__(self, *, any_case: bool, partial: bytes = b"") -> None:
        self.any_case = any_case
        self.partial = partial
        self._seen = b""
        self._seen_request: MacRequest | None = None

    def is_like(self, other: Any) -> bool:
        """Whether both are at the same place in the same frame, and read it alike."""
        return (
            isinstance(other, FrameReception)
            and self.partial == other.partial
            and self.any_case == other.any_case
        )

    def copy(self) -> "FrameReception":
        """The same, apart."""
        return FrameReception(any_case=self.any_case, partial=self.partial)

    def lone_request(self, data: bytes) -> MacRequest | None:
        """``data`` taken apart if it is one frame and nothing else, and none has begun before it.

        What has begun does not count, since a frame begins anew at each Stx.  Remembered, since the
        line asks for the ``quiet_prefix`` of what it hands over next.
        """
        if data is not self._seen:
            self._seen = data
            self._seen_request = take_apart(data, self.any_case) if is_one_frame(data) else None
        return self._seen_request

    def frames(self, data: bytes) -> Iterable[tuple[MacRequest, int]]:
        """The frames that ``data`` completes, and behind which of its bytes each ends."""
        request = self.lone_request(data)
        return self._found_in(data) if request is None else ((request, REQUEST_BYTES),)

    def _found_in(self, data: bytes) -> Iterator[tuple[MacRequest, int]]:
        kept = len(self.partial)
        buffer = self.partial + data
        start, end = next_frame(buffer, 0)
        while start >= 0:
            yield take_apart(buffer[start:end], self.any_case), end - kept
            start, end = next_frame(buffer, end)

    def quiet_prefix(self, data: bytes, addresses: Container[int | None] | None) -> int:
        """Everything before the last byte of the first frame for all or one of ``addresses``.

        None: everything concerns.
        """
        for request, end in self.frames(data):
            address = request.address
            if addresses is None or address == GENERAL_ADDRESS or address in addresses:
                return end - 1
        return len(data)

    def addressed(self, data: bytes, at_address: Mapping[int, list[int]]) -> list[int]:
        """Whom the frame that ends with ``data`` concerns, of those at their addresses."""
        for request, end in self.frames(data):
            if end == len(data):
                if request.address == GENERAL_ADDRESS:
                    return [each for group in at_address.values() for each in group]
                if request.address is not None:
                    return list(at_address.get(request.address, ()))
        return []

    def hear(self, data: bytes) -> None:
        """Take ``data``; no frame that it completes matters."""
        if self.lone_request(data) is not None:
            self.partial = b""
            return
        buffer = self.partial + data
        start, end = next_frame(buffer, 0)
        while start >= 0:
            start, end = next_frame(buffer, end)
        self.partial = buffer[end:]


def completed(data: bytes) -> bytes:
    """``data``, a request as far as its parameters, with sum and Etx; anything else as it is."""
    if len(data) == REQUEST_BYTES - 3 and data.startswith(STX + REQUEST_LENGTH_FIELD):
        return data + checksum(data[4:]) + bytes((ETX,))
    return data


def is_whole_reply(reply: bytes) -> bool:
    """Whether ``reply`` is a Nack, an acknowledgement, or one with its answer, whole."""
    if reply[:1] == NACK:
        return True
    size = SHORT_REPLY_BYTES if reply[2:3] != b"\x02" else ANSWER_BYTES
    return reply[:1] == ACK and len(reply) >= size
