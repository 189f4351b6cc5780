"""Faults of the wire in virtual time: every kind, every selection, the same again by its seed."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from typing import Any, cast

import can
import pytest
import serial

from axistwin import catalog, testing
from axistwin.errors import UsageError
from axistwin.runtime.line import Line
from axistwin.wire.wire_fault import FAULT_TYPES, make_fault

POSITION, STATUS = b"\x0201400200000000000A2\x03", b"\x0201400210000000000A3\x03"
REPLY = bytes.fromhex("06130230313130303030303030303030303130031a")
ASK_POSITION = can.Message(
    arbitration_id=0x601, is_extended_id=False, data=bytes.fromhex("4000200000000000")
)
ANSWER = "4200200000000000"


class Host:
    """A program at the line of a MAC23, that asks and asks again."""

    def __init__(self, twin: testing.StartedTwin, port: Any) -> None:
        self.twin, self.port = twin, port
        self.retries = 0

    @property
    def faults(self) -> Any:
        """Those of the line."""
        return self.twin.line.faults

    def ask(self, request: bytes = POSITION) -> bytes:
        """What comes within the port's time-out."""
        self.port.write(request)
        answer: bytes = self.port.read(200)
        return answer

    def ask_again(self) -> bytes:
        """The answer, asked for four times at most."""
        for _ in range(4):
            answer = self.ask()
            if answer.endswith(b"\x1a") and answer.startswith(b"\x06"):
                return answer
            self.retries += 1
        raise AssertionError("no answer")


@contextmanager
def host(**options: Any) -> Iterator[Host]:
    """A MAC23 in virtual time, and who talks to it."""
    with testing.start("mac23", time="virtual", **options) as twin:
        port = serial.serial_for_url(twin.port, baudrate=38400, timeout=0.3)
        with closing(port):
            yield Host(twin, port)


