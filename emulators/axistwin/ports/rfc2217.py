"""RFC 2217: a serial port over TCP whose settings the client controls, for ``rfc2217://HOST:PORT``.

Everything a pty hides is seen here: data bits, parity, break, purges and the modem lines.  pyserial
speaks the protocol; it is given an object that looks like one of its ports.  A serial port belongs
to one client: while one is connected, further ones are closed at once.

The modem lines are those of an RS-485 adapter that is plugged in: CTS, DSR and CD on, RI off, and
RTS and DTR go nowhere.  They never change, so there is nothing to poll.
"""

import socket
import struct
from collections.abc import Callable
from dataclasses import replace

from serial import rfc2217

from axistwin.kernel.time import NS_PER_S
from axistwin.ports.stream import Stream
from axistwin.ports.tcp import TcpPort, TcpStream
from axistwin.runtime.serving.line_server import Server
from axistwin.wire.framing import PARITIES, LineFormat

_IAC = rfc2217.IAC
_XON, _XOFF = b"\x11", b"\x13"

# Of what a client sends after XOFF, and of a break: who holds the line for longer gains nothing.
_HELD_MAX = 1024
_BREAK_MAX_NS = NS_PER_S

# A negotiation is a few bytes; without a bound, one that never ends would grow for ever.
_NEGOTIATION_MAX = 64

# What pyserial's parser raises for a negotiation that is cut short or out of range.
_MALFORMED = (struct.error, KeyError, TypeError, ValueError, IndexError)


