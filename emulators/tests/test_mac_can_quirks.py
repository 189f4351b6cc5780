"""Every switch of the MAC23 on CAN: for each value, what a host on the bus sees (ledger §7)."""

from dataclasses import astuple
from typing import Any

import pytest
from can_bench import BIT_NS, CanBench, emergencies
from mac_bench import ACCEPTED, REFUSED, SILENCE, TICK_NS, S
from mac_quirk_motion_cases import CASES as SERIAL_CASES
from quirk_cases import Cases

from axistwin.devices.mac.axis.quirks import QUIRKS, MacQuirks
from axistwin.devices.mac.can.quirks import CAN_QUIRKS, MacCanQuirks, parse_can_quirks
from axistwin.errors import UsageError
from axistwin.kernel.effects import SendFrame, Store
from axistwin.wire.can_frame import wire_bits

CASES: Cases[CanBench] = Cases()
case = CASES.case

READ = "40 00 20 00 00 00 00 00"


def verdict(reply: bytes) -> str:
    """A, R, Q or - for a reply as ``CanBench.ask`` gives it."""
    names = {ACCEPTED: "A", REFUSED: "R", SILENCE: "-"}
    return names.get(reply) or ("Q" if len(reply) == 21 else reply.hex())


# ---- the axis ----

# Three bits of dd that a MAC34 uses are reserved on CAN (ledger §5.1).
case("reserved_bits", {"0": (0, 0x0800), "1": (0x8EF0FF7F, 0xDF9F)})(
    SERIAL_CASES["reserved_bits"][0]
)


# ---- SDO ----


@case("can_byte_order", {"big": (0x40, 0x0A, 0x320), "little": (0, 0, 0x2003)})
def _(bench: CanBench) -> object:
    """The ledger's way to tell, without motion; and the period as 2005h shows it."""
    bench.ask_raw("23 0C 20 00 00 00 00 40")
    torque = bench.ask_raw("40 06 20 00 00 00 00 00")[5]
    bench.ask_raw("23 0E 20 00 00 00 0A 00")
    speeds = bench.ask_raw("40 05 20 00 00 00 00 00")
    return torque, speeds[4], speeds[6] << 8 | speeds[7]


@case("upload_scs", {"42h": "42 00 20 00", "43h": "43 00 20 00"})
def _(bench: CanBench) -> object:
    return bench.ask_raw(READ)[:4].hex(" ")


@case(
    "abort_code_form",
    {
        "zeros": ["00000000"] * 7,
        "code": [
            "08000022",
            "06090030",
            "06020000",
            "06020000",
            "05040001",
            "06090030",
            "08000022",
        ],
    },
)
def _(bench: CanBench) -> object:
    """Locked, out of range, unassigned, outside, other command, zero period, FIFO full."""
    told = []
    bench.do(0x15, 0x320)
    for data in ("23 0D 20 00 00 00 01 00", "23 0C 20 00 00 00 00 FF", "23 12 20 00 00 00 00 00"):
        told.append(bench.ask_raw(data)[4:])
    for data in ("40 00 10 00 00 00 00 00", "22 0C 20 00 00 00 00 40", "23 1E 20 00 00 01 00 00"):
        told.append(bench.ask_raw(data)[4:])
    for _ in range(4):
        reply = bench.ask_raw("23 1E 20 00 FF FF FF FF")
    told.append(reply[4:])
    return [each[::-1].hex() for each in told]


@case("sdo_other_ccs", {"refuse": "RRRRR", "as_23h": "AAAAR", "silence": "-----"})
def _(bench: CanBench) -> object:
    """The expedited ones of CiA 301; the start of a segmented download."""
    names = {0x60: "A", 0x80: "R"}
    told = ""
    for command in (0x22, 0x27, 0x2B, 0x2F, 0x21):
        reply = bench.ask_raw(bytes((command, 0x0C, 0x20, 0, 0, 0, 0, 0x40)))
        told += names[reply[0]] if reply else "-"
    return told


