"""An operating system that gives the serving process little time, for tests of servers.

Everything is real, descriptors and loop, but for the time: it stands still until the process looks
at the clock, and may then have gone on by any time, as if the process had been paused just before.
While nothing is ready, it goes on to the alarm.  Clients act when the process waits, or at any
other wait of its loop, in the same thread.
"""

import contextlib
import os
import select
from collections.abc import Iterator
from random import Random
from typing import Any, TypeAlias

import pytest

from axistwin.kernel.time import NS_PER_MS, NS_PER_US, Nanos
from axistwin.runtime.serving import base_server
from axistwin.runtime.serving.base_server import BaseServer
from axistwin.runtime.serving.rack import Rack

PAUSES_NS = (NS_PER_US, 40 * NS_PER_US, NS_PER_MS, 12 * NS_PER_MS, 60 * NS_PER_MS)
LONG_NS = 50 * NS_PER_MS
STUCK_MS = 300
"""What a pty gets, in real time, to carry what was written."""

Script: TypeAlias = Iterator[None]
"""What a client does; it goes on at each wait of the process."""


class PausedSystem:
    """Time, alarm and ``epoll`` of a server whose process is paused ``often`` (0..1).

    waited_ns: how long the process has waited for its alarm; how long it was paused does not count.
    settle_ms: what a pty gets before a long wait; 0 where all is there as soon as it is written.
    """

    def __init__(self, seed: int, often: float, monkeypatch: pytest.MonkeyPatch) -> None:
        self.waited_ns: Nanos = 0
        self.settle_ms = STUCK_MS
        self._random = Random(seed)
        self._often = often
        self._now_ns: Nanos = 0
        self._due_ns: Nanos | None = None
        self._script: Script = iter(())
        self._rack = Rack()
        self.loop = self._rack.loop
        self._epoll = self.loop._epoll
        self._bell = os.eventfd(0, os.EFD_NONBLOCK)
        monkeypatch.setattr(self.loop, "_epoll", self)
        monkeypatch.setattr(base_server, "Alarm", lambda: self)

    def source(self) -> int:
        """What the process is told when it asks for the time."""
        self._now_ns += NS_PER_US
        if self._random.random() < self._often:
            self._now_ns += self._random.choice(PAUSES_NS)
        return self._now_ns

    def run(self, server: BaseServer[Any, Any], script: Script) -> None:
        """Serve until ``script`` has come to its end."""
        self._script = script
        self._rack.add(server)
        self._rack.open()
        self._rack.run()

    def close(self) -> None:
        """Nothing: this is the alarm too, which its server closes."""

    def release(self) -> None:
        """Give the descriptors back."""
        os.close(self._bell)
        self._epoll.close()

    # -- the alarm --

    def fileno(self) -> int:
        """What is readable when the alarm has gone off."""
        return self._bell

    def set(self, delay_ns: Nanos) -> None:
        """Go off then."""
        self.clear()
        self._due_ns = self._now_ns + max(1, delay_ns)

    def clear(self) -> None:
        """Do not go off."""
        self._due_ns = None
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._bell)

    # -- epoll --

    def __getattr__(self, name: str) -> Any:
        return getattr(self._epoll, name)

    def poll(self, timeout_s: float, maxevents: int) -> list[tuple[int, int]]:
        """What is ready; before it waits the clients act, and then the alarm goes off."""
        while True:
            if self._random.random() < self._often:
                self._go_on()
            if ready := self._ready(maxevents):
                return ready
            if timeout_s == 0 or self._has_stopped:
                return []
            self._go_on()
            if ready := self._ready(maxevents):
                return ready
            if self.loop._is_stopped:
                continue
            if self._due_ns is None:
                assert self._ready(maxevents, STUCK_MS), "the process sleeps, and a client waits"
                continue
            if self._due_ns > self._now_ns + LONG_NS:
                if ready := self._ready(maxevents, self.settle_ms):
                    return ready
                self._go_on()
            self.waited_ns += max(0, self._due_ns - self._now_ns)
            self._now_ns = max(self._now_ns, self._due_ns)

    def _ready(self, maxevents: int, patience_ms: int = 0) -> list[tuple[int, int]]:
        if self._due_ns is not None and self._due_ns <= self._now_ns:
            os.eventfd_write(self._bell, 1)
        found: list[tuple[int, int]] = self._epoll.poll(patience_ms / 1000, maxevents)
        self._random.shuffle(found)
        return found

    @property
    def _has_stopped(self) -> bool:
        return bool(self.loop._is_stopped)

    def _go_on(self) -> None:
        """Let the clients act."""
        if self._has_stopped:
            return
        try:
            next(self._script)
        except StopIteration:
            self._rack.request_stop()


def received(fd: int) -> bytes:
    """What a client finds there now."""
    if not select.select([fd], [], [], 0)[0]:
        return b""
    return os.read(fd, 65536)
