"""Several units on one line, characters that are none, power, and headers of impossible length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.link import must_serve_amid_a_wait
from axistwin_conformance.families.msc.checks.packets import INVALID_UNITS, SUM_WITH_A_START
from axistwin_conformance.families.msc.checks.repeats import is_surely
from axistwin_conformance.families.msc.checks.time import judge_broken_off, judge_pace
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import FILLER

ORDER = 40  # of this module in a run; see `Family.modules`

MOST_SIGNS: Final = 15  # one of each unit, if they do not speak at the same time
ROUNDS_REAL: Final = 12
ROUNDS: Final = 60
OTHERS_SIZES: Final = (0, 1, codec.MAX_BODY)
PAUSE_S: Final = 0.05  # between header and body: well within T1


def units(session: Session) -> list[MscDriver]:
    """Every unit that is on the line."""
    return [MscDriver(session, unit) for unit in (session.address, *session.neighbours)]


def absent(session: Session) -> int:
    """The number of a unit that is not on the line, and whose byte means nothing else."""
    taken = (session.address, *session.neighbours, 2, 6)
    return next(unit for unit in reversed(codec.UNITS) if unit not in taken)


def judge_skipped(driver: MscDriver) -> None:
    """Go on only where this device tells other units' packets from its own (MSC-AMB-12)."""
    if not driver.link.is_rs485 and driver.session.reading("rs232_unit_check") != "silent":
        seen = driver.session.reading("rs232_unit_check")
        driver.session.skip(f"on RS-232 this device has rs232_unit_check={seen}")


def judge_followed(driver: MscDriver) -> None:
    """Go on only where this device follows other units' packets by their length (MSC-AMB-14)."""
    if driver.session.reading("other_unit_framing") != "skip_by_length":
        driver.session.skip("this device has other_unit_framing=hunt_stx")


# --- somebody else's packets ----------------------------------------------------------------------


@check("MSC-PKT-15", "MSC-LNK-19")
def packets_for_others_are_followed_by_their_length(session: Session) -> None:
    """A packet for a unit that is not there, with a whole RQSTAT for this one and signs inside,
    draws nothing, unless this device hunts for 02h.  (SKIP 02h, 06h, 15h, other)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    inner = driver.client.request(RQSTAT)
    for inside in (inner, ACK + NAK + inner, b"\x00\xff" + inner + STX + NAK):
        body = RQSTAT + inside
        raw = codec.packet(absent(session), body, checksum=0x3030)
        session.target.drain()
        session.target.send(raw)
        received = driver.client.listen(len(raw) * driver.link.byte_ns / 1e9 + driver.link.glance_s)
        if received:
            # Who hunts may refuse each byte on the way as noise (MSC-AMB-30).
            taken = received.lstrip(NAK) if session.reading("noise_in_idle") == "nak" else received
            if taken[:1] != ACK:
                session.fail(("MSC-PKT-15", "MSC-LNK-19"), "nothing", codec.explain(received))
            session.target.send(ACK)
            driver.client.wait_until_quiet()
        seen = "hunt_stx" if received else "skip_by_length"
        driver.reading("other_unit_framing", seen, ("MSC-PKT-15", "MSC-LNK-19"))
        driver.link.alive("MSC-PKT-15")


@check("MSC-LNK-19", "MSC-LNK-04")
def what_breaks_off_for_others_draws_nothing(session: Session) -> None:
    """A packet for a unit that is not there, broken off or under a wrong checksum, draws nothing,
    not even when its time is over; then this unit serves.  (T1 in SKIP)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    whole = codec.packet(absent(session), codec.dread(0))
    longer_s = driver.client.packet_timeout_s * 1.2 + driver.link.glance_s
    for count in (2, 6, len(whole) - 1) if session.target.is_virtual else (6,):
        session.target.drain()
        session.target.send(whole[:count])
        text = f"{count} bytes for another unit"
        driver.link.nothing_more(("MSC-LNK-19", "MSC-LNK-04"), text, longer_s)
        driver.link.alive("MSC-LNK-19")
    span_s = len(whole) * driver.link.byte_ns / 1e9
    for offset in (1, 0x100):
        session.target.send(codec.with_wrong_checksum(whole, offset))
        text = "a wrong checksum for another unit"
        driver.link.nothing_more(("MSC-LNK-19", "MSC-LNK-04"), text, span_s + driver.link.glance_s)
    driver.link.alive("MSC-LNK-19")
    # Nor when the time of one that was whole is over.
    session.target.send(whole)
    driver.link.nothing_more("MSC-LNK-19", "a packet for another unit", longer_s)
    driver.link.alive("MSC-LNK-19")


