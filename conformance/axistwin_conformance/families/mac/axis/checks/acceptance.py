"""The acceptance table, cell by cell: every index in every state the wire alone can reach.

For each cell the module is brought into the state, gets the command with harmless parameters, and
must answer as the table says, or as another reading of it that the ledger names.  Re-initialising
and destructive commands have checks of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.acceptance import (
    RUNNING,
    AcceptanceRow,
    outcome_of,
)
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS
from axistwin_conformance.families.mac.axis.probes.sync import back

ORDER = 110  # of this module in a run; see `Family.modules`

LONG_STEPS: Final = 120  # a second of motion at the slowest speed
MOST_EXCHANGES: Final = 60  # in motion, from one start
MOST_LOCKED: Final = 14  # exchanges while what is locked is tried
RESUMES_S: Final = 0.2  # after it: what waited for the axis to be at rest would have begun
SHOWS_S: Final = 0.1  # another speed than the slowest
STANDS_S: Final = 0.1  # after 17h without a ramp
AHEAD: Final = 12  # increments: passed while what is locked is tried
FAR: Final = 100_000  # increments: a stop that is never reached
NEAR: Final = 40  # increments of tolerance: behind a start, for a while, and not before the end
SHORT_STEPS: Final = 100  # to run on for so many is waited for at the slowest speed


def _power_off(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x1A)


def _power_on(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x19)


def _move(driver: AxisDriver, start: int) -> None:
    # Each command takes it a little further from the start: it must not be there already.
    way = driver.limits.way_outlasting(LONG_STEPS, driver.motion.period, MOST_EXCHANGES)
    driver.client.command(0x13, start + way)


def _turn(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x15, velocity(1, driver.motion.period))


def _interpolate(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x16, segment_parameter(LONG_STEPS, driver.motion.period))


def _arm(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x10)


def _preload(driver: AxisDriver, start: int) -> None:
    driver.client.command(0x10)
    driver.client.command(0x13, start + 10)


# DJ needs a fault, hence a rig.
STATE_WORDS: Final = {
    "OF": "with the power off",
    "HD": "at rest",
    "AR": "after 10h, before a motion",
    "PL": "with a motion preloaded",
    "PO": "in point-to-point motion",
    "VE": "in velocity motion",
    "IN": "in interpolated motion",
}
ENTER: Final[Mapping[str, Callable[[AxisDriver, int], None]]] = {
    "OF": _power_off,
    "HD": _power_on,
    "PO": _move,
    "VE": _turn,
    "IN": _interpolate,
    "AR": _arm,
    "PL": _preload,
}

# Parameters that change nothing the module has not already, or next to nothing.
HARMLESS: Final[Mapping[int, Callable[[int, int], int]]] = {
    0x09: lambda start, period: 0x3FFFFFFF,
    0x0A: lambda start, period: 0xC0000000,
    0x0C: lambda start, period: 0x40,
    0x0D: lambda start, period: period,
    0x0E: lambda start, period: 0x0500,
    0x13: lambda start, period: start + 20,
    0x15: lambda start, period: velocity(1, period),
    0x16: lambda start, period: segment_parameter(5, period),
    0x1E: lambda start, period: segment_parameter(5, period),
}


def slowly(driver: AxisDriver) -> int:
    """The slowest period, or a faster one for an axis that runs on: over so many increments that
    each stop would take seconds."""
    runs_on = driver.limits.braking(SLOWEST)
    return driver.limits.outlasting(LONG_STEPS, SLOWEST * SHORT_STEPS // max(SHORT_STEPS, runs_on))


def judge_locked(driver: AxisDriver, over_ns: int, index: int, parameter: int) -> None:
    """Judge that a motion that is surely under way until then refuses that command."""
    exchange = driver.client.command(index, parameter)
    driver.motion.taken_in_time(exchange, over_ns, "the motion")
    driver.judge.must(ReplyKind.REFUSED, exchange, "MACS-STATE-01")


def walk(session: Session, *indices: int) -> None:
    """Judge the rows of these indices in every state of `ENTER`."""
    driver = driver_of(session)
    start = driver.motion.ready(slowly(driver))
    for index in indices:
        row = driver.client.face.acceptance[index]
        parameter = HARMLESS[index](start, driver.motion.period) if index in HARMLESS else 0
        for state, enter in ENTER.items():
            enter(driver, start)
            exchange = driver.client.command(index, parameter)
            driver.motion.at_rest()
            _judge(driver, row, state, index, exchange)
        if abs(driver.client.position() - start) > driver.limits.room():
            driver.motion.finish(driver.motion.go(start))


# Clauses of which acceptance is but a part: it is asked for, and proves none of them.
PARTLY: Final[Mapping[str, str]] = {
    "MACS-CMD-0C-03": "accepted in every state; that the motor then pulls less at once, the wire"
    " does not show",
    "MACS-CMD-0E-02": "accepted in every state; from when on it counts shows on a held shaft",
}


def _shown_by(session: Session, index: int) -> tuple[str, ...]:
    """Which of its check's requirements the row of an index shows: those that speak of it."""
    names = session.check.declared if session.check else ()
    kind = "Q" if index >= 0x20 else "CMD"
    return tuple(
        name
        for name in names
        if len(names) == 1
        or name == "MACS-STATE-01"
        or f"{index:02X}" in name.split("-")[2]
        or name.startswith(f"MACS-{kind}-XX")
    )


