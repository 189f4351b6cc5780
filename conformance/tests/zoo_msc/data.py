"""Faults of the data area: single values, blocks, addresses (DREAD, DWRITE, BREAD, BWRITE, DAT)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from axistwin.devices.msc.data_area import BLOCK_VALUES, VALUE_MAX, DataArea, signed
from axistwin.devices.msc.receiver import ACCEPTED, REFUSED, Verdict
from zoo_msc.planting import (
    Any_,
    Commands,
    MonkeyPatch,
    around,
    at,
    bodies,
    carry_out,
    msc_mutant,
    number_in,
    on,
    payloads,
)

BLOCK_BYTES = 128
PROGRAM_BLOCK = 6144 + 128


# --- single values -------------------------------------------------------------------------------


@msc_mutant("MSC-DREAD-03", traps=(27,))
def a_negative_value_reads_as_its_amount(patch: MonkeyPatch) -> None:
    """DREAD has no sign."""

    def change(value: bytes) -> bytes:
        number = int.from_bytes(value, "big", signed=True)
        return min(abs(number), VALUE_MAX).to_bytes(4, "big")

    payloads(patch, change, "DREAD")


@msc_mutant("MSC-DREAD-03", traps=(27,))
def a_value_of_sixteen_bits_is_widened_with_its_sign(patch: MonkeyPatch) -> None:
    """Values from 8000h to FFFFh read as negative ones."""

    def change(value: bytes) -> bytes:
        is_so = value[:2] == b"\0\0" and value[2] >= 0x80
        return b"\xff\xff" + value[2:] if is_so else value

    payloads(patch, change, "DREAD")


@msc_mutant("MSC-DREAD-01", "MSC-DWRITE-05")
def an_address_has_eleven_bits(patch: MonkeyPatch) -> None:
    """Bit 11 of a single value's address is not wired: what is 2048 further on is the same."""
    for name in (b"DREAD", b"DWRITE"):
        on(patch, name, lambda go, unit, now, body: go(now, at(body, number_in(body) & ~0x800)))


@msc_mutant("MSC-BREAD-01")
def an_address_of_a_block_may_hold_no_sign(patch: MonkeyPatch) -> None:
    """BREAD is refused where a byte of its address is 06h or 15h."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return REFUSED if {0x06, 0x15} & set(body[6:]) and number_in(body) < 5120 else go()

    on(patch, b"BREAD", act)


@msc_mutant("MSC-DREAD-04", "MSC-PROP-13")
def a_value_counts_its_reads(patch: MonkeyPatch) -> None:
    """Each DREAD of a value makes it one more for whoever reads it next."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict, place = go(), number_in(body)
        build = verdict.reply
        if build is None or place > 5120:
            return verdict
        reply = build(now)
        unit._data.write(place, signed(unit._data.read(place) + 1))
        return verdict._replace(reply=lambda when: reply)

    on(patch, b"DREAD", act)


@msc_mutant("MSC-DREAD-04")
def a_value_is_taken_out_by_its_read(patch: MonkeyPatch) -> None:
    """A DREAD leaves 0 behind."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict, place = go(), number_in(body)
        build = verdict.reply
        if build is None or place > 5120:
            return verdict
        reply = build(now)
        unit._data.write(place, 0)
        return verdict._replace(reply=lambda when: reply)

    on(patch, b"DREAD", act)


@msc_mutant("MSC-BREAD-04")
def a_block_begins_with_the_number_of_its_reads(patch: MonkeyPatch) -> None:
    """The first of BREAD's values is one more each time."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        if build is None or number_in(body) > 5120:
            return verdict
        unit.reads = getattr(unit, "reads", 0) + 1
        count = unit.reads.to_bytes(4, "big")
        return verdict._replace(reply=lambda when: build(when)[:6] + count + build(when)[10:])

    on(patch, b"BREAD", act)


@msc_mutant("MSC-DWRITE-02", "MSC-DREAD-02", traps=(11,))
def seven_bits_of_each_byte_are_stored(patch: MonkeyPatch) -> None:
    """What DWRITE brings is text: bit 7 of its values is dropped."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return go(now, body[:9] + bytes(one & 0x7F for one in body[9:]))

    on(patch, b"DWRITE", act)


@msc_mutant("MSC-DWRITE-01", "MSC-PKT-15", traps=(11,))
def a_value_that_is_no_text_is_refused(patch: MonkeyPatch) -> None:
    """DWRITE with a byte above 7Fh behind its address is no valid body."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return go() if body[9:].isascii() else REFUSED

    on(patch, b"DWRITE", act)


