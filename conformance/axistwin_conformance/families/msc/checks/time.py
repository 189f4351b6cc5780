"""Time-outs of the link, and the time of a character (PHY-01, PHY-03, LNK-03, LNK-12, LNK-17).

In virtual time the windows are as narrow as the ledger is; on a real line they are wider by what is
not known of an instant (`link`).
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session, earlier
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.repeats import is_surely, judge_all_repeats
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import FILLER, MS, Names

ORDER = 30  # of this module in a run; see `Family.modules`

LISTEN_S: Final = 60.0  # costs nothing in virtual time
LISTEN_REAL_S: Final = 2.0
LONGEST_PACKET_NS: Final = 258_400_000  # MSC-LNK-17: 248 characters
WITHOUT_GAPS: Final = (
    "At 9600 baud with 8 data bits, no parity and 1 stop bit a byte takes 10 bits. The manual names"
    " no gaps between bytes; so those of a reply follow one another without any."
)
ONE_LIMIT: Final = (
    "A packet that does not arrive whole within the device's time limit is answered with NAK. The"
    " manual names no time; so a device that has shown one is held to it, wherever a packet breaks"
    " off."
)
MARGIN_BYTES: Final = 5  # MSC-AMB-03: how far below T1 a packet is surely in time
REAL_CUTS: Final = (2, 5, 6, 10, 13, 14)  # of RQSTAT's 15 bytes: in each field, and their edges
SIGNS: Final = 0x0615  # as a block number: in a packet neither is a sign, nor begins a time limit
MOST_LATE: Final = 4  # times as late as it is due: what comes within is a late repeat
LONG_BODIES: Final = (137, codec.MAX_BODY)  # of BWRITE, and the largest
LONG_CUT: Final = 200  # bytes of that
SHOWN_BYTES: Final = 20  # of a packet, in words
WRONG_SPACING: Final = 0.03  # of a character's time, over a whole reply


@check("MSC-PHY-01")
def a_character_takes_ten_bits_of_9600_baud(session: Session) -> None:
    """RQSTAT at 9600 baud, 8N1, is served, and the bytes of its reply follow at 1.04 ms."""
    driver = MscDriver(session)
    session.step(session.target.baud == 9600, "9600 baud", session.target.baud)
    driver.link.alive("MSC-PHY-01")
    judge_pace(driver, "MSC-PHY-01")


def judge_pace(driver: MscDriver, names: Names) -> None:
    """Judge that a reply's characters come one upon the other, as at 9600 8N1."""
    session = driver.session
    if session.target.description.startswith("socket:"):
        return  # a plain socket carries bytes, not a rate
    session.target.drain()
    session.target.send(driver.client.request(RQSTAT))
    session.step(
        driver.client.receive(2)[:1] == ACK, "ACK and the beginning of a packet", "not that"
    )
    count = driver.client.reply_bytes("RQSTAT") - 1
    began_ns = session.target.now_ns
    rest = driver.client.receive(count)
    took_ns = session.target.now_ns - began_ns
    session.target.send(ACK)
    session.step(len(rest) == count, f"{count} more bytes", len(rest))
    due_ns = count * driver.link.byte_ns
    spare_ns = due_ns * WRONG_SPACING + driver.link.spare_ns
    session.expect(
        abs(took_ns - due_ns) <= spare_ns,
        names,
        f"{count} bytes in {due_ns / MS:.1f} ms",
        Observation(
            f"of the {count + 2} bytes that came back from {REQUEST} (ACK and packet), the end of"
            f" the last one came {took_ns / MS:.1f} ms after the end of the second one"
            f" ({took_ns / count * 10 / driver.link.byte_ns:.1f} bits per byte: another rate,"
            " another frame or gaps between the bytes)",
            value=f"{took_ns / MS:.1f} ms",
            wanted=f"{due_ns / MS:.1f} ms ± {spare_ns / MS:.1f} ms (10 bits per byte at 9600"
            " baud, 8N1; the tolerance is the suite's)",
            rule=WITHOUT_GAPS,
            by_hand="this shows the bytes; measure their times with a scope or logic analyser",
        ),
    )


@check("MSC-PHY-03")
def an_idle_unit_says_nothing(session: Session) -> None:
    """A unit that nobody has asked anything keeps silent."""
    driver = MscDriver(session)
    seconds = LISTEN_S if session.target.is_virtual else LISTEN_REAL_S
    driver.link.nothing_more("MSC-PHY-03", "the last exchange", seconds)
    driver.link.alive("MSC-PHY-03")


