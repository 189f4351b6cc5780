"""What there is to be run: the models, their switches, profiles, and how lines and buses are built.

Each family declares its models in ``devices/<family>/family.py``.  What only some runs need, buses
and programs, is imported by them: a start loads what it runs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from reprlib import repr as shown  # of any depth and length
from typing import TYPE_CHECKING, Any, cast

from axistwin import discovery
from axistwin.devices.base import CanDevice, SerialDevice
from axistwin.devices.family import Carrier, DeviceOptions, Model, Value
from axistwin.errors import StateError, UsageError, nearest, suggestion, with_article
from axistwin.kernel.seed import derive_seed
from axistwin.kernel.time import NS_PER_US, Nanos
from axistwin.runtime.clock import Clock, PacedClock
from axistwin.runtime.line import Line
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.simulation import Station
from axistwin.runtime.storage import MemoryStorage, Stores
from axistwin.wire.faults import WireFaults

if TYPE_CHECKING:
    from axistwin.programs import Program, ProgramSource
    from axistwin.runtime.bus import Bus

DEFAULT_BITRATE = 125_000
"""Of a bus, bits per second."""

BITRATE_MAX = 1_000_000
"""Of a bus, bits per second; the limit of ISO 11898-2."""

_SKEW_MIN_NS, _SKEW_MAX_NS = 30 * NS_PER_US, 200 * NS_PER_US
_PROFILE_KEYS = ("model", "quirks")

_PROFILE_BYTES_MAX = 20_000
"""Several times what all quirks take; tomllib needs minutes for some that are larger."""

_DIGITS_MAX = 1000
"""Of a number that is told to be out of range; Python itself does not read some thousands."""


@dataclass(frozen=True, slots=True)
class DeviceSpec:
    """Which device is wanted: ``mac23:0``."""

    model: str
    address: int

    def __str__(self) -> str:
        return f"{self.model}:{self.address}"


def models() -> dict[str, Model]:
    """All models by name."""
    return dict(discovery.models())


def find_model(name: str) -> Model:
    """The model called ``name``.  Raises UsageError with the nearest name."""
    known = discovery.models()
    if name in known:
        return known[name]
    hint = suggestion(name, known)
    names = f"known: {', '.join(known)}"
    raise UsageError(f"unknown model {name!r}: {f'{hint} ' if hint else ''}{names}")


def parse_device(text: str) -> DeviceSpec:
    """``MODEL`` or ``MODEL:ADDRESS``, the address as 127, 7Fh or 0x7F.  Raises UsageError."""
    name, colon, address = text.partition(":")
    model = find_model(name)
    if not colon:
        return DeviceSpec(name, model.default_address)
    number = _parse_number(address)
    low, high = model.addresses[0], model.addresses[-1]
    limits = f"{low:X}..{high:X}h ({low}..{high})"
    if number is None:
        raise UsageError(
            f"address {address!r} of {name} is no number: {limits},"
            f" such as {name}:5 or {name}:{high:X}h"
        )
    if number not in model.addresses:
        written = address if address.isdigit() else f"{address} ({number})"
        raise UsageError(f"address {written} is out of range for {name}: {limits}")
    return DeviceSpec(name, number)


def parse_settings(texts: Iterable[str]) -> dict[str, str]:
    """``NAME=VALUE`` texts as a mapping; the last of equal names holds.  Raises UsageError."""
    settings = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise UsageError(f"quirk {text!r}: write NAME=VALUE, such as xon_byte=11h")
        settings[name] = value
    return settings


def all_settings(
    specs: Iterable[DeviceSpec], profile: str | Path | None, quirks: Mapping[str, Value]
) -> dict[str, Value]:
    """The quirks of the file ``profile``, if one is given, and ``quirks``, which override those.

    Raises UsageError as ``read_profile``.
    """
    if profile is None:
        return dict(quirks)
    return {**read_profile(profile, {spec.model for spec in specs}), **quirks}


def check_quirk(specs: Iterable[DeviceSpec], name: str, value: Value) -> None:
    """Raise UsageError unless a model of ``specs`` has the quirk ``name`` with this ``value``."""
    _check_quirks([find_model(spec.model) for spec in specs], {name: value})


def parse_programs(texts: Iterable[str]) -> dict[int | None, ProgramSource]:
    """``PROGRAM`` or ``UNIT=PROGRAM`` texts by unit, None for all.  Raises UsageError.

    A unit is written as an address is: 2, 2h or 0x2.
    """
    programs: dict[int | None, ProgramSource] = {}
    for text in texts:
        unit, equals, source = text.partition("=")
        number = _parse_number(unit) if equals else None
        if number is None:
            source = text
        if not source:
            raise UsageError(f"program {text!r}: write FILE.py, FILE.py:CLASS, or UNIT=FILE.py")
        if number in programs:
            whose = "all units" if number is None else f"unit {number}"
            raise UsageError(f"program {text}: {whose} had {programs[number]} already; give one")
        programs[number] = source
    return programs


def read_profile(path: str | Path, known_models: Iterable[str]) -> dict[str, Value]:
    """The quirks in the TOML file at ``path``, meant for one of ``known_models`` (of a line).

    ``path`` may be the name of a profile that comes with a family, such as mn100.
    The file has ``model = "NAME"``, and a table ``[quirks]``.
    Raises UsageError naming the file and the key.
    """
    names = sorted(set(known_models))
    profile = _read_toml(path)
    for key in profile:
        if key not in _PROFILE_KEYS:
            raise UsageError(f"profile {path}: unknown key {key!r}: {nearest(key, _PROFILE_KEYS)}")
    if "model" not in profile:
        lacking = "names no model" if profile else "is empty"
        raise UsageError(
            f"profile {path}: it {lacking}; it begins with the model that it is of,"
            f' such as model = "{names[0]}"'
        )
    model = profile["model"]
    if model not in names:
        raise UsageError(
            f"profile {path}: key 'model' is {shown(model)}, but the line has {', '.join(names)}; "
            "give another profile"
        )
    quirks = profile.get("quirks", {})
    if not isinstance(quirks, dict):
        raise UsageError(f"profile {path}: key 'quirks' is no table; write [quirks]")
    for name, value in quirks.items():
        if not isinstance(value, str | int):
            raise UsageError(
                f"profile {path}: quirk {name} is {shown(value)}; write a text or a number"
            )
        try:
            _check_quirk(find_model(model), name, value)
        except UsageError as error:
            raise UsageError(f"profile {path}: {error}") from None
    return quirks


def profiles_of(model: str) -> dict[str, Path]:
    """The profiles that come with ``model``, by name."""
    found = discovery.profiles().items()
    return {name: path for name, path in found if _read_toml(path).get("model") == model}


def build_line(
    specs: Sequence[DeviceSpec],
    *,
    quirks: Mapping[str, Value] | None = None,
    seed: int = 0,
    clock: Clock | None = None,
    paced: bool = True,
    storage: Stores | None = None,
    baud: int | None = None,
    cold: bool = False,
    programs: Mapping[int | None, ProgramSource] | None = None,
) -> Line:
    """A line with the devices of ``specs``; two may have the same address, and then collide.

    quirks: by name, for every model that knows them.  seed: of everything random.
    clock: real time unless given.  paced: bytes take their time.  storage: none unless given; it
    belongs to the line from now on.  baud: the rate that devices without a stored one have.
    cold: the supply is applied now, else they have started long ago.
    programs: what runs in the controllers, by address, None for all; a cold one starts by itself if
    it does at any other power-up.

    Raises UsageError and StateError; the storage is closed then.
    """
    storage = MemoryStorage() if storage is None else storage
    try:
        used = _checked_models(specs, "serial", quirks or {})
        loads = _programs_of(specs, programs or {})
        clock = PacedClock() if clock is None else clock
        stations = _stations(specs, quirks or {}, seed, storage, baud)
        devices = [cast(SerialDevice, station.device) for station in stations]
        is_alike = len({model.name for model in used}) == 1
        family = used[0].family if is_alike else used[0].family.of_any_model()
        faults = WireFaults("serial", family.explain, seed)
        network = SerialNetwork(devices, start_ns=clock.now_ns(), paced=paced, faults=faults)
        network.host_format = devices[0].line_format
        line = Line(network, clock, storage, stations, explain=family.explain)
        for index, program in loads.items():
            line.twins[index].load_program(program)
            if not cold:
                line.twins[index].start_program()
        if cold:
            for twin in line.twins:
                twin.power_cycle()
    except BaseException:
        storage.close()
        raise
    return line


def build_bus(
    specs: Sequence[DeviceSpec],
    *,
    quirks: Mapping[str, Value] | None = None,
    seed: int = 0,
    clock: Clock | None = None,
    paced: bool = True,
    storage: Stores | None = None,
    bitrate: int = DEFAULT_BITRATE,
    cold: bool = False,
) -> Bus:
    """A CAN bus with the devices of ``specs``; two may have the same address.

    bitrate: of the bus, 1..1000000 bits per second.  All else as for ``build_line``.

    Raises UsageError and StateError; the storage is closed then.
    """
    from axistwin.runtime.bus import Bus
    from axistwin.runtime.can_network import CanNetwork

    storage = MemoryStorage() if storage is None else storage
    try:
        used = _checked_models(specs, "can", quirks or {})
        if not 0 < bitrate <= BITRATE_MAX:
            raise UsageError(f"bitrate {bitrate} is out of range: 1..{BITRATE_MAX} bits per second")
        clock = PacedClock() if clock is None else clock
        stations = _stations(specs, quirks or {}, seed, storage, None)
        devices = [cast(CanDevice, station.device) for station in stations]
        faults = WireFaults("can", used[0].explain, seed)
        start_ns = clock.now_ns()
        network = CanNetwork(
            devices, bitrate=bitrate, start_ns=start_ns, paced=paced, faults=faults
        )
        bus = Bus(network, clock, storage, stations, explain=used[0].explain)
        if cold:
            for twin in bus.twins:
                twin.power_cycle()
    except BaseException:
        storage.close()
        raise
    return bus


def _programs_of(
    specs: Sequence[DeviceSpec], programs: Mapping[int | None, ProgramSource]
) -> dict[int, Program]:
    """The program of each device that gets one, by its place on the line.  Raises UsageError."""
    if not programs:
        return {}
    from axistwin.programs import find_program

    tables = [find_model(spec.model).family.controls() for spec in specs]
    places = [place for place, table in enumerate(tables) if "load_program" in table.attributes()]
    if not places:
        raise UsageError(
            f"{specs[0]} runs no program; leave it out, or name a controller such as msc-250"
        )
    units = [specs[place].address for place in places]
    for unit in programs:
        if unit is not None and unit not in units:
            known = ", ".join(map(str, units))
            raise UsageError(f"program {unit}={programs[unit]}: no unit {unit}; there is {known}")
    found = {unit: find_program(source) for unit, source in programs.items()}
    wanted = {place: found.get(specs[place].address, found.get(None)) for place in places}
    return {place: program for place, program in wanted.items() if program is not None}


_CARRIED: dict[Carrier, tuple[str, str]] = {
    "serial": ("a serial line", "axistwin://{}"),
    "can": ("a CAN bus", 'can.Bus(interface="axistwin", channel="{}")'),
}
"""What each carrier is called, and how a Python program reaches a device on it."""


def _checked_models(
    specs: Sequence[DeviceSpec], carrier: Carrier, quirks: Mapping[str, Value]
) -> list[Model]:
    """The models of ``specs``, all of them for ``carrier`` and with known quirks."""
    if not specs:
        raise UsageError("no device was named; name one, such as mac23 or mac23:5")
    used = [find_model(spec.model) for spec in specs]
    for spec, model in zip(specs, used, strict=True):
        if model.carrier != carrier:
            wanted, use = _CARRIED[model.carrier]
            raise UsageError(
                f"{spec} lives on {wanted}, not on {_CARRIED[carrier][0]}; "
                f"from Python use {use.format(spec)}"
            )
    _check_quirks(used, quirks)
    return used


def _stations(
    specs: Sequence[DeviceSpec],
    quirks: Mapping[str, Value],
    seed: int,
    storage: Stores,
    baud: int | None,
) -> list[Station]:
    """The devices of ``specs``, each with its memory: what is stored, else the factory's values."""
    stations = []
    for index, spec in enumerate(specs):
        model = find_model(spec.model)
        slot = storage.slot(f"{spec.model}-{spec.address}", spec.model)
        cells = dict(slot.cells)
        if not cells and baud is not None:
            if baud not in model.bauds:
                rates = ", ".join(map(str, model.bauds))
                raise UsageError(f"baud {baud} is no rate of {spec.model}: {rates}")
            if len(model.bauds) > 1:  # or else there is nothing to remember
                cells["baud"] = baud
        own = {name: value for name, value in quirks.items() if name in model.quirks}
        options = DeviceOptions(own, cells, _skew_ns(seed, spec, index), alone=len(specs) == 1)
        device = model.make(spec.address, options)
        present = device.cells(0)
        strange = sorted(name for name in slot.cells if present.get(name) != slot.cells[name])
        if strange:
            raise StateError(
                f"state of {spec}: cell {strange[0]} cannot be {slot.cells[strange[0]]}; "
                "restore a good copy, or remove it to start with factory values"
            )
        slot.save(present, durable=True)
        stations.append(Station(str(spec), spec.model, device, slot, model.family.controls()))
    return stations


