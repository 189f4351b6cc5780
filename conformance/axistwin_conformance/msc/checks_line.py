"""Several units on one line, characters that are none, power, and headers of impossible length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from axistwin_conformance.msc import codec
from axistwin_conformance.msc.checks_packets import INVALID_UNITS
from axistwin_conformance.msc.checks_time import judge_broken_off
from axistwin_conformance.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.msc.link import MS, Link
from axistwin_conformance.registry import check
from axistwin_conformance.session import Session

HALF_RATE: Final = 4800
# At half the rate: five bits of 0 and five of 1.  At 9600: ten bits of 0, one character without a
# stop bit, then the line at rest for as long.
SPOILT_CHARACTER: Final = b"\xf0"
SPOILT_AT: Final = {"header": 4, "checksum": 13}  # places in RQSTAT where a byte is spoilt
FILLER: Final = b"0"
MOST_SIGNS: Final = 15  # one of each unit, if they do not speak at the same time
RUNNING: Final = 1  # bit 0 of the status word
START_S: Final = 2.0  # for how long after power-up nothing must be said
ROUNDS_REAL: Final = 12
ROUNDS: Final = 60


def units(session: Session) -> list[Link]:
    """Every unit that is on the line."""
    return [Link(session, unit) for unit in (session.address, *session.neighbours)]


def absent(session: Session) -> int:
    """The number of a unit that is not on the line, and whose byte means nothing else."""
    taken = (session.address, *session.neighbours, 2, 6)
    return next(unit for unit in reversed(codec.UNITS) if unit not in taken)


def judge_skipped(link: Link) -> None:
    """Go on only where this device tells other units' packets from its own (MSC-AMB-12)."""
    if not link.is_rs485 and link.session.reading("rs232_unit_check") != "silent":
        seen = link.session.reading("rs232_unit_check")
        link.session.skip(f"on RS-232 this device has rs232_unit_check={seen}")


def judge_followed(link: Link) -> None:
    """Go on only where this device follows other units' packets by their length (MSC-AMB-14)."""
    if link.session.reading("other_unit_framing") != "skip_by_length":
        link.session.skip("this device has other_unit_framing=hunt_stx")


# --- somebody else's packets ----------------------------------------------------------------------


@check("MSC-PKT-15", "MSC-LNK-19")
def packets_for_others_are_followed_by_their_length(session: Session) -> None:
    """A packet for a unit that is not there, with a whole RQSTAT for this one and signs inside,
    draws nothing, unless this device hunts for 02h.  (SKIP 02h, 06h, 15h, other)"""
    link = Link(session)
    judge_skipped(link)
    inner = link.talk.request(RQSTAT)
    for inside in (inner, ACK + NAK + inner, b"\x00\xff" + inner + STX + NAK):
        body = RQSTAT + inside
        raw = codec.packet(absent(session), body, checksum=0x3030)
        session.target.drain()
        session.target.send(raw)
        heard = link.talk.listen(len(raw) * link.byte_ns / 1e9 + link.glance_s)
        if heard:
            if heard[:1] != ACK:
                session.fail(("MSC-PKT-15", "MSC-LNK-19"), "nothing", codec.explain(heard))
            session.target.send(ACK)
            link.talk.settle()
        seen = "hunt_stx" if heard else "skip_by_length"
        link.reading("other_unit_framing", seen, ("MSC-PKT-15", "MSC-LNK-19"))
        link.alive("MSC-PKT-15")


