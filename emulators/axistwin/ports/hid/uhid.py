"""The USB port of a twin as a HID device of this machine's, made by way of Linux' /dev/uhid.

To programs it is a board that is plugged in: ``/dev/hidrawN``, found by hidapi by vendor and
product.  It is gone when the port is closed, and also when the process dies.
"""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from axistwin.devices.family import UsbIdentity
from axistwin.devices.traces import ReportReady
from axistwin.errors import PortError
from axistwin.kernel.effects import Trace
from axistwin.ports.hid import uhid_events
from axistwin.ports.hid.uhid_events import EventType, KernelEvent
from axistwin.runtime.line import UsbCable
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.twin import Twin

UHID: Final = Path("/dev/uhid")
_HIDRAW: Final = Path("/sys/class/hidraw")
_NODE_TIMEOUT_S: Final = 10.0
_NODE_POLL_S: Final = 0.01


def missing() -> tuple[str, str] | None:
    """What keeps this process from making HID devices, and the remedy; None: nothing does."""
    if not UHID.exists():
        return f"there is no {UHID}", "sudo modprobe uhid"
    if not os.access(UHID, os.R_OK | os.W_OK):
        return f"no permission for {UHID}", f"run as root, or: sudo chown $USER {UHID}"
    return None


class UhidPort:
    """The USB port of device ``device_index``, called ``name``, of a line."""

    kind = "hid"

    def __init__(self, device_index: int, name: str, usb: UsbIdentity) -> None:
        self.device_index = device_index
        self.url = ""
        self._name = name
        self._usb = usb
        self._place = f"axistwin/{os.getpid()}/{device_index}"
        self._fd = -1
        self._server: Server | None = None
        self._cable: UsbCable | None = None
        self._unsubscribe: Callable[[], None] = lambda: None

    def describe(self) -> str:
        """The device node."""
        return self.url

    def open(self) -> None:
        """Plug the device in.  Raises PortError."""
        lack = missing()
        if lack is not None:
            raise PortError(f"hid: {lack[0]}; {lack[1]} (see 'axistwin doctor')")
        try:
            self._fd = os.open(UHID, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
            os.write(self._fd, uhid_events.create(self._usb, self._place, self._name))
        except OSError as error:
            raise PortError(
                f"hid: {UHID} makes no device ({error.strerror}); see 'axistwin doctor'"
            ) from None
        self.url = self._found_node()

    def _found_node(self) -> str:
        """The node of our device, once the kernel has made it.  Raises PortError."""
        deadline_s = time.monotonic() + _NODE_TIMEOUT_S
        while time.monotonic() < deadline_s:
            for facts in _HIDRAW.glob("*/device/uevent"):
                node = Path("/dev", facts.parts[-3])
                with contextlib.suppress(OSError):  # gone meanwhile
                    if f"HID_PHYS={self._place}\n" in facts.read_text() and node.exists():
                        return str(node)
            time.sleep(_NODE_POLL_S)
        raise PortError(
            f"hid: the kernel has made no /dev/hidraw* within {_NODE_TIMEOUT_S:.0f} s; "
            "it needs CONFIG_HIDRAW, and devtmpfs or udev"
        )

    def attach(self, server: Server) -> None:
        """Serve whoever opens the node."""
        self._server = server
        self._cable = server.line.usb_cable(self.device_index)
        self._unsubscribe = server.line.subscribe(self._hear)
        server.loop.add_reader(self._fd, self._take_events)

    def close(self) -> None:
        """Pull the plug: a client's next read fails, as with a real device."""
        self._unsubscribe()
        self._unsubscribe = lambda: None
        if self._server is not None:
            self._server.loop.remove_reader(self._fd)
            self._server = self._cable = None
        if self._fd >= 0:
            os.close(self._fd)  # which takes the device away
            self._fd = -1

    def _hear(self, twin: Twin, trace: Trace) -> None:
        """In whichever thread has let time pass."""
        server = self._server
        is_ours = server is not None and twin is server.line.twins[self.device_index]
        if is_ours and isinstance(trace, ReportReady):
            assert server is not None
            server.loop.call_soon(self._hand_over)

    def _hand_over(self) -> None:
        """Give the kernel what the device has for its host."""
        while self._cable is not None and (report := self._cable.receive()) is not None:
            self._tell_kernel(uhid_events.input_report(report))

    def _tell_kernel(self, event: bytes) -> None:
        """Raises PortError if the kernel has given up the device."""
        try:
            os.write(self._fd, event)
        except OSError as error:
            raise self._given_up(error) from None

    def _given_up(self, error: OSError) -> PortError:
        return PortError(
            f"hid {self.url}: the kernel has given the device up ({error.strerror}); start again"
        )

    def _take_events(self) -> None:
        """Do what the kernel asks for, event by event."""
        while True:
            try:
                data = os.read(self._fd, uhid_events.EVENT_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                raise self._given_up(error) from None
            event = uhid_events.parse(data)
            if event is not None:
                self._take(event)

    def _take(self, event: KernelEvent) -> None:
        assert self._server is not None
        assert self._cable is not None
        if event.report is not None:
            self._cable.send(event.report)
            self._hand_over()  # before the next one: the device keeps only a few
            self._server.look_again()
        reply = uhid_events.answer(event)
        if reply is not None:
            self._tell_kernel(reply)
        told = {EventType.OPEN: "connected", EventType.CLOSE: "disconnected"}.get(event.type)
        if told is not None:
            self._server.report({"event": told, "endpoint": self.kind, "url": self.url})
