"""A module on the bus, as checks handle it, and the same with the rig around it."""

from __future__ import annotations

from axistwin_conformance.mac_axis import bench, rig_bench
from axistwin_conformance.mac_can.talk import Talk


class Bench(bench.Bench, Talk):
    """One module on the bus."""


class RigBench(rig_bench.RigBench, Bench):
    """One module on the bus and the rig around it."""
