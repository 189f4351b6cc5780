"""What bytes may do to an MN400, whatever surrounds them: by that they are allowed or not.

A board looks for an address, a command, an address and a sum; a board that is broken may not look
at the sum, at the id, or at where a frame ends.  So every command in the bytes counts that stands
behind an address byte, whole or not.

1. What moves an axis or switches an output is motion; so is what goes on with a motion.
2. What stores a program is stored; what changes address, rate or configuration is destructive,
   unless it names what the board has already, or what none can have.
3. Everything else is passive: it reads, stops, or sets what the snapshot puts back.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from typing import Final

from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.words import command_words

MOVING: Final = "A+MTUC}"
STORING: Final = "Z"
CHANGING: Final = ".=~"
PAYLOADS: Final = re.compile(rb"[\x80-\xff]+([\x00-\x7f]+)")
NO_MOTION: Final = re.compile("[Mm],*")  # a move without any displacement (MN4-CMD-M-04)
JOG_MODE: Final = re.compile("[Jj] *0*1")
NUMBER_TEXT: Final = re.compile("-?[0-9]+")


@lru_cache(maxsize=4096)
def texts(data: bytes) -> tuple[str, ...]:
    """All commands in these bytes with what stands behind them."""
    return tuple(_texts(data))


def _texts(data: bytes) -> Iterator[str]:
    """What stands behind each address; a sum that was sent there begins no command by itself, but a
    board that has lost its place may take it for one."""
    for match in PAYLOADS.finditer(data):
        text = match[1].decode("latin-1")
        if match.end() == len(data) and len(text) == 1 and _ends_packet(data):
            continue
        yield text


def _ends_packet(data: bytes) -> bool:
    """True if the last byte is the sum of a whole packet that begins with the last but one address
    in these bytes: what was sent before it, is no part of it."""
    *_, opening, closing = [-1, -1, *(at for at, byte in enumerate(data) if byte > 0x7F)]
    begun = data[opening:] if opening >= 0 else b""
    return closing == len(data) - 2 and codec.packet_end(begun) == len(begun) > 0


def danger(text: str, board: int, rate: int) -> str:
    """The safety class of a command, for a board of that id at that rate (baud)."""
    letter = text[:1].upper()
    if letter in MOVING and letter:
        return "passive" if NO_MOTION.fullmatch(text) else "motion"
    if JOG_MODE.match(text):
        return "motion"
    if letter and letter in STORING:
        return "stored"
    if letter and letter in CHANGING:
        return "passive" if _keeps(letter, text[1:], board, rate) else "destructive"
    return "passive"


def _keeps(letter: str, body: str, board: int, rate: int) -> bool:
    """True for an address or a rate that the board has, or that none has."""
    if letter == "." or NUMBER_TEXT.fullmatch(body) is None:
        return letter != "." and body == ""
    number = codec.number_in(body)
    if letter == "=":
        return number == board or number not in codec.IDS
    return number not in range(len(codec.RATES)) or codec.RATES[number] == rate


def objection(data: bytes, allowed: frozenset[str], board: int, rate: int) -> str | None:
    """Why these bytes must not be sent by a check of these classes; None: they may."""
    for text in texts(data):
        needed = danger(text, board, rate)
        if needed != "passive" and needed not in allowed:
            return f"{command_words(text)} is {needed}, which this check does not declare"
    return None
