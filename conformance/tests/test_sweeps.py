"""The sweeps: what they draw, how it is planted, and a sample of each."""

from __future__ import annotations

import itertools
import json
import os
import random
import sys
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import parse_qsl

import pytest
import serial
from quirk_twins import quirks_query
from sweeping import real_runs, sweeps, wrong_device
from sweeping.faults import PARTS, Fault, When, draw_fault
from sweeping.formats import FORMATS, MacSerialFormat
from sweeping.journal import Journal, run_all
from sweeping.readings import FIXED, drawn, go_together, misread, pooled, singles, unread
from sweeping.runs import LONGEST_S, Row, Setting
from sweeping.sweeps import MODELS, FaultSweep, QuirkSweep
from sweeping.wrong_device import Tally, functions, planted
from zoo.judge import Overrun, limited

from axistwin.catalog import models
from axistwin.cli.program import EXIT_BUG
from axistwin_conformance.families.msc import codec

MAC = bytes.fromhex("02 30 31 34 30 30 31 35 30 30 30 30 30 30 30 33 32 30 41 42 03")
ANSWER = bytes.fromhex("06 13 02 30 31 31 30 30 30 30 30 30 30 30 30 30 30 31 30 03 1A")
SDO = bytes.fromhex("06 01 23 16 20 00 03 E8 10 00")
DWRITE = bytes.fromhex("02 01 00 0D 00 00 44 57 52 49 54 45 2C 07 D8 00 00 04 D2 03 BE")
# Of seed 1: bytes, values, order and effects of commands, and what is wrong inside.
SAMPLE = [
    ("mac23", 3), ("mac23", 9), ("mac23-can", 4), ("mac23-can", 6), ("msc-250", 7), ("msc-250", 9),
]  # fmt: skip
# Devices that were taken for a noisy line,
NOISY = [
    ("mac23-can", Fault("effect", "that of d10", ("d13",))),
    ("msc-250", Fault("reply", "longer", ("DREAD",), When(every=3), amount=3)),
    ("msc-250", Fault("reply", "broken by a pause", amount=600_000_000)),
]
# or for no module at all.
UNKNOWN = [
    Fault("byte of a reply", "bits flipped", at=0, amount=0x80),
    Fault("byte of a reply", "bits flipped", at=17, amount=0xFF),
    Fault("effect", "refused", FORMATS["mac23"].commands),
    Fault("effect", "none, no reply", FORMATS["mac23"].commands, When(first=5)),
]
# What escaped: a byte behind the replies to one command; what is wrong in some attempts only; a
# module that restarts by itself, which was lost before anything was judged; a temperature that is
# told wrongly once it was judged; and a move that begins again, though it was stopped.
ONCE_ESCAPED = [
    ("mac23", "full", Fault("reply", "longer", ("1E",), amount=1)),
    ("mac23", "full", Fault("reply", "longer", ("23",), amount=1)),
    ("mac23", "full", Fault("effect", "late", ("09",), When(every=7), amount=30_000_000)),
    ("mac23", "quick", Fault("state", "lost", FORMATS["mac23"].commands, When(first=50, every=40))),
    ("mac23", "quick", Fault("state", "lost", (), When(first=50, every=40))),
    ("mac23-can", "quick", Fault("state", "lost", (), When(first=10, every=7))),
    ("mac23-can", "quick", Fault("byte of a reply", "doubled", at=3)),
    ("mac23-can", "quick", Fault("value of an answer", "twice", ("u07",), When(first=200), size=1)),
    ("mac23-can", "full", Fault("effect", "twice", ("d14",), amount=30_000_000)),
    (
        "mac23-can",
        "full",
        Fault("byte of a reply", "bits flipped", ("d02",), When(every=7), at=7, amount=2),
    ),
]
# What led out again and again: whatever was sent to stop it, or to put things back, moved it; or
# its counter did not show that it moved.
LED_OUT = [
    ("mac23", "Plant.position_at", "caught"),
    ("mac23", Fault("value that is understood", "its negative", MacSerialFormat.commands,
                    size=4, above=0x10000), "strayed"),
    ("mac23-can", Fault("effect", "that of d15", ("d02",), When(every=7)), "strayed"),
    ("mac23-can", Fault("reply", "that of the one before"), "caught"),
    ("mac23", Fault("value of an answer", "all ones", MacSerialFormat.queries, at=2, size=2),
     "caught"),
]  # fmt: skip
TICKS = 6148  # a variable of the bench program, one more in every scan
EXAMPLES = [
    ("mac23", MAC, "15", "00000320"), ("mac23-can", SDO, "d16", "03E81000"),
    ("msc-250", DWRITE, "DWRITE", "07D8000004D2"),
]  # fmt: skip


