"""Which readings a unit follows, as far as it takes the bench program in it to show them."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.msc.bench import Bench
from axistwin_conformance.msc.codec import BLOCK_VALUES
from axistwin_conformance.msc.probing import running_program
from axistwin_conformance.probing import Outcome, probe
from axistwin_conformance.profile import Probe

STARTS: Final = ("stored", "motion")
PROGRAM: Final = ("program",)
PULSES: Final = 12
BLOCKS: Final = 8
TIMER_FLAG: Final = 32
TIMER_S: Final = 0.25


@probe(safety=STARTS, needs=PROGRAM)
def write_visibility(bench: Bench) -> Outcome:
    """SFLAG and CFLAG back to back, and how many such pulses the program has seen."""
    program = running_program(bench)
    before, ticks, began_ns = program.pulses(), program.ticks(), bench.target.now_ns
    shortest_ns = None
    for _ in range(PULSES):
        on, off = bench.set_flag(program.pulse), bench.clear_flag(program.pulse)
        width_ns = off.signed_ns - on.signed_ns
        shortest_ns = width_ns if shortest_ns is None else min(width_ns, shortest_ns)
    seen = program.pulses() - before
    scans = program.ticks() - ticks
    scan_ns = (bench.target.now_ns - began_ns) // max(scans, 1)
    if seen < PULSES:
        return 0
    assert shortest_ns is not None
    if scan_ns < 1.5 * shortest_ns:
        bench.session.skip("its scans are too short for a pulse to fall between two")
    return 1


@probe(safety=STARTS, needs=PROGRAM)
def bwrite_atomic(bench: Bench) -> Outcome:
    """BWRITEs of blocks of one value, and whether the program ever finds two in one."""
    program = running_program(bench)
    before = program.torn()
    for number in range(BLOCKS):
        bench.write_block(program.block, [number + 1] * BLOCK_VALUES)
    return int(program.torn() != before)


@probe(safety=STARTS, needs=PROGRAM)
def timer_flag(bench: Bench) -> Outcome:
    """A timer's flag while it runs, and when it has run out."""
    program = running_program(bench)
    bench.set_flag(program.timed)
    program.until(lambda: not bench.flag(program.timed), TIMER_S / 2)
    while_running = bench.flag(TIMER_FLAG)
    bench.target.wait(2 * TIMER_S)
    after = bench.flag(TIMER_FLAG)
    readings = {(True, False): 0, (False, True): 1}
    return readings.get((while_running, after), f"now {while_running}, then {after}")


PROBES: Final = tuple(one for one in vars().values() if isinstance(one, Probe))
