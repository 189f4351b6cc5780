"""Bytes of a MAC serial line in words, for transcripts and traces.

``explain`` reads either direction: requests of a host, replies of a module.  It judges what it sees
(a wrong sum, a frame that breaks off) and never fails: what is no frame is shown as hex.
"""

import re
from functools import partial

from axistwin.devices.mac.axis.command_words import (
    QUERIES,
    answer_in_words,
    command_in_words,
    query_in_words,
)
from axistwin.devices.mac.axis.models import MacModel
from axistwin.devices.mac.serial.framing import (
    ANY_CASE,
    GENERAL_ADDRESS,
    REQUEST_BYTES,
    STX,
    checksum,
)
from axistwin.devices.words import in_words, incomplete, missing

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


def explain(data: bytes, model: MacModel | None = None) -> str:
    """What ``data`` (one or more frames, either direction) says, in one line.

    model: of the module, for what its bytes mean in °C and volts; None: it is not known.
    """
    return "; ".join(in_words(bytes(data), partial(_frame_at, model)))


def _frame_at(model: MacModel | None, data: bytes, at: int, follows: bool) -> tuple[str, int]:
    """The text and length of the frame that begins at ``at``; length 0 if none does."""
    first = data[at]
    if first == 0x15:
        return "Nack", 1
    if first == STX[0] and (text := _request(data[at : at + REQUEST_BYTES])):
        return text, REQUEST_BYTES
    if first == 0x06:
        if short := _SHORT_REPLIES.get(data[at : at + 3]):
            return short, 3
        if text := _answer(data[at : at + _ANSWER_BYTES], model):
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
    named = f"{query_in_words(index)}?" if index in QUERIES else command_in_words(index, parameters)
    return f"{index:02X}h {named}{where} -> {whom}{doubt}"


def _answer(frame: bytes, model: MacModel | None) -> str:
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
    right = checksum(frame[6:17])
    doubt = "" if frame[17:19] == right else f" [checksum wrong, {right.decode()} is right]"
    address = ANY_CASE[frame[6:8]]
    whom = "general" if address == GENERAL_ADDRESS else f"module {address}"
    return f"{answer_in_words(int(digit, 16), fields, model)} ({whom}){doubt}"
