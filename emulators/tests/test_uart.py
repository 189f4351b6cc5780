"""What a receiver makes of levels."""

import pytest

from axistwin.wire.framing import LineFormat
from axistwin.wire.uart import UartReceiver
from axistwin.wire.waveform import Transmission, make_break

F1000 = LineFormat(1000)  # one bit is 1 ms
MS = 1_000_000


def hear(
    line: list[Transmission], line_format: LineFormat = F1000, *, is_host: bool = False
) -> list[tuple[int, int]]:
    """All (done_ns, value) that a receiver gets from ``line``; at a device only the good ones."""
    receiver = UartReceiver(0, line_format, is_host=is_host)
    heard = []
    while (character := receiver.next_character(line)) is not None:
        if character.value is not None and (is_host or not character.is_bad):
            heard.append((character.done_ns, character.value))
        receiver.take(character)
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
    receiver = UartReceiver(0, F1000, is_host=False)
    heard = []
    while (character := receiver.next_character(line)) is not None:
        heard.append((character.done_ns, character.value, character.is_bad))
        receiver.take(character)
    assert heard == [(10 * MS, 3, True), (60 * MS, 0x61, False)]


def test_bad_parity_is_bad_or_nul() -> None:
    """At a device nothing good arrives, at the host a NUL."""
    line = [Transmission(1, 0, LineFormat(1000, 7, "O"), b"a")]
    even = LineFormat(1000, 7, "E")
    assert hear(line, even) == []
    assert hear(line, even, is_host=True) == [(10 * MS, 0)]


def test_a_restarted_receiver_takes_the_next_edge_for_a_start_bit() -> None:
    """In the middle of a character that is some data bit."""
    receiver = UartReceiver(0, F1000, is_host=False)
    receiver.search_from(5 * MS << 40)
    character = receiver.next_character([Transmission(1, 0, F1000, b"\x5f")])
    assert character is not None
    assert character.edge == 6 * MS << 40