def _judge(
    driver: AxisDriver, row: AcceptanceRow, state: str, index: int, exchange: AxisExchange
) -> None:
    kind, words = exchange.kind, STATE_WORDS[state]
    seen = driver.client.observed(exchange)
    if state == "PO":
        words = f"{words} {driver.motion.settings_words()}"
    seen = replace(seen, clause=f"{seen.clause} {words}")
    shown = _shown_by(driver.session, index)
    wanted = outcome_of(row.cell(state))
    if index >= 0x20 and wanted is ReplyKind.ACCEPTED:
        wanted = ReplyKind.ANSWER
    session = driver.session
    if "unknown_index" in row.otherwise:
        fitting = tuple(
            number
            for number, kinds in enumerate(driver.client.face.unassigned)
            if kinds[index >= 0x20] is kind
        )
        driver.judge.reading(
            "unknown_index",
            fitting or f"{kind.value} to {driver.client.named(index)}",
            shown,
            seen,
        )
        return
    if kind is not wanted:
        others = row.readings(state)
        # What the device has shown already explains best.
        others.sort(key=lambda owner: driver.readings.known(owner[1]) != owner[2])
        for content, switch, number in others:
            if outcome_of(content) is kind:
                readings = session.run.ledger.ambiguity_of(switch).switches[switch]
                session.quirk(shown, switch, readings[number], seen)
                session.expect(True, shown, "", "")
                return
    session.step(
        kind is wanted,
        f"{driver.client.named(index)} to be {wanted.value} {words}",
        replace(seen, value=kind.value, wanted=driver.client.wanted(wanted)),
    )
    session.expect(True, [name for name in shown if name not in PARTLY], "", "")


def _written_in_motion(driver: AxisDriver, index: int, name: str) -> None:
    """What a parameter reads as after another value was sent in motion: that one if it was
    accepted, the old one if it was refused.  Either way the motion is none but the one begun."""
    start = driver.motion.ready(slowly(driver))
    parameter = PARAMETERS[index]
    before = driver.client.parameter(index)
    other = before - 1 if before else 1
    way = driver.limits.way_outlasting(LONG_STEPS, driver.motion.period, MOST_EXCHANGES)
    forecast = driver.motion.go(start + way)
    sent = driver.client.command(index, parameter.parameter(other))
    accepted = sent.kind is ReplyKind.ACCEPTED
    wanted, seen = other if accepted else before, driver.client.parameter(index)
    driver.client.wait(SHOWS_S)
    if name != "MACS-CMD-0C-03":  # the wire does not show all of it
        driver.motion.follow(forecast, name, driver.limits.allowance(driver.motion.period))
    driver.motion.at_rest()
    driver.client.command(index, parameter.parameter(before))
    if seen != wanted:
        told = "accepted" if accepted else "refused"
        driver.session.fail(name, f"{told} in motion: {wanted:X} is read", f"{seen:X}")


