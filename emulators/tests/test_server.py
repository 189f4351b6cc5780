"""The server: one line in real time, for clients on any number of ports."""

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import serial
from served import TIMEOUT_S, eventually, falls_quiet
from spy_storage import Disk
from toy_device import LATENCY_NS, ToyDevice

from axistwin.errors import PortError, StateError
from axistwin.kernel.time import NS_PER_S
from axistwin.ports.pty import PtyPort
from axistwin.ports.tcp import TcpPort, parse_address
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.line import Line
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.simulation import Station
from axistwin.runtime.storage import MemorySlot
from axistwin.wire.framing import LineFormat

pytestmark = pytest.mark.system

F38400 = LineFormat(38400)


class FullDisk(MemorySlot):
    """A memory that cannot be written."""

    def save(self, cells: Mapping[str, int], *, durable: bool) -> None:
        """Fail as a full disk does."""
        raise StateError("state: no room; make room")


class Bench:
    """A toy device at ``./toy`` and on TCP."""

    def __init__(
        self,
        folder: Path,
        *,
        paced: bool = True,
        slot: MemorySlot | None = None,
        line_format: LineFormat = F38400,
    ) -> None:
        self.device = ToyDevice()
        self.device.line_format = line_format
        self.slot = slot or MemorySlot()
        self.slot.cells.update(self.device.stored)
        network = SerialNetwork([self.device], paced=paced)
        station = Station("toy:0", "toy", self.device, self.slot)
        self.line = Line(network, PacedClock(), Disk(), [station])
        self.pty = PtyPort(str(folder / "toy"), line_format)
        self.tcp = TcpPort("127.0.0.1:0")
        self.rack = Rack()
        self.events: list[object] = []
        self.server = self.rack.add(
            Server(
                self.line,
                [self.pty, self.tcp],
                loop=self.rack.loop,
                report=lambda event: self.events.append(event["event"]),
            )
        )

    def open(self, baud: int = 38400) -> serial.Serial:
        """A client on the pty."""
        return serial.Serial(self.pty.url, baud, timeout=TIMEOUT_S)

    def connect(self) -> socket.socket:
        """A client on TCP."""
        address = parse_address(self.tcp.url.removeprefix("socket://"))
        return socket.create_connection(address, timeout=TIMEOUT_S)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """A bench that is served."""
    bench = Bench(tmp_path)
    bench.rack.start()
    yield bench
    bench.rack.stop()
    bench.line.close()


def test_an_answer_takes_the_time_of_the_line_and_the_device(bench: Bench) -> None:
    """Request, latency and answer in real time: never earlier."""
    least_s = (F38400.span_ns(1) + LATENCY_NS + F38400.span_ns(4)) / NS_PER_S
    with bench.open() as client:
        took = []
        for _ in range(20):
            begin = time.monotonic()
            client.write(b"P")
            assert client.read(4) == bytes(4)
            took.append(time.monotonic() - begin)
    assert min(took) >= least_s


