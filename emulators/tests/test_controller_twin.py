"""A user's handle on a controller, and the ways to give it a program."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import pytest
import serial
from msc_bench import rqstat

from axistwin import testing
from axistwin.devices.program_traces import ProgramFailed
from axistwin.devices.snapshot import Snapshot
from axistwin.errors import UsageError
from axistwin.kernel.effects import Trace
from axistwin.macroprogram import Macroprogram, Output, Steps, UserFlag, Variable
from axistwin.testing import StartedTwin
from axistwin.urlhandler import lines
from axistwin.urlhandler.protocol_axistwin import Serial

RUNNING, RAM_UNRELIABLE, CLEARED, AUTO_START = 1, 4, 8, 64

Starter = Callable[..., StartedTwin]


class Counter(Macroprogram):
    """Counts starts."""

    start = UserFlag(200)
    lamp = Output(20)
    count = Variable(2000, initial=10)

    def run(self) -> Steps:
        """For ever."""
        while True:
            yield self.start.rise
            self.start = False
            self.lamp = True
            self.count += 1


class Failing(Macroprogram):
    """Has a mistake in its second scan."""

    def run(self) -> Steps:
        """Not long."""
        yield
        self.fault("out of order")


@pytest.fixture
def twin(axistwin: Starter) -> StartedTwin:
    """A controller with a program, in virtual time."""
    return axistwin("msc-250", program=Counter, time="virtual")


def status_by_wire(port: str) -> int:
    """The status word, as a host reads it."""
    with serial.serial_for_url(port, timeout=1) as host:
        host.write(rqstat())
        answer = host.read(24)
        host.write(b"\x06")
        host.flush()
    return int.from_bytes(answer[14:16], "big")


# -- flags, variables, status ------------------------------------------------------------------


def test_flags_are_worked_by_number_and_by_name(twin: StartedTwin) -> None:
    """Of any kind; what the program does with them is seen."""
    twin.flags["start"] = True
    assert twin.flags[200]
    twin.advance(0.02)
    assert (twin.flags["start"], twin.flags[20], twin.flags["lamp"]) == (False, True, True)
    twin.flags[3] = True
    assert (twin.flags.on, repr(twin.flags)) == ([3, 20], "<Flags on: 3, 20>")
    twin.flags[3] = twin.flags[20] = False
    assert repr(twin.flags) == "<Flags on: none>"


def test_variables_are_worked_by_address_and_by_name(twin: StartedTwin) -> None:
    """What the program has stored, and what it reads."""
    assert twin.variables["count"] == 10
    twin.variables["count"] = -5
    twin.flags["start"] = True
    twin.advance(1)
    assert twin.variables[2000] == -4
    assert twin.cells["data_07D0"] == -4


def bits(twin: StartedTwin) -> set[int]:
    """The status bits that are set."""
    return {bit for bit in range(16) if twin.status >> bit & 1}


@pytest.mark.parametrize("bit", range(16))
def test_every_status_bit_can_be_set_and_cleared(twin: StartedTwin, bit: int) -> None:
    """And is read over the wire."""
    twin.stop_program()
    assert bits(twin) == set()
    twin.set_status(bit, True)
    assert bits(twin) == {bit}
    assert status_by_wire(twin.port) == 1 << bit
    twin.set_status(bit, False)
    assert status_by_wire(twin.port) == 0


def set_flag(twin: Any, key: Any, value: Any) -> None:
    """As an expression."""
    twin.flags[key] = value


def set_variable(twin: Any, key: Any, value: Any) -> None:
    """As an expression."""
    twin.variables[key] = value


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda twin: twin.flags[256], "flag 256 does not exist: 0..255"),
        (lambda twin: twin.flags["strat"], "unknown flag 'strat': did you mean start?"),
        (lambda twin: twin.flags[1.5], "flag 1.5 is no number; give a number, or a name"),
        (lambda twin: twin.flags[True], "flag True is no number"),
        (lambda twin: set_flag(twin, 3, 2), "flag 3: 2 is not allowed; set True or False"),
        (lambda twin: set_flag(twin, -1, True), "flag -1 does not exist"),
        (lambda twin: twin.variables[32768], "address 32768 does not exist: 0..32764"),
        (lambda twin: twin.variables["cuont"], "unknown variable 'cuont': did you mean count?"),
        (lambda twin: set_variable(twin, 0, 1.5), "variable 0 = 1.5 is no whole number"),
        (lambda twin: set_variable(twin, 0, 1 << 31), "value 2147483648 is out of range"),
        (lambda twin: twin.set_status(16, True), "status bit 16 does not exist: 0..15"),
        (lambda twin: twin.set_status(3, 3), "status bit 3: 3 is not allowed"),
        (lambda twin: setattr(twin, "battery", "empty"), "battery 'empty': known: flat, good, low"),
        (lambda twin: setattr(twin, "load", 3), "has no load: that is for a motion device; known:"),
        (
            lambda twin: setattr(twin.twin, "load", 3),
            "no load: that is for a motion device; known:",
        ),
        (lambda twin: twin.inputs, "msc-250:1 is a controller and has no inputs: that is for a m"),
        (lambda twin: twin.inptus, "msc-250:1 is a controller and has no inptus: known: address"),
        (lambda twin: twin.position, "is a controller and has no position"),
        (lambda twin: twin.push(3), "is a controller and has no push"),
    ],
)
def test_a_mistake_is_told_in_one_line(
    twin: StartedTwin, mistake: Callable[[Any], Any], message: str
) -> None:
    """With what is allowed; nothing has changed."""
    before = twin.describe()
    with pytest.raises(UsageError) as caught:
        mistake(twin)
    assert message in str(caught.value)
    assert twin.describe() == before


def test_flags_and_variables_are_not_gone_through(twin: StartedTwin) -> None:
    """``flags.on`` tells which are on; a loop would otherwise run into a number too many."""
    with pytest.raises(TypeError, match="not iterable"):
        list(twin.flags)  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="not iterable"):
        list(twin.variables)  # type: ignore[call-overload]


def test_names_need_a_program(axistwin: Starter) -> None:
    """Which has none yet."""
    twin = axistwin("msc-250", time="virtual")
    with pytest.raises(UsageError, match="flag 'start': msc-250:1 has no program with names; load"):
        twin.flags["start"]


def test_twins_have_the_handle_of_their_kind(axistwin: Starter) -> None:
    """What the one can, the other says it cannot."""
    controller = axistwin("msc-250", time="virtual").twin
    motor = axistwin("mac23", time="virtual").twin
    assert type(controller) is not type(motor)
    assert hasattr(controller, "flags")
    assert not hasattr(controller, "inputs")
    with pytest.raises(
        UsageError, match="mac23:0 is a motion device and has no flags: that is for a controller"
    ):
        motor.flags  # noqa: B018
    with pytest.raises(UsageError, match="mac23:0 is a motion device and has no variables"):
        motor.variables = 3  # type: ignore[assignment, misc]


# -- program, power ----------------------------------------------------------------------------


def test_a_program_given_at_the_start_runs(twin: StartedTwin) -> None:
    """Without auto start it does not after a power cycle; its data stay."""
    twin.flags["start"] = True
    twin.advance(1)
    assert (twin.status, twin.state) == (RUNNING, "program running")
    assert isinstance(twin.program, Counter)
    twin.power_cycle()
    assert (twin.status, twin.state) == (0, "program stopped")
    assert (twin.variables["count"], twin.flags.on) == (11, [])
    twin.start_program()
    assert twin.status == RUNNING


def test_auto_start_runs_it_at_power_up(axistwin: Starter) -> None:
    """Status 65; a twin that is switched on now begins so, too."""
    options: dict[str, Any] = {"quirks": {"auto_start": True}, "time": "virtual"}
    twin = axistwin("msc-250", program=Counter, **options)
    assert twin.status == RUNNING | AUTO_START
    twin.power_cycle()
    assert twin.status == RUNNING | AUTO_START
    assert axistwin("msc-250", program=Counter, cold=True, **options).status == 65
    assert axistwin("msc-250", program=Counter, cold=True, time="virtual").status == 0


def test_a_program_is_changed_in_a_running_twin(twin: StartedTwin) -> None:
    """The old one stops; the new one has to be started; a bad one changes nothing."""
    with pytest.raises(UsageError, match="unknown program"):
        twin.load_program("nothing")
    assert twin.status == RUNNING
    twin.load_program("bench")
    assert twin.status == 0
    twin.start_program()
    twin.advance(0.055)
    assert twin.variables["ticks"] == 6
    twin.stop_program()
    twin.advance(1)
    assert (twin.status, twin.variables["ticks"]) == (0, 6)


def test_a_cleared_system_has_no_program_and_no_data(twin: StartedTwin) -> None:
    """Status bit 3, until a program is loaded, with its initial values."""
    twin.variables["count"] = 99
    twin.clear_program()
    assert (twin.status, twin.state, twin.variables[2000]) == (CLEARED, "program cleared", 0)
    with pytest.raises(UsageError, match="there is no program to start; load one first"):
        twin.start_program()
    twin.load_program(Counter)
    assert (twin.status, twin.variables["count"]) == (0, 10)


def test_a_flat_battery_loses_the_memory_with_the_supply(twin: StartedTwin) -> None:
    """Not before; status bits 1 and 2 tell."""
    assert twin.battery == "good"
    twin.battery = "low"
    assert bits(twin) == {0, 1}
    twin.power_cycle()
    assert (twin.variables["count"], bits(twin)) == (10, {1})
    twin.battery = "flat"
    assert (twin.variables["count"], twin.status & RAM_UNRELIABLE) == (10, 0)
    twin.power_cycle()
    assert (twin.variables["count"], bits(twin)) == (0, {1, 2})


def test_the_memory_outlives_the_twin(axistwin: Starter, tmp_path: Path) -> None:
    """With a folder for it: initial values do not come back."""
    options: dict[str, Any] = {"program": Counter, "time": "virtual", "state": tmp_path / "s"}
    first = axistwin("msc-250", **options)
    first.flags["start"] = True
    first.advance(1)
    first.stop()
    assert axistwin("msc-250", **options).variables["count"] == 11


def test_a_script_error_is_told(axistwin: Starter) -> None:
    """Where and why; subscribers hear of it at its time."""
    twin = axistwin("msc-250", program=Counter, time="virtual")
    traces: list[Trace] = []
    twin.line.subscribe(lambda _, trace: traces.append(trace))
    twin.load_program(Failing)
    twin.start_program()
    errors = [twin.program_error]
    twin.advance(1)
    errors.append(twin.program_error)
    assert errors[0] is None
    assert re.search(r"test_controller_twin\.py:\d+: out of order$", str(errors[1]))
    assert twin.status == 1 << 12
    (error,) = [trace for trace in traces if isinstance(trace, ProgramFailed)]
    assert (error.time_ns, error.error) == (10_000_000, errors[1])


def test_an_hour_passes_at_once(twin: StartedTwin) -> None:
    """For a program that waits."""
    twin.advance(3600)
    twin.flags["start"] = True
    twin.advance(3600)
    assert twin.variables["count"] == 11


def test_the_same_seed_tells_the_same_story(axistwin: Starter) -> None:
    """Bytes and times of a transcript, states and traces."""

    def story() -> tuple[str, list[Trace], Snapshot]:
        line = axistwin("msc-250:1", "msc-250:2", program="bench", time="virtual", seed=7)
        traces: list[Trace] = []
        line.line.subscribe(lambda _, trace: traces.append(trace))
        with serial.serial_for_url(line.port, timeout=0.5) as host:
            for unit in (1, 2, 1):
                host.write(rqstat(unit))
                host.read(24)
                host.write(b"\x06")
                line[unit - 1].flags[240 + unit] = True
        line.advance(0.5)
        told = line.transcript, traces, line[1].describe()
        line.stop()
        return told

    assert story() == story()


# -- ways to give one --------------------------------------------------------------------------

TABLE = (
    "from axistwin.macroprogram import *\n"
    "class Table(Macroprogram):\n"
    "    number = Variable(2000, initial={})\n"
    "    def scan(self):\n"
    "        pass\n"
)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a.py, b.py, which store 1 and 2, and bad.py."""
    monkeypatch.chdir(tmp_path)
    for name, number in (("a", 1), ("b", 2)):
        (tmp_path / f"{name}.py").write_text(TABLE.format(number), encoding="utf-8")
    (tmp_path / "bad.py").write_text("\nnonsense\n", encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("query", "numbers"),
    [
        ("program=a.py", [1, 1]),
        ("program=a.py:Table&program.2=b.py", [1, 2]),
        ("program.1=b.py", [2, 0]),
        ("program.2=b.py&program.1=a.py", [1, 2]),
    ],
)
@pytest.mark.usefixtures("files")
def test_a_url_gives_programs_to_all_or_to_one(query: str, numbers: list[int]) -> None:
    """By the unit's number."""
    url = f"axistwin://msc-250:1,msc-850:2?time=virtual&{query}"
    with cast(Serial, serial.serial_for_url(url)) as port:
        assert [twin.variables[2000] for twin in port.twins] == numbers
        assert [twin.status for twin in port.twins] == [int(number > 0) for number in numbers]


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("msc-250?program=none.py", "program none.py: cannot be read"),
        ("msc-250?program=bad.py", "program bad.py:2: NameError: name 'nonsense' is not defined"),
        ("msc-250?program.x=a.py", "program.x: x is no unit; write program.2=FILE.py"),
        ("msc-250?program.=a.py", "program.: nothing is no unit"),
        ("msc-250?program.2=a.py", "program 2=a.py: no unit 2; there is 1"),
        ("msc-250?program=", "program: no value given"),
        ("msc-250?programm=a.py", "unknown parameter programm: did you mean program?"),
        ("mac23?program=a.py", "mac23:0 runs no program; leave it out, or name a controller"),
        ("msc-250?program.1=a.py&program.01=b.py", "unit 1 had a.py already; give one"),
    ],
)
@pytest.mark.usefixtures("files")
def test_a_url_that_gives_a_bad_program_is_told(place: str, message: str) -> None:
    """In one line, as pyserial's error."""
    with pytest.raises(serial.SerialException) as caught:
        serial.serial_for_url(f"axistwin://{place}")
    assert message in str(caught.value)


