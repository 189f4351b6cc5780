"""Supply, temperature and what becomes of them: warnings, latched faults, the motor's fuse.

Rules
-----
1. Warnings are live and refuse nothing (MACS-STATE-04).
2. A disjunction bit latches when its cause appears and stays when the cause goes; only a restart
   clears it (MACS-Q-21-02), and if the cause is still there it comes back at once (MACS-STATE-03).
3. Over-voltage is remembered apart, in hh.7, and locks nothing (MACS-Q-21-03).
4. A cause that the model has no bit for does not exist: a MAC23 has no encoder fault.
"""

from dataclasses import dataclass
from typing import Final

from axistwin.devices.mac.axis.models import (
    MAC34_AMPLIFIER,
    MAC34_ENCODER,
    MICRO_CUT,
    OVER_VOLTAGE_WARNING,
    MacModel,
)
from axistwin.kernel.effects import Trace

CAUSES: Final[dict[str, int]] = {"amplifier": MAC34_AMPLIFIER, "encoder": MAC34_ENCODER}
"""Faults that are not measured but happen: over-current or earth leak; encoder not found."""

FAULTS: Final = (*CAUSES, "micro_cut")
"""All that can happen to a module of some model, by name."""

ROOM_MILLIDEGREES: Final = 25_000


@dataclass(frozen=True, slots=True)
class FaultLatched(Trace):
    """A cause has latched: ``bits`` are the new ones of dd."""

    bits: int

    def __str__(self) -> str:
        return f"fault {self.bits:02X}h has latched"


class Faults:
    """The fault word dd, the over-voltage memory, and the measures they come from."""

    def __init__(self, model: MacModel, *, encoder_locks: bool) -> None:
        self.model = model
        self.supply_millivolts = model.nominal_millivolts
        self.temperature_millidegrees = ROOM_MILLIDEGREES
        self.latched = 0
        self.over_voltage_seen = False
        self._lasting = 0  # bits of causes that are present now, measured ones excluded
        self._locking = model.fault_bits & ~(0 if encoder_locks else MAC34_ENCODER)
        self._measure()

    def set_supply(self, millivolts: int) -> None:
        """The supply voltage from now on."""
        self.supply_millivolts = millivolts
        self._measure()

    def set_temperature(self, millidegrees: int) -> None:
        """The temperature of the electronics from now on."""
        self.temperature_millidegrees = millidegrees
        self._measure()

    def set_cause(self, name: str, present: bool) -> None:
        """Let a cause of ``CAUSES`` be there or gone."""
        bit = CAUSES[name] & self.model.fault_bits
        self._lasting = self._lasting | bit if present else self._lasting & ~bit
        self._measure()

    @property
    def names(self) -> tuple[str, ...]:
        """Those of ``FAULTS`` that the model has a bit for (rule 4)."""
        return tuple(name for name in FAULTS if CAUSES.get(name, MICRO_CUT) & self.model.fault_bits)

    @property
    def is_locking_cause_present(self) -> bool:
        """Whether a disjunction would come back at once if it were acknowledged (rule 2)."""
        trips = self.model.trips(self.raw_supply, self.raw_temperature) | self._lasting
        return bool(trips & self._locking)

    def micro_cut(self) -> None:
        """A disturbance of the supply too short to stop the module (dd.0)."""
        self.latched |= MICRO_CUT

    def acknowledge(self) -> None:
        """Forget what is latched; causes that are still there latch again (rule 2)."""
        self.latched = 0
        self.over_voltage_seen = False
        self._measure()

    @property
    def disjuncted(self) -> bool:
        """Whether a latched fault has cut the motor's power."""
        return bool(self.latched & self._locking)

    @property
    def word(self) -> int:
        """The byte dd of 21h."""
        return self.latched | self.model.warnings(self.raw_supply)

    def _measure(self) -> None:
        """Read both measures and judge them."""
        model = self.model
        self.raw_supply = model.raw_supply(self.supply_millivolts)
        self.raw_temperature = model.raw_temperature(self.temperature_millidegrees)
        self.latched |= model.trips(self.raw_supply, self.raw_temperature) | self._lasting
        if model.warnings(self.raw_supply) & OVER_VOLTAGE_WARNING:
            self.over_voltage_seen = True
