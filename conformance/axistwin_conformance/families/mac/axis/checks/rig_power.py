"""What outlives the supply and what does not (PERS-01 to -03, Q-20-02, CMD-07-02, REPLY-12)."""

from __future__ import annotations

from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.checks.rig_faults import (
    MICRO_CUT,
    NO_THRESHOLDS,
    is_mac23,
    judge_memory,
)
from axistwin_conformance.families.mac.axis.checks.rig_inputs import judge_no_edge
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.motion import PRELOAD_SHOWS_S, segment_parameter
from axistwin_conformance.families.mac.axis.driver.rig import OVER_VOLTAGE, WORKED
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS, settings_of
from axistwin_conformance.families.mac.axis.words import NAMES

ORDER = 250  # of this module in a run; see `Family.modules`

POWER: Final = ("rig:power",)
LISTEN_S: Final = 3.0
STORING_S: Final = 0.5  # from the last Ack to the cut: no manual says that Ack means stored

# What is stored for certain: the index of the command, and a value.
STORED: Final = {
    0x09: 0x00012345,
    0x0A: 0xFFFABCDF,
    0x0C: 0x2B,
    0x0D: 0x0ABC,
    0x0E: 0x1D,
    0x0F: 0x37,
}
# The superior stop below the inferior one, and all ones, as an erased cell has them.
EDGES: Final = {0x09: 0xFFFFFFFF, 0x0A: 0x0100, 0x0C: 0x7F, 0x0D: 0xFFFF, 0x0E: 0xFF, 0x0F: 0xFF}
SET_IN_MOTION: Final = {0x0C: 0x2A, 0x0E: 0x1C}  # what no motion locks
NEAR_ZERO: Final = 100  # increments from where a place of either sign is gone to
MODES: Final[tuple[tuple[int, int], ...]] = (
    (0x02, 0),
    (0x03, 9),
    (0x1C, 0x21),
)
# A field that is lost comes up at the factory value, which may be one of those (§5.10).
OTHER_MODES: Final[tuple[tuple[int, int], ...]] = ((0x02, 1), (0x03, 1), (0x1C, 0x12))
MODE_FIELDS: Final = {0x02: 0xF000, 0x03: 0x0F00, 0x1C: 0x00FF}  # of km dd of 26h


@check("MACS-Q-20-02", "MACS-PERS-01", "MACS-PERS-03", safety=WORKED, needs=POWER)
def the_position_outlives_the_supply(session: Session) -> None:
    """An axis that was not moved meanwhile is where it was, on either side of 0; nothing of its
    motion is left."""
    driver = driver_of(session)
    kept = ("MACS-Q-20-02", "MACS-PERS-01")
    for distance in (33, -57):
        start = driver.rig.begin()
        is_near = abs(start) <= NEAR_ZERO and driver.limits.fits(distance)
        place = driver.motion.finish(driver.motion.go(distance if is_near else start + distance))
        driver.rig.power_cycle()
        session.expect(
            driver.client.position() == place, kept, f"position {place}", driver.client.position()
        )
        again = driver.rig.rest()
        session.expect(again == place, "MACS-PERS-03", "at rest", again)


@check("MACS-Q-20-02", "MACS-PERS-03", "MACS-REPLY-12", safety=WORKED, needs=POWER)
def a_power_cut_ends_a_motion_for_good(session: Session) -> None:
    """Cut in motion, the position is where the axis then was; nothing resumes, nothing is said."""
    driver = driver_of(session)
    for command in driver.rig.motion_commands:
        # Nothing tells the envelope that an endless motion has ended with the supply.
        slow = (
            driver.limits.gentle(driver.rig.slow_period, driver.rig.away_s + LISTEN_S)
            if command.is_endless
            else None
        )
        start = driver.rig.begin(slow)
        moving = command.begin(driver.rig, start, driver.rig.reach)
        driver.client.wait(0.08)
        cut = driver.rig.power_cycle("MACS-PERS-03")
        driver.rig.in_time(moving, cut)
        place = driver.rig.rest()
        driver.rig.judge_place(place, moving.halted(cut), 1, "MACS-Q-20-02", coasts=True)
        driver.client.unasked()
        driver.client.wait(LISTEN_S)
        if session.transport.is_virtual:  # a supply that is switched may put noise on a real line
            received = driver.client.unasked()
            session.expect(not received, "MACS-REPLY-12", "not a byte", received)
        driver.motion.finish(driver.motion.go(start), "MACS-PERS-03")
    if not session.transport.is_virtual:
        session.not_run("MACS-REPLY-12", "switching the supply may put noise on the line")


