"""Faults of motions that show beside others: of a helix but not of an arc, of a contour behind
another one, of axes that go on while others turn round."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.motion import MoveSettings, moves
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import MotionOrder
from zoo_mn400.planting import Any_, MonkeyPatch, around, board_mutant, plans

# --- helices --------------------------------------------------------------------------------------


@board_mutant("MN4-ARC-02")
def a_helix_may_end_off_its_circle(patch: MonkeyPatch) -> None:
    """Its radii are not compared; those of an arc are."""

    def act(go: Any_, order: MotionOrder, position: Any, rules: Any, quirks: Any) -> None:
        x, y, z = order.settings.plane
        center, _, _ = order.circle(position, quirks)
        if order.letter == "A" or z in (x, y) or not any(center):
            go()

    around(patch, MotionOrder, "_check_circle", act)


# --- contours -------------------------------------------------------------------------------------


@board_mutant("MN4-CMD-CC-01", "MN4-CC-05")
def a_contour_that_waits_has_the_margin_that_came_last(patch: MonkeyPatch) -> None:
    """Of the contours that wait, each has that of the last (."""
    last = [0]

    def keep(go: Any_, one: Interpreter, *segments: Any) -> MotionOrder:
        order = go()
        assert isinstance(order, MotionOrder)
        last[0] = order.margin
        return order

    around(patch, Interpreter, "_contour_order", keep)

    def act(go: Any_, mover: Mover, now: int, order: MotionOrder) -> Any:
        return go(now, replace(order, margin=last[0]) if order.letter == ")" else order)

    around(patch, Mover, "_plan", act)


@board_mutant("MN4-CC-06")
def a_contour_knows_no_end_speed(patch: MonkeyPatch) -> None:
    """Its segments run at their V, be it above the end speed of the profile."""

    def act(go: Any_, now: int, settings: MoveSettings, segments: Any, margin: int) -> Any:
        top = max([settings.profile.end, *(segment.speed for segment in segments)])
        faster = replace(settings, profile=replace(settings.profile, end=top))
        return go(now, faster, segments, margin)

    plans(patch, "contour", act)


@board_mutant("MN4-CC-01")
def an_empty_pair_runs_a_contour_again(patch: MonkeyPatch) -> None:
    """Between ( and ) there is nothing: the segments before it are made once more."""
    kept: list[Any] = []

    def act(go: Any_, one: Interpreter, *given: Any) -> Any:
        assert one.contour is not None
        if one.contour.segments:
            kept[:] = one.contour.segments
        else:
            one.contour.segments.extend(kept)
        return go()

    around(patch, Interpreter, "_end_contour", act)


# --- backlash -------------------------------------------------------------------------------------


@board_mutant("MN4-BKL-02")
def axes_that_go_down_make_steps_with_one_that_turns(patch: MonkeyPatch) -> None:
    """Those that went down before, too, if there is one with backlash to take up."""
    make = moves.compensation

    def act(settings: MoveSettings, directions: Any, memory: Any = None) -> Any:
        found = make(settings, directions, memory)
        if not found:
            return found
        memory = settings.lash_memory if memory is None else memory
        first, second, third, fourth = (
            1 if way < 0 else was for way, was in zip(directions, memory, strict=True)
        )
        return make(settings, directions, (first, second, third, fourth))

    patch.setattr(moves, "compensation", act)
