"""Exchanges with one module, whichever way it is talked to.

A face says how a request looks and how a reply is fetched (`AxisClient`'s abstract part); what a
value means is the same for all.  Every exchange says when the module can have taken the request
over (`AxisExchange.taken`): the same arithmetic then holds in virtual time, over a pty, on a bus
and over a real adapter.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Final, Protocol

from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, WAITED, Observation
from axistwin_conformance.families.mac.axis.exchanges import QUERIES, AxisReply, ReplyKind, signed
from axistwin_conformance.families.mac.axis.model.acceptance import AcceptanceRow, table_without
from axistwin_conformance.families.mac.axis.model.forecast import TimeWindow
from axistwin_conformance.families.mac.axis.parameters import PARAMETERS, READ_ORDER, values_of
from axistwin_conformance.transport.transport import Transport

QUIET_S: Final = 0.05  # ten times any reply seen; silence is proven by the next exchange, not by it
LONGEST_WAIT_S: Final = 10_000  # twice what the longest way of a check takes at the slowest speed
SHORT_REPLY_BYTES: Final = 3  # of a serial line; longer ones are no acknowledgement
STOPS: Final = (0x18, 0x17, 0x1A, 0x00)  # maximum braking, the ramp, no power, the start-up state
LOOK_S: Final = 0.1  # the slowest catch-up takes two increments in that time
SWING: Final = 1  # increments: standby (MACS-CMD-02-03)
CAREFUL: Final = frozenset({0x0B, 0x13, 0x14, 0x18})  # commands that need `Precautions`

Part = str | tuple[str, ...] | None


@dataclass(frozen=True, slots=True)
class AxisExchange:
    """One request as it was sent, its reply, and when the module took the request over."""

    request: bytes
    reply: Any  # `SerialReply` or `CanReply`
    taken: TimeWindow

    @property
    def kind(self) -> ReplyKind:
        """What kind of reply it is."""
        kind: ReplyKind = self.reply.kind
        return kind


@dataclass(frozen=True, slots=True)
class Sample:
    """A counter reading and the window in which the module took it."""

    position: int
    taken: TimeWindow


@dataclass(frozen=True, slots=True)
class AxisFace:
    """What one face of the module answers, and how.

    `answered`: the queries it answers; `may_be_silent`: the commands it may obey without a reply.
    `repeatable`: what it may be sent twice and does the same, with the same reply; after anything
    else the check is in doubt about the first (a second 13h is refused, a second segment runs).
    `missing`: commands and queries that other faces have and this one does not.  `unassigned`: what
    comes to a command and to a query that mean nothing, for each reading of `unknown_index`.
    `signs`: how acceptance and refusal look on the wire.  `has_sync`: there is a way to
    `synchronise`.  `faults`: the bits of dd of 21h with a meaning.  `deaf`: the requirement that a
    module answers nothing after 00h, if there is one.
    """

    answered: range
    may_be_silent: frozenset[int]
    repeatable: frozenset[int]
    unassigned: tuple[tuple[ReplyKind, ReplyKind], ...]
    signs: Mapping[ReplyKind, str]
    missing: tuple[int, ...] = ()
    has_sync: bool = False
    faults: int = 0x7F
    deaf: str = ""

    @property
    def acceptance(self) -> Mapping[int, AcceptanceRow]:
        """The acceptance table of this face."""
        return table_without(self.missing)


class Precautions(Protocol):
    """What has to be done about some commands beside sending them."""

    def before(self, index: int, /) -> None:
        """Called before one of `CAREFUL` is sent; may raise to hold it back."""

    def after(self, index: int, kind: ReplyKind, /) -> None:
        """Called when the reply has come."""


def quiet_s(target: Transport) -> float:
    """How long nothing must come until it counts as silence, this way."""
    return QUIET_S + target.uncertainty_ns / 1e9


class AxisClient(ABC):
    """One module: what is sent to it, and what it answers."""

    face: ClassVar[AxisFace]

    def __init__(self, session: Session, address: int | None = None) -> None:
        self.session = session
        self.target: Transport = session.transport
        self.address = session.address if address is None else address
        self.precautions: Precautions | None = None

    # --- what a face brings -----------------------------------------------------------------------

    @abstractmethod
    def request(
        self, index: int, parameter: int = 0, sub_index: int = 0, address: int | None = None
    ) -> Any:
        """A well-formed request to this module, or to that address."""

    @abstractmethod
    def to_all(self, index: int, parameter: int = 0) -> Any:
        """A well-formed request to all modules."""

    @abstractmethod
    def corrupted(self, index: int, parameter: int, how: int) -> tuple[Any, ReplyKind] | None:
        """A request that must not be obeyed, one of several (`how`), and the reply it gets; None
        where there is none whose reply could be told from others."""

    @abstractmethod
    def send(self, request: Any, timeout_s: float | None = None) -> AxisExchange:
        """Send a request and take the reply apart; where noise is possible, again if need be."""

    @abstractmethod
    def swift(
        self, index: int, parameter: int, timeout_s: float, is_cleared: bool
    ) -> tuple[bytes, bytes, TimeWindow]:
        """What `send` does by the shortest way there is: the request, the reply, and when the
        request was taken over.  Where `Transport.is_direct` only, not for what may be silent."""

    @property
    @abstractmethod
    def frame_ns(self) -> int:
        """The time a request takes on its way; 0 where that is not known."""

    @property
    @abstractmethod
    def glance_ns(self) -> int:
        """How long before an instant a query must be sent so that the counter is read before it."""

    @property
    @abstractmethod
    def imax(self) -> int:
        """The highest torque limit of this module (MACS-CMD-0C-01)."""

    @abstractmethod
    def is_answer(self, index: int, reply: Any, *, in_any_reading: bool = False) -> bool:
        """True if a reply says that it answers that query of this module; `in_any_reading`: also
        in a way that only another reading of the manual admits."""

    @abstractmethod
    def unasked(self) -> str:
        """What has arrived without being asked for, in words; empty if nothing has."""

    @staticmethod
    @abstractmethod
    def kind_of(received: bytes) -> ReplyKind:
        """What kind of reply these bytes are."""

    @abstractmethod
    def data_of(self, received: bytes) -> int | None:
        """The number in an answer; None for what is none."""

    @staticmethod
    @abstractmethod
    def named(index: int) -> str:
        """What a command or a query is called on this face."""

    @staticmethod
    @abstractmethod
    def explained(sent: bytes) -> str:
        """A request in words."""

    @abstractmethod
    def described(self, received: bytes) -> str:
        """A reply in words."""

    def synchronise(self) -> AxisExchange | None:
        """Do what 11h does, to all modules and without a reply; None where there is no such way."""
        return None

    # --- noise ------------------------------------------------------------------------------------

    @abstractmethod
    def _once(self, request: Any, timeout_s: float | None) -> AxisExchange:
        """Send, and take the reply apart."""

    @abstractmethod
    def _is_good(self, index: int, reply: Any, *, may_be_silent: bool) -> bool:
        """True if a module could say that, as far as is known of this one."""

    def _count_writes(self, kind: ReplyKind, *, is_general: bool) -> None:
        """What the module has refused or Nacked has worn nothing; of what all are told, the others
        may have obeyed."""
        is_refusal = kind in (ReplyKind.REFUSED, ReplyKind.NACK) and not is_general
        self.session.run.budget.replied(is_refusal=is_refusal)

    def _undisturbed(
        self, request: Any, index: int, exchange: AxisExchange, timeout_s: float | None
    ) -> AxisExchange:
        """Send again until noise is not the reason for the reply; only what may be sent twice.

        What was Nacked was not obeyed (MACS-REPLY-04), and may be sent again whatever it is.  What
        may not be sent twice is asked for again later in the run: the same bad reply each time is
        the device's own as well.
        """
        quality = self.session.run.quality
        earlier = quality.unrepeated.setdefault(index, [])
        bad: list[bytes] = []
        since_ns: int | None = None  # the first sending that may have been obeyed
        for _ in range(RETRY.exchange):
            is_good = self._is_good(index, exchange.reply, may_be_silent=timeout_s is not None)
            if is_good:
                earlier.clear()
            if self.session.is_believed(bad, exchange.reply.raw, is_good=is_good):
                break
            words = f"{self.explained(exchange.request)}: {exchange.reply}"
            if exchange.kind is not ReplyKind.NACK:
                if index not in self.face.repeatable:
                    earlier.append(exchange.reply.raw)
                    self.session.is_reproduced = quality.is_reproduced(earlier)
                    if self.session.is_reproduced:
                        quality.note_wrong()
                    elif self.session.check is not None:
                        self.session.void_attempt(words)
                    break
                since_ns = exchange.taken.earliest_ns if since_ns is None else since_ns
            self.session.record_retry(words)
            exchange = self._once(request, timeout_s)
        if since_ns is None or index in QUERIES:
            return exchange
        return replace(exchange, taken=TimeWindow(since_ns, exchange.taken.latest_ns))

    # --- values -----------------------------------------------------------------------------------

    def command(self, index: int, parameter: int = 0, sub_index: int = 0) -> AxisExchange:
        """Send a command, with what precautions it needs."""
        careful = self.precautions if index in CAREFUL else None
        if careful is None:
            return self._command(index, parameter, sub_index)
        careful.before(index)
        exchange = self._command(index, parameter, sub_index)
        careful.after(index, exchange.kind)
        return exchange

    def _command(self, index: int, parameter: int, sub_index: int) -> AxisExchange:
        return self.send(self.request(index, parameter, sub_index))

    def within(self, timeout_s: float, index: int, parameter: int = 0) -> AxisExchange:
        """Send a command or a query to which nothing need come; wait so long for a reply."""
        return self.send(self.request(index, parameter), timeout_s)

    def in_vain(self, request: Any) -> AxisExchange:
        """Send a request that must not be obeyed, and listen for `QUIET_S`."""
        return self.send(request, QUIET_S)

    def ask(self, index: int, sub_index: int = 0) -> AxisExchange:
        """Send a query."""
        return self.command(index, 0, sub_index)

    def value(self, index: int, sub_index: int = 0) -> int:
        """The 32-bit number a query answers; no answer fails the check."""
        reply: AxisReply = self.ask(index, sub_index).reply
        if reply.data is None:
            self.session.fail(None, f"an answer to {self.named(index)}", reply)
        return reply.data

    def parameter(self, index: int) -> int:
        """The stored parameter that this command sets, unsigned."""
        return PARAMETERS[index].read(self.value(PARAMETERS[index].query))

    def parameters(self) -> dict[int, int]:
        """All stored parameters, unsigned, by the index of the command that sets each."""
        return values_of({query: self.value(query) for query in READ_ORDER})

    def data_bytes(self, index: int, sub_index: int = 0) -> tuple[int, int, int, int]:
        """The four bytes a query answers, first byte first."""
        first, second, third, fourth = self.value(index, sub_index).to_bytes(4, "big")
        return first, second, third, fourth

    def sample(self) -> Sample:
        """Read the counter, with the window in which it was read.  Fails the check in which the
        axis is seen to have run away, once it is stopped."""
        travel_guard, was_runaway = self.target.travel_guard, self.session.run.runaway
        exchange = self.ask(0x20)
        if travel_guard is not None and travel_guard.is_in_doubt:
            exchange = self.ask(0x20)
        runaway = self.session.run.runaway
        if runaway and not was_runaway:
            hold(self, is_seen_moving=True)
            if self.session.check is not None:
                self.session.fail(None, "an axis that goes where it is told", runaway)
        if exchange.reply.data is None:
            self.session.fail(None, f"an answer to {self.named(0x20)}", exchange.reply)
        return Sample(signed(exchange.reply.data), exchange.taken)

    def position(self) -> int:
        """Read the counter."""
        return self.sample().position

    def wait(self, seconds: float) -> None:
        """Let time pass; nobody waits for a motion that takes longer than any that a check asks
        for: the place it was reckoned from cannot be right."""
        if seconds > LONGEST_WAIT_S:
            longest = f"a place from which a motion takes {LONGEST_WAIT_S} s at most"
            self.session.fail(None, longest, f"one from which it takes {seconds:.0f} s")
        if seconds > 0:
            self.target.wait(seconds)

    def wait_until(self, moment_ns: int) -> None:
        """Let time pass up to a moment of the target's clock."""
        self.wait((moment_ns - self.target.now_ns) / 1e9)

    def silence_after(self, request: Any) -> tuple[bool, str, Observation]:
        """Send what must get no reply: whether none came, what is expected, and what came."""
        exchange = self.send(request, quiet_s(self.target))
        is_silent = exchange.kind is ReplyKind.SILENCE
        return is_silent, self.wanted(ReplyKind.SILENCE), self.observed(exchange)

    def wanted(self, kind: ReplyKind) -> str:
        """The reply that is expected, in words."""
        sign = self.face.signs.get(kind)
        return f"{kind.in_words} ({sign})" if sign else kind.in_words

    def observed(self, exchange: AxisExchange) -> Observation:
        """What the module did with a request, in words."""
        reply = exchange.reply
        sign = reply.raw.hex(" ").upper()
        if len(reply.raw) > SHORT_REPLY_BYTES:
            sign = self.face.signs.get(reply.kind, "")
        did = {
            ReplyKind.ACCEPTED: f"was accepted ({sign})",
            ReplyKind.REFUSED: f"was refused ({sign})",
            ReplyKind.NACK: f"was answered with Nack ({sign}h)",
            ReplyKind.SILENCE: f"got no reply{WAITED}",
        }.get(reply.kind, f"got {'the ' if reply.kind is ReplyKind.ANSWER else ''}{reply}")
        return Observation(f"{REQUEST} {did}", str(reply), "", exchange.request, is_whole=False)


