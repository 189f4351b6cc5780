"""Which command is accepted in which state: the acceptance table of §4.2 as data.

A accepted, R refused, F accepted until the FIFO is full.  The column is the state's code:

    OF at rest, unpowered   HD at rest, powered   PO position   VE velocity   IN interpolated
    AR armed by 10h         PL motion preloaded   DJ disjuncted

Where the manual can be read otherwise, `otherwise` names the switch and what its further readings
(number 1, 2, ...) put into which columns.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import ReplyKind

STATES: Final = ("OF", "HD", "PO", "VE", "IN", "AR", "PL", "DJ")
RUNNING: Final = ("PO", "VE", "IN")
AT_REST: Final = ("OF", "HD", "AR", "PL")

Otherwise = Mapping[str, Mapping[int, Mapping[str, str]]]


@dataclass(frozen=True, slots=True)
class AcceptanceRow:
    """One index: its cells by state, the readings that change cells, and what is judged by it."""

    cells: str
    requirements: tuple[str, ...] = ()
    otherwise: Otherwise = field(default_factory=dict)

    def cell(self, state: str) -> str:
        """The default reading of one cell."""
        return self.cells[STATES.index(state)]

    def readings(self, state: str) -> list[tuple[str, str, int]]:
        """Other admissible contents of a cell: (content, switch, number of its reading)."""
        return [
            (cells[state], switch, number)
            for switch, by_number in self.otherwise.items()
            for number, cells in by_number.items()
            if state in cells
        ]


def _same(states: tuple[str, ...], content: str) -> dict[str, str]:
    return dict.fromkeys(states, content)


_LOCKED_WITH_PRELOAD: Final[Otherwise] = {"preload_locks": {1: {"PL": "R"}}}
# The serial list kept the marks of 02h, 03h and 13h only (MACS-AMB-08).
_LOCKED_BY_CAN_LIST: Final[Otherwise] = {
    "motion_lock_set": {1: _same(RUNNING, "A")},
    "preload_locks": {1: {"PL": "R"}},
}
_SECOND_PRELOAD: Final[Otherwise] = {
    "preload_policy": {1: {"PL": "R"}},
    "preload_locks": {1: {"PL": "R"}},
}
_SEGMENT: Final[Otherwise] = {"interp_during_profile": {1: {"PO": "R", "VE": "R"}}}
# By the number of the reading; what is answered with data or not at all, no cell tells.
_UNASSIGNED: Final[Otherwise] = {"unknown_index": {1: _same(STATES, "A")}}
_UNASSIGNED_COMMAND: Final[Otherwise] = {
    "unknown_index": {1: _same(STATES, "A"), 2: _same(STATES, "A")}
}
_LOCKABLE: Final[Otherwise] = {"lock_08_1b": {1: _same(RUNNING, "R")}}

UNASSIGNED_COMMAND: Final = AcceptanceRow("RRRRRRRR", ("MACS-CMD-XX-01",), _UNASSIGNED_COMMAND)
UNASSIGNED_QUERY: Final = AcceptanceRow("RRRRRRRR", ("MACS-Q-XX-02",), _UNASSIGNED)

ACCEPTANCE: Final[dict[int, AcceptanceRow]] = {
    0x00: AcceptanceRow("AAAAAAAA", ("MACS-CMD-00-03",)),
    0x01: AcceptanceRow("AAAAAAAA", ("MACS-CMD-01-01",)),
    0x02: AcceptanceRow("AARRRAAA", ("MACS-CMD-02-02",), _LOCKED_WITH_PRELOAD),
    0x03: AcceptanceRow(
        "AARRRAAA", ("MACS-CMD-03-02",), _LOCKED_BY_CAN_LIST
    ),  # d = 1: see the model
    0x07: AcceptanceRow("AAAAAAAA", ("MACS-CMD-07-01",)),
    0x08: AcceptanceRow("AAAAAAAA", ("MACS-CMD-08-01",), _LOCKABLE),
    0x09: AcceptanceRow("AARRRAAA", ("MACS-CMD-090A-03",), _LOCKED_BY_CAN_LIST),
    0x0A: AcceptanceRow("AARRRAAA", ("MACS-CMD-090A-03",), _LOCKED_BY_CAN_LIST),
    0x0B: AcceptanceRow("AAAAAAAA", ("MACS-CMD-0B-02",)),
    0x0C: AcceptanceRow("AAAAAAAA", ("MACS-CMD-0C-03",)),
    0x0D: AcceptanceRow("AARRRAAA", ("MACS-CMD-0D-02",), _LOCKED_BY_CAN_LIST),
    0x0E: AcceptanceRow("AAAAAAAA", ("MACS-CMD-0E-02",)),
    0x0F: AcceptanceRow("AARRRAAA", ("MACS-CMD-0F-02",), _LOCKED_BY_CAN_LIST),
    0x10: AcceptanceRow("AAAAAAAR", ("MACS-CMD-10-01",)),
    0x11: AcceptanceRow(
        "AAAAAAAR",
        ("MACS-CMD-11-02",),
        {"sync_without_preload": {1: _same(("OF", "HD", "PO", "VE", "IN", "AR"), "R")}},
    ),
    0x13: AcceptanceRow("AARRRAAR", ("MACS-CMD-13-02",), _SECOND_PRELOAD),
    0x14: AcceptanceRow(
        "AARRRAAR",
        ("MACS-CMD-14-02",),
        {**_SECOND_PRELOAD, "motion_lock_set": {1: _same(RUNNING, "A")}},
    ),
    0x15: AcceptanceRow(
        "AAAAAAAR",
        ("MACS-CMD-15-02",),
        {
            "preload_policy": {1: {"PL": "R"}},
            "vel_during_position": {1: {"PO": "R"}},
            "vel_during_interp": {1: {"IN": "R"}},
        },
    ),
    0x16: AcceptanceRow("AAAAFAAR", ("MACS-CMD-16-02",), _SEGMENT),
    0x17: AcceptanceRow("AAAAAAAR", ("MACS-CMD-17-01",), {"stop17_in_interp": {1: {"IN": "R"}}}),
    0x18: AcceptanceRow("AAAAAAAR", ("MACS-CMD-18-01",)),
    0x19: AcceptanceRow("AAAAAAAR", ("MACS-CMD-19-01",)),
    0x1A: AcceptanceRow("AAAAAAAR", ("MACS-CMD-1A-01",)),
    0x1B: AcceptanceRow("AAAAAAAA", ("MACS-CMD-1B-01",), _LOCKABLE),
    0x1C: AcceptanceRow(
        "AAAAAAAA", ("MACS-CMD-1C-01",), {"cmd_1c_supported": {1: _same(STATES, "R")}}
    ),
    0x1E: AcceptanceRow("AAAAFAAR", ("MACS-CMD-1E-01",), _SEGMENT),
    **dict.fromkeys((0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F), UNASSIGNED_COMMAND),
    **{index: AcceptanceRow("AAAAAAAA", ("MACS-Q-XX-01",)) for index in range(0x20, 0x2A)},
    **dict.fromkeys(range(0x2A, 0x30), UNASSIGNED_QUERY),
}


@cache
def table_without(missing: tuple[int, ...]) -> Mapping[int, AcceptanceRow]:
    """The table of a face that does not have these commands and queries."""
    rows = {index: UNASSIGNED_COMMAND if index < 0x20 else UNASSIGNED_QUERY for index in missing}
    return ChainMap(rows, ACCEPTANCE) if rows else ACCEPTANCE


# What stays allowed in motion beyond the marks; locking one of these is trap 16 of §8.
LOCKED_IN_MOTION: Final = tuple(
    index for index, row in ACCEPTANCE.items() if row.cells[2:5] == "RRR" and index < 0x20
)


def outcome_of(content: str) -> ReplyKind:
    """The reply that a cell stands for; F means a FIFO with room."""
    return ReplyKind.REFUSED if content == "R" else ReplyKind.ACCEPTED
