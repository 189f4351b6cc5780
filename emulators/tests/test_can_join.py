"""Joining a bus through python-can: frames both ways, echoes, backpressure, and a bus that goes."""

import errno
import importlib.util
import os
import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import can
import canopen_talk
import pytest
from can_clients import frame_of, message
from served import eventually
from served_bus import POSITION, TIMEOUT_S, ServedBus, client, receive

from axistwin.errors import PortError, UsageError
from axistwin.kernel.time import NS_PER_S
from axistwin.ports.can_hub import SlcanPtyPort, SlcanTcpPort, SocketcandPort
from axistwin.ports.can_join import QUEUE_FRAMES, JoinPort
from axistwin.wire.can_frame import CanFrame

pytestmark = pytest.mark.system

REPLY = CanFrame(0x581, bytes.fromhex("4200200000000000"))
BITRATE = 125_000


def virtual_place() -> str:
    """A bus of this process that no other test uses."""
    return f"virtual:{random.getrandbits(64):x}"


@contextmanager
def joined(place: str, **options: Any) -> Iterator[ServedBus]:
    """Modules 1 and 2 on the bus at ``place``."""
    with ServedBus(JoinPort(place, BITRATE), paced=False, **options) as served:
        yield served


def assert_ends(served: ServedBus, reason: str) -> None:
    """The server ends by itself, with the one clear error that has ``reason``."""
    thread = served.rack._thread
    assert thread is not None
    assert eventually(lambda: not thread.is_alive())
    with pytest.raises(PortError, match=rf"^can .*: the bus is gone \({reason}\); bring it back"):
        served.rack.stop()
    served.bus.close()


def other_end(place: str) -> can.BusABC:
    """Another program on the virtual bus."""
    return can.Bus(interface="virtual", channel=place.partition(":")[2])


# ---- frames --------------------------------------------------------------------------------------


def test_modules_converse_on_a_bus_without_a_descriptor() -> None:
    """It is read by a thread; each module's replies come in the order of the requests."""
    place = virtual_place()
    with joined(place), other_end(place) as bus:
        asked: dict[int, list[int]] = {1: [], 2: []}
        for i in range(300):
            address = 1 + i % 2
            asked[address].append(i % 256)
            data = bytes((0x40, i % 8, 0x20, i % 256, 0, 0, 0, 0))
            bus.send(message(CanFrame(0x600 + address, data)))
        heard = [frame_of(bus.recv(TIMEOUT_S)) for _ in range(300)]
        for address, sub_indices in asked.items():
            told = [each.data[3] for each in heard if each.identifier == 0x580 + address]
            assert told == sub_indices


def test_a_joined_bus_and_hub_clients_are_one() -> None:
    """What a client of the hub sends is heard outside and by the modules, and so back."""
    place = virtual_place()
    port, hub = JoinPort(place, BITRATE), SlcanTcpPort("127.0.0.1:0")
    extended = CanFrame(0x12345, b"\x01", True)
    with (
        ServedBus(port, hub, paced=False),
        other_end(place) as bus,
        client(hub.client_line) as inside,
    ):
        inside.send(POSITION)
        assert frame_of(bus.recv(TIMEOUT_S)) == frame_of(POSITION)
        assert frame_of(bus.recv(TIMEOUT_S)) == REPLY
        assert frame_of(inside.recv(TIMEOUT_S)) == REPLY
        bus.send(message(extended))
        assert frame_of(inside.recv(TIMEOUT_S)) == extended


def test_what_is_not_for_modules_is_not_heard() -> None:
    """Error frames and CAN FD; the bus goes on."""
    place = virtual_place()
    with joined(place) as served, other_end(place) as bus:
        bus.send(can.Message(is_error_frame=True))
        bus.send(
            can.Message(arbitration_id=0x601, is_fd=True, data=bytes(12), is_extended_id=False)
        )
        bus.send(POSITION)
        assert frame_of(bus.recv(TIMEOUT_S)) == REPLY
        assert [passed.frame for passed in served.bus.transcript] == [frame_of(POSITION), REPLY]


def test_spontaneous_messages_go_out_when_the_module_says() -> None:
    """A boot-up comes two seconds of the module's after power, a thousand times as fast here."""
    place = virtual_place()
    with joined(place, speed=1000) as served, other_end(place) as bus:
        before_ns = served.bus.sync()
        served.bus.twins[0].power_cycle()
        receive(bus, 0x701)
        assert served.bus.sync() - before_ns >= 2 * NS_PER_S


