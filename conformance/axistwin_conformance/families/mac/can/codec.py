"""Host side of the MAC23 on CAN: frames to send, legal or not, and frames heard to take apart.

A module is a server of expedited transfers with a manufacturer area 2000h.. only.  A command is a
download, a query an upload; the two ranges of indices overlap, and the direction decides
(MACC-SDO-05).

    600h + adr   23 ii 20 ss  d d d d    download           (MACC-SDO-01)
                 40 ii 20 ss  x x x x    upload             (MACC-SDO-03)
    580h + adr   60 ii 20 ss  0 0 0 0    accepted           (MACC-SDO-01)
                 80 ii 20 ss  0 0 0 0    refused            (MACC-SDO-02)
                 42 ii 20 ss  d d d d    answer             (MACC-SDO-03)
    600h                                 a request to all   (MACC-GEN-01)
    080h                                 SYNC               (MACC-SYNC-01)
    080h + adr   eight bytes             emergency          (MACC-EMCY-03)
    700h + adr   00                      boot-up            (MACC-BOOT-02)
    7E5h, 7E4h                           LMT                (MACC-LMT-01)

Indices.  Here and in the whole suite an index below 20h is the download of that low byte, 20h + ii
the upload ii: the numbers that command and query have on the serial line, so that what speaks of
the axis need not know its wire.

Building refuses only what no CAN controller could send.  Parsing never raises: what does not fit is
GARBAGE with its flaws listed.  Where the manual leaves the form open, all readings are understood
and the one seen is told.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from axistwin_conformance.base.errors import counted
from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES as AXIS_COMMANDS
from axistwin_conformance.families.mac.axis.exchanges import QUERY_NAMES as AXIS_QUERIES
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind as ReplyKind
from axistwin_conformance.families.mac.axis.exchanges import signed as signed
from axistwin_conformance.families.mac.axis.words import NOT_USED, data_words, request_words
from axistwin_conformance.transport.can_frame import Frame

NMT: Final = 0x000
SYNC: Final = 0x080
EMERGENCY: Final = 0x080  # + address
REPLY: Final = 0x580  # + address
REQUEST: Final = 0x600  # + address
BOOT_UP: Final = 0x700  # + address
LMT_REPLY: Final = 0x7E4
LMT_REQUEST: Final = 0x7E5

ADDRESSES: Final = range(1, 0x80)  # MACC-ID-01
GENERAL_ADDRESS: Final = 0  # 600h + 0: to all, and nobody's own (MACC-GEN-01)
SPOKESMAN: Final = 1  # who answers what all are told (MACC-GEN-02)

DOWNLOAD: Final = 0x23
UPLOAD: Final = 0x40
ACCEPTED: Final = 0x60
REFUSED: Final = 0x80
ANSWER_SPELLINGS: Final = {0x42: "42h", 0x43: "43h"}  # MACC-AMB-18
INDEX_HIGH: Final = 0x20
TRANSFER_BYTES: Final = 8
ZEROS: Final = bytes(4)
IMAX: Final = 0x80  # MACC-CMD-0C-01
QUERIES: Final = range(0x20, 0x30)
ANSWERED: Final = range(0x20, 0x28)


# --- what the four parameter bytes mean ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Field:
    """Bytes of a parameter that belong together: offset in the four, number, sign."""

    name: str
    offset: int
    size: int
    is_signed: bool = False

    def read(self, data: bytes) -> int:
        """Give the value, most significant byte first (MACC-SDO-04)."""
        raw = data[self.offset : self.offset + self.size]
        return int.from_bytes(raw, "big", signed=self.is_signed)


@dataclass(frozen=True, slots=True)
class Layout:
    """The four bytes of one index: its fields, and which of them would travel together as numbers
    if a device took the standard's byte order instead (MACC-AMB-01).  What the manual has as bytes
    of their own keeps its place then; a lone byte behind three without a meaning is a number of
    four."""

    fields: tuple[Field, ...] = ()
    words: tuple[int, ...] = (4,)

    def read(self, data: bytes) -> dict[str, int]:
        """Give the values of all fields."""
        return {part.name: part.read(data) for part in self.fields}

    def reordered(self, data: bytes) -> bytes:
        """Turn each number's bytes round: from one byte order into the other."""
        turned, at = b"", 0
        for size in self.words:
            turned += data[at : at + size][::-1]
            at += size
        return turned


def _low(name: str) -> Layout:
    return Layout((Field(name, 3, 1),))


def _number(name: str) -> Layout:
    return Layout((Field(name, 0, 4, is_signed=True),))


