"""The data area: single values, blocks, addresses (DREAD, DWRITE, BREAD, BWRITE, DAT-02)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import BLOCK_VALUES, signed
from axistwin_conformance.families.msc.driver import MscDriver
from axistwin_conformance.families.msc.scratch import SAFE_STRIDE

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


def _spelt(data: bytes) -> str:
    return f"{int.from_bytes(data, 'big', signed=True)} ({data.hex(' ').upper()})"


@check(
    "MSC-DWRITE-01", "MSC-DWRITE-02", "MSC-DWRITE-04", "MSC-DREAD-01", "MSC-DREAD-02",
    "MSC-DREAD-03", safety="stored", needs=("variables",),
)  # fmt: skip
def a_value_written_is_the_value_read(session: Session) -> None:
    """DREAD right after the ACK of a DWRITE returns the value written, in four bytes of two's
    complement, also at the ends of the range and for the bytes of ACK, NAK and STX."""
    driver = MscDriver(session)
    slots = driver.scratch.slots(4)
    for number, value in enumerate((*BOUNDARIES, *driver.values(16))):
        address = slots[number % len(slots)]
        exchange = driver.ask(codec.dwrite(address, value))
        session.expect(exchange.is_acked, "MSC-DWRITE-01", f"ACK to {value}", exchange)
        reply = driver.served(codec.dread(address), "MSC-DREAD-01", "a reply to DREAD")
        size = len(reply.payload)
        session.expect(size == codec.VALUE_BYTES, "MSC-DREAD-02", "4 bytes", size)
        names = ("MSC-DREAD-02", "MSC-DWRITE-02", "MSC-DWRITE-04", "MSC-DREAD-03")
        text = f"{value} as {codec.i32(value).hex(' ')}"
        seen = Observation(
            f"{REQUEST} returned {_spelt(reply.payload)} after DWRITE {address} = {value}",
            value=reply.payload.hex(" "),
            wanted=_spelt(codec.i32(value)),
            causes=(f"DWRITE {address} = {value}",),
        )
        session.expect(reply.payload == codec.i32(value), names, text, seen)


@check("MSC-DWRITE-02", "MSC-DWRITE-05", safety="stored", needs=("variables",))
def no_other_variable_changes(session: Session) -> None:
    """A DWRITE changes the variable it names; those 4, 8, 16 and so on addresses away, and the ends
    of what was named, keep their values."""
    driver = MscDriver(session)
    slots = range(driver.scratch.slots(2)[0], driver.scratch.variables.stop - 3, SAFE_STRIDE)
    for address in driver.scratch.slots(min(3, len(slots))):
        near = [address + (sign << bit) for bit in range(2, 16) for sign in (1, -1)]
        others = sorted({slots[0], slots[-1], *near} & set(slots) - {address})
        before = dict(zip(others, driver.values(len(others)), strict=True))
        for other, value in before.items():
            driver.write(other, value)
        for value in (-1, 0):
            driver.write(address, value)
            seen = driver.read(address)
            session.expect(seen == value, "MSC-DWRITE-02", f"{value} at {address}", seen)
            after = {other: driver.read(other) for other in others}
            wrong = {other: after[other] for other in others if after[other] != before[other]}
            text = f"nothing else than {address} changed"
            session.expect(not wrong, "MSC-DWRITE-05", text, wrong)


@check("MSC-DREAD-04", "MSC-BREAD-04", needs=("variables",))
def reading_changes_nothing(session: Session) -> None:
    """Reads of the same variable agree, BREAD's first value among them, however often it is
    read."""
    driver = MscDriver(session)
    for address in driver.scratch.some_blocks(2):
        first = driver.read(address)
        again = [driver.read(address) for _ in range(3)]
        if set(again) != {first}:
            driver.scratch.may_be_moved(address)
        session.expect(
            set(again) == {first}, "MSC-DREAD-04", f"{first} each time", ", ".join(map(str, again))
        )
        block = driver.read_block(address)
        seen = driver.read(address)
        if seen != first:
            driver.scratch.may_be_moved(address)
        session.expect(block[0] == first, "MSC-BREAD-04", f"{first} first", block[0])
        session.expect(seen == first, ("MSC-DREAD-04", "MSC-BREAD-04"), f"{first} again", seen)
        second = driver.read_block(address)
        if second != block:
            driver.scratch.may_be_moved(address)
        session.expect(second == block, "MSC-DREAD-04", codec.listed(block), codec.listed(second))


@check("MSC-DREAD-04", "MSC-BREAD-04", safety="stored", needs=("variables",))
def what_was_written_outlasts_its_reads(session: Session) -> None:
    """Blocks that were written, no value of them 0, are told alike by every look at them, value by
    value and block by block, also after every read was asked for and its reply refused once."""
    driver = MscDriver(session)
    blocks = driver.scratch.some_blocks(3)
    for address in blocks:
        driver.write_block(address, driver.values(BLOCK_VALUES))
    first: dict[int, tuple[list[int], tuple[int, ...]]] = {}
    for number, address in enumerate((*blocks, *blocks, blocks[0])):
        if number == 2 * len(blocks):
            _refuse_once(driver, address)
        singles = [driver.read(place) for _, place in driver.scratch.within_block(address)]
        look = singles, driver.read_block(address)
        names = ("MSC-DREAD-04", "MSC-BREAD-04")
        text = f"what the first look at {address} told"
        session.expect(first.setdefault(address, look) == look, names, text, "something else")


def _refuse_once(driver: MscDriver, address: int) -> None:
    """Ask each of the reading commands, and refuse its reply once."""
    for body in dict.fromkeys((*driver.reads(), codec.bread(address), codec.dread(address))):
        driver.link.unanswered(body)
        driver.link.refuse_in("MSC-DREAD-04")
        driver.client.send(codec.ACK)


@check("MSC-DREAD-01", "MSC-BREAD-01", needs=("variables",))
def an_address_has_sixteen_bits(session: Session) -> None:
    """DREAD and BREAD take any of the named addresses as two bytes, bytes that are signs of the
    protocol among them."""
    driver = MscDriver(session)
    ends = driver.scratch.slots(2)
    free = range(driver.scratch.variables.start, driver.scratch.variables.stop - 3)
    places = [place for place in free if place % SAFE_STRIDE == 0]
    special = {
        next((place for place in places if divmod(place, 256)[part] == byte), places[0])
        for byte in SPECIAL_BYTES
        for part in (0, 1)
    }
    for address in sorted({*ends, *special}):
        driver.served(codec.dread(address), "MSC-DREAD-01", f"the value at {address:04X}h")
    for address in driver.scratch.some_blocks(3):
        driver.served(codec.bread(address), "MSC-BREAD-01", f"the values from {address:04X}h on")


@check("MSC-DREAD-01", "MSC-DWRITE-05", safety="stored", needs=("variables",))
def every_bit_of_an_address_counts(session: Session) -> None:
    """Variables whose addresses differ in a single bit hold values of their own."""
    driver = MscDriver(session)
    slots = set(range(driver.scratch.slots(2)[0], driver.scratch.variables.stop - 3, SAFE_STRIDE))
    pairs = {
        bit: next(
            ((slot, slot ^ 1 << bit) for slot in sorted(slots) if slot ^ 1 << bit in slots), None
        )
        for bit in range(2, 16)
    }
    places = sorted({place for pair in pairs.values() if pair for place in pair})
    if not places:  # two that stand side by side may differ in several bits, three cannot all
        session.skip(f"needs 3 variables {SAFE_STRIDE} addresses apart (--variables FIRST-LAST)")
    values = dict(zip(places, driver.values(len(places)), strict=True))
    for place, value in values.items():
        driver.write(place, value)
    for place, value in values.items():
        seen = driver.read(place)
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
    driver = MscDriver(session)
    for number, address in enumerate(driver.scratch.some_blocks(3)):
        values = list(BOUNDARIES[:BLOCK_VALUES]) if number == 0 else driver.values(BLOCK_VALUES)
        exchange = driver.ask(codec.bwrite(address, values))
        session.expect(exchange.is_acked, "MSC-BWRITE-01", "ACK to 32 values", exchange)
        reply = driver.served(codec.bread(address), "MSC-BREAD-01", "a reply to BREAD")
        size = len(reply.payload)
        session.expect(size == 128, "MSC-BREAD-02", "32 values in 128 bytes", f"{size} bytes")
        names = ("MSC-BWRITE-02", "MSC-BREAD-02", "MSC-BREAD-03")
        text, seen = codec.listed(values), codec.listed(reply.values)
        session.expect(list(reply.values) == values, names, text, seen)
        _judge_singles(driver, address, reply.values)
        driver.write(address, ~values[0])
        changed, text = driver.read_block(address)[0], f"{~values[0]} first, written since"
        session.expect(changed == ~values[0], ("MSC-BREAD-04", "MSC-PROP-12"), text, changed)


@check("MSC-BWRITE-02", "MSC-BREAD-03", safety="stored", needs=("variables",))
def values_of_a_block_may_be_alike(session: Session) -> None:
    """A block of 32 equal values, of two by turns, or of others between two equal ends, comes back
    as it was written, whatever was there."""
    driver = MscDriver(session)
    (address,) = driver.scratch.blocks(1)
    (one, other), within = driver.values(2), driver.values(BLOCK_VALUES - 2)
    half = BLOCK_VALUES // 2
    for values in ([one] * BLOCK_VALUES, [other, one] * half, [one, *within, one]):
        _judge_comes_back(driver, address, values)


def _judge_comes_back(driver: MscDriver, address: int, values: list[int]) -> None:
    """Write a block, and judge that it is read as it was written."""
    driver.write_block(address, values)
    seen, text = driver.read_block(address), codec.listed(values)
    names = ("MSC-BWRITE-02", "MSC-BREAD-03")
    driver.session.expect(list(seen) == values, names, text, codec.listed(seen))


def _judge_singles(driver: MscDriver, address: int, block: Sequence[int]) -> None:
    """Hold a block against single reads (PROP-12)."""
    for number, place in driver.scratch.within_block(address):
        seen = driver.read(place)
        if seen != block[number] != driver.read_block(address)[number]:
            driver.scratch.may_be_moved(place)
        names = ("MSC-BREAD-03", "MSC-PROP-12", *(("MSC-BREAD-04",) if number == 0 else ()))
        text = f"{block[number]} at {place}, value {number + 1} of the block"
        driver.session.expect(seen == block[number], names, text, seen)


@check("MSC-BWRITE-02", "MSC-BREAD-03", safety="stored", needs=("variables",))
def every_byte_may_stand_in_every_place_of_a_value(session: Session) -> None:
    """Each of the 256 bytes comes back by BREAD from each of the four places of a value, two of
    the same side by side."""
    driver = MscDriver(session)
    (address,) = driver.scratch.blocks(1)
    for first in range(0, 0x100, BLOCK_VALUES):
        places = range(first, first + BLOCK_VALUES)
        rows = [bytes((byte, byte, byte ^ 0xFF, byte ^ 0xFF)) for byte in places]
        values = [int.from_bytes(row, "big", signed=True) for row in rows]
        _judge_comes_back(driver, address, values)


@check("MSC-PKT-09", "MSC-DWRITE-02", "MSC-BWRITE-02", safety="stored", needs=("variables",))
def writes_right_behind_one_another_are_each_carried_out(session: Session) -> None:
    """Of several DWRITEs, or BWRITEs, to one place the last one counts, under whatever block number
    and though it equals an earlier one; nothing behind the place changes."""
    driver = MscDriver(session)
    address = driver.scratch.blocks(1)[0]
    behind = address + BLOCK_VALUES * driver.scratch.stride
    has_more = driver.scratch.may_write(behind)
    if has_more:
        driver.write(behind, 7)
    for block in (0, 1, 5, 0xFFFF):
        own = ("MSC-PKT-09",) if block else ()
        once, other = driver.values(BLOCK_VALUES), driver.values(BLOCK_VALUES)
        for values in (other, once, other, once):
            exchange = driver.ask(codec.bwrite(address, values), block)
            session.expect(exchange.is_acked, "MSC-PKT-09", f"ACK to block {block:04X}h", exchange)
        seen, text = driver.read_block(address), f"{codec.listed(once)}, written last"
        session.expect(list(seen) == once, own or "MSC-BWRITE-02", text, codec.listed(seen))
        for value in (-2, 1, -2, 1):
            exchange = driver.ask(codec.dwrite(address, value), block)
            session.expect(exchange.is_acked, "MSC-PKT-09", f"ACK to block {block:04X}h", exchange)
        value = driver.read(address)
        session.expect(value == 1, own or "MSC-DWRITE-02", f"1 at {address}, written last", value)
    if has_more:
        value = driver.read(behind)
        session.expect(value == 7, "MSC-BWRITE-02", f"7 at {behind}, behind the block", value)


@check("MSC-BREAD-03", "MSC-BREAD-04", "MSC-PROP-12", needs=("variables",))
def a_block_equals_its_single_reads(session: Session) -> None:
    """BREAD of what is there equals 32 DREADs, one stride apart."""
    driver = MscDriver(session)
    for address in driver.scratch.blocks(1):
        _judge_singles(driver, address, driver.read_block(address))


@check("MSC-DAT-02", safety="stored", needs=("variables",))
def values_of_a_block_lie_one_stride_apart(session: Session) -> None:
    """Which value of a block the address four further on holds, tells the stride; it is the same
    everywhere."""
    driver = MscDriver(session)
    for address in driver.scratch.some_blocks(3):
        values = driver.values(BLOCK_VALUES)
        driver.write_block(address, values)
        for further in (SAFE_STRIDE, 3 * SAFE_STRIDE, 7 * SAFE_STRIDE):
            seen = driver.read(address + further)
            strides = [stride for stride in STRIDES if values[further // stride] == seen]
            if not strides:
                text = [f"{values[further // stride]} (stride {stride})" for stride in STRIDES]
                session.fail(None, text, f"{seen} at {address}+{further}")
            driver.reading("data_address_stride", tuple(map(str, strides)))


@check("MSC-BWRITE-03", "MSC-BWRITE-01", safety="stored", needs=("variables",))
def padding_is_stored_as_well(session: Session) -> None:
    """Of 20 values padded to 32, all 32 are stored: the twelve behind the array are overwritten."""
    driver = MscDriver(session)
    (address,) = driver.scratch.blocks(1)
    driver.write_block(address, driver.values(BLOCK_VALUES))
    *_, (_, last) = driver.scratch.within_block(address)
    driver.write(last, 7)  # whatever BWRITE stores there
    padded = [*driver.values(SHORT_ARRAY), *[0] * (BLOCK_VALUES - SHORT_ARRAY)]
    exchange = driver.ask(codec.bwrite(address, padded))
    session.expect(exchange.is_acked, "MSC-BWRITE-01", "ACK to 32 values", exchange)
    seen = driver.read_block(address)
    text = codec.listed(padded)
    session.expect(list(seen) == padded, "MSC-BWRITE-03", text, codec.listed(seen))


@check("MSC-BWRITE-02", safety="stored", needs=("variables",))
def a_longer_array_is_sent_block_by_block(session: Session) -> None:
    """64 values sent by two BWRITEs, the second 32 strides on, lie in a row; neither block touches
    what is before or behind it."""
    driver = MscDriver(session)
    length = 2 * BLOCK_VALUES * driver.scratch.stride
    first = driver.scratch.slots(1)[0]
    if first + SAFE_STRIDE + length + SAFE_STRIDE > driver.scratch.variables.stop:
        session.skip(f"needs {length + 2 * SAFE_STRIDE} variables in a row (--variables)")
    start, behind = first + SAFE_STRIDE, first + SAFE_STRIDE + length
    fences = dict(zip((first, behind), driver.values(2), strict=True))
    for place, value in fences.items():
        driver.write(place, value)
    values = driver.values(2 * BLOCK_VALUES)
    for number in (0, BLOCK_VALUES):
        driver.write_block(
            start + number * driver.scratch.stride, values[number : number + BLOCK_VALUES]
        )
    middle = driver.read_block(start + BLOCK_VALUES // 2 * driver.scratch.stride)
    names = "MSC-BWRITE-02"
    wanted = values[BLOCK_VALUES // 2 : BLOCK_VALUES // 2 + BLOCK_VALUES]
    text = codec.listed(wanted)
    session.expect(list(middle) == wanted, names, text, codec.listed(middle))
    for place, value in fences.items():
        seen = driver.read(place)
        session.expect(seen == value, "MSC-BWRITE-02", f"{value} at {place} as before", seen)
