"""Endless motion against the closed form: 15h from rest, changed, stopped (CMD-15)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.motion import locked_on_the_way_down
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import as_velocity, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, ramp_increments
from axistwin_conformance.families.mac.axis.probes.motion import (
    vel_change_law,
    vel_f6_direction,
    vel_reverse_cmd,
)
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES

ORDER = 130  # of this module in a run; see `Family.modules`

F6: Final = 0xF6
FOLLOWS_LOOKS: Final = 4
CHANGES: Final = 20  # of speed, in one motion
STOPPING: Final = ("MACS-CMD-15-04", "MACS-CMD-17-01")


@check("MACS-CMD-15-01", safety=MOVES)
def f6_turns_counter_clockwise(session: Session) -> None:
    """15h with SS = F6h counts down, with any other SS up."""
    driver = driver_of(session)
    driver.motion.ready(0x2000)
    driver.judge.again(vel_f6_direction)
    period, seconds = driver.motion.period, driver.motion.lasting_s(20)
    edges = (0x00, 0x01, 0x06, 0x7F, 0x80, 0xF5, 0xF7, 0xFF)
    for selector in range(0x100) if session.transport.is_virtual else edges:
        if selector == F6:
            continue
        moved = _moved(driver, selector << 16 | period, seconds)
        session.expect(
            moved > 0,
            None,
            f"the counter to count up with sub-byte {selector:02X}h",
            f"{moved:+d} increments",
        )
        driver.motion.come_home()


def judge_follows(driver: AxisDriver, what: str, requirement: str) -> None:
    """At constant speed an axis is not busy whatever the target of the last move was; a look may
    meet the moment at which a real one trails."""
    is_busy = all(driver.status.is_busy() for _ in range(FOLLOWS_LOOKS))
    driver.session.expect(not is_busy, requirement, f"not busy: {what}", "busy")


def _moved(driver: AxisDriver, parameter: int, seconds: float) -> int:
    """How far 15h with that parameter moves the axis in a short time."""
    start = driver.client.position()
    driver.judge.accepted(0x15, parameter)
    driver.client.wait(seconds)
    driver.client.command(0x18)
    return driver.client.position() - start


@check("MACS-CMD-15-01", "MACS-CMD-15-05", safety=MOVES)
def velocity_climbs_and_cruises_on_time(session: Session) -> None:
    """From rest 15h climbs the ramp built from its own period, then holds it; 0Dh stays."""
    driver = driver_of(session)
    for direction, period, coefficient in ((1, 0x10C0, 1), (-1, 0x0690, 2), (1, 0x40A0, 0)):
        driver.motion.ready(0x0777, coefficient)
        period = driver.limits.gentle(period, 0.4)
        if direction < 0:  # 15h powers the motor, as any motion
            driver.judge.accepted(0x1A)
        forecast = driver.motion.turn(direction, period)
        for _ in range(6 if session.transport.is_virtual else 3):
            driver.client.wait(0.06)
            driver.motion.follow(forecast, "MACS-CMD-15-01", driver.limits.allowance(period))
        judge_follows(driver, "15h from rest, at full speed", "MACS-CMD-15-01")
        kept = driver.client.parameter(0x0D)
        wanted = driver.limits.slowed(0x0777)
        session.expect(kept == wanted, "MACS-CMD-15-05", f"{wanted:04X} in 25h", f"{kept:04X}")
        driver.motion.at_rest()


@check("MACS-CMD-15-02", "MACS-CMD-15-03", safety=MOVES, level="full")
def the_direction_stays_whatever_the_next_15h_says(session: Session) -> None:
    """In motion, 15h with the other direction is accepted with SS ignored, or refused."""
    driver = driver_of(session)
    driver.judge.again(vel_reverse_cmd, "MACS-CMD-15-03")
    faster = driver.limits.slowed(0x4000)
    for direction in (1, -1):
        driver.motion.ready(SLOWEST)
        forecast = driver.motion.turn(direction, SLOWEST)
        driver.client.wait(0.1)
        exchange = driver.client.command(0x15, velocity(-direction, faster))
        if exchange.kind is ReplyKind.ACCEPTED:
            forecast = forecast.changed(exchange.taken, faster)
        for _ in range(3):
            driver.client.wait(0.1)
            driver.motion.follow(
                forecast, ("MACS-CMD-15-02", "MACS-CMD-15-03"), driver.limits.allowance(faster)
            )
        driver.motion.at_rest()


@check("MACS-CMD-15-02", safety=MOVES, level="full")
def a_speed_change_takes_one_ramp(session: Session) -> None:
    """15h in motion leads to the new period on a ramp of 120·AA increments."""
    driver = driver_of(session)
    if driver.readings.known("ramp_law"):
        session.skip("the ledger gives no formula for speed changes on such a ramp")
    driver.judge.again(vel_change_law)


def _knows_no_formula(driver: AxisDriver) -> bool:
    """True if the ledger does not say how this device changes speeds on a ramp."""
    law = driver.readings.known("vel_change_law")
    return law == 1 or bool(driver.readings.known("ramp_law"))


@check("MACS-CMD-15-02", safety=MOVES, level="full")
def the_speed_changes_as_often_as_it_is_told(session: Session) -> None:
    """Without a ramp the last of many 15h in a row counts, whatever direction each of them says."""
    driver = driver_of(session)
    is_refused = bool(driver.readings.known("vel_reverse_cmd"))
    driver.motion.ready(SLOWEST)
    driver.motion.turn(-1, SLOWEST)
    fast = driver.limits.gentle(0x2000, 1.0)
    for number in range(CHANGES):
        period = fast if number == CHANGES - 1 else SLOWEST - number
        sign = 1 if number % 3 == 0 and not is_refused else -1
        driver.judge.accepted(0x15, velocity(sign, period))
    driver.client.wait(0.05)
    before = driver.client.sample()
    driver.client.wait(0.15)
    after = driver.client.sample()
    driver.motion.at_rest()
    step_ns, slack = fast * TICK_NS, 1 + driver.limits.allowance(fast)
    least = (after.taken.earliest_ns - before.taken.latest_ns) // step_ns - slack
    most = (after.taken.latest_ns - before.taken.earliest_ns) // step_ns + slack
    moved = abs(after.position - before.position)
    wanted = f"{least}..{most} increments, after {CHANGES} changes of speed"
    session.expect(least <= moved <= most, None, wanted, moved)


@check("MACS-CMD-15-02", "MACS-CMD-15-04", safety=MOVES, level="full")
def speed_changes_follow_the_closed_form(session: Session) -> None:
    """Faster, slower and faster again, then 0000: every leg is where the formula puts it."""
    driver = driver_of(session)
    if _knows_no_formula(driver):
        session.skip("the ledger gives no formula for speed changes on such a ramp")
    if driver.readings.known("stop_ramp_law"):
        session.skip("the ledger gives no formula for stops on such a ramp")
    if driver.readings.is_open("vel_change_law") or driver.readings.is_open("stop_ramp_law"):
        session.skip("its replies take too long to tell by which law it changes speeds and stops")
    first, *others = driver.limits.slowed_alike(0x1800, 0x0600, 0x2000)
    for coefficient in (0, 1, 2):
        driver.motion.ready(0x0800, coefficient)
        forecast = driver.motion.turn(1, first)
        for period in others:
            driver.client.wait(0.06)
            taken = driver.judge.accepted(
                0x15, velocity(1, period), requirement="MACS-CMD-15-02"
            ).taken
            forecast = forecast.changed(taken, period)
            for _ in range(3):
                driver.client.wait(0.04)
                driver.motion.follow(
                    forecast, "MACS-CMD-15-02", driver.limits.allowance(min(others))
                )
        forecast = forecast.stopped(
            driver.judge.accepted(0x15, 0, requirement="MACS-CMD-15-04").taken
        )
        driver.motion.watch(forecast, "MACS-CMD-15-04", samples=3)
        if coefficient:
            _stopped_and_going_on(driver, 0x17 if coefficient == 1 else 0x15, coefficient, first)


def _stopped_and_going_on(driver: AxisDriver, index: int, coefficient: int, period: int) -> None:
    """17h, or 15h with 0000, and on the way down another 15h: the motion goes on at that speed."""
    length = ramp_increments(coefficient)
    period = driver.limits.outlasting(length, period)
    driver.motion.ready(0x0800, coefficient)
    forecast = driver.motion.turn(1, period)
    driver.client.wait(driver.motion.lasting_s(length, period))  # half-way up, in time
    forecast = forecast.stopped(driver.judge.accepted(index).taken)
    again = driver.judge.accepted(0x15, velocity(1, period), requirement="MACS-CMD-15-02")
    assert forecast.end is not None
    driver.motion.taken_in_time(again, forecast.end.earliest_ns, "the motion")
    forecast = forecast.changed(again.taken, period)
    for _ in range(3):
        driver.client.wait(0.15)
        driver.motion.follow(forecast, "MACS-CMD-15-02", driver.limits.allowance(period))
    driver.motion.at_rest()


@check(
    "MACS-CMD-15-04",
    "MACS-CMD-17-01",
    "MACS-CMD-13-02",
    "MACS-STATE-01",
    safety=MOVES,
    level="full",
)
def velocity_0_and_17h_stop_on_the_ramp(session: Session) -> None:
    """15h with 0000, and 17h, bring endless motion to rest one ramp further on; until then it
    counts as running."""
    driver = driver_of(session)
    for direction, coefficient in ((1, 1), (-1, 2)):
        for index, name in ((0x15, "MACS-CMD-15-04"), (0x17, "MACS-CMD-17-01")):
            driver.motion.ready(0x0800, coefficient)
            period = driver.motion.period
            forecast = driver.motion.turn(direction, period)
            driver.client.wait(driver.readings.climbing_s(period, coefficient) + 0.1)
            parameter = velocity(-direction, 0) if index == 0x15 else 0
            stop = driver.judge.accepted(index, parameter, requirement=name)
            stopped = forecast.stopped(stop.taken)
            if coefficient > 1:  # the first one is watched from its beginning
                locked_on_the_way_down(driver, stopped)
                stopped = _stopped_again(driver, index, stopped, name)
            # Of two stops nobody knows which has gone wrong.
            names = STOPPING if coefficient > 1 else name
            place = driver.motion.watch(stopped, names, samples=3)
            driver.client.wait(0.2)
            session.expect(
                driver.client.position() == place,
                name,
                f"rest at {place}",
                driver.client.position(),
            )
            driver.judge.accepted(0x0F, coefficient, requirement=name)


def _stopped_again(driver: AxisDriver, index: int, stopped: Forecast, name: str) -> Forecast:
    """On the way down the same stop again, and the other one: it goes on as it was; where a stop
    takes a whole ramp, the ledger does not say what a second one does (MACS-AMB-45)."""
    if driver.readings.known("stop_ramp_law") or driver.readings.is_open("stop_ramp_law"):
        return stopped
    for again in (index, 0x15 if index == 0x17 else 0x17):
        end, now_ns = stopped.end, driver.client.target.now_ns
        assert end is not None
        if end.earliest_ns - now_ns > 3 * driver.client.target.uncertainty_ns:
            exchange = driver.judge.accepted(again, requirement=name)
            driver.motion.taken_in_time(exchange, end.earliest_ns, "the motion")
            stopped = stopped.stopped(exchange.taken)
    return stopped


@check("MACS-CMD-15-04", safety=MOVES, level="full")
def velocity_0_at_rest_moves_nothing(session: Session) -> None:
    """15h with 0000 at rest is accepted and leaves the axis at rest, unlocked."""
    driver = driver_of(session)
    start = driver.motion.ready()
    driver.judge.accepted(0x15, 0)
    driver.client.wait(0.1)
    session.expect(driver.client.position() == start, None, start, driver.client.position())
    driver.judge.accepted(0x0F, 0)


@check("MACS-CMD-15-06", safety=MOVES, level="full")
def the_first_parameter_byte_of_15h_is_ignored(session: Session) -> None:
    """Whatever stands before SS, speed and direction are the same."""
    driver = driver_of(session)
    period = driver.limits.slowed(0x2000)
    for first in (0x01, 0x7F, 0xF6, 0xFF):
        for direction in (1, -1):
            driver.motion.ready(0x0800)
            origin = driver.client.position()
            exchange = driver.client.command(0x15, first << 24 | velocity(direction, period))
            if exchange.kind is ReplyKind.REFUSED:
                driver.judge.reading("dont_care_digits", 1)
                continue
            driver.judge.must(ReplyKind.ACCEPTED, exchange)
            forecast = driver.motion.to_velocity(exchange, origin, direction, period)
            driver.client.wait(0.05)
            driver.motion.follow(forecast, None, driver.limits.allowance(period))
            driver.motion.at_rest()


@check("MACS-CMD-15-02", "MACS-STATE-01", safety=MOVES, level="full")
def velocity_takes_over_from_a_move(session: Session) -> None:
    """15h during 13h is accepted: endless motion on past the target; or refused."""
    driver = driver_of(session)
    start = driver.motion.ready(0x1000, 1)
    forecast = driver.motion.go(start + 400)
    driver.client.wait(driver.motion.lasting_s(300))
    exchange = driver.client.command(0x15, velocity(1, driver.motion.period))
    outcome: int | str = ACCEPTED_OR_REFUSED.get(exchange.kind, str(exchange.reply))
    driver.judge.reading("vel_during_position", outcome, "MACS-CMD-15-02")
    if outcome == 1:
        driver.motion.finish(forecast, "MACS-STATE-01")
        return
    # At the very speed of the move, a change changes nothing but the end.
    driver.client.wait(driver.motion.lasting_s(500))
    place = driver.client.position()
    session.expect(place > start + 400, "MACS-CMD-15-02", f"beyond {start + 400}", place)
    judge_follows(driver, "15h during a move, at its speed", "MACS-CMD-15-02")
    driver.judge.refused(0x02, 0, requirement="MACS-STATE-01")
    driver.motion.at_rest()


@check("MACS-CMD-15-02", safety=MOVES, level="full")
def velocity_takes_over_from_a_segment(session: Session) -> None:
    """15h during a segment is accepted, empties the FIFO and leads from the segment's speed to its
    own, as any 15h in motion; or is refused."""
    driver = driver_of(session)
    period = driver.limits.slowed(0x2000)
    for coefficient in (0, 1):
        is_open = driver.readings.is_open("vel_change_law")
        if coefficient and (is_open or _knows_no_formula(driver)):
            break
        start = driver.motion.ready(0x1000, coefficient)
        segment = driver.limits.segment(100, SLOWEST, exchanges=4)
        first = driver.motion.put(segment)
        driver.judge.accepted(0x1E, 0x0010FFFF)
        exchange = driver.client.command(0x15, velocity(1, period))
        outcome: int | str = ACCEPTED_OR_REFUSED.get(exchange.kind, str(exchange.reply))
        driver.judge.reading("vel_during_interp", outcome)
        if outcome == 0:
            over_ns = first.taken.earliest_ns + segment.duration_ns
            driver.motion.taken_in_time(exchange, over_ns, "the segment")
            forecast = as_velocity(driver.motion, first, start, segment.period)
            forecast = forecast.changed(exchange.taken, period)
            for _ in range(4):
                driver.client.wait(0.1)
                driver.motion.follow(forecast, None, driver.limits.allowance(period))
        driver.motion.at_rest()


@check("MACS-CMD-15-04", safety=MOVES, level="full")
def velocity_0_ends_segments(session: Session) -> None:
    """15h with 0000 during a segment stops the axis and empties the FIFO, or is refused."""
    driver = driver_of(session)
    driver.motion.ready(0x1000)
    driver.judge.accepted(0x16, 100 << 16 | SLOWEST)
    driver.judge.accepted(0x16, 100 << 16 | SLOWEST)
    exchange = driver.client.command(0x15, velocity(1, 0))
    outcome: int | str = ACCEPTED_OR_REFUSED.get(exchange.kind, str(exchange.reply))
    driver.judge.reading("vel_during_interp", outcome, "MACS-CMD-15-04")
    if outcome == 0:
        driver.client.wait(0.3)
        place = driver.client.position()
        driver.client.wait(0.3)
        session.expect(
            driver.client.position() == place, None, f"rest at {place}", driver.client.position()
        )
        driver.judge.accepted(0x0F, 0)
    driver.motion.at_rest()
