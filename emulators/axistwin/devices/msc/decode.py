"""Bytes of an executive port in words, for transcripts and traces; and words in bytes.

``explain`` reads either direction: packets of a host and of a unit, single ACK and NAK characters.
It judges what it sees (a wrong sum, a packet that breaks off) and never fails: what is no packet is
shown as hex.  The direction is not in the bytes: RFLAG asks for flag 1 with the very bytes that
answer "on".
"""

import re
from collections.abc import Callable
from struct import iter_unpack
from typing import Final

from axistwin.devices.msc.packets import (
    ACK,
    BODY_MAX,
    CHECKSUM_BYTES,
    FRAME_BYTES,
    HEADER_BYTES,
    NAK,
    STX,
    UNITS,
    body_length,
    is_sum_right,
    packet,
)
from axistwin.devices.msc.status import StatusBit
from axistwin.devices.words import in_words, incomplete, missing, spaced
from axistwin.errors import UsageError, nearest

_SIGNS = {ACK: "ACK", NAK: "NAK"}

_SHOWN_MAX = 4
"""Values of a block that are told; the others are counted."""


def explain(data: bytes) -> str:
    """What ``data`` (one or more packets, either direction) says, in one line."""
    return "; ".join(in_words(bytes(data), _part_at))


def _part_at(data: bytes, at: int, is_sign: bool) -> tuple[str, int]:
    """The text and length of what begins at ``at``; length 0 if nothing does.

    06h and 15h in the middle of a stretch that is no part are no answers.
    """
    first = data[at]
    if is_sign and first in _SIGNS:
        return _SIGNS[first], 1
    if first != STX:
        return "", 0
    raw = _whole_at(data, at)
    if raw:
        return _packet(raw), len(raw)
    begun = data[at : at + FRAME_BYTES + BODY_MAX]
    # Amid bytes that are no part, a 02h is taken for a packet's only if a whole header follows.
    if not _may_begin(begun) or not (is_sign or len(begun) >= HEADER_BYTES):
        return "", 0
    begun = begun[: _next_sound(begun)]
    return incomplete(begun, _missing_behind(begun)), len(begun)


def _whole_at(data: bytes, at: int) -> bytes:
    """The packet that begins there; empty if not all of it is there."""
    if len(data) < at + FRAME_BYTES:
        return b""
    length = body_length(data[at : at + HEADER_BYTES])
    raw = data[at : at + FRAME_BYTES + length]
    return raw if length <= BODY_MAX and len(raw) == FRAME_BYTES + length else b""


def _may_begin(begun: bytes) -> bool:
    """Whether some packet begins so, as far as its unit and its length are there."""
    is_unit = len(begun) < 2 or begun[1] in UNITS
    length = int.from_bytes(begun[2:4].ljust(2, b"\0"), "big")
    return is_unit and length <= BODY_MAX


def _next_sound(begun: bytes) -> int:
    """Where the next packet begins that is whole and sound; at the end if none does."""
    at = begun.find(STX, 1)
    while at > 0:
        raw = _whole_at(begun, at)
        if raw and raw[1] in UNITS and is_sum_right(raw):
            return at
        at = begun.find(STX, at + 1)
    return len(begun)


def _missing_behind(begun: bytes) -> str:
    """What is missing behind the beginning of a packet."""
    if len(begun) < HEADER_BYTES:
        return missing(HEADER_BYTES - len(begun), HEADER_BYTES, " of the header") + ", and the rest"
    length = body_length(begun)
    of_body = HEADER_BYTES + length - len(begun)
    if of_body > 0:
        return missing(of_body, length, " of the body") + ", and the checksum"
    of_sum = CHECKSUM_BYTES + of_body
    return (
        "the checksum is missing"
        if of_sum == CHECKSUM_BYTES
        else missing(of_sum, CHECKSUM_BYTES, " of the checksum")
    )


def _packet(raw: bytes) -> str:
    """A whole packet in words."""
    body = raw[HEADER_BYTES:-CHECKSUM_BYTES]
    name, comma, values = body.partition(b",")
    say = _SAID.get(name) if comma else None
    text = say(values) if say is not None else ""
    if say is None or (values and not text):
        told = f"body {spaced(body)}" if body else "no body"
    else:
        told = f"{name.decode()}{' ' if text else ''}{text}"
    notes = [f"unit {raw[1]}" if raw[1] in UNITS else f"unit {raw[1]}, which is none"]
    if raw[4:6] != b"\0\0":
        notes.append(f"block {raw[4:6].hex().upper()}h")
    doubt = ""
    if not is_sum_right(raw):
        right = (sum(raw[1:-CHECKSUM_BYTES])) & 0xFFFF
        doubt = f" [checksum wrong, {right:04X}h is right]"
    return f"{told} ({', '.join(notes)}){doubt}"


