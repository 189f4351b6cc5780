"""Faults of the commands in general: names, commas, sizes, and what is said to them (CMD, MOD)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.msc import controller as controller_module
from axistwin.devices.msc.models import MODELS
from axistwin.devices.msc.receiver import ACCEPTED, REFUSED, Verdict
from zoo_msc.planting import (
    Any_,
    Commands,
    MonkeyPatch,
    accepts,
    around,
    bodies,
    carry_out,
    msc_mutant,
    payloads,
    replies,
    resummed,
    total,
)

LETTERS = 8  # at most, of a name

# --- replies -------------------------------------------------------------------------------------


@msc_mutant("MSC-CMD-04")
def a_flags_reply_has_a_blank_for_its_comma(patch: MonkeyPatch) -> None:
    """Name and state are parted by 20h."""
    replies(patch, lambda raw: resummed(raw.replace(b",", b" ")), "RFLAG")


@msc_mutant("MSC-CMD-04")
def a_value_is_told_under_the_name_of_its_write(patch: MonkeyPatch) -> None:
    """DREAD's reply begins as the DWRITE that would store the value."""
    _renamed(patch, b"DREAD,", b"DWRITE,")


@msc_mutant("MSC-CMD-04")
def a_name_is_told_with_a_letter_twice(patch: MonkeyPatch) -> None:
    """RFLAG's reply says RRFLAG, under the length and the sum of what it should say."""
    replies(patch, lambda raw: raw[:7] + raw[6:], "RFLAG")


def _renamed(patch: MonkeyPatch, name: bytes, instead: bytes) -> None:
    around(
        patch,
        Commands,
        "_read",
        lambda go, unit, known, build: go(instead if known == name else known, build),
    )


@msc_mutant("MSC-CMD-02")
def the_status_has_no_comma(patch: MonkeyPatch) -> None:
    """RQSTAT's reply goes on right behind its name, and ends with one byte more."""

    def change(raw: bytes) -> bytes:
        return resummed(raw[:12] + raw[13:-2] + b"\0" + raw[-2:])

    replies(patch, change, "RQSTAT")


@msc_mutant("MSC-CMD-12", "MSC-DREAD-02")
def a_value_is_told_with_its_address(patch: MonkeyPatch) -> None:
    """DREAD's reply repeats the address asked for."""
    _with_its_number(patch, b"DREAD")


@msc_mutant("MSC-CMD-12")
def a_state_is_told_with_its_flag(patch: MonkeyPatch) -> None:
    """RFLAG's reply repeats the number asked for."""
    _with_its_number(patch, b"RFLAG")


def _with_its_number(patch: MonkeyPatch, command: bytes) -> None:
    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        verdict = go()
        name, _, values = body.partition(b",")
        build = verdict.reply
        if name != command or build is None:
            return verdict
        at = len(name) + 1
        return verdict._replace(reply=lambda when: _put_in(build(when), at, values))

    bodies(patch, act)


def _put_in(reply: bytes, at: int, values: bytes) -> bytes:
    return reply[:at] + values + reply[at:]


@msc_mutant("MSC-CMD-05", "MSC-RFLAG-01")
def a_flag_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """RFLAG draws its ACK and nothing more, as SFLAG does."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        verdict = go()
        return Verdict(verdict.sign) if body.startswith(b"RFLAG,") else verdict

    bodies(patch, act)


# --- names ---------------------------------------------------------------------------------------


def _unknown(patch: MonkeyPatch, name: bytes) -> None:
    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return REFUSED if body.startswith(name + b",") else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-01", "MSC-CMD-06", "MSC-CFLAG-01")
def cflag_is_not_known(patch: MonkeyPatch) -> None:
    """A flag can be turned on only."""
    _unknown(patch, b"CFLAG")


@msc_mutant("MSC-CMD-01", "MSC-CMD-06", "MSC-SFLAG-01")
def sflag_is_not_known(patch: MonkeyPatch) -> None:
    """A flag can be turned off only."""
    _unknown(patch, b"SFLAG")


@msc_mutant("MSC-CMD-06", "MSC-BREAD-01")
def bread_is_not_known(patch: MonkeyPatch) -> None:
    """Values are read one by one."""
    _unknown(patch, b"BREAD")


@msc_mutant("MSC-MOD-01", "MSC-RFLAGS-01")
def this_model_has_no_rflags(patch: MonkeyPatch) -> None:
    """The MSC-250 has the commands of the older models."""
    _unknown(patch, b"RFLAGS")


@msc_mutant("MSC-MOD-02", traps=(35,), model="msc-generic")
def every_model_has_rflags(patch: MonkeyPatch) -> None:
    """The other models have the commands of the MSC-250."""
    named = {name: replace(model, has_rflags=True) for name, model in MODELS.items()}
    patch.setattr(controller_module, "MODELS", named)


@msc_mutant("MSC-CMD-07", traps=(9,))
def names_are_compared_by_their_beginning(patch: MonkeyPatch) -> None:
    """The first command that a body begins with is taken: RFLAGS is an RFLAG with much behind
    it."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if body.startswith(b"RFLAGS"):
            return go(now, b"RFLAG," + body[len(b"RFLAG") :])
        return go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-07", traps=(9,))
def five_letters_of_a_name_count(patch: MonkeyPatch) -> None:
    """RFLAGS without what makes it another command is served by one flag, number 0."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return go(now, b"RFLAG,\0\0") if body == b"RFLAGS," else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-08", traps=(10,))
def a_body_is_split_at_every_comma(patch: MonkeyPatch) -> None:
    """Of what is behind the name only what is before the next comma counts."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, values, *_ = [*body.split(b","), b""]
        return go(now, name + b"," + values) if b"," in body else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-08", traps=(10,))
