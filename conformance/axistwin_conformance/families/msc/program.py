"""The bench program in a unit under test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import Names
from axistwin_conformance.families.msc.scratch import PROGRAM_BLOCK, scratch_of

REACTION_S: Final = 1.0  # within which the bench program does what its flags ask for


class BenchProgram:
    """The bench program in a unit: its flags, its counters, its block; skips if it does not run."""

    def __init__(self, session: Session) -> None:
        place = scratch_of(session).program
        if place is None:  # it was named, and dropped when the run began (`snapshot.remember`)
            session.skip("what the bench program uses could not all be read")
        self.driver = MscDriver(session)
        self.session = session
        self.flag, self.address = place
        self.count, self.pulse, self.halt, self.timed = range(self.flag, self.flag + 4)
        self.block = self.address + PROGRAM_BLOCK.start

    def counter(self) -> int:
        """How often `count` was found on."""
        return self.driver.read(self.address)

    def ticks(self) -> int:
        """One more in every scan."""
        return self.driver.read(self.address + 4)

    def pulses(self) -> int:
        """How often `pulse` was seen to go on."""
        return self.driver.read(self.address + 8)

    def torn(self) -> int:
        """In how many scans the ends of the block differed."""
        return self.driver.read(self.address + 12)

    def is_running(self) -> bool:
        """True if it counts its scans."""
        first = self.ticks()
        return self.until(lambda: self.ticks() != first)

    def must_run(self) -> None:
        """Go on only with the program running."""
        if not self.is_running():
            self.session.skip(f"the bench program does not run: nothing counts at {self.address}+4")

    def until(self, is_so: Callable[[], bool], within_s: float = REACTION_S) -> bool:
        """See `MscDriver.until`."""
        return self.driver.until(is_so, within_s)

    def taken(self, flag: int, names: Names) -> None:
        """Judge that the program finds a flag on, which it then clears."""
        is_cleared = self.until(lambda: not self.driver.flag(flag))
        self.session.expect(
            is_cleared, names, f"flag {flag} cleared by the program within {REACTION_S:g} s", "on"
        )
