"""Which readings a module follows on software stops, after a stop, and in a restart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mac.axis.driver.client import QUIET_S, Sample
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.motion import DEAF_S
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.probes.running_on import (
    overrun,
    step_from_a_stop,
    travel_guard,
)
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 90  # of this module in a run; see `Family.modules`

PERIOD: Final = 0x1000
FAST: Final = 0x0200  # 15625 inc/s: an axis with inertia brakes over 12 increments
BRAKING_S: Final = 0.3  # of endless motion before a stop is surely met
SUPERIOR: Final = 0x02  # bit of ff
FARTHEST: Final = 160  # increments that a probe here waits for
POLL_S: Final = 0.05
LONGEST_DEAFNESS_S: Final = 61.0
LONGEST_REAL_S: Final = 8.0  # where waiting takes a person's time, and may be for a dead device
CLOCK_S: Final = 0.15  # closer than that to 2 s is 2 s, where only polling tells
SLOWEST_CATCH_UP: Final = 0xFF00
CATCH_UP_NS: Final = 200_000  # for an increment, times the byte of 0Eh (MACS-CMD-0E-01)
UNSTEADY: Final = 5  # increments by which a shaft may be elsewhere than it is led


def rest(driver: AxisDriver) -> int:
    """The place where the axis is once it no longer moves at the speed of `travel_guard`."""
    driver.motion.run_out()
    driver.client.wait(max(0.15, driver.motion.lasting_s(FARTHEST)))
    return driver.client.position()


@probe(safety=MOVES)
def ff_lifetime(driver: AxisDriver) -> Outcome:
    """A software stop tripped, 18h, the stops disabled, a move away: 21h after each."""
    start = travel_guard(driver, 10)
    driver.judge.accepted(0x13, start + 60)
    rest(driver)
    driver.judge.accepted(0x18)
    before = driver.status.stopped_on()
    driver.judge.accepted(0x03, 0)
    is_live = driver.status.stopped_on() != before
    driver.judge.accepted(0x13, start)
    rest(driver)
    after = driver.status.stopped_on()
    if not before:
        return "no stop bit at all"
    if is_live:
        return 1
    return {0: 0, before: 2}.get(after, f"ff {before:02X}, then {after:02X}")


@probe(safety=MOVES)
def status_ff_layout(driver: AxisDriver) -> Outcome:
    """The bit of ff after a trip of the superior software stop."""
    start = travel_guard(driver, 10)
    driver.judge.accepted(0x13, start + 60)
    rest(driver)
    ff = driver.status.stopped_on()
    return {SUPERIOR: 0, SUPERIOR << 1: 1}.get(ff, f"ff {ff:02X}")


@probe(safety=MOVES)
def soft_stop_compare(driver: AxisDriver) -> Outcome:
    """Parked on a software stop, a move further out: whether it makes a step."""
    return step_from_a_stop(driver)


@probe(safety=MOVES)
def soft_stop_blocks(driver: AxisDriver) -> Outcome:
    """Parked 30 increments beyond a software stop, a move back."""
    start = travel_guard(driver, -30)
    kind = driver.client.command(0x13, start - 60).kind
    driver.client.wait(0.1)
    moved = start - rest(driver)
    driver.judge.accepted(0x03, 0)
    if kind is ReplyKind.ACCEPTED and moved >= 60:
        return 0
    return 1 if moved <= 0 else f"{kind.value}, {moved} increments back"


@probe(safety=MOVES, needs=("virtual",))
def brake_increments(driver: AxisDriver) -> Outcome:
    """How far a software stop is overrun, slowly and fast: the plant's braking, or a number."""
    if driver.limits.gentle(FAST, BRAKING_S) > FAST:
        driver.session.skip("needs 15625 inc/s and 10000 increments of travel")
    further = driver.readings.known("soft_stop_compare")
    slow, fast = overrun(driver, PERIOD) + further, overrun(driver, FAST) + further
    if slow == fast:  # an ideal plant stands at once; that number is no reading of its own
        is_ideal = driver.session.reading("plant") == "ideal"
        return 0 if slow == 0 and is_ideal else Measured(str(slow))
    return 0 if 0 <= slow < fast else f"overrun by {slow} and {fast} increments"


