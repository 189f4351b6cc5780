"""Nothing acknowledged on a serial line is lost when the daemon is killed at any moment."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial
from daemon_process import TIMEOUT_S, Daemon, daemon
from kill_rounds import Served, survive_kills
from mac_frames import ACCEPTED, request
from stored_values import MacMemory

pytestmark = pytest.mark.strength

POSITION = 0x20


@contextlib.contextmanager
def twin(folder: Path) -> Iterator[tuple[Daemon, serial.SerialBase]]:
    """A twin on a pty with its memory in ``folder``, killed in the end, and a client."""
    arguments = ("mac23:0", "--pty", "./pty", "--state", "./state", "--no-pacing", "--json")
    with daemon(folder, *arguments) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(folder / "pty"), 38400, timeout=TIMEOUT_S) as port:
            yield process, port


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Served]:
    """What the twin stores."""
    with twin(folder) as (process, port):
        yield Served([process.process.pid], [MacMemory(port)])


@pytest.mark.strength(seconds=70)
def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_200_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    survive_kills(partial(stored, tmp_path), sample=200, seed=20060612)


def test_a_position_that_was_reported_while_moving_is_not_lost_by_a_kill(tmp_path: Path) -> None:
    """After kill -9 in a move the axis stands no further back than the host was last told."""
    with twin(tmp_path) as (process, port):
        assert MacMemory(port).exchange(request(0x13, 100_000), 3) == ACCEPTED
        begin = time.monotonic()
        told = 0
        while time.monotonic() - begin < 0.7:
            told = MacMemory(port).ask(POSITION)
        os.kill(process.process.pid, signal.SIGKILL)
    assert told > 0
    with twin(tmp_path) as (_, port):
        restored = MacMemory(port).ask(POSITION)
    assert told <= restored <= told + 10_000
