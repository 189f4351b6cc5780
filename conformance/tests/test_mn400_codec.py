"""Packets of the MN400, both ways, sound and broken; its commands and what is wrong with a text."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin_conformance.base.ledger import RequirementKind, load_ledger
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.grammar import (
    COMMANDS,
    OPEN_REFUSALS,
    UNASSIGNED,
    ParsedCommand,
    Refusal,
    ReplyForm,
    arc_radii_differ,
    read_command,
)
from axistwin_conformance.families.mn400.lenient import lenient

LEDGER = load_ledger("mn400")
START, DONE, PRESENT = ReturnCode.START, ReturnCode.DONE, ReturnCode.PRESENT
REQUEST = "81 4D 31 30 30 30 81 10"
# Every packet of the ledger with board, command, and what it says.
STATUS_PACKETS = [
    (1, "*", START, "81 2A 03 00 81 2F"),
    (1, "*", PRESENT, "81 2A 16 00 81 42"),
    (1, "*", DONE, "81 2A 05 00 81 31"),
    (1, "K", START, "81 4B 03 00 81 50"),
    (1, "K", ReturnCode.NOMOVEPENDING, "81 4B 10 00 81 5D"),
    (1, "=", START, "81 3D 03 00 81 42"),
    (5, "=", DONE, "85 3D 05 00 85 4C"),
    (1, "~", START, "81 7E 03 00 81 03"),
    (1, "~", ReturnCode.BAUDCHANGEOK, "81 7E 12 00 81 12"),
    (5, "~", START, "85 7E 03 00 85 0B"),
    (5, "~", ReturnCode.BAUDCHANGEOK, "85 7E 12 00 85 1A"),
    (1, "&", DONE, "81 26 05 00 81 2D"),
]
# What the checksum of the four-axis reply to E is, by what stands behind the value.
TRAILERS = [("06", 0x34), ("06 00", 0x34), ("", 0x2E), ("00", 0x2E), ("05", 0x33), ("05 00", 0x33)]


def default(switch: str) -> str:
    """The reading that is taken unless a board shows another."""
    return LEDGER.ambiguity_of(switch).default_of(switch)


def refusal(text: str, **readings: str) -> str:
    """The requirement by which a text is refused; empty if it is carried out."""
    made = read_command(text, lambda switch: readings.get(switch) or default(switch))
    return made.requirement if isinstance(made, Refusal) else ""


def values(text: str, **readings: str) -> tuple[int | None, ...]:
    """The parameters of a text that is carried out."""
    made = read_command(text, lambda switch: readings.get(switch) or default(switch))
    assert isinstance(made, ParsedCommand), made
    return made.values


def test_the_manuals_request_is_built_byte_for_byte() -> None:
    """M1000 to board 1: the sum is 210h, of which 10h is sent."""
    assert codec.request(1, "M1000") == bytes.fromhex(REQUEST)
    packet = codec.parse(bytes.fromhex(REQUEST))
    assert packet is not None
    assert (packet.board, packet.command, packet.text) == (1, "M", "M1000")
    assert packet.is_sound


@pytest.mark.parametrize(("board", "command", "code", "raw"), STATUS_PACKETS)
def test_a_status_packet_of_the_ledger_is_built_and_read(
    board: int, command: str, code: ReturnCode, raw: str
) -> None:
    """Six bytes each, with the null that no checksum shows."""
    made = bytes.fromhex(raw)
    assert codec.status(board, command, code) == made
    packet = codec.parse(made)
    assert packet is not None
    assert (packet.board, packet.command, packet.code) == (board, command, code)
    assert packet.is_sound
    assert packet.has_null
    bare = codec.parse(codec.status(board, command, code, null=False))
    assert bare is not None
    assert bare.code == code
    assert not bare.has_null
    assert bare.check == packet.check


def test_the_printed_reply_to_e_is_read_for_what_it_is() -> None:
    """Its separators are 2E 00 and its checksum is that of a reply of one axis."""
    printed = codec.parse(bytes.fromhex("81 45 35 34 35 35 2E 00 2E 00 2E 00 06 81 20"))
    assert printed is not None
    assert printed.flaws == ("checksum 20h, should be 2Ah",)
    assert (printed.fields, printed.is_dotted) == ((5455, 0, 0, 0), True)
    one_axis = codec.parse(bytes.fromhex("81 45 35 34 35 35 06 81 20"))
    assert one_axis is not None
    assert one_axis.is_sound
    assert one_axis.fields == (5455,)


@pytest.mark.parametrize("trailer", ["06", "", "0600", "05", "00"])
def test_a_period_and_a_null_are_a_comma_and_a_zero(trailer: str) -> None:
    """The null behind the last period is of the value, whatever follows it (MN4-AMB-02)."""
    packet = codec.parse(codec.data(1, "E", "5.\0,-7.\0", bytes.fromhex(trailer)))
    assert packet is not None
    assert packet.fields == (5, 0, -7, 0)
    assert packet.trailer == bytes.fromhex(trailer)
    plain = codec.parse(codec.data(1, "?", "MN400 V 1.08 / 1.04", bytes.fromhex(trailer)))
    assert plain is not None
    assert (plain.value, plain.is_dotted) == ("MN400 V 1.08 / 1.04", False)


@pytest.mark.parametrize(("trailer", "check"), TRAILERS)
def test_a_data_packet_is_read_with_any_trailer(trailer: str, check: int) -> None:
    """The value ends before the bytes that are not printable."""
    raw = codec.data(1, "E", "5455,0,0,0", bytes.fromhex(trailer))
    packet = codec.parse(raw)
    assert packet is not None
    assert raw[-1] == check
    assert packet.value == "5455,0,0,0"
    assert packet.fields == (5455, 0, 0, 0)
    assert packet.trailer == bytes.fromhex(trailer)
    assert packet.code is None


def test_the_poll_of_all_boards_is_the_ledgers() -> None:
    """80 2A 80 2A; a poll of board 1 that follows a foreign frame as well."""
    assert codec.request(codec.ALL_BOARDS, "*") == bytes.fromhex("80 2A 80 2A")
    assert codec.request(1, "*") == bytes.fromhex("81 2A 81 2C")
    found, strays = codec.packets(bytes.fromhex("41 81 2A 03 00 81 2F 81 2A 16 00 81 42"))
    assert codec.codes_of(found) == ("START", "PRESENT")
    assert strays == b"A"


@pytest.mark.parametrize("wanted", [0x00, 3, 4, 0x0D, 0x11, 0x13, 0x26, 0x2A, 0x2C, 0x51, 0x7B])
def test_every_checksum_can_be_had(wanted: int) -> None:
    """MN4-PKT-04 needs requests whose checksum looks like something else."""
    text = codec.with_checksum(1, wanted)
    assert codec.request(1, text)[-1] == wanted
    assert refusal(text) == ""


def test_a_checksum_of_eight_bits_is_not_to_be_had() -> None:
    """It has seven; all of these are reached, to every board."""
    with pytest.raises(ValueError, match="7 bits"):
        codec.with_checksum(1, 128)
    for board in codec.IDS:
        assert codec.request(board, codec.with_checksum(board, board))[-1] == board


@given(st.integers(0, 127), st.binary(min_size=1, max_size=80), st.integers(1, 127))
def test_a_broken_packet_is_sent_as_given_and_named(board: int, text: bytes, offset: int) -> None:
    """Any payload below 80h, a wrong sum, a wrong second address."""
    text = bytes(byte & 0x7F for byte in text)
    sound = codec.parse(codec.request(board, text))
    assert sound is not None
    assert sound.is_sound
    assert sound.payload == text
    wrong_sum = codec.parse(codec.with_wrong_checksum(sound.raw, offset))
    assert wrong_sum is not None
    assert [flaw[:8] for flaw in wrong_sum.flaws] == ["checksum"]
    other = codec.parse(codec.request(board, text, closing=(board + 1) % 128 | 0x80))
    assert other is not None
    assert [flaw[:6] for flaw in other.flaws] == ["second"]


@given(st.binary(max_size=40))
def test_whatever_comes_is_cut_into_packets_and_strays(received: bytes) -> None:
    """No byte is lost or told twice, and no byte string is too broken."""
    found, strays = codec.packets(received)
    assert sum(len(packet.raw) for packet in found) + len(strays) == len(received)
    words.explain_reply(received)
    words.explain_request(received)


def test_a_packet_is_over_one_byte_behind_its_second_address() -> None:
    """Whatever that byte is; a byte short of it the packet still lacks something."""
    raw = codec.status(1, "~", START)
    assert raw[-1] == START
    assert codec.packet_end(raw + b"\x81") == len(raw)
    for length in range(len(raw)):
        assert codec.packet_end(raw[:length]) == 0


def test_there_are_forty_commands_and_the_rest_is_unassigned() -> None:
    """Printable characters, letters in one case."""
    printable = {chr(code).upper() for code in range(0x21, 0x7F)}
    assert len(COMMANDS) == 40
    assert printable == {*COMMANDS, *UNASSIGNED}
    listed = [rule.letter for rule in COMMANDS.values() if rule.form is ReplyForm.DATA]
    assert sorted(listed) == sorted("/?SNE[:")


@pytest.mark.parametrize("letter", UNASSIGNED)
def test_an_unassigned_character_is_no_command(letter: str) -> None:
    """Alone and with parameters."""
    assert refusal(letter) == refusal(f"{letter}1,2") == "MN4-ERR-01"


@pytest.mark.parametrize(
    ("text", "requirement"),
    [
        ("V12.5", "MN4-PAR-02"), ("M10a", "MN4-PAR-02"), ("M+5", "MN4-PAR-02"),
        ("L 5,0,0,0", "MN4-PAR-02"), ("L1-2", "MN4-PAR-03"), ("L-", "MN4-PAR-03"),
        ("B32768", "MN4-PAR-04"), ("B-32768", "MN4-PAR-04"), ("B65537", "MN4-PAR-04"),
        ("L3000000000", "MN4-PAR-05"), ("L4294967297", "MN4-PAR-05"),
        ("L" + "9" * 20, "MN4-PAR-05"), ("L-2147483648,0,0,0", "MN4-PAR-05"),
        ("X3", "MN4-CMD-X-01"), ("X0", "MN4-CMD-X-01"), ("X", "MN4-PAR-09"),
        ("M1,2,3,4,5", "MN4-PAR-09"), ("?5", "MN4-PAR-09"), ("Q1", "MN4-PAR-09"),
        ("V0", "MN4-CMD-V-04"), ("V1", "MN4-CMD-V-04"), ("V100001", "MN4-CMD-V-04"),
        ("F5000,1000,1", "MN4-CMD-F-02"), ("F1,1000,1", "MN4-CMD-F-02"),
        ("F1000,100001,1", "MN4-CMD-F-02"), ("F1000,5000,0", "MN4-CMD-F-02"),
        ("P1,1", "MN4-CMD-P-02"), ("P0,1", "MN4-ERR-02"), ("P5,1", "MN4-ERR-02"),
        ("B-1", "MN4-CMD-B-02"), ("D0", "MN4-CMD-D-01"), ("D-1,0,1,1", "MN4-CMD-D-01"),
        ("D2", "MN4-CMD-D-01"), ("G0,1,1,1,1", "MN4-CMD-G-02"), ("G1,1,1,1,0", "MN4-CMD-G-02"),
        ("C0,1", "MN4-CMD-C-03"), ("C9,1", "MN4-CMD-C-03"), ("C1,2", "MN4-CMD-C-03"),
        ("C1,-1", "MN4-CMD-C-03"), ("=0", "MN4-CMD-ADDR-02"), ("=128", "MN4-CMD-ADDR-02"),
        ("~5", "MN4-CMD-BAUD-02"), ("~-1", "MN4-CMD-BAUD-02"), ("E3", "MN4-CMD-E-04"),
        ("A-10,0,-20,0,0", "MN4-CMD-A-03"), ("A-10,0,-20,0", "MN4-PAR-09"),
        ("+-10,0,-20,0,1,5,-1", "MN4-HEL-05"), (";2", "MN4-ERR-02"), ("J2", "MN4-ERR-02"),
        ("H2", "MN4-ERR-02"), ("I2", "MN4-ERR-02"), ("T1,0,0,0,0", "MN4-ERR-02"),
    ],
)  # fmt: skip
def test_a_text_is_refused_by_its_requirement(text: str, requirement: str) -> None:
    """Grammar, ranges, and what parameters must be together."""
    assert refusal(text) == requirement


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("M,,-100", (None, None, -100, None)), ("m1000", (1000, None, None, None)),
        ("M9000,2500", (9000, 2500, None, None)), ("L007,0,-0,0", (7, 0, 0, 0)),
        ("M1,", (1, None, None, None)), ("M", (None,) * 4), ("H", (None,)), ("(50", (50,)),
        ("P1,2", (1, 2, None)), ("V-1", (-1,)), ("D1,-1,1,1", (1, -1, 1, 1)),
        ("L2147483647,0,0,0", (2147483647, 0, 0, 0)), ("E2", (2,)),
        ("F,,20000", (None, None, 20000)), ("A-1000,0,-2000,0,1", (-1000, 0, -2000, 0, 1)),
        ("T500,0,0,0,2000,0", (500, 0, 0, 0, 2000, 0)),
        ("+-1000,0,-2000,0,1,-500,4", (-1000, 0, -2000, 0, 1, -500, 4)),
        ("G2000,1000,100,10,8000", (2000, 1000, 100, 10, 8000)), ("B400,0,0,0", (400, 0, 0, 0)),
    ],
)  # fmt: skip
def test_a_text_is_read(text: str, wanted: tuple[int | None, ...]) -> None:
    """Omitted parameters are None, also those left out at the end."""
    assert values(text) == wanted


@pytest.mark.parametrize(
    ("text", "switch", "reading", "is_refused"),
    [
        ("L-2147483648,0,0,0", "long_min", "-2147483648", False),
        ("L2147000001,0,0,0", "long_max", "2147000000", True),
        ("L,5", "omitted_param", "error", True),
        ("P1,3", "omitted_param", "error", False),
        ("P1,3", "omitted_param", "zero", False),
        ("?5", "extra_params", "ignore", False),
        ("G40000,1,1,1,1", "g_widths", "32x5", False),
        ("G40000,1,1,1,1", "g_widths", "16x4_32", True),
        ("G1,1,1,1,40000", "g_widths", "16x4_32", False),
        ("V-5", "negative_v", "minus_one_only", True),
        ("V-1", "negative_v", "minus_one_only", False),
        ("V1", "speed_range_policy", "clip", False),
        ("P0,1", "plane_base", "0", False),
        ("P4,1", "plane_base", "0", True),
        ("P1,3,3", "plane_z_check", "at_plane", True),
        ("L 5,0,0,0", "space_policy", "skip", False),
        ("H1", "hold_takes_arg", "false", True),
        ("E3", "measure_other", "plain", False),
    ],
)
def test_where_the_manual_is_open_the_reading_decides(
    text: str, switch: str, reading: str, is_refused: bool
) -> None:
    """The other reading turns the answer of the default around, or leaves it."""
    assert bool(refusal(text, **{switch: reading})) is is_refused


def test_what_fails_nobody_is_an_interpretation() -> None:
    """A refusal that a must asks for is never left open."""
    kinds = {LEDGER.requirements[name].kind for name in OPEN_REFUSALS}
    assert kinds == {RequirementKind.INTERPRETATION}


def test_the_longest_texts_are_those_of_the_ledger() -> None:
    """M 48, A 51, T 65, + 69 characters, all parameters at full width."""
    lengths = dict.fromkeys(COMMANDS, 1)
    for letter, rule in COMMANDS.items():
        widths = [max(len(str(one.low)), len(str(one.high))) for one in rule.parameters]
        lengths[letter] += sum(widths) + max(0, len(widths) - 1)
    assert {letter: length for letter, length in lengths.items() if length > 40} == {
        "M": 48, "L": 48, "A": 51, "T": 65, "+": 69,
    }  # fmt: skip


def test_an_arc_whose_radii_nearly_agree_is_one() -> None:
    """The manual's own 45 degrees are off by 0.63; half the way to the centre is not."""
    tolerance = Fraction(default("arc_radius_tol"))
    assert arc_radii_differ((0, -500), (-354, -146), tolerance) is None
    assert arc_radii_differ((0, -500), (-354, -146), Fraction(1, 2)) is not None
    far = arc_radii_differ((-1000, 0), (-500, 0), tolerance)
    assert far is not None
    assert far.requirement == "MN4-CMD-A-04"
    zero = arc_radii_differ((0, 0), (0, 0), tolerance)
    assert zero is not None
    assert zero.requirement == "MN4-ARC-07"
    # Exactly on the bound, and a step beyond it.
    assert arc_radii_differ((10, 0), (10, 12), Fraction(2)) is None
    assert arc_radii_differ((10, 0), (10, 13), Fraction(2)) is not None


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        (REQUEST, "1: M1000 (move: m1 1000)"),
        ("80 2A 80 2A", "all boards: * (poll)"),
        ("81 57 81 59", "1: W (no command)"),
        ("81 04 81 06", "1: Ctrl-D (end of the program)"),
        ("81 2A 82 2D", "1: * (poll); second address 82h"),
        ("41 42", "2 bytes: 41 42"),
        ("81 58 61 81 3B", "1: Xa (multiplex: parameters of no sense)"),
    ],
)
def test_a_request_is_told_in_words(raw: str, told: str) -> None:
    """Parameters by their names, flaws behind."""
    assert words.explain_request(bytes.fromhex(raw)) == told


