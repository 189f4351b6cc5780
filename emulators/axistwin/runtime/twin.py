"""A user's handle on one device: what a hand, a supply and a load can do to it.

``Twin`` is what every device has, ``MotionTwin`` adds a shaft with its pins, ``ControllerTwin`` the
flags, variables and program of a controller.

Everything here acts at the present time of its line or bus and is over when it returns; from any
thread.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, Protocol

from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.motion.plant import Load

if TYPE_CHECKING:
    from axistwin.macroprogram import Macroprogram
    from axistwin.programs import ProgramSource

INPUTS = ("reference", "positive_stop", "negative_stop", "reset")

_PLAIN = ("name", "model")
"""What a twin has besides its properties."""

SUPPLY_MAX_VOLTS = 1000.0
TEMPERATURE_MIN_CELSIUS, TEMPERATURE_MAX_CELSIUS = -273.0, 1000.0


class Present(Protocol):
    """What a twin acts through: the devices of a line or bus at their present time."""

    def present(self) -> AbstractContextManager[Nanos]:
        """The present time, which stands still in the block."""

    def advance(self, duration_ns: Nanos) -> Nanos:
        """Let ``duration_ns`` pass; returns the present time."""

    def act(self, index: int, action: Callable[[Nanos], Sequence[Effect]]) -> None:
        """Have ``action`` do something to device ``index`` now, and perform its effects."""

    def set_power(self, index: int, on: bool) -> None:
        """Apply or cut the supply of device ``index`` now."""


class _NoSuchAttributeError(UsageError, AttributeError):
    """What is asked for is not there: a user's mistake, and ``hasattr`` understands it."""


class Inputs:
    """The input pins of a device, ``True`` while a contact ties one to ground.

    ``reference``, ``positive_stop``, ``negative_stop``, ``reset``.
    """

    __slots__ = ("_twin", "_values")

    _twin: "MotionTwin"
    _values: dict[str, bool]

    def __init__(self, twin: "MotionTwin") -> None:
        object.__setattr__(self, "_twin", twin)
        object.__setattr__(self, "_values", dict.fromkeys(INPUTS, False))

    def __getattr__(self, name: str) -> bool:
        if name.startswith("__"):
            raise AttributeError(name)
        return self._values[_checked_name("input", name, self._values)]

    def __setattr__(self, name: str, active: bool) -> None:
        _checked_name("input", name, self._values)
        value = _checked_switch(f"input {name}", active)
        self._twin._set_input(name, value)
        self._values[name] = value

    def __repr__(self) -> str:
        return f"Inputs({', '.join(f'{name}={value}' for name, value in self._values.items())})"


class LoadHandle:
    """What is coupled to the shaft; each of its values can be set on its own.

    See ``axistwin.motion.plant.Load`` for names, units and ranges.
    """

    __slots__ = ("_twin",)

    _twin: "MotionTwin"

    def __init__(self, twin: "MotionTwin") -> None:
        object.__setattr__(self, "_twin", twin)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        load = self._twin._load
        return getattr(load, _checked_name("load", name, _names_of(load)))

    def __setattr__(self, name: str, value: Any) -> None:
        load = self._twin._load
        _checked_name("load", name, _names_of(load))
        self._twin.load = replace(load, **{name: value})

    def __eq__(self, other: object) -> bool:
        return bool(self._twin._load == (other._twin._load if type(other) is LoadHandle else other))

    __hash__ = None  # type: ignore[assignment]  # it changes

    def __repr__(self) -> str:
        return repr(self._twin._load)


