"""Faults, warnings and what 21h and 27h tell of supply and temperature (STATE-02 to -04, Q-21-02,
Q-21-03, Q-27-01).

A fault that latches cuts the motor's power and keeps every motion command refused until 00h or the
supply has been away; parameters stay writable.  Warnings come and go with the supply.  What the
supply or the temperature must do is judged by what 27h tells of it: a rig need not be exact.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import CannotDo
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.facts import facts_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.driver.rig import (
    AT_ONCE,
    OVER_VOLTAGE,
    UNDER_VOLTAGE,
    WORKED,
    MotionCommand,
)
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.axis.parameters import settings_of
from axistwin_conformance.families.mac.axis.snapshot import DISJUNCTIONS
from axistwin_conformance.transport.rig import Rig

ORDER = 230  # of this module in a run; see `Family.modules`

HOT_CELSIUS: Final = 90.0
TRIPS_FROM_TT: Final = 0x79  # MAC23: 85 °C is 78h (§5.9)
OVER_FROM_VV: Final = 0xDD  # MAC23: 46.04 V
UNDER_TO_VV: Final = 0x39  # MAC23: 11.88 V
NO_THRESHOLDS: Final = "the manual gives no thresholds for this model (MACS-AMB-56)"
FIRST_WITH_MEMORY: Final = 0x0704  # hh.7 exists from release 7.4 on, if 24h spells it so

PARAMETERS_STAY: Final = (
    "After a fault the motor is unpowered and motion commands are refused until 00h or a power"
    " cycle. That parameters can still be set is concluded from it."
)
STARTING: Final = (0x13, 0x14, 0x15, 0x16, 0x19, 0x1E)
OTHER_MOTION: Final = (0x10, 0x11, 0x17, 0x18, 0x1A)  # refused too, or not: MACS-AMB-33


@dataclass(frozen=True, slots=True)
class Cause:
    """A fault: the rig's control behind it, what the manual calls it, its bit of dd, the values
    that bring it about and end it, and whether its cause lasts."""

    name: str
    words: str
    bit: int
    present: bool | float = True
    absent: bool | float = False
    lasts: bool = True

    def begin(self, rig: Rig) -> tuple[int, int]:
        """Bring it about."""
        return rig.work(self.name, self.present)

    def end(self, rig: Rig) -> tuple[int, int]:
        """End what brings it about."""
        return rig.work(self.name, self.absent)


MICRO_CUT: Final = Cause("micro_cut", "power line disturbance", 0x01, lasts=False)
ENCODER: Final = Cause("encoder", "encoder fault", 0x02)
AMPLIFIER: Final = Cause("amplifier", "amplifier fault", 0x08)


def heat(usual: float) -> Cause:
    """Too hot, which a MAC23 tells in bit 4; back to the usual temperature."""
    return Cause("temperature", "overheating", 0x10, HOT_CELSIUS, usual)


def is_mac23(session: Session) -> bool:
    """True for the model whose thresholds and thermal bit the manual gives."""
    return facts_of(session).is_mac23


def celsius(driver: AxisDriver) -> float:
    """The temperature, by 27h."""
    return facts_of(driver.session).celsius(driver.client.data_bytes(0x27)[0])


# --- disjunctions --------------------------------------------------------------------------------


@check("MACS-STATE-02", "MACS-Q-21-02", safety=WORKED, needs=("rig:micro_cut",))
def a_micro_cut_of_the_supply_locks_motion(session: Session) -> None:
    """A power line disturbance sets bit 0 of dd in 21h; motion commands are refused until 00h, and
    parameters can still be set."""
    walk_through(driver_of(session), MICRO_CUT)


@check("MACS-STATE-02", "MACS-STATE-03", "MACS-Q-21-02", safety=WORKED, needs=("rig:temperature",))
def overheating_locks_motion(session: Session) -> None:
    """Above 85 °C dd.4 latches and motion is refused until 00h, or again if it is still hot."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    walk_through(driver, heat(celsius(driver)))


@check("MACS-STATE-02", "MACS-STATE-03", "MACS-Q-21-02", safety=WORKED, needs=("rig:amplifier",))
def an_amplifier_fault_locks_motion(session: Session) -> None:
    """On a MAC34 an amplifier fault latches dd.3 and refuses motion until 00h."""
    if is_mac23(session):
        session.skip("only a MAC34 tells faults of its amplifier")
    walk_through(driver_of(session), AMPLIFIER)