_SEGMENT: Final = Layout((Field("steps", 0, 2, is_signed=True), Field("period", 2, 2)), (2, 2))
_NOTHING: Final = Layout()
_BYTES: Final = (1, 1, 1, 1)

DOWNLOADS: Final[Mapping[int, Layout]] = {
    0x02: _low("standby"),
    0x03: _low("stops"),
    0x07: _low("reference"),
    0x09: _number("superior"),
    0x0A: _number("inferior"),
    0x0C: _low("torque"),
    0x0D: Layout((Field("period", 2, 2),), (2, 2)),
    0x0E: Layout((Field("catch_up", 2, 1),), (2, 2)),
    0x0F: _low("coefficient"),
    0x13: _number("target"),
    0x15: Layout((Field("direction", 1, 1), Field("period", 2, 2)), (1, 1, 2)),
    0x16: _SEGMENT,
    0x1C: _low("tolerance"),
    0x1E: _SEGMENT,
    **dict.fromkeys((0x00, 0x01, 0x0B, 0x10, 0x11, 0x14, 0x17, 0x18, 0x19, 0x1A), _NOTHING),
}
MAY_BE_SILENT: Final = frozenset({0x00, 0x01})  # downloads that restart it, MACC-AMB-26
UNASSIGNED_DOWNLOADS: Final = tuple(number for number in range(0x20) if number not in DOWNLOADS)
UPLOADS: Final[Mapping[int, Layout]] = {
    0x20: _number("position"),
    0x21: Layout(
        (Field("dd", 0, 1), Field("ff", 1, 1), Field("gg", 2, 1), Field("hh", 3, 1)), _BYTES
    ),
    0x22: _number("superior"),
    0x23: _number("inferior"),
    0x24: Layout((Field("release", 0, 4),), _BYTES),
    0x25: Layout((Field("catch_up", 0, 1), Field("zero", 1, 1), Field("period", 2, 2)), (1, 1, 2)),
    0x26: Layout(
        (
            Field("coefficient", 0, 1),
            Field("torque", 1, 1),
            Field("modes", 2, 1),
            Field("tolerance", 3, 1),
        ),
        _BYTES,
    ),
    0x27: Layout(
        (Field("tt", 0, 1), Field("vv", 1, 1), Field("cc", 2, 1), Field("dd", 3, 1)), _BYTES
    ),
}
UNASSIGNED_UPLOADS: Final = tuple(query for query in QUERIES if query not in UPLOADS)
LAYOUTS: Final = {**DOWNLOADS, **UPLOADS}


def parameter_bytes(index: int, parameter: int, byte_order: str = "big") -> bytes:
    """The four bytes of a signed or unsigned 32-bit parameter, in a reading of MACC-AMB-01."""
    data = (parameter & 0xFFFF_FFFF).to_bytes(4, "big")
    return data if byte_order == "big" else LAYOUTS.get(index, _NOTHING).reordered(data)


# --- what a host sends ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CanRequest:
    """A transfer asked for, field by field, so that any field can be corrupted.

    `length`: of the frame, 0..8; below 8 what stands behind is cut off.  `address` 0: to all.
    """

    address: int
    command: int
    index_low: int
    data: bytes = ZEROS
    sub_index: int = 0
    index_high: int = INDEX_HIGH
    length: int = TRANSFER_BYTES

    def frame(self) -> Frame:
        """Give the frame for the bus."""
        head = bytes([self.command, self.index_low, self.index_high, self.sub_index])
        return Frame(REQUEST + self.address, (head + self.data)[: self.length])

    @property
    def index(self) -> int:
        """The suite's index: low byte of a download, 20h more of an upload."""
        return self.index_low + (0x20 if self.command == UPLOAD else 0)

    @property
    def is_well_formed(self) -> bool:
        """True if it is one of the two transfers the manual knows, whole and in its area."""
        is_known = self.command in (DOWNLOAD, UPLOAD) and self.index_high == INDEX_HIGH
        return is_known and self.length == TRANSFER_BYTES and len(self.data) == len(ZEROS)


def request(
    address: int, index: int, parameter: int = 0, sub_index: int = 0, byte_order: str = "big"
) -> CanRequest:
    """Build a well-formed request: a download for an index below 20h, else an upload, of which
    `parameter` is the filler."""
    data = parameter_bytes(index, parameter, byte_order)
    if index in QUERIES:
        return CanRequest(address, UPLOAD, index - 0x20, data, sub_index)
    return CanRequest(address, DOWNLOAD, index, data, sub_index)


