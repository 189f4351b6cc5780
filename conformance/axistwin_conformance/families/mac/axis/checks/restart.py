"""Re-initialisation (00h): what it keeps, what it ends; and the counter cleared in a move (0Bh)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.motion import SLOWEST, bench_of, segment
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import (
    RAMP_LEVELS,
    TICK_NS,
    Course,
    ramp_increments,
)
from axistwin_conformance.families.mac.axis.probes.motion import cleared_in_a_move
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 170  # of this module in a run; see `Family.modules`

PARAMETER_QUERIES: Final = (0x22, 0x23, 0x25, 0x26)


@check("MACS-CMD-00-01", "MACS-CMD-18-03", safety=MOVES)
def after_00h_parameters_and_position_are_kept(session: Session) -> None:
    """00h keeps position and stored parameters at rest; sync, preload and stop bits are gone."""
    bench = bench_of(session)
    start = bench.ready(0x1000, 3)
    bench.finish(bench.go(start + 30))
    for index, parameter in (
        (0x09, start + 40), (0x0A, start - 5000), (0x0C, 0x33), (0x0E, 0x0700), (0x1C, 0x02),
        (0x03, 8),
    ):  # fmt: skip
        bench.command(index, parameter)
    bench.accepted(0x13, start + 100)
    bench.wait(0.4 + bench.lasting_s(11 * RAMP_LEVELS))
    bench.run_out()
    before = [bench.value(index) for index in PARAMETER_QUERIES]
    place = bench.position()
    stopped_on = bench.stopped_on()
    bench.command(0x10)
    bench.command(0x13, start)
    bench.reinitialise()
    after = [bench.value(index) for index in PARAMETER_QUERIES]
    modes = 0x0000FFFF  # K, m and TT of 26h: whether they are stored is open (MACS-AMB-24)
    if after[:3] == before[:3] and after[3] & ~modes == before[3] & ~modes:
        bench.reading("persist_modes", int(after != before), "MACS-CMD-00-01")
    else:
        session.fail("MACS-CMD-00-01", _hex(before), _hex(after))
    session.expect(
        bench.position() == place, "MACS-CMD-00-01", f"position {place}", bench.position()
    )
    session.expect(
        bench.stopped_on() == 0 or bench.known("ff_lifetime") == 1,
        "MACS-CMD-00-01", f"ff 00 (was {stopped_on:02X})",
        f"{bench.stopped_on():02X}",
    )  # fmt: skip
    bench.command(0x11)
    bench.wait(0.1)
    session.expect(
        bench.position() == place, ("MACS-CMD-00-01", "MACS-CMD-18-03"),
        "nothing preloaded any more", bench.position(),
    )  # fmt: skip


@check("MACS-CMD-00-01", "MACS-CMD-18-03", safety=MOVES, level="full")
def in_motion_00h_drops_the_motion(session: Session) -> None:
    """00h during a move or segments: the axis stands, nothing resumes or is locked."""
    bench = bench_of(session)
    for begin in ((0x13, 100), (0x16, segment(60, SLOWEST))):
        start = bench.ready(SLOWEST)
        index, parameter = begin
        for _ in range(2):
            bench.command(index, start + parameter if index == 0x13 else parameter)
        bench.wait(0.2)
        bench.reinitialise()
        place = bench.position()
        session.expect(
            abs(place - start) < 60, "MACS-CMD-00-01", "motion dropped", f"{place - start}"
        )
        bench.wait(0.5)
        session.expect(
            bench.position() == place, ("MACS-CMD-00-01", "MACS-CMD-18-03"),
            f"at rest at {place}", bench.position(),
        )  # fmt: skip
        bench.accepted(0x0F, 0, requirement="MACS-CMD-00-01")
        bench.finish(bench.go(start), "MACS-CMD-00-01")


@check("MACS-CMD-0B-02", "MACS-CMD-0B-01", safety=MOVES, level="full")
def clearing_the_counter_during_a_move(session: Session) -> None:
    """0Bh half-way through 13h: the target stays a number, or the remaining distance stays."""
    bench = bench_of(session)
    outcome, _ = cleared_in_a_move(bench)
    assert isinstance(outcome, int | str), "the look tells its readings apart"
    bench.reading("reset_in_motion", outcome, "MACS-CMD-0B-02")
    session.expect(True, "MACS-CMD-0B-01", "", "")


@check("MACS-CMD-0B-01", "MACS-CMD-13-05", safety=MOVES, level="full")
def a_move_whose_counter_is_cleared_on_the_ramp_keeps_to_it(session: Session) -> None:
    """0Bh while the axis climbs: the rest of the way, now longer, is run as if from the start."""
    bench = bench_of(session)
    start, target = bench.ready(SLOWEST, 1), 2 * ramp_increments(1) + 60
    if abs(start) > min(40, bench.room()):
        session.skip("the counter is too far from 0 to be brought back there")
    bench.needs_room(target + ramp_increments(1), "two ramps and some way between them")
    sent = bench.accepted(0x13, target)
    whole = bench.to_position(sent, start, target)
    climb = Course.endless(bench.period, 1, bench.law).profile
    bench.wait_until(sent.taken.latest_ns + climb.ticks_of(ramp_increments(1) // 2) * TICK_NS)
    cleared = bench.accepted(0x0B)
    # A ramp takes as long as 240 increments at full speed; 20 more, and it may be slowing down.
    slowing_ns = sent.taken.earliest_ns + round(bench.lasting_s(240 + 20) * 1e9)
    bench.taken_in_time(cleared, slowing_ns, "the way to where the axis slows down")
    lowest, highest = whole.bounds(cleared.taken)
    keeps_way = bench.known("reset_in_motion") == 1
    ends = [(place, target - place if keeps_way else target) for place in (lowest, highest)]
    onward = Forecast.of(
        timeline
        for place, end in ends
        for timeline in bench.to_position(sent, start - place, end).timelines
    )
    bench.watch(onward, ("MACS-CMD-0B-01", "MACS-CMD-13-05"), samples=6)
    bench.at_rest()
    bench.finish(bench.go(-lowest))  # to one increment: nobody knows the instant better
    bench.accepted(0x0B)


def _hex(values: list[int]) -> str:
    return " ".join(f"{value:08X}" for value in values)