# --- T1 -------------------------------------------------------------------------------------------


def judge_broken_off(driver: MscDriver, count: int) -> None:
    """Send so many bytes of RQSTAT and no more: one NAK, T1 later (MSC-LNK-03)."""
    session, whole = driver.session, len(driver.client.request(RQSTAT))
    raw = driver.client.request(RQSTAT)[:count]
    text = f"{count} bytes of RQSTAT"
    if count == 1:
        _judge_lone_start(driver)
        return
    received, sent_ns, came_ns = driver.link.break_off(raw)
    session.expect(received == NAK, "MSC-LNK-03", f"NAK to {text}", received.hex(" ") or "nothing")
    if driver.unit != session.address:  # whose time-outs nobody has measured
        return
    due = driver.link.sign_window(sent_ns, count)
    before = earlier(session, "packet_timeout_ms")
    shown = "earlier in this run this device waited" if before else "this device waits"
    session.expect(
        came_ns in due,
        "MSC-LNK-03",
        f"NAK to {text} {due.since(sent_ns)}",
        Observation(
            f"RQSTAT broken off after {count} of its {whole} bytes was answered with NAK"
            f" {(came_ns - sent_ns) / MS:.1f} ms after its first byte began"
            f" ({(came_ns - sent_ns - count * driver.link.byte_ns) / MS:.1f} ms after the end"
            " of the last one)",
            value=f"after {(came_ns - sent_ns) / MS:.1f} ms",
            wanted=f"NAK {due.since(sent_ns)}: {shown}"
            f" {driver.client.packet_timeout_s * 1000:.0f} ms from the first byte",
            rule=ONE_LIMIT,
            earlier=before,
        ),
    )
    driver.link.nothing_more("MSC-LNK-03", f"the NAK to {text}")


def _judge_lone_start(driver: MscDriver) -> None:
    """What comes to a lone 02h (MSC-AMB-31): nobody knows yet for whom the packet was to be."""
    received, sent_ns, came_ns = driver.link.break_off(STX)
    is_many = bool(driver.session.neighbours)  # several at once garble each other
    if received and received != NAK and not is_many:
        driver.session.fail("MSC-LNK-03", ["NAK", "nothing"], received.hex(" "))
    if not received:
        is_rs232 = driver.link.is_surely_rs232()
        readings = ("silent",) if is_rs232 else ("silent_on_rs485", "silent")
    else:
        readings = ("nak",) if driver.link.is_rs485 else ("silent_on_rs485", "nak")
    driver.reading("timeout_before_unit", readings, "MSC-LNK-03")
    if received and not is_many:
        due = driver.link.sign_window(sent_ns, 1)
        text = f"after {(came_ns - sent_ns) / MS:.1f} ms"
        driver.session.expect(came_ns in due, "MSC-LNK-03", f"NAK {due.since(sent_ns)}", text)
    driver.link.nothing_more("MSC-LNK-03", "a lone 02h")


@check("MSC-LNK-03", "MSC-LNK-04", "MSC-LNK-22")
def a_packet_broken_off_is_refused_when_its_time_is_over(session: Session) -> None:
    """RQSTAT broken off after any of its bytes gets one NAK when the time limit is over, not
    before; then the unit serves the next packet."""
    driver = MscDriver(session)
    whole = len(driver.client.request(RQSTAT))
    first = 2 if driver.link.is_rs485 else 1  # a lone 02h may be anybody's there
    for count in range(first, whole) if session.target.is_virtual else REAL_CUTS:
        judge_broken_off(driver, count)
        driver.link.alive(("MSC-LNK-22", "MSC-LNK-04"))
    known = round(driver.client.packet_timeout_s * 1000)
    session.quirk("MSC-LNK-03", "packet_timeout_ms", str(known))


@check("MSC-LNK-03", needs=("alone",))
def a_lone_start_is_refused_on_rs232(session: Session) -> None:
    """A lone 02h draws NAK at T1 from a unit alone on RS-232, or silence if this device reads it
    so; after T1 it serves.  (T1 in HDR)"""
    driver = MscDriver(session)
    judge_broken_off(driver, 1)
    driver.link.alive("MSC-LNK-03")


@check("MSC-LNK-03", "MSC-PHY-03", needs=("neighbour",))
def a_lone_start_is_nobodys_on_rs485(session: Session) -> None:
    """A lone 02h on a shared line draws silence from everybody, or a NAK if this device reads it
    so: nobody can tell for whom it was.  (T1 in HDR)"""
    driver = MscDriver(session)
    judge_broken_off(driver, 1)
    driver.link.alive(("MSC-LNK-03", "MSC-PHY-03"))


