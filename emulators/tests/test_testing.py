"""Twins for tests, without pytest: what a started line offers and that it leaves no trace."""

import os
import re
import threading
import time
from pathlib import Path
from typing import Any

import can
import pytest
import serial
from mac_frames import ACCEPTED, REFUSED, ask, request

from axistwin import testing
from axistwin.errors import AxistwinError, PortError, UsageError
from axistwin.motion.plant import Load
from axistwin.runtime.serving.line_server import Server

TIMES = ["virtual", "real", 20]


def opened(twin: testing.StartedLine, **settings: Any) -> Any:
    """A client of ``twin``."""
    return serial.serial_for_url(twin.port, **{"baudrate": 38400, "timeout": 0.5, **settings})


def open_files() -> set[str]:
    """What the file descriptors of this process point to."""
    names = set()
    for entry in Path("/proc/self/fd").iterdir():
        try:
            names.add(f"{entry.name} {entry.readlink()}")
        except FileNotFoundError:  # the one that lists the folder
            continue
    return names


@pytest.mark.system
@pytest.mark.parametrize("time", TIMES)
def test_a_client_can_connect_when_start_returns(time: str | float) -> None:
    """In every kind of time, and a ``with`` block stops the twin."""
    with testing.start("mac23", time=time) as twin, opened(twin) as port:
        assert ask(port, 0x20) == 0
    with pytest.raises(serial.SerialException):
        opened(twin)


@pytest.mark.system
@pytest.mark.parametrize("time", TIMES)
def test_nothing_is_left_behind(time: str | float) -> None:
    """No thread, no descriptor, no file, however often twins come and go."""
    with testing.start("mac23", time=time):
        pass
    files, threads = open_files(), threading.active_count()
    for _ in range(5):
        with testing.start("mac23", time=time) as twin, opened(twin) as port:
            assert ask(port, 0x20) == 0
        assert not Path(twin.port).parent.exists()
    assert threading.active_count() == threads
    assert open_files() == files
    assert twin not in testing._running.values()


def test_a_start_that_fails_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory and the folder are let go of when the server cannot serve."""
    files, threads = open_files(), threading.active_count()

    def refuse(server: Server) -> None:
        raise PortError("no pseudo terminal to be had")

    monkeypatch.setattr(Server, "open", refuse)
    with pytest.raises(PortError):
        testing.start("mac23")
    assert threading.active_count() == threads
    assert open_files() == files


@pytest.mark.system
def test_a_twin_on_a_pty_stops_while_a_client_waits() -> None:
    """The client sees a hang-up; nothing hangs."""
    with testing.start("mac23") as twin:
        port = opened(twin, timeout=60)
    start = time.monotonic()
    with pytest.raises(serial.SerialException):
        port.read(1)
    assert time.monotonic() - start < 30
    port.close()


@pytest.mark.system
def test_stopping_twice_is_stopping_once() -> None:
    """So a test may stop a twin which the fixture stops too."""
    twin = testing.start("mac23")
    twin.stop()
    twin.stop()


@pytest.mark.system
@pytest.mark.parametrize("time", ["virtual", "real"])
def test_a_single_twin_forwards_everything(time: str) -> None:
    """Inputs, supply, temperature, load, power and what can be read."""
    with testing.start("mac23:3", time=time) as twin:
        twin.inputs.reference = True
        twin.supply_volts = 30.5
        twin.temperature_celsius = 41.0
        twin.load = Load()
        assert twin.inputs.reference is True
        assert (twin.supply_volts, twin.temperature_celsius) == (30.5, 41.0)
        assert twin.load == twin.twin.load
        assert (twin.name, twin.address, twin.position) == ("mac23:3", 3, 0)
        assert not twin.is_moving
        assert twin.state == twin.twin.state
        assert twin.describe()["address"] == 3
        twin.power_off()
        was_powered = twin.is_powered
        twin.power_on()
        assert (was_powered, twin.is_powered) == (False, True)
        assert "mac23:3 on" in repr(twin)


def test_a_single_twin_lacks_nothing_of_a_twin() -> None:
    """Whatever a twin of a line has, a twin alone has too."""
    with testing.start("mac23", time="virtual") as twin:
        public = [name for name in dir(twin.twin) if not name.startswith("_")]
        assert [name for name in public if not hasattr(twin, name)] == []
        assert (twin.model, twin.cells) == (twin.twin.model, twin.twin.cells)


def test_what_a_single_twin_does_not_have_cannot_be_set() -> None:
    """A misspelt name is told, and would be one of the twin's."""
    with testing.start("mac23", time="virtual") as twin:
        with pytest.raises(UsageError, match="did you mean supply_volts"):
            twin.suply_volts = 30.0
        with pytest.raises(AttributeError):
            twin.position = 5  # type: ignore[misc]
        assert {"position", "inputs", "advance"} <= set(dir(twin))


