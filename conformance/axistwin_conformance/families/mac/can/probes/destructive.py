"""Which readings a module follows in what can make it unreachable: LMT, factory reset.

Each is asked with the module alone on the bus, and ends with the address that it began with.  Given
is the module's own address, or one that cannot be had.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.probing import reply_of
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.driver import Bench
from axistwin_conformance.transport.can_frame import Frame

ORDER = 130  # of this module in a run; see `Family.modules`

DESTRUCTIVE: Final = ("motion", "stored", "destructive")
ALONE: Final = ("alone",)
LMT_STORE: Final = 0x17
LMT_WHO: Final = 0x5E  # of the convention: which address
IMPOSSIBLE: Final = 0xFF  # whoever takes its low seven bits is at 127, and can be found
FACTORY_ADDRESS: Final = 1
TAKEN_OVER: Final = b"\x11\x00\x00"
ATTEMPTS: Final = 3  # to bring the old address back
BAD_ADDRESS: Final = {b"\x11\x01\x00": 0, b"\x11\xff\x00": 1}


def configure(bench: Bench, frame: Frame) -> bytes | None:
    """Send an LMT frame; the data of the reply to it, None for silence."""
    bench.target.drain()
    bench.target.send(frame)
    seconds = QUIET_S * 2 + bench.target.uncertainty_ns / 1e9
    arrival = bench.target.receive(lambda one: one.identifier == codec.LMT_REPLY, seconds)
    return None if arrival is None else arrival.frame.data


def answers(bench: Bench, address: int) -> bool:
    """True if somebody answers at that address."""
    return bench.send(bench.request(0x20, address=address), QUIET_S * 2).kind is Kind.ANSWER


def leave(bench: Bench) -> None:
    """Leave configuration mode, and wait out the restart that this may be."""
    configure(bench, codec.lmt_leave())
    bench.wait_awake()


def give_address(bench: Bench, address: int) -> None:
    """The whole procedure; with the store that some modules want (MACC-AMB-12)."""
    configure(bench, codec.lmt_enter())
    configure(bench, codec.lmt_address(address))
    if bench.known("lmt_other"):
        configure(bench, codec.lmt(LMT_STORE))
    leave(bench)


@contextmanager
def address_put_back(bench: Bench) -> Iterator[None]:
    """Bring the module back to the address it had, whatever was done to it meanwhile; interrupted,
    the device guard does.

    The whole procedure does that from wherever it is: alone on the bus, it obeys it at any address,
    in configuration mode or not.
    """
    own = bench.address

    def put_back() -> bool:
        bench.address = own
        bench.wait(QUIET_S)
        for _ in range(ATTEMPTS):
            give_address(bench, own)
            if answers(bench, own):
                return True
        return False

    with bench.session.restore_on_exit(f"address {own}", put_back):
        yield


@contextmanager
def configuring(bench: Bench) -> Iterator[None]:
    """Configuration mode, left whatever happens; the address is then what it was."""
    own = bench.address

    def put_back() -> bool:
        leave(bench)
        if not answers(bench, own):
            give_address(bench, own)
        return answers(bench, own)

    with bench.session.restore_on_exit(f"address {own}", put_back):
        configure(bench, codec.lmt_enter())
        yield


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_other(bench: Bench) -> Outcome:
    """7E5h 5E, at rest and in configuration mode."""
    bench.at_rest()
    if configure(bench, codec.lmt(LMT_WHO)) is not None:
        return 1
    with configuring(bench):
        reply = configure(bench, codec.lmt(LMT_WHO))
    return int(reply is not None)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_dlc(bench: Bench) -> Outcome:
    """The length of the reply to 7E5h 11 and the module's own address."""
    bench.at_rest()
    with configuring(bench):
        reply = configure(bench, codec.lmt_address(bench.address))
    return "silence" if reply is None else Measured(str(len(reply)))


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_error_reply(bench: Bench) -> Outcome:
    """The reply to 7E5h 11 FF."""
    bench.at_rest()
    with configuring(bench):
        reply = configure(bench, codec.lmt_address(IMPOSSIBLE))
        if reply is not None and reply[:3] == TAKEN_OVER:
            bench.within(QUIET_S, 0x00)  # so that it is not kept
            bench.wait_awake()
    if reply is None:
        return 2
    return BAD_ADDRESS.get(reply[:3], f"7E4h {reply.hex(' ').upper()}")


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_incomplete(bench: Bench) -> Outcome:
    """7E5h 04 01, then 04 00: whether a boot-up message comes."""
    bench.at_rest()
    with configuring(bench):
        bench.target.take_spontaneous()
        configure(bench, codec.lmt_leave())
        message = bench.boot_up(bench.awake_surely_s)
    return int(message is not None)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lmt_sdo(bench: Bench) -> Outcome:
    """2000h in configuration mode."""
    bench.at_rest()
    with configuring(bench):
        kind = bench.within(QUIET_S, 0x20).kind
    return reply_of(kind, {Kind.ANSWER: 0, Kind.SILENCE: 1})


@probe(safety=DESTRUCTIVE, needs=ALONE, switch="factory_reset_scope")
def whether_2001h_restarts(bench: Bench) -> Outcome:
    """2001h, then whether a boot-up message comes from address 1."""
    own = bench.address
    bench.at_rest()
    with address_put_back(bench):  # which address the next start would bring, is all the same
        bench.target.take_spontaneous()
        bench.within(QUIET_S, 0x01)
        message = bench.boot_up(bench.awake_surely_s, FACTORY_ADDRESS)
        is_there = answers(bench, own) or answers(bench, FACTORY_ADDRESS)
    if not is_there:
        return "neither the old address nor 1 answers"
    return int(message is None)