@check("MSC-LNK-02", "MSC-LNK-03", "MSC-LNK-04")
def a_length_that_is_wrong_is_found_at_t1_at_the_latest(session: Session) -> None:
    """RQSTAT with a length too large, up to the largest, or a byte lost, draws one NAK at T1; sent
    again too early it is taken for the rest; with a length too small it draws NAK at once
    (§4.3)."""
    driver = MscDriver(session)
    raw = driver.client.request(RQSTAT)
    cases = [codec.packet(driver.unit, RQSTAT, length=7 + more) for more in (1, 10)]
    # The last byte of this body is its true length.
    cases.append(codec.packet(driver.unit, codec.rflag(8), length=9))
    lost = range(4, len(raw) - 1) if session.target.is_virtual else (9,)
    cases += [raw[:at] + raw[at + 1 :] for at in lost]
    cases += [case for case in _long_ones(driver) if driver.link.has_time_for(len(case))]
    for case in cases:
        received, sent_ns, came_ns = driver.link.break_off(case)
        more = " and so on" if len(case) > SHOWN_BYTES else ""
        text = f"{case[:SHOWN_BYTES].hex(' ')}{more}, {len(case)} bytes, T1 later"
        due = driver.link.sign_window(sent_ns, len(case))
        is_so = received == NAK and came_ns in due
        got = f"{codec.explain(received) or 'nothing'} after {(came_ns - sent_ns) / MS:.1f} ms"
        session.expect(is_so, ("MSC-LNK-02", "MSC-LNK-03"), f"NAK to {text}", got)
        driver.link.nothing_more("MSC-LNK-04", f"the NAK to {text}")
    driver.link.sign(
        codec.packet(driver.unit, RQSTAT, length=7 + len(raw)) + raw, NAK, "MSC-LNK-04", "both"
    )
    driver.link.alive("MSC-LNK-04")
    # What is left over of a body cut short begins with its checksum, 02h.  On one pair of wires a
    # unit that NAKs at once talks into those two characters.
    if not driver.link.is_busy_hearing and driver.link.latency_ns <= 3 * driver.link.byte_ns:
        return
    session.target.send(codec.packet(driver.unit, RQSTAT, length=5))
    received = driver.client.receive(1)
    session.expect(
        received == NAK, "MSC-LNK-02", "NAK at once", codec.explain(received) or "nothing"
    )
    received = driver.client.wait_until_quiet()  # 13h is no unit's number
    is_refused = not received.strip(NAK) or driver.link.is_refused_in_chorus
    session.expect(is_refused, "MSC-LNK-02", "NAK at most", codec.explain(received))
    driver.link.alive("MSC-LNK-02")


def _long_ones(driver: MscDriver) -> list[bytes]:
    """A body of the largest size that breaks off far behind its middle, one that lacks its sum's
    last byte, and a header with nothing behind it."""
    whole = [
        codec.packet(driver.unit, RQSTAT.ljust(size, FILLER), checksum=0) for size in LONG_BODIES
    ]
    cut = [whole[-1][:LONG_CUT], *(raw[:-1] for raw in whole)]
    return [*cut, whole[-1][: codec.HEADER_BYTES]] if driver.target.is_virtual else cut[:2]


def send_in_parts(driver: MscDriver, parts: list[tuple[float, bytes]]) -> tuple[bytes, int]:
    """Send the parts, each that long (s) after the beginning of the first, until something comes:
    what came, and when (ns, since the beginning)."""
    driver.target.drain()
    began_ns = driver.target.now_ns
    for at_s, part in parts:
        left_s = at_s - (driver.target.now_ns - began_ns) / 1e9
        received = driver.client.receive(1, left_s) if left_s > 0 else b""
        if received:
            return received, driver.target.now_ns - began_ns
        driver.target.send(part)
    received = driver.client.receive(1)
    return received, driver.target.now_ns - began_ns


def finish(driver: MscDriver, sign: bytes) -> bytes:
    """Take and acknowledge the reply if there is one, then wait out what may be left over."""
    if sign != ACK:
        return driver.client.wait_until_quiet()
    reply, strays = driver.client.receive_packet()
    if reply:
        driver.target.send(ACK)
    return strays + driver.client.listen(driver.link.glance_s)


