"""A module on the bus, as checks handle it."""

from __future__ import annotations

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.can.client import CanClient


class CanDriver(AxisDriver):
    """One module on the bus."""

    client: CanClient

    def __init__(self, session: Session, address: int | None = None) -> None:
        super().__init__(CanClient(session, address))
