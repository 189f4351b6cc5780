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

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect

Kind: TypeAlias = Literal[
    "switch", "number", "whole", "choice", "text", "data", "record", "program", "nothing"
]
"""What a value is; ``data`` is only read, ``nothing`` is what an action without a value takes."""

Read: TypeAlias = Callable[..., Any]
"""``read(device, now)``, with a key behind that where the control has keys."""

Write: TypeAlias = Callable[..., Sequence[Effect]]
"""``write(device, now, value)``; the key, if there is one, in front of the value."""


@dataclass(frozen=True, slots=True)
class Control:
    """One thing that can be worked or seen.

    unit, low, high: of a number.  choices: of a choice.  keys: texts or numbers (rule 2).
    names: reads which numbers have names.  noun: what messages call it, the name unless given.
    record, members: the class of a record and what it consists of.
    parameters: of the Python method that works it; "" in ``attribute``: not on Python handles.
    default: of the last parameter.  attribute: what Python calls it, the name unless given.
    """

    name: str
    kind: Kind
    doc: str
    read: Read | None = None
    write: Write | None = None
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] = ()
    keys: tuple[str, ...] | range | None = None
    names: Read | None = None
    noun: str = ""
    record: type[Any] | None = None
    members: "tuple[Control, ...]" = ()
    parameters: tuple[str, ...] | None = None
    default: Any = None
    attribute: str | None = None

    @property
    def python_name(self) -> str:
        """What it is called on a handle; empty if it is not there."""
        return self.name if self.attribute is None else self.attribute

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
    if not (low is None or low <= value) or not (high is None or value <= high):
        raise UsageError(f"{label} = {value!r} is out of range: {allowed} {control.unit}")
    return float(value)


def _whole(control: Control, value: Any, label: str) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if control.unit:
        raise UsageError(f"{label} {value!r} is no number of {control.unit}; give a whole number")
    raise UsageError(f"{label} = {value!r} is no whole number")


def _choice(control: Control, value: Any, label: str) -> str:
    if value not in control.choices:
        raise UsageError(f"{label} {value!r}: {nearest(str(value), control.choices)}")
    return str(value)


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


def seen(name: str) -> Read:
    """Reads what the device's snapshot has under ``name``."""
    return lambda device, now: device.describe(now)[name]


POWER: Final = Control("power", "switch", "the supply, on or off", attribute="")
"""Worked by the line or bus, which stops sending too; a device has no way to switch itself."""

COMMON: Final = (
    POWER,
    Control("address", "whole", "the address it answers at now", seen("address")),
    Control("state", "text", "what it is doing now, in words", seen("state_text")),
    Control(
        "cells",
        "data",
        "the nonvolatile cells by name, as they are now",
        lambda device, now: dict(device.cells(now)),
    ),
)
"""What every device has."""
