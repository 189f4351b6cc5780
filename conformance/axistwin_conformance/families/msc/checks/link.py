"""The link: one sign to each packet; replies refused, left unanswered, or talked over (LNK).

Each check names the cells of the link table (§4.1) that it visits.
"""

from __future__ import annotations

import itertools
from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.packets import carrying
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import DRAWN, DUE, JUNK, WHILE_IT_TALKS, Again
from axistwin_conformance.families.msc.program import BenchProgram

ORDER = 20  # of this module in a run; see `Family.modules`

MOST_REFUSALS: Final = 6  # one more than MSC-LNK-09 has repeats
SECOND: Final = codec.rflag(0)  # whose reply cannot be taken for RQSTAT's
BEFORE_THE_REPLY: Final = "behind the ACK to a request"
SCANS_S: Final = 0.1  # several scans of the bench program (10 ms each)
TICKS_AT: Final = 4  # behind its first variable: one more in each scan
COUNTER_AT: Final = 0  # one more each time its first flag is found on


# --- one sign to each packet ----------------------------------------------------------------------


@check("MSC-LNK-01", "MSC-LNK-02", "MSC-LNK-04", "MSC-LNK-05", "MSC-LNK-07", "MSC-LNK-22")
def each_packet_draws_one_sign(session: Session) -> None:
    """A good RQSTAT draws one bare ACK and then its reply, one with a wrong checksum one bare NAK,
    in any order.  (IDLE 02h; IDLE, HDR, BODY, CSUM; EXEC)"""
    driver = MscDriver(session)
    raw = driver.client.request(RQSTAT)
    for is_good in (True, False, False, True, False, True, True):
        if is_good:
            exchange = driver.link.sign(
                raw, ACK, ("MSC-LNK-01", "MSC-LNK-04", "MSC-LNK-22"), "RQSTAT"
            )
            is_whole = exchange.reply is not None and exchange.reply.is_sound
            own = ("MSC-LNK-07", "MSC-LNK-05")
            session.expect(is_whole, own, "06, then a packet", exchange)
            gap_ns = exchange.replied_ns - exchange.signed_ns
        else:
            broken = codec.with_wrong_checksum(raw)
            names = ("MSC-LNK-02", "MSC-LNK-04", "MSC-LNK-05")
            driver.link.sign(broken, NAK, names, "RQSTAT with a wrong checksum")
    reply_ns = codec.REPLY_BYTES["RQSTAT"] * driver.link.byte_ns
    session.info("MSC-LNK-07", f"the reply begins {(gap_ns - reply_ns) / 1e6:.1f} ms after the ACK")


@check("MSC-LNK-04", "MSC-LNK-14", safety="stored", needs=("variables",))
def a_write_draws_the_ack_and_nothing_else(session: Session) -> None:
    """DWRITE and BWRITE draw ACK, then silence; a stray ACK of the host does no harm."""
    driver = MscDriver(session)
    spot = driver.scratch.block_spot()
    _judge_writes(driver, codec.dwrite(spot, 77), codec.bwrite(spot, range(32)))


@check("MSC-LNK-04", "MSC-LNK-14", safety="stored", needs=("flags",))
def a_flag_that_is_turned_draws_the_ack_and_nothing_else(session: Session) -> None:
    """So do SFLAG and CFLAG."""
    driver = MscDriver(session)
    (number,) = driver.scratch.some_flags(1)
    _judge_writes(driver, codec.sflag(number), codec.cflag(number))


def _judge_writes(driver: MscDriver, *bodies: bytes) -> None:
    session = driver.session
    for body in bodies:
        raw = driver.client.request(body)
        session.target.drain()
        session.target.send(raw)
        sign = driver.client.receive(1, driver.client.limit_s(len(raw)))
        session.expect(sign == ACK, "MSC-LNK-04", "one ACK", codec.explain(sign) or "nothing")
        _judge_after_write(driver, body)
        session.target.send(ACK)
        driver.link.nothing_more(("MSC-LNK-04", "MSC-LNK-14"), "a stray ACK")
        driver.link.alive("MSC-LNK-14")


