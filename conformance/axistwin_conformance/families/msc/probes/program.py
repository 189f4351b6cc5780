"""Which readings a unit follows, as far as it takes the bench program in it to show them."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.msc.codec import BLOCK_VALUES
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.probing import running_program

ORDER = 40  # of this module in a run; see `Family.modules`

STARTS: Final = ("stored", "motion")
PROGRAM: Final = ("program",)
PULSES: Final = 12
CALM_S: Final = 0.5  # in which nobody writes
BLOCKS: Final = 8
TIMER_FLAG: Final = 32
TIMER_S: Final = 0.25


@probe(safety=STARTS, needs=PROGRAM)
def write_visibility(driver: MscDriver) -> Outcome:
    """SFLAG and CFLAG back to back: how many such pulses the program has seen, and in how many
    scans beside those that it would have made anyhow."""
    program = running_program(driver)
    target = driver.target
    scans, since_ns = program.ticks(), target.now_ns
    target.wait(CALM_S)
    calm, calm_ns = program.ticks() - scans, target.now_ns - since_ns
    before, widths_ns = program.pulses(), []
    scans, since_ns = program.ticks(), target.now_ns
    for _ in range(PULSES):
        on, off = driver.set_flag(program.pulse), driver.clear_flag(program.pulse)
        widths_ns.append(off.signed_ns - on.signed_ns)
    scans, busy_ns = program.ticks() - scans, target.now_ns - since_ns
    if scans - (calm + 1) * busy_ns / calm_ns > PULSES:  # of two writes each
        return 1
    if program.pulses() - before < PULSES:
        return 0
    if calm_ns / max(calm, 1) < 1.5 * min(widths_ns):
        driver.session.skip("its scans are too short for a pulse to fall between two")
    return 1


@probe(safety=STARTS, needs=PROGRAM)
def bwrite_atomic(driver: MscDriver) -> Outcome:
    """BWRITEs of blocks of one value, and whether the program ever finds two in one."""
    program = running_program(driver)
    before = program.torn()
    for number in range(BLOCKS):
        driver.write_block(program.block, [number + 1] * BLOCK_VALUES)
    return int(program.torn() != before)


@probe(safety=STARTS, needs=PROGRAM)
def timer_flag(driver: MscDriver) -> Outcome:
    """A timer's flag while it runs, and when it has run out."""
    program = running_program(driver)
    set_ns = driver.set_flag(program.timed).asked_ns
    program.until(lambda: not driver.flag(program.timed), TIMER_S / 2)
    while_running = driver.flag(TIMER_FLAG)
    driver.in_time(set_ns, TIMER_S, "the timer")
    driver.target.wait(2 * TIMER_S)
    after = driver.flag(TIMER_FLAG)
    readings = {(True, False): 0, (False, True): 1}
    return readings.get((while_running, after), f"now {while_running}, then {after}")
