"""Nothing acknowledged on a CAN bus is lost when the daemon is killed at any moment."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import can
import pytest
from daemon_process import Daemon, daemon
from kill_rounds import Served, survive_kills
from stored_values import CanMemory

pytestmark = pytest.mark.strength

MODULES = (1, 2)
POSITION, GO = 0x00, 0x13


@contextlib.contextmanager
def twins(folder: Path) -> Iterator[tuple[Daemon, can.BusABC]]:
    """Two modules with their memory in ``folder``, killed in the end, and a client."""
    modules = [f"mac23-can:{address}" for address in MODULES]
    options = ("--slcan", "./can", "--state", "./state", "--no-pacing", "--json")
    with daemon(folder, *modules, *options) as process:
        for _ in modules:
            assert process.event()["event"] == "ready"
        bus = can.Bus(interface="slcan", channel=str(folder / "can"), sleep_after_open=0)
        try:
            yield process, bus
        finally:
            with contextlib.suppress(can.CanError, OSError):  # it may be gone
                bus.shutdown()


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Served]:
    """What the modules store."""
    with twins(folder) as (process, bus):
        yield Served([process.process.pid], [CanMemory(bus, MODULES)])


@pytest.mark.strength(seconds=30)
def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_60_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    survive_kills(partial(stored, tmp_path), sample=60, seed=20061)


def test_a_position_that_was_reported_while_moving_is_not_lost_by_a_kill(tmp_path: Path) -> None:
    """After kill -9 in a move the axis stands no further back than the host was last told."""
    with twins(tmp_path) as (process, bus):
        assert CanMemory(bus, MODULES).order(2, GO, 100_000)
        begin_s = time.monotonic()
        told = 0
        while time.monotonic() - begin_s < 0.7:
            told = CanMemory(bus, MODULES).ask(2, POSITION)
        os.kill(process.process.pid, signal.SIGKILL)
    assert told > 0
    with twins(tmp_path) as (_, bus):
        restored = CanMemory(bus, MODULES).ask(2, POSITION)
    assert told <= restored <= told + 10_000
