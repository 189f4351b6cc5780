"""Commands and queries of a MAC module in words, on any interface."""

from collections.abc import Callable

from axistwin.devices.mac.axis.models import MacModel
from axistwin.devices.words import spaced

MEASURES = 0x27


def _signed(data: bytes) -> int:
    return int.from_bytes(data, "big", signed=True)


def _word(data: bytes) -> int:
    return int.from_bytes(data[-2:], "big")


def _velocity(data: bytes) -> str:
    sign = "-" if data[1] == 0xF6 else "+"
    return f"velocity {sign}, period {_word(data)}" if _word(data) else "velocity 0: stop"


def _segment(data: bytes) -> str:
    return f"{_signed(data[:2])} steps at period {_word(data)}"


_TORQUE_AT_REST = {0: "nominal torque at rest", 1: "standby at rest"}
_STOPS = {0: "stops off", 1: "hardware stops", 8: "software stops", 9: "hardware, software stops"}
_BAUD = {1: "9600 baud", 2: "19200 baud", 3: "38400 baud"}

_COMMANDS: dict[int, Callable[[bytes], str]] = {
    0x00: lambda d: "initialise module",
    0x01: lambda d: "factory values",
    0x02: lambda d: _TORQUE_AT_REST.get(d[3], f"torque at rest {d[3]:02X}h"),
    0x03: lambda d: _STOPS.get(d[3], f"stops mode {d[3]:02X}h"),
    0x07: lambda d: {0: "reference off", 1: "reference on"}.get(d[3], f"reference {d[3]:02X}h"),
    0x08: lambda d: f"new address {d[3]:02X}h",
    0x09: lambda d: f"superior stop {_signed(d)}",
    0x0A: lambda d: f"inferior stop {_signed(d)}",
    0x0B: lambda d: "position := 0",
    0x0C: lambda d: f"torque {d[3]:02X}h",
    0x0D: lambda d: f"maximum speed, period {_word(d)}",
    0x0E: lambda d: f"catch-up {d[2]} x 200 us",
    0x0F: lambda d: f"ramp {d[3]} ({120 * d[3]} increments)",
    0x10: lambda d: "wait for synchronisation",
    0x11: lambda d: "synchronise",
    0x13: lambda d: f"go to position {_signed(d)}",
    0x14: lambda d: "go to position 0",
    0x15: _velocity,
    0x16: lambda d: f"segment {_segment(d)}",
    0x17: lambda d: "stop with ramp",
    0x18: lambda d: "stop without ramp",
    0x19: lambda d: "motor on",
    0x1A: lambda d: "motor off",
    0x1B: lambda d: _BAUD.get(d[3], f"baud rate {d[3]:02X}h"),
    0x1C: lambda d: f"tolerance {d[3]}",
    0x1E: lambda d: f"virtual segment {_segment(d)}",
}

QUERIES = {
    0x20: "position",
    0x21: "status",
    0x22: "superior stop",
    0x23: "inferior stop",
    0x24: "release",
    0x25: "speeds",
    0x26: "ramp, torque, modes",
    0x27: "measures",
    0x28: "RAM",
    0x29: "EEPROM",
}


def _speeds(data: bytes) -> str:
    return f"catch-up {data[0]}, period {_word(data)}"


def _modes(data: bytes) -> str:
    return f"ramp {data[0]}, torque {data[1]:02X}h, mode {data[2]:02X}h, tolerance {data[3]}"


def _measures(data: bytes, model: MacModel | None) -> str:
    names = (
        ("not busy" if data[2] & 0x08 else "busy"),
        ("positive stop" if data[2] & 0x20 else ""),
        ("negative stop" if data[3] & 0x40 else ""),
        ("reference" if data[3] & 0x20 else ""),
    )
    temperature, supply = f"{data[0]:02X}h", f"{data[1]:02X}h"
    if model is not None:  # each model has scales of its own
        temperature = f"{model.celsius(data[0]):.1f} °C ({temperature})"
        supply = f"{model.volts(data[1]):.1f} V ({supply})"
    measured = f"temperature {temperature}, supply {supply}"
    return ", ".join((measured, *(name for name in names if name)))


_ANSWERS: dict[int, tuple[str, Callable[[bytes], str]]] = {
    0x20: ("position", lambda d: str(_signed(d))),
    0x21: ("status", spaced),
    0x22: ("superior stop", lambda d: str(_signed(d))),
    0x23: ("inferior stop", lambda d: str(_signed(d))),
    0x24: ("release", lambda d: d.hex().upper()),
    0x25: ("speeds", _speeds),
    0x26: ("modes", _modes),
    MEASURES: ("measures", spaced),
    0x28: ("RAM", spaced),
    0x29: ("EEPROM", spaced),
}


def command_in_words(index: int, parameters: bytes) -> str:
    """What command ``index`` with its four bytes of parameters asks for, on any interface."""
    return _COMMANDS[index](parameters) if index in _COMMANDS else "(unassigned)"


def query_in_words(index: int) -> str:
    """What query ``index`` (20h and up) is about."""
    return QUERIES.get(index, "(unassigned)")


def value_in_words(index: int, data: bytes, model: MacModel | None) -> str:
    """The four bytes that query ``index`` was answered with, in the units of a model if known."""
    if index == MEASURES:
        return _measures(data, model)
    return _ANSWERS.get(index, ("", spaced))[1](data)


def answer_in_words(digit: int, data: bytes, model: MacModel | None) -> str:
    """Query and value of an answer whose index ends in ``digit``."""
    index = 0x20 + digit
    name = _ANSWERS.get(index, ("", spaced))[0]
    return f"{f'{index:02X}h {name}'.rstrip()} = {value_in_words(index, data, model)}"
