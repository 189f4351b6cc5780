"""Which readings a module follows in what SYNC starts."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import CanDriver

ORDER = 70  # of this module in a run; see `Family.modules`

STEPS: Final = 30
PERIOD: Final = 0x1000  # 512 µs per increment
MOVED_S: Final = 0.15  # by then 30 of them are made


@probe(safety=MOVES, switch="sync_arm_lifetime")
def motions_that_one_2010h_holds(driver: CanDriver) -> Outcome:
    """2010h, 2013h, SYNC, 2013h: whether the second move is held, too."""
    start = driver.motion.ready(PERIOD)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + STEPS)
    driver.client.broadcast(codec.sync())
    driver.client.wait(MOVED_S)
    place = driver.client.position()
    driver.judge.accepted(0x13, start)
    is_second_held = is_held(driver, place)
    driver.motion.at_rest()
    if place != start + STEPS:
        return f"{place - start} of {STEPS} increments after SYNC"
    if is_second_held:
        driver.motion.reinitialise()  # nothing else is said to end it
        return 2
    return 0, 1  # what becomes of one given in motion is asked next


@probe(safety=MOVES)
def sync_dlc(driver: CanDriver) -> Outcome:
    """2010h, 2013h, then SYNC with a byte, and without one."""
    start = driver.motion.ready(PERIOD)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + STEPS)
    starts = []
    for data in (b"\x01", b""):
        driver.client.broadcast(codec.sync(data))
        starts.append(not is_held(driver, start))
    driver.motion.at_rest()
    if driver.session.reading("sync_arm_lifetime") == "permanent":
        driver.motion.reinitialise()
    return {(True, True): 0, (False, True): 1}.get((starts[0], starts[1]), "SYNC starts nothing")
