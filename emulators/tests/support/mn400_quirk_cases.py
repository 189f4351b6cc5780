"""What a host sees under each value of each quirk of a board: packets, parameters, programs."""

from mn400_bench import Mn400Bench, in_short, packets_in
from quirk_cases import Cases

from axistwin.devices.mn400.link.packets import packet
from axistwin.kernel.time import NS_PER_MS

CASES: Cases[Mn400Bench] = Cases()
case = CASES.case


def hexed(data: bytes) -> str:
    """As people read bytes."""
    return data.hex(" ").upper()


def entered(bench: Mn400Bench, *lines: str) -> None:
    """Store a user program."""
    assert bench.say("Z") == "S D"
    bench.say(*lines)
    assert bench.say("\x04") == "S D"


def configured(bench: Mn400Bench, *lines: str) -> None:
    """Store a configuration program."""
    bench.say(".", *lines)
    assert bench.say("Q") == "S D"


def after(bench: Mn400Bench, milliseconds: float, *lines: str) -> list[int]:
    """Where the axes are some time after ``lines``."""
    for line in lines:
        assert bench.say(line) == "S D", line
    bench.wait(milliseconds)
    return bench.peek()


# ---- packets ----


@case(
    "data_packet_trailer",
    {"06": "06", "none": "", "0600": "06 00", "05": "05", "0500": "05 00", "00": "00"},
)
def _(bench: Mn400Bench) -> object:
    _, data = packets_in(bench.ask(packet(1, b"/")))
    assert data[2:3] == b"0"
    return hexed(data[3:-2])


@case("data_value_encoding", {"ascii": "30 2C 30 2C 30 2C 30", "dot_nul": "30 2E 00 2E 00 2E 00"})
def _(bench: Mn400Bench) -> object:
    _, data = packets_in(bench.ask(packet(1, b"E")))
    return hexed(data[2:-3])


@case("outcome_null", {"true": "81 4B 10 00 81 5D", "false": "81 4B 10 81 5D"})
def _(bench: Mn400Bench) -> object:
    heard = hexed(bench.ask(packet(1, b"K")))
    assert heard.startswith("81 4B 03 00 81 50 ")
    return heard[18:]


@case(
    "error_start_policy",
    {
        "after_accept": ("S PE", "IC", "CHK", "S NP"),
        "always": ("S PE", "S IC", "S CHK", "S NP"),
        "never": ("PE", "IC", "CHK", "S NP"),
    },
)
def _(bench: Mn400Bench) -> object:
    wrong = bench.ask(bytes.fromhex("81 2A 81 2D"))
    told = " ".join(in_short(raw) for raw in packets_in(wrong))
    return bench.say("X3"), bench.say("W"), told, bench.say("K")


@case("echo_case", {"upper": "E", "as_sent": "e"})
def _(bench: Mn400Bench) -> object:
    heard = bench.ask(packet(1, b"e"))
    assert bench.ask(packet(1, b"E"))[1:2] == b"E"
    return chr(heard[1])


@case("address_settable", {"true": ("S D", 0, 2), "false": ("S PE", 2, 0)})
def _(bench: Mn400Bench) -> object:
    told = bench.say("=2")
    polls = [packets_in(bench.ask(packet(number, b"*"))) for number in (1, 2)]
    return told, *map(len, polls)


@case(
    "broadcast_reply",
    {"staggered": (True, True), "immediate": (True, False), "poll_only": (False, False)},
    numbers=(1, 9),
)
def _(bench: Mn400Bench) -> object:
    heard = bench.ask(packet(0, b"J0"), 2000)
    late = [device.sent for device in bench.devices]
    if not heard:
        assert not any(late)
        assert len(packets_in(bench.ask(packet(0, b"*"), 2000))) == 4
        return False, False
    return True, late[1][0][0] - late[0][0][0] > 100 * NS_PER_MS


@case("poll_slot_ms", {"auto": 116, "20": 160, "2.5": 20}, numbers=(9,))
def _(bench: Mn400Bench) -> object:
    heard_ns = bench.send(packet(9, b"*"))
    bench.wait(1000)
    delay_ns: int = bench.device.sent[0][0] - heard_ns
    return delay_ns // NS_PER_MS - bench.quirks.response_delay_ms


