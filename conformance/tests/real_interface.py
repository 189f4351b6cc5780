"""An interface in real time: a pty, or a TCP port, in front of the TCP port of `axistwin run`.

What comes from the twin is handed on in lumps, or later, as an adapter or a terminal server does;
what goes to it is late by the same jitter.
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import json
import os
import pty
import random
import select
import socket
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass

CHUNK = 4096
TICK_S = 0.001
START_S = 20.0


@dataclass(frozen=True, slots=True)
class RealWay:
    """Times in s: what is received is handed on once per `lump_s`; either way takes `way_s`."""

    lump_s: float = 0.0
    way_s: tuple[float, float] = (0.0, 0.0)
    is_pty: bool = True


class _Pump:
    """Carries bytes between the two ends until it is stopped."""

    def __init__(self, near: int, twin: int, way: RealWay, seed: int) -> None:
        self._near, self._twin, self._way = near, twin, way
        self._random = random.Random(seed)
        self._due: list[tuple[float, int, int, bytes]] = []  # when, number, to where, what
        self._numbers = itertools.count()
        self._last = {near: 0.0, twin: 0.0}  # when what was sent there last is due
        self.stopped = threading.Event()

    def run(self) -> None:
        """Carry."""
        while not self.stopped.is_set():
            ready, _, _ = select.select([self._near, self._twin], [], [], TICK_S)
            for end in ready:
                with contextlib.suppress(OSError):  # the far end of a pty may be closed for now
                    self._take(end, os.read(end, CHUNK))
            now = time.monotonic()
            while self._due and self._due[0][0] <= now:
                _, _, end, data = heapq.heappop(self._due)
                with contextlib.suppress(OSError):
                    os.write(end, data)

    def _take(self, end: int, data: bytes) -> None:
        if not data:  # hung up
            self.stopped.set()
            return
        to = self._twin if end == self._near else self._near
        at = time.monotonic() + self._random.uniform(*self._way.way_s)
        if to == self._near and self._way.lump_s:
            at += self._way.lump_s - at % self._way.lump_s
        self._last[to] = max(at, self._last[to])
        heapq.heappush(self._due, (self._last[to], next(self._numbers), to, data))


@contextlib.contextmanager
def twin_behind(way: RealWay, *words: str, seed: int = 0) -> Iterator[str]:
    """Run `axistwin run WORDS` behind that; give what `--port` takes."""
    command = [sys.executable, "-m", "axistwin", "run", *words, "--tcp", "127.0.0.1:0", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        try:
            assert daemon.stdout is not None
            ready = json.loads(daemon.stdout.readline())
            host, port = ready["url"].removeprefix("socket://").rsplit(":", 1)
            with socket.create_connection((host, int(port)), START_S) as twin:
                twin.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                with _near_end(way) as (near, name):
                    yield from _pumped(near, twin, way, seed, name)
        finally:
            daemon.terminate()
            daemon.wait(START_S)


def _pumped(
    near: list[int], twin: socket.socket, way: RealWay, seed: int, name: str
) -> Iterator[str]:
    pumps: list[_Pump] = []
    is_over = threading.Event()

    def carry() -> None:
        while not is_over.is_set():
            if not near:
                time.sleep(TICK_S)
                continue
            pumps.append(_Pump(near[-1], twin.fileno(), way, seed))
            pumps[-1].run()
            return

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()
    try:
        yield name
    finally:
        is_over.set()
        for pump in pumps:
            pump.stopped.set()
        thread.join(START_S)


@contextlib.contextmanager
def _near_end(way: RealWay) -> Iterator[tuple[list[int], str]]:
    """The end for the suite: its descriptor as soon as there is one, and its name."""
    if way.is_pty:
        master, slave = pty.openpty()
        tty.setraw(slave)
        try:
            yield [master], os.ttyname(slave)
        finally:
            os.close(slave)
            os.close(master)
        return
    near: list[int] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        clients: list[socket.socket] = []

        def accept() -> None:
            with contextlib.suppress(OSError):
                client, _ = server.accept()
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                clients.append(client)
                near.append(client.fileno())

        threading.Thread(target=accept, daemon=True).start()
        try:
            yield near, f"socket://127.0.0.1:{server.getsockname()[1]}"
        finally:
            for client in clients:
                client.close()
