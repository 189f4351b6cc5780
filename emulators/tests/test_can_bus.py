"""The CAN bus: one order for all, arbitration, acknowledgement, collisions and error counters."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from axistwin.wire.can_bus import CanBus, Change, Fault, Happening, Heard
from axistwin.wire.can_frame import CanFrame, arbitration_key, stuffed_bits, wire_bits

BIT = 2000  # ns at 500 kbit/s
S = 1_000_000_000


def bus_of(count: int, bitrate: int | None = 500_000) -> CanBus:
    """A bus with that many stations, 0 and up."""
    bus = CanBus(bitrate)
    for number in range(count):
        assert bus.attach(0) == number
    return bus


def heard(happened: list[Happening]) -> list[Heard]:
    """What of it was frames."""
    return [each for each in happened if isinstance(each, Heard)]


def faults(happened: list[Happening]) -> list[Fault]:
    """What of it was error frames."""
    return [each for each in happened if isinstance(each, Fault)]


LOW, HIGH = CanFrame(0x081, b"\1"), CanFrame(0x581, b"12345678")

# ---- order ----


def test_a_frame_is_heard_by_all_others_when_its_last_bit_is_over() -> None:
    """And its sender learns it at the same time."""
    bus = bus_of(3)
    bus.offer(1, HIGH, 5000)
    assert bus.next_event() == 5000
    assert bus.run_until(S) == [Heard(5000 + wire_bits(HIGH) * BIT, HIGH, (1,), (0, 2))]
    assert bus.next_event() is None
    assert bus.backlog(1) == 0


def test_the_next_frame_begins_after_the_intermission() -> None:
    """Three bits lie between frames that wait."""
    bus = bus_of(2)
    bus.offer(0, HIGH, 0)
    bus.offer(0, LOW, 0)
    first, second = heard(bus.run_until(S))
    assert (first.frame, second.frame) == (HIGH, LOW)  # a station keeps its own order
    assert second.end_ns - first.end_ns == (3 + wire_bits(LOW)) * BIT


def test_of_frames_that_wait_the_lowest_identifier_goes_first() -> None:
    """Whoever was first to be ready."""
    bus = bus_of(4)
    bus.offer(0, CanFrame(0x700), 0)
    for number, identifier in ((1, 0x583), (2, 0x581), (3, 0x582)):
        bus.offer(number, CanFrame(identifier), number)
    order = [each.frame.identifier for each in heard(bus.run_until(S))]
    assert order == [0x700, 0x581, 0x582, 0x583]


def test_a_frame_that_is_not_ready_yet_lets_others_pass() -> None:
    """Until then it does not compete, and what its station sends later waits behind it."""
    bus = bus_of(3)
    bus.offer(0, LOW, S)
    bus.offer(0, CanFrame(0), 0)
    bus.offer(1, HIGH, 0)
    first, second, third = heard(bus.run_until(2 * S))
    assert (first.frame, second.frame, third.frame) == (HIGH, LOW, CanFrame(0))
    assert second.end_ns == S + wire_bits(LOW) * BIT


frame_lists = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 0x7FF), st.binary(max_size=8), st.integers(0, 900)),
    max_size=25,
)


@pytest.mark.strength
@given(frame_lists, st.sampled_from([None, 125_000, 500_000, 1_000_000, 83_333]))
def test_every_frame_is_heard_once_by_each_other_station_in_one_order(
    offers: list[tuple[int, int, bytes, int]], bitrate: int | None
) -> None:
    """Nothing is lost or doubled, a station's own order stays, frames do not overlap."""
    bus = bus_of(5, bitrate)
    sent: dict[int, list[CanFrame]] = {number: [] for number in range(5)}
    for number, identifier, data, ready_us in offers:
        frame = CanFrame(identifier * 5 % 0x7FD + number % 3, data)  # collisions happen
        sent[number].append(frame)
        bus.offer(number, frame, ready_us * 1000)
    end, told = 0, heard(bus.run_until(10 * S))
    got: dict[int, list[CanFrame]] = {number: [] for number in range(5)}
    for each in told:
        assert each.end_ns - end >= bus.span_ns(wire_bits(each.frame))
        end = each.end_ns
        assert each.listeners
        assert not {*each.senders} & {*each.listeners}
        for number in each.senders:
            got[number].append(each.frame)
    assert got == sent
    assert bus.next_event() is None