def hold(client: AxisClient, *, is_seen_moving: bool = False) -> bool:
    """Bring an axis to rest that went where nothing leads that it was asked for; True if it stands.

    Nothing is believed of it but what is seen: any command may be the one that moves it, the stop
    as well.  So an axis that stands gets none, and one that moves gets one after the other, each
    followed by a look.  `is_seen_moving`: no time is to be lost with a look before the first.
    """
    for index in STOPS:
        if not is_seen_moving and _stands(client):
            return True
        is_seen_moving = False
        try:
            client.command(index)
        except OutsideEnvelope:  # it is one of those that may have moved it
            continue
    return _stands(client)


def _stands(client: AxisClient) -> bool:
    before = client.ask(0x20).reply.data
    client.wait(LOOK_S)
    after = client.ask(0x20).reply.data
    if before is None or after is None:
        return False
    return abs(signed(after - before & 0xFFFF_FFFF)) <= SWING


def judge_deaf(client: AxisClient, since_ns: int, seconds: float) -> None:
    """Hold it against a module that it answers a query half-way through a restart: each is as
    long as the others.  No query is sent where it could come too late."""
    half_ns = round(seconds * 5e8)
    if not client.face.deaf or client.target.uncertainty_ns > half_ns // 2:
        return
    client.target.wait(max(0.0, (since_ns + half_ns - client.target.now_ns) / 1e9))
    exchange = client.in_vain(client.request(0x20))
    is_early = exchange.taken.latest_ns < since_ns + round(seconds * 1e9)
    if exchange.kind is ReplyKind.ANSWER and is_early:
        wanted = f"no answer {half_ns // 1_000_000} ms after 00h, as after any"
        client.session.run.violations.append((client.face.deaf, wanted, str(exchange.reply)))
