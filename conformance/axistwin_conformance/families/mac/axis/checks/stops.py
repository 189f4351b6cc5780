"""Software stops: where they stop, which way they block, what 21h then tells (CMD-09, CMD-0A,
STOP-03).  Hardware stops need somebody who works the inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import counted
from axistwin_conformance.core.session import Session, earlier
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, Course, ramp_increments
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.axis.words import pace_words

ORDER = 160  # of this module in a run; see `Family.modules`

PERIOD: Final = 0x1000
FAR: Final = 100_000  # increments: a stop that is never reached
FARTHEST: Final = 160  # increments that a check here waits for
RAMP_COEFFICIENT: Final = 3
RAMP: Final = ramp_increments(RAMP_COEFFICIENT)
ASIDE: Final = 40  # increments
STOP_ON_RAMP: Final = RAMP + 200  # increments: before the end of a ramp down that begins behind one
SUPERIOR, INFERIOR = 0x02, 0x01  # bits of ff


@dataclass(frozen=True, slots=True)
class SoftwareStop:
    """One of the two software stops: its command, its direction, its bit in ff."""

    index: int
    direction: int
    bit: int
    requirements: tuple[str, str]


SIDES: Final = (
    SoftwareStop(0x09, 1, SUPERIOR, ("MACS-CMD-09-02", "MACS-STOP-03")),
    SoftwareStop(0x0A, -1, INFERIOR, ("MACS-CMD-0A-02", "MACS-STOP-03")),
)
BOTH_SIDES: Final = ("MACS-STOP-03", "MACS-CMD-09-02", "MACS-CMD-0A-02")
OVERRUN: Final = "brake_increments"
ALIKE: Final = (
    "Both software stops watch one counter, whichever command moves the axis; so an axis whose way"
    " to rest does not depend on its speed comes to rest as far beyond the one as beyond the other."
)

# Every command that moves the axis, so that it would pass the stop by 40 increments or more.
MOTION_COMMANDS: Final[Mapping[str, Callable[[AxisDriver, int, int], None]]] = {
    "13h": lambda driver, start, sign: _send(driver, 0x13, start + 140 * sign),
    "15h": lambda driver, start, sign: _send(driver, 0x15, velocity(sign, driver.motion.period)),
    "16h": lambda driver, start, sign: _send(
        driver, 0x16, segment_parameter(140 * sign, driver.motion.period)
    ),
    "10h 13h 11h": lambda driver, start, sign: _synchronised(driver, start + 140 * sign),
    "15h 15h": lambda driver, start, sign: _changed(driver, sign),
    "16h 15h": lambda driver, start, sign: _taken_over(driver, sign),
    "13h 16h": lambda driver, start, sign: _behind_a_move(driver, start + 30 * sign, sign),
}
# What a device must not read otherwise than by default, or some of these do not pass the stop: to
# either side, and downwards.
PASSES: Final = {"16h 15h": ("vel_during_interp",), "13h 16h": ("interp_during_profile",)}
PASSES_DOWN: Final = {
    "15h": ("vel_f6_direction",),
    "15h 15h": ("vel_f6_direction",),
    "16h": ("segment_signed",),
    "16h 15h": ("segment_signed",),
    "13h 16h": ("segment_signed",),
}


def _send(driver: AxisDriver, index: int, parameter: int) -> None:
    driver.judge.accepted(index, parameter)


def _passes(driver: AxisDriver, side: SoftwareStop, name: str) -> bool:
    """True where the device's readings let that motion pass a stop on that side."""
    switches = PASSES.get(name, ()) + (PASSES_DOWN.get(name, ()) if side.direction < 0 else ())
    return not any(driver.readings.known(switch) for switch in switches)


def _changed(driver: AxisDriver, sign: int) -> None:
    """15h so slow that the stop is not met before the next one, which is as fast as the others."""
    for period in (SLOWEST, driver.motion.period):
        _send(driver, 0x15, velocity(sign, period))


