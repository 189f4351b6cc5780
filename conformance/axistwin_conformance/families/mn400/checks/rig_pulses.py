"""Motion that external pulses pace: threading, and moves at a negative speed (T, V; THR, SYN)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import (
    LAG_S,
    MOTION,
    NS,
    RIG_MOTION,
    BoardMotion,
    inside,
    told,
)
from axistwin_conformance.families.mn400.planner.pulses import (
    TURN,
    Spindle,
    pulses_of,
    threaded,
    threaded_between,
)
from axistwin_conformance.families.mn400.planner.vector import axis_window, major_length

ORDER = 310

PULSES: Final = ("rig:pulses", "rig:index")
BY: Final = (100, -53, 0, 7)
LASH: Final = "B9,9,9,9", "D-1,-1,-1,-1"
PIECES: Final = (1, 2, 40, 57, 90)  # pulses fed, one after the other; 190 together
SETTLE_S: Final = 0.05

SPINDLE: Final = ("rig:spindle",)
RATE_ERROR: Final = Fraction(1, 10)  # of a spindle that is set, but not by a twin in this process
LOOK_S: Final = 0.08


def fed(motion: BoardMotion, count: int) -> tuple[int, ...]:
    """The counters once so many more pulses have come."""
    motion.session.rig.work("pulses", count)
    motion.target.wait(SETTLE_S)
    return motion.read()[0]


@check("MN4-THR-01", "MN4-THR-02", "MN4-THR-03", "MN4-THR-04", "MN4-CMD-T-01", "MN4-CMD-T-02",
       safety=RIG_MOTION, needs=PULSES)  # fmt: skip
def a_threading_move_follows_its_pulses(session: Session) -> None:
    """Nothing before the index and the offset, then in proportion to the pulses, all of it with the
    last one, and no step beyond; with backlash to be taken up before it as well."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(200, "these moves")
    lash = LASH if motion.driver.reading("backlash_counts") == "false" else ()
    for is_absolute, pulses, offset, settings in (
        (False, 200, 0, ()), (False, 400, 10, lash), (True, 200, 3, ()),
    ):  # fmt: skip
        base = (10, 20, 30, 40) if is_absolute else (0, 0, 0, 0)
        place = ",".join(map(str, base))
        motion.ready(motion.mode(is_absolute=is_absolute), f"L{place}", *settings)
        goal = [by + at if is_absolute else by for by, at in zip(BY, base, strict=True)]
        text = f"T{','.join(map(str, goal))},{pulses},{offset}"
        motion.driver.draws(text, DONE, "MN4-CMD-T-01")
        motion.stays("MN4-THR-04")
        if motion.driver.reading("threader_start") == "index":
            before = fed(motion, 20)
            motion.driver.tells(before == base, "MN4-THR-03", f"{base} before the index", before)
            session.rig.work("index", True)
        if offset:
            before = fed(motion, offset)
            session.expect(before == base, "MN4-CMD-T-01", f"{base} in the offset", before)
        _judge_pulses(motion, base, pulses)
        after = fed(motion, 50)
        end = tuple(at + by for at, by in zip(base, BY, strict=True))
        session.expect(after == end, ("MN4-THR-04", "MN4-CMD-T-02"), end, after, "pulses beyond")


def _judge_pulses(motion: BoardMotion, base: Sequence[int], pulses: int) -> None:
    """Judge the counters after each piece, and at the end."""
    done = 0
    for piece in (*PIECES, pulses - sum(PIECES)):
        done += piece
        counters = fed(motion, piece)
        windows = [threaded(by, done, pulses) for by in BY]
        place = [(at + low, at + high) for at, (low, high) in zip(base, windows, strict=True)]
        is_right = inside(counters, tuple(place))
        names = ("MN4-THR-01", "MN4-THR-02", "MN4-CMD-T-01", "MN4-CMD-T-02")
        motion.session.expect(is_right, names, told(place), counters, f"after {done} of {pulses}")


