"""Synchronous mode: 10h arms, a motion is loaded, 11h starts it (CMD-10, CMD-11)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probes.motion import preload_policy
from axistwin_conformance.families.mac.axis.probes.sync import (
    armed_zero_velocity,
    is_held,
    sync_during_interp,
)
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES

ORDER = 150  # of this module in a run; see `Family.modules`

ARMED_S: Final = 1.0  # an arm has no end of its own; see also left_alone.py
ARMED_EXCHANGES: Final = 8  # in a move
ASIDE: Final = 60  # increments


@check("MACS-CMD-10-01", "MACS-CMD-11-01", "MACS-STATE-01", safety=MOVES)
def a_preloaded_move_waits_for_11h(session: Session) -> None:
    """After 10h, 13h is acknowledged and nothing moves or locks; 11h starts it, on time."""
    driver = driver_of(session)
    for distance in (120, -75):
        start = driver.motion.ready(0x1000, 1)
        if distance < 0:  # 11h powers the motor, as any motion
            driver.judge.accepted(0x1A)
        driver.judge.accepted(0x10, requirement="MACS-CMD-10-01")
        if distance > 0:
            driver.client.wait(ARMED_S)
        driver.judge.must(ReplyKind.ANSWER, driver.client.ask(0x20))
        driver.judge.accepted(0x13, start + distance, requirement="MACS-CMD-10-01")
        session.expect(
            is_held(driver, start),
            "MACS-CMD-10-01",
            f"rest at {start} until 11h",
            driver.client.position(),
        )
        session.expect(not driver.status.is_busy(), "MACS-STATE-01", "not busy", "busy")
        lock = driver.client.command(0x0F, 1).kind
        driver.judge.reading("preload_locks", int(lock is ReplyKind.REFUSED), "MACS-STATE-01")
        exchange = driver.judge.accepted(0x11, requirement="MACS-CMD-11-01")
        driver.motion.watch(
            driver.motion.to_position(exchange, start, start + distance), "MACS-CMD-11-01"
        )


@check("MACS-CMD-10-01", "MACS-CMD-11-01", "MACS-CMD-14-01", safety=MOVES, level="full")
def velocity_and_14h_can_be_preloaded_too(session: Session) -> None:
    """15h and 14h after 10h wait for 11h just so; 14h goes to 0, wherever the last move went."""
    driver = driver_of(session)
    start = driver.motion.ready(0x1000, 1)
    start = driver.motion.finish(driver.motion.go(start + ASIDE))
    driver.judge.accepted(0x10)
    period = driver.limits.slowed(0x1800)
    driver.judge.accepted(0x15, velocity(-1, period))
    session.expect(
        is_held(driver, start),
        "MACS-CMD-10-01",
        f"rest at {start} until 11h",
        driver.client.position(),
    )
    exchange = driver.judge.accepted(0x11)
    forecast = driver.motion.to_velocity(exchange, start, -1, period)
    for _ in range(3):
        driver.client.wait(0.1)
        driver.motion.follow(forecast, "MACS-CMD-11-01", driver.limits.allowance(period))
    driver.motion.at_rest()
    start = driver.client.position()
    if abs(start) > driver.limits.room():  # back to where it was found
        start = driver.motion.ready(0x1000, 1)
    if abs(start) > driver.limits.room():
        return
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x14, requirement="MACS-CMD-14-01")
    session.expect(
        is_held(driver, start),
        "MACS-CMD-10-01",
        f"rest at {start} until 11h",
        driver.client.position(),
    )
    exchange = driver.judge.accepted(0x11)
    driver.motion.watch(
        driver.motion.to_position(exchange, start, 0), ("MACS-CMD-14-01", "MACS-CMD-11-01")
    )


@check("MACS-CMD-19-01", safety=MOVES, level="full")
def power_leaves_what_10h_has_begun(session: Session) -> None:
    """19h after 10h, and with a motion preloaded, neither starts the motion nor drops it; nor does
    it stop an endless motion."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x19)
    driver.judge.accepted(0x13, start + 30)
    driver.judge.accepted(0x19)
    held = is_held(driver, start)
    session.expect(held, None, f"rest at {start} until 11h", driver.client.position())
    exchange = driver.judge.accepted(0x11)
    driver.motion.finish(driver.motion.to_position(exchange, start, start + 30))
    period = driver.limits.gentle(0x2000, 1.0)
    driver.motion.ready()
    forecast = driver.motion.turn(1, period)
    driver.judge.accepted(0x19)
    for _ in range(3):
        driver.client.wait(0.05)
        driver.motion.follow(forecast, None, driver.limits.allowance(period))
    driver.motion.at_rest()


