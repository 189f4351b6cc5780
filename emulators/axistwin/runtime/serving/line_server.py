"""One serial line served to clients.

The loop, the alarm and saving are told in ``base_server``; here is what goes over the line.

Rules
-----
1. Every client hears every byte of the line, as on a tee; what clients send is queued in the order
   in which it was read.
2. Bytes reach a client when they have arrived on the line.  The server wakes for the end of a
   stretch of bytes, not for each byte: a client sees an answer at the instant its last byte is
   complete, and of a long stretch whatever is complete at every ``Line.GRANULARITY_NS``.
3. A client has the line for ``TURN_NS`` at a time.  What takes longer waits here, and the client is
   not read, while the line's host end has more than that to send.  Others still are: each may add
   one turn, and what is held back leaves it ``ANSWER_NS`` for the answer, so none can shut out
   another, however slow it is.  What waits when its client goes is dropped.
4. The host end of the line uses the rate and framing of the client whose bytes it took last; a
   client that has none (raw TCP) gets those of the first device.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, Protocol

from axistwin.kernel.time import NS_PER_MS, Nanos
from axistwin.runtime.line import Line
from axistwin.runtime.serving.base_server import LOOK_NS, BaseServer, Endpoint, Report
from axistwin.runtime.serving.loop import Loop
from axistwin.runtime.simulation import earliest
from axistwin.wire.framing import LineFormat

TURN_NS: Final[Nanos] = 500 * NS_PER_MS
"""How long the bytes of one client may take on the line before others get their turn."""

ANSWER_NS: Final[Nanos] = 100 * NS_PER_MS
"""How long whoever was held back leaves the line to others after their bytes."""

PAUSE_NS: Final[Nanos] = 50 * NS_PER_MS
"""A longer silence ends a burst of the transcript.  A reply may reach it in pieces, late when the
machine is busy; the other direction ends it anyway.
"""

BAUD_MIN: Final = 50
"""The slowest rate for which systems have a name; clients that are slower get it on the line."""


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

    def look(self) -> None:
        """Held back for some time: see whether there is still somebody."""

    def resume(self) -> None:
        """Send again."""


class LinePort(Endpoint, Protocol):
    """A place where clients find the line; ``url`` is for ``serial_for_url``."""

    def attach(self, server: "Server") -> None:
        """Serve clients, in the server's loop."""


class Server(BaseServer[Line, LinePort]):
    """Serves ``line`` on ``ports``; ``report`` is told of clients that come and go."""

    def __init__(
        self,
        line: Line,
        ports: Sequence[LinePort],
        *,
        loop: Loop,
        report: Report = lambda event: None,
    ) -> None:
        super().__init__(line, ports, loop, report)
        self.line = line
        line.transcript.pause_ns = PAUSE_NS
        self._clients: list[Client] = []
        self._held_back: dict[Client, bytes] = {}
        """Who is not read, and what the line has not taken yet of what they have sent."""
        self._answered_ns: Nanos = 0
        self._talker: Client | None = None
        self._wanted_format: LineFormat | None = None
        self._told_rates: set[tuple[Client, int]] = set()

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
        self._held_back.pop(client, None)
        if self._talker is client:
            self._talker = None
        self._told_rates = {told for told in self._told_rates if told[0] is not client}

    def input(self, client: Client, data: bytes) -> None:
        """``client`` has sent ``data``."""
        if client in self._held_back:
            self._held_back[client] += data
            return
        answer, rest = self._take_turn(client, data)
        busy_ns = self.line.host_busy_ns
        if rest or busy_ns > TURN_NS:
            self._held_back[client] = rest
            client.pause()
        if self._held_back:
            self._answered_ns = self.line.clock.now_ns() + busy_ns + ANSWER_NS
        self._expect_motion()
        self._set_alarm()
        # Last: what follows a write competes with the client for the processor.
        if answer:
            self._hand_out(answer)

    def _take_turn(self, client: Client, data: bytes) -> tuple[bytes, bytes]:
        """Send as much of ``data`` as one turn takes: the answer so far, and what is left."""
        self._talker = client
        line_format = self._use_format(client.line_format())
        line, rest = self.line, b""
        if line.rate_mismatch is not None:
            self._tell_mismatch(client)
        if line_format.span_ns(len(data)) > TURN_NS:
            share = max(1, line.host_format.characters_within(TURN_NS))
            data, rest = data[:share], data[share:]
        return line.exchange(data), rest

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
        if self._held_back:
            answer += self._give_turns()
        self._save()
        self._set_alarm()
        if answer:
            self._hand_out(answer)

    def _give_turns(self) -> bytes:
        """Let the line take what was held back, as far as it can; the answer so far."""
        answer = b""
        for client, data in tuple(self._held_back.items()):
            if self._wait_ns(client):
                client.look()
                continue
            del self._held_back[client]
            if data:
                more, rest = self._take_turn(client, data)
                answer += more
                self._held_back[client] = rest  # last, since it has had its turn
            else:
                client.resume()
        return answer

    def _wait_ns(self, client: Client) -> Nanos:
        """How long ``client``, which is held back, has to wait for its next turn."""
        wait_ns = self.line.host_busy_ns - TURN_NS
        if client is not self._talker:
            wait_ns = max(wait_ns, self._answered_ns - self.line.clock.now_ns())
        return max(0, wait_ns)

    def _use_format(self, line_format: LineFormat | None) -> LineFormat:
        """The host end uses ``line_format``, or the first device's; returns which."""
        wanted = line_format or self.line.device_format
        if wanted is not self._wanted_format:  # nobody else sets it while this serves
            self._wanted_format = wanted
            is_too_slow = wanted.baud < BAUD_MIN
            self.line.host_format = replace(wanted, baud=BAUD_MIN) if is_too_slow else wanted
        return wanted

    def _hand_out(self, data: bytes) -> None:
        """Every client hears ``data`` from the line."""
        for client in self._clients:
            client.deliver(data)

    def _due_ns(self) -> Nanos | None:
        """What the line does next, or the turn of a client that is held back, or a look at it."""
        due = self.line.next_event_ns()
        if self._held_back:
            wait_ns = min(map(self._wait_ns, self._held_back))
            due = earliest(due, self.line.clock.now_ns() + min(wait_ns, LOOK_NS))
        return due

    @property
    def _has_news(self) -> bool:
        """Whether the line has bytes for the clients."""
        return self.line.has_news
