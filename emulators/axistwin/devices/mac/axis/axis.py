"""The core of a MAC module: what every command means, on a serial line as on a CAN bus.

The axis knows commands by index and four parameter bytes (one unsigned number, first byte highest)
and queries by index.  It says whether a command was accepted; how that looks on the wire, who is
addressed, and when the module is deaf is the business of a *face*.

Rules
-----
1. Acceptance first (``acceptance``), then the value, then the effect: what is refused changes
   nothing (MACS-REPLY-05).
2. What a command stores is in the effects before it returns (``parameters``).
3. Synchronous mode is two flags over any state: armed by 10h, then preloaded by 13h, 14h or 15h,
   started by 11h (MACS-CMD-10-01..11-02).  Segments are never held (MACS-CMD-10-03).
4. A disjunction cuts power in any state, and stays until a restart (MACS-STATE-02, -03).
5. Told are stops that are met (``StopMet``) and faults that latch (``FaultLatched``).
6. Calls come in the order of time; whoever calls has run the axis up to that time.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final

from axistwin.devices.mac.axis.acceptance import MOVING, STATE_CODES, State, acceptance_table
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.faults import FAULTS, FaultLatched, Faults
from axistwin.devices.mac.axis.memory_map import eeprom_image, ram_image
from axistwin.devices.mac.axis.models import MacModel
from axistwin.devices.mac.axis.parameters import Parameters, Setter, signed_32
from axistwin.devices.mac.axis.quirks import RANGE_MAX, RANGE_MIN, MacQuirks
from axistwin.devices.mac.axis.stops import STOP_NAMES, StopMet
from axistwin.errors import UsageError, nearest
from axistwin.kernel.effects import Effect
from axistwin.kernel.time import Nanos
from axistwin.motion.interpolator import Segment

INPUTS: Final = ("positive_stop", "negative_stop", "reference")

COUNTER_CLOCKWISE: Final = 0xF6  # SS of 15h (MACS-CMD-15-01)

NOT_BUSY, POSITIVE_STOP = 0x08, 0x20  # bits of cc in 27h (ledger §5.9)
NEGATIVE_STOP, REFERENCE = 0x40, 0x20  # bits of dd in 27h
OVER_VOLTAGE_SEEN: Final = {"7": 0x80, "6-0": 0x7F}  # hh of 21h (MACS-AMB-13)


class Axis:
    """State, parameters and motion of one module, at rest and unpowered until ``start``.

    ``cells`` are what is stored already; unknown or impossible ones are ignored.
    """

    def __init__(self, model: MacModel, quirks: MacQuirks, cells: Mapping[str, int]) -> None:
        self.quirks = quirks
        self._effects: list[Effect] = []
        self.parameters = Parameters(quirks, cells, self._emit, model.addresses)
        self.values, self.stored = self.parameters.values, self.parameters.stored
        self.faults = Faults(model, encoder_locks=quirks.encoder_fault_locks)
        self.drive = Drive(model, quirks, self.values, self.faults)
        self.inputs = dict.fromkeys(INPUTS, False)
        self._cells = acceptance_table(quirks)
        self._columns = tuple(self._cells[state] for state in State)
        self._assigned = tuple(cell != "u" for cell in self._cells[State.OF])
        self._reference_enabled = False
        self._armed = False
        self.arm_lasts = False  # 10h holds every motion until 17h, 18h, 1Ah (MACC-AMB-31)
        self._preload: tuple[int, int] | None = None
        reserved = 0xFF if quirks.reserved_bits else 0
        hh_bit = OVER_VOLTAGE_SEEN[quirks.status_hh_bit]
        shift = 1 if quirks.status_ff_layout == "shifted" else 0
        ff_reserved = 0xFF & ~(0x0F << shift)
        self._status_reserved = (
            reserved & model.reserved_status_bits,
            reserved & ff_reserved,
            reserved,
            reserved & ~hh_bit,
        )
        self._measure_reserved = reserved & ~0x28 & 0xFF, reserved & ~0x60 & 0xFF
        self._ff_shift, self._hh_bit = shift, hh_bit
        self.drive.counter.set(0, self.stored["position"])
        self.drive.counter.freeze(0)
        self._told_faults = 0

    # ---- acceptance ----------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """The column of the acceptance table (ledger §4.2)."""
        if self.faults.latched and self.faults.disjuncted:
            return State.DJ
        if (kind := self.drive.kind) is not None:
            return kind
        if self._preload is not None:
            return State.PL
        if self._armed:
            return State.AR
        return State.HD if self.drive.powered else State.OF

    def state_code(self) -> str:
        """The state in the ledger's letters, such as ``HD+AR`` or ``VE+PL``."""
        flag = 2 if self._preload is not None else int(self._armed)
        return STATE_CODES[self.state][flag][self.drive.powered]

    def is_assigned(self, index: int) -> bool:
        """Whether the manual gives ``index`` (0..FFh) a meaning, in whatever state."""
        return index < len(self._assigned) and self._assigned[index]

    def cell(self, index: int) -> str:
        """A accepted, R refused, 1 refused for the parameter 01, u unassigned; in this state."""
        return self._columns[self.state][index]

    def is_locked(self, index: int, parameters: int) -> bool:
        """Whether the state refuses command ``index``: nothing at all happens then."""
        cell = self._columns[self.state][index]
        return cell == "R" or (cell == "1" and parameters & 0xFF == 1)

    def execute(self, now: Nanos, index: int, parameters: int, start_ns: Nanos) -> bool:
        """Execute command ``index``, which is not ``is_locked``.  False: refused for its value.

        A motion that it starts begins at ``start_ns``.
        """
        if (parameter := _PARAMETERS.get(index)) is not None:
            setter, apply = parameter
            accepted = setter(self.parameters, parameters)
            if accepted:
                apply(self.drive, now)
            return accepted
        handler = _COMMANDS.get(index)
        assert handler is not None, f"command {index:02X}h is for the face or unassigned"
        accepted = handler(self, now, parameters, start_ns)
        self._obey_stops(now)
        self._save_counter(now)
        return accepted

    def take_effects(self) -> list[Effect]:
        """What is to be stored or told since the last call, in order."""
        effects = self._effects
        if effects:
            self._effects = []
        return effects

    def _emit(self, effect: Effect) -> None:
        self._effects.append(effect)

    # ---- parameters ----------------------------------------------------------------------------

    def restore_factory_values(self, now: Nanos) -> None:
        """01h: all parameters, address and rate as from the factory; the position stays."""
        self.parameters.restore_factory_values()
        self._apply_parameters(now)

    def _apply_parameters(self, now: Nanos) -> None:
        self.drive.apply_catch_up(now)
        self.drive.apply_torque(now)
        self.drive.replan(now)

    def _reference(self, _: Nanos, number: int, __: Nanos) -> bool:
        """07h (MACS-CMD-07-01, -02)."""
        enabled = self.parameters.in_printed_set(number & 0xFF, (0, 1), 0x01)
        if enabled is None:
            return False
        self._reference_enabled = bool(enabled)
        return True

    def _zero_counter(self, now: Nanos, _: int, __: Nanos) -> bool:
        """0Bh (MACS-CMD-0B-01, MACS-AMB-53)."""
        self.drive.zero(now, keeps_remaining=self.quirks.reset_in_motion == "remaining")
        return True

    # ---- synchronous mode ----------------------------------------------------------------------

    def _arm(self, _: Nanos, __: int, ___: Nanos) -> bool:
        """10h (MACS-CMD-10-01); twice is once, in motion is for the next one (MACS-AMB-35)."""
        if self._preload is None:
            in_motion = self.drive.kind is not None
            self._armed = not in_motion or self.quirks.sync_arm_lifetime != "lost"
        return True

    def _synchronise(self, now: Nanos, _: int, start_ns: Nanos) -> bool:
        """11h (MACS-CMD-11-01, -02)."""
        preload = self._preload
        if preload is None:
            return self.quirks.sync_without_preload == "accept"
        index = preload[0]
        if self.drive.kind is State.IN and index != 0x15:
            policy = self.quirks.sync_during_interp
            if policy == "now":
                self.drive.drop_segments(now)
            elif policy == "after":
                self.drive.go_to_after_segments(signed_32(preload[1]))
            self._preload = None
            return policy != "now" or self._start_held(now, preload, start_ns)
        if self.state in MOVING and self._cells[self.state][index] == "R":
            return False
        self._preload = None
        return self._start_held(now, preload, start_ns)

    def _start_held(self, now: Nanos, held: tuple[int, int], start_ns: Nanos) -> bool:
        """Execute a motion that was held back."""
        index, parameters = held
        return _STARTS[index](self, now, parameters, start_ns)

    def _held_back(self, index: int, parameters: int) -> bool:
        """Preload a motion if synchronous mode wants it; False: it is to start now."""
        if self._preload is not None:
            if self.quirks.preload_policy != "keep":
                self._preload = (index, parameters)
            return True
        if not self._armed:
            return False
        self._armed, self._preload = self.arm_lasts, (index, parameters)
        return True

    def _disarm(self) -> None:
        """17h, 18h, 1Ah: arm and preload are dropped (MACS-AMB-36)."""
        if self.quirks.preload_policy != "keep":
            self._armed, self._preload = False, None

    # ---- motion --------------------------------------------------------------------------------

    def _go_to(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        """13h (MACS-CMD-13-01..06)."""
        number = signed_32(parameters)
        if not RANGE_MIN <= number <= RANGE_MAX and self.quirks.target_range == "refuse":
            return False
        if self._refuses_way(number - self.drive.counter.at(now)):
            return False
        return self._held_back(0x13, parameters) or self._start_go_to(now, parameters, start_ns)

    def _go_to_zero(self, now: Nanos, _: int, start_ns: Nanos) -> bool:
        """14h: 13h with 0 (MACS-CMD-14-01)."""
        return self._go_to(now, 0, start_ns)

    def _start_go_to(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        self.drive.go_to(now, signed_32(parameters), start_ns)
        return True

    def _velocity(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        """15h (MACS-CMD-15-01..06)."""
        if parameters & 0xFFFF == 0:
            return self._zero_velocity(now, start_ns)
        running = self.drive.set_point_direction(now)
        direction = self._direction_of(parameters)
        if running and direction != running and self.quirks.vel_reverse_cmd == "refuse":
            return False
        if not running and self._refuses_way(direction):
            return False
        return self._held_back(0x15, parameters) or self._start_velocity(now, parameters, start_ns)

    def _zero_velocity(self, now: Nanos, start_ns: Nanos) -> bool:
        """15h 0000: stop; nothing that synchronous mode could hold back (MACS-AMB-68).

        Of segments too: what ends them with another speed ends them with none (MACS-AMB-30).
        """
        if self.drive.kind is State.IN:
            self.drive.stop_segments(now, after_this_one=False)
        elif self.drive.kind is not None:
            self.drive.ramped_stop(now)
        elif self._armed or self._preload is not None:
            policy = self.quirks.armed_zero_velocity
            if policy == "refuse":
                return False
            if policy == "spend":
                self._armed, self._preload = False, None
        return True

    def _direction_of(self, parameters: int) -> int:
        """The sign that SS of 15h means (MACS-CMD-15-01, MACS-AMB-07)."""
        backward = parameters >> 16 & 0xFF == COUNTER_CLOCKWISE
        return -1 if backward and self.quirks.vel_f6_direction == "negative" else 1

    def _start_velocity(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        direction = self._direction_of(parameters)
        self.drive.run_at(now, parameters & 0xFFFF, direction, start_ns)
        return True

    def _segment(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        """16h (MACS-CMD-16-01, -02)."""
        return self._offer(now, parameters, start_ns, virtual=False)

    def _virtual_segment(self, now: Nanos, parameters: int, start_ns: Nanos) -> bool:
        """1Eh (MACS-CMD-1E-01)."""
        return self._offer(now, parameters, start_ns, virtual=True)

    def _offer(self, now: Nanos, parameters: int, start_ns: Nanos, *, virtual: bool) -> bool:
        """Store a segment: DDDD VVVV (MACS-AMB-38, -39)."""
        steps, period_ticks = parameters >> 16, parameters & 0xFFFF
        if period_ticks == 0:
            policy = self.quirks.segment_zero_period
            if policy == "refuse":
                return False
            period_ticks = 1 if policy == "fastest" else 65536
        if steps == 0 and self.quirks.segment_zero_steps == "65536":
            steps = 65536
        elif steps & 0x8000 and self.quirks.segment_signed:
            steps -= 0x10000
        if not virtual and self._refuses_way(steps):
            return False
        if not self.drive.offer(now, Segment(steps, period_ticks, virtual), start_ns):
            return False
        if self.quirks.arm_after_segment == "lost":
            self._armed, self._preload = False, None
        return True

    def _refuses_way(self, distance: int) -> bool:
        """Whether the sign of ``distance`` leads into an active hardware stop (MACS-AMB-49)."""
        if distance == 0 or self.quirks.hard_stop_command == "accept":
            return False
        return self.drive.stops.is_blocked_hard(1 if distance > 0 else -1)

    def _ramped_stop(self, now: Nanos, _: int, __: Nanos) -> bool:
        """17h (MACS-CMD-17-01, -02, MACS-AMB-77)."""
        if self.drive.kind is State.IN and self.quirks.stop17_in_interp == "ignore":
            return True
        self._disarm()
        if self.drive.kind is State.IN:
            after_this_one = self.quirks.stop17_in_interp == "after_segment"
            self.drive.stop_segments(now, after_this_one=after_this_one)
        else:
            self.drive.ramped_stop(now)
        if self.quirks.segments_after_17h == "dropped":
            self.drive.flush_waiting(now)
        return True

    def _hard_stop(self, now: Nanos, _: int, __: Nanos) -> bool:
        """18h (MACS-CMD-18-01..03)."""
        flushes = self.quirks.abort_flush
        if flushes:
            self._disarm()
        if self.drive.powered:
            self.drive.hard_stop(now, keeps_segments=not flushes)
        return True

    def _motor_on(self, now: Nanos, _: int, __: Nanos) -> bool:
        """19h (MACS-CMD-19-01)."""
        self.drive.power_on(now)
        return True

    def _motor_off(self, now: Nanos, _: int, __: Nanos) -> bool:
        """1Ah (MACS-CMD-1A-01)."""
        self._disarm()
        self.drive.power_off(now)
        return True

    # ---- queries -------------------------------------------------------------------------------

    def query(self, now: Nanos, index: int) -> int:
        """The four bytes of query 20h..27h, as one unsigned number."""
        return _QUERIES[index - 0x20](self, now)

    def _read_position(self, now: Nanos) -> int:
        """20h (MACS-Q-20-01)."""
        return self.drive.reading_at(now) & 0xFFFFFFFF

    def _read_status(self, now: Nanos) -> int:
        """21h: dd ff gg hh (ledger §5.9)."""
        dd, ff, gg, hh = self._status_reserved
        stops = self.drive.stops.bits_at(now)
        seen = self._hh_bit if self.faults.over_voltage_seen else 0
        return (
            (dd | self.faults.word) << 24
            | (ff | stops << self._ff_shift) << 16
            | gg << 8
            | hh
            | seen
        )

    def _read_superior_stop(self, _: Nanos) -> int:
        """22h (MACS-Q-22-01)."""
        return self.values["superior_stop"] & 0xFFFFFFFF

    def _read_inferior_stop(self, _: Nanos) -> int:
        """23h (MACS-Q-23-01)."""
        return self.values["inferior_stop"] & 0xFFFFFFFF

    def _read_release(self, _: Nanos) -> int:
        """24h (MACS-Q-24-01)."""
        return self.quirks.version_word

    def _read_speeds(self, _: Nanos) -> int:
        """25h: rr 00 vvvv (MACS-Q-25-01)."""
        return self.values["catchup"] << 24 | self.values["period"]

    def _read_modes(self, _: Nanos) -> int:
        """26h: nn cc Km dd (MACS-Q-26-01)."""
        values = self.values
        modes = values["standby"] << 4 | values["stops"]
        return values["ramp"] << 24 | values["torque"] << 16 | modes << 8 | values["tolerance"]

    def _read_measures(self, now: Nanos) -> int:
        """27h: tt vv cc dd, inputs as they are wired (MACS-Q-27-01..03)."""
        cc, dd = self._measure_reserved
        inputs = self.inputs
        cc |= POSITIVE_STOP * inputs["positive_stop"]
        cc |= 0 if self.drive.is_busy(now) else NOT_BUSY
        dd |= NEGATIVE_STOP * inputs["negative_stop"] | REFERENCE * inputs["reference"]
        return self.faults.raw_temperature << 24 | self.faults.raw_supply << 16 | cc << 8 | dd

    def memory(self, now: Nanos, *, ram: bool) -> bytes:
        """The 256 bytes of RAM or EEPROM (MACS-Q-28-01, -29-01)."""
        if ram:
            in_use = {**self.values, "position": self.drive.reading_at(now)}
            return ram_image(in_use, self.quirks.imax_value)
        return eeprom_image(self.stored)

    # ---- time and surroundings -------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When something happens by itself."""
        return self.drive.next_event()

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``."""
        self.drive.run(now)
        self._obey_stops(now)
        self._save_counter(now)

    def _obey_stops(self, now: Nanos) -> None:
        """A stop drops what was to come, as 18h does (MACS-AMB-51)."""
        bit = self.drive.met_stop
        if bit:
            self.drive.met_stop = 0
            self._emit(StopMet(now, STOP_NAMES[bit]))
            if self.quirks.abort_flush:
                self._disarm()

    def _save_counter(self, now: Nanos) -> None:
        """Hand on the position whenever it has come to a new rest or was set."""
        if self.drive.counter.settled:
            self.drive.counter.settled = False
            self.parameters.save_position(self.drive.counter.at(now))

    def power_on(self, now: Nanos) -> None:
        """The supply is there: the counter is what was saved (MACS-Q-20-02)."""
        self.drive.counter.thaw(now)
        self.drive.replan(now)

    def power_off(self, now: Nanos) -> None:
        """The supply goes: the position is saved, all else volatile is lost (MACS-PERS-01, -03)."""
        self.shut_down(now)
        self.drive.counter.freeze(now)
        self.drive.replan(now)

    def shut_down(self, now: Nanos) -> None:
        """Back to the state before start-up (MACS-CMD-00-01)."""
        self.drive.power_off(now)
        self.drive.stops.bits = 0
        self._armed = self._reference_enabled = False
        self._preload = None
        self.faults.acknowledge()
        self.parameters.read_stored()
        self._apply_parameters(now)
        self._save_counter(now)

    def start(self, now: Nanos) -> None:
        """The end of start-up: faults afresh, then power if it is to be there (MACS-AMB-26)."""
        self.faults.acknowledge()
        self._told_faults = 0
        self._obey_faults(now)
        if self.quirks.power_on_at_boot and not self.faults.disjuncted:
            self.drive.power_on(now)

    def set_input(self, now: Nanos, name: str, active: bool) -> None:
        """Ground an input (active) or open it; UsageError for an unknown one."""
        if name not in self.inputs:
            raise UsageError(f"unknown input {name!r}: {nearest(name, (*INPUTS, 'reset'))}")
        was, self.inputs[name] = self.inputs[name], active
        if name == "reference":
            closing = self.quirks.ref_edge == "closing"
            if was != active and active == closing:
                self._reference_edge(now)
            return
        self.drive.stops.inputs[1 if name == "positive_stop" else -1] = active
        self.drive.replan(now)

    def _reference_edge(self, now: Nanos) -> None:
        """Zero the counter in a positive motion (MACS-REF-01)."""
        if self._reference_enabled and self.drive.direction_at(now) > 0:
            self.drive.zero(now, keeps_remaining=self.quirks.ref_retarget == "remaining")
            self._save_counter(now)

    def set_supply(self, now: Nanos, millivolts: int) -> None:
        """The supply voltage."""
        self.faults.set_supply(millivolts)
        self._obey_faults(now)

    def set_temperature(self, now: Nanos, millidegrees: int) -> None:
        """The temperature of the electronics."""
        self.faults.set_temperature(millidegrees)
        self._obey_faults(now)

    def set_fault(self, now: Nanos, name: str, present: bool) -> None:
        """Let a fault be there or gone; UsageError for an unknown one, or one of other models."""
        if name not in FAULTS:
            raise UsageError(f"unknown fault {name!r}: {nearest(name, FAULTS)}")
        if name not in self.faults.names:
            model, names = self.faults.model.name, ", ".join(self.faults.names)
            raise UsageError(f"a {model} has no fault {name!r}; it has: {names}")
        if name == "micro_cut":
            if present:
                self.faults.micro_cut()
        else:
            self.faults.set_cause(name, present)
        self._obey_faults(now)

    def _obey_faults(self, now: Nanos) -> None:
        """A disjunction cuts the motor's power and drops all motion (MACS-STATE-02)."""
        latched = self.faults.latched
        if latched & ~self._told_faults:
            self._emit(FaultLatched(now, latched & ~self._told_faults))
        self._told_faults = latched
        if not self.faults.disjuncted:
            return
        self._armed, self._preload = False, None
        if self.drive.powered:
            self.drive.power_off(now)
            self._save_counter(now)

    def counter_at(self, now: Nanos) -> int:
        """The position counter, as a power failure would save it."""
        return self.drive.counter.at(now)

    def facts(self, now: Nanos) -> dict[str, Any]:
        """What the module's snapshot has of the axis."""
        drive, faults = self.drive, self.faults
        return {
            "position": drive.reading_at(now),
            "powered": drive.powered,
            "busy": drive.is_busy(now),
            "armed": self._armed,
            "preloaded": self._preload is not None,
            "segments_stored": drive.interpolator.stored_at(now),
            "reference_enabled": self._reference_enabled,
            "fault_bits": faults.word,
            "stop_bits": drive.stops.bits,
            "supply_millivolts": faults.supply_millivolts,
            "temperature_millidegrees": faults.temperature_millidegrees,
            **self.inputs,
            **self.values,
        }


_Handler = Callable[[Axis, Nanos, int, Nanos], bool]

_PARAMETERS: Final[dict[int, tuple[Setter, Callable[[Drive, Nanos], None]]]] = {
    0x02: (Parameters.set_standby, Drive.torque_changed),
    0x03: (Parameters.set_stops, Drive.replan),
    0x09: (Parameters.set_superior_stop, Drive.replan),
    0x0A: (Parameters.set_inferior_stop, Drive.replan),
    0x0C: (Parameters.set_torque, Drive.torque_changed),
    0x0D: (Parameters.set_period, Drive.replan),
    0x0E: (Parameters.set_catch_up, Drive.apply_catch_up),
    0x0F: (Parameters.set_ramp, Drive.replan),
    0x1C: (Parameters.set_tolerance, Drive.replan),
}
"""Commands that set a parameter: what takes the value, and what the drive does about it."""

_COMMANDS: Final[dict[int, _Handler]] = {
    0x07: Axis._reference,
    0x0B: Axis._zero_counter,
    0x10: Axis._arm,
    0x11: Axis._synchronise,
    0x13: Axis._go_to,
    0x14: Axis._go_to_zero,
    0x15: Axis._velocity,
    0x16: Axis._segment,
    0x17: Axis._ramped_stop,
    0x18: Axis._hard_stop,
    0x19: Axis._motor_on,
    0x1A: Axis._motor_off,
    0x1E: Axis._virtual_segment,
}

_STARTS: Final[dict[int, _Handler]] = {0x13: Axis._start_go_to, 0x15: Axis._start_velocity}

_QUERIES: Final[tuple[Callable[[Axis, Nanos], int], ...]] = (
    Axis._read_position,
    Axis._read_status,
    Axis._read_superior_stop,
    Axis._read_inferior_stop,
    Axis._read_release,
    Axis._read_speeds,
    Axis._read_modes,
    Axis._read_measures,
)
