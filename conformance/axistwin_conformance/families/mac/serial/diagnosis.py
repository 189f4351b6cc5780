"""What a module breaks by a reply that no module gives, whoever asked: the engine's own questions,
the probes, what is remembered and put back.

Judged is only what every reading of the manual leaves out.  A frame that is not well-formed, not
for a module on this line, or of an index whose reply is open, may be answered by anything; silence
is nobody's fault once something was sent that makes a module deaf.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES, ReplyKind
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.client import ANSWERED, MAY_BE_SILENT, OTHER_DIGITS
from axistwin_conformance.families.mac.serial.codec import SerialReply

PLAIN: Final = b"00" + b"00000000"  # sub-index and parameter nobody can object to
MOVES: Final = (0x13, 0x14)
LATE_TIMES: Final = 3  # a host that is held up may be once, at whatever it asks
OBEYED: Final = frozenset(COMMAND_NAMES)
LONG_LENGTH: Final = (0x28, b"014")  # MACS-AMB-05


def diagnose(session: Session, request: bytes, reply: bytes | None) -> Violation | None:
    """Which requirement a reply to these bytes breaks, if it is one that no module gives.

    `reply` None: there was none, the twin had crashed.
    """
    # Nobody need answer a general frame, but nobody may fall over one.
    also = (codec.GENERAL_ADDRESS,) if reply is None else ()
    index = _asked(session, request, *also)
    if index is None:
        return None
    if reply is None:
        return _promised(index, "the twin crashed")
    seen = codec.parse(reply)
    if seen.kind is ReplyKind.SILENCE and _may_be_deaf(session):
        return None
    judge = _judge_answer if index in ANSWERED else _judge_short
    return judge(request, index, seen)


def _asked(session: Session, request: bytes, *also: int) -> int | None:
    """The index of a frame that a module on this line must answer in a known way, or None.

    `also`: addresses beside those of the modules.
    """
    if len(request) != codec.REQUEST_BYTES or request[:4] != b"\x02014" or request[20] != codec.ETX:
        return None
    summed = request[4:18]
    if not set(summed) <= set(b"0123456789ABCDEF"):
        return None
    address, index = int(summed[:2], 16), int(summed[2:4], 16)
    is_whole = request[18:20] == codec.two_digits(codec.checksum(summed))
    is_ours = address in (session.address, *session.neighbours, *also)
    is_known = index in ANSWERED or index in OBEYED
    return index if is_whole and is_ours and is_known else None


def acknowledged_late(session: Session) -> Violation | None:
    """What a module has broken that is lost now, and before that acknowledged moves, and nothing
    else, so late that the host had asked something else by then: when they were over."""
    late_s, others = list[float](), 0
    asked: tuple[int, int] | None = None  # index and time of the request sent last, if it has one
    overdue: tuple[int, int] | None = None  # the same of one that was silent when the next followed
    heard = b""
    for record in session.target.transcript:
        if record.direction is Direction.HOST:
            is_answered = asked is not None and asked[0] in ANSWERED and heard
            overdue = None if is_answered else overdue or (None if heard else asked)
            index = _asked(session, record.data)
            asked, heard = (None if index is None else (index, record.time_ns)), b""
        elif record.direction is Direction.DEVICE and overdue is not None:
            heard += record.data
            if asked is not None and _is_of_another(asked[0], heard):
                others += overdue[0] not in MOVES
                late_s.append((record.time_ns - overdue[1]) / 1e9)
                overdue = None
        elif record.direction is Direction.DEVICE:
            heard += record.data
    if len(late_s) < LATE_TIMES or others:
        return None
    return Violation(
        "MACS-REPLY-14",
        "06 13 1A as soon as a move is taken over",
        f"{len(late_s)} moves were acknowledged so late that other requests had followed, up to"
        f" {max(late_s):.2f} s; then nothing came while another move went on",
    )


def _is_of_another(index: int, heard: bytes) -> bool:
    """True if what was heard since this request begins with the reply to one before it."""
    size = codec.ANSWER_BYTES if index in ANSWERED else codec.SHORT_REPLY_BYTES
    is_short = codec.parse(heard[: codec.SHORT_REPLY_BYTES]).kind is ReplyKind.ACCEPTED
    return len(heard) > size or (index in ANSWERED and is_short)


def _promised(index: int, came: str) -> Violation:
    if index in ANSWERED:
        return Violation("MACS-REPLY-07", f"an answer to query {index:02X}h", came)
    return Violation("MACS-REPLY-01", f"06 13 1A or 06 13 17 to {index:02X}h", came)


def _may_be_deaf(session: Session) -> bool:
    """True if something was sent here after which a module may say nothing for a while."""
    sent = (record.data for record in session.records() if record.direction is Direction.HOST)
    return any(_asked(session, data) in MAY_BE_SILENT for data in sent)


def _judge_short(request: bytes, index: int, seen: SerialReply) -> Violation | None:
    is_open = index in MAY_BE_SILENT and seen.kind is ReplyKind.SILENCE
    if is_open or seen.kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED):
        return None
    return _promised(index, str(seen))


def _judge_answer(request: bytes, index: int, seen: SerialReply) -> Violation | None:
    if seen.kind is ReplyKind.REFUSED and request[8:18] != PLAIN:  # MACS-AMB-62 and the like
        return None
    if seen.kind is not ReplyKind.ANSWER:
        return _promised(index, str(seen))
    query = int(request[4:6], 16)
    if seen.address != query:
        return Violation("MACS-REPLY-08", f"address {query:02X} in the answer", str(seen))
    if seen.digit not in (index & 0xF, OTHER_DIGITS.get(index)):
        return Violation("MACS-REPLY-09", f"digit {index & 0xF} in the answer", str(seen))
    if seen.length != b"011" and (index, seen.length) != LONG_LENGTH:
        return Violation("MACS-REPLY-10", "length field 011", str(seen))
    return None
