"""Targets: the way from the suite to a device on USB HID, report by report.

A `HidTransport` wraps whatever writes and reads reports as hidapi's devices do.  For a real device
that is a node of Linux' hidraw, used as the file that it is: one `write` is one OUT report, one
`read` one IN report, and three ioctls tell who it is.  No library is needed for that; hidapi's own
Python module would do the same on the same node, but is one more compiled thing to install, and of
its two back ends only one sees a device that is not on a bus of USB.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import struct
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from axistwin_conformance.base.errors import TargetError
from axistwin_conformance.base.transcript import Transcript
from axistwin_conformance.transport.transport import (
    SILENCE_NOTED_S,
    STOP_HEARD_NS,
    Transport,
)

SLICE_MS: Final = 20  # a real device is listened to in slices: an interrupt need not wait longer
LEAST_MS: Final = 1  # to hidapi no time-out at all means for ever
DRAINED_REPORTS: Final = 1000
UNNUMBERED: Final = b"\0"  # what hidapi and hidraw have before a report that has no number
# Linux' hidraw.h: ioctls, and what they fill in.
HIDIOCGRDESCSIZE, HIDIOCGRDESC, HIDIOCGRAWINFO = 0x80044801, 0x90044802, 0x80084803
DESCRIPTOR_BYTES: Final = 4096
# Items of a report descriptor (HID 1.11, 6.2.2): type and tag, without the size of the item.
REPORT_SIZE, REPORT_COUNT, INPUT, OUTPUT, REPORT_ID = 0x74, 0x94, 0x80, 0x90, 0x84
LONG_ITEM: Final = 0xFE


@dataclass(frozen=True, slots=True)
class HidIdentity:
    """How a device enumerates: ids, and the bytes of its IN and OUT report.

    `has_numbers`: its reports are numbered.
    """

    vendor: int
    product: int
    in_bytes: int
    out_bytes: int
    has_numbers: bool = False

    def __str__(self) -> str:
        sizes = f"reports of {self.in_bytes} bytes in, {self.out_bytes} out"
        return f"{self.vendor:04X}h:{self.product:04X}h, {sizes}"


class ReportPort(Protocol):
    """What a transport needs of a device on HID: hidapi's methods, and who it is."""

    def identity(self) -> HidIdentity:
        """How it enumerates."""

    def write(self, data: bytes, /) -> int:
        """Send an OUT report behind its number; less than 0 if it was not taken."""

    def read(self, max_length: int, timeout_ms: int, /) -> Sequence[int]:
        """The next IN report; empty when the time-out (> 0) passes first."""

    def close(self) -> None:
        """Give the device back."""


