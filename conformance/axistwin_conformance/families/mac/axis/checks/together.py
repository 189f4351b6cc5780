"""Several axes at once: started together, and kept in step (MULTI)."""

from __future__ import annotations

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 190  # of this module in a run; see `Family.modules`


def everybody(session: Session) -> list[AxisDriver]:
    """The module under test and its neighbours."""
    return [driver_of(session, address) for address in (session.address, *session.neighbours)]


@check("MACS-MULTI-02", "MACS-CMD-11-01", safety=MOVES, needs=("neighbour",))
def one_11h_starts_all_preloaded_axes_together(session: Session) -> None:
    """10h and 13h to each module, 11h to all: they start on the same frame."""
    axes = everybody(session)
    starts = [driver.motion.ready(0x2000) for driver in axes]
    try:
        for driver, start in zip(axes, starts, strict=True):
            driver.judge.accepted(0x10)
            driver.judge.accepted(0x13, start + 200)
        sync = axes[0].client.send(axes[0].client.to_all(0x11), QUIET_S * 2)
        for driver, start in zip(axes, starts, strict=True):
            forecast = driver.motion.to_position(sync, start, start + 200)
            driver.motion.follow(
                forecast, ("MACS-MULTI-02", "MACS-CMD-11-01"), driver.limits.allowance(0x2000)
            )
        for driver, start in zip(axes, starts, strict=True):
            driver.motion.finish(
                driver.motion.to_position(sync, start, start + 200),
                ("MACS-MULTI-02", "MACS-CMD-11-01"),
            )
    finally:
        _all_back(axes, starts)


@check("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01", safety=MOVES, needs=("neighbour",))
def axes_keep_step_through_virtual_segments(session: Session) -> None:
    """While one axis moves, the other waits the same ticks: afterwards both are in step."""
    axes = everybody(session)[:2]
    starts = [driver.motion.ready() for driver in axes]
    longest = max((driver.limits.segment(40, 0x2000) for driver in axes), key=lambda one: one.steps)
    steps, period = longest.steps, max(driver.limits.outlasting(40, 0x2000) for driver in axes)
    slow = max(period, 0x3000)
    segments = (Segment(steps, period), Segment(30, slow, moves=False), Segment(20, period))
    other = (Segment(steps, period, moves=False), Segment(30, slow), Segment(20, period))
    try:
        forecasts = [
            driver.motion.feed(start, *row)
            for driver, start, row in zip(axes, starts, (segments, other), strict=True)
        ]
        for _ in range(6):
            for driver, forecast in zip(axes, forecasts, strict=True):
                driver.motion.follow(
                    forecast,
                    ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"),
                    driver.limits.allowance(period),
                )
        for driver, forecast in zip(axes, forecasts, strict=True):
            driver.motion.finish(forecast, ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"))
    finally:
        _all_back(axes, starts)


def _all_back(axes: list[AxisDriver], starts: list[int]) -> None:
    for driver, start in zip(axes, starts, strict=True):
        driver.motion.at_rest()
        driver.motion.finish(driver.motion.go_plainly(start))
