"""What a host sees under each value of each quirk of a controller."""

from msc_bench import (
    ACK,
    CHARACTER_NS,
    F9600,
    NAK,
    REPLY,
    STATUS,
    MscBench,
    bread,
    broken,
    bwrite,
    dread,
    dwrite,
    end_of,
    flag,
    long,
    rflags,
    rqstat,
)
from quirk_cases import Cases

from axistwin.devices.msc.packets import packet
from axistwin.kernel.time import NS_PER_MS
from axistwin.macroprogram import Macroprogram, UserFlag, Variable
from axistwin.programs.bench import Bench
from axistwin.wire.framing import Chunk

CASES: Cases[MscBench] = Cases()
case = CASES.case


def verdict(heard: bytes) -> str:
    """A: ACK alone; N: one NAK; R: ACK and a packet; -: nothing; else the bytes."""
    if heard[:2] == b"\x06\x02" and len(heard) > 8:
        return "R"
    return {ACK: "A", NAK: "N", b"": "-"}.get(heard) or heard.hex()


def run(bench: MscBench, program: type[Macroprogram]) -> None:
    """Have ``program`` running."""
    bench.perform(bench.device.load_program(bench.now, program))
    bench.perform(bench.device.start_program(bench.now))


def first_answer_ms(bench: MscBench, data: bytes, from_last: bool = True) -> int | None:
    """How long behind the last (or first) byte of ``data`` the unit begins to send, ms."""
    start_ns = bench.now
    heard_ns = bench.send(data)
    bench.settle()
    if not bench.sent:
        return None
    return (bench.sent[0][0] - (heard_ns if from_last else start_ns + CHARACTER_NS)) // NS_PER_MS


# ---- time-outs and repeats ----


@case("retransmit_limit", {"5_repeats": (5, 6), "5_total": (4, 5)})
def _(bench: MscBench) -> object:
    bench.tell(dread(8), 100)
    repeats = [bench.tell(NAK, 100) for _ in range(8)]
    assert repeats == [REPLY] * repeats.count(REPLY) + [b""] * repeats.count(b"")
    return repeats.count(REPLY), bench.tell(dread(8), 10_000).count(REPLY)


@case("ack_timeout_action", {"retransmit": (5, "-"), "abandon": (0, "-"), "wait": (0, "again")})
def _(bench: MscBench) -> object:
    bench.tell(dread(8), 100)
    repeats = bench.settle().count(REPLY)
    return repeats, "again" if bench.tell(NAK, 100) == REPLY else "-"


@case("ack_timeout_ms", {"1000": 1000, "77": 77})
def _(bench: MscBench) -> object:
    bench.tell(dread(8), 2000)
    return (bench.sent[2][0] - end_of(bench.sent[1])) // NS_PER_MS


