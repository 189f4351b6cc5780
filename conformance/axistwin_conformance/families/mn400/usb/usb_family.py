"""What the engine must know of the MN400 on USB beside its checks.

What is judged is what the manual says of USB (MN4-USB-01 to -08): the checks of everything else are
those of packets, on the serial line.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import Effect, Exchange
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.codec import ReturnCode
from axistwin_conformance.families.mn400.safety import danger
from axistwin_conformance.families.mn400.usb.driver import (
    PRODUCT,
    VENDOR,
    UsbDriver,
    report_words,
    text_in,
)
from axistwin_conformance.families.mn400.words import command_words
from axistwin_conformance.transport.hid import HidTransport, open_hid
from axistwin_conformance.transport.kinds import HID

MODEL: Final = Model("mn400", "MN400 4-axis motion controller, on USB")
QUERIES: Final = "/?SNE[:*R&"


class Mn400Usb(Family):
    """MN400 boards on USB.  The address is what one goes back to that was changed (MN4-USB-07)."""

    name = "mn400"
    models: ClassVar = {MODEL.name: MODEL}
    addresses = codec.IDS
    default_address = 1
    transport_kind = HID
    impact: ClassVar = {
        "destructive": "changes the address (=)",
        "end": "counters that were changed are put back",
    }

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> HidTransport:
        """Open a node."""
        return open_hid(url)

    def explain(self, record: Record) -> str:
        """Put a report into words."""
        if record.direction is Direction.HOST:
            return command_words(text_in(record.data))
        return report_words(record.data)

    def in_words(self, request: bytes, reply: bytes) -> Exchange:
        """Put an exchange into the words of a failure."""
        text = text_in(request)
        effect = Effect.NOTHING if text[:1].upper() in QUERIES else Effect.OTHER
        return Exchange(command_words(text), effect)

    def driver(self, session: Session, address: int | None = None) -> UsbDriver:
        """The board."""
        return UsbDriver(session)

    def identify(self, session: Session) -> Identity:
        """Poll the board and ask for its firmware; nothing is sent to what has neither its vendor's
        nor its own number."""
        driver = UsbDriver(session)
        found = driver.transport.identity
        if found.vendor != VENDOR and found.product != PRODUCT:
            raise WrongDevice(f"not an MN400: it enumerates as {found}")
        reply = driver.ask("*")
        if reply.code != ReturnCode.PRESENT:
            raise TargetError(f"no MN400 answers so to a poll on USB: {reply}")
        firmware = driver.ask("?").value_of("?")
        if firmware is not None and not firmware.startswith("MN"):
            raise WrongDevice(f"not an MN400: it says it is {firmware!r}")
        told = firmware or "unknown"
        return Identity(f"{told}, {found}", {"firmware": told, "usb": str(found)})

    def is_alive(self, session: Session) -> bool:
        """A poll that is answered."""
        return UsbDriver(session).ask("*").code == ReturnCode.PRESENT

    def stop(self, session: Session) -> None:
        """Nothing: what is judged here moves nothing, and a machine that moves is not ours."""

    def remember(self, session: Session) -> tuple[int, ...]:
        """The counters."""
        return UsbDriver(session).position()

    def restore(self, session: Session, memory: tuple[int, ...]) -> tuple[str, ...]:
        """Load the counters; each check has put back what it has set beside."""
        driver = UsbDriver(session)
        if driver.position() == memory:
            return ()
        reply = driver.ask("L" + ",".join(map(str, memory)))
        return () if reply.is_silence else (f"the counters: {reply}",)

    def kept(self, memory: tuple[int, ...]) -> Mapping[str, Any]:
        """The counters."""
        return {"counters": [*memory]}

    def memory_of(self, held: Mapping[str, Any]) -> tuple[int, ...]:
        """The same the other way."""
        return tuple(map(int, held["counters"]))

    def forbid(self, session: Session, data: bytes) -> str | None:
        """Why a report must not be sent: any text in it that a check of its classes must not send,
        whether a board should look at that or not."""
        if session.check is None:
            return None
        for part in data.split(b"\0"):
            text = part.decode("latin-1")
            needed = danger(text, session.address, 0) if text else "passive"
            if needed != "passive" and needed not in session.check.safety:
                return f"{command_words(text)} is {needed}, which this check does not declare"
        return None
