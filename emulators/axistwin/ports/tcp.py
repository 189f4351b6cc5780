"""Raw TCP: the bytes of the line and nothing else, for ``socket://HOST:PORT``.

Several clients may be connected at once; each hears the whole line.  TCP knows no bit rate, so the
line runs at the devices' own.  RFC 2217 has a port of its own (``rfc2217.py``), because its
negotiation would be garbage to a raw client.

A client that floods and then closes leaves as much in the kernels' buffers as the line carries in
half a minute, and its end would be seen only behind that.  So a client that is held back is looked
after: once it has closed, its rest goes out for ``REST_S`` seconds, and what is left is dropped.
"""

import errno
import ipaddress
import socket
import struct
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from axistwin.errors import PortError, UsageError
from axistwin.ports.stream import REST_S, Owner, SerialStream, Stream
from axistwin.runtime.serving.line_server import Server

CLIENTS_MAX = 32
"""Connections served at once; further ones are closed at once."""

# Bound what the kernels at both ends keep of a client that floods.  Segments of the loopback's own
# size would let the client's end keep megabytes.
_RECEIVE_BUFFER_BYTES = 4096
_SEGMENT_BYTES = 1400

# Bounds what the kernel keeps for a client that does not read.
_SEND_BUFFER_BYTES = 64 * 1024

_LOOK_S = 0.2

# First byte of struct tcp_info, and the state in /proc/net/tcp: the connection was reset; all that
# the client has sent is here; the client has closed, but not all that it has sent is here.
_TCP_CLOSE, _TCP_CLOSE_WAIT = 7, 8
_TCP_FIN_WAIT1 = 4
_BACKLOG = 2 * CLIENTS_MAX

_EXHAUSTED = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_RETRY_S = 1.0

ServerT = TypeVar("ServerT", bound=Owner)


def parse_address(text: str) -> tuple[str, int]:
    """``HOST:PORT`` or ``[IPV6]:PORT`` as (host, port); port 0 means any free one.

    Raises UsageError.
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    is_number = port.isascii() and port.isdecimal() and len(port) <= len("65535")
    if not colon or not host or not is_number or int(port) > 65535:
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


def listen(kind: str, host: str, port: int, *options: tuple[int, int, int]) -> socket.socket:
    """A socket that listens there; ``kind`` is what messages call it.  Raises PortError.

    options: of the socket and what it accepts: level, name, value.
    """
    listener: socket.socket | None = None
    try:
        family, type_, protocol, _, place = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listener = socket.socket(family, type_, protocol)
        for option in ((socket.SOL_SOCKET, socket.SO_REUSEADDR, 1), *options):
            listener.setsockopt(*option)
        listener.bind(place)
        listener.listen(_BACKLOG)
    except UnicodeError:  # neither the characters nor the length of a name
        raise PortError(
            f"{kind} {host}:{port}: no such host (no name of one); "
            "give an address of this machine, such as 127.0.0.1"
        ) from None
    except OSError as error:
        if listener is not None:
            listener.close()
        reason = (error.strerror or str(error)).lower()
        if isinstance(error, socket.gaierror):
            raise PortError(
                f"{kind} {host}:{port}: no such host ({reason}); "
                "give an address of this machine, such as 127.0.0.1"
            ) from None
        raise PortError(
            f"{kind} {host}:{port}: cannot listen there ({reason}); "
            "choose another port, or 0 for a free one"
        ) from None
    return listener


class Farewell:
    """Finds out that the client of a ``connection`` that is not read has closed it."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._look_s = self._closed_s = 0.0

    def is_over(self) -> bool:
        """Whether the client has closed, and had its time for what it had sent before."""
        state = self._connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, 1)[0]
        if state == _TCP_CLOSE:
            return True
        now = time.monotonic()
        if not self._closed_s and now >= self._look_s:
            self._look_s = now + _LOOK_S
            if state == _TCP_CLOSE_WAIT or _far_end_has_closed(self._connection):
                self._closed_s = now
        return bool(self._closed_s) and now - self._closed_s >= REST_S


def _far_end_has_closed(connection: socket.socket) -> bool:
    """Whether the client has closed its end, though the word of that waits behind its bytes.

    Only the kernel of the client's machine knows: False for a client on another one.
    """
    try:
        near = _as_in_proc(*connection.getsockname()[:2])
        far = _as_in_proc(*connection.getpeername()[:2])
        table = Path("/proc/net/tcp" if len(near) == len("0100007F:1388") else "/proc/net/tcp6")
        for line in table.read_text("ascii").splitlines():
            words = line.split()
            if words[1:3] == [far, near]:
                return int(words[3], 16) == _TCP_FIN_WAIT1
    except OSError:  # reset just now, or a system without /proc: nothing is known
        pass
    return False


def _as_in_proc(host: str, port: int) -> str:
    """An address as the kernel prints it: words of four bytes in the machine's order."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is not None:
        address = address.ipv4_mapped
    words = struct.unpack(f"={len(address.packed) // 4}I", address.packed)
    return "".join(f"{word:08X}" for word in words) + f":{port:04X}"


class Listener(ABC, Generic[ServerT]):
    """Listens at ``address`` (HOST:PORT).  Raises UsageError for one that cannot be read."""

    kind = "tcp"
    scheme = "socket"
    clients_max = CLIENTS_MAX

    def __init__(self, address: str) -> None:
        self.host, self.port = parse_address(address)
        self._listener: socket.socket | None = None
        self._server: ServerT | None = None
        self._connections: dict[socket.socket, Stream] = {}

    @abstractmethod
    def make_stream(
        self, server: ServerT, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """The stream of a new client."""

    @property
    def url(self) -> str:
        """What a client passes to ``serial_for_url``; the real port once it is open."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"

    def describe(self) -> str:
        """The url."""
        return self.url

    def open(self) -> None:
        """Listen.  Raises PortError."""
        listener = listen(
            self.kind,
            self.host,
            self.port,
            (socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES),
            (socket.IPPROTO_TCP, socket.TCP_MAXSEG, _SEGMENT_BYTES),
        )
        listener.setblocking(False)
        self.port = listener.getsockname()[1]
        self._listener = listener

    def attach(self, server: ServerT) -> None:
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
            self._tell("refused", peer=f"{peer[0]}:{peer[1]}", clients_max=self.clients_max)
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        stream = self.make_stream(self._server, connection, lambda: self._disconnect(connection))
        stream.place = self._place
        self._connections[connection] = stream
        self._tell("connected", peer=f"{peer[0]}:{peer[1]}")
        stream.start()

    def _listen_again(self) -> None:
        if self._listener is not None and self._server is not None:
            self._server.loop.add_reader(self._listener, self._accept)

    def _disconnect(self, connection: socket.socket) -> None:
        stream = self._connections.pop(connection)
        stream.stop()
        connection.close()
        self._tell("disconnected", **stream.take_losses())

    def _tell(self, event: str, **details: object) -> None:
        if self._server is not None:
            self._server.report({"event": event, **self._place, **details})

    @property
    def _place(self) -> dict[str, object]:
        return {"endpoint": self.kind, "url": self.url}


class TcpStream(SerialStream):
    """The client of a line at the other end of ``connection``."""

    def __init__(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> None:
        super().__init__(server, connection.fileno(), on_end, Farewell(connection).is_over)


class TcpPort(Listener[Server]):
    """The bytes of the line, for several clients."""

    def make_stream(
        self, server: Server, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """The stream of a new client."""
        return TcpStream(server, connection, on_end)