def sync(data: bytes = b"") -> Frame:
    """Build the frame that starts what is preloaded (MACC-SYNC-01)."""
    return Frame(SYNC, data)


def nmt(command: int, address: int = 0) -> Frame:
    """Build a network management frame, of which the manual does not speak (MACC-AMB-24)."""
    return Frame(NMT, bytes([command, address]))


def lmt(*head: int, length: int = TRANSFER_BYTES) -> Frame:
    """Build an LMT frame: its first bytes, zeros up to `length` (MACC-AMB-08)."""
    return Frame(LMT_REQUEST, bytes(head).ljust(length, b"\0")[:length])


def lmt_enter(length: int = TRANSFER_BYTES) -> Frame:
    """Build the frame that opens the address procedure (MACC-LMT-01)."""
    return lmt(0x04, 0x01, length=length)


def lmt_address(address: int, length: int = TRANSFER_BYTES) -> Frame:
    """Build the frame that gives the address, 0..255 (MACC-LMT-02)."""
    return lmt(0x11, address, length=length)


def lmt_leave(length: int = TRANSFER_BYTES) -> Frame:
    """Build the frame that closes the procedure and makes the address hold (MACC-LMT-03)."""
    return lmt(0x04, 0x00, length=length)


# --- what a module says when asked ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class CanReply:
    """A reply taken apart.

    `index` (the suite's) and `sub_index`: as repeated by the module.  `data`: the four bytes of an
    answer as a number, first byte first.  `abort_code`: what a refusal carries, 0 for the manual's
    zeros.  `flaws`: what does not fit the manual.
    """

    kind: ReplyKind
    frame: Frame | None = None
    index: int | None = None
    sub_index: int | None = None
    data: int | None = None
    abort_code: int = 0
    flaws: tuple[str, ...] = field(default=())

    @property
    def raw(self) -> bytes:
        """The frame, packed; empty for silence."""
        return b"" if self.frame is None else self.frame.pack()

    @property
    def answer_spelling(self) -> str | None:
        """The reading of MACC-AMB-18 this reply shows, if it shows one."""
        if self.kind is not ReplyKind.ANSWER or self.frame is None:
            return None
        return ANSWER_SPELLINGS[self.frame.data[0]]

    def data_bytes(self) -> tuple[int, int, int, int]:
        """Give the four data bytes of an answer, first byte first."""
        assert self.data is not None, "only an answer carries data"
        first, second, third, fourth = self.data.to_bytes(4, "big")
        return first, second, third, fourth

    def __str__(self) -> str:
        return explain_reply(self)


SILENCE: Final = CanReply(ReplyKind.SILENCE)


def parse(frame: Frame | None, byte_order: str = "big") -> CanReply:
    """Take the frame apart that came back, None for none; whose it is, is not asked here."""
    if frame is None:
        return SILENCE
    if not frame.is_plain:
        return CanReply(ReplyKind.GARBAGE, frame, flaws=("an extended or a remote frame",))
    if len(frame.data) != TRANSFER_BYTES:
        return CanReply(ReplyKind.GARBAGE, frame, flaws=(f"{len(frame.data)} bytes instead of 8",))
    command, low, high, sub_index = frame.data[:4]
    data = frame.data[4:]
    index = low if high == INDEX_HIGH else None
    if command == ACCEPTED:
        if data == ZEROS:
            return CanReply(ReplyKind.ACCEPTED, frame, index, sub_index)
        flaw = f"{data.hex(' ').upper()} behind 60h instead of zeros"
    elif command == REFUSED:
        abort_code = int.from_bytes(data, "little")  # the standard's order
        return CanReply(ReplyKind.REFUSED, frame, index, sub_index, abort_code=abort_code)
    elif command in ANSWER_SPELLINGS:
        index = None if index is None else 0x20 + index
        layout = _NOTHING if index is None else LAYOUTS.get(index, _NOTHING)
        ordered = data if byte_order == "big" else layout.reordered(data)
        return CanReply(ReplyKind.ANSWER, frame, index, sub_index, int.from_bytes(ordered, "big"))
    else:
        flaw = f"first byte {command:02X} is none of 60, 80, 42"
    return CanReply(ReplyKind.GARBAGE, frame, index, sub_index, flaws=(flaw,))


