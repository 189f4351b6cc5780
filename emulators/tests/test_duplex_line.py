"""Wires of their own for each direction: who hears what, when, and in which order."""

import random

import pytest

from axistwin.wire.duplex_line import DuplexLine
from axistwin.wire.framing import LineFormat
from axistwin.wire.serial_line import HOST

F9600 = LineFormat(9600)
BYTE_NS = F9600.span_ns(1)
BOTH_PACES = pytest.mark.parametrize("paced", [True, False])

Heard = list[tuple[int, int, int]]


def listen(line: DuplexLine, until_ns: int, most: int = 10**9) -> Heard:
    """All (time, station, value) heard by ``until_ns``, in the order in which it is handed over."""
    heard: Heard = []
    while (offer := line.offer(until_ns)) is not None:
        chunk, stations = offer
        count = min(most, len(chunk.data))
        line.accept(count)
        for index in range(count):
            heard += [(chunk.arrival_ns(index), each, chunk.data[index]) for each in stations]
    assert line.now_ns == until_ns
    return heard


def bytes_at(heard: Heard, station: int) -> bytes:
    """What ``station`` heard."""
    return bytes(value for _, each, value in heard if each == station)


@BOTH_PACES
def test_both_ends_send_at_a_time(paced: bool) -> None:
    """Nothing is disturbed, and nobody is deaf while it drives."""
    line = DuplexLine([F9600] * 2, paced=paced)
    line.transmit(HOST, 0, b"downwards")
    line.transmit(1, BYTE_NS // 3, b"upwards")
    heard = listen(line, 10**9)
    assert bytes_at(heard, 1) == b"downwards"
    assert bytes_at(heard, HOST) == b"upwards"
    assert line.is_silent
    assert line.transmissions_held == line.bytes_held == 0


def test_bytes_of_both_lines_come_in_the_order_of_time() -> None:
    """Taken in whatever pieces; at one nanosecond those for the host first."""
    rng = random.Random(1)
    for most in (1, 2, 10**9):
        line = DuplexLine([F9600] * 2)
        for _ in range(40):
            station, start_ns = rng.randrange(2), rng.randrange(200 * BYTE_NS)
            line.transmit(station, start_ns, rng.randbytes(rng.randrange(1, 9)))
        line.transmit(HOST, 10**9, b"x")
        line.transmit(1, 10**9, b"y")
        heard = listen(line, 10**10, most)
        assert [time for time, _, _ in heard] == sorted(time for time, _, _ in heard)
        assert [station for _, station, _ in heard[-2:]] == [HOST, 1]


@BOTH_PACES
def test_devices_do_not_hear_one_another(paced: bool) -> None:
    """What one says, the host alone hears; what the host says, all of them."""
    line = DuplexLine([F9600] * 4, paced=paced)
    line.transmit(2, 0, b"answer")
    assert listen(line, 10**8) == [
        (F9600.span_ns(n + 1) if paced else 0, HOST, value) for n, value in enumerate(b"answer")
    ]
    line.transmit(HOST, 10**8, b"all")
    heard = listen(line, 10**9)
    assert [bytes_at(heard, station) for station in range(4)] == [b"", b"all", b"all", b"all"]


@BOTH_PACES
def test_devices_that_answer_at_once_collide(paced: bool) -> None:
    """They share the pair on which the host listens."""
    line = DuplexLine([F9600] * 3, paced=paced)
    line.transmit(1, 0, b"\xf3\x55")
    line.transmit(2, 0, b"\x3f\x0f")
    heard = listen(line, 10**9)
    assert bytes_at(heard, HOST) == b"\x33\x05"
    assert bytes_at(heard, 1) == bytes_at(heard, 2) == b""


def test_a_device_without_supply_breaks_off_and_hears_nothing() -> None:
    """On both pairs."""
    line = DuplexLine([F9600] * 2)
    line.transmit(1, 0, b"abc")
    line.transmit(HOST, 0, b"abc")
    heard = listen(line, BYTE_NS + 1)
    line.switch_off(1)
    heard += listen(line, 10**8)
    assert bytes_at(heard, 1) == b"a"
    assert bytes_at(heard, HOST)[:1] == b"a"
    assert bytes_at(heard, HOST) != b"abc"
    line.switch_on(1)
    line.transmit(HOST, 10**8, b"d")
    assert bytes_at(listen(line, 10**9), 1) == b"d"


def test_a_bad_character_is_told_to_the_device() -> None:
    """Seven bits and parity from the host, where eight bits are expected."""
    line = DuplexLine([LineFormat(9600, 8, "E"), F9600])
    line.transmit(HOST, 0, b"\x03")
    offer = line.offer(10**9)
    assert offer is not None
    assert (offer[0].data, offer[0].errors, offer[1]) == (b"\x03", (0,), (1,))


def test_what_is_to_come_is_foretold() -> None:
    """The next byte for each end, and a stretch if only one end sends."""
    line = DuplexLine([F9600] * 2)
    assert line.next_arrival() is None
    line.transmit(HOST, 0, b"ab")
    stretch = line.peek_stretch()
    assert stretch is not None
    assert (stretch[0].data, stretch[1]) == (b"ab", (1,))
    line.transmit(1, BYTE_NS, b"c")
    assert line.peek_stretch() is None
    assert line.next_arrival() == line.next_arrival_at(1) == BYTE_NS
    assert line.next_arrival_at(HOST) == 2 * BYTE_NS
    assert (line.backlog(HOST), line.backlog(1)) == (2, 1)
    assert line.sent_ns(1) == 2 * BYTE_NS
    line.purge(1)
    assert line.next_arrival_at(HOST) is None
    listen(line, 10**9)
    line.transmit(1, 10**9, b"up")
    stretch = line.peek_stretch()
    assert stretch is not None
    assert (stretch[0].data, stretch[1]) == (b"up", (HOST,))


def test_a_rate_counts_in_both_directions() -> None:
    """One that differs is garbled both ways."""
    line = DuplexLine([F9600] * 2)
    line.set_format(1, LineFormat(4800))
    line.transmit(HOST, 0, b"hello")
    line.transmit(1, 0, b"hello")
    heard = listen(line, 10**9)
    assert bytes_at(heard, HOST) != b"hello"
    assert bytes_at(heard, 1) != b"hello"
    assert line.ahead_of_host() is None
