"""What probes of an MSC unit share: replies kept without an answer, refused, or waited for; what an
odd packet draws; measured times as readings."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from axistwin_conformance.core.probing import Measured
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import QUIET_S
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import LIMITS
from axistwin_conformance.families.msc.program import BenchProgram

MS: Final = 1_000_000
LONGEST_S: Final = 61.0  # a time-out of a unit that has not run out by then counts as none
LONGEST_REAL_S: Final = 10.0  # where waiting takes a person's time
MOST_REFUSED: Final = 8  # NAKs: more than any unit repeats for
LINE_SLACK_NS: Final = 5 * MS  # what a serial adapter and its driver may add to a time
BUSY_NS: Final = 20 * MS  # what they may add on a busy host, or by an adapter that collects bytes
COARSE_MS: Final = 20  # a time measured on a real line is told in steps of so many


class MscReplyKind(StrEnum):
    """What one packet has drawn, all told."""

    SILENCE = "nothing"
    NAK = "NAK"
    ACK = "ACK alone"
    REPLY = "ACK and a reply"
    OTHER = "something else"


Answer = tuple[MscReplyKind, Packet | None]  # what came, and the reply if that was one


def answer_to(driver: MscDriver, raw: bytes, timeout_s: float | None = None) -> Answer:
    """Send a packet that this unit need not serve, once; what it draws is taken to its end.

    `timeout_s`: until the sign comes.
    """
    driver.target.drain()
    driver.client.send(raw)
    return answer_now(driver, driver.client.limit_s(len(raw)) if timeout_s is None else timeout_s)


def answer_now(driver: MscDriver, timeout_s: float) -> Answer:
    """The answer to what was sent last."""
    sign = driver.client.receive(1, timeout_s)
    if sign == ACK:
        reply, strays = driver.client.receive_packet()
        if reply is not None or strays:
            driver.client.send(ACK)
            return (
                (MscReplyKind.REPLY, reply)
                if reply is not None and not strays
                else (MscReplyKind.OTHER, None)
            )
        return MscReplyKind.ACK, None
    if sign in (b"", NAK):
        return MscReplyKind.NAK if sign else MscReplyKind.SILENCE, None
    driver.client.listen(glance_s(driver))
    driver.client.send(ACK)
    return MscReplyKind.OTHER, None


def reply_kind_of(driver: MscDriver, raw: bytes) -> MscReplyKind:
    """What a packet draws that this unit need not serve."""
    return answer_to(driver, raw)[0]


def longest_s(driver: MscDriver) -> float:
    """How long a time-out of a unit is waited for."""
    return LONGEST_S if driver.target.is_virtual else LONGEST_REAL_S


def glance_s(driver: MscDriver) -> float:
    """How long to listen for what a unit sends at once, as far as it is known how long it takes."""
    delay_s = int(driver.session.reading("reply_delay_ms")) / 1000
    return QUIET_S + delay_s + driver.target.uncertainty_ns / 1e9


def unanswered(driver: MscDriver, body: bytes = RQSTAT) -> tuple[Packet, int]:
    """Ask and keep our answer to the reply back; the reply, and when it was over (ns)."""
    exchange = driver.ask(body, answer=None)
    driver.session.step(exchange.is_acked and exchange.reply is not None, "a reply", exchange)
    assert exchange.reply is not None, "the step above has seen to it"
    return exchange.reply, exchange.replied_ns


def look_s(driver: MscDriver) -> float:
    """How long to listen for a repeat: T2 must not run out meanwhile."""
    return min(glance_s(driver), driver.client.ack_timeout_s / 2)


def repeat_at_once(driver: MscDriver, limit_s: float | None = None) -> bool:
    """True if the unit now sends more than a sign on its own, before T2 could make it do so, or
    within the limit."""
    again, strays = driver.client.receive_packet(look_s(driver) if limit_s is None else limit_s)
    if strays:  # of several units that talk at once nothing can be read
        driver.client.listen(glance_s(driver))
    return again is not None or bool(strays.strip(ACK + NAK))


def repeat_to_nak(driver: MscDriver) -> bool:
    """Send NAK; whether that draws anything, however long this unit takes to answer."""
    driver.client.send(NAK)
    return repeat_at_once(driver, glance_s(driver))


def refusals(driver: MscDriver) -> int:
    """How many packets NAKs draw, one after another, until one draws none; then it is idle."""
    for count in range(MOST_REFUSED):
        if not repeat_to_nak(driver):
            return count
    driver.client.send(ACK)
    return MOST_REFUSED


def down_to_the_last(driver: MscDriver) -> int:
    """Ask, and refuse the reply until it will be repeated but once; when the last one was over."""
    _, over_ns = unanswered(driver)
    for _ in range(LIMITS[driver.session.reading("retransmit_limit")] - 1):
        driver.session.step(repeat_to_nak(driver), "the reply again", "nothing")
        over_ns = driver.target.now_ns
    return over_ns


def is_waiting(driver: MscDriver) -> bool | None:
    """Whether a unit that has one repeat left still waits for our answer; None: it sends its last
    reply again to any NAK, so that this tells nothing (MSC-AMB-29).  Afterwards it is idle."""
    count = refusals(driver)
    return None if count == 1 and driver.session.reading("stray_nak") != "ignore" else count == 1


def default_of(driver: MscDriver, switch: str) -> int:
    """The default of a switch whose reading is a number."""
    return int(driver.session.run.ledger.ambiguity_of(switch).default_of(switch))


def in_ms(
    driver: MscDriver, measured_ns: int, switch: str, *, is_from_sending: bool = False
) -> Measured:
    """A time as the reading of a switch: exact where time is, else the default if it may be that,
    and in steps that the line does not blur.

    `is_from_sending`: it was measured from something sent to something heard, so that the way there
    and back is in it; from one thing heard to another there is only what the way varies by.
    """
    ms = max(0, round(measured_ns / MS))
    target = driver.target
    if target.is_virtual and target.is_lossless:
        return Measured(str(ms))
    default = default_of(driver, switch)
    over_ns = measured_ns - default * MS
    trip = target.round_trip
    jitter_ns = trip.max_ns - trip.median_ns
    longer_ns = trip.way_ns if is_from_sending else jitter_ns
    if -jitter_ns - BUSY_NS <= over_ns <= longer_ns + BUSY_NS:
        return Measured(str(default))
    return Measured(str(max(1, round(ms / COARSE_MS)) * COARSE_MS))


def variable(driver: MscDriver) -> int:
    """The address of one of the named variables; skips without one."""
    return MscDriver(driver.session).scratch.spot()


def block_of_variables(driver: MscDriver) -> int:
    """Where a whole block of the named variables begins: none is read beyond what was named.  Skips
    if there is none."""
    return MscDriver(driver.session).scratch.block_spot()


def odd_packet(driver: MscDriver, body: bytes) -> bytes:
    """A packet whose header, length and checksum are right, whatever its body."""
    return codec.packet(driver.unit, body)


def running_program(driver: MscDriver) -> BenchProgram:
    """The bench program; skips if it stands still."""
    program = BenchProgram(driver.session)
    program.must_run()
    return program