def _skew_ns(seed: int, spec: DeviceSpec, index: int) -> Nanos:
    """How much later than the first device on the line another one answers.

    No two oscillators agree: without it, two devices that answer at once would send their bits in
    step, and equal answers would not even disturb one another.
    """
    if index == 0:
        return 0
    span = _SKEW_MAX_NS - _SKEW_MIN_NS
    return _SKEW_MIN_NS + derive_seed(seed, f"skew/{index}/{spec}") % span


def _check_quirks(used: Sequence[Model], settings: Mapping[str, Value]) -> None:
    """Every setting is known to a model in use and has a value it allows."""
    for name, value in settings.items():
        knowing = [model for model in used if name in model.quirks]
        for model in knowing or used[:1]:
            _check_quirk(model, name, value)


def _check_quirk(model: Model, name: str, value: Value) -> None:
    known = model.quirks
    if name not in known:
        lister = f"axistwin models {model.name}"
        if other := next((one for one in discovery.models().values() if name in one.quirks), None):
            whose = f"{with_article(other.name)} has it, {with_article(model.name)} does not"
            raise UsageError(f"unknown quirk {name!r}: {whose}; see '{lister}'")
        raise UsageError(f"unknown quirk {name!r}: {nearest(name, known, lister)}")
    known[name].parse(value)


