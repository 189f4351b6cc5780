"""Characters take their time, to the nanosecond."""

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.wire.framing import PARITIES, Chunk, LineFormat

formats = st.builds(
    LineFormat,
    st.integers(50, 4_000_000),
    st.integers(5, 8),
    st.sampled_from(PARITIES),
    st.sampled_from([2, 3, 4]),
)


@pytest.mark.parametrize(
    ("line_format", "half_bits"),
    [
        (LineFormat(38400), 20),
        (LineFormat(9600, 7, "E"), 20),
        (LineFormat(9600, 8, "E"), 22),
        (LineFormat(9600, 8, "O", 4), 24),
        (LineFormat(110, 5, "N", 3), 15),
    ],
)
def test_a_character_is_start_data_parity_and_stop_bits_long(
    line_format: LineFormat, half_bits: int
) -> None:
    """The length counts in half bits because of one and a half stop bits."""
    assert line_format.half_bits_per_byte == half_bits


def test_a_request_of_21_bytes_takes_5469_microseconds_at_38400() -> None:
    """The ledger's table of times on the line, to the nanosecond."""
    assert LineFormat(38400).span_ns(21) == 5_468_750
    assert LineFormat(19200).span_ns(21) == 10_937_500
    assert LineFormat(9600).span_ns(21) == 21_875_000
    assert LineFormat(38400).span_ns(1) == 260_416


@given(formats, st.integers(0, 10**6))
def test_spans_are_exact_rounded_down_once(line_format: LineFormat, count: int) -> None:
    """A million characters end within the nanosecond where exact arithmetic puts them."""
    exact = Fraction(count * line_format.half_bits_per_byte * 10**9, 2 * line_format.baud)
    assert line_format.span_ns(count) == exact // 1


@given(formats, st.integers(0, 10**6), st.integers(0, 10**13))
def test_counting_characters_inverts_spans(
    line_format: LineFormat, count: int, elapsed_ns: int
) -> None:
    """A character is complete at the nanosecond its span says and not one before."""
    assert line_format.characters_within(line_format.span_ns(count)) == count
    assert count == 0 or line_format.characters_within(line_format.span_ns(count) - 1) < count
    within = line_format.characters_within(elapsed_ns)
    assert line_format.span_ns(within) <= elapsed_ns < line_format.span_ns(within + 1)


def test_no_character_is_complete_before_the_start() -> None:
    """A time before the start bit counts as nothing heard."""
    assert LineFormat(38400).characters_within(-1) == 0


@given(formats, st.integers(0, 10**15), st.binary(min_size=1, max_size=50), st.data())
def test_a_stretch_cut_anywhere_keeps_its_arrival_times(
    line_format: LineFormat, start_ns: int, data: bytes, draw: st.DataObject
) -> None:
    """Cutting a stretch in two moves no byte by a nanosecond."""
    cut = draw.draw(st.integers(0, len(data) - 1))
    whole = Chunk(start_ns, data, line_format)
    tail = Chunk(start_ns, data[cut:], line_format, cut)
    assert [whole.arrival_ns(i) for i in range(cut, len(data))] == [
        tail.arrival_ns(i) for i in range(len(data) - cut)
    ]


def test_without_pacing_every_byte_arrives_at_the_start() -> None:
    """A chunk without a format takes no time."""
    chunk = Chunk(7, b"abc", None)
    assert [chunk.arrival_ns(i) for i in range(3)] == [7, 7, 7]


def test_formats_compare_and_print_by_what_they_mean() -> None:
    """Equal settings are equal formats; the text is what engineers write."""
    assert LineFormat(9600) == LineFormat(9600, 8, "N", 2)
    assert LineFormat(9600) != LineFormat(9600, 8, "N", 4)
    assert len({LineFormat(9600), LineFormat(9600)}) == 1
    assert str(LineFormat(9600, 7, "E", 3)) == "9600 7E1.5"
