"""What modal commands set: the volatile state of a board that moves nothing by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Final

from axistwin_conformance.families.mn400.grammar import ParsedCommand, ReadingOf
from axistwin_conformance.families.mn400.planner.circle import CircleRules
from axistwin_conformance.families.mn400.planner.speed import MotionProfile
from axistwin_conformance.families.mn400.planner.vector import BacklashState, MotionSettings

ON: Final = "1"
UNCOMPENSATED: Final = BacklashState()


@dataclass(frozen=True, slots=True)
class BoardSettings:
    """The modal state, as at power-on unless something is said.

    `speed`: steps/s, negative for external sync.  `profile`: start, end, acceleration as F was
    given them.  `plane`: X, Y and traverse motor, from 0.  `is_absolute`: the coordinate mode.
    `outputs`: those that are on, from 1.
    """

    speed: int = 2000
    profile: tuple[int, int, int] = (1000, 5000, 10_000)
    backlash: BacklashState = UNCOMPENSATED
    plane: tuple[int, int, int] = (0, 2, 1)
    multiplex: int = 1
    is_absolute: bool = False
    holds: bool = False
    feed_hold: int = 0
    jog_speed: int = 1000
    taps: tuple[int, int, int, int, int] = (2000, 1000, 100, 10, 8000)
    outputs: frozenset[int] = frozenset()

    @property
    def is_synced(self) -> bool:
        """True if external pulses pace every motion."""
        return self.speed < 0

    def motion_profile(self, reading: ReadingOf) -> MotionProfile:
        """The profile in effect on this board."""
        start, end, acceleration = self.profile
        scale = Fraction(reading("accel_scale"))
        return MotionProfile(start, end, acceleration * scale)

    def motion(self, reading: ReadingOf) -> MotionSettings:
        """With what a vector move begins."""
        is_clipped = reading("multiplex_cap") == "clip"
        return MotionSettings(self.speed, self.motion_profile(reading), self.multiplex, is_clipped)

    def circle(self, reading: ReadingOf) -> CircleRules:
        """With what a circle begins."""
        return CircleRules(
            self.speed,
            self.motion_profile(reading),
            is_tangential=reading("arc_rate") == "tangential",
            is_ramped=reading("arc_ramp") == "true",
            is_full_at_zero=reading("arc_zero_sweep") == "full",
        )

    def after(self, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
        """The state after a modal command; the same after any other."""
        change = _CHANGES.get(command.letter)
        return self if change is None else change(self, command, reading)


Change = Callable[[BoardSettings, ParsedCommand, ReadingOf], BoardSettings]


def _kept(old: Sequence[int], new: Sequence[int | None], reading: ReadingOf) -> tuple[int, ...]:
    """New values; one that was left out keeps the old (MN4-PAR-09) or is 0 (MN4-AMB-49)."""
    is_kept = reading("omitted_param") != "zero"
    pairs = zip(old, new, strict=True)
    return tuple((was if is_kept else 0) if one is None else one for was, one in pairs)


def _speed(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    return replace(state, speed=command.value(0))


def _profile(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    start, end, acceleration = _kept(state.profile, command.values, reading)
    return replace(state, profile=(start, end, acceleration))


def _backlash(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    steps = _kept(state.backlash.steps, command.values, reading)
    return replace(state, backlash=replace(state.backlash, steps=steps))


def _directions(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    pairs = zip(state.backlash.memory, command.values, strict=True)
    memory = tuple(was if one is None else one for was, one in pairs)
    return replace(state, backlash=replace(state.backlash, memory=memory))


def _plane(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    base = int(reading("plane_base"))
    x, y, z = command.value(0), command.value(1), command.value(2, state.plane[2] + base)
    return replace(state, plane=(x - base, y - base, z - base))


def _mode(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    return replace(state, is_absolute=str(command.value(0)) == reading("abs_mode_value"))


def _hold(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    if command.values[0] is None and reading("hold_bare_arg") == "toggle":
        return replace(state, holds=not state.holds)
    return replace(state, holds=bool(command.value(0, 1)))


def _output(state: BoardSettings, command: ParsedCommand, reading: ReadingOf) -> BoardSettings:
    port, level = command.value(0), str(command.value(1))
    changed = {port}
    is_on = level == reading("output_on_state")
    return replace(state, outputs=state.outputs | changed if is_on else state.outputs - changed)


def _taps(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    first, second, third, fourth, unit = (command.value(index) for index in range(5))
    return replace(state, taps=(first, second, third, fourth, unit))


def _multiplex(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    return replace(state, multiplex=command.value(0))


def _feed_hold(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    return replace(state, feed_hold=command.value(0))


def _jog_speed(state: BoardSettings, command: ParsedCommand, _: ReadingOf) -> BoardSettings:
    return replace(state, jog_speed=command.value(0))


_CHANGES: Final[Mapping[str, Change]] = {
    "V": _speed, "F": _profile, "B": _backlash, "D": _directions, "P": _plane, "I": _mode,
    "H": _hold, "C": _output, "G": _taps, "X": _multiplex, ";": _feed_hold, "Y": _jog_speed,
}  # fmt: skip


def power_on(reading: ReadingOf) -> BoardSettings:
    """The modal state after power-up, without a configuration program (MN4-PWR-01, MN4-PWR-02)."""
    return BoardSettings(
        is_absolute=reading("power_on_mode") == "absolute",
        feed_hold=int(reading("feedhold_power_on") == ON),
        outputs=frozenset(range(1, 9) if reading("power_on_outputs") == "on" else ()),
    )
