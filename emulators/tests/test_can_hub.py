"""The hub: clients of a bus of twins on ptys and on TCP, in real time."""

import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import can
import canopen_talk
import pytest
from can_clients import frame_of, message
from served import eventually, falls_quiet
from served_bus import POSITION, TIMEOUT_S, ServedBus, client, receive
from spy_storage import Disk

from axistwin.errors import PortError, StateError
from axistwin.ports.can_client import OUTPUT_MAX
from axistwin.ports.can_hub import MISTAKES_TOLD_MAX, SlcanPtyPort, SlcanTcpPort, SocketcandPort
from axistwin.ports.tcp import parse_address
from axistwin.runtime.serving.bus_server import BusPort
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.system

BURST = [CanFrame(0x100 + i % 0x400, i.to_bytes(8, "big")) for i in range(300)]


class Hub(ServedBus):
    """Modules 1 and 2 behind all three kinds of port."""

    def __init__(self, folder: Path, **options: Any) -> None:
        self.pty = SlcanPtyPort(str(folder / "mac"))
        self.tcp = SlcanTcpPort("127.0.0.1:0")
        self.daemon = SocketcandPort("127.0.0.1:0")
        super().__init__(self.pty, self.tcp, self.daemon, **options)


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[Hub]:
    """A hub that is served, with frames that take their time."""
    with Hub(tmp_path) as hub:
        yield hub


@pytest.fixture
def fast_hub(tmp_path: Path) -> Iterator[Hub]:
    """A hub whose frames take no time."""
    with Hub(tmp_path, paced=False) as hub:
        yield hub


def connect(port: SlcanTcpPort | SocketcandPort) -> socket.socket:
    """A bare client of a TCP port."""
    address = parse_address(port.url.partition("//")[2])
    return socket.create_connection(address, timeout=TIMEOUT_S)


def converse(bus: can.BusABC) -> None:
    """A position is asked for and told."""
    bus.send(POSITION)
    assert receive(bus, 0x581).data == bytes.fromhex("4200200000000000")


PORTS: list[Callable[[Hub], BusPort]] = [
    lambda hub: hub.pty,
    lambda hub: hub.tcp,
    lambda hub: hub.daemon,
]
EACH_PORT = pytest.mark.parametrize("port", PORTS, ids=["slcan", "slcan-tcp", "socketcand"])


# ---- conversations -------------------------------------------------------------------------------


@EACH_PORT
def test_python_can_converses_by_the_line_that_is_told(
    hub: Hub, port: Callable[[Hub], BusPort]
) -> None:
    """Again and again, as programs come and go; comings and goings are reported."""

    def has_ended(count: int) -> bool:
        return hub.names().count("disconnected") == count

    for count in (1, 2, 3):
        with client(port(hub).client_line) as bus:
            converse(bus)
        assert eventually(partial(has_ended, count))
    assert hub.names() == ["connected", "disconnected"] * 3
    assert {event["endpoint"] for event in hub.events} == {port(hub).kind}
    assert [each.get("dropped_messages") for each in hub.events] == [None, 0] * 3


def test_all_hear_one_order_and_nobody_hears_himself(hub: Hub) -> None:
    """Three clients send at once, two listen: the same frames in the same order, none missing."""
    lines = [port(hub).client_line for port in PORTS]
    bursts = [BURST[:100], BURST[100:200], BURST[200:]]
    with (
        client(lines[0]) as one,
        client(lines[1]) as two,
        client(lines[2]) as three,
        client(lines[1]) as listener,
        client(lines[2]) as other_listener,
    ):
        senders = [one, two, three]
        threads = [
            threading.Thread(target=lambda b=b, f=f: [b.send(message(each)) for each in f])
            for b, f in zip(senders, bursts, strict=True)
        ]
        for thread in threads:
            thread.start()
        heard = [frame_of(listener.recv(TIMEOUT_S)) for _ in BURST]
        assert [frame_of(other_listener.recv(TIMEOUT_S)) for _ in BURST] == heard
        for sender, own in zip(senders, bursts, strict=True):
            expected = [frame for frame in heard if frame not in own]
            assert [frame_of(sender.recv(TIMEOUT_S)) for _ in expected] == expected
            assert sender.recv(0.01) is None
            assert [frame for frame in heard if frame in own] == own
        for thread in threads:
            thread.join(TIMEOUT_S)