@probe(safety=MOVES)
def overshoot_return(driver: AxisDriver) -> Outcome:
    """0Bh on the way from -700 to -100, so that the target falls behind; the pace of the return."""
    if driver.readings.known("reset_in_motion"):
        driver.session.skip("0Bh keeps the distance left on this device: no target falls behind")
    start = driver.motion.ready(PERIOD, 1)
    if abs(start) + 1000 > driver.limits.room():
        driver.session.skip("needs counter 0 close by and 2000 increments of travel")
    driver.judge.accepted(0x0E, SLOWEST_CATCH_UP)
    driver.motion.finish(driver.motion.go(-700))
    forecast = driver.motion.go(-100)
    end = forecast.end
    assert end is not None
    while driver.client.position() < -350 and driver.client.target.now_ns < end.earliest_ns:
        pass
    cleared = driver.judge.accepted(0x0B).taken
    here = forecast.bounds(cleared)[0]
    samples = driver.motion.sampled(1.5, 40)
    driver.motion.at_rest()
    driver.motion.ready(PERIOD, 1)
    if abs(here) < driver.limits.room():
        driver.motion.finish(driver.motion.go(-here))
        driver.client.command(0x0B)
    if cleared.latest_ns >= end.earliest_ns:  # the move was over, and its target not behind
        driver.session.skip("its replies take too long to tell")
    return _way_back(driver, samples, -100)


def _way_back(driver: AxisDriver, samples: Sequence[Sample], target: int) -> Outcome:
    """Which reading it is to come back to a target like that: 200 increments take 10 s of catch-up,
    and a tenth of a second in a profile."""
    furthest = max(sample.position for sample in samples)
    turn = [sample.position for sample in samples].index(furthest)
    last = [sample for sample in samples if sample.position == furthest][-1]
    after = samples[turn:]
    if all(_is_caught_up(samples[turn], sample) for sample in after):
        return 0
    arrived = [one for one in after if abs(one.position - target) <= UNSTEADY]
    if samples[-1] not in arrived:
        return f"from {furthest} back to {[one.position for one in after[1:]]}"
    between = [one for one in after if target + 20 < one.position < furthest - 20]
    if not between:
        return 0  # where 20h tells the set-point, a catch-up is not seen at all
    profile_ns = 1e9 * driver.motion.lasting_s(furthest - target)
    least_ns = between[-1].taken.earliest_ns - between[0].taken.latest_ns
    most_ns = arrived[0].taken.latest_ns - last.taken.earliest_ns
    is_profile = least_ns <= 2 * profile_ns and most_ns >= 0.7 * profile_ns
    return 1 if is_profile else f"back in {least_ns / 1e6:.0f} to {most_ns / 1e6:.0f} ms"


def _is_caught_up(before: Sample, after: Sample) -> bool:
    """Whether catch-up gets from the one to the other at the pace of `SLOWEST_CATCH_UP`."""
    pace_ns = (SLOWEST_CATCH_UP >> 8) * CATCH_UP_NS
    least_ns = after.taken.earliest_ns - before.taken.latest_ns
    most_ns = after.taken.latest_ns - before.taken.earliest_ns
    back = before.position - after.position
    return least_ns / pace_ns - UNSTEADY <= back <= most_ns / pace_ns + UNSTEADY


# --- restart -------------------------------------------------------------------------------------


@probe(safety=MOVES)
def reset_reply(driver: AxisDriver) -> Outcome:
    """00h."""
    driver.motion.ready()
    kind = driver.client.within(QUIET_S, 0x00).kind
    _first_answer_ns(driver, driver.client.target.now_ns)
    return {ReplyKind.ACCEPTED: 0, ReplyKind.SILENCE: 1}.get(kind, kind.value)


