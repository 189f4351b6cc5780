"""What happens to a MAC axis: stops, reference, faults, loads, inertia; its memories."""

import pytest
from mac_bench import MS, SILENCE, TICK_NS, MacBench, S

from axistwin.devices.mac.framing import request
from axistwin.kernel.effects import Trace
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk

PERIOD = 0x320  # 800 ticks, the ledger's examples
HELD = Load(held=True)
FREE = Load()


def moving(distance: int, aa: int = 1, **quirks: str | int) -> MacBench:
    """A module that has just accepted 13h, period 800."""
    bench = MacBench(factory_ramp=aa, factory_period=PERIOD, **quirks)  # type: ignore[arg-type]
    bench.do(0x13, distance & 0xFFFFFFFF)
    return bench


def ticks_since_etx(bench: MacBench) -> int:
    """Time since the last Etx, which must be a whole number of ticks."""
    ticks, rest = divmod(bench.now - bench.etx_ns, TICK_NS)
    assert rest == 0
    return ticks


# ---- stops ----


def test_a_software_stop_ends_the_motion_one_increment_beyond() -> None:
    """Strict: rests at sup + 1, bit 1 of ff (MACS-CMD-09-02)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500, factory_inferior_stop=-500)
    bench.do(0x13, 10_000)
    bench.settle()
    assert bench.position() == 501
    assert bench.read(0x21) == 0x00020000
    bench.do(0x15, 0x00F60000 | PERIOD)
    assert bench.read(0x21) == 0
    bench.settle()
    assert bench.position() == -501
    assert bench.read(0x21) == 0x00010000


def test_a_position_equal_to_the_stop_is_legal() -> None:
    """It sets no bit (ledger §8.21)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500)
    bench.do(0x13, 500)
    bench.settle()
    assert bench.position() == 500
    assert bench.read(0x21) == 0


