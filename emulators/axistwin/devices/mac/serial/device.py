"""The serial face of a MAC module: expert frames in, replies out, over the axis core.

What belongs to this face and nothing else: framing and sums, the replies, whom a frame concerns
(own address, FF), programming of address (08h) and rate (1Bh), memory reading (28h, 29h), and when
the UART is deaf.  What a command means, and when it is taken, the axis knows; power, restarts and
surroundings are the module's.

Time at the receiver
--------------------

    host   |Stx ... Etx|                            (next request)
    module             |-latency-|Ack Xoff ... Xon|
    hears              |-------- lost ------------|               rx_during_xoff = lost
                       etx                        end of reply    00h 01h 1Bh: then deaf for 2 s

Rules
-----
1. A frame is Stx and 20 bytes that are not Stx (MACS-FRAME-10, -11).  Byte 20 must be Etx and the
   length field right, else it never was (MACS-FRAME-12).  No clock runs between bytes (-14).
2. First the sum, then the digits, then the index, then acceptance (MACS-REPLY-06).
3. One reply per frame, nothing unasked (MACS-REPLY-12).  To FF module 00 replies (MACS-MULTI-03).
4. What a command stores stands in front of its reply in the list of effects.
5. A restart acts when its own reply has left (MACS-CMD-00-03); until it is over, all is lost.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from axistwin.devices.mac.axis.acceptance import SIGNIFICANT
from axistwin.devices.mac.axis.memory_map import RATES, four_bytes
from axistwin.devices.mac.axis.models import MODELS, MacModel
from axistwin.devices.mac.axis.module import MacModule, ModuleSnapshot
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.devices.mac.serial.framing import (
    ADDRESS_MAX,
    ANSWER_LENGTH_FIELD,
    ANY_CASE,
    GENERAL_ADDRESS,
    HEX,
    NACK,
    REQUEST_BYTES,
    UPPER,
    FrameReception,
    MacRequest,
    answer,
    next_frame,
    number,
    take_apart,
)
from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect, Transmit
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_US, Nanos
from axistwin.wire.framing import Chunk, LineFormat


@dataclass(frozen=True, slots=True)
class SerialModuleSnapshot(ModuleSnapshot):
    """A module on a serial line; ``baud`` is the rate in use."""

    baud: int


class MacSerial(MacModule):
    """One MAC module on a serial line.

    model: ``mac23``, ``mac34-1`` or ``mac34-2``.  address: 0..127; a stored one wins.
    cells: what it stored in an earlier life.  skew_ns: added to its reply latency, so that two
    modules never answer on the very same nanosecond.  alone: no other module is on the line
    (``general_reply_policy`` = lone).  A ``powered`` module is switched on at time 0; a ``started``
    one has its boot time behind it then.
    Raises UsageError for an unknown model or an address out of range.
    """

    is_full_duplex: Final = False
    """RS-485 on one pair of wires."""

    drops_bad_characters: Final = True
    """As if they had never been (ledger §2)."""

    def __init__(
        self,
        model: str | MacModel,
        address: int = 0,
        *,
        quirks: MacQuirks | None = None,
        cells: Mapping[str, int] | None = None,
        skew_ns: int = 0,
        alone: bool = True,
        powered: bool = True,
        started: bool = True,
    ) -> None:
        if not 0 <= address <= ADDRESS_MAX:
            raise UsageError(f"address {address:02X}h is not in 00h..7Fh, the addresses of a MAC")
        quirks = quirks or MacQuirks()
        limited = _model(model).with_limits(quirks)
        super().__init__(limited, quirks, {"address": address, **(cells or {})})
        self.alone = alone
        self._latency_ns = quirks.reply_latency_us * NS_PER_US + skew_ns
        self._prepare_replies()
        self._take_over_stored()
        # The receiver.
        self.reception = FrameReception(any_case=self._any_case)
        self._deaf_until: Nanos = NEVER
        self._sending_until: Nanos = 0
        # The frame in hand: when its Etx was heard, whether bytes take time, what came of it.
        self._etx_ns: Nanos = 0
        self._paced = True
        if powered:
            self._switch_on(started=started)
        self._effects.clear()  # it has been so for long

    def _prepare_replies(self) -> None:
        """Everything about replies that the quirks decide once for all."""
        quirks = self.quirks
        self._xon = quirks.xon_byte
        self._accepted = bytes((0x06, 0x13, quirks.xon_byte))
        self._refused = bytes((0x06, 0x13, quirks.xonerror_byte))
        self._any_case = quirks.lowercase_hex == "accept"
        self._digits = ANY_CASE if self._any_case else UPPER
        self._loses = quirks.rx_during_xoff == "lost"
        self._judges_all = quirks.nack_scope != "addressed"
        self._wants_sub_index_00 = quirks.subindex_policy == "refuse"
        self._wants_digits_0 = quirks.dont_care_digits == "refuse"
        self._starts_at_reply_end = quirks.motion_start_ref == "reply_end"
        self._echoes = quirks.general_echo == "as_sent"
        self._answer_forms = {
            index: (b"%X" % (index & 0xF), ANSWER_LENGTH_FIELD) for index in range(0x20, 0x30)
        }
        self._answer_forms[0x21] = (quirks.status_reply_digit.encode(), ANSWER_LENGTH_FIELD)
        self._answer_forms[0x23] = (quirks.reply23_digit.encode(), ANSWER_LENGTH_FIELD)
        self._answer_forms[0x28] = (b"8", quirks.reply28_length.encode())

    # ---- receiver ------------------------------------------------------------------------------

    @property
    def line_format(self) -> LineFormat:
        """8N1 at the rate in use (MACS-LINE-01)."""
        return self._line_format

    @property
    def listener(self) -> "MacSerial":
        """What modules have heard, they may share."""
        return self

    def heeded_address(self, now: Nanos) -> int | None:
        """Its own, as long as it hears all and other modules' frames are none of its business."""
        return None if self._judges_all or now < self._deaf_until else self.address

    def quiet_prefix(self, data: bytes) -> int:
        """Everything before the last byte of the first frame that concerns this module."""
        request = self.reception.lone_request(data)
        if request is not None:  # by far the most common
            return REQUEST_BYTES - self._concerns(request)
        return self.reception.quiet_prefix(data, None if self._judges_all else (self.address,))

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; answer the frames they complete."""
        data, first = chunk.data, 0
        request = self.reception.lone_request(data)
        if request is not None and chunk.start_ns >= self._deaf_until:
            self.reception.partial = b""
            self._take(data, request, chunk, REQUEST_BYTES - 1)
            return self._taken_effects()
        while first < len(data):
            if chunk.start_ns < self._deaf_until:
                first = self._first_heard(chunk, first)
            kept = len(self.reception.partial)
            buffer = self.reception.partial + (data[first:] if first else data)
            start, end = next_frame(buffer, 0)
            if start < 0:
                self.reception.partial = buffer[end:]
                break
            self.reception.partial = b""
            first += end - kept
            frame = buffer[start:end]
            self._take(frame, take_apart(frame, self._any_case), chunk, first - 1)
        return self._taken_effects()

    def _take(self, frame: bytes, request: MacRequest, chunk: Chunk, last: int) -> None:
        """Take 21 bytes, completed by byte ``last`` of ``chunk``, if they matter here."""
        if self._concerns(request):
            self._etx_ns = chunk.arrival_ns(last)
            self._paced = chunk.format is not None
            self._judge(frame, request)

    def _first_heard(self, chunk: Chunk, first: int) -> int:
        """The first byte from ``first`` on that is heard; bytes missed break a frame begun."""
        begin, size = first, len(chunk.data)
        while first < size and chunk.arrival_ns(first) < self._deaf_until:
            first += 1
            if self._deaf_until == NEVER:
                first = size
        if first > begin:
            self.reception.partial = b""
        return first

    def _concerns(self, request: MacRequest) -> bool:
        """Whether 21 bytes from Stx on may have an effect here (MACS-REPLY-13)."""
        address = request.address
        return address == self.address or address == GENERAL_ADDRESS or self._judges_all

    # ---- frames --------------------------------------------------------------------------------

    def _judge(self, frame: bytes, request: MacRequest) -> None:
        """Take 21 bytes that begin with Stx: rules 1 to 3."""
        if self._etx_ns >= self._due:
            self._run_until(self._etx_ns)
        address = request.address
        general = address == GENERAL_ADDRESS
        replies = address == self.address or (general and self._answers_general())
        if not request.is_framed:
            reply = NACK if replies and self.quirks.bad_frame_reply == "nack" else None
        elif not request.is_sum_right:
            reply = NACK if self._nacks(replies=replies) else None
        elif address == self.address or general:
            reply = self._obey(frame, request.command, general=general)
            if not replies:
                reply = None
        else:
            return
        if reply is not None:
            self._transmit(reply)

    def _answers_general(self) -> bool:
        """Whether this module replies to frames to FF (MACS-AMB-16)."""
        policy = self.quirks.general_reply_policy
        if policy == "lone":
            return self.alone or self.address == 0
        return policy == "all" or (policy == "addr00_only" and self.address == 0)

    def _nacks(self, *, replies: bool) -> bool:
        """Whether this module answers a wrong sum (MACS-AMB-19)."""
        if not self._judges_all:
            return replies
        return self.quirks.nack_scope == "any" or self.address == 0

    def _obey(self, frame: bytes, index: int | None, *, general: bool) -> bytes | None:
        """Execute a frame whose sum is right; its reply, or None for silence."""
        if index is None or self._refuses_digits(frame, index):
            return self._refused
        if 0x20 <= index < 0x2A:
            return self._query(frame, index)
        if not self.axis.is_assigned(index):
            return self._unassigned(frame, index)
        parameters = number(frame[10:18], any_case=self._any_case)
        if parameters is None:
            parameters = self._significant_only(frame[10:18], SIGNIFICANT.get(index, 0))
            if parameters is None:
                return self._refused
        return self._command(index, parameters, general=general)

    def _refuses_digits(self, frame: bytes, index: int) -> bool:
        """Whether sub-index or don't-care digits forbid the frame (MACS-AMB-61, -62)."""
        if index == 0x28 or index == 0x29:
            if frame[8:10] not in self._digits:
                return True
        elif self._wants_sub_index_00 and frame[8:10] != b"00":
            return True
        if self._wants_digits_0:
            mask = b"%08X" % SIGNIFICANT.get(index, 0)
            return any(m == 0x30 != d for m, d in zip(mask, frame[10:18], strict=True))
        return False

    def _significant_only(self, digits: bytes, mask: int) -> int | None:
        """The parameters with 0 for the digits that do not matter (MACS-FRAME-06, -13)."""
        shown = b"%08X" % mask
        kept = bytes(0x30 if m == 0x30 else d for m, d in zip(shown, digits, strict=True))
        return number(kept, any_case=self._any_case)

    def _reply_span(self, size: int) -> tuple[Nanos, Nanos]:
        """Start and end of a reply of ``size`` bytes to the frame in hand."""
        start_ns = self._etx_ns + self._latency_ns
        if start_ns < self._sending_until:
            start_ns = self._sending_until
        return start_ns, start_ns + (self._line_format.span_ns(size) if self._paced else 0)

    def _transmit(self, data: bytes) -> None:
        """Queue a reply; until it has left, the receiver is off (MACS-REPLY-15)."""
        start_ns, end_ns = self._reply_span(len(data))
        self._effects.append(Transmit(start_ns, data))
        self._sending_until = end_ns
        if self._loses and end_ns > self._deaf_until:
            self._deaf_until = end_ns

    # ---- commands and queries ------------------------------------------------------------------

    def _command(self, index: int, parameters: int, *, general: bool) -> bytes | None:
        """Execute command ``index``; its reply, or None for silence."""
        if self.axis.is_locked(index, parameters):
            self._tell_refusal(self._etx_ns, index, is_locked=True)
            return self._refused
        face_command = _FACE_COMMANDS.get(index)
        if face_command is not None:
            return face_command(self, parameters, general)
        now = start_ns = self._etx_ns
        if self._starts_at_reply_end:
            start_ns = self._reply_span(len(self._accepted))[1]
        accepted = self.axis.execute(now, index, parameters, start_ns)
        self._collect(now)
        self._reschedule()
        if accepted:
            return self._accepted
        self._tell_refusal(now, index, is_locked=False)
        return self._refused

    def _unassigned(self, frame: bytes, index: int) -> bytes | None:
        """The reply to an index nobody assigned (MACS-AMB-58)."""
        policy = self.quirks.unknown_index
        if policy == "zero_answer" and index >= 0x20:
            return answer(self._echo(frame), b"%X" % (index & 0xF), 0, xon=self._xon)
        if policy == "silence":
            return None
        return self._refused if policy == "refuse" else self._accepted

    def _query(self, frame: bytes, index: int) -> bytes:
        """The answer to query ``index`` (MACS-REPLY-07..10)."""
        if index < 0x28:
            data = self.axis.query(self._etx_ns, index)
        else:
            image = self.axis.memory(self._etx_ns, ram=index == 0x28)
            wraps = self.quirks.mem_wrap == "wrap"
            data = four_bytes(image, self._digits[frame[8:10]], wraps=wraps)
        digit, length = self._answer_forms[index]
        return answer(self._echo(frame), digit, data, length, self._xon)

    def _echo(self, frame: bytes) -> bytes:
        """The address in an answer to ``frame`` (MACS-REPLY-08, MACS-AMB-17)."""
        if not self._echoes:
            return HEX[self.address]
        return frame[4:6].upper() if self._any_case else frame[4:6]

    def _initialise(self, _: int, __: bool) -> bytes | None:
        """00h: restart when the reply has left (MACS-CMD-00-01..03)."""
        return self._restart(self.quirks.reset_reply == "ack")

    def _restore_factory(self, _: int, __: bool) -> bytes | None:
        """01h: factory values, address 00, 38400 baud, then like 00h (MACS-CMD-01-01..03)."""
        self.axis.restore_factory_values(self._etx_ns)
        self._effects += self.axis.take_effects()
        restarts = self.quirks.factory_reset_scope == "restart"
        return self._restart(self.quirks.reset_reply == "ack", restarts=restarts)

    def _program_address(self, parameters: int, general: bool) -> bytes | None:
        """08h: the last byte is the new address (MACS-CMD-08-01..03)."""
        address = parameters & 0xFF
        if self.quirks.addr_prog_requires_ff and not general:
            return self._refused
        if address > ADDRESS_MAX and self.quirks.addr_range == "refuse":
            return self._refused
        self.axis.parameters.store("address", address & ADDRESS_MAX)
        self._effects += self.axis.take_effects()
        if self.quirks.addr_effective == "at_once":
            self.address = address & ADDRESS_MAX
        return self._accepted

    def _set_rate(self, parameters: int, _: bool) -> bytes | None:
        """1Bh: new rate, restart (MACS-CMD-1B-01)."""
        code = self.axis.parameters.in_printed_set(parameters & 0xFF, tuple(RATES), 0x03)
        if code is None:
            return self._refused
        self.axis.parameters.store("baud", RATES[code])
        self._effects += self.axis.take_effects()
        if self.quirks.baud_reply_rate == "new":
            self._line_format = LineFormat(RATES[code])
        return self._restart(True)

    def _restart(self, acknowledged: bool, *, restarts: bool = True) -> bytes | None:
        """Take over address and rate when the reply has left, and start anew if it ``restarts``.

        A module that executes mutely does so at the same time (MACS-MULTI-03).
        """
        end_ns = self._reply_span(len(self._accepted))[1] if acknowledged else self._etx_ns
        self._take_over_at, self._take_over_restarts = end_ns, restarts
        if restarts:
            self._deaf_until = end_ns + self._boot_ns
        self._reschedule()
        return self._accepted if acknowledged else None

    # ---- what the module tells its face ----------------------------------------------------------

    def _take_over_stored(self) -> None:
        """Work with the stored address and rate from now on."""
        super()._take_over_stored()
        self._line_format = LineFormat(self.axis.stored["baud"])

    def _hear_nothing(self, until: Nanos) -> None:
        """The UART is off ``until`` then (MACS-CMD-00-02)."""
        self._deaf_until, self._sending_until = until, 0
        self.reception = FrameReception(any_case=self._any_case)  # also where it was shared

    def describe(self, now: Nanos) -> SerialModuleSnapshot:
        """Everything worth showing."""
        return SerialModuleSnapshot(**self.facts(now), baud=self._line_format.baud)


_FACE_COMMANDS: Final[dict[int, Callable[[MacSerial, int, bool], bytes | None]]] = {
    0x00: MacSerial._initialise,
    0x01: MacSerial._restore_factory,
    0x08: MacSerial._program_address,
    0x1B: MacSerial._set_rate,
}
"""Commands that this face executes itself; acceptance is the axis' all the same."""


def _model(model: str | MacModel) -> MacModel:
    if isinstance(model, MacModel):
        return model
    if model not in MODELS:
        raise UsageError(f"unknown model {model!r}: {nearest(model, MODELS)}")
    return MODELS[model]
