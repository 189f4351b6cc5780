"""The program ``axistwin``: ready lines, events, clean ends, one clear line for each mistake."""

import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path

import click
import pytest
import serial
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke
from mac_frames import ACCEPTED, answer_value, request
from served import eventually

from axistwin import __version__, catalog
from axistwin.cli import program

pytestmark = pytest.mark.system


def ask(port: serial.SerialBase, frame: bytes, count: int) -> bytes:
    """The reply to ``frame``."""
    port.write(frame)
    return bytes(port.read(count))


# -- run ----------------------------------------------------------------------------------------


def test_run_says_when_clients_can_connect_and_ends_cleanly(tmp_path: Path) -> None:
    """A ready line per device; SIGTERM ends it with status 0 and the link removed."""
    with daemon(tmp_path, "mac23", "mac34-1:5", "--pty", "./mac") as process:
        lines = [process.line(), process.line()]
        link = tmp_path / "mac"
        target = link.readlink()
        assert lines == [
            f"ready mac23:0 pty=./mac ({target})",
            f"ready mac34-1:5 pty=./mac ({target})",
        ]
        with serial.Serial(str(link), 38400, timeout=TIMEOUT_S) as port:
            for address in (0, 5):
                assert answer_value(ask(port, request(0x20, address=address), 21)) == 0
        status, out, err = process.end()
        assert (status, out) == (0, "")
        assert "memory ends with this run" in err
        assert list(tmp_path.iterdir()) == []


def test_run_tells_everything_as_json(tmp_path: Path) -> None:
    """Ready, clients that come and go, stopped; SIGINT ends it as well."""
    with daemon(tmp_path, "mac23", "--json") as process:
        ready = process.event()
        endpoint = {"endpoint": "pty", "url": "./mac23"}
        assert ready == {
            "event": "ready",
            "device": "mac23:0",
            **endpoint,
            "endpoints": [endpoint],
        }
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            assert process.event() == {"event": "connected", **endpoint}
            assert len(ask(port, request(0x20), 21)) == 21
        assert process.event() == {"event": "disconnected", **endpoint, "dropped_bytes": 0}
        status, out, _ = process.end(signal.SIGINT)
        assert status == 0
        assert json.loads(out)["event"] == "stopped"


def test_run_serves_several_endpoints_at_once(tmp_path: Path) -> None:
    """A pty, TCP and RFC 2217 on free ports: one line, told in one ready line."""
    with daemon(
        tmp_path, "mac23", "--pty", "p", "--tcp", "127.0.0.1:0", "--rfc2217", "127.0.0.1:0"
    ) as process:
        words = process.line().split()
        assert words[:3] == ["ready", "mac23:0", "pty=p"]
        urls = dict(word.split("=", 1) for word in words if "=" in word)
        assert urls["tcp"].startswith("socket://127.0.0.1:")
        assert urls["rfc2217"].startswith("rfc2217://127.0.0.1:")
        for url in (str(tmp_path / "p"), urls["tcp"]):
            with serial.serial_for_url(url, 38400, timeout=TIMEOUT_S) as port:
                assert len(ask(port, request(0x20), 21)) == 21


def test_what_was_stored_is_there_at_the_next_start(tmp_path: Path) -> None:
    """``--state`` keeps an address that was programmed, over a violent end too."""
    arguments = ("mac23", "--state", "memory")
    with daemon(tmp_path, *arguments) as process:
        process.line()
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            assert ask(port, request(0x08, 0x25), 3) == ACCEPTED
        process.process.kill()
        process.process.wait(TIMEOUT_S)
    with daemon(tmp_path, *arguments) as process:
        process.line()
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            assert len(ask(port, request(0x20, address=0x25), 21)) == 21
        status, _, err = process.end()
        assert status == 0
        assert "address 37 (asked for: 0)" in err
        assert "memory ends" not in err