class Flags:
    """The flags of a controller, by number or by the program's names."""

    __slots__ = ("_twin",)
    __iter__ = None  # or Python would count up from 0

    def __init__(self, twin: "ControllerTwin") -> None:
        self._twin = twin

    def __getitem__(self, key: int | str) -> bool:
        number, twin = self._twin._key("flag", key), self._twin
        with twin._simulation.present() as now:
            return bool(twin._device.flag_at(now, number))

    def __setitem__(self, key: int | str, on: bool) -> None:
        number, twin = self._twin._key("flag", key), self._twin
        value = _checked_switch(f"flag {key}", on)
        twin._simulation.act(twin._index, lambda now: twin._device.set_flag(now, number, value))

    @property
    def on(self) -> list[int]:
        """The numbers of all flags that are on, ascending."""
        with self._twin._simulation.present() as now:
            return [number for number in range(256) if self._twin._device.flag_at(now, number)]

    def __repr__(self) -> str:
        return f"<Flags on: {', '.join(map(str, self.on)) or 'none'}>"


class Variables:
    """The variables of a controller, by address or by the program's names."""

    __slots__ = ("_twin",)
    __iter__ = None  # or Python would count up from 0

    def __init__(self, twin: "ControllerTwin") -> None:
        self._twin = twin

    def __getitem__(self, key: int | str) -> int:
        address, twin = self._twin._key("variable", key), self._twin
        with twin._simulation.present() as now:
            return int(twin._device.variable_at(now, address))

    def __setitem__(self, key: int | str, value: int) -> None:
        address, twin = self._twin._key("variable", key), self._twin
        if isinstance(value, bool) or not isinstance(value, int):
            raise UsageError(f"variable {key} = {value!r} is no whole number")
        twin._simulation.act(
            twin._index, lambda now: twin._device.set_variable(now, address, value)
        )


class Twin:
    """One device, of any kind; its line or bus makes it."""

    _kind = "device"
    """What messages call it."""

    def __init__(self, simulation: Present, index: int, name: str, model: str, device: Any) -> None:
        self._simulation = simulation
        self._index = index
        self._device = device
        self._is_powered = True
        self.name = name
        self.model = model

    def __repr__(self) -> str:
        return f"<Twin {self.name}: {self.state}>"

    if not TYPE_CHECKING:  # or else no misspelt name would be found by a type checker

        def __getattr__(self, name: str) -> Any:
            if name.startswith("_"):
                raise AttributeError(name)
            raise _NoSuchAttributeError(self._no_such(name))

        def __setattr__(self, name: str, value: Any) -> None:
            if not (name.startswith("_") or hasattr(type(self), name) or name in _PLAIN):
                raise UsageError(self._no_such(name))
            object.__setattr__(self, name, value)

    def _no_such(self, name: str) -> str:
        known = [each for each in dir(self) if not each.startswith("_")]
        remedy = nearest(name, known)
        for other in Twin.__subclasses__():
            if hasattr(other, name):
                remedy = f"that is for a {other._kind}; known: {', '.join(known)}"
        return f"{self.name} is a {self._kind} and has no {name}: {remedy}"

    # -- what can be read ---------------------------------------------------------------------

    @property
    def address(self) -> int:
        """The address it answers at now, which a command may have changed."""
        return int(self.describe()["address"])

    @property
    def state(self) -> str:
        """What it is doing now, such as ``at rest, powered``."""
        return str(self.describe()["state_text"])

    @property
    def cells(self) -> dict[str, int]:
        """The nonvolatile cells by name, as they are now."""
        with self._simulation.present() as now:
            return dict(self._device.cells(now))

    def describe(self) -> dict[str, Any]:
        """Everything worth showing of it, by name, as it is now."""
        with self._simulation.present() as now:
            return dict(self._device.describe(now))

    # -- power --------------------------------------------------------------------------------

    @property
    def is_powered(self) -> bool:
        """Whether the supply is applied."""
        return self._is_powered

    def power_off(self) -> None:
        """Cut the supply; nothing happens if it is off."""
        with self._simulation.present():
            if self._is_powered:
                self._is_powered = False
                self._simulation.set_power(self._index, on=False)

    def power_on(self) -> None:
        """Apply the supply; nothing happens if it is on."""
        with self._simulation.present():
            if not self._is_powered:
                self._is_powered = True
                self._simulation.set_power(self._index, on=True)

    def power_cycle(self, off_s: float = 0.0) -> None:
        """Cut the supply for ``off_s`` seconds of the twin's time, then apply it.

        Returns when it is applied; the device then still needs the time it takes to start.
        """
        seconds = _checked_number("off_s", off_s, 0.0, 1e6, "s")
        self.power_off()
        self._simulation.advance(round(seconds * NS_PER_S))
        self.power_on()


