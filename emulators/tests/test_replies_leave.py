"""However long the serving process is paused between two of its steps, no reply waits in it."""

import contextlib
import os
import socket
import termios
import tty
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest
from mac_frames import request
from paused_system import PausedSystem, Script, received
from uhid_socket import SocketPort, in_report, out_event

from axistwin.catalog import build_bus, build_line, parse_device
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.ports.can_hub import SlcanPtyPort, SlcanTcpPort, SocketcandPort
from axistwin.ports.pty import PtyPort, set_rate
from axistwin.ports.rfc2217 import Rfc2217Port
from axistwin.ports.tcp import Listener, TcpPort
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.line import Line
from axistwin.runtime.serving.bus_server import BusPort, BusServer
from axistwin.runtime.serving.line_server import BAUD_MIN, TURN_NS, LinePort, Server

pytestmark = pytest.mark.system

EXCHANGES = 30
REPLY_NS: Nanos = 300 * NS_PER_MS
"""What the process may wait for a reply; lifebeats come after seconds."""

SEEDS = pytest.mark.parametrize("seed", range(3))
OFTEN = pytest.mark.parametrize("often", [0.0, 0.02, 0.3])
PACING = pytest.mark.parametrize("paced", [True, False], ids=["paced", "unpaced"])

RATE_OF_1 = b"\xff\xfa\x2c\x01\0\0\0\1\xff\xf0"
"""How a client of RFC 2217 sets one bit per second."""

UPLOAD = {"slcan": b"t60184000200000000000\r", "socketcand": b"< send 601 8 40 0 20 0 0 0 0 0 >"}
OPEN = {"slcan": b"O\r", "socketcand": b"< open vcan0 >< rawmode >"}
UPLOADED = {"slcan": b"t5818", "socketcand": b"< frame 581 "}


def line_port(kind: str, folder: Path, line: Line) -> LinePort:
    """A port for clients of a line."""
    if kind == "pty":
        return PtyPort(str(folder / "pty"), line.device_format)
    return (TcpPort if kind == "tcp" else Rfc2217Port)("127.0.0.1:0")


def bus_port(kind: str, folder: Path) -> BusPort:
    """A port for clients of a bus."""
    if kind == "slcan":
        return SlcanPtyPort(str(folder / "slcan"))
    return (SlcanTcpPort if kind == "slcan-tcp" else SocketcandPort)("127.0.0.1:0")