def answers(started: testing.StartedLine) -> list[tuple[int, str]]:
    """What the MAC23 on CAN answers to a question: after how many µs, and its data."""
    began_ns = started.virtual_time_ns
    started.bus.send(ASK_POSITION)
    found = []
    while (passed_ns := started.virtual_time_ns - began_ns) < 300_000_000:
        message = started.bus.recv(0.3 - passed_ns / 1e9)
        if message is not None and message.arbitration_id == 0x581:
            passed_ns = started.virtual_time_ns - began_ns
            found.append((passed_ns // 1000, message.data.hex()))
    return found


# ---- kinds on a serial line ----------------------------------------------------------------------


@pytest.mark.parametrize("pacing", [True, False], ids=["paced", "unpaced"])
@pytest.mark.parametrize(
    ("kind", "heard"),
    [
        ("drop", b""),
        ("duplicate", REPLY + REPLY),
        ("delay", REPLY),
        ("jitter", REPLY),
        ("disconnect", b""),
        ("busy", b"\0"),
    ],
)
def test_the_next_reply_meets_the_fault_and_no_other(kind: Any, heard: bytes, pacing: bool) -> None:
    """One-shot is what a fault is unless it is told otherwise; the list has what it did."""
    with host(pacing=pacing) as talk:
        assert talk.ask(STATUS)
        number = talk.faults.add(kind, direction="to_host")
        assert talk.ask() == heard
        assert talk.ask() == REPLY
        (report,) = talk.faults
        assert (report.number, report.acted, report.is_over) == (number, 1, True)
        assert report.last.endswith(": " + REPLY.hex(" ").upper())
        assert talk.faults.acted == {kind: 1}


@pytest.mark.parametrize("pacing", [True, False], ids=["paced", "unpaced"])
def test_a_corrupted_reply_has_one_bit_flipped(pacing: bool) -> None:
    """The place is drawn; the report names it."""
    with host(pacing=pacing) as talk:
        talk.faults.add("corrupt", direction="to_host")
        corrupted = talk.ask()
        flipped = int.from_bytes(corrupted, "big") ^ int.from_bytes(REPLY, "big")
        assert flipped.bit_count() == 1
        place = len(REPLY) - 1 - (flipped.bit_length() - 1) // 8
        assert f"of byte {place + 1} flipped" in talk.faults[1].last


def test_a_delayed_reply_comes_later_by_the_duration() -> None:
    """To the nanosecond, behind the latency that the device has anyway."""
    reached = []
    for selection in ({}, {"direction": "to_host", "duration_ms": 40}):
        with host() as talk:
            if selection:
                talk.faults.add("delay", **selection)
            talk.port.write(POSITION)
            assert talk.port.read(len(REPLY)) == REPLY
            reached.append(talk.twin.virtual_time_ns)
    assert reached[1] - reached[0] == 40_000_000


def test_jitter_spreads_the_bytes_within_its_bound() -> None:
    """Every gap is new, none is longer, and the bytes stay in order."""
    with host() as talk:
        talk.faults.add("jitter", direction="to_host", duration_ms=10)
        talk.port.write(POSITION)
        times = []
        for expected in REPLY:
            assert talk.port.read(1)[0] == expected
            times.append(talk.twin.virtual_time_ns)
        byte_ns = 10 * 1_000_000_000 // 38400
        gaps = [after - before - byte_ns for before, after in pairwise(times)]
        assert all(-2 <= gap <= 10_000_002 for gap in gaps)
        assert len(set(gaps)) > 15


def test_a_break_before_a_reply_is_a_nul_to_the_host() -> None:
    """The reply follows it whole."""
    with host() as talk:
        talk.faults.add("break", direction="to_host")
        assert talk.ask() == b"\0" + REPLY


def test_a_break_at_once_reaches_the_device_as_a_bad_character() -> None:
    """It takes its time on the line; what is sent behind it is answered."""
    with host() as talk:
        talk.faults.add("break", duration_ms=30)
        assert talk.faults[1].acted == 1
        assert talk.ask().endswith(REPLY)


def test_noise_comes_on_a_line_at_rest_by_its_rate() -> None:
    """About as often as said, on the average; a full line is left alone."""
    with host() as talk:
        talk.faults.add("noise", direction="to_host", per_s=50)
        talk.twin.advance(10)
        count = talk.faults[1].acted
        assert 400 < count < 600
        assert len(talk.port.read(2000)) >= count


def test_noise_to_the_device_starts_no_frame_but_may_spoil_one() -> None:
    """The host that asks again gets its answer."""
    with host() as talk:
        talk.faults.add("noise", direction="to_device", per_s=100)
        for _ in range(20):
            assert talk.ask_again() == REPLY
        assert talk.faults[1].acted > 10


@pytest.mark.parametrize("pacing", [True, False], ids=["paced", "unpaced"])
@pytest.mark.parametrize("kind", ["disconnect", "busy"])
def test_nothing_passes_while_the_wire_is_cut(kind: Any, pacing: bool) -> None:
    """From now on, for the duration, in both directions; then all is as before."""
    with host(pacing=pacing) as talk:
        began_ns = talk.twin.virtual_time_ns
        talk.faults.add(kind, duration_ms=200)
        talk.port.write(POSITION)
        talk.twin.advance(0.199)
        assert talk.port.read(talk.port.in_waiting) in (b"", b"\0")
        assert talk.twin.virtual_time_ns - began_ns < 200_000_000
        talk.twin.advance(0.002)
        assert talk.ask() == REPLY


def test_a_cut_in_one_direction_lets_the_other_one_pass() -> None:
    """The device does what it is told; only its answer is lost."""
    with host() as talk:
        talk.faults.add("disconnect", direction="to_host", count=1)
        assert talk.ask(b"\x020140013000000007DBF\x03") == b""
        assert talk.twin.position == 125


def test_to_remove_a_fault_ends_what_it_is_doing() -> None:
    """A cable that is out for a minute is in again at once."""
    with host() as talk:
        number = talk.faults.add("disconnect", duration_ms=60_000)
        assert talk.ask() == b""
        report = talk.faults.remove(number)
        assert (report.acted, len(talk.faults)) == (1, 0)
        assert talk.ask() == REPLY


# ---- which messages ------------------------------------------------------------------------------


def test_a_count_is_kept() -> None:
    """Three replies are lost, the fourth comes; the host's retries are counted by the fault."""
    with host() as talk:
        talk.faults.add("drop", direction="to_host", count=3)
        assert talk.ask_again() == REPLY
        assert (talk.retries, talk.faults[1].acted, talk.faults[1].seen) == (3, 3, 3)


def test_a_chance_acts_on_its_share_of_the_messages() -> None:
    """Until it is removed."""
    with host(pacing=False) as talk:
        talk.faults.add("drop", direction="to_host", chance=0.25)
        heard = sum(talk.ask() == REPLY for _ in range(400))
        report = talk.faults.remove(1)
        assert (report.seen, report.acted) == (400, 400 - heard)
        assert 70 < report.acted < 130
        assert all(talk.ask() == REPLY for _ in range(10))


def test_a_chance_of_nothing_never_acts_and_of_one_always() -> None:
    """The ends of the range are exact."""
    with host(pacing=False) as talk:
        talk.faults.add("drop", chance=0)
        assert all(talk.ask() == REPLY for _ in range(20))
        talk.faults.add("drop", chance=1)
        assert not any(talk.ask() for _ in range(20))


def test_messages_are_chosen_by_their_meaning() -> None:
    """In the words of the transcript, of either case."""
    with host() as talk:
        assert "20h" in catalog.find_model("mac23").family.explain(POSITION)
        talk.faults.add("drop", direction="to_device", message="21H", count=5)
        assert talk.ask(POSITION) == REPLY
        assert talk.ask(STATUS) == b""
        assert talk.faults[1].seen == 1


def test_messages_are_chosen_by_their_bytes() -> None:
    """Two digits each, any byte for two dots."""
    with host() as talk:
        talk.faults.add("drop", hex="02 30 31 34 30 .. 32 31", count=5)
        assert talk.ask(POSITION) == REPLY
        assert talk.ask(STATUS) == b""


def test_faults_act_one_after_the_other() -> None:
    """A delayed one comes twice; of a lost one the next does not hear."""
    with host() as talk:
        talk.faults.add("delay", direction="to_host", duration_ms=10)
        talk.faults.add("duplicate", direction="to_host")
        assert talk.ask() == REPLY + REPLY
        talk.faults.clear()
        talk.faults.add("drop", direction="to_host")
        number = talk.faults.add("corrupt", direction="to_host")
        assert talk.ask() == b""
        assert talk.faults[number].seen == 0


def test_devices_on_one_line_are_not_told_apart() -> None:
    """The wire is common: the fault meets the next reply of either."""
    with testing.start("mac23:0", "mac34-1:5", time="virtual") as line:
        port = serial.serial_for_url(line.port, baudrate=38400, timeout=0.3)
        line.line.faults.add("drop", direction="to_host")
        family = catalog.find_model("mac34-1").family
        port.write(family.compose("20h", 5))
        assert port.read(100) == b""
        port.write(POSITION)
        assert port.read(100) == REPLY
        port.close()


# ---- the same again ------------------------------------------------------------------------------

STORM = (
    ("corrupt", {"chance": 0.2}),
    ("drop", {"chance": 0.1, "direction": "to_host"}),
    ("jitter", {"chance": 0.3}),
    ("noise", {"per_s": 30}),
    ("disconnect", {"per_s": 1, "duration_ms": 50}),
    ("busy", {"chance": 0.05, "duration_ms": 20}),
)


def storm(seed: int) -> tuple[str, list[tuple[int, int, str]]]:
    """What is said in a storm, and what the faults have done."""
    with host(seed=seed) as talk:
        for kind, selection in STORM:
            talk.faults.add(kind, **selection)
        for request in (POSITION, STATUS) * 15:
            talk.ask(request)
        return talk.twin.transcript, [(each.seen, each.acted, each.last) for each in talk.faults]


def test_the_same_seed_gives_the_same_trace() -> None:
    """Byte for byte and nanosecond for nanosecond; another seed gives another one."""
    assert storm(5) == storm(5)
    assert storm(5) != storm(6)
    assert all(acted for _, acted, _ in storm(5)[1])


def test_a_fault_that_never_acts_changes_nothing() -> None:
    """The long way round the shortcuts ends at the same nanosecond with the same bytes."""
    traces = []
    for selection in (None, {"hex": "FF FF FF", "count": 1}):
        for pacing in (True, False):
            with host(pacing=pacing) as talk:
                if selection:
                    talk.faults.add("drop", **selection)
                said = [(talk.ask(each), talk.twin.virtual_time_ns) for each in (POSITION, STATUS)]
                traces.append((pacing, said))
    assert traces[:2] == traces[2:]


def test_what_faults_do_is_in_the_transcript() -> None:
    """At its time, with the number of the fault."""
    with host() as talk:
        talk.faults.add("drop", direction="to_host")
        talk.ask()
        assert "faults.add: 1 drop direction=to_host" in talk.twin.transcript
        assert "* fault 1 (drop): lost: 06 13" in talk.twin.transcript


# ---- a CAN bus -----------------------------------------------------------------------------------


@pytest.mark.parametrize("pacing", [True, False], ids=["paced", "unpaced"])
def test_frames_meet_the_faults_too(pacing: bool) -> None:
    """Lost, twice, changed, later, destroyed and sent again: each once, then all is well."""
    with testing.start("mac23-can:1", time="virtual", pacing=pacing) as started:
        faults = started.line.faults
        ((usual_us, data),) = answers(started)
        assert data == ANSWER
        faults.add("drop", direction="to_host", message="Position =")
        assert answers(started) == []
        faults.add("duplicate", direction="to_host")
        assert [each for _, each in answers(started)] == [ANSWER, ANSWER]
        faults.add("delay", direction="to_host", duration_ms=30)
        ((late_us, _),) = answers(started)
        assert late_us - usual_us == 30_000
        faults.add("corrupt", direction="to_host", hex="581# 42 .. 20")
        ((_, corrupted),) = answers(started)
        assert (int(corrupted, 16) ^ int(ANSWER, 16)).bit_count() == 1
        faults.add("drop", direction="to_device")
        assert answers(started) == []
        assert answers(started) == [(usual_us, ANSWER)]
        assert [each.acted for each in faults] == [1] * 5


@pytest.mark.parametrize("pacing", [True, False], ids=["paced", "unpaced"])
@pytest.mark.parametrize("selection", [{}, {"direction": "to_host"}, {"direction": "to_device"}])
def test_nothing_passes_while_a_bus_is_cut(pacing: bool, selection: dict[str, Any]) -> None:
    """In the direction of the fault; then all is well."""
    with testing.start("mac23-can:1", time="virtual", pacing=pacing) as started:
        number = started.line.faults.add("disconnect", duration_ms=10_000, **selection)
        for _ in range(3):
            assert answers(started) == []
        assert started.line.faults[number].acted == 1
        started.advance(10)
        assert [data for _, data in answers(started)] == [ANSWER]


def test_a_frame_that_comes_late_is_lost_on_a_bus_that_was_cut_meanwhile() -> None:
    """What counts is when it would be heard."""
    with testing.start("mac23-can:1", time="virtual") as started:
        started.line.faults.add("delay", direction="to_host", duration_ms=30)
        started.bus.send(ASK_POSITION)
        started.advance(0.010)
        started.line.faults.add("disconnect", duration_ms=50)
        assert started.bus.recv(0.2) is None
        assert [data for _, data in answers(started)] == [ANSWER]


def test_jitter_of_frames_is_drawn_within_its_bound() -> None:
    """Every frame by itself, and in their order."""
    with testing.start("mac23-can:1", time="virtual") as started:
        ((usual_us, _),) = answers(started)
        started.line.faults.add("jitter", direction="to_host", duration_ms=20, chance=1)
        extra_us = [answers(started)[0][0] - usual_us for _ in range(20)]
        assert min(extra_us) >= 0
        assert max(extra_us) <= 20_000
        assert len(set(extra_us)) == 20
        assert max(extra_us) - min(extra_us) > 10_000


def test_error_frames_cost_time_and_count_as_errors() -> None:
    """The controller sends again by itself; both ends count."""
    with testing.start("mac23-can:1", time="virtual") as started:
        ((usual_us, _),) = answers(started)
        started.line.faults.add("error_frame", direction="to_host", count=3)
        ((late_us, _),) = answers(started)
        assert 3 * 200 < late_us - usual_us < 3 * 500
        assert started.line.faults[1].acted == 3


def test_endless_error_frames_take_the_sender_off_the_bus_for_a_while() -> None:
    """Neither kind of bus stands still; without the fault the frame goes out."""
    for pacing in (True, False):
        with testing.start("mac23-can:1", time="virtual", pacing=pacing) as started:
            number = started.line.faults.add("error_frame", direction="to_host", chance=1)
            assert answers(started) == []
            assert started.line.faults[number].acted >= 32
            started.line.faults.remove(number)
            assert answers(started)[0][1] == ANSWER


def test_a_dominant_bus_holds_all_frames_back() -> None:
    """Nobody begins before it is over, and a frame under way fails and is sent again."""
    with testing.start("mac23-can:1", time="virtual") as started:
        started.line.faults.add("busy", duration_ms=80)
        ((late_us, data),) = answers(started)
        assert data == ANSWER
        assert late_us > 80_000
        started.bus.send(ASK_POSITION)
        started.advance(0.0005)
        started.line.faults.add("busy", duration_ms=80)
        failed, *rest = [each for each in (started.bus.recv(0.2) for _ in range(2)) if each]
        assert failed.is_error_frame
        assert [each.data.hex() for each in rest] == [ANSWER]
        assert started.virtual_time_ns > 380_000_000


def test_a_delayed_frame_is_not_overtaken() -> None:
    """What follows in its direction waits for it."""
    with testing.start("mac23-can:1", time="virtual") as started:
        started.line.faults.add("delay", direction="to_host", duration_ms=50)
        status = can.Message(
            arbitration_id=0x601, is_extended_id=False, data=bytes.fromhex("4001200000000000")
        )
        for message in (ASK_POSITION, status):
            started.bus.send(message)
        heard = [started.bus.recv(0.2) for _ in range(2)]
        assert [each.data.hex()[4:6] for each in heard if each is not None] == ["20", "20"]
        assert [each.data.hex()[2:4] for each in heard if each is not None] == ["00", "01"]


# ---- every family --------------------------------------------------------------------------------


@pytest.mark.parametrize(("device", "words"), [("msc-250:1", "RQSTAT"), ("mn400:1", "FirmwareRev")])
def test_no_family_needs_anything_for_it(device: str, words: str) -> None:
    """A reply is lost, the next request is answered; chosen by the decoder's word."""
    family = catalog.find_model(device.partition(":")[0]).family
    request = family.compose(words, 1)
    with testing.start(device, time="virtual") as twin:
        port = serial.serial_for_url(
            twin.port, baudrate=cast(Line, twin.line).device_format.baud, timeout=0.5
        )
        port.write(request)
        usual = port.read(100)
        assert usual
        twin.line.faults.add("drop", direction="to_device", message=words)
        port.write(request)
        assert port.read(100) == b""
        port.write(request)
        assert port.read(100)
        assert twin.line.faults[1].acted == 1
        port.close()


# ---- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wire", "selection", "told"),
    [
        ("serial", {"kind": "dorp"}, "kind 'dorp': did you mean drop?"),
        ("serial", {}, "kind is missing: known: break, busy"),
        ("serial", {"kind": "error_frame"}, "kind 'error_frame' is not for a serial line: known"),
        ("can", {"kind": "break"}, "kind 'break' is not for a CAN bus: known: corrupt, drop"),
        ("serial", {"kind": "drop", "direction": "host"}, "direction 'host': known: both"),
        ("serial", {"kind": "drop", "count": 0}, "count 0 is out of range: 1..1000000000"),
        ("serial", {"kind": "drop", "count": 1.5}, "count 1.5: write a whole number"),
        ("serial", {"kind": "drop", "count": True}, "count True: write a whole number"),
        ("serial", {"kind": "drop", "chance": 1.1}, "chance 1.1 is out of range: 0..1"),
        ("serial", {"kind": "drop", "chance": float("nan")}, "chance nan is out of range"),
        ("serial", {"kind": "drop", "per_s": 5}, "per_s: drop needs a message to act on"),
        ("serial", {"kind": "noise"}, "per_s is missing: noise comes so many times a second"),
        ("serial", {"kind": "noise", "per_s": 5, "hex": "02"}, "hex: with per_s it chooses no"),
        ("serial", {"kind": "noise", "per_s": 1e9}, "per_s 1000000000 is out of range"),
        ("serial", {"kind": "drop", "duration_ms": 5}, "duration_ms: drop has none; leave it out"),
        ("serial", {"kind": "delay", "duration_ms": 0}, "duration_ms 0 is out of range"),
        ("serial", {"kind": "drop", "hex": "2"}, "hex '2': write bytes as two digits each"),
        ("serial", {"kind": "drop", "hex": "581#40"}, "a serial line has no identifiers"),
        ("serial", {"kind": "drop", "message": "a" * 201}, "message: write a text of at most 200"),
        ("serial", {"kind": "drop", "messsage": "a"}, "messsage: a fault has no such field: did"),
    ],
)
def test_a_mistake_is_one_clear_line(wire: Any, selection: dict[str, Any], told: str) -> None:
    """With the name of the field, what is allowed, or the nearest name."""
    with pytest.raises(UsageError) as error:
        make_fault(wire, **selection)
    assert told in str(error.value)
    assert "\n" not in str(error.value)


def test_a_line_has_a_limit_of_faults_and_names_those_it_has() -> None:
    """Removed numbers are not used again."""
    with host() as talk:
        for _ in range(64):
            talk.faults.add("drop", hex="FF")
        with pytest.raises(UsageError, match="64 faults already; remove one"):
            talk.faults.add("drop")
        talk.faults.clear()
        assert talk.faults.add("drop") == 65
        with pytest.raises(UsageError, match="no fault 3: known: 65"):
            talk.faults.remove(3)
        with pytest.raises(UsageError, match="no fault 3"):
            talk.faults[3]


def test_every_kind_says_what_it_does() -> None:
    """And is for one wire at least."""
    assert all(each.wires and each.doc for each in FAULT_TYPES.values())
