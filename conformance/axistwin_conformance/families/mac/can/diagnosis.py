"""What a module breaks by a reply that no module gives, whoever asked: the engine's own questions,
the probes, what is remembered and put back.

Judged is only what every reading of the manual leaves out.  A request that is not well-formed, not
for a module on this bus, or of an index whose reply is open, may be answered by anything; silence
is nobody's fault once something was sent that makes a module deaf.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Violation
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import RIG
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import MAY_BE_SILENT, CanRequest
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame, unpack_all

# After frames of these identifiers some reading admits silence: network management, LMT.
DEAFENING: Final = frozenset({codec.NMT, codec.LMT_REQUEST})
ANSWERS: Final = frozenset(bytes([one]) for one in codec.ANSWER_SPELLINGS)
PUT_OFF_NS: Final = 8_000_000_000  # by which a module may put off what makes it start anew
# Whose requirement it is that a frame is survived, by its identifier.
SURVIVED: Final = {
    codec.NMT: "MACC-BOOT-04",
    codec.SYNC: "MACC-SYNC-01",
    codec.LMT_REQUEST: "MACC-LMT-01",
}


def diagnose(session: Session, request: bytes, reply: bytes | None) -> Violation | None:
    """Which requirement a reply to these frames breaks, if it is one that no module gives.

    `reply` None: there was none, the twin had crashed.
    """
    frames = unpack_all(request)
    if not frames:
        return None
    asked = request_of(frames[-1])
    if reply is None:
        return _crashed(frames[-1], asked)
    if asked is None or not _is_promised(session, asked):
        return None
    received = tuple(frame for frame in unpack_all(reply) if codec.is_reply(frame))
    if not received and _may_be_deaf(session, asked):
        return None
    return _judge(asked, received)


def is_unasked_start(boot_up: Arrival, before: Iterable[Record]) -> bool:
    """True for a boot-up message that nothing explains: since anything may have made the module
    start anew it has answered, longer ago than it may put that off.

    `before`: what happened up to it and later, the latest first.  What may have made it start anew:
    2000h and 2001h, any frame that is no sound request, whoever sent it, and any act of a rig.
    """
    address, has_answered = codec.spontaneous_from(boot_up.frame), False
    if codec.boot_up_form(boot_up.frame) is None:
        return False
    for record in before:
        if record.time_ns >= boot_up.time_ns:
            continue
        if has_answered and record.time_ns < boot_up.time_ns - PUT_OFF_NS:
            return True
        if record.direction is Direction.NOTE and record.text.startswith(RIG):
            return False
        for frame in unpack_all(record.data):
            if record.direction is Direction.DEVICE and codec.is_reply(frame):
                is_own = frame.identifier - codec.REPLY == address
                has_answered |= is_own and frame.data[:1] in ANSWERS
            elif not codec.is_spontaneous(frame) and _may_restart(frame):
                return False
    return False


def _may_restart(frame: Frame) -> bool:
    return request_of(frame) is None or _deafens(frame)


def request_of(frame: Frame) -> CanRequest | None:
    """The request a frame carries, well-formed and of an index that the manual has; or None."""
    if not frame.is_plain or len(frame.data) != codec.TRANSFER_BYTES:
        return None
    address = frame.identifier - codec.REQUEST
    if address != codec.GENERAL_ADDRESS and address not in codec.ADDRESSES:
        return None
    command, low, high, sub_index = frame.data[:4]
    request = CanRequest(address, command, low, frame.data[4:], sub_index, high)
    is_known = request.is_well_formed and (
        low in codec.DOWNLOADS if command == codec.DOWNLOAD else request.index in codec.ANSWERED
    )
    return request if is_known else None


def _is_promised(session: Session, request: CanRequest) -> bool:
    """True for a request that a module on this bus must answer in a known way."""
    return request.address in (session.address, *session.neighbours)


def _crashed(frame: Frame, asked: CanRequest | None) -> Violation:
    """Nobody need answer everything, but nobody may fall over anything."""
    if asked is not None:
        return _promised(asked, "the twin crashed")
    requirement = SURVIVED.get(frame.identifier, "MACC-SDO-12")
    if not frame.is_plain:
        requirement = "MACC-ID-03"
    return Violation(requirement, f"{codec.explain(frame)}, survived", "the twin crashed")


def _promised(request: CanRequest, came: str) -> Violation:
    words = codec.explain(request.frame())
    if request.command == codec.UPLOAD:
        return Violation("MACC-SDO-03", f"an answer, {words}", came)
    return Violation("MACC-SDO-01", f"60h or 80h, {words}", came)


def _may_be_deaf(session: Session, asked: CanRequest) -> bool:
    """True if something was sent here after which a module may say nothing for a while."""
    if asked.command == codec.DOWNLOAD and asked.index_low in MAY_BE_SILENT:
        return True
    sent = (record.data for record in session.records() if record.direction is Direction.HOST)
    return any(_deafens(frame) for data in sent for frame in unpack_all(data))


def _deafens(frame: Frame) -> bool:
    request = request_of(frame)
    is_reset = (
        request is not None and request.command == codec.DOWNLOAD and request.index in MAY_BE_SILENT
    )
    return is_reset or frame.identifier in DEAFENING


def _judge(asked: CanRequest, received: tuple[Frame, ...]) -> Violation | None:
    described = "; ".join(codec.explain(frame) for frame in received) or "silence"
    own = [reply for reply in received if reply.identifier == codec.REPLY + asked.address]
    if received and not own:
        return Violation(
            "MACC-ID-01", f"the reply on {codec.REPLY + asked.address:03X}h", described
        )
    if len(own) > 1:
        return Violation("MACC-SDO-06", f"one reply, {codec.explain(asked.frame())}", described)
    if not own or codec.mismatch(asked, own[0]):
        return _promised(asked, described)
    kind = codec.parse(own[0]).kind
    if asked.command == codec.DOWNLOAD:
        is_good = kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED)
    else:  # with a sub-index an upload may be refused (MACC-AMB-16)
        is_good = kind is ReplyKind.ANSWER or (kind is ReplyKind.REFUSED and asked.sub_index > 0)
    return None if is_good else _promised(asked, described)
