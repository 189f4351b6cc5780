"""What every MAC module is, whatever it talks on: power, reset input, restarts, surroundings.

A *face* (``serial``) adds the wire: what it hears, what it replies, whom it obeys.  The axis knows
what a command means.  In between stands the module, which is off, held in reset, starting up, or
alive, and which tells what becomes of it.

    off --power_on--> BT --boot time--> alive --take_over--> BT      (00h, 01h and their like)
     ^                 ^                  |
     +---power_off     +---RI<------------+                          (reset input, any time)

Rules
-----
1. A restart drops motion and everything volatile, and works with what is stored (MACS-CMD-00-01).
2. In BT and RI the module hears nothing, and what came before is forgotten (MACS-CMD-00-02).
3. A new state (ledger §4.1) is told (``StateChanged``).
4. Everything that is due happens in the order of time before a call from outside looks or acts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from axistwin.devices.mac.axis.acceptance import state_text
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.models import MacModel
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.devices.snapshot import Snapshot
from axistwin.devices.traces import Refused, StateChanged
from axistwin.errors import UsageError
from axistwin.kernel.effects import Effect, Silence
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.motion.plant import Load

RESET_INPUT: Final = "reset"


@dataclass(frozen=True, slots=True)
class ModuleSnapshot(Snapshot):
    """A module at one instant.

    state: as in ``state_code``.  position: as 20h reads it.  powered: whether the motor has torque.
    armed, preloaded: synchronous mode.  segments_stored: the interpolator's queue.
    fault_bits, stop_bits: dd and the low bits of ff of 21h.  The inputs are true while tied to
    ground; the rest are the parameters in use, as the commands that set them have them.
    """

    model: str
    address: int
    state: str
    state_text: str
    position: int
    powered: bool
    busy: bool
    armed: bool
    preloaded: bool
    segments_stored: int
    reference_enabled: bool
    fault_bits: int
    stop_bits: int
    supply_millivolts: int
    temperature_millidegrees: int
    positive_stop: bool
    negative_stop: bool
    reference: bool
    standby: int
    stops: int
    torque: int
    catchup: int
    ramp: int
    tolerance: int
    period: int
    superior_stop: int
    inferior_stop: int


class MacModule:
    """A module without its wire, at rest and switched off until ``switch_on`` or ``power_on``.

    ``cells`` are what is stored already.
    """

    def __init__(self, model: MacModel, quirks: MacQuirks, cells: Mapping[str, int]) -> None:
        self.quirks = quirks
        self.model = model
        self.axis = Axis(model, quirks, cells)
        self.address = 0
        self._load = Load()
        self._boot_ns = quirks.boot_time_ms * NS_PER_MS
        self._effects: list[Effect] = []
        # Power, reset input, restart: when each next thing happens.
        self._powered = False
        self._reset_held = False
        self._take_over_at: Nanos = NEVER
        self._take_over_restarts = False
        self._boot_end: Nanos = NEVER
        self._due: Nanos = NEVER
        self._told_state = "off"

    def _switch_on(self, *, started: bool) -> None:
        """Apply the supply at time 0; a ``started`` module has its boot time behind it then."""
        self.power_on(0)
        if started:
            self._hear_nothing(0)
            self._boot_end = self._due = 0
            self._run_until(0)

    # ---- what a face adds ------------------------------------------------------------------------

    def _take_over_stored(self) -> None:
        """Work with the stored address from now on."""
        self.address = self.axis.stored["address"]

    def _hear_nothing(self, until: Nanos) -> None:
        """Be deaf ``until`` then; what was heard and is to be sent so far is forgotten."""

    def _booted(self, now: Nanos) -> None:
        """The module is alive from ``now`` on."""

    # ---- time ----------------------------------------------------------------------------------

    def next_event(self) -> Nanos | None:
        """When something happens by itself: a restart, the end of the boot, an event of motion."""
        return None if self._due == NEVER else self._due

    def wake(self, now: Nanos) -> list[Effect]:
        """Do what is due at ``now``."""
        self._run_until(now)
        return self._taken_effects()

    def _run_until(self, now: Nanos) -> None:
        """Everything due by ``now``, in the order of time."""
        while self._due <= now:
            due = self._due
            self._do(due)
            self._collect(due)
            self._reschedule()

    def _do(self, due: Nanos) -> None:
        """The one thing that is due."""
        if due == self._take_over_at:
            self._take_over(due)
        elif due == self._boot_end:
            self._boot_end = NEVER
            self.axis.start(due)
            self._booted(due)
        else:
            self.axis.run(due)

    def _collect(self, now: Nanos) -> None:
        """Take the axis' effects, and tell the state if it is another one."""
        if effects := self.axis.take_effects():
            self._effects += effects
        state = self._state_code()
        if state != self._told_state:
            self._told_state = state
            self._effects.append(StateChanged(now, state, state_text(state)))

    def _tell_refusal(self, now: Nanos, index: int, *, is_locked: bool) -> None:
        """Say why command ``index`` is refused: for the state, or for what it asks."""
        reason = f"refused {index:02X}h: its value is out of range, or the way is barred"
        if is_locked:
            reason = f"refused {index:02X}h: {state_text(self._state_code())}"
        self._effects.append(Refused(now, reason))

    def _take_over(self, now: Nanos) -> None:
        self._take_over_at = NEVER
        self._take_over_stored()
        if self._take_over_restarts:
            self._begin_boot(now)

    def _begin_boot(self, now: Nanos) -> None:
        """Enter BT: motion dropped, deaf for the boot time (MACS-CMD-00-01, -02)."""
        self.axis.shut_down(now)
        self._boot_end = now + self._boot_ns
        self._hear_nothing(self._boot_end)

    def _reschedule(self) -> None:
        due, motion = min(self._take_over_at, self._boot_end), self.axis.next_event()
        self._due = due if motion is None or due < motion else motion

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
            self._take_over_at = self._boot_end = NEVER
            self._hear_nothing(NEVER)
            self.axis.power_off(now)
        return self._settle(now)

    def power_on(self, now: Nanos) -> list[Effect]:
        """Apply the supply: boot time, then at rest and unpowered (MACS-AMB-21, -26)."""
        if not self._powered:
            self._powered = True
            self._take_over_stored()
            self.axis.power_on(now)
            if self._reset_held:
                self._hear_nothing(NEVER)
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
            self._take_over_at = self._boot_end = NEVER
            self._hear_nothing(NEVER)
            self._effects.append(Silence())
            self.axis.shut_down(now)
        else:
            self._take_over_stored()
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
        self.axis.drive.set_load(now, load)
        self._load = load
        return self._settle(now)

    def push(self, now: Nanos, increments: int) -> list[Effect]:
        """Turn the shaft by hand, by signed ``increments``, against nothing but the regulation."""
        self._run_until(now)
        self.axis.drive.push(now, increments)
        return self._settle(now)

    # ---- for whoever looks on --------------------------------------------------------------------

    def cells(self, now: Nanos) -> Mapping[str, int]:
        """All nonvolatile cells; the position is the one a power failure would save at ``now``."""
        self._run_until(now)
        return {**self.axis.stored, "position": self.axis.counter_at(now)}

    def is_moving(self, now: Nanos) -> bool:
        """Whether the position changes by itself."""
        self._run_until(now)
        return self.axis.drive.is_moving(now)

    def position_at(self, now: Nanos) -> int:
        """The position counter, as 20h would read it."""
        self._run_until(now)
        return self.axis.drive.reading_at(now)

    def state_code(self, now: Nanos) -> str:
        """The state of ledger §4.1: BT RI OF HD PO VE IN DJ, with +AR or +PL where it applies."""
        self._run_until(now)
        return self._state_code()

    def _state_code(self) -> str:
        if not self._powered:
            return "off"
        if self._reset_held:
            return "RI"
        return "BT" if self._boot_end != NEVER else self.axis.state_code()

    def input_at(self, now: Nanos, name: str) -> bool:
        """Whether input ``name`` is tied to ground."""
        return self._reset_held if name == RESET_INPUT else self.axis.inputs[name]

    def load_at(self, now: Nanos) -> Load:
        """What hangs on the shaft."""
        return self._load

    def velocity_at(self, now: Nanos) -> float:
        """The signed speed of the shaft, increments per second."""
        self._run_until(now)
        return float(self.axis.drive.plant.speed_at(now) * NS_PER_S)

    def facts(self, now: Nanos) -> dict[str, Any]:
        """What a face's snapshot has of every module."""
        state = self.state_code(now)
        return {
            "model": self.model.name,
            "address": self.address,
            "state": state,
            "state_text": state_text(state),
            **self.axis.facts(now),
        }
