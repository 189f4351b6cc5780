"""EEPROM writes: each one wears the cell; they are counted, told, and kept to a budget.

What is put back at the end of a check, and on the way out, is counted as well but never held back:
a device must be left as it was found, whatever that costs.
"""

from __future__ import annotations

from dataclasses import dataclass

from axistwin_conformance.base.errors import CannotDo

DEFAULT_BUDGET = 2_000  # of the 100 000 that EEPROMs of the time were good for: one run in fifty


@dataclass(slots=True)
class WriteBudget:
    """How many stored writes a run may ask for, and how many it has; `limit` None: any number."""

    limit: int | None = None
    spent: int = 0
    pending: int = 0  # asked for by what was sent last, to which no reply has come yet

    def allow(self, writes: int) -> None:
        """Raise CannotDo if that many more are too many."""
        if writes and self.limit is not None and self.spent + writes > self.limit:
            raise CannotDo(f"the budget of {self.limit} EEPROM writes is used up (--eeprom-budget)")

    def note(self, writes: int) -> None:
        """Count writes that are being sent."""
        self.spent += writes
        self.pending = writes

    def replied(self, *, is_refusal: bool) -> None:
        """Give back a write that the one device it was for has refused: it has worn nothing."""
        if is_refusal and self.pending == 1:
            self.spent -= 1
        self.pending = 0
