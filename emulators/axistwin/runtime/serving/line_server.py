"""One serial line served to clients.

The loop, the alarm and saving are told in ``base_server``; here is what goes over the line.

Rules
-----
1. Every client hears every byte of the line, as on a tee; what clients send is queued in the order
   in which it was read.
2. Bytes reach a client when they have arrived on the line.  The server wakes for the end of a
   stretch of bytes, not for each byte: a client sees an answer at the instant its last byte is
   complete, and of a long stretch whatever is complete at every ``Line.GRANULARITY_NS``.
3. A client is not read while the line's host end has more than ``BACKLOG_MAX`` bytes to send.
   Others still are: each may add one read, so none can shut out another.
4. The host end of the line uses the rate and framing of the client that sent last; a client that
   has none (raw TCP) gets those of the first device.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from axistwin.kernel.time import Nanos
from axistwin.runtime.line import Line
from axistwin.runtime.serving.base_server import BaseServer, Endpoint, Report
from axistwin.runtime.serving.loop import Loop
from axistwin.wire.framing import LineFormat

BACKLOG_MAX = 1024
"""Bytes waiting to go out on the line above which a client that sends is no longer read."""

# How many bytes are taken before the line is asked how much it has to send.
_WEIGHED_BYTES = 256


class Client(Protocol):
    """A stream of bytes that takes part in the line."""

    @property
    def place(self) -> Mapping[str, object]:
        """Where it has come in: ``endpoint`` and ``url``, as in events."""

    def line_format(self) -> LineFormat | None:
        """Rate and framing it uses now; None if it has none."""

    def deliver(self, data: bytes) -> None:
        """Take bytes from the line, without waiting."""

    def pause(self) -> None:
        """Send nothing more to ``Server.input``."""

    def resume(self) -> None:
        """Send again."""


class Port(Endpoint, Protocol):
    """A place where clients find the line; ``url`` is for ``serial_for_url``."""

    def attach(self, server: "Server") -> None:
        """Serve clients, in the server's loop."""


class Server(BaseServer[Line, Port]):
    """Serves ``line`` on ``ports``; ``report`` is told of clients that come and go."""

    def __init__(
        self,
        line: Line,
        ports: Sequence[Port],
        *,
        report: Report = lambda event: None,
        loop: Loop | None = None,
    ) -> None:
        super().__init__(line, ports, report, loop)
        self.line = line
        self._clients: list[Client] = []
        self._paused: list[Client] = []
        self._talker: Client | None = None
        self._told_rates: set[tuple[Client, int]] = set()
        self._unweighed = 0

    def _attach_ports(self) -> None:
        for port in self.ports:
            port.attach(self)

    # -- clients ------------------------------------------------------------------------------

    def add_client(self, client: Client) -> None:
        """From now on ``client`` hears the line."""
        self._clients.append(client)
        if self._talker is None:
            self._talker = client

    def remove_client(self, client: Client) -> None:
        """``client`` has gone."""
        self._clients.remove(client)
        if client in self._paused:
            self._paused.remove(client)
        if self._talker is client:
            self._talker = None
        self._told_rates = {told for told in self._told_rates if told[0] is not client}

    def input(self, client: Client, data: bytes) -> None:
        """``client`` has sent ``data``."""
        self._talker = client
        self._use_format(client.line_format())
        if self.line.rate_mismatch is not None:
            self._tell_mismatch(client)
        answer = self.line.exchange(data)
        self._unweighed += len(data)
        if self._unweighed >= _WEIGHED_BYTES:
            self._unweighed = 0
            if self.line.host_backlog > BACKLOG_MAX:
                client.pause()
                self._paused.append(client)
        self._expect_motion()
        self._set_alarm()
        # Last: what follows a write competes with the client for the processor.
        if answer:
            self._hand_out(answer)

    def _tell_mismatch(self, client: Client) -> None:
        """Report, once for each rate of a client, that no device understands it."""
        mismatch = self.line.rate_mismatch
        if mismatch is None or (client, mismatch[0]) in self._told_rates:
            return
        baud, device_bauds = mismatch
        self._told_rates.add((client, baud))
        self.report(
            {"event": "wrong_rate", **client.place, "baud": baud, "module_bauds": device_bauds}
        )

    def pump(self) -> None:
        """Do what is due on the line now, and set the alarm for what comes next."""
        if self._talker is not None:
            self._use_format(self._talker.line_format())
        answer = self.line.receive()
        if self._paused and self.line.host_backlog <= BACKLOG_MAX:
            clients, self._paused = self._paused, []
            for client in clients:
                client.resume()
        self._save()
        self._set_alarm()
        if answer:
            self._hand_out(answer)

    def _use_format(self, line_format: LineFormat | None) -> None:
        """The host end uses ``line_format``, or the first device's."""
        line = self.line
        wanted = line_format or line.device_format
        present = line.host_format
        if wanted is not present and wanted != present:
            line.host_format = wanted

    def _hand_out(self, data: bytes) -> None:
        """Every client hears ``data`` from the line."""
        for client in self._clients:
            client.deliver(data)

    def _due_ns(self) -> Nanos | None:
        """What the line does next, or a paused client's turn."""
        line = self.line
        due = line.next_event_ns()
        if self._paused:
            turn = line.host_sent_ns - line.host_format.span_ns(BACKLOG_MAX)
            due = turn if due is None else min(due, turn)
        return due
