"""What the motion commands of an MN400 do on the wire, with the numbers of ledger §5."""

import pytest
from mn400_bench import Mn400Bench, in_short, packets_in

MS = 1.0


@pytest.mark.parametrize(
    ("lines", "milliseconds"),
    [
        (("F1000,4000,4000", "V2000", "M10000"), 5125),
        (("F1000,4000,4000", "V3000", "M10000"), 3667),
        (("V2000", "M10000"), 5050),
        (("V8000", "M20000"), 4320),
        (("V5000", "M500"), 289.9),
        (("V3000", "M800"), 400),
        (("V500", "M1000"), 2000),
        (("V3000", "(50", "M1000", "M1000", ")"), 800),
        (("V3000", "(", "M1000", "M0,1000", ")"), 933.3),
        (("V3000", "(", "M1000", "M-1000", ")"), 933.3),
        (("V3000", "(", "M1000", "V2000", "M1000", ")"), 941),
        (("V2", "M1"), 500),
        (("A-1000,0,-2000,0,1",), 1414),
    ],
)
def test_motions_take_as_long_as_the_ledger_computes(
    lines: tuple[str, ...], milliseconds: float
) -> None:
    """Ledger §5.2, §5.3, §5.5."""
    assert Mn400Bench().moving_ms(*lines) == pytest.approx(milliseconds, rel=1e-3)


def test_a_contour_is_faster_than_its_moves_one_by_one() -> None:
    """The manual's example: 0.957 s, with the default margin 1.156 s, as moves 1.475 s."""
    lines = ("V3000", "M500,,500", "M505,,500", "M509,,500", "V3850", "M530,,505", "M520,,510")
    bench = Mn400Bench()
    assert round(bench.moving_ms("(50", *lines, ")")) == 957
    assert bench.peek() == [2564, 0, 2515, 0]
    assert round(bench.moving_ms("V3000", "(", *lines, ")")) == 1156
    apart = [bench.moving_ms("V3000", line) for line in lines[1:4]]
    apart += [bench.moving_ms("V3850", line) for line in lines[5:]]
    assert round(sum(apart)) == 1475


# ---- coordinates ----


def test_omitted_axes_stay_where_they_are() -> None:
    """Also in absolute mode (MN4-PAR-06), where trap 1 would drive them home."""
    bench = Mn400Bench()
    bench.say("L10,20,30,40", "I1", "M,,-100")
    bench.wait(500)
    assert bench.peek() == [10, 20, -100, 40]
    bench.say("I0", "M1,")
    bench.wait(500)
    assert bench.peek() == [11, 20, -100, 40]


def test_both_modes_do_what_they_say() -> None:
    """Relative at power-up (MN4-CMD-M-02, MN4-CMD-I-02, MN4-CMD-L-02)."""
    bench = Mn400Bench()
    bench.say("L5,0,0,0", "M5")
    bench.wait(100)
    assert bench.value("E") == "10,0,0,0"
    bench.say("I1", "M5,-7")
    bench.wait(100)
    assert bench.value("E") == "5,-7,0,0"
    bench.say("L0,0,0,0", "M5,-7", "I0")
    bench.wait(100)
    assert bench.value("E") == "5,-7,0,0"


def test_counters_wrap_in_32_bits() -> None:
    """MN4-MOT-06."""
    bench = Mn400Bench()
    bench.say("L2147483647,0,0,0", "M2")
    bench.wait(100)
    assert bench.value("E") == "-2147483647,0,0,0"


def test_a_motion_without_steps_is_over_at_once() -> None:
    """And the exit code is 0 (MN4-CMD-M-04)."""
    bench = Mn400Bench()
    bench.switch("m1_plus")
    bench.say("M5")
    assert bench.value("/") == "2"
    assert bench.say("M") == "S D"
    assert bench.value("/") == "0"
    assert bench.peek() == [0, 0, 0, 0]


