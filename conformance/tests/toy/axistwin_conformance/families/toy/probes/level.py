"""Which letter acknowledges a level, and whether it outlives the supply."""

from __future__ import annotations

from axistwin_conformance.core.probing import Outcome, probe

from ..family import Lamp


@probe(safety="stored")
def acknowledge(lamp: Lamp) -> Outcome:
    """The letter that answers a level"""
    answer = lamp.set_level(5)
    return {"K": 0, "A": 1}.get(answer, f"it answers {answer!r}")


@probe(safety=("stored", "rig"), needs=("rig:power",))
def keeps_level(lamp: Lamp) -> Outcome:
    """The level after the supply was off"""
    lamp.set_level(7)
    lamp.switch_off_and_on()
    came = lamp.level()
    return {"7\n": 0, "0\n": 1}.get(came, f"the level is {came!r}")
