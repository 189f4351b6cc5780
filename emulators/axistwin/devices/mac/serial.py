"""The serial face of a MAC module: expert frames in, replies out, over the axis core.

What belongs to this face and nothing else: framing and sums, the replies, whom a frame concerns
(own address, FF), programming of address (08h) and rate (1Bh), memory reading (28h, 29h), and when
the module is deaf.  What a command means, and when it is taken, the axis knows.

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
5. A new state (ledger §4.1) is told: ``Trace`` of the kind ``state``.
6. A restart acts when its own reply has left (MACS-CMD-00-03); until it is over, all is lost.
"""

from collections.abc import Callable, Mapping
from typing import Final

from axistwin.devices.mac.acceptance import INDEX_COUNT, SIGNIFICANT, state_text
from axistwin.devices.mac.axis import Axis
from axistwin.devices.mac.framing import (
    ADDRESS_MAX,
    ANSWER_LENGTH_FIELD,
    ANY_CASE,
    GENERAL_ADDRESS,
    HEX,
    NACK,
    REQUEST_BYTES,
    UPPER,
    Request,
    answer,
    is_one_frame,
    next_frame,
    number,
    take_apart,
)
from axistwin.devices.mac.memory_map import RATES, four_bytes
from axistwin.devices.mac.models import MODELS, MacModel
from axistwin.devices.mac.quirks import MacQuirks
from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect, Silence, Trace, Transmit
from axistwin.kernel.time import NS_PER_MS, NS_PER_US, Nanos
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk, LineFormat

_NEVER: Final[Nanos] = 1 << 62
RESET_INPUT: Final = "reset"