# ---- an interface that is slow, echoes, or fails -------------------------------------------------


class Interface(can.BusABC):
    """An interface with a descriptor: what the test puts in is received, ``sent`` was sent.

    trouble: called before every send and receive.
    """

    def __init__(self) -> None:
        super().__init__("test")
        self.sent: list[CanFrame] = []
        self.echoes = False
        self.on_send: Callable[[], None] = lambda: None
        self.on_receive: Callable[[], None] = lambda: None
        self.sends = self.receives = 0
        self._queue: list[can.Message] = []
        self._lock = threading.Lock()
        self._read_fd, self._write_fd = os.pipe()

    def put(self, frame: CanFrame) -> None:
        """Let ``frame`` be received."""
        with self._lock:
            self._queue.append(message(frame))
        os.write(self._write_fd, b"x")

    def fileno(self) -> int:
        """Readable when there is something."""
        return self._read_fd

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Note it."""
        self.sends += 1
        self.on_send()
        self.sent.append(frame_of(msg))
        if self.echoes:
            self.put(frame_of(msg))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self.receives += 1
        self.on_receive()
        with self._lock:
            if not self._queue:
                return None, False
            os.read(self._read_fd, 1)
            return self._queue.pop(0), False

    def shutdown(self) -> None:
        """Close."""
        super().shutdown()
        os.close(self._read_fd)
        os.close(self._write_fd)


@pytest.fixture
def interface(monkeypatch: pytest.MonkeyPatch) -> Interface:
    """What python-can opens, whatever is asked for."""
    interface = Interface()
    monkeypatch.setattr(can, "Bus", lambda **_: interface)
    return interface


def test_a_busy_interface_holds_frames_back_in_order(interface: Interface) -> None:
    """ENOBUFS and a full buffer: tried again, not at once and not in a loop."""
    refusals = [
        can.CanOperationError("no buffer", errno.ENOBUFS),
        can.CanOperationError("full"),
    ] * 4
    refusals[0].__cause__ = OSError(errno.ENOBUFS, "No buffer space available")

    def refuse() -> None:
        if refusals:
            raise refusals.pop()

    interface.on_send = refuse
    with joined("pcan:x"):
        for sub_index in range(20):
            interface.put(CanFrame(0x601, bytes((0x40, 0, 0x20, sub_index, 0, 0, 0, 0))))
        assert eventually(lambda: len(interface.sent) == 20)
    assert [frame.data[3] for frame in interface.sent] == list(range(20))
    assert interface.sends == 28


def test_an_interface_that_takes_nothing_loses_the_newest(interface: Interface) -> None:
    """Bounded, told once, counted at the end, and hardly tried meanwhile."""

    def refuse() -> None:
        raise can.CanTimeoutError("nobody acknowledges")

    interface.on_send = refuse
    count = QUEUE_FRAMES + 100
    with joined("pcan:x") as served:
        for i in range(count):
            interface.put(CanFrame(0x601, bytes((0x40, 0, 0x20, i % 256, 0, 0, 0, 0))))
        assert eventually(lambda: "overrun" in served.names())
        (port,) = served.server.ports
        assert isinstance(port, JoinPort)
        member = port._member
        assert member is not None
        assert eventually(lambda: member._dropped == 100)
        began_s, sends = time.monotonic(), interface.sends
        time.sleep(0.3)
        assert interface.sends - sends < 70 * (time.monotonic() - began_s)
        interface.on_send = lambda: None
        assert eventually(lambda: len(interface.sent) == QUEUE_FRAMES)
    assert served.names().count("overrun") == 1
    assert [frame.data[3] for frame in interface.sent] == [i % 256 for i in range(QUEUE_FRAMES)]
    assert served.events[-1]["dropped_messages"] == 100


def test_echoes_of_one_s_own_frames_are_not_heard(interface: Interface) -> None:
    """Also with foreign frames in between; an equal one of another station is."""
    interface.echoes = True
    with joined("udp_multicast:x") as served:
        for _ in range(3):
            interface.put(frame_of(POSITION))
        assert eventually(lambda: len(interface.sent) == 3)
        assert eventually(lambda: not interface._queue)
        interface.put(REPLY)
        assert eventually(lambda: len(served.bus.transcript) == 7)
        passed = list(served.bus.transcript)
    assert [each.frame for each in passed if not each.from_host] == [REPLY] * 3
    assert [each.frame for each in passed if each.from_host] == [frame_of(POSITION)] * 3 + [REPLY]


def test_echoes_that_never_come_are_forgotten(interface: Interface) -> None:
    """No more are waited for than may be under way."""
    with joined("udp_multicast:x") as served:
        sender = served.bus.attach()
        rounds, per_round = 12, 100
        for number in range(1, rounds + 1):
            for i in range(per_round):
                served.bus.send(sender, CanFrame(i))
            assert eventually(lambda: len(interface.sent) == number * per_round)  # noqa: B023
        (port,) = served.server.ports
        assert isinstance(port, JoinPort)
        assert port._member is not None
        assert port._member._echoes is not None
        assert len(port._member._echoes) == QUEUE_FRAMES


def test_junk_on_the_bus_is_passed_over(interface: Interface) -> None:
    """Something that python-can cannot read."""
    junk = [ValueError("no frame"), can.CanOperationError("could not unpack")]

    def stumble() -> None:
        if junk:
            os.read(interface.fileno(), 1)
            raise junk.pop()

    interface.on_receive = stumble
    with joined("pcan:x"):
        os.write(interface._write_fd, b"xx")
        interface.put(frame_of(POSITION))
        assert eventually(lambda: interface.sent == [REPLY])


def test_a_descriptor_that_is_ready_for_nothing_is_no_busy_loop(interface: Interface) -> None:
    """Readable, but never a frame: looked at a hundred times a second at most."""
    interface.on_receive = lambda: None
    with joined("pcan:x"):
        os.write(interface._write_fd, b"x")
        time.sleep(0.3)
        began_s, receives = time.monotonic(), interface.receives
        time.sleep(0.3)
        assert interface.receives - receives <= 130 * (time.monotonic() - began_s)


@pytest.mark.parametrize("when", ["on_send", "on_receive"])
def test_a_bus_that_goes_away_ends_the_server(interface: Interface, when: str) -> None:
    """With one line that names it and the system's reason."""

    def fail() -> None:
        raise can.CanOperationError("failed", errno.ENETDOWN) from OSError(
            errno.ENETDOWN, "Network is down"
        )

    setattr(interface, when, fail)
    served = ServedBus(JoinPort("pcan:x", BITRATE), paced=False)
    served.rack.start()
    interface.put(frame_of(POSITION))
    assert_ends(served, "Network is down")


