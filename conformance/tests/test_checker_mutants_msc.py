"""The checker of the MSC controllers is mutated too: a wrong model, codec or table turns a healthy
twin red (see test_checker_mutants)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from checker_faults import Patch, fault, faults_in, judge_red

from axistwin_conformance.families.msc import codec, link, scratch
from axistwin_conformance.families.msc.checks import golden, rig
from axistwin_conformance.families.msc.link import MscLink, ReplyWindow
from axistwin_conformance.families.msc.sequences import model
from axistwin_conformance.families.msc.sequences.model import UnitModel

pytestmark = pytest.mark.strength

MODEL = "msc-250"


# --- packets -------------------------------------------------------------------------------------


@fault("sums_above_32767_are_still_sums", "MSC-PKT-12")
def a_checksum_has_fifteen_bits(patch: Patch) -> None:
    """The codec drops the highest bit of a sum."""
    patch.setattr(codec, "checksum", lambda data: sum(data) & 0x7FFF)


@fault("each_packet_draws_one_sign", "MSC-LNK-02")
def a_wrong_sum_is_sent_right(patch: Patch) -> None:
    """What the suite sends under a wrong checksum is sound."""
    patch.setattr(codec, "with_wrong_checksum", lambda raw, offset=1: raw)


@fault("the_written_exchanges_of_variables_come_byte_for_byte", "MSC-PKT-21")
def values_go_low_byte_first(patch: Patch) -> None:
    """The codec writes a value the other way round than the manual's examples."""
    patch.setattr(
        codec, "i32", lambda number: (number & 0xFFFF_FFFF).to_bytes(codec.VALUE_BYTES, "little")
    )


@fault("the_written_exchanges_of_flags_and_status_come_byte_for_byte", "MSC-PKT-12")
def a_written_exchange_is_misprinted(patch: Patch) -> None:
    """One byte of each written reply is another one."""
    written = golden.golden_exchanges()

    def spoilt(said: tuple[str, bytes]) -> tuple[str, bytes]:
        who, data = said
        is_reply = who == "D" and len(data) > 1
        return (who, data[:-3] + bytes([data[-3] ^ 1]) + data[-2:]) if is_reply else said

    turned = tuple(replace(one, said=tuple(map(spoilt, one.said))) for one in written)
    patch.setattr(golden, "golden_exchanges", lambda: turned)
    patch.setattr(golden, "STATUS_AT", slice(7, 15))


# --- link ----------------------------------------------------------------------------------------


@fault("refusals_and_time_outs_share_one_limit", "MSC-LNK-09")
def four_repeats_are_expected(patch: Patch) -> None:
    """The suite takes five repeats for five sendings in all."""
    patch.setattr(link, "LIMITS", {"5_repeats": 4, "5_total": 4})


@fault("a_packet_broken_off_is_refused_when_its_time_is_over", "MSC-LNK-03")
def a_time_limit_is_expected_from_the_last_byte(patch: Patch) -> None:
    """T1 counts from the last byte of what was sent."""
    window = MscLink.sign_window

    def late(one: MscLink, sent_ns: int, count: int) -> ReplyWindow:
        return window(one, sent_ns + count * one.byte_ns, count)

    patch.setattr(MscLink, "sign_window", late)


@fault("a_reply_without_answer_comes_again", "MSC-LNK-12")
def a_repeat_is_expected_with_the_old_one(patch: Patch) -> None:
    """T2 counts from the first byte of a reply."""
    window = MscLink.repeat_window
    patch.setattr(
        MscLink, "repeat_window", lambda one, replied_ns, size: window(one, replied_ns, 0)
    )


# --- data, flags and status ----------------------------------------------------------------------


@fault("a_block_written_is_the_block_read", "MSC-BREAD-03")
def neighbours_are_expected_two_apart(patch: Patch) -> None:
    """The suite believes in words where the unit has bytes."""
    patch.setattr(scratch.ScratchPlaces, "stride", property(lambda one: 2))


@fault("flag_f_is_bit_f_mod_8_of_byte_f_div_8", "MSC-RFLAGS-02")
def flags_are_expected_from_the_highest_bit_on(patch: Patch) -> None:
    """The codec counts the bits of a byte of RFLAGS' reply the other way round."""
    flags_on = codec.flags_on
    patch.setattr(
        codec, "flags_on", lambda states: frozenset(number ^ 7 for number in flags_on(states))
    )


@fault("flag_f_is_bit_f_mod_8_of_byte_f_div_8", "MSC-RFLAGS-02")
def flags_are_expected_as_one_big_number(patch: Patch) -> None:
    """The codec reads RFLAGS' reply high byte first."""
    flags_on = codec.flags_on
    patch.setattr(codec, "flags_on", lambda states: flags_on(states[::-1]))


@fault("a_read_is_answered_under_its_own_name", "MSC-CMD-12")
def a_state_is_expected_in_one_byte(patch: Patch) -> None:
    """The table of replies has one byte for a flag."""
    name = "RFLAG"
    patch.setitem(codec.REPLY_PAYLOADS, name, 1)
    patch.setitem(codec.REPLY_BYTES, name, codec.REPLY_BYTES[name] - 1)


@fault("bit_0_is_the_program", "MSC-STA-01")
def bit_1_is_expected_to_be_the_program(patch: Patch) -> None:
    """The suite counts the bits of the status word from 1."""
    patch.setattr(rig, "RUNNING", 2)


@fault("some_mixed_sequences_agree_with_the_model", "MSC-PROP-08", "MSC-PROP-09")
def a_write_is_forgotten_by_the_model(patch: Patch) -> None:
    """The model keeps the first value that a DWRITE gives an address."""
    write = UnitModel.write

    def first(one: UnitModel, address: int, value: int) -> None:
        known = one.admissible(address)
        write(one, address, value if known is None else min(known))

    patch.setattr(UnitModel, "write", first)


@fault("some_mixed_sequences_agree_with_the_model", "MSC-PROP-09")
def a_block_has_31_values_in_the_model(patch: Patch) -> None:
    """The last value of a BWRITE is not stored by the model."""
    write = UnitModel.write_block

    def short(one: UnitModel, address: int, values: Any) -> None:
        write(one, address, [*values[:-1], values[-1] ^ 1])

    patch.setattr(UnitModel, "write_block", short)


FAULTS = faults_in(globals())


@pytest.mark.parametrize("name", FAULTS)
def test_a_wrong_checker_turns_a_healthy_twin_red(name: str) -> None:
    """The prediction that was tampered with no longer holds, and the check says so."""
    judge_red(FAULTS[name], MODEL, (scratch, golden, codec, link, model))
