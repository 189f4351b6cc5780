"""The pty port: raw, named, seen through its settings, for clients that come and go."""

import contextlib
import os
import pty
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest
import serial
from echo_line import OWN_FORMAT, EchoLine
from served import EVERY_BYTE, TIMEOUT_S, Served, eventually

from axistwin.errors import PortError
from axistwin.ports.link import Link
from axistwin.ports.pty import PtyPort
from axistwin.runtime.line import Line
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.opens import OpenWatches
from axistwin.runtime.serving.rack import Rack
from axistwin.wire.framing import LineFormat

pytestmark = pytest.mark.system


class Bench(Served):
    """An echo line behind a pty at ``link``."""

    def __init__(self, link: Path, own_format: LineFormat = OWN_FORMAT) -> None:
        self.link = str(link)
        self.pty = PtyPort(self.link, own_format)
        super().__init__(self.pty, EchoLine(own_format))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """A running bench."""
    with Bench(tmp_path / "port") as bench:
        yield bench


@contextlib.contextmanager
def opened(path: str) -> Iterator[int]:
    """A client that opens the port and sets nothing."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        yield fd
    finally:
        os.close(fd)


def set_speed(fd: int, speed: int) -> None:
    """Set a standard speed, as stty does."""
    settings = termios.tcgetattr(fd)
    settings[4] = settings[5] = speed
    termios.tcsetattr(fd, termios.TCSANOW, settings)


def test_every_byte_value_passes_unchanged_for_a_client_that_sets_nothing(bench: Bench) -> None:
    """The pty is raw from the first moment and never echoes."""
    with opened(bench.link) as fd:
        os.write(fd, EVERY_BYTE)
        received = b""
        while len(received) < len(EVERY_BYTE):
            received += os.read(fd, 1024)
        assert received == EVERY_BYTE
        assert bytes(bench.line.heard) == EVERY_BYTE


def test_fifty_clients_come_and_go(bench: Bench) -> None:
    """Each of fifty clients in turn is served, and the same link stays."""
    target = Path(bench.link).readlink()
    for number in range(50):
        with serial.Serial(bench.link, 38400, timeout=TIMEOUT_S) as client:
            client.write(b"client %d" % number)
            assert client.read(7) == b"client "
    assert Path(bench.link).readlink() == target


def test_opens_and_closes_are_reported(bench: Bench) -> None:
    """A client that comes and goes is an event each; a port at rest has none."""
    assert bench.names() == []
    with opened(bench.link):
        assert eventually(lambda: bench.names() == ["connected"])
    assert eventually(lambda: bench.names() == ["connected", "disconnected"])


def test_a_killed_client_leaves_the_port_usable(bench: Bench) -> None:
    """A client that dies by SIGKILL is noticed, and the next one is served."""
    script = "import os, sys, time; os.write(os.open(sys.argv[1], os.O_RDWR), b'x'); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-Sc", script, bench.link]) as client:
        try:
            assert eventually(lambda: b"x" in bench.line.heard)
        finally:
            client.kill()
    assert eventually(lambda: "disconnected" in bench.names())
    with serial.Serial(bench.link, 38400, timeout=TIMEOUT_S) as port:
        port.write(b"next")
        assert port.read(4) == b"next"


def test_what_one_client_left_unread_is_not_given_to_the_next(bench: Bench) -> None:
    """A closed port drops what comes in."""
    with opened(bench.link) as fd:
        os.write(fd, b"old")
        assert eventually(lambda: bytes(bench.line.heard) == b"old")
    assert eventually(lambda: "disconnected" in bench.names())
    with opened(bench.link) as fd:
        os.write(fd, b"new")
        assert os.read(fd, 3) == b"new"


def test_what_a_client_wrote_before_it_closed_is_heard(bench: Bench) -> None:
    """``printf … > port`` works, although the port is closed by the time anyone looks."""
    for number in range(20):
        with opened(bench.link) as fd:
            os.write(fd, b"%02d" % number)
    expected = b"".join(b"%02d" % number for number in range(20))
    assert eventually(lambda: bytes(bench.line.heard) == expected)


def test_the_port_begins_at_the_rate_of_the_devices(tmp_path: Path) -> None:
    """A client that sets no rate finds the right one, odd rates included."""
    with Bench(tmp_path / "port", LineFormat(12345)) as bench, opened(bench.link) as fd:
        os.write(fd, b"right")
        assert os.read(fd, 5) == b"right"
    assert bench.line.formats[-1].baud == 12345


def test_the_rate_and_stop_bits_of_the_client_are_the_hosts(bench: Bench) -> None:
    """What the client sets, odd rates too, is the rate at the host's end of the line."""
    with serial.Serial(bench.link, 9600, timeout=TIMEOUT_S) as client:
        for baud, stop_bits in ((9600, 1), (115200, 2), (250000, 1), (38400, 1)):
            client.baudrate, client.stopbits = baud, stop_bits
            client.write(b"ab")
            answer = client.read(2)
            assert bench.line.formats[-1] == LineFormat(baud, stop_half_bits=2 * stop_bits)
            assert answer == (b"ab" if (baud, stop_bits) == (38400, 1) else b"??")


