"""Commands, queries and answers of an axis in words, field by field."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.base.errors import counted
from axistwin_conformance.core.wording import (
    AS_AT_START,
    PLACE,
    POWERED,
    RUNNING,
    Effect,
    Exchange,
)
from axistwin_conformance.families.mac.axis.exchanges import (
    COMMAND_NAMES,
    QUERIES,
    QUERY_NAMES,
    signed,
)
from axistwin_conformance.families.mac.axis.parameters import (
    PARAMETERS,
    SHOWN_BY,
    AxisParameter,
)

POSITION: Final = 0x20
EFFECTS: Final = {
    **dict.fromkeys(PARAMETERS, Effect.VALUE),
    0x10: Effect.HOLD,
    0x11: Effect.START,
    **dict.fromkeys((0x13, 0x14, 0x15, 0x16, 0x1E), Effect.MOTION),
    **dict.fromkeys((0x17, 0x18), Effect.STOP),
    **dict.fromkeys(QUERIES, Effect.NOTHING),
}
# Of the state of an axis, what commands change and what replies depend on; of a parameter the name
# is that of its command.
FIFO: Final = "fifo"  # whether a segment has been run yet
SPEEDS: Final = frozenset({"0Dh", "0Eh", "0Fh"})
MOVES_BY: Final = frozenset({RUNNING, PLACE, POWERED, "03h", *SPEEDS})
MOVED: Final[Mapping[str, str | None]] = {RUNNING: None, PLACE: None}
SETS: Final[Mapping[int, Mapping[str, str | None]]] = {
    **dict.fromkeys((0x11, 0x13, 0x14, 0x15), MOVED),
    **{index: {**MOVED, FIFO: "used"} for index in (0x16, 0x1E)},
    **{index: {RUNNING: None} for index in (0x10, 0x17, 0x18)},
    0x0B: {PLACE: None},
    0x19: {POWERED: AS_AT_START},
    0x1A: {POWERED: "off"},
}
NEEDS: Final[Mapping[int, frozenset[str]]] = {
    **dict.fromkeys(COMMAND_NAMES, frozenset({RUNNING, POWERED})),
    **dict.fromkeys((0x10, 0x11, 0x13, 0x14, 0x15), MOVES_BY),
    **dict.fromkeys((0x16, 0x1E), MOVES_BY | {FIFO}),
    0x03: frozenset({RUNNING, "07h", "09h", "0Ah"}),
    0x0B: frozenset({RUNNING, PLACE}),
    0x20: frozenset({RUNNING, PLACE}),
    0x21: frozenset({RUNNING, "03h"}),
    **{query: frozenset(f"{one.index:02X}h" for one in SHOWN_BY[query]) for query in SHOWN_BY},
    0x27: frozenset({RUNNING, POWERED, "03h", "07h", "1Ch"}),
    **dict.fromkeys((0x2A, 0x2B, 0x2C, 0x2D, 0x2E, 0x2F), frozenset[str]()),
}
WITHOUT_PARAMETER: Final = frozenset({0x00, 0x01, 0x0B, 0x10, 0x11, 0x14, 0x17, 0x18, 0x19, 0x1A})
NOT_USED: Final = "not used"
TICK: Final = "× 0.125 µs"  # the unit of a period
NAMES: Final = {  # of the fields of an answer
    "standby": "torque at rest",
    "stops": "stops mode",
    "superior": "superior software stop",
    "inferior": "inferior software stop",
    "torque": "torque limit",
    "period": "period",
    "catch_up": "unstall (catch-up) speed",
    "coefficient": "ramp coefficient",
    "tolerance": "tolerance",
}
PERIOD_TICK_NS: Final = 125
UNITS: Final = {"period": TICK, "superior": "increments", "inferior": "increments"}
# The bytes of answers by the letters of the manual (MACS-Q-21-01, MACS-Q-27-01).
STATUS_BYTES: Final = {0x21: ("dd", "ff", "", "hh"), 0x27: ("tt", "vv", "cc", "dd")}
GLOSSARY: Final = {
    "dd": "fault byte dd of 21h",
    "ff": "stops byte ff of 21h",
    "hh": "memories byte hh of 21h",
    "cc": "state byte cc of 27h",
    "tt": "temperature byte tt of 27h",
    "vv": "supply byte vv of 27h",
}


def pace_words(named: str, period: int) -> str:
    """How fast an axis moves at most: the time of an increment, and the command that set it."""
    return f"{period * PERIOD_TICK_NS / 1e6:.4g} ms an increment ({named} = {period})"


def request_words(index: int, parameter: int, named: str = "") -> str:
    """A command or a query: ``13h (go to position -500)``; `named`: its number, as it was sent."""
    name = COMMAND_NAMES.get(index) or QUERY_NAMES.get(index) or NOT_USED
    words = _with_value(index, parameter, name)
    return f"{named or f'{index:02X}h'} ({words})"


def _with_value(index: int, parameter: int, name: str) -> str:
    if (index in QUERIES or index in WITHOUT_PARAMETER) and not parameter:
        return name
    if index == 0x13:
        return f"{name} {signed(parameter)}"
    if index in (0x16, 0x1E):
        steps, period = signed(parameter >> 16, 16), parameter & 0xFFFF
        return f"{name} of {steps} steps at period {period} {TICK}"
    if index == 0x15:
        way = "counter-clockwise" if parameter >> 16 & 0xFF == 0xF6 else "clockwise"
        return f"{name} {way} at period {parameter & 0xFFFF} {TICK}"
    known = PARAMETERS.get(index)
    if known is not None and known.parameter(known.taken(parameter)) & 0xFFFF_FFFF == parameter:
        unit = f" {TICK}" if known.name == "period" else ""
        return f"{name} {known.taken(parameter)}{unit}"
    return f"{name} {parameter:08X}h"


def answer_words(query: int, data: int) -> str:
    """The fields of an answer, as the manual names them; empty where the number says it all."""
    if query in STATUS_BYTES:
        named = zip(STATUS_BYTES[query], data.to_bytes(4, "big"), strict=True)
        return ", ".join(f"{name} = {byte:02X}h" for name, byte in named if name)
    return ", ".join(
        " ".join((NAMES[one.name], str(_shown(one, data)), UNITS.get(one.name, ""))).rstrip()
        for one in sorted(SHOWN_BY.get(query, ()), key=lambda part: -part.shift)
    )


def data_words(query: int, data: int) -> str:
    """The number of an answer, in words: its fields, a position, or the number as it is."""
    if query == POSITION:
        return counted(signed(data), "increment")
    return answer_words(query, data) or f"{data:08X}h"


def _shown(parameter: AxisParameter, data: int) -> int:
    value = parameter.read(data)
    return signed(value, parameter.bits) if parameter.is_signed else value


def exchange_words(words: str, index: int, parameter: int, data: int | None) -> Exchange:
    """A well-formed request, already in words, its parameter, and the number of its answer, None if
    none came."""
    is_query = index in QUERIES
    name = QUERY_NAMES.get(index, "") if is_query else ""
    answer = data_words(index, data) if is_query and data is not None else ""
    quantity = "position" if name == "position" else ""
    return Exchange(
        words, EFFECTS.get(index, Effect.OTHER), quantity, answer, sets=_sets(index, parameter),
        needs=NEEDS.get(index), shows=_shows(index, data) if is_query and data is not None else {},
    )  # fmt: skip


def _sets(index: int, parameter: int) -> Mapping[str, str | None] | None:
    """What a request changes."""
    known = PARAMETERS.get(index)
    if known is not None:
        return {f"{index:02X}h": str(known.taken(parameter))}
    return {} if index in QUERIES else SETS.get(index)


def _shows(query: int, data: int) -> dict[str, str | None]:
    """What an answer tells of the state."""
    if query == POSITION:
        return {PLACE: str(signed(data))}
    return {f"{one.index:02X}h": str(_shown(one, data)) for one in SHOWN_BY.get(query, ())}
