"""What may be sent to a controller that works a machine: the classes of the ledger, byte by byte.

Rules.

1. The name of a writing command leaves us only in a check that declares it, and only with an
   address or flag that the operator has named, whatever else is wrong with the packet: a device
   that fails to look at the checksum has just written.  It is looked for in everything that is
   sent, in pieces or inside the values of a block.  Checks that send such packets on purpose are of
   class negative.
2. What a device would take for a packet, its sum being right, is one of the nine commands, of its
   right size, at an even address, with a flag below 256: commands that nobody has documented load
   and start macroprograms on the same port.  Anything else needs a check of class rig; and even
   there, on a real controller, only names that no maker can have given, or, if the check is of
   class negative, a write of a wrong size to a place that may be written all the same.
3. In checks of class rig a twin may be sent anything.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final
from weakref import WeakKeyDictionary

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, STX
from axistwin_conformance.families.msc.scratch import may_set, may_write
from axistwin_conformance.transport.transport import is_twin_url

TAIL_BYTES: Final = 2 * codec.MAX_PACKET  # of what was sent in pieces
MOST_FLAGS: Final = len(codec.FLAGS)

_WRITE: Final = re.compile(rb"(BWRITE|DWRITE|CFLAG|SFLAG),?+(?=(..))", re.DOTALL | re.IGNORECASE)
_AT_AN_ADDRESS: Final = ("BREAD", "BWRITE", "DREAD", "DWRITE")
_OF_A_FLAG: Final = ("CFLAG", "RFLAG", "SFLAG")

IMPACT: Final[Mapping[str, str]] = {
    "passive": "reads (BREAD, DREAD, RFLAG, RFLAGS, RQSTAT), and reads that are cut short or under"
    " a wrong checksum; bytes that are no packet",
    "stored": "writes variables (DWRITE, BWRITE, of --variables) and flags (SFLAG, CFLAG, of"
    " --flags)",
    "negative": "sends writes that no unit may carry out (DWRITE, BWRITE, SFLAG, CFLAG): under a"
    " wrong checksum, cut short, to a unit that is not there; with 'rig', of a wrong size",
    "motion": "lets the bench program work (SFLAG, CFLAG and BWRITE of --bench-program)",
    "rig": "power, inputs, status and macroprogram are worked; unknown names, bodies of a wrong"
    " size and odd addresses are sent",
}


@dataclass(frozen=True, slots=True)
class Writing:
    """What asks a device to write: the command's name, the address or the flag."""

    name: str
    number: int

    @property
    def is_of_flag(self) -> bool:
        """True for SFLAG and CFLAG."""
        return self.name in _OF_A_FLAG


@lru_cache(maxsize=4096)
def writings(data: bytes, fresh: int = 0) -> tuple[Writing, ...]:
    """Everything in these bytes that a device could carry out as a write, whatever surrounds it.

    `fresh`: what ends before that place is left out.  A missing comma does not save it.
    """
    found = []
    for match in _WRITE.finditer(data):
        name, number = match[1].decode().upper(), int.from_bytes(match[2], "big")
        if match.end() + 2 > fresh:
            found.append(Writing(name, number))
    return tuple(found)


@lru_cache(maxsize=4096)
def packets(data: bytes, fresh: int = 0) -> tuple[codec.Packet, ...]:
    """Everything in these bytes that a device could take for a packet, its sum being right."""
    return tuple(packet for end, packet in _packets(data) if end > fresh)


def _packets(data: bytes) -> Iterator[tuple[int, codec.Packet]]:
    at = data.find(STX)
    while 0 <= at <= len(data) - codec.AROUND_BODY:
        end = at + codec.AROUND_BODY + int.from_bytes(data[at + 2 : at + 4], "big")
        packet = codec.parse(data[at:end]) if end <= len(data) else None
        if packet is not None and codec.checksum(packet.raw[1:-2]) == packet.checksum:
            yield end, packet
        at = data.find(STX, at + 1)


def is_harmless(data: bytes) -> bool:
    """True if no device could take any of these bytes for a packet, or for part of a write."""
    return not writings(data) and not packets(data)


# --- the guard ------------------------------------------------------------------------------------

_tails: WeakKeyDictionary[Session, bytes] = WeakKeyDictionary()


