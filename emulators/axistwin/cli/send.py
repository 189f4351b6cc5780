"""``axistwin send``: one command in words or bytes, and the reply in words."""

from __future__ import annotations

import errno
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any

import click

from axistwin import catalog
from axistwin.cli.decode import READERS
from axistwin.devices.words import spaced
from axistwin.errors import PortError, UsageError

if TYPE_CHECKING:
    from axistwin.devices.family import Model
    from axistwin.wire.can_frame import CanFrame

EXIT_SILENT = 1

BAUD_MAX = 4_000_000
LONGEST_WAIT_S = 86_400
WAIT = re.compile(r"wait (?P<number>\d+(?:\.\d+)?) ?(?P<unit>ms|s)")
"""A pause in place of a command."""

BROADCASTS = frozenset({0x000, 0x080})
"""Identifiers of network management and SYNC (CiA 301)."""

SHORTEST_S = 1e-6
"""Of a pause: less is lost in rounding."""

UNASKED_BYTES = 4096
"""More than a device says by itself in a pause."""

GAP_S = 0.3
"""A silence within a reply, at most: an MSC takes its time behind its ACK."""


@click.command(
    epilog="Exit status: 0 every command got a reply, 1 one did not, 2 wrong usage.  "
    "To find the words of a request, give its bytes to 'axistwin decode'."
)
@click.argument("port")
@click.argument("texts", metavar="COMMAND...", nargs=-1, required=True)
@click.option(
    "--model", "name", metavar="MODEL", help="Model of the device (default: by PORT's name)."
)
@click.option(
    "--address", type=int, metavar="N", help="Address of the device (default: the model's)."
)
@click.option(
    "--baud",
    type=click.IntRange(1, BAUD_MAX),
    metavar="N",
    help="Rate of the line or bus (default: the model's).",
)
@click.option(
    "--timeout",
    "timeout_s",
    type=click.FloatRange(0.001, 3600),
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Longest wait for a reply.",
)
def send(
    port: str,
    texts: tuple[str, ...],
    name: str | None,
    address: int | None,
    baud: int | None,
    timeout_s: float,
) -> int:
    """Send commands in words or bytes, and show the replies in words.

    PORT is a serial port, a pty of 'axistwin run', or any URL of pyserial; for a CAN bus,
    INTERFACE:CHANNEL of python-can.

    COMMAND is one of: words, as 'axistwin decode' shows them, or shorter; an index such as 20h,
    with or without a value; bytes in hex; a frame as cansend takes it; a pause such as
    'wait 350 ms'.  A missing checksum is added; all other bytes are sent as they are, wrong
    ones too.

    \b
    axistwin send ./mac23 'go to 125'
    axistwin send ./mac23 20h '13h 125' 'position? -> module 5'
    axistwin send ./msc-250 RQSTAT 'SFLAG 200'
    axistwin send slcan:./mac23-can 'status?' '601#4000200000000000'
    axistwin send /dev/ttyUSB0 --model mac34-1 '02 30 31 34 30 30 32 30 ...'
    """
    model, place = find_device(port, name)
    if address is None:
        address = _address(port, model)
    requests = [request_of(model, address, text) for text in texts]
    is_answered = True
    for request, reply in exchanges(model, place, requests, baud, timeout_s):
        click.echo(
            f"> wait {request:g} s" if isinstance(request, float) else row_of(model, ">", request)
        )
        for part in reply:
            click.echo(row_of(model, "<", part))
        if not reply and _is_asked(request):
            click.echo(f"< nothing within {timeout_s:g} s")
            is_answered = False
    return 0 if is_answered else EXIT_SILENT


def row_of(model: Model, arrow: str, content: bytes | CanFrame) -> str:
    """What was said, and what it means."""
    shown = spaced(content) if isinstance(content, bytes) else str(content)
    return f"{arrow} {shown}  {model.explain(content)}".rstrip()


def request_of(model: Model, address: int, text: str) -> bytes | CanFrame | float:
    """What ``text`` says; a pause as its seconds.  Raises UsageError."""
    if pause := WAIT.fullmatch(text):
        seconds = float(pause["number"]) / (1000 if pause["unit"] == "ms" else 1)
        if seconds > LONGEST_WAIT_S:
            raise UsageError(f"{text[:40]}: a pause has at most {LONGEST_WAIT_S} s")
        return seconds
    found = READERS[model.carrier](text)
    if found is not None and found.content is not None:
        content = found.content
        return model.family.completed(content) if isinstance(content, bytes) else content
    request: bytes | CanFrame = model.family.compose(text, address)
    return request


# -- what is there -----------------------------------------------------------------------------


def find_device(port: str, name: str | None) -> tuple[Model, str]:
    """The model at ``port``, and where it is; a pty of an slcan adapter as such.

    Raises UsageError.
    """
    if "://" not in port and not _is_on_can(port) and not os.access(port, os.F_OK):
        remedy = f"start a twin there: axistwin run MODEL --pty {port}"
        if port.startswith("/dev/"):
            remedy = "is the adapter plugged in? 'axistwin doctor' lists the serial ports"
        raise UsageError(f"{port} does not exist; {remedy}")
    guess = _named_in(port)
    if name is None and guess is None:
        known = [model.name for model in catalog.models().values()]
        raise UsageError(
            f"{port}: which device is there? add --model MODEL ({', '.join(known)}); "
            f"of an slcan adapter, write slcan:{port}"
        )
    model = catalog.find_model(name) if name is not None else guess
    assert model is not None
    if model.carrier != "can" or _is_on_can(port):
        return model, port
    return model, f"slcan:{port}"


