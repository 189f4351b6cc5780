"""Inputs of an MN400: limits, shield, panel, potentiometers, jogging, pulses."""

import pytest
from mn400_bench import Mn400Bench
from mn400_motion_quirk_cases import press, pulses

from axistwin.devices.mn400.inputs import LIMITS, NAMES, ON_VALUES
from axistwin.errors import UsageError

# ---- limits ----


@pytest.mark.parametrize(("name", "value"), ON_VALUES.items())
def test_each_input_has_its_own_value_in_s(name: str, value: int) -> None:
    """Limits 1..128, auxiliary inputs 256..32768, unsigned (MN4-CMD-S-01, MN4-CMD-S-02)."""
    bench = Mn400Bench()
    assert bench.value("S") == "0"
    bench.switch(name)
    assert bench.value("S") == str(value)
    assert bench.device.input_at(bench.now, name)
    bench.switch("m1_minus")
    bench.switch(name, on=False)
    assert bench.value("S") == ("0" if name == "m1_minus" else "1")


def test_the_values_are_those_of_the_manual() -> None:
    """M1- 1, M1+ 2, M4+ 128, Aux1 256, Aux8 32768."""
    named = ("m1_minus", "m1_plus", "m2_minus", "m4_plus", "aux_1", "aux_8")
    assert [ON_VALUES[name] for name in named] == [1, 2, 4, 128, 256, 32768]


@pytest.mark.parametrize(("name", "place"), LIMITS.items())
def test_each_limit_stops_motion_towards_it_and_no_other(name: str, place: tuple[int, int]) -> None:
    """All axes at once, with its value as the exit code (MN4-LIM-01..04)."""
    axis, direction = place
    bench = Mn400Bench()
    distance = ["3000"] * 4
    distance[axis] = str(3000 * direction)
    bench.say("M" + ",".join(distance), "M5,5,5,5")
    before = bench.peek()
    bench.switch(name)
    stood = bench.peek()
    assert all(stood)
    assert sum(map(abs, stood)) - sum(map(abs, before)) < 10
    assert bench.value("/") == str(ON_VALUES[name])
    assert bench.value(":") == "1,0,0,0,1"
    left = [int(text) for text in bench.value("N").split(",")]
    assert [a + b for a, b in zip(stood, left, strict=True)] == [int(text) for text in distance]
    bench.wait(5000)
    assert bench.peek() == stood
    distance[axis] = str(-30 * direction)
    bench.say("M" + ",".join([*distance[:axis], distance[axis]]))
    bench.wait(3000)
    assert bench.peek()[axis] == stood[axis] - 30 * direction
    assert bench.value("/") == "0"


def test_a_limit_of_an_axis_that_rests_stops_nothing() -> None:
    """Nor does an auxiliary input (MN4-LIM-04, MN4-LIM-07)."""
    bench = Mn400Bench()
    bench.switch("m2_plus")
    bench.switch("aux_3")
    bench.say("M500")
    bench.wait(500)
    assert bench.peek()[0] == 500
    assert bench.value("/") == "0"


@pytest.mark.parametrize("phase", ["end", "start"])
def test_a_motion_towards_a_limit_that_is_on_makes_no_step(phase: str) -> None:
    """It is accepted, and the exit code is set (MN4-LIM-06); | clears it (MN4-CMD-EXIT-03)."""
    bench = Mn400Bench(step_phase=phase)
    bench.switch("m1_plus")
    assert bench.say("M500,-5") == "S D"
    assert bench.value("/") == "2"
    assert bench.peek() == [0, 0, 0, 0]
    assert bench.value("N") == "500,-5,0,0"
    bench.say("|")
    assert bench.value("/") == "0"
    assert bench.value(":") == "1,0,0,0,0"


def test_the_exit_code_is_that_of_the_last_motion() -> None:
    """During a motion the previous one's (MN4-CMD-EXIT-02), then overwritten (MN4-CMD-EXIT-04)."""
    bench = Mn400Bench()
    bench.switch("m1_plus")
    bench.say("M500", "M-500")
    assert bench.value("/") == "2"
    bench.wait(500)
    assert bench.value("/") == "0"


def test_an_arc_stops_where_it_would_first_go_towards_a_limit() -> None:
    """The limit was on from the beginning; the arc begins the other way (MN4-LIM-02)."""
    bench = Mn400Bench()
    bench.switch("m1_plus")
    bench.say("A-1000,0,0,0,-1")
    bench.wait(3000)
    x, _, y, _ = bench.peek()
    assert x in range(-2001, -1990)
    assert abs(y) < 60
    assert bench.value("/") == "2"


