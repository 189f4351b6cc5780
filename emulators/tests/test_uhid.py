"""The port behind /dev/uhid, with a socket in the kernel's place."""

import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from daemon_process import assert_one_clear_line, invoke
from served import TIMEOUT_S, eventually
from uhid_socket import SocketPort

from axistwin import catalog
from axistwin.errors import PortError
from axistwin.ports.hid import uhid
from axistwin.ports.hid.uhid import UhidPort
from axistwin.ports.hid.uhid_events import EVENT_BYTES
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.rack import Rack

pytestmark = pytest.mark.system

OPEN, CLOSE = struct.pack("=I", 4), struct.pack("=I", 5)


@contextmanager
def serving(port: SocketPort, *devices: str, **options: Any) -> Iterator[list[dict[str, Any]]]:
    """A line of boards behind ``port``; the events that are reported."""
    specs = [catalog.parse_device(device) for device in devices or ("mn400",)]
    events: list[dict[str, Any]] = []
    with catalog.build_line(specs, **options) as line:
        rack = Rack()
        rack.add(
            Server(line, [port], loop=rack.loop, report=lambda event: events.append(dict(event)))
        )
        rack.start()
        try:
            yield events
        finally:
            rack.stop()
            port.kernel.close()


def test_a_board_is_driven_by_reports() -> None:
    """A read, a refusal, an order that says nothing, and a reply that comes later by itself."""
    port = SocketPort()
    with serving(port):
        for asked, answer in ((b"E", b"E0,0,0,0"), (b"*", b"*\x16"), (b"X3", b"X\x0e")):
            port.tell(asked)
            assert port.heard() == answer
        port.tell(b"L1,2,3,4")
        port.tell(b"E1")
        assert port.heard() == b"E1,2,3,4,0"


def test_no_report_of_a_burst_is_lost() -> None:
    """A board keeps 8 for a host that does not take them; this one does."""
    port = SocketPort()
    with serving(port):
        for number in range(30):
            port.tell(b"L%d" % number)
            port.tell(b"E")
        assert [port.heard() for _ in range(30)] == [b"E%d,0,0,0" % n for n in range(30)]


def test_several_boards_have_a_port_each() -> None:
    """Reports of one do not come out of the other."""
    port = SocketPort(device_index=1)
    with serving(port, "mn400:1", "mn400:2"):
        port.tell(b"L7")
        port.tell(b"E")
        assert port.heard() == b"E7,0,0,0"


def test_who_opens_and_closes_the_node_is_told_and_the_kernel_answered() -> None:
    """It would wait five seconds for an answer that does not come."""
    port = SocketPort()
    with serving(port) as events:
        port.kernel.send(OPEN.ljust(EVENT_BYTES, b"\0"))
        port.kernel.send(struct.pack("=IIBB", 9, 77, 0, 2))
        assert port.kernel.recv(EVENT_BYTES) == struct.pack("=IIHH", 10, 77, 5, 0)
        port.kernel.send(CLOSE)
        assert eventually(lambda: len(events) == 2)
    place = {"endpoint": "hid", "url": "/dev/hidraw7"}
    assert events == [{"event": "connected", **place}, {"event": "disconnected", **place}]


def test_a_kernel_that_gives_the_device_up_ends_the_run_with_one_line() -> None:
    """The reports have nowhere to go."""
    port = SocketPort()
    specs = [catalog.parse_device("mn400")]
    with catalog.build_line(specs) as line:
        rack = Rack()
        rack.add(Server(line, [port], loop=rack.loop))
        rack.start()
        port.tell(b"E")
        port.kernel.close()
        thread = rack._thread
        assert thread is not None
        thread.join(TIMEOUT_S)
        with pytest.raises(
            PortError, match=r"hid /dev/hidraw7: the kernel has given the device up"
        ):
            rack.stop()


def test_what_is_missing_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No node, no permission, or a node that makes no device."""
    usb = catalog.find_model("mn400").usb
    assert usb is not None
    port = UhidPort(0, "mn400:1", usb)
    monkeypatch.setattr(uhid, "UHID", tmp_path / "uhid")
    with pytest.raises(PortError, match=r"there is no .*/uhid; sudo modprobe uhid .*doctor"):
        port.open()
    (tmp_path / "uhid").touch()
    with monkeypatch.context() as patched:
        patched.setattr(os, "access", lambda path, mode: False)
        with pytest.raises(PortError, match=r"no permission for .*: sudo chown"):
            port.open()
    monkeypatch.setattr(uhid, "_NODE_TIMEOUT_S", 0.05)
    with pytest.raises(PortError, match=r"no /dev/hidraw\* within .*CONFIG_HIDRAW"):
        port.open()
    port.close()


def test_models_without_usb_are_refused() -> None:
    """And told which have it."""
    assert_one_clear_line(invoke("run", "mac23", "--hid"), "mac23:0 has no USB", "mn400")
    assert_one_clear_line(invoke("run", "mac23-can", "--hid"), "--hid is for a serial line")
