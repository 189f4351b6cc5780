"""Whether a module goes on with what it does, and keeps what it was told, while nobody speaks to it
(CMD-10, CMD-15)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import velocity
from axistwin_conformance.families.mac.axis.probes.sync import is_held
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 175  # of this module in a run; see `Family.modules`

ALONE_S: Final = 31.0  # what ends by itself does so after half a minute at most
LEAST_S: Final = 11.0  # where the axis may not go so far
STANDS_S: Final = 0.1
SPARE_S: Final = 1.5  # of exchanges before and after it


@check("MACS-CMD-15-01", "MACS-CMD-10-01", safety=MOVES, level="full")
def neither_motion_nor_arm_ends_while_nobody_speaks(session: Session) -> None:
    """Endless motion goes on through half a minute without a request, and 10h given at its
    beginning still holds the motion behind it back."""
    driver = driver_of(session)
    seconds = _alone_s(driver)
    # What becomes of the arm when 15h with 0000 ends the motion, the device shows without a pause.
    is_kept = _left_alone(driver, 0.2, is_armed=driver.readings.known("sync_arm_lifetime") != 1)
    held = _left_alone(driver, seconds, is_armed=is_kept)
    if not is_kept:
        session.not_run("MACS-CMD-10-01", "10h in motion holds nothing back on this device")
        return
    wanted = f"13h held until 11h, {seconds:.0f} s after 10h as right behind it"
    session.expect(held, "MACS-CMD-10-01", wanted, "it moved at once")


def _alone_s(driver: AxisDriver) -> float:
    """How long the axis may go on at the slowest speed, ALONE_S at most; leaves the check where
    that is less than LEAST_S."""
    if not driver.session.envelope.is_guarded:
        return ALONE_S
    seconds = min(ALONE_S, driver.motion.lasting_s(driver.limits.room(), SLOWEST) - SPARE_S)
    if seconds < LEAST_S:
        driver.limits.gentle(SLOWEST, LEAST_S + 2 * SPARE_S)
    return max(seconds, LEAST_S)


def _left_alone(driver: AxisDriver, seconds: float, *, is_armed: bool) -> bool:
    """Turn for so long, and judge that; whether 10h given before then holds a 13h back."""
    driver.motion.ready(SLOWEST)
    forecast = driver.motion.turn(1, SLOWEST)
    if is_armed:
        driver.judge.accepted(0x10)
    driver.client.wait(seconds)
    for _ in range(2):
        driver.motion.follow(forecast, "MACS-CMD-15-01", driver.limits.allowance(SLOWEST))
        driver.client.wait(0.1)
    if not is_armed:
        driver.motion.at_rest()
        return False
    driver.judge.accepted(0x15, velocity(1, 0))
    driver.client.wait(STANDS_S)  # the increment that has begun is made
    driver.motion.run_out()
    place = driver.client.position()
    is_standing = is_held(driver, place)
    if is_standing:
        driver.judge.accepted(0x13, place + 40)
    is_kept = is_standing and is_held(driver, place)
    driver.motion.disarm()
    return is_kept
