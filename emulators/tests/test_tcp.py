"""The TCP port: raw bytes for several clients at once."""

import contextlib
import socket
import time
from collections.abc import Iterator

import pytest
import serial
from served import EVERY_BYTE, TIMEOUT_S, Served, eventually, falls_quiet

from axistwin import catalog
from axistwin.errors import PortError, UsageError
from axistwin.ports.rfc2217 import Rfc2217Port
from axistwin.ports.tcp import CLIENTS_MAX, TcpPort, is_loopback, parse_address
from axistwin.runtime.serving.line_server import BAUD_MIN, TURN_NS, Server
from axistwin.runtime.serving.rack import Rack
from axistwin.wire.framing import LineFormat

pytestmark = pytest.mark.system


class Bench(Served):
    """An echo line behind a TCP port."""

    def __init__(self, address: str = "127.0.0.1:0") -> None:
        self.tcp = TcpPort(address)
        super().__init__(self.tcp)

    def connect(self) -> socket.socket:
        """A new client."""
        host, port = parse_address(self.tcp.url.removeprefix("socket://"))
        return socket.create_connection((host, port), timeout=TIMEOUT_S)


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A running bench."""
    with Bench() as bench:
        yield bench


def receive(client: socket.socket, count: int) -> bytes:
    """Exactly ``count`` bytes."""
    data = b""
    while len(data) < count:
        more = client.recv(count - len(data))
        assert more, "disconnected"
        data += more
    return data


def test_every_byte_value_passes_unchanged(bench: Bench) -> None:
    """Nothing is added, escaped or swallowed."""
    with bench.connect() as client:
        client.sendall(EVERY_BYTE)
        assert receive(client, 256) == EVERY_BYTE


def test_pyserial_opens_the_url_that_is_told(bench: Bench) -> None:
    """``url`` names the port that was really taken for port 0."""
    assert not bench.tcp.url.endswith(":0")
    with serial.serial_for_url(bench.tcp.url, timeout=TIMEOUT_S) as client:
        client.write(b"hello")
        assert client.read(5) == b"hello"


def test_ipv6_works_where_the_machine_has_it() -> None:
    """``[::1]:0`` listens on the IPv6 loopback."""
    bench = Bench("[::1]:0")
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(bench)
        except PortError:
            pytest.skip("this machine has no IPv6")
        with bench.connect() as client:
            client.sendall(b"six")
            assert receive(client, 3) == b"six"


def test_clients_that_come_and_go_are_reported(bench: Bench) -> None:
    """Fifty of them, one after another."""
    for _ in range(50):
        with bench.connect() as client:
            client.sendall(b"x")
            assert receive(client, 1) == b"x"
    assert eventually(lambda: bench.names() == ["connected", "disconnected"] * 50)


def test_every_client_hears_the_whole_line(bench: Bench) -> None:
    """As on a tee: what one has asked, all get the answer to."""
    with bench.connect() as first, bench.connect() as second:
        assert eventually(lambda: len(bench.names()) == 2)
        first.sendall(b"asked by the first")
        assert receive(second, 18) == b"asked by the first"


def test_the_line_follows_the_devices_when_they_change_their_rate(bench: Bench) -> None:
    """A client without a rate is at the right one always."""
    bench.line.own_format = LineFormat(9600)
    with bench.connect() as client:
        client.sendall(b"x")
        assert receive(client, 1) == b"x"


def test_a_client_that_floods_does_not_shut_out_another(bench: Bench) -> None:
    """The flood waits in its own client, and the other's bytes go out soon."""
    bench.line.is_blocked = True
    with bench.connect() as flooder, bench.connect() as other:
        flooder.settimeout(0.3)
        with contextlib.suppress(TimeoutError):
            flooder.sendall(b"x" * 20_000_000)
        assert eventually(lambda: bench.line.host_backlog > 0)
        assert falls_quiet(lambda: bench.line.host_backlog)
        backlog = bench.line.host_backlog
        assert backlog <= 4096
        other.sendall(b"polite")
        assert eventually(lambda: bench.line.host_backlog == backlog + 6)
        bench.line.unblock()
        assert receive(other, backlog + 6).endswith(b"polite")


@pytest.mark.parametrize("scheme", ["tcp", "rfc2217"])
@pytest.mark.parametrize("host", ["127.0.0.1", "[::1]"])
def test_a_flooder_that_gives_up_and_closes_leaves_the_line_free(scheme: str, host: str) -> None:
    """What it left in the kernels' buffers goes out for about a second, and then no more."""
    make = TcpPort if scheme == "tcp" else Rfc2217Port
    specs = [catalog.parse_device("mac23")]
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(catalog.build_line(specs))
        port, quiet = make(f"{host}:0"), TcpPort("127.0.0.1:0")
        rack = Rack()
        rack.add(Server(line, [port, quiet], loop=rack.loop))
        try:
            rack.start()
        except PortError:
            pytest.skip("this machine has no IPv6")
        stack.callback(rack.stop)
        flooder = socket.create_connection(parse_address(port.url.partition("//")[2]))
        flooder.settimeout(0.3)
        with pytest.raises(TimeoutError):
            flooder.sendall(b"x" * 10_000_000)
        flooder.shutdown(socket.SHUT_RDWR)
        flooder.close()
        other = stack.enter_context(
            serial.serial_for_url(quiet.url, timeout=0.3),
        )
        begin = time.monotonic()
        answer = b""
        while not answer.startswith(b"\x06\x13\x02") and time.monotonic() < begin + 30:
            other.write(b"\x0201400200000000000A2\x03")
            answer = other.read(21)
        assert answer.startswith(b"\x06\x13\x02"), answer