@probe(safety=MOVES)
def boot_time_ms(driver: AxisDriver) -> Outcome:
    """20h every 50 ms after 00h; where time is exact, closer and closer to the first answer."""
    driver.motion.ready()
    low_ms, high_ms = _deafness(driver)
    if high_ms < 0:
        driver.client.wait(DEAF_S + 0.5)
        is_put_off = driver.client.within(POLL_S, 0x20).kind is ReplyKind.ANSWER
        told = " while queries come, one behind a silence" if is_put_off else ""
        return f"no answer for {_longest_s(driver):.0f} s after 00h{told}"
    if not driver.client.target.is_lossless:  # what comes late shifts every edge
        is_default = abs(high_ms / 1000 - DEAF_S) <= CLOCK_S + 2 * driver.client.target.line_s
        return Measured(f"{DEAF_S * 1000:.0f}" if is_default else str(high_ms))
    while high_ms - low_ms > 1:
        middle_ms = (low_ms + high_ms) // 2
        if _listens_after(driver, middle_ms):
            high_ms = middle_ms
        else:
            low_ms = middle_ms
        driver.client.wait(high_ms / 1000 + POLL_S)
    return Measured(str(high_ms))


def restarted_ns(driver: AxisDriver) -> int:
    """Send 00h; when its reply, or what there would be of it, was over."""
    exchange = driver.client.within(QUIET_S, 0x00)
    if exchange.kind is ReplyKind.SILENCE:  # it restarts when it has taken the frame (MACS-AMB-20)
        return exchange.taken.earliest_ns
    return exchange.taken.latest_ns


def _deafness(driver: AxisDriver) -> tuple[int, int]:
    """Bounds in ms of the deaf time after 00h, from polling; -1: it never listened again."""
    since_ns = restarted_ns(driver)
    answer_ns = _first_answer_ns(driver, since_ns)
    high_ms = -1 if answer_ns is None else -(-(answer_ns - since_ns) // 1_000_000)
    poll_ms = 200 + round(driver.client.target.line_s * 1000)  # from one query in vain to the next
    return max(0, high_ms - poll_ms), high_ms


def _longest_s(driver: AxisDriver) -> float:
    return LONGEST_DEAFNESS_S if driver.client.target.is_virtual else LONGEST_REAL_S


def _first_answer_ns(driver: AxisDriver, from_ns: int) -> int | None:
    """When the module was first heard again."""
    while driver.client.target.now_ns < from_ns + _longest_s(driver) * 1e9:
        exchange = driver.client.within(POLL_S, 0x20)
        if exchange.kind is ReplyKind.ANSWER:
            return exchange.taken.earliest_ns
    return None


def _listens_after(driver: AxisDriver, deaf_ms: int) -> bool:
    """Whether a query is heard whose first byte comes so long after the reply to 00h."""
    since_ns = restarted_ns(driver)
    driver.client.wait_until(since_ns + deaf_ms * 1_000_000)
    kind = driver.client.within(POLL_S, 0x20).kind
    return kind is ReplyKind.ANSWER


@probe(safety=MOVES)
def persist_modes(driver: AxisDriver) -> Outcome:
    """02h and 03h changed, 00h, 26h; and changed back, for either may be as from the factory."""
    driver.motion.ready()
    are_kept = True
    for _ in range(2):
        now = driver.client.value(0x26) & 0xFFFF
        driver.client.command(0x02, 1 - (now >> 12 & 1))
        driver.client.command(0x03, 8 if now >> 8 & 0xF == 0 else 0)
        changed = driver.client.value(0x26) & 0xFFFF
        if changed == now:
            driver.session.skip("02h and 03h change nothing")
        driver.motion.reinitialise()
        are_kept &= driver.client.value(0x26) & 0xFFFF == changed
        if not are_kept:
            break
    driver.motion.ready()
    return 0 if are_kept else 1
