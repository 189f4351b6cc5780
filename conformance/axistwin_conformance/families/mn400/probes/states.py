"""Which readings a board follows that take a move to show: hold, queue, coordinate mode, what an
abort leaves behind.  All moves are short and slow; what is told by inputs takes a rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.hold import hold_text
from axistwin_conformance.families.mn400.checks.queue import (
    MOST_TAKEN,
    MOVE_S,
    NO_END,
    QUEUE_S,
    fill_queue,
    slow_board,
    standing_axis_loaded,
)
from axistwin_conformance.families.mn400.driver import DATA, DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.motion.return_to_start import turn_hold_off

ORDER = 20  # of this module in a run; see `Family.modules`

MOTION_RIG: Final = ("motion", "rig")
PENDING: Final = ("START", "MOVEPENDING")
STEPS: Final = 40
AUX_8: Final = 32768


def slow(driver: BoardDriver, seconds: int = 1) -> tuple[BoardMotion, int]:
    """A board that is ready for moves of so many seconds, and their steps."""
    return slow_board(driver.session, seconds, STEPS)


def on_hold(driver: BoardDriver) -> BoardMotion:
    """A board at rest with hold on."""
    motion, _ = slow(driver)
    driver.command(hold_text(motion))
    return motion


def let_go(motion: BoardMotion) -> None:
    """Run what is pending to its end, whatever is, and turn hold off."""
    motion.driver.ask("K")
    motion.target.wait(0.2)
    motion.driver.ask("Q")
    turn_hold_off(motion.driver)


# --- abort ----------------------------------------------------------------------------------------


@probe(safety=MOTION)
def move_abort_use(driver: BoardDriver) -> Outcome:
    """Whether MOVE_ABORT stands for DONE behind Q in a move, until | and no longer."""
    _, steps = slow(driver)
    driver.command(f"M{steps}")
    driver.ask("Q")
    said = [codec.codes_of(driver.ask(text).found)[-1:] for text in ("X1", "|", "X1")]
    readings: Mapping[tuple[tuple[str, ...], tuple[str, ...]], int] = {
        (("DONE",), ("DONE",)): 0,
        (("MOVE_ABORT",), ("DONE",)): 1,
    }
    return readings.get((said[0], said[2]), f"{said}")


# --- coordinates ----------------------------------------------------------------------------------


@probe(safety=MOTION)
def abs_mode_value(driver: BoardDriver) -> Outcome:
    """Behind I1 and L5,0,0,0: where M6 leads."""
    slow(driver)
    driver.command("I1")
    driver.command("L5,0,0,0")
    driver.command("M6")
    driver.target.wait(1.0)
    position = driver.position()
    return {6: 0, 11: 1}.get(position[0], str(position))


# --- hold -----------------------------------------------------------------------------------------


@probe(safety=MOTION)
def hold_bare_arg(driver: BoardDriver) -> Outcome:
    """H, H, M1, ?."""
    motion, _ = slow(driver)
    driver.command("H")
    driver.command("H")
    driver.ask("M1")
    codes = driver.ask("?").codes
    is_held = codes == PENDING
    if is_held:
        let_go(motion)
    return 0 if is_held else 1 if codes == DATA else str(codes)


@probe(safety=MOTION)
def pending_move_reply(driver: BoardDriver) -> Outcome:
    """M1 with hold on."""
    motion = on_hold(driver)
    outcome = driver.draws_one_of("M1", {DONE: "done", PENDING: "movepending"})
    let_go(motion)
    return outcome


@probe(safety=MOTION)
def release_reply(driver: BoardDriver) -> Outcome:
    """K with M1 pending."""
    motion = on_hold(driver)
    driver.ask("M1")
    outcome = driver.draws_one_of("K", {DONE: "done", PENDING: "movepending"})
    let_go(motion)
    return outcome


@probe(safety=MOTION)
def hold_after_release(driver: BoardDriver) -> Outcome:
    """H, M1, K, M-1, ?."""
    motion = on_hold(driver)
    for text in ("M1", "K", "M-1"):
        driver.ask(text)
    codes = driver.ask("?").codes
    if codes == PENDING:
        let_go(motion)
    return 0 if codes == PENDING else 1 if codes == DATA else str(codes)


@probe(safety=MOTION)
def movepending_exempt(driver: BoardDriver) -> Outcome:
    """With a move pending: Q, and with another one H0."""
    served = []
    for text in ("Q", "H0" if driver.reading("hold_takes_arg") == "true" else "H"):
        motion = on_hold(driver)
        driver.ask("M1")
        served.append(driver.ask(text).codes != PENDING)
        let_go(motion)
    readings = {(False, False): 0, (True, False): 1, (True, True): 2}
    return readings.get((served[0], served[1]), f"Q and H served: {served}")


@probe(safety=MOTION)
def hold_scope(driver: BoardDriver) -> Outcome:
    """With hold on: which of A, and J1, is pending as M is."""
    kept = []
    for text in ("A-1,0,-2,0,1", "J1"):
        motion = on_hold(driver)
        driver.ask(text)
        kept.append(driver.ask("?").codes == PENDING)
        let_go(motion)
        driver.ask("J0")
    readings = {(True, False): 0, (False, False): 1, (True, True): 2}
    return readings.get((kept[0], kept[1]), f"A and J1 kept: {kept}")


# --- queue and abort ------------------------------------------------------------------------------


@probe(safety=MOTION)
def queue_modal(driver: BoardDriver) -> Outcome:
    """A move of axis 1, and while it runs an L of axis 2: whether E shows it before the end."""
    motion, steps = slow(driver, 2)
    driver.command(f"M{steps}")
    driver.command(standing_axis_loaded(driver))
    now, later = driver.position()[1], motion.rest()[1]
    return {(0, 7): 0, (7, 7): 1}.get((now, later), f"counter 2 at {now}, then {later}")


@probe(safety=MOTION)
def queue_depth(driver: BoardDriver) -> Outcome:
    """How many moves are taken behind one that runs."""
    motion, steps = slow_board(driver.session, QUEUE_S)
    motion.set(f"M{steps}")
    taken, exchange = fill_queue(motion)
    for _ in range(taken + 1):  # whether the first one flushes the queue is asked later
        driver.ask("Q")
    if taken == MOST_TAKEN:
        driver.session.skip(NO_END.format(taken=taken))
    return Measured(str(taken)) if "SLAVEBUFFOV" in exchange.codes else str(exchange)


@probe(safety=MOTION)
def cc_capacity(driver: BoardDriver) -> Outcome:
    """How many segments a contour takes."""
    slow(driver)
    with driver.entered("("):
        taken = 0
        while (codes := driver.ask(f"M{1 - 2 * (taken % 2)}").codes) == DONE:
            taken += 1
            if taken == MOST_TAKEN:
                driver.session.skip(f"{taken} segments are taken, and no end of it")
        return Measured(str(taken)) if "SLAVEBUFFOV" in codes else str(codes)


@probe(safety=MOTION)
def quit_in_entry(driver: BoardDriver) -> Outcome:
    """A move, ( while it runs, Q; E twice."""
    _, steps = slow(driver)
    for text in (f"M{steps}", "(", "Q"):
        driver.command(text)
    driver.target.wait(0.3)
    before = driver.position()
    driver.target.wait(0.3)
    after = driver.position()
    driver.ask("Q")
    return 0 if after == before else 1


@probe(safety=MOTION)
def abort_flag_clear(driver: BoardDriver) -> Outcome:
    """The last flag of : after Q, read twice."""
    _, steps = slow(driver)
    driver.command(f"M{steps}")
    driver.command("Q")
    flags = tuple(driver.flags()["AbortFlag"] for _ in range(2))
    return {(1, 1): 0, (1, 0): 1}.get((flags[0], flags[1]), f"AbortFlag {flags}")


@probe(safety=MOTION_RIG, needs=("rig:limit_plus",))
def abort_exit_code(driver: BoardDriver) -> Outcome:
    """/ after a move that a limit has stopped, and then after Q in the next one, of which no limit
    knows."""
    motion, steps = slow(driver, MOVE_S)
    driver.command(f"M{steps}")
    driver.target.wait(0.3)
    driver.session.rig.work("limit_plus", True, number=1)
    driver.target.wait(MOVE_S)  # a limit may halt its axis, and not end the move (MN4-AMB-47)
    before = driver.exit_code()
    driver.session.rig.work("limit_plus", False, number=1)
    driver.command(f"M{-steps}")
    driver.target.wait(0.1)
    driver.command("Q")
    after = driver.exit_code()
    motion.rest()
    if before == 0:
        return "no exit code of the limit"
    return 0 if after == 0 else 1 if after == before else Measured(str(after))


# --- inputs ---------------------------------------------------------------------------------------


@probe(safety="rig", needs=("rig:aux",))
def limit_status_signed(driver: BoardDriver) -> Outcome:
    """S with aux input 8 on."""
    driver.session.rig.work("aux", True, number=8)
    driver.target.wait(0.3)
    seen = driver.inputs()
    driver.session.rig.work("aux", False, number=8)
    return {AUX_8: 0, -AUX_8: 1}.get(seen, str(seen))


@probe(safety=MOTION_RIG, needs=("rig:feedrate", "rig:feedrate_enable"))
def feedrate_pot(driver: BoardDriver) -> Outcome:
    """How far a move goes in a second with the pot at a quarter."""
    _, steps = slow(driver, 4)
    rig = driver.session.rig
    rig.work("feedrate", 25.0)
    rig.work("feedrate_enable", True)
    driver.command(f"M{steps}")
    driver.target.wait(1.0)
    gone = driver.position()[0]
    driver.ask("Q")
    rig.work("feedrate_enable", False)
    rig.work("feedrate", 100.0)
    return 0 if gone < steps / 6 else 1 if gone < steps / 2 else f"{gone} of {steps} steps"
