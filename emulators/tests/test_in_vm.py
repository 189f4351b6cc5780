"""The tests that need a kernel with CAN or uhid, run on one: in the machines of ``scripts/vm``."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TIME_S = 1500
TWINS, SUITE = "emulators/tests/vm", "conformance/tests/vm"

pytestmark = pytest.mark.skipif("AXISTWIN_VM" in os.environ, reason="this is the virtual machine")


def passes(mark: str, machine: list[str], *places: str) -> None:
    """All tests of that mark pass; a machine that cannot start says what is missing."""
    command = [sys.executable, "scripts/vm.py", *machine, "--timeout", str(TIME_S), sys.executable]
    command += ["-m", "pytest", "-m", mark, "-p", "no:cacheprovider", *places]
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
    summary = re.search(r"=+ (\d+) passed[ ,]", done.stdout)
    assert summary is not None, told


@pytest.mark.strength(seconds=500)
@pytest.mark.parametrize("folder", [TWINS, SUITE])
def test_what_needs_vcan_passes_where_there_is_one(folder: str) -> None:
    """Real SocketCAN."""
    passes("vcan", [], folder)


@pytest.mark.strength(seconds=80)
def test_what_needs_uhid_passes_where_it_is() -> None:
    """Real hidraw; in one machine, and no file that is not needed, since code is slow in there."""
    passes("uhid", ["--uhid"], f"{TWINS}/test_uhid.py", f"{SUITE}/test_hidraw.py")
