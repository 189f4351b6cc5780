"""One CAN bus served to clients.

The loop, the alarm and saving are told in ``base_server``; here is what goes over the bus.

Rules
-----
1. Each client is a controller of its own on the bus, and all hear the same frames in one order.  A
   client sees a frame when it is complete.
2. A client is not read while it ``is_behind``: its frames wait for the bus, and so do its own
   writes then.  The others are not held up.  A client that closes meanwhile is noticed.
3. What a client has sent before it closed still goes out, for a while.
"""

import contextlib
import time
from collections.abc import Sequence
from typing import Protocol

from axistwin.kernel.time import Nanos
from axistwin.runtime.bus import Bus
from axistwin.runtime.serving.base_server import LOOK_NS, BaseServer, Endpoint, Report
from axistwin.runtime.serving.loop import Loop
from axistwin.runtime.simulation import earliest


class Member(Protocol):
    """Who takes part in the bus."""

    @property
    def has_news(self) -> bool:
        """Whether the bus has something that ``pump`` would take."""

    @property
    def is_behind(self) -> bool:
        """Whether so much waits for the bus that it must not send more."""

    def next_event_ns(self) -> Nanos | None:
        """When ``pump`` has something to do that the bus knows nothing of."""

    def pump(self) -> None:
        """Take what the bus has, hand it on, and do what is due; without waiting."""

    def pause(self) -> None:
        """Send nothing more."""

    def look(self) -> None:
        """Held back for some time: see whether there is still somebody."""

    def resume(self) -> None:
        """Send again."""


class DrainingClient(Protocol):
    """Who has gone, and has sent something before."""

    def has_left(self) -> bool:
        """Whether the last of that is on its way; it is off the bus then."""

    def next_event_ns(self) -> Nanos | None:
        """When it leaves in any case."""

    def stop(self) -> None:
        """Leave the bus now."""


class BusPort(Endpoint, Protocol):
    """A place where clients find the bus, or where it meets another one."""

    @property
    def client_line(self) -> str:
        """What a Python program writes to open it; empty if there is nothing to open."""

    def attach(self, server: "BusServer") -> None:
        """Serve clients, in the server's loop."""


class BusServer(BaseServer[Bus, BusPort]):
    """Serves ``bus`` on ``ports``; ``report`` is told of clients that come and go.

    epoch_ns: what to add to the time of the bus to have the time of day.
    """

    def __init__(
        self,
        bus: Bus,
        ports: Sequence[BusPort],
        *,
        loop: Loop,
        report: Report = lambda event: None,
    ) -> None:
        super().__init__(bus, ports, loop, report)
        self.bus = bus
        self.epoch_ns: Nanos = time.time_ns() - bus.sync()
        self._members: list[Member] = []
        self._paused: list[Member] = []
        self._draining: list[DrainingClient] = []

    def _attach_ports(self) -> None:
        for port in self.ports:
            port.attach(self)

    def close(self) -> None:
        """Serve no more, release the ports, and forget what is still to be sent."""
        draining, self._draining = self._draining, []
        with contextlib.ExitStack() as rest:
            for client in draining:
                rest.callback(client.stop)
            super().close()

    # -- clients ------------------------------------------------------------------------------

    def add_member(self, member: Member) -> None:
        """From now on ``member`` is pumped."""
        self._members.append(member)

    def remove_member(self, member: Member) -> None:
        """``member`` has gone."""
        self._members.remove(member)
        if member in self._paused:
            self._paused.remove(member)

    def drain(self, client: DrainingClient) -> None:
        """Let what ``client`` has sent go out."""
        self._draining.append(client)
        self._set_alarm()

    def heard(self, member: Member | None = None) -> None:
        """``member``, or somebody, has sent something."""
        if member is not None and member.is_behind:
            member.pause()
            self._paused.append(member)
        self._expect_motion()
        self.pump()

    def pump(self) -> None:
        """Do what is due on the bus now, and set the alarm for what comes next."""
        self.bus.sync()
        for member in tuple(self._members):
            if member in self._members:  # one that goes may take another with it
                member.pump()
        for member in tuple(self._paused):
            if member.is_behind:
                member.look()
            else:
                self._paused.remove(member)
                member.resume()
        if self._draining:
            self._draining = [client for client in self._draining if not client.has_left()]
        self._save()
        self._set_alarm()

    def _due_ns(self) -> Nanos | None:
        """What the bus does next, or a member, a client or a look at who is held back."""
        due = self.bus.next_event_ns()
        for member in self._members:
            due = earliest(due, member.next_event_ns())
        for client in self._draining:
            due = earliest(due, client.next_event_ns())
        if self._paused:
            due = earliest(due, self.bus.clock.now_ns() + LOOK_NS)
        return due

    @property
    def _has_news(self) -> bool:
        """Whether a member has; it may have come while others were pumped."""
        return any(member.has_news for member in self._members)
