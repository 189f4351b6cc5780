"""Pause, resume and quit anywhere in a motion; what N, / and : tell of it ({, }, Q; PAU, QUIT)."""

from __future__ import annotations

import operator
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Requirements, Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mn400.driver import AXES, DONE, BoardDriver
from axistwin_conformance.families.mn400.model.motions import Span, VectorMotion
from axistwin_conformance.families.mn400.motion.board_motion import (
    MOTION,
    BoardMotion,
    inside,
    is_monotone,
    told,
)
from axistwin_conformance.families.mn400.planner.speed import Halt, halted

ORDER = 150

# Motions that are paused, and how long each lasts about (s): moves, an arc, a helix.
PAUSED: Final = (
    ("M1500", 0.8), ("M-900,1200,7,-1", 0.7), ("A-400,0,-800,0,1", 0.6),
    ("+-100,0,-200,0,-1,300,2", 0.7),
)  # fmt: skip
MOST_PAUSES: Final = 3
AGAIN_STEPS: Final = 850  # more than a pause brakes for: so far is a move that is paused again
WAITING: Final = ("M0,0,500", "L0,7,0,0")  # behind a move of axis 1; Q drops it
RAMPED: Final = (500, 5000, 5000)  # a profile by which M2000 at V3000 takes 1.1 s
# What runs with that, and when } comes: on the ramp up, at speed, on the ramp down.
UNPAUSED: Final = ((("M2000",), (0.2, 0.5, 0.8)), (("(", "M1000,-30", "M1000,30", ")"), (0.3, 0.8)))
BRAKING: Final = (100, 1000, 1000)  # by which a pause at 0.6 s brakes for as long
MULTIPLEXED: Final = ("(", "M500,-50", "M500", ")")  # of which the second segment alone has none
SLOW, FEW = 2, 2  # steps/s and steps of a move whose steps are far from one another
# What is set while something at V1000 is paused: speeds below and above, a lower end speed.
SLOWER, FASTER, LOWER = "V500", "V3000", "F400,500,1000"
PAUSED_AND_SET: Final = (
    (("M1000,-300",), SLOWER), (("M1000,-300",), FASTER), (("M1000,-300",), LOWER),
    (("A-200,0,-400,0,1",), SLOWER), (("(", "M500", "M500,20", ")"), FASTER),
)  # fmt: skip


def stops_within(motion: BoardMotion, taken: Span, *, is_ramped: bool) -> tuple[Halt, Halt]:
    """Where the only move under way may stop that is told to in that span of time."""
    scheduled = motion.model.timeline.motions[0]
    assert isinstance(scheduled.motion, VectorMotion), "a vector move"
    move = scheduled.motion.move
    first, last = taken[0] - scheduled.begins[1], taken[1] - scheduled.begins[0]
    ends = (
        halted(move.plan, max(Fraction(0), at), move.settings.profile, is_ramped=is_ramped)
        for at in (first, last)
    )
    low, high = ends
    return low, high


@check("MN4-CMD-PAU-01", "MN4-CMD-PAU-02", "MN4-CMD-N-01", "MN4-MEA-05", "MN4-PAU-01",
       "MN4-CMD-SW-02", "MN4-CMD-V-01", "MN4-RSP-14", safety=MOTION)  # fmt: skip