@check("MACS-CMD-02-02", "MACS-STATE-01", safety=("motion", "stored"))
def torque_at_rest_is_locked_in_motion(session: Session) -> None:
    """02h is refused while running and accepted in every other state."""
    walk(session, 0x02)


@check("MACS-CMD-03-02", "MACS-STATE-01", safety=("motion", "stored"))
def the_stops_mode_is_locked_in_motion(session: Session) -> None:
    """03h, all four values, is refused while running and accepted in every other state."""
    walk(session, 0x03)
    driver = driver_of(session)
    start = driver.motion.ready(slowly(driver))
    for state in RUNNING:
        for value in (0, 1, 8, 9):
            ENTER[state](driver, start)
            exchange = driver.client.command(0x03, value)
            driver.motion.at_rest()
            if exchange.kind is ReplyKind.ACCEPTED and value != 1:
                # The serial list keeps the mark of d = 1 only; the CAN list has all four.
                driver.judge.reading("motion_lock_set", 1, "MACS-CMD-03-02")
                driver.client.command(0x03, 0)
            else:
                driver.judge.must(ReplyKind.REFUSED, exchange, "MACS-CMD-03-02")


@check("MACS-CMD-090A-03", "MACS-STATE-01", safety=("motion", "stored"))
def the_software_stops_are_locked_in_motion(session: Session) -> None:
    """09h and 0Ah are refused while running and accepted in every other state."""
    walk(session, 0x09, 0x0A)
    for index in (0x09, 0x0A):
        _written_in_motion(driver_of(session), index, "MACS-CMD-090A-03")


@check("MACS-CMD-0D-02", "MACS-STATE-01", safety=("motion", "stored"))
def the_period_is_locked_in_motion(session: Session) -> None:
    """0Dh is refused while running and accepted in every other state."""
    walk(session, 0x0D)


@check("MACS-CMD-0F-02", "MACS-STATE-01", safety=("motion", "stored"))
def the_ramp_is_locked_in_motion(session: Session) -> None:
    """0Fh is refused while running and accepted in every other state."""
    walk(session, 0x0F)
    _written_in_motion(driver_of(session), 0x0F, "MACS-CMD-0F-02")


@check("MACS-CMD-13-02", "MACS-CMD-13-03", "MACS-STATE-01", safety=("motion", "stored"))
def a_move_is_refused_in_motion(session: Session) -> None:
    """13h is refused while running and accepted in every other state, unpowered included."""
    walk(session, 0x13)


@check("MACS-CMD-14-02", "MACS-STATE-01", safety=("motion", "stored"), level="full")
def a_move_to_0_is_refused_in_motion(session: Session) -> None:
    """14h is refused while running, which goes on, and accepted in every other state."""
    walk(session, 0x14)
    driver = driver_of(session)
    forecast = driver.motion.go(driver.motion.ready(slowly(driver)) + LONG_STEPS)
    driver.client.wait(0.1)
    if driver.client.command(0x14).kind is ReplyKind.REFUSED:
        driver.motion.finish(forecast, "MACS-CMD-14-02")


@check("MACS-CMD-15-02", safety=("motion", "stored"), level="full")
def velocity_is_accepted_in_every_state(session: Session) -> None:
    """15h is accepted in every state, or refused where the ledger leaves that open."""
    walk(session, 0x15)


@check("MACS-CMD-16-02", "MACS-CMD-1E-01", safety=("motion", "stored"))
def segments_are_accepted_in_every_state(session: Session) -> None:
    """16h and 1Eh are accepted while the FIFO has room, or refused during a profile."""
    walk(session, 0x16, 0x1E)


