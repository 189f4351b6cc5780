"""Backlash: a move against the remembered direction begins with steps that no counter tells (B, D;
BKL).  On the line it shows by the time for which the counters stand."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import AXES, DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion

ORDER = 160

LASH: Final = 100  # steps: 0.2 s at the speed of these checks
WIDE: Final = 300  # steps: more than a byte holds
FEW: Final = 40
SLOW: Final = 500
RAMPED: Final = (200, 4000, 10_000)  # start, end, acceleration: at neither of these speeds for long
UNEVEN: Final = f"B{LASH},30,{LASH},30"  # so that it shows which axes make these steps
ALL: Final = f"B{LASH},{LASH},{LASH},{LASH}"
# What waits behind a move of axis 1 until Q drops it: a move, an arc and a contour by which each
# axis would have turned round.
DROPPED: Final = (("M-50,-50",), ("A-50,0,-50,-50,1",), ("(", "M-80,,,-60", "M-80,,,-60", ")"))
# A contour that Q ends amid its first segment: in the second one each axis would go on as it went.
CUT_SHORT: Final = ("M100", "M,50,40,30", "M40")
CRAWL: Final = 50  # steps/s: at this one what is taken up may be little
BEHIND_S: Final = 0.6  # there: behind what is taken up, amid a move of 40 steps
CREEPING: Final = 100  # steps/s, for few steps: what may be taken up adds up
PAUSED_AT_S: Final = 0.25  # of a compensation of 0.6 s
PAUSED_BEHIND_S: Final = 0.9  # of the same, and amid the motion behind it
# What is paused there, and how often, with the backlash of its axes: moves, an arc, a contour.
PAUSED: Final = (
    (1, "B60,0,0,0", ("M-40",)), (2, "B0,60,0,8", ("M0,-30,0,-10",)),
    (1, "B0,0,60,0", ("A0,-20,-20,-20,-1",)), (1, "B60,0,0,0", ("(", "M-25,5", "M-15,-5", ")")),
)  # fmt: skip


def begun(session: Session) -> BoardMotion:
    """A motion with room for moves of some hundred steps and their compensation."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(12 * LASH, "these moves with their compensation")
    return motion


@check("MN4-BKL-01", "MN4-BKL-03", "MN4-CMD-B-01", "MN4-CMD-D-02", safety=MOTION)
def a_turn_costs_the_steps_of_the_backlash(session: Session) -> None:
    """None in the remembered direction, all of them against it, on those axes that D says."""
    motion = begun(session)
    for texts, moves in (
        ((ALL,), ("M200", "M-200", "M-100", "M300")),
        ((ALL, "D-1,1,1,1"), ("M200", "M50", "M-250")),
        ((ALL, "D1,-1,1,1"), ("M0,200", "M200,0")),
        ((f"B0,{LASH},0,0",), ("M-200,-100", "M200,100", "M-200")),
        ((f"B{LASH},30,0,0",), ("M-200,-200", "M100,200")),
        ((f"B{WIDE},0,0,0",), ("M-100", "M100")),
    ):
        motion.ready(*texts, speed=SLOW)
        for text in moves:
            names = ("MN4-BKL-01", "MN4-CMD-D-02", "MN4-CMD-B-01")
            motion.run(text, "MN4-CMD-B-01", names, "MN4-BKL-03", names, samples=6)
    motion.ready(f"B{FEW},{FEW},{FEW},{FEW}", speed=CREEPING)
    for axis in range(AXES):
        directions = ["1"] * AXES
        directions[axis] = "-1"
        forward = f"M{',' * axis}{FEW // 4}"
        motion.run(forward, "MN4-CMD-D-02", samples=2)
        motion.do(f"D{','.join(directions)}", "MN4-CMD-D-02")
        motion.run(forward, "MN4-CMD-D-02", samples=2)


@check("MN4-BKL-01", safety=MOTION)
def a_move_begins_from_rest_behind_its_compensation(session: Session) -> None:
    """With ramps: the compensation is a move of its own."""
    motion = _ramped(session)
    for text in ("M-300", "M300"):
        motion.run(text, "MN4-BKL-01", samples=8)


