"""The 40 commands: what parameters they have, in what ranges, and what is wrong with a text.

    text   command  [ parameter { "," parameter } ]
    parameter   [ "-" ] digit { digit }, or nothing: omitted

A text is judged as a board judges it (MN4-PAR-01 to MN4-PAR-10): first its grammar, then each
range, then what several parameters must be together.  What depends on a board's state (an arc in
absolute mode needs the counters) is not judged here but by the model.  Where the manual leaves
something open, the reading that is handed over decides (`ReadingOf`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from math import isqrt
from typing import Final

from axistwin_conformance.families.mn400 import codec

NARROW: Final = 32_767  # %, either way (MN4-PAR-04)
WIDE: Final = 2_147_483_647  # &, unless the board has another bound (MN4-AMB-48)
LEAST_RATE: Final = 2  # steps/s (MN4-MOT-02)
GREATEST_RATE: Final = 100_000
DEFAULT_MARGIN: Final = 20  # steps/s, of ( without a parameter (MN4-CMD-CC-01)
PARAMETER: Final = re.compile(r"-?[0-9]+")

ReadingOf = Callable[[str], str]  # switch → the reading that a board is held to


class ReplyForm(StrEnum):
    """What follows the START of a command that is carried out."""

    DONE = "DONE"
    DATA = "data"
    LISTING = "a packet for each line"
    PRESENT = "PRESENT"
    BAUD = "BAUDCHANGEOK, at the new rate"
    REPEATED = "the last message, without START"


class Omission(StrEnum):
    """What a parameter that is left out means."""

    REQUIRED = "PARA_ERROR"
    KEEPS = "the current value, or what MN4-AMB-49 makes of it"
    STAYS = "the current value"
    NOTHING = "no motion of that axis, or 0"
    DEFAULT = "the default"


@dataclass(frozen=True, slots=True)
class ParameterRule:
    """One parameter: its name, the ends of its range, and what leaving it out means.

    `is_wide`: written with & in the manual, so that its bounds are those of MN4-AMB-48 where it has
    no narrower ones.
    """

    name: str
    low: int
    high: int
    omission: Omission = Omission.REQUIRED
    is_wide: bool = False


@dataclass(frozen=True, slots=True)
class CommandRule:
    """One command: its letter, what it does in words, what answers it, its parameters.

    `moves`: it asks for motion, so that Hold keeps it (MN4-AMB-18).
    """

    letter: str
    title: str
    form: ReplyForm = ReplyForm.DONE
    parameters: tuple[ParameterRule, ...] = ()
    moves: bool = False


@dataclass(frozen=True, slots=True)
class ParsedCommand:
    """A command that a board carries out: None stands for each parameter that was left out."""

    letter: str
    values: tuple[int | None, ...] = ()

    def value(self, index: int, default: int = 0) -> int:
        """A parameter, or the default where it was left out."""
        found = self.values[index] if index < len(self.values) else None
        return default if found is None else found


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a text is refused, by which requirement, and that no such command exists at all."""

    reason: str
    requirement: str
    is_unknown: bool = False


def _wide(*names: str, omission: Omission = Omission.NOTHING) -> tuple[ParameterRule, ...]:
    return tuple(ParameterRule(name, -WIDE, WIDE, omission, is_wide=True) for name in names)


def _one(name: str, low: int, high: int, omission: Omission = Omission.REQUIRED) -> ParameterRule:
    return ParameterRule(name, low, high, omission)


def _each(
    names: str, low: int, high: int, omission: Omission = Omission.REQUIRED
) -> tuple[ParameterRule, ...]:
    return tuple(ParameterRule(name, low, high, omission) for name in names.split())


_AXES: Final = ("m1", "m2", "m3", "m4")
_ARC: Final = (*_wide("centre x", "centre y", "x", "y"), _one("direction", -1, 1))
_KEEPS: Final = Omission.KEEPS
_PULSES: Final = ParameterRule("pulses", 1, WIDE, Omission.REQUIRED, is_wide=True)