@check(
    "MACS-CMD-0C-03",
    "MACS-CMD-0E-02",
    "MACS-CMD-1C-01",
    "MACS-CMD-07-01",
    safety=("motion", "stored"),
    level="full",
)
def torque_catch_up_and_tolerance_are_free_in_motion(session: Session) -> None:
    """07h, 0Ch, 0Eh and 1Ch are accepted in every state."""
    walk(session, 0x07, 0x0C, 0x0E, 0x1C)
    for index, name in {
        0x0C: "MACS-CMD-0C-03",
        0x0E: "MACS-CMD-0E-02",
        0x1C: "MACS-CMD-1C-01",
    }.items():
        _written_in_motion(driver_of(session), index, name)
    for name, what in PARTLY.items():
        session.info(name, what)
    _torque_up_and_down_in_motion(driver_of(session))
    _tolerance_on_the_way(driver_of(session))


def _torque_up_and_down_in_motion(driver: AxisDriver) -> None:
    """In each kind of motion the torque limit may be lowered, and raised again."""
    for state in RUNNING:
        start = driver.motion.ready(slowly(driver))
        own = driver.client.parameter(0x0C)
        ENTER[state](driver, start)
        for value in (own - 1 if own else 1, own):
            exchange = driver.client.command(0x0C, PARAMETERS[0x0C].parameter(value))
            if exchange.kind is not ReplyKind.ACCEPTED:
                driver.judge.must(ReplyKind.ACCEPTED, exchange, "MACS-CMD-0C-03")
        driver.motion.at_rest()


