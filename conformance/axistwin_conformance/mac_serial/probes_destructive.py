"""Which readings a module follows in what can make it unreachable: address, rate, factory reset.

Each puts back at once what it changed, alone on the line.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.mac_axis.bench import QUIET_S, SLOWEST
from axistwin_conformance.mac_axis.dialogue import Kind
from axistwin_conformance.mac_axis.probing import ACCEPTED_OR_REFUSED, reply_of
from axistwin_conformance.mac_serial.bench import Bench
from axistwin_conformance.mac_serial.codec import GENERAL_ADDRESS
from axistwin_conformance.mac_serial.probes import answers_to_all
from axistwin_conformance.probing import Outcome, probe
from axistwin_conformance.profile import Probe

DESTRUCTIVE: Final = ("motion", "stored", "destructive")
FACTORY_BAUD: Final = 38400
RATES: Final = {0x01: 9600, 0x02: 19200, 0x03: 38400}
ALONE: Final = ("alone",)


def program_address(bench: Bench, new: int, to: int = GENERAL_ADDRESS) -> Kind:
    """Send 08h; a module that is not 00 may obey without a word (§6)."""
    return bench.send(bench.request(0x08, new, address=to), QUIET_S * 2).kind


def answers(bench: Bench, address: int) -> bool:
    """True if somebody answers at that address."""
    exchange = bench.send(bench.request(0x20, address=address), QUIET_S * 2)
    return exchange.kind is Kind.ANSWER and exchange.reply.address == address


@contextmanager
def address_put_back(bench: Bench) -> Iterator[None]:
    """Bring the module back to the address it had, whatever was done to it meanwhile."""
    own = bench.address
    try:
        yield
    finally:
        bench.wait(QUIET_S)
        if bench.known("addr_effective") == 1 and answers(bench, own):
            program_address(bench, own)  # or the next restart brings the other address
        elif not answers(bench, own):
            program_address(bench, own)
            bench.send(bench.request(0x00, address=own), QUIET_S)  # if it takes a restart
            bench.send(bench.request(0x00, address=bench.address), QUIET_S)
            bench.wait_awake()
        bench.address = own


def other_address(bench: Bench) -> int:
    """An address that the module does not have."""
    return 0x2A if bench.address != 0x2A else 0x15


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_effective(bench: Bench) -> Outcome:
    """08h to FF, then 20h at the new address, before and after 00h."""
    new = other_address(bench)
    with address_put_back(bench):
        program_address(bench, new)
        if answers(bench, new):
            bench.address = new
            return 0
        bench.send(bench.request(0x00), QUIET_S)
        bench.wait_awake()
        is_there = answers(bench, new)
        bench.address = new if is_there else bench.address
        return 1 if is_there else "the new address never answers"


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_prog_requires_ff(bench: Bench) -> Outcome:
    """08h to the module's own address, with that very address."""
    kind = program_address(bench, bench.address, to=bench.address)
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE, switch="general_reply_policy")
def general_reply_of_a_lone_module(bench: Bench) -> Outcome:
    """20h to FF while the module, alone, has another address than 00."""
    new = other_address(bench)
    with address_put_back(bench):
        program_address(bench, new)
        if bench.known("addr_effective") == 1:
            bench.send(bench.request(0x00), QUIET_S)
            bench.wait_awake()
        if not answers(bench, new):
            bench.session.skip("it cannot be given another address")
        bench.address = new
        kind, _ = answers_to_all(bench)
    return (1, 3) if kind is Kind.ANSWER else (0, 2)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_range(bench: Bench) -> Outcome:
    """08h to FF with AAh, then 20h at AAh and at 2Ah; after 00h if that is when it takes."""
    new = 0xAA if bench.address != 0x2A else 0x95
    with address_put_back(bench):
        kind = program_address(bench, new)
        if bench.known("addr_effective") == 1:
            bench.send(bench.request(0x00), QUIET_S)
            bench.wait_awake()
        if answers(bench, bench.address):
            return 0
        is_masked = answers(bench, new & 0x7F)
        bench.address = new & 0x7F if is_masked else bench.address
        return 1 if is_masked else f"{kind.value}, and no answer any more"


@probe(safety=DESTRUCTIVE, needs=ALONE)
def lock_08_1b(bench: Bench) -> Outcome:
    """08h with the present address during a slow move."""
    start = bench.ready(SLOWEST)
    to = GENERAL_ADDRESS if bench.known("addr_prog_requires_ff") else bench.address
    bench.accepted(0x13, start + 100)
    kind = program_address(bench, bench.address, to)
    bench.at_rest()
    if kind is Kind.SILENCE and to == GENERAL_ADDRESS:
        bench.session.skip("it keeps silent to general frames, and takes 08h by no other")
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def cmd_1b_supported(bench: Bench) -> Outcome:
    """1Bh with the present rate."""
    value = next(one for one, rate in RATES.items() if rate == bench.target.baud)
    kind = bench.send(bench.request(0x1B, value), QUIET_S * 2).kind
    bench.wait_awake()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def baud_reply_rate(bench: Bench) -> Outcome:
    """1Bh with another rate: whether its reply can be read at the old one."""
    if bench.known("cmd_1b_supported"):
        bench.session.skip("this device has no 1Bh")
    if bench.target.description.startswith("socket:"):
        bench.session.skip("a plain socket carries bytes, not a rate")
    own = bench.target.baud
    value = next(one for one, rate in RATES.items() if rate != own)
    kind = bench.send(bench.request(0x1B, value), QUIET_S * 2).kind
    bench.wait_awake()
    set_rate(bench, RATES[value], own)
    return 0 if kind is Kind.ACCEPTED else 1  # at the new rate we hear garbage, or nothing


def set_rate(bench: Bench, now: int, wanted: int) -> None:
    """Bring module and host to a rate, whatever rate the module talks."""
    value = next(one for one, rate in RATES.items() if rate == wanted)
    for rate in (now, *RATES.values()):
        bench.target.baud = rate
        bench.send(bench.request(0x1B, value), QUIET_S * 2)
        bench.wait_awake()
        bench.target.baud = wanted
        if bench.ask(0x20).kind is Kind.ANSWER:
            return


@probe(safety=DESTRUCTIVE, needs=ALONE)
def factory_reset_scope(bench: Bench) -> Outcome:
    """20h at once after 01h: deaf, as after 00h, or not."""
    with address_put_back(bench):
        own_baud = bench.target.baud
        bench.send(bench.request(0x01), QUIET_S * 2)
        bench.address = 0
        bench.target.baud = FACTORY_BAUD
        is_deaf = bench.send(bench.request(0x20), QUIET_S).kind is Kind.SILENCE
        bench.wait_awake()
        if own_baud != FACTORY_BAUD:
            set_rate(bench, FACTORY_BAUD, own_baud)
    return int(not is_deaf)


PROBES: Final = tuple(one for one in vars().values() if isinstance(one, Probe))