def test_the_ready_line_names_the_address_that_is_stored(tmp_path: Path) -> None:
    """And one warning line each tells what was asked for instead, and of modules that collide."""
    state = ("--state", "memory", "--pty", "line")
    with daemon(tmp_path, "mac23", *state) as process:
        process.line()
        with serial.Serial(str(tmp_path / "line"), 38400, timeout=TIMEOUT_S) as port:
            assert ask(port, request(0x08, 5), 3) == ACCEPTED
        process.end()
    with daemon(tmp_path, "mac23", "mac34-1:5", "--baud", "9600", *state) as process:
        assert process.line().startswith("ready mac23:5 pty=line ")
        assert process.line().startswith("ready mac34-1:5 pty=line ")
        _, _, err = process.end()
    memory = "address 5 (asked for: 0) and 38400 baud (asked for: 9600)"
    rates = "mac23:0 at 38400 baud, mac34-1:5 at 9600 baud"
    assert err.splitlines() == [
        f"axistwin: mac23:0: its memory has {memory}, and that holds",
        "axistwin: mac23:0 and mac34-1:5 answer on top of one another: address 5",
        f"axistwin: {rates}: no client understands all of them",
    ]


def test_a_client_at_the_wrong_rate_is_told_of_and_seen_in_the_capture(tmp_path: Path) -> None:
    """One hint and one event for each of its rates; bytes that nobody can understand say so."""
    capture = tmp_path / "line.txt"

    def notes() -> list[str]:
        rows = capture.read_text("utf-8").splitlines()
        return [row for row in rows if "not understood: sent at 9600, the module listens" in row]

    with daemon(tmp_path, "mac23", "--json", "--capture", "line.txt") as process:
        process.event()
        with serial.Serial(str(tmp_path / "mac23"), 9600, timeout=0.1) as port:
            assert process.event()["event"] == "connected"
            for count in (1, 2):  # each is looked at before the client does anything else
                ask(port, request(0x20), 21)
                assert eventually(lambda: len(notes()) == count)  # noqa: B023
            told = process.event()
            port.baudrate = 38400
            port.timeout = TIMEOUT_S
            port.reset_input_buffer()
            assert len(ask(port, request(0x20), 21)) == 21
        assert process.event()["event"] == "disconnected"
        _, _, err = process.end()
    assert told == {
        "event": "wrong_rate",
        "endpoint": "pty",
        "url": "./mac23",
        "baud": 9600,
        "module_bauds": [38400],
    }
    assert err.count("./mac23: a client sends at 9600, the module listens at 38400") == 1
    assert len(notes()) == 2
    assert all(request(0x20).hex(" ").upper() in row for row in notes())
    assert "position" in capture.read_text("utf-8").splitlines()[-1]


def test_quirks_come_from_a_profile_and_the_command_line(tmp_path: Path) -> None:
    """``--quirk`` beats ``--profile``."""
    (tmp_path / "old.toml").write_text(
        'model = "mac23"\n[quirks]\nxon_byte = "11h"\nversion_word = 1\n', encoding="utf-8"
    )
    arguments = ("--profile", "old.toml", "--quirk", "version_word=2")
    with daemon(tmp_path, "mac23", *arguments) as process:
        process.line()
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            answer = ask(port, request(0x24), 21)
        assert answer[-1] == 0x11
        assert answer[9:17] == b"00000002"


@pytest.mark.parametrize(("speed", "is_deaf"), [("0.01", True), ("100", False)])
def test_a_cold_start_is_deaf_for_two_seconds_of_the_twin_s(
    tmp_path: Path, speed: str, is_deaf: bool
) -> None:
    """200 s at a hundredth of the speed, 20 ms at a hundred times: asked for longer than 2 s."""
    with daemon(tmp_path, "mac23", "--cold", "--speed", speed, "--no-pacing") as process:
        process.line()
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=0.3) as port:
            began_s = time.monotonic()
            answer = b""
            while not answer and time.monotonic() - began_s < (2.5 if is_deaf else TIMEOUT_S):
                answer = ask(port, request(0x20), 21)
    assert answer == b"" if is_deaf else answer


