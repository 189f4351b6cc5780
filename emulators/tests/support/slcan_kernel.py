"""Run inside scripts/vm: a kernel's own slcan driver at the other end of the slcan dialect.

Prints what went wrong, or ``conversed``.
"""

import subprocess
import time
from pathlib import Path

import can
from can_clients import TIMEOUT_S, frame_of, message, on_pty

from axistwin.ports.slcan import Channel, SlcanPort
from axistwin.wire.can_frame import CanFrame

BITRATE = 125_000
CONVERSATION = [
    CanFrame(0x601, bytes.fromhex("4000200000000000")),
    CanFrame(0x123),
    CanFrame(0x12ABCDEF, b"\x01\x02", is_extended=True),
    CanFrame(0x701, is_remote=True),
    CanFrame(0x701, b"", False, True, 8),
    CanFrame(0x1FFFFFFF, b"", True, True, 3),
]


def attached(path: str) -> subprocess.Popen[bytes]:
    """``slcand`` on the pty, and its interface up."""
    daemon = subprocess.Popen(["slcand", "-F", "-o", "-c", "-f", "-s4", path, "slcan9"])
    deadline = time.monotonic() + TIMEOUT_S
    while not Path("/sys/class/net/slcan9").exists():
        assert time.monotonic() < deadline, "slcand made no interface"
        assert daemon.poll() is None, "slcand failed"
        time.sleep(0.01)
    subprocess.run(["ip", "link", "set", "slcan9", "up"], check=True)
    return daemon


def converse() -> None:
    """Every kind of frame both ways, then slcand's farewell."""
    port = SlcanPort(BITRATE)
    with on_pty(port) as (served, path):
        daemon = attached(path)
        try:
            with can.Bus(interface="socketcan", channel="slcan9") as bus:
                for frame in CONVERSATION:
                    bus.send(message(frame))
                assert [served.next_frame() for _ in CONVERSATION] == CONVERSATION
                for frame in CONVERSATION:
                    served.deliver(frame)
                assert [frame_of(bus.recv(TIMEOUT_S)) for _ in CONVERSATION] == CONVERSATION
        finally:
            daemon.terminate()
            daemon.wait(TIMEOUT_S)
        deadline = time.monotonic() + TIMEOUT_S
        while port.channel is not Channel.CLOSED:
            assert time.monotonic() < deadline, "slcand's close command did not arrive"
            time.sleep(0.01)
        assert port.settings.bitrates == (BITRATE,)
        assert port.take_trouble() is None


if __name__ == "__main__":
    converse()
    print("conversed")
