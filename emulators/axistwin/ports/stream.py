"""What every port has in common: one client's bytes on a file descriptor.

Rules
-----
1. Reading stops while the line or bus has more to send than it should; the client then blocks in
   its own write, as on a UART, and nothing piles up here.  One that has gone meanwhile is noticed.
2. Writing never waits.  What the kernel does not take is kept up to a bound; beyond that the newest
   is lost, as in an overrun UART, and counted.
3. Descriptors are read and written directly; a request and its answer cost one read and one write.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Protocol

from axistwin.runtime.serving.base_server import Report
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.loop import LoopShare
from axistwin.wire.framing import LineFormat

READ_MAX = 1024
"""Bytes taken from a client at once."""

OUTPUT_MAX = 16 * 1024
"""Bytes kept for a client of a line that does not read, on top of what the kernel keeps."""


REST_S = 1.0
"""How long the rest of a client that has closed still goes out."""


class Owner(Protocol):
    """Whose loop a port is served in, and who is told of its clients."""

    @property
    def loop(self) -> LoopShare:
        """Where it is served."""

    @property
    def report(self) -> Report:
        """What is called with each event."""


class Stream(ABC):
    """A client on the non-blocking descriptor ``fd``; ``on_end`` is called when it has gone.

    ``start`` after which it takes part, and ``stop`` run in the loop's thread.
    is_abandoned: asked of a client that was held back; True: it has closed, and had its time.
    place: endpoint and url, for events.
    """

    def __init__(
        self,
        loop: LoopShare,
        fd: int,
        on_end: Callable[[], None],
        is_abandoned: Callable[[], bool] = lambda: False,
    ) -> None:
        self.place: Mapping[str, object] = {}
        self.running = False
        self._loop = loop
        self._fd = fd
        self._on_end = on_end
        self._is_abandoned = is_abandoned
        self._awaits_room = False

    # -- what goes on behind the bytes --

    @abstractmethod
    def join(self) -> None:
        """The client has come."""

    @abstractmethod
    def leave(self) -> None:
        """The client has gone; forget what it has not taken."""

    @abstractmethod
    def input(self, data: bytes) -> None:
        """The client has sent ``data``."""

    @abstractmethod
    def write_waiting(self) -> bool:
        """Write what waits for the client by ``write_some``; whether something still waits."""

    @abstractmethod
    def take_losses(self) -> dict[str, object]:
        """What the client has lost because it did not read, for an event; counts anew then."""

    # -- the descriptor --

    def start(self) -> None:
        """Take part; not if ``join`` raises."""
        self.join()
        self.running = True
        self._loop.add_reader(self._fd, self._readable)

    def stop(self) -> None:
        """Take part no more; what the client has not taken yet is dropped."""
        if not self.running:
            return
        self.running = False
        self.leave()
        self._loop.remove_reader(self._fd)
        self.await_room(False)

    def pause(self) -> None:
        """Stop reading."""
        if self.running:
            self._loop.remove_reader(self._fd)

    def look(self) -> None:
        """Held back: the client may have gone; the rest of its flood is dropped then."""
        if self.running and self._is_abandoned():
            self._on_end()

    def resume(self) -> None:
        """Read again, if the client has not gone meanwhile."""
        self.look()
        if self.running:
            self._loop.add_reader(self._fd, self._readable)

    def write_some(self, data: bytes | bytearray) -> int:
        """Write what the kernel takes just now; how many bytes that were."""
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0
        except OSError:  # gone; reading finds that out too, and tidies up
            return len(data)

    def await_room(self, wanted: bool) -> None:
        """Whether to be told (``write_waiting``) when the descriptor takes more."""
        if wanted == self._awaits_room:
            return
        self._awaits_room = wanted
        if wanted:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_MAX)
        except BlockingIOError:
            return
        except OSError:  # EIO: no client has the pty open; ECONNRESET: the connection is broken
            data = b""
        if data:
            self.input(data)
        else:
            self._on_end()

    def _writable(self) -> None:
        self.await_room(self.write_waiting())


class SerialStream(Stream):
    """A client of a serial line, which the server hands what it hears."""

    def __init__(
        self,
        server: Server,
        fd: int,
        on_end: Callable[[], None],
        is_abandoned: Callable[[], bool] = lambda: False,
    ) -> None:
        super().__init__(server.loop, fd, on_end, is_abandoned)
        self._server = server
        self._unsent = bytearray()
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

    def join(self) -> None:
        """Hear the line."""
        self._server.add_client(self)

    def leave(self) -> None:
        """Hear it no more."""
        self._server.remove_client(self)
        self.drop_unsent()

    def input(self, data: bytes) -> None:
        """Send ``data`` to the line."""
        data = self.decoded(data)
        if data:
            self._server.input(self, data)
        else:  # settings, which may have changed what the line does next
            self._server.pump()

    def deliver(self, data: bytes) -> None:
        """Hand bytes from the line to the client; never waits."""
        self.write(self.encoded(data))

    def take_losses(self) -> dict[str, object]:
        """How many bytes the client has lost; counts from 0 again."""
        count, self._dropped_bytes = self._dropped_bytes, 0
        return {"dropped_bytes": count}

    def drop_unsent(self) -> None:
        """Forget what the client has not taken yet."""
        self._unsent.clear()
        self.await_room(False)

    def write(self, data: bytes) -> None:
        """Write ``data`` as it is, now or behind what waits."""
        if not self._unsent:
            count = self.write_some(data)
            if count == len(data):
                return
            data = data[count:]
            self.await_room(True)
        room = OUTPUT_MAX - len(self._unsent)
        self._unsent += data[:room]
        self._dropped_bytes += max(0, len(data) - room)

    def write_waiting(self) -> bool:
        """Write what waits; whether something still does."""
        del self._unsent[: self.write_some(self._unsent)]
        return bool(self._unsent)