def test_another_rate_than_the_factory_s_may_be_given(tmp_path: Path) -> None:
    """``--baud 9600``: heard at 9600 only, which is what the pty starts with."""
    with daemon(tmp_path, "mac23", "--baud", "9600") as process:
        process.line()
        with serial.Serial(str(tmp_path / "mac23"), 9600, timeout=TIMEOUT_S) as port:
            assert len(ask(port, request(0x20), 21)) == 21
            port.baudrate, port.timeout = 38400, 0.1
            assert len(ask(port, request(0x20), 21)) < 21


def test_capture_writes_what_was_said_with_its_meaning(tmp_path: Path) -> None:
    """One line per frame, each way; a second run appends."""
    for _ in range(2):
        with daemon(tmp_path, "mac23", "--capture", "line.txt") as process:
            process.line()
            with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
                ask(port, request(0x20), 21)
            process.end()
    remark, question, answer = (tmp_path / "line.txt").read_text("utf-8").splitlines()[3:]
    assert remark.startswith("# 2")
    assert f"> {request(0x20).hex(' ').upper()}  " in question
    assert "< 06 13 02" in answer
    assert "position" in question
    assert "position" in answer


def test_a_capture_that_cannot_begin_is_one_clear_line(tmp_path: Path) -> None:
    """``--capture /dev/full``: nothing runs without the recording asked for."""
    link = str(tmp_path / "mac23")
    result = invoke("run", "mac23", "--pty", link, "--capture", "/dev/full")
    assert_one_clear_line(result, "/dev/full", "No space left")
    assert not os.path.lexists(link)


def test_a_disk_that_fills_up_ends_the_capture_and_not_the_daemon(tmp_path: Path) -> None:
    """It is said once, as a line and as an event, and by status 2 at the end."""
    script = (
        "import resource, signal, sys; from axistwin.cli.main import main;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300)); main()"
    )
    arguments = ("mac23", "--json", "--capture", "line.txt")
    with daemon(tmp_path, *arguments, program=("-c", script)) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
            for _ in range(5):
                assert len(ask(port, request(0x20), 21)) == 21
                time.sleep(0.1)  # the recording is flushed
        names = [process.event()["event"] for _ in range(3)]
        assert sorted(names) == ["capture_lost", "connected", "disconnected"]
        status, _, err = process.end()
    assert status == 2
    assert err.count("capture line.txt: cannot be written any more (File too large)") == 1
    assert "Traceback" not in err


