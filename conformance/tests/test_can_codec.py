"""Frames of the MAC23 on CAN, both ways, legal and not."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.base.ledger import family_folder, load_ledger
from axistwin_conformance.families.mac.axis.driver.facts import MacFacts
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import ReplyKind
from axistwin_conformance.families.mac.serial.family import MODELS
from axistwin_conformance.transport.can_frame import Frame

FIXTURES = Path(__file__).parents[2] / "fixtures" / "mac_can"
GOLDEN = family_folder("mac_can") / "golden" / "exchanges.toml"
DATA = tomllib.loads(GOLDEN.read_text(encoding="utf-8"))


def frame(text: str) -> Frame:
    """An identifier and data, as the golden file writes them."""
    identifier, *data = text.split()
    return Frame(int(identifier, 16), bytes.fromhex("".join(data)))


def by_name(rows: list[dict[str, Any]]) -> pytest.MarkDecorator:
    """Each row of the golden file a case of its own."""
    return pytest.mark.parametrize("golden", rows, ids=[one["name"] for one in rows])


@by_name(DATA["exchange"])
def test_golden_requests_are_what_the_codec_builds(golden: dict[str, Any]) -> None:
    """From address, index and parameter; and what the fields mean can be read back."""
    wanted = frame(golden["request"])
    parameter = int.from_bytes(wanted.data[4:], "big")
    built = codec.request(wanted.identifier & 0x7F, golden["index"], parameter)
    assert built.frame() == wanted
    assert built.is_well_formed
    assert built.index == golden["index"]
    if golden["fields"]:
        assert codec.LAYOUTS[golden["index"]].read(wanted.data[4:]) == golden["fields"]


@by_name(DATA["exchange"])
def test_golden_replies_are_understood_and_belong_to_their_requests(golden: dict[str, Any]) -> None:
    """Accepted, or an answer, to that index; and to no other request of the file."""
    request, reply = frame(golden["request"]), frame(golden["reply"])
    told = codec.parse(reply)
    assert (told.kind, told.index) in (
        (ReplyKind.ACCEPTED, golden["index"]), (ReplyKind.ANSWER, golden["index"]),
    )  # fmt: skip
    built = codec.request(request.identifier & 0x7F, golden["index"])
    assert codec.mismatch(built, reply) == ""
    others = [one["index"] for one in DATA["exchange"] if one["index"] != golden["index"]]
    assert all(codec.mismatch(codec.request(1, one), reply) for one in others)


@by_name(DATA["exchange"])
def test_golden_requirements_exist(golden: dict[str, Any]) -> None:
    """The file speaks the ledger's language."""
    assert set(golden["requirements"]) <= set(load_ledger("mac_can").requirements)


def test_every_misprint_says_what_is_wrong_with_it() -> None:
    """A recorded misprint has the printed form, the place and the reason."""
    misprints = [one for row in DATA["exchange"] for one in row.get("misprint", [])]
    assert len(misprints) == 4
    assert all(one["printed"] and one["where"] and one["why"] for one in misprints)


def test_the_printed_identifiers_of_the_two_axis_example_are_no_modules() -> None:
    """681h is taken for nobody's, not for module 129."""
    printed = Frame(0x681, bytes.fromhex("23 16 20 00 03 E8 10 00"))
    assert codec.explain(printed).startswith("of no meaning here")


def test_the_address_procedure_is_what_the_golden_file_says() -> None:
    """Eight bytes by default, seven if asked for."""
    steps = [codec.lmt_enter(), codec.lmt_address(5), codec.lmt_leave()]
    assert steps == [frame(one["request"]) for one in DATA["address"]]
    assert [len(one.data) for one in (codec.lmt_enter(7), codec.lmt_address(5, 7))] == [7, 7]


@by_name(DATA["scaling"])
def test_the_printed_scalings_give_the_printed_values(golden: dict[str, Any]) -> None:
    """The raw value of each threshold is the last one before it, or the first one at it."""
    facts = MODELS["mac23"].facts
    assert isinstance(facts, MacFacts)
    scale = {"torque": lambda raw: raw / 128, "thermal threshold": facts.celsius}
    measure = scale.get(golden["name"], facts.volts)
    value, step = measure(golden["raw"]), measure(1) - measure(0)
    assert abs(value - golden["value"]) < step
    if golden["name"] == "over-voltage":
        assert measure(golden["raw"] - 1) < golden["value"] <= value
    elif golden["name"] == "under-voltage":
        assert value <= golden["value"] < measure(golden["raw"] + 1)
    else:
        assert value == golden["value"]


def test_the_golden_file_of_the_fixtures_is_the_shipped_one() -> None:
    """The installed suite and the fixtures folder hold the same bytes."""
    assert (FIXTURES / "exchanges.toml").read_bytes() == GOLDEN.read_bytes()