@check("MSC-LNK-19", "MSC-LNK-04")
def what_breaks_off_for_others_draws_nothing(session: Session) -> None:
    """A packet for a unit that is not there, broken off or under a wrong checksum, draws nothing,
    not even when its time is over; then this unit serves.  (T1 in SKIP)"""
    link = Link(session)
    judge_skipped(link)
    judge_followed(link)
    whole = codec.packet(absent(session), codec.dread(0))
    longer_s = link.packet_timeout_s * 1.2 + link.glance_s
    for count in (2, 6, len(whole) - 1) if session.target.is_virtual else (6,):
        session.target.drain()
        session.target.send(whole[:count])
        told = f"{count} bytes for another unit"
        link.nothing_more(("MSC-LNK-19", "MSC-LNK-04"), told, longer_s)
        link.alive("MSC-LNK-19")
    for offset in (1, 0x100):
        session.target.send(codec.with_wrong_checksum(whole, offset))
        told = "a wrong checksum for another unit"
        span_s = len(whole) * link.byte_ns / 1e9
        link.nothing_more(("MSC-LNK-19", "MSC-LNK-04"), told, span_s + link.glance_s)
    link.alive("MSC-LNK-19")


@check("MSC-LNK-19")
def the_rest_of_another_units_packet_is_counted_off(session: Session) -> None:
    """An RQSTAT that lies where another unit's announced body is still to come is part of that, and
    the one behind it is served.  (SKIP)"""
    link = Link(session)
    judge_skipped(link)
    judge_followed(link)
    inner = link.talk.request(RQSTAT)
    header = codec.packet(absent(session), b"", length=len(inner) - 2)[: codec.HEADER_BYTES]
    session.target.drain()
    session.target.send(header)
    session.target.send(inner)
    span_s = (len(header) + len(inner)) * link.byte_ns / 1e9
    link.nothing_more("MSC-LNK-19", "what another unit's header announced", span_s + link.glance_s)
    link.alive("MSC-LNK-19")


# --- several units --------------------------------------------------------------------------------


@check("MSC-PKT-05", "MSC-PKT-18", "MSC-LNK-19", "MSC-PHY-02", needs=("neighbour",))
def each_unit_answers_its_own_number_only(session: Session) -> None:
    """Of the numbers 1 to 15, those of the units on the line draw one reply each, with the number
    asked; the others, 0 and those above 15 draw nothing, or what this device reads there."""
    present = {link.unit: link for link in units(session)}
    own = Link(session)
    judge_followed(own)
    for unit in codec.UNITS:
        raw = codec.packet(unit, RQSTAT)
        if unit in present:
            exchange = present[unit].talk.ask(raw)
            reply = exchange.reply
            is_own = exchange.is_acked and reply is not None and reply.unit == unit
            names = ("MSC-PKT-05", "MSC-PKT-18", "MSC-PHY-02")
            session.expect(is_own, names, f"one reply of unit {unit}", exchange)
            own.nothing_more("MSC-PKT-05", f"the reply of unit {unit}")
            continue
        session.target.drain()
        session.target.send(raw)
        span_s = len(raw) * own.byte_ns / 1e9
        told = f"RQSTAT to unit {unit}, which is not there"
        own.nothing_more(("MSC-PKT-05", "MSC-LNK-19"), told, span_s + own.glance_s)
    for unit in INVALID_UNITS:
        _judge_invalid(own, unit)
    own.alive("MSC-PKT-05")


def _judge_invalid(link: Link, unit: int) -> None:
    """What a shared line says to a number that no unit can have (MSC-AMB-13)."""
    raw = codec.packet(unit, RQSTAT)
    link.target.drain()
    link.target.send(raw)
    heard = link.talk.listen(len(raw) * link.byte_ns / 1e9 + link.glance_s)
    if len(heard) > MOST_SIGNS:
        told = f"nothing to unit {unit}"
        link.session.fail("MSC-LNK-19", [told, "NAK of everybody"], codec.explain(heard))
    # Several that refuse at once garble each other.
    readings = ("nak",) if heard else ("silent", "broadcast")
    link.reading("invalid_unit", readings, "MSC-LNK-19")