@check("MACS-CMD-10-02", "MACS-CMD-11-02", "MACS-CMD-11-01", safety=MOVES)
def arming_concerns_one_motion(session: Session) -> None:
    """The motion after a synchronised one starts directly, also behind one of no way; a second 11h
    starts nothing again."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    driver.judge.accepted(0x10, requirement="MACS-CMD-10-02")
    if driver.readings.known("sync_arm_lifetime") != 1:  # twice is as good as once (MACS-AMB-35)
        driver.judge.accepted(0x10, requirement="MACS-CMD-10-02")
    driver.judge.accepted(0x13, start + 30)
    exchange = driver.judge.accepted(0x11)
    place = driver.motion.finish(driver.motion.to_position(exchange, start, start + 30))
    driver.judge.reading("sync_without_preload", _without_preload(driver), "MACS-CMD-11-02")
    session.expect(
        is_held(driver, place), "MACS-CMD-11-02", f"at {place}", driver.client.position()
    )
    if not _is_permanent(driver):
        driver.motion.finish(driver.motion.go(start), "MACS-CMD-10-02")
        for index in (0x14, 0x13) if start == 0 else (0x13,):
            driver.judge.accepted(0x10)
            driver.judge.accepted(index, start)  # where it is: the motion that 10h concerns
            driver.judge.accepted(0x11, requirement="MACS-CMD-11-01")
            start = driver.motion.finish(driver.motion.go(start + 30), "MACS-CMD-10-02")
        return
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start)
    exchange = driver.judge.accepted(0x11)
    driver.motion.finish(driver.motion.to_position(exchange, place, start))
    driver.judge.accepted(0x13, start + 30)  # armed by no 10h of its own
    outcome = 2 if is_held(driver, start) else (0, 1)
    driver.judge.reading("sync_arm_lifetime", outcome, "MACS-CMD-10-02")


def _is_permanent(driver: AxisDriver) -> bool:
    """True on a device that 10h leaves armed, motion after motion (MACC-AMB-31)."""
    return driver.readings.known("sync_arm_lifetime") == 2


def _armed_still(driver: AxisDriver, *, held: bool) -> tuple[int, ...]:
    """The readings of a motion behind a 10h that was given in motion: held, or not."""
    if not held:
        return (1,)
    switches = driver.session.run.ledger.ambiguity_of("sync_arm_lifetime").switches
    return tuple(number for number in range(len(switches["sync_arm_lifetime"])) if number != 1)


def _without_preload(driver: AxisDriver) -> int | str:
    reply = driver.client.command(0x11).reply
    return ACCEPTED_OR_REFUSED.get(reply.kind, str(reply))


@check("MACS-CMD-11-02", "MACS-CMD-11-01", safety=MOVES, level="full")
def without_a_preloaded_motion_11h_moves_nothing(session: Session) -> None:
    """11h at rest, and after a 10h without motion, moves nothing; the order must be right."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    driver.motion.finish(driver.motion.go(start + 20))
    for commands in ((0x11,), (0x10, 0x11), (0x11, 0x10)):
        for index in commands:
            reply = driver.client.command(index).reply
            if index == 0x11:
                outcome = ACCEPTED_OR_REFUSED.get(reply.kind, str(reply))
                driver.judge.reading("sync_without_preload", outcome, "MACS-CMD-11-02")
        held = is_held(driver, start + 20)
        session.expect(
            held, ("MACS-CMD-11-02", "MACS-CMD-11-01"), f"at {start + 20}", driver.client.position()
        )
        driver.motion.disarm()