def test_standard_output_that_is_full_is_one_clear_line(tmp_path: Path) -> None:
    """``models`` fails with it; ``run`` goes on serving, and says so."""
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "axistwin"]
        listed = subprocess.run(
            [*command, "models"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
        assert listed.returncode == 2
        assert listed.stderr.count("\n") == 1
        assert "standard output cannot be written (No space left" in listed.stderr
        with daemon(tmp_path, "mac23", stdout=full) as process:
            assert process.process.stderr is not None
            said = [process.process.stderr.readline() for _ in range(2)]
            assert any("standard output cannot be written" in line for line in said)
            with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
                assert len(ask(port, request(0x20), 21)) == 21
            status, _, err = process.end()
            assert (status, err) == (2, "")


@pytest.mark.parametrize("abstract", [False, True], ids=["path", "abstract"])
def test_systemd_is_told(tmp_path: Path, abstract: bool) -> None:
    """READY=1 when clients can connect, STOPPING=1 at the end."""
    name = f"@axistwin-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name[1:] if abstract else name)
        manager.settimeout(TIMEOUT_S)
        with daemon(tmp_path, "mac23", environment={"NOTIFY_SOCKET": name}) as process:
            assert manager.recv(100) == b"READY=1"
            assert (tmp_path / "mac23").is_char_device()
            process.end()
            assert manager.recv(100) == b"STOPPING=1"


def test_a_reader_of_stdout_that_goes_away_does_not_end_the_daemon(tmp_path: Path) -> None:
    """``axistwin run … --json | head -1`` leaves a daemon that still serves."""
    with daemon(tmp_path, "mac23", "--json") as process:
        process.line()
        assert process.process.stdout is not None
        process.process.stdout.close()
        for _ in range(3):
            with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
                assert len(ask(port, request(0x20), 21)) == 21
        process.process.stdout = None
        assert process.end()[0] == 0


def test_the_end_of_the_terminal_ends_it_cleanly(tmp_path: Path) -> None:
    """SIGHUP removes the link as the other signals do."""
    with daemon(tmp_path, "mac23") as process:
        process.line()
        assert process.end(signal.SIGHUP)[0] == 0
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize(
    "place", ["axistwin.runtime.storage.Storage.slot", "axistwin.ports.link.Path.replace"]
)
def test_a_signal_during_the_start_ends_it_cleanly(
    tmp_path: Path, number: signal.Signals, place: str
) -> None:
    """While the memory is read, or the link just made: status 0, no traceback, nothing left."""
    owner, method = place.rsplit(".", 1)
    module, name = owner.rsplit(".", 1)
    script = (
        f"import os, sys, time\nfrom {module} import {name} as owner\n"
        f"from axistwin.cli.main import main\nwhole = owner.{method}\n"
        f"def stopped(*arguments):\n    os.kill(os.getpid(), {int(number)})\n"
        f"    time.sleep(0.01)\n    return whole(*arguments)\n"
        f"owner.{method} = stopped\nmain()\n"
    )
    with daemon(tmp_path, "mac23", "--state", "memory", program=("-c", script)) as process:
        _, err = process.process.communicate(timeout=TIMEOUT_S)
    assert process.process.returncode == 0
    assert "Traceback" not in err
    assert [path.name for path in tmp_path.iterdir()] == ["memory"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("module", ["axistwin.cli.run.serial", "axistwin.ports.pty"])
def test_a_signal_amid_an_import_is_no_mistake_of_the_module(
    tmp_path: Path, number: signal.Signals, module: str
) -> None:
    """What a descriptor's __set_name__ raises, Python makes a RuntimeError of."""
    script = (
        "import importlib.abc, os, sys\nfrom axistwin.cli.main import main\n"
        "class Interrupt(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path, target=None):\n"
        f"        if name == {module!r}:\n"
        "            sys.meta_path.remove(self)\n"
        "            class Name:\n"
        "                def __set_name__(self, owner, name):\n"
        f"                    os.kill(os.getpid(), {int(number)})\n"
        "                    for _ in range(1000): pass\n"
        "            class Owner:\n"
        "                name = Name()\n"
        "sys.meta_path.insert(0, Interrupt())\nmain()\n"
    )
    with daemon(tmp_path, "mac23", "--state", "memory", program=("-c", script)) as process:
        _, err = process.process.communicate(timeout=TIMEOUT_S)
    assert process.process.returncode in (0, 130, -signal.SIGTERM)
    assert err == ""
    assert {path.name for path in tmp_path.iterdir()} <= {"memory"}


def test_a_signal_at_any_moment_of_the_start_leaves_nothing(tmp_path: Path) -> None:
    """Whenever it comes, from the first millisecond on."""
    for delay_ms in range(0, 200, 20):
        with daemon(tmp_path, "mac23") as process:
            time.sleep(delay_ms / 1000)
            status, _, err = process.end(signal.SIGTERM)
            assert status in (0, -signal.SIGTERM)
            assert "Traceback" not in err
            assert list(tmp_path.iterdir()) == []


def test_a_second_daemon_on_the_same_link_or_memory_is_refused(tmp_path: Path) -> None:
    """Each says what is in use; the first goes on."""
    with daemon(tmp_path, "mac23", "--state", "memory") as process:
        process.line()
        link, memory = str(tmp_path / "mac23"), str(tmp_path / "memory")
        assert_one_clear_line(invoke("run", "mac23", "--pty", link), link, "in use")
        other = str(tmp_path / "other")
        result = invoke("run", "mac23", "--pty", other, "--state", memory)
        assert_one_clear_line(result, memory, "in use")
        assert not os.path.lexists(other)
        with serial.Serial(link, 38400, timeout=TIMEOUT_S) as port:
            assert len(ask(port, request(0x20), 21)) == 21


def test_the_daemon_is_ready_soon(tmp_path: Path) -> None:
    """Until the first answer it takes few times the processor time that its imports take."""

    def spent_s() -> float:
        usage = resource.getrusage(resource.RUSAGE_CHILDREN)
        return usage.ru_utime + usage.ru_stime

    took = []
    for _ in range(3):
        begin = spent_s()
        subprocess.run([sys.executable, "-c", "import axistwin.cli.main, serial"], check=True)
        import_s, begin = spent_s() - begin, spent_s()
        with daemon(tmp_path, "mac23", "--no-pacing") as process:
            process.line()
            with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
                assert len(ask(port, request(0x20), 21)) == 21
        took.append((spent_s() - begin) / import_s)
    assert min(took) < 5.0


# -- mistakes -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("run",), ["which devices", "axistwin models"]),
        (("run", "mac233"), ["mac233", "mac23"]),
        (("run", "mac23:80h"), ["80h", "mac23", "7Fh"]),
        (("run", "mac23:128"), ["128", "127"]),
        (("run", "mac23:x"), ["'x'"]),
        (("run", "mac23", "--quirk", "xon_bite=11h"), ["xon_bite", "xon_byte"]),
        (("run", "mac23", "--quirk", "xon_byte=12h"), ["xon_byte", "12h", "1Ah, 11h"]),
        (("run", "mac23", "--quirk", "xon_byte"), ["xon_byte", "NAME=VALUE"]),
        (("run", "mac23", "--baud", "1234"), ["1234", "38400"]),
        (("run", "mac23", "--baud", "fast"), ["--baud", "fast"]),
        (("run", "mac23", "--speed", "0"), ["speed", "0"]),
        (("run", "mac23", "--tcp", "5000"), ["5000", "HOST:PORT"]),
        (("run", "mac23", "--profile", "missing.toml"), ["missing.toml"]),
        (("run", "mac23", "--pty", "nowhere/mac"), ["nowhere", "create it first"]),
        (("run", "mac23", "--capture", "nowhere/log"), ["nowhere/log"]),
        (("run", "mac23", "--pty", ""), ["--pty", "needs a name"]),
        (("run", "mac23", "--state", ""), ["--state", "needs a name"]),
        (("run", "mac23", "--capture", ""), ["--capture", "needs a name"]),
        (("run", "mac23", "--seed", "-1"), ["--seed", "-1", "x>=0"]),
        (("run", "mac23", "--frobnicate"), ["--frobnicate", "axistwin run --help"]),
        (("rnu", "mac23"), ["rnu", "run"]),
        (("models", "mac233"), ["mac233", "did you mean mac23? known: mac23, mac34-1, mac34-2"]),
        (("run", "MAC23"), ["'MAC23'", "did you mean mac23?"]),
        (("run", "mac34"), ["'mac34'", "did you mean mac34-1 or mac34-2?"]),
        (("run", "zzz"), ["'zzz': known: mac23, mac34-1, mac34-2"]),
        (("run", "mac23", "mac23-can:2"), ["mac23-can:2", "CAN bus", "serial line", "each"]),
        (("run", "mac23", "--quirk", "zzz=1"), ["'zzz': see 'axistwin models mac23'"]),
        (("run", "mac23", "--tcp"), ["requires an argument; see 'axistwin run --help'"]),
        (("run", "mac23", "--quirk", "XON_BYTE=11h"), ["did you mean xon_byte?"]),
        ((), ["axistwin --help"]),
    ],
)
def test_a_mistake_is_one_clear_line_and_status_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], parts: list[str]
) -> None:
    """It names the value, what is allowed or known, and nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    assert_one_clear_line(invoke(*arguments), *parts)
    assert list(tmp_path.iterdir()) == []


def test_a_port_in_use_is_one_clear_line(tmp_path: Path) -> None:
    """The address and the remedy are named."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"127.0.0.1:{other.getsockname()[1]}"
        assert_one_clear_line(invoke("run", "mac23", "--tcp", address), address, "in use")


