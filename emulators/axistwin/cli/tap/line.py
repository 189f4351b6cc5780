"""A tap of a serial line: a port for the program, a serial port with the device, a recording.

Rules
-----
1. What comes from either side is in the recording before it is passed on, so that a kill at any
   moment loses nothing that was passed on.
2. It is passed on at once and as it came.  What the program sets (on a pty the rate and the stop
   bits; on RFC 2217 also data bits, parity, flow control, break, DTR and RTS) is set on the port
   behind what it sent before.  On RFC 2217 it sees the port's CTS, DSR, RI and CD.
3. A recording that cannot be written any more ends, which is told once; what is recorded goes on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, Final

from axistwin.cli.tap.file import TapFile
from axistwin.cli.tap.program import Program, ProgramPort, ProgramPty
from axistwin.errors import PortError
from axistwin.runtime.serving.base_server import Report
from axistwin.runtime.serving.loop import Loop, LoopShare

READ_S: Final = 0.1
"""How long the reader of the port waits before it looks whether it is to end."""

_FRAMING: Final = ("baudrate", "bytesize", "parity", "stopbits")
_MODEM_LINES: Final = {"cts": True, "dsr": True, "cd": True, "ri": False}
"""Seen by the program, and as it sees them if the port has none."""


class LineTap:
    """Passes on between ``program_port`` and ``port``, an open port of pyserial, and records.

    Belongs to the thread of ``loop``.
    on_event: called with what happens to the program's port.
    """

    def __init__(
        self,
        port: Any,
        program_port: ProgramPty | ProgramPort,
        file: TapFile,
        loop: Loop,
        on_event: Report,
    ) -> None:
        self._loop = loop
        self.loop = LoopShare(loop, self._break_off)
        self.report = on_event
        self._program_port = program_port
        self._port = port
        self._file = file
        self._program: Program | None = None
        self._modem_lines: dict[str, bool] = {}
        self._failure = ""
        self._bug: Exception | None = None
        self._is_ending = False
        self._reader = threading.Thread(target=self._read, daemon=True)

    def run(self, on_ready: Callable[[], None]) -> None:
        """Until a signal stops the loop.  Raises PortError when the port fails."""
        self._program_port.open()
        try:
            self._note_framing()
            self._program_port.attach(self)
            self._reader.start()
            on_ready()
            self._loop.run()
        finally:
            self._is_ending = True
            self._program_port.close()
            if self._reader.is_alive():
                self._reader.join(10 * READ_S)
        if self._bug is not None:
            raise self._bug
        if self._failure:
            raise PortError(f"{self._port.port}: {self._failure}; the recording has all up to then")

    # -- for the program --

    def join(self, program: Program | None) -> None:
        """Who hears the device from now on."""
        self._program = program

    def pass_on(self, data: bytes) -> None:
        """Record what the program says, and give it to the device."""
        self._file.add("host", data)
        try:
            self._port.write(data)
        except OSError as error:  # pyserial's are
            self._fail(str(error))

    def set(self, **settings: Any) -> None:
        """Set the port, by pyserial's names.  Raises ValueError for what it does not take."""
        present = {name: getattr(self._port, name) for name in settings}
        if present == settings:
            return
        try:
            self._port.flush()
            for name, value in settings.items():
                setattr(self._port, name, value)
        except (OSError, ValueError) as error:
            wanted = " ".join(f"{name} {value}" for name, value in settings.items())
            self._file.remark(f"{wanted} cannot be set: {error}")
            raise ValueError(str(error)) from None
        if not settings.keys().isdisjoint(_FRAMING):
            self._note_framing()
        for name in settings.keys() - _FRAMING:
            self._file.remark(f"{self._port.port} {name} {'on' if settings[name] else 'off'}")

    def setting(self, name: str) -> Any:
        """What is set on the port, or how a modem line is, by pyserial's name."""
        if name not in _MODEM_LINES:
            return getattr(self._port, name)
        try:
            is_on = bool(getattr(self._port, name))
        except OSError:  # it has none, or nothing is known of it
            return _MODEM_LINES[name]
        if self._modem_lines.get(name) != is_on:
            self._modem_lines[name] = is_on
            self._file.remark(f"{self._port.port} {name} {'on' if is_on else 'off'}")
        return is_on

    def purge(self, *, is_output: bool) -> None:
        """Forget what has not been sent to the device, or what it has said that nobody has read."""
        (self._port.reset_output_buffer if is_output else self._port.reset_input_buffer)()

    # -- for the device --

    def _note_framing(self) -> None:
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
            self._program.deliver(data)

    def _fail(self, reason: str) -> None:
        self._failure = self._failure or reason
        self._loop.stop()

    def _break_off(self, error: Exception) -> None:
        self._bug = error
        self._loop.stop()
