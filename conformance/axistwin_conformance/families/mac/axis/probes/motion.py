"""Which readings a module follows in its motions, synchronous mode and stops.

First what ends a motion (`AxisMotion.at_rest` rests on it), then what is locked, then ramps and
speeds.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Final

from axistwin_conformance.core.probing import Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import (
    FIFO_STAGES,
    PRELOAD_SHOWS_S,
    segment_parameter,
    velocity,
)
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.kinematics import TICK_NS, Course, ramp_increments
from axistwin_conformance.families.mac.axis.probes.running_on import (
    FASTEST,
    may_go_fast,
    may_see_lag,
    trails,
)
from axistwin_conformance.families.mac.axis.probing import ACCEPTED_OR_REFUSED, MOVES, reply_of

ORDER = 60  # of this module in a run; see `Family.modules`

LONGEST_STOP: Final = 12  # such pauses: a whole ramp of equal increments from its first levels
RAMP_LAWS: Final = ("equal_time", "equal_increments")
TARGET_OUT_OF_RANGE: Final = 0x40000000
ROUNDINGS: Final = ("down", "half_up", "up")  # the soonest end first
STEP_SEEN_NS: Final = 600_000
SWING_READS: Final = 12
SWING_PAUSE_S: Final = 0.003
LONGEST_RAMP: Final = 0xFF
RAMP_PERIOD: Final = 0x0800  # 3906 inc/s, of all questions about ramps
ROUNDING_PERIOD: Final = 0x07F1  # the three roundings of its levels lie evenly apart, 3.3 ms
CHANGED_PERIOD: Final = 0x1400  # at twice the speed before, the three laws lie 160 increments apart
STOP_PERIOD: Final = 0x1000
FIRST_OVER_MS: Final = 300  # of a move of two increments at FFFFh
EQUAL_TIME_MS: Final = 380  # in which 5 increments of a ramp to FFFFh are over, in equal times
MOST_LATE_MS: Final = 50  # of a look at an axis at FFFFh: its increments are 66 ms apart and more
FAR_FROM_ZERO: Final = 500  # increments: to the same number of a cleared counter it takes seconds
ACCELERATED_SLACK: Final = 4  # increments: no formula is given, only its law


# --- what ends a motion --------------------------------------------------------------------------


@probe(safety=MOVES)
def abort_flush(driver: AxisDriver) -> Outcome:
    """Two segments, 18h during the first, a third of 5 steps: whether the second runs too."""
    for _ in range(FIFO_STAGES):
        driver.client.command(0x18)
    driver.client.command(
        0x0F, 0
    )  # no ramp behind the last segment, whatever MACS-AMB-40 is read as
    fast, slow = driver.limits.slowed_alike(0x1000, 0x4000)
    for _ in range(2):
        driver.client.command(0x16, segment_parameter(40, slow))
    driver.client.command(0x18)
    place = driver.client.position()
    driver.client.command(0x16, segment_parameter(5, fast))
    driver.client.wait(PRELOAD_SHOWS_S + driver.motion.lasting_s(45, slow))
    moved = driver.client.position() - place
    if moved < 40:
        return 0
    driver.motion.reinitialise()  # whatever is still stored
    return 1


@probe(safety=MOVES)
def preload_policy(driver: AxisDriver) -> Outcome:
    """10h, 13h, another motion: refused or not; 17h, 11h: whether the first still runs."""
    driver.client.command(0x18)
    start = driver.client.position()
    driver.client.command(0x10)
    driver.client.command(0x13, start + 1000)
    second = driver.client.command(
        0x15, velocity(1, driver.limits.slowed(0x2000))
    )  # never locked, as 13h may be
    driver.client.command(0x17)
    driver.client.command(0x11)
    driver.client.wait(PRELOAD_SHOWS_S)
    driver.client.command(0x18)
    moved = driver.client.position() != start
    if second.kind is ReplyKind.REFUSED:
        return 1
    return 2 if moved else 0


@probe(safety=MOVES)
def preload_locks(driver: AxisDriver) -> Outcome:
    """0Fh while a motion is preloaded."""
    start = driver.motion.ready(SLOWEST)
    driver.judge.accepted(0x10)
    driver.judge.accepted(0x13, start + 50)
    kind = driver.client.command(0x0F, 0).kind
    driver.motion.at_rest()
    return reply_of(kind, ACCEPTED_OR_REFUSED)


def _outlasting(driver: AxisDriver, exchanges: int) -> int:
    """100 increments, or as many more as are still on their way after so many exchanges."""
    return driver.limits.way_outlasting(100, driver.motion.period, exchanges + 1)


@probe(safety=MOVES)
def motion_lock_set(driver: AxisDriver) -> Outcome:
    """09h, 0Ah, 0Dh and 0Fh during a slow move: what most of them do; each has its own check."""
    start = driver.motion.ready(SLOWEST)
    same = {
        0x09: driver.client.parameter(0x09),
        0x0A: driver.client.parameter(0x0A),
        0x0D: SLOWEST,
        0x0F: 0,
    }
    driver.judge.accepted(0x13, start + _outlasting(driver, 1 + len(same)))
    kinds = [driver.client.command(index, parameter).kind for index, parameter in same.items()]
    driver.motion.at_rest()
    if not set(kinds) <= {ReplyKind.ACCEPTED, ReplyKind.REFUSED}:
        return ", ".join(kind.value for kind in kinds)
    return int(kinds.count(ReplyKind.ACCEPTED) > len(kinds) // 2)


@probe(safety=MOVES)
def busy_after_abort(driver: AxisDriver) -> Outcome:
    """27h after 13h and 18h."""
    start = driver.motion.ready(SLOWEST)
    driver.judge.accepted(0x13, start + _outlasting(driver, 2))
    driver.client.wait(0.1)
    driver.client.command(0x18)
    driver.client.wait(0.1)
    return int(driver.status.is_busy())


@probe(safety=MOVES)
def busy_after_17h(driver: AxisDriver) -> Outcome:
    """27h after 13h and 17h."""
    start = driver.motion.ready(SLOWEST)
    way = _outlasting(driver, 2)
    exchange = driver.judge.accepted(0x13, start + way)
    driver.client.wait(0.1)
    stop = driver.judge.accepted(0x17)
    end = driver.motion.to_position(exchange, start, start + way).stopped(stop.taken).end
    assert end is not None
    driver.client.wait_until(end.latest_ns + 50_000_000)
    return int(driver.status.is_busy())


@probe(safety=MOVES)
def vel_reverse_cmd(driver: AxisDriver) -> Outcome:
    """15h with the other direction in endless motion; where 15h knows but one, in a move down."""
    start = driver.motion.ready(SLOWEST)
    driver.client.command(0x15, velocity(-1, SLOWEST))
    driver.client.wait(driver.motion.lasting_s(10))
    goes_down = driver.client.position() < start
    kind = driver.client.command(0x15, velocity(1, SLOWEST)).kind
    driver.motion.at_rest()
    if goes_down:
        return reply_of(kind, ACCEPTED_OR_REFUSED)
    kind = _replied_in_a_move(driver, -1)
    if kind is ReplyKind.REFUSED and _replied_in_a_move(driver, 1) is kind:
        return 0, 1  # 15h is refused in every move (MACS-AMB-29)
    return reply_of(kind, ACCEPTED_OR_REFUSED)


def _replied_in_a_move(driver: AxisDriver, direction: int) -> ReplyKind:
    """The reply to 15h, upwards, during a far 13h."""
    start = driver.motion.ready(SLOWEST)
    driver.client.command(0x13, start + direction * _outlasting(driver, 2))
    kind = driver.client.command(0x15, velocity(1, SLOWEST)).kind
    driver.motion.at_rest()
    return kind


@probe(safety=MOVES)
def vel_during_position(driver: AxisDriver) -> Outcome:
    """15h during a far 13h."""
    return reply_of(_replied_in_a_move(driver, 1), ACCEPTED_OR_REFUSED)


# --- ramps and instants --------------------------------------------------------------------------
#
# In this order most begin with the period and the ramp of the one before, and the last of them with
# those of most checks: no EEPROM write.


@probe(safety=MOVES)
def step_phase(driver: AxisDriver) -> Outcome:
    """One increment of a ramp's first level at FFFFh, 131 ms: the counter half-way through it."""
    start = driver.motion.ready(SLOWEST, 1)
    begun = driver.judge.accepted(0x13, start + 1).taken
    driver.client.wait(0.04)
    sample = driver.client.sample()
    if sample.taken.latest_ns - begun.earliest_ns >= 16 * driver.motion.period * TICK_NS:
        driver.session.skip("its replies take too long to tell")
    early = sample.position - start
    driver.client.wait(0.2)
    late = driver.client.position() - start
    return {(0, 1): 0, (1, 1): 1}.get((early, late), f"{early}, then {late} of 1 increment")


