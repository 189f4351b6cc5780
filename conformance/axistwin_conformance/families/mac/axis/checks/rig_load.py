"""A shaft that is held or turned: whose position 20h tells, busy, catch-up, the lock (BUSY-01,
BUSY-02, CMD-0E, CMD-1A-02, CMD-18-01, STATE-01).

A held axis falls behind its set-point, which goes on.  Let go, it catches up by one increment every
VV·200 µs; the phase of the first one is open, so a prediction spans one increment.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import Sample
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter
from axistwin_conformance.families.mac.axis.driver.rig import AT_ONCE, WORKED, MotionCommand
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.axis.model.kinematics import CATCH_UP_UNIT_TICKS, TICK_NS

ORDER = 240  # of this module in a run; see `Family.modules`

HOLD: Final = ("rig:hold",)
TURN: Final = ("rig:turn",)
LAG: Final = 40  # increments by which a held axis is left behind
TOLERANCE: Final = 10
SLOW_CATCH_UP: Final = 0x32  # 10 ms per increment: readings tell single increments
EASY_CATCH_UP: Final = 0xFF  # 51 ms per increment, for a bench on which time is real
PROFILE: Final = 2  # the reading of MACS-AMB-27 by which a motion is over with its profile
RESENT: Final = 8  # times: an EEPROM bears only so many writes
LAG_SHOWS_S: Final = 0.3
LONGEST_SEGMENT: Final = 0x7FFF  # increments: DDDD is signed


def _catch_up_ns(coefficient: int) -> int:
    """VV·200 µs per increment; 0 acts as 1 (MACS-AMB-47)."""
    return max(1, coefficient) * CATCH_UP_UNIT_TICKS * TICK_NS


def _fastest_catch_up(driver: AxisDriver, wanted: int) -> int:
    """That VV, or the fastest that stays within the envelope; a shaft let go knows no other."""
    if not driver.session.envelope.is_guarded:
        return wanted
    return max(wanted, -(-driver.limits.fastest // CATCH_UP_UNIT_TICKS))


def _left_behind(driver: AxisDriver, catch_up: int, tolerance: int = 0, lag: int = LAG) -> int:
    """Hold the shaft, order a move, let its profile end; give the target."""
    start = driver.rig.begin(0x0640)
    driver.judge.accepted(0x0E, catch_up << 8)
    driver.client.command(0x1C, tolerance)
    driver.session.rig.work("hold", True)
    end = driver.motion.go(start + lag).end
    assert end is not None
    driver.client.wait_until(end.latest_ns)
    driver.client.wait(0.1)
    return start + lag


def _source(driver: AxisDriver) -> bool:
    """Judge whose position 20h tells (MACS-AMB-55); True if that of the shaft itself."""
    place = driver.client.position()
    slack = driver.limits.allowance(driver.motion.period)
    outcome: int | str = f"position {place} of an axis held at {driver.rig.start}"
    if abs(place - driver.rig.start) <= slack:
        outcome = 0
    elif place == driver.rig.start + LAG:
        outcome = 1
    driver.judge.reading("position_source", outcome, "MACS-Q-20-01")
    return outcome == 0


@check(
    "MACS-BUSY-01",
    "MACS-Q-27-03",
    "MACS-Q-20-01",
    "MACS-STATE-01",
    "MACS-CMD-1C-01",
    safety=WORKED,
    needs=HOLD,
)
def a_held_axis_is_busy_until_it_is_near_its_target(session: Session) -> None:
    """Held back, a move stays busy and locked; let go, it ends within tolerance, then exactly."""
    driver = driver_of(session)
    if not driver.rig.has_tolerance():
        session.skip("1Ch is not supported: no tolerance to judge by")
    catch_up = SLOW_CATCH_UP if driver.session.rig.is_exact else EASY_CATCH_UP
    target = _left_behind(driver, catch_up, TOLERANCE)
    busy = ("MACS-BUSY-01", "MACS-Q-27-03")
    session.expect(driver.status.is_busy(), busy, "busy while the shaft is held", "not busy")
    is_shaft = _source(driver)
    locks = [_is_locked(driver)]
    let_go = TimeWindow(*driver.session.rig.work("hold", False))
    near_ns = (LAG - TOLERANCE // 2) * _catch_up_ns(catch_up)
    if not is_shaft:
        driver.client.wait_until(let_go.latest_ns + LAG * _catch_up_ns(catch_up) + 100_000_000)
        session.expect(not driver.status.is_busy(), busy, "not busy in the end", "busy")
        session.not_run(
            ("MACS-STATE-01", "MACS-CMD-1C-01"), "20h tells the set-point, not where the shaft is"
        )
        return
    _judge_busy(driver, target, let_go.latest_ns + near_ns, busy)
    near = driver.client.command(0x02, 0)
    locks.append(near.kind is ReplyKind.REFUSED)
    driver.client.wait_until(let_go.latest_ns + (LAG + 5) * _catch_up_ns(catch_up))
    place = driver.client.position()
    session.expect(place == target, "MACS-BUSY-01", f"at last exactly {target}", place)
    session.expect(not driver.status.is_busy(), busy, "not busy", "busy")
    locks.append(_is_locked(driver))
    readings = ([True, False, False], [True, True, False], [False, False, False])
    described = f"locked while held, near, there: {locks}"
    is_near = near.taken.latest_ns < let_go.earliest_ns + (LAG - 1) * _catch_up_ns(catch_up)
    seen = (0, 1, 2) if is_near else (0, 2)  # by then it may have been there
    fitting = tuple(
        number
        for number, reading in enumerate(readings)
        if all(reading[at] is locks[at] for at in seen)
    )
    driver.judge.reading("running_until", fitting or described, "MACS-STATE-01")


def _is_locked(driver: AxisDriver) -> bool:
    """Whether 02h is refused, which every reading locks, with what is set already."""
    return driver.client.command(0x02, 0).kind is ReplyKind.REFUSED


def _judge_busy(
    driver: AxisDriver, target: int, until_ns: int, requirement: tuple[str, str]
) -> None:
    """On the way to a target, busy means more than the tolerance away, to one increment."""
    while driver.client.target.now_ns < until_ns:
        before = driver.client.position()
        is_busy = driver.status.is_busy()
        after = driver.client.position()
        places = range(min(before, after), max(before, after) + 1)
        admissible = {target - place > TOLERANCE for place in places}
        driver.session.expect(
            is_busy in admissible,
            (*requirement, "MACS-CMD-1C-01"),
            f"busy only with more than {TOLERANCE} of {target - before} left",
            is_busy,
        )


@check("MACS-CMD-0E-01", "MACS-CMD-0E-02", "MACS-BUSY-01", safety=WORKED, needs=HOLD)
def a_held_axis_catches_up_at_its_own_speed(session: Session) -> None:
    """Let go, one increment follows every VV·200 µs, whatever 0Dh; 0Eh counts under way too."""
    driver = driver_of(session)
    speeds = (SLOW_CATCH_UP, EASY_CATCH_UP, 0x10, 1, 0)
    for catch_up in speeds if driver.session.rig.is_exact else (EASY_CATCH_UP,):
        if max(1, catch_up) < _fastest_catch_up(driver, 1):
            continue
        if catch_up == 0 and driver.client.command(0x0E, 0).kind is ReplyKind.REFUSED:
            driver.judge.reading("zero_catchup", 1, "MACS-CMD-0E-01")
            continue
        target = _left_behind(driver, catch_up)
        if driver.client.position() == target:
            session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
        let_go = TimeWindow(*driver.session.rig.work("hold", False))
        _follow_catch_up(driver, let_go, driver.rig.start, target, catch_up, "MACS-CMD-0E-01")
        place = driver.rig.rest()
        session.expect(place == target, ("MACS-CMD-0E-01", "MACS-BUSY-01"), target, place)
    _change_under_way(driver)
    if driver.session.rig.is_exact:
        _sent_again_under_way(driver)


def _follow_catch_up(
    driver: AxisDriver, since: TimeWindow, begin: int, target: int, catch_up: int, requirement: str
) -> None:
    """Read the counter until the end is due, each reading within the increment of the phase."""
    step_ns = _catch_up_ns(catch_up)
    direction = 1 if target > begin else -1
    slack = 0 if driver.session.rig.is_exact else 1 + driver.limits.allowance(driver.motion.period)
    end_ns = since.latest_ns + (abs(target - begin) + 2) * step_ns
    while driver.client.target.now_ns < end_ns:
        sample = driver.client.sample()
        least, most = _caught_up(sample, since, step_ns, abs(target - begin))
        done = (sample.position - begin) * direction
        driver.session.expect(
            least - slack <= done <= most + slack,
            requirement,
            f"{least}..{most} increments of {step_ns / 1e6:g} ms caught up",
            done,
        )
        driver.client.wait(step_ns / 2e9 if driver.session.rig.is_exact else 0.05)


def _caught_up(sample: Sample, since: TimeWindow, step_ns: int, lag: int) -> tuple[int, int]:
    least = (sample.taken.earliest_ns - since.latest_ns) // step_ns
    most = (sample.taken.latest_ns - since.earliest_ns) // step_ns + 1
    return max(0, min(lag, least)), min(lag, most)


@check("MACS-CMD-0E-01", "MACS-BUSY-01", "MACS-Q-20-01", safety=WORKED, needs=HOLD, level="full")
def a_move_held_for_a_while_makes_up_for_it_at_its_end(session: Session) -> None:
    """Held in the midst of a move the shaft stands where it was; let go, it follows with its lag,
    which is made up after the profile, one increment every VV·200 µs."""
    driver = driver_of(session)
    if not driver.session.rig.is_exact or driver.readings.known("position_source"):
        session.skip(f"{AT_ONCE}, and 20h to tell where the shaft is")
    start = driver.rig.begin()
    driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
    target = start + driver.rig.reach
    moving = driver.motion.go(target)
    driver.client.wait(0.1)
    held = TimeWindow(*driver.session.rig.work("hold", True))
    lowest, highest = moving.bounds(held)
    place = driver.client.position()
    session.expect(
        lowest <= place <= highest, "MACS-Q-20-01", f"held at {lowest}..{highest}", place
    )
    driver.client.wait(LAG * driver.motion.period * TICK_NS / 1e9)
    again = driver.client.position()
    session.expect(again == place, "MACS-Q-20-01", f"still at {place}", again)
    let_go = TimeWindow(*driver.session.rig.work("hold", False))
    driver.rig.in_time(moving, let_go)
    missed = (moving.bounds(let_go)[0] - highest, moving.bounds(let_go)[1] - lowest)
    under_way = driver.client.sample()
    least, most = moving.bounds(under_way.taken)
    session.expect(
        least - missed[1] <= under_way.position <= most - missed[0],
        "MACS-BUSY-01",
        f"{missed[0]}..{missed[1]} increments behind {least}..{most}",
        under_way.position,
    )
    end = moving.end
    assert end is not None
    driver.client.wait_until(end.latest_ns)
    late = driver.client.sample()
    made_up = 2 + (late.taken.latest_ns - end.earliest_ns) // _catch_up_ns(SLOW_CATCH_UP)
    lag = target - late.position
    session.expect(
        missed[0] - made_up <= lag <= missed[1],
        "MACS-BUSY-01",
        f"{missed[0] - made_up}..{missed[1]} increments behind",
        lag,
    )
    _follow_catch_up(driver, late.taken, late.position, target, SLOW_CATCH_UP, "MACS-CMD-0E-01")
    place = driver.rig.rest()
    session.expect(place == target, ("MACS-CMD-0E-01", "MACS-BUSY-01"), target, place)


@check(
    "MACS-STOP-01",
    "MACS-CMD-0E-01",
    safety=WORKED,
    needs=(*HOLD, "rig:positive_stop"),
    level="full",
)
def a_hardware_stop_lets_a_catch_up_away_from_it_go_on(session: Session) -> None:
    """Catching up counts down: an active positive stop is none of its business."""
    _comes_back_from_a_stop(driver_of(session), -LAG, 0)


@check(
    "MACS-STOP-01",
    "MACS-CMD-0E-01",
    safety=WORKED,
    needs=(*HOLD, *TURN, "rig:positive_stop"),
    level="full",
)
def a_hardware_stop_lets_a_shaft_turned_too_far_come_back(session: Session) -> None:
    """The move led up, but what is left of it counts down: the positive stop does not end it."""
    driver = driver_of(session)
    if not driver.session.rig.is_exact:
        session.skip(f"{AT_ONCE}: the shaft is turned while it is held")
    driver.limits.needs_room(2 * LAG, "room to turn the shaft beyond its target")
    _comes_back_from_a_stop(driver, LAG, 2 * LAG)


def _comes_back_from_a_stop(driver: AxisDriver, distance: int, turned: int) -> None:
    """Hold the shaft in a move, turn it, close the positive stop, let go: it must count down."""
    start = driver.rig.begin(0x0640)
    if driver.readings.known("position_source"):
        driver.session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    target = start + distance
    driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
    driver.judge.accepted(0x03, 1)
    driver.session.rig.work("hold", True)
    end = driver.motion.go(target).end
    assert end is not None
    driver.client.wait_until(end.latest_ns)
    driver.client.wait(0.1)
    if turned:
        driver.session.rig.work("turn", turned)
    driver.rig.contact("positive_stop", True)
    driver.session.rig.work("hold", False)
    driver.client.wait((LAG + 5) * _catch_up_ns(SLOW_CATCH_UP) / 1e9)
    place, ff = driver.client.position(), driver.status.stopped_on()
    if (
        driver.readings.known("ff_lifetime") == 1
    ):  # on this device ff shows the stop, not who met it
        ff = 0
    driver.rig.contact("positive_stop", False)
    driver.judge.accepted(0x03, 0)
    driver.session.expect(
        (place, ff) == (target, 0),
        ("MACS-STOP-01", "MACS-CMD-0E-01"),
        f"at {target}, ff 00",
        f"at {place}, ff {ff:02X}",
    )


def _change_under_way(driver: AxisDriver) -> None:
    """0Eh during catch-up is accepted, and counts from the next increment on."""
    slow, fast = EASY_CATCH_UP, _fastest_catch_up(driver, 5)
    target = _left_behind(driver, slow)
    driver.session.rig.work("hold", False)
    driver.client.wait(5 * _catch_up_ns(slow) / 1e9)
    changed = driver.judge.accepted(0x0E, fast << 8, requirement="MACS-CMD-0E-02").taken
    # The increment under way may still be a slow one; the others take a millisecond each, or more.
    driver.client.wait_until(changed.latest_ns + _catch_up_ns(slow) + LAG * _catch_up_ns(fast))
    place = driver.client.position()
    driver.session.expect(place == target, "MACS-CMD-0E-02", f"already at {target}", place)


def _sent_again_under_way(driver: AxisDriver) -> None:
    """0Eh with what is set already changes nothing, however often it comes."""
    target = _left_behind(driver, EASY_CATCH_UP)
    let_go = TimeWindow(*driver.session.rig.work("hold", False))
    for _ in range(RESENT):
        driver.client.wait(0.03)
        driver.judge.accepted(0x0E, EASY_CATCH_UP << 8, requirement="MACS-CMD-0E-02")
    sample = driver.client.sample()
    least, most = _caught_up(sample, let_go, _catch_up_ns(EASY_CATCH_UP), LAG)
    done = sample.position - (target - LAG)
    driver.session.expect(
        least <= done <= most,
        "MACS-CMD-0E-02",
        f"{least}..{most} increments caught up, 0Eh sent again or not",
        done,
    )


@check("MACS-BUSY-02", "MACS-Q-27-03", safety=WORKED, needs=HOLD)
def endless_motion_and_segments_are_busy_while_held(session: Session) -> None:
    """By 15h, either way, and 16h the axis is busy only while something keeps it from following."""
    driver = driver_of(session)
    for command in driver.rig.motion_commands:
        for way in (1, -1) if command.is_endless else (1,):
            if command.name != "13h" and driver.rig.can_go(command, way):
                _busy_while_held(driver, command, way)


def _busy_while_held(driver: AxisDriver, command: MotionCommand, way: int) -> None:
    session = driver.session
    distance = min(
        LONGEST_SEGMENT,
        driver.limits.room() if session.rig.is_exact else driver.rig.reach,
    )
    start = driver.rig.begin(driver.rig.lasting(distance, 0.2 + 2 * LAG_SHOWS_S))
    moving = command.begin(driver.rig, start, way * distance)
    driver.client.wait(0.1)
    session.expect(
        not driver.status.is_busy(),
        ("MACS-BUSY-02", "MACS-Q-27-03"),
        f"{command.name}: following, not busy",
        "busy",
    )
    held = TimeWindow(*session.rig.work("hold", True))
    driver.rig.in_time(moving, held)
    driver.client.wait(LAG_SHOWS_S)
    session.expect(
        driver.status.is_busy(),
        ("MACS-BUSY-02", "MACS-Q-27-03"),
        f"{command.name}: held, busy",
        "not busy",
    )
    free = TimeWindow(*session.rig.work("hold", False))
    driver.rig.in_time(moving, free)
    if command.is_endless:
        driver.client.wait(LAG_SHOWS_S)
        before = driver.client.position()
        driver.client.wait(0.1)
        session.expect(
            way * (driver.client.position() - before) > 0,
            "MACS-BUSY-02",
            "turning again",
            "at rest",
        )
        session.expect(
            not driver.status.is_busy(),
            ("MACS-BUSY-02", "MACS-Q-27-03"),
            "following again, not busy",
            "busy",
        )
    driver.motion.at_rest()


@check("MACS-CMD-18-01", "MACS-CMD-18-03", safety=WORKED, needs=HOLD, level="full")
def a_stopped_move_does_not_catch_up(session: Session) -> None:
    """After 18h the target is given up: the shaft, let go, stays where it is and is not busy."""
    driver = driver_of(session)
    _left_behind(driver, 1)
    driver.judge.accepted(0x18)
    place = driver.client.position()
    if (
        driver.readings.known("running_until") != PROFILE
    ):  # there 18h comes to a motion that is over
        driver.judge.reading("busy_after_abort", int(driver.status.is_busy()), "MACS-CMD-18-03")
    driver.session.rig.work("hold", False)
    driver.client.wait(0.3)
    again, slack = driver.client.position(), driver.limits.allowance(driver.motion.period)
    session.expect(
        abs(again - place) <= slack, ("MACS-CMD-18-01", "MACS-CMD-18-03"), f"still {place}", again
    )
    session.expect(
        not _is_locked(driver), ("MACS-CMD-18-01", "MACS-CMD-18-03"), "no longer running", "locked"
    )


@check("MACS-CMD-17-01", "MACS-STATE-01", safety=WORKED, needs=HOLD, level="full")
def an_endless_motion_ends_with_its_ramp_though_the_shaft_is_held(session: Session) -> None:
    """17h ends velocity mode when the ramp is over: not busy, not locked, whatever holds the shaft;
    there is no target to wait for."""
    driver = driver_of(session)
    if not driver.session.rig.is_exact:
        session.skip(f"{AT_ONCE}: endless motion is left to it")
    driver.rig.begin()
    driver.motion.turn(1, driver.motion.period)
    driver.session.rig.work("hold", True)
    driver.client.wait(LAG_SHOWS_S)
    driver.judge.accepted(0x17, requirement="MACS-CMD-17-01")
    driver.client.wait(LAG_SHOWS_S)
    session.expect(not driver.status.is_busy(), "MACS-CMD-17-01", "stopped, not busy", "busy")
    session.expect(not _is_locked(driver), "MACS-STATE-01", "no longer running", "locked")
    driver.judge.accepted(0x18)


@check("MACS-CMD-0B-01", safety=WORKED, needs=HOLD, level="full")
def a_counter_is_cleared_where_the_shaft_is(session: Session) -> None:
    """0Bh while the shaft lags behind its set-point: 20h then tells 0, not how far it lags."""
    driver = driver_of(session)
    driver.rig.begin(SLOWEST)  # the less the shaft may have moved, the less of the envelope is lost
    with driver.rig.own_origin() as origin:
        driver.motion.finish(driver.motion.go(10))
        driver.session.rig.work("hold", True)
        end = driver.motion.go(10 + LAG).end
        assert end is not None
        driver.client.wait_until(end.latest_ns)
        driver.client.wait(0.1)
        before = driver.client.position()
        driver.judge.accepted(0x0B)
        place = driver.client.position()
        driver.judge.accepted(0x18)
        driver.session.rig.work("hold", False)
        origin.shift += before - place
    if abs(before - 10) > LAG // 2:
        session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    session.expect(
        abs(place) <= driver.limits.allowance(driver.motion.period),
        None,
        f"0, and not {before}",
        place,
    )


@check("MACS-CMD-0B-01", "MACS-CMD-13-01", safety=WORKED, needs=HOLD, level="full")
def a_move_whose_counter_is_cleared_while_it_lags_ends_where_it_should(session: Session) -> None:
    """0Bh in a move whose shaft is held: let go, it ends at its number, or after its way."""
    driver = driver_of(session)
    driver.rig.begin(SLOWEST)
    driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
    target = 10 + LAG + driver.limits.way_outlasting(2 * LAG, SLOWEST, 3)
    with driver.rig.own_origin() as origin:
        driver.motion.finish(driver.motion.go(10))
        driver.session.rig.work("hold", True)
        moving = driver.motion.go(target)
        driver.client.wait(driver.motion.lasting_s(LAG))
        before = driver.client.position()
        cleared = driver.judge.accepted(0x0B)
        driver.session.rig.work("hold", False)
        driver.client.wait(
            driver.motion.lasting_s(target) + target * _catch_up_ns(SLOW_CATCH_UP) / 1e9
        )
        place = driver.rig.rest()
        origin.shift += before
    assert moving.end is not None
    driver.motion.taken_in_time(cleared, moving.end.earliest_ns, "the motion")
    if abs(before - 10) > LAG // 2:
        session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
    due = target - before if driver.readings.known("reset_in_motion") else target
    session.expect(
        abs(place - due) <= driver.limits.allowance(driver.motion.period),
        ("MACS-CMD-0B-01", "MACS-CMD-13-01"),
        f"at rest at {due}",
        place,
    )


# --- turned by hand ------------------------------------------------------------------------------


def _judge_turned(driver: AxisDriver, asked: int, done: int, requirement: str) -> None:
    """By hand about as far as asked; exactly so by the twin."""
    if driver.session.rig.is_exact:
        is_right = done == asked
    else:
        is_right = done * asked > 0 and abs(asked) // 4 <= abs(done) <= 4 * abs(asked)
    driver.session.expect(is_right, requirement, f"turned by {asked}", done)


@check("MACS-CMD-1A-02", safety=WORKED, needs=TURN)
def an_unpowered_shaft_is_still_counted(session: Session) -> None:
    """Turned by hand after 1Ah, in either direction, the counter follows and nothing returns."""
    driver = driver_of(session)
    start = driver.rig.begin()
    driver.motion.finish(driver.motion.go(start + 20))
    driver.judge.accepted(0x1A)
    driver.limits.needs_travel(20, "room to turn the shaft by hand")
    for share in (20, -35, 12):  # of what is left of the envelope
        asked = share * min(driver.limits.room(), 1000) // 100
        before = driver.client.position()
        driver.session.rig.work("turn", asked)
        driver.client.wait(0.3)
        _judge_turned(driver, asked, driver.rig.rest() - before, "MACS-CMD-1A-02")


@check("MACS-CMD-18-01", "MACS-BUSY-01", safety=WORKED, needs=TURN, level="full")
def a_turned_shaft_comes_back_only_where_it_is_regulated(session: Session) -> None:
    """After a move a turned shaft returns at the catch-up speed; after 18h it stays turned."""
    driver = driver_of(session)
    start = driver.rig.begin()
    driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
    place = driver.motion.finish(driver.motion.go(start + 30))
    if driver.session.rig.is_exact:
        for asked in (25, -25):
            turned = TimeWindow(*driver.session.rig.work("turn", asked))
            if driver.client.position() == place:
                session.skip("20h tells the set-point: nothing to see of the shaft (MACS-AMB-55)")
            _follow_catch_up(driver, turned, place + asked, place, SLOW_CATCH_UP, "MACS-BUSY-01")
    else:
        driver.session.rig.work("turn", 25)
        driver.client.wait(2.0)
    back = driver.rig.rest()
    session.expect(back == place, "MACS-BUSY-01", f"back at {place}", back)
    driver.judge.accepted(0x18)
    driver.session.rig.work("turn", -25)
    _judge_turned(driver, -25, driver.rig.rest() - place, "MACS-CMD-18-01")
    driver.client.command(0x18)


@check("MACS-CMD-17-01", "MACS-BUSY-01", safety=WORKED, needs=TURN, level="full")
def a_turned_shaft_comes_back_to_where_a_ramped_stop_has_left_it(session: Session) -> None:
    """17h holds the place it comes to rest at, with or without segments that were waiting."""
    driver = driver_of(session)
    if not driver.session.rig.is_exact or driver.readings.known("position_source"):
        session.skip(f"{AT_ONCE}, and 20h to tell where the shaft is")
    waiting = not driver.readings.known("interp_during_profile") and driver.readings.known(
        "segments_after_17h"  # those that run end the regulation, as any new motion does
    )
    for segments in range(1 + waiting):
        start = driver.rig.begin()
        driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
        driver.motion.go(start + driver.rig.reach)
        for _ in range(segments):
            driver.judge.accepted(0x16, segment_parameter(20, driver.motion.period))
        driver.client.wait(0.05)
        driver.judge.accepted(0x17, requirement="MACS-CMD-17-01")
        place = driver.rig.rest()
        turned = TimeWindow(*driver.session.rig.work("turn", 25))
        _follow_catch_up(driver, turned, place + 25, place, SLOW_CATCH_UP, "MACS-CMD-17-01")
        back = driver.rig.rest()
        session.expect(back == place, "MACS-CMD-17-01", f"back at {place}", back)
        if not driver.readings.known("busy_after_17h"):
            session.expect(not driver.status.is_busy(), "MACS-BUSY-01", "not busy", "busy")


@check("MACS-CMD-1A-01", "MACS-STATE-01", safety=WORKED, needs=HOLD, level="full")
def power_off_gives_a_held_move_up(session: Session) -> None:
    """After 1Ah nothing is regulated any more: a shaft that was held stays where it is let go."""
    driver = driver_of(session)
    _left_behind(driver, 1)
    driver.judge.accepted(0x1A)
    place = driver.client.position()
    driver.session.rig.work("hold", False)
    driver.client.wait(0.3)
    again, slack = driver.client.position(), driver.limits.allowance(driver.motion.period)
    session.expect(abs(again - place) <= slack, "MACS-CMD-1A-01", f"still {place}", again)
    session.expect(not _is_locked(driver), "MACS-STATE-01", "no longer running", "locked")
    driver.motion.finish(
        driver.motion.go(again + 20), "MACS-CMD-1A-01"
    )  # power comes back with the next motion
