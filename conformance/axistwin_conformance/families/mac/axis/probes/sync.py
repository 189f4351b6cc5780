"""Which readings a module follows in segments and in synchronous mode."""

from __future__ import annotations

from functools import partial
from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange, Sample
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import (
    Forecast,
    Segment,
    Timeline,
    TimeWindow,
)
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, Course
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES, reply_of

ORDER = 80  # of this module in a run; see `Family.modules`

WAIT_STEPS: Final = 0x20  # of a virtual segment at the slowest period: 262 ms
BURST: Final = 7  # exchanges
HELD_S: Final = 0.15
TURNING_SLACK: Final = 1  # increments: one that is in progress when the axis turns


def put(driver: AxisDriver, segment: Segment) -> AxisExchange:
    """Send a segment, real or virtual."""
    return driver.client.command(
        0x16 if segment.moves else 0x1E, segment_parameter(segment.steps, segment.period)
    )


def wait_steps(driver: AxisDriver) -> int:
    """Steps of a segment at the slowest period that outlasts a burst of others on this line."""
    least_ns = BURST * driver.client.target.uncertainty_ns
    return max(WAIT_STEPS, -(-least_ns // (SLOWEST * TICK_NS)))


def back(driver: AxisDriver, steps: int) -> int:
    """So many steps backward, where segments can go backward."""
    return steps if driver.readings.known("segment_signed") else -steps


def is_held(driver: AxisDriver, place: int) -> bool:
    """True if the axis is still there a little later."""
    driver.client.wait(HELD_S)
    return driver.client.position() == place


@probe(safety=MOVES)
def fifo_counts_executing(driver: AxisDriver) -> Outcome:
    """A burst of five long 1Eh: how many are accepted."""
    driver.motion.at_rest()
    segment = Segment(wait_steps(driver), SLOWEST, moves=False)
    burst = [put(driver, segment) for _ in range(5)]
    over_ns = burst[0].taken.earliest_ns + segment.duration_ns
    driver.motion.taken_in_time(burst[-1], over_ns, "the first segment")
    kinds = [exchange.kind for exchange in burst]
    driver.motion.at_rest()
    depths: dict[tuple[ReplyKind, ...], int] = {
        (ReplyKind.ACCEPTED,) * 4 + (ReplyKind.REFUSED,): 0,
        (ReplyKind.ACCEPTED,) * 3 + (ReplyKind.REFUSED,) * 2: 1,
    }
    return depths.get(tuple(kinds), ", ".join(kind.value for kind in kinds))


@probe(safety=MOVES)
def segment_signed(driver: AxisDriver) -> Outcome:
    """16h FFFF at a slow period: one step back, or a long way forward."""
    start = driver.motion.ready_for_segments()
    period = driver.limits.slowed(0x1000)
    put(driver, Segment(0xFFFF, period))
    driver.client.wait(driver.motion.lasting_s(100, period))
    driver.motion.at_rest()
    moved = driver.client.position() - start
    return 0 if moved == -1 else 1 if moved > 10 else f"{moved:+d} increments"


@probe(safety=MOVES)
def fifo_underrun(driver: AxisDriver) -> Outcome:
    """One segment and no other behind it, with AA = 1 so that a ramp shows; then another."""
    start = driver.motion.ready_for_segments(coefficient=1)
    period = driver.limits.slowed(0x2000)
    exchange = put(driver, Segment(30, period))
    end = driver.motion.to_segments(exchange, start, Segment(30, period)).end
    assert end is not None
    driver.client.wait_until(end.latest_ns + 300_000_000)
    moved = driver.client.position() - start
    again = put(driver, Segment(1, period)).kind
    if again is ReplyKind.REFUSED:
        driver.client.command(0x18)  # what leads out of it (MACS-AMB-40)
        return 2
    driver.motion.at_rest()
    if again is not ReplyKind.ACCEPTED or moved < 30:
        return f"{moved} of 30 increments, then {again.value}"
    return 0 if moved == 30 else 1


@probe(safety=MOVES)
def segment_zero_period(driver: AxisDriver) -> Outcome:
    """1Eh with VVVV = 0000: refused; over at once; or long running."""
    driver.motion.ready_for_segments()
    kind = driver.client.command(0x1E, segment_parameter(WAIT_STEPS, 0)).kind
    driver.client.wait(0.02)
    is_running = driver.client.command(0x02, 0).kind is ReplyKind.REFUSED
    driver.motion.at_rest()
    if kind is ReplyKind.ACCEPTED:
        return 2 if is_running else 1
    return reply_of(kind, {ReplyKind.REFUSED: 0})


@probe(safety=MOVES)
def segment_zero_steps(driver: AxisDriver) -> Outcome:
    """1Eh with DDDD = 0000: over at once, or long running."""
    driver.motion.ready_for_segments()
    kind = driver.client.command(0x1E, segment_parameter(0, 0x1000)).kind
    is_running = driver.client.command(0x02, 0).kind is ReplyKind.REFUSED
    driver.motion.at_rest()
    return int(is_running) if kind is ReplyKind.ACCEPTED else f"{kind.value} to 1Eh with DDDD = 0"


@probe(safety=MOVES)
def interp_during_profile(driver: AxisDriver) -> Outcome:
    """16h during 13h: the reply, and where the axis ends."""
    start = driver.motion.ready(driver.limits.outlasting(100, 0x2000))
    way = driver.limits.way_outlasting(100, driver.motion.period, 3)
    exchange = driver.judge.accepted(0x13, start + way)
    segment = Segment(back(driver, 40), driver.limits.slowed(0x1000))
    second = put(driver, segment)
    end = driver.motion.to_position(exchange, start, start + way).end
    assert end is not None
    driver.motion.taken_in_time(second, end.earliest_ns, "the move that it was to meet")
    if second.kind is ReplyKind.REFUSED:
        driver.motion.at_rest()
        return 1
    driver.client.wait_until(end.latest_ns + segment.duration_ns + 50_000_000)
    moved, total = driver.client.position() - start, way + segment.steps
    driver.motion.at_rest()
    if second.kind is ReplyKind.ACCEPTED and moved <= total:
        return 0 if moved == total else 2
    return f"{second.kind.value}, {moved:+d} increments"


@probe(safety=MOVES)
def stop17_in_interp(driver: AxisDriver) -> Outcome:
    """17h during the first of two segments: the reply, and how many steps are done."""
    start = driver.motion.ready(0x1000)  # AA = 0: to stop now takes one increment
    segment = driver.limits.segment(30, 0x2000)
    row = [segment] * 2
    forecast = driver.motion.feed(start, *row)
    stop = driver.client.command(0x17)
    most = forecast.bounds(stop.taken)[1] - start + 2 + driver.limits.allowance(row[0].period)
    assert forecast.end is not None
    driver.client.wait_until(forecast.end.latest_ns + 50_000_000)
    moved = driver.client.position() - start
    driver.motion.at_rest()
    if moved == 2 * segment.steps and stop.kind in (ReplyKind.ACCEPTED, ReplyKind.REFUSED):
        return 0 if stop.kind is ReplyKind.ACCEPTED else 1
    if stop.kind is ReplyKind.ACCEPTED and (moved == segment.steps or 0 < moved <= most):
        return 2 if moved == segment.steps else 3
    return f"{stop.kind.value}, {moved} of {2 * segment.steps} increments"


@probe(safety=MOVES)
def vel_during_interp(driver: AxisDriver) -> Outcome:
    """15h during a long 16h."""
    driver.motion.ready_for_segments()
    driver.judge.accepted(0x16, segment_parameter(100, SLOWEST))
    kind = driver.client.command(0x15, velocity(1, driver.limits.slowed(0x2000))).kind
    driver.motion.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def sync_without_preload(driver: AxisDriver) -> Outcome:
    """11h at rest."""
    driver.motion.ready()
    return reply_of(driver.client.command(0x11).kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def sync_arm_lifetime(driver: AxisDriver) -> Outcome:
    """10h during a move, then 13h: whether that is held.  Where 10h holds every motion, it is."""
    start = driver.motion.ready(driver.limits.outlasting(30, 0x4000))
    way = driver.limits.way_outlasting(30, driver.motion.period, 3)
    forecast = driver.motion.go(start + way)
    end = forecast.end
    assert end is not None
    armed = driver.judge.accepted(0x10)
    driver.motion.taken_in_time(armed, end.earliest_ns, "the move")
    driver.client.wait_until(end.latest_ns + 50_000_000)
    place = driver.client.position()
    driver.judge.accepted(0x13, start)
    held = is_held(driver, place)
    driver.client.command(0x11)
    driver.client.wait(0.1)
    driver.motion.at_rest()
    readings = driver.session.run.ledger.ambiguity_of("sync_arm_lifetime").switches
    held_by = tuple(n for n in range(len(readings["sync_arm_lifetime"])) if n != 1)
    return held_by if held else 1


@probe(safety=MOVES)
def arm_after_segment(driver: AxisDriver) -> Outcome:
    """10h, 16h, 13h: whether the move is held."""
    start = driver.motion.ready(0x1000)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x16, segment_parameter(25, driver.motion.period))
    driver.client.wait(0.1 + driver.motion.lasting_s(25))
    place = driver.client.position()
    driver.judge.accepted(0x13, start)
    held = is_held(driver, place)
    driver.client.command(0x11)
    driver.client.wait(0.1)
    driver.motion.at_rest()
    return 0 if held else 1


@probe(safety=MOVES)
def armed_zero_velocity(driver: AxisDriver) -> Outcome:
    """10h, 15h 0000, 13h: the reply, and whether the move is held."""
    start = driver.motion.ready(0x1000)
    driver.judge.accepted(0x10)
    zero = driver.client.command(0x15, 0).kind
    driver.client.command(0x13, start + 30)
    held = is_held(driver, start)
    driver.client.command(0x11)
    driver.client.wait(0.1)
    driver.motion.at_rest()
    if zero is ReplyKind.ACCEPTED:
        return 0 if held else 1
    return reply_of(zero, {ReplyKind.REFUSED: 2})


@probe(safety=MOVES)
def segments_after_17h(driver: AxisDriver) -> Outcome:
    """13h, 16h, 17h: where the axis ends, and whether the segment has taken it there."""
    if driver.readings.known("interp_during_profile"):
        driver.session.skip("no segment waits for the end of a move on this device")
    start = driver.motion.ready(driver.limits.outlasting(100, 0x2000))
    way = driver.limits.way_outlasting(100, driver.motion.period, 3)
    exchange = driver.judge.accepted(0x13, start + way)
    segment = Segment(back(driver, 40), driver.limits.slowed(0x1000))
    waiting = driver.motion.put(segment)
    stop = driver.judge.accepted(0x17)
    forecast = driver.motion.to_position(exchange, start, start + way)
    moving, stopped = forecast.end, forecast.stopped(stop.taken)
    assert moving is not None
    driver.motion.taken_in_time(waiting, moving.earliest_ns, "the move that it was to meet")
    driver.motion.taken_in_time(stop, moving.earliest_ns, "the move that it was to stop")
    driver.client.wait_until(moving.latest_ns + segment.duration_ns + 50_000_000)
    moved = driver.client.position() - start
    driver.motion.at_rest()
    slack = 1 + driver.limits.allowance(driver.motion.period)
    lowest, highest = (place - start for place in stopped.final)
    fitting = tuple(
        number
        for number, steps in enumerate((segment.steps, 0))
        if lowest + steps - slack <= moved <= highest + steps + slack
    )
    return fitting or f"{moved:+d} increments, {lowest}..{highest} of them of the move"


@probe(safety=MOVES)
def sync_during_interp(driver: AxisDriver) -> Outcome:
    """10h, 13h back, two segments, 11h: the places in their order."""
    if driver.readings.known("arm_after_segment"):
        driver.session.skip("segments disarm this device: nothing is left to start")
    start = driver.motion.ready(0x4000)
    target = start - 100
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, target)
    segment = driver.limits.segment(20, 0x4000)
    row = driver.motion.feed(start, segment, segment)
    sync = driver.judge.accepted(0x11)
    row_end = row.end
    assert row_end is not None
    # A move that does not wait for the segments, 82 ms or more, turns back before their end.
    driver.motion.taken_in_time(sync, row_end.earliest_ns, "the segments")
    steps = 2 * segment.steps
    there_s, back_s = (
        driver.motion.lasting_s(steps, segment.period),
        driver.motion.lasting_s(100 + steps),
    )
    samples = driver.motion.sampled(0.25 + there_s + back_s, 36)
    driver.motion.at_rest()
    after = _back_from(driver, (start + steps,), row_end, target)
    at_once = _back_from(driver, row.bounds(sync.taken), sync.taken, target)
    fitting = tuple(
        number
        for number, (back_ns, way_back) in enumerate(
            ((row_end, after), (sync.taken, at_once), (row_end, row))
        )
        if all(_is_on_the_way(driver, sample, row, back_ns, way_back) for sample in samples)
    )
    places = [sample.position - start for sample in samples]
    return fitting or f"places {places}"


def _back_from(
    driver: AxisDriver, origins: tuple[int, ...], begins: TimeWindow, target: int
) -> Forecast:
    """What to expect of a move to `target` that begins in the window, from one of those places."""
    law, period = driver.readings.law_of(0), driver.motion.period
    histories: list[Timeline] = []
    for origin in origins:
        profile = partial(Course.to_position, origin - target, period, 0)
        histories += Forecast.started(begins, origin, -1, profile, law).timelines
    return Forecast.of(histories)


def _is_on_the_way(
    driver: AxisDriver, sample: Sample, row: Forecast, begins: TimeWindow, move: Forecast
) -> bool:
    """Whether a place fits a row of segments, and behind it the move that begins in the window."""
    forecasts = [row] if sample.taken.earliest_ns <= begins.latest_ns else []
    forecasts += [move] if sample.taken.latest_ns >= begins.earliest_ns else []
    return any(not driver.motion.beyond([sample], one, one, TURNING_SLACK) for one in forecasts)