@pytest.mark.parametrize("index", [0x13, 0x15, 0x16])
def test_a_command_further_out_is_accepted_and_ends_at_once(index: int) -> None:
    """MACS-AMB-48; the way back is free."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500, cells={"position": 600})
    bench.do(index, {0x13: 1000, 0x15: PERIOD, 0x16: 0x00640400}[index])
    assert bench.position() == 600
    assert bench.state() == "HD"
    assert bench.read(0x21) == 0x00020000
    bench.do(0x13, 550)
    bench.settle()
    assert bench.position() == 550


def test_segments_meet_the_software_stop_too_and_the_fifo_is_emptied() -> None:
    """MACS-STOP-03: out, back, and out again."""
    bench = MacBench(factory_stops=8, factory_superior_stop=50, cells={"position": 60})
    bench.do(0x16, 0xFFCE0400)
    bench.do(0x16, 0x00640400)
    bench.do(0x16, 0x00640400)
    bench.settle()
    assert bench.position() == 51
    assert bench.read(0x21) == 0x00020000


def test_a_stop_drops_the_preload_and_what_waits_for_the_segments() -> None:
    """MACS-AMB-51: nothing moves by itself after a stop."""
    bench = MacBench(factory_stops=8, factory_superior_stop=50)
    for index, parameters in ((0x10, 0), (0x13, 0xFFFFFF00), (0x16, 0x00C80400), (0x11, 0)):
        bench.do(index, parameters)
    bench.settle()
    bench.advance(S)
    assert bench.position() == 51
    bench.do(0x13, 0)
    bench.settle()
    bench.do(0x15, 0x320)
    bench.do(0x10)
    bench.do(0x15, 400)
    bench.settle()
    assert bench.state() == "HD"


@pytest.mark.parametrize("overflow", ["saturate", "wrap"])
@pytest.mark.parametrize("blocks", ["same_direction", "both"])
def test_a_stop_outside_the_counters_range_is_never_met(overflow: str, blocks: str) -> None:
    """It costs no event per increment either (MACS-AMB-54)."""
    bench = MacBench(
        factory_ramp=0, factory_stops=8, position_overflow=overflow, soft_stop_blocks=blocks
    )
    bench.do(0x02, 0)
    for position, command in ((0x3FFFFF00, PERIOD), (-0x40000000 + 256, 0x00F60000 | PERIOD)):
        device = MacBench(
            cells={"position": position, "stops": 8, "superior_stop": 0x7FFFFFFF},
            factory_ramp=0,
            position_overflow=overflow,
            soft_stop_blocks=blocks,
        )
        device.do(0x15, command)
        events = 0
        end = device.now + 2 * S
        while (due := device.device.next_event()) is not None and due <= end:
            device.run_until(due)
            events += 1
        assert events <= 2
        device.run_until(end)
        assert device.state() == "VE"
        limit = 0x3FFFFFFF if position > 0 else -0x40000000
        wrapped = position > 0 > device.position() or position < 0 < device.position()
        assert wrapped if overflow == "wrap" else device.position() == limit


def test_an_axis_that_comes_back_from_a_saturated_counter_meets_its_stop() -> None:
    """The counter stands at its end until the shaft is back there (MACS-AMB-54, saturate)."""
    bench = MacBench(
        cells={"position": 0x3FFFFFFE, "stops": 8, "inferior_stop": 0x3FFFFF00},
        position_overflow="saturate",
    )
    bench.do(0x16, 0x7FFF0010)
    bench.do(0x16, 0x80000010)
    bench.do(0x16, 0x80000010)
    events = 0
    while (due := bench.device.next_event()) is not None:
        bench.run_until(due)
        events += 1
    assert bench.position() == 0x3FFFFEFF
    assert events < 5


def test_disabled_stops_stop_nothing() -> None:
    """03h 00, both kinds (MACS-STOP-02)."""
    bench = MacBench(factory_superior_stop=50)
    bench.input("positive_stop", True)
    bench.do(0x13, 100)
    bench.settle()
    assert bench.position() == 100


@pytest.mark.parametrize(
    ("name", "sign", "ff"), [("positive_stop", 1, 0x08), ("negative_stop", -1, 0x04)]
)
def test_a_hardware_stop_ends_motion_of_its_sign_and_frees_the_other(
    name: str, sign: int, ff: int
) -> None:
    """MACS-STOP-01; level, not edge."""
    bench = MacBench(factory_stops=1)
    bench.do(0x13, sign * 100_000 & 0xFFFFFFFF)
    bench.advance(S)
    bench.input(name, True)
    assert bench.state() == "HD"
    rest = bench.position()
    assert rest * sign > 0
    assert bench.read(0x21) == ff << 16
    bench.do(0x13, sign * 100_000 & 0xFFFFFFFF)
    assert bench.position() == rest
    assert bench.read(0x21) == ff << 16
    bench.do(0x14)
    bench.settle()
    assert bench.position() == 0
    assert bench.read(0x21) == 0


def test_inputs_are_shown_raw_whatever_is_enabled() -> None:
    """27h: cc.5, dd.6, dd.5; idle cc & 28 = 08 (MACS-Q-27-02)."""
    bench = MacBench()
    assert bench.read(0x27) & 0xFFFF == 0x0800
    for name, bits in (("positive_stop", 0x2800), ("negative_stop", 0x0840), ("reference", 0x0820)):
        bench.input(name, True)
        assert bench.read(0x27) & 0xFFFF == bits
        bench.input(name, False)
    assert bench.read(0x21) == 0


@pytest.mark.parametrize("source", ["encoder", "set_point"])
def test_a_software_stop_watches_the_counter_wherever_it_comes_from(source: str) -> None:
    """A held shaft whose set-point is what is counted meets the stop (MACS-AMB-55, -STOP-03)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500, position_source=source)
    bench.do(0x15, PERIOD)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    if source == "encoder":
        assert bench.state() == "VE"
        assert bench.position() < 10
    else:
        assert bench.state() == "HD"
        assert bench.read(0x21) == 0x00020000


