"""The first host program of the README, unchanged, on a pty and in virtual time."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import serial
from mac_frames import ACCEPTED, ANSWER_LENGTH, answer_value, request

import axistwin as _axistwin  # noqa: F401  registers the URL scheme
from axistwin.testing import StartedTwin

pytestmark = pytest.mark.system

HOST_PROGRAM = Path(__file__).parents[2] / "fixtures" / "first-exchange" / "host.py"
MOVE_NS = 9_920_080 * 125  # 10000 increments, P = 800, AA = 10 (ledger 5.3)
EXCHANGE_NS = 11_937_500  # 21 bytes there, 1 ms, 21 bytes back, at 38400
HOUR_S = 3600
LONGEST_S = 240  # of a program that takes five seconds, on the busiest machine

Starter = Callable[..., StartedTwin]


def run_host_program(port: str) -> str:
    """What the program prints when it drives ``port``."""
    result = subprocess.run(
        [sys.executable, str(HOST_PROGRAM), port],
        capture_output=True,
        text=True,
        check=False,
        timeout=LONGEST_S,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def assert_story(printed: str) -> int:
    """The program saw what a MAC23 does; gives the number of polls during the move."""
    moved, burst, surplus, stopped = printed.splitlines()
    polls = re.fullmatch(r"moved to 10000 after (\d+) polls", moved)
    assert polls, moved
    assert burst.endswith("06131a 06131a 06131a 06131a 061317"), burst
    assert re.fullmatch(r"the surplus segment was accepted after \d+ more refusals", surplus)
    assert stopped == "stopped at 12001 status 00020000"
    return int(polls[1])


def test_the_program_tells_its_story_on_a_pty(axistwin: Starter) -> None:
    """Move, poll, a refused fifth segment, and a software stop, over a real pty."""
    polls = assert_story(run_host_program(axistwin("mac23").port))
    # An exchange takes at least its time on the line, so there is no room for more polls than this.
    assert 0 < polls <= MOVE_NS // EXCHANGE_NS + 1


def test_the_program_tells_the_same_story_in_virtual_time() -> None:
    """Only the URL differs; the number of polls is what the line allows, to one."""
    polls = assert_story(run_host_program("axistwin://mac23?address=0&time=virtual"))
    assert MOVE_NS // EXCHANGE_NS <= polls <= MOVE_NS // EXCHANGE_NS + 1


def test_the_program_ends_where_nobody_answers() -> None:
    """With a word, and not never."""
    url = "axistwin://mac23?address=5&time=virtual"
    command = [sys.executable, str(HOST_PROGRAM), url]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LONGEST_S)
    assert ended.returncode == 1
    assert ended.stderr == "no whole reply to 02h: nothing\n"


@pytest.mark.parametrize("where", ["pty", "virtual"])
def test_a_move_takes_the_time_of_the_formula(axistwin: Starter, where: str) -> None:
    """From acknowledgement to the first poll at the target: the formula, to an exchange or two."""
    twin = axistwin("mac23", time="real" if where == "pty" else where)
    with serial.serial_for_url(twin.port, baudrate=38400, timeout=1) as port:

        def now_ns() -> int:
            return int(getattr(port, "virtual_time_ns", time.monotonic_ns()))

        def send(index: int, parameter: int, length: int = 3) -> bytes:
            port.write(request(index, parameter))
            return bytes(port.read(length))

        for index, parameter in ((0x02, 0), (0x0D, 800), (0x0F, 10)):
            assert send(index, parameter) == ACCEPTED
        begin = now_ns()
        assert send(0x13, 10_000) == ACCEPTED
        while answer_value(send(0x20, 0, ANSWER_LENGTH)) != 10_000:
            pass
        took = now_ns() - begin
    assert took >= MOVE_NS
    if where == "virtual":
        assert took <= MOVE_NS + 3 * EXCHANGE_NS


def test_an_hour_of_motion_takes_milliseconds() -> None:
    """A move of an hour, looked at every minute, arrives at the tick that the formula gives."""
    url = "axistwin://mac23?address=0&time=virtual"
    with serial.serial_for_url(url, baudrate=38400, timeout=0.5) as port:

        def send(index: int, parameter: int, length: int = 3) -> bytes:
            port.write(request(index, parameter))
            return bytes(port.read(length))

        assert send(0x0F, 0) == ACCEPTED  # no ramp: each increment takes P
        assert send(0x0D, 0xFFFF) == ACCEPTED
        distance = HOUR_S * 8_000_000 // 0xFFFF
        begin = time.process_time()
        assert send(0x13, distance) == ACCEPTED
        port.timeout = 60
        for _ in range(HOUR_S // 60 - 1):
            assert port.read(1) == b""
        assert 0 < answer_value(send(0x20, 0, ANSWER_LENGTH)) < distance
        assert port.read(1) == b""
        assert answer_value(send(0x20, 0, ANSWER_LENGTH)) == distance
        assert time.process_time() - begin < 1