@check("MACS-STATE-02", "MACS-STATE-03", "MACS-Q-21-02", safety=WORKED, needs=("rig:encoder",))
def a_missing_encoder_locks_motion(session: Session) -> None:
    """On a MAC34 a missing encoder is told in dd.1 and refuses motion, or is only told."""
    if is_mac23(session):
        session.skip("only a MAC34 tells that its encoder is missing")
    driver = driver_of(session)
    start = driver.rig.begin()
    driver.session.rig.work("encoder", True)
    session.expect(
        driver.status.faults() == ENCODER.bit,
        ("MACS-STATE-03", "MACS-Q-21-02"),
        "dd 02",
        f"{driver.status.faults():02X}",
    )
    kind = driver.client.command(0x13, start + 5).kind
    driver.motion.at_rest()
    driver.session.rig.work("encoder", False)
    outcome = {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1}.get(kind, kind.value)
    driver.judge.reading("encoder_fault_locks", outcome, "MACS-STATE-02")
    driver.rig.restart()
    if outcome == 0:
        walk_through(driver, ENCODER)


@check("MACS-STATE-03", "MACS-Q-21-02", safety=WORKED, needs=("rig:temperature",), level="full")
def a_fault_gone_by_the_end_of_the_start_up_is_forgotten(session: Session) -> None:
    """At the end of the start-up faults are looked at afresh: what came and went before, is not."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    if not driver.session.rig.is_exact or driver.motion.deaf_s < 1:
        session.skip(f"{AT_ONCE}: it has to heat and to cool while the module starts")
    start = driver.rig.begin()
    cause = heat(celsius(driver))
    driver.client.within(QUIET_S, 0x00)
    cause.begin(driver.session.rig)
    driver.client.wait(0.1)
    cause.end(driver.session.rig)
    driver.rig.awake("MACS-STATE-03")
    seen = driver.status.faults()
    session.expect(seen == 0, ("MACS-STATE-03", "MACS-Q-21-02"), "dd 00", f"{seen:02X}")
    driver.motion.finish(driver.motion.go(start + 10), "MACS-STATE-03")


def walk_through(driver: AxisDriver, cause: Cause) -> None:
    """A fault's whole life, at rest: it comes, locks, latches, goes with 00h, or comes back."""
    session = driver.session
    start = driver.rig.begin()
    cause.begin(driver.session.rig)
    _judge_bits(driver, cause, "MACS-Q-21-02")
    _judge_lock(driver, start)
    _judge_parameters(driver, cause)
    cause.end(driver.session.rig)
    driver.client.wait(0.2)
    _judge_bits(driver, cause, "MACS-Q-21-02")
    for index in (0x19, 0x1A):  # neither clears it
        driver.client.command(index)
    driver.judge.refused(0x13, start + 5, requirement="MACS-STATE-02")
    _judge_bits(driver, cause, "MACS-Q-21-02")
    _clear(driver)
    session.expect(
        driver.status.faults() == 0,
        ("MACS-STATE-02", "MACS-Q-21-02"),
        "dd 00",
        f"{driver.status.faults():02X}",
    )
    driver.motion.finish(driver.motion.go(start + 40), "MACS-STATE-02")
    driver.motion.finish(driver.motion.go(start), "MACS-STATE-02")
    if cause.lasts:
        _judge_return(driver, cause, start)
    session.expect(
        driver.client.position() == start,
        "MACS-STATE-02",
        f"still {start}",
        driver.client.position(),
    )


def _judge_return(driver: AxisDriver, cause: Cause, start: int) -> None:
    """With its cause still there, the fault is back after 00h."""
    cause.begin(driver.session.rig)
    _clear(driver)
    _judge_bits(driver, cause, "MACS-STATE-03")
    driver.judge.refused(0x13, start + 5, requirement="MACS-STATE-03")
    cause.end(driver.session.rig)
    _clear(driver)


def _clear(driver: AxisDriver) -> None:
    """00h, which a disjuncted module accepts, and the time it then needs."""
    driver.client.command(0x00)
    driver.rig.awake("MACS-STATE-02")


def _judge_bits(driver: AxisDriver, cause: Cause, requirement: str) -> None:
    seen = driver.status.faults() & DISJUNCTIONS
    driver.session.expect(
        seen == cause.bit, requirement, f"dd {cause.bit:02X} for {cause.name}", f"{seen:02X}"
    )


