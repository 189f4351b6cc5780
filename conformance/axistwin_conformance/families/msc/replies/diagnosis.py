"""What a unit breaks by a reply that no MSC gives, whoever asked: the engine's own questions, the
probes, what is remembered and put back.

Judged is only what every reading of the manual leaves out, and only for sound requests to the unit
under test, at addresses and flags that every device must have an answer for or a NAK.
"""

from __future__ import annotations

from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, NAK, Packet
from axistwin_conformance.families.msc.replies.lenient import SIZE_ROW

ALWAYS_SERVED = ("RQSTAT",)  # what no state, address or flag lets a unit refuse, but MSC-AMB-32


def diagnose(session: Session, request: bytes, reply: bytes | None) -> Violation | None:
    """Which requirement a reply to these bytes breaks, if it is one that no unit gives.

    `reply` None: there was none, the twin had crashed.
    """
    if request in (ACK, NAK) and reply is not None:
        request, reply = _before_the_sign(session)
    question = codec.parse(request)
    if question is None or not question.is_request or question.unit != session.address:
        return None
    awaited = "ACK" if question.name in codec.WRITES else f"ACK and a {question.name} packet"
    if reply is None:
        return Violation("MSC-LNK-01", awaited, "the twin crashed")
    came = codec.explain(reply) or "nothing"
    if reply[:1] == NAK and question.name not in ALWAYS_SERVED:
        return None
    if reply[:1] != ACK:
        return Violation("MSC-LNK-01", awaited, came)
    if question.name in codec.WRITES:
        return None  # what may follow is left open (MSC-AMB-36)
    if question.name == "RFLAGS" and not session.run.model.facts.has_rflags:
        return None
    answer = codec.parse(reply[1:])
    if answer is None:
        return Violation("MSC-CMD-05", awaited, came)
    return _judged(session, question, answer, came)


def _before_the_sign(session: Session) -> tuple[bytes, bytes]:
    """The last packet we have sent, and what came before we acknowledged or refused it."""
    request, reply, is_over = b"", b"", False
    for record in session.records():
        if record.direction is Direction.HOST and record.data in (ACK, NAK):
            is_over = True
        elif record.direction is Direction.HOST:
            request, reply, is_over = record.data, b"", False
        elif record.direction is Direction.DEVICE and not is_over:
            reply += record.data
    return request, reply


def _judged(session: Session, question: Packet, answer: Packet, came: str) -> Violation | None:
    """What is wrong with a reply, the most telling first."""
    size = codec.REPLY_BYTES[question.name]
    sizes = (size, size - 2) if question.name == "RQSTAT" else (size,)  # MSC-AMB-38
    right = codec.checksum(answer.raw[1:-2])
    if answer.length != len(answer.body):
        return Violation("MSC-PKT-06", f"length {len(answer.body)}", came)
    if answer.checksum != right:
        return Violation("MSC-PKT-12", f"checksum {right:04X}", came)
    if answer.unit != question.unit:
        return Violation("MSC-PKT-18", f"unit {question.unit}", came)
    if answer.name != question.name or codec.COMMA not in answer.body:
        return Violation("MSC-CMD-04", f"the name {question.name} and a comma", came)
    if len(answer.raw) not in sizes:
        return Violation(f"MSC-{question.name}-{SIZE_ROW[question.name]}", f"{size} bytes", came)
    if question.name == "RFLAG" and answer.numbers[0] not in (0, 1):
        return Violation("MSC-RFLAG-02", "0 or 1", came)
    return None
