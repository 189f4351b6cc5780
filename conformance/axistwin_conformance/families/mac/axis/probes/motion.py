"""Which readings a module follows in its motions, synchronous mode and stops.

First what ends a motion (`Bench.at_rest` rests on it), then what is locked, then ramps and speeds.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.motion import (
    FIFO_STAGES,
    PRELOAD_SHOWS_S,
    SLOWEST,
    Bench,
    segment,
    velocity,
)
from axistwin_conformance.families.mac.axis.exchanges import Kind
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, Course, ramp_increments
from axistwin_conformance.families.mac.axis.probes.running_on import FASTEST, may_go_fast
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES, reply_of

ORDER = 60  # of this module in a run; see `Family.modules`

RAMP_LAWS: Final = ("equal_time", "equal_increments")
TARGET_OUT_OF_RANGE: Final = 0x40000000
ROUNDINGS: Final = ("down", "half_up", "up")  # the soonest end first
STEP_SEEN_NS: Final = 600_000
SWING_READS: Final = 12
SWING_PAUSE_S: Final = 0.003
LONGEST_RAMP: Final = 0xFF
ROUNDING_PERIOD: Final = 0x07F1  # the three roundings of its levels lie evenly apart, 3.3 ms
STOP_PERIOD: Final = 0x1000
FAR: Final = 100_000


# --- what ends a motion --------------------------------------------------------------------------


@probe(safety=MOVES)
def abort_flush(bench: Bench) -> Outcome:
    """Two segments, 18h during the first, a third of 5 steps: whether the second runs too."""
    for _ in range(FIFO_STAGES):
        bench.command(0x18)
    bench.command(0x0F, 0)  # no ramp behind the last segment, whatever MACS-AMB-40 is read as
    fast, slow = bench.slowed_alike(0x1000, 0x4000)
    for _ in range(2):
        bench.command(0x16, segment(40, slow))
    bench.command(0x18)
    place = bench.position()
    bench.command(0x16, segment(5, fast))
    bench.wait(PRELOAD_SHOWS_S + bench.lasting_s(45, slow))
    moved = bench.position() - place
    if moved < 40:
        return 0
    bench.reinitialise()  # whatever is still stored
    return 1


@probe(safety=MOVES)
def preload_policy(bench: Bench) -> Outcome:
    """10h, 13h, another motion: refused or not; 17h, 11h: whether the first still runs."""
    bench.command(0x18)
    start = bench.position()
    bench.command(0x10)
    bench.command(0x13, start + 1000)
    second = bench.command(0x15, velocity(1, bench.slowed(0x2000)))  # never locked, as 13h may be
    bench.command(0x17)
    bench.command(0x11)
    bench.wait(PRELOAD_SHOWS_S)
    bench.command(0x18)
    moved = bench.position() != start
    if second.kind is Kind.REFUSED:
        return 1
    return 2 if moved else 0


@probe(safety=MOVES)
def preload_locks(bench: Bench) -> Outcome:
    """0Fh while a motion is preloaded."""
    start = bench.ready()
    bench.accepted(0x10)
    bench.accepted(0x13, start + 50)
    kind = bench.command(0x0F, 0).kind
    bench.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def motion_lock_set(bench: Bench) -> Outcome:
    """09h, 0Ah, 0Dh and 0Fh during a slow move: what most of them do; each has its own check."""
    start = bench.ready(SLOWEST)
    same = {0x09: bench.value(0x22), 0x0A: bench.value(0x23), 0x0D: SLOWEST, 0x0F: 0}
    bench.accepted(0x13, start + 100)
    kinds = [bench.command(index, parameter).kind for index, parameter in same.items()]
    bench.at_rest()
    if not set(kinds) <= {Kind.ACCEPTED, Kind.REFUSED}:
        return ", ".join(kind.value for kind in kinds)
    return int(kinds.count(Kind.ACCEPTED) > len(kinds) // 2)


@probe(safety=MOVES)
def busy_after_abort(bench: Bench) -> Outcome:
    """27h after 13h and 18h."""
    start = bench.ready(SLOWEST)
    bench.accepted(0x13, start + 100)
    bench.wait(0.1)
    bench.command(0x18)
    bench.wait(0.1)
    return int(bench.is_busy())


# --- ramps and instants --------------------------------------------------------------------------


@probe(safety=MOVES)
def step_phase(bench: Bench) -> Outcome:
    """One increment of a ramp's first level at FFFFh, 131 ms: the counter half-way through it."""
    start = bench.ready(SLOWEST, 1)
    bench.accepted(0x13, start + 1)
    bench.wait(0.04)
    early = bench.position() - start
    bench.wait(0.2)
    late = bench.position() - start
    return {(0, 1): 0, (1, 1): 1}.get((early, late), f"{early}, then {late} of 1 increment")


