"""Frames of a bus with MAC modules in words, for transcripts and captures.

``explain_frame`` reads every direction: requests of a host, replies and messages of a module.  It
never fails: what belongs to none of them is named by its identifier only.
"""

from collections.abc import Callable

from axistwin.devices.mac.axis.acceptance import SERIAL_ONLY
from axistwin.devices.mac.axis.command_words import command_in_words, query_in_words, value_in_words
from axistwin.devices.mac.axis.models import MAC23_CAN
from axistwin.devices.mac.can.device import (
    ACCEPTED,
    BOOT_UP,
    DOWNLOAD,
    EMERGENCY,
    GENERAL_REQUEST,
    INDEX_HIGH,
    LMT_ADDRESS,
    LMT_MODE,
    LMT_REPLY,
    LMT_REQUEST,
    NMT,
    QUERIES,
    REFUSED,
    REPLY,
    REQUEST,
    REQUEST_BYTES,
    SYNC,
    UPLOAD,
    UPLOAD_COUNT,
)
from axistwin.wire.can_frame import CanFrame

EMERGENCY_BYTES = 8
LMT_BYTES_MIN = 2
"""The service and what it is about; what is behind them is ignored (MACC-AMB-08)."""

_UPLOADED = (0x42, 0x43)
_ADDRESS_BITS = 0x7F
_UNASSIGNED = "(unassigned)"


def explain_frame(frame: CanFrame) -> str:
    """What ``frame`` says, in one line; empty if it concerns no module."""
    if frame.is_extended or frame.is_remote:
        return "ignored: " + ("extended" if frame.is_extended else "remote") + " frame"
    if frame.identifier in _COMMON:
        return _COMMON[frame.identifier](frame.data)
    address = frame.identifier & _ADDRESS_BITS
    speak = _OF_MODULES.get(frame.identifier - address)
    return speak(frame.data, address) if speak else ""


def _request(data: bytes, address: int) -> str:
    whom = f"module {address}" if address else "all modules"
    if len(data) != REQUEST_BYTES:
        return f"request of {_size(data)} -> {whom} [{REQUEST_BYTES} are right]"
    command, index = data[0], data[1]
    if command == UPLOAD:
        text = f"{_object(data)} {_uploaded(data)}?"
    elif command == DOWNLOAD:
        known = data[2] == INDEX_HIGH and index not in SERIAL_ONLY
        text = f"{_object(data)} {command_in_words(index, data[4:]) if known else _UNASSIGNED}"
    else:
        text = f"{_object(data)} by command byte {command:02X}h"
    return f"{text} -> {whom}"


def _reply(data: bytes, address: int) -> str:
    who = f"module {address}"
    if len(data) != REQUEST_BYTES:
        return f"reply of {_size(data)} ({who}) [{REQUEST_BYTES} are right]"
    command = data[0]
    if command in _UPLOADED:
        value = value_in_words(QUERIES + data[1], data[4:], MAC23_CAN)
        return f"{_object(data)} {_uploaded(data)} = {value} ({who})"
    verdict = {ACCEPTED: "accepted", REFUSED: "refused"}.get(command, f"reply {command:02X}h")
    code = int.from_bytes(data[4:], "little")
    reason = f", abort code {code:08X}h" if command == REFUSED and code else ""
    return f"{_object(data)} {verdict}{reason} ({who})"


def _size(data: bytes) -> str:
    return "1 byte" if len(data) == 1 else f"{len(data)} bytes"


def _uploaded(data: bytes) -> str:
    """What the upload of an index is about; some queries of the serial face are none here."""
    known = data[2] == INDEX_HIGH and data[1] < UPLOAD_COUNT
    return query_in_words(QUERIES + data[1]) if known else _UNASSIGNED


def _object(data: bytes) -> str:
    sub_index = f" sub-index {data[3]:02X}h" if data[3] else ""
    return f"{data[2]:02X}{data[1]:02X}h{sub_index}"


def _boot_up(data: bytes, address: int) -> str:
    return f"boot-up (module {address})" if address else ""


def _emergency(data: bytes, address: int) -> str:
    code = int.from_bytes(data[:2], "little")
    if not data:
        return f"emergency without data (module {address})"
    if len(data) != EMERGENCY_BYTES:
        return f"emergency of {_size(data)} (module {address}) [{EMERGENCY_BYTES} are right]"
    if not any(data):
        return f"lifebeat, no error (module {address})"
    status = data[3:7].hex(" ").upper()
    return f"emergency {code:04X}h, status {status} (module {address})"


def _sync(data: bytes) -> str:
    return "SYNC: synchronise -> all modules"


def _nmt(data: bytes) -> str:
    return "network management (modules ignore it unless nmt_supported)"


def _lmt(data: bytes) -> str:
    if data[:2] == bytes((LMT_MODE, 1)):
        return "address procedure: begin"
    if data[:2] == bytes((LMT_MODE, 0)):
        return "address procedure: take over"
    if len(data) > 1 and data[0] == LMT_ADDRESS:
        return f"address procedure: address {data[1]}"
    if len(data) < LMT_BYTES_MIN and data[:1] in (b"", bytes((LMT_MODE,)), bytes((LMT_ADDRESS,))):
        return f"address procedure: request of {_size(data)} [{LMT_BYTES_MIN} at least are right]"
    return "address procedure: unknown service"


def _lmt_reply(data: bytes) -> str:
    if data[:2] == bytes((LMT_ADDRESS, 0)):
        return "address procedure: address taken"
    if len(data) < LMT_BYTES_MIN:
        return f"address procedure: reply of {_size(data)} [{LMT_BYTES_MIN} at least are right]"
    return "address procedure: refused"


_COMMON: dict[int, Callable[[bytes], str]] = {
    NMT: _nmt,
    SYNC: _sync,
    LMT_REQUEST: _lmt,
    LMT_REPLY: _lmt_reply,
}

_OF_MODULES: dict[int, Callable[[bytes, int], str]] = {
    REQUEST: _request,
    REPLY: _reply,
    BOOT_UP: _boot_up,
    EMERGENCY: _emergency,
}
assert GENERAL_REQUEST == REQUEST, "the general request is that to address 0"