@contextmanager
def client(port: LinePort | BusPort) -> Iterator[int]:
    """A descriptor of somebody who has opened ``port``."""
    if isinstance(port, Listener):
        with socket.create_connection((port.host, port.port)) as connection:
            yield connection.fileno()
        return
    terminal = os.open(port.url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(terminal, termios.TCSANOW)
        yield terminal
    finally:
        os.close(terminal)


@pytest.fixture
def system(seed: int, often: float, monkeypatch: pytest.MonkeyPatch) -> Iterator[PausedSystem]:
    """What the server runs on."""
    system = PausedSystem(seed, often, monkeypatch)
    yield system
    system.release()


def line_on(system: PausedSystem, *, paced: bool = True, latency_us: int = 1500) -> Line:
    """A module at 0."""
    return build_line(
        [parse_device("mac23:0")],
        clock=PacedClock(source=system.source),
        paced=paced,
        quirks={"reply_latency_us": latency_us},
    )


def is_answered(heard: bytes) -> bool:
    """Whether what was heard ends with the position of a module that has not moved."""
    return heard.endswith(b"\x03\x1a")


def heard(
    system: PausedSystem, fd: int, is_complete: Callable[[bytes], bool], patience_ns: Nanos
) -> Generator[None, None, bytes]:
    """Wait until what has come is complete, but not for longer than that; all of it."""
    begin_ns, data = system.waited_ns, received(fd)
    while not is_complete(data):
        yield
        data += received(fd)
        assert system.waited_ns - begin_ns <= patience_ns, f"a reply is kept behind {data!r}"
    return data


def asking(system: PausedSystem, port: LinePort) -> Script:
    """One question after another."""
    with client(port) as fd:
        for _ in range(EXCHANGES):
            os.write(fd, request(0x20))
            yield from heard(system, fd, is_answered, REPLY_NS)


@SEEDS
@OFTEN
@PACING
@pytest.mark.parametrize("latency_us", [0, 20, 1500])
@pytest.mark.parametrize("kind", ["pty", "tcp", "rfc2217"])
def test_no_reply_waits_for_another_request(
    kind: str, latency_us: int, paced: bool, tmp_path: Path, system: PausedSystem
) -> None:
    """On every port of a line each question is answered, wherever the process is paused."""
    with line_on(system, paced=paced, latency_us=latency_us) as line:
        port = line_port(kind, tmp_path, line)
        system.run(Server(line, [port], loop=system.loop), asking(system, port))


FLOOD = b"U" * 5000


def flooding(system: PausedSystem, port: LinePort, other: LinePort, patience_ns: Nanos) -> Script:
    """Send more than the line takes at once, and then a question that all hear answered."""
    system.settle_ms = 10  # waiting is what a client that is held back does all the time
    with client(port) as fd, client(other) as listener:
        for _ in range(3):
            rest = FLOOD + request(0x20)
            while rest:
                with contextlib.suppress(BlockingIOError):
                    rest = rest[os.write(fd, rest[:500]) :]
                yield
            yield from heard(system, fd, is_answered, patience_ns)
            yield from heard(system, listener, is_answered, patience_ns)


@SEEDS
@OFTEN
@pytest.mark.parametrize("kind", ["pty", "tcp", "rfc2217"])
def test_no_reply_waits_while_a_client_is_held_back(
    kind: str, tmp_path: Path, system: PausedSystem
) -> None:
    """A client that sends more than the line takes is held back, and its last is answered."""
    with line_on(system) as line:
        port, other = line_port(kind, tmp_path, line), TcpPort("127.0.0.1:0")
        patience_ns = 2 * line.device_format.span_ns(len(FLOOD)) + REPLY_NS
        script = flooding(system, port, other, patience_ns)
        system.run(Server(line, [port, other], loop=system.loop), script)


def asking_beside_a_slow_one(
    system: PausedSystem, line: Line, slow: LinePort, port: LinePort
) -> Script:
    """Ask again and again, while another client's bytes take minutes."""
    with client(slow) as fd, client(port) as asker:
        if isinstance(slow, PtyPort):
            set_rate(fd, 1)
        else:
            os.write(fd, RATE_OF_1)
        os.write(fd, b"U" * 900)
        while line.host_format.baud != BAUD_MIN:
            yield
        for _ in range(5):
            os.write(asker, request(0x20))
            yield from heard(system, asker, is_answered, 2 * TURN_NS + REPLY_NS)


@SEEDS
@OFTEN
@pytest.mark.parametrize("kind", ["pty", "rfc2217"])
def test_a_slow_client_shuts_nobody_out(kind: str, tmp_path: Path, system: PausedSystem) -> None:
    """One sends for minutes at its rate; another is answered again and again meanwhile."""
    with line_on(system) as line:
        slow, other = line_port(kind, tmp_path, line), TcpPort("127.0.0.1:0")
        script = asking_beside_a_slow_one(system, line, slow, other)
        system.run(Server(line, [slow, other], loop=system.loop), script)


def uploading(system: PausedSystem, port: BusPort, dialect: str) -> Script:
    """One upload after another, and then as many at once as hold the client back."""
    with client(port) as fd:
        os.write(fd, OPEN[dialect])
        yield from heard(system, fd, bool, REPLY_NS)
        for count in [1] * EXCHANGES + [100]:
            os.write(fd, UPLOAD[dialect] * count)
            are_all_there = partial(has_count, UPLOADED[dialect], count)
            yield from heard(system, fd, are_all_there, count * REPLY_NS)


def has_count(part: bytes, count: int, data: bytes) -> bool:
    """Whether ``part`` is in ``data`` so many times."""
    return data.count(part) >= count


@SEEDS
@OFTEN
@PACING
@pytest.mark.parametrize("kind", ["slcan", "slcan-tcp", "socketcand"])
def test_no_reply_on_a_bus_waits_for_another_frame(
    kind: str, paced: bool, tmp_path: Path, system: PausedSystem
) -> None:
    """On every hub each upload is answered, wherever the process is paused."""
    clock = PacedClock(source=system.source)
    with build_bus([parse_device("mac23-can:1")], clock=clock, paced=paced) as bus:
        port = bus_port(kind, tmp_path)
        script = uploading(system, port, kind.removesuffix("-tcp"))
        system.run(BusServer(bus, [port], loop=system.loop), script)


REPORTS = {b"E": b"E0,0,0,0", b"E1": b"E0,0,0,0,0"}


def reading_reports(system: PausedSystem, port: SocketPort) -> Script:
    """Questions that are answered at once, and later by the board itself, one by one and many."""
    fd, system.settle_ms = port.kernel.fileno(), 0
    for asked in [[b"E", b"E1"]] * EXCHANGES + [[b"E"] * 20]:
        for text in asked:
            os.write(fd, out_event(text))
        for text in asked:
            event = yield from heard(system, fd, bool, REPLY_NS)
            assert in_report(event) == REPORTS[text]


@SEEDS
@OFTEN
@PACING
def test_no_report_waits_for_another_one(paced: bool, system: PausedSystem) -> None:
    """A board on USB, whose E1 measures for 100 ms; there is a socket in the kernel's place."""
    port = SocketPort()
    clock = PacedClock(source=system.source)
    with port.kernel, build_line([parse_device("mn400")], clock=clock, paced=paced) as line:
        system.run(Server(line, [port], loop=system.loop), reading_reports(system, port))
