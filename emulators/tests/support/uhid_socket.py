"""The port behind /dev/uhid, with a socket in the kernel's place."""

import os
import socket
import struct

from served import TIMEOUT_S

from axistwin import catalog
from axistwin.ports.hid.uhid import UhidPort
from axistwin.ports.hid.uhid_events import EVENT_BYTES


def out_event(text: bytes) -> bytes:
    """An OUT report as the kernel tells of it."""
    report = b"\0" + text.ljust(64, b"\0")
    return struct.pack("=I4096sHB", 6, report, len(report), 1)


def in_report(event: bytes) -> bytes:
    """The IN report that an event gives to the kernel, without its padding."""
    number, size = struct.unpack_from("=IH", event)
    assert (number, size, len(event)) == (12, 64, 70)
    return event[6:].rstrip(b"\0")


class SocketPort(UhidPort):
    """What it tells the kernel comes out of ``kernel``."""

    def __init__(self, device_index: int = 0) -> None:
        usb = catalog.find_model("mn400").usb
        assert usb is not None
        super().__init__(device_index, "mn400:1", usb)
        self.kernel, self._ours = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.kernel.settimeout(TIMEOUT_S)

    def open(self) -> None:
        """As if the kernel had made a node."""
        os.set_blocking(self._ours.fileno(), False)
        self._fd = self._ours.detach()
        self.url = "/dev/hidraw7"

    def tell(self, text: bytes) -> None:
        """An OUT report, as hidraw hands it on."""
        self.kernel.send(out_event(text))

    def heard(self) -> bytes:
        """The next IN report, without its padding."""
        return in_report(self.kernel.recv(EVENT_BYTES))
