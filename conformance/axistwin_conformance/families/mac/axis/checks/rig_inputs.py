"""Inputs: hardware stops, reference, reset (Q-27-02, STOP-01, STOP-02, REF-01, CMD-07, IO-01).

A contact that is closed pulls its input to ground: active.  Stops are levels and block one sign;
the reference is an edge, the contact's opening, and works in positive motion only (§5.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.rig import (
    AT_ONCE,
    HARD_NEGATIVE,
    HARD_POSITIVE,
    WORKED,
    MotionCommand,
    Origin,
)
from axistwin_conformance.families.mac.axis.driver.status import INPUT_BITS
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast, TimeWindow
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED
from axistwin_conformance.families.mac.axis.words import STATUS_BYTES

ORDER = 220  # of this module in a run; see `Family.modules`

STOP_INPUTS: Final = ("rig:positive_stop", "rig:negative_stop")
REFERENCE: Final = ("rig:reference",)
CATCH_UP_NS: Final = 200_000  # per increment and unit of 0Eh
SLOW_CATCH_UP: Final = 0xFF  # 51 ms per increment
LAG: Final = 40  # increments by which a held axis is left behind
EDGES_S: Final = 0.6  # a motion under which the contact is worked four times


@dataclass(frozen=True, slots=True)
class HardwareStop:
    """One hardware stop: its input, the sign of the motion it ends, its bit in ff."""

    name: str
    direction: int
    bit: int


SIDES: Final = (
    HardwareStop("positive_stop", 1, HARD_POSITIVE),
    HardwareStop("negative_stop", -1, HARD_NEGATIVE),
)


@check("MACS-Q-27-02", "MACS-Q-27-01", safety=WORKED, needs=(*STOP_INPUTS, *REFERENCE))
def the_inputs_show_whatever_is_enabled(session: Session) -> None:
    """Each input sets its own bit of 27h and no other, whatever 03h and 07h enable."""
    driver = driver_of(session)
    driver.rig.begin()
    settings = [(mode, enabled) for mode in (0, 1, 8, 9) for enabled in (0, 1)]
    for mode, enabled in settings if driver.session.rig.is_exact else [settings[0], settings[-1]]:
        driver.judge.accepted(0x03, mode)
        with driver.rig.reference_enabled(enabled):
            for name in INPUT_BITS:
                for active in (True, False):
                    driver.session.rig.work(name, active)
                    seen = [shown for shown, is_set in driver.status.inputs().items() if is_set]
                    session.expect(
                        seen == ([name] if active else []),
                        ("MACS-Q-27-02", "MACS-Q-27-01"),
                        f"27h to show as active: {name if active else 'none'}",
                        partial(_inputs_seen, name if active else "", seen, (mode, enabled)),
                    )


def _inputs_seen(active: str, shown: list[str], enabled: tuple[int, int]) -> Observation:
    """Which inputs 27h showed as active, with their bits, in words; `enabled`: 03h and 07h."""
    wanted = [active] if active else []
    wrong = next((name for name in INPUT_BITS if (name in shown) != (name in wanted)), active)
    byte, bit = INPUT_BITS[wrong]
    letters, number = STATUS_BYTES[0x27][byte], bit.bit_length() - 1
    only = f"with only the {_noun(active)} active" if active else "with no input active"
    did = "showed" if wrong in shown else "did not show"
    return Observation(
        f"{only} and 03h = {enabled[0]}, 07h = {enabled[1]},"
        f" {REQUEST} {did} the {_noun(wrong)} as active ({letters} bit {number} ="
        f" {int(wrong in shown)})",
        value=", ".join(shown) or "none",
        wanted=f"{'active' if wrong in wanted else 'not active'} ({letters} bit {number} ="
        f" {int(wrong in wanted)})",
    )


def _noun(name: str) -> str:
    return f"{name.replace('_', ' ')} input"


# --- hardware stops ------------------------------------------------------------------------------


@check("MACS-STOP-01", safety=WORKED, needs=STOP_INPUTS)
def a_hardware_stop_ends_motion_of_its_sign(session: Session) -> None:
    """Any motion ends where the stop becomes active; it is told, and the way back is free."""
    driver = driver_of(session)
    for side in SIDES:
        for mode, command in zip((1, 9, 1), driver.rig.motion_commands, strict=False):
            if driver.rig.can_go(command, side.direction):
                _trip(driver, side, command, mode)


def _trip(driver: AxisDriver, side: HardwareStop, command: MotionCommand, mode: int) -> None:
    session = driver.session
    start = driver.rig.begin()
    driver.rig.enable_stops(mode)
    moving = command.begin(driver.rig, start, side.direction * driver.rig.reach)
    driver.client.wait(0.08)
    act = driver.rig.contact(side.name, True)
    driver.rig.in_time(moving, act)
    place = driver.rig.rest()
    driver.rig.judge_place(place, moving.halted(act), side.direction, "MACS-STOP-01")
    driver.rig.judge_stop_bit(side.bit, "MACS-STOP-01")
    if command.name == "13h":  # the others have no target to be away from
        driver.judge.reading("busy_after_abort", int(driver.status.is_busy()), "MACS-STOP-01")
    driver.judge.accepted(0x03, mode, requirement="MACS-STOP-01")  # and so no longer running
    driver.motion.finish(driver.motion.go(start), "MACS-STOP-01")
    returned = driver.status.stopped_on()
    driver.rig.contact(side.name, False)
    # On the way back the bit goes, unless it lives as long as the stop, or for ever.
    if returned and command.name == "13h":
        driver.judge.reading("ff_lifetime", 2 if driver.status.stopped_on() else 1, "MACS-STOP-01")
    again = driver.rig.rest()
    session.expect(again == start, "MACS-STOP-01", "nothing resumes", f"at {again}, not {start}")


@check("MACS-STOP-01", "MACS-Q-21-01", safety=WORKED, needs=("rig:positive_stop",))
def the_hardware_stop_bit_stays_until_the_next_motion(session: Session) -> None:
    """The bit of 21h outlives the stop itself and 18h; the next motion clears it."""
    driver = driver_of(session)
    side = SIDES[0]
    start = driver.rig.begin()
    driver.judge.accepted(0x03, 1)
    moving = driver.motion.go(start + driver.rig.reach)
    driver.client.wait(0.08)
    driver.rig.in_time(moving, driver.rig.contact(side.name, True))
    driver.rig.rest()
    driver.rig.judge_stop_bit(side.bit, ("MACS-STOP-01", "MACS-Q-21-01"))
    driver.rig.contact(side.name, False)
    released = driver.status.stopped_on()
    driver.judge.accepted(0x18)
    stopped = driver.status.stopped_on()
    driver.motion.finish(driver.motion.go(start))
    moved = driver.status.stopped_on()
    outcome: int | str = f"ff {released:02X} released, {stopped:02X} after 18h, {moved:02X} moved"
    if not released and not moved:
        outcome = 1
    elif released and stopped == released:
        outcome = 2 if moved else 0
    driver.judge.reading("ff_lifetime", outcome, "MACS-STOP-01")


@check("MACS-STOP-01", safety=WORKED, needs=STOP_INPUTS, level="full")
def toward_an_active_hardware_stop_nothing_moves(session: Session) -> None:
    """A command toward an active stop is accepted, or refused, but makes no step."""
    driver = driver_of(session)
    for side in SIDES:
        for command in driver.rig.motion_commands:
            if not driver.rig.can_go(command, side.direction):
                continue
            start = driver.rig.begin()
            driver.judge.accepted(0x03, 1)
            driver.rig.contact(side.name, True)
            kind = _toward(driver, command, start + side.direction * 40)
            moved = (driver.rig.rest() - start) * side.direction
            limit = driver.limits.braking(driver.motion.period)
            session.expect(
                0 <= moved <= limit,
                None,
                f"{command.name}: no step toward the stop",
                f"{moved} steps",
            )
            driver.judge.reading(
                "hard_stop_command",
                ACCEPTED_OR_REFUSED.get(kind, f"{kind.value} to {command.name}"),
            )
            if kind is ReplyKind.ACCEPTED:
                driver.rig.judge_stop_bit(side.bit, None)
            driver.judge.accepted(0x03, 1)
            driver.rig.contact(side.name, False)
            again = driver.rig.rest()
            session.expect(again == start + moved * side.direction, None, "nothing resumes", again)


def _toward(driver: AxisDriver, command: MotionCommand, target: int) -> ReplyKind:
    """Send the command of a way without asking for a reply of one kind."""
    steps = target - driver.rig.start
    parameter = {
        "13h": target,
        "16h": (steps & 0xFFFF) << 16 | driver.motion.period,
        "15h": (0xF60000 if steps < 0 else 0) | driver.motion.period,
    }[command.name]
    return driver.client.command(int(command.name[:2], 16), parameter).kind


@check("MACS-STOP-01", safety=WORKED, needs=STOP_INPUTS, level="full")
def a_hardware_stop_does_not_touch_the_other_sign(session: Session) -> None:
    """A stop that becomes active under motion of the other sign changes nothing."""
    driver = driver_of(session)
    for side in SIDES:
        start = driver.rig.begin()
        driver.judge.accepted(0x03, 1)
        moving = driver.motion.go(start - side.direction * driver.rig.reach)
        driver.client.wait(0.08)
        driver.rig.contact(side.name, True)
        driver.motion.finish(moving)
        driver.rig.contact(side.name, False)
        session.expect(
            driver.status.stopped_on() == 0,
            None,
            "no stop bit",
            f"{driver.status.stopped_on():02X}",
        )


@check("MACS-STOP-02", "MACS-CMD-03-01", safety=WORKED, needs=STOP_INPUTS)
def disabled_hardware_stops_do_nothing(session: Session) -> None:
    """With 03h at 0 or 8, motion goes on and begins under both stops, and no bit is set."""
    driver = driver_of(session)
    for mode in (0, 8):
        for side in SIDES:
            start = driver.rig.begin()
            driver.rig.enable_stops(mode)
            target = start + side.direction * driver.rig.reach
            moving = driver.motion.go(target)
            driver.client.wait(0.08)
            for stop in SIDES:
                driver.rig.contact(stop.name, True)
            driver.motion.finish(moving, ("MACS-STOP-02", "MACS-CMD-03-01"))
            driver.motion.finish(driver.motion.go(start))
            session.expect(
                driver.status.stopped_on() == 0,
                ("MACS-STOP-02", "MACS-CMD-03-01"),
                "no stop bit",
                driver.status.stopped_on(),
            )
            for stop in SIDES:
                driver.rig.contact(stop.name, False)


@check("MACS-STOP-01", safety=WORKED, needs=("rig:hold", "rig:positive_stop"), level="full")
def a_hardware_stop_ends_a_catch_up_toward_it(session: Session) -> None:
    """What is left of a move is motion of its sign: the positive stop ends a catch-up that counts
    up, on the way."""
    driver, side = driver_of(session), SIDES[0]
    if not session.rig.is_exact or driver.readings.known("position_source"):
        session.skip(f"{AT_ONCE}, and 20h to tell where the shaft is")
    start = driver.rig.begin(0x0640)
    driver.judge.accepted(0x0E, SLOW_CATCH_UP << 8)
    driver.judge.accepted(0x03, 1)
    session.rig.work("hold", True)
    end = driver.motion.go(start + LAG).end
    assert end is not None
    driver.client.wait_until(end.latest_ns)
    driver.client.wait(0.1)
    is_running = driver.client.command(0x02, 0).kind is ReplyKind.REFUSED
    let_go = TimeWindow(*session.rig.work("hold", False))
    if not is_running:
        session.skip("the move was over with its profile: what is left is no motion (MACS-AMB-27)")
    step_ns = SLOW_CATCH_UP * CATCH_UP_NS
    driver.client.wait(LAG // 4 * step_ns / 1e9)
    act = driver.rig.contact(side.name, True)
    slack = driver.limits.allowance(driver.motion.period)
    least = (act.earliest_ns - let_go.latest_ns) // step_ns - slack
    most = (act.latest_ns - let_go.earliest_ns) // step_ns + 1 + slack
    most += driver.limits.braking(driver.motion.period)
    driver.client.wait((LAG + 5) * step_ns / 1e9)
    done = driver.client.position() - start
    session.expect(
        least <= done <= most,
        None,
        f"the catch-up ended {least}..{most} of {LAG} increments on",
        f"{done} increments",
    )
    driver.rig.judge_stop_bit(side.bit, None)
    driver.rig.contact(side.name, False)
    driver.client.wait(0.3)
    again = driver.client.position() - start
    session.expect(again == done, None, "nothing resumes", f"{again - done:+d} increments")
    driver.judge.accepted(0x03, 0)


# --- the reference -------------------------------------------------------------------------------


def _edge(driver: AxisDriver, moving: Forecast, origin: Origin, active: bool) -> bool:
    """Work the reference contact during a motion that began at 0; was the counter zeroed?

    Counting on and counting from the edge are told apart by one reading; anything else fails.
    """
    driver.client.wait(0.06)
    act = driver.rig.contact("reference", active)
    driver.rig.in_time(moving, act)
    steps = moving.bounds(act)
    sample = driver.client.sample()
    lowest, highest = moving.bounds(sample.taken)
    slack = driver.limits.allowance(driver.motion.period)
    doubt = slack + origin.doubt
    went_on = (lowest - origin.shift - doubt, highest - origin.shift + doubt)
    zeroed = (max(0, lowest - steps[1]) - slack, highest - steps[0] + slack)
    if went_on[0] <= sample.position <= went_on[1]:
        return False
    driver.session.expect(
        zeroed[0] <= sample.position <= zeroed[1],
        "MACS-REF-01",
        [f"{went_on[0]}..{went_on[1]}: counting on", f"{zeroed[0]}..{zeroed[1]}: from the edge"],
        sample.position,
    )
    origin.shift = (steps[0] + steps[1]) // 2
    origin.doubt = max(origin.doubt, steps[1] - origin.shift)
    return True


@check("MACS-REF-01", "MACS-CMD-07-01", safety=WORKED, needs=REFERENCE)
def opening_the_reference_contact_zeroes_the_counter(session: Session) -> None:
    """In positive motion each opening of the contact makes the counter 0; motion goes on."""
    driver = driver_of(session)
    distance = min(driver.limits.room(), 2 * driver.rig.reach)
    for command in driver.rig.motion_commands:
        driver.rig.begin(driver.rig.lasting(distance, EDGES_S))
        with driver.rig.own_origin() as origin, driver.rig.reference_enabled():
            moving = command.begin(driver.rig, 0, distance)
            edges = (True, False, True, False) if driver.session.rig.is_exact else (True, False)
            zeroed = [_edge(driver, moving, origin, active) for active in edges]
            half = len(edges) // 2
            outcome: int | str = f"zeroed at closing, opening...: {zeroed}"
            if zeroed in ([False, True] * half, [True, False] * half):
                outcome = int(zeroed[0])
            driver.judge.reading("ref_edge", outcome, ("MACS-REF-01", "MACS-CMD-07-01"))
            if command.is_endless:
                driver.judge.accepted(0x18)
                driver.rig.rest()
                continue
            _judge_end(driver, moving, command, origin)


def _judge_end(
    driver: AxisDriver, moving: Forecast, command: MotionCommand, origin: Origin
) -> None:
    """A segment is relative: its end tells exactly how far the counter was shifted."""
    end = moving.end
    assert end is not None
    if command.name != "16h":
        driver.motion.at_rest()  # what a zeroed move then does is judged elsewhere
        return
    driver.client.wait_until(end.latest_ns)
    slack = origin.doubt + driver.limits.allowance(driver.motion.period)
    whole, place = moving.final[1], driver.rig.rest()
    driver.session.expect(
        abs(whole - origin.shift - place) <= slack,
        "MACS-REF-01",
        f"all {whole} steps made: at rest about {whole - origin.shift}",
        place,
    )
    origin.shift = whole - place


@check("MACS-REF-01", "MACS-CMD-07-01", "MACS-CMD-07-02", safety=WORKED, needs=REFERENCE)
def without_its_enable_the_reference_does_nothing(session: Session) -> None:
    """With 07h at 0, and after 00h although 07h was 1, no edge zeroes the counter."""
    driver = driver_of(session)
    for requirement in ("MACS-CMD-07-01", "MACS-CMD-07-02"):
        driver.rig.begin()
        with driver.rig.own_origin() as origin, driver.rig.reference_enabled():
            if requirement == "MACS-CMD-07-01":
                driver.judge.accepted(0x07, 0)
            else:
                driver.rig.restart()
            judge_no_edge(driver, origin, requirement)
            session.expect(True, "MACS-REF-01", "", "")


def judge_no_edge(driver: AxisDriver, origin: Origin, requirement: str) -> None:
    """Work the contact in a positive move from 0; the counter must count on."""
    moving = driver.motion.go(driver.rig.reach)
    zeroed = [_edge(driver, moving, origin, active) for active in (True, False)]
    driver.session.expect(
        not any(zeroed),
        requirement,
        "the counter to count on over both edges of the reference contact",
        " and ".join(("zeroed" if one else "counted on") for one in zeroed),
    )
    driver.motion.finish(moving, requirement)


@check("MACS-REF-01", safety=WORKED, needs=REFERENCE)
def negative_motion_ignores_the_reference(session: Session) -> None:
    """In negative motion neither edge of the contact changes the counter."""
    driver = driver_of(session)
    distance = min(driver.limits.room(), 2 * driver.rig.reach)
    for command in driver.rig.motion_commands:
        if not driver.rig.can_go(command, -1):
            continue
        driver.rig.begin(driver.rig.lasting(distance, EDGES_S))
        with driver.rig.own_origin() as origin, driver.rig.reference_enabled():
            moving = command.begin(driver.rig, 0, -distance)
            for active in (True, False):
                driver.client.wait(0.06)
                driver.rig.in_time(moving, driver.rig.contact("reference", active))
                driver.motion.follow(moving, None, driver.limits.allowance(driver.motion.period))
            driver.motion.at_rest()
            origin.shift = 0


@check("MACS-REF-01", safety=WORKED, needs=REFERENCE)
def at_rest_the_reference_does_nothing(session: Session) -> None:
    """Without motion, powered or not, neither edge changes the counter."""
    driver = driver_of(session)
    start = driver.rig.begin()
    place = driver.motion.finish(driver.motion.go(start + 30))
    with driver.rig.reference_enabled():
        for power in (0x19, 0x1A):
            driver.judge.accepted(power)
            for active in (True, False):
                driver.rig.contact("reference", active)
                now = driver.client.position()
                session.expect(now == place, None, f"still {place}", now)


@check("MACS-REF-01", safety=WORKED, needs=REFERENCE, level="full")
def a_zeroed_move_ends_at_its_target_by_the_new_count(session: Session) -> None:
    """A 13h that is zeroed under way ends at its number of the new count, or goes the old way."""
    driver = driver_of(session)
    reach, closed_first = driver.rig.reach, not driver.readings.known("ref_edge")
    for begin, target in ((0, reach // 2), (-reach // 2, -reach // 8)):
        driver.rig.begin()
        driver.judge.accepted(0x0E, 0x0100)
        with driver.rig.own_origin() as origin, driver.rig.reference_enabled():
            driver.motion.finish(driver.motion.go(begin))
            driver.rig.contact("reference", closed_first)
            moving = driver.motion.go(target)
            driver.client.wait(0.06)
            act = driver.rig.contact("reference", not closed_first)
            driver.rig.in_time(moving, act)
            steps = [place - begin for place in moving.bounds(act)]
            _judge_target(driver, moving, steps, target, begin, origin)
            driver.rig.contact("reference", False)


def _judge_target(
    driver: AxisDriver, moving: Forecast, steps: list[int], target: int, begin: int, origin: Origin
) -> None:
    """Where the move ended tells what it kept: its target or its way (MACS-AMB-52)."""
    end = moving.end
    assert end is not None
    # At worst as many increments more as were made, then back at 200 µs each (0Eh is 01).
    more_ns = driver.rig.reach * (driver.motion.period * TICK_NS + CATCH_UP_NS)
    driver.client.wait_until(end.latest_ns + more_ns)
    place = driver.rig.rest()
    slack = driver.limits.allowance(driver.motion.period)
    left = sorted(target - begin - done for done in steps)
    outcome: int | str = f"at rest at {place}"
    if place == target:
        outcome = 0
    elif left[0] - slack <= place <= left[1] + slack:
        outcome = 1
    driver.judge.reading("ref_retarget", outcome)
    done = (steps[0] + steps[1]) // 2
    origin.shift = begin + done
    if outcome == 1:
        origin.shift = target - place


# --- the reset input -----------------------------------------------------------------------------


@check("MACS-IO-01", safety=WORKED, needs=("rig:reset",))
def held_in_reset_the_module_is_deaf(session: Session) -> None:
    """While the reset input is low nothing is answered or executed; then it starts up again."""
    driver = driver_of(session)
    start = driver.rig.begin(SLOWEST, 3)
    for is_moving in (False, True):
        driver.judge.accepted(0x0F, 3)
        if is_moving:
            driver.judge.accepted(0x13, start + driver.rig.reach)
            driver.client.wait(0.1)
        driver.session.rig.work("reset", True)
        if _answers_in_reset(driver, start):
            driver.judge.reading("has_reset_input", 1)
            return
        driver.judge.reading("has_reset_input", 0)
        driver.motion.wait_awake()
        if _answers_in_reset(driver, start):
            session.fail(None, "silence for as long as it is held", "an answer")
        driver.session.rig.work("reset", False)
        driver.rig.awake()
        place = driver.rig.rest()
        highest = start + driver.rig.reach * is_moving
        session.expect(start <= place <= highest, None, f"{start}..{highest}: deaf", place)
        coefficient = driver.client.parameter(0x0F)
        session.expect(coefficient == 3, None, "AA 03", f"{coefficient:02X}")
        driver.motion.finish(driver.motion.go_plainly(start))


def _answers_in_reset(driver: AxisDriver, start: int) -> bool:
    """Send what would be answered, Nacked, executed; True if anything comes."""
    frames = [
        driver.client.request(0x20),
        driver.client.request(0x0F, 0x55),
        driver.client.request(0x13, start - 40),
    ]
    if (corrupted := driver.client.corrupted(0x20, 0, 0)) is not None:
        frames.append(corrupted[0])
    return any(driver.client.send(frame, QUIET_S).kind is not ReplyKind.SILENCE for frame in frames)
