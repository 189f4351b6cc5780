"""Address, baud rate and factory reset: what can make a module unreachable comes last, with the
module alone on the line, and is put back at once (CMD-01, CMD-08, CMD-1B)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver import factory
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, AxisExchange
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.serial.address_recovery import (
    RATES,
    answers,
    brought_back,
    has_rate,
    other_address,
    program_address,
)
from axistwin_conformance.families.mac.serial.codec import GENERAL_ADDRESS, SerialRequest
from axistwin_conformance.families.mac.serial.driver import SerialDriver
from axistwin_conformance.families.mac.serial.probes.destructive import DESTRUCTIVE, FACTORY_BAUD

ORDER = 270  # of this module in a run; see `Family.modules`

OTHER_RATE: Final = 0x02  # of 1Bh: not the factory's
ASIDE: Final = 25  # increments
MODES: Final = (0x02, 0x03, 0x1C)  # whether they are stored is open (MACS-AMB-24)
NEW_ADDRESSES: Final = (0x2A, 0x7F, 0x01)


@check(
    "MACS-CMD-08-01", "MACS-CMD-08-02", "MACS-REPLY-04", "MACS-REPLY-08",
    safety=DESTRUCTIVE, needs=("alone",),
)  # fmt: skip
def the_address_can_be_programmed(session: Session) -> None:
    """08h to FF gives the only module a new address, which its answers tell, from the next frame
    on, and for good; not under a wrong checksum."""
    driver = SerialDriver(session)
    with brought_back(driver):
        new = next(one for one in NEW_ADDRESSES if one != driver.client.address)
        _nacked_in_vain(driver, driver.client.to_all(0x08, new))
        for new in NEW_ADDRESSES:
            old = driver.client.address
            if new == old:
                continue
            kind = program_address(driver, new)
            session.expect(
                kind in (ReplyKind.ACCEPTED, ReplyKind.SILENCE),
                "MACS-CMD-08-01",
                ["accepted", "silence"],
                kind.value,
            )
            _judge_echo(driver, new)
            if not answers(driver, new):
                driver.client.send(driver.client.request(0x00), QUIET_S)
                driver.motion.wait_awake()
                outcome: int | str = 1 if answers(driver, new) else "never"
                driver.judge.reading(
                    "addr_effective", outcome, ("MACS-CMD-08-01", "MACS-CMD-08-02")
                )
            else:
                driver.judge.reading("addr_effective", 0, "MACS-CMD-08-02")
            driver.client.address = new
            session.expect(
                not answers(driver, old), "MACS-CMD-08-01", f"silence at {old:02X}", "an answer"
            )
        driver.client.command(0x00)
        driver.motion.wait_awake()
        session.expect(
            answers(driver, driver.client.address),
            "MACS-CMD-08-02",
            f"still at {driver.client.address:02X} after 00h",
            "silence",
        )


def _judge_echo(driver: SerialDriver, address: int) -> None:
    """Who answers at an address, tells that address."""
    query = driver.client.request(0x20, address=address)
    # As bytes: it is nobody's whom this client talks to, and no noise if it does not answer.
    reply = driver.client.send(query.encode(), QUIET_S * 2).reply
    if reply.kind is ReplyKind.ANSWER:
        wanted, seen = f"address {address:02X} in the answer", f"address {reply.address:02X}"
        driver.session.expect(reply.address == address, "MACS-REPLY-08", wanted, seen)


@check("MACS-CMD-08-03", "MACS-CMD-08-01", safety=DESTRUCTIVE, needs=("alone",))
def addresses_from_80_up_are_refused(session: Session) -> None:
    """08h with 80h..FFh is refused and the address kept, or only its low bits count."""
    driver = SerialDriver(session)
    for new in (0x80, 0xAA, 0xFE, 0xFF):
        with brought_back(driver):
            kind = program_address(driver, new)
            outcome: int | str = f"{kind.value} to address {new:02X}"
            if answers(driver, driver.client.address):
                if kind in (ReplyKind.REFUSED, ReplyKind.SILENCE):
                    outcome = 0
                elif (
                    new & 0x7F == driver.client.address
                    or driver.readings.known("addr_effective") == 1
                ):
                    outcome = 1
            elif answers(driver, new & 0x7F):
                outcome = 1
            driver.judge.reading("addr_range", outcome, "MACS-CMD-08-03")
    with brought_back(driver):
        kind = program_address(driver, 0x11, to=driver.client.address)
        is_obeyed = answers(driver, 0x11)
        outcome = {(ReplyKind.ACCEPTED, True): 0, (ReplyKind.REFUSED, False): 1}.get(
            (kind, is_obeyed), f"{kind.value} to 08h at its own address"
        )
        if kind is ReplyKind.ACCEPTED and not is_obeyed and session.readings.get("addr_effective"):
            outcome = 0
        driver.judge.reading("addr_prog_requires_ff", outcome, "MACS-CMD-08-01")


@check("MACS-FRAME-13", "MACS-CMD-08-03", safety=DESTRUCTIVE, needs=("alone",))
def an_address_that_is_no_number_is_refused(session: Session) -> None:
    """08h with a character that is no hex digit in the new address is refused, the address kept."""
    driver = SerialDriver(session)
    for digits in (b"G1", b"1G", b"GG", b" 1", b"+1"):
        with brought_back(driver):
            frame = replace(
                driver.client.request(0x08, address=GENERAL_ADDRESS), parameters=b"000000" + digits
            )
            kind = driver.client.send(frame, QUIET_S * 2).kind
            if kind is ReplyKind.NACK:
                driver.judge.reading("bad_frame_reply", 1, "MACS-FRAME-13")
            is_kept = kind in (ReplyKind.REFUSED, ReplyKind.NACK, ReplyKind.SILENCE) and answers(
                driver, driver.client.address
            )
            session.expect(
                is_kept,
                ("MACS-FRAME-13", "MACS-CMD-08-03"),
                f"refused, still at {driver.client.address:02X}",
                kind.value,
            )


@check(
    "MACS-CMD-1B-01", "MACS-CMD-XX-02", "MACS-LINE-01", "MACS-Q-20-02", "MACS-REPLY-04",
    "MACS-REPLY-05", safety=DESTRUCTIVE, needs=("alone",),
)  # fmt: skip
def the_rate_can_be_programmed(session: Session) -> None:
    """1Bh sets 9600, 19200, 38400 baud; the module restarts, then talks the new rate only, and has
    kept what it had; refused or Nacked it does nothing."""
    driver = SerialDriver(session)
    if not has_rate(driver):
        session.skip("a plain socket carries bytes, not a rate")
    start = driver.motion.ready()
    driver.motion.finish(driver.motion.go(start + (ASIDE if start != -ASIDE else 2 * ASIDE)))
    before, place = driver.client.parameters(), driver.client.position()
    _nacked_in_vain(driver, driver.client.request(0x1B, OTHER_RATE))
    for value in (0x00, 0x04, 0xFF):
        with brought_back(driver, is_readdressed=False):
            kind = driver.client.command(0x1B, value).kind
            policy = driver.readings.known("param_range_policy")
            if kind is not ReplyKind.REFUSED:
                driver.motion.wait_awake()  # it may have taken it for another value
                driver.judge.reading("param_range_policy", max(1, policy), "MACS-CMD-XX-02")
            else:
                _undisturbed(driver, ("MACS-CMD-XX-02", "MACS-REPLY-05"), f"1Bh {value:02X}")
            # Masked, a value may still be none of the three, and then is refused all the same.
            session.expect(True, "MACS-CMD-XX-02", "", "")
    with brought_back(driver, is_readdressed=False):
        for value in RATES:
            _judge_rate(driver, value)
            _judge_kept(driver, place, before)
    driver.judge.alive("MACS-LINE-01")


def _judge_kept(driver: SerialDriver, place: int, before: Mapping[int, int]) -> None:
    """Judge that the restart of 1Bh, as any, keeps the position and the parameters."""
    found, names = driver.client.position(), ("MACS-CMD-1B-01", "MACS-Q-20-02")
    driver.session.expect(found == place, names, f"position {place} kept over 1Bh", found)
    after = driver.client.parameters()
    for index in before.keys() - set(MODES):
        wanted = f"{driver.client.named(index)} {before[index]:X}h kept over 1Bh"
        is_kept = after[index] == before[index]
        driver.session.expect(is_kept, "MACS-CMD-1B-01", wanted, f"{after[index]:X}h")


def _nacked_in_vain(driver: SerialDriver, request: SerialRequest) -> None:
    """Send a frame under a wrong checksum, after which the module is where it was."""
    driver.client.send(request.with_wrong_checksum(), QUIET_S * 2)
    _undisturbed(driver, ("MACS-REPLY-04",), f"{request.index.decode()}h under a wrong checksum")


def _undisturbed(driver: SerialDriver, requirements: tuple[str, ...], what: str) -> None:
    """Judge that the module answers at once where it did."""
    is_there = answers(driver, driver.client.address)
    driver.session.expect(is_there, requirements, f"an answer to 20h after {what}", "silence")


def _judge_rate(driver: SerialDriver, value: int) -> None:
    """Change the rate, judge the reply, the deafness and the new rate."""
    session, rate, old = driver.session, RATES[value], driver.client.target.baud
    exchange = driver.client.send(driver.client.request(0x1B, value), QUIET_S * 2)
    if exchange.kind is ReplyKind.REFUSED:
        driver.judge.reading("cmd_1b_supported", 1, "MACS-CMD-1B-01")
        return
    driver.judge.reading("cmd_1b_supported", 0, "MACS-CMD-1B-01")
    if rate != old:
        outcome = 0 if exchange.kind is ReplyKind.ACCEPTED else 1  # at the new rate we hear garbage
        driver.judge.reading("baud_reply_rate", outcome, "MACS-CMD-1B-01")
    driver.client.target.baud = rate
    _judge_still_deaf(driver, exchange, "MACS-CMD-1B-01")
    driver.motion.wait_awake()
    driver.judge.alive("MACS-CMD-1B-01")
    if rate != old:
        driver.client.target.baud = old
        at_old = driver.client.send(driver.client.request(0x20), QUIET_S * 2).kind
        driver.client.target.baud = rate
        session.expect(
            at_old is not ReplyKind.ANSWER,
            "MACS-CMD-1B-01",
            f"no answer at {old} baud, the rate before",
            at_old.value,
        )
        driver.client.wait(QUIET_S)


@check(
    "MACS-CMD-01-01",
    "MACS-CMD-01-02",
    "MACS-CMD-01-03",
    "MACS-CMD-1C-01",
    "MACS-REPLY-04",
    safety=DESTRUCTIVE,
    needs=("alone",),
)
def a_factory_reset_brings_the_factory_values(session: Session) -> None:
    """01h writes the factory values over all parameters, deaf for 2 s; address 00, 38400 baud."""
    driver = SerialDriver(session)
    place = driver.motion.finish(driver.motion.go(driver.motion.ready() + 25))
    changed = factory.overwrite(driver, 0)
    with brought_back(driver):
        _nacked_in_vain(driver, driver.client.request(0x01))
        _move_away(driver)
        exchange = driver.client.send(driver.client.request(0x01), QUIET_S * 2)
        replies = {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}
        outcome: int | str = replies.get(exchange.kind, f"{exchange.kind.value} to 01h")
        driver.judge.reading("reset_reply", outcome, "MACS-CMD-01-01")
        driver.client.address, session.target.baud = 0, FACTORY_BAUD
        is_deaf = driver.client.send(driver.client.request(0x20), QUIET_S).kind is ReplyKind.SILENCE
        if is_deaf:  # deaf at all is deaf as long as after 00h
            _judge_still_deaf(driver, exchange, "MACS-CMD-01-03")
        driver.motion.wait_awake()
        driver.judge.alive("MACS-CMD-01-02")
        driver.judge.reading("factory_reset_scope", int(not is_deaf), "MACS-CMD-01-03")
        factory.judge_values(driver, changed)
        factory.judge_again(driver, lambda: _reset(driver))
        kept = driver.client.position()
        session.expect(kept == place, "MACS-CMD-01-01", f"position {place} kept", kept)


def _judge_still_deaf(driver: SerialDriver, restart: AxisExchange, requirement: str) -> None:
    """A query just before a restarted module may listen again gets no reply; nothing is asked where
    the module is so slow that a query could come too late."""
    query_s = 2 * QUIET_S + driver.session.target.line_s
    until_ns = restart.taken.earliest_ns + round((driver.motion.deaf_surely_s - query_s) * 1e9)
    if driver.client.target.now_ns > until_ns:
        return
    driver.client.wait_until(until_ns)
    late = driver.client.send(driver.client.request(0x20), QUIET_S)
    driver.judge.must(ReplyKind.SILENCE, late, requirement)


def _move_away(driver: SerialDriver) -> None:
    """Give the module another address and rate, so that 01h has something to undo, as far as it
    takes them."""
    own, new, own_baud = driver.client.address, other_address(driver), driver.client.target.baud
    program_address(driver, new)
    if has_rate(driver):
        driver.client.address = new if answers(driver, new) else own
        driver.client.send(driver.client.request(0x1B, OTHER_RATE), QUIET_S * 2)
        driver.motion.wait_awake()
    _find(driver, (new, own), (RATES[OTHER_RATE], own_baud))


def _find(driver: SerialDriver, addresses: Sequence[int], rates: Sequence[int]) -> None:
    """Talk to the module as it answers; as at the end of the lists if it does not."""
    for rate in rates:
        driver.client.target.baud = rate
        for address in addresses:
            driver.client.address = address
            if answers(driver, address):
                return


def _reset(driver: SerialDriver) -> None:
    driver.client.send(driver.client.request(0x01), QUIET_S * 2)
    driver.motion.wait_awake()