COMMANDS: Final[Mapping[str, CommandRule]] = {
    rule.letter: rule
    for rule in (
        CommandRule("A", "arc", parameters=_ARC, moves=True),
        CommandRule("(", "begin a contour", parameters=(
            _one("margin", 0, NARROW, Omission.DEFAULT),)),
        CommandRule("|", "clear the exit code"),
        CommandRule("C", "switch an output", parameters=_each("port", 1, 8) + _each("off", 0, 1)),
        CommandRule(")", "end the contour and run it", moves=True),
        CommandRule("/", "exit code", ReplyForm.DATA),
        CommandRule(";", "feed hold", parameters=_each("mode", 0, 1)),
        CommandRule("?", "firmware", ReplyForm.DATA),
        CommandRule("+", "helix", moves=True, parameters=(
            *_ARC, *_wide("z"), _one("turns", 0, NARROW, Omission.NOTHING))),
        CommandRule("H", "hold", parameters=(_one("mode", 0, 1, Omission.DEFAULT),)),
        CommandRule("J", "jog mode", parameters=_each("mode", 0, 1)),
        CommandRule("G", "steps per tap", parameters=_each("r1 r2 r3 r4 per_inch", 1, NARROW)),
        CommandRule("Y", "jog speed", parameters=(
            ParameterRule("speed", LEAST_RATE, GREATEST_RATE, is_wide=True),)),
        CommandRule("S", "inputs", ReplyForm.DATA),
        CommandRule("L", "load counters", parameters=_wide(*_AXES, omission=_KEEPS)),
        CommandRule("M", "move", parameters=_wide(*_AXES), moves=True),
        CommandRule("{", "pause"),
        CommandRule("*", "poll", ReplyForm.PRESENT),
        CommandRule("F", "profile", parameters=(
            ParameterRule("start", LEAST_RATE, GREATEST_RATE, _KEEPS, is_wide=True),
            ParameterRule("end", LEAST_RATE, GREATEST_RATE, _KEEPS, is_wide=True),
            ParameterRule("acceleration", 1, WIDE, _KEEPS, is_wide=True))),
        CommandRule("Z", "enter a program"),
        CommandRule("Q", "quit"),
        CommandRule("N", "steps left", ReplyForm.DATA),
        CommandRule("E", "position", ReplyForm.DATA, (_one("measure", 1, 2, Omission.DEFAULT),)),
        CommandRule("R", "list the program", ReplyForm.LISTING),
        CommandRule("K", "release"),
        CommandRule("}", "resume"),
        CommandRule("&", "repeat the last message", ReplyForm.REPEATED),
        CommandRule("U", "run the program"),
        CommandRule("I", "coordinate mode", parameters=_each("mode", 0, 1)),
        CommandRule("=", "set the address", parameters=_each("id", 1, 127)),
        CommandRule("B", "backlash", parameters=_each("m1 m2 m3 m4", 0, NARROW, _KEEPS)),
        CommandRule("D", "backlash directions", parameters=_each("m1 m2 m3 m4", -1, 1, _KEEPS)),
        CommandRule("~", "set the rate", ReplyForm.BAUD, _each("rate", 0, 4)),
        CommandRule(".", "enter the configuration"),
        CommandRule("P", "plane", parameters=(
            *_each("x y", 1, 4), _one("z", 1, 4, Omission.STAYS))),  # MN4-CMD-P-03
        CommandRule("X", "multiplex", parameters=_each("multiplex", 1, 4)),
        CommandRule("V", "speed", parameters=(
            ParameterRule("speed", -WIDE, GREATEST_RATE, is_wide=True),)),
        CommandRule("[", "shield", ReplyForm.DATA),
        CommandRule(":", "flags", ReplyForm.DATA),
        CommandRule("T", "thread", moves=True, parameters=(
            *_wide(*_AXES), _PULSES, _one("offset", 0, NARROW, Omission.NOTHING))),
    )
}  # fmt: skip
UNASSIGNED: Final = tuple("OW0123456789!\"#$%',-<>@\\]^_`")  # MN4-ERR-01
# Refusals that the manual leaves open: a board that serves such a text does not fail by it.
OPEN_REFUSALS: Final = frozenset(
    {
        "MN4-PAR-09", "MN4-CMD-V-04", "MN4-CMD-F-02", "MN4-CMD-B-02", "MN4-CMD-E-04",
        "MN4-CMD-HEL-04", "MN4-THR-05",
    }
)  # fmt: skip
# Of these no value in between is one (MN4-CMD-A-03, MN4-CMD-D-01, MN4-CMD-X-01).
_DIRECTIONS: Final = (-1, 1)
_MULTIPLEXES: Final = (1, 2, 4)


