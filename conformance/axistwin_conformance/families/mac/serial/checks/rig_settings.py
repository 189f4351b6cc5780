"""What re-addressing and another rate leave behind without a supply (PERS-01, PERS-02)."""

from __future__ import annotations

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.rig_power import POWER
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.rig import OFF_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.serial.address_recovery import (
    brought_back,
    has_rate,
    other_address,
    program_address,
)
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.probes.destructive import DESTRUCTIVE, FACTORY_BAUD

ORDER = 260  # of this module in a run; see `Family.modules`


@check("MACS-PERS-01", "MACS-CMD-1B-01", safety=(*DESTRUCTIVE, "rig"), needs=("alone", *POWER))
def the_rate_outlives_the_supply(session: Session) -> None:
    """The rate of 1Bh is kept over power-off."""
    driver = SerialDriver(session)
    if not has_rate(driver):
        session.skip("a plain socket carries bytes, not a rate")
    driver.rig.begin()
    rate, value = (
        (9600, 0x01) if driver.client.target.baud == FACTORY_BAUD else (FACTORY_BAUD, 0x03)
    )
    with brought_back(driver, is_readdressed=False):
        if (
            driver.client.send(driver.client.request(0x1B, value), QUIET_S * 2).kind
            is ReplyKind.REFUSED
        ):
            driver.judge.reading("cmd_1b_supported", 1, "MACS-CMD-1B-01")
            session.not_run("MACS-PERS-01", "the rate cannot be changed on this device")
            return
        driver.client.target.baud = rate
        driver.motion.wait_awake()
        driver.judge.alive("MACS-CMD-1B-01")
        driver.rig.power_cycle()
        session.expect(
            driver.client.ask(0x20).kind is ReplyKind.ANSWER,
            "MACS-PERS-01",
            f"an answer at {rate}",
            "silence",
        )


@check("MACS-PERS-02", "MACS-CMD-08-02", safety=(*DESTRUCTIVE, "rig"), needs=("alone", *POWER))
def the_address_outlives_the_supply(session: Session) -> None:
    """The address of 08h is kept over power-off."""
    driver = SerialDriver(session)
    driver.rig.begin()
    new = other_address(driver)
    with brought_back(driver):
        program_address(driver, new)
        driver.session.rig.work("power", False)
        driver.client.wait(OFF_S)
        driver.session.rig.work("power", True)
        driver.motion.wait_awake()
        driver.client.address = new
        driver.judge.alive(("MACS-PERS-02", "MACS-CMD-08-02"))
