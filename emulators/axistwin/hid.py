"""Twins on USB in this process, with the interface of hidapi's Python module ``hid``.

A program that imports ``hid`` (or ``hidraw``) of hidapi runs against a twin when it is given this
module in its place::

    from axistwin import hid

    board = hid.device()
    board.open_path(b"axistwin://mn400?time=virtual")
    board.write(b"\\0E")
    bytes(board.read(64)).rstrip(b"\\0")  # b'E0,0,0,0'

- ``open_path`` takes a URL as ``serial_for_url`` does, and plugs in its first device with USB.
- ``enumerate`` and ``open`` find the twins of this process that somebody refers to: behind a port
  or a device that is open or was, behind a ``line=NAME``, in a fixture.  Their serial line and USB
  lead to the same board.
- In virtual time, time passes in ``read`` alone: up to the report, or to the time-out.  One that
  must not wait and finds nothing takes a frame of USB, so that polling ends.
- ``timeout_ms`` is the client's own time, as on a serial port.
"""

import itertools
from collections.abc import Iterable, Iterator
from typing import Any, Final, NamedTuple

from axistwin import catalog
from axistwin.devices.family import UsbIdentity
from axistwin.errors import AxistwinError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, Nanos
from axistwin.ports.hid import uhid_events
from axistwin.runtime.line import UsbCable
from axistwin.runtime.twin import Twin
from axistwin.urlhandler import lines
from axistwin.urlhandler.lines import OpenLine
from axistwin.urlhandler.url import SCHEME, parse_url

FRAME_NS: Final[Nanos] = NS_PER_MS
"""Of USB at full speed: an IN report comes in one of them."""

PATIENCE_NS: Final[Nanos] = 24 * 3600 * NS_PER_S
"""In virtual time, a read without a time-out is given up when nothing came for so long."""

_BUS_USB: Final = 1
_VENDORS_PAGE, _VENDORS_USAGE = 0xFF00, 1
_NO_REPORT: Final = "the board has no such report: they come by themselves"


class _PluggedBoard(NamedTuple):
    """A device with USB, and its ``place`` on a line."""

    shared: OpenLine
    place: int
    usb: UsbIdentity

    @property
    def twin(self) -> Twin:
        """The handle."""
        return self.shared.line.twins[self.place]

    @property
    def path(self) -> bytes:
        """What ``open_path`` finds it by, as long as its line lives."""
        return b"axistwin-usb:%d:%d" % (self.shared.number, self.place)

    def describe(self) -> dict[str, Any]:
        """As hidapi tells it."""
        return {
            "path": self.path,
            "vendor_id": self.usb.vendor_id,
            "product_id": self.usb.product_id,
            "serial_number": self.twin.name,
            "release_number": uhid_events.RELEASE_NUMBER,
            "manufacturer_string": "",
            "product_string": self.usb.product_name,
            "usage_page": _VENDORS_PAGE,
            "usage": _VENDORS_USAGE,
            "interface_number": 0,
            "bus_type": _BUS_USB,
        }


def _boards_on(shared: OpenLine) -> Iterator[_PluggedBoard]:
    for place, twin in zip(itertools.count(), shared.line.twins, strict=False):
        usb = catalog.find_model(twin.model).usb
        if usb is not None:
            yield _PluggedBoard(shared, place, usb)


def _boards(vendor_id: int = 0, product_id: int = 0) -> list[_PluggedBoard]:
    """Those of this process; 0 stands for any."""
    living = sorted(lines.living(), key=lambda shared: shared.number)
    return [
        board
        for shared in living
        for board in _boards_on(shared)
        if vendor_id in (0, board.usb.vendor_id) and product_id in (0, board.usb.product_id)
    ]


def enumerate(vendor_id: int = 0, product_id: int = 0) -> list[dict[str, Any]]:  # noqa: A001 - hidapi's name
    """What hidapi tells of each device; 0 stands for any vendor or product."""
    return [board.describe() for board in _boards(vendor_id, product_id)]


