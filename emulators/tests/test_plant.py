"""The shaft against its set-point: lag, catch-up, inertia, braking, and what comes when."""

from fractions import Fraction
from math import ceil, isqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.errors import UsageError
from axistwin.motion.inertia import Mechanics
from axistwin.motion.interpolator import Interpolator, Segment
from axistwin.motion.plant import Load, Plant
from axistwin.motion.ramp import Ramp, RampedMotion, RampRules
from axistwin.motion.trajectory import TICK_NS, StepPhase

SETTINGS = settings(max_examples=60)
MS = 1_000_000
HELD = Load(held=True)
FREE = Load()
MAC23 = Mechanics(increments_per_turn=2000, rotor_inertia_kgcm2=Fraction(44, 100))
TORQUE_NM = Fraction(14, 10)
MECHANICS = st.sampled_from([None, MAC23])
RATE = MAC23.acceleration(TORQUE_NM, Fraction(0)) * 10**18  # inc/s²


def plant(mechanics: Mechanics | None = None, catch_up_ticks: int = 1600) -> Plant:
    """A shaft at 0 with the full torque of a MAC23."""
    return Plant(mechanics=mechanics, torque_nm=TORQUE_NM, catch_up_ticks=catch_up_ticks)


def move(distance: int, period_ticks: int = 800, aa: int = 0, direction: int = 1) -> RampedMotion:
    """A move from rest at time 0."""
    return RampedMotion.to_target(0, direction, distance, Ramp(period_ticks, aa))


def endless(period_ticks: int = 800, direction: int = 1) -> RampedMotion:
    """An endless motion without a ramp from time 0."""
    return RampedMotion.endless(0, direction, Ramp(period_ticks, 0))


def run_move(shaft: Plant, motion: RampedMotion) -> None:
    """Start ``motion`` in position mode at time 0."""
    target = motion.target
    assert target is not None
    shaft.follow(0, motion.trajectory, motion.trajectory.direction * target)


MOVES = st.builds(
    move, st.integers(1, 400), st.integers(80, 3000), st.integers(0, 1), st.sampled_from([-1, 1])
)
HOLDS = st.lists(
    st.tuples(st.integers(0, 60 * MS), st.integers(1, 60 * MS)), max_size=3
)  # pause before, length


def hold(shaft: Plant, holds: list[tuple[int, int]], polls: st.DataObject | None = None) -> int:
    """Hold the shaft at times; returns when it was released for good."""
    now = 0
    for pause_ns, length_ns in holds:
        for load, wait_ns in ((HELD, pause_ns), (FREE, length_ns)):
            if polls is not None:
                shaft.advance(polls.draw(st.integers(now, now + wait_ns)))
            now += wait_ns
            shaft.set_load(now, load)
    return now


# ---- the ideal shaft ----


@SETTINGS
@given(MOVES, st.integers(0, 10**9))
def test_an_ideal_shaft_is_where_its_set_point_is(motion: RampedMotion, now: int) -> None:
    """§5.4: position = set-point, at every instant; catch-up takes no time."""
    shaft = plant()
    run_move(shaft, motion)
    assert shaft.position_at(now) == motion.trajectory.displacement_at(now)
    assert shaft.set_point_at(now) == shaft.position_at(now)
    assert shaft.settle_ns(0, 0) == motion.end_ns
    assert shaft.rest_ns(0) == motion.end_ns


def test_a_held_shaft_stands_and_then_follows_with_its_lag() -> None:
    """§4.3: the set-point goes on, the shaft makes its steps later by as many increments."""
    shaft = plant()
    run_move(shaft, move(1000))
    shaft.set_load(10 * MS, HELD)
    assert shaft.position_at(10 * MS) == 100
    assert shaft.position_at(30 * MS) == 100
    assert shaft.reach_ns(101, 30 * MS) is None
    assert shaft.settle_ns(30 * MS, 10) is None
    shaft.set_load(30 * MS, FREE)
    assert shaft.position_at(40 * MS) == 200
    assert shaft.set_point_at(40 * MS) == 400
    assert shaft.position_at(100 * MS) == 800


