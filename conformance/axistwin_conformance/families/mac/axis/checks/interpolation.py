"""Segments and their FIFO: counts, refusals, exact chaining, virtual ones (CMD-16, CMD-1E)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.velocity import judge_follows
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import FIFO_STAGES, segment_parameter
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
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
SWINGING_NS: Final = 2_000_000  # of a time that two exchanges straddle
MANY: Final = 0x102  # steps of FFFFh: 2.1 s
# Steps whose bytes are 00, 80 or FF: where a sign, or a carry, may be lost.
EDGES: Final = (-0x100, 0x100, -0x200, 0x80, -0x80, 0xFF, -0xFF, 0x200)
# Virtual segments, which no motor limits: so many steps, so fast.
FAST: Final = ((0x4000, 0x20), (0x7F80, 0x08))


def plain(session: Session) -> AxisDriver:
    """A bench for a device whose segments end as the ledger takes them to; skips for others."""
    driver = driver_of(session)
    if driver.readings.known("fifo_underrun"):
        session.skip("this device does something else than halt when the FIFO runs empty")
    return driver


@check("MACS-CMD-16-02", safety=MOVES)
def the_fifo_has_three_stages(session: Session) -> None:
    """Of five long segments in a burst the first three are accepted and the fifth is refused."""
    driver = driver_of(session)
    driver.motion.ready()
    driver.judge.again(fifo_counts_executing)


@check("MACS-CMD-16-02", "MACS-CMD-1E-01", "MACS-REPLY-05", safety=MOVES)
def a_refused_segment_is_accepted_when_a_stage_frees(session: Session) -> None:
    """A full FIFO refuses until the interpolator takes the next segment, then accepts one."""
    driver = plain(session)
    start = driver.motion.ready()
    segment = Segment(wait_steps(driver), SLOWEST)
    driver.limits.needs_travel(
        5 * segment.steps, "segments that outlast a burst of exchanges on this line"
    )
    first = driver.judge.must(ReplyKind.ACCEPTED, put(driver, segment))
    accepted = 1
    while (more := put(driver, segment)).kind is ReplyKind.ACCEPTED:
        driver.motion.unbroken(first, [segment], more)
        accepted += 1
        session.expect(accepted <= 4, "MACS-CMD-16-02", "3 or 4 accepted", accepted)
    frees_ns = first.taken.earliest_ns + segment.duration_ns
    driver.client.wait_until(frees_ns - 40_000_000 - driver.client.target.line_ns)
    early = put(driver, segment)
    if early.taken.latest_ns < frees_ns:
        driver.judge.must(ReplyKind.REFUSED, early, ("MACS-CMD-16-02", "MACS-CMD-1E-01"))
    driver.client.wait_until(first.taken.latest_ns + segment.duration_ns + SWINGING_NS)
    driver.judge.must(
        ReplyKind.ACCEPTED, put(driver, segment), ("MACS-CMD-16-02", "MACS-CMD-1E-01")
    )
    driver.judge.must(ReplyKind.REFUSED, put(driver, segment), "MACS-CMD-16-02")
    forecast = driver.motion.to_segments(first, start, *([segment] * (accepted + 1)))
    place = driver.motion.finish(forecast, "MACS-REPLY-05")
    driver.client.wait(0.4)
    again = driver.client.position()
    session.expect(
        place == again == start + (accepted + 1) * segment.steps,
        "MACS-REPLY-05",
        "only the accepted segments run",
        f"{again - start} increments",
    )


@check("MACS-CMD-16-01", "MACS-CMD-16-03", safety=MOVES)
def segments_run_at_their_own_constant_speed(session: Session) -> None:
    """A segment moves DDDD steps from where the axis is, each in VVVV × 0.125 µs, whatever 0Dh and
    0Fh say."""
    driver = plain(session)
    fast, medium, slow = driver.limits.slowed_alike(0x1000, 0x1800, 0x8000)
    # So many that a quarter more shows beside an exchange that takes long.
    many = max(40, min(200, 8 * driver.client.target.uncertainty_ns // (slow * TICK_NS)))
    for steps, period, coefficient in (
        (250, fast, 1),  # more than two ramps of 0Fh
        (back(driver, 200), medium, 0),
        (many, slow, 50),
    ):
        start = driver.motion.ready(0x4000, coefficient)
        exchange = driver.judge.must(ReplyKind.ACCEPTED, put(driver, Segment(steps, period)))
        judge_follows(driver, "16h behind a 13h", "MACS-CMD-16-01")
        driver.motion.watch(
            driver.motion.to_segments(exchange, start, Segment(steps, period)),
            ("MACS-CMD-16-01", "MACS-CMD-16-03"),
            samples=5,
        )


@check("MACS-CMD-16-01", "MACS-FRAME-05", safety=MOVES, level="full")
def segment_steps_are_signed(session: Session) -> None:
    """DDDD is a signed number of steps, whatever its bytes: FFFFh is one back and 8000h goes
    backward; or unsigned."""
    driver = driver_of(session)
    driver.judge.again(segment_signed, ("MACS-CMD-16-01", "MACS-FRAME-05"))
    _judge_edges(driver)
    start, segment = driver.motion.ready(), Segment(-0x8000, driver.limits.slowed(0x1000))
    if not driver.readings.known("segment_signed") and driver.limits.fits(start - 0x8000):
        exchange = driver.judge.must(ReplyKind.ACCEPTED, put(driver, segment))
        forecast = driver.motion.to_segments(exchange, start, segment)
        driver.client.wait(0.1)
        driver.motion.follow(
            forecast, ("MACS-CMD-16-01", "MACS-FRAME-05"), driver.limits.allowance(segment.period)
        )
        driver.motion.at_rest()


def _judge_edges(driver: AxisDriver) -> None:
    """Segments of steps whose bytes are 00, 80 or FF end where they are to, either way."""
    start, period = driver.motion.ready(), driver.limits.slowed(0x0640)
    for steps in EDGES:
        segment = Segment(steps if steps > 0 else back(driver, -steps), period)
        if driver.limits.fits(start + segment.steps):
            exchange = driver.judge.must(ReplyKind.ACCEPTED, put(driver, segment))
            forecast = driver.motion.to_segments(exchange, start, segment)
            start = driver.motion.finish(forecast, ("MACS-CMD-16-01", "MACS-FRAME-05"))
            if driver.readings.known("fifo_underrun"):
                start = driver.motion.ready()


@check("MACS-CMD-1E-01", "MACS-CMD-16-01", safety=MOVES)
def virtual_segments_wait_as_long_as_real_ones_move(session: Session) -> None:
    """Between two segments, 1Eh keeps the axis still for DDDD·VVVV ticks, and not one more."""
    driver = plain(session)
    start = driver.motion.ready()
    first, slow = driver.limits.segment(40, 0x3000), driver.limits.slowed(0x4000)
    pause = Segment(first.steps * 3 // 2, first.period, moves=False)
    row = [first, pause, Segment(back(driver, 25), slow)]
    forecast = driver.motion.feed(start, *row)
    driver.motion.watch(forecast, ("MACS-CMD-1E-01", "MACS-CMD-16-01"), samples=10)
    place = driver.client.position()
    driver.judge.must(
        ReplyKind.ACCEPTED,
        put(driver, Segment(back(driver, 30), 0x4000, moves=False)),
        "MACS-CMD-1E-01",
    )
    driver.client.wait(0.1)
    session.expect(
        driver.client.position() == place, "MACS-CMD-1E-01", place, driver.client.position()
    )


@check("MACS-CMD-1E-01", safety=MOVES, level="full")
def a_segment_behind_virtual_ones_begins_on_time(session: Session) -> None:
    """Behind one virtual segment of few long steps and one of more than 2 s, which no counter of 24
    bits holds, a segment begins when all their ticks are over."""
    driver = plain(session)
    few = driver.limits.segment(4, SLOWEST, moves=False)
    for pauses in ((few, Segment(2, SLOWEST, moves=False)), (Segment(MANY, SLOWEST, moves=False),)):
        start = driver.motion.ready(0x1000)
        row = [*pauses, Segment(100, driver.motion.period)]
        driver.motion.watch(driver.motion.feed(start, *row), samples=12)


@check("MACS-CMD-1E-01", safety=MOVES, level="full")
def a_segment_behind_many_fast_steps_begins_on_time(session: Session) -> None:
    """Behind a virtual segment of many steps, too fast for a motor, a segment begins when all their
    ticks are over."""
    driver = plain(session)
    first = driver.limits.segment(25, SLOWEST, moves=False)
    for steps, period in FAST:
        start = driver.motion.ready(0x1000)
        row = [first, Segment(steps, period, moves=False), Segment(100, driver.motion.period)]
        driver.motion.watch(driver.motion.feed(start, *row), samples=12)


@check("MACS-CMD-16-01", "MACS-CMD-1E-01", "MACS-CMD-16-02", safety=MOVES)
def segments_follow_one_another_without_a_gap(session: Session) -> None:
    """A long row, fed whenever the FIFO takes one, ends at the sum of its ticks: no drift."""
    driver = plain(session)
    start = driver.motion.ready()
    # Each segment must outlast an exchange, or the FIFO runs empty.  Where the axis may go far,
    # more steps do that, not slower ones: the faster they are, the shorter a gap that shows.
    count, shortest = (120, 20) if session.transport.is_virtual else (16, 80)
    period = driver.limits.outlasting(shortest, 0x1000)
    if not session.envelope.is_guarded:
        period = driver.limits.slowed(0x1000)
        shortest = max(shortest, driver.limits.steps_outlasting(period))
    draw = session.random
    row = [
        Segment(
            draw.choice((back(driver, 1), 1)) * draw.randint(shortest, 2 * shortest),
            draw.randint(period, min(SLOWEST, period * 3 // 2)),
            draw.random() < 0.8,
        )
        for _ in range(count)
    ]
    first = driver.judge.must(ReplyKind.ACCEPTED, put(driver, row[0]))
    for number, segment in enumerate(row[1:], 1):
        # Of what it has: a look that comes late finds the axis at rest behind that.
        forecast = driver.motion.to_segments(first, start, *row[:number])
        while (exchange := put(driver, segment)).kind is ReplyKind.REFUSED:
            driver.motion.follow(
                forecast, ("MACS-CMD-16-01", "MACS-CMD-1E-01"), driver.limits.allowance(0x0C00)
            )
            if exchange.taken.earliest_ns > forecast.over_ns + SURELY_EMPTY_NS:
                break  # it would refuse for ever
        driver.judge.must(ReplyKind.ACCEPTED, exchange, "MACS-CMD-16-02")
        driver.motion.unbroken(first, row[:number], exchange)
    forecast = driver.motion.to_segments(first, start, *row)
    driver.motion.watch(forecast, ("MACS-CMD-16-01", "MACS-CMD-1E-01"), samples=3)


@check("MACS-CMD-16-01", "MACS-STATE-01", safety=MOVES, level="full")
def when_the_fifo_runs_empty_the_axis_rests(session: Session) -> None:
    """At the end of the last segment the axis stands on its last step, unlocked, and goes on."""
    driver = driver_of(session)
    start = driver.motion.ready()
    segment = Segment(30, driver.limits.slowed(0x2000))
    driver.judge.again(fifo_underrun, "MACS-CMD-16-01")
    start = driver.client.position()
    for number in range(0 if driver.readings.known("fifo_underrun") else 3):
        if number == 1:  # a segment powers the motor, as any motion
            driver.judge.accepted(0x1A)
        exchange = driver.judge.must(ReplyKind.ACCEPTED, put(driver, segment))
        forecast = driver.motion.to_segments(exchange, start, segment)
        place = driver.motion.watch(forecast, "MACS-CMD-16-01", samples=2)
        driver.judge.accepted(0x0F, 0, requirement="MACS-STATE-01")
        start = place


@check("MACS-CMD-16-01", "MACS-CMD-1E-01", "MACS-REPLY-05", safety=MOVES, level="full")
def segments_of_zero_period_or_zero_steps(session: Session) -> None:
    """VVVV = 0 is refused, and the segments stored before run, or taken as a very fast or slow one;
    DDDD = 0 takes no time."""
    driver = plain(session)
    start = driver.motion.ready(SLOWEST)
    kind = driver.client.command(0x1E, segment_parameter(WAIT_STEPS, 0)).kind
    driver.client.wait(0.02)
    is_running = driver.client.command(0x02, 0).kind is ReplyKind.REFUSED
    driver.motion.at_rest()
    outcome: int | str = str(kind.value)
    if kind is ReplyKind.REFUSED:
        outcome = 0
    elif kind is ReplyKind.ACCEPTED:
        outcome = 2 if is_running else 1
    driver.judge.reading("segment_zero_period", outcome, "MACS-CMD-1E-01")
    if outcome == 0:
        start = _refused_behind_segments(driver)
    for index in (0x16, 0x1E):
        kind = driver.client.command(index, segment_parameter(0, driver.limits.slowed(0x1000))).kind
        if kind is not ReplyKind.ACCEPTED:
            session.fail(("MACS-CMD-16-01", "MACS-CMD-1E-01"), "accepted", kind.value)
        outcome = int(driver.client.command(0x02, 0).kind is ReplyKind.REFUSED)
        driver.motion.at_rest()
        driver.judge.reading("segment_zero_steps", outcome, f"MACS-CMD-{index:02X}-01")
        if outcome:
            start = driver.client.position()
    session.expect(
        driver.client.position() == start, "MACS-CMD-16-01", start, driver.client.position()
    )


def _refused_behind_segments(driver: AxisDriver) -> int:
    """Segments that are refused for their period leave those alone that are stored; the place."""
    start = driver.motion.ready()
    segment = driver.limits.segment(20, 0x4000, exchanges=5)
    forecast = driver.motion.feed(start, segment, segment)
    for index in (0x16, 0x1E):
        driver.judge.refused(index, segment_parameter(WAIT_STEPS, 0), requirement="MACS-REPLY-05")
    place = driver.motion.finish(forecast, "MACS-REPLY-05")
    driver.motion.at_rest()  # out of the error of a store that has run empty (MACS-AMB-40)
    return place


@check("MACS-CMD-17-02", safety=MOVES)
def a_ramped_stop_does_not_interrupt_segments(session: Session) -> None:
    """17h during segments: they run to their end.  Other readings are named quirks."""
    driver = plain(session)
    driver.judge.again(stop17_in_interp)
    if driver.readings.known("stop17_in_interp"):
        return
    # Nor is it done later: what is begun next goes on.
    start, segment = driver.motion.ready(0x0800), driver.limits.segment(20, 0x2000)
    for is_move in (True, False):
        end = driver.motion.feed(start, segment).end
        assert end is not None
        driver.judge.accepted(0x17)
        driver.client.wait_until(end.latest_ns + SURELY_EMPTY_NS // 10)
        if is_move:
            start = driver.motion.finish(driver.motion.go(start + 250))
            continue
        period = driver.limits.gentle(0x1000, 0.3)
        forecast = driver.motion.turn(1, period)
        for _ in range(2):
            driver.client.wait(0.1)
            driver.motion.follow(forecast, None, driver.limits.allowance(period))


@check("MACS-CMD-18-03", "MACS-CMD-18-01", safety=MOVES, level="full")
def a_hard_stop_empties_the_fifo(session: Session) -> None:
    """18h ends the segment and drops the stored ones: nothing resumes, and the FIFO is free."""
    driver = plain(session)
    start = driver.motion.ready()
    segment = driver.limits.segment(40, 0x4000)
    forecast = driver.motion.feed(start, segment, segment, segment)
    driver.client.wait(0.1)
    halted = forecast.halted(driver.judge.accepted(0x18).taken)
    place = driver.motion.finish(halted, "MACS-CMD-18-01", driver.limits.braking(segment.period))
    driver.client.wait(0.5)
    again = driver.client.position()
    both = ("MACS-CMD-18-01", "MACS-CMD-18-03")
    session.expect(again == place, both, f"at rest at {place}", again)
    driver.judge.accepted(0x0F, 0, requirement="MACS-CMD-18-01")
    if driver.readings.known(
        "abort_flush"
    ):  # what is stored runs with the next segment on this device
        driver.judge.again(abort_flush, "MACS-CMD-18-03")
        return
    start = driver.client.position()
    segment = Segment(10, driver.limits.slowed(0x2000))
    exchange = driver.judge.must(ReplyKind.ACCEPTED, put(driver, segment), "MACS-CMD-18-03")
    driver.motion.watch(
        driver.motion.to_segments(exchange, start, segment), "MACS-CMD-18-03", samples=2
    )


@check("MACS-CMD-16-02", safety=MOVES, level="full")
def segments_sent_during_a_move(session: Session) -> None:
    """16h during 13h is stored and runs when the axis rests, or is refused, or takes over; three
    are stored there too, and what is refused never runs."""
    driver = plain(session)
    driver.judge.again(interp_during_profile)
    if driver.readings.known("interp_during_profile"):
        return
    start = driver.motion.ready(driver.limits.outlasting(100, 0x2000, exchanges=7))
    target = start + driver.limits.way_outlasting(100, driver.motion.period, 7)
    end = driver.motion.go(target).end
    assert end is not None
    segment = Segment(back(driver, 5), driver.limits.slowed(0x1000))
    row = [put(driver, segment) for _ in range(FIFO_STAGES + 2)]
    driver.motion.taken_in_time(row[-1], end.earliest_ns, "the move")
    for number, exchange in enumerate(row):
        kind = ReplyKind.ACCEPTED if number < FIFO_STAGES else ReplyKind.REFUSED
        driver.judge.must(kind, exchange, "MACS-CMD-16-02")
    driver.client.wait_until(end.latest_ns + len(row) * segment.duration_ns + SURELY_EMPTY_NS // 5)
    place, wanted = driver.client.position(), target + FIFO_STAGES * segment.steps
    session.expect(place == wanted, None, f"at {wanted}, behind {FIFO_STAGES} segments", place)
    driver.motion.at_rest()
