"""Who plays operations on a unit, and what they begin with."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.driver import Bench
from axistwin_conformance.families.msc.link import Link
from axistwin_conformance.families.msc.sequences.operations import OPERATIONS
from axistwin_conformance.families.msc.sequences.sequence import (
    BYTES_PER_OPERATION,
    Sequence,
    begin,
)
from axistwin_conformance.sequences.runner import Runner

BABBLING: Final = ("other_unit_framing", "stray_nak")  # MSC-AMB-14, -29


class UnitRunner(Runner):
    """Plays operations on one unit, always from the same values and flags."""

    operation_bytes = BYTES_PER_OPERATION
    arguments = (3, 1, 2)
    beginning = "all values 0 and all flags off"

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench.session)
        self.bench = bench
        self._last: Sequence | None = None

    @property
    def kinds(self) -> int:
        """How many operations there are."""
        return len(OPERATIONS)

    def on(self, session: Session) -> UnitRunner:
        """The same on the twin of this unit."""
        return UnitRunner(Bench(session))

    def begin(self) -> Sequence:
        """A sequence on a line at rest, with known values and flags."""
        if self.is_fresh or (self._last is not None and not self._last.is_over):
            self.bench.talk.settle()
        self._last = begin(self.bench, OPERATIONS)
        return self._last


def runner_of(session: Session) -> UnitRunner:
    """Somebody who plays on the unit under test; skips where others talk in between, and where no
    variable is named."""
    for switch in BABBLING if session.neighbours else ():
        reading = session.reading(switch)
        if reading != session.run.ledger.ambiguity_of(switch).default_of(switch):
            session.skip(f"with {switch}={reading}, what is said to one unit draws others' answers")
    Link(session).spot()  # or nothing could be written
    return UnitRunner(Bench(session))
