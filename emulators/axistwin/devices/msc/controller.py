"""One MSC controller on a serial line: its executive port, its memory, its program, its supply.

::

    line --- Receiver --- Commands --- DataArea, Flags, Status --- ProgramRunner
             (link, §4)   (§2.4)       (§5.2, §5.3, §5.4)          (the user's program)

Rules
-----
1. The program's scans that are due are made up for before anything looks at data, flags or status.
2. A host's write is stored durably, a program's is handed to the operating system.
3. Power-up: link idle, flags off, data as the battery kept it.  With the battery flat the memory is
   lost: all zeros, and status bit 2.  A program with auto start runs without any host's action
   (ledger §5.4), when the self-test is over.
4. On RS-232, and on RS-485 with a pair of wires for each direction, both ends may send at a time;
   on one pair a unit is silent for the turnaround before it drives (MSC-AMB-34).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from axistwin.devices.msc.commands import Commands
from axistwin.devices.msc.data_area import VALUE_MAX, VALUE_MIN, DataArea
from axistwin.devices.msc.flags import FLAGS, Flags, parse_flag_map
from axistwin.devices.msc.models import MODELS, MscModel
from axistwin.devices.msc.packets import UNITS
from axistwin.devices.msc.program import ProgramRunner
from axistwin.devices.msc.quirks import MscQuirks
from axistwin.devices.msc.receiver import LINE_FORMAT, Receiver, ReceiverState
from axistwin.devices.msc.status import Status, StatusBit, status_bit
from axistwin.devices.snapshot import Snapshot
from axistwin.devices.traces import StateChanged
from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect, Store
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.macroprogram.program import Macroprogram
from axistwin.wire.framing import Chunk, LineFormat

BATTERY_LEVELS: Final = ("good", "low", "flat")

_ALL_BITS: Final = ~StatusBit(0)


@dataclass(frozen=True, slots=True)
class ControllerSnapshot(Snapshot):
    """A controller at one instant.

    state: of the link layer (ledger §4).  program_error: where and why the program ended with a
    script error, if it did.  program_names: its names for flags and variables.
    """

    model: str
    address: int
    state: str
    state_text: str
    transport: str
    status: int
    status_bits: list[str]
    battery: str
    flags_on: list[int]
    program_error: str | None
    program_names: dict[str, int]


class MscController:
    """One controller.

    model: ``msc-250``, ``msc-850-32``, ``msc-850`` or ``msc-generic``.  unit: 1..15, the setting of
    its address switch.  cells: what it stored in an earlier life.  skew_ns: added to its answers
    and time limits, so that two units never act on the very same nanosecond.  alone: no other unit
    is on the line (``transport`` = auto).  A ``powered`` unit is switched on long before time 0.
    Raises UsageError for an unknown model or a unit out of range.
    """

    def __init__(
        self,
        model: str | MscModel,
        unit: int = 1,
        *,
        quirks: MscQuirks | None = None,
        cells: Mapping[str, int] | None = None,
        skew_ns: Nanos = 0,
        alone: bool = True,
        powered: bool = True,
    ) -> None:
        if unit not in UNITS:
            raise UsageError(f"unit {unit} is not in 1..15, the settings of the address switch")
        self.model = _model(model)
        self.quirks = quirks = quirks or MscQuirks()
        self.is_rs232 = quirks.transport == "rs232" or (
            quirks.transport == "auto" and alone and unit == 1
        )
        kinds = parse_flag_map(quirks.flag_map)
        assert kinds is not None, "the quirk was parsed"
        self.data = DataArea(quirks)
        self.flags = Flags(kinds, is_on_expired=quirks.timer_flag == "expired")
        self.status = Status(clears_on_read=quirks.status_latch == "clear_on_read")
        self._commands = Commands(
            self.model, quirks, self.data, self.flags, self.status, self._catch_up, self._wrote
        )
        turnaround_ms = 0 if self.is_full_duplex else quirks.turnaround_ms
        self._receiver = Receiver(
            unit,
            quirks,
            self._commands.examine,
            is_rs232=self.is_rs232,
            delay_ns=max(quirks.response_delay_ms, turnaround_ms) * NS_PER_MS + skew_ns,
            skew_ns=skew_ns,
        )
        self._effects = self._receiver.effects
        self._scan_ns = quirks.scan_ms * NS_PER_MS
        self._runner = self._make_runner(None)
        self._powered = False
        self._test_ends: Nanos = NEVER
        self._battery = BATTERY_LEVELS[0]
        self._is_memory_lost = False
        self._told = ""
        self._restore(cells or {})
        if powered:
            self._powered = True
            self._show_conditions()
            self._told = self._state_text()

    def _restore(self, cells: Mapping[str, int]) -> None:
        """Take over what was stored."""
        self.data.restore(cells)
        level = cells.get("battery", 0)
        if 0 <= level < len(BATTERY_LEVELS):
            self._battery = BATTERY_LEVELS[level]
        self._is_memory_lost = cells.get("memory_lost", 0) == 1

    # ---- the line ------------------------------------------------------------------------------

    @property
    def line_format(self) -> LineFormat:
        """9600 8N1, always (MSC-PHY-01)."""
        return LINE_FORMAT

    @property
    def is_full_duplex(self) -> bool:
        """Whether each direction has wires of its own (rule 4)."""
        return self.is_rs232 or self.quirks.rs485_mode == "four_wire"

    @property
    def drops_bad_characters(self) -> bool:
        """Whether they do not even spoil the packet that they stand in (MSC-AMB-43)."""
        return self.quirks.uart_error == "drop_byte"

    def quiet_prefix(self, data: bytes) -> int:
        """How many leading bytes of ``data`` surely cause no effect."""
        return self._receiver.quiet_prefix(data) if self._powered else len(data)

    def receive(self, chunk: Chunk) -> list[Effect]:
        """Take the bytes of ``chunk``; answer the packet that they complete."""
        if not self._powered:
            return []
        self._receiver.receive(chunk)
        return self._taken() if self._effects else []

    # ---- time ----------------------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When the link, the program or the self-test wants to go on."""
        due = min(self._receiver.next_event(), self._test_ends)
        scan_ns = self._runner.next_event()
        if scan_ns is not None and scan_ns < due:
            return scan_ns
        return None if due == NEVER else due

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""
        self._run_until(now)
        return self._taken()

    def _run_until(self, now: Nanos) -> None:
        """Everything due by ``now``: the end of the self-test, scans, the link."""
        if self._test_ends <= now:
            self._end_test(self._test_ends)
        self._receiver.wake(now)
        self._catch_up(now)

    def _catch_up(self, now: Nanos) -> None:
        """Let the program do its scans up to ``now`` (rules 1 and 2)."""
        if self._runner.is_running:
            self._runner.wake(now)
            self._follow_program(now)

    def _wrote(self, now: Nanos) -> None:
        """The host has written (rule 2, MSC-AMB-33)."""
        if self.data.is_changed:
            self._effects.insert(0, Store(self.data.take_changed()))
        if self._runner.is_running:
            self._runner.host_wrote(now)
            self._follow_program(now)

    def _follow_program(self, now: Nanos) -> None:
        """Hand over what the program has stored, and tell its end."""
        self._store()
        if not self._runner.is_running:
            self._tell(now)

    def _taken(self) -> list[Effect]:
        """What is to be done, at the end of a call."""
        effects = self._effects
        if not effects:
            return []
        self._effects = self._receiver.effects = []
        return effects

    def _tell(self, now: Nanos) -> None:
        """Tell what has become of the program and the unit."""
        self._effects += self._runner.take_traces()
        text = self._state_text()
        if text != self._told:
            self._told = text
            self._effects.append(StateChanged(now, text))

    def _settle(self, now: Nanos) -> list[Effect]:
        """Close a call from outside."""
        self._tell(now)
        return self._taken()

    # ---- supply --------------------------------------------------------------------------------

    def power_off(self, now: Nanos) -> list[Effect]:
        """Cut the supply: the battery keeps the data, or does not."""
        self._run_until(now)
        if self._powered:
            self._runner.stop(now)
            self._powered = False
            self._test_ends = NEVER
            self._receiver.reset()
            self._is_memory_lost = False
            self._lose_memory()
        return self._settle(now)

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply (rule 3); nothing is sent (MSC-PHY-04)."""
        if not self._powered:
            self._powered = True
            self.flags.clear()
            self.status.set(_ALL_BITS, on=False)
            self._show_conditions()
            if self.quirks.self_test_ms:
                self.status.set(StatusBit.SELF_TEST)
                self._test_ends = now + self.quirks.self_test_ms * NS_PER_MS
            else:
                self._end_test(now)
        return self._settle(now)

    def _show_conditions(self) -> None:
        """The status bits that follow from what the unit is and has."""
        self.status.set(StatusBit.BATTERY_LOW, self._battery != BATTERY_LEVELS[0])
        self.status.set(StatusBit.RAM_UNRELIABLE, self._is_memory_lost)
        self.status.set(StatusBit.AUTO_START, self._runner.is_auto_started)

    def _lose_memory(self) -> None:
        """Without supply a flat battery keeps nothing."""
        if self._battery == "flat" and not self._powered:
            self._is_memory_lost = True
            self.data.lose()
            self._effects.append(Store(self.data.take_changed(), durable=False))

    def _end_test(self, now: Nanos) -> None:
        """The self-test is over: a program with auto start begins."""
        self._test_ends = NEVER
        self.status.set(StatusBit.SELF_TEST, on=False)
        if self._runner.is_auto_started and self._runner.has_program:
            self._runner.start(now)
        self._tell(now)

    # ---- the program ---------------------------------------------------------------------------

    def _make_runner(self, program: Any) -> ProgramRunner:
        """What runs ``program``.  Raises UsageError if it does not fit this unit."""
        return ProgramRunner(
            program,
            self.data,
            self.flags,
            self.status,
            scan_ns=self._scan_ns,
            quirks=self.quirks,
        )

    def load_program(self, now: Nanos, program: Any) -> list[Effect]:
        """Put ``program`` in, or with None take it out; it does not run yet.

        Raises UsageError if it does not fit this unit: then nothing has changed.
        """
        self._run_until(now)
        runner = self._make_runner(program)
        self._runner.stop(now)
        self._effects += self._runner.take_traces()
        self._runner = runner
        if program is not None:
            self.status.set(StatusBit.PROGRAM_CLEARED, on=False)
        self.status.set(StatusBit.AUTO_START, runner.is_auto_started)
        self._store()
        return self._settle(now)

    def program_at(self, now: Nanos) -> Macroprogram | None:
        """The program's object as it runs, or ran last; None before its first start."""
        self._catch_up(now)
        return self._runner.instance

    def start_program(self, now: Nanos) -> list[Effect]:
        """Start the program from its beginning.  Raises UsageError if there is none."""
        self._run_until(now)
        if not self._powered:
            raise UsageError("the controller has no supply; switch it on first")
        self._runner.start(now)
        self._catch_up(now)
        return self._settle(now)

    def stop_program(self, now: Nanos) -> list[Effect]:
        """Stop the program; flags and data stay, timers hold (MSC-AMB-32)."""
        self._run_until(now)
        self._runner.stop(now)
        return self._settle(now)

    def clear_program(self, now: Nanos) -> list[Effect]:
        """Reset the system and clear the program: zeros, flags off, status bit 3 (ledger §5.4)."""
        self._run_until(now)
        self._runner.stop(now)
        self._effects += self._runner.take_traces()
        self._runner = self._make_runner(None)
        self.flags.clear()
        self.data.lose()
        self.status.set(_ALL_BITS, on=False)
        self._show_conditions()
        self.status.set(StatusBit.PROGRAM_CLEARED)
        self._store()
        return self._settle(now)

    # ---- the back door -------------------------------------------------------------------------

    def flag_at(self, now: Nanos, number: int) -> bool:
        """Whether flag ``number`` is on.  Raises UsageError for a number that is none."""
        _check("flag", number, FLAGS - 1)
        self._catch_up(now)
        return self.flags.state(now, number)

    def set_flag(self, now: Nanos, number: int, on: bool) -> list[Effect]:
        """Turn a flag of any kind on or off, as the machine does.  Raises UsageError."""
        _check("flag", number, FLAGS - 1)
        self._run_until(now)
        self.flags.set(number, on)
        return self._settle(now)

    def variable_at(self, now: Nanos, address: int) -> int:
        """The signed value at ``address``.  Raises UsageError outside the data area."""
        _check("address", address, self.data.end)
        self._catch_up(now)
        return self.data.peek(address)

    def set_variable(self, now: Nanos, address: int, value: int) -> list[Effect]:
        """Store the signed 32-bit ``value`` at ``address``.  Raises UsageError out of range."""
        _check("address", address, self.data.end)
        if not VALUE_MIN <= value <= VALUE_MAX:
            raise UsageError(f"value {value} is out of range: {VALUE_MIN}..{VALUE_MAX}")
        self._run_until(now)
        self.data.put(address, value)
        self._store()
        return self._settle(now)

    def status_at(self, now: Nanos) -> int:
        """The status word; looking at it changes nothing."""
        self._catch_up(now)
        return int(self.status.word)

    def status_bit_at(self, now: Nanos, bit: int) -> bool:
        """Whether status ``bit``, 0..15, is on.  Raises UsageError."""
        return bool(self.status_at(now) & status_bit(bit))

    def set_status(self, now: Nanos, bit: int, on: bool) -> list[Effect]:
        """Let the condition of status ``bit``, 0..15, be there or gone.  Raises UsageError."""
        mask = status_bit(bit)
        self._run_until(now)
        self.status.set(mask, on)
        return self._settle(now)

    def set_battery(self, now: Nanos, level: str) -> list[Effect]:
        """Let the memory's battery be good, low or flat.  Raises UsageError for other words."""
        if level not in BATTERY_LEVELS:
            raise UsageError(f"battery {level!r}: {nearest(level, BATTERY_LEVELS)}")
        self._run_until(now)
        self._battery = level
        if self._powered:
            self.status.set(StatusBit.BATTERY_LOW, level != BATTERY_LEVELS[0])
        else:
            self._lose_memory()
        return self._settle(now)

    def _store(self) -> None:
        """Hand what has changed to the operating system."""
        if self.data.is_changed:
            self._effects.append(Store(self.data.take_changed(), durable=False))

    # ---- for whoever looks on ------------------------------------------------------------------

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells: the values ever written, the battery and what it lost."""
        if self._powered:
            self._catch_up(now)
        return {
            "battery": BATTERY_LEVELS.index(self._battery),
            "memory_lost": int(self._is_memory_lost),
            **self.data.cells(),
        }

    def is_moving(self, now: Nanos) -> bool:
        """Never: what a program changes is stored by itself."""
        return False

    def _state_text(self) -> str:
        """What the unit is doing, in words."""
        if not self._powered:
            return "off"
        if self.status.has(StatusBit.SELF_TEST):
            return "self-test"
        if self.status.has(StatusBit.RUNNING):
            return "program running"
        if self.status.has(StatusBit.PROGRAM_CLEARED):
            return "program cleared"
        return "program stopped" if self._runner.has_program else "no program"

    def describe(self, now: Nanos) -> ControllerSnapshot:
        """Everything worth showing."""
        if self._powered:
            self._catch_up(now)
        states = self.flags.states(now)
        return ControllerSnapshot(
            model=self.model.name,
            address=self._receiver.unit,
            state=self._link_text(),
            state_text=self._state_text(),
            transport="rs232" if self.is_rs232 else "rs485",
            status=int(self.status.word),
            status_bits=[str(bit.name) for bit in StatusBit if self.status.has(bit)],
            battery=self._battery,
            flags_on=[number for number in range(FLAGS) if states >> number & 1],
            program_error=self._runner.error,
            program_names=dict(self._runner.names),
        )

    def _link_text(self) -> str:
        """The state of the link layer, as the ledger's table calls it (§4)."""
        if self._receiver.is_busy:
            return "EXEC"
        if self._receiver.state is ReceiverState.DISCARD:
            return "BODY"
        return self._receiver.state.name


def _model(model: str | MscModel) -> MscModel:
    if isinstance(model, MscModel):
        return model
    if model not in MODELS:
        raise UsageError(f"unknown model {model!r}: {nearest(model, MODELS)}")
    return MODELS[model]


def _check(what: str, number: int, highest: int) -> None:
    """Raise UsageError if ``number`` is not in 0..``highest``."""
    if not 0 <= number <= highest:
        raise UsageError(f"{what} {number} does not exist: 0..{highest}")
