"""Stops, the reference input and the counter of a MAC axis (ledger §5.8)."""

from typing import Any

import pytest
from mac_bench import ACCEPTED, FREE, HELD, MS, PERIOD, REFUSED, MacBench, S, moving

from axistwin.devices.mac.serial.framing import request
from axistwin.wire.framing import Chunk

# ---- stops ----


def test_a_software_stop_ends_the_motion_one_increment_beyond() -> None:
    """Strict: rests at sup + 1, bit 1 of ff (MACS-CMD-09-02)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500, factory_inferior_stop=-500)
    bench.do(0x13, 10_000)
    assert bench.settled_position() == 501
    assert bench.read(0x21) == 0x00020000
    bench.do(0x15, 0x00F60000 | PERIOD)
    assert bench.read(0x21) == 0
    assert bench.settled_position() == -501
    assert bench.read(0x21) == 0x00010000


def test_a_position_equal_to_the_stop_is_legal() -> None:
    """It sets no bit (ledger §8.21)."""
    bench = MacBench(factory_stops=8, factory_superior_stop=500)
    bench.do(0x13, 500)
    assert bench.settled_position() == 500
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
    assert bench.settled_position() == 550


def test_segments_meet_the_software_stop_too_and_the_fifo_is_emptied() -> None:
    """MACS-STOP-03: out, back, and out again."""
    bench = MacBench(factory_stops=8, factory_superior_stop=50, cells={"position": 60})
    bench.do(0x16, 0xFFCE0400)
    bench.do(0x16, 0x00640400)
    bench.do(0x16, 0x00640400)
    assert bench.settled_position() == 51
    assert bench.read(0x21) == 0x00020000


@pytest.mark.parametrize("counts_executing", [True, False])
def test_segments_that_a_stop_leaves_stored_wait_for_the_next_one(counts_executing: bool) -> None:
    """MACS-AMB-51, FIFO kept: the executing one is lost; no stage is free until they go on."""
    bench = MacBench(
        factory_stops=1, abort_flush=False, fifo_counts_executing=counts_executing, factory_ramp=0
    )
    bench.do(0x15, 0x320)
    for _ in range(3):
        bench.do(0x16, 0xFFF60320)  # they wait for the end of the velocity motion
    bench.input("positive_stop", True)
    bench.settle()
    rest = bench.position()
    bench.advance(100 * MS)
    assert (bench.position(), bench.state()) == (rest, "HD")
    reply = bench.ask(0x16, 0xFFF60320)
    bench.settle()
    if counts_executing:
        assert (reply, bench.position()) == (REFUSED, rest)
        bench.do(0x14)
        assert bench.settled_position() == -30
    else:
        assert (reply, bench.position()) == (ACCEPTED, rest - 40)


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
    for start, command, end in (
        (0x3FFFFF00, PERIOD, 0x3FFFFFFF),
        (-0x3FFFFF00, 0x00F60000 | PERIOD, -0x40000000),
    ):
        bench = MacBench(
            cells={"position": start, "stops": 8, "superior_stop": 0x7FFFFFFF},
            factory_ramp=0,
            position_overflow=overflow,
            soft_stop_blocks=blocks,
        )
        bench.do(0x15, command)
        events, until = 0, bench.now + 2 * S
        while (due := bench.device.next_event()) is not None and due <= until:
            bench.run_until(due)
            events += 1
        assert events <= 2
        bench.run_until(until)
        assert bench.state() == "VE"
        position = bench.position()
        assert position == end if overflow == "saturate" else position * start < 0


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
    assert bench.settled_position() == 100


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
    assert bench.settled_position() == 0
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
    assert bench.settled_position() == at
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
    assert bench.settled_position() == 20_000


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
    assert bench.settled_position() == 2000


def test_a_target_that_falls_behind_is_reached_in_catch_up() -> None:
    """0Bh near the end of a negative-going account: down the ramp, past, and back (§5.3)."""
    bench = MacBench(factory_ramp=1, factory_catchup=1, cells={"position": -5000})
    bench.do(0x13, 100)
    bench.advance(300 * MS)
    bench.do(0x0B)
    assert bench.settled_position() == 100


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
    assert bench.settled_position() == end


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
    assert bench.settled_position() == 501


def test_the_counter_wraps_at_31_bits() -> None:
    """MACS-AMB-54."""
    bench = MacBench(cells={"position": 0x3FFFFFF0})
    bench.do(0x16, 0x00200400)
    assert bench.settled_position() == -0x40000000 + 0x0F + 1


# ---- a stop that is met by the last increment of a motion ----

OUT, IN = 0x0020, 0xFFE0  # 32 steps one way, and back


def _signed(direction: int, number: int) -> int:
    return direction * number & 0xFFFFFFFF


def _bench_with_stop_at(direction: int, stop: int, **quirks: Any) -> MacBench:
    """Software stops on; the one of ``direction`` at ``stop`` increments that way."""
    bench = MacBench(factory_stops=8, factory_ramp=1, **quirks)
    bench.do(0x09 if direction > 0 else 0x0A, _signed(direction, stop))
    return bench


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("compare", "stop"), [("strict", 23), ("equal", 24)])
@pytest.mark.parametrize("plant", ["ideal", "inertial"])
def test_the_last_increment_of_a_move_meets_the_stop_like_any_other(
    direction: int, compare: str, stop: int, plant: str
) -> None:
    """What waits behind it is dropped, and the bit of ff is set (MACS-CMD-09-02, ledger §4.3)."""
    bench = _bench_with_stop_at(direction, stop, soft_stop_compare=compare, plant=plant)
    bench.do(0x13, _signed(direction, 24))
    bench.do(0x16, (IN if direction > 0 else OUT) << 16 | 0x0800)
    bench.settle()
    bench.advance(S)
    assert (bench.position(), bench.state()) == (direction * 24, "HD")
    assert bench.read(0x21) == (0x00020000 if direction > 0 else 0x00010000)


def _go_out(bench: MacBench, index: int, direction: int) -> None:
    """Go 24 increments by a move, at a velocity, or by a segment; 32 back are stored behind it."""
    if index == 0x13:
        bench.do(0x13, _signed(direction, 24))
    elif index == 0x16:
        bench.do(0x16, (direction * 24 & 0xFFFF) << 16 | 0x2000)
    else:
        bench.do(0x15, 0x00F60000 | 0x4000 if direction < 0 else 0x4000)
        while abs(bench.position()) < 18:  # 17h: what was climbed, and the increment in progress
            bench.advance(MS)
        bench.do(0x17)
    bench.do(0x16, (-direction * 32 & 0xFFFF) << 16 | 0x0800)


def _furthest_of(bench: MacBench, index: int, direction: int) -> int:
    """How far ``_go_out`` leads where no stop is in the way."""
    _go_out(bench, index, direction)
    furthest = 0
    while bench.device.axis.drive.kind is not None:
        bench.advance(MS // 4)
        furthest = max(furthest, direction * bench.position_at(bench.now))
    return furthest


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("index", [0x13, 0x15, 0x16])
@pytest.mark.parametrize("phase", ["end", "start"])
def test_whatever_ends_on_the_far_side_of_a_stop_has_met_it(
    index: int, direction: int, phase: str
) -> None:
    """Position, velocity, segments; one increment less, and what waits runs (MACS-STOP-03)."""
    furthest = _furthest_of(_bench_with_stop_at(direction, 999, step_phase=phase), index, direction)
    bit = 0x00020000 if direction > 0 else 0x00010000
    for stop, rest, ff in ((furthest - 1, furthest, bit), (furthest, furthest - 32, 0)):
        bench = _bench_with_stop_at(direction, stop, step_phase=phase)
        _go_out(bench, index, direction)
        bench.settle()
        bench.advance(S)
        assert (direction * bench.position(), bench.state()) == (rest, "HD")
        assert bench.read(0x21) == ff


def test_a_stop_met_by_the_last_increment_leaves_what_is_stored_where_it_is_kept() -> None:
    """MACS-AMB-51: the FIFO waits for the next segment."""
    bench = _bench_with_stop_at(1, 23, abort_flush=False)
    bench.do(0x13, 24)
    bench.do(0x16, IN << 16 | 0x0800)
    bench.settle()
    bench.advance(S)
    assert (bench.position(), bench.read(0x21)) == (24, 0x00020000)
    bench.do(0x16, IN << 16 | 0x0800)
    assert bench.settled_position() == 24 - 64


@pytest.mark.parametrize("increments", ["0", "7"])
def test_a_shaft_that_has_turned_on_the_stop_needs_no_way_to_brake(increments: str) -> None:
    """It rests where it has met the stop, not on the way of the next segment (ledger §5.8)."""
    bench = _bench_with_stop_at(1, 23, brake_increments=increments)
    bench.do(0x16, 24 << 16 | 0x2000)
    bench.do(0x16, IN << 16 | 0x0800)
    bench.settle()
    assert (bench.position(), bench.read(0x21)) == (24, 0x00020000)


def test_a_catch_up_that_ends_beyond_the_stop_has_met_it() -> None:
    """It belongs to the motion (ledger §4.1)."""
    bench = _bench_with_stop_at(1, 23)
    bench.device.set_load(bench.now, HELD)
    bench.do(0x13, 24)
    bench.advance(100 * MS)
    bench.device.set_load(bench.now, FREE)
    bench.do(0x16, IN << 16 | 0x0800)
    bench.settle()
    bench.advance(S)
    assert bench.read(0x21) == 0x00020000
