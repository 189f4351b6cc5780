"""``axistwin tap``: between a program and its device on a serial port, recording both."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Mapping
from typing import Any, Final

import click

from axistwin.cli.output import EXIT_USAGE
from axistwin.errors import PortError

_HELP: Final = {
    "pty": "Link for the program to open.",
    "baud": "Rate of PORT until the program sets one on the link.",
    "parity": "Parity of PORT; a pty does not show what the program sets.",
}


@click.command(epilog="Exit status: 0 ended by Ctrl-C, 2 wrong usage, or PORT or FILE has failed.")
@click.argument("place", metavar="PORT")
@click.argument("capture", metavar="FILE")
@click.option(
    "--pty", "link", default="./tap", show_default=True, metavar="LINK", help=_HELP["pty"]
)
@click.option(
    "--baud",
    type=click.IntRange(1, 4_000_000),
    default=9600,
    show_default=True,
    metavar="N",
    help=_HELP["baud"],
)
@click.option(
    "--parity",
    type=click.Choice(["none", "even", "odd"]),
    default="none",
    show_default=True,
    help=_HELP["parity"],
)
def tap(place: str, capture: str, link: str, baud: int, parity: str) -> int:
    """Record what a program and a device on a serial port say to each other.

    PORT is a serial port, a pty of 'axistwin run', or any URL of pyserial.  The program opens LINK
    in its place; rate and stop bits that it sets are set on PORT.  Everything is appended to FILE
    before it is passed on.  'axistwin decode' shows FILE in words, 'axistwin replay' compares it
    with a twin.

    \b
    axistwin tap /dev/ttyUSB0 capture.txt
    axistwin tap ./mac23 capture.txt --pty ./recorded
    """
    import serial

    from axistwin.cli.run.serving import stop_signals
    from axistwin.cli.tap.line import READ_S, LineTap, TapFile
    from axistwin.runtime.serving.loop import Loop

    losses: list[str] = []

    def lose(reason: str) -> None:
        losses.append(reason)
        click.echo(
            f"axistwin: capture {capture}: cannot be written any more ({reason}); recording has "
            "ended, bytes are still passed on",
            err=True,
        )

    def tell(event: Mapping[str, object]) -> None:
        if event.get("dropped_bytes"):
            click.echo(
                f"axistwin: the program did not read {event['dropped_bytes']} bytes", err=True
            )

    settings: dict[str, Any] = {"baudrate": baud, "parity": parity[0].upper(), "timeout": READ_S}
    with contextlib.closing(Loop()) as loop, contextlib.closing(TapFile(capture, lose)) as file:
        loop.install_signal_handlers(stop_signals())
        try:
            port = serial.serial_for_url(place, **settings)
        except (OSError, ValueError) as error:  # pyserial's are
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            if number == errno.EACCES:
                reason += "; 'axistwin doctor' names the remedy"
            raise PortError(f"{place}: {reason}") from None
        with port:
            line = LineTap(port, link, file, loop, tell)
            line.run(lambda: click.echo(f"ready tap {line.pty.describe()} -> {place}, {capture}"))
    return EXIT_USAGE if losses else 0
