"""Arcs and helices of the MN400 (ledger §5.3, §5.4)."""

from collections.abc import Iterator
from itertools import pairwise
from math import atan2, cos, hypot, pi, sin, tau

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from mn400_motions import S, end, rules, times

from axistwin.devices.mn400.motion import (
    MotionRules,
    MoveSettings,
    Plane,
    PulseTrain,
    VectorMotion,
    arc,
    arc_is_round,
    helix,
)
from axistwin.devices.mn400.motion.circle import LatticeCircle

Point = tuple[int, int]
PLANE = Plane()


def points(motion: VectorMotion, plane: Plane = PLANE) -> Iterator[Point]:
    """Every point of the plane that the motion passes, in order."""
    moments = {at_ns for axis in (plane.x, plane.y) for at_ns in times(motion, axis)}
    for at_ns in sorted({motion.since_ns, *moments}):
        position = motion.position_at(at_ns)
        yield position[plane.x], position[plane.y]


@st.composite
def arcs(draw: st.DrawFn, radius_max: int = 150) -> tuple[Point, Point, bool]:
    """(centre, rounded destination, clockwise) as a host would send them."""
    center = draw(st.tuples(*[st.integers(-radius_max, radius_max)] * 2))
    assume(hypot(*center) >= 3)
    angle = draw(st.floats(0, tau))
    radius = hypot(*center)
    destination = (
        round(center[0] + radius * cos(angle)),
        round(center[1] + radius * sin(angle)),
    )
    return center, destination, draw(st.booleans())


def swept(center: Point, destination: Point, clockwise: bool) -> float:
    """The angle of the arc, by the ledger's formula."""
    start = atan2(-center[1], -center[0])
    goal = atan2(destination[1] - center[1], destination[0] - center[0])
    sweep = (start - goal if clockwise else goal - start) % tau
    dead_ahead = destination == (0, 0) or sweep == 0
    return tau if dead_ahead else sweep


@pytest.mark.parametrize(
    ("given", "ticks", "dominant_s", "tangential_s"),
    [
        (((-1000, 0), (-2000, 0), True), 2828, 1.414, 1.5707963),
        (((0, -500), (-354, -146), False), 354, 0.177, 0.1963495),
    ],
)
def test_the_arcs_of_the_manual_take_their_ticks(
    given: tuple[Point, Point, bool], ticks: int, dominant_s: float, tangential_s: float
) -> None:
    """Half a circle and 45 degrees at 2000 steps/s, by both readings of the rate."""
    motion = arc(0, MoveSettings(), PLANE, *given)
    assert end(motion) == dominant_s * S == ticks * S // 2000
    along = arc(0, MoveSettings(rules(arc_rate="tangential")), PLANE, *given)
    assert end(along) == pytest.approx(tangential_s * S, rel=1e-6)
    for moved in (motion, along):
        position = moved.position_at(end(moved))
        assert (position[0], position[2]) == given[1]


