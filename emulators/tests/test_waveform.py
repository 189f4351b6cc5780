"""Levels on the pair over time."""

from bisect import bisect_right
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.wire.framing import LineFormat
from axistwin.wire.waveform import FINE_BITS, Transmission, level_changes, make_break, parity_bit

F1000 = LineFormat(1000)  # one bit is 1 ms
MS = 1_000_000


def changes(line: list[Transmission], station: int) -> list[int]:
    """What ``station`` sees of the whole line."""
    pieces = [(each.station, each.piece(0, 0, 10**6 * MS << FINE_BITS)) for each in line]
    own = [piece for each, piece in pieces if each == station]
    return level_changes(own, [piece for each, piece in pieces if each != station])


def is_space(line: list[Transmission], station: int, fine: int) -> bool:
    """The level at that instant."""
    return bool(bisect_right(changes(line, station), fine) & 1)


def next_fall(line: list[Transmission], station: int, fine: int) -> int | None:
    """When mark next becomes space, at ``fine`` or later."""
    return next((each for each in changes(line, station)[::2] if each >= fine), None)


def levels(line: list[Transmission], station: int, bits: int) -> str:
    """What ``station`` sees in the middle of each millisecond."""
    middles = [(2 * bit + 1) * MS // 2 << FINE_BITS for bit in range(bits)]
    return "".join("_" if is_space(line, station, middle) else "-" for middle in middles)


@pytest.mark.parametrize(
    ("line_format", "value", "expected"),
    [
        (LineFormat(1000), 0x35, "_-_-_--__-"),
        (LineFormat(1000, 7, "E"), 0x35, "_-_-_--__-"),
        (LineFormat(1000, 8, "E"), 0x07, "_---_____--"),
        (LineFormat(1000, 8, "O", 4), 0x07, "_---______--"),
        (LineFormat(1000, 5, "M"), 0x00, "______--"),
        (LineFormat(1000, 5, "S"), 0x1F, "_-----_-"),
    ],
    ids=str,
)
def test_a_character_is_drawn_as_the_format_says(
    line_format: LineFormat, value: int, expected: str
) -> None:
    """Start bit, data lowest first, parity, stop; before and behind it the line is at mark."""
    line = [Transmission(1, 2 * MS, line_format, bytes((value,)))]
    assert levels(line, 0, len(expected) + 5) == "--" + expected + "---"


@pytest.mark.parametrize(
    ("parity", "even", "odd"), [("E", 0, 1), ("O", 1, 0), ("M", 1, 1), ("S", 0, 0)]
)
def test_parity(parity: str, even: int, odd: int) -> None:
    """The bit for a value of even and of odd weight."""
    assert (parity_bit(parity, 0x33), parity_bit(parity, 0x31)) == (even, odd)


def test_space_wins_and_a_driving_station_sees_mark() -> None:
    """Levels combine; the receiver of a station that drives is off."""
    line = [Transmission(1, 0, F1000, b"\xf0"), Transmission(2, 0, F1000, b"\xcc")]
    assert levels(line, 0, 10) == "_______---"
    assert levels(line, 1, 12) == "-" * 12
    assert levels(line, 3, 10) == levels(line, 0, 10)


def test_a_break_is_space_throughout_and_needs_a_rest() -> None:
    """Its station may send again one bit later, so that the next start bit can be seen."""
    broken = make_break(1, MS, 3 * MS, F1000)
    assert levels([broken], 0, 6) == "-___--"
    assert broken.free_ns == 5 * MS
    assert next_fall([broken], 0, 0) == MS << FINE_BITS


def test_a_cut_lets_go_at_once() -> None:
    """In the middle of a character the rest is mark; at its end nothing is broken."""
    line = [Transmission(1, 0, F1000, b"\0\0")]
    line[0].cut(3 * MS)
    assert levels(line, 0, 12) == "___---------"
    assert line[0].is_broken
    whole = Transmission(1, 0, F1000, b"\0\0")
    whole.cut(10 * MS)
    assert not whole.is_broken
    assert (whole.count, whole.end_ns) == (1, 10 * MS)


def test_a_receiver_that_comes_back_on_in_space_sees_an_edge() -> None:
    """Its own end of driving counts as a falling edge if the line is at space then."""
    line = [Transmission(1, 0, F1000, b"\xff"), Transmission(2, 5 * MS, F1000, b"\0")]
    assert next_fall(line, 1, 0) == 10 * MS << FINE_BITS
    assert next_fall(line, 0, 0) == 0
    assert next_fall(line, 0, 1) == 5 * MS << FINE_BITS
    line = [make_break(1, 0, 90 * MS, F1000), Transmission(2, 20 * MS, F1000, b"\xff")]
    assert next_fall(line, 2, 1) == 30 * MS << FINE_BITS
    assert next_fall(line, 2, 31 * MS << FINE_BITS) is None


@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.integers(0, 30), st.binary(min_size=1, max_size=2)),
        max_size=4,
    ),
    st.integers(0, 3),
)
def test_falls_are_where_levels_fall(sent: list[tuple[int, int, bytes]], station: int) -> None:
    """Looking for edges and looking at levels agree, bit by bit."""
    line = [Transmission(each, start * MS, F1000, data) for each, start, data in sent]
    seen = "-" + levels(line, station, 60)
    expected = [bit for bit, pair in enumerate(pairwise(seen)) if pair == ("-", "_")]
    falls = []
    fine = next_fall(line, station, 0)
    while fine is not None:
        falls.append((fine >> FINE_BITS) // MS)
        fine = next_fall(line, station, fine + 1)
    assert falls == expected


def test_a_long_stretch_forgets_its_past() -> None:
    """Freed memory moves no byte and no number."""
    stretch = Transmission(1, 0, F1000, bytes(range(256)) * 40)
    stretch.forget_before(10_000)
    assert stretch.kept == 240
    assert stretch.data(10_000, 10_002) == bytes((16, 17))
    assert stretch.edge(10_000, 0) == (100_000 * MS) << FINE_BITS


def test_bytes_complete_and_begun() -> None:
    """A byte is complete at its last nanosecond, and has begun one behind its first."""
    stretch = Transmission(1, 100, F1000, b"abc")
    assert [stretch.complete_by(100 + each) for each in (10 * MS - 1, 10 * MS, 10**9)] == [0, 1, 3]
    assert [stretch.begun_by(100 + each) for each in (0, 1, 10 * MS, 10 * MS + 1)] == [0, 1, 1, 2]
    stretch.stop_after(2)
    assert (stretch.count, stretch.kept, stretch.end_ns) == (2, 2, 100 + 20 * MS)
