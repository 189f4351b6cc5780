"""Packets of the serial port and reports of the USB port: their bytes (ledger §2).

    request  ADDR | command | parameters | ADDR | sum
    status   ADDR | command | code | 00 | ADDR | sum            the null: MN4-AMB-03
    data     ADDR | command | value | trailer | ADDR | sum

ADDR is the number of the board with bit 7 set, 80h for all boards (MN4-PKT-02).  The sum is that of
all bytes before it, both addresses included, without bit 7 (MN4-PKT-03).  A null adds nothing to
it: the sum never tells whether one is there.
"""

import re
from enum import IntEnum
from functools import cache
from typing import Final

from axistwin.devices.mn400.quirks import Mn400Quirks

ADDRESS_BIT: Final = 0x80
EVERYBODY: Final = 0
"""The number that concerns all boards; none has it (MN4-DROP-01)."""

STATUS_BYTES: Final = 6
FRAME_BYTES: Final = 3
"""What a packet has beside its command and what follows that."""

REPORT_BYTES: Final = 64
PARSED_BYTES: Final = 48
"""Of a report, those that the board looks at (MN4-USB-02)."""

_REPLY: Final = re.compile(rb".[\x20-\x7F]*[\x00-\x1F]\x00?", re.DOTALL)
_TRAILERS: Final = {
    "06": b"\x06",
    "none": b"",
    "0600": b"\x06\x00",
    "05": b"\x05",
    "0500": b"\x05\x00",
    "00": b"\x00",
}


class ReturnCode(IntEnum):
    """What a status packet says (ledger §2.5)."""

    START = 0x03
    MOVE_ABORT = 0x04
    DONE = 0x05
    CHKSUMERROR = 0x07
    ADDRESS_ERROR = 0x08
    INVALIDCOMMAND = 0x0C
    INVALIDPROGCOMM = 0x0D
    PARA_ERROR = 0x0E
    NO_COMMAND = 0x0F
    NOMOVEPENDING = 0x10
    MOVEPENDING = 0x11
    BAUDCHANGEOK = 0x12
    TIMEOUT = 0x13
    BUSY = 0x14
    SLAVEBUFFOV = 0x15
    PRESENT = 0x16
    NOT_AVAILABLE = 0x1D
    MEMORY_FULL = 0x1E
    MOVE_STOPPED = 0x20


OF_MN100: Final = (
    ReturnCode.ADDRESS_ERROR,
    ReturnCode.NO_COMMAND,
    ReturnCode.NOT_AVAILABLE,
    ReturnCode.MOVE_STOPPED,
)
"""The codes that the predecessor alone has (``mn100_codes``, ``motion_done``)."""

REASONS: Final = {
    ReturnCode.CHKSUMERROR: "its checksum is wrong",
    ReturnCode.ADDRESS_ERROR: "its two addresses differ",
    ReturnCode.NO_COMMAND: "it has no command",
    ReturnCode.NOT_AVAILABLE: "there is no such output",
    ReturnCode.INVALIDCOMMAND: "no such command while the board is in this state: {state}",
    ReturnCode.INVALIDPROGCOMM: "it cannot stand in a stored program",
    ReturnCode.PARA_ERROR: "a parameter is malformed or out of range",
    ReturnCode.TIMEOUT: "the packet broke off",
    ReturnCode.BUSY: "not possible in this state: {state}",
    ReturnCode.SLAVEBUFFOV: "no room in the buffer or the queue",
    ReturnCode.MEMORY_FULL: "no room in the store",
}
"""What the codes of refusals mean, for who looks on."""

NULL_IS_SHOWN: Final = (ReturnCode.START, ReturnCode.PRESENT, ReturnCode.DONE)
"""The codes behind which the manual shows a null; behind the others see MN4-AMB-03."""


def checksum(data: bytes) -> int:
    """The sum of ``data`` without bit 7."""
    return sum(data) & 0x7F


def packet(address: int, payload: bytes) -> bytes:
    """``payload`` between two addresses, with the sum; ``address`` is 0..127."""
    head = b"%c%b%c" % (ADDRESS_BIT | address, payload, ADDRESS_BIT | address)
    return head + bytes((checksum(head),))


def completed(data: bytes) -> bytes:
    """``data``, a packet without its sum, with it; anything else as it is."""
    is_open = len(data) >= FRAME_BYTES and data[0] >= ADDRESS_BIT and data[-1] == data[0]
    if is_open and max(data[1:-1]) < ADDRESS_BIT:
        return data + bytes((checksum(data),))
    return data


def status(address: int, command: int, code: int, quirks: Mn400Quirks) -> bytes:
    """A status packet (MN4-RSP-01, MN4-RSP-13)."""
    return _status(address, command, code, quirks.start_null, quirks.outcome_null)


@cache
def _status(address: int, command: int, code: int, start_null: bool, outcome_null: bool) -> bytes:
    has_null = start_null if code in NULL_IS_SHOWN else outcome_null
    return packet(address, bytes((command, code)) + b"\x00" * has_null)


def data_packet(address: int, command: int, value: str, quirks: Mn400Quirks) -> bytes:
    """A data packet with its trailer (MN4-RSP-12)."""
    text = value.encode("ascii")
    if quirks.data_value_encoding == "dot_nul":  # as the bytes of the manual's example
        text = text.replace(b",0", b".\x00")
    return packet(address, bytes((command,)) + text + trailer(quirks))


def trailer(quirks: Mn400Quirks) -> bytes:
    """What stands behind the value of a data packet (MN4-AMB-01)."""
    return _TRAILERS[quirks.data_packet_trailer]


def is_reply(payload: bytes) -> bool:
    """Whether a board may have sent it: it ends with a code, maybe a null (MN4-DROP-10).

    Any other control character is a host's mistake in a parameter (MN4-PAR-02).
    """
    return _REPLY.fullmatch(payload) is not None


def report(content: bytes) -> bytes:
    """A report with ``content`` and the padding behind it; what does not fit is lost."""
    return content[:REPORT_BYTES].ljust(REPORT_BYTES, b"\x00")


def report_text(data: bytes) -> bytes:
    """The command in a report: up to the first null within the bytes that are looked at."""
    return data[:PARSED_BYTES].partition(b"\x00")[0]
