"""What a motion command asks for, kept until it is its turn, and the settings that it keeps.

Rules
-----
1. A motion keeps the settings of the moment in which it was accepted, those that wait in front of
   it in the queue included (MN4-STM-01, MN4-STM-07, MN4-CMD-I-04).
2. Its displacement is computed when it starts: absolute coordinates mean what the counters say then
   (MN4-CMD-M-02), in 64 bits (MN4-MOT-06).  An omitted axis keeps its coordinate (MN4-PAR-06).
3. Whether it is legal is checked when it is accepted, from where the axes will stand then.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, TypeAlias

from axistwin.devices.mn400.grammar import SPEED_MAX, SPEED_MIN, Arguments, ParameterError
from axistwin.devices.mn400.motion import (
    ContourSegment,
    MotionRules,
    MoveSettings,
    Plane,
    SpeedProfile,
    VectorMotion,
    arc,
    arc_is_round,
    contour,
    helix,
    straight,
    thread,
)
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.kernel.time import Nanos

AXES: Final = 4
Four: TypeAlias = tuple[int, int, int, int]
ZERO: Final[Four] = (0, 0, 0, 0)
_WRAP: Final = 1 << 32


def wrapped(values: Sequence[int]) -> Four:
    """Counters of 32 bits in two's complement (MN4-MOT-06)."""
    first, second, third, fourth = (
        (value + (_WRAP >> 1)) % _WRAP - (_WRAP >> 1) for value in values
    )
    return first, second, third, fourth


def added(left: Sequence[int], right: Sequence[int]) -> Four:
    """The sum, axis by axis."""
    return left[0] + right[0], left[1] + right[1], left[2] + right[2], left[3] + right[3]


def negated(values: Sequence[int]) -> Four:
    """The other way round."""
    return -values[0], -values[1], -values[2], -values[3]


def loaded(values: Sequence[int], given: Sequence[int | None]) -> Four:
    """``values`` with those of ``given`` that were not omitted."""
    first, second, third, fourth = (
        old if new is None else new for old, new in zip(values, given, strict=True)
    )
    return first, second, third, fourth


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """What modal commands set; axes count from 0 here.

    speed: of V, negative for external sync.  start, top, acceleration: of F.  plane: of P, the
    motors X, Y and Z.  taps: the four resolutions of G; spi: steps per inch; jog_speed: of Y.
    """

    speed: int = 2000
    start: int = 1000
    top: int = 5000
    acceleration: int = 10_000
    is_absolute: bool = False
    plane: tuple[int, int, int] = (0, 2, 1)
    multiplex: int = 1
    lash: Four = ZERO
    taps: Four = (2000, 1000, 100, 10)
    spi: int = 8000
    jog_speed: int = 1000

    @property
    def profile(self) -> SpeedProfile:
        """The ramps."""
        return SpeedProfile(self.start, self.top, self.acceleration)


def change_of(
    letter: str, given: Arguments, quirks: Mn400Quirks, settings: BoardSettings
) -> Callable[[BoardSettings], BoardSettings]:
    """How a modal command changes the settings.  Raises ParameterError."""
    changed: dict[str, Any] = {}
    if letter == "F":
        start, top, acceleration = _three(
            (settings.start, settings.top, settings.acceleration), given
        )
        if quirks.speed_range_policy == "clip":
            start = min(max(start, SPEED_MIN), top, SPEED_MAX)
        if start > top:
            raise ParameterError
        changed = {"start": start, "top": top, "acceleration": acceleration}
    elif letter == "P":
        x, y, z = (None if motor is None else motor - quirks.plane_base for motor in given)
        traverse = settings.plane[2] if z is None else z
        is_crossed = quirks.plane_z_check == "at_plane" and traverse in (x, y)
        if x == y or is_crossed:
            raise ParameterError
        changed = {"plane": (x, y, traverse)}
    elif letter == "G":
        changed = {"taps": given[:4], "spi": given[4]}
    elif letter == "B":
        changed = {"lash": loaded(settings.lash, given)}
    elif letter == "I":
        changed = {"is_absolute": given[0] == quirks.abs_mode_value}
    else:
        changed = {{"V": "speed", "X": "multiplex", "Y": "jog_speed"}[letter]: given[0]}
    return lambda before: replace(before, **changed)


def _three(values: tuple[int, int, int], given: Arguments) -> tuple[int, int, int]:
    """``values`` with those of ``given`` that were not omitted."""
    first, second, third = (
        old if new is None else new for old, new in zip(values, given, strict=True)
    )
    return first, second, third


@dataclass(frozen=True, slots=True)
class MoveStart:
    """Where and with what a motion starts.  position: the counters.  memory: of the backlash."""

    now: Nanos
    position: Four
    memory: Four
    feed_permille: int


@dataclass(frozen=True, slots=True)
class StoredSegment:
    """One M between ( and ), and the speed in force there."""

    targets: Arguments
    speed: int


