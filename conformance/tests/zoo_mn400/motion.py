"""Faults of motion: moves, arcs, helices, contours, backlash, read-out (CMD-M to MEA)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400 import orders
from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.grammar import SPEED_MAX
from axistwin.devices.mn400.motion import (
    MoveSettings,
    SpeedProfile,
    arc_is_round,
    arcs,
    straight,
)
from axistwin.devices.mn400.motion.arcs import ArcPath
from axistwin.devices.mn400.motion.circle import LatticeCircle
from axistwin.devices.mn400.motion.pace import TimedPace
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import MotionOrder
from zoo_mn400.planting import (
    MS,
    Any_,
    MonkeyPatch,
    around,
    begins_with,
    board_mutant,
    commands,
    plans,
    settles,
    values,
)

# --- moves ----------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-M-01", "MN4-MOT-01")
def each_axis_runs_at_its_own_speed(patch: MonkeyPatch) -> None:
    """A move ends where it should, but its axes go one behind the other."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        from axistwin.devices.mn400.motion import ContourSegment, contour

        segments = []
        for axis, steps in enumerate(displacement):
            one = [0, 0, 0, 0]
            one[axis] = steps
            first, second, third, fourth = one
            segments.append(ContourSegment((first, second, third, fourth), settings.speed))
        return contour(now, settings, segments, 0)

    plans(patch, "straight", act)


@board_mutant("MN4-CMD-M-02", "MN4-CMD-I-01", "MN4-CMD-L-02")
def targets_are_distances(patch: MonkeyPatch) -> None:
    """In absolute mode M goes as far as its parameters say."""

    def act(go: Any_, order: MotionOrder, position: Any, field: int, axis: int) -> int:
        return int(go((0, 0, 0, 0), field, axis)) if order.letter == "M" else int(go())

    around(patch, MotionOrder, "distance", act)


@board_mutant("MN4-CMD-M-01")
def axis_2_goes_the_other_way(patch: MonkeyPatch) -> None:
    """A positive parameter counts axis 2 down."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        first, second, third, fourth = displacement
        return go(now, settings, (first, -second, third, fourth))

    plans(patch, "straight", act)


@board_mutant("MN4-CMD-M-02", "MN4-CMD-M-03", traps=(42,))
def long_moves_miss_by_one(patch: MonkeyPatch) -> None:
    """Of a distance of 50 steps or more the last one is not made."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        less = tuple(d - (d > 50) + (d < -50) for d in displacement)
        return go(now, settings, less)

    plans(patch, "straight", act)


