"""Which readings a module follows in what it says of errors: with a software stop, and with a rig.

A message that comes when something is done may be a lifebeat.  An upload just before keeps that
10 s away, except on a module whose lifebeat runs freely: so each thing is done twice, within less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cmp_to_key
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probes.rig import TOO_MUCH_VOLTS
from axistwin_conformance.families.mac.axis.probes.running_on import travel_guard
from axistwin_conformance.families.mac.axis.probes.stops import rest
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.families.mac.can.probes.messages import (
    LATE_S,
    LIFEBEAT_S,
    lifebeat,
    longest_boot_s,
    payload_readings,
    speaks,
    spontaneous_messages,
)
from axistwin_conformance.transport.rig import Rig

ORDER = 100  # of this module in a run; see `Family.modules`

BEYOND: Final = 60  # increments, of which a stop lets 10 pass
SHOWS_S: Final = 0.2
ALL_BYTES: Final = "FFFFFFFFh"
TOO_HOT_CELSIUS: Final = 95.0
TOO_FEW_VOLTS: Final = 10.0
WORKED: Final = ("motion", "rig")
TIMES: Final = 2

# Bits of dd, in the order of priority that the standard's codes have by default (MACC-EMCY-04).
HOT, CUT, OVER, UNDER = 0x10, 0x01, 0x40, 0x20
BEGIN: Final[dict[int, Callable[[Rig], object]]] = {
    HOT: lambda rig: rig.work("temperature", TOO_HOT_CELSIUS),
    CUT: lambda rig: (rig.work("micro_cut", True), rig.work("micro_cut", False)),
    OVER: lambda rig: rig.work("supply", TOO_MUCH_VOLTS),
    UNDER: lambda rig: rig.work("supply", TOO_FEW_VOLTS),
}
NOT_TOGETHER: Final = {OVER, UNDER}


# --- with a software stop ------------------------------------------------------------------------


@contextmanager
def stopped_beyond(driver: CanDriver) -> Iterator[None]:
    """A move that a software stop ends, and the stops off again."""
    start = travel_guard(driver, 10)
    driver.judge.accepted(0x13, start + BEYOND)
    rest(driver)
    yield
    driver.motion.at_rest()
    driver.judge.accepted(0x03, 0)


@probe(safety=MOVES, switch="emcy_payload")
def emcy_payload_of_a_stopped_axis(driver: CanDriver) -> Outcome:
    """The lifebeat beside 2001h while ff shows a stop."""
    with stopped_beyond(driver):
        status = bytes(driver.client.data_bytes(0x21))
        message = lifebeat(driver)
    if not status[1]:
        driver.session.skip("2001h shows no stop, and so is all zeros")
    return 3 if message is None else payload_readings(message, status)


@probe(safety=MOVES)
def emcy_trigger_mask(driver: CanDriver) -> Outcome:
    """A software stop tripped, twice: whether the module speaks at once."""
    speaks(driver)
    spoke = set()
    for _ in range(TIMES):
        driver.client.target.take_spontaneous()
        with stopped_beyond(driver):
            spoke.add(bool(spontaneous_messages(driver, 0)))
    return Measured(ALL_BYTES) if spoke == {True} else 0


# --- with a rig ----------------------------------------------------------------------------------


def speaks_when(driver: CanDriver, act: Callable[[Rig], object]) -> bool:
    """Whether the module says something when that is done."""
    since_ns = driver.client.ask(0x20).taken.earliest_ns
    driver.client.target.take_spontaneous()
    act(driver.session.rig)
    messages = spontaneous_messages(driver, SHOWS_S + driver.client.target.uncertainty_ns / 1e9)
    if driver.client.target.now_ns - since_ns > (LIFEBEAT_S - LATE_S) * 1e9:
        driver.session.skip("the rig took so long that it may have been a lifebeat")
    return bool(messages)


@probe(safety=WORKED, needs=("rig:supply",))
def emcy_on_clear(driver: CanDriver) -> Outcome:
    """Over-voltage that comes and goes, twice: when the module speaks."""
    speaks(driver)
    driver.motion.at_rest()
    comes, goes = set(), set()
    for _ in range(TIMES):
        comes.add(speaks_when(driver, BEGIN[OVER]))
        goes.add(speaks_when(driver, lambda rig: rig.reset()))
    driver.motion.reinitialise()  # 2001h remembers the over-voltage
    if comes != {True}:
        return "nothing is said of an over-voltage"
    return int(goes != {True})


@probe(safety=WORKED, needs=("rig:supply", "rig:temperature", "rig:micro_cut"))
def emcy_code_map(driver: CanDriver) -> Outcome:
    """Code and register of each error of 2001h; of two at once, where the rig is exact."""
    speaks(driver)
    if driver.session.reading("emcy_payload") == "status_first":
        driver.session.skip("its messages carry no code")
    codes = {bit: code for bit in BEGIN if any(code := _code_of(driver, bit))}

    def precedes(switch: int, other: int) -> int:
        if {switch, other} == NOT_TOGETHER or not driver.session.rig.is_exact:
            return 0
        seen = _code_of(driver, switch, other)
        return (seen == codes[other]) - (seen == codes[switch])

    order = sorted(codes, key=cmp_to_key(precedes))
    if tuple((bit, *codes[bit]) for bit in order) == codec.ERROR_CODES:
        return 0
    described = [f"{bit:02X}/{codes[bit][0]:04X}/{codes[bit][1]:02X}" for bit in order]
    return Measured(",".join(described)) if described else "no error has a code"


def _code_of(driver: CanDriver, *bits: int) -> tuple[int, int]:
    """Code and register that the module tells while these errors are there."""
    driver.motion.at_rest()
    driver.client.target.take_spontaneous()
    for bit in bits:
        BEGIN[bit](driver.session.rig)
    messages = spontaneous_messages(driver, SHOWS_S + driver.client.target.uncertainty_ns / 1e9)
    faults = driver.client.data_bytes(0x21)[0]
    message = messages[-1] if messages else lifebeat(driver)
    driver.session.rig.reset()
    driver.motion.reinitialise()
    if faults & (HOT | CUT | OVER | UNDER) != sum(bits):
        driver.session.skip(f"2001h shows {faults:02X} instead of {sum(bits):02X}")
    data = b"" if message is None else message.frame.data
    return int.from_bytes(data[:2], "little"), int.from_bytes(data[2:3], "big")


@probe(safety=WORKED, needs=("rig:temperature",))
def fault_ack_while_present(driver: CanDriver) -> Outcome:
    """2000h while it is too hot."""
    driver.motion.at_rest()
    BEGIN[HOT](driver.session.rig)
    driver.client.wait(SHOWS_S)
    is_hot = bool(driver.client.data_bytes(0x21)[0] & HOT)
    driver.client.target.take_spontaneous()
    kind = driver.client.within(QUIET_S, 0x00).kind
    is_restarted = (
        kind is not ReplyKind.REFUSED and driver.client.boot_up(longest_boot_s(driver)) is not None
    )
    driver.session.rig.reset()
    driver.motion.reinitialise()
    if not is_hot:
        driver.session.skip("2001h shows no fault")
    if kind is ReplyKind.REFUSED:
        return 1
    return 0 if is_restarted else f"{kind.value}, and no boot-up message"
