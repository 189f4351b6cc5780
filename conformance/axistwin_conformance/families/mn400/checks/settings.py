"""What is refused of commands that move, hold or collect, and of spaces; what L leaves alone (ERR,
PAR, PKT, A, C, H, L)."""

from __future__ import annotations

import re
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.boundaries import edges
from axistwin_conformance.families.mn400.checks.parameters import judge_text
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 125

STEPS: Final = 60
MOVERS: Final = "MA+TCJ"
LAST_OUTPUT: Final = "C8,1"
SWITCHES: Final = "H("
NUMBER: Final = re.compile("[0-9]+")
# What leaves N and E as they are, at rest behind a Q.
LEFT_ALONE: Final = (
    ("|", "MN4-CMD-EXIT-03"), ("V300", "MN4-CMD-N-02"), ("F300,400,500", "MN4-CMD-N-02"),
    ("B1,1,1,1", "MN4-CMD-N-02"), ("X2", "MN4-CMD-N-02"), ("Q", "MN4-CMD-Q-03"),
)  # fmt: skip
REFUSALS: Final = ("MN4-ERR-02", "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-04", "MN4-PAR-09")


@check(*REFUSALS, "MN4-PAR-05", "MN4-CMD-A-03", "MN4-HEL-05", "MN4-CMD-C-03", safety=MOTION)
def what_moves_is_refused_beyond_its_edges(session: Session) -> None:
    """Every text of M, A, +, T, C and J that is wrong draws PARA_ERROR; no axis moves.  The last of
    the outputs there are is served."""
    motion = BoardMotion(BoardDriver(session))
    motion.ready("Y100")
    is_guarded = session.transport.travel_guard is not None
    for letter in MOVERS:
        for text in edges(letter):
            refusal = motion.driver.refusal_of(text)
            if refusal is None or (is_guarded and _longest(text) > motion.room):
                continue
            judge_text(motion.driver, text, refusal)
        position = motion.stays("MN4-ERR-02")
        session.expect(
            not any(position), "MN4-ERR-02", "counters of 0", position, f"after {letter}"
        )
    motion.driver.draws(LAST_OUTPUT, DONE, "MN4-CMD-C-03")


def _longest(text: str) -> int:
    """The greatest number in a text: what a board that does not look at bounds may run to."""
    return max(map(int, NUMBER.findall(text)), default=0)


@check(*REFUSALS, "MN4-CMD-H-02", "MN4-CMD-CC-01")
@restoring("H")
def hold_and_contours_are_served_and_refused_at_their_edges(session: Session) -> None:
    """H and ( at all edges of their grammar; what is served is taken back."""
    driver, switched = BoardDriver(session), 0
    for letter in SWITCHES:
        for text in edges(letter):
            refusal = driver.refusal_of(text)
            judge_text(driver, text, refusal)
            if letter == "(":
                driver.ask("Q")
            elif refusal is None:
                switched += 1
    if driver.reading("hold_takes_arg") == "true":
        driver.command("H0")
    elif switched % 2:  # each has toggled
        driver.command("H")
    served = driver.ask("E")
    session.expect(served.says("START", "data"), "MN4-CMD-H-02", "START and a value", served)
    session.expect(driver.is_present(), "MN4-CMD-CC-01", "a poll's reply after Q", "none")


@check("MN4-PKT-12")
def a_space_is_no_part_of_a_command(session: Session) -> None:
    """In front of a read it makes an unknown command of it, behind it a parameter that is none."""
    driver = BoardDriver(session)
    if driver.reading("space_policy") == "skip":
        session.skip("this board leaves spaces out (MN4-AMB-68)")
    unknown = driver.errors("INVALIDCOMMAND", is_recognised=False)
    for text, codes in ((" E", unknown), ("E ", driver.errors("PARA_ERROR")),
                        ("V 2000", driver.errors("PARA_ERROR"))):  # fmt: skip
        driver.draws(text, codes, "MN4-PKT-12")


@check("MN4-CMD-L-03", "MN4-CMD-EXIT-03", "MN4-CMD-N-02", "MN4-CMD-Q-03", safety=MOTION)
def loading_leaves_what_is_left_of_a_move(session: Session) -> None:
    """N after Q tells the same before and after L; N and E do before and after |, settings and
    another Q."""
    motion, steps = slow_board(session, 1, STEPS)
    driver = motion.driver
    motion.do(f"M{steps}", "MN4-CMD-L-03")
    driver.target.wait(0.4)
    motion.do("Q", "MN4-CMD-L-03")
    here, before = motion.rest(), driver.steps_left()
    for text, requirement in LEFT_ALONE:
        motion.do(text, requirement)
        seen = driver.position(), driver.steps_left()
        is_same = seen == (here, before)
        told = f"told by E and N behind {text}"
        session.expect(is_same, requirement, (here, before), seen, told)
    motion.do("L5,6,7,8", "MN4-CMD-L-03")
    after = driver.steps_left()
    session.expect(after == before, "MN4-CMD-L-03", before, after, "told by N")
