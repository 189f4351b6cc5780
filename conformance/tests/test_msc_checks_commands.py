"""Checks of an MSC's commands and data: a sound controller passes, faulty ones fail by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from msc_controller import Controller, Turn, answers, judge, refuses, twisted
from msc_judging import failed, troubles

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import Packet
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import NO_SCRATCH, TWIN_SCRATCH, ScratchArea

pytestmark = pytest.mark.strength

REPLY_NS = 10_000_000
BYTES = "every_byte_may_stand_in_every_place_of_a_value"
BEHIND = "writes_right_behind_one_another_are_each_carried_out"
MODULES = tuple(
    f"axistwin_conformance.families.msc.checks.{name}"
    for name in ("commands", "data", "flags", "status", "program", "bench", "rig")
)
CHECKS = [one for one in FAMILY.checks() if one.module in MODULES]


@pytest.mark.parametrize("check", CHECKS, ids=lambda one: one.name)
@pytest.mark.parametrize("has_rflags", [True, False])
def test_a_sound_controller_passes(check: Check, has_rflags: bool) -> None:
    """Nothing fails; what is not run has to do with RFLAGS, which the model has or has not."""
    found = judge(check.name, Controller(has_rflags=has_rflags))
    assert not [text for text in troubles(found) if "RFLAGS" not in text], found


@pytest.mark.parametrize("check", CHECKS, ids=lambda one: one.name)
def test_each_requirement_that_a_check_names_is_judged(check: Check) -> None:
    """On one of the two models, every one of them passes."""
    passed = {
        one.requirement
        for has_rflags in (True, False)
        for one in judge(check.name, Controller(has_rflags=has_rflags))
        if one.verdict is Verdict.PASS
    }
    assert passed == set(check.requirements)


@pytest.mark.parametrize("check", CHECKS, ids=lambda one: one.name)
@pytest.mark.parametrize(
    ("variables", "flags"),
    [(range(2048, 2306), range(200, 204)), (range(2049, 2307), range(200, 204)),
     (range(2050, 2060), range(200, 201)), (range(2048, 2049), range(200, 201))],
    ids=["two blocks", "odd", "two values", "one address"],
)  # fmt: skip
def test_what_the_operator_has_named_is_enough(
    check: Check, variables: range, flags: range
) -> None:
    """With little named, wherever it begins, nothing fails and nothing else is written to."""
    place = TWIN_SCRATCH.program
    scratch = ScratchArea(variables, flags, place)
    found = judge(check.name, Controller(), is_twin=False, settings=scratch)
    assert not failed(found), troubles(found)


@pytest.mark.parametrize(
    "check", [one for one in CHECKS if not one.needs], ids=lambda one: one.name
)
def test_nothing_needs_be_named_for_what_only_reads(check: Check) -> None:
    """The checks without needs hold on a controller of which nothing is known."""
    found = judge(check.name, Controller(), is_twin=False, settings=NO_SCRATCH)
    assert not failed(found), troubles(found)


# --- faults --------------------------------------------------------------------------------------


def renamed(self: Controller, one: Packet, served: bytes) -> bytes:
    """The reply under another command's name."""
    name = {"DREAD": "BREAD"}.get(one.name, one.name)
    return codec.body(name, served)


def with_address(self: Controller, one: Packet, served: bytes) -> bytes:
    """The reply with the address or flag number in front of its values."""
    return codec.body(one.name, one.payload[:2], served)


def with_value(self: Controller, one: Packet) -> bytes | None:
    """A write answered by a packet with what it has stored."""
    Controller.dwrite(self, one)
    return one.payload[2:]


def split_at_every_comma(self: Controller, one: Packet) -> bytes | None:
    """A body taken apart at all its commas."""
    if len(one.body.split(b",")) > 2:
        return None
    return Controller.serve(self, one)


def without_commas(self: Controller, one: Packet) -> bytes | None:
    """A value whose commas are lost."""
    return self.put(one.numbers[0], one.payload[2:].replace(b",", b"\x00"))


