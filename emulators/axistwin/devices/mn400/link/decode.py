"""Bytes of the serial line in words, for transcripts and traces; and words in bytes.

``explain`` reads either direction: a status packet tells its code, a data packet its value behind
``=``, a request its parameters.  It judges what it sees (a wrong sum, a packet that breaks off) and
never fails: what is no packet is shown as hex.
"""

import re
from typing import Final

from axistwin.devices.mn400.grammar import COMMANDS
from axistwin.devices.mn400.link.packets import (
    ADDRESS_BIT,
    EVERYBODY,
    ReturnCode,
    checksum,
    packet,
)
from axistwin.devices.words import in_words, incomplete, spaced
from axistwin.errors import UsageError, nearest

_PRINTABLE: Final = range(0x20, 0x7F)
_ENDS: Final = {0x04: "EndOfProgram", 0x14: "EndOfProgram (14h)"}
_NAMES: Final = {command.name.upper(): letter for letter, command in COMMANDS.items()}
_NAMES["ENDOFPROGRAM"] = "\x04"
_NOTES: Final = re.compile(r"\([a-z][^)]*\)")
_BOARD: Final = re.compile(r"\((?:board (\d+)|all boards)\b")
_NAMED: Final = re.compile(r"([A-Za-z]{2,})\s*(.*)")


def explain(data: bytes) -> str:
    """What ``data`` (one or more packets, either direction) says, in one line."""
    return "; ".join(in_words(bytes(data), _part_at))


def _part_at(data: bytes, at: int, is_next: bool) -> tuple[str, int]:
    """The text and length of the packet that begins at ``at``; length 0 if none does."""
    opening = data[at]
    if opening < ADDRESS_BIT:
        return "", 0
    close = next((n for n in range(at + 1, len(data)) if data[n] >= ADDRESS_BIT), len(data))
    if close < len(data) and (data[close] != opening or close == at + 1):
        return "", 0
    begun = data[at : close + 2]
    if len(begun) < close + 2 - at:
        is_closed = close < len(data)
        what = "the checksum is" if is_closed else "the closing address and the checksum are"
        return incomplete(begun, f"{what} missing"), len(begun)
    if begun[-1] >= ADDRESS_BIT:
        return "", 0
    return _packet(begun), len(begun)


def _packet(raw: bytes) -> str:
    """A whole packet in words."""
    number, command, rest = raw[0] & ~ADDRESS_BIT, raw[1], raw[2:-2]
    letter = chr(command).upper()
    if command in _ENDS:
        name = _ENDS[command]
    elif letter in COMMANDS:
        name = COMMANDS[letter].name
    else:
        name = f"command {letter!r}" if command in _PRINTABLE else f"command {command:02X}h"
    text = name + _content(rest)
    whose = "all boards" if number == EVERYBODY else f"board {number}"
    right = checksum(raw[:-1])
    doubt = "" if right == raw[-1] else f" [checksum wrong, {right:02X}h is right]"
    return f"{text} ({whose}){doubt}"


def _content(rest: bytes) -> str:
    """What follows the command's character."""
    codes = [code.value for code in ReturnCode]
    if rest and rest[0] in codes and rest[1:] in (b"", b"\x00"):
        return f": {ReturnCode(rest[0]).name}"
    text = rest.rstrip(bytes(range(0x20)))
    if (rest and not text) or any(byte not in _PRINTABLE for byte in text):
        return f" {spaced(rest)}"
    shown = text.decode("ascii")
    if len(text) < len(rest):
        return f" = {shown}"
    return f" {shown}" if shown else ""


def compose(text: str, number: int) -> bytes:
    """The packet that ``text`` asks for: ``M1000,500``, ``Mover 1000,500``, ``? (board 5)``.

    Raises UsageError.
    """
    if (found := _BOARD.search(text)) is not None:
        number = int(found[1] or EVERYBODY)
    line = _NOTES.sub("", text).strip()
    named = _NAMED.fullmatch(line)
    if named is not None:
        name = named[1].upper()
        if name not in _NAMES:
            raise UsageError(f"{text!r} is no command: {nearest(named[1], _titles())}")
        line = _NAMES[name] + named[2].replace(" ", "")
    if not line or line[0].upper() not in (*COMMANDS, "\x04") or not line.isascii():
        raise UsageError(f"{text!r} is no command: write M1000,500 or Mover 1000,500")
    if not EVERYBODY <= number < ADDRESS_BIT:
        raise UsageError(f"board {number} is not in 0..127")
    return packet(number, line.encode("ascii"))


def _titles() -> list[str]:
    return [*(command.name for command in COMMANDS.values()), "EndOfProgram"]
