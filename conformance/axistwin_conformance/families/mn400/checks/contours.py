"""Contours: stored until they are closed, then one motion within margin and caps ((, ); CC)."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.checks.queue import all_steps, one_step_text
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.planner.speed import ramped

ORDER = 140

# The manual's example (§2.2 "(").
EXAMPLE_LINES: Final = (
    "V3000", "M500,,500", "M505,,500", "M509,,500", "V3850", "M530,,505", "M520,,510",
)  # fmt: skip
BESIDE_LINES: Final = ("V3000", "M600", "M600,6", "M600")  # 2000 steps/s at each end of the second
EXAMPLE_STEPS: Final = 2564  # along its longest axis
BAD_LINES: Final = ("M100,-", "M-60,60,1a", "V1a")  # of a contour that none of them changes
PLANNED_S: Final = 1  # by which a board has made its plan of many segments, and moves
# Margins and places of two contours that wait, one behind the other, and the profile of the bends.
WAITING: Final = (
    ("(", ("M350,-50", "M350,,60", "M280,-20")), ("(2000", ("M,30,60", "M220,,,-40")),
)  # fmt: skip
BENDS: Final = (100, 500, 2000)
QUEUED: Final = 4  # places that are taken behind the motion that runs
BELOW: Final = (1000, 2000, 10_000)  # start, end, acceleration: the end is below the speed
SAME_SPEED: Final = Fraction(1, 20)  # s, by which one motion may be seen to differ from another


def contour(
    motion: BoardMotion, opening: str, lines: Sequence[str], requirement: str = "MN4-CMD-CC-02"
) -> None:
    """Enter a contour: nothing moves before it is closed."""
    motion.set(opening)
    for line in lines:
        motion.do(line, requirement)


@check("MN4-CMD-CC-01", "MN4-CMD-CC-02", "MN4-CMD-CC-05", "MN4-CC-01", "MN4-CC-03", "MN4-CC-04",
       "MN4-CC-06", "MN4-CC-05", safety=MOTION)  # fmt: skip
def the_example_takes_the_time_of_its_margin(session: Session) -> None:
    """Five segments on two axes with margins of 50 and 20, and three of which only the second moves
    another axis: every reading on the way and the end are those of the fastest plan that keeps
    them."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(EXAMPLE_STEPS, "the example's segments")
    motion.needs_speed(3850, "the example's segments")
    usual = ("MN4-CC-05", "MN4-CMD-CC-01")
    for opening, names, lines in (
        ("(50", ("MN4-CC-04",), EXAMPLE_LINES), ("(", usual, EXAMPLE_LINES),
        ("(20", ("MN4-CC-04",), EXAMPLE_LINES), ("(20", ("MN4-CC-04",), BESIDE_LINES),
    ):  # fmt: skip
        motion.ready()
        contour(motion, opening, lines)
        motion.do(")", "MN4-CMD-CC-05")
        path = (*names, "MN4-CC-03", "MN4-CC-06", "MN4-CMD-CC-05")
        motion.follow(path, "MN4-CC-01", path, samples=10)


@check("MN4-CC-01", "MN4-CMD-CC-02", "MN4-CMD-CC-04", "MN4-CMD-CC-08", "MN4-STM-06",
       "MN4-ERR-02", safety=MOTION)  # fmt: skip
def a_contour_waits_until_it_is_closed(session: Session) -> None:
    """Nothing moves between ( and ); Q forgets segments and speed; in both coordinate modes the end
    is that of single moves, whatever is refused meanwhile.  An empty pair behind a contour moves
    nothing."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(600, "these contours")
    motion.ready()
    contour(motion, "(", ("V500", "M100", "M0,100"))
    session.transport.wait(0.5)
    for text, requirement in (("Q", "MN4-CMD-CC-02"), (")", "MN4-STM-06")):
        motion.set(text)
        counters = motion.stays(requirement)
        session.expect(not any(counters), requirement, "0, 0, 0, 0", counters, f"after {text}")
    motion.run("M600", "MN4-CMD-CC-04")
    for is_absolute in (False, True):
        motion.ready(motion.mode(is_absolute=is_absolute), "L10,20,30,40")
        contour(motion, "(", ("M100,50", "v1500", "M,-30,20"))
        for text in BAD_LINES:
            motion.driver.draws(text, motion.driver.errors("PARA_ERROR"), "MN4-ERR-02")
        for text in (
            ("m200,,,5", "M0,0", "V2000", "M-40,10,10,10")
            if not is_absolute
            else ("m200,,,5", "M200,,,5", "V2000", "M-40,10,10,10")
        ):
            motion.do(text, "MN4-CMD-CC-02")
        motion.do(")", "MN4-CMD-CC-02")
        motion.follow("MN4-CC-01")
    for text in "()":
        motion.driver.ask(text)
    motion.stays(("MN4-CC-01", "MN4-CMD-CC-08"))


@check("MN4-CC-01", "MN4-CMD-CC-01", "MN4-CC-05", "MN4-CMD-M-02", "MN4-STM-01", safety=MOTION)
def a_contour_that_waits_begins_where_what_is_before_it_ends(session: Session) -> None:
    """In absolute mode, opened and closed while a move or a contour runs, and behind another one
    that waits: its segments lead to their places, wherever the axes were meanwhile, and bend by its
    own margin."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(400, "these contours")
    if int(motion.driver.reading("queue_depth")) < QUEUED:
        session.skip("the queue of this board is too short (MN4-AMB-52)")
    if int(motion.driver.reading("cc_capacity")) < max(len(lines) for _, lines in WAITING):
        session.skip("the contours of this board are too short (MN4-AMB-51)")
    names = ("MN4-CC-01", "MN4-CMD-M-02", "MN4-STM-01")
    for first in (("M300,-50",), ("(", "M150,-20", "M300,-50", ")")):
        _judge_waiting(motion, first, names)