def _judge_after_write(driver: MscDriver, body: bytes) -> None:
    """What comes behind the ACK to a write: nothing, or an empty packet (MSC-AMB-36)."""
    packet, strays = driver.client.receive_packet(driver.link.glance_s)
    received = codec.bytes_of(packet, strays)
    name = body.partition(codec.COMMA)[0].decode()
    is_empty = (
        packet is not None
        and packet.is_sound
        and packet.body in (b"", body[: len(name) + 1])
        and not strays
    )
    if received and not is_empty:
        driver.session.fail("MSC-LNK-14", ["nothing", "an empty packet"], codec.explain(received))
    driver.reading("write_reply", "empty_packet" if received else "none", "MSC-LNK-14")


@check("MSC-LNK-24", "MSC-LNK-04", safety=("stored", "negative"), needs=("variables",))
def bytes_of_a_refused_packet_are_not_looked_at_again(session: Session) -> None:
    """A BWRITE with a wrong checksum and a good RQSTAT among its values draws one NAK, nothing
    else."""
    driver = MscDriver(session)
    body = codec.bwrite(driver.scratch.block_spot(), carrying(driver.client.request(RQSTAT)))
    raw = codec.with_wrong_checksum(driver.client.request(body))
    driver.link.sign(raw, NAK, ("MSC-LNK-24", "MSC-LNK-04"), "the whole packet")
    driver.link.alive("MSC-LNK-24")


# --- replies refused and acknowledged -------------------------------------------------------------


def refusals(driver: MscDriver, count: int) -> tuple[Packet, int]:
    """Refuse the reply to RQSTAT so many times, or until none comes: the reply and how many repeats
    came.  Each repeat must be the same packet (MSC-LNK-10); a last one is acknowledged."""
    first, repeats = driver.link.unanswered(), 0
    for _ in range(count):
        again = driver.link.refuse()
        if again is None:
            return first, repeats
        driver.session.expect(
            driver.link.is_same(again, first),
            "MSC-LNK-10",
            f"{first.raw.hex(' ')} again",
            again.raw.hex(" "),
        )
        repeats += 1
    driver.target.send(ACK)
    return first, repeats


@check("MSC-LNK-09", "MSC-LNK-10", "MSC-LNK-11", "MSC-LNK-13", "MSC-LNK-08")
def a_refused_reply_comes_again_up_to_five_times(session: Session) -> None:
    """A reply answered with NAK is repeated, byte for byte and without ACK, up to 5 times; each
    exchange counts its own repeats."""
    driver = MscDriver(session)
    for count in (*range(MOST_REFUSALS), MOST_REFUSALS, MOST_REFUSALS):
        _, repeats = refusals(driver, count)
        if count == MOST_REFUSALS or repeats < count:
            seen = {5: "5_repeats", 4: "5_total"}.get(repeats)
            if seen is None:
                sent = min(count, repeats + 1)
                seen_words = Observation(
                    f"the device repeated its reply to {REQUEST} {repeats} times, for {sent} NAKs",
                    wanted="a repeat for each NAK, up to 5 repeats (or up to 4, if the manual's 5"
                    " counts the first transmission)",
                )
                session.fail("MSC-LNK-09", ["5 repeats", "5 sendings in all"], seen_words)
            driver.reading("retransmit_limit", seen, "MSC-LNK-09")
            names: tuple[str, ...] = ("MSC-LNK-13",)
        else:
            session.expect(repeats == count, ("MSC-LNK-09", "MSC-LNK-08"), count, repeats)
            names = ("MSC-LNK-11",)
        driver.link.nothing_more(names, f"{count} NAKs")
        driver.link.alive(names)