def test_power_cycle_needs_a_start_up() -> None:
    """Position is kept, and the module hears nothing for 2 s (MACS-PERS-01, MACS-AMB-21)."""
    with testing.start("mac23", time="virtual") as twin, opened(twin) as port:
        port.write(request(0x13, 40))
        assert port.read(3) == ACCEPTED
        twin.advance(1)
        twin.power_cycle()
        port.write(request(0x20))
        assert port.read(1) == b""
        twin.advance(2)
        assert ask(port, 0x20) == twin.position == 40


def test_several_twins_share_one_line() -> None:
    """They are found by number and by name."""
    with (
        testing.start("mac23:0", "mac34-1:5", time="virtual") as line,
        opened(line) as port,
    ):
        assert len(line) == 2
        assert [twin.name for twin in line] == ["mac23:0", "mac34-1:5"]
        assert line[1] is line["mac34-1:5"] is line.twins[1]
        port.write(request(0x13, 40, address=5))
        assert port.read(3) == ACCEPTED
        line.advance(1)
        assert [twin.position for twin in line] == [0, 40]
        with pytest.raises(UsageError, match=r"no twin mac34-1:6 .*did you mean mac34-1:5"):
            _ = line["mac34-1:6"]


@pytest.mark.system
def test_time_can_be_moved_only_when_it_is_virtual() -> None:
    """``advance`` says what to do instead."""
    with testing.start("mac23", time="virtual") as twin:
        twin.advance(1.5)
        assert twin.virtual_time_ns == 1_500_000_000
        with pytest.raises(UsageError, match=r"-1 s is out of range: 0\.\.1e\+12 s"):
            twin.advance(-1)
    with (
        testing.start("mac23") as twin,
        pytest.raises(UsageError, match='start the twin with time="virtual"'),
    ):
        twin.advance(1)


@pytest.mark.system
def test_scaled_time_runs_faster() -> None:
    """At 100 times, 0.05 s of sleep are 5 s of the twin's."""
    with testing.start("mac23", time=100) as twin:
        start = twin.virtual_time_ns
        time.sleep(0.05)
        assert twin.virtual_time_ns - start > 4_900_000_000


@pytest.mark.system
def test_options_reach_the_twin(tmp_path: Path) -> None:
    """Address, quirks, rate, memory and start-up."""
    with testing.start("mac23", address=7, quirks={"xon_byte": "11h"}, time="virtual") as twin:
        port = opened(twin)
        port.write(request(0x0B, address=7))
        assert port.read(3) == b"\x06\x13\x11"
    with testing.start("mac23", baud=9600, pacing=False, seed=7, state=tmp_path) as twin:
        port = opened(twin, baudrate=9600)
        port.write(request(0x0D, 1234))
        assert port.read(3) == ACCEPTED
        port.close()
    with testing.start("mac23", time="virtual", cold=True, state=tmp_path) as twin:
        twin.advance(2.1)
        with opened(twin, baudrate=9600) as port:
            assert ask(port, 0x25) & 0xFFFF == 1234


