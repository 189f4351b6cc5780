"""Exchanges with one module on the bus: requests, replies, and when the module can have taken a
request over.

Indices are the suite's (see `codec`): 00h to 1Fh are downloads, 20h to 2Fh the uploads 00h to 0Fh,
so that what knows the axis talks to it here as on the serial line.

A reply belongs to a request by the identifier it comes from, and by the index, the sub-index and
the direction it names.  What comes from there and names something else is waited past; only if
nothing better comes is it handed on as garbage, with what is wrong with it.  Boot-up, lifebeat and
emergency are never replies (`CanTransport.receive`).

When a request was taken over (`AxisExchange.taken`): not before its frame can have been on the bus,
not after the reply was in our hands.  Where the bit rate is known the shortest times of both frames
narrow that.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Final

from axistwin_conformance.base.events import Note
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, WAITED, Observation
from axistwin_conformance.families.mac.axis.driver.client import (
    AxisClient,
    AxisExchange,
    AxisFace,
    quiet_s,
)
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.codec import MAY_BE_SILENT, CanReply, CanRequest
from axistwin_conformance.families.mac.can.diagnosis import is_unasked_start
from axistwin_conformance.transport.can import Arrival, CanTransport
from axistwin_conformance.transport.can_frame import Frame, unpack

# Uploads, settings except the counter reset, the end of a motion and of powering.
REPEATABLE: Final = frozenset(
    {*codec.QUERIES, 0x02, 0x03, 0x07, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x18, 0x19, 0x1A, 0x1C,
     *codec.UNASSIGNED_DOWNLOADS}
)  # fmt: skip
RESTARTED_BY: Final = "a start at power-up, after 2000h or after the address procedure only"


def bus_of(session: Session) -> CanTransport:
    """The bus a session is on."""
    assert isinstance(session.transport, CanTransport), "a MAC on CAN is judged on a CAN bus"
    return session.transport


class CanClient(AxisClient):
    """One module on the bus: what is sent to it, and what it answers."""

    face: ClassVar[AxisFace] = AxisFace(
        answered=codec.ANSWERED,
        may_be_silent=MAY_BE_SILENT,
        repeatable=REPEATABLE,
        signs={ReplyKind.ACCEPTED: "60h", ReplyKind.REFUSED: "80h"},
        unassigned=(  # MACC-AMB-15
            (ReplyKind.REFUSED, ReplyKind.REFUSED),
            (ReplyKind.ACCEPTED, ReplyKind.ANSWER),
            (ReplyKind.SILENCE, ReplyKind.SILENCE),
        ),
        missing=(0x08, 0x1B, 0x28, 0x29),  # address, rate, memory
        has_sync=True,  # another way than 11h to start what is preloaded
        faults=0x71,  # those of the MAC34 are none here (§5.1)
    )

    def __init__(self, session: Session, address: int | None = None) -> None:
        super().__init__(session, address)
        self.target: CanTransport = bus_of(session)

    # --- requests and replies ---------------------------------------------------------------------

    @property
    def byte_order(self) -> str:
        """The order of bytes this module has shown (MACC-AMB-01)."""
        return self.session.readings.get("can_byte_order", "big")

    @property
    def _general_reply_identifier(self) -> int:
        """Where module 1 answers what all are told (MACC-AMB-03)."""
        return int(self.session.readings.get("general_reply_id", "581h")[:-1], 16)

    def request(
        self, index: int, parameter: int = 0, sub_index: int = 0, address: int | None = None
    ) -> CanRequest:
        """A well-formed request to this module, or to that address (0: to all)."""
        whom = self.address if address is None else address
        return codec.request(whom, index, parameter, sub_index, self.byte_order)

    def send(self, request: CanRequest, timeout_s: float | None = None) -> AxisExchange:
        """Send a request, take the reply apart.  Where frames get lost, what may be said twice is
        said again until noise is not the reason for the reply."""
        exchange = self._once(request, timeout_s)
        if self.target.is_lossless or not request.is_well_formed:
            return exchange
        settled = self._undisturbed(request, request.index, exchange, timeout_s)
        self._judge_passing(request, exchange, settled)
        return settled

    def _judge_passing(
        self, request: CanRequest, first: AxisExchange, settled: AxisExchange
    ) -> None:
        """Hold a reply against the module that was wrong for once, and right when asked for again:
        frames get lost, but what a bus carries is as it was sent."""
        if first is settled or not settled.reply.raw or settled.kind is ReplyKind.GARBAGE:
            return
        alone = codec.parse(unpack(first.reply.raw) if first.reply.raw else None, self.byte_order)
        if alone.kind is ReplyKind.GARBAGE:
            requirement = "MACC-SDO-03" if request.command == codec.UPLOAD else "MACC-SDO-01"
            actual = f"now and then {'; '.join(alone.flaws)}"
            self.session.run.violations.append((requirement, "the same form each time", actual))

    def _is_good(self, index: int, reply: CanReply, *, may_be_silent: bool) -> bool:
        if reply.kind is ReplyKind.SILENCE:
            return may_be_silent or index in MAY_BE_SILENT
        if index in codec.ANSWERED:
            return reply.kind is ReplyKind.ANSWER
        return reply.kind is not ReplyKind.GARBAGE

    def _once(self, request: CanRequest, timeout_s: float | None) -> AxisExchange:
        self.target.drain()
        if self.target.unjudged:
            self._judge_unasked()
        frame = request.frame()
        sent_ns = self.target.send(frame)
        arrival = self._reply_to(request, timeout_s)
        if arrival is None:
            return AxisExchange(
                frame.pack(), codec.SILENCE, TimeWindow(sent_ns, self.target.now_ns)
            )
        self.target.note_exchange(frame, sent_ns, arrival.time_ns)
        flaw = codec.mismatch(request, arrival.frame)
        reply = codec.parse(arrival.frame, self.byte_order)
        if flaw:
            reply = replace(reply, kind=ReplyKind.GARBAGE, flaws=(*reply.flaws, flaw))
        self._count_writes(reply.kind, is_general=request.address == codec.GENERAL_ADDRESS)
        is_late = request.index in MAY_BE_SILENT  # obeyed when the reply has left (MACC-CMD-00-02)
        begun = None if is_late else reply.frame
        return AxisExchange(
            frame.pack(), reply, self._window(frame, sent_ns, begun, arrival.time_ns)
        )

    def _judge_unasked(self) -> None:
        """Hold it against a module that it starts anew by itself; where its supply may have been
        cut for a moment, once is no fault of its own."""
        run, said = self.session.run, self.target.unjudged
        own = {self.session.address, *self.session.neighbours}
        for arrival in said:
            is_ours = codec.spontaneous_from(arrival.frame) in own
            if not is_ours or not is_unasked_start(arrival, reversed(self.target.transcript)):
                continue
            run.unasked_starts += 1
            came = f"{codec.explain(arrival.frame)}, and nothing had made it start anew"
            if self.target.is_lossless or run.unasked_starts > 1:
                run.violations.append(("MACC-BOOT-01", RESTARTED_BY, came))
            else:
                run.emit(Note(f"{came}; was its supply cut for a moment?"))
        said.clear()

    def _reply_to(self, request: CanRequest, timeout_s: float | None) -> Arrival | None:
        """The reply, or else what came from where it had to come from."""
        whence = codec.REPLY + request.address
        if request.address == codec.GENERAL_ADDRESS:
            whence = self._general_reply_identifier

        def comes_from_there(frame: Frame) -> bool:
            return frame.identifier == whence and frame.is_plain

        def is_reply(frame: Frame) -> bool:
            return comes_from_there(frame) and not codec.mismatch(request, frame)

        limit_s = (
            self.session.reply_timeout_s if timeout_s is None else timeout_s + self.target.line_s
        )
        return self.target.receive(is_reply, limit_s) or self.target.receive(comes_from_there, 0)

    def _window(
        self, request: Frame, sent_ns: int, begun: Frame | None, done_ns: int
    ) -> TimeWindow:
        """When the module can have taken a request over: at its end, before that reply began."""
        earliest = sent_ns + self.target.least_time_ns(request)
        latest = done_ns if begun is None else done_ns - self.target.least_time_ns(begun)
        return TimeWindow(sent_ns, done_ns) if latest < earliest else TimeWindow(earliest, latest)

    def to_all(self, index: int, parameter: int = 0) -> CanRequest:
        """A well-formed request on 600h (MACC-GEN-01)."""
        return self.request(index, parameter, address=codec.GENERAL_ADDRESS)

    def corrupted(
        self, index: int, parameter: int, how: int
    ) -> tuple[CanRequest, ReplyKind] | None:
        """A request whose frame is too short, which is ignored (MACC-SDO-11); None where this
        device pads such frames (MACC-AMB-19)."""
        if self.session.reading("short_frame") != "ignore":
            return None
        return replace(self.request(index, parameter), length=how % 8), ReplyKind.SILENCE

    def swift(
        self, index: int, parameter: int, timeout_s: float, is_cleared: bool
    ) -> tuple[bytes, bytes, TimeWindow]:
        """See `AxisClient.swift`."""
        exchange = self.send(self.request(index, parameter), timeout_s)
        return exchange.request, exchange.reply.raw, exchange.taken

    @property
    def frame_ns(self) -> int:
        """The least time a request takes on the bus."""
        return self.target.least_time_ns(self.request(0x20).frame())

    @property
    def glance_ns(self) -> int:
        """How long before an instant a query must be sent so that the counter is read before it:
        two frames of the greatest length there is."""
        return 3 * self.frame_ns

    @property
    def imax(self) -> int:
        """The highest torque limit (MACC-CMD-0C-01)."""
        return codec.IMAX

    def is_answer(self, index: int, reply: CanReply, *, in_any_reading: bool = False) -> bool:
        """True if a reply is an answer; that it belongs to its request is seen to already."""
        return reply.kind is ReplyKind.ANSWER

    def unasked(self) -> str:
        """What has arrived without being asked for, but for what modules say unasked."""
        return "; ".join(codec.explain(arrival.frame) for arrival in self.target.drain())

    @staticmethod
    def kind_of(received: bytes) -> ReplyKind:
        """What kind of reply this frame is."""
        return codec.parse(unpack(received) if received else None).kind

    def data_of(self, received: bytes) -> int | None:
        """The number in an answer."""
        return self._parsed(received).data

    def _parsed(self, received: bytes) -> CanReply:
        return codec.parse(unpack(received) if received else None, self.byte_order)

    @staticmethod
    def named(index: int) -> str:
        """What a command or a query is called."""
        service = "upload" if index in codec.QUERIES else "download"
        return f"{service} 20{index & 0x1F if index < 0x20 else index & 0x0F:02X}h"

    @staticmethod
    def explained(sent: bytes) -> str:
        """A request in words."""
        return codec.explain(unpack(sent))

    def described(self, received: bytes) -> str:
        """A reply in words."""
        return str(self._parsed(received))

    def broadcast(self, frame: Frame) -> TimeWindow:
        """Send a frame that is not answered; return when the modules can have heard it.

        An upload behind it bounds that: the bus has one order, and what a host sends later has no
        better identifier than the frames this is for (SYNC, general).
        """
        earliest_ns = self.target.send(frame) + self.target.least_time_ns(frame)
        behind = self.ask(0x20).taken.latest_ns - self.frame_ns
        return TimeWindow(earliest_ns, max(earliest_ns, behind))

    def synchronise(self) -> AxisExchange:
        """Send SYNC, which does what 11h does (MACC-SYNC-03) and is not answered."""
        frame = Frame(codec.SYNC)
        return AxisExchange(frame.pack(), codec.SILENCE, self.broadcast(frame))

    # --- what a module says unasked ---------------------------------------------------------------

    def boot_up(self, timeout_s: float, address: int | None = None) -> Arrival | None:
        """Wait for the boot-up message, in any of its forms (MACC-AMB-04); None without one."""
        whom = self.address if address is None else address

        def is_boot_up(frame: Frame) -> bool:
            return codec.spontaneous_from(frame) == whom and codec.boot_up_form(frame) is not None

        return self.target.receive_spontaneous(is_boot_up, timeout_s)

    def emergency(self, timeout_s: float) -> Arrival | None:
        """Wait for an emergency or lifebeat message; None without one."""

        def is_ours(frame: Frame) -> bool:
            return codec.spontaneous_from(frame) == self.address and codec.is_emergency(frame)

        return self.target.receive_spontaneous(is_ours, timeout_s)

    def silence_after(self, request: CanRequest | Frame) -> tuple[bool, str, Observation]:
        """See `AxisClient.silence_after`; a reply of any kind, to whomever, counts."""
        frame = request if isinstance(request, Frame) else request.frame()
        self.target.drain()
        self.target.send(frame)
        reply = self.target.receive(codec.is_reply, quiet_s(self.target))
        actual = "silence" if reply is None else codec.explain(reply.frame)
        did = f"got no reply{WAITED}" if reply is None else f"was answered with {actual}"
        seen = Observation(f"{REQUEST} {did}", actual, request=frame.pack(), is_whole=False)
        return reply is None, self.wanted(ReplyKind.SILENCE), seen
