"""The pair when bytes take no time."""

from axistwin.wire.framing import LineFormat
from axistwin.wire.instant_line import InstantLine
from axistwin.wire.serial_line import HOST

F38400 = LineFormat(38400)
F9600 = LineFormat(9600)
ANSWER = b"\x06\x13\x02UUU\x1a"


def listen(line: InstantLine, until_ns: int, most: int = 10**9) -> list[tuple[int, int, int]]:
    """All (time, station, value) heard by ``until_ns``, taken ``most`` bytes at a time."""
    heard = []
    while (offer := line.offer(until_ns)) is not None:
        chunk, stations = offer
        assert chunk.format is None
        count = min(most, len(chunk.data))
        line.accept(count)
        assert HOST not in stations or not chunk.errors
        heard += [
            (chunk.start_ns, each, chunk.data[index])
            for index in range(count)
            if index not in chunk.errors
            for each in stations
        ]
    assert line.now_ns == until_ns
    return heard


def bytes_at(heard: list[tuple[int, int, int]], station: int) -> bytes:
    """What ``station`` heard."""
    return bytes(value for _, each, value in heard if each == station)


def test_a_burst_is_heard_at_the_nanosecond_it_is_sent() -> None:
    """By everybody but its sender, in order, in whatever pieces."""
    for most in (1, 3, 10**9):
        line = InstantLine([F38400] * 3, 50)
        line.transmit(HOST, 0, b"abc" * 1000)
        line.transmit(HOST, 0, b"d")
        assert line.backlog(HOST) == 3001
        heard = listen(line, 50, most)
        assert {time for time, _, _ in heard} == {50}
        assert bytes_at(heard, 1) == bytes_at(heard, 2) == b"abc" * 1000 + b"d"
        assert bytes_at(heard, HOST) == b""
        assert line.bytes_held == line.transmissions_held == line.backlog(HOST) == 0


def test_rates_still_have_to_match() -> None:
    """One in another format hears what its UART would have sampled; the others hear all."""
    line = InstantLine([F38400, F38400, F9600])
    line.transmit(HOST, 0, ANSWER)
    heard = listen(line, 0)
    assert bytes_at(heard, 1) == ANSWER
    assert bytes_at(heard, 2) != ANSWER
    line.set_format(HOST, F9600)
    line.transmit(1, 0, ANSWER)
    garbage = bytes_at(listen(line, 0), HOST)
    assert garbage
    assert garbage != ANSWER


def test_answers_that_would_overlap_collide() -> None:
    """Known before the first begins, and begun before it would have ended."""
    overlap_ns = F38400.span_ns(len(ANSWER)) - 1
    for skew_ns in (0, 30_000, 400_000):
        line = InstantLine([F38400] * 3)
        line.transmit(1, 1000, ANSWER)
        line.transmit(2, 1000 + skew_ns, ANSWER[::-1])
        assert skew_ns <= overlap_ns
        heard = listen(line, 10**9)
        assert ANSWER not in bytes_at(heard, HOST)
        assert {time for time, _, _ in heard} == {1000}
        assert line.transmissions_held == 0


def test_collisions_chain() -> None:
    """A third that only overlaps the second is part of the same garbage."""
    line = InstantLine([F38400] * 4)
    for station in (1, 2, 3):
        line.transmit(station, (station - 1) * F38400.span_ns(5), ANSWER)
    heard = listen(line, 10**9)
    assert {time for time, _, _ in heard} == {0}
    assert ANSWER not in bytes_at(heard, HOST)


def test_answers_that_would_not_overlap_are_whole() -> None:
    """One that begins when the other would have ended is alone."""
    line = InstantLine([F38400] * 3)
    line.transmit(1, 0, ANSWER)
    line.transmit(2, F38400.span_ns(len(ANSWER)), ANSWER)
    assert bytes_at(listen(line, 10**9), HOST) == ANSWER * 2


def test_the_host_collides_with_nobody_and_goes_first() -> None:
    """At one nanosecond the host's burst is heard before an answer."""
    line = InstantLine([F38400] * 2)
    line.transmit(1, 0, b"answer")
    line.transmit(HOST, 0, b"request")
    heard = listen(line, 0)
    assert [station for _, station, _ in heard] == [1] * 7 + [0] * 6
    assert bytes_at(heard, HOST) == b"answer"


def test_a_station_sends_in_order() -> None:
    """What is queued behind a later start waits for it."""
    line = InstantLine([F38400] * 2)
    line.transmit(1, 500, b"a")
    line.transmit(1, 100, b"b")
    assert line.sent_ns(1) == 500
    assert line.next_arrival_at(HOST) == line.next_arrival() == 500
    assert line.next_arrival_at(1) is None
    assert listen(line, 499) == []
    assert bytes_at(listen(line, 500), HOST) == b"ab"


def test_without_supply_nothing_is_sent_or_heard() -> None:
    """What was queued is gone; after power-on all is as before."""
    line = InstantLine([F38400] * 2)
    line.transmit(1, 500, b"a")
    line.switch_off(1)
    line.transmit(1, 600, b"b")
    line.transmit(HOST, 0, b"c")
    assert listen(line, 1000) == []
    line.switch_on(1)
    line.transmit(HOST, 0, b"d")
    assert bytes_at(listen(line, 1000), 1) == b"d"
