"""Faults of long paths: what is counted in 16 bits, behind more ticks, steps or pulses than these
hold."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mn400.motion import VectorMotion
from axistwin.devices.mn400.motion.arcs import ArcPath
from axistwin.devices.mn400.motion.pace import PulsedPace
from axistwin.devices.mn400.motion.paths import Path, StraightPath
from axistwin.devices.mn400.motion.timeline import FINE
from zoo_mn400.planting import Any_, MonkeyPatch, around, board_mutant


def _places(patch: MonkeyPatch, place: Any_) -> None:
    """Let the axes of a motion of one path be at `place(motion, path, axis, tick)`, behind so many
    ticks of it, if those are more than 16 bits hold; None: where they should be."""

    def act(go: Any_, motion: VectorMotion, now: int) -> Any:
        found = list(go())
        paths, tick = motion.chain.paths, motion._x_at(now) >> FINE
        if len(paths) == 1 and tick > 0xFFFF:
            for axis in range(4):
                other = place(motion, paths[0], axis, tick)
                found[axis] = found[axis] if other is None else other
        first, second, third, fourth = found
        return first, second, third, fourth

    around(patch, VectorMotion, "position_at", act)


def _behind(path: Path, axis: int, ticks: int) -> int:
    return path.displacement(axis, path.taken(axis, ticks << FINE))


def _is_minor(path: Path, axis: int) -> bool:
    total = path.total(axis)
    return 0 < total < max(map(path.total, range(4)))


@board_mutant("MN4-CMD-M-01", "MN4-MOT-05")
def minor_axes_know_16_bits_of_the_ticks(patch: MonkeyPatch) -> None:
    """Behind 65535 ticks of a move they are where they were behind none."""

    def place(motion: VectorMotion, path: Path, axis: int, tick: int) -> int | None:
        if not isinstance(path, StraightPath) or not _is_minor(path, axis):
            return None
        return _behind(path, axis, tick & 0xFFFF)

    _places(patch, place)


@board_mutant("MN4-MOT-01")
def minor_axes_know_16_bits_of_the_steps(patch: MonkeyPatch) -> None:
    """The same behind 65535 steps of the axis that goes farthest."""

    def place(motion: VectorMotion, path: Path, axis: int, tick: int) -> int | None:
        if not isinstance(path, StraightPath) or not _is_minor(path, axis):
            return None
        multiplex = path.ticks // max(map(path.total, range(4)))
        steps, rest = divmod(tick, multiplex)
        if steps <= 0xFFFF:
            return None
        return _behind(path, axis, (steps & 0xFFFF) * multiplex + rest)

    _places(patch, place)


@board_mutant("MN4-HEL-02")
def a_traverse_knows_16_bits_of_the_ticks(patch: MonkeyPatch) -> None:
    """Behind 65535 ticks of a helix it is where it was behind none."""

    def place(motion: VectorMotion, path: Path, axis: int, tick: int) -> int | None:
        if not isinstance(path, ArcPath) or not path.traverse or axis != path.plane.z:
            return None
        return _behind(path, axis, tick & 0xFFFF)

    _places(patch, place)


@board_mutant("MN4-THR-01")
def a_thread_knows_16_bits_of_its_pulses(patch: MonkeyPatch) -> None:
    """Behind 65535 of them its axes are where they were behind none."""

    def place(motion: VectorMotion, path: Path, axis: int, tick: int) -> int | None:
        is_thread = isinstance(path, StraightPath) and isinstance(motion.paces[-1], PulsedPace)
        return _behind(path, axis, tick & 0xFFFF) if is_thread else None

    _places(patch, place)