def _read_toml(path: str | Path) -> dict[str, Any]:
    import tomllib

    place = Path(path)
    if not place.is_file():
        place = discovery.profiles().get(str(path), place)
    try:
        with place.open("rb") as file:
            data = file.read(_PROFILE_BYTES_MAX + 1)
        if len(data) > _PROFILE_BYTES_MAX:
            raise UsageError(
                f"profile {path}: it has more than {_PROFILE_BYTES_MAX} bytes; that is no profile"
            )
        return tomllib.loads(data.decode())
    except OSError as error:
        raise UsageError(
            f"profile {path}: cannot be read ({error.strerror}); give an existing file or a "
            f"profile that comes with a model: {', '.join(discovery.profiles())}"
        ) from None
    except RecursionError:
        raise UsageError(f"profile {path}: this is no profile (nested too deep)") from None
    except ValueError as error:  # no UTF-8, no TOML, or a number of thousands of digits
        reason = str(error).partition(";")[0]
        raise UsageError(f"profile {path}: this is no TOML ({reason})") from None


def _parse_number(text: str) -> int | None:
    """``127``, ``7Fh`` or ``0x7F``; None for anything else."""
    body, base = text.lower(), 10
    if body.endswith("h"):
        body, base = body[:-1], 16
    elif body.startswith("0x"):
        body, base = body[2:], 16
    known = set("0123456789abcdef"[:base])
    is_number = 0 < len(body) <= _DIGITS_MAX and set(body) <= known
    return int(body, base) if is_number else None
