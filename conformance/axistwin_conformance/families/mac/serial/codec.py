"""Host side of the MAC serial line: requests to send, legal or not, and replies to take apart.

A request is always 21 bytes: Stx, the length ``014``, address, index and sub-index as two hex
digits each, eight parameter digits, two checksum digits, Etx (MACS-FRAME-01).  A reply has 1, 3 or
21 bytes, and its first bytes tell which:

    15                                   Nack: wrong checksum             (MACS-REPLY-02)
    06 13 1A                             accepted and executed            (MACS-REPLY-01)
    06 13 17                             understood, but refused          (MACS-REPLY-03)
    06 13 02 011 aa i dddddddd cc 03 1A  answer to a query                (MACS-REPLY-07)

Building never refuses anything: a conformance suite must be able to send every illegal frame.
Parsing never raises: what does not fit is GARBAGE with its flaws listed, so that a check can tell a
wrong digit from a wrong checksum.  Where the manual leaves the byte open (Xon, Xonerror, the length
of answer 28h) all readings are understood and the one seen is told.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Final

from axistwin_conformance.families.mac.axis.exchanges import (
    COMMAND_NAMES,
    QUERY_NAMES,
    ReplyKind,
)
from axistwin_conformance.families.mac.axis.words import NOT_USED, data_words, request_words

STX: Final = 0x02
ETX: Final = 0x03
ACK: Final = 0x06
XOFF: Final = 0x13
NACK: Final = 0x15

XON_SPELLINGS: Final = {0x1A: "1Ah", 0x11: "11h"}  # MACS-AMB-01
XONERROR_SPELLINGS: Final = {0x17: "17h", 0x18: "18h"}  # MACS-AMB-02
ANSWER_LENGTH_FIELDS: Final = (b"011", b"014")  # MACS-AMB-05: 014 is printed for 28h only

REQUEST_LENGTH_FIELD: Final = b"014"
REQUEST_BYTES: Final = 21
SUMMED_BYTES: Final = 14
SHORT_REPLY_BYTES: Final = 3
SUMS: Final = 256  # different ones
ANSWER_BYTES: Final = 21
ANSWER_START: Final = bytes([ACK, XOFF, STX])
GENERAL_ADDRESS: Final = 0xFF
IMAX_ADDRESS: Final = 0xAF  # MACS-Q-28-01

_DIGIT_CHARACTERS: Final = b"0123456789ABCDEF"
DIGITS: Final = frozenset(_DIGIT_CHARACTERS)


def checksum(characters: bytes) -> int:
    """Sum of the character codes modulo 100h (MACS-FRAME-03)."""
    return sum(characters) % 0x100


def two_digits(value: int) -> bytes:
    """Spell a byte as two upper-case hex digits."""
    return b"%02X" % (value & 0xFF)


def eight_digits(value: int) -> bytes:
    """Spell a number, negative ones in two's complement, as eight digits (MACS-FRAME-05)."""
    return b"%08X" % (value & 0xFFFF_FFFF)


@dataclass(frozen=True, slots=True)
class SerialRequest:
    """One frame of the host, field by field as raw characters, so that any field can be corrupted.

    ``check`` of None stands for the right checksum of the other fields.
    """

    address: bytes
    index: bytes
    sub_index: bytes = b"00"
    parameters: bytes = b"00000000"
    check: bytes | None = None
    start: bytes = bytes([STX])
    length: bytes = REQUEST_LENGTH_FIELD
    end: bytes = bytes([ETX])

    @property
    def summed(self) -> bytes:
        """The characters under the checksum."""
        return self.address + self.index + self.sub_index + self.parameters

    def encode(self) -> bytes:
        """Give the bytes for the line."""
        check = two_digits(checksum(self.summed)) if self.check is None else self.check
        return self.start + self.length + self.summed + check + self.end

    @property
    def is_well_formed(self) -> bool:
        """True if a module takes this for a frame: right fields, digits only, right checksum."""
        is_framed = (self.start, self.length, self.end) == (b"\x02", REQUEST_LENGTH_FIELD, b"\x03")
        is_spelt = set(self.summed) <= DIGITS and len(self.summed) == SUMMED_BYTES
        return is_framed and is_spelt and self.check is None

    def with_wrong_checksum(self, offset: int = 1) -> SerialRequest:
        """Spoil the checksum by ``offset`` (1..255), keeping it two hex digits."""
        return replace(self, check=two_digits(checksum(self.summed) + offset))

    def in_lower_case(self) -> SerialRequest:
        """Spell the fields in lower case, with the checksum of what is then sent."""
        return replace(
            self,
            address=self.address.lower(),
            index=self.index.lower(),
            sub_index=self.sub_index.lower(),
            parameters=self.parameters.lower(),
        )


