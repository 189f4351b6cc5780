"""Faults of what is entered where no room is left (NVM)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.commands import Interpreter, Refusal
from axistwin.devices.mn400.store import ProgramStore
from zoo_mn400.planting import Any_, MonkeyPatch, around, board_mutant


@board_mutant("MN4-NVM-09", "MN4-NVM-02")
def what_does_not_fit_pushes_the_first_line_out(patch: MonkeyPatch) -> None:
    """MEMORY_FULL is sent, and the first line is gone."""

    def act(go: Any_, store: ProgramStore, part: Any, line: bytes) -> Any:
        found = go()
        if found is None and len(store._entry) > 5:
            del store._entry[0]
        return found

    around(patch, ProgramStore, "add", act)


@board_mutant("MN4-NVM-09", "MN4-NVM-02")
def what_does_not_fit_is_lost_in_silence(patch: MonkeyPatch) -> None:
    """Behind the last line that fits each draws DONE, and none is stored."""

    def act(go: Any_, store: ProgramStore, part: Any, line: bytes) -> Any:
        found = go()
        return () if found is None else found

    around(patch, ProgramStore, "add", act)


@board_mutant("MN4-NVM-01", "MN4-STM-04")
def what_does_not_fit_ends_the_entry(patch: MonkeyPatch) -> None:
    """MEMORY_FULL is sent, and the next line is carried out."""

    def act(go: Any_, one: Interpreter, line: Any) -> Any:
        try:
            return go()
        except Refusal:
            one._close_entry()
            raise

    around(patch, Interpreter, "_store_line", act)
