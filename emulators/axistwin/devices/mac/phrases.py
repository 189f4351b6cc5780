"""Words for commands and queries of a MAC module, read back: the counterpart of ``command_words``.

Taken are the words of a transcript (``13h go to position 125 -> module 0``), shorter ones (``go to
125``), and an index with a value or without (``20h``, ``13h 125``, ``0Ch 50h``).
"""

import re
from collections.abc import Callable
from typing import Final, NamedTuple

from axistwin.devices.mac.axis.command_words import QUERIES
from axistwin.errors import UsageError, suggestion

GENERAL = 0xFF


class Phrase(NamedTuple):
    """A command or query: its index, four bytes of parameters, sub-index, and to whom, if told."""

    command: int
    parameters: int = 0
    sub_index: int = 0
    address: int | None = None


_NUMBER = r"([+-]?\d+|[0-9A-Fa-f]+h|0x[0-9A-Fa-f]+)"
_ADDRESSEE = re.compile(r"\s*->\s*(?:module (\d+)|(all modules))\s*$")
_INDEX = re.compile(r"([0-9A-Fa-f]{1,2})h(?:\s+|$)")
_OBJECT = re.compile(r"^20([0-9A-Fa-f]{2}h\s+)")
"""What CAN calls it; the words say whether 00h or 20h is meant, but 14h is told as 13h with 0."""

_SUB_INDEX = re.compile(r"\s+at ([0-9A-Fa-f]{1,2})h$")


def number(text: str) -> int:
    """``-5``, ``7Dh`` or ``0x7D``."""
    return int(text[:-1], 16) if text.endswith("h") else int(text, 16 if "x" in text else 10)


def _whole(value: int = 0, bits: int = 32) -> Callable[[re.Match[str]], int]:
    """The number of a phrase, or ``value`` for one without, in so many ``bits``."""

    def read(match: re.Match[str]) -> int:
        found = number(match[1]) if match.re.groups else value
        if not -(1 << (bits - 1)) <= found < 1 << bits:
            raise UsageError(f"{match[0]}: {found} does not fit; the parameter has {bits} bits")
        return found & ((1 << bits) - 1)

    return read


def _velocity(match: re.Match[str]) -> int:
    return (0xF6 if match[1] == "-" else 0x0A) << 16 | _whole(bits=16)(_second(match))


def _segment(match: re.Match[str]) -> int:
    return _whole(bits=16)(match) << 16 | _whole(bits=16)(_second(match))


def _second(match: re.Match[str]) -> re.Match[str]:
    """A match with the second number of ``match`` as its first."""
    found = re.fullmatch(_NUMBER, match[2])
    assert found is not None
    return found


_PHRASES: Final[tuple[tuple[str, int, Callable[[re.Match[str]], int]], ...]] = (
    ("initiali[sz]e(?: module)?", 0x00, _whole()),
    ("factory values", 0x01, _whole()),
    ("nominal torque at rest", 0x02, _whole(0)),
    ("standby at rest", 0x02, _whole(1)),
    (f"torque at rest {_NUMBER}", 0x02, _whole(bits=8)),
    ("stops off", 0x03, _whole(0)),
    ("hardware stops", 0x03, _whole(1)),
    ("software stops", 0x03, _whole(8)),
    ("hardware, software stops", 0x03, _whole(9)),
    (f"stops mode {_NUMBER}", 0x03, _whole(bits=8)),
    ("reference off", 0x07, _whole(0)),
    ("reference on", 0x07, _whole(1)),
    (f"reference {_NUMBER}", 0x07, _whole(bits=8)),
    (f"new address {_NUMBER}", 0x08, _whole(bits=8)),
    (f"superior stop {_NUMBER}", 0x09, _whole()),
    (f"inferior stop {_NUMBER}", 0x0A, _whole()),
    ("position := 0", 0x0B, _whole()),
    (f"torque {_NUMBER}", 0x0C, _whole(bits=8)),
    (f"maximum speed, period {_NUMBER}", 0x0D, _whole(bits=16)),
    (f"catch-up {_NUMBER}(?: x 200 us)?", 0x0E, lambda match: _whole(bits=8)(match) << 8),
    (rf"ramp {_NUMBER}(?: \(\d+ increments\))?", 0x0F, _whole(bits=8)),
    ("wait for synchroni[sz]ation", 0x10, _whole()),
    ("synchroni[sz]e", 0x11, _whole()),
    (f"go to (?:position )?{_NUMBER}", 0x13, _whole()),
    ("velocity 0(?:: stop)?", 0x15, _whole()),
    (f"velocity ([+-]), period {_NUMBER}", 0x15, _velocity),
    (f"segment {_NUMBER} steps at period {_NUMBER}", 0x16, _segment),
    ("stop(?: with ramp)?", 0x17, _whole()),
    ("stop without ramp", 0x18, _whole()),
    ("motor on", 0x19, _whole()),
    ("motor off", 0x1A, _whole()),
    ("9600 baud", 0x1B, _whole(1)),
    ("19200 baud", 0x1B, _whole(2)),
    ("38400 baud", 0x1B, _whole(3)),
    (f"baud rate {_NUMBER}", 0x1B, _whole(bits=8)),
    (f"tolerance {_NUMBER}", 0x1C, _whole(bits=8)),
    (f"virtual segment {_NUMBER} steps at period {_NUMBER}", 0x1E, _segment),
    *((rf"{re.escape(name)}\??", index, _whole()) for index, name in QUERIES.items()),
)
"""Words, the index, and what makes the parameters of them."""


_REMEDY = "write words such as 'go to 125' or 'status?', or an index such as 20h, or 13h 125"


def parse_phrase(text: str) -> Phrase:
    """What ``text`` asks a module for.  Raises UsageError."""
    rest, address = text.strip(), None
    if (to := _ADDRESSEE.search(rest)) is not None:
        address = GENERAL if to[2] else int(to[1])
        rest = rest[: to.start()]
    sub_index = 0
    if (at := _SUB_INDEX.search(rest)) is not None:
        sub_index, rest = int(at[1], 16), rest[: at.start()]
    index = None
    rest = _OBJECT.sub(r"\1" if rest.lower().startswith("2014h") else "", rest)
    if (begin := _INDEX.match(rest)) is not None:
        index, rest = int(begin[1], 16), rest[begin.end() :]
        if not rest or re.fullmatch(_NUMBER, rest):
            value = _whole()(re.fullmatch(_NUMBER, rest or "0") or begin)
            return Phrase(index, value, sub_index, address)
    for pattern, named, read in _PHRASES:
        match = re.fullmatch(pattern, rest, re.IGNORECASE)
        if match is not None and (index is None or index == named or _is_home(index, match)):
            return Phrase(named if index is None else index, read(match), sub_index, address)
    plain = [re.sub(r"\(\?:[^)]*\)\??|\\??\?$", "", each[0]) for each in _PHRASES]
    remedy = suggestion(re.sub(_NUMBER, "N", rest), [each.replace(_NUMBER, "N") for each in plain])
    raise UsageError(f"{text!r} is no command: {remedy or _REMEDY}")


def _is_home(index: int, match: re.Match[str]) -> bool:
    """14h is told as 13h with 0."""
    return index == 0x14 and match[0].lower() == "go to position 0"
