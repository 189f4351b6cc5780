"""Nothing acknowledged is lost when a rack with every model, busy on every line, is killed."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import can
import pytest
import serial
from daemon_process import TIMEOUT_S, daemon
from kill_rounds import Served, survive_kills
from stored_values import CanMemory, MacMemory, Mn400Memory, MscMemory, StoredValues

pytestmark = pytest.mark.strength

RACK = """
state = "./state"

[[line]]
name = "rs485"
devices = ["mac23:0", "mac34-1:5", "mac34-2:6"]
pty = "./rs485"
pacing = false

[[line]]
name = "msc"
devices = "msc-250"
pty = "./msc"
pacing = false
quirks = { response_delay_ms = 0, reply_delay_ms = 0 }

[[line]]
name = "mn400"
devices = "mn400"
pty = "./mn400"
pacing = false
quirks = { response_delay_ms = 0 }

[[bus]]
name = "can"
devices = ["mac23-can:1", "mac23-can:2"]
slcan = "./can"
pacing = false
"""
DEVICES = 7


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Served]:
    """What all devices of the rack store; killed in the end."""
    (folder / "rack.toml").write_text(RACK)
    with contextlib.ExitStack() as stack:
        process = stack.enter_context(daemon(folder, "rack.toml", "--json", command="rack"))
        assert [process.event()["event"] for _ in range(DEVICES)] == ["ready"] * DEVICES

        def port(name: str, rate: int) -> serial.Serial:
            path = str(folder / name)
            return stack.enter_context(serial.Serial(path, rate, timeout=TIMEOUT_S))

        bus = can.Bus(interface="slcan", channel=str(folder / "can"), sleep_after_open=0)
        memories: list[StoredValues] = [
            MacMemory(port("rs485", 38400), (0, 5, 6)),
            MscMemory(port("msc", 9600)),
            Mn400Memory(port("mn400", 9600)),
            CanMemory(bus, (1, 2)),
        ]
        try:
            yield Served(process.process.pid, memories)
        finally:
            with contextlib.suppress(can.CanError, OSError):  # it is gone
                bus.shutdown()


@pytest.mark.strength(seconds=15)
def test_nothing_acknowledged_is_lost_when_a_busy_rack_is_killed(tmp_path: Path) -> None:
    """Every value whose write was acknowledged, on any model, is read back after a restart."""
    survive_kills(partial(stored, tmp_path), sample=4, seed=20170523)