def test_a_frame_is_heard_when_it_is_complete(hub: Hub) -> None:
    """With the time of day, not earlier than the bits of the bus take."""
    with client(hub.tcp.client_line) as bus, client(hub.daemon.client_line) as listener:
        took = []
        for _ in range(20):
            sent_at, began = time.time(), time.monotonic()
            bus.send(POSITION)
            reply = receive(listener, 0x581)
            took.append(time.monotonic() - began)
            assert sent_at < reply.timestamp < time.time()
        assert min(took) > 2 * 108 / hub.bus.bitrate


def test_remote_and_extended_frames_pass(fast_hub: Hub) -> None:
    """By slcan, both ways."""
    frames = [
        CanFrame(0x701, b"", False, True, 4),
        CanFrame(0x12345678, b"\x01\x02", True),
        CanFrame(0x1ABCDEF0, b"", True, True),
    ]
    with client(fast_hub.pty.client_line) as one, client(fast_hub.tcp.client_line) as other:
        for frame in frames:
            one.send(message(frame))
            assert frame_of(other.recv(TIMEOUT_S)) == frame
            other.send(message(frame))
            assert frame_of(one.recv(TIMEOUT_S)) == frame


@EACH_PORT
def test_a_burst_is_lossless(hub: Hub, port: Callable[[Hub], BusPort]) -> None:
    """Faster than the bus: the sender is held back, a listener that reads gets everything."""
    with client(port(hub).client_line) as sender, client(hub.tcp.client_line) as listener:
        for frame in BURST:
            sender.send(message(frame))
        assert [frame_of(listener.recv(TIMEOUT_S)) for _ in BURST] == BURST


def test_what_was_sent_before_the_client_closed_still_goes_out(hub: Hub) -> None:
    """A shell's one-liner is heard, though it has gone before the frame is complete."""
    with client(hub.tcp.client_line) as listener:
        fd = os.open(hub.pty.url, os.O_RDWR | os.O_NOCTTY)
        os.write(fd, b"O\r" + b"t60184000200000000000\r" * 20)
        os.close(fd)
        for _ in range(20):
            receive(listener, 0x581)


def test_the_adapter_is_a_new_one_for_each_client(hub: Hub) -> None:
    """A client that leaves the channel open does not open it for the next."""
    for _ in range(2):
        fd = os.open(hub.pty.url, os.O_RDWR | os.O_NOCTTY)
        os.write(fd, b"F\r")
        assert os.read(fd, 10) == b"\a"
        os.write(fd, b"O\rF\r")
        data = b""
        while len(data) < 5:
            data += os.read(fd, 10)
        assert data == b"\rF00\r"
        os.close(fd)
        assert eventually(lambda: hub.pty._stream is None)


def test_raw_mode_s_answer_arrives_alone(hub: Hub) -> None:
    """On a busy bus, python-can's client opens every time."""
    stop = threading.Event()

    def chatter() -> None:
        with client(hub.tcp.client_line) as bus:
            while not stop.is_set():
                bus.send(message(CanFrame(0x7F0)))
                time.sleep(0.0005)

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        for _ in range(20):
            with client(hub.daemon.client_line) as bus:
                receive(bus, 0x7F0)
    finally:
        stop.set()
        thread.join(TIMEOUT_S)


# ---- canopen -------------------------------------------------------------------------------------