@probe(safety=MOVES, needs=("virtual",))
def motion_start_ref(bench: Bench) -> Outcome:
    """The instant of a step, told from both ends of the exchange that started the motion."""
    start = bench.ready(SLOWEST, 1)
    first_ns = 16 * bench.period * TICK_NS
    steps = 1 + bench.known("step_phase")  # the step that comes one increment after the start
    exchange = bench.accepted(0x13, start + 3)
    etx_ns = exchange.taken.earliest_ns
    # A query that ends just after the step if that is counted from Etx, and is taken before it is
    # due if it is counted from the end of the reply.
    bench.wait_until(etx_ns + first_ns + 2 * TICK_NS * 8 - bench.frame_ns)
    sample = bench.sample()
    bench.at_rest()
    if sample.taken.latest_ns >= exchange.taken.latest_ns + first_ns:
        bench.session.skip("its replies take too long to tell")
    moved = sample.position - start
    return {steps: 0, steps - 1: 1}.get(moved, f"{moved} increments")


@probe(safety=MOVES)
def ramp_law(bench: Bench) -> Outcome:
    """A move of two ramps, sampled: the two laws differ by 1.69 in time."""
    start = bench.ready(0x0640, 2)
    distance = 2 * ramp_increments(2)
    exchange = bench.accepted(0x13, start + distance)
    laws = [replace(bench.law, ramp=name) for name in RAMP_LAWS]
    forecasts = [bench.to_position(exchange, start, start + distance, law) for law in laws]
    samples = bench.sampled(0.45, 12)
    bench.command(0x18)
    fitting = bench.fit(samples, forecasts)
    if not fitting:
        seen = ", ".join(f"{one.position - start} in {one.taken}" for one in samples)
        return f"a ramp that fits neither law: {seen}"
    return fitting[0]


@probe(safety=MOVES)
def triangle_law(bench: Bench) -> Outcome:
    """A move of two increments at FFFFh: both on the first level, 262 ms, or on the second."""
    start = bench.ready(SLOWEST, 1)
    exchange = bench.accepted(0x13, start + 2)
    # Where a step counts at its beginning, the second one begins after 131 ms, or after 66 ms.
    look_ms = 100 if bench.known("step_phase") else 200
    bench.wait_until(exchange.taken.earliest_ns + look_ms * 1_000_000)
    moved = bench.position() - start
    bench.wait(0.2)
    return {1: 0, 2: 1}.get(moved, f"{moved} of 2 increments after {look_ms} ms")


@probe(safety=MOVES, needs=("virtual",))
def period_rounding(bench: Bench) -> Outcome:
    """A long move with AA = FFh: the rounding of 61200 periods adds up to milliseconds."""
    distance = 2 * ramp_increments(LONGEST_RAMP)
    if distance > bench.room():
        bench.session.skip(f"needs {2 * distance} increments of travel")
    start = bench.ready(ROUNDING_PERIOD, LONGEST_RAMP)
    # When the last step counts, by each rounding; they lie 3.3 ms apart, an exchange takes 12.
    counted = distance - bench.known("step_phase")
    ends_ns = [
        Course.to_position(
            distance, bench.period, LONGEST_RAMP, replace(bench.law, rounding=name)
        ).profile.ticks_of(counted) * TICK_NS
        for name in ROUNDINGS
    ]  # fmt: skip
    for number, (due_ns, next_ns) in enumerate(pairwise(ends_ns)):
        target = start + distance if number == 0 else start
        exchange = bench.accepted(0x13, target)
        etx_ns = exchange.taken.edges[bench.known("motion_start_ref")]
        bench.wait_until(etx_ns + due_ns + STEP_SEEN_NS - bench.frame_ns)
        sample = bench.sample()
        if sample.taken.latest_ns >= etx_ns + next_ns:
            bench.session.skip("its replies take too long to tell")
        if sample.position == target:
            return (1, 0)[number]
        bench.wait(0.1)
    return 2


