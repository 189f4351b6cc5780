"""The link of a unit as its checks judge it: they count signs, refuse replies or leave them
unanswered, break packets off, and know at which instants each of that must show.

Windows.  T1 runs from the first byte of a packet, T2 from the last byte of a reply (§5.6).  When a
byte has left, and when one has come, is known to the time of a character and, on a real line, to
the transport's uncertainty; what the unit takes to turn round is measured on a good exchange.  A
reading is a whole number of ms, so that one ms is allowed for that on either side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.client import QUIET_S, MscClient, MscExchange
from axistwin_conformance.families.msc.codec import ACK, NAK, RQSTAT, Packet
from axistwin_conformance.transport.transport import is_twin_url

MS: Final = 1_000_000
STATUS_END: Final = 9  # of RQSTAT's body: what follows the status word may be anything
ROUNDING_NS: Final = MS  # a measured time-out is told in whole ms,
COARSE_NS: Final = 15 * MS  # or in steps of 20 where the line blurs it
WHILE_IT_TALKS: Final = 4  # characters of a reply that have come when it is interrupted
JUNK: Final = b"\x00"
FILLER: Final = b"0"  # of a packet whose end is of no account; no sum of one is 3030h
MOMENT_S: Final = 0.005  # between two parts of a packet: one after the other, and well within T1
TRIALS: Final = 3  # of what noise may have corrupted
RS232_UNIT: Final = 1  # MSC-PKT-04
LIMITS: Final = {"5_repeats": 5, "5_total": 4}  # MSC-AMB-01: how many repeats there are
# Readings in which the idle units of a shared line answer what one of them says, or junk for it.
SHOUTING: Final = (
    ("stray_nak", "resend_last"),
    ("noise_in_idle", "nak"),
    ("other_unit_framing", "hunt_stx"),
)
DRAWN: Final = "drawn"  # by what the host has sent
DUE: Final = "due"  # by T2
WAITS_AT_MOST: Final = 1.5  # times the time-out of a unit until it counts as not coming

Names = str | tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ReplyWindow:
    """Between which instants (ns, of the target's clock) something has to come."""

    earliest_ns: int
    latest_ns: int

    def __contains__(self, instant_ns: int) -> bool:
        return self.earliest_ns <= instant_ns <= self.latest_ns

    def since(self, origin_ns: int) -> str:
        """The window in words, counted from that instant."""
        first, last = ((instant - origin_ns) / MS for instant in (self.earliest_ns, self.latest_ns))
        return f"after {first:.1f} to {last:.1f} ms"


@dataclass(frozen=True, slots=True)
class Again:
    """A reply that came again amid the wait for its sign, if any did; what came before it or
    instead of it; what may have been the cause: `DRAWN` by what was sent, `DUE` by T2; and whether
    the unit, saying nothing, has given the reply up at T2."""

    packet: Packet | None
    strays: bytes
    causes: tuple[str, ...]
    is_over: bool = False


class MscLink:
    """The link of one unit as checks judge it, as a part of their driver."""

    def __init__(self, client: MscClient) -> None:
        self.session, self.target = client.session, client.target
        self._client = client

    # --- what is known of the line ----------------------------------------------------------------

    @property
    def byte_ns(self) -> int:
        """The time a character takes."""
        return self.target.byte_ns

    @property
    def spare_ns(self) -> int:
        """How well an instant is known: exactly, where time is virtual and nothing is disturbed."""
        is_exact = self.target.is_virtual and self.target.is_lossless
        return 0 if is_exact else self.target.uncertainty_ns

    @property
    def glance_s(self) -> float:
        """How long what must not come is listened for, where no time-out is at stake."""
        delay_s = int(self.session.reading("reply_delay_ms")) / 1000
        return QUIET_S + delay_s + self.target.uncertainty_ns / 1e9

    def drawn_by(self, noise: bytes) -> bytes:
        """All that a unit says to bytes of which each may draw a sign, one behind the other."""
        limit_s = self.glance_s + self.latency_ns / 1e9
        self.target.drain()
        self.target.send(noise)
        received = self._client.listen(len(noise) * self.byte_ns / 1e9 + limit_s)
        for _ in noise:
            if not (more := self._client.listen(limit_s) if received else b""):
                break
            received += more
        return received

    @property
    def glance_amid_wait_s(self) -> float:
        """The same while the unit waits for the host's sign: T2 must not run out meanwhile."""
        return min(self.glance_s, self._client.ack_timeout_s / 2)

    @property
    def is_slow(self) -> bool:
        """True if T2 may be over before what a byte draws is there: the unit takes as long to
        answer as it waits."""
        return self.glance_s > self._client.ack_timeout_s / 2

    def measure_if_slow(self) -> None:
        """Measure what `drawn_again` needs, before the exchange that it looks at."""
        if self.is_slow:
            self._measure_latency()

    def drawn_again(self, over_ns: int) -> Again:
        """What comes of bytes that were sent instead of a sign to a reply that was over then.

        Of a slow unit T2 may be over afterwards; see `measure_if_slow`.
        """
        action = self.session.run.readings.get("ack_timeout_action")
        if not self.is_slow or action != "retransmit":
            limit_s = self.glance_amid_wait_s if action in (None, "retransmit") else self.glance_s
            packet, strays = self._client.receive_packet(limit_s)
            is_over = action == "abandon" and self._is_t2_over(over_ns)
            return Again(packet, strays, (DRAWN,) if packet is not None else (), is_over)
        # Either is there by then, and when it has begun tells which of them it is.
        drawn_ns = self.target.now_ns + self.byte_ns + self.latency_ns
        due_ns = over_ns + self._t2_ns
        until_ns = max(drawn_ns, due_ns) + round(self.glance_s * 1e9)
        packet, strays = self._client.receive_packet((until_ns - self.target.now_ns) / 1e9)
        if packet is None:
            return Again(None, strays, (), is_over=True)
        begun_ns = self.target.now_ns - len(packet.raw) * self.byte_ns
        if not self._is_about(begun_ns, due_ns):
            return Again(packet, strays, (DRAWN,))
        is_either = self._is_about(drawn_ns, due_ns)
        return Again(packet, strays, (DRAWN, DUE) if is_either else (DUE,))

    def _is_about(self, instant_ns: int, other_ns: int) -> bool:
        """True for two instants that cannot be told apart."""
        rounding_ns = ROUNDING_NS if self.target.is_virtual else COARSE_NS
        return abs(instant_ns - other_ns) <= 2 * self.byte_ns + self.spare_ns + rounding_ns

    @property
    def _t2_ns(self) -> int:
        return round(self._client.ack_timeout_s * 1e9)

    def _is_t2_over(self, over_ns: int) -> bool:
        return self.target.now_ns - over_ns + self.spare_ns >= self._t2_ns

    @cached_property
    def latency_ns(self) -> int:
        """From the last byte of a good packet to the first bit of its ACK.

        An exchange of its own: whoever measures has it measured before he begins.
        """
        exchange = self._ask(RQSTAT)
        sent_ns = (len(exchange.request) + 1) * self.byte_ns
        return max(0, exchange.signed_ns - exchange.asked_ns - sent_ns)

    def _measure_latency(self) -> int:
        return self.latency_ns

    @property
    def is_rs485(self) -> bool:
        """True if the unit can only be on RS-485: not number 1, or not alone (MSC-PKT-04)."""
        return self._client.unit != RS232_UNIT or bool(self.session.neighbours)

    @property
    def is_busy_hearing(self) -> bool:
        """True if the unit can hear while it talks: two wires of RS-485 carry one way at a time."""
        return not self.is_rs485

    def drawn_by_both(self, first: bytes, second: bytes) -> bytes:
        """All that comes of two packets without a pause between: the second is served when the sign
        to the first has left."""
        self.target.drain()
        self.target.send(first + second)
        own_s = len(first + second) * self.byte_ns / 1e9
        return self._client.listen(own_s + self.glance_s + self.target.line_s)

    def is_surely_rs232(self) -> bool:
        """True for a unit that shows it: it hears while it talks, as on four wires of RS-485, and
        takes or refuses what is for other numbers, as nobody does there (MSC-LNK-19)."""
        is_checked = self.session.reading("rs232_unit_check") == "silent"
        return not is_checked and self.hears_while_it_talks()

    def must_hear_while_it_talks(self) -> None:
        """Skip if what is said at once spoils a sound exchange."""
        if not self.hears_while_it_talks():
            self.session.skip(
                "what unit and host say at once is corrupted, as on two wires of RS-485, where"
                " number 1 may be as well"
            )

    def hears_while_it_talks(self) -> bool:
        """Try it: a unit 1 without others may be on two wires of RS-485, and nothing else tells.
        A unit whose replies are never whole shows nothing here."""
        if self.is_rs485:
            return False
        return any(self._is_whole_beneath(JUNK) for _ in range(TRIALS)) or not any(
            self._is_whole_beneath(b"") for _ in range(TRIALS)
        )

    def _is_whole_beneath(self, junk: bytes) -> bool:
        """Whether a reply comes whole while the host sends bytes that mean nothing."""
        client = self._client
        client.wait_until_quiet()
        self.target.drain()
        self.target.send(client.request(RQSTAT))
        begun = client.receive(1 + WHILE_IT_TALKS)
        if junk:
            self.target.send(junk)
        rest = client.receive(client.reply_bytes("RQSTAT") - WHILE_IT_TALKS)
        reply = codec.parse((begun + rest).removeprefix(ACK))
        client.wait_until_quiet()
        return reply is not None and reply.is_sound

    @property
    def limit(self) -> int:
        """How many repeats this device sends (MSC-AMB-01)."""
        return LIMITS[self.session.reading("retransmit_limit")]

    @property
    def is_refused_in_chorus(self) -> bool:
        """True if the neighbours refuse as well what names no unit: NAKs of several at once garble
        each other."""
        is_nak = self.session.reading("invalid_unit") == "nak"
        return is_nak and bool(self.session.neighbours)

    def calm(self, *switches: str) -> None:
        """Go on only if one unit's NAK, or junk, leaves the other units of the line quiet.

        `switches`: the readings that matter; none named: all of `SHOUTING`.
        """
        for switch, reading in SHOUTING:
            if switches and switch not in switches:
                continue
            if self.session.neighbours and self.session.reading(switch) == reading:
                text = "the other units of this line take part; ask the unit alone"
                self.session.skip(f"with {switch}={reading} {text}")

    # --- what may be sent to whom -----------------------------------------------------------------

    @property
    def is_twin(self) -> bool:
        """True if nothing can be harmed: a twin, not a controller."""
        return is_twin_url(self.target.description)

    def only_on_a_twin(self) -> None:
        """Skip on a real controller, where nobody knows what a write of a strange body or number
        changes."""
        if not self.is_twin:
            self.session.skip("a write to a place that nobody has named is sent to a twin only")

    def _ask(self, body: bytes, **how: Any) -> MscExchange:
        return self._client.ask(self._client.request(body), **how)

    # --- signs ------------------------------------------------------------------------------------

    def sign(self, raw: bytes, sign: bytes, names: Names, what: str) -> MscExchange:
        """Judge that a packet draws that sign, then nothing but the reply it asks for."""
        if sign == NAK:
            self.calm()
        exchange = self._client.ask(raw)
        text = {ACK: "ACK", NAK: "NAK", b"": "nothing"}[sign]
        is_so = exchange.sign == sign and not exchange.extra
        if sign != ACK:
            is_so = exchange.raw == sign
        self.session.expect(
            is_so,
            names,
            f"{text} to {what}",
            lambda: replace(exchange.observed(), wanted=f"{text} to {what}"),
        )
        self.nothing_more(names, what)
        return exchange

    def nothing_more(self, names: Names, what: str, seconds: float | None = None) -> None:
        """Judge that the unit says nothing on its own after that."""
        extra = self._client.listen(self.glance_s if seconds is None else seconds)
        self.session.expect(
            not extra, names, f"nothing more after {what}", codec.explain(extra) or "nothing"
        )

    def alive(self, names: Names) -> Packet:
        """Judge that a good RQSTAT is served: ACK, and its reply."""
        exchange = self._ask(RQSTAT)
        reply = exchange.reply
        is_good = exchange.is_acked and reply is not None and reply.name == "RQSTAT"
        self.session.expect(is_good, names, "ACK and a reply to RQSTAT", exchange.observed)
        assert reply is not None
        return reply

    def specified(self, reply: Packet) -> bytes:
        """The body of a reply as far as it is specified (MSC-RQSTAT-03)."""
        return reply.body[:STATUS_END] if reply.name == "RQSTAT" else reply.body

    # --- replies without an answer ----------------------------------------------------------------

    def unanswered(self, body: bytes = RQSTAT) -> Packet:
        """Ask, and keep the answer to the reply back; a step."""
        self._measure_latency()
        exchange = self._ask(body, answer=None)
        is_good = exchange.is_acked and exchange.reply is not None and exchange.reply.is_sound
        self.session.step(is_good, "ACK and a reply", exchange.observed)
        assert exchange.reply is not None
        return exchange.reply

    def refuse(self) -> Packet | None:
        """Answer a reply with NAK; the repeat, or None if none comes.  What comes instead of one
        fails MSC-LNK-10."""
        return self.refuse_in("MSC-LNK-10")

    def refuse_in(self, names: Names) -> Packet | None:
        """The same where something else is judged than MSC-LNK-10."""
        self.calm()
        self.target.send(NAK)
        again, strays = self._client.receive_packet()
        if strays:
            received = codec.explain(strays + (again.raw if again else b""))
            self.session.fail(names, "the packet again, or nothing", received)
        return again

    def is_same(self, again: Packet, first: Packet) -> bool:
        """True if a packet repeats another in this device's reading (MSC-AMB-35)."""
        if self.session.reading("retransmit_content") == "snapshot":
            return again.raw == first.raw
        is_alike = (again.name, again.unit) == (first.name, first.unit)
        return again.is_sound and is_alike and len(again.raw) == len(first.raw)

    # --- when -------------------------------------------------------------------------------------

    def sign_window(self, sent_ns: int, count: int) -> ReplyWindow:
        """When the NAK for a packet comes of which `count` bytes were sent in a row from then on
        and no more: T1 later, in this device's reading of MSC-AMB-03."""
        mode = self.session.reading("packet_timeout_mode")
        first, last = 0, 1  # in characters: when T1 may have begun
        if mode == "interbyte":
            first, last = count - 1, count
        elif mode == "after_header":
            first, last = (5, 6) if count >= codec.HEADER_BYTES else (0, count)
        return self._due(sent_ns, first, last, self._client.packet_timeout_s)

    def repeat_window(self, replied_ns: int, size: int) -> ReplyWindow:
        """When a repeat of that size is there entirely, if the one before was at that time and
        nobody answered it: T2 later."""
        own_ns = size * self.byte_ns
        due = self._due(replied_ns, 0, 1, self._client.ack_timeout_s)
        return ReplyWindow(due.earliest_ns + own_ns - self.byte_ns, due.latest_ns + own_ns)

    def _due(self, origin_ns: int, first: int, last: int, timeout_s: float) -> ReplyWindow:
        """When one character comes that is sent when a time-out is over that began between those
        characters after the origin."""
        due_ns = origin_ns + round(timeout_s * 1e9)
        rounding_ns = ROUNDING_NS if self.target.is_virtual else COARSE_NS
        early_ns = due_ns + first * self.byte_ns - rounding_ns - self.spare_ns
        late_ns = due_ns + (last + 2) * self.byte_ns + self.latency_ns + rounding_ns
        return ReplyWindow(early_ns, late_ns + self.spare_ns)

    def has_time_for(self, size: int) -> bool:
        """True if so many bytes, sent in a row, are surely over before T1 is."""
        span_ns = size * self.byte_ns + self.spare_ns
        return span_ns < self.sign_window(0, codec.HEADER_BYTES).earliest_ns

    def is_amid(self, sent_ns: int, size: int, came_ns: int) -> bool:
        """True if what came then came before the last of the bytes, sent in a row, was over."""
        rounding_ns = ROUNDING_NS if self.target.is_virtual else COARSE_NS
        return came_ns < sent_ns + size * self.byte_ns - rounding_ns - self.spare_ns

    def break_off(self, raw: bytes, first: int = 0) -> tuple[bytes, int, int]:
        """Send the beginning of a packet and wait out T1: what came, when sending began and when it
        came (ns).  `first`: so many bytes of it are sent a moment before the others."""
        self.calm()
        self._measure_latency()
        self.target.drain()
        sent_ns = self.target.send(raw[: first or None])
        if first:
            self.target.wait(first * self.byte_ns / 1e9 + MOMENT_S)
            self.target.send(raw[first:])
        own_s = len(raw) * self.byte_ns / 1e9
        received = self._client.receive(
            1, self._client.packet_timeout_s * WAITS_AT_MOST + own_s + self.glance_s
        )
        came_ns = self.target.now_ns
        if not received:
            self._fill_up(raw)
        return received, sent_ns, came_ns

    def _fill_up(self, raw: bytes) -> None:
        """Send what is missing of a packet that nobody has refused at T1, if that is no more than a
        long one has: a unit without that limit serves nothing else until it has it."""
        is_own = len(raw) >= codec.HEADER_BYTES and raw[1] == self._client.unit
        announced = codec.AROUND_BODY + int.from_bytes(raw[2:4], "big")
        if is_own and announced <= 2 * codec.MAX_PACKET:
            self.target.send(FILLER * (announced - len(raw)))
            self._client.listen((announced - len(raw)) * self.byte_ns / 1e9 + self.glance_s)