class MotionTwin(Twin):
    """A device that turns a shaft: its pins, supply, load and position."""

    _kind = "motion device"

    def __init__(self, simulation: Present, index: int, name: str, model: str, device: Any) -> None:
        super().__init__(simulation, index, name, model, device)
        self._load = Load()
        self._inputs = Inputs(self)
        self._load_handle = LoadHandle(self)

    @property
    def position(self) -> int:
        """Where the axis is now, in increments."""
        with self._simulation.present() as now:
            return int(self._device.position_at(now))

    @property
    def is_moving(self) -> bool:
        """Whether the axis moves now."""
        with self._simulation.present() as now:
            return bool(self._device.is_moving(now))

    # -- pins, supply, load -------------------------------------------------------------------

    @property
    def inputs(self) -> Inputs:
        """The input pins: ``twin.inputs.reference = True``."""
        return self._inputs

    @property
    def supply_volts(self) -> float:
        """Voltage of the supply, 0..1000 V.  Raises UsageError when set out of range."""
        return float(self.describe()["supply_millivolts"] / 1000)

    @supply_volts.setter
    def supply_volts(self, volts: float) -> None:
        value = _checked_number("supply_volts", volts, 0.0, SUPPLY_MAX_VOLTS, "V")
        self._simulation.act(
            self._index, lambda now: self._device.set_supply(now, round(value * 1000))
        )

    @property
    def temperature_celsius(self) -> float:
        """Temperature of the electronics, °C.  Raises UsageError when set out of range."""
        return float(self.describe()["temperature_millidegrees"] / 1000)

    @temperature_celsius.setter
    def temperature_celsius(self, celsius: float) -> None:
        low, high = TEMPERATURE_MIN_CELSIUS, TEMPERATURE_MAX_CELSIUS
        value = _checked_number("temperature_celsius", celsius, low, high, "°C")
        self._simulation.act(
            self._index, lambda now: self._device.set_temperature(now, round(value * 1000))
        )

    @property
    def load(self) -> LoadHandle:
        """What is coupled to the shaft: set as a whole, ``Load(...)``, or value by value."""
        return self._load_handle

    @load.setter
    def load(self, load: Load) -> None:
        if not isinstance(load, Load):
            raise UsageError(f"load {load!r} is not allowed; set a Load of axistwin.motion.plant")
        with self._simulation.present():
            self._simulation.act(self._index, lambda now: self._device.set_load(now, load))
            self._load = load

    def push(self, increments: int) -> None:
        """Turn the shaft by hand, by signed ``increments``."""
        if isinstance(increments, bool) or not isinstance(increments, int):
            raise UsageError(f"push {increments!r} is no number of increments; give a whole number")
        self._simulation.act(self._index, lambda now: self._device.push(now, increments))

    def set_fault(self, name: str, present: bool = True) -> None:
        """Let a fault be there or gone that no measure shows.  Raises UsageError with the names."""
        self._simulation.act(self._index, lambda now: self._device.set_fault(now, name, present))

    def _set_input(self, name: str, active: bool) -> None:
        self._simulation.act(self._index, lambda now: self._device.set_input(now, name, active))