@probe(safety=MOVES, needs=("virtual",))
def plant(bench: Bench) -> Outcome:
    """Without ramp to 80000 inc/s: whether the axis is there at once."""
    if not may_go_fast(bench):
        bench.session.skip("needs 80000 inc/s and 8000 increments of travel")
    period = FASTEST
    start = bench.ready(period, 0)
    exchange = bench.accepted(0x15, velocity(1, period))
    samples = bench.sampled(0.02, 2)
    bench.command(0x18)
    ideal = bench.to_velocity(exchange, start, 1, period)
    return 0 if bench.fit(samples, [ideal]) else 1


@probe(safety=MOVES)
def standby_swing(bench: Bench) -> Outcome:
    """20h a few times in standby after a move."""
    start = bench.ready()
    bench.accepted(0x02, 1)
    end = bench.go(start + 50).end
    assert end is not None
    bench.wait_until(end.latest_ns + 100_000_000)
    places = set()
    for number in range(SWING_READS):  # at no even pace: it must not fall in with the swing's
        bench.wait(number * SWING_PAUSE_S)
        places.add(bench.position() - start)
    bench.accepted(0x18)
    bench.command(0x02, 0)
    if places == {50}:
        return 0
    return 1 if places <= {49, 50, 51} else f"{sorted(places)} where 50 is the place held"


@probe(safety=MOVES)
def vel_f6_direction(bench: Bench) -> Outcome:
    """15h with SS = F6h, then 20h."""
    start = bench.ready(0x2000)
    bench.accepted(0x15, velocity(-1, bench.period))
    bench.wait(bench.lasting_s(20))
    bench.command(0x18)
    moved = bench.position() - start
    return 0 if moved < 0 else 1 if moved > 0 else "no motion at all"


@probe(safety=MOVES)
def stop_ramp_law(bench: Bench) -> Outcome:
    """17h in the middle of a ramp: the climbed increments are descended, or a whole ramp."""
    start = bench.ready(0x0640, 4)
    distance = min(bench.room(), 3 * ramp_increments(4))
    exchange = bench.accepted(0x13, start + distance)
    bench.wait(0.05)
    stop = bench.accepted(0x17)
    moving = bench.to_position(
        exchange, start, start + distance, replace(bench.law, stop="climbed")
    )
    samples = bench.sampled(0.6, 8)
    if bench.fit(samples, [moving.stopped(stop.taken)]):
        return 0
    # Of the other reading only the number of increments is given, not their periods.
    done = [1 + place - start for place in moving.bounds(stop.taken)]
    bench.wait(2.0)
    rest, whole = bench.position() - start, ramp_increments(4)
    slack = 2 + bench.allowance(bench.period)
    is_whole = done[0] + whole - slack <= rest <= done[1] + whole + slack
    return 1 if is_whole else f"at rest {rest} increments on"


@probe(safety=MOVES)
def vel_change_law(bench: Bench) -> Outcome:
    """15h to another speed in motion, sampled."""
    if bench.known("ramp_law"):
        return _change_by_length(bench)
    bench.ready(0x0800, 2)
    before, after = bench.slowed_alike(0x1000, 0x0A00)
    origin = bench.position()
    start = bench.accepted(0x15, velocity(1, before))
    bench.wait(240 * 2 * before * TICK_NS / 1e9 + 0.03)
    change = bench.accepted(0x15, velocity(1, after))
    forecasts = [
        bench.to_velocity(start, origin, 1, before, replace(bench.law, change=name))
        .changed(change.taken, after)
        for name in ("ramp_length", "step")
    ]  # fmt: skip
    samples = bench.sampled(0.4 * after / 0x0A00, 12)
    bench.command(0x18)
    fitting = bench.fit(samples, forecasts)
    if fitting:
        return 0 if fitting[0] == 0 else 2
    # The ledger gives no formula for the third: it must be on its way from one speed to the other,
    # and end at the new one, all the same.
    unchanged = bench.to_velocity(start, origin, 1, before)
    if stray := bench.beyond(samples, unchanged, forecasts[1]):
        return f"{stray} between the old speed and the new one"
    first, last = samples[-3], samples[-1]
    least, most = (
        (last.taken.earliest_ns - first.taken.latest_ns) // (after * TICK_NS) - 2,
        (last.taken.latest_ns - first.taken.earliest_ns) // (after * TICK_NS) + 2,
    )
    moved = last.position - first.position
    return 1 if least <= moved <= most else f"{moved} increments where {least}..{most} are due"