def test_a_limit_ends_the_program() -> None:
    """MN4-LIM-03."""
    bench = Mn400Bench()
    bench.say("Z", "M3000", "M,100", "\x04", "U")
    bench.switch("m1_plus")
    bench.wait(3000)
    assert bench.peek()[1] == 0
    assert bench.device.describe(bench.now).state == "ABT"


def test_a_limit_while_paused_counts_at_resume() -> None:
    """Ledger §4.2."""
    bench = Mn400Bench()
    bench.say("M3000", "{")
    bench.wait(1000)
    stood = bench.peek()
    bench.switch("m1_plus")
    bench.say("}")
    bench.wait(3000)
    assert bench.peek()[0] - stood[0] <= 1
    assert bench.value("/") == "2"


# ---- shield ----


def test_without_feedhold_the_shield_aborts() -> None:
    """Exit code 0, AbortFlag 1 (MN4-SHD-01, MN4-SHD-03); what starts then trips at once."""
    bench = Mn400Bench()
    bench.say("M3000", "M,5")
    bench.switch("shield")
    stood = bench.peek()
    assert bench.value(":") == "0,0,0,0,1"
    assert bench.value("/") == "0"
    assert bench.say("M10") == "S D"
    bench.switch("shield", on=False)
    bench.wait(3000)
    assert bench.peek() == stood
    assert bench.value(":") == "1,0,0,0,1"


def test_with_feedhold_the_shield_pauses() -> None:
    """Until it is shut (MN4-CMD-FH-01, MN4-CMD-FH-02); ;0 meanwhile aborts nothing (MN4-SHD-04)."""
    bench = Mn400Bench()
    bench.say(";1", "M3000")
    bench.switch("shield")
    bench.wait(1000)
    stood = bench.peek()
    assert bench.value(":") == "0,1,1,1,0"
    bench.say(";0")
    bench.wait(1000)
    assert bench.peek() == stood
    bench.switch("shield", on=False)
    bench.wait(3000)
    assert bench.peek()[0] == 3000
    assert bench.value(":") == "1,0,0,0,0"


def test_each_reason_for_a_pause_is_taken_back_by_itself() -> None:
    """The shield and { (MN4-SHD-02)."""
    bench = Mn400Bench()
    bench.say(";1", "M3000", "{")
    bench.switch("shield")
    bench.say("}")
    bench.wait(3000)
    assert bench.peek()[0] < 3000
    bench.say("{")
    bench.switch("shield", on=False)
    bench.wait(3000)
    assert bench.peek()[0] < 3000
    bench.say("}")
    bench.wait(3000)
    assert bench.peek()[0] == 3000


def test_a_motion_waits_for_the_shield_with_feedhold() -> None:
    """It begins when the shield is shut; what is pending is kept (ledger §4.2)."""
    bench = Mn400Bench()
    bench.switch("shield")
    bench.say(";1", "M30")
    bench.wait(500)
    assert bench.value("N") == "30,0,0,0"
    bench.switch("shield", on=False)
    bench.wait(500)
    assert bench.peek()[0] == 30


# ---- panel ----


def test_the_panel_stands_for_commands() -> None:
    """Start U, Pause { and }, Stop Q, Run/Jog J; in silence (MN4-IO-02, MN4-NVM-12)."""
    bench = Mn400Bench()
    bench.say("Z", "M2000", "\x04")
    flags = ("run", "pause", "stop", "jog")

    def shown() -> list[bool]:
        return [bench.device.flag_at(bench.now, name) for name in flags]

    assert shown() == [False, False, False, False]
    bench.switch("start")
    bench.wait(200)
    assert shown() == [True, False, False, False]
    bench.switch("pause")
    bench.switch("pause", on=False)
    bench.wait(1000)
    stood = bench.peek()
    bench.wait(1000)
    assert bench.peek() == stood
    assert shown() == [True, True, False, False]
    bench.switch("pause")
    bench.wait(100)
    assert bench.peek() != stood
    bench.switch("stop")
    assert shown() == [False, False, True, False]
    bench.switch("run_jog")
    assert shown()[3]
    bench.switch("run_jog", on=False)
    assert not shown()[3]
    assert bench.wait(1000) == b""


def test_the_panel_does_not_reach_into_an_entry() -> None:
    """Start and Stop are no lines of a program."""
    bench = Mn400Bench()
    bench.say("Z")
    bench.switch("start")
    bench.switch("stop")
    bench.say("M1", "\x04")
    assert bench.say("R") == "S M1"


