"""A rack of real twins without ports, and its control server, for tests with real sockets."""

import http.client
import json
import socket
from collections.abc import Callable, Mapping
from typing import Any, Self

from axistwin.catalog import build_bus, build_line, find_model, parse_device
from axistwin.control.server import ControlServer
from axistwin.ports.tcp import parse_address
from axistwin.runtime.clock import Clock, PacedClock
from axistwin.runtime.serving.bus_server import BusServer
from axistwin.runtime.serving.line_server import Server
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.simulation import Simulation

TIMEOUT_S = 20.0
"""How long anything may take before a test fails."""


def add_line(
    rack: Rack, texts: str, clock: Clock, hear: Callable[[dict[str, Any]], None]
) -> Simulation[Any]:
    """A line or bus of ``rack``, without ports, with the devices ``texts``; ``hear``: its events.

    Whoever calls this closes it.
    """
    specs = [parse_device(text) for text in texts.split()]

    def report(event: Mapping[str, Any]) -> None:
        hear(dict(event))

    if find_model(specs[0].model).carrier == "can":
        bus = build_bus(specs, clock=clock)
        rack.add(BusServer(bus, [], loop=rack.loop, report=report))
        return bus
    line = build_line(specs, clock=clock)
    rack.add(Server(line, [], loop=rack.loop, report=report))
    return line


class ServedControl:
    """Lines with ``devices`` (several on one line in one text), served within ``with``."""

    def __init__(
        self, *devices: str, token: str | None = None, host: str = "127.0.0.1", speed: float = 1.0
    ) -> None:
        self.rack = Rack()
        self.lines: list[Simulation[Any]] = []
        self.events: list[dict[str, Any]] = []
        for texts in devices:
            clock = PacedClock(speed)
            self.lines.append(add_line(self.rack, texts, clock, self.events.append))
        self.server = ControlServer(self.rack, f"{host}:0", token)

    def __enter__(self) -> Self:
        self.server.open()
        self.rack.start()
        self.server.serve()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.close()
        self.rack.stop()
        for line in self.lines:
            line.close()

    @property
    def place(self) -> tuple[str, int]:
        """Host and port."""
        return parse_address(self.server.url.removeprefix("http://"))

    def connect(self) -> socket.socket:
        """A bare connection."""
        return socket.create_connection(self.place, timeout=TIMEOUT_S)

    def ask(
        self, method: str, path: str, body: Any = None, headers: dict[str, str] | None = None
    ) -> tuple[int, Any]:
        """Status and JSON of the answer at ``path``, below /api/v1 unless it begins with /."""
        connection = http.client.HTTPConnection(*self.place, timeout=TIMEOUT_S)
        given = dict(headers or {})
        if body is not None:
            given.setdefault("Content-Type", "application/json")
            body = body if isinstance(body, bytes) else json.dumps(body).encode()
        try:
            url = path if path.startswith("/") else f"/api/v1/{path}"
            connection.request(method, url, body, given)
            response = connection.getresponse()
            data = response.read()
        finally:
            connection.close()
        is_json = response.headers.get_content_type() == "application/json"
        return response.status, json.loads(data) if is_json else data

    def get(self, path: str) -> Any:
        """The answer; it is a good one."""
        status, answer = self.ask("GET", path)
        assert status == 200, answer
        return answer

    def raw(self, request: bytes) -> bytes:
        """All that is answered to ``request`` until the connection is closed."""
        with self.connect() as connection:
            connection.sendall(request)
            data = b""
            while more := connection.recv(65536):
                data += more
            return data
