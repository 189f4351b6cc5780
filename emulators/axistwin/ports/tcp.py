"""Raw TCP: the bytes of the line and nothing else, for ``socket://HOST:PORT``.

Several clients may be connected at once; each hears the whole line.  TCP knows no bit rate, so the
line runs at the devices' own.  RFC 2217 has a port of its own (``rfc2217.py``), because its
negotiation would be garbage to a raw client.
"""

import errno
import ipaddress
import socket
from collections.abc import Callable

from axistwin.errors import PortError, UsageError
from axistwin.ports.stream import Stream
from axistwin.runtime.server import Server

CLIENTS_MAX = 32
"""Connections served at once; further ones are closed at once."""

# Bound what the kernels at both ends keep of a client that floods.  All of that still goes out when
# the client has closed, as with a serial port; so it has to be seconds' worth.  Segments of the
# loopback's own size would let the client's end keep megabytes.
_RECEIVE_BUFFER_BYTES = 4096
_SEGMENT_BYTES = 1400

# Bounds what the kernel keeps for a client that does not read.
_SEND_BUFFER_BYTES = 64 * 1024

# First byte of struct tcp_info: the connection was reset.
_TCP_CLOSE = 7
_BACKLOG = 2 * CLIENTS_MAX

_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_RETRY_S = 1.0

StreamMaker = Callable[[Server, socket.socket, Callable[[], None]], Stream]


def parse_address(text: str) -> tuple[str, int]:
    """``HOST:PORT`` or ``[IPV6]:PORT`` as (host, port); port 0 means any free one.

    Raises UsageError.
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not host or not port.isascii() or not port.isdecimal() or int(port) > 65535:
        raise UsageError(
            f"address {text!r}: HOST:PORT is needed, port 0..65535 (0: any free one), "
            "such as 127.0.0.1:5000"
        )
    return host, int(port)


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach ``host``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class TcpStream(Stream):
    """The client at the other end of ``connection``."""

    def __init__(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> None:
        super().__init__(server, connection.fileno(), on_end)
        self._connection = connection

    def resume(self) -> None:
        """Read again, unless the client has died meanwhile: the rest of its flood is dropped."""
        information = self._connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)
        if information[0] == _TCP_CLOSE:
            self._on_end()
        else:
            super().resume()


class TcpPort:
    """Listens at ``address`` (HOST:PORT).  Raises UsageError for one that cannot be read."""

    kind = "tcp"
    scheme = "socket"
    clients_max = CLIENTS_MAX

    def __init__(self, address: str) -> None:
        self.host, self._port = parse_address(address)
        self._listener: socket.socket | None = None
        self._server: Server | None = None
        self._connections: dict[socket.socket, Stream] = {}

    @property
    def url(self) -> str:
        """What a client passes to ``serial_for_url``; the real port once it is open."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self._port}"

    def describe(self) -> str:
        """The url."""
        return self.url

    def open(self) -> None:
        """Listen.  Raises PortError."""
        listener: socket.socket | None = None
        try:
            family, kind, protocol, _, place = socket.getaddrinfo(
                self.host, self._port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            listener = socket.socket(family, kind, protocol)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
            listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_MAXSEG, _SEGMENT_BYTES)
            listener.bind(place)
            listener.listen(_BACKLOG)
        except OSError as error:
            if listener is not None:
                listener.close()
            reason = (error.strerror or str(error)).lower()
            raise PortError(
                f"{self.kind} {self.host}:{self._port}: cannot listen there ({reason}); "
                "choose another port, or 0 for a free one"
            ) from None
        listener.setblocking(False)
        self._port = listener.getsockname()[1]
        self._listener = listener

    def attach(self, server: Server) -> None:
        """Accept clients."""
        assert self._listener is not None
        self._server = server
        server.loop.add_reader(self._listener, self._accept)

    def close(self) -> None:
        """Disconnect the clients and listen no more."""
        for connection in list(self._connections):
            self._disconnect(connection)
        if self._listener is not None:
            if self._server is not None:
                self._server.loop.remove_reader(self._listener)
            self._listener.close()
        self._listener = self._server = None

    def make_stream(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """The stream of a new client."""
        return TcpStream(server, connection, on_end)

    def _accept(self) -> None:
        assert self._listener is not None
        assert self._server is not None
        try:
            connection, peer = self._listener.accept()
        except OSError as error:
            if error.errno in _EXHAUSTED:  # the client still waits: do not spin meanwhile
                self._server.loop.remove_reader(self._listener)
                self._server.loop.call_later(_RETRY_S, self._listen_again)
            return
        if len(self._connections) >= self.clients_max:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        stream = self.make_stream(self._server, connection, lambda: self._disconnect(connection))
        self._connections[connection] = stream
        stream.start()
        self._tell("connected", peer=f"{peer[0]}:{peer[1]}")

    def _listen_again(self) -> None:
        if self._listener is not None and self._server is not None:
            self._server.loop.add_reader(self._listener, self._accept)

    def _disconnect(self, connection: socket.socket) -> None:
        stream = self._connections.pop(connection)
        stream.stop()
        connection.close()
        self._tell("disconnected", dropped_bytes=stream.take_dropped())

    def _tell(self, event: str, **details: object) -> None:
        if self._server is not None:
            self._server.report({"event": event, "endpoint": self.kind, "url": self.url, **details})
