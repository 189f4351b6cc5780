"""What a host sees under each value of each quirk: the registry, and frames, addresses, storage."""

import contextlib
from collections.abc import Mapping

from mac_bench import ACCEPTED, MS, NACK, REFUSED, SILENCE, TICK_NS, MacBench, S
from quirk_cases import Cases

from axistwin.devices.mac.serial.framing import checksum, request
from axistwin.errors import UsageError
from axistwin.motion.plant import Load
from axistwin.wire.framing import Chunk

CASES: Cases[MacBench] = Cases()
case = CASES.case


def verdict(reply: bytes) -> str:
    """A, R, N, Q or - for a reply."""
    names = {ACCEPTED: "A", REFUSED: "R", SILENCE: "-", NACK: "N"}
    return names.get(reply) or ("Q" if len(reply) == 21 else reply.hex())


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
    with contextlib.suppress(UsageError):
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
