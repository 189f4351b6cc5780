"""Bytes of the serial line into packets (ledger §2.7).

Rules
-----
1. A byte with bit 7 opens a packet.  The same byte behind at least one character closes it, and the
   next one is the sum, whatever its value below 80h (MN4-PKT-04).  Any other byte with bit 7 opens
   a packet anew, and what was there is forgotten (MN4-PKT-11, MN4-PKT-15).
2. Bytes without bit 7 outside a packet are ignored (MN4-PKT-10).
3. A packet that is not complete some time after its last byte is given up (MN4-AMB-51).  A byte
   that is complete just when that time is over has come in time.
4. A character with a bad stop bit is as if it had never been.
5. With ``mn100_codes`` a byte that opens a packet anew may also end the one before: if what follows
   is the right sum of all, that packet has two different addresses, or no command.
"""

import re
from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple

from axistwin.devices.mn400.link.packets import ADDRESS_BIT
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.framing import Chunk

_WHOLE: Final = re.compile(rb"([\x80-\xFF])([\x00-\x7F]+)\1[\x00-\x7F]")
"""A packet and nothing else, which most of what comes is."""


class Flaw(Enum):
    """What is wrong with a packet."""

    NONE = "nothing"
    TOO_LONG = "it has more characters than the buffer holds"
    CHECKSUM = "its sum is wrong"
    ADDRESS = "its two addresses differ"
    NO_COMMAND = "there is nothing between its addresses"
    INCOMPLETE = "it was not completed in time"


class Request(NamedTuple):
    """A packet for this board, complete at ``time_ns``: its payload.

    is_raw: a single byte outside any packet that ends the entry of a program (MN4-AMB-13).
    """

    time_ns: Nanos
    payload: bytes
    flaw: Flaw = Flaw.NONE
    is_for_all: bool = False
    is_raw: bool = False


class _Whole(NamedTuple):
    """``data``, a packet and nothing else, taken apart."""

    data: bytes
    opening: int
    payload: bytes
    flaw: Flaw


class _Frame:
    """What there is of a packet."""

    __slots__ = (
        *("_is_doubtful", "_payload_max", "doubted", "is_closed", "is_too_long"),
        *("opening", "payload", "total"),
    )

    def __init__(self, payload_max: int, *, is_doubtful: bool = False) -> None:
        self._payload_max = payload_max
        self._is_doubtful = is_doubtful
        self.open(0)

    def copy(self) -> "_Frame":
        """The same, apart."""
        other = _Frame(self._payload_max, is_doubtful=self._is_doubtful)
        other.opening, other.payload = self.opening, self.payload[:]
        other.is_closed, other.is_too_long = self.is_closed, self.is_too_long
        other.total, other.doubted = self.total, self.doubted
        return other

    def open(self, opening: int) -> None:
        """Begin; 0 is outside any packet."""
        self.opening = self.total = opening
        self.payload = bytearray()
        self.is_closed = self.is_too_long = False
        self.doubted: tuple[int, bytes, int] | None = None
        """Opening, payload and sum of the packet that may end here (rule 5)."""

    def take(self, byte: int) -> int | None:
        """One more byte (rule 1); the sum, if that is it."""
        if byte >= ADDRESS_BIT:
            if byte != self.opening or not self.payload or self.is_closed:
                before = (self.opening, bytes(self.payload), (self.total + byte) & 0x7F)
                is_doubted = self._is_doubtful and self.opening and not self.is_closed
                self.open(byte)
                self.doubted = before if is_doubted else None
            else:
                self.is_closed = True
                self.total += byte
            return None
        doubted, self.doubted = self.doubted, None
        if doubted is not None and doubted[2] == byte:
            self.opening, self.payload = doubted[0], bytearray(doubted[1])
            return byte
        if self.is_closed:
            return byte
        if self.opening:
            self.total += byte
            if len(self.payload) < self._payload_max:
                self.payload.append(byte)
            else:
                self.is_too_long = True
        return None


