"""The MAC ramp: every table of the ledger tick for tick, and planning anew in mid-motion."""

from collections.abc import Iterable, Iterator
from itertools import islice

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ramp_pieces import climb_pieces, position_pieces, velocity_pieces

from axistwin.motion.ramp import (
    ChangeLaw,
    Ramp,
    RampedMotion,
    RampLaw,
    RampRules,
    Rounding,
    StopLaw,
    TriangleLaw,
    change_pieces,
    level_bounds,
    stop_pieces,
)
from axistwin.motion.trajectory import TICK_NS, Piece, StepPhase

P800 = [12800, 6400, 4267, 3200, 2560, 2133, 1829, 1600, 1422, 1280, 1164, 1067, 985, 914, 853]
SETTINGS = settings(max_examples=100)
RULES = st.builds(
    RampRules,
    st.sampled_from(RampLaw),
    st.sampled_from(Rounding),
    st.sampled_from(TriangleLaw),
    st.sampled_from(ChangeLaw),
    st.sampled_from(StopLaw),
    st.sampled_from(StepPhase),
)
RAMPS = st.builds(Ramp, st.integers(1, 3000), st.integers(0, 3), RULES)


def count(pieces: Iterable[Piece]) -> int:
    """How many increments finite pieces have."""
    return sum(increments or 0 for increments, _ in pieces)


def periods(pieces: Iterable[Piece]) -> Iterator[int]:
    """The period of every increment."""
    for increments, period_ticks in pieces:
        if increments is None:
            while True:
                yield period_ticks
        yield from (period_ticks for _ in range(increments))


def ticks(pieces: Iterable[Piece]) -> int:
    """How long finite pieces take."""
    return sum(periods(pieces))