def test_without_a_bit_rate_frames_take_no_time_but_keep_their_order() -> None:
    """Arbitration among those that are ready together, at their own time."""
    bus = bus_of(4, None)
    for number, identifier in ((1, 0x583), (2, 0x581), (3, 0x582)):
        bus.offer(number, CanFrame(identifier), 77)
        bus.offer(number, CanFrame(identifier + 0x10), 77)
    told = heard(bus.run_until(S))
    assert [each.frame.identifier for each in told] == [0x581, 0x582, 0x583, 0x591, 0x592, 0x593]
    assert {each.end_ns for each in told} == {77}


def test_reactions_take_part_in_the_next_arbitration() -> None:
    """Who drives the bus is asked after every frame."""
    bus = bus_of(3)
    bus.offer(0, HIGH, 0)
    bus.offer(1, CanFrame(0x700), 0)
    first = heard(bus.run_next(S))[0]
    bus.offer(2, LOW, first.end_ns)
    assert heard(bus.run_next(S))[0].frame == LOW


# ---- coming and going ----


def test_who_comes_during_a_frame_does_not_hear_it() -> None:
    """It hears the next one."""
    bus = bus_of(2)
    bus.offer(0, HIGH, 0)
    assert bus.run_until(BIT) == []
    late = bus.attach(BIT)
    bus.offer(0, LOW, 0)
    first, second = heard(bus.run_until(S))
    assert first.listeners == (1,)
    assert second.listeners == (1, late)


def test_a_sender_that_leaves_breaks_its_frame_off() -> None:
    """The others see an error, and nothing of the frame."""
    bus = bus_of(3)
    bus.offer(0, HIGH, 0)
    bus.run_until(10 * BIT)
    bus.leave(0, 10 * BIT)
    bus.offer(1, LOW, 0)
    broken, next_frame = bus.run_until(S)
    assert broken == Fault(30 * BIT, "stuff", ())
    assert next_frame == Heard((33 + wire_bits(LOW)) * BIT, LOW, (1,), (2,))
    assert bus.counters(2) == (0, 0)  # one error, one good frame


def test_what_is_withdrawn_is_not_sent() -> None:
    """A frame that is on the bus is finished."""
    bus = bus_of(2)
    bus.offer(0, HIGH, 0)
    bus.offer(0, LOW, 0)
    bus.run_until(BIT)
    bus.withdraw(0, BIT)
    assert bus.backlog(0) == 1
    assert [each.frame for each in heard(bus.run_until(S))] == [HIGH]


# ---- nobody acknowledges ----


def test_a_lone_station_repeats_and_becomes_passive_but_never_off() -> None:
    """Sixteen errors of 8; then the counter stays, and the bus sleeps although it sends."""
    bus = bus_of(1)
    bus.offer(0, HIGH, 0)
    told = bus.run_until(1000 * S)
    assert [each.kind for each in faults(told)] == ["ack"] * 17
    assert bus.counters(0) == (128, 0)
    assert bus.state(0) == "passive"
    assert bus.next_event() is None
    active = wire_bits(HIGH) - 8 + 6 + 8
    assert [each.end_ns for each in faults(told)[:2]] == [active * BIT, (2 * active + 3) * BIT]
    assert [each.time_ns for each in told if isinstance(each, Change)] == [
        (16 * active + 15 * 3) * BIT
    ]


@pytest.mark.parametrize("offset_bits", [0, 1, 60, 117, 500, 12_345_678])
def test_the_repeated_frame_is_heard_by_the_first_who_comes(offset_bits: int) -> None:
    """From the attempt on that begins after it has come; the attempts before are not stepped."""
    bus = bus_of(1)
    bus.offer(0, HIGH, 0)
    told = bus.run_until(S)
    last = faults(told)[-1].end_ns
    period = (wire_bits(HIGH) - 8 + 14 + 3 + 8) * BIT
    first_start = last + 11 * BIT
    come = S + offset_bits * BIT
    bus.attach(come)
    (end_ns,) = [each.end_ns for each in heard(bus.run_until(come + S))]
    start = end_ns - wire_bits(HIGH) * BIT
    assert (start - first_start) % period == 0
    assert come <= start < come + period
    assert bus.counters(0) == (127, 0)
    assert bus.state(0) == "active"


def test_a_lone_station_without_a_bit_rate_waits_for_company() -> None:
    """No time passes, and the bus does not turn in circles."""
    bus = bus_of(1, None)
    bus.offer(0, HIGH, 5)
    assert len(faults(bus.run_until(5))) == 17
    assert bus.next_event() is None
    bus.attach(9)
    assert [each.end_ns for each in heard(bus.run_until(9))] == [9]


