"""A server around an echo line, for tests of ports."""

import socket
import time
from collections.abc import Callable
from typing import Any, Self, cast

import pytest
from echo_line import EchoLine

from axistwin.runtime.line import Line
from axistwin.runtime.serving.line_server import LinePort, Server
from axistwin.runtime.serving.rack import Rack

TIMEOUT_S = 20.0
"""How long anything may take before a test fails."""

EVERY_BYTE = bytes(range(256))


class Served:
    """``port`` serving ``line`` in a thread, within ``with``; ``events``: what was reported."""

    def __init__(self, port: LinePort, line: EchoLine | None = None) -> None:
        self.line = line or EchoLine()
        self.port = port
        self.events: list[dict[str, Any]] = []
        self.rack = Rack()
        self.server = self.rack.add(
            Server(
                cast(Line, self.line),
                [port],
                loop=self.rack.loop,
                report=lambda event: self.events.append(dict(event)),
            )
        )

    def __enter__(self) -> Self:
        self.rack.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.rack.stop()

    def names(self) -> list[str]:
        """The names of the events so far."""
        return [event["event"] for event in tuple(self.events)]


def eventually(condition: Callable[[], bool]) -> bool:
    """Whether ``condition`` becomes true in time."""
    end = time.monotonic() + TIMEOUT_S
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def falls_quiet(count: Callable[[], int], seconds: float = 0.2) -> bool:
    """Whether, once what is under way has been done, ``count`` stays the same for so long."""

    def is_quiet() -> bool:
        before = count()
        time.sleep(seconds)
        return count() == before

    return eventually(is_quiet)


def receive_until(client: socket.socket, end: bytes) -> bytes:
    """What comes up to and including ``end``."""
    data = b""
    while not data.endswith(end):
        more = client.recv(4096)
        assert more, f"closed behind {data!r}"
        data += more
    return data


def hurry_rfc2217_clients(monkeypatch: pytest.MonkeyPatch) -> None:
    """pyserial's client waits in steps of 50 ms, and 300 ms at the end: from now on, in 2 ms."""

    class Time:
        time, monotonic = time.time, time.monotonic

        @staticmethod
        def sleep(seconds: float) -> None:
            time.sleep(min(seconds, 0.002))

    monkeypatch.setattr("serial.rfc2217.time", Time)
