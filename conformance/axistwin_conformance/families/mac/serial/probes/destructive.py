"""Which readings a module follows in what can make it unreachable: address, rate, factory reset.

Each puts back at once what it changed, alone on the line.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, reply_of
from axistwin_conformance.families.mac.serial.address_recovery import (
    RATES,
    answers,
    brought_back,
    has_rate,
    other_address,
    program_address,
)
from axistwin_conformance.families.mac.serial.codec import GENERAL_ADDRESS
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.probes.line import answers_to_all

ORDER = 120  # of this module in a run; see `Family.modules`

DESTRUCTIVE: Final = ("motion", "stored", "destructive")
FACTORY_BAUD: Final = 38400
ALONE: Final = ("alone",)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_effective(driver: SerialDriver) -> Outcome:
    """08h to FF, then 20h at the new address, before and after 00h."""
    new = other_address(driver)
    with brought_back(driver):
        program_address(driver, new)
        if answers(driver, new):
            driver.client.address = new
            return 0
        driver.client.send(driver.client.request(0x00), QUIET_S)
        driver.motion.wait_awake()
        is_there = answers(driver, new)
        driver.client.address = new if is_there else driver.client.address
        return 1 if is_there else "the new address never answers"


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_prog_requires_ff(driver: SerialDriver) -> Outcome:
    """08h to the module's own address, with that very address."""
    kind = program_address(driver, driver.client.address, to=driver.client.address)
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE, switch="general_reply_policy")
def general_reply_of_a_lone_module(driver: SerialDriver) -> Outcome:
    """20h to FF while the module, alone, has another address than 00."""
    new = other_address(driver)
    with brought_back(driver):
        program_address(driver, new)
        if driver.readings.known("addr_effective") == 1:
            driver.client.send(driver.client.request(0x00), QUIET_S)
            driver.motion.wait_awake()
        if not answers(driver, new):
            driver.session.skip("it cannot be given another address")
        driver.client.address = new
        kind, _ = answers_to_all(driver)
    return (1, 3) if kind is ReplyKind.ANSWER else (0, 2)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_range(driver: SerialDriver) -> Outcome:
    """08h to FF with AAh, then 20h at AAh and at 2Ah; after 00h if that is when it takes."""
    new = 0xAA if driver.client.address != 0x2A else 0x95
    with brought_back(driver):
        kind = program_address(driver, new)
        if driver.readings.known("addr_effective") == 1:
            driver.client.send(driver.client.request(0x00), QUIET_S)
            driver.motion.wait_awake()
        if answers(driver, driver.client.address):
            return 0
        is_masked = answers(driver, new & 0x7F)
        driver.client.address = new & 0x7F if is_masked else driver.client.address
        return 1 if is_masked else f"{kind.value}, and no answer any more"


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lock_08_1b(driver: SerialDriver) -> Outcome:
    """08h with the present address during a slow move."""
    start = driver.motion.ready(SLOWEST)
    to = (
        GENERAL_ADDRESS if driver.readings.known("addr_prog_requires_ff") else driver.client.address
    )
    driver.judge.accepted(0x13, start + 100)
    kind = program_address(driver, driver.client.address, to)
    driver.motion.at_rest()
    if kind is ReplyKind.SILENCE and to == GENERAL_ADDRESS:
        driver.session.skip("it keeps silent to general frames, and takes 08h by no other")
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def cmd_1b_supported(driver: SerialDriver) -> Outcome:
    """1Bh with the present rate."""
    value = next(code for code, rate in RATES.items() if rate == driver.client.target.baud)
    kind = driver.client.send(driver.client.request(0x1B, value), QUIET_S * 2).kind
    driver.motion.wait_awake()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def baud_reply_rate(driver: SerialDriver) -> Outcome:
    """1Bh with another rate: whether its reply can be read at the old one."""
    if driver.readings.known("cmd_1b_supported"):
        driver.session.skip("this device has no 1Bh")
    if not has_rate(driver):
        driver.session.skip("a plain socket carries bytes, not a rate")
    value = next(code for code, rate in RATES.items() if rate != driver.client.target.baud)
    with brought_back(driver, is_readdressed=False):
        kind = driver.client.send(driver.client.request(0x1B, value), QUIET_S * 2).kind
        driver.motion.wait_awake()
        driver.client.target.baud = RATES[value]
    return 0 if kind is ReplyKind.ACCEPTED else 1  # at the new rate we hear garbage, or nothing


@probe(safety=DESTRUCTIVE, needs=ALONE)
def factory_reset_scope(driver: SerialDriver) -> Outcome:
    """20h at once after 01h: deaf, as after 00h, or not."""
    with brought_back(driver):
        driver.client.send(driver.client.request(0x01), QUIET_S * 2)
        driver.client.address, driver.client.target.baud = 0, FACTORY_BAUD
        is_deaf = driver.client.send(driver.client.request(0x20), QUIET_S).kind is ReplyKind.SILENCE
        driver.motion.wait_awake()
    return int(not is_deaf)
