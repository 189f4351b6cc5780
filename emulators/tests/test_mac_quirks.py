"""Every switch of the MAC twin works: for each value, what a host sees (ledger §7, §5.11)."""

from bisect import bisect_left
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from mac_bench import ACCEPTED, MS, NACK, REFUSED, SILENCE, TICK_NS, MacBench, S

from axistwin.devices.mac.framing import checksum, request
from axistwin.devices.mac.quirks import QUIRKS, MacQuirks, parse_quirks
from axistwin.errors import UsageError
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk

Scenario = Callable[[MacBench], object]
CASES: dict[str, tuple[Scenario, dict[str, object], dict[str, Any]]] = {}


def case(name: str, seen: Mapping[str, object], **base: Any) -> Callable[[Scenario], Scenario]:
    """Register what is seen under each value of quirk ``name``, over the ``base`` settings."""

    def register(scenario: Scenario) -> Scenario:
        assert name not in CASES
        CASES[name] = (scenario, dict(seen), base)
        return scenario

    return register


def verdict(reply: bytes) -> str:
    """A, R, N, Q or - for a reply."""
    names = {ACCEPTED: "A", REFUSED: "R", SILENCE: "-", NACK: "N"}
    return names.get(reply) or ("Q" if len(reply) == 21 else reply.hex())


def final(bench: MacBench) -> int:
    """The position when all motion is over."""
    bench.settle()
    return bench.position()


def run_ticks(bench: MacBench) -> int:
    """Let the motion end; its duration in ticks from the last Etx on."""
    start = bench.etx_ns
    while bench.device.is_moving(bench.now):
        due = bench.device.next_event()
        assert due is not None
        bench.run_until(due)
    return (bench.now - start) // TICK_NS


def with_sum(body: bytes) -> bytes:
    """A frame around aa..pppppppp."""
    return b"\x02014" + body + checksum(body) + b"\x03"


# ---- frames and replies ----


@case("xon_byte", {"1Ah": 0x1A, "11h": 0x11})
def _(bench: MacBench) -> object:
    return bench.ask(0x19)[2]


@case("xonerror_byte", {"17h": 0x17, "18h": 0x18})
def _(bench: MacBench) -> object:
    return bench.ask(0x12)[2]


@case("status_reply_digit", {"1": b"1", "2": b"2"})
def _(bench: MacBench) -> object:
    return bench.ask(0x21)[8:9]


@case("reply23_digit", {"3": b"3", "2": b"2"})
def _(bench: MacBench) -> object:
    return bench.ask(0x23)[8:9]


@case("reply28_length", {"011": b"011", "014": b"014"})
def _(bench: MacBench) -> object:
    return bench.ask(0x28)[3:6]


@case("virtual_segment_index", {"1Eh": ("A", 0)})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x1E, 0x00640400)), final(bench)


@case("bad_frame_reply", {"silence": "--", "nack": "NN"})
def _(bench: MacBench) -> object:
    frame = request(0, 0x20)
    length = bench.send(frame[:3] + b"5" + frame[4:])
    return verdict(length) + verdict(bench.send(frame[:20] + b"\x04"))


@case("lowercase_hex", {"refuse": "R-N", "accept": "AQA"})
def _(bench: MacBench) -> object:
    frame = request(0, 0x0C, 0x4A)
    sums = verdict(bench.send(frame[:18] + frame[18:20].lower() + frame[20:]))
    digit = verdict(bench.send(with_sum(b"000c0000000040")))
    bench.do(0x08, 0x0A, address=0xFF)
    return digit + verdict(bench.send(with_sum(b"0a200000000000"))) + sums


@case("rx_during_xoff", {"lost": 21, "kept": 42})
def _(bench: MacBench) -> object:
    return len(bench.send(request(0, 0x20) * 2))


@case("subindex_policy", {"ignore": "QA", "refuse": "RR"})
def _(bench: MacBench) -> object:
    assert len(bench.ask(0x28, sub_index=0xAF)) == 21
    return verdict(bench.ask(0x20, sub_index=1)) + verdict(bench.ask(0x19, sub_index=1))


@case("dont_care_digits", {"ignore": "AQA", "refuse": "RRR"})
def _(bench: MacBench) -> object:
    asked = ((0x0C, 0xFFFFFF40), (0x20, 1), (0x15, 0x01000320))
    return "".join(verdict(bench.ask(*each)) for each in asked)