@case("rx_timeout_ms", {"500": 500, "50": 50})
def _(bench: Mn400Bench) -> object:
    heard_ns = bench.send(b"\x81L1")
    assert hexed(bench.wait(2000)) == "81 4C 13 00 81 61"
    return (bench.device.sent[0][0] - heard_ns) // NS_PER_MS - 1


@case("timeout_reply", {"true": "81 2A 13 00 81 3F", "false": ""})
def _(bench: Mn400Bench) -> object:
    told = hexed(bench.ask(b"\x81*", 1000))
    assert bench.say("*") == "S PR"
    return told


@case("timeout_without_command", {"silent": "", "zero": "81 00 13 00 81 15"})
def _(bench: Mn400Bench) -> object:
    return hexed(bench.ask(b"\x81", 1000))


@case("rx_payload_max", {"80": ("OV", "S PE"), "200": ("S PE", "S PE"), "12": ("OV", "OV")})
def _(bench: Mn400Bench) -> object:
    return tuple(bench.say("L" + "9" * count, milliseconds=400) for count in (100, 20))


@case("retransmit_cmd", {"replaced": "&", "verbatim": "?"})
def _(bench: Mn400Bench) -> object:
    last = packets_in(bench.ask(packet(1, b"?")))[1]
    again = bench.ask(packet(1, b"&"))
    assert again[2:-2] == last[2:-2]
    return chr(again[1])


@case("retransmit_in_entry", {"retransmit": ("D", "S"), "store": ("S D", "S &")})
def _(bench: Mn400Bench) -> object:
    bench.say("Z")
    told = bench.say("&")
    bench.say("\x04")
    return told, bench.say("R")


@case("baud_reply", {"baudchangeok": "S BC", "plus_done": "S BC D"})
def _(bench: Mn400Bench) -> object:
    return bench.say("~0")


@case("broadcast_setaddr", {"accepted": "S D", "refused": "S PE"})
def _(bench: Mn400Bench) -> object:
    return bench.say("=1", number=0)


@case(
    "reply_transport",
    {"sender": ("S 1,0,0,0", []), "both": ("S 1,0,0,0", ["45 31 2C 30 2C 30 2C 30"])},
)
def _(bench: Mn400Bench) -> object:
    bench.say("L1,0,0,0")
    told = bench.say("E")
    return told, bench.device.take_report(bench.now)


@case("usb_error_form", {"cmd_code": ["58 0E"], "code": ["0E"]})
def _(bench: Mn400Bench) -> object:
    bench.perform(bench.device.send_usb(bench.now, "X3"))
    return bench.device.take_report(bench.now)


@case("usb_outcome_codes", {"true": ["4B 10"], "false": []})
def _(bench: Mn400Bench) -> object:
    bench.perform(bench.device.send_usb(bench.now, "K"))
    return bench.device.take_report(bench.now)


# ---- parameters ----


@case("space_policy", {"error": ("S PE", "IC", "0,0,0,0"), "skip": ("S D", "S 5,0,0,0", "5,0,0,0")})
def _(bench: Mn400Bench) -> object:
    return bench.say("L 5,0,0,0"), bench.say(" E"), bench.value("E")


@case("omitted_param", {"keep": "1,9,3,4", "zero": "0,9,0,0", "error": "1,2,3,4"})
def _(bench: Mn400Bench) -> object:
    bench.say("L1,2,3,4", "L,9")
    return bench.value("E")


@case("extra_params", {"para_error": ("S PE", 0), "ignore": ("S MN400 V 1.08 / 1.04", 5)})
def _(bench: Mn400Bench) -> object:
    told = bench.say("?5")
    bench.say("L5,0,0,0,9")
    return told, bench.peek()[0]


@case("long_max", {"2147483647": "S D", "2147000000": "S PE"})
def _(bench: Mn400Bench) -> object:
    assert bench.say("L2147000000") == "S D"
    return bench.say("L2147483647,0,0,0")


