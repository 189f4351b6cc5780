"""The set-point as a closed formula of time, against a walk over every increment."""

from itertools import accumulate, pairwise, repeat

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.motion.trajectory import (
    TICK_NS,
    Leg,
    Piece,
    StepPhase,
    Trajectory,
    first_increments,
    merged,
)

PIECES = st.lists(
    st.builds(Piece, st.integers(1, 30), st.integers(1, 200)), min_size=1, max_size=6
).map(tuple)
PHASES = st.sampled_from(StepPhase)
DIRECTIONS = st.sampled_from([-1, 1])


@st.composite
def trajectories(draw: st.DrawFn) -> Trajectory:
    """Finite trajectories of up to 180 increments."""
    return Trajectory(
        draw(st.integers(0, 10_000)),
        draw(DIRECTIONS),
        draw(PIECES),
        draw(PHASES),
        draw(st.integers(0, 50)),
    )


def walked_ends(trajectory: Trajectory) -> list[int]:
    """When each increment ends, by adding up one after the other."""
    periods: list[int] = []
    for increments, period_ticks in trajectory.pieces:
        assert increments is not None
        periods.extend(repeat(period_ticks, increments))
    return [trajectory.start_ns + ticks * TICK_NS for ticks in accumulate(periods)]


@settings(max_examples=100)
@given(trajectories(), st.data())
def test_closed_form_agrees_with_adding_up_increments(
    trajectory: Trajectory, data: st.DataObject
) -> None:
    """Counts, ends and periods at any instant are those of the increments laid end to end."""
    ends = walked_ends(trajectory)
    now = data.draw(st.integers(trajectory.start_ns, ends[-1] + 1000))
    done = sum(end <= now for end in ends)
    assert trajectory.completed_at(now) == trajectory.before + done
    assert trajectory.end_ns == ends[-1]
    assert trajectory.total_increments == trajectory.before + len(ends)
    starts = [trajectory.start_ns, *ends]
    for number, end in enumerate(ends, trajectory.before + 1):
        assert trajectory.end_of_increment_ns(number) == end
        length_ns = end - starts[number - trajectory.before - 1]
        assert trajectory.period_of(number) * TICK_NS == length_ns
    expected = None if done == len(ends) else trajectory.period_of(trajectory.before + done + 1)
    assert trajectory.period_at(now) == expected


@settings(max_examples=100)
@given(trajectories())
def test_count_and_time_are_inverse_to_the_nanosecond(trajectory: Trajectory) -> None:
    """At the instant of step n the count is n, and n-1 a nanosecond before."""
    total = trajectory.total_increments
    assert total is not None
    for n in range(trajectory.before + 1, total + 1):
        step_ns = trajectory.step_ns(n)
        assert trajectory.increments_at(step_ns) == n
        assert trajectory.increments_at(step_ns - 1) == n - 1
        end_ns = trajectory.end_of_increment_ns(n)
        assert trajectory.completed_at(end_ns) == n
        assert trajectory.completed_at(end_ns - 1) == n - 1


@settings(max_examples=100)
@given(trajectories(), st.data())
def test_a_cut_trajectory_runs_alike_and_then_rests(
    trajectory: Trajectory, data: st.DataObject
) -> None:
    """The first n increments keep their times; nothing comes after them."""
    total = trajectory.total_increments
    assert total is not None
    n = data.draw(st.integers(trajectory.before, total))
    cut = trajectory.cut(n)
    assert cut.total_increments == n
    for number in range(trajectory.before + 1, n + 1):
        assert cut.step_ns(number) == trajectory.step_ns(number)
    assert trajectory.end_ns is not None
    assert cut.increments_at(trajectory.end_ns + 10**9) == n


@settings(max_examples=100)
@given(trajectories(), st.data())
def test_reach_is_the_first_time_at_a_displacement(
    trajectory: Trajectory, data: st.DataObject
) -> None:
    """What lies ahead is reached at its step, what lies behind or beyond never."""
    assert trajectory.end_ns is not None
    after = data.draw(st.integers(trajectory.start_ns - 500, trajectory.end_ns + 500))
    n = data.draw(st.integers(0, trajectory.before + 200))
    reached = trajectory.reach_ns(trajectory.direction * n, after)
    present, total = trajectory.increments_at(after), trajectory.total_increments
    assert total is not None
    if present <= n <= total:
        assert reached is not None
        assert trajectory.displacement_at(reached) == trajectory.direction * n
        assert reached == max(after, trajectory.step_ns(n) if n > present else after)
    else:
        assert reached is None


