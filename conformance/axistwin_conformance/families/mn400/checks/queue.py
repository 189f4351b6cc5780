"""What a board does while it moves: it answers at once, queues what must wait, and serves the rest
(RSP, STM, Q, RTX, SW)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from operator import sub
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.client import REPLY_LIMIT_S, BoardExchange
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion

ORDER = 120  # of this module in a run; see `Family.modules`

STEPS: Final = 400  # of a move that is looked at while it runs
MOVE_S: Final = 2
LOOKS: Final = 12
MOST_TAKEN: Final = 1024  # commands; where a queue or a contour ends that takes more stays open
MOST_ONE_WAY: Final = 400  # steps: three axes have room for more moves than are ever queued
NO_END: Final = "{taken} commands are queued, and no end of it"
QUEUE_S: Final = 40  # of a move behind which the queue is filled: about so many at 9600 baud
# What neither moves nor clears anything, behind a Q.
LEAVING_FLAGS: Final = (
    "V200", "F1000,5000,10000", "X1", "B0,0,0,0", "D1,1,1,1", "Y1000", "L0,0,0,0",
)  # fmt: skip
SPARE_S: Final = 1  # by which a move lasts longer than it takes to fill the queue again


def slow_board(
    session: Session, seconds: float = MOVE_S, steps: int = STEPS
) -> tuple[BoardMotion, int]:
    """A board that is ready for moves of so many steps (or as many as there is room for), each of
    which takes so long; and the steps."""
    motion = BoardMotion(BoardDriver(session))
    steps = motion.within(steps)
    motion.ready(speed=max(2, round(steps / seconds)))
    return motion, steps


def needs_flags(session: Session) -> None:
    """Leave the check out where a board has no ; and : (MN4-AMB-38)."""
    if session.reading("has_feedhold_cmds") == "false":
        session.skip("this board has no ; and : (MN4-AMB-38)")


@check("MN4-RSP-15", safety=MOTION)
def a_position_is_of_one_instant(session: Session) -> None:
    """Of axes that go equally far no reading shows one behind the other, nor any going back."""
    motion, steps = slow_board(session)
    motion.set(f"M{steps},{steps},,{-steps}")
    rows = []
    for _ in range(LOOKS):
        session.target.wait(MOVE_S / LOOKS)
        rows.append(motion.driver.position())
    is_one = all(row[0] == row[1] == -row[3] for row in rows)
    motion.driver.tells(is_one, "MN4-RSP-15", "axes 1, 2 and 4 as far as one another", rows)
    firsts = [row[0] for row in rows]
    motion.driver.tells(firsts == sorted(firsts), "MN4-RSP-15", "no way back", firsts)
    motion.rest()


def standing_axis_loaded(driver: BoardDriver) -> str:
    """An L that loads axis 2 with 7, and no other axis unless this board has no such L."""
    return "L,7" if driver.reading("omitted_param") == "keep" else "L0,7,0,0"


@check("MN4-STM-01", "MN4-ERR-02", safety=MOTION)
def counters_are_loaded_in_their_turn(session: Session) -> None:
    """An L sent while a move runs is carried out behind it, where settings are queued at all; an X3
    that is refused meanwhile drops nothing of what waits."""
    motion, steps = slow_board(session)
    driver = motion.driver
    motion.do(f"M{steps}", "MN4-STM-01")
    motion.do(standing_axis_loaded(driver), "MN4-STM-01")
    is_queued = driver.position()[1] == 0
    driver.follows("queue_modal", "true" if is_queued else "false", "MN4-STM-01")
    driver.draws("X3", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    motion.wait_until(motion.ends[1])
    position = motion.rest()
    names, told = ("MN4-STM-01", "MN4-ERR-02"), "counter 2 loaded with 7"
    session.expect(position[1] == 7, names, told, position, "X3 was refused meanwhile")


@check("MN4-STM-02", safety=MOTION)
def in_motion_reads_are_answered_at_once(session: Session) -> None:
    """Every read, poll and repetition in motion, within the time of a reply; the move goes on."""
    motion, steps = slow_board(session, 4)
    driver = motion.driver
    motion.set(f"M{steps}")
    usual_s = REPLY_LIMIT_S + session.target.uncertainty_ns / 1e9
    flags = [":"] if driver.reading("has_feedhold_cmds") == "true" else []
    for text in ("E", "N", "S", "/", "?", "[", *flags, "*", "&"):
        wanted = PRESENT if text == "*" else ("PRESENT",) if text == "&" else DATA
        exchange = driver.draws(text, wanted, "MN4-STM-02")
        took_s = (exchange.done_ns - exchange.asked_ns) / 1e9
        limit_s = usual_s + driver.client.later_s(text)
        told = f"an answer within {limit_s:.2f} s"
        session.expect(took_s <= limit_s, "MN4-STM-02", told, f"{took_s:.3f} s", f"to {text}")
    motion.follow("MN4-STM-02")


@check("MN4-STM-02", "MN4-CMD-FH-02", "MN4-CMD-EXIT-03", safety=MOTION)
def in_motion_what_is_no_setting_of_motion_works_at_once(session: Session) -> None:
    """; and | in motion: : and / tell so before the move is over."""
    needs_flags(session)
    motion, steps = slow_board(session, 4)
    driver = motion.driver
    motion.do(f"M{steps}", "MN4-STM-02")
    for mode in (1, 0):
        driver.draws(f";{mode}", DONE, "MN4-STM-02")
        flags = driver.flags()
        driver.tells(flags["FeedHold"] == mode, "MN4-CMD-FH-02", f"FeedHold {mode}", flags)
    driver.draws("|", DONE, "MN4-STM-02")
    code = driver.exit_code()
    driver.tells(code == 0, "MN4-CMD-EXIT-03", "exit code 0", code)
    motion.follow("MN4-STM-02")


def one_step(number: int, room: int, first: int = 2) -> tuple[int, int]:
    """Axis and way of the move of that number among many of one step: three axes in turn, all
    forward, so that each move that is lost is missed at the end; back where there is no room."""
    one_way = 3 * max(1, min(room, MOST_ONE_WAY))
    return first + number % 3, 1 if number // one_way % 2 == 0 else -1


def one_step_text(number: int, room: int, first: int = 2) -> str:
    """The M of that move."""
    axis, way = one_step(number, room, first)
    return f"M{',' * (axis - 1)}{way}"


def all_steps(count: int, room: int, first: int = 2) -> tuple[int, ...]:
    """How far so many of these moves lead each axis."""
    steps = [0] * AXES
    for number in range(count):
        axis, way = one_step(number, room, first)
        steps[axis - 1] += way
    return tuple(steps)


def judge_endless_queue(motion: BoardMotion, before: Sequence[int], taken: int) -> None:
    """Whether what a queue has taken that has no end is carried out; its depth stays open."""
    went = tuple(map(sub, motion.rest()[1:], before[1:]))
    wanted = all_steps(taken, motion.room)[1:]
    motion.session.expect(
        went == wanted,
        "MN4-STM-03",
        f"axes 2, 3 and 4 gone {wanted} when {taken} queued moves of one step are over, or"
        " SLAVEBUFFOV",
        went,
    )
    motion.session.skip(NO_END.format(taken=taken))


def fill_queue(motion: BoardMotion) -> tuple[int, BoardExchange]:
    """Behind a move that runs: how many moves the queue takes, `MOST_TAKEN` at most, and what the
    last request draws; the check or probe is left out if the move may end before that."""
    taken, until_s = 0, motion.ends[0] - 1
    while (exchange := motion.driver.ask(one_step_text(taken, motion.room))).codes == DONE:
        taken += 1
        if taken == MOST_TAKEN:
            break
        if motion.now[1] > until_s:
            motion.driver.ask("Q")
            motion.session.skip(f"the move is too short for a queue of more than {taken} commands")
    return taken, exchange


def judge_each_place(session: Session, taken: int, seconds: float) -> None:
    """Fill a queue of so many places again, which takes so long, offer it one move more, and let it
    all run: each move that was taken has led on, and the one that was refused has not."""
    motion, steps = slow_board(session, seconds + SPARE_S)
    motion.do(f"M{steps}", "MN4-STM-01")
    for number in range(taken):
        motion.driver.draws(one_step_text(number, motion.room), DONE, "MN4-STM-03")
    exchange = motion.driver.ask(one_step_text(taken, motion.room))
    if motion.now[1] > motion.ends[0]:
        session.skip("the move was over before the queue was full again")
    motion.driver.judge(exchange, motion.driver.errors("SLAVEBUFFOV"), "MN4-STM-03")
    motion.wait_until(motion.ends[1] + Fraction(taken, motion.model.settings.speed))
    place = motion.rest()
    wanted = steps, *all_steps(taken, motion.room)[1:]
    told = f"{wanted} when M{steps} and {taken} moves of axes 2, 3 and 4 by one step are over"
    names = ("MN4-STM-01", "MN4-STM-03")
    session.expect(place == wanted, names, told, place, "all of which were taken, and no other")


def empty_queue(motion: BoardMotion, taken: int) -> None:
    """Behind a Q: end so many moves one by one where Q ends but the one that runs (MN4-AMB-62)."""
    if motion.driver.reading("quit_flushes_queue") == "false":
        for _ in range(taken):
            motion.driver.ask("Q")


@check("MN4-STM-03", "MN4-STM-01", safety=MOTION)
def a_full_queue_is_told(session: Session) -> None:
    """Behind a move as many commands are taken as the queue holds; the next draws START and
    SLAVEBUFFOV and is lost, and none of the others is.  Where that does not come, all that was
    taken is carried out."""
    motion, steps = slow_board(session, QUEUE_S)
    driver = motion.driver
    before = driver.position()
    motion.do(f"M{steps}", "MN4-STM-03")
    began = motion.now[0]
    taken, exchange = fill_queue(motion)
    seconds = float(motion.now[1] - began)
    if taken == MOST_TAKEN:
        judge_endless_queue(motion, before, taken)
    codes = driver.errors("SLAVEBUFFOV")
    driver.judge(exchange, codes, "MN4-STM-03")
    driver.follows("queue_depth", str(taken), "MN4-STM-03")
    driver.draws("Q", DONE, "MN4-STM-03")
    empty_queue(motion, taken)
    motion.stays("MN4-STM-03")
    judge_each_place(session, taken, seconds)


@check("MN4-CMD-RTX-03", safety=MOTION)
def a_repetition_repeats_and_carries_nothing_out(session: Session) -> None:
    """& behind E tells twice what E told, though the axis has gone on; & behind M moves nothing."""
    motion, steps = slow_board(session)
    driver = motion.driver
    motion.do(f"M{steps}", "MN4-CMD-RTX-03")
    for _ in range(2):
        again = driver.draws("&", ("DONE",), "MN4-CMD-RTX-03")
    seen = driver.position()
    driver.target.wait(MOVE_S / 4)
    for _ in range(2):
        again = driver.draws("&", ("data",), "MN4-CMD-RTX-03")
        told = again.value.fields if again.value else None
        session.expect(told == seen, "MN4-CMD-RTX-03", seen, told, "as E told before")
    now = driver.position()
    session.expect(now[0] > seen[0], "MN4-CMD-RTX-03", f"more than {seen[0]}", now)
    motion.follow("MN4-CMD-RTX-03")


def _judge_flags_behind_settings(motion: BoardMotion, steps: int) -> None:
    driver = motion.driver
    motion.set(f"M{steps}")
    for text in (";1", "Q"):
        motion.do(text, "MN4-CMD-SW-01")
    motion.rest()
    for text in (*LEAVING_FLAGS, motion.mode(is_absolute=False)):
        motion.do(text, "MN4-CMD-SW-01")
    driver.draws("M10a", driver.errors("PARA_ERROR"), "MN4-CMD-SW-01")
    flags = driver.flags()
    both = flags["FeedHold"], flags["AbortFlag"]
    told = "FeedHold and AbortFlag after ;1, Q, settings and what is refused"
    motion.session.expect(both == (1, 1), "MN4-CMD-SW-01", (1, 1), both, told)
    motion.do("|", "MN4-CMD-SW-01")
    flags = driver.flags()
    motion.session.expect(flags["FeedHold"] == 1, "MN4-CMD-FH-02", "FeedHold 1", flags, "after |")
    motion.do(";0", "MN4-CMD-FH-02")


@check("MN4-CMD-SW-01", "MN4-CMD-FH-02", "MN4-CMD-Q-03", "MN4-PKT-05", safety=MOTION)
def the_abort_flag_is_of_the_last_motion(session: Session) -> None:
    """AbortFlag is 1 after Q has ended a move, paused or not, whatever is set or refused then,
    also behind a | under a wrong sum; 0 after | and behind the next move, and still 0 after a Q at
    rest and what is refused there.  FeedHold is as ; has it throughout."""
    needs_flags(session)
    motion, steps = slow_board(session)
    _judge_flags_behind_settings(motion, steps)
    for before, behind in (((), "|"), (("{",), f"M{steps}")):
        motion.set(f"M{steps}")
        for text in (*before, "Q"):
            motion.do(text, "MN4-CMD-SW-01")
        first, second = (motion.driver.flags()["AbortFlag"] for _ in range(2))
        told = f"AbortFlag after {' and '.join((*before, 'Q'))}"
        session.expect(first == 1, "MN4-CMD-SW-01", 1, first, told)
        seen = "next_or_clear" if second else "read"
        motion.driver.follows("abort_flag_clear", seen, "MN4-CMD-SW-01")
        motion.driver.ignores("|")
        third = motion.driver.flags()["AbortFlag"]
        session.expect(third == second, "MN4-PKT-05", second, third, "AbortFlag as before")
        motion.do(behind, "MN4-CMD-SW-01")
        flag = motion.driver.flags()["AbortFlag"]
        session.expect(flag == 0, "MN4-CMD-SW-01", 0, flag, f"AbortFlag behind {behind}")
        motion.follow("MN4-CMD-SW-01")
    motion.do("Q", "MN4-CMD-Q-03")
    flag = motion.driver.flags()["AbortFlag"]
    session.expect(flag == 0, "MN4-CMD-Q-03", 0, flag, "AbortFlag after a Q at rest")
    for text in ("X3", "W", "K"):
        motion.driver.ask(text)
    motion.driver.ignores("X1")
    flag = motion.driver.flags()["AbortFlag"]
    told = "AbortFlag after what is refused at rest"
    session.expect(flag == 0, "MN4-CMD-SW-01", 0, flag, told)