@check("MSC-LNK-11", "MSC-LNK-13", "MSC-LNK-08", "MSC-LNK-10")
def no_time_out_outlives_its_exchange(session: Session) -> None:
    """After the host's ACK, after a repeat that was acknowledged, after the last repeat and after a
    NAK for a packet, nothing comes for longer than both time-outs.  (T1 and T2 in IDLE)"""
    driver = MscDriver(session)
    longer_s = (
        max(driver.client.packet_timeout_s, driver.client.ack_timeout_s) * 1.2
        + driver.link.glance_s
    )
    driver.link.alive("MSC-LNK-08")
    driver.link.nothing_more("MSC-LNK-11", "the host's ACK", longer_s)
    _, repeats = refusals(driver, 2)
    session.step(repeats == 2, "2 repeats", repeats)
    driver.link.nothing_more("MSC-LNK-11", "the host's ACK to a repeat", longer_s)
    refusals(driver, MOST_REFUSALS)
    driver.link.nothing_more("MSC-LNK-13", "the last repeat and the NAK to it", longer_s)
    raw = codec.with_wrong_checksum(driver.client.request(RQSTAT))
    driver.link.sign(raw, NAK, "MSC-LNK-08", "a wrong checksum")
    driver.link.nothing_more("MSC-LNK-11", "a NAK for a packet", longer_s)
    driver.link.alive("MSC-LNK-13")


@check("MSC-LNK-15", "MSC-LNK-11")
def signs_outside_an_exchange_are_ignored(session: Session) -> None:
    """06h and 15h sent to an idle unit draw nothing, nor does a second ACK; a late NAK draws
    nothing, or the last reply if this device reads it so.  (IDLE 06h, 15h)"""
    driver = MscDriver(session)
    for signs in (ACK, ACK + ACK, NAK, NAK + NAK, ACK + NAK + ACK):
        last = driver.link.alive("MSC-LNK-15")
        session.target.send(signs)
        again, strays = driver.client.receive_packet(
            driver.link.glance_s + len(signs) * driver.link.byte_ns / 1e9
        )
        if again is None and not strays:
            if NAK in signs:
                driver.reading("stray_nak", "ignore", "MSC-LNK-15")
            continue
        # Several units that send again what was their last garble each other; a sign is no packet.
        is_garbled = bool(session.neighbours) and (again is not None or strays.strip(ACK + NAK))
        is_last = is_garbled or (
            again is not None and not strays and driver.link.is_same(again, last)
        )
        if NAK not in signs or not is_last:
            session.fail(
                ("MSC-LNK-15", "MSC-LNK-11"),
                f"nothing to {codec.explain(signs)}",
                codec.explain(strays + (again.raw if again else b"")),
            )
        driver.reading("stray_nak", "resend_last", "MSC-LNK-15")
        session.target.send(ACK)
        driver.client.wait_until_quiet()
    driver.link.alive("MSC-LNK-15")
    driver.link.alive("MSC-LNK-11")


# --- something else than a sign -------------------------------------------------------------------


@check("MSC-LNK-16", "MSC-LNK-08")
def a_new_packet_ends_the_wait_for_the_hosts_sign(session: Session) -> None:
    """A packet sent instead of the ACK is served and the old reply is gone, or what this device
    reads there.  (WAIT 02h)"""
    driver = MscDriver(session)
    # Neither T2 nor, once the packet has begun, T1 may run out while it is looked.
    limits = (driver.client.ack_timeout_s, driver.client.packet_timeout_s)
    look_s = min(driver.link.glance_s, min(limits) / 5)
    draws_s = (driver.link.latency_ns + 4 * driver.link.byte_ns + driver.link.spare_ns) / 1e9
    if look_s < draws_s and session.reading("ack_timeout_action") == "retransmit":
        driver.link.alive("MSC-LNK-16")
        session.skip("T2 is too short to tell its repeats from what a byte draws")
    first = driver.link.unanswered()
    raw = driver.client.request(SECOND)
    # Byte by byte, as far as one of them may draw the old reply again.
    sent, seen = 0, "ignore"
    for reading in ("as_nak", "ignore"):
        session.target.send(raw[sent : sent + 1])
        sent += 1
        received, strays = driver.client.receive_packet(look_s)
        if received is not None or strays:
            seen = reading
            break
    else:
        session.target.send(raw[sent:])
        received, strays = driver.client.receive_packet(driver.client.limit_s(len(raw)))
    if strays == ACK and received is not None and received.name == "RFLAG":
        session.target.send(ACK)
        driver.reading("stx_while_waiting", "serve", "MSC-LNK-16")
        driver.link.nothing_more(
            "MSC-LNK-16", "both", driver.client.ack_timeout_s * 1.2 + driver.link.glance_s
        )
    elif not strays and (
        driver.link.is_same(received, first) if received is not None else sent == 2
    ):
        driver.reading("stx_while_waiting", seen, "MSC-LNK-16")
        session.target.send(ACK)
        driver.client.wait_until_quiet()
    else:
        text = ["ACK and the reply to RFLAG", "the reply to RQSTAT again", "nothing"]
        session.fail(
            "MSC-LNK-16", text, codec.explain(strays + (received.raw if received else b""))
        )
    driver.link.alive("MSC-LNK-08")