def _tolerance_on_the_way(driver: AxisDriver) -> None:
    """A tolerance above the way that is left does not end the move: it goes on to its target."""
    start = driver.motion.ready(slowly(driver))
    way = driver.limits.way_outlasting(LONG_STEPS // 2, driver.motion.period, 6)
    forecast = driver.motion.go(start + way)
    if driver.client.command(0x1C, 0xFF).kind is ReplyKind.ACCEPTED:
        driver.motion.watch(forecast, "MACS-CMD-1C-01", samples=2)
        driver.client.command(0x1C, 0)
    driver.motion.at_rest()


@check("MACS-CMD-10-01", "MACS-CMD-11-02", safety=("motion", "stored"), level="full")
def sync_commands_are_accepted_in_every_state(session: Session) -> None:
    """10h and 11h are accepted in every state; 11h may be refused with nothing preloaded."""
    walk(session, 0x10, 0x11)


@check(
    "MACS-CMD-17-01",
    "MACS-CMD-18-01",
    "MACS-CMD-18-02",
    "MACS-CMD-19-01",
    "MACS-CMD-1A-01",
    safety=("motion", "stored"),
    level="full",
)
def stops_and_power_are_accepted_in_every_state(session: Session) -> None:
    """17h, 18h, 19h and 1Ah are accepted in every state."""
    walk(session, 0x17, 0x18, 0x19, 0x1A)


@check("MACS-CMD-XX-01", "MACS-Q-XX-02", safety=("motion", "stored"), level="full")
def unassigned_indices_are_refused_in_every_state(session: Session) -> None:
    """What is not assigned is refused in every state, and disturbs none."""
    table = driver_of(session).client.face.acceptance
    walk(session, *(index for index in sorted(table) if table[index].cells == "RRRRRRRR"))


@check("MACS-Q-XX-01", safety=("motion", "stored"), level="full")
def queries_are_answered_in_every_state(session: Session) -> None:
    """Every query that means something is answered in every state."""
    driver = driver_of(session)
    walk(session, *driver.client.face.answered)
    for enter in (_move_back, _turn_back, _interpolate_back):
        enter(driver, driver.motion.ready(slowly(driver)))
        for index in driver.client.face.answered:
            driver.judge.must(ReplyKind.ANSWER, driver.client.ask(index))
        driver.motion.at_rest()


def _move_back(driver: AxisDriver, start: int) -> None:
    way = driver.limits.way_outlasting(LONG_STEPS, driver.motion.period, MOST_LOCKED)
    driver.judge.accepted(0x13, start - way)


def _turn_back(driver: AxisDriver, start: int) -> None:
    driver.judge.accepted(0x15, velocity(-1, driver.motion.period))


def _interpolate_back(driver: AxisDriver, start: int) -> None:
    steps = back(driver, LONG_STEPS)
    driver.judge.accepted(0x16, segment_parameter(steps, driver.motion.period))


@check("MACS-REPLY-05", "MACS-CMD-13-02", safety=("motion", "stored"), level="full")
def what_is_refused_in_motion_has_no_effect(session: Session) -> None:
    """All that a motion locks is refused in each kind of motion, armed or not: the parameters stay
    as they were, the motion goes on, and nothing of it is done when the axis has come to rest."""
    driver = driver_of(session)
    names = ("MACS-REPLY-05", "MACS-CMD-13-02")
    _unassigned_on_the_way(driver)
    _busy_behind_a_refusal(driver)
    stored = _after_a_restart(driver)
    for state in RUNNING:
        start = driver.motion.ready(slowly(driver))
        driver.motion.keep_off(0x09, start + FAR)
        driver.motion.keep_off(0x0A, start - FAR)
        if state != "IN":  # there a refused 03h enables none
            driver.judge.accepted(0x03, 8)
        before = driver.client.parameters()
        forecast = _begun(driver, state, start)
        for index, parameter in _locked(driver, before, start):
            if driver.client.command(index, parameter).kind is not ReplyKind.REFUSED:
                return  # the checks of the lock judge that
        _refused_wherever_to(driver, start, forecast)
        driver.client.wait(SHOWS_S)
        driver.motion.follow(forecast, names, driver.limits.allowance(driver.motion.period))
        after = driver.client.parameters()
        _judge_as_before(driver, before, after)
        if state == "VE":
            driver.judge.accepted(0x17)
            driver.motion.run_out()
            driver.client.wait(STANDS_S)
            place = driver.client.position()
        else:
            place = driver.motion.finish(forecast, names)
        driver.client.wait(RESUMES_S)
        again = driver.client.position()
        session.expect(again == place, names, f"at rest at {place}", again)
        driver.motion.disarm()
    _judge_as_before(driver, stored, _after_a_restart(driver))


def _refused_wherever_to(driver: AxisDriver, start: int, forecast: Forecast) -> None:
    """A move is refused to where the axis is going already, too, and with 10h before it, which is
    about a motion from rest."""
    ends = {timeline.final for timeline in forecast.timelines if forecast.mode == "PO"}
    end = next((place for place in ends if place is not None), start)
    for index, parameter in ((0x13, end), (0x10, 0), (0x13, start)):
        exchange = driver.client.command(index, parameter)
        driver.motion.taken_in_time(exchange, forecast.steady_until_ns, "the motion")
        if index == 0x13:
            driver.judge.must(ReplyKind.REFUSED, exchange, "MACS-CMD-13-02")


def _busy_behind_a_refusal(driver: AxisDriver) -> None:
    """A refused target close to the axis does not end busy: the target of the move does."""
    start = driver.motion.ready(slowly(driver))
    if driver.client.command(0x1C, NEAR).kind is not ReplyKind.ACCEPTED:
        return
    period = driver.motion.period
    way = driver.limits.way_outlasting(LONG_STEPS, period, 6)
    forecast = driver.motion.go(start + way)
    for index in (0x13, 0x14) if abs(start) <= NEAR // 2 else (0x13,):
        if driver.client.command(index, start if index == 0x13 else 0).kind is ReplyKind.REFUSED:
            is_busy = driver.status.is_busy()
            left = start + way - forecast.bounds(driver.client.ask(0x20).taken)[1]
            is_far = left > NEAR + driver.limits.allowance(period)
            wanted = f"busy, {left} increments before the target of the move"
            driver.session.expect(is_busy or not is_far, "MACS-REPLY-05", wanted, "not busy")
    driver.motion.at_rest()


def _judge_as_before(
    driver: AxisDriver, before: Mapping[int, int], after: Mapping[int, int]
) -> None:
    wrong = [index for index in before if after[index] != before[index]]
    driver.session.expect(
        not wrong,
        "MACS-REPLY-05",
        [f"{driver.client.named(index)} still {before[index]:X}h" for index in wrong],
        [f"{after[index]:X}h" for index in wrong],
    )


def _after_a_restart(driver: AxisDriver) -> dict[int, int]:
    """The parameters with which the module starts up again, set as for a motion before."""
    driver.motion.ready(slowly(driver))
    driver.motion.reinitialise()
    return driver.client.parameters()


def _unassigned_on_the_way(driver: AxisDriver) -> None:
    """Whatever a device says to commands that are not assigned, a move goes on as it was."""
    start = driver.motion.ready(slowly(driver))
    table, period = driver.client.face.acceptance, driver.motion.period
    unassigned = [index for index in range(0x20) if table[index].cells == "RRRRRRRR"]
    way = driver.limits.way_outlasting(LONG_STEPS, period, 2 * len(unassigned) + 2)
    forecast = driver.motion.go(start + way)
    for index in unassigned:
        driver.client.command(index)
        driver.motion.follow(forecast, "MACS-REPLY-05", driver.limits.allowance(period))
    driver.motion.watch(forecast, "MACS-REPLY-05", samples=2)


def _begun(driver: AxisDriver, state: str, start: int) -> Forecast:
    """Begin a motion of that kind that outlasts what is then sent; what to expect of it."""
    if state == "VE":
        return driver.motion.turn(-1, driver.motion.period)
    if state == "PO":
        period = driver.motion.period
        return driver.motion.go(start + driver.limits.way_outlasting(60, period, MOST_LOCKED))
    segment = driver.limits.segment(30, driver.motion.period, exchanges=MOST_LOCKED // 2)
    return driver.motion.feed(start, segment, segment)


def _locked(driver: AxisDriver, values: Mapping[int, int], start: int) -> Iterator[tuple[int, int]]:
    """What every motion locks, as far as this device does, each with another value than it has."""
    asked = {
        0x02: 1 - (values[0x02] & 1),
        0x03: 0 if values[0x03] else 9,
        0x09: start + AHEAD,  # in the way of the motion, up or down
        0x0A: start - AHEAD,
        0x0D: driver.limits.slowed(0x2123),
        0x0F: values[0x0F] ^ 0x05,
        0x14: 0,
        0x13: start - 40,
    }
    for index, parameter in asked.items():
        is_surely = index in (0x02, 0x03, 0x13) or driver.readings.known("motion_lock_set") == 0
        if is_surely and (index != 0x14 or driver.limits.fits(0)):
            yield index, parameter


@check("MACS-STATE-01", "MACS-CMD-13-01", safety=("motion", "stored"), level="full")
def the_lock_ends_with_the_motion(session: Session) -> None:
    """0Dh and 0Fh are refused up to the end of a move and a segment, then accepted."""
    driver = driver_of(session)
    start = driver.motion.ready(driver.limits.outlasting(100, 0x4000))
    slack_ns = 0 if session.transport.is_virtual else 200_000_000
    before_ns = 40_000_000 + driver.client.target.uncertainty_ns
    for begin in (_short_move, _short_segment):
        end = begin(driver, start)
        driver.client.wait_until(end[0] - before_ns)
        exchange = driver.client.command(0x02, 0)  # locked by every reading of the list
        if exchange.taken.latest_ns < end[0]:
            driver.judge.must(ReplyKind.REFUSED, exchange, "MACS-STATE-01")
        driver.client.wait_until(end[1] + slack_ns)
        driver.judge.accepted(0x02, 0, requirement="MACS-STATE-01")
        driver.judge.accepted(0x0F, 0, requirement="MACS-STATE-01")
        driver.judge.accepted(0x0D, driver.motion.period, requirement="MACS-STATE-01")
        driver.judge.accepted(0x13, start, requirement="MACS-CMD-13-01")
        driver.client.wait(0.3 + driver.motion.lasting_s(100))


def _short_move(driver: AxisDriver, start: int) -> tuple[int, int]:
    end = driver.motion.go(start + 100).end
    assert end is not None
    return end.edges


def _short_segment(driver: AxisDriver, start: int) -> tuple[int, int]:
    window = driver.judge.accepted(0x16, segment_parameter(100, driver.motion.period)).taken
    duration_ns = 100 * driver.motion.period * TICK_NS
    return window.earliest_ns + duration_ns, window.latest_ns + duration_ns
