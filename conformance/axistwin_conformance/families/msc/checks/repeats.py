"""What every reply is owed, whatever went before it: all its repeats, and to be heard out (LNK).

Each check names the cells of the link table (§4.1) that it visits.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.link import BEFORE_THE_REPLY, SECOND
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import COARSE_NS, MS, ROUNDING_NS, Names

ORDER = 25  # of this module in a run; see `Family.modules`

STRAYS: Final = (NAK, NAK + NAK, ACK + NAK + ACK)
ODD_BYTES: Final = b"\x00\xffA"  # neither signs nor 02h
MIDDLE, LATE = 0.6, 0.99  # of the time in which a sign surely comes within T2
REAL_LATE: Final = 0.85  # a busy host is late itself
LEAST: Final = 0.5  # of T2: what the line does not blur
SPARE: Final = 1.2  # times what an exchange takes
MARGIN_BYTES: Final = 3  # before the end of T2 a sign surely comes in time


def is_surely(session: Session, switch: str, reading: str) -> bool:
    """True if this device follows that reading, and nothing that was seen admits another one."""
    detection = session.run.detections.get(switch)
    if detection is not None and switch not in session.readings:
        return detection.candidates == (reading,)
    return session.reading(switch) == reading


def judge_all_repeats(driver: MscDriver, names: Names, when: str, before: bytes = b"") -> None:
    """Judge that a reply is repeated to each NAK up to the limit, and to none after that.

    `when`: what went before, in words; `before`: is sent before each NAK.
    """
    first, repeats = driver.link.unanswered(), 0
    while repeats <= driver.link.limit:
        if before:
            driver.target.send(before)
        again = driver.link.refuse()
        if again is None:
            break
        is_same = driver.link.is_same(again, first)
        text = f"{first.raw.hex(' ')} again"
        driver.session.expect(is_same, "MSC-LNK-10", text, again.raw.hex(" "))
        repeats += 1
    if repeats > driver.link.limit:
        driver.target.send(ACK)
    seen = Observation(
        f"{when}, the device repeated its reply to {REQUEST} {repeats} times, for"
        f" {min(repeats, driver.link.limit) + 1} NAKs",
        wanted=f"a repeat for each NAK, {driver.link.limit} at most",
    )
    text = f"{driver.link.limit} repeats {when}"
    driver.session.expect(repeats == driver.link.limit, names, text, seen)


@check("MSC-LNK-09", "MSC-LNK-10", "MSC-LNK-13", "MSC-LNK-15")
def whatever_went_before_a_reply_has_all_its_repeats(session: Session) -> None:
    """A reply is repeated to as many NAKs as any, right after another one was given up, after a
    packet was refused, after NAKs that nobody had waited for, and with other bytes before each NAK.
    (IDLE 15h; WAIT 15h, other)"""
    driver = MscDriver(session)
    for when in ("after an exchange", "after a reply was given up"):
        judge_all_repeats(driver, ("MSC-LNK-09", "MSC-LNK-13"), when)
    driver.link.alive("MSC-LNK-13")
    wrong = codec.with_wrong_checksum(driver.client.request(RQSTAT))
    driver.link.sign(wrong, NAK, "MSC-LNK-09", "a wrong checksum")
    judge_all_repeats(driver, "MSC-LNK-09", "after a packet was refused")
    if not is_surely(session, "stray_nak", "ignore"):
        session.not_run("MSC-LNK-15", "this device sends its last reply again to any NAK")
        return
    for signs in STRAYS:
        text = f"after {codec.explain(signs)} amid no exchange"
        session.target.send(signs)
        span_s = len(signs) * driver.link.byte_ns / 1e9
        driver.link.nothing_more("MSC-LNK-15", text, span_s + driver.link.glance_s)
        judge_all_repeats(driver, ("MSC-LNK-09", "MSC-LNK-15"), text)
    if is_surely(session, "junk_while_waiting", "ignore"):
        text = "with bytes before each NAK that are no signs"
        judge_all_repeats(driver, "MSC-LNK-09", text, ODD_BYTES)
    driver.link.alive("MSC-LNK-13")


@check("MSC-LNK-16", "MSC-LNK-10", "MSC-LNK-07", needs=("alone",))
def a_packet_that_comes_during_a_repeat_is_served_after_it(session: Session) -> None:
    """RFLAG sent while RQSTAT's reply is to come, or is repeated, is served once that has left.
    (EXEC and RETX 02h)"""
    driver = MscDriver(session)
    if not driver.link.is_busy_hearing:
        session.skip("on RS-485 the host would talk over the unit")
    for switch, wanted in (("rx_while_busy", "buffer"), ("stx_while_waiting", "serve")):
        if session.reading(switch) != wanted:
            session.skip(f"this device has {switch}={session.reading(switch)}")
    second = driver.client.request(SECOND)
    first = driver.link.unanswered()
    for when in ("in a repeat", "behind the request", BEFORE_THE_REPLY):
        if when == "in a repeat":
            session.target.send(NAK + second)
        else:
            early = second if when == "behind the request" else b""
            session.target.drain()
            session.target.send(driver.client.request(RQSTAT) + early)
            sign = driver.client.receive(1)
            session.step(sign == ACK, "ACK", codec.explain(sign) or "nothing")
            if not early:
                session.target.send(second)
        _judge_both(driver, first, when)


def _judge_both(driver: MscDriver, first: Packet, when: str) -> None:
    """Judge that RQSTAT's reply comes whole, then RFLAG's ACK and reply, and nothing else."""
    session = driver.session
    again, strays = driver.client.receive_packet()
    is_again = again is not None and not strays and again.is_sound and again.name == first.name
    if again is not None and when == "in a repeat":  # else what it tells may have changed by itself
        is_again = is_again and driver.link.is_same(again, first)
    if not is_again:
        driver.link.must_hear_while_it_talks()
    names: Names = "MSC-LNK-10" if when == "in a repeat" else ("MSC-LNK-07", "MSC-LNK-16")
    text = f"RQSTAT's whole reply, with a packet {when}"
    session.expect(is_again, names, text, again or strays.hex(" ") or "nothing")
    sign = driver.client.receive(1)
    second, strays = driver.client.receive_packet()
    is_served = sign == ACK and not strays and second is not None and second.name == "RFLAG"
    text, came = f"ACK and a reply to RFLAG sent {when}", second or (sign + strays).hex(" ")
    session.expect(is_served, "MSC-LNK-16", text, came or "nothing")
    session.target.send(ACK)
    driver.link.nothing_more("MSC-LNK-16", "both")
    driver.link.alive("MSC-LNK-16")


@check("MSC-LNK-11", "MSC-LNK-10", "MSC-LNK-08")
def a_sign_counts_whenever_it_comes(session: Session) -> None:
    """An ACK or a NAK in the middle of T2, or just before it is over, is taken as at once: nothing
    comes of the one, one repeat of the other.  (WAIT 06h, 15h)"""
    driver = MscDriver(session)
    _must_tell_t2(driver, "MSC-LNK-08")
    ack_timeout_s = driver.client.ack_timeout_s
    for part in (MIDDLE, LATE if session.target.is_virtual else REAL_LATE):
        first, over_ns = _unanswered(driver)
        at_ns = _send_at(driver, ACK, part, over_ns)
        text = f"{(at_ns - over_ns) / MS:.0f} ms after a reply"
        names = ("MSC-LNK-11", "MSC-LNK-08")
        # A repeat at T2 begins within that.
        left_s = ack_timeout_s - (at_ns - over_ns) / 1e9 + driver.link.latency_ns / 1e9
        left_s += driver.link.glance_s + 2 * driver.link.spare_ns / 1e9
        driver.link.nothing_more(names, f"an ACK {text}", left_s)
        first, over_ns = _unanswered(driver)
        at_ns = _send_at(driver, NAK, part, over_ns)
        _judge_late_nak(driver, first, over_ns, at_ns)
    driver.link.alive("MSC-LNK-11")


@check("MSC-LNK-16", "MSC-LNK-08")
def a_packet_counts_whenever_it_comes(session: Session) -> None:
    """A packet in the middle of T2, or begun just before it is over, is served as at once, and T2
    is over with it: nothing comes of the old reply while the packet is carried out, or after it.
    (WAIT 02h; EXEC)"""
    driver = MscDriver(session)
    if not is_surely(session, "stx_while_waiting", "serve"):
        session.skip("this device does not serve a packet while it waits for a sign")
    _must_tell_t2(driver, "MSC-LNK-16")
    for part in (MIDDLE, LATE if session.target.is_virtual else REAL_LATE):
        _, over_ns = _unanswered(driver)
        at_ns = _send_at(driver, driver.client.request(SECOND), part, over_ns)
        text = f"a packet {(at_ns - over_ns) / MS:.0f} ms after a reply"
        reply, strays = driver.client.receive_packet()
        session.target.send(ACK)
        is_served = strays == ACK and reply is not None and reply.name == codec.name_of(SECOND)
        seen = codec.explain(strays + (reply.raw if reply else b"")) or "nothing"
        names = ("MSC-LNK-16", "MSC-LNK-08")
        session.expect(is_served, names, f"ACK and its own reply to {text}", seen)
        left_s = driver.client.ack_timeout_s * 1.2 + driver.link.glance_s
        driver.link.nothing_more(names, text, left_s)
    driver.link.alive("MSC-LNK-16")


def _must_tell_t2(driver: MscDriver, requirement: str) -> None:
    """Go on only where T2 shows, and an exchange leaves most of it."""
    session = driver.session
    if not is_surely(session, "ack_timeout_action", "retransmit"):
        session.skip("nothing tells how long this device waits for a sign")
    driver.link.alive(requirement)
    ack_timeout_s = driver.client.ack_timeout_s
    late_s = driver.link.latency_ns / 1e9 + int(session.reading("reply_delay_ms")) / 1000
    if _limit_s(driver) <= max(ack_timeout_s * LEAST, late_s * SPARE):
        text = f"too long here to be told from the {ack_timeout_s * 1000:.0f} ms of T2"
        session.skip(f"an exchange takes {text}")


def _rounding_ns(driver: MscDriver) -> int:
    return 2 * (ROUNDING_NS if driver.target.is_virtual else COARSE_NS)


def _limit_s(driver: MscDriver) -> float:
    """How long after the end of a reply a sign has to be sent to come within T2, for certain."""
    ways_ns = driver.link.spare_ns + _rounding_ns(driver)
    return driver.client.ack_timeout_s - (MARGIN_BYTES * driver.link.byte_ns + ways_ns) / 1e9


def _unanswered(driver: MscDriver) -> tuple[Packet, int]:
    """Ask and keep our answer back; the reply, and when it can have been over (ns) at the earliest:
    if it has come late, nobody knows whether it was sent late."""
    exchange = driver.ask(RQSTAT, answer=None)
    is_good = exchange.is_acked and exchange.reply is not None and exchange.reply.is_sound
    driver.session.step(is_good, "ACK and a reply", exchange.observed)
    assert exchange.reply is not None
    count = len(exchange.request) + len(exchange.raw)
    return exchange.reply, exchange.asked_ns + count * driver.link.byte_ns


def _send_at(driver: MscDriver, raw: bytes, part: float, over_ns: int) -> int:
    """Send a sign or a packet when that part of the time for it is over; when (ns)."""
    limit_s = _limit_s(driver)
    left_ns = over_ns + round(part * limit_s * 1e9) - driver.target.now_ns
    driver.target.wait(max(0, left_ns) / 1e9)
    driver.target.send(raw)
    driver.in_time(over_ns, limit_s, "T2, less a margin,")
    return driver.target.now_ns


def _judge_late_nak(driver: MscDriver, first: Packet, over_ns: int, at_ns: int) -> None:
    """Judge that a NAK then draws a reply again, and does so before T2, if that is told apart; and
    that the repeat is all that comes."""
    session, link = driver.session, driver.link
    due_ns = over_ns + round(driver.client.ack_timeout_s * 1e9)
    again, strays = driver.client.receive_packet()
    begun_ns = driver.target.now_ns - len(again.raw if again else b"") * link.byte_ns
    driver.target.send(ACK)
    names, text = ("MSC-LNK-10", "MSC-LNK-08"), f"a NAK {(at_ns - over_ns) / MS:.0f} ms after it"
    is_same = again is not None and not strays and link.is_same(again, first)
    seen: Packet | str = again or codec.explain(strays) or "nothing"
    session.expect(is_same, names, f"the reply again to {text}", seen)
    needed_ns = int(session.reading("reply_delay_ms")) * MS + link.latency_ns + 4 * link.byte_ns
    blurred_ns = link.spare_ns + _rounding_ns(driver)
    if 2 * (needed_ns + blurred_ns) < due_ns - at_ns:
        came = f"{(begun_ns - over_ns) / MS:.1f} ms after it"
        is_drawn = begun_ns + blurred_ns < due_ns
        session.expect(is_drawn, names, f"the reply again at once to {text}", came)
    link.nothing_more(names, f"ACK to the repeat that {text} has drawn")
