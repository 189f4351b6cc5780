"""Exchanges with one module on the bus: requests, replies, and when the module can have taken a
request over.

Indices are the suite's (see `codec`): 00h to 1Fh are downloads, 20h to 2Fh the uploads 00h to 0Fh,
so that what knows the axis talks to it here as on the serial line.

A reply belongs to a request by the identifier it comes from, and by the index, the sub-index and
the direction it names.  What comes from there and names something else is waited past; only if
nothing better comes is it handed on as garbage, with what is wrong with it.  Boot-up, lifebeat and
emergency are never replies (`CanTarget.receive`).

When a request was taken over (`Exchange.taken`): not before its frame can have been on the bus, not
after the reply was in our hands.  Where the bit rate is known the shortest times of both frames
narrow that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.can_frame import Frame
from axistwin_conformance.can_target import Arrival, CanTarget
from axistwin_conformance.mac_axis.forecast import Window
from axistwin_conformance.mac_can import codec
from axistwin_conformance.mac_can.codec import Kind, Reply, Request
from axistwin_conformance.session import ATTEMPTS, Session

QUIET_S: Final = 0.05  # silence is proven by the next exchange, not by it
BOOT_S: Final = 2.0  # MACC-BOOT-04
BOOT_PATIENCE_S: Final = 1.0  # how much longer than that a boot-up message is waited for
# What a module may be told twice and does the same, with the same reply: uploads, settings except
# the counter reset, the end of a motion and of powering.  A second 2013h is refused and a second
# segment runs; both leave the check in doubt about the first.
REPEATABLE: Final = frozenset(
    {*codec.QUERIES, 0x02, 0x03, 0x07, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x18, 0x19, 0x1A, 0x1C,
     *codec.UNASSIGNED_DOWNLOADS}
)  # fmt: skip
MAY_BE_SILENT: Final = frozenset({0x00, 0x01})  # MACC-AMB-26

Part = str | tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request, its reply, and the window in which the module took the request over."""

    request: Frame
    reply: Reply
    taken: Window

    @property
    def kind(self) -> Kind:
        """What the module said."""
        return self.reply.kind


@dataclass(frozen=True, slots=True)
class Sample:
    """A counter reading and the window in which the module took it."""

    position: int
    taken: Window


def bus_of(session: Session) -> CanTarget:
    """The bus a session is on."""
    assert isinstance(session.carrier, CanTarget), "a MAC on CAN is judged on a CAN bus"
    return session.carrier


