"""What a device wants done, as values.  The device decides; a shell performs.

Effects are performed strictly in the order given.  That order carries a promise: a durable
``Store`` in front of a ``Transmit`` is on disk before the first bit of the acknowledgement leaves.

Some are made for every answer: named tuples take a third of a frozen dataclass's time.
"""

from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

from axistwin.kernel.time import Nanos


class Transmit(NamedTuple):
    """Send ``data`` on the device's line, first start bit at ``start_ns`` at the earliest."""

    start_ns: Nanos
    data: bytes


Frame = TypeVar("Frame", covariant=True)
"""What is sent as a whole (``wire.can_frame.CanFrame``); the kernel does not look into it."""


class SendFrame(NamedTuple, Generic[Frame]):
    """Let the device's bus controller send ``frame``, at ``start_ns`` at the earliest.

    Frames of one device keep their order.
    """

    start_ns: Nanos
    frame: Frame


@dataclass(frozen=True, slots=True)
class Silence:
    """Send nothing more of what was to be sent.

    A byte on a serial line breaks off; a frame on a bus is finished by the controller.
    """


class Store(NamedTuple):
    """Write nonvolatile ``cells`` (name, value); ``durable`` ones must reach the disk at once.

    A cell that is not durable (the position counter, saved by the hardware when the supply fails)
    is handed to the operating system, which keeps it when this process is killed.
    """

    cells: tuple[tuple[str, int], ...]
    durable: bool = True


@dataclass(frozen=True, slots=True)
class Trace:
    """Something worth telling happened at ``time_ns``; each kind of it is a class of its own."""

    time_ns: Nanos


Effect: TypeAlias = Transmit | SendFrame[Any] | Silence | Store | Trace