def test_a_slow_client_that_sends_and_closes_leaves_the_line_free() -> None:
    """Fifty bytes at one bit per second would take minutes; they go out for about a second."""
    with contextlib.ExitStack() as stack:
        line = stack.enter_context(catalog.build_line([catalog.parse_device("mac23")]))
        slow, quiet = Rfc2217Port("127.0.0.1:0"), TcpPort("127.0.0.1:0")
        rack = Rack()
        rack.add(Server(line, [slow, quiet], loop=rack.loop))
        rack.start()
        stack.callback(rack.stop)
        with socket.create_connection((slow.host, slow.port)) as client:
            client.sendall(b"\xff\xfa\x2c\x01\0\0\0\1\xff\xf0" + b"U" * 50)
            assert eventually(lambda: line.host_format.baud == BAUD_MIN)
        assert eventually(lambda: not slow._connections)
        assert line.host_busy_ns <= 2 * TURN_NS
        other = stack.enter_context(serial.serial_for_url(quiet.url, timeout=TIMEOUT_S))
        other.write(b"\x0201400200000000000A2\x03")
        assert other.read(21).startswith(b"\x06\x13\x02")


def test_a_client_that_sends_and_closes_is_heard_to_its_end(bench: Bench) -> None:
    """A few frames sent with the close right behind them all reach the line."""
    with bench.connect() as client:
        client.sendall(EVERY_BYTE * 4)
    assert eventually(lambda: bench.line.heard == EVERY_BYTE * 4)


def test_a_client_that_never_reads_stops_nobody(bench: Bench) -> None:
    """Its bytes are dropped when a bound is reached; the others get theirs."""
    with bench.connect() as deaf, bench.connect() as other:
        assert eventually(lambda: len(bench.names()) == 2)
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        piece = b"y" * 1000
        for _ in range(3000):
            other.sendall(piece)
            assert receive(other, 1000) == piece
    assert eventually(lambda: bench.names().count("disconnected") == 2)
    dropped = [event.get("dropped_bytes", 0) for event in bench.events]
    assert max(dropped) > 100_000


def test_a_client_that_resets_its_connection_is_gone(bench: Bench) -> None:
    """An aborted connection is as good as a closed one."""
    client = bench.connect()
    client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")
    client.close()
    assert eventually(lambda: bench.names() == ["connected", "disconnected"])


def test_clients_beyond_the_limit_are_closed_at_once(bench: Bench) -> None:
    """The limit bounds memory; a place becomes free when a client leaves."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(bench.connect()) for _ in range(CLIENTS_MAX)]
        assert eventually(lambda: len(bench.names()) == CLIENTS_MAX)
        with bench.connect() as surplus:
            assert surplus.recv(1) == b""
        clients[0].close()
        assert eventually(lambda: "disconnected" in bench.names())
        with bench.connect() as late:
            late.sendall(b"in")
            assert receive(late, 2) == b"in"


def test_a_port_in_use_is_one_clear_line(bench: Bench) -> None:
    """The message names the address and the remedy."""
    address = bench.tcp.url.removeprefix("socket://")
    with pytest.raises(PortError, match=rf"tcp {address}: .*in use.*0 for a free one"):
        Bench(address).rack.open()


def test_an_address_of_another_machine_cannot_be_listened_at() -> None:
    """One clear line, too."""
    with pytest.raises(PortError, match=r"tcp 192\.0\.2\.1:0: cannot listen there"):
        Bench("192.0.2.1:0").rack.open()


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:5000", ("127.0.0.1", 5000)),
        ("localhost:0", ("localhost", 0)),
        ("[::1]:65535", ("::1", 65535)),
    ],
)
def test_addresses_are_host_and_port(text: str, address: tuple[str, int]) -> None:
    """IPv6 hosts stand in brackets."""
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["", "5000", ":5000", "host:", "host:x", "host:65536", "host:-1"])
def test_an_address_that_cannot_be_read_is_a_usage_error(text: str) -> None:
    """The message shows the form."""
    with pytest.raises(UsageError, match="HOST:PORT is needed"):
        parse_address(text)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("lab", False)],
)
def test_only_the_loopback_counts_as_loopback(host: str, expected: bool) -> None:
    """Everything else deserves a warning."""
    assert is_loopback(host) is expected


def test_stopping_disconnects_the_clients() -> None:
    """A client sees the end of the connection, and the port is free again at once."""
    with Bench() as bench:
        client = bench.connect()
        assert eventually(lambda: bench.names() == ["connected"])
    with client:
        assert client.recv(1) == b""
    begin = time.monotonic()
    with Bench(bench.tcp.url.removeprefix("socket://")):
        assert time.monotonic() - begin < TIMEOUT_S
