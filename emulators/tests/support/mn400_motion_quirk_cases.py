"""What a host sees under each value of each quirk of a board: motion, pauses, pulses, jogging."""

from mn400_bench import Mn400Bench
from mn400_quirk_cases import CASES, after, entered

ALL_CASES = CASES
"""Those of packets and programs, and those below."""

case = CASES.case


def near(value: float, *expected: float) -> float:
    """The one of ``expected`` that is within one in a hundred; else the value."""
    return next((each for each in expected if abs(value - each) <= each / 100), value)


def pulses(bench: Mn400Bench, count: int) -> list[int]:
    """Where the axes are after so many pulses."""
    bench.perform(bench.device.feed_pulses(bench.now, count))
    return bench.peek()


def press(bench: Mn400Bench, name: str, milliseconds: float) -> list[int]:
    """Where the axes are long after an input was on for a while."""
    bench.switch(name)
    bench.wait(milliseconds)
    bench.switch(name, on=False)
    bench.wait(3000)
    return bench.peek()


CONTOUR = ("V3000", "M500,,500", "M505,,500", "M509,,500", "V3850", "M530,,505", "M520,,510")
"""The manual's example."""


def contour_ms(bench: Mn400Bench, opening: str, *segments: str) -> float:
    """How long a contour takes."""
    return bench.moving_ms("V3000", "I0", opening, *segments, ")")


# ---- speed ----


@case("accel_scale", {"1.0": 3667, "0.5": 4000})
def _(bench: Mn400Bench) -> object:
    return near(bench.moving_ms("F1000,4000,4000", "V3000", "M10000"), 3667, 4000)


@case("multiplex_cap", {"clip": ("S D", 25), "error": ("S PE", 0), "none": ("S D", 50)})
def _(bench: Mn400Bench) -> object:
    bench.say("F50000,50000,1", "V50000", "X4")
    told = bench.say("M900000,900000")
    before = bench.peek()[0]
    bench.wait(10)
    return told, (bench.peek()[0] - before + 5) // 10


@case("dda_phase", {"half": 3, "zero": 5, "full": 1})
def _(bench: Mn400Bench) -> object:
    bench.say("V-1", "M5,1")
    return next(count for count in range(1, 6) if pulses(bench, 1)[1])


@case("step_phase", {"end": 500, "start": 0})
def _(bench: Mn400Bench) -> object:
    bench.say("V2", "M1", milliseconds=20)
    return 0 if bench.peek()[0] else round(bench.moving_ms("H0") + 15, -2) + 0 * 500


@case("feedrate_pot", {"scale": 1000, "ignore": 2000})
def _(bench: Mn400Bench) -> object:
    bench.perform(bench.device.set_feed_pot(bench.now, 500))
    assert near(bench.moving_ms("F2,5000,1000000", "V2000", "M2000"), 1000) == 1000
    bench.switch("feedrate_enable")
    return 2_000_000 / near(bench.moving_ms("M2000"), 1000, 2000)


@case("dir_level_positive", {"low": [False, True], "high": [True, False]})
def _(bench: Mn400Bench) -> object:
    levels = []
    for line in ("M5", "M-5"):
        after(bench, 100, line)
        levels.append(bench.device.direction_at(bench.now, 1))
    return levels


# ---- arcs and helices ----


@case("arc_ramp", {"false": False, "true": True})
def _(bench: Mn400Bench) -> object:
    return bench.moving_ms("V5000", "A5000,0,0,0,1") > 28284 / 5 * 1.05


@case("arc_rate", {"dominant_tick": 1414, "tangential": 1571})
def _(bench: Mn400Bench) -> object:
    return near(bench.moving_ms("A-1000,0,-2000,0,1"), 1414, 1571)


@case("arc_radius_tol", {"2.5": "S D", "0": "S PE"})
def _(bench: Mn400Bench) -> object:
    assert bench.say("A-1000,0,-500,0,1") == "S PE"
    return bench.say("A0,-500,-354,-146,-1")


