"""Continuous contouring of the MN400: look-ahead and margin (ledger §5.5)."""

from collections.abc import Collection, Sequence
from itertools import pairwise
from math import inf, sqrt

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mn400_motions import S, end, negated, rules, times

from axistwin.devices.mn400.motion import (
    ContourSegment,
    MoveSettings,
    PulseTrain,
    SpeedProfile,
    contour,
    straight,
)
from axistwin.devices.mn400.motion.lookahead import SpeedPlan, limits_of, seam_between
from axistwin.devices.mn400.motion.moves import TOP_SPEED, straight_part
from axistwin.devices.mn400.motion.pace import TimedPace
from axistwin.devices.mn400.motion.timeline import FINE

EXAMPLE = [
    ContourSegment((500, 0, 500, 0), 3000),
    ContourSegment((505, 0, 500, 0), 3000),
    ContourSegment((509, 0, 500, 0), 3000),
    ContourSegment((530, 0, 505, 0), 3850),
    ContourSegment((520, 0, 510, 0), 3850),
]
axis_steps = st.one_of(st.integers(-40, 40), st.integers(180, 220), st.just(0))
segments = st.builds(
    ContourSegment, st.tuples(*[axis_steps] * 4), st.one_of(st.integers(2, 6000), st.just(3000))
)
contours = st.lists(segments.filter(lambda one: any(one.displacement)), min_size=1, max_size=9)
profiles = st.tuples(st.integers(2, 2000), st.integers(0, 5000), st.integers(100, 40_000)).map(
    lambda given: SpeedProfile(given[0], given[0] + given[1], given[2])
)


def planned(made: MoveSettings, parts: Sequence[ContourSegment], margin: int) -> SpeedPlan:
    """The plan of a contour."""
    stretches = [straight_part(made, *part).stretch for part in parts]
    limits = [limits_of(stretch, made, 1000) for stretch in stretches]
    seams = [
        seam_between(one.displacement, other.displacement, margin, made, TOP_SPEED)
        for one, other in pairwise(parts)
    ]
    return SpeedPlan(limits, seams)


def whole(speed: int) -> float:
    """A speed in steps/s."""
    return speed / (1 << FINE)


def test_below_start_speed_a_segment_has_one_speed_whatever_a_corner_has() -> None:
    """There is no ramp by which it could slow down (MN4-CMD-V-03); 20 steps at 100 steps/s."""
    for corner in ("start_speed", "margin"):
        made = MoveSettings(rules=rules(cc_corner_speed=corner))
        parts = [ContourSegment((10, 0, 0, 0), 100), ContourSegment((-10, 0, 0, 0), 100)]
        assert end(contour(0, made, parts, 20)) == S // 5


def test_the_contour_of_the_manual_is_planned_as_the_ledger_reckons() -> None:
    """Entry, peak, exit and time of all five segments at margin 50."""
    plan = planned(MoveSettings(), EXAMPLE, 50)
    entries = [1000, 3000, 3000, 3050, 3376.39]
    exits = [3000, 3000, 3000, 3426.39, 1000]
    seconds = [0.23333, 0.16833, 0.16967, 0.14830, 0.23764]
    assert [whole(speed) for speed in plan.entries] == pytest.approx(entries, abs=0.005)
    assert [whole(speed) for speed in plan.exits] == pytest.approx(exits, abs=0.005)
    motion = contour(0, MoveSettings(), EXAMPLE, 50)
    made = times(motion, 0)
    reached, ends, peaks = 0, [], []
    for part in EXAMPLE:
        own = made[reached : reached + part.displacement[0]]
        peaks.append(S / min(after - before for before, after in pairwise(own)))
        reached += part.displacement[0]
        ends.append(own[-1] / S)
    assert peaks == pytest.approx([3000, 3000, 3000, 3850, 3376.39], rel=0.002)
    assert [after - before for before, after in pairwise([0, *ends])] == pytest.approx(
        seconds, abs=0.000006
    )


@pytest.mark.parametrize(
    ("scope", "at_50", "at_20"),
    [
        ("per_axis_pair", 0.957, 1.156),
        ("per_axis_equal", 1.090, 1.274),
        ("major_only", 0.957, 0.958),
    ],
)
def test_each_reading_of_the_margin_has_its_durations(
    scope: str, at_50: float, at_20: float
) -> None:
    """The contour of the manual by the readings of MN4-AMB-31."""
    made = MoveSettings(rules(cc_margin_scope=scope))
    for margin, expected in ((50, at_50), (20, at_20)):
        assert end(contour(0, made, EXAMPLE, margin)) / S == pytest.approx(expected, abs=0.0006)