class HidapiDevice:
    """``hid.device()``: methods, arguments and errors are hidapi's."""

    def __init__(self) -> None:
        self._board: _PluggedBoard | None = None
        self._cable: UsbCable | None = None
        self._is_nonblocking = False

    # -- beyond hidapi --

    @property
    def twin(self) -> Twin:
        """The handle of the twin that is open.  Raises ValueError."""
        return self._opened()[0].twin

    @property
    def virtual_time_ns(self) -> int:
        """The present time of the board's line in nanoseconds, in any kind of time."""
        return self._opened()[0].shared.line.sync()

    # -- life --

    def open(
        self, vendor_id: int = 0, product_id: int = 0, serial_number: str | None = None
    ) -> None:
        """Open the first one found.  Raises OSError."""
        self._refuse_second()
        for board in _boards(vendor_id, product_id):
            if serial_number in (None, board.twin.name):
                self._open(board)
                return
        serial = f" and serial number {serial_number}" if serial_number else ""
        raise OSError(
            f"open failed: no twin in this process has {vendor_id:04x}:{product_id:04x}{serial}; "
            f"open_path(b'{SCHEME}mn400?time=virtual') makes one"
        )

    def open_path(self, path: bytes | str) -> None:
        """Open what ``enumerate`` has told, or what an ``axistwin://`` URL asks for.

        Raises OSError.
        """
        self._refuse_second()
        text = path if isinstance(path, str) else path.decode("utf-8", "replace")
        if text.startswith(SCHEME):
            try:
                shared = lines.open_line(parse_url(text))
            except AxistwinError as error:
                raise OSError(f"open failed: {error}") from None
            found = next(_boards_on(shared), None)
            reason = "no device there has USB"
        else:
            found = next((board for board in _boards() if board.path == text.encode()), None)
            reason = f"give a path of enumerate(), or {SCHEME}mn400?time=virtual"
        if found is None:
            raise OSError(f"open failed: {text}: {reason}")
        self._open(found)

    def _refuse_second(self) -> None:
        if self._board is not None:
            raise RuntimeError("already open")

    def _open(self, board: _PluggedBoard) -> None:
        self._board = board
        self._cable = board.shared.line.usb_cable(board.place)
        self._is_nonblocking = False
        while self._cable.receive() is not None:
            pass  # a host keeps nothing from before its program opened the device
        board.shared.use_host_time()

    def close(self) -> None:
        """Let go of it; the twin stays powered."""
        board, self._board, self._cable = self._board, None, None
        if board is not None:
            board.shared.line.wake()
            board.shared.release_host_time()

    def _opened(self) -> tuple[_PluggedBoard, UsbCable]:
        if self._board is None or self._cable is None:
            raise ValueError("not open")
        return self._board, self._cable

    # -- reports --

    def write(self, buff: Iterable[int]) -> int:
        """Send an OUT report behind its number, 0; how many bytes, or -1 for too many or none.

        Raises ValueError, and OSError for a twin that cannot go on.
        """
        board, cable = self._opened()
        data = bytes(buff)
        report = uhid_events.unnumbered(data)
        if not data or len(report) > board.usb.report_bytes:
            return -1
        try:
            cable.send(report)
        except AxistwinError as error:
            raise OSError(str(error)) from None
        return len(data)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """The next IN report, at most ``max_length`` bytes of it; nothing after ``timeout_ms``.

        Without a time-out it waits for ever, unless ``set_nonblocking``.  Raises ValueError, and
        OSError where that would really be for ever.
        """
        board, cable = self._opened()
        try:
            report = cable.receive()
            if report is None:
                self._wait(board, cable, timeout_ms)
                report = cable.receive()
        except AxistwinError as error:
            raise OSError(str(error)) from None
        return list(report[:max_length]) if report is not None else []

    def _wait(self, board: _PluggedBoard, cable: UsbCable, timeout_ms: int) -> None:
        """Wait for a report."""
        line = board.shared.line
        now = line.sync()
        until_ns: Nanos | None = None
        if timeout_ms > 0:
            until_ns = now + board.shared.options.span_ns(timeout_ms / 1000)
        elif self._is_nonblocking:
            until_ns = now + FRAME_NS if line.is_virtual else now
        has_come = False

        def is_over() -> bool:
            return self._board is not board

        while not (has_come or is_over()) and (until_ns is None or now < until_ns):
            limit_ns = until_ns
            if until_ns is None and not line.clock.is_shared:
                limit_ns = line.next_event_ns()
                if limit_ns is None or limit_ns > now + PATIENCE_NS:
                    raise OSError(
                        "read error: nothing will ever come, and without a time-out this would "
                        "wait for ever; give read a timeout_ms"
                    )
            now = cable.wait(limit_ns, stop=is_over)
            has_come = cable.has_report

    def set_nonblocking(self, v: int) -> int:
        """Let a ``read`` without a time-out return at once; 0."""
        self._opened()
        self._is_nonblocking = bool(v)
        return 0

    def send_feature_report(self, buff: Iterable[int]) -> int:
        """-1: the board has none."""
        self._opened()
        return -1

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        """Raises OSError: the board has none."""
        self._opened()
        raise OSError(f"read error: {_NO_REPORT}")

    def get_input_report(self, report_num: int, max_length: int) -> list[int]:
        """Raises OSError: the board is not asked for one, it sends them."""
        self._opened()
        raise OSError(f"read error: {_NO_REPORT}")

    # -- what it is --

    def get_report_descriptor(self, max_length: int = 4096) -> list[int]:
        """One report each way."""
        return list(uhid_events.descriptor(self._opened()[0].usb.report_bytes)[:max_length])

    def get_manufacturer_string(self) -> str:
        """Empty: no string is known."""
        self._opened()
        return ""

    def get_product_string(self) -> str:
        """The model."""
        return self._opened()[0].usb.product_name

    def get_serial_number_string(self) -> str:
        """The twin's name, such as ``mn400:1``, to tell several apart."""
        return self._opened()[0].twin.name

    def get_indexed_string(self, index: int) -> str:
        """Raises OSError: no other strings are known."""
        self._opened()
        raise OSError(f"get indexed string error: there is no string {index}")

    def error(self) -> str:
        """What the last error was; here it is in the exceptions."""
        self._opened()
        return "Success"


device = HidapiDevice
"""By this name hidapi has it."""
