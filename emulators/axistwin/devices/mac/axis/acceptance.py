"""Which index a MAC axis takes in which state: the ledger's table §4.2, as data.

Rules
-----
1. A cell is one letter: A accepted, R refused, 1 refused for the parameter 01 only, u unassigned
   (what that means is the quirk ``unknown_index``).
2. Columns are the states of §4.1 in which the module listens.  AR and PL are columns of an axis at
   rest; in motion the column of the motion counts, armed or not.  BT and RI never get here: a
   module that is deaf has no acceptance.
3. Quirks amend cells before the device starts; nothing is decided at run time but the state.
4. A command that passes here may still be refused by its handler: value outside the range, FIFO
   full, nothing to synchronise.

Index ranges are the manual's: 00h..1Fh commands, 20h..2Fh queries (MACS-FRAME-08); higher ones are
unassigned like 2Ah..2Fh (MACS-AMB-58).
"""

from collections.abc import Mapping
from enum import IntEnum
from typing import Final, TypeAlias

from axistwin.devices.mac.axis.quirks import MacQuirks

INDEX_COUNT: Final = 0x30


class State(IntEnum):
    """The states of the axis that listen (ledger §4.1), in the order of the columns."""

    OF = 0
    HD = 1
    PO = 2
    VE = 3
    IN = 4
    AR = 5
    PL = 6
    DJ = 7


STATE_TEXTS: Final = {
    "off": "switched off",
    "BT": "starting up, deaf",
    "RI": "held in reset",
    "OF": "at rest, unpowered",
    "HD": "at rest, powered",
    "PO": "moving to a position",
    "VE": "moving at a velocity",
    "IN": "executing segments",
    "DJ": "fault, unpowered",
    "AR": "synchronous mode armed",
    "PL": "motion preloaded",
}
"""The states of ledger §4.1 in words; the last two stand beside another one."""


def state_text(code: str) -> str:
    """A state code such as ``HD+AR`` in words."""
    return ", ".join(STATE_TEXTS[part] for part in code.split("+"))


def _state_codes(state: State) -> tuple[tuple[str, str], ...]:
    """The codes of ``state``: bare, armed, preloaded; each unpowered and powered."""
    names = (state.name, state.name)
    if state in (State.AR, State.PL):
        names = (State.OF.name, State.HD.name)
    return tuple((names[0] + flag, names[1] + flag) for flag in ("", "+AR", "+PL"))


STATE_CODES: Final = tuple(_state_codes(state) for state in State)
"""The codes of every state, as ``state_text`` takes them."""

ALL: Final = tuple(State)
MOVING: Final = (State.PO, State.VE, State.IN)

_TABLE: Final = """
        OF HD PO VE IN AR PL DJ
00      A  A  A  A  A  A  A  A
01      A  A  A  A  A  A  A  A
02      A  A  R  R  R  A  A  A
03      A  A  R  R  R  A  A  A
04-06   u  u  u  u  u  u  u  u
07      A  A  A  A  A  A  A  A
08      A  A  A  A  A  A  A  A
09-0A   A  A  R  R  R  A  A  A
0B-0C   A  A  A  A  A  A  A  A
0D      A  A  R  R  R  A  A  A
0E      A  A  A  A  A  A  A  A
0F      A  A  R  R  R  A  A  A
10-11   A  A  A  A  A  A  A  R
12      u  u  u  u  u  u  u  u
13-14   A  A  R  R  R  A  A  R
15-1A   A  A  A  A  A  A  A  R
1B-1C   A  A  A  A  A  A  A  A
1D      u  u  u  u  u  u  u  u
1E      A  A  A  A  A  A  A  R
1F      u  u  u  u  u  u  u  u
20-29   A  A  A  A  A  A  A  A
2A-2F   u  u  u  u  u  u  u  u
"""

LOCKED: Final = (0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F, 0x13, 0x14)
"""Forbidden while running (MACS-STATE-01)."""

SIGNIFICANT: Final[dict[int, int]] = {
    **dict.fromkeys((0x09, 0x0A, 0x13, 0x16, 0x1E), 0xFFFFFFFF),
    **dict.fromkeys((0x02, 0x03, 0x07, 0x08, 0x0C, 0x0F, 0x1B, 0x1C), 0x000000FF),
    **dict.fromkeys((0x0D, 0x0E), 0x0000FFFF),
    0x15: 0x00FFFFFF,
}
"""The parameter digits not printed x, as a mask; no entry: none (MACS-FRAME-06, MACS-AMB-62)."""

SERIAL_ONLY: Final = (0x08, 0x1B)
"""Commands that only the serial face has: address and rate (MACC-CMD-XX-01)."""

Amendment: TypeAlias = tuple[str, object, tuple[int, ...], tuple[State, ...], str]

_AMENDMENTS: Final[tuple[Amendment, ...]] = (
    # quirk, value, indexes, states, cell
    ("motion_lock_set", "serial_list", (0x09, 0x0A, 0x0D, 0x0F, 0x14), MOVING, "A"),
    ("motion_lock_set", "serial_list", (0x03,), MOVING, "1"),
    ("lock_08_1b", True, (0x08, 0x1B), MOVING, "R"),
    ("cmd_1b_supported", False, (0x1B,), ALL, "R"),
    ("cmd_1c_supported", False, (0x1C,), ALL, "R"),
    ("vel_during_position", "refuse", (0x15,), (State.PO,), "R"),
    ("vel_during_interp", "refuse", (0x15,), (State.IN,), "R"),
    ("interp_during_profile", "refuse", (0x16, 0x1E), (State.PO, State.VE), "R"),
    ("stop17_in_interp", "refuse", (0x17,), (State.IN,), "R"),
    ("disj_refuse_set", "starting", (0x10, 0x11, 0x17, 0x18, 0x1A), (State.DJ,), "A"),
    ("preload_locks", True, LOCKED, (State.PL,), "R"),
    ("preload_policy", "refuse", (0x13, 0x14, 0x15), (State.PL,), "R"),
)

Cells: TypeAlias = Mapping[State, tuple[str, ...]]


def _read(table: str) -> dict[State, list[str]]:
    """The columns of the table, one letter per index."""
    heading, *rows = table.strip().splitlines()
    columns = {State[name]: ["u"] * INDEX_COUNT for name in heading.split()}
    for row in rows:
        indexes, *cells = row.split()
        first, _, last = indexes.partition("-")
        for index in range(int(first, 16), int(last or first, 16) + 1):
            for column, cell in zip(columns.values(), cells, strict=True):
                column[index] = cell
    return columns


def acceptance_table(quirks: MacQuirks) -> Cells:
    """The cell of every index 00h..2Fh in every listening state, as ``quirks`` read the manual."""
    columns = _read(_TABLE)
    for name, value, indexes, states, cell in _AMENDMENTS:
        if getattr(quirks, name) == value:
            for state in states:
                for index in indexes:
                    columns[state][index] = cell
    return {state: tuple(cells) for state, cells in columns.items()}