def test_a_state_file_that_cannot_be_read_is_one_clear_line(tmp_path: Path) -> None:
    """And it stays as it is."""
    (tmp_path / "mac23-0.state").write_bytes(b"not ours")
    result = invoke("run", "mac23", "--pty", str(tmp_path / "p"), "--state", str(tmp_path))
    assert_one_clear_line(result, "mac23-0.state")
    assert (tmp_path / "mac23-0.state").read_bytes() == b"not ours"


def test_an_unknown_host_is_told_apart_from_a_port_in_use() -> None:
    """Another port would not help."""
    result = invoke("run", "mac23", "--tcp", "nosuchhost.invalid:5000")
    assert_one_clear_line(result, "nosuchhost.invalid:5000: no such host", "127.0.0.1")


def test_listening_for_other_machines_is_allowed_with_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever can reach the port can drive the twin."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("axistwin.runtime.serving.rack.Rack.run", lambda self, **_: self.close())
    result = invoke("run", "mac23", "--tcp", "0.0.0.0:0")
    assert result.exit_code == 0
    assert "0.0.0.0: whoever reaches this address can drive the twin" in result.stderr


def test_a_bug_of_ours_is_a_traceback_and_status_70(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is dressed up as the user's mistake."""

    def fail() -> None:
        raise AssertionError("impossible")

    monkeypatch.setattr(catalog, "models", fail)
    result = invoke("models")
    assert result.exit_code == 70
    assert "Traceback" in result.stderr
    assert "impossible" in result.stderr


# -- models, help, commands of others -----------------------------------------------------------


def test_version_and_help() -> None:
    """Both go to stdout with status 0."""
    assert invoke("--version").stdout == f"axistwin {__version__}\n"
    for command in ((), ("run",), ("models",), ("doctor",)):
        result = invoke(*command, "--help")
        assert result.exit_code == 0
        assert result.stdout.startswith("Usage: axistwin")


def test_python_m_axistwin_is_the_same_program() -> None:
    """``python -m axistwin``."""
    command = [sys.executable, "-m", "axistwin", "--version"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == (
        f"axistwin {__version__}\n"
    )


@click.command()
@click.pass_context
def added(ctx: click.Context) -> None:
    """Do what another distribution does."""
    ctx.exit(3)


def entry_point(name: str, value: str) -> EntryPoint:
    """A command as a distribution announces it."""
    return EntryPoint(name=name, value=value, group=program.COMMAND_GROUP)


def test_commands_of_other_distributions_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are listed, run, and keep their own exit status."""
    point = entry_point("added", "ignored:added")
    monkeypatch.setattr(EntryPoint, "load", lambda self: added)
    monkeypatch.setattr(program, "_added", lambda: [point])
    assert "Do what another distribution does." in invoke("--help").stdout
    assert invoke("added").exit_code == 3


def test_a_command_whose_extra_is_missing_names_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One clear line with what to type in a clone or beside a wheel; the rest still works."""

    def load(self: EntryPoint) -> None:
        raise ModuleNotFoundError("No module named 'hypothesis'", name="hypothesis")

    monkeypatch.setattr(EntryPoint, "load", load)
    monkeypatch.setattr(program, "_added", lambda: [entry_point("conform", "nowhere:conform")])
    assert_one_clear_line(invoke("conform"), "pip install 'hypothesis>=", "'jinja2>=", "'rich>=")
    assert "not available" in invoke("--help").stdout
    assert invoke("models").exit_code == 0