@case("arc_zero_sweep", {"full": True, "none": False})
def _(bench: Mn400Bench) -> object:
    bench.say("A-2000,0,0,0,1")
    return bench.device.moves_at(bench.now)


@case(
    "helix_abs_fields",
    {"center_dest": [-2000, -400, 0], "none": [-3000, -400, 1000], "all": [-2000, -500, 0]},
)
def _(bench: Mn400Bench) -> object:
    return after(bench, 9000, "L-1000,100,1000,0", "I1", "+-1000,0,-2000,0,1,-500,0")[:3]


@case("helix_zero_final", {"full": 2, "none": 1})
def _(bench: Mn400Bench) -> object:
    return round(bench.moving_ms("+-500,0,0,0,1,100,1") / 1414)


# ---- contours ----


@case(
    "cc_margin_scope",
    {"per_axis_pair": (957, 1156), "per_axis_equal": (1090, 1274), "major_only": (957, 958)},
)
def _(bench: Mn400Bench) -> object:
    return tuple(round(contour_ms(bench, opening, *CONTOUR)) for opening in ("(50", "("))


@case(
    "cc_unsupported",
    {
        "invalidcommand": ("IC", "S D"),
        "busy": ("S BY", "S D"),
        "ignored": ("S D", "S D"),
        "executed": ("S 0", "S D"),
    },
)
def _(bench: Mn400Bench) -> object:
    bench.say("(")
    return bench.say("/"), bench.say("Q")


@case("cc_corner_speed", {"start_speed": 933, "margin": 1096})
def _(bench: Mn400Bench) -> object:
    return round(contour_ms(bench, "(", "M1000", "M0,1000"))


@case("cc_capacity", {"256": 256, "3": 3})
def _(bench: Mn400Bench) -> object:
    bench.say("(")
    told = [bench.say("M1") for _ in range(258)]
    assert set(told) == {"S D", "S OV"}
    return told.count("S D")


@case("cc_axis4", {"ignored": "S D", "error": "S PE"})
def _(bench: Mn400Bench) -> object:
    bench.say("(")
    assert bench.say("M100,,,100") == "S D"
    return bench.say("M,,,100")


@case("contour_pulses", {"paced": ("S D", 0), "ignored": ("S D", 100), "error": ("S PE", 0)})
def _(bench: Mn400Bench) -> object:
    bench.say("V-2000", "(", "M100")
    told = bench.say(")")
    bench.wait(1000)
    return told, bench.peek()[0]


# ---- pauses and aborts ----


@case("quit_in_entry", {"both": False, "entry_only": True})
def _(bench: Mn400Bench) -> object:
    bench.say("M5000", "(", "Q")
    return bench.device.moves_at(bench.now)


@case("pause_decel", {"true": True, "false": False})
def _(bench: Mn400Bench) -> object:
    bench.say("F1000,5000,1000", "V3000", "M30000")
    bench.wait(2000)
    bench.say("{", milliseconds=20)
    before = bench.peek()[0]
    bench.wait(5000)
    assert bench.say("}") == "S D"
    return bench.peek()[0] - before > 500


@case("pause_idle", {"noop": 10, "latch": 0})
def _(bench: Mn400Bench) -> object:
    moved = after(bench, 500, "{", "M10")[0]
    assert after(bench, 500, "}")[0] == 10
    return moved


@case("quit_decel", {"false": False, "true": True})
def _(bench: Mn400Bench) -> object:
    bench.say("F1000,5000,1000", "V3000", "M30000")
    bench.wait(2000)
    bench.say("Q", milliseconds=20)
    before = bench.peek()[0]
    bench.wait(5000)
    assert bench.value(":").endswith("1")
    return bench.peek()[0] - before > 500


@case("quit_flushes_queue", {"true": 0, "false": 500})
def _(bench: Mn400Bench) -> object:
    return after(bench, 1000, "M5000", "M,500", "Q")[1]


@case("move_abort_use", {"unused": "S D", "while_aborted": "S ABORT"})
def _(bench: Mn400Bench) -> object:
    bench.say("M5000", "Q")
    told = bench.say("L0,0,0,0")
    bench.say("|")
    assert bench.say("L0,0,0,0") == "S D"
    return told