def test_the_margin_of_20_falls_at_the_third_junction() -> None:
    """Speeds before and behind it, and the separate moves to compare with."""
    plan = planned(MoveSettings(), EXAMPLE, 20)
    assert [whole(plan.exits[2]), whole(plan.entries[3])] == pytest.approx([1324, 1344], abs=0.5)
    separate = [straight(0, MoveSettings(speed=part.speed), part.displacement) for part in EXAMPLE]
    assert sum(map(end, separate)) / S == pytest.approx(1.475, abs=0.0005)


def test_one_speed_at_a_junction_would_be_slow() -> None:
    """As the ledger reckons where the third segment meets the fourth (MN4-AMB-31)."""
    plan = planned(MoveSettings(rules(cc_margin_scope="per_axis_equal")), EXAMPLE, 50)
    assert [whole(plan.exits[2]), whole(plan.entries[3])] == pytest.approx([1696] * 2, abs=0.5)


@pytest.mark.parametrize(
    ("parts", "seconds"),
    [
        ([((1000, 0, 0, 0), 3000), ((1000, 0, 0, 0), 3000)], 0.800),
        ([((1000, 0, 0, 0), 3000), ((0, 1000, 0, 0), 3000)], 0.93333),
        ([((1000, 0, 0, 0), 3000), ((-1000, 0, 0, 0), 3000)], 0.93333),
        ([((1000, 0, 0, 0), 3000), ((1000, 0, 0, 0), 2000)], 0.94101),
    ],
)
def test_simple_pairs_take_the_time_of_the_ledger(
    parts: list[tuple[tuple[int, int, int, int], int]], seconds: float
) -> None:
    """A collinear pair is one move, a corner and a reversal two; a slower V gives way."""
    motion = contour(0, MoveSettings(), [ContourSegment(*part) for part in parts])
    assert end(motion) / S == pytest.approx(seconds, abs=0.000006)


def relaxed(
    made: MoveSettings, parts: Sequence[ContourSegment], margin: int, hard: Collection[int]
) -> tuple[list[float], list[float]]:
    """The greatest fixed point of the ledger's rules 1 to 4, axis by axis, by patience."""
    start = float(made.profile.start)
    caps = [float(made.cap(part.speed, 1, 1000)) for part in parts]
    lengths = [max(map(abs, part.displacement)) for part in parts]
    entries, exits = list(caps), list(caps)
    entries[0], exits[-1] = min(start, caps[0]), min(start, caps[-1])
    gain = 2.0 * made.profile.acceleration
    for _ in range(20_000):
        before = [*entries, *exits]
        for k, cap in enumerate(caps):
            if cap <= start:
                entries[k] = exits[k] = min(entries[k], exits[k])
            else:
                exits[k] = min(exits[k], sqrt(entries[k] ** 2 + gain * lengths[k]))
                entries[k] = min(entries[k], sqrt(exits[k] ** 2 + gain * lengths[k]))
        for k in range(len(parts) - 1):
            if k in hard:
                exits[k] = min(exits[k], start, caps[k])
                entries[k + 1] = min(entries[k + 1], start, caps[k + 1])
                continue
            for axis in range(3):
                leave = parts[k].displacement[axis] / lengths[k]
                enter = parts[k + 1].displacement[axis] / lengths[k + 1]
                opposite = leave * enter < 0
                w, u = exits[k], entries[k + 1]
                fastest_u = (0 if opposite else abs(leave) * w) + margin / (1 + opposite)
                fastest_w = (0 if opposite else abs(enter) * u) + margin / (1 + opposite)
                entries[k + 1] = min(u, fastest_u / abs(enter) if enter else inf)
                exits[k] = min(w, fastest_w / abs(leave) if leave else inf)
        if max(abs(x - y) for x, y in zip(before, [*entries, *exits], strict=True)) < 1e-9:
            break
    return entries, exits


@pytest.mark.strength
@given(contours, profiles, st.integers(0, 300))
@settings(max_examples=250, derandomize=True)
def test_the_plan_is_the_greatest_that_the_rules_allow(
    parts: Sequence[ContourSegment], profile: SpeedProfile, margin: int
) -> None:
    """It is the fixed point of the rules, and no hard junction could have been soft."""
    made = MoveSettings(profile=profile)
    plan = planned(made, parts, margin)
    hard = {
        k
        for k, seam in enumerate(plan.seams)
        if not seam.lines
        and (seam.exit_cap, seam.entry_cap) == (plan.limits[k].corner, plan.limits[k + 1].corner)
    }
    entries, exits = relaxed(made, parts, margin, hard)
    assert [whole(speed) for speed in plan.entries] == pytest.approx(entries, abs=0.01)
    assert [whole(speed) for speed in plan.exits] == pytest.approx(exits, abs=0.01)
    for k in hard:
        softer = relaxed(made, parts, margin, hard - {k})
        corners = whole(plan.limits[k].corner), whole(plan.limits[k + 1].corner)
        same = softer[1][k] == corners[0] and softer[0][k + 1] == corners[1]
        assert same or softer[1][k] < corners[0] + 1e-6 or softer[0][k + 1] < corners[1] + 1e-6


