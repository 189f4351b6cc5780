"""Address, baud rate and factory reset: what can make a module unreachable comes last, with the
module alone on the line, and is put back at once (CMD-01, CMD-08, CMD-1B)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver import factory
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S
from axistwin_conformance.families.mac.axis.exchanges import Kind
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
from axistwin_conformance.families.mac.serial.probes.destructive import DESTRUCTIVE, FACTORY_BAUD

ORDER = 270  # of this module in a run; see `Family.modules`

OTHER_RATE: Final = 0x02  # of 1Bh: not the factory's
NEW_ADDRESSES: Final = (0x2A, 0x7F, 0x01)


@check("MACS-CMD-08-01", "MACS-CMD-08-02", safety=DESTRUCTIVE, needs=("alone",))
def the_address_can_be_programmed(session: Session) -> None:
    """08h to FF gives the only module a new address, from the next frame on, and for good."""
    bench = Bench(session)
    with brought_back(bench):
        for new in NEW_ADDRESSES:
            old = bench.address
            if new == old:
                continue
            kind = program_address(bench, new)
            session.expect(
                kind in (Kind.ACCEPTED, Kind.SILENCE), "MACS-CMD-08-01",
                ["accepted", "silence"], kind.value,
            )  # fmt: skip
            if not answers(bench, new):
                bench.send(bench.request(0x00), QUIET_S)
                bench.wait_awake()
                outcome: int | str = 1 if answers(bench, new) else "never"
                bench.reading("addr_effective", outcome, ("MACS-CMD-08-01", "MACS-CMD-08-02"))
            else:
                bench.reading("addr_effective", 0, "MACS-CMD-08-02")
            bench.address = new
            session.expect(
                not answers(bench, old), "MACS-CMD-08-01", f"silence at {old:02X}", "an answer"
            )
        bench.command(0x00)
        bench.wait_awake()
        session.expect(
            answers(bench, bench.address), "MACS-CMD-08-02",
            f"still at {bench.address:02X} after 00h", "silence",
        )  # fmt: skip


@check("MACS-CMD-08-03", "MACS-CMD-08-01", safety=DESTRUCTIVE, needs=("alone",))
def addresses_from_80_up_are_refused(session: Session) -> None:
    """08h with 80h..FFh is refused and the address kept, or only its low bits count."""
    bench = Bench(session)
    for new in (0x80, 0xAA, 0xFE, 0xFF):
        with brought_back(bench):
            kind = program_address(bench, new)
            outcome: int | str = f"{kind.value} to address {new:02X}"
            if answers(bench, bench.address):
                if kind in (Kind.REFUSED, Kind.SILENCE):
                    outcome = 0
                elif new & 0x7F == bench.address or bench.known("addr_effective") == 1:
                    outcome = 1
            elif answers(bench, new & 0x7F):
                outcome = 1
            bench.reading("addr_range", outcome, "MACS-CMD-08-03")
    with brought_back(bench):
        kind = program_address(bench, 0x11, to=bench.address)
        is_obeyed = answers(bench, 0x11)
        outcome = {(Kind.ACCEPTED, True): 0, (Kind.REFUSED, False): 1}.get(
            (kind, is_obeyed), f"{kind.value} to 08h at its own address"
        )
        if kind is Kind.ACCEPTED and not is_obeyed and session.readings.get("addr_effective"):
            outcome = 0
        bench.reading("addr_prog_requires_ff", outcome, "MACS-CMD-08-01")


@check("MACS-FRAME-13", "MACS-CMD-08-03", safety=DESTRUCTIVE, needs=("alone",))
def an_address_that_is_no_number_is_refused(session: Session) -> None:
    """08h with a character that is no hex digit in the new address is refused, the address kept."""
    bench = Bench(session)
    for digits in (b"G1", b"1G", b"GG", b" 1", b"+1"):
        with brought_back(bench):
            frame = replace(
                bench.request(0x08, address=GENERAL_ADDRESS), parameters=b"000000" + digits
            )
            kind = bench.send(frame, QUIET_S * 2).kind
            if kind is Kind.NACK:
                bench.reading("bad_frame_reply", 1, "MACS-FRAME-13")
            is_kept = kind in (Kind.REFUSED, Kind.NACK, Kind.SILENCE) and answers(
                bench, bench.address
            )
            session.expect(
                is_kept, ("MACS-FRAME-13", "MACS-CMD-08-03"),
                f"refused, still at {bench.address:02X}", kind.value,
            )  # fmt: skip


@check("MACS-CMD-1B-01", "MACS-CMD-XX-02", "MACS-LINE-01", safety=DESTRUCTIVE, needs=("alone",))
def the_rate_can_be_programmed(session: Session) -> None:
    """1Bh sets 9600, 19200, 38400 baud; the module restarts, then talks the new rate only."""
    bench = Bench(session)
    if not has_rate(bench):
        session.skip("a plain socket carries bytes, not a rate")
    for value in (0x00, 0x04, 0xFF):
        with brought_back(bench, is_readdressed=False):
            kind = bench.command(0x1B, value).kind
            policy = bench.known("param_range_policy")
            if kind is not Kind.REFUSED:
                bench.wait_awake()  # it may have taken it for another value
                bench.reading("param_range_policy", max(1, policy), "MACS-CMD-XX-02")
            # Masked, a value may still be none of the three, and then is refused all the same.
            session.expect(True, "MACS-CMD-XX-02", "", "")
    with brought_back(bench, is_readdressed=False):
        for value in RATES:
            _judge_rate(bench, value)
    bench.alive("MACS-LINE-01")


def _judge_rate(bench: Bench, value: int) -> None:
    """Change the rate, judge the reply, the deafness and the new rate."""
    session, rate, old = bench.session, RATES[value], bench.target.baud
    exchange = bench.send(bench.request(0x1B, value), QUIET_S * 2)
    if exchange.kind is Kind.REFUSED:
        bench.reading("cmd_1b_supported", 1, "MACS-CMD-1B-01")
        return
    bench.reading("cmd_1b_supported", 0, "MACS-CMD-1B-01")
    if rate != old:
        outcome = 0 if exchange.kind is Kind.ACCEPTED else 1  # at the new rate we hear garbage
        bench.reading("baud_reply_rate", outcome, "MACS-CMD-1B-01")
    bench.target.baud = rate
    bench.wait(bench.deaf_surely_s - QUIET_S * 4)
    early = bench.send(bench.request(0x20), QUIET_S)
    bench.must(Kind.SILENCE, early, "MACS-CMD-1B-01")
    bench.wait(bench.awake_surely_s - bench.deaf_surely_s + QUIET_S)
    bench.alive("MACS-CMD-1B-01")
    if rate != old:
        bench.target.baud = old
        at_old = bench.send(bench.request(0x20), QUIET_S * 2).kind
        bench.target.baud = rate
        session.expect(
            at_old is not Kind.ANSWER, "MACS-CMD-1B-01", f"no answer at {old}", at_old.value
        )
        bench.wait(QUIET_S)


@check("MACS-CMD-01-01", "MACS-CMD-01-02", "MACS-CMD-01-03", "MACS-CMD-1C-01",
       safety=DESTRUCTIVE, needs=("alone",))  # fmt: skip
def a_factory_reset_brings_the_factory_values(session: Session) -> None:
    """01h writes the factory values over all parameters, deaf for 2 s; address 00, 38400 baud."""
    bench = Bench(session)
    place = bench.finish(bench.go(bench.ready() + 25))
    changed = factory.spoil(bench, 0)
    with brought_back(bench):
        _move_away(bench)
        exchange = bench.send(bench.request(0x01), QUIET_S * 2)
        replies = {Kind.ACCEPTED: 0, Kind.SILENCE: 1}
        outcome: int | str = replies.get(exchange.kind, f"{exchange.kind.value} to 01h")
        bench.reading("reset_reply", outcome, "MACS-CMD-01-01")
        bench.address, session.target.baud = 0, FACTORY_BAUD
        is_deaf = bench.send(bench.request(0x20), QUIET_S).kind is Kind.SILENCE
        bench.wait(bench.deaf_surely_s - QUIET_S * 5)
        if is_deaf:  # deaf at all is deaf as long as after 00h
            late = bench.send(bench.request(0x20), QUIET_S)
            bench.must(Kind.SILENCE, late, "MACS-CMD-01-03")
        bench.wait(bench.awake_surely_s - bench.deaf_surely_s + QUIET_S * 5)
        bench.alive("MACS-CMD-01-02")
        bench.reading("factory_reset_scope", int(not is_deaf), "MACS-CMD-01-03")
        factory.judge_values(bench, changed)
        factory.judge_again(bench, lambda: _reset(bench))
        kept = bench.position()
        session.expect(kept == place, "MACS-CMD-01-01", f"position {place} kept", kept)


def _move_away(bench: Bench) -> None:
    """Give the module another address and rate, so that 01h has something to undo, as far as it
    takes them."""
    own, new, own_baud = bench.address, other_address(bench), bench.target.baud
    program_address(bench, new)
    if has_rate(bench):
        bench.address = new if answers(bench, new) else own
        bench.send(bench.request(0x1B, OTHER_RATE), QUIET_S * 2)
        bench.wait_awake()
    _find(bench, (new, own), (RATES[OTHER_RATE], own_baud))


def _find(bench: Bench, addresses: Sequence[int], rates: Sequence[int]) -> None:
    """Talk to the module as it answers; as at the end of the lists if it does not."""
    for rate in rates:
        bench.target.baud = rate
        for address in addresses:
            bench.address = address
            if answers(bench, address):
                return


def _reset(bench: Bench) -> None:
    bench.send(bench.request(0x01), QUIET_S * 2)
    bench.wait_awake()