def _kept_seen(index: int, stored: int, seen: int) -> Observation:
    """What a parameter was after a power cycle, in words."""
    known = PARAMETERS[index]
    return Observation(
        f"after a power cycle, begun {STORING_S * 1000:.0f} ms after the last setting was accepted,"
        f" {REQUEST} showed the {NAMES[known.name]} {known.taken(seen)}",
        value=str(seen),
        wanted=f"{known.taken(stored)}, as set by {index:02X}h before it",
        causes=(f"{index:02X}h (",),
    )


@check("MACS-PERS-01", safety=WORKED, needs=POWER)
def parameters_outlive_the_supply(session: Session) -> None:
    """Software stops, torque limit, speeds and ramp are the same after a power cycle, whatever they
    are, and when they were set in motion."""
    driver = driver_of(session)
    driver.rig.begin()
    for values in (STORED, EDGES, SET_IN_MOTION):
        if values is SET_IN_MOTION:
            driver.rig.begin()
            driver.motion.put(driver.limits.segment(40, driver.motion.period, moves=False))
        settings = settings_of(values, values)
        for index, parameter in settings.items():
            driver.judge.accepted(index, parameter)
        driver.client.wait(STORING_S)
        driver.rig.power_cycle()
        for index, parameter in settings.items():
            seen = PARAMETERS[index].parameter(driver.client.parameter(index))
            session.expect(
                seen == parameter,
                None,
                f"{parameter} as {index:02X}h has stored it before the cut",
                partial(_kept_seen, index, parameter, seen),
            )


def _is_settable(driver: AxisDriver, index: int) -> bool:
    return index != 0x1C or driver.rig.has_tolerance()


@check("MACS-PERS-02", safety=WORKED, needs=POWER)
def modes_outlive_the_supply_or_all_do_not(session: Session) -> None:
    """02h, 03h and 1Ch are all kept over power-off, or all lost."""
    driver = driver_of(session)
    driver.rig.begin()
    fields = [MODE_FIELDS[index] for index in MODE_FIELDS if _is_settable(driver, index)]
    kept, told = set(fields), []
    for modes in (MODES, OTHER_MODES):
        for index, parameter in modes:
            if MODE_FIELDS[index] in fields:
                driver.judge.accepted(index, parameter)
        before = driver.client.value(0x26) & 0xFFFF
        driver.rig.power_cycle()
        after = driver.client.value(0x26) & 0xFFFF
        told.append(f"{before:04X}, then {after:04X}")
        kept = {mask for mask in kept if before & mask == after & mask}
        if len(kept) in (0, len(fields)):
            break
    outcome: int | str = f"K, m and TT {'; '.join(told)}"
    if len(kept) in (0, len(fields)):
        outcome = int(not kept)
    driver.judge.reading("persist_modes", outcome)


@check(
    "MACS-PERS-03",
    "MACS-CMD-07-02",
    "MACS-REF-01",
    safety=WORKED,
    needs=("rig:power", "rig:reference"),
)
def the_reference_is_disabled_at_power_up(session: Session) -> None:
    """07h 1 is forgotten without the supply: no edge zeroes afterwards."""
    driver = driver_of(session)
    driver.rig.begin()
    with driver.rig.own_origin() as origin, driver.rig.reference_enabled():
        driver.rig.power_cycle()
        judge_no_edge(driver, origin, "MACS-PERS-03")
        session.expect(True, ("MACS-CMD-07-02", "MACS-REF-01"), "", "")