def a_move_stands_where_it_is_paused(session: Session) -> None:
    """Half-way at start speed, and braking to it from a higher one, with a multiplex as well; E and
    N add up to the whole, : tells of the pause, and } goes on to the end; a second { pauses it as
    the first did.  The next move has its speed, and nothing comes unasked."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(2000, "these moves")
    for multiplex, speed, by, at_s in (
        (1, 1000, (2000, 0, 0, 0), 1.0), (4, 3000, (2000, -500, 0, 1), 0.4),
        (1, 3000, (-2000, 0, 0, 0), 0.1), (4, 3000, (-2000, 700, 0, 0), 0.12),
    ):  # fmt: skip
        motion.ready(f"X{multiplex}", speed=speed, profile=(1000, 5000, 5000))
        motion.do(f"M{','.join(map(str, by))}", "MN4-CMD-PAU-01")
        driver.target.wait(at_s)
        exchange = driver.draws("{", ("START", "DONE"), "MN4-CMD-PAU-01")
        _judge_halt(motion, motion.span(exchange), by)
        motion.model.accept("{", motion.span(exchange))
        here = motion.rest_paused()
        rest, left = driver.counted(map(operator.sub, by, here)), driver.steps_left()
        names = ("MN4-MEA-05", "MN4-CMD-N-01")
        session.expect(left == rest, names, rest, left, f"left of {by} at {here}")
        motion.stays("MN4-CMD-PAU-01")
        _judge_flags(motion, is_paused=True)
        resumed = motion.span(motion.do("}", "MN4-CMD-PAU-02"))
        _judge_flags(motion, is_paused=False)
        if multiplex == 1:
            _judge_once_more(motion, resumed, here, by)
        rows = (here, *motion.follow("MN4-CMD-PAU-02", samples=4))
        session.expect(is_monotone(rows, by), "MN4-CMD-PAU-02", f"no way back on {by}", rows)
        if multiplex == 1 and speed > 1000:
            motion.run(f"M{-by[0]}", "MN4-CMD-V-01", samples=3)


def _judge_once_more(
    motion: BoardMotion, resumed: Span, here: tuple[int, ...], by: tuple[int, ...]
) -> None:
    """Judge a second pause, of a move that goes on from there and has far to go, and end it."""
    paused = motion.span(motion.do("{", "MN4-CMD-PAU-01"))
    again = motion.rest_paused()
    is_short = abs(again[0]) < abs(by[0])
    most = AGAIN_STEPS + motion.model.settings.speed * (paused[1] - resumed[0])
    when = f"behind a second {{ on the way to {by}"
    if abs(by[0] - here[0]) >= most:  # else a slow host may have let it come to its end
        motion.session.expect(is_short, "MN4-CMD-PAU-01", "at rest before that", again, when)
    motion.do("}", "MN4-CMD-PAU-02")


def _judge_halt(motion: BoardMotion, taken: Span, by: tuple[int, ...]) -> None:
    """Judge where the major axis comes to rest (MN4-AMB-61)."""
    driver, session = motion.driver, motion.session
    is_ramped = driver.reading("pause_decel") == "true"
    low, high = stops_within(motion, motion.widened(taken), is_ramped=is_ramped)
    driver.target.wait(float(high.seconds))
    here, _ = motion.read()
    window = int(low.steps) - 1, int(high.steps) + 1
    came = abs(here[0])
    is_right = window[0] <= came <= window[1]
    session.expect(is_right, "MN4-PAU-01", told([window]), came, f"paused on the way to {by}")


def _judge_flags(motion: BoardMotion, *, is_paused: bool) -> None:
    if motion.driver.reading("has_feedhold_cmds") == "false":
        motion.session.not_run("MN4-CMD-SW-02", "this board has no : (MN4-AMB-38)")
        return
    flags = motion.driver.flags()
    seen = flags["PauseFlag"], flags["PauseState"]
    wanted = (int(is_paused),) * 2
    when = "the axes stood paused" if is_paused else "} had resumed the move"
    text = Observation(
        f"while {when}, {REQUEST} showed PauseFlag {seen[0]} and PauseState {seen[1]}",
        value=str(seen),
        wanted=f"{int(is_paused)} of both",
    )
    motion.session.expect(seen == wanted, "MN4-CMD-SW-02", wanted, text)


@check("MN4-PAU-02", "MN4-PAU-03", "MN4-CMD-PAU-02", "MN4-CMD-N-02", safety=MOTION)
def pauses_anywhere_lose_no_step(session: Session) -> None:
    """Up to three pauses at drawn times, near the end as well, in moves, arcs and helices: the end
    is exact, no step is left, the exit code is 0."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(1500, "these motions")
    for text, lasts_s in PAUSED:
        for _ in range(4 if session.transport.is_virtual else 1):
            motion.ready("X2", speed=motion.fast(2500))
            motion.do(text, "MN4-CMD-PAU-02")
            wanted = motion.end
            for _ in range(session.random.randint(1, MOST_PAUSES)):
                driver.target.wait(session.random.uniform(0, lasts_s / 2))
                motion.do("{", "MN4-CMD-PAU-02")
                driver.target.wait(session.random.uniform(0, 0.3))
                motion.do("}", "MN4-CMD-PAU-02")
            counters = motion.rest()
            is_right = inside(counters, wanted)
            names = ("MN4-PAU-02", "MN4-PAU-03", "MN4-CMD-PAU-02")
            session.expect(is_right, names, told(wanted), counters, f"{text} with pauses")
            code = driver.exit_code()
            session.expect(code == 0, "MN4-PAU-03", 0, code, "exit code after pauses")
            left, after = driver.steps_left(), f"after {text} with pauses"
            session.expect(left == (0,) * AXES, "MN4-CMD-N-02", "0, 0, 0, 0", left, after)
    motion.ready(speed=motion.fast(3000), profile=RAMPED)
    for text, lasts_s in (("M1500,-400", 0.7), ("M-1500,400", 0.8)):  # amid its last ramp
        motion.do(text, "MN4-CMD-PAU-02")
        wanted = motion.end
        for order in "{}":
            driver.target.wait(lasts_s)
            motion.do(order, "MN4-CMD-PAU-02")
        counters, both = motion.rest(), ("MN4-PAU-02", "MN4-CMD-PAU-02")
        session.expect(inside(counters, wanted), both, told(wanted), counters, f"{text}, paused")


