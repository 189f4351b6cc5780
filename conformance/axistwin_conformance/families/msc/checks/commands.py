"""Commands in general: names, commas, sizes, and which of them have a reply (CMD)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import NAK, RQSTAT
from axistwin_conformance.families.msc.driver import MscDriver

ORDER = 60  # of this module in a run; see `Family.modules`

EXAMPLE: Final = bytes.fromhex("02 01 00 0D 00 00 44 57 52 49 54 45 2C 07 D8 00 00 04 D2 03 BE")
EXAMPLE_ADDRESS, EXAMPLE_VALUE = 2008, 1234
COMMA: Final = 0x2C
COMMA_FLAG: Final = COMMA  # 00 2C in a request
ALL_COMMAS: Final = int.from_bytes(codec.COMMA * 4, "big")


def _name(body: bytes) -> str:
    return body.partition(codec.COMMA)[0].decode()


@check("MSC-CMD-01", "MSC-CMD-04", "MSC-CMD-05", "MSC-CMD-06", "MSC-CMD-12")
def a_read_is_answered_under_its_own_name(session: Session) -> None:
    """Each reading command draws ACK and a packet of its own name, a comma, and its values alone:
    neither address nor flag number is repeated."""
    driver = MscDriver(session)
    for body in driver.reads():
        name = _name(body)
        exchange = driver.ask(body)
        known = ("MSC-CMD-01", "MSC-CMD-06")
        session.expect(exchange.sign == codec.ACK, known, f"ACK to {name}", exchange)
        reply = exchange.reply
        session.expect(reply is not None, "MSC-CMD-05", "a packet behind the ACK", exchange)
        assert reply is not None
        heading = name.encode() + codec.COMMA
        begins = reply.body[: len(heading)]
        session.expect(begins == heading, "MSC-CMD-04", heading, begins)
        size = driver.client.reply_bytes(name) - codec.AROUND_BODY - len(heading)
        text = f"{size} bytes behind the comma of {name}"
        session.expect(len(reply.payload) == size, "MSC-CMD-12", text, len(reply.payload))


@check(
    "MSC-CMD-01", "MSC-CMD-05", "MSC-CMD-06", "MSC-LNK-14", "MSC-DWRITE-03", "MSC-BWRITE-05",
    safety="stored", needs=("variables", "flags"),
)  # fmt: skip
def a_write_draws_its_ack_and_nothing_else(session: Session) -> None:
    """DWRITE, BWRITE, SFLAG and CFLAG draw ACK and, for as long as a reply would be repeated,
    nothing more; an ACK in return does no harm."""
    driver = MscDriver(session)
    (block,), flag = driver.scratch.blocks(1), driver.scratch.some_flags(1)[0]
    own = {"DWRITE": ("MSC-DWRITE-03",), "BWRITE": ("MSC-BWRITE-05",)}
    for body in (
        codec.dwrite(block, 5),
        codec.bwrite(block, driver.values(codec.BLOCK_VALUES)),
        codec.sflag(flag),
        codec.cflag(flag),
    ):
        name = _name(body)
        exchange = driver.ask(body)
        known = ("MSC-CMD-01", "MSC-CMD-06", "MSC-CMD-05")
        session.expect(exchange.sign == codec.ACK, known, f"ACK to {name}", exchange)
        names = ("MSC-LNK-14", *own.get(name, ()))
        reply, strays = exchange.reply, exchange.extra
        if reply is None and not strays:
            reply, strays = driver.client.receive_packet(driver.client.ack_timeout_s * 1.5)
            if reply is not None:
                driver.client.send(codec.ACK)
        is_empty = reply is not None and reply.is_sound and reply.unit == driver.unit
        is_empty = is_empty and reply is not None and not reply.payload
        if strays or (reply is not None and not is_empty):
            received = codec.explain(codec.bytes_of(reply, strays))
            both = (*names, "MSC-CMD-05")
            session.fail(both, ["nothing behind the ACK", "an empty packet"], received)
        driver.reading("write_reply", "empty_packet" if is_empty else "none", names)
        driver.client.send(codec.ACK)
        driver.link.nothing_more(names, f"an ACK to the ACK of {name}")
        driver.link.alive("MSC-LNK-14")


@check("MSC-CMD-02")
def the_comma_is_there_without_values(session: Session) -> None:
    """RQSTAT and RFLAGS are served with a body of seven bytes, the comma its last; and their
    replies have it."""
    driver = MscDriver(session)
    for body in (RQSTAT, *([codec.RFLAGS] if driver.has_rflags else [])):
        reply = driver.served(body, None, "a reply")
        session.expect(
            reply.body.startswith(body),
            None,
            f"a body that begins with {body.decode()}",
            reply.body.decode("ascii", "backslashreplace"),
        )


@check("MSC-CMD-03")
def a_checksum_without_the_comma_is_refused(session: Session) -> None:
    """RQSTAT is served under a checksum that counts its comma, and refused under one that does
    not."""
    driver = MscDriver(session)
    right = driver.client.request(RQSTAT, 0x1234)
    without = codec.packet(
        driver.unit, RQSTAT, 0x1234, checksum=codec.checksum(right[1:-2]) - COMMA
    )
    driver.link.sign(without, NAK, "MSC-CMD-03", "a checksum that leaves the comma out")
    driver.link.sign(right, codec.ACK, "MSC-CMD-03", "one that counts it")


@check("MSC-LNK-06")
def a_refused_read_is_not_served(session: Session) -> None:
    """Each reading command under a wrong checksum gets NAK, and no reply behind it."""
    driver = MscDriver(session)
    for body in driver.reads():
        raw = codec.with_wrong_checksum(driver.client.request(body))
        driver.link.sign(raw, NAK, "MSC-LNK-06", codec.explain_request(raw))


@check("MSC-LNK-06", "MSC-LNK-22", safety=("stored", "negative"), needs=("variables",))
def a_refused_write_stores_nothing(session: Session) -> None:
    """DWRITE and BWRITE with a wrong checksum get NAK and leave the variables as they were; the
    host's repeat with the right one is carried out."""
    driver = MscDriver(session)
    spot = driver.scratch.block_spot()
    before = list(range(100, 132))
    driver.write_block(spot, before)
    for body, after in (
        (codec.dwrite(spot, -7), [-7, *before[1:]]),
        (codec.bwrite(spot, [-8] * 32), [-8] * 32),
    ):
        whole = driver.client.request(body)
        for offset in (1, 0x100, 0xFFFF):
            raw = codec.with_wrong_checksum(whole, offset)
            driver.link.sign(raw, NAK, "MSC-LNK-06", codec.explain_request(raw))
        for missing in (1, codec.CHECKSUM_BYTES):
            driver.link.break_off(whole[:-missing])  # what it draws is LNK-03
        session.expect(
            driver.read(spot) == before[0] and list(driver.read_block(spot)) == before,
            "MSC-LNK-06",
            "the variables as before",
            "a value of the refused packet",
        )
        for is_cut in (False, True):
            _refuse(driver, whole, is_cut=is_cut)
            _judge_repeat(driver, body)
            seen, text = list(driver.read_block(spot)), "what the repeat of a refused write stores"
            session.expect(seen == after, ("MSC-LNK-06", "MSC-LNK-22"), text, codec.listed(seen))
            driver.write_block(spot, before)