def request(address: int, index: int, parameter: int = 0, sub_index: int = 0) -> SerialRequest:
    """Build a well-formed request; ``parameter`` is a signed or unsigned 32-bit number."""
    return SerialRequest(
        address=two_digits(address),
        index=two_digits(index),
        sub_index=two_digits(sub_index),
        parameters=eight_digits(parameter),
    )


@lru_cache(maxsize=4096)
def frame(address: int, index: int, parameter: int = 0) -> bytes:
    """What `request(...).encode()` gives, at a fraction of its cost."""
    summed = b"%02X%02X00%08X" % (address & 0xFF, index & 0xFF, parameter & 0xFFFF_FFFF)
    return b"\x02014%b%02X\x03" % (summed, checksum(summed))


@dataclass(frozen=True, slots=True)
class SerialReply:
    """A reply taken apart; the answer fields are None or empty unless ``kind`` is ANSWER.

    ``data`` is the answer's 32-bit number, ``address`` and ``digit`` as sent, ``final`` the byte
    behind the message (Xon or Xonerror), ``flaws`` what does not fit the manual.
    """

    kind: ReplyKind
    raw: bytes = b""
    address: int | None = None
    digit: int | None = None
    data: int | None = None
    length: bytes = b""
    final: int | None = None
    flaws: tuple[str, ...] = field(default=())

    @property
    def xon_spelling(self) -> str | None:
        """The reading of AMB-01 this reply shows, if it shows one."""
        return None if self.final is None else XON_SPELLINGS.get(self.final)

    @property
    def xonerror_spelling(self) -> str | None:
        """The reading of AMB-02 this reply shows, if it shows one."""
        return None if self.final is None else XONERROR_SPELLINGS.get(self.final)

    def data_bytes(self) -> tuple[int, int, int, int]:
        """Give the four data bytes of an answer, first byte first."""
        assert self.data is not None, "only an answer carries data"
        first, second, third, fourth = self.data.to_bytes(4, "big")
        return first, second, third, fourth

    def __str__(self) -> str:
        return explain_reply(self)


SILENCE: Final = SerialReply(ReplyKind.SILENCE)


def missing_bytes(received: bytes) -> int:
    """Tell how many more bytes the reply beginning with ``received`` needs at least; 0 = complete.

    A beginning that fits no reply is complete as it is: garbage.
    """
    if not received:
        return 1
    if received[0] == NACK:
        return 0
    if received[0] != ACK or (len(received) > 1 and received[1] != XOFF):
        return 0
    if len(received) < SHORT_REPLY_BYTES:
        return SHORT_REPLY_BYTES - len(received)
    if received[2] != STX:
        return 0
    return max(0, ANSWER_BYTES - len(received))


def is_summed(received: bytes) -> bool:
    """Whether it is framed as an answer, and the sum is that of what it holds, whatever that is:
    whoever sent it meant it.  No byte corrupted, lost or added on the way leaves the sum right, but
    for zeros, which a glitch adds."""
    summed, told, final = received[6:-4], received[-4:-2], received[-2:]
    is_begun = received.startswith(ANSWER_START) and received[3:6] in ANSWER_LENGTH_FIELDS
    is_ended = final[:1] == bytes([ETX]) and final[-1] in XON_SPELLINGS
    return is_begun and is_ended and 0 not in summed and told == two_digits(checksum(summed))


def parse(received: bytes) -> SerialReply:
    """Take a reply apart; everything received must belong to it, or it is garbage."""
    if not received:
        return SILENCE
    if received == bytes([NACK]):
        return SerialReply(ReplyKind.NACK, received)
    if len(received) == SHORT_REPLY_BYTES and received[:2] == bytes([ACK, XOFF]):
        return _parse_short(received)
    if len(received) == ANSWER_BYTES and received.startswith(ANSWER_START):
        return _parse_answer(received)
    return SerialReply(ReplyKind.GARBAGE, received, flaws=("fits no reply of the manual",))


@lru_cache(maxsize=256)
def _parse_short(received: bytes) -> SerialReply:
    final = received[2]
    if final in XON_SPELLINGS:
        return SerialReply(ReplyKind.ACCEPTED, received, final=final)
    if final in XONERROR_SPELLINGS:
        return SerialReply(ReplyKind.REFUSED, received, final=final)
    flaw = f"third byte {final:02X} is neither Xon nor Xonerror"
    return SerialReply(ReplyKind.GARBAGE, received, final=final, flaws=(flaw,))


@lru_cache(maxsize=4096)
def answer_data(received: bytes) -> int | None:
    """`parse(received).data`, at a fraction of its cost."""
    is_framed = len(received) == ANSWER_BYTES and received.startswith(ANSWER_START)
    return int(received[9:17], 16) if is_framed and not _flaws(received) else None


