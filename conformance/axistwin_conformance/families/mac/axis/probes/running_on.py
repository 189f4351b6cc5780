"""Whether an axis runs on after 18h and stops: asked before anything else that moves it, since all
other questions end their motions by one of these.

A software stop is a number of the counter, so how far it is overrun does not depend on when anybody
looks: it is the same in virtual time and on a real line.
"""

from __future__ import annotations

import math
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import velocity
from axistwin_conformance.families.mac.axis.model.kinematics import TICKS_PER_SECOND
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 50  # of this module in a run; see `Family.modules`

AHEAD: Final = 50  # increments to the stop
FURTHER: Final = 1500  # increments to where a move would end that no stop ends
FAR: Final = 100_000  # increments: a stop that is never reached
PERIOD: Final = 0x1000
FASTER: Final = 0x0400  # 7812 inc/s: an unloaded axis with inertia brakes over 4 increments
FASTEST: Final = 100
LAG_NS: Final = 3_000_000  # with inertia an axis trails its set-point at that speed by 4 ms or more
LOOK_S: Final = 0.25
LOOKS: Final = 450  # more than π/2·√N of the largest number there is, as the speed falls


def travel_guard(driver: AxisDriver, distance: int, period: int = PERIOD) -> int:
    """Put the superior stop so far ahead, the other far behind; give the start."""
    if driver.readings.known("ff_lifetime") == 2:  # only a restart clears ff on this device
        driver.motion.reinitialise()
    start = driver.motion.ready(period)
    driver.judge.accepted(0x09, start + distance)
    driver.motion.keep_off(0x0A, start - FAR)
    driver.judge.accepted(0x03, 8)
    return start


def overrun(driver: AxisDriver, period: int) -> int:
    """How many increments further than the first one beyond a software stop a move at that speed
    comes to rest."""
    return _outward(driver, AHEAD, period) - AHEAD - 1


def may_go_fast(driver: AxisDriver) -> bool:
    """Whether the envelope has room for a motion in which inertia shows: 80000 inc/s."""
    return driver.limits.fastest <= FASTEST and driver.limits.room() >= 4000


def may_see_lag(driver: AxisDriver) -> bool:
    """Whether this device replies soon enough that such a motion shows how far the axis trails."""
    return driver.client.target.round_trip.way_ns < LAG_NS


def step_from_a_stop(driver: AxisDriver) -> int:
    """1 where a move further out makes no step from a place on a software stop: equal is beyond."""
    return int(_outward(driver, 0, PERIOD) == 0)


def _outward(driver: AxisDriver, ahead: int, period: int) -> int:
    """How far the axis comes on its way to a place beyond a software stop so far ahead; leaves the
    probe where the stop stops nothing."""
    driver.limits.needs_room(2 * AHEAD, "a software stop to be overrun")
    start, far = travel_guard(driver, ahead, period), min(FURTHER, driver.limits.room())
    guard = driver.motion.travel_guard
    if guard is not None:
        guard.run_on = driver.limits.room() - ahead
    driver.client.command(0x13, start + far)
    driver.client.wait((AHEAD + 1) * driver.motion.period / TICKS_PER_SECOND)
    place = driver.client.position()
    for _ in range(LOOKS):
        # The last of N increments takes 2√N times as long as the first.
        last_s = 2 * driver.motion.lasting_s(math.isqrt(max(0, place - start)) + 1)
        driver.client.wait(max(LOOK_S, last_s))
        before, place = place, driver.client.position()
        if place == before:
            break
    driver.motion.at_rest()
    driver.judge.accepted(0x03, 0)
    if guard is not None:
        guard.run_on = 0
    moved = place - start
    if moved < 0 or moved == far:
        driver.session.skip(f"moved by {moved} of {far} increments: no stop at {ahead} ended that")
    return moved


@probe(safety=MOVES, switch="brake_increments")
def running_on(driver: AxisDriver) -> Outcome:
    """How far the slowest motion overruns a software stop: a number, where nothing has to brake."""
    further = step_from_a_stop(driver)
    number = overrun(driver, SLOWEST) + further
    fast = overrun(driver, FASTER) + further if number > 0 else number
    is_of_the_plant = number == 1 and (fast > 1 or driver.motion.period > FASTER)
    if number == 0 or is_of_the_plant:
        if driver.client.target.is_virtual:
            driver.session.skip("stands at once when it is slow")
        return 0
    if number < 0 or fast != number:
        return f"overrun by {number} increments, and by {fast} when it is faster"
    return Measured(str(number))


@probe(safety=MOVES, switch="plant")
def inertia(driver: AxisDriver) -> Outcome:
    """How far the slowest motion overruns a software stop: one increment, where inertia does it."""
    if driver.client.target.is_virtual and may_go_fast(driver) and may_see_lag(driver):
        driver.session.skip("there it shows in motion too")
    if driver.session.reading("brake_increments").isdigit():
        driver.session.skip("nothing brakes this axis that would tell")
    if overrun(driver, SLOWEST) + step_from_a_stop(driver) > 0:
        return 1
    # It may stop at once all the same.  The built-in twin alone has no load that would hold it.
    return int(driver.client.target.is_virtual and _trails_without_torque(driver))


def _trails_without_torque(driver: AxisDriver) -> bool:
    period = driver.limits.slowed(FASTER)
    start, own = driver.motion.ready(period, 0), driver.client.parameter(0x0C)
    driver.judge.accepted(0x0C, 1)
    is_behind = trails(driver, start, period)
    driver.client.command(0x0C, own)
    return is_behind


def trails(driver: AxisDriver, start: int, period: int) -> bool:
    """Whether the axis, at rest at `start`, is behind a motion without ramp at that period."""
    exchange = driver.judge.accepted(0x15, velocity(1, period))
    samples = driver.motion.sampled(0.02, 2)
    driver.client.command(0x18)
    return not driver.motion.fit(samples, [driver.motion.to_velocity(exchange, start, 1, period)])