@check("MN4-STM-01", safety=RIG_MOTION, needs=PULSES)
def a_move_waits_for_the_last_pulse_of_a_thread(session: Session) -> None:
    """One that is queued behind it moves nothing before, and needs no pulses."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(100, "these moves")
    motion.ready()
    for text in ("T50,0,0,0,50", "M0,50"):
        motion.driver.draws(text, DONE, "MN4-STM-01")
    if motion.driver.reading("threader_start") == "index":
        session.rig.work("index", True)
    for pulses, wanted in ((49, (49, 0, 0, 0)), (1, (50, 50, 0, 0))):
        session.rig.work("pulses", pulses)
        counters = motion.rest()
        session.expect(counters == wanted, "MN4-STM-01", wanted, counters)


@check("MN4-THR-01", "MN4-THR-03", "MN4-THR-04", "MN4-CMD-T-01", safety=RIG_MOTION, needs=SPINDLE)
def a_thread_keeps_step_with_its_spindle(session: Session) -> None:
    """From the index on each step comes with its pulse, whatever the rate and however many there
    are; none beyond the last."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(200, "these moves")
    for rate, pulses, offset in ((1000, 1000, 0), (4000, 2000, 300), (8000, 80_000, 0)):
        motion.needs_speed(rate * max(BY) // pulses, "these moves")
        motion.ready()
        spindle = _turned(motion, rate)
        text = f"T{','.join(map(str, BY))},{pulses},{offset}"
        low, high = spindle.pulses(motion.span(motion.driver.draws(text, DONE, "MN4-CMD-T-01")))
        if motion.driver.reading("threader_start") == "index":
            low, high = ((one // TURN + 1) * TURN for one in (low, high))
        _judge_pace(motion, spindle, (low + offset, high + offset), pulses)
        motion.stays("MN4-THR-04")


@check("MN4-THR-01", "MN4-THR-04", "MN4-CMD-T-01", safety=RIG_MOTION, needs=SPINDLE)
def a_thread_waits_for_a_spindle_that_stands(session: Session) -> None:
    """Where it was when that stopped; it goes on with the next pulse, at any rate, to its end, and
    a move behind it begins at once."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(200, "these moves")
    rate, pulses = 1000, 2000
    motion.needs_speed(4 * rate * max(BY) // pulses, "these moves")
    motion.ready()
    spindle = _turned(motion, rate)
    motion.driver.draws(f"T{','.join(map(str, BY))},{pulses}", DONE, "MN4-CMD-T-01")
    while motion.read()[0][0] < BY[0] // 2:
        over = spindle.pulses(motion.now)[0] > TURN + pulses
        session.expect(not over, "MN4-THR-01", "a thread under way", "none", f"at {rate} Hz")
        motion.target.wait(LOOK_S)
    session.rig.work("spindle", 0)
    counters = motion.stays("MN4-THR-04")
    low, high = pulses_of(counters[0], BY[0], pulses)
    end = _judge_pace(motion, _turned(motion, 4 * rate), (-high, -low), pulses)
    motion.model.observe(end)
    motion.run("M50", "MN4-CMD-T-01")


def _turned(motion: BoardMotion, rate: int) -> Spindle:
    """Let the spindle turn, at so many pulses per second."""
    rig = motion.session.rig
    began, done = (Fraction(one, NS) for one in rig.work("spindle", rate))
    return Spindle(rate, (began, done), Fraction(0) if rig.is_exact else RATE_ERROR)


def _judge_pace(
    motion: BoardMotion, spindle: Spindle, before: tuple[int, int], pulses: int
) -> tuple[int, ...]:
    """Judge the counters until a threading move of so many pulses must be over, and give the last;
    `before`: how many pulses of the spindle come before its first, at least and at most."""
    lag = 0 if motion.target.is_virtual else LAG_S
    done, counters = (0, 0), tuple[int, ...]()
    while done[0] < pulses:
        motion.target.wait(LOOK_S)
        counters, (first, last) = motion.read()
        low, high = spindle.pulses((first - lag, last))
        done = low - before[1], high - before[0]
        place = tuple(threaded_between(by, done, pulses) for by in BY)
        name = "MN4-THR-03" if done[1] <= 0 else "MN4-THR-01"
        when = f"after {done[0]} to {done[1]} of {pulses} pulses"
        motion.session.expect(inside(counters, place), name, told(place), counters, when)
    return counters


@check("MN4-THR-06", "MN4-CMD-T-03", safety=RIG_MOTION, needs=PULSES)
def threading_knows_no_speed(session: Session) -> None:
    """Whatever V and F are; Q ends it while it waits and on its way."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(200, "these moves")
    for speed, profile in ((2, (2, 10, 1)), (5000, (1000, 5000, 10_000))):
        motion.ready(speed=speed, profile=profile)
        driver.draws("T100,0,0,0,100", DONE, "MN4-CMD-T-03")
        if driver.reading("threader_start") == "index":
            session.rig.work("index", True)
        counters = fed(motion, 60)
        session.expect(counters[0] == 60, "MN4-THR-06", "60", counters[0], f"at V{speed}")
        driver.draws("Q", DONE, "MN4-CMD-T-03")
        after = fed(motion, 60)
        session.expect(after == counters, "MN4-CMD-T-03", counters, after, "pulses after Q")


@check("MN4-THR-05", "MN4-CMD-T-03", safety=MOTION)
def threading_waits_and_bounds_its_steps(session: Session) -> None:
    """More steps than pulses are refused, or not (MN4-AMB-59); without pulses nothing moves, and Q
    ends it."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(300, "these moves")
    motion.ready()
    exchange = driver.ask("T300,0,0,0,200")
    if driver.reading("threader_overrate") == "para_error":
        refused = driver.errors("PARA_ERROR")
        driver.tells(exchange.says(*refused), "MN4-THR-05", " and ".join(refused), exchange)
    else:
        session.not_run("MN4-THR-05", "this board makes several steps per pulse (MN4-AMB-59)")
    driver.command("Q")
    driver.draws("T100,0,0,0,200", DONE, "MN4-CMD-T-03")
    motion.stays("MN4-CMD-T-03")
    driver.draws("Q", DONE, "MN4-CMD-T-03")
    motion.run("M10", "MN4-CMD-T-03")


@check("MN4-SYN-01", "MN4-CMD-V-02", "MN4-CMD-A-05", safety=RIG_MOTION, needs=("rig:pulses",))
def at_a_negative_speed_pulses_pace_every_move(session: Session) -> None:
    """One pulse is one step of the axis that goes farthest; an arc takes as many as it has ticks
    and ends exactly, with a limit on that it does not meet too; without pulses nothing moves."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(400, "these moves")
    motion.ready("V-1")
    driver.draws(f"M{','.join(map(str, BY))}", DONE, "MN4-CMD-V-02")
    motion.stays(("MN4-CMD-V-02", "MN4-SYN-01"))
    length, done = major_length(BY), 0
    for piece in (1, 9, 40, 49, 1):
        done += piece
        counters = fed(motion, piece)
        place = tuple(axis_window(by, length, done, done) for by in BY)
        session.expect(inside(counters, place), "MN4-SYN-01", told(place), counters, f"at {done}")
    after = fed(motion, 10)
    session.expect(after == BY, "MN4-SYN-01", BY, after, "pulses beyond the end")
    motion.ready("V-1")
    _judge_paced_arc(motion)
    if "limit_plus" in session.rig.capabilities:
        motion.ready("V-1")
        session.rig.work("limit_plus", True, number=2)
        _judge_paced_arc(motion, ", with the + limit of axis 2 on, which stands")
        session.rig.work("limit_plus", False, number=2)


def _judge_paced_arc(motion: BoardMotion, when: str = "") -> None:
    """Judge that half a circle of 283 ticks goes on with its pulses alone."""
    session = motion.session
    motion.driver.draws("A-100,0,-200,0,1", DONE, "MN4-CMD-A-05")
    motion.stays("MN4-CMD-A-05")
    under_way = fed(motion, 150)
    is_on = 0 > under_way[0] > -200
    told_way = f"half-way after 150 pulses{when}"
    session.expect(is_on, "MN4-CMD-A-05", told_way, under_way)
    after, wanted = fed(motion, 250), (-200, 0, 0, 0)
    session.expect(after == wanted, "MN4-CMD-A-05", wanted, after, f"after 400 pulses{when}")


@check("MN4-CMD-V-02", safety=RIG_MOTION, needs=("rig:pulses",))
def a_contour_waits_for_the_pulses_of_a_segment(session: Session) -> None:
    """Of three segments that of a negative speed advances with its pulses, not with those before it
    begins; the one behind it begins when they have come."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(150, "this contour")
    if motion.driver.reading("contour_pulses") != "paced":
        session.skip("no pulses pace the contours of this board (MN4-AMB-73)")
    motion.ready()
    for text in ("(", "V500", "M50", "V-1", "M50", "V1000", "M50", ")"):
        motion.driver.draws(text, DONE, "MN4-CMD-V-02")
    if session.rig.is_exact:  # else they may come too late
        session.rig.work("pulses", 5)
    for pulses, wanted in ((0, 50), (20, 70), (30, 150)):
        if pulses:
            session.rig.work("pulses", pulses)
        counters = motion.rest()
        session.expect(counters == (wanted, 0, 0, 0), "MN4-CMD-V-02", wanted, counters)
