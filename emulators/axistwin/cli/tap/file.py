"""The file that a tap records into."""

import os
import time
from collections.abc import Callable

from axistwin.errors import UsageError
from axistwin.kernel.time import NS_PER_MS, NS_PER_S, NS_PER_US, Nanos
from axistwin.runtime.transcript import ARROWS, Direction
from axistwin.wire.can_frame import CanFrame


class TapFile:
    """The recording at ``path``: each row is in the file when ``add`` returns.

    on_failure: called with the reason, once, when it cannot be written any more.
    Raises UsageError.
    """

    def __init__(self, path: str, on_failure: Callable[[str], None]) -> None:
        self._on_failure = on_failure
        self._has_failed = False
        self._epoch_ns: Nanos = time.time_ns() - time.monotonic_ns()
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC
            self._fd = os.open(path, flags, 0o666)
        except OSError as error:
            raise UsageError(
                f"capture {path}: cannot be written ({error.strerror}); choose another file"
            ) from None

    def add(self, direction: Direction, data: bytes) -> None:
        """Write bytes of a serial line with the present time."""
        now_ns = self._now_ns()
        time_ms = f"{now_ns // NS_PER_MS}.{now_ns % NS_PER_MS:06d}"
        self._write(f"{time_ms} {ARROWS[direction]} {data.hex(' ').upper()}\n")

    def add_frame(self, channel: str, frame: CanFrame, direction: Direction | None) -> None:
        """Write a frame of a bus with the present time, as candump does; None: from anybody."""
        now_ns = self._now_ns()
        time_s = f"{now_ns // NS_PER_S}.{now_ns % NS_PER_S // NS_PER_US:06d}"
        way = {"host": " T", "device": " R", None: ""}[direction]
        self._write(f"({time_s}) {channel} {frame}{way}\n")

    def remark(self, text: str) -> None:
        """Write a remark."""
        self._write(f"# {text}\n")

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)

    def _now_ns(self) -> Nanos:
        return self._epoch_ns + time.monotonic_ns()

    def _write(self, row: str) -> None:
        if self._has_failed:
            return
        data = row.encode()
        try:
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError as error:
            self._has_failed = True
            self._on_failure(error.strerror or str(error))