def reason_not_served_amid_a_wait(driver: MscDriver) -> str:
    """Why a packet instead of a sign may not be served (MSC-AMB-27); empty: it is."""
    session, switch = driver.session, "stx_while_waiting"
    detection = session.run.detections.get(switch)
    left = detection.candidates if detection and switch not in session.readings else ()
    seen = left or (session.reading(switch),)
    return "" if seen == ("serve",) else f"this device has {switch}={' or '.join(seen)}"


def must_serve_amid_a_wait(driver: MscDriver) -> None:
    """Go on only where a packet instead of a sign is served."""
    if reason := reason_not_served_amid_a_wait(driver):
        driver.session.skip(reason)


def _reply_is_gone(driver: MscDriver, names: tuple[str, ...], what: str) -> None:
    """Judge that an old reply comes no more: neither by itself nor, unless this device sends its
    last one again whenever it hears 15h, to a NAK."""
    driver.link.nothing_more(names, what, driver.client.ack_timeout_s * 1.2 + driver.link.glance_s)
    if driver.session.reading("stray_nak") == "ignore":
        driver.target.send(NAK)
        driver.link.nothing_more(names, f"{what}, and a NAK")


@check("MSC-LNK-16", "MSC-LNK-22")
def a_bad_packet_ends_the_wait_for_the_hosts_sign_as_well(session: Session) -> None:
    """A packet under a wrong checksum, or one that breaks off, sent instead of the ACK draws NAK,
    and the old reply is gone all the same.  (WAIT 02h; HDR, BODY, CSUM)"""
    driver = MscDriver(session)
    must_serve_amid_a_wait(driver)
    raw = driver.client.request(SECOND)
    for count in (len(raw), len(raw) - 1, 3):
        driver.link.unanswered()
        if count == len(raw):
            driver.link.sign(codec.with_wrong_checksum(raw), NAK, "MSC-LNK-16", "a wrong checksum")
        else:
            received, _, _ = driver.link.break_off(raw[:count])
            told = codec.explain(received)
            if not told and session.readings.get("packet_timeout_ms") is None:
                session.skip("no NAK to a packet that breaks off, nor was there one before (T1)")
            session.expect(received == NAK, "MSC-LNK-16", "NAK", told or "nothing")
        _reply_is_gone(driver, ("MSC-LNK-16", "MSC-LNK-22"), f"{count} bytes amid a wait")
        driver.link.alive("MSC-LNK-22")


@check("MSC-LNK-16", "MSC-LNK-14", safety="stored", needs=("variables",))
def a_write_ends_the_wait_for_the_hosts_sign(session: Session) -> None:
    """A DWRITE sent instead of the ACK is carried out and ACKed, and the old reply is gone."""
    driver = MscDriver(session)
    must_serve_amid_a_wait(driver)
    spot = driver.scratch.spot()
    for value in (1, -2):
        driver.link.unanswered()
        exchange = driver.ask(codec.dwrite(spot, value))
        session.expect(exchange.is_acked, "MSC-LNK-16", "ACK to a write amid a wait", exchange)
        _reply_is_gone(driver, ("MSC-LNK-16", "MSC-LNK-14"), "a write amid a wait")
        session.expect(driver.read(spot) == value, "MSC-LNK-16", value, driver.read(spot))