@case("long_min", {"-2147483647": "S PE", "-2147483648": "S D"})
def _(bench: Mn400Bench) -> object:
    assert bench.say("L-2147483647") == "S D"
    return bench.say("L-2147483648,0,0,0")


@case("g_widths", {"16x5": "PE PE", "32x5": "D D", "16x4_32": "PE D"})
def _(bench: Mn400Bench) -> object:
    told = bench.say("G40000,1,1,1,1"), bench.say("G1,1,1,1,40000")
    return " ".join(told).replace("S ", "")


@case("negative_v", {"any": "S D", "minus_one_only": "S PE"})
def _(bench: Mn400Bench) -> object:
    assert bench.say("V-1") == "S D"
    return bench.say("V-5")


@case("speed_range_policy", {"error": ("S PE", "S PE", "S PE"), "clip": ("S D", "S D", "S D")})
def _(bench: Mn400Bench) -> object:
    return bench.say("V1"), bench.say("V100001"), bench.say("F5000,1000,1")


@case("plane_base", {"1": ("S D", "S PE"), "0": ("S PE", "S D")})
def _(bench: Mn400Bench) -> object:
    return bench.say("P4,1"), bench.say("P0,1")


@case(
    "plane_z_check",
    {"at_helix": ("S D", "S PE"), "at_plane": ("S PE", "S D"), "none": ("S D", "S D")},
)
def _(bench: Mn400Bench) -> object:
    return bench.say("P1,2"), bench.say("+20,0,40,0,1,5,1")


@case("abs_mode_value", {"1": 5, "0": 10})
def _(bench: Mn400Bench) -> object:
    return after(bench, 500, "I1", "L5,0,0,0", "M5")[0]


@case("output_on_state", {"0": True, "1": False})
def _(bench: Mn400Bench) -> object:
    bench.say("C1,0")
    assert bench.device.output_at(bench.now, 2) is False
    return bench.device.output_at(bench.now, 1)


@case("measure_other", {"error": "S PE", "plain": "S 0,0,0,0"})
def _(bench: Mn400Bench) -> object:
    return bench.say("E3")


@case("has_feedhold_cmds", {"true": ("S 1,0,0,0,0", "S D"), "false": ("IC", "IC")})
def _(bench: Mn400Bench) -> object:
    return bench.say(":"), bench.say(";0")


# ---- hold and queue ----


@case("hold_bare_arg", {"1": "S MP", "toggle": "S MN400 V 1.08 / 1.04"})
def _(bench: Mn400Bench) -> object:
    return bench.say("H", "H", "M1", "?")


@case("hold_takes_arg", {"true": "S D", "false": "S PE"})
def _(bench: Mn400Bench) -> object:
    return bench.say("H0")


@case("hold_after_release", {"stays_on": "S MP", "one_shot": "S MN400 V 1.08 / 1.04"})
def _(bench: Mn400Bench) -> object:
    return bench.say("H", "M1", "K", "M1", "?")


@case(
    "hold_scope",
    {
        "MA+T)": ("S MP", "S MP", "S MP", "S 0"),
        "M": ("S MP", "S 0", "S 0", "S 0"),
        "MA+T)UJ": ("S MP", "S MP", "S MP", "S MP"),
    },
)
def _(bench: Mn400Bench) -> object:
    told = []
    for line in ("M1", "T1,0,0,0,5", "(", "J1"):
        other = Mn400Bench(hold_scope=str(bench.quirks.hold_scope))
        other.say("H", line)
        if line == "(":
            other.say("M5", ")")
        told.append(other.say("/"))
    return tuple(told)


@case("movepending_exempt", {"K&": "S MP/S MP", "K&Q": "S D/S MP", "K&QH": "S D/S D"})
def _(bench: Mn400Bench) -> object:
    told = bench.say("H", "M1", "Q")
    bench.say("M1")
    return f"{told}/{bench.say('H0')}"


@case("pending_move_reply", {"done": "S D", "movepending": "S MP"})
def _(bench: Mn400Bench) -> object:
    return bench.say("H", "M1")


