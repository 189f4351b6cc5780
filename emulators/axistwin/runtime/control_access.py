"""How the controls of one device are worked and read: all of them by name, and as values of Python.

Everything acts at the present time of the device's line or bus.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any, Protocol

from axistwin.devices.controls import POWER, Control, ControlTable
from axistwin.errors import UnknownNameError, UsageError, nearest
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos


class Present(Protocol):
    """What a twin acts through: the devices of a line or bus at their present time."""

    def present(self) -> AbstractContextManager[Nanos]:
        """The present time, which stands still in the block."""

    def advance(self, duration_ns: Nanos) -> Nanos:
        """Let ``duration_ns`` pass; returns the present time."""

    def act(self, index: int, action: Callable[[Nanos], Sequence[Effect]]) -> Nanos:
        """Have ``action`` do something to device ``index`` now, and perform its effects."""

    def set_power(self, index: int, on: bool) -> Nanos:
        """Apply or cut the supply of device ``index`` now."""

    def note(self, text: str) -> None:
        """Keep for a transcript what is done now."""

    def tell_worked(self, index: int, name: str, value: Callable[[], Any]) -> None:
        """Tell who looks on that control ``name`` of device ``index`` was worked; its value."""


class DeviceAccess:
    """Works and reads the controls of device ``index`` of a simulation."""

    def __init__(
        self, simulation: Present, index: int, name: str, device: Any, table: ControlTable
    ) -> None:
        self.simulation = simulation
        self.name = name
        self.table = table
        self.is_powered = True
        self._index = index
        self._device = device

    def set_power(self, *, on: bool) -> Nanos:
        """Apply or cut the supply, and when; nothing happens if it is so already."""
        with self.simulation.present() as now:
            if self.is_powered is on:
                self.simulation.tell_worked(self._index, POWER.name, lambda: on)
                return now
            self.is_powered = on
            self.simulation.note(f"{self.name}: power {'on' if on else 'off'}")
            return self.simulation.set_power(self._index, on=on)

    def read(self, control: Control, *key: int | str) -> Any:
        """How ``control`` is now."""
        with self.simulation.present() as now:
            shown = self._device.describe(now) if control.field else {}
            return self._value(control, now, shown, *key)

    def read_all(self, *, is_live: bool = False) -> tuple[Nanos, dict[str, Any]]:
        """The present time, and all that can be read then: plain values by the names of controls.

        is_live: without what is only looked up from time to time.
        """
        with self.simulation.present() as now:
            shown = self._device.describe(now)
            values: dict[str, Any] = {}
            for control in self.table:
                if not (control is POWER or control.is_shown) or (is_live and not control.is_live):
                    continue
                for key in control.keys or ():
                    name = f"{control.name}.{key}"
                    values[name] = plain(self._value(control, now, shown, key))
                if control.keys is not None:
                    continue
                value = self._value(control, now, shown)
                for member in control.members:
                    values[f"{control.name}.{member.name}"] = plain(getattr(value, member.name))
                if not control.members:
                    values[control.name] = plain(value)
            return now, values

    def _value(
        self, control: Control, now: Nanos, shown: Mapping[str, Any], *key: int | str
    ) -> Any:
        if control is POWER:
            return self.is_powered
        if not control.field:
            return getattr(self._device, control.read)(now, *key)
        value = shown[control.field]
        return value if control.scale == 1 else value / control.scale

    def work(
        self,
        control: Control,
        *arguments: Any,
        shown: int | str | None = None,
        member: str | None = None,
    ) -> Nanos:
        """Work ``control``, and when: a key, if it has keys, and a value.

        shown: the key as written.  member: the only one of a record that is set.
        """
        if control.kind != "nothing":
            *keys, value = arguments
            names = keys if shown is None else [shown]
            value = control.checked(value, *names)
            arguments = (*keys, value if control.scale == 1 else round(value * control.scale))
        if control is POWER:
            return self.set_power(on=arguments[0])
        if control.kind == "program":
            from axistwin.programs import find_program

            arguments = tuple(map(find_program, arguments))
        self._note(control, arguments, shown)
        write = getattr(self._device, control.write)

        def write_and_tell(now: Nanos) -> Sequence[Effect]:
            effects: Sequence[Effect] = write(now, *arguments)
            self._tell_worked(control, now, arguments[:-1], member)
            return effects

        return self.simulation.act(self._index, write_and_tell)

    def _tell_worked(
        self, control: Control, now: Nanos, keys: tuple[Any, ...], member: str | None
    ) -> None:
        """Tell who looks on: of a record, what is set of it."""

        def value(attribute: str | None = None) -> Any:
            if not (control.read or control.field) or control.kind == "program":
                return None
            shown = self._device.describe(now) if control.field else {}
            found = self._value(control, now, shown, *keys)
            return plain(found if attribute is None else getattr(found, attribute))

        names = [each.name for each in control.members if member in (None, each.name)]
        for name in names:
            self.simulation.tell_worked(self._index, f"{control.name}.{name}", partial(value, name))
        if not names:
            name = ".".join((control.name, *map(str, keys)))
            self.simulation.tell_worked(self._index, name, value)

    def _note(self, control: Control, arguments: tuple[Any, ...], shown: int | str | None) -> None:
        """Keep what a hand does: ``inputs.reset = True``."""
        *keys, value = arguments if arguments else (None,)
        keys = keys if shown is None else [shown]
        name = ".".join((control.name, *map(str, keys)))
        given = value / control.scale if control.scale != 1 else getattr(value, "__name__", value)
        text = name if not arguments else f"{name} = {given}"
        self.simulation.note(f"{self.name}: {text}")

    def number(self, control: Control, key: int | str) -> int:
        """The number of a flag, or address of a variable, that ``key`` means."""
        label = control.label()
        if isinstance(key, bool) or not isinstance(key, int | str):
            raise UsageError(f"{label} {key!r} is no number; give a number, or a name")
        if isinstance(key, int):
            return key
        if not control.names:
            raise UsageError(f"{label} {key!r} is no number; give a number")
        with self.simulation.present() as now:
            names: Mapping[str, int] = self._device.describe(now)[control.names]
        if not names:
            raise UsageError(f"{label} {key!r}: {self.name} has no program with names; load one")
        return names[_checked_name(label, key, names)]


def plain(value: Any) -> Any:
    """``value`` as JSON has it: an exact fraction as a number, any mapping or row as its own."""
    if isinstance(value, Fraction):
        return float(value)
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value


# -- what controls with keys, and records, look like -------------------------------------------


class _Values:
    """What stands for ``control`` on a handle."""

    __slots__ = ("_access", "_control")

    _control: Control
    _access: DeviceAccess

    def __init__(self, access: DeviceAccess, control: Control) -> None:
        object.__setattr__(self, "_access", access)  # past the setters of the kinds below
        object.__setattr__(self, "_control", control)


class NamedValues(_Values):
    """A control with names for keys: ``twin.inputs.reset = True``."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._access.read(self._control, self._checked_name(name))

    def __setattr__(self, name: str, value: Any) -> None:
        self._access.work(self._control, self._checked_name(name), value)

    def _checked_name(self, name: str) -> str:
        return _checked_name(self._control.noun, name, tuple(self._control.keys or ()))

    def __repr__(self) -> str:
        shown = (f"{name}={getattr(self, str(name))}" for name in self._control.keys or ())
        return f"{self._control.name.capitalize()}({', '.join(shown)})"


