"""Commands and the grammar of their parameters (ledger §3.4).

    payload    = command [ parameter *( "," parameter ) ]
    parameter  = [ "-" ] 1*digit / ""                       "" is omitted

Rules
-----
1. A parameter is checked against its width before anything is computed with it: a number of twenty
   digits does not wrap (MN4-PAR-05).
2. Trailing parameters may be left out; a trailing comma is one that is omitted (MN4-PAR-10).
3. What an omitted parameter means is its own: an axis that does not move, a value that is kept, a
   value of its own, or an error (MN4-PAR-06, MN4-PAR-09).
4. One parameter out of range refuses the whole command (MN4-ERR-02).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, TypeAlias

from axistwin.devices.mn400.quirks import Mn400Quirks

SHORT_MAX: Final = 32767
SPEED_MIN, SPEED_MAX = 2, 100_000
MARGIN: Final = 20
"""Of a contour whose ( has none, in steps per second (MN4-CMD-CC-01)."""

_DIGITS: Final = frozenset(b"0123456789")
_DIGITS_MAX: Final = 20
"""More than any parameter has, leading zeros apart."""


class ParameterError(ValueError):
    """A parameter is malformed or out of range: PARA_ERROR."""


class NoSuchOutputError(ParameterError):
    """The number of an output is out of range: the code may be another one (``mn100_codes``)."""


class Omitted(Enum):
    """What an omitted parameter means."""

    REQUIRED = "it is an error"
    KEEP = "the setting keeps its value, or does not (MN4-AMB-49)"
    STAY = "the setting keeps its value (MN4-CMD-P-03)"
    STILL = "the axis does not move"


Arguments: TypeAlias = tuple[int | None, ...]
"""One value per parameter of the command; None for one that was omitted."""


@dataclass(frozen=True, slots=True)
class BoardParameter:
    """One parameter: its range, and what its omission means (or the value that it then has).

    is_long: of 32 bits, else of 16.  allowed: the only values; else ``low`` to ``high``.
    is_clipped: a value out of range may mean the nearest one that is not (MN4-AMB-24).
    is_sync: a negative value selects external sync (MN4-CMD-V-02).  is_output: the number of one.
    """

    omitted: Omitted | int = Omitted.REQUIRED
    is_long: bool = False
    low: int | None = None
    high: int | None = None
    allowed: tuple[int, ...] = ()
    is_clipped: bool = False
    is_sync: bool = False
    is_output: bool = False


@dataclass(frozen=True, slots=True)
class BoardCommand:
    """One command: its character, its name in the manual, and its parameters.

    is_motion: it moves axes, and hold keeps it back.  is_data: its reply has a value.
    """

    letter: str
    name: str
    parameters: tuple[BoardParameter, ...] = ()
    is_motion: bool = False
    is_data: bool = False


def _short(low: int, high: int, omitted: Omitted | int = Omitted.REQUIRED) -> BoardParameter:
    return BoardParameter(omitted, low=low, high=high)


def _one_of(*values: int, omitted: Omitted | int = Omitted.REQUIRED) -> BoardParameter:
    return BoardParameter(omitted, allowed=values)


def _four(parameter: BoardParameter) -> tuple[BoardParameter, ...]:
    return (parameter,) * 4


_DISTANCE: Final = BoardParameter(Omitted.STILL, is_long=True)
_COUNTER: Final = BoardParameter(Omitted.KEEP, is_long=True)
_DIRECTION: Final = _one_of(1, -1)
_SWITCH: Final = _one_of(0, 1)
_RATIO: Final = _short(1, SHORT_MAX)
_SPEED: Final = BoardParameter(is_long=True, low=SPEED_MIN, high=SPEED_MAX, is_clipped=True)
_PROFILE_SPEED: Final = replace(_SPEED, omitted=Omitted.KEEP)
_ACCELERATION: Final = replace(_PROFILE_SPEED, low=1, high=None)
_ARC: Final = (*_four(_DISTANCE), _DIRECTION)

COMMANDS: Final[Mapping[str, BoardCommand]] = {
    command.letter: command
    for command in (
        BoardCommand("A", "Arc", _ARC, is_motion=True),
        BoardCommand("(", "BeginCC", (_short(0, SHORT_MAX, MARGIN),)),
        BoardCommand(")", "EndCC"),
        BoardCommand("|", "ClearExitCode"),
        BoardCommand("C", "Control", (replace(_short(1, 8), is_output=True), _SWITCH)),
        BoardCommand("/", "ExitCode", is_data=True),
        BoardCommand(";", "FeedHold", (_SWITCH,)),
        BoardCommand("?", "FirmwareRev", is_data=True),
        BoardCommand(
            "+", "HelicalMove", (*_ARC, _DISTANCE, _short(0, SHORT_MAX, 0)), is_motion=True
        ),
        BoardCommand("H", "Hold", (_one_of(0, 1, omitted=Omitted.STILL),)),
        BoardCommand("J", "Jogger", (_SWITCH,)),
        BoardCommand("G", "JogTapSteps", (_RATIO,) * 5),
        BoardCommand("Y", "JogVelocity", (_SPEED,)),
        BoardCommand("S", "LimitStatus", is_data=True),
        BoardCommand("L", "LoadCount", _four(_COUNTER)),
        BoardCommand("M", "Mover", _four(_DISTANCE), is_motion=True),
        BoardCommand("{", "PauseMove"),
        BoardCommand("}", "ResumeMove"),
        BoardCommand("*", "PollDevices", is_data=True),
        BoardCommand("F", "Profile", (_PROFILE_SPEED, _PROFILE_SPEED, _ACCELERATION)),
        BoardCommand("Z", "Program"),
        BoardCommand("Q", "Quit"),
        BoardCommand("N", "ReadCount", is_data=True),
        BoardCommand("E", "ReadPosition", (_one_of(1, 2, omitted=Omitted.STILL),), is_data=True),
        BoardCommand("R", "ReadProgram", is_data=True),
        BoardCommand("K", "Release"),
        BoardCommand("&", "Retransmit"),
        BoardCommand("U", "RunProgram"),
        BoardCommand("I", "SetAbsMode", (_SWITCH,)),
        BoardCommand("=", "SetAddr", (_short(1, 127),)),
        BoardCommand("B", "SetBacklash", _four(_short(0, SHORT_MAX, Omitted.KEEP))),
        BoardCommand("D", "SetBacklashDir", _four(_one_of(1, -1, omitted=Omitted.KEEP))),
        BoardCommand("~", "SetBaudRate", (_short(0, 4),)),
        BoardCommand(".", "SetConfig"),
        BoardCommand("P", "SetCPlane", (_short(1, 4), _short(1, 4), _short(1, 4, Omitted.STAY))),
        BoardCommand("X", "SetMultiplex", (_one_of(1, 2, 4),)),
        BoardCommand("V", "SetSpeed", (replace(_SPEED, is_sync=True),)),
        BoardCommand("[", "ShieldStatus", is_data=True),
        BoardCommand(":", "SwitchStatus", is_data=True),
        BoardCommand(
            "T",
            "Threader",
            (
                *_four(_DISTANCE),
                BoardParameter(is_long=True, low=1),
                _short(0, SHORT_MAX, 0),
            ),
            is_motion=True,
        ),
    )
}
"""All commands by their characters (MN4-ERR-01 lists those that are none)."""


_OF_EACH_AXIS: Final = "MLBD"
"""Commands with one parameter for each axis of the board."""


def commands(quirks: Mn400Quirks) -> dict[str, BoardCommand]:
    """The commands of a board with ``quirks``."""
    found = dict(COMMANDS)
    if not quirks.has_feedhold_cmds:
        del found[";"], found[":"]
    long_ratio = replace(_RATIO, is_long=True, high=None)
    if quirks.g_widths == "32x5":
        found["G"] = replace(found["G"], parameters=(long_ratio,) * 5)
    elif quirks.g_widths == "16x4_32":
        found["G"] = replace(found["G"], parameters=(*_four(_RATIO), long_ratio))
    if quirks.measure_other == "plain":
        found["E"] = replace(found["E"], parameters=(BoardParameter(Omitted.STILL),))
    if not quirks.hold_takes_arg:
        found["H"] = replace(found["H"], parameters=())
    for letter in _OF_EACH_AXIS:
        found[letter] = replace(found[letter], parameters=found[letter].parameters[: quirks.axes])
    motor = _short(quirks.plane_base, quirks.plane_base + 3)
    motors = (motor, motor, replace(motor, omitted=Omitted.STAY))
    found["P"] = replace(found["P"], parameters=motors)
    return found


def arguments(command: BoardCommand, text: bytes, quirks: Mn400Quirks) -> Arguments:
    """The parameters in ``text``, what follows the command's character.  Raises ParameterError.

    Those of axes that the board does not have are omitted.
    """
    wanted = command.parameters
    if not (text or wanted):
        return ()
    fields = text.split(b",") if text else []
    if len(fields) > len(wanted) and quirks.extra_params == "para_error":
        raise ParameterError
    numbers = [_number(field) for field in fields][: len(wanted)]
    numbers += [None] * (len(wanted) - len(numbers))
    values = tuple(
        _omitted(parameter, quirks) if number is None else _checked(parameter, number, quirks)
        for parameter, number in zip(wanted, numbers, strict=True)
    )
    lacking = len(COMMANDS[command.letter].parameters) - len(wanted)
    return values + (None,) * lacking


def _number(field: bytes) -> int | None:
    """One parameter; None if it was omitted.  Raises ParameterError."""
    if not field:
        return None
    digits = field.removeprefix(b"-")
    if not digits or not _DIGITS.issuperset(digits) or len(digits.lstrip(b"0")) > _DIGITS_MAX:
        raise ParameterError
    return int(digits[-_DIGITS_MAX:]) * (-1 if field[:1] == b"-" else 1)


def _omitted(parameter: BoardParameter, quirks: Mn400Quirks) -> int | None:
    """The value of an omitted parameter, or None if that has a meaning of its own (rule 3)."""
    if isinstance(parameter.omitted, int):
        return parameter.omitted
    if parameter.omitted in (Omitted.STILL, Omitted.STAY):
        return None
    if parameter.omitted is Omitted.REQUIRED or quirks.omitted_param == "error":
        raise ParameterError
    if quirks.omitted_param == "keep":
        return None
    return _checked(parameter, 0, quirks)  # zero, where that is a value


def _checked(parameter: BoardParameter, value: int, quirks: Mn400Quirks) -> int:
    """``value``, if it is in range.  Raises ParameterError."""
    widest = (quirks.long_min, quirks.long_max) if parameter.is_long else (-SHORT_MAX, SHORT_MAX)
    if not widest[0] <= value <= widest[1]:
        raise ParameterError
    if parameter.is_sync and value < 0:
        if value != -1 and quirks.negative_v == "minus_one_only":
            raise ParameterError
        return value
    low = widest[0] if parameter.low is None else parameter.low
    high = widest[1] if parameter.high is None else parameter.high
    if parameter.is_clipped and quirks.speed_range_policy == "clip":
        return min(max(value, low), high)
    if not low <= value <= high or (parameter.allowed and value not in parameter.allowed):
        raise NoSuchOutputError if parameter.is_output else ParameterError
    return value
