"""The table of commands and states, as data (`states.toml`)."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import Final


class BoardState(StrEnum):
    """In what a board can be, as far as a command may draw something else there."""

    RDY = "ready"
    MOV = "moving"
    QUE = "moving, with more queued"
    PAU = "paused"
    HLD = "on hold"
    HPD = "on hold with a move pending"
    CCB = "entering a contour"
    CCX = "running a contour"
    PRG = "entering a program"
    CFG = "entering the configuration"
    RUN = "running its program"
    JOG = "jogging"
    THR = "waiting for pulses"
    ABT = "aborted"


class CellOutcome(StrEnum):
    """What a command draws, and when it takes effect."""

    DONE = "D"
    IDLE = "D0"
    QUEUED = "Dq"
    BUFFERED = "Db"
    PENDING = "Dp"
    STORED = "Ds"
    VALUE = "V"
    LISTING = "V*"
    PRESENT = "PR"
    REPEATED = "R&"
    NONE_PENDING = "NP"
    MOVE_PENDING = "MP"
    BAUD = "BC"
    BUSY = "BY"
    UNKNOWN = "IC"
    NO_LINE = "IP"


class Ground(StrEnum):
    """On what a cell stands."""

    MANUAL = "m"
    DERIVED = "d"
    INTERPRETATION = "i"


@dataclass(frozen=True, slots=True)
class StateCell:
    """What a command draws in a state; `enters`: the state it leads to, None: the same."""

    outcome: CellOutcome
    enters: BoardState | None
    ground: Ground

    @property
    def is_open(self) -> bool:
        """True where the manual is silent: a board that does otherwise does not fail by it."""
        return self.ground is Ground.INTERPRETATION


# What comes of an outcome, packet by packet; `data` stands for a data packet.
REPLIES: Final[Mapping[CellOutcome, tuple[str, ...]]] = {
    **dict.fromkeys(
        (
            CellOutcome.DONE,
            CellOutcome.IDLE,
            CellOutcome.QUEUED,
            CellOutcome.BUFFERED,
            CellOutcome.PENDING,
            CellOutcome.STORED,
        ),
        ("START", "DONE"),
    ),
    CellOutcome.VALUE: ("START", "data"),
    CellOutcome.LISTING: ("START", "data"),  # and as many more as there are lines
    CellOutcome.PRESENT: ("START", "PRESENT"),
    CellOutcome.NONE_PENDING: ("START", "NOMOVEPENDING"),
    CellOutcome.MOVE_PENDING: ("START", "MOVEPENDING"),
    CellOutcome.BAUD: ("START", "BAUDCHANGEOK"),
    CellOutcome.BUSY: ("START", "BUSY"),
    CellOutcome.UNKNOWN: ("INVALIDCOMMAND",),
    CellOutcome.NO_LINE: ("START", "INVALIDPROGCOMM"),
}


@cache
def state_table() -> Mapping[tuple[str, BoardState], StateCell]:
    """Every cell, by the letter of its command and its state."""
    data = resources.files(__package__).joinpath("states.toml").read_text(encoding="utf-8")
    table = tomllib.loads(data)
    states = [BoardState[name] for name in table["states"]]
    return {
        (letter, state): _cell(text)
        for letter, row in table["commands"].items()
        for state, text in zip(states, row, strict=True)
    }


def _cell(text: str) -> StateCell:
    """``D>MOV m``: outcome, state entered, ground."""
    what, ground = text.split()
    outcome, _, enters = what.partition(">")
    return StateCell(CellOutcome(outcome), BoardState[enters] if enters else None, Ground(ground))
