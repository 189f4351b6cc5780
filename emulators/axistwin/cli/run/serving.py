"""A run of twins, whatever carries them: built, served, recorded, until a signal ends it."""

from __future__ import annotations

import contextlib
import os
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from axistwin.cli.extras import needed
from axistwin.cli.output import EXIT_USAGE
from axistwin.cli.run import systemd
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.control.token import find_token
from axistwin.errors import UsageError
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.simulation import Simulation

if TYPE_CHECKING:
    from axistwin.catalog import DeviceSpec
    from axistwin.control.server import ControlServer
    from axistwin.runtime.serving.base_server import BaseServer, Endpoint
    from axistwin.runtime.serving.loop import Loop, LoopShare

SimulationT = TypeVar("SimulationT", bound=Simulation[Any])


@dataclass(frozen=True, slots=True)
class Shared:
    """The options that mean the same for every carrier; see ``axistwin run --help``."""

    state: str | None
    profile: str | None
    quirks: tuple[str, ...]
    speed: float
    no_pacing: bool
    cold: bool
    seed: int
    capture: str | None
    control: str | None = None
    control_token_file: str | None = None

    def control_server(self, rack: Rack) -> ControlServer | None:
        """The control server that is asked for.  Raises UsageError."""
        if self.control is None:
            if self.control_token_file is not None:
                raise UsageError("--control-token-file goes with --control HOST:PORT")
            return None
        try:
            from axistwin.control.server import ControlServer
        except ImportError as error:
            raise UsageError(
                f"--control: {error.name} is missing; install what it needs: "
                f"pip install {needed(error.name)}"
            ) from None
        return ControlServer(rack, self.control, find_token(self.control_token_file, os.environ))

    def arguments(self, specs: Sequence[DeviceSpec], *, paced: bool = True) -> dict[str, Any]:
        """For ``build_line`` or ``build_bus`` of the catalog; ``paced``: what may take time does.

        Raises UsageError and StateError.
        """
        from axistwin import catalog
        from axistwin.runtime.clock import PacedClock
        from axistwin.runtime.storage import MemoryStorage, Storage

        return {
            "quirks": catalog.all_settings(
                specs, self.profile, catalog.parse_settings(self.quirks)
            ),
            "seed": self.seed,
            "clock": PacedClock(self.speed),
            "paced": paced and not self.no_pacing,
            "storage": MemoryStorage() if self.state is None else Storage(self.state),
            "cold": self.cold,
        }


class Run(ABC, Generic[SimulationT]):
    """What differs from one carrier to the next."""

    def __init__(self, specs: Sequence[DeviceSpec], shared: Shared) -> None:
        self.specs = specs
        self.shared = shared

    def watching(self) -> AbstractContextManager[None]:
        """What watches over the run, from before ``build``."""
        return contextlib.nullcontext()

    @abstractmethod
    def build(self) -> SimulationT:
        """The devices and what connects them.  Raises UsageError and StateError."""

    @abstractmethod
    def serve(
        self, simulation: SimulationT, reporter: Reporter, loop: Loop
    ) -> BaseServer[SimulationT, Any]:
        """The server with its ports, not open yet, in ``loop``.  Raises UsageError."""

    @abstractmethod
    def recording(
        self, simulation: SimulationT, path: str, loop: LoopShare, on_failure: Callable[[str], None]
    ) -> AbstractContextManager[None]:
        """Append what is said to the file at ``path``.  Raises UsageError.

        on_failure: called with the reason, once, when the recording has to end early.
        """

    @abstractmethod
    def warn_of_surprises(self, simulation: SimulationT) -> None:
        """Say what the user may not expect."""


def perform(run: Run[SimulationT], reporter: Reporter) -> int:
    """Serve until a signal ends it; the exit status.  Raises UsageError, StateError, PortError."""
    capture = run.shared.capture

    def capture_lost(reason: str) -> None:
        reporter.lose(
            f"capture {capture}: cannot be written any more ({reason}); recording has ended, "
            "the modules go on",
            {"event": "capture_lost", "file": capture, "reason": reason},
        )

    with contextlib.closing(reporter), contextlib.closing(Rack()) as rack:
        # During the start: it ends when it can.
        rack.loop.install_signal_handlers(stop_signals())
        with (
            run.watching(),
            run.build() as simulation,
            contextlib.closing(rack.add(run.serve(simulation, reporter, rack.loop))) as server,
            contextlib.ExitStack() as beside,
        ):
            if capture is not None:
                beside.enter_context(run.recording(simulation, capture, server.loop, capture_lost))
            control = run.shared.control_server(rack)
            rack.open()
            if control is not None:
                beside.callback(control.close)
                control.open()
            warn_of_listeners(server.ports)
            run.warn_of_surprises(simulation)
            if simulation.is_volatile:
                warn("memory is volatile and ends with this run; --state DIR keeps it")

            def on_ready() -> None:
                if control is not None:
                    control.serve()
                url = None if control is None else control.url
                reporter.ready(simulation.twins, server.ports, url)
                systemd.notify("READY=1")

            try:
                rack.run(on_ready=on_ready)
            finally:
                systemd.notify("STOPPING=1")
        reporter.stopped()
    return EXIT_USAGE if reporter.has_lost else 0


def stop_signals() -> list[signal.Signals]:
    """Ctrl-C, the polite kill, and the end of the terminal, unless nohup says to outlive that."""
    signals = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signals.append(signal.SIGHUP)
    return signals


def warn_of_listeners(ports: Sequence[Endpoint]) -> None:
    """Say which of the open ports others can reach."""
    for port in ports:
        host = getattr(port, "host", None)
        if host is None:  # no network in between
            continue
        from axistwin.ports.tcp import is_loopback

        if not is_loopback(host):
            warn(
                f"{port.kind} {host}: whoever reaches this address can drive the twin, "
                "there is no password"
            )
