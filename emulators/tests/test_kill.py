"""Nothing acknowledged is lost when the daemon is killed at any moment."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request

ROUNDS = 200
WRITTEN = {0x09: 0x22, 0x0A: 0x23}  # command that stores a 32-bit value: query that reads it


@contextlib.contextmanager
def daemon(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """A twin on a pty with its memory in ``folder``; killed without a word at the end."""
    command = [sys.executable, "-m", "axistwin", "run", "mac23:0", "--pty", str(folder / "pty")]
    command += ["--state", str(folder / "state"), "--no-pacing", "--json"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as twin:
        assert twin.stdout is not None
        line = twin.stdout.readline()
        if not line:
            assert twin.stderr is not None
            pytest.fail(f"the daemon did not start: {twin.stderr.read()}")
        assert json.loads(line)["event"] == "ready"
        try:
            yield twin
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(twin.pid, signal.SIGKILL)


def exchange(port: serial.SerialBase, frame: bytes, length: int) -> bytes:
    """Send ``frame`` and read ``length`` bytes, fewer when the twin is gone."""
    port.write(frame)
    return bytes(port.read(length))


def read_back(port: serial.SerialBase, query: int) -> int:
    """The 32-bit value that ``query`` answers with."""
    return answer_value(exchange(port, request(query), ANSWER_LENGTH))


def write_until_killed(
    port: serial.SerialBase, rng: random.Random, known: dict[int, int]
) -> dict[int, set[int]]:
    """Write random values until the twin dies; the values each cell may hold afterwards."""
    admissible = {index: {value} for index, value in known.items()}
    with contextlib.suppress(serial.SerialException, OSError):
        while True:
            index = rng.choice(list(WRITTEN))
            value = rng.getrandbits(31)  # positive, so that it reads back as written
            admissible[index].add(value)
            if exchange(port, request(index, value), 3) != ACCEPTED:
                break
            admissible[index] = {value}
    return admissible


@pytest.mark.slow
def test_nothing_acknowledged_is_lost_when_the_daemon_is_killed_200_times(tmp_path: Path) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    rng = random.Random(20060612)
    admissible: dict[int, set[int]] = {}
    acknowledged = 0
    for round_number in range(ROUNDS):
        with daemon(tmp_path) as twin:
            with serial.Serial(str(tmp_path / "pty"), 38400, timeout=2) as port:
                now = {index: read_back(port, query) for index, query in WRITTEN.items()}
                for index, values in admissible.items():
                    assert now[index] in values, (round_number, index, hex(now[index]))
                killer = threading.Timer(
                    rng.uniform(0.0, 0.08), os.kill, (twin.pid, signal.SIGKILL)
                )
                killer.start()
                admissible = write_until_killed(port, rng, now)
                killer.join()
            acknowledged += sum(values != {now[i]} for i, values in admissible.items())
    assert acknowledged > ROUNDS // 4, "the kills came before anything was written"


@pytest.mark.slow
def test_a_position_that_was_reported_while_moving_is_not_lost_by_a_kill(tmp_path: Path) -> None:
    """After kill -9 in a move the axis stands no further back than the host was last told."""
    with daemon(tmp_path) as twin, serial.Serial(str(tmp_path / "pty"), 38400, timeout=2) as port:
        assert exchange(port, request(0x13, 100_000), 3) == ACCEPTED
        begin = time.monotonic()
        told = 0
        while time.monotonic() - begin < 0.7:
            told = read_back(port, 0x20)
        os.kill(twin.pid, signal.SIGKILL)
    assert told > 0
    with daemon(tmp_path), serial.Serial(str(tmp_path / "pty"), 38400, timeout=2) as port:
        restored = read_back(port, 0x20)
    assert told <= restored <= told + 10_000
