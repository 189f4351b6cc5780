"""``axistwin ctl`` against a daemon: in this process, from a shell, and an old program's life."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "how-to" / "work-a-daemon.md"
SCRIPT = Path(__file__).parent / "support" / "old_program.sh"
RUN = ("--control", "127.0.0.1:0", "--json")
RACK = """
control.address = "127.0.0.1:0"
line = [{ name = "line", devices = "mac23", pty = "./mac23" }]
bus = [{ name = "bus", devices = "mac23-can", slcan = "./mac23-can" }]
"""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where a daemon with a MAC23 and a MAC34 is worked."""
    folder = tmp_path_factory.mktemp("daemon")
    with daemon(folder, "mac23:0", "mac34-1:5", "--pty", "./line", *RUN) as process:
        yield process.event()["control"].removeprefix("http://")


def environment(address: str) -> dict[str, str]:
    """What a shell has that works the daemon at ``address``."""
    scripts = str(Path(sys.executable).parent)
    path = f"{scripts}:{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "AXISTWIN_CONTROL": address}


def said(address: str, *words: str) -> str:
    """What the command says; it is done."""
    result = invoke("ctl", *words, "--control", address)
    assert result.exit_code == 0, result.output
    return result.stdout


def test_devices_and_controls_are_listed(address: str) -> None:
    """A line each, with values, units and limits."""
    assert said(address).splitlines() == [
        "mac23:0        pty=./line  power on, at rest, unpowered",
        "mac34-1:5      pty=./line  power on, at rest, unpowered",
    ]
    rows = [row.split() for row in said(address, "mac34-1").splitlines()]
    assert ["inputs.reference", "off"] in rows
    assert ["supply_volts", "48", "0..1000", "V"] in rows
    assert ["!", "position", "0", "increments"] in rows


def test_values_are_read_and_set(address: str) -> None:
    """Of any kind; a number may be negative; the other device stays as it is."""
    for name, word, shown in (
        ("inputs.negative_stop", "on", "on"),
        ("inputs.negative_stop", "OFF", "off"),
        ("supply_volts", "20.5", "20.5"),
        ("load.held", "yes", "on"),
        ("load.held", "no", "off"),
    ):
        assert said(address, "mac23:0", name, word) == ""
        assert said(address, "mac23:0", name) == f"{shown}\n"
    before = int(said(address, "mac23:0", "position"))
    said(address, "mac23:0", "push", "-25")
    assert int(said(address, "mac23:0", "position")) == before - 25
    assert said(address, "mac34-1:5", "supply_volts") == "48\n"


def test_power_is_switched(address: str) -> None:
    """Off, on, and a cycle of a given length."""
    said(address, "mac34-1", "power", "off")
    assert said(address, "mac34-1", "power") == "off\n"
    said(address, "mac34-1", "power", "on")
    done = json.loads(said(address, "mac34-1", "power", "cycle", "0.2", "--json"))
    assert done["on_time_ns"] - done["off_time_ns"] >= 200_000_000
    assert said(address, "mac34-1", "power") == "on\n"


def test_answers_are_json_for_programs(address: str) -> None:
    """What the API says."""
    devices = [json.loads(line) for line in said(address, "--json").splitlines()]
    assert [each["name"] for each in devices] == ["mac23:0", "mac34-1:5"]
    controls = [json.loads(line) for line in said(address, "mac23", "--json").splitlines()]
    assert controls[0]["name"] == "power"
    info = json.loads(said(address, "mac23", "supply_volts", "--json"))
    assert (info["unit"], info["high"]) == ("V", 1000.0)
    done = json.loads(said(address, "mac23", "inputs.reset", "off", "--json"))
    assert done["time_ns"] > 0


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("mac32:0",), ["no device 'mac32:0'", "did you mean mac23:0"]),
        (("mac23", "inputs.refrence"), ["did you mean inputs.reference"]),
        (("mac23", "inputs.reset", "of"), ["inputs.reset 'of'", "on or off"]),
        (("mac23", "supply_volts", "2000"), ["out of range", "0..1000 V"]),
        (("mac23", "supply_volts", "x"), ["'x' is no number"]),
        (("mac23", "push", "1.5"), ["'1.5' is no number"]),
        (("mac23", "position", "3"), ["only read"]),
        (("mac23", "push"), ["only worked, not read"]),
        (("mac23", "inputs.reset", "on", "off"), ["2 values"]),
        (("mac23", "power", "cylce"), ["did you mean cycle"]),
        (("mac23", "power", "off", "3"), ["too many words"]),
        (("mac23", "power", "cycle", "60"), ["off_s", "20"]),
        (("mac23", "watch", "positoin"), ["did you mean position"]),
        (("mac23", "--jsn"), ["no option --jsn"]),
    ],
)
def test_a_mistake_is_one_clear_line(
    address: str, words: tuple[str, ...], parts: list[str]
) -> None:
    """With the nearest name, or what is allowed."""
    assert_one_clear_line(invoke("ctl", *words, "--control", address), *parts)


