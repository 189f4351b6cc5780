"""What every port has in common: one client's bytes on a file descriptor.

Rules
-----
1. Reading stops while the line has more to send than it should; the client then blocks in its own
   write, as on a UART, and nothing piles up here.
2. Writing never waits.  What the kernel does not take is kept up to ``OUTPUT_MAX`` bytes; beyond
   that the newest bytes are lost, as in an overrun UART, and counted.
3. Descriptors are read and written directly; a request and its answer cost one read and one write.
"""

import os
from collections.abc import Callable, Mapping

from axistwin.runtime.server import READ_MAX, Server
from axistwin.wire.framing import LineFormat

OUTPUT_MAX = 16 * 1024
"""Bytes kept for a client that does not read, on top of what the kernel keeps."""


class Stream:
    """A client on the non-blocking descriptor ``fd``; ``on_end`` is called when it has gone.

    ``start`` after which it takes part in the line, and ``stop`` run in the server's loop.
    place: endpoint and url, for events.
    """

    def __init__(self, server: Server, fd: int, on_end: Callable[[], None]) -> None:
        self._server = server
        self._fd = fd
        self._on_end = on_end
        self.place: Mapping[str, object] = {}
        self._unsent = bytearray()
        self.running = False
        self._dropped_bytes = 0

    def line_format(self) -> LineFormat | None:
        """Rate and framing the client uses; None when its kind of port has none of its own."""
        return None

    def decoded(self, data: bytes) -> bytes:
        """The line's bytes in what the client has sent."""
        return data

    def encoded(self, data: bytes) -> bytes:
        """What to send to the client for the line's bytes."""
        return data

    def start(self) -> None:
        """Take part in the line."""
        self.running = True
        self._server.loop.add_reader(self._fd, self._readable)
        self._server.add_client(self)

    def stop(self) -> None:
        """Leave the line; what the client has not taken yet is dropped."""
        if not self.running:
            return
        self.running = False
        self._server.remove_client(self)
        self._server.loop.remove_reader(self._fd)
        self._drop_unsent()

    def pause(self) -> None:
        """Stop reading."""
        if self.running:
            self._server.loop.remove_reader(self._fd)

    def resume(self) -> None:
        """Read again."""
        if self.running:
            self._server.loop.add_reader(self._fd, self._readable)

    def deliver(self, data: bytes) -> None:
        """Hand bytes from the line to the client; never waits."""
        self._write(self.encoded(data))

    def take_dropped(self) -> int:
        """How many bytes the client has lost because it did not read; counts from 0 again."""
        count, self._dropped_bytes = self._dropped_bytes, 0
        return count

    def _drop_unsent(self) -> None:
        """Forget what the client has not taken yet."""
        if self._unsent:
            self._unsent.clear()
            self._server.loop.remove_writer(self._fd)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_MAX)
        except BlockingIOError:
            return
        except OSError:  # EIO: no client has the pty open; ECONNRESET: the connection is broken
            data = b""
        if not data:
            self._on_end()
            return
        data = self.decoded(data)
        if data:
            self._server.input(self, data)

    def _write(self, data: bytes) -> None:
        if not self._unsent:
            try:
                count = os.write(self._fd, data)
            except BlockingIOError:
                count = 0
            except OSError:
                return  # gone; reading finds that out too, and tidies up
            if count == len(data):
                return
            data = data[count:]
            self._server.loop.add_writer(self._fd, self._writable)
        room = OUTPUT_MAX - len(self._unsent)
        self._unsent += data[:room]
        self._dropped_bytes += max(0, len(data) - room)

    def _writable(self) -> None:
        try:
            del self._unsent[: os.write(self._fd, self._unsent)]
        except BlockingIOError:
            return
        except OSError:
            self._unsent.clear()
        if not self._unsent:
            self._server.loop.remove_writer(self._fd)