@pytest.mark.parametrize("hardware", [False, True])
def test_a_stop_ends_a_catch_up_too(hardware: bool) -> None:
    """It is part of the motion (§4.1), and the stops watch every motion (MACS-STOP-01, -03)."""
    stops = 1 if hardware else 8
    bench = moving(1000, factory_stops=stops, factory_superior_stop=500, factory_catchup=1)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    assert bench.state() == "PO"
    bench.take(bench.device.set_load(bench.now, FREE))
    if hardware:
        bench.advance(10 * MS)
        bench.input("positive_stop", True)
        at = bench.device.position_at(bench.now)
        ff = 0x08
    else:
        at, ff = 501, 0x02
    bench.settle()
    assert bench.position() == at
    assert bench.state() == "HD"
    assert bench.read(0x21) == ff << 16
    bench.advance(S)
    assert bench.position() == at


# ---- reference and counter ----


def reference_pulse(bench: MacBench) -> None:
    """Close and open the contact."""
    bench.input("reference", True)
    bench.advance(10 * MS)
    bench.input("reference", False)


def test_the_counter_is_zeroed_when_the_contact_opens_in_a_positive_move() -> None:
    """The motion goes on (MACS-REF-01); a 13h target stays absolute (MACS-AMB-52)."""
    bench = moving(20_000)
    bench.do(0x07, 1)
    bench.advance(S)
    bench.input("reference", True)
    bench.advance(10 * MS)
    assert bench.device.position_at(bench.now) > 1000
    bench.input("reference", False)
    assert bench.device.position_at(bench.now) == 0
    bench.settle()
    assert bench.position() == 20_000


def test_the_reference_is_ignored_in_a_negative_move_at_rest_and_when_disabled() -> None:
    """MACS-REF-01, MACS-CMD-07-02."""
    bench = moving(20_000)
    bench.advance(S)
    reference_pulse(bench)
    assert bench.device.position_at(bench.now) > 1000
    bench.do(0x18)
    bench.do(0x07, 1)
    reference_pulse(bench)
    assert bench.position() > 1000
    bench.do(0x13, 0xFFFF0000)
    bench.advance(3 * S)
    reference_pulse(bench)
    assert bench.device.position_at(bench.now) < -1000
    bench.reset()
    bench.do(0x15, PERIOD)
    bench.advance(10 * S)
    reference_pulse(bench)
    assert bench.device.position_at(bench.now) > 1000


def test_the_counter_can_be_zeroed_at_rest_and_under_way() -> None:
    """0Bh: later targets count from there (MACS-CMD-0B-01, -02)."""
    bench = moving(500)
    bench.settle()
    bench.do(0x0B)
    assert bench.position() == 0
    assert bench.stores["position"] == 0
    bench.do(0x13, 2000)
    bench.advance(100 * MS)
    before = bench.device.position_at(bench.now)
    assert before > 100
    bench.do(0x0B)
    bench.settle()
    assert bench.position() == 2000


def test_a_target_that_falls_behind_is_reached_in_catch_up() -> None:
    """0Bh near the end of a negative-going account: down the ramp, past, and back (§5.3)."""
    bench = MacBench(factory_ramp=1, factory_catchup=1, cells={"position": -5000})
    bench.do(0x13, 100)
    bench.advance(300 * MS)
    bench.do(0x0B)
    bench.settle()
    assert bench.position() == 100