def _word(data: bytes) -> int:
    return int.from_bytes(data[:2], "big")


def _numbers(data: bytes) -> str:
    """Signed values in words, of many the first ones."""
    values = [str(value) for (value,) in iter_unpack(">i", data)]
    more = len(values) - _SHOWN_MAX
    return " ".join(values[:_SHOWN_MAX]) + (f" and {more} more" if more > 0 else "")


def _read(size: int) -> Callable[[bytes], str]:
    """BREAD and DREAD: an address is asked for, ``size`` bytes of values are the answer."""

    def say(values: bytes) -> str:
        if len(values) == 2:
            return f"at {_word(values)}?"
        return f"= {_numbers(values)}" if len(values) == size else ""

    return say


def _write(size: int) -> Callable[[bytes], str]:
    """BWRITE and DWRITE."""

    def say(values: bytes) -> str:
        return f"at {_word(values)}: {_numbers(values[2:])}" if len(values) == 2 + size else ""

    return say


def _flag(values: bytes) -> str:
    """SFLAG and CFLAG."""
    return f"{_word(values)}" if len(values) == 2 else ""


def _rflag(values: bytes) -> str:
    """RFLAG: a flag's number, or its state; for 0 and 1 that cannot be told apart."""
    if len(values) != 2:
        return ""
    number = _word(values)
    return f"{number}?" + (f" (or = {('off', 'on')[number]})" if number < 2 else "")


def _rflags(values: bytes) -> str:
    """RFLAGS: nothing, or 256 flags."""
    if len(values) != 32:
        return ""
    states = int.from_bytes(values, "little")
    on = [str(number) for number in range(256) if states >> number & 1]
    return f"= on: {' '.join(on) if on else 'none'}"


def _rqstat(values: bytes) -> str:
    """RQSTAT: nothing, or the status word."""
    if len(values) not in (6, 8):
        return ""
    word = _word(values)
    names = [str(bit.name).lower() for bit in StatusBit if word & bit]
    return f"= {word}" + (f" ({', '.join(names)})" if names else "")


_SAID: dict[bytes, Callable[[bytes], str]] = {
    b"BREAD": _read(128),
    b"BWRITE": _write(128),
    b"CFLAG": _flag,
    b"DREAD": _read(4),
    b"DWRITE": _write(4),
    b"RFLAG": _rflag,
    b"RFLAGS": _rflags,
    b"RQSTAT": _rqstat,
    b"SFLAG": _flag,
}


# -- and back: words to a packet -----------------------------------------------------------------

BLOCK: Final = 32
"""Values that BWRITE has."""

_VALUES: Final = {
    "BREAD": 1,
    "BWRITE": 1 + BLOCK,
    "CFLAG": 1,
    "DREAD": 1,
    "DWRITE": 2,
    "RFLAG": 1,
    "RFLAGS": 0,
    "RQSTAT": 0,
    "SFLAG": 1,
}
"""How many numbers a command has; the first is a flag or an address, others are values."""

_NOTES = re.compile(r"\([^)]*\)")
_UNIT = re.compile(r"\(unit (\d+)\b")


def compose(text: str, unit: int) -> bytes:
    """The packet that ``text`` asks for.  Raises UsageError."""
    if (told := _UNIT.search(text)) is not None:
        unit = int(told[1])
    rest = _NOTES.sub(" ", text)
    name, *words = re.sub(r"\bat\b|[?:,]", " ", rest).split() or [""]
    name = name.upper()
    if name not in _VALUES:
        raise UsageError(f"{text!r} is no command: {nearest(name, _VALUES)}")
    numbers = [_number(name, word) for word in words]
    wanted = _VALUES[name]
    if len(numbers) != wanted:
        raise UsageError(f"{text!r}: {name} has {wanted} numbers, not {len(numbers)}")
    body = name.encode() + b","
    if numbers:
        body += (numbers[0] & 0xFFFF).to_bytes(2, "big")
    for value in numbers[1:]:
        body += (value & 0xFFFFFFFF).to_bytes(4, "big")
    return packet(unit, body)


def _number(name: str, word: str) -> int:
    try:
        return int(word[:-1], 16) if word.endswith("h") else int(word, 0)
    except ValueError:
        raise UsageError(f"{name}: {word} is no number; write 200, C8h or 0xC8") from None