def _judge_lock(driver: AxisDriver, start: int) -> None:
    """Motion commands are refused; whether stops and the like count among them is open."""
    parameters = {
        0x13: start + 40,
        0x15: velocity(1, driver.motion.period),
        0x16: segment_parameter(5, driver.motion.period),
        0x1E: segment_parameter(5, driver.motion.period),
    }
    for index in STARTING:
        driver.judge.refused(index, parameters.get(index, 0), requirement="MACS-STATE-02")
    ambiguous = [
        index
        for index in OTHER_MOTION
        if index != 0x11 or not driver.readings.known("sync_without_preload")
    ]
    kinds = {index: driver.client.command(index).kind for index in ambiguous}
    described = ", ".join(f"{index:02X}h {kind.value}" for index, kind in kinds.items())
    outcome: int | str = described
    if set(kinds.values()) == {ReplyKind.REFUSED}:
        outcome = 0
    elif set(kinds.values()) == {ReplyKind.ACCEPTED}:
        outcome = 1
    driver.judge.reading("disj_refuse_set", outcome, "MACS-STATE-02")
    driver.session.expect(
        driver.client.position() == start,
        "MACS-STATE-02",
        f"still {start}",
        driver.client.position(),
    )


def _judge_parameters(driver: AxisDriver, cause: Cause) -> None:
    """What is no motion command is accepted, with what is set already."""
    settings = {**settings_of(driver.client.parameters()), 0x07: 0}
    tolerance = settings.pop(0x1C)
    for index, parameter in sorted(settings.items()):
        exchange = driver.client.command(index, parameter)
        seen, active = driver.client.observed(exchange), f"21h, dd = {cause.bit:02X}h"
        wanted = driver.client.wanted(ReplyKind.ACCEPTED)
        driver.session.expect(
            exchange.kind is ReplyKind.ACCEPTED,
            "MACS-STATE-02",
            wanted,
            replace(
                seen,
                clause=f'at rest, with the fault "{cause.words}" active ({active}), {seen.clause}',
                wanted=f"{wanted}, because a fault locks motion commands and"
                f" {driver.client.named(index)} sets a parameter",
                causes=(driver.client.named(0x21).removeprefix("query "),),
                rule=PARAMETERS_STAY,
                is_whole=True,
            ),
        )
    if driver.rig.has_tolerance():
        driver.judge.accepted(0x1C, tolerance, requirement="MACS-STATE-02")
    for index in driver.client.face.answered:
        driver.client.value(index)


def _causes(driver: AxisDriver) -> list[Cause]:
    """The faults this model tells that the rig can make."""
    known = [MICRO_CUT]
    if is_mac23(driver.session):
        known.append(heat(celsius(driver)))
    else:
        known.append(AMPLIFIER)
    return [cause for cause in known if cause.name in driver.session.rig.capabilities]


@check("MACS-STATE-02", "MACS-Q-20-01", safety=WORKED, needs=("rig:micro_cut",))
def a_fault_in_motion_cuts_the_power(session: Session) -> None:
    """A fault under any motion ends it; the position stays valid, nothing resumes after 00h."""
    driver = driver_of(session)
    for cause in _causes(driver):
        for command in driver.rig.motion_commands:
            with suppress(CannotDo):  # of the causes one suffices
                _cut_down(driver, cause, command)


def _cut_down(driver: AxisDriver, cause: Cause, command: MotionCommand) -> None:
    session = driver.session
    start = driver.rig.begin()
    moving = command.begin(driver.rig, start, driver.rig.reach)
    driver.client.wait(0.08)
    act = TimeWindow(*cause.begin(driver.session.rig))
    driver.rig.in_time(moving, act)
    place = driver.rig.rest()
    driver.rig.judge_place(
        place, moving.halted(act), 1, ("MACS-STATE-02", "MACS-Q-20-01"), coasts=True
    )
    _judge_bits(driver, cause, "MACS-STATE-02")
    driver.judge.refused(0x13, start, requirement="MACS-STATE-02")
    driver.judge.refused(
        0x16, segment_parameter(5, driver.motion.period), requirement="MACS-STATE-02"
    )
    cause.end(driver.session.rig)
    _clear(driver)
    again = driver.rig.rest()
    session.expect(again == place, "MACS-STATE-02", f"nothing resumes: still {place}", again)
    driver.motion.finish(driver.motion.go(start), "MACS-STATE-02")


