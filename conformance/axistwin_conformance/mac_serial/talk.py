"""Exchanges with one module: requests, replies, and when the module can have taken a request over.

Every exchange tells when that was (`Exchange.taken`): not before the request's last byte has left
us, not after its reply began.  That needs no assumption about latencies, so the same arithmetic
holds in virtual time, over a pty and over a real adapter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from axistwin_conformance.mac_serial import codec
from axistwin_conformance.mac_serial.codec import Kind, Reply, Request
from axistwin_conformance.mac_serial.forecast import Window
from axistwin_conformance.session import ATTEMPTS, Session

QUIET_S: Final = 0.05  # ten times any reply seen; silence is proven by the next exchange, not by it
SPELLINGS_ALIKE: Final = 3
QUERIES: Final = range(0x20, 0x30)
ANSWERED: Final = range(0x20, 0x2A)
# What a module may be told twice and does the same, with the same reply: the queries, every setting
# but the counter reset, the end of a motion and of powering (§4.2).  A second 13h is refused and a
# second segment runs; both leave the check in doubt about the first.
REPEATABLE: Final = frozenset(
    {*QUERIES, 0x02, 0x03, 0x07, 0x09, 0x0A, 0x0C, 0x0D, 0x0E, 0x0F, 0x18, 0x19, 0x1A, 0x1C,
     0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F}
)  # fmt: skip
MAY_BE_SILENT: Final = frozenset({0x00, 0x01, 0x08, 0x1B})  # MACS-AMB-20, §6

Part = str | tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request, its reply, and the window in which the module took the request over."""

    request: bytes
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