@pytest.mark.usefixtures("files")
def test_lines_that_are_shared_agree_on_their_programs() -> None:
    """Another program is another line."""
    url = "axistwin://msc-250?time=virtual&line=shared-programs&program="
    with (
        serial.serial_for_url(url + "a.py"),
        serial.serial_for_url(url + "a.py"),
        pytest.raises(serial.SerialException, match=r"programs is all=a\.py, not all=b\.py"),
    ):
        serial.serial_for_url(url + "b.py")
    lines.release("shared-programs")


@pytest.mark.usefixtures("files")
def test_the_fixture_gives_programs_to_all_or_to_one(axistwin: Starter) -> None:
    """A class, a file, a name; by unit."""
    line = axistwin("msc-250:1", "msc-250:2", program="a.py", time="virtual")
    assert [twin.variables[2000] for twin in line] == [1, 1]
    line = axistwin("msc-250:1", "msc-250:2", program={2: Path("b.py"), 1: Counter}, time="virtual")
    assert [twin.variables[2000] for twin in line] == [10, 2]
    with pytest.raises(UsageError, match="no unit 3; there is 1, 2"):
        axistwin("msc-250:1", "msc-250:2", program={3: Counter}, time="virtual")
    with pytest.raises(UsageError, match="program: mac23-can runs none; leave it out"):
        axistwin("mac23-can", program=Counter)


