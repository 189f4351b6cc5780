"""Replies of the serial line read under a lenient grammar, which names each departure from the
manual's and gives the reply that a sound module would have sent.

    what came ─▶ rewritten in up to two of six ways (`_REWRITES`), each one departure
              ─▶ read field by field (`_FIELDS`), a field that is missing, too long, too short or
                 not what it should be is one departure
              ─▶ the reading with the fewest departures, if enough of it is as it should be

Digits have no borders, so that one digit too many can be another field's; the sum and what was
asked decide, and between equals the order of the tables.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

from axistwin_conformance.core.lenient import COMPLETENESS, Lenient, ReplyDeparture
from axistwin_conformance.families.mac.axis.exchanges import QUERIES, ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.client import ANSWERED, OTHER_DIGITS

MOST_DEPARTURES: Final = 3  # of ten fields: what has more of them is something else
MOST_TOO_LONG: Final = 8  # bytes, or too short, of one field
MOST_REWRITES: Final = 2
MOST_SURPLUS: Final = 4  # bytes before or behind a reply
SHORTEST_ANSWER: Final = 12  # with numbers that have one digit
LONGEST_ANSWER: Final = codec.ANSWER_BYTES + 12  # with fields twice as long as they should be
LONGEST: Final = 4 * codec.ANSWER_BYTES  # who says more than that to one request, babbles
MOTIONS: Final = frozenset({0x11, 0x13, 0x14, 0x15, 0x16, 0x1E})
ANSWERED_AT_ONCE_NS: Final = 500_000_000  # MACS-REPLY-16

_ACKNOWLEDGED: Final = bytes([codec.ACK, codec.XOFF])
_XONS: Final = bytes(codec.XON_SPELLINGS)
_FINALS: Final = _XONS + bytes(codec.XONERROR_SPELLINGS)
_HEX: Final = frozenset(b"0123456789ABCDEF")
_FRAMING: Final = frozenset(_ACKNOWLEDGED + _FINALS + bytes([codec.STX, codec.ETX]))
LEAST_DIGITS: Final = 8  # in an answer
_SEPARATORS: Final = b"\r\n\t ,;:\0"
_NO_READINGS: Final[Mapping[str, str]] = {}


@dataclass(frozen=True, slots=True)
class _Asked:
    """What a sound request has asked, and how a module may answer that: the digits that stand for
    the query, and the length fields, the one of this module first as far as it is known."""

    address: bytes
    index: int
    is_plain: bool
    xon: bytes  # as this module spells it
    digits: tuple[bytes, ...]
    lengths: tuple[bytes, ...]

    @property
    def is_query(self) -> bool:
        return self.index in ANSWERED

    @property
    def form(self) -> str:
        """Whose requirement the form of the reply is."""
        return "MACS-REPLY-07" if self.is_query else "MACS-REPLY-01"

    @property
    def wanted(self) -> str:
        """That form, in words."""
        if self.is_query:
            return f"an answer to query {self.index:02X}h"
        return f"06 13 1A or 06 13 17 to {self.index:02X}h"


@dataclass(frozen=True, slots=True)
class _Text:
    """What came, rewritten so far: the departures that took, and the digits as they were spelt."""

    departures: tuple[ReplyDeparture, ...]
    data: bytes
    spelt: bytes


def lenient(
    request: bytes,
    reply: bytes,
    readings: Mapping[str, str] = _NO_READINGS,
    after_ns: int = 0,
) -> Lenient | None:
    """The reply to a sound request read under the lenient grammar; None for nothing of this
    protocol, for silence, and for what comes back as it was sent.

    `readings`: what is known of the module.  `after_ns`: how long after the request it came.
    """
    asked = _asked(request, readings)
    if asked is None or not reply or request in reply or len(reply) > LONGEST:
        return None
    best = _best(asked, reply)
    if best is None:
        return None
    if after_ns > ANSWERED_AT_ONCE_NS and asked.index in MOTIONS:
        late = ReplyDeparture(
            "MACS-REPLY-14", "moment", "a reply when the command is taken over",
            f"one {after_ns // 1_000_000} ms after it",
        )  # fmt: skip
        best = replace(best, departures=(*best.departures, late))
    return best


@lru_cache(maxsize=4096)  # a reply that comes byte by byte begins like many others
def _best(asked: _Asked, reply: bytes) -> Lenient | None:
    """The reading with the fewest departures; among equals one of the reply as a whole."""
    if sound := _as_reply(asked, _Text((), reply, reply), 0):  # nearly always
        return sound
    texts = sorted(_rewritten(asked, reply), key=lambda text: not text.departures)
    for count in range(1, MOST_DEPARTURES + 1):
        for text in texts:
            left = count - len(text.departures)
            if left >= 0 and (one := _as_reply(asked, text, left)):
                return replace(one, departures=(*text.departures, *one.departures))
    return None


def _asked(request: bytes, readings: Mapping[str, str]) -> _Asked | None:
    summed = request[4:18]
    if len(request) != codec.REQUEST_BYTES or not set(summed) <= _HEX:
        return None
    address, index = int(summed[:2], 16), int(summed[2:4], 16)
    sent = codec.request(address, index, int(summed[6:], 16), int(summed[4:6], 16))
    if request != sent.encode() or index >= QUERIES.stop:
        return None
    xon = bytes.fromhex(readings.get("xon_byte", "1Ah")[:2])
    digits, lengths = ["%X" % (index & 0xF)], ["011"]
    if index in OTHER_DIGITS:  # MACS-AMB-03, -04
        switch = "status_reply_digit" if index == 0x21 else "reply23_digit"
        digits = [readings.get(switch, digits[0]), *digits, f"{OTHER_DIGITS[index]:X}"]
    if index == 0x28:  # MACS-AMB-05
        lengths = [readings.get("reply28_length", lengths[0]), *lengths, "014"]
    spelt = (tuple(one.encode() for one in dict.fromkeys(row)) for row in (digits, lengths))
    return _Asked(summed[:2], index, not summed[4:].strip(b"0"), xon, *spelt)


# --- rewriting: what concerns the reply as a whole ------------------------------------------------


def _rewritten(asked: _Asked, reply: bytes) -> Iterator[_Text]:
    """What came, and all that becomes of it by one or several rewrites."""
    for count in range(MOST_REWRITES + 1):
        for chosen in itertools.combinations(_REWRITES, count):
            text: _Text | None = _Text((), reply, reply)
            for rewrite in chosen:
                text = rewrite(asked, text) if text is not None else None
            if text is not None and text.data:
                yield text


def _without_top_bits(asked: _Asked, text: _Text) -> _Text | None:
    """Seven data bits and a parity bit: a module sends nothing above 7Fh."""
    if not any(byte > 0x7F for byte in text.data):
        return None
    words = "a top bit of its own"
    if all(byte > 0x7F for byte in text.data):
        words = "a top bit that is always set"
    elif len(parities := {byte.bit_count() % 2 for byte in text.data}) == 1:
        words = "odd parity" if parities.pop() else "even parity"
    data = bytes(byte & 0x7F for byte in text.data)
    told = ReplyDeparture(
        "MACS-LINE-01", "data bits", "8 data bits, no parity", f"7 bits and {words}"
    )
    return _Text((*text.departures, told), data, data)


def _without_separators(asked: _Asked, text: _Text) -> _Text | None:
    data = text.data.translate(None, _SEPARATORS)
    if data == text.data:
        return None
    found = bytes(byte for byte in text.data if byte in _SEPARATORS)
    told = ReplyDeparture(
        asked.form, "separator", "nothing between or behind the fields", _hex(found)
    )
    return _Text((*text.departures, told), data, data)


def _said_once(asked: _Asked, text: _Text) -> _Text | None:
    """One of several replies, if they are alike, or one of two is a mere acknowledgement."""
    data = text.data
    times = next((n for n in (3, 2) if data == data[: len(data) // n] * n), 0)
    if times and len(data) > times:
        data, words = data[: len(data) // times], f"{times} that are alike"
    elif asked.is_query and (one := re.fullmatch(_TWO_REPLIES, data, re.DOTALL)):
        data, words = one[1] or one[2], "an acknowledgement of its own beside the answer"
    else:
        return None
    told = ReplyDeparture("MACS-REPLY-12", "number", "one reply", words)
    return _Text((*text.departures, told), data, data)


def _alone(asked: _Asked, text: _Text) -> _Text | None:
    """A reply without some bytes before or behind it."""
    found = re.search(_ONE_REPLY, text.data, re.DOTALL)
    around = text.data.replace(found[0], b"", 1) if found else b""
    if found is None or not 0 < len(around) <= MOST_SURPLUS:
        return None
    told = ReplyDeparture(
        "MACS-REPLY-12", "surplus", "nothing but the reply", f"also {_hex(around)}"
    )
    return _Text((*text.departures, told), found[0], found[0])


_ONE_REPLY: Final = rb"\x06\x13(\x02.+\x03)?[\x1a\x11\x17\x18]"
_SHORT: Final = rb"\x06\x13[\x1a\x11\x17\x18]"
_TWO_REPLIES: Final = rb"%b(\x06\x13\x02.+)|(\x06\x13\x02.+\x03[\x1a\x11])%b" % (_SHORT, _SHORT)


def _in_order(asked: _Asked, text: _Text) -> _Text | None:
    """The bytes of the acknowledgement put where they belong."""
    data = text.data
    start, end = data.find(codec.STX), data.rfind(codec.ETX)
    message = data[start : end + 1] if 0 <= start < end else b""
    around = data.replace(message, b"", 1) if message else data
    finals = [byte for byte in around if byte in (_XONS if message else _FINALS)]
    if len(around) != codec.SHORT_REPLY_BYTES or len(finals) != 1:
        return None
    ordered = _ACKNOWLEDGED + message + bytes(finals)
    if ordered == data or sorted(ordered) != sorted(data):
        return None
    expected = "Ack, Xoff, the answer, Xon" if message else "Ack, Xoff, Xon"
    told = ReplyDeparture(
        asked.form, "order", expected, _hex(around) if not message else _hex(data)
    )
    return _Text((*text.departures, told), ordered, ordered)


def _in_upper_case(asked: _Asked, text: _Text) -> _Text | None:
    if not any(byte in b"abcdef" for byte in text.data):
        return None
    told = ReplyDeparture("MACS-FRAME-04", "case", "digits 0-9 and A-F", _words(text.data[3:-2]))
    return _Text((*text.departures, told), text.data.upper(), text.data)


_Rewrite = Callable[[_Asked, _Text], _Text | None]
_REWRITES: Final[tuple[_Rewrite, ...]] = (
    _without_top_bits, _said_once, _alone, _without_separators, _in_order, _in_upper_case,
)  # fmt: skip


# --- reading --------------------------------------------------------------------------------------


def _as_reply(asked: _Asked, text: _Text, most: int) -> Lenient | None:
    """What the text can be taken for with so many departures at most."""
    short = _as_short(asked, text.data) or _as_cut(asked, text.data)
    if short is None or len(short.departures) > most:
        return _as_answer(asked, text, most)
    is_too_little = len(text.data) <= codec.SHORT_REPLY_BYTES and text.departures
    return None if is_too_little and short.departures else short


def _as_short(asked: _Asked, data: bytes) -> Lenient | None:
    """An acknowledgement or a refusal; it is no reply to a query that all modules answer."""
    kind = codec.parse(data).kind
    if kind not in (ReplyKind.ACCEPTED, ReplyKind.REFUSED, ReplyKind.NACK):
        return None if asked.is_query else _as_broken(asked, data)
    is_refused = kind is ReplyKind.REFUSED and not asked.is_plain
    if is_refused or not (asked.is_query or kind is ReplyKind.NACK):
        return Lenient((), data)
    return Lenient(
        (ReplyDeparture(asked.form, "form", asked.wanted, f"{_hex(data)} ({kind.value})"),), data
    )


def _as_broken(asked: _Asked, data: bytes) -> Lenient | None:
    """A short reply in which one byte is missing or another one; or whose Xoff and Xon somebody
    has taken for flow control."""
    final = data[-1:] if data[-1] in _FINALS else b""
    head = data.removesuffix(final)
    if data == bytes([codec.ACK]):  # who takes both has Xon where ASCII has it (MACS-AMB-01)
        return Lenient((_missing(asked, "Xoff"), _missing(asked, "Xon")), _ACKNOWLEDGED + b"\x11")
    if data == _ACKNOWLEDGED:
        return Lenient((_cut(asked, codec.SHORT_REPLY_BYTES, data),), b"")
    if head[:2] == _ACKNOWLEDGED and len(data) == codec.SHORT_REPLY_BYTES:
        told = ReplyDeparture(asked.form, "Xon", "1A, or 17 for a refusal", _hex(data[2:]))
        return Lenient((told,), b"")
    if not final:
        return None
    told_of_head = {
        b"\x13": _missing(asked, "acknowledgement"),
        b"\x06": _missing(asked, "Xoff"),
    }.get(head)
    if len(head) == len(_ACKNOWLEDGED) and head[1] == codec.XOFF:
        told_of_head = _wrong(asked, "acknowledgement", head[:1])
    elif len(head) == len(_ACKNOWLEDGED) and head[0] == codec.ACK:
        told_of_head = _wrong(asked, "Xoff", head[1:])
    return None if told_of_head is None else Lenient((told_of_head,), _ACKNOWLEDGED + final)


def _as_cut(asked: _Asked, data: bytes) -> Lenient | None:
    """The beginning of an answer, all of it as it should be."""
    if not asked.is_query or not len(_ACKNOWLEDGED) <= len(data) < codec.ANSWER_BYTES - 1:
        return None
    for length, digit in itertools.product(asked.lengths, asked.digits):
        filler = _answer(asked, length, digit, b"00000000", asked.xon)
        value = (data[9:17] + filler[9 + len(data[9:17]) :])[:8]
        if not set(value) <= _HEX:
            continue
        whole = _answer(asked, length, digit, value, asked.xon)
        if whole.startswith(data):  # nothing is handed on yet: two digits for one begin alike
            return Lenient((_cut(asked, len(whole), data),), b"")
    return None


def _as_answer(asked: _Asked, text: _Text, most: int) -> Lenient | None:
    """An answer read field by field, in which so many fields at most are wrong."""
    if not SHORTEST_ANSWER <= len(text.data) <= LONGEST_ANSWER:
        return None
    if text.data[-1] in _HEX or sum(byte in _HEX for byte in text.data) < LEAST_DIGITS:
        return None  # what ends among digits is only a beginning, seen once more for each byte
    found = list(_taken(_Split(asked, text), most))
    # A right sum is no chance; nor has a number more digits than eight, or a query no name.
    found.sort(key=lambda one: ("checksum" in one.wrong, one.is_unlikely))
    told = _told(found[0]) if found else None
    return told if told is not None and len(told.departures) <= most else None


@dataclass(frozen=True, slots=True)
class _Split:
    """An answer taken apart up to some field: its parts so far, and how many are wrong."""

    asked: _Asked
    text: _Text
    parts: tuple[bytes, ...] = ()
    at: int = 0
    wrong: tuple[str, ...] = ()

    def part(self, name: str) -> bytes:
        """One of the fields."""
        return self.parts[_NAMES.index(name)]

    @property
    def is_unlikely(self) -> bool:
        """True for mistakes that are made less often than others that look alike."""
        return len(self.part("data")) > 8 or not self.part("digit")

    def with_part(self, field: _Field, size: int) -> _Split:
        """The next field taken so long."""
        part = self.text.data[self.at : self.at + size]
        taken = replace(self, parts=(*self.parts, part), at=self.at + size)
        is_sound = field.is_sound(taken, part)
        return taken if is_sound else replace(taken, wrong=(*self.wrong, field.name))


@dataclass(frozen=True, slots=True)
class _Field:
    """A field of an answer: the sizes it may be taken for, the right one first; whether it is of
    digits; whether a part is what it should be."""

    name: str
    requirement: str
    sizes: tuple[int, ...]
    is_digits: bool
    is_sound: Callable[[_Split, bytes], bool]

    def fits(self, part: bytes) -> bool:
        """Whether a part can be this field at all."""
        if self.name == "checksum" and len(part) == 1:
            return True  # a byte instead of digits
        strange = [byte for byte in part if byte not in _HEX]
        if self.is_digits and len(part) == self.sizes[0] > 1:  # one of them may be none
            return not strange or (len(strange) == 1 and strange[0] not in _FRAMING)
        return not part or (not strange) is self.is_digits


def _is_right_sum(split: _Split, part: bytes) -> bool:
    return part in (codec.two_digits(codec.checksum(body)) for body in _bodies(split))


def _bodies(split: _Split) -> Iterable[bytes]:
    """What the sum may cover: what was sent, as it was spelt, and what should have been."""
    address, digit, data = (split.part(name) for name in ("address", "digit", "data"))
    size = len(address + digit + data)
    begin = sum(len(part) for part in split.parts[: _NAMES.index("address")])
    spelt = split.text.spelt[begin : begin + size]
    sound = digit if digit in split.asked.digits else split.asked.digits[0]
    mended = (split.asked.address if not _is_general(split.asked) else address) + sound
    return (address + digit + data, spelt, mended + data, mended + data[-8:].rjust(8, b"0"))


def _is_general(asked: _Asked) -> bool:
    return asked.address == b"FF"  # whose address the answer then has, is open (MACS-AMB-17)


_FIELDS: Final = (
    _Field("acknowledgement", "MACS-REPLY-07", (1, 0), False, lambda _, part: part == b"\x06"),
    _Field("Xoff", "MACS-REPLY-07", (1, 0), False, lambda _, part: part == b"\x13"),
    _Field("start byte", "MACS-REPLY-07", (1, 0), False, lambda _, part: part == b"\x02"),
    _Field(
        "length", "MACS-REPLY-10", (3, 4, 2, 1, 0), True,
        lambda one, part: part in one.asked.lengths,
    ),
    _Field(
        "address", "MACS-REPLY-08", (2, 3, 1, 4, 0), True,
        lambda one, part: part == one.asked.address or (len(part) == 2 and _is_general(one.asked)),
    ),
    _Field(
        "digit", "MACS-REPLY-09", (1, 2, 0), True, lambda one, part: part in one.asked.digits
    ),
    _Field(
        "data", "MACS-REPLY-07", (8, 7, 6, 5, 4, 3, 2, 1, 9, 10, 16), True,
        lambda _, part: len(part) == 8 and set(part) <= _HEX,
    ),
    _Field("checksum", "MACS-REPLY-07", (2, 3, 1, 4, 0), True, _is_right_sum),
    _Field("end byte", "MACS-REPLY-07", (1, 0), False, lambda _, part: part == b"\x03"),
    _Field("Xon", "MACS-REPLY-07", (1, 0), False, lambda _, part: part != b"" and part in _XONS),
)  # fmt: skip
_NAMES: Final = tuple(field.name for field in _FIELDS)
# How many bytes an answer has from each field on.
_RIGHT_SIZES: Final = [sum(one.sizes[0] for one in _FIELDS[at:]) for at in range(len(_FIELDS))]


def _taken(split: _Split, most: int) -> Iterator[_Split]:
    """The ways to take a text apart in which so many fields at most are wrong."""
    if len(split.parts) == len(_FIELDS):
        if split.at == len(split.text.data):
            yield split
        return
    number, left = len(split.parts), len(split.text.data) - split.at
    if abs(left - _RIGHT_SIZES[number]) > (most - len(split.wrong)) * MOST_TOO_LONG:
        return
    field = _FIELDS[number]
    for size in field.sizes:
        if split.at + size > len(split.text.data):
            continue
        if not field.fits(split.text.data[split.at : split.at + size]):
            continue
        taken = split.with_part(field, size)
        if len(taken.wrong) <= most:
            yield from _taken(taken, most)


def _told(split: _Split) -> Lenient:
    """What is wrong with an answer, in words, and the answer without that."""
    asked, departures = split.asked, []
    for field, part in zip(_FIELDS, split.parts, strict=True):
        if field.name in split.wrong:
            departures.append(_departure(split, field, part))
    data, digit, length = (split.part(name) for name in ("data", "digit", "length"))
    address, xon = split.part("address"), split.part("Xon")
    if asked.index == 0x25 and data[2:4] != b"00" and data[4:6] == b"00" and len(data) == 8:
        wanted = "rr 00 vvvv, the most significant digits first"
        departures.append(ReplyDeparture("MACS-FRAME-05", "byte order", wanted, _words(data)))
        data = b"".join(data[at : at + 2] for at in (6, 4, 2, 0))
    is_lost = "checksum" in split.wrong and not _has_its_place(split)
    is_lost |= not set(data) <= _HEX
    mended = _answer(
        asked if not _is_general(asked) else replace(asked, address=address),
        length if length in asked.lengths else asked.lengths[0],
        digit if digit in asked.digits else asked.digits[0],
        data[-8:].rjust(8, b"0"),
        xon if xon and xon in _XONS else asked.xon,
    )
    if not asked.is_query and asked.index not in QUERIES:
        told = ReplyDeparture(asked.form, "form", asked.wanted, "an answer, as to a query")
        return Lenient((*departures, told), _ACKNOWLEDGED + asked.xon)
    return Lenient(tuple(departures), b"" if is_lost else mended)


def _has_its_place(split: _Split) -> bool:
    """Whether the data are known to begin and end where they were taken to, under a wrong sum."""
    part, data = split.part("checksum"), split.part("data")
    if len(data) != 8 or not set(part) <= _HEX:
        return len(data) == 8
    value = int(part or b"0", 16) % 0x100
    return len(part) in (0, 2) or value in (codec.checksum(body) for body in _bodies(split))


def _answer(asked: _Asked, length: bytes, digit: bytes, data: bytes, xon: bytes) -> bytes:
    summed = asked.address + digit + data
    check = codec.two_digits(codec.checksum(summed))
    return codec.ANSWER_START + length + summed + check + bytes([codec.ETX]) + xon


# --- words ----------------------------------------------------------------------------------------


def _departure(split: _Split, field: _Field, part: bytes) -> ReplyDeparture:
    if not part:
        return _missing(split.asked, field.name)
    if field.name == "checksum":
        expected = codec.two_digits(codec.checksum(next(iter(_bodies(split)))))
        return ReplyDeparture(
            field.requirement, field.name, _words(expected), _sum_in_words(split, part)
        )
    expected_text = {
        "length": _words(split.asked.lengths[0]),
        "address": _words(split.asked.address),
        "digit": _words(split.asked.digits[0]),
        "data": "8 digits",
    }.get(field.name)
    if expected_text is None:
        return _wrong(split.asked, field.name, part)
    actual = f"{len(part)}: {_words(part)}" if field.name == "data" else _words(part)
    return ReplyDeparture(field.requirement, field.name, expected_text, actual)


_EXPECTED: Final = {
    "acknowledgement": "06", "Xoff": "13", "start byte": "02", "end byte": "03", "Xon": "1A",
}  # fmt: skip


def _wrong(asked: _Asked, name: str, came: bytes) -> ReplyDeparture:
    return ReplyDeparture(asked.form, name, _EXPECTED[name], _hex(came))


def _missing(asked: _Asked, name: str) -> ReplyDeparture:
    """A field that is not there; Xoff and Xon may have been taken for flow control."""
    requirement = next(field.requirement for field in _FIELDS if field.name == name)
    if name in ("Xoff", "Xon"):
        requirement = "MACS-LINE-02"
    elif name in _EXPECTED:
        requirement = asked.form
    return ReplyDeparture(requirement, name, _EXPECTED.get(name, f"the field {name}"), "nothing")


def _cut(asked: _Asked, whole: int, came: bytes) -> ReplyDeparture:
    return ReplyDeparture(
        asked.form, COMPLETENESS, f"{whole} bytes", f"the first {len(came)}: {_hex(came)}"
    )


def _sum_in_words(split: _Split, part: bytes) -> str:
    """The sum that came, and what it covers instead, if that is one of the usual mistakes."""
    parts = dict(zip(_NAMES, split.parts, strict=False))
    body = parts["address"] + parts["digit"] + parts["data"]
    right, start, end = codec.checksum(body), parts["start byte"], bytes([codec.ETX])
    exclusive = 0
    for byte in body:
        exclusive ^= byte
    covers: dict[str, int] = {
        "of the length field too": codec.checksum(parts["length"] + body),
        "from Stx on": codec.checksum(start + parts["length"] + body),
        "from Stx on, with Etx": codec.checksum(start + parts["length"] + body + end),
        "of Etx too": codec.checksum(body + end),
        "without the address": codec.checksum(parts["digit"] + parts["data"]),
        "of the data only": codec.checksum(parts["data"]),
        **_sum_of_values(body),
        "negated": -right % 0x100,
        "inverted": ~right % 0x100,
        "of seven bits": right & 0x7F,
        "as an exclusive or": exclusive,
    }
    told = _words(part)
    for words, value in covers.items():
        if part == codec.two_digits(value):
            return f"{told}, {words}"
    if part == codec.two_digits(right)[::-1]:
        return f"{told}, its digits the other way round"
    if part == bytes([right]):
        return f"{told}, the byte itself"
    return told


def _sum_of_values(body: bytes) -> dict[str, int]:
    """None of a body that holds anything but digits."""
    if not set(body) <= _HEX:
        return {}
    return {"of the values, not the characters": sum(int(b"%c" % one, 16) for one in body) % 0x100}


def _hex(data: bytes) -> str:
    return data.hex(" ").upper()


def _words(data: bytes) -> str:
    """Printable characters as they are, everything else as hex bytes."""
    return data.decode("ascii") if data and all(0x20 < byte < 0x7F for byte in data) else _hex(data)