def rule_of(text: str) -> CommandRule | None:
    """The command of a text, whatever its case; None: no command begins so."""
    return COMMANDS.get(text[:1].upper())


def read_command(text: str, reading: ReadingOf) -> ParsedCommand | Refusal:
    """What a board makes of a text outside of entry modes, as far as no state decides."""
    rule = rule_of(text)
    if rule is None:
        return Refusal(f"no command {text[:1]!r}", "MN4-ERR-01", is_unknown=True)
    skips = reading("space_policy") == "skip"
    body = text[1:].replace(" ", "") if skips else text[1:]
    values = _values(body)
    if isinstance(values, Refusal):
        return values
    count = len(rule.parameters)
    if len(values) > count:
        if reading("extra_params") != "ignore":
            return Refusal(f"{len(values)} parameters, {count} at most", "MN4-PAR-09")
        values = values[:count]
    for parameter, value in zip(rule.parameters, _filled(values, count), strict=True):
        if refusal := _refused(rule, parameter, value, reading):
            return refusal
    command = ParsedCommand(rule.letter, _filled(values, count))
    return _together(command, reading) or command


def _values(body: str) -> tuple[int | None, ...] | Refusal:
    """The parameters of a text; an empty one is omitted."""
    if not body:
        return ()
    values: list[int | None] = []
    for part in body.split(","):
        if part and PARAMETER.fullmatch(part) is None:
            name = "MN4-PAR-03" if set(part) <= set("-0123456789") else "MN4-PAR-02"
            return Refusal(f"{part!r} is no decimal integer", name)
        values.append(codec.number_in(part) if part else None)
    return tuple(values)


def _filled(values: Sequence[int | None], count: int) -> tuple[int | None, ...]:
    """So many parameters: what is left out at the end is omitted (MN4-PAR-07)."""
    return (*values, *[None] * (count - len(values)))


def _refused(
    rule: CommandRule, parameter: ParameterRule, value: int | None, reading: ReadingOf
) -> Refusal | None:
    """Why a value cannot be that of a parameter; None: it can."""
    if value is None:
        is_error = parameter.omission is Omission.REQUIRED or (
            parameter.omission is Omission.KEEPS and reading("omitted_param") == "error"
        )
        if parameter.omission is Omission.KEEPS and reading("omitted_param") == "zero":
            is_error = not parameter.low <= 0 <= parameter.high or rule.letter == "D"
        return Refusal(f"{parameter.name} is missing", "MN4-PAR-09") if is_error else None
    if rule.letter == "H" and reading("hold_takes_arg") == "false":
        return Refusal("H has no parameter", "MN4-CMD-H-02")
    low, high = _bounds(rule, parameter, reading)
    if low <= value <= high:
        return None
    reason = f"{parameter.name} {value} is not within {low} to {high}"
    return Refusal(reason, _range_requirement(rule.letter, parameter, value))


# By which requirement a value that its width would hold is refused.
_RANGES: Final = {
    "A": "MN4-CMD-A-03", "+": "MN4-HEL-05", "B": "MN4-CMD-B-02", "C": "MN4-CMD-C-03",
    "D": "MN4-CMD-D-01", "F": "MN4-CMD-F-02", "G": "MN4-CMD-G-02", "V": "MN4-CMD-V-04",
    "Y": "MN4-MOT-02", "X": "MN4-CMD-X-01", "=": "MN4-CMD-ADDR-02", "~": "MN4-CMD-BAUD-02",
    "E": "MN4-CMD-E-04",
}  # fmt: skip


def _range_requirement(letter: str, parameter: ParameterRule, value: int) -> str:
    if abs(value) > (WIDE if parameter.is_wide else NARROW):
        return "MN4-PAR-05" if parameter.is_wide else "MN4-PAR-04"
    return _RANGES.get(letter, "MN4-ERR-02")


