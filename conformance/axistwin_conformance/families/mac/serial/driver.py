"""A module on the serial line, as checks handle it, and the same with the rig around it."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.families.mac.axis.driver import motion, rig
from axistwin_conformance.families.mac.serial.client import Talk
from axistwin_conformance.families.mac.serial.codec import Request

NACKED_BY_MANY: Final = "every module of the line Nacks here, all at once: ask it alone"


class Bench(motion.Bench, Talk):
    """One module on the line."""

    def nacked_alone(self, request: Request) -> list[Request]:
        """The frame under a wrong checksum, where only the module it is for could Nack it."""
        return [] if self.is_nacked_by_many else [request.with_wrong_checksum()]


class RigBench(rig.RigBench, Bench):
    """One module on the line and the rig around it."""
