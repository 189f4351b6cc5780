"""What the settings of an MN400 change, and what they leave alone (ledger §3.6)."""

import re

import pytest
from mn400_bench import Mn400Bench
from mn400_motion_quirk_cases import pulses

from axistwin.kernel.time import NS_PER_MS


def states(bench: Mn400Bench) -> tuple[object, ...]:
    """What a host can read without changing anything."""
    return tuple(bench.value(line) for line in ("E", "N", ":", "/", "S", "["))


WRONG = """
X3 V0 V100001 F5000,1000,1 P1,1 B-1 D0 C9,0 C1,2 I2 =0 =128 ~5 ~-1 ;2 H2 L1,2,3,x L1,2,3,4,5
G1,1,1,1,0 Y0 J2 E3
"""


@pytest.mark.parametrize("line", WRONG.split())
def test_a_refused_setting_changes_nothing(line: str) -> None:
    """PARA_ERROR behind START, at the old number and rate (MN4-ERR-02, MN4-CMD-ADDR-02)."""
    bench = Mn400Bench()
    bench.say("L9,8,7,6", "V500", ";1")
    before = states(bench)
    assert bench.say(line) == "S PE"
    assert states(bench) == before
    assert bench.moving_ms("M100,100") == 200


def test_no_partial_assignment() -> None:
    """D-1,0,1,1 leaves axis 1 as it was (trap 31)."""
    bench = Mn400Bench()
    bench.say("B100,0,0,0", "V500")
    assert bench.say("D-1,0,1,1") == "S PE"
    assert bench.moving_ms("M100") == 200


def test_each_reply_is_of_its_class() -> None:
    """Two packets each, reads without DONE (MN4-RSP-03, MN4-RSP-04, MN4-RSP-07, MN4-RSP-11)."""
    bench = Mn400Bench()
    for line in (";0", "V100", "Q", "{", "}", "|", "C1,0", ")", "U"):
        assert bench.say(line) == "S D", line
    for line in ("/", "?", "S", "N", "E", "[", ":"):
        told = bench.say(line)
        assert told.startswith("S "), line
        assert not told.endswith(" D"), line
    assert re.fullmatch(r"MN400 V \d\.\d\d / \d\.\d\d", bench.value("?"))
    assert bench.value(":") == "1,0,0,0,0"
    assert bench.value("[") == "1"


def test_commands_may_be_in_lower_case() -> None:
    """MN4-PAR-01."""
    bench = Mn400Bench()
    assert [bench.say(line) for line in ("v500", "m10", "e", "x2", "h1", "k")][0::3] == [
        "S D",
        "S D",
    ]
    assert bench.value("e") == "10,0,0,0"


def test_a_profile_is_that_of_later_motions() -> None:
    """A motion keeps its own (MN4-CMD-F-01, MN4-CMD-F-03); a single value may change alone."""
    bench = Mn400Bench()
    bench.say("V4000", "F1000,4000,4000")
    assert round(bench.moving_ms("M10000")) == round(1000 * (2 * 0.75 + (10000 - 3750) / 4000), 0)
    bench.say("M10000", "F,,40000")
    bench.wait(2000)
    assert bench.device.moves_at(bench.now)
    bench.wait(2000)
    assert bench.moving_ms("M10000") < 2700
    assert bench.moving_ms("F,2000", "M10000") > 5000


def test_separate_moves_each_end_at_start_speed() -> None:
    """The time of a queue is the sum (MN4-MOT-15)."""
    bench = Mn400Bench()
    alone = bench.moving_ms("V5000", "M10000")
    bench.say("H", "M10000", "K", "H0", "M10000")
    began = bench.now
    while bench.device.moves_at(bench.now):
        bench.wait(1)
    assert 2 * alone - 600 < (bench.now - began) / NS_PER_MS < 2 * alone


def test_the_speed_is_that_of_the_major_axis() -> None:
    """Whatever the others do, whichever it is, with any multiplex (MN4-MOT-01, MN4-MOT-05)."""
    bench = Mn400Bench()
    for line in ("M1000", "M1000,1000,1000,1000", "M,-1000,3", "M,,7,1000"):
        assert bench.moving_ms("V500", line) == 2000
        assert bench.moving_ms("X4", line) == 2000
        bench.say("X1")