@pytest.mark.parametrize(
    ("keeps", "way", "end"),
    [
        ("absolute", "catch_up", 200),
        ("absolute", "fresh_profile", 200),
        ("remaining", "catch_up", 150),
    ],
)
def test_zeroing_in_a_catch_up_keeps_what_it_keeps_under_way(
    keeps: str, way: str, end: int
) -> None:
    """13h stays the absolute number, or the way that is left (MACS-AMB-53)."""
    bench = moving(200, reset_in_motion=keeps, overshoot_return=way, factory_catchup=5)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    bench.take(bench.device.set_load(bench.now, FREE))
    while bench.device.position_at(bench.now) < 50:
        bench.advance(MS // 10)
    bench.take(bench.device.receive(Chunk(bench.now, request(0, 0x0B), None)))
    assert bench.device.position_at(bench.now) == 0
    bench.settle()
    assert bench.position() == end


def test_zeroing_after_a_ramped_stop_does_not_bring_the_target_back() -> None:
    """What 17h gave up stays given up, though the axis still runs behind (MACS-CMD-17-01)."""
    bench = moving(20_000, factory_catchup=1)
    bench.advance(S)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.do(0x17)
    bench.advance(S)
    assert bench.state() == "PO"
    bench.do(0x0B)
    bench.take(bench.device.set_load(bench.now, FREE))
    bench.settle()
    assert 0 < bench.position() < 1000


def test_zeroing_shifts_the_software_stops_in_space() -> None:
    """Soft stops use the counter (§5.8)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500)
    bench.do(0x13, 400)
    bench.settle()
    bench.do(0x0B)
    bench.do(0x15, PERIOD)
    bench.settle()
    assert bench.position() == 501


def test_the_counter_wraps_at_31_bits() -> None:
    """MACS-AMB-54."""
    bench = MacBench(cells={"position": 0x3FFFFFF0})
    bench.do(0x16, 0x00200400)
    bench.settle()
    assert bench.position() == -0x40000000 + 0x0F + 1


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


# ---- load, busy, catch-up (§5.5) ----


def test_a_held_axis_is_busy_and_catches_up_at_the_unstall_speed() -> None:
    """Busy is cc.3 = 0; the move is running until it is within the tolerance (MACS-BUSY-01)."""
    bench = moving(100, factory_catchup=10)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    held = bench.device.position_at(bench.now)
    assert held < 100
    assert bench.state() == "PO"
    assert bench.read(0x27) & 0x0800 == 0
    bench.take(bench.device.set_load(bench.now, FREE))
    free = bench.now
    end = bench.settle()
    assert bench.position() == 100
    assert end == free + (100 - held) * 10 * 200_000
    assert bench.read(0x27) & 0x0800


def test_the_tolerance_ends_running_early_but_not_the_regulation() -> None:
    """Regulation goes on to the exact set-point (MACS-BUSY-01, MACS-AMB-27)."""
    bench = moving(100, factory_catchup=10, factory_tolerance=20)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    held = bench.device.position_at(bench.now)
    bench.take(bench.device.set_load(bench.now, FREE))
    free = bench.now
    bench.run_until(free + (100 - held - 20) * 2 * MS - 1)
    assert bench.state() == "PO"
    bench.run_until(bench.now + 1)
    assert bench.state() == "HD"
    assert bench.device.position_at(bench.now) == 80
    bench.advance(10 * S)
    assert bench.position() == 100


def test_a_tolerance_that_grows_under_way_ends_the_wait() -> None:
    """1Ch is free in motion (§4.2)."""
    bench = moving(100)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    assert bench.state() == "PO"
    bench.do(0x1C, 0xFF)
    assert bench.state() == "HD"


@pytest.mark.parametrize(("index", "parameters"), [(0x15, PERIOD), (0x16, 0x7FFF0320)])
def test_in_velocity_and_interpolation_busy_is_a_speed_not_held(
    index: int, parameters: int
) -> None:
    """MACS-BUSY-02: free again it keeps its lag and is not busy."""
    bench = MacBench(factory_ramp=0)
    bench.do(index, parameters)
    assert bench.read(0x27) & 0x0800
    bench.take(bench.device.set_load(bench.now, HELD))
    held = bench.device.position_at(bench.now)
    bench.advance(S)
    assert bench.position() == held
    assert bench.read(0x27) & 0x0800 == 0
    bench.take(bench.device.set_load(bench.now, FREE))
    free = bench.now
    assert bench.read(0x27) & 0x0800
    assert abs(bench.position_at(free + S // 2) - held - 5000) <= 1


def test_a_load_beyond_the_torque_limit_stalls_the_axis() -> None:
    """0Ch limits the torque at once: 40h of 80h is 0.7 Nm (MACS-CMD-0C-01, -03)."""
    bench = MacBench(factory_ramp=0)
    bench.do(0x0C, 0x80)
    bench.do(0x15, PERIOD)
    bench.take(bench.device.set_load(bench.now, Load(torque_nm=1)))
    bench.advance(S)
    turning = bench.position()
    assert turning > 9000
    bench.do(0x0C, 0x40)
    stalled = bench.position()
    bench.advance(S)
    assert bench.position() == stalled
    bench.do(0x0C, 0x80)
    bench.advance(S)
    assert bench.position() > stalled + 9000


STOPS = [(0x17, 0), (0x15, 0)]


@pytest.mark.parametrize("stop", STOPS)
def test_a_ramped_stop_in_catch_up_rests_where_the_shaft_is(stop: tuple[int, int]) -> None:
    """No catch-up to the old target (§4.1, §5.7); the place is held from now on."""
    bench = moving(1000, factory_catchup=10)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    bench.take(bench.device.set_load(bench.now, FREE))
    bench.advance(100 * MS)
    assert bench.state() == "PO"
    bench.do(*stop)
    rest = bench.position()
    assert bench.state() == "HD"
    bench.advance(10 * S)
    assert bench.position() == rest < 1000
    bench.take(bench.device.push(bench.now, 5))
    bench.advance(S)
    assert bench.position() == rest
    bench.do(0x13, 1000)
    bench.settle()
    assert bench.position() == 1000


@pytest.mark.parametrize("stop", STOPS)
def test_a_ramped_stop_frees_an_axis_whose_shaft_is_held(stop: tuple[int, int]) -> None:
    """The motion is given up, so 13h is taken again (§4.1)."""
    bench = moving(1000)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    bench.refuse(0x13, 0)
    bench.do(*stop)
    assert bench.state() == "HD"
    bench.do(0x13, bench.position())


@pytest.mark.parametrize("stop", STOPS)
def test_a_ramped_stop_ends_the_way_back_to_a_target_that_fell_behind(
    stop: tuple[int, int],
) -> None:
    """0Bh let the axis pass its target; on the way back 17h stops it (§5.3, §4.1)."""
    bench = MacBench(factory_ramp=1, factory_catchup=100, cells={"position": -5000})
    bench.do(0x13, 100)
    bench.advance(300 * MS)
    bench.do(0x0B)
    bench.advance(100 * MS)
    assert bench.state() == "PO"
    bench.do(*stop)
    assert bench.state() == "HD"
    rest = bench.position()
    bench.advance(10 * S)
    assert bench.position() == rest > 100


def test_a_ramped_stop_lets_an_inertial_shaft_that_lags_behind_run_out() -> None:
    """Its profile is over, the shaft is not at rest: where it comes to rest is held."""
    bench = MacBench(plant="inertial", factory_ramp=0, factory_torque=1)
    bench.do(0x02, 0)
    bench.do(0x13, 2000)
    bench.run_until(bench.etx_ns + 210 * MS)
    before = bench.device.position_at(bench.now)
    bench.take(bench.device.receive(Chunk(bench.now, request(0, 0x17), None)))
    assert bench.state() == "PO"
    assert bench.device.position_at(bench.now) == before
    bench.settle()
    rest = bench.position()
    assert before + 100 < rest <= 2000
    assert bench.state() == "HD"
    bench.take(bench.device.push(bench.now, -3))
    bench.advance(S)
    assert bench.position() == rest


@pytest.mark.parametrize("reading", ["ignore", "refuse"])
def test_a_velocity_that_ends_a_catch_up_has_a_direction_of_its_own(reading: str) -> None:
    """The profile is over: the set-point starts from rest, nothing is reversed (MACS-AMB-28)."""
    bench = moving(1000, vel_reverse_cmd=reading)
    bench.take(bench.device.set_load(bench.now, HELD))
    bench.advance(5 * S)
    assert bench.state() == "PO"
    bench.do(0x15, 0x00F60000 | PERIOD)
    bench.take(bench.device.set_load(bench.now, FREE))
    bench.advance(S)
    assert bench.position() < -1000


def readings(bench: MacBench) -> set[int]:
    """All that is read within half a second, without letting time pass."""
    return {bench.device.position_at(bench.now + at * MS) for at in range(0, 500, 7)}


def test_in_standby_the_reading_may_swing_about_the_place_that_is_held() -> None:
    """±1 about the target, busy with it, nothing stored, no event (MACS-CMD-02-03, §5.5)."""
    bench = MacBench(standby_swing="one", factory_catchup=1)
    assert readings(bench) == {0}
    bench.do(0x13, 100)
    bench.settle()
    assert bench.state() == "HD"
    assert readings(bench) == {99, 100, 101}
    assert bench.device.next_event() is None
    busy = set()
    for _ in range(50):
        bench.advance(7 * MS)
        busy.add(bench.read(0x27) & 0x0800)
        assert bench.state() == "HD"
        assert bench.device.cells(bench.now)["position"] == 100
        assert bench.stores["position"] == 100
    assert busy == {0, 0x0800}
    bench.do(0x1C, 1)
    assert all(bench.read(0x27) & 0x0800 for _ in range(50))
    for target in (200, 300, 400):
        bench.advance(33 * MS)
        bench.do(0x13, target)
        bench.settle()
        assert readings(bench) == {target - 1, target, target + 1}


@pytest.mark.parametrize("end", [(0x18, 0), (0x02, 0), (0x1A, 0)])
def test_the_swing_ends_with_standby_or_regulation(end: tuple[int, int]) -> None:
    """MACS-CMD-18-02; 02h d=0 is the remedy of trap 42."""
    bench = MacBench(standby_swing="one")
    bench.do(0x13, 100)
    bench.settle()
    bench.do(*end)
    assert readings(bench) == {100}


# ---- an inertial shaft (§5.4) ----


def test_an_inertial_axis_takes_a_way_to_stop_and_stays_locked_until_it_rests() -> None:
    """18h from speed: ⌈v²/2a⌉ increments (§5.7)."""
    bench = MacBench(plant="inertial", factory_ramp=0, factory_period=16)
    bench.do(0x15, 16)
    bench.advance(S)
    chunk = Chunk(bench.now, request(0, 0x18), None)
    before = bench.device.position_at(bench.now)
    bench.take(bench.device.receive(chunk))
    assert bench.state() == "VE"
    bench.settle()
    assert 10_000 < bench.position() - before < 100_000
    assert bench.state() == "HD"


def test_an_unpowered_inertial_shaft_coasts_until_it_is_powered_again() -> None:
    """1Ah does not brake (MACS-CMD-1A-01); 19h does."""
    ways = []
    for powered_again in (False, True):
        bench = MacBench(plant="inertial", factory_ramp=0)
        bench.do(0x15, 100)
        bench.advance(S)
        before = bench.device.position_at(bench.now)
        bench.do(0x1A)
        assert bench.state() == "OF"
        assert bench.device.is_moving(bench.now)
        if powered_again:
            bench.do(0x19)
        bench.settle()
        assert bench.stores["position"] == bench.position()
        ways.append(bench.position() - before)
    coasted, braked = ways
    assert coasted > 2 * braked > 0


def test_segments_ended_under_way_leave_an_inertial_shaft_where_it_is() -> None:
    """The shaft never jumps, whatever the set-point forgets."""
    bench = MacBench(plant="inertial", stop17_in_interp="now", factory_ramp=1)
    bench.do(0x16, 0x00C80320)
    bench.advance(5 * MS)
    before = bench.device.position_at(bench.now)
    assert before > 50
    bench.take(bench.device.receive(Chunk(bench.now, request(0, 0x17), None)))
    assert bench.device.position_at(bench.now) == before
    bench.settle()
    assert before < bench.position() < 200 + 120


def test_the_real_position_is_where_a_new_motion_starts() -> None:
    """After 18h the shaft was pushed: 13h measures from the encoder."""
    bench = MacBench()
    bench.do(0x19)
    bench.take(bench.device.push(bench.now, 30))
    bench.do(0x13, 0)
    bench.settle()
    assert bench.position() == 0


# ---- what is told ----


def told(bench: MacBench) -> list[tuple[str, int | str]]:
    """Kind and value of every trace so far."""
    traces = [effect for effect in bench.effects if isinstance(effect, Trace)]
    times = [trace.time_ns for trace in traces]
    assert times == sorted(times)
    return [(trace.kind, dict(trace.details)["value"]) for trace in traces]


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