def _taken_over(driver: AxisDriver, sign: int) -> None:
    """The same, where the slow motion is a segment."""
    _send(driver, 0x16, segment_parameter(140 * sign, SLOWEST))
    _send(driver, 0x15, velocity(sign, driver.motion.period))


def _behind_a_move(driver: AxisDriver, target: int, sign: int) -> None:
    """A move that ends before the stop, and a segment that waits for its end."""
    _send(driver, 0x13, target)
    _send(driver, 0x16, segment_parameter(110 * sign, driver.motion.period))


def _synchronised(driver: AxisDriver, target: int) -> None:
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, target)
    driver.judge.accepted(0x11)


def enable_stop(
    driver: AxisDriver,
    side: SoftwareStop,
    distance: int,
    mode: int = 8,
    settings: tuple[int, int] = (PERIOD, 0),
) -> int:
    """Put the stop of one side `distance` increments ahead, the other one far, and set a period and
    a ramp; give the start."""
    if driver.readings.known("ff_lifetime") == 2:  # only a restart clears ff on this device
        driver.motion.at_rest()
        driver.client.command(0x00)
        driver.motion.wait_awake()
    start = driver.motion.ready(*settings)
    other = 0x0A if side.index == 0x09 else 0x09
    driver.judge.accepted(side.index, start + side.direction * distance)
    driver.motion.keep_off(other, start - side.direction * FAR)
    driver.judge.accepted(0x03, mode)
    return start


def rest_place(driver: AxisDriver, period: int | None = None) -> int:
    """The place where the axis is once it no longer moves; without a ramp, and at the speed of
    `enable_stop` or another."""
    driver.motion.run_out(period or driver.motion.period)
    driver.client.wait(max(0.15, driver.motion.lasting_s(FARTHEST)))
    return driver.client.position()


def judge_bits(driver: AxisDriver, side: SoftwareStop, name: str) -> None:
    """The ff bit of this side, at the place the CAN manual gives it or shifted by one."""
    ff = driver.status.stopped_on()
    outcome = {side.bit: 0, side.bit << 1: 1}.get(ff, f"ff {ff:02X} on the {name} stop")
    driver.judge.reading("status_ff_layout", outcome, side.requirements[0])


@check("MACS-CMD-09-02", "MACS-Q-21-01", safety=MOVES)
def the_stop_bit_stays_until_the_next_motion(session: Session) -> None:
    """The ff bit outlives reading it, 18h, 07h and the end of enabling; the next motion clears
    it."""
    driver = driver_of(session)
    side = SIDES[0]
    start = enable_stop(driver, side, 10)
    driver.judge.accepted(0x13, start + 60)
    rest_place(driver)
    judge_bits(driver, side, "superior")
    driver.judge.accepted(0x18)
    driver.judge.accepted(0x07, 0)
    before = driver.status.stopped_on()
    wanted = "the bit still there after 21h, 18h and 07h"
    session.expect(before != 0, "MACS-Q-21-01", wanted, "ff 00")
    driver.judge.accepted(0x03, 0)
    live = driver.status.stopped_on() != before
    driver.judge.accepted(0x13, start)
    rest_place(driver)
    after = driver.status.stopped_on()
    outcome: int | str = f"ff {before:02X}, then {after:02X}"
    if live:
        outcome = 1
    elif after == 0:
        outcome = 0
    elif after == before:
        outcome = 2
    driver.judge.reading("ff_lifetime", outcome, "MACS-Q-21-01")