@check("MSC-LNK-03", "MSC-LNK-17")
def the_time_limit_is_for_the_whole_packet(session: Session) -> None:
    """A packet with pauses below T1 that takes longer altogether is refused at T1, or served if
    this device's limit is for each pause, or from the header on."""
    driver = MscDriver(session)
    raw = driver.client.request(RQSTAT, SIGNS)
    seen: list[str] = []
    # In parts of T1: both end 1.2 behind their beginning; the first 0.8 behind its header.
    for places in (
        ((0, 0, 1), (0.4, 1, 6), (0.8, 6, 14), (1.2, 14, 15)),
        ((0, 0, 6), (0.6, 6, 14), (1.2, 14, 15)),
    ):
        parts = [(at * driver.client.packet_timeout_s, raw[start:end]) for at, start, end in places]
        received, _ = send_in_parts(driver, parts)
        if received not in (ACK, NAK):
            session.fail("MSC-LNK-03", ["NAK", "ACK"], received.hex(" ") or "nothing")
        strays = finish(driver, received)
        session.expect(not strays, "MSC-LNK-03", "one sign", f"{codec.explain(strays)} as well")
        seen.append("served" if received == ACK else "refused")
    readings = {
        "refused, refused": "total",
        "served, refused": "after_header",
        "served, served": "interbyte",
    }
    mode = readings.get(", ".join(seen))
    if mode is None:
        session.fail("MSC-LNK-03", list(readings), ", ".join(seen))
    session.quirk(("MSC-LNK-03", "MSC-LNK-17"), "packet_timeout_mode", mode)
    driver.link.alive("MSC-LNK-03")


@check("MSC-LNK-17", "MSC-LNK-03")
def the_longest_packet_has_time_enough(session: Session) -> None:
    """RQSTAT stretched over the time of 248 characters is served; so is one that ends five
    characters before T1."""
    driver = MscDriver(session)
    raw = driver.client.request(RQSTAT)
    margin_s = (MARGIN_BYTES * driver.link.byte_ns + 2 * driver.link.spare_ns) / 1e9
    spans = {
        "MSC-LNK-03": driver.client.packet_timeout_s - margin_s,
        "MSC-LNK-17": LONGEST_PACKET_NS / 1e9,
    }
    for name, span_s in sorted(spans.items(), key=lambda each: each[1]):
        if span_s <= 0:
            slowest = f"an exchange takes up to {driver.link.spare_ns / MS:.0f} ms here"
            session.not_run(name, f"{slowest}: too long to come just before a time-out is over")
            continue
        last_s = span_s - driver.link.byte_ns / 1e9
        each = [
            (last_s * number / (len(raw) - 1), raw[number : number + 1])
            for number in range(len(raw))
        ]
        received, took_ns = send_in_parts(driver, each)
        text = f"ACK to RQSTAT within {span_s * 1000:.1f} ms"
        got = f"{codec.explain(received) or 'nothing'} after {took_ns / MS:.1f} ms"
        if received != ACK and spans["MSC-LNK-03"] < span_s <= driver.client.packet_timeout_s:
            session.inconclusive(name, f"{got}, but the way may have delayed the end of it")
        session.expect(received == ACK, name, text, got)
        strays = finish(driver, received)
        session.expect(
            not strays, name, "one sign and one reply", f"{codec.explain(strays)} as well"
        )


@check("MSC-LNK-03", "MSC-LNK-22")
def the_time_limit_begins_with_each_packet(session: Session) -> None:
    """Noise starts no time limit, and a packet right behind the NAK for one that broke off has the
    whole limit for itself."""
    driver = MscDriver(session)
    limit_s = driver.client.packet_timeout_s
    raw = driver.client.request(RQSTAT)
    is_quiet = session.reading("noise_in_idle") == "ignore"
    start = [(0.0, b"\x00\xff")] if is_quiet else []
    late = [(0.7 * limit_s, raw[:8]), (1.3 * limit_s, raw[8:])]
    received, _ = send_in_parts(driver, start + late)
    session.expect(received == ACK, "MSC-LNK-03", "ACK", codec.explain(received) or "nothing")
    finish(driver, received)
    received, _, _ = driver.link.break_off(raw[:8])
    session.expect(received == NAK, "MSC-LNK-03", "NAK", codec.explain(received) or "nothing")
    rest_s = max(0.5 * limit_s, 0.8 * limit_s - 2 * driver.link.spare_ns / 1e9)
    received, _ = send_in_parts(driver, [(0.0, raw[:8]), (rest_s, raw[8:])])
    session.expect(received == ACK, "MSC-LNK-22", "ACK", codec.explain(received) or "nothing")
    strays = finish(driver, received)
    session.expect(
        not strays, "MSC-LNK-22", "one sign and one reply", f"{codec.explain(strays)} as well"
    )


