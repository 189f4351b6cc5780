"""Re-initialisation (00h): what it keeps, what it ends; and the counter cleared in a move (0Bh)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.parameters import judge_still_locked
from axistwin_conformance.families.mac.axis.checks.stops import SIDES
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import (
    RAMP_LEVELS,
    TICK_NS,
    Course,
    ramp_increments,
)
from axistwin_conformance.families.mac.axis.parameters import (
    PARAMETER_QUERIES,
    PARAMETERS,
    values_of,
)
from axistwin_conformance.families.mac.axis.probes.motion import cleared_in_a_move
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 170  # of this module in a run; see `Family.modules`

# What every module takes (§5.10), one set after the other: all bits of the cells, the superior stop
# below the inferior one; then the same low bytes under other high ones, with other signs.
STORED: Final = (
    {0x09: -1, 0x0A: 0x100, 0x0C: 0x7F, 0x0D: 0xFFFF, 0x0E: 0xFF00, 0x0F: 0xFF, 0x1C: 0xFF},
    {0x09: 0x12FF, 0x0A: -0x12345600, 0x0C: 0x01, 0x0D: 0x7FFF, 0x0E: 0x0100, 0x0F: 0, 0x1C: 0},
)
BELOW: Final = 150  # increments: a position of 00h that is negative
MODES: Final = (0x02, 0x03, 0x1C)  # whether they are stored is open (MACS-AMB-24)
SET_IN_MOTION: Final = (0x0C, 0x0E, 0x1C)  # what no motion locks

SOFTWARE: Final = 0x0800  # of 26h: software stops enabled


@check("MACS-CMD-00-01", "MACS-CMD-18-03", "MACS-CMD-09-02", "MACS-CMD-0A-02", safety=MOVES)
def after_00h_parameters_and_position_are_kept(session: Session) -> None:
    """00h keeps position, below 0 if that is near, and stored parameters at rest; sync, preload and
    stop bits are gone; software stops that are still enabled then act."""
    driver = driver_of(session)
    start = driver.motion.ready(0x1000, 3)
    if abs(start) + BELOW <= driver.limits.room() and driver.limits.fits(-BELOW):
        start = driver.motion.finish(driver.motion.go(-BELOW))
    driver.motion.finish(driver.motion.go(start + 30))
    for index, parameter in (
        (0x09, start + 40),
        (0x0A, start - 60),
        (0x0C, 0x33),
        (0x0E, 0x0700),
        (0x1C, 0x02),
        (0x03, 8),
    ):
        driver.client.command(index, parameter)
    driver.judge.accepted(0x13, start + 100)
    driver.client.wait(0.4 + driver.motion.lasting_s(11 * RAMP_LEVELS))
    driver.motion.run_out()
    before = [driver.client.value(index) for index in PARAMETER_QUERIES]
    place = driver.client.position()
    stopped_on = driver.status.stopped_on()
    driver.client.command(0x10)
    driver.client.command(0x13, start)
    driver.motion.reinitialise()
    after = [driver.client.value(index) for index in PARAMETER_QUERIES]
    modes = 0x0000FFFF  # K, m and TT of 26h: whether they are stored is open (MACS-AMB-24)
    if after[:3] == before[:3] and after[3] & ~modes == before[3] & ~modes:
        driver.judge.reading("persist_modes", int(after != before), "MACS-CMD-00-01")
    else:
        session.fail("MACS-CMD-00-01", _hex(before), _hex(after))
    session.expect(
        driver.client.position() == place,
        "MACS-CMD-00-01",
        f"position {place}",
        driver.client.position(),
    )
    session.expect(
        driver.status.stopped_on() == 0 or driver.readings.known("ff_lifetime") == 1,
        "MACS-CMD-00-01",
        f"ff 00 (was {stopped_on:02X})",
        f"{driver.status.stopped_on():02X}",
    )
    driver.client.command(0x11)
    driver.client.wait(0.1)
    session.expect(
        driver.client.position() == place,
        ("MACS-CMD-00-01", "MACS-CMD-18-03"),
        "nothing preloaded any more",
        driver.client.position(),
    )
    _judge_stops_enabled(driver, start - 60)


def _judge_stops_enabled(driver: AxisDriver, inferior: int) -> None:
    """From beyond the superior stop the axis goes no further out, and back no further than the
    inferior one, before any of them is set or enabled again."""
    if not driver.client.value(0x26) & SOFTWARE:
        return  # what of 26h is stored, is open (MACS-AMB-24)
    most = 1 + driver.limits.braking(driver.motion.period)
    for side in SIDES:
        place, sign = driver.client.position(), side.direction
        if sign < 0 and driver.readings.known("soft_stop_blocks"):
            return  # nor does this device let the axis back
        end = place if sign > 0 else inferior
        way = abs(end - place) + 60
        driver.client.command(0x13, end + 60 * sign)  # outward, it may be refused
        driver.client.wait(0.4 + driver.motion.lasting_s(way + 11 * RAMP_LEVELS))
        driver.motion.run_out()
        beyond = (driver.client.position() - end) * sign
        driver.session.expect(
            0 <= beyond <= 2 * most,
            ("MACS-CMD-00-01", side.requirements[0]),
            f"at rest 0..{2 * most} increments beyond {end}, by {side.index:02X}h: 26h shows stops",
            beyond,
        )


@check("MACS-PERS-01", "MACS-CMD-00-01", safety=MOVES, level="full")
def what_was_stored_is_there_after_00h(session: Session) -> None:
    """Whatever the parameters are, 00h brings up those, and nothing that was refused: all ones, the
    superior stop below the other, the same low byte as before; and the position, of either sign or
    cleared."""
    driver = driver_of(session)
    reach = min(25, driver.limits.room() // 2)
    for values, target in zip(STORED, (reach, -reach), strict=True):
        place = driver.motion.ready()
        if abs(place) <= reach and driver.limits.fits(target):
            place = driver.motion.finish(driver.motion.go(target))
        for index, parameter in values.items():
            driver.client.command(index, parameter)
        _refused_for_their_value(driver)
        cleared = place if target < 0 and abs(place) <= reach else 0
        if cleared:
            driver.judge.accepted(0x0B)
        before = driver.client.parameters()
        driver.motion.reinitialise()
        _judge_parameters(driver, before)
        found, wanted = driver.client.position(), 0 if cleared else place
        session.expect(found == wanted, "MACS-CMD-00-01", f"position {wanted}", found)
        if cleared:  # back to where the counter was 0
            driver.motion.ready()
            driver.motion.finish(driver.motion.go(found - cleared))
            driver.client.command(0x0B)


def _refused_for_their_value(driver: AxisDriver) -> None:
    """Send values that are refused, or taken for others: what is then in use was stored."""
    driver.client.command(0x0C, 0xFF)
    driver.client.command(0x02, 0x02)
    driver.client.command(0x03, 0x02)
    if not driver.readings.known("zero_period_0d"):  # or it would be the fastest there is
        driver.client.command(0x0D, 0)


def _judge_parameters(driver: AxisDriver, before: Mapping[int, int]) -> None:
    """Judge that what is stored for certain is as before; of the rest that is open (AMB-24)."""
    after = driver.client.parameters()
    lost = [index for index in before if after[index] != before[index] and index not in MODES]
    driver.session.expect(
        not lost,
        ("MACS-PERS-01", "MACS-CMD-00-01"),
        [f"{driver.client.named(index)} {before[index]:X}h kept over 00h" for index in lost],
        [f"{after[index]:X}h" for index in lost],
    )


@check("MACS-CMD-00-01", "MACS-CMD-18-03", "MACS-PERS-01", safety=MOVES, level="full")
def in_motion_00h_drops_the_motion(session: Session) -> None:
    """00h during a move or segments: the axis stands, nothing resumes or is locked; what was set
    meanwhile is kept."""
    driver = driver_of(session)
    most = _outlasting_00h(driver)
    for begin in ((0x13, 2 * most), (0x16, segment_parameter(most, SLOWEST))):
        _dropped_by_00h(driver, *begin, most)


@check("MACS-CMD-00-01", "MACS-CMD-18-03", "MACS-PERS-01", safety=MOVES, level="full")
def in_endless_motion_00h_drops_it(session: Session) -> None:
    """00h in endless motion: the axis stands, nothing resumes or is locked; what was set meanwhile
    is kept."""
    driver = driver_of(session)
    _dropped_by_00h(driver, 0x15, velocity(1, SLOWEST), _outlasting_00h(driver))


def _outlasting_00h(driver: AxisDriver) -> int:
    """Increments at the slowest speed, twice as many as are made until 00h is surely taken over."""
    # Seven exchanges after the first command, and a wait, the module has surely taken 00h over.
    most = 60 + driver.limits.steps_outlasting(SLOWEST, 7)
    driver.limits.needs_room(2 * most, "a motion that 00h comes in time for")
    return most


def _dropped_by_00h(driver: AxisDriver, index: int, parameter: int, most: int) -> None:
    """Begin that motion, and judge what 00h makes of it, which comes before so many increments."""
    session, start = driver.session, driver.motion.ready(SLOWEST)
    own = _settings(driver)
    sent = start + parameter if index == 0x13 else parameter
    first = driver.client.command(index, sent).taken
    driver.client.command(index, sent)
    wanted = _set_meanwhile(driver, own)
    driver.client.wait(0.2)
    driver.client.command(0x10)  # it would hold the next motion back
    restart = driver.motion.reinitialise()
    in_time_ns = first.earliest_ns + most * SLOWEST * TICK_NS
    driver.motion.taken_in_time(restart, in_time_ns, "half of the motion")
    place = driver.client.position()
    furthest = int((restart.taken.latest_ns - first.earliest_ns) / TICK_NS / SLOWEST) + 1
    furthest += driver.limits.braking(SLOWEST) + driver.limits.allowance(SLOWEST)
    session.expect(
        abs(place - start) <= min(most, furthest),
        "MACS-CMD-00-01",
        f"motion dropped at once: at most {furthest} increments made",
        f"{place - start}",
    )
    driver.client.wait(0.5)
    session.expect(
        driver.client.position() == place,
        ("MACS-CMD-00-01", "MACS-CMD-18-03"),
        f"at rest at {place}",
        driver.client.position(),
    )
    _judge_kept(driver, wanted)
    driver.judge.accepted(0x0F, 0, requirement="MACS-CMD-00-01")
    driver.motion.finish(driver.motion.go(start), "MACS-CMD-00-01")


def _settings(driver: AxisDriver) -> dict[int, int]:
    """The parameters that 25h and 26h show."""
    return values_of({query: driver.client.value(query) for query in (0x25, 0x26)})


def _set_meanwhile(driver: AxisDriver, own: Mapping[int, int]) -> dict[int, int]:
    """Set, in motion, what it does not lock to values one off; those that were taken."""
    wanted = {index: _one_off(own[index]) for index in SET_IN_MOTION}
    kinds = {
        index: driver.client.command(index, PARAMETERS[index].parameter(value)).kind
        for index, value in wanted.items()
    }
    return {index: wanted[index] for index in wanted if kinds[index] is ReplyKind.ACCEPTED}


def _judge_kept(driver: AxisDriver, wanted: Mapping[int, int]) -> None:
    """Judge that what was set in motion was stored."""
    kept = _settings(driver)
    modes = {index for index in MODES if driver.readings.known("persist_modes")}
    for index in wanted.keys() - modes:
        words = f"{driver.client.named(index)} {wanted[index]:02X}, set in motion, kept"
        seen = f"{kept[index]:02X}"
        driver.session.expect(kept[index] == wanted[index], "MACS-PERS-01", words, seen)


def _one_off(value: int) -> int:
    return value - 1 if value > 1 else value + 1


@check("MACS-CMD-0B-02", "MACS-CMD-0B-01", safety=MOVES, level="full")
def clearing_the_counter_during_a_move(session: Session) -> None:
    """0Bh half-way through 13h: the target stays a number, or the remaining distance stays."""
    driver = driver_of(session)
    outcome, _ = cleared_in_a_move(driver)
    assert isinstance(outcome, int | str), "the look tells its readings apart"
    driver.judge.reading("reset_in_motion", outcome, "MACS-CMD-0B-02")
    session.expect(True, "MACS-CMD-0B-01", "", "")


@check("MACS-CMD-0B-01", "MACS-CMD-13-05", "MACS-STATE-01", safety=MOVES, level="full")
def a_move_whose_counter_is_cleared_on_the_ramp_keeps_to_it(session: Session) -> None:
    """0Bh while the axis climbs: the rest of the way, now longer, is run as if from the start; the
    axis stays locked."""
    driver = driver_of(session)
    start, beyond = driver.motion.ready(SLOWEST, 1), driver.limits.way_outlasting(20, SLOWEST, 2)
    target = 2 * ramp_increments(1) + 40 + beyond
    if abs(start) > min(40, driver.limits.room()):
        session.skip("the counter is too far from 0 to be brought back there")
    driver.limits.needs_room(target + ramp_increments(1), "two ramps and some way between them")
    sent = driver.judge.accepted(0x13, target)
    whole = driver.motion.to_position(sent, start, target)
    climb = Course.endless(driver.motion.period, 1, driver.readings.law_of(1)).profile
    driver.client.wait_until(
        sent.taken.latest_ns + climb.ticks_of(ramp_increments(1) // 2) * TICK_NS
    )
    cleared = driver.judge.accepted(0x0B)
    # So far beyond the climb it still has some way to go before it slows down.
    slowing_ns = sent.taken.earliest_ns + climb.ticks_of(ramp_increments(1) + beyond) * TICK_NS
    driver.motion.taken_in_time(cleared, slowing_ns, "the way to where the axis slows down")
    lowest, highest = whole.bounds(cleared.taken)
    keeps_way = driver.readings.known("reset_in_motion") == 1
    ends = [(place, target - place if keeps_way else target) for place in (lowest, highest)]
    onward = Forecast.of(
        timeline
        for place, end in ends
        for timeline in driver.motion.to_position(sent, start - place, end).timelines
    )
    judge_still_locked(driver, onward)
    driver.motion.watch(onward, ("MACS-CMD-0B-01", "MACS-CMD-13-05"), samples=6)
    driver.motion.set_plain()
    driver.motion.finish(
        driver.motion.go(-lowest)
    )  # to one increment: nobody knows the instant better
    driver.judge.accepted(0x0B)


def _hex(values: list[int]) -> str:
    return " ".join(f"{value:08X}" for value in values)