def filled(self: Controller, one: Packet) -> bytes | None:
    """A block of equal values is filled with their last byte."""
    data = one.payload[2:]
    are_alike = data == data[:4] * (len(data) // 4)
    return self.put(one.numbers[0], data[-1:] * len(data) if are_alike else data)


def once_for_each_number(self: Controller, one: Packet) -> bytes | None:
    """A write with the block number of the packet before taken for its repeat."""
    before, block = self.notes["block"], int.from_bytes(self.receiver._request[4:6], "big")
    self.notes["block"] = block
    is_repeat = block != 0 and block == before and one.name in codec.WRITES
    return b"" if is_repeat else Controller.serve(self, one)


def goes_on(self: Controller, one: Packet) -> bytes | None:
    """A block behind the one that was written to the same address."""
    before, self.notes["place"] = self.notes["place"], one.numbers[0]
    further = len(one.payload) - 2 if before == one.numbers[0] else 0
    return self.put(one.numbers[0] + further, one.payload[2:])


def begins_with(self: Controller, one: Packet) -> bytes | None:
    """RFLAGS taken for an RFLAG."""
    if one.name == "RFLAGS":
        return codec.u16(0)
    return Controller.serve(self, one)


def stores_more(self: Controller, one: Packet) -> bytes | None:
    """A write that clears the value behind as well."""
    return self.put(one.numbers[0], one.payload[2:] + bytes(4))


def stores_short(self: Controller, one: Packet) -> bytes | None:
    """A write of the low 24 bits."""
    return self.put(one.numbers[0] + 1, one.payload[3:])


def little_endian(self: Controller, one: Packet) -> bytes | None:
    """A write low byte first."""
    return self.put(one.numbers[0], one.payload[:1:-1])


def stores_late(self: Controller, one: Packet) -> bytes | None:
    """A write that the next one carries out."""
    self.notes["late"], value = int.from_bytes(one.payload[2:], "big"), self.notes["late"]
    return self.put(one.numbers[0], codec.i32(value))


def counts_reads(self: Controller, one: Packet) -> bytes | None:
    """A read that counts itself."""
    served = Controller.dread(self, one)
    self.add(one.numbers[0])
    return served


def block_counts_reads(self: Controller, one: Packet) -> bytes | None:
    """A block read that counts itself."""
    served = Controller.bread(self, one)
    self.add(one.numbers[0] + 4)
    return served


def narrow(self: Controller, one: Packet) -> bytes | None:
    """A data area of 2 KiB, over and over."""
    return self.put(one.numbers[0] & 0x7FF, one.payload[2:])


def narrow_read(self: Controller, one: Packet) -> bytes | None:
    """Its other side."""
    return self.get(one.numbers[0] & 0x7FF, 4)


def trimmed(self: Controller, one: Packet) -> bytes | None:
    """A block without the zeros at its end."""
    return self.put(one.numbers[0], one.payload[2:].rstrip(b"\x00"))


def one_more(self: Controller, one: Packet) -> bytes | None:
    """A block of 33 values."""
    return self.put(one.numbers[0], one.payload[2:] + bytes(4))


def one_less(self: Controller, one: Packet) -> bytes | None:
    """A block of 31 values."""
    return self.put(one.numbers[0], one.payload[2:-4])


def apart(stride: int) -> Turn:
    """Singles and blocks that count addresses differently: of a stride no reading has."""

    def dread(self: Controller, one: Packet) -> bytes | None:
        at = one.numbers[0] - 1024
        return self.get(1024 + at // 4 * stride if at > 0 else 1024 + at, 4)

    return twisted(dread=dread)


def backwards(served: bytes) -> bytes:
    """The values of a block in the opposite order."""
    return b"".join(served[at : at + 4] for at in range(len(served) - 4, -1, -4))


FAULTS: list[tuple[str, Callable[[], Controller], str]] = [
    ("a_read_is_answered_under_its_own_name", twisted(body=renamed), "MSC-CMD-04"),
    ("a_read_is_answered_under_its_own_name", twisted(body=with_address), "MSC-CMD-12"),
    ("a_read_is_answered_under_its_own_name", answers("RFLAG", lambda _: b""), "MSC-CMD-05"),
    ("a_read_is_answered_under_its_own_name", refuses("RFLAG"), "MSC-CMD-06"),
    ("a_write_draws_its_ack_and_nothing_else", twisted(dwrite=with_value), "MSC-DWRITE-03"),
    ("a_write_draws_its_ack_and_nothing_else", answers("BWRITE", lambda _: b"ok"), "MSC-BWRITE-05"),
    ("a_write_draws_its_ack_and_nothing_else", answers("CFLAG", lambda _: b"\x00"), "MSC-LNK-14"),
    ("a_write_draws_its_ack_and_nothing_else", refuses("SFLAG"), "MSC-CMD-06"),
    ("the_comma_is_there_without_values", refuses("RQSTAT"), "MSC-CMD-02"),
    ("the_comma_is_there_without_values", refuses("RFLAGS"), "MSC-CMD-02"),
    ("the_worked_example_writes_1234", twisted(dwrite=little_endian), "MSC-DWRITE-01"),
    ("the_worked_example_writes_1234", refuses("DWRITE"), "MSC-CMD-03"),
    ("names_are_compared_whole", twisted(serve=begins_with), "MSC-CMD-07"),
    ("a_flag_number_may_hold_a_comma", twisted(serve=split_at_every_comma), "MSC-CMD-08"),
    ("commas_in_addresses_and_values_are_data", twisted(serve=split_at_every_comma), "MSC-CMD-08"),
    ("commas_in_addresses_and_values_are_data", twisted(dwrite=without_commas), "MSC-CMD-08"),
    ("commas_in_addresses_and_values_are_data", twisted(bwrite=without_commas), "MSC-CMD-08"),
    ("a_value_written_is_the_value_read", twisted(dwrite=stores_short), "MSC-DWRITE-02"),
    ("a_value_written_is_the_value_read", twisted(dwrite=little_endian), "MSC-DWRITE-02"),
    ("a_value_written_is_the_value_read", twisted(dwrite=stores_late), "MSC-DWRITE-04"),
    ("a_value_written_is_the_value_read", answers("DREAD", lambda one: one[2:]), "MSC-DREAD-02"),
    ("a_value_written_is_the_value_read", refuses("DREAD"), "MSC-DREAD-01"),
    (
        "a_value_written_is_the_value_read",
        refuses("DWRITE", lambda one: one.payload[2] > 0x7F),
        "MSC-DWRITE-01",
    ),
    ("no_other_variable_changes", twisted(dwrite=stores_more), "MSC-DWRITE-05"),
    ("no_other_variable_changes", twisted(dwrite=narrow, dread=narrow_read), "MSC-DWRITE-05"),
    ("reading_changes_nothing", answers("BREAD", lambda one: b"\x01" + one[1:]), "MSC-BREAD-04"),
    ("what_was_written_outlasts_its_reads", twisted(dread=counts_reads), "MSC-DREAD-04"),
    ("what_was_written_outlasts_its_reads", twisted(bread=block_counts_reads), "MSC-BREAD-04"),
    (
        "an_address_has_sixteen_bits",
        refuses("DREAD", lambda one: 0x2C in one.payload),
        "MSC-DREAD-01",
    ),
    ("an_address_has_sixteen_bits", refuses("BREAD"), "MSC-BREAD-01"),
    ("every_bit_of_an_address_counts", twisted(dwrite=narrow, dread=narrow_read), "MSC-DREAD-01"),
    ("a_block_written_is_the_block_read", answers("BREAD", backwards), "MSC-BREAD-03"),
    ("a_block_written_is_the_block_read", answers("BREAD", lambda one: one[:-4]), "MSC-BREAD-02"),
    ("a_block_written_is_the_block_read", refuses("BREAD"), "MSC-BREAD-01"),
    ("a_block_written_is_the_block_read", refuses("BWRITE"), "MSC-BWRITE-01"),
    ("a_block_written_is_the_block_read", twisted(bwrite=one_less), "MSC-BWRITE-02"),
    ("a_block_written_is_the_block_read", apart(8), "MSC-PROP-12"),
    ("a_block_equals_its_single_reads", answers("DREAD", lambda _: b"\0\0\0\1"), "MSC-PROP-12"),
    (
        "a_block_equals_its_single_reads",
        answers("BREAD", lambda one: b"\1" + one[1:]),
        "MSC-BREAD-04",
    ),
    (BYTES, twisted(bwrite=without_commas), "MSC-BWRITE-02"),
    ("values_of_a_block_may_be_alike", twisted(bwrite=filled), "MSC-BWRITE-02"),
    (BEHIND, twisted(serve=once_for_each_number), "MSC-PKT-09"),
    (BEHIND, twisted(bwrite=goes_on), "MSC-BWRITE-02"),
    ("values_of_a_block_lie_one_stride_apart", apart(12), "MSC-DAT-02"),
    ("values_of_a_block_lie_one_stride_apart", apart(8), "MSC-DAT-02"),
    ("padding_is_stored_as_well", twisted(bwrite=trimmed), "MSC-BWRITE-03"),
    ("a_longer_array_is_sent_block_by_block", twisted(bwrite=one_more), "MSC-BWRITE-02"),
    ("a_longer_array_is_sent_block_by_block", twisted(bwrite=one_less), "MSC-BWRITE-02"),
]


@pytest.mark.parametrize(
    ("name", "make", "requirement"),
    FAULTS,
    ids=[f"{one}-{key}-{n}" for n, (one, _, key) in enumerate(FAULTS)],
)
def test_a_fault_fails_what_it_breaks(
    name: str, make: Callable[[], Controller], requirement: str
) -> None:
    """Each by the check that is there for it."""
    assert requirement in failed(judge(name, make()))


@pytest.mark.parametrize("twist", [{"dread": counts_reads}, {"bread": block_counts_reads}])
def test_what_moves_by_itself_may_be_a_programs(twist: dict[str, Any]) -> None:
    """On a built-in twin reading has changed it; elsewhere nobody knows: there is no verdict."""
    make = twisted(**twist)
    assert "MSC-DREAD-04" in failed(judge("reading_changes_nothing", make(), is_builtin=True))
    findings = judge("reading_changes_nothing", make())
    doubts = [one.text for one in findings if one.verdict is Verdict.INCONCLUSIVE]
    assert doubts
    assert all("a program uses it, or reading changes it" in one for one in doubts)
    assert not failed(findings)


class Uncounted(Controller):
    """Takes a checksum with or without the comma."""

    def __init__(self) -> None:
        super().__init__()
        judge = self.receiver._judge
        self.receiver._judge = lambda raw, now: judge(self._counted(raw), now)

    @staticmethod
    def _counted(raw: bytes) -> bytes:
        right = codec.u16(codec.checksum(raw[1:-2]))
        return raw[:-2] + right if raw[-2:] == codec.u16(codec.checksum(raw[1:-2]) - 0x2C) else raw


def test_a_checksum_without_the_comma_is_not_taken() -> None:
    """Who takes either, fails."""
    assert failed(judge("a_checksum_without_the_comma_is_refused", Uncounted())) == {"MSC-CMD-03"}


class Unhurried(Controller):
    """Refuses what is under a wrong checksum, and serves it all the same."""

    def __init__(self) -> None:
        super().__init__()
        self._judge, self.receiver._judge = self.receiver._judge, self._judge_and_serve

    def _judge_and_serve(self, raw: bytes, now: int) -> None:
        """Sends the reply behind the NAK."""
        self._judge(raw, now)
        one, unit = codec.parse(raw), self.receiver
        assert one is not None
        if not one.is_sound and (served := self.serve(made_sound(one))):
            reply = codec.packet(self.unit, self.body(one, served))
            unit._send(unit._busy_until + REPLY_NS, reply)


def made_sound(one: Packet) -> Packet:
    """The same packet under its right checksum."""
    sound = codec.parse(codec.packet(one.unit, one.body, one.block))
    assert sound is not None
    return sound


def test_a_refused_read_has_no_reply() -> None:
    """Who serves what he has refused, fails."""
    assert failed(judge("a_refused_read_is_not_served", Unhurried())) == {"MSC-LNK-06"}


def test_every_check_of_commands_and_data_has_a_fault_here() -> None:
    """No check of these modules goes without one that it finds."""
    elsewhere = {
        "a_checksum_without_the_comma_is_refused",
        "a_refused_read_is_not_served",
        "a_refused_write_stores_nothing",  # with the link's
        "a_refused_sflag_turns_nothing_on",
    }
    covered = {name for name, _, _ in FAULTS} | elsewhere
    names = {one.name for one in CHECKS if one.module.endswith(("commands", "data"))}
    assert names <= covered