def test_a_rate_set_beforehand_is_kept_for_the_next_program(bench: Bench) -> None:
    """``stty -F port 4800`` and then a program that sets nothing, as on a real port."""
    with opened(bench.link) as fd:
        set_speed(fd, termios.B4800)
    assert eventually(lambda: bench.names()[-1:] != ["connected"])
    with opened(bench.link) as fd:
        os.write(fd, b"x")
        assert os.read(fd, 1) == b"?"
    assert bench.line.formats[-1].baud == 4800


def test_a_client_may_ask_for_parity_again_and_again(bench: Bench) -> None:
    """Parity does not stick to a pty, and yet no open fails for it."""
    for _ in range(10):
        with serial.Serial(bench.link, 38400, parity="E", timeout=TIMEOUT_S) as client:
            client.write(b"even")
            assert client.read(4) == b"even"
            client.parity = "O"
            client.write(b"odd")
            assert client.read(3) == b"odd"


def test_a_port_left_cooked_is_raw_for_the_next_client(bench: Bench) -> None:
    """A client that switches on line editing and echo spoils the port for itself only."""
    with opened(bench.link) as fd:
        settings = termios.tcgetattr(fd)
        settings[3] |= termios.ICANON | termios.ECHO | termios.ISIG
        termios.tcsetattr(fd, termios.TCSANOW, settings)
    master, cooked = bench.pty._master, termios.ICANON | termios.ECHO
    assert eventually(lambda: not termios.tcgetattr(master)[tty.LFLAG] & cooked)
    with opened(bench.link) as fd:
        assert not termios.tcgetattr(fd)[tty.LFLAG] & cooked
        os.write(fd, b"\x03\r")
        assert os.read(fd, 2) == b"\x03\r"


def test_a_client_that_floods_is_not_read_beyond_the_backlog(bench: Bench) -> None:
    """A line that is slower than its host makes the client's own write wait, and loses nothing."""
    bench.line.is_blocked = True
    flood = EVERY_BYTE * 400
    with opened(bench.link) as fd:
        os.set_blocking(fd, False)
        sent = 0
        deadline = time.monotonic() + 0.5
        while time.monotonic() < deadline and sent < len(flood):
            with contextlib.suppress(BlockingIOError):
                sent += os.write(fd, flood[sent : sent + 1024])
        assert sent < len(flood)
        assert eventually(lambda: bench.line.host_backlog > 0)
        assert bench.line.host_backlog <= 4096
        bench.line.unblock()
        assert eventually(lambda: len(bench.line.heard) == sent)
        assert bytes(bench.line.heard) == flood[:sent]


def test_a_client_that_never_reads_loses_the_newest_bytes_and_memory_stays_flat(
    bench: Bench,
) -> None:
    """What neither the kernel nor a bounded buffer holds is dropped and counted."""
    with opened(bench.link) as fd:
        os.write(fd, b"hello")
        assert eventually(lambda: bench.line.heard == b"hello")
        for _ in range(100):
            bench.line.speak(b"x" * 1000)
            time.sleep(0.001)
        os.write(fd, b"still heard")
        assert eventually(lambda: bytes(bench.line.heard).endswith(b"still heard"))
    assert eventually(lambda: "disconnected" in bench.names())
    assert 50_000 < bench.events[-1]["dropped_bytes"] < 100_000


def test_the_link_is_removed_at_the_end(tmp_path: Path) -> None:
    """Nothing is left in the folder."""
    with Bench(tmp_path / "port") as bench:
        assert Path(bench.link).is_char_device()
    assert list(tmp_path.iterdir()) == []


def test_a_link_that_somebody_else_has_replaced_is_left_alone(bench: Bench) -> None:
    """Only our own link is removed."""
    link = Path(bench.link)
    link.unlink()
    link.write_text("precious")
    bench.rack.stop()
    assert link.read_text() == "precious"


@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_not_a_link_to_a_pty_is_never_replaced(tmp_path: Path, kind: str) -> None:
    """A file, a folder or another link at the place is an error that names it."""
    place = tmp_path / "port"
    if kind == "file":
        place.write_text("precious")
    elif kind == "folder":
        place.mkdir()
    else:
        place.symlink_to(tmp_path)
    with pytest.raises(PortError, match=rf"port: a {kind}.*will not be replaced"):
        Bench(place).rack.open()
    assert os.path.lexists(place)


@pytest.mark.parametrize("target", ["/dev/pts/987654", "/dev/pts/ptmx"])
def test_a_link_of_a_dead_process_is_replaced(tmp_path: Path, target: str) -> None:
    """Dangling or not, a link to a pty that nobody serves may go."""
    place = tmp_path / "port"
    place.symlink_to(target)
    with Bench(place) as bench:
        assert str(place.readlink()) == bench.pty.device


