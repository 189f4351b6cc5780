"""Both stored programs of a board, whenever its daemon is killed: each whole, never torn."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial
from daemon_process import daemon
from kill_rounds import Memory, survive_kills
from mn400_bench import in_short, packets_in

from axistwin.devices.mn400.link.packets import packet

PROGRAM, CONFIGURATION = range(2)
OPENING = ("Z", ".")
END = ("\x04", "Q")
DONE_BYTES = 12
PRESENT = bytes.fromhex("81 2A 16 00 81 42")
MASKS = (0, 0x2AAAAAAA, 0x55555555, 0x33333333)
"""What the four counters of one configuration differ by: then they tell whether it is whole."""


def lines_of(cell: int, value: int) -> list[str]:
    """A program or a configuration of some lines, each of which tells the value."""
    count = 1 + value % 9
    if cell == PROGRAM:
        return [f"M{value},{number},{count}" for number in range(count)]
    loads = ["L" + "," * axis + str(value ^ mask) for axis, mask in enumerate(MASKS)]
    return [*loads, *(f"B{number}" for number in range(count))]


def ask(port: serial.SerialBase, line: str) -> list[str]:
    """What a command and a poll behind it are answered with, in short, without START."""
    port.write(packet(1, line.encode()) + packet(1, b"*"))
    heard = bytes(port.read_until(PRESENT))
    if not heard.endswith(PRESENT):
        raise EOFError
    return [in_short(raw) for raw in packets_in(heard)][1:-2]


def read_back(port: serial.SerialBase, cell: int) -> int:
    """The value whose lines are stored; 0: none are.  Anything between is torn."""
    if cell == PROGRAM:
        lines = ask(port, "R")
        value = int(lines[0][1:].split(",")[0]) if lines else 0
        assert lines == (lines_of(cell, value) if lines else []), "a torn program"
        return value
    counters = [int(text) for text in ask(port, "E")[0].split(",")]
    value = counters[0]
    whole = [value ^ mask for mask in MASKS] if any(counters) else counters
    assert counters == whole, "a torn configuration"
    return value


def write(port: serial.SerialBase, cell: int, value: int) -> bool:
    """Store its lines; whether the end of the entry was acknowledged."""
    lines = [OPENING[cell], *lines_of(cell, value), END[cell]]
    port.write(b"".join(packet(1, line.encode()) for line in lines))
    heard = bytes(port.read(DONE_BYTES * len(lines)))
    if len(heard) < DONE_BYTES * len(lines):
        return False
    assert {in_short(raw) for raw in packets_in(heard)} == {"S", "D"}
    return True


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Memory]:
    """What a board keeps."""
    quick = ("--quirk", "response_delay_ms=0", "--no-pacing", "--json")
    arguments = ("mn400", "--pty", "./pty", "--state", "./state", *quick)
    with daemon(folder, *arguments) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(folder / "pty"), 9600, timeout=2) as port:
            yield Memory(process.process.pid, partial(read_back, port), partial(write, port))


@pytest.mark.parametrize(
    "rounds",
    [
        pytest.param(12, marks=pytest.mark.strength(seconds=10)),
        pytest.param(200, marks=pytest.mark.soak),
    ],
)
def test_programs_are_whole_however_often_the_daemon_is_killed(tmp_path: Path, rounds: int) -> None:
    """After kill -9 each is the one whose end was acknowledged, or the one begun since."""
    cells = (PROGRAM, CONFIGURATION)
    survive_kills(partial(stored, tmp_path), cells, rounds=rounds, seed=20180601)


@pytest.mark.strength
def test_a_torn_program_is_noticed(tmp_path: Path) -> None:
    """A line that is missing or of another program fails the test above."""
    with stored(tmp_path) as memory:
        assert memory.read(PROGRAM) == memory.read(CONFIGURATION) == 0
    lines = [*lines_of(PROGRAM, 8)[:-1], lines_of(PROGRAM, 17)[-1]]
    with daemon(tmp_path, "mn400", "--pty", "./pty", "--no-pacing", "--json") as process:
        process.event()
        with serial.Serial(str(tmp_path / "pty"), 9600, timeout=2) as port:
            for line in ("Z", *lines, "\x04"):
                port.write(packet(1, line.encode()))
                port.read(DONE_BYTES)
            with pytest.raises(AssertionError, match="torn program"):
                read_back(port, PROGRAM)
            port.write(packet(1, b"L1,2,3,4"))
            port.read(DONE_BYTES)
            with pytest.raises(AssertionError, match="torn configuration"):
                read_back(port, CONFIGURATION)