def index_of(frame: Frame) -> int | None:
    """The index of a plain request for a known form of transfer; None for any other frame."""
    is_whole = frame.is_plain and len(frame.data) == TRANSFER_BYTES
    if not is_whole or not REQUEST <= frame.identifier <= REQUEST + ADDRESSES[-1]:
        return None
    command, low, high, sub_index = frame.data[:4]
    bases = {DOWNLOAD: range(0x20), UPLOAD: QUERIES}
    if high != INDEX_HIGH or sub_index or command not in bases or low >= len(bases[command]):
        return None
    return bases[command][low]


def mismatch(request: CanRequest, frame: Frame) -> str:
    """What keeps a frame from a module's reply identifier from being the reply to this request:
    index, sub-index or direction; empty if nothing does.

    What has another length, or another first byte than a reply's, is none of those: a module that
    replies so is wrong, and that must not be taken for silence.
    """
    if not frame.is_plain or len(frame.data) != TRANSFER_BYTES:
        return ""
    command, repeated = frame.data[0], bytes(frame.data[1:4])
    if repeated != bytes([request.index_low, request.index_high, request.sub_index]):
        low, high, sub_index = repeated
        return f"it is for {high:02X}{low:02X}h sub-index {sub_index:02X}h"
    if command in ANSWER_SPELLINGS and request.command == DOWNLOAD:
        return "it answers an upload, not a download"
    if command == ACCEPTED and request.command == UPLOAD:
        return "it accepts a download, not an upload"
    return ""


def is_reply(frame: Frame) -> bool:
    """True for what modules send in reply to anything, requests and LMT, whoever it is from."""
    return frame.is_plain and (
        frame.identifier - REPLY in ADDRESSES
        or frame.identifier == LMT_REPLY
        or (frame.identifier == REQUEST + SPOKESMAN and _looks_like_reply(frame))
    )


def _looks_like_reply(frame: Frame) -> bool:
    """True for the first byte of a reply: what module 1 may send on 601h (MACC-AMB-03)."""
    return frame.data[:1] in (
        b"\x60",
        b"\x80",
        *(bytes([spelling]) for spelling in ANSWER_SPELLINGS),
    )


# --- what a module says unasked ------------------------------------------------------------------


def spontaneous_from(frame: Frame) -> int | None:
    """The address of the module that says this unasked (700h or 080h plus it), or None."""
    if not frame.is_plain:
        return None
    for base in (BOOT_UP, EMERGENCY):
        if frame.identifier - base in ADDRESSES:
            return frame.identifier - base
    return None


def is_spontaneous(frame: Frame) -> bool:
    """True for what modules say unasked, never in reply to a request."""
    return spontaneous_from(frame) is not None


BOOT_UP_FORMS: Final = {  # MACC-AMB-04: base of the identifier, data
    "heartbeat": (BOOT_UP, b"\0"),
    "emergency_empty": (EMERGENCY, b""),
    "heartbeat_empty": (BOOT_UP, b""),
}


def boot_up(address: int, form: str = "heartbeat") -> Frame:
    """The boot-up message of a module, in a reading of MACC-AMB-04."""
    base, data = BOOT_UP_FORMS[form]
    return Frame(base + address, data)


def boot_up_form(frame: Frame) -> str | None:
    """The reading of MACC-AMB-04 a frame is a boot-up message in; None if it is none."""
    address = spontaneous_from(frame)
    if address is None:
        return None
    for form in BOOT_UP_FORMS:
        if frame == boot_up(address, form):
            return form
    return None


# By priority: mask of the fault byte, error code, error register (MACC-EMCY-04).
ERROR_CODES: Final = (
    (0x10, 0x4200, 0x09),
    (0x01, 0x3100, 0x05),
    (0x40, 0x3210, 0x05),
    (0x20, 0x3220, 0x05),
)
EMERGENCY_FORMS: Final = ("cia301_status", "status_first", "code_only")  # MACC-AMB-05
EMERGENCY_BYTES: Final = 8


def error_of(faults: int) -> tuple[int, int]:
    """Error code and register that follow from the first byte of 2001h; 0, 0 without an error."""
    for mask, code, register in ERROR_CODES:
        if faults & mask:
            return code, register
    return 0, 0


def emergency_data(form: str, status: bytes) -> bytes:
    """The eight bytes of the emergency message of a module whose 2001h reads `status`."""
    code, register = error_of(status[0])
    head = code.to_bytes(2, "little") + bytes([register])
    described = {"cia301_status": head + status, "status_first": status, "code_only": head}
    return described[form].ljust(EMERGENCY_BYTES, b"\0")


def emergency_forms(frame: Frame, status: bytes) -> tuple[str, ...]:
    """The readings of MACC-AMB-05 in which a frame says that 2001h reads `status`."""
    return tuple(form for form in EMERGENCY_FORMS if frame.data == emergency_data(form, status))