@check(
    "MACS-STATE-02",
    "MACS-Q-21-02",
    safety=WORKED,
    needs=("virtual", "rig:supply", "rig:temperature"),
)
def far_too_much_cuts_the_power_of_a_mac34(session: Session) -> None:
    """Where dd.3 comes with the supply, or dd.2 with the temperature, it ends the motion as well.

    From where on is not told (MACS-AMB-56), so both are raised as far as 27h can tell: too much for
    a real one.
    """
    if is_mac23(session):
        session.skip("only a MAC34 has these two bits")
    driver, facts = driver_of(session), facts_of(session)
    usual_volts, usual_celsius = facts.volts(driver.client.data_bytes(0x27)[1]), celsius(driver)
    most_volts = facts.volts(0xFF)
    rises = (
        (0x08, "supply", usual_volts, most_volts),
        (0x04, "temperature", usual_celsius, 120.0),
    )
    for bit, control, usual, most in rises:
        start = driver.rig.begin()
        driver.motion.turn(1, driver.motion.period)
        values = (round(usual + (most - usual) * part / 20, 1) for part in range(1, 21))
        is_latched = any(_latches(driver, control, value, bit) for value in values)
        place = driver.rig.rest() if is_latched else start
        if is_latched:
            _judge_lock(driver, place)
        session.rig.work(control, usual)
        driver.motion.at_rest()
        _clear(driver)
        again = driver.client.position()
        session.expect(
            not is_latched or again == place, "MACS-STATE-02", f"nothing resumes: {place}", again
        )


def _latches(driver: AxisDriver, control: str, value: float, bit: int) -> bool:
    """Whether supply or temperature at that value is a fault; if so, it is the one of `bit`."""
    driver.session.rig.work(control, value)
    seen = driver.status.faults() & DISJUNCTIONS
    driver.session.expect(seen in (0, bit), "MACS-Q-21-02", f"dd 00 or {bit:02X}", f"{seen:02X}")
    return seen == bit


# --- supply and temperature ----------------------------------------------------------------------


def _judge_close(
    driver: AxisDriver, what: str, wanted: float, described: float, exact: float
) -> None:
    """27h tells the value that the rig set: to one count, or to what a bench's own meter shows."""
    limit = exact if driver.session.rig.is_exact else max(1.0, 0.1 * abs(wanted), exact)
    driver.session.expect(
        abs(described - wanted) <= limit,
        "MACS-Q-27-01",
        f"{what} {wanted:g} ± {limit:.2f}",
        f"{described:g}",
    )


@check("MACS-Q-27-01", safety=WORKED, needs=("rig:supply", "rig:temperature"))
def supply_and_temperature_have_the_model_s_scale(session: Session) -> None:
    """27h follows supply and temperature in the scale that the manual gives for the model."""
    driver, facts = driver_of(session), facts_of(session)
    usual = facts.volts(driver.client.data_bytes(0x27)[1])
    for share in (0.7, 0.85, 1.1):
        driver.session.rig.work("supply", round(usual * share, 2))
        described = facts.volts(driver.client.data_bytes(0x27)[1])
        _judge_close(driver, "supply", round(usual * share, 2), described, facts.volts_per_count)
    for degrees in (10.0, 35.0, 60.0, 80.0):
        driver.session.rig.work("temperature", degrees)
        _judge_close(driver, "temperature", degrees, celsius(driver), facts.celsius_gain)


