"""``axistwin tap`` between programs and twins on real ptys: passed on, recorded, kill -9 or not."""

import contextlib
import errno
import os
import random
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from daemon_process import Daemon, assert_one_clear_line, daemon, invoke
from kill_rounds import GONE, KILLS, TELL_EACH, Killer

pytestmark = pytest.mark.system

SAMPLE = 5
QUERY = b"\x0201400200000000000A2\x03"
ANSWER_BYTES = 21


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where links and recordings are."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@contextlib.contextmanager
def tapped(folder: Path, *arguments: str) -> Iterator[Daemon]:
    """A tap that is ready."""
    with daemon(folder, *arguments, command="tap") as process:
        ready = process.line()
        assert ready.startswith("ready tap ./tap"), process.process.communicate()
        yield process


def recorded(direction: str, path: str = "capture.txt") -> bytes:
    """All bytes in one direction."""
    rows = Path(path).read_text("utf-8").splitlines()
    found = [re.fullmatch(r"\d+\.\d{6} ([<>]) ([0-9A-F ]+)", row) for row in rows if row[0] != "#"]
    assert all(found), rows
    return b"".join(bytes.fromhex(each[2]) for each in found if each and each[1] == direction)


def test_a_conversation_goes_through_and_is_replayed(folder: Path) -> None:
    """At the program's rate; both sides are recorded as they came, and decode explains them."""
    with (
        daemon(folder, "mac23") as twin,
        contextlib.nullcontext(twin.line()),
        tapped(folder, "./mac23", "capture.txt") as tap,
    ):
        with serial.Serial("./tap", 38400, timeout=10) as port:
            said = []
            for _ in range(3):
                port.write(QUERY)
                said.append(port.read(ANSWER_BYTES))
            port.write(QUERY[:-3] + b"A3\x03")
            said.append(port.read(1))
        status, _, errors = tap.end(signal.SIGINT)
    assert (status, errors) == (0, "")
    assert said[-1] == b"\x15"
    assert recorded("<") == b"".join(said)
    assert recorded(">") == QUERY * 3 + QUERY[:-3] + b"A3\x03"
    assert "# ./mac23 38400 8N1" in Path("capture.txt").read_text("utf-8")
    shown = invoke("decode", "mac23", "capture.txt")
    assert shown.exit_code == 0
    assert "20h position? -> module 0" in shown.stdout
    result = invoke("replay", "capture.txt", "--against", "mac23", "--window", "60000")
    assert result.exit_code == 0, result.output


def test_rate_and_stop_bits_are_followed(folder: Path) -> None:
    """Also those of a program that says nothing."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    with tapped(folder, name, "capture.txt", "--baud", "4800") as tap:
        with serial.Serial("./tap", 38400, stopbits=2, timeout=10) as port:
            path = Path("capture.txt")
            while f"# {name} 38400 8N2" not in path.read_text("utf-8"):
                time.sleep(0.01)
            os.write(master, b"abc")
            assert port.read(3) == b"abc"
        assert tap.end()[0] == 0
    assert path.read_text("utf-8").startswith(f"# {name} 4800 8N1\n# {name} 38400 8N2\n")
    os.close(master)
    os.close(slave)


def test_a_device_that_goes_away_is_reported(folder: Path) -> None:
    """In one line; what was said before is there."""
    with (
        daemon(folder, "mac23") as twin,
        contextlib.nullcontext(twin.line()),
        tapped(folder, "./mac23", "capture.txt") as tap,
        serial.Serial("./tap", 38400, timeout=10) as port,
    ):
        port.write(QUERY)
        answer = port.read(ANSWER_BYTES)
        twin.end(signal.SIGKILL)
        _, errors = tap.process.communicate(timeout=10)
    assert tap.process.returncode == 2
    assert errors.startswith("axistwin: ./mac23: ")
    assert len(errors.splitlines()) == 1
    assert recorded("<") == answer


def test_a_full_disk_does_not_stop_what_is_passed_on(folder: Path) -> None:
    """It is told once, and in the exit status."""
    with (
        daemon(folder, "mac23") as twin,
        contextlib.nullcontext(twin.line()),
        tapped(folder, "./mac23", "/dev/full") as tap,
    ):
        with serial.Serial("./tap", 38400, timeout=10) as port:
            for _ in range(2):
                port.write(QUERY)
                assert len(port.read(ANSWER_BYTES)) == ANSWER_BYTES
        status, _, errors = tap.end()
    assert status == 2
    assert errors.count(os.strerror(errno.ENOSPC)) == 1
    assert len(errors.splitlines()) == 1


def test_a_kill_loses_nothing_that_was_passed_on(folder: Path) -> None:
    """Whatever the program has heard is in the recording, and what it had said before that."""
    rounds = int(KILLS or SAMPLE)
    rng = random.Random(1)
    heard_bytes = 0
    with daemon(folder, "mac23", "--no-pacing") as twin:
        twin.line()
        for number in range(rounds):
            path = f"capture-{number}.txt"
            with (
                tapped(folder, "./mac23", path) as tap,
                serial.Serial("./tap", 38400, timeout=10) as port,
            ):
                killer = Killer(tap.process.pid, rng)
                heard, answered = b"", 0
                with contextlib.suppress(*GONE):
                    while True:
                        port.write(QUERY)
                        while len(heard) < (answered + 1) * ANSWER_BYTES:
                            data = port.read(1)
                            if not data:
                                raise EOFError
                            heard += data
                        answered += 1
                        killer.count()
                killer.join()
                tap.process.wait()
            assert recorded("<", path).startswith(heard)
            assert recorded(">", path).startswith(QUERY * answered)
            heard_bytes += len(heard)
            Path(path).unlink()
            if (number + 1) % TELL_EACH == 0 or number + 1 == rounds:
                print(f"{number + 1} kills, {heard_bytes} bytes heard", flush=True)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("./none", "capture.txt"), ("./none: No such file or directory",)),
        (("/dev/null", "capture.txt"), ("/dev/null", "Inappropriate ioctl")),
        (("nothing://x", "capture.txt"), ("nothing://x", "protocol")),
        (("loop://", "no/capture.txt"), ("no/capture.txt", "choose another file")),
        (("loop://", "capture.txt", "--pty", "no/tap"), ("no/tap", "create it first")),
        (("loop://",), ("FILE",)),
        (("loop://", "capture.txt", "--baud", "x"), ("--baud",)),
    ],
)
def test_a_mistake_is_one_clear_line(words: tuple[str, ...], parts: tuple[str, ...]) -> None:
    """With exit status 2."""
    assert_one_clear_line(invoke("tap", *words), *parts)


def test_any_url_of_pyserial_can_be_tapped(folder: Path) -> None:
    """One that answers itself."""
    with tapped(folder, "loop://", "capture.txt") as tap:
        with serial.Serial("./tap", 38400, timeout=10) as port:
            port.write(b"echo")
            assert port.read(4) == b"echo"
        assert tap.end()[0] == 0
    assert recorded(">") == recorded("<") == b"echo"
    assert not Path("tap").is_symlink()