@probe(safety=MOVES, needs=("virtual",))
def motion_start_ref(driver: AxisDriver) -> Outcome:
    """The instant of a step, told from both ends of the exchange that started the motion."""
    start = driver.motion.ready(SLOWEST, 1)
    first_ns = 16 * driver.motion.period * TICK_NS
    steps = 1 + driver.readings.known(
        "step_phase"
    )  # the step that comes one increment after the start
    exchange = driver.judge.accepted(0x13, start + 3)
    etx_ns = exchange.taken.earliest_ns
    # A query that ends just after the step if that is counted from Etx, and is taken before it is
    # due if it is counted from the end of the reply.
    driver.client.wait_until(etx_ns + first_ns + 2 * TICK_NS * 8 - driver.client.frame_ns)
    sample = driver.client.sample()
    driver.motion.at_rest()
    if sample.taken.latest_ns >= exchange.taken.latest_ns + first_ns:
        driver.session.skip("its replies take too long to tell")
    moved = sample.position - start
    return {steps: 0, steps - 1: 1}.get(moved, f"{moved} increments")


@probe(safety=MOVES)
def triangle_law(driver: AxisDriver) -> Outcome:
    """A move of two increments at FFFFh: both on the first level, 262 ms, or on the second.  Where
    the levels of a ramp are of equal increments, so is one of fourteen, and not one of two."""
    start = driver.motion.ready(SLOWEST, 1)
    exchange = driver.judge.accepted(0x13, start + 2)
    # Where a step counts at its beginning, the second one begins after 131 ms, or after 66 ms.
    is_early = driver.readings.known("step_phase")
    moved = _moved_by(driver, exchange, start, 100 if is_early else 200)
    if moved != 1:
        return {2: 1}.get(moved, f"{moved} of 2 increments before the second is due")
    driver.client.wait_until(exchange.taken.latest_ns + FIRST_OVER_MS * 1_000_000)
    start += 2
    exchange = driver.judge.accepted(0x13, start + 14)
    if _moved_by(driver, exchange, start, EQUAL_TIME_MS) >= 5:
        return 0  # levels of equal time: of equal increments 2 are over, and the third has begun
    # The last one is over after 1834 ms, or after 1703 ms; it begins 131 ms before.
    moved = _moved_by(driver, exchange, start, 1768 - (131 if is_early else 0))
    return {13: 0, 14: 1}.get(moved, f"{moved} of 14 increments before the last is due")


