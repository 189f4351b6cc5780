"""Nothing a controller acknowledged is lost when the daemon is killed at any moment."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial
from daemon_process import daemon
from kill_rounds import Memory, survive_kills
from msc_bench import ACK, dread, dwrite

pytestmark = pytest.mark.strength

ADDRESSES = (0, 2008, 0x7FFC)
QUICK = (
    *("--quirk", "response_delay_ms=0", "--quirk", "reply_delay_ms=0"),
    *("--no-pacing", "--json"),
)


def read_back(port: serial.SerialBase, address: int) -> int:
    """The value at ``address``."""
    port.write(dread(address))
    answer = bytes(port.read(19))
    port.write(ACK)
    return int.from_bytes(answer[-6:-2], "big", signed=True)


def write(port: serial.SerialBase, address: int, value: int) -> bool:
    """Store ``value``; whether that was acknowledged."""
    port.write(dwrite(address, value))
    return bytes(port.read(1)) == ACK


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Memory]:
    """What a controller stores by DWRITE."""
    arguments = ("msc-250", "--pty", "./pty", "--state", "./state", *QUICK)
    with daemon(folder, *arguments) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(folder / "pty"), 9600, timeout=2) as port:
            yield Memory(process.process.pid, partial(read_back, port), partial(write, port))


def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_60_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    survive_kills(partial(stored, tmp_path), ADDRESSES, rounds=60, seed=19961201)