def test_a_junction_that_turns_out_hard_holds_back_what_follows() -> None:
    """A slow second segment makes the junction hard, which then slows that segment's exit."""
    tiny = ContourSegment((1, 2, 0, 0), 1150)
    parts = [ContourSegment((1000, 900, 0, 0), 5000), tiny, tiny]
    plan = planned(MoveSettings(), parts, 400)
    entries, exits = relaxed(MoveSettings(), parts, 400, {0})
    assert [whole(speed) for speed in plan.entries] == pytest.approx(entries, abs=0.01)
    assert [whole(speed) for speed in plan.exits] == pytest.approx(exits, abs=0.01)
    assert whole(plan.exits[1]) == pytest.approx(sqrt(1000**2 + 2 * 10_000 * 2), abs=0.01)


@pytest.mark.strength
@given(contours, profiles, st.integers(0, 300), st.sampled_from([1, 2, 4]))
@settings(max_examples=120, derandomize=True)
def test_a_contour_arrives_between_the_fastest_and_the_separate_moves(
    parts: Sequence[ContourSegment], profile: SpeedProfile, margin: int, multiplex: int
) -> None:
    """The end is the sum of the segments; bounds and monotony of MN4-CC-01 and -09."""
    made = MoveSettings(profile=profile, multiplex=multiplex)
    motion = contour(5, made, parts, margin)
    sums = tuple(map(sum, zip(*(part.displacement for part in parts), strict=True)))
    assert motion.total == motion.position_at(end(motion)) == sums
    assert motion.remaining_at(end(motion)) == (0, 0, 0, 0)
    separate = [straight(0, made_at(made, part.speed), part.displacement) for part in parts]
    assert end(motion) - 5 <= sum(map(end, separate)) + len(parts)
    fastest = sum(
        max(map(abs, part.displacement)) / made.cap(part.speed, multiplex, 1000) for part in parts
    )
    if multiplex == 1:
        assert end(motion) - 5 >= fastest * S - 1
    assert end(contour(5, made, parts, margin + 50)) <= end(motion) + 1


def made_at(made: MoveSettings, speed: int) -> MoveSettings:
    """The same settings with another V."""
    return MoveSettings(made.rules, made.profile, speed, made.multiplex)


@given(contours, st.integers(0, 300))
@settings(max_examples=60, derandomize=True)
def test_a_mirrored_contour_is_mirrored(parts: Sequence[ContourSegment], margin: int) -> None:
    """Signs change nothing but the signs of the positions."""
    here = contour(0, MoveSettings(), parts, margin)
    mirrored = [part._replace(displacement=negated(part.displacement)) for part in parts]
    there = contour(0, MoveSettings(), mirrored, margin)
    assert end(here) == end(there)
    for part in range(9):
        at_ns = end(here) * part // 8
        assert here.position_at(at_ns) == negated(there.position_at(at_ns))


@given(contours, st.integers(0, 100))
@settings(max_examples=60, derandomize=True)
def test_the_fourth_axis_changes_no_speed_at_a_junction(
    parts: Sequence[ContourSegment], margin: int
) -> None:
    """With a fourth axis that is never the major one the duration stays (MN4-CC-08)."""
    three = [
        part._replace(displacement=(*part.displacement[:3], 0))
        for part in parts
        if any(part.displacement[:3])
    ]
    four = [
        part._replace(
            displacement=(*part.displacement[:3], (-1) ** k * max(map(abs, part.displacement)))
        )
        for k, part in enumerate(three)
    ]
    durations = [end(contour(0, MoveSettings(), some, margin)) for some in (three, four)]
    assert durations[0] == durations[1]


def test_a_corner_can_be_passed_at_the_margin() -> None:
    """The other reading of MN4-AMB-33: as fast as the margin allows, and no slower than 2."""
    parts = [ContourSegment((1000, 0, 0, 0), 3000), ContourSegment((0, 1000, 0, 0), 3000)]
    made = MoveSettings(rules(cc_corner_speed="margin"))
    for margin, expected in ((50, 50), (0, 2)):
        plan = planned(made, parts, margin)
        assert whole(plan.exits[0]) == whole(plan.entries[1]) == expected
        assert [whole(plan.entries[0]), whole(plan.exits[1])] == [1000, 1000]
        assert end(contour(0, made, parts, margin)) > end(contour(0, MoveSettings(), parts))


