"""Exchanges with one board: a request there, and the packets that answer it.

Rules.

1. A reply has no length and no announced number of packets.  After START one more packet comes,
   after anything else none (MN4-RSP-03, MN4-RSP-04); only the listing of a program has as many as
   it has lines.  What comes beyond that is left for who looks for it (`strays_now`).
2. After doubt about framing a board may take the next request for the end of a cut one: then the
   caller waits out its receive time-out before he asks anything (MN4-PKT-15).
3. Where bytes may get lost, what reads is sent again below the checks; what sets a value too, for
   it sets the same one, and what a board says it has not taken.  What moves, stores or counts is
   not: that voids the attempt.
4. Whether a board is at some id and rate is asked by `seek`: what comes of that, or does not, says
   nothing of the line, and nothing of a board that is elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, WAITED, Observation
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.codec import BoardPacket, ReturnCode
from axistwin_conformance.families.mn400.grammar import ReplyForm, rule_of
from axistwin_conformance.transport.serial import SerialTransport

RECEIVED_AT_ONCE: Final = 4096
QUIET_S: Final = 0.1  # after which a board that is talking has ended
REPLY_LIMIT_S: Final = 0.25  # MN4 9.3: of any reply, before it begins
MEASURES_S: Final = {1: 0.1, 2: 1.0}  # by the parameter of E (MN4-MEA-01)
LONGEST_PACKET: Final = 16_384  # bytes: a program may come in one
LONGEST_TEXT: Final = 69  # characters of a legal request
MOST_STRAYS: Final = 512  # bytes of no packet that are worth reading
MOST_LINES: Final = 4096  # of a listing: more than 8 KiB hold
REPEATABLE: Final = frozenset("/?SNE[:*RVFBDPXGYI;L|Q")  # rule 3
NOT_TAKEN: Final = (("TIMEOUT",), ("CHKSUMERROR",))  # replies to what has done nothing
SLOT_GAP_S: Final = 0.002  # MN4-DROP-03
TIMEOUT_MARGIN_S: Final = 0.1


@dataclass(frozen=True, slots=True)
class BoardExchange:
    """A request and what came of it.

    `found`: the packets; `strays`: what belongs to none.  Times (ns, of the target's clock):
    `asked_ns` when sending began, `came_ns` when each packet was there.  `done_codes`: the codes
    that say of this board that it has obeyed, beside DONE.
    """

    request: bytes
    found: tuple[BoardPacket, ...]
    strays: bytes = b""
    asked_ns: int = 0
    came_ns: tuple[int, ...] = ()
    done_codes: frozenset[str] = frozenset()

    @property
    def codes(self) -> tuple[str, ...]:
        """What the packets say, in their order."""
        return tuple(
            "DONE" if one in self.done_codes else one for one in codec.codes_of(self.found)
        )

    @property
    def raw(self) -> bytes:
        """All that came; strays stand behind the packets."""
        return b"".join(packet.raw for packet in self.found) + self.strays

    @property
    def is_silence(self) -> bool:
        """True if nothing came at all."""
        return not self.raw

    @property
    def is_sound(self) -> bool:
        """True for sound packets and nothing else."""
        return bool(self.found) and not self.strays and all(one.is_sound for one in self.found)

    @property
    def value(self) -> BoardPacket | None:
        """The first data packet."""
        return next((packet for packet in self.found if packet.code is None), None)

    @property
    def done_ns(self) -> int:
        """When the last packet was there; when it was asked, if none came."""
        return self.came_ns[-1] if self.came_ns else self.asked_ns

    def says(self, *codes: str) -> bool:
        """True if sound packets say exactly that."""
        return self.is_sound and self.codes == codes

    def __str__(self) -> str:
        return words.explain_reply(self.raw) or "nothing"

    def observed(self) -> Observation:
        """What the board did with the packet, in words."""
        did = f"was answered with {self}" if self.raw else f"got no answer{WAITED}"
        return Observation(f"{REQUEST} {did}", str(self), "", self.request, is_whole=False)


class BoardClient:
    """One board on the line: what is said to it and what it says."""

    def __init__(self, session: Session, board: int | None = None) -> None:
        self.session = session
        self.board = session.address if board is None else board
        self.target: SerialTransport = session.target

    # --- one way ----------------------------------------------------------------------------------

    def request(self, text: str | bytes) -> bytes:
        """A sound packet for this board."""
        return codec.request(self.board, text)

    def send(self, raw: bytes) -> int:
        """Send the bytes as they are; return when that began (ns)."""
        return self.target.send(raw)

    def listen(self, seconds: float) -> bytes:
        """All that comes within so long."""
        return self.target.receive(RECEIVED_AT_ONCE, seconds)

    def strays_now(self) -> bytes:
        """What still comes, although the reply is over."""
        return self.listen(QUIET_S + self.target.uncertainty_ns / 1e9)

    def receive_packet(self, timeout_s: float) -> tuple[BoardPacket | None, bytes]:
        """The next packet, and what came before it or instead of it; `timeout_s` (s) until its
        first byte, the rest has the time it takes on the line."""
        strays, received = b"", self.target.receive(self._missing(b""), timeout_s)
        while received and received[0] < codec.ADDRESS_MARK and len(strays) < MOST_STRAYS:
            strays += received
            received = self.target.receive(self._missing(b""), timeout_s)
        while received and not codec.packet_end(received) and len(received) < LONGEST_PACKET:
            more = self.target.receive(self._missing(received), self.session.reply_timeout_s)
            if not more:
                break
            received += more
        if not codec.packet_end(received):
            return None, strays + received
        return codec.parse(received), strays

    def _missing(self, received: bytes) -> int:
        """How many bytes may be read at once without reading beyond this packet."""
        if end := codec.packet_end(received + self.target.upcoming):
            return end - len(received)
        if not received or (len(received) > 1 and received[-1] >= codec.ADDRESS_MARK):
            return 1
        return codec.LEAST_PACKET - 2  # its second address, and the checksum

    # --- waiting ----------------------------------------------------------------------------------

    @property
    def frame_timeout_s(self) -> float:
        """For how long a board waits for the rest of a frame, as measured or by default."""
        return int(self.session.reading("rx_timeout_ms")) / 1000

    def forget_frame(self) -> bytes:
        """Wait until a board has given up what it took for a frame (rule 2); return what came."""
        return self.listen(self.frame_timeout_s + TIMEOUT_MARGIN_S)

    def limit_s(self, text: str) -> float:
        """How long to wait for the first byte of each packet of a reply."""
        own_s = max(0, len(text) - LONGEST_TEXT) * self.target.byte_ns / 1e9  # it must be there
        return self.session.reply_timeout_s + own_s + self.later_s(text)

    def later_s(self, text: str) -> float:
        """How much later than others a reply is due: it measures first, or waits for its slot."""
        mode = text[1:].replace(" ", "")  # some boards skip spaces (MN4-AMB-68)
        measure = MEASURES_S.get(codec.number_in(mode), 0.0) if mode.isdigit() else 0.0
        later_s = {"E": measure, "*": self.poll_slot_s() * (self.board - 1)}
        return later_s.get(text[:1].upper(), 0.0)

    def poll_slot_s(self) -> float:
        """How long a board waits with a poll's reply for each id below its own (MN4-DROP-03)."""
        reading = self.session.reading("poll_slot_ms")
        return self.usual_slot_s() if reading == "auto" else float(reading) / 1000

    def usual_slot_s(self, value_bytes: int = codec.STATUS_BYTES) -> float:
        """The same by default, where the last packet of a reply is so long (MN4-DROP-04)."""
        reply_bytes = codec.STATUS_BYTES + value_bytes
        return reply_bytes * self.target.byte_ns / 1e9 + SLOT_GAP_S

    # --- both ways --------------------------------------------------------------------------------

    def ask(self, text: str | bytes, **how: float) -> BoardExchange:
        """Send a sound request with that text; `how` is as `ask_raw` takes it."""
        return self.ask_raw(self.request(text), **how)

    def ask_raw(self, raw: bytes, timeout_s: float | None = None) -> BoardExchange:
        """Send a packet and take the packets that come of it (rules 1 and 3).

        `timeout_s`: until the first byte of each; None: as long as a board may take.
        """
        return self._believed(self._once(raw, timeout_s), timeout_s)

    def ask_again(self, wanted: bytes) -> BoardExchange:
        """Send &, to which what is `wanted` is good, though it may say what noise is answered."""
        exchange = self._once(self.request("&"), None)
        return exchange if exchange.raw == wanted else self._believed(exchange, None)

    def _believed(self, exchange: BoardExchange, timeout_s: float | None) -> BoardExchange:
        """The same, or what came in the end (rule 3)."""
        raw = exchange.request
        if self.target.is_lossless:
            return exchange
        packet = codec.parse(raw)
        is_own = packet is not None and packet.is_sound and packet.board == self.board
        if not is_own or packet is None:
            return exchange
        done_ns, later_ns = exchange.done_ns, round(self.later_s(packet.text) * 1e9)
        self.target.note_exchange(
            raw, len(exchange.raw), exchange.asked_ns, done_ns=done_ns, later_ns=later_ns
        )
        return self._undisturbed(exchange, packet, timeout_s)

    def seek(self, most: int | None = None) -> BoardExchange:
        """Poll a board that need not be there, or must not be (rule 4), until it answers, or so
        often in vain; `most`: None: as often as noise does not make a board silent."""
        raw = self.request("*")
        exchange = self._once(raw, None)
        needed = 1 if self.target.is_lossless else self.session.run.quality.alike_needed
        for _ in range(1, needed if most is None else most):
            if self._is_good(exchange, "*"):
                break
            self.forget_frame()
            exchange = self._once(raw, None)
        return exchange

    def ask_all(self, text: str, limit_s: float) -> BoardExchange:
        """Send a request to all boards; what comes within so long (s), whosever it is."""
        raw = codec.request(codec.ALL_BOARDS, text)
        self.target.drain()
        asked_ns = self.target.send(raw)
        deadline_ns = self.target.now_ns + round(limit_s * 1e9)
        found, strays = list[BoardPacket](), b""
        came_ns: list[int] = []
        while (left_ns := deadline_ns - self.target.now_ns) > 0:
            got, before = self.receive_packet(left_ns / 1e9)
            strays += before
            if got is not None:
                found.append(got)
                came_ns.append(self.target.now_ns)
        return BoardExchange(raw, tuple(found), strays, asked_ns, tuple(came_ns))

    def _undisturbed(
        self, exchange: BoardExchange, packet: BoardPacket, timeout_s: float | None
    ) -> BoardExchange:
        """Send again until noise is not the reason for what came (rule 3)."""
        bad: list[bytes] = []
        for _ in range(RETRY.exchange):
            is_good = self._is_good(exchange, packet.text)
            if self.session.is_believed(bad, exchange.raw, is_good=is_good):
                break
            told = f"{words.explain_request(exchange.request)}: {exchange}"
            if not (self._is_repeatable(packet) or exchange.codes in NOT_TAKEN):
                if self.session.check is not None:
                    self.session.void_attempt(told)
                break
            self.session.record_retry(told)
            self.forget_frame()
            exchange = self._once(exchange.request, timeout_s)
        return exchange

    def _is_repeatable(self, packet: BoardPacket) -> bool:
        """Whether a board that has obeyed already does nothing else when told again."""
        takes_number = self.session.reading("hold_takes_arg") == "true"
        is_off = packet.text == "J0" or (packet.text == "H0" and takes_number)
        return is_off or packet.command.upper() in REPEATABLE

    def _is_good(self, exchange: BoardExchange, text: str) -> bool:
        """True if a board could say that to a sound request."""
        is_bad = "CHKSUMERROR" in exchange.codes or "TIMEOUT" in exchange.codes
        rule = rule_of(text)
        is_listing = rule is not None and rule.form is ReplyForm.LISTING
        is_whole = exchange.codes[-1:] != ("START",) or is_listing  # an empty program has no line
        return exchange.is_sound and is_whole and not is_bad

    def _once(self, raw: bytes, timeout_s: float | None) -> BoardExchange:
        self.target.drain()
        asked_ns = self.target.send(raw)
        packet = codec.parse(raw)
        text = "" if packet is None else packet.text
        limit_s = self.limit_s(text) if timeout_s is None else timeout_s
        found, strays = list[BoardPacket](), b""
        came_ns: list[int] = []
        while len(found) < MOST_LINES:
            got, before = self.receive_packet(limit_s)
            strays += before
            if got is None:
                break
            found.append(got)
            came_ns.append(self.target.now_ns)
            if self._is_over(text, found):
                break
            limit_s = self._next_limit_s(text, found, limit_s)
        done_codes = self._done_codes(found)
        return BoardExchange(raw, tuple(found), strays, asked_ns, tuple(came_ns), done_codes)

    def _done_codes(self, found: list[BoardPacket]) -> frozenset[str]:
        """MOVE_ABORT, of a board that says so for DONE while its last motion is aborted."""
        if all(one.code != ReturnCode.MOVE_ABORT for one in found):
            return frozenset()
        is_so = self.session.run.readings.guess("move_abort_use", "") == "while_aborted"
        return frozenset({ReturnCode.MOVE_ABORT.name}) if is_so else frozenset()

    def _is_over(self, text: str, found: list[BoardPacket]) -> bool:
        """True if a reply has all its packets (rule 1)."""
        if found[-1].code == ReturnCode.START:
            return False
        if found[-1].code == ReturnCode.BAUDCHANGEOK:
            return self.session.reading("baud_reply") != "plus_done"
        rule = rule_of(text)
        is_listing = rule is not None and rule.form is ReplyForm.LISTING
        return not is_listing or found[-1].code is not None

    def _next_limit_s(self, text: str, found: list[BoardPacket], limit_s: float) -> float:
        """Lines of a listing follow one another at once."""
        return QUIET_S if text[:1].upper() == "R" and len(found) > 1 else limit_s