class RecordValues(_Values):
    """A record: set as a whole, ``twin.load = Load(...)``, or value by value."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self._whole(), self._checked_name(name))

    def __setattr__(self, name: str, value: Any) -> None:
        changed = {self._checked_name(name): value}
        self._access.work(self._control, replace(self._whole(), **changed), member=name)

    def _whole(self) -> Any:
        return self._access.read(self._control)

    def _checked_name(self, name: str) -> str:
        known = tuple(member.name for member in self._control.members)
        return _checked_name(self._control.label(), name, known)

    def __eq__(self, other: object) -> bool:
        return bool(self._whole() == (other._whole() if type(other) is RecordValues else other))

    __hash__ = None  # type: ignore[assignment]  # it changes

    def __repr__(self) -> str:
        return repr(self._whole())


class NumberedValues(_Values):
    """A control with numbers for keys: ``twin.variables[2008]``, or by the program's names."""

    __slots__ = ()
    __iter__ = None  # or Python would count up from 0

    def __getitem__(self, key: int | str) -> Any:
        return self._access.read(self._control, self._access.number(self._control, key))

    def __setitem__(self, key: int | str, value: Any) -> None:
        number = self._access.number(self._control, key)
        self._access.work(self._control, number, value, shown=key)


class Switches(NumberedValues):
    """Numbered switches: ``twin.flags[200] = True``, or by the program's names."""

    __slots__ = ()

    @property
    def on(self) -> list[int]:
        """The numbers of all that are on, ascending."""
        keys = self._control.keys
        assert isinstance(keys, range), "numbered"
        with self._access.simulation.present():
            return [number for number in keys if self._access.read(self._control, number)]

    def __repr__(self) -> str:
        on = ", ".join(map(str, self.on)) or "none"
        return f"<{self._control.name.capitalize()} on: {on}>"