@check("MN4-CMD-PAU-04", "MN4-PAU-04", "MN4-PAU-05", "MN4-CMD-PAU-02", "MN4-CMD-Q-01",
       "MN4-CMD-N-02", "MN4-CMD-SW-02", "MN4-ERR-02", safety=MOTION)  # fmt: skip
def pauses_end_as_they_should(session: Session) -> None:
    """A pause at rest holds nothing back; what is asked for in a pause waits behind it, whatever is
    refused meanwhile, and one } ends it, however many { there were; Q drops all of it."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(1100, "these moves")
    motion.ready()
    motion.do("{", "MN4-CMD-PAU-04")
    motion.do("}", "MN4-CMD-PAU-04")
    motion.do("{", "MN4-CMD-PAU-04")
    if driver.reading("pause_idle") == "noop":
        motion.run("M50", "MN4-CMD-PAU-04")
    motion.ready(speed=1000)
    motion.do("M1000", "MN4-PAU-04")
    driver.target.wait(0.3)
    motion.do("{", "MN4-PAU-04")
    here = motion.rest_paused()
    for text in ("{", "V1000", "|", "M0,100"):
        motion.do(text, "MN4-PAU-04")
    after = motion.stays("MN4-PAU-04")
    session.expect(after == here, "MN4-PAU-04", here, after)
    driver.draws("X3", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    _judge_flags(motion, is_paused=True)
    motion.do("}", "MN4-CMD-PAU-02")
    counters, names = motion.rest(), ("MN4-PAU-04", "MN4-ERR-02", "MN4-CMD-PAU-02")
    session.expect(counters == (1000, 100, 0, 0), names, "1000, 100, 0, 0", counters)
    motion.ready(speed=1000)
    motion.do("M1000", "MN4-PAU-05")
    driver.target.wait(0.3)
    motion.do("{", "MN4-PAU-05")
    motion.rest_paused()
    _judge_quit(motion)


@check("MN4-CMD-PAU-02", "MN4-CMD-Q-01", "MN4-PAU-05", "MN4-CMD-N-02", safety=MOTION)
def a_pause_ends_before_the_axes_stand(session: Session) -> None:
    """} while a pause still brakes lets a move, or a contour with a multiplex, go on to its end; Q
    there ends it where it is."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "these motions")
    for texts, text in ((MULTIPLEXED, "}"), (("M1000",), "}"), (("M1000",), "Q")):
        motion.ready("X4", speed=1000, profile=BRAKING)
        for one in texts:
            motion.do(one, "MN4-CMD-PAU-02")
        motion.driver.target.wait(0.6)
        motion.do("{", "MN4-CMD-PAU-02")
        motion.driver.target.wait(0.1)
        if text == "}":
            motion.do(text, "MN4-CMD-PAU-02")
            motion.follow("MN4-CMD-PAU-02")
    _judge_quit(motion)


def _judge_quit(motion: BoardMotion) -> None:
    """Judge that Q ends a move of 1000 steps that is paused, and that no } brings it back."""
    motion.do("Q", "MN4-PAU-05")
    if motion.driver.reading("quit_decel") == "false":
        motion.stays("MN4-CMD-Q-01")
    here = motion.rest()
    _judge_rest(motion, here, (1000, 0, 0, 0), "MN4-CMD-N-02", "after Q")
    motion.do("}", "MN4-PAU-05")
    after = motion.stays("MN4-PAU-05")
    motion.session.expect(after == here, "MN4-PAU-05", here, after)


