"""Who plays operations on a unit, and what they begin with."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.sequences.operations import OPERATIONS
from axistwin_conformance.families.msc.sequences.sequence import (
    BYTES_PER_OPERATION,
    UnitSequence,
    begin,
)
from axistwin_conformance.sequences.runner import Runner

BABBLING: Final = ("other_unit_framing", "stray_nak")  # MSC-AMB-14, -29


class MscRunner(Runner):
    """Plays operations on one unit, always from the same values and flags."""

    operation_bytes = BYTES_PER_OPERATION
    arguments = (3, 1, 2)
    beginning = "all values 0 and all flags off"

    def __init__(self, driver: MscDriver) -> None:
        super().__init__(driver.session)
        self.driver = driver
        self._last: UnitSequence | None = None

    @property
    def kinds(self) -> int:
        """How many operations there are."""
        return len(OPERATIONS)

    def on(self, session: Session) -> MscRunner:
        """The same on the twin of this unit."""
        return MscRunner(MscDriver(session))

    def begin(self) -> UnitSequence:
        """A sequence on a line at rest, with known values and flags."""
        if self.is_fresh or (self._last is not None and not self._last.is_over):
            self.driver.client.wait_until_quiet()
        self._last = begin(self.driver, OPERATIONS)
        return self._last


def runner_of(session: Session) -> MscRunner:
    """Somebody who plays on the unit under test; skips where others talk in between, and where no
    variable is named."""
    for switch in BABBLING if session.neighbours else ():
        reading = session.reading(switch)
        if reading != session.run.ledger.ambiguity_of(switch).default_of(switch):
            session.skip(f"with {switch}={reading}, what is said to one unit draws others' answers")
    MscDriver(session).scratch.spot()  # or nothing could be written
    return MscRunner(MscDriver(session))
