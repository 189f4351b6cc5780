"""What a unit says, read also where it is not as the manual asks, each departure by its name.

    signs | header, 6 | NAME | , | payload | checksum, 2

The name of the command that was sent is what everything else is found by: a reply has it behind its
header, whatever is wrong with either.  What the size of the payload has to be is known; where sum
and announced length fit another size, that is what the unit means.

    signs      ACK alone (MSC-LNK-01), once (MSC-LNK-04), before the packet (MSC-LNK-07)
    header     6 bytes (MSC-PKT-01), begun by 02h (MSC-PKT-02), the unit's number (MSC-PKT-18), what
               the body has (MSC-PKT-06), high byte first (MSC-PKT-08)
    body       the name and a comma (MSC-CMD-04), the size of the command's own row
    checksum   two bytes, high byte first (MSC-PKT-11), over unit to body (MSC-PKT-12), eight bits
               each (MSC-PHY-01)

The block number may be any (MSC-AMB-10), what follows the status word too (MSC-RQSTAT-03).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.core.lenient import COMPLETENESS, Lenient, ReplyDeparture
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, COMMA, HEADER_BYTES, MOST_STRAYS, NAK, STX

SIZE_ROW: Final = {"BREAD": "02", "DREAD": "02", "RFLAG": "02", "RFLAGS": "01", "RQSTAT": "01"}
MOST_BEFORE_NAME: Final = MOST_STRAYS + HEADER_BYTES  # signs and a header, or what is made of them
SHORT_STATUS: Final = 6  # bytes behind the comma (MSC-AMB-38)
SUM_DIGITS: Final = 4
SEVEN_BITS: Final = 0x7F7F
HEX: Final = frozenset(b"0123456789ABCDEFabcdef")
LOST_BITS: Final = "7 of a value's"
ASCII_STATES: Final[Mapping[int, int]] = {0x30: 0, 0x31: 1, 0x3030: 0, 0x3031: 1}

# What a wrong sum may be over instead, of a packet's bytes up to its own.
COVERAGES: Final[Mapping[str, Callable[[bytes], int]]] = {
    "the start byte too": sum,
    "not the unit": lambda raw: sum(raw[2:]),
    "the body alone": lambda raw: sum(raw[HEADER_BYTES:]),
    "not the length": lambda raw: sum(raw[1:2] + raw[4:]),
    "what is behind the comma": lambda raw: sum(raw.partition(COMMA)[2]),
    "all, in one byte": lambda raw: sum(raw[1:]) & 0xFF,
    "all, in two's complement": lambda raw: -sum(raw[1:]),
    "all, inverted": lambda raw: ~sum(raw[1:]),
}


@dataclass(frozen=True, slots=True)
class _Found:
    """A packet, or its beginning, at the head of some bytes: how it departs, what a sound unit
    would have sent, and how many bytes it has; 0: it is not whole, and its first byte is known."""

    departures: tuple[ReplyDeparture, ...]
    mended: bytes
    size: int


def lenient(session: Session, request: bytes, reply: bytes) -> Lenient | None:
    """What came of a sound request, or of our answer to a reply, which asks for that again; None
    for nothing that a unit could mean by it."""
    if not reply:
        return None
    if request == NAK:
        return _repeats(session, reply)
    question = codec.parse(request)
    if question is None or not question.is_request or question.unit != session.address:
        return None
    if question.name in codec.WRITES:
        return _sign(reply)
    if reply == NAK:
        return Lenient((), reply)
    if question.name == "RFLAGS" and not session.run.model.facts.has_rflags and reply == ACK:
        return Lenient((), reply)  # MSC-AMB-06
    return _answer(question.name, session.address, reply)


def _sign(reply: bytes) -> Lenient | None:
    """What came of a write; a packet may follow its ACK (MSC-AMB-36)."""
    if reply[:1] in (ACK, NAK):
        is_twice = reply == ACK * len(reply) and len(reply) > 1
        return Lenient((_twice(reply),), ACK) if is_twice else Lenient((), reply)
    return Lenient((_not_acked(reply),), ACK) if len(reply) == 1 else None


def _repeats(session: Session, reply: bytes) -> Lenient:
    """A packet that comes again, to a NAK: nothing stands before it (MSC-LNK-10)."""
    for name in sorted(codec.READS, key=len, reverse=True):
        misnamed, right = _renamed(name, reply)
        if misnamed or 0 <= reply.find(name.encode()) <= HEADER_BYTES:
            found = _packets(name, session.address, right)
            return Lenient((*misnamed, *found.departures), found.mended)
    return Lenient((_incomplete(reply),), STX if reply[:1] == STX else b"")


def _answer(name: str, unit: int, reply: bytes) -> Lenient | None:
    """What came of a read."""
    at = reply.find(name.encode(), 0, MOST_BEFORE_NAME + len(name))
    if at < 0:
        signs = ACK if reply[:1] == ACK else b""
        misnamed, right = _renamed(name, reply[len(signs) :])
        answer = _answer(name, unit, signs + right) if misnamed else None
        if answer is None:
            return _unnamed(name, reply)
        return replace(answer, departures=(*misnamed, *answer.departures))
    signs, header = _parted(reply[:at])
    found = _packets(name, unit, header + reply[at:])
    departures = list(found.departures)
    behind = (header + reply[at:])[found.size :] if found.size else b""
    if not signs and behind == ACK:
        departures.append(
            ReplyDeparture("MSC-LNK-07", "order", "ACK, then the packet", "ACK behind it")
        )
        departures = [one for one in departures if one.name != "surplus"]
    elif signs != ACK:
        is_twice = len(signs) > 1 and signs == ACK * len(signs)
        departures.append(_twice(signs) if is_twice else _not_acked(signs))
    is_whole = bool(found.mended) or any(one.name == COMPLETENESS for one in departures)
    return Lenient(tuple(departures), ACK + found.mended if is_whole else b"")


def _parted(lead: bytes) -> tuple[bytes, bytes]:
    """What stands before a name, as signs and header."""
    if lead[-HEADER_BYTES : -HEADER_BYTES + 1] == STX and len(lead) >= HEADER_BYTES:
        return lead[:-HEADER_BYTES], lead[-HEADER_BYTES:]
    return (lead[:1], lead[1:]) if lead[:1] in (ACK, NAK) else (b"", lead)


def _renamed(name: str, data: bytes) -> tuple[tuple[ReplyDeparture, ...], bytes]:
    """Packets under that name that have another in its place: that, and how they should be.

    The sum of the packet has to be that of the right name: who wrote the wrong one has meant it.
    """
    came = data[HEADER_BYTES:].partition(COMMA)[0]
    right = data.replace(came + COMMA, name.encode() + COMMA) if came else data
    length = int.from_bytes(data[2:4], "big")
    if right == data or not codec.is_whole(right[: codec.AROUND_BODY + length]):
        return (), data
    actual = came.decode("latin-1")
    return (ReplyDeparture("MSC-CMD-04", "name in place", name, actual),), right


def _unnamed(name: str, reply: bytes) -> Lenient | None:
    """A reply without the name: its beginning, or one with another name in its place, of which
    nobody knows what it answers."""
    signs, packet = (ACK, reply[1:]) if reply[:1] == ACK else (b"", reply)
    if not packet:
        return Lenient((_incomplete(reply),), ACK)
    if packet[:1] != STX:
        return None
    if codec.missing_bytes(packet):
        return Lenient((_incomplete(reply),), signs and ACK + STX)
    parsed = codec.parse(packet)
    if parsed is None or not parsed.is_sound:
        return None
    return Lenient((ReplyDeparture("MSC-CMD-04", "name", name, parsed.name),), b"")


def _packets(name: str, unit: int, data: bytes) -> _Found:
    """The packet that bytes begin with, and its repeats."""
    found = _packet(name, unit, data)
    behind = data[found.size :] if found.size else b""
    if not behind or not found.mended:
        return found
    if behind[:1] not in (STX, data[:1]):
        surplus = ReplyDeparture("MSC-LNK-04", "surplus", "nothing more", behind.hex(" ").upper())
        return _Found((*found.departures, surplus), found.mended, found.size)
    again = _packets(name, unit, behind)
    departures = dict.fromkeys((*found.departures, *again.departures))
    size = found.size + again.size if again.size else 0
    return _Found(tuple(departures), found.mended + again.mended, size)


# --- one packet -----------------------------------------------------------------------------------


def _packet(name: str, unit: int, data: bytes) -> _Found:
    """The packet with that name that bytes begin with."""
    at = data.find(name.encode())
    if at < 0:
        return _Found((_incomplete(data),), STX, 0)
    readings = tuple(_readings(name, data[:at], data[at + len(name) :]))
    for is_meant in (_is_sized, _is_summed, _is_plain):
        for reading in filter(is_meant, readings):
            return reading.found(unit)
    return _Found((_incomplete(data),), STX, 0)


@dataclass(frozen=True, slots=True)
class _Reading:
    """One way to take a packet apart; `comma`, `check`: as they came; `behind`: what follows."""

    name: str
    header: bytes
    comma: bytes
    payload: bytes
    check: bytes
    behind: bytes

    @property
    def size(self) -> int:
        """Of the whole."""
        return len(self.raw) + len(self.check)

    @property
    def raw(self) -> bytes:
        """All but the checksum, as it came."""
        return self.header + self.name.encode() + self.comma + self.payload

    @property
    def _summed(self) -> bytes:
        """The same, to be summed: the first byte is none of it."""
        return STX + self.raw if self._is_unbegun else self.raw

    @property
    def _is_unbegun(self) -> bool:
        """True if the header lacks its first byte."""
        return len(self.header) == HEADER_BYTES - 1 and self.header[:1] != STX

    @property
    def right(self) -> int:
        """The sum it should have."""
        return codec.checksum(self._summed[1:])

    @property
    def announced(self) -> int:
        """The length that its header tells; -1 if it has none."""
        if len(self.header) != HEADER_BYTES - self._is_unbegun:
            return -1
        return int.from_bytes(self._summed[2:4], "big")

    @property
    def body_bytes(self) -> int:
        """What the body has."""
        return len(self.name) + len(self.comma) + len(self.payload)

    @property
    def has_size(self) -> bool:
        """True if the payload has the size of the command's reply."""
        is_short = self.name == "RQSTAT" and self.announced == self.body_bytes
        sizes = (codec.REPLY_PAYLOADS[self.name], *(SHORT_STATUS,) * is_short)
        return len(self.payload) in sizes

    def found(self, unit: int) -> _Found:
        """What is wrong with it, and how it should be."""
        departures = (*self._of_header(unit), *self._of_body(), *self._of_sum())
        payload = self._payload()
        if payload is None or any(one.actual == LOST_BITS for one in departures):
            return _Found(departures, b"", self.size)
        block = int.from_bytes(self._summed[4:6], "big") if self.announced >= 0 else 0
        mended = codec.packet(unit, codec.body(self.name, payload), block)
        return _Found(departures, mended, self.size)

    def _of_header(self, unit: int) -> Iterator[ReplyDeparture]:
        if self._is_unbegun:
            yield ReplyDeparture("MSC-PKT-02", "start byte", "02", "nothing")
        elif len(self.header) != HEADER_BYTES:
            yield ReplyDeparture("MSC-PKT-01", "header", "6 bytes", f"{len(self.header)} bytes")
            return
        elif self.header[:1] != STX:
            yield ReplyDeparture("MSC-PKT-02", "start byte", "02", f"{self.header[0]:02X}")
        header = self._summed
        if header[1] != unit:
            yield ReplyDeparture("MSC-PKT-18", "unit", f"{unit}", f"{header[1]}")
        if self.announced == self.body_bytes:
            return
        if int.from_bytes(header[2:4], "little") == self.body_bytes:
            order = header[2:4].hex(" ").upper()
            yield ReplyDeparture("MSC-PKT-08", "length byte order", "high byte first", order)
        else:
            yield ReplyDeparture("MSC-PKT-06", "length", f"{self.body_bytes}", f"{self.announced}")

    def _of_body(self) -> Iterator[ReplyDeparture]:
        if self.comma != COMMA:
            came = self.comma.hex().upper() or "nothing"
            yield ReplyDeparture("MSC-CMD-04", "comma", "a comma behind the name", came)
        if self.body_bytes > codec.MAX_BODY:
            most = f"{codec.MAX_BODY} bytes at most"
            yield ReplyDeparture("MSC-PKT-10", "body", most, f"{self.body_bytes} bytes")
        if not self.has_size:
            row = f"MSC-{self.name}-{SIZE_ROW[self.name]}"
            size = codec.REPLY_PAYLOADS[self.name]
            yield ReplyDeparture(row, "size", f"{size} bytes", f"{len(self.payload)} bytes")
        state = int.from_bytes(self.payload, "big")
        if self.name == "RFLAG" and self.has_size and state not in (0, 1):
            yield ReplyDeparture("MSC-RFLAG-02", "flag state", "0 or 1", self.payload.hex().upper())

    def _of_sum(self) -> Iterator[ReplyDeparture]:
        if self.check == codec.u16(self.right):
            return
        right, came = f"{self.right:04X}", self.check.hex().upper() or "nothing"
        if len(self.check) != codec.CHECKSUM_BYTES:
            kind = {0: "", SUM_DIGITS: " digits"}.get(len(self.check), " width")
            yield ReplyDeparture("MSC-PKT-11", f"checksum{kind}", f"{right} in 2 bytes", came)
        elif self.check[::-1] == codec.u16(self.right):
            yield ReplyDeparture(
                "MSC-PKT-11", "checksum byte order", f"{right}, high byte first", came
            )
        elif kind := self._lost_bits():
            yield ReplyDeparture("MSC-PHY-01", "data bits", "8 of each byte", kind)
        else:
            value = int.from_bytes(self.check, "big")
            fits = [
                f", the sum over {what}"
                for what, of in COVERAGES.items()
                if of(self._summed) & 0xFFFF == value
            ]
            yield ReplyDeparture("MSC-PKT-12", "checksum", right, came + "".join(fits[:1]))

    def _lost_bits(self) -> str:
        """What a line of seven bits has left of it; empty: that is not what is wrong."""
        if any(byte > 0x7F for byte in self.raw + self.check):
            return ""
        came = int.from_bytes(self.check, "big")
        if self.right & SEVEN_BITS == came:
            return "7 of the checksum's"
        lost = (self.right + 0x80 * count for count in range(1, codec.VALUE_BYTES + 1))
        is_few = len(self.payload) <= codec.VALUE_BYTES
        return LOST_BITS if is_few and any(one & SEVEN_BITS == came for one in lost) else ""

    def _payload(self) -> bytes | None:
        """The payload as it should be; None where nobody knows."""
        size = codec.REPLY_PAYLOADS[self.name]
        if self.body_bytes > codec.MAX_BODY:  # more than a packet may have is nobody's to cut
            return None
        if self.name == "RFLAG":
            state = int.from_bytes(self.payload, "big")
            return codec.u16(ASCII_STATES.get(state, int(state != 0))) if self.payload else None
        if self.name == "RQSTAT" and len(self.payload) >= 2:  # the rest may be anything
            return self.payload if self.has_size else self.payload[:size].ljust(size, b"\0")
        return self.payload[:size] if len(self.payload) >= size else None