@check("MACS-Q-21-02", "MACS-STATE-04", safety=WORKED, needs=("rig:supply",))
def warnings_follow_the_supply_and_refuse_nothing(session: Session) -> None:
    """dd.6 from 46 V up and dd.5 from 12 V down come and go; motion runs as ever under both."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    driver.rig.begin()
    steps = (24.0, 45.6, 46.4, 45.6, 12.4, 11.5, 12.4)
    fine = (45.8, 46.1, 12.1, 11.85) if driver.session.rig.is_exact else ()
    for volts in (*steps, *fine):
        driver.session.rig.work("supply", volts)
        vv = driver.client.data_bytes(0x27)[1]
        wanted = OVER_VOLTAGE * (vv >= OVER_FROM_VV) | UNDER_VOLTAGE * (vv <= UNDER_TO_VV)
        seen = driver.status.faults()
        if driver.client.data_bytes(0x27)[1] != vv:
            continue  # a supply that swings: not to be judged by one count
        session.expect(
            seen == wanted, "MACS-Q-21-02", f"dd {wanted:02X} at vv {vv:02X}", f"{seen:02X}"
        )
        if wanted:
            _judge_moves(driver)
    start = driver.motion.ready(SLOWEST)
    forecast = driver.motion.go(start + 60)
    driver.session.rig.work("supply", 11.5)
    driver.client.wait(0.1)
    driver.motion.finish(forecast, "MACS-STATE-04")
    driver.session.rig.reset()
    session.expect(
        driver.status.faults() == 0, "MACS-Q-21-02", "dd 00", f"{driver.status.faults():02X}"
    )


def _judge_moves(driver: AxisDriver) -> None:
    """Every kind of motion is accepted and runs to its end."""
    start = driver.client.position()
    way = driver.limits.way_outlasting(20, driver.motion.period, 5)
    for command in driver.rig.motion_commands:
        moving = command.begin(driver.rig, start, way)
        if command.is_endless:
            driver.client.wait(0.02)
            driver.judge.accepted(0x18)
        else:
            driver.motion.finish(moving, "MACS-STATE-04")
        driver.motion.finish(driver.motion.go(start), "MACS-STATE-04")
    for index in (0x19, 0x17, 0x18, 0x1A):
        driver.judge.accepted(index, requirement="MACS-STATE-04")


@check("MACS-Q-21-03", "MACS-STATE-04", safety=WORKED, needs=("rig:supply",))
def an_over_voltage_is_remembered(session: Session) -> None:
    """hh tells a past over-voltage until 00h; it locks nothing and no motion clears it."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    start = driver.rig.begin()
    driver.rig.restart()
    idle = driver.status.memories()  # all its bits but one mean nothing, and need not be 0
    driver.session.rig.work("supply", 11.5)
    hh = driver.status.memories()
    session.expect(hh == idle, "MACS-Q-21-03", f"hh {idle:02X}: too little is not remembered", hh)
    driver.session.rig.work("supply", 46.4)
    if not driver.status.faults() & OVER_VOLTAGE:
        session.inconclusive(None, "the rig's supply did not reach 46 V")
    driver.session.rig.work("supply", 24.0)
    judge_memory(driver, idle)
    driver.motion.finish(driver.motion.go(start + 20), "MACS-STATE-04")
    for index in (0x18, 0x1A, 0x19):
        driver.judge.accepted(index, requirement="MACS-Q-21-03")
    judge_memory(driver, idle)
    driver.rig.restart()
    hh = driver.status.memories()
    session.expect(hh == idle, "MACS-Q-21-03", f"hh {idle:02X} after 00h", f"{hh:02X}")


def judge_memory(driver: AxisDriver, idle: int) -> None:
    """hh tells it by its bit 7, or by all the others (MACS-AMB-13)."""
    hh = driver.status.memories() ^ idle
    release = driver.client.value(0x24)
    if hh == 0 and release < FIRST_WITH_MEMORY:
        driver.session.skip(f"release {release:08X} may be older than 7.4, which brought this bit")
    outcome: int | str = {0x80: 0, 0x7F: 1}.get(hh, f"hh changed in {hh:02X} by an over-voltage")
    if hh & idle:
        outcome = f"hh {idle:02X} before any over-voltage, {hh ^ idle:02X} after it"
    driver.judge.reading("status_hh_bit", outcome, "MACS-Q-21-03")


@check("MACS-Q-21-02", "MACS-Q-27-01", safety=WORKED, needs=("rig:temperature",))
def the_thermal_fault_begins_above_85_degrees(session: Session) -> None:
    """dd.4 is set from the first count above 85 °C on, and stays when it is cooler again."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    driver.rig.begin()
    is_hot = False
    for degrees in (80.0, 85.0, 87.5, 80.0) if driver.session.rig.is_exact else (75.0, 95.0, 75.0):
        driver.session.rig.work("temperature", degrees)
        tt = driver.client.data_bytes(0x27)[0]
        is_hot = is_hot or tt >= TRIPS_FROM_TT
        wanted = 0x10 if is_hot else 0
        seen = driver.status.faults()
        session.expect(
            seen == wanted, "MACS-Q-21-02", f"dd {wanted:02X} at tt {tt:02X}", f"{seen:02X}"
        )
        _judge_close(driver, "temperature", degrees, celsius(driver), 2.5)
    driver.session.rig.reset()
    driver.client.command(0x00)
    driver.rig.awake()