def _flaws(received: bytes) -> list[str]:
    """What does not fit the manual in what has the frame of an answer."""
    length, summed, flaws = received[3:6], received[6:17], []
    if length not in ANSWER_LENGTH_FIELDS:
        flaws.append(f"length field {_text(length)} is not 011")
    if received[6:19].translate(None, _DIGIT_CHARACTERS):
        flaws.append("a field holds something else than the digits 0-9 A-F")
    elif received[17:19] != two_digits(checksum(summed)):
        expected = two_digits(checksum(summed))
        flaws.append(f"checksum {_text(received[17:19])} should be {_text(expected)}")
    if received[19] != ETX:
        flaws.append(f"byte 19 is {received[19]:02X}, not Etx")
    if received[20] not in XON_SPELLINGS:
        flaws.append(f"last byte {received[20]:02X} is not Xon")
    return flaws


def _parse_answer(received: bytes) -> SerialReply:
    length, summed = received[3:6], received[6:17]
    if flaws := _flaws(received):
        return SerialReply(
            ReplyKind.GARBAGE, received, length=length, final=received[20], flaws=tuple(flaws)
        )
    return SerialReply(
        ReplyKind.ANSWER,
        received,
        address=int(summed[:2], 16),
        digit=int(summed[2:3], 16),
        data=int(summed[3:], 16),
        length=length,
        final=received[20],
    )


# --- words for reports ---------------------------------------------------------------------------


def explain(data: bytes) -> str:
    """Put a frame of either direction into one line of words."""
    if data[:1] in (bytes([ACK]), bytes([NACK])):
        return explain_reply(parse(data))
    return explain_request(data)


def explain_request(data: bytes) -> str:
    """Put a request, well-formed or not, into words: ``to module 00h: 20h (position)``."""
    if len(data) > REQUEST_BYTES and data[0] == data[-REQUEST_BYTES] == STX and data[-1] == ETX:
        begun, whole = data[:-REQUEST_BYTES], data[-REQUEST_BYTES:]
        return f"frame broken off after {begun.hex(' ').upper()}, then {explain_request(whole)}"
    if len(data) != REQUEST_BYTES or data[0] != STX or data[20] != ETX:
        return f"no frame ({len(data)} bytes)"
    summed = data[4:18]
    address, index = _text(summed[:2]), _text(summed[2:4])
    words = f"{index}h ({_name(summed[2:4])} {_text(summed[6:])})"
    if set(summed) <= DIGITS:
        words = request_words(int(summed[2:4], 16), int(summed[6:], 16))
    to = "all" if address == f"{GENERAL_ADDRESS:02X}" else f"module {address}h"
    return f"to {to}: {words}{oddities(data)}"


def is_refusal(received: bytes) -> bool:
    """True for a reply that says that nothing was done."""
    return bool(received) and parse(received).kind in (ReplyKind.REFUSED, ReplyKind.NACK)


def oddities(data: bytes) -> str:
    """What is unusual in a request of the right length, to be put behind its words."""
    summed, check = data[4:18], data[18:20]
    words = "" if summed[4:6] == b"00" else f", {_sub_index(summed[2:4])} {_text(summed[4:6])}h"
    if data[1:4] != REQUEST_LENGTH_FIELD:
        words += f", length field {_text(data[1:4])}"
    if check != two_digits(checksum(summed)):
        words += f", checksum {_text(check)}h instead of {_text(two_digits(checksum(summed)))}h"
    return words


def explain_reply(reply: SerialReply) -> str:
    """Put a reply into words."""
    if reply.kind is ReplyKind.ANSWER:
        assert reply.data is not None
        assert reply.address is not None
        assert reply.digit is not None
        words = data_words(0x20 + reply.digit, reply.data)
        return f"answer of module {reply.address:02X}h to 2{reply.digit:X}h: {words}"
    if reply.kind is ReplyKind.GARBAGE:
        return f"garbage {_text(reply.raw)}: {'; '.join(reply.flaws)}"
    return reply.kind.value if not reply.raw else f"{reply.kind.value} ({_text(reply.raw)})"


def _name(index: bytes) -> str:
    if any(character not in DIGITS for character in index.upper()):
        return "unreadable index"
    number = int(index, 16)
    return COMMAND_NAMES.get(number) or QUERY_NAMES.get(number) or NOT_USED


def _sub_index(index: bytes) -> str:
    return {b"28": "RAM address", b"29": "EEPROM address"}.get(index, "sub-index")


def _text(data: bytes) -> str:
    """Printable digits as they are, everything else as hex bytes."""
    if data and all(0x20 <= byte < 0x7F for byte in data):
        text = data.decode("ascii")
        return f'"{text}"' if " " in text else text
    return data.hex(" ").upper()