def _change_by_length(bench: Bench) -> Outcome:
    """The same on ramps of equal increments, for which the ledger has no formula of a change: only
    a change without any ramp shows, at the next increment."""
    bench.ready(0x0800, 2)
    before, after = bench.slowed_alike(0x1000, 0x0A00)
    bench.accepted(0x15, velocity(1, before))
    bench.wait(420 * 2 * before * TICK_NS / 1e9 + 0.03)
    bench.accepted(0x15, velocity(1, after))
    here = bench.sample()
    bench.wait(0.02 * after / 0x0A00)
    there = bench.sample()
    bench.command(0x18)
    gone_ns = there.taken.earliest_ns - here.taken.latest_ns
    return 2 if there.position - here.position >= gone_ns // (after * TICK_NS) - 1 else (0, 1)


@probe(safety=MOVES)
def vel_reverse_cmd(bench: Bench) -> Outcome:
    """15h with the other direction in endless motion."""
    bench.ready(SLOWEST)
    bench.command(0x15, velocity(1, SLOWEST))
    kind = bench.command(0x15, velocity(-1, SLOWEST)).kind
    bench.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def vel_during_position(bench: Bench) -> Outcome:
    """15h during a far 13h."""
    start = bench.ready(SLOWEST)
    bench.command(0x13, start + 100)
    kind = bench.command(0x15, velocity(1, SLOWEST)).kind
    bench.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


@probe(safety=MOVES)
def reset_in_motion(bench: Bench) -> Outcome:
    """0Bh during 13h, then the final 20h: the target stays a number, or the distance left stays."""
    return cleared_in_a_move(bench)[0]


def cleared_in_a_move(bench: Bench) -> tuple[Outcome, int]:
    """Clear the counter during a move; tell what became of it, and put the counter's 0 back.

    The second value is the reply's window: how far from the start the counter was cleared.
    """
    distance = 150
    start = bench.ready(bench.outlasting(distance, 0x4000, 6), 0)
    if abs(start) > bench.room() // 2:
        bench.session.skip(f"counter 0 is {abs(start)} increments away")
    target = start + distance
    forecast = bench.go(target)
    bench.wait(0.15)
    cleared = bench.accepted(0x0B)
    lowest, highest = forecast.bounds(cleared.taken)
    bench.wait(0.8 + abs(target) * 2 * bench.period * TICK_NS / 1e9)
    final = bench.position()
    # 0Bh made some place in lowest..highest the new 0.
    remaining = range(target - highest - 1, target - lowest + 2)
    outcome: Outcome = f"rest at {final}"
    if final == target and final not in remaining:
        outcome = 0
    elif final in remaining:
        outcome = 1
    bench.at_rest()
    if abs(lowest) <= bench.room():
        bench.finish(bench.go(-lowest))
        bench.command(0x0B)
    assert forecast.end is not None
    bench.taken_in_time(cleared, forecast.end.earliest_ns, "the motion")
    return outcome, lowest


@probe(safety=MOVES)
def target_range(bench: Bench) -> Outcome:
    """13h 40000000, the reply only, then 18h."""
    bench.ready(SLOWEST, 1)
    if not bench.fits(TARGET_OUT_OF_RANGE):
        return "a device that does not refuse would go there: needs --max-travel 2147483648"
    kind = bench.command(0x13, TARGET_OUT_OF_RANGE).kind
    bench.at_rest()
    return reply_of(kind, {Kind.REFUSED: 0, Kind.ACCEPTED: 1})
