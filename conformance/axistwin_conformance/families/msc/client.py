"""Exchanges with one unit: a packet there, ACK or NAK back, perhaps a packet, and our ACK to that.

Rules.

1. A NAK for a packet that broke off comes long after it (MSC-LNK-03), and a reply nobody has
   acknowledged comes again (MSC-LNK-12).  Neither must be taken for the answer to what is asked
   next: after sending something broken, or leaving a reply unanswered, a caller waits until the
   unit is quiet (`wait_until_quiet`) before he asks anything else.
2. Where bytes may get lost, a sound packet that may be carried out twice is sent again, below the
   checks: the reads, and the writes of values.  SFLAG and CFLAG are not: the macroprogram may have
   used the flag up in between, and a second one is a second cycle of the machine (MSC-LNK-18).
   What goes wrong with one of these voids the attempt.
3. Whatever whole reply has come is acknowledged, sound or not, unless told otherwise: that ends the
   exchange on every device, and what came is for the caller to judge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, WAITED, Observation
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.codec import ACK, MOST_STRAYS, NAK, STX, Packet
from axistwin_conformance.transport.serial import SerialTransport

RECEIVED_AT_ONCE: Final = 4096
QUIET_S: Final = 0.1  # after which a unit that is talking has ended
UNMEASURED_S: Final = 0.6  # on top of the usual time-out, before a round trip is measured
MARGIN_S: Final = 0.2  # on top of a measured time-out: one reply, and the way
REPEATS: Final = 5  # MSC-LNK-09
REPEAT_S: Final = 0.15  # the longest reply (§2.4)
MOST_RECEIVED: Final = 24  # repeats and signs that are waited out before a unit counts as babbling
REPEATABLE: Final = frozenset({*codec.READS, "DWRITE", "BWRITE"})  # rule 2


@dataclass(frozen=True, slots=True)
class MscExchange:
    """A packet and what came of it.

    `sign`: ACK, NAK or nothing; `reply`: the packet behind it; `extra`: what belongs to neither.
    Times (ns, of the target's clock): `asked_ns` when sending began, `signed_ns` when the sign was
    there, `replied_ns` when the reply was; each that of the one before if there is none.
    """

    request: bytes
    sign: bytes
    reply: Packet | None = None
    extra: bytes = b""
    asked_ns: int = 0
    signed_ns: int = 0
    replied_ns: int = 0

    @property
    def raw(self) -> bytes:
        """All that came."""
        return self.sign + (self.reply.raw if self.reply else b"") + self.extra

    @property
    def is_acked(self) -> bool:
        """True for an ACK and nothing beside it and the reply."""
        return self.sign == ACK and not self.extra

    @property
    def is_naked(self) -> bool:
        """True for a NAK and nothing else."""
        return self.raw == NAK

    @property
    def is_silence(self) -> bool:
        """True if nothing came at all."""
        return not self.raw

    def __str__(self) -> str:
        return codec.explain(self.raw) or "nothing"

    def observed(self) -> Observation:
        """What the unit did with the packet, in words."""
        did = f"was answered with {self}" if self.raw else f"got no answer{WAITED}"
        return Observation(f"{REQUEST} {did}", str(self), "", self.request, is_whole=False)


class MscClient:
    """One unit on the line: what is said to it and what it says."""

    def __init__(self, session: Session, unit: int | None = None) -> None:
        self.session = session
        self.unit = session.address if unit is None else unit
        self.target: SerialTransport = session.target

    # --- one way ----------------------------------------------------------------------------------

    def request(self, body: bytes, block: int = 0) -> bytes:
        """A sound packet for this unit."""
        return codec.packet(self.unit, body, block)

    def send(self, raw: bytes) -> int:
        """Send the bytes as they are; return when that began (ns)."""
        return self.target.send(raw)

    def receive(self, count: int, timeout_s: float | None = None) -> bytes:
        """Up to `count` bytes; fewer if the time-out (s, for all of them) passes first."""
        return self.target.receive(count, self.limit_s(count) if timeout_s is None else timeout_s)

    def listen(self, seconds: float) -> bytes:
        """All that comes within so long."""
        return self.target.receive(RECEIVED_AT_ONCE, seconds)

    def receive_packet(self, timeout_s: float | None = None) -> tuple[Packet | None, bytes]:
        """The next packet the unit sends, and what came before it or instead of it.

        `timeout_s`: until its first byte; the rest has the time it takes on the line beside that.
        What comes in pieces is told to the session: where bytes may get lost it may be noise.
        """
        packet, strays = self._next_packet(timeout_s)
        is_whole = packet is None or packet.is_sound
        if not is_whole or strays.strip(ACK + NAK):
            self.session.note_broken_reply(codec.bytes_of(packet, strays))
        return packet, strays

    def _next_packet(self, timeout_s: float | None = None) -> tuple[Packet | None, bytes]:
        limit_s = self.limit_s(0) if timeout_s is None else timeout_s
        strays, received = b"", self.receive(1, limit_s)
        while received and received != STX and len(strays) < MOST_STRAYS:
            strays += received
            received = self.receive(1, limit_s)
        if received != STX:
            return None, strays + received
        return self.rest_of_packet(strays)

    def rest_of_packet(self, strays: bytes = b"") -> tuple[Packet | None, bytes]:
        """The packet whose first byte has been heard, behind these bytes."""
        received = STX
        while count := self._missing(received):
            # Its bytes follow one another: a repeat, after T2, is not to be taken for the rest.
            own_s = count * self.target.byte_ns / 1e9
            more = self.receive(count, self.session.reply_timeout_s + own_s)
            received += more
            if len(more) < count:
                return None, strays + received
        return codec.parse(received), strays

    def _missing(self, received: bytes) -> int:
        """How many bytes may be read at once without reading beyond this packet; 0: it is over."""
        count = codec.missing_bytes(received)
        known = received + self.target.upcoming if count else received
        while len(received) + count <= len(known):
            more = codec.missing_bytes(known[: len(received) + count])
            if not more:
                break
            count += more
        return count

    def limit_s(self, count: int) -> float:
        """How long to wait for so many bytes that a unit sends without being told more.

        The manual names no limit for its delays: until they are measured, more is allowed.
        """
        unmeasured_s = 0 if self.target.round_trip.max_ns else UNMEASURED_S
        own_s = count * self.target.byte_ns / 1e9
        return self.session.reply_timeout_s + unmeasured_s + own_s

    # --- time-outs of the unit --------------------------------------------------------------------

    @property
    def packet_timeout_s(self) -> float:
        """T1, as measured in this run or by default (MSC-AMB-03)."""
        return int(self.session.reading("packet_timeout_ms")) / 1000

    @property
    def ack_timeout_s(self) -> float:
        """T2, as measured in this run or by default (MSC-AMB-02)."""
        return int(self.session.reading("ack_timeout_ms")) / 1000

    @property
    def quiet_limit_s(self) -> float:
        """For how long nothing must come before nothing will (§5.6), of a unit that takes as long
        to say it as this one."""
        known, own_s = self.session.readings, max(self.target.line_s, self.session.run.late_s)
        if {"packet_timeout_ms", "ack_timeout_ms"} <= set(known):
            return max(self.packet_timeout_s, self.ack_timeout_s) + own_s + MARGIN_S
        return self.packet_timeout_s + (REPEATS + 1) * (self.ack_timeout_s + REPEAT_S) + own_s

    def wait_until_quiet(self, *, after: MscExchange | None = None) -> bytes:
        """Wait until nothing is left over of what was said before; return what still came.

        A reply that comes again is acknowledged and thrown away (§4.3).  Who then still talks after
        twice the time in which all repeats are over, is not waited for; who has said nothing but
        signs all the while never falls silent, and can be asked nothing: raises TargetError.
        `after`: what was said last; where that drew nothing at all, no reply is waiting to be
        acknowledged.
        """
        received, quiet_s = b"", self.quiet_limit_s
        if after is not None and after.is_silence:
            quiet_s = min(quiet_s, self.packet_timeout_s + self.session.run.late_s + MARGIN_S)
        until_ns = self.target.now_ns + round(2 * quiet_s * 1e9)
        for _ in range(MOST_RECEIVED):
            if self.target.now_ns >= until_ns:
                break
            packet, strays = self._next_packet(quiet_s)
            if packet is None and not strays:
                return received
            received += codec.bytes_of(packet, strays)
            if packet is not None or STX in strays:
                self.target.send(ACK)
        self._refuse_endless_signs(received)
        return received

    def _refuse_endless_signs(self, received: bytes) -> None:
        """Judge what came without an end, though nobody asked (MSC-LNK-04); each byte of what was
        sent may have drawn a sign (MSC-AMB-30)."""
        most = max(MOST_STRAYS, len(self.target.last_sent))
        if len(received) <= most or received.strip(ACK + NAK):
            return
        came = f"{len(received)} more, {codec.explain(received[:1])} first, and no end"
        self.session.run.violations.append(("MSC-LNK-04", "one ACK or NAK for a packet", came))
        raise TargetError("it sends ACK or NAK without end, and is asked nothing more")

    # --- both ways --------------------------------------------------------------------------------

    def ask(
        self,
        raw: bytes,
        *,
        answer: bytes | None = ACK,
        is_read: bool | None = None,
        timeout_s: float | None = None,
    ) -> MscExchange:
        """Send a packet and take what comes of it (rules 2 and 3).

        `answer`: our sign after a reply, None to keep it back.  `is_read`: a packet is awaited
        after the ACK; None: if this is a sound one of the commands that have a reply.
        `timeout_s`: until the sign comes.
        """
        packet = codec.parse(raw)
        is_sound = packet is not None and packet.is_request and packet.unit == self.unit
        name = packet.name if packet is not None and is_sound else ""
        awaits = name in codec.READS if is_read is None else is_read
        exchange = self._once(raw, awaits, answer, timeout_s)
        if self.target.is_lossless or not is_sound:
            return exchange
        if exchange.is_acked:
            self.target.note_exchange(raw, len(exchange.raw), exchange.asked_ns)
        return self._undisturbed(exchange, name, awaits, answer, timeout_s)

    def _undisturbed(
        self,
        exchange: MscExchange,
        name: str,
        awaits: bool,
        answer: bytes | None,
        limit: float | None,
    ) -> MscExchange:
        """Send again until noise is not the reason for what came (rule 2).

        A NAK, time after time, is no sign of a device that is lost: it may refuse an address.
        """
        bad: list[bytes] = []
        refused = 0
        for _ in range(RETRY.exchange):
            if self._is_refusal(exchange, refused):
                break
            if not exchange.is_naked or self.session.is_strict:
                is_good = self._is_good(exchange, name, awaits)
                if self.session.is_believed(bad, exchange.raw, is_good=is_good):
                    break
            refused = refused + 1 if exchange.is_naked else 0
            words = f"{codec.explain_request(exchange.request)}: {exchange}"
            if name not in REPEATABLE:
                if self.session.check is not None:
                    self.session.void_attempt(words)
                break
            self.session.record_retry(words)
            if not exchange.is_naked:  # part of the packet may wait for its end, or a reply for us
                self.wait_until_quiet(after=exchange)
            exchange = self._once(exchange.request, awaits, answer, limit)
        return exchange

    def _is_refusal(self, exchange: MscExchange, refused: int) -> bool:
        """True for a NAK that has come too often before for noise."""
        quality = self.session.run.quality
        is_settled = exchange.is_naked and refused + 1 >= quality.alike_needed
        if is_settled:
            self.session.run.silence_limit.good()
            self.session.is_reproduced = True
        return is_settled

    def _is_good(self, exchange: MscExchange, name: str, awaits: bool) -> bool:
        """True if a unit could say that to a sound packet, as far as is known of this one."""
        if awaits and name in codec.READS:
            return self.is_right(exchange, name)
        # Behind the ACK to a write nothing need come, even where it is waited for (MSC-AMB-36).
        return exchange.is_acked and (exchange.reply is None or exchange.reply.is_sound)

    def is_right(self, exchange: MscExchange, name: str) -> bool:
        """True for what must come of a read, in the reading of this device."""
        reply = exchange.reply
        return (
            exchange.is_acked
            and reply is not None
            and reply.is_sound
            and reply.unit == self.unit
            and reply.name == name
            and len(reply.raw) in self._reply_sizes(name)
        )

    def _reply_sizes(self, name: str) -> set[int]:
        """What the reply to a command may have, as far as the reading of this device is known."""
        is_open = name == "RQSTAT" and "status_tail" not in self.session.readings
        return {self.reply_bytes(name), codec.REPLY_BYTES[name] - 2 * is_open}

    def reply_bytes(self, name: str) -> int:
        """What the reply to a command has, in the reading of this device (MSC-AMB-38)."""
        is_short = name == "RQSTAT" and self.session.reading("status_tail") == "4"
        return codec.REPLY_BYTES[name] - 2 * is_short

    def _once(
        self, raw: bytes, awaits: bool, answer: bytes | None, timeout_s: float | None
    ) -> MscExchange:
        self.target.drain()
        asked_ns = self.target.send(raw)
        limit_s = self.limit_s(len(raw)) if timeout_s is None else timeout_s
        first = self.receive(1, limit_s)
        signed_ns = replied_ns = self.target.now_ns
        sign = first if first in (ACK, NAK) else b""
        reply, extra = None, b""
        if first == STX or (sign == ACK and awaits):
            reply, extra = self.rest_of_packet() if first == STX else self._next_packet()
            replied_ns = self.target.now_ns
            if answer is not None and not sign:  # it may be in the wrong order (MSC-LNK-07)
                extra += self.listen(QUIET_S)
            elif answer is not None and reply is not None and not reply.is_sound:
                self.listen(QUIET_S)  # so that all of it is on record, whatever its length says
            if answer is not None and (reply or STX in extra):
                self.target.send(answer)
        elif first and not sign:
            extra = first + self.listen(QUIET_S)
        elif sign == ACK and self.session.reading("write_reply") == "empty_packet":
            reply, extra = self._next_packet()
            self.target.send(ACK)
        return MscExchange(raw, sign, reply, extra, asked_ns, signed_ns, replied_ns)
