"""``axistwin tap``: between a program and its device on a line or a bus, recording both."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import click

from axistwin.cli.output import EXIT_USAGE
from axistwin.errors import PortError, UsageError

if TYPE_CHECKING:
    from axistwin.cli.tap.file import TapFile
    from axistwin.runtime.serving.bus_server import BusPort

DEFAULT_LINK: Final = "./tap"
DEFAULT_BAUD: Final = 9600

_HELP: Final = {
    "pty": "Link for the program to open on a serial line.  [default: ./tap]",
    "rfc2217": "Serial port on TCP for the program, in place of a pty: passes on parity, data "
    "bits, break and modem lines too.",
    "baud": "Rate of PORT until the program sets one.  [default: 9600]",
    "parity": "Parity of PORT; a pty does not show what the program sets.  [default: none]",
    "can": "Bus with the program; without a place for the program a tap of a bus only listens.",
    "slcan": "Link for the program to open as an slcan adapter.",
    "slcan_tcp": "The same on TCP.",
    "socketcand": "The daemon socketcand for the program, with the bus vcan0.",
    "bitrate": "Rate of PORT, for adapters that have one.  [default: 125000]",
}

_OWN_OPTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "a serial line": ("pty", "rfc2217", "baud", "parity"),
    "a CAN bus": ("can", "slcan", "slcan_tcp", "socketcand", "bitrate"),
}
_ON_BUS: Final = re.compile(r"[a-z]\w*:(?!//).*", re.DOTALL)
"""INTERFACE:CHANNEL; what begins otherwise is a path, or a URL of pyserial."""


@click.command(epilog="Exit status: 0 ended by Ctrl-C, 2 wrong usage, or PORT or FILE has failed.")
@click.argument("place", metavar="PORT")
@click.argument("capture", metavar="FILE")
@click.option("--pty", metavar="LINK", help=_HELP["pty"])
@click.option("--rfc2217", metavar="HOST:PORT", help=_HELP["rfc2217"])
@click.option("--baud", type=click.IntRange(1, 4_000_000), metavar="N", help=_HELP["baud"])
@click.option("--parity", type=click.Choice(["none", "even", "odd"]), help=_HELP["parity"])
@click.option("--can", metavar="INTERFACE:CHANNEL", help=_HELP["can"])
@click.option("--slcan", metavar="LINK", help=_HELP["slcan"])
@click.option("--slcan-tcp", metavar="HOST:PORT", help=_HELP["slcan_tcp"])
@click.option("--socketcand", metavar="HOST:PORT", help=_HELP["socketcand"])
@click.option("--bitrate", type=click.IntRange(1, 1_000_000), metavar="N", help=_HELP["bitrate"])
def tap(place: str, capture: str, **options: Any) -> int:
    """Record what a program and a device say to each other.

    PORT has the device: a serial port, a pty of 'axistwin run' or any URL of pyserial; or a CAN
    bus, INTERFACE:CHANNEL of python-can.  The program opens LINK, or whatever is given, in its
    place; rate and stop bits that it sets are set on PORT.  Everything is appended to FILE before
    it is passed on.  'axistwin decode' shows FILE in words, 'axistwin replay' compares it with a
    twin.

    \b
    axistwin tap /dev/ttyUSB0 capture.txt
    axistwin tap ./mac23 capture.txt --pty ./recorded
    axistwin tap /dev/ttyUSB0 capture.txt --rfc2217 127.0.0.1:5001
    axistwin tap socketcan:can0 candump.log
    axistwin tap slcan:/dev/ttyACM0 candump.log --can socketcan:vcan0
    """
    from axistwin.cli.tap.file import TapFile

    is_bus = bool(_ON_BUS.fullmatch(place))
    own = _own_options("a CAN bus" if is_bus else "a serial line", place, options)
    losses: list[str] = []

    def lose(reason: str) -> None:
        losses.append(reason)
        what = "frames" if is_bus else "bytes"
        _warn(
            f"capture {capture}: cannot be written any more ({reason}); recording has ended, "
            f"{what} are still passed on"
        )

    with contextlib.closing(TapFile(capture, lose)) as file:
        (_tap_bus if is_bus else _tap_line)(place, capture, file, **own)
    return EXIT_USAGE if losses else 0


def _own_options(carrier: str, place: str, options: dict[str, Any]) -> dict[str, Any]:
    """The options of ``carrier``.  Raises UsageError if one of the other's is given."""
    for other, names in _OWN_OPTIONS.items():
        for name in names:
            if other != carrier and options[name] is not None:
                own = ", ".join(f"--{each.replace('_', '-')}" for each in _OWN_OPTIONS[carrier])
                option = f"--{name.replace('_', '-')}"
                raise UsageError(f"{option} is for {other}, and {place} is {carrier}: use {own}")
    return {name: options[name] for name in _OWN_OPTIONS[carrier]}


