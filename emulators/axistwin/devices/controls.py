"""What can be worked and seen of a device from outside, as data: one table per family.

Python handles and the fixture are made from the tables (``runtime/twin.py``), and so is whatever
else works devices by the names of their controls.

Rules
-----
1. Values are plain (bool, int, float, str, None, lists and mappings of them) but for a ``program``.
2. A control with ``keys`` stands for one value per key: ``inputs.reset``, ``flags.200``.
   A ``record`` is set as a whole, or one of its ``members``: ``load.held``.
3. A table checks what does not depend on the device; a device checks what it is told all the same.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, TypeAlias

from axistwin.errors import UsageError, nearest

Kind: TypeAlias = Literal[
    "switch", "number", "whole", "choice", "text", "data", "record", "program", "nothing"
]
"""What a value is; ``data`` is only read, ``nothing`` is what an action without a value takes."""

NUMBER_MAX: Final = 1e18
WHOLE_MAX: Final = 2**63 - 1
"""The largest numbers that are taken by any control; most have closer limits."""

KEYS_SHOWN_MAX: Final = 32
"""Of a control with more keys nobody shows all values together."""


class Bit(NamedTuple):
    """What bit ``number`` (0 is the lowest) of a number is called, and the requirement behind."""

    number: int
    name: str
    requirement: str


@dataclass(frozen=True, slots=True)
class Control:
    """One thing that can be worked or seen.

    field: what its device's snapshot calls it.  read: or else the method of the device that gives
    it, called with the time and the key, if it has keys.  write: the method that works it, called
    with the time, the key and the value.  scale: the device's units in one of ours.
    unit, low, high: of a number.  bits: of a whole number that has some.  is_queue: it tells how
    many commands wait.
    choices: of a choice.  keys: texts or numbers (rule 2).
    names: the snapshot's field that has numbers by name.  noun: what messages call it, the name
    unless given.  record, members: the class of a record and what it consists of.
    is_live: whoever looks on is told when it changes; else it is only looked up.
    attribute: what Python handles call it, the name unless given; "": they do not have it.
    parameters: of the Python method that works it; default: of the last one.
    """

    name: str
    kind: Kind
    doc: str
    field: str = ""
    read: str = ""
    write: str = ""
    scale: int = 1
    unit: str = ""
    low: float | None = None
    high: float | None = None
    bits: tuple[Bit, ...] = ()
    is_queue: bool = False
    choices: tuple[str, ...] = ()
    keys: tuple[str, ...] | range | None = None
    names: str = ""
    noun: str = ""
    record: type[Any] | None = None
    members: "tuple[Control, ...]" = ()
    is_live: bool = True
    attribute: str | None = None
    parameters: tuple[str, ...] | None = None
    default: Any = None

    @property
    def python_name(self) -> str:
        """What it is called on a handle; empty if it is not there."""
        return self.name if self.attribute is None else self.attribute

    @property
    def is_shown(self) -> bool:
        """Whether its device tells its value, or those for its keys, that can be shown together."""
        few = self.keys is None or len(self.keys) <= KEYS_SHOWN_MAX
        return bool(self.read or self.field) and few and self.kind != "program"

    def label(self, *keys: int | str) -> str:
        """What messages call it, or the value for a key."""
        return " ".join((self.noun or self.name, *map(str, keys)))

    def checked(self, value: Any, *keys: int | str) -> Any:
        """``value`` as the device takes it.  Raises UsageError."""
        check = _CHECKS.get(self.kind)
        return value if check is None else check(self, value, self.label(*keys))


def _switch(_: Control, value: Any, label: str) -> bool:
    if value not in (False, True):
        raise UsageError(f"{label}: {value!r} is not allowed; set True or False")
    return bool(value)


def _number(control: Control, value: Any, label: str) -> float:
    low, high = control.low, control.high
    allowed = f"{low:g}..{high:g}" if high is not None else f"at least {low:g}"
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{label} = {value!r} is no number; set {allowed} {control.unit}")
    is_within = (low is None or low <= value) and (high is None or value <= high)
    if not (is_within and abs(value) <= NUMBER_MAX):
        raise UsageError(f"{label} = {value!r} is out of range: {allowed} {control.unit}")
    return float(value)


def _whole(control: Control, value: Any, label: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        if abs(value) > WHOLE_MAX:
            raise UsageError(f"{label} is out of range: -{WHOLE_MAX}..{WHOLE_MAX} {control.unit}")
        return value
    if control.unit:
        raise UsageError(f"{label} {value!r} is no number of {control.unit}; give a whole number")
    raise UsageError(f"{label} = {value!r} is no whole number")


def _choice(control: Control, value: Any, label: str) -> str:
    if value not in control.choices:
        raise UsageError(f"{label} {value!r}: {nearest(str(value), control.choices)}")
    return str(value)


def _text(control: Control, value: Any, label: str) -> str:
    if not isinstance(value, str):
        raise UsageError(f"{label} {value!r} is no text; give a text")
    return value


def _record(control: Control, value: Any, label: str) -> Any:
    assert control.record is not None, "a record has a class"
    if isinstance(value, control.record):
        return value
    wanted = f"{control.record.__name__} of {control.record.__module__}"
    raise UsageError(f"{label} {value!r} is not allowed; set a {wanted}")


_CHECKS: Final[Mapping[str, Callable[[Control, Any, str], Any]]] = {
    "switch": _switch,
    "number": _number,
    "whole": _whole,
    "choice": _choice,
    "text": _text,
    "record": _record,
}


@dataclass(frozen=True, eq=False, slots=True)
class ControlTable:
    """The controls of a family; ``noun`` is what messages call its devices."""

    noun: str
    controls: tuple[Control, ...]

    def __iter__(self) -> Iterator[Control]:
        return iter(self.controls)

    def attributes(self) -> list[str]:
        """What Python handles have of it."""
        return [control.python_name for control in self.controls if control.python_name]


class AxisReadout(NamedTuple):
    """How the motion of a device is followed, to be plotted.

    names: of its axes.  unit: of positions.  position, rate: the controls that have them (rate per
    second), one number or one for each axis; a control ``is_moving`` tells when all stand.
    query: asks for the positions, in words that the family composes.  answer: finds them, as group
    1, in the reply as the family explains it.
    """

    names: tuple[str, ...]
    unit: str
    position: str
    rate: str
    query: str
    answer: str


POWER: Final = Control("power", "switch", "the supply, on or off", attribute="")
"""Worked by the line or bus, which stops sending too; a device has no way to switch itself."""

COMMON: Final = (
    POWER,
    Control("address", "whole", "the address it answers at now", "address"),
    Control("state", "text", "what it is doing now, in words", "state_text"),
    Control(
        "cells",
        "data",
        "the nonvolatile cells by name, as they are now",
        read="cells",
        is_live=False,
    ),
)
"""What every device has."""