@case("abort_exit_code", {"0": "0", "keep": "2", "7": "7"})
def _(bench: Mn400Bench) -> object:
    bench.switch("m1_plus")
    bench.say("M5")
    assert bench.value("/") == "2"
    bench.say("M-5000", "Q")
    return bench.value("/")


@case("multi_limit_exit", {"sum": "10", "first": "2"})
def _(bench: Mn400Bench) -> object:
    bench.switch("m1_plus")
    bench.switch("m2_plus")
    bench.say("M500,500")
    return bench.value("/")


@case("limit_direction", {"toward": ("0", -500), "both": ("2", 0)})
def _(bench: Mn400Bench) -> object:
    bench.switch("m1_plus")
    moved = after(bench, 1000, "M-500")[0]
    return bench.value("/"), moved


@case("limit_halts", {"all": (False, "2"), "axis": (True, "2")})
def _(bench: Mn400Bench) -> object:
    bench.say("M3000,3000")
    bench.switch("m1_plus")
    stood = bench.peek()[0]
    bench.wait(3000)
    assert bench.peek()[0] == stood
    return bench.peek()[1] == 3000, bench.value("/")


@case("limit_ramp", {"false": False, "true": True})
def _(bench: Mn400Bench) -> object:
    bench.say("F1000,5000,1000", "V3000", "M30000")
    bench.wait(2000)
    bench.switch("m1_plus")
    before = bench.peek()[0]
    bench.wait(5000)
    assert bench.value("/") == "2"
    return bench.peek()[0] - before > 500


# ---- backlash ----


@case("backlash_counts", {"false": -50, "true": -100})
def _(bench: Mn400Bench) -> object:
    return after(bench, 1000, "B50", "M-50")[0]


@case("backlash_speed", {"v": 150, "start": 250})
def _(bench: Mn400Bench) -> object:
    bench.say("F1000,5000,1000000", "V2000", "B200")
    return round(bench.moving_ms("M-100"), -1)


@case("backlash_arc", {"start_only": False, "quadrants": True})
def _(bench: Mn400Bench) -> object:
    plain = bench.moving_ms("A500,0,0,0,1")
    bench.say("D1,1,1,1", "B1000,0,1000,0")
    return bench.moving_ms("A500,0,0,0,1") > plain + 1500


# ---- pulses ----


@case("threader_start", {"index": 0, "first_pulse": 5})
def _(bench: Mn400Bench) -> object:
    bench.say("T5,0,0,0,10")
    moved = pulses(bench, 20)[0]
    if not moved:
        bench.perform(bench.device.index_pulse(bench.now))
        assert pulses(bench, 10)[0] == 5
    return moved


@case("threader_overrate", {"para_error": "S PE", "multi": "S D"})
def _(bench: Mn400Bench) -> object:
    return bench.say("T20,0,0,0,10")


@case("sync_ratio", {"major_step": 10, "tick": 5})
def _(bench: Mn400Bench) -> object:
    bench.say("X2", "V-1", "M100,100")
    return pulses(bench, 10)[0]


# ---- jogging and the panel ----


@case("tap_rounding", {"floor": [0, 1, 2, 3, 4], "nearest": [1, 2, 2, 3, 4]})
def _(bench: Mn400Bench) -> object:
    bench.say("G10,10,10,10,8", "J1")
    return [press(bench, "jog_m1_plus", 50)[0] for _ in range(5)]


@case("jog_res_code", {"r1_first": 4, "r4_first": 800})
def _(bench: Mn400Bench) -> object:
    bench.say("J1")
    return press(bench, "jog_m1_plus", 50)[0]


@case("jog_hold_ms", {"500": False, "50": True})
def _(bench: Mn400Bench) -> object:
    bench.say("J1")
    return press(bench, "jog_m1_plus", 200)[0] > 50


@case("panel_start", {"run_program": 25, "none": 0})
def _(bench: Mn400Bench) -> object:
    entered(bench, "M25")
    return press(bench, "start", 50)[0]