def test_a_reply_is_told_in_words() -> None:
    """Each packet with its board; what is no packet in hex."""
    raw = codec.status(1, "E", START) + codec.data(1, "E", "1,-2,0,0") + b"\x81\x45"
    assert words.explain_reply(raw) == "1: E START, 1: E 1,-2,0,0, 2 bytes: 81 45"
    bare = codec.status(2, "K", ReturnCode.NOMOVEPENDING, null=False)
    assert words.explain_reply(bare) == "2: K NOMOVEPENDING without null"


def departures(text: str, reply: bytes, board: int = 1) -> list[tuple[str, str]]:
    """What departs in the reply to a command, by requirement and name."""
    read = lenient(board, codec.request(board, text), reply)
    assert read is not None
    return [one.key for one in read.departures]


SOUND_REPLIES = {
    "V500": codec.status(1, "V", START) + codec.status(1, "V", DONE),
    "e": codec.status(1, "E", START) + codec.data(1, "E", "0,0,0,0"),
    "*": codec.status(1, "*", START) + codec.status(1, "*", PRESENT),
    "&": codec.status(1, "&", DONE),
    "W": codec.status(1, "W", ReturnCode.INVALIDCOMMAND),
    "K": codec.status(1, "K", START) + codec.status(1, "K", 0x10, null=False),
    "R": codec.status(1, "R", START) + codec.data(1, "R", "M1") + codec.data(1, "R", "M-1"),
}