@check("MSC-LNK-16", "MSC-LNK-09", "MSC-LNK-10")
def a_reply_served_amid_a_wait_has_repeats_of_its_own(session: Session) -> None:
    """However often the old reply was refused, the one that takes its place is repeated as often as
    any, and it alone.  (WAIT 02h; RETX)"""
    driver = MscDriver(session)
    must_serve_amid_a_wait(driver)
    for refused in (2, driver.link.limit):
        driver.link.unanswered()
        for number in range(refused):
            session.step(driver.link.refuse() is not None, f"repeat {number + 1}", "nothing")
        second = driver.link.unanswered(SECOND)
        for number in range(driver.link.limit):
            again = driver.link.refuse()
            text = f"repeat {number + 1} of {driver.link.limit}"
            session.expect(again is not None, "MSC-LNK-09", text, "nothing")
            is_same = again is not None and driver.link.is_same(again, second)
            session.expect(is_same, ("MSC-LNK-10", "MSC-LNK-16"), second, again)
        session.target.send(ACK)
        driver.link.nothing_more("MSC-LNK-16", "the last repeat")


@check("MSC-LNK-08", "MSC-LNK-12")
def another_byte_is_no_sign(session: Session) -> None:
    """A byte that is neither sign nor 02h leaves the wait as it is: a NAK after it still draws the
    repeat; or it counts as NAK, or ends the wait, if this device reads it so.  (WAIT other)"""
    driver = MscDriver(session)
    driver.link.calm()
    first = driver.link.unanswered()
    over_ns = session.target.now_ns
    session.target.send(JUNK)
    came = driver.link.drawn_again(over_ns)
    again, strays = came.packet, came.strays
    readings = tuple({DRAWN: "as_nak", DUE: "ignore"}[cause] for cause in came.causes)
    if again is None and not strays:
        session.target.send(NAK)
        again, strays = driver.client.receive_packet()
        readings = ("ignore",) if again else ("abandon",)
    is_good = not strays and (again is None or driver.link.is_same(again, first))
    text = ["nothing, and the repeat to a NAK", "the repeat at once", "nothing more"]
    if not is_good:
        session.fail(("MSC-LNK-08", "MSC-LNK-12"), text, again or strays.hex(" "))
    if readings != ("abandon",):
        session.target.send(ACK)
        driver.link.nothing_more("MSC-LNK-08", "ACK")
    is_told = bool(came.causes) or session.reading("stray_nak") == "ignore"
    if (readings == ("ignore",) and not is_told) or (readings == ("abandon",) and came.is_over):
        # A unit that had given up would have sent it again as well; or both have by now.
        readings = ("ignore", "abandon")
    driver.reading("junk_while_waiting", readings, ("MSC-LNK-08", "MSC-LNK-12"))
    driver.link.alive("MSC-LNK-08")


@check("MSC-LNK-08", "MSC-LNK-10", "MSC-LNK-07", "MSC-LNK-04", needs=("alone",))
def a_sign_that_comes_while_it_talks_counts_when_it_ends(session: Session) -> None:
    """An ACK or NAK sent right behind the request, between its ACK and any reply, during the reply,
    or during a repeat, is taken as the answer when that has left, or lost if this device reads it
    so.  (EXEC and RETX 06h, 15h, other)"""
    driver = MscDriver(session)
    if not driver.link.is_busy_hearing:
        session.skip("on RS-485 the host would talk over the unit")
    for when in ("behind the request", "in the reply", "in a repeat"):
        for sent in (ACK, NAK, JUNK + ACK):
            _talk_over(driver, sent, when)
            driver.link.alive("MSC-LNK-08")
    for body, sent in zip(driver.reads(), itertools.cycle((ACK, JUNK + ACK, NAK)), strict=False):
        _talk_over(driver, sent, BEFORE_THE_REPLY, body)
        driver.link.alive("MSC-LNK-08")


