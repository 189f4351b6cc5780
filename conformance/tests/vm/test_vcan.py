"""A whole judgement over real SocketCAN; run where the kernel has it (``scripts/vm``)."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytestmark = pytest.mark.vcan

START_S = 30.0
JUDGEMENT_S = 900.0


@contextmanager
def twins(folder: Path) -> Iterator[None]:
    """Two twins on vcan0, in a process of their own."""
    command = [sys.executable, "-m", "axistwin", "run", "mac23-can:1", "mac23-can:2"]
    with subprocess.Popen(
        [*command, "--can", "socketcan:vcan0", "--json"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    ) as daemon:
        try:
            assert daemon.stdout is not None
            for _ in range(2):
                assert json.loads(daemon.stdout.readline())["event"] == "ready"
            yield
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait(START_S)


def test_the_twin_on_vcan0_conforms_in_full(tmp_path: Path) -> None:
    """Everything that the wire shows and nobody has to work a rig for, in real time."""
    command = [sys.executable, "-m", "axistwin", "conform", "mac23-can", "--can", "socketcan:vcan0"]
    command += ["--address", "1", "--neighbour", "2", "--allow", "motion,stored", "--level", "full"]
    with twins(tmp_path):
        judged = subprocess.run(
            command,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=JUDGEMENT_S,
            check=False,
        )
    assert judged.returncode == 0, judged.stdout[-8000:] + judged.stderr
    assert "The device conforms to mac23-can" in judged.stdout
