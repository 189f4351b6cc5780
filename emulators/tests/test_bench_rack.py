"""scripts/bench rack: 300 devices in one process, all of which answer beside driven ones."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.strength(seconds=60)

ROOT = Path(__file__).parents[2]
MOST_KIB = 30.0


def test_300_devices_answer_beside_50_driven_ones_and_a_flood() -> None:
    """Each costs little memory; how quick they are is told, and not judged here."""
    command = [sys.executable, "-m", "scripts.bench", "rack", "--seconds", "0.05"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "rack: 300 devices of 9 models" in ran.stdout
    assert float(re.findall(r"memory: ([\d.]+) KiB per further device", ran.stdout)[0]) < MOST_KIB
    load = re.findall(r"load: 50 devices, (\d+) exchanges/s; garbage (\d+) bytes/s", ran.stdout)
    assert all(int(number) > 0 for number in load[0])
    assert "200 quiet devices asked under load: all have answered" in ran.stdout
    table, _, workers = ran.stdout.partition("  workers: ")
    assert len(re.findall(r"^  .*\d\.\d\d$", table, re.MULTILINE)) == 5
    rates = re.findall(r"^  (?:one process|two workers) +(\d+) requests/s", workers, re.MULTILINE)
    assert len(rates) == 2
    assert all(int(rate) > 0 for rate in rates)
    assert ran.stderr == ""