def objection(session: Session, data: bytes) -> str | None:
    """Why these bytes must not be sent now, after what this check has sent before; None: they may.

    What a write asks for is kept in the run's memory, to be looked at when things are put back.
    """
    check, run = session.check, session.run
    before = _tails.get(session, b"")
    if check is None or (data in (ACK, NAK) and not before):
        return None
    window = before + data
    asked = writings(window, len(before))
    if asked and run.memory is not None:
        run.memory.touched.update(asked)
    _tails[session] = b"" if _is_whole(data) else window[-TAIL_BYTES:]
    is_rig = "rig" in check.safety
    if is_rig and is_twin_url(run.target.description):
        return None
    for writing in asked:
        if reason := _unwritable(session, writing):
            return reason
    if data[:1] == STX and _announced(data) > codec.MAX_BODY and not is_rig:
        return f"a header that announces {_announced(data)} bytes needs a check of class rig"
    for found in packets(window, len(before)):
        reason = _strange(found, has_rflags=run.model.facts.has_rflags)
        is_known = _is_known_to_be_strange(found) or _is_misfit(session, found)
        if reason and not (is_rig and is_known):
            return f"{reason} needs {'a twin' if is_rig else 'a check of class rig'}"
    return None


@lru_cache(maxsize=4096)
def _is_whole(data: bytes) -> bool:
    """True for one sound request: nothing of it waits for more."""
    packet = codec.parse(data)
    return packet is not None and packet.is_sound


def _announced(data: bytes) -> int:
    """The length that a packet's header tells; 0 while it is not whole, or not of a unit."""
    is_header = len(data) >= codec.HEADER_BYTES and data[1] in codec.UNITS
    return int.from_bytes(data[2:4], "big") if is_header else 0


def _unwritable(session: Session, writing: Writing) -> str | None:
    """Why a write is refused (rule 1)."""
    assert session.check is not None, "hooks of the family write what they have read"
    if not {"stored", "motion", "rig"} & set(session.check.safety):
        return f"{writing.name} is stored, which this check does not declare"
    if writing.is_of_flag:
        if may_set(session, writing.number):
            return None
        return f"{writing.name} {writing.number}: not a flag named by --flags"
    values = codec.BLOCK_VALUES if writing.name == "BWRITE" else 1
    if may_write(session, writing.number, values):
        return None
    return f"{writing.name} {writing.number}: not inside the addresses named by --variables"


@lru_cache(maxsize=4096)
def _strange(packet: codec.Packet, *, has_rflags: bool) -> str:
    """What is unusual about a packet whose sum is right (rule 2); empty if nothing is."""
    if packet.length > codec.MAX_BODY:
        return f"a body of {packet.length} bytes"
    if codec.COMMA not in packet.body or packet.name not in codec.NAMES:
        return f"the name {packet.name!r}"
    if len(packet.payload) != codec.REQUEST_PAYLOADS[packet.name]:
        return f"{packet.name} with {len(packet.payload)} bytes behind its comma"
    if packet.name == "RFLAGS" and not has_rflags:
        return "RFLAGS, which this model does not have,"
    if packet.name in _AT_AN_ADDRESS and packet.numbers[0] % 2:
        return f"the odd address {packet.numbers[0]}"
    if packet.name in _OF_A_FLAG and packet.numbers[0] >= MOST_FLAGS:
        return f"flag {packet.numbers[0]}"
    return ""


def _is_misfit(session: Session, packet: codec.Packet) -> bool:
    """True for a write of a wrong size that does no harm whatever a device takes of it: its place,
    and all that its values may reach, is the operator's to give."""
    assert session.check is not None, "hooks of the family write what they have read"
    is_whole = codec.COMMA in packet.body and len(packet.payload) >= 2
    if "negative" not in session.check.safety or packet.name not in codec.WRITES or not is_whole:
        return False
    number = packet.numbers[0]
    if packet.name in _OF_A_FLAG:
        return may_set(session, number)
    least = codec.BLOCK_VALUES if packet.name == "BWRITE" else 1
    reached = -(-(len(packet.payload) - 2) // codec.VALUE_BYTES)
    return number % 2 == 0 and may_write(session, number, max(least, reached))


def _is_known_to_be_strange(packet: codec.Packet) -> bool:
    """True for what a real controller may be sent on a bench: a read that is wrong in its size,
    its spelling or its number, and names no command can have: the one that is all Z, and those of
    reads with Zs or blanks around them."""
    name = packet.name.strip(" Z").upper()
    return (
        name in codec.READS
        or (packet.name.upper() in ("", codec.IMPOSSIBLE_NAME))
        or packet.length > codec.MAX_BODY
    )
