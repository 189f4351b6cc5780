"""Replies on the bus read under a lenient grammar, which names each departure from the manual's and
gives the frame that a sound module would have sent.

A frame is taken for the reply to a request if nearly all of what makes it one is there: identifier,
length, command specifier, index and sub-index.  Under another identifier all the rest has to fit;
under its own one part may be wrong.  What modules say unasked, and what others say, is passed over.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.core.lenient import Lenient, ReplyDeparture
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import CanRequest
from axistwin_conformance.families.mac.can.diagnosis import request_of
from axistwin_conformance.transport.can_frame import Frame, unpack_all

MOST_DEPARTURES: Final = 2  # of one frame
MOST_REPLIES: Final = 3  # who says more than that to one request, babbles
LEAST_BYTES: Final = 2  # command specifier, low byte of the index: less tells nothing
HEAD_BYTES: Final = 4  # command specifier, index, sub-index
MOTIONS: Final = frozenset({0x11, 0x13, 0x14, 0x15, 0x16, 0x1E})
ANSWERED_AT_ONCE_NS: Final = 500_000_000  # MACS-REPLY-16
ABORT_CLASSES: Final = frozenset({0x05, 0x06, 0x08})  # last byte of the standard's abort codes
NO_SUCH_OBJECT: Final = bytes.fromhex("00 00 02 06")  # what every other node of CANopen says

_NO_READINGS: Final[Mapping[str, str]] = {}


def lenient(
    request: bytes,
    reply: bytes,
    readings: Mapping[str, str] = _NO_READINGS,
    after_ns: int = 0,
    *,
    is_identified: bool = False,
) -> Lenient | None:
    """The reply to a sound request, frames in a row either, read under the lenient grammar; None
    for silence, for nothing of this protocol, and for somebody who never stops talking.

    `readings`: what is known of the module.  `after_ns`: how long after the request it came.
    `is_identified`: it is known that this is a module; else one that has no such object is taken
    for another node.  What else was said beside the reply stays where it is in the mended one.
    """
    sent, frames = _frames(request), _frames(reply)
    asked = request_of(sent[-1]) if sent else None
    if asked is None:
        return None
    heard = {
        at: one
        for at, frame in enumerate(frames)
        if frame != sent[-1]
        and (is_identified or frame.data[HEAD_BYTES:] != NO_SUCH_OBJECT)
        and (one := _read(asked, frame, readings)) is not None
    }
    if not heard or len(heard) > MOST_REPLIES:
        return None
    best = min(heard, key=lambda at: len(heard[at].departures))
    departures = list(heard[best].departures)
    if len(heard) > 1:
        words = "; ".join(str(frames[at]) for at in heard)
        departures.append(ReplyDeparture("MACC-SDO-06", "number", "one reply", words))
    if after_ns > ANSWERED_AT_ONCE_NS and asked.index in MOTIONS:
        expected = "a reply when the command is taken over"
        late = f"one {after_ns // 1_000_000} ms after it"
        departures.append(ReplyDeparture("MACC-SDO-13", "moment", expected, late))
    if not heard[best].mended:
        return Lenient(tuple(departures), b"")
    others = [b"" if at in heard else frame.pack() for at, frame in enumerate(frames)]
    others[best] = heard[best].mended
    return Lenient(tuple(departures), b"".join(others))


def _frames(packed: bytes) -> tuple[Frame, ...]:
    """The frames in these bytes; none if they are none."""
    try:
        return unpack_all(packed)
    except ValueError:
        return ()


def _read(asked: CanRequest, frame: Frame, readings: Mapping[str, str]) -> Lenient | None:
    """A frame taken for the reply, with what is wrong with it; None for what is none."""
    if frame.is_remote or len(frame.data) < LEAST_BYTES:
        return None
    departures = _framing(asked, frame)
    is_foreign = any(one.name in ("identifier", "form") for one in departures)
    data, content = frame.data, _content(asked, frame.data)
    if len(content) > 1 and (realigned := _realigned(asked, data)) is not None:
        named = f"{_hex(_named(asked))} behind the first byte"
        content = [ReplyDeparture(_form(asked), "head", named, _hex(data[:HEAD_BYTES]))]
        data = realigned
    is_short = len(frame.data) < HEAD_BYTES
    if (is_foreign and (content or is_short)) or (is_short and content):
        return None
    departures += content
    if len(departures) > MOST_DEPARTURES or len(content) > 1:
        return None
    return Lenient(tuple(departures), _mended(asked, data, readings) if data else b"")


def _named(asked: CanRequest) -> bytes:
    """What a reply repeats behind its first byte."""
    return bytes([asked.index_low, asked.index_high, asked.sub_index])


def _realigned(asked: CanRequest, data: bytes) -> bytes | None:
    """The data without the one byte too many in their head, or with the one it lacks; empty if that
    is the first, which nothing else tells; None where it makes no head of a reply."""
    named = _named(asked)
    if data.startswith(named):
        return b""
    for head in (bytes([command]) + named for command in _commands(asked)):
        for at in range(1, HEAD_BYTES):
            if data[:at] + data[at + 1 : HEAD_BYTES + 1] == head:
                return data[:at] + data[at + 1 :]
            if data[: HEAD_BYTES - 1] == head[:at] + head[at + 1 :]:
                return head + data[HEAD_BYTES - 1 :]
    return None


def _form(asked: CanRequest) -> str:
    """Whose requirement the form of the reply is."""
    return "MACC-SDO-03" if asked.command == codec.UPLOAD else "MACC-SDO-01"


def _framing(asked: CanRequest, frame: Frame) -> list[ReplyDeparture]:
    """What is wrong with the frame around its data."""
    told, identifiers = [], [codec.REPLY + asked.address]
    if asked.address == codec.GENERAL_ADDRESS:  # MACC-AMB-03
        identifiers = [codec.REPLY + codec.SPOKESMAN, codec.REQUEST + codec.SPOKESMAN]
    if frame.is_extended:
        told.append(
            ReplyDeparture("MACC-ID-01", "form", "an identifier of 11 bits", "one of 29 bits")
        )
    if frame.identifier not in identifiers:
        expected = " or ".join(f"{one:03X}h" for one in identifiers)
        told.append(
            ReplyDeparture("MACC-ID-01", "identifier", expected, f"{frame.identifier:03X}h")
        )
    if frame.length != codec.TRANSFER_BYTES:
        came = f"{frame.length}: {_hex(frame.data)}"
        told.append(ReplyDeparture(_form(asked), "length", "8 bytes", came))
    return told


def _content(asked: CanRequest, data: bytes) -> list[ReplyDeparture]:
    """What is wrong with the data, as far as there are any."""
    form, told = _form(asked), []
    command, index, sub_index, value = data[:1], data[1:3], data[3:4], data[HEAD_BYTES:]
    if command[0] not in _commands(asked):
        name, expected = "command specifier", " or ".join(f"{one:02X}h" for one in _commands(asked))
        told.append(ReplyDeparture(form, name, expected, f"{command[0]:02X}h"))
    elif command[0] == codec.REFUSED and any(value) and value[-1] not in ABORT_CLASSES:
        told.append(ReplyDeparture("MACC-SDO-02", "abort code", "zeros", _hex(value)))
    elif command[0] == codec.ACCEPTED and any(value):
        told.append(ReplyDeparture(form, "data", "zeros", _hex(value)))
    named = bytes([asked.index_low, asked.index_high])
    if not named.startswith(index):
        name = "byte order" if index == named[::-1] else "index"
        told.append(ReplyDeparture(form, name, _hex(named), _hex(index)))
    if sub_index and sub_index[0] != asked.sub_index:
        told.append(ReplyDeparture(form, "sub-index", f"{asked.sub_index:02X}", _hex(sub_index)))
    return told


def _commands(asked: CanRequest) -> tuple[int, ...]:
    """With what first byte a module may reply; with a sub-index it may refuse any (MACC-AMB-16)."""
    if asked.command == codec.DOWNLOAD:
        return codec.ACCEPTED, codec.REFUSED
    refusal = (codec.REFUSED,) if asked.sub_index else ()
    return *codec.ANSWER_SPELLINGS, *refusal


def _mended(asked: CanRequest, data: bytes, readings: Mapping[str, str]) -> bytes:
    """The reply of a sound module; empty where the frame does not tell what it would have been."""
    command, value = data[0], data[HEAD_BYTES:]
    is_upload = asked.command == codec.UPLOAD
    if command >> 5 == codec.REFUSED >> 5:
        command, value = codec.REFUSED, value if value[-1:] and value[-1] in ABORT_CLASSES else b""
    elif not is_upload:
        is_known = command >> 5 in (
            codec.ACCEPTED >> 5,
            *(one >> 5 for one in codec.ANSWER_SPELLINGS),
        )
        if not is_known or command == asked.command:
            return b""
        command, value = codec.ACCEPTED, b""
    elif (
        command == asked.command
        or len(data) != codec.TRANSFER_BYTES
        or (command >> 5 == codec.ACCEPTED >> 5 and not any(value))  # no number: a mere "done"
    ):
        return b""
    elif command not in codec.ANSWER_SPELLINGS:
        command = int(readings.get("upload_scs", "42h")[:-1], 16)
    head = bytes([command]) + _named(asked)
    whom = asked.address or codec.SPOKESMAN
    return Frame(codec.REPLY + whom, head + value.ljust(len(codec.ZEROS), b"\0")).pack()


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()