def _overrun_seen(
    driver: AxisDriver,
    side: SoftwareStop,
    name: str,
    start: int,
    place: int,
    due: tuple[int, int],
) -> Observation:
    """Where a motion ended beyond a software stop, in words."""
    stop = start + side.direction * 50
    which = "superior" if side.direction > 0 else "inferior"
    driver.client.wait(0.1)
    last = driver.client.position()
    there = start + side.direction * place
    rest = "came to rest" if last == there else f"was (and 100 ms later at {last})"
    clause = (
        f"after {name} from position {start}, at {pace_words('0Dh', driver.motion.period)}"
        f" and without a ramp (0Fh = 0), the axis {rest} {counted(place - 50, 'increment')}"
        f" beyond the {which} software stop ({side.index:02X}h = {stop}), at {there}"
        f" (read twice with {REQUEST}, 100 ms apart)"
    )
    # Where equal is beyond, the first increment beyond the stop is the stop itself.
    beyond = due[1] - 50 - (driver.readings.known("soft_stop_compare") == 1)
    did = f"came to rest {counted(beyond, 'increment')} beyond the superior software stop"
    # Nothing unless it was a number.
    before = earlier(driver.session, OVERRUN, "09h", "0Dh", "0Fh", did=did)
    wanted = f"{due[0] - 50}..{due[1] - 50} increments beyond it"
    if before:
        clause += (
            f", but earlier in this run {counted(beyond, 'increment')} beyond the superior one"
            " (09h), also set 50 ahead of the start and passed without a ramp, at two speeds alike"
            " (read until the place no longer changed)"
        )
        wanted = "the same distance on both sides"
    return Observation(
        clause,
        value=str(place),
        wanted=wanted,
        causes=tuple(f"{index} (" for index in (f"{side.index:02X}h", *name.split())),
        earlier=before,
        rule=ALIKE if before else "",
    )


@check("MACS-CMD-09-02", "MACS-CMD-0A-02", "MACS-STOP-03", safety=MOVES)
def beyond_a_software_stop_every_motion_ends(session: Session) -> None:
    """13h, 15h, 16h and 11h, a 15h in motion and a segment that waits for the end of a move end on
    the first increment beyond a software stop; byte ff of 21h names the stop, and motion is not
    locked."""
    driver = driver_of(session)
    for side in SIDES:
        for name, move in MOTION_COMMANDS.items():
            if not _passes(driver, side, name):
                continue
            if not session.transport.is_virtual and side.direction < 0 and name != "13h":
                continue  # the other side has shown every way; here the time is real
            start = enable_stop(driver, side, 50)
            move(driver, start, side.direction)
            driver.client.wait(0.05)
            place = (rest_place(driver) - start) * side.direction
            most = 51 + driver.limits.braking(driver.motion.period)
            is_known = session.readings.get(OVERRUN, "").isdigit()
            least = most - 1 if is_known else 50  # a number that was seen holds everywhere
            is_right = least <= place <= most
            # Of two sides that differ nobody knows which is right.
            names = BOTH_SIDES if is_known and not is_right else side.requirements
            session.expect(
                is_right,
                names,
                f"{name} at rest {least} to {most} increments on: the stop is 50 ahead",
                partial(_overrun_seen, driver, side, name, start, place, (least, most)),
            )
            # How far it runs on may not be known: then one place may be due to either reading.
            fitting = [number for number in (0, 1) if least + 1 - number <= place <= most - number]
            driver.judge.reading("soft_stop_compare", tuple(fitting), side.requirements)
            judge_bits(driver, side, name)
            if name.startswith("10h") or name == "13h":  # the others have no target to be away from
                driver.judge.reading(
                    "busy_after_abort", int(driver.status.is_busy()), side.requirements
                )
            driver.judge.accepted(0x03, 0, requirement=side.requirements)


@check("MACS-CMD-18-03", "MACS-STOP-03", safety=MOVES, level="full")
def a_software_stop_drops_a_preloaded_move(session: Session) -> None:
    """10h, 13h, then a segment that meets a software stop, and 11h: as after 18h, nothing moves."""
    driver = driver_of(session)
    for switch in ("abort_flush", "preload_policy", "arm_after_segment", "preload_locks"):
        if driver.readings.known(switch):
            session.skip(f"this device's {switch} leaves nothing to drop, or all")
    start = enable_stop(driver, SIDES[0], 20)
    segment = segment_parameter(60, driver.motion.period)
    for index, parameter in ((0x10, 0), (0x13, start - 40), (0x16, segment)):
        driver.judge.accepted(index, parameter)
    place = rest_place(driver)
    session.expect(place > start, "MACS-STOP-03", f"beyond {start}, on the stop", place)
    driver.client.command(0x11)  # with nothing to start, it may be refused
    moved = rest_place(driver) - place
    names = ("MACS-CMD-18-03", "MACS-STOP-03")
    session.expect(not moved, names, "no motion: the stop has dropped it", f"{moved:+d} increments")