@pytest.mark.parametrize(("model", "message", "kind", "values"), EXAMPLES)
def test_the_manuals_examples_are_taken_apart_and_put_together_again(
    model: str, message: bytes, kind: str, values: str
) -> None:
    """Kind, values, and the sum that goes with others."""
    form = FORMATS[model]
    assert form.kind(message) == kind
    assert form.values(message).hex().upper() == values
    assert form.with_values(message, form.values(message)) == message
    assert form.with_kind(message, kind) == message
    other = form.with_values(message, bytes(len(values) // 2))
    assert form.resummed(other) == other
    assert form.resummed(other[:-2] + b"\0" + other[-1:]) == other or model == "mac23-can"


def test_an_answer_has_its_sum_where_the_ledger_says() -> None:
    """Ten characters on, it is the same answer of another position."""
    form = FORMATS["mac23"]
    assert form.with_values(ANSWER, bytes.fromhex("00000010"))[17:19] == b"11"
    assert form.resummed(ANSWER) == ANSWER


@pytest.mark.parametrize(
    ("how", "number", "changed"),
    [("its negative", 1, 0xFFFFFFFF), ("sign and magnitude", 0xFFFFFFFF, 0x80000001),
     ("at most 16 bits", 0x12345, 0x7FFF), ("16 bits and their sign", 0x18000, 0xFFFF8000),
     ("bytes reversed", 1, 0x01000000), ("a tenth more", 0xFFFFFFF6, 0xFFFFFFF5)],
)  # fmt: skip
def test_a_number_is_changed_as_its_name_says(how: str, number: int, changed: int) -> None:
    """At its width."""
    fault = Fault("value of an answer", how)
    assert fault.changed(number.to_bytes(4)) == changed.to_bytes(4)


@pytest.mark.parametrize(
    ("kind", "values", "others", "is_other"),
    [("CFLAG", "0080", "0081", True), ("CFLAG", "00800000", "FF800000", False),
     ("SFLAG", "0100", "FF00", False), ("SFLAG", "0100", "00FF", True),
     ("DWRITE", "07D8000004D2", "07D8000004D3", True), ("DWRITE", "07D804D2", "07D804D3", False)],
)  # fmt: skip
def test_what_is_refused_either_way_means_nothing_else(
    kind: str, values: str, others: str, is_other: bool
) -> None:
    """A command of another size, or of a flag that does not exist, shows no host what it said."""
    means_other = FORMATS["msc-250"].means_other
    assert means_other(kind, bytes.fromhex(values), bytes.fromhex(others)) is is_other


@pytest.mark.parametrize("model", FORMATS)
def test_the_same_seed_is_the_same_devices(model: str) -> None:
    """And they are of every part, and none is drawn twice over."""
    faults = [draw_fault(FORMATS[model], f"7/{number}") for number in range(400)]
    assert faults == [draw_fault(FORMATS[model], f"7/{number}") for number in range(400)]
    assert {one.part for one in faults} >= PARTS.keys() - {"other effect"}
    assert len(set(faults)) > 350
    pairs = list(itertools.islice(drawn(model, "7"), 50))
    assert pairs == list(itertools.islice(drawn(model, "7"), 50))
    assert {len(one) for one in pairs} == {1, 2}


@pytest.mark.parametrize("model", MODELS)
def test_pools_hold_every_value_of_every_switch_once(model: str) -> None:
    """And no switch twice, and no pool is larger than was asked for."""
    waiting = [item for one in singles(model, "7") for item in one.items()]
    pools = pooled(model, "7", 8)
    while waiting:
        pool = next(pools)
        assert 0 < len(pool) <= 8
        for item in pool.items():
            waiting.remove(item)


@pytest.mark.parametrize("model", MODELS)
def test_a_drawn_value_comes_to_the_twin_as_it_was_drawn(model: str) -> None:
    """Also one with characters that mean something in a URL."""
    for readings in singles(model, "7"):
        assert parse_qsl(quirks_query(readings)[1:]) == [
            (f"quirk.{name}", value) for name, value in readings.items()
        ]


def test_counters_that_no_host_can_load_are_not_drawn() -> None:
    """Neither in pools nor in pairs: they are never put back."""
    assert not go_together({"power_on_position": "-2147483647", "long_min": "-2147000000"})
    assert not go_together({"power_on_position": "2147483647", "long_max": "2147483646"})
    assert go_together({"power_on_position": "2147483647", "long_min": "-2147000000"})
    assert all(map(go_together, itertools.islice(pooled("mn400", "7", 16), 22)))


@pytest.mark.parametrize("model", FORMATS)
def test_every_drawn_value_is_one_that_the_twin_takes(model: str) -> None:
    """No draw is a mistake of the draw's own, and no switch is left out without a reason."""
    quirks = models()[model].quirks
    known = singles(model, "3")
    for readings in known:
        for name, value in readings.items():
            assert quirks[name].parse(value) != quirks[name].parse(quirks[name].default)
    left = quirks.keys() - {name for one in known for name in one}
    assert all(quirks[name].kind == "text" or name in FIXED[model] for name in left), left


def test_when_says_which_messages_are_hit() -> None:
    """Each one, one in three, from a number on."""
    assert [When().is_due(number) for number in range(3)] == [True] * 3
    assert [n for n in range(9) if When(every=3).is_due(n)] == [2, 5, 8]
    assert [n for n in range(9) if When(first=7).is_due(n)] == [7, 8]


def test_a_fault_inside_reaches_the_tables_too() -> None:
    """A method that a table of the twin holds is wrong there as well, and right afterwards."""
    from axistwin.devices.mac.axis import axis

    known = functions("mac23")
    at = next(n for n, one in enumerate(known) if one[1] == "_read_superior_stop")
    right = axis._QUERIES[2]
    with planted(Fault("inside", "one more", at=at), "mac23", Tally()) as place:
        assert place == "Axis._read_superior_stop"
        assert axis._QUERIES[2] is not right
        assert axis._QUERIES[2] is axis.Axis._read_superior_stop
    assert axis._QUERIES[2] is right


@pytest.mark.parametrize(("how", "states"), [("none", [0, 0]), ("late", [0, 1])])
def test_an_effect_is_missing_beside_a_program_that_runs(how: str, states: list[int]) -> None:
    """SFLAG is acknowledged, and the twin is no crashed one: its program goes on."""
    tally = Tally()
    with planted(Fault("effect", how, ("SFLAG",), amount=300_000_000), "msc-250", tally):
        port = serial.serial_for_url("axistwin://msc-250?time=virtual&program=bench", timeout=0.2)
        replies = [
            _asked(port, body)
            for body in (codec.dread(TICKS), codec.sflag(200), *[codec.rflag(200)] * 2)
        ]
        ticks = codec.parse(_asked(port, codec.dread(TICKS))[1:])
    before, _, *flags = [codec.parse(reply.removeprefix(codec.ACK)) for reply in replies]
    assert replies[1] == codec.ACK
    assert [flag and flag.numbers[0] for flag in flags] == states
    assert before
    assert ticks
    assert ticks.values[0] > before.values[0] + 10
    assert not tally.crash


def _asked(port: serial.SerialBase, body: bytes) -> bytes:
    """What comes within 200 ms of a command, which is acknowledged."""
    port.write(codec.packet(1, body))
    reply: bytes = port.read(100)
    port.write(codec.ACK)
    return reply


def test_a_reading_is_misread_only_if_what_is_told_excludes_it() -> None:
    """Silence is no mistake, and one of several is right; a measured number may be near."""
    truth = {"boot_time_ms": "1700", "xon_byte": "11h"}
    told = {
        "boot_time_ms": ["1702", []], "xon_byte": ["1Ah", []], "step_phase": [None, []],
        "ramp_law": [None, ["equal_increments", "equal_time"]],
    }  # fmt: skip
    row = {"detected": told, "named": {}}
    assert misread("mac23", truth, row) == {"xon_byte": "1Ah told, 11h is so"}
    truth |= {"step_phase": "any", "ramp_law": "equal_time"}
    assert unread("mac23", truth, row) == ("step_phase",)


def test_why_a_reading_is_not_told_is_in_the_row() -> None:
    """What no wire can show is told from what a probe has missed."""
    row = {
        "hang": "", "errors": [], "failed": [], "status": 0, "problems": [], "judged": [],
        "open": {}, "named": {}, "detected": {"power_on_at_boot": [None, []]},
        "untold": {"power_on_at_boot": "nothing on the line tells"},
    }  # fmt: skip
    sweep = QuirkSweep(Setting("mac23", "virtual", "quick", 300), seed=1)
    outcome = sweep._outcome({"power_on_at_boot": "true"}, row)
    assert outcome == ("unread", "power_on_at_boot: nothing on the line tells")


def test_no_module_refuses_the_torque_that_it_has() -> None:
    """Its own, or the highest one: a host could not put that back."""
    assert not go_together({"torque_range": "exclusive", "factory_torque": "128"})
    assert not go_together({"torque_range": "exclusive", "imax_value": "96"})
    assert go_together({"torque_range": "exclusive", "factory_torque": "127"})
    assert go_together({"factory_torque": "255"})


def test_hold_that_never_goes_off_is_not_drawn() -> None:
    """Without a parameter of H, another reading must end it."""
    assert not go_together({"hold_takes_arg": "false"})
    assert go_together({"hold_takes_arg": "false", "hold_bare_arg": "toggle"})
    assert {"hold_takes_arg": "false"} not in singles("mn400", "7")


def test_a_ramp_of_an_axis_that_halts_alone_is_not_drawn() -> None:
    """It halts at once: nothing on the wire could tell it."""
    assert not go_together({"limit_halts": "axis", "limit_ramp": "true"})
    assert go_together({"limit_halts": "all", "limit_ramp": "true"})


def test_what_is_of_rs232_alone_is_not_drawn_on_rs485() -> None:
    """Nothing on the wire could tell it."""
    assert not go_together({"transport": "rs485", "rs232_unit_check": "nak"})
    assert go_together({"transport": "rs232", "rs232_unit_check": "nak"})


def test_a_data_area_ends_with_a_whole_variable() -> None:
    """An odd address is no variable's."""
    sizes = [one["data_size"] for one in singles("msc-250", "7") if "data_size" in one]
    assert sizes
    assert all(int(size) % 2 == 0 for size in sizes)


def test_the_table_counts_each_pair_of_readings_once() -> None:
    """And only those of devices that were judged as they are."""
    sweep = QuirkSweep(Setting("mac23", "virtual", "quick", 300), seed=1)
    rows = [
        {"outcome": outcome, "readings": dict(word.split("=") for word in words.split())}
        for outcome, words in (
            ("sound", "a=1 b=1 c=1"), ("unread", "b=1 a=1"), ("sound", "a=1 b=2"),
            ("failed", "a=9 b=9"), ("sound", ""),
        )
    ]  # fmt: skip
    told = "rightly judged: 4 readings, 4 pairs of readings, 3 pairs of switches"
    assert told in sweep.table(rows)


def test_no_device_without_torque_has_inertia() -> None:
    """Each by itself is drawn, and any other torque beside inertia."""
    inert, powerless = {"plant": "inertial"}, {"factory_torque": "0"}
    assert not go_together({**inert, **powerless, "xon_byte": "11h"})
    assert go_together({**inert, "factory_torque": "64"})
    assert go_together(powerless)


@pytest.mark.system
def test_a_sweep_goes_on_where_it_was_ended(tmp_path: Path) -> None:
    """What is in the file is not done again; who takes for ever, and who dies, is a row too."""

    def judge(number: int) -> dict[str, object]:
        if number == 2:
            while True:
                random.random()
        if number == 3:
            os._exit(1)
        return {"outcome": "sound", "hang": ""}

    journal = Journal(tmp_path / "rows" / "x.jsonl")
    run_all([1, 2, 3], judge, journal.add, jobs=3, limit_s=0.2)
    again = Journal(tmp_path / "rows" / "x.jsonl")
    assert again.rows == journal.rows
    assert again.rows[1]["outcome"] == "sound"
    assert again.rows[2]["hang"]
    assert again.rows[3]["hang"]
    assert [json.loads(line)["number"] for line in again.path.read_text().splitlines()]


@pytest.mark.strength
def test_a_twin_whose_fault_makes_it_turn_on_the_spot_is_no_device(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One that plans the same instant for ever is given up, and is dead from then on."""

    def turn(*given: object) -> list[object]:
        while True:
            random.random()

    monkeypatch.setattr(wrong_device, "LIMIT_S", 0.2)
    device = object.__new__(wrong_device.WrongDevice)
    device._tally = Tally()
    with pytest.raises(RuntimeError, match="never comes to an end"):
        device._guarded(turn)
    assert device._tally.crash == "never comes to an end"
    assert device._guarded(turn) == []
    assert device.next_event() is None


@pytest.mark.strength
@pytest.mark.parametrize("look", ["cells", "is_moving", "describe"])
def test_a_twin_that_turns_on_the_spot_while_it_is_looked_at_is_no_device(
    monkeypatch: pytest.MonkeyPatch, look: str
) -> None:
    """Who reads what it keeps lets it come up to the present, where it may never arrive."""

    def turn(now: int) -> None:
        while True:
            random.random()

    monkeypatch.setattr(wrong_device, "LIMIT_S", 0.2)
    inner = SimpleNamespace(**{look: turn})
    tally = Tally()
    device = wrong_device.WrongDevice(inner, Fault("none", ""), FORMATS["mac23"], tally)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="never comes to an end"):
            getattr(device, look)(0)
    assert tally.crash == "never comes to an end"


@pytest.mark.parametrize(
    "inner",
    [
        SimpleNamespace(wake=lambda now: [], next_event=lambda: 5),
        SimpleNamespace(quiet_prefix=lambda data: -1),
    ],
    ids=["wants to be woken again at once", "hears fewer bytes than none"],
)
def test_a_twin_that_gets_no_further_is_no_device(inner: SimpleNamespace) -> None:
    """The line would wait for it for ever, or call it a mistake of its own."""
    tally = Tally(said=1, hits=1)
    device = wrong_device.WrongDevice(inner, Fault("none", ""), FORMATS["msc-250"], tally)
    with pytest.raises(RuntimeError, match="never comes to an end"):
        device.wake(5) if hasattr(inner, "wake") else device.quiet_prefix(b"0")
    told = FaultSweep._outcome({"hang": "100 s of processor time"}, tally)
    assert told == ("no device", "never comes to an end")
    assert FaultSweep._outcome({"hang": "100 s"}, Tally()) == ("no device", "100 s"), "unmade"


def test_what_a_frame_has_no_room_for_is_no_hit() -> None:
    """A ninth byte of data never leaves."""
    tally = Tally()
    fault = Fault("byte of a reply", "doubled", at=9)
    device = wrong_device.WrongDevice(
        SimpleNamespace(accepts=None), fault, FORMATS["mac23-can"], tally
    )
    reply = bytes.fromhex("0581 4201200001020304")
    device._kind = "u01"
    (effect,) = device._reply(reply, 0, 0)
    assert effect.frame.data == reply[2:]
    assert (tally.asked, tally.hits) == (1, 0)


@pytest.mark.strength
def test_a_limit_goes_on_behind_the_limits_within_it() -> None:
    """A run of many chunks that are each short enough is ended all the same."""

    def work_on() -> None:
        for _ in range(200_000):
            with limited(5.0):
                random.random()

    with pytest.raises(Overrun), limited(0.3):
        work_on()


@pytest.mark.strength(seconds=60)
@pytest.mark.parametrize(("model", "number"), SAMPLE)
def test_a_sample_of_wrong_devices_is_caught(model: str, number: int) -> None:
    """The sweep itself is `scripts/sweep_faults`."""
    setting = Setting(model, "a plain port", "quick", 300, is_exitfirst=True)
    row = FaultSweep(setting, seed=1).judge(number)
    assert row["outcome"] == "caught", row


@pytest.mark.strength(seconds=30)
@pytest.mark.parametrize(("model", "fault"), NOISY, ids=str)
def test_a_device_that_is_always_wrong_is_no_noisy_line(model: str, fault: Fault) -> None:
    """It fails, and is not given the time of a noisy line for it."""
    setting = Setting(model, "a plain port", "quick", 300)
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert row["outcome"] == "caught", row
    assert row["bench_s"] < LONGEST_S / 1.5


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize(("model", "level", "fault"), ONCE_ESCAPED, ids=str)
def test_what_once_escaped_on_a_plain_port_is_caught(model: str, level: str, fault: Fault) -> None:
    """On a line, or a bus, that nobody knows to lose nothing."""
    setting = Setting(model, "a plain port", level, 300, is_exitfirst=True)
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert row["outcome"] == "caught", row


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize(("model", "fault", "outcome"), LED_OUT, ids=str)
def test_an_axis_that_got_outside_is_held(model: str, fault: Fault | str, outcome: str) -> None:
    """It strays by one motion at most, and nothing moves it once that was seen."""
    if isinstance(fault, str):
        names = [f"{owner.__qualname__}.{name}" for owner, name, _ in functions(model)]
        fault = Fault("inside", "twice", when=When(every=7), at=names.index(fault))
    setting = Setting(model, "a plain port", "quick", 300)
    row = FaultSweep(setting, seed=20261128).judge_fault(fault, setting)
    assert row["outcome"] == outcome, row


@pytest.mark.parametrize(
    ("places", "is_held"),
    [
        ((0, 30_000, 40_000, 40_000, 40_000), True),
        ((0, 30_000, 40_000, 40_000, 40_000, 20_500), True),
        ((0, 30_000, 40_000, 50_000, 60_000), False),
        ((0, 30_000, 40_000, 40_000, 40_000, 41_000), False),
    ],
    ids=["stands", "goes home", "goes on", "goes on later"],
)
def test_a_shaft_is_held_once_a_host_could_know_where_it_is(
    places: tuple[int, ...], is_held: bool
) -> None:
    """Two answers are enough; from then on it is to come to rest and stay."""
    tally = Tally()
    for place in places:
        tally.follow(1, place, is_asked=True)
    assert tally.is_held is is_held
    row: Row = {"hang": "", "errors": [], "status": 1, "evidence": ["told"], "failed": []}
    outcome = FaultSweep._outcome(row, tally)[0]
    assert outcome == ("strayed" if is_held else "outside")


def test_a_shaft_that_nobody_looked_at_is_not_held() -> None:
    """Also beside one that is."""
    tally = Tally()
    for place in (0, 30_000, 30_000, 30_000):
        tally.follow(1, place, is_asked=True)
        tally.follow(2, place, is_asked=False)
    assert not tally.is_held


def test_who_says_nothing_any_more_is_silent() -> None:
    """It answers the first requests, and none of the last."""
    row: Row = {"hang": "", "errors": [], "status": 3, "sentence": "lost", "evidence": []}
    assert FaultSweep._outcome(row, Tally(said=9, hits=1, unanswered=1)) == ("refused", "lost")
    assert FaultSweep._outcome(row, Tally(said=9, hits=1, unanswered=9)) == ("silent", "lost")


@pytest.mark.strength
@pytest.mark.parametrize(
    ("fault", "outcome"),
    [(Fault("reply", "before the one that is due"), "caught"), (Fault("reply", "lost"), "silent")],
    ids=str,
)
def test_a_module_that_holds_replies_back_goes_on(fault: Fault, outcome: str) -> None:
    """A twin that stands still is no device, and one without replies never answers."""
    setting = Setting("mac23-can", "virtual", "quick", 300, is_exitfirst=True)
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert row["outcome"] == outcome, row


@pytest.mark.parametrize("place", ["sentence", "evidence"])
def test_a_twin_that_has_crashed_is_neither_caught_nor_silent(place: str) -> None:
    """Whether the run says so, or what a check has found."""
    text = "the built-in twin crashed: TypeError"
    row: Row = {"hang": "", "errors": [], "status": 1, "sentence": "", "evidence": [""]}
    row[place] = text if place == "sentence" else [text]
    assert FaultSweep._outcome(row, Tally(said=1, hits=1)) == ("no device", text)


@pytest.mark.strength
def test_a_daemon_that_ends_by_a_bug_has_crashed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends by itself, with the status for that."""
    monkeypatch.setattr(real_runs, "main", lambda words: sys.exit(EXIT_BUG))
    notes = tmp_path / "tally"
    child = os.fork()
    if not child:
        real_runs._serve("msc-250", tmp_path / "line", notes, Tally())
    os.waitpid(child, 0)
    assert str(EXIT_BUG) in json.loads(notes.read_text("utf-8"))["crash"]


@pytest.mark.strength
@pytest.mark.parametrize("fault", UNKNOWN, ids=str)
def test_a_module_whose_replies_are_all_wrong_in_one_byte_is_one(fault: Fault) -> None:
    """It fails, where it was told that no module answers."""
    setting = Setting("mac23", "a plain port", "quick", 300, is_exitfirst=True)
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert row["outcome"] == "caught", row


@pytest.mark.strength
def test_a_query_that_is_never_answered_soundly_is_no_error_of_the_suite() -> None:
    """Neither the byte that is no digit, nor what rests on that query."""
    fault = Fault("byte of a reply", "bits flipped", ("27",), at=9, amount=146)
    setting = Setting("mac23", "a plain port", "quick", 300)
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert row["errors"] == []
    assert row["outcome"] == "caught", row


@pytest.mark.strength
def test_a_unit_1_alone_on_two_wires_conforms() -> None:
    """Nothing but what is corrupted when both talk tells it from one on RS-232."""
    row = QuirkSweep(Setting("msc-250", "a plain port", "quick", 300), seed=1).judge_readings(
        {"transport": "rs485"}
    )
    assert row["outcome"] == "sound", row


@pytest.mark.strength(seconds=60)
@pytest.mark.parametrize("model", MODELS)
def test_a_sample_of_other_readings_conforms(model: str) -> None:
    """The sweep itself is `scripts/sweep_quirks`."""
    sweep = QuirkSweep(Setting(model, "virtual", "quick", 300), seed=1, at_once=8)
    row = sweep.judge(1)
    assert row["outcome"] in ("sound", "unread"), row["why"]


@pytest.mark.strength
@pytest.mark.parametrize(("kind", "other"), [("0C", "08"), ("0F", "1B")])
def test_a_module_that_a_command_has_led_elsewhere_is_found_and_fails(
    kind: str, other: str
) -> None:
    """At the address, or the rate, that the command would have set had it been the other one."""
    setting = Setting("mac23", "a plain port", "quick", 300, is_exitfirst=True)
    fault = Fault("effect", f"that of {other}", (kind,))
    row = FaultSweep(setting, seed=1).judge_fault(fault, setting)
    assert (row["outcome"], row["failed"]) == ("caught", [f"MACS-CMD-{kind}-01"]), row


@pytest.mark.strength(seconds=60)
def test_a_fault_that_never_gets_on_the_wire_is_not_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """What people are told of a device is wrong, and every byte of the line as it should be."""
    known = functions("msc-250")
    (at,) = (number for number, (_, name, _) in enumerate(known) if name == "_tell")
    monkeypatch.setattr(sweeps, "draw_fault", lambda *_: Fault("inside", "its negative", at=at))
    row = FaultSweep(Setting("msc-250", "a plain port", "quick", 300), seed=1).judge(1)
    assert (row["outcome"], row["level"], row["hits"] > 0) == ("unseen", "full", True), row
