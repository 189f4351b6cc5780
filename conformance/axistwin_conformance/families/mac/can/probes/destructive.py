"""Which readings a module follows in what can make it unreachable: LMT, factory reset.

Each is asked with the module alone on the bus, and ends with the address that it began with.  Given
is the module's own address, or one that cannot be had.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probing import reply_of
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.transport.can_frame import Frame

ORDER = 130  # of this module in a run; see `Family.modules`

DESTRUCTIVE: Final = ("motion", "stored", "destructive")
ALONE: Final = ("alone",)
LMT_STORE: Final = 0x17
LMT_WHO: Final = 0x5E  # of the convention: which address
IMPOSSIBLE: Final = 0xFF  # whoever takes its low seven bits is at 127, and can be found
FACTORY_ADDRESS: Final = 1
TAKEN_OVER: Final = b"\x11\x00\x00"
BAD_ADDRESS: Final = {b"\x11\x01\x00": 0, b"\x11\xff\x00": 1}


def configure(driver: CanDriver, frame: Frame) -> bytes | None:
    """Send an LMT frame; the data of the reply to it, None for silence."""
    driver.client.target.drain()
    driver.client.target.send(frame)
    seconds = QUIET_S * 2 + driver.client.target.uncertainty_ns / 1e9
    arrival = driver.client.target.receive(
        lambda owner: owner.identifier == codec.LMT_REPLY, seconds
    )
    return None if arrival is None else arrival.frame.data


def answers(driver: CanDriver, address: int) -> bool:
    """True if somebody answers at that address."""
    return (
        driver.client.send(driver.client.request(0x20, address=address), QUIET_S * 2).kind
        is ReplyKind.ANSWER
    )


def leave(driver: CanDriver) -> None:
    """Leave configuration mode, and wait out the restart that this may be."""
    configure(driver, codec.lmt_leave())
    driver.motion.wait_awake()


def give_address(driver: CanDriver, address: int) -> None:
    """The whole procedure; with the store that some modules want (MACC-AMB-12)."""
    configure(driver, codec.lmt_enter())
    configure(driver, codec.lmt_address(address))
    if driver.readings.known("lmt_other"):
        configure(driver, codec.lmt(LMT_STORE))
    leave(driver)


@contextmanager
def address_put_back(driver: CanDriver) -> Iterator[None]:
    """Bring the module back to the address it had, whatever was done to it meanwhile; interrupted,
    the device guard does.

    The whole procedure does that from wherever it is: alone on the bus, it obeys it at any address,
    in configuration mode or not.
    """
    own = driver.client.address

    def put_back() -> bool:
        driver.client.address = own
        driver.client.wait(QUIET_S)
        for _ in range(RETRY.recovery):
            give_address(driver, own)
            if answers(driver, own):
                return True
        return False

    with driver.session.restore_on_exit(f"address {own}", put_back):
        yield


@contextmanager
def configuring(driver: CanDriver) -> Iterator[None]:
    """Configuration mode, left whatever happens; the address is then what it was."""
    own = driver.client.address

    def put_back() -> bool:
        leave(driver)
        if not answers(driver, own):
            give_address(driver, own)
        return answers(driver, own)

    with driver.session.restore_on_exit(f"address {own}", put_back):
        configure(driver, codec.lmt_enter())
        yield


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_other(driver: CanDriver) -> Outcome:
    """7E5h 5E, at rest and in configuration mode."""
    driver.motion.at_rest()
    if configure(driver, codec.lmt(LMT_WHO)) is not None:
        return 1
    with configuring(driver):
        reply = configure(driver, codec.lmt(LMT_WHO))
    return int(reply is not None)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_dlc(driver: CanDriver) -> Outcome:
    """The length of the reply to 7E5h 11 and the module's own address."""
    driver.motion.at_rest()
    with configuring(driver):
        reply = configure(driver, codec.lmt_address(driver.client.address))
    return "silence" if reply is None else Measured(str(len(reply)))


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_error_reply(driver: CanDriver) -> Outcome:
    """The reply to 7E5h 11 FF."""
    driver.motion.at_rest()
    with configuring(driver):
        reply = configure(driver, codec.lmt_address(IMPOSSIBLE))
        if reply is not None and reply[:3] == TAKEN_OVER:
            driver.client.within(QUIET_S, 0x00)  # so that it is not kept
            driver.motion.wait_awake()
    if reply is None:
        return 2
    return BAD_ADDRESS.get(reply[:3], f"7E4h {reply.hex(' ').upper()}")


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_incomplete(driver: CanDriver) -> Outcome:
    """7E5h 04 01, then 04 00: whether a boot-up message comes."""
    driver.motion.at_rest()
    with configuring(driver):
        driver.client.target.take_spontaneous()
        configure(driver, codec.lmt_leave())
        message = driver.client.boot_up(driver.motion.awake_surely_s)
    return int(message is not None)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_sdo(driver: CanDriver) -> Outcome:
    """2000h in configuration mode."""
    driver.motion.at_rest()
    with configuring(driver):
        kind = driver.client.within(QUIET_S, 0x20).kind
    return reply_of(kind, {ReplyKind.ANSWER: 0, ReplyKind.SILENCE: 1})


@probe(safety=DESTRUCTIVE, needs=ALONE, switch="factory_reset_scope")
def whether_2001h_restarts(driver: CanDriver) -> Outcome:
    """2001h, then whether a boot-up message comes from address 1."""
    own = driver.client.address
    driver.motion.at_rest()
    with address_put_back(driver):  # which address the next start would bring, is all the same
        driver.client.target.take_spontaneous()
        driver.client.within(QUIET_S, 0x01)
        message = driver.client.boot_up(driver.motion.awake_surely_s, FACTORY_ADDRESS)
        is_there = answers(driver, own) or answers(driver, FACTORY_ADDRESS)
    if not is_there:
        return "neither the old address nor 1 answers"
    return int(message is None)
