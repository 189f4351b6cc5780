"""The RFC 2217 port: the client's settings reach the line."""

import random
import socket
from collections.abc import Iterator

import pytest
import serial
from served import EVERY_BYTE, TIMEOUT_S, Served, eventually, hurry_rfc2217_clients, receive_until

from axistwin.kernel.time import NS_PER_MS
from axistwin.ports.rfc2217 import Rfc2217Port
from axistwin.ports.tcp import parse_address
from axistwin.wire.framing import LineFormat

# pyserial's own client does it that way.
pytestmark = [
    pytest.mark.system,
    pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning"),
]

IAC, SB, SE = b"\xff", b"\xfa", b"\xf0"
XON, XOFF = b"\x11", b"\x13"


class Bench(Served):
    """An echo line behind an RFC 2217 port."""

    def __init__(self) -> None:
        self.rfc2217 = Rfc2217Port("127.0.0.1:0")
        super().__init__(self.rfc2217)

    def open(self, baud: int = 38400, *, parity: str = "N", xonxoff: bool = False) -> serial.Serial:
        """A client as pyserial makes it."""
        return serial.serial_for_url(
            self.rfc2217.url, baud, parity=parity, xonxoff=xonxoff, timeout=TIMEOUT_S
        )

    def connect(self) -> socket.socket:
        """A client that speaks for itself."""
        address = parse_address(self.rfc2217.url.removeprefix("rfc2217://"))
        return socket.create_connection(address, timeout=TIMEOUT_S)


@pytest.fixture(autouse=True)
def _impatient_client(monkeypatch: pytest.MonkeyPatch) -> None:
    hurry_rfc2217_clients(monkeypatch)


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A running bench."""
    with Bench() as bench:
        yield bench


def test_every_byte_value_passes_unchanged(bench: Bench) -> None:
    """FFh, Telnet's escape, included."""
    with bench.open() as client:
        client.write(EVERY_BYTE)
        assert client.read(256) == EVERY_BYTE


def test_rate_and_framing_of_the_client_are_the_hosts(bench: Bench) -> None:
    """Odd rates, parity, data and stop bits all reach the line."""
    with bench.open(12345, parity="E") as client:
        client.write(b"a")
        assert client.read(1) == b"?"
        assert bench.line.formats[-1] == LineFormat(12345, 8, "E", 2)
        client.baudrate, client.bytesize, client.parity, client.stopbits = 4800, 7, "O", 2
        client.write(b"a")
        assert client.read(1) == b"?"
        assert bench.line.formats[-1] == LineFormat(4800, 7, "O", 4)
        client.baudrate, client.bytesize, client.parity, client.stopbits = 38400, 8, "N", 1
        client.write(b"a")
        assert client.read(1) == b"a"


def test_what_was_sent_before_a_setting_has_the_one_before(bench: Bench) -> None:
    """Also when both come in one piece, as from a client that does not wait for the answer."""
    baud = IAC + SB + b"\x2c\x01" + (4800).to_bytes(4, "big") + IAC + SE
    with bench.connect() as client:
        client.sendall(b"a" + baud + b"b")
        assert eventually(lambda: len(bench.line.formats) == 2)
    assert [each.baud for each in bench.line.formats] == [38400, 4800]


def test_a_break_reaches_the_line_with_its_length(bench: Bench) -> None:
    """The line is held at space for as long as the client held it."""
    with bench.open() as client:
        client.break_condition = True
        client.break_condition = False
        assert eventually(lambda: len(bench.line.breaks) == 1)
        assert 0 < bench.line.breaks[0] < TIMEOUT_S * 1000 * NS_PER_MS


