"""A MAC axis and its surroundings: faults, what it tells, its memories (ledger §5.9)."""

import pytest
from mac_bench import PERIOD, SILENCE, TICK_NS, MacBench, S, moving

from axistwin.devices.mac.axis.faults import FaultLatched
from axistwin.devices.mac.axis.stops import StopMet
from axistwin.devices.traces import Refused, StateChanged
from axistwin.kernel.effects import Trace

# ---- faults (§5.9) ----


def test_the_mac23_trips_above_78h_and_the_fault_latches() -> None:
    """Cause gone, fault stays; 1Ah and 19h do not clear it; 00h does (MACS-Q-21-02, -STATE-02)."""
    bench = moving(100_000)
    bench.take(bench.device.set_temperature(bench.now, 85_000))
    assert bench.read(0x27) >> 24 == 0x78
    assert bench.read(0x21) == 0
    bench.take(bench.device.set_temperature(bench.now, 87_500))
    assert bench.read(0x27) >> 24 == 0x79
    assert bench.read(0x21) == 0x10000000
    assert bench.state() == "DJ"
    rest = bench.position()
    bench.take(bench.device.set_temperature(bench.now, 25_000))
    bench.refuse(0x13, 0)
    bench.refuse(0x19)
    bench.refuse(0x1A)
    assert bench.read(0x21) == 0x10000000
    assert bench.position() == rest
    bench.reset()
    assert bench.read(0x21) == 0
    bench.do(0x14)


def test_a_fault_whose_cause_persists_is_back_after_the_reset() -> None:
    """MACS-STATE-03."""
    bench = MacBench()
    bench.take(bench.device.set_temperature(bench.now, 100_000))
    bench.reset()
    assert bench.read(0x21) == 0x10000000
    bench.refuse(0x13, 5)