@dataclass(frozen=True)
class MotionOrder:
    """One motion command: its character, parameters and settings; of a contour its segments."""

    letter: str
    arguments: Arguments
    settings: BoardSettings
    segments: tuple[StoredSegment, ...] = ()
    margin: int = 0

    @cached_property
    def is_paced(self) -> bool:
        """Whether it advances with external pulses alone."""
        speeds = [segment.speed for segment in self.segments] or [self.settings.speed]
        return self.letter == "T" or min(speeds) < 0

    # -- distances (rule 2) --

    def distance(self, position: Sequence[int], field: int, axis: int) -> int:
        """How far ``axis`` is to go from ``position``, as the parameter ``field`` says."""
        value = self.arguments[field]
        if value is None:
            return 0
        return value - position[axis] if self.settings.is_absolute else value

    def vector(self, position: Sequence[int]) -> Four:
        """Displacement of the four axes of M and T."""
        first, second, third, fourth = (self.distance(position, n, n) for n in range(AXES))
        return first, second, third, fourth

    def path(self, position: Four) -> list[ContourSegment]:
        """The segments of a contour, one displacement after the other."""
        path = []
        for segment in self.segments:
            step = MotionOrder("M", segment.targets, self.settings).vector(position)
            path.append(ContourSegment(step, segment.speed))
            position = added(position, step)
        return path

    def circle(
        self, position: Four, quirks: Mn400Quirks
    ) -> tuple[tuple[int, int], tuple[int, int], int]:
        """Centre and destination seen from the start, and the traverse (MN4-CMD-A-02)."""
        x, y, z = self.settings.plane
        order = self
        if self.letter == "+" and quirks.helix_abs_fields == "none":
            order = MotionOrder("+", self.arguments, BoardSettings(plane=self.settings.plane))
        center = order.distance(position, 0, x), order.distance(position, 1, y)
        destination = order.distance(position, 2, x), order.distance(position, 3, y)
        traverse = 0
        if self.letter == "+":
            traverse = self.arguments[5] or 0
            if quirks.helix_abs_fields == "all":
                traverse = order.distance(position, 5, z)
        return center, destination, traverse

    def end(self, position: Four, quirks: Mn400Quirks) -> Four:
        """Where the counters stand when it is over, if nothing ends it before."""
        if self.letter == ")":
            for segment in self.path(position):
                position = added(position, segment.displacement)
            return wrapped(position)
        if self.letter not in "A+":
            return wrapped(added(position, self.vector(position)))
        _, destination, traverse = self.circle(position, quirks)
        moved = [0] * AXES
        x, y, z = self.settings.plane
        moved[x], moved[y] = destination
        moved[z] += traverse
        return wrapped(added(position, moved))

    # -- legality (rule 3) --

    def check(self, position: Four, rules: MotionRules, quirks: Mn400Quirks) -> None:
        """Raises ParameterError if it cannot start at ``position``."""
        if self.letter in "A+":
            self._check_circle(position, rules, quirks)
        elif self.letter == "T":
            pulses = self.arguments[4]
            assert pulses is not None, "a required parameter"
            is_too_far = max(map(abs, self.vector(position))) > pulses
            if is_too_far and quirks.threader_overrate == "para_error":
                raise ParameterError
        elif self.letter == ")":
            if quirks.contour_pulses == "error" and self.is_paced:
                raise ParameterError
        elif quirks.multiplex_cap == "error":
            is_multi_axis = sum(map(bool, self.vector(position))) > 1
            if is_multi_axis and self.settings.speed * self.settings.multiplex > SPEED_MAX:
                raise ParameterError

    def _check_circle(self, position: Four, rules: MotionRules, quirks: Mn400Quirks) -> None:
        center, destination, _ = self.circle(position, quirks)
        x, y, z = self.settings.plane
        is_flat = self.letter == "A" or quirks.plane_z_check == "none" or z not in (x, y)
        if not is_flat or not arc_is_round(rules, center, destination):
            raise ParameterError

    # -- the plan --

    def plan(self, start: MoveStart, rules: MotionRules, quirks: Mn400Quirks) -> VectorMotion:
        """The motion."""
        settings, position = self.settings, start.position
        moving = MoveSettings(
            rules,
            profile=settings.profile,
            speed=settings.speed,
            multiplex=settings.multiplex,
            lash=settings.lash,
            lash_memory=start.memory,
            feed_permille=start.feed_permille,
        )
        if self.letter == "M":
            return straight(start.now, moving, self.vector(position))
        if self.letter == ")":
            return contour(start.now, moving, self.path(position), self.margin)
        if self.letter == "T":
            _, _, _, _, pulses, offset = self.arguments
            assert pulses is not None, "a required parameter"
            return thread(start.now, moving, self.vector(position), pulses, offset or 0)
        center, destination, traverse = self.circle(position, quirks)
        plane = Plane(*settings.plane)
        is_clockwise = self.arguments[4] == 1
        if self.letter == "A":
            return arc(start.now, moving, plane, center, destination, is_clockwise)
        turns = self.arguments[6] or 0
        return helix(start.now, moving, plane, center, destination, is_clockwise, traverse, turns)
