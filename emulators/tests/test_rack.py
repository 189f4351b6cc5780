"""A rack: several lines in one loop, each failing for itself."""

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import serial
from served import TIMEOUT_S, eventually
from spy_storage import Disk
from toy_device import ToyDevice

from axistwin.errors import PortError, StateError, UnknownNameError, UsageError
from axistwin.ports.pty import PtyPort
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.line import Line
from axistwin.runtime.network import SerialNetwork
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.live import LineTold, Live, RackEvent
from axistwin.runtime.serving.rack import Rack, RackDevice
from axistwin.runtime.simulation import Station
from axistwin.runtime.storage import MemorySlot
from axistwin.wire.framing import LineFormat

pytestmark = pytest.mark.system


class Rig:
    """Lines of toys at ``./0``, ``./1`` ... in one rack."""

    def __init__(self, folder: Path, lines: int) -> None:
        self.rack = Rack()
        self.devices = [ToyDevice({"address": number}) for number in range(lines)]
        self.links = [str(folder / str(number)) for number in range(lines)]
        self.events: list[dict[str, Any]] = []
        for number, device in enumerate(self.devices):
            slot = MemorySlot()
            slot.cells.update(device.stored)
            station = Station("toy:0", "toy", device, slot)
            line = Line(SerialNetwork([device]), PacedClock(), Disk(), [station])
            port = PtyPort(self.links[number], LineFormat(38400))
            server = Server(line, [port], loop=self.rack.loop, report=self._report)
            self.rack.add(server)

    def _report(self, event: Any) -> None:
        self.events.append(dict(event))

    def asks(self, number: int) -> bytes:
        """What the toy on that line answers to a question."""
        with serial.Serial(self.links[number], 38400, timeout=TIMEOUT_S) as port:
            port.write(b"P")
            return bytes(port.read(4))

    def break_device(self, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
        """Let it raise from now on whenever it hears something."""

        def fail(*_: Any) -> None:
            raise AssertionError("our bug")

        monkeypatch.setattr(self.devices[number], "receive", fail)


def name_of(device: RackDevice) -> str:
    """Of a device, where it is to be done in the loop."""
    return device.name


def test_a_line_whose_device_fails_ends_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its clients see a hang-up, it is reported with the reason, and the others answer."""
    rig = Rig(tmp_path, 3)
    rig.rack.start()
    rig.break_device(1, monkeypatch)
    with pytest.raises(serial.SerialException):
        rig.asks(1)
    assert eventually(lambda: any(each["event"] == "line_failed" for each in rig.events))
    (failed,) = [each for each in rig.events if each["event"] == "line_failed"]
    assert failed == {
        "event": "line_failed",
        "line": "toy:0~2",
        "devices": ["toy:0~2"],
        "error": "our bug",
    }
    assert [rig.asks(0), rig.asks(2)] == [bytes(4)] * 2
    assert not Path(rig.links[1]).is_symlink()
    assert rig.rack.do_all(name_of).result(TIMEOUT_S) == ["toy:0", "toy:0~3"]
    with pytest.raises(StateError, match="toy:0~2 is not served any more: our bug"):
        rig.rack.do("toy:0~2", name_of).result(TIMEOUT_S)
    rig.rack.stop()


def test_when_the_last_line_has_failed_the_rack_ends_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is nothing left to serve."""
    rig = Rig(tmp_path, 2)
    rig.rack.start()
    for number in range(2):
        rig.break_device(number, monkeypatch)
        with pytest.raises(serial.SerialException):
            rig.asks(number)
    with pytest.raises(AssertionError, match="our bug"):
        rig.rack.stop()


def test_a_wish_that_fails_is_the_lines_failure_and_a_users_mistake_is_not(tmp_path: Path) -> None:
    """Whoever asked is told either; the other line goes on."""
    rig = Rig(tmp_path, 2)
    rig.rack.start()

    def mistake(device: RackDevice) -> None:
        raise UsageError(f"{device.name}: no")

    def bug(device: RackDevice) -> None:
        raise ZeroDivisionError("our bug")

    with pytest.raises(UsageError, match="toy:0: no"):
        rig.rack.do("toy:0", mistake).result(TIMEOUT_S)
    assert rig.asks(0) == bytes(4)
    with pytest.raises(StateError, match="our bug"):
        rig.rack.do("toy:0", bug).result(TIMEOUT_S)
    assert rig.rack.lines["toy:0"].failure is not None
    assert rig.asks(1) == bytes(4)
    rig.rack.stop()


def test_wishes_are_done_in_the_loops_thread(tmp_path: Path) -> None:
    """Where programs are watched; nothing else happens meanwhile."""
    rig = Rig(tmp_path, 1)
    rig.rack.start()
    thread = rig.rack.do("toy:0", lambda device: threading.current_thread()).result(TIMEOUT_S)
    assert thread is not threading.current_thread()
    assert thread.name == "axistwin"
    rig.rack.stop()


def test_a_device_is_found_by_its_name_its_address_or_its_model(tmp_path: Path) -> None:
    """Equal names are told apart; an unknown one is told with the nearest."""
    rack = Rig(tmp_path, 2).rack
    assert list(rack.devices) == list(rack.lines) == ["toy:0", "toy:0~2"]
    assert rack.find("toy:1").name == "toy:0~2"  # the address that its memory has
    with pytest.raises(UnknownNameError, match=r"no device 'toy': it is one of toy:0, toy:0~2"):
        rack.find("toy")
    with pytest.raises(UnknownNameError, match=r"no device 'toy:9': did you mean toy:0"):
        rack.find("toy:9")
    rack.close()
    folder = tmp_path / "lone"
    folder.mkdir()
    rack = Rig(folder, 1).rack
    assert rack.find("toy").name == "toy:0"
    rack.close()


def test_when_one_port_cannot_be_opened_no_line_is(tmp_path: Path) -> None:
    """The links of the others are gone again."""
    (tmp_path / "1").write_text("precious")
    rig = Rig(tmp_path, 3)
    with pytest.raises(PortError):
        rig.rack.start()
    assert [path.name for path in tmp_path.iterdir()] == ["1"]


def test_what_servers_report_is_told_with_the_line(tmp_path: Path) -> None:
    """Clients that come and go, for whoever looks on."""
    rig = Rig(tmp_path, 2)
    told: list[tuple[str, object]] = []
    rig.rack.subscribe(lambda line, event: told.append((line, event["event"])))
    rig.rack.start()
    assert rig.asks(1) == bytes(4)
    assert eventually(lambda: len(told) == 2)
    rig.rack.stop()
    assert told == [("toy:0~2", "connected"), ("toy:0~2", "disconnected")]


@pytest.mark.parametrize(("takes_ms", "after_ms"), [(0, 50), (10, 40), (30, 25), (80, 25)])
def test_what_looking_takes_is_no_part_of_the_period(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, takes_ms: int, after_ms: int
) -> None:
    """So that live values come 20 times a second; who looks long leaves time for the lines."""
    rig = Rig(tmp_path, 1)
    live = Live(rig.rack)
    now_s, delays_ms = [0.0], []

    def looks(*_: object) -> None:
        now_s[0] += takes_ms / 1000

    def call_later(delay_s: float, callback: Callable[[], object]) -> None:
        delays_ms.append(round(delay_s * 1000))
        now_s[0] += delay_s

    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    monkeypatch.setattr(live, "_look_at", looks)
    monkeypatch.setattr(rig.rack.loop, "call_later", call_later)
    with contextlib.closing(rig.rack):
        leave = live.watch(["toy:0"], lambda event: None)
        live.touch(rig.rack.devices["toy:0"])
        for _ in range(3):
            live._look()
        leave()
    assert delays_ms == [50, after_ms, after_ms, after_ms]


def test_lines_come_and_go_while_the_others_are_served(tmp_path: Path) -> None:
    """A watcher hears of it, and looks at what is gone no more; the name is free again."""
    rig = Rig(tmp_path, 2)
    live = Live(rig.rack)
    heard: list[RackEvent] = []
    rig.rack.start()
    leave = rig.rack.do(
        "toy:0", lambda device: live.watch(["toy:0", "toy:0~2"], heard.append)
    ).result(TIMEOUT_S)
    rig.rack.do("toy:0", lambda device: rig.rack.remove("toy:0~2")).result(TIMEOUT_S)
    assert not Path(rig.links[1]).is_symlink()
    assert list(rig.rack.lines) == list(rig.rack.devices) == ["toy:0"]
    assert [(each.line, each.kind) for each in heard if isinstance(each, LineTold)] == [
        ("toy:0~2", "line_removed")
    ]
    assert rig.asks(0) == bytes(4)
    with pytest.raises(UnknownNameError):
        rig.rack.do("toy:0~2", name_of).result(TIMEOUT_S)

    def add(device: RackDevice) -> None:
        simulation = rig.rack.lines["toy:0"].simulation
        port = PtyPort(rig.links[1], LineFormat(38400))
        server = Server(simulation, [port], loop=rig.rack.loop)
        rig.rack.add(server, "press").open()
        server.begin()

    rig.rack.do("toy:0", add).result(TIMEOUT_S)
    assert rig.rack.find("toy:0@press").line == "press"
    assert rig.rack.do_all(name_of).result(TIMEOUT_S) == ["toy:0", "toy:0@press"]
    rig.rack.do("toy:0", lambda device: leave()).result(TIMEOUT_S)
    rig.rack.stop()