def test_positive_counts_up_whatever_the_axis() -> None:
    """MN4-CMD-M-03, MN4-PAR-07, MN4-MOT-03."""
    bench = Mn400Bench()
    for axis in range(4):
        bench.say("L0,0,0,0", "M" + "," * axis + "-3")
        bench.wait(50)
        assert bench.peek() == [-3 if each == axis else 0 for each in range(4)]


def test_each_mode_lasts_until_the_next_i() -> None:
    """MN4-CMD-I-01, MN4-CMD-I-03."""
    bench = Mn400Bench()
    bench.say("I1", "M5", "M5", "M5")
    bench.wait(100)
    assert bench.peek()[0] == 5
    bench.say("I0", "M5", "M5")
    bench.wait(100)
    assert bench.peek()[0] == 15


def test_the_plane_says_which_motors_make_arcs() -> None:
    """And which one traverses (MN4-CMD-P-01, MN4-CMD-HEL-02, MN4-CMD-HEL-03, MN4-ARC-08)."""
    bench = Mn400Bench()
    bench.say("P4,2,1", "A-100,0,-200,0,-1")
    bench.wait(2000)
    assert bench.peek() == [0, 0, 0, -200]
    bench.say("L0,0,0,0", "+-100,0,-200,0,-1,-50,1")
    bench.wait(3000)
    assert bench.peek() == [-50, 0, 0, -200]
    assert bench.say("P1,1") == "S PE"
    bench.say("L0,0,0,0", "A-100,0,-200,0,-1")
    bench.wait(2000)
    assert bench.peek() == [0, 0, 0, -200]


def test_a_revolution_more_takes_as_long_as_a_full_circle() -> None:
    """rev full turns, one final arc; full if it ends where it begins (MN4-HEL-01, MN4-HEL-04)."""
    bench = Mn400Bench()
    circle = bench.moving_ms("A-500,0,0,0,1")
    assert circle == pytest.approx(1414, abs=3)
    half = bench.moving_ms("+-500,0,-1000,0,1,100,0")
    assert half == pytest.approx(circle / 2, abs=3)
    assert bench.moving_ms("+-500,0,-1000,0,1,100,2") == pytest.approx(2.5 * circle, abs=5)
    assert bench.moving_ms("+-500,0,0,0,1,100,1") == pytest.approx(2 * circle, abs=5)
    assert bench.say("+-500,0,0,0,1,100,-1") == "S PE"


def test_arcs_run_at_their_speed_throughout_and_on_pulses() -> None:
    """No ramp (MN4-MOT-13), not above end speed, one tick per pulse (MN4-CMD-A-05)."""
    bench = Mn400Bench()
    assert bench.moving_ms("V5000", "A-500,0,0,0,1") == pytest.approx(2828 / 5, abs=2)
    assert bench.moving_ms("V9000", "A-500,0,0,0,1") == pytest.approx(2828 / 5, abs=2)
    bench.say("V-1", "A-500,0,-1000,0,-1")
    halfway = pulses(bench, 707)
    assert abs(halfway[0] + 500) <= 2
    assert halfway[2] in range(-502, -497) or halfway[2] in range(498, 503)
    assert pulses(bench, 708) == [-1000, 0, 0, 0]


def test_the_two_directions_go_round_opposite_sides() -> None:
    """1 clockwise, -1 counter-clockwise with X to the right and Y up (MN4-ARC-01, MN4-CMD-A-03)."""
    heights = []
    for direction in (1, -1):
        bench = Mn400Bench()
        bench.say(f"A1000,0,2000,0,{direction}")
        bench.wait(600)
        heights.append(bench.peek()[2])
    assert heights[0] > 900
    assert heights[1] < -900


def test_what_is_left_of_an_arc_is_the_way_to_its_end() -> None:
    """Net and signed (MN4-ARC-09)."""
    bench = Mn400Bench()
    bench.say("A-1000,0,-2000,0,1", "{")
    x, _, y, _ = bench.peek()
    assert bench.value("N") == f"{-2000 - x},0,{-y},0"


def test_threads_follow_the_coordinate_mode() -> None:
    """MN4-CMD-T-02."""
    bench = Mn400Bench()
    bench.say("L100,0,0,0", "I1", "T150,,-5,0,60")
    bench.perform(bench.device.index_pulse(bench.now))
    assert pulses(bench, 60) == [150, 0, -5, 0]