@board_mutant("MN4-CMD-M-01", "MN4-PAR-06")
def unnamed_axes_creep(patch: MonkeyPatch) -> None:
    """Axis 4 makes a step with each move."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        first, second, third, fourth = displacement
        return go(now, settings, (first, second, third, fourth or 1))

    plans(patch, "straight", act)


@board_mutant("MN4-CMD-V-01")
def the_speed_at_power_on_is_1000(patch: MonkeyPatch) -> None:
    """V is 1000 until it is set, and 1000 when 2000 is."""
    begins_with(patch, speed=1000)
    settles(
        patch,
        "V",
        lambda after, before: replace(after, speed=1000 if after.speed > 1000 else after.speed),
    )


def _caps(patch: MonkeyPatch, change: Any_) -> None:
    """Let `change(cap, settings, speed, multiplex)` be the top speed."""

    def act(go: Any_, settings: MoveSettings, speed: int, multiplex: int, feed: int) -> int:
        return int(change(int(go()), settings, speed, multiplex))

    around(patch, MoveSettings, "cap", act)


@board_mutant("MN4-CMD-V-03", "MN4-MOT-12", "MN4-CMD-A-05", "MN4-MOT-13", traps=(17,))
def the_end_speed_is_no_limit(patch: MonkeyPatch) -> None:
    """V above the end speed of the profile is run at V."""
    _caps(patch, lambda cap, settings, speed, multiplex: max(cap, abs(speed)))


@board_mutant("MN4-CMD-V-03", "MN4-MOT-12", "MN4-MOT-02", traps=(17,))
def no_move_is_slower_than_the_start_speed(patch: MonkeyPatch) -> None:
    """V below the start speed is run at the start speed."""
    _caps(patch, lambda cap, settings, speed, multiplex: max(cap, settings.profile.start))


@board_mutant(
    "MN4-CMD-V-01",
    "MN4-CMD-F-01",
    "MN4-CMD-A-05",
    "MN4-MOT-01",
    "MN4-MOT-02",
    "MN4-MOT-13",
    "MN4-SYN-02",
)
def speeds_are_a_tenth_less(patch: MonkeyPatch) -> None:
    """The clock of the steps is slow."""
    _caps(patch, lambda cap, settings, speed, multiplex: max(2, cap * 9 // 10))


@board_mutant("MN4-MOT-05")
def a_multiplex_slows_one_axis_down(patch: MonkeyPatch) -> None:
    """Its limit is that of a move of one axis as well."""

    def act(go: Any_, now: int, settings: MoveSettings, displacement: Any) -> Any:
        speed = min(settings.speed, SPEED_MAX // settings.multiplex)
        return go(now, replace(settings, speed=speed), displacement)

    plans(patch, "straight", act)


def _profiles(patch: MonkeyPatch, change: Any_) -> None:
    """Let each straight move have the profile `change(profile)`."""

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(now, replace(settings, profile=change(settings.profile)), *rest)

    plans(patch, "straight", act)


@board_mutant("MN4-CMD-F-01", "MN4-MOT-10")
def moves_are_not_ramped(patch: MonkeyPatch) -> None:
    """A move runs at V from its first step."""
    _profiles(patch, lambda profile: SpeedProfile(profile.end, profile.end, profile.acceleration))


@board_mutant("MN4-CMD-F-01", "MN4-MOT-10")
def moves_begin_at_rest(patch: MonkeyPatch) -> None:
    """The start speed is 2 steps/s, whatever F says."""
    _profiles(patch, lambda profile: replace(profile, start=2))


@board_mutant("MN4-CMD-F-01", "MN4-MOT-10")
def ramps_are_a_third_as_steep(patch: MonkeyPatch) -> None:
    """The acceleration is a third of F's."""
    _profiles(patch, lambda profile: replace(profile, acceleration=profile.acceleration // 3 + 1))


@board_mutant("MN4-CMD-V-05", traps=(38,))
def a_speed_acts_on_the_move_that_runs(patch: MonkeyPatch) -> None:
    """V during a move changes it."""

    def act(go: Any_, mover: Mover, now: int, waiting: Any) -> None:
        before = mover.accepted.speed
        go()
        after = mover.accepted.speed
        if mover._motion is not None and after != before and after > 0:
            mover._motion = mover._motion.override(now, max(1, min(1000, after * 1000 // before)))
            mover._watch(now)

    around(patch, Mover, "set", act)


@board_mutant("MN4-RSP-05", traps=(2, 46))
def done_is_sent_at_the_end_of_a_move(patch: MonkeyPatch) -> None:
    """DONE of a move of less than 0.45 s is sent when it is over."""

    def act(go: Any_, one: Interpreter, line: Any, letter: str) -> Any:
        answer = go()
        motion = one._mover.motion_at(line.now)
        if letter == "M" and motion is not None and motion.end_ns is not None:
            wait_ns = motion.end_ns - line.now
            if wait_ns < 450 * MS:
                *before, last = answer.parts
                return answer._replace(parts=[*before, last._replace(wait_ns=wait_ns)])
        return answer

    around(patch, Interpreter, "_answer", act)


# --- arcs and helices -----------------------------------------------------------------------------


def _planes(patch: MonkeyPatch, name: str, change: Any_) -> None:
    """Let an arc or a helix have other arguments."""
    plans(patch, name, lambda go, now, settings, *rest: go(now, settings, *change(*rest)))


@board_mutant("MN4-CMD-A-01", "MN4-CMD-HEL-03", "MN4-ARC-08", traps=(15,))
def the_plane_is_axes_1_and_2(patch: MonkeyPatch) -> None:
    """At power-on, and after P1,3,2."""
    begins_with(patch, plane=(0, 1, 2))

    def change(after: Any, before: Any) -> Any:
        return replace(after, plane=(0, 1, 2)) if after.plane == (0, 2, 1) else after

    settles(patch, "P", change)


@board_mutant("MN4-CMD-A-03", "MN4-ARC-01", "MN4-ARC-05", "MN4-ARC-04", traps=(19,))
def clockwise_is_the_other_way_round(patch: MonkeyPatch) -> None:
    """Direction 1 is counter-clockwise."""
    _planes(
        patch,
        "arc",
        lambda plane, center, end, is_clockwise: (plane, center, end, not is_clockwise),
    )


@board_mutant("MN4-CMD-A-05", "MN4-ARC-04")
def an_eighth_of_the_circle_is_mistaken(patch: MonkeyPatch) -> None:
    """The one right of the lowest point is counted from the axis beside it."""

    def act(go: Any_, circle: LatticeCircle, x: int, y: int) -> int:
        return circle.quarter - y if 0 < x < -y else int(go())

    around(patch, LatticeCircle, "tick_at", act)


@board_mutant("MN4-ARC-01")
def an_arc_goes_by_the_points_of_the_lattice(patch: MonkeyPatch) -> None:
    """An end beside the circle, whose nearest point lies behind the start, takes a whole circle."""
    sweep_of = arcs._final_sweep

    def act(circle: LatticeCircle, start: Any, goal: Any, *rest: Any) -> tuple[float, int]:
        sweep, ticks = sweep_of(circle, start, goal, *rest)
        points = (circle.tick_at(*goal) - circle.tick_at(*start)) % (4 * circle.quarter)
        return sweep, points or ticks

    patch.setattr(arcs, "_final_sweep", act)


@board_mutant("MN4-CMD-A-04")
def radii_may_differ_by_a_tenth(patch: MonkeyPatch) -> None:
    """What is nearly round is taken for an arc."""
    patch.setattr(orders, "arc_is_round", lambda rules, center, end: center != (0, 0))


@board_mutant("MN4-CMD-A-04", "MN4-CMD-A-02")
def an_arc_that_waits_is_looked_at_from_where_the_axes_are(patch: MonkeyPatch) -> None:
    """Whether it is round, in absolute mode, behind a motion that runs."""
    around(patch, Mover, "expected", lambda go, mover, now: mover.position_at(now))


@board_mutant("MN4-CMD-A-04")
def an_arc_that_waits_knows_nothing_of_traverses_before_it(patch: MonkeyPatch) -> None:
    """Whether it is round, in absolute mode, behind a helix that waits."""

    def act(go: Any_, order: MotionOrder, position: Any, quirks: Any) -> Any:
        end = list(go())
        if order.letter == "+":
            end[order.settings.plane[2]] = position[order.settings.plane[2]]
        return tuple(end)

    around(patch, MotionOrder, "end", act)


@board_mutant("MN4-ARC-07")
def a_radius_of_zero_is_taken(patch: MonkeyPatch) -> None:
    """A0,0,0,0,1 draws DONE."""
    check = arc_is_round
    patch.setattr(
        orders,
        "arc_is_round",
        lambda rules, center, end: center == (0, 0) or check(rules, center, end),
    )

    def act(go: Any_, now: int, settings: MoveSettings, plane: Any, center: Any, *rest: Any) -> Any:
        if center == (0, 0):
            return straight(now, settings, (0, 0, 0, 0))
        return go(now, settings, plane, center, *rest)

    plans(patch, "arc", act)


@board_mutant("MN4-ARC-02", traps=(18,))
def radii_must_be_equal(patch: MonkeyPatch) -> None:
    """The arc of 45 degrees of the manual is refused."""

    def is_round(rules: Any, center: Any, end: Any) -> bool:
        first = center[0] ** 2 + center[1] ** 2
        second = (end[0] - center[0]) ** 2 + (end[1] - center[1]) ** 2
        return bool(first == second != 0)

    patch.setattr(orders, "arc_is_round", is_round)


@board_mutant("MN4-ARC-03")
def arcs_end_beside_their_end(patch: MonkeyPatch) -> None:
    """An arc of other radii by rounding ends on its circle."""

    def act(
        go: Any_, now: int, settings: MoveSettings, plane: Any, center: Any, end: Any, way: Any
    ) -> Any:
        first = center[0] ** 2 + center[1] ** 2
        second = (end[0] - center[0]) ** 2 + (end[1] - center[1]) ** 2
        moved = end if first == second else (end[0] + 1, end[1])
        return go(now, settings, plane, center, moved, way)

    plans(patch, "arc", act)


@board_mutant("MN4-CMD-HEL-01", "MN4-HEL-02")
def a_helix_makes_one_turn_less(patch: MonkeyPatch) -> None:
    """Of four revolutions three are made, and the arc."""

    def change(*given: Any) -> Any:
        return (*given[:-1], max(0, given[-1] - 1))

    _planes(patch, "helix", change)


@board_mutant("MN4-CMD-HEL-02", "MN4-HEL-02")
def a_helix_always_goes_up(patch: MonkeyPatch) -> None:
    """The sign of the traverse is lost."""

    def change(*given: Any) -> Any:
        return (*given[:-2], abs(given[-2]), given[-1])

    _planes(patch, "helix", change)


# --- contours -------------------------------------------------------------------------------------


def _contours(patch: MonkeyPatch, change: Any_) -> None:
    """Let a contour have `change(segments, margin)`."""
    plans(
        patch,
        "contour",
        lambda go, now, settings, segments, margin: go(now, settings, *change(segments, margin)),
    )


@board_mutant("MN4-CC-02", "MN4-CC-03", "MN4-CMD-CC-05", traps=(21,))
def a_contour_stops_at_each_joint(patch: MonkeyPatch) -> None:
    """Each segment begins and ends at start speed."""
    from axistwin.devices.mn400.motion import moves

    patch.setattr(moves, "_seam", lambda before, after, margin, settings: None)


@board_mutant("MN4-CC-01", "MN4-CC-02", "MN4-CC-09")
def a_contour_loses_its_last_segment(patch: MonkeyPatch) -> None:
    """What comes right before ) is not made."""
    _contours(patch, lambda segments, margin: (segments[:-1] or segments, margin))


@board_mutant("MN4-CC-05", "MN4-CMD-CC-01", traps=(22,))
def a_margin_stays(patch: MonkeyPatch) -> None:
    """( without a margin has that of the ( before it."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        kept = getattr(one, "margin", 20)
        one.margin = int(line.text) if line.text.isdigit() else kept  # type: ignore[attr-defined]
        return go(line, (one.margin,))  # type: ignore[attr-defined]

    around(patch, Interpreter, "_begin_contour", act)

    def init(go: Any_, one: Interpreter, *given: Any) -> None:
        go()
        one._acts["("] = one._begin_contour

    around(patch, Interpreter, "__init__", init)


@board_mutant("MN4-CC-08", "MN4-CC-01")
def axis_4_does_not_follow_a_contour(patch: MonkeyPatch) -> None:
    """Segments move three axes."""

    def change(segments: Any, margin: int) -> Any:
        less = [
            one._replace(displacement=(*one.displacement[:3], 0))
            if any(one.displacement[:3])
            else one
            for one in segments
        ]
        return less, margin

    _contours(patch, change)


# --- backlash -------------------------------------------------------------------------------------


def _memories(patch: MonkeyPatch, change: Any_) -> None:
    """Let each straight move have `change(settings)`."""
    plans(patch, "straight", lambda go, now, settings, *rest: go(now, change(settings), *rest))


@board_mutant("MN4-BKL-01", "MN4-CMD-B-01", "MN4-CMD-D-02")
def backlash_is_not_taken_up(patch: MonkeyPatch) -> None:
    """B is answered, and nothing comes of it."""
    _memories(patch, lambda settings: replace(settings, lash=(0, 0, 0, 0)))


@board_mutant("MN4-BKL-01")
def backlash_is_taken_up_the_other_way(patch: MonkeyPatch) -> None:
    """As many steps, away from where the move leads."""
    from axistwin.devices.mn400.motion import moves

    make = moves.compensation

    def act(settings: MoveSettings, *given: Any) -> Any:
        first, second, third, fourth = settings.lash
        return make(replace(settings, lash=(-first, -second, -third, -fourth)), *given)

    patch.setattr(moves, "compensation", act)


@board_mutant("MN4-BKL-06")
def a_rounded_arc_ends_the_other_way(patch: MonkeyPatch) -> None:
    """Behind one whose end lies beside its circle the other directions are remembered."""

    def act(go: Any_, path: ArcPath, axis: int, n: int) -> int:
        shift = path._shifts[axis]
        is_beside = shift is not None and n > path._on_circle[shift][1]
        return -int(go()) if is_beside else int(go())

    around(patch, ArcPath, "heading", act)


@board_mutant("MN4-BKL-01", "MN4-BKL-02", "MN4-CMD-B-01", "MN4-CMD-D-02", traps=(39,))
def backlash_is_taken_up_by_each_first_move(patch: MonkeyPatch) -> None:
    """The directions are remembered the other way round."""

    def change(settings: MoveSettings) -> MoveSettings:
        first, second, third, fourth = settings.lash_memory
        return replace(settings, lash_memory=(-first, -second, -third, -fourth))

    _memories(patch, change)


# --- read-out -------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-N-01", "MN4-MEA-05")
def what_is_left_is_what_was_made(patch: MonkeyPatch) -> None:
    """N counts up."""

    def change(text: str, readout: Any, now: int) -> str:
        motion = readout._mover.motion_at(now)
        return text if motion is None else ",".join(map(str, motion.position_at(now)))

    values(patch, "N", change)


@board_mutant("MN4-MEA-06", "MN4-CMD-CC-06")
def counters_are_told_when_a_move_is_over(patch: MonkeyPatch) -> None:
    """E during a move tells where it began."""

    def change(text: str, readout: Any, now: int) -> str:
        mover = readout._mover
        return ",".join(map(str, mover._base)) if mover.is_busy else text

    values(patch, "E", change)


@board_mutant("MN4-CMD-E-03", "MN4-MEA-02", "MN4-MEA-03", traps=(29,))
def a_count_is_that_of_the_major_axis(patch: MonkeyPatch) -> None:
    """E1 counts without the multiplex."""

    def act(go: Any_, mover: Mover, motion: Any, now: int) -> int:
        return int(int(go()) // motion.settings.multiplex)

    around(patch, Mover, "_counted", act)


@board_mutant("MN4-STM-01")
def a_move_that_runs_is_counted_by_the_multiplex_that_came_last(patch: MonkeyPatch) -> None:
    """X during a move changes the ticks of that one."""

    def act(go: Any_, mover: Mover, motion: Any, now: int) -> int:
        return int(go()) * mover.accepted.multiplex // int(motion.settings.multiplex)

    around(patch, Mover, "_counted", act)


@board_mutant("MN4-CMD-N-02")
def what_a_pause_has_left_stays(patch: MonkeyPatch) -> None:
    """N behind a move that was paused tells what was left in the pause."""

    def pause(go: Any_, mover: Mover, now: int, reason: str = "command") -> None:
        mover.noted = mover.left_at(now)  # type: ignore[attr-defined]
        go()

    def begin(go: Any_, mover: Mover, *given: Any) -> None:
        mover.noted = None  # type: ignore[attr-defined]
        go()

    def finish(go: Any_, mover: Mover, now: int) -> None:
        go()
        noted = getattr(mover, "noted", None)
        if noted is not None and not mover.is_aborted:
            mover._left = noted

    around(patch, Mover, "pause", pause)
    around(patch, Mover, "_begin", begin)
    around(patch, Mover, "_finish", finish)


@board_mutant("MN4-CMD-EXIT-03")
def the_bar_clears_what_is_left(patch: MonkeyPatch) -> None:
    """| behind Q clears the exit code, and N."""

    def act(go: Any_, one: Interpreter, line: Any, given: Any) -> Any:
        one._mover._left = (0, 0, 0, 0)
        return go()

    commands(patch, "|", act)


@board_mutant("MN4-CMD-EXIT-02")
def the_exit_code_is_cleared_by_a_move(patch: MonkeyPatch) -> None:
    """/ is 0 as soon as a move begins."""

    def act(go: Any_, mover: Mover, now: int, order: Any) -> None:
        mover.exit_code = 0
        go()

    around(patch, Mover, "_begin", act)


@board_mutant("MN4-BKL-06")
def a_helix_does_not_remember_its_traverse(patch: MonkeyPatch) -> None:
    """Behind + the traverse axis remembers the direction before it."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        kept, order = mover._memory, mover.order
        go()
        if order is not None and order.letter == "+":
            memory = list(mover._memory)
            memory[order.settings.plane[2]] = kept[order.settings.plane[2]]
            mover._memory = (memory[0], memory[1], memory[2], memory[3])

    around(patch, Mover, "_finish", act)


@board_mutant("MN4-PAU-01")
def a_pause_with_a_multiplex_does_not_brake(patch: MonkeyPatch) -> None:
    """Under X2 and X4 { stops a move at once."""

    def act(go: Any_, pace: TimedPace, now: int, x: int, ramped: bool) -> Any:
        return go(now, x, ramped and pace.settings.multiplex == 1)

    around(patch, TimedPace, "stopped", act)


@board_mutant("MN4-MEA-01")
def a_measurement_forgets_a_move_that_is_over(patch: MonkeyPatch) -> None:
    """E1 counts the ticks of what runs when it ends."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        kept = mover._phantom
        go()
        mover._phantom = kept

    around(patch, Mover, "_finish", act)
