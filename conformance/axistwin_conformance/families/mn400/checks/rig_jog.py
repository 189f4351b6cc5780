"""Jogging: taps, resolutions, held inputs, what ends it (J, G, Y; JOG)."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import AXES, DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import (
    CLOCK_ERROR,
    NS,
    RIG_MOTION,
    BoardMotion,
)
from axistwin_conformance.families.mn400.planner.pulses import tapped

ORDER = 320

JOG: Final = ("rig:jog_plus", "rig:jog_minus")
TAP_S: Final = 0.05
BETWEEN_S: Final = 0.1
HELD_S: Final = 1.0  # an input is held for so much longer than what may be a tap
JOG_SPEED: Final = 400
LASH: Final = 400  # steps: at the jog speed as long as an input is held
BY: Final = 50
PROFILE: Final = (1000, 5000, 10_000)  # starts above the jog speed: no ramps


def hold(motion: BoardMotion, name: str, axis: int = 0) -> tuple[int, int]:
    """Press a jog input until the board must have told that from a tap; axis from 0.  When it was
    pressed, ns."""
    pressed = motion.session.rig.work(name, True, number=axis + 1)
    motion.target.wait(int(motion.driver.reading("jog_hold_ms")) / 1000 + HELD_S)
    return pressed


def tap(motion: BoardMotion, axis: int, direction: int, times: int = 1) -> tuple[int, ...]:
    """The counters after so many short presses of a jog input; axis from 0."""
    name = "jog_plus" if direction > 0 else "jog_minus"
    for _ in range(times):
        motion.session.rig.work(name, True, number=axis + 1)
        motion.target.wait(TAP_S)
        motion.session.rig.work(name, False, number=axis + 1)
        motion.target.wait(BETWEEN_S)
    return motion.rest()


def jogging(session: Session, *texts: str) -> BoardMotion:
    """A board in jog mode."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1200, "jogging")
    motion.ready(f"Y{JOG_SPEED}", *texts, profile=PROFILE)
    if not session.rig.is_exact:
        session.skip("taps of 50 ms need a rig that keeps time")
    return motion


@check("MN4-JOG-01", "MN4-JOG-07", "MN4-CMD-J-01", "MN4-CMD-G-01", safety=RIG_MOTION, needs=JOG)
def taps_move_in_jog_mode_alone(session: Session) -> None:
    """Each axis either way by the steps of a tap in jog mode, by none in run mode."""
    motion = jogging(session, "G10,10,10,10,80")
    place = [0] * AXES
    for is_on in (False, True, False):
        motion.driver.draws(f"J{int(is_on)}", DONE, "MN4-CMD-J-01")
        for axis in range(AXES):
            for direction, times in ((1, 2), (-1, 1)):
                place[axis] += 8 * direction * times * is_on
                counters = tap(motion, axis, direction, times)
                names = ("MN4-JOG-01", "MN4-CMD-G-01") if is_on else ("MN4-JOG-07",)
                names = (*names, "MN4-CMD-J-01")
                session.expect(counters == tuple(place), names, tuple(place), counters)
    session.expect(motion.driver.is_present(), "MN4-CMD-J-01", "an answer in run mode", "none")


@check("MN4-JOG-02", "MN4-JOG-03", "MN4-JOG-04", safety=RIG_MOTION, needs=(*JOG, "rig:jog_res"))
def taps_add_up_to_whole_steps(session: Session) -> None:
    """Four resolutions by Jog Res; fractions are kept, so that five taps of 8/10 are 4 steps and
    ten are 8; opposite ones cancel; what is kept outlasts another resolution."""
    motion = jogging(session, "G10,20,40,80,800")
    driver = motion.driver
    driver.command("J1")
    codes = ((0, 0), (0, 1), (1, 0), (1, 1))  # of Jog Res 1 and 0, for r1 to r4
    if driver.reading("jog_res_code") == "r4_first":
        codes = codes[::-1]
    where = 0
    for (one, nought), steps in zip(codes, (80, 40, 20, 10), strict=True):
        session.rig.work("jog_res", bool(one), number=1)
        session.rig.work("jog_res", bool(nought), number=0)
        where += steps
        counters = tap(motion, 0, 1)
        session.expect(counters[0] == where, "MN4-JOG-02", where, counters[0])
    for number in (0, 1):
        session.rig.work("jog_res", False, number=number)
    motion.ready(f"Y{JOG_SPEED}", "G10,10,10,10,8", profile=PROFILE)
    driver.command("J1")
    for taps in range(1, 11):
        counters = tap(motion, 1, 1)
        low, high = tapped(taps, 8, 10)
        is_right = low <= counters[1] <= high
        session.expect(is_right, "MN4-JOG-03", f"{low} to {high}", counters[1], f"{taps} taps")
    counters = tap(motion, 1, -1, 10)
    driver.tells(counters[1] == 0, "MN4-JOG-04", "0 after ten taps back", counters[1])
    tap(motion, 2, 1, 1)
    driver.command("G5,5,5,5,1")
    counters = tap(motion, 2, 1, 1)
    driver.tells(counters[2] == 1, "MN4-JOG-04", "8/10 and 1/5 are a step", counters[2])


