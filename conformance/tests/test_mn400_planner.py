"""Motion of the MN400 by the formulas of its ledger: every reference number, and what must hold of
any move."""

from __future__ import annotations

from fractions import Fraction
from math import cos, pi, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin_conformance.families.mn400.planner.circle import CircleMove, CircleRules
from axistwin_conformance.families.mn400.planner.contour import (
    ContourMove,
    ContourRules,
    ContourSegment,
    MarginScope,
    planned,
)
from axistwin_conformance.families.mn400.planner.pulses import (
    Spindle,
    can_be_threaded,
    pulses_of,
    tapped,
    threaded,
    threaded_between,
)
from axistwin_conformance.families.mn400.planner.speed import (
    DEFAULT_PROFILE,
    MotionProfile,
    halted,
    ramped,
    root,
)
from axistwin_conformance.families.mn400.planner.vector import (
    BacklashState,
    MotionSettings,
    VectorMove,
    compensated,
)

NS = Fraction(1, 10**9)
EXAMPLE = (1000, 4000, 4000)  # of F: start, end, acceleration
DEFAULT = (1000, 5000, 10_000)
# Profile, V, steps; then steps of a ramp and seconds for the whole acceleration and for half of it.
REFERENCES = [
    (EXAMPLE, 2000, 10_000, (375, 5.125), (750, 5.25)),
    (EXAMPLE, 3000, 10_000, (1000, 3.667), (2000, 4.0)),
    (DEFAULT, 2000, 10_000, (150, 5.05), None),
    (DEFAULT, 8000, 20_000, (1200, 4.32), None),
    (DEFAULT, 5000, 500, (250, 0.2899), None),
    (DEFAULT, 3000, 800, (400, 0.4), None),
    (DEFAULT, 500, 1000, (0, 2.0), None),
]
# The contour of the manual: displacements of axes 1 and 3, speed.
CONTOUR = [
    ContourSegment((first, 0, third, 0), speed)
    for first, third, speed in (
        (500, 500, 3000), (505, 500, 3000), (509, 500, 3000), (530, 505, 3850), (520, 510, 3850),
    )
]  # fmt: skip
# Length, cap, entry, peak, leaving speed, seconds of each at margin 50.
CONTOUR_PLAN = [
    (500, 3000, 1000, 3000, 3000, 0.23333),
    (505, 3000, 3000, 3000, 3000, 0.16833),
    (509, 3000, 3000, 3000, 3000, 0.16967),
    (530, 3850, 3050, 3850, 3426.39, 0.14830),
    (520, 3850, 3376.39, 3376.39, 1000, 0.23764),
]


def profile(start: int, end: int, acceleration: int | Fraction) -> MotionProfile:
    """What F has set."""
    return MotionProfile(start, end, Fraction(acceleration))


def line(axis: int, steps: int, speed: int) -> ContourSegment:
    """A segment along one axis (from 0)."""
    return ContourSegment(tuple(steps if one == axis else 0 for one in range(4)), speed)


def seconds(
    segments: list[ContourSegment],
    margin: int = 20,
    scope: MarginScope = MarginScope.PER_AXIS_PAIR,
) -> float:
    """How long a contour takes with the default profile."""
    return float(ContourMove(segments, ContourRules(margin, DEFAULT_PROFILE, scope)).seconds)


# --- ramps ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("given_profile", "speed", "steps", "whole", "half"), REFERENCES)
def test_a_ramped_move_takes_what_the_ledger_says(
    given_profile: tuple[int, int, int],
    speed: int,
    steps: int,
    whole: tuple[int, float],
    half: tuple[int, float] | None,
) -> None:
    """Ramp length and duration, for the acceleration as given and for half of it."""
    start, end, acceleration = given_profile
    for scale, wanted in ((Fraction(1), whole), (Fraction(1, 2), half)):
        if wanted is None:
            continue
        made = ramped(steps, speed, profile(start, end, acceleration * scale))
        ramp = made.phases[0].length if len(made.phases) > 1 else 0
        assert float(ramp) == pytest.approx(wanted[0], abs=1e-6)
        assert float(made.seconds) == pytest.approx(wanted[1], abs=5e-4)
        assert float(made.length) == pytest.approx(steps, abs=1e-6)