def _judge_waiting(motion: BoardMotion, first: Sequence[str], names: tuple[str, ...]) -> None:
    """Judge the contours behind what runs first."""
    session = motion.session
    motion.ready(motion.mode(is_absolute=True), speed=500, profile=BENDS)
    for text in first:
        motion.do(text, names)
    for opening, lines in WAITING:
        opened = motion.driver.ask(opening)
        if not opened.says(*DONE):
            motion.driver.ask("Q")
            session.skip(f"no contour is opened in motion: ( draws {opened}")
        motion.model.accept(opening, motion.span(opened))
        for line in (*lines, ")"):
            motion.do(line, names)
    motion.do("M200", names)
    margins = ("MN4-CMD-CC-01", "MN4-CC-05")
    motion.follow((*names, *margins), names, margins, samples=10)


@check("MN4-CC-02", "MN4-CMD-CC-05", safety=MOTION)
def a_straight_way_in_pieces_takes_no_longer(session: Session) -> None:
    """Two, and ten if there is room, collinear segments last as long as one move."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(2000, "these contours")
    motion.needs_speed(3000, "these contours")
    for pieces in (2, min(10, int(motion.driver.reading("cc_capacity")))):
        motion.ready(speed=3000)
        contour(motion, "(", [f"M{2000 // pieces},{-1000 // pieces}"] * pieces, "MN4-CMD-CC-05")
        motion.do(")", "MN4-CMD-CC-05")
        motion.follow("MN4-CC-02", samples=8)
    motion.ready(speed=3000)
    motion.do("M2000,-1000", "MN4-CMD-CC-05")
    whole = motion.lasts()
    motion.ready(speed=3000)
    contour(motion, "(", ["M1000,-500"] * 2, "MN4-CMD-CC-05")
    motion.do(")", "MN4-CMD-CC-05")
    pieces_s = motion.lasts()
    is_alike = max(whole[0], pieces_s[0]) <= min(whole[1], pieces_s[1]) + SAME_SPEED
    told = f"{float(whole[0]):.3f} to {float(whole[1]):.3f} s"
    came = f"{float(pieces_s[0]):.3f} to {float(pieces_s[1]):.3f} s"
    session.expect(is_alike, "MN4-CC-02", told, came)


@check("MN4-CC-07", "MN4-CC-03", "MN4-CC-09", safety=MOTION)
def a_corner_is_taken_at_start_speed(session: Session) -> None:
    """A right angle and a reversal last as long as separate moves; a short last segment slows the
    ones before it."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1600, "these contours")
    motion.needs_speed(3000, "these contours")
    for lines, requirement in (
        (("M1000", "M0,1000"), "MN4-CC-07"), (("M1000", "M-1000"), "MN4-CC-07"),
        (("M1000", "M200", "M100", "M50", "M10"), "MN4-CC-03"),
        (("M5", "M10", "M300,300", "M300,300", "M0,5"), "MN4-CC-03"),
    ):  # fmt: skip
        motion.ready(speed=3000)
        contour(motion, "(", lines, "MN4-CC-09")
        motion.do(")", "MN4-CC-09")
        motion.follow(requirement, "MN4-CC-09", (requirement, "MN4-CC-09"), samples=8)


