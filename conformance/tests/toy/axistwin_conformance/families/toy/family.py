"""A lamp on a line: how it is opened, asked, and left as it was found."""

from __future__ import annotations

from typing import ClassVar, Final

from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.base.transcript import Record
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.session import REPLY_TIMEOUT_S, Session
from axistwin_conformance.transport.rig import POWER, RigControl, rig_controls
from axistwin_conformance.transport.serial import SerialTransport, open_target

RATE: Final = 9600
DO: Final = ("Press the button.", "")
DONE: Final = ("the button was pressed", "")
PRESS: Final = RigControl("press", "button", "presses the button", DO, DONE, "press", is_step=True)


class Lamp:
    """A lamp as checks and probes handle it."""

    def __init__(self, session: Session) -> None:
        self.session = session

    def _exchange(self, request: bytes, size: int) -> bytes:
        self.session.target.send(request)
        return self.session.target.receive(size, REPLY_TIMEOUT_S)

    def level(self) -> str:
        """Ask for the level: a digit and a line feed; empty if nothing comes."""
        return self._exchange(b"?\n", 2).decode("ascii", "replace")

    def set_level(self, level: int) -> str:
        """Set the level; return what acknowledges it."""
        return self._exchange(b"=%d\n" % level, 1).decode("ascii", "replace")

    def switch_off_and_on(self) -> None:
        """Cut the supply for a moment."""
        self.session.rig.work("power", False)
        self.session.rig.work("power", True)


class ToyFamily(Family):
    """Lamps."""

    name = "toy"
    models: ClassVar = {"toy": Model("toy", "a lamp")}
    addresses = range(1)
    default_address = 0
    default_rate = RATE
    rates = (RATE,)
    rig_controls = rig_controls(PRESS, POWER)
    impact: ClassVar = {"stored": "sets the level", "rig": "cuts the supply"}

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> SerialTransport:
        """Open a port."""
        return open_target(url, rate or RATE, is_builtin=is_builtin)

    def explain(self, record: Record) -> str:
        """Lines are words already."""
        return record.data.decode("ascii", "replace").strip()

    def driver(self, session: Session, address: int | None = None) -> Lamp:
        """The lamp on the line."""
        return Lamp(session)

    def identify(self, session: Session) -> Identity:
        """Ask for the level."""
        level = Lamp(session).level()
        if not level:
            raise TargetError("no lamp answers")
        if not level[0].isdigit():
            raise WrongDevice(f"no lamp: it answers {level!r}")
        return Identity(f"a lamp at level {level[0]}")

    def is_alive(self, session: Session) -> bool:
        """Ask for the level."""
        return Lamp(session).level()[:1].isdigit()

    def stop(self, session: Session) -> None:
        """A lamp does not move."""

    def remember(self, session: Session) -> str:
        """Read the level."""
        return Lamp(session).level()[:1]

    def restore(self, session: Session, memory: str) -> tuple[str, ...]:
        """Set the level that it had."""
        lamp = Lamp(session)
        if lamp.level()[:1] != memory:
            lamp.set_level(int(memory))
        return () if lamp.level()[:1] == memory else (f"level {memory}",)


FAMILY: Final = ToyFamily()
