"""What a receiver makes of levels."""

import bit_by_bit
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.kernel.schedule import NEVER
from axistwin.wire.framing import LineFormat
from axistwin.wire.uart import UartReceiver
from axistwin.wire.waveform import FINE_BITS, Transmission, make_break

F1000 = LineFormat(1000)  # one bit is 1 ms
MS = 1_000_000


def hear(
    line: list[Transmission], line_format: LineFormat = F1000, *, is_host: bool = False
) -> list[tuple[int, int]]:
    """All (done_ns, value) that a receiver gets from ``line``; at a device only the good ones."""
    heard = characters(line, UartReceiver((0,), line_format))
    if is_host:
        return [(done_ns, 0 if is_bad else value) for done_ns, value, is_bad in heard]
    return [(done_ns, value) for done_ns, value, is_bad in heard if not is_bad]


def characters(
    line: list[Transmission], receiver: UartReceiver, most: int = 10**9
) -> list[tuple[int, int, bool]]:
    """Time, value and badness of all that ``receiver`` gets, taken ``most`` at a time."""
    heard: list[tuple[int, int, bool]] = []
    while receiver.next_done_ns(line) is not None:
        chunk = receiver.characters(NEVER).first(most)
        for place, value in enumerate(chunk.data):
            heard.append((chunk.arrival_ns(place), value, place in chunk.errors))
        assert receiver.take(len(chunk.data)) == heard[-1][0]
    return heard


def test_a_byte_counts_one_character_after_its_edge() -> None:
    """At the end of its stop bit."""
    assert hear([Transmission(1, 7, F1000, b"ab")]) == [(10 * MS + 7, 0x61), (20 * MS + 7, 0x62)]


@pytest.mark.parametrize(("width_ns", "is_heard"), [(MS // 2 - 1, False), (MS // 2 + 1, True)])
def test_a_start_bit_must_last_to_its_middle(width_ns: int, is_heard: bool) -> None:
    """A shorter pulse is a glitch, a longer one the start of FFh."""
    expected = [(10 * MS, 0xFF)] if is_heard else []
    assert hear([make_break(1, 0, width_ns, F1000)]) == expected


@pytest.mark.parametrize(("width_ns", "value"), [(9 * MS + MS // 2 - 1, 0), (10 * MS, None)])
def test_a_stop_bit_must_be_mark_in_its_middle(width_ns: int, value: int | None) -> None:
    """Nine bits of space are a NUL, more are a bad character: told as such, or NUL at the host."""
    line = [make_break(1, 0, width_ns, F1000)]
    assert hear(line) == ([] if value is None else [(10 * MS, value)])
    assert hear(line, is_host=True) == [(10 * MS, 0)]


def test_after_a_bad_stop_bit_the_next_falling_edge_starts_a_character() -> None:
    """A long break is one character, and does not swallow what follows its end."""
    line = [make_break(1, 0, 500 * MS, F1000), Transmission(1, 501 * MS, F1000, b"a")]
    assert hear(line, is_host=True) == [(10 * MS, 0), (511 * MS, 0x61)]


def test_the_search_goes_on_in_the_middle_of_the_stop_bit() -> None:
    """A sender that is a little fast is followed."""
    fast = LineFormat(1040)
    values = [value for _, value in hear([Transmission(1, 0, fast, b"U\0\xff" * 50)])]
    assert bytes(values) == b"U\0\xff" * 50


@pytest.mark.parametrize(
    ("baud", "is_understood"), [(930, False), (960, True), (1040, True), (1070, False)]
)
def test_rates_may_differ_by_about_five_percent(baud: int, is_understood: bool) -> None:
    """The last sample decides: 9.5 bits of one against 9 to 10 bits of the other."""
    data = bytes(range(256))
    values = [value for _, value in hear([Transmission(1, 0, LineFormat(baud), data)])]
    assert (bytes(values) == data) is is_understood


def test_a_bad_character_is_handed_to_a_device_as_sampled() -> None:
    """With word that it is bad, one character after its edge; a good one comes without."""
    line = [
        Transmission(1, 0, LineFormat(1000, 8, "E"), b"\x03"),  # parity 0, where 8N1 wants a stop
        Transmission(1, 50 * MS, F1000, b"a"),
    ]
    heard = characters(line, UartReceiver((0,), F1000))
    assert heard == [(10 * MS, 3, True), (60 * MS, 0x61, False)]


def test_bad_parity_is_bad_or_nul() -> None:
    """At a device nothing good arrives, at the host a NUL."""
    line = [Transmission(1, 0, LineFormat(1000, 7, "O"), b"a")]
    even = LineFormat(1000, 7, "E")
    assert hear(line, even) == []
    assert hear(line, even, is_host=True) == [(10 * MS, 0)]


def test_a_restarted_receiver_takes_the_next_edge_for_a_start_bit() -> None:
    """In the middle of a character that is some data bit."""
    receiver = UartReceiver((0,), F1000, searched=5 * MS << FINE_BITS)
    assert receiver.next_edge([Transmission(1, 0, F1000, b"\x5f")]) == 6 * MS << FINE_BITS


FORMATS = st.sampled_from(
    [
        LineFormat(38400),
        LineFormat(38400, 8, "N", 4),
        LineFormat(19200),
        LineFormat(115200),
        LineFormat(9600, 7, "E"),
        LineFormat(39000),
        LineFormat(38411, 5, "O", 3),
    ]
)
DRIVES = st.lists(
    st.tuples(
        st.integers(0, 3),  # who
        st.integers(0, 60) | st.integers(0, 2_000_000),  # a pause before it
        FORMATS,
        st.binary(min_size=1, max_size=8),
        st.sampled_from(["whole", "whole", "whole", "cut", "break"]),
        st.integers(1, 3_000_000),  # how much of it
    ),
    min_size=1,
    max_size=5,
)


@pytest.mark.strength
@settings(max_examples=150)
@given(DRIVES, FORMATS, st.just(0) | st.integers(0, 3_000_000 << FINE_BITS), st.integers(1, 9))
def test_runs_of_levels_give_what_every_instant_looked_at_gives(
    drives: list[tuple[int, int, LineFormat, bytes, str, int]],
    line_format: LineFormat,
    begin: int,
    most: int,
) -> None:
    """Any rates, overlaps, cuts, breaks, deafness; from any instant on; at once or in parts."""
    line: list[Transmission] = []
    free = [0] * 4
    for station, pause_ns, form, data, kind, length_ns in drives:
        start_ns = free[station] + pause_ns
        if kind == "break":
            line.append(make_break(station, start_ns, length_ns, form))
        else:
            line.append(Transmission(station, start_ns, form, data))
        if kind == "cut":
            line[-1].cut(start_ns + min(length_ns, line[-1].end_ns - start_ns))
        free[station] = line[-1].free_ns
    line.sort(key=lambda each: (each.start_ns, each.station))
    expected = bit_by_bit.hear(line, 0, line_format, begin)
    assert characters(line, UartReceiver((0,), line_format, begin), most) == expected


def test_a_long_stretch_is_sampled_window_by_window() -> None:
    """Thousands of bytes at a wrong rate, a long rest, and a long break among them."""
    line = [
        Transmission(1, 7, LineFormat(1100), bytes(range(256)) * 2),
        make_break(1, 10_000 * MS, 7_000 * MS, F1000),
        Transmission(2, 90_000 * MS, LineFormat(800), bytes(range(256))),
    ]
    expected = bit_by_bit.hear(line, 0, F1000, 0)
    assert len(expected) > 500
    assert characters(line, UartReceiver((0,), F1000)) == expected
