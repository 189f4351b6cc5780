"""Faults that the table of negations had and nobody had planted: of values, flags and the status
word."""

from __future__ import annotations

import struct
from typing import Any

from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.data_area import VALUE_MAX, signed
from axistwin.devices.msc.flags import FLAGS
from axistwin.devices.msc.status import Status, StatusBit
from zoo_msc.planting import (
    MS,
    Any_,
    Commands,
    MonkeyPatch,
    around,
    at,
    msc_mutant,
    number_in,
    on,
    payloads,
)

SAFE_END = 5120  # where what the bench program looks at begins


def _also(patch: MonkeyPatch, name: bytes, effect: Any_) -> None:
    """Let a write that is carried out do `effect(unit, when, body)` behind it."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        carry = verdict.act
        if carry is None:
            return verdict

        def both(when: int) -> Any:
            again = carry(when)
            effect(unit, when, body)
            return again

        return verdict._replace(act=both)

    on(patch, name, act)


def _stores(patch: MonkeyPatch, change: Any_) -> None:
    """Let DWRITE store `change(value)`."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        value = int.from_bytes(body[9:13], "big", signed=True)
        stored = int(change(value)).to_bytes(4, "big", signed=True)
        return go(now, body[:9] + stored) if len(body) == 13 else go()

    on(patch, b"DWRITE", act)


# --- single values -------------------------------------------------------------------------------


@msc_mutant("MSC-DWRITE-02", "MSC-PROP-08")
def a_value_is_kept_as_a_real_number(patch: MonkeyPatch) -> None:
    """DWRITE stores 24 bits that count and an exponent: what is above 2**24 is rounded."""

    def change(value: int) -> int:
        return min(int(struct.unpack("f", struct.pack("f", value))[0]), VALUE_MAX)

    _stores(patch, change)


@msc_mutant("MSC-DWRITE-02", "MSC-PROP-08", "MSC-DREAD-03")
def a_value_has_24_bits(patch: MonkeyPatch) -> None:
    """DWRITE stores the low three bytes with their sign."""
    _stores(patch, lambda value: signed(value << 8) >> 8)


@msc_mutant("MSC-DREAD-03", "MSC-PROP-08")
def the_lowest_value_is_told_as_the_one_above_it(patch: MonkeyPatch) -> None:
    """DREAD knows no number that has no opposite: 80000000h reads as 80000001h."""
    payloads(patch, lambda value: b"\x80\0\0\1" if value == b"\x80\0\0\0" else value, "DREAD")


@msc_mutant("MSC-DREAD-01", "MSC-DREAD-03")
def a_value_is_told_as_at_most_31_bits(patch: MonkeyPatch) -> None:
    """DREAD tells 40000000h and what is above it, or below its opposite, as that."""

    def change(value: bytes) -> bytes:
        number = int.from_bytes(value, "big", signed=True)
        return max(-(1 << 30), min(1 << 30, number)).to_bytes(4, "big", signed=True)

    payloads(patch, change, "DREAD")


@msc_mutant("MSC-BREAD-03", "MSC-PROP-12", "MSC-BREAD-04")
def the_low_byte_of_an_address_has_a_sign(patch: MonkeyPatch) -> None:
    """DREAD and DWRITE add it as a signed character: from 80h on they mean what is 256 before."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        address = number_in(body)
        is_so = address & 0x80 and 256 <= address < SAFE_END
        return go(now, at(body, address - 256)) if is_so else go()

    for name in (b"DREAD", b"DWRITE"):
        on(patch, name, act)


@msc_mutant("MSC-DWRITE-04", "MSC-DWRITE-02", "MSC-PROP-08")
def a_value_is_seen_a_tenth_of_a_second_later(patch: MonkeyPatch) -> None:
    """For 100 ms behind its DWRITE an address reads as it did before."""

    def write(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        place = number_in(body)
        if place < SAFE_END and unit._data.has(place):
            old = unit._data.read(place)
            unit.before = {**getattr(unit, "before", {}), place: (now + 100 * MS, old)}
        return go()

    def read(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        until, old = getattr(unit, "before", {}).get(number_in(body), (0, 0))
        if now >= until:
            return go()
        return unit._read(b"DREAD,", lambda when: old.to_bytes(4, "big", signed=True))

    on(patch, b"DWRITE", write)
    on(patch, b"DREAD", read)


@msc_mutant("MSC-DWRITE-05", "MSC-PROP-09")
def the_value_before_is_cleared(patch: MonkeyPatch) -> None:
    """DWRITE stores 64 bits, the high ones, which are 0, in front."""

    def effect(unit: Any, when: int, body: bytes) -> None:
        place = number_in(body) - 4
        if 0 <= place < SAFE_END:
            unit._data.write(place, 0)

    _also(patch, b"DWRITE", effect)


# --- blocks --------------------------------------------------------------------------------------


@msc_mutant("MSC-BREAD-02", "MSC-PROP-01")
def a_block_has_31_values(patch: MonkeyPatch) -> None:
    """BREAD's reply ends one value early, and its length says so."""
    payloads(patch, lambda block: block[:-4], "BREAD")


