"""Backlash, jogging, threading and external sync of the MN400 (ledger §5.6, §5.10, §5.11)."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from math import ceil, floor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mn400_motions import S, end, rules

from axistwin.devices.mn400.motion import (
    ContourSegment,
    JogTaps,
    MotionRules,
    MoveSettings,
    Plane,
    PulseTrain,
    VectorMotion,
    arc,
    contour,
    helix,
    jog,
    straight,
    thread,
)

SLOW = 500
"""Below start speed: without ramps times are simple."""


def lashed(lash: int = 50, **changed: object) -> MoveSettings:
    """Backlash on the first two axes, at a speed without ramps."""
    return MoveSettings(rules(**changed), speed=SLOW, lash=(lash, lash, 0, 0))


# Backlash


def test_the_first_move_against_the_memory_takes_up_the_backlash() -> None:
    """b steps before the move, b/V later, not in the counters (MN4-BKL-01, -03)."""
    along = straight(0, lashed(), (100, 0, 0, 0))
    against = straight(0, lashed(), (-100, 0, 0, 0))
    assert end(along) == 100 * S // SLOW
    assert end(against) == 150 * S // SLOW
    assert against.position_at(50 * S // SLOW) == (0, 0, 0, 0)
    assert against.position_at(51 * S // SLOW) == (-1, 0, 0, 0)
    assert against.remaining_at(50 * S // SLOW) == (-100, 0, 0, 0)
    assert against.step_time_ns(0, 1) == 51 * S // SLOW
    steps = list(against.steps(0, 0, end(against)))
    assert [step.direction for step in steps] == [-1] * 150
    assert [step.is_commanded for step in steps] == [False] * 50 + [True] * 100


def test_backlash_that_counts_shows_in_the_position() -> None:
    """The other reading of MN4-AMB-58: E has it, N has not."""
    motion = straight(0, lashed(backlash_counts=True), (-100, 0, 0, 0))
    assert motion.position_at(end(motion)) == (-150, 0, 0, 0)
    assert motion.position_at(25 * S // SLOW) == (-25, 0, 0, 0)
    assert motion.remaining_at(25 * S // SLOW) == (-100, 0, 0, 0)


def test_all_axes_take_up_their_backlash_together() -> None:
    """One vector move as long as the largest, of those axes only that turn round."""
    made = MoveSettings(speed=SLOW, lash=(50, 20, 30, 7), lash_memory=(1, -1, 1, -1))
    motion = straight(0, made, (-10, 10, 0, -10))
    assert end(motion) == 60 * S // SLOW
    for axis, expected in enumerate((-50, 20, 0, 0)):
        hidden = [step for step in motion.steps(axis, 0, S) if not step.is_commanded]
        assert sum(step.direction for step in hidden) == expected
    assert motion.lash_memory_at(end(motion)) == (-1, 1, 1, -1)
    assert motion.phantom_at(end(motion)) == 10


def test_the_example_of_d_compensates_on_the_second_axis_only() -> None:
    """`D1,-1,1,1` and positive moves (MN4-CMD-D-02)."""
    made = MoveSettings(speed=SLOW, lash=(50, 50, 50, 50), lash_memory=(1, -1, 1, 1))
    for axis, expected in enumerate((100, 150, 100, 100)):
        displacement = [0, 0, 0, 0]
        displacement[axis] = 100
        first, second, third, fourth = displacement
        assert end(straight(0, made, (first, second, third, fourth))) == expected * S // SLOW


def test_the_memory_follows_the_last_motion_of_each_axis() -> None:
    """Also without backlash, and not for an axis at rest (MN4-BKL-02, MN4-BKL-04)."""
    motion = straight(0, MoveSettings(lash_memory=(1, -1, 1, -1)), (-5, 0, 3, 0))
    assert motion.lash_memory_at(end(motion)) == (-1, -1, 1, -1)


def test_an_abort_in_the_compensation_keeps_the_whole_move_and_the_new_memory() -> None:
    """N is all of it and the direction is that of the compensation (MN4-BKL-05)."""
    motion = straight(0, lashed(), (-100, 0, 0, 0)).quit(20 * S // SLOW)
    assert motion.remaining_at(S) == (-100, 0, 0, 0)
    assert motion.lash_memory_at(S) == (-1, 1, 1, 1)


def test_compensation_is_a_ramped_move_of_its_own() -> None:
    """At the move's speed and profile, or at start speed by the other reading."""
    made = MoveSettings(lash=(400, 0, 0, 0))
    parts = [end(straight(0, MoveSettings(), (steps, 0, 0, 0))) for steps in (400, 10_000)]
    assert abs(end(straight(0, made, (-10_000, 0, 0, 0))) - sum(parts)) <= 1
    slow = MoveSettings(rules(backlash_speed="start"), lash=(400, 0, 0, 0))
    assert end(straight(0, slow, (-10_000, 0, 0, 0))) == 400 * S // 1000 + parts[1]


