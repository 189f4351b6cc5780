"""Braking ordered again and again while the shaft still runs out."""

from fractions import Fraction

import pytest
import serial
from mac_bench import MS, MacBench
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request

import axistwin as _axistwin  # noqa: F401  registers the URL scheme
from axistwin.motion.inertia import Mechanics
from axistwin.motion.plant import Plant
from axistwin.motion.ramp import Ramp, RampedMotion

ORDERS = 60


def test_a_row_of_stops_while_the_shaft_runs_out_is_answered_like_one() -> None:
    """The exact speed of a shaft that brakes does not grow without bound with each 18h."""
    url = "axistwin://mac23:0?time=virtual&quirk.brake_increments=65535"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.1) as port:

        def send(index: int, parameter: int = 0, length: int = 3) -> bytes:
            port.write(request(index, parameter))
            return bytes(port.read(length))

        for index, parameter in ((0x02, 0), (0x0F, 0), (0x15, 100)):
            assert send(index, parameter) == ACCEPTED
        places = []
        for _ in range(ORDERS):
            assert send(0x18) == ACCEPTED
            places.append(answer_value(send(0x20, 0, ANSWER_LENGTH)))
        assert places == sorted(places)
        assert places[0] < places[-1]


def braked(orders: int, pause_ns: int, **quirks: str | int) -> int:
    """How far the shaft runs out of 80000 inc/s when 18h is sent so often."""
    bench = MacBench(factory_ramp=0, **quirks)  # type: ignore[arg-type]
    bench.do(0x15, 100)
    bench.advance(100 * MS)
    bench.do(0x18)
    place = bench.device.position_at(bench.etx_ns)
    for _ in range(orders - 1):
        bench.advance(pause_ns)
        bench.do(0x18)
    bench.settle()
    return bench.position() - place


@pytest.mark.parametrize("pause_ns", [0, MS])
def test_another_stop_while_the_shaft_runs_out_makes_its_way_no_longer(pause_ns: int) -> None:
    """MACS-CMD-18-01: it brakes as hard as it can already; the way counts from the first order."""
    assert braked(1, pause_ns, brake_increments=2000) == 2000
    assert braked(5, pause_ns, brake_increments=2000) == 2000
    once = braked(1, pause_ns, plant="inertial")
    assert once > 100
    assert braked(5, pause_ns, plant="inertial") == once


def test_a_stronger_motor_may_still_shorten_the_way() -> None:
    """The way only never grows: with more torque than at the first order it is shorter."""
    ways = []
    for torque_nm in (Fraction(1, 10), Fraction(14, 10)):
        shaft = Plant(mechanics=Mechanics(2000, Fraction(44, 100)), torque_nm=Fraction(14, 10))
        motion = RampedMotion.endless(0, 1, Ramp(100, 0))
        shaft.follow(0, motion.trajectory)
        shaft.set_torque(100 * MS, Fraction(1, 10))
        shaft.brake(100 * MS)
        shaft.set_torque(101 * MS, torque_nm)
        shaft.brake(101 * MS)
        ways.append(shaft.position_at(10**12))
    assert ways[1] < ways[0]


@pytest.mark.parametrize("quirks", [{"brake_increments": 500}, {"plant": "inertial"}], ids=str)
def test_a_stop_brakes_segments_as_it_brakes_profiles(quirks: dict[str, str | int]) -> None:
    """§5.7: any motion; the end of the segments is not a wall."""
    ways = []
    for command in ((0x15, 400), (0x16, 0x7FFF0190)):
        bench = MacBench(factory_ramp=0, **quirks)  # type: ignore[arg-type]
        bench.do(*command)
        bench.advance(200 * MS)
        bench.do(0x18)
        place = bench.device.position_at(bench.etx_ns)
        bench.settle()
        ways.append(bench.position() - place)
    assert ways[0] == ways[1] > 10


def test_a_segment_sent_while_the_shaft_runs_out_is_run_when_it_rests() -> None:
    """MACS-AMB-31: accepted in motion, so it is executed; 18h again drops it (MACS-CMD-18-03)."""
    for index, parameters in ((0x15, 0x320), (0x16, 0x03E80320)):
        bench = MacBench(factory_ramp=0, brake_increments=300)
        bench.do(index, parameters)
        bench.advance(50 * MS)
        bench.do(0x18)
        place = bench.device.position_at(bench.etx_ns)
        bench.do(0x16, 0x00640320)
        assert bench.settled_position() == place + 400
        bench.do(index, parameters)
        bench.advance(50 * MS)
        bench.do(0x18)
        place = bench.device.position_at(bench.etx_ns)
        bench.do(0x16, 0x00640320)
        bench.do(0x18)
        assert bench.settled_position() == place + 300
