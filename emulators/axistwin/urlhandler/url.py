"""What an ``axistwin://`` URL says, as a value.

``axistwin://MODEL[:ADDRESS][,MODEL[:ADDRESS]...][?PARAMETER=VALUE[&PARAMETER=VALUE...]]``

========================= ====================================================================
``address=5``             the address, where it is not written behind the model's name
``time=virtual``          time passes only while the host waits
``time=real``             the default
``time=20``               twenty times as fast as real time
``quirk.NAME=VALUE``      one of the readings that the manual leaves open; any number of them
``profile=FILE``          a file with a set of quirks, or the name of a profile such as mn100
``state=DIR``             keep what a real unit keeps, in this directory
``seed=N``                the seed of everything random
``pacing=no``             bytes take no time on the line
``baud=9600``             the rate that the devices left the factory with
``cold=yes``              switch the devices on now: they start up first
``host_clock=yes``        the program's ``time.sleep`` and clocks move virtual time too
``program=PROGRAM``       what runs in the controllers: a file, ``FILE.py:CLASS``, or a name
``program.UNIT=PROGRAM``  what runs in one of several
``line=NAME``             a line of this name, the same for all who open it
========================= ====================================================================
"""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Final
from urllib.parse import unquote

from axistwin import catalog
from axistwin.errors import UsageError, nearest
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.programs import ProgramSource
from axistwin.runtime.clock import Clock, PacedClock, VirtualClock
from axistwin.runtime.host.patches import HOST, watch
from axistwin.runtime.host.time import HostedClock
from axistwin.runtime.storage import MemoryStorage, Storage

SCHEME = "axistwin://"
QUIRK_PREFIX = "quirk."
PROGRAM_PREFIX = "program."

VIRTUAL = "virtual"
REAL = "real"

_IN_A_TEST = "PYTEST_CURRENT_TEST"
"""What is in the environment while pytest runs a test, which is told then what slept in vain."""

SPEED = "speed"
"""What ``time=20`` is called on the command line, and asked for by mistake elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TwinOptions:
    """The devices on a line or bus and how they live.

    devices: ``MODEL`` or ``MODEL:ADDRESS`` each.  speed: seconds of the devices' time per real
    second, > 0, or None for virtual time.  cold: start the devices up now instead of finding them
    ready.  host_clock: the host's own sleeping and clocks move the virtual time too.
    """

    devices: tuple[str, ...]
    speed: float | None = 1.0
    quirks: Mapping[str, Any] = field(default_factory=dict)
    profile: str | None = None
    state: str | None = None
    seed: int = 0
    pacing: bool = True
    cold: bool = False
    host_clock: bool = False

    def span_ns(self, seconds: float) -> Nanos:
        """``seconds`` of the host's own time in the devices' time."""
        return round(seconds * (self.speed or 1.0) * NS_PER_S)

    def arguments(self) -> dict[str, Any]:
        """For ``build_line`` or ``build_bus`` of the catalog.  Raises UsageError and StateError."""
        specs = [catalog.parse_device(device) for device in self.devices]
        clock: Clock = VirtualClock() if self.speed is None else PacedClock(self.speed)
        if self.speed is None and not self.host_clock and _IN_A_TEST in os.environ:
            watch()
        if self.host_clock:
            if self.speed is not None:
                raise UsageError("host_clock: is for virtual time alone; write time=virtual too")
            clock = HostedClock(HOST)
        return {
            "specs": specs,
            "quirks": catalog.all_settings(specs, self.profile, self.quirks),
            "seed": self.seed,
            "clock": clock,
            "paced": self.pacing,
            "storage": MemoryStorage() if self.state is None else Storage(self.state),
            "cold": self.cold,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class LineOptions(TwinOptions):
    """The devices on a line and how they live.

    baud: the devices' factory rate, None for the model's own.  programs: what runs in the
    controllers, by unit, None for all.
    """

    baud: int | None = None
    programs: Mapping[int | None, ProgramSource] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class TwinUrl:
    """A URL taken apart: the options, which of them it gives, and the line's name or None."""

    url: str
    options: LineOptions
    given: frozenset[str]
    line: str | None

    def disagreement(self, options: LineOptions) -> str | None:
        """The first thing that this URL asks for and that ``options`` have not; None if all agree.

        What the URL leaves out agrees with anything.
        """
        for name in sorted(self.given):
            wanted, found = getattr(self.options, name), getattr(options, name)
            if wanted != found:
                return f"{name} is {_shown(found)}, not {_shown(wanted)}"
        return None


def parse_speed(text: str | float) -> float | None:
    """``virtual`` (None), ``real`` (1.0) or how many times as fast as real time.

    Raises UsageError.
    """
    if text == VIRTUAL:
        return None
    if text == REAL:
        return 1.0
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not 0 < speed < math.inf:
        raise UsageError(f"time={text}: use virtual, real, or a speed above 0 such as 20")
    return speed


