"""The pair: what each station hears, against an independent reading of the rules."""

from collections.abc import Callable, Sequence

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from uart_reference import Heard, Sent, reference

from axistwin.wire.framing import LineFormat
from axistwin.wire.serial_line import HOST, SerialLine
from axistwin.wire.waveform import Transmission

F38400 = LineFormat(38400)
F9600 = LineFormat(9600)
BYTE_NS = F38400.span_ns(1)


class SampledLine(SerialLine):
    """A line that looks at every bit, always."""

    def _undisturbed_until(self, current: Transmission, limit_ns: int) -> int:
        return min(limit_ns, current.start_ns - 1)

    def _is_in_step(self, first: Transmission, clash_ns: int | None) -> bool:
        return False


def listen(line: SerialLine, until_ns: int, most: int = 10**9, *, drops_bad: bool = True) -> Heard:
    """Let time pass and note who hears what when, taking ``most`` bytes at a time.

    Devices drop bad characters unless told otherwise.
    """
    heard: Heard = []
    while (offer := line.offer(until_ns)) is not None:
        chunk, stations = offer
        count = min(most, len(chunk.data))
        line.accept(count)
        assert HOST not in stations or not chunk.errors
        for index in range(count):
            if drops_bad and index in chunk.errors:
                continue
            assert chunk.arrival_ns(index) <= until_ns
            heard += [(chunk.arrival_ns(index), each, chunk.data[index]) for each in stations]
        assert line.now_ns <= until_ns
    assert line.now_ns == until_ns
    return heard


def bytes_at(heard: Heard, station: int) -> bytes:
    """What ``station`` heard."""
    return bytes(value for _, each, value in heard if each == station)


# -- one sender --


def test_bytes_arrive_one_character_after_another() -> None:
    """The end of byte i lies i + 1 characters after the start, for every listener."""
    line = SerialLine([F38400, F38400, F38400], 1000)
    line.transmit(HOST, 1000, b"abc")
    assert listen(line, 10**9) == [
        (1000 + 260416, 1, ord("a")),
        (1000 + 260416, 2, ord("a")),
        (1000 + 520833, 1, ord("b")),
        (1000 + 520833, 2, ord("b")),
        (1000 + 781250, 1, ord("c")),
        (1000 + 781250, 2, ord("c")),
    ]


@pytest.mark.strength
def test_a_million_bytes_queued_one_by_one_do_not_drift() -> None:
    """A stretch that is continued for ever keeps its exact times, and its past is forgotten."""
    line = SerialLine([F38400, F38400])
    last_ns = count = most_held = 0
    for _ in range(1000):
        for _ in range(1000):
            line.transmit(HOST, 0, b"U")
        while (offer := line.offer(line.sent_ns(HOST) - 1)) is not None:
            line.accept(len(offer[0].data))
            last_ns = offer[0].arrival_ns(len(offer[0].data) - 1)
            count += len(offer[0].data)
        most_held = max(most_held, line.bytes_held)
    assert count == 999_999
    assert last_ns == 999_999 * 10 * 10**9 // 38400
    assert most_held < 20_000


def test_a_station_sends_one_thing_after_the_other() -> None:
    """What is queued while a station sends follows without a gap; a later start is kept."""
    line = SerialLine([F38400, F38400])
    line.transmit(1, 500, b"ab")
    line.transmit(1, 600, b"c")
    line.transmit(1, 5_000_000, b"d")
    assert [time for time, _, _ in listen(line, 10**9)] == [
        500 + F38400.span_ns(1),
        500 + F38400.span_ns(2),
        500 + F38400.span_ns(3),
        5_000_000 + F38400.span_ns(1),
    ]


def test_a_format_counts_from_the_bytes_queued_next() -> None:
    """Bytes queued before the change go out as they were meant."""
    line = SerialLine([F38400, F38400, F9600])
    line.transmit(HOST, 0, b"fast")
    line.set_format(HOST, F9600)
    line.transmit(HOST, 0, b"slow")
    assert line.sent_ns(HOST) == F38400.span_ns(4) + F9600.span_ns(4)
    assert bytes_at(listen(line, 10**8), 1)[:4] == b"fast"
    line.transmit(HOST, 2 * 10**8, b"slow")
    assert bytes_at(listen(line, 10**9), 2)[-4:] == b"slow"


