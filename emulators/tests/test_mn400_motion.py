"""Straight moves of the MN400: ramps, interpolation, step times (ledger §5.1, §5.2)."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from math import isqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mn400_motions import S, end, negated, rules, times

from axistwin.devices.mn400.motion import (
    MoveSettings,
    SpeedProfile,
    VectorMotion,
    straight,
)

DEFAULT = (1000, 5000, 10000)
EXAMPLE = (1000, 4000, 4000)

displacements = st.tuples(*[st.integers(-300, 300)] * 4)
profiles = st.tuples(st.integers(2, 3000), st.integers(0, 20000), st.integers(1, 100_000)).map(
    lambda given: SpeedProfile(given[0], given[0] + given[1], given[2])
)
moves = st.builds(
    lambda profile, speed, multiplex, phase, start, displacement: straight(
        start,
        MoveSettings(rules(dda_phase=phase), profile, speed, multiplex),
        displacement,
    ),
    profiles,
    st.integers(2, 30_000),
    st.sampled_from([1, 2, 4]),
    st.sampled_from(["half", "zero", "full"]),
    st.integers(0, 10**15),
    displacements,
)


@pytest.mark.parametrize(
    ("profile", "speed", "steps", "whole_s", "half_s"),
    [
        (EXAMPLE, 2000, 10000, "5.125", "5.250"),
        (EXAMPLE, 3000, 10000, "3.6666666667", "4.000"),
        (DEFAULT, 2000, 10000, "5.050", "5.100"),
        (DEFAULT, 8000, 20000, "4.320", "4.640"),
        (DEFAULT, 5000, 500, "0.2898979486", "0.3483314774"),
        (DEFAULT, 3000, 800, "0.400", "0.4944271910"),
        (DEFAULT, 500, 1000, "2.000", "2.000"),
    ],
)
def test_moves_last_as_the_ledger_reckons(
    profile: tuple[int, int, int], speed: int, steps: int, whole_s: str, half_s: str
) -> None:
    """Durations of the reference table, by both readings of the acceleration (MN4-AMB-25)."""
    for scale, expected in (("1.0", whole_s), ("0.5", half_s)):
        read = rules(accel_scale=scale)
        motion = straight(0, MoveSettings(read, SpeedProfile(*profile), speed), (steps, 0, 0, 0))
        assert abs(end(motion) - Fraction(expected) * S) < 1
        assert motion.step_time_ns(0, steps) == motion.end_ns


@pytest.mark.parametrize(
    ("profile", "speed", "steps", "scale", "ramp_steps", "ramp_s"),
    [
        (EXAMPLE, 2000, 10000, "1.0", 375, 0.25),
        (EXAMPLE, 2000, 10000, "0.5", 750, 0.50),
        (EXAMPLE, 3000, 10000, "1.0", 1000, 0.50),
        (EXAMPLE, 3000, 10000, "0.5", 2000, 1.00),
        (DEFAULT, 2000, 10000, "1.0", 150, 0.10),
        (DEFAULT, 8000, 20000, "1.0", 1200, 0.40),
        (DEFAULT, 5000, 500, "1.0", 250, 0.1449),
        (DEFAULT, 3000, 800, "1.0", 400, 0.20),
    ],
)
def test_ramps_are_as_long_as_the_ledger_reckons(
    profile: tuple[int, int, int],
    speed: int,
    steps: int,
    scale: str,
    ramp_steps: int,
    ramp_s: float,
) -> None:
    """Steps and time of the reference table, at both ends of the move."""
    made = MoveSettings(rules(accel_scale=scale), SpeedProfile(*profile), speed)
    motion = straight(0, made, (steps, 0, 0, 0))
    at_ns = motion.step_time_ns(0, ramp_steps)
    left_ns = motion.step_time_ns(0, steps - ramp_steps)
    assert at_ns is not None
    assert left_ns is not None
    assert at_ns / S == pytest.approx(ramp_s, abs=0.00005)
    assert (end(motion) - left_ns) / S == pytest.approx(ramp_s, abs=0.00005)


def test_a_short_move_has_the_peak_of_the_ledger() -> None:
    """500 steps with the default profile: 2449.5 steps/s (MN4-MOT-11)."""
    gaps = [
        b - a for a, b in pairwise(times(straight(0, MoveSettings(speed=5000), (500, 0, 0, 0)), 0))
    ]
    assert S / min(gaps) == pytest.approx(2449.5, rel=0.002)


@given(profiles, st.integers(2, 30_000), displacements, st.permutations(range(4)))
@settings(max_examples=80)
def test_more_speed_or_acceleration_never_takes_longer(
    profile: SpeedProfile, speed: int, displacement: tuple[int, int, int, int], order: list[int]
) -> None:
    """And which axes move, and how finely, changes nothing (property P9 of the ledger)."""
    ended = end(straight(0, MoveSettings(profile=profile, speed=speed), displacement))
    for faster in (
        MoveSettings(profile=profile, speed=speed + 100),
        MoveSettings(profile=replace(profile, acceleration=profile.acceleration + 50), speed=speed),
    ):
        assert end(straight(0, faster, displacement)) <= ended + 1
    first, second, third, fourth = (displacement[axis] for axis in order)
    made = MoveSettings(profile=profile, speed=speed, multiplex=1 + order[0] % 2)
    assert end(straight(0, made, (first, second, third, fourth))) == ended


@pytest.mark.parametrize(
    ("scale", "ramp_steps", "ramp_s"), [("1.0", 375, "0.25"), ("0.5", 750, "0.5")]
)
def test_the_worked_example_reaches_speed_after_its_ramp(
    scale: str, ramp_steps: int, ramp_s: str
) -> None:
    """The ramp from 1000 to 2000 steps/s at 4000 steps/s² and its mirror at the end."""
    motion = straight(
        0,
        MoveSettings(rules(accel_scale=scale), SpeedProfile(*EXAMPLE), 2000),
        (0, -10000, 0, 0),
    )
    assert motion.step_time_ns(1, ramp_steps) == Fraction(ramp_s) * S
    for n in (ramp_steps, 5000, 10000 - ramp_steps - 1):
        assert times_between(motion, 1, n) == S // 2000
    first, last = times(motion, 1)[0], times_between(motion, 1, 9999)
    assert abs(first - last) <= 1


def times_between(motion: VectorMotion, axis: int, n: int) -> int:
    """From step ``n`` to the one behind it."""
    before, after = motion.step_time_ns(axis, n), motion.step_time_ns(axis, n + 1)
    assert before is not None
    assert after is not None
    return after - before


def ramp_time_ns(profile: SpeedProfile, speed: int, steps: int, n: int) -> int:
    """The time of step ``n`` by the formulas of the ledger, in whole ns, rounded down."""
    start, a = profile.start, profile.acceleration
    scale = 10**30

    def root(square: Fraction) -> Fraction:
        return Fraction(isqrt(int(square * scale * scale)), scale)

    if speed <= start:
        return int(Fraction(n, min(speed, profile.end)) * S)
    top = min(Fraction(min(speed, profile.end)) ** 2, start * start + Fraction(a) * steps)
    ramp = (top - start * start) / (2 * a)

    def climb(s: Fraction) -> Fraction:
        return (root(start * start + 2 * a * s) - start) / a

    cruise = (steps - 2 * ramp) / root(top)
    if n <= ramp:
        exact = climb(Fraction(n))
    elif n <= steps - ramp:
        exact = climb(ramp) + (n - ramp) / root(top)
    else:
        exact = 2 * climb(ramp) + cruise - climb(Fraction(steps - n))
    return int(exact * S)


@given(profiles, st.integers(2, 30_000), st.integers(1, 100_000), st.data())
@settings(max_examples=150)
def test_every_step_comes_when_the_speed_has_summed_up_to_it(
    profile: SpeedProfile, speed: int, steps: int, data: st.DataObject
) -> None:
    """Step times against the ledger's formulas with 30 digits, to the nearest nanosecond."""
    motion = straight(0, MoveSettings(profile=profile, speed=speed), (steps, 0, 0, 0))
    for n in (1, data.draw(st.integers(1, steps)), steps):
        at_ns = motion.step_time_ns(0, n)
        assert at_ns is not None
        assert at_ns - ramp_time_ns(profile, speed, steps, n) in (0, 1)


