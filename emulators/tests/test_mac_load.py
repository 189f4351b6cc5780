"""What hangs on the shaft of a MAC axis: busy, catch-up, standby, inertia (ledger §5.4, §5.5)."""

import pytest
from mac_bench import FREE, HELD, MS, PERIOD, MacBench, S, moving

from axistwin.devices.mac.serial.framing import request
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk

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
    assert bench.settled_position() == 1000


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
    assert bench.settled_position() == 0