def test_a_break_without_end_holds_the_line_for_a_second_at_most(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody on the line could tell a longer one from it, and others wait."""
    with bench.open() as client:
        client.break_condition = True
        client.write(b"x")
        assert client.read(1) == b"x"
        later_ns = bench.line.clock.now_ns() + 3600 * 1000 * NS_PER_MS
        monkeypatch.setattr(bench.line.clock, "now_ns", lambda: later_ns)
        client.break_condition = False
        assert eventually(lambda: bench.line.breaks == [1000 * NS_PER_MS])


def test_what_a_break_is_answered_with_reaches_the_client(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Settings come without bytes, and still there may be something to hear then."""

    def answer(duration_ns: int) -> None:
        bench.line.send(b"!")

    monkeypatch.setattr(bench.line, "send_break", answer)
    with bench.open() as client:
        client.break_condition = True
        client.break_condition = False
        assert client.read(1) == b"!"


def test_no_rate_is_slower_than_what_systems_have_a_name_for(bench: Bench) -> None:
    """At one bit per second a byte would hold the line for ten seconds; it becomes 50."""
    with bench.open(1) as client:
        client.write(b"a")
        assert client.read(1) == b"?"
    assert bench.line.formats[-1] == LineFormat(50)


def test_purging_the_output_drops_what_is_not_on_the_line_yet(bench: Bench) -> None:
    """pyserial's ``reset_output_buffer``."""
    bench.line.is_blocked = True
    with bench.open() as client:
        client.write(b"regretted")
        assert eventually(lambda: bench.line.host_backlog == 9)
        client.reset_output_buffer()
        assert bench.line.host_backlog == 0


def test_the_modem_lines_of_an_adapter_are_on(bench: Bench) -> None:
    """A client that waits for CTS or DSR does not wait in vain."""
    with bench.open() as client:
        client.rts, client.dtr = False, True
        assert client.cts
        assert client.dsr
        assert client.cd
        assert not client.ri


def test_a_second_client_is_refused_and_the_first_goes_on(bench: Bench) -> None:
    """A serial port belongs to one; it is free when that one has gone."""
    with bench.open() as client:
        with bench.connect() as second:
            assert second.recv(1) == b""
        client.write(b"mine")
        assert client.read(4) == b"mine"
    assert eventually(lambda: bench.names() == ["connected", "refused", "disconnected"])
    assert bench.events[1]["clients_max"] == 1
    with bench.open() as client:
        client.write(b"next")
        assert client.read(4) == b"next"


def test_every_client_starts_at_the_devices_own_rate(bench: Bench) -> None:
    """What the last one has set is forgotten."""
    with bench.open(9600):
        pass
    assert eventually(lambda: bench.names()[-1:] == ["disconnected"])
    with bench.connect() as client:
        client.sendall(b"plain")
        receive_until(client, b"plain")


def test_xon_and_xoff_pass_unless_the_client_wants_flow_control(bench: Bench) -> None:
    """A driver that does not, sees 13h and 11h as the bytes they are."""
    with bench.open() as client:
        client.write(XOFF + XON + b"x")
        assert client.read(3) == XOFF + XON + b"x"


def test_a_client_with_flow_control_is_held_by_xoff_and_released_by_xon(bench: Bench) -> None:
    """And never gets to see either, as with a real port."""
    with bench.open(xonxoff=True) as client:
        client.write(b"go")
        assert client.read(2) == b"go"
        bench.line.speak(XOFF + b"stop")
        assert client.read(4) == b"stop"
        client.write(b"held")
        client.timeout = 0.1
        assert client.read(1) == b""
        assert bytes(bench.line.heard) == b"go"
        client.timeout = TIMEOUT_S
        bench.line.speak(XON)
        assert client.read(4) == b"held"


@pytest.mark.parametrize(
    "garbage",
    [
        IAC + SE,
        IAC + SB + IAC + SE,
        IAC + SB + b"\x2c\x01\x00" + IAC + SE,
        IAC + SB + b"\x2c\x03\x09" + IAC + SE,
        IAC + SB + b"\x2c\x02\x63" + IAC + SE,
        IAC + SB + b"\x2c\x0b" + IAC + SE,
        IAC + SB + b"endless" * 1000 + IAC + SE,
    ],
    ids=["end", "empty", "short-rate", "parity", "data-bits", "mask", "endless"],
)
def test_a_malformed_negotiation_is_survived(bench: Bench, garbage: bytes) -> None:
    """Cut short, out of range or endless: the next bytes are served."""
    with bench.connect() as client:
        client.sendall(garbage + b"after all")
        receive_until(client, b"after all")


def test_random_bytes_never_break_the_server(bench: Bench) -> None:
    """Seeded noise, rich in escapes; a new client is served as if nothing had been."""
    rng = random.Random(2217)
    noise = bytes(rng.choice((255, 250, 240, 44, rng.randrange(256))) for _ in range(20_000))
    with bench.connect() as client:
        client.sendall(noise)
        client.shutdown(socket.SHUT_WR)
        while client.recv(65536):
            pass
    with bench.open() as port:
        port.write(b"fine")
        assert port.read(4) == b"fine"