def _moved_by(driver: AxisDriver, exchange: AxisExchange, start: int, look_ms: int) -> int:
    """How many increments from `start` the axis is, so long after a command was taken."""
    driver.client.wait_until(exchange.taken.earliest_ns + look_ms * 1_000_000)
    sample = driver.client.sample()
    late_ms = (sample.taken.latest_ns - exchange.taken.earliest_ns) / 1_000_000 - look_ms
    if late_ms > min(look_ms // 4, MOST_LATE_MS):
        driver.session.skip("its replies take too long to tell")
    return sample.position - start


def _ready_for_a_ramp(driver: AxisDriver, coefficient: int) -> tuple[int, float]:
    """Where the axis then is, and how many times longer a ramp takes than at the speed for which
    the pauses of a question are chosen: exchanges here must be short beside it."""
    start = driver.motion.ready(driver.limits.unhurried(RAMP_PERIOD), coefficient)
    return start, driver.motion.period / RAMP_PERIOD


@probe(safety=MOVES)
def ramp_law(driver: AxisDriver) -> Outcome:
    """A move of two ramps, sampled: the two laws differ by 1.69 in time."""
    start, pace = _ready_for_a_ramp(driver, 2)
    distance = 2 * ramp_increments(2)
    exchange = driver.judge.accepted(0x13, start + distance)
    laws = [replace(driver.readings.law_of(2), ramp=name) for name in RAMP_LAWS]
    forecasts = [driver.motion.to_position(exchange, start, start + distance, law) for law in laws]
    samples = driver.motion.sampled(0.45 * pace, 12)
    driver.client.command(0x18)
    fitting = driver.motion.fit(samples, forecasts)
    if not fitting:
        seen = ", ".join(f"{sample.position - start} in {sample.taken}" for sample in samples)
        return f"a ramp that fits neither law: {seen}"
    return tuple(fitting)


@probe(safety=MOVES)
def vel_change_law(driver: AxisDriver) -> Outcome:
    """15h to another speed in motion, sampled."""
    driver.motion.ready(RAMP_PERIOD, 2)
    after = driver.limits.unhurried(CHANGED_PERIOD, SLOWEST // 2)
    before, after = driver.limits.slowed_alike(2 * after, after)
    origin = driver.client.position()
    start = driver.judge.accepted(0x15, velocity(1, before))
    climb_ticks = Course.endless(before, 2, driver.readings.law_of(2)).profile.ticks_of(
        ramp_increments(2)
    )
    driver.client.wait(climb_ticks * TICK_NS / 1e9 + 0.03)
    change = driver.judge.accepted(0x15, velocity(1, after))
    law = driver.readings.law_of(2)
    unchanged = driver.motion.to_velocity(start, origin, 1, before)
    ramped, accelerated, stepped = (
        driver.motion.to_velocity(start, origin, 1, before, replace(law, change=name)).changed(
            change.taken, after
        )
        for name in ("ramp_length", "constant_acceleration", "step")
    )
    samples = driver.motion.sampled(0.8 * after / CHANGED_PERIOD, 16)
    driver.client.command(0x18)
    if stray := driver.motion.beyond(samples, unchanged, stepped):
        return f"{stray} between the old speed and the new one"
    is_step = bool(driver.motion.fit(samples, [stepped]))
    if driver.readings.known("ramp_law"):
        # The ledger has no formula of a change on such ramps, but none is ahead of this one.
        slower = () if driver.motion.beyond(samples, unchanged, ramped) else (0, 1)
        fitting = (*slower, *((2,) if is_step else ()))
        return fitting or "faster than a ramp, slower than a step"
    is_ramp = bool(driver.motion.fit(samples, [ramped]))
    if is_ramp or is_step:
        is_even = not driver.motion.beyond(samples, accelerated, accelerated, ACCELERATED_SLACK)
        fits = (is_ramp, is_even, is_step)
        return tuple(number for number, does_fit in enumerate(fits) if does_fit)
    # The ledger gives no formula for the third: it must end at the new speed all the same.
    first, last = samples[-3], samples[-1]
    least, most = (
        (last.taken.earliest_ns - first.taken.latest_ns) // (after * TICK_NS) - 2,
        (last.taken.latest_ns - first.taken.earliest_ns) // (after * TICK_NS) + 2,
    )
    moved = last.position - first.position
    return 1 if least <= moved <= most else f"{moved} increments where {least}..{most} are due"


@probe(safety=MOVES)
def stop_ramp_law(driver: AxisDriver) -> Outcome:
    """17h in the middle of a ramp: the climbed increments are descended, or a whole ramp."""
    start, pace = _ready_for_a_ramp(driver, 4)
    whole = ramp_increments(4)
    distance = min(driver.limits.room(), 3 * whole)
    exchange = driver.judge.accepted(0x13, start + distance)
    driver.client.wait(0.05 * pace)
    stop = driver.judge.accepted(0x17)
    moving = driver.motion.to_position(
        exchange, start, start + distance, replace(driver.readings.law_of(4), stop="climbed")
    )
    samples = driver.motion.sampled(0.6 * pace, 8)
    stopped = moving.stopped(stop.taken)
    # Of the other reading only the number of increments is given, not their periods.
    first, last = (whole + 1 + place for place in moving.bounds(stop.taken))
    slack = 2 + driver.limits.allowance(driver.motion.period)
    if driver.motion.fit(samples, [stopped]):
        return 0 if stopped.final[1] < first - slack else (0, 1)
    place, rest = start, driver.client.position()
    for _ in range(LONGEST_STOP):
        if rest == place:
            break
        driver.client.wait(pace)
        place, rest = rest, driver.client.position()
    is_whole = first - slack <= rest <= last + slack
    return 1 if is_whole else f"at rest {rest - start} increments on"


@probe(safety=MOVES, needs=("virtual",))
def period_rounding(driver: AxisDriver) -> Outcome:
    """A long move with AA = FFh: the rounding of 61200 periods adds up to milliseconds."""
    distance = 2 * ramp_increments(LONGEST_RAMP)
    if distance > driver.limits.room():
        driver.session.skip(f"needs {2 * distance} increments of travel")
    start = driver.motion.ready(ROUNDING_PERIOD, LONGEST_RAMP)
    # When the last step counts, by each rounding; they lie 3.3 ms apart, an exchange takes 12.
    counted = distance - driver.readings.known("step_phase")
    law = driver.readings.law_of(LONGEST_RAMP)
    ends_ns = [
        Course.to_position(
            distance, driver.motion.period, LONGEST_RAMP, replace(law, rounding=name)
        ).profile.ticks_of(counted)
        * TICK_NS
        for name in ROUNDINGS
    ]
    for number, (due_ns, next_ns) in enumerate(pairwise(ends_ns)):
        target = start + distance if number == 0 else start
        exchange = driver.judge.accepted(0x13, target)
        etx_ns = exchange.taken.edges[driver.readings.known("motion_start_ref")]
        driver.client.wait_until(etx_ns + due_ns + STEP_SEEN_NS - driver.client.frame_ns)
        sample = driver.client.sample()
        if sample.taken.latest_ns >= etx_ns + next_ns:
            driver.session.skip("its replies take too long to tell")
        if sample.position == target:
            return (1, 0)[number]
        driver.client.wait(0.1)
    return 2


@probe(safety=MOVES, needs=("virtual",))
def plant(driver: AxisDriver) -> Outcome:
    """Without ramp to 80000 inc/s: whether the axis is there at once."""
    if not may_go_fast(driver):
        driver.session.skip("needs 80000 inc/s and 8000 increments of travel")
    if trails(driver, driver.motion.ready(FASTEST, 0), FASTEST):
        return 1
    return 0 if may_see_lag(driver) else (0, 1)


@probe(safety=MOVES)
def standby_swing(driver: AxisDriver) -> Outcome:
    """20h a few times in standby after a move."""
    start = driver.motion.ready()
    driver.judge.accepted(0x02, 1)
    end = driver.motion.go(start + 50).end
    assert end is not None
    driver.client.wait_until(end.latest_ns + 100_000_000)
    places = set()
    for number in range(SWING_READS):  # at no even pace: it must not fall in with the swing's
        driver.client.wait(number * SWING_PAUSE_S)
        places.add(driver.client.position() - start)
    driver.judge.accepted(0x18)
    driver.client.command(0x02, 0)
    if places == {50}:
        return 0
    return 1 if places <= {49, 50, 51} else f"{sorted(places)} where 50 is the place held"


@probe(safety=MOVES)
def vel_f6_direction(driver: AxisDriver) -> Outcome:
    """15h with SS = F6h, then 20h."""
    start = driver.motion.ready()
    period = driver.limits.slowed(0x2000)
    driver.judge.accepted(0x15, velocity(-1, period))
    driver.client.wait(driver.motion.lasting_s(20, period))
    driver.client.command(0x18)
    moved = driver.client.position() - start
    return 0 if moved < 0 else 1 if moved > 0 else "no motion at all"


@probe(safety=MOVES)
def reset_in_motion(driver: AxisDriver) -> Outcome:
    """0Bh during 13h, then the final 20h: the target stays a number, or the distance left stays."""
    return cleared_in_a_move(driver)[0]


def cleared_in_a_move(driver: AxisDriver) -> tuple[Outcome, int]:
    """Clear the counter during a move; tell what became of it, and put the counter's 0 back.

    The second value is the reply's window: how far from the start the counter was cleared.
    """
    period = driver.limits.outlasting(150, 0x4000, 6)
    distance = driver.limits.way_outlasting(150, period, 3)
    far = abs(driver.client.position())
    if far > FAR_FROM_ZERO and driver.limits.fits(-distance):
        driver.motion.finish(driver.motion.go_plainly(-distance))
    start = driver.motion.ready(period, 0)
    if abs(start) > driver.limits.room() // 2:
        driver.session.skip(f"counter 0 is {abs(start)} increments away")
    target = start + distance
    forecast = driver.motion.go(target)
    driver.client.wait(0.15)
    cleared = driver.judge.accepted(0x0B)
    lowest, highest = forecast.bounds(cleared.taken)
    driver.client.wait(0.8 + abs(target) * 2 * driver.motion.period * TICK_NS / 1e9)
    final = driver.client.position()
    # 0Bh made some place in lowest..highest the new 0.
    remaining = range(target - highest - 1, target - lowest + 2)
    outcome: Outcome = f"rest at {final}"
    if final == target and final not in remaining:
        outcome = 0
    elif final in remaining:
        outcome = 1
    driver.motion.at_rest()
    if abs(lowest) <= driver.limits.room():
        driver.motion.finish(driver.motion.go(-lowest))
        driver.client.command(0x0B)
    assert forecast.end is not None
    driver.motion.taken_in_time(cleared, forecast.end.earliest_ns, "the motion")
    return outcome, lowest


@probe(safety=MOVES)
def target_range(driver: AxisDriver) -> Outcome:
    """13h 40000000, the reply only, then 18h."""
    driver.motion.ready(SLOWEST, 1)
    if not driver.limits.fits(TARGET_OUT_OF_RANGE):
        return "a device that does not refuse would go there: needs --max-travel 2147483648"
    kind = driver.client.command(0x13, TARGET_OUT_OF_RANGE).kind
    driver.motion.at_rest()
    return reply_of(kind, {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1})