def _named_in(port: str) -> Model | None:
    """The model that ``port`` is called after."""
    models = catalog.models()
    on_can = _is_on_can(port)
    place = port.partition(":")[2] if on_can else port.removeprefix("axistwin://")
    words = re.split(r"[?:,]", place.rpartition("/")[2])[0]
    fitting = [each for each in models.values() if each.carrier == "can" or not on_can]
    for model in sorted(fitting, key=lambda each: -len(each.name)):
        if words.startswith(model.name):
            return model
    for model in fitting:
        if words and model.name.startswith(words):
            return model
    return next((each for each in fitting if on_can and each.carrier == "can"), None)


def _is_on_can(port: str) -> bool:
    """Whether ``port`` is a channel of an interface of python-can."""
    interface, colon, _ = port.partition(":")
    if not colon or "://" in port or not interface.isidentifier():
        return False
    from can.interfaces import BACKENDS

    return interface in BACKENDS


def _address(port: str, model: Model) -> int:
    """The first device's in a URL or channel of ours, else the model's default."""
    from axistwin.urlhandler.url import SCHEME, parse_url

    if port.startswith(SCHEME) and (devices := parse_url(port).options.devices):
        return catalog.parse_device(devices[0]).address
    if port.startswith("axistwin:") and port.count(":") > 1:
        return catalog.parse_device(port.split(":", 1)[1].partition("?")[0].split(",")[0]).address
    return model.default_address


# -- the exchange ------------------------------------------------------------------------------


def exchanges(
    model: Model,
    place: str,
    requests: Iterable[Any],
    baud: int | None,
    timeout_s: float,
    is_whole: Callable[[bytes], bool] | None = None,
) -> Iterator[tuple[Any, list[Any]]]:
    """Each of ``requests`` with what came back: nothing, if nothing did within ``timeout_s``.

    baud: of the line or bus, the model's own unless given.  is_whole: whether a reply on a line is
    complete, asked in place of the family.  Raises PortError.
    """
    rate = baud or model.default_baud
    if model.carrier == "can":
        return _over_can(model, place, requests, rate, timeout_s)
    return _over_line(model, place, requests, rate, timeout_s, is_whole or model.family.is_whole)


def _over_line(
    model: Model,
    place: str,
    requests: Iterable[Any],
    baud: int,
    timeout_s: float,
    is_whole: Callable[[bytes], bool],
) -> Iterator[tuple[bytes | float, list[bytes]]]:
    """Each of ``requests`` with what came back.  Raises PortError."""
    import serial

    import axistwin  # noqa: F401 - the URL

    try:
        with serial.serial_for_url(place, baudrate=baud, timeout=timeout_s) as port:
            port.reset_input_buffer()
            for request in requests:
                if isinstance(request, float):
                    port.timeout = request
                    yield request, [said] if (said := port.read(UNASKED_BYTES)) else []
                    continue
                port.write(request)
                port.timeout = timeout_s
                reply = bytearray()
                while byte := port.read(1):
                    reply += byte
                    port.timeout = GAP_S
                    if thanks := model.family.acknowledgement(bytes(reply)):
                        port.write(thanks)
                        port.flush()
                        break
                    if is_whole(bytes(reply)):
                        break
                yield request, [bytes(reply)] if reply else []
    except (serial.SerialException, OSError) as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        if error.errno == errno.EACCES:
            reason += "; 'axistwin doctor' names the remedy"
        raise PortError(f"{place}: {reason}") from None


def _is_asked(request: bytes | CanFrame | float) -> bool:
    """Whether something answers to it: not to a pause, nor to what is said to a whole bus."""
    if isinstance(request, float):
        return False
    return isinstance(request, bytes) or request.identifier not in BROADCASTS


def _pause(bus: Any, seconds: float) -> Iterator[Any]:
    """Let so much time of ``bus`` pass, and give what is said meanwhile."""

    def now_s() -> float:
        virtual_ns = getattr(bus, "virtual_time_ns", None)
        return time.monotonic() if virtual_ns is None else virtual_ns / 1e9

    end_s = now_s() + seconds
    while (left_s := end_s - now_s()) > SHORTEST_S:
        if (message := bus.recv(left_s)) is not None:
            yield message


def _over_can(
    model: Model, place: str, requests: Iterable[Any], bitrate: int, timeout_s: float
) -> Iterator[tuple[CanFrame | float, list[CanFrame]]]:
    """Each of ``requests`` with what came back.  Raises PortError."""
    import can

    from axistwin.ports.can_message import frame_of, message_of

    interface, _, channel = place.partition(":")
    settings: dict[str, Any] = {"bitrate": bitrate} if interface in ("slcan", "axistwin") else {}
    if interface == "slcan":
        settings["sleep_after_open"] = 0.0
    try:
        with can.Bus(interface=interface, channel=channel, **settings) as bus:
            for request in requests:
                replies: list[CanFrame] = []
                if isinstance(request, float):
                    yield request, [frame_of(message) for message in _pause(bus, request)]
                    continue
                bus.send(message_of(request))
                while (
                    _is_asked(request)
                    and not replies
                    and (message := bus.recv(timeout_s)) is not None
                ):
                    if message.is_error_frame or message.is_fd:
                        continue
                    frame = frame_of(message)
                    if model.family.is_reply(request, frame):
                        replies.append(frame)
                yield request, replies
    except (can.CanError, OSError, ValueError) as error:
        raise PortError(f"{place}: {error}") from None
