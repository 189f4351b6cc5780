"""Software stops whatever their numbers are: at 0, of either sign, in either order; with a
tolerance (CMD-09, CMD-0A, STOP-03)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.stops import (
    BOTH_SIDES,
    FAR,
    PERIOD,
    SIDES,
    SoftwareStop,
    enable_stop,
    judge_bits,
    rest_place,
)
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 162  # of this module in a run; see `Family.modules`

BEFORE: Final = 20  # increments from where a motion begins to the stop
BEYOND: Final = 60  # from there to its target
ASIDE: Final = 45  # from 0
TOLERANCE: Final = 40


def _judge_met(
    driver: AxisDriver, side: SoftwareStop, stop: int, what: str, least: int = 0
) -> None:
    """A move beyond a stop ends on it, or right beyond; `least`: how far it may end before it."""
    requirement = side.requirements
    driver.judge.accepted(0x13, stop + BEYOND * side.direction, requirement=requirement)
    beyond = (rest_place(driver) - stop) * side.direction
    most = 1 + driver.limits.braking(driver.motion.period)
    driver.session.expect(
        -least <= beyond <= most,
        requirement,
        f"at rest {-least}..{most} increments beyond {side.index:02X}h = {stop}, {what}",
        beyond,
    )


@check(*BOTH_SIDES, safety=MOVES, level="full")
def a_software_stop_may_be_any_number(session: Session) -> None:
    """A stop at 0, a superior one below 0 and an inferior one above 0 end a motion as any other."""
    driver = driver_of(session)
    if abs(driver.motion.ready(PERIOD)) > driver.limits.room():
        session.skip("position 0 is outside the envelope")
    for side, stop in ((SIDES[0], 0), (SIDES[0], -ASIDE), (SIDES[1], 0), (SIDES[1], ASIDE)):
        driver.motion.set_plain(PERIOD)
        driver.motion.finish(driver.motion.go(stop - BEFORE * side.direction))
        driver.judge.accepted(side.index, stop)
        driver.motion.keep_off(SIDES[side is SIDES[0]].index, stop - side.direction * FAR)
        driver.judge.accepted(0x03, 8)
        _judge_met(driver, side, stop, "03h = 8")
        if driver.readings.known("ff_lifetime") != 2:  # that of the motion before stays there
            judge_bits(driver, side, "only")
        driver.judge.accepted(0x03, 0)


@check(*BOTH_SIDES, safety=MOVES, level="full")
def nothing_else_shifts_a_software_stop(session: Session) -> None:
    """A tolerance leaves a stop where it is, and so does the other one, wherever that is: each is
    looked at in its own direction, the superior one below the inferior one as well."""
    driver = driver_of(session)
    for side in SIDES:
        start = enable_stop(driver, side, BEFORE)
        if driver.client.command(0x1C, TOLERANCE).kind is ReplyKind.ACCEPTED:
            _judge_met(driver, side, start + BEFORE * side.direction, f"1Ch = {TOLERANCE}")
        driver.judge.accepted(0x03, 0)
    for side, other in (SIDES, SIDES[::-1]):
        start = enable_stop(driver, side, BEFORE)
        far = start + (BEFORE + BEYOND // 2) * side.direction
        driver.judge.accepted(other.index, far)
        # A device on which a stop blocks both directions does not even begin (MACS-AMB-48).
        least = BEFORE if driver.readings.known("soft_stop_blocks") else 0
        words = f"{other.index:02X}h = {far}"
        _judge_met(driver, side, start + BEFORE * side.direction, words, least)
        driver.judge.accepted(0x03, 0)