# --- T2 -------------------------------------------------------------------------------------------


@check("MSC-LNK-12", "MSC-LNK-08", "MSC-LNK-09", "MSC-LNK-13", "MSC-LNK-10")
def a_reply_without_answer_comes_again(session: Session) -> None:
    """When the host says nothing, the same reply comes again, T2 after its last byte, five times;
    then silence, and the unit serves; or it gives up or waits, if this device reads it so.
    (T2 in WAIT)"""
    driver = MscDriver(session)
    first = driver.link.unanswered()
    repeats = _repeats_by_time_out(driver, first)
    action = "retransmit" if repeats else _without_repeats(driver)
    session.quirk("MSC-LNK-12", "ack_timeout_action", action)
    if repeats:
        known = round(driver.client.ack_timeout_s * 1000)
        session.quirk("MSC-LNK-12", "ack_timeout_ms", str(known))
        seen = {5: "5_repeats", 4: "5_total"}.get(repeats)
        if seen is None:
            text = f"{REQUEST} was answered, and the reply repeated {repeats} times"
            wanted = "5 repeats (or 4, if the manual's 5 counts the first transmission)"
            session.fail(
                "MSC-LNK-09", ["5 repeats", "5 sendings in all"], Observation(text, wanted=wanted)
            )
        session.quirk("MSC-LNK-09", "retransmit_limit", seen)
    else:
        text = f"nothing repeats by itself with ack_timeout_action={action}"
        session.not_run("MSC-LNK-09", text)
        session.not_run("MSC-LNK-10", text)
    driver.link.alive(("MSC-LNK-13", "MSC-LNK-08"))


def _repeats_by_time_out(driver: MscDriver, first: codec.Packet, repeats: int = 0) -> int:
    """Say nothing until no more repeats come, and judge each one's bytes and time; return their
    number, with those that have come before."""
    session = driver.session
    last_ns = session.target.now_ns
    limit_s = driver.client.ack_timeout_s * 1.5 + driver.link.glance_s
    while repeats <= driver.link.limit:
        again, strays = driver.client.receive_packet(limit_s)
        if again is None and not strays and 0 < repeats < driver.link.limit:
            # One that comes late is told as late, and not as one too few.
            again, strays = driver.client.receive_packet(MOST_LATE * limit_s)
        if again is None and not strays:
            break
        is_same = again is not None and not strays and driver.link.is_same(again, first)
        text = f"{first.raw.hex(' ')} again"
        session.expect(is_same, "MSC-LNK-10", text, again or strays.hex(" "))
        due, came_ns = driver.link.repeat_window(last_ns, len(first.raw)), session.target.now_ns
        after = f"{(came_ns - last_ns) / MS:.1f} ms"
        told = Observation(
            f"repeat {repeats + 1} of the reply to {REQUEST} came {after} after the one before it",
            value=f"after {after}",
            wanted=f"it {due.since(last_ns)}",
        )
        session.expect(came_ns in due, "MSC-LNK-12", f"the repeat {due.since(last_ns)}", told)
        last_ns, repeats = came_ns, repeats + 1
    return repeats


def _without_repeats(driver: MscDriver) -> tuple[str, ...] | str:
    """Whether a unit that has not repeated its reply has given up or waits (MSC-AMB-02)."""
    driver.target.send(NAK)
    again, _ = driver.client.receive_packet()
    if again is None:
        return "abandon"
    driver.target.send(ACK)
    return ("wait", "abandon") if driver.session.reading("stray_nak") == "resend_last" else "wait"


@check("MSC-LNK-12", "MSC-LNK-09", "MSC-LNK-13", "MSC-LNK-10")
def refusals_and_time_outs_share_one_limit(session: Session) -> None:
    """Three NAKs and then silence: the rest of the five repeats come by time-out, and no more; the
    next reply has all of its own."""
    driver = MscDriver(session)
    if not is_surely(session, "ack_timeout_action", "retransmit"):
        session.skip("this device does not repeat a reply by itself, as far as is known")
    first = driver.link.unanswered()
    for number in range(1, 4):
        session.step(driver.link.refuse() is not None, f"repeat {number}", "nothing")
    repeats = _repeats_by_time_out(driver, first, 3)
    session.expect(
        repeats == driver.link.limit, "MSC-LNK-09", f"{driver.link.limit} repeats", repeats
    )
    judge_all_repeats(driver, ("MSC-LNK-09", "MSC-LNK-13"), "after one was given up at T2")
    driver.link.alive("MSC-LNK-13")
