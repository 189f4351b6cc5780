"""Commands in general: names, commas, sizes, and which of them have a reply (CMD)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import NAK, RQSTAT
from axistwin_conformance.families.msc.controller import Controller

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
    unit = Controller(session)
    for body in unit.reads():
        name = _name(body)
        exchange = unit.ask(body)
        known = ("MSC-CMD-01", "MSC-CMD-06")
        session.expect(exchange.sign == codec.ACK, known, f"ACK to {name}", exchange)
        reply = exchange.reply
        session.expect(reply is not None, "MSC-CMD-05", "a packet behind the ACK", exchange)
        assert reply is not None
        heading = name.encode() + codec.COMMA
        begins = reply.body[: len(heading)]
        session.expect(begins == heading, "MSC-CMD-04", heading, begins)
        size = unit.talk.reply_bytes(name) - codec.AROUND_BODY - len(heading)
        told = f"{size} bytes behind the comma of {name}"
        session.expect(len(reply.payload) == size, "MSC-CMD-12", told, len(reply.payload))


@check(
    "MSC-CMD-01", "MSC-CMD-05", "MSC-CMD-06", "MSC-LNK-14", "MSC-DWRITE-03", "MSC-BWRITE-05",
    safety="stored", needs=("variables", "flags"),
)  # fmt: skip
def a_write_draws_its_ack_and_nothing_else(session: Session) -> None:
    """DWRITE, BWRITE, SFLAG and CFLAG draw ACK and, for as long as a reply would be repeated,
    nothing more; an ACK in return does no harm."""
    unit = Controller(session)
    (block,), flag = unit.blocks(1), unit.some_flags(1)[0]
    own = {"DWRITE": ("MSC-DWRITE-03",), "BWRITE": ("MSC-BWRITE-05",)}
    for body in (
        codec.dwrite(block, 5),
        codec.bwrite(block, unit.values(codec.BLOCK_VALUES)),
        codec.sflag(flag),
        codec.cflag(flag),
    ):
        name = _name(body)
        exchange = unit.ask(body)
        known = ("MSC-CMD-01", "MSC-CMD-06", "MSC-CMD-05")
        session.expect(exchange.sign == codec.ACK, known, f"ACK to {name}", exchange)
        names = ("MSC-LNK-14", *own.get(name, ()))
        reply, strays = exchange.reply, exchange.extra
        if reply is None and not strays:
            reply, strays = unit.talk.hear_packet(unit.ack_timeout_s * 1.5)
            if reply is not None:
                unit.talk.send(codec.ACK)
        is_empty = reply is not None and reply.is_sound and reply.unit == unit.unit
        is_empty = is_empty and reply is not None and not reply.payload
        if strays or (reply is not None and not is_empty):
            heard = codec.explain(strays + (reply.raw if reply else b""))
            session.fail(names, ["nothing behind the ACK", "an empty packet"], heard)
        unit.reading("write_reply", "empty_packet" if is_empty else "none", names)
        unit.talk.send(codec.ACK)
        unit.nothing_more(names, f"an ACK to the ACK of {name}")
        unit.alive("MSC-LNK-14")


@check("MSC-CMD-02")
def the_comma_is_there_without_values(session: Session) -> None:
    """RQSTAT and RFLAGS are served with a body of seven bytes, the comma its last; and their
    replies have it."""
    unit = Controller(session)
    for body in (RQSTAT, *([codec.RFLAGS] if unit.has_rflags else [])):
        reply = unit.served(body, None, "a reply")
        session.expect(reply.body.startswith(body), None, f"{body!r} first", reply.body)


@check("MSC-CMD-03")
def a_checksum_without_the_comma_is_refused(session: Session) -> None:
    """RQSTAT is served under a checksum that counts its comma, and refused under one that does
    not."""
    unit = Controller(session)
    right = unit.talk.request(RQSTAT, 0x1234)
    without = codec.packet(unit.unit, RQSTAT, 0x1234, checksum=codec.checksum(right[1:-2]) - COMMA)
    unit.sign(without, NAK, "MSC-CMD-03", "a checksum that leaves the comma out")
    unit.sign(right, codec.ACK, "MSC-CMD-03", "one that counts it")


@check("MSC-LNK-06")
def a_refused_read_is_not_served(session: Session) -> None:
    """Each reading command under a wrong checksum gets NAK, and no reply behind it."""
    unit = Controller(session)
    for body in unit.reads():
        raw = codec.with_wrong_checksum(unit.talk.request(body))
        unit.sign(raw, NAK, "MSC-LNK-06", codec.explain_request(raw))


@check("MSC-CMD-03", "MSC-DWRITE-01", safety="stored", needs=("variables",))
def the_worked_example_writes_1234(session: Session) -> None:
    """The manual's 21 bytes, length 13 and checksum with the comma, are ACKed and store 1234; at
    another address, if 2008 is not to be written."""
    unit = Controller(session)
    address = EXAMPLE_ADDRESS
    if not {address, address + 3} <= set(unit.variables):
        (address,) = unit.slots(1)
    raw = EXAMPLE
    if (unit.unit, address) != (1, EXAMPLE_ADDRESS):
        raw = unit.talk.request(codec.dwrite(address, EXAMPLE_VALUE))
    unit.write(address, 0)
    exchange = unit.talk.ask(raw)
    names = ("MSC-CMD-03", "MSC-DWRITE-01")
    session.expect(exchange.is_acked, names, "ACK", exchange)
    value = unit.read(address)
    session.expect(value == EXAMPLE_VALUE, names, f"{EXAMPLE_VALUE} at {address}", value)


@check("MSC-CMD-07")
def names_are_compared_whole(session: Session) -> None:
    """RFLAG is answered by two bytes and RFLAGS by thirty-two, whichever came before."""
    unit = Controller(session)
    if not unit.has_rflags:
        session.skip("this model has no RFLAGS that RFLAG could be mistaken for")
    for body in (codec.rflag(8), codec.RFLAGS, codec.RFLAGS, codec.rflag(8)):
        name = _name(body)
        size = codec.REPLY_PAYLOADS[name]
        reply = unit.served(body, None, f"a reply to {name}")
        is_own = (reply.name, len(reply.payload)) == (name, size)
        session.expect(is_own, None, f"{size} bytes of {name}", reply)


@check("MSC-CMD-08")
def a_flag_number_may_hold_a_comma(session: Session) -> None:
    """RFLAG of flag 44, spelled 00 2C, is served as any other."""
    unit = Controller(session)
    unit.served(codec.rflag(COMMA_FLAG), None, f"the state of flag {COMMA_FLAG}")


@check("MSC-CMD-08", safety="stored", needs=("variables",))
def commas_in_addresses_and_values_are_data(session: Session) -> None:
    """Addresses with a byte 2Ch hold what is written there, and 2C2C2C2Ch comes back, alone and in
    a block."""
    unit = Controller(session)
    (block,) = unit.blocks(1)
    free = range(unit.variables.start, unit.variables.stop - 3)
    places = [place for place in free if COMMA in divmod(place, 256) and place % 4 == 0]
    places = [place for place in places if place in (0x2C2C, *places[:2], *places[-2:])]
    for value, address in enumerate(places or [block], 1):
        exchange = unit.ask(codec.dwrite(address, value))
        session.expect(exchange.is_acked, None, f"ACK to a write to {address:04X}h", exchange)
    for value, address in enumerate(places or [block], 1):
        seen = unit.read(address)
        session.expect(seen == value, None, f"{value} at {address:04X}h", seen)
    unit.write(block, ALL_COMMAS)
    session.expect(unit.read(block) == ALL_COMMAS, None, "2C2C2C2Ch back", unit.read(block))
    unit.write_block(block, [ALL_COMMAS] * codec.BLOCK_VALUES)
    seen_block = unit.read_block(block)
    is_back = set(seen_block) == {ALL_COMMAS}
    session.expect(is_back, None, "32 times 2C2C2C2Ch back", seen_block)