def test_where_no_daemon_is_the_line_says_how_to_start_one() -> None:
    """Nobody, an address that is none, and somebody else."""
    assert_one_clear_line(invoke("ctl", "--control", "127.0.0.1:1"), "127.0.0.1:1", "axistwin run")
    assert_one_clear_line(invoke("ctl", "--control", "here"), "HOST:PORT")


def test_a_missing_extra_is_told_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One line, and no run without its control API."""
    for name in ("server", "listener", "application"):
        monkeypatch.delitem(sys.modules, f"axistwin.control.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    result = invoke("run", "mac23", "--pty", str(tmp_path / "p"), "--control", "127.0.0.1:0")
    assert_one_clear_line(result, "uvicorn is missing", "pip install 'fastapi", "'uvicorn")


def test_names_are_completed(address: str, tmp_path: Path) -> None:
    """Devices, controls and values, as the shell asks for them; nothing without a daemon."""

    def completed(line: str, at: str) -> list[str]:
        words = line.split(" ")
        done = subprocess.run(
            [sys.executable, "-m", "axistwin"],
            env={
                **environment(at),
                "_AXISTWIN_COMPLETE": "bash_complete",
                "COMP_WORDS": line,
                "COMP_CWORD": str(len(words) - 1),
            },
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
            timeout=TIMEOUT_S,
        )
        assert done.stderr == ""
        return [row.partition(",")[2] for row in done.stdout.split()]

    assert completed("axistwin ctl mac2", address) == ["mac23:0"]
    assert completed("axistwin ctl mac23:0 inputs.p", address) == ["inputs.positive_stop"]
    assert completed("axistwin ctl mac23:0 inputs.reset o", address) == ["on", "off"]
    assert completed("axistwin ctl mac23:0 power c", address) == ["cycle"]
    assert completed("axistwin ctl mac2", "127.0.0.1:1") == []


def test_what_is_watched_is_told_as_it_changes(address: str, tmp_path: Path) -> None:
    """Values first, then changes only; Ctrl-C ends it."""
    watching = subprocess.Popen(
        [sys.executable, "-m", "axistwin", "ctl", "mac34-1", "watch", "temperature_celsius"],
        env=environment(address),
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert watching.stdout is not None
    row = r" +\d+\.\d{3} mac34-1:5 temperature_celsius "
    assert re.fullmatch(f"{row}25\n", watching.stdout.readline())
    said(address, "mac34-1", "temperature_celsius", "40")
    assert re.fullmatch(f"{row}40\n", watching.stdout.readline())
    watching.send_signal(signal.SIGINT)
    out, err = watching.communicate(timeout=TIMEOUT_S)
    assert (out, err.strip(), watching.returncode) == ("", "", 130)


def test_a_watcher_is_told_that_the_daemon_has_ended(tmp_path: Path) -> None:
    """One line, and exit status 2; events as JSON before."""
    with daemon(tmp_path, "mac23", *RUN) as process:
        address = process.event()["control"].removeprefix("http://")
        watching = subprocess.Popen(
            [sys.executable, "-m", "axistwin", "ctl", "mac23", "watch", "--json"],
            env=environment(address),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert watching.stdout is not None
        assert json.loads(watching.stdout.readline())["event"] == "snapshot"
        process.end()
    _, err = watching.communicate(timeout=TIMEOUT_S)
    assert watching.returncode == 2
    assert "it has ended" in err
    assert err.count("\n") == 1


@pytest.mark.strength(seconds=40)
def test_an_old_program_lives_its_whole_life_against_a_daemon(tmp_path: Path) -> None:
    """Home, limit, fault, a lost supply, and an emergency on CAN: all provoked from a shell."""
    (tmp_path / "rack.toml").write_text(RACK)
    with daemon(tmp_path, "rack.toml", "--json", command="rack") as process:
        address = [process.event() for _ in range(2)][1]["control"].removeprefix("http://")
        done = subprocess.run(
            ["bash", str(SCRIPT)],
            cwd=tmp_path,
            env=environment(address),
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines() == [*("home", "limit", "fault", "supply", "emergency", "alive")]


def shown_commands() -> Iterator[tuple[str, str]]:
    """The commands of the page's part "From a shell", each with what it says."""
    part = PAGE.read_text(encoding="utf-8").partition("## From a shell")[2].partition("\n## ")[0]
    (block,) = re.findall(r"```console\n(.*?)```", part, re.DOTALL)
    for text in block.split("$ ")[1:]:
        command, _, output = text.partition("\n")
        yield command, output


def test_the_commands_of_the_page_do_what_it_says(tmp_path: Path) -> None:
    """One after the other, as a reader types them, who is soon enough to see the start-up."""
    commands = list(shown_commands())
    assert len(commands) > 8
    with daemon(tmp_path, "mac23", *RUN, "--speed", "0.1") as process:
        address = process.event()["control"].removeprefix("http://")
        for command, output in commands:
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=tmp_path,
                env=environment(address),
                capture_output=True,
                text=True,
                check=False,
                timeout=TIMEOUT_S,
            )
            assert (done.returncode, done.stdout, done.stderr) == (0, output, ""), command
