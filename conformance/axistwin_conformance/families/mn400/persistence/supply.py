"""The supply of a board, switched by a rig."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.families.mn400.driver import BoardDriver

OFF_S: Final = 0.5
START_S: Final = 10.0  # within which a board serves
POLL_S: Final = 0.2


def switch_on(driver: BoardDriver) -> int:
    """Switch the supply off and, after a while, on; what the board then says is not read yet.
    Before when it was off (ns)."""
    driver.session.rig.work("power", False)
    driver.target.wait(OFF_S)
    driver.target.drain()
    before_ns, _ = driver.session.rig.work("power", True)
    return before_ns


def power_cycle(driver: BoardDriver) -> None:
    """Switch the supply off and on, and go on once the board answers at its present id and rate."""
    switch_on(driver)
    driver.session.step(serves_again(driver), "a board that answers after power-up", "it does not")


def serves_again(driver: BoardDriver) -> bool:
    """Wait until the board answers after power-up; False if it does not within 10 s."""
    deadline_ns = driver.target.now_ns + round(START_S * 1e9)
    while not driver.is_found(most=1):
        if driver.target.now_ns >= deadline_ns:
            return False
        driver.target.wait(POLL_S)
    driver.target.drain()
    return True