@check("MACS-CMD-10-03", "MACS-CMD-10-01", safety=MOVES)
def segments_are_not_held_by_10h(session: Session) -> None:
    """1Eh and 16h run although the module is armed; whether the arm then stays is reported."""
    driver = driver_of(session)
    start = driver.motion.ready(0x1000)
    driver.judge.accepted(0x10)
    pause = driver.limits.segment(1000, driver.motion.period, moves=False)
    forecast = driver.motion.feed(start, pause, Segment(25, driver.motion.period))
    driver.motion.follow(forecast, "MACS-CMD-10-03", driver.limits.allowance(driver.motion.period))
    driver.client.wait(0.1 + driver.motion.lasting_s(pause.steps, pause.period))
    driver.client.wait(driver.motion.lasting_s(25))
    place = driver.client.position()
    session.expect(place == start + 25, "MACS-CMD-10-03", start + 25, place)
    driver.judge.accepted(0x13, start)
    outcome = int(not is_held(driver, place))
    driver.judge.reading("arm_after_segment", outcome, "MACS-CMD-10-01")
    driver.client.command(0x11)
    driver.client.wait(0.1)


@check("MACS-CMD-10-02", "MACS-CMD-11-01", safety=MOVES, level="full")
def a_second_motion_replaces_the_preloaded_one(session: Session) -> None:
    """10h, 13h to one place, 13h to another, 11h: the second counts, or was refused."""
    driver = driver_of(session)
    start = driver.motion.ready(0x0800)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + 60)
    second = driver.client.command(0x13, start - 60)
    driver.judge.accepted(0x11, requirement="MACS-CMD-11-01")
    driver.client.wait(0.25 + driver.motion.lasting_s(60))
    moved = driver.client.position() - start
    if second.kind is ReplyKind.ACCEPTED:
        session.expect(
            moved == -60 or (moved == 60 and driver.readings.known("preload_policy") == 2),
            "MACS-CMD-10-02",
            "the second target, -60",
            f"{moved:+d}",
        )
    else:
        driver.judge.must(ReplyKind.REFUSED, second, "MACS-CMD-10-02")
        if not driver.readings.known("preload_locks"):
            driver.judge.reading("preload_policy", 1, "MACS-CMD-10-02")
        session.expect(moved == 60, "MACS-CMD-10-02", "the first target, +60", f"{moved:+d}")


@check("MACS-CMD-18-03", "MACS-CMD-10-02", safety=MOVES, level="full")
def stops_and_power_off_drop_a_preloaded_motion(session: Session) -> None:
    """17h, 18h and 1Ah drop preload and arm, or are refused, or leave them: one and the same."""
    driver = driver_of(session)
    driver.motion.ready(0x1000)
    driver.judge.again(preload_policy, ("MACS-CMD-18-03", "MACS-CMD-10-02"))
    for index in (0x17, 0x18, 0x1A):
        start = driver.motion.ready(0x1000)
        driver.judge.accepted(0x10)
        driver.judge.accepted(0x13, start + 400)
        stop = driver.client.command(index)
        driver.client.command(0x11)
        driver.client.wait(0.2)
        driver.client.command(0x18)
        moved = driver.client.position() != start
        driver.judge.must(ReplyKind.ACCEPTED, stop)
        if moved and index != 0x1A and driver.readings.known("abort_flush"):
            continue  # this device keeps what is stored over a stop, whatever it is
        if moved or driver.readings.known("preload_policy") != 1:
            driver.judge.reading("preload_policy", 2 if moved else 0, "MACS-CMD-18-03")
        if not moved:
            start = driver.client.position()
            driver.motion.finish(driver.motion.go(start + 10), "MACS-CMD-10-02")


@check("MACS-CMD-15-04", "MACS-CMD-10-01", safety=MOVES, level="full")
def velocity_0_while_armed_at_rest(session: Session) -> None:
    """10h, then 15h with 0000, then 13h: whether 13h is held tells what became of the arm."""
    driver_of(session).judge.again(armed_zero_velocity, ("MACS-CMD-15-04", "MACS-CMD-10-01"))