def test_a_clockwise_half_circle_goes_below() -> None:
    """From the origin through (-1000, -1000), whatever the end point hides (MN4-ARC-05)."""
    motion = arc(0, MoveSettings(), PLANE, (-1000, 0), (-2000, 0), True)
    assert all(y <= 0 for _, y in points(motion))
    assert motion.position_at(end(motion) // 2) == (-1000, 0, -1000, 0)
    other = arc(0, MoveSettings(), PLANE, (-1000, 0), (-2000, 0), False)
    assert other.position_at(end(other) // 2) == (-1000, 0, 1000, 0)


def check_steps(motion: VectorMotion, center: Point, destination: Point) -> None:
    """End exact, 1.5 steps from the circle, one step per axis and tick (MN4-ARC-03, -04)."""
    radius = hypot(*center)
    slack = 1.5 + abs(hypot(destination[0] - center[0], destination[1] - center[1]) - radius)
    before = (0, 0)
    for point in points(motion):
        assert abs(hypot(point[0] - center[0], point[1] - center[1]) - radius) <= slack
        assert max(abs(point[0] - before[0]), abs(point[1] - before[1])) <= 1
        before = point
    assert before == destination


@pytest.mark.strength
@given(arcs(), st.sampled_from(["dominant_tick", "tangential"]))
@settings(max_examples=100, derandomize=True)
def test_an_arc_ends_exactly_and_stays_by_its_circle(
    given: tuple[Point, Point, bool], rate: str
) -> None:
    """End exact, 1.5 steps from the circle, one step per axis and tick (MN4-ARC-03, -04)."""
    center, destination, _ = given
    motion = arc(0, MoveSettings(rules(arc_rate=rate)), PLANE, *given)
    assert motion.total == (destination[0], 0, destination[1], 0)
    assert motion.position_at(end(motion)) == motion.total
    check_steps(motion, center, destination)


@st.composite
def tolerated(draw: st.DrawFn) -> tuple[Point, Point, bool]:
    """An arc, small or not, whose destination is as far beside the circle as is accepted."""
    center = draw(st.tuples(*[st.integers(-12, 12)] * 2))
    angle, beside = draw(st.floats(0, tau)), draw(st.floats(-2.5, 2.5))
    radius = hypot(*center) + beside
    destination = (
        round(center[0] + radius * cos(angle)),
        round(center[1] + radius * sin(angle)),
    )
    assume(arc_is_round(MotionRules(), center, destination))
    return center, destination, draw(st.booleans())


@pytest.mark.strength
@given(tolerated())
@settings(max_examples=200, derandomize=True)
def test_any_accepted_destination_is_reached(given: tuple[Point, Point, bool]) -> None:
    """Also where rounding is all there is of a circle, end and tolerance are kept."""
    center, destination, _ = given
    motion = arc(0, MoveSettings(), PLANE, *given)
    check_steps(motion, center, destination)


@pytest.mark.strength
@given(arcs())
@settings(max_examples=100, derandomize=True)
def test_an_arc_sweeps_its_angle_in_its_direction(given: tuple[Point, Point, bool]) -> None:
    """Summed up over the points, the angle is that of the ledger, to what rounding hides."""
    center, destination, clockwise = given
    motion = arc(0, MoveSettings(), PLANE, *given)
    angle, before = 0.0, (0, 0)
    for point in points(motion):
        here = (point[0] - center[0], point[1] - center[1])
        there = (before[0] - center[0], before[1] - center[1])
        cross = there[0] * here[1] - there[1] * here[0]
        angle += atan2(cross, there[0] * here[0] + there[1] * here[1])
        before = point
    expected = swept(center, destination, clockwise)
    assert angle == pytest.approx(-expected if clockwise else expected, abs=1e-6)


@given(arcs())
@settings(max_examples=80, derandomize=True)
def test_both_directions_to_one_point_make_a_whole_turn(given: tuple[Point, Point, bool]) -> None:
    """The ticks of both add up to those of the circle, to what rounding hides (P11)."""
    center, destination, _ = given
    assume(destination != (0, 0))
    here, there = (arc(0, MoveSettings(), PLANE, center, destination, way) for way in (True, False))
    whole = arc(0, MoveSettings(), PLANE, center, (0, 0), True)
    assert abs(end(here) + end(there) - end(whole)) <= 4 * S // 2000
    expected = 8 * hypot(*center) / 2**0.5
    assert end(whole) / S * 2000 == pytest.approx(expected, abs=8)


@given(arcs(200))
@settings(max_examples=80, derandomize=True)
def test_mirrored_arcs_are_mirrored(given: tuple[Point, Point, bool]) -> None:
    """With y and the direction turned round, the same points come at the same times."""
    center, destination, clockwise = given
    motion = arc(0, MoveSettings(), PLANE, *given)
    mirrored = arc(
        0,
        MoveSettings(),
        PLANE,
        (-center[0], center[1]),
        (-destination[0], destination[1]),
        not clockwise,
    )
    assert end(motion) == end(mirrored)
    for part in range(9):
        at_ns = end(motion) * part // 8
        x, _, y, _ = motion.position_at(at_ns)
        assert mirrored.position_at(at_ns) == (-x, 0, y, 0)


@given(st.integers(1, 10**9))
@settings(max_examples=200, derandomize=True)
def test_the_lattice_circle_inverts_its_own_formulas(squared: int) -> None:
    """Ticks of steps and steps of ticks agree anywhere on a circle of any size."""
    circle = LatticeCircle.of(squared)
    for part in range(33):
        tick = 4 * circle.quarter * part // 32
        steps = circle.steps_until(tick)
        assert steps == 0 or circle.tick_of(steps) <= tick
        assert circle.tick_of(steps + 1) > tick
        x, y = circle.across(tick), circle.across(tick + circle.quarter)
        assert circle.after(steps) == x
        assert abs(hypot(x, y) - squared**0.5) <= 0.75
        moved = circle.across(circle.tick_of(steps + 1)) - x
        assert moved == circle.heading(steps + 1)
        assert circle.last_alike(steps + 1) >= steps + 1


@pytest.mark.parametrize(
    ("center", "destination", "is_round"),
    [
        ((0, -500), (-354, -146), True),
        ((-1000, 0), (-500, 0), False),
        ((-1000, 0), (-2002, 0), True),
        ((-1000, 0), (-2003, 0), False),
        ((-20, 0), (0, 0), True),
        ((0, 0), (5, 5), False),
        ((3, 4), (3, 4), False),
    ],
)
def test_radii_may_differ_by_two_and_a_half_steps(
    center: Point, destination: Point, is_round: bool
) -> None:
    """The tolerance of MN4-ARC-02, and no arc without a radius (MN4-ARC-07)."""
    assert arc_is_round(MotionRules(), center, destination) is is_round


def test_an_exact_tolerance_is_exact() -> None:
    """A reading without tolerance takes equal radii and nothing else."""
    exact = rules(arc_radius_tol="0")
    assert arc_is_round(exact, (-3, -4), (-8, -4))
    assert arc_is_round(exact, (-5, 0), (-8, 4))
    assert not arc_is_round(exact, (-5, 0), (-8, 5))


def test_an_arc_to_its_start_is_a_whole_turn_or_nothing() -> None:
    """Both readings of MN4-AMB-29."""
    motion = arc(0, MoveSettings(), PLANE, (-20, 0), (0, 0), True)
    assert end(motion) == 112 * S // 2000
    assert motion.path_left_at(0) == (80, 0, 80, 0)
    assert motion.remaining_at(0) == (0, 0, 0, 0)
    nothing = arc(0, MoveSettings(rules(arc_zero_sweep="none")), PLANE, (-20, 0), (0, 0), True)
    assert end(nothing) == 0


def test_arcs_run_without_a_ramp_and_pause_at_once() -> None:
    """At the speed clipped to the end speed throughout, by the default reading (MN4-MOT-13)."""
    made = MoveSettings(speed=8000)
    motion = arc(0, made, PLANE, (-1000, 0), (-2000, 0), True)
    assert end(motion) == 2828 * S // 5000
    paused = motion.pause(S // 10)
    assert paused.rest_ns == S // 10
    assert paused.resume(S).end_ns == S - S // 10 + end(motion)
    ramped = MoveSettings(rules(arc_ramp=True), speed=8000)
    assert end(arc(0, ramped, PLANE, (-1000, 0), (-2000, 0), True)) > end(motion)


@given(arcs(100), st.integers(-900, 900), st.integers(0, 3), st.integers(0, 1000))
@settings(max_examples=120, derandomize=True)
def test_a_helix_traverses_in_proportion_to_the_angle(
    given: tuple[Point, Point, bool], traverse: int, turns: int, share: int
) -> None:
    """z = round(zd·θ/Θ) to a step, over all turns and the last arc (MN4-HEL-01, -02)."""
    center, destination, clockwise = given
    motion = helix(0, MoveSettings(), PLANE, *given, traverse, turns)
    assert motion.position_at(end(motion)) == (destination[0], traverse, destination[1], 0)
    one_turn = end(arc(0, MoveSettings(), PLANE, center, (0, 0), clockwise))
    last_arc = end(arc(0, MoveSettings(), PLANE, *given))
    ticks = (turns * one_turn + last_arc) * 2000 // S
    assert end(motion) == max(ticks, abs(traverse)) * S // 2000
    at_ns = end(motion) * share // 1000
    x, z, y, _ = motion.position_at(at_ns)
    whole = swept(center, destination, clockwise) + tau * turns
    angle = atan2(y - center[1], x - center[0]) - atan2(-center[1], -center[0])
    angle = -angle if clockwise else angle
    expected = whole * z / traverse if traverse else angle
    off = (angle - expected + pi) % tau - pi
    radius = hypot(*center)
    assert abs(off) <= (whole / abs(traverse) if traverse else 0) + 3.5 / radius


def test_the_helix_of_the_manual_turns_four_and_a_half_times() -> None:
    """`+-1000,0,-2000,0,1,-500,4`: to X -2000, Y 0, Z -500."""
    motion = helix(0, MoveSettings(), PLANE, (-1000, 0), (-2000, 0), True, -500, 4)
    assert motion.total == (-2000, -500, 0, 0)
    assert end(motion) == 9 * 2828 * S // 2000
    assert motion.position_at(end(motion) * 8 // 9) == (0, -444, 0, 0)
    assert motion.position_at(end(motion)) == (-2000, -500, 0, 0)
    assert len(list(motion.steps(0, 0, end(motion)))) == 9 * 2000


def test_a_helix_that_mostly_traverses_does_so_evenly() -> None:
    """The traverse has most steps, one with each tick; the circle goes with it (ledger §5.4)."""
    motion = helix(0, MoveSettings(), PLANE, (-50, 0), (0, 0), True, 1000)
    assert end(motion) == S // 2
    steps = [step.at_ns for step in motion.steps(1, 0, end(motion))]
    assert len(steps) == 1000
    assert {b - a for a, b in pairwise(steps)} == {S // 2000}
    for axis in (0, 2):
        times = [step.at_ns for step in motion.steps(axis, 0, end(motion))]
        assert all(b - a > S // 2000 for a, b in pairwise(times))
    middle = motion.position_at(end(motion) // 4)
    assert middle[1] == 250
    assert max(abs(middle[0] + 50), abs(middle[2] + 50)) <= 1


def test_a_helix_and_its_mirror_image_step_at_the_same_nanoseconds() -> None:
    """Also where floats are rounded: at 2 steps/s each bit of them is seen."""
    made = MoveSettings(speed=2)
    here = helix(0, made, PLANE, (51, 10), (0, 0), True, 365, 2)
    there = helix(0, made, PLANE, (-51, -10), (0, 0), True, -365, 2)
    for axis in range(4):
        mirrored = [
            step._replace(direction=-step.direction) for step in there.steps(axis, 0, end(there))
        ]
        assert list(here.steps(axis, 0, end(here))) == mirrored


def test_a_helix_of_only_a_traverse_is_a_straight_line() -> None:
    """No sweep (by the other reading of a last arc of nothing) leaves the traverse alone."""
    made = MoveSettings(rules(arc_zero_sweep="none"))
    motion = helix(0, made, PLANE, (-20, 0), (0, 0), True, -40)
    assert end(motion) == 40 * S // 2000
    assert motion.position_at(end(motion) // 2) == (0, -20, 0, 0)


def test_the_traverse_motor_may_be_in_the_plane_of_an_arc() -> None:
    """`P1,2` leaves Z at 2; the arc moves 1 and 2 all the same (MN4-CMD-P-03)."""
    motion = arc(0, MoveSettings(), Plane(0, 1, 1), (-1000, 0), (-2000, 0), True)
    assert motion.position_at(end(motion) // 2) == (-1000, -1000, 0, 0)
    assert motion.position_at(end(motion)) == (-2000, 0, 0, 0)


def test_an_arc_on_pulses_makes_a_tick_with_each() -> None:
    """With a negative V each pulse is a tick, whatever the reading of the rate (MN4-SYN-01)."""
    for rate in ("dominant_tick", "tangential"):
        made = MoveSettings(rules(arc_rate=rate), speed=-1)
        motion = arc(0, made, PLANE, (-1000, 0), (-2000, 0), True)
        assert motion.end_ns is None
        motion = motion.feed(S, 1414)
        assert motion.position_at(S) == (-1000, 0, -1000, 0)
        motion = motion.paced_by(2 * S, PulseTrain(1_000_000))
        assert motion.end_ns == 2 * S + 1414 * S // 1000
        assert motion.position_at(end(motion)) == (-2000, 0, 0, 0)


@given(arcs(100), st.integers(-300, 300), st.integers(0, 2), st.integers(0, 1000))
@settings(max_examples=80, derandomize=True)
def test_a_paused_helix_loses_no_step(
    given: tuple[Point, Point, bool], traverse: int, turns: int, share: int
) -> None:
    """Steps before and behind a pause are all steps, each made once."""
    motion = helix(0, MoveSettings(), PLANE, *given, traverse, turns)
    at_ns = end(motion) * share // 1000
    resumed = motion.pause(at_ns).resume(at_ns + S)
    for axis in range(4):
        steps = [*motion.steps(axis, -1, at_ns), *resumed.steps(axis, at_ns, end(resumed))]
        assert len(steps) == motion.path_left_at(-1)[axis]
        assert sum(step.direction for step in steps) == motion.total[axis]
    assert abs(end(resumed) - end(motion) - (S if share < 1000 else 0)) <= 1


@given(arcs(100), st.integers(-300, 300), st.integers(0, 1000))
@settings(max_examples=60, derandomize=True)
def test_the_next_step_in_a_direction_is_found_behind_a_turn(
    given: tuple[Point, Point, bool], traverse: int, share: int
) -> None:
    """A limit behind the turn of an axis trips when the axis comes back to it."""
    motion = helix(0, MoveSettings(), PLANE, *given, traverse)
    at_ns = end(motion) * share // 1000
    for axis in range(4):
        steps = list(motion.steps(axis, at_ns, end(motion)))
        for direction in (0, 1, -1):
            matching = [step for step in steps if direction in (0, step.direction)]
            expected = matching[0] if matching else None
            assert motion.next_step(axis, at_ns, direction) == expected