class MacSerial:
    """One MAC module on a serial line.

    model: ``mac23``, ``mac34-1`` or ``mac34-2``.  address: 0..127; a stored one wins.
    cells: what it stored in an earlier life.  skew_ns: added to its reply latency, so that two
    modules never answer on the very same nanosecond.  alone: no other module is on the line
    (``general_reply_policy`` = lone).  A ``powered`` module is switched on at time 0; a ``started``
    one has its boot time behind it then.
    Raises UsageError for an unknown model or an address out of range.
    """

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
        self.quirks = quirks = quirks or MacQuirks()
        self.model = _model(model).with_limits(quirks)
        self.axis = Axis(self.model, quirks, {"address": address, **(cells or {})})
        self.alone = alone
        self._latency_ns = quirks.reply_latency_us * NS_PER_US + skew_ns
        self._boot_ns = quirks.boot_time_ms * NS_PER_MS
        self._prepare_replies()
        self._take_over_address_and_rate()
        # The receiver.
        self._partial = b""
        self._deaf_until: Nanos = _NEVER
        self._sending_until: Nanos = 0
        # The frame in hand: when its Etx was heard, whether bytes take time, what came of it.
        self._etx_ns: Nanos = 0
        self._paced = True
        self._effects: list[Effect] = []
        # Power, reset input, restart: when each next thing happens.
        self._powered = False
        self._reset_held = False
        self._take_over_at: Nanos = _NEVER
        self._take_over_restarts = False
        self._boot_end: Nanos = _NEVER
        self._due: Nanos = _NEVER
        self._told_state = "off"
        if powered:
            self.power_on(0)
        if powered and started:
            self._boot_end = self._deaf_until = self._due = 0
            self._run_until(0)
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

    def quiet_prefix(self, data: bytes) -> int:
        """Everything before the last byte of the first frame that concerns this module."""
        if not self._partial and is_one_frame(data):
            request = take_apart(data, any_case=self._any_case)
            return REQUEST_BYTES - 1 if self._concerns(request) else REQUEST_BYTES
        kept = len(self._partial)
        buffer = self._partial + data
        start, end = next_frame(buffer, 0)
        while start >= 0:
            if self._concerns(take_apart(buffer[start:end], any_case=self._any_case)):
                return max(0, end - 1 - kept)
            start, end = next_frame(buffer, end)
        return len(data)

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; answer the frames they complete."""
        data, first = chunk.data, 0
        if not self._partial and chunk.start_ns >= self._deaf_until and is_one_frame(data):
            self._take(data, chunk, REQUEST_BYTES - 1)  # by far the most common
            first = REQUEST_BYTES
        while first < len(data):
            if chunk.start_ns < self._deaf_until:
                first = self._first_heard(chunk, first)
            kept = len(self._partial)
            buffer = self._partial + (data[first:] if first else data)
            start, end = next_frame(buffer, 0)
            if start < 0:
                self._partial = buffer[end:]
                break
            self._partial = b""
            first += end - kept
            self._take(buffer[start:end], chunk, first - 1)
        return self._taken_effects()

    def _take(self, frame: bytes, chunk: Chunk, last: int) -> None:
        """Take 21 bytes, completed by byte ``last`` of ``chunk``, if they matter here."""
        request = take_apart(frame, any_case=self._any_case)
        if self._concerns(request):
            self._etx_ns = chunk.arrival_ns(last)
            self._paced = chunk.format is not None
            self._judge(frame, request)

    def _first_heard(self, chunk: Chunk, first: int) -> int:
        """The first byte from ``first`` on that is heard; bytes missed break a frame begun."""
        begin, size = first, len(chunk.data)
        while first < size and chunk.arrival_ns(first) < self._deaf_until:
            first += 1
            if self._deaf_until == _NEVER:
                first = size
        if first > begin:
            self._partial = b""
        return first

    def _concerns(self, request: Request) -> bool:
        """Whether 21 bytes from Stx on may have an effect here (MACS-REPLY-13)."""
        address = request.address
        return address == self.address or address == GENERAL_ADDRESS or self._judges_all

    # ---- frames --------------------------------------------------------------------------------

    def _judge(self, frame: bytes, request: Request) -> None:
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

    def _upper(self, digits: bytes) -> bytes:
        return digits.upper() if self._any_case else digits

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
        if index >= INDEX_COUNT or self.axis.cell(index) == "u":
            return self._unassigned(frame, index)
        parameters = number(frame[10:18], any_case=self._any_case)
        if parameters is None:
            parameters = self._significant_only(frame[10:18], SIGNIFICANT.get(index, 0))
            if parameters is None:
                return self._refused
        return self._command(index, parameters, general=general)

    def _refuses_digits(self, frame: bytes, index: int) -> bool:
        """Whether sub-index or don't-care digits forbid the frame (MACS-AMB-61, -62)."""
        quirks = self.quirks
        if index == 0x28 or index == 0x29:
            if frame[8:10] not in self._digits:
                return True
        elif quirks.subindex_policy == "refuse" and frame[8:10] != b"00":
            return True
        if quirks.dont_care_digits == "refuse":
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
        start_ns = max(self._etx_ns + self._latency_ns, self._sending_until)
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
        face_command = _FACE_COMMANDS.get(index)
        if face_command is not None:
            refused = self.axis.cell(index) == "R"
            return self._refused if refused else face_command(self, parameters, general)
        start_ns = self._etx_ns
        if self.quirks.motion_start_ref == "reply_end":
            start_ns = self._reply_span(len(self._accepted))[1]
        accepted = self.axis.execute(self._etx_ns, index, parameters, start_ns)
        self._collect(self._etx_ns)
        self._reschedule()
        return self._accepted if accepted else self._refused

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
        return self._upper(frame[4:6]) if self._echoes else HEX[self.address]

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

    def _take_over_address_and_rate(self) -> None:
        """Work with the stored address and rate from now on."""
        self.address = self.axis.stored["address"]
        self._line_format = LineFormat(self.axis.stored["baud"])

    # ---- time ----------------------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When something happens by itself: a restart, the end of the boot, an event of motion."""
        return None if self._due == _NEVER else self._due

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""
        self._run_until(now)
        return self._taken_effects()

    def _run_until(self, now: Nanos) -> None:
        """Everything due by ``now``, in the order of time."""
        while self._due <= now:
            due = self._due
            if due == self._take_over_at:
                self._take_over(due)
            elif due == self._boot_end:
                self._boot_end = _NEVER
                self.axis.start(due)
            else:
                self.axis.run(due)
            self._collect(due)
            self._reschedule()

    def _collect(self, now: Nanos) -> None:
        """Take the axis' effects, and tell the state if it is another one."""
        self._effects += self.axis.take_effects()
        state = self._state_code()
        if state != self._told_state:
            self._told_state = state
            self._effects.append(Trace(now, "state", (("value", state),)))

    def _take_over(self, now: Nanos) -> None:
        self._take_over_at = _NEVER
        self._take_over_address_and_rate()
        if self._take_over_restarts:
            self._begin_boot(now)

    def _begin_boot(self, now: Nanos) -> None:
        """Enter BT: motion dropped, deaf for the boot time (MACS-CMD-00-01, -02)."""
        self.axis.shut_down(now)
        self._partial = b""
        self._boot_end = self._deaf_until = now + self._boot_ns

    def _reschedule(self) -> None:
        motion = self.axis.next_event()
        self._due = min(self._take_over_at, self._boot_end, _NEVER if motion is None else motion)

    def _taken_effects(self) -> list[Effect]:
        effects = self._effects
        if effects:
            self._effects = []
        return effects

    def _settle(self, now: Nanos) -> list[Effect]:
        """Close a call from outside that touched the axis."""
        self._collect(now)
        self._reschedule()
        self._run_until(now)
        return self._taken_effects()

    # ---- power, inputs, surroundings -------------------------------------------------------------

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply: everything volatile is gone; the position is saved (MACS-PERS-01)."""
        self._run_until(now)
        if self._powered:
            self._powered = False
            self._take_over_at = self._boot_end = _NEVER
            self._deaf_until, self._sending_until, self._partial = _NEVER, 0, b""
            self.axis.power_off(now)
        return self._settle(now)

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply: boot time, then at rest and unpowered (MACS-AMB-21, -26)."""
        if not self._powered:
            self._powered = True
            self._take_over_address_and_rate()
            self.axis.power_on(now)
            if self._reset_held:
                self._deaf_until = _NEVER
            else:
                self._begin_boot(now)
        return self._settle(now)

    def set_input(self, now: Nanos, name: str, active: bool) -> list[Effect]:
        """Wire input ``name`` to ground (active) or leave it open.

        Names: positive_stop, negative_stop, reference, reset.  Raises UsageError for others.
        """
        self._run_until(now)
        if name == RESET_INPUT:
            self._set_reset_input(now, active)
        else:
            self.axis.set_input(now, name, active)
        return self._settle(now)

    def _set_reset_input(self, now: Nanos, held: bool) -> None:
        """RI while held low, then BT (MACS-IO-01, ledger §4.1)."""
        if not self.quirks.has_reset_input:
            raise UsageError(
                "input reset: this device has none; start it with the quirk has_reset_input=true"
            )
        if held == self._reset_held:
            return
        self._reset_held = held
        if not self._powered:
            return
        if held:
            self._take_over_at = self._boot_end = self._deaf_until = _NEVER
            self._partial, self._sending_until = b"", 0
            self._effects.append(Silence())
            self.axis.shut_down(now)
        else:
            self._take_over_address_and_rate()
            self._begin_boot(now)

    def set_supply(self, now: Nanos, millivolts: int) -> list[Effect]:
        """The supply voltage at the module from now on; cutting it is ``power_off``."""
        self._run_until(now)
        self.axis.set_supply(now, millivolts)
        return self._settle(now)

    def set_temperature(self, now: Nanos, millidegrees: int) -> list[Effect]:
        """The temperature of the electronics, in thousandths of a degree Celsius."""
        self._run_until(now)
        self.axis.set_temperature(now, millidegrees)
        return self._settle(now)

    def set_fault(self, now: Nanos, name: str, present: bool) -> list[Effect]:
        """Let a fault be there or gone: amplifier, encoder (MAC34), micro_cut (a moment only).

        Raises UsageError for other names, and for those that the model does not have.
        """
        self._run_until(now)
        self.axis.set_fault(now, name, present)
        return self._settle(now)

    def set_load(self, now: Nanos, load: Load) -> list[Effect]:
        """What hangs on the shaft from now on."""
        self._run_until(now)
        self.axis.set_load(now, load)
        return self._settle(now)

    def push(self, now: Nanos, increments: int) -> list[Effect]:
        """Turn the shaft by hand, by signed ``increments``, against nothing but the regulation."""
        self._run_until(now)
        self.axis.push(now, increments)
        return self._settle(now)

    # ---- for whoever looks on --------------------------------------------------------------------

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells; the position is the one a power failure would save at ``now``."""
        self._run_until(now)
        return {**self.axis.stored, "position": self.axis.counter_at(now)}

    def is_moving(self, now: Nanos) -> bool:
        """Whether the position changes by itself."""
        self._run_until(now)
        return self.axis.is_moving(now)

    def position_at(self, now: Nanos) -> int:
        """The position counter, as 20h would read it."""
        self._run_until(now)
        return self.axis.reading_at(now)

    def state_code(self, now: Nanos) -> str:
        """The state of ledger §4.1: BT RI OF HD PO VE IN DJ, with +AR or +PL where it applies."""
        self._run_until(now)
        return self._state_code()

    def _state_code(self) -> str:
        if not self._powered:
            return "off"
        if self._reset_held:
            return "RI"
        return "BT" if self._boot_end != _NEVER else self.axis.state_code()

    def describe(self, now: Nanos) -> dict[str, int | str | bool]:
        """Named state for panels and failing tests."""
        state = self.state_code(now)
        return {
            "model": self.model.name,
            "address": self.address,
            "baud": self._line_format.baud,
            "state": state,
            "state_text": state_text(state),
            **self.axis.describe(now),
        }


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