def test_arcs_take_up_backlash_at_the_start_or_at_each_turn() -> None:
    """By the initial direction; the other reading of MN4-AMB-58 at every reversal."""
    made = MoveSettings(speed=SLOW, lash=(30, 0, 40, 0))
    motion = arc(0, made, Plane(), (-100, 0), (-200, 0), True)
    ticks = 282
    assert end(motion) == (ticks + 40) * S // SLOW
    assert motion.lash_memory_at(end(motion)) == (-1, 1, 1, 1)
    each = MoveSettings(rules(backlash_arc="quadrants"), speed=SLOW, lash=(30, 0, 40, 0))
    turning = helix(0, each, Plane(), (-100, 0), (-200, 0), True, 77, 1)
    hidden: list[list[int]] = [[], [], [], []]
    for axis in range(4):
        steps = list(turning.steps(axis, 0, end(turning)))
        hidden[axis] = [step.direction for step in steps if not step.is_commanded]
        before = 1
        for step in steps:
            assert step.direction == before or not step.is_commanded or made.lash[axis] == 0
            before = step.direction
    assert hidden[0] == [-1] * 30 + [1] * 30 + [-1] * 30
    assert hidden[2] == [-1] * 40 + [1] * 40 + [-1] * 40 + [1] * 40
    assert turning.position_at(end(turning)) == (-200, 77, 0, 0)
    assert end(turning) == (3 * ticks + 2 * 30 + 3 * 40 + 40) * S // SLOW


def test_contours_take_up_backlash_before_the_first_segment() -> None:
    """By each axis' first direction; the memory is each axis' last (MN4-BKL-07)."""
    parts = [
        ContourSegment((100, 0, 0, 0), SLOW),
        ContourSegment((100, -10, 0, 0), SLOW),
        ContourSegment((-100, 0, 0, 0), SLOW),
    ]
    motion = contour(0, lashed(), parts)
    assert end(motion) == (50 + 300) * S // SLOW
    assert [step.direction for step in motion.steps(1, 0, end(motion))] == [-1] * 60
    assert motion.lash_memory_at(end(motion)) == (-1, -1, 1, 1)


# Jogging


@pytest.mark.strength
@given(
    st.integers(1, 32767),
    st.lists(st.tuples(st.integers(1, 32767), st.sampled_from([1, -1])), max_size=40),
    st.sampled_from(["floor", "nearest"]),
)
@settings(max_examples=150)
def test_taps_owe_less_than_a_step(
    steps_per_inch: int, taps: Sequence[tuple[int, int]], rounding: str
) -> None:
    """Whatever the taps, all steps so far are within one of the exact sum (MN4-JOG-04)."""
    read, state, made, exact = rules(tap_rounding=rounding), JogTaps(), 0, Fraction()
    for resolution, direction in taps:
        steps, state = state.tap(steps_per_inch, resolution, direction, read)
        made += steps
        exact += direction * Fraction(steps_per_inch, resolution)
        assert abs(exact - made) < 1
        assert exact - made == state.owed


def test_five_taps_of_eight_tenths_are_four_steps() -> None:
    """`G10,10,10,10,8` (MN4-JOG-03): every fifth tap, not every fourth, moves nothing."""
    state, made = JogTaps(), []
    for _ in range(10):
        steps, state = state.tap(8, 10, 1, MotionRules())
        made.append(steps)
    assert made == [0, 1, 1, 1, 1] * 2
    for _ in range(10):
        steps, state = state.tap(8, 10, -1, MotionRules())
        made.append(steps)
    assert sum(made) == 0
    assert state == JogTaps()


@pytest.mark.parametrize("resolution", [2000, 1000, 100, 10])
def test_taps_of_the_manuals_example_are_whole(resolution: int) -> None:
    """`G2000,1000,100,10,8000`: 4, 8, 80 and 800 steps per tap."""
    expected = {2000: 4, 1000: 8, 100: 80, 10: 800}[resolution]
    assert JogTaps().tap(8000, resolution, -1, MotionRules()) == (-expected, JogTaps())


def test_a_held_button_runs_at_jog_speed_until_it_is_released() -> None:
    """Ramped up, and ramped down on release (MN4-JOG-05); the pot scales it (MN4-JOG-06)."""
    motion = jog(0, MoveSettings(), 2, -1)
    assert motion.position_at(10 * S) == (0, 0, -(150 + 9900 * 2), 0)
    released = motion.quit(10 * S, ramped=True)
    assert released.end_ns == 10 * S + S // 10
    assert released.position_at(11 * S) == (0, 0, -(150 + 9900 * 2 + 150), 0)
    slower = motion.override(10 * S, 500)
    assert slower.position_at(12 * S)[2] - slower.position_at(11 * S)[2] == -1000
    a_day = 86_400 * S
    assert motion.position_at(a_day)[2] == -(150 + (86_400 * 10 - 1) * 200)


