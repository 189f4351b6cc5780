"""What a command is, on its way from a port to what obeys it, and its answer on the way back."""

from collections.abc import Sequence
from enum import Enum
from functools import cache
from typing import NamedTuple, Protocol

from axistwin.devices.mn400.link.packets import ReturnCode
from axistwin.devices.mn400.link.sender import Reply, ReplyPart
from axistwin.kernel.time import Nanos


class Origin(Enum):
    """Where a line comes from."""

    SERIAL = "serial line"
    USB = "USB"
    CONFIG = "configuration program"
    PROGRAM = "user program"
    PANEL = "control panel"


class Port(Protocol):
    """What commands change of the ports."""

    address: int

    def set_rate(self, number: int) -> None:
        """Change the rate of the serial line, 0..4."""

    def last_message(self, origin: Origin) -> Reply | None:
        """What was sent last on the port of ``origin``."""


class Answer(NamedTuple):
    """The answer to a line; code: how it ended."""

    parts: Sequence[ReplyPart]
    code: ReturnCode = ReturnCode.DONE


class BoardLine(NamedTuple):
    """A line that is being judged: its command, what follows it, and where it comes from."""

    now: Nanos
    command: int
    text: bytes
    raw: bytes
    origin: Origin
    is_for_all: bool = False


@cache
def status_part(address: int, command: int, code: ReturnCode) -> ReplyPart:
    """A status packet, which says the same whenever it is sent."""
    return ReplyPart(Reply(address, command, code))


@cache
def started(address: int, command: int, code: ReturnCode) -> Answer:
    """START and ``code``: most answers."""
    start = status_part(address, command, ReturnCode.START)
    return Answer((start, status_part(address, command, code)), code)