def test_start_stops_what_it_has_begun_when_the_program_is_bad(tmp_path: Path) -> None:
    """The folder is free again."""
    state = tmp_path / "state"

    class Bad(Counter):
        lamp = Output(200)

    with pytest.raises(UsageError, match=r"Bad\.lamp: flag 200 is of kind user"):
        testing.start("msc-250", program=Bad, state=state)
    with testing.start("msc-250", program=Counter, state=state, time="virtual") as twin:
        assert twin.status == RUNNING


def run(folder: Path, *arguments: str) -> "subprocess.Popen[str]":
    """``axistwin run`` in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "axistwin", "run", *arguments],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )


@pytest.mark.system
def test_the_daemon_runs_programs_and_tells_their_errors(files: Path) -> None:
    """By unit; when one fails, in its first scan or later, in words and as an event."""
    later = TABLE.format(3).replace("        pass\n", "        assert self.time_ms < 20\n")
    (files / "later.py").write_text(later, encoding="utf-8")
    (files / "first.py").write_text(TABLE.format(3).replace("pass", "1 / 0"), encoding="utf-8")
    programs = ["--program=a.py", "--program=2=first.py", "--program=3=later.py"]
    units = [f"msc-250:{unit}" for unit in (1, 2, 3)]
    process = run(files, *units, *programs, "--json", "--pty", "./msc")
    events: list[dict[str, Any]] = []
    try:
        assert process.stdout is not None
        for event in process.stdout:
            events.append(json.loads(event))
            if events[-1]["event"] == "ready":
                break
        with serial.Serial(str(files / "msc"), 9600, timeout=5) as host:
            host.write(rqstat(1))
            answer = host.read(24)
            host.write(b"\x06")
            host.write(rqstat(3))
            last = host.read(24)
    finally:
        process.send_signal(signal.SIGTERM)
        printed, said = process.communicate(timeout=20)
    events += map(json.loads, printed.splitlines())
    assert (answer[14:16], last[14:16]) == (b"\x00\x01", b"\x10\x00")
    first, second = (event for event in events if event["event"] == "program_error")
    assert first["device"] == "msc-250:2"
    assert first["error"] == "first.py:5: ZeroDivisionError: division by zero"
    assert (second["device"], second["error"]) == ("msc-250:3", "later.py:5: AssertionError: ")
    told = "msc-250:2: its program has stopped with an error: first.py:5: ZeroDivision"
    assert said.count(told) == 1
    assert said.count("msc-250:3: its program has stopped with an error: later.py:5") == 1
    assert process.returncode == 0


@pytest.mark.system
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["msc-250", "--program", "bad.py"], "program bad.py:2: NameError: name 'nonsense'"),
        (["msc-250", "--program", "a.py:Press"], "program a.py: no class Press: "),
        (["msc-250", "--program", "3=a.py"], "program 3=a.py: no unit 3; there is 1"),
        (["msc-250", "--program", "1="], "program '1=': write FILE.py, FILE.py:CLASS, or UNIT="),
        (["msc-250", "--program", ""], "--program: needs a name"),
        (["msc-250", "--program", "a.py", "--program", "b.py"], "all units had a.py already; give"),
        (["mac23", "--program", "a.py"], "mac23:0 runs no program; leave it out"),
        (["mac23-can", "--program", "a.py"], "--program is for a serial line"),
    ],
)
def test_a_bad_program_ends_the_daemon_with_one_line(
    files: Path, arguments: list[str], message: str
) -> None:
    """And exit status 2, before anything is served."""
    process = run(files, *arguments)
    printed, said = process.communicate(timeout=20)
    assert (process.returncode, printed) == (2, "")
    assert said.startswith("axistwin: ")
    assert message in said
    assert said.count("\n") == 1