def test_quit_and_pause_without_a_motion_do_nothing() -> None:
    """Nor for the next one (MN4-CMD-Q-03, MN4-CMD-PAU-04)."""
    bench = Mn400Bench()
    before = states(bench)
    for line in ("Q", "{", "}", ")", "|"):
        assert bench.say(line) == "S D"
    assert states(bench) == before
    bench.say("M10")
    bench.wait(100)
    assert bench.peek()[0] == 10


def test_after_quit_both_modes_go_on_from_where_the_axes_are() -> None:
    """MN4-QUIT-02."""
    bench = Mn400Bench()
    bench.say("M5000", "Q")
    stood = bench.peek()[0]
    bench.say("M10")
    bench.wait(100)
    assert bench.peek()[0] == stood + 10
    bench.say("I1", "M5000")
    bench.wait(5000)
    assert bench.peek()[0] == 5000


def test_hold_keeps_only_motion() -> None:
    """While nothing is pending all else works (MN4-CMD-H-02, MN4-CMD-H-03)."""
    bench = Mn400Bench()
    bench.say("H1")
    assert bench.say("L5,0,0,0") == "S D"
    assert bench.value("E") == "5,0,0,0"
    assert bench.say("X2") == "S D"
    bench.say("H0", "M5")
    bench.wait(50)
    assert bench.peek()[0] == 10


def test_a_pending_motion_of_one_board_does_not_concern_another() -> None:
    """MN4-DROP-07; nor does its rate (MN4-DROP-09)."""
    bench = Mn400Bench(1, 2)
    bench.say("H", "M5")
    assert bench.say("E") == "S MP"
    assert bench.say("E", number=2) == "S 0,0,0,0"
    bench.say("K")
    bench.ask(bytes.fromhex("81 7E 34 81 34"))
    assert bench.say("E", number=2) == "S 0,0,0,0"


@pytest.mark.parametrize(("line", "milliseconds"), [("E", 0), ("E1", 100), ("E2", 1000)])
def test_a_measurement_is_told_when_it_is_over(line: str, milliseconds: int) -> None:
    """START at once, the value behind the time (MN4-MEA-01)."""
    bench = Mn400Bench()
    bench.value(line, milliseconds=1500)
    (start_ns, _), (value_ns, _) = bench.device.sent
    assert value_ns - start_ns == milliseconds * NS_PER_MS + 6_250_000


def test_read_outs_of_a_monotone_motion_are_monotone() -> None:
    """And within its box (MN4-MEA-06, MN4-RSP-15)."""
    bench = Mn400Bench()
    bench.say("M3000,-1500")
    seen = [bench.position() for _ in range(20)]
    assert seen == sorted(seen, key=lambda place: (place[0], -place[1]))
    assert seen[-1] == [3000, -1500, 0, 0]
    assert len({place[0] for place in seen}) > 10


def test_arcs_and_contours_take_up_backlash_at_their_start() -> None:
    """By the first direction of each axis; the last one is remembered (MN4-BKL-06, MN4-BKL-07)."""
    bench = Mn400Bench()
    bench.say("V500", "F2,5000,1000000")
    plain = bench.moving_ms("(", "M50", "M-50", ")")
    bench.say("B100,0,0,0", "D1")
    assert bench.moving_ms("(", "M50", "M-50", ")") == pytest.approx(plain, abs=1)
    assert bench.moving_ms("(", "M50", "M-50", ")") == pytest.approx(plain + 200, abs=5)
    assert bench.moving_ms("M-10") == pytest.approx(20, abs=1)


def test_an_abort_during_compensation_leaves_the_whole_move() -> None:
    """Memory is new already (MN4-BKL-05)."""
    bench = Mn400Bench()
    bench.say("V500", "B1000", "M-100", "Q")
    assert bench.value("N") == "-100,0,0,0"
    assert bench.peek()[0] == 0
    assert bench.moving_ms("M-100") == 200


def test_compensation_is_seen_at_the_step_outputs_alone() -> None:
    """After D1,-1,1,1 a positive move compensates axis 2 only (MN4-CMD-D-02, MN4-BKL-03)."""
    bench = Mn400Bench()
    bench.say("B30,30,30,30", "D1,-1,1,1", "M5,6,7,8")
    bench.wait(500)
    assert bench.device.steps_at(bench.now) == [5, 36, 7, 8]
    assert bench.peek() == [5, 6, 7, 8]
    bench.say("M-5,1")
    bench.wait(500)
    assert bench.device.steps_at(bench.now) == [40, 37, 7, 8]
    assert bench.peek() == [0, 7, 7, 8]
