"""scripts/bench panel: twenty boards that move, shown in a browser."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

pytestmark = [
    pytest.mark.strength(seconds=15),
    pytest.mark.skipif(
        not (shutil.which("chromium") or shutil.which("chromium-browser")),
        reason="needs chromium (apt-get install chromium)",
    ),
]


def test_both_pages_follow_twenty_boards() -> None:
    """What they show changes; how often, and how long it takes, is told, not judged here."""
    command = [sys.executable, "-m", "scripts.bench", "panel", "--seconds", "0.1"]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "panel: 20 boards, all axes moving" in ran.stdout
    rows = re.findall(r"^  (\S.*?) +([\d.]+) changes/s   longest task", ran.stdout, re.MULTILINE)
    assert [name for name, _ in rows] == ["overview", "page of a board"]
    assert all(float(rate) > 0 for _, rate in rows)