def test_catch_up_makes_one_increment_every_period() -> None:
    """§5.5: after the profile, VV·1600 ticks per increment; within tolerance is settled."""
    shaft = plant(catch_up_ticks=5 * 1600)
    run_move(shaft, move(1000))
    shaft.set_load(10 * MS, HELD)
    shaft.set_load(12 * MS, FREE)
    assert shaft.position_at(100 * MS) == 980
    for n in range(1, 21):
        assert shaft.position_at(100 * MS + n * MS - 1) == 980 + n - 1
        assert shaft.position_at(100 * MS + n * MS) == 980 + n
    assert shaft.settle_ns(50 * MS, 0) == 120 * MS
    assert shaft.settle_ns(50 * MS, 7) == 113 * MS
    assert shaft.is_busy(113 * MS - 1, 7)
    assert not shaft.is_busy(113 * MS, 7)
    assert shaft.rest_ns(0 + 50 * MS) == 120 * MS


def test_a_new_catch_up_speed_applies_from_the_next_increment() -> None:
    """MACS-CMD-0E-02: the increment in progress keeps its period."""
    shaft = plant(catch_up_ticks=8000)
    run_move(shaft, move(1000))
    shaft.set_load(0, HELD)
    shaft.set_load(100 * MS, FREE)
    shaft.set_catch_up(102 * MS + 1, 16000)
    assert shaft.position_at(103 * MS - 1) == 2
    assert shaft.position_at(103 * MS) == 3
    assert shaft.position_at(105 * MS - 1) == 3
    assert shaft.position_at(105 * MS) == 4


def test_a_new_target_in_catch_up_begins_its_step_anew() -> None:
    """The target behind instead of ahead: the first step back a whole period later."""
    motion = move(100)
    shaft = plant()
    run_move(shaft, motion)
    shaft.push(20 * MS, -5)
    shaft.replace(20 * MS + 250_000, motion.trajectory, 90)
    assert shaft.position_at(20 * MS + 450_000 - 1) == 96
    assert shaft.position_at(20 * MS + 450_000) == 95
    assert shaft.rest_ns(20 * MS + 250_000) == 20 * MS + 250_000 + 6 * 200_000


def test_a_shaft_pushed_while_it_brakes_rests_as_much_further() -> None:
    """The push adds to the way of the brake."""
    shaft = plant()
    shaft.follow(0, endless().trajectory)
    shaft.brake(10 * MS, 20)
    shaft.push(11 * MS, 7)
    assert shaft.position_at(10**12) == 127


def test_velocity_mode_does_not_make_up_its_lag() -> None:
    """§5.5: without a target the lag stays for ever, busy only while held."""
    shaft = plant()
    motion = endless()
    shaft.follow(0, motion.trajectory)
    shaft.set_load(10 * MS, HELD)
    assert shaft.is_busy(15 * MS, 0)
    shaft.set_load(20 * MS, FREE)
    assert not shaft.is_busy(20 * MS, 0)
    assert shaft.position_at(3600 * 1000 * MS) == 36_000_000 - 100
    stopped = motion.stop(30 * MS)
    shaft.replace(30 * MS, stopped.trajectory)
    assert shaft.position_at(10**12) == 301 - 100


def test_a_pushed_shaft_comes_back_at_the_catch_up_speed() -> None:
    """§5.5: regulation stays active at rest after a move, and ends with a brake."""
    shaft = plant()
    run_move(shaft, move(10))
    shaft.push(50 * MS, 3)
    assert shaft.position_at(50 * MS) == 13
    assert shaft.position_at(50 * MS + 200_000 - 1) == 13
    assert shaft.position_at(50 * MS + 200_000) == 12
    assert shaft.settle_ns(50 * MS, 0) == 50 * MS + 600_000
    shaft.brake(60 * MS)
    shaft.push(70 * MS, -4)
    assert shaft.position_at(10**12) == 6
    assert not shaft.is_regulating


