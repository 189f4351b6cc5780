"""Both stored programs of a board, whenever its daemon is killed: each whole, never torn."""

import contextlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
import serial
from daemon_process import TIMEOUT_S, daemon
from kill_rounds import Served, survive_kills
from stored_values import Mn400Memory


@contextlib.contextmanager
def stored(folder: Path) -> Iterator[Served]:
    """What a board keeps."""
    quick = ("--quirk", "response_delay_ms=0", "--no-pacing", "--json")
    arguments = ("mn400", "--pty", "./pty", "--state", "./state", *quick)
    with daemon(folder, *arguments) as process:
        assert process.event()["event"] == "ready"
        with serial.Serial(str(folder / "pty"), 9600, timeout=TIMEOUT_S) as port:
            yield Served([process.process.pid], [Mn400Memory(port)])


@pytest.mark.strength(seconds=10)
def test_programs_are_whole_however_often_the_daemon_is_killed(tmp_path: Path) -> None:
    """After kill -9 each is the one whose end was acknowledged, or the one begun since."""
    survive_kills(partial(stored, tmp_path), sample=12, seed=20180601)


@pytest.mark.strength
def test_a_torn_program_is_noticed(tmp_path: Path) -> None:
    """A line that is missing or of another program fails the test above."""
    with stored(tmp_path) as served:
        (memory,) = served.memories
        assert {memory.read(cell) for cell in memory.cells} == {0}
    with daemon(tmp_path, "mn400", "--pty", "./pty", "--no-pacing", "--json") as process:
        process.event()
        with serial.Serial(str(tmp_path / "pty"), 9600, timeout=TIMEOUT_S) as port:
            board = Mn400Memory(port)
            mixed = [*board.lines_of(0, 8)[:-1], board.lines_of(0, 17)[-1]]
            for line in ("Z", *mixed, "\x04"):
                board.order(line)
            with pytest.raises(AssertionError, match="torn program"):
                board.read(board.PROGRAM)
            board.order("L1,2,3,4")
            with pytest.raises(AssertionError, match="torn configuration"):
                board.read(board.CONFIGURATION)