@check("MACS-STOP-03", "MACS-CMD-09-02", safety=MOVES, level="full")
def a_software_stop_drops_the_stored_segments(session: Session) -> None:
    """A segment beyond a software stop ends there, and what was stored behind it never runs."""
    driver = driver_of(session)
    start = enable_stop(driver, SIDES[0], 20)
    for _ in range(3):
        driver.judge.accepted(0x16, segment_parameter(30, driver.motion.period))
    first = rest_place(driver) - start
    driver.client.wait(0.2)
    second = rest_place(driver) - start
    most = 21 + driver.limits.braking(driver.motion.period)
    session.expect(
        20 <= first <= most,
        ("MACS-STOP-03", "MACS-CMD-09-02"),
        f"at rest 20..{most} increments on",
        first,
    )
    session.expect(
        first == second,
        ("MACS-STOP-03", "MACS-CMD-09-02"),
        "at rest",
        f"{second - first} more increments",
    )
    driver.judge.accepted(0x16, segment_parameter(1, driver.motion.period))
    driver.judge.accepted(0x02, 0)


@check("MACS-STOP-03", "MACS-CMD-09-02", "MACS-CMD-0A-02", safety=MOVES, level="full")
def segments_that_turn_round_end_on_the_stop_they_meet_first(session: Session) -> None:
    """Of two software stops in the way of a row of segments, the first one ends it for good."""
    driver = driver_of(session)
    if not _passes(driver, SIDES[1], "16h"):
        session.skip("DDDD has no sign on this device: segments do not turn round")
    for side, other in (SIDES, SIDES[::-1]):
        near = driver.limits.way_outlasting(20, SLOWEST, 3)
        start, sign = enable_stop(driver, side, near), side.direction
        driver.judge.accepted(other.index, start - 30 * sign)
        period = driver.limits.outlasting(near, driver.motion.period)
        first = driver.motion.put(Segment((near + 20) * sign, period))
        second = driver.motion.put(Segment(-(near + 100) * sign, period))
        met_ns = first.taken.earliest_ns + near * period * TICK_NS
        driver.motion.taken_in_time(second, met_ns, "the way to the first stop")
        driver.client.wait(driver.motion.lasting_s(2 * near + 120, period))
        place = (rest_place(driver, period) - start) * sign
        most = near + 1 + driver.limits.braking(period)
        session.expect(
            near <= place <= most, side.requirements, f"at rest {near}..{most} increments on", place
        )
        judge_bits(driver, side, "nearer")
        driver.judge.accepted(0x03, 0)
    for side in SIDES:  # the segment before it ends short of any
        start, sign = enable_stop(driver, side, 30), side.direction
        short = driver.limits.segment(20, driver.motion.period)
        driver.motion.put(Segment(-short.steps * sign, short.period))
        driver.motion.put(Segment((short.steps + 130) * sign, short.period))
        driver.client.wait(driver.motion.lasting_s(2 * short.steps + 130, short.period))
        place = (rest_place(driver, short.period) - start) * sign
        most = 31 + driver.limits.braking(short.period)
        session.expect(
            30 <= place <= most, side.requirements, f"at rest 30..{most} increments on", place
        )
        judge_bits(driver, side, "only")
        driver.judge.accepted(0x03, 0)


@check("MACS-CMD-09-02", "MACS-CMD-0A-02", safety=MOVES, level="full")
def on_a_software_stop_nothing_ends(session: Session) -> None:
    """A target equal to the stop is reached and no bit is set: beyond means beyond."""
    driver = driver_of(session)
    for side in SIDES:
        start = enable_stop(driver, side, 50)
        target = start + 50 * side.direction
        driver.motion.finish(driver.motion.go(target), side.requirements[0])
        ff = driver.status.stopped_on()
        outcome: int | str = {0: 0, side.bit: 1, side.bit << 1: 1}.get(ff, f"ff {ff:02X}")
        if outcome or not driver.readings.known("soft_stop_compare"):
            # Where equal counts as beyond, the motion may be over before it is ended.
            driver.judge.reading("soft_stop_compare", outcome, side.requirements[0])
        driver.judge.accepted(0x03, 0)


