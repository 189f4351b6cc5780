"""``axistwin tap`` on CAN: between a program and twins, or listening; replayed; kill -9 or not."""

import contextlib
import errno
import os
import random
import re
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from daemon_process import Daemon, assert_one_clear_line, daemon, invoke, talk
from kill_rounds import GONE
from served import eventually

pytestmark = pytest.mark.system

KILLS = int(os.environ.get("AXISTWIN_KILLS", "5"))
"""How often a tap is killed."""

LATEST_KILL_S = 0.1
DEVICES = "slcan:./mac23-can?sleep_after_open=0"
SAID = ("position?", "go to 300", "wait 300 ms", "position?", "99h")
QUERY = b"t60184000200000000000\r"
ANSWER = b"t58184200200000000000"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where links and recordings are."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@contextlib.contextmanager
def bus(folder: Path, *arguments: str) -> Iterator[Daemon]:
    """A module on a hub."""
    with daemon(folder, "mac23-can", "--slcan", "./mac23-can", *arguments) as process:
        assert process.line().startswith("ready mac23-can:1 ")
        yield process


@contextlib.contextmanager
def tapped(folder: Path, *arguments: str) -> Iterator[Daemon]:
    """A tap that is ready."""
    with daemon(folder, *arguments, command="tap") as process:
        assert process.line().startswith("ready tap "), process.process.communicate()
        yield process


def rows(path: str = "capture.log") -> list[str]:
    """Frames of a recording with their directions, if it has some."""
    found = [
        re.fullmatch(r"\(\d{10}\.\d{6}\) vcan0 (\S+(?: [TR])?)", row)
        for row in Path(path).read_text("utf-8").splitlines()
    ]
    assert all(found)
    return [each[1] for each in found if each]


def speak(link: str) -> str:
    """What ``axistwin send`` shows of the conversation."""
    result = talk(link, "mac23-can", *SAID)
    assert result.exit_code == 0, result.output
    return result.stdout


def says_the_same(path: str) -> bool:
    """Whether a twin does."""
    words = ("replay", path, "--against", "mac23-can", "--window", "60000")
    return invoke(*words).exit_code == 0


def test_a_conversation_goes_through_and_is_replayed(folder: Path) -> None:
    """Each frame with its direction; decode explains them, a twin says the same."""
    with bus(folder), tapped(folder, DEVICES, "capture.log", "--slcan", "./tap") as tap:
        shown = speak("./tap")
        status, _, errors = tap.end(signal.SIGINT)
    assert (status, errors) == (0, "")
    assert "position = 300 (module 1)" in shown
    assert rows() == [
        "601#4000200000000000 T",
        "581#4200200000000000 R",
        "601#231320000000012C T",
        "581#6013200000000000 R",
        "601#4000200000000000 T",
        "581#420020000000012C R",
        "601#4079200000000000 T",
        "581#8079200000000000 R",
    ]
    assert "2000h position? -> module 1" in invoke("decode", "mac23-can", "capture.log").stdout
    assert says_the_same("capture.log")
    assert not Path("tap").is_symlink()


def test_who_only_listens_disturbs_nobody_and_replay_tells_who_spoke(folder: Path) -> None:
    """Frames have no direction then; nor do those of candump on the machine of both."""
    with (
        bus(folder, "--slcan", "./second") as twin,
        tapped(folder, DEVICES.replace("mac23-can", "second"), "capture.log") as tap,
    ):
        speak("./mac23-can")
        assert eventually(lambda: len(rows()) == 8)
        assert tap.end()[0] == 0
        assert twin.end()[0] == 0
    heard = rows()
    assert heard[:2] == ["601#4000200000000000", "581#4200200000000000"]
    assert says_the_same("capture.log")
    text = Path("capture.log").read_text("utf-8")
    Path("candump.log").write_text(text.replace("\n", " T\n"), "utf-8")
    assert says_the_same("candump.log")
    Path("other.log").write_text(text.replace("581#42", "581#43"), "utf-8")
    assert not says_the_same("other.log")


