"""The table of commands and states, where a program or a configuration is entered, and where a
program runs (STM, NVM, U).

What an entry stores is a program that runs by nobody: the snapshot, or an empty configuration,
takes its place.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.acceptance import (
    JOG_SPEED,
    SETTLED_S,
    TEXTS,
    is_listing,
    unchanged,
)
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.checks.stored import judge_listing
from axistwin_conformance.families.mn400.driver import DONE
from axistwin_conformance.families.mn400.grammar import ReplyForm, rule_of
from axistwin_conformance.families.mn400.model.states import BoardState
from axistwin_conformance.families.mn400.motion.board_motion import BoardMotion
from axistwin_conformance.families.mn400.persistence.programs import (
    emptied_afterwards,
    end_program,
    enter_program,
    program_entry,
    relative_mode,
)
from axistwin_conformance.families.mn400.probes.stored import RUNNING
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 260

RUN_S: Final = 20  # for which the program runs
STEPS: Final = 400
FEW: Final = 40  # of a move behind an entry: it takes 0.2 s
LASH: Final = "B20,20,20,20"  # in force while lines are entered that would set another one
STORING: Final = ("Z", ".", "U")


def _sent(motion: BoardMotion, *left_out: str) -> tuple[str, ...]:
    """Every command as a line, but for these."""
    return tuple(text for text in (*TEXTS, *unchanged(motion), *STORING) if text not in left_out)


def _settings(motion: BoardMotion) -> tuple[str, ...]:
    """Lines that would change each setting that a move, an arc or a flag shows."""
    plane, absolute = motion.plane(2, 4, 1), motion.mode(is_absolute=True)
    lines = ("V2", "F2,2,1", "B0,0,0,0", "D-1,-1,-1,-1", "X4", plane, absolute, ";1")
    return motion.driver.known(lines)


def _prepared(session: Session) -> tuple[BoardMotion, int]:
    """A board whose settings differ from all those, and the steps of a short move."""
    motion, steps = slow_board(session)
    for text in motion.driver.known((LASH, ";0")):
        motion.set(text)
    return motion, min(steps, FEW)


def _judge_settings(motion: BoardMotion, steps: int, requirement: str) -> None:
    """Judge by a flag and short motions that the settings are those of before the entry."""
    session, driver = motion.session, motion.driver
    if driver.reading("has_feedhold_cmds") == "true":
        flags = driver.flags()
        session.expect(flags["FeedHold"] == 0, requirement, "FeedHold 0", flags)
    motion.do(f"M{steps},{steps}", requirement)
    exchange = driver.ask("E1")
    fields = (exchange.value.fields if exchange.value else None) or (FEW + 1,)
    told = f"a count of at most {FEW}"
    session.expect(fields[-1] <= FEW, requirement, told, exchange.observed)
    motion.follow(requirement, samples=2)
    motion.run(f"M-{steps},-{steps}", requirement, samples=2)
    motion.run(f"A-{steps},0,-{steps},-{steps},1", requirement, samples=2)
    # The last way of all axes is that of the first: what was taken up of the backlash is let go.
    motion.run(f"M{steps},{steps},{steps}", requirement, samples=2)


def _judge_line(motion: BoardMotion, text: str, requirement: str) -> None:
    """Judge what a line of an entry draws, and take it over."""
    exchange = motion.driver.ask(text)
    span = motion.span(exchange)
    expected = replace(motion.model.expect(text, span), requirement=requirement)
    if text == "&" and motion.driver.reading("retransmit_in_entry") == "retransmit":
        is_right = len(exchange.codes) == 1 and exchange.is_sound
        motion.session.expect(is_right, requirement, "the last packet again", exchange, "to &")
        return
    motion.driver.fits(text, exchange, expected)
    if exchange.codes == DONE:
        motion.model.accept(text, span)


@check("MN4-STM-04", "MN4-NVM-01", safety=RUNNING)
@restoring("B")
def in_a_program_every_command_is_a_line(session: Session) -> None:
    """Each of the commands, wrong parameters and unknown ones between Z and Ctrl-D: what draws DONE
    is listed by R, nothing moves, and later motions go by the settings of before."""
    motion, few = _prepared(session)
    with program_entry(motion.driver):
        motion.model.accept("Z", motion.now)
        for text in (*_sent(motion, codec.END_OF_PROGRAM, "."), *_settings(motion)):
            _judge_line(motion, text, "MN4-STM-04")
        motion.driver.judge(end_program(motion.driver), DONE, "MN4-NVM-01")
    position = motion.driver.position()
    session.expect(not any(position), "MN4-NVM-01", "counters of 0", position)
    judge_listing(motion.driver, motion.model.lines, ("MN4-STM-04",))
    motion.model.accept(codec.END_OF_PROGRAM, motion.now)
    _judge_settings(motion, few, "MN4-NVM-01")


@check("MN4-NVM-04", safety=("motion", "stored", "destructive"), needs=("alone",))
@restoring("B")
def in_a_configuration_every_command_is_a_line(session: Session) -> None:
    """Each of the commands between . and Q draws DONE or INVALIDPROGCOMM; nothing moves, and later
    motions go by the settings of before."""
    motion, few = _prepared(session)
    with emptied_afterwards(motion.driver):
        motion.driver.draws(".", DONE, "MN4-NVM-04")
        motion.model.accept(".", motion.now)
        for text in (*_sent(motion, "Q"), *_settings(motion)):
            _judge_line(motion, text, "MN4-NVM-04")
        motion.do("Q", "MN4-NVM-04")
        position = motion.driver.position()
        session.expect(not any(position), "MN4-NVM-04", "counters of 0", position)
        _judge_settings(motion, few, "MN4-NVM-04")


@check("MN4-CMD-U-01", "MN4-STM-02", safety=RUNNING)
def while_a_program_runs_reads_are_served(session: Session) -> None:
    """Reads and polls as ever, { pauses, Q ends it; what it draws otherwise is told."""
    motion, steps = slow_board(session, RUN_S, STEPS)
    program = (relative_mode(motion.driver), f"M{steps}")
    enter_program(motion.driver, program)
    _run(motion)
    for text in _sent(motion, "Z", "."):
        if not _judge_running(motion, text):
            for ending in ("Q", "K", "Q", "J0"):
                motion.driver.ask(ending)
            _run(motion)
    motion.driver.draws("Q", DONE, "MN4-CMD-U-01")
    motion.stays("MN4-CMD-U-01")


def _run(motion: BoardMotion) -> None:
    motion.ready(JOG_SPEED, speed=motion.model.settings.speed)
    motion.driver.draws("U", DONE, "MN4-CMD-U-01")
    motion.target.wait(SETTLED_S)


def _judge_running(motion: BoardMotion, text: str) -> bool:
    """Judge one command; True if the program certainly runs on."""
    driver, rule = motion.driver, rule_of(text)
    exchange = driver.ask(text)
    if text == "&":
        motion.session.expect(
            len(exchange.codes) == 1, "MN4-STM-02", "one packet", exchange.observed
        )
        return True
    if rule and rule.form is ReplyForm.LISTING and is_listing(exchange):
        return True
    expected = replace(motion.model.expect_in(text, BoardState.RUN), requirement="MN4-STM-02")
    is_usual = driver.fits(text, exchange, expected)
    if text in ("Q", "{"):
        motion.stays("MN4-STM-02")
        return False
    return is_usual
