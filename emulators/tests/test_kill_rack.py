"""Nothing acknowledged is lost when a rack with every model, busy on every line, is killed."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import can
import pytest
import serial
from daemon_process import TIMEOUT_S, Daemon
from kill_rounds import Served, survive_kills
from rack_process import next_event, ready, reload, serve, workers_of
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


ALTERED = RACK.replace("pacing = false", "pacing = false\nseed = 1")
"""Every line anew, with the memory that it had."""
LINES = {"rs485", "msc", "mn400", "can"}


@contextlib.contextmanager
def values_in(folder: Path) -> Iterator[list[StoredValues]]:
    """What all devices of a rack that is served there store."""
    with contextlib.ExitStack() as stack:

        def port(name: str, rate: int) -> serial.Serial:
            path = str(folder / name)
            return stack.enter_context(serial.Serial(path, rate, timeout=TIMEOUT_S))

        bus = can.Bus(interface="slcan", channel=str(folder / "can"), sleep_after_open=0)
        try:
            yield [
                MacMemory(port("rs485", 38400), (0, 5, 6)),
                MscMemory(port("msc", 9600)),
                Mn400Memory(port("mn400", 9600)),
                CanMemory(bus, (1, 2)),
            ]
        finally:
            with contextlib.suppress(can.CanError, OSError):  # it is gone
                bus.shutdown()


@contextlib.contextmanager
def stored(folder: Path, workers: int) -> Iterator[Served]:
    """A rack of its own, by so many workers; killed in the end, of which no worker is left."""
    with serve(folder, RACK, workers) as rack:
        ready(rack, DEVICES)
        with values_in(folder) as memories:
            yield Served([rack.process.pid], memories)


@contextlib.contextmanager
def stored_again(folder: Path, rack: Daemon) -> Iterator[Served]:
    """A rack that goes on, of which a worker is killed; SIGHUP then begins every line again."""
    with values_in(folder) as memories:
        yield Served([each.pid for each in workers_of(rack)], memories)
    next_event(rack, "line_failed")
    served = (folder / "rack.toml").read_text()
    assert set(reload(rack, folder, ALTERED if served == RACK else RACK)["added"]) == LINES


@pytest.mark.strength(seconds=40)
@pytest.mark.parametrize("workers", [1, 2])
def test_nothing_acknowledged_is_lost_when_a_busy_rack_is_killed(
    tmp_path: Path, workers: int
) -> None:
    """Every value whose write was acknowledged, on any model, is read back after a restart."""
    survive_kills(partial(stored, tmp_path, workers), sample=4, seed=20170523)


@pytest.mark.strength(seconds=15)
def test_nothing_acknowledged_is_lost_when_a_busy_worker_is_killed(tmp_path: Path) -> None:
    """Nor of what the other one serves; all is read back when the rack has begun it again."""
    with serve(tmp_path, RACK, 2) as rack:
        ready(rack, DEVICES)
        survive_kills(partial(stored_again, tmp_path, rack), sample=4, seed=20170524)
        assert rack.end()[0] == 0
