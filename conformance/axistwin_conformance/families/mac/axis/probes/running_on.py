"""Whether an axis runs on after 18h and stops: asked before anything else that moves it, since all
other questions end their motions by one of these.

A software stop is a number of the counter, so how far it is overrun does not depend on when anybody
looks: it is the same in virtual time and on a real line.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import SLOWEST, Bench
from axistwin_conformance.families.mac.axis.model.kinematics import TICKS_PER_SECOND
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 50  # of this module in a run; see `Family.modules`

AHEAD: Final = 50  # increments to the stop
FURTHER: Final = 1500  # increments to where a move would end that no stop ends
FAR: Final = 100_000  # increments: a stop that is never reached
PERIOD: Final = 0x1000
FASTER: Final = 0x0400  # 7812 inc/s: an unloaded axis with inertia brakes over 4 increments
FASTEST: Final = 100
LOOK_S: Final = 0.25  # the last of 200 increments takes as long at the slowest speed
LOOKS: Final = 40


def travel_guard(bench: Bench, distance: int, period: int = PERIOD) -> int:
    """Put the superior stop so far ahead, the other far behind; give the start."""
    if bench.known("ff_lifetime") == 2:  # only a restart clears ff on this device
        bench.reinitialise()
    start = bench.ready(period)
    bench.accepted(0x09, start + distance)
    bench.accepted(0x0A, start - FAR)
    bench.accepted(0x03, 8)
    return start


def overrun(bench: Bench, period: int) -> int:
    """How many increments further than the first one beyond a software stop a move at that speed
    comes to rest."""
    return _outward(bench, AHEAD, period) - AHEAD - 1


def may_go_fast(bench: Bench) -> bool:
    """Whether the envelope has room for a motion in which inertia shows: 80000 inc/s."""
    return bench.fastest <= FASTEST and bench.room() >= 4000


def step_from_a_stop(bench: Bench) -> int:
    """1 where a move further out makes no step from a place on a software stop: equal is beyond."""
    return int(_outward(bench, 0, PERIOD) == 0)


def _outward(bench: Bench, ahead: int, period: int) -> int:
    """How far the axis comes on its way to a place beyond a software stop so far ahead; leaves the
    probe where the stop stops nothing."""
    bench.needs_room(2 * AHEAD, "a software stop to be overrun")
    start, far = travel_guard(bench, ahead, period), min(FURTHER, bench.room())
    bench.command(0x13, start + far)
    bench.wait((AHEAD + 1) * bench.period / TICKS_PER_SECOND)
    place = bench.position()
    for _ in range(LOOKS):
        bench.wait(LOOK_S)
        before, place = place, bench.position()
        if place == before:
            break
    bench.at_rest()
    bench.accepted(0x03, 0)
    moved = place - start
    if not 0 <= moved < far:
        bench.session.skip(f"moved by {moved} of {far} increments: no stop at {ahead} ended that")
    return moved


@probe(safety=MOVES, switch="brake_increments")
def running_on(bench: Bench) -> Outcome:
    """How far the slowest motion overruns a software stop: a number, where nothing has to brake."""
    further = step_from_a_stop(bench)
    number = overrun(bench, SLOWEST) + further
    fast = overrun(bench, FASTER) + further if number > 0 else number
    is_of_the_plant = number == 1 and (fast > 1 or bench.period > FASTER)
    if number == 0 or is_of_the_plant:
        if bench.target.is_virtual:
            bench.session.skip("stands at once when it is slow")
        return 0
    if number < 0 or fast != number:
        return f"overrun by {number} increments, and by {fast} when it is faster"
    return Measured(str(number))


@probe(safety=MOVES, switch="plant")
def inertia(bench: Bench) -> Outcome:
    """How far the slowest motion overruns a software stop: one increment, where inertia does it."""
    if bench.target.is_virtual and may_go_fast(bench):
        bench.session.skip("there it shows in motion too")
    if bench.session.reading("brake_increments").isdigit():
        bench.session.skip("nothing brakes this axis that would tell")
    return int(overrun(bench, SLOWEST) + step_from_a_stop(bench) > 0)