class Talk:
    """One module on the line: what is said to it, what it says, and what that proves."""

    def __init__(self, session: Session, address: int | None = None) -> None:
        self.session = session
        self.target = session.target
        self.address = session.address if address is None else address
        self._noted: set[int] = set()  # last bytes of replies whose spelling is noted

    @property
    def byte_ns(self) -> int:
        """The time a byte takes on the line."""
        return self.target.byte_ns

    def send(self, frame: Request | bytes, timeout_s: float | None = None) -> Exchange:
        """Send bytes, take the reply apart.  A Nack that noise provoked is answered by sending
        again: a module does nothing with a frame it Nacks (MACS-REPLY-04)."""
        data = frame if isinstance(frame, bytes) else frame.encode()
        exchange = self._once(data, timeout_s)
        if self.target.is_lossless or not isinstance(frame, Request) or not frame.is_well_formed:
            return exchange
        return self._undisturbed(data, int(frame.index, 16), exchange, timeout_s)

    def _undisturbed(
        self, data: bytes, index: int, exchange: Exchange, timeout_s: float | None
    ) -> Exchange:
        """Send again until noise is not the reason for the reply; only what may be sent twice."""
        bad: list[bytes] = []
        since_ns: int | None = None  # the first sending that may have been obeyed
        for _ in range(ATTEMPTS):
            if self._is_good(index, exchange.reply, may_be_silent=timeout_s is not None):
                self.session.is_believed(bad, exchange.reply.raw, is_good=True)
                break
            if self.session.is_believed(bad, exchange.reply.raw, is_good=False):
                break
            words = f"{codec.explain(data)}: {exchange.reply}"
            if exchange.kind is not Kind.NACK:
                if index not in REPEATABLE and self.session.check is not None:
                    self.session.disturbed(words)
                if index not in REPEATABLE:
                    break
                since_ns = exchange.taken.earliest_ns if since_ns is None else since_ns
            self.session.record_retry(words)
            exchange = self._once(data, timeout_s)
        if since_ns is None or index in QUERIES:
            return exchange
        return replace(exchange, taken=Window(since_ns, exchange.taken.latest_ns))

    def _is_good(self, index: int, reply: Reply, *, may_be_silent: bool) -> bool:
        """True if a module could say that, as far as is known of this one."""
        if reply.kind is Kind.SILENCE:
            return may_be_silent or index in MAY_BE_SILENT
        seen = self.session.readings
        spelling, error = reply.xon_spelling, reply.xonerror_spelling
        if spelling != seen.get("xon_byte", spelling) and spelling is not None:
            return False
        if error != seen.get("xonerror_byte", error) and error is not None:
            return False
        if index in ANSWERED:
            return reply.kind is Kind.ANSWER
        return reply.kind in (Kind.ACCEPTED, Kind.REFUSED, Kind.ANSWER)

    def _once(self, data: bytes, timeout_s: float | None) -> Exchange:
        self.target.drain()
        sent_ns = self.target.send(data)
        limit_s = self.session.reply_timeout_s if timeout_s is None else timeout_s
        received = b""
        while (count := codec.missing_bytes(received)) > 0:
            arrived = self.target.receive(count, limit_s)
            if not arrived:
                break
            received += arrived
        taken = self._window(sent_ns, len(data), len(received), self.target.now_ns)
        reply = codec.parse(received)
        self._note_spelling(reply)
        return Exchange(data, reply, taken)

    def exchange(
        self, data: bytes, size: int, timeout_s: float, is_cleared: bool = False
    ) -> tuple[bytes, Window]:
        """What `send` does, at a fraction of its cost, where the target allows it
        (`Target.is_direct`): the reply as it came, and when the request was taken over.

        `size`: of the reply if all goes well; `is_cleared`: see `Target.exchange`.
        """
        sent_ns, received, done_ns = self.target.exchange(data, size, timeout_s, is_cleared)
        if received and received[-1] not in self._noted:
            reply = codec.parse(received)
            if reply.final is not None:
                self._noted.add(reply.final)
                self._note_spelling(reply)
        return received, self._window(sent_ns, len(data), len(received), done_ns)

    def _window(self, sent_ns: int, sent: int, received: int, done_ns: int) -> Window:
        """When the module can have taken over a request of `sent` bytes."""
        byte_ns = self.target.byte_ns
        earliest, latest = sent_ns + sent * byte_ns, done_ns - received * byte_ns
        if latest < earliest:  # a line on which bytes take no time
            return Window(sent_ns, done_ns)
        # A motion may count from the end of the reply (MACS-AMB-41): within the window.
        return Window(earliest, done_ns if received == codec.SHORT_REPLY_BYTES else latest)

    def _note_spelling(self, reply: Reply) -> None:
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
                if votes[switch, seen] < SPELLINGS_ALIKE:
                    continue
            self.session.run.readings.setdefault(switch, seen)

    def frame(
        self, index: int, parameter: int = 0, sub_index: int = 0, address: int | None = None
    ) -> Request:
        """A well-formed request to this module."""
        whom = self.address if address is None else address
        return codec.request(whom, index, parameter, sub_index)

    def command(self, index: int, parameter: int = 0, sub_index: int = 0) -> Exchange:
        """Send a command."""
        if sub_index or index in MAY_BE_SILENT or not self.target.is_direct:
            return self.send(self.frame(index, parameter, sub_index))
        self.target.drain()
        data = codec.frame(self.address, index, parameter)
        size = codec.ANSWER_BYTES if index in ANSWERED else codec.SHORT_REPLY_BYTES
        received, taken = self.exchange(data, size, self.session.reply_timeout_s)
        return Exchange(data, codec.parse(received), taken)

    def ask(self, index: int, sub_index: int = 0) -> Exchange:
        """Send a query."""
        return self.command(index, 0, sub_index)

    def value(self, index: int, sub_index: int = 0) -> int:
        """The 32-bit number a query answers; no answer fails the check."""
        exchange = self.ask(index, sub_index)
        if exchange.reply.data is None:
            self.session.fail(None, f"an answer to query {index:02X}h", exchange.reply)
        return exchange.reply.data

    def data_bytes(self, index: int, sub_index: int = 0) -> tuple[int, int, int, int]:
        """The four bytes a query answers, first byte first."""
        first, second, third, fourth = self.value(index, sub_index).to_bytes(4, "big")
        return first, second, third, fourth

    def sample(self) -> Sample:
        """Read the counter, with the window in which it was read."""
        exchange = self.ask(0x20)
        if exchange.reply.data is None:
            self.session.fail(None, "an answer to query 20h", exchange.reply)
        return Sample(codec.signed(exchange.reply.data), exchange.taken)

    def position(self) -> int:
        """Read the counter."""
        return self.sample().position

    def is_busy(self) -> bool:
        """The inverted bit 3 of 27h byte 3 (MACS-Q-27-03)."""
        return not self.data_bytes(0x27)[2] & 0x08

    def stopped_on(self) -> int:
        """The byte ff of 21h: which stops ended the motion."""
        return self.data_bytes(0x21)[1] & 0x0F

    # --- judging ---------------------------------------------------------------------------------

    def must(self, kind: Kind, exchange: Exchange, requirement: Part = None) -> Exchange:
        """Judge that the reply is of that kind.

        Without a requirement it is a step on the way: a wrong reply fails all the check names, but
        a right one proves none of them when there are several.
        """
        self._judge(
            exchange.kind is kind,
            requirement,
            f"{kind.value} to {codec.explain(exchange.request)}",
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
        """Send a command that must be accepted."""
        return self.must(Kind.ACCEPTED, self.command(index, parameter, sub_index), requirement)

    def refused(
        self, index: int, parameter: int = 0, sub_index: int = 0, requirement: Part = None
    ) -> Exchange:
        """Send a command that must be refused."""
        return self.must(Kind.REFUSED, self.command(index, parameter, sub_index), requirement)

    def silent(self, frame: Request | bytes, requirement: Part = None) -> None:
        """Judge that a frame gets no reply: none now, and exactly one to the next query."""
        exchange = self.send(frame, QUIET_S + self.target.uncertainty_ns / 1e9)
        self.must(Kind.SILENCE, exchange, requirement)
        self.alive(requirement)

    def alive(self, requirement: Part = None) -> None:
        """Judge that the module answers a good query, once."""
        exchange = self.ask(0x20)
        self.must(Kind.ANSWER, exchange, requirement)