@check("MSC-LNK-19", "MSC-LNK-04", "MSC-LNK-03", needs=("neighbour",))
def broken_packets_for_one_unit_concern_it_alone(session: Session) -> None:
    """A wrong checksum, and a packet broken off, for one of the units draw exactly one NAK; the
    other units serve at once, and so does it after that."""
    line = units(session)
    for link in line:
        raw = codec.with_wrong_checksum(link.talk.request(RQSTAT))
        link.sign(raw, NAK, ("MSC-LNK-19", "MSC-LNK-04"), f"a wrong sum for unit {link.unit}")
        for other in line:
            other.alive("MSC-LNK-19")
        judge_broken_off(link, 9)
        for other in line:
            other.alive("MSC-LNK-19")


def _turns(session: Session, line: list[Link], rounds: int) -> Iterator[tuple[Link, str]]:
    kinds = ["read", "read", "read", "flag", "wrong sum", "refused reply", "carrier"]
    for _ in range(rounds):
        yield session.random.choice(line), session.random.choice(kinds)


@check("MSC-PROP-14", "MSC-LNK-19", needs=("neighbour",), soaks=True)
def each_unit_behaves_as_if_alone(session: Session) -> None:
    """With several units on a line and exchanges interleaved at random, broken ones among them,
    each says what it says alone, and nobody else says anything."""
    line = units(session)
    line[0].calm()
    alone = {link.unit: link.told(link.alive("MSC-PROP-14")) for link in line}
    for link, kind in _turns(session, line, ROUNDS if session.target.is_virtual else ROUNDS_REAL):
        session.note(f"{kind} for unit {link.unit}")
        if kind == "wrong sum":
            offset = session.random.randrange(1, 0x10000)
            raw = codec.with_wrong_checksum(link.talk.request(RQSTAT), offset)
            _draws(link, raw, NAK)
        elif kind == "flag":
            exchange = link.ask(codec.rflag(session.random.randrange(256)))
            name = exchange.reply.name if exchange.reply else ""
            session.expect(name == "RFLAG", "MSC-PROP-14", "a reply to RFLAG", exchange)
        elif kind == "carrier":
            if session.reading("other_unit_framing") == "skip_by_length":
                inside = session.random.choice(line).talk.request(RQSTAT)
                raw = codec.packet(link.unit, RQSTAT + inside, checksum=0x3030)
                _draws(link, raw, NAK)
        else:
            if kind == "refused reply":
                first = link.unanswered()
                again = link.refuse_in("MSC-PROP-14")
                session.target.send(ACK)
                is_same = again is not None and link.is_same(again, first)
                session.expect(is_same, "MSC-PROP-14", first, again)
            body = link.told(link.alive("MSC-PROP-14"))
            if body != alone[link.unit]:  # what it tells may have changed by itself
                alone[link.unit] = link.told(link.alive("MSC-PROP-14"))
            session.expect(body == alone[link.unit], "MSC-PROP-14", alone[link.unit], body)


def _draws(link: Link, raw: bytes, sign: bytes) -> None:
    """Judge that exactly that sign comes from a line of several units."""
    link.target.drain()
    link.target.send(raw)
    heard = link.talk.listen(len(raw) * link.byte_ns / 1e9 + link.glance_s)
    told = codec.explain(heard) or "nothing"
    names = ("MSC-PROP-14", "MSC-LNK-19")
    link.session.expect(heard == sign, names, codec.explain(sign), told)


# --- on a bench -----------------------------------------------------------------------------------