@case(
    "unknown_index",
    {"refuse": "RR", "accept": "AA", "zero_answer": "AQ", "silence": "--"},
)
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x12)) + verdict(bench.ask(0x2A))


@case("param_range_policy", {"refuse": ("R", 0), "mask": ("A", 8), "clamp": ("A", 9)})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x03, 0x0A)), bench.read(0x26) >> 8 & 0xF


@case("reply_latency_us", {"1000": 1000, "0": 0, "250000": 250_000})
def _(bench: MacBench) -> object:
    bench.do(0x19)
    return (bench.late[-1].start_ns - bench.etx_ns) // 1000


@case("version_word", {"00000704h": 0x704, "20061214h": 0x20061214})
def _(bench: MacBench) -> object:
    return bench.read(0x24)


@case("reserved_bits", {"0": (0, 0x0800), "1": (0x80F0FF7F, 0xDF9F)})
def _(bench: MacBench) -> object:
    return bench.read(0x21), bench.read(0x27) & 0xFFFF


@case("mem_wrap", {"wrap": 0xFFFF0003, "zero": 0xFFFF0000})
def _(bench: MacBench) -> object:
    return bench.read(0x29, 0xFE)


# ---- addresses ----


@case(
    "general_reply_policy",
    {"addr00_only": "Q--", "all": "QQQ", "none": "---", "lone": "Q-Q"},
)
def _(bench: MacBench) -> object:
    """Module 00 among others, module 05 among others, module 05 alone."""
    bench.device.alone = False
    told = verdict(bench.ask(0x20, address=0xFF))
    bench.device.address = 5
    told += verdict(bench.ask(0x20, address=0xFF))
    bench.device.alone = True
    return told + verdict(bench.ask(0x20, address=0xFF))


@case("general_echo", {"as_sent": b"FF", "own_address": b"00"})
def _(bench: MacBench) -> object:
    return bench.ask(0x20, address=0xFF)[6:8]


@case("addr_prog_requires_ff", {"false": "AQ", "true": "R-"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x08, 7)) + verdict(bench.ask(0x20, address=7))


@case("addr_effective", {"at_once": "-QQ", "at_restart": "Q-Q"})
def _(bench: MacBench) -> object:
    bench.do(0x08, 7, address=0xFF)
    told = verdict(bench.ask(0x20, address=0)) + verdict(bench.ask(0x20, address=7))
    bench.power_cycle()
    return told + verdict(bench.ask(0x20, address=7))


@case("addr_range", {"refuse": "R-", "mask": "AQ"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x08, 0x85, address=0xFF)) + verdict(bench.ask(0x20, address=5))


@case("nack_scope", {"addressed": "--N", "module_00": "N--", "any": "NNN"})
def _(bench: MacBench) -> object:
    """A wrong sum to module 03, seen by 00 and by 05; then one to 05 itself."""
    wrong = request(3, 0x20)[:18] + b"00\x03"
    told = verdict(bench.send(wrong))
    bench.device.address = 5
    told += verdict(bench.send(wrong))
    return told + verdict(bench.send(request(5, 0x20)[:18] + b"00\x03"))


# ---- start-up and storage ----


@case("reset_reply", {"ack": "A-A-", "silence": "----"})
def _(bench: MacBench) -> object:
    told = verdict(bench.ask(0x00)) + verdict(bench.ask(0x20))
    bench.advance(2 * S)
    return told + verdict(bench.ask(0x01)) + verdict(bench.ask(0x20))


@case("boot_time_ms", {"2000": "--Q", "500": "-QQ", "0": "QQQ"})
def _(bench: MacBench) -> object:
    bench.do(0x00)
    told, start = "", bench.now
    for milliseconds in (0, 600, 2100):
        bench.run_until(start + milliseconds * MS)
        told += verdict(bench.ask(0x20))
    return told


@case("baud_reply_rate", {"old": 38400, "new": 9600})
def _(bench: MacBench) -> object:
    """The rate of the module's UART when its reply leaves."""
    bench.device.receive(Chunk(bench.now, request(0, 0x1B, 1), bench.device.line_format))
    return bench.device.line_format.baud