def test_a_vector_move_stays_on_its_chord() -> None:
    """All axes start and end together (MN4-CMD-M-01)."""
    bench = Mn400Bench()
    bench.say("M3000,-1500,750,1")
    seen = 0
    while bench.device.moves_at(bench.now):
        bench.wait(7)
        first, second, third, fourth = bench.peek()
        assert abs(second + first / 2) <= 1
        assert abs(third - first / 4) <= 1
        assert fourth in (0, 1)
        seen += 0 < first < 3000
    assert seen > 100
    assert bench.peek() == [3000, -1500, 750, 1]


# ---- the queue ----


def test_commands_queue_and_settings_change_later_moves_only() -> None:
    """MN4-RSP-06, MN4-STM-01, MN4-CMD-V-05; E is live, N is of the present move (MN4-CMD-N-03)."""
    bench = Mn400Bench()
    bench.say("V1000", "M2000", "V500", "M,500", "L,,7,")
    assert bench.value("N").endswith(",0,0,0")
    bench.wait(1500)
    assert bench.peek()[1:3] == [0, 0]
    bench.wait(500)
    assert 0 < bench.peek()[1] < 250
    assert bench.value("N").startswith("0,")
    bench.wait(1000)
    assert bench.peek() == [2000, 500, 7, 0]


def test_the_mode_of_a_queued_motion_is_that_of_its_acceptance() -> None:
    """The queued I in front of it included (MN4-CMD-I-04)."""
    bench = Mn400Bench()
    bench.say("L100,0,0,0", "M500", "I1", "M50", "I0", "M5")
    bench.wait(3000)
    assert bench.peek()[0] == 55


def test_quit_flushes_the_queue_and_takes_queued_settings_back() -> None:
    """MN4-CMD-Q-01, MN4-CMD-Q-02, trap 40."""
    bench = Mn400Bench()
    bench.say("V1000", "M5000", "V100", "M,500", "Q")
    stood = bench.peek()
    assert 0 < stood[0] < 5000
    assert bench.value("N") == f"{5000 - stood[0]},0,0,0"
    assert bench.value(":") == "1,0,0,0,1"
    assert bench.value("/") == "0"
    bench.wait(3000)
    assert bench.peek() == stood
    assert bench.moving_ms("M1000") == 1000
    assert bench.value(":") == "1,0,0,0,0"
    assert bench.value("N") == "0,0,0,0"


def test_a_full_queue_loses_the_command_alone() -> None:
    """Behind START (MN4-STM-03); immediate ones still work (MN4-STM-02)."""
    bench = Mn400Bench(queue_depth=2)
    bench.say("M30000")
    assert [bench.say(line) for line in ("V500", "M1", "M1", "L5")] == [
        "S D",
        "S D",
        "S OV",
        "S OV",
    ]
    assert [bench.say(line) for line in ("H", "H0", "|", ";1", "*")][-1] == "S PR"


# ---- pause ----


def test_a_pause_loses_no_step() -> None:
    """The manual's example (MN4-CMD-PAU-01, MN4-CMD-PAU-02, MN4-MEA-05, MN4-CMD-SW-02)."""
    bench = Mn400Bench()
    bench.say("V1000", "M2000")
    bench.wait(1000 - 100)
    bench.say("{")
    position, left = bench.value("E"), bench.value("N")
    assert 980 < int(position.split(",")[0]) < 1020
    assert int(position.split(",")[0]) + int(left.split(",")[0]) == 2000
    assert bench.value(":") == "1,0,1,1,0"
    bench.wait(5000)
    assert bench.value("E") == position
    bench.say("M,5", "}")
    assert bench.value(":") == "1,0,0,0,0"
    bench.wait(2000)
    assert bench.peek() == [2000, 5, 0, 0]
    assert bench.value("/") == "0"


def test_the_pause_flags_tell_asked_from_stopped() -> None:
    """During the ramp only the first is on (MN4-AMB-37)."""
    bench = Mn400Bench()
    bench.say("F1000,5000,1000", "V4000", "M30000")
    bench.wait(4000)
    bench.say("{")
    assert bench.value(":") == "1,0,1,0,0"
    bench.wait(5000)
    assert bench.value(":") == "1,0,1,1,0"
    bench.say("Q")
    assert bench.value(":") == "1,0,0,0,1"
    bench.say("}")
    stood = bench.peek()
    bench.wait(2000)
    assert bench.peek() == stood


