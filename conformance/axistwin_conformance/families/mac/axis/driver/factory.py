"""What a factory reset (01h) does to the parameters of an axis, whichever way it is told."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS

# §5.10; only the address, the rate and the tolerance are the manual's, the rest is the ledger's.
FACTORY_ANSWERS: Final = {0x22: 0x3FFFFFFF, 0x23: 0xC0000000, 0x25: 0x05000320, 0x26: 0x0A601000}
# Two rows of settings of which no value is a factory's, nor one of the other row.
FOREIGN_SETTINGS: Final = (
    ((0x02, 0), (0x03, 9), (0x09, 1000), (0x0A, -1000), (0x0C, 0x22), (0x0D, 0x0777),
     (0x0E, 0x2200), (0x0F, 0x22), (0x1C, 0x22)),
    ((0x02, 1), (0x03, 8), (0x09, 2000), (0x0A, -2000), (0x0C, 0x33), (0x0D, 0x0888),
     (0x0E, 0x3300), (0x0F, 0x33), (0x1C, 0x33)),
)  # fmt: skip


def answers(driver: AxisDriver) -> dict[int, int]:
    """What the queries say that tell of parameters."""
    return {index: driver.client.value(index) for index in FACTORY_ANSWERS}


def overwrite(driver: AxisDriver, row: int) -> dict[int, int]:
    """Set everything to the values of a row of `FOREIGN_SETTINGS`; what the queries then say."""
    for index, parameter in FOREIGN_SETTINGS[row]:
        driver.client.command(index, parameter)
    return answers(driver)


def judge_values(driver: AxisDriver, changed: dict[int, int]) -> None:
    """Judge that everything was overwritten, with values that can be a factory's."""
    session, found = driver.session, answers(driver)
    words = ", ".join(f"{index:02X}h {value:08X}" for index, value in found.items())
    for index, value in found.items():
        session.expect(
            value != changed[index], "MACS-CMD-01-01", f"{index:02X}h overwritten", f"{value:08X}"
        )
    tolerance = PARAMETERS[0x1C].read(found[0x26])
    session.expect(tolerance == 0, "MACS-CMD-1C-01", "tolerance 0", tolerance)
    imax, limit = driver.client.imax, PARAMETERS[0x0C].read(found[0x26])
    session.expect(limit <= imax, "MACS-CMD-01-01", f"torque 00..{imax:02X}", f"{limit:02X}")
    session.info("MACS-CMD-01-01", f"factory values: {words}")


def judge_again(driver: AxisDriver, reset: Callable[[], object]) -> None:
    """From other values a second reset must come to the same: what it does not write shows."""
    session, found = driver.session, answers(driver)
    for index, value in overwrite(driver, 1).items():
        session.step(
            value != found[index], f"{index:02X}h other than {found[index]:08X}", f"{value:08X}"
        )
    reset()
    for index, value in found.items():
        again = driver.client.value(index)
        session.expect(
            again == value, "MACS-CMD-01-01", f"{index:02X}h {value:08X} again", f"{again:08X}"
        )
