"""Scaling and thresholds of the three models, and the faults they lead to (ledger §5.9)."""

from fractions import Fraction

import pytest

from axistwin.devices.mac.axis.faults import Faults
from axistwin.devices.mac.axis.models import MAC23, MAC34_1, MAC34_2, MODELS, MacModel
from axistwin.devices.mac.axis.quirks import parse_quirks

SCALES = [
    (MAC23, Fraction(5, 2), -215, Fraction(10, 48)),
    (MAC34_1, Fraction(245, 100), -140, Fraction(4, 10)),
    (MAC34_2, Fraction(245, 100), -140, Fraction(8, 10)),
]


@pytest.mark.parametrize(("model", "slope", "offset", "volts"), SCALES)
def test_every_raw_measure_is_the_one_nearest_to_its_value(
    model: MacModel, slope: Fraction, offset: int, volts: Fraction
) -> None:
    """°C = slope·tt + offset, V = volts·vv: each raw value comes back from its own formula."""
    for raw in range(256):
        assert model.raw_temperature(round((slope * raw + offset) * 1000)) == raw
        assert model.raw_supply(round(volts * raw * 1000)) == raw


@pytest.mark.parametrize("model", MODELS.values())
def test_measures_stay_in_a_byte(model: MacModel) -> None:
    """Whatever the surroundings."""
    assert model.raw_temperature(-300_000) == 0
    assert model.raw_temperature(10_000_000) == 255
    assert model.raw_supply(0) == 0
    assert model.raw_supply(10_000_000) == 255


def test_85_degrees_do_not_trip_a_mac23() -> None:
    """78h is 85 °C exactly, which is not above it (ledger §5.9)."""
    assert MAC23.trips(0, 0x78) == 0
    assert MAC23.trips(0, 0x79) == 0x10


def test_limits_from_the_quirk_replace_those_of_a_mac34_only() -> None:
    """MACS-AMB-56: UNDER/OVER/VMAX/TRIP."""
    quirks = parse_quirks({"mac34_limits": "20/40/48/60"})
    assert MAC23.with_limits(quirks) is MAC23
    model = MAC34_1.with_limits(quirks)
    assert model.warnings(50) == 0x20
    assert model.warnings(51) == 0
    assert model.warnings(100) == 0x40
    assert model.trips(150, 0) == 0
    assert model.trips(151, 0) == 0x08
    assert model.trips(0, 81) == 0
    assert model.trips(0, 82) == 0x04


def test_a_latched_fault_outlives_its_cause_until_acknowledged() -> None:
    """MACS-Q-21-02, MACS-STATE-03."""
    faults = Faults(MAC34_1, encoder_locks=True)
    faults.set_cause("encoder", True)
    faults.acknowledge()
    assert faults.word == 0x02
    faults.set_cause("encoder", False)
    assert faults.word == 0x02
    assert faults.disjuncted
    faults.acknowledge()
    assert faults.word == 0


def test_over_voltage_is_remembered_and_locks_nothing() -> None:
    """MACS-Q-21-03."""
    faults = Faults(MAC23, encoder_locks=True)
    faults.set_supply(46_100)
    assert faults.word == 0x40
    faults.set_supply(24_000)
    assert faults.word == 0
    assert faults.over_voltage_seen
    assert not faults.disjuncted
    faults.acknowledge()
    assert not faults.over_voltage_seen
