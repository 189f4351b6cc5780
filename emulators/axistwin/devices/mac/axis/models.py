"""The MAC models: resolution, scaling of the measures, thresholds, fault bits.

All thresholds are compared in raw units, as 27h shows them, so that a fault and the measure that
explains it never contradict (ledger §5.9).  The manual gives no MAC34 thresholds (MACS-AMB-56):
the twin's own stand in the table and ``mac34_limits`` replaces them.  Torque and rotor inertia,
which only the inertial plant uses, are the manual's for the MAC23 (ledger §5.4) and chosen for the
MAC34.
"""

from dataclasses import dataclass, replace
from fractions import Fraction

from axistwin.devices.mac.axis.memory_map import SERIAL_ADDRESSES
from axistwin.devices.mac.axis.quirks import MacQuirks

# Bits of dd in the answer to 21h (ledger §5.9).
OVER_VOLTAGE_WARNING = 0x40
UNDER_VOLTAGE_WARNING = 0x20
MAC23_THERMAL = 0x10
MAC34_AMPLIFIER = 0x08
MAC34_THERMAL = 0x04
MAC34_ENCODER = 0x02
MICRO_CUT = 0x01


@dataclass(frozen=True, slots=True)
class MacModel:
    """One model's fixed data.

    Temperature °C = scale·raw + offset, in millidegrees.  Supply V = raw·scale, where one raw step
    is ``supply_step_uv`` microvolts.  The ``raw_*`` thresholds are inclusive.  The first of
    ``addresses`` is the factory's.  ``reserved_status_bits``: those of dd in 21h that mean nothing;
    serial modules share one layout (MACS-Q-21-02), the CAN module has a narrower one (CAN's §5.1).
    """

    name: str
    increments_per_turn: int
    temperature_step_m: int
    temperature_offset_m: int
    supply_step_uv: int
    nominal_millivolts: int
    raw_under_voltage: int
    raw_over_voltage: int
    raw_supply_trip: int
    raw_thermal_trip: int
    thermal_bit: int
    fault_bits: int
    torque_max_nm: Fraction
    rotor_inertia_kgcm2: Fraction
    addresses: range = SERIAL_ADDRESSES
    reserved_status_bits: int = 0x80

    def raw_temperature(self, millidegrees: int) -> int:
        """The measure tt of 27h nearest to a temperature, held at 0 and 255."""
        return _nearest(millidegrees - self.temperature_offset_m, self.temperature_step_m)

    def raw_supply(self, millivolts: int) -> int:
        """The measure vv of 27h nearest to a supply voltage, held at 0 and 255."""
        return _nearest(millivolts * 1000, self.supply_step_uv)

    def celsius(self, raw_temperature: int) -> float:
        """The temperature of the measure tt."""
        return (self.temperature_step_m * raw_temperature + self.temperature_offset_m) / 1000

    def volts(self, raw_supply: int) -> float:
        """The supply of the measure vv."""
        return self.supply_step_uv * raw_supply / 1_000_000

    def warnings(self, raw_supply: int) -> int:
        """The live warning bits of dd (MACS-Q-21-02)."""
        if raw_supply >= self.raw_over_voltage:
            return OVER_VOLTAGE_WARNING
        return UNDER_VOLTAGE_WARNING if raw_supply <= self.raw_under_voltage else 0

    def trips(self, raw_supply: int, raw_temperature: int) -> int:
        """The disjunction bits of dd whose measured cause is present now."""
        thermal = self.thermal_bit if raw_temperature >= self.raw_thermal_trip else 0
        amplifier = MAC34_AMPLIFIER if raw_supply >= self.raw_supply_trip else 0
        return thermal | amplifier

    def with_limits(self, quirks: MacQuirks) -> "MacModel":
        """This model with the thresholds that ``mac34_limits`` asks for (MACS-AMB-56)."""
        if quirks.mac34_limits == "model" or not self.fault_bits & MAC34_THERMAL:
            return self
        under, over, v_max, trip = map(int, quirks.mac34_limits.split("/"))
        return replace(
            self,
            raw_under_voltage=self.raw_supply(under * 1000),
            raw_over_voltage=self.raw_supply(over * 1000),
            raw_supply_trip=v_max * 1_250_000 // self.supply_step_uv + 1,
            raw_thermal_trip=(trip * 1000 - self.temperature_offset_m) // self.temperature_step_m
            + 1,
        )


def _nearest(value: int, step: int) -> int:
    return max(0, min(255, (2 * value + step) // (2 * step)))


_NEVER = 256  # no eight-bit measure reaches it

MAC23 = MacModel(
    name="mac23",
    increments_per_turn=2000,
    temperature_step_m=2500,
    temperature_offset_m=-215_000,
    supply_step_uv=208_333,  # 1/4.8 V
    nominal_millivolts=24_000,
    raw_under_voltage=0x39,
    raw_over_voltage=0xDD,
    raw_supply_trip=_NEVER,
    raw_thermal_trip=0x79,  # above 85 °C = 78h
    thermal_bit=MAC23_THERMAL,
    fault_bits=MAC23_THERMAL | MICRO_CUT,
    torque_max_nm=Fraction(14, 10),
    rotor_inertia_kgcm2=Fraction(44, 100),
)

MAC34_1 = MacModel(
    name="mac34-1",
    increments_per_turn=10_000,
    temperature_step_m=2450,
    temperature_offset_m=-140_000,
    supply_step_uv=400_000,
    nominal_millivolts=48_000,
    raw_under_voltage=60,  # 24 V
    raw_over_voltage=150,  # 60 V
    raw_supply_trip=201,  # above 125 % of 64 V
    raw_thermal_trip=92,  # above 85 °C
    thermal_bit=MAC34_THERMAL,
    fault_bits=MAC34_AMPLIFIER | MAC34_THERMAL | MAC34_ENCODER | MICRO_CUT,
    torque_max_nm=Fraction(34, 10),
    rotor_inertia_kgcm2=Fraction(14, 10),
)

MAC34_2 = replace(
    MAC34_1,
    name="mac34-2",
    supply_step_uv=800_000,
    nominal_millivolts=96_000,
)

MODELS: dict[str, MacModel] = {model.name: model for model in (MAC23, MAC34_1, MAC34_2)}
"""The models with a serial line."""

MAC23_CAN = replace(MAC23, name="mac23-can", addresses=range(1, 0x80), reserved_status_bits=0x8E)
"""The MAC23 on CAN: no address 0, which is the general identifier's (MACC-ID-01, ledger §6.1)."""