@check("MACS-CMD-09-02", "MACS-CMD-0A-02", "MACS-CMD-03-01", safety=MOVES, level="full")
def software_stops_work_only_when_enabled(session: Session) -> None:
    """With 03h at 0 or 1 the axis passes both software stops, and no bit is set; at 9 they end the
    motion."""
    driver = driver_of(session)
    for side in SIDES:
        for mode in (0, 1):
            start = enable_stop(driver, side, 20, mode)
            driver.motion.finish(driver.motion.go(start + 60 * side.direction))
            ff = driver.status.stopped_on() & (SUPERIOR | INFERIOR)
            session.expect(
                ff == 0,
                ("MACS-CMD-03-01", side.requirements[0]),
                "no software stop in ff",
                f"{ff:02X}",
            )
        start = enable_stop(driver, side, 20, 9)
        driver.judge.accepted(0x13, start + 60 * side.direction)
        place = (rest_place(driver) - start) * side.direction
        most = 21 + driver.limits.braking(driver.motion.period)
        session.expect(
            20 <= place <= most,
            ("MACS-CMD-03-01", side.requirements[0]),
            f"at rest 20..{most} increments on: the stop is 20 ahead, and 03h = 9 enables it",
            place,
        )
        driver.judge.accepted(0x03, 0)


@check("MACS-STOP-03", "MACS-CMD-09-02", "MACS-CMD-0A-02", safety=MOVES, level="full")
def software_stops_are_watched_while_the_axis_slows_down(session: Session) -> None:
    """A software stop ends a motion on the ramp of 17h, and on that which leads to a target."""
    driver = driver_of(session)
    driver.limits.needs_room(3 * RAMP, "a ramp, full speed and a ramp again")
    period = driver.limits.outlasting(STOP_ON_RAMP - RAMP - ASIDE, PERIOD)
    for side, is_stopped in ((SIDES[0], True), (SIDES[1], False)):
        start = enable_stop(driver, side, STOP_ON_RAMP, settings=(period, RAMP_COEFFICIENT))
        if is_stopped:
            _stop_before(driver, STOP_ON_RAMP)
        else:
            way = STOP_ON_RAMP + RAMP // 2
            driver.judge.accepted(0x13, start + way * side.direction)
            driver.client.wait(driver.motion.lasting_s(way + 2 * RAMP))
        place = (rest_place(driver) - start) * side.direction
        most = STOP_ON_RAMP + 1 + driver.limits.braking(driver.motion.period)
        session.expect(
            STOP_ON_RAMP <= place <= most,
            side.requirements,
            f"at rest {STOP_ON_RAMP}..{most} increments on: the stop is {STOP_ON_RAMP} ahead",
            place,
        )
        judge_bits(driver, side, "enabled")
        driver.judge.accepted(0x03, 0)


def _stop_before(driver: AxisDriver, distance: int) -> None:
    """15h, and 17h so near before that distance that its ramp leads beyond it."""
    period, law = driver.motion.period, driver.readings.law_of(RAMP_COEFFICIENT)
    climb_ticks = Course.endless(period, RAMP_COEFFICIENT, law).profile.ticks_of(RAMP)
    begun = driver.judge.accepted(0x15, velocity(1, period)).taken
    driver.client.wait_until(begun.latest_ns + (climb_ticks + ASIDE * period) * TICK_NS)
    stop = driver.judge.accepted(0x17)
    met_ns = begun.earliest_ns + (climb_ticks + (distance - RAMP) * period) * TICK_NS
    driver.motion.taken_in_time(stop, met_ns, "the way to the stop")
    driver.client.wait(driver.motion.lasting_s(2 * RAMP))


