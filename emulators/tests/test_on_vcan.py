"""The tests that need a kernel with CAN, run on one: in the virtual machine of ``scripts/vm``."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TIME_S = 1500

pytestmark = [
    pytest.mark.strength(seconds=500),
    pytest.mark.skipif("AXISTWIN_VM" in os.environ, reason="this is the virtual machine"),
]


@pytest.mark.parametrize("folder", ["emulators/tests/vm", "conformance/tests/vm"])
def test_what_needs_vcan_passes_where_there_is_one(folder: str) -> None:
    """A machine that cannot start fails as well: its message says what is missing."""
    command = [sys.executable, "scripts/vm.py", "--timeout", str(TIME_S), sys.executable]
    command += ["-m", "pytest", "-m", "vcan", "-p", "no:cacheprovider", folder]
    done = subprocess.run(
        command,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=TIME_S + 60,
        check=False,
    )
    told = done.stdout[-10_000:] + done.stderr[-2_000:]
    assert done.returncode == 0, told
    summary = re.search(r"=+ (\d+) passed in", done.stdout)
    assert summary is not None, told
