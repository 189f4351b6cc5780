"""A tap of a serial line: a pty for the program, a serial port with the device, a recording.

Rules
-----
1. What comes from either side is in the recording before it is passed on, so that a kill at any
   moment loses nothing that was passed on.
2. It is passed on at once and as it came.  The rate and the stop bits that the program sets on the
   pty are set on the port before what it sends.
3. A recording that cannot be written any more ends, which is told once; what is recorded goes on.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from typing import Any, Final

from axistwin.errors import PortError, UsageError
from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.ports.pty import PseudoTerminal, PtyFarewell, PtySettings
from axistwin.ports.stream import OUTPUT_MAX, Stream
from axistwin.runtime.serving.base_server import Report
from axistwin.runtime.serving.loop import Loop, LoopShare
from axistwin.runtime.transcript import ARROWS, Direction
from axistwin.wire.framing import LineFormat

READ_S: Final = 0.1
"""How long the reader of the port waits before it looks whether it is to end."""

LOOK_S: Final = 0.02
"""How often the settings of a program that says nothing are looked at."""


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
        """Write ``data`` with the present time."""
        now_ns = self._epoch_ns + time.monotonic_ns()
        time_ms = f"{now_ns // NS_PER_MS}.{now_ns % NS_PER_MS:06d}"
        self._write(f"{time_ms} {ARROWS[direction]} {data.hex(' ').upper()}\n")

    def remark(self, text: str) -> None:
        """Write a remark."""
        self._write(f"# {text}\n")

    def close(self) -> None:
        """Close the file."""
        os.close(self._fd)

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


class LineTap:
    """Passes on between the pty at ``link`` and ``port``, an open port of pyserial, and records.

    Belongs to the thread of ``loop``.  The port's rate is the pty's first one.
    on_event: called with what happens to the pty.
    """

    def __init__(
        self,
        port: Any,
        link: str,
        file: TapFile,
        loop: Loop,
        on_event: Report,
    ) -> None:
        self._loop = loop
        self.loop = LoopShare(loop, self._break_off)
        self.report = on_event
        self.pty = _TapPty(link, LineFormat(port.baudrate))
        self._port = port
        self._file = file
        self._program: _Program | None = None
        self._failure = ""
        self._bug: Exception | None = None
        self._is_ending = False
        self._reader = threading.Thread(target=self._read, daemon=True)

    def run(self, on_ready: Callable[[], None]) -> None:
        """Until a signal stops the loop.  Raises PortError when the port fails."""
        self.pty.open()
        try:
            self._note_settings()
            self.pty.attach(self)
            self._reader.start()
            on_ready()
            self._loop.run()
        finally:
            self._is_ending = True
            self.pty.close()
            if self._reader.is_alive():
                self._reader.join(10 * READ_S)
        if self._bug is not None:
            raise self._bug
        if self._failure:
            raise PortError(f"{self._port.port}: {self._failure}; the recording has all up to then")

    def follow(self, line_format: LineFormat) -> None:
        """Set the port as the program has set the pty."""
        stop_bits = line_format.stop_half_bits / 2
        if (self._port.baudrate, self._port.stopbits) == (line_format.baud, stop_bits):
            return
        try:
            self._port.flush()
            self._port.baudrate = line_format.baud
            self._port.stopbits = stop_bits
        except (OSError, ValueError) as error:
            self._file.remark(f"{line_format.baud} baud cannot be set: {error}")
            return
        self._note_settings()

    def join(self, program: _Program | None) -> None:
        """Who hears the device from now on."""
        self._program = program

    def pass_on(self, data: bytes) -> None:
        """Record what the program says, and give it to the device."""
        self._file.add("host", data)
        try:
            self._port.write(data)
        except OSError as error:  # pyserial's are
            self._fail(str(error))

    def _note_settings(self) -> None:
        port = self._port
        self._file.remark(
            f"{port.port} {port.baudrate} {port.bytesize}{port.parity}{port.stopbits:g}"
        )

    def _read(self) -> None:
        """Wait for the device, in a thread of its own: not every URL has a descriptor."""
        port = self._port
        try:
            while not self._is_ending:
                if data := port.read(1):
                    data += port.read(port.in_waiting) if port.in_waiting else b""
                    self.loop.call_soon(self._heard, data)
        except (OSError, TypeError) as error:  # TypeError: closed while it was read
            if not self._is_ending:
                self.loop.call_soon(self._fail, str(error))

    def _heard(self, data: bytes) -> None:
        self._file.add("device", data)
        if self._program is not None:
            self._program.write(data)

    def _fail(self, reason: str) -> None:
        self._failure = self._failure or reason
        self._loop.stop()

    def _break_off(self, error: Exception) -> None:
        self._bug = error
        self._loop.stop()


class _TapPty(PseudoTerminal[LineTap]):
    """The program's side."""

    def __init__(self, link: str, line_format: LineFormat) -> None:
        super().__init__(link, line_format.baud)
        self._format = line_format

    def make_stream(self, server: LineTap, master: int, on_end: Callable[[], None]) -> Stream:
        """A stream that the tap passes on."""
        return _Program(server, master, PtySettings(master, self._format), on_end)


class _Program(Stream):
    """Whoever has the pty open."""

    def __init__(
        self, tap: LineTap, master: int, settings: PtySettings, on_end: Callable[[], None]
    ) -> None:
        super().__init__(tap.loop, master, on_end, PtyFarewell(master).is_over)
        self._tap = tap
        self._settings = settings
        self._unsent = bytearray()
        self._dropped_bytes = 0

    def join(self) -> None:
        """Hear the device."""
        self._tap.join(self)
        self._loop.call_soon(self._look_at_settings)

    def leave(self) -> None:
        """Hear it no more."""
        self._tap.join(None)
        self._unsent.clear()

    def input(self, data: bytes) -> None:
        """Pass on what the program says, at its rate."""
        self._tap.follow(self._settings.line_format())
        self._tap.pass_on(data)

    def write(self, data: bytes) -> None:
        """Give it what the device says, now or behind what waits; see ``OUTPUT_MAX``."""
        room = OUTPUT_MAX - len(self._unsent)
        self._unsent += data[:room]
        self._dropped_bytes += max(0, len(data) - room)
        self.await_room(self.write_waiting())

    def write_waiting(self) -> bool:
        """Write what waits; whether something still does."""
        del self._unsent[: self.write_some(self._unsent)]
        return bool(self._unsent)

    def take_losses(self) -> dict[str, object]:
        """How many bytes the program has lost; counts from 0 again."""
        count, self._dropped_bytes = self._dropped_bytes, 0
        return {"dropped_bytes": count}

    def _look_at_settings(self) -> None:
        """A program that only listens has a rate too."""
        if self.running:
            self._tap.follow(self._settings.line_format())
            self._loop.call_later(LOOK_S, self._look_at_settings)