def the_last_comma_parts_name_and_values(patch: MonkeyPatch) -> None:
    """A comma among the values belongs to a name that nobody knows."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return REFUSED if body.count(b",") > 1 else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-03", "MSC-PKT-12")
def a_sum_may_leave_the_comma_out(patch: MonkeyPatch) -> None:
    """A checksum that does not count the comma is right as well."""
    accepts(patch, lambda raw: total(raw[1:-2].replace(b",", b"", 1)) == raw[-2:])


@msc_mutant("MSC-CMD-09")
def a_capital_first_letter_is_enough(patch: MonkeyPatch) -> None:
    """Rqstat is served, rqstat is not."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, comma, values = body.partition(b",")
        return go(now, name.upper() + comma + values) if name[:1].isupper() else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-10")
def an_unknown_name_is_served_as_the_last_one(patch: MonkeyPatch) -> None:
    """What is not found leaves the pointer at the table's end: it is answered like RQSTAT."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        is_known = body.partition(b",")[0].upper() in unit._by_name
        return go() if is_known or b"," not in body else go(now, b"RQSTAT,")

    bodies(patch, act)


@msc_mutant("MSC-CMD-10")
def an_unknown_name_is_refused_only_without_values(patch: MonkeyPatch) -> None:
    """With values behind it a name that nobody knows is acknowledged."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, _, values = body.partition(b",")
        return ACCEPTED if values and name.upper() not in unit._by_name else go()

    bodies(patch, act)


# --- sizes ---------------------------------------------------------------------------------------


def _fitted(patch: MonkeyPatch, command: bytes, size: int) -> None:
    """Let the values of a reading command that have so many bytes be made two."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, _, values = body.partition(b",")
        is_so = name == command and len(values) == size
        return go(now, name + b"," + values[:2].rjust(2, b"\0")) if is_so else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-11", "MSC-DREAD-01")
def one_byte_behind_an_address_does_no_harm(patch: MonkeyPatch) -> None:
    """DREAD with one more byte is served, with two more it is refused."""
    _fitted(patch, b"DREAD", 3)


@msc_mutant("MSC-CMD-11", "MSC-BREAD-01")
def two_bytes_behind_an_address_do_no_harm(patch: MonkeyPatch) -> None:
    """BREAD with two more bytes is served, with one more it is refused."""
    _fitted(patch, b"BREAD", 4)


@msc_mutant("MSC-CMD-11", "MSC-RFLAG-01")
def a_flag_may_be_named_in_one_byte(patch: MonkeyPatch) -> None:
    """RFLAG's number may be as short as it is."""
    _fitted(patch, b"RFLAG", 1)


@msc_mutant("MSC-CMD-11", "MSC-BWRITE-01")
def a_shorter_block_is_stored(patch: MonkeyPatch) -> None:
    """BWRITE takes 31 values as well, and stores them."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if not body.startswith(b"BWRITE,") or len(body) != 133:
            return go()
        for at in range(9, 133, 4):
            carry = b"DWRITE," + (int.from_bytes(body[7:9], "big") + at - 9).to_bytes(2, "big")
            verdict = go(now, carry + body[at : at + 4])
            assert verdict.act is not None
            verdict.act(now)
        return ACCEPTED

    bodies(patch, act)


@msc_mutant("MSC-CMD-11", "MSC-SFLAG-01")
def a_flag_in_three_bytes_is_turned_on(patch: MonkeyPatch) -> None:
    """Of SFLAG's values the last two are taken, however many there are."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        is_longer = body.startswith(b"SFLAG,") and len(body) == 9
        return go(now, body[:6] + body[6:8]) if is_longer else go()

    bodies(patch, act)


@msc_mutant("MSC-RFLAG-02", "MSC-CMD-12", traps=(28,))
def a_state_has_one_byte(patch: MonkeyPatch) -> None:
    """RFLAG's reply is one byte, 00 or 01."""
    payloads(patch, lambda state: state[1:], "RFLAG")


def _refused_but_done(patch: MonkeyPatch, name: bytes, sizes: range, whole: int) -> None:
    """Let a write whose body has one of these sizes be carried out as if it had `whole` bytes, and
    refused."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if not body.startswith(name + b",") or len(body) not in sizes:
            return go()
        carry_out(unit, now, body[:whole].ljust(whole, b"\0"))
        return REFUSED

    bodies(patch, act)


@msc_mutant("MSC-BWRITE-01", "MSC-CMD-11", "MSC-LNK-06")
def a_shorter_block_is_refused_and_stored(patch: MonkeyPatch) -> None:
    """BWRITE stores what has come while it counts, and says NAK if there are fewer than 32."""
    _refused_but_done(patch, b"BWRITE", range(9, 137), 137)


@msc_mutant("MSC-CFLAG-01", "MSC-CMD-11", "MSC-LNK-06")
def a_flag_in_three_bytes_is_refused_and_turned_off(patch: MonkeyPatch) -> None:
    """CFLAG looks behind its number when the flag is off."""
    _refused_but_done(patch, b"CFLAG", range(9, 11), 8)


@msc_mutant("MSC-DWRITE-01", "MSC-CMD-11", "MSC-LNK-06")
def a_value_in_eight_bytes_is_refused_and_stored(patch: MonkeyPatch) -> None:
    """Of a DWRITE with two values the first is stored before the second is seen."""
    _refused_but_done(patch, b"DWRITE", range(17, 18), 13)