@pytest.mark.parametrize(
    ("devices", "options", "message"),
    [
        ([], {}, "which devices"),
        (["mac24"], {}, "did you mean mac23"),
        (["mac23"], {"tim": "virtual"}, "unknown option tim: did you mean time"),
        (["mac23"], {"speed": 3}, "unknown option speed: write time=3"),
        (["mac23"], {"time": "later"}, "use virtual, real, or a speed"),
        (["mac23:1"], {"address": 2}, "for one device without an address"),
        (["mac23"], {"quirks": {"xon_bite": 1}}, "unknown quirk 'xon_bite'"),
        (["mac23"], {"profile": "/nowhere"}, "profile /nowhere"),
        (["mac23"], {"state": "/dev/null"}, "state /dev/null"),
        (["mac23"], {"bitrate": 9600}, "bitrate: not for mac23; write baud=9600"),
        (["mac23", "mac23-can"], {}, "mac23-can:1 lives on a CAN bus, not on a serial line"),
        (["mac23-can", "mac23"], {}, "mac23:0 lives on a serial line, not on a CAN bus"),
        (["mac23-can"], {"baud": 125_000}, "baud: not for mac23-can; write bitrate=125000"),
        (["mac23-can"], {"bitrate": 2_000_000}, "bitrate 2000000 is out of range"),
        (["mac23-can:0"], {}, "address 0 is out of range"),
        (["mac23-can"], {"quirks": {"xon_byte": 1}}, "unknown quirk 'xon_byte'"),
        (["mac23-can"], {"profile": "/nowhere"}, "profile /nowhere"),
        (["mac23-can"], {"state": "/dev/null"}, "state /dev/null"),
    ],
)
@pytest.mark.parametrize("kind", ["virtual", "real"])
def test_mistakes_are_one_clear_line(
    kind: str, devices: list[str], options: dict[str, Any], message: str
) -> None:
    """On a pty and behind a URL alike, and nothing stays running."""
    threads = threading.active_count()
    with pytest.raises(AxistwinError, match=message) as caught:
        testing.start(*devices, **{"time": kind, **options})
    assert "\n" not in str(caught.value)
    assert threading.active_count() == threads


def test_the_transcript_tells_what_was_said() -> None:
    """Decoded, with both directions; a refused command stays in sight behind a thousand polls."""
    with testing.start("mac23", time="virtual") as twin, opened(twin) as port:
        for expected in (ACCEPTED, REFUSED):
            port.write(request(0x13, 100_000))
            assert port.read(3) == expected
        for _ in range(1000):
            ask(port, 0x20)
        text = twin.transcript
    assert "06 13 17  refused" in text
    # The motion ends amid the polls, which is shown.
    left_out = map(int, re.findall(r"(\d+) more like this one", text))
    assert sum(left_out) == 1000 - 2 * text.count("more like this one") - 1
    assert text.count("at rest, powered") == 1
    assert len(text.splitlines()) < 24
    assert twin.transcript == text, "it can be read after the end"


def test_the_transcript_is_bounded() -> None:
    """Whatever was said, beginning and end are shown and the middle is counted."""
    with testing.start("mac23", time="virtual", pacing=False) as twin, opened(twin) as port:
        for number in range(500):
            port.write(request(0x0C, number % 2))
            port.read(3)
    rows = twin.transcript.splitlines()
    assert len(rows) == 151
    assert "850 lines left out" in twin.transcript
    assert os.linesep not in rows[0]


def test_a_transcript_tells_of_a_rate_that_nobody_understands() -> None:
    """A perfect frame at the wrong rate is not shown as one."""
    with testing.start("mac23", time="virtual") as twin:
        with serial.serial_for_url(twin.port, baudrate=9600, timeout=0.1) as port:
            port.write(b"\x0201400200000000000A2\x03")
            port.read(21)
        assert "not understood: sent at 9600, the module listens at 38400" in twin.transcript
        assert "position" not in twin.transcript


# ---- on a bus ----


def upload(bus: can.BusABC, index: int, address: int = 1) -> int:
    """The value that an object is read with."""
    data = bytes((0x40, index, 0x20, 0, 0, 0, 0, 0))
    bus.send(can.Message(arbitration_id=0x600 + address, data=data, is_extended_id=False))
    while (reply := bus.recv(0.5)) is not None:
        if reply.arbitration_id == 0x580 + address:
            assert reply.data[0] == 0x42
            return int.from_bytes(reply.data[4:], "big", signed=True)
    raise AssertionError("no reply")


def go_to(bus: can.BusABC, position: int, address: int = 1) -> None:
    """Send a motion command and wait for its reply."""
    data = bytes((0x23, 0x13, 0x20, 0)) + position.to_bytes(4, "big", signed=True)
    bus.send(can.Message(arbitration_id=0x600 + address, data=data, is_extended_id=False))
    assert bus.recv(0.5) is not None