class Talk:
    """One module on the bus: what is said to it, what it says, and what that proves."""

    def __init__(self, session: Session, address: int | None = None) -> None:
        self.session = session
        self.target = bus_of(session)
        self.address = session.address if address is None else address

    # --- requests and replies ---------------------------------------------------------------------

    @property
    def byte_order(self) -> str:
        """The order of bytes this module has shown (MACC-AMB-01)."""
        return self.session.readings.get("can_byte_order", "big")

    @property
    def general_reply_identifier(self) -> int:
        """Where module 1 answers what all are told (MACC-AMB-03)."""
        return int(self.session.readings.get("general_reply_id", "581h")[:-1], 16)

    def request(
        self, index: int, parameter: int = 0, sub_index: int = 0, address: int | None = None
    ) -> Request:
        """A well-formed request to this module, or to that address (0: to all)."""
        whom = self.address if address is None else address
        return codec.request(whom, index, parameter, sub_index, self.byte_order)

    def send(self, one: Request, timeout_s: float | None = None) -> Exchange:
        """Send a request, take the reply apart.  Where frames get lost, what may be said twice is
        said again until noise is not the reason for the reply."""
        exchange = self._once(one, timeout_s)
        if self.target.is_lossless or not one.is_well_formed:
            return exchange
        return self._undisturbed(one, exchange, timeout_s)

    def _undisturbed(self, one: Request, exchange: Exchange, timeout_s: float | None) -> Exchange:
        bad: list[bytes] = []
        since_ns: int | None = None  # the first sending that may have been obeyed
        for _ in range(ATTEMPTS):
            is_good = self._is_good(one, exchange.reply, may_be_silent=timeout_s is not None)
            if self.session.is_believed(bad, exchange.reply.raw, is_good=is_good):
                break
            words = f"{codec.explain(exchange.request)}: {exchange.reply}"
            if one.index not in REPEATABLE:
                if self.session.check is not None:
                    self.session.disturbed(words)
                break
            since_ns = exchange.taken.earliest_ns if since_ns is None else since_ns
            self.session.record_retry(words)
            exchange = self._once(one, timeout_s)
        if since_ns is None or one.index in codec.QUERIES:
            return exchange
        return replace(exchange, taken=Window(since_ns, exchange.taken.latest_ns))

    @staticmethod
    def _is_good(one: Request, reply: Reply, *, may_be_silent: bool) -> bool:
        """True if a module could say that, as far as is known of this one."""
        if reply.kind is Kind.SILENCE:
            return may_be_silent or one.index in MAY_BE_SILENT
        if one.index in codec.ANSWERED:
            return reply.kind is Kind.ANSWER
        return reply.kind is not Kind.GARBAGE

    def _once(self, one: Request, timeout_s: float | None) -> Exchange:
        self.target.drain()
        frame = one.frame()
        sent_ns = self.target.send(frame)
        arrival = self._reply_to(one, timeout_s)
        if arrival is None:
            return Exchange(frame, codec.SILENCE, Window(sent_ns, self.target.now_ns))
        flaw = codec.mismatch(one, arrival.frame)
        reply = codec.parse(arrival.frame, self.byte_order)
        if flaw:
            reply = replace(reply, kind=Kind.GARBAGE, flaws=(*reply.flaws, flaw))
        return Exchange(frame, reply, self._window(frame, sent_ns, reply, arrival.time_ns))

    def _reply_to(self, one: Request, timeout_s: float | None) -> Arrival | None:
        """The reply, or else what came from where it had to come from."""
        whence = codec.REPLY + one.address
        if one.address == codec.GENERAL_ADDRESS:
            whence = self.general_reply_identifier

        def comes_from_there(frame: Frame) -> bool:
            return frame.identifier == whence and frame.is_plain

        def is_reply(frame: Frame) -> bool:
            return comes_from_there(frame) and not codec.mismatch(one, frame)

        limit_s = self.session.reply_timeout_s if timeout_s is None else timeout_s
        return self.target.receive(is_reply, limit_s) or self.target.receive(comes_from_there, 0)

    def _window(self, request: Frame, sent_ns: int, reply: Reply, done_ns: int) -> Window:
        """When the module can have taken over a request."""
        earliest = sent_ns + self.target.least_time_ns(request)
        latest = done_ns
        # A motion may count from the end of the reply (MACS-AMB-41): within the window.
        if reply.kind is not Kind.ACCEPTED and reply.frame is not None:
            latest -= self.target.least_time_ns(reply.frame)
        return Window(sent_ns, done_ns) if latest < earliest else Window(earliest, latest)

    def command(self, index: int, parameter: int = 0, sub_index: int = 0) -> Exchange:
        """Send a request of that index."""
        return self.send(self.request(index, parameter, sub_index))

    def ask(self, index: int, sub_index: int = 0) -> Exchange:
        """Send an upload request."""
        return self.command(index, 0, sub_index)

    def to_all(self, index: int, parameter: int = 0, timeout_s: float | None = None) -> Exchange:
        """Send a request on 600h and wait for who answers for all (MACC-GEN-02)."""
        return self.send(self.request(index, parameter, address=codec.GENERAL_ADDRESS), timeout_s)

    def say(self, frame: Frame) -> Window:
        """Send a frame that is not answered; return when the modules can have heard it.

        An upload behind it bounds that: the bus has one order, and what a host sends later has no
        better identifier than the frames this is for (SYNC, general).
        """
        sent_ns = self.target.send(frame)
        behind = self.ask(0x20)
        return Window(sent_ns + self.target.least_time_ns(frame), behind.taken.latest_ns)

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

    def wait_awake(self) -> Arrival | None:
        """Wait for the boot-up message after a reset; where none comes, long enough without it."""
        return self.boot_up(BOOT_S + BOOT_PATIENCE_S + self.target.uncertainty_ns / 1e9)

    # --- values -----------------------------------------------------------------------------------

    def value(self, index: int, sub_index: int = 0) -> int:
        """The 32-bit number an upload answers; no answer fails the check."""
        exchange = self.ask(index, sub_index)
        if exchange.reply.data is None:
            expected = f"an answer to upload {0x2000 + index - 0x20:04X}h"
            self.session.fail(None, expected, exchange.reply)
        return exchange.reply.data

    def data_bytes(self, index: int, sub_index: int = 0) -> tuple[int, int, int, int]:
        """The four bytes an upload answers, first byte first."""
        first, second, third, fourth = self.value(index, sub_index).to_bytes(4, "big")
        return first, second, third, fourth

    def sample(self) -> Sample:
        """Read the counter, with the window in which it was read."""
        exchange = self.ask(0x20)
        if exchange.reply.data is None:
            self.session.fail(None, "an answer to upload 2000h", exchange.reply)
        return Sample(codec.signed(exchange.reply.data), exchange.taken)

    def position(self) -> int:
        """Read the counter."""
        return self.sample().position

    def is_busy(self) -> bool:
        """The inverted bit 3 of 2007h byte 3 (MACC-Q-07-01)."""
        return not self.data_bytes(0x27)[2] & 0x08

    def stopped_on(self) -> int:
        """The byte ff of 2001h: which stops ended the motion."""
        return self.data_bytes(0x21)[1] & 0x0F

    # --- judging ----------------------------------------------------------------------------------

    def must(self, kind: Kind, exchange: Exchange, requirement: Part = None) -> Exchange:
        """Judge that the reply is of that kind.

        Without a requirement it is a step on the way: a wrong reply fails all the check names, but
        a right one proves none of them when there are several.
        """
        self._judge(
            exchange.kind is kind,
            requirement,
            f"{kind.value} ({codec.explain(exchange.request)})",
            exchange.reply,
        )
        return exchange

    def _judge(self, condition: bool, requirement: Part, expected: str, actual: object) -> None:
        """Judge a requirement; without one, in a check that names several, it is a step."""
        check = self.session.check
        if requirement is None and check is not None and len(check.requirements) > 1:
            self.session.step(condition, expected, actual)
        else:
            self.session.expect(condition, requirement, expected, actual)

    def accepted(
        self, index: int, parameter: int = 0, sub_index: int = 0, requirement: Part = None
    ) -> Exchange:
        """Send a download that must be accepted."""
        return self.must(Kind.ACCEPTED, self.command(index, parameter, sub_index), requirement)

    def refused(
        self, index: int, parameter: int = 0, sub_index: int = 0, requirement: Part = None
    ) -> Exchange:
        """Send a request that must be refused."""
        return self.must(Kind.REFUSED, self.command(index, parameter, sub_index), requirement)

    def silent(self, frame: Frame, requirement: Part = None) -> None:
        """Judge that a frame gets no reply of any kind, and that the module is still there."""
        self.target.drain()
        self.target.send(frame)
        heard = self.target.receive(codec.is_reply, QUIET_S + self.target.uncertainty_ns / 1e9)
        actual = "silence" if heard is None else codec.explain(heard.frame)
        self._judge(heard is None, requirement, f"silence after {codec.explain(frame)}", actual)
        self.alive(requirement)

    def alive(self, requirement: Part = None) -> None:
        """Judge that the module answers a good upload request, once."""
        exchange = self.ask(0x20)
        self.must(Kind.ANSWER, exchange, requirement)
