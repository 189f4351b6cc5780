"""The HTTP server: uvicorn in a thread of its own, on a socket of ours, with bounds.

Rules
-----
1. At most ``CONNECTIONS_MAX`` of HTTP: for another, the one that has been idle longest is closed.
2. A connection without a request is closed after ``IDLE_S``, half a request or none at all; one
   with a request that takes longer than ``REQUEST_S``, too.
   With TLS its handshake has ``IDLE_S`` as well.
3. What a client does not read is kept up to about ``SEND_BUFFER_BYTES``, by the kernel and here.
"""

import asyncio
import contextlib
import logging
import socket
import ssl
import threading
from typing import Any, Final

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from axistwin.control.guard import Application
from axistwin.ports.tcp import listen, parse_address

CONNECTIONS_MAX: Final = 128
IDLE_S: Final = 10.0
REQUEST_S: Final = 40.0
FAREWELL_S: Final = 2.0
SEND_BUFFER_BYTES: Final = 64 * 1024
MESSAGE_MAX_BYTES: Final = 1024
START_TIMEOUT_S: Final = 30.0
STOP_TIMEOUT_S: Final = 10.0


class _BoundedConnection(H11Protocol):
    """A connection of which rules 1 and 2 are true."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)  # type: ignore[arg-type]  # of sockets only
        self.since_s = self.loop.time()
        self._timer = self.loop.call_later(IDLE_S, self._look)
        # WebSockets have a bound of their own: who watches keeps nobody out.
        ours = [each for each in self.connections if isinstance(each, _BoundedConnection)]
        if len(ours) > CONNECTIONS_MAX:
            idle = [each for each in ours if not each.is_busy] or [self]
            min(idle, key=lambda each: each.since_s).end()

    def connection_lost(self, exc: Exception | None) -> None:
        self._timer.cancel()
        super().connection_lost(exc)

    @property
    def is_busy(self) -> bool:
        """Whether a request is being answered."""
        cycle: RequestResponseCycle | None = self.cycle
        return cycle is not None and not cycle.response_complete

    def end(self) -> None:
        """Close it now; nothing more is written."""
        self.connections.discard(self)
        self.transport.abort()

    def handle_events(self) -> None:
        was_busy = self.is_busy
        super().handle_events()
        if self.is_busy and not was_busy:
            self.since_s = self.loop.time()

    def on_response_complete(self) -> None:
        self.since_s = self.loop.time()
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._timer.cancel()
        super().handle_websocket_upgrade(event)

    def _look(self) -> None:
        left_s = self.since_s + (REQUEST_S if self.is_busy else IDLE_S) - self.loop.time()
        if left_s <= 0:
            self.end()
        else:
            self._timer = self.loop.call_later(min(left_s, IDLE_S), self._look)


class _BoundedSocket(WebSocketsSansIOProtocol):
    """A WebSocket whose end does not wait for a client that does not read."""

    async def send(self, message: Any) -> None:
        is_close = message["type"] == "websocket.close"
        if is_close:
            self.writable.set()  # it is the last, and needs no room
        await super().send(message)
        if is_close:
            self.loop.call_later(FAREWELL_S, self.transport.abort)


class _Loop(asyncio.SelectorEventLoop):
    """Bounds how long TLS may take to begin (rule 2) and to end."""

    async def create_server(self, *arguments: Any, **options: Any) -> asyncio.Server:
        if options.get("ssl") is not None:
            options.update(ssl_handshake_timeout=IDLE_S, ssl_shutdown_timeout=FAREWELL_S)
        return await super().create_server(*arguments, **options)


class _Uvicorn(uvicorn.Server):
    """Wakes for nothing but its clients."""

    async def main_loop(self) -> None:
        self.ended = asyncio.Event()
        self.loop = asyncio.get_running_loop()
        self.is_running.set()
        await self.ended.wait()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        # asyncio loses whom it is accepting while its server closes: accept nobody, then close.
        for listening in sockets or ():
            self.loop.remove_reader(listening)
        await asyncio.sleep(0.05)
        await super().shutdown(sockets)
        for connection in list(self.server_state.connections):  # who does not read its end
            connection.transport.abort()
        await asyncio.sleep(0.01)  # for the loop to close them

    is_running: threading.Event


class HttpListener:
    """Serves ``application`` at ``address`` (HOST:PORT), with ``tls`` if there is one.

    Raises UsageError for a bad address.
    """

    kind = "http"

    def __init__(self, address: str, tls: ssl.SSLContext | None = None) -> None:
        self._tls = tls
        self.host, self.port = parse_address(address)
        self._socket: socket.socket | None = None
        self._server: _Uvicorn | None = None
        self._thread: threading.Thread | None = None

    @property
    def url(self) -> str:
        """Where it is found; with the real port once it is open."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'http' if self._tls is None else 'https'}://{host}:{self.port}"

    def open(self) -> None:
        """Claim the address.  Raises PortError."""
        buffer = (socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self._socket = listen("control", self.host, self.port, buffer)
        self.port = self._socket.getsockname()[1]

    def serve(self, application: Application) -> None:
        """Answer from now on, in a thread of its own."""
        assert self._socket is not None, "it is open"
        config = uvicorn.Config(
            application,
            http=_BoundedConnection,
            ws=_BoundedSocket,
            ws_max_size=MESSAGE_MAX_BYTES,
            ws_per_message_deflate=False,
            lifespan="off",
            log_config=None,
            log_level=logging.ERROR,
            access_log=False,
            server_header=False,
            date_header=False,
            proxy_headers=False,
            loop="asyncio",
            timeout_graceful_shutdown=1,
        )
        config.load()
        config.ssl = self._tls
        server = self._server = _Uvicorn(config)
        server.is_running = threading.Event()
        sockets = [self._socket]

        def run() -> None:
            with asyncio.Runner(loop_factory=_Loop) as runner:
                runner.run(server.serve(sockets))

        self._thread = threading.Thread(target=run, name="axistwin-control", daemon=True)
        self._thread.start()
        assert server.is_running.wait(START_TIMEOUT_S), "the control server did not start"

    def close(self) -> None:
        """Answer nobody any more, and let go of the address."""
        if self._thread is not None and self._server is not None:
            server = self._server
            with contextlib.suppress(RuntimeError):  # its loop has ended
                server.loop.call_soon_threadsafe(server.ended.set)
            self._thread.join(STOP_TIMEOUT_S)
            self._thread = None
        if self._socket is not None:
            self._socket.close()
            self._socket = None