@msc_mutant("MSC-DWRITE-04", "MSC-DWRITE-02", "MSC-PROP-08")
def a_value_is_stored_when_the_next_one_comes(patch: MonkeyPatch) -> None:
    """A DWRITE is carried out behind the command that follows it."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        late, unit.late = getattr(unit, "late", b""), b""
        if body.startswith(b"DWRITE,") and number_in(body) < 5120:
            unit.late = body
            verdict: Any = ACCEPTED
        else:
            verdict = go()
        if late and verdict.reply is not None:
            build = verdict.reply
            reply = build(now)
            verdict = verdict._replace(reply=lambda when: reply)
        if late:
            carry = go(now, late)
            if carry.act is not None:
                carry.act(now)
        return verdict

    bodies(patch, act)


@msc_mutant("MSC-DWRITE-02")
def a_value_of_0_is_not_stored(patch: MonkeyPatch) -> None:
    """DWRITE of 0 is acknowledged and leaves what was there."""
    on(
        patch,
        b"DWRITE",
        lambda go, unit, now, body: go() if any(body[9:]) else ACCEPTED,
    )


@msc_mutant("MSC-DWRITE-05", "MSC-PROP-09")
def a_value_is_stored_with_its_sign_behind_it(patch: MonkeyPatch) -> None:
    """DWRITE stores 64 bits."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        place = number_in(body) + 4
        if unit._data.has(place) and place < 5120:
            carry_out(unit, now, b"BREAD," + body[7:9])
            unit._data.write(place, -1 if body[9] & 0x80 else 0)
        return go()

    on(patch, b"DWRITE", act)


# --- blocks --------------------------------------------------------------------------------------


def _values(block: bytes) -> list[bytes]:
    return [block[at : at + 4] for at in range(0, len(block), 4)]


@msc_mutant("MSC-BREAD-02", "MSC-BREAD-03")
def the_last_value_of_a_block_is_that_before_it(patch: MonkeyPatch) -> None:
    """BREAD's loop ends one value early."""
    payloads(patch, lambda block: block[:-4] + block[-8:-4], "BREAD")


@msc_mutant("MSC-BREAD-03", "MSC-PROP-12")
def a_block_begins_with_its_last_value(patch: MonkeyPatch) -> None:
    """BWRITE and BREAD agree on it; single values stand the other way round."""
    payloads(patch, lambda block: b"".join(_values(block)[::-1]), "BREAD")
    on(
        patch,
        b"BWRITE",
        lambda go, unit, now, body: go(now, body[:9] + b"".join(_values(body[9:])[::-1])),
    )


