"""One MN400 on a serial line and on USB: its ports, its supply, its inputs and outputs.

::

    line --- PacketReceiver --- Interpreter --- Mover, Jogger --- motion
    USB  ----------------------     |           ProgramStore, Inputs
    ReplySender (one per port) <---------'

Rules
-----
1. A command acts when its packet is complete; its reply begins after the response delay.  A poll's
   reply, and each reply to a command for all boards, waits for the slots of the lower numbers
   (MN4-CMD-POLL-02, MN4-DROP-03, MN4-DROP-04).
2. Number and rate are volatile: 1 and 9600 at power-up (MN4-CMD-ADDR-03, MN4-CMD-BAUD-03).  Then
   the configuration program runs, line by line, each when the replies to the one before have left;
   they are sent like those to a host (MN4-NVM-05, MN4-NVM-07).
3. A board at another number or rate than those has a configuration program that sets them: there is
   no other way to be there at power-up.
4. USB has neither numbers nor sums, and says nothing but values and errors (ledger §2.8).
5. With reply_transport=both USB tells what the serial line tells, when that does: a reply is made
   once, as to read or to measure twice gives two values (MN4-AMB-66).
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from axistwin.devices.mn400.acceptance import BoardState
from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.inputs import JOGS, LIMITS, Inputs
from axistwin.devices.mn400.jog import Jogger
from axistwin.devices.mn400.link import packets
from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.ports import Answer, BoardLine, Origin
from axistwin.devices.mn400.link.receiver import Flaw, PacketReceiver, Request
from axistwin.devices.mn400.link.sender import Reply, ReplyPart, ReplySender
from axistwin.devices.mn400.motion import PulseTrain
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import Four, added
from axistwin.devices.mn400.quirks import Mn400Quirks, parse_decimal
from axistwin.devices.mn400.readout import MEASURES_MS
from axistwin.devices.mn400.store import ProgramStore
from axistwin.devices.snapshot import Snapshot
from axistwin.devices.traces import Refused, ReportReady, StateChanged
from axistwin.errors import UsageError
from axistwin.kernel.effects import Effect, Store, Transmit
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, NS_PER_US, Nanos
from axistwin.wire.framing import Chunk, LineFormat

RATES: Final = (9600, 19200, 38400, 57600, 115200)
NUMBERS: Final = range(1, 128)
USB_QUEUE: Final = 8
"""Reports that a host keeps; the oldest one is dropped for the next (ledger §2.8)."""

_FORMATS: Final = tuple(LineFormat(rate) for rate in RATES)
_LONG_AGO_NS: Final = -1_000_000 * NS_PER_S
_SLOT_GAP_NS: Final = 2 * NS_PER_MS
_COUNTERS: Final = 4 * len("-2147483648") + 3
_VALUE_BYTES: Final = {"/": 3, "?": 0, "S": 6, "[": 1, ":": 9, "N": _COUNTERS, "E": _COUNTERS}
"""The longest value of each command (MN4-DROP-04)."""

_COUNT_BYTES: Final = len(",4294967295")
_MEASURES_MS: Final = {b"%d" % number: ms for number, ms in MEASURES_MS.items()}
SPINDLE_PULSES: Final = 2000
"""Of an encoder on the spindle, in one turn: then comes its index pulse."""

_SILENT_ON_USB: Final = (
    ReturnCode.START,
    ReturnCode.DONE,
    ReturnCode.MOVE_ABORT,
    ReturnCode.BAUDCHANGEOK,
)
_FLAWLESS, _SERIAL, _USB = Flaw.NONE, Origin.SERIAL, Origin.USB
"""Compared for each line: as an attribute of its class a member takes ten times as long."""
_FLAW_CODES: Final = {
    Flaw.TOO_LONG: ReturnCode.SLAVEBUFFOV,
    Flaw.CHECKSUM: ReturnCode.CHKSUMERROR,
    Flaw.ADDRESS: ReturnCode.ADDRESS_ERROR,
    Flaw.NO_COMMAND: ReturnCode.NO_COMMAND,
}
_OUTCOMES: Final = (ReturnCode.NOMOVEPENDING, ReturnCode.MOVEPENDING)


@dataclass(frozen=True, slots=True)
class BoardSnapshot(Snapshot):
    """A board at one instant.

    remaining: steps not made (N).  queued: commands behind what runs.  outputs: the numbers of
    those that are on.
    """

    address: int
    baud: int
    state: str
    state_text: str
    counters: list[int]
    remaining: list[int]
    queued: int
    exit_code: int
    outputs: list[int]
    inputs_status: int
    feed_pot_permille: int
    jog_pot_permille: int
    spindle_millihertz: int
    program_lines: list[str]
    configuration_lines: list[str]


class Mn400Board:
    """One board.

    number: 1..127, at which it is when it has started (rule 3).  baud: likewise.  cells: what it
    stored in an earlier life; they hold instead of both.  skew_ns: how much later than its siblings
    it answers.  alone: no other board is on the line (``transport`` = auto).  A ``powered`` board
    was switched on long before time 0.  Raises UsageError for what a board cannot be.
    """

    drops_bad_characters = True

    def __init__(
        self,
        number: int = 1,
        *,
        quirks: Mn400Quirks | None = None,
        cells: Mapping[str, int] | None = None,
        skew_ns: Nanos = 0,
        alone: bool = True,
        powered: bool = True,
    ) -> None:
        self.quirks = quirks = quirks or Mn400Quirks()
        if number not in NUMBERS:
            raise UsageError(f"address {number} is not in 1..127")
        if number != 1 and not quirks.address_settable:
            raise UsageError(f"address {number}: with address_settable=false it is always 1")
        self.is_full_duplex = quirks.transport == "rs232" or (quirks.transport == "auto" and alone)
        self.store = ProgramStore(quirks)
        self._restore(number, cells or {})
        self.inputs = Inputs(quirks)
        self.mover = Mover(quirks, self.inputs)
        self.jogger = Jogger(quirks, self.inputs, self.mover)
        self.address = 1
        self._rate = 0
        self.line_format = _FORMATS[0]
        """The rate now, 8N1 (MN4-PHY-01, MN4-PHY-02)."""
        self._delay_ns = quirks.response_delay_ms * NS_PER_MS + skew_ns
        self._is_paced = True
        self.interpreter = Interpreter(
            quirks, self, self.inputs, self.mover, self.jogger, self.store
        )
        self._receiver = PacketReceiver(
            quirks, lambda: self.address, lambda: self.interpreter.raw_ends, skew_ns
        )
        self._serial = ReplySender(self._send_packet, is_ahead=True)
        self._usb = ReplySender(self._send_report, is_ahead=False)
        self._senders = (self._serial, self._usb)
        self._has_copies = quirks.reply_transport == "both"
        has_outcomes = quirks.usb_outcome_codes
        self._silent_on_usb = _SILENT_ON_USB if has_outcomes else (*_SILENT_ON_USB, *_OUTCOMES)
        self.reports: deque[bytes] = deque(maxlen=USB_QUEUE)
        self._config: deque[bytes] = deque()
        self._effects: list[Effect] = []
        self._powered = False
        self._shown_state: BoardState | None = None
        if powered:
            self.power_on(_LONG_AGO_NS)
            while (due := self._due()) <= 0:
                self._run_until(due)
            self._effects = []

    def _restore(self, number: int, cells: Mapping[str, int]) -> None:
        """Take over what was stored, or have it as rule 3 tells."""
        stored = {name: value for name, value in cells.items() if name != "baud"}
        if stored:
            self.store.restore(stored)
            return
        lines = [b"=%d" % number] if number != 1 else []
        rate = cells.get("baud", RATES[0])
        if rate not in RATES:
            raise UsageError(f"baud {rate} is no rate of an MN400: {', '.join(map(str, RATES))}")
        if rate != RATES[0]:
            lines.append(b"~%d" % RATES.index(rate))
        self.store.put("config", lines)

    # -- the serial line --

    def set_rate(self, number: int) -> None:
        """Set the rate, 0..4; if it changes, what there is of a packet is forgotten."""
        if number != self._rate:
            self._rate, self.line_format = number, _FORMATS[number]
            self._receiver.reset()

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` surely cause no effect."""
        return self._receiver.quiet_prefix(data) if self._powered else len(data)

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; obey and answer the packet that they complete."""
        if not self._powered:
            return []
        self._is_paced = chunk.format is not None
        for request in self._receiver.receive(chunk):
            is_shared = not self.is_full_duplex and not request.is_for_all
            if is_shared and packets.is_reply(request.payload):
                continue  # of a board with the same number, on the same pair (MN4-DROP-10)
            self._run_until(request.time_ns)
            self._serve(request)
            self._settle(request.time_ns)
        return self._taken()

    def _serve(self, request: Request) -> None:
        """Judge one packet (ledger §2.7, from step 3)."""
        now, payload, flaw, is_for_all, is_raw = request
        number = self.address
        answer: Answer | None
        if flaw is _FLAWLESS and not is_raw:
            answer = self.interpreter.obey(now, payload, _SERIAL, is_for_all)
        else:
            answer = self._answer_to_rest(request)
        if answer is None:
            return
        is_poll = payload[:1] == b"*" and flaw is _FLAWLESS
        policy = self.quirks.broadcast_reply if is_for_all else ""
        if policy == "poll_only" and not is_poll:
            return
        start_ns = now + self._delay_ns
        if number > 1 and (is_poll or policy == "staggered"):
            letter = payload[:1].upper().decode()
            start_ns += (number - 1) * self._slot_ns(letter, payload)
        self._reply(start_ns, answer.parts, _SERIAL)

    def _answer_to_rest(self, request: Request) -> Answer | None:
        """The answer to a packet with a flaw, or to the byte that ends an entry."""
        now, payload, flaw, _, is_raw = request
        command = payload[0] if payload else 0
        if self.quirks.echo_case == "upper":
            command = ord(chr(command).upper())
        if is_raw:
            return self.interpreter.end_entry(BoardLine(now, command, b"", b"", Origin.SERIAL))
        if flaw in _FLAW_CODES:
            return self.interpreter.refusal(command, _FLAW_CODES[flaw], payload, is_alone=True)
        if not self.quirks.timeout_reply:
            return None
        refusal = self.interpreter.refusal(command, ReturnCode.TIMEOUT, payload, is_alone=True)
        is_told = bool(payload) or self.quirks.timeout_without_command == "zero"
        return refusal if is_told else None

    def _slot_ns(self, letter: str, payload: bytes) -> Nanos:
        """How long one board has for its reply (MN4-AMB-08, MN4-DROP-04)."""
        longest, wait_ns = packets.STATUS_BYTES, 0
        around = 4 + len(packets.trailer(self.quirks))
        if letter == "R":  # a listing of lines of one character
            lines = self.quirks.nvm_size // (1 + self.quirks.nvm_line_overhead)
            longest = lines * (1 + around)
        elif letter in _VALUE_BYTES:
            longest = _VALUE_BYTES[letter] + around
            if letter == "?":
                longest = len(self.quirks.firmware) + around
            if letter == "E" and payload[1:].isdigit():
                longest += _COUNT_BYTES
                wait_ns = _MEASURES_MS.get(payload[1:].lstrip(b"0"), 0) * NS_PER_MS
        elif self.quirks.poll_slot_ms != "auto":
            slot = parse_decimal(self.quirks.poll_slot_ms)
            assert slot is not None
            return slot * NS_PER_US
        span_ns = self.line_format.span_ns(packets.STATUS_BYTES + longest)
        return span_ns + wait_ns + _SLOT_GAP_NS

    # -- replies --

    def _reply(self, start_ns: Nanos, parts: Sequence[ReplyPart], origin: Origin) -> None:
        """Send a reply to where the command came from (MN4-PHY-05)."""
        is_for_usb = origin is _USB and not self._has_copies
        (self._usb if is_for_usb else self._serial).send(start_ns, parts)

    def last_message(self, origin: Origin) -> Reply | None:
        """What was sent last on the port of ``origin``."""
        return (self._usb if origin is Origin.USB else self._serial).last

    def _send_packet(self, start_ns: Nanos, message: Reply) -> Nanos:
        address, command, code, value = message
        if value is None:
            data = packets.status(address, command, code, self.quirks)
        else:
            data = packets.data_packet(address, command, value, self.quirks)
        if self._has_copies:
            self._usb.send(start_ns, [ReplyPart(message)])
        self._effects.append(Transmit(start_ns, data))
        return start_ns + (self.line_format.span_ns(len(data)) if self._is_paced else 0)

    def _send_report(self, start_ns: Nanos, message: Reply) -> Nanos | None:
        """Rule 4, MN4-AMB-50."""
        command, code = bytes((message.command,)), bytes((message.code,))
        if message.value is not None:
            content = command + message.value.encode("latin-1")
        elif message.code in self._silent_on_usb:
            return None
        else:
            is_whole = message.code == ReturnCode.PRESENT or self.quirks.usb_error_form != "code"
            content = command + code if is_whole else code
        self.reports.append(packets.report(content))
        self._effects.append(ReportReady(start_ns, content))
        return start_ns

    # -- time --

    def _due(self) -> Nanos:
        """When anything is next to be done."""
        if not self._powered:
            return NEVER
        due = min(self._receiver.due_ns, self.mover.next_event(), self.jogger.next_event())
        for sender in self._senders:
            if sender.parts:
                due = min(due, sender.next_event())
        return min(due, self._config_due()) if self._config else due

    def _config_due(self) -> Nanos:
        """When the next line of the configuration program runs (rule 2)."""
        if not self._config or not self._serial.is_silent:
            return NEVER
        return self._serial.free_ns

    def next_event(self) -> Nanos | None:
        """When something is due."""
        due = self._due()
        return None if due == NEVER else due

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""
        self._run_until(now)
        return self._taken()

    def _run_until(self, now: Nanos) -> None:
        """Everything that is due by ``now``, in the order of time."""
        while (due := self._due()) <= now:
            self.mover.wake(due)
            self.jogger.wake(due)
            given_up = self._receiver.wake(due)
            if given_up is not None:
                self._serve(given_up)
            if self._config_due() <= due:
                answer = self.interpreter.obey(due, self._config.popleft(), Origin.CONFIG)
                self._reply(due + self._delay_ns, answer.parts, Origin.CONFIG)
            self._settle(due)

    def _settle(self, now: Nanos) -> None:
        """Run the lines of the program that are due; store, send and report what has changed."""
        interpreter = self.interpreter
        for line, part in interpreter.late_answers():
            is_slotted = line.is_for_all and self.quirks.broadcast_reply == "staggered"
            slot_ns = self._slot_ns(chr(line.command), line.raw) if is_slotted else 0
            self._reply(now + (self.address - 1) * slot_ns, [part], line.origin)
        parts = interpreter.run_program(now)
        if parts:
            self._serial.send(now + self._delay_ns, parts)
        if interpreter.cells:
            self._effects.append(Store(tuple(interpreter.cells)))
            interpreter.cells.clear()
        if interpreter.refused:
            self._effects.extend(Refused(now, reason) for reason in interpreter.refused)
            interpreter.refused.clear()
        for sender in self._senders:
            if sender.parts:
                sender.run(now)
        state = interpreter.state()
        if state is not self._shown_state:
            self._shown_state = state
            self._effects.append(StateChanged(now, state.name, state.value))

    def _taken(self) -> list[Effect]:
        effects, self._effects = self._effects, []
        return effects

    def _changed(self, now: Nanos) -> list[Effect]:
        """Close a call from outside."""
        if self._powered:
            self._settle(now)
        return self._taken()

    # -- supply --

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply: everything but the two programs is gone, also one half entered."""
        self._run_until(now)
        effects = self._taken()
        if self._powered:
            self._powered = False
            self._forget(now)
            self._shown_state = None
            effects.append(StateChanged(now, "OFF", "off"))
        return effects

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply: the defaults, then the configuration program (rule 2)."""
        if self._powered:
            return []
        self._powered = True
        self._forget(now)
        self.interpreter.set_jog(now, self.inputs.is_on("run_jog"))
        self._config.extend(self.store.lines("config"))
        return self._changed(now)

    def _forget(self, now: Nanos) -> None:
        """All that is volatile is as at power-up."""
        self.address = 1
        self.set_rate(0)
        self._receiver.reset()
        self._config.clear()
        self._serial.reset(now)
        self._usb.reset(now)
        self.reports.clear()
        self.mover.reset()
        self.jogger.reset()
        self.interpreter.reset()

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """The lines of both programs."""
        return self.store.cells()

    def is_moving(self, now: Nanos) -> bool:
        """Never: no cell changes by itself."""
        return False

    # -- USB --

    def receive_report(self, now: Nanos, data: bytes) -> list[Effect]:
        """Take an OUT report of up to 64 bytes (MN4-USB-01..08); see ``reports``."""
        self._run_until(now)
        text = packets.report_text(data)
        if self._powered and text:
            self._reply(now, self.interpreter.obey(now, text, Origin.USB).parts, Origin.USB)
        return self._changed(now)

    def send_usb(self, now: Nanos, text: str) -> list[Effect]:
        """Take a report with ``text``.  Raises UsageError for more than 64 or other characters."""
        if not text.isascii() or len(text) > packets.REPORT_BYTES:
            raise UsageError(f"report {text!r}: write at most 64 characters of ASCII")
        return self.receive_report(now, text.encode())

    def take_report(self, now: Nanos) -> list[str]:
        """The IN reports that the host has not read yet, in hex without the padding at the end."""
        self._run_until(now)
        return [data.rstrip(b"\x00").hex(" ").upper() for data in self.reports]

    def drop_reports(self, now: Nanos) -> list[Effect]:
        """Forget the IN reports: the host has read them."""
        self.reports.clear()
        return self._changed(now)

    # -- inputs --

    def input_at(self, now: Nanos, name: str) -> bool:
        """Whether an input is on.  Raises UsageError."""
        return self.inputs.is_on(name)

    def set_input(self, now: Nanos, name: str, on: bool) -> list[Effect]:
        """Close or open the contact of an input.  Raises UsageError for a name that is none."""
        self._run_until(now)
        if self.inputs.set(name, on) and self._powered:
            self._input_changed(now, name, on)
        return self._changed(now)

    def _input_changed(self, now: Nanos, name: str, on: bool) -> None:
        """An input has another level."""
        if name in LIMITS:
            self.mover.limits_changed(now)
            self.jogger.look(now)
        elif name == "shield":
            self.mover.shield_changed(now)
            self.jogger.look(now)
        elif name == "feedrate_enable":
            self.mover.feed_changed(now)
        elif name in JOGS:
            (self.jogger.press if on else self.jogger.release)(now, *JOGS[name])
        elif name == "run_jog":
            self._work_panel(now, b"J1" if on else b"J0")
        elif on and name == "stop":
            self._work_panel(now, b"Q")
        elif on and name == "pause":
            self._work_panel(now, b"}" if self.mover.is_paused_by("command") else b"{")
        elif on and name == "start" and self.quirks.panel_start == "run_program":
            self._work_panel(now, b"U")

    def _work_panel(self, now: Nanos, line: bytes) -> None:
        """Do what a switch of the panel stands for, in silence (MN4-IO-02)."""
        if self.interpreter.entry not in ("program", "config"):
            self.interpreter.obey(now, line, Origin.PANEL)

    def set_feed_pot(self, now: Nanos, permille: int) -> list[Effect]:
        """Turn the feedrate potentiometer, 0..1000."""
        self._run_until(now)
        self.inputs.feed_pot_permille = permille
        self.mover.feed_changed(now)
        return self._changed(now)

    def set_jog_pot(self, now: Nanos, permille: int) -> list[Effect]:
        """Turn the jog-speed potentiometer, 0..1000."""
        self._run_until(now)
        self.inputs.jog_pot_permille = permille
        self.jogger.pot_changed(now)
        return self._changed(now)

    def index_pulse(self, now: Nanos) -> list[Effect]:
        """One pulse at the threader's index input."""
        self._run_until(now)
        self.mover.index(now)
        return self._changed(now)

    def feed_pulses(self, now: Nanos, count: int) -> list[Effect]:
        """So many pulses, at least 0, at the threader's input A.  Raises UsageError."""
        if count < 0:
            raise UsageError(f"{count} pulses are not possible; give 0 or more")
        self._run_until(now)
        self.mover.feed(now, count)
        return self._changed(now)

    def turn_spindle(self, now: Nanos, rate_millihertz: int) -> list[Effect]:
        """Let pulses come by themselves, in thousandths per second; 0: no more."""
        self._run_until(now)
        train = PulseTrain(rate_millihertz, SPINDLE_PULSES, now) if rate_millihertz else None
        self.mover.follow(now, train)
        return self._changed(now)

    # -- outputs and read-out --

    def position_at(self, now: Nanos) -> Four:
        """The counters."""
        return self.interpreter.readout.position_at(now)

    def steps_at(self, now: Nanos) -> list[int]:
        """Pulses at the step outputs since power-up, in either direction, compensation included."""
        return list(added(self.mover.made_at(now), self.jogger.made_at(now)))

    def step_rates_at(self, now: Nanos) -> list[float]:
        """Steps per second of the step outputs, with the sign of the direction; of jogging too."""
        rates = [self.mover.rates_at(now), *(one.rates_at(now) for one in self.jogger.motions())]
        return [sum(of_axis) for of_axis in zip(*rates, strict=True)]

    def moves_at(self, now: Nanos) -> bool:
        """Whether an axis moves, or will when its pause is over or pulses come."""
        return self.mover.is_busy or bool(self.jogger.motions())

    def output_at(self, now: Nanos, number: int) -> bool:
        """Whether output ``number``, 1..8, is on.  Raises UsageError."""
        outputs = self.interpreter.outputs
        if not 1 <= number <= len(outputs):
            raise UsageError(f"output {number} does not exist: 1..{len(outputs)}")
        return outputs[number - 1]

    def flag_at(self, now: Nanos, name: str) -> bool:
        """Whether a flag output of the panel is on (MN4-IO-02)."""
        flags = {
            "stop": self.mover.is_aborted,
            "pause": self.mover.is_paused,
            "jog": self.jogger.is_on,
            "run": self.interpreter.program is not None or self.mover.is_busy,
        }
        return flags[name]

    def direction_at(self, now: Nanos, axis: int) -> bool:
        """Level of the direction output of ``axis``, 1..4: of its last step (MN4-AMB-45)."""
        is_positive = self.mover.memory_at(now)[axis - 1] > 0
        return is_positive == (self.quirks.dir_level_positive == "high")

    def describe(self, now: Nanos) -> BoardSnapshot:
        """Everything worth showing."""
        state = self.interpreter.state()
        inputs, train = self.inputs, self.mover.train
        return BoardSnapshot(
            address=self.address,
            baud=RATES[self._rate],
            state=state.name if self._powered else "OFF",
            state_text=state.value if self._powered else "off",
            counters=list(self.position_at(now)),
            remaining=list(self.mover.left_at(now)),
            queued=len(self.mover.queue),
            exit_code=self.mover.exit_code,
            outputs=[n + 1 for n, is_on in enumerate(self.interpreter.outputs) if is_on],
            inputs_status=inputs.status,
            feed_pot_permille=inputs.feed_pot_permille,
            jog_pot_permille=inputs.jog_pot_permille,
            spindle_millihertz=0 if train is None else train.rate_millihertz,
            program_lines=[line.decode("latin-1") for line in self.store.lines("program")],
            configuration_lines=[line.decode("latin-1") for line in self.store.lines("config")],
        )
