"""The motions that commands make: straight moves, contours, threads and jogs."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import groupby, pairwise
from typing import NamedTuple

from axistwin.devices.mn400.motion.lookahead import Seam, Stretch, seam_between
from axistwin.devices.mn400.motion.motion import VectorMotion
from axistwin.devices.mn400.motion.pace import Pace, PulsedPace, TimedPace
from axistwin.devices.mn400.motion.paths import Path, PathChain, StraightPath
from axistwin.devices.mn400.motion.rules import AXES, MoveSettings, Quad
from axistwin.devices.mn400.motion.timeline import FINE, ONE
from axistwin.kernel.time import Nanos

DEFAULT_MARGIN = 20
ENDLESS = 1 << 48
"""Steps of a jog: 89 years at 100 000 steps/s."""
TOP_SPEED = 1 << (FINE + 40)


class ContourSegment(NamedTuple):
    """One M between ( and ), and the V in force there."""

    displacement: Quad
    speed: int


class Part(NamedTuple):
    """A path and how it is driven."""

    path: Path
    stretch: Stretch
    is_pulsed: bool = False


def straight(now_ns: Nanos, settings: MoveSettings, displacement: Quad) -> VectorMotion:
    """A vector move (MN4-CMD-M-01)."""
    return _joined(now_ns, settings, [ContourSegment(displacement, settings.speed)], 0)


def contour(
    now_ns: Nanos,
    settings: MoveSettings,
    segments: Sequence[ContourSegment],
    margin: int = DEFAULT_MARGIN,
) -> VectorMotion:
    """One continuous motion through all segments (MN4-CMD-CC-05); margin in steps/s."""
    if settings.rules.contour_pulses == "ignored":  # of contours alone (MN4-AMB-73)
        segments = [segment._replace(speed=abs(segment.speed)) for segment in segments]
    return _joined(now_ns, settings, segments, margin)


def _joined(
    now_ns: Nanos, settings: MoveSettings, segments: Sequence[ContourSegment], margin: int
) -> VectorMotion:
    """Straight parts one behind the other.

    Backlash is taken up at the speed of the first one (ledger §5.6).
    """
    moving = [segment for segment in segments if any(segment.displacement)]
    parts = [
        straight_part(settings, segment.displacement, segment.speed, is_joined=index > 0)
        for index, segment in enumerate(moving)
    ]
    before = replace(settings, speed=moving[0].speed) if moving else settings
    lash = compensation(before, _first_directions(part.path for part in parts))
    return assembled(now_ns, settings, [*lash, *parts], margin)


def thread(
    now_ns: Nanos, settings: MoveSettings, displacement: Quad, pulses: int, offset: int = 0
) -> VectorMotion:
    """A move over external pulses, after the index and ``offset`` of them (MN4-CMD-T-01)."""
    assert pulses >= 1, f"a thread over {pulses} pulses"
    path = StraightPath.over(displacement, pulses, settings.rules.dda_phase)
    stretch = Stretch(displacement, path.length, settings.speed, 1)
    lash = compensation(settings, displacement)
    chain = _chain([*lash, Part(path, stretch, is_pulsed=True)], settings)
    paces = _paces(settings, lash, 0, 0)
    needs_index = settings.rules.threader_start == "index"
    start = chain.length - path.length
    paces.append(PulsedPace(start, chain.length, needs_index, offset))
    return VectorMotion.starting(now_ns, settings, chain, paces)


def jog(now_ns: Nanos, settings: MoveSettings, axis: int, direction: int) -> VectorMotion:
    """A motion of one axis until it is quit; ``settings.speed`` is the jog speed."""
    displacement = [0, 0, 0, 0]
    displacement[axis] = direction * ENDLESS
    first, second, third, fourth = displacement
    return straight(now_ns, settings, (first, second, third, fourth))


def straight_part(
    settings: MoveSettings,
    displacement: Quad,
    speed: int,
    *,
    is_joined: bool = False,
    is_commanded: bool = True,
) -> Part:
    """A straight path at ``speed``; negative: on pulses."""
    is_pulsed = speed < 0
    multiplex = settings.multiplex if sum(map(bool, displacement)) > 1 else 1
    if is_pulsed and settings.rules.sync_ratio == "major_step":
        multiplex = 1
    major = max(map(abs, displacement))
    path = StraightPath.over(
        displacement, major * multiplex, settings.rules.dda_phase, multiplex, is_commanded
    )
    stretch = Stretch(displacement, major << FINE, speed, multiplex, is_joined=is_joined)
    return Part(path, stretch, is_pulsed)


def compensation(
    settings: MoveSettings, directions: Quad, memory: Quad | None = None
) -> list[Part]:
    """The move that takes up the backlash of axes that turn round (ledger §5.6).

    ``directions`` of the motion that follows, 0 for axes at rest; ``memory`` in place of that of
    the settings.
    """
    memory = settings.lash_memory if memory is None else memory
    first, second, third, fourth = (
        -lash * memory[axis] if directions[axis] * memory[axis] < 0 else 0
        for axis, lash in enumerate(settings.lash)
    )
    taken_up = (first, second, third, fourth)
    if not any(taken_up):
        return []
    speed = settings.speed
    if settings.rules.backlash_speed == "start" and speed > 0:
        speed = min(speed, settings.profile.start)
    return [straight_part(settings, taken_up, speed, is_commanded=False)]


def assembled(
    now_ns: Nanos, settings: MoveSettings, parts: Sequence[Part], margin: int = 0
) -> VectorMotion:
    """The motion of ``parts`` one behind the other."""
    chain = _chain(parts, settings)
    paces = _paces(settings, parts, 0, margin)
    return VectorMotion.starting(now_ns, settings, chain, paces)


def _chain(parts: Sequence[Part], settings: MoveSettings) -> PathChain:
    # Without pulses there is no step, be it early or not (MN4-THR-04).
    is_pulsed = any(part.is_pulsed for part in parts)
    early = ONE if settings.rules.step_phase == "start" and not is_pulsed else 0
    return PathChain([part.path for part in parts], early)


def _paces(settings: MoveSettings, parts: Sequence[Part], x: int, margin: int) -> list[Pace]:
    """Paces for ``parts`` from ``x`` on; neighbours of one kind share a pace."""
    paces: list[Pace] = []
    for is_pulsed, group in groupby(parts, key=lambda part: part.is_pulsed):
        members = list(group)
        if is_pulsed:
            end = x + sum(part.path.length for part in members)
            paces.append(PulsedPace(x, end))
        else:
            stretches = [part.stretch for part in members]
            seams = [_seam(one, other, margin, settings) for one, other in pairwise(stretches)]
            paces.append(TimedPace.of(settings, x, stretches, seams))
        x = paces[-1].x1
    return paces


def _seam(before: Stretch, after: Stretch, margin: int, settings: MoveSettings) -> Seam | None:
    """The seam between neighbours; None without a joint."""
    if not after.is_joined:
        return None
    return seam_between(before.displacements, after.displacements, margin, settings, TOP_SPEED)


def _first_directions(paths: Iterable[Path]) -> Quad:
    """The direction of each axis' first step; 0: it does not move."""
    directions = [0, 0, 0, 0]
    for path in paths:
        for axis in AXES:
            if not directions[axis] and path.total(axis):
                directions[axis] = path.heading(axis, 1)
        if all(directions):
            break
    first, second, third, fourth = directions
    return first, second, third, fourth