@pytest.mark.parametrize(
    "line_format",
    [
        LineFormat(9600, 7, "E"),
        LineFormat(19200, 8, "E"),
        LineFormat(38400, 8, "O", 4),
        LineFormat(300, 5, "N", 3),
        LineFormat(115200, 7, "M"),
        LineFormat(57600, 6, "S", 4),
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", [SerialLine, SampledLine])
def test_every_byte_passes_in_every_format(line_format: LineFormat, kind: type[SerialLine]) -> None:
    """Equal formats understand each other, by bits or by stretches; surplus bits are not sent."""
    line = kind([line_format, line_format])
    line.transmit(HOST, 0, bytes(range(256)))
    heard = listen(line, 10**11)
    mask = (1 << line_format.data_bits) - 1
    assert bytes_at(heard, 1) == bytes(value & mask for value in range(256))
    assert [time for time, _, _ in heard] == [line_format.span_ns(n + 1) for n in range(256)]


# -- formats that differ --


@pytest.mark.parametrize("percent", [-2, -1, 1, 2])
def test_rates_within_two_percent_understand_each_other(percent: int) -> None:
    """The sampling itself tolerates it; no rule says so."""
    line = SerialLine([F38400, LineFormat(38400 * (100 + percent) // 100)])
    line.transmit(HOST, 0, bytes(range(256)))
    assert bytes_at(listen(line, 10**9), 1) == bytes(range(256))


def test_8n1_and_8n2_understand_each_other() -> None:
    """Nobody looks at a second stop bit."""
    line = SerialLine([LineFormat(38400, 8, "N", 4), F38400])
    line.transmit(HOST, 0, b"hello")
    assert bytes_at(listen(line, 10**9), 1) == b"hello"


def test_a_format_may_change_right_before_the_first_start_bit() -> None:
    """Having looked ahead does not fix what is heard."""
    line = SerialLine([F38400, F38400])
    line.transmit(HOST, 0, b"hello")
    assert line.next_arrival() == BYTE_NS
    line.set_format(1, F9600)
    assert bytes_at(listen(line, 10**9), 1) != b"hello"


@pytest.mark.parametrize(("sender", "receiver"), [(F9600, F38400), (F38400, F9600)])
def test_wrong_rates_garble_the_same_way_each_time(
    sender: LineFormat, receiver: LineFormat
) -> None:
    """A request at the wrong rate is not recognisable, and always the same garbage."""
    request = b"\x02014002000000000" + b"00000A2\x03"
    results = []
    for _ in range(2):
        line = SerialLine([receiver, sender, receiver])
        line.transmit(1, 0, request)
        results.append(listen(line, 10**9))
    assert results[0] == results[1]
    assert bytes_at(results[0], HOST)
    for station in (HOST, 2):
        assert b"\x02014" not in bytes_at(results[0], station)


def test_wrong_parity_is_dropped_by_a_device_and_nul_at_the_host() -> None:
    """Every second byte of even weight fails under odd parity."""
    even, odd = LineFormat(9600, 8, "E"), LineFormat(9600, 8, "O")
    line = SerialLine([even, odd])
    line.transmit(HOST, 0, b"abc")
    assert listen(line, 10**8) == []
    line.transmit(1, 10**8, b"abc")
    assert bytes_at(listen(line, 10**9), HOST) == b"\0\0\0"


def test_a_parity_bit_is_a_bad_or_good_stop_bit_to_one_who_expects_none() -> None:
    """8E1 into 8N1: bytes of odd weight pass (parity is mark), of even weight fail."""
    line = SerialLine([LineFormat(9600, 8, "E"), F9600])
    line.transmit(HOST, 0, b"\x07")
    line.transmit(HOST, 10**8, b"\x03")
    assert bytes_at(listen(line, 10**9), 1) == b"\x07"


def test_a_bad_character_is_handed_over_as_sampled_and_told() -> None:
    """It stands among the good ones, at its place and time."""
    line = SerialLine([LineFormat(9600, 8, "E"), F9600])
    line.transmit(HOST, 0, b"\x07\x03\x07")
    offer = line.offer(10**9)
    assert offer is not None
    chunk, stations = offer
    assert (chunk.data[:2], chunk.errors[:1], stations) == (b"\x07\x03", (1,), (1,))
    assert chunk.arrival_ns(1) == 21 * 10**9 // 9600  # bits
    assert (chunk.without_errors().data[:2], chunk.with_nul().data[:2]) == (b"\x07\x07", b"\x07\0")


def test_a_receiver_that_changes_its_rate_gets_back_in_step_at_the_next_gap() -> None:
    """A character under way is lost, what follows a rest of the line is whole."""
    line = SerialLine([F38400, F9600])
    line.transmit(HOST, 0, b"\0" * 10)
    listen(line, 5 * BYTE_NS + BYTE_NS // 2)
    line.set_format(1, F38400)
    line.transmit(HOST, 10**8, b"clean")
    assert bytes_at(listen(line, 10**9), 1)[-5:] == b"clean"
    assert line.transmissions_held == 0


# -- overlaps --


def test_two_who_answer_at_once_are_heard_as_garbage() -> None:
    """Space dominates; stations that drive hear nothing of one another."""
    line = SerialLine([F38400] * 4)
    line.transmit(1, 1000, b"\x06\x13\x02012345\x1a")
    line.transmit(2, 1000 + 40_000, b"\x06\x13\x02012345\x1a")
    heard = listen(line, 10**9)
    assert bytes_at(heard, HOST) != b"\x06\x13\x02012345\x1a"
    assert bytes_at(heard, HOST)
    for station in (1, 2):  # at most a last byte that the other had not finished
        assert len(bytes_at(heard, station)) <= 1


def test_answers_that_coincide_to_the_nanosecond_combine_bit_by_bit() -> None:
    """What is space in either byte is space on the line."""
    line = SerialLine([F38400] * 3)
    line.transmit(1, 0, b"\xf3\x55")
    line.transmit(2, 0, b"\x3f\x0f")
    assert bytes_at(listen(line, 10**9), HOST) == b"\x33\x05"


def test_listeners_hear_a_collision_in_the_order_of_stations() -> None:
    """At one nanosecond the lower station comes first, also when bits are sampled."""
    line = SerialLine([F38400] * 5)
    line.transmit(1, 0, b"\xf3")
    line.transmit(3, 0, b"\x3f")
    assert [station for _, station, _ in listen(line, 10**9)] == [0, 2, 4]


@pytest.mark.parametrize("kind", [SerialLine, SampledLine])
def test_a_glitch_behind_the_last_sample_is_a_start_bit(kind: type[SerialLine]) -> None:
    """A nanosecond of space in the last half of a stop bit shifts all that follows."""
    line = kind([F38400] * 3)
    line.transmit(HOST, 0, b"\0\0\0\0")
    sample_ns = 19 * 10**9 // (2 * 38400)
    heard = listen(line, sample_ns + 1)
    line.transmit(1, 0, b"x")
    heard += listen(line, sample_ns + 2)
    line.switch_off(1)
    heard += listen(line, 10**9)
    assert [time for time, station, _ in heard if station == 2][:2] == [
        BYTE_NS,
        sample_ns + 1 + BYTE_NS,
    ]


def test_a_station_is_deaf_while_it_drives() -> None:
    """What arrives meanwhile is lost; what begins afterwards is heard."""
    line = SerialLine([F38400] * 2)
    line.transmit(HOST, 0, b"U" * 4)
    line.transmit(1, 0, b"U")
    line.transmit(HOST, 10**8, b"ok")
    heard = listen(line, 10**9)
    assert bytes_at(heard, HOST) == b""
    assert bytes_at(heard, 1)[-5:] == b"UUUok"


def test_bytes_complete_before_an_overlap_are_whole() -> None:
    """A byte whose last nanosecond is that of the overlap's first is heard as sent."""
    line = SerialLine([F38400] * 3)
    line.transmit(HOST, 0, b"abc")
    line.transmit(2, F38400.span_ns(2), b"\0")
    heard = listen(line, 10**9)
    assert bytes_at(heard, 1)[:2] == b"ab"
    assert bytes_at(heard, 1)[2:] == b"\0"


def test_a_stretch_is_clean_again_after_an_overlap() -> None:
    """A long stretch hit by one byte is soon handed over without looking at bits again."""
    line = SerialLine([F38400] * 3)
    line.transmit(HOST, 0, b"UUUU" + bytes(range(256)) * 40)
    line.transmit(2, 3 * BYTE_NS + 7, b"x")
    chunks = []
    while (offer := line.offer(10**10)) is not None:
        line.accept(len(offer[0].data))
        chunks.append(len(offer[0].data))
    assert max(chunks) > 1000
    assert sum(1 for each in chunks if each == 1) < 60


# -- breaks, supply, purge --


def test_a_break_drops_at_a_device_and_is_one_nul_at_the_host() -> None:
    """However long it lasts, a break is one bad character."""
    for milliseconds in (1, 250):
        line = SerialLine([F38400] * 3)
        line.send_break(1, 0, milliseconds * 1_000_000)
        line.transmit(1, 0, b"ok")
        heard = listen(line, 10**9)
        assert bytes_at(heard, HOST) == b"\0ok"
        assert bytes_at(heard, 2) == b"ok"
        rest_ns = 10**9 // 38400
        assert heard[-1][0] == milliseconds * 1_000_000 + rest_ns + F38400.span_ns(2)


def test_a_break_shorter_than_half_a_bit_is_a_glitch() -> None:
    """No character starts from it."""
    line = SerialLine([F38400] * 2)
    line.send_break(1, 0, 12_000)
    line.transmit(1, 0, b"ok")
    assert bytes_at(listen(line, 10**9), HOST) == b"ok"


@pytest.mark.parametrize("kind", [SerialLine, SampledLine])
def test_a_byte_breaks_off_where_the_supply_fails(kind: type[SerialLine]) -> None:
    """The driver lets go: the rest of the byte reads mark, and nothing follows."""
    line = kind([F38400] * 2)
    line.transmit(1, 0, b"a\0b")
    heard = listen(line, BYTE_NS + BYTE_NS // 2)  # start bit and four data bits of the second
    line.switch_off(1)
    assert line.sent_ns(1) == line.now_ns
    heard += listen(line, 10**9)
    assert bytes_at(heard, HOST) == b"a\xf0"
    assert line.transmissions_held == 0


def test_a_supply_that_fails_between_two_bytes_harms_neither() -> None:
    """At the very end of a byte nothing is left to break off."""
    line = SerialLine([F38400] * 2)
    line.transmit(1, 0, b"ab")
    heard = listen(line, BYTE_NS)
    line.switch_off(1)
    heard += listen(line, 10**9)
    assert bytes_at(heard, HOST) == b"a"
    assert line.transmissions_held == 0


def test_a_station_without_supply_neither_hears_nor_sends() -> None:
    """Until it is switched on again; a byte that is half over then is not heard as sent."""
    line = SerialLine([F38400] * 2)
    line.switch_off(1)
    line.transmit(1, 0, b"x")
    line.transmit(HOST, 0, b"U\xff\xff\xff")
    assert listen(line, BYTE_NS + BYTE_NS // 2) == []
    line.switch_on(1)
    heard = listen(line, 10**9)
    assert bytes_at(heard, 1) == b"\xff\xff"


def test_purging_finishes_the_byte_on_the_line_and_drops_the_rest() -> None:
    """A byte whose start bit has begun cannot be called back."""
    line = SerialLine([F38400] * 2)
    line.transmit(HOST, 0, b"abc")
    line.transmit(HOST, 10**8, b"later")
    heard = listen(line, BYTE_NS + 1)
    assert line.backlog(HOST) == 6
    line.purge(HOST)
    assert line.backlog(HOST) == 0
    assert line.sent_ns(HOST) == F38400.span_ns(2)
    line.transmit(HOST, 0, b"d")
    heard += listen(line, 10**9)
    assert bytes_at(heard, 1) == b"abd"
    assert heard[-1][0] == F38400.span_ns(3)


def test_purging_before_the_first_start_bit_leaves_nothing() -> None:
    """Bytes queued at this very nanosecond are not on the line yet."""
    line = SerialLine([F38400] * 2)
    line.transmit(HOST, 0, b"abc")
    line.purge(HOST)
    assert line.transmissions_held == 0
    assert line.sent_ns(HOST) == 0


# -- an independent reading, and every way of driving --


some_formats = st.lists(
    st.sampled_from([F38400, F38400, F38400, F9600, LineFormat(39000), LineFormat(38400, 7, "E")]),
    min_size=2,
    max_size=4,
)
some_bytes = st.binary(min_size=1, max_size=6)
some_sent = st.lists(
    st.builds(Sent, st.integers(0, 3), st.integers(0, 8 * BYTE_NS), some_bytes), max_size=5
)


def without_queueing(formats: Sequence[LineFormat], sent: list[Sent]) -> list[Sent]:
    """Those that begin when their station is free: queueing has tests of its own."""
    free = [0] * len(formats)
    kept = []
    for each in sorted(sent, key=lambda item: item.start_ns):
        if each.station < len(formats) and each.start_ns >= free[each.station]:
            kept.append(each)
            free[each.station] = each.start_ns + formats[each.station].span_ns(len(each.data)) + 1
    return kept


@pytest.mark.strength
@settings(max_examples=300)
@given(some_formats, some_sent)
@example([F38400, F9600], [Sent(0, 0, b"z\0\0\0\x10")])  # samples fall exactly on edges
def test_everybody_hears_what_exact_arithmetic_says(
    formats: list[LineFormat], sent: list[Sent]
) -> None:
    """Overlaps, wrong rates, deafness: equal to intervals of fractions, to the nanosecond."""
    sent = without_queueing(formats, sent)
    line = SerialLine(formats)
    for each in sent:
        line.transmit(each.station, each.start_ns, each.data)
    assert sorted(listen(line, 10**9)) == reference(formats, sent)
    assert line.transmissions_held == 0


Action = Callable[[SerialLine], None]


def _action(kind: int, station: int, data: bytes, line_format: LineFormat, ahead_ns: int) -> Action:
    def act(line: SerialLine) -> None:
        if kind <= 3:
            line.transmit(station, line.now_ns + ahead_ns * (kind % 2), data)
        elif kind == 4:
            line.set_format(station, line_format)
        elif kind == 5:
            line.switch_off(station)
        elif kind == 6:
            line.switch_on(station)
        elif kind == 7:
            line.purge(station)
        else:
            line.send_break(station, line.now_ns, 1 + ahead_ns)

    return act


actions = st.lists(
    st.tuples(
        st.integers(0, 4 * BYTE_NS),
        st.builds(
            _action,
            st.integers(0, 8),
            st.integers(0, 2),
            st.binary(min_size=1, max_size=12),
            st.sampled_from([F38400, F38400, F9600, LineFormat(38400, 8, "E")]),
            st.integers(0, 3 * BYTE_NS),
        ),
    ),
    max_size=10,
)


def play(line: SerialLine, script: list[tuple[int, Action]], stops: list[int], most: int) -> Heard:
    """Do what ``script`` says (waits and actions), pausing at ``stops`` as well."""
    heard: Heard = []
    at_ns = 0
    for wait_ns, act in script:
        for stop in sorted(stops):
            if line.now_ns < stop < at_ns + wait_ns:
                heard += listen(line, stop, most)
        at_ns += wait_ns
        heard += listen(line, at_ns, most)
        act(line)
    return sorted(heard + listen(line, at_ns + 10**9, most))


@pytest.mark.strength
@settings(max_examples=400)
@given(actions, st.lists(st.integers(0, 40 * BYTE_NS), max_size=12), st.integers(1, 5))
def test_stretches_and_bits_give_the_same_bytes_at_the_same_nanoseconds(
    script: list[tuple[int, Action]], stops: list[int], most: int
) -> None:
    """However time is cut up, however many bytes are taken, by stretches or by bits."""
    plain = SerialLine([F38400] * 3)
    expected = play(plain, script, [], 10**9)
    assert play(SerialLine([F38400] * 3), script, stops, most) == expected
    assert play(SampledLine([F38400] * 3), script, stops, most) == expected
    assert plain.transmissions_held == 0


@pytest.mark.strength
@settings(max_examples=200)
@given(actions, st.integers(0, 2), st.lists(st.integers(0, 4 * BYTE_NS), max_size=3))
def test_the_next_arrival_is_foretold(
    script: list[tuple[int, Action]], station: int, waits: list[int]
) -> None:
    """As long as nobody does anything, the next byte comes just when it was announced."""
    line = SerialLine([F38400] * 3)
    for wait_ns, act in script:
        listen(line, line.now_ns + wait_ns)
        act(line)
    for wait_ns in waits:
        listen(line, line.now_ns + wait_ns)
    expected = line.next_arrival_at(station)
    anything = line.next_arrival()
    heard = listen(line, line.now_ns + 10**9, drops_bad=False)
    own = [time for time, each, _ in heard if each == station]
    if line._is_on[station]:
        assert expected == (own[0] if own else None)
    assert (
        (anything is None and not heard)
        or (anything is not None and not heard)
        or (anything is not None and anything <= heard[0][0])
    )


@pytest.mark.strength
def test_memory_stays_flat_while_one_talks_and_another_interrupts_for_ever() -> None:
    """History is dropped as soon as no receiver needs it."""
    line = SerialLine([F38400, F38400, F9600])
    most_held = most_bytes = 0
    for round_number in range(300):
        line.transmit(HOST, 0, bytes(range(40)))
        line.transmit(1, line.now_ns + 5 * BYTE_NS + round_number, b"xyz")
        listen(line, line.sent_ns(HOST) - BYTE_NS // 3)
        most_held = max(most_held, line.transmissions_held)
        most_bytes = max(most_bytes, line.bytes_held)
    assert most_held <= 4
    assert most_bytes < 10_000