def table_a(period_ticks: int, aa: int) -> list[int]:
    """Table A of ledger §5.2, written from its definition."""
    table = []
    for j in range(120 * aa):
        k = next(k for k in range(1, 16) if aa * k * (k + 1) // 2 > j)
        table.append((32 * period_ticks + k) // (2 * k))
    return table


def incremental_form(j: int, r: int, table: list[int], period_ticks: int) -> list[int]:
    """The periods still to come by the three-way rule of ledger §5.3."""
    full, result = len(table), []
    while r > 0 or j > 0:
        if r >= j + 2 and j < full:
            result.append(table[j])
            j += 1
        elif r >= j + 1:
            result.append(period_ticks if j == full else table[j])
        else:
            result.append(table[j - 1])
            j -= 1
        r -= 1
    return result


def test_table_a_for_800_ticks() -> None:
    """§5.2: fifteen levels, k·AA increments each, periods rounded half up."""
    expected = [Piece(k, period) for k, period in enumerate(P800, 1)]
    assert list(climb_pieces(800, 1)) == expected
    sevenfold = [Piece(7 * k, period) for k, period in enumerate(P800, 1)]
    assert list(climb_pieces(800, 7)) == sevenfold


@pytest.mark.parametrize("aa", [0, 1, 10, 255])
def test_a_whole_ramp_is_120_aa_increments_in_240_aa_p_ticks(aa: int) -> None:
    """§5.2: 720720 is divisible by 1..15 and 16, so nothing is rounded."""
    pieces = climb_pieces(720720, aa)
    assert count(pieces) == 120 * aa
    assert ticks(pieces) == 240 * aa * 720720


@pytest.mark.parametrize(
    ("rounding", "expected"),
    [(Rounding.HALF_UP, 4267), (Rounding.FLOOR, 4266), (Rounding.CEIL, 4267)],
)
def test_level_three_of_800_is_rounded_as_ruled(rounding: Rounding, expected: int) -> None:
    """16·800/3 = 4266.67 (MACS-AMB-43)."""
    assert climb_pieces(800, 1, RampRules(rounding=rounding))[2].period_ticks == expected


def test_rounding_half_up_and_ceiling_differ_below_one_half() -> None:
    """16·800/9 = 1422.22."""
    by_rule = [climb_pieces(800, 1, RampRules(rounding=r))[8].period_ticks for r in Rounding]
    assert by_rule == [1422, 1422, 1423]


def test_equal_increments_take_405_7_aa_p_ticks() -> None:
    """MACS-AMB-42: 16 levels of 7.5·AA increments, boundaries rounded down."""
    rules = RampRules(ramp_law=RampLaw.EQUAL_INCREMENTS)
    assert level_bounds(120, rules.ramp_law)[:4] == (7, 15, 22, 30)
    pieces = climb_pieces(720720, 2, rules)
    assert [n for n, _ in pieces] == [15] * 16
    assert round(ticks(pieces) / (2 * 720720), 1) == 405.7


@pytest.mark.parametrize(
    ("distance", "aa", "expected_ticks", "peak_level"),
    [
        (1, 1, 12800, 1),
        (2, 1, 25600, 1),
        (10, 1, 68268, 3),
        (100, 1, 243200, 10),
        (239, 1, 383155, 15),
        (240, 1, 384008, 15),
        (241, 1, 384808, 16),
        (1000, 1, 992008, 16),
        (1000, 10, 2432000, 10),
        (10000, 10, 9920080, 16),
    ],
)
def test_examples_of_position_mode(
    distance: int, aa: int, expected_ticks: int, peak_level: int
) -> None:
    """The table of §5.3: total ticks and the highest level."""
    pieces = position_pieces(distance, 800, aa)
    assert count(pieces) == distance
    assert ticks(pieces) == expected_ticks
    assert min(periods(pieces)) == [*P800, 800][peak_level - 1]


SAMPLED_DISTANCES = [
    *range(60), 119, 120, 121, 238, 239, 240, 241, 242, 479, 480, 481, 719, 720, 721, 1234,
    2398, 2399, 2400, 2401, 3333, 4999, 5000,
]  # fmt: skip


@pytest.mark.parametrize("aa", [0, 1, 2, 3, 10])
def test_the_profile_is_the_formula_of_the_ledger(aa: int) -> None:
    """§5.3: T(i) = A[min(i, D-1-i)] within the ramp, else P; and the incremental form agrees."""
    table = table_a(800, aa)
    for distance in SAMPLED_DISTANCES:
        near = (min(i, distance - 1 - i) for i in range(distance))
        formula = [table[d] if d < len(table) else 800 for d in near]
        assert list(periods(position_pieces(distance, 800, aa))) == formula
        assert incremental_form(0, distance, table, 800) == formula


def test_shared_peak_speeds_up_both_middle_increments() -> None:
    """§5.11: both middle increments of D = 12 run at A[6]; odd D and whole ramps mirror."""
    rules = RampRules(triangle_law=TriangleLaw.SHARED_PEAK)
    table = table_a(800, 1)
    expected = [*table[:5], table[6], table[6], *reversed(table[:5])]
    assert list(periods(position_pieces(12, 800, 1, rules))) == expected
    assert position_pieces(13, 800, 1, rules) == position_pieces(13, 800, 1)
    assert position_pieces(240, 800, 1, rules) == position_pieces(240, 800, 1)


@SETTINGS
@given(st.integers(0, 2000), RAMPS)
def test_every_profile_is_its_own_mirror_image(distance: int, ramp: Ramp) -> None:
    """Acceleration and deceleration mirror each other under every law; the sum is the distance."""
    sequence = list(periods(position_pieces(distance, ramp.period_ticks, ramp.aa, ramp.rules)))
    assert sequence == sequence[::-1]
    assert len(sequence) == distance


def test_velocity_mode_climbs_and_goes_on() -> None:
    """§5.7: table A, then P without end; AA = 0 has no ramp."""
    assert velocity_pieces(800, 1) == (*climb_pieces(800, 1), Piece(None, 800))
    assert velocity_pieces(800, 0) == (Piece(None, 800),)


def test_a_stop_mirrors_the_climb() -> None:
    """§5.7: from cruise N increments in 240·AA·P ticks, from counter j the first j reversed."""
    assert list(periods(stop_pieces(120, 800, 1))) == table_a(800, 1)[::-1]
    assert list(periods(stop_pieces(7, 800, 1))) == table_a(800, 1)[:7][::-1]
    assert ticks(stop_pieces(1200, 720720, 10)) == 2400 * 720720
    assert stop_pieces(0, 800, 0) == ()


def test_example_of_a_speed_change() -> None:
    """§5.7: 1600 -> 800, AA 1: boundaries, periods and total."""
    bounds = [5, 11, 18, 24, 31, 39, 46, 54, 63, 71, 80, 90, 99, 109, 120]
    by_level = [
        1506, 1422, 1347, 1280, 1219, 1164, 1113, 1067, 1024, 985, 948, 914, 883, 853, 826,
    ]  # fmt: skip
    pieces = change_pieces(1600, 800, 1)
    starts = [0, *bounds]
    assert pieces == tuple(
        Piece(end - start, period)
        for start, end, period in zip(starts, bounds, by_level, strict=False)
    )
    assert ticks(pieces) == 127674


def test_a_change_from_nearly_rest_is_table_a() -> None:
    """§5.7: with one period growing without bound it becomes the ramp from or to rest."""
    assert change_pieces(10**12, 800, 2) == climb_pieces(800, 2)
    to_rest = [period for _, period in change_pieces(800, 10**12, 2)]
    assert to_rest == [period for _, period in stop_pieces(240, 800, 2)]
    equal = RampRules(ramp_law=RampLaw.EQUAL_INCREMENTS)
    assert change_pieces(10**12, 800, 2, equal) == climb_pieces(800, 2, equal)


@SETTINGS
@given(st.integers(1, 5000), st.integers(1, 5000), st.integers(0, 20))
def test_a_change_takes_n_increments_between_the_two_speeds(old: int, new: int, aa: int) -> None:
    """§5.7: N increments, monotone, never beyond either speed; swapped speeds swap the order."""
    sequence = list(periods(change_pieces(old, new, aa)))
    assert len(sequence) == 120 * aa
    assert sequence == sorted(sequence, reverse=old > new)
    assert all(min(old, new) <= period <= max(old, new) for period in sequence)


def test_other_laws_of_a_speed_change() -> None:
    """MACS-AMB-44: constant acceleration needs 3/4 of N from half to full speed; a step nothing."""
    constant = RampRules(change_law=ChangeLaw.CONSTANT_ACCELERATION)
    assert count(change_pieces(1600, 800, 1, constant)) == 90
    # The ramp of a first speed half as fast is twice as long for the same difference of speeds.
    slow_first = change_pieces(1600, 800, 1, constant, first_ticks=1600)
    assert count(slow_first) == 360
    assert change_pieces(1600, 800, 1, RampRules(change_law=ChangeLaw.STEP)) == ()


# ---- planning anew ----


def assert_goes_on(old: RampedMotion, new: RampedMotion, now: int) -> None:
    """``new`` counts like ``old`` at ``now`` and finishes the increment in progress alike."""
    assert new.trajectory.increments_at(now) == old.trajectory.increments_at(now)
    assert new.trajectory.completed_at(now) == old.trajectory.completed_at(now)
    if old.trajectory.period_at(now) is not None:
        number = old.trajectory.completed_at(now) + 1
        end = old.trajectory.end_of_increment_ns(number)
        assert new.trajectory.end_of_increment_ns(number) == end
    assert new.trajectory.direction == old.trajectory.direction


def rest_of(motion: RampedMotion, now: int, limit: int = 2000) -> list[int]:
    """Periods after the increment in progress at ``now``."""
    trajectory = motion.trajectory
    skip = trajectory.completed_at(now) + 1 - trajectory.before
    return list(islice(periods(trajectory.pieces), skip, skip + limit))


MOTIONS = st.builds(
    lambda ramp, direction, distance: (
        RampedMotion.endless(1000, direction, ramp)
        if distance is None
        else RampedMotion.to_target(1000, direction, distance, ramp)
    ),
    RAMPS,
    st.sampled_from([-1, 1]),
    st.none() | st.integers(1, 1000),
)


def instant(data: st.DataObject, motion: RampedMotion) -> int:
    """A moment from shortly before the start to shortly after the end."""
    end = motion.end_ns
    if end is None:
        end = motion.trajectory.end_of_increment_ns(motion.trajectory.before + 500)
    return data.draw(st.integers(max(0, motion.trajectory.start_ns - 10), end + 10))


@SETTINGS
@given(MOTIONS, st.data())
def test_any_row_of_orders_leaves_a_continuous_motion(
    motion: RampedMotion, data: st.DataObject
) -> None:
    """Stop, change of speed and retarget at any instant keep counts and the running increment."""
    now = 0
    for _ in range(4):
        now = max(now, instant(data, motion))
        if motion.is_over(now):
            break
        order = data.draw(st.sampled_from(["stop", "change", "retarget"]))
        if order == "stop":
            new = motion.stop(now)
        elif order == "change":
            new = motion.change_speed(now, data.draw(st.integers(1, 3000)))
        else:
            new = motion.retarget(now, data.draw(st.integers(-500, 500)))
        assert_goes_on(motion, new, now)
        assert len(new.trajectory.pieces) <= 40
        motion = new


@SETTINGS
@given(MOTIONS, st.data())
def test_a_stop_comes_to_rest_within_the_ramp_and_stays_stopped(
    motion: RampedMotion, data: st.DataObject
) -> None:
    """MACS-CMD-17-01: at most N increments after the one in progress; stopping twice is once."""
    now = instant(data, motion)
    stopped = motion.stop(now)
    total = stopped.trajectory.total_increments
    assert total is not None
    assert total - stopped.trajectory.completed_at(now) <= motion.ramp.length + 1
    assert stopped.stop(now) == stopped
    later = min(stopped.end_ns or 0, now + 1000)
    assert stopped.stop(max(now, later)) == stopped


@SETTINGS
@given(st.integers(1, 1000), st.integers(0, 3), st.data())
def test_a_stop_descends_the_counter(distance: int, aa: int, data: st.DataObject) -> None:
    """§5.7: after the increment in progress A[j-1] … A[0]; the final descent stays as it is."""
    motion = RampedMotion.to_target(0, 1, distance, Ramp(800, aa))
    table = table_a(800, aa)
    assert motion.end_ns is not None
    now = data.draw(st.integers(0, motion.end_ns - 1))
    j = 0
    number = motion.trajectory.completed_at(now) + 1
    for n in range(number):
        left = distance - n
        if left >= j + 2 and j < len(table):
            j += 1
        elif left < j + 1:
            j -= 1
    stopped = motion.stop(now)
    assert rest_of(stopped, now) == table[:j][::-1]
    assert stopped.target == number + j
    assert stopped.overshoot == 0
    if distance - number == j:
        assert stopped.end_ns == motion.end_ns


def test_a_stop_in_mid_ramp_by_the_other_law_takes_the_whole_ramp() -> None:
    """MACS-AMB-45: N increments from the level in use; a descent to the target stays as it is."""
    ramp = Ramp(800, 1, RampRules(stop_law=StopLaw.RAMP_LENGTH))
    motion = RampedMotion.endless(0, 1, ramp)
    in_level_3 = motion.trajectory.end_of_increment_ns(4)
    assert rest_of(motion.stop(in_level_3), in_level_3) == table_a(4267, 1)[::-1]
    move = RampedMotion.to_target(0, 1, 240, ramp)
    in_descent = move.trajectory.end_of_increment_ns(200)
    assert move.stop(in_descent).end_ns == move.end_ns


def test_a_stop_in_a_transition_descends_from_the_level_in_use() -> None:
    """§5.7: N increments whose full speed is the period of the increment in progress."""
    cruise = RampedMotion.endless(0, 1, Ramp(1600, 1))
    now = cruise.trajectory.end_of_increment_ns(500)
    changing = cruise.change_speed(now, 800)
    later = changing.trajectory.end_of_increment_ns(501 + 11)
    assert changing.trajectory.period_at(later) == 1347
    assert rest_of(changing.stop(later), later) == table_a(1347, 1)[::-1]


@SETTINGS
@given(st.integers(1, 3000), st.integers(1, 3000), st.integers(0, 3), st.data())
def test_a_change_of_speed_starts_from_the_period_in_use(
    old: int, new: int, aa: int, data: st.DataObject
) -> None:
    """§5.7: P1 is the period in use when the command arrives; N increments; then P2."""
    motion = RampedMotion.endless(0, -1, Ramp(old, aa))
    now = data.draw(st.integers(0, motion.trajectory.end_of_increment_ns(500)))
    in_use = motion.trajectory.period_at(now)
    assert in_use is not None
    changed = motion.change_speed(now, new)
    expected = [*periods(change_pieces(in_use, new, aa)), new, new]
    assert rest_of(changed, now, len(expected)) == expected
    at_cruise = changed.trajectory.end_of_increment_ns(changed.trajectory.before + 120 * aa + 3)
    assert rest_of(changed.stop(at_cruise), at_cruise) == table_a(new, aa)[::-1]


def test_a_position_motion_becomes_an_endless_one() -> None:
    """MACS-AMB-29: the target is given up, the direction stays."""
    motion = RampedMotion.to_target(0, -1, 1000, Ramp(800, 1))
    now = motion.trajectory.end_of_increment_ns(300)
    changed = motion.change_speed(now, 400)
    assert changed.target is None
    assert changed.end_ns is None
    assert changed.trajectory.direction == -1


@SETTINGS
@given(st.integers(1, 800), st.integers(0, 2), st.integers(-300, 1500), st.data())
def test_retargeting_follows_the_incremental_form(
    distance: int, aa: int, remaining: int, data: st.DataObject
) -> None:
    """§5.3: after the increment in progress the three-way rule goes on with j and the new r."""
    motion = RampedMotion.to_target(0, 1, distance, Ramp(800, aa))
    assert motion.end_ns is not None
    now = data.draw(st.integers(0, motion.end_ns - 1))
    number = motion.trajectory.completed_at(now) + 1
    j = motion.counter_at(motion.trajectory.end_of_increment_ns(number))
    moved = motion.retarget(now, remaining)
    r = motion.trajectory.increments_at(now) + remaining - number
    assert rest_of(moved, now) == incremental_form(j, r, table_a(800, aa), 800)
    assert moved.overshoot == max(0, j - r)


def test_a_passed_target_is_come_back_to_on_a_fresh_profile() -> None:
    """§5.3: the return starts from rest at the end, the other way, by the overshoot."""
    motion = RampedMotion.to_target(0, 1, 1000, Ramp(800, 1))
    now = motion.trajectory.end_of_increment_ns(500)
    moved = motion.retarget(now, -10)
    back = moved.returning()
    assert moved.overshoot == 120 + 11
    assert back is not None
    assert back.trajectory.start_ns == moved.end_ns
    assert back.trajectory.direction == -1
    assert back.trajectory.total_increments == 131
    assert motion.returning() is None


def test_counter_and_level_can_be_told_at_any_time() -> None:
    """j climbs to N, holds and descends; the level goes 1..16..1 and is 0 at rest."""
    motion = RampedMotion.to_target(0, 1, 300, Ramp(800, 1))
    at = motion.trajectory.end_of_increment_ns
    assert [motion.counter_at(at(n)) for n in (1, 2, 120, 180, 181, 299, 300)] == [
        1, 2, 120, 120, 119, 1, 0,
    ]  # fmt: skip
    levels = [motion.level_at(at(n) - 1) for n in (1, 2, 3, 4, 120, 121, 180, 181, 300)]
    assert levels == [1, 2, 2, 3, 15, 16, 16, 15, 1]
    assert motion.level_at(at(300)) == 0


def test_a_segments_speed_is_taken_over() -> None:
    """MACS-AMB-30: the step in progress is finished, then N increments to the new speed."""
    motion = RampedMotion.taking_over(5000, 1, 1600, Ramp(800, 1))
    expected = [1600, *periods(change_pieces(1600, 800, 1)), 800]
    assert list(islice(periods(motion.trajectory.pieces), len(expected))) == expected
    assert motion.trajectory.end_of_increment_ns(1) == 5000 + 1600 * TICK_NS
    assert rest_of(motion.stop(5000), 5000) == table_a(1600, 1)[::-1]


def test_orders_before_a_start_in_the_future() -> None:
    """Nothing is in progress: a stop moves nothing, a change of speed ramps from rest."""
    motion = RampedMotion.endless(1000, 1, Ramp(800, 1))
    assert motion.stop(999).trajectory.total_increments == 0
    assert motion.change_speed(999, 400).trajectory.pieces == velocity_pieces(400, 1)
    move = RampedMotion.to_target(1000, 1, 5, Ramp(800, 1)).retarget(999, 700)
    assert move == RampedMotion.to_target(1000, 1, 700, Ramp(800, 1))


def test_thousands_of_changes_cost_no_memory() -> None:
    """A motion that is changed every few increments stays as short as it was."""
    motion = RampedMotion.endless(0, 1, Ramp(800, 2))
    for n in range(5, 10_000, 5):
        motion = motion.change_speed(motion.trajectory.end_of_increment_ns(n), 500 + n % 700)
    assert len(motion.trajectory.pieces) <= 17
    assert motion.trajectory.before >= 9_990