@msc_mutant("MSC-BREAD-02", "MSC-BREAD-03")
def values_of_a_block_have_sixteen_bits(patch: MonkeyPatch) -> None:
    """BREAD tells the low half of each value, widened with its sign."""

    def change(block: bytes) -> bytes:
        halves = struct.unpack(">32i", block)
        return struct.pack(">32i", *(signed(one << 16) >> 16 for one in halves))

    payloads(patch, change, "BREAD")


@msc_mutant("MSC-BREAD-04", "MSC-PROP-12")
def a_block_is_told_as_it_was_read_before(patch: MonkeyPatch) -> None:
    """BREAD of the address of the BREAD before is served from a copy, whatever a DWRITE has
    changed since."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        kept, place = getattr(unit, "copy", None), number_in(body)
        verdict = go()
        if verdict.reply is None or place > SAFE_END:
            return verdict
        if kept is None or kept[0] != place:
            unit.copy = kept = (place, verdict.reply(now))
        return verdict._replace(reply=lambda when: kept[1])

    def forget(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        unit.copy = None
        return go()

    on(patch, b"BREAD", act)
    on(patch, b"BWRITE", forget)


@msc_mutant("MSC-BREAD-03")
def a_block_begins_behind_its_address(patch: MonkeyPatch) -> None:
    """BWRITE and BREAD begin with the value after the one that is named."""
    for name in (b"BREAD", b"BWRITE"):
        on(
            patch,
            name,
            lambda go, unit, now, body: (
                go(now, at(body, number_in(body) + 4)) if number_in(body) < SAFE_END else go()
            ),
        )


@msc_mutant("MSC-BWRITE-02", "MSC-BWRITE-03")
def the_last_value_of_a_block_is_not_stored(patch: MonkeyPatch) -> None:
    """BWRITE's loop ends one value early."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        place = number_in(body) + 124
        if len(body) != 137 or not unit._data.has(place) or place > SAFE_END:
            return go()
        return go(now, body[:-4] + unit._data.read(place).to_bytes(4, "big", signed=True))

    on(patch, b"BWRITE", act)


@msc_mutant("MSC-BWRITE-02")
def a_block_clears_the_value_behind_it(patch: MonkeyPatch) -> None:
    """BWRITE's loop ends one value late, behind its buffer."""

    def effect(unit: Any, when: int, body: bytes) -> None:
        place = number_in(body) + 128
        if place < SAFE_END:
            unit._data.write(place, 0)

    _also(patch, b"BWRITE", effect)


@msc_mutant("MSC-BWRITE-02", "MSC-BREAD-03")
def values_of_a_block_are_stored_in_halves_exchanged(patch: MonkeyPatch) -> None:
    """BWRITE stores the low word of each value before the high one."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if len(body) != 137 or number_in(body) > SAFE_END:
            return go()
        words = [body[at : at + 2] for at in range(9, 137, 2)]
        pairs = zip(words[1::2], words[::2], strict=True)
        return go(now, body[:9] + b"".join(word for pair in pairs for word in pair))

    on(patch, b"BWRITE", act)


# --- flags ---------------------------------------------------------------------------------------


@msc_mutant("MSC-CFLAG-02", "MSC-PROP-10")
def a_flag_is_not_turned_off(patch: MonkeyPatch) -> None:
    """CFLAG draws its ACK and does nothing."""
    on(patch, b"CFLAG", lambda go, unit, now, body: go()._replace(act=None))


@msc_mutant("MSC-CFLAG-02", "MSC-PROP-10")
def a_flag_that_is_cleared_again_goes_on(patch: MonkeyPatch) -> None:
    """CFLAG turns a flag over."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        number = number_in(body)
        is_on = number < FLAGS and bool(unit._flags._on >> number & 1)
        return go() if is_on or number >= FLAGS else go(now, b"S" + body[1:])

    on(patch, b"CFLAG", act)