@check("MACS-CMD-09-02", "MACS-CMD-0A-02", "MACS-STOP-03", safety=MOVES, level="full")
def from_beyond_a_software_stop_one_can_return(session: Session) -> None:
    """Parked beyond a stop, motion further out ends at once and the way back is free."""
    driver = driver_of(session)
    for side in SIDES:
        start = enable_stop(driver, side, -30)  # the axis stands 30 increments beyond its stop
        outward = driver.client.command(0x13, start + 60 * side.direction).kind
        moved = (rest_place(driver) - start) * side.direction
        beyond = driver.limits.braking(driver.motion.period) * 2
        session.expect(
            outward is ReplyKind.REFUSED or 0 <= moved <= beyond,
            side.requirements,
            "that it is refused, or moves no increment further out",
            f"{outward.value}, {moved} increments",
        )
        if outward is ReplyKind.ACCEPTED:
            judge_bits(driver, side, "outward")
        here = driver.client.position()
        inward = driver.client.command(0x13, start - 60 * side.direction).kind
        driver.client.wait(0.1)
        back = (here - rest_place(driver)) * side.direction
        outcome: int | str = f"{inward.value}, {back} increments back"
        if inward is ReplyKind.ACCEPTED and back >= 60:
            outcome = 0
        elif back <= 0:
            outcome = 1
        driver.judge.reading("soft_stop_blocks", outcome, side.requirements)
        if outcome == 0:
            ff = driver.status.stopped_on()
            if ff:  # gone it may be because the motion cleared it, or because it lives
                driver.judge.reading("ff_lifetime", 2, side.requirements[0])


@check("MACS-CMD-09-02", "MACS-STOP-03", "MACS-CMD-0B-01", safety=MOVES, level="full")
def software_stops_watch_the_counter(session: Session) -> None:
    """Clearing the counter shifts the stops in space, since they are numbers of the counter."""
    driver = driver_of(session)
    start = driver.motion.ready(PERIOD)
    if abs(start) > driver.limits.room():
        session.skip("the counter's origin could not be put back: it is outside the envelope")
    driver.motion.finish(driver.motion.go(start + 15))
    driver.judge.accepted(0x09, 30)
    driver.motion.keep_off(0x0A, -FAR)
    driver.judge.accepted(0x0B)
    driver.judge.accepted(0x03, 8)
    driver.judge.accepted(0x13, 90)
    place = rest_place(driver)
    driver.judge.accepted(0x03, 0)
    most = 31 + driver.limits.braking(driver.motion.period)
    session.expect(
        30 <= place <= most,
        ("MACS-CMD-09-02", "MACS-STOP-03", "MACS-CMD-0B-01"),
        f"30..{most} of the new count",
        place,
    )
    driver.motion.finish(driver.motion.go(-(start + 15)))
    driver.judge.accepted(0x0B)


@check("MACS-STOP-03", "MACS-CMD-0B-01", safety=MOVES, level="full")
def a_counter_cleared_in_motion_brings_the_stop_nearer(session: Session) -> None:
    """A software stop is met where the new count says, though the motion began with the old one."""
    driver = driver_of(session)
    start = driver.motion.ready(SLOWEST)
    if abs(start) > min(40, driver.limits.room()):
        session.skip("the counter is too far from 0 to be brought back there")
    driver.motion.finish(driver.motion.go(start - 60))
    driver.judge.accepted(0x09, 20)
    driver.motion.keep_off(0x0A, -FAR)
    driver.judge.accepted(0x03, 8)
    forecast = driver.motion.turn(1, SLOWEST)
    driver.client.wait(0.15)
    cleared = forecast.bounds(driver.judge.accepted(0x0B).taken)
    driver.client.wait(0.3)
    place = rest_place(driver)
    driver.judge.accepted(0x03, 0)
    most = 21 + driver.limits.braking(SLOWEST)
    session.expect(
        20 <= place <= most,
        ("MACS-STOP-03", "MACS-CMD-0B-01"),
        f"20..{most} of the new count",
        place,
    )
    driver.motion.finish(
        driver.motion.go(-cleared[0])
    )  # to one increment: nobody knows the instant better
    driver.judge.accepted(0x0B)