def test_a_short_move_peaks_where_its_ramps_meet() -> None:
    """500 steps at 5000: 2449.5 steps/s after 0.1449 s, never more."""
    made = ramped(500, 5000, DEFAULT_PROFILE)
    assert float(made.peak) == pytest.approx(2449.49, abs=0.01)
    assert float(made.phases[0].seconds) == pytest.approx(0.1449, abs=1e-4)
    assert made.peak <= root(Fraction(1000**2 + 10_000 * 500))


@given(st.integers(1, 50_000), st.integers(2, 9000))
@settings(max_examples=40)
def test_time_and_way_belong_together(steps: int, speed: int) -> None:
    """The steps made when the k-th is made are k, at the start, the end and between."""
    made = ramped(steps, speed, DEFAULT_PROFILE)
    for count in (0, steps // 3, steps // 2, steps):
        at = made.time_of(Fraction(count))
        assert abs(made.travelled(at) - count) < Fraction(1, 10**6)
    assert made.speed_at(made.seconds + 1) == 0
    assert made.travelled(made.seconds + 1) == made.length


@given(st.integers(2, 20_000), st.integers(2, 8000), st.integers(1, 99))
@settings(max_examples=40)
def test_a_pause_ends_at_the_start_speed_and_never_beyond_the_target(
    steps: int, speed: int, percent: int
) -> None:
    """Braking takes a ramp from above the start speed and no time from below."""
    made = ramped(steps, speed, DEFAULT_PROFILE)
    at = made.seconds * percent / 100
    soft = halted(made, at, DEFAULT_PROFILE, is_ramped=True)
    hard = halted(made, at, DEFAULT_PROFILE, is_ramped=False)
    assert hard.steps <= soft.steps <= made.length
    assert hard.seconds == at
    assert (soft.seconds > at) is (made.speed_at(at) > 1000)


def test_a_step_comes_at_the_end_of_its_period_or_at_its_beginning() -> None:
    """V2, M1: after half a second, or at once (MN4-AMB-71)."""
    made = ramped(1, 2, DEFAULT_PROFILE)
    assert made.last_step_time(is_early=False) == Fraction(1, 2)
    assert made.last_step_time(is_early=True) == 0
    assert made.steps_within(NS, Fraction(1, 4), is_early=False) == (0, 0)
    assert made.steps_within(NS, Fraction(1, 4), is_early=True) == (0, 1)


# --- vector moves ---------------------------------------------------------------------------------


def test_all_axes_end_together_and_stay_on_the_chord() -> None:
    """Halfway each has half of its way, give or take a step."""
    move = VectorMove((1000, -500, 0, 3), MotionSettings(1000, DEFAULT_PROFILE))
    assert move.plan.seconds == 1
    half = Fraction(1, 2)
    assert move.windows(half, half) == ((500, 500), (-251, -249), (0, 0), (1, 2))
    assert move.windows(Fraction(2), Fraction(3)) == tuple((one, one) for one in (1000, -500, 0, 3))
    assert move.windows(Fraction(0), Fraction(0)) == ((0, 0),) * 4


@given(st.lists(st.integers(-900, 900), min_size=4, max_size=4), st.sampled_from((0, 1, 2)))
@settings(max_examples=40)
def test_every_interpolation_stays_inside_its_windows(steps: list[int], phase: int) -> None:
    """Whatever the accumulators begin with: 0, half or all but one of the ticks."""
    move = VectorMove(tuple(steps), MotionSettings(500, DEFAULT_PROFILE))
    length = move.length
    sums = [(0, length // 2, max(0, length - 1))[phase]] * 4
    made = [0] * 4
    for tick in range(1, length + 1):
        for axis, one in enumerate(steps):
            sums[axis] += abs(one)
            if sums[axis] >= length:
                sums[axis] -= length
                made[axis] += 1 if one > 0 else -1
        at = Fraction(tick, 500)
        windows = move.windows(at, at)
        assert all(low <= one <= high for one, (low, high) in zip(made, windows, strict=True))
    assert made == steps


def test_a_measurement_counts_ticks_of_the_major_axis() -> None:
    """1500 steps/s at multiplex 2 for 100 ms: 300; none of an axis that moves alone."""
    settings_ = MotionSettings(1500, profile(1500, 5000, 10_000), multiplex=2)
    move = VectorMove((15_000, 1, 0, 0), settings_)
    assert move.counted(Fraction(1), Fraction(11, 10)) == (298, 302)
    assert VectorMove((15_000, 0, 0, 0), settings_).counted(Fraction(1), Fraction(2)) == (0, 0)


def test_a_multiplex_lowers_the_greatest_rate_of_several_axes() -> None:
    """100000 over the multiplex; an axis alone and a board that does not clip go on."""
    fast = profile(1000, 100_000, 10_000)
    for multiplex, speed in ((1, 90_000), (2, 50_000), (4, 25_000)):
        settings_ = MotionSettings(90_000, fast, multiplex)
        assert VectorMove((10, 10, 0, 0), settings_).speed == speed
        assert VectorMove((10, 0, 0, 0), settings_).speed == 90_000
    assert (
        VectorMove((9, 9, 0, 0), MotionSettings(90_000, fast, 4, is_clipped=False)).speed == 90_000
    )


def test_backlash_is_made_up_for_before_a_move_against_the_memory() -> None:
    """D1,-1,1,1: a positive move compensates on axis 2 only; the memory follows who moves."""
    state = BacklashState((50, 40, 30, 0), (1, -1, 1, 1))
    assert state.compensation((10, 10, 10, 10)) == (0, 40, 0, 0)
    assert state.compensation((-10, 0, -10, -10)) == (-50, 0, -30, 0)
    assert state.after((-10, 0, 10, -1)).memory == (-1, -1, 1, -1)
    settings_ = MotionSettings(500, DEFAULT_PROFILE)
    before, move = compensated((-10, 0, -10, 0), settings_, state)
    assert before.plan.seconds == Fraction(50, 500)
    assert move.plan.seconds == Fraction(10, 500)
    none, _ = compensated((10, 0, 10, 0), settings_, state)
    assert none.plan.seconds == 0


# --- circles --------------------------------------------------------------------------------------


def circle(
    centre: tuple[int, int], end: tuple[int, int], direction: int, **changes: int
) -> CircleMove:
    """An arc or a helix at V2000 with the default profile."""
    return CircleMove(centre, end, direction, CircleRules(2000, DEFAULT_PROFILE), **changes)


def test_the_half_circle_of_the_manual_takes_2828_ticks() -> None:
    """1.414 s at 2000 ticks/s, clockwise through (-1000, -1000); 1.571 s along the path."""
    half = circle((-1000, 0), (-2000, 0), 1)
    assert half.ticks == pytest.approx(2828, abs=0.5)
    assert float(half.plan.seconds) == pytest.approx(1.414, abs=5e-4)
    assert half.point(half.sweep / 2) == pytest.approx((-1000, -1000))
    rules = CircleRules(2000, DEFAULT_PROFILE, is_tangential=True)
    path = CircleMove((-1000, 0), (-2000, 0), 1, rules)
    assert path.ticks == pytest.approx(3142, abs=0.5)
    assert float(path.plan.seconds) == pytest.approx(1.571, abs=5e-4)


def test_the_45_degrees_of_the_manual_take_354_ticks() -> None:
    """From the top counter-clockwise: a growing angle (MN4-ARC-01)."""
    arc = circle((0, -500), (-354, -146), -1)
    assert arc.ticks == pytest.approx(354, abs=0.5)
    assert arc.sweep == pytest.approx(pi / 4, abs=1e-3)
    rules = CircleRules(2000, DEFAULT_PROFILE, is_tangential=True)
    assert CircleMove((0, -500), (-354, -146), -1, rules).ticks == pytest.approx(393, abs=0.5)


def test_both_ways_to_one_end_are_a_full_circle_together() -> None:
    """And an arc that ends where it starts is one, or nothing (MN4-AMB-29)."""
    arcs = [circle((300, 400), (700, 700), direction) for direction in (1, -1)]
    assert sum(arc.sweep for arc in arcs) == pytest.approx(2 * pi)
    assert circle((-20, 0), (0, 0), 1).sweep == pytest.approx(2 * pi)
    assert circle((-20, 0), (0, 0), 1).ticks == pytest.approx(8 * 20 / 2**0.5)
    rules = CircleRules(2000, DEFAULT_PROFILE, is_full_at_zero=False)
    assert CircleMove((-20, 0), (0, 0), 1, rules).plan.seconds == 0


def test_a_circle_runs_at_the_end_speed_at_most_and_without_a_ramp() -> None:
    """Unless a board ramps arcs."""
    fast = CircleRules(8000, DEFAULT_PROFILE)
    move = CircleMove((-1000, 0), (-2000, 0), 1, fast)
    assert float(move.plan.seconds) == pytest.approx(2828.43 / 5000, abs=1e-4)
    soft = CircleMove((-1000, 0), (-2000, 0), 1, CircleRules(8000, DEFAULT_PROFILE, is_ramped=True))
    assert len(soft.plan.phases) == 3
    assert soft.plan.seconds > move.plan.seconds


@given(st.integers(20, 400), st.integers(0, 23), st.integers(1, 23), st.sampled_from((1, -1)))
@settings(max_examples=40)
def test_a_lattice_walk_along_a_circle_stays_inside_the_windows(
    radius: int, first: int, turned: int, direction: int
) -> None:
    """One step of the faster axis per tick, the other one nearest to the circle."""
    begin = first * pi / 12
    last = begin - direction * turned * pi / 12
    centre = (round(-radius * cos(begin)), round(-radius * sin(begin)))
    end = (round(centre[0] + radius * cos(last)), round(centre[1] + radius * sin(last)))
    move = circle(centre, end, direction)
    angle, position = move.first_angle, (0, 0)
    for tick in range(1, int(move.circle_ticks)):
        step = 1 / (move.radius * max(abs(cos(angle)), abs(sin(angle))))
        angle -= direction * step
        position = (
            round(centre[0] + move.radius * cos(angle)),
            round(centre[1] + move.radius * sin(angle)),
        )
        at = Fraction(tick, 2000)
        x_window, y_window, _ = move.windows(at, at)
        assert x_window[0] <= position[0] <= x_window[1]
        assert y_window[0] <= position[1] <= y_window[1]
    done = move.seconds[1] + 1
    assert move.windows(done, done)[:2] == ((end[0],) * 2, (end[1],) * 2)


def test_the_helix_of_the_manual_makes_four_and_a_half_turns() -> None:
    """Clockwise, ending at -2000, 0 with -500 on the traverse, in proportion all the way."""
    helix = circle((-1000, 0), (-2000, 0), 1, traverse=-500, turns=4)
    assert helix.sweep == pytest.approx(9 * pi)
    assert helix.ticks == pytest.approx(9 * 2828.43, abs=1)
    third = helix.plan.seconds / 3
    low, high = helix.windows(third, third)[2]
    assert low <= -167 <= high
    assert high - low < 10
    steep = circle((-10, 0), (-20, 0), 1, traverse=5000)
    assert steep.ticks == 5000


# --- contours -------------------------------------------------------------------------------------


def test_the_contour_of_the_manual_is_planned_as_the_ledger_has_it() -> None:
    """Entry, peak and leaving speed of all five segments at margin 50."""
    plans = planned(CONTOUR, ContourRules(50, DEFAULT_PROFILE))
    for made, (length, cap, entry, peak, leaving, took) in zip(plans, CONTOUR_PLAN, strict=True):
        assert made.segment.length == length
        assert made.cap == cap
        speeds = [float(one) for one in (made.entry, made.plan(DEFAULT_PROFILE).peak, made.leaving)]
        assert speeds == pytest.approx([entry, peak, leaving], abs=0.01)
        assert float(made.plan(DEFAULT_PROFILE).seconds) == pytest.approx(took, abs=1e-5)


@pytest.mark.parametrize(
    ("scope", "at_50", "at_20"),
    [
        (MarginScope.PER_AXIS_PAIR, 0.957, 1.156),
        (MarginScope.PER_AXIS_EQUAL, 1.090, 1.274),
        (MarginScope.MAJOR_ONLY, 0.957, 0.958),
    ],
)
def test_the_readings_of_the_margin_differ_as_the_ledger_says(
    scope: MarginScope, at_50: float, at_20: float
) -> None:
    """The total time at margins 50 and 20."""
    assert seconds(CONTOUR, 50, scope) == pytest.approx(at_50, abs=5e-4)
    assert seconds(CONTOUR, 20, scope) == pytest.approx(at_20, abs=5e-4)


def test_at_margin_20_a_junction_falls_to_1324_and_1344() -> None:
    """That of segments 3 and 4; as separate moves all take 1.475 s."""
    plans = planned(CONTOUR, ContourRules(20, DEFAULT_PROFILE))
    assert float(plans[2].leaving) == pytest.approx(1324, abs=1)
    assert float(plans[3].entry) == pytest.approx(1344, abs=1)
    apart = sum(ramped(one.length, one.speed, DEFAULT_PROFILE).seconds for one in CONTOUR)
    assert float(apart) == pytest.approx(1.475, abs=5e-4)


@pytest.mark.parametrize(
    ("segments", "wanted"),
    [
        ([line(0, 1000, 3000), line(0, 1000, 3000)], 0.8),
        ([line(0, 1000, 3000), line(1, 1000, 3000)], 0.933),
        ([line(0, 1000, 3000), line(0, -1000, 3000)], 0.933),
        ([line(0, 1000, 3000), line(0, 1000, 2000)], 0.941),
    ],
)
def test_the_short_references_of_contours_hold(
    segments: list[ContourSegment], wanted: float
) -> None:
    """A split costs nothing, a corner or a reversal as much as two moves, a slower V its ramp."""
    assert seconds(segments) == pytest.approx(wanted, abs=5e-4)


def test_a_slower_segment_is_entered_at_its_own_speed() -> None:
    """V3000 then V2000: left at 2020, entered at 2000."""
    rules = ContourRules(20, DEFAULT_PROFILE)
    first, second = planned([line(0, 1000, 3000), line(0, 1000, 2000)], rules)
    assert float(first.leaving) == pytest.approx(2020, abs=1e-6)
    assert float(second.entry) == pytest.approx(2000, abs=1e-6)


def test_a_corner_beyond_the_margin_may_keep_the_margin_instead() -> None:
    """The other reading of MN4-AMB-33 is slower there."""
    corner = [line(0, 1000, 3000), line(1, 1000, 3000)]
    rules = ContourRules(20, DEFAULT_PROFILE, has_hard_corners=False)
    first, second = planned(corner, rules)
    assert first.leaving == second.entry == 20


segments_drawn = st.lists(
    st.builds(
        ContourSegment,
        st.tuples(*[st.integers(-600, 600)] * 3, st.integers(-100, 100)),
        st.sampled_from((400, 1500, 3000, 5000)),
    ),
    min_size=1,
    max_size=6,
)


@given(segments_drawn, st.sampled_from((0, 5, 20, 50, 300)))
@settings(max_examples=40)
def test_a_contour_keeps_all_its_bounds(segments: list[ContourSegment], margin: int) -> None:
    """MN4-CC-03, -04, -06, -09: its ends, its margin, its caps, and its time."""
    rules = ContourRules(margin, DEFAULT_PROFILE)
    plans = planned(segments, rules)
    if not plans:
        return
    assert plans[0].entry <= 1000
    assert plans[-1].leaving <= 1000
    for made in plans:
        speed = made.plan(DEFAULT_PROFILE)
        assert float(speed.length) == pytest.approx(made.segment.length, abs=1e-3)
        assert float(speed.peak) <= float(made.cap) + 1e-3
    move = ContourMove(segments, rules)
    apart = sum(ramped(p.segment.length, p.segment.speed, DEFAULT_PROFILE).seconds for p in plans)
    least = sum(p.segment.length / p.cap for p in plans)
    assert float(least) - 1e-6 <= float(move.seconds) <= float(apart) + 1e-6
    wider = ContourMove(segments, ContourRules(margin + 40, DEFAULT_PROFILE))
    assert float(wider.seconds) <= float(move.seconds) + 1e-6
    assert move.windows(move.seconds + 1, move.seconds + 1) == tuple(
        (one, one) for one in move.displacements
    )


def test_the_windows_of_a_contour_go_from_segment_to_segment() -> None:
    """Between two times all that lies between is admissible."""
    move = ContourMove(
        [line(0, 1000, 1000), line(1, -1000, 1000)], ContourRules(20, DEFAULT_PROFILE)
    )
    assert move.windows(Fraction(1, 2), Fraction(1, 2))[:2] == ((500, 500), (0, 0))
    assert move.windows(Fraction(3, 2), Fraction(3, 2))[:2] == ((1000, 1000), (-500, -500))
    assert move.windows(Fraction(9, 10), Fraction(11, 10))[:2] == ((900, 1000), (-100, 0))


# --- pulses and taps ------------------------------------------------------------------------------


def test_pulses_are_shared_out_and_no_more_is_made_than_asked() -> None:
    """300 steps in 1000 pulses; 500 in 2000; backwards as well."""
    assert threaded(300, 500, 1000) == (150, 150)
    assert threaded(300, 501, 1000) == (150, 151)
    assert threaded(-500, 2000, 2000) == (-500, -500)
    assert threaded(500, 9999, 2000) == (500, 500)
    assert threaded(500, -5, 2000) == (0, 0)
    assert can_be_threaded((500, -2000, 0, 0), 2000)
    assert not can_be_threaded((500, -2001, 0, 0), 2000)


def test_taps_keep_their_fractions() -> None:
    """G10,10,10,10,8: five taps are four steps, ten are eight; one is none or one."""
    assert tapped(5, 8, 10) == (4, 4)
    assert tapped(10, 8, 10) == (8, 8)
    assert tapped(1, 8, 10) == (0, 1)
    assert [tapped(1, 8000, res)[0] for res in (2000, 1000, 100, 10)] == [4, 8, 80, 800]


def test_a_spindle_gives_its_pulses_from_when_it_may_have_begun() -> None:
    """At least and at most: by its own doubt, that of the moment, and a pulse of rounding."""
    exact = Spindle(1000, (Fraction(2), Fraction(2)))
    assert exact.pulses((Fraction(1), Fraction(2))) == (0, 1)
    assert exact.pulses((Fraction(3), Fraction(3))) == (999, 1001)
    rough = Spindle(1000, (Fraction(1), Fraction(2)), Fraction(1, 10))
    assert rough.pulses((Fraction(3), Fraction(4))) == (899, 3301)


def test_steps_tell_how_many_pulses_there_were() -> None:
    """All that may have come, and no number beyond those of the move."""
    for done in range(201):
        low, high = threaded_between(100, (done, done), 200)
        for steps in (low, high):
            least, most = pulses_of(steps, 100, 200)
            assert least <= done <= most
            assert (least, most) != (0, 200)
    assert threaded_between(-53, (100, 200), 200) == (-53, -26)