@msc_mutant("MSC-PROP-12")
def a_value_is_told_as_it_was_written_alone(patch: MonkeyPatch) -> None:
    """DREAD of where a DWRITE went gives that value, whatever a BWRITE has stored there since."""

    def write(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        unit.alone = {**getattr(unit, "alone", {}), number_in(body): body[9:13]}
        return go()

    def read(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        kept = getattr(unit, "alone", {}).get(number_in(body))
        if kept is None or number_in(body) > 5120:
            return go()
        return unit._read(b"DREAD,", lambda when: kept)

    on(patch, b"DWRITE", write)
    on(patch, b"DREAD", read)


@msc_mutant("MSC-BWRITE-02")
def a_block_is_written_in_the_page_of_its_address(patch: MonkeyPatch) -> None:
    """BWRITE begins at the multiple of 128 below its address."""
    on(
        patch,
        b"BWRITE",
        lambda go, unit, now, body: go(now, at(body, number_in(body) & ~(BLOCK_BYTES - 1))),
    )


@msc_mutant("MSC-BWRITE-03", traps=(25,))
def zeros_behind_an_array_are_not_stored(patch: MonkeyPatch) -> None:
    """Of a BWRITE's values those are stored that end with the last that is not 0."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        count = len(body[9:].rstrip(b"\0")) // 4 + 1
        place, verdict = number_in(body), go()
        if verdict.act is None or place > 5120:
            return verdict
        kept = unit._data.read_block(place)
        old = b"".join(value.to_bytes(4, "big", signed=True) for value in kept)
        return go(now, body[: 9 + 4 * count] + old[4 * count :])

    on(patch, b"BWRITE", act)


@msc_mutant("MSC-BWRITE-07")
def a_block_over_the_end_is_refused_too_late(patch: MonkeyPatch) -> None:
    """BWRITE stores what fits, and then says NAK."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        if verdict is REFUSED and unit._data.has(number_in(body)):
            for number, value in enumerate(_values(body[9:])):
                place = number_in(body) + 4 * number
                if unit._data.has(place):
                    unit._data.write(place, int.from_bytes(value, "big", signed=True))
        return verdict

    on(patch, b"BWRITE", act)


def _over_the_end(patch: MonkeyPatch, fill: Callable[[bytes], bytes]) -> None:
    """Serve BREAD of a block over the end by what `fill` makes of the values that are there."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        place, data = number_in(body), unit._data
        if go() is not REFUSED or not data.has(place):
            return go()
        there = [data.read(one) for one in range(place, place + BLOCK_BYTES, 4) if data.has(one)]
        block = b"".join(value.to_bytes(4, "big", signed=True) for value in there)
        return unit._read(b"BREAD,", lambda when: fill(block))

    on(patch, b"BREAD", act)


@msc_mutant("MSC-BREAD-05")
def behind_the_end_all_bits_are_set(patch: MonkeyPatch) -> None:
    """BREAD of a block over the end is served; what is not there reads as -1."""

    _over_the_end(patch, lambda there: there.ljust(BLOCK_BYTES, b"\xff"))


@msc_mutant("MSC-BWRITE-06")
def a_block_in_use_is_stored_in_part(patch: MonkeyPatch) -> None:
    """Of a BWRITE to the array that the running program looks at the first half is stored."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if number_in(body) != PROGRAM_BLOCK or not any(body[9:]):
            return go()
        kept = unit._data.read_block(PROGRAM_BLOCK)[BLOCK_VALUES // 2 :]
        old = b"".join(value.to_bytes(4, "big", signed=True) for value in kept)
        return go(now, body[: 9 + BLOCK_BYTES // 2] + old)

    on(patch, b"BWRITE", act)


# --- places --------------------------------------------------------------------------------------


@msc_mutant("MSC-DAT-02")
def values_of_a_block_lie_eight_apart(patch: MonkeyPatch) -> None:
    """BWRITE and BREAD leave a gap between neighbours."""

    def act(go: Any_, area: Any, address: int, count: int = BLOCK_VALUES) -> Any:
        place = area._place(address)
        return range(place, place + 8 * count, 8)

    around(patch, DataArea, "block_places", act)


@msc_mutant("MSC-DAT-03")
def a_block_outside_the_data_area_is_zeros(patch: MonkeyPatch) -> None:
    """DREAD is refused there, BREAD is not."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if unit._data.has(number_in(body)):
            return go()
        return unit._read(b"BREAD,", lambda when: bytes(BLOCK_BYTES))

    on(patch, b"BREAD", act)


@msc_mutant("MSC-DREAD-01")
def an_address_inside_a_value_reads_bytes_in_between(patch: MonkeyPatch) -> None:
    """From the second byte of a value on, it is read as if it stood at the first and had its bytes
    exchanged."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        inside = number_in(body) % 4
        verdict = go(now, at(body, number_in(body) - inside))
        build = verdict.reply
        if not inside or build is None:
            return verdict
        return verdict._replace(reply=lambda when: _turned(build(when), inside))

    on(patch, b"DREAD", act)


def _turned(reply: bytes, count: int) -> bytes:
    return reply[:6] + reply[6 + count :] + reply[6 : 6 + count]


@msc_mutant("MSC-BREAD-02")
def a_block_over_the_end_is_told_short(patch: MonkeyPatch) -> None:
    """BREAD over the end of the data area is served with the values that are there."""

    _over_the_end(patch, lambda there: there)


@msc_mutant("MSC-BREAD-05")
def a_block_up_to_the_end_is_refused(patch: MonkeyPatch) -> None:
    """BREAD whose last value is the last there is runs over the end by one."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        return go() if unit._data.has(number_in(body) + BLOCK_BYTES) else REFUSED

    on(patch, b"BREAD", act)


@msc_mutant("MSC-DAT-03")
def a_block_outside_is_refused_behind_its_ack(patch: MonkeyPatch) -> None:
    """BWRITE's place is looked at when it is carried out: ACK, then NAK."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        return go() if unit._data.has(number_in(body)) else Verdict(b"\x06\x15")

    on(patch, b"BWRITE", act)
