"""The program's side of a tap of a serial line: a pty, or RFC 2217, which shows all settings."""

from __future__ import annotations

import contextlib
import socket
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Final, Protocol

from axistwin.ports.pty import PseudoTerminal, PtyFarewell, PtySettings
from axistwin.ports.rfc2217 import Negotiation, pieces
from axistwin.ports.stream import OUTPUT_MAX, Owner, Stream
from axistwin.ports.tcp import Farewell, Listener
from axistwin.wire.framing import LineFormat

LOOK_S: Final = 0.02
"""How often the settings of a program that says nothing are looked at, and the modem lines."""

_CONTROL: Final = ("dtr", "rts", "break_condition", "xonxoff", "rtscts")
"""What a port may not have; a program is not told so."""


class TappedPort(Owner, Protocol):
    """The port with the device, as ``LineTap`` gives and records it."""

    def join(self, program: Program | None) -> None:
        """Who hears the device from now on."""

    def pass_on(self, data: bytes) -> None:
        """Give the device what the program says."""

    def set(self, **settings: Any) -> None:
        """Set the port, by pyserial's names.  Raises ValueError for what it does not take."""

    def setting(self, name: str) -> Any:
        """What is set on the port, or how a modem line is, by pyserial's name."""

    def purge(self, *, is_output: bool) -> None:
        """Forget what has not been sent, or what has come that nobody has read."""


class Program(Stream):
    """Whoever has opened the program's side."""

    def __init__(
        self,
        tap: TappedPort,
        fd: int,
        on_end: Callable[[], None],
        is_abandoned: Callable[[], bool],
    ) -> None:
        super().__init__(tap.loop, fd, on_end, is_abandoned)
        self.tap = tap
        self._unsent = bytearray()
        self._dropped_bytes = 0

    @abstractmethod
    def follow(self) -> None:
        """See to what is set, or has changed, while nothing is said."""

    def start(self) -> None:
        """Hear the device."""
        super().start()
        self._loop.call_soon(self._follow_again)

    def join(self) -> None:
        """Hear the device."""
        self.tap.join(self)

    def leave(self) -> None:
        """Hear it no more."""
        self.tap.join(None)
        self._unsent.clear()

    def deliver(self, data: bytes) -> None:
        """Give it what the device says."""
        self.write(data)

    def write(self, data: bytes) -> None:
        """Write ``data`` as it is, now or behind what waits; see ``OUTPUT_MAX``."""
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

    def drop_unsent(self) -> None:
        """Forget what the program has not taken."""
        self._unsent.clear()

    def _follow_again(self) -> None:
        """A program that only listens has a rate too."""
        if self.running:
            self.follow()
            self._loop.call_later(LOOK_S, self._follow_again)


# ---- a pty ---------------------------------------------------------------------------------------


class ProgramPty(PseudoTerminal[TappedPort]):
    """A pty behind ``link``, whose rate begins as ``baud``."""

    def __init__(self, link: str, baud: int) -> None:
        super().__init__(link, baud)
        self._format = LineFormat(baud)

    def make_stream(self, server: TappedPort, master: int, on_end: Callable[[], None]) -> Stream:
        """A stream that the tap passes on."""
        return _PtyProgram(server, master, on_end, self._format)


class _PtyProgram(Program):
    """Its rate and stop bits are seen."""

    def __init__(
        self, tap: TappedPort, master: int, on_end: Callable[[], None], line_format: LineFormat
    ) -> None:
        super().__init__(tap, master, on_end, PtyFarewell(master).is_over)
        self._settings = PtySettings(master, line_format)

    def input(self, data: bytes) -> None:
        """Pass on what the program says, at its rate."""
        self.follow()
        self.tap.pass_on(data)

    def follow(self) -> None:
        """Set the port as the program has set the pty."""
        line_format = self._settings.line_format()
        with contextlib.suppress(ValueError):  # which the recording has
            self.tap.set(baudrate=line_format.baud, stopbits=line_format.stop_half_bits / 2)


# ---- RFC 2217 ------------------------------------------------------------------------------------


class ProgramPort(Listener[TappedPort]):
    """Listens at ``address`` (HOST:PORT) for the program."""

    kind = "rfc2217"
    scheme = "rfc2217"
    clients_max = 1

    def make_stream(
        self, server: TappedPort, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """A stream that the tap passes on."""
        return _NetProgram(server, connection, on_end)


class _NetProgram(Program):
    """Sets the port by what it says."""

    def __init__(
        self, tap: TappedPort, connection: socket.socket, on_end: Callable[[], None]
    ) -> None:
        super().__init__(tap, connection.fileno(), on_end, Farewell(connection).is_over)
        self._negotiation: Negotiation | None = None

    def start(self) -> None:
        """Hear the device, and offer the negotiation."""
        super().start()
        self._negotiation = Negotiation(_SeenPort(self), self)

    def input(self, data: bytes) -> None:
        """Pass on what the program says, and set what it sets, in its order."""
        assert self._negotiation is not None
        for piece in pieces(data):
            if said := self._negotiation.decoded(piece):
                self.tap.pass_on(said)

    def deliver(self, data: bytes) -> None:
        """Give it what the device says."""
        assert self._negotiation is not None
        self.write(self._negotiation.encoded(data))

    def follow(self) -> None:
        """Tell it of modem lines that have changed."""
        assert self._negotiation is not None
        self._negotiation.look_at_modem_lines()


class _SeenPort:
    """What the negotiation takes for the port: whatever it sets is set on the tapped one."""

    def __init__(self, program: _NetProgram) -> None:
        self.__dict__["program"] = program

    def __getattr__(self, name: str) -> Any:
        return self.__dict__["program"].tap.setting(name)

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            self.__dict__["program"].tap.set(**{name: value})
        except ValueError:
            if name not in _CONTROL:
                raise

    def reset_input_buffer(self) -> None:
        """Forget what the device has said and the program has not read."""
        program = self.__dict__["program"]
        program.tap.purge(is_output=False)
        program.drop_unsent()

    def reset_output_buffer(self) -> None:
        """Forget what has not been sent to the device."""
        self.__dict__["program"].tap.purge(is_output=True)
