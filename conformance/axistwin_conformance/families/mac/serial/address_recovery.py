"""Where a module is to be found, its address and its rate, and how it is brought back there.

Whatever may change either works inside `brought_back`, with the module alone on the line: FF then
reaches it at any address (MACS-MULTI-02), so that only its rate has to be searched for.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.family import Violation
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES, ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import GENERAL_ADDRESS
from axistwin_conformance.families.mac.serial.driver import SerialDriver

RATES: Final = {0x01: 9600, 0x02: 19200, 0x03: 38400}  # MACS-CMD-1B-01
ADDRESSES: Final = range(0x80)  # MACS-FRAME-07
LATEST_RECORDS: Final = 200  # more than are made until silence ends a run
LEADING_AWAY: Final = (0x01, 0x08, 0x1B)  # to another address or rate


def answers(driver: SerialDriver, address: int) -> bool:
    """True if somebody answers at that address, asked as often as noise needs; silence there says
    nothing of the line."""
    query = driver.client.request(0x20, address=address).encode()
    target = driver.session.target
    for _ in range(1 if target.is_lossless else driver.session.run.quality.alike_needed):
        exchange = driver.client.send(query, QUIET_S * 2)
        if exchange.kind is ReplyKind.ANSWER and exchange.reply.address == address:
            return True
    return False


def other_address(driver: SerialDriver) -> int:
    """An address that the module does not have."""
    return 0x2A if driver.client.address != 0x2A else 0x15


def program_address(driver: SerialDriver, new: int, to: int = GENERAL_ADDRESS) -> ReplyKind:
    """Send 08h; a module that is not 00 may obey without a word (§6)."""
    return driver.client.send(driver.client.request(0x08, new, address=to), QUIET_S * 2).kind


def has_rate(driver: SerialDriver) -> bool:
    """False behind a plain socket: it carries bytes, not a rate."""
    return not driver.client.target.description.startswith("socket:")


@contextmanager
def brought_back(driver: SerialDriver, *, is_readdressed: bool = True) -> Iterator[None]:
    """Bring the module back to the address and the rate it had, whatever was done to it meanwhile;
    interrupted, the device guard does.  `is_readdressed`: False where only the rate may change."""
    address, baud = driver.client.address, driver.client.target.baud
    what = f"address {address:02X}h" + (f", {baud} baud" if has_rate(driver) else "")
    with driver.session.restore_on_exit(
        what, lambda: _bring_back(driver, address, baud, is_readdressed)
    ):
        yield


def _bring_back(driver: SerialDriver, address: int, baud: int, is_readdressed: bool) -> bool:
    """Bring module and host back to an address and a rate; False if nobody answers there then."""
    driver.client.wait(QUIET_S)
    driver.client.address = address
    # It may be deaf at first, and then, by MACS-AMB-18, take its address only with the next
    # restart.
    for number in range(RETRY.recovery):
        if number > 0:
            _restart_anywhere(driver, baud)
        if _is_found(driver, baud, is_readdressed or number > 0):
            return _reaches_rate(driver, baud)
    driver.client.target.baud = baud
    return False


def _rates(driver: SerialDriver, baud: int) -> tuple[int, ...]:
    """Where to search: at the rate used last, the one it had, any other."""
    current = (driver.client.target.baud, baud)
    return tuple(dict.fromkeys((*current, *RATES.values()) if has_rate(driver) else current[:1]))


def _is_found(driver: SerialDriver, baud: int, is_readdressed: bool) -> bool:
    """Find the rate at which the module answers; it has the address then."""
    for rate in _rates(driver, baud):
        driver.client.target.baud = rate
        if answers(driver, driver.client.address):
            if is_readdressed and driver.session.readings.get("addr_effective") != "at_once":
                program_address(
                    driver, driver.client.address
                )  # or the next restart may bring another one
            return True
        if is_readdressed:
            program_address(driver, driver.client.address)
            if answers(driver, driver.client.address):
                return True
    return False


def _restart_anywhere(driver: SerialDriver, baud: int) -> None:
    """A restart at whatever address and rate, with the address programmed (MACS-AMB-18)."""
    for rate in _rates(driver, baud):
        driver.client.target.baud = rate
        driver.client.send(driver.client.to_all(0x00), QUIET_S)
    driver.motion.wait_awake()


def _reaches_rate(driver: SerialDriver, baud: int) -> bool:
    """Bring module and host, who hear one another, to a rate."""
    current = driver.client.target.baud
    value = next((code for code, rate in RATES.items() if rate == baud), None)
    if current == baud or value is None:
        return current == baud
    driver.client.send(driver.client.request(0x1B, value), QUIET_S * 2)
    driver.motion.wait_awake()
    driver.client.target.baud = baud
    return answers(driver, driver.client.address)


def found_elsewhere(driver: SerialDriver) -> Violation | None:
    """What a module has broken that answers no more, but does at the address, or at the rate, that
    its last command would have set had it been 08h, or 1Bh.  It is not brought back from there:
    that takes what was not allowed."""
    for index, value in _last_commands(driver):
        place = _place_of(driver, value)
        if place and index not in LEADING_AWAY:
            return Violation(
                f"MACS-CMD-{index:02X}-01",
                f"the module where it was, after {index:02X}h",
                f"after {index:02X}h with {value:02X}h nobody answers there, and {place}",
            )
    return None


def _place_of(driver: SerialDriver, value: int) -> str:
    """Where a module answers that this value has led away; empty if none does."""
    target, known = driver.client.target, (driver.client.address, *driver.session.neighbours)
    if value in ADDRESSES and value not in known and answers(driver, value):
        return f"a module answers at address {value:02X}h"
    rate, before = RATES.get(value), target.baud
    if rate in (None, before) or not has_rate(driver):
        return ""
    try:
        target.baud = rate
        is_there = answers(driver, driver.client.address)
    finally:
        target.baud = before
    return f"a module answers at {rate} baud" if is_there else ""


def _last_commands(driver: SerialDriver) -> list[tuple[int, int]]:
    """Index and last byte of each command since the last one that was answered, and of that one."""
    transcript, found = driver.client.target.transcript, list[tuple[int, int]]()
    is_answered = False
    for record in reversed(transcript.since(max(0, transcript.position - LATEST_RECORDS))):
        if record.direction is not Direction.HOST:
            is_answered |= record.direction is Direction.DEVICE
            continue
        digits = record.data[4:18]
        is_whole = len(record.data) == codec.REQUEST_BYTES and set(digits) <= codec.DIGITS
        if is_whole and int(digits[:2], 16) == driver.client.address:
            index = int(digits[2:4], 16)
            if index in COMMAND_NAMES:
                found.append((index, int(digits[-2:], 16)))
                if is_answered:
                    break
        is_answered = False
    return list(dict.fromkeys(found))
