"""What a host sees under each value of the quirks of motion, stops and faults."""

from bisect import bisect_left

from mac_bench import MS, TICK_NS, MacBench, S
from mac_quirk_cases import CASES, case, run_ticks, verdict

from axistwin.motion.plant import Load

__all__ = ["CASES"]

# ---- position and velocity ----


@case("motion_start_ref", {"etx": 0, "reply_end": MS + 781_250})
def _(bench: MacBench) -> object:
    """What a one-step segment of 8.191875 ms takes longer."""
    bench.do(0x16, 0x0001FFFF)
    return run_ticks(bench) * TICK_NS - 0xFFFF * TICK_NS


@case("step_phase", {"end": 0, "start": 1})
def _(bench: MacBench) -> object:
    bench.do(0x16, 0x0001FFFF)
    return bench.device.position_at(bench.now)


def climb_ticks(bench: MacBench) -> int:
    """Ticks of the whole ramp of AA = 1, P = 800: when increment 120 is complete."""
    bench.do(0x15, 0x320)
    times = range(bench.now, bench.now + S)
    first = times[bisect_left(times, 120, key=bench.device.position_at)]
    return (first - bench.etx_ns) // TICK_NS


EQUAL_INCREMENTS = sum(
    (15 * k // 2 - 15 * (k - 1) // 2) * ((2 * 12800 + k) // (2 * k)) for k in range(1, 17)
)


@case("ramp_law", {"equal_time": 192_004, "equal_increments": EQUAL_INCREMENTS}, factory_ramp=1)
def _(bench: MacBench) -> object:
    return climb_ticks(bench)


@case(
    "period_rounding",
    {
        "half_up": 192_004,
        "floor": sum(k * (12800 // k) for k in range(1, 16)),
        "ceil": sum(k * -(-12800 // k) for k in range(1, 16)),
    },
    factory_ramp=1,
)
def _(bench: MacBench) -> object:
    return climb_ticks(bench)


@case("triangle_law", {"mirror": 51_200, "shared_peak": 46_934}, factory_ramp=1)
def _(bench: MacBench) -> object:
    """Six increments: d = 0 1 2 2 1 0, or the middle two at the level of 3."""
    bench.do(0x13, 6)
    return run_ticks(bench)


@case("vel_f6_direction", {"negative": -1, "positive": 1})
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x00F60320)
    bench.advance(S)
    return 1 if bench.position() > 0 else -1


@case("vel_reverse_cmd", {"ignore": "A", "refuse": "R"})
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return verdict(bench.ask(0x15, 0x00F60200))


@case("vel_during_position", {"accept": ("A", "VE"), "refuse": ("R", "PO")})
def _(bench: MacBench) -> object:
    bench.do(0x13, 100_000)
    return verdict(bench.ask(0x15, 0x200)), bench.state()


@case("vel_during_interp", {"accept": ("A", "VE"), "refuse": ("R", "IN")})
def _(bench: MacBench) -> object:
    bench.do(0x16, 0x7FFF0400)
    return verdict(bench.ask(0x15, 0x200)), bench.state()


@case(
    "vel_change_law",
    {"ramp_length": True, "constant_acceleration": False, "step": False},
    factory_ramp=1,
)
def _(bench: MacBench) -> object:
    """Whether 1600 to 800 takes 120 increments in 127674 ticks (and ends the one before)."""
    bench.do(0x15, 1600)
    bench.advance(S)
    bench.do(0x15, 800)
    start = bench.etx_ns
    before = type(bench)(factory_ramp=1)
    before.do(0x15, 1600)
    count = bench.position_at(start + 127_674 * TICK_NS) - before.position_at(start)
    law = bench.device.quirks.vel_change_law
    assert {"step": count > 155, "constant_acceleration": count < 100}.get(law, True)
    return 119 <= count <= 121


@case("stop_ramp_law", {"climbed": 1, "ramp_length": 0}, factory_ramp=10)
def _(bench: MacBench) -> object:
    """Whether 17h early in a ramp needs no more increments than the climb."""
    bench.do(0x15, 0x1000)
    bench.advance(300 * MS)
    bench.do(0x17)
    here = bench.device.position_at(bench.now)
    rest = bench.settled_position()
    assert rest - here < 400 or rest - here > 1190
    return int(rest < 3 * here)


@case(
    "overshoot_return",
    {"catch_up": (100, True), "fresh_profile": (100, False)},
    factory_ramp=1,
    factory_catchup=0xFF,
    cells={"position": -5000},
)
def _(bench: MacBench) -> object:
    """Where the axis ends, and whether its way back is the slow one."""
    bench.do(0x13, 100)
    bench.advance(300 * MS)
    bench.do(0x0B)
    start = bench.now
    return bench.settled_position(), bench.now - start > S


@case("plant", {"ideal": True, "inertial": False}, factory_ramp=0)
def _(bench: MacBench) -> object:
    """Whether an unramped move takes D·P ticks exactly, or longer."""
    bench.do(0x13, 1000)
    ticks = run_ticks(bench)
    assert bench.position() == 1000
    assert ticks >= 1000 * 0x320
    return ticks == 1000 * 0x320


@case("busy_after_abort", {"false": 0x08, "true": 0})
def _(bench: MacBench) -> object:
    bench.do(0x13, 100_000)
    bench.do(0x18)
    return bench.read(0x27) >> 8 & 0x08


@case("busy_after_17h", {"false": (0x08, 0x08), "true": (0, 0x08)})
def _(bench: MacBench) -> object:
    """27h at rest after 17h; then after 18h, which gives up what 17h has left (MACS-AMB-51)."""
    bench.do(0x13, 100_000)
    bench.do(0x17)
    bench.settle()
    after_17h = bench.read(0x27) >> 8 & 0x08
    bench.do(0x18)
    return after_17h, bench.read(0x27) >> 8 & 0x08


@case("abort_flush", {"true": 1, "false": 2001})
def _(bench: MacBench) -> object:
    """How far the axis goes when a segment of one step follows 18h in a queue of three."""
    for _ in range(3):
        bench.do(0x16, 0x03E80400)
    bench.do(0x18)
    rest = bench.position()
    bench.do(0x16, 0x00010400)
    return bench.settled_position() - rest


# ---- synchronous mode ----


@case("sync_without_preload", {"accept": "A", "refuse": "R"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x11))


@case("sync_arm_lifetime", {"kept": "VE+AR", "lost": "VE"})
def _(bench: MacBench) -> object:
    """10h in motion."""
    bench.do(0x15, 0x320)
    bench.do(0x10)
    return bench.state()


@case("arm_after_segment", {"kept": 0, "lost": 30})
def _(bench: MacBench) -> object:
    """10h, a virtual segment, 13h: where the axis then is without 11h."""
    bench.do(0x10)
    bench.do(0x1E, 0x00010400)
    bench.do(0x13, 30)
    return bench.settled_position()


@case("preload_policy", {"replace": ("A", 200, 0), "refuse": ("R", 100, 0), "keep": ("A", 100, 50)})
def _(bench: MacBench) -> object:
    """The second motion's reply, where 11h leads, and whether 17h leaves a preload alone."""
    bench.do(0x10)
    bench.do(0x13, 100)
    told = verdict(bench.ask(0x13, 200))
    bench.do(0x11)
    place = bench.settled_position()
    bench.do(0x0B)
    for index, parameters in ((0x10, 0), (0x13, 50), (0x17, 0), (0x11, 0)):
        bench.do(index, parameters)
    return told, place, bench.settled_position()


@case("armed_zero_velocity", {"keep": ("A", 0), "spend": ("A", 50), "refuse": ("R", 0)})
def _(bench: MacBench) -> object:
    bench.do(0x10)
    told = verdict(bench.ask(0x15, 0))
    bench.do(0x13, 50)
    return told, bench.settled_position()


@case("sync_during_interp", {"after": (200, -50), "now": (False, -50), "drop": (200, 200)})
def _(bench: MacBench) -> object:
    """Whether the segments are run to their end, and where all ends."""
    for index, parameters in ((0x10, 0), (0x13, -50), (0x16, 0x00641000), (0x16, 0x00641000)):
        bench.do(index, parameters & 0xFFFFFFFF)
    bench.do(0x11)
    top = 0
    while bench.device.is_moving(bench.now):
        top = max(top, bench.device.position_at(bench.now))
        bench.advance(100_000)
    top = max(top, bench.device.position_at(bench.now))
    return (200 if top == 200 else False), bench.position()


# ---- segments ----


@case("fifo_counts_executing", {"false": "AAAAR", "true": "AAARR"})
def _(bench: MacBench) -> object:
    return "".join(verdict(bench.ask(0x1E, 0x03E81000)) for _ in range(5))


@case("segment_signed", {"true": -1, "false": 65535})
def _(bench: MacBench) -> object:
    bench.do(0x16, 0xFFFF0010)
    return bench.settled_position()


@case(
    "segment_zero_period",
    {"refuse": ("R", 0), "fastest": ("A", 0x100), "65536": ("A", 0x100 * 65536)},
)
def _(bench: MacBench) -> object:
    bench.do(0x1E, 0x000AFFFF)  # what comes next ends a whole segment later
    first = bench.etx_ns + 10 * 0xFFFF * TICK_NS
    told = verdict(bench.ask(0x1E, 0x01000000))
    bench.settle()
    return told, (bench.now - first) // TICK_NS


@case("segment_zero_steps", {"zero_time": ("A", 0), "65536": ("A", 65536 * 0x400)})
def _(bench: MacBench) -> object:
    told = verdict(bench.ask(0x1E, 0x00000400))
    ticks = run_ticks(bench)
    return told, ticks if ticks > 100_000 else 0


@case(
    "fifo_underrun",
    {"halt": (100, "A"), "decelerate": (220, "A"), "error": (100, "R")},
    factory_ramp=1,
)
def _(bench: MacBench) -> object:
    """Where an underrun leaves the axis, and what becomes of the next segment."""
    bench.do(0x16, 0x00640320)
    place = bench.settled_position()
    told = verdict(bench.ask(0x16, 0x00640320))
    bench.do(0x18)
    bench.do(0x16, 0x00640320)
    return place, told


@case(
    "interp_during_profile",
    {"queue": ("A", 1100), "refuse": ("R", 1000), "preempt": ("A", False)},
)
def _(bench: MacBench) -> object:
    bench.do(0x13, 1000)
    told = verdict(bench.ask(0x16, 0x00640400))
    place = bench.settled_position()
    return told, place if place >= 1000 else False


@case(
    "stop17_in_interp",
    {
        "ignore": ("A", 400),
        "refuse": ("R", 400),
        "after_segment": ("A", 200),
        "now": ("A", "ramped"),
    },
    factory_ramp=1,
)
def _(bench: MacBench) -> object:
    bench.do(0x16, 0x00C80800)
    bench.do(0x16, 0x00C80800)
    told = verdict(bench.ask(0x17))
    here = bench.device.position_at(bench.now)
    place = bench.settled_position()
    return told, "ramped" if 100 < place - here <= 121 and place < 200 else place


@case("segments_after_17h", {"run": 40, "dropped": 0}, factory_ramp=1)
def _(bench: MacBench) -> object:
    """How far a segment that waits behind a 13h goes once 17h has stopped that."""
    bench.do(0x13, 100_000)
    bench.do(0x16, 0x00280400)
    bench.do(0x17)
    place = bench.settled_position()
    before = type(bench)(factory_ramp=1)
    before.do(0x13, 100_000)
    before.do(0x1E, 0x00280400)
    before.do(0x17)
    return place - before.settled_position()


# ---- stops, reference, counter, faults ----


@case(
    "soft_stop_compare", {"strict": 501, "equal": 500}, factory_stops=8, factory_superior_stop=500
)
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return bench.settled_position()


@case(
    "soft_stop_blocks",
    {"same_direction": 550, "both": 600},
    factory_stops=8,
    factory_superior_stop=500,
    cells={"position": 600},
)
def _(bench: MacBench) -> object:
    bench.do(0x13, 550)
    return bench.settled_position()


@case("hard_stop_command", {"accept": "AAA", "refuse": "RRR"}, factory_stops=1)
def _(bench: MacBench) -> object:
    bench.input("positive_stop", True)
    asked = ((0x13, 100), (0x15, 0x320), (0x16, 0x00640400))
    told = "".join(verdict(bench.ask(*each)) for each in asked)
    assert bench.position() == 0
    bench.do(0x13, 0xFFFFFFFE)
    return told


@case(
    "brake_increments",
    {"plant": 501, "0": 501, "10": 511},
    factory_stops=8,
    factory_superior_stop=500,
)
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return bench.settled_position()


@case(
    "ff_lifetime",
    {"next_motion": (2, 2, 0, 0), "live": (2, 0, 0, 0), "until_reset": (2, 2, 2, 0)},
    factory_stops=8,
    factory_superior_stop=500,
)
def _(bench: MacBench) -> object:
    """ff after the stop, after 0Bh, after the next motion, after 00h."""
    bench.do(0x15, 0x320)
    bench.settle()
    told = [bench.read(0x21) >> 16]
    bench.do(0x0B)
    told.append(bench.read(0x21) >> 16)
    bench.do(0x13, 10)
    told.append(bench.read(0x21) >> 16)
    bench.reset()
    return (*told, bench.read(0x21) >> 16)


@case(
    "status_ff_layout",
    {"can_map": 2, "shifted": 4},
    factory_stops=8,
    factory_superior_stop=500,
)
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    bench.settle()
    return bench.read(0x21) >> 16


@case("status_hh_bit", {"7": 0x80, "6-0": 0x7F})
def _(bench: MacBench) -> object:
    bench.take(bench.device.set_supply(bench.now, 50_000))
    return bench.read(0x21) & 0xFF


@case("ref_edge", {"opening": (False, True), "closing": (True, False)}, factory_ramp=0)
def _(bench: MacBench) -> object:
    """Whether the counter is zeroed when the contact closes, and when it opens."""
    bench.do(0x07, 1)
    bench.do(0x15, 0x320)
    told = []
    for active in (True, False):
        bench.advance(S)
        bench.input("reference", active)
        told.append(bench.device.position_at(bench.now) == 0)
    return tuple(told)


@case("ref_retarget", {"absolute": True, "remaining": False})
def _(bench: MacBench) -> object:
    """Whether the target stays the number that was sent."""
    bench.do(0x07, 1)
    bench.input("reference", True)
    bench.do(0x13, 20_000)
    bench.advance(S)
    passed = bench.device.position_at(bench.now)
    bench.input("reference", False)
    place = bench.settled_position()
    assert place in (20_000, 20_000 - passed)
    return place == 20_000


@case("reset_in_motion", {"absolute": True, "remaining": False})
def _(bench: MacBench) -> object:
    bench.do(0x13, 20_000)
    bench.advance(S)
    bench.do(0x0B)
    return bench.settled_position() == 20_000


@case(
    "position_overflow",
    {"wrap": (-0x40000000 + 9, -0x40000000 + 8), "saturate": (0x3FFFFFFF, 0x3FFFFFFE)},
    cells={"position": 0x3FFFFFFF - 90},
)
def _(bench: MacBench) -> object:
    bench.do(0x16, 0x00640400)
    over = bench.settled_position()
    bench.do(0x16, 0xFFFF0400)
    return over, bench.settled_position()


@case("target_range", {"refuse": "R", "accept": "A"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x13, 0x40000000))


@case("position_source", {"encoder": 0, "set_point": 100})
def _(bench: MacBench) -> object:
    bench.take(bench.device.set_load(bench.now, Load(held=True)))
    bench.do(0x13, 100)
    bench.advance(S)
    return bench.position()


@case("encoder_fault_locks", {"true": (2, "R"), "false": (2, "A")}, model="mac34-1")
def _(bench: MacBench) -> object:
    bench.take(bench.device.set_fault(bench.now, "encoder", True))
    return bench.read(0x21) >> 24, verdict(bench.ask(0x13, 5))


@case("standby_swing", {"none": [100] * 4, "one": [100, 101, 100, 99]})
def _(bench: MacBench) -> object:
    """What is read at rest after 13h, once around."""
    bench.do(0x13, 100)
    bench.settle()
    return [bench.position_at(2 * S + 50 * MS * quarter) for quarter in range(4)]