# Threading and external sync


@pytest.mark.strength
@given(
    st.tuples(*[st.integers(-200, 200)] * 4),
    st.integers(0, 300),
    st.sampled_from(["half", "zero", "full"]),
    st.lists(st.integers(1, 60), min_size=1, max_size=30),
)
@settings(max_examples=120)
def test_a_thread_follows_the_count_of_its_pulses(
    displacement: tuple[int, int, int, int], more: int, phase: str, gifts: Sequence[int]
) -> None:
    """Steps are the share of the pulses, to one step, and the rest none (MN4-THR-01, -04)."""
    pulses = max(1, *map(abs, displacement)) + more
    motion = thread(0, MoveSettings(rules(dda_phase=phase)), displacement, pulses, 3)
    motion = motion.feed(1, 50).index(2).feed(3, 3)
    fed = 0
    for now_ns, gift in enumerate(gifts, start=10):
        motion = motion.feed(now_ns, gift)
        fed = min(pulses, fed + gift)
        for axis, position in enumerate(motion.position_at(now_ns)):
            share = Fraction(fed * abs(displacement[axis]), pulses)
            assert floor(share) <= abs(position) <= ceil(share)
    assert motion.is_over_at(1000) == (fed == pulses)
    motion = motion.feed(1000, 10_000)
    assert motion.position_at(1000) == motion.total == displacement
    assert motion.is_over_at(1000)


