"""The link layer of one unit: packets in, ACK and NAK out, replies and their repeats (ledger §4).

::

    host   |STX ... sum|                                          |ACK|
    unit               |-response delay-|ACK|-reply delay-|packet|
           T1 .........                                           T2 ..
    state  packet      EXEC ...................................... WAIT  IDLE

States
------
IDLE; HEADER, BODY (checksum included), DISCARD (the rest of a packet that is too long), SKIP (the
rest of a packet for another unit); EXEC, while it works or sends, repeats included (``is_busy``);
WAIT for the host's ACK or NAK.

Rules
-----
1. A packet is delimited by its length alone: no byte in it is special (MSC-PKT-15), and bytes of a
   packet that was refused are not looked at again (MSC-LNK-24).
2. T1 runs from the arrival of the STX to that of the last byte (MSC-LNK-03); T2 from the moment at
   which the reply has left (MSC-AMB-02).  A byte that is complete just when a time limit runs out
   has come in time.
3. A packet for this unit draws one ACK or NAK (MSC-LNK-04), one for another unit nothing
   (MSC-LNK-19).
4. What arrives in EXEC waits in a buffer of 256 bytes and is looked at in the moment in which the
   unit is ready again (MSC-AMB-39).
5. A reply is repeated five times at most, byte for byte, without an ACK before it (MSC-LNK-09, -10,
   -21); the count belongs to the reply.
6. A character with a bad stop bit is nothing outside packets, and spoils the packet in which it
   stands (MSC-AMB-43).
7. The unit is woken at the end of EXEC even when nothing is left to do: bytes that come before it
   never bring a wake-up forward (``SerialDevice.quiet_prefix``).
"""

from collections.abc import Callable
from enum import Enum
from typing import Final, NamedTuple, TypeAlias

from axistwin.devices.msc.packets import (
    ACK,
    ACK_BYTE,
    BODY_MAX,
    CHECKSUM_BYTES,
    FRAME_BYTES,
    HEADER_BYTES,
    NAK,
    NAK_BYTE,
    STX,
    Whom,
    body_length,
    concerned,
    is_sum_right,
    packet,
)
from axistwin.devices.msc.quirks import MscQuirks
from axistwin.kernel.effects import Effect, Transmit
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.wire.framing import Chunk, LineFormat

BUFFER_BYTES: Final = 256
UNPACED_BUFFER_BYTES: Final = 65536
"""Where bytes take no time, all that a host writes comes at once."""

REPEATS_MAX: Final = {"5_repeats": 5, "5_total": 4}

LINE_FORMAT: Final = LineFormat(9600)
"""9600 8N1 (MSC-PHY-01)."""


class ReceiverState(Enum):
    """Where the receiver stands between two bytes."""

    IDLE = "idle"
    HEADER = "header"
    BODY = "body"
    DISCARD = "discard"
    SKIP = "skip"
    WAIT = "wait"


class Verdict(NamedTuple):
    """What becomes of a packet whose sum is right.

    sign: ACK, NAK or nothing.  act: carries a command out; returns when it wants to be called
    again, or None when it is done.  reply: gives the body of the reply.
    """

    sign: bytes
    act: Callable[[Nanos], Nanos | None] | None = None
    reply: Callable[[Nanos], bytes] | None = None


REFUSED: Final = Verdict(NAK_BYTE)
ACCEPTED: Final = Verdict(ACK_BYTE)
IGNORED: Final = Verdict(b"")

Examiner: TypeAlias = Callable[[Nanos, bytes], Verdict]
"""Judges the body of a packet that was complete at a time."""