@msc_mutant("MSC-PROP-10")
def a_flag_goes_off_with_its_read(patch: MonkeyPatch) -> None:
    """RFLAG of a flag of the host's that is on turns it off."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict, number = go(), number_in(body)
        build = verdict.reply
        if build is None or number >= FLAGS or not unit._flags.may_host_write(number):
            return verdict
        reply = build(now)
        unit._flags.set(number, False)
        return verdict._replace(reply=lambda when: reply)

    on(patch, b"RFLAG", act)


@msc_mutant("MSC-RFLAG-02")
def a_flag_is_told_as_it_was_looked_at_before(patch: MonkeyPatch) -> None:
    """RFLAG of the same flag as the RFLAG before gives the state that it had then."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        if build is None:
            return verdict
        kept = getattr(unit, "looked", None)
        unit.looked = (number_in(body), build(now))
        reply = kept[1] if kept is not None and kept[0] == number_in(body) else unit.looked[1]
        return verdict._replace(reply=lambda when: reply)

    on(patch, b"RFLAG", act)


@msc_mutant("MSC-RFLAGS-02", "MSC-RFLAGS-03", "MSC-PROP-11")
def the_last_eight_flags_are_never_told(patch: MonkeyPatch) -> None:
    """RFLAGS' last byte is 0."""
    payloads(patch, lambda states: states[:31] + b"\0", "RFLAGS")


@msc_mutant("MSC-RFLAGS-02", "MSC-RFLAGS-03")
def all_flags_are_told_one_place_up(patch: MonkeyPatch) -> None:
    """RFLAGS counts the flags from 1: flag 0 is at the place of flag 1."""

    def change(states: bytes) -> bytes:
        number = int.from_bytes(states, "little") << 1
        return (number & (1 << FLAGS) - 1).to_bytes(32, "little")

    payloads(patch, change, "RFLAGS")


# --- the status word -----------------------------------------------------------------------------


def _told(patch: MonkeyPatch, change: Any_) -> None:
    """Let RQSTAT tell `change(word)`."""
    around(patch, Status, "read", lambda go, status: change(go()))


@msc_mutant("MSC-STA-01", "MSC-STA-02")
def auto_start_is_not_told(patch: MonkeyPatch) -> None:
    """Bit 6 is always off."""
    _told(patch, lambda word: word & ~StatusBit.AUTO_START)


@msc_mutant("MSC-STA-01", "MSC-STA-02")
def auto_start_is_told_and_not_done(patch: MonkeyPatch) -> None:
    """Bit 6 outlasts a power cut, and no program is started."""

    def off(go: Any_, controller: Any, now: int) -> Any:
        controller.was_auto = controller.status.has(StatusBit.AUTO_START)
        return go()

    def on(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        controller.status.set(StatusBit.AUTO_START, controller.was_auto)
        return effects

    around(patch, MscController, "power_off", off)
    around(patch, MscController, "power_on", on)


@msc_mutant("MSC-STA-02")
def errors_from_bit_11_on_are_told_one_bit_lower(patch: MonkeyPatch) -> None:
    """Who left the bit for the load in progress out has all behind it in the wrong place."""
    _told(patch, lambda word: word & 0x07FF | (word & 0xF800) >> 1)


@msc_mutant("MSC-STA-02")
def the_highest_bit_is_not_told(patch: MonkeyPatch) -> None:
    """A status word of fifteen bits has no room for the interrupt table."""
    _told(patch, lambda word: word & 0x7FFF)


@msc_mutant("MSC-STA-02")
def an_error_stays_told(patch: MonkeyPatch) -> None:
    """What bit 12 and those above it have told once they tell until the supply is cut."""

    def act(go: Any_, status: Any) -> int:
        status.kept = getattr(status, "kept", 0) | int(go()) & 0xF000
        return int(go()) | int(status.kept)

    around(patch, Status, "read", act)


@msc_mutant("MSC-STA-03")
def low_battery_hides_unreliable_memory(patch: MonkeyPatch) -> None:
    """Of bits 1 to 5 only the lowest that is on is told."""

    def change(word: int) -> int:
        low = word & 0x3E
        return word & ~0x3E | low & -low

    _told(patch, change)


@msc_mutant("MSC-RQSTAT-01")
def the_status_is_followed_by_seven_bytes(patch: MonkeyPatch) -> None:
    """FF has three bytes and AAAA four."""
    payloads(patch, lambda status: status + b"\0", "RQSTAT")
