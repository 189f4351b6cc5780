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
from can_clients import message
from daemon_process import TIMEOUT_S, Daemon, daemon
from kill_rounds import Memory, survive_kills

from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.strength

MODULES = (1, 2)
WRITTEN = {0x09: 0x02, 0x0A: 0x03}  # download that stores a 32-bit value: upload that reads it
CELLS = [address << 8 | index for address in MODULES for index in WRITTEN]
POSITION, GO = 0x00, 0x13
DOWNLOAD, ACCEPTED, UPLOAD, READ = 0x23, 0x60, 0x40, 0x42


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


def exchange(bus: can.BusABC, address: int, command: int, index: int, value: int = 0) -> bytes:
    """The reply to an SDO request.  Raises EOFError or OSError when the daemon is gone."""
    data = bytes((command, index, 0x20, 0)) + value.to_bytes(4, "big")
    end_s = time.monotonic() + TIMEOUT_S
    try:
        bus.send(message(CanFrame(0x600 + address, data)))
        while (left_s := end_s - time.monotonic()) > 0:
            reply = bus.recv(left_s)
            if reply is not None and reply.arbitration_id == 0x580 + address:
                return bytes(reply.data)
    except can.CanError as error:
        raise EOFError from error
    raise EOFError(f"no reply from module {address}")


def read_back(bus: can.BusABC, address: int, index: int) -> int:
    """What the upload of ``index`` gives."""
    reply = exchange(bus, address, UPLOAD, index)
    assert reply[:4] == bytes((READ, index, 0x20, 0))
    return int.from_bytes(reply[4:], "big")


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Memory]:
    """What the modules store by the downloads of ``WRITTEN``."""
    with twins(folder) as (process, bus):

        def read(cell: int) -> int:
            return read_back(bus, cell >> 8, WRITTEN[cell & 0xFF])

        def write(cell: int, value: int) -> bool:
            return exchange(bus, cell >> 8, DOWNLOAD, cell & 0xFF, value)[0] == ACCEPTED

        yield Memory(process.process.pid, read, write)


@pytest.mark.strength(seconds=30)
def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_60_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    survive_kills(partial(stored, tmp_path), CELLS, rounds=60, seed=20061)


def test_a_position_that_was_reported_while_moving_is_not_lost_by_a_kill(tmp_path: Path) -> None:
    """After kill -9 in a move the axis stands no further back than the host was last told."""
    with twins(tmp_path) as (process, bus):
        assert exchange(bus, 2, DOWNLOAD, GO, 100_000)[0] == ACCEPTED
        begin_s = time.monotonic()
        told = 0
        while time.monotonic() - begin_s < 0.7:
            told = read_back(bus, 2, POSITION)
        os.kill(process.process.pid, signal.SIGKILL)
    assert told > 0
    with twins(tmp_path) as (_, bus):
        restored = read_back(bus, 2, POSITION)
    assert told <= restored <= told + 10_000