@check("MN4-CMD-PAU-01", "MN4-CMD-N-01", "MN4-CMD-PAU-02", safety=MOTION)
def a_pause_makes_no_step(session: Session) -> None:
    """{ right behind a step of a slow move, of which the next one is far: E stands, N is the rest,
    and what is left takes its time."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.ready(speed=SLOW)
    motion.do(f"M{FEW}", "MN4-CMD-PAU-01")
    before, seen = motion.read()
    while before[0] < 1 and seen[1] < motion.ends[1]:
        before, seen = motion.read()
    exchange = motion.do("{", "MN4-CMD-PAU-01")
    if motion.span(exchange)[1] - seen[0] > Fraction(1, 2 * SLOW):
        session.skip("its replies take too long to tell")
    after = driver.position()
    session.expect(after == before, "MN4-CMD-PAU-01", before, after, "E behind {")
    rest, left = driver.counted(map(operator.sub, (FEW, 0, 0, 0), after)), driver.steps_left()
    session.expect(left == rest, "MN4-CMD-N-01", rest, left, f"left of M{FEW} at {after}")
    motion.do("}", "MN4-CMD-PAU-02")
    motion.follow("MN4-CMD-PAU-02")


@check("MN4-CMD-PAU-04", "MN4-MOT-10", safety=MOTION)
def a_resume_without_a_pause_changes_nothing(session: Session) -> None:
    """} while a move or a contour runs that nobody has paused, be it taken or refused: it goes on
    by its ramps, and ends in its time."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(2000, "these moves")
    names = ("MN4-CMD-PAU-04", "MN4-MOT-10")
    for texts, times_s in UNPAUSED:
        for at_s in times_s:
            motion.ready(speed=3000, profile=RAMPED)
            for text in texts:
                motion.do(text, "MN4-CMD-PAU-04")
            driver.target.wait(at_s)
            exchange = driver.ask("}")
            session.step(exchange.is_sound, "an answer to }", exchange.observed)
            driver.tells(exchange.says(*DONE), "MN4-CMD-PAU-04", "START and DONE", exchange)
            motion.follow(names, samples=6)


@check("MN4-CMD-V-05", "MN4-CMD-F-03", "MN4-STM-01", "MN4-CMD-PAU-02", safety=MOTION)
def what_is_set_in_a_pause_is_for_later_moves(session: Session) -> None:
    """V and F between { and }: the rest of the motion takes the time it took before, and a move
    behind it that of the new setting."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1400, "these motions")
    for texts, setting in PAUSED_AND_SET:
        requirement = "MN4-CMD-F-03" if setting == LOWER else "MN4-CMD-V-05"
        motion.ready(speed=1000)
        for text in texts:
            motion.do(text, "MN4-CMD-PAU-02")
        motion.driver.target.wait(0.2)
        motion.do("{", "MN4-CMD-PAU-02")
        motion.do(setting, requirement)
        motion.do("}", "MN4-CMD-PAU-02")
        motion.follow(requirement, "MN4-CMD-PAU-02", requirement, samples=6)
        motion.run("M-400", "MN4-STM-01", samples=3)


@check("MN4-CMD-Q-01", "MN4-CMD-Q-02", "MN4-CMD-Q-03", "MN4-QUIT-01", "MN4-QUIT-02",
       "MN4-CMD-N-02", "MN4-CMD-N-03", safety=MOTION)  # fmt: skip
def quit_stops_and_forgets(session: Session) -> None:
    """Q ends the move where it is, and what waits behind it; another Q at rest changes nothing of
    what N tells.  Relative moves go on from there, and absolute places stay what they were."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(2000, "these moves")
    for by in ((2000, 0, 0, 0), (-2000, 300, 0, -1)):
        motion.ready(speed=3000, profile=(1000, 5000, 5000))
        motion.do(f"M{','.join(map(str, by))}", "MN4-CMD-Q-01")
        motion.do("M0,0,500", "MN4-CMD-Q-02")
        _judge_left(motion, by)
        driver.target.wait(0.3)
        exchange = driver.draws("Q", ("START", "DONE"), "MN4-CMD-Q-01")
        is_ramped = driver.reading("quit_decel") == "true"
        taken = motion.widened(motion.span(exchange))
        low, high = stops_within(motion, taken, is_ramped=is_ramped)
        here = motion.rest()
        motion.model.accept("Q", motion.span(exchange))
        motion.model.observe(here)
        window = int(low.steps) - 1, int(high.steps) + 1
        is_right = window[0] <= abs(here[0]) <= window[1]
        session.expect(is_right, ("MN4-QUIT-01", "MN4-CMD-Q-01"), told([window]), abs(here[0]))
        is_flushed = driver.reading("quit_flushes_queue") == "true"
        if is_flushed:
            session.expect(here[2] == 0, "MN4-CMD-Q-02", "axis 3 at rest", here)
        motion.stays("MN4-CMD-Q-02")
        aim = by if is_flushed else here  # else of the one that ran since
        _judge_rest(motion, here, aim, "MN4-CMD-N-02", "after Q")
        motion.do("Q", "MN4-CMD-Q-03")
        _judge_rest(motion, here, aim, "MN4-CMD-Q-03", "after Q and a Q at rest")
        motion.do("M0,0,-600", "MN4-QUIT-02")
        driver.target.wait(0.1)
        motion.do("Q", "MN4-CMD-Q-01")
        again = motion.rest()
        aim = (*here[:2], here[2] - 600, here[3])
        _judge_rest(motion, again, aim, "MN4-CMD-N-02", "after a second move and Q")
        motion.run("M10,10", "MN4-QUIT-02")
        motion.do(motion.mode(is_absolute=True), "MN4-QUIT-02")
        motion.run("M0,0,0,0", "MN4-QUIT-02")
        left = driver.steps_left()
        session.expect(left == (0,) * AXES, "MN4-CMD-N-02", "0, 0, 0, 0", left, "after a move")


