"""The data area: single values, blocks, addresses (DREAD, DWRITE, BREAD, BWRITE, DAT-02)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import BLOCK_VALUES, signed
from axistwin_conformance.families.msc.controller import Controller
from axistwin_conformance.families.msc.driver import SAFE_STRIDE

ORDER = 70  # of this module in a run; see `Family.modules`

# The ends of the range, every sign of the protocol four times over, and bytes that text would lose.
BOUNDARIES: Final = tuple(
    signed(value)
    for value in (
        0, 1, -1, 2, -2, 127, 128, 255, 256, -128, -129, -256, 32767, 32768, 65535, 65536,
        -32768, -32769, 0x7FFFFFFF, 0x7FFFFFFE, -0x80000000, -0x7FFFFFFF, 0x11131113, 0x02020202,
        0x06060606, 0x15151515, 0x2C2C2C2C, 0x02010007, 0x0D0A0D0A, 0x1A1A1A1A, 0x7F80FF00,
        0x00FF00FF, 0x01020304, 1234,
    )
)  # fmt: skip
SPECIAL_BYTES: Final = (0x02, 0x06, 0x11, 0x13, 0x15, 0x2C)
SHORT_ARRAY: Final = 20  # values of the array in trap 25; twelve are padding
STRIDES: Final = (4, 2, 1)  # MSC-AMB-18


@check(
    "MSC-DWRITE-01", "MSC-DWRITE-02", "MSC-DWRITE-04", "MSC-DREAD-01", "MSC-DREAD-02",
    "MSC-DREAD-03", safety="stored", needs=("variables",),
)  # fmt: skip
def a_value_written_is_the_value_read(session: Session) -> None:
    """Whatever value DWRITE stores, the ends of the range and the protocol's own signs among them,
    the DREAD right behind its ACK returns in four bytes of two's complement."""
    unit = Controller(session)
    slots = unit.slots(4)
    for number, value in enumerate((*BOUNDARIES, *unit.values(16))):
        address = slots[number % len(slots)]
        exchange = unit.ask(codec.dwrite(address, value))
        session.expect(exchange.is_acked, "MSC-DWRITE-01", f"ACK to {value}", exchange)
        reply = unit.served(codec.dread(address), "MSC-DREAD-01", "a reply to DREAD")
        size = len(reply.payload)
        session.expect(size == codec.VALUE_BYTES, "MSC-DREAD-02", "4 bytes", size)
        names = ("MSC-DWRITE-02", "MSC-DWRITE-04", "MSC-DREAD-02", "MSC-DREAD-03")
        told = f"{value} as {codec.i32(value).hex(' ')}"
        session.expect(reply.payload == codec.i32(value), names, told, reply.payload.hex(" "))


@check("MSC-DWRITE-02", "MSC-DWRITE-05", safety="stored", needs=("variables",))
def no_other_variable_changes(session: Session) -> None:
    """A DWRITE changes the variable it names; those 4, 8, 16 and so on addresses away, and the ends
    of what was named, keep their values."""
    unit = Controller(session)
    slots = range(unit.slots(2)[0], unit.variables.stop - 3, SAFE_STRIDE)
    for address in unit.slots(min(3, len(slots))):
        near = [address + (sign << bit) for bit in range(2, 16) for sign in (1, -1)]
        others = sorted({slots[0], slots[-1], *near} & set(slots) - {address})
        before = dict(zip(others, unit.values(len(others)), strict=True))
        for other, value in before.items():
            unit.write(other, value)
        for value in (-1, 0):
            unit.write(address, value)
            seen = unit.read(address)
            session.expect(seen == value, "MSC-DWRITE-02", f"{value} at {address}", seen)
            after = {other: unit.read(other) for other in others}
            wrong = {other: after[other] for other in others if after[other] != before[other]}
            told = f"nothing else than {address} changed"
            session.expect(not wrong, "MSC-DWRITE-05", told, wrong)


@check("MSC-DREAD-04", "MSC-BREAD-04", needs=("variables",))
def reading_changes_nothing(session: Session) -> None:
    """Reads of the same variable agree, BREAD's first value among them, however often it is
    read."""
    unit = Controller(session)
    for address in unit.some_blocks(2):
        first = unit.read(address)
        again = [unit.read(address) for _ in range(3)]
        if set(again) != {first}:
            unit.may_be_moved(address)
        session.expect(set(again) == {first}, "MSC-DREAD-04", f"{first} each time", again)
        block = unit.read_block(address)
        seen = unit.read(address)
        if seen != first:
            unit.may_be_moved(address)
        session.expect(block[0] == first, "MSC-BREAD-04", f"{first} first", block[0])
        session.expect(seen == first, ("MSC-DREAD-04", "MSC-BREAD-04"), f"{first} again", seen)
        second = unit.read_block(address)
        if second != block:
            unit.may_be_moved(address)
        session.expect(second == block, "MSC-DREAD-04", codec.listed(block), codec.listed(second))


