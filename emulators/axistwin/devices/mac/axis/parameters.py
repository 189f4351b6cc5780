"""The parameters of a MAC module: what is in use, what is stored, which values are taken.

Rules
-----
1. A parameter is *in use* (``values``) and, with the doubt of MACS-AMB-24, *stored* (``stored``).
   What is stored leaves a durable ``Store`` among the effects before the command returns
   (MACS-PERS-01, -02); what is stored already is not written again.
2. A start-up reads what is stored (ledger §4.1).
3. A setter takes the four parameter bytes as one number and says whether it took the value; what
   it refuses changes nothing (MACS-REPLY-05).
"""

from collections.abc import Callable, Mapping
from typing import TypeAlias

from axistwin.devices.mac.axis.memory_map import (
    MODES,
    PARAMETERS,
    SERIAL_ADDRESSES,
    STOPS_MODES,
    admissible,
    factory_values,
)
from axistwin.devices.mac.axis.quirks import MacQuirks
from axistwin.kernel.effects import Store


def signed_32(number: int) -> int:
    """A 32-bit field as two's complement (MACS-FRAME-05)."""
    return number - (1 << 32) if number >> 31 else number


class Parameters:
    """Parameters and nonvolatile cells; unknown or impossible ``cells`` are ignored.

    ``emit`` takes what is to be stored.  addresses: those a module of this model can have.
    """

    def __init__(
        self,
        quirks: MacQuirks,
        cells: Mapping[str, int],
        emit: Callable[[Store], None],
        addresses: range = SERIAL_ADDRESSES,
    ) -> None:
        self._quirks = quirks
        self._emit = emit
        self._factory = factory_values(quirks, addresses)
        self.stored = {**self._factory, **admissible(cells, quirks, addresses)}
        self.values = {name: self.stored[name] for name in PARAMETERS}

    def store(self, name: str, value: int) -> None:
        """Keep ``value`` over power-off."""
        if self.stored[name] != value:
            self.stored[name] = value
            self._emit(Store(((name, value),)))

    def save_position(self, position: int) -> None:
        """Hand on the counter, which the hardware saves when the supply fails (MACS-Q-20-02)."""
        self.stored["position"] = position
        self._emit(Store((("position", position),), durable=False))

    def read_stored(self) -> None:
        """Use what is stored."""
        self.values.update((name, self.stored[name]) for name in PARAMETERS)

    def restore_factory_values(self) -> None:
        """01h: everything but the position as from the factory (MACS-CMD-01-01, -02)."""
        fresh = {**self._factory}
        del fresh["position"]
        changed = tuple(item for item in fresh.items() if self.stored[item[0]] != item[1])
        self.stored.update(changed)
        if changed:
            self._emit(Store(changed))
        self.read_stored()

    def in_printed_set(self, value: int, allowed: tuple[int, ...], mask: int) -> int | None:
        """``value``, or what it counts as, of a printed set; None: refused (MACS-AMB-60)."""
        policy = self._quirks.param_range_policy
        if value in allowed:
            return value
        if policy == "mask":
            return value & mask if value & mask in allowed else None
        if policy == "clamp":
            return max((item for item in allowed if item <= value), default=min(allowed))
        return None

    def set_standby(self, number: int) -> bool:
        """02h: 1 for half torque at rest (MACS-CMD-02-01)."""
        return self._set("standby", self.in_printed_set(number & 0xFF, (0, 1), 0x01))

    def set_stops(self, number: int) -> bool:
        """03h: bit 0 hardware, bit 3 software stops (MACS-CMD-03-01)."""
        return self._set("stops", self.in_printed_set(number & 0xFF, STOPS_MODES, 0x09))

    def set_superior_stop(self, number: int) -> bool:
        """09h: any signed 32-bit position (MACS-CMD-09-01, MACS-AMB-54)."""
        return self._set("superior_stop", signed_32(number))

    def set_inferior_stop(self, number: int) -> bool:
        """0Ah: any signed 32-bit position (MACS-CMD-0A-01)."""
        return self._set("inferior_stop", signed_32(number))

    def set_torque(self, number: int) -> bool:
        """0Ch: the torque limit in parts of Imax (MACS-CMD-0C-01, -02, MACS-AMB-10)."""
        value, quirks = number & 0xFF, self._quirks
        margin = 0 if quirks.torque_range == "inclusive" else 1
        low, high = margin, quirks.imax_value - margin
        if not low <= value <= high:
            if quirks.torque_over == "clamp":
                value = max(low, min(high, value))
            elif quirks.torque_over == "mask":
                value &= 0x7F
        return self._set("torque", value if low <= value <= high else None)

    def set_period(self, number: int) -> bool:
        """0Dh: ticks per increment at maximum speed (MACS-CMD-0D-01, -03)."""
        period_ticks = number & 0xFFFF
        if period_ticks == 0 and self._quirks.zero_period_0d == "as_one":
            period_ticks = 1
        return self._set("period", period_ticks or None)

    def set_catch_up(self, number: int) -> bool:
        """0Eh: the third byte, in 200 µs per increment (MACS-CMD-0E-01, MACS-AMB-47)."""
        value, low_byte = number >> 8 & 0xFF, number & 0xFF
        refused = low_byte and self._quirks.catchup_low_byte == "refuse"
        refused = refused or (value == 0 and self._quirks.zero_catchup == "refuse")
        return self._set("catchup", None if refused else value)

    def set_ramp(self, number: int) -> bool:
        """0Fh: the ramp coefficient, 120 increments each (MACS-CMD-0F-01)."""
        return self._set("ramp", number & 0xFF)

    def set_tolerance(self, number: int) -> bool:
        """1Ch: the tolerance in increments (MACS-CMD-1C-01)."""
        return self._set("tolerance", number & 0xFF)

    def _set(self, name: str, value: int | None) -> bool:
        """Use ``value`` from now on and store it; None is refused."""
        if value is None:
            return False
        self.values[name] = value
        if name not in MODES or self._quirks.persist_modes == "stored":
            self.store(name, value)
        return True


Setter: TypeAlias = Callable[[Parameters, int], bool]
