"""Which readings a module follows in segments and in synchronous mode."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import (
    SLOWEST,
    Bench,
    Exchange,
    segment,
    velocity,
)
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.forecast import Segment
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES, reply_of

ORDER = 80  # of this module in a run; see `Family.modules`

WAIT_STEPS: Final = 0x20  # of a virtual segment at the slowest period: 262 ms
BURST: Final = 7  # exchanges
HELD_S: Final = 0.15


def put(bench: Bench, one: Segment) -> Exchange:
    """Send a segment, real or virtual."""
    return bench.command(0x16 if one.moves else 0x1E, segment(one.steps, one.period))


def wait_steps(bench: Bench) -> int:
    """Steps of a segment at the slowest period that outlasts a burst of others on this line."""
    least_ns = BURST * bench.target.line_ns
    return max(WAIT_STEPS, -(-least_ns // (SLOWEST * TICK_NS)))


def back(bench: Bench, steps: int) -> int:
    """So many steps backward, where segments can go backward."""
    return steps if bench.known("segment_signed") else -steps


def is_held(bench: Bench, place: int) -> bool:
    """True if the axis is still there a little later."""
    bench.wait(HELD_S)
    return bench.position() == place


@probe(safety=MOVES)
def fifo_counts_executing(bench: Bench) -> Outcome:
    """A burst of five long 1Eh: how many are accepted."""
    bench.at_rest()
    one = Segment(wait_steps(bench), SLOWEST, moves=False)
    burst = [put(bench, one) for _ in range(5)]
    over_ns = burst[0].taken.earliest_ns + one.duration_ns
    bench.taken_in_time(burst[-1], over_ns, "the first segment")
    kinds = [exchange.kind for exchange in burst]
    bench.at_rest()
    depths: dict[tuple[Kind, ...], int] = {
        (Kind.ACCEPTED,) * 4 + (Kind.REFUSED,): 0,
        (Kind.ACCEPTED,) * 3 + (Kind.REFUSED,) * 2: 1,
    }
    return depths.get(tuple(kinds), ", ".join(kind.value for kind in kinds))


@probe(safety=MOVES)
def segment_signed(bench: Bench) -> Outcome:
    """16h FFFF at a slow period: one step back, or a long way forward."""
    start = bench.ready(SLOWEST)
    period = bench.slowed(0x1000)
    put(bench, Segment(0xFFFF, period))
    bench.wait(bench.lasting_s(100, period))
    bench.at_rest()
    moved = bench.position() - start
    return 0 if moved == -1 else 1 if moved > 10 else f"{moved:+d} increments"


@probe(safety=MOVES)
def fifo_underrun(bench: Bench) -> Outcome:
    """One segment and no other behind it, with AA = 1 so that a ramp shows; then another."""
    start = bench.ready(coefficient=1)
    period = bench.slowed(0x2000)
    exchange = put(bench, Segment(30, period))
    end = bench.to_segments(exchange, start, Segment(30, period)).end
    assert end is not None
    bench.wait_until(end.latest_ns + 300_000_000)
    moved = bench.position() - start
    again = put(bench, Segment(1, period)).kind
    if again is Kind.REFUSED:
        bench.command(0x18)  # what leads out of it (MACS-AMB-40)
        return 2
    bench.at_rest()
    if again is not Kind.ACCEPTED or moved < 30:
        return f"{moved} of 30 increments, then {again.value}"
    return 0 if moved == 30 else 1


@probe(safety=MOVES)
def segment_zero_period(bench: Bench) -> Outcome:
    """1Eh with VVVV = 0000: refused; over at once; or long running."""
    bench.ready(SLOWEST)
    kind = bench.command(0x1E, segment(WAIT_STEPS, 0)).kind
    bench.wait(0.02)
    is_running = bench.command(0x02, 0).kind is Kind.REFUSED
    bench.at_rest()
    if kind is Kind.ACCEPTED:
        return 2 if is_running else 1
    return reply_of(kind, {Kind.REFUSED: 0})


@probe(safety=MOVES)
def segment_zero_steps(bench: Bench) -> Outcome:
    """1Eh with DDDD = 0000: over at once, or long running."""
    bench.ready(SLOWEST)
    kind = bench.command(0x1E, segment(0, 0x1000)).kind
    is_running = bench.command(0x02, 0).kind is Kind.REFUSED
    bench.at_rest()
    return int(is_running) if kind is Kind.ACCEPTED else f"{kind.value} to 1Eh with DDDD = 0"


@probe(safety=MOVES)
def interp_during_profile(bench: Bench) -> Outcome:
    """16h during 13h: the reply, and where the axis ends."""
    start = bench.ready(bench.outlasting(100, 0x2000))
    exchange = bench.accepted(0x13, start + 100)
    one = Segment(back(bench, 40), bench.slowed(0x1000))
    second = put(bench, one)
    end = bench.to_position(exchange, start, start + 100).end
    assert end is not None
    bench.taken_in_time(second, end.earliest_ns, "the move that it was to meet")
    if second.kind is Kind.REFUSED:
        bench.at_rest()
        return 1
    bench.wait_until(end.latest_ns + one.duration_ns + 50_000_000)
    moved, total = bench.position() - start, 100 + one.steps
    bench.at_rest()
    if second.kind is Kind.ACCEPTED and moved <= total:
        return 0 if moved == total else 2
    return f"{second.kind.value}, {moved:+d} increments"


@probe(safety=MOVES)
def stop17_in_interp(bench: Bench) -> Outcome:
    """17h during the first of two segments: the reply, and how many steps are done."""
    start = bench.ready(0x1000)  # AA = 0: to stop now takes one increment
    row = [Segment(30, bench.outlasting(30, 0x2000))] * 2
    forecast = bench.feed(start, *row)
    stop = bench.command(0x17)
    most = forecast.bounds(stop.taken)[1] - start + 2 + bench.allowance(row[0].period)
    assert forecast.end is not None
    bench.wait_until(forecast.end.latest_ns + 50_000_000)
    moved = bench.position() - start
    bench.at_rest()
    if moved == 60 and stop.kind in (Kind.ACCEPTED, Kind.REFUSED):
        return 0 if stop.kind is Kind.ACCEPTED else 1
    if stop.kind is Kind.ACCEPTED and (moved == 30 or 0 < moved <= most):
        return 2 if moved == 30 else 3
    return f"{stop.kind.value}, {moved} of 60 increments"


@probe(safety=MOVES)
def vel_during_interp(bench: Bench) -> Outcome:
    """15h during a long 16h."""
    bench.ready(0x1000)
    bench.accepted(0x16, segment(100, SLOWEST))
    kind = bench.command(0x15, velocity(1, bench.slowed(0x2000))).kind
    bench.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def sync_without_preload(bench: Bench) -> Outcome:
    """11h at rest."""
    bench.ready()
    return reply_of(bench.command(0x11).kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def sync_arm_lifetime(bench: Bench) -> Outcome:
    """10h, 16h, 13h: whether the move is held."""
    start = bench.ready(0x1000)
    bench.accepted(0x10)
    bench.accepted(0x16, segment(25, bench.period))
    bench.wait(0.1 + bench.lasting_s(25))
    place = bench.position()
    bench.accepted(0x13, start)
    held = is_held(bench, place)
    bench.command(0x11)
    bench.wait(0.1)
    bench.at_rest()
    return 0 if held else 1


@probe(safety=MOVES)
def armed_zero_velocity(bench: Bench) -> Outcome:
    """10h, 15h 0000, 13h: the reply, and whether the move is held."""
    start = bench.ready(0x1000)
    bench.accepted(0x10)
    zero = bench.command(0x15, 0).kind
    bench.command(0x13, start + 30)
    held = is_held(bench, start)
    bench.command(0x11)
    bench.wait(0.1)
    bench.at_rest()
    if zero is Kind.ACCEPTED:
        return 0 if held else 1
    return reply_of(zero, {Kind.REFUSED: 2})


@probe(safety=MOVES)
def sync_during_interp(bench: Bench) -> Outcome:
    """10h, 13h back, two segments, 11h: the places in their order."""
    if bench.known("sync_arm_lifetime"):
        bench.session.skip("segments disarm this device: nothing is left to start")
    start = bench.ready(0x4000)
    bench.accepted(0x10)
    bench.accepted(0x13, start - 100)
    one = Segment(20, bench.outlasting(20, 0x4000))
    first, _ = bench.put(one), bench.put(one)
    # The segments take 82 ms or more; a move that does not wait for them turns back before their
    # end.
    sync = bench.command(0x11)
    bench.taken_in_time(sync, first.taken.earliest_ns + 2 * one.duration_ns, "the segments")
    longer_s = bench.lasting_s(40, one.period - 0x4000) + bench.lasting_s(
        140, bench.period - 0x4000
    )
    places = [at.position - start for at in bench.sampled(0.6 + longer_s, 36)]
    bench.at_rest()
    if places[-1] == -100:
        return 0 if max(places) >= 30 else 1
    return 2 if places[-1] == 40 else f"{sync.kind.value}, places {places}"
