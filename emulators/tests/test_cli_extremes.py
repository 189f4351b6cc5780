"""The program ``axistwin`` where nobody reads what it says, and words are out of bounds."""

import contextlib
import fcntl
import json
import os
import signal
import socket
import time
from pathlib import Path

import pytest
import serial
from daemon_process import TIMEOUT_S, assert_one_clear_line, daemon, invoke
from mac_frames import request
from served import eventually

pytestmark = pytest.mark.system


def ask(port: serial.SerialBase, frame: bytes, count: int) -> bytes:
    """The reply to ``frame``."""
    port.write(frame)
    return bytes(port.read(count))


def test_a_capture_to_a_pipe_that_nobody_reads_is_one_clear_line(tmp_path: Path) -> None:
    """It does not wait for a reader."""
    os.mkfifo(tmp_path / "pipe")
    link, pipe = str(tmp_path / "mac23"), str(tmp_path / "pipe")
    result = invoke("run", "mac23", "--pty", link, "--capture", pipe)
    assert_one_clear_line(result, "pipe", "nobody reads it")
    assert not os.path.lexists(link)


READING = (("decode", "mac23", "pipe"), ("replay", "pipe", "--against", "mac23"))
SIGNALS = ((signal.SIGINT, 130), (signal.SIGTERM, -signal.SIGTERM))


@pytest.mark.parametrize("words", READING)
def test_a_pipe_is_waited_for_until_somebody_has_written(
    words: tuple[str, ...], tmp_path: Path
) -> None:
    """As cat does: whoever writes may come later."""
    os.mkfifo(tmp_path / "pipe")
    writers = []

    def is_waited_for() -> bool:
        with contextlib.suppress(OSError):
            writers.append(os.open(tmp_path / "pipe", os.O_WRONLY | os.O_NONBLOCK))
        return bool(writers)

    with daemon(tmp_path, *words[1:], command=words[0]) as process:
        assert eventually(is_waited_for)
        os.write(writers[0], b"1.0 > 06 13 17\n")
        os.close(writers[0])
        out, err = process.process.communicate(timeout=TIMEOUT_S)
    assert not err
    assert "06 13 17" in out or "1 exchange, mac23 says the same" in out


@pytest.mark.parametrize(("number", "status"), SIGNALS)
@pytest.mark.parametrize("words", READING)
def test_waiting_for_a_pipe_ends_by_a_signal(
    words: tuple[str, ...], number: signal.Signals, status: int, tmp_path: Path
) -> None:
    """By Ctrl-C with 130, without a word, though nobody ever writes."""
    os.mkfifo(tmp_path / "pipe")
    program = ("-X", "importtime", "-m", "axistwin")
    with daemon(tmp_path, *words[1:], command=words[0], program=program) as process:
        assert process.process.stderr is not None
        lines = iter(process.process.stderr.readline, "")
        assert any("axistwin.catalog" in line for line in lines)
        time.sleep(0.2)  # it opens the pipe soon; before that a signal does the same
        ended = process.end(number)
    told = [line for line in ended[2].split("\n") if line and not line.startswith("import time:")]
    assert (ended[:2], told) == ((status, ""), [])


def test_a_rack_does_not_wait_for_a_pipe_instead_of_its_file(tmp_path: Path) -> None:
    """One clear line: it would read it again at SIGHUP, while its lines wait."""
    os.mkfifo(tmp_path / "pipe")
    with daemon(tmp_path, "pipe", command="rack") as process:
        out, err = process.process.communicate(timeout=TIMEOUT_S)
    told = "axistwin: rack pipe: this is a pipe from which nothing comes; give a file\n"
    assert (process.process.returncode, out, err) == (2, "", told)


