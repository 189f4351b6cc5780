"""A server around a bus of real twins in real time, for tests of CAN ports."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

import can
from can.interfaces.slcan import slcanBus

from axistwin.catalog import build_bus, parse_device
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.serving.bus_server import BusPort, BusServer
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.storage import Stores

TIMEOUT_S = 20.0
"""How long anything may take before a test fails."""

POSITION = can.Message(
    arbitration_id=0x601, data=bytes.fromhex("4000200000000000"), is_extended_id=False
)
"""An upload of the position of module 1."""


class ServedBus:
    """``ports`` serving modules 1 and 2 in a thread, within ``with``; ``events``: the reports."""

    def __init__(
        self,
        *ports: BusPort,
        paced: bool = True,
        speed: float = 1.0,
        storage: Stores | None = None,
    ) -> None:
        specs = [parse_device(f"mac23-can:{address}") for address in (1, 2)]
        self.bus = build_bus(specs, clock=PacedClock(speed), paced=paced, storage=storage)
        self.events: list[dict[str, Any]] = []
        self.rack = Rack()
        self.server = self.rack.add(
            BusServer(
                self.bus,
                ports,
                loop=self.rack.loop,
                report=lambda event: self.events.append(dict(event)),
            )
        )

    def __enter__(self) -> Self:
        self.rack.start()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.rack.stop()
        finally:
            self.bus.close()

    def names(self) -> list[str]:
        """The names of the events so far."""
        return [event["event"] for event in tuple(self.events)]


@contextmanager
def client(line: str) -> Iterator[can.BusABC]:
    """A client opened by what ``line`` says, without the two seconds that slcan's rests."""
    if 'interface="slcan"' in line:
        line = f"{line[:-1]}, sleep_after_open=0)"
    with eval(line, {"can": can}) as bus:  # the line that users are told
        if isinstance(bus, slcanBus):
            assert bus.get_version(TIMEOUT_S) == (10, 13), "its channel is open by now"
        yield bus


def receive(bus: can.BusABC, identifier: int) -> can.Message:
    """The next message with that identifier."""
    end = time.monotonic() + TIMEOUT_S
    while (left := end - time.monotonic()) > 0:
        message = bus.recv(left)
        if message is not None and message.arbitration_id == identifier:
            return message
    raise AssertionError(f"nothing came from {identifier:03X}h")