def test_outputs_change_one_by_one_and_last() -> None:
    """Through moves, aborts and entries (MN4-CMD-C-01, MN4-CMD-C-02, MN4-IO-03)."""
    bench = Mn400Bench()
    bench.say("C3,0", "C8,0", "M5000", "Q", "Z", "\x04", "C8,1")
    assert bench.device.describe(bench.now).outputs == [3]
    bench.say("M300", "C1,0")
    assert not bench.device.output_at(bench.now, 1) or not bench.device.moves_at(bench.now)
    bench.wait(1000)
    assert bench.device.describe(bench.now).outputs == [1, 3]


@pytest.mark.parametrize("name", ["m5_plus", "shielt", ""])
def test_an_input_that_is_none_is_a_mistake(name: str) -> None:
    """The nearest one is offered."""
    bench = Mn400Bench()
    with pytest.raises(UsageError, match="input"):
        bench.device.set_input(bench.now, name, True)
    assert len(set(NAMES)) == len(NAMES) == 32


# ---- jogging ----


def test_taps_keep_their_fractions() -> None:
    """Ten taps of 8/10 make 8 steps (MN4-JOG-02, MN4-JOG-03), opposite ones cancel (MN4-JOG-04)."""
    bench = Mn400Bench()
    bench.say("G10,10,10,10,8", "J1")
    assert [press(bench, "jog_m2_plus", 50)[1] for _ in range(10)] == [0, 1, 2, 3, 4, 4, 5, 6, 7, 8]
    assert [press(bench, "jog_m2_minus", 50)[1] for _ in range(10)][-1] == 0
    assert bench.peek()[0] == 0


@pytest.mark.parametrize(
    ("inputs", "steps"),
    [((), 4), (("jog_res_0",), 8), (("jog_res_1",), 80), (("jog_res_0", "jog_res_1"), 800)],
)
def test_the_resolution_inputs_select_the_tap(inputs: tuple[str, ...], steps: int) -> None:
    """Of the default parameters of G: 8000 steps by 2000, 1000, 100, 10."""
    bench = Mn400Bench()
    bench.say("J1", "Y20000", "F2,20000,1000000")
    for name in inputs:
        bench.switch(name)
    assert press(bench, "jog_m1_minus", 100)[0] == -steps


def test_what_is_held_moves_at_jog_speed_until_it_is_released() -> None:
    """After half a second, scaled by the potentiometer (MN4-JOG-01, MN4-JOG-05, MN4-JOG-06)."""
    bench = Mn400Bench()
    bench.say("J1", "Y500")
    bench.switch("jog_m1_plus")
    bench.wait(400)
    assert bench.peek()[0] == 4
    bench.wait(600)
    before = bench.peek()[0]
    assert abs(before - 4 - 250) <= 2
    bench.perform(bench.device.set_jog_pot(bench.now, 200))
    bench.wait(1000)
    assert abs(bench.peek()[0] - before - 100) <= 2
    bench.switch("jog_m1_plus", on=False)
    stood = bench.peek()
    bench.wait(1000)
    assert bench.peek()[0] - stood[0] <= 1
    assert bench.say("J0", "M5") == "S D"
    bench.wait(100)
    assert bench.position()[0] == bench.peek()[0] >= stood[0] + 5


def test_counters_can_be_loaded_while_an_axis_jogs() -> None:
    """They count on from there."""
    bench = Mn400Bench()
    bench.say("J1", "Y100")
    bench.switch("jog_m1_plus")
    bench.wait(3000)
    bench.say("L1000,0,0,0", milliseconds=30)
    assert bench.peek()[0] in range(1000, 1005)


def test_jog_inputs_do_nothing_outside_jog_mode() -> None:
    """MN4-JOG-07."""
    bench = Mn400Bench()
    assert press(bench, "jog_m1_plus", 1000)[0] == 0


def test_limits_and_shield_stop_what_jogs() -> None:
    """MN4-JOG-08; Q, too, and jog mode stays (ledger §4.1, note 7)."""
    for name in ("m1_plus", "shield", "Q"):
        bench = Mn400Bench()
        bench.say("J1")
        bench.switch("jog_m1_plus")
        bench.wait(1000)
        assert bench.peek()[0] > 400
        if name == "Q":
            bench.say("Q")
        else:
            bench.switch(name)
        stood = bench.peek()
        bench.wait(1000)
        assert bench.peek() == stood
        assert bench.value("/") == "0"
        assert bench.device.describe(bench.now).state == "JOG"


# ---- pulses ----