@check("MSC-LNK-06", "MSC-LNK-22", safety=("stored", "negative"), needs=("flags",))
def a_refused_sflag_turns_nothing_on(session: Session) -> None:
    """SFLAG and CFLAG with a wrong checksum get NAK and leave the flag as it was, on or off; the
    host's repeat with the right one is carried out."""
    driver = MscDriver(session)
    number = driver.scratch.flags[0]
    for on, body in ((True, codec.sflag(number)), (False, codec.cflag(number))):
        driver.turn(number, on=not on)
        raw = codec.with_wrong_checksum(driver.client.request(body))
        driver.link.sign(raw, NAK, "MSC-LNK-06", codec.explain_request(raw))
        seen = driver.flag(number)
        text = f"flag {number} as before"
        session.expect(seen is not on, "MSC-LNK-06", text, "on" if seen else "off")
        for is_cut in (False, True):
            driver.turn(number, on=not on)
            _refuse(driver, driver.client.request(body), is_cut=is_cut)
            _judge_repeat(driver, body)
            seen = driver.flag(number)
            text = f"flag {number} as the repeat of a refused packet turns it"
            names = ("MSC-LNK-06", "MSC-LNK-22")
            session.expect(seen is on, names, text, "on" if seen else "off")


def _refuse(driver: MscDriver, whole: bytes, *, is_cut: bool) -> None:
    """Have a packet refused: for its checksum, or because it is cut short."""
    if is_cut:
        driver.link.break_off(whole[:-1])  # what it draws is LNK-03
        return
    raw = codec.with_wrong_checksum(whole)
    driver.link.sign(raw, NAK, "MSC-LNK-06", codec.explain_request(raw))


