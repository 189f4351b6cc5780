"""Inputs and panel, worked by a rig, as commands tell of them and obey them (S, EXIT; IO)."""

from __future__ import annotations

from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.checks.queue import needs_flags, slow_board
from axistwin_conformance.families.mn400.driver import AXES, DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import BoardMotion

ORDER = 210

MOTION_RIG: Final = ("motion", "rig")
AUX_INPUTS: Final = 8
MINUS_2: Final = 4  # the value of the - limit of axis 2
SIGNED_BIT: Final = 32768
# Inputs that S does not tell of and that move nothing, with the number of the one that is worked.
HAVE_NO_VALUE: Final = {"shield": None, "feedrate_enable": None, "jog_res": 1}
STEPS: Final = 400
MOVE_S: Final = 4
SOON_S: Final = 0.5  # in which a board has seen an input
TAP_S: Final = 0.1
SWITCHED_S: Final = 0.3


@check("MN4-CMD-S-01", "MN4-CMD-S-02", safety="rig",
       needs=("rig:limit_plus", "rig:limit_minus", "rig:aux"))  # fmt: skip
def every_input_has_its_value(session: Session) -> None:
    """Each limit and each aux input, turned on by itself and all together: S is the sum of what is
    on; of other inputs it tells nothing."""
    driver = BoardDriver(session)
    rig, before = session.rig, driver.inputs()
    session.step(before == 0, "no input on", before)
    inputs = [
        (name, axis) for axis in range(1, AXES + 1) for name in ("limit_minus", "limit_plus")
    ] + [("aux", number) for number in range(1, AUX_INPUTS + 1)]
    for bit, (name, number) in enumerate(inputs):
        rig.work(name, True, number=number)
        driver.target.wait(SWITCHED_S)
        seen = driver.inputs()
        if 1 << bit == SIGNED_BIT:
            is_signed = seen == -SIGNED_BIT
            driver.follows("limit_status_signed", str(is_signed).lower(), "MN4-CMD-S-02")
            seen = abs(seen)
        name_of = f"{name.replace('_', ' ')} {number}"
        session.expect(seen == 1 << bit, "MN4-CMD-S-01", 1 << bit, seen, f"with {name_of} on")
        rig.work(name, False, number=number)
    for name, number in inputs:
        rig.work(name, True, number=number)
    driver.target.wait(SWITCHED_S)
    together = driver.inputs()
    most = 2 * SIGNED_BIT - 1
    wanted = -1 if driver.reading("limit_status_signed") == "true" else most
    session.expect(together == wanted, "MN4-CMD-S-02", wanted, together, "with all inputs on")
    for name, number in inputs:
        rig.work(name, False, number=number)
    for name, one in HAVE_NO_VALUE.items():
        if name in rig.capabilities:
            rig.work(name, True, number=one)
            driver.target.wait(SWITCHED_S)
            seen = driver.inputs()
            rig.work(name, False, number=one)
            session.expect(seen == 0, "MN4-CMD-S-01", 0, seen, f"with {name.replace('_', ' ')} on")


@check("MN4-CMD-EXIT-02", "MN4-CMD-EXIT-03", "MN4-CMD-EXIT-04", safety=MOTION_RIG,
       needs=("rig:limit_minus",))  # fmt: skip
def the_exit_code_is_that_of_the_last_move(session: Session) -> None:
    """The code that a limit has left stays while the next move runs and is 0 once it is over; |
    makes it 0 at once."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver, rig = motion.driver, session.rig
    for ending in ("move", "|"):
        motion.set(f"M,{-steps}")
        end_s = motion.ends[1]
        driver.target.wait(SOON_S)
        rig.work("limit_minus", True, number=2)
        driver.target.wait(SOON_S)
        gone = -driver.position()[1]
        motion.model.observe(driver.position())
        rig.work("limit_minus", False, number=2)  # it may block the way back too (MN4-AMB-47)
        if driver.reading("limit_halts") == "axis":
            motion.wait_until(end_s)  # the move goes on without that axis
        if ending == "move":
            motion.set(f"M,{max(gone, steps // 4)}")
            code = driver.exit_code()
            session.expect(code == MINUS_2, "MN4-CMD-EXIT-02", MINUS_2, code, "in the next move")
            motion.rest()
            names = "MN4-CMD-EXIT-04"
        else:
            driver.draws("|", DONE, "MN4-CMD-EXIT-03")
            names = "MN4-CMD-EXIT-03"
        code = driver.exit_code()
        session.expect(code == 0, names, 0, code, f"after that {ending}")


@check("MN4-IO-02", safety=MOTION_RIG, needs=("rig:pause", "rig:stop"))
def the_panel_pauses_and_stops(session: Session) -> None:
    """Pause works like { and then }, Stop like Q; where the manual names the switches alone."""
    needs_flags(session)
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver = motion.driver
    motion.set(f"M{steps}")
    for wanted in (1, 0):
        _press(motion, "pause")
        flags = driver.flags()
        is_usual = flags["PauseState"] == wanted
        driver.tells(is_usual, "MN4-IO-02", f"PauseState {wanted}", flags)
    _press(motion, "stop")
    before, after = driver.position(), driver.position()
    is_stopped = before == after and after[0] != steps
    driver.tells(is_stopped, "MN4-IO-02", "no motion after Stop", after)
    driver.ask("Q")


def _press(motion: BoardMotion, name: str) -> None:
    motion.session.rig.work(name, True)
    motion.target.wait(TAP_S)
    motion.session.rig.work(name, False)
    motion.target.wait(TAP_S)


@check("MN4-IO-01", safety=MOTION_RIG, needs=("rig:feedrate", "rig:feedrate_enable"))
def the_feedrate_pot_scales_the_speed(session: Session) -> None:
    """With Feedrate EN on and the pot at half, a move goes half as far in the same time."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver, speed = motion.driver, max(2, steps // MOVE_S)
    session.rig.work("feedrate", 50.0)
    session.rig.work("feedrate_enable", True)
    motion.set(f"M{steps}")
    (first, *_), begun = motion.read()
    driver.target.wait(1.0)
    (last, *_), ended = motion.read()
    motion.set("Q")
    session.rig.work("feedrate_enable", False)
    session.rig.work("feedrate", 100.0)
    seconds = (ended[0] + ended[1] - begun[0] - begun[1]) / 2
    share = (last - first) / (speed * seconds) if seconds else Fraction(0)
    readings = {True: "scale", False: "ignore"}
    if not (0.4 < share < 0.6 or 0.9 < share < 1.1):
        told = f"{float(share):.2f} of the speed"
        session.no_reading("MN4-IO-01", "feedrate_pot", readings.values(), told)
    driver.follows("feedrate_pot", readings[share < 0.6], "MN4-IO-01")