@pytest.mark.parametrize(
    ("raw", "dd", "hh"),
    [(0xDC, 0, 0), (0xDD, 0x40, 0x80), (0x3A, 0, 0), (0x39, 0x20, 0)],
)
def test_supply_warnings_are_live_and_refuse_nothing(raw: int, dd: int, hh: int) -> None:
    """Over-voltage is remembered in hh.7 until a restart (MACS-Q-21-02, -03, MACS-STATE-04)."""
    bench = MacBench()
    bench.take(bench.device.set_supply(bench.now, raw * 10_000 // 48))
    assert bench.read(0x27) >> 16 & 0xFF == raw
    assert bench.read(0x21) == dd << 24 | hh
    bench.do(0x13, 10)
    bench.take(bench.device.set_supply(bench.now, 24_000))
    assert bench.read(0x21) == hh
    bench.reset()
    assert bench.read(0x21) == 0


def test_a_micro_cut_disjuncts() -> None:
    """dd.0."""
    bench = moving(1000)
    bench.take(bench.device.set_fault(bench.now, "micro_cut", True))
    assert bench.read(0x21) == 0x01000000
    assert bench.state() == "DJ"
    bench.power_cycle()
    assert bench.read(0x21) == 0


def test_a_disjunction_drops_what_was_to_come_though_the_motor_was_unpowered() -> None:
    """11h, where it is taken, starts nothing then (MACS-STATE-02, MACS-AMB-33)."""
    bench = MacBench(disj_refuse_set="starting")
    bench.do(0x10)
    bench.do(0x13, 1000)
    bench.take(bench.device.set_fault(bench.now, "micro_cut", True))
    assert bench.state() == "DJ"
    bench.do(0x11)
    bench.advance(S)
    assert bench.state() == "DJ"
    assert bench.position() == 0
    assert bench.device.describe(bench.now)["powered"] is False
    bench = MacBench(disj_refuse_set="starting")
    bench.do(0x10)
    bench.take(bench.device.set_fault(bench.now, "micro_cut", True))
    assert bench.state() == "DJ"


@pytest.mark.parametrize("model", ["mac34-1", "mac34-2"])
def test_the_mac34_has_faults_of_its_own(model: str) -> None:
    """Amplifier dd.3, thermal dd.2, encoder dd.1; supply beyond 125 % Vmax is dd.3."""
    for name, dd in (("amplifier", 8), ("encoder", 2)):
        bench = MacBench(model)
        bench.take(bench.device.set_fault(bench.now, name, True))
        assert bench.read(0x21) >> 24 == dd
        assert bench.state() == "DJ"
        bench.take(bench.device.set_fault(bench.now, name, False))
        bench.reset()
        assert bench.state() == "OF"
    bench = MacBench(model)
    bench.take(bench.device.set_temperature(bench.now, 90_000))
    assert bench.read(0x21) >> 24 == 4
    bench = MacBench(model)
    volts = 81 if model == "mac34-1" else 161
    bench.take(bench.device.set_supply(bench.now, volts * 1000))
    assert bench.read(0x21) == 0x48000080


# ---- what is told ----


def told(bench: MacBench) -> list[tuple[str, int | str]]:
    """Kind and value of every trace so far."""
    traces = [
        effect
        for effect in bench.effects
        if isinstance(effect, Trace) and not isinstance(effect, Refused)
    ]
    times = [trace.time_ns for trace in traces]
    assert times == sorted(times)
    named: list[tuple[str, int | str]] = []
    for trace in traces:
        match trace:
            case StateChanged(state=state):
                named.append(("state", state))
            case StopMet(stop=stop):
                named.append(("stop", stop))
            case FaultLatched(bits=bits):
                named.append(("fault", bits))
    assert len(named) == len(traces)
    return named


def test_states_and_stops_are_told_when_they_change() -> None:
    """At their own time, queries not at all."""
    bench = MacBench(factory_stops=8, factory_superior_stop=50)
    bench.position()
    bench.refuse(0x0D, 0)
    assert told(bench) == []
    bench.do(0x10)
    bench.do(0x13, 1000)
    bench.do(0x11)
    bench.settle()
    states = [("state", "OF+AR"), ("state", "OF+PL"), ("state", "PO")]
    assert told(bench) == [*states, ("stop", "software +"), ("state", "HD")]
    bench.take(bench.device.power_off(bench.now))
    bench.take(bench.device.power_on(bench.now))
    bench.advance(3 * S)
    assert told(bench)[-3:] == [("state", "off"), ("state", "BT"), ("state", "OF")]
    bench.input("reset", True)
    bench.input("reset", False)
    assert told(bench)[-2:] == [("state", "RI"), ("state", "BT")]


def test_faults_are_told_when_they_latch() -> None:
    """Once, and again when a restart finds the cause still there."""
    bench = moving(1000)
    for millidegrees in (87_500, 90_000):
        bench.take(bench.device.set_temperature(bench.now, millidegrees))
    assert told(bench) == [("state", "PO"), ("fault", 0x10), ("state", "DJ")]
    bench.reset()
    assert told(bench)[3:] == [("state", "BT"), ("fault", 0x10), ("state", "DJ")]


# ---- memories ----


def test_imax_is_the_ram_byte_at_afh() -> None:
    """28h AF: first of four bytes (MACS-Q-28-01)."""
    assert MacBench().read(0x28, 0xAF) == 0x80000000
    assert MacBench().read(0x28, 0xAE) == 0x00800000


def test_the_eeprom_shows_what_is_stored_first_byte_first() -> None:
    """The map of ``memory_map``; erased elsewhere."""
    bench = MacBench(address=5, cells={"position": -2})
    bench.do(0x0D, 0x1234)
    bench.do(0x0C, 0x33)
    assert bench.read(0x29, 0x00) == 0x05030100
    assert bench.read(0x29, 0x04) == 0x33050A00
    assert bench.read(0x29, 0x08) == 0x1234FFFF
    assert bench.read(0x29, 0x0C) == 0x3FFFFFFF
    assert bench.read(0x29, 0x10) == 0xC0000000
    assert bench.read(0x29, 0x14) == 0xFFFFFFFE
    assert bench.read(0x29, 0x40) == 0xFFFFFFFF


def test_ram_shows_the_position_in_use() -> None:
    """The private part of the map (MACS-AMB-65)."""
    bench = moving(1000)
    bench.settle()
    assert bench.read(0x28, 0x80) == 1000
    assert bench.read(0x28, 0x84) == 0x60010500
    assert bench.read(0x28, 0x88) == 0x03200000


def test_describe_names_the_state() -> None:
    """For panels and failing tests."""
    bench = moving(1000)
    told = bench.device.describe(bench.now)
    assert told["model"] == "mac23"
    assert told["state"] == "PO"
    assert told["period"] == PERIOD
    assert told["powered"] is True
    assert bench.device.is_moving(bench.now)
    assert bench.ask(0x20, address=3) == SILENCE


def test_other_models_turn_with_their_own_resolution_under_inertia() -> None:
    """MAC34: 10000 increments per turn (ledger §1)."""
    assert MacBench("mac34-1").device.model.increments_per_turn == 10_000
    bench = MacBench("mac34-2", plant="inertial", factory_ramp=0)
    bench.do(0x13, 5000)
    start = bench.etx_ns
    end = bench.settle()
    assert bench.position() == 5000
    assert end - start > 5000 * PERIOD * TICK_NS
