"""The table of commands and states, in the states that take a motion to reach (STM).

One row of cells for each state: the board is brought into it, every command that may be sent there
is sent, and what comes is judged by the model.  A command that leaves the state, or whose answer is
one that the manual leaves open, is followed by a new beginning.  Where the axes are is read before
each, so that a command that was refused and did something all the same is found.

Z, . and U are not among them: they would lose or run what is stored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.hold import hold_text
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.client import BoardExchange
from axistwin_conformance.families.mn400.driver import DATA
from axistwin_conformance.families.mn400.grammar import ReplyForm, rule_of
from axistwin_conformance.families.mn400.model.states import BoardState, CellOutcome, state_table
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.motion.return_to_start import turn_hold_off, wait_for_rest

ORDER = 140

STATE_S: Final = 20  # for which a motion lasts that no command ends
STEPS: Final = 400
MOST_QUEUED: Final = 4  # commands that are left waiting, at most
JOG_SPEED: Final = "Y100"  # in case an input of the panel is on
SETTLED_S: Final = 0.6  # by which a state that was entered would show
LOAD: Final = "L1,2,3,4"
LOAD_STANDING: Final = "L,2,3,4"  # all axes but the one that moves
# Commands as they are sent in every state; what moves goes a few steps.
TEXTS: Final = (
    "/", "?", "S", "N", "E", "[", ":", "*", "&", "K", "|", "X1", "B0,0,0,0", "D1,1,1,1",
    "G2000,1000,100,10,8000", "Y1000", "X3", "\x04", "W", ";0", "R", "C1,1", LOAD, "}",
    "M2", "A-2,0,-4,0,1", "+-2,0,-4,0,1,2,0", "(", ")", "{", "J1", "T2,0,0,0,1000,0", "Q",
)  # fmt: skip
QUEUEING: Final = (BoardState.MOV, BoardState.QUE, BoardState.PAU, BoardState.CCX, BoardState.THR)
UNTRACED: Final = (BoardState.HPD, BoardState.CCB)  # E tells nothing there
REPEATS: Final = ("data", "DONE", "PRESENT", "NOMOVEPENDING", "MOVEPENDING", "INVALIDCOMMAND",
                  "PARA_ERROR", "BUSY", "BAUDCHANGEOK")  # fmt: skip


def unchanged(motion: BoardMotion) -> tuple[str, ...]:
    """Settings as the board has them, and hold."""
    driver, settings = motion.driver, motion.model.settings
    return (
        f"={driver.board}", f"~{codec.RATES.index(driver.target.baud)}", f"V{settings.speed}",
        f"F{','.join(map(str, settings.profile))}", motion.plane(1, 3, 2),
        motion.mode(is_absolute=False), hold_text(motion),
    )  # fmt: skip


def is_listing(exchange: BoardExchange) -> bool:
    """True for START and any number of lines, whatever ends them (MN4-AMB-41)."""
    first, *lines = exchange.codes or ("",)
    return first == "START" and {*lines} <= {"data", "DONE"} and not exchange.strays


class StateRow:
    """The cells of one state.  `waiting`: whose business a command is that is queued or kept;
    `other`: whose every other one is."""

    def __init__(self, session: Session, state: BoardState, waiting: str, other: str) -> None:
        self.session, self.state = session, state
        self.waiting, self.other = waiting, other
        self.motion, self.steps = slow_board(session, STATE_S, STEPS)
        self.driver = self.motion.driver
        self._queued = 0  # commands that wait
        self._most_queued = MOST_QUEUED
        if state in QUEUEING:
            places = int(self.driver.reading("queue_depth")) - (state is BoardState.QUE)
            self._most_queued = min(MOST_QUEUED, max(1, places))

    @property
    def _texts(self) -> tuple[str, ...]:
        """All that is sent.  Where an L acts at once the counter of an axis that moves is not
        loaded: nobody would know any more where that axis is (MN4-AMB-52)."""
        texts = (*TEXTS, *unchanged(self.motion))
        if self.state not in QUEUEING or self.driver.reading("queue_modal") == "true":
            return texts
        has_standing = self.driver.reading("omitted_param") == "keep"
        kept = [LOAD_STANDING] if has_standing else []
        at = texts.index(LOAD)
        return (*texts[:at], *kept, *texts[at + 1 :])

    def judge(self) -> None:
        """Judge every cell."""
        self._enter()
        for text in self._texts:
            if not self._judge_cell(text):
                self._leave()
                self._enter()
        self._leave()

    def _judge_cell(self, text: str) -> bool:
        """Judge one; True if the board is certainly in this state still."""
        self._trace()
        exchange = self.driver.ask(text)
        span = self.motion.span(exchange)
        model = self.motion.model
        expected = replace(model.expect(text, span), requirement=self._requirement(text))
        if text == "&":
            is_right = len(exchange.codes) == 1 and exchange.codes[0] in REPEATS
            self.session.expect(is_right, self.other, "one packet", exchange, "to &")
            return True
        rule = rule_of(text)
        if rule and rule.form is ReplyForm.LISTING and is_listing(exchange):
            return True
        if not self.driver.fits(text, exchange, expected):
            return False
        if self.state is BoardState.MOV and exchange.codes[-1:] == ("BUSY",):
            self.driver.repeats(exchange, "MN4-CMD-RTX-01")
        if exchange.codes[-1:] == ("DONE",) or text == "K" or self._is_kept(text):
            model.accept(text, span)
        self._queued += self._requirement(text) == self.waiting
        is_staying = model.states(span) == {self.state} and self._queued < self._most_queued
        if not is_staying:
            self._judge_entered(text)
        return is_staying

    def _judge_entered(self, text: str) -> None:
        """Judge in what state the last command has left the board: ? draws what it draws there, and
        the axes are where they are to be."""
        self.driver.target.wait(SETTLED_S)
        exchange = self.driver.ask("?")
        expected = self.motion.model.expect("?", self.motion.span(exchange))
        is_right = exchange.codes in expected.replies
        told = sorted(" and ".join(reply) for reply in expected.replies)
        name = self._requirement(text)
        self.session.expect(is_right, name, told, exchange, f"to ? behind {text}")
        if exchange.codes == DATA:
            self.motion.look(self.other)

    def _requirement(self, text: str) -> str:
        cell = state_table().get((text[:1].upper(), self.state))
        waits = (CellOutcome.QUEUED, CellOutcome.PENDING, CellOutcome.BUFFERED)
        return self.waiting if cell and cell.outcome in waits else self.other

    def _is_kept(self, text: str) -> bool:
        cell = state_table().get((text[:1].upper(), self.state))
        return cell is not None and cell.outcome is CellOutcome.PENDING

    def _trace(self) -> None:
        """Judge that the axes are where what was accepted leads them."""
        if self.state not in UNTRACED:
            self.motion.look(self.other)

    def _enter(self) -> None:
        self._queued = 0
        self.motion.ready(JOG_SPEED, speed=max(2, round(self.steps / STATE_S)))
        for text in ENTERING[self.state](self):
            exchange = self.driver.ask(text)
            self.session.step(exchange.is_sound, f"an answer to {text}", exchange.observed)
            self.motion.model.accept(text, self.motion.span(exchange))
        if self.state is BoardState.ABT and self.driver.reading("quit_decel") == "true":
            wait_for_rest(self.driver)  # what may be moving must not be loaded; see `_texts`

    def _leave(self) -> None:
        """End whatever may be going on, pending or entered, in any reading."""
        is_flushed = self.driver.reading("quit_flushes_queue") == "true"
        ends = ["Q"] * (1 if is_flushed else MOST_QUEUED + 2)
        for text in (*ends, "K", *ends):
            self.driver.ask(text)
        turn_hold_off(self.driver)
        self.driver.ask("J0")


Entering = Callable[[StateRow], tuple[str, ...]]

ENTERING: Final[Mapping[BoardState, Entering]] = {
    BoardState.RDY: lambda row: (),
    BoardState.MOV: lambda row: (f"M{row.steps}",),
    BoardState.QUE: lambda row: (f"M{row.steps}", f"M{-row.steps}"),
    BoardState.PAU: lambda row: (f"M{row.steps}", "{"),
    BoardState.HLD: lambda row: (hold_text(row.motion),),
    BoardState.HPD: lambda row: (hold_text(row.motion), f"M{row.steps}"),
    BoardState.CCB: lambda row: ("(",),
    BoardState.CCX: lambda row: ("(", f"M{row.steps // 2}", f"M{row.steps // 2}", ")"),
    BoardState.JOG: lambda row: ("J1",),
    BoardState.THR: lambda row: (f"T{row.steps // 2},0,0,0,{row.steps},0",),
    BoardState.ABT: lambda row: (f"M{row.steps}", "Q"),
}


@check("MN4-STM-02", safety=MOTION)
def at_rest_every_command_is_served(session: Session) -> None:
    """Ready and unheld, what moves and what does not."""
    StateRow(session, BoardState.RDY, "MN4-STM-02", "MN4-STM-02").judge()


@check("MN4-RSP-06", "MN4-STM-02", "MN4-CMD-RTX-01", safety=MOTION)
def in_motion_commands_wait_or_are_served_at_once(session: Session) -> None:
    """While one move runs; & repeats what says that the board is busy."""
    StateRow(session, BoardState.MOV, "MN4-RSP-06", "MN4-STM-02").judge()


@check("MN4-RSP-06", "MN4-STM-02", safety=MOTION)
def behind_a_queue_commands_wait_or_are_served_at_once(session: Session) -> None:
    """While one move runs and another waits."""
    StateRow(session, BoardState.QUE, "MN4-RSP-06", "MN4-STM-02").judge()


@check("MN4-CMD-PAU-01", "MN4-RSP-06", safety=MOTION)
def in_a_pause_commands_wait_or_are_served_at_once(session: Session) -> None:
    """Between { and }; no axis moves."""
    StateRow(session, BoardState.PAU, "MN4-RSP-06", "MN4-CMD-PAU-01").judge()


@check("MN4-CMD-H-01", "MN4-CMD-H-03", safety=MOTION)
def on_hold_moves_are_kept_and_the_rest_is_served(session: Session) -> None:
    """With hold on and nothing pending."""
    StateRow(session, BoardState.HLD, "MN4-CMD-H-01", "MN4-CMD-H-03").judge()


@check("MN4-RSP-09", safety=MOTION)
def a_pending_move_keeps_everything_out(session: Session) -> None:
    """With hold on and a move pending: MOVEPENDING, but for K and &."""
    StateRow(session, BoardState.HPD, "MN4-RSP-09", "MN4-RSP-09").judge()


@check("MN4-CMD-CC-02", "MN4-CMD-CC-03", safety=MOTION)
def a_contour_takes_moves_and_speeds_alone(session: Session) -> None:
    """Between ( and )."""
    if session.reading("cc_unsupported") == "executed":
        session.skip("this board executes what a contour does not support")
    StateRow(session, BoardState.CCB, "MN4-CMD-CC-02", "MN4-CMD-CC-03").judge()


@check("MN4-CMD-CC-06", "MN4-RSP-06", safety=MOTION)
def in_a_contour_commands_wait_or_are_served_at_once(session: Session) -> None:
    """While a contour runs."""
    StateRow(session, BoardState.CCX, "MN4-RSP-06", "MN4-CMD-CC-06").judge()


@check("MN4-CMD-J-01", safety=MOTION)
def in_jog_mode_moves_are_refused_and_the_rest_is_served(session: Session) -> None:
    """Between J1 and J0, with no panel worked."""
    StateRow(session, BoardState.JOG, "MN4-CMD-J-01", "MN4-CMD-J-01").judge()


@check("MN4-CMD-T-03", "MN4-RSP-06", safety=MOTION)
def without_pulses_commands_wait_or_are_served_at_once(session: Session) -> None:
    """While T waits for pulses; no axis moves."""
    StateRow(session, BoardState.THR, "MN4-RSP-06", "MN4-CMD-T-03").judge()


@check("MN4-CMD-Q-01", safety=MOTION)
def after_an_abort_every_command_is_served(session: Session) -> None:
    """After Q has ended a move."""
    StateRow(session, BoardState.ABT, "MN4-CMD-Q-01", "MN4-CMD-Q-01").judge()