@case(
    "od_outside_20",
    {
        "refuse": ["80", "80", "80", "80", "80"],
        "minimum": ["42 00 10 00 00 00 00 00", "05", "42", "80", "80"],
        "silence": ["", "", "", "", ""],
    },
)
def _(bench: CanBench) -> object:
    """1000h, 1001h with a fault, 1018h sub 0, 1008h, and a write."""
    bench.take(bench.device.set_supply(bench.now, 47_000))
    bench.advance(S)
    read = [
        bench.ask_raw(bytes((0x40, low, 0x10, 0, 0, 0, 0, 0))) for low in (0x00, 0x01, 0x18, 0x08)
    ]
    read.append(bench.ask_raw("23 00 10 00 00 00 00 01"))
    told = [each[:1].hex() for each in read]
    if told[0] == "42":
        told[0], told[1] = read[0].hex(" "), f"{read[1][4]:02X}"
    return told


@case("unknown_index", {"refuse": "RRRR", "accept": "AAQQ", "silence": "----"})
def _(bench: CanBench) -> object:
    """2012h and 2008h written, 2008h and 200Fh read; nothing is done, zeros are read."""
    told = verdict(bench.ask(0x12)) + verdict(bench.ask(0x08, 5))
    replies = [bench.ask(0x28), bench.ask(0x2F)]
    assert all(set(each[9:17]) == {0x30} for each in replies if len(each) == 21)
    assert bench.device.address == 1
    return told + "".join(map(verdict, replies))


@case("subindex_policy", {"ignore": "QA", "refuse": "RR"})
def _(bench: CanBench) -> object:
    return verdict(bench.ask(0x20, sub_index=1)) + verdict(bench.ask(0x19, sub_index=1))


@case("dont_care_digits", {"ignore": "AQAA", "refuse": "RQRR"})
def _(bench: CanBench) -> object:
    """The filler of an upload request never matters (MACC-SDO-07)."""
    asked = ((0x0C, 0xFFFFFF40), (0x20, 1), (0x15, 0x01000320), (0x19, 1))
    return "".join(verdict(bench.ask(*each)) for each in asked)


@case("short_frame", {"ignore": "--", "pad": "4260"})
def _(bench: CanBench) -> object:
    told = [bench.ask_raw("40 00 20 00"), bench.ask_raw("23 19 20")]
    return "".join(each[:1].hex() or "-" for each in told)


@case("imax_value", {"80h": "RA", "FFh": "AA", "40h": "RR"})
def _(bench: CanBench) -> object:
    return verdict(bench.ask(0x0C, 0x81)) + verdict(bench.ask(0x0C, 0x80))


# ---- general message and network ----


@case("general_reply_id", {"581h": "581", "601h": "601"})
def _(bench: CanBench) -> object:
    return bench.say(0x600, READ)[0][:3]


@case("general_upload", {"answer": 1, "ignore": 0})
def _(bench: CanBench) -> object:
    assert len(bench.say(0x600, "23 19 20 00 00 00 00 00")) == 1
    return len(bench.say(0x600, READ))


@case(
    "bootup_form",
    {"heartbeat": "701#00", "emergency_empty": "081#", "heartbeat_empty": "701#"},
)
def _(bench: CanBench) -> object:
    bench.reset()
    return bench.told()[-1]


@case(
    "emcy_payload",
    {
        "cia301_status": ["10 32 05 40 00 00 80 00"] * 2,
        "status_first": ["40 00 00 80 00 00 00 00"] * 2,
        "code_only": ["10 32 05 00 00 00 00 00"] * 2,
        "none": [],
    },
)
def _(bench: CanBench) -> object:
    """The change and the lifebeat that follows it."""
    bench.take(bench.device.set_supply(bench.now, 47_000))
    bench.advance(10 * S)
    return [payload for _, payload in emergencies(bench)]


@case(
    "emcy_code_map",
    {
        "cia301": ["10 32 05", "00 42 09"],
        "40/FF01/81,10/1000/01": ["01 FF 81", "01 FF 81"],
        "10/1000/01": ["00 00 00", "00 10 01"],
    },
)
def _(bench: CanBench) -> object:
    bench.take(bench.device.set_supply(bench.now, 47_000))
    bench.take(bench.device.set_temperature(bench.now, 100_000))
    return [payload[:8].upper() for _, payload in emergencies(bench)]