@case("factory_reset_scope", {"restart": "A-", "no_restart": "AQ"})
def _(bench: MacBench) -> object:
    bench.do(0x0D, 0x1000)
    told = verdict(bench.ask(0x01)) + verdict(bench.ask(0x25))
    bench.advance(2 * S)
    assert bench.read(0x25) & 0xFFFF == 0x320
    return told


@case("persist_modes", {"stored": 0x000909, "volatile": 0x001000})
def _(bench: MacBench) -> object:
    for index, value in ((0x02, 0), (0x03, 9), (0x1C, 9)):
        bench.do(index, value)
    assert bench.read(0x26) & 0xFFFF == 0x0909
    bench.power_cycle()
    return bench.read(0x26) & 0xFFFF


@case("power_on_at_boot", {"false": "OF", "true": "HD"})
def _(bench: MacBench) -> object:
    bench.power_cycle()
    return bench.state()


@case("cmd_1b_supported", {"true": "A", "false": "R"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x1B, 3))


@case("cmd_1c_supported", {"true": ("A", 5), "false": ("R", 0)})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x1C, 5)), bench.read(0x26) & 0xFF


@case("has_reset_input", {"true": "-", "false": "Q"})
def _(bench: MacBench) -> object:
    bench.input("reset", True)
    return verdict(bench.ask(0x20))


def factory(name: str, seen: Mapping[str, object], query: int, shift: int, mask: int) -> None:
    """A factory value is what a query reads after 01h."""

    @case(name, seen)
    def _(bench: MacBench) -> object:
        bench.do(0x01)
        bench.advance(2 * S)
        return bench.read(query) >> shift & mask


factory("factory_standby", {"1": 1, "0": 0}, 0x26, 12, 0xF)
factory("factory_stops", {"0": 0, "1": 1, "8": 8, "9": 9}, 0x26, 8, 0xF)
factory("factory_superior_stop", {"3FFFFFFFh": 0x3FFFFFFF, "5": 5}, 0x22, 0, 0xFFFFFFFF)
factory("factory_inferior_stop", {"C0000000h": 0xC0000000, "-5": 0xFFFFFFFB}, 0x23, 0, 0xFFFFFFFF)
factory("factory_torque", {"60h": 0x60, "7Fh": 0x7F}, 0x26, 16, 0xFF)
factory("factory_period", {"0320h": 0x320, "FFFFh": 0xFFFF}, 0x25, 0, 0xFFFF)
factory("factory_catchup", {"05h": 5, "FFh": 0xFF}, 0x25, 24, 0xFF)
factory("factory_ramp", {"0Ah": 10, "00h": 0}, 0x26, 24, 0xFF)
factory("factory_tolerance", {"00h": 0, "20h": 0x20}, 0x26, 0, 0xFF)


@case("imax_value", {"80h": (0x80, "RA"), "FFh": (0xFF, "AA"), "40h": (0x40, "RR")})
def _(bench: MacBench) -> object:
    told = verdict(bench.ask(0x0C, 0x81)) + verdict(bench.ask(0x0C, 0x80))
    return bench.read(0x28, 0xAF) >> 24, told


@case("mac34_limits", {"model": (0, 0x20, 0), "20/30/40/60": (0x40, 0, 0x08)}, model="mac34-1")
def _(bench: MacBench) -> object:
    """dd at 35 V, at 22 V, and the disjunctions at 51 V."""
    told = []
    for volts in (35, 22, 51):
        bench.take(bench.device.set_supply(bench.now, volts * 1000))
        told.append(bench.read(0x21) >> 24)
    return told[0], told[1], told[2] & 0x0C


# ---- acceptance ----


@case("motion_lock_set", {"can_list": "R", "serial_list": "A"})
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return verdict(bench.ask(0x0D, 0x100))


@case("lock_08_1b", {"false": "A", "true": "R"})
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return verdict(bench.ask(0x08, 5))


@case("preload_locks", {"false": "A", "true": "R"})
def _(bench: MacBench) -> object:
    bench.do(0x10)
    bench.do(0x13, 100)
    return verdict(bench.ask(0x0D, 0x100))