@check("MN4-CMD-Q-02", "MN4-QUIT-02", "MN4-CMD-A-02", safety=MOTION)
def quit_leaves_nothing_of_what_it_drops(session: Session) -> None:
    """A load that has waited is not done; the first move or arc in absolute mode begins where the
    axes are, not where the motions were to end that Q has ended and dropped."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(900, "these moves")
    if driver.reading("quit_flushes_queue") == "false":
        session.skip("Q of this board drops nothing (MN4-AMB-62)")
    if int(driver.reading("queue_depth")) < len(WAITING):
        session.skip("the queue of this board is too short (MN4-AMB-52)")
    # Counters that are loaded at once would tell no more where the axes are.
    waiting = WAITING if driver.reading("queue_modal") == "true" else WAITING[:1]
    for is_arc in (False, True):
        motion.ready(speed=400)
        for text in ("M800", *waiting, "Q"):
            motion.do(text, "MN4-CMD-Q-02")
        x, second, y, _ = motion.rest()
        told_load = "0: Q has dropped the L that waited"
        session.expect(second == 0, "MN4-CMD-Q-02", told_load, second, "counter of axis 2")
        motion.do(motion.mode(is_absolute=True), "MN4-QUIT-02")
        if is_arc:
            text = f"A{x - 40},{y},{x - 80},{y},1"
            motion.run(text, ("MN4-CMD-A-02", "MN4-QUIT-02"))
        else:
            motion.run("M40,0,20", "MN4-QUIT-02")


def _judge_left(motion: BoardMotion, by: tuple[int, ...]) -> None:
    """Judge that what waits does not count among the steps left."""
    left = motion.driver.steps_left()
    is_right = left[2] == 0 and abs(left[0]) <= abs(by[0])
    motion.session.expect(is_right, "MN4-CMD-N-03", f"at most {by}, none of axis 3", left)


def _judge_rest(
    motion: BoardMotion,
    here: tuple[int, ...],
    by: tuple[int, ...],
    requirement: Requirements,
    when: str,
) -> None:
    """Judge what is left of a move that was ended (MN4-AMB-39)."""
    driver = motion.driver
    rest = driver.counted(map(operator.sub, by, here))
    if driver.reading("readcount_after_abort") == "zero":
        rest = (0,) * AXES
    left = driver.steps_left()
    motion.session.expect(left == rest, requirement, rest, left, when)


@check("MN4-CMD-EXIT-02", "MN4-MEA-06", safety=MOTION)
def reads_in_motion_tell_of_the_present(session: Session) -> None:
    """During a move / is that of the one before, and E never turns back."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(1000, "this move")
    motion.ready("|", speed=1000)
    motion.do("M1000,-3", "MN4-MEA-06")
    code = driver.exit_code()
    session.expect(code == 0, "MN4-CMD-EXIT-02", 0, code, "exit code during the first move")
    rows = motion.follow("MN4-MEA-06", samples=12)
    session.expect(is_monotone(rows, (1000, -3, 0, 0)), "MN4-MEA-06", "no way back", rows)