# --- requests -------------------------------------------------------------------------------------


def test_an_index_below_20h_is_written_and_one_from_20h_on_is_read() -> None:
    """The same low byte names two services."""
    assert codec.request(1, 0x01).frame() == frame("601 23 01 20 00 00 00 00 00")
    assert codec.request(1, 0x21).frame() == frame("601 40 01 20 00 00 00 00 00")
    assert codec.request(0x7F, 0x13, -1).frame() == frame("67F 23 13 20 00 FF FF FF FF")


def test_every_field_of_a_request_can_be_spoilt() -> None:
    """Command byte, both bytes of the index, sub-index, length."""
    good = codec.request(1, 0x20)
    spoilt = {
        "601 22 00 20 00 00 00 00 00": replace(good, command=0x22),
        "601 40 00 10 00 00 00 00 00": replace(good, index_high=0x10),
        "601 40 08 20 00 00 00 00 00": replace(good, index_low=0x08),
        "601 40 00 20 01 00 00 00 00": replace(good, sub_index=1),
        "601 40 00 20 00": replace(good, length=4),
        "601": replace(good, length=0),
        "600 40 00 20 00 00 00 00 00": replace(good, address=codec.GENERAL_ADDRESS),
    }
    for text, one in spoilt.items():
        assert one.frame() == frame(text)
    assert [one.is_well_formed for one in spoilt.values()] == [False, False] + [True] * 2 + [
        False, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("index", "parameter", "turned"),
    [
        (0x0C, 0x40, "40 00 00 00"),
        (0x0E, 0x0A00, "00 00 00 0A"),
        (0x16, 0x03E81000, "E8 03 00 10"),
        (0x13, 0x100, "00 01 00 00"),
        (0x15, 0x00F60FFF, "00 F6 FF 0F"),
        (0x25, 0x0A001234, "0A 00 34 12"),
        (0x26, 0x0A214302, "0A 21 43 02"),
    ],
)
def test_the_other_byte_order_turns_each_number_round(
    index: int, parameter: int, turned: str
) -> None:
    """Words and longs, but not bytes of their own (MACC-AMB-01)."""
    assert codec.parameter_bytes(index, parameter, "little") == bytes.fromhex(turned)
    assert codec.parameter_bytes(index, parameter) == parameter.to_bytes(4, "big")


@given(st.sampled_from(sorted(codec.LAYOUTS)), st.integers(0, 0xFFFF_FFFF))
def test_an_answer_is_read_back_in_either_byte_order(index: int, number: int) -> None:
    """What one order writes, the same order reads."""
    for order in ("big", "little"):
        data = codec.parameter_bytes(index, number, order)
        if index in codec.UPLOADS:
            answer = Frame(0x581, bytes([0x42, index - 0x20, 0x20, 0]) + data)
            assert codec.parse(answer, order).data == number
        assert codec.LAYOUTS[index].reordered(codec.LAYOUTS[index].reordered(data)) == data


def test_the_layouts_fill_four_bytes_and_cover_every_assigned_index() -> None:
    """24 downloads and 8 uploads; fields lie within the four bytes and do not overlap."""
    assert (len(codec.DOWNLOADS), len(codec.UPLOADS)) == (24, 8)
    assert codec.UNASSIGNED_DOWNLOADS == (0x04, 0x05, 0x06, 0x08, 0x12, 0x1B, 0x1D, 0x1F)
    assert list(codec.UNASSIGNED_UPLOADS) == list(range(0x28, 0x30))
    assert set(codec.COMMAND_NAMES) == set(codec.DOWNLOADS)
    assert set(codec.QUERY_NAMES) == set(codec.UPLOADS) == set(codec.ANSWERED)
    for layout in codec.LAYOUTS.values():
        assert sum(layout.words) == 4
        taken = [at for one in layout.fields for at in range(one.offset, one.offset + one.size)]
        assert sorted(set(taken)) == sorted(taken)
        assert all(at in range(4) for at in taken)


# --- replies --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "kind", "index"),
    [
        ("581 60 0C 20 00 00 00 00 00", ReplyKind.ACCEPTED, 0x0C),
        ("581 60 0C 20 00 00 00 00 01", ReplyKind.GARBAGE, 0x0C),
        ("581 80 13 20 00 00 00 00 00", ReplyKind.REFUSED, 0x13),
        ("581 80 00 10 00 00 00 00 00", ReplyKind.REFUSED, None),
        ("581 42 06 20 00 01 02 03 04", ReplyKind.ANSWER, 0x26),
        ("581 43 06 20 00 01 02 03 04", ReplyKind.ANSWER, 0x26),
        ("581 43 00 10 00 01 02 03 04", ReplyKind.ANSWER, None),
        ("581 4B 06 20 00 01 02 00 00", ReplyKind.GARBAGE, 0x06),
        ("581 42 06 20 00", ReplyKind.GARBAGE, None),
        ("581", ReplyKind.GARBAGE, None),
    ],
)
def test_replies_are_told_apart(text: str, kind: ReplyKind, index: int | None) -> None:
    """By the first byte; what fits none of the forms is garbage and says why."""
    reply = codec.parse(frame(text))
    assert (reply.kind, reply.index) == (kind, index)
    assert bool(reply.flaws) is (kind is ReplyKind.GARBAGE)
    assert reply.raw == frame(text).pack()


