"""How devices are reached, in the words of the command line: a byte line, a CAN bus, USB HID."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from axistwin_conformance.base.errors import UsageError, with_article
from axistwin_conformance.base.line_quality import MOST_NOISE
from axistwin_conformance.transport.can_frame import unpack_all

HOST_AND_PORT = re.compile(r"[\w.-]+:\d+|\[[0-9a-fA-F:]+\]:\d+")


def in_hex(data: bytes) -> str:
    """Bytes as people read them."""
    return data.hex(" ").upper()


@dataclass(frozen=True, slots=True)
class TransportKind:
    """How a kind of device is reached, and what that is called.

    `word`: what modules share; `option` and `rate_option`: where it is and how fast, on the command
    line, empty where there is no rate; `metavar` and `example`: of what stands behind `option`;
    `twin`: how that begins for a twin in this process, empty where there is none.  `most_noise`:
    the largest share of exchanges that is taken for corrupted on the way.
    """

    word: str
    option: str
    rate_option: str
    metavar: str
    example: str
    twin: str
    most_noise: float = MOST_NOISE

    def spell(self, data: bytes) -> str:
        """What was said, as reports show it: bytes in hex, frames as candump's log has them."""
        if self.word != "bus":
            return in_hex(data)
        return " ".join(frame.candump for frame in unpack_all(data))

    def twin_url(self, model: str, address: int, neighbours: tuple[int, ...]) -> str:
        """The built-in twin, in virtual time, with its neighbours on one line or bus."""
        devices = ",".join(f"{model}:{each}" for each in (address, *neighbours))
        return f"{self.twin}{devices}?time=virtual"

    @property
    def rate_parameter(self) -> str:
        """What the URL of a twin calls the rate."""
        return self.rate_option.removeprefix("--")


LINE: Final = TransportKind("line", "--port", "--baud", "URL", "/dev/ttyUSB0", "axistwin://")
BUS: Final = TransportKind(
    "bus",
    "--can",
    "--bitrate",
    "INTERFACE:CHANNEL",
    "socketcan:can0 or --can slcan:/dev/ttyACM0",
    "axistwin:",
    most_noise=0.1,  # a controller sends again what was corrupted; an adapter may lose a few
)
HID: Final = TransportKind("USB", "--hid", "", "PATH", "/dev/hidraw0", "")
TRANSPORT_KINDS: Final = (LINE, BUS, HID)


def choose_endpoint(
    kinds: Sequence[TransportKind],
    model: str,
    endpoints: Mapping[str, str | None],
    rates: Mapping[str, int | None],
) -> tuple[TransportKind, str | None, int | None]:
    """How a device of a model is reached, of the `kinds` that it has, where and how fast, of what
    was given by option; raises UsageError for what does not go with the model or with the rest."""
    named = [other for other in TRANSPORT_KINDS if endpoints.get(other.option) is not None]
    usual = kinds[0]
    kind = next((other for other in named if other in kinds), usual)
    where = f"{with_article(model)} is on a {usual.word}"
    for other in named:
        if other not in kinds:
            raise UsageError(
                f"{other.option} {endpoints[other.option]}: {where}:"
                f" {usual.option} {usual.metavar}, for instance {usual.option} {usual.example}"
            )
        if other is not kind:
            raise UsageError(f"{kind.option} and {other.option}: judge it over one of them")
    for option, rate in rates.items():
        if rate is None or option == kind.rate_option:
            continue
        if not kind.rate_option:
            raise UsageError(f"{option} {rate}: {kind.word} has no rate; leave it out")
        raise UsageError(f"{option} {rate}: {where}; its rate is {kind.rate_option}")
    endpoint, rate = endpoints.get(kind.option), rates.get(kind.rate_option)
    if endpoint is not None:
        check_endpoint(kind, endpoint, rate)
    return kind, endpoint, rate


def check_endpoint(kind: TransportKind, endpoint: str, rate: int | None) -> None:
    """Raise UsageError for what cannot be meant; whether it is there, shows when it is opened."""
    if kind is BUS:
        from axistwin_conformance.transport.can import check_interface

        check_interface(endpoint, rate)
    elif kind is HID:
        if "://" in endpoint:
            raise UsageError(f"--hid {endpoint} is a URL: write a path such as {kind.example}")
    elif HOST_AND_PORT.fullmatch(endpoint) and not Path(endpoint).exists():
        raise UsageError(
            f"--port {endpoint} is no device; a line over TCP is --port socket://{endpoint}"
        )
    else:
        from axistwin_conformance.transport.serial import check_url

        check_url(endpoint)