def _time_limits(bench: MscBench) -> tuple[object, ...]:
    """From the STX: with one byte, with a header, with a byte every 300 ms."""
    times = []
    for count in (1, 6):
        start_ns, sent = bench.now, len(bench.sent)
        bench.send(rqstat()[:count])
        bench.settle()
        times.append(bench.sent[sent][0] - start_ns - CHARACTER_NS)
    sent = len(bench.sent)
    for byte in rqstat():
        bench.send(bytes((byte,)))
        bench.wait(300)
    bench.settle()
    return *(time // NS_PER_MS for time in times), bench.sent[sent][1]


@case(
    "packet_timeout_mode",
    {
        "total": (1000, 1000, NAK),
        "interbyte": (1000, 1005, ACK),
        "after_header": (1000, 1005, NAK),
    },
)
def _(bench: MscBench) -> object:
    return _time_limits(bench)


@case("packet_timeout_ms", {"1000": 1000, "300": 300, "1": 1})
def _(bench: MscBench) -> object:
    return first_answer_ms(bench, rqstat()[:3], from_last=False)


# ---- bodies ----


@case("unknown_command", {"nak": "N", "ack_ignore": "A", "silent": "-"})
def _(bench: MscBench) -> object:
    return verdict(bench.tell(packet(1, b"ZZZZZZ,"), 3000))


@case(
    "malformed_body",
    {
        "nak": ("N", "N", "N", "N", 0),
        "ack_ignore": ("A", "A", "A", "A", 0),
        "lenient": ("R", "R", "A", "A", 7),
    },
)
def _(bench: MscBench) -> object:
    answers = [
        verdict(bench.ask(packet(1, b"RQSTAT,\1"))),
        verdict(bench.ask(packet(1, b"DREAD,\0"))),
        verdict(bench.ask(packet(1, b"BWRITE,\0\x08" + long(7) + long(9) + b"\1\2"))),
        verdict(bench.ask(packet(1, b"BWRITE,"))),
    ]
    return *answers, bench.value(8)


@case("rflags_unsupported", {"as_unknown": "N", "ack_no_reply": "A"}, model="msc-850")
def _(bench: MscBench) -> object:
    return verdict(bench.tell(rflags(), 3000))


@case("comma", {"required": "NNNRN", "optional": "RARRR"})
def _(bench: MscBench) -> object:
    bodies = (b"RQSTAT", b"SFLAG\0\xc8", b"RFLAGS", b"RFLAGS,", b"DREAD\0\x08")
    return "".join(verdict(bench.ask(packet(1, body))) for body in bodies)


@case("case_sensitive", {"true": ("N", "N"), "false": ("R", b"RQSTAT,")})
def _(bench: MscBench) -> object:
    heard = bench.ask(packet(1, b"rqstat,"))
    mixed = bench.ask(packet(1, b"RqStat,"))
    return verdict(heard), mixed[7:14] if len(mixed) > 1 else verdict(mixed)


@case("ack_order", {"ack_first": (0, 5), "ack_last": (5, 5)})
def _(bench: MscBench) -> object:
    heard_ns = bench.send(dwrite(8, 5))
    bench.run_until(heard_ns + NS_PER_MS)
    early = bench.device.variable_at(bench.now, 8)
    assert bench.wait(100) == ACK
    return early, bench.device.variable_at(bench.now, 8)


# ---- replies ----


@case(
    "reply_block",
    {
        "zero": ("0000", "0000", "0000", "0000"),
        "echo": ("1234", "4321", "0000", "0000"),
        "counter": ("0001", "0002", "0003", "0004"),
    },
)
def _(bench: MscBench) -> object:
    blocks = [bench.ask(dread(8, block=block))[5:7].hex() for block in (0x1234, 0x4321, 0, 0)]
    bench.tell(dread(8, block=0x1234), 100)
    assert bench.tell(NAK, 100)[4:6] == bench.tell(NAK, 100)[4:6]
    return tuple(blocks)


@case("reply_unit", {"own": 1, "echo": 9}, rs232_unit_check="ignore")
def _(bench: MscBench) -> object:
    return bench.ask(rqstat(9))[2]


@case("rs232_unit_check", {"silent": "---", "nak": "NN-", "ignore": "RR-"})
def _(bench: MscBench) -> object:
    return "".join(verdict(bench.ask(rqstat(unit))) for unit in (2, 15, 16))


@case(
    "invalid_unit",
    {"silent": ("-", "-", "-", 0), "nak": ("N", "N", "N", 0), "broadcast": ("-", "-", "-", 5)},
)
def _(bench: MscBench) -> object:
    answers = [verdict(bench.ask(each)) for each in (dwrite(8, 5, 0), rqstat(16), rqstat(255))]
    return *answers, bench.value(8)


CARRIER = packet(2, (b"BWRITE,\x08\0" + bytes(5) + rqstat()).ljust(137, b"\0"))


@case("other_unit_framing", {"skip_by_length": "-", "hunt_stx": "R"}, units=(1, 3))
def _(bench: MscBench) -> object:
    # Both drive the one pair at first: the host hears only a repeat.
    return "R" if packet(1, b"RQSTAT," + bytes(8)) in bench.tell(CARRIER, 3000) else "-"


@case(
    "overlength",
    {
        "nak_after_packet": ("1000 ms", "N", 249),
        "nak_after_header": ("5 ms", "N", 6),
        "timeout_only": ("1000 ms", "N", 961),
        "accept": ("1000 ms", "R", 256),
    },
    malformed_body="lenient",
)
def _(bench: MscBench) -> object:
    start_ns = bench.now
    bench.send(packet(1, b"?" * 241)[:6])
    bench.settle()
    silent_ms = (bench.sent[0][0] - start_ns - CHARACTER_NS) // NS_PER_MS // 5 * 5
    start_ns, sent = bench.now, len(bench.sent)
    whole = packet(1, b"?" * 241)
    if bench.device.quirks.overlength == "accept":
        whole = packet(1, b"RQSTAT,".ljust(248, b"\0"))
    bench.send(whole)
    bench.settle()
    time_ns = bench.sent[sent][0] - start_ns
    if bench.device.quirks.overlength != "timeout_only":
        time_ns -= 5 * NS_PER_MS
    sign = "R" if bench.sent[sent][1] == ACK else "N"
    silent = "5 ms" if silent_ms < 20 else f"{silent_ms} ms"
    return silent, sign, F9600.characters_within(time_ns)


@case("empty_body", {"as_unknown": "N", "ack": "A"})
def _(bench: MscBench) -> object:
    return verdict(bench.tell(bytes.fromhex("02 01 00 00 00 00 00 01"), 3000))


# ---- the data area ----


@case("data_address_stride", {"4": 4, "2": 2, "1": 1})
def _(bench: MscBench) -> object:
    bench.ask(bwrite(2048, [0x01020304, *range(500, 531)]))
    places = [address for address in range(2049, 2060) if bench.value(address) == 500]
    return places[0] - 2048


@case("data_misaligned", {"overlap": 0x00010000, "nak": "N", "round_down": 1})
def _(bench: MscBench) -> object:
    bench.ask(bwrite(2048, [1, 2] + [0] * 30))
    heard = bench.ask(dread(2050))
    return verdict(heard) if len(heard) == 1 else int.from_bytes(heard[13:17], "big")


@case("data_out_of_range", {"nak": "N5N", "zero": "05R", "wrap": "66R"})
def _(bench: MscBench) -> object:
    bench.ask(dwrite(8, 5))
    bench.ask(dwrite(0x8008, 6))
    heard = bench.ask(dread(0x8008))
    beyond = "N" if heard == NAK else str(heard[-3])
    return f"{beyond}{bench.value(8)}{verdict(bench.ask(bread(0x9000)))}"


@case("block_overrun", {"nak_atomic": ("N", 0, 0), "partial": ("A", 1, 0), "wrap": ("A", 1, 5)})
def _(bench: MscBench) -> object:
    heard = bench.ask(bwrite(0x7FF0, list(range(1, 33))))
    if len(bench.ask(bread(0x7FF0))) == 1:
        assert heard == NAK
    return verdict(heard), bench.value(0x7FF0), bench.value(0)


# ---- flags and status ----


@case("flag_out_of_range", {"nak": ("N", "N"), "off": ("A", 0), "mod256": ("A", 1)})
def _(bench: MscBench) -> object:
    sign = verdict(bench.ask(flag("SFLAG", 456)))
    heard = bench.ask(flag("RFLAG", 456))
    assert bench.is_on(200) is (bench.device.quirks.flag_out_of_range == "mod256")
    return sign, verdict(heard) if len(heard) == 1 else heard[-3]


@case(
    "flag_write_readonly",
    {"ack_ignore": ("A", False, False), "nak": ("N", False, False), "force": ("A", True, False)},
)
def _(bench: MscBench) -> object:
    sign = verdict(bench.ask(flag("SFLAG", 3)))
    forced = bench.is_on(3)
    run(bench, Bench)
    bench.wait(20)
    return sign, forced, bench.is_on(3)


@case("status_spare", {"zeros": (bytes(6), True), "internal": (b"\0\2\0\0\x07\xd8", False)})
def _(bench: MscBench) -> object:
    bench.ask(dread(2008))
    first, second = bench.ask(rqstat())[-8:-2], bench.ask(rqstat())[-8:-2]
    return first, first == second


@case("status_latch", {"level": (0x1042, 0x1042), "clear_on_read": (0x1042, 0x42)})
def _(bench: MscBench) -> object:
    for bit in (1, 6, 12):
        bench.perform(bench.device.set_status(bench.now, bit, on=True))
    return bench.status(), bench.status()


# ---- what comes at the wrong moment ----


@case(
    "stx_while_waiting",
    {"serve": ACK + STATUS, "as_nak": REPLY + REPLY, "ignore": b""},  # its sum has another 02h
    ack_timeout_ms=5000,
)
def _(bench: MscBench) -> object:
    bench.tell(dread(8), 100)
    return bench.tell(rqstat(), 200)


@case(
    "pending_reply_on_stx",
    {"drop": (b"", b""), "keep_if_foreign": (REPLY, b"")},
    ack_timeout_ms=5000,
)
def _(bench: MscBench) -> object:
    """NAK behind a whole packet for another unit; then behind one for this unit."""
    bench.tell(dread(8), 100)
    bench.tell(rqstat(2), 100)
    foreign = bench.tell(NAK, 100)
    bench.tell(rqstat(), 100)
    bench.tell(ACK)
    return foreign, bench.tell(NAK, 100)


@case(
    "junk_while_waiting",
    {"ignore": (b"", REPLY, REPLY), "as_nak": (REPLY, REPLY, REPLY), "abandon": (b"", b"", b"")},
)
def _(bench: MscBench) -> object:
    bench.tell(dread(8), 100)
    at_once = bench.tell(b"\0", 200)
    repeat = bench.tell(NAK, 100)
    return at_once, repeat, bench.wait(960)


@case("stray_nak", {"ignore": [b""] * 6, "resend_last": [REPLY] * 5 + [b""]})
def _(bench: MscBench) -> object:
    bench.tell(NAK, 100)
    bench.ask(dread(8))
    heard = []
    for _ in range(6):
        heard.append(bench.tell(NAK, 100))
        bench.tell(ACK, 50)
    return heard


@case("noise_in_idle", {"ignore": b"", "nak": NAK + NAK})
def _(bench: MscBench) -> object:
    return bench.tell(b"\0\xff\x06", 3000)


@case(
    "timeout_before_unit",
    {"silent_on_rs485": "N-", "silent": "--", "nak": "NN"},
)
def _(bench: MscBench) -> object:
    policy = bench.device.quirks.timeout_before_unit
    on_rs485 = MscBench(5, timeout_before_unit=policy)
    return verdict(bench.tell(b"\x02", 2000)) + verdict(on_rs485.tell(b"\x02", 2000))


@case("stopped_access", {"allow": "RRAR", "nak": "RNNR"})
def _(bench: MscBench) -> object:
    stopped = [bench.ask(each) for each in (rqstat(), dread(8), dwrite(8, 1))]
    run(bench, Bench)
    return "".join(map(verdict, (*stopped, bench.ask(dread(8)))))


@case("loading_access", {"allow": "RRAR", "nak": "RNNR"})
def _(bench: MscBench) -> object:
    bench.perform(bench.device.set_status(bench.now, 10, on=True))
    loading = [bench.ask(each) for each in (rqstat(), dread(8), dwrite(8, 1))]
    bench.perform(bench.device.set_status(bench.now, 10, on=False))
    return "".join(map(verdict, (*loading, bench.ask(dread(8)))))


class CountPulses(Macroprogram):
    """Counts how often it sees flag 200 rise."""

    flag = UserFlag(200)
    count = Variable(400)

    def scan(self) -> None:
        """One scan."""
        if self.flag.rise:
            self.count += 1


@case("write_visibility", {"next_scan": 0, "immediate": 1}, scan_ms=200)
def _(bench: MscBench) -> object:
    run(bench, CountPulses)
    assert bench.tell(flag("SFLAG", 200), 30) + bench.tell(flag("CFLAG", 200), 30) == ACK + ACK
    return bench.value(400)


@case("rs485_mode", {"two_wire": False, "four_wire": True}, units=(2, 3))
def _(bench: MscBench) -> object:
    bench.send(broken(rqstat(2)))
    bench.wait(21)  # its NAK begins in the middle of the next packet
    bench.send(rqstat(3))
    return bench.wait(100)[-23:] == packet(3, b"RQSTAT," + bytes(8))


@case("retransmit_content", {"snapshot": (0, 0), "fresh": (0, 9)})
def _(bench: MscBench) -> object:
    first = bench.tell(dread(8), 100)[1:]
    bench.perform(bench.device.set_variable(bench.now, 8, 9))
    return first[-3], bench.tell(NAK, 100)[-3]


@case("write_reply", {"none": ACK, "empty_packet": ACK + packet(1, b"DWRITE,")})
def _(bench: MscBench) -> object:
    heard = bench.tell(dwrite(8, 5), 100)
    assert (bench.tell(NAK, 100) == b"") is (len(heard) == 1)
    return heard


@case("status_tail", {"6": 15, "4": 13})
def _(bench: MscBench) -> object:
    heard = bench.ask(rqstat())[1:]
    assert len(heard) == 8 + heard[3]
    return heard[3]


@case("rx_while_busy", {"buffer": NAK + NAK, "drop": NAK})
def _(bench: MscBench) -> object:
    return bench.tell(broken(rqstat()) + broken(rqstat()), 900)


@case("reply_delay_ms", {"10": 10, "0": 0, "123": 123})
def _(bench: MscBench) -> object:
    bench.tell(rqstat(), 300)
    return (bench.sent[1][0] - end_of(bench.sent[0])) // NS_PER_MS


@case("timer_flag", {"running": (False, True, False), "expired": (False, False, True)})
def _(bench: MscBench) -> object:
    run(bench, Bench)
    before = bench.is_on(32)
    bench.tell(flag("SFLAG", 243), 60)
    during = bench.device.flag_at(bench.now, 32)
    bench.wait(300)
    return before, during, bench.is_on(32)


@case("bwrite_atomic", {"true": 0, "false": 1})
def _(bench: MscBench) -> object:
    run(bench, Bench)
    for value in range(1, 6):
        assert bench.ask(bwrite(6144 + 128, [value] * 32)) == ACK
        assert bench.value(6144 + 128 + 124) == value
    torn = bench.value(6144 + 12)
    assert torn in (0, 5)
    return torn // 5


@case("uart_error", {"bad_packet": ("N", 5), "use_byte": ("R", None), "drop_byte": ("N", 1000)})
def _(bench: MscBench) -> object:
    raw = rqstat()
    bench.send(raw[:8])
    bench.wait(10)
    bench.perform(bench.device.receive(Chunk(bench.now, raw[8:9], F9600, errors=(0,))))
    bench.wait(2)
    heard_ns = bench.send(raw[9:])
    bench.wait(1500)
    sign = bench.sent[0]
    if sign[1] == ACK:
        return "R", None
    late_ns = sign[0] - heard_ns if sign[0] - heard_ns < 10 * NS_PER_MS else sign[0] - CHARACTER_NS
    return "N", late_ns // NS_PER_MS


# ---- configuration ----


@case("data_size", {"32768": (0x7FFC, "N"), "4096": (0x0FFC, "N"), "65536": (0xFFFC, "N")})
def _(bench: MscBench) -> object:
    size = bench.device.quirks.data_size
    assert verdict(bench.ask(dread(size - 4))) == "R"
    assert verdict(bench.ask(bread(size - 128))) == "R"
    beyond = size if size < 0x10000 else size - 3
    return bench.device.data.end, verdict(bench.ask(dread(beyond)))


@case("response_delay_ms", {"5": 5, "0": 0, "40": 40})
def _(bench: MscBench) -> object:
    return first_answer_ms(bench, rqstat())


@case("turnaround_ms", {"1": 1, "9": 9}, units=(2,), response_delay_ms=0)
def _(bench: MscBench) -> object:
    return first_answer_ms(bench, rqstat(2))


@case("flag_map", {"generic": (False, True), "user:0-7/input:200": (True, False)})
def _(bench: MscBench) -> object:
    for number in (3, 200):
        bench.ask(flag("SFLAG", number))
    return bench.is_on(3), bench.is_on(200)


@case("transport", {"auto": "N", "rs232": "N", "rs485": "-"})
def _(bench: MscBench) -> object:
    return verdict(bench.tell(b"\x02", 2000))


@case("scan_ms", {"10": 50, "25": 20})
def _(bench: MscBench) -> object:
    run(bench, Bench)
    before = bench.device.variable_at(bench.now, 6148)
    bench.wait(500)
    return bench.device.variable_at(bench.now, 6148) - before


@case("self_test_ms", {"0": (0, 0), "300": (128, 0)})
def _(bench: MscBench) -> object:
    bench.network.power_off(0)
    bench.network.power_on(0)
    early = bench.status()
    bench.wait(500)
    return early, bench.status()


@case("auto_start", {"false": (1, 0), "true": (65, 65)})
def _(bench: MscBench) -> object:
    run(bench, Bench)
    running = bench.status()
    bench.network.power_off(0)
    bench.network.power_on(0)
    return running, bench.status()