def test_frames_pass_while_no_program_is_there(folder: Path) -> None:
    """A module that speaks by itself is acknowledged and recorded; nobody is held up."""
    with (
        bus(folder, "--slcan", "./second"),
        tapped(folder, DEVICES, "capture.log", "--slcan", "./tap") as tap,
    ):
        assert "position = 300 (module 1)" in speak("./second")
        assert eventually(lambda: len(rows()) == 8)
        assert tap.end()[0] == 0
    assert {row[-1] for row in rows()} == {"R"}


def test_a_full_disk_does_not_stop_what_is_passed_on(folder: Path) -> None:
    """It is told once, and in the exit status."""
    with bus(folder), tapped(folder, DEVICES, "/dev/full", "--slcan", "./tap") as tap:
        assert "position = 300 (module 1)" in speak("./tap")
        status, _, errors = tap.end()
    assert status == 2
    assert errors.count(os.strerror(errno.ENOSPC)) == 1
    assert len(errors.splitlines()) == 1


def test_a_bus_that_goes_away_is_reported(folder: Path) -> None:
    """In one line; what was said before is there."""
    with bus(folder) as twin, tapped(folder, DEVICES, "capture.log", "--slcan", "./tap") as tap:
        speak("./tap")
        twin.end(signal.SIGKILL)
        _, errors = tap.process.communicate(timeout=30)
    assert tap.process.returncode == 2
    assert errors.startswith("axistwin: can slcan:./mac23-can")
    assert len(errors.splitlines()) == 1
    assert len(rows()) == 8


def test_a_kill_loses_nothing_that_was_passed_on(folder: Path) -> None:
    """Whatever the program has heard is in the recording, and what it had said before that."""
    rng = random.Random(1)
    heard_frames = 0
    with bus(folder, "--no-pacing"):
        for number in range(KILLS):
            path = f"capture-{number}.log"
            with (
                tapped(folder, DEVICES, path, "--slcan", "./tap") as tap,
                serial.Serial("./tap", timeout=10) as port,
            ):
                port.write(b"O\r")
                killer = threading.Timer(rng.uniform(0, LATEST_KILL_S), tap.process.kill)
                killer.start()
                heard = 0
                with contextlib.suppress(*GONE):
                    while True:
                        port.write(QUERY)
                        lines = [port.read_until(b"\r")]
                        while ANSWER not in lines[-1]:
                            if not lines[-1].endswith(b"\r"):
                                raise EOFError
                            lines.append(port.read_until(b"\r"))
                        heard += 1
                killer.join()
                tap.process.wait()
            recorded = rows(path)
            assert recorded.count("581#4200200000000000 R") >= heard
            assert recorded.count("601#4000200000000000 T") >= heard
            heard_frames += heard
    assert heard_frames > KILLS // 4, "the kills came before anything was heard"


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("slcn:./x", "capture.log"), ("slcn", "did you mean slcan")),
        (("slcan:./none", "capture.log"), ("can slcan:./none: cannot be joined",)),
        (("slcan:./x", "no/capture.log"), ("no/capture.log", "choose another file")),
        (("slcan:./x", "capture.log", "--can", "slcan:./x"), ("--can slcan:./x", "another one")),
        (("slcan:./x", "capture.log", "--pty", "./p"), ("--pty is for a serial line", "--slcan")),
        (("loop://", "capture.log", "--slcan", "./p"), ("--slcan is for a CAN bus", "--rfc2217")),
        (("loop://", "capture.log", "--bitrate", "5"), ("--bitrate is for a CAN bus",)),
        (("loop://", "c.txt", "--pty", "p", "--rfc2217", "127.0.0.1:0"), ("one of them",)),
    ],
)
def test_a_mistake_is_one_clear_line(words: tuple[str, ...], parts: tuple[str, ...]) -> None:
    """With exit status 2."""
    assert_one_clear_line(invoke("tap", *words), *parts)