# -- all controls by name ----------------------------------------------------------------------


class BoundControl:
    """One control of one twin: ``set`` works it, ``value`` is how it is now."""

    def __init__(self, access: DeviceAccess, control: Control, key: int | str | None) -> None:
        self._access = access
        self._control = control
        self._keys = () if key is None else (key,)
        self._member = next((each for each in control.members if each.name == key), None)
        shown = self._member or control
        self.name = control.name if key is None else f"{control.name}.{key}"
        self.kind, self.doc, self.unit = shown.kind, shown.doc, shown.unit
        self.low, self.high, self.choices = shown.low, shown.high, shown.choices
        self.bits, self.is_queue = shown.bits, shown.is_queue
        self.has_numbers = isinstance(control.keys, range) and key is None
        self.keys = control.keys if self.has_numbers else None
        self.is_readable = control is POWER or bool(control.read or control.field)
        self.is_writable = control is POWER or bool(control.write)

    def __repr__(self) -> str:
        return f"<control {self.name} of {self._access.name}>"

    @property
    def value(self) -> Any:
        """How it is now, as a plain value.  Raises UsageError if it is only worked."""
        self._need_number()
        if not self.is_readable:
            raise UsageError(f"control {self.name} of {self._access.name} is only worked, not read")
        if self._member is None:
            return self._access.read(self._control, *self._keys)
        return plain(getattr(self._access.read(self._control), self._member.name))

    def set(self, value: Any = None) -> Nanos:
        """Work it, and when; an action that takes nothing is given nothing.  Raises UsageError."""
        self._need_number()
        if not self.is_writable:
            raise UsageError(f"control {self.name} of {self._access.name} is only read, not worked")
        if self._member is None:
            values = () if self.kind == "nothing" else (value,)
            return self._access.work(self._control, *self._keys, *values)
        with self._access.simulation.present():
            whole = self._access.read(self._control)
            checked = self._member.checked(value)
            name = self._member.name
            return self._access.work(self._control, replace(whole, **{name: checked}), member=name)

    def _need_number(self) -> None:
        if self.has_numbers:
            example = f"{self.name}.{(self._control.keys or [0])[0]}"
            raise UsageError(
                f"control {self.name} of {self._access.name} has numbers: name one, "
                f"such as {example}"
            )


class Controls(Mapping[str, BoundControl]):
    """The controls of a twin by name.

    Of a control with numbers for keys the name is listed, and each number can be had:
    ``controls["flags.200"]``; by the names of its program too.
    """

    def __init__(self, access: DeviceAccess) -> None:
        self._access = access
        self._rows = {row.name: row for row in access.table}

    def __iter__(self) -> Iterator[str]:
        for row in self._rows.values():
            if row.members:
                yield from (f"{row.name}.{member.name}" for member in row.members)
            elif isinstance(row.keys, tuple):
                yield from (f"{row.name}.{key}" for key in row.keys)
            elif row.kind != "program" or row.write:
                yield row.name

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __contains__(self, name: object) -> bool:
        # Not by ``__getitem__`` alone: it looks for names that resemble one that is unknown.
        row = name.partition(".")[0] if isinstance(name, str) else name
        return row in self._rows and super().__contains__(name)

    def read_all(self, *, is_live: bool = False) -> tuple[Nanos, dict[str, Any]]:
        """The present time, and all that can be read then: plain values by name.

        Of numbers for keys, those of a few.  is_live: without what is only looked up from time to
        time, such as all cells.
        """
        return self._access.read_all(is_live=is_live)

    def __getitem__(self, name: str) -> BoundControl:
        if name in iter(self):
            row, _, key = name.partition(".")
            return BoundControl(self._access, self._rows[row], key or None)
        row, _, key = name.partition(".")
        control = self._rows.get(row)
        if control is None or not isinstance(control.keys, range) or not key:
            raise UnknownNameError(
                f"{self._access.name} has no control {name!r}: {nearest(name, self)}"
            )
        number = int(key) if key.isascii() and key.isdigit() else key
        return BoundControl(self._access, control, self._access.number(control, number))


def _checked_name(kind: str, name: str, known: "Mapping[str, object] | tuple[Any, ...]") -> str:
    if name not in known:
        raise UsageError(f"unknown {kind} {name!r}: {nearest(name, known)}")
    return name