@pytest.mark.parametrize("text", SOUND_REPLIES)
def test_a_sound_reply_departs_in_nothing(text: str) -> None:
    """And is handed on byte for byte."""
    reply = SOUND_REPLIES[text]
    read = lenient(1, codec.request(1, text), reply)
    assert read is not None
    assert read.departures == ()
    assert read.mended == reply


@pytest.mark.parametrize(
    ("text", "reply", "wanted"),
    [
        ("E", codec.data(1, "E", "0,0,0,0"), [("MN4-RSP-04", "no START")]),
        ("V500", codec.status(1, "V", DONE), [("MN4-RSP-03", "no START")]),
        ("E", SOUND_REPLIES["e"] + codec.status(1, "E", DONE),
         [("MN4-RSP-04", "DONE behind data")]),
        ("V500", codec.status(1, "V", START, null=False) + codec.status(1, "V", DONE),
         [("MN4-RSP-01", "null")]),
        ("*", codec.status(0, "*", START) + codec.status(1, "*", PRESENT),
         [("MN4-PKT-07", "address")]),
        ("V5", codec.with_wrong_checksum(codec.status(1, "V", START)) + codec.status(1, "V", DONE),
         [("MN4-PKT-03", "checksum")]),
        ("V5", codec.status(1, "W", START) + codec.status(1, "V", DONE),
         [("MN4-RSP-11", "command")]),
        ("&", codec.status(1, "&", START) + codec.status(1, "&", DONE), [("MN4-RSP-08", "START")]),
        ("V5", b"ok" + SOUND_REPLIES["V500"], [("MN4-RSP-14", "strays")]),
        ("V5", codec.status(1, "V", START), [("MN4-RSP-03", "completeness")]),
        ("V5", codec.status(1, "V", START)[:3], [("MN4-RSP-03", "completeness")]),
    ],
)  # fmt: skip
def test_a_departure_is_named(text: str, reply: bytes, wanted: list[tuple[str, str]]) -> None:
    """One thing that is wrong has one name."""
    assert departures(text, reply) == wanted


def test_what_departs_in_a_known_way_is_mended() -> None:
    """Address, sum, command and null become a sound board's; START and DONE are put right."""
    sloppy = codec.with_wrong_checksum(codec.status(0, "V", START, null=False))
    read = lenient(1, codec.request(1, "V5"), sloppy + codec.status(1, "V", DONE))
    assert read is not None
    assert read.mended == SOUND_REPLIES["V500"]
    done = codec.status(1, "E", DONE)
    late = lenient(1, codec.request(1, "E"), codec.data(1, "E", "0,0,0,0") + done)
    assert late is not None
    assert late.mended == SOUND_REPLIES["e"]


@pytest.mark.parametrize("reply", [b"", b"OK\r\n", b"\x02\x01\x00"])
def test_another_protocol_is_not_read(reply: bytes) -> None:
    """Nor is silence; and what is no request has no reply."""
    assert lenient(1, codec.request(1, "E"), reply) is None
    assert lenient(1, codec.request(1, "E")[:3], SOUND_REPLIES["e"]) is None