@settings(max_examples=100)
@given(trajectories(), st.data())
def test_legs_are_seamless_and_end_at_rest(trajectory: Trajectory, data: st.DataObject) -> None:
    """Each leg starts where and when the one before ended; the last is endless rest."""
    assert trajectory.end_ns is not None
    start = data.draw(st.integers(0, trajectory.end_ns + 500))
    legs = list(trajectory.legs(start))
    assert trajectory.leg_at(start) == legs[0]
    for leg, following in pairwise(legs):
        assert leg.end_ns == following.start_ns
        steps = 0
        if leg.direction:
            steps = (following.start_ns - leg.start_ns) // (leg.period_ticks * TICK_NS)
        assert following.displacement == leg.displacement + leg.direction * steps
    total = trajectory.total_increments
    assert total is not None
    last = Leg(trajectory.end_ns, None, 0, 0, trajectory.direction * total)
    assert legs[-1] == last
    assert legs[0].start_ns <= start or legs[0] == last


def test_an_endless_trajectory_counts_after_an_hour() -> None:
    """One hour at 800 ticks is 36 million increments, in one division."""
    endless = Trajectory(0, 1, (Piece(10, 1000), Piece(None, 800)))
    hour_ns = 3600 * 10**9
    assert endless.is_endless
    assert endless.end_ns is None
    assert endless.total_increments is None
    assert endless.increments_at(10 * 1000 * TICK_NS + hour_ns) == 10 + 36_000_000
    assert endless.period_at(hour_ns) == 800
    assert endless.cut(12).pieces == (Piece(10, 1000), Piece(2, 800))
    assert endless.reach_ns(36_000_010, 0) == 10 * 1000 * TICK_NS + hour_ns
    assert list(endless.legs(hour_ns)) == [Leg(1_250_000, None, 1, 800, 10)]


def test_nothing_counts_before_the_start() -> None:
    """A start in the future: no increment, no period, at rest until then."""
    future = Trajectory(1000, -1, (Piece(2, 8),), StepPhase.START)
    assert future.increments_at(999) == 0
    assert future.period_at(999) is None
    assert future.increments_at(1000) == 1
    assert future.displacement_at(2000) == -2
    assert next(future.legs(0)) == Leg(0, 1000, 0, 0, 0)


def test_an_empty_trajectory_is_over_at_once() -> None:
    """No pieces: the end is the start."""
    empty = Trajectory(500, 1, (), before=7)
    assert empty.end_ns == 500
    assert empty.total_increments == 7
    assert empty.increments_at(10**9) == 7
    assert empty.period_at(500) is None
    assert list(empty.legs(600)) == [Leg(500, None, 0, 0, 7)]


@pytest.mark.parametrize("pieces", [(Piece(0, 5),), (Piece(1, 0),), (Piece(None, 5), Piece(1, 5))])
def test_a_trajectory_of_impossible_pieces_is_a_bug(pieces: tuple[Piece, ...]) -> None:
    """Empty pieces, periods of no ticks and anything after an endless piece are caught."""
    with pytest.raises(AssertionError):
        Trajectory(0, 1, pieces)


def test_merging_joins_equal_neighbours_and_drops_empty_ones() -> None:
    """The increments stay; an endless neighbour swallows the piece before it."""
    pieces = (Piece(2, 9), Piece(0, 7), Piece(3, 9), Piece(1, 8), Piece(None, 8))
    assert merged(pieces) == (Piece(5, 9), Piece(None, 8))
    assert first_increments(merged(pieces), 7) == (Piece(5, 9), Piece(2, 8))
    assert first_increments(merged(pieces), 0) == ()


@settings(max_examples=100)
@given(trajectories(), DIRECTIONS, st.integers(0, 5_000_000))
def test_when_it_heads_somewhere_is_told_without_a_walk(
    trajectory: Trajectory, direction: int, from_ns: int
) -> None:
    """The start of the first leg in that direction, from any time on; none in the other one."""
    starts = [leg.start_ns for leg in trajectory.legs(from_ns) if leg.direction == direction]
    assert trajectory.heads_ns(direction, from_ns) == (starts[0] if starts else None)