def test_a_thread_follows_the_pulses() -> None:
    """After the index and the offset, in proportion, to the end (MN4-THR-01..04)."""
    bench = Mn400Bench()
    bench.say("T500,-250,0,0,2000,3")
    assert pulses(bench, 100)[0] == 0
    bench.perform(bench.device.index_pulse(bench.now))
    assert pulses(bench, 3)[0] == 0
    seen = [pulses(bench, 500)[:2] for _ in range(4)]
    assert [place[0] for place in seen] == [125, 250, 375, 500]
    assert all(abs(place[1] + place[0] / 2) <= 1 for place in seen)
    assert pulses(bench, 1000)[:2] == [500, -250]
    assert bench.value("/") == "0"
    assert bench.device.describe(bench.now).state == "RDY"


def test_without_pulses_a_thread_makes_no_step_however_early_steps_are() -> None:
    """The first one comes with a pulse (MN4-THR-01, MN4-THR-04)."""
    bench = Mn400Bench(step_phase="start")
    assert bench.say("T10,0,0,0,10") == "S D"
    bench.perform(bench.device.index_pulse(bench.now))
    bench.wait(1000)
    assert bench.peek()[0] == 0
    assert [pulses(bench, count)[0] for count in (1, 4, 5)] == [1, 5, 10]


def test_a_thread_needs_no_more_than_a_step_per_pulse_and_can_be_quit() -> None:
    """MN4-THR-05, MN4-CMD-T-03."""
    bench = Mn400Bench()
    assert bench.say("T11,0,0,0,10") == "S PE"
    assert bench.say("T10,0,0,0,10", "Q") == "S D"
    bench.perform(bench.device.index_pulse(bench.now))
    assert pulses(bench, 100)[0] == 0


def test_pulses_pace_a_single_move_however_contours_take_a_negative_speed() -> None:
    """MN4-SYN-01; MN4-AMB-73 is about contours."""
    bench = Mn400Bench(contour_pulses="ignored")
    bench.say("V-1", "B50", "M-10")
    bench.wait(1000)
    assert bench.peek()[0] == 0
    assert [pulses(bench, count)[0] for count in (50, 4, 6)] == [0, -4, -10]


def test_a_spindle_turns_a_thread() -> None:
    """2000 pulses per turn come by themselves, the index among them."""
    bench = Mn400Bench()
    bench.perform(bench.device.turn_spindle(bench.now, 2_000_000))
    bench.say("T500,0,0,0,1000")
    bench.wait(3000)
    assert bench.peek()[0] == 500
    bench.perform(bench.device.turn_spindle(bench.now, 0))
    bench.say("T500,0,0,0,1000")
    bench.wait(3000)
    assert bench.peek()[0] == 500


def test_a_negative_speed_waits_for_pulses() -> None:
    """One per step of the major axis (MN4-SYN-01, MN4-SYN-02, MN4-CMD-V-02)."""
    bench = Mn400Bench()
    bench.say("V-1", "M10,5")
    bench.wait(1000)
    assert bench.peek() == [0, 0, 0, 0]
    assert pulses(bench, 4)[:2] == [4, 2]
    assert pulses(bench, 6)[:2] == [10, 5]
    assert bench.moving_ms("V500", "M1000") == 2000


def test_a_limit_stops_a_paced_arc_where_it_turns_towards_it() -> None:
    """Also when many pulses come at once (MN4-LIM-02)."""
    bench = Mn400Bench()
    bench.switch("m1_plus")
    bench.say("V-1", "A-1000,0,0,0,-1")
    x, _, y, _ = pulses(bench, 5000)
    assert x in range(-2001, -1990)
    assert abs(y) < 60
    assert bench.value("/") == "2"


def test_the_feedrate_scales_what_runs() -> None:
    """Only while it is enabled, and not below 2 steps/s (MN4-IO-01)."""
    bench = Mn400Bench()
    bench.say("F2,5000,1000000", "V1000", "M10000")
    bench.switch("feedrate_enable")
    bench.wait(1000)
    before = bench.peek()[0]
    bench.perform(bench.device.set_feed_pot(bench.now, 500))
    bench.wait(1000)
    assert abs(bench.peek()[0] - before - 500) <= 2
    bench.perform(bench.device.set_feed_pot(bench.now, 0))
    before = bench.peek()[0]
    bench.wait(2000)
    assert abs(bench.peek()[0] - before - 4) <= 2
    bench.switch("feedrate_enable", on=False)
    before = bench.peek()[0]
    bench.wait(1000)
    assert abs(bench.peek()[0] - before - 1000) <= 3
