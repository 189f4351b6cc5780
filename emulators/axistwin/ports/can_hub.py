"""Where clients find a CAN bus of twins: slcan on a pty or on TCP, socketcand on TCP.

The process is the bus.  Each client is a controller of its own on it; what real adapters and the
real daemon say is told in ``slcan`` and ``socketcand``, queues and their bounds in ``can_client``.

- The adapter behind the pty is a new one for each client that opens it: its channel is closed, its
  rate that of the bus.
- A client that does not read loses frames, which is told once, and counted when it goes.
"""

import socket
from abc import abstractmethod
from collections.abc import Callable
from typing import Final

from axistwin.kernel.time import Nanos
from axistwin.ports.can_client import CanClient
from axistwin.ports.dialect import CanDialect
from axistwin.ports.pty import PseudoTerminal, PtyFarewell
from axistwin.ports.slcan import SlcanPort
from axistwin.ports.socketcand import SocketcandSession
from axistwin.ports.stream import Stream
from axistwin.ports.tcp import Farewell, Listener
from axistwin.runtime.serving.bus_server import BusServer

BUS_NAMES: Final = ("vcan0", "can0")
"""What clients of the socketcand port may call the bus."""

MISTAKES_TOLD_MAX: Final = 10
"""Mistakes of one client that are told; one that sends junk makes any number of them."""

_TTY_BAUD: Final = 115200  # what it says in the terminal's settings; it means nothing


class CanStream(Stream):
    """A client of the bus on a descriptor, speaking ``dialect``."""

    def __init__(
        self,
        server: BusServer,
        fd: int,
        on_end: Callable[[], None],
        is_abandoned: Callable[[], bool],
        dialect: CanDialect,
    ) -> None:
        super().__init__(server.loop, fd, on_end, is_abandoned)
        self._server = server
        self._client = CanClient(server.bus, dialect, epoch_ns=server.epoch_ns)
        self._dropped = 0
        self._mistakes = 0

    # -- for the descriptor --

    def join(self) -> None:
        """Be on the bus, and greet."""
        self._client.start()
        self._server.add_member(self)
        self._flush()

    def leave(self) -> None:
        """Leave the bus, as soon as it has carried what the client sent."""
        self._server.remove_member(self)
        self._client.finish()
        self._server.drain(self._client)

    def input(self, data: bytes) -> None:
        """Perform what the client says."""
        self._client.input(data)
        self._tell_trouble()
        self._server.heard(self)  # which hands out what there is to say, at once

    def write_waiting(self) -> bool:
        """Write what waits; whether something still does."""
        self._client.write_to(self.write_some)
        return self._client.has_output

    def take_losses(self) -> dict[str, object]:
        """How many messages the client has lost; counts from 0 again."""
        count, self._dropped = self._dropped, 0
        return {"dropped_messages": count}

    # -- for the server --

    @property
    def has_news(self) -> bool:
        """Whether the bus has something for the client."""
        return self._client.has_news

    @property
    def is_behind(self) -> bool:
        """Whether the client must not be read."""
        return self._client.is_behind

    def next_event_ns(self) -> Nanos | None:
        """When its dialect has something to do."""
        return self._client.next_event_ns()

    def pump(self) -> None:
        """Hand the client what the bus has for it."""
        self._client.pump()
        self._flush()

    def _flush(self) -> None:
        """Write, count what is lost, and hang up when that is the dialect's wish."""
        if not self._awaits_room and self._client.has_output:
            self.await_room(self.write_waiting())
        self._count_losses()
        if self._client.dialect.is_closing and not self._client.has_output:
            self._on_end()

    def _count_losses(self) -> None:
        lost = self._client.take_dropped()
        if lost and not self._dropped:
            self._server.report({"event": "overrun", **self.place})
        self._dropped += lost

    def _tell_trouble(self) -> None:
        trouble = self._client.dialect.take_trouble()
        if trouble is None:
            return
        self._mistakes += 1
        if self._mistakes <= MISTAKES_TOLD_MAX:
            self._server.report({"event": "client_mistake", **self.place, "message": trouble})


def _bitrate(server: BusServer) -> int | None:
    """What adapters have to be set to; None: anything, because frames take no time."""
    return server.bus.bitrate if server.bus.is_paced else None


def _slcan_line(channel: str) -> str:
    return f'can.Bus(interface="slcan", channel="{channel}")'


class SlcanPtyPort(PseudoTerminal[BusServer]):
    """An adapter that speaks slcan, behind the symbolic link ``link``."""

    kind = "slcan"
    option = "--slcan"

    def __init__(self, link: str) -> None:
        super().__init__(link, _TTY_BAUD)

    @property
    def client_line(self) -> str:
        """For python-can."""
        return _slcan_line(self.url)

    def make_stream(self, server: BusServer, master: int, on_end: Callable[[], None]) -> Stream:
        """A new adapter."""
        return CanStream(
            server, master, on_end, PtyFarewell(master).is_over, SlcanPort(_bitrate(server))
        )


class _CanListener(Listener[BusServer]):
    """A conversation of its own for each client, on TCP."""

    @abstractmethod
    def make_dialect(self, server: BusServer) -> CanDialect:
        """What a new client is spoken to in."""

    def make_stream(
        self, server: BusServer, connection: socket.socket, on_end: Callable[[], None]
    ) -> Stream:
        """The stream of a new client."""
        is_over = Farewell(connection).is_over
        return CanStream(server, connection.fileno(), on_end, is_over, self.make_dialect(server))


class SlcanTcpPort(_CanListener):
    """An adapter that speaks slcan for each client, on TCP."""

    kind = "slcan-tcp"
    scheme = "socket"

    @property
    def client_line(self) -> str:
        """For python-can."""
        return _slcan_line(self.url)

    def make_dialect(self, server: BusServer) -> CanDialect:
        """A new adapter."""
        return SlcanPort(_bitrate(server))


class SocketcandPort(_CanListener):
    """The daemon socketcand."""

    kind = "socketcand"
    scheme = "can"  # as in the daemon's own beacon

    @property
    def client_line(self) -> str:
        """For python-can."""
        return (
            f'can.Bus(interface="socketcand", channel="{BUS_NAMES[0]}", '
            f'host="{self.host}", port={self.port})'
        )

    def make_dialect(self, server: BusServer) -> CanDialect:
        """A new session."""
        return SocketcandSession(BUS_NAMES)