class HidTransport(Transport):
    """A device on USB HID.  What is said are reports without the nulls at their end."""

    source_word = "the HID device"
    word = "USB"

    def __init__(
        self, port: ReportPort, description: str, *, is_lossless: bool | None = None
    ) -> None:
        super().__init__(
            port, description, is_lossless=is_lossless, transcript=Transcript(is_in_pieces=False)
        )
        self._port = port
        self._pending: deque[bytes] = deque()
        with self._told("asking who it is"):
            self.identity = port.identity()

    @property
    def rate(self) -> None:
        """USB has a rate of its own."""
        return

    def send(self, content: bytes) -> int:
        """Send an OUT report with this content and nulls behind it; return when that began (ns)."""
        started_ns = self._announced(content)
        report = UNNUMBERED + content.ljust(self.identity.out_bytes, b"\0")
        with self._told("sending"):
            taken = self._port.write(report)
        if taken < 0:
            raise TargetError(f"{self.source_word} takes no report of {len(report) - 1} bytes")
        return started_ns

    def receive(self, timeout_s: float) -> bytes | None:
        """The next IN report, without the nulls at its end; None if none comes in time (s)."""
        started_ns = self.now_ns
        self._listen(started_ns + round(timeout_s * 1e9), is_first_enough=True)
        if self._pending:
            return self._pending.popleft()
        if timeout_s >= SILENCE_NOTED_S:
            self._note_silence(started_ns)
        return None

    def wait(self, seconds: float) -> float:
        """Let time pass, keep what arrives for `receive`; return the seconds that really passed."""
        started_ns = self.now_ns
        self._listen(started_ns + round(seconds * 1e9), is_first_enough=False)
        return (self.now_ns - started_ns) / 1e9

    def drain(self) -> tuple[bytes, ...]:
        """Set aside the reports that nobody asked for, and return them."""
        for _ in range(DRAINED_REPORTS):
            if not self._read(LEAST_MS):
                break
        dropped = tuple(self._pending)
        self._pending.clear()
        if dropped:
            self.mark(f"{len(dropped)} reports nobody asked for were set aside")
        return dropped

    def close(self) -> None:
        """Close the device; one that is gone already is fine."""
        with contextlib.suppress(Exception):
            self._port.close()

    def _listen(self, deadline_ns: int, *, is_first_enough: bool) -> None:
        """Keep what comes until then, or until there is something to be handed on."""
        while (left_ns := deadline_ns - self.now_ns) > 0 or is_first_enough:
            if is_first_enough and self._pending:
                return
            left_ms = -(-self._within_travel(max(left_ns, 0)) // 1_000_000)
            if not self.is_virtual:
                left_ms = min(left_ms, SLICE_MS)
            begun_ns = 0 if self.is_virtual else self.now_ns
            came = self._read(max(left_ms, LEAST_MS))
            if not self.is_virtual:
                late_ns = self.now_ns - begun_ns - max(left_ms, LEAST_MS) * 1_000_000
                self.lateness.note("listening", late_ns, is_device_free=True)
            if not came and left_ns <= 0:
                return

    def _read(self, timeout_ms: int) -> bool:
        """Take one report if it comes in time."""
        self._clock_ns = None
        with self._told("receiving"):
            report = bytes(self._port.read(self.identity.in_bytes, timeout_ms))
        if report:
            content, _ = self._arrived(report.rstrip(b"\0"))
            self._pending.append(content)
        return bool(report)

    # --- what the base asks for -------------------------------------------------------------------

    def _stop_by(self, data: bytes) -> None:
        self.send(data)
        self._read(STOP_HEARD_NS // 1_000_000)

    def _has_heard(self, seconds: float) -> bool:
        return self.receive(seconds) is not None

    def _source_trouble(self, doing: str, error: Exception) -> TargetError | None:
        if isinstance(error, OSError):
            why = error.strerror or " ".join(str(error).split())
            return TargetError(f"the HID device failed while {doing}: {why}")
        return None


class HidrawPort:
    """A node of Linux' hidraw, as `ReportPort`.  Raises OSError."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def identity(self) -> HidIdentity:
        """Ids and sizes from the kernel."""
        _, vendor, product = struct.unpack("=IHH", fcntl.ioctl(self._fd, HIDIOCGRAWINFO, bytes(8)))
        size = fcntl.ioctl(self._fd, HIDIOCGRDESCSIZE, bytes(4))
        asked = bytearray(size + bytes(DESCRIPTOR_BYTES))
        fcntl.ioctl(self._fd, HIDIOCGRDESC, asked)
        return identity_of(vendor, product, bytes(asked[4 : 4 + struct.unpack("=I", size)[0]]))

    def write(self, data: bytes, /) -> int:
        """Send an OUT report behind its number."""
        return os.write(self._fd, data)

    def read(self, max_length: int, timeout_ms: int, /) -> bytes:
        """The next IN report; empty when the time-out passes first."""
        if not self._poll.poll(timeout_ms):
            return b""
        return os.read(self._fd, max_length)

    def close(self) -> None:
        """Close the node."""
        os.close(self._fd)


def identity_of(vendor: int, product: int, descriptor: bytes) -> HidIdentity:
    """Read a report descriptor: how many bits all fields of each report have."""
    bits = {INPUT: 0, OUTPUT: 0}
    size = count = 0
    has_numbers = False
    for item, value in _items(descriptor):
        if item == REPORT_SIZE:
            size = value
        elif item == REPORT_COUNT:
            count = value
        elif item == REPORT_ID:
            has_numbers = True
        elif item in bits:
            bits[item] += size * count
    in_bytes, out_bytes = (-(-bits[item] // 8) for item in (INPUT, OUTPUT))
    return HidIdentity(vendor, product, in_bytes, out_bytes, has_numbers)


def _items(descriptor: bytes) -> Iterator[tuple[int, int]]:
    """The items of a descriptor: type and tag, and the number that each has."""
    at = 0
    while at < len(descriptor):
        prefix = descriptor[at]
        if prefix == LONG_ITEM:  # reserved by the standard, and skipped
            at += 3 + descriptor[at + 1 : at + 2].ljust(1, b"\0")[0]
            continue
        length = (0, 1, 2, 4)[prefix & 3]
        yield prefix & ~3, int.from_bytes(descriptor[at + 1 : at + 1 + length], "little")
        at += 1 + length


def open_hid(path: str) -> HidTransport:
    """Open a node of hidraw; raises TargetError with the reason in one line."""
    try:
        port = HidrawPort(path)
    except OSError as error:
        raise TargetError(f"cannot open {path}: {error.strerror}") from error
    try:
        return HidTransport(port, path)
    except TargetError as error:
        port.close()
        raise TargetError(f"cannot open {path}: it is no HID device ({error})") from error