@pytest.mark.parametrize("time", TIMES)
def test_a_twin_on_can_has_a_bus(time: str | float) -> None:
    """python-can's, usable when start returns; the twin is worked as any other."""
    with testing.start("mac23-can", time=time) as twin:
        assert isinstance(twin.bus, can.BusABC)
        assert upload(twin.bus, 0x00) == twin.position == 0
        twin.supply_volts = 11
        emergency = twin.bus.recv(0.5)
        assert emergency is not None
        assert emergency.arbitration_id == 0x081
    with pytest.raises(can.CanOperationError, match="is shut down"):
        twin.bus.send(can.Message(arbitration_id=0x80))


def test_several_twins_share_one_bus_and_several_ports() -> None:
    """By number and by name; ``port`` is the channel of more ports, until it is stopped."""
    with testing.start("mac23-can:1", "mac23-can:2", time="virtual") as twins:
        assert [twin.name for twin in twins] == ["mac23-can:1", "mac23-can:2"]
        assert twins[1] is twins["mac23-can:2"]
        with can.Bus(interface="axistwin", channel=twins.port, ignore_config=True) as other:
            go_to(other, -40, address=2)
            heard = [twins.bus.recv(0.1), twins.bus.recv(0.1)]
        assert [each.arbitration_id for each in heard if each is not None] == [0x602, 0x582]
        twins.advance(1)
        assert [twin.position for twin in twins] == [0, -40]
        assert upload(twins.bus, 0x00, address=2) == -40
        assert twins.virtual_time_ns > 1_000_000_000
    with pytest.raises(can.CanInitializationError, match="there is no bus started-"):
        can.Bus(interface="axistwin", channel=twins.port, ignore_config=True)


def test_advance_sends_what_is_periodic() -> None:
    """At its times, as python-can's own advance does."""
    with testing.start("mac23-can:3", time="virtual") as twin:
        sync = can.Message(arbitration_id=0x080, is_extended_id=False)
        twin.bus.send_periodic(sync, 0.1)
        twin.advance(0.95)
        assert twin.transcript.count("080#") == 2, "the first, and the last of those alike"
        assert "8 more like this one" in twin.transcript


def test_a_bus_that_a_test_shut_down_goes_on() -> None:
    """The twins live until they are stopped, whoever leaves the bus."""
    with testing.start("mac23-can", time="virtual") as twin:
        go_to(twin.bus, 7)
        twin.bus.shutdown()
        twin.advance(1)
        assert twin.position == 7
        with can.Bus(interface="axistwin", channel=twin.port, ignore_config=True) as again:
            assert upload(again, 0x00) == 7


def test_a_serial_line_has_no_bus() -> None:
    """It says what to use instead."""
    with (
        testing.start("mac23", time="virtual") as twin,
        pytest.raises(UsageError, match="mac23:0 lives on a serial line; open its port"),
    ):
        _ = twin.bus


def test_options_reach_a_twin_on_can(tmp_path: Path) -> None:
    """Address, quirks, bit rate, memory, start-up."""
    options: testing.Options = {
        "quirks": {"upload_scs": "43h"},
        "bitrate": 500_000,
        "state": tmp_path,
        "address": 9,
        "time": "virtual",
        "pacing": False,
    }
    with testing.start("mac23-can", **options) as twin:
        assert twin.bus._bus.bitrate == 500_000
        go_to(twin.bus, 5, address=9)
        twin.bus.send(
            can.Message(arbitration_id=0x609, data=b"\x40\0\x20\0\0\0\0\0", is_extended_id=False)
        )
        reply = twin.bus.recv(1)
        assert reply is not None
        assert reply.data[0] == 0x43
        twin.advance(1)
    with testing.start("mac23-can:9", cold=True, time="virtual", state=tmp_path) as twin:
        boot_up = twin.bus.recv(3)
        assert boot_up is not None
        assert (boot_up.arbitration_id, boot_up.timestamp >= 2) == (0x709, True)
        assert twin.position == 5


def test_the_transcript_of_a_bus_tells_what_was_said() -> None:
    """Decoded, whoever spoke, long polls shortened; readable after the end."""
    with testing.start("mac23-can:1", "mac23-can:2", time="virtual") as twins:
        go_to(twins.bus, 100_000, address=2)
        for _ in range(1000):
            upload(twins.bus, 0x07)
    text = twins.transcript
    assert "> 602#23132000000186A0  2013h go to position 100000 -> module 2" in text
    assert "< 582#6013200000000000  2013h accepted (module 2)" in text
    assert "998 more like this one" in text
    assert len(text.splitlines()) < 12
