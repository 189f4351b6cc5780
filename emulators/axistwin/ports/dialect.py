"""What a CAN port's protocol looks like to the port that carries its bytes.

A dialect is a pure state machine for one client: bytes in, bytes and frames out.  It reads no clock
and does no IO; whoever serves the client passes on what comes and tells the time.
"""

from abc import ABC, abstractmethod
from enum import IntFlag
from typing import TypeAlias

from axistwin.kernel.time import Nanos
from axistwin.wire.can_frame import CanFrame

Out: TypeAlias = bytes | CanFrame
"""Bytes for the client, or a frame for the bus; in the order in which they arose."""


class BusError(IntFlag):
    """What went wrong on the bus: the error classes of Linux (``linux/can/error.h``)."""

    CONTROLLER = 0x004
    """The client's own controller became error-passive."""
    PROTOCOL = 0x008
    NO_ACKNOWLEDGE = 0x020
    BUS_OFF = 0x040
    """The client's own controller left the bus."""
    BUS_ERROR = 0x080
    RESTARTED = 0x100
    """The client's own controller is error-active again."""


class CanDialect(ABC):
    """One client's conversation.

    is_closing: the conversation is over; hang up when the client has got what it is owed.
    """

    is_closing: bool = False

    def __init__(self) -> None:
        self._trouble: str | None = None
        self._on_the_way = 0  # frames handed out that have not been on the bus yet

    @property
    def acknowledges(self) -> bool:
        """Whether its controller acknowledges frames just now: not one that is closed."""
        return True

    def greeting(self) -> bytes:
        """What a client is sent before it says anything."""
        return b""

    @abstractmethod
    def receive(self, data: bytes, now_ns: Nanos) -> list[Out]:
        """What follows from ``data`` of the client, cut up in any way; never raises."""

    @abstractmethod
    def deliver(self, frame: CanFrame, time_ns: Nanos) -> bytes:
        """What the client gets of another station's ``frame`` that was complete at ``time_ns``."""

    @abstractmethod
    def deliver_error(self, error: BusError, time_ns: Nanos) -> bytes:
        """What the client gets of an error at ``time_ns``."""

    def overrun(self) -> None:  # noqa: B027 - most have no words for it
        """Something for the client was lost, because it does not read."""

    def sent(self) -> None:
        """The frame that was handed out longest ago has been on the bus, or is given up."""
        assert self._on_the_way, "a frame was sent that was not handed out"
        self._on_the_way -= 1

    def next_event(self) -> Nanos | None:
        """When ``wake`` has something to do; None: nothing happens by itself."""
        return None

    def wake(self, now_ns: Nanos) -> list[Out]:
        """What is due by ``now_ns``."""
        return []

    def take_trouble(self) -> str | None:
        """The latest mistake of the client that its own protocol has no words for; once.

        One line for whoever runs the bus: the value, what would be right and the remedy.
        """
        trouble, self._trouble = self._trouble, None
        return trouble
