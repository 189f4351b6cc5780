"""Hold: what is kept, what is answered while a move is pending, and how it is released (H, K, RSP,
STM)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Requirements, Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.driver import DATA, DONE
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.motion.return_to_start import turn_hold_off

ORDER = 130

HOLD_S: Final = 0.6  # for which a move that is held is watched
RELEASED_S: Final = 0.8  # for which a move runs that has been released, while another is held
STEPS: Final = 40
# Commands that a board refuses while a move is pending; with an effect that would be seen.
REFUSED: Final = (
    "?", "E", "N", "S", "/", "[", ":", "*", "|", "L9,9,9,9", "V4000", "X4", "P1,2,3", "I0", "I1",
    "F10,20,30", "B9,9,9,9", "D-1,-1,-1,-1", ";", "G1,1,1,1,1", "Y2", "M7", "A-2,0,-4,0,1",
    "(", ")", "{", "R", "X3",
)  # fmt: skip
NOTHING_PENDING: Final = ("START", "NOMOVEPENDING")


def held(session: Session, seconds: float = 0.4) -> tuple[BoardMotion, int]:
    """A board on hold, at rest; and how many steps to ask it for."""
    motion, steps = slow_board(session, seconds, STEPS)
    motion.set(hold_text(motion))
    return motion, steps


def hold_text(motion: BoardMotion) -> str:
    """What turns hold on, from off."""
    return "H1" if motion.driver.reading("hold_takes_arg") == "true" else "H"


def keep(motion: BoardMotion, text: str, requirement: Requirements) -> None:
    """Judge that what asks for motion is kept, and draws what this board says then."""
    is_done = motion.driver.reading("pending_move_reply") == "done"
    codes = DONE if is_done else ("START", "MOVEPENDING")
    exchange = motion.driver.draws(text, codes, requirement)
    motion.model.accept(text, motion.span(exchange))


def release(motion: BoardMotion, requirement: Requirements, *, everyone: bool = False) -> None:
    """Judge that K draws what this board says then; to all boards if asked for."""
    driver = motion.driver
    is_done = driver.reading("release_reply") == "done"
    codes: tuple[str, ...] = DONE if is_done else ("START", "MOVEPENDING")
    if everyone:
        raw = codec.request(codec.ALL_BOARDS, "K")
        limit_s = driver.poll_slot_s() * driver.board + driver.session.reply_timeout_s
        exchange = driver.client.ask_raw(raw, limit_s)
        codes = () if driver.reading("broadcast_reply") == "poll_only" else codes
    else:
        exchange = driver.ask("K")
    driver.judge(exchange, codes, requirement)
    motion.model.accept("K", motion.span(exchange))


@check("MN4-CMD-H-01", "MN4-CMD-H-02", "MN4-CMD-K-01", "MN4-PKT-05", safety=MOTION)
def a_held_move_waits_for_its_release(session: Session) -> None:
    """With hold on a move is accepted and no axis moves; K runs it, and nothing under a wrong sum
    does, or ends hold.  With hold off, be it in motion, it runs at once, and what H comes upon in
    motion is not lost."""
    motion, steps = held(session)
    keep(motion, f"M{steps},{-steps}", "MN4-CMD-H-01")
    _stays_pending(motion)
    release(motion, "MN4-CMD-K-01")
    motion.follow("MN4-CMD-K-01")
    _judge_ignored(motion, f"M{-steps},{steps}")
    if motion.driver.reading("hold_after_release") == "one_shot":
        motion.set(hold_text(motion))
    keep(motion, f"M,,{steps}", "MN4-CMD-H-01")
    release(motion, "MN4-CMD-K-01")
    _hold_off(motion)  # in motion
    motion.do(f"M,,{-steps}", "MN4-CMD-H-02")
    motion.driver.draws("?", DATA, "MN4-CMD-H-02")
    motion.follow("MN4-CMD-H-02")
    motion.run(f"M{steps},{-steps}", "MN4-CMD-H-02")
    _hold_drops_nothing(motion, steps)


def _judge_ignored(motion: BoardMotion, text: str) -> None:
    """Judge that what ends hold, or a pending move, does nothing under a wrong sum."""
    driver = motion.driver
    if driver.reading("hold_after_release") == "one_shot":
        motion.set(hold_text(motion))
    ends = "H0" if driver.reading("hold_takes_arg") == "true" else "H"
    driver.ignores(ends)
    keep(motion, text, "MN4-PKT-05")
    for one in ("K", "Q", ends):
        driver.ignores(one)
    driver.draws("?", ("START", "MOVEPENDING"), "MN4-PKT-05")
    release(motion, "MN4-PKT-05")
    motion.follow("MN4-PKT-05")


def _hold_drops_nothing(motion: BoardMotion, steps: int) -> None:
    """H while a move runs and another waits: both are made in the end, even if the second should
    wait for K or for H0."""
    first, second, third, fourth = motion.rest()
    for text in (f"M,,{steps}", "M,,,1", hold_text(motion)):
        motion.do(text, "MN4-CMD-H-01")
    motion.wait_until(motion.ends[1])
    motion.driver.ask("K")
    turn_hold_off(motion.driver)
    place, wanted = motion.rest(), (first, second, third + steps, fourth + 1)
    told = f"{wanted} when M,,{steps} and M,,,1 behind it are over"
    motion.session.expect(place == wanted, "MN4-CMD-H-01", told, place, "H was sent meanwhile")


@check("MN4-CMD-H-01", "MN4-CMD-K-01", safety=MOTION)
def all_that_moves_is_held(session: Session) -> None:
    """An arc, a helix and a contour wait for K as a move does, where hold keeps more than M; they
    run in the plane that was set."""
    if session.reading("hold_scope") == "M":
        session.skip("this board holds M alone (MN4-AMB-18)")
    motion, steps = held(session)
    radius = max(1, steps // 4)
    around, contour = f"{-radius},0,{-2 * radius},0,1", ("(", f"M{steps}", f"M{steps}", ")")
    motion.set(motion.plane(2, 4, 1))
    for number, texts in enumerate(((f"A{around}",), (f"+{around},{radius},1",), contour)):
        if number and session.reading("hold_after_release") == "one_shot":
            motion.set(hold_text(motion))
        for text in texts[:-1]:
            motion.set(text)
        keep(motion, texts[-1], "MN4-CMD-H-01")
        _stays_pending(motion)
        release(motion, "MN4-CMD-K-01")
        motion.follow("MN4-CMD-K-01")
    _hold_off(motion)


def _stays_pending(motion: BoardMotion) -> None:
    """Nothing moves: no read is served now, so the pause is judged by where the axes are at the
    end, and by when they get there."""
    motion.target.wait(HOLD_S)
    motion.driver.draws("?", ("START", "MOVEPENDING"), "MN4-CMD-H-01")


def _hold_off(motion: BoardMotion) -> None:
    """H0, or the H that toggles, unless K has ended hold already."""
    if motion.driver.reading("hold_after_release") == "one_shot":
        return
    takes = motion.driver.reading("hold_takes_arg") == "true"
    if not takes and motion.driver.reading("hold_bare_arg") != "toggle":
        motion.session.skip("nothing turns this board's hold off")
    motion.set("H0" if takes else "H")


@check("MN4-CMD-K-02", "MN4-CMD-K-01", "MN4-CMD-H-01", "MN4-RSP-09", safety=MOTION)
def hold_stays_on_after_a_release(session: Session) -> None:
    """A second move is pending while the first runs that K has released; a { that is refused then
    pauses nothing, and a K that comes meanwhile runs the second behind the first.  Another is
    pending after Q has ended one, and after what sets, clears or is refused."""
    motion, steps = held(session, RELEASED_S)
    keep(motion, f"M{steps}", "MN4-CMD-K-02")
    release(motion, "MN4-CMD-K-02")
    exchange = motion.driver.ask(f"M,{-steps}")
    told = "START and DONE, or START and MOVEPENDING"
    is_taken = exchange.codes in (DONE, ("START", "MOVEPENDING"))
    session.step(is_taken, told, exchange, "to a move after K")
    is_on = motion.driver.ask("?").codes == ("START", "MOVEPENDING")
    seen = "stays_on" if is_on else "one_shot"
    motion.driver.follows("hold_after_release", seen, "MN4-CMD-K-02")
    motion.model.accept(f"M,{-steps}", motion.span(exchange))
    if is_on:
        motion.driver.draws("{", ("START", "MOVEPENDING"), "MN4-RSP-09")
        release(motion, "MN4-CMD-K-01")
        motion.target.wait(RELEASED_S / 4)
        motion.look("MN4-RSP-09")
        motion.follow("MN4-CMD-K-01")
        keep(motion, f"M{-steps}", "MN4-CMD-K-02")
        release(motion, "MN4-CMD-K-02")
        _stays_on(motion, steps)
    motion.follow("MN4-CMD-K-02")
    _hold_off(motion)


def _stays_on(motion: BoardMotion, steps: int) -> None:
    """Neither Q, in motion and at rest, nor |, settings or an error turns hold off."""
    for text in ("Q", "Q", "|", "V100", "L0,0,0,0"):
        motion.do(text, "MN4-CMD-H-01")
        motion.rest()
    motion.driver.draws("M10a", motion.driver.errors("PARA_ERROR"), "MN4-CMD-H-01")
    keep(motion, f"M{steps}", "MN4-CMD-H-01")
    _stays_pending(motion)
    release(motion, "MN4-CMD-K-02")


@check("MN4-RSP-09", "MN4-CMD-K-01", "MN4-STM-08", "MN4-CMD-RTX-01", safety=MOTION)
def with_a_move_pending_nothing_else_is_served(session: Session) -> None:
    """Reads, settings and a second move draw START and MOVEPENDING and have no effect: K runs the
    first move as it was asked for, and nothing behind it."""
    motion, steps = held(session)
    driver = motion.driver
    has_flags = driver.reading("has_feedhold_cmds") == "true"
    before = driver.flags()["FeedHold"] if has_flags else 0
    keep(motion, f"M{steps},,{-steps}", "MN4-RSP-09")
    for text in REFUSED:
        if text[0] in ":;" and not has_flags:
            continue
        text = f";{1 - before}" if text == ";" else text
        name = "MN4-STM-08" if text[0] in "MA" else "MN4-RSP-09"
        driver.draws(text, ("START", "MOVEPENDING"), name)
    driver.repeats(driver.ask("?"), "MN4-CMD-RTX-01")
    for letter, readings in (("Q", ("K&Q", "K&QH")), ("H0", ("K&QH",))):
        if driver.reading("movepending_exempt") not in readings:
            driver.draws(letter, ("START", "MOVEPENDING"), "MN4-RSP-09")
    release(motion, "MN4-CMD-K-01")
    motion.follow(("MN4-RSP-09", "MN4-STM-08"))
    driver.draws("K", NOTHING_PENDING, "MN4-STM-08")
    motion.stays("MN4-STM-08")
    if has_flags:
        flags = driver.flags()
        is_kept = flags["FeedHold"] == before
        session.expect(is_kept, "MN4-RSP-09", f"FeedHold {before}", flags, "; was refused")
    _hold_off(motion)
    motion.run(f"M{-steps},,{steps}", "MN4-RSP-09")


@check("MN4-CMD-K-03", safety=MOTION, needs=("alone",))
def a_release_of_all_boards_is_one_of_this(session: Session) -> None:
    """K to id 0 runs the pending move."""
    motion, steps = held(session)
    keep(motion, f"M{steps}", "MN4-CMD-K-03")
    release(motion, "MN4-CMD-K-03", everyone=True)
    motion.follow("MN4-CMD-K-03")
    _hold_off(motion)