@check("MN4-BKL-07", safety=MOTION)
def a_contour_begins_from_rest_behind_its_compensation(session: Session) -> None:
    """The same of its first segment."""
    motion = _ramped(session)
    motion.set("(")
    for text in ("M-150,10", "M-150,10"):
        motion.do(text, "MN4-BKL-07")
    motion.do(")", "MN4-BKL-07")
    motion.follow("MN4-BKL-07", samples=8)


def _ramped(session: Session) -> BoardMotion:
    """Backlash on all axes, and a speed that is reached by ramps."""
    motion = begun(session)
    start, end = (motion.fast(one) for one in RAMPED[:2])
    motion.ready(ALL, speed=end, profile=(start, end, RAMPED[2]))
    return motion


@check("MN4-BKL-02", "MN4-BKL-04", "MN4-CMD-L-03", safety=MOTION)
def the_memory_is_of_the_last_motion(session: Session) -> None:
    """An axis that stood keeps it, one without backlash has it as well, L does not touch it; one
    that goes on as before makes no steps with those that turn round."""
    motion = begun(session)
    motion.ready(UNEVEN, speed=SLOW)
    for text in ("M-100,0,-100", "M-50,-50,-50,-50", "M50,0,50", "M50,50,50,50"):
        motion.run(text, "MN4-BKL-02")
    motion.ready(ALL, speed=SLOW)
    for text in ("M-100,100", "M0,100", "M100", "M0,-100", "M-200"):
        motion.run(text, "MN4-BKL-02")
    motion.ready(speed=SLOW)
    motion.run("M-100,100", "MN4-BKL-04")
    motion.do(ALL, "MN4-BKL-04")
    motion.run("M-100,100", "MN4-BKL-04")
    motion.run("M100,-100", "MN4-BKL-04")
    motion.do("L5,5,5,5", "MN4-CMD-L-03")
    motion.run("M50,-50", "MN4-CMD-L-03")
    motion.run("M-50", "MN4-CMD-L-03")


@check("MN4-BKL-02", safety=MOTION)
def what_quit_drops_is_not_remembered(session: Session) -> None:
    """Motions that have waited and never begun turn no axis, nor does a contour whose segments Q
    comes before: a move the way all axes went takes up no backlash then."""
    motion = begun(session)
    if motion.driver.reading("quit_flushes_queue") == "false":
        session.skip("Q of this board drops nothing (MN4-AMB-62)")
    if int(motion.driver.reading("queue_depth")) < len(DROPPED):
        session.skip("the queue of this board is too short (MN4-AMB-52)")
    motion.ready("B10,10,10,10", speed=CRAWL)  # what may be taken up adds up
    motion.do(f"M{4 * LASH}", "MN4-BKL-02")
    for first, *others in DROPPED:
        exchange = motion.driver.ask(first)
        if first == "(" and not exchange.says(*DONE):
            continue  # no contour is opened in motion here (ledger 4.1)
        motion.driver.judge(exchange, DONE, "MN4-BKL-02")
        motion.model.accept(first, motion.span(exchange))
        for text in others:
            motion.do(text, "MN4-BKL-02")
    _judge_behind_quit(motion)
    motion.ready("B10,10,10,10", speed=CRAWL)
    motion.set("(")
    for text in (*CUT_SHORT, ")"):
        motion.do(text, "MN4-BKL-02")
    _judge_behind_quit(motion)


def _judge_behind_quit(motion: BoardMotion) -> None:
    """Judge that no axis has turned round, and so none of them takes up backlash; and the same with
    axes that went back when Q ended their move."""
    motion.do("Q", "MN4-BKL-02")
    motion.rest()
    motion.run(f"M{FEW},{FEW},{FEW},{FEW}", "MN4-BKL-02")
    motion.do(f"M-{FEW},,-{FEW}", "MN4-BKL-02")
    motion.driver.target.wait(BEHIND_S)
    motion.do("Q", "MN4-BKL-02")
    motion.rest()
    motion.run(f"M-{FEW},{FEW},-{FEW}", "MN4-BKL-02")