def _talk_over(driver: MscDriver, sent: bytes, when: str, body: bytes = RQSTAT) -> None:
    """Send signs while a reply, or a repeat of it, is under way, and judge what that does."""
    session = driver.session
    driver.link.measure_if_slow()
    received, first = _talked_over(driver, sent, when, body)
    packet = codec.parse(received)
    is_whole = packet is not None and packet.is_sound
    if not is_whole:
        driver.link.must_hear_while_it_talks()
    own = ("MSC-LNK-07", "MSC-LNK-04") if when == BEFORE_THE_REPLY else "MSC-LNK-10"
    text = f"the whole packet, with {codec.explain_request(sent)} sent {when}"
    session.expect(is_whole, own, text, codec.explain(received) or "nothing")
    assert packet is not None
    if first and session.reading("retransmit_content") == "snapshot":
        session.expect(packet.raw == first, "MSC-LNK-10", first.hex(" "), packet.raw.hex(" "))
    # A unit that has lost the sign still waits for it, and repeats the reply when T2 runs out.
    came = driver.link.drawn_again(session.target.now_ns)
    junk_counts = session.reading("junk_while_waiting") == "as_nak" and sent[:1] == JUNK
    readings = _kept_or_lost(came, draws=sent == NAK or junk_counts)
    names = ("MSC-LNK-08", "MSC-LNK-10")
    held = session.run.readings.get("rx_while_busy")
    is_so = not came.strays and bool(readings) and held in (None, *readings)
    text = "the reply again" if held != "drop" and (sent == NAK or junk_counts) else "nothing more"
    session.expect(is_so, names, text, came.packet or came.strays.hex(" ") or "nothing")
    driver.reading("rx_while_busy", readings, names)
    if came.packet is not None or held != "buffer":
        session.target.send(ACK)


def _talked_over(driver: MscDriver, sent: bytes, when: str, body: bytes) -> tuple[bytes, bytes]:
    """Send signs then: the bytes of the reply, or of its repeat, as they came; the first reply if
    it is repeated."""
    first = b""
    if when == "in a repeat":
        first = driver.link.unanswered(body).raw
        driver.target.send(NAK)
    else:
        driver.target.drain()
        early = sent if when == "behind the request" else b""
        driver.target.send(driver.client.request(body) + early)
        sign = driver.client.receive(1)
        if early and sign != ACK:
            driver.link.must_hear_while_it_talks()
        driver.session.step(sign == ACK, "ACK", sign.hex())
    if when == BEFORE_THE_REPLY:
        driver.target.send(sent)
    begun = driver.client.receive(WHILE_IT_TALKS)
    if when in ("in the reply", "in a repeat"):
        driver.target.send(sent)
    size = driver.client.reply_bytes(codec.name_of(body))
    return begun + driver.client.receive(size - WHILE_IT_TALKS), first


def _kept_or_lost(came: Again, *, draws: bool) -> tuple[str, ...]:
    """What the readings of rx_while_busy are that explain what came of signs which the unit, if it
    keeps them, takes for NAK, or for ACK; none: nothing does."""
    if not draws:
        by_cause = {DRAWN: (), DUE: ("drop",)}
        nothing: tuple[str, ...] = ("buffer", "drop")
    else:
        by_cause = {DRAWN: ("buffer",), DUE: ("drop",)}
        nothing = ("drop",)
    if came.packet is None:
        return nothing
    return tuple(reading for cause in came.causes for reading in by_cause[cause])


@check("MSC-LNK-04", "MSC-LNK-16", needs=("alone",))
def packets_behind_one_another_are_each_served(session: Session) -> None:
    """Two RQSTATs with wrong checksums without a pause between draw two NAKs, or one if this device
    loses what comes while it works.  (EXEC 02h)"""
    driver = MscDriver(session)
    if not driver.link.is_busy_hearing:
        session.skip("on RS-485 the unit would talk over the host")
    raw = codec.with_wrong_checksum(driver.client.request(RQSTAT))
    received = driver.link.drawn_by_both(raw, raw)
    if received and not received.strip(NAK) and session.reading("noise_in_idle") == "nak":
        # What is left of a packet that was lost in part is refused too.
        driver.client.wait_until_quiet()
        driver.reading("rx_while_busy", ("buffer", "drop"), "MSC-LNK-04")
    elif received == NAK + NAK:
        driver.reading("rx_while_busy", "buffer", "MSC-LNK-04")
    elif received == NAK:
        # What is left of the second packet may look like the beginning of one.
        received = driver.client.wait_until_quiet()
        session.expect(not received.strip(NAK), "MSC-LNK-04", "NAK at most", received.hex(" "))
        driver.reading("rx_while_busy", "drop", "MSC-LNK-04")
    else:
        driver.link.must_hear_while_it_talks()
        session.fail("MSC-LNK-04", ["NAK NAK", "NAK"], codec.explain(received) or "nothing")
    driver.link.alive("MSC-LNK-16")