def _warn(text: str) -> None:
    click.echo(f"axistwin: {text}", err=True)


# ---- a serial line -------------------------------------------------------------------------------


def _tap_line(
    place: str,
    capture: str,
    file: TapFile,
    *,
    pty: str | None,
    rfc2217: str | None,
    baud: int | None,
    parity: str | None,
) -> None:
    """Until a signal ends it.  Raises UsageError and PortError."""
    from axistwin.cli.run.serving import stop_signals, warn_of_listeners
    from axistwin.cli.tap.line import LineTap
    from axistwin.cli.tap.program import ProgramPort, ProgramPty
    from axistwin.runtime.serving.loop import Loop

    if pty is not None and rfc2217 is not None:
        raise UsageError("--pty and --rfc2217: there is one program; give one of them")

    def tell(event: Mapping[str, object]) -> None:
        if event.get("dropped_bytes"):
            _warn(f"the program did not read {event['dropped_bytes']} bytes")

    with contextlib.closing(Loop()) as loop:
        loop.install_signal_handlers(stop_signals())
        with _opened(place, baud or DEFAULT_BAUD, parity or "none") as port:
            program: ProgramPty | ProgramPort
            if rfc2217 is not None:
                program = ProgramPort(rfc2217)
            else:
                program = ProgramPty(DEFAULT_LINK if pty is None else pty, port.baudrate)
            line = LineTap(port, program, file, loop, tell)

            def be_ready() -> None:
                warn_of_listeners([program], "device")
                click.echo(f"ready tap {program.describe()} -> {place}, {capture}")

            line.run(be_ready)


def _opened(place: str, baud: int, parity: str) -> Any:
    """The port at ``place``, as pyserial has it.  Raises PortError."""
    import serial

    from axistwin.cli.tap.line import READ_S

    try:
        return serial.serial_for_url(place, baudrate=baud, parity=parity[0].upper(), timeout=READ_S)
    except (OSError, ValueError) as error:  # pyserial's are
        number = getattr(error, "errno", None)
        reason = os.strerror(number) if number else str(error)
        if number == errno.EACCES:
            reason += "; 'axistwin doctor' names the remedy"
        raise PortError(f"{place}: {reason}") from None


# ---- a bus ---------------------------------------------------------------------------------------


def _tap_bus(
    place: str,
    capture: str,
    file: TapFile,
    *,
    can: str | None,
    slcan: str | None,
    slcan_tcp: str | None,
    socketcand: str | None,
    bitrate: int | None,
) -> None:
    """Until a signal ends it.  Raises UsageError and PortError."""
    from axistwin import catalog
    from axistwin.cli.run.reporter import Reporter
    from axistwin.cli.run.serving import stop_signals, warn_of_listeners
    from axistwin.cli.tap.bus import tap_bus
    from axistwin.ports.can_hub import SlcanPtyPort, SlcanTcpPort, SocketcandPort
    from axistwin.ports.can_join import JoinPort
    from axistwin.runtime.serving.rack import Rack

    if can == place:
        raise UsageError(f"--can {can}: that is the bus with the devices; give another one")
    rate = catalog.DEFAULT_BITRATE if bitrate is None else bitrate
    outside = JoinPort(place, rate)
    ports: list[BusPort] = [] if can is None else [JoinPort(can, rate)]
    ports += [] if slcan is None else [SlcanPtyPort(slcan)]
    ports += [] if slcan_tcp is None else [SlcanTcpPort(slcan_tcp)]
    ports += [] if socketcand is None else [SocketcandPort(socketcand)]

    def be_ready() -> None:
        warn_of_listeners(ports, "device")
        where = " ".join(port.describe() for port in ports)
        click.echo(f"ready tap {f'{where} -> ' if where else ''}{place}, {capture}")

    with contextlib.closing(Reporter(as_json=False)) as reporter:
        rack = Rack()
        rack.loop.install_signal_handlers(stop_signals())
        with contextlib.closing(rack):
            tap_bus(rack, outside, ports, file, reporter.event, be_ready)