def test_no_frame_is_silence() -> None:
    """And has no bytes."""
    assert codec.parse(None).kind is ReplyKind.SILENCE
    assert codec.parse(None).raw == b""


def test_an_extended_or_remote_frame_is_no_reply() -> None:
    """It is garbage, whatever it holds."""
    assert codec.parse(Frame(0x581, bytes(8), is_extended=True)).kind is ReplyKind.GARBAGE
    assert codec.parse(Frame(0x581, is_remote=True)).kind is ReplyKind.GARBAGE


def test_the_readings_a_reply_shows_are_told() -> None:
    """42h or 43h, and the reason that the standard wants in a refusal."""
    assert codec.parse(frame("581 43 00 20 00 00 00 00 00")).answer_spelling == "43h"
    refused = codec.parse(frame("581 80 13 20 00 22 00 00 08"))
    assert (refused.kind, refused.abort_code) == (ReplyKind.REFUSED, 0x0800_0022)
    assert refused.answer_spelling is None


@pytest.mark.parametrize(
    ("index", "text", "words"),
    [
        (0x20, "581 42 00 20 00 00 00 00 00", ""),
        (0x20, "581 42 01 20 00 00 00 00 00", "2001h"),
        (0x20, "581 42 00 10 00 00 00 00 00", "1000h"),
        (0x20, "581 42 00 20 01 00 00 00 00", "sub-index 01"),
        (0x20, "581 60 00 20 00 00 00 00 00", "accepts a download"),
        (0x00, "581 42 00 20 00 00 00 00 00", "answers an upload"),
        (0x00, "581 60 00 20 00 00 00 00 00", ""),
        (0x00, "581 80 00 20 00 00 00 00 00", ""),
        (0x20, "581 80 00 20 00 00 00 00 00", ""),
        (0x20, "581 99 00 20 00 00 00 00 00", ""),
        (0x20, "581 42 00", ""),
    ],
)
def test_a_reply_to_something_else_is_known_by_index_sub_index_and_direction(
    index: int, text: str, words: str
) -> None:
    """A wrong form of the right reply is not: the module has to be blamed for it."""
    found = codec.mismatch(codec.request(1, index), frame(text))
    assert words in found
    assert bool(found) is bool(words)


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("581 60", True), ("5FF", True), ("7E4 11", True), ("601 42 00", True), ("601 80", True),
        ("601 40 00", False), ("601", False), ("602 42", False), ("580 42", False),
        ("701 00", False), ("080", False),
    ],
)  # fmt: skip
def test_what_may_be_a_reply_to_anything_is_known(text: str, is_one: bool) -> None:
    """Transfers, LMT, and module 1 in the reading that replies on 601h."""
    assert codec.is_reply(frame(text)) is is_one


# --- what is said unasked -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("701 00", 1), ("77F 00", 127), ("081 00", 1), ("0FF", 127), ("764 00", 100),
        ("080", None), ("700 00", None), ("7E4 11 00 00", None), ("7E5 04 01", None),
        ("581 42", None), ("601 40", None), ("600 40", None), ("000 01 00", None),
        ("100", None), ("780", None),
    ],
)  # fmt: skip
def test_what_modules_say_unasked_is_known_by_its_identifier(
    text: str, address: int | None
) -> None:
    """SYNC is nobody's emergency, LMT nobody's boot-up."""
    assert codec.spontaneous_from(frame(text)) == address
    assert codec.is_spontaneous(frame(text)) is (address is not None)


def test_an_extended_frame_is_nobodys_boot_up() -> None:
    """Nor is a remote one."""
    assert codec.spontaneous_from(Frame(0x701, b"\0", is_extended=True)) is None
    assert codec.spontaneous_from(Frame(0x701, is_remote=True)) is None


def test_each_form_of_the_boot_up_message_is_recognised() -> None:
    """And nothing else is one (MACC-AMB-04)."""
    for form in codec.BOOT_UP_FORMS:
        assert codec.boot_up_form(codec.boot_up(5, form)) == form
    for text in ("705 7F", "705 00 00", "085 00", "605", "080"):
        assert codec.boot_up_form(frame(text)) is None


