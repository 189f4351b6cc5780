"""What the channel and the keyword arguments of ``can.Bus`` say, as a value.

The parameters are told at the head of ``axistwin.canbus``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from axistwin import catalog
from axistwin.errors import UsageError, nearest
from axistwin.urlhandler.url import (
    COMMON_PARAMETERS,
    QUIRK_PREFIX,
    TwinOptions,
    split_query,
    whole_number,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusOptions(TwinOptions):
    """The devices on a bus and how they live; ``bitrate``: bits per second."""

    bitrate: int = catalog.DEFAULT_BITRATE


@dataclass(frozen=True, slots=True)
class ChannelRequest:
    """A channel taken apart: the name its bus is found under, the options, those it gives."""

    name: str
    options: BusOptions
    given: frozenset[str]


_PARAMETERS = {**COMMON_PARAMETERS, "bitrate": ("bitrate", whole_number("bitrate", 1))}
_KNOWN = (*_PARAMETERS, "bus")
_ARGUMENTS = {**{name: name for name in _KNOWN if name != "state"}, "state_dir": "state"}
"""Keyword argument -> parameter; ``can.Bus`` keeps the word ``state`` for itself."""


_FOR_OTHERS = ("single_handle", "data_bitrate")
"""What python-can's own programs tell every interface, and only some understand."""


def parse_channel(channel: str, arguments: Mapping[str, Any]) -> ChannelRequest:
    """What ``channel`` and the keyword ``arguments`` of ``can.Bus`` ask for.  Raises UsageError."""
    place, _, query = channel.partition("?")
    quirks: dict[str, Any] = {}
    texts: dict[str, str] = {}
    for name, value in split_query(query, _KNOWN):
        if name.startswith(QUIRK_PREFIX):
            quirks[name.removeprefix(QUIRK_PREFIX)] = value
        else:
            texts[name] = value
    for name, value in _told_by(arguments, quirks):
        if name in texts:
            raise UsageError(f"{name}: given twice ({texts[name]} and {value}); give it once")
        texts[name] = value
    devices = _devices(place)
    bus_name = texts.pop("bus", None)
    if not devices and bus_name is None:
        raise UsageError(f"channel {channel!r} names no device; write mac23-can:1, for instance")
    values: dict[str, Any] = {}
    for name, text in texts.items():
        field_name, parse = _PARAMETERS[name]
        values[field_name] = parse(text)
    if quirks:
        values["quirks"] = quirks
    if devices:
        values["devices"] = devices
    given = frozenset(values)
    values.setdefault("devices", ())
    return ChannelRequest(bus_name or ",".join(devices), BusOptions(**values), given)


def _told_by(arguments: Mapping[str, Any], quirks: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Keyword arguments as parameters in text; what they say of quirks goes into ``quirks``."""
    for name, value in arguments.items():
        if name in _FOR_OTHERS or value is None:
            continue
        if name == "quirks":
            quirks.update(value)
        elif name.startswith(QUIRK_PREFIX):
            quirks[name.removeprefix(QUIRK_PREFIX)] = value
        elif name in _ARGUMENTS:
            text = ("no", "yes")[value] if isinstance(value, bool) else str(value)
            yield _ARGUMENTS[name], text
        elif name == "state":
            raise UsageError(
                "state: python-can keeps this argument for itself; write state_dir=DIR, "
                "or ?state=DIR in the channel"
            )
        else:
            raise UsageError(f"unknown argument {name}: {nearest(name, (*_ARGUMENTS, 'quirks'))}")


def _devices(place: str) -> tuple[str, ...]:
    """``mac23-can:1,2`` as ``mac23-can:1`` and ``mac23-can:2``."""
    devices: list[str] = []
    for text in place.split(",") if place else ():
        if devices and text[:1].isdigit():
            text = f"{devices[-1].partition(':')[0]}:{text}"
        devices.append(text)
    return tuple(str(catalog.parse_device(device)) for device in devices)