def test_canopen_converses_from_another_process(tmp_path: Path) -> None:
    """Objects, a refusal, boot-up, lifebeat, emergency and the address, by slcan on the pty."""
    with Hub(tmp_path, speed=20) as hub:
        process = subprocess.Popen(
            [sys.executable, canopen_talk.__file__, "slcan", hub.pty.url, "wait-for-fault"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        if process.stdout.readline() == "ready for a fault\n":
            hub.bus.twins[0].supply_volts = 11
            time.sleep(0.1)
            hub.bus.twins[0].supply_volts = 24
        out, err = process.communicate(timeout=30)
        assert (process.returncode, out) == (0, "conversed\n"), err
        assert hub.bus.twins[0].address == 1  # the factory's, after another one


# ---- clients that misbehave ----------------------------------------------------------------------


def test_a_sleeping_client_harms_nobody(fast_hub: Hub) -> None:
    """It loses frames, is told so as an adapter does, and that once; another one loses none."""
    sleeper = os.open(fast_hub.pty.url, os.O_RDWR | os.O_NOCTTY)
    os.write(sleeper, b"O\r")
    assert os.read(sleeper, 1) == b"\r"
    per_round, rounds = 100, 50
    assert per_round * rounds * 26 > OUTPUT_MAX + 40_000, "what the kernel keeps, and we"
    frame = message(CanFrame(0x123, bytes(8)))
    with client(fast_hub.daemon.client_line) as sender, client(fast_hub.tcp.client_line) as awake:
        for _ in range(rounds):
            for _ in range(per_round):
                sender.send(frame)
            for _ in range(per_round):
                assert awake.recv(TIMEOUT_S) is not None
        converse(awake)
    assert fast_hub.names().count("overrun") == 1
    data = b""
    while b"F09\r" not in data:
        assert len(data) < 2_000_000, "it was not flagged"
        os.write(sleeper, b"F\r")
        data += os.read(sleeper, 65536)
    lines = data[: data.index(b"F09\r") + 4].split(b"\r")
    assert b"t12380000000000000000" in lines, "what was kept is read in whole lines"
    assert {line[:4] for line in lines} <= {b"t123", b"t601", b"t581", b"F00", b"F09", b""}
    os.close(sleeper)
    assert eventually(lambda: fast_hub.events[-1].get("dropped_messages", 0) > 0)


@pytest.mark.parametrize("port", PORTS[1:], ids=["slcan-tcp", "socketcand"])
def test_junk_harms_nobody(hub: Hub, port: Callable[[Hub], Any]) -> None:
    """Bytes without sense, in pieces, with others conversing beside."""
    with client(hub.pty.client_line) as bus, connect(port(hub)) as junk:
        for piece in (
            bytes(range(256)),
            b"\r" * 100,
            b"<" * 300,
            b"t" * 5000,
            b"< send > < \xff >",
        ):
            junk.sendall(piece)
            converse(bus)
    with client(port(hub).client_line) as bus:
        converse(bus)


def test_a_client_of_another_bus_is_told_and_hung_up(hub: Hub) -> None:
    """The daemon's way; whoever runs the twin is told which bus there is."""
    with connect(hub.daemon) as connection:
        assert connection.recv(100) == b"< hi >"
        connection.sendall(b"< open can7 >")
        answer = b""
        while more := connection.recv(100):
            answer += more
    assert b"vcan0, can0" in answer
    (mistake,) = [event for event in hub.events if event["event"] == "client_mistake"]
    assert "'can7'" in mistake["message"]
    assert mistake["endpoint"] == "socketcand"


def test_a_client_that_goes_on_making_mistakes_is_told_of_a_few_times(hub: Hub) -> None:
    """Each is dropped all the same, and the client is served."""
    with connect(hub.daemon) as connection:
        assert connection.recv(100) == b"< hi >"
        connection.sendall(b"< open can0 >")
        assert connection.recv(100) == b"< ok >"
        for i in range(3 * MISTAKES_TOLD_MAX):
            connection.sendall(b"< send %d >< echo >" % i)
            assert connection.recv(100) == b"< echo >"
    assert hub.names().count("client_mistake") == MISTAKES_TOLD_MAX


def test_a_wrong_bit_rate_is_told(hub: Hub) -> None:
    """Nothing gets through, and the remedy is named."""
    with can.Bus(
        interface="slcan", channel=hub.tcp.url, bitrate=500_000, sleep_after_open=0
    ) as bus:
        bus.send(POSITION)
        assert bus.recv(0.05) is None
    assert eventually(lambda: "client_mistake" in hub.names())
    (mistake,) = [event for event in hub.events if event["event"] == "client_mistake"]
    assert "bitrate=125000" in mistake["message"]


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_client_that_is_held_back_and_gone_is_noticed(hub: Hub, kind: str) -> None:
    """Nobody acknowledges, so its frames never leave; it is let go of all the same."""
    for twin in hub.bus.twins:
        twin.power_off()
    flood = b"O\r" + b"t1230\r" * 200
    if kind == "pty":
        fd = os.open(hub.pty.url, os.O_RDWR | os.O_NOCTTY)
        os.write(fd, flood)
        assert eventually(lambda: "connected" in hub.names())
        os.close(fd)
    else:
        with connect(hub.tcp) as connection:
            connection.sendall(flood)
            assert eventually(lambda: "connected" in hub.names())
    assert eventually(lambda: "disconnected" in hub.names())
    for twin in hub.bus.twins:
        twin.power_on()
    with client(hub.tcp.client_line) as bus:
        receive(bus, 0x701)
        converse(bus)


# ---- time and ends -------------------------------------------------------------------------------


def test_a_bus_at_rest_costs_nothing(hub: Hub, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a client that is silent, nothing is done until something happens."""
    with client(hub.tcp.client_line) as bus:
        pumps: list[float] = []
        pump = hub.server.pump

        def counted() -> None:
            pumps.append(time.monotonic())
            pump()

        monkeypatch.setattr(hub.server, "pump", counted)
        converse(bus)
        assert pumps
        assert falls_quiet(lambda: len(pumps), 0.3)


def test_an_axis_that_moves_is_saved(tmp_path: Path) -> None:
    """Also while nobody asks; a kill may come at any time."""

    storage = Disk()
    with Hub(tmp_path, storage=storage) as hub, client(hub.tcp.client_line) as bus:
        slot = hub.bus._stations[0].slot
        bus.send(message(CanFrame(0x601, bytes.fromhex("2313200000100000"))))  # a long way
        receive(bus, 0x581)
        first = slot.cells["position"]
        assert eventually(lambda: slot.cells["position"] > first)


def test_a_full_disk_ends_the_server_and_leaves_nothing(tmp_path: Path) -> None:
    """One clear error; the link is gone, clients see the end."""

    hub = Hub(tmp_path, storage=Disk())

    def fail(*_: object, **__: object) -> None:
        raise StateError("state: no room; make room")

    hub.rack.start()
    hub.bus._stations[0].slot.save = fail  # type: ignore[method-assign]
    with connect(hub.tcp) as connection:
        connection.sendall(b"O\rt6018230C200000000040\r")
        while connection.recv(100):
            pass
    with pytest.raises(StateError, match="make room"):
        hub.rack.stop()
    assert not os.path.lexists(hub.pty.url)


def test_a_bus_that_has_failed_when_a_client_comes_ends_the_server(tmp_path: Path) -> None:
    """With that error, and no other one."""
    hub = Hub(tmp_path)
    hub.rack.start()
    hub.bus.close()
    with connect(hub.tcp) as connection:
        assert connection.recv(100) == b""
    with pytest.raises(StateError, match="the bus is closed"):
        hub.rack.stop()


def test_ports_that_cannot_be_had_are_one_clear_line(hub: Hub, tmp_path: Path) -> None:
    """A link and an address that are taken, with the option that chooses another."""
    with pytest.raises(PortError, match="choose another --slcan"):
        SlcanPtyPort(hub.pty.url).open()
    taken = hub.daemon.url.partition("//")[2]
    with pytest.raises(PortError, match=f"socketcand {taken}: cannot listen there"):
        SocketcandPort(taken).open()


def test_stopping_ends_all_clients(tmp_path: Path) -> None:
    """The link is gone, connections are closed, the bus is left."""
    with Hub(tmp_path) as hub:
        fd = os.open(hub.pty.url, os.O_RDWR | os.O_NOCTTY)
        connection = connect(hub.daemon)
        assert connection.recv(100) == b"< hi >"
        assert eventually(lambda: hub.names().count("connected") == 2)
    assert connection.recv(100) == b""
    connection.close()
    with pytest.raises(OSError, match="Input/output error"):
        os.write(fd, b"O\r")
    os.close(fd)
    assert not os.path.lexists(hub.pty.url)
