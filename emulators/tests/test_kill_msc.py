"""Nothing a controller acknowledged is lost when the daemon is killed at any moment."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial
from daemon_process import TIMEOUT_S, daemon
from kill_rounds import Served, survive_kills
from stored_values import MscMemory

pytestmark = pytest.mark.strength

QUICK = (
    *("--quirk", "response_delay_ms=0", "--quirk", "reply_delay_ms=0"),
    *("--no-pacing", "--json"),
)


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Served]:
    """What a controller stores by DWRITE."""
    arguments = ("msc-250", "--pty", "./pty", "--state", "./state", *QUICK)
    with daemon(folder, *arguments) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(folder / "pty"), 9600, timeout=TIMEOUT_S) as port:
            yield Served([process.process.pid], [MscMemory(port)])


def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_60_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    survive_kills(partial(stored, tmp_path), sample=60, seed=19961201)
