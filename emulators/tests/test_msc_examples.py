"""The three machines of ``fixtures/macroprograms``, driven through a full cycle by their hosts."""

import os
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from axistwin.testing import StartedTwin

pytestmark = pytest.mark.system

FOLDER = Path(__file__).parents[2] / "fixtures" / "macroprograms"
SPEED = 5

LIFT = (
    "0 108 395 853 1464 2228 3093 4027 5000 5973 6908 7772 8536 9148 9605 9892 10000 "
    "9892 9605 9148 8536 7772 6908 5973 5000 4027 3093 2228 1464 853 395 108"
)
SAW = " ".join(str((625 * check + 1) // 2) for check in range(32))  # of points 250 apart

STORIES = {
    "indexing_table": [
        "program running: True",
        *(f"station {station % 8} at {station % 8 * 4500}" for station in range(1, 9)),
        "cycles: 8 clamp fault: False",
        "program running: False",
    ],
    "cut_to_length": [
        "5 of 5 pieces of 1250: 1253 1253 1253 1253 1253",
        "stock: 93735 fault: False",
        "2 of 4 pieces of 777: 782 782",
        "stock: 0 fault: True",
    ],
    "cam_follower": [
        f"table 1 {LIFT}",
        f"table 0 {SAW}",
        f"table 1 {LIFT}",
        "program running: True",
    ],
}

Starter = Callable[..., StartedTwin]


def told_by_host(machine: str, port: str) -> list[str]:
    """What the host program of ``machine`` prints when it drives ``port``."""
    done = subprocess.run(
        [sys.executable, FOLDER / f"{machine}_host.py", port],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("machine", STORIES)
def test_each_machine_goes_through_its_cycle_in_virtual_time(machine: str) -> None:
    """Behind the URL that the host program names."""
    url = f"axistwin://msc-250?program={FOLDER / machine}.py&time=virtual"
    assert told_by_host(machine, url) == STORIES[machine]


@pytest.mark.parametrize("machine", STORIES)
def test_each_machine_goes_through_the_same_cycle_on_a_pty(axistwin: Starter, machine: str) -> None:
    """Whenever the host happens to ask."""
    twin = axistwin("msc-250", program=FOLDER / f"{machine}.py", time=SPEED)
    assert told_by_host(machine, twin.port) == STORIES[machine]


def test_a_machine_runs_in_any_model(axistwin: Starter) -> None:
    """The commands that the hosts use are known to all."""
    twin = axistwin("msc-generic", program=FOLDER / "indexing_table.py", time="virtual")
    twin.flags["start"] = True
    twin.advance(3)
    assert (twin.flags["done"], twin.variables["station"]) == (True, 1)


def test_a_clamp_that_does_not_close_is_told(axistwin: Starter) -> None:
    """What the machine's model cannot do, a hand can: the fault branch of the table."""
    twin = axistwin("msc-250", program=FOLDER / "indexing_table.py", time="virtual")
    twin.advance(0.2)
    assert twin.flags["clamped"]
    twin.flags["start"] = True
    twin.advance(0.75)  # it has moved and begins to clamp
    assert twin.flags["clamp"]
    for _ in range(60):
        twin.flags["clamp"] = False  # somebody has shut the valve
        twin.advance(0.01)
    assert twin.flags["clamp_fault"]
    assert not twin.flags["done"]


def test_a_host_that_is_late_is_not_confused(axistwin: Starter) -> None:
    """An answer that is repeated is thrown away; nothing is done twice."""
    msc_host = runpy.run_path(str(FOLDER / "msc_host.py"))
    twin = axistwin("msc-250", program="bench", time="virtual")
    host = msc_host["Msc"](twin.port)
    host.port.write = lambda data, write=host.port.write: data == b"\x06" or write(data)
    for turn in range(1, 4):
        host.set_flag(240)
        twin.advance(1.5)  # without an ACK the answer to ``read`` is repeated meanwhile
        assert host.read(6144) == turn
    twin.advance(3)
    assert host.flag(240) is False


def test_the_description_of_the_machines_names_all_files() -> None:
    """And no other."""
    page = (FOLDER / "README.md").read_text(encoding="utf-8")
    for path in FOLDER.glob("*.py"):
        assert f"`{path.name}`" in page, path.name
