"""A family that lies in a folder of its own, somewhere on Python's path, and nowhere else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from axistwin import discovery

pytestmark = pytest.mark.system

TOY = Path(__file__).parent / "support" / "toy_twin"
FAMILY = TOY / "axistwin" / "devices" / "toy"
LINES_MAX = 200


def run(*command: str, cwd: Path, given: str = "") -> subprocess.CompletedProcess[str]:
    """Run Python with the folder on its path."""
    environment = {**os.environ, "PYTHONPATH": str(TOY)}
    return subprocess.run(
        [sys.executable, *command],
        cwd=cwd,
        env=environment,
        input=given,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def test_a_fifth_family_is_listed_after_the_others(tmp_path: Path) -> None:
    """With its quirks; without the folder it is not there."""
    listed = run("-m", "axistwin", "models", cwd=tmp_path)
    rows = listed.stdout.splitlines()[1:]
    names = [row.split()[0] for row in rows if not row.startswith(" ")]  # others are continued
    assert names == [*discovery.models(), "toy"]
    detailed = run("-m", "axistwin", "models", "toy", "all", cwd=tmp_path)
    assert "acknowledge = K    [TOY-AMB-01]" in detailed.stdout
    assert "keeps_level = true    [TOY-AMB-02]" in detailed.stdout
    assert "toy" not in discovery.models()


def test_a_fifth_family_is_decoded(tmp_path: Path) -> None:
    """Both directions, from standard input."""
    done = run("-m", "axistwin", "decode", "toy", cwd=tmp_path, given="3D 35 0A\n35 0A\n")
    assert [line.split("  ")[-1] for line in done.stdout.splitlines()] == ["level 5", "level 5"]


def test_a_fifth_family_runs_on_a_pty(tmp_path: Path) -> None:
    """Stored values outlive the run, quirks are obeyed."""
    program = (
        "import serial, subprocess, sys\n"
        "daemon = subprocess.Popen([sys.executable, '-m', 'axistwin', 'run', 'toy', '--quirk',\n"
        "    'acknowledge=A', '--state', 'memory'], stdout=subprocess.PIPE, text=True)\n"
        "print(daemon.stdout.readline().split(' (')[0])\n"
        "with serial.Serial('toy', timeout=5) as port:\n"
        "    port.write(b'=7\\n?\\n')\n"
        "    print(port.read(3))\n"
        "daemon.terminate()\n"
        "daemon.communicate()\n"
        "print(daemon.returncode)\n"
    )
    done = run("-c", program, cwd=tmp_path)
    assert done.stdout.splitlines() == ["ready toy:0 pty=./toy", "b'A7\\n'", "0"], done.stderr


def test_a_fifth_family_is_behind_the_url(tmp_path: Path) -> None:
    """In virtual time."""
    program = (
        "import axistwin, serial\n"
        "port = serial.serial_for_url('axistwin://toy?time=virtual', timeout=1)\n"
        "port.write(b'=3\\n')\n"
        "print(port.read(1), port.twins[0].level, port.twins[0].state)\n"
        "port.twins[0].press()\n"
        "port.write(b'?\\n')\n"
        "print(port.read(2))\n"
    )
    done = run("-W", "error", "-c", program, cwd=tmp_path)
    assert done.stdout.splitlines() == ["b'K' 3 on", "b'0\\n'"], done.stderr


def test_a_fifth_family_works_in_the_fixture(tmp_path: Path) -> None:
    """Attributes, controls, mistakes, power, and what a failing test is told."""
    (tmp_path / "test_lamp.py").write_text(
        "import pytest, serial\n"
        "from axistwin.errors import UsageError\n"
        "def test_lamp(axistwin):\n"
        "    twin = axistwin('toy', time='virtual', quirks={'keeps_level': False})\n"
        "    port = serial.serial_for_url(twin.port, timeout=1)\n"
        "    port.write(b'=4\\n')\n"
        "    assert port.read(1) == b'K'\n"
        "    assert twin.level == twin.controls['level'].value == twin.describe()['level'] == 4\n"
        "    with pytest.raises(UsageError, match='a lamp and has no inputs: that is for a'):\n"
        "        twin.inputs\n"
        "    twin.power_cycle()\n"
        "    assert twin.level == 0\n"
        "def test_transcript(axistwin):\n"
        "    twin = axistwin('toy', time='virtual')\n"
        "    serial.serial_for_url(twin.port).write(b'?\\n')\n"
        "    twin.advance(1)\n"
        "    assert False\n"
    )
    done = run("-m", "pytest", "-p", "no:cacheprovider", "-q", cwd=tmp_path)
    assert "1 failed, 1 passed" in done.stdout
    assert "axistwin toy:0 on axistwin://" in done.stdout
    assert "level?" in done.stdout


def test_the_price_of_a_family_is_known() -> None:
    """One folder, three files of substance, less than this many lines."""
    lines = {path.name: len(path.read_text().splitlines()) for path in FAMILY.glob("*.py")}
    assert set(lines) == {"__init__.py", "family.py", "device.py", "controls.py"}
    assert sum(lines.values()) < LINES_MAX