def test_a_passed_target_is_returned_to_in_catch_up() -> None:
    """§5.3: the descent ends beyond the target; the shaft comes back increment by increment."""
    motion = move(1000, aa=1)
    shaft = plant()
    run_move(shaft, motion)
    now = motion.trajectory.end_of_increment_ns(500)
    moved = motion.retarget(now, -10)
    assert moved.target == 490
    assert moved.end_ns is not None
    shaft.replace(now, moved.trajectory, moved.target)
    assert shaft.position_at(moved.end_ns) == 490 + moved.overshoot
    back_ns = moved.end_ns + moved.overshoot * 1600 * TICK_NS
    assert shaft.settle_ns(now, 0) == back_ns
    assert shaft.position_at(back_ns - 1) == 491
    assert shaft.position_at(back_ns) == 490
    # Within a wide tolerance it settles on the way there, not on the way back.
    assert shaft.settle_ns(now, 500) == now


def test_a_torque_above_the_drives_holds_the_shaft() -> None:
    """A load as strong as the drive stalls it; raising the torque limit frees it."""
    shaft = plant()
    run_move(shaft, move(1000))
    shaft.set_load(10 * MS, Load(torque_nm=1.4))
    assert shaft.position_at(20 * MS) == 100
    shaft.set_torque(20 * MS, Fraction(15, 10))
    assert shaft.position_at(30 * MS) == 200


def test_braking_an_ideal_shaft_takes_no_way_or_the_way_ordered() -> None:
    """§5.7: 0 increments by default; `brake_increments` otherwise, uniformly slowed down."""
    shaft = plant()
    shaft.follow(0, endless().trajectory)
    shaft.brake(10 * MS + 50_000)
    assert shaft.position_at(10**12) == 100
    shaft = plant()
    shaft.follow(0, endless(direction=-1).trajectory)
    shaft.brake(10 * MS, 20)
    rest_ns = shaft.rest_ns(10 * MS)
    # 20 increments from 10 000 inc/s take 2·20/10 000 s.
    assert rest_ns == 14 * MS
    assert shaft.position_at(rest_ns - 1) == -119
    assert shaft.position_at(rest_ns) == -120


# ---- both ----


@pytest.mark.strength
@SETTINGS
@given(MECHANICS, MOVES, HOLDS, st.data())
def test_the_shaft_never_passes_its_set_point_and_ends_on_target(
    mechanics: Mechanics | None, motion: RampedMotion, holds: list[tuple[int, int]],
    data: st.DataObject,
) -> None:  # fmt: skip
    """Monotone, never ahead, never early, exactly on target in the end."""
    shaft = plant(mechanics)
    run_move(shaft, motion)
    released_ns = hold(shaft, holds)
    settled_ns = shaft.settle_ns(released_ns, 0)
    assert settled_ns is not None
    assert motion.end_ns is not None
    direction, target = motion.trajectory.direction, motion.target
    assert target is not None
    assert settled_ns >= min(motion.end_ns, max(released_ns, motion.end_ns))
    instants = sorted(
        data.draw(st.lists(st.integers(released_ns, settled_ns + MS), min_size=2, max_size=20))
    )
    made = [direction * shaft.position_at(t) for t in instants]
    assert made == sorted(made)
    assert all(
        0 <= n <= motion.trajectory.increments_at(t) for n, t in zip(made, instants, strict=True)
    )
    assert shaft.position_at(settled_ns) == direction * target
    assert shaft.position_at(settled_ns + 10**12) == direction * target


