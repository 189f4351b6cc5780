"""Parameters of an MN400's commands: every range, omission and malformation of the ledger."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mn400_state_table import cells

from axistwin.devices.mn400.acceptance import TABLE
from axistwin.devices.mn400.grammar import Arguments, ParameterError, arguments, commands
from axistwin.devices.mn400.quirks import parse_quirks
from axistwin.devices.switches import Value

WRONG = """
V12.5 M10a L1-2 L- M+5 M5.0 M0x10 M1,2,3,4,5 ?5 Q1
B32768 B-32768 B65537 B-1 L3000000000 L4294967297 L-2147483648 L99999999999999999999
V V0 V1 V100001 F5000,100001 F1 F,,0 Y1 Y Y-1
A A1,2,3,4 A1,2,3,4,0 A1,2,3,4,2 +1,0,2,0,1,0,-1 T1,0,0,0 T1,0,0,0,0 T1,0,0,0,5,-1
C C1 C0,0 C9,0 C1,2 C1,-1 ; ;2 H2 J J2 I I2 =0 =128 = ~5 ~-1 ~ P P1 P0,1 P5,1
X X0 X3 X8 D0 D2 G1,1,1,1 G0,1,1,1,1 G1,1,1,1,0 G40000,1,1,1,1 E3 E0 (-1 (32768
"""


def parse(line: str, **settings: Value) -> Arguments | None:
    """The parameters of ``line``, None if they are refused."""
    quirks = parse_quirks(settings)
    try:
        return arguments(commands(quirks)[line[0]], line[1:].encode(), quirks)
    except ParameterError:
        return None


def test_the_table_of_states_is_that_of_the_ledger() -> None:
    """Forty commands in fourteen states."""
    own = {(letter, state.name): word.value for (letter, state), word in TABLE.items()}
    assert own == cells()
    assert len(own) == 40 * 14


@pytest.mark.parametrize(
    ("line", "read"),
    [
        ("M1000", (1000, None, None, None)),
        ("M,,-100", (None, None, -100, None)),
        ("M1,", (1, None, None, None)),
        ("M", (None, None, None, None)),
        ("L007,-0,0,0", (7, 0, 0, 0)),
        ("L2147483647,-2147483647", (2147483647, -2147483647, None, None)),
        ("(", (20,)),
        ("(50", (50,)),
        ("A-1000,0,-2000,0,1", (-1000, 0, -2000, 0, 1)),
        ("A,5,,,-1", (None, 5, None, None, -1)),
        ("+-1000,0,-2000,0,1,-500,4", (-1000, 0, -2000, 0, 1, -500, 4)),
        ("+1,0,2,0,1", (1, 0, 2, 0, 1, None, 0)),
        ("T500,0,0,0,2000", (500, 0, 0, 0, 2000, 0)),
        ("P1,2", (1, 2, None)),
        ("F,5000", (None, 5000, None)),
        ("H", (None,)),
        ("V-5", (-5,)),
        ("V2", (2,)),
        ("B32767", (32767, None, None, None)),
        ("G32767,1,1,1,32767", (32767, 1, 1, 1, 32767)),
        ("E", (None,)),
        ("E2", (2,)),
        ("?", ()),
    ],
)
def test_what_is_right_is_read(line: str, read: Arguments) -> None:
    """None is a parameter that was omitted."""
    assert parse(line) == read


@pytest.mark.parametrize("line", WRONG.split())
def test_what_is_wrong_is_refused(line: str) -> None:
    """With PARA_ERROR (MN4-ERR-02)."""
    assert parse(line) is None


@pytest.mark.parametrize(
    ("line", "name", "value", "read"),
    [
        ("V1", "speed_range_policy", "clip", (2,)),
        ("F1,200000,0", "speed_range_policy", "clip", (2, 100000, 1)),
        ("V-5", "negative_v", "minus_one_only", None),
        ("V-1", "negative_v", "minus_one_only", (-1,)),
        ("G40000,1,1,1,40000", "g_widths", "32x5", (40000, 1, 1, 1, 40000)),
        ("G1,1,1,1,40000", "g_widths", "16x4_32", (1, 1, 1, 1, 40000)),
        ("G40000,1,1,1,1", "g_widths", "16x4_32", None),
        ("L2147000001", "long_max", "2147000000", None),
        ("L-2147483648", "long_min", "-2147483648", (-2147483648, None, None, None)),
        ("P0,3", "plane_base", "0", (0, 3, None)),
        ("P4,1", "plane_base", "0", None),
        ("L,9", "omitted_param", "zero", (0, 9, 0, 0)),
        ("L,9", "omitted_param", "error", None),
        ("F,5000", "omitted_param", "zero", None),
        ("M,9", "omitted_param", "error", (None, 9, None, None)),
        ("P1,2", "omitted_param", "error", (1, 2, None)),
        ("P1,2", "omitted_param", "zero", (1, 2, None)),
        ("?5", "extra_params", "ignore", ()),
        ("X2,9", "extra_params", "ignore", (2,)),
        ("E3", "measure_other", "plain", (3,)),
        ("H0", "hold_takes_arg", "false", None),
    ],
)
def test_readings_of_the_parameters(
    line: str, name: str, value: str, read: Arguments | None
) -> None:
    """Each under the quirk that names it."""
    assert parse(line, **{name: value}) == read


@given(st.lists(st.integers(-(1 << 31) + 1, (1 << 31) - 1) | st.none(), min_size=1, max_size=4))
def test_every_list_of_distances_is_read_back(distances: list[int | None]) -> None:
    """Whatever is omitted, and wherever the list ends."""
    text = ",".join("" if each is None else str(each) for each in distances)
    read = parse("M" + text)
    assert read == tuple(distances) + (None,) * (4 - len(distances))


def test_numbers_of_any_length_are_read_right() -> None:
    """As many digits as a buffer may hold; leading zeros do not count."""
    assert parse("L" + "0" * 8000 + "7") == (7, None, None, None)
    assert parse("L1" + "0" * 8000) is None
    assert parse("L1" + "0" * 20) is None


def test_commands_that_a_predecessor_lacks_can_be_left_out() -> None:
    """; and : (MN4-AMB-38)."""
    known = commands(parse_quirks({"has_feedhold_cmds": False}))
    assert len(known) == 38
    assert not {";", ":"} & known.keys()