@pytest.mark.parametrize("bitrate", [125_000, None])
def test_who_only_listens_is_no_company(bitrate: int | None) -> None:
    """It hears nothing, since no frame succeeds, until it acknowledges."""
    bus = bus_of(1, bitrate)
    bus.set_acknowledging(bus.attach(0), 0, acknowledges=False)
    bus.offer(0, HIGH, 0)
    assert heard(bus.run_until(S)) == []
    assert bus.next_event() is None  # asleep
    bus.set_acknowledging(1, S, acknowledges=True)
    (frame,) = heard(bus.run_until(2 * S))
    assert frame.listeners == (1,)


def test_who_only_listens_hears_what_others_acknowledge() -> None:
    """With a third station on the bus frames succeed, for the listener too."""
    bus = bus_of(3)
    bus.set_acknowledging(1, 0, acknowledges=False)
    bus.offer(0, HIGH, 0)
    assert [each.listeners for each in heard(bus.run_until(S))] == [(1, 2)]


@pytest.mark.parametrize("leaves", [False, True])
def test_a_frame_fails_when_the_last_to_acknowledge_goes_meanwhile(leaves: bool) -> None:
    """And is repeated for the next who comes."""
    bus = bus_of(2)
    bus.offer(0, HIGH, 0)
    bus.run_until(20 * BIT)
    if leaves:
        bus.leave(1, 20 * BIT)
    else:
        bus.set_acknowledging(1, 20 * BIT, acknowledges=False)
    told = bus.run_until(S)
    first = faults(told)[0]
    assert (first.kind, first.end_ns) == ("ack", (wire_bits(HIGH) - 8 + 6 + 8) * BIT)
    assert heard(told) == []
    bus.attach(S)
    assert len(heard(bus.run_until(2 * S))) == 1


def test_withdrawing_ends_the_endless_repetition() -> None:
    """After the attempt that is under way the bus is idle."""
    bus = bus_of(1)
    bus.offer(0, HIGH, 0)
    bus.run_until(S)
    bus.withdraw(0, S)
    bus.attach(S)
    assert heard(bus.run_until(2 * S)) == []
    assert bus.next_event() is None
    bus.offer(0, LOW, 2 * S)
    assert heard(bus.run_until(3 * S))[0].end_ns == 2 * S + wire_bits(LOW) * BIT


# ---- two stations with one identifier ----

MINE, THEIRS = CanFrame(0x581, b"\x42\0\x20\0\0\0\0\1"), CanFrame(0x581, b"\x42\0\x20\0\0\0\0\3")
"""They differ in one bit of the last byte: MINE is dominant there."""


def test_equal_frames_succeed_at_once_and_are_heard_once() -> None:
    """Nothing tells the listeners that there were two."""
    bus = bus_of(3)
    bus.offer(0, MINE, 0)
    bus.offer(2, MINE, 0)
    assert bus.run_until(S) == [Heard(wire_bits(MINE) * BIT, MINE, (0, 2), (1,))]


def test_a_collision_is_repeated_until_both_are_passive_then_one_wins() -> None:
    """Sixteen error frames; then the recessive one's flag disturbs nobody (Cho and Shin 2016)."""
    bus = bus_of(3)
    bus.offer(0, THEIRS, 0)
    bus.offer(1, MINE, 0)
    told = bus.run_until(S)
    assert [each.kind for each in faults(told)] == ["bit"] * 16
    first, second = heard(told)
    assert (first.frame, first.senders, first.listeners) == (MINE, (1,), (2,))
    assert (second.frame, second.senders, second.listeners) == (THEIRS, (0,), (1, 2))
    # Its flag ends with bit 5 of EOF; 8 bits of delimiter, 3 of intermission, 8 of suspension.
    start = second.end_ns - wire_bits(THEIRS) * BIT
    assert start - first.end_ns == (-2 + 8 + 3 + 8) * BIT
    assert bus.counters(1) == (127, 0)
    assert bus.counters(0) == (128 + 8 - 1, 0)
    assert bus.counters(2) == (0, 14)


