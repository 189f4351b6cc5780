"""Which command does what in which state: the table of ledger §4.1, as data.

A cell is one word of the ledger: what is answered, and what becomes of the command.  Parameters,
checksums and foreign addresses are checked elsewhere.
"""

from collections.abc import Mapping
from enum import Enum
from typing import Final


class BoardState(Enum):
    """The states of the table."""

    RDY = "ready"
    MOV = "moving"
    QUE = "moving, commands are queued"
    PAU = "paused"
    HLD = "hold"
    HPD = "hold, a motion is pending"
    CCB = "contour entry"
    CCX = "contour running"
    PRG = "program entry"
    CFG = "configuration entry"
    RUN = "program running"
    JOG = "jog mode"
    THR = "waiting for pulses"
    ABT = "aborted"

    __hash__ = object.__hash__
    """Sought in the table for each line: that of the name takes ten times as long."""


class Treatment(Enum):
    """What becomes of a command."""

    NOW = "D"
    QUEUED = "Dq"
    PENDING = "Dp"
    BUFFERED = "Db"
    STORED = "Ds"
    VOID = "D0"
    VALUE = "V"
    LISTING = "V*"
    POLL = "PR"
    RETRANSMIT = "R&"
    NOTHING_PENDING = "NP"
    MOVE_PENDING = "MP"
    BAUD = "BC"
    BUSY = "BY"
    INVALID = "IC"
    INVALID_LINE = "IP"


_COLUMNS: Final = tuple(BoardState)

_MODAL: Final = "D Dq Dq Dq D MP IC Dq Ds Ds BY D Dq D"
_MOTION: Final = "D Dq Dq Dq Dp MP IC Dq Ds Ds BY BY Dq D"
_READ: Final = "V V V V V MP IC V Ds Ds V V V V"
_AT_ONCE: Final = "D D D D D MP IC D Ds Ds D D D D"
_ENTRY: Final = "D BY BY BY D MP IC BY IP IP BY BY BY D"

_ROWS: Final[Mapping[str, str]] = {
    #    RDY MOV QUE PAU HLD HPD CCB CCX PRG CFG RUN JOG THR ABT
    **dict.fromkeys("CGYLFIBDPX", _MODAL),
    "V": "D   Dq  Dq  Dq  D   MP  Db  Dq  Ds  Ds  BY  D   Dq  D",
    **dict.fromkeys("A+T", _MOTION),
    "M": "D   Dq  Dq  Dq  Dp  MP  Db  Dq  Ds  Ds  BY  BY  Dq  D",
    **dict.fromkeys("/?SNE[:", _READ),
    "R": "V*  V*  V*  V*  V*  MP  IC  V*  Ds  Ds  BY  V*  V*  V*",
    "*": "PR  PR  PR  PR  PR  MP  IC  PR  Ds  Ds  PR  PR  PR  PR",
    **dict.fromkeys("|;", _AT_ONCE),
    "=": "D   D   D   D   D   MP  IC  D   Ds  Ds  BY  D   D   D",
    "H": "D   D   D   D   D   MP  IC  D   Ds  Ds  BY  D   D   D",
    "~": "BC  BC  BC  BC  BC  MP  IC  BC  Ds  Ds  BY  BC  BC  BC",
    "(": "D   D   D   D   D   MP  IC  D   Ds  Ds  BY  BY  D   D",
    ")": "D0  D0  D0  D0  D0  MP  D   D0  Ds  Ds  BY  BY  D0  D0",
    "J": "D   BY  BY  BY  D   MP  IC  BY  Ds  Ds  BY  D   BY  D",
    "{": "D0  D   D   D0  D0  MP  IC  D   Ds  Ds  D   D0  D   D0",
    "}": "D0  D0  D0  D   D0  MP  IC  D0  Ds  Ds  D0  D0  D0  D0",
    **dict.fromkeys("Z.", _ENTRY),
    "U": "D   BY  BY  BY  D   MP  IC  BY  Ds  Ds  BY  BY  BY  D",
    "Q": "D0  D   D   D   D0  MP  D   D   Ds  D   D   D   D   D0",
    "K": "NP  NP  NP  NP  NP  D   IC  NP  Ds  Ds  NP  NP  NP  NP",
    "&": "R&  R&  R&  R&  R&  R&  R&  R&  R&  R&  R&  R&  R&  R&",
}

TABLE: Final[Mapping[tuple[str, BoardState], Treatment]] = {
    (letter, column): Treatment(word)
    for letter, row in _ROWS.items()
    for column, word in zip(_COLUMNS, row.split(), strict=True)
}
"""What becomes of each command in each state."""
