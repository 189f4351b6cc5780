"""A module on the bus, as checks handle it, and the same with the rig around it."""

from __future__ import annotations

from axistwin_conformance.families.mac.axis.driver import motion, rig
from axistwin_conformance.families.mac.can.client import Talk


class Bench(motion.Bench, Talk):
    """One module on the bus."""


class RigBench(rig.RigBench, Bench):
    """One module on the bus and the rig around it."""