@pytest.mark.parametrize(
    ("faults", "code", "register"),
    [
        (0x00, 0x0000, 0x00), (0x10, 0x4200, 0x09), (0x01, 0x3100, 0x05), (0x40, 0x3210, 0x05),
        (0x20, 0x3220, 0x05), (0x71, 0x4200, 0x09), (0x61, 0x3100, 0x05), (0x8E, 0, 0),
    ],
)  # fmt: skip
def test_the_error_code_follows_from_the_fault_byte_by_priority(
    faults: int, code: int, register: int
) -> None:
    """Temperature before cut, cut before over- and under-voltage."""
    assert codec.error_of(faults) == (code, register)


def test_each_form_of_the_emergency_message_is_recognised() -> None:
    """Beside the four bytes of 2001h; a healthy module's may fit several (MACC-AMB-05)."""
    status = bytes.fromhex("40 02 00 80")
    data = {
        "cia301_status": "10 32 05 40 02 00 80 00",
        "status_first": "40 02 00 80 00 00 00 00",
        "code_only": "10 32 05 00 00 00 00 00",
    }
    for form, text in data.items():
        one = Frame(0x081, bytes.fromhex(text))
        assert codec.emergency_data(form, status) == one.data
        assert codec.emergency_forms(one, status) == (form,)
        assert codec.is_emergency(one)
    healthy = Frame(0x081, bytes(8))
    assert codec.emergency_forms(healthy, bytes(4)) == codec.EMERGENCY_FORMS
    assert codec.emergency_forms(Frame(0x081, bytes(7)), bytes(4)) == ()


# --- words ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "601 23 16 20 00 03 E8 10 00",
            "to module 1: download 2016h (segment of 1000 steps at period 4096 × 0.125 µs)",
        ),
        ("601 40 00 20 00 00 00 00 00", "to module 1: upload 2000h (position)"),
        ("601 40 00 20 01 FF 00 00 00",
         "to module 1: upload 2000h sub-index 01h (position), filler FF000000"),
        ("601 40 00 10 00 00 00 00 00", "to module 1: upload 1000h (not used)"),
        ("601 22 0C 20 00 00 00 00 40", "to module 1: by 22h 200Ch (torque limit 64)"),
        ("601 40 00", "to module 1: a request of 2 bytes (40 00)"),
        ("600 23 11 20 00 00 00 00 00", "to all: download 2011h (synchro)"),
        ("581 60 16 20 00 00 00 00 00", "module 1: accepted 2016h"),
        ("581 80 13 20 00 00 00 00 00", "module 1: refused 2013h"),
        ("581 80 13 20 00 22 00 00 08", "module 1: refused 2013h, abort code 08000022h"),
        ("581 42 00 20 00 FF FF FF FF", "module 1: answer 2000h: -1 increments (FFFFFFFFh)"),
        ("581 43 00 20 00 00 00 00 01", "module 1: answer 2000h: 1 increment (00000001h), by 43h"),
        ("080", "SYNC"),
        ("080 01", "SYNC 01"),
        ("000 02 01", "network management: 02 01"),
        ("701 00", "module 1: boot-up"),
        ("701 7F", "module 1: under the boot-up identifier: 7F"),
        ("081 00 00 00 00 02 00 80 00", "module 1: lifebeat 00 00 00 00 02 00 80 00"),
        ("081 10 32 05 40 00 00 00 00", "module 1: emergency 10 32 05 40 00 00 00 00"),
        ("7E5 04 01 00 00 00 00 00", "LMT: enter configuration (7 bytes)"),
        ("7E5 11 05 00 00 00 00 00 00", "LMT: new address 5"),
        ("7E5 5E 00 00 00 00 00 00 00", "LMT: 5E 00 00 00 00 00 00 00"),
        ("7E4 11 00 00 00 00 00 00 00", "LMT reply: 11 00 00 00 00 00 00 00"),
        ("123 01", "of no meaning here: 123h [1] 01"),
    ],
)  # fmt: skip
def test_every_frame_can_be_put_into_words(text: str, words: str) -> None:
    """Whichever its direction, whatever it holds."""
    assert codec.explain(frame(text)) == words


@given(
    st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans(),
    st.sampled_from(sorted(codec.LAYOUTS)),
)  # fmt: skip
def test_no_frame_makes_the_codec_fall_over(
    identifier: int, data: bytes, is_extended: bool, index: int
) -> None:
    """Words, reply, sender: all of any frame."""
    one = Frame(identifier, data, is_extended)
    assert codec.explain(one)
    assert str(codec.parse(one))
    assert codec.parse(one, "little").kind is codec.parse(one).kind
    assert codec.boot_up_form(one) in (None, *codec.BOOT_UP_FORMS)
    assert isinstance(codec.mismatch(codec.request(1, index), one), str)