@check("MN4-CC-06", "MN4-CMD-CC-07", "MN4-CC-08", safety=MOTION)
def every_segment_keeps_its_own_speed(session: Session) -> None:
    """Fast, then slow, then below the start speed; the last V stays for what follows.  Above the
    end speed of the profile it is that one.  The fourth axis bounds no speed and ends exactly."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1600, "these contours")
    motion.needs_speed(3000, "these contours")
    for lines in (
        ("V3000", "M1000", "V2000", "M500"), ("V500", "M200", "V3000", "M1000", "V400", "M100"),
        ("V3000", "M700", "V800", "M10", "V3000", "M700"),
    ):  # fmt: skip
        motion.ready()
        contour(motion, "(", lines, "MN4-CC-06")
        motion.do(")", "MN4-CC-06")
        motion.follow("MN4-CC-06", samples=10)
        motion.run("M-800", "MN4-CMD-CC-07")
    motion.ready(speed=3000, profile=BELOW)
    contour(motion, "(", ("M700,30", "M700,30", "M100"), "MN4-CC-06")
    motion.do(")", "MN4-CC-06")
    motion.follow("MN4-CC-06", samples=8)
    motion.ready(speed=3000)
    contour(motion, "(", ("M700,0,0,300", "M700,0,0,-300", "M200,0,0,200"), "MN4-CC-08")
    motion.do(")", "MN4-CC-08")
    motion.follow("MN4-CC-08", samples=8)


@check("MN4-CC-09", "MN4-CC-04", safety=MOTION)
def a_contour_is_no_slower_than_separate_moves(session: Session) -> None:
    """Nor faster than its caps allow; a wider margin makes none slower.  Where the margin is the
    speed of a corner beyond it, a narrow one may be slower (MN4-AMB-33)."""
    motion = BoardMotion(BoardDriver(session))
    has_slow_corners = motion.driver.reading("cc_corner_speed") == "margin"
    motion.needs_room(1500, "these contours")
    motion.needs_speed(3000, "these contours")
    lines = ("M500,10", "M500,40,5", "M500,90,-10")
    least = Fraction(3 * 500, 3000)
    slowest: Fraction | None = None
    for margin in (0, 20, 200, 2000):
        motion.ready(speed=3000)
        profile = motion.model.settings.motion_profile(motion.driver.reading)
        most = 3 * ramped(500, 3000, profile).seconds
        contour(motion, f"({margin}", lines, "MN4-CC-09")
        motion.do(")", "MN4-CC-09")
        first, last = motion.lasts()
        told = f"{float(least):.3f} to {float(most):.3f} s"
        is_right = last >= least and (first <= most or has_slow_corners)
        came = f"{float(first):.3f} to {float(last):.3f} s at margin {margin}"
        session.expect(is_right, "MN4-CC-09", told, came)
        is_monotone = slowest is None or first <= slowest + SAME_SPEED
        session.expect(is_monotone, "MN4-CC-04", f"no more than {slowest} s", came)
        slowest = last if slowest is None else min(slowest, last)


@check("MN4-CMD-CC-06", "MN4-CC-10", safety=MOTION)
def a_running_contour_can_be_paused_and_quit(session: Session) -> None:
    """{ and } lose no step, N and E add up to its end meanwhile, and each segment has its own speed
    behind it; Q ends all of it."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(1500, "these contours")
    lines = ("M500,100", "V1200", "M500,-100,300", "V300", "M-200,0,-300,40")
    for at_s in (0.1, 0.4, 0.7):
        motion.ready(speed=1500)
        contour(motion, "(", lines, "MN4-CMD-CC-06")
        motion.do(")", "MN4-CMD-CC-06")
        driver.target.wait(at_s)
        motion.do("{", "MN4-CMD-CC-06")
        here = motion.rest_paused()
        rest = driver.counted(map(operator.sub, (800, 0, 0, 40), here))
        left = driver.steps_left()
        driver.tells(left == rest, "MN4-CC-10", f"{rest} at {here}", left)
        motion.do("}", "MN4-CMD-CC-06")
        motion.follow("MN4-CMD-CC-06")
    motion.ready(speed=1500)
    contour(motion, "(", lines, "MN4-CMD-CC-06")
    motion.do(")", "MN4-CMD-CC-06")
    driver.target.wait(0.3)
    motion.do("Q", "MN4-CMD-CC-06")
    counters = motion.rest()
    told = "on the way, not at the end"
    session.expect(0 < counters[0] < 1000, "MN4-CMD-CC-06", told, counters)
    motion.stays("MN4-CMD-CC-06", 1.0)


@check("MN4-CMD-CC-09", "MN4-CC-01", safety=MOTION, level="full")
def a_contour_has_room_for_256_segments(session: Session) -> None:
    """One more is SLAVEBUFFOV and lost, and none of the others is: each goes a step, and they end
    where these lead."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    capacity = int(driver.reading("cc_capacity"))
    motion.ready()
    motion.set("(")
    taken = 0
    for _ in range(capacity):
        exchange = driver.ask(one_step_text(taken, motion.room, 1))
        if not exchange.says(*DONE):
            driver.tells(False, "MN4-CMD-CC-09", f"{capacity} segments", f"{taken}: {exchange}")
            break
        taken += 1
    else:
        exchange = driver.ask(one_step_text(taken, motion.room, 1))
        codes = driver.errors("SLAVEBUFFOV")
        is_full = exchange.says(*codes)
        driver.tells(is_full, "MN4-CMD-CC-09", " and ".join(codes), exchange)
        taken += exchange.says(*DONE)
    driver.draws(")", DONE, "MN4-CC-01")
    driver.target.wait(PLANNED_S)
    place, wanted = motion.rest(), all_steps(taken, motion.room, 1)
    told = f"{wanted} when a contour of {taken} segments of one step is over"
    session.expect(place == wanted, "MN4-CC-01", told, place)
