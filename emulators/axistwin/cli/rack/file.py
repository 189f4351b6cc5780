"""The rack file: lines and buses in TOML.  Every mistake in it is told with its line.

Needs pydantic, of the extra ``control``.
"""

import os
import re
import stat
import tomllib
from collections.abc import Iterator, Mapping
from reprlib import repr as shown
from typing import Annotated, Any, Final, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)

from axistwin import catalog
from axistwin.catalog import DeviceSpec
from axistwin.cli.rack.positions import KeyPath, Positions
from axistwin.devices.family import Carrier
from axistwin.errors import UsageError, nearest
from axistwin.wire.wire_fault import make_fault

FILE_BYTES_MAX: Final = 200_000
"""Several times what some hundred lines take."""

Problems: TypeAlias = Iterator[tuple[KeyPath, str]]
"""What is wrong, and where."""


class RackFileError(UsageError):
    """A rack file has mistakes: ``problems`` has a line for each, with the file and its line."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


def _scalar(value: Any) -> Any:
    if not isinstance(value, str | int | float):
        raise ValueError("write a text, a number, true or false")
    return value


def _several(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


Text = Annotated[str, Field(min_length=1)]
Texts = Annotated[list[Text], BeforeValidator(_several)]
"""One text, or an array of them."""

Scalar = Annotated[Any, AfterValidator(_scalar)]


class _Table(BaseModel):
    """A table of the file: no other keys, and no conversions; underscores are written as ``-``."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        frozen=True,
        alias_generator=lambda name: name.replace("_", "-"),
    )


class FaultSection(_Table):
    """A fault of the wire; ``wire.wire_fault`` says what may be in it."""

    kind: Text
    direction: Text | None = None
    message: str = ""
    hex: str = ""
    count: int | None = None
    chance: float | None = None
    per_s: float | None = None
    duration_ms: float | None = None


class Section(_Table):
    """What lines and buses have in common; all but the name is as in ``axistwin run --help``."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    devices: Annotated[Texts, Field(min_length=1)]
    profile: Text | None = None
    quirks: dict[str, Scalar] = {}
    speed: float = 1.0
    pacing: bool = True
    cold: bool = False
    seed: Annotated[int, Field(ge=0)] = 0
    capture: Text | None = None
    initial: dict[str, dict[str, Scalar]] = {}
    """Controls by device, such as ``inputs.reference``, and how they are at the start."""
    faults: list[FaultSection] = []

    @property
    def specs(self) -> list[DeviceSpec]:
        """Its devices.  Raises UsageError."""
        return [catalog.parse_device(text) for text in self.devices]


class LineSection(Section):
    """A serial line."""

    pty: Texts = []
    tcp: Texts = []
    rfc2217: Texts = []
    hid: bool = False
    baud: int | None = None
    program: Texts = []


class BusSection(Section):
    """A CAN bus."""

    can: Texts = []
    slcan: Texts = []
    slcan_tcp: Texts = []
    socketcand: Texts = []
    bitrate: int | None = None


class ControlSection(_Table):
    """Where the control API is."""

    address: Text
    token_file: Text | None = None
    certificate: Text | None = None
    key: Text | None = None


class RackFile(_Table):
    """The whole file."""

    state: Text | None = None
    control: ControlSection | None = None
    line: list[LineSection] = []
    bus: list[BusSection] = []

    @property
    def sections(self) -> dict[str, Section]:
        """Lines and buses by name."""
        return {section.name: section for _, section in self.placed()}

    def placed(self) -> Iterator[tuple[KeyPath, Section]]:
        """Lines and buses, each with where it stands."""
        for number, line in enumerate(self.line):
            yield ("line", number), line
        for number, bus in enumerate(self.bus):
            yield ("bus", number), bus


_ENDPOINTS: Final[Mapping[type[Section], tuple[str, ...]]] = {
    LineSection: ("pty", "tcp", "rfc2217", "hid"),
    BusSection: ("can", "slcan", "slcan_tcp", "socketcand"),
}
_CARRIERS: Final[Mapping[type[Section], Carrier]] = {LineSection: "serial", BusSection: "can"}
_REPEATED: Final = ("line", "bus", "faults")  # sections of which there may be several
_WRITTEN: Final[Mapping[Carrier, str]] = {"serial": "[[line]]", "can": "[[bus]]"}


class RackText:
    """The file at ``path`` as it is now: ``content``, and where everything in it stands.

    Raises RackFileError for what is wrong in it, as far as no device need be built to see it.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        text = _read(path)
        try:
            data = tomllib.loads(text)
        except RecursionError:
            raise RackFileError([f"{path}:1: this is no rack file (nested too deep)"]) from None
        except ValueError as error:
            reason = str(error)
            found = re.search(r" \(at line (\d+), column \d+\)", reason)
            number = int(found[1]) if found else text.count("\n") + 1
            reason = reason.partition(" (at ")[0].partition(";")[0]
            raise RackFileError([f"{path}:{number}: this is no TOML ({reason})"]) from None
        self._positions = Positions(text)
        try:
            self.content = RackFile.model_validate(data)
        except ValidationError as error:
            self.refuse(_problems_of_keys(error))
            raise AssertionError("there are problems") from None
        self.refuse(_problems_of_content(self.content))

    def refuse(self, problems: Problems) -> None:
        """Raise RackFileError if there are any."""
        found = {(self._positions.line_of(place), message): None for place, message in problems}
        if found:
            raise RackFileError([f"{self.path}:{line}: {text}" for line, text in sorted(found)])


