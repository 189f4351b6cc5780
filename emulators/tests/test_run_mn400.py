"""``axistwin run`` and the URL with an MN400, as the other families have them."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import serial
from daemon_process import TIMEOUT_S, daemon, invoke

import axistwin  # noqa: F401  registers the URL
from axistwin.devices.mn400.link.packets import packet

pytestmark = pytest.mark.system

SET = bytes.fromhex("81 2E 03 00 81 33 81 2E 05 00 81 35")


def ask(port: serial.Serial, number: int, line: bytes, size: int = 12) -> bytes:
    """Send a command, take its reply."""
    port.write(packet(number, line))
    return bytes(port.read(size))


def test_what_a_board_stores_outlives_its_process(tmp_path: Path) -> None:
    """A configuration entered in one run holds in the next."""
    with daemon(tmp_path, "mn400", "--state", "memory") as process:
        assert process.line().startswith("ready mn400:1 pty=./mn400 (/dev/")
        with serial.Serial(str(tmp_path / "mn400"), 9600, timeout=TIMEOUT_S) as port:
            assert ask(port, 1, b".") == SET
            assert len(ask(port, 1, b"=9")) == len(ask(port, 1, b"Q")) == 12
        status, _, err = process.end()
    assert (status, "Traceback" in err) == (0, False)
    with daemon(tmp_path, "mn400", "--state", "memory") as process:
        process.line()
        with serial.Serial(str(tmp_path / "mn400"), 9600, timeout=TIMEOUT_S) as port:
            assert ask(port, 9, b"*")[:2] == b"\x89*"
        assert process.end()[0] == 0


def test_a_capture_of_a_board_is_in_words(tmp_path: Path) -> None:
    """Requests and replies."""
    with daemon(tmp_path, "mn400:3", "--no-pacing", "--capture", "line.txt") as process:
        process.line()
        with serial.Serial(str(tmp_path / "mn400"), 9600, timeout=TIMEOUT_S) as port:
            assert len(ask(port, 3, b"L5,0,0,0")) == 12
        process.end()
    told = [row.split("  ")[-1] for row in (tmp_path / "line.txt").read_text("utf-8").splitlines()]
    assert told[1:] == [
        "LoadCount 5,0,0,0 (board 3)",
        "LoadCount: START (board 3); LoadCount: DONE (board 3)",
    ]


def test_a_board_behind_the_url_is_worked_by_its_controls() -> None:
    """Inputs, pots, USB, power; a rate beside 9600 is in its configuration program."""
    port: Any = serial.serial_for_url("axistwin://mn400?address=3&time=virtual", timeout=1)
    twin = port.twins[0]
    assert twin.configuration_lines == ["=3"]
    twin.inputs.m1_plus = True
    assert len(ask(port, 3, b"M5")) == 12
    assert (twin.exit_code, twin.inputs_status, twin.state) == (2, 2, "aborted")
    twin.feed_pot_percent = 12.5
    assert twin.feed_pot_percent == 12.5
    twin.send_usb("S")
    port.timeout = 0.1
    assert port.read(1) == b""
    assert twin.usb_reports == ["53 32"]
    twin.read_usb()
    assert twin.usb_reports == []
    twin.power_cycle()
    port.timeout = 1
    assert port.read(12) == bytes.fromhex("81 3D 03 00 81 42 83 3D 05 00 83 48")
    assert (twin.exit_code, twin.counters) == (0, [0, 0, 0, 0])
    fast: Any = serial.serial_for_url(
        "axistwin://mn400?time=virtual&baud=115200", 115200, timeout=1
    )
    assert ask(fast, 1, b"*")[-4:] == bytes.fromhex("16 00 81 42")
    assert fast.twins[0].configuration_lines == ["~4"]


def test_the_commands_of_the_page_on_the_mn100_do_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """DONE of the move comes in the pause behind it, and E has one number."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "run-mn100-programs.md"
    (run, *_), (send, *_) = (
        re.findall(rf"^\$ axistwin ({name} .*)$", page.read_text("utf-8"), re.MULTILINE)
        for name in ("run", "send")
    )
    monkeypatch.chdir(tmp_path)
    with daemon(tmp_path, *shlex.split(run)[1:]) as process:
        assert process.line().startswith("ready mn400:2 pty=./mn400 ")
        said = invoke(*shlex.split(send, comments=True)).stdout
        assert re.findall(r"Mover: (\w+)", said) == ["START", "DONE"]
        assert re.search(r"ReadPosition.* 1000 \(board 2\)\n$", said)
        assert process.end()[0] == 0
