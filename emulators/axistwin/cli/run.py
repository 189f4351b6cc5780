"""``axistwin run``: twins on a serial line, served until a signal ends it."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from threading import Event
from typing import TYPE_CHECKING, Any, cast

import click

from axistwin.cli import systemd
from axistwin.cli.output import EXIT_USAGE, discard_stdout
from axistwin.errors import UsageError

if TYPE_CHECKING:
    from axistwin.catalog import DeviceSpec
    from axistwin.runtime.line import Line
    from axistwin.runtime.server import Port

_HELP_PTY = (
    "Pseudo terminal behind the symbolic link LINK (default: ./MODEL of the first device, "
    "and none with --tcp or --rfc2217 alone)."
)
_HELP_TCP = "Raw TCP, several clients; port 0: any free one.  For socket://HOST:PORT."
_HELP_RFC2217 = "TCP with rate, framing and break, one client.  For rfc2217://HOST:PORT."


def _named(_: click.Context, option: click.Parameter, value: Any) -> Any:
    """A path, or several, none of them empty as an unset variable of a script leaves it."""
    if "" in ((value,) if isinstance(value, str) else value or ()):
        raise UsageError(f"{option.opts[0]}: needs a name, such as ./mac23")
    return value


@click.command(
    epilog="Ends on Ctrl-C or SIGTERM, with the link removed and the state saved.  "
    "Quirks: 'axistwin models MODEL'.  This machine: 'axistwin doctor'."
)
@click.argument("devices", metavar="MODEL[:ADDRESS]...", nargs=-1)
@click.option("--pty", "links", callback=_named, metavar="LINK", multiple=True, help=_HELP_PTY)
@click.option("--tcp", "tcp", metavar="HOST:PORT", multiple=True, help=_HELP_TCP)
@click.option("--rfc2217", "rfc2217", metavar="HOST:PORT", multiple=True, help=_HELP_RFC2217)
@click.option(
    "--state",
    callback=_named,
    metavar="DIR",
    help="Folder that holds what the modules store (default: nothing outlives this run).",
)
@click.option("--profile", callback=_named, metavar="FILE", help="Quirks from a TOML file.")
@click.option(
    "--quirk", "quirks", metavar="NAME=VALUE", multiple=True, help="One quirk; beats --profile."
)
@click.option(
    "--baud",
    type=int,
    metavar="N",
    help="Rate of modules that have none stored yet, bits per second (default: the factory's).",
)
@click.option(
    "--speed",
    type=float,
    default=1.0,
    metavar="X",
    show_default=True,
    help="Run X times as fast as real time.",
)
@click.option(
    "--no-pacing", is_flag=True, help="Bytes take no time on the line; the modules' own times stay."
)
@click.option(
    "--cold", is_flag=True, help="Apply the supply now: the modules are deaf for their first 2 s."
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    metavar="N",
    show_default=True,
    help="Of everything random.",
)
@click.option(
    "--capture",
    callback=_named,
    metavar="FILE",
    help="Append what is said on the line: time in ms, > or <, bytes in hex, meaning.",
)
@click.option("--json", "as_json", is_flag=True, help="Events on stdout, one JSON object per line.")
def run(
    devices: tuple[str, ...],
    links: tuple[str, ...],
    tcp: tuple[str, ...],
    rfc2217: tuple[str, ...],
    capture: str | None,
    as_json: bool,
    **options: Any,
) -> int:
    """Run twins on one serial line that any program can open.

    Several devices share the line, as modules on RS-485 do.  Several endpoints may be given; every
    client hears the whole line.  When clients can connect, one line per device says so:

    \b
    $ axistwin run mac23
    ready mac23:0 pty=./mac23 (/dev/pts/5)

    \b
    axistwin run mac23:0 mac34-1:5 --pty ./mac --state ./mac.state
    axistwin run mac23 --tcp 127.0.0.1:5000 --rfc2217 127.0.0.1:5001
    axistwin run mac23:7Fh --no-pacing --quirk reply_latency_us=0

    ADDRESS: 0..127, also as 7Fh or 0x7F; default 0.
    """
    if not devices:
        raise UsageError("run: which devices? such as 'axistwin run mac23'; see 'axistwin models'")
    from axistwin import catalog
    from axistwin.cli.capture import recording
    from axistwin.runtime.server import Server

    specs = [catalog.parse_device(text) for text in devices]
    if not (links or tcp or rfc2217):
        links = (f"./{specs[0].model}",)
    reporter = Reporter(as_json)

    def capture_lost(reason: str) -> None:
        reporter.lose(
            f"capture {capture}: cannot be written any more ({reason}); recording has ended, "
            "the modules go on",
            {"event": "capture_lost", "file": capture, "reason": reason},
        )

    with (
        ending_early() as signals_are_heeded,
        make_line(specs, **options) as line,
        contextlib.closing(
            Server(line, make_ports(line, links, tcp, rfc2217), report=reporter.event)
        ) as server,
    ):
        explain = catalog.find_model(specs[0].model).explain
        with recording(line, capture, explain, server.loop, capture_lost):
            server.heed(_stop_signals())
            signals_are_heeded.set()
            server.open()
            warn_of_listeners(server.ports)
            warn_of_surprises(specs, line, options["baud"])
            if line.is_volatile:
                _warn("memory is volatile and ends with this run; --state DIR keeps it")

            def on_ready() -> None:
                reporter.ready(line, server.ports)
                systemd.notify("READY=1")

            try:
                server.run(on_ready=on_ready)
            finally:
                systemd.notify("STOPPING=1")
    reporter.event({"event": "stopped"})
    return EXIT_USAGE if reporter.has_lost else 0


@contextlib.contextmanager
def ending_early() -> Iterator[Event]:
    """In the block a stop signal ends the program at once, with all closed that was opened.

    When the event that is given is set, something else heeds the signals, and what is done
    afterwards (saving) is not disturbed by another one.
    """
    is_heeded = Event()

    def end(*_: object) -> None:
        if not is_heeded.is_set():
            raise SystemExit(0)

    previous = {number: signal.signal(number, end) for number in _stop_signals()}
    try:
        yield is_heeded
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _stop_signals() -> list[signal.Signals]:
    """Ctrl-C, the polite kill, and the end of the terminal, unless nohup says to outlive that."""
    signals = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signals.append(signal.SIGHUP)
    return signals


def make_line(
    specs: Sequence[DeviceSpec],
    *,
    state: str | None,
    profile: str | None,
    quirks: tuple[str, ...],
    baud: int | None,
    speed: float,
    no_pacing: bool,
    cold: bool,
    seed: int,
) -> Line:
    """The line with its modules, as the options say.  Raises UsageError and StateError."""
    from axistwin import catalog
    from axistwin.runtime.clock import PacedClock
    from axistwin.runtime.storage import MemoryStorage, Storage

    settings: dict[str, catalog.Value] = {}
    if profile is not None:
        settings.update(catalog.read_profile(profile, {spec.model for spec in specs}))
    settings.update(catalog.parse_settings(quirks))
    clock = PacedClock(speed)
    return catalog.build_line(
        specs,
        quirks=settings,
        seed=seed,
        clock=clock,
        paced=not no_pacing,
        storage=MemoryStorage() if state is None else Storage(state),
        baud=baud,
        cold=cold,
    )


def make_ports(
    line: Line, links: tuple[str, ...], tcp: tuple[str, ...], rfc2217: tuple[str, ...]
) -> list[Port]:
    """The endpoints, not open yet.  Raises UsageError."""
    ports: list[Port] = []
    if links:
        from axistwin.ports.pty import PtyPort

        ports += [PtyPort(link, line.device_format) for link in links]
    if tcp or rfc2217:
        from axistwin.ports.rfc2217 import Rfc2217Port
        from axistwin.ports.tcp import TcpPort

        ports += [*map(TcpPort, tcp), *map(Rfc2217Port, rfc2217)]
    return ports


def warn_of_listeners(ports: Sequence[Port]) -> None:
    """Say which of the open ports others can reach."""
    for port in ports:
        if port.kind == "pty":
            continue
        from axistwin.ports.tcp import TcpPort, is_loopback

        if isinstance(port, TcpPort) and not is_loopback(port.host):
            _warn(
                f"{port.kind} {port.host}: whoever reaches this address can drive the twin, "
                "there is no password"
            )


def warn_of_surprises(specs: Sequence[DeviceSpec], line: Line, baud: int | None) -> None:
    """Say where the modules' memory differs from what was asked for, and where two collide."""
    from axistwin import catalog

    found: dict[int, DeviceSpec] = {}
    for spec, twin in zip(specs, line.twins, strict=True):
        wanted = baud or catalog.find_model(spec.model).default_baud
        stored, address = twin.cells["baud"], twin.address
        differences = []
        if address != spec.address:
            differences.append(f"address {address} (asked for: {spec.address})")
        if stored != wanted:
            differences.append(f"{stored} baud (asked for: {wanted})")
        if differences:
            _warn(f"{spec}: its memory has {' and '.join(differences)}, and that holds")
        if address in found:
            _warn(f"{found[address]} and {spec} answer on top of one another: address {address}")
        found.setdefault(address, spec)


