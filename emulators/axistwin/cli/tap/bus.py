"""A tap of a CAN bus: a bus without devices, between a program and the bus with them, recorded.

    bus with the devices -- JoinPort --- Bus --- hub, or another JoinPort -- program
                                          |
                                       TapFile

Rules
-----
1. A frame is in the recording before it is passed on, so that a kill at any moment loses nothing
   that was passed on.
2. Without a place for the program the tap only listens: nothing goes to the bus, and nobody can
   tell who sent a frame.
3. Either side acknowledges and arbitrates for itself.  Error frames and CAN FD are not passed on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from axistwin.cli.tap.file import TapFile
from axistwin.kernel.time import Nanos
from axistwin.ports.can_join import JoinPort
from axistwin.runtime.bus import Bus, Passed
from axistwin.runtime.can_network import CanNetwork
from axistwin.runtime.clock import PacedClock
from axistwin.runtime.serving.base_server import Report
from axistwin.runtime.serving.bus_server import BusPort, BusServer
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.storage import MemoryStorage
from axistwin.runtime.transcript import Direction

CHANNEL: Final = "vcan0"
"""What the recording calls a bus that is no network interface."""


class _Witness:
    """A controller on the bus that takes everything: somebody has to acknowledge."""

    is_behind = False

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._station = bus.attach()

    @property
    def has_news(self) -> bool:
        """Whether there is something to take."""
        return self._bus.has_news(self._station)

    def next_event_ns(self) -> Nanos | None:
        """Never."""
        return None

    def pump(self) -> None:
        """Take it."""
        self._bus.receive(self._station)

    def pause(self) -> None:
        """It sends nothing that could be held back."""

    look = resume = pause


def tap_bus(
    rack: Rack,
    outside: JoinPort,
    program_ports: Sequence[BusPort],
    file: TapFile,
    report: Report,
    on_ready: Callable[[], None],
) -> None:
    """Pass on between ``outside`` and ``program_ports``, and record, until a signal ends ``rack``.

    Raises PortError.
    """
    network = CanNetwork([], bitrate=outside.bitrate, paced=False)
    with Bus(network, PacedClock(), MemoryStorage(), []) as bus:
        server = BusServer(bus, [outside, *program_ports], loop=rack.loop, report=report)
        server.add_member(_Witness(bus))
        channel = outside.channel if outside.interface == "socketcan" else CHANNEL

        def record(passed: Passed) -> None:
            direction: Direction = "device" if passed.senders == (outside.station,) else "host"
            file.add_frame(channel, passed.frame, direction if program_ports else None)

        bus.subscribe_frames(record)
        rack.add(server, "tap")
        rack.open()
        rack.run(on_ready=on_ready)