@check("MSC-LNK-20", "MSC-PKT-10", safety="rig", needs=("bench",))
def a_header_that_announces_too_much_is_refused(session: Session) -> None:
    """A header with a length above 240 leads to one NAK: after all that it announced, or when this
    device reads it.  (BODY, discarding)"""
    link = Link(session)
    seen = set()
    for length in (241, 255, 256, 0xFFFF) if session.target.is_virtual else (241, 0xFFFF):
        header = codec.packet(link.unit, b"", length=length)[: codec.HEADER_BYTES]
        heard, sent_ns, came_ns = link.break_off(header)
        told = f"a header with length {length}"
        session.expect(heard == NAK, ("MSC-LNK-20", "MSC-PKT-10"), f"NAK to {told}", heard.hex())
        link.nothing_more("MSC-LNK-20", told)
        is_late = came_ns in link.sign_window(sent_ns, codec.HEADER_BYTES)
        is_early = came_ns < link.sign_window(sent_ns, codec.HEADER_BYTES).earliest_ns
        session.expect(
            is_late or is_early, "MSC-LNK-20", "NAK at once or at T1",
            f"after {(came_ns - sent_ns) / MS:.1f} ms",
        )  # fmt: skip
        seen.add("at T1" if is_late else "at once")
        link.alive("MSC-LNK-20")
    session.expect(len(seen) == 1, "MSC-LNK-20", "one of the two", " and ".join(sorted(seen)))
    if seen == {"at once"}:
        link.reading("overlength", "nak_after_header", ("MSC-LNK-20", "MSC-PKT-10"))
        return
    readings = {_after_all_of_it(link, length) for length in (241, 256)}
    session.expect(len(readings) == 1, "MSC-LNK-20", "one reading", sorted(readings))
    link.reading("overlength", readings.pop(), ("MSC-LNK-20", "MSC-PKT-10"))


def _after_all_of_it(link: Link, length: int) -> tuple[str, ...]:
    """What a whole packet of that length shows, its sum being wrong and its body no command."""
    body = RQSTAT.ljust(length, FILLER)
    raw = codec.packet(link.unit, body, checksum=0x3030)
    heard, sent_ns, came_ns = link.break_off(raw)
    link.session.expect(heard == NAK, "MSC-LNK-20", "NAK", heard.hex(" ") or "nothing")
    link.nothing_more("MSC-LNK-20", "the NAK")
    link.alive("MSC-LNK-20")
    is_late = came_ns >= link.sign_window(sent_ns, codec.HEADER_BYTES).earliest_ns
    return ("timeout_only",) if is_late else ("nak_after_packet", "accept")


@check("MSC-LNK-02", "MSC-LNK-04", safety="rig", needs=("bench",))
def an_empty_body_is_no_command(session: Session) -> None:
    """A packet without a body under a right checksum is treated as an unknown command, or ACKed if
    this device reads it so."""
    link = Link(session)
    link.calm()
    raw = codec.packet(link.unit, b"")
    exchange = link.talk.ask(raw, is_read=False)
    link.nothing_more(("MSC-LNK-02", "MSC-LNK-04"), "it")
    like_unknown = {"nak": NAK, "ack_ignore": ACK, "silent": b""}
    readings = ["as_unknown"] * (
        exchange.raw == like_unknown[session.reading("unknown_command")]
    ) + ["ack"] * (exchange.raw == ACK)
    if not readings:
        session.fail(("MSC-LNK-02", "MSC-LNK-04"), ["like an unknown command", "ACK"], exchange)
    link.reading("empty_body", readings, ("MSC-LNK-02", "MSC-LNK-04"))
    link.alive("MSC-LNK-02")


