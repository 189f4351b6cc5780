"""``axistwin doctor``: what the machine can do, and the remedy for what it cannot."""

import json
import os
from pathlib import Path
from typing import NoReturn

import pytest
from click.testing import CliRunner

from axistwin.cli import doctor
from axistwin.cli.doctor import Lack
from axistwin.cli.program import main
from axistwin.ports import socketcan
from axistwin.ports.hid import uhid

NEEDED = ["pseudo terminals", "inotify", "loopback TCP", "current folder"]


def refuse() -> NoReturn:
    """A check that fails."""
    raise Lack("broken", "mend it")


@pytest.mark.system
def test_every_check_says_ok_or_the_remedy() -> None:
    """No line without a finding, nothing missing without a remedy."""
    findings = doctor.examine()
    assert [finding.name for finding in findings if finding.needed] == NEEDED
    for finding in findings:
        assert finding.found
        assert finding.ok == (finding.remedy == "")


@pytest.mark.system
def test_a_machine_that_runs_these_tests_can_run_twins() -> None:
    """Status 0, whatever else is missing."""
    result = CliRunner().invoke(main, ["doctor"])
    assert result.exit_code == 0
    for name in NEEDED:
        assert f"ok        {name}" in result.stdout


@pytest.mark.parametrize("needed", [True, False])
def test_only_what_run_needs_makes_the_status_1(
    monkeypatch: pytest.MonkeyPatch, needed: bool
) -> None:
    """The remedy is shown in either case."""
    monkeypatch.setattr(doctor, "CHECKS", (("something", needed, refuse),))
    result = CliRunner().invoke(main, ["doctor"])
    assert result.exit_code == (1 if needed else 0)
    assert ("MISSING" in result.stdout) == needed
    assert ("optional" in result.stdout) == (not needed)
    assert "remedy: mend it" in result.stdout


def test_no_line_is_wider_than_80_columns_and_no_command_is_broken() -> None:
    """Each command of a remedy can be copied."""
    remedy = f"--slcan works without; on a kernel with CAN: {socketcan.REMEDY.format('vcan0')}"
    shown = doctor._shown(doctor.Finding("CAN interfaces", False, False, "none " * 20, remedy))
    lines = shown.splitlines()
    assert max(map(len, lines)) <= 80
    assert [line.strip() for line in lines[-3:]] == [
        "sudo modprobe vcan &&",
        "sudo ip link add vcan0 type vcan &&",
        "sudo ip link set vcan0 up",
    ]


def test_doctor_speaks_json(monkeypatch: pytest.MonkeyPatch) -> None:
    """One object per check."""
    monkeypatch.setattr(doctor, "CHECKS", (("something", False, refuse),))
    result = CliRunner().invoke(main, ["doctor", "--json"])
    assert json.loads(result.stdout) == {
        "name": "something",
        "ok": False,
        "needed": False,
        "found": "broken",
        "remedy": "mend it",
    }


def test_a_folder_that_cannot_be_written_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Even root cannot write to /proc."""
    monkeypatch.chdir("/proc")
    with pytest.raises(Lack, match="/proc cannot be written"):
        doctor.check_folder()


@pytest.mark.parametrize(
    ("has_can", "states", "found", "remedy"),
    [
        (False, {}, "the kernel has no CAN", "--slcan works without"),
        (True, {}, "there is no interface", "ip link add vcan0 type vcan"),
        (True, {"can0": "down"}, r"can0 \(down\)", "ip link set can0 up"),
    ],
)
def test_a_machine_without_a_can_bus_gets_the_remedy(
    monkeypatch: pytest.MonkeyPatch,
    has_can: bool,
    states: dict[str, socketcan.LinkState],
    found: str,
    remedy: str,
) -> None:
    """No CAN in the kernel, no interface, or none that is up."""
    monkeypatch.setattr(socketcan, "kernel_has_can", lambda: has_can)
    monkeypatch.setattr(socketcan, "interfaces", lambda: list(states))
    monkeypatch.setattr(socketcan, "link_state", lambda name: states.get(name, "absent"))
    with pytest.raises(Lack, match=found) as caught:
        doctor.check_can()
    assert remedy in caught.value.remedy


def test_can_interfaces_are_told_with_their_states(monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is up is enough."""
    states: dict[str, socketcan.LinkState] = {"vcan0": "up", "can0": "down"}
    monkeypatch.setattr(socketcan, "kernel_has_can", lambda: True)
    monkeypatch.setattr(socketcan, "interfaces", lambda: list(states))
    monkeypatch.setattr(socketcan, "link_state", lambda name: states[name])
    assert doctor.check_can() == "can0 (down), vcan0 (up)"


@pytest.mark.parametrize("is_installed", [True, False])
def test_what_multicast_needs_is_named(monkeypatch: pytest.MonkeyPatch, is_installed: bool) -> None:
    """python-can has it as an extra."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name: name if is_installed else None)
    if is_installed:
        assert doctor.check_python_can().endswith("virtual, udp_multicast")
        return
    with pytest.raises(Lack, match="not udp_multicast") as caught:
        doctor.check_python_can()
    assert caught.value.remedy == "pip install msgpack"


def test_a_serial_port_without_permission_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The remedy is the group that owns serial ports."""

    class Port:
        device = str(tmp_path / "ttyX")

    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [Port()])
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(Lack, match=r"no permission for .*ttyX") as caught:
        doctor.check_real_ports()
    assert "dialout" in caught.value.remedy


def test_what_usb_needs_is_told_for_either_side(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """/dev/uhid to be a device, hidraw to judge one; the object of this process needs neither."""
    monkeypatch.setattr(uhid, "UHID", tmp_path / "uhid")
    monkeypatch.setattr(doctor, "_HIDRAW_CLASS", tmp_path / "hidraw")
    with pytest.raises(Lack, match=r"no .*uhid; only 'run --hid' needs it") as caught:
        doctor.check_uhid()
    assert caught.value.remedy == "axistwin.hid works without; else: sudo modprobe uhid"
    with pytest.raises(Lack, match="kernel has no hidraw"):
        doctor.check_hidraw()
    (tmp_path / "uhid").touch()
    assert doctor.check_uhid() == "works"
    (tmp_path / "hidraw").mkdir()
    with pytest.raises(Lack, match="no HID device found"):
        doctor.check_hidraw()
    (tmp_path / "hidraw" / "hidraw3").touch()
    monkeypatch.setattr(os, "access", lambda path, mode: True)
    assert doctor.check_hidraw() == "/dev/hidraw3"
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(Lack, match="no permission for /dev/hidraw3") as caught:
        doctor.check_hidraw()
    assert caught.value.remedy == "run as root, or: sudo chown $USER /dev/hidraw3"
    with pytest.raises(Lack, match=r"no permission for .*uhid"):
        doctor.check_uhid()


def test_a_suite_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """And of what it needs, what is missing, by names that pip finds."""
    lacking: set[str] = {"hypothesis", "jinja2"}
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name in lacking else name)
    with pytest.raises(Lack, match="hypothesis, jinja2") as caught:
        doctor.check_suite()
    assert caught.value.remedy == "pip install hypothesis jinja2"
    lacking.add("axistwin_conformance")
    with pytest.raises(Lack, match="axistwin_conformance is missing"):
        doctor.check_suite()