@pytest.mark.strength
@SETTINGS
@given(MECHANICS, MOVES, HOLDS, st.data())
def test_polling_changes_nothing(
    mechanics: Mechanics | None, motion: RampedMotion, holds: list[tuple[int, int]],
    data: st.DataObject,
) -> None:  # fmt: skip
    """A shaft that is advanced at any instants is where one is that was left alone."""
    left_alone, polled = plant(mechanics), plant(mechanics)
    for shaft in (left_alone, polled):
        run_move(shaft, motion)
    now = hold(left_alone, holds)
    assert hold(polled, holds, data) == now
    for _ in range(5):
        now = data.draw(st.integers(now, now + 50 * MS))
        polled.advance(now)
        assert polled.position_at(now) == left_alone.position_at(now)
        assert polled.settle_ns(now, 3) == left_alone.settle_ns(now, 3)
        assert polled.rest_ns(now) == left_alone.rest_ns(now)


@pytest.mark.strength
@SETTINGS
@given(MECHANICS, MOVES, HOLDS, st.integers(-450, 450), st.integers(0, 20))
def test_reach_and_settle_are_exact_to_the_nanosecond(
    mechanics: Mechanics | None, motion: RampedMotion, holds: list[tuple[int, int]],
    position: int, tolerance: int,
) -> None:  # fmt: skip
    """There at that instant, not there a nanosecond before."""
    shaft = plant(mechanics)
    run_move(shaft, motion)
    now = hold(shaft, holds)
    reached_ns = shaft.reach_ns(position, now)
    present, direction = shaft.position_at(now), motion.trajectory.direction
    assert motion.target is not None
    on_the_way = direction * (position - present) >= 0 and direction * position <= motion.target
    assert (reached_ns is not None) == on_the_way
    if reached_ns is not None:
        assert shaft.position_at(reached_ns) == position
        assert reached_ns == now or shaft.position_at(reached_ns - 1) == position - direction
    settled_ns = shaft.settle_ns(now, tolerance)
    assert settled_ns is not None
    assert not shaft.is_busy(settled_ns, tolerance)
    assert settled_ns == now or shaft.is_busy(settled_ns - 1, tolerance)


@SETTINGS
@given(
    MECHANICS,
    st.lists(st.tuples(st.integers(-20, 20), st.integers(100, 2000)), min_size=1, max_size=4),
    st.integers(0, 20 * MS),
    st.data(),
)
def test_segments_are_followed_however_the_past_is_forgotten(
    mechanics: Mechanics | None, segments: list[tuple[int, int]], hold_ns: int, data: st.DataObject
) -> None:
    """Advancing before each ``run`` of the interpolator loses nothing."""
    whole, pruned = Interpolator(), Interpolator()
    left_alone, advanced = plant(mechanics), plant(mechanics)
    for shaft, interpolator in ((left_alone, whole), (advanced, pruned)):
        shaft.follow(0, interpolator)
        for steps, period_ticks in segments:
            assert interpolator.offer(0, Segment(steps, period_ticks))
    for load, now in ((HELD, hold_ns), (FREE, hold_ns + MS)):
        advanced.advance(now)
        pruned.run(now)
        left_alone.set_load(now, load)
        advanced.set_load(now, load)
    for _ in range(4):
        now = data.draw(st.integers(now, now + 3 * MS))
        advanced.advance(now)
        pruned.run(now)
        assert advanced.position_at(now) == left_alone.position_at(now)
    if mechanics is None:
        lag = whole.displacement_at(hold_ns + MS) - whole.displacement_at(hold_ns)
        assert advanced.position_at(now) == whole.displacement_at(now) - lag


def test_a_later_motion_starts_where_the_shaft_is() -> None:
    """§5.3: start = present position; the lag of the motion before is forgotten."""
    shaft = plant()
    shaft.follow(0, endless().trajectory)
    shaft.set_load(10 * MS, HELD)
    shaft.set_load(20 * MS, FREE)
    shaft.brake(30 * MS)
    motion = RampedMotion.to_target(40 * MS, -1, 50, Ramp(800, 0))
    shaft.follow(40 * MS, motion.trajectory, -50)
    assert shaft.target == 150
    assert shaft.position_at(10**12) == 150