@check("MACS-CMD-11-01", "MACS-CMD-10-03", safety=MOVES, level="full")
def a_preloaded_move_started_during_segments(session: Session) -> None:
    """11h while segments run: the move follows them, or starts at once, or is dropped."""
    driver = driver_of(session)
    if driver.readings.known("arm_after_segment") or _is_permanent(driver):
        session.skip("this device's readings of 10h leave nothing to start, or all")
    driver.judge.again(sync_during_interp, ("MACS-CMD-11-01", "MACS-CMD-10-03"))
    if not driver.readings.known("sync_during_interp"):
        start = driver.motion.ready(0x4000)
        for index, parameter in (
            (0x10, 0),
            (0x13, start - 20),
            (0x16, segment_parameter(20, driver.motion.period)),
        ):
            driver.judge.accepted(index, parameter)
        driver.judge.accepted(0x11, requirement="MACS-CMD-11-01")
        driver.client.wait(0.4 + driver.motion.lasting_s(60))
        driver.motion.finish(
            driver.motion.go(start), "MACS-CMD-11-01"
        )  # not held back: 11h has used it up


@check("MACS-CMD-11-01", safety=MOVES, level="full")
def a_preloaded_speed_started_during_segments_is_taken_at_once(session: Session) -> None:
    """10h, 15h, then 11h while a segment runs: the axis goes on without end at the new speed."""
    driver = driver_of(session)
    if _is_permanent(driver):
        session.skip("this device's sync_arm_lifetime holds every motion")
    for switch in ("arm_after_segment", "vel_during_interp", "preload_policy"):
        if driver.readings.known(switch):
            session.skip(f"this device's {switch} leaves nothing to start")
    driver.motion.ready(0x4000)
    slow, fast = driver.limits.slowed_alike(0x8000, 0x2000)
    for index, parameter in (
        (0x10, 0),
        (0x15, velocity(1, slow)),
        (0x16, segment_parameter(50, fast)),
    ):
        driver.judge.accepted(index, parameter)
    driver.judge.accepted(0x11, requirement="MACS-CMD-11-01")
    driver.client.wait(0.2)
    before = driver.client.sample()
    driver.client.wait(0.2)
    after = driver.client.sample()
    driver.judge.accepted(0x18)
    step_ns, slack = slow * TICK_NS, 1 + driver.limits.allowance(slow)
    least = (after.taken.earliest_ns - before.taken.latest_ns) // step_ns - slack
    most = (after.taken.latest_ns - before.taken.earliest_ns) // step_ns + slack
    moved = after.position - before.position
    session.expect(least <= moved <= most, None, f"{least}..{most} increments", moved)


@check("MACS-CMD-10-01", "MACS-STATE-01", safety=MOVES, level="full")
def arming_in_motion_concerns_the_next_motion(session: Session) -> None:
    """10h during a move touches neither it nor its lock; the next move is held until 11h."""
    driver = driver_of(session)
    start = driver.motion.ready(SLOWEST)
    forecast = driver.motion.go(start + driver.limits.way_outlasting(30, SLOWEST, ARMED_EXCHANGES))
    driver.judge.accepted(0x10)
    _judge_locked(driver, forecast)
    place = driver.motion.watch(forecast, "MACS-CMD-10-01", samples=2)
    driver.judge.accepted(0x13, start)
    held = is_held(driver, place)
    driver.judge.reading("sync_arm_lifetime", _armed_still(driver, held=held), "MACS-CMD-10-01")
    if held:
        exchange = driver.judge.accepted(0x11)
        forecast = driver.motion.to_position(exchange, place, start)
        driver.motion.finish(forecast, "MACS-CMD-10-01")


def judge_refused_amid(
    driver: AxisDriver, forecast: Forecast, exchange: AxisExchange, requirement: str
) -> None:
    """What a motion locks is refused, if it was surely sent before that ends."""
    end = forecast.end
    assert end is not None
    if exchange.taken.latest_ns < end.earliest_ns:
        driver.judge.must(ReplyKind.REFUSED, exchange, requirement)


def _judge_locked(driver: AxisDriver, forecast: Forecast) -> None:
    """Until a move ends, its parameters are locked, as far as this device locks them."""
    values = {0x02: 0, 0x0D: driver.motion.period, 0x0F: driver.motion.coefficient}
    for index, value in values.items():
        exchange = driver.client.command(index, value)
        if index == 0x02 or driver.readings.known("motion_lock_set") == 0:
            judge_refused_amid(driver, forecast, exchange, "MACS-STATE-01")