@case("emcy_on_clear", {"true": 2, "false": 1})
def _(bench: CanBench) -> object:
    bench.take(bench.device.set_supply(bench.now, 11_000))
    bench.take(bench.device.set_supply(bench.now, 24_000))
    return len(emergencies(bench))


@case(
    "emcy_trigger_mask",
    {"FF000000h": ["20"], "FFFFFFFFh": ["00", "20"], "000F0000h": ["00"], "00000000h": []},
    factory_stops=8,
    factory_superior_stop=5,
)
def _(bench: CanBench) -> object:
    """A stop is met (ff), then the supply falls (dd); dd as each message tells it."""
    bench.do(0x13, 50)
    bench.settle()
    bench.take(bench.device.set_supply(bench.now, 11_000))
    return [payload[9:11] for _, payload in emergencies(bench)]


@case("lifebeat_restart", {"own": [14, 24], "any": [18, 28], "free": [10, 20]})
def _(bench: CanBench) -> object:
    """An own request at 4 s, a SYNC at 6 s, a general one at 8 s: whole seconds of the messages."""
    for second, identifier, data in ((4, 0x601, READ), (6, 0x080, ""), (8, 0x600, READ)):
        bench.run_until(second * S)
        bench.say(identifier, data)
    bench.run_until(29 * S)
    return [at // S for at, _ in emergencies(bench)]


@case("sync_dlc", {"any": ("PO", "PO"), "empty": ("OF+PL", "PO")})
def _(bench: CanBench) -> object:
    bench.do(0x10)
    bench.do(0x13, 100_000)
    bench.say(0x080, "05")
    after_data = bench.state()
    bench.say(0x080)
    return after_data, bench.state()


@case("nmt_supported", {"false": "QQQQA-", "true": "-Q-QA-"})
def _(bench: CanBench) -> object:
    """Stopped, pre-operational, started by number; SYNC when stopped; a reset of all."""
    bench.do(0x10)
    bench.do(0x13, 100_000)
    supported = bench.device.quirks.nmt_supported
    told = ""
    for data in ("02 01", "80 00", "02 00", "01 01"):
        bench.say(0x000, data)
        told += verdict(bench.ask(0x20))
        if data == "02 01" and supported:
            bench.say(0x080)
            assert bench.state() == "OF+PL"
    bench.say(0x000, "02 02")
    told += verdict(bench.ask(0x19))
    for data in ("81 00", "82 01"):
        bench.say(0x000, "02 00")
        bench.say(0x000, data)
        assert bench.state() == ("BT" if supported else "HD+PL")
        bench.advance(3 * S)
    return told + ("-" if bench.ask(0x12) == REFUSED else "?")


# ---- address procedure ----


@case("lmt_dlc", {"8": "7E4#1100000000000000", "7": "7E4#11000000000000"})
def _(bench: CanBench) -> object:
    bench.say(0x7E5, "04 01")
    return bench.say(0x7E5, "11 05")[0]


@case(
    "lmt_error_reply",
    {"01": ["7E4#1101000000000000"], "FF": ["7E4#11FF000000000000"], "silence": []},
)
def _(bench: CanBench) -> object:
    bench.say(0x7E5, "04 01")
    return bench.say(0x7E5, "11 80")


@case("lmt_incomplete", {"ignore": ("OF", "OF"), "bootup": ("BT", "BT")})
def _(bench: CanBench) -> object:
    """04 00 alone, and without an address in between; the address stays."""
    bench.say(0x7E5, "04 00")
    alone = bench.state()
    bench.advance(3 * S)
    bench.say(0x7E5, "04 01")
    bench.say(0x7E5, "04 00")
    assert bench.device.address == 1
    return alone, bench.state()


@case("lmt_sdo", {"served": "QQ", "ignored": "-Q"})
def _(bench: CanBench) -> object:
    bench.say(0x7E5, "04 01")
    told = verdict(bench.ask(0x20))
    bench.say(0x7E5, "04 00")
    return told + verdict(bench.ask(0x20))


@case(
    "lmt_other",
    {"ignored": ([], [], [], 9), "cia305": (["7E4#5E01"], ["7E4#5A00"], ["7E4#1700"], 1)},
)
def _(bench: CanBench) -> object:
    """Inquiries at rest, 17h in configuration mode; the address after a power cycle without 17h."""
    told = []
    for data in ("5E", "5A", "17"):
        if data == "17":
            bench.say(0x7E5, "04 01")
        told.append([each[:8] for each in bench.say(0x7E5, f"{data} 00 00 00 00 00 00 00")])
    bench.say(0x7E5, "11 09")
    bench.say(0x7E5, "04 00")
    bench.advance(3 * S)
    assert bench.device.address == 9
    bench.power_cycle()
    return *told, bench.device.address


def test_a_stored_address_of_the_305_reading_stays() -> None:
    """17h between 11 and 04 00; what identifies a device reads zeros (MACC-AMB-12)."""
    bench = CanBench(lmt_other="cia305")
    for data in ("5A", "5B", "5C", "5D"):
        assert bench.say(0x7E5, f"{data} 00") == [f"7E4#{data}00000000000000"]
    assert bench.say(0x7E5, "17 00") == bench.say(0x7E5, "59 00") == []
    bench.say(0x7E5, "04 01")
    bench.say(0x7E5, "11 09")
    count = len(bench.effects)
    bench.say(0x7E5, "17 00")
    assert [type(effect) for effect in bench.effects[count:]] == [Store, SendFrame]
    bench.say(0x7E5, "04 00")
    bench.advance(3 * S)
    bench.power_cycle()
    assert bench.device.address == 9


# ---- start-up, synchronous mode, faults ----


@case("reset_reply", {"ack": "A-A-", "silence": "----"})
def _(bench: CanBench) -> object:
    told = verdict(bench.ask(0x00)) + verdict(bench.ask(0x20))
    bench.advance(2 * S)
    assert bench.told()[-1] == "701#00"
    return told + verdict(bench.ask(0x01)) + verdict(bench.ask(0x20))


@case("boot_time_ms", {"2000": 2 * S, "500": S // 2, "0": 0})
def _(bench: CanBench) -> object:
    bench.do(0x00)
    start, reply = next(each for each in bench.frames if each[1].identifier == 0x581)
    bench.advance(2 * S)
    return bench.frames[-1][0] - (start + wire_bits(reply) * BIT_NS)


@case("factory_reset_scope", {"restart": ("-", "701#00"), "no_restart": ("Q", "581#4200")})
def _(bench: CanBench) -> object:
    bench.do(0x0D, 0x1000)
    bench.do(0x01)
    told = verdict(bench.ask(0x20))
    bench.advance(2 * S)
    last = bench.told()[-1][:8]
    assert bench.read(0x25) & 0xFFFF == 0x320
    return told, last[:6] if last.startswith("7") else last


@case(
    "sync_arm_lifetime",
    {"kept": ("VE+AR", "PO"), "lost": ("VE", "PO"), "permanent": ("VE+AR", "HD+PL")},
)
def _(bench: CanBench) -> object:
    """10h in motion; then at rest 10h 13h SYNC 13h: does the second one move?"""
    bench.do(0x15, 0x320)
    bench.do(0x10)
    armed = bench.state()
    bench.do(0x18)
    bench.do(0x0B)
    bench.do(0x10)
    bench.do(0x13, 10)
    bench.say(0x080)
    bench.settle()
    bench.do(0x13, 100_000)
    return armed, bench.state()


@case("fault_ack_while_present", {"returns": "AR", "refuse": "RA"})
def _(bench: CanBench) -> object:
    """2000h while it is hot; then when it is cool, or 13h after the useless restart."""
    bench.take(bench.device.set_temperature(bench.now, 100_000))
    told = verdict(bench.ask(0x00))
    bench.advance(3 * S)
    if told == "A":
        return told + verdict(bench.ask(0x13, 5))
    bench.take(bench.device.set_temperature(bench.now, 25_000))
    return told + verdict(bench.ask(0x00))


@pytest.mark.parametrize(
    ("data", "code"),
    [
        ("23 02 20 00 00 00 00 02", "06090030"),
        ("23 03 20 00 00 00 00 02", "06090030"),
        ("23 07 20 00 00 00 00 02", "06090030"),
        ("23 0C 20 00 00 00 00 81", "06090030"),
        ("23 0D 20 00 00 00 00 00", "06090030"),
        ("23 13 20 00 40 00 00 00", "06090030"),
        ("23 16 20 00 00 05 00 00", "06090030"),
        ("23 11 20 00 00 00 00 00", "08000022"),
        ("23 08 10 00 00 00 00 00", "06020000"),
        ("23 01 10 00 00 00 00 00", "06010002"),
        ("23 18 10 01 00 00 00 00", "06010002"),
        ("40 18 10 02 00 00 00 00", "06020000"),
        ("40 00 20 01 00 00 00 00", "06090011"),
        ("40 0F 20 00 00 00 00 00", "06020000"),
        ("41 00 20 00 00 00 00 00", "05040001"),
    ],
)
def test_abort_codes_say_why(data: str, code: str) -> None:
    """As CiA 301 has them, low byte first."""
    bench = CanBench(
        abort_code_form="code",
        sync_without_preload="refuse",
        od_outside_20="minimum",
        subindex_policy="refuse",
    )
    reply = bench.ask_raw(data)
    assert reply[:4] == b"\x80" + bytes.fromhex(data)[1:4]
    assert reply[4:][::-1].hex() == code


@pytest.mark.parametrize(
    ("quirk", "data"),
    [
        ("catchup_low_byte", "23 0E 20 00 00 00 05 01"),
        ("dont_care_digits", "23 0E 20 00 00 01 05 00"),
    ],
)
def test_a_refused_catch_up_has_its_abort_code(quirk: str, data: str) -> None:
    """200Eh, where a reading of the manual refuses it."""
    settings: dict[str, Any] = {"abort_code_form": "code", quirk: "refuse"}
    bench = CanBench(**settings)
    assert bench.ask_raw(data)[4:][::-1].hex() == "06090030"


@pytest.mark.parametrize(
    ("download", "upload"),
    [
        ("0C 20 00 40 00 00 00", "06 20 00 0A 40 10 00"),
        ("1C 20 00 07 00 00 00", "06 20 00 0A 60 10 07"),
        ("09 20 00 78 56 34 12", "02 20 00 78 56 34 12"),
        ("0A 20 00 FE FF FF FF", "03 20 00 FE FF FF FF"),
        ("0D 20 00 00 00 34 12", "05 20 00 05 00 34 12"),
        ("0E 20 00 00 00 00 0A", "05 20 00 0A 00 20 03"),
        ("19 20 00 00 00 00 00", "04 20 00 00 00 07 04"),
        ("19 20 00 00 00 00 00", "07 20 00 60 35 08 00"),
        ("19 20 00 00 00 00 00", "01 20 00 20 00 00 00"),
    ],
)
def test_little_endian_words_and_longs(download: str, upload: str) -> None:
    """Each field turned in its place; bytes stay where they are (MACC-AMB-01)."""
    bench = CanBench(can_byte_order="little")
    bench.take(bench.device.set_supply(bench.now, 11_000))
    assert bench.ask_raw(f"23 {download}")[0] == 0x60
    assert bench.ask_raw(f"40 {upload[:8]} 00 00 00 00").hex(" ").upper() == f"42 {upload}"


@pytest.mark.parametrize(
    ("data", "position"),
    [("16 20 00 05 00 00 01", 5), ("15 20 00 00 F6 00 40", -1), ("13 20 00 09 00 00 00", 9)],
)
def test_little_endian_motions(data: str, position: int) -> None:
    """DDDD and VVVV of 2016h, VVVV of 2015h behind SS, the target of 2013h."""
    bench = CanBench(can_byte_order="little", factory_ramp=0)
    assert bench.ask_raw(f"23 {data}")[0] == 0x60
    if data.startswith("15"):
        bench.run_until(bench.etx_ns + 0x6000 * TICK_NS)  # one step and a half
    else:
        bench.settle()
    assert bench.device.position_at(bench.now) == position


# ---- the tests ----

SHARED = sorted(CAN_QUIRKS.keys() - CASES.keys())


@pytest.mark.parametrize(("name", "value"), CASES.played())
def test_each_value_of_each_switch_of_can_shows_on_the_bus(name: str, value: str) -> None:
    """The scenario of the switch ends as the reading says."""
    scenario, seen, base = CASES[name]
    assert scenario(CanBench(**{**base, name: value})) == seen[value]


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name in SHARED for value in SERIAL_CASES[name][1]]
)
def test_shared_switches_show_the_same_on_both_faces(name: str, value: str) -> None:
    """One axis: the scenario of the serial face, asked over SDO, ends as it does there."""
    scenario, seen, base = SERIAL_CASES[name]
    assert scenario(CanBench(**{**base, name: value})) == seen[value]


def test_every_switch_of_can_has_a_case_with_all_its_values() -> None:
    """Its own, or the one it shares; of numbers and texts at least two values."""
    for name, quirk in CAN_QUIRKS.items():
        values = list((CASES.get(name) or SERIAL_CASES[name])[1])
        assert values[0] == quirk.default, name
        if quirk.kind in ("choice", "bool"):
            assert set(quirk.allowed) == set(values), name
        else:
            assert len(values) >= 2, name


def test_every_doubt_of_the_ledger_is_a_switch_or_has_one_reading() -> None:
    """MACC-AMB-01..32; the bit rate is the bus's."""
    switches = {quirk.source for quirk in CAN_QUIRKS.values()}
    one_reading = {2, 21, 23, 30}
    expected = {f"MACC-AMB-{number:02}" for number in range(1, 33) if number not in one_reading}
    assert {source for source in switches if source.startswith("MACC-AMB")} == expected


def test_switches_of_bytes_and_rates_belong_to_the_serial_face_alone() -> None:
    """What a bus cannot show is no switch of CAN, and the other way round."""
    assert not {"xon_byte", "mem_wrap", "baud_reply_rate", "mac34_limits"} & CAN_QUIRKS.keys()
    assert not {"upload_scs", "lmt_dlc", "bootup_form"} & QUIRKS.keys()
    assert {"factory_ramp", "motion_lock_set", "boot_time_ms"} <= CAN_QUIRKS.keys() & QUIRKS.keys()


def test_the_defaults_of_shared_switches_are_the_same_on_both_faces() -> None:
    """One reading of one manual family."""
    serial, can = MacQuirks(), MacCanQuirks()
    for name in QUIRKS.keys() & CAN_QUIRKS.keys():
        assert getattr(serial, name) == getattr(can, name), name
        assert QUIRKS[name].default == CAN_QUIRKS[name].default, name


def test_defaults_parse_to_the_default_settings() -> None:
    """What the program lists as default is the default."""
    defaults = {name: quirk.default for name, quirk in CAN_QUIRKS.items()}
    assert astuple(parse_can_quirks(defaults)) == astuple(MacCanQuirks())


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("xon_byte", "1Ah", "unknown quirk 'xon_byte'"),
        ("upload_scs", "44h", "allowed: 42h, 43h"),
        ("lmt_dlc", "6", "allowed: 8, 7"),
        ("emcy_payload", "cia301", "did you mean cia301_status"),
        ("emcy_code_map", "10/42000/09", "BITS/CODE/REGISTER"),
        ("emcy_code_map", "10/4200/09;", "BITS/CODE/REGISTER"),
        ("emcy_code_map", "", "BITS/CODE/REGISTER"),
        ("emcy_trigger_mask", "100000000h", "FFFFFFFFh"),
        ("sync_arm_lifetime", "for ever", "allowed: kept, lost, permanent"),
    ],
)
def test_a_mistake_is_one_line_with_the_allowed_values(name: str, value: str, words: str) -> None:
    """UsageError naming value, allowed range and remedy."""
    with pytest.raises(UsageError, match=words) as told:
        parse_can_quirks({name: value})
    assert "\n" not in str(told.value)