# ---- hold ----


def test_hold_keeps_one_motion_with_its_settings() -> None:
    """It starts with K and what was in force (MN4-CMD-H-01, MN4-STM-07, MN4-STM-08)."""
    bench = Mn400Bench()
    bench.say("V1000", "H", "V500")
    assert bench.say("M1000") == "S D"
    assert bench.say("M1") == "S MP"
    bench.wait(2000)
    assert bench.peek()[0] == 0
    assert bench.moving_ms("K") == 2000
    assert bench.say("M1", "H0") == "S MP"
    assert bench.say("K", "H0") == "S D"


def test_a_contour_is_kept_by_hold() -> None:
    """As the pending motion (ledger §4.1, note 4)."""
    bench = Mn400Bench()
    bench.say("H", "(", "M100", ")")
    assert bench.say("E") == "S MP"
    bench.say("K")
    bench.wait(500)
    assert bench.peek()[0] == 100


# ---- contours ----


def test_quit_discards_what_was_sent_since_the_bracket() -> None:
    """The speed, too; a later ) does nothing (MN4-CMD-CC-04, MN4-STM-06)."""
    bench = Mn400Bench()
    bench.say("V1000", "(", "V100", "M500", "Q")
    assert bench.say(")") == "S D"
    bench.wait(1000)
    assert bench.peek()[0] == 0
    assert bench.moving_ms("M1000") == 1000


def test_the_last_speed_of_a_contour_stays_in_force() -> None:
    """MN4-CMD-CC-07; an empty pair does nothing (MN4-CMD-CC-08)."""
    bench = Mn400Bench()
    bench.say("(", "M10", "V500", ")")
    bench.wait(500)
    assert bench.moving_ms("M1000") == 2000
    assert [bench.say(line) for line in ("(", ")")] == ["S D", "S D"]


def test_a_contour_tells_what_is_left_of_all_its_segments() -> None:
    """Net and signed (MN4-CC-10), paused and resumed (MN4-CMD-CC-06)."""
    bench = Mn400Bench()
    bench.say("V1000", "(", "M1000", "M-400,300", ")", "{")
    position = bench.peek()
    left = [int(text) for text in bench.value("N").split(",")]
    assert [a + b for a, b in zip(position, left, strict=True)] == [600, 300, 0, 0]
    bench.say("}")
    bench.wait(3000)
    assert bench.peek() == [600, 300, 0, 0]


# ---- arcs ----


def test_the_arcs_of_the_manual_move_axes_1_and_3() -> None:
    """Clockwise through (-1000, 0, -1000): y is never positive (MN4-ARC-05, MN4-CMD-A-01)."""
    bench = Mn400Bench()
    bench.say("A-1000,0,-2000,0,1")
    lowest = 0
    while bench.device.moves_at(bench.now):
        bench.wait(5)
        x, second, y, fourth = bench.peek()
        assert (second, fourth) == (0, 0)
        assert y <= 1
        assert abs(((x + 1000) ** 2 + y * y) ** 0.5 - 1000) <= 1.5
        lowest = min(lowest, y)
    assert lowest < -990
    assert bench.peek() == [-2000, 0, 0, 0]
    assert bench.say("A0,-500,-354,-146,-1") == "S D"
    bench.wait(1000)
    assert bench.peek() == [-2354, 0, -146, 0]


def test_the_helix_of_the_manual_ends_where_it_says() -> None:
    """4.5 revolutions clockwise (MN4-CMD-HEL-01); the traverse motor must not be in the plane."""
    bench = Mn400Bench()
    assert bench.say("+-1000,0,-2000,0,1,-500,4") == "S D"
    bench.wait(20_000)
    assert bench.peek() == [-2000, -500, 0, 0]
    assert bench.say("P1,2") == "S D"
    assert bench.say("+-1000,0,-2000,0,1,-500,4") == "S PE"
    assert bench.say("A-1000,0,-500,0,1") == "S PE"
    assert bench.say("A0,0,0,0,1") == "S PE"