def is_emergency(frame: Frame) -> bool:
    """True for what lies under 080h plus an address and is no boot-up message of old."""
    address = spontaneous_from(frame)
    return address is not None and frame.identifier < REPLY and boot_up_form(frame) is None


# --- words for reports ---------------------------------------------------------------------------

COMMAND_NAMES: Final = {index: AXIS_COMMANDS[index] for index in DOWNLOADS}
QUERY_NAMES: Final = {index: AXIS_QUERIES[index] for index in UPLOADS}
LMT_WORDS: Final = {b"\x04\x01": "enter configuration", b"\x04\x00": "return to nominal"}


def explain(frame: Frame) -> str:
    """Put a frame of either direction into one line of words."""
    identifier, data = frame.identifier, frame.data
    if not frame.is_plain:
        form = "extended" if frame.is_extended else "remote"
        return f"{form} frame {frame}"
    if identifier == SYNC:
        return f"SYNC {data.hex(' ').upper()}".rstrip()
    if identifier == NMT:
        return f"network management: {data.hex(' ').upper()}"
    if identifier == LMT_REQUEST:
        return f"LMT: {_lmt_words(data)}"
    if identifier == LMT_REPLY:
        return f"LMT reply: {data.hex(' ').upper()}"
    address = spontaneous_from(frame)
    if address is not None:
        return f"module {address}: {_spontaneous_words(frame)}"
    if identifier - REPLY in ADDRESSES:
        return f"module {identifier - REPLY}: {explain_reply(parse(frame))}"
    if identifier == REQUEST:
        return f"to all: {_transfer_words(data)}"
    if identifier - REQUEST in ADDRESSES:
        return f"to module {identifier - REQUEST}: {_transfer_words(data)}"
    return f"of no meaning here: {frame}"


def explain_reply(reply: CanReply) -> str:
    """Put a reply into words."""
    if reply.frame is None:
        return "silence"
    if reply.kind is ReplyKind.GARBAGE:
        return f"garbage {reply.frame}: {'; '.join(reply.flaws)}"
    _, low, high, sub_index = reply.frame.data[:4]
    words = f"{reply.kind.value} {_index_words(low, high, sub_index)}"
    if reply.data is not None:
        query = 0x20 + low
        words += f": {data_words(query, reply.data) if high == INDEX_HIGH else ''}".rstrip(": ")
        words += f" ({reply.data:08X}h)"
        spelling = reply.answer_spelling
        words += "" if spelling == "42h" else f", by {spelling}"
    return words + (f", abort code {reply.abort_code:08X}h" if reply.abort_code else "")


def _transfer_words(data: bytes) -> str:
    if len(data) != TRANSFER_BYTES:
        spelt = f" ({data.hex(' ').upper()})" if data else ""
        return f"a request of {counted(len(data), 'byte')}{spelt}"
    command, low, high, sub_index = data[:4]
    where, filler = _index_words(low, high, sub_index), data[4:].hex().upper()
    if command == UPLOAD:
        name = QUERY_NAMES.get(0x20 + low, NOT_USED) if high == INDEX_HIGH else NOT_USED
        return f"upload {where} ({name})" + ("" if data[4:] == ZEROS else f", filler {filler}")
    form = f"{'download' if command == DOWNLOAD else f'by {command:02X}h'} {where}"
    if high == INDEX_HIGH and low in COMMAND_NAMES:
        return request_words(low, int.from_bytes(data[4:], "big"), form)
    return f"{form} ({NOT_USED} {filler})"


def _index_words(low: int, high: int, sub_index: int) -> str:
    return f"{high:02X}{low:02X}h" + (f" sub-index {sub_index:02X}h" if sub_index else "")


def _lmt_words(data: bytes) -> str:
    rest = f" ({len(data)} bytes)" if len(data) != TRANSFER_BYTES else ""
    if data[:1] == b"\x11" and len(data) > 1:
        return f"new address {data[1]}{rest}"
    return LMT_WORDS.get(bytes(data[:2]), data.hex(" ").upper()) + rest


def _spontaneous_words(frame: Frame) -> str:
    if boot_up_form(frame) is not None:
        return "boot-up"
    data = frame.data.hex(" ").upper()
    if not is_emergency(frame):
        return f"under the boot-up identifier: {data}"
    is_healthy = not any(frame.data[:3]) and (len(frame.data) < 4 or not frame.data[3])
    return f"{'lifebeat' if is_healthy else 'emergency'} {data}"