@check("MN4-BKL-01", "MN4-BKL-03", "MN4-CMD-PAU-02", safety=MOTION)
def a_pause_in_the_compensation_loses_none_of_it(session: Session) -> None:
    """{ and } meanwhile, once and twice, and behind it: the rest of it is made and no more, then
    the whole motion; with a pause it is over no earlier than without, and later by the pause at
    most.  What is left is the whole motion as yet."""
    motion = begun(session)
    is_before_arcs = motion.driver.reading("backlash_arc") == "start_only"
    names = ("MN4-CMD-PAU-02", "MN4-BKL-01")
    for pauses, lash, texts in PAUSED:
        if texts[0].startswith("A") and not is_before_arcs:
            continue
        motion.ready(lash, speed=CREEPING)
        for text in texts:
            motion.do(text, names)
        for _ in range(pauses):
            motion.driver.target.wait(PAUSED_AT_S / pauses)
            motion.do("{", names)
            _judge_left(motion)
            motion.do("}", names)
        motion.follow(names, samples=8)
    motion.ready("B60,60,0,0", speed=CREEPING)
    motion.do("M-90,-30", names)
    motion.driver.target.wait(PAUSED_BEHIND_S)
    motion.do("{", names)
    motion.do("}", names)
    motion.follow(names, samples=8)


def _judge_left(motion: BoardMotion) -> None:
    """Within a compensation that no counter tells, N is the whole motion (MN4-AMB-58); where it
    may be over already it is not looked at."""
    driver = motion.driver
    is_apart = driver.reading("backlash_counts") == "false"
    is_net = driver.reading("readcount_arc") == "net"
    place = motion.model.where(motion.widened(motion.now))
    if is_apart and is_net and not any(low or high for low, high in place):
        whole, left = driver.counted(low for low, _ in motion.end), driver.steps_left()
        driver.tells(left == whole, "MN4-BKL-03", f"{whole} left", left)


@check("MN4-BKL-05", safety=MOTION)
def quit_in_the_compensation_leaves_the_whole_move(session: Session) -> None:
    """E stands, N is the move as asked for, and the memory is new already."""
    motion = begun(session)
    driver = motion.driver
    for name, wanted in (("backlash_counts", "false"), ("readcount_after_abort", "kept")):
        if driver.reading(name) != wanted:
            session.skip(f"this board is read as {name}={driver.reading(name)}: nothing to tell by")
    motion.ready(ALL, speed=SLOW)
    motion.do("M-200", "MN4-BKL-05")
    driver.target.wait(0.1)
    motion.do("Q", "MN4-BKL-05")
    counters = motion.rest()
    driver.tells(not any(counters), "MN4-BKL-05", "0, 0, 0, 0", counters)
    left = driver.steps_left()
    is_whole = tuple(map(abs, left)) == (200, 0, 0, 0)
    driver.tells(is_whole, "MN4-BKL-05", "200 steps left of axis 1", left)


@check("MN4-BKL-06", "MN4-BKL-07", safety=MOTION)
def arcs_and_contours_are_compensated_before_they_begin(session: Session) -> None:
    """By the direction in which each axis sets out; what is remembered is the last one, of the
    traverse axis of a helix, too."""
    motion = begun(session)
    if motion.driver.reading("backlash_arc") == "start_only":
        around = "-300,-300,-600,-600"
        few = f"B{FEW},{FEW},{FEW},{FEW}"  # what may be taken up adds up
        for lash, arc, back in (
            (ALL, f"A{around},1", "M0,50"), (ALL, f"A{around},-1", "M0,50"),
            (ALL, "A0,-50,-35,-15,-1", "M0,50"),  # its end is off the circle
            (few, "+-50,0,-100,0,1,-60,1", "M0,50"), (few, "+-50,0,-100,0,1,1,1", "M0,-50"),
        ):  # fmt: skip
            motion.ready(lash, speed=SLOW)
            motion.run(arc, "MN4-BKL-06")
            for text in ("M100", back, "M0,0,-50", "M-50"):
                motion.run(text, "MN4-BKL-06")
    else:
        session.not_run("MN4-BKL-06", "this board compensates within arcs (MN4-AMB-58)")
    motion.ready(ALL, speed=SLOW)
    motion.set("(")
    for text in ("M-200,10", "M-50,-100", "M0,0,100"):
        motion.do(text, "MN4-BKL-07")
    motion.do(")", "MN4-BKL-07")
    motion.follow("MN4-BKL-07", samples=8)
    for text in ("M-50", "M0,20", "M0,0,-50"):
        motion.run(text, "MN4-BKL-07")
