"""Exchanges with one module: requests, replies, and when the module can have taken a request over.

Every exchange says when that was (`AxisExchange.taken`): not before the request's last byte has
left us, not after its reply began.  That needs no assumption about latencies, so the same
arithmetic holds in virtual time, over a pty and over a real adapter.
"""

from __future__ import annotations

from typing import ClassVar, Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.base.transcript import Direction
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import (
    QUIET_S,
    AxisClient,
    AxisExchange,
    AxisFace,
)
from axistwin_conformance.families.mac.axis.exchanges import QUERIES, ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import SerialReply, SerialRequest
from axistwin_conformance.transport.serial import SerialTransport

ANSWERED: Final = range(0x20, 0x2A)
# The queries, every setting but the counter reset, the end of a motion and of powering (§4.2).
REPEATABLE: Final = frozenset(
    {*QUERIES, 0x02, 0x03, 0x07, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x18, 0x19, 0x1A, 0x1C,
     0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F}
)  # fmt: skip
NACK_BY_ALL: Final = "any"
NACK_BYTES: Final = 1
MAY_BE_SILENT: Final = frozenset({0x00, 0x01, 0x08, 0x1B})  # MACS-AMB-20, §6
OTHER_DIGITS: Final = {0x21: 2, 0x23: 2}  # MACS-AMB-03, -04
MOST_GARBAGE: Final = 2 * codec.ANSWER_BYTES  # who says more, babbles
GLANCE_BYTES: Final = codec.REQUEST_BYTES + 12  # a query, and the reply as far as its data
REPLIED: Final = frozenset({ReplyKind.ANSWER, ReplyKind.ACCEPTED, ReplyKind.REFUSED})


def _is_general(data: bytes) -> bool:
    return data[4:6].upper() == b"%02X" % codec.GENERAL_ADDRESS


