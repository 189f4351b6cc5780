"""Properties of packets and link that hold for whatever is drawn (PROP-01 to 07, 15 and 16).

What is drawn to be wrong is RQSTAT or DREAD; junk is drawn again until no device could take any of
it for a write, or for a command that nobody has documented.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.link import refusals
from axistwin_conformance.families.msc.checks.packets import judge_noise
from axistwin_conformance.families.msc.checks.time import finish, send_in_parts
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.safety import is_harmless

ORDER = 100  # of this module in a run; see `Family.modules`

BITS: Final = 8
LONGEST_JUNK: Final = 64
NOISE_BYTES: Final = 24
SHARE_OF_T1: Final = 0.8  # of the time limit that a packet in pieces is given, pauses included
MOST_REPEATS: Final = 5  # MSC-LNK-09
FEW: Final = 2  # rounds of what takes time-outs of a real line


def rounds(session: Session, number: int, on_a_line: int) -> int:
    """How many rounds: in virtual time waiting costs nothing."""
    return number if session.target.is_virtual else on_a_line


def drawn_read(driver: MscDriver, *, is_broken: bool = False) -> bytes:
    """The body of a reading command; one that is to be broken is RQSTAT or DREAD."""
    draw = driver.session.random
    bodies = [RQSTAT]
    if not is_broken:
        bodies += [codec.rflag(draw.randrange(256)), *([codec.RFLAGS] if driver.has_rflags else [])]
    if spots := driver.scratch.spots(1 << 16):
        spot = draw.choice(spots)
        bodies.append(codec.dread(spot))
        if not is_broken and spot + 127 in driver.scratch.variables:
            bodies.append(codec.bread(spot))
    return draw.choice(bodies)


@check("MSC-PROP-01", soaks=True)
def any_reply_is_sound_and_fits_its_request(session: Session) -> None:
    """Any reply has the unit's own number, the request's name, its size, and a right checksum."""
    driver = MscDriver(session)
    for _ in range(rounds(session, 60, 20)):
        body = drawn_read(driver)
        exchange = driver.ask(body, session.random.randrange(0x10000))
        reply, name = exchange.reply, body.partition(codec.COMMA)[0].decode()
        size = driver.client.reply_bytes(name)
        text = f"a sound {name} reply of unit {driver.unit} with {size} bytes"
        is_right = (
            exchange.is_acked
            and reply is not None
            and reply.is_sound
            and reply.unit == driver.unit
            and reply.name == name
            and len(reply.raw) == size
        )
        session.expect(is_right, None, text, exchange)


@check("MSC-PROP-02", soaks=True)
def block_numbers_change_no_reply(session: Session) -> None:
    """The same request with any block number draws the same body."""
    driver = MscDriver(session)
    for _ in range(rounds(session, 40, 10)):
        body, block = drawn_read(driver), session.random.randrange(0x10000)
        before = driver.link.specified(driver.query(body))
        exchange = driver.ask(body, block)
        if driver.link.specified(driver.query(body)) != before:
            continue  # what it reads changes by itself
        reply = exchange.reply
        is_same = exchange.is_acked and reply is not None and driver.link.specified(reply) == before
        session.expect(is_same, None, f"the body of block 0 to block {block:04X}h", exchange)


@check("MSC-PROP-03", soaks=True)
def packets_may_come_in_pieces(session: Session) -> None:
    """However a packet is cut and however long the pauses are, within T1 it is served like a whole
    one."""
    driver, draw = MscDriver(session), session.random
    span_s = SHARE_OF_T1 * driver.client.packet_timeout_s - driver.link.spare_ns / 1e9
    for _ in range(rounds(session, 24, FEW)):
        raw = driver.client.request(drawn_read(driver), draw.randrange(0x10000))
        count = draw.randrange(2, len(raw) + 1)
        places = [0, *sorted(draw.sample(range(1, len(raw)), count - 1)), len(raw)]
        own_s = len(raw) * driver.link.byte_ns / 1e9
        pauses = sorted(draw.uniform(0, max(span_s - own_s, 0)) for _ in range(count - 1))
        parts = [
            (at_s, raw[first:end])
            for at_s, first, end in zip((0.0, *pauses), places[:-1], places[1:], strict=True)
        ]
        received, _ = send_in_parts(driver, parts)
        text = f"ACK to {len(parts)} pieces within {span_s:.2f} s"
        session.expect(received == ACK, None, text, codec.explain(received) or "nothing")
        strays = finish(driver, received)
        session.expect(
            not strays, None, "one sign and one reply", f"{codec.explain(strays)} as well"
        )


@check("MSC-PROP-04", soaks=True)
def any_bit_turned_is_found(session: Session) -> None:
    """A read packet with any one bit turned in its body or checksum draws exactly one NAK."""
    driver = MscDriver(session)
    driver.link.calm()
    for body in [RQSTAT, *(codec.dread(address) for address in driver.scratch.spots(1))]:
        raw = driver.client.request(body, session.random.randrange(0x10000))
        places = range(codec.HEADER_BYTES * BITS, len(raw) * BITS)
        few = session.random.sample(places, rounds(session, len(places), 12))
        for place in few:
            index, bit = divmod(place, BITS)
            corrupted = raw[:index] + bytes([raw[index] ^ 1 << bit]) + raw[index + 1 :]
            exchange = driver.client.ask(corrupted)
            text = f"NAK with bit {bit} of byte {index} turned"
            session.expect(exchange.is_naked, None, text, exchange)
            if not session.target.is_virtual:
                continue  # a second sign would be set aside before the next packet
            driver.link.nothing_more("MSC-PROP-04", "the NAK")
        driver.link.nothing_more("MSC-PROP-04", "the NAKs")
    driver.link.alive("MSC-PROP-04")


@check("MSC-PROP-05", soaks=True)
def the_sum_does_not_see_bytes_exchanged(session: Session) -> None:
    """Two bytes of a block number or an address exchanged, or one raised by what another is lowered
    by, go unnoticed: such a packet is served for what it says."""
    driver, draw = MscDriver(session), session.random
    for _ in range(rounds(session, 24, 8)):
        high, low = draw.randrange(256), draw.randrange(256)
        sent = driver.client.request(RQSTAT, high << 8 | low)
        moved = draw.randrange(-min(high, 255 - low), min(255 - high, low) + 1)
        for first, second in ((low, high), (high + moved, low - moved)):
            corrupted = sent[:4] + bytes([first, second]) + sent[6:]
            exchange = driver.client.ask(corrupted)
            is_served = exchange.is_acked and exchange.reply is not None
            session.expect(is_served, None, "ACK and a reply: the sum is right", exchange)
    spots = set(driver.scratch.spots(1 << 16))
    pairs = [
        address
        for address in spots
        if _exchanged(address) in spots and _exchanged(address) != address
    ]
    for address in draw.sample(sorted(pairs), min(len(pairs), 4)):
        other = _exchanged(address)
        wanted = driver.read(other)
        sent = driver.client.request(codec.dread(address))
        corrupted = sent[:-4] + codec.u16(other) + sent[-2:]
        reply = driver.client.ask(corrupted).reply
        seen = None if reply is None else reply.values
        session.expect(seen == (wanted,), None, f"{wanted}, what is at {other}", seen)


def _exchanged(address: int) -> int:
    return int.from_bytes(codec.u16(address), "little")


@check("MSC-PROP-06", soaks=True)
def any_beginning_of_a_read_draws_one_nak(session: Session) -> None:
    """Any proper beginning of a read packet, then silence, draws one NAK, not before it is sent;
    then the unit serves."""
    driver, draw = MscDriver(session), session.random
    for _ in range(rounds(session, 16, 1)):
        raw = driver.client.request(drawn_read(driver, is_broken=True), draw.randrange(0x10000))
        count = draw.randrange(2, len(raw))  # a lone 02h may be anybody's (MSC-AMB-31)
        received, sent_ns, came_ns = driver.link.break_off(raw[:count])
        text = codec.explain(received) or "nothing"
        session.expect(received == NAK, None, f"NAK to {count} bytes of {raw.hex(' ')}", text)
        took_ns, own_ns = came_ns - sent_ns, count * driver.link.byte_ns
        session.expect(took_ns >= own_ns, None, f"not within {own_ns / 1e6:.1f} ms", took_ns / 1e6)
        driver.link.nothing_more("MSC-PROP-06", "the NAK")
        driver.link.alive("MSC-PROP-06")


@check("MSC-PROP-07", "MSC-LNK-10", soaks=True)
def each_nak_draws_one_repeat_up_to_the_limit(session: Session) -> None:
    """For any numbers of NAKs one after another, each draws one identical repeat, five at most."""
    driver = MscDriver(session)
    for _ in range(rounds(session, 24, 4)):
        count = session.random.randrange(driver.link.limit + 2)
        _, repeats = refusals(driver, count)
        wanted = min(count, driver.link.limit)
        session.expect(repeats == wanted, "MSC-PROP-07", f"{wanted} to {count} NAKs", repeats)
        if count >= MOST_REPEATS:
            seen = "5_repeats" if repeats == MOST_REPEATS else "5_total"
            session.quirk("MSC-PROP-07", "retransmit_limit", seen)
        driver.link.alive("MSC-PROP-07")


@check("MSC-PROP-15", soaks=True)
def bytes_without_02h_draw_nothing(session: Session) -> None:
    """Any bytes without 02h, sent to an idle unit, draw nothing, or what this device has."""
    driver, draw = MscDriver(session), session.random
    for _ in range(rounds(session, 30, 8)):
        size = draw.randrange(1, NOISE_BYTES)
        noise = bytes(draw.choice([*range(2), *range(3, 256)]) for _ in range(size))
        if session.reading("stray_nak") == "resend_last":
            noise = noise.replace(NAK, ACK)
        judge_noise(driver, noise, "MSC-PROP-15")
    driver.link.alive("MSC-PROP-15")


@check("MSC-PROP-16", soaks=True)
def after_any_junk_it_serves_again(session: Session) -> None:
    """After any junk, and the time in which what it began runs out, RQSTAT is served."""
    driver = MscDriver(session)
    junk = bytes(LONGEST_JUNK)
    for _ in range(rounds(session, 16, FEW)):
        session.target.send(junk)
        session.target.wait(len(junk) * driver.link.byte_ns / 1e9)
        for _ in junk:  # each of which may draw a NAK that takes its time (MSC-AMB-30)
            if not driver.client.wait_until_quiet():
                break
        driver.link.alive("MSC-PROP-16")
        junk = drawn_junk(driver)


def drawn_junk(driver: MscDriver) -> bytes:
    """Bytes with packets, parts of packets and spoilt ones among them, harmless to any device."""
    draw = driver.session.random
    for _ in range(1000):
        junk = b"".join(_piece(driver) for _ in range(draw.randrange(1, 5)))[:LONGEST_JUNK]
        if is_harmless(junk) and not _announces_too_much(junk):
            return junk
    return bytes(LONGEST_JUNK)


def _announces_too_much(junk: bytes) -> bool:
    """True if some of it may be a header with a length above 240: that is for a bench."""
    starts = (at for at in range(len(junk)) if junk[at : at + 1] == STX)
    return any(int.from_bytes(junk[at + 2 : at + 4], "big") > codec.MAX_BODY for at in starts)


def _piece(driver: MscDriver) -> bytes:
    draw = driver.session.random
    raw = bytearray(
        driver.client.request(drawn_read(driver, is_broken=True), draw.randrange(0x10000))
    )
    how = draw.randrange(6)
    if how == 0:
        return bytes(draw.randrange(256) for _ in range(draw.randrange(1, 20)))
    if how == 1:
        return bytes(raw[: draw.randrange(1, len(raw))])
    if how == 2:
        return bytes(raw[draw.randrange(1, len(raw)) :])
    if how == 3:
        return bytes(draw.choice((STX, ACK, NAK, b"\x01"))) * draw.randrange(1, 8)
    at = draw.randrange(1, len(raw))
    raw[at] = draw.randrange(256)
    if how == 4:
        del raw[draw.randrange(len(raw))]
    return bytes(raw)