def test_the_example_of_t_takes_its_pulses_from_the_index_on() -> None:
    """`T500,0,0,0,2000,0` on an encoder of 400 pulses a turn, half a turn late by the offset."""
    train = PulseTrain(1_000_000, pulses_per_turn=400)
    motion = thread(0, MoveSettings(), (500, 0, 0, 0), 2000)
    assert motion.end_ns is None
    running = motion.paced_by(S // 10, replace(train, origin_ns=S // 10))
    assert running.end_ns == S // 10 + 400 * S // 1000 + 2 * S
    assert running.position_at(S // 10 + S // 2) == (25, 0, 0, 0)
    assert running.position_at(end(running)) == (500, 0, 0, 0)
    late = thread(0, MoveSettings(), (500, 0, 0, 0), 2000, 200).paced_by(0, train)
    assert late.end_ns == (400 + 200 + 2000) * S // 1000
    at_once = thread(0, MoveSettings(rules(threader_start="first_pulse")), (500, 0, 0, 0), 2000)
    assert at_once.paced_by(0, train).end_ns == 2 * S
    twice = thread(0, MoveSettings(), (500, 0, 0, 0), 4000).paced_by(0, train)
    assert twice.end_ns == 400 * S // 1000 + 4 * S


def test_a_train_without_an_index_starts_no_thread() -> None:
    """Pulses alone are heard only after an index pulse (MN4-THR-03)."""
    motion = thread(0, MoveSettings(), (500, 0, 0, 0), 2000).paced_by(0, PulseTrain(1_000_000))
    assert motion.end_ns is None
    assert motion.position_at(90 * S) == (0, 0, 0, 0)
    assert motion.index(90 * S).end_ns == 92 * S
    assert motion.quit(S).is_over_at(S)


def test_the_index_is_where_the_spindle_has_it_not_where_the_motion_starts() -> None:
    """Two threads begin at the same angle of a spindle that goes on turning (MN4-THR-03)."""
    train = PulseTrain(1_000_000, 400, S // 10)
    for start_ns in (S, S + 123_456_789, S + 299_000_000, S + 299_999_999):
        motion = thread(start_ns, MoveSettings(), (500, 0, 0, 0), 2000)
        assert motion.paced_by(start_ns, train).end_ns == S // 10 + (1200 + 2000) * S // 1000
    motion = thread(S + 3 * S // 10, MoveSettings(), (500, 0, 0, 0), 2000)
    assert motion.paced_by(S + 3 * S // 10, train).end_ns == S // 10 + (1600 + 2000) * S // 1000


def test_headings_are_known_before_the_pulses() -> None:
    """A limit can halt a thread that waits for its first pulse (MN4-LIM-06)."""
    motion = thread(0, MoveSettings(), (500, 0, -3, 0), 2000)
    assert motion.headings_at(5) == (1, 0, -1, 0)
    assert motion.pause(5).headings_at(5) == (0, 0, 0, 0)
    assert motion.quit(5).headings_at(5) == (0, 0, 0, 0)
    assert motion.halt_axis(5, 0).headings_at(5) == (0, 0, -1, 0)


def test_a_spindle_that_changes_its_speed_is_followed_by_count() -> None:
    """The rate changes when, not where; without pulses the axes stand (MN4-THR-01)."""
    made = MoveSettings(rules(threader_start="first_pulse"))
    motion = thread(0, made, (500, -250, 0, 1), 2000).paced_by(0, PulseTrain(1_000_000))
    motion = motion.paced_by(S, PulseTrain(500_000))
    assert motion.position_at(S) == (250, -125, 0, 1)
    motion = motion.paced_by(2 * S, None)
    assert motion.position_at(2 * S) == motion.position_at(9 * S) == (375, -188, 0, 1)
    assert motion.end_ns is None
    assert motion.paced_by(9 * S, PulseTrain(1_000_000)).end_ns == 9 * S + S // 2


def test_a_thread_takes_up_backlash_on_the_clock_first() -> None:
    """Then it waits for the index."""
    motion = thread(0, lashed(), (-500, 0, 0, 0), 2000)
    assert motion.position_at(S) == (0, 0, 0, 0)
    assert len(list(motion.steps(0, 0, S))) == 50
    motion = motion.index(50 * S // SLOW - 1).feed(S // 2, 40)
    assert motion.position_at(S) == (0, 0, 0, 0)
    assert motion.index(S).feed(S, 40).position_at(S) == (-10, 0, 0, 0)


def test_more_steps_than_pulses_are_several_steps_a_pulse() -> None:
    """What the other reading of MN4-AMB-59 makes of them."""
    motion = thread(0, MoveSettings(), (100, 0, 0, 0), 40).index(0)
    assert motion.feed(1, 20).position_at(1) == (50, 0, 0, 0)
    assert motion.feed(1, 40).position_at(1) == (100, 0, 0, 0)


@pytest.mark.parametrize(
    ("ratio", "multiplex", "position"), [("major_step", 4, 10), ("tick", 4, 2)]
)
def test_a_move_on_pulses_makes_a_step_or_a_tick_with_each(
    ratio: str, multiplex: int, position: int
) -> None:
    """Ten pulses are ten major steps, or ten ticks by the other reading (MN4-AMB-60)."""
    made = MoveSettings(rules(sync_ratio=ratio), speed=-1, multiplex=multiplex)
    motion = straight(0, made, (100, -50, 0, 0)).feed(S, 10)
    assert motion.position_at(S)[0] == position
    assert motion.end_ns is None


@given(
    st.integers(1, 10**9),
    st.integers(0, 10**6),
    st.lists(st.integers(0, 10**9), min_size=1, max_size=20),
)
@settings(max_examples=150)
def test_pulses_counted_are_pulses_that_came(rate: int, turn: int, moments: Sequence[int]) -> None:
    """Counts and times of a train are inverse to each other at every nanosecond."""
    train = PulseTrain(rate, turn, 17)
    for now_ns in moments:
        count = train.count_at(17 + now_ns)
        assert count == 0 or train.time_of(count) <= 17 + now_ns
        assert train.time_of(count + 1) > 17 + now_ns
        index = train.index_after(count)
        assert (index is None) == (turn == 0)
        if index is not None:
            assert index % turn == 0
            assert count < index <= count + turn


@pytest.mark.strength
@given(
    st.tuples(*[st.integers(-200, 200)] * 4),
    st.integers(1000, 10**7),
    st.lists(st.integers(0, 10**8), min_size=2, max_size=6),
)
@settings(max_examples=100, derandomize=True)
def test_pauses_on_pulses_lose_pulses_but_no_step(
    displacement: tuple[int, int, int, int], rate: int, moments: Sequence[int]
) -> None:
    """Pulses in a pause pass unused; the target is reached all the same (MN4-PAU-03)."""
    motion = straight(0, MoveSettings(speed=-1), displacement).paced_by(0, PulseTrain(rate))
    since_ns, counts = -1, [0, 0, 0, 0]

    def follow(moved: VectorMotion, now_ns: int) -> None:
        for axis in range(4):
            steps = moved.steps(axis, since_ns, now_ns)
            counts[axis] += sum(step.direction for step in steps)
        assert moved.position_at(now_ns) == tuple(counts)

    for number, now_ns in enumerate(sorted(moments)):
        follow(motion, now_ns)
        since_ns = now_ns
        motion = motion.resume(now_ns) if number % 2 else motion.pause(now_ns)
        assert motion.position_at(now_ns) == tuple(counts)
    motion = motion.resume(since_ns)
    follow(motion, max(end(motion), since_ns))
    assert tuple(counts) == displacement