@check("MN4-JOG-05", "MN4-JOG-06", "MN4-CMD-Y-01", safety=RIG_MOTION, needs=(*JOG, "rig:jog_pot"))
def a_held_input_runs_at_the_jog_speed(session: Session) -> None:
    """Steadily at Y once it is more than a tap, scaled by the pot, until it is let go."""
    motion = jogging(session, "G1000,1000,1000,1000,1000")
    driver = motion.driver
    for percent in (100, 50):
        driver.command("J1")
        session.rig.work("jog_pot", percent)
        hold(motion, "jog_minus")
        first, began = motion.read()
        motion.target.wait(0.5)
        second, ended = motion.read()
        session.rig.work("jog_minus", False, number=1)
        speed = Fraction(JOG_SPEED * percent, 100)
        went, name = first[0] - second[0], "MN4-CMD-Y-01" if percent == 100 else "MN4-JOG-06"
        least = speed * (ended[0] - began[1]) * (1 - CLOCK_ERROR) - 1
        most = speed * (ended[1] - began[0]) * (1 + CLOCK_ERROR) + 1
        is_right = least <= went <= most
        names = ("MN4-JOG-05", name) if percent == 100 else (name,)
        session.expect(is_right, names, f"{float(least):.0f} to {float(most):.0f}", went)
        motion.rest()
        motion.stays("MN4-JOG-05")
        driver.command("J0")
        motion.ready(f"Y{JOG_SPEED}", "G1000,1000,1000,1000,1000", profile=PROFILE)


@check("MN4-BKL-01", "MN4-BKL-02", safety=RIG_MOTION, needs=(*JOG, "rig:jog_pot"))
def jogging_turns_only_the_axis_that_it_moves(session: Session) -> None:
    """The others, whatever they remember, are not compensated before it and keep what they
    remember; this one remembers the way that it went."""
    motion = jogging(session)
    session.rig.work("jog_pot", 100)
    for axis in range(AXES):
        for direction in (1, -1):
            _judge_turn(motion, axis, direction)


def _judge_turn(motion: BoardMotion, axis: int, direction: int) -> None:
    """Hold the input of an axis that has no backlash, all remembering the other direction."""
    memory, lash = [-direction] * AXES, [LASH] * AXES
    lash[axis] = 0
    motion.ready(f"Y{JOG_SPEED}", "G1,1,1,1,1", "V500", _listed("B", lash), _listed("D", memory),
                 profile=PROFILE)  # fmt: skip
    motion.driver.command("J1")
    name = "jog_plus" if direction > 0 else "jog_minus"
    pressed = hold(motion, name, axis)
    counters, now = motion.read()
    motion.session.rig.work(name, False, number=axis + 1)
    motion.rest()
    motion.driver.command("J0")
    late = Fraction(int(motion.driver.reading("jog_hold_ms")), 1000) + Fraction(LASH, JOG_SPEED) / 2
    least = JOG_SPEED * (now[0] - Fraction(pressed[1], NS) - late)
    went = direction * counters[axis]
    motion.session.expect(went >= least, "MN4-BKL-01", f"{float(least):.0f} at least", went)
    memory[axis] = direction
    motion.model.accept(_listed("D", memory), motion.now)
    motion.do(_listed("B", [BY] * AXES), "MN4-BKL-02")
    for moved in (axis, (axis + 1) % AXES):
        by = [direction * BY if moved == other else 0 for other in range(AXES)]
        motion.run(_listed("M", by), "MN4-BKL-02", samples=2)


def _listed(letter: str, values: Sequence[int]) -> str:
    return letter + ",".join(map(str, values))


@check("MN4-JOG-08", "MN4-JOG-07", safety=RIG_MOTION, needs=(*JOG, "rig:limit_plus", "rig:shield"))
def limits_and_shield_end_jogging(session: Session) -> None:
    """An input that is held moves nothing towards a limit that is on, nor with the shield open, nor
    once the board has left jog mode."""
    motion = jogging(session, "G1000,1000,1000,1000,1000")
    for name, number in (("limit_plus", 1), ("shield", None), ("J0", None)):
        requirement = "MN4-JOG-07" if name == "J0" else "MN4-JOG-08"
        motion.driver.command("J1")
        hold(motion, "jog_plus")
        if name == "J0":
            motion.driver.draws(name, DONE, requirement)
        else:
            session.rig.work(name, True, number=number)
        motion.target.wait(0.2)
        before = motion.stays(requirement)
        session.rig.work("jog_plus", False, number=1)
        if name != "J0":
            hold(motion, "jog_plus")
            after = motion.read()[0]
            session.rig.work("jog_plus", False, number=1)
            session.expect(after == before, requirement, before, after, "held again")
            session.rig.work(name, False, number=number)
            motion.driver.command("J0")
        motion.ready(f"Y{JOG_SPEED}", "G1000,1000,1000,1000,1000", profile=PROFILE)
