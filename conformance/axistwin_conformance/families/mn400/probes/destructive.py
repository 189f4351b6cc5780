"""Which readings a board follows in what can make it unreachable: its id; and after power-up.

Each puts back at once what it changed, alone on the line.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.persistence.address_recovery import (
    brought_back,
    is_there,
    other_ids,
)
from axistwin_conformance.families.mn400.persistence.programs import PROFILE
from axistwin_conformance.families.mn400.persistence.supply import power_cycle
from axistwin_conformance.families.mn400.probes.together import LONGEST_SLOT_S, slot_reading

ORDER = 120  # of this module in a run; see `Family.modules`

DESTRUCTIVE: Final = ("destructive",)
ALONE: Final = ("alone",)
POWER: Final = ("rig:power",)
FEW_STEPS: Final = 5
FAR_IDS: Final = (9, 41)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def address_settable(driver: BoardDriver) -> Outcome:
    """= with another id, and a poll there."""
    (new, *_) = other_ids(driver, 2, 3)
    with brought_back(driver, new):
        driver.ask(f"={new}")
        return _is_moved(driver, new)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def broadcast_setaddr(driver: BoardDriver) -> Outcome:
    """= with another id, sent to all boards."""
    if driver.reading("address_settable") == "false":
        driver.session.skip("this board has one id for ever")
    (new, *_) = other_ids(driver, 2, 3)
    with brought_back(driver, new):
        driver.client.ask_all(f"={new}", driver.slots_s())
        return _is_moved(driver, new)


def _is_moved(driver: BoardDriver, new: int) -> Outcome:
    """Whether the board now answers at the new id: 0; at its old one: 1."""
    if is_there(driver, new):
        return 0
    return 1 if is_there(driver, driver.board) else "it answers at neither id"


@probe(safety=DESTRUCTIVE, needs=ALONE)
def poll_slot_ms(driver: BoardDriver) -> Outcome:
    """How much later a poll of all boards is answered at id 41 than at id 9."""
    if driver.reading("address_settable") == "false":
        driver.session.skip("this board has one id for ever")
    waited_ns = []
    limit_s = LONGEST_SLOT_S * max(FAR_IDS)
    for board in FAR_IDS:
        with brought_back(driver, board):
            driver.ask(f"={board}")
            exchange = driver.client.ask_all("*", limit_s)
            if not exchange.found:
                return f"no answer at id {board}"
            waited_ns.append((board, exchange.came_ns[0] - exchange.asked_ns))
    (low, early_ns), (high, late_ns) = waited_ns
    return slot_reading(driver, (late_ns - early_ns) / (high - low) / 1e6)


# --- after power-up -------------------------------------------------------------------------------


@probe(safety="rig", needs=POWER)
def power_on_position(driver: BoardDriver) -> Outcome:
    """L5,6,7,8, a power cycle, E."""
    driver.command("L5,6,7,8")
    power_cycle(driver)
    counters = driver.position()
    return Measured(str(counters[0])) if len({*counters}) == 1 else str(counters)


@probe(safety="rig", needs=POWER)
def feedhold_power_on(driver: BoardDriver) -> Outcome:
    """The second field of : after a power cycle."""
    if driver.reading("has_feedhold_cmds") == "false":
        driver.session.skip("this board has no feed hold")
    power_cycle(driver)
    return driver.flags()["FeedHold"]


@probe(safety=("motion", "rig"), needs=POWER)
def power_on_mode(driver: BoardDriver) -> Outcome:
    """A power cycle, then L5,0,0,0, M5 and no I: E is 10 in relative mode, 5 in absolute mode."""
    power_cycle(driver)
    for text in (PROFILE, "V200"):
        driver.command(text)
    driver.command(f"L{FEW_STEPS},0,0,0")
    driver.command(f"M{FEW_STEPS}")
    driver.target.wait(1.0)
    steps = driver.position()[0]
    return {2 * FEW_STEPS: 0, FEW_STEPS: 1}.get(steps, f"{steps} steps")