def test_a_motion_that_counts_at_the_start_of_increments() -> None:
    """MACS-AMB-41: the first increment counts at once, and only once."""
    ramp = Ramp(800, 0, RampRules(step_phase=StepPhase.START))
    shaft = plant()
    motion = RampedMotion.to_target(5 * MS, 1, 10, ramp)
    shaft.follow(5 * MS, motion.trajectory, 10)
    assert shaft.position_at(5 * MS) == 1
    assert shaft.position_at(10**12) == 10


# ---- the inertial shaft ----


def test_the_rate_of_a_mac23_is_that_of_the_ledger() -> None:
    """§5.4: 1.4 Nm on 0.44 kg·cm² give about 1.0·10⁷ inc/s²."""
    assert 1.01e7 < RATE < 1.02e7
    with_load = MAC23.acceleration(TORQUE_NM, Fraction(44, 100)) * 10**18
    assert abs(with_load - RATE / 2) <= 1


def test_an_inertial_shaft_speeds_up_by_the_square_root() -> None:
    """§5.4: increment n from rest at √(2n/a), until the speed of the set-point is reached."""
    shaft = plant(MAC23)
    run_move(shaft, move(1000, period_ticks=200))
    rate = int(RATE)
    # 40 000 inc/s are reached after v²/2a = 79 increments.
    for n in range(1, 79):
        expected_ns = isqrt(2 * n * 10**18 // rate - 1) + 1
        assert abs((shaft.reach_ns(n, 0) or 0) - expected_ns) <= 1
    at_speed_ns = shaft.reach_ns(100, 0)
    assert at_speed_ns is not None
    assert (shaft.reach_ns(101, 0) or 0) - at_speed_ns in (25_000, 25_001)


@pytest.mark.parametrize("aa", [0, 1])
def test_an_inertial_move_ends_exactly_and_without_catch_up(aa: int) -> None:
    """§5.4: the way lost in speeding up is made good in slowing down."""
    motion = move(2000, aa=aa)
    shaft = plant(MAC23, catch_up_ticks=8_000_000)
    run_move(shaft, motion)
    settled_ns = shaft.settle_ns(0, 0)
    assert settled_ns is not None
    assert motion.end_ns is not None
    assert motion.end_ns <= settled_ns < motion.end_ns + MS


@pytest.mark.parametrize("direction", [1, -1])
def test_an_inertial_shaft_brakes_in_v_squared_over_2a(direction: int) -> None:
    """§5.7: ⌈v²/2a⌉ increments on from the position where the brake came."""
    shaft = plant(MAC23)
    shaft.follow(0, endless(200, direction).trajectory)
    position = shaft.position_at(100 * MS)
    shaft.brake(100 * MS)
    way = ceil(Fraction(40_000**2) / (2 * RATE))
    assert way == 79
    assert shaft.position_at(10**12) == position + direction * way
    rest_ns = shaft.rest_ns(100 * MS)
    assert rest_ns is not None
    assert abs(rest_ns - 100 * MS - 2 * way * 10**9 / 40_000) < 30_000


def test_a_shaft_without_power_coasts_until_friction_stops_it() -> None:
    """MACS-CMD-1A-01: no braking; the way is v²·J/2M of friction and load."""
    ways = []
    for load in (FREE, Load(torque_nm=0.5)):
        shaft = plant(MAC23)
        shaft.set_load(0, load)
        shaft.follow(0, endless(200).trajectory)
        before = shaft.position_at(100 * MS)
        shaft.cut_power(100 * MS)
        ways.append(shaft.position_at(10**12) - before)
    friction_rate = MAC23.acceleration(Fraction(2, 100), Fraction(0)) * 10**18
    assert ways[0] == ceil(Fraction(40_000**2) / (2 * friction_rate))
    assert ways[1] < ways[0] / 20


def test_a_weak_drive_is_busy_while_it_gains_speed() -> None:
    """§5.5: in velocity mode busy = real speed below set-point."""
    shaft = plant(MAC23)
    shaft.set_load(0, Load(inertia_kgcm2=100))
    shaft.follow(0, endless(200).trajectory)
    assert shaft.is_busy(10 * MS, 0)
    assert not shaft.is_busy(2000 * MS, 0)


def test_a_drive_without_torque_does_not_turn_an_inertial_shaft() -> None:
    """0Ch 00: no torque, no acceleration."""
    shaft = Plant(mechanics=MAC23)
    run_move(shaft, move(10))
    assert shaft.position_at(10**12) == 0
    shaft.set_torque(10**12, TORQUE_NM)
    assert shaft.position_at(2 * 10**12) == 10


@pytest.mark.parametrize("load", [HELD, Load(torque_nm=2)])
def test_a_held_inertial_shaft_stands_and_starts_from_rest(load: Load) -> None:
    """Held in full speed it stands at once; free again it needs √(2n/a) like any start."""
    shaft = plant(MAC23)
    shaft.follow(0, endless(200).trajectory)
    shaft.set_load(100 * MS, load)
    position = shaft.position_at(100 * MS)
    assert shaft.position_at(200 * MS) == position
    shaft.set_load(200 * MS, FREE)
    first_ns = shaft.reach_ns(position + 1, 200 * MS)
    assert first_ns is not None
    assert abs(first_ns - 200 * MS - isqrt(2 * 10**18 // int(RATE))) <= 2


def test_a_new_motion_takes_a_braking_shaft_over_between_two_increments() -> None:
    """A nanosecond before a step the shaft brakes; the new motion lets it make that step."""
    shaft = plant(MAC23)
    shaft.follow(0, endless(200).trajectory)
    shaft.brake(100 * MS)
    position = shaft.position_at(101 * MS)
    due_ns = shaft.reach_ns(position + 1, 101 * MS)
    assert due_ns is not None
    motion = RampedMotion.endless(due_ns - 1, 1, Ramp(200, 0))
    shaft.follow(due_ns - 1, motion.trajectory)
    assert shaft.reach_ns(position + 1, due_ns - 1) == due_ns


def segments(*parts: tuple[int, int], load: tuple[int, int] | None = None) -> tuple[Plant, int]:
    """An inertial shaft on segments (steps, period) from time 0, and the end of the last.

    ``load``: held from, held until.
    """
    interpolator, shaft = Interpolator(), plant(MAC23)
    shaft.follow(0, interpolator)
    for steps, period_ticks in parts:
        assert interpolator.offer(0, Segment(steps, period_ticks))
    if load is not None:
        shaft.set_load(load[0], HELD)
        shaft.set_load(load[1], FREE)
    return shaft, interpolator.end_ns


def test_a_shaft_turns_where_it_meets_its_set_point_coming_back() -> None:
    """79 behind at 40 000 inc/s when the set-point turns: they meet, and both go back to 0."""
    shaft, end_ns = segments((300, 200), (-300, 200))
    turn_ns = 7 * MS + 500_000
    lag, speed = Fraction(40_000**2) / (2 * RATE), 40_000
    # lag = 2·v·t - a·t²/2
    meeting_s = (2 * speed - (4 * speed**2 - 2 * float(RATE * lag)) ** 0.5) / float(RATE)
    highest = round(300 - speed * meeting_s)
    meeting_ns = turn_ns + round(meeting_s * 1e9)
    assert shaft.position_at(meeting_ns) == highest
    assert shaft.reach_ns(highest + 1, 0) is None
    back_ns = shaft.reach_ns(highest - 1, meeting_ns)
    assert back_ns is not None
    assert back_ns - meeting_ns < isqrt(4 * 10**18 // int(RATE))
    assert shaft.position_at(end_ns + 100 * MS) == 0


def test_a_shaft_ahead_of_its_set_point_slows_down_with_it() -> None:
    """Held on the way out and freed on the way back it is ahead: no way is left to make good."""
    shaft, end_ns = segments((200, 200), (-200, 200), load=(1 * MS, 7 * MS))
    assert shaft.rest_ns(7 * MS) == end_ns
    made = shaft.position_at(7 * MS) - shaft.position_at(end_ns)
    # It gained speed for the 3 ms that were left, and stopped with its set-point.
    assert made == round(RATE * 3**2 / (2 * 1000**2))


def test_a_shaft_that_has_come_up_to_its_set_point_makes_its_very_steps() -> None:
    """Slowing down from 40 000 to 1000 inc/s makes the whole lag good; then step is step."""
    shaft, _ = segments((100, 800), (300, 200), (20, 8000))
    slow_ns = 10 * MS + 7_500_000
    for n in range(410, 421):
        assert shaft.reach_ns(n, 0) == slow_ns + (n - 400) * MS


def test_a_shaft_on_its_set_point_turns_from_rest() -> None:
    """Turning costs the way of speeding up: v/2a later at the first step back."""
    shaft, _ = segments((100, 800), (300, 200), (20, 8000), (-20, 8000))
    turn_ns = 10 * MS + 7_500_000 + 20 * MS
    first_ns = shaft.reach_ns(419, turn_ns)
    assert first_ns is not None
    late_ns = first_ns - turn_ns - MS
    assert abs(late_ns - 1000 * 10**9 / (2 * int(RATE))) < 10


def test_a_pause_between_segments_is_taken_alike_polled_or_not() -> None:
    """The shaft comes to rest on a whole increment, whether or not it is looked at there."""
    shafts = []
    for polls in ((), (8 * MS,)):
        interpolator, shaft = Interpolator(), plant(MAC23)
        shaft.follow(0, interpolator)
        for steps, period_ticks, virtual in ((50, 200, False), (10, 8000, True), (50, 200, False)):
            assert interpolator.offer(0, Segment(steps, period_ticks, virtual))
        for now in polls:
            shaft.advance(now)
        shafts.append(shaft)
    left_alone, polled = shafts
    assert left_alone.position_at(8 * MS) < left_alone.position_at(10**9)
    for n in range(left_alone.position_at(8 * MS), left_alone.position_at(10**9) + 1):
        assert polled.reach_ns(n, 8 * MS) == left_alone.reach_ns(n, 8 * MS)


@pytest.mark.strength
def test_a_long_inertial_run_keeps_its_numbers_small() -> None:
    """Two thousand segments later the exact position is still a fraction of modest size."""
    interpolator, shaft = Interpolator(), plant(MAC23)
    shaft.follow(0, interpolator)
    for n in range(2_000):
        while not interpolator.offer(interpolator.next_event() or 0, Segment(3, 300 + n % 7)):
            due = interpolator.next_event()
            assert due is not None
            shaft.advance(due)
            interpolator.run(due)
    assert shaft._shaft.exact.denominator < 1 << 200
    assert shaft._shaft.speed.denominator < 1 << 200


# ---- the load ----


def test_a_load_takes_numbers_as_they_are_written() -> None:
    """0.1 Nm is one tenth exactly."""
    assert Load(torque_nm=0.1).torque_nm == Fraction(1, 10)
    assert Load(inertia_kgcm2=2).inertia_kgcm2 == 2


@pytest.mark.parametrize("value", [-1, -0.5, float("nan"), float("inf")])
def test_an_impossible_load_is_a_user_mistake(value: float) -> None:
    """One line with the name, the value and the remedy."""
    with pytest.raises(UsageError, match=r"^torque_nm .* is not allowed; give .* at least 0$"):
        Load(torque_nm=value)
