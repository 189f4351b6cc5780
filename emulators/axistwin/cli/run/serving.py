"""A run of twins, whatever carries them: built, served, recorded, until a signal ends it."""

from __future__ import annotations

import contextlib
import os
import signal
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from axistwin.cli.extras import needed
from axistwin.cli.output import EXIT_USAGE
from axistwin.cli.run import systemd
from axistwin.cli.run.reporter import Reporter, warn
from axistwin.errors import UsageError
from axistwin.runtime.serving.rack import Rack
from axistwin.runtime.simulation import Simulation

if TYPE_CHECKING:
    from axistwin.catalog import DeviceSpec
    from axistwin.control.front.workforce import Workforce
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
    control_certificate: str | None = None
    control_key: str | None = None

    def control_server(self, rack: Rack) -> ControlServer | None:
        """The control server that is asked for.  Raises UsageError."""
        if self.control is None:
            for option, value in (
                ("--control-token-file", self.control_token_file),
                ("--control-certificate", self.control_certificate),
                ("--control-key", self.control_key),
            ):
                if value is not None:
                    raise UsageError(f"{option} goes with --control HOST:PORT")
            return None
        return make_control_server(
            rack, self.control, self.control_token_file, self.control_certificate, self.control_key
        )

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


def make_control_server(
    served: Rack | Workforce,
    address: str,
    token_file: str | None,
    certificate: str | None = None,
    key: str | None = None,
) -> ControlServer:
    """The control server of ``served`` at ``address``, not open yet.  Raises UsageError."""
    try:
        from axistwin.control import tls
        from axistwin.control.server import ControlServer
        from axistwin.control.token import find_token
    except ImportError as error:
        raise UsageError(
            f"--control: {error.name} is missing; install what it needs: "
            f"pip install {needed(error.name)}"
        ) from None
    if key is not None and certificate is None:
        raise UsageError(f"control key {key}: it goes with a certificate; give that as well")
    context = None if certificate is None else tls.server_context(certificate, key)
    return ControlServer(served, address, find_token(token_file, os.environ), context)


class Run(ABC, Generic[SimulationT]):
    """What differs from one carrier to the next."""

    def __init__(self, specs: Sequence[DeviceSpec], shared: Shared) -> None:
        self.specs = specs
        self.shared = shared

    @property
    def has_programs(self) -> bool:
        """Whether programs of the user run in it."""
        return False

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


class HostedLines:
    """The lines and buses of one ``rack``, each from being built to being closed."""

    def __init__(self, reporter: Reporter) -> None:
        self.rack = Rack()
        self.reporter = reporter
        self._stacks: dict[str, contextlib.ExitStack] = {}
        self._watching = contextlib.ExitStack()
        self._watches_programs = False

    def add(
        self,
        run: Run[SimulationT],
        line: str = "",
        prepare: Callable[[SimulationT], object] = lambda simulation: None,
    ) -> str:
        """Build what ``run`` asks for, not open yet; what it is called (``line``, if given).

        prepare: called before it is served.  Raises UsageError and StateError; nothing is left
        then.
        """
        if run.has_programs and not self._watches_programs:
            from axistwin.cli.run.watchdog import watching_programs

            self._watching.enter_context(watching_programs())
            self._watches_programs = True
        with contextlib.ExitStack() as stack:
            simulation = run.build()
            stack.push(simulation)
            prepare(simulation)
            server = run.serve(simulation, self.reporter, self.rack.loop)
            stack.callback(server.close)
            capture = run.shared.capture
            if capture is not None:
                lost = partial(self._lose_capture, capture)
                stack.enter_context(run.recording(simulation, capture, server.loop, lost))
            self.rack.add(server, line)
            name = next(name for name, each in self.rack.lines.items() if each is server)
            self._stacks[name] = stack.pop_all()
        return name

    def remove(self, line: str) -> None:
        """Serve ``line`` no more; its state is saved.  Raises StateError if that fails."""
        self.rack.remove(line)
        self._stacks.pop(line).close()

    def close(self) -> None:
        """Close all lines; only when the rack does not run."""
        with contextlib.ExitStack() as rest:
            rest.callback(self.rack.close)
            rest.push(self._watching.pop_all())
            for stack in self._stacks.values():
                rest.push(stack)
            self._stacks.clear()

    def warn_of_surprises(self, run: Run[Any], line: str) -> None:
        """Say what the user may not expect of ``line``, which is open."""
        server = self.rack.lines[line]
        warn_of_listeners(server.ports)
        run.warn_of_surprises(server.simulation)

    def serve(self, control: ControlServer | None, on_ready: Callable[[], None]) -> None:
        """Serve what is open until a signal ends it.

        on_ready: called when clients can connect.
        """

        def ready() -> None:
            if control is not None:
                control.serve()
            on_ready()
            systemd.notify("READY=1")

        try:
            self.rack.run(on_ready=ready)
        finally:
            systemd.notify("STOPPING=1")

    def _lose_capture(self, capture: str, reason: str) -> None:
        self.reporter.lose(
            f"capture {capture}: cannot be written any more ({reason}); recording has ended, "
            "the modules go on",
            {"event": "capture_lost", "file": capture, "reason": reason},
        )


VOLATILE = "memory ends with this run"


def perform(run: Run[SimulationT], reporter: Reporter) -> int:
    """Serve until a signal ends it; the exit status.  Raises UsageError, StateError, PortError."""
    with contextlib.closing(reporter):
        with contextlib.closing(HostedLines(reporter)) as lines, contextlib.ExitStack() as beside:
            rack = lines.rack
            # During the start: it ends when it can.
            rack.loop.install_signal_handlers(stop_signals())
            line = lines.add(run)
            control = run.shared.control_server(rack)
            rack.open()
            if control is not None:
                beside.callback(control.close)
                control.open()
            lines.warn_of_surprises(run, line)
            server = rack.lines[line]
            if server.simulation.is_volatile:
                warn(f"{VOLATILE}; --state DIR keeps it")

            def on_ready() -> None:
                # The address may have been changed and stored.
                names = [f"{twin.model}:{twin.address}" for twin in server.simulation.twins]
                reporter.ready(names, server.ports, None if control is None else control.url)

            lines.serve(control, on_ready)
        reporter.stopped()
    return EXIT_USAGE if reporter.has_lost else 0


def stop_signals() -> list[signal.Signals]:
    """Ctrl-C, the polite kill, and the end of the terminal, unless nohup says to outlive that."""
    signals = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signals.append(signal.SIGHUP)
    return signals


def warn_of_listeners(ports: Sequence[Endpoint], what: str = "twin") -> None:
    """Say through which of the open ports others can reach ``what``."""
    for port in ports:
        host = getattr(port, "host", None)
        if host is None:  # no network in between
            continue
        from axistwin.ports.tcp import is_loopback

        if not is_loopback(host):
            warn(
                f"{port.kind} {host}: whoever reaches this address can drive the {what}, there "
                "is no password"
            )