class SerialClient(AxisClient):
    """One module on the line: what is sent to it, and what it answers."""

    face: ClassVar[AxisFace] = AxisFace(
        answered=ANSWERED,
        may_be_silent=MAY_BE_SILENT,
        repeatable=REPEATABLE,
        deaf="MACS-CMD-00-02",
        signs={
            ReplyKind.ACCEPTED: "06 13 1A",
            ReplyKind.REFUSED: "06 13 17",
            ReplyKind.NACK: "15h",
        },
        unassigned=(  # MACS-AMB-58
            (ReplyKind.REFUSED, ReplyKind.REFUSED),
            (ReplyKind.ACCEPTED, ReplyKind.ACCEPTED),
            (ReplyKind.ACCEPTED, ReplyKind.ANSWER),
            (ReplyKind.SILENCE, ReplyKind.SILENCE),
        ),
    )

    def __init__(self, session: Session, address: int | None = None) -> None:
        super().__init__(session, address)
        self.target: SerialTransport = session.target
        self._noted: set[int] = set()  # last bytes of replies whose spelling is noted

    def send(self, frame: SerialRequest | bytes, timeout_s: float | None = None) -> AxisExchange:
        """Send bytes, take the reply apart.  A Nack that noise provoked is answered by sending
        again: a module does nothing with a frame it Nacks (MACS-REPLY-04)."""
        data = frame if isinstance(frame, bytes) else frame.encode()
        is_all_said = self.session.run.replied_at == self.target.transcript.position
        exchange = self._once(data, timeout_s)
        if (
            self.target.is_lossless
            or not isinstance(frame, SerialRequest)
            or not frame.is_well_formed
        ):
            return exchange
        settled = self._undisturbed(data, int(frame.index, 16), exchange, timeout_s)
        if settled is not exchange:
            self._judge_passing(exchange.reply, is_all_said=is_all_said)
        return settled

    def _judge_passing(self, reply: SerialReply, *, is_all_said: bool) -> None:
        """Hold replies against the module that were no answers, or those to something else, and
        others when asked for again, if their sums are right oftener than noise gets them right.

        `is_all_said`: no reply was due from before; else this one may just be late.
        """
        if reply.kind is ReplyKind.GARBAGE and codec.is_summed(reply.raw):
            name, flaws = "MACS-REPLY-07", "; ".join(reply.flaws)
        elif reply.kind is ReplyKind.ANSWER and is_all_said:
            is_own = reply.address == self.address
            name = "MACS-REPLY-09" if is_own else "MACS-REPLY-08"
            flaws = f"an answer of {reply.address:02X}h, digit {reply.digit:X}, to something else"
        else:
            return
        if self.session.run.quality.is_meant(codec.SUMS):
            actual = f"now and then {flaws}, with the right sum"
            self.session.run.violations.append((name, "the same form each time", actual))

    def _is_good(self, index: int, reply: SerialReply, *, may_be_silent: bool) -> bool:
        """True if a module could say that, as far as is known of this one."""
        if reply.kind is ReplyKind.SILENCE:
            return may_be_silent or index in MAY_BE_SILENT
        seen = self.session.readings
        spelling, error = reply.xon_spelling, reply.xonerror_spelling
        if spelling != seen.get("xon_byte", spelling) and spelling is not None:
            return False
        if error != seen.get("xonerror_byte", error) and error is not None:
            return False
        if index in ANSWERED:
            return reply.kind is ReplyKind.ANSWER and self._may_answer(index, reply)
        return reply.kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED, ReplyKind.ANSWER)

    def _may_answer(self, index: int, reply: SerialReply) -> bool:
        """True for the answer of any module of the line to that query, in any reading."""
        whoever = {self.address, self.session.address, *self.session.neighbours, 0x00}
        digits = {index & 0xF, OTHER_DIGITS.get(index)}
        return reply.address in {*whoever, codec.GENERAL_ADDRESS} and reply.digit in digits

    def _once(self, data: bytes, timeout_s: float | None) -> AxisExchange:
        self._judge_unasked()
        sent_ns = self.target.send(data)
        limit_s = self._limit_s(timeout_s)
        received = self._whole(b"", limit_s)
        self.target.note_exchange(data, len(received), sent_ns)
        taken = self._window(sent_ns, len(data), len(received), self.target.now_ns)
        reply = codec.parse(received)
        if reply.kind is ReplyKind.GARBAGE and not self.target.is_lossless:
            # The rest of it is no reply to the next frame.
            reply = codec.parse(received + self.target.receive(MOST_GARBAGE, QUIET_S))
        self._note_spelling(reply)
        self._count_writes(reply.kind, is_general=_is_general(data))
        self._note_whole(data, reply)
        return AxisExchange(data, reply, taken)

    def _judge_unasked(self) -> None:
        """Set aside what has come since the last reply.  Where that was whole, to a frame that one
        module alone replies to, and nothing gets lost, nobody had asked for it (MACS-REPLY-12).

        Elsewhere it may be the reply to something else: to what was cut off, or came late or twice.
        """
        run, surplus = self.session.run, self.target.drain()
        if not surplus or not self.target.is_lossless or run.replied_at < 0:
            return
        since = self.target.transcript.since(run.replied_at)
        if not any(record.direction is Direction.HOST for record in since):
            came = surplus.hex(" ").upper()
            run.violations.append(("MACS-REPLY-12", "nothing until it is asked", came))

    def _note_whole(self, data: bytes, reply: SerialReply) -> None:
        """Take note that this module, and none beside it, has said all that it was asked for."""
        is_mended = self.target.mender is not None  # then what is left over belongs to a reply
        is_own = data[4:6] == codec.two_digits(self.address)
        if reply.kind in REPLIED and reply.final is not None and is_own and not is_mended:
            self.session.run.replied_at = self.target.transcript.position

    def _limit_s(self, timeout_s: float | None) -> float:
        """How long to listen where the module may take so long; the line's own time is added."""
        return self.session.reply_timeout_s if timeout_s is None else timeout_s + self.target.line_s

    def exchange(
        self, data: bytes, size: int, timeout_s: float, is_cleared: bool = False
    ) -> tuple[bytes, TimeWindow]:
        """What `send` does, at a fraction of its cost, where the target allows it
        (`SerialTransport.is_direct`): the reply as it came, and when the request was taken over.

        `size`: of the reply if all goes well; `is_cleared`: see `SerialTransport.exchange`.
        """
        sent_ns, received, done_ns = self.target.exchange(data, size, timeout_s, is_cleared)
        if received and received[-1] not in self._noted:
            if len(received) >= size and codec.missing_bytes(received):  # an answer to no query
                received, done_ns = self._whole(received, timeout_s), self.target.now_ns
            reply = codec.parse(received)
            if reply.final is not None:
                self._noted.add(reply.final)
                self._note_spelling(reply)
        if self.session.run.budget.pending:
            self._count_writes(codec.parse(received).kind, is_general=_is_general(data))
        return received, self._window(sent_ns, len(data), len(received), done_ns)

    def _whole(self, received: bytes, timeout_s: float) -> bytes:
        """The rest of a reply that is longer than the usual one, behind its beginning."""
        while (count := codec.missing_bytes(received)) > 0:
            arrived = self.target.receive(count, timeout_s)
            if not arrived:
                break
            received += arrived
        return received

    def in_vain(self, request: SerialRequest | bytes) -> AxisExchange:
        """See `AxisClient.in_vain`; a Nack at most is expected, where nothing disturbs."""
        if not self.target.is_direct:
            return super().in_vain(request)
        data = request if isinstance(request, bytes) else request.encode()
        received, taken = self.exchange(data, NACK_BYTES, self._limit_s(QUIET_S))
        return AxisExchange(data, codec.parse(received), taken)

    def _window(self, sent_ns: int, sent: int, received: int, done_ns: int) -> TimeWindow:
        """When the module can have taken over a request of `sent` bytes."""
        byte_ns = self.target.byte_ns
        earliest, latest = sent_ns + sent * byte_ns, done_ns - received * byte_ns
        if latest < earliest:  # a line on which bytes take no time
            return TimeWindow(sent_ns, done_ns)
        # A motion may count from the end of the reply (MACS-AMB-41): within the window.
        return TimeWindow(earliest, done_ns if received == codec.SHORT_REPLY_BYTES else latest)

    def _note_spelling(self, reply: SerialReply) -> None:
        """Remember how this device spells Xon and Xonerror; a check of its own judges it.  Noise
        can turn one spelling into the other, so there it takes some that agree."""
        for switch, seen in (
            ("xon_byte", reply.xon_spelling),
            ("xonerror_byte", reply.xonerror_spelling),
        ):
            if seen is None or switch in self.session.readings:
                continue
            if not self.target.is_lossless:
                votes = self.session.run.quality.votes
                votes[switch, seen] += 1
                if votes[switch, seen] < RETRY.alike:
                    continue
            self.session.run.readings.setdefault(switch, seen)

    def request(
        self, index: int, parameter: int = 0, sub_index: int = 0, address: int | None = None
    ) -> SerialRequest:
        """A well-formed request to this module."""
        whom = self.address if address is None else address
        return codec.request(whom, index, parameter, sub_index)

    def to_all(self, index: int, parameter: int = 0) -> SerialRequest:
        """A well-formed request to FF (MACS-MULTI-02)."""
        return codec.request(codec.GENERAL_ADDRESS, index, parameter)

    def corrupted(
        self, index: int, parameter: int, how: int
    ) -> tuple[SerialRequest, ReplyKind] | None:
        """A request under a wrong checksum, which is Nacked (MACS-REPLY-02)."""
        if self.is_nacked_by_many:  # all at once: neither reply nor the next frame would be heard
            return None
        request = self.request(index, parameter)
        return request.with_wrong_checksum(how % 0xFF + 1), ReplyKind.NACK

    def nacked_alone(self, request: SerialRequest) -> list[SerialRequest]:
        """The frame under a wrong checksum, where only the module it is for could Nack it."""
        return [] if self.is_nacked_by_many else [request.with_wrong_checksum()]

    @property
    def is_nacked_by_many(self) -> bool:
        """True where every module on this line Nacks every wrong checksum (MACS-AMB-19)."""
        return bool(self.session.neighbours) and self.session.reading("nack_scope") == NACK_BY_ALL

    def swift(
        self, index: int, parameter: int, timeout_s: float, is_cleared: bool
    ) -> tuple[bytes, bytes, TimeWindow]:
        """See `AxisClient.swift`."""
        data = codec.frame(self.address, index, parameter)
        size = codec.ANSWER_BYTES if index in ANSWERED else codec.SHORT_REPLY_BYTES
        received, taken = self.exchange(data, size, timeout_s, is_cleared)
        return data, received, taken

    @property
    def frame_ns(self) -> int:
        """The time a request takes on the line."""
        return codec.REQUEST_BYTES * self.target.byte_ns

    @property
    def glance_ns(self) -> int:
        """How long before an instant a query must be sent so that the counter is read before it."""
        return GLANCE_BYTES * self.target.byte_ns

    @property
    def imax(self) -> int:
        """The byte at AFh of the RAM (MACS-Q-28-01)."""
        return self.data_bytes(0x28, codec.IMAX_ADDRESS)[0]

    def is_answer(self, index: int, reply: SerialReply, *, in_any_reading: bool = False) -> bool:
        """True if a reply says that it answers that query (MACS-REPLY-09)."""
        if in_any_reading:
            digits = (index & 0xF, OTHER_DIGITS.get(index))
            return reply.address == self.address and reply.digit in digits
        return reply.digit == index & 0xF

    def unasked(self) -> str:
        """What has arrived without being asked for, as hex."""
        return self.target.drain().hex(" ")

    @staticmethod
    def kind_of(received: bytes) -> ReplyKind:
        """What kind of reply these bytes are."""
        return codec.parse(received).kind

    def data_of(self, received: bytes) -> int | None:
        """The number in an answer."""
        return codec.answer_data(received)

    @staticmethod
    def named(index: int) -> str:
        """What a command or a query is called."""
        return f"query {index:02X}h" if index in QUERIES else f"{index:02X}h"

    @staticmethod
    def explained(sent: bytes) -> str:
        """A request in words."""
        return codec.explain(sent)

    def described(self, received: bytes) -> str:
        """A reply in words."""
        return str(codec.parse(received))

    def _command(self, index: int, parameter: int, sub_index: int) -> AxisExchange:
        if sub_index or index in MAY_BE_SILENT or not self.target.is_direct:
            return super()._command(index, parameter, sub_index)
        self._judge_unasked()
        data = codec.frame(self.address, index, parameter)
        size = codec.ANSWER_BYTES if index in ANSWERED else codec.SHORT_REPLY_BYTES
        received, taken = self.exchange(data, size, self.session.reply_timeout_s)
        reply = codec.parse(received)
        self._note_whole(data, reply)
        return AxisExchange(data, reply, taken)
