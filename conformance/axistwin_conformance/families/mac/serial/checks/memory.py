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
    _is_same_behind(driver, 0x28, IMAX_ADDRESS, 0x29)
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
    """29h gives the four bytes from ss on, whatever was read before; windows that overlap agree."""
    driver = SerialDriver(session)
    _windows_agree(driver, 0x29)
    for first in (0x00, 0x40, IMAX_ADDRESS):
        for other in (0x28, 0x20):
            _is_same_behind(driver, 0x29, first, other)


def _is_same_behind(driver: SerialDriver, index: int, first: int, other: int) -> None:
    """A query to the other memory, or to none, makes no difference to the next one.  What lives is
    read again."""
    for _ in range(3):
        before = driver.client.data_bytes(index, first)
        driver.client.ask(other, first if other == 0x28 or other == 0x29 else 0)
        after = driver.client.data_bytes(index, first)
        if before[0] == after[0] and (index == 0x28 or before == after):
            break
    driver.session.expect(
        before[0] == after[0] and (index == 0x28 or before == after),
        None,
        f"{index:02X}h {first:02X} as before {other:02X}h: {bytes(before).hex()}",
        bytes(after).hex(),
    )


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