@check("MSC-DREAD-04", "MSC-BREAD-04", safety="stored", needs=("variables",))
def what_was_written_outlasts_its_reads(session: Session) -> None:
    """Blocks that were written, no value of them 0, are told alike by every look at them, value by
    value and block by block."""
    unit = Controller(session)
    blocks = unit.some_blocks(3)
    for address in blocks:
        unit.write_block(address, unit.values(BLOCK_VALUES))
    first: dict[int, tuple[list[int], tuple[int, ...]]] = {}
    for address in (*blocks, *blocks):
        singles = [unit.read(place) for _, place in unit.within_block(address)]
        look = singles, unit.read_block(address)
        names = ("MSC-DREAD-04", "MSC-BREAD-04")
        told = f"what the first look at {address} told"
        session.expect(first.setdefault(address, look) == look, names, told, "something else")


@check("MSC-DREAD-01", "MSC-BREAD-01", needs=("variables",))
def an_address_has_sixteen_bits(session: Session) -> None:
    """DREAD and BREAD take any of the named addresses as two bytes, bytes that are signs of the
    protocol among them."""
    unit = Controller(session)
    ends = unit.slots(2)
    free = range(unit.variables.start, unit.variables.stop - 3)
    places = [place for place in free if place % SAFE_STRIDE == 0]
    special = {
        next((place for place in places if divmod(place, 256)[part] == byte), places[0])
        for byte in SPECIAL_BYTES
        for part in (0, 1)
    }
    for address in sorted({*ends, *special}):
        unit.served(codec.dread(address), "MSC-DREAD-01", f"the value at {address:04X}h")
    for address in unit.some_blocks(3):
        unit.served(codec.bread(address), "MSC-BREAD-01", f"the values from {address:04X}h on")


@check("MSC-DREAD-01", "MSC-DWRITE-05", safety="stored", needs=("variables",))
def every_bit_of_an_address_counts(session: Session) -> None:
    """Variables whose addresses differ in a single bit hold values of their own."""
    unit = Controller(session)
    slots = set(range(unit.slots(2)[0], unit.variables.stop - 3, SAFE_STRIDE))
    pairs = {
        bit: next(
            ((slot, slot ^ 1 << bit) for slot in sorted(slots) if slot ^ 1 << bit in slots), None
        )
        for bit in range(2, 16)
    }
    places = sorted({place for pair in pairs.values() if pair for place in pair})
    if not places:  # two that stand side by side may differ in several bits, three cannot all
        session.skip(f"needs 3 variables {SAFE_STRIDE} addresses apart (--variables FIRST-LAST)")
    values = dict(zip(places, unit.values(len(places)), strict=True))
    for place, value in values.items():
        unit.write(place, value)
    for place, value in values.items():
        seen = unit.read(place)
        names = ("MSC-DREAD-01", "MSC-DWRITE-05")
        session.expect(seen == value, names, f"{value} at {place:04X}h", seen)
    missing = [str(bit) for bit, pair in pairs.items() if pair is None]
    if missing:
        session.note(f"no two variables are named that differ in bit {', '.join(missing)} alone")


# --- blocks ---------------------------------------------------------------------------------------


@check(
    "MSC-BWRITE-01", "MSC-BWRITE-02", "MSC-BREAD-01", "MSC-BREAD-02", "MSC-BREAD-03",
    "MSC-BREAD-04", "MSC-PROP-12", safety="stored", needs=("variables",),
)  # fmt: skip
def a_block_written_is_the_block_read(session: Session) -> None:
    """The 32 values of a BWRITE come back by BREAD in their order, and by single reads one stride
    apart."""
    unit = Controller(session)
    for number, address in enumerate(unit.some_blocks(3)):
        values = list(BOUNDARIES[:BLOCK_VALUES]) if number == 0 else unit.values(BLOCK_VALUES)
        exchange = unit.ask(codec.bwrite(address, values))
        session.expect(exchange.is_acked, "MSC-BWRITE-01", "ACK to 32 values", exchange)
        reply = unit.served(codec.bread(address), "MSC-BREAD-01", "a reply to BREAD")
        size = len(reply.payload)
        session.expect(size == 128, "MSC-BREAD-02", "32 values in 128 bytes", f"{size} bytes")
        names = ("MSC-BWRITE-02", "MSC-BREAD-02", "MSC-BREAD-03")
        told, seen = codec.listed(values), codec.listed(reply.values)
        session.expect(list(reply.values) == values, names, told, seen)
        _judge_singles(unit, address, reply.values)