@given(moves)
@settings(max_examples=150)
def test_a_move_ends_exactly_and_positions_agree_with_step_times(motion: VectorMotion) -> None:
    """The end is the target, and each step shows at its own nanosecond and not before."""
    assert motion.position_at(end(motion)) == motion.total
    assert motion.remaining_at(end(motion)) == (0, 0, 0, 0)
    assert motion.position_at(motion.since_ns) == (0, 0, 0, 0)
    for axis, target in enumerate(motion.total):
        sign = 1 if target > 0 else -1
        for n, at_ns in list(enumerate(times(motion, axis), 1))[:: 1 + abs(target) // 7]:
            assert motion.position_at(at_ns)[axis] * sign >= n
            assert motion.position_at(at_ns - 1)[axis] * sign < n


@given(moves)
@settings(max_examples=100)
def test_all_axes_stay_on_the_chord_and_end_together(motion: VectorMotion) -> None:
    """Each axis is within one step of its share of the major axis' way (MN4-CMD-M-01)."""
    longest = max(map(abs, motion.total))
    if not longest:
        return
    major = next(axis for axis in range(4) if abs(motion.total[axis]) == longest)
    for at_ns in times(motion, major)[:: 1 + longest // 20]:
        position = motion.position_at(at_ns)
        for axis in range(4):
            share = Fraction(motion.total[axis] * abs(position[major]), longest)
            assert abs(position[axis] - share) <= 1


@given(moves)
@settings(max_examples=100)
def test_no_interval_is_shorter_than_speed_and_acceleration_allow(motion: VectorMotion) -> None:
    """The major axis never exceeds its cap, and never gains more than the ramp in a step."""
    longest = max(map(abs, motion.total))
    major = next(axis for axis in range(4) if abs(motion.total[axis]) == longest)
    made = motion.settings
    multi = sum(map(bool, motion.total)) > 1
    cap = made.cap(made.speed, made.multiplex if multi else 1, 1000)
    gaps = [after - before for before, after in pairwise(times(motion, major))]
    assert all(gap >= S // cap - 1 for gap in gaps)
    for before, after in pairwise(gaps):
        gain = abs(Fraction(S, after) - Fraction(S, before))
        rounding = Fraction(2 * cap * cap, S)
        limit = made.profile.acceleration * Fraction(before + after, 2 * S)
        assert gain <= limit + rounding


@pytest.mark.parametrize("phase", ["half", "zero", "full"])
@pytest.mark.parametrize("multiplex", [1, 2, 4])
def test_the_multiplex_leaves_the_major_axis_its_times(multiplex: int, phase: str) -> None:
    """Its k-th step is when the speed has summed up to k, at each m-th tick (ledger §5.1, §5.2)."""
    made = MoveSettings(rules(dda_phase=phase), speed=500, multiplex=multiplex)
    motion = straight(0, made, (7, 100, -100, 99))
    assert times(motion, 1) == times(motion, 2) == [k * S // 500 for k in range(1, 101)]


@given(displacements, profiles, st.integers(2, 30_000), st.sampled_from([1, 2, 4]))
@settings(max_examples=80)
def test_mirrored_input_gives_mirrored_output(
    displacement: tuple[int, int, int, int], profile: SpeedProfile, speed: int, multiplex: int
) -> None:
    """Signs of the displacement change nothing but the signs of the positions."""
    made = MoveSettings(profile=profile, speed=speed, multiplex=multiplex)
    here, there = straight(0, made, displacement), straight(0, made, negated(displacement))
    assert here.end_ns == there.end_ns
    for part in range(5):
        at_ns = end(here) * part // 4
        assert here.position_at(at_ns) == tuple(-one for one in there.position_at(at_ns))


@given(moves, st.lists(st.integers(0, 1000), min_size=1, max_size=5))
@settings(max_examples=80)
def test_steps_between_any_times_are_the_difference_of_positions(
    motion: VectorMotion, cuts: Sequence[int]
) -> None:
    """Steps are listed once, in order, with their times and directions."""
    whole = end(motion) - motion.since_ns
    marks = [motion.since_ns, *sorted(motion.since_ns + whole * cut // 1000 for cut in cuts)]
    for axis in range(4):
        for before, after in pairwise(marks):
            steps = list(motion.steps(axis, before, after))
            moved = motion.position_at(after)[axis] - motion.position_at(before)[axis]
            assert sum(step.direction for step in steps) == moved
            assert len(steps) == abs(moved)
            assert all(before < step.at_ns <= after for step in steps)
            assert steps == sorted(steps)


@pytest.mark.parametrize(("multiplex", "ticks"), [(1, 2000), (2, 4000), (4, 8000)])
def test_phantom_ticks_count_the_major_axis_times_the_multiplex(multiplex: int, ticks: int) -> None:
    """A multi-axis move counts m ticks a step, a single axis none; the duration stays."""
    made = MoveSettings(speed=1000, multiplex=multiplex)
    motion = straight(0, made, (3000, -1, 0, 0))
    assert motion.phantom_at(2 * S) == ticks
    assert end(motion) == 3 * S
    assert straight(0, made, (3000, 0, 0, 0)).phantom_at(2 * S) == 0


def test_multiplexed_moves_are_limited_to_their_share_of_the_step_rate() -> None:
    """100 000 / m steps/s with more than one axis, by the default reading (MN4-AMB-65)."""
    profile = SpeedProfile(100_000, 100_000, 1)
    for cap, expected in (("clip", 4 * S), ("none", S)):
        made = MoveSettings(rules(multiplex_cap=cap), profile, 100_000, 4)
        assert straight(0, made, (100_000, 1, 0, 0)).end_ns == expected
        assert straight(0, made, (100_000, 0, 0, 0)).end_ns == S


@pytest.mark.parametrize(("phase", "first_ns", "early_ns"), [("end", S // 2, 0), ("start", 0, -1)])
def test_the_step_phase_decides_when_a_step_is_made(
    phase: str, first_ns: int, early_ns: int
) -> None:
    """V2, M1: after half a second, or at once (MN4-AMB-71)."""
    motion = straight(0, MoveSettings(rules(step_phase=phase), speed=2), (1, 0, 0, 0))
    assert motion.step_time_ns(0, 1) == first_ns
    assert motion.position_at(first_ns) == (1, 0, 0, 0)
    assert [step.at_ns for step in motion.steps(0, early_ns, S)] == [first_ns]
    assert motion.end_ns == S // 2


def test_a_move_of_nothing_is_over_at_once() -> None:
    """Zero displacement takes no time and makes no step (MN4-CMD-M-04)."""
    motion = straight(7, MoveSettings(), (0, 0, 0, 0))
    assert motion.end_ns == 7
    assert motion.is_over_at(7)
    assert motion.position_at(7) == motion.remaining_at(7) == motion.headings_at(7) == (0, 0, 0, 0)
    assert motion.pause(7) is motion
    assert motion.next_step(0, 0) is None


def test_positions_after_the_longest_move_are_exact() -> None:
    """2 147 483 647 steps at 2 steps/s last 34 years; each end of a step is known."""
    steps = 2**31 - 1
    motion = straight(0, MoveSettings(speed=2), (steps, 0, 0, 1))
    assert motion.end_ns == steps * S // 2
    assert motion.position_at(10**18) == (2 * 10**9, 0, 0, 1)
    assert motion.position_at(10**18 - 1) == (2 * 10**9 - 1, 0, 0, 1)
