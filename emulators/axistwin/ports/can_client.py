"""One client of a CAN bus: its dialect, its controller on the bus, and what it has not read yet.

    descriptor <-- write_to -- [messages] <-- dialect <-- pump --- Bus
               --- input ----------------->  dialect  --- send --> Bus

Rules
-----
1. The client is a controller on the bus from ``start`` to ``stop``; it acknowledges while its
   dialect says so.
2. Writing never waits.  What the descriptor does not take is kept, ``OUTPUT_MAX`` bytes at most;
   beyond that whole messages are lost to this client alone, and counted.  A message that has begun
   is finished.
3. While ``is_behind`` the client must not be read: it waits in its own write, and nothing that it
   sends is lost.
4. What the client has sent before it goes still goes out, for ``FAREWELL_NS`` at most (``finish``).
5. The dialect's times are those of the bus plus ``epoch_ns``, so that a client that knows the time
   of day is shown it.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Iterable
from operator import itemgetter
from typing import Final

from axistwin.errors import StateError
from axistwin.kernel.time import NS_PER_S, Nanos
from axistwin.ports.dialect import BusError, CanDialect, Out
from axistwin.runtime.bus import Bus
from axistwin.runtime.can_network import Arrival, ErrorReport
from axistwin.wire.can_bus import ControllerState, Fault
from axistwin.wire.can_frame import CanFrame

OUTPUT_MAX: Final = 64 * 1024
"""Bytes kept for a client that does not read, on top of what the kernel keeps."""

BACKLOG_FRAMES: Final = 64
"""Frames waiting for the bus above which a client is not read."""

FAREWELL_NS: Final[Nanos] = NS_PER_S
"""How long the frames of a client that has gone still go out."""


class CanClient:
    """A client that speaks ``dialect`` on ``bus``.

    epoch_ns: what to add to the time of the bus.
    """

    def __init__(self, bus: Bus, dialect: CanDialect, *, epoch_ns: Nanos = 0) -> None:
        self.dialect = dialect
        self._bus = bus
        self._epoch_ns = epoch_ns
        self._port: int | None = None
        self._on_the_way = 0
        self._controller: ControllerState = "active"
        self._acknowledges = True
        self._messages: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._begun = b""  # the rest of a message, part of which has been written
        self._dropped = 0
        self._leaves_ns: Nanos | None = None

    # -- life --

    def start(self) -> None:
        """Join the bus, and greet."""
        assert self._port is None
        self._acknowledges = self.dialect.acknowledges
        self._port = self._bus.attach(hears_errors=True, acknowledges=self._acknowledges)
        self._put(self.dialect.greeting())

    def stop(self) -> None:
        """Leave the bus; what the client has not read, and what it has not sent, is forgotten."""
        if self._port is not None:
            with contextlib.suppress(StateError):  # a bus that has failed is told of elsewhere
                self._bus.detach(self._port)
            self._port = None
        self._messages.clear()
        self._begun, self._waiting_bytes = b"", 0

    def finish(self) -> None:
        """The client has gone: only its frames still go out (``has_left``)."""
        self._messages.clear()
        self._begun, self._waiting_bytes = b"", 0
        self._leaves_ns = self._bus.clock.now_ns() + FAREWELL_NS

    def has_left(self) -> bool:
        """After ``finish``: whether that is over; it is stopped then."""
        assert self._port is not None
        assert self._leaves_ns is not None
        now_ns = self._bus.sync()
        if self._bus.backlog(self._port) and now_ns < self._leaves_ns:
            return False
        self.stop()
        return True

    # -- the bus's side --

    def input(self, data: bytes) -> None:
        """The client has sent ``data``."""
        now_ns = self._bus.sync()
        self._count_sent()
        self._perform(self.dialect.receive(data, now_ns + self._epoch_ns))

    def pump(self) -> None:
        """Take what the bus has for the client, and do what its dialect has to do by itself.

        Of the time up to the last ``Bus.sync``.
        """
        assert self._port is not None
        self._count_sent()
        arrivals, reports = self._bus.receive_all(self._port)
        news: Iterable[Arrival | ErrorReport] = arrivals
        if reports:
            news = sorted([*arrivals, *reports], key=itemgetter(0))  # all begin with their time
        for each in news:
            self._tell(each)
        due_ns = self.dialect.next_event()
        if due_ns is not None:
            now_ns = self._bus.sync() + self._epoch_ns
            if due_ns <= now_ns:
                self._perform(self.dialect.wake(now_ns))

    def next_event_ns(self) -> Nanos | None:
        """When the dialect has something to do by itself, in the time of the bus."""
        if self._leaves_ns is not None:
            return self._leaves_ns
        due_ns = self.dialect.next_event()
        return None if due_ns is None else due_ns - self._epoch_ns

    @property
    def has_news(self) -> bool:
        """Whether ``pump`` would take something from the bus."""
        assert self._port is not None
        return self._bus.has_news(self._port)

    @property
    def is_behind(self) -> bool:
        """Whether so much waits for the bus that the client must wait (rule 3)."""
        if self._on_the_way > BACKLOG_FRAMES:
            self._bus.sync()  # on one without time they have left already
            self._count_sent()
        return self._on_the_way > BACKLOG_FRAMES

    def _tell(self, news: Arrival | ErrorReport) -> None:
        """Put it in the words of the dialect."""
        time_ns = news[0] + self._epoch_ns
        if isinstance(news, Arrival):
            self._put(self.dialect.deliver(news.frame, time_ns))
        elif (error := self._error_of(news)) is not None:
            self._put(self.dialect.deliver_error(error, time_ns))

    def _perform(self, outs: list[Out]) -> None:
        assert self._port is not None
        for out in outs:
            if isinstance(out, CanFrame):
                self._bus.send(self._port, out)
                self._on_the_way += 1
            else:
                self._put(out)
        self._follow_dialect()

    def _follow_dialect(self) -> None:
        """Rule 1."""
        assert self._port is not None
        if self.dialect.acknowledges != self._acknowledges:
            self._acknowledges = not self._acknowledges
            self._bus.set_acknowledging(self._port, acknowledges=self._acknowledges)

    def _count_sent(self) -> None:
        """Find out what has left; afterwards ``_on_the_way`` is what has not."""
        assert self._port is not None
        if not self._on_the_way:
            return
        backlog = self._bus.backlog(self._port)
        while self._on_the_way > backlog:
            self._on_the_way -= 1
            self.dialect.sent()

    def _error_of(self, report: ErrorReport) -> BusError | None:
        """None: passive no more, for which the dialects have no words."""
        if isinstance(report, Fault):
            kind = BusError.NO_ACKNOWLEDGE if report.kind == "ack" else BusError.PROTOCOL
            return kind | BusError.BUS_ERROR
        before, self._controller = self._controller, report.state
        if report.state == "active":
            return BusError.RESTARTED if before == "off" else None
        return BusError.BUS_OFF if report.state == "off" else BusError.CONTROLLER

    # -- the client's side --

    @property
    def has_output(self) -> bool:
        """Whether ``write_to`` has something to write."""
        return bool(self._begun or self._messages)

    def write_to(self, write: Callable[[bytes], int]) -> None:
        """Hand over what waits; ``write`` takes as much as it can and returns how much that was."""
        if not self.has_output:
            return
        data = self._begun + b"".join(self._messages)
        count = write(data)
        assert 0 <= count <= len(data)
        count -= len(self._begun)
        if count < 0:
            self._begun = self._begun[count:]
            return
        while count > 0:
            message = self._messages.popleft()
            self._waiting_bytes -= len(message)
            count -= len(message)
        self._begun = message[count:] if count else b""

    def take_dropped(self) -> int:
        """How many messages the client has lost because it did not read; counts from 0 again."""
        dropped, self._dropped = self._dropped, 0
        return dropped

    def _put(self, message: bytes) -> None:
        if not message:
            return
        if self._waiting_bytes + len(message) > OUTPUT_MAX:
            self._dropped += 1
            self.dialect.overrun()
            return
        self._messages.append(message)
        self._waiting_bytes += len(message)
