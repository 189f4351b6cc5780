"""What the address procedure leaves as it is, and what stores no address (LMT, PERS, Q-00)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver import factory
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.boot_up import restart
from axistwin_conformance.families.mac.can.checks.lmt import (
    NEW_ADDRESSES,
    serves_meanwhile,
    stays,
    take_address,
)
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.destructive import (
    ALONE,
    DESTRUCTIVE,
    LMT_STORE,
    address_put_back,
    answers,
    configure,
    give_address,
)

ORDER = 295  # of this module in a run; see `Family.modules`

AWAY: Final = 25  # increments, so that the counter is not 0
MODES: Final = 0x0000FFFF  # K, m and TT of 2006h: whether they are stored is open (MACS-AMB-24)


@check(
    "MACC-Q-00-01", "MACC-PERS-01", "MACC-PERS-02", "MACC-LMT-03", safety=DESTRUCTIVE, needs=ALONE
)
def the_address_procedure_changes_the_address_alone(session: Session) -> None:
    """Position, parameters and modes are what they were before the procedure."""
    driver = CanDriver(session)
    driver.motion.finish(driver.motion.go(driver.motion.ready() + AWAY))
    before = factory.overwrite(driver, 0)
    place = driver.client.position()
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        give_address(driver, new)
        driver.client.address = new
        wanted = f"an answer at address {new}"
        session.expect(answers(driver, new), "MACC-LMT-03", wanted, "silence")
        kept, after = driver.client.position(), factory.answers(driver)
        session.expect(kept == place, "MACC-Q-00-01", f"position {place}", kept)
        words = [
            " ".join(f"{value & ~(MODES if index == 0x26 else 0):08X}" for index, value in one)
            for one in (before.items(), after.items())
        ]
        session.expect(words[0] == words[1], "MACC-PERS-01", *words)
        driver.judge.reading("persist_modes", int(before != after), "MACC-PERS-02")


@check("MACC-LMT-03", "MACC-LMT-09", safety=DESTRUCTIVE, needs=ALONE)
def storing_before_the_end_stores_no_address(session: Session) -> None:
    """17h amid the procedure, then a restart: the module has the address it had."""
    driver = CanDriver(session)
    driver.motion.at_rest()
    if not serves_meanwhile(driver) or driver.readings.known("lmt_other"):
        session.skip("it takes no reset meanwhile, or obeys 17h (MACC-AMB-11, -12)")
    new = next(address for address in NEW_ADDRESSES if address != driver.client.address)
    with address_put_back(driver):
        configure(driver, codec.lmt_enter())
        take_address(driver, codec.lmt_address(new), "MACC-LMT-03")
        configure(driver, codec.lmt(LMT_STORE))
        names = ("MACC-LMT-03", "MACC-LMT-09")
        wanted = f"a boot-up message from {driver.client.address}"
        session.expect(restart(driver).boot_up is not None, names, wanted, "none")
        stays(driver, "MACC-LMT-03", new)