def _is_sized(reading: _Reading) -> bool:
    """True if sum and size are right."""
    return reading.has_size and _is_summed(reading)


def _is_summed(reading: _Reading) -> bool:
    """True if the sum is right, in whatever form: that is no chance."""
    if len(reading.check) == SUM_DIGITS:
        return HEX.issuperset(reading.check) and int(reading.check, 16) == reading.right
    if len(reading.check) == codec.CHECKSUM_BYTES:
        return reading.check == codec.u16(reading.right)
    # The same again follows: what is between, if anything, is all there is of a sum.
    is_meant = reading.announced == reading.body_bytes
    return is_meant and reading.behind.startswith(reading.header)


def _is_plain(reading: _Reading) -> bool:
    """True if all is there, whatever the sum is."""
    has_sum = len(reading.check) == codec.CHECKSUM_BYTES
    is_meant = reading.announced == reading.body_bytes
    return (has_sum and reading.has_size) or (is_meant and len(reading.check) < SUM_DIGITS)


def _readings(name: str, header: bytes, tail: bytes) -> Iterator[_Reading]:
    """The ways to take apart what follows a name, the most likely first."""
    usual, checked = codec.REPLY_PAYLOADS[name], codec.CHECKSUM_BYTES
    length = int.from_bytes(header[-4:-2], "big") if len(header) >= HEADER_BYTES - 1 else 0
    for comma in (tail[:1], b""):
        if comma != tail[:1] and tail[:1] == COMMA:
            continue
        data = tail[len(comma) :]
        announced = length - len(name) - len(comma)
        for size in dict.fromkeys((usual, announced, len(data) - checked)):
            for check in (checked, SUM_DIGITS, 1, 0):
                end = size + check
                behind = data[end:]
                is_usual = check == checked or not behind or behind.startswith(header)
                if size >= 0 and end <= len(data) and is_usual:
                    yield _Reading(name, header, comma, data[:size], data[size:end], behind)


# --- departures that several have -----------------------------------------------------------------


def _incomplete(reply: bytes) -> ReplyDeparture:
    is_sign = reply == ACK
    requirement = "MSC-CMD-05" if is_sign else "MSC-PKT-01"
    came = "ACK alone" if is_sign else reply.hex(" ").upper()
    return ReplyDeparture(requirement, COMPLETENESS, "ACK and a whole packet", came)


def _not_acked(signs: bytes) -> ReplyDeparture:
    came = signs.hex(" ").upper() or "nothing"
    return ReplyDeparture("MSC-LNK-01", "acknowledgement", "ACK first", came)


def _twice(signs: bytes) -> ReplyDeparture:
    return ReplyDeparture("MSC-LNK-04", "acknowledgements", "one ACK", f"{len(signs)} of them")