def test_the_server_wakes_for_the_end_of_an_answer_and_not_for_each_byte(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Few wake-ups per exchange; a line at rest has none."""
    with bench.open() as client:
        client.write(b"P")
        assert client.read(4) == bytes(4)
        wakes: list[float] = []
        receive = bench.line.receive

        def counted() -> bytes:
            wakes.append(time.monotonic())
            return receive()

        monkeypatch.setattr(bench.line, "receive", counted)
        assert falls_quiet(lambda: len(wakes))
        wakes.clear()
        client.write(b"P")
        assert client.read(4) == bytes(4)
        assert falls_quiet(lambda: len(wakes))
        assert 1 <= len(wakes) <= 6


def test_a_client_at_a_wrong_rate_gets_no_valid_answer_and_at_the_right_one_does(
    bench: Bench,
) -> None:
    """The rate is part of the line."""
    with bench.open(9600) as client:
        client.timeout = 0.1
        client.write(b"P")
        assert client.read(4) != bytes(4)
        client.reset_input_buffer()
        client.timeout = TIMEOUT_S
        client.baudrate = 38400
        client.write(b"P")
        assert client.read(4) == bytes(4)


def test_clients_of_several_ports_share_the_line(bench: Bench) -> None:
    """What one asks on TCP, the other hears on the pty."""
    with bench.open() as reader, bench.connect() as writer:
        assert eventually(lambda: bench.events.count("connected") == 2)
        writer.sendall(b"W")
        assert reader.read(1) == b"K"
        assert writer.recv(1) == b"K"


def test_what_a_client_was_told_to_be_stored_is_stored(bench: Bench) -> None:
    """The acknowledgement leaves after the write."""
    with bench.open() as client:
        for count in range(1, 6):
            client.write(b"W")
            assert client.read(1) == b"K"
            assert bench.slot.cells["writes"] == count


def test_the_position_of_a_moving_axis_is_saved_while_nobody_asks(bench: Bench) -> None:
    """Every 50 ms or so, and no more after the axis has stopped."""
    with bench.open() as client:
        client.write(b"G")
        assert eventually(lambda: bench.slot.cells["position"] > 0)
        seen = bench.slot.cells["position"]
        assert eventually(lambda: bench.slot.cells["position"] > seen + 100)
        client.write(b"SP")
        stopped = int.from_bytes(client.read(4), "big")
    assert bench.slot.cells["position"] <= stopped


def test_a_twin_may_be_used_from_another_thread_meanwhile(bench: Bench) -> None:
    """A hand at an input does not wait for the host."""
    bench.line.twins[0].inputs.reference = True
    assert ("reference", True) in [(name, value) for _, name, value in bench.device.done]


def test_without_pacing_an_exchange_takes_the_devices_own_time_only(tmp_path: Path) -> None:
    """1 ms here, although the bytes alone would take a second."""
    bench = Bench(tmp_path, paced=False, line_format=LineFormat(50))
    bench.rack.start()
    try:
        with bench.open(50) as client:
            took = []
            for _ in range(20):
                begin = time.monotonic()
                client.write(b"P")
                assert client.read(4) == bytes(4)
                took.append(time.monotonic() - begin)
        assert LATENCY_NS / NS_PER_S <= min(took) < LineFormat(50).span_ns(5) / NS_PER_S
    finally:
        bench.rack.stop()


def test_a_client_that_floods_waits_and_does_not_spoil_the_line_for_good(bench: Bench) -> None:
    """The flood is taken at the line's rate; when it ends, the other client is answered."""
    # While it lasts, answers collide with it on the half-duplex pair.
    with bench.open() as client:
        with bench.connect() as flooder:
            flooder.setblocking(False)
            flooder.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
            sent = 0
            end = time.monotonic() + 0.2
            while time.monotonic() < end:
                with contextlib.suppress(BlockingIOError):
                    sent += flooder.send(b"x" * 65536)
                time.sleep(0.01)
            assert 4096 < sent < 200_000, "the kernels keep what the line cannot take"
            assert eventually(lambda: bench.line.host_backlog > 0)
            assert bench.line.host_backlog <= 4096
        client.write(b"W")
        assert client.read(1) == b"K"


def test_stopping_takes_no_time_and_is_final(tmp_path: Path) -> None:
    """The thread has ended, the link is gone, and a second stop does nothing."""
    bench = Bench(tmp_path)
    bench.rack.start()
    threads = threading.active_count()
    with bench.open():
        begin = time.monotonic()
        bench.rack.stop()
        assert time.monotonic() - begin < TIMEOUT_S
    assert threading.active_count() == threads - 1
    assert not os.path.lexists(bench.pty.url)
    bench.rack.stop()


def test_a_server_that_was_never_started_can_be_stopped(tmp_path: Path) -> None:
    """Nothing is left behind, no descriptor either (a leak would be a warning)."""
    Bench(tmp_path).rack.stop()


def test_when_one_port_cannot_be_opened_none_is(tmp_path: Path) -> None:
    """The link of the first is gone again when the second fails."""
    bench = Bench(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = TcpPort(f"127.0.0.1:{other.getsockname()[1]}")
        rack = Rack()
        rack.add(Server(bench.line, [bench.pty, taken], loop=rack.loop))
        with pytest.raises(PortError):
            rack.start()
    assert not os.path.lexists(bench.pty.url)
    bench.rack.stop()


def test_a_disk_that_fails_ends_the_server_with_the_reason(tmp_path: Path) -> None:
    """No acknowledgement leaves, and whoever runs the server is told."""
    bench = Bench(tmp_path, slot=FullDisk())
    bench.rack.start()
    with bench.open() as client:
        client.write(b"W")
        with pytest.raises(serial.SerialException):
            client.read(1)
    with pytest.raises(StateError, match="no room"):
        bench.rack.stop()


def test_a_bug_ends_the_server_and_is_not_hidden(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a device raises reaches whoever runs the server."""

    def fail(*_: Any) -> None:
        raise AssertionError("our bug")

    bench = Bench(tmp_path)
    monkeypatch.setattr(bench.device, "receive", fail)
    bench.rack.open()
    with bench.connect() as client:
        client.sendall(b"P")
        with pytest.raises(AssertionError, match="our bug"):
            bench.rack.run()


def test_in_the_main_thread_a_signal_ends_it(tmp_path: Path) -> None:
    """SIGTERM makes ``run`` return."""
    bench = Bench(tmp_path)
    bench.rack.open()
    bench.rack.loop.call_later(0.05, os.kill, os.getpid(), signal.SIGTERM)
    bench.rack.loop.install_signal_handlers([signal.SIGTERM])
    bench.rack.run()
    assert not os.path.lexists(bench.pty.url)