def _judge_repeat(driver: MscDriver, body: bytes) -> None:
    """Judge that what a host sends when a packet was refused (MSC-LNK-23) is taken."""
    exchange = driver.ask(body)
    text = f"ACK to the repeat of a refused {codec.name_of(body)}"
    driver.session.expect(exchange.is_acked, ("MSC-LNK-22", "MSC-LNK-06"), text, exchange)


@check("MSC-CMD-03", "MSC-DWRITE-01", safety="stored", needs=("variables",))
def the_worked_example_writes_1234(session: Session) -> None:
    """The manual's 21 bytes, length 13 and checksum with the comma, are ACKed and store 1234; at
    another address, if 2008 is not to be written."""
    driver = MscDriver(session)
    address = EXAMPLE_ADDRESS
    if not {address, address + 3} <= set(driver.scratch.variables):
        (address,) = driver.scratch.slots(1)
    raw = EXAMPLE
    if (driver.unit, address) != (1, EXAMPLE_ADDRESS):
        raw = driver.client.request(codec.dwrite(address, EXAMPLE_VALUE))
    driver.write(address, 0)
    exchange = driver.client.ask(raw)
    names = ("MSC-CMD-03", "MSC-DWRITE-01")
    session.expect(exchange.is_acked, names, "ACK", exchange)
    value = driver.read(address)
    session.expect(value == EXAMPLE_VALUE, names, f"{EXAMPLE_VALUE} at {address}", value)


@check("MSC-CMD-07")
def names_are_compared_whole(session: Session) -> None:
    """RFLAG is answered by two bytes and RFLAGS by thirty-two, whichever came before."""
    driver = MscDriver(session)
    if not driver.has_rflags:
        session.skip("this model has no RFLAGS that RFLAG could be mistaken for")
    for body in (codec.rflag(8), codec.RFLAGS, codec.RFLAGS, codec.rflag(8)):
        name = _name(body)
        size = codec.REPLY_PAYLOADS[name]
        reply = driver.served(body, None, f"a reply to {name}")
        is_own = (reply.name, len(reply.payload)) == (name, size)
        session.expect(is_own, None, f"{size} bytes of {name}", reply)


@check("MSC-CMD-08")
def a_flag_number_may_hold_a_comma(session: Session) -> None:
    """RFLAG of flag 44, spelled 00 2C, is served as any other."""
    driver = MscDriver(session)
    driver.served(codec.rflag(COMMA_FLAG), None, f"the state of flag {COMMA_FLAG}")


@check("MSC-CMD-08", safety="stored", needs=("variables",))
def commas_in_addresses_and_values_are_data(session: Session) -> None:
    """Addresses with a byte 2Ch hold what is written there, and 2C2C2C2Ch comes back, alone and in
    a block."""
    driver = MscDriver(session)
    (block,) = driver.scratch.blocks(1)
    free = range(driver.scratch.variables.start, driver.scratch.variables.stop - 3)
    places = [place for place in free if COMMA in divmod(place, 256) and place % 4 == 0]
    places = [place for place in places if place in (0x2C2C, *places[:2], *places[-2:])]
    for value, address in enumerate(places or [block], 1):
        exchange = driver.ask(codec.dwrite(address, value))
        session.expect(exchange.is_acked, None, f"ACK to a write to {address:04X}h", exchange)
    for value, address in enumerate(places or [block], 1):
        seen = driver.read(address)
        session.expect(seen == value, None, f"{value} at {address:04X}h", seen)
    driver.write(block, ALL_COMMAS)
    session.expect(driver.read(block) == ALL_COMMAS, None, "2C2C2C2Ch back", driver.read(block))
    driver.write_block(block, [ALL_COMMAS] * codec.BLOCK_VALUES)
    seen_block = driver.read_block(block)
    is_back = set(seen_block) == {ALL_COMMAS}
    session.expect(is_back, None, "32 times 2C2C2C2Ch back", seen_block)
