"""Faults of the wire at every kind of port: what a host hears there, in real time."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
import serial
from served_bus import ServedBus, client
from wire_fault_checks import check_bus, check_line

from axistwin.catalog import build_line, parse_device
from axistwin.ports.can_hub import SlcanPtyPort, SlcanTcpPort, SocketcandPort
from axistwin.ports.can_join import JoinPort
from axistwin.ports.pty import PtyPort
from axistwin.ports.rfc2217 import Rfc2217Port
from axistwin.ports.tcp import TcpPort
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.line import Line
from axistwin.runtime.serving.line_server import LinePort, Server
from axistwin.runtime.serving.rack import Rack

# pyserial's RFC 2217 client does it that way.
pytestmark = [
    pytest.mark.system,
    pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning"),
]

BAUD = 38400


@contextlib.contextmanager
def served(
    make_port: type[TcpPort | Rfc2217Port] | None, folder: Path
) -> Iterator[tuple[Line, str]]:
    """A line with a module, and the URL where it is found."""
    with build_line([parse_device("mac23:0")], clock=PacedClock()) as line:
        port: LinePort
        if make_port is None:
            port = PtyPort(str(folder / "mac23"), line.device_format)
        else:
            port = make_port("127.0.0.1:0")
        rack = Rack()
        rack.add(Server(line, [port], loop=rack.loop))
        rack.start()
        try:
            yield line, port.url
        finally:
            rack.stop()


@pytest.mark.parametrize("make_port", [None, TcpPort, Rfc2217Port], ids=["pty", "tcp", "rfc2217"])
def test_a_host_of_a_serial_line_meets_every_fault(
    make_port: type[TcpPort | Rfc2217Port] | None, tmp_path: Path
) -> None:
    """Each once; and then all is as before."""
    with served(make_port, tmp_path) as (line, url), serial.serial_for_url(url, BAUD) as host:
        check_line(line, host)


@pytest.mark.parametrize("make_port", [SlcanPtyPort, SlcanTcpPort, SocketcandPort])
def test_a_host_of_the_hub_meets_every_fault(
    make_port: type[SlcanPtyPort | SlcanTcpPort | SocketcandPort], tmp_path: Path
) -> None:
    """Each once; and then all is as before."""
    port = make_port(str(tmp_path / "can") if make_port is SlcanPtyPort else "127.0.0.1:0")
    with ServedBus(port) as bench, client(port.client_line) as host:
        check_bus(bench.bus, host)


def test_a_host_of_a_bus_that_is_joined_meets_every_fault() -> None:
    """Where frames take no time; ``tests/vm`` does the same on vcan."""
    with (
        can.Bus(interface="virtual", channel="faults") as host,
        ServedBus(JoinPort("virtual:faults", 125_000), paced=False) as bench,
    ):
        check_bus(bench.bus, host)
