"""Bytes of a MAC serial line in words, for transcripts and traces.

``explain`` reads either direction: requests of a host, replies of a module.  It judges what it sees
(a wrong sum, a frame that breaks off) and never fails: what is no frame is shown as hex.
"""

import re
from collections.abc import Callable

from axistwin.devices.mac.serial.framing import (
    ANY_CASE,
    GENERAL_ADDRESS,
    REQUEST_BYTES,
    STX,
    checksum,
)
from axistwin.devices.words import in_words, incomplete, missing, spaced

_ANSWER_BYTES = 21

_SHORT_REPLIES: dict[bytes, str] = {
    b"\x06\x13\x1a": "accepted",
    b"\x06\x13\x11": "accepted (Xon 11h)",
    b"\x06\x13\x17": "refused",
    b"\x06\x13\x18": "refused (Xonerror 18h)",
}

_BROKEN_REPLIES: dict[bytes, str] = {
    b"\x06": "Xoff is missing, and what follows it",
    b"\x06\x13": "Xon, Xonerror or an answer is missing",
}

_REQUEST_HEAD = b"\x02014"
_ANSWER_HEADS = (b"\x06\x13\x02011", b"\x06\x13\x02014")
_CUT = re.compile(rb"(?:\x06\x13\x0201[14][0-9A-Fa-f]*\x03?\x1a?|\x02014[0-9A-Fa-f]*\x03?)")
assert _ANSWER_BYTES == REQUEST_BYTES, "one length for both that break off"


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

_QUERIES = {
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


def _measures(data: bytes) -> str:
    names = (
        ("not busy" if data[2] & 0x08 else "busy"),
        ("positive stop" if data[2] & 0x20 else ""),
        ("negative stop" if data[3] & 0x40 else ""),
        ("reference" if data[3] & 0x20 else ""),
    )
    raw = f"temperature {data[0]:02X}h, supply {data[1]:02X}h"
    return ", ".join((raw, *(name for name in names if name)))


_ANSWERS: dict[str, tuple[str, Callable[[bytes], str]]] = {
    "0": ("20h position", lambda d: str(_signed(d))),
    "1": ("21h status", spaced),
    "2": ("22h superior stop", lambda d: str(_signed(d))),
    "3": ("23h inferior stop", lambda d: str(_signed(d))),
    "4": ("24h release", lambda d: d.hex().upper()),
    "5": ("25h speeds", _speeds),
    "6": ("26h modes", _modes),
    "7": ("27h measures", _measures),
    "8": ("28h RAM", spaced),
    "9": ("29h EEPROM", spaced),
}


def explain(data: bytes) -> str:
    """What ``data`` (one or more frames, either direction) says, in one line."""
    return "; ".join(in_words(bytes(data), _frame_at))


def _frame_at(data: bytes, at: int, follows: bool) -> tuple[str, int]:
    """The text and length of the frame that begins at ``at``; length 0 if none does."""
    first = data[at]
    if first == 0x15:
        return "Nack", 1
    if first == STX[0] and (text := _request(data[at : at + REQUEST_BYTES])):
        return text, REQUEST_BYTES
    if first == 0x06:
        if short := _SHORT_REPLIES.get(data[at : at + 3]):
            return short, 3
        if text := _answer(data[at : at + _ANSWER_BYTES]):
            return text, _ANSWER_BYTES
    return _broken_at(data, at, follows) if first in (STX[0], 0x06) else ("", 0)


def _broken_at(data: bytes, at: int, follows: bool) -> tuple[str, int]:
    """The text and length of a frame that breaks off or has lost bytes; length 0 if none is there.

    Amid bytes that are no frame a beginning is taken for one's only with its length field.
    """
    found = _CUT.match(data, at)
    rest = data[at : at + REQUEST_BYTES]
    if found is None and follows:
        if rest in _BROKEN_REPLIES:
            return incomplete(rest, _BROKEN_REPLIES[rest]), len(rest)
        if any(head.startswith(rest) for head in (_REQUEST_HEAD, *_ANSWER_HEADS)):
            return incomplete(rest, missing(REQUEST_BYTES - len(rest), REQUEST_BYTES)), len(rest)
    if found is None or len(found[0]) >= REQUEST_BYTES:
        return "", 0
    count = len(found[0])
    return incomplete(found[0], missing(REQUEST_BYTES - count, REQUEST_BYTES)), count


def _request(frame: bytes) -> str:
    """A host's frame in words; empty if it has not the form of one."""
    if len(frame) != REQUEST_BYTES or frame[1:4] != b"014" or frame[20] != 0x03:
        return ""
    values = [ANY_CASE.get(frame[at : at + 2]) for at in range(4, 18, 2)]
    fields = [value for value in values if value is not None]
    if len(fields) != len(values):
        return ""
    address, index, sub_index, parameters = fields[0], fields[1], fields[2], bytes(fields[3:])
    whom = "all modules" if address == GENERAL_ADDRESS else f"module {address}"
    right = checksum(frame[4:18])
    doubt = "" if frame[18:20].upper() == right else f" [checksum wrong, {right.decode()} is right]"
    where = f" at {sub_index:02X}h" if sub_index or index in (0x28, 0x29) else ""
    named = (
        f"{query_in_words(index)}?" if index in _QUERIES else command_in_words(index, parameters)
    )
    return f"{index:02X}h {named}{where} -> {whom}{doubt}"


def command_in_words(index: int, parameters: bytes) -> str:
    """What command ``index`` with its four bytes of parameters asks for, on any interface."""
    return _COMMANDS[index](parameters) if index in _COMMANDS else "(unassigned)"


def query_in_words(index: int) -> str:
    """What query ``index`` (20h and up) is about."""
    return _QUERIES.get(index, "(unassigned)")


def value_in_words(index: int, data: bytes) -> str:
    """The four bytes that query ``index`` was answered with."""
    _, say = _ANSWERS.get(f"{index - 0x20:X}", ("", spaced))
    return say(data)


def _answer(frame: bytes) -> str:
    """A module's answer in words; empty if it has not the form of one."""
    if len(frame) != _ANSWER_BYTES or frame[1:3] != b"\x13\x02" or frame[19] != 0x03:
        return ""
    if frame[3:6] not in (b"011", b"014") or frame[6:8] not in ANY_CASE:
        return ""
    values = [ANY_CASE.get(frame[at : at + 2]) for at in range(9, 17, 2)]
    fields = bytes(value for value in values if value is not None)
    digit = chr(frame[8])
    if len(fields) != 4 or digit not in "0123456789ABCDEF":
        return ""
    name, say = _ANSWERS.get(digit, (f"2{digit}h", spaced))
    right = checksum(frame[6:17])
    doubt = "" if frame[17:19] == right else f" [checksum wrong, {right.decode()} is right]"
    address = ANY_CASE[frame[6:8]]
    whom = "general" if address == GENERAL_ADDRESS else f"module {address}"
    return f"{name} = {say(fields)} ({whom}){doubt}"
