"""The two ways a device hangs on, in the words of the command line: a byte line and a CAN bus."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from axistwin_conformance.base.errors import UsageError, with_article
from axistwin_conformance.transport.can_frame import unpack_all

HOST_AND_PORT = re.compile(r"[\w.-]+:\d+|\[[0-9a-fA-F:]+\]:\d+")


def in_hex(data: bytes) -> str:
    """Bytes as people read them."""
    return data.hex(" ").upper()


@dataclass(frozen=True, slots=True)
class TransportKind:
    """How a kind of device is reached, and what that is called.

    `word`: what modules share; `option` and `rate_option`: where it is and how fast, on the command
    line; `metavar` and `example`: of what stands behind `option`; `twin`: how that begins
    for a twin in this process.
    """

    word: str
    option: str
    rate_option: str
    metavar: str
    example: str
    twin: str

    def spell(self, data: bytes) -> str:
        """What was said, as reports show it: bytes in hex, frames as candump's log has them."""
        if self.word == "line":
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
)
TRANSPORT_KINDS: Final = (LINE, BUS)


def choose_endpoint(
    kind: TransportKind,
    model: str,
    endpoints: Mapping[str, str | None],
    rates: Mapping[str, int | None],
) -> tuple[str | None, int | None]:
    """What was given of where and how fast, by option; raises UsageError for what the model's way
    does not have."""
    where = f"{with_article(model)} is on a {kind.word}"
    for other in TRANSPORT_KINDS:
        if other is kind:
            continue
        if endpoints[other.option] is not None:
            raise UsageError(
                f"{other.option} {endpoints[other.option]}: {where}:"
                f" {kind.option} {kind.metavar}, for instance {kind.option} {kind.example}"
            )
        if rates[other.rate_option] is not None:
            raise UsageError(
                f"{other.rate_option} {rates[other.rate_option]}: {where};"
                f" its rate is {kind.rate_option}"
            )
    endpoint = endpoints[kind.option]
    if endpoint is not None:
        check_endpoint(kind, endpoint, rates[kind.rate_option])
    return endpoint, rates[kind.rate_option]


def check_endpoint(kind: TransportKind, endpoint: str, rate: int | None) -> None:
    """Raise UsageError for what cannot be meant; whether it is there, shows when it is opened."""
    if kind is BUS:
        from axistwin_conformance.transport.can import check_interface

        check_interface(endpoint, rate)
    elif HOST_AND_PORT.fullmatch(endpoint) and not Path(endpoint).exists():
        raise UsageError(
            f"--port {endpoint} is no device; a line over TCP is --port socket://{endpoint}"
        )
    else:
        from axistwin_conformance.transport.serial import check_url

        check_url(endpoint)