@case("release_reply", {"done": "S D", "movepending": "S MP"})
def _(bench: Mn400Bench) -> object:
    return bench.say("H", "M1", "K")


@case("queue_modal", {"true": 0, "false": 460})
def _(bench: Mn400Bench) -> object:
    bench.send(packet(1, b"M500") + packet(1, b"L0,0,0,0"))
    bench.wait(1000)
    moved = bench.peek()[0]
    return moved if moved == 0 else 460 if 440 < moved < 500 else moved


@case("queue_depth", {"32": 32, "2": 2, "0": 0})
def _(bench: Mn400Bench) -> object:
    bench.say("M30000")
    told = [bench.say("M1") for _ in range(34)]
    assert told == ["S D"] * told.count("S D") + ["S OV"] * told.count("S OV")
    return told.count("S D")


# ---- read-out ----


@case("limit_status_signed", {"false": "32769", "true": "-32767"})
def _(bench: Mn400Bench) -> object:
    bench.switch("aux_8")
    bench.switch("m1_minus")
    return bench.value("S")


@case("shield_status_sense", {"shield": ("1", "0"), "switch": ("0", "1")})
def _(bench: Mn400Bench) -> object:
    shut = bench.value("[")
    bench.switch("shield")
    assert bench.value(":")[0] == "0"
    return shut, bench.value("[")


@case("abort_flag_clear", {"next_or_clear": ("1", "1"), "read": ("1", "0")})
def _(bench: Mn400Bench) -> object:
    bench.say("M5000", "Q")
    return bench.value(":")[-1], bench.value(":")[-1]


@case("readcount_after_abort", {"kept": True, "zero": False})
def _(bench: Mn400Bench) -> object:
    bench.say("M5000", "Q")
    left = int(bench.value("N").split(",")[0])
    assert left in (0, 5000 - bench.peek()[0])
    return bool(left)


@case("readcount_sign", {"signed": -1, "magnitude": 1})
def _(bench: Mn400Bench) -> object:
    bench.say("M-2000", "{")
    return 1 if int(bench.value("N").split(",")[0]) > 0 else -1


@case("readcount_arc", {"net": 0, "path": 2000})
def _(bench: Mn400Bench) -> object:
    bench.say("V-1", "A500,0,0,0,1")
    left = bench.value("N").split(",")
    return int(left[0])


@case("measure_single_axis", {"zero": 0, "major": 200})
def _(bench: Mn400Bench) -> object:
    bench.say("M20000")
    bench.wait(200)
    return int(bench.value("E1", milliseconds=300).split(",")[4])


@case("measure_position_sample", {"end": 200, "start": 0})
def _(bench: Mn400Bench) -> object:
    bench.say("M20000")
    bench.wait(200)
    before = bench.peek()[0]
    told = int(bench.value("E1", milliseconds=300).split(",")[0])
    return (told - before) // 100 * 100


@case(
    "readprogram_framing",
    {"packet_per_line": "S M1 V5", "single": "S M1 V5"},
)
def _(bench: Mn400Bench) -> object:
    entered(bench, "M1", "V5")
    heard = packets_in(bench.ask(packet(1, b"R")))
    is_single = bench.quirks.readprogram_framing == "single"
    assert len(heard) == (2 if is_single else 3)
    return " ".join(map(in_short, heard))


@case("readprogram_end", {"none": "S M1", "done": "S M1 D", "empty_line": "S M1 "})
def _(bench: Mn400Bench) -> object:
    entered(bench, "M1")
    return bench.say("R")


# ---- stored programs ----


@case("eof_byte", {"04": ("S D", "S PR"), "14": ("S IP", "S D"), "both": ("S D", "S PR")})
def _(bench: Mn400Bench) -> object:
    bench.say("Z")
    return bench.say("\x04"), bench.say("*")


@case("eof_framing", {"packet": (0, "S D"), "raw": (2, "IC"), "both": (2, "IC")})
def _(bench: Mn400Bench) -> object:
    bench.say("Z")
    raw = len(packets_in(bench.ask(b"\x04")))
    return raw, bench.say("\x04")


