"""Where steps are counted does not change where a motion goes, nor what stops it (MACS-AMB-41)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mac_bench import MS, MacBench

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.models import MODELS
from axistwin.devices.mac.axis.quirks import parse_quirks

MAC23 = MODELS["mac23"]

PHASES = pytest.mark.parametrize("phase", ["end", "start"])
STARTS = pytest.mark.parametrize("start", ["etx", "reply_end"])
SEGMENTS = st.lists(
    st.tuples(st.sampled_from([0x16, 0x1E]), st.integers(-30, 30), st.booleans()),
    min_size=1,
    max_size=6,
)


def started_axis(**quirks: str | int) -> Axis:
    """A powered module's axis, without a line."""
    axis = Axis(MAC23, parse_quirks(quirks), {})
    axis.power_on(0)
    axis.start(0)
    return axis


def run_until(axis: Axis, time_ns: int) -> None:
    """Let everything happen that is due."""
    while (due := axis.next_event()) is not None and due <= time_ns:
        axis.run(due)


def segment(bench: MacBench, index: int, steps: int, period_ticks: int = 0x400) -> None:
    """A segment that has to be accepted."""
    bench.do(index, (steps & 0xFFFF) << 16 | period_ticks)


@settings(max_examples=40)
@given(st.sampled_from(["end", "start"]), st.sampled_from(["etx", "reply_end"]), SEGMENTS)
def test_segments_end_on_the_sum_of_their_steps(
    phase: str, start: str, segments: list[tuple[int, int, bool]]
) -> None:
    """Back to back or one after the other, real and virtual ones, of both directions."""
    bench = MacBench(step_phase=phase, motion_start_ref=start)
    expected = 0
    for index, steps, waits in segments:
        segment(bench, index, steps, 0x40)
        expected += steps if index == 0x16 else 0
        if waits:
            bench.settle()
    assert bench.settled_position() == expected


@PHASES
@STARTS
@pytest.mark.parametrize("brake", ["plant", "10"])
@pytest.mark.parametrize("first", [0, 0x1E], ids=["at_once", "behind_a_virtual_one"])
def test_a_segment_toward_an_active_hardware_stop_makes_no_step(
    phase: str, start: str, brake: str, first: int
) -> None:
    """MACS-AMB-49: accepted, no step, ff bit; what never moved needs no way to brake."""
    bench = MacBench(
        step_phase=phase, motion_start_ref=start, brake_increments=brake, factory_stops=1
    )
    bench.input("positive_stop", True)
    if first:
        segment(bench, first, 14)
    segment(bench, 0x16, 14)
    bench.settle()
    assert (bench.position(), bench.read(0x21)) == (0, 0x00080000)
    segment(bench, 0x16, -14)
    assert bench.settled_position() == -14


@PHASES
@pytest.mark.parametrize(("index", "parameters"), [(0x13, 50), (0x15, 0x320), (0x16, 0x00320320)])
def test_a_motion_that_a_stop_bars_before_it_sets_out_makes_no_step(
    phase: str, index: int, parameters: int
) -> None:
    """Accepted on a free way, but the contact closes before the first step begins."""
    axis = started_axis(step_phase=phase, factory_stops=1, factory_ramp=0)
    assert axis.execute(MS, index, parameters, 3 * MS)
    axis.set_input(2 * MS, "positive_stop", True)
    run_until(axis, 10 * MS)
    assert (axis.counter_at(10 * MS), axis.query(10 * MS, 0x21)) == (0, 0x00080000)


@PHASES
def test_an_axis_beyond_a_software_stop_that_blocks_both_ways_makes_no_step(phase: str) -> None:
    """MACS-AMB-48, both: neither outward nor inward."""
    bench = MacBench(
        step_phase=phase, soft_stop_blocks="both", factory_stops=8, factory_superior_stop=-1
    )
    for steps in (14, -14):
        segment(bench, 0x16, steps)
        bench.settle()
        assert (bench.position(), bench.read(0x21)) == (0, 0x00020000)


@PHASES
@pytest.mark.parametrize("steps", [5, 4])
def test_a_software_stop_is_met_one_beyond_between_segments_too(phase: str, steps: int) -> None:
    """§5.8, strict: at 6 of stop 5, be it the last step of a segment or the first of the next."""
    bench = MacBench(step_phase=phase, factory_stops=8, factory_superior_stop=steps)
    segment(bench, 0x16, 5, 0xFFFF)
    segment(bench, 0x16, 5, 0xFFFF)
    assert bench.settled_position() == steps + 1


@PHASES
@pytest.mark.parametrize("brake", ["plant", "0", "7"])
@pytest.mark.parametrize(("index", "parameters"), [(0x13, 50), (0x15, 0x320), (0x16, 0x00320320)])
def test_a_motion_out_of_a_software_stop_itself_makes_one_step(
    phase: str, brake: str, index: int, parameters: int
) -> None:
    """§5.8, strict: on the stop is legal, so the axis rests one beyond, and its way to brake."""
    bench = MacBench(
        step_phase=phase, factory_stops=8, factory_superior_stop=0, brake_increments=brake
    )
    bench.do(index, parameters)
    assert bench.settled_position() == (8 if brake == "7" else 1)
    assert bench.read(0x21) == 0x00020000


@PHASES
@pytest.mark.parametrize("late_ns", [-1, 0, 1])
def test_a_velocity_takes_over_the_step_of_a_segment_once(phase: str, late_ns: int) -> None:
    """MACS-AMB-30: the same count before and after, whatever instant of the step it is."""
    axis = started_axis(step_phase=phase, factory_ramp=0)
    assert axis.execute(0, 0x16, 0x00641F40, 0)  # 100 steps of 1 ms
    now = 30 * MS + late_ns
    run_until(axis, now)
    before = axis.counter_at(now)
    assert axis.execute(now, 0x15, 0x1F40, now)
    places = [before, axis.counter_at(now)]
    for time in range(now, now + 3 * MS, MS // 4):
        run_until(axis, time)
        places.append(axis.counter_at(time))
    assert places[0] == places[1] == 30 - (late_ns < 0) + (phase == "start")
    assert places == sorted(places)
    assert axis.counter_at(now + 4 * MS) == places[0] + 4