def test_a_thread_that_reads_tells_of_the_end(
    interface: Interface, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with a descriptor; an interface that does not wait is no busy loop either."""
    monkeypatch.setattr(interface, "fileno", lambda: -1)
    served = ServedBus(JoinPort("pcan:x", BITRATE), paced=False)
    began_s = time.monotonic()
    served.rack.start()
    time.sleep(0.2)
    assert interface.receives < 200 * (time.monotonic() - began_s)
    interface.put(frame_of(POSITION))
    assert eventually(lambda: interface.sent == [REPLY])

    def fail() -> None:
        raise OSError(errno.EIO, "Input/output error")

    interface.on_receive = fail
    assert_ends(served, "Input/output error")


# ---- real adapters and buses ---------------------------------------------------------------------


def test_an_slcan_adapter_is_joined(tmp_path: Any) -> None:
    """Another hub's pty stands for it; when it is unplugged, the one clear error comes."""
    adapter = SlcanPtyPort(str(tmp_path / "adapter"))
    with ServedBus(adapter) as bench:
        for twin in bench.bus.twins:
            twin.power_off()
        place = f"slcan:{adapter.url}?sleep_after_open=0"
        listener = bench.bus.attach()
        served = ServedBus(JoinPort(place, BITRATE), paced=False)
        served.rack.start()
        bench.bus.send(listener, frame_of(POSITION))
        assert eventually(lambda: bench.bus.has_news(listener))
        assert [arrival.frame for arrival in bench.bus.receive(listener)] == [REPLY]
    assert_ends(served, ".*")


def test_a_socketcand_is_joined() -> None:
    """Another hub's port stands for it; its end is noticed, which python-can hides."""
    daemon = SocketcandPort("127.0.0.1:0")
    with ServedBus(daemon) as bench:
        for twin in bench.bus.twins:
            twin.power_off()
        listener = bench.bus.attach()
        place = f"socketcand:vcan0?host=127.0.0.1&port={daemon.port}"
        served = ServedBus(JoinPort(place, BITRATE), paced=False)
        served.rack.start()
        bench.bus.send(listener, frame_of(POSITION))
        assert eventually(lambda: bench.bus.has_news(listener))
        assert [arrival.frame for arrival in bench.bus.receive(listener)] == [REPLY]
    assert_ends(served, "the connection has ended")


@pytest.fixture
def group() -> str:
    """A multicast address that no other test uses; skips where there is no multicast."""
    if importlib.util.find_spec("msgpack") is None:
        pytest.skip("python-can's udp_multicast needs msgpack")
    group = f"239.74.{random.randrange(256)}.{random.randrange(1, 255)}"
    try:
        with (
            can.Bus(interface="udp_multicast", channel=group, hop_limit=0) as one,
            can.Bus(interface="udp_multicast", channel=group, hop_limit=0) as other,
        ):
            one.send(POSITION)
            if other.recv(1) is None:
                pytest.skip("multicast does not come back on this machine")
    except (can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this machine: {error}")
    return group


def test_a_multicast_bus_is_joined(group: str) -> None:
    """Nothing leaves the machine, echoes are not heard, junk in the group harms nobody."""
    place = f"udp_multicast:{group}?port=43114"
    with joined(place) as served:
        line = served.server.ports[0].client_line
        assert "hop_limit=0" in line
        with client(line) as bus:
            for _ in range(20):
                bus.send(POSITION)
                assert frame_of(receive(bus, 0x581)) == REPLY
            bus._multicast.send(b"\xffjunk")  # type: ignore[attr-defined]
            with pytest.raises(can.CanOperationError):
                receive(bus, 0x7FF)
            bus.send(POSITION)
            assert frame_of(receive(bus, 0x581)) == REPLY
        frames = [(passed.frame, passed.from_host) for passed in served.bus.transcript]
        assert frames == [(frame_of(POSITION), True), (REPLY, False)] * 21


def test_canopen_converses_over_multicast(group: str) -> None:
    """From a process of its own."""
    with joined(f"udp_multicast:{group}", speed=20) as served:
        done = subprocess.run(
            [sys.executable, canopen_talk.__file__, "udp_multicast", group],
            capture_output=True,
            text=True,
            timeout=30,
            check=False,
        )
        assert (done.returncode, done.stdout) == (0, "conversed\n"), done.stderr
        assert served.bus.twins[0].address == 1, "the factory's again"


# ---- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "part"),
    [
        ("", "INTERFACE:CHANNEL is needed"),
        ("vcan0", "such as socketcan:vcan0"),
        ("socketcan:", "INTERFACE:CHANNEL is needed"),
        ("socketcn:vcan0", "did you mean socketcan?"),
        ("xyz:vcan0", "known: axistwin,"),
    ],
)
def test_a_place_that_cannot_be_read_is_a_usage_error(place: str, part: str) -> None:
    """It says what would be right."""
    with pytest.raises(UsageError, match=r"^can ") as caught:
        JoinPort(place, BITRATE)
    assert part in str(caught.value)


@pytest.mark.parametrize(
    ("place", "part"),
    [
        ("socketcan:nocan7", "there is no such interface"),
        ("socketcan:\udcff", "there is no such interface"),
        ("socketcand:vcan0", "its arguments go behind the channel: socketcand:CHANNEL?NAME=VALUE"),
        ("slcan:/dev/nothing", "No such file or directory"),
        ("axistwin:mac99-can", "unknown model 'mac99-can'"),
        ("udp_multicast:127.0.0.1", "can udp_multicast:127.0.0.1"),
    ],
)
def test_a_bus_that_cannot_be_joined_is_one_clear_line(place: str, part: str) -> None:
    """With the reason and a remedy."""
    port = JoinPort(place, BITRATE)
    with pytest.raises(PortError, match=r"cannot be joined \(.*\); ") as caught:
        port.open()
    port.close()
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)
