"""Commands, queries and answers of an axis in words, field by field."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.wording import Exchange
from axistwin_conformance.families.mac.axis.exchanges import (
    COMMAND_NAMES,
    QUERIES,
    QUERY_NAMES,
    signed,
)
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS, SHOWN_BY

WITHOUT_PARAMETER: Final = frozenset({0x00, 0x01, 0x0B, 0x10, 0x11, 0x14, 0x17, 0x18, 0x19, 0x1A})
NAMES: Final = {  # of the fields of an answer
    "standby": "torque at rest",
    "stops": "stops mode",
    "superior": "superior software stop",
    "inferior": "inferior software stop",
    "torque": "torque limit",
    "period": "period",
    "catch_up": "catch-up speed",
    "coefficient": "ramp coefficient",
    "tolerance": "tolerance",
}
# Bytes of the answers to 21h and 27h (MACS-Q-21-01, MACS-Q-27-01).
GLOSSARY: Final = {
    "dd": "fault byte dd",
    "ff": "stops byte ff",
    "hh": "memories byte hh",
    "cc": "state byte cc",
    "tt": "temperature byte tt",
    "vv": "supply byte vv",
}


def request_words(index: int, parameter: int, named: str = "") -> str:
    """A command or a query: ``13h go to position -500``; `named`: its number, as it was sent."""
    name = COMMAND_NAMES.get(index) or QUERY_NAMES.get(index) or "unassigned"
    words = f"{named or f'{index:02X}h'} {name}"
    if (index in QUERIES or index in WITHOUT_PARAMETER) and not parameter:
        return words
    if index == 0x13:
        return f"{words} {signed(parameter)}"
    if index in (0x16, 0x1E):
        return f"{words} of {signed(parameter >> 16, 16)} steps at period {parameter & 0xFFFF}"
    if index == 0x15:
        way = "counter-clockwise" if parameter >> 16 & 0xFF == 0xF6 else "clockwise"
        return f"{words} {way} at period {parameter & 0xFFFF}"
    known = PARAMETERS.get(index)
    if known is not None and known.parameter(known.taken(parameter)) & 0xFFFF_FFFF == parameter:
        return f"{words} {known.taken(parameter)}"
    return f"{words} {parameter:08X}"


def answer_words(query: int, data: int) -> str:
    """The fields of an answer; empty where the number says it all."""
    if query == 0x21:
        return f"faults {data >> 24:02X}, stops {data >> 16 & 0xFF:02X}, memories {data & 0xFF:02X}"
    return ", ".join(f"{NAMES[one.name]} {one.read(data)}" for one in SHOWN_BY.get(query, ())[::-1])


def exchange_words(words: str, index: int, data: int | None) -> Exchange:
    """A well-formed request, already in words, and the number of its answer, None if none came."""
    is_query = index in QUERIES
    name = QUERY_NAMES.get(index, "") if is_query else ""
    answer = answer_words(index, data) if is_query and data is not None else ""
    fields = f"{index:02X}h: {answer}" if answer else ""
    return Exchange(words, is_query, "position" if name == "position" else "", fields)
