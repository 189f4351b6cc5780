"""Which bytes are a packet, and what a unit's own packets look like (PHY, PKT).

What is wrong on purpose here is RQSTAT or DREAD: a unit that takes it for right has done nothing.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MscExchange
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, STX, Packet
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.link import FILLER, RS232_UNIT

ORDER = 10  # of this module in a run; see `Family.modules`

XON_XOFF: Final = 0x11131113
# Every byte that a careless receiver takes for something else, and the ends of the range.
LOADED_VALUES: Final = (
    XON_XOFF, 0x02020202, 0x06060606, 0x15151515, 0x02010007, 0x0D0A0D0A, 0x1A1B7F08, 0x2C2C2C2C,
    0x10101010, 0x1B1B7D7D, 0x00000000, 0xFFFFFFFF, 0x80808080, 0x7FFFFFFF,
)  # fmt: skip
BLOCKS: Final = (
    0x0001, 0x00FF, 0x0100, 0x1234, 0x4321, 0x0202, 0x0606, 0x1515, 0x0215, 0x1113, 0xFFFF,
)  # fmt: skip
COUNTED_AT_MOST: Final = 25  # a unit's own counter has moved on by retries, on a noisy line
ODD_AND_EVEN: Final = (RQSTAT, codec.rflag(0))
ASCII_ONE: Final = 0x31  # what a host sends that takes the number for text (ERR-06)
SWAPPED: Final = (0x0408, 0x0804)  # two addresses of which each is the other's bytes exchanged
INVALID_UNITS: Final = (0, 16, ASCII_ONE, 0xFF)
OTHER_UNITS: Final = range(2, 16)
# The ends of what a body may have, and of what seven and eight bits, or a buffer, can count.
SIZES: Final = (0, 1, 2, 6, 7, 63, 64, 100, 127, 128, 137, 138, 200, 239, 240)
SIZES_REAL: Final = (0, 1, 127, 128, 239, 240)
SUM_WITH_A_START: Final = 0x7002  # more than any of them adds up to; who stops early hears its 02h


# --- a unit's own packets -------------------------------------------------------------------------


@check(
    "MSC-PKT-01", "MSC-PKT-02", "MSC-PKT-03", "MSC-PKT-06", "MSC-PKT-08", "MSC-PKT-10",
    "MSC-PKT-11", "MSC-PKT-12", "MSC-PKT-16", "MSC-PKT-17", "MSC-PKT-18", "MSC-LNK-11",
)  # fmt: skip
def every_reply_is_a_packet_as_the_manual_draws_it(session: Session) -> None:
    """The reply to each reading command is 02h, the unit, length, block, body, checksum; no more
    than 240 bytes of body, and nothing behind it, our ACK to it or not."""
    driver = MscDriver(session)
    for body in driver.reads():
        judge_reply(driver, driver.ask(body, 0x1234))
        text = codec.explain_request(driver.client.request(body))
        driver.link.nothing_more(("MSC-PKT-16", "MSC-LNK-11"), f"the reply to {text}")
    _judge_end(driver)


def _judge_end(driver: MscDriver) -> None:
    """A byte right behind a reply our own ACK would cover; a repeat, after T2, is none."""
    driver.link.unanswered()
    at_once_ns = 2 * driver.link.byte_ns + driver.session.target.uncertainty_ns
    behind = driver.client.receive(1, min(at_once_ns / 1e9, driver.link.glance_amid_wait_s))
    driver.session.target.send(ACK)
    driver.session.expect(
        not behind.strip(STX), "MSC-PKT-16", "nothing behind a reply", codec.explain(behind)
    )


def judge_reply(driver: MscDriver, exchange: MscExchange) -> Packet:
    """Judge the bytes behind an ACK as a packet (PKT), whatever it means; return it."""
    session, raw = driver.session, exchange.raw[1:]
    text = codec.explain_request(exchange.request)
    session.step(exchange.sign == ACK and bool(raw), f"ACK and a packet ({text})", exchange)
    first = (exchange.extra or raw)[0]  # what comes before a packet is set apart
    session.expect(first == 2, ("MSC-PKT-02", "MSC-PKT-17"), "02h first", f"{first:02X}h")
    packet = codec.parse(raw)
    if packet is None:
        session.fail(("MSC-PKT-01", "MSC-PKT-17"), "8 bytes and a body", f"{len(raw)} bytes")
    session.expect(packet.unit in codec.UNITS, "MSC-PKT-03", "unit 1 to 15", packet.unit)
    session.expect(packet.unit == driver.unit, "MSC-PKT-18", f"unit {driver.unit}", packet.unit)
    _judge_length(driver, packet)
    right = codec.checksum(raw[1:-2])
    order = f"{right:04X}, high byte first"
    swapped = int.from_bytes(codec.u16(right), "little")
    is_swapped = packet.checksum == swapped != right
    session.expect(not is_swapped, "MSC-PKT-11", order, f"{packet.checksum:04X}")
    session.expect(
        packet.checksum == right,
        "MSC-PKT-12",
        f"{right:04X}, the sum of what stands between",
        f"{packet.checksum:04X}",
    )
    return packet


def _judge_length(driver: MscDriver, packet: Packet) -> None:
    """Judge what a reply announces; of one that announces too much no more than 240 bytes are
    heard, and from one that goes low byte first as many as it says.  Where the sum is wrong too,
    it is the length that is."""
    session, announced = driver.session, packet.length
    right = (
        driver.client.reply_bytes(packet.name) - codec.AROUND_BODY
        if packet.name in codec.READS
        else 0
    )
    is_swapped = announced == int.from_bytes(codec.u16(right), "little") != right
    text = f"{codec.u16(right).hex(' ')}, high byte first"
    is_extended = right and announced == right - 0x100 & 0xFFFF and right & 0x80
    session.expect(
        not is_swapped and not is_extended, "MSC-PKT-08", text, codec.u16(announced).hex(" ")
    )
    most = f"{codec.MAX_BODY} at most"
    session.expect(announced <= codec.MAX_BODY, ("MSC-PKT-10", "MSC-PKT-16"), most, announced)
    names, size = ("MSC-PKT-01", "MSC-PKT-06", "MSC-PKT-17"), len(packet.body)
    session.expect(announced == size, names, f"length {size}, as the body has", announced)
    is_short = announced < right and not packet.is_sound
    session.expect(not is_short, names, f"length {right}, as the body has", announced)


@check("MSC-PKT-04", needs=("alone",))
def on_rs232_replies_carry_unit_1(session: Session) -> None:
    """On RS-232 every reply carries 01h, the byte and not the character."""
    driver = MscDriver(session)
    if driver.link.is_rs485:
        session.skip("this unit is on RS-485, where its switch sets the number")
    for body in driver.reads():
        reply = driver.ask(body).reply
        seen = None if reply is None else reply.unit
        session.expect(seen == RS232_UNIT, None, f"unit {RS232_UNIT}", seen)


@check("MSC-PKT-07")
def bodies_of_odd_and_of_even_length_are_served(session: Session) -> None:
    """RQSTAT with 7 bytes and RFLAG with 8 draw replies with 15 and 8, RFLAGS one with 39."""
    driver = MscDriver(session)
    bodies = [*ODD_AND_EVEN, *([codec.RFLAGS] if driver.has_rflags else [])]
    for body in bodies:
        exchange = driver.ask(body)
        name = body.partition(codec.COMMA)[0].decode()
        size = driver.client.reply_bytes(name) - codec.AROUND_BODY
        seen = None if exchange.reply is None else exchange.reply.length
        session.expect(seen == size, None, f"ACK, and {size} bytes of reply to {name}", exchange)


@check("MSC-PKT-07", "MSC-PKT-08", safety="stored", needs=("variables",))
def the_longest_body_is_served_and_its_reply_tells_134(session: Session) -> None:
    """BWRITE's body of 137 bytes is ACKed; BREAD's reply announces 134 as 00 86."""
    driver = MscDriver(session)
    spot = driver.scratch.block_spot()
    values = [*range(1, codec.BLOCK_VALUES + 1)]
    exchange = driver.ask(codec.bwrite(spot, values))
    session.expect(exchange.is_acked, "MSC-PKT-07", "ACK to 137 bytes of body", exchange)
    exchange = driver.ask(codec.bread(spot))
    length = exchange.raw[3:5]
    session.expect(length == b"\x00\x86", "MSC-PKT-08", "length 00 86", length.hex(" "))


# --- fields of a request --------------------------------------------------------------------------


@check("MSC-PKT-09", "MSC-PKT-15", "MSC-PKT-19", "MSC-PHY-05")
def any_block_number_is_served_alike(session: Session) -> None:
    """RQSTAT with any block number, 0202h, 0606h, 1515h and 1113h among them, gets the same reply;
    its own block number is 0000h, or as this device reads that."""
    driver = MscDriver(session)
    driver.link.calm("other_unit_framing")
    plain = driver.query(RQSTAT)
    sent, got = [0], [plain.block]
    for block in (*BLOCKS, BLOCKS[-1]):  # the last one twice: no number marks a repeat
        exchange = driver.ask(RQSTAT, block)
        reply = exchange.reply
        names = ("MSC-PKT-09", "MSC-PKT-15", "MSC-PHY-05")
        if reply is not None and driver.link.specified(reply) != driver.link.specified(plain):
            plain = driver.query(RQSTAT)  # the status itself may have changed
            sent, got = [*sent, 0], [*got, plain.block]
        is_same = (
            exchange.is_acked
            and reply is not None
            and driver.link.specified(reply) == driver.link.specified(plain)
        )
        text = f"ACK and the body of block 0 to block {block:04X}h"
        session.expect(is_same, names, text, exchange)
        assert reply is not None
        sent, got = [*sent, block], [*got, reply.block]
    seen = block_readings(sent, got)
    if not seen:
        session.fail("MSC-PKT-19", ["0000h", "the request's", "a counter"], _hex(got))
    driver.reading("reply_block", seen, "MSC-PKT-19")


def block_readings(sent: Sequence[int], got: Sequence[int]) -> tuple[str, ...]:
    """The readings of MSC-AMB-10 that explain the block numbers of replies."""
    steps = [after - before & 0xFFFF for before, after in itertools.pairwise(got)]
    fitting = {
        "zero": not any(got),
        "echo": list(got) == list(sent),
        "counter": all(0 < step <= COUNTED_AT_MOST for step in steps),
    }
    return tuple(name for name, fits in fitting.items() if fits)


def _hex(numbers: Sequence[int]) -> str:
    return " ".join(f"{number:04X}" for number in numbers)


@check("MSC-PKT-15", "MSC-PKT-11")
def bytes_02h_06h_and_15h_of_body_and_checksum_are_no_signs(session: Session) -> None:
    """RFLAG of flags 2, 6 and 21 is served, and RQSTAT whose checksum has 02h, 06h, 13h or 15h in
    it; two bytes of body under a wrong sum are refused at their end.
    (HDR, BODY and CSUM 02h, 06h, 15h, other)"""
    driver = MscDriver(session)
    driver.link.calm("other_unit_framing")
    cut = codec.with_wrong_checksum(driver.client.request(RQSTAT[:2]))
    driver.link.sign(cut, NAK, "MSC-PKT-15", "a length of 02h")
    plain = codec.checksum(driver.client.request(RQSTAT)[1:-2])
    for low in (0x02, 0x06, 0x11, 0x13, 0x15):
        # What the block number adds makes the low byte of the sum; the high one is 02h or 03h.
        added = (low - plain) % 0x100
        for block in (added, added << 8):
            exchange = driver.ask(RQSTAT, block)
            text = codec.explain_request(exchange.request)
            is_served = exchange.is_acked and exchange.reply is not None
            names = ("MSC-PKT-15", "MSC-PKT-11")
            session.expect(is_served, names, f"ACK and a reply to {text}", exchange)
    for flag in (0x02, 0x06, 0x15, 0x13):
        exchange = driver.ask(codec.rflag(flag))
        is_served = exchange.is_acked and exchange.reply is not None
        session.expect(is_served, "MSC-PKT-15", f"ACK and a reply to flag {flag}", exchange)


@check("MSC-PKT-10", "MSC-PKT-15", "MSC-LNK-04", "MSC-LNK-22")
def a_body_of_any_size_is_taken_to_its_end(session: Session) -> None:
    """A body of 0 to 240 bytes under a wrong sum, a whole RQSTAT in it where there is room, draws
    one NAK, and the packet behind it is served.  (BODY, CSUM)"""
    driver = MscDriver(session)
    driver.link.calm()
    inner = driver.client.request(RQSTAT)
    for size in SIZES if session.target.is_virtual else SIZES_REAL:
        if not driver.link.has_time_for(codec.AROUND_BODY + size):
            session.note(f"T1 runs out while {size} bytes of body are being sent")
            continue
        room = size - len(inner)
        body = RQSTAT.ljust(room, FILLER) + inner if room > len(RQSTAT) else RQSTAT
        raw = codec.packet(driver.unit, body.ljust(size, FILLER)[:size], checksum=SUM_WITH_A_START)
        text = f"{size} bytes of body under a wrong sum"
        names = ("MSC-PKT-10", "MSC-PKT-15", "MSC-LNK-04")
        exchange = driver.link.sign(raw, NAK, names, text)
        # A port or a bridge may hand bytes on sooner than the rate lets them go.
        is_exact, at_ns = session.target.is_virtual, exchange.signed_ns
        is_early = is_exact and driver.link.is_amid(exchange.asked_ns, len(raw), at_ns)
        took = f"NAK after {(exchange.signed_ns - exchange.asked_ns) / 1e6:.1f} ms"
        session.expect(not is_early, names, f"NAK at the end of {len(raw)} bytes", took)
        driver.link.alive(("MSC-LNK-22", "MSC-PKT-15", "MSC-PKT-10"))


@check("MSC-PKT-03", "MSC-PKT-04", needs=("alone",))
def on_rs232_other_unit_numbers_are_not_its_own(session: Session) -> None:
    """RQSTAT to another number than 1 draws silence on RS-232, or what this device reads there."""
    driver = MscDriver(session)
    if driver.link.is_rs485:
        session.skip("this unit is on RS-485, where other numbers are other units'")
    others = OTHER_UNITS if session.target.is_virtual else (2, 3, 8, 15)
    for unit in others:
        seen = _to_other(driver, unit)
        if isinstance(seen, MscExchange):
            session.fail("MSC-PKT-04", ["silence", "NAK", "ACK and a reply"], seen)
        driver.reading("rs232_unit_check", seen, "MSC-PKT-04")
    for unit in INVALID_UNITS:
        seen = _to_other(driver, unit)
        if seen == ("ignore",) and session.reading("rs232_unit_check") == "ignore":
            continue  # a unit that looks at no number takes this one too
        if isinstance(seen, MscExchange) or seen == ("ignore",):
            session.fail("MSC-PKT-03", ["silence", "NAK"], seen)
        readings = (*seen, "broadcast") if "silent" in seen else seen
        driver.reading("invalid_unit", readings, "MSC-PKT-03")
    driver.link.alive("MSC-PKT-04")


def _to_other(driver: MscDriver, unit: int) -> tuple[str, ...] | MscExchange:
    """What RQSTAT to another number shows: readings of MSC-AMB-12, or what explains none."""
    raw = codec.packet(unit, RQSTAT)
    sign_s = (len(raw) * driver.link.byte_ns + driver.link.latency_ns) / 1e9
    exchange = driver.client.ask(raw, is_read=True, timeout_s=sign_s + 0.1)
    is_hunting = driver.session.reading("other_unit_framing") == "hunt_stx"
    # What it takes for a packet behind the number ends with T1.
    hunting_s = driver.client.packet_timeout_s * 1.2 if is_hunting else 0
    extra = driver.client.listen(driver.link.glance_s + hunting_s)
    reply = exchange.reply
    seen = MscExchange(raw, exchange.sign, reply, exchange.extra + extra)
    if seen.is_silence:
        return ("silent",)
    refuses_noise = driver.session.reading("noise_in_idle") == "nak"
    if not seen.raw.strip(NAK) and (is_hunting or (refuses_noise and not seen.is_naked)):
        return ("silent", "nak")  # it may have refused only what is behind the number
    if seen.is_naked:
        return ("nak",)
    number = {RS232_UNIT: "own", unit: "echo"}.get(reply.unit) if reply is not None else None
    if not seen.is_acked or reply is None or not reply.is_sound or number is None:
        return seen
    driver.reading("reply_unit", number, "MSC-PKT-04")
    return ("ignore",)


def _without_start(address: int) -> int:
    """A value with which a DWRITE to unit 0 has no 02h behind its own: a unit that hunts for one in
    what is not for it would take that for a packet of its own, and refuse it at T1."""
    for value in range(3, 0x100):
        raw = codec.packet(0, codec.dwrite(address, value))
        if STX not in raw[1:]:
            return value
    return 3  # the address has one


@check("MSC-PKT-03", safety="stored", needs=("variables", "alone"))
def unit_0_is_no_broadcast(session: Session) -> None:
    """A DWRITE to unit 0 stores nothing, unless this device reads 0 as everybody."""
    driver = MscDriver(session)
    spot = driver.scratch.spot()
    driver.write(spot, 1)
    value = _without_start(spot)
    raw = codec.packet(0, codec.dwrite(spot, value))
    exchange = driver.client.ask(raw, is_read=False)
    more = driver.client.listen(driver.link.glance_s)  # of who hunts, and refuses what is no 02h
    driver.client.wait_until_quiet()  # a unit that hunts for 02h may have found some
    held = driver.read(spot)
    if exchange.is_naked and held == 1:
        driver.reading("invalid_unit", ("silent", "nak") if more else "nak")
    elif exchange.is_silence and held in (1, value):
        driver.reading("invalid_unit", "silent" if held == 1 else "broadcast")
    elif session.reading("rs232_unit_check") != "ignore" or driver.link.is_rs485:
        session.fail(None, "silence or NAK, and the value as it was", f"{exchange}, {held}")
    else:
        session.not_run(None, "this unit looks at no number, so 0 is like any other")


# --- checksums ------------------------------------------------------------------------------------


def _crc(data: bytes, polynomial: int, start: int) -> int:
    crc = start
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (polynomial if crc & 0x8000 else 0)) & 0xFFFF
    return crc


def _words(data: bytes) -> int:
    even = data + b"\x00" * (len(data) % 2)
    return sum(int.from_bytes(even[at : at + 2], "big") for at in range(0, len(even), 2)) & 0xFFFF


def _all_xored(data: bytes) -> int:
    result = 0
    for byte in data:
        result ^= byte
    return result


def _one_complement(data: bytes) -> int:
    return ~sum(data) & 0xFFFF


# What somebody may compute who has not read it well: of all bytes from the unit to the end of the
# body, as (header from the unit on, body).
WRONG_SUMS: Final[Mapping[str, Callable[[bytes, bytes], int]]] = {
    "the 02h summed too": lambda header, body: sum(header + body) + 2,
    "the unit left out": lambda header, body: sum(header[1:] + body),
    "the length left out": lambda header, body: sum(header[:1] + header[3:] + body),
    "the block number left out": lambda header, body: sum(header[:3] + body),
    "the header left out": lambda header, body: sum(body),
    "the body left out": lambda header, body: sum(header),
    "the comma left out": lambda header, body: sum(header + body) - 0x2C,
    "the last byte left out": lambda header, body: sum((header + body)[:-1]),
    "the high byte dropped": lambda header, body: sum(header + body) & 0xFF,
    "the low byte dropped": lambda header, body: sum(header + body) & 0xFF00,
    "low byte first": lambda header, body: int.from_bytes(codec.u16(sum(header + body)), "little"),
    "one too many": lambda header, body: sum(header + body) + 1,
    "one too few": lambda header, body: sum(header + body) - 1,
    "100h too many": lambda header, body: sum(header + body) + 0x100,
    "100h too few": lambda header, body: sum(header + body) - 0x100,
    "8000h too many": lambda header, body: sum(header + body) + 0x8000,
    "negated": lambda header, body: -sum(header + body),
    "inverted": lambda header, body: _one_complement(header + body),
    "exclusive or": lambda header, body: _all_xored(header + body),
    "words summed": lambda header, body: _words(header + body),
    "CRC-16 of CCITT": lambda header, body: _crc(header + body, 0x1021, 0xFFFF),
    "CRC-16 of XMODEM": lambda header, body: _crc(header + body, 0x1021, 0),
    "nothing": lambda header, body: 0,
    "all bits": lambda header, body: 0xFFFF,
}


@check("MSC-PKT-12", "MSC-PKT-11", "MSC-LNK-02", "MSC-LNK-05", "MSC-LNK-22")
def every_other_checksum_is_refused(session: Session) -> None:
    """RQSTAT and DREAD with a checksum that is a usual mistake get one NAK; with the right one they
    are served, also right after a NAK."""
    driver = MscDriver(session)
    bodies = [RQSTAT, *(codec.dread(address) for address in driver.scratch.spots(1))]
    blocks = (0x1234, 0xA500) if session.target.is_virtual else (0x1234,)
    for body in bodies:
        for block in blocks:
            _refuse_all(driver, body, block)


def _refuse_all(driver: MscDriver, body: bytes, block: int) -> None:
    right = driver.client.request(body, block)
    names = ("MSC-LNK-02", "MSC-PKT-12", "MSC-LNK-05")
    for how, wrong_sum in WRONG_SUMS.items():
        wrong = wrong_sum(right[1:6], body) & 0xFFFF
        if wrong == codec.checksum(right[1:-2]):
            continue
        raw = codec.packet(driver.unit, body, block, checksum=wrong)
        own = ("MSC-PKT-11",) if how == "low byte first" else ()
        driver.link.sign(raw, NAK, (*names, *own), f"a checksum with {how}")
    exchange = driver.ask(body, block)
    is_served = exchange.is_acked and exchange.reply is not None
    names = ("MSC-PKT-12", "MSC-PKT-11", "MSC-LNK-22")
    driver.session.expect(
        is_served, names, "ACK and a reply under the right sum", exchange.observed
    )


@check("MSC-PKT-12", "MSC-PKT-11", safety="stored", needs=("variables",))
def sums_above_32767_are_still_sums(session: Session) -> None:
    """BWRITE of 32 times -1, whose bytes sum up to more than 7FFFh, is ACKed, and its BREAD has the
    right sum."""
    driver = MscDriver(session)
    spot, values = driver.scratch.block_spot(), [-1] * codec.BLOCK_VALUES
    names = ("MSC-PKT-12", "MSC-PKT-11")
    exchange = driver.ask(codec.bwrite(spot, values), 0xFFFF)
    session.expect(exchange.is_acked, names, "ACK", exchange)
    reply = driver.ask(codec.bread(spot)).reply
    is_right = reply is not None and reply.is_sound and list(reply.values) == values
    session.expect(is_right, names, "32 times -1 under the right sum", reply)


# --- values ---------------------------------------------------------------------------------------


@check("MSC-PKT-14", safety="stored", needs=("variables",))
def numbers_go_high_byte_first(session: Session) -> None:
    """1 comes back as 00 00 00 01, and what is written to one address is not found at the address
    with its bytes exchanged."""
    driver = MscDriver(session)
    spot = driver.scratch.spot()
    for value in (1, 0x01020304, -2):
        driver.write(spot, value)
        payload = driver.query(codec.dread(spot)).payload
        text = codec.i32(value).hex(" ")
        session.expect(payload == codec.i32(value), None, text, payload.hex(" "))
    if not set(SWAPPED) <= set(driver.scratch.variables):
        return
    for number, address in enumerate(SWAPPED, 1):
        driver.write(address, number)
    seen = tuple(driver.read(address) for address in SWAPPED)
    session.expect(seen == (1, 2), None, f"1 at {SWAPPED[0]}, 2 at {SWAPPED[1]}", seen)


@check("MSC-PHY-05", "MSC-PKT-15", safety="stored", needs=("variables",))
def no_byte_of_a_value_is_special(session: Session) -> None:
    """Values full of 02h, 06h, 15h, 11h, 13h and control characters go both ways, one ACK each."""
    driver = MscDriver(session)
    driver.link.calm("other_unit_framing")
    spot = driver.scratch.spot()
    names = ("MSC-PHY-05", "MSC-PKT-15")
    for value in LOADED_VALUES:
        text = f"{value:08X}"
        exchange = driver.ask(codec.dwrite(spot, value))
        session.expect(exchange.is_acked, names, f"one ACK to a write of {text}", exchange)
        driver.link.nothing_more(names, f"a write of {text}")
        reply = driver.ask(codec.dread(spot)).reply
        is_back = reply is not None and reply.payload == codec.i32(value)
        session.expect(is_back, names, text, reply)


def carrying(packet: bytes) -> list[int]:
    """32 values whose bytes hold that packet, from the second value on."""
    data = (b"\x00" * 4 + packet).ljust(4 * codec.BLOCK_VALUES, b"\x00")
    return list(struct.unpack(f">{codec.BLOCK_VALUES}i", data))


@check("MSC-PKT-15", "MSC-LNK-04", safety="stored", needs=("variables",))
def a_packet_inside_a_packet_is_data(session: Session) -> None:
    """BWRITE of values that hold a whole RQSTAT for this unit draws one ACK, and BREAD returns
    them."""
    driver = MscDriver(session)
    driver.link.calm("other_unit_framing")
    spot, values = driver.scratch.block_spot(), carrying(driver.client.request(RQSTAT))
    names = ("MSC-PKT-15", "MSC-LNK-04")
    exchange = driver.ask(codec.bwrite(spot, values))
    session.expect(exchange.is_acked, names, "one ACK", exchange)
    driver.link.nothing_more(names, "the ACK to a BWRITE that holds a packet")
    reply = driver.ask(codec.bread(spot)).reply
    is_back = reply is not None and list(reply.values) == values
    session.expect(is_back, "MSC-PKT-15", "the values as written", reply)
    driver.link.alive("MSC-PKT-15")


# --- what is no packet ----------------------------------------------------------------------------

NOISE: Final = (b"\x00\xff\x41", b"\x00", b"\xff", b"RQSTAT,", b"\r\n", b"\x11\x13\x1a\x1b\x7f")


@check("MSC-PKT-20")
def bytes_that_start_no_packet_are_ignored(session: Session) -> None:
    """Bytes without 02h draw nothing from an idle unit, or what this device reads there; the packet
    right behind them is served once."""
    driver = MscDriver(session)
    for noise in NOISE:
        judge_noise(driver, noise, "MSC-PKT-20")
    if session.reading("noise_in_idle") == "ignore":
        for noise in NOISE:  # without a pause between
            exchange = driver.client.ask(noise + driver.client.request(RQSTAT), is_read=True)
            is_served = exchange.is_acked and exchange.reply is not None
            session.expect(is_served, None, "one ACK and one reply", exchange)
            driver.link.nothing_more("MSC-PKT-20", "the reply")
    driver.link.alive("MSC-PKT-20")


def judge_noise(driver: MscDriver, noise: bytes, names: str) -> None:
    """Send bytes without 02h to an idle unit, and judge what comes (MSC-AMB-30)."""
    received = driver.link.drawn_by(noise)
    # Several units that refuse at once garble each other; on two wires one garbles what is sent.
    talks_over = len(noise) > 1 and driver.session.reading("noise_in_idle") == "nak"
    is_refused = (
        not received.strip(NAK)
        or bool(driver.session.neighbours)
        or (talks_over and received.endswith(NAK))
    )
    if received and not is_refused:
        driver.session.fail(names, ["nothing", "NAK"], codec.explain(received))
    readings: tuple[str, ...] = ("nak",) if received else ("ignore",)
    if not received and (talks_over or (driver.session.neighbours and len(noise) > 1)):
        readings = ("ignore", "nak")  # the host's last byte may have taken the NAK with it
    driver.reading("noise_in_idle", readings, names)


@check("MSC-PKT-21", safety="stored", needs=("variables",))
def the_manuals_example_is_a_valid_packet(session: Session) -> None:
    """The 21 bytes of the manual's example, to this unit, draw ACK, and 2008 then holds 1234."""
    driver = MscDriver(session)
    if 2008 not in driver.scratch.variables:
        session.skip("address 2008 is not among the variables that may be written (--variables)")
    example = bytes.fromhex("02 01 00 0D 00 00 44 57 52 49 54 45 2C 07 D8 00 00 04 D2 03 BE")
    if driver.unit != 1:
        example = codec.packet(driver.unit, example[6:-2])
    exchange = driver.client.ask(example)
    session.expect(exchange.is_acked, None, "ACK", exchange)
    session.expect(driver.read(2008) == 1234, None, "1234 at 2008", driver.read(2008))
