"""What a MAC axis does in time: profiles, velocity, segments, synchronous mode (ledger §5)."""

import pytest
from mac_bench import MS, PERIOD, REFUSED, TICK_NS, MacBench, S, moving

from axistwin.devices.mac.serial.framing import request
from axistwin.wire.framing import Chunk


def ticks_since_etx(bench: MacBench) -> int:
    """Time since the last Etx, which must be a whole number of ticks."""
    ticks, rest = divmod(bench.now - bench.etx_ns, TICK_NS)
    assert rest == 0
    return ticks


@pytest.fixture
def bench() -> MacBench:
    """A MAC23 at rest, with the defaults."""
    return MacBench()


# ---- position mode (§5.3) ----

EXAMPLES = [
    (1, 1, 12800),
    (2, 1, 25600),
    (10, 1, 68268),
    (100, 1, 243200),
    (239, 1, 383155),
    (240, 1, 384008),
    (241, 1, 384808),
    (1000, 1, 992008),
    (1000, 10, 2432000),
    (10000, 10, 9920080),
]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("distance", "aa", "ticks"), EXAMPLES)
def test_the_ledgers_moves_take_their_ticks(distance: int, aa: int, ticks: int, sign: int) -> None:
    """Tick for tick through frames, both directions (MACS-CMD-13-01, -05)."""
    bench = MacBench(factory_ramp=aa, factory_period=PERIOD)
    chunk = Chunk(bench.now, request(0, 0x13, sign * distance), bench.device.line_format)
    bench.take(bench.device.receive(chunk))
    bench.etx_ns = chunk.arrival_ns(20)
    bench.run_until(bench.etx_ns)
    bench.settle()
    assert ticks_since_etx(bench) == ticks
    assert bench.device.position_at(bench.now) == sign * distance


def test_every_increment_of_a_short_move_comes_on_its_tick() -> None:
    """D = 10, AA = 1: levels 1 2 2 3 3 and back (§5.2)."""
    bench = moving(10)
    periods = [12800, 6400, 6400, 4267, 4267, 4267, 4267, 6400, 6400, 12800]
    at = bench.etx_ns
    for count, period in enumerate(periods):
        at += period * TICK_NS
        assert bench.position_at(at - 1) == count
        assert bench.position_at(at) == count + 1


def test_a_target_that_is_the_position_moves_nothing() -> None:
    """Accepted, no motion, not busy (MACS-CMD-13-04)."""
    bench = MacBench(cells={"position": 55})
    bench.do(0x13, 55)
    assert bench.state() == "HD"
    assert bench.read(0x27) & 0x0800
    assert bench.position() == 55


def test_14h_goes_back_to_zero() -> None:
    """MACS-CMD-14-01."""
    bench = MacBench(cells={"position": -300})
    bench.do(0x14, 0x12345678)
    assert bench.settled_position() == 0


def test_targets_are_absolute_and_signed() -> None:
    """13h FFFFFFFF goes to -1 (MACS-FRAME-05)."""
    bench = MacBench(cells={"position": 5})
    bench.do(0x13, 0xFFFFFFFF)
    assert bench.settled_position() == -1


@pytest.mark.parametrize("number", [0x40000000, 0xBFFFFFFF, 0x80000000, 0x7FFFFFFF])
def test_targets_outside_the_counter_are_refused(number: int) -> None:
    """MACS-CMD-13-06."""
    MacBench().refuse(0x13, number)


def test_without_a_ramp_every_increment_takes_the_period() -> None:
    """AA = 0 (§5.4)."""
    bench = moving(1000, aa=0)
    bench.settle()
    assert bench.now == bench.etx_ns + 1000 * PERIOD * TICK_NS


def test_an_hour_of_motion_is_asked_in_one_step() -> None:
    """Closed form: an hour at 10000 inc/s."""
    bench = MacBench(factory_ramp=0)
    bench.do(0x15, PERIOD)
    assert bench.position_at(bench.etx_ns + 3600 * S) == 36_000_000


