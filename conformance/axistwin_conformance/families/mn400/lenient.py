"""Replies of the MN400 that are not as the manual asks, read all the same.

Each thing in which a reply departs is named with its requirement, once for each packet in which it
is so; `mended` is the reply as a sound board would have put it.  What the manual leaves open
(trailers, nulls of outcomes, the case of the command byte) is no departure.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from axistwin_conformance.core.lenient import COMPLETENESS, Lenient, ReplyDeparture
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import BoardPacket, ReturnCode
from axistwin_conformance.families.mn400.grammar import ReplyForm, rule_of

# Codes that stand where the answer of a command would, after START or alone.
LAST_CODES: Final = codec.CODES - {ReturnCode.START}
# Codes that come alone: a board that sends no START before them does right (MN4-ERR-03).
ALONE: Final = frozenset(
    {
        ReturnCode.CHKSUMERROR,
        ReturnCode.INVALIDCOMMAND,
        ReturnCode.TIMEOUT,
        ReturnCode.SLAVEBUFFOV,
    }
)
# What carries the null by what the manual prints or says; elsewhere it is open (MN4-AMB-03).
NULLED: Final = {
    ReturnCode.START: "MN4-RSP-01",
    ReturnCode.DONE: "MN4-RSP-02",
    ReturnCode.PRESENT: "MN4-CMD-POLL-01",
}


@dataclass(frozen=True, slots=True)
class _Piece:
    """A packet as it should have been, and in what the one that came departs from it."""

    departures: tuple[ReplyDeparture, ...]
    mended: bytes


def lenient(board: int, request: bytes, reply: bytes) -> Lenient | None:
    """The reply of a board to a request, sound or not; None: silence, or another protocol."""
    asked = codec.parse(request)
    found, strays = codec.packets(reply)
    if asked is None or not reply:
        return None
    if not found:
        is_begun = reply[0] == codec.address_byte(board) and strays == reply
        return Lenient((_incomplete("a whole packet", reply),), b"") if is_begun else None
    pieces = [_mended(board, asked.command, packet) for packet in found]
    departures = [departure for piece in pieces for departure in piece.departures]
    departures += _sequence(asked.command, found)
    if strays and reply.endswith(strays) and strays[0] >= codec.ADDRESS_MARK:
        departures.append(_incomplete("a whole packet", strays))
    elif strays:
        departures.append(
            ReplyDeparture("MN4-RSP-14", "strays", "packets alone", strays.hex(" ").upper())
        )
    elif not _is_over(asked.command, found):
        departures.append(_incomplete("a packet behind START", reply))
    return Lenient(tuple(departures), b"".join(_whole(board, asked.command, found, pieces)))


def _incomplete(expected: str, received: bytes) -> ReplyDeparture:
    return ReplyDeparture("MN4-RSP-03", COMPLETENESS, expected, received.hex(" ").upper())


def _is_over(command: str, found: tuple[BoardPacket, ...]) -> bool:
    """True if nothing more must come: the last packet is more than START, or START suffices."""
    return found[-1].code != ReturnCode.START or command == "&"


def _whole(
    board: int, command: str, found: tuple[BoardPacket, ...], pieces: list[_Piece]
) -> Iterator[bytes]:
    """The mended packets, with the START that a board has left out and without a DONE too many."""
    if _lacks_start(command, found):
        yield codec.status(board, found[0].command, ReturnCode.START)
    has_data = False
    for packet, piece in zip(found, pieces, strict=True):
        if not (has_data and packet.code == ReturnCode.DONE and command.upper() != "R"):
            yield piece.mended
        has_data = has_data or packet.code is None


def _mended(board: int, command: str, packet: BoardPacket) -> _Piece:
    """One packet against what is asked of every packet."""
    departures = []
    own = codec.address_byte(board)
    payload = packet.payload
    if packet.opening != own:
        departures.append(_byte("MN4-PKT-07", "address", own, packet.opening))
    if packet.closing != packet.opening:
        departures.append(_byte("MN4-PKT-02", "second address", packet.opening, packet.closing))
    right = codec.checksum(packet.raw[:-1])
    if packet.check != right:
        departures.append(_byte("MN4-PKT-03", "checksum", right, packet.check))
    if payload and packet.command.upper() != command.upper():
        wanted = ord(command.upper())
        departures.append(_byte("MN4-RSP-11", "command", wanted, payload[0]))
        payload = bytes([wanted]) + payload[1:]
    if packet.code in NULLED and not packet.has_null:
        name = NULLED[ReturnCode(packet.code)]
        departures.append(ReplyDeparture(name, "null", "00 behind the code", "none"))
        payload += codec.NULL
    return _Piece(tuple(departures), codec.request(board, payload))


def _byte(requirement: str, name: str, wanted: int, came: int) -> ReplyDeparture:
    return ReplyDeparture(requirement, name, f"{wanted:02X}h", f"{came:02X}h")


def _sequence(command: str, found: tuple[BoardPacket, ...]) -> Iterator[ReplyDeparture]:
    """In what the order of the packets departs from that of the manual (MN4-RSP-03, -04, -08)."""
    said = " ".join(codec.codes_of(found))
    is_repeat = command == "&"
    if is_repeat and len(found) > 1 and found[0].code == ReturnCode.START:
        yield ReplyDeparture("MN4-RSP-08", "START", "the last message alone", said)
    if _lacks_start(command, found):
        name = "MN4-RSP-04" if found[0].code is None else "MN4-RSP-03"
        yield ReplyDeparture(name, "no START", "START first", said)
    rule = rule_of(command)
    is_data = rule is not None and rule.form is ReplyForm.DATA
    if is_data and found[-1].code == ReturnCode.DONE and any(one.code is None for one in found):
        yield ReplyDeparture("MN4-RSP-04", "DONE behind data", "START and data", said)


def _lacks_start(command: str, found: tuple[BoardPacket, ...]) -> bool:
    """True if what came needs a START before it and has none."""
    first = found[0].code
    if command == "&" or first == ReturnCode.START:
        return False
    return first is None or (first in LAST_CODES - ALONE and first in NULLED)