def _judge_singles(unit: Controller, address: int, block: Sequence[int]) -> None:
    """Hold a block against single reads (PROP-12)."""
    for number, place in unit.within_block(address):
        seen = unit.read(place)
        if seen != block[number] != unit.read_block(address)[number]:
            unit.may_be_moved(place)
        names = ("MSC-BREAD-03", "MSC-PROP-12", *(("MSC-BREAD-04",) if number == 0 else ()))
        told = f"{block[number]} at {place}, value {number + 1} of the block"
        unit.session.expect(seen == block[number], names, told, seen)


@check("MSC-BREAD-03", "MSC-BREAD-04", "MSC-PROP-12", needs=("variables",))
def a_block_equals_its_single_reads(session: Session) -> None:
    """BREAD of what is there equals 32 DREADs, one stride apart."""
    unit = Controller(session)
    for address in unit.blocks(1):
        _judge_singles(unit, address, unit.read_block(address))


@check("MSC-DAT-02", safety="stored", needs=("variables",))
def values_of_a_block_lie_one_stride_apart(session: Session) -> None:
    """Which value of a block the address four further on holds, tells the stride; it is the same
    everywhere."""
    unit = Controller(session)
    for address in unit.some_blocks(3):
        values = unit.values(BLOCK_VALUES)
        unit.write_block(address, values)
        for further in (SAFE_STRIDE, 3 * SAFE_STRIDE, 7 * SAFE_STRIDE):
            seen = unit.read(address + further)
            strides = [stride for stride in STRIDES if values[further // stride] == seen]
            if not strides:
                told = [f"{values[further // stride]} (stride {stride})" for stride in STRIDES]
                session.fail(None, told, f"{seen} at {address}+{further}")
            unit.reading("data_address_stride", tuple(map(str, strides)))


@check("MSC-BWRITE-03", "MSC-BWRITE-01", safety="stored", needs=("variables",))
def padding_is_stored_as_well(session: Session) -> None:
    """Of 20 values padded to 32, all 32 are stored: the twelve behind the array are overwritten."""
    unit = Controller(session)
    (address,) = unit.blocks(1)
    unit.write_block(address, unit.values(BLOCK_VALUES))
    padded = [*unit.values(SHORT_ARRAY), *[0] * (BLOCK_VALUES - SHORT_ARRAY)]
    exchange = unit.ask(codec.bwrite(address, padded))
    session.expect(exchange.is_acked, "MSC-BWRITE-01", "ACK to 32 values", exchange)
    seen = unit.read_block(address)
    told = codec.listed(padded)
    session.expect(list(seen) == padded, "MSC-BWRITE-03", told, codec.listed(seen))


@check("MSC-BWRITE-02", safety="stored", needs=("variables",))
def a_longer_array_is_sent_block_by_block(session: Session) -> None:
    """64 values sent by two BWRITEs, the second 32 strides on, lie in a row; neither block touches
    what is before or behind it."""
    unit = Controller(session)
    length = 2 * BLOCK_VALUES * unit.stride
    first = unit.slots(1)[0]
    if first + SAFE_STRIDE + length + SAFE_STRIDE > unit.variables.stop:
        session.skip(f"needs {length + 2 * SAFE_STRIDE} variables in a row (--variables)")
    start, behind = first + SAFE_STRIDE, first + SAFE_STRIDE + length
    fences = dict(zip((first, behind), unit.values(2), strict=True))
    for place, value in fences.items():
        unit.write(place, value)
    values = unit.values(2 * BLOCK_VALUES)
    for number in (0, BLOCK_VALUES):
        unit.write_block(start + number * unit.stride, values[number : number + BLOCK_VALUES])
    middle = unit.read_block(start + BLOCK_VALUES // 2 * unit.stride)
    names = "MSC-BWRITE-02"
    wanted = values[BLOCK_VALUES // 2 : BLOCK_VALUES // 2 + BLOCK_VALUES]
    told = codec.listed(wanted)
    session.expect(list(middle) == wanted, names, told, codec.listed(middle))
    for place, value in fences.items():
        seen = unit.read(place)
        session.expect(seen == value, "MSC-BWRITE-02", f"{value} at {place} as before", seen)