@check("MSC-LNK-02", "MSC-LNK-03", safety="rig", needs=("bench",))
def a_character_without_its_stop_bit_spoils_its_packet(session: Session) -> None:
    """A framing error in header or checksum of RQSTAT draws NAK at the packet's end; or the byte
    counts as it is, or is lost, if this device reads it so; between packets it does nothing.
    (UART error in IDLE, HDR, CSUM, WAIT)"""
    link = Link(session)
    if session.target.description.startswith("socket:"):
        session.skip("a plain socket carries bytes, not a rate")
    link.calm()
    session.target.drain()
    _spoilt(link)
    link.nothing_more("MSC-LNK-02", "a framing error between packets")
    link.alive("MSC-LNK-02")
    raw = codec.packet(link.unit, RQSTAT)  # its block number is 0000h, as the spoilt byte is
    for place in SPOILT_AT.values():
        session.target.drain()
        sent_ns = session.target.send(raw[:place])
        _spoilt(link)
        session.target.send(raw[place + 1 :])
        link.reading("uart_error", _uart_reading(link, sent_ns, place), "MSC-LNK-02")
        link.alive(("MSC-LNK-02", "MSC-LNK-03"))
    first = link.unanswered()
    _spoilt(link)
    again = link.refuse_in("MSC-LNK-02")
    is_same = again is not None and link.is_same(again, first)
    session.expect(is_same, "MSC-LNK-02", "the repeat to a NAK behind it", again)
    session.target.send(ACK)
    link.alive("MSC-LNK-03")


def _spoilt(link: Link) -> None:
    """Send one character that has no stop bit, once all before it has left."""
    target = link.target
    rate = target.baud
    target.wait(codec.REQUEST_BYTES["RQSTAT"] * link.byte_ns / 1e9 + link.spare_ns / 1e9)
    try:
        target.baud = HALF_RATE
        target.send(SPOILT_CHARACTER)
        target.wait(4 * link.byte_ns / 1e9 + link.spare_ns / 1e9)
    finally:
        target.baud = rate


def _uart_reading(link: Link, sent_ns: int, place: int) -> tuple[str, ...]:
    """What is read from the answer to an RQSTAT with one character spoilt (MSC-AMB-43)."""
    heard = link.talk.hear(1, link.packet_timeout_s * 1.5 + link.glance_s)
    came_ns = link.target.now_ns
    count = codec.REQUEST_BYTES["RQSTAT"] - 1
    if heard == ACK:
        link.talk.hear_packet()
        link.target.send(ACK)
        return ("use_byte",)
    link.session.expect(heard == NAK, "MSC-LNK-02", "NAK or ACK", heard.hex(" ") or "nothing")
    link.nothing_more("MSC-LNK-02", "NAK")
    if came_ns >= link.sign_window(sent_ns, count).earliest_ns:
        return ("drop_byte",)
    # In the checksum 00 is wrong in any case.
    return ("bad_packet",) if place == SPOILT_AT["header"] else ("bad_packet", "use_byte")


@check("MSC-PHY-04", "MSC-PHY-03", safety=("rig", "motion"), needs=("rig:power",))
def power_up_says_nothing(session: Session) -> None:
    """Neither losing its supply nor getting it back makes a unit say anything, be it idle, inside a
    packet, or waiting for the host's sign; then it serves, counting from 0.  (power cycle)"""
    link = Link(session)
    longer_s = max(link.packet_timeout_s, link.ack_timeout_s) * 1.2 + START_S
    was_running = link.status() & RUNNING
    for state in ("idle", "inside a packet", "waiting for a sign"):
        if state == "inside a packet":
            session.target.send(link.talk.request(RQSTAT)[:9])
            session.target.wait(0.05)
        elif state == "waiting for a sign":
            link.unanswered()
            session.step(link.refuse_in("MSC-PHY-04") is not None, "a repeat", "nothing")
        session.rig.power_off()
        names = ("MSC-PHY-04", "MSC-PHY-03")
        link.nothing_more(names, f"a power cut while {state}", link.glance_s)
        session.rig.power_on()
        link.nothing_more(names, f"power-up after a cut while {state}", longer_s)
        link.alive("MSC-PHY-04")
        link.unanswered()
        for number in range(link.limit):
            told = f"repeat {number + 1} of {link.limit}"
            session.expect(link.refuse_in("MSC-PHY-04") is not None, "MSC-PHY-04", told, "nothing")
        session.target.send(ACK)
        link.nothing_more("MSC-PHY-04", "the last repeat")
    if was_running and not link.status() & RUNNING and "program" in session.rig.capabilities:
        session.rig.run_program(True)