class Receiver:
    """The link layer of ``unit``, idle.

    examine: judges bodies.  delay_ns: from the last byte of a packet to the answer.
    skew_ns: how much later than an exact clock this one says that time is up.
    ``effects`` are what is to be sent, for the caller to take.
    """

    def __init__(
        self,
        unit: int,
        quirks: MscQuirks,
        examine: Examiner,
        *,
        is_rs232: bool,
        delay_ns: Nanos,
        skew_ns: Nanos = 0,
    ) -> None:
        self.unit = 1 if is_rs232 else unit
        self.effects: list[Effect] = []
        self._quirks = quirks
        self._examine = examine
        self._is_rs232 = is_rs232
        self._whom_of = concerned(unit, quirks, is_rs232=is_rs232)
        self._delay_ns = delay_ns
        self._reply_delay_ns = quirks.reply_delay_ms * NS_PER_MS
        self._packet_ns = quirks.packet_timeout_ms * NS_PER_MS + skew_ns
        self._answer_ns = quirks.ack_timeout_ms * NS_PER_MS + skew_ns
        self._packet_bytes = LINE_FORMAT.characters_within(self._packet_ns)
        self._repeats_max = REPEATS_MAX[quirks.retransmit_limit]
        self._is_interbyte = quirks.packet_timeout_mode == "interbyte"
        self._heeds_noise = quirks.noise_in_idle == "nak" or quirks.stray_nak == "resend_last"
        self._serves_when_waiting = quirks.stx_while_waiting == "serve"
        self._acts_first = quirks.ack_order == "ack_last"
        self._is_paced = True
        self.reset()

    def reset(self) -> None:
        """Power-up: idle, nothing is sent, nothing remembered (ledger §4.1)."""
        self.state = ReceiverState.IDLE
        # The packet on its way in, T1, and how many bytes are missing until the next decision.
        self._packet = bytearray()
        self._missing = 0
        self._whom = Whom.OTHER
        self._is_bad = False
        self._packet_due: Nanos = NEVER
        # EXEC: until when, what comes then, and what came meanwhile.
        self._busy_until: Nanos = NEVER
        self._then: Callable[[Nanos], None] = self._rest
        self._kept = bytearray()
        # The packet in hand, its reply, T2.
        self._verdict = IGNORED
        self._request = b""
        self._sign_ns: Nanos = 0
        self._reply = b""
        self._reply_unit = self.unit
        self._rebuild: Callable[[Nanos], bytes] = _nothing
        self._block = 0
        self._repeats = 0
        self._answer_due: Nanos = NEVER
        # T2 of a reply whose fate depends on whom the packet on its way in is for (MSC-AMB-45).
        self._kept_due: Nanos | None = None

    @property
    def is_busy(self) -> bool:
        """Whether the unit works or sends: EXEC."""
        return self._busy_until != NEVER

    # -- time ------------------------------------------------------------------------------------

    def next_event(self) -> Nanos:
        """When a time limit runs out, or the unit is ready with what it does; or ``NEVER``."""
        return min(self._packet_due, self._answer_due, self._busy_until)

    def wake(self, now: Nanos) -> None:
        """Do what is due by ``now``."""
        while (due := self.next_event()) <= now:
            if due == self._busy_until:
                self._busy_until = NEVER
                self._then(due)
            elif due == self._packet_due:
                self._give_up_packet(due)
            else:
                self._give_up_waiting(due)

    def _give_up_packet(self, now: Nanos) -> None:
        """T1 has run out (MSC-LNK-03, MSC-AMB-31)."""
        if len(self._packet) == 1:
            policy = self._quirks.timeout_before_unit
            nacks = policy == "nak" or (policy == "silent_on_rs485" and self._is_rs232)
        else:
            nacks = self._whom_of[self._packet[1]] in (Whom.OWN, Whom.REFUSED)
        self._packet_due = NEVER
        if nacks:
            self._sign(now, now, NAK_BYTE, self._rest)
        else:
            self._end_foreign(now)

    def _give_up_waiting(self, now: Nanos) -> None:
        """T2 has run out (MSC-LNK-12)."""
        if self._quirks.ack_timeout_action == "retransmit":
            self._repeat(now, now)
        else:
            self._rest(now)

    # -- bytes in --------------------------------------------------------------------------------

    def receive(self, chunk: Chunk) -> None:
        """Take the bytes of ``chunk``; a bad character comes alone."""
        data = chunk.data
        self._is_paced = chunk.format is not None
        if chunk.errors:
            self._take_bad(chunk)
        elif (at := self._whole_packet_at(data)) >= 0:
            self._answer_due = NEVER
            self._whom, self._is_bad = Whom.OWN, False
            self._judge(data[at:] if at else data, chunk.arrival_ns(len(data) - 1))
        else:
            self._take(chunk)

    def _whole_packet_at(self, data: bytes) -> int:
        """Where the one packet begins that ``data`` is, of legal length, for this unit, in time.

        0, or 1 behind the host's ACK that was awaited; -1: it is something else.
        """
        at = 0
        if self.state is not ReceiverState.IDLE:
            if self.state is not ReceiverState.WAIT:
                return -1
            if data[:1] == ACK_BYTE:
                at = 1
            elif not self._serves_when_waiting:
                return -1
        length = len(data) - at - FRAME_BYTES
        if (
            length > 0
            and data[at] == STX
            and data[at + 2] << 8 | data[at + 3] == length
            and self._whom_of[data[at + 1]] is Whom.OWN
            and self._busy_until == NEVER
            and length <= BODY_MAX
            and length + FRAME_BYTES - 1 <= self._packet_bytes
        ):
            return at
        return -1

    def _take_bad(self, chunk: Chunk) -> None:
        """A character with a bad stop bit (rule 6)."""
        policy = self._quirks.uart_error
        is_in_packet = (
            self.state not in (ReceiverState.IDLE, ReceiverState.WAIT) and self._busy_until == NEVER
        )
        if is_in_packet and policy != "drop_byte":
            self._is_bad = self._is_bad or policy == "bad_packet"
            self._take_counted(chunk, 0)

    def _take(self, chunk: Chunk) -> None:
        """Take bytes one stretch after the other, each as far as nothing is to be decided."""
        at, size = 0, len(chunk.data)
        while at < size:
            if self._busy_until != NEVER:
                self._keep(chunk.data[at:])
                return
            if self.state is ReceiverState.IDLE:
                at = self._take_idle(chunk, at)
            elif self.state is ReceiverState.WAIT:
                self._take_waiting(chunk.data[at], chunk.arrival_ns(at))
                at += 1
            else:
                at = self._take_counted(chunk, at)

    def _take_idle(self, chunk: Chunk, at: int) -> int:
        """Look for an STX from byte ``at`` on; returns where to go on."""
        if self._heeds_noise and chunk.data[at] != STX:
            self._take_noise(chunk.data[at], chunk.arrival_ns(at))
            return at + 1
        found = chunk.data.find(STX, at)
        if found < 0:
            return len(chunk.data)
        self._begin_packet(chunk.arrival_ns(found))
        return found + 1

    def _take_noise(self, byte: int, now: Nanos) -> None:
        """A byte that starts no packet, while idle (MSC-AMB-29, MSC-AMB-30)."""
        if byte == NAK:
            if self._quirks.stray_nak == "resend_last" and self._reply:
                self._repeat(now, now + self._delay_ns)
        elif byte != ACK and self._quirks.noise_in_idle == "nak":
            self._sign(now, now + self._delay_ns, NAK_BYTE, self._rest)

    def _take_waiting(self, byte: int, now: Nanos) -> None:
        """A byte while the host's ACK is awaited (ledger §4.1)."""
        if byte == ACK:
            self._rest(now)
            return
        if byte == NAK:
            reading = "as_nak"
        elif byte == STX:
            reading = self._quirks.stx_while_waiting
        else:
            reading = self._quirks.junk_while_waiting
        if reading == "as_nak":
            self._repeat(now, now + self._delay_ns)
        elif reading == "serve":
            if self._quirks.pending_reply_on_stx == "keep_if_foreign":
                self._kept_due = self._answer_due
            self._answer_due = NEVER
            self._begin_packet(now)
        elif reading == "abandon":
            self._rest(now)

    def _begin_packet(self, now: Nanos) -> None:
        """An STX: T1 starts."""
        self.state = ReceiverState.HEADER
        self._packet = bytearray((STX,))
        self._missing = HEADER_BYTES - 1
        self._is_bad = False
        self._packet_due = now + self._packet_ns

    def _take_counted(self, chunk: Chunk, at: int) -> int:
        """Take bytes of a packet from byte ``at`` on; returns where to go on."""
        count = min(self._missing, len(chunk.data) - at)
        self._missing -= count
        if self.state is ReceiverState.HEADER or self.state is ReceiverState.BODY:
            self._packet += chunk.data[at : at + count]
        now = chunk.arrival_ns(at + count - 1)
        if self._is_interbyte:
            self._packet_due = now + self._packet_ns
        if not self._missing:
            if self.state is ReceiverState.HEADER:
                self._judge_header(now)
            else:
                self._end_packet(now)
        return at + count

    # -- decisions (ledger §4.2) -----------------------------------------------------------------

    def _judge_header(self, now: Nanos) -> None:
        """The header is complete: whom it concerns, and how much is to come."""
        quirks = self._quirks
        length = body_length(self._packet)
        self._whom = self._whom_of[self._packet[1]]
        self._missing = length + CHECKSUM_BYTES
        if quirks.packet_timeout_mode == "after_header":
            self._packet_due = now + self._packet_ns
        if self._whom is not Whom.OTHER:
            self._kept_due = None
        if self._whom is Whom.OTHER:
            self.state = ReceiverState.SKIP
            if quirks.other_unit_framing == "hunt_stx":
                self._end_packet(now)
        elif length <= BODY_MAX or quirks.overlength == "accept":
            self.state = ReceiverState.BODY
        else:
            self.state = ReceiverState.DISCARD
            if quirks.overlength == "nak_after_header":
                self._end_packet(now)
            elif quirks.overlength == "timeout_only":
                self._missing = NEVER

    def _end_packet(self, now: Nanos) -> None:
        """No more bytes of the packet are to come, or to be looked at."""
        self._packet_due = NEVER
        if self.state is ReceiverState.SKIP:
            self._end_foreign(now)
        elif self.state is ReceiverState.DISCARD:
            self._refuse(now)
        else:
            self._judge(bytes(self._packet), now)

    def _end_foreign(self, now: Nanos) -> None:
        """A packet for another unit is over: idle, or waiting as before it (MSC-AMB-45).

        A T2 that ran out meanwhile takes effect now.
        """
        kept_due, self._kept_due = self._kept_due, None
        if kept_due is None:
            self.state = ReceiverState.IDLE
        else:
            self.state, self._answer_due = ReceiverState.WAIT, max(now, kept_due)

    def _judge(self, raw: bytes, now: Nanos) -> None:
        """A packet of legal length that concerns this unit is complete."""
        if self._is_bad or self._whom is Whom.REFUSED or not is_sum_right(raw):
            self._refuse(now)
            return
        self._request = raw
        verdict = self._examine(now, raw[HEADER_BYTES:-CHECKSUM_BYTES])
        if self._whom is Whom.ALL:
            verdict = Verdict(b"", verdict.act)
        self._verdict = verdict
        self._sign_ns = now + self._delay_ns
        if self._acts_first or not verdict.sign:
            self._obey_first(now)
        else:
            self._sign(now, self._sign_ns, verdict.sign, self._obey)

    def _refuse(self, now: Nanos) -> None:
        """A packet is bad: NAK, unless it is for all units."""
        if self._whom is Whom.ALL:
            self._rest(now)
        else:
            self._sign(now, now + self._delay_ns, NAK_BYTE, self._rest)

    # -- EXEC ------------------------------------------------------------------------------------

    def _stay_busy(self, now: Nanos, until: Nanos, then: Callable[[Nanos], None]) -> None:
        """Work or send ``until`` then, and go on with ``then``: at once if that is now."""
        self.state = ReceiverState.IDLE
        if until <= now:
            then(now)
        else:
            self._busy_until, self._then = until, then

    def _send(self, start_ns: Nanos, data: bytes) -> Nanos:
        """Queue ``data``; returns when its last byte has left."""
        effects = self.effects
        if effects and not self._is_paced and type(effects[-1]) is Transmit:
            last = effects[-1]
            if last.start_ns == start_ns:
                effects[-1] = Transmit(start_ns, last.data + data)
                return start_ns
        effects.append(Transmit(start_ns, data))
        return start_ns + LINE_FORMAT.span_ns(len(data)) if self._is_paced else start_ns

    def _sign(
        self, now: Nanos, start_ns: Nanos, sign: bytes, then: Callable[[Nanos], None]
    ) -> None:
        """Send ACK or NAK; go on with ``then`` when it has left."""
        self._stay_busy(now, self._send(start_ns, sign), then)

    def _obey(self, now: Nanos) -> None:
        """The ACK has left: carry out the command, then reply (MSC-LNK-07, MSC-AMB-09)."""
        act = self._verdict.act
        again_ns = None if act is None else act(now)
        if again_ns is None:
            self._send_reply(now)
        else:
            self._stay_busy(now, again_ns, self._obey)

    def _obey_first(self, now: Nanos) -> None:
        """Carry out the command, then send the ACK, if any, at ``_sign_ns`` (MSC-AMB-09)."""
        act, sign = self._verdict.act, self._verdict.sign
        again_ns = None if act is None else act(now)
        if again_ns is not None:
            self._stay_busy(now, again_ns, self._obey_first)
        elif sign:
            self._sign(now, max(now, self._sign_ns), sign, self._send_reply)
        else:
            self._rest(now)

    def _send_reply(self, now: Nanos) -> None:
        """Build and send the reply, if there is one (MSC-PKT-17..19)."""
        if self._verdict.reply is None:
            self._rest(now)
            return
        quirks, request = self._quirks, self._request
        self._rebuild = self._verdict.reply
        self._reply_unit = request[1] if quirks.reply_unit == "echo" else self.unit
        if quirks.reply_block == "echo":
            self._block = request[4] << 8 | request[5]
        elif quirks.reply_block == "counter":
            self._block = self._block + 1 & 0xFFFF
        self._reply = packet(self._reply_unit, self._rebuild(now), self._block)
        self._repeats = 0
        end_ns = self._send(now + self._reply_delay_ns, self._reply)
        self._stay_busy(now, end_ns, self._await_answer)

    def _repeat(self, now: Nanos, start_ns: Nanos) -> None:
        """Send the reply again, if that is still allowed (MSC-LNK-09, MSC-LNK-13)."""
        if self._repeats >= self._repeats_max:
            self._rest(now)
            return
        self._repeats += 1
        self._answer_due = NEVER
        if self._quirks.retransmit_content == "fresh":
            self._reply = packet(self._reply_unit, self._rebuild(now), self._block)
        self._stay_busy(now, self._send(start_ns, self._reply), self._await_answer)

    def _await_answer(self, now: Nanos) -> None:
        """The reply has left: T2 starts (MSC-LNK-08)."""
        self.state = ReceiverState.WAIT
        if self._quirks.ack_timeout_action != "wait":
            self._answer_due = now + self._answer_ns
        self._look_at_kept(now)

    def _rest(self, now: Nanos) -> None:
        """Nothing is under way any more."""
        self.state = ReceiverState.IDLE
        self._kept_due = None
        self._answer_due = NEVER
        self._look_at_kept(now)

    def _keep(self, data: bytes) -> None:
        """Keep what comes in EXEC for later (rule 4)."""
        if self._quirks.rx_while_busy == "buffer":
            limit = BUFFER_BYTES if self._is_paced else UNPACED_BUFFER_BYTES
            self._kept += data[: limit - len(self._kept)]

    def _look_at_kept(self, now: Nanos) -> None:
        """Ready again: what came meanwhile arrives now."""
        if self._kept:
            data = bytes(self._kept)
            self._kept.clear()
            self._take(Chunk(now, data, None))

    # -- bytes to come ---------------------------------------------------------------------------

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` surely bring no effect, and no time limit before it.

        See ``SerialDevice.quiet_prefix``.
        """
        if self._whole_packet_at(data) >= 0:  # by far the most common
            return len(data) - 1
        size = len(data)
        if self._busy_until != NEVER:
            return size
        state, at = self.state, 0
        if self._kept_due is not None:  # what follows this packet may be about the reply
            return 0
        if state is ReceiverState.BODY or state is ReceiverState.DISCARD:
            return min(size, self._missing - 1)
        if state is ReceiverState.HEADER:
            begun = bytes(self._packet)
            return max(0, self._quiet_when_idle(begun + data, 0) - len(begun))
        if state is ReceiverState.SKIP:
            at = self._missing
        elif state is ReceiverState.WAIT:
            at, is_over = self._quiet_while_waiting(data)
            if not is_over:
                return at
        return min(size, self._quiet_when_idle(data, at))

    def _quiet_while_waiting(self, data: bytes) -> tuple[int, bool]:
        """How many bytes bring no effect while the ACK is awaited, and whether it is over then."""
        quirks = self._quirks
        for at, byte in enumerate(data):
            if byte == ACK:
                return at + 1, True
            if byte == NAK:
                return at, False
            reading = quirks.stx_while_waiting if byte == STX else quirks.junk_while_waiting
            if reading == "serve":
                return at, quirks.pending_reply_on_stx == "drop"
            if reading == "abandon":
                return at + 1, True
            if reading == "as_nak":
                return at, False
        return len(data), False

    def _quiet_when_idle(self, data: bytes, at: int) -> int:
        """How many bytes bring no effect, the receiver being idle in front of byte ``at``."""
        size = len(data)
        while at < size:
            if self._heeds_noise and data[at] != STX:
                return at
            at = data.find(STX, at)
            if at < 0:
                return size
            in_time = at + self._packet_bytes  # T1 may run out behind it
            if at + HEADER_BYTES > size:
                return min(size, in_time)
            at = self._quiet_end(data, at)
            if at < 0:
                return min(size, -at, in_time)
            if at > in_time:
                return min(size, in_time)
        return size

    def _quiet_end(self, data: bytes, at: int) -> int:
        """Where the packet that begins at ``at`` ends; negative: the byte that has an effect."""
        length = data[at + 2] << 8 | data[at + 3]
        end = at + FRAME_BYTES + length
        if self._whom_of[data[at + 1]] is Whom.OTHER:
            return at + HEADER_BYTES if self._quirks.other_unit_framing == "hunt_stx" else end
        if length > BODY_MAX and self._quirks.overlength == "nak_after_header":
            end = at + HEADER_BYTES
        return 1 - end


def _nothing(_: Nanos) -> bytes:
    """The reply of a unit that has not replied yet."""
    return b""
