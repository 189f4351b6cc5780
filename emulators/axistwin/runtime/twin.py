"""A user's handle on one device, made from the controls of its family (``devices/controls.py``).

A control that is read or set is an attribute: ``twin.supply_volts = 30``; one with keys is indexed,
by number (``twin.flags[200]``) or by name (``twin.inputs.reset``); an action is a method.
``twin.controls`` has all of them by name: ``twin.controls["inputs.reset"].set(True)``.

Everything here acts at the present time of its line or bus and is over when it returns; from any
thread.
"""

import inspect
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any

from axistwin import discovery
from axistwin.devices.controls import Control, ControlTable
from axistwin.devices.snapshot import Snapshot
from axistwin.errors import UsageError, nearest
from axistwin.kernel.time import NS_PER_S
from axistwin.runtime.control_access import (
    Controls,
    DeviceAccess,
    NamedValues,
    NumberedValues,
    Present,
    RecordValues,
    Switches,
)

_PLAIN = ("name", "model")
"""What a twin has besides its properties."""

_POWER_CYCLE = Control("off_s", "number", "how long the supply is off", unit="s", low=0.0, high=1e6)


_EITHER_WAY = inspect.Parameter.POSITIONAL_OR_KEYWORD


class _NoSuchAttributeError(UsageError, AttributeError):
    """What is asked for is not there: a user's mistake, and ``hasattr`` understands it."""


class Twin:
    """One device, of any kind; its line or bus makes it, by the class of ``handle_class``."""

    _table: ControlTable

    def __init__(self, simulation: Present, index: int, name: str, model: str, device: Any) -> None:
        self._simulation = simulation
        self._device = device
        self._access = DeviceAccess(simulation, index, name, device, self._table)
        self.name = name
        self.model = model

    def __repr__(self) -> str:
        return f"<Twin {self.name}: {self.describe()['state_text']}>"

    if not TYPE_CHECKING:  # or else no misspelt name would be found by a type checker

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            raise _NoSuchAttributeError(self._no_such(name))

        def __setattr__(self, name: str, value: Any) -> None:
            if not (name.startswith("_") or hasattr(type(self), name) or name in _PLAIN):
                raise UsageError(self._no_such(name))
            member = getattr(type(self), name, None)
            if isinstance(member, property) and member.fset is None:
                raise _NoSuchAttributeError(self._read_only(name))
            object.__setattr__(self, name, value)

    def _no_such(self, name: str) -> str:
        known = [each for each in dir(self) if not each.startswith("_")]
        tables = [model.family.controls() for model in discovery.models().values()]
        nouns = dict.fromkeys(table.noun for table in tables if name in table.attributes())
        remedy = nearest(name, known)
        if nouns:
            remedy = f"that is for a {' or a '.join(nouns)}; known: {', '.join(known)}"
        return f"{self.name} is a {self._table.noun} and has no {name}: {remedy}"

    def _read_only(self, name: str) -> str:
        controls = [control for control in self._table if control.python_name]
        units = {control.unit for control in controls if control.python_name == name} - {""}
        remedy = ", ".join(
            f"{control.python_name}({', '.join(control.parameters)}) would {control.doc}"
            for control in controls
            if control.unit in units and control.parameters is not None
        )
        if not remedy:
            settable = (
                each for each in controls if each.write and not (each.keys or each.parameters)
            )
            remedy = f"can be set: {', '.join(each.python_name for each in settable)}"
        return f"{self.name}: {name} can only be read; {remedy}"

    def describe(self) -> Snapshot:
        """Everything worth showing of it, by name, as it is now."""
        with self._simulation.present() as now:
            found: Snapshot = self._device.describe(now)
            return found

    @property
    def controls(self) -> Controls:
        """All that can be worked and seen of it, by name."""
        return Controls(self._access)

    # -- power --------------------------------------------------------------------------------

    @property
    def is_powered(self) -> bool:
        """Whether the supply is applied."""
        return self._access.is_powered

    def power_off(self) -> None:
        """Cut the supply; nothing happens if it is off."""
        self._access.set_power(on=False)

    def power_on(self) -> None:
        """Apply the supply; nothing happens if it is on."""
        self._access.set_power(on=True)

    def power_cycle(self, off_s: float = 0.0) -> None:
        """Cut the supply for ``off_s`` seconds of the twin's time, then apply it.

        Returns when it is applied; the device then still needs the time it takes to start.
        """
        seconds = _POWER_CYCLE.checked(off_s)
        self.power_off()
        self._simulation.advance(round(seconds * NS_PER_S))
        self.power_on()


@cache
def handle_class(table: ControlTable) -> type[Twin]:
    """The class of twins with the controls of ``table``."""
    members: dict[str, Any] = {"_table": table, "__slots__": (), "__doc__": Twin.__doc__}
    for control in table:
        if control.python_name:
            members[control.python_name] = _member(control)
    return type(f"{table.noun.title().replace(' ', '')}Twin", (Twin,), members)


def _member(control: Control) -> Any:
    """What a control is on the class of a handle: a method or a property."""
    if control.parameters is not None:
        return _method(control, control.parameters)
    values = _values_class(control)

    def read(twin: Twin) -> Any:
        return values(twin._access, control) if values else twin._access.read(control)

    def work(twin: Twin, value: Any) -> None:
        twin._access.work(control, value)

    is_set = control.write and control.keys is None
    return property(read, work if is_set else None, doc=control.doc)


def _values_class(
    control: Control,
) -> Callable[[DeviceAccess, Control], object] | None:
    """What stands for several values on a handle; None for a control that has one."""
    if control.members:
        return RecordValues
    if control.keys is None:
        return None
    if isinstance(control.keys, tuple):
        return NamedValues
    return Switches if control.kind == "switch" else NumberedValues


def _method(control: Control, parameters: tuple[str, ...]) -> Callable[..., None]:
    """The method that works ``control``."""
    each = [inspect.Parameter(name, _EITHER_WAY) for name in parameters]
    if control.default is not None:
        each[-1] = each[-1].replace(default=control.default)
    signature = inspect.Signature(each)

    def work(twin: Twin, *positional: Any, **named: Any) -> None:
        arguments = signature.bind(*positional, **named)
        arguments.apply_defaults()
        twin._access.work(control, *arguments.args)

    work.__name__ = control.python_name
    work.__doc__ = control.doc
    return work