class Rfc2217Port(TcpPort):
    """Listens at ``address`` (HOST:PORT) for one RFC 2217 client at a time."""

    kind = "rfc2217"
    scheme = "rfc2217"
    clients_max = 1

    def make_stream(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """The stream of a new client, which starts with the devices' own rate and framing."""
        return _Rfc2217Stream(server, connection, on_end)


def pieces(data: bytes) -> list[bytes]:
    """``data`` of a client, cut so that what it sets comes behind what it sent before."""
    first, *rest = data.split(_IAC)
    return [piece for piece in (first, *(_IAC + each for each in rest)) if piece]


class Negotiation:
    """What is between the line's bytes and those of a client, whose settings are ``terminal``'s.

    terminal: looks like one of pyserial's ports.  connection: has ``write``.
    """

    def __init__(self, terminal: object, connection: object) -> None:
        self._manager = rfc2217.PortManager(terminal, connection)  # type: ignore[arg-type]  # the stubs ask for more than it uses

    def decoded(self, data: bytes) -> bytes:
        """The line's bytes in what the client has sent; the settings in it are performed."""
        manager = self._manager
        if _IAC in data or manager.mode != rfc2217.M_NORMAL or manager.suboption is not None:
            data = b"".join(self._filtered(data[i : i + 1]) for i in range(len(data)))
        return data

    def encoded(self, data: bytes) -> bytes:
        """The line's bytes with Telnet's escape character doubled."""
        return data.replace(_IAC, _IAC + _IAC)

    def look_at_modem_lines(self) -> None:
        """Tell the client if they have changed."""
        self._manager.check_modem_lines()

    def _filtered(self, byte: bytes) -> bytes:
        """One byte through pyserial's parser, which must not fall over garbage."""
        manager = self._manager
        try:
            data = b"".join(manager.filter(byte))
        except _MALFORMED:
            data = b""
            manager.mode, manager.suboption = rfc2217.M_NORMAL, None
        if manager.suboption is not None and len(manager.suboption) > _NEGOTIATION_MAX:
            manager.suboption = None
        return data


class _Rfc2217Stream(TcpStream):
    """Data between the escapes of Telnet, and the settings within them."""

    def __init__(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> None:
        super().__init__(server, connection, on_end)
        self.terminal = _Terminal(server, self.drop_unsent, self._admit)
        self._negotiation: Negotiation | None = None

    def start(self) -> None:
        """Take part in the line and offer the negotiation."""
        super().start()
        self._negotiation = Negotiation(self.terminal, self)

    def line_format(self) -> LineFormat:
        """What the client has set."""
        return self.terminal.line_format

    def input(self, data: bytes) -> None:
        """Send ``data`` to the line, and set what is set in it, in their order."""
        for piece in pieces(data):
            super().input(piece)

    def decoded(self, data: bytes) -> bytes:
        """The line's bytes in ``data``; the settings in it are performed."""
        assert self._negotiation is not None
        return self.terminal.admitted(self._negotiation.decoded(data))

    def encoded(self, data: bytes) -> bytes:
        """The line's bytes with Telnet's escape character doubled."""
        assert self._negotiation is not None
        return self._negotiation.encoded(self.terminal.heard(data))

    def _admit(self, data: bytes) -> None:
        """Send to the line what XOFF had held back."""
        if self.running:
            self._server.input(self, data)


class _Terminal:
    """What ``PortManager`` takes for a serial port; pyserial's names throughout."""

    cts = dsr = cd = True
    ri = False

    def __init__(
        self, server: Server, drop_input: Callable[[], None], send: Callable[[bytes], None]
    ) -> None:
        self._server = server
        self._drop_input = drop_input
        self._send = send
        self._break_since_ns: int | None = None
        self._held: bytearray | None = None
        self._xonxoff = False
        self.line_format: LineFormat = server.line.device_format
        self.rtscts = False
        self.dtr = self.rts = True

    def reset_input_buffer(self) -> None:
        """Drop what has come from the line and was not sent to the client."""
        self._drop_input()

    def reset_output_buffer(self) -> None:
        """Drop what the client has sent and is not on the line yet."""
        if self._held is not None:
            self._held.clear()
        self._server.line.purge_output()

    @property
    def baudrate(self) -> int:
        """Bits per second, above 0."""
        return self.line_format.baud

    @baudrate.setter
    def baudrate(self, value: int) -> None:
        self.line_format = replace(self.line_format, baud=value)

    @property
    def bytesize(self) -> int:
        """Data bits, 5..8."""
        return self.line_format.data_bits

    @bytesize.setter
    def bytesize(self, value: int) -> None:
        if not 5 <= value <= 8:
            raise ValueError(value)
        self.line_format = replace(self.line_format, data_bits=value)

    @property
    def parity(self) -> str:
        """One of N E O M S."""
        return self.line_format.parity

    @parity.setter
    def parity(self, value: str) -> None:
        assert value in PARITIES
        self.line_format = replace(self.line_format, parity=value)

    @property
    def stopbits(self) -> float:
        """1, 1.5 or 2."""
        return {2: 1, 3: 1.5, 4: 2}[self.line_format.stop_half_bits]

    @stopbits.setter
    def stopbits(self, value: float) -> None:
        self.line_format = replace(self.line_format, stop_half_bits=round(2 * value))

    @property
    def break_condition(self) -> bool:
        """Whether the client holds the line in break."""
        return self._break_since_ns is not None

    @break_condition.setter
    def break_condition(self, on: bool) -> None:
        if on and self._break_since_ns is None:
            self._break_since_ns = self._server.line.clock.now_ns()
        elif not on and self._break_since_ns is not None:
            # It goes out when its length is known, as one piece.
            duration_ns = self._server.line.clock.now_ns() - self._break_since_ns
            self._server.line.send_break(min(max(1, duration_ns), _BREAK_MAX_NS))
            self._break_since_ns = None

    @property
    def xonxoff(self) -> bool:
        """Whether the port obeys XON and XOFF and keeps them to itself."""
        return self._xonxoff

    @xonxoff.setter
    def xonxoff(self, on: bool) -> None:
        self._xonxoff = on
        if not on:
            self._release()

    def heard(self, data: bytes) -> bytes:
        """What the client gets of ``data`` from the line."""
        if not self._xonxoff:
            return data
        last = max(data.rfind(_XON), data.rfind(_XOFF))
        if last >= 0 and data[last : last + 1] == _XON:
            self._release()
        elif last >= 0 and self._held is None:
            self._held = bytearray()
        return data.translate(None, _XON + _XOFF)

    def admitted(self, data: bytes) -> bytes:
        """What goes to the line of ``data`` from the client; the rest is held back after XOFF."""
        if self._held is None:
            return data
        self._held += data[: _HELD_MAX - len(self._held)]
        return b""

    def _release(self) -> None:
        held, self._held = self._held, None
        if held:
            # Later: this may be called in the middle of the server handing out bytes.
            self._server.loop.call_soon(self._send, bytes(held))