class PacketReceiver:
    """The receiving half of one board's port.

    address: gives the number of the board now.  ends_raw: gives the bytes that mean something by
    themselves now.
    """

    def __init__(
        self,
        quirks: Mn400Quirks,
        address: Callable[[], int],
        ends_raw: Callable[[], bytes],
        skew_ns: Nanos = 0,
    ) -> None:
        self._address = address
        self._ends_raw = ends_raw
        self._timeout_ns = quirks.rx_timeout_ms * NS_PER_MS + skew_ns
        self._payload_max = quirks.rx_payload_max
        self._is_doubtful = quirks.mn100_codes
        self._ends_packets = quirks.eof_framing == "packet"
        self._frame = _Frame(self._payload_max, is_doubtful=self._is_doubtful)
        self._last_whole = _Whole(b"", 0, b"", Flaw.NONE)
        self.due_ns = NEVER
        """When the packet is given up."""

    def reset(self) -> None:
        """Forget what there is of a packet."""
        self._frame.open(0)
        self.due_ns = NEVER

    def wake(self, now: Nanos) -> Request | None:
        """Give the packet up if it is time (rule 3); report what was for this board alone."""
        if self.due_ns > now:
            return None
        due, opening, payload = self.due_ns, self._frame.opening, bytes(self._frame.payload)
        self.reset()
        if opening != ADDRESS_BIT | self._address():
            return None
        return Request(due, payload, Flaw.INCOMPLETE)

    def receive(self, chunk: Chunk) -> list[Request]:
        """Take the bytes of ``chunk``; the packets for this board that are complete now."""
        whole = self._whole(chunk.data)
        if whole is not None:
            self.due_ns = NEVER
            data, opening, payload, flaw = whole
            if not self._concerns(opening):
                return []
            at_ns = chunk.arrival_ns(len(data) - 1)
            return [Request(at_ns, payload, flaw, opening == ADDRESS_BIT)]
        requests = []
        frame, raw = self._frame, self._ends_raw()
        for place, byte in enumerate(chunk.data):
            if not frame.opening and byte in raw:
                requests.append(Request(chunk.arrival_ns(place), bytes((byte,)), is_raw=True))
                continue
            given = frame.take(byte)
            if given is not None:
                if self._concerns(frame.opening):
                    requests.append(self._complete(chunk.arrival_ns(place), given))
                frame.open(0)
        last_ns = chunk.arrival_ns(len(chunk.data) - 1)
        self.due_ns = last_ns + self._timeout_ns if frame.opening else NEVER
        return requests

    def _whole(self, data: bytes) -> _Whole | None:
        """``data`` taken apart, if it is a packet and nothing else, whatever the readings."""
        if self._frame.opening or self._is_doubtful:
            return None
        if not self._ends_packets and self._ends_raw():
            return None
        if data != self._last_whole.data:  # hosts ask the same again and again
            if _WHOLE.fullmatch(data) is None:
                return None
            payload, flaw = data[1:-2], Flaw.NONE
            if len(payload) > self._payload_max:
                payload, flaw = payload[: self._payload_max], Flaw.TOO_LONG
            elif sum(data[:-1]) & 0x7F != data[-1]:
                flaw = Flaw.CHECKSUM
            self._last_whole = _Whole(data, data[0], payload, flaw)
        return self._last_whole

    def _concerns(self, opening: int) -> bool:
        return opening == ADDRESS_BIT or opening == ADDRESS_BIT | self._address()

    def _complete(self, now: Nanos, given: int) -> Request:
        """The packet is complete, with ``given`` as its sum."""
        frame = self._frame
        flaw = Flaw.NONE
        if not frame.is_closed:
            flaw = Flaw.ADDRESS if frame.payload else Flaw.NO_COMMAND
        elif frame.is_too_long:
            flaw = Flaw.TOO_LONG
        elif frame.total & 0x7F != given:
            flaw = Flaw.CHECKSUM
        return Request(now, bytes(frame.payload), flaw, frame.opening == ADDRESS_BIT)

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` complete no packet for this board."""
        whole = self._whole(data)
        if whole is not None:
            return len(data) - self._concerns(whole.opening)
        frame, raw = self._frame.copy(), self._ends_raw()
        for place, byte in enumerate(data):
            if not frame.opening and byte in raw:
                return place
            if frame.take(byte) is not None:
                if self._concerns(frame.opening):
                    return place
                frame.open(0)
        return len(data)
