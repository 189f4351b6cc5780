"""Which readings a module follows in what can make it unreachable: address, rate, factory reset.

Each puts back at once what it changed, alone on the line.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S, SLOWEST
from axistwin_conformance.families.mac.axis.exchanges import Kind
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
from axistwin_conformance.families.mac.serial.driver import Bench
from axistwin_conformance.families.mac.serial.probes.line import answers_to_all

ORDER = 120  # of this module in a run; see `Family.modules`

DESTRUCTIVE: Final = ("motion", "stored", "destructive")
FACTORY_BAUD: Final = 38400
ALONE: Final = ("alone",)


@probe(safety=DESTRUCTIVE, needs=ALONE)
def addr_effective(bench: Bench) -> Outcome:
    """08h to FF, then 20h at the new address, before and after 00h."""
    new = other_address(bench)
    with brought_back(bench):
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
    with brought_back(bench):
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
    with brought_back(bench):
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
    if not has_rate(bench):
        bench.session.skip("a plain socket carries bytes, not a rate")
    value = next(one for one, rate in RATES.items() if rate != bench.target.baud)
    with brought_back(bench, is_readdressed=False):
        kind = bench.send(bench.request(0x1B, value), QUIET_S * 2).kind
        bench.wait_awake()
        bench.target.baud = RATES[value]
    return 0 if kind is Kind.ACCEPTED else 1  # at the new rate we hear garbage, or nothing


@probe(safety=DESTRUCTIVE, needs=ALONE)
def factory_reset_scope(bench: Bench) -> Outcome:
    """20h at once after 01h: deaf, as after 00h, or not."""
    with brought_back(bench):
        bench.send(bench.request(0x01), QUIET_S * 2)
        bench.address, bench.target.baud = 0, FACTORY_BAUD
        is_deaf = bench.send(bench.request(0x20), QUIET_S).kind is Kind.SILENCE
        bench.wait_awake()
    return int(not is_deaf)