def test_a_link_of_another_program_to_a_living_pty_stays(tmp_path: Path) -> None:
    """socat and others make such links too: neither replaced now nor removed at the end."""
    master, slave = pty.openpty()
    link = tmp_path / "port"
    link.symlink_to(os.ttyname(slave))
    with pytest.raises(PortError, match=r"port: another program's link .* choose another --pty"):
        Bench(link).rack.open()
    assert link.readlink() == Path(os.ttyname(slave))
    os.close(slave)
    os.close(master)


def test_a_link_that_is_older_than_the_pty_of_that_number_is_replaced(tmp_path: Path) -> None:
    """Numbers are given again: what a killed process left may name somebody else's terminal."""
    master, slave = pty.openpty()
    link = tmp_path / "port"
    link.symlink_to(os.ttyname(slave))
    os.utime(link, (0, 0), follow_symlinks=False)
    (tmp_path / ".port.123").symlink_to("/dev/pts/7")
    with Bench(link) as bench:
        assert link.readlink() == Path(bench.pty.device)
        assert not (tmp_path / ".port.123").is_symlink()
    os.close(slave)
    os.close(master)


def test_a_link_without_a_name_is_one_clear_line() -> None:
    """``--pty ""`` is not the current folder."""
    with pytest.raises(PortError, match="needs a name"):
        Link("").claim()


def test_a_link_that_is_served_is_in_use(bench: Bench) -> None:
    """A second server under the same name is refused, by whatever path it comes."""
    folder = Path(bench.link).parent
    for path in (Path(bench.link), folder / "." / "port"):
        with pytest.raises(PortError, match="in use, another axistwin serves it"):
            Bench(path).rack.open()
    assert Path(bench.link).is_char_device()


def test_a_link_with_a_long_path_is_in_use_too(tmp_path: Path) -> None:
    """Longer than the kernel's name of it may be; its neighbour is free."""
    folder = tmp_path / ("long" * 40)
    folder.mkdir()
    with Bench(folder / "port"):
        with pytest.raises(PortError, match="in use, another axistwin serves it"):
            Bench(folder / "port").rack.open()
        with Bench(folder / "port2"):
            pass


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    """One clear line."""
    with pytest.raises(PortError, match=r"there is no folder .*/nowhere; create it first"):
        Bench(tmp_path / "nowhere" / "port").rack.open()


def test_a_client_sees_a_hang_up_when_the_server_ends(bench: Bench) -> None:
    """The client's read fails at once instead of waiting for ever."""
    with serial.Serial(bench.link, 38400, timeout=TIMEOUT_S) as client:
        client.write(b"x")
        assert client.read(1) == b"x"
        bench.rack.stop()
        with pytest.raises(serial.SerialException):
            client.read(1)


def test_the_rest_of_a_client_that_closes_is_not_left_to_the_next(bench: Bench) -> None:
    """What the line has not taken of it within about a second is dropped."""
    bench.line.is_blocked = True
    with opened(bench.link) as fd:
        os.set_blocking(fd, False)
        assert eventually(lambda: bench.names() == ["connected"])
        for _ in range(100):
            with contextlib.suppress(BlockingIOError):
                os.write(fd, EVERY_BYTE)
            time.sleep(0.001)
    assert eventually(lambda: "disconnected" in bench.names())
    kept = bench.line.host_backlog
    assert 0 < kept <= 4096
    bench.line.unblock()
    assert eventually(lambda: len(bench.line.heard) >= kept)
    time.sleep(0.1)
    assert bench.names() == ["connected", "disconnected"]
    assert len(bench.line.heard) == kept


def inotify_instances() -> int:
    """How many of them this process has."""
    links = [
        str(entry.readlink()) for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink()
    ]
    return sum("inotify" in link for link in links)


def test_two_hundred_ptys_of_one_loop_take_one_inotify_instance(tmp_path: Path) -> None:
    """Each notices its own client; a user may have no more than 128 instances."""
    before, events = inotify_instances(), list[Any]()
    rack = Rack()
    ports = [PtyPort(str(tmp_path / str(number)), OWN_FORMAT) for number in range(200)]
    line = cast(Line, EchoLine(OWN_FORMAT))

    def names() -> list[str]:
        return [event["event"] for event in tuple(events)]

    rack.add(Server(line, ports, loop=rack.loop, report=events.append))
    rack.start()
    try:
        assert inotify_instances() == before + 1
        for number in (0, 137, 199, 0):
            with opened(ports[number].url) as fd:
                os.write(fd, b"x")
                assert os.read(fd, 1) == b"x"
            assert eventually(lambda: names()[-1:] == ["disconnected"])
            assert {event["url"] for event in events} == {ports[number].url}
            events.clear()
    finally:
        rack.stop()
    assert inotify_instances() == before


def test_a_kernel_that_notices_no_clients_is_a_port_error_at_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It names the limit; link and pty are gone again."""

    def refuse(*_: object) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(OpenWatches, "add", refuse)
    bench = Bench(tmp_path / "port")
    with pytest.raises(PortError, match=r"Too many open files.*max_user_instances"):
        bench.rack.start()
    assert not os.path.lexists(bench.link)