class ControllerTwin(Twin):
    """A controller in which a user's program runs: its flags, variables, status and program."""

    _kind = "controller"

    def __init__(self, simulation: Present, index: int, name: str, model: str, device: Any) -> None:
        super().__init__(simulation, index, name, model, device)
        self._flags = Flags(self)
        self._variables = Variables(self)

    # -- flags, variables, status ---------------------------------------------------------------

    @property
    def flags(self) -> Flags:
        """Every flag, of any kind, also those that the host cannot set: ``twin.flags[3] = True``.

        By number, or by the name that the program gives it: ``twin.flags["start"]``.
        """
        return self._flags

    @property
    def variables(self) -> Variables:
        """Every variable: ``twin.variables[2008]``, or by the program's name for it."""
        return self._variables

    @property
    def status(self) -> int:
        """The status word, as RQSTAT gives it; looking at it changes nothing."""
        with self._simulation.present() as now:
            return int(self._device.status_at(now))

    def set_status(self, bit: int, on: bool) -> None:
        """Let the condition that ``bit``, 0..15, tells be there or gone.  Raises UsageError."""
        value = _checked_switch(f"status bit {bit}", on)
        self._simulation.act(self._index, lambda now: self._device.set_status(now, bit, value))

    @property
    def battery(self) -> str:
        """The battery of the memory: ``good``, ``low`` or ``flat``.

        When it is flat, what is stored is lost at the next power-up.  Raises UsageError when set
        to anything else.
        """
        return str(self.describe()["battery"])

    @battery.setter
    def battery(self, level: str) -> None:
        self._simulation.act(self._index, lambda now: self._device.set_battery(now, level))

    # -- program ------------------------------------------------------------------------------

    @property
    def program(self) -> "Macroprogram | None":
        """The program's object as it runs, or ran last; None before the first start."""
        self.describe()  # brings it to the present
        found: Macroprogram | None = self._device.program
        return found

    @property
    def program_error(self) -> str | None:
        """Where and why the program ended with a script error, if it did."""
        found: str | None = self.describe()["program_error"]
        return found

    def load_program(self, program: "ProgramSource") -> None:
        """Put a program in, in place of the one that is there; ``start_program`` starts it.

        program: a class derived from ``axistwin.macroprogram.Macroprogram``, ``FILE.py``,
        ``FILE.py:CLASS``, or the name of one that comes with axistwin.  Raises UsageError.
        """
        from axistwin.programs import find_program

        found = find_program(program)
        self._simulation.act(self._index, lambda now: self._device.load_program(now, found))

    def start_program(self) -> None:
        """Start the program from its beginning.  Raises UsageError if there is none."""
        self._simulation.act(self._index, self._device.start_program)

    def stop_program(self) -> None:
        """Stop the program; flags, outputs and data stay as they are."""
        self._simulation.act(self._index, self._device.stop_program)

    def clear_program(self) -> None:
        """Reset the system and clear the program, with the data (status bit 3)."""
        self._simulation.act(self._index, self._device.clear_program)

    def _key(self, kind: str, key: int | str) -> int:
        """The number of a flag, or address of a variable, that ``key`` means."""
        if isinstance(key, bool) or not isinstance(key, int | str):
            raise UsageError(f"{kind} {key!r} is no number; give a number, or a name")
        if isinstance(key, int):
            return key
        names: Mapping[str, int] = self.describe()["program_names"]
        if not names:
            raise UsageError(f"{kind} {key!r}: {self.name} has no program with names; load one")
        return names[_checked_name(kind, key, names)]


if TYPE_CHECKING:

    class AnyTwin(MotionTwin, ControllerTwin):
        """A twin as a type checker sees it that cannot know the kind: with what any kind has."""

else:
    AnyTwin = Twin


def _names_of(load: Load) -> tuple[str, ...]:
    return tuple(each.name for each in fields(load))


def _checked_switch(name: str, on: object) -> bool:
    if on not in (False, True):
        raise UsageError(f"{name}: {on!r} is not allowed; set True or False")
    return bool(on)


def _checked_name(kind: str, name: str, known: "Mapping[str, object] | tuple[str, ...]") -> str:
    if name not in known:
        raise UsageError(f"unknown {kind} {name!r}: {nearest(name, known)}")
    return name


def _checked_number(name: str, value: object, low: float, high: float, unit: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UsageError(f"{name} = {value!r} is no number; set {low:g}..{high:g} {unit}")
    if not low <= value <= high:
        raise UsageError(f"{name} = {value!r} is out of range: {low:g}..{high:g} {unit}")
    return float(value)
