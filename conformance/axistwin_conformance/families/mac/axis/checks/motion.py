"""Point-to-point motion against the closed form: 13h, 14h, ramps, stops, busy (CMD-13, -14, -0D,
-0F, -17, -18, -1A, BUSY)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.base.errors import OutsideEnvelope
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver, driver_of
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.driver.motion import SAFE_PERIOD
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.forecast import Forecast
from axistwin_conformance.families.mac.axis.model.kinematics import (
    RAMP_LEVELS,
    TICK_NS,
    ramp_increments,
)
from axistwin_conformance.families.mac.axis.probes.motion import (
    ramp_law,
    stop_ramp_law,
    triangle_law,
)
from axistwin_conformance.families.mac.axis.probing import MOVES

ORDER = 120  # of this module in a run; see `Family.modules`

# The table of §5.3: where a profile is one increment off, it shows at these distances.
TOLERATED: Final = ((10, 80), (0, -80), (40, 80), (0xFF, -300))  # tolerance, and the way to go
AS_FAR: Final = 5  # increments to go, and of tolerance
TOLD: Final = {True: "busy", False: "not busy"}
BUSY: Final = 0x08  # of byte cc of 27h: 0 while busy
TABLE: Final = (
    (1, 1), (2, 1), (3, 1), (10, 1), (100, 1), (239, 1), (240, 1), (241, 1), (479, 2), (481, 2),
    (48, 0x80),
)  # fmt: skip
# The last one has levels of more increments than 8 bits count.
LONG_TABLE: Final = ((1000, 1), (1000, 10), (10000, 10), (2100, 0x80))
LONG_WAYS: Final = (0x8000, 0x10000, 0x1000000)  # increments at full speed
ASIDE: Final = 2000  # increments: ramps, and what an axis goes on while its stop is under way
FIRST_TARGET_OUT_OF_RANGE: Final = 0x40000000
RESUMES_S: Final = 0.45  # longer than anything that is late and still belongs to one command


def slow(session: Session) -> int:
    """A period at which single increments show; up to eight times faster where waiting costs time,
    as far as an exchange is then still short beside a ramp."""
    return (
        0x4000
        if session.transport.is_virtual
        else driver_of(session).limits.unhurried(0x0800, 0x4000)
    )


@check("MACS-CMD-0F-01", "MACS-CMD-13-01", "MACS-CMD-13-05", safety=MOVES)
def the_ramp_has_120_increments_per_unit(session: Session) -> None:
    """A move of twice 120·AA increments follows the 16 levels of the ramp, up and down."""
    driver = driver_of(session)
    driver.judge.again(ramp_law, ("MACS-CMD-0F-01", "MACS-CMD-13-01"))
    driver.judge.again(triangle_law, "MACS-CMD-13-05")


@check("MACS-CMD-13-01", "MACS-CMD-13-05", "MACS-CMD-0D-01", "MACS-CMD-0F-01", safety=MOVES)
def moves_take_the_time_of_the_closed_form(session: Session) -> None:
    """13h follows the trapezoid, or the triangle of a short move, and ends on the target."""
    driver = driver_of(session)
    for distance, coefficient in TABLE[:: 1 if session.transport.is_virtual else 2]:
        for direction in (1, -1) if session.transport.is_virtual else (1 if distance & 1 else -1,):
            start = driver.motion.ready(slow(session), coefficient)
            if coefficient == 2:  # a move that has to power the motor has its ramp as well
                driver.judge.accepted(0x1A)
            forecast = driver.motion.go(start + direction * distance)
            driver.motion.watch(
                forecast,
                ("MACS-CMD-13-01", "MACS-CMD-13-05", "MACS-CMD-0D-01", "MACS-CMD-0F-01"),
                samples=4,
            )


def judge_targets_under_sub_indices(driver: AxisDriver) -> None:
    """A 13h with a sub-index other than 00 goes to its target, or is refused and moves nothing."""
    for way, sub_index in ((120, 0x01), (-120, 0xFF), (120, 0xF0)):
        start = driver.motion.ready()
        exchange = driver.client.command(0x13, start + way, sub_index)
        outcomes = {ReplyKind.ACCEPTED: 0, ReplyKind.REFUSED: 1}
        outcome = outcomes.get(exchange.kind, exchange.kind.value)
        driver.judge.reading("subindex_policy", outcome)
        target = start if outcome == 1 else start + way
        driver.motion.finish(driver.motion.to_position(exchange, start, target))


@check("MACS-CMD-13-01", "MACS-CMD-13-05", safety=MOVES, level="full")
def long_moves_take_the_time_of_the_closed_form(session: Session) -> None:
    """The ledger's longer examples at 10000 inc/s, and a ramp longer than the move."""
    driver = driver_of(session)
    shortest = min(distance for distance, _ in LONG_TABLE)
    driver.limits.needs_travel(2 * shortest, f"moves of {shortest} increments and more")
    for distance, coefficient in LONG_TABLE:
        if distance > driver.limits.room():
            continue
        start = driver.motion.ready(800, coefficient)
        driver.motion.watch(
            driver.motion.go(start + distance), ("MACS-CMD-13-01", "MACS-CMD-13-05"), samples=12
        )
        if ramp_increments(coefficient) <= 2 * distance:  # the others take long
            driver.motion.watch(
                driver.motion.go(start), ("MACS-CMD-13-01", "MACS-CMD-13-05"), samples=12
            )


