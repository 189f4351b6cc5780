"""The host-side driver of one axis: one part for each job."""

from __future__ import annotations

from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import AxisClient
from axistwin_conformance.families.mac.axis.driver.judge import AxisJudge
from axistwin_conformance.families.mac.axis.driver.limits import AxisLimits
from axistwin_conformance.families.mac.axis.driver.motion import AxisMotion
from axistwin_conformance.families.mac.axis.driver.readings import AxisReadings
from axistwin_conformance.families.mac.axis.driver.rig import AxisRig
from axistwin_conformance.families.mac.axis.driver.status import AxisStatus


class AxisDriver:
    """One module, as checks handle it.

    `client`: exchanges.  `judge`: what replies are held to.  `readings`: which readings of the
    manual it has shown.  `limits`: what it may be asked for.  `status`: what its answers say.
    `motion`: settings, motions, forecasts.  `rig`: what the rig around it does.
    """

    def __init__(self, client: AxisClient) -> None:
        self.client = client
        self.session = client.session
        self.judge = AxisJudge(client)
        self.readings = AxisReadings(client.session)
        self.limits = AxisLimits(client, self.readings)
        self.status = AxisStatus(client)
        self.motion = AxisMotion(client, self.judge, self.readings, self.limits)
        self.rig = AxisRig(client, self.judge, self.readings, self.limits, self.status, self.motion)


def driver_of(session: Session, address: int | None = None) -> AxisDriver:
    """A module of the family under test, this one or that at an address, as its face handles it."""
    driver = session.run.family.driver(session, address)
    assert isinstance(driver, AxisDriver)
    return driver