# ---- velocity mode (§5.7) ----


def test_a_velocity_motion_climbs_and_stays() -> None:
    """The ramp of 120·AA increments, level k lasting k·AA of them, then P each (MACS-CMD-15-01)."""
    bench = MacBench(factory_ramp=2)
    bench.do(0x15, PERIOD)
    climb = sum(2 * k * ((32 * PERIOD + k) // (2 * k)) for k in range(1, 16))
    assert bench.position_at(bench.etx_ns + climb * TICK_NS - 1) == 239
    assert bench.position_at(bench.etx_ns + climb * TICK_NS) == 240
    assert bench.position_at(bench.etx_ns + (climb + 100 * PERIOD) * TICK_NS) == 340


@pytest.mark.parametrize(("ss", "sign"), [(0xF6, -1), (0, 1), (0x6F, 1), (0xF7, 1), (0x01, 1)])
def test_only_f6_turns_counter_clockwise(bench: MacBench, ss: int, sign: int) -> None:
    """Every other SS is clockwise; the first byte is without effect (MACS-CMD-15-01, -06)."""
    bench.do(0x15, 0xAB000000 | ss << 16 | PERIOD)
    bench.advance(S)
    assert bench.position() * sign > 0


def test_a_second_velocity_changes_the_speed_never_the_direction() -> None:
    """SS of the wrong direction is accepted and ignored (MACS-CMD-15-02, -03)."""
    bench = MacBench(factory_ramp=0)
    bench.do(0x15, PERIOD)
    bench.do(0x15, 0x00F60000 | 400)
    bench.advance(S)
    start = bench.device.position_at(bench.now)
    bench.advance(S)
    assert bench.device.position_at(bench.now) - start == 20_000
    assert bench.read(0x25) & 0xFFFF == PERIOD


def test_the_ledgers_speed_change_takes_its_ticks() -> None:
    """1600 to 800 at AA 1: 120 increments in 127674 ticks (§5.7)."""
    bench = MacBench(factory_ramp=1)
    bench.do(0x15, 1600)
    bench.advance(S)
    bench.do(0x15, 800)
    # The increment in progress at Etx is finished on the old period first.
    probe = MacBench(factory_ramp=1)
    probe.do(0x15, 1600)
    running = probe.position_at(bench.etx_ns)
    first = bench.etx_ns
    while probe.position_at(first) == running:
        first += TICK_NS
    assert bench.position_at(first + 127_674 * TICK_NS - 1) == running + 1 + 119
    assert bench.position_at(first + 127_674 * TICK_NS) == running + 1 + 120
    assert bench.position_at(first + (127_674 + 800 * 50) * TICK_NS) == running + 1 + 170


@pytest.mark.parametrize("stop", [(0x17, 0), (0x15, 0), (0x15, 0x00F60000)])
def test_a_ramped_stop_from_cruise_takes_n_increments(stop: tuple[int, int]) -> None:
    """And leaves the motor powered (MACS-CMD-17-01, -15-04)."""
    bench = MacBench(factory_ramp=1)
    bench.do(0x15, PERIOD)
    bench.advance(S)
    bench.do(*stop)
    etx = bench.etx_ns
    end = bench.settle()
    probe = MacBench(factory_ramp=1)
    probe.do(0x15, PERIOD)
    running = probe.position_at(etx)
    assert bench.position() == running + 1 + 120
    assert 192_004 * TICK_NS < end - etx <= (192_004 + PERIOD) * TICK_NS
    assert bench.state() == "HD"


def test_a_ramped_stop_in_mid_ramp_descends_what_was_climbed() -> None:
    """§5.7: j further increments after the one in progress."""
    bench = MacBench(factory_ramp=10)
    bench.do(0x15, 0x1000)
    start = bench.etx_ns
    bench.run_until(start + 400 * MS)
    bench.do(0x17)
    probe = MacBench(factory_ramp=10)
    probe.do(0x15, 0x1000)
    running = probe.position_at(bench.etx_ns)
    assert bench.settled_position() == 2 * (running + 1)


def test_a_ramped_stop_gives_up_the_target_of_a_position_motion() -> None:
    """No creeping on to the old target (MACS-CMD-17-01)."""
    bench = moving(100_000)
    bench.advance(S)
    bench.do(0x17)
    bench.settle()
    rest = bench.position()
    assert 10_000 < rest < 11_000
    bench.advance(10 * S)
    assert bench.position() == rest


def test_a_velocity_command_takes_over_a_position_motion() -> None:
    """It passes the target (MACS-AMB-29)."""
    bench = moving(1000)
    bench.do(0x15, PERIOD)
    assert bench.state() == "VE"
    bench.advance(S)
    assert bench.position() > 2000


def test_a_velocity_command_takes_over_from_the_segments() -> None:
    """FIFO emptied, from the segment's speed on, its direction kept (MACS-AMB-30)."""
    bench = MacBench(factory_ramp=0)
    bench.do(0x16, 0x83E80400)
    bench.do(0x16, 0x03E80400)
    bench.advance(S)
    bench.do(0x15, 400)
    assert bench.state() == "VE"
    before = bench.device.position_at(bench.now)
    bench.advance(S)
    assert bench.device.position_at(bench.now) - before == -20_000


@pytest.mark.parametrize(("aa", "way"), [(0, 0), (1, 120)])
@pytest.mark.parametrize("reading", ["ignore", "refuse", "after_segment", "now"])
def test_15h_0000_stops_the_segments_whatever_17h_does(aa: int, way: int, reading: str) -> None:
    """FIFO emptied, a ramp from the segment's speed (MACS-CMD-15-04, MACS-AMB-30)."""
    bench = MacBench(factory_ramp=aa, stop17_in_interp=reading)
    bench.do(0x16, 0x03E80400)
    start_ns = bench.etx_ns
    bench.do(0x16, 0x03E80400)
    bench.do(0x15)
    begun = (bench.etx_ns - start_ns) // (0x400 * TICK_NS) + 1
    assert bench.settled_position() == begun + way
    assert bench.state() == "HD"
    bench.advance(S)
    assert bench.position() == begun + way


def test_15h_0000_ends_a_virtual_segment_at_once(bench: MacBench) -> None:
    """No step is in progress, nothing follows (MACS-AMB-30)."""
    bench.do(0x1E, 0x03E80400)
    bench.do(0x16, 0x03E80400)
    bench.do(0x15)
    assert bench.state() == "HD"
    bench.advance(S)
    assert bench.position() == 0


@pytest.mark.parametrize("index", [0x15, 0x17])
def test_segments_that_brake_already_brake_on(index: int) -> None:
    """15h 0000 or 17h after 18h: the axis is at rest when its shaft is (§4.3)."""
    bench = MacBench(plant="inertial", stop17_in_interp="now", brake_increments="2000")
    bench.do(0x16, 0x7FFF0100)
    bench.advance(S // 10)
    bench.do(0x18)
    bench.do(index)
    assert bench.state() == "IN"
    before = bench.position()
    bench.settle()
    assert bench.state() == "HD"
    assert bench.position() > before


@pytest.mark.parametrize(
    ("quirks", "steps"),
    [
        ({"preload_policy": "keep"}, [(0x10, 0), (0x13, 500), (0x16, 0x7FFF0100), (0x18, 0)]),
        ({"motion_lock_set": "serial_list"}, [(0x16, 0x7FFF0100), (0x18, 0), (0x10, 0), (0x14, 0)]),
    ],
)
@pytest.mark.parametrize("stop", [None, 0x15, 0x17, 0x18])
def test_a_synchronised_motion_waits_for_the_end_of_braking_too(
    quirks: dict[str, str], steps: list[tuple[int, int]], stop: int | None
) -> None:
    """It is given up with the next stop (MACS-AMB-69)."""
    bench = MacBench(plant="inertial", brake_increments="2000", stop17_in_interp="now", **quirks)  # type: ignore[arg-type]
    for index, parameters in steps:
        if index == 0x18:
            bench.advance(S // 10)
        bench.do(index, parameters)
    bench.do(0x11)
    assert bench.state() == "IN"
    if stop is not None:
        bench.do(stop)
    bench.settle()
    bench.advance(S)
    bench.settle()
    target = 500 if (0x13, 500) in steps else 0
    assert (bench.position() == target) is (stop is None)


# ---- hard stop, power ----


def test_a_hard_stop_stops_dead_and_ends_regulation() -> None:
    """MACS-CMD-18-01: powered, position valid, a pushed shaft stays where it is."""
    bench = moving(100_000)
    bench.advance(S)
    bench.do(0x18)
    etx = bench.etx_ns
    rest = bench.position()
    assert rest == moving(100_000).position_at(etx)
    assert bench.state() == "HD"
    bench.take(bench.device.push(bench.now, 7))
    bench.advance(10 * S)
    assert bench.position() == rest + 7


def test_the_place_of_a_finished_move_is_held() -> None:
    """A pushed shaft comes back, one increment every VV·200 µs (§5.5)."""
    bench = MacBench(factory_catchup=5)
    bench.do(0x13, 100)
    bench.settle()
    bench.take(bench.device.push(bench.now, -4))
    start = bench.now
    for step in range(4):
        assert bench.position_at(start + (step + 1) * MS - 1) == 96 + step
        assert bench.position_at(start + (step + 1) * MS) == 97 + step
    bench.advance(S)
    assert bench.position() == 100


def test_without_power_the_shaft_turns_freely_and_is_counted(bench: MacBench) -> None:
    """MACS-CMD-1A-01, -02."""
    bench.do(0x13, 100)
    bench.settle()
    bench.do(0x1A)
    assert bench.state() == "OF"
    bench.take(bench.device.push(bench.now, -40))
    bench.advance(S)
    assert bench.position() == 60


def test_motor_off_in_motion_is_accepted_and_a_motion_powers_it_again() -> None:
    """MACS-CMD-1A-01, MACS-CMD-13-03."""
    bench = moving(100_000)
    bench.advance(S)
    bench.do(0x1A)
    assert bench.state() == "OF"
    rest = bench.position()
    bench.advance(S)
    assert bench.position() == rest
    bench.do(0x13, rest)
    assert bench.state() == "HD"


# ---- segments (§5.6) ----


def test_segments_run_back_to_back_to_the_tick(bench: MacBench) -> None:
    """No gap, no rounding; virtual ones take their time (MACS-CMD-16-01, -1E-01)."""
    bench.do(0x16, 0x00C80400)
    start = bench.etx_ns
    bench.do(0x1E, 0x00C80400)
    bench.do(0x16, 0xFFCE0800)
    one, two = 200 * 0x400, 400 * 0x400
    three = two + 50 * 0x800
    assert bench.position_at(start + one * TICK_NS - 1) == 199
    for ticks, position in ((one, 200), (two, 200), (two + 0x800, 199), (three, 150)):
        assert bench.position_at(start + ticks * TICK_NS) == position
    assert bench.now == start + three * TICK_NS
    assert bench.state() == "HD"


def test_the_fifth_segment_of_a_burst_is_refused_until_a_stage_frees(bench: MacBench) -> None:
    """Three stages in front of the one in execution (MACS-CMD-16-02)."""
    for _ in range(4):
        bench.do(0x1E, 0x03E81000)
    start = bench.late[0].start_ns - MS
    bench.refuse(0x16, 0x03E81000)
    frame_ns = bench.device.line_format.span_ns(21)
    end = start + 512 * MS
    bench.run_until(end - 1 - frame_ns)
    assert bench.ask(0x1E, 0x03E81000) == REFUSED
    bench.run_until(end + 8 * MS)
    bench.do(0x1E, 0x03E81000)


def test_an_underrun_rests_at_the_last_step_and_a_later_segment_starts_afresh(
    bench: MacBench,
) -> None:
    """MACS-AMB-40."""
    bench.do(0x16, 0x000A1000)
    bench.settle()
    assert bench.state() == "HD"
    bench.advance(S)
    bench.do(0x16, 0x000A1000)
    start = bench.etx_ns
    assert bench.position_at(start + 9 * 0x1000 * TICK_NS) == 19
    assert bench.position_at(start + 10 * 0x1000 * TICK_NS) == 20
    assert bench.state() == "HD"


def test_segments_know_neither_ramp_nor_maximum_speed() -> None:
    """MACS-CMD-16-03."""
    bench = MacBench(factory_ramp=50, factory_period=0xFFFF)
    bench.do(0x16, 0x03E80010)
    assert bench.settle() < bench.etx_ns + 1000 * 0x10 * TICK_NS + 2 * MS
    assert bench.position() == 1000


def test_the_most_negative_segment_has_32768_steps(bench: MacBench) -> None:
    """DDDD = 8000h (§5.6)."""
    bench.do(0x16, 0x80000100)
    assert bench.settled_position() == -32768


def test_a_ramped_stop_does_not_interrupt_segments(bench: MacBench) -> None:
    """MACS-CMD-17-02."""
    bench.do(0x16, 0x03E80400)
    bench.do(0x17)
    assert bench.settled_position() == 1000


def test_a_hard_stop_empties_the_fifo(bench: MacBench) -> None:
    """Nothing resumes (MACS-CMD-18-03)."""
    bench.do(0x16, 0x03E80400)
    bench.do(0x16, 0x03E80400)
    bench.do(0x18)
    rest = bench.position()
    bench.advance(S)
    assert bench.position() == rest < 1000
    bench.do(0x16, 0x00010400)
    assert bench.settled_position() == rest + 1


def test_segments_sent_during_a_move_run_after_it() -> None:
    """MACS-AMB-31."""
    bench = moving(500)
    for _ in range(3):
        bench.do(0x16, 0x00640400)
    bench.refuse(0x16, 0x00640400)
    end = bench.etx_ns
    assert bench.settled_position() == 800
    assert bench.now > end


@pytest.mark.parametrize("during", ["preempt", "queue"])
def test_a_segment_refused_after_an_underrun_leaves_the_motion_alone(during: str) -> None:
    """What is refused has no effect (MACS-REPLY-05, MACS-AMB-40 error, MACS-AMB-31)."""
    bench = MacBench(fifo_underrun="error", interp_during_profile=during, factory_ramp=0)
    bench.do(0x16, 0x000A0400)
    bench.advance(S)
    bench.do(0x13, 1000)
    bench.refuse(0x16, 0x000A0400)
    assert bench.state() == "PO"
    assert bench.settled_position() == 1000
    assert bench.state() == "HD"


# ---- synchronous mode ----


def test_an_armed_motion_starts_on_11h(bench: MacBench) -> None:
    """Acknowledged, held, started (MACS-CMD-10-01, -11-01)."""
    bench.do(0x10)
    assert bench.state() == "OF+AR"
    bench.do(0x13, 100)
    assert bench.state() == "OF+PL"
    bench.advance(S)
    assert bench.position() == 0
    bench.do(0x11)
    start = bench.etx_ns
    assert bench.settled_position() == 100
    assert bench.now > start
    bench.do(0x13, 0)
    assert bench.settled_position() == 0


def test_the_second_preload_replaces_the_first(bench: MacBench) -> None:
    """MACS-AMB-36."""
    for index, parameters in ((0x10, 0), (0x13, 100), (0x13, 200), (0x11, 0)):
        bench.do(index, parameters)
    assert bench.settled_position() == 200


@pytest.mark.parametrize("stop", [0x17, 0x18, 0x1A])
def test_stops_drop_arm_and_preload(bench: MacBench, stop: int) -> None:
    """MACS-AMB-36, MACS-AMB-51."""
    for index, parameters in ((0x10, 0), (0x13, 100), (stop, 0), (0x11, 0)):
        bench.do(index, parameters)
    assert bench.state() == "OF"
    bench.do(0x10)
    bench.do(stop)
    bench.do(0x13, 50)
    assert bench.settled_position() == 50


def test_segments_are_not_held_and_leave_the_arm(bench: MacBench) -> None:
    """MACS-CMD-10-03, MACS-AMB-35."""
    bench.do(0x10)
    bench.do(0x16, 0x00640400)
    assert bench.settled_position() == 100
    bench.do(0x13, 0)
    assert bench.state() == "HD+PL"


def synchronised_behind_segments(**quirks: str | int) -> MacBench:
    """A 13h to 5000 waits for the end of a long segment (MACS-AMB-69)."""
    bench = MacBench(factory_ramp=1, **quirks)  # type: ignore[arg-type]
    for index, parameters in ((0x10, 0), (0x13, 5000), (0x16, 0x03E80400), (0x11, 0)):
        bench.do(index, parameters)
    assert bench.state() == "IN"
    return bench


def test_a_synchronised_motion_waits_for_the_end_of_the_segments_once() -> None:
    """MACS-AMB-69, MACS-CMD-10-02."""
    bench = synchronised_behind_segments()
    assert bench.settled_position() == 5000
    bench.do(0x16, 0x000A0400)
    bench.settle()
    bench.advance(S)
    assert bench.position() == 5010


@pytest.mark.parametrize(
    "steps",
    [
        [(0x15, PERIOD), (0x15, 0)],
        [(0x15, PERIOD), (0x13, 0)],
        [(0x18, 0)],
        [(0x1A, 0)],
        [(0x00, 0)],
    ],
)
@pytest.mark.parametrize("flush", ["true", "false"])
def test_a_synchronised_motion_is_given_up_with_the_segments_it_waits_for(
    steps: list[tuple[int, int]], flush: str
) -> None:
    """Segments that end in any other way leave nothing that could start later by itself."""
    bench = synchronised_behind_segments(abort_flush=flush)
    for index, parameters in steps:
        bench.ask(index, parameters)
    if steps[-1][0] == 0x13:
        bench.do(0x17)
    bench.advance(3 * S)
    bench.settle()
    rest = bench.position()
    bench.do(0x16, 0x000A0400)
    bench.settle()
    bench.advance(3 * S)
    assert bench.position() == rest + 10
    assert bench.state() == "HD"


@pytest.mark.parametrize("reading", ["after_segment", "now"])
def test_a_ramped_stop_of_segments_gives_up_what_waits_for_them(reading: str) -> None:
    """MACS-AMB-30 and -32 with MACS-AMB-69: by 15h 0000 and by 17h."""
    for stop in ((0x17, 0), (0x15, 0)):
        bench = synchronised_behind_segments(stop17_in_interp=reading)
        bench.do(*stop)
        bench.settle()
        bench.advance(S)
        assert bench.position() < 1200
        assert bench.state() == "HD"


def test_arming_in_motion_holds_the_next_motion() -> None:
    """10h under way, 15h preloaded, 11h takes it (§4.2 note on AR/PL)."""
    bench = MacBench(factory_ramp=0)
    bench.do(0x15, PERIOD)
    bench.do(0x10)
    bench.do(0x15, 400)
    assert bench.state() == "VE+PL"
    bench.do(0x11)
    before = bench.device.position_at(bench.now)
    bench.advance(S)
    assert bench.device.position_at(bench.now) - before == 20_000


def test_two_axes_started_by_one_general_frame_step_on_the_same_nanosecond() -> None:
    """All start on the same frame's Etx (§6)."""
    benches = [MacBench(address=address) for address in (0, 5)]
    for bench in benches:
        bench.do(0x10)
        bench.do(0x13, 1000)
        bench.run_until(2 * S)
        bench.ask(0x11, address=0xFF)
    ends = {bench.settle() for bench in benches}
    assert len(ends) == 1
