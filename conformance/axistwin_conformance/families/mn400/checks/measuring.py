"""Measured rates: E1 and E2 count the ticks of a move over 100 and 1000 ms (E; MEA)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.client import MEASURES_S
from axistwin_conformance.families.mn400.driver import AXES, DATA, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import (
    CLOCK_ERROR,
    MOTION,
    NS,
    BoardMotion,
)

ORDER = 170

SPEEDS: Final = (300, 1500)
SLOW: Final = 500
MANY_TICKS: Final = 4, 17_000  # multiplex and speed by which E2 counts more than 65535
MANY_STEPS: Final = 24_000  # of that move
LAST: Final = 12  # steps of the last segment of a contour: a quarter of what E1 counts


@check("MN4-CMD-E-02", "MN4-CMD-E-03", "MN4-MEA-01", "MN4-MEA-02", "MN4-MEA-03",
       "MN4-STM-01", safety=MOTION)  # fmt: skip
def a_measurement_counts_ticks(session: Session) -> None:
    """At constant speed it is speed, multiplex and time, give or take a step, and it comes when the
    time is over, also of a move that has been paused; a multiplex that is set meanwhile is for
    later moves."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(2000, "these moves")
    for mode, seconds in MEASURES_S.items():
        for speed in SPEEDS:
            for multiplex in (1, 2, 4):
                if speed * (seconds + 0.3) < motion.room:
                    _judge_count(motion, mode, seconds, speed, multiplex)
    if motion.driver.reading("queue_modal") == "true":  # else it may be the present one that counts
        _judge_count(motion, 1, MEASURES_S[1], SPEEDS[0], 2, ("X4",))
    _judge_count(motion, 1, MEASURES_S[1], SPEEDS[0], 2, ("{", "}"))
    multiplex, speed = MANY_TICKS
    if motion.room >= MANY_STEPS // 2 and motion.fast(speed) == speed:
        _judge_count(motion, 2, MEASURES_S[2], speed, multiplex, aside=-MANY_STEPS // 2)


def _judge_count(
    motion: BoardMotion,
    mode: int,
    seconds: float,
    speed: int,
    multiplex: int,
    later: Sequence[str] = (),
    aside: int = 0,
) -> None:
    """Judge the count of a move; `later`: what is sent when it runs and changes no count; `aside`:
    where it begins."""
    session, driver = motion.session, motion.driver
    motion.ready(f"X{multiplex}", speed=speed, profile=(speed, speed, 10_000))
    if aside:
        motion.run(f"M{aside}", "MN4-CMD-E-02", samples=1)
    far = min(motion.room - aside, round(speed * (seconds + 0.6)))
    motion.do(f"M{far},{-far // 3}", "MN4-CMD-E-02")
    for text in later:
        motion.do(text, "MN4-STM-01")
    exchange = driver.draws(f"E{mode}", DATA, "MN4-CMD-E-02")
    fields = exchange.value.fields if exchange.value else None
    told = f"to E{mode}" + (f" behind {' and '.join(later)}" if later else "")
    session.expect(len(fields or ()) == AXES + 1, "MN4-CMD-E-02", "five numbers", fields, told)
    assert fields is not None
    wanted = speed * multiplex * seconds
    off = multiplex + (0 if motion.target.is_virtual else wanted * CLOCK_ERROR)
    is_right = abs(fields[-1] - wanted) <= off
    names = (
        ("MN4-STM-01",) if later[:1] == ("X4",) else ("MN4-CMD-E-03", "MN4-MEA-02", "MN4-MEA-03")
    )
    session.expect(is_right, names, f"{wanted:g} within {float(off):g}", fields[-1], told)
    done, started = Fraction(exchange.done_ns, NS), Fraction(exchange.came_ns[0], NS)
    # A busy host may read START late, but it cannot have left before the request was complete.
    began = started if motion.target.is_virtual else motion.span(exchange)[0]
    most = Fraction(seconds) * (1 + CLOCK_ERROR) + Fraction(motion.target.line_ns, NS)
    most += Fraction(60 * motion.target.byte_ns, NS)
    is_timely = Fraction(seconds) * (1 - CLOCK_ERROR) <= done - began and done - started <= most
    limits, waited = f"{seconds} to {float(most):.3f} s", f"{float(done - started):.3f} s"
    session.expect(is_timely, "MN4-MEA-01", limits, waited, told)


@check("MN4-MEA-01", safety=MOTION)
def a_measurement_counts_what_is_left_of_a_move(session: Session) -> None:
    """Begun shortly before the end of one, it counts its last ticks and none behind them; also of a
    contour whose last segment begins meanwhile."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(SLOW, "this move")
    whole = f"M{SLOW},{-SLOW // 3}"
    _judge_last_ticks(motion, (whole,), whole)
    segments = f"M{SLOW - LAST},{-SLOW // 3}", f"M{LAST},{-LAST // 3}"
    _judge_last_ticks(motion, ("(", *segments, ")"), "a contour")


def _judge_last_ticks(motion: BoardMotion, texts: Sequence[str], told: str) -> None:
    """Judge the count of E1 shortly before the end of what goes that far."""
    session = motion.session
    motion.ready(speed=SLOW, profile=(SLOW, SLOW, 10_000))
    for text in texts:
        motion.do(text, "MN4-MEA-01")
    motion.wait_until(motion.ends[0] - Fraction(MEASURES_S[1]) * 2 / 3)
    exchange = motion.driver.draws("E1", DATA, "MN4-MEA-01")
    fields = exchange.value.fields if exchange.value else None
    session.expect(len(fields or ()) == AXES + 1, "MN4-MEA-01", "five numbers", fields)
    assert fields is not None
    started = motion.span(exchange)[0], Fraction(exchange.came_ns[0], NS)
    low, high = motion.model.where(motion.widened(started))[0]
    least, most = SLOW - high - 1, SLOW - low + 1
    is_right = least <= fields[-1] <= most
    when = f"to E1 shortly before the end of {told}"
    session.expect(is_right, "MN4-MEA-01", f"{least} to {most}", fields[-1], when)


@check("MN4-CMD-E-04", "MN4-MEA-04", safety=MOTION)
def a_measurement_disturbs_nothing(session: Session) -> None:
    """Its positions are those of its end, or of its begin; the move goes on, and that of one axis
    counts nothing."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(500, "these moves")
    motion.ready(speed=SLOW)
    motion.do("M500", "MN4-MEA-04")
    exchange = driver.draws("E1", DATA, "MN4-MEA-04")
    fields = (exchange.value.fields if exchange.value else None) or (0,) * (AXES + 1)
    if driver.reading("measure_single_axis") == "zero":
        driver.tells(fields[-1] == 0, "MN4-CMD-E-04", "a count of 0", fields[-1])
    is_end = driver.reading("measure_position_sample") == "end"
    first, last = motion.span(exchange)
    begin, end = Fraction(exchange.came_ns[0], NS), Fraction(exchange.came_ns[0], NS)
    if is_end:
        begin, end = end + Fraction(1, 10) * (1 - CLOCK_ERROR), last
    else:
        begin = first
    place = motion.model.where(motion.widened((begin, end)))
    low, high = place[0]
    driver.tells(low <= fields[0] <= high, "MN4-MEA-04", f"{low} to {high}", fields[0])
    motion.follow("MN4-MEA-04")