def test_arcs_in_absolute_mode_are_judged_from_where_they_will_start() -> None:
    """Also behind a queue (MN4-CMD-A-02)."""
    bench = Mn400Bench()
    bench.say("I1", "M1000,,500")
    assert bench.say("A500,500,0,500,1") == "S D"
    assert bench.say("A500,500,0,500,1") == "S D"
    assert bench.say("A500,400,100,500,1") == "S PE"
    bench.wait(10_000)
    assert bench.peek() == [0, 0, 500, 0]


# ---- measurement ----


@pytest.mark.parametrize(("multiplex", "count"), [(1, 200), (2, 400), (4, 800)])
def test_measurements_count_phantom_steps(multiplex: int, count: int) -> None:
    """Scaled by the multiplex, of motions of several axes (MN4-CMD-E-02, MN4-CMD-E-03)."""
    bench = Mn400Bench()
    bench.say(f"X{multiplex}", "M20000,10000")
    bench.wait(200)
    *_, told = bench.value("E1", milliseconds=200).split(",")
    assert abs(int(told) - count) <= multiplex
    *_, told = bench.value("E2", milliseconds=1200).split(",")
    assert abs(int(told) - 10 * count) <= multiplex
    bench.say("Q")
    assert bench.value("E1", milliseconds=200).endswith(",0")


def on_usb(bench: Mn400Bench) -> list[str]:
    """The reports since last time: the letter of a command, and its value."""
    told = [bytes.fromhex(one).decode("ascii") for one in bench.device.take_report(bench.now)]
    bench.device.drop_reports(bench.now)
    return told


@pytest.mark.parametrize("is_asked_on_usb", [False, True])
def test_a_measurement_told_on_both_ports_is_made_once(is_asked_on_usb: bool) -> None:
    """Whoever asks: two of different begin would tell another time than 100 ms (MN4-AMB-66)."""
    bench = Mn400Bench(reply_transport="both")
    bench.say("V300", "F300,300,1000", "M2000,-600")
    bench.wait(500)
    on_usb(bench)
    if is_asked_on_usb:
        bench.perform(bench.device.send_usb(bench.now, "E1"))
        told = " ".join(map(in_short, packets_in(bench.wait(200))))
    else:
        told = bench.say("E1", milliseconds=200)
    assert told.startswith("S ")
    assert on_usb(bench) == [f"E{told[2:]}"]
    assert abs(int(told.split(",")[-1]) - 30) <= 1


def test_what_a_read_out_clears_is_told_alike_on_both_ports() -> None:
    """The abort flag that reading clears: the reply is made once (MN4-AMB-66)."""
    bench = Mn400Bench(reply_transport="both", abort_flag_clear="read")
    bench.say("M500", "Q")
    on_usb(bench)
    assert bench.say(":") == "S 1,0,0,0,1"
    assert on_usb(bench) == [":1,0,0,0,1"]


def test_the_measurement_of_the_manual_is_1500_steps_a_second() -> None:
    """E1, a multiplex of 2 and a count of 300 (MN4-MEA-02)."""
    bench = Mn400Bench()
    bench.say("X2", "V1500", "M20000,10000")
    bench.wait(200)
    *_, told = bench.value("E1", milliseconds=200).split(",")
    assert abs(int(told) - 300) <= 2


# ---- backlash ----


def test_backlash_is_taken_up_when_an_axis_turns_round() -> None:
    """Uncounted, before the move (MN4-BKL-01..04, MN4-CMD-D-02)."""
    bench = Mn400Bench()
    bench.say("F2,5000,1000000", "V1000", "B100,100,100,100")
    times = [round(bench.moving_ms(line), -1) for line in ("M500", "M-500", "M-500", "M500", "M,1")]
    assert times == [500, 600, 500, 600, 0]
    assert bench.peek() == [0, 1, 0, 0]
    bench.say("D1,-1,1,1")
    assert round(bench.moving_ms("M500,500,500,500"), -1) == 600
    assert bench.say("D-1,0,1,1") == "S PE"
    assert round(bench.moving_ms("M500"), -1) == 500
