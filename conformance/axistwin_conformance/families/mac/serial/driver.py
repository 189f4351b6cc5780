"""A module on the serial line, as checks handle it."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.serial.client import SerialClient

NACKED_BY_MANY: Final = "every module of the line Nacks here, all at once: ask it alone"


class SerialDriver(AxisDriver):
    """One module on the line."""

    client: SerialClient

    def __init__(self, session: Session, address: int | None = None) -> None:
        super().__init__(SerialClient(session, address))
