"""Several axes at once: started together, and kept in step (MULTI)."""

from __future__ import annotations

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.motion import QUIET_S, Bench, bench_of
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 190  # of this module in a run; see `Family.modules`


def everybody(session: Session) -> list[Bench]:
    """The module under test and its neighbours."""
    return [bench_of(session, address) for address in (session.address, *session.neighbours)]


@check("MACS-MULTI-02", "MACS-CMD-11-01", safety=MOVES, needs=("neighbour",))
def one_11h_starts_all_preloaded_axes_together(session: Session) -> None:
    """10h and 13h to each module, 11h to all: they start on the same frame."""
    axes = everybody(session)
    starts = [bench.ready(0x2000) for bench in axes]
    try:
        for bench, start in zip(axes, starts, strict=True):
            bench.accepted(0x10)
            bench.accepted(0x13, start + 200)
        sync = axes[0].send(axes[0].to_all(0x11), QUIET_S * 2)
        for bench, start in zip(axes, starts, strict=True):
            forecast = bench.to_position(sync, start, start + 200)
            bench.follow(forecast, ("MACS-MULTI-02", "MACS-CMD-11-01"), bench.allowance(0x2000))
        for bench, start in zip(axes, starts, strict=True):
            bench.finish(
                bench.to_position(sync, start, start + 200), ("MACS-MULTI-02", "MACS-CMD-11-01")
            )
    finally:
        _all_back(axes, starts)


@check("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01", safety=MOVES, needs=("neighbour",))
def axes_keep_step_through_virtual_segments(session: Session) -> None:
    """While one axis moves, the other waits the same ticks: afterwards both are in step."""
    axes = everybody(session)[:2]
    starts = [bench.ready() for bench in axes]
    one = (Segment(40, 0x2000), Segment(30, 0x3000, moves=False), Segment(20, 0x2000))
    other = (Segment(40, 0x2000, moves=False), Segment(30, 0x3000), Segment(20, 0x2000))
    try:
        forecasts = [
            bench.feed(start, *row)
            for bench, start, row in zip(axes, starts, (one, other), strict=True)
        ]
        for _ in range(6):
            for bench, forecast in zip(axes, forecasts, strict=True):
                bench.follow(
                    forecast,
                    ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"),
                    bench.allowance(0x2000),
                )
        for bench, forecast in zip(axes, forecasts, strict=True):
            bench.finish(forecast, ("MACS-MULTI-02", "MACS-CMD-1E-01", "MACS-CMD-16-01"))
    finally:
        _all_back(axes, starts)


def _all_back(axes: list[Bench], starts: list[int]) -> None:
    for bench, start in zip(axes, starts, strict=True):
        bench.at_rest()
        bench.finish(bench.go_plainly(start))
