"""Several units on one line, characters that are none, power, and headers of impossible length."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.packets import INVALID_UNITS
from axistwin_conformance.families.msc.checks.time import judge_broken_off
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.link import Link

ORDER = 40  # of this module in a run; see `Family.modules`

MOST_SIGNS: Final = 15  # one of each unit, if they do not speak at the same time
ROUNDS_REAL: Final = 12
ROUNDS: Final = 60
PAUSE_S: Final = 0.05  # between header and body: well within T1


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
    """An RQSTAT that lies where another unit's announced body is still to come is part of that,
    right behind the header or after a pause, and the one behind it is served.  (SKIP)"""
    link = Link(session)
    judge_skipped(link)
    judge_followed(link)
    inner = link.talk.request(RQSTAT)
    header = codec.packet(absent(session), b"", length=len(inner) - 2)[: codec.HEADER_BYTES]
    span_s = (len(header) + len(inner)) * link.byte_ns / 1e9
    for pause_s in (0.0, PAUSE_S):
        session.target.drain()
        session.target.send(header)
        session.target.wait(pause_s)
        session.target.send(inner)
        told = "what another unit's header announced"
        link.nothing_more("MSC-LNK-19", told, span_s + link.glance_s)
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
