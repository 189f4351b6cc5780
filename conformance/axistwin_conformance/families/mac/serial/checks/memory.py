"""The memory that 28h and 29h show (Q-28, Q-29)."""

from __future__ import annotations

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.facts import facts_of
from axistwin_conformance.families.mac.serial.codec import IMAX_ADDRESS
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.probes.line import imax_value, mem_wrap

ORDER = 90  # of this module in a run; see `Family.modules`


@check("MACS-Q-28-01")
def ram_is_read_from_the_sub_index_upward(session: Session) -> None:
    """28h gives four bytes from address ss: windows that overlap agree; AFh holds Imax."""
    driver = SerialDriver(session)
    _windows_agree(driver, 0x28)
    seen = mem_wrap.look(session)
    if seen.readings:  # zeros on both sides of the end tell nothing
        session.quirk(None, "mem_wrap", seen.readings)
    imax = driver.client.data_bytes(0x28, IMAX_ADDRESS)[0]
    expected = facts_of(session).imax
    if expected is None:
        session.info(None, f"Imax {imax:02X}h")
        session.expect(imax > 0, None, "an Imax above 0", imax)
        return
    driver.judge.again(imax_value)
    session.expect(imax > 0, None, "an Imax above 0", imax)


@check("MACS-Q-29-01")
def eeprom_is_read_from_the_sub_index_upward(session: Session) -> None:
    """29h gives four bytes from address ss: windows that overlap agree."""
    _windows_agree(SerialDriver(session), 0x29)


def _windows_agree(driver: SerialDriver, index: int) -> None:
    """Read the same bytes through shifted windows.  RAM lives, so a byte that differs is read
    again: it is wrong only if it never comes out the same."""
    for first in (0x00, 0x01, 0x40, IMAX_ADDRESS - 3, 0xF8):
        for shift in (1, 2, 3):
            for _ in range(3):
                low, high = (
                    driver.client.data_bytes(index, first),
                    driver.client.data_bytes(index, first + shift),
                )
                if low[shift:] == high[: 4 - shift]:
                    break
            driver.session.expect(
                low[shift:] == high[: 4 - shift],
                None,
                f"{index:02X}h {first + shift:02X} to begin with {bytes(low[shift:]).hex()}",
                bytes(high).hex(),
            )
