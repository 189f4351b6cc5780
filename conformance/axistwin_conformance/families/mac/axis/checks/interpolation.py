"""Segments and their FIFO: counts, refusals, exact chaining, virtual ones (CMD-16, CMD-1E)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.motion import SLOWEST, Bench, bench_of, segment
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probes.motion import abort_flush
from axistwin_conformance.families.mac.axis.probes.sync import (
    WAIT_STEPS,
    back,
    fifo_counts_executing,
    fifo_underrun,
    interp_during_profile,
    put,
    segment_signed,
    stop17_in_interp,
    wait_steps,
)
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 140  # of this module in a run; see `Family.modules`

SURELY_EMPTY_NS: Final = 1_000_000_000  # after the end of all that was put there
SETTLE_NS: Final = 2_000_000  # of a time that two exchanges straddle


def plain(session: Session) -> Bench:
    """A bench for a device whose segments end as the ledger takes them to; skips for others."""
    bench = bench_of(session)
    if bench.known("fifo_underrun"):
        session.skip("this device does something else than halt when the FIFO runs empty")
    return bench


@check("MACS-CMD-16-02", safety=MOVES)
def the_fifo_has_three_stages(session: Session) -> None:
    """Of five long segments in a burst the first three are accepted and the fifth is refused."""
    bench = bench_of(session)
    bench.ready()
    bench.again(fifo_counts_executing)


@check("MACS-CMD-16-02", "MACS-CMD-1E-01", "MACS-REPLY-05", safety=MOVES)
def a_refused_segment_is_accepted_when_a_stage_frees(session: Session) -> None:
    """A full FIFO refuses until the interpolator takes the next segment, then accepts one."""
    bench = plain(session)
    start = bench.ready()
    one = Segment(wait_steps(bench), SLOWEST)
    bench.needs_travel(5 * one.steps, "segments that outlast a burst of exchanges on this line")
    first = bench.must(Kind.ACCEPTED, put(bench, one))
    accepted = 1
    while (more := put(bench, one)).kind is Kind.ACCEPTED:
        bench.unbroken(first, [one], more)
        accepted += 1
        session.expect(accepted <= 4, "MACS-CMD-16-02", "3 or 4 accepted", accepted)
    frees_ns = first.taken.earliest_ns + one.duration_ns
    bench.wait_until(frees_ns - 40_000_000 - bench.target.line_ns)
    early = put(bench, one)
    if early.taken.latest_ns < frees_ns:
        bench.must(Kind.REFUSED, early, ("MACS-CMD-16-02", "MACS-CMD-1E-01"))
    bench.wait_until(first.taken.latest_ns + one.duration_ns + SETTLE_NS)
    bench.must(Kind.ACCEPTED, put(bench, one), ("MACS-CMD-16-02", "MACS-CMD-1E-01"))
    bench.must(Kind.REFUSED, put(bench, one), "MACS-CMD-16-02")
    forecast = bench.to_segments(first, start, *([one] * (accepted + 1)))
    place = bench.finish(forecast, "MACS-REPLY-05")
    bench.wait(0.4)
    again = bench.position()
    session.expect(
        place == again == start + (accepted + 1) * one.steps, "MACS-REPLY-05",
        "only the accepted segments run", f"{again - start} increments",
    )  # fmt: skip


@check("MACS-CMD-16-01", "MACS-CMD-16-03", safety=MOVES)
def segments_run_at_their_own_constant_speed(session: Session) -> None:
    """A segment takes exactly |DDDD|·VVVV ticks, relative, whatever 0Dh and 0Fh say."""
    bench = plain(session)
    fast, medium, slow = bench.slowed_alike(0x1000, 0x1800, 0x8000)
    # So many that a quarter more shows beside an exchange that takes long.
    many = max(40, min(200, 8 * bench.target.uncertainty_ns // (slow * TICK_NS)))
    for steps, period, coefficient in (
        (200, fast, 5),
        (back(bench, 150), medium, 0),
        (many, slow, 50),
    ):
        start = bench.ready(0x4000, coefficient)
        exchange = bench.must(Kind.ACCEPTED, put(bench, Segment(steps, period)))
        bench.watch(
            bench.to_segments(exchange, start, Segment(steps, period)),
            ("MACS-CMD-16-01", "MACS-CMD-16-03"),
            samples=5,
        )


@check("MACS-CMD-16-01", "MACS-FRAME-05", safety=MOVES, level="full")
def segment_steps_are_signed(session: Session) -> None:
    """DDDD is a signed number of steps: FFFFh is one back and 8000h goes backward; or unsigned."""
    bench = bench_of(session)
    bench.again(segment_signed, ("MACS-CMD-16-01", "MACS-FRAME-05"))
    start, one = bench.ready(), Segment(-0x8000, bench.slowed(0x1000))
    if not bench.known("segment_signed") and bench.fits(start - 0x8000):
        exchange = bench.must(Kind.ACCEPTED, put(bench, one))
        forecast = bench.to_segments(exchange, start, one)
        bench.wait(0.1)
        bench.follow(forecast, ("MACS-CMD-16-01", "MACS-FRAME-05"), bench.allowance(one.period))
        bench.at_rest()


@check("MACS-CMD-1E-01", "MACS-CMD-16-01", safety=MOVES)
def virtual_segments_wait_as_long_as_real_ones_move(session: Session) -> None:
    """Between two segments, 1Eh keeps the axis still for DDDD·VVVV ticks, and not one more."""
    bench = plain(session)
    start = bench.ready()
    period, slow = bench.outlasting(40, 0x3000), bench.slowed(0x4000)
    row = [
        Segment(40, period), Segment(60, period, moves=False), Segment(back(bench, 25), slow),
    ]  # fmt: skip
    forecast = bench.feed(start, *row)
    bench.watch(forecast, ("MACS-CMD-1E-01", "MACS-CMD-16-01"), samples=10)
    place = bench.position()
    bench.must(
        Kind.ACCEPTED, put(bench, Segment(back(bench, 30), 0x4000, moves=False)), "MACS-CMD-1E-01"
    )
    bench.wait(0.1)
    session.expect(bench.position() == place, "MACS-CMD-1E-01", place, bench.position())


@check("MACS-CMD-16-01", "MACS-CMD-1E-01", "MACS-CMD-16-02", safety=MOVES)
def segments_follow_one_another_without_a_gap(session: Session) -> None:
    """A long row, fed whenever the FIFO takes one, ends at the sum of its ticks: no drift."""
    bench = plain(session)
    start = bench.ready()
    # Each segment must outlast an exchange, or the FIFO runs empty.
    count, shortest = (120, 20) if session.transport.is_virtual else (16, 80)
    period = bench.outlasting(shortest, 0x1000)
    draw = session.random
    row = [
        Segment(
            draw.choice((back(bench, 1), 1)) * draw.randint(shortest, 2 * shortest),
            draw.randint(period, min(SLOWEST, period * 3 // 2)),
            draw.random() < 0.8,
        )
        for _ in range(count)
    ]
    first = bench.must(Kind.ACCEPTED, put(bench, row[0]))
    for number, one in enumerate(row[1:], 1):
        # Of what it has: a look that comes late finds the axis at rest behind that.
        forecast = bench.to_segments(first, start, *row[:number])
        while (exchange := put(bench, one)).kind is Kind.REFUSED:
            bench.follow(forecast, ("MACS-CMD-16-01", "MACS-CMD-1E-01"), bench.allowance(0x0C00))
            if exchange.taken.earliest_ns > forecast.over_ns + SURELY_EMPTY_NS:
                break  # it would refuse for ever
        bench.must(Kind.ACCEPTED, exchange, "MACS-CMD-16-02")
        bench.unbroken(first, row[:number], exchange)
    forecast = bench.to_segments(first, start, *row)
    bench.watch(forecast, ("MACS-CMD-16-01", "MACS-CMD-1E-01"), samples=3)


@check("MACS-CMD-16-01", "MACS-STATE-01", safety=MOVES, level="full")
def when_the_fifo_runs_empty_the_axis_rests(session: Session) -> None:
    """At the end of the last segment the axis stands on its last step, unlocked, and goes on."""
    bench = bench_of(session)
    start = bench.ready()
    one = Segment(30, bench.slowed(0x2000))
    bench.again(fifo_underrun, "MACS-CMD-16-01")
    start = bench.position()
    for _ in range(0 if bench.known("fifo_underrun") else 3):
        exchange = bench.must(Kind.ACCEPTED, put(bench, one))
        forecast = bench.to_segments(exchange, start, one)
        place = bench.watch(forecast, "MACS-CMD-16-01", samples=2)
        bench.accepted(0x0F, 0, requirement="MACS-STATE-01")
        start = place


@check("MACS-CMD-16-01", "MACS-CMD-1E-01", safety=MOVES, level="full")
def segments_of_zero_period_or_zero_steps(session: Session) -> None:
    """VVVV = 0 is refused, or taken as a very fast or slow one; DDDD = 0 takes no time."""
    bench = plain(session)
    start = bench.ready(SLOWEST)
    kind = bench.command(0x1E, segment(WAIT_STEPS, 0)).kind
    bench.wait(0.02)
    is_running = bench.command(0x02, 0).kind is Kind.REFUSED
    bench.at_rest()
    outcome: int | str = str(kind.value)
    if kind is Kind.REFUSED:
        outcome = 0
    elif kind is Kind.ACCEPTED:
        outcome = 2 if is_running else 1
    bench.reading("segment_zero_period", outcome, "MACS-CMD-1E-01")
    for index in (0x16, 0x1E):
        kind = bench.command(index, segment(0, bench.slowed(0x1000))).kind
        if kind is not Kind.ACCEPTED:
            session.fail(None, "accepted", kind.value)
        outcome = int(bench.command(0x02, 0).kind is Kind.REFUSED)
        bench.at_rest()
        bench.reading("segment_zero_steps", outcome, f"MACS-CMD-{index:02X}-01")
        if outcome:
            start = bench.position()
    session.expect(bench.position() == start, "MACS-CMD-16-01", start, bench.position())


@check("MACS-CMD-17-02", safety=MOVES)
def a_ramped_stop_does_not_interrupt_segments(session: Session) -> None:
    """17h during segments: they run to their end.  Other readings are named quirks."""
    bench = plain(session)
    bench.again(stop17_in_interp)


@check("MACS-CMD-18-03", "MACS-CMD-18-01", safety=MOVES, level="full")
def a_hard_stop_empties_the_fifo(session: Session) -> None:
    """18h ends the segment and drops the stored ones: nothing resumes, and the FIFO is free."""
    bench = plain(session)
    start = bench.ready()
    one = Segment(40, bench.outlasting(40, 0x4000))
    forecast = bench.feed(start, one, one, one)
    bench.wait(0.1)
    halted = forecast.halted(bench.accepted(0x18).taken)
    place = bench.finish(halted, "MACS-CMD-18-01", bench.braking(one.period))
    bench.wait(0.5)
    again = bench.position()
    both = ("MACS-CMD-18-01", "MACS-CMD-18-03")
    session.expect(again == place, both, f"at rest at {place}", again)
    bench.accepted(0x0F, 0, requirement="MACS-CMD-18-01")
    if bench.known("abort_flush"):  # what is stored runs with the next segment on this device
        bench.again(abort_flush, "MACS-CMD-18-03")
        return
    start = bench.position()
    one = Segment(10, bench.slowed(0x2000))
    exchange = bench.must(Kind.ACCEPTED, put(bench, one), "MACS-CMD-18-03")
    bench.watch(bench.to_segments(exchange, start, one), "MACS-CMD-18-03", samples=2)


@check("MACS-CMD-16-02", safety=MOVES, level="full")
def segments_sent_during_a_move(session: Session) -> None:
    """16h during 13h is stored and runs when the axis rests, or is refused, or takes over."""
    bench = plain(session)
    bench.again(interp_during_profile)