def parse_url(url: str) -> TwinUrl:
    """Take ``url`` apart.  Raises UsageError."""
    if url[: len(SCHEME)].lower() != SCHEME:
        raise UsageError(f"{url}: expected {SCHEME}MODEL[:ADDRESS][?PARAMETER=VALUE...]")
    place, _, query = url[len(SCHEME) :].partition("?")
    devices = (
        [unquote(device) for device in place.removesuffix("/").split(",")]
        if place.strip("/")
        else []
    )
    if "" in devices:
        raise UsageError(f"{url}: a device is missing at a comma; remove it, or name one")
    values: dict[str, Any] = {}
    quirks: dict[str, str] = {}
    programs: list[str] = []
    line = None
    for name, value in split_query(query, (*_PARAMETERS, "address", "line", "program")):
        if name.startswith(QUIRK_PREFIX):
            quirks[name.removeprefix(QUIRK_PREFIX)] = value
        elif name == "program":
            programs.append(value)
        elif name.startswith(PROGRAM_PREFIX):
            programs.append(f"{_unit(name)}={value}")
        elif name == "line":
            line = value
        elif name == "address":
            devices = addressed(devices, value)
        else:
            field_name, parse = _PARAMETERS[name]
            values[field_name] = parse(value)
    if quirks:
        values["quirks"] = quirks
    if programs:
        values["programs"] = catalog.parse_programs(programs)
    if devices:
        values["devices"] = tuple(devices)
    elif line is None:
        raise UsageError(f"{url}: names no device; write {SCHEME}mac23, for instance")
    given = frozenset(values)
    values.setdefault("devices", ())
    return TwinUrl(url, LineOptions(**values), given, line)


def split_query(query: str, known: Sequence[str]) -> list[tuple[str, str]]:
    """The parameters with their values, every name a quirk's or ``known``, and given once.

    Raises UsageError.
    """
    prefixes = (QUIRK_PREFIX, PROGRAM_PREFIX) if "program" in known else (QUIRK_PREFIX,)
    found: dict[str, str] = {}
    for part in query.split("&"):
        if not part:
            continue
        name, equals, value = (unquote(piece) for piece in part.partition("="))
        if name not in known and not name.startswith(prefixes):
            remedy = nearest(name, (*known, QUIRK_PREFIX + "NAME"))
            if name == SPEED:
                remedy = f"write time={value or 20}"
            raise UsageError(f"unknown parameter {name}: {remedy}")
        if not equals or not value:
            raise UsageError(f"{name}: no value given; write {name}=VALUE")
        if name in found:
            raise UsageError(f"{name}: given twice ({found[name]} and {value}); give it once")
        found[name] = value
    return list(found.items())


def addressed(devices: list[str], address: str) -> list[str]:
    """The one device of ``devices`` with the address behind its name.  Raises UsageError."""
    if len(devices) != 1 or ":" in devices[0]:
        raise UsageError(
            f"address={address}: is for one device without an address; write MODEL:ADDRESS instead"
        )
    return [f"{devices[0]}:{address}"]


def _unit(name: str) -> str:
    """The unit in ``program.2``.  Raises UsageError."""
    unit = name.removeprefix(PROGRAM_PREFIX)
    if not (unit.isascii() and unit.isdigit()):
        raise UsageError(f"{name}: {unit or 'nothing'} is no unit; write program.2=FILE.py")
    return unit


def whole_number(name: str, minimum: int) -> Callable[[str], int]:
    """A parser for whole numbers from ``minimum`` upward."""

    def parse(text: str) -> int:
        if not (text.isascii() and text.isdigit() and int(text) >= minimum):
            raise UsageError(f"{name}={text}: use a whole number, {minimum} or above")
        return int(text)

    return parse


def yes_or_no(name: str) -> Callable[[str], bool]:
    """A parser for yes and no."""

    def parse(text: str) -> bool:
        if text not in ("yes", "no"):
            raise UsageError(f"{name}={text}: use yes or no")
        return text == "yes"

    return parse


def _shown(value: object) -> str:
    """A value of ``LineOptions`` for a message."""
    if isinstance(value, tuple):
        return ",".join(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{name or 'all'}={setting}" for name, setting in value.items()) or "none"
    return str(value)


COMMON_PARAMETERS: Final[Mapping[str, tuple[str, Callable[[str], Any]]]] = {
    "time": ("speed", parse_speed),
    "profile": ("profile", str),
    "state": ("state", str),
    "seed": ("seed", whole_number("seed", 0)),
    "pacing": ("pacing", yes_or_no("pacing")),
    "cold": ("cold", yes_or_no("cold")),
    "host_clock": ("host_clock", yes_or_no("host_clock")),
}
"""Name of a parameter -> field of ``TwinOptions``, parser."""

_PARAMETERS = {**COMMON_PARAMETERS, "baud": ("baud", whole_number("baud", 1))}
assert {entry for entry, _ in _PARAMETERS.values()} <= {entry.name for entry in fields(LineOptions)}