@case("program_replies", {"false": "", "true": "S 0"})
def _(bench: Mn400Bench) -> object:
    entered(bench, "/")
    return bench.say("U")[4:]


@case("prog_check", {"entry": ("S IP", "S IP", "S"), "run": ("S D", "S D", "S W Z")})
def _(bench: Mn400Bench) -> object:
    bench.say("Z")
    told = bench.say("W"), bench.say("Z")
    bench.say("\x04")
    return *told, bench.say("R")


@case("nvm_size", {"8192": 1, "20": 0})
def _(bench: Mn400Bench) -> object:
    bench.say("Z", "M1,2,3,4,5,6")
    return int(bench.say("M1,2,3,4,5,6") == "S D")


@case("nvm_line_overhead", {"1": 4, "6": 1}, nvm_size=16)
def _(bench: Mn400Bench) -> object:
    bench.say("Z")
    return [bench.say("M1") for _ in range(5)].count("S D") - 1


@case("nvm_commit", {"at_end": "S V5", "per_line": "S M1"})
def _(bench: Mn400Bench) -> object:
    entered(bench, "V5")
    bench.say("Z", "M1")
    bench.power_cycle()
    return bench.say("R")


# ---- power-up ----


@case("power_on_mode", {"relative": 10, "absolute": 5})
def _(bench: Mn400Bench) -> object:
    return after(bench, 500, "L5,0,0,0", "M5")[0]


@case("feedhold_power_on", {"0": "0", "1": "1"})
def _(bench: Mn400Bench) -> object:
    return bench.value(":")[2]


@case("power_on_position", {"0": "0,0,0,0", "-7": "-7,-7,-7,-7"})
def _(bench: Mn400Bench) -> object:
    bench.say("L1,2,3,4")
    bench.power_cycle()
    return bench.value("E")


@case("power_on_outputs", {"off": False, "on": True})
def _(bench: Mn400Bench) -> object:
    return bench.device.output_at(bench.now, 8)


# ---- as the MN100 ----


@case("start_null", {"true": "81 2A 03 00 81 2F", "false": "81 2A 03 81 2F"})
def _(bench: Mn400Bench) -> object:
    start, _ = packets_in(bench.ask(packet(1, b"*")))
    return hexed(start)


@case("motion_done", {"at_once": ("S D", ""), "at_end": ("S", "D")})
def _(bench: Mn400Bench) -> object:
    told = bench.say("M1000")
    return told, " ".join(in_short(raw) for raw in packets_in(bench.wait(1000)))


@case("queue_full_code", {"slavebuffov": "S OV", "busy": "S BY"}, queue_depth=0)
def _(bench: Mn400Bench) -> object:
    bench.say("M1000")
    return bench.say("M1")


@case("mn100_codes", {"false": ("", "", "S PE"), "true": ("ADDR", "NC", "S NA")})
def _(bench: Mn400Bench) -> object:
    heard = [bench.ask(bytes.fromhex(raw), 400) for raw in ("81 2A 82 2D", "81 81 02")]
    told = [" ".join(in_short(raw) for raw in packets_in(data)) for data in heard]
    bench.wait(1000)
    return *told, bench.say("C9,0")


@case("axes", {"4": ("0,0,0,0", "S D"), "2": ("0,0", "S PE"), "1": ("0", "S PE")})
def _(bench: Mn400Bench) -> object:
    return bench.value("E"), bench.say("L1,2,3")


# ---- configuration ----


@case("firmware", {"MN400 V 1.08 / 1.04": "MN400 V 1.08 / 1.04", "MN100 V 2.00": "MN100 V 2.00"})
def _(bench: Mn400Bench) -> object:
    return bench.value("?")


@case("transport", {"auto": True, "rs232": True, "rs485": False})
def _(bench: Mn400Bench) -> object:
    assert bench.say("*") == "S PR"
    return bench.device.is_full_duplex


@case("response_delay_ms", {"1": 1, "20": 20})
def _(bench: Mn400Bench) -> object:
    heard_ns = bench.send(packet(1, b"*"))
    bench.wait(200)
    return (bench.device.sent[0][0] - heard_ns) // NS_PER_MS
