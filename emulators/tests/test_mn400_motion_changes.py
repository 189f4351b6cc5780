"""Pause, resume, quit, feed rate and halted axes of the MN400's motions (ledger §5.8, §5.12)."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mn400_motions import Recorder, S, end, negated, rules

from axistwin.devices.mn400.motion import (
    ContourSegment,
    MoveSettings,
    Plane,
    SpeedProfile,
    VectorMotion,
    arc,
    contour,
    straight,
)
from axistwin.devices.mn400.motion.pace import TimedPace
from axistwin.devices.mn400.motion.timeline import FINE

EXAMPLE = SpeedProfile(1000, 4000, 4000)
displacements = st.tuples(*[st.integers(-300, 300)] * 4)
profiles = st.tuples(st.integers(2, 3000), st.integers(0, 9000), st.integers(1, 100_000)).map(
    lambda given: SpeedProfile(given[0], given[0] + given[1], given[2])
)
segments = st.lists(
    st.builds(ContourSegment, displacements, st.integers(2, 12_000)), min_size=1, max_size=6
)
made = st.builds(
    lambda profile, multiplex, phase, decel: MoveSettings(
        rules(step_phase=phase, pause_decel=decel), profile, multiplex=multiplex
    ),
    profiles,
    st.sampled_from([1, 2, 4]),
    st.sampled_from(["end", "end", "start"]),
    st.sampled_from([True, True, False]),
)
motions = st.builds(contour, st.integers(0, 10**12), made, segments, st.integers(0, 200))
interruptions = st.lists(
    st.tuples(st.integers(0, 1000), st.integers(0, 400_000_000)), min_size=1, max_size=5
)
"""(when in per mille of what is left to go, for how long in ns)"""


def interrupted(motion: VectorMotion, breaks: Sequence[tuple[int, int]]) -> Recorder:
    """The motion with pauses, run to its end."""
    recorder = Recorder(motion)
    for share, pause_ns in breaks:
        motion = recorder.motion
        if motion.end_ns is None or motion.end_ns <= recorder.since_ns:
            break
        pause_at_ns = motion.since_ns + (motion.end_ns - motion.since_ns) * share // 1000
        recorder.motion = recorder.until(pause_at_ns).pause(pause_at_ns)
        resume_at_ns = pause_at_ns + pause_ns
        recorder.motion = recorder.until(resume_at_ns).resume(resume_at_ns)
    recorder.until(max(end(recorder.motion), recorder.since_ns))
    return recorder


@pytest.mark.strength
@given(motions, interruptions)
@settings(max_examples=150, derandomize=True)
def test_pauses_anywhere_lose_and_add_no_step(
    motion: VectorMotion, breaks: Sequence[tuple[int, int]]
) -> None:
    """After any pauses every step is made once and the end is the target (MN4-CMD-PAU-02)."""
    recorder = interrupted(motion, breaks)
    assert recorder.positions() == motion.total
    assert recorder.motion.position_at(recorder.since_ns) == motion.total
    for axis in range(4):
        steps = recorder.steps[axis]
        assert len(steps) == motion.path_left_at(motion.since_ns - 1)[axis]
        assert [step.at_ns for step in steps] == sorted(step.at_ns for step in steps)


@pytest.mark.strength
@given(made, st.integers(2, 12_000), displacements, interruptions)
@settings(max_examples=100, derandomize=True)
def test_pauses_never_make_a_motion_faster(
    settings: MoveSettings,
    speed: int,
    displacement: tuple[int, int, int, int],
    breaks: Sequence[tuple[int, int]],
) -> None:
    """No interval between steps is shorter than that of the top speed."""
    if settings.rules.step_phase == "start":
        return  # a step before a pause may be a part of an interval early
    moved = contour(0, settings, [ContourSegment(displacement, speed)])
    cap = settings.cap(speed, 1, 1000)
    for steps in interrupted(moved, breaks).steps:
        assert all(after.at_ns - before.at_ns >= S // cap - 2 for before, after in pairwise(steps))


@given(profiles, st.integers(2, 12_000), st.integers(2, 4000), st.integers(0, 1000))
@settings(max_examples=100, derandomize=True)
def test_a_pause_brakes_at_the_profiles_rate_to_start_speed(
    profile: SpeedProfile, speed: int, steps: int, share: int
) -> None:
    """The way to the stop is (v² - S²)/2a, and none at or below start speed (MN4-PAU-01)."""
    motion = straight(0, MoveSettings(profile=profile, speed=speed), (steps, 0, 0, 0))
    at_ns = end(motion) * share // 1000
    paused = motion.pause(at_ns)
    top = min(speed, profile.end)
    longest = Fraction(max(0, top**2 - profile.start**2), 2 * profile.acceleration)
    stopped_ns = paused.rest_ns
    if stopped_ns is None:
        assert motion.is_over_at(at_ns)
        return
    moved = paused.position_at(stopped_ns)[0] - paused.position_at(at_ns)[0]
    assert moved <= longest + 1
    assert Fraction(stopped_ns - at_ns, S) <= Fraction(max(0, top - profile.start) + 1, 1) / (
        profile.acceleration
    )
    assert paused.position_at(stopped_ns + 10**12) == paused.position_at(stopped_ns)
    assert paused.remaining_at(stopped_ns)[0] + paused.position_at(stopped_ns)[0] == steps


def test_the_example_of_the_manual_pauses_at_a_thousand_steps() -> None:
    """V1000, M2000, a second later a pause: 1000 steps made, 1000 to go (MN4-CMD-PAU-01)."""
    motion = straight(0, MoveSettings(speed=1000), (2000, 0, 0, 0)).pause(S)
    assert motion.is_paused
    assert motion.rest_ns == S
    assert motion.end_ns is None
    assert motion.position_at(5 * S) == motion.remaining_at(5 * S) == (1000, 0, 0, 0)
    assert motion.headings_at(5 * S) == (0, 0, 0, 0)
    assert motion.resume(5 * S).end_ns == 6 * S


def test_a_pause_at_speed_ramps_down_and_the_resumed_move_ramps_up() -> None:
    """At 2000 steps/s: 375 steps and a quarter of a second, both ways."""
    motion = straight(0, MoveSettings(profile=EXAMPLE), (10_000, 0, 0, 0))
    paused = motion.pause(S)
    assert paused.rest_ns == S + S // 4
    assert paused.position_at(S)[0] == 375 + 1500
    assert paused.position_at(2 * S)[0] == 375 + 1500 + 375
    resumed = paused.resume(10 * S)
    assert resumed.end_ns == 10 * S + S // 4 + (10_000 - 2250 - 750) * S // 2000 + S // 4
    at_once = paused.resume(S + S // 8)
    assert at_once.step_time_ns(0, 375 + 1500 + 218) == pytest.approx(S + S // 8, abs=S // 1000)


def test_a_pause_in_the_last_ramp_ends_the_move() -> None:
    """The braking of a pause is the ramp of the end: it never overshoots (MN4-PAU-02)."""
    motion = straight(0, MoveSettings(profile=EXAMPLE), (10_000, 0, 0, 0))
    paused = motion.pause(end(motion) - S // 8)
    assert paused.end_ns is not None
    assert abs(paused.end_ns - end(motion)) <= 1
    assert paused.position_at(paused.end_ns) == (10_000, 0, 0, 0)
    assert paused.resume(paused.end_ns) is paused


def test_quit_stops_at_once_and_keeps_what_is_left() -> None:
    """Without a ramp the counters show the steps issued (MN4-QUIT-01, MN4-CMD-N-02)."""
    motion = straight(0, MoveSettings(profile=EXAMPLE), (10_000, -5000, 0, 0))
    quit_ = motion.quit(S)
    assert quit_.end_ns == quit_.rest_ns == S
    assert quit_.is_aborted
    assert quit_.position_at(9 * S) == motion.position_at(S)
    assert quit_.remaining_at(9 * S) == motion.remaining_at(S)
    assert quit_.step_time_ns(0, 5000) is None
    assert quit_.resume(2 * S) is quit_
    ramped = motion.quit(S, ramped=True)
    assert ramped.end_ns == S + S // 4
    assert ramped.position_at(9 * S)[0] == motion.position_at(S)[0] + 375


def test_quit_while_paused_drops_the_rest() -> None:
    """A later resume does nothing (MN4-PAU-05)."""
    motion = straight(0, MoveSettings(), (10_000, 0, 0, 0)).pause(S).quit(2 * S)
    assert motion.is_over_at(2 * S)
    assert motion.resume(3 * S).position_at(9 * S) == motion.position_at(2 * S)


@given(motions, st.integers(0, 1000), st.integers(0, 3))
@settings(max_examples=80, derandomize=True)
def test_a_halted_axis_stands_and_the_others_arrive(
    motion: VectorMotion, share: int, axis: int
) -> None:
    """One axis keeps its position, the rest is as without it (limit_halts = axis)."""
    at_ns = motion.since_ns + (end(motion) - motion.since_ns) * share // 1000
    halted = motion.halt_axis(at_ns, axis)
    assert halted.end_ns == motion.end_ns
    for later_ns in (at_ns, (at_ns + end(motion)) // 2, end(motion)):
        expected = list(motion.position_at(later_ns))
        expected[axis] = motion.position_at(at_ns)[axis]
        assert list(halted.position_at(later_ns)) == expected
    assert halted.next_step(axis, at_ns) is None


@pytest.mark.strength
@given(motions, st.integers(0, 1000))
@settings(max_examples=80, derandomize=True)
def test_the_next_step_towards_a_limit_is_the_first_one(motion: VectorMotion, share: int) -> None:
    """``next_step`` agrees with the list of the steps, in both directions."""
    at_ns = motion.since_ns + (end(motion) - motion.since_ns) * share // 1000
    for axis in range(4):
        steps = list(motion.steps(axis, at_ns, end(motion)))
        for direction in (0, 1, -1):
            matching = [step for step in steps if direction in (0, step.direction)]
            expected = matching[0] if matching else None
            assert motion.next_step(axis, at_ns, direction) == expected
        assert motion.headings_at(at_ns)[axis] == (steps[0].direction if steps else 0)


@pytest.mark.strength
@given(motions, st.lists(st.tuples(st.integers(0, 1000), st.integers(0, 1000)), max_size=5))
@settings(max_examples=120, derandomize=True)
def test_the_feed_rate_changes_the_time_and_nothing_else(
    motion: VectorMotion, changes: Sequence[tuple[int, int]]
) -> None:
    """Turning the pot in mid-motion loses no step, and at full it is the old plan again."""
    recorder = Recorder(motion)
    for share, permille in changes:
        left_ns = end(recorder.motion) - recorder.since_ns
        at_ns = max(recorder.motion.since_ns, recorder.since_ns + left_ns * share // 4000)
        recorder.motion = recorder.until(at_ns).override(at_ns, permille)
    recorder.until(end(recorder.motion))
    assert recorder.positions() == motion.total
    if all(permille == 1000 for _, permille in changes):
        assert recorder.motion is motion
    if changes and motion.settings.rules.step_phase == "end":
        assert end(recorder.motion) >= end(motion) - 5 * len(changes)


@given(motions, st.integers(0, 1000))
@settings(max_examples=100, derandomize=True)
def test_planning_anew_at_the_same_speed_changes_nothing(motion: VectorMotion, share: int) -> None:
    """From any state the new plan is the rest of the old one, to some nanoseconds."""
    at_ns = motion.since_ns + (end(motion) - motion.since_ns) * share // 1000
    again = motion.override(at_ns, 999).override(at_ns, 1000)
    assert abs(end(again) - end(motion)) <= 20 + (end(motion) - motion.since_ns) // 10**9
    for later_ns in (at_ns, (at_ns + end(motion)) // 2):
        for here, there in zip(
            again.position_at(later_ns), motion.position_at(later_ns), strict=True
        ):
            assert abs(here - there) <= 1


def test_a_step_that_is_near_when_the_motion_is_changed_is_made_behind_the_change() -> None:
    """Half a nanosecond ahead at full speed: not before the pot is turned, and not lost."""
    made = MoveSettings(profile=SpeedProfile(5000, 5000, 1), speed=686, feed_permille=500)
    motion = straight(0, made, (400, 0, 0, 0))
    for n in range(1, 100):
        at_ns = n * S // 343  # a part of a nanosecond before step n
        faster = motion.override(at_ns, 1000)
        steps = [*motion.steps(0, -1, at_ns), *faster.steps(0, at_ns, end(faster))]
        assert faster.position_at(at_ns) == motion.position_at(at_ns)
        assert len(steps) == 400


def test_a_pause_does_not_stop_a_hair_before_a_step() -> None:
    """Backlash is taken up to the end, behind which an arc would go on at once."""
    made = MoveSettings(
        profile=SpeedProfile(28, 16041, 297), speed=746, lash=(0, 0, 0, 7), lash_memory=(-1,) * 4
    )
    motion = arc(0, made, Plane(1, 3, 2), (-125, -150), (-188, -335), False)
    first_ns = motion.step_time_ns(3, 1)
    assert first_ns is not None
    for part in range(1, 200):
        at_ns = first_ns * part // 200
        paused = motion.pause(at_ns)
        stood_ns = paused.rest_ns
        assert stood_ns is not None
        resumed = paused.resume(stood_ns + S)
        assert resumed.made_at(stood_ns + S) == paused.made_at(stood_ns + S)


def test_the_pot_scales_the_programmed_speed() -> None:
    """Half the pot is half the speed, none of it 2 steps/s; rules of F apply (MN4-IO-01)."""
    for permille, expected in ((500, 10 * S), (1000, 5 * S + S // 20), (0, 5000 * S)):
        motion = straight(0, MoveSettings(feed_permille=permille), (10_000, 0, 0, 0))
        assert motion.end_ns == expected
    moving = straight(0, MoveSettings(), (10_000, 0, 0, 0))
    slower = moving.override(S, 750)
    # 150 steps of ramp, 1800 at speed; 87.5 steps of braking; then at 1500 and a ramp of 62.5.
    at_speed = 10_000 - 1950 - Fraction("87.5") - Fraction("62.5")
    assert abs(end(slower) - (S + S // 20 + at_speed * S / 1500 + S // 20)) < 1


def test_mirrored_contours_pause_alike() -> None:
    """Mirrored input gives mirrored output through a pause."""
    parts = [ContourSegment((300, 20, -7, 1), 3000), ContourSegment((280, 40, -9, 0), 2500)]
    here = contour(0, MoveSettings(), parts)
    there = contour(
        0, MoveSettings(), [one._replace(displacement=negated(one.displacement)) for one in parts]
    )
    for share in range(11):
        at_ns = end(here) * share // 10
        one, other = here.pause(at_ns), there.pause(at_ns)
        assert one.rest_ns == other.rest_ns
        assert one.position_at(10 * S) == negated(other.position_at(10 * S))


@dataclass
class Watch:
    """Judges every plan of a motion by its glides: speed, acceleration and margin."""

    parts: Sequence[ContourSegment]
    margin: int
    settings: MoveSettings
    speed: Fraction = Fraction()
    """Of the major axis, where the motion was changed."""

    def ratios(self, index: int) -> list[Fraction]:
        """The share of the major axis' speed that each limited axis has."""
        displacement = self.parts[index].displacement
        return [Fraction(one, max(map(abs, displacement))) for one in displacement[:3]]

    def entries(self, index: int, before: Fraction) -> tuple[Fraction, Fraction]:
        """The entries to that segment that the margin allows behind an exit at ``before``."""
        slowest, fastest = Fraction(), Fraction(10**9)
        for leave, enter in zip(self.ratios(index - 1), self.ratios(index), strict=True):
            if enter:
                ends = [(leave * before + sign * self.margin) / enter for sign in (-1, 1)]
                slowest, fastest = max(slowest, min(ends)), min(fastest, max(ends))
            else:
                assert abs(leave * before) <= self.margin + Fraction(1, 1000)
        return slowest, fastest

    def judge(self, motion: VectorMotion) -> None:
        """All glides of the motion as planned now."""
        (pace,) = motion.paces
        assert isinstance(pace, TimedPace)
        start = Fraction(self.settings.profile.start)
        before, index = self.speed, None
        for glide in pace.timeline.glides:
            if glide.x1 - glide.x0 < 1 << FINE - 20:
                continue  # what rounding leaves in front of a junction
            here = bisect_right(pace.bounds, (glide.x0 + glide.x1) // 2)
            m = pace.stretches[here].multiplex
            first, last = (Fraction(speed, m << FINE) for speed in (glide.v0, glide.v1))
            way = Fraction(glide.x1 - glide.x0, m << FINE)
            gain = abs(first**2 - last**2)
            assert gain <= 2 * self.settings.profile.acceleration * way + Fraction(1, 100)
            top = self.settings.cap(self.parts[here].speed, m, 1000)
            assert max(first, last) <= top + Fraction(1, 1000)
            if max(before, first) > start + Fraction(1, 1000):
                if index in (None, here):
                    assert abs(before - first) < Fraction(1, 1000) or first <= start
                else:
                    # Below start speed it may change at once, also right behind a junction.
                    slowest, fastest = self.entries(here, before)
                    near = Fraction(1, 1000)
                    assert slowest <= max(first, Fraction(start)) + near
                    assert first <= fastest + near
            before, index = last, here

    def speed_at(self, motion: VectorMotion, now_ns: int) -> None:
        """Remember the speed for the plan that follows."""
        (pace,) = motion.paces
        assert isinstance(pace, TimedPace)
        assert pace.start_ns is not None
        x, speed = pace.timeline.state_at(now_ns - pace.start_ns)
        here = min(bisect_right(pace.bounds, x), len(pace.bounds) - 1)
        self.speed = Fraction(speed, pace.stretches[here].multiplex << FINE)


whole_contours = st.lists(
    st.builds(
        ContourSegment,
        displacements.filter(any),
        st.one_of(st.integers(2, 9000), st.just(3000)),
    ),
    min_size=1,
    max_size=6,
)


@given(
    whole_contours,
    profiles,
    st.sampled_from([1, 2, 4]),
    st.integers(0, 400),
    st.lists(
        st.tuples(st.integers(0, 1000), st.sampled_from(["pause", "resume", "feed", "quit"])),
        min_size=1,
        max_size=8,
    ),
    st.integers(0, 1000),
)
@example(  # a hard junction, reached at start speed and a rounding
    parts=[
        ContourSegment((130, -78, 130, 299), 7957),
        ContourSegment((-85, -220, 152, -300), 3000),
        ContourSegment((130, -78, 130, 299), 7957),
        ContourSegment((202, 130, -300, -203), 4829),
        ContourSegment((92, 75, 106, -108), 3000),
        ContourSegment((111, 175, 0, 130), 7957),
    ],
    profile=SpeedProfile(653, 1314, 28027),
    multiplex=1,
    margin=101,
    changes=[(309, "resume"), (806, "pause"), (23, "feed"), (192, "resume"), (360, "pause")],
    permille=230,
)
@settings(max_examples=200, derandomize=True)
def test_no_change_exceeds_speed_acceleration_or_margin(
    parts: Sequence[ContourSegment],
    profile: SpeedProfile,
    multiplex: int,
    margin: int,
    changes: Sequence[tuple[int, str]],
    permille: int,
) -> None:
    """Every plan, from any state, keeps the limits; only start speed may come and go at once."""
    made_now = MoveSettings(profile=profile, multiplex=multiplex)
    motion = contour(0, made_now, parts, margin)
    watch = Watch(parts, margin, made_now)
    watch.judge(motion)
    now_ns = 0
    for share, change in changes:
        until_ns = motion.end_ns or motion.rest_ns
        assert until_ns is not None
        now_ns += max(0, until_ns - now_ns) * share // 1000
        if motion.is_over_at(now_ns):
            break
        watch.speed_at(motion, now_ns)
        if change == "pause":
            motion = motion.pause(now_ns)
        elif change == "resume":
            motion = motion.resume(now_ns)
        elif change == "quit":
            motion = motion.quit(now_ns, ramped=True)
        else:
            motion = motion.override(now_ns, permille)
            permille = 1000 - permille
        if motion.since_ns == now_ns:
            watch.judge(motion)