@case(
    "running_until",
    {"tolerance": "RA", "exact": "RR", "profile": "AA"},
    factory_catchup=0xFF,
    factory_tolerance=20,
)
def _(bench: MacBench) -> object:
    """0Dh while the axis is held far from its target, and when it is within the tolerance."""
    bench.take(bench.device.set_load(bench.now, Load(held=True)))
    bench.do(0x13, 100)
    bench.advance(S)
    held = verdict(bench.ask(0x0D, 0x320))
    bench.take(bench.device.set_load(bench.now, Load()))
    while bench.device.position_at(bench.now) < 90:
        bench.advance(MS)
    return held + verdict(bench.ask(0x0D, 0x320))


@case("disj_refuse_set", {"motion_type": "RR", "starting": "AR"})
def _(bench: MacBench) -> object:
    bench.take(bench.device.set_fault(bench.now, "micro_cut", True))
    return verdict(bench.ask(0x18)) + verdict(bench.ask(0x13, 5))


@case("torque_range", {"inclusive": "AA", "exclusive": "RR"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x0C, 0)) + verdict(bench.ask(0x0C, 0x80))


@case("torque_over", {"refuse": 0x60, "clamp": 0x80, "mask": 0x01})
def _(bench: MacBench) -> object:
    bench.ask(0x0C, 0x81)
    return bench.read(0x26) >> 16 & 0xFF


@case("zero_period_0d", {"refuse": ("R", 0x320), "as_one": ("A", 1)})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x0D, 0)), bench.read(0x25) & 0xFFFF


@case("zero_catchup", {"as_one": ("A", 0, 200_000), "refuse": ("R", 5, MS)})
def _(bench: MacBench) -> object:
    """Reply, 25h, and the time of one catch-up increment."""
    told = verdict(bench.ask(0x0E, 0)), bench.read(0x25) >> 24
    bench.do(0x14)
    bench.take(bench.device.push(bench.now, -1))
    start = bench.now
    while bench.device.position_at(bench.now):
        bench.advance(100_000)
    return *told, bench.now - start


@case("catchup_low_byte", {"ignore": ("A", 7), "refuse": ("R", 5)})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x0E, 0x0701)), bench.read(0x25) >> 24


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
    before = MacBench(factory_ramp=1)
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
    rest = final(bench)
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
    return final(bench), bench.now - start > S


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


@case("abort_flush", {"true": 1, "false": 2001})
def _(bench: MacBench) -> object:
    """How far the axis goes when a segment of one step follows 18h in a queue of three."""
    for _ in range(3):
        bench.do(0x16, 0x03E80400)
    bench.do(0x18)
    rest = bench.position()
    bench.do(0x16, 0x00010400)
    return final(bench) - rest


# ---- synchronous mode ----


@case("sync_without_preload", {"accept": "A", "refuse": "R"})
def _(bench: MacBench) -> object:
    return verdict(bench.ask(0x11))


@case("sync_arm_lifetime", {"kept": ("OF+PL", "VE+AR"), "lost": ("PO", "VE")})
def _(bench: MacBench) -> object:
    """10h, a virtual segment, 13h; and 10h in motion."""
    bench.do(0x10)
    bench.do(0x1E, 0x00000400)
    bench.do(0x13, 100_000)
    told = bench.state().replace("HD", "OF")
    bench.do(0x18)
    bench.do(0x15, 0x320)
    bench.do(0x10)
    return told, bench.state()


@case("preload_policy", {"replace": ("A", 200, 0), "refuse": ("R", 100, 0), "keep": ("A", 100, 50)})
def _(bench: MacBench) -> object:
    """The second motion's reply, where 11h leads, and whether 17h leaves a preload alone."""
    bench.do(0x10)
    bench.do(0x13, 100)
    told = verdict(bench.ask(0x13, 200))
    bench.do(0x11)
    place = final(bench)
    bench.do(0x0B)
    for index, parameters in ((0x10, 0), (0x13, 50), (0x17, 0), (0x11, 0)):
        bench.do(index, parameters)
    return told, place, final(bench)


@case("armed_zero_velocity", {"keep": ("A", 0), "spend": ("A", 50), "refuse": ("R", 0)})
def _(bench: MacBench) -> object:
    bench.do(0x10)
    told = verdict(bench.ask(0x15, 0))
    bench.do(0x13, 50)
    return told, final(bench)


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
    return final(bench)


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
    place = final(bench)
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
    place = final(bench)
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
    place = final(bench)
    return told, "ramped" if 100 < place - here <= 121 and place < 200 else place


# ---- stops, reference, counter, faults ----