def _warn(message: str) -> None:
    click.echo(f"axistwin: {message}", err=True)


class Reporter:
    """Events on stdout: ready lines for people, or everything as JSON for programs."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self.has_lost = False

    def lose(self, message: str, event: Mapping[str, object] | None = None) -> None:
        """Say that something asked for cannot be done any more; the exit status tells it too."""
        self.has_lost = True
        _warn(message)
        if event is not None:
            self.event(event)

    def ready(self, line: Line, ports: Sequence[Port]) -> None:
        """One event per device: clients can connect."""
        endpoints = [{"endpoint": port.kind, "url": port.url} for port in ports]
        for twin in line.twins:
            device = f"{twin.model}:{twin.address}"  # which may have been changed and stored
            if self._as_json:
                self.event(
                    {"event": "ready", "device": device, **endpoints[0], "endpoints": endpoints}
                )
            else:
                where = " ".join(f"{port.kind}={port.describe()}" for port in ports)
                self._say(f"ready {device} {where}")

    def event(self, event: Mapping[str, object]) -> None:
        """Tell one event; people are only told when clients can connect, and of a wrong rate."""
        if event["event"] == "wrong_rate":
            from axistwin.runtime.line import listening

            baud, bauds = event["baud"], cast("Sequence[int]", event["module_bauds"])
            _warn(f"{event['url']}: a client sends at {baud}, {listening(bauds)}: set its rate")
        if self._as_json:
            now = datetime.now().astimezone().isoformat(timespec="milliseconds")
            self._say(json.dumps({"event": event["event"], "time": now, **event}))

    def _say(self, text: str) -> None:
        """Whoever started us may have stopped listening, which is no reason to end."""
        try:
            sys.stdout.write(text + "\n")
            sys.stdout.flush()
        except OSError as error:
            discard_stdout()
            if not isinstance(error, BrokenPipeError):
                self.lose(
                    f"standard output cannot be written ({error.strerror}); nothing more is told "
                    "there, the modules go on"
                )