def test_segments_of_no_length_are_dropped() -> None:
    """They neither take time nor break the motion."""
    nothing = ContourSegment((0, 0, 0, 0), 2000)
    parts = [nothing, *EXAMPLE[:2], nothing, nothing, *EXAMPLE[2:], nothing]
    assert contour(0, MoveSettings(), parts, 50).end_ns == end(
        contour(0, MoveSettings(), EXAMPLE, 50)
    )
    assert contour(3, MoveSettings(), [nothing], 50).end_ns == 3


def test_backlash_of_a_contour_is_taken_up_at_the_speed_of_its_first_segment() -> None:
    """Whatever V was before the bracket, or is at its end (ledger §5.6)."""
    parts = [ContourSegment((0, 0, 0, 0), 300), ContourSegment((-100, 0, 0, 0), 500)]
    parts.append(ContourSegment((-100, 0, 0, 0), 1000))
    made = MoveSettings(speed=1000, lash=(50, 0, 0, 0))
    plain = end(contour(0, MoveSettings(speed=1000), parts))
    assert end(contour(0, made, parts)) == plain + 50 * S // 500


def test_a_contour_on_pulses_advances_by_them_or_ignores_them() -> None:
    """Segments with a negative V, by the readings of MN4-AMB-73."""
    parts = [part._replace(speed=-1) for part in EXAMPLE]
    motion = contour(0, MoveSettings(speed=-1), parts, 50)
    assert motion.end_ns is None
    motion = motion.feed(S, 510)
    assert motion.position_at(S) == (510, 0, 510, 0)
    assert motion.paced_by(S, PulseTrain(1000 * 1000)).end_ns == S + (2564 - 510) * S // 1000
    ignored = [part._replace(speed=-part.speed) for part in EXAMPLE]
    made = MoveSettings(rules(contour_pulses="ignored"))
    assert contour(0, made, ignored, 50).end_ns == end(contour(0, MoveSettings(), EXAMPLE, 50))


def test_a_contour_goes_from_the_clock_to_pulses_and_back() -> None:
    """A V in its midst changes the pace there; each part begins and ends at start speed."""
    parts = [
        ContourSegment((1000, 0, 0, 0), 3000),
        ContourSegment((100, 0, 0, 0), -1),
        ContourSegment((1000, 0, 0, 0), 3000),
    ]
    alone = end(straight(0, MoveSettings(speed=3000), (1000, 0, 0, 0)))
    motion = contour(0, MoveSettings(), parts)
    assert motion.step_time_ns(0, 1000) == alone
    assert motion.step_time_ns(0, 1001) is None
    assert motion.position_at(9 * S) == (1000, 0, 0, 0)
    motion = motion.feed(9 * S, 99)
    assert motion.position_at(9 * S) == (1099, 0, 0, 0)
    assert len(list(motion.steps(0, 9 * S - 1, 9 * S))) == 99
    motion = motion.feed(10 * S, 1)
    assert motion.end_ns == 10 * S + alone
    assert motion.position_at(end(motion)) == (2100, 0, 0, 0)
    paused = motion.pause(10 * S + alone // 2)
    assert paused.resume(20 * S).position_at(21 * S) == (2100, 0, 0, 0)


@pytest.mark.strength
def test_ten_thousand_segments_take_a_few_sweeps_and_any_place_is_found_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The plan is linear: sweeps do not grow with the contour; queries look at few glides."""
    sweeps = []
    forward = SpeedPlan._forward

    def counted(plan: SpeedPlan) -> bool:
        sweeps.append(len(plan.limits))
        return forward(plan)

    monkeypatch.setattr(SpeedPlan, "_forward", counted)
    parts = [
        ContourSegment((100 + k * 7 % 5, k * 11 % 13, -(k * 3 % 4), 1), 1000 + k * 37 % 4000)
        for k in range(10_000)
    ]
    motion = contour(0, MoveSettings(), parts, 50)
    assert len(sweeps) <= 6
    (pace,) = motion.paces
    assert isinstance(pace, TimedPace)
    assert len(pace.timeline.glides) <= 3 * len(parts)
    assert motion.position_at(end(motion)) == motion.total
    paused = motion.pause(end(motion) // 2)
    assert paused.rest_ns is not None
    resumed = paused.resume(paused.rest_ns)
    assert resumed.position_at(end(resumed)) == motion.total
    assert len(sweeps) <= 12