@case(
    "soft_stop_compare", {"strict": 501, "equal": 500}, factory_stops=8, factory_superior_stop=500
)
def _(bench: MacBench) -> object:
    bench.do(0x15, 0x320)
    return final(bench)


@case(
    "soft_stop_blocks",
    {"same_direction": 550, "both": 600},
    factory_stops=8,
    factory_superior_stop=500,
    cells={"position": 600},
)
def _(bench: MacBench) -> object:
    bench.do(0x13, 550)
    return final(bench)


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
    return final(bench)


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
    place = final(bench)
    assert place in (20_000, 20_000 - passed)
    return place == 20_000


@case("reset_in_motion", {"absolute": True, "remaining": False})
def _(bench: MacBench) -> object:
    bench.do(0x13, 20_000)
    bench.advance(S)
    bench.do(0x0B)
    return final(bench) == 20_000


@case(
    "position_overflow",
    {"wrap": (-0x40000000 + 9, -0x40000000 + 8), "saturate": (0x3FFFFFFF, 0x3FFFFFFE)},
    cells={"position": 0x3FFFFFFF - 90},
)
def _(bench: MacBench) -> object:
    bench.do(0x16, 0x00640400)
    over = final(bench)
    bench.do(0x16, 0xFFFF0400)
    return over, final(bench)


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


# ---- the tests ----


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, (_, seen, _) in CASES.items() for value in seen]
)
def test_each_value_of_each_quirk_shows_on_the_wire(name: str, value: str) -> None:
    """The scenario of the quirk ends as the reading says."""
    scenario, seen, base = CASES[name]
    assert scenario(MacBench(**{**base, name: value})) == seen[value]


def test_every_quirk_has_a_case_with_all_its_values() -> None:
    """Numbers and texts: at least the default and another one."""
    assert CASES.keys() == QUIRKS.keys()
    for name, quirk in QUIRKS.items():
        values = CASES[name][1].keys()
        assert quirk.default in values, name
        if quirk.kind in ("choice", "bool"):
            assert set(quirk.allowed) == set(values), name
        else:
            assert len(values) >= 2, name


def test_the_first_case_value_is_the_default() -> None:
    """Values stand in the order of the readings, default first."""
    for name, quirk in QUIRKS.items():
        assert next(iter(CASES[name][1])) == quirk.default, name
        assert quirk.source.startswith("MACS-"), name
        assert quirk.doc, name


def test_defaults_parse_to_the_default_settings() -> None:
    """What the program lists as default is the default."""
    assert parse_quirks({name: quirk.default for name, quirk in QUIRKS.items()}) == MacQuirks()


@pytest.mark.parametrize(
    ("value", "meant"), [("11h", 0x11), ("0x11", 0x11), ("17", 0x11), (17, 0x11), ("1Ah", 0x1A)]
)
def test_numbers_may_be_spelled_as_hex_or_decimal(value: str | int, meant: int) -> None:
    """On a command line or in TOML."""
    assert parse_quirks({"xon_byte": value}).xon_byte == meant


@pytest.mark.parametrize(("value", "meant"), [("yes", True), (True, True), ("off", False)])
def test_switches_take_the_usual_words(value: str | bool, meant: bool) -> None:
    """And TOML booleans."""
    assert parse_quirks({"fifo_counts_executing": value}).fifo_counts_executing is meant


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("xon_bite", "1", "did you mean xon_byte"),
        ("xon_byte", "12h", "allowed: 1Ah, 11h"),
        ("running_until", "tolerence", "did you mean tolerance"),
        ("boot_time_ms", "-1", r"allowed: 0\.\.60000"),
        ("boot_time_ms", "soon", r"allowed: 0\.\.60000"),
        ("abort_flush", "perhaps", "allowed: true, false"),
        ("mac34_limits", "30/20/40/60", "UNDER/OVER/VMAX/TRIP"),
        ("brake_increments", "70000", r"0\.\.65535"),
        ("factory_superior_stop", "100000000h", "80000000h"),
    ],
)
def test_a_mistake_is_one_line_with_the_allowed_values(name: str, value: str, words: str) -> None:
    """UsageError naming value, allowed range and remedy."""
    with pytest.raises(UsageError, match=words) as told:
        parse_quirks({name: value})
    assert "\n" not in str(told.value)