def test_a_capture_into_a_pipe_whose_reader_sleeps_stops_nobody(tmp_path: Path) -> None:
    """The module goes on, and at the end it is said that something is missing."""
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    fcntl.fcntl(reader, fcntl.F_SETPIPE_SZ, 4096)
    try:
        arguments = ("mac23", "--no-pacing", "--capture", "pipe", "--quirk", "reply_latency_us=0")
        with daemon(tmp_path, *arguments) as process:
            process.line()
            with serial.Serial(str(tmp_path / "mac23"), 38400, timeout=TIMEOUT_S) as port:
                for _ in range(100):
                    assert len(ask(port, request(0x20), 21)) == 21
            status, _, err = process.end()
    finally:
        os.close(reader)
    assert status == 2
    assert "capture pipe: cannot be written any more" in err


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_events_that_nobody_reads_are_dropped_and_counted(tmp_path: Path, stream: str) -> None:
    """Thousands of clients come and go; the module answers, and who reads in the end is told."""
    arguments = ("mac23", "--json", "--tcp", "127.0.0.1:0", "--rfc2217", "127.0.0.1:0")
    with daemon(tmp_path, *arguments) as process:
        ready = process.event()
        tcp, rfc2217 = (each["url"].rpartition(":")[2] for each in ready["endpoints"])
        for _ in range(1500):
            with socket.create_connection(("127.0.0.1", int(rfc2217))) as client:
                if stream == "stderr":  # another rate than the module's, which people are told
                    client.sendall(b"\xff\xfa\x2c\x01\0\0\x12\xc0\xff\xf0U")
                    client.recv(1000)
                client.shutdown(socket.SHUT_WR)
                while client.recv(1000):
                    pass
        with serial.serial_for_url(f"socket://127.0.0.1:{tcp}", timeout=TIMEOUT_S) as port:
            assert len(ask(port, request(0x20), 21)) == 21
        status, out, _ = process.end()
    events = [json.loads(line) for line in out.splitlines()]
    losses = [event["count"] for event in events if event["event"] == "events_dropped"]
    clients = 2 * 1501 + (1500 if stream == "stderr" else 0)
    assert sum(losses) > clients / 4
    assert len(events) - len(losses) - 1 + sum(losses) == clients
    assert events[-1]["event"] == "stopped"
    assert status == 0


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("reply_latency_us = " + "9" * 5000, "this is no TOML (Exceeds the limit"),
        ("xon_byte = " + "[" * 2000 + "]" * 2000, "nested too deep"),
        ("xon_byte." + ".".join("a" * 5000) + " = 1", "quirk xon_byte is {'a': {'a':"),
        (".".join("a" * 50_000) + " = 1", "more than 20000 bytes"),
    ],
    ids=["digits", "nesting", "dots", "size"],
)
@pytest.mark.parametrize("name", ["a.toml", "\udcff.toml"])
def test_a_profile_beyond_all_bounds_is_one_clear_line(
    tmp_path: Path, text: str, part: str, name: str
) -> None:
    """However long its numbers, and however deep its tables are."""
    (tmp_path / name).write_text('model = "mac23"\n[quirks]\n' + text, "utf-8")
    result = invoke("run", "mac23", "--profile", str(tmp_path / name))
    assert_one_clear_line(result, part)


@pytest.mark.parametrize("name", ["h" * 300, "h\udcff", ".", "a..b"])
def test_a_host_that_can_be_none_is_one_clear_line(name: str) -> None:
    """Too long, or of characters that no name has."""
    assert_one_clear_line(invoke("run", "mac23", "--tcp", f"{name}:5000"), "no such host")
    assert_one_clear_line(invoke("run", "mac23", "--tcp", f"{name}:{'9' * 5000}"), "HOST:PORT")


def test_a_link_that_is_too_long_is_one_clear_line(tmp_path: Path) -> None:
    """A folder takes names of 255 bytes."""
    for model, option in (("mac23", "--pty"), ("mac23-can", "--slcan")):
        result = invoke("run", model, option, str(tmp_path / ("p" * 300)))
        assert_one_clear_line(result, "too long", "choose another --")


def test_a_link_may_have_any_name_that_a_file_has(tmp_path: Path) -> None:
    """Also one that is no UTF-8: it is told as it is."""
    with daemon(tmp_path, "mac23", "--pty", "p\udcff") as process:
        assert process.process.stdout is not None
        raw = os.read(process.process.stdout.fileno(), 1000)
        assert raw.startswith(b"ready mac23:0 pty=p\xff (")
        assert process.end()[0] == 0