@check("MSC-LNK-04", "MSC-LNK-14", safety="stored", needs=("alone", "variables"))
def a_packet_right_behind_a_write_is_served(session: Session) -> None:
    """Two DWRITEs without a pause between draw two ACKs and are both carried out, in their order;
    or the second is lost, if this device loses what comes while it works.  (EXEC 02h)"""
    driver = MscDriver(session)
    if not driver.link.is_busy_hearing:
        session.skip("on RS-485 the unit would talk over the host")
    if session.reading("write_reply") != "none":
        session.skip("behind its ACK to a write this device awaits ours")
    spot = driver.scratch.spot()
    for first, second in ((1, 2), (-1, 3)):
        received = driver.link.drawn_by_both(
            *(driver.client.request(codec.dwrite(spot, value)) for value in (first, second))
        )
        is_kept = received == ACK + ACK
        if not is_kept:
            received += (
                driver.client.wait_until_quiet()
            )  # what is left of the second may look like a packet
        is_lost = received[:1] == ACK and not received[1:].strip(NAK)
        text = codec.explain(received) or "nothing"
        if not (is_kept or is_lost):
            driver.link.must_hear_while_it_talks()
        session.expect(is_kept or is_lost, "MSC-LNK-04", ["ACK ACK", "ACK, NAK at most"], text)
        driver.reading("rx_while_busy", "buffer" if is_kept else "drop", "MSC-LNK-04")
        wanted, seen = second if is_kept else first, driver.read(spot)
        session.expect(seen == wanted, "MSC-LNK-14", f"{wanted} stored", seen)


# --- with the bench program -----------------------------------------------------------------------


@check("MSC-LNK-21", "MSC-LNK-10", needs=("program",))
def a_repeat_carries_the_data_of_the_first_reply(session: Session) -> None:
    """DREAD of a variable that grows in every scan is repeated byte for byte, or with fresh data if
    this device reads it so."""
    driver = MscDriver(session)
    ticks_at = BenchProgram(session).address + TICKS_AT
    body = codec.dread(ticks_at)
    before = driver.read(ticks_at)
    first = driver.link.unanswered(body)
    session.target.wait(min(SCANS_S, driver.client.ack_timeout_s / 2))  # or it repeats by itself
    driver.link.refuse()
    again = driver.link.refuse()  # a repeat of a repeat is the first reply as well
    session.target.send(ACK)
    if again is None or not again.is_sound or again.name != "DREAD":
        session.fail("MSC-LNK-10", "the packet again", again)
    after = driver.read(ticks_at)
    is_counting = after != before
    if not is_counting and again.raw == first.raw:
        session.skip("the bench program does not run: it counts no scans")
    if is_counting and again.values != first.values:
        driver.reading("retransmit_content", "fresh", ("MSC-LNK-21", "MSC-LNK-10"))
        return
    driver.reading("retransmit_content", "snapshot", "MSC-LNK-21")
    session.expect(
        again.raw == first.raw,
        ("MSC-LNK-10", "MSC-LNK-21"),
        first.raw.hex(" "),
        again.raw.hex(" "),
    )


def _has_counted(driver: MscDriver, counter: int, before: int) -> bool:
    return driver.read(counter) != before


@check("MSC-LNK-18", safety=("stored", "motion"), needs=("program", "variables"))
def a_repeated_write_is_carried_out_again(session: Session) -> None:
    """The same SFLAG sent twice counts twice in a program that uses the flag up, and the same
    DWRITE writes again: nothing marks a repeat."""
    driver = MscDriver(session)
    bench = BenchProgram(session)
    bench.must_run()
    flag, counter = bench.flag, bench.address + COUNTER_AT
    for block in (0, 0, 1, 1):
        before = driver.read(counter)
        exchange = driver.ask(codec.sflag(flag), block)
        session.step(exchange.is_acked, "ACK to SFLAG", exchange)
        bench.until(partial(_has_counted, driver, counter, before))
        session.target.wait(SCANS_S)  # and it is not counted again
        after = driver.read(counter)
        session.expect(codec.signed(before + 1) == after, None, f"{before} + 1", after)
    spot = driver.scratch.spot()
    for value in (5, 6, 5):
        driver.write(spot, value)
    session.expect(driver.read(spot) == 5, None, "5, written a second time", driver.read(spot))
