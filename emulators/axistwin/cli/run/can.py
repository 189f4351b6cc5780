"""``axistwin run`` for models that live on a CAN bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Final

from axistwin import catalog
from axistwin.catalog import DeviceSpec
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.cli.run.serving import Run, Shared
from axistwin.errors import UsageError
from axistwin.ports import socketcan
from axistwin.runtime.bus import Bus
from axistwin.runtime.serving.bus_server import BusServer

if TYPE_CHECKING:
    from axistwin.kernel.time import Nanos
    from axistwin.runtime.serving.bus_server import BusPort
    from axistwin.runtime.serving.loop import Loop, LoopShare

DEFAULT_INTERFACE: Final = "vcan0"


class CanRun(Run[Bus]):
    """Modules on one bus: this process is the bus, or joins one.

    Without an endpoint it joins vcan0 if that is up, else it is a hub with an slcan pty at
    ``./MODEL``.
    """

    def __init__(
        self,
        specs: Sequence[DeviceSpec],
        shared: Shared,
        *,
        can: tuple[str, ...],
        slcan: tuple[str, ...],
        slcan_tcp: tuple[str, ...],
        socketcand: tuple[str, ...],
        bitrate: int | None,
    ) -> None:
        super().__init__(specs, shared)
        self._can, self._slcan, self._slcan_tcp, self._socketcand = (
            can,
            slcan,
            slcan_tcp,
            socketcand,
        )
        own_bitrate = catalog.find_model(specs[0].model).default_baud
        self._bitrate = own_bitrate if bitrate is None else bitrate
        self._chosen = not (self._can or self._slcan or self._slcan_tcp or self._socketcand)
        self._epoch_ns: Nanos = 0
        if len(self._can) > 1:
            raise UsageError(
                f"--can {self._can[1]}: the modules have joined {self._can[0]} already; one bus "
                "only, start a second 'axistwin run' for another"
            )
        if self._chosen and socketcan.link_state(DEFAULT_INTERFACE) == "up":
            self._can = (f"socketcan:{DEFAULT_INTERFACE}",)
        elif self._chosen:
            self._slcan = (f"./{specs[0].model}",)
        if self._slcan or self._slcan_tcp:
            _check_slcan_rate(self._bitrate)

    def build(self) -> Bus:
        """The bus with its modules; on a bus that is joined, time is that bus' own affair."""
        return catalog.build_bus(
            self.specs,
            **self.shared.arguments(self.specs, paced=not self._can),
            bitrate=self._bitrate,
        )

    def serve(self, simulation: Bus, reporter: Reporter, loop: Loop) -> BusServer:
        """The bus behind all endpoints that were asked for."""
        server = BusServer(simulation, self._make_ports(), report=reporter.event, loop=loop)
        self._epoch_ns = server.epoch_ns
        return server

    def _make_ports(self) -> list[BusPort]:
        ports: list[BusPort] = []
        if self._can:
            from axistwin.ports.can_join import JoinPort

            ports += [JoinPort(place, self._bitrate) for place in self._can]
        if self._slcan or self._slcan_tcp or self._socketcand:
            from axistwin.ports.can_hub import SlcanPtyPort, SlcanTcpPort, SocketcandPort

            ports += map(SlcanPtyPort, self._slcan)
            ports += map(SlcanTcpPort, self._slcan_tcp)
            ports += map(SocketcandPort, self._socketcand)
        if self._chosen:
            self._tell_choice(ports[0])
        return ports

    def _tell_choice(self, port: BusPort) -> None:
        """Where the modules are, since nobody said where they should be, and how to reach them."""
        if self._can:
            warn(f"{DEFAULT_INTERFACE} is up, the modules join it; clients: {port.client_line}")
            return
        why = {"absent": f"there is no {DEFAULT_INTERFACE}", "down": f"{DEFAULT_INTERFACE} is down"}
        state = why[socketcan.link_state(DEFAULT_INTERFACE)]
        warn(f"{state}, so this process is the bus; clients: {port.client_line}")
        warn(f"to have {DEFAULT_INTERFACE}: {socketcan.remedy(DEFAULT_INTERFACE)}")

    def recording(
        self, simulation: Bus, path: str, loop: LoopShare, on_failure: Callable[[str], None]
    ) -> AbstractContextManager[None]:
        """Frames as candump writes them."""
        from axistwin.cli.run.capture_can import recording_bus

        return recording_bus(simulation, path, loop, self._epoch_ns, on_failure)

    def warn_of_surprises(self, simulation: Bus) -> None:
        """Say where the memory differs from what was asked for, and where two collide."""
        found: dict[int, DeviceSpec] = {}
        for spec, twin in zip(self.specs, simulation.twins, strict=True):
            address = twin.address
            if address != spec.address:
                warn(
                    f"{spec}: its memory has address {address} (asked for: {spec.address}), "
                    "and that holds"
                )
            if address in found:
                warn(f"{found[address]} and {spec} disturb one another: address {address}")
            found.setdefault(address, spec)


def _check_slcan_rate(bitrate: int) -> None:
    """Say how a client is set to a rate that no digit chooses.  Raises UsageError if none can be.

    One out of the range of any bus is refused where the bus is built.
    """
    from axistwin.ports.slcan import STANDARD_RATES, registers_of

    if bitrate in STANDARD_RATES or not 0 < bitrate <= catalog.BITRATE_MAX:
        return
    standard = ", ".join(map(str, STANDARD_RATES))
    registers = registers_of(bitrate)
    if not registers:
        raise UsageError(
            f"bitrate {bitrate}: no slcan client can be set to it; choose one of {standard}"
        )
    warn(
        f"bitrate {bitrate}: slcan clients choose {standard}; to this one they are set by their "
        f"timing registers alone ({registers})"
    )