def _read(path: str) -> str:
    try:
        with open(path, "rb", opener=_open_at_once) as file:
            data = file.read(FILE_BYTES_MAX + 1)
            is_pipe = stat.S_ISFIFO(os.fstat(file.fileno()).st_mode)
        if is_pipe and not data:
            raise UsageError(f"rack {path}: this is a pipe from which nothing comes; give a file")
        if len(data) > FILE_BYTES_MAX:
            raise RackFileError([f"{path}:1: it has more than {FILE_BYTES_MAX} bytes; split it"])
        return data.decode().replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise RackFileError([f"{path}:1: this is no text in UTF-8"]) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(
            f"rack {path}: cannot be read ({reason}); "
            f"'axistwin rack --init {path}' writes an example"
        ) from None


def _open_at_once(path: str, flags: int) -> int:
    """A pipe without a writer is not waited for: at SIGHUP the lines would wait, too."""
    descriptor = os.open(path, flags | os.O_NONBLOCK)
    os.set_blocking(descriptor, True)
    return descriptor


# -- what is wrong -----------------------------------------------------------------------------


def _problems_of_keys(error: ValidationError) -> Problems:
    """What pydantic has found, with the nearest name for an unknown key."""
    for each in error.errors(include_url=False):
        place = each["loc"]
        key = next((str(part) for part in reversed(place) if isinstance(part, str)), "")
        if each["type"] == "extra_forbidden":
            known = _keys_around(place)
            yield place, f"unknown key {key!r}: {nearest(key, known)}"
        elif each["type"] == "missing":
            yield place, f"key {key!r} is missing"
        elif key == "name" and each["type"] == "string_pattern_mismatch":
            name = each["input"]
            yield place, f"name {name!r}: 1 to 64 letters, digits, '-', '_' and '.'"
        else:
            told = each["msg"].removeprefix("Value error, ")
            told = _form_of(place, each["type"]) or told[0].lower() + told[1:]
            yield place, f"{key} is {shown(each['input'])}: {told}"


def _form_of(place: KeyPath, kind: str) -> str:
    """How a section is written, where something else stands in its place."""
    path = ".".join(str(part) for part in place if not isinstance(part, int))
    if path.split(".")[-1] in _REPEATED and kind in ("list_type", "dict_type", "model_type"):
        return f"write it as a section, [[{path}]]"
    return f"write it as a section, [{path}]" if kind in ("dict_type", "model_type") else ""


def _keys_around(place: KeyPath) -> list[str]:
    tables: Mapping[str, type[_Table]] = {
        "line": LineSection,
        "bus": BusSection,
        "control": ControlSection,
    }
    table = tables[str(place[0])] if len(place) > 1 else RackFile
    if "faults" in place[2:-1]:
        table = FaultSection
    return [field.alias or name for name, field in table.model_fields.items()]


def _problems_of_content(content: RackFile) -> Problems:
    if not (content.line or content.bus):
        yield (), "there is neither a [[line]] nor a [[bus]]; write one"
    names: set[str] = set()
    taken: dict[str, str] = {}
    for place, section in content.placed():
        if section.name in names:
            yield (*place, "name"), f"name {section.name!r} is taken; choose another"
        names.add(section.name)
        yield from _problems_of_endpoints(place, section, taken)
        yield from _problems_of_devices(place, section)
        yield from _problems_of_faults(place, section)


def _problems_of_endpoints(place: KeyPath, section: Section, taken: dict[str, str]) -> Problems:
    """Whether it has some that no other one has; ``taken``: whose each is."""
    keys = _ENDPOINTS[type(section)]
    if not any(getattr(section, key) for key in keys):
        written = ", ".join(key.replace("_", "-") for key in keys)
        yield place, f"{section.name} has no endpoint; give one of {written}"
    for key in keys:
        values = getattr(section, key)
        for number, value in enumerate([] if isinstance(values, bool) else values):
            if value.endswith(":0") or key == "can":  # any free one; a bus that may be shared
                continue
            owner = taken.setdefault(value.removeprefix("./"), section.name)
            if owner != section.name:
                written = key.replace("_", "-")
                where = (*place, written, number)
                yield where, f"{written} {value}: {owner} has it already; choose another"


def _problems_of_faults(place: KeyPath, section: Section) -> Problems:
    for number, fault in enumerate(section.faults):
        try:
            make_fault(_CARRIERS[type(section)], **fault.model_dump())
        except UsageError as error:
            told = str(error)
            for name, field in FaultSection.model_fields.items():
                told = re.sub(rf"\b{name}\b", field.alias or name, told)
            yield (*place, "faults", number, re.split(r"[\s:]", told)[0]), told


def _problems_of_devices(place: KeyPath, section: Section) -> Problems:
    specs = []
    carrier = _CARRIERS[type(section)]
    for number, text in enumerate(section.devices):
        try:
            spec = catalog.parse_device(text)
        except UsageError as error:
            yield (*place, "devices", number), str(error)
            continue
        own = catalog.find_model(spec.model).carrier
        if own == carrier:
            specs.append(spec)
        else:
            told = f"{spec} does not live on a {_WRITTEN[carrier]}; write it under {_WRITTEN[own]}"
            yield (*place, "devices", number), told
    if not specs:
        return
    for name, value in section.quirks.items():
        try:
            catalog.check_quirk(specs, name, value)
        except UsageError as error:
            yield (*place, "quirks", name), str(error)
    try:
        catalog.all_settings(specs, section.profile, {})
    except UsageError as error:
        yield (*place, "profile"), str(error)
    for device in section.initial:
        if device not in section.devices:
            yield (*place, "initial", device), f"{device!r}: {nearest(device, section.devices)}"