@check("MACS-CMD-15-01", "MACS-CMD-13-01", safety=MOVES, level="full")
def long_ways_are_counted_in_full(session: Session) -> None:
    """Endless motion goes on at full speed, and a move comes back, over more increments than 15
    bits count, and 16 bits; in virtual time 24 bits."""
    driver = driver_of(session)
    driver.limits.needs_room(LONG_WAYS[0] + ASIDE, "motions that no counter of 15 bits holds")
    start = driver.motion.ready(driver.limits.slowed(800), 1)
    most = None if session.transport.is_virtual else 2
    ways = [way for way in LONG_WAYS[:most] if driver.limits.fits(start + way + ASIDE)]
    if len(ways) < 2:
        needed = -(-(LONG_WAYS[1] + ASIDE) * 8 // 7)
        why = OutsideEnvelope("motions that none of 16 bits holds", "--max-travel", needed)
        session.not_run(None, why.reason)
    _go_far(driver, driver.motion.turn(1, driver.motion.period), ways, "MACS-CMD-15-01")
    driver.motion.at_rest()
    target = min(start, driver.client.position() - max(ways) - ASIDE // 2)
    forecast = driver.motion.go(target)
    _go_far(driver, forecast, ways, "MACS-CMD-13-01")
    driver.motion.watch(forecast, "MACS-CMD-13-01", samples=2)


def _go_far(driver: AxisDriver, forecast: Forecast, ways: Sequence[int], name: str) -> None:
    """Judge where the axis is each time that so many increments at full speed are surely over."""
    period = driver.motion.period
    for way in ways:
        cruised_ns = (way + 2 * 240 + ASIDE // 4) * period * TICK_NS
        driver.client.wait_until(forecast.timelines[0].start_ns + cruised_ns)
        driver.motion.follow(forecast, name, driver.limits.allowance(period))


@check("MACS-CMD-0D-01", "MACS-CMD-13-01", safety=MOVES, level="full")
def a_larger_period_is_a_slower_move(session: Session) -> None:
    """Without ramp, D increments take at least D·P ticks, whatever P; the end is exact."""
    driver = driver_of(session)
    for period in (0x0400, 0x1000, 0x4000):
        start = driver.motion.ready(period)
        driver.motion.watch(
            driver.motion.go(start + 60), ("MACS-CMD-0D-01", "MACS-CMD-13-01"), samples=3
        )


@check("MACS-CMD-0F-03", "MACS-CMD-13-01", safety=MOVES, level="full")
def without_ramp_the_move_is_monotone_and_not_too_fast(session: Session) -> None:
    """With AA = 0 a move lasts at least D·P ticks, never turns back, and ends exactly."""
    driver = driver_of(session)
    start = driver.motion.ready(SAFE_PERIOD)
    distance = 1000
    exchange = driver.judge.accepted(0x13, start + distance)
    least_ns = distance * driver.motion.period * TICK_NS
    last = start
    while True:
        sample = driver.client.sample()
        session.expect(
            sample.position >= last, "MACS-CMD-13-01", f"{last} or more", sample.position
        )
        last = sample.position
        elapsed_ns = sample.taken.latest_ns - exchange.taken.earliest_ns
        most = (
            elapsed_ns // (driver.motion.period * TICK_NS)
            + 1
            + driver.limits.allowance(driver.motion.period)
        )
        session.expect(
            last - start <= most,
            "MACS-CMD-0F-03",
            f"at most {most} increments by then",
            last - start,
        )
        if last == start + distance or elapsed_ns > 2 * least_ns + 1_000_000_000:
            break
    session.expect(last == start + distance, "MACS-CMD-13-01", start + distance, last)
    if session.transport.is_virtual:  # no torque and no inertia limits the built-in twin (§5.4)
        driver.motion.watch(driver.motion.go(start), "MACS-CMD-0F-03", samples=3)
        last = start
    driver.client.wait(0.1)
    session.expect(
        driver.client.position() == last,
        "MACS-CMD-13-01",
        f"at rest at {last}",
        driver.client.position(),
    )


@check("MACS-CMD-13-04", "MACS-BUSY-01", safety=MOVES)
def a_move_to_where_it_is_does_nothing(session: Session) -> None:
    """13h to the present position is accepted; no motion, not busy, nothing locked."""
    driver = driver_of(session)
    for coefficient in (0, 5):
        start = driver.motion.ready(SLOWEST, coefficient)
        driver.judge.accepted(0x13, start, requirement="MACS-CMD-13-04")
        session.expect(
            not driver.status.is_busy(), ("MACS-BUSY-01", "MACS-CMD-13-04"), "not busy", "busy"
        )
        driver.judge.accepted(0x0F, coefficient, requirement="MACS-CMD-13-04")
        session.expect(
            driver.client.position() == start, "MACS-CMD-13-04", start, driver.client.position()
        )


@check("MACS-CMD-13-06", "MACS-CMD-13-01", "MACS-REPLY-05", safety=MOVES, level="full")
def targets_beyond_the_counter_are_refused(session: Session) -> None:
    """A target outside the counter's 31 bits is refused, or accepted; its edges are accepted."""
    driver = driver_of(session)
    if not driver.limits.fits(FIRST_TARGET_OUT_OF_RANGE):
        session.skip("a device that does not refuse would go there: needs --max-travel 2147483648")
    for target in (FIRST_TARGET_OUT_OF_RANGE, -FIRST_TARGET_OUT_OF_RANGE - 1, 0x7FFFFFFF):
        start = driver.motion.ready(SLOWEST, 1)
        kind = driver.client.command(0x13, target).kind
        if kind is ReplyKind.REFUSED:
            driver.client.wait(0.3)  # the first increment of a motion would take 0.13 s
        driver.motion.at_rest()
        outcome: int | str = {ReplyKind.REFUSED: 0, ReplyKind.ACCEPTED: 1}.get(kind, kind.value)
        driver.judge.reading("target_range", outcome, "MACS-CMD-13-06")
        if outcome == 0:
            session.expect(
                driver.client.position() == start, "MACS-CMD-13-06", start, driver.client.position()
            )
    for target in (FIRST_TARGET_OUT_OF_RANGE - 1, -FIRST_TARGET_OUT_OF_RANGE):
        start = driver.motion.ready(SLOWEST, 1)
        exchange = driver.client.command(0x13, target)
        driver.motion.at_rest()
        driver.judge.must(ReplyKind.ACCEPTED, exchange, "MACS-CMD-13-01")
    place = driver.motion.ready(SLOWEST, 1)
    driver.judge.accepted(0x10)
    if driver.client.command(0x13, FIRST_TARGET_OUT_OF_RANGE).kind is ReplyKind.REFUSED:
        driver.judge.accepted(0x13, place + 40)
        driver.client.wait(0.3)
        again = driver.client.position()
        session.expect(again == place, "MACS-REPLY-05", f"armed: at {place} until 11h", again)


@check("MACS-CMD-13-03", "MACS-CMD-1A-01", "MACS-CMD-19-01", safety=MOVES)
def a_move_powers_the_motor(session: Session) -> None:
    """After 1Ah, and after 19h, a move runs as ever; 1Ah itself moves nothing at rest."""
    driver = driver_of(session)
    start = driver.motion.ready()
    for index in (0x1A, 0x19, 0x1A):
        name = "MACS-CMD-1A-01" if index == 0x1A else "MACS-CMD-19-01"
        driver.judge.accepted(index, requirement=name)
        place = driver.client.position()
        session.expect(place == start, name, start, place)
        start = driver.motion.finish(driver.motion.go(start + 50), "MACS-CMD-13-03")


@check("MACS-CMD-14-01", safety=MOVES, level="full")
def going_to_0_is_a_move_like_any_other(session: Session) -> None:
    """14h runs the profile of 13h to position 0 and ignores its parameters."""
    driver = driver_of(session)
    start = driver.motion.ready(driver.limits.unhurried(0x0640), 1)
    if abs(start) > driver.limits.room():
        session.skip(f"position 0 is {abs(start)} increments away, outside the envelope")
    for place, parameter in ((150, 0), (-90, 0x00000123), (41, 0xFFFFFFFF)):
        driver.motion.finish(driver.motion.go(place))
        exchange = driver.client.command(0x14, parameter)
        if parameter and exchange.kind is ReplyKind.REFUSED:
            driver.judge.reading("dont_care_digits", 1)
            exchange = driver.client.command(0x14)
        driver.judge.must(ReplyKind.ACCEPTED, exchange)
        driver.motion.watch(driver.motion.to_position(exchange, place, 0), None, samples=3)
    driver.motion.finish(driver.motion.go(150))  # it begins once: 18h right behind it is its end
    driver.judge.accepted(0x14)
    driver.judge.accepted(0x18)
    place = driver.client.position()
    driver.client.wait(RESUMES_S)
    again = driver.client.position()
    session.expect(again == place, None, f"at rest at {place}, where 18h has ended it", again)


@check("MACS-BUSY-01", "MACS-Q-27-03", "MACS-CMD-1C-01", "MACS-Q-20-01", safety=MOVES)
def busy_ends_within_the_tolerance(session: Session) -> None:
    """During a move either way 27h shows busy until the axis is within the tolerance (1Ch) of the
    target; the axis still reaches the target."""
    driver = driver_of(session)
    for tolerance, distance in TOLERATED:
        start = driver.motion.ready(
            0x8000 if session.transport.is_virtual else driver.limits.unhurried(0x4000)
        )
        is_set = not tolerance or driver.client.command(0x1C, tolerance).kind is ReplyKind.ACCEPTED
        if not is_set:
            session.skip("1Ch is not supported: no tolerance to judge by")
        target = start + distance
        if not driver.limits.fits(target):
            continue
        forecast = driver.motion.go(target)
        end = forecast.end
        assert end is not None
        while session.transport.now_ns < end.latest_ns:
            exchange = driver.client.ask(0x27)
            if exchange.reply.data is None:
                session.fail(None, f"an answer to {driver.client.named(0x27)}", exchange.reply)
            lowest, highest = forecast.bounds(exchange.taken)
            slack = driver.limits.allowance(driver.motion.period)
            is_busy = not exchange.reply.data_bytes()[2] & BUSY
            places = range(lowest - slack, highest + slack + 1)
            admissible = {abs(target - place) > tolerance for place in places}
            least, most = sorted((abs(target - highest), abs(target - lowest)))
            # An increment more or less (AMB-41) is no fault of the busy line.
            session.expect(
                is_busy in admissible,
                ("MACS-BUSY-01", "MACS-Q-27-03", "MACS-CMD-1C-01"),
                _busy_words(admissible, least, most, tolerance),
                partial(
                    _busy_seen,
                    exchange,
                    start,
                    driver.motion.settings_words(),
                    least,
                    most,
                    tolerance,
                    admissible,
                ),
            )
            if tolerance >= abs(distance) // 2:  # it must not count as if it were there
                driver.motion.follow(forecast, "MACS-Q-20-01", slack)
        driver.motion.finish(forecast, "MACS-BUSY-01")
        session.expect(
            not driver.status.is_busy(),
            ("MACS-BUSY-01", "MACS-Q-27-03"),
            "not busy at the target",
            "busy",
        )
    _judge_edges_of_busy(driver)


def _judge_edges_of_busy(driver: AxisDriver) -> None:
    """Before the first increment it is busy already, on a way longer than the tolerance; on one
    just as long it is not, and the axis goes it all the same."""
    driver.motion.ready(SLOWEST, 1)
    driver.judge.accepted(0x1C, AS_FAR)
    for distance, is_busy in ((8 * AS_FAR, True), (-AS_FAR, False)):
        start = driver.client.position()
        forecast = driver.motion.go(start + distance)
        for _ in range(3):
            before, seen = driver.client.position(), driver.status.is_busy()
            if before == driver.client.position() == start:
                driver.session.expect(
                    seen == is_busy,
                    ("MACS-BUSY-01", "MACS-CMD-1C-01"),
                    f"{TOLD[is_busy]}, {abs(distance)} increments to go, tolerance {AS_FAR}",
                    TOLD[seen],
                )
        if not is_busy:  # however near it is, it is a move
            driver.motion.finish(forecast, ("MACS-BUSY-01", "MACS-CMD-1C-01"))
        driver.motion.at_rest()


def _busy_seen(
    exchange: AxisExchange,
    start: int,
    settings: str,
    least: int,
    most: int,
    tolerance: int,
    admissible: set[bool],
) -> Observation:
    """What 27h showed with so many increments to go, in words."""
    state = exchange.reply.data_bytes()[2]
    told, bit = ("not busy", 1) if state & BUSY else ("busy", 0)
    return Observation(
        f"on the move from position {start} {settings}, with {least}..{most} increments to go, as"
        f" predicted, and tolerance {tolerance} (1Ch), {REQUEST} showed {told}"
        f" (cc = {state:02X}h, bit 3 = {bit})",
        value=told,
        wanted=" or ".join(
            "busy (bit 3 = 0: as 27h has it, the motor does not yet follow)"
            if is_busy
            else "not busy (bit 3 = 1)"
            for is_busy in sorted(admissible)
        ),
        is_whole=False,
    )


def _busy_words(admissible: set[bool], least: int, most: int, tolerance: int) -> str:
    """What 27h must tell with so many increments to go."""
    told = " or ".join("busy" if is_busy else "not busy" for is_busy in sorted(admissible))
    bit = "bit 3 of the third byte of 27h, 0 if busy"
    return f"{told} ({bit}), with {least}..{most} increments to go and tolerance {tolerance}"


# --- stops ---------------------------------------------------------------------------------------


def locked_on_the_way_down(driver: AxisDriver, stopped: Forecast) -> None:
    """Judge that 13h is refused while a ramped stop slows the axis down, if there is time for it
    on this line: to the place where the axis will come to rest, for a module that takes it."""
    end, now_ns = stopped.end, driver.client.target.now_ns
    assert end is not None
    if end.earliest_ns - now_ns < 2 * driver.client.target.uncertainty_ns:
        return
    exchange = driver.client.command(0x13, stopped.final[0])
    driver.motion.taken_in_time(exchange, end.earliest_ns, "the motion")
    driver.judge.must(ReplyKind.REFUSED, exchange, ("MACS-CMD-13-02", "MACS-STATE-01"))


@check("MACS-CMD-17-01", "MACS-CMD-13-02", "MACS-STATE-01", safety=MOVES)
def a_ramped_stop_in_full_motion_takes_one_ramp(session: Session) -> None:
    """17h in cruise comes to rest one ramp further on, on the ramp, and stays there; until then
    the axis counts as running."""
    driver = driver_of(session)
    driver.limits.needs_room(4 * ramp_increments(1) + 400, "a ramp, full speed and a ramp again")
    for coefficient in (1, 3):
        start = driver.motion.ready(0x0640, coefficient)
        target = start + 4 * ramp_increments(coefficient) + 400
        if not driver.limits.fits(target):
            continue
        forecast = driver.motion.go(target)
        cruise_s = driver.readings.climbing_s(driver.motion.period, coefficient)
        cruise_s += driver.motion.lasting_s(150)
        driver.client.wait_until(forecast.timelines[0].start_ns + round(cruise_s * 1e9))
        stopped = forecast.stopped(driver.judge.accepted(0x17).taken)
        locked_on_the_way_down(driver, stopped)
        driver.motion.watch(stopped, "MACS-CMD-17-01", samples=4)
        driver.client.wait(0.3)
        place = driver.client.position()
        lowest, highest = stopped.final
        session.expect(
            lowest <= place <= highest,
            "MACS-CMD-17-01",
            f"at rest at {lowest}..{highest}, no creeping on to the target",
            place,
        )
        driver.judge.reading("busy_after_17h", int(driver.status.is_busy()), "MACS-CMD-17-01")


@check("MACS-CMD-17-01", safety=MOVES, level="full")
def a_ramped_stop_on_the_ramp_descends_what_was_climbed(session: Session) -> None:
    """17h early in a long ramp comes to rest after the climbed increments, or a whole ramp."""
    driver = driver_of(session)
    driver.judge.again(stop_ramp_law)


@check("MACS-CMD-17-01", safety=MOVES, level="full")
def a_ramped_stop_while_slowing_down_changes_nothing(session: Session) -> None:
    """17h on the descending ramp: that is where the axis was going anyway."""
    driver = driver_of(session)
    start = driver.motion.ready(driver.limits.outlasting(60, slow(session), exchanges=1), 1)
    forecast = driver.motion.go(start + 200)
    end = forecast.end
    assert end is not None
    driver.client.wait_until(end.earliest_ns - 60 * driver.motion.period * TICK_NS)
    stop = driver.judge.accepted(0x17)
    if driver.readings.known("stop_ramp_law"):
        # Whether a whole ramp is due here as well, the ledger does not say (MACS-AMB-45).
        driver.motion.taken_in_time(stop, end.earliest_ns, "the move")
        lowest, highest = forecast.bounds(stop.taken)
        whole, slack = ramp_increments(1), 2 + driver.limits.allowance(driver.motion.period)
        place, moved = start, driver.client.position()
        while place != moved <= highest + 1 + whole + slack:
            driver.client.wait(driver.motion.lasting_s(2 * RAMP_LEVELS))  # two of its slowest steps
            place, moved = moved, driver.client.position()
        if lowest + whole - slack <= moved <= highest + 1 + whole + slack:
            session.expect(True, None, "a whole ramp further on", moved)
            return
    place = driver.motion.watch(forecast, None, samples=2)
    session.expect(place == start + 200, None, start + 200, place)


@check("MACS-CMD-18-01", "MACS-CMD-18-03", safety=MOVES)
def a_hard_stop_stops_where_the_axis_is(session: Session) -> None:
    """18h ends a move, or an endless motion, without ramp at a valid position, even on the way down
    from it; nothing resumes, the next move is exact."""
    driver = driver_of(session)
    rows = (("13h", 0, 0.0), ("13h", 0, 0.12), ("13h", 2, 0.12), ("15h", 2, 0.12), ("17h", 2, 0.12))
    for name, coefficient, moving_s in rows:
        way, is_move = min(1500, driver.limits.room()), name == "13h"
        period = driver.limits.outlasting(way, SAFE_PERIOD)
        if not is_move:
            period = driver.limits.gentle(period, 0.4)
        start = driver.motion.ready(period, coefficient)
        forecast = driver.motion.go(start + way) if is_move else driver.motion.turn(1, period)
        driver.client.wait(moving_s)
        if name == "17h":
            driver.client.wait(driver.readings.climbing_s(driver.motion.period, coefficient))
            forecast = forecast.stopped(driver.judge.accepted(0x17).taken)
        halted = forecast.halted(driver.judge.accepted(0x18).taken)
        lowest, highest = halted.final
        braking = driver.limits.braking(driver.motion.period)
        place = driver.client.position()
        session.expect(
            lowest <= place <= highest + 1 + braking,
            "MACS-CMD-18-01",
            f"{lowest}..{highest + 1 + braking}",
            place,
        )
        driver.client.wait(RESUMES_S)
        again = driver.client.position()
        session.expect(
            again == place, ("MACS-CMD-18-01", "MACS-CMD-18-03"), f"at rest at {place}", again
        )
        if is_move:  # the others have no target to be away from
            is_busy = driver.status.is_busy()
            driver.judge.reading("busy_after_abort", int(is_busy), "MACS-CMD-18-03")
        if moving_s:
            driver.judge.accepted(0x0F, coefficient, requirement="MACS-CMD-18-01")
        driver.motion.finish(driver.motion.go(start), "MACS-CMD-18-01")


@check("MACS-CMD-18-02", safety=MOVES)
def a_hard_stop_at_rest_does_nothing(session: Session) -> None:
    """18h and 17h at rest are accepted and move nothing."""
    driver = driver_of(session)
    start = driver.motion.ready()
    for index in (0x18, 0x18, 0x17, 0x18):
        driver.judge.accepted(index)
        session.expect(driver.client.position() == start, None, start, driver.client.position())


@check("MACS-CMD-1A-01", safety=MOVES, level="full")
def power_off_ends_a_motion(session: Session) -> None:
    """1Ah in motion is accepted; the axis comes to rest, unlocked, and does not resume."""
    driver = driver_of(session)
    segment = driver.limits.segment(50, SLOWEST)
    for name in ("13h", "15h", "16h"):
        start = driver.motion.ready(SLOWEST)
        driver.judge.accepted(0x19)  # that they power it themselves is judged elsewhere
        if name == "13h":
            forecast = driver.motion.go(start + 100)
        elif name == "15h":
            forecast = driver.motion.turn(1, SLOWEST)
        else:  # the second one has not begun when the power goes
            forecast = driver.motion.feed(start, segment, segment)
        driver.client.wait(0.2)
        off = driver.judge.accepted(0x1A)
        driver.client.wait(0.5)
        place = driver.client.position()
        lowest, _ = forecast.bounds(off.taken)
        within = f"coasting from {lowest}, where 1Ah met a motion of {name}, not driven on"
        session.expect(lowest <= place < start + 2 * segment.steps, None, within, place)
        driver.client.wait(0.3)
        session.expect(
            driver.client.position() == place, None, f"at rest at {place}", driver.client.position()
        )
        driver.judge.accepted(0x0F, 0)