def test_an_error_frame_has_the_length_that_its_flags_give() -> None:
    """The bit in error, flags of all who see it, delimiter and intermission."""
    bus = bus_of(3)
    bus.offer(0, THEIRS, 0)
    bus.offer(1, MINE, 0)
    mine, theirs = stuffed_bits(MINE), stuffed_bits(THEIRS)
    at = next(i for i, (a, b) in enumerate(zip(mine, theirs, strict=False)) if a != b)
    dominant = len(mine[: at + 1]) - len(mine[: at + 1].rstrip("0"))
    last_flag_bit = at + 12 - dominant
    ends = [each.end_ns // BIT for each in faults(bus.run_until(S))]
    length = last_flag_bit + 1 + 8
    assert ends == [length + count * (length + 3) for count in range(16)]


class Controller:
    """One error-active controller, bit by bit: sends a stream or listens, flags what is wrong."""

    def __init__(self, stream: str | None, stuffed: int) -> None:
        self.stream = stream
        self.ack_slot = stuffed + 1
        self.flag = self.delimiter = self.run = 0
        self.last = ""
        self.is_wrong = False

    def output(self, at: int, acknowledges: bool) -> str:
        """What it puts on the bus."""
        if self.is_wrong:
            return "0" if self.flag < 6 else "1"
        if self.stream is None:
            return "0" if acknowledges and at == self.ack_slot else "1"
        return self.stream[at] if at < len(self.stream) else "1"

    def sample(self, at: int, bus: str, own: str) -> None:
        """Look at the bus: bit errors, a missing acknowledgement, six equal bits."""
        if self.is_wrong:
            if self.flag < 6:
                self.flag += 1
            elif bus == "1":
                self.delimiter += 1
            return
        self.run = self.run + 1 if bus == self.last else 1
        self.last = bus
        if self.stream is not None:
            self.is_wrong = (bus == own) if at == self.ack_slot else (bus != own)
        elif self.run == 6 and at < self.ack_slot:
            self.is_wrong = True


def bits_until_all_is_over(streams: list[str], listeners: int) -> int:
    """Play one attempt of active stations bit by bit; to the end of EOF or of the delimiter."""
    equal = len(set(streams)) == 1
    stuffed = len(streams[0])
    stations = [Controller(stream, stuffed if equal else 1000) for stream in streams]
    stations += [Controller(None, stuffed if equal else 1000) for _ in range(listeners)]
    for at in range(1000):
        outputs = [station.output(at, equal) for station in stations]
        for station, own in zip(stations, outputs, strict=True):
            station.sample(at, min(outputs), own)
        if all(station.delimiter == 8 for station in stations):
            return at + 1
        if not any(station.is_wrong for station in stations) and at + 1 == stuffed + 10:
            return at + 1
    raise AssertionError("without end")


@pytest.mark.strength
@given(
    st.lists(st.binary(max_size=8), min_size=1, max_size=3),
    st.integers(0, 2),
    st.sampled_from([0x000, 0x581, 0x7FF, 0x0F0]),
)
def test_each_first_attempt_takes_as_long_as_played_bit_by_bit(
    contents: list[bytes], listeners: int, identifier: int
) -> None:
    """Success, missing acknowledgement, collision: error frames to the bit."""
    frames = [CanFrame(identifier, data) for data in contents]
    bus = bus_of(len(frames) + listeners)
    for number, frame in enumerate(frames):
        bus.offer(number, frame, 0)
    first = bus.run_next(S)[0]
    assert isinstance(first, Heard | Fault)
    played = bits_until_all_is_over([stuffed_bits(frame) for frame in frames], listeners)
    assert first.end_ns == played * BIT


def test_two_alone_who_collide_take_turns_in_the_end() -> None:
    """Passive both: the loser drops out, the winner hears no acknowledgement, the loser's turn."""
    for bitrate in (500_000, None):
        bus = bus_of(2, bitrate)
        bus.offer(0, THEIRS, 0)
        bus.offer(1, MINE, 0)
        told = bus.run_until(S)
        assert [each.kind for each in faults(told)] == ["bit"] * 16 + ["ack"]
        assert [(each.frame, each.senders) for each in heard(told)] == [
            (THEIRS, (0,)),
            (MINE, (1,)),
        ]
        assert bus.next_event() is None


def collide_until_off(bus: CanBus) -> list[Happening]:
    """Requests that both answer, every 10 ms, until station 0 is off; what happened last."""
    for turn in range(40):
        now = turn * S // 100
        bus.offer(0, THEIRS, now)
        bus.offer(1, MINE, now)
        told = bus.run_until(now + S // 100 - 1)
        if any(isinstance(each, Change) and each.state == "off" for each in told):
            return told
    raise AssertionError("never off")


def test_a_station_that_always_loses_goes_off_and_comes_back() -> None:
    """+8 and -1 per request beyond the first, off above 255, back after 128 times 11 bits."""
    bus = bus_of(3)
    told = collide_until_off(bus)
    off = next(each for each in told if isinstance(each, Change) and each.state == "off")
    assert off.station == 0
    back = next(each for each in told if isinstance(each, Change) and each.time_ns > off.time_ns)
    assert back == Change(off.time_ns + (128 * 11 - 8) * BIT, 0, "active")
    assert heard(told)[-1].frame == THEIRS  # still to be sent, with a new controller
    assert bus.counters(0) == (0, 0)


def test_traffic_delays_the_return_from_bus_off() -> None:
    """Every frame lets one sequence of 11 recessive bits pass: delimiter, end, intermission."""
    bus, filler = bus_of(3), CanFrame(0x7FF, b"\x55" * 8)
    off = next(each for each in collide_until_off(bus) if isinstance(each, Change)).time_ns
    bus = bus_of(3)
    for _ in range(200):
        bus.offer(2, filler, off - 1)
    told = collide_until_off(bus) + bus.run_until(2 * S)
    changes = [each for each in told if isinstance(each, Change) and each.station == 0]
    gap_bits = 3 + 127 * (wire_bits(filler) + 3)
    assert changes[-1] == Change(off + gap_bits * BIT, 0, "active")
    assert [each.frame for each in heard(told)].index(THEIRS) == 128


def test_the_last_other_station_off_leaves_nobody_to_acknowledge_until_it_is_back() -> None:
    """The closed form of the repetition knows of the return, too."""
    for bitrate in (500_000, None):
        bus = bus_of(2, bitrate)
        offs = 0
        for turn in range(60):
            now = turn * S // 10
            bus.offer(0, THEIRS, now)
            bus.offer(1, MINE, now)
            told = bus.run_until(now + S // 10 - 1)
            assert len(faults(told)) <= 17 + 2  # what repeats itself is not stepped through
            offs += sum(isinstance(each, Change) and each.state == "off" for each in told)
            assert bus.next_event() is None
            assert bus.backlog(0) == bus.backlog(1) == 0
            assert bus.state(0) != "off"
        assert offs


def test_127_stations_that_begin_together_are_heard_in_the_order_of_their_identifiers() -> None:
    """Boot-up of a full bus: back to back, nobody lost."""
    bus = bus_of(128)
    numbers = list(range(1, 128))
    random.Random(1).shuffle(numbers)
    for number in numbers:
        bus.offer(number, CanFrame(0x700 + number, b"\0"), 2 * S)
    told = heard(bus.run_until(3 * S))
    assert [each.frame.identifier for each in told] == [0x700 + n for n in range(1, 128)]
    assert all(len(each.listeners) == 127 for each in told)
    bits = sum(wire_bits(each.frame) + 3 for each in told) - 3
    assert told[-1].end_ns == 2 * S + bits * BIT


@pytest.mark.strength
@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), min_size=2, max_size=6))
def test_who_begins_together_is_heard_by_arbitration(frames: list[tuple[int, bytes]]) -> None:
    """The keys never fall, as long as nobody has an identifier in common."""
    frames = list({identifier: (identifier, data) for identifier, data in frames}.values())
    bus = bus_of(len(frames) + 1)
    for number, (identifier, data) in enumerate(frames):
        bus.offer(number, CanFrame(identifier, data), 0)
    keys = [arbitration_key(each.frame) for each in heard(bus.run_until(S))]
    assert keys == sorted(keys)
    assert len(keys) == len(frames)