@check("MACS-PERS-03", safety=WORKED, needs=POWER)
def what_was_armed_is_forgotten_at_power_up(session: Session) -> None:
    """10h, a preloaded move, stored segments and stop bits are gone after a power cycle."""
    driver = driver_of(session)
    start = driver.rig.begin()
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + 50)
    driver.rig.power_cycle()
    driver.client.command(0x11)
    driver.client.wait(PRELOAD_SHOWS_S)
    session.expect(
        driver.client.position() == start, None, "no preloaded move left", driver.client.position()
    )
    driver.judge.accepted(0x10)
    driver.rig.power_cycle()
    driver.motion.finish(driver.motion.go(start + 20))  # not held back: 10h is forgotten
    driver.rig.begin()
    for _ in range(3):
        driver.judge.accepted(0x16, segment_parameter(driver.rig.reach // 3, driver.motion.period))
    driver.rig.power_cycle()
    place = driver.rig.rest()
    driver.judge.accepted(0x16, segment_parameter(5, driver.motion.period))
    again = driver.rig.rest()
    session.expect(again == place + 5, None, f"one segment of 5 from {place}", again)
    start = driver.rig.begin()
    driver.judge.accepted(0x09, start + 10)
    driver.judge.accepted(0x03, 8)
    driver.judge.accepted(0x13, start + 40)
    driver.rig.rest()
    session.expect(driver.status.stopped_on() != 0, None, "a stop bit", "ff 00")
    driver.rig.power_cycle()
    ff = driver.status.stopped_on()
    is_live = (
        driver.readings.known("ff_lifetime") == 1
    )  # beyond the stop the bit is then there again
    session.expect(ff == 0 or is_live, None, "ff 00 after a power cycle", f"{ff:02X}")


@check(
    "MACS-PERS-03",
    "MACS-Q-21-02",
    "MACS-STATE-02",
    safety=WORKED,
    needs=("rig:power", "rig:micro_cut"),
)
def a_latched_fault_ends_with_the_supply(session: Session) -> None:
    """A disjunction whose cause is gone does not outlive a power cycle; motion runs again."""
    driver = driver_of(session)
    start = driver.rig.begin()
    MICRO_CUT.begin(driver.session.rig)
    MICRO_CUT.end(driver.session.rig)
    driver.judge.refused(0x13, start + 5)
    session.expect(
        driver.status.faults() == MICRO_CUT.bit,
        ("MACS-Q-21-02", "MACS-STATE-02"),
        "dd 01",
        f"{driver.status.faults():02X}",
    )
    driver.rig.power_cycle()
    session.expect(
        driver.status.faults() == 0,
        ("MACS-PERS-03", "MACS-Q-21-02"),
        "dd 00 after a power cycle",
        f"{driver.status.faults():02X}",
    )
    driver.motion.finish(driver.motion.go(start + 20), "MACS-STATE-02")


@check("MACS-PERS-03", "MACS-Q-21-03", safety=WORKED, needs=("rig:power", "rig:supply"))
def the_over_voltage_memory_ends_with_the_supply(session: Session) -> None:
    """hh does not outlive a power cycle."""
    if not is_mac23(session):
        session.skip(NO_THRESHOLDS)
    driver = driver_of(session)
    driver.rig.begin()
    driver.rig.restart()
    idle = driver.status.memories()
    driver.session.rig.work("supply", 46.4)
    if not driver.status.faults() & OVER_VOLTAGE:
        session.inconclusive(None, "the rig's supply did not reach 46 V")
    driver.session.rig.work("supply", 24.0)
    judge_memory(driver, idle)
    driver.rig.power_cycle()
    hh = driver.status.memories()
    session.expect(
        hh == idle,
        ("MACS-PERS-03", "MACS-Q-21-03"),
        f"hh {idle:02X} after a power cycle",
        f"{hh:02X}",
    )
