"""The closed form of MAC motion against the ledger's figures and against a step-by-step rule."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.families.mac.axis.model.kinematics import (
    Course,
    EvenRun,
    Law,
    Profile,
    divide,
    move,
    ramp,
    ramp_increments,
    transition,
)

LAW = Law()
DETERMINISTIC = settings(max_examples=200, database=None, derandomize=True)


@pytest.mark.parametrize(
    ("distance", "coefficient", "ticks"),
    [
        (1, 1, 12_800), (2, 1, 25_600), (10, 1, 68_268), (100, 1, 243_200), (239, 1, 383_155),
        (240, 1, 384_008), (241, 1, 384_808), (1000, 1, 992_008), (1000, 10, 2_432_000),
        (10_000, 10, 9_920_080),
    ],
)  # fmt: skip
def test_moves_last_as_long_as_the_ledgers_table_says(
    distance: int, coefficient: int, ticks: int
) -> None:
    """Total times with P = 800, tick for tick."""
    assert move(distance, 800, coefficient, LAW).ticks == ticks


def test_the_ramp_has_the_ledgers_levels() -> None:
    """P = 800, AA = 1: level k has k increments of 16·P/k ticks."""
    runs = ramp(800, 1, LAW)
    assert [run.period for run in runs] == [
        12800, 6400, 4267, 3200, 2560, 2133, 1829, 1600, 1422, 1280, 1164, 1067, 985, 914, 853,
    ]  # fmt: skip
    assert [run.count for run in runs] == list(range(1, 16))
    assert sum(run.count or 0 for run in runs) == ramp_increments(1) == 120


def test_equal_increments_take_1_69_times_as_long() -> None:
    """The other reading of the ramp is told apart by its time."""
    equal_time = Profile(ramp(1600, 10, LAW)).ticks or 0
    equal_increments = Profile(ramp(1600, 10, Law(ramp="equal_increments"))).ticks or 0
    assert equal_increments / equal_time == pytest.approx(405.7 / 240, rel=0.002)


def test_a_speed_change_has_the_ledgers_levels() -> None:
    """1600 → 800 ticks with AA = 1: boundaries, periods and the total of 127674 ticks."""
    runs = transition(1600, 800, 1, LAW)
    assert [run.period for run in runs] == [
        1506, 1422, 1347, 1280, 1219, 1164, 1113, 1067, 1024, 985, 948, 914, 883, 853, 826,
    ]  # fmt: skip
    assert sum((run.count or 0) * run.period for run in runs) == 127_674
    assert sum(run.count or 0 for run in runs) == 120


def stepwise(distance: int, period: int, coefficient: int) -> list[int]:
    """The ledger's incremental form (§5.3): climb, hold or descend at each boundary."""
    table = [
        divide(16 * period, level, "half_up")
        for level in range(1, 16)
        for _ in range(level * coefficient)
    ]
    climbed, left, periods = 0, distance, []
    while left > 0:
        if left >= climbed + 2 and climbed < len(table):
            periods.append(table[climbed])
            climbed += 1
        elif left >= climbed + 1:
            periods.append(period if climbed == len(table) else table[climbed])
        else:
            climbed -= 1
            periods.append(table[climbed])
        left -= 1
    return periods


@given(st.integers(0, 1500), st.integers(1, 0xFFFF), st.integers(0, 4))
@DETERMINISTIC
def test_the_closed_form_is_the_stepwise_rule(distance: int, period: int, coefficient: int) -> None:
    """Both forms of §5.3 give the same increments, one by one."""
    profile = move(distance, period, coefficient, LAW)
    periods = [run.period for run in profile.runs for _ in range(run.count or 0)]
    assert periods == stepwise(distance, period, coefficient)


@given(st.integers(1, 1500), st.integers(1, 5000), st.integers(0, 4), st.data())
@DETERMINISTIC
def test_steps_and_times_are_inverse(
    distance: int, period: int, coefficient: int, data: st.DataObject
) -> None:
    """Step n is counted on the tick C(n), and not one tick before."""
    profile = move(distance, period, coefficient, LAW)
    step = data.draw(st.integers(1, distance))
    assert profile.steps_by(profile.ticks_of(step)) == step
    assert profile.steps_by(profile.ticks_of(step) - 1) == step - 1


@given(st.integers(1, 2000), st.integers(1, 5000), st.integers(0, 4))
@DETERMINISTIC
def test_the_roundings_enclose_the_exact_profile(
    distance: int, period: int, coefficient: int
) -> None:
    """Rounded down is never slower, rounded up never faster than half up."""
    fast, exact, slow = (
        move(distance, period, coefficient, Law(rounding=rounding)).ticks or 0
        for rounding in ("down", "half_up", "up")
    )
    assert fast <= exact <= slow


@pytest.mark.parametrize(
    ("step", "rest"),
    [(0, 2), (5, 12), (119, 240), (120, 241), (500, 621), (880, 1000), (999, 1000)],
)
def test_a_ramped_stop_descends_what_was_climbed(step: int, rest: int) -> None:
    """17h in a move of 1000: one increment is finished, the climbed ones are descended."""
    course = Course.to_position(1000, 800, 1, LAW)
    stopped = course.stopped(course.profile.ticks_of(step) + 1)
    assert stopped.profile.steps == rest


def test_a_stop_before_a_change_has_begun_forgets_the_change() -> None:
    """15h and 15h 0000 within one increment: the axis comes down from where it climbed to."""
    course = Course.endless(1000, 1, LAW)
    assert course.changed(10, 500).stopped(20).profile == course.stopped(20).profile


@pytest.mark.parametrize("step", range(5))
def test_a_second_stop_in_the_same_increment_adds_nothing(step: int) -> None:
    """The middle one of a move of 5 was held, not climbed; that stays so the second time."""
    course = Course.to_position(5, 800, 2, LAW)
    ticks = course.profile.ticks_of(step) + 1
    once = course.stopped(ticks)
    assert once.stopped(ticks + 1).profile == once.profile


def test_a_speed_change_goes_on_for_ever_at_the_new_period() -> None:
    """After the transition the new period holds."""
    course = Course.endless(1600, 1, LAW)
    at_cruise = course.profile.ticks_of(200)
    changed = course.changed(at_cruise, 800)
    first = changed.profile.steps_by(at_cruise) + 1 + 120
    assert changed.profile.period_of(first) == 800
    assert changed.profile.is_endless


def test_an_endless_profile_has_neither_end_nor_length() -> None:
    """An endless run is the last one and has no total."""
    profile = Profile((EvenRun(3, 10), EvenRun(None, 5)))
    assert (profile.steps, profile.ticks) == (None, None)
    assert profile.steps_by(30) == 3
    assert profile.steps_by(1030) == 203
    assert profile.first(5).ticks == 40