def _bounds(rule: CommandRule, parameter: ParameterRule, reading: ReadingOf) -> tuple[int, int]:
    """The range of a parameter in the reading of this board."""
    low, high = parameter.low, parameter.high
    if rule.letter == "P":
        base = int(reading("plane_base"))
        return base, base + 3
    if rule.letter == "G" and (widths := reading("g_widths")) != "16x5":
        return low, WIDE if widths == "32x5" or parameter.name == "per_inch" else high
    if parameter.is_wide:
        widest = int(reading("long_min")), int(reading("long_max"))
        low = widest[0] if parameter.low == -WIDE else low
        high = widest[1] if parameter.high == WIDE else high
        if reading("speed_range_policy") == "clip" and rule.letter in "VFY":
            return (1 if parameter.name == "acceleration" else widest[0]), widest[1]
    if rule.letter == "E" and reading("measure_other") == "plain":
        return -NARROW, NARROW
    return low, high


def _together(command: ParsedCommand, reading: ReadingOf) -> Refusal | None:
    """Why parameters that are in range each cannot stand together; None: they can."""
    letter, values = command.letter, command.values
    if letter in "A+" and command.value(4) not in _DIRECTIONS:
        return Refusal("a direction is 1 or -1", "MN4-CMD-A-03")
    if letter == "D" and not {*values} <= {*_DIRECTIONS, None}:
        return Refusal("a direction is 1 or -1", "MN4-CMD-D-01")
    if letter == "X" and values[0] not in _MULTIPLEXES:
        return Refusal("a multiplex is 1, 2 or 4", "MN4-CMD-X-01")
    if letter == "P":
        return _plane(command, reading)
    is_clipped = reading("speed_range_policy") == "clip"
    if letter == "V":
        return _speed(command.value(0), reading)
    if letter == "F" and not is_clipped and None not in values[:2]:
        start, end = command.value(0), command.value(1)
        return Refusal("start above end", "MN4-CMD-F-02") if start > end else None
    return None


def _plane(command: ParsedCommand, reading: ReadingOf) -> Refusal | None:
    x, y, z = command.values
    if x == y:
        return Refusal("X and Y are one motor", "MN4-CMD-P-02")
    if z is not None and z in (x, y) and reading("plane_z_check") == "at_plane":
        return Refusal("the traverse motor is in the plane", "MN4-CMD-P-03")
    return None


def _speed(speed: int, reading: ReadingOf) -> Refusal | None:
    """Why a speed that V's width holds is none: 0 and 1, and negative ones but -1 where only that
    one means external sync (MN4-AMB-23)."""
    if 0 <= speed < LEAST_RATE and reading("speed_range_policy") != "clip":
        return Refusal(f"a speed is {LEAST_RATE} or more", "MN4-CMD-V-04")
    if speed < -1 and reading("negative_v") == "minus_one_only":
        return Refusal("of negative speeds there is -1", "MN4-CMD-V-02")
    return None


def arc_radii_differ(
    centre: tuple[int, int], end: tuple[int, int], tolerance: Fraction
) -> Refusal | None:
    """Why no arc has that centre and that end, both from its start; None: there is one.

    Exact: two square roots differ by no more than a tolerance, without a float (MN4-ARC-02).
    """
    square0 = centre[0] ** 2 + centre[1] ** 2
    square1 = (end[0] - centre[0]) ** 2 + (end[1] - centre[1]) ** 2
    if square0 == 0:
        return Refusal("a radius of 0", "MN4-ARC-07")
    if roots_differ_by_more(square0, square1, tolerance):
        radii = f"{isqrt(square0)} and {isqrt(square1)}"
        return Refusal(f"radii of about {radii}", "MN4-CMD-A-04")
    return None


def roots_differ_by_more(square0: int, square1: int, tolerance: Fraction) -> bool:
    """True if the square roots of two numbers differ by more than the tolerance, exactly."""
    # (a - b)^2 > t^2  <=>  a^2 + b^2 - t^2 > 2ab; both sides squared where the left is positive.
    left = square0 + square1 - tolerance**2
    return left > 0 and left**2 > 4 * square0 * square1
