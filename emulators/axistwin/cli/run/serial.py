"""``axistwin run`` for models that live on a serial line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from axistwin import catalog
from axistwin.catalog import DeviceSpec
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.cli.run.serving import Run, Shared
from axistwin.devices.family import UsbIdentity
from axistwin.errors import UsageError
from axistwin.kernel.effects import Trace
from axistwin.runtime.line import Line
from axistwin.runtime.serving.line_server import Server

if TYPE_CHECKING:
    from axistwin.runtime.serving.line_server import LinePort
    from axistwin.runtime.serving.loop import Loop, LoopShare
    from axistwin.runtime.twin import Twin


class SerialRun(Run[Line]):
    """Modules on one line behind ptys and TCP; without an endpoint a pty at ``./MODEL``.

    Those with USB also as HID devices.
    """

    def __init__(
        self,
        specs: Sequence[DeviceSpec],
        shared: Shared,
        *,
        links: tuple[str, ...],
        tcp: tuple[str, ...],
        rfc2217: tuple[str, ...],
        hid: bool,
        baud: int | None,
        programs: tuple[str, ...],
    ) -> None:
        super().__init__(specs, shared)
        self._usb = _usb_ports(specs) if hid else {}
        if not (links or tcp or rfc2217 or len(self._usb) == len(specs)):
            links = (f"./{specs[0].model}",)
        self._links, self._tcp, self._rfc2217 = links, tcp, rfc2217
        self._baud = baud
        self._programs = programs

    @property
    def has_programs(self) -> bool:
        """Whether some were named."""
        return bool(self._programs)

    def build(self) -> Line:
        """The line with its modules."""
        return catalog.build_line(
            self.specs,
            **self.shared.arguments(self.specs),
            baud=self._baud,
            programs=catalog.parse_programs(self._programs),
        )

    def serve(self, simulation: Line, reporter: Reporter, loop: Loop) -> Server:
        """The line behind all endpoints that were asked for."""
        if any("program_error" in twin.controls for twin in simulation.twins):
            _ProgramWatch(simulation, reporter)
        return Server(simulation, self._make_ports(simulation), report=reporter.event, loop=loop)

    def _make_ports(self, line: Line) -> list[LinePort]:
        ports: list[LinePort] = []
        if self._links:
            from axistwin.ports.pty import PtyPort

            ports += [PtyPort(link, line.device_format) for link in self._links]
        if self._tcp or self._rfc2217:
            from axistwin.ports.rfc2217 import Rfc2217Port
            from axistwin.ports.tcp import TcpPort

            ports += [*map(TcpPort, self._tcp), *map(Rfc2217Port, self._rfc2217)]
        if self._usb:
            from axistwin.ports.hid.uhid import UhidPort

            ports += [UhidPort(at, line.twins[at].name, usb) for at, usb in self._usb.items()]
        return ports

    def recording(
        self, simulation: Line, path: str, loop: LoopShare, on_failure: Callable[[str], None]
    ) -> AbstractContextManager[None]:
        """Bursts of bytes, in hex and in words."""
        from axistwin.cli.run.capture import recording_line

        explain = catalog.find_model(self.specs[0].model).explain
        return recording_line(simulation, path, explain, loop, on_failure)

    def warn_of_surprises(self, simulation: Line) -> None:
        """Say where the memory differs from what was asked for, and where two collide."""
        found: dict[int, DeviceSpec] = {}
        rates: dict[int, DeviceSpec] = {}  # the first device at each
        for spec, twin in zip(self.specs, simulation.twins, strict=True):
            wanted = self._baud or catalog.find_model(spec.model).default_baud
            stored, address = twin.cells.get("baud", wanted), twin.address
            differences = []
            if address != spec.address and "address" not in twin.cells:
                warn(f"{spec}: is unit {address}, since a controller on RS-232 has no other number")
            elif address != spec.address:
                differences.append(f"address {address} (asked for: {spec.address})")
            if stored != wanted:
                differences.append(f"{stored} baud (asked for: {wanted})")
            if differences:
                warn(f"{spec}: its memory has {' and '.join(differences)}, and that holds")
            if address in found:
                warn(f"{found[address]} and {spec} answer on top of one another: address {address}")
            found.setdefault(address, spec)
            rates.setdefault(stored, spec)
        if len(rates) > 1:
            told = ", ".join(f"{spec} at {rate} baud" for rate, spec in rates.items())
            warn(f"{told}: no client understands all of them")


def _usb_ports(specs: Sequence[DeviceSpec]) -> dict[int, UsbIdentity]:
    """The place on the line of each device with USB, and what it is there.  Raises UsageError."""
    found = {at: catalog.find_model(spec.model).usb for at, spec in enumerate(specs)}
    ports = {at: usb for at, usb in found.items() if usb is not None}
    if not ports:
        known = ", ".join(name for name, model in catalog.models().items() if model.usb)
        raise UsageError(f"--hid: {specs[0]} has no USB; leave it out, or name one with: {known}")
    return ports


class _ProgramWatch:
    """Says when a program has ended otherwise than it should, once for each start."""

    def __init__(self, line: Line, reporter: Reporter) -> None:
        self._reporter = reporter
        self._failed_early = {
            twin.name: twin.program_error
            for twin in line.twins
            if "program_error" in twin.controls and twin.program_error
        }
        for name, error in self._failed_early.items():  # in a scan before anybody listened
            self._tell_error(name, error)
        line.subscribe(self._hear)

    def _hear(self, twin: Twin, trace: Trace) -> None:
        from axistwin.devices.program_traces import ProgramFailed, StrayReturn

        if isinstance(trace, StrayReturn):
            self._reporter.warn(f"{twin.name}: its program has stopped: run came to its end")
            self._reporter.event({"event": "stray_return", "device": twin.name})
        if not isinstance(trace, ProgramFailed):
            return
        if self._failed_early.pop(twin.name, None) != trace.error:
            self._tell_error(twin.name, trace.error)

    def _tell_error(self, name: str, error: str) -> None:
        self._reporter.warn(f"{name}: its program has stopped with an error: {error}")
        self._reporter.event({"event": "program_error", "device": name, "error": error})