@pytest.mark.parametrize("bitrate", [None, 500_000, 125_000])
@pytest.mark.parametrize("seed", range(40))
def test_stations_may_come_go_and_collide_at_any_time(seed: int, bitrate: int | None) -> None:
    """Time never goes back, nothing hangs, and who stays gets everything through in the end."""
    chance = random.Random(seed)
    bus, now, last = bus_of(4, bitrate), 0, 0
    for _ in range(150):
        number = chance.randrange(4)
        action = chance.random()
        if not bus.is_attached(number):
            if action < 0.5:
                bus.join(number, now)
        elif action < 0.7:
            identifier = chance.choice((0x581, 0x581, 0x582, 0x080 + number))
            data = chance.choice((b"\1", b"\2", b"12345678"))
            bus.offer(
                number, CanFrame(identifier, data), now + chance.choice((0, 0, 1000, S // 50))
            )
        elif action < 0.75:
            bus.leave(number, now)
        elif action < 0.8:
            bus.withdraw(number, now)
        now += chance.choice((0, 0, 5 * BIT, 77 * BIT, 1234 * BIT, S // 10))
        for each in bus.run_until(now):
            at = each.time_ns if isinstance(each, Change) else each.end_ns
            assert last <= at <= now
            last = at
            if isinstance(each, Heard):
                assert not {*each.senders} & {*each.listeners}
        due = bus.next_event()
        assert due is None or due > now
        bus._knows_start = False
        assert due == bus.next_event(), "what it remembers is what it would find"
    for number in range(4):
        if not bus.is_attached(number):
            bus.join(number, now)
    bus.run_until(now + 60 * S)
    assert [bus.backlog(number) for number in range(4)] == [0] * 4
    assert bus.next_event() is None
