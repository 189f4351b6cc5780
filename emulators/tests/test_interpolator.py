"""The segment FIFO: no gap, no drift, no difference whether it is polled."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.motion.interpolator import Interpolator, Segment, Step, Underrun
from axistwin.motion.ramp import stop_pieces
from axistwin.motion.trajectory import TICK_NS, Leg, Piece, StepPhase

SETTINGS = settings(max_examples=100)
SEGMENTS = st.builds(Segment, st.integers(-20, 20), st.integers(1, 50), st.booleans())
LONG = Segment(1000, 1000)


@pytest.mark.parametrize(
    ("counts_executing", "accepted"), [(False, [1, 1, 1, 1, 0]), (True, [1, 1, 1, 0, 0])]
)
def test_a_burst_is_refused_when_the_fifo_is_full(
    counts_executing: bool, accepted: list[int]
) -> None:
    """MACS-AMB-37: three wait beside the executing segment, or two."""
    interpolator = Interpolator(counts_executing=counts_executing)
    assert [interpolator.offer(100 + i, LONG) for i in range(5)] == accepted


def test_a_stage_frees_on_the_tick_the_next_segment_is_taken() -> None:
    """MACS-CMD-16-02: refused a nanosecond before, accepted on the very tick."""
    interpolator = Interpolator()
    for _ in range(4):
        assert interpolator.offer(0, LONG)
    assert not interpolator.offer(LONG.duration_ns - 1, LONG)
    assert interpolator.offer(LONG.duration_ns, LONG)
    assert not interpolator.offer(LONG.duration_ns, LONG)


def test_example_of_a_virtual_segment() -> None:
    """§2.5: 1000 steps of 4096 ticks are 512 ms, in which nothing moves."""
    interpolator = Interpolator()
    assert interpolator.offer(7, Segment(1000, 4096, virtual=True))
    assert interpolator.end_ns == 7 + 512_000_000
    assert interpolator.displacement_at(600_000_000) == 0
    assert interpolator.is_executing(7 + 512_000_000 - 1)
    assert not interpolator.is_executing(7 + 512_000_000)


@pytest.mark.strength
@SETTINGS
@given(st.lists(SEGMENTS, min_size=1, max_size=4), st.sampled_from(StepPhase))
def test_stored_segments_run_without_gap_or_rounding(
    segments: list[Segment], step_phase: StepPhase
) -> None:
    """§5.6: step m of a segment counts exactly m periods after the end of the one before."""
    interpolator = Interpolator(step_phase=step_phase)
    for segment in segments:
        assert interpolator.offer(1000, segment)
    start_ns, displacement = 1000, 0
    for segment in segments:
        period_ns = segment.period_ticks * TICK_NS
        sign = 0 if segment.virtual else (segment.steps > 0) - (segment.steps < 0)
        early = step_phase is StepPhase.START
        for step in range(1, abs(segment.steps) + 1):
            instant = start_ns + (step - early) * period_ns
            assert interpolator.displacement_at(instant - 1) == displacement
            displacement += sign
            assert interpolator.displacement_at(instant) == displacement
        start_ns += segment.duration_ns
    assert interpolator.end_ns == start_ns
    assert interpolator.displacement_at(start_ns + 10**9) == displacement


@pytest.mark.strength
@SETTINGS
@given(st.lists(st.tuples(SEGMENTS, st.integers(0, 40_000)), max_size=12), st.data())
def test_polling_and_running_change_nothing(
    offers: list[tuple[Segment, int]], data: st.DataObject
) -> None:
    """The same offers give the same refusals and positions, however often one looks."""
    left_alone, polled = Interpolator(), Interpolator()
    now = 0
    for segment, pause_ns in offers:
        for _ in range(data.draw(st.integers(0, 3))):
            then = data.draw(st.integers(now, now + pause_ns))
            polled.displacement_at(then)
            if polled.next_event() is not None and polled.next_event() == then:
                polled.run(then)
        now += pause_ns
        polled.run(now)
        assert polled.stored_at(now) == left_alone.stored_at(now)
        assert polled.offer(now, segment) == left_alone.offer(now, segment)
        assert polled.displacement_at(now) == left_alone.displacement_at(now)
        assert polled.end_ns == left_alone.end_ns
        assert list(polled.legs(now)) == list(left_alone.legs(now))
        assert polled.leg_at(now) == left_alone.leg_at(now) == next(polled.legs(now))
        for way in (1, -1):
            starts = [leg.start_ns for leg in polled.legs(now) if leg.direction == way]
            assert polled.heads_ns(way, now) == (starts[0] if starts else None)
        assert polled.step_in_progress(now) == left_alone.step_in_progress(now)


def test_a_long_queue_does_not_drift() -> None:
    """MACS trap 25: 10 000 segments of odd periods end on the sum of their ticks."""
    interpolator = Interpolator()
    now = ticks = steps = 0
    for n in range(10_000):
        segment = Segment(n % 7 - 3, 3 + n % 13)
        if not interpolator.offer(now, segment):
            event = interpolator.next_event()
            assert event is not None
            now = event
            interpolator.run(now)
            while not interpolator.offer(now, segment):
                event = interpolator.next_event()
                assert event is not None
                now = event
                interpolator.run(now)
        ticks += abs(segment.steps) * segment.period_ticks
        steps += segment.steps
    assert interpolator.end_ns == ticks * TICK_NS
    assert interpolator.displacement_at(interpolator.end_ns) == steps


def test_next_event_is_each_segments_end() -> None:
    """One wake-up per segment; none when everything is over."""
    interpolator = Interpolator()
    assert interpolator.next_event() is None
    interpolator.offer(0, Segment(2, 8))
    interpolator.offer(0, Segment(-1, 8))
    assert interpolator.next_event() == 2000
    interpolator.run(2000)
    assert interpolator.next_event() == 3000
    interpolator.run(3000)
    assert interpolator.next_event() is None
    assert interpolator.displacement_at(3000) == 1


def test_no_steps_take_no_time() -> None:
    """MACS-AMB-39: consumed at once when idle; in the queue it waits for its turn."""
    interpolator = Interpolator()
    assert interpolator.offer(50, Segment(0, 9))
    assert interpolator.stored_at(50) == 0
    assert interpolator.end_ns == 50
    assert interpolator.offer(60, LONG)
    assert interpolator.offer(60, Segment(0, 9))
    assert interpolator.offer(60, LONG)
    assert interpolator.stored_at(60) == 2
    assert interpolator.stored_at(60 + LONG.duration_ns) == 0
    assert interpolator.end_ns == 60 + 2 * LONG.duration_ns


def test_an_underrun_halts_at_the_last_step() -> None:
    """MACS-AMB-40, halt: a later segment starts afresh when it is received."""
    interpolator = Interpolator()
    interpolator.offer(0, Segment(3, 8))
    assert interpolator.displacement_at(10_000) == 3
    assert interpolator.offer(10_000, Segment(-1, 8))
    assert interpolator.displacement_at(10_999) == 3
    assert interpolator.displacement_at(11_000) == 2
    assert list(interpolator.legs(2999)) == [
        Leg(0, 3000, 1, 8, 0),
        Leg(3000, 10_000, 0, 0, 3),
        Leg(10_000, 11_000, -1, 8, 3),
        Leg(11_000, None, 0, 0, 2),
    ]


def test_an_underrun_in_error_refuses_until_flushed() -> None:
    """MACS-AMB-40, error: just in time is in time; afterwards nothing is accepted."""
    interpolator = Interpolator(underrun=Underrun.ERROR)
    assert interpolator.offer(0, Segment(1, 8))
    assert interpolator.offer(1000, Segment(1, 8))
    assert not interpolator.has_failed(2000)
    assert not interpolator.offer(2001, Segment(1, 8))
    interpolator.run(2001)
    assert interpolator.has_failed(2001)
    interpolator.flush(3000)
    assert interpolator.offer(3000, Segment(1, 8))


def test_an_underrun_decelerates_by_the_pieces_given() -> None:
    """MACS-AMB-40, deceleration: the axis goes on down the ramp of the last speed."""
    interpolator = Interpolator(underrun=Underrun.DECELERATE)
    descent = stop_pieces(120, 800, 1)
    interpolator.offer(0, Segment(-100, 800), descent)
    end_ns = 100 * 800 * TICK_NS + sum((n or 0) * p for n, p in descent) * TICK_NS
    assert interpolator.end_ns == end_ns
    assert interpolator.displacement_at(end_ns) == -220
    assert interpolator.stored_at(0) == 0


def test_a_segment_in_time_prevents_the_deceleration() -> None:
    """A next segment on the very tick follows at once; one during the descent after its step."""
    descent = (Piece(2, 80), Piece(1, 160))
    in_time = Interpolator(underrun=Underrun.DECELERATE)
    in_time.offer(0, Segment(4, 80), descent)
    in_time.offer(40_000, Segment(1, 8))
    assert in_time.end_ns == 41_000
    late = Interpolator(underrun=Underrun.DECELERATE)
    late.offer(0, Segment(4, 80), descent)
    late.offer(40_001, Segment(1, 8))
    assert late.end_ns == 51_000
    assert late.displacement_at(51_000) == 6


@pytest.mark.strength
@SETTINGS
@given(st.lists(SEGMENTS, min_size=1, max_size=4), st.integers(0, 300_000))
def test_a_flush_stands_where_it_was(segments: list[Segment], now: int) -> None:
    """MACS-CMD-18-03: the position at that instant stays, nothing resumes, the FIFO is free."""
    interpolator = Interpolator()
    for segment in segments:
        interpolator.offer(0, segment)
    position = interpolator.displacement_at(now)
    interpolator.flush(now)
    assert interpolator.displacement_at(now + 10**9) == position
    assert interpolator.next_event() is None
    assert interpolator.stored_at(now) == 0
    assert list(interpolator.legs(now)) == [Leg(now, None, 0, 0, position)]


def test_dropping_the_stored_lets_the_executing_end() -> None:
    """MACS-AMB-32, stop after the segment."""
    interpolator = Interpolator(underrun=Underrun.DECELERATE)
    for _ in range(3):
        interpolator.offer(0, Segment(4, 80), (Piece(1, 160),))
    interpolator.drop_stored(10)
    assert interpolator.stored_at(10) == 0
    assert interpolator.displacement_at(interpolator.end_ns) == 5


def test_a_holding_interpolator_stores_and_waits() -> None:
    """MACS-AMB-31: three fit while a profile runs; they start when it is released."""
    interpolator = Interpolator()
    interpolator.hold()
    assert [interpolator.offer(0, Segment(5, 8)) for _ in range(4)] == [True, True, True, False]
    assert interpolator.next_event() is None
    assert interpolator.displacement_at(10**6) == 0
    interpolator.release(10**6)
    assert interpolator.stored_at(10**6) == 2
    assert interpolator.end_ns == 10**6 + 15_000


def test_the_step_in_progress_is_known() -> None:
    """MACS-AMB-30: its start, direction and period; none in a virtual segment or at rest."""
    interpolator = Interpolator()
    assert interpolator.step_in_progress(0) is None
    interpolator.offer(0, Segment(-3, 8))
    interpolator.offer(0, Segment(3, 8, virtual=True))
    assert interpolator.step_in_progress(1500) == Step(1000, -1, 8)
    assert interpolator.step_in_progress(3500) is None
    assert interpolator.step_in_progress(6000) is None


@pytest.mark.strength
@SETTINGS
@given(st.lists(SEGMENTS, min_size=1, max_size=4), st.integers(0, 50_000), st.integers(-40, 40))
def test_reach_is_the_first_time_at_a_displacement(
    segments: list[Segment], after: int, displacement: int
) -> None:
    """Compared with a search over every instant at which a step can count."""
    interpolator = Interpolator()
    for segment in segments:
        interpolator.offer(0, segment)
    instants = [after, *range(after - after % TICK_NS, interpolator.end_ns + 1, TICK_NS)]
    there = (t for t in instants if t >= after and interpolator.displacement_at(t) == displacement)
    assert interpolator.reach_ns(displacement, after) == next(there, None)


@pytest.mark.strength
@SETTINGS
@given(st.lists(SEGMENTS, min_size=1, max_size=4), st.integers(0, 50_000))
def test_legs_are_seamless(segments: list[Segment], start: int) -> None:
    """Each leg begins when and where the one before ended."""
    interpolator = Interpolator()
    for segment in segments:
        interpolator.offer(0, segment)
    legs = list(interpolator.legs(start))
    for leg, following in pairwise(legs):
        assert leg.end_ns == following.start_ns
        assert following.displacement == interpolator.displacement_at(following.start_ns)
    assert legs[-1].end_ns is None