@check("MSC-LNK-19", "MSC-LNK-16")
def a_packet_for_another_unit_amid_a_wait_draws_nothing(session: Session) -> None:
    """A packet for a unit that is not there, sent instead of the ACK, sound, under a wrong sum or
    broken off, draws nothing; the old reply is gone, or comes again at T2 if this device keeps it.
    (WAIT 02h; SKIP)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    must_serve_amid_a_wait(driver)
    whole = codec.packet(absent(session), RQSTAT)
    is_dropped = is_surely(session, "pending_reply_on_stx", "drop")
    names = ("MSC-LNK-19", "MSC-LNK-16")
    for raw in (whole, codec.with_wrong_checksum(whole), whole[:-1]):
        first = driver.link.unanswered()
        session.target.send(raw)
        text = f"{codec.explain_request(raw)} amid a wait"
        limits_s = (driver.client.packet_timeout_s, driver.client.ack_timeout_s)
        limit_s = len(raw) * driver.link.byte_ns / 1e9 + driver.link.glance_s
        limit_s += 1.2 * max(limits_s) if raw == whole[:-1] else 0.0
        again, strays = driver.client.receive_packet(limit_s)
        is_kept = not is_dropped and again is not None and driver.link.is_same(again, first)
        came = codec.explain(codec.bytes_of(again, strays)) or "nothing"
        session.expect(not strays and (again is None or is_kept), names, f"nothing to {text}", came)
        if not is_dropped:
            session.target.send(ACK)
        driver.link.alive(names)


@check("MSC-LNK-19")
def the_rest_of_another_units_packet_is_counted_off(session: Session) -> None:
    """An RQSTAT that lies where another unit's announced body is still to come is part of that,
    right behind the header or after a pause, and the one behind it is served, whatever size that
    body has.  (SKIP)"""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    inner = driver.client.request(RQSTAT)
    header = codec.packet(absent(session), b"", length=len(inner) - 2)[: codec.HEADER_BYTES]
    span_s = (len(header) + len(inner)) * driver.link.byte_ns / 1e9
    for pause_s in (0.0, PAUSE_S):
        session.target.drain()
        session.target.send(header)
        session.target.wait(pause_s)
        session.target.send(inner)
        text = "what another unit's header announced"
        driver.link.nothing_more("MSC-LNK-19", text, span_s + driver.link.glance_s)
        driver.link.alive("MSC-LNK-19")
    for size in OTHERS_SIZES:
        raw = codec.packet(absent(session), FILLER * size, checksum=SUM_WITH_A_START)
        if not driver.link.has_time_for(len(raw)):
            continue
        session.target.drain()
        session.target.send(raw)
        text = f"{size} bytes of body for another unit"
        own_s = len(raw) * driver.link.byte_ns / 1e9
        driver.link.nothing_more("MSC-LNK-19", text, own_s + driver.link.glance_s)
        driver.link.alive("MSC-LNK-19")


@check("MSC-LNK-19", safety=("stored", "negative"), needs=("variables",))
def a_write_for_another_unit_stores_nothing_here(session: Session) -> None:
    """DWRITE and BWRITE to a unit that is not there draw nothing and leave this unit's variables as
    they were."""
    driver = MscDriver(session)
    judge_skipped(driver)
    judge_followed(driver)
    spot = driver.scratch.block_spot()
    before = driver.values(codec.BLOCK_VALUES)
    driver.write_block(spot, before)
    for body in (codec.dwrite(spot, ~before[0]), codec.bwrite(spot, [~one for one in before])):
        raw = codec.packet(absent(session), body)
        session.target.drain()
        session.target.send(raw)
        span_s = len(raw) * driver.link.byte_ns / 1e9
        driver.link.nothing_more(
            "MSC-LNK-19", "a write for another unit", span_s + driver.link.glance_s
        )
        seen = list(driver.read_block(spot))
        session.expect(seen == before, None, "the variables as before", codec.listed(seen))


# --- several units --------------------------------------------------------------------------------


@check("MSC-PKT-05", "MSC-PKT-18", "MSC-LNK-19", "MSC-PHY-02", needs=("neighbour",))
def each_unit_answers_its_own_number_only(session: Session) -> None:
    """Each unit on the line answers its own number once, with that number in the reply; numbers of
    no unit get no answer, and 0 and those above 15 what this device gives them."""
    present = {driver.unit: driver for driver in units(session)}
    own = MscDriver(session)
    judge_followed(own)
    for unit in codec.UNITS:
        raw = codec.packet(unit, RQSTAT)
        if unit in present:
            exchange = present[unit].client.ask(raw)
            reply = exchange.reply
            is_own = exchange.is_acked and reply is not None and reply.unit == unit
            # A wrong number tells nothing of the two lines.
            is_wrong = reply is not None and reply.unit != unit
            names = ("MSC-PKT-18", "MSC-PKT-05", *(() if is_wrong else ("MSC-PHY-02",)))
            seen = exchange.observed()
            if exchange.is_acked and reply is not None:
                other = (
                    f", which is on the line as well: unit {reply.unit} answered, or unit {unit}"
                    " with a wrong number (alone on the line it shows which)"
                )
                seen = replace(
                    seen,
                    clause=f"the reply to {REQUEST} carried unit number {reply.unit}"
                    f"{other if reply.unit in present else ''}",
                    wanted=f"unit number {unit}",
                )
            session.expect(is_own, names, f"one reply of unit {unit}", seen)
            own.link.nothing_more("MSC-PKT-05", f"the reply of unit {unit}")
            judge_pace(present[unit], "MSC-PHY-02")
            continue
        session.target.drain()
        session.target.send(raw)
        span_s = len(raw) * own.link.byte_ns / 1e9
        text = f"RQSTAT to unit {unit}, which is not there"
        own.link.nothing_more(("MSC-PKT-05", "MSC-LNK-19"), text, span_s + own.link.glance_s)
    for unit in INVALID_UNITS:
        _judge_invalid(own, unit)
    own.link.alive("MSC-PKT-05")


def _judge_invalid(driver: MscDriver, unit: int) -> None:
    """What a shared line says to a number that no unit can have (MSC-AMB-13)."""
    raw = codec.packet(unit, RQSTAT)
    driver.target.drain()
    driver.target.send(raw)
    received = driver.client.listen(len(raw) * driver.link.byte_ns / 1e9 + driver.link.glance_s)
    if len(received) > MOST_SIGNS:
        text = f"nothing to unit {unit}"
        driver.session.fail("MSC-LNK-19", [text, "NAK of everybody"], codec.explain(received))
    # Several that refuse at once garble each other.
    readings = ("nak",) if received else ("silent", "broadcast")
    driver.reading("invalid_unit", readings, "MSC-LNK-19")


@check("MSC-LNK-19", "MSC-LNK-04", "MSC-LNK-03", needs=("neighbour",))
def broken_packets_for_one_unit_concern_it_alone(session: Session) -> None:
    """A wrong checksum, and a packet broken off, for one of the units draw exactly one NAK; the
    other units serve at once, and so does it after that."""
    line = units(session)
    for driver in line:
        raw = codec.with_wrong_checksum(driver.client.request(RQSTAT))
        driver.link.sign(
            raw, NAK, ("MSC-LNK-19", "MSC-LNK-04"), f"a wrong sum for unit {driver.unit}"
        )
        for other in line:
            other.link.alive("MSC-LNK-19")
        judge_broken_off(driver, 9)
        for other in line:
            other.link.alive("MSC-LNK-19")


def _turns(session: Session, line: list[MscDriver], rounds: int) -> Iterator[tuple[MscDriver, str]]:
    kinds = ["read", "read", "read", "flag", "wrong sum", "refused reply", "carrier"]
    for _ in range(rounds):
        yield session.random.choice(line), session.random.choice(kinds)


@check("MSC-PROP-14", "MSC-LNK-19", needs=("neighbour",), soaks=True)
def each_unit_behaves_as_if_alone(session: Session) -> None:
    """With several units on a line and exchanges interleaved at random, broken ones among them,
    each says what it says alone, and nobody else says anything."""
    line = units(session)
    line[0].link.calm()
    alone = {
        driver.unit: driver.link.specified(driver.link.alive("MSC-PROP-14")) for driver in line
    }
    for driver, kind in _turns(session, line, ROUNDS if session.target.is_virtual else ROUNDS_REAL):
        session.note(f"{kind} for unit {driver.unit}")
        if kind == "wrong sum":
            offset = session.random.randrange(1, 0x10000)
            raw = codec.with_wrong_checksum(driver.client.request(RQSTAT), offset)
            _draws(driver, raw, NAK)
        elif kind == "flag":
            exchange = driver.ask(codec.rflag(session.random.randrange(256)))
            name = exchange.reply.name if exchange.reply else ""
            session.expect(name == "RFLAG", "MSC-PROP-14", "a reply to RFLAG", exchange)
        elif kind == "carrier":
            if session.reading("other_unit_framing") == "skip_by_length":
                inside = session.random.choice(line).client.request(RQSTAT)
                raw = codec.packet(driver.unit, RQSTAT + inside, checksum=0x3030)
                _draws(driver, raw, NAK)
        else:
            if kind == "refused reply":
                first = driver.link.unanswered()
                again = driver.link.refuse_in("MSC-PROP-14")
                session.target.send(ACK)
                is_same = again is not None and driver.link.is_same(again, first)
                session.expect(is_same, "MSC-PROP-14", first, again)
            body = driver.link.specified(driver.link.alive("MSC-PROP-14"))
            if body != alone[driver.unit]:  # what it tells may have changed by itself
                alone[driver.unit] = driver.link.specified(driver.link.alive("MSC-PROP-14"))
            session.expect(body == alone[driver.unit], "MSC-PROP-14", alone[driver.unit], body)


def _draws(driver: MscDriver, raw: bytes, sign: bytes) -> None:
    """Judge that exactly that sign comes from a line of several units."""
    driver.target.drain()
    driver.target.send(raw)
    received = driver.client.listen(len(raw) * driver.link.byte_ns / 1e9 + driver.link.glance_s)
    text = codec.explain(received) or "nothing"
    names = ("MSC-PROP-14", "MSC-LNK-19")
    driver.session.expect(received == sign, names, codec.explain(sign), text)
