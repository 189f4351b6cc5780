"""``axistwin watch``: screens of any size, a terminal, and lines where there is none."""

import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke
from rich.console import Console

from axistwin.cli.watch.screen import DetailScreen, OverviewScreen, Screen, follow
from axistwin.control.client import ControlClient

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "watch-a-daemon.md"
AXES = {"names": ["axis"], "unit": "increments", "position": "position", "rate": "velocity"}
LEAVE_SCREEN = b"\x1b[?1049l"
SIZES = [(110, 30), (80, 24), (59, 24), (40, 10), (20, 4), (10, 1)]


def device(name: str) -> dict[str, Any]:
    """As the API has it."""
    return {"name": name, "power": True, "state": "at rest", "axes": AXES}


def control(name: str, unit: str = "", bits: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the screen takes of one."""
    told = [{"bit": bit, "name": each, "requirement": "X-1"} for bit, each in enumerate(bits)]
    return {"name": name, "unit": unit, "bits": told}


def changed(name: str, **values: Any) -> dict[str, Any]:
    """An event."""
    return {"event": "changed", "device": name, "time_ns": 1_500_000_000, "values": values}


def rendered(screen: Screen, width: int, height: int) -> list[str]:
    """The rows of a terminal."""
    console = Console(width=width, height=height, force_terminal=False)
    with console.capture() as capture:
        console.print(screen.render(width, height))
    return capture.get().splitlines()


def detail() -> DetailScreen:
    """A device with a bit that is on, a group of switches, and a queue."""
    controls = [control("faults", bits=("hot", "cold")), control("queued", "commands")]
    screen = DetailScreen(device("mac23:0"), controls)
    values = {"faults": 2, "queued": 3, "inputs.one": True, "inputs.two": False, "load.held": False}
    screen.receive(changed("mac23:0", **values))
    return screen


def overview(count: int = 3) -> OverviewScreen:
    """Devices with a position."""
    screen = OverviewScreen([device(f"mac23:{number}") for number in range(count)], device)
    screen.receive(changed("mac23:0", position=-125, velocity=2.5))
    return screen


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_screen_fits_every_terminal(width: int, height: int) -> None:
    """Nothing is wider or higher than it, for one device or many."""
    for screen in (overview(), overview(100), detail()):
        rows = rendered(screen, width, height)
        assert len(rows) <= max(3, height)
        assert all(len(row) <= width for row in rows)


def test_the_overview_has_state_position_and_speed() -> None:
    """Of a device without power it tells that; devices that do not fit are counted."""
    screen = overview(30)
    screen.receive(
        {"event": "set", "device": "mac23:1", "time_ns": 2, "control": "power", "value": False}
    )
    first, second, third = rendered(screen, 110, 24)[:3]
    assert first.split() == ["device", "state", "position", "speed"]
    assert re.split(r"\s{2,}", second.strip()) == [
        "mac23:0", "at rest", "-125 increments", "2.5 increments/s",
    ]  # fmt: skip
    assert third.split() == ["mac23:1", "power", "off"]
    assert "8 more" in rendered(screen, 110, 24)[-1]


def test_one_device_has_bits_by_name_and_what_is_on_of_a_group() -> None:
    """A switch alone stands for itself."""
    rows = [re.split(r"\s{2,}", row.strip()) for row in rendered(detail(), 60, 24)]
    assert rows[0] == ["mac23:0", "at rest", "1.5 s"]
    assert ["faults", "cold"] in rows
    assert ["queued", "3 commands"] in rows
    assert ["inputs", "one"] in rows
    assert ["load held", "off"] in rows


def test_events_are_below_the_values() -> None:
    """What was set, and what the device tells; each once."""
    screen = detail()
    told = {"event": "told", "device": "mac23:0", "time_ns": 2_000_000_000, "text": "it stops"}
    screen.receive(told)
    assert rendered(screen, 60, 24)[-1].split(maxsplit=1) == ["2.000", "mac23:0 it stops"]


def test_the_terminal_is_as_it_was_when_events_end(tmp_path: Path) -> None:
    """Also when they end with an error."""

    def events() -> Iterator[dict[str, Any]]:
        yield changed("mac23:0", position=1)
        raise ValueError("the end")

    target = tmp_path / "terminal"
    with target.open("w") as file, pytest.raises(ValueError, match="end"):
        follow(overview(), events(), Console(file=file, force_terminal=True, width=80, height=24))
    assert LEAVE_SCREEN in target.read_bytes()


# ---- the program ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Where a daemon with two modules is watched."""
    folder = tmp_path_factory.mktemp("daemon")
    run = ("--pty", "./line", "--control", "127.0.0.1:0", "--json")
    with daemon(folder, "mac23:0", "mac34-1:5", *run) as process:
        yield process.event()["control"].removeprefix("http://")


def command(*words: str) -> list[str]:
    """The program with these words."""
    return [sys.executable, "-m", "axistwin", "watch", *words]


@pytest.mark.system
def test_a_terminal_follows_a_device_until_ctrl_c(address: str) -> None:
    """What is set is seen; the screen is left, and nothing is said."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 40, 100, 0, 0))
    environment = {**os.environ, "TERM": "xterm", "AXISTWIN_CONTROL": address}
    process = subprocess.Popen(
        command("mac23"), stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, env=environment
    )
    os.close(theirs)
    seen = b""
    while b"none on" not in seen:
        seen += os.read(ours, 65536)
    assert invoke("ctl", "mac23", "inputs.reference", "on", "--control", address).exit_code == 0
    while b"inputs.reference on" not in seen:
        seen += os.read(ours, 65536)
    assert invoke("ctl", "mac23", "inputs.reference", "off", "--control", address).exit_code == 0
    process.send_signal(signal.SIGINT)
    while LEAVE_SCREEN not in seen:
        seen += os.read(ours, 65536)
    _, error = process.communicate(timeout=TIMEOUT_S)
    os.close(ours)
    assert (process.returncode, error.strip()) == (130, b"")
    assert b"mac34-1" not in seen


@pytest.mark.system
@pytest.mark.parametrize("words", [(), ("mac34-1",), ("http://{}",), ("http://{}/mac34-1:5",)])
def test_without_a_terminal_changes_are_lines(address: str, words: tuple[str, ...]) -> None:
    """Values first; a set is told once, and once again if it is set to the same."""
    given = [word.format(address) for word in words]
    environment = {
        **os.environ,
        "AXISTWIN_CONTROL": "127.0.0.1:1" if "{}" in str(words) else address,
    }
    process = subprocess.Popen(
        command(*given), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )
    assert process.stdout is not None
    lines = iter(process.stdout.readline, "")
    last = "mac34-1:5 stop_bits"
    assert any(last in line for line in lines)
    for value in ("41", "41", "42"):
        invoke("ctl", "mac34-1", "temperature_celsius", value, "--control", address)
    told = [re.sub(r"^ +[\d.]+ ", "", next(lines)).strip() for _ in range(3)]
    assert told == [f"mac34-1:5 temperature_celsius {value}" for value in (41, 41, 42)]
    process.send_signal(signal.SIGINT)
    out, error = process.communicate(timeout=TIMEOUT_S)
    assert (out, error.strip(), process.returncode) == ("", "", 130)


@pytest.mark.system
def test_the_page_shows_what_is_shown(address: str) -> None:
    """Each row of its screens is one of ours; its pipe gives the line."""
    overview, one, piped = re.findall(
        r"```console\n\$ (axistwin watch.*?)\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
    )
    client = ControlClient(address)
    devices = client.get("devices")["devices"]
    controls = client.get("devices", "mac23:0", "controls")["controls"]
    screens: list[Screen] = [OverviewScreen(devices, device), DetailScreen(devices[0], controls)]
    for screen, (command_line, text) in zip(screens, (overview, one), strict=True):
        assert command_line in ("axistwin watch", "axistwin watch mac23")
        for each in devices:
            state = client.get("devices", each["name"], "state")
            screen.receive({"event": "snapshot", **state})
        ours = [words_of(row) for row in rendered(screen, 80, 30)]
        assert [words for row in text.splitlines() if (words := words_of(row)) not in ours] == []
    environment = {**os.environ, "AXISTWIN_CONTROL": address}
    environment["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    process = subprocess.Popen(
        ["bash", "-c", piped[0]],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().split()[1:] == piped[1].split()[1:]
    os.killpg(process.pid, signal.SIGTERM)
    process.communicate(timeout=TIMEOUT_S)


def words_of(row: str) -> list[str]:
    """Its columns, without a time."""
    return re.split(r"\s{2,}", re.sub(r"[\d.]+ s$", "T", row.strip()))


@pytest.mark.system
def test_a_mistake_is_one_clear_line(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """No daemon, no such device, two addresses, and what is not installed."""
    nobody = invoke("watch", "http://127.0.0.1:1")
    assert_one_clear_line(nobody, "127.0.0.1:1", "no daemon answers", "axistwin run")
    unknown = invoke("watch", "mac32:0", "--control", address)
    assert_one_clear_line(unknown, "no device 'mac32:0'", "did you mean mac23:0")
    twice = invoke("watch", "http://127.0.0.1:1", "--control", address)
    assert_one_clear_line(twice, "leave out --control")
    monkeypatch.setitem(sys.modules, "websockets.sync.client", None)
    missing = invoke("watch", "--control", address)
    assert_one_clear_line(missing, "missing", "pip install")
