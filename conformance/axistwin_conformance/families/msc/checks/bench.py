"""What no sound host sends: unknown names, wrong sizes, places and flags that are not there.

Only on a bench, and on a real controller of reads alone: commands that nobody has documented load
and clear programs on the same port, and what is malformed may be carried out all the same.  Writes
of these kinds go to named places, where that does no harm, or to a twin only, whose places outside
the named ones are put back here.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import MscExchange
from axistwin_conformance.families.msc.codec import BLOCK_VALUES, RQSTAT
from axistwin_conformance.families.msc.driver import (
    ACKED,
    AS_UNKNOWN,
    NAKED,
    SERVED,
    MscDriver,
    Readings,
)
from axistwin_conformance.families.msc.scratch import SAFE_STRIDE, first_outside

ORDER = 150  # of this module in a run; see `Family.modules`

BENCH: Final = ("bench",)
LAST_PLACE: Final = 0xFFFC
ADDRESSES: Final = 0x10000
HALF: Final = BLOCK_VALUES // 2
COMMA_ADDRESSES: Final = (0x042C, 0x2C00, 0x2C04, 0x2C2C)
REAL_STEP: Final = 32
LOADED_BYTES: Final = (0x02, 0x06, 0x0A, 0x0D, 0x11, 0x13, 0x15, 0x1A, 0x2C, 0x7F, 0xFF)


# --- names ----------------------------------------------------------------------------------------


@check("MSC-CMD-10", safety="rig", needs=BENCH)
def a_name_nobody_knows_is_refused(session: Session) -> None:
    """A command that cannot exist draws NAK, or what this device has for it; with and without
    values, with as many as a body may have, and again."""
    driver = MscDriver(session)
    sizes = (
        BLOCK_VALUES * codec.VALUE_BYTES,
        codec.MAX_BODY - len(codec.body(codec.IMPOSSIBLE_NAME)),
    )
    most = [(bytes(size),) for size in sizes if driver.link.has_time_for(codec.MAX_PACKET)]
    for fields in ((), (b"\x00\x00",), (b"\x07\xd8\x00\x00\x04\xd2",), *most, ()):
        raw = driver.client.request(codec.body(codec.IMPOSSIBLE_NAME, *fields))
        driver.follows(raw, "unknown_command", AS_UNKNOWN, "MSC-CMD-10")
        driver.link.alive("MSC-CMD-10")


@check("MSC-CMD-07", "MSC-CMD-10", safety="rig", needs=BENCH)
def a_name_is_compared_from_end_to_end(session: Session) -> None:
    """The name of a reading command with a blank or a Z before or behind it is as unknown as any
    other: such as no maker has given."""
    driver = MscDriver(session)
    if session.reading("comma") != "required":
        session.skip("without a comma a name ends where this device takes it to end")
    names = {codec.name_of(body): body.partition(codec.COMMA)[2] for body in driver.reads()}
    for name, values in names.items():
        ahead = (f" {name}", f"Z{name}") if name == "RQSTAT" else ()
        for spelling in (f"{name}Z", f"{name} ", *ahead):
            raw = driver.client.request(codec.body(spelling, values))
            both = ("MSC-CMD-07", "MSC-CMD-10")
            driver.follows(raw, "unknown_command", AS_UNKNOWN, both)
    driver.link.alive("MSC-CMD-07")


def _as_unknown_or(driver: MscDriver, kind: str, switch: str) -> Readings:
    """What an unknown command draws stands for the default reading of a switch, another thing for
    the second; what is the same in both tells nothing."""
    default, other = driver.session.run.ledger.ambiguity_of(switch).switches[switch]
    same = driver.as_unknown == kind
    return {kind: (default, other) if same else other, driver.as_unknown: default} | (
        {kind: (default, other)} if same else {}
    )


@check("MSC-CMD-10", "MSC-CMD-02", "MSC-CMD-01", safety="rig", needs=BENCH)
def a_name_without_its_comma_is_unknown(session: Session) -> None:
    """RQSTAT and RFLAGS spelled without a comma are as unknown as any other name, unless this
    device does without."""
    driver = MscDriver(session)
    names = ("MSC-CMD-10", "MSC-CMD-02")
    for body in (RQSTAT, *([codec.RFLAGS] if driver.has_rflags else [])):
        raw = driver.client.request(body.rstrip(codec.COMMA))
        driver.follows(raw, "comma", _as_unknown_or(driver, SERVED, "comma"), names)
        driver.link.alive("MSC-CMD-02")
    if driver.link.is_twin and session.reading("comma") == "required":
        for body in driver.reads():
            raw = driver.client.request(body.replace(codec.COMMA, b";", 1))
            kind, exchange = driver.draws(raw)
            session.expect(kind == driver.as_unknown, "MSC-CMD-01", driver.as_unknown, exchange)


@check("MSC-CMD-09", safety="rig", needs=BENCH)
def names_are_upper_case(session: Session) -> None:
    """RQSTAT in lower and in mixed case, and DREAD so, are unknown, unless this device does not
    mind."""
    driver = MscDriver(session)
    reads = [RQSTAT, codec.rflag(0), *(codec.dread(address) for address in driver.scratch.spots(1))]
    for body in reads:
        name, _, values = body.partition(codec.COMMA)
        for spelling in (name.lower(), name.capitalize()):
            raw = driver.client.request(spelling + codec.COMMA + values)
            readings = _as_unknown_or(driver, SERVED, "case_sensitive")
            driver.follows(raw, "case_sensitive", readings, "MSC-CMD-09")


@check("MSC-MOD-02", safety="rig", needs=BENCH)
def a_model_without_rflags_does_not_answer_it(session: Session) -> None:
    """On models without it RFLAGS draws what an unknown command draws, or a lone ACK; never the
    states of flags."""
    driver = MscDriver(session)
    if driver.has_rflags:
        session.skip("this model has RFLAGS (MSC-MOD-01)")
    readings = _as_unknown_or(driver, ACKED, "rflags_unsupported")
    driver.follows(
        driver.client.request(codec.RFLAGS), "rflags_unsupported", readings, "MSC-MOD-02"
    )
    driver.link.alive("MSC-MOD-02")


# --- sizes ----------------------------------------------------------------------------------------

# A short body leaves a lenient device without what it needs: there it may refuse it as well.
LONG: Final[Readings] = {NAKED: "nak", ACKED: "ack_ignore", SERVED: "lenient"}
SHORT: Final[Readings] = {
    NAKED: ("nak", "lenient"), ACKED: ("ack_ignore", "lenient"), SERVED: "lenient",
}  # fmt: skip


def _longer(driver: MscDriver) -> list[bytes]:
    return [body + extra for body in driver.reads() for extra in (b"\x00", b"\x02\x06")]


def _shorter(driver: MscDriver) -> list[bytes]:
    with_values = [body for body in driver.reads() if not body.endswith(codec.COMMA)]
    return [body[:-count] for body in with_values for count in (1, 2)]


@check("MSC-CMD-11", "MSC-BREAD-01", "MSC-DREAD-01", "MSC-RFLAG-01", safety="rig", needs=BENCH)
def a_body_of_another_size_is_refused(session: Session) -> None:
    """A reading command with bytes too many or too few draws NAK, or what this device has for it;
    the sound one behind it is served."""
    driver = MscDriver(session)
    own = {"BREAD": "MSC-BREAD-01", "DREAD": "MSC-DREAD-01", "RFLAG": "MSC-RFLAG-01"}
    for bodies, readings in ((_longer(driver), LONG), (_shorter(driver), SHORT)):
        for body in bodies:
            name = body.partition(codec.COMMA)[0].decode()
            names = ("MSC-CMD-11", *([own[name]] if name in own else []))
            raw = driver.client.request(body)
            exchange = driver.follows(raw, "malformed_body", readings, names)
            reply = exchange.reply
            size = driver.client.reply_bytes(name)
            is_own = reply is None or (reply.name, len(reply.raw)) == (name, size)
            session.expect(is_own, names, f"a reply of {name}, if any", exchange)
            driver.link.alive("MSC-CMD-11")


@check(
    "MSC-CMD-11", "MSC-BWRITE-01", "MSC-DWRITE-01", "MSC-SFLAG-01", "MSC-CFLAG-01", "MSC-LNK-06",
    safety=("stored", "negative", "rig"), needs=("bench", "variables", "flags"),
)  # fmt: skip
def a_write_of_another_size_stores_nothing(session: Session) -> None:
    """BWRITE with other than 32 values, DWRITE with other than four bytes, SFLAG and CFLAG with
    more than two draw NAK and change nothing, wherever the place is a named one; with one byte, on
    a twin only."""
    driver = MscDriver(session)
    block, flag = driver.scratch.blocks(1)[0], driver.scratch.some_flags(1)[0]
    behind = block + BLOCK_VALUES * driver.scratch.stride
    before, more = driver.values(BLOCK_VALUES), []
    if driver.scratch.may_write(block, BLOCK_VALUES + 1):
        more = driver.values(1)
        driver.write(behind, more[0])
    driver.write_block(block, before)
    for body, size in _misfits(driver, block, flag, has_more=bool(more)):
        name = codec.name_of(body)
        names = ("MSC-CMD-11", f"MSC-{name}-01", "MSC-LNK-06")
        was_on = name == "CFLAG"
        driver.turn(flag, on=was_on)
        kind, exchange = driver.draws(driver.client.request(body))
        # An ACK alone is also what a lenient device says to a write.
        readings = dict(size) | {ACKED: ("ack_ignore", "lenient")}
        if kind not in (NAKED, ACKED):
            session.fail(names[:2], [NAKED, ACKED], exchange)
        driver.reading("malformed_body", readings[kind], names[:2])
        if session.reading("malformed_body") == "lenient":
            continue
        values = [*driver.read_block(block), *([driver.read(behind)] if more else [])]
        is_so = values == [*before, *more] and driver.flag(flag) is was_on
        came = "what it names is changed"
        session.expect(is_so, names, f"nothing changed by {name} of {len(body)} bytes", came)


def _misfits(
    driver: MscDriver, block: int, flag: int, *, has_more: bool
) -> Iterator[tuple[bytes, Readings]]:
    """Writes with too little or too much behind their place, and what those draw."""
    for count in (0, 1, BLOCK_VALUES - 1):
        yield codec.bwrite(block, [7] * count), SHORT
    yield codec.bwrite(block, [7] * BLOCK_VALUES)[:-1], SHORT
    if has_more:
        yield codec.bwrite(block, [7] * BLOCK_VALUES) + b"\x07", LONG
        yield codec.bwrite(block, [7] * (BLOCK_VALUES + 1)), LONG
    for cut in range(1, codec.VALUE_BYTES + 1):
        yield codec.dwrite(block, 7)[:-cut], SHORT
    for extra in (1, codec.VALUE_BYTES):
        yield codec.dwrite(block, 7) + b"\x07" * extra, LONG
    for command in (codec.sflag, codec.cflag):
        if driver.link.is_twin:  # elsewhere nobody knows which flag that is
            yield command(flag)[:-1], SHORT
        for extra in (1, 2):
            yield command(flag) + bytes(extra), LONG


# --- places ---------------------------------------------------------------------------------------


@check("MSC-DREAD-01", "MSC-PKT-15", "MSC-CMD-08", safety="rig", needs=BENCH)
def every_byte_may_stand_in_an_address(session: Session) -> None:
    """DREAD of addresses with each byte in front, and with each behind that a variable may have, is
    served up to where the data area ends; so is BREAD with commas there."""
    driver = MscDriver(session)

    def served(addresses: Iterable[int]) -> list[int]:
        for address in addresses:
            kinds[address], _ = driver.draws(driver.client.request(codec.dread(address)))
        return [address for address, kind in kinds.items() if kind == SERVED]

    kinds: dict[int, str] = {}
    step = 1 if session.target.is_virtual else REAL_STEP
    ahead = sorted({*range(0, 0x100, step), *LOADED_BYTES})
    found = served((byte << 8) + SAFE_STRIDE for byte in ahead)
    if not found:
        session.skip("this device serves none of them now")
    page = found[len(found) // 2] & 0xFF00
    behind = {*range(page, page + 0x100, SAFE_STRIDE * min(step, 8)), *COMMA_ADDRESSES}
    last = max(served(sorted(behind)))
    for address, kind in kinds.items():
        is_so = kind == SERVED or (kind == NAKED and address > last)
        text = f"the value at {address:04X}h, as at {last:04X}h"
        has_comma = codec.COMMA in codec.u16(address)
        names = ("MSC-CMD-08",) if has_comma else ("MSC-DREAD-01", "MSC-PKT-15")
        session.expect(is_so, names, text, kind)
    for address in COMMA_ADDRESSES:
        if address + BLOCK_VALUES * codec.VALUE_BYTES <= last:
            kind, _ = driver.draws(driver.client.request(codec.bread(address)))
            text = f"the values from {address:04X}h on"
            session.expect(kind == SERVED, "MSC-CMD-08", text, kind)


@check("MSC-DREAD-01", safety=("stored", "rig"), needs=("bench", "variables"))
def an_address_inside_a_value_reads_its_bytes(session: Session) -> None:
    """DREAD of an address inside a value returns the bytes from there on, across the next value;
    or NAK, or that value, as this device reads it."""
    driver = MscDriver(session)
    stride = driver.scratch.stride
    if stride == 1:
        session.skip("on this device every address is a variable of its own")
    (block,) = driver.scratch.blocks(1)
    values = driver.values(BLOCK_VALUES)
    driver.write_block(block, values)
    whole = b"".join(map(codec.i32, values))
    for inside in range(1, stride):
        exchange = driver.ask(codec.dread(block + inside))
        reply = exchange.reply
        if exchange.is_naked:
            driver.reading("data_misaligned", "nak")
            continue
        if not exchange.is_acked or reply is None:
            session.fail(None, [SERVED, NAKED], exchange)
        at = inside * codec.VALUE_BYTES // stride
        expected = {whole[at : at + 4]: "overlap", whole[:4]: "round_down"}
        if reply.payload not in expected:
            text = [f"{raw.hex(' ')} ({reading})" for raw, reading in expected.items()]
            session.fail(None, text, f"{reply.payload.hex(' ')} at {block}+{inside}")
        driver.reading("data_misaligned", expected[reply.payload])


@check("MSC-DWRITE-05", safety=("stored", "rig"), needs=("bench", "variables"))
def a_write_inside_a_value_changes_what_a_read_there_shows(session: Session) -> None:
    """DWRITE and BWRITE to an address inside a value store their bytes from there on; or draw NAK,
    or mean that value, as this device reads it; nothing else changes.  Odd addresses are written to
    on a twin only."""
    driver = MscDriver(session)
    stride = driver.scratch.stride
    if stride == 1:
        session.skip("on this device every address is a variable of its own")
    step = 1 if driver.link.is_twin else 2
    if stride <= step:
        driver.link.only_on_a_twin()
    place, _ = driver.scratch.blocks(2)
    for inside in range(step, stride, step):
        for body, data in _writes_inside(driver, place + inside):
            values = driver.values(2 * BLOCK_VALUES)
            before = b"".join(map(codec.i32, values))
            for half in (0, BLOCK_VALUES):
                driver.write_block(place + half * stride, values[half : half + BLOCK_VALUES])
            kind, exchange = driver.draws(driver.client.request(body))
            seen = b"".join(
                codec.i32(value)
                for half in (0, BLOCK_VALUES)
                for value in driver.read_block(place + half * stride)
            )
            at = inside * codec.VALUE_BYTES // stride
            outcomes = {
                (ACKED, _stored(before, at, data)): "overlap",
                (NAKED, before): "nak",
                (ACKED, _stored(before, 0, data)): "round_down",
            }
            if (kind, seen) not in outcomes:
                changed = [number for number in range(len(seen)) if seen[number] != before[number]]
                text = [f"bytes {at} to {at + len(data) - 1} changed", NAKED, "bytes from 0 on"]
                session.fail(None, text, f"{exchange}; bytes {changed} changed")
            driver.reading("data_misaligned", outcomes[kind, seen])


def _writes_inside(driver: MscDriver, address: int) -> Iterator[tuple[bytes, bytes]]:
    """A value and a block to be written there, each with the bytes that it stores."""
    for values in (driver.values(1), driver.values(BLOCK_VALUES)):
        data = b"".join(map(codec.i32, values))
        write = codec.dwrite(address, values[0]) if len(values) == 1 else None
        yield write or codec.bwrite(address, values), data


def _stored(before: bytes, at: int, data: bytes) -> bytes:
    return before[:at] + data + before[at + len(data) :]


@check("MSC-DAT-03", safety=("stored", "rig"), needs=("bench", "variables"))
def an_address_outside_the_data_area_is_refused(session: Session) -> None:
    """DREAD at the end of the sixteen bits draws NAK; or 0, or what is at the beginning, as this
    device reads it."""
    driver = MscDriver(session)
    kind, exchange = driver.draws(driver.client.request(codec.dread(LAST_PLACE)))
    if kind == NAKED:
        driver.reading("data_out_of_range", "nak")
        kind, exchange = driver.draws(driver.client.request(codec.bread(LAST_PLACE)))
        session.expect(kind == NAKED, None, "NAK to BREAD there as well", exchange)
        if driver.link.is_twin:
            blocks = codec.bwrite(LAST_PLACE, range(BLOCK_VALUES))
            for body in (codec.dwrite(LAST_PLACE, 1), blocks):
                kind, exchange = driver.draws(driver.client.request(body))
                text = f"NAK to {codec.name_of(body)} there as well"
                session.expect(kind == NAKED, None, text, exchange)
        return
    session.expect(kind == SERVED, None, [NAKED, SERVED], exchange)
    (mine,) = driver.scratch.slots(1)
    (value,) = driver.values(1)
    driver.write(mine, value)
    aliases = [
        place for place in range(mine + 4, ADDRESSES, 4) if not (place - mine) & (place - mine - 1)
    ]
    alias = next((place for place in aliases if driver.read(place) == value), None)
    if alias is not None:
        driver.reading("data_out_of_range", "wrap")
        if driver.link.is_twin:
            driver.write(alias, ~value)
            seen = driver.read(mine)
            session.expect(seen == ~value, None, f"{~value} at {mine}, by way of {alias}", seen)
    elif driver.read(LAST_PLACE) == 0 and not _keeps_at_the_end(driver):
        driver.reading("data_out_of_range", "zero")
    else:
        session.skip(f"no end of the data area up to {LAST_PLACE:04X}h is known")


def _keeps_at_the_end(driver: MscDriver) -> bool:
    """True if the last place keeps what is written there, or if that cannot be tried out."""
    if not driver.link.is_twin:
        return True
    driver.write(LAST_PLACE, 0x5A5A)
    is_kept = driver.read(LAST_PLACE) == 0x5A5A
    driver.write(LAST_PLACE, 0)
    return is_kept


def _end_of_data(driver: MscDriver) -> int:
    """The lowest address behind the named ones that is refused; skips if there is none."""

    def is_refused(address: int) -> bool:
        return driver.draws(driver.client.request(codec.dread(address)))[0] == NAKED

    named = driver.scratch.slots(1)[0]
    if not is_refused(LAST_PLACE):
        driver.session.skip("this device refuses no address, so that its last one cannot be found")
    return first_outside(is_refused, named, LAST_PLACE, driver.scratch.stride)


@check("MSC-BREAD-05", "MSC-BREAD-02", safety="rig", needs=("bench", "variables"))
def a_block_read_over_the_end_is_refused_whole(session: Session) -> None:
    """BREAD of a block of which a part is behind the end of the data area draws NAK, or 32 values
    with those that are there, as this device reads it; one that just fits is served."""
    driver = MscDriver(session)
    end, stride = _end_of_data(driver), driver.scratch.stride
    kind, exchange = driver.draws(driver.client.request(codec.bread(end - BLOCK_VALUES * stride)))
    session.expect(kind == SERVED, "MSC-BREAD-05", "the last whole block", exchange)
    _judge_count(session, exchange)
    for beyond in (1, HALF, BLOCK_VALUES - 1):
        start = end - (BLOCK_VALUES - beyond) * stride
        if start % 2:
            continue
        kind, exchange = driver.draws(driver.client.request(codec.bread(start)))
        if kind == NAKED:
            driver.reading("block_overrun", "nak_atomic", "MSC-BREAD-05")
            continue
        reply = exchange.reply
        is_served = kind == SERVED and reply is not None
        session.expect(is_served, "MSC-BREAD-05", [NAKED, SERVED], exchange)
        assert reply is not None
        _judge_count(session, exchange)
        _judge_overrun(driver, start, beyond, reply.values)


def _judge_count(session: Session, exchange: MscExchange) -> None:
    """Judge that a block that is told has all its values, whatever is there."""
    count = len(exchange.reply.payload) / codec.VALUE_BYTES if exchange.reply else 0
    session.expect(count == BLOCK_VALUES, "MSC-BREAD-02", f"{BLOCK_VALUES} values, or NAK", count)


def _judge_overrun(driver: MscDriver, start: int, beyond: int, values: Sequence[int]) -> None:
    """Which reading of MSC-AMB-21 explains a block of which the last `beyond` values are not
    there."""
    there = BLOCK_VALUES - beyond
    for number, place in driver.scratch.within_block(start):
        if number < there:
            seen = driver.read(place)
            text = f"{seen} first, as at {place}: what is there"
            driver.session.expect(values[number] == seen, "MSC-BREAD-05", text, values[number])
    behind = list(values[there:])
    around = list(driver.read_block(0))[:beyond]
    readings = [
        reading
        for reading, expected in (("partial", [0] * beyond), ("wrap", around))
        if behind == expected
    ]
    if not readings:
        driver.session.fail("MSC-BREAD-05", ["zeros", f"what is at 0: {around}"], behind)
    driver.reading("block_overrun", tuple(readings), "MSC-BREAD-05")


@check("MSC-BWRITE-07", safety=("stored", "rig"), needs=("bench", "variables"))
def a_block_written_over_the_end_stores_nothing(session: Session) -> None:
    """BWRITE of a block whose second half is behind the end of the data area draws NAK and stores
    nothing, or half of it, as this device reads it; on a twin only."""
    driver = MscDriver(session)
    driver.link.only_on_a_twin()
    end, stride = _end_of_data(driver), driver.scratch.stride
    last, start = end - BLOCK_VALUES * stride, end - HALF * stride
    with _kept(driver, (last, 0)):
        before = driver.values(BLOCK_VALUES)
        driver.write_block(last, before)
        driver.write_block(0, before)
        singles = driver.read(last), driver.read(0)
        text = f"{before[0]} at either end, by DREAD"
        session.step(set(singles) == {before[0]}, text, singles)
        values = driver.values(BLOCK_VALUES)
        kind, exchange = driver.draws(driver.client.request(codec.bwrite(start, values)))
        if kind not in (NAKED, ACKED):
            session.fail(None, [NAKED, ACKED], exchange)
        seen = list(driver.read_block(last)), list(driver.read_block(0))
        half = before[:HALF] + values[:HALF]
        outcomes = {
            "nak_atomic": (before, before),
            "partial": (half, before),
            "wrap": (half, values[HALF:] + before[HALF:]),
        }
        shown = next((reading for reading, outcome in outcomes.items() if outcome == seen), None)
        if shown is None or (shown == "nak_atomic") != (kind == NAKED):
            session.fail(None, [f"{NAKED}, and nothing stored", *outcomes], f"{exchange}: {seen}")
        driver.reading("block_overrun", shown)


@contextmanager
def _kept(driver: MscDriver, blocks: Sequence[int]) -> Iterator[None]:
    """Put back what a twin held at places that nobody has named."""
    held = {place: driver.read_block(place) for place in blocks}
    try:
        yield
    finally:
        for place, values in held.items():
            driver.write_block(place, values)


# --- flags ----------------------------------------------------------------------------------------


@check("MSC-FLG-02", safety=("stored", "rig"), needs=("bench", "flags"))
def a_flag_number_above_255_is_refused(session: Session) -> None:
    """A flag number above 255 gets NAK, counts as off, or is taken modulo 256: always the same, in
    RFLAG, and on a twin in SFLAG and CFLAG."""
    driver = MscDriver(session)
    number = driver.scratch.some_flags(1)[0]
    driver.set_flag(number)
    for far in (number + 256, number + 0x100 * 0xFF, number | 0x8000):
        kind, exchange = driver.draws(driver.client.request(codec.rflag(far)))
        reply = exchange.reply
        if kind == NAKED:
            driver.reading("flag_out_of_range", "nak")
            continue
        if kind != SERVED or reply is None or reply.numbers not in ((0,), (1,)):
            session.fail(None, [NAKED, "off", f"the state of flag {number}"], exchange)
        driver.reading("flag_out_of_range", "mod256" if reply.numbers == (1,) else "off")
    if driver.link.is_twin:
        _judge_far_writes(driver, number)


def _judge_far_writes(driver: MscDriver, number: int) -> None:
    for on, command in ((False, codec.cflag), (True, codec.sflag)):
        driver.turn(number, on=not on)
        kind, exchange = driver.draws(driver.client.request(command(number + 256)))
        is_changed = driver.flag(number) == on
        readings = {(NAKED, False): "nak", (ACKED, False): "off", (ACKED, True): "mod256"}
        if (kind, is_changed) not in readings:
            text = [f"{NAKED} and no effect", f"{ACKED} and no effect", f"flag {number} changed"]
            driver.session.fail(None, text, f"{exchange}, changed: {is_changed}")
        name, did = ("SFLAG", "turned on") if on else ("CFLAG", "turned off")
        effect = f"flag {number} {'was' if is_changed else 'was not'} {did}"
        before, far = f"{'CFLAG' if on else 'SFLAG'} {number}", f"{name} {number + 256}"
        shown = Observation(
            f"after {before}, {far} was answered with {exchange}, and {effect} ({REQUEST} showed"
            " it)",
            causes=(before, far),
        )
        driver.reading("flag_out_of_range", readings[kind, is_changed], shown=shown)
