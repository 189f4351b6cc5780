"""Inputs, panel and pulses, worked by a rig, as commands tell of them and obey them (S, EXIT, FH,
G, Y, T; IO)."""

from __future__ import annotations

from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.driver import AXES, DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import BoardMotion

ORDER = 210

MOTION_RIG: Final = ("motion", "rig")
AUX_INPUTS: Final = 8
SIGNED_BIT: Final = 32768
STEPS: Final = 400
MOVE_S: Final = 4
SOON_S: Final = 0.5  # in which a board has seen an input
TAP_S: Final = 0.1
SWITCHED_S: Final = 0.3


@check("MN4-CMD-S-01", "MN4-CMD-S-02", safety="rig",
       needs=("rig:limit_plus", "rig:limit_minus", "rig:aux"))  # fmt: skip
def every_input_has_its_value(session: Session) -> None:
    """Each limit and each aux input, turned on by itself and all together: S is the sum of what is
    on."""
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


@check("MN4-CMD-EXIT-01", "MN4-CMD-EXIT-02", "MN4-CMD-EXIT-04", "MN4-CMD-EXIT-03",
       safety=MOTION_RIG, needs=("rig:limit_plus", "rig:limit_minus"))  # fmt: skip
def the_exit_code_names_the_limit(session: Session) -> None:
    """A move that a limit stops leaves its value; the next move shows it until it is over, and
    leaves 0; | clears it at once."""
    for axis in range(1, AXES + 1):
        for sign, name in ((-1, "limit_minus"), (1, "limit_plus")):
            _judge_limit(session, axis, sign, name)


def _judge_limit(session: Session, axis: int, sign: int, name: str) -> None:
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver, rig = motion.driver, session.rig
    value = 1 << 2 * (axis - 1) + (sign > 0)
    commas = "," * (axis - 1)
    motion.set(f"M{commas}{sign * steps}")
    driver.target.wait(SOON_S)
    rig.work(name, True, number=axis)
    driver.target.wait(SOON_S)
    stopped = driver.position()
    code = driver.exit_code()
    session.expect(code == value, "MN4-CMD-EXIT-01", value, code, f"stopped by {name} {axis}")
    motion.model.accept("Q", motion.span(driver.ask("*")))
    motion.model.observe(stopped)
    motion.set(f"M{commas}{-stopped[axis - 1] or -sign}")
    code = driver.exit_code()
    session.expect(code == value, "MN4-CMD-EXIT-02", value, code, "during the next move")
    motion.rest()
    code = driver.exit_code()
    session.expect(code == 0, ("MN4-CMD-EXIT-04", "MN4-CMD-EXIT-01"), 0, code, "after that")
    motion.set(f"M{commas}{sign}")
    motion.rest()
    driver.draws("|", DONE, "MN4-CMD-EXIT-03")
    code = driver.exit_code()
    session.expect(code == 0, "MN4-CMD-EXIT-03", 0, code, "after |")
    rig.work(name, False, number=axis)


@check("MN4-CMD-FH-01", safety=MOTION_RIG, needs=("rig:shield",))
def feed_hold_decides_what_the_shield_does(session: Session) -> None:
    """With ;1 an open shield pauses the move and a shut one lets it go on to its end; with ;0 it
    ends the move."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver, rig = motion.driver, session.rig
    for mode in (1, 0):
        motion.ready(f";{mode}", speed=max(2, steps // MOVE_S))
        motion.set(f"M{steps}")
        driver.target.wait(SOON_S)
        rig.work("shield", True)
        driver.target.wait(SOON_S)
        motion.stays("MN4-CMD-FH-01")
        flags = driver.flags()
        wanted = {"PauseState": mode, "AbortFlag": 1 - mode}
        seen = {name: flags[name] for name in wanted}
        session.expect(seen == wanted, "MN4-CMD-FH-01", wanted, seen, f"with ;{mode}")
        rig.work("shield", False)
        driver.target.wait(SOON_S)
        end = motion.rest()[0]
        is_right = (end == steps) is bool(mode)
        told = "at its end" if mode else "where it was stopped"
        session.expect(is_right, "MN4-CMD-FH-01", told, end, f"with ;{mode}, the shield shut")


@check("MN4-CMD-G-01", "MN4-CMD-J-01", safety=MOTION_RIG,
       needs=("rig:jog_plus", "rig:jog_res"))  # fmt: skip
def a_tap_goes_as_far_as_its_resolution_says(session: Session) -> None:
    """In jog mode the four resolutions give spi over res steps for a tap, in some order; outside of
    it a tap moves nothing."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(200, "these taps")
    motion.ready("Y1000", "G100,50,20,10,200")
    motion.set("J1")
    seen = []
    for code in range(4):
        for bit in (0, 1):
            session.rig.work("jog_res", bool(code >> bit & 1), number=bit)
        seen.append(_tapped(motion))
    for bit in (0, 1):
        session.rig.work("jog_res", False, number=bit)
    wanted = [2, 4, 10, 20]
    session.expect(sorted(seen) == wanted, "MN4-CMD-G-01", wanted, seen, "steps of a tap")
    motion.set("J0")
    moved = _tapped(motion)
    session.expect(moved == 0, "MN4-CMD-J-01", 0, moved, "steps of a tap after J0")


def _tapped(motion: BoardMotion) -> int:
    """How far a short tap moves axis 1."""
    before = motion.driver.position()[0]
    motion.session.rig.work("jog_plus", True, number=1)
    motion.target.wait(TAP_S)
    motion.session.rig.work("jog_plus", False, number=1)
    motion.target.wait(SOON_S)
    return motion.driver.position()[0] - before


@check("MN4-CMD-Y-01", safety=MOTION_RIG, needs=("rig:jog_plus",))
def a_held_jog_input_runs_at_jog_speed(session: Session) -> None:
    """An input that is held moves its axis at the speed of Y."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "jogging for two seconds")
    for speed in (50, 150):
        motion.ready("G1000,1000,1000,1000,1000")
        motion.set(f"Y{speed}")
        motion.set("J1")
        session.rig.work("jog_plus", True, number=1)
        motion.target.wait(1.0)
        (first, *_), begun = motion.read()
        motion.target.wait(1.0)
        (last, *_), ended = motion.read()
        session.rig.work("jog_plus", False, number=1)
        motion.target.wait(SOON_S)
        motion.set("J0")
        least, most = speed * (ended[0] - begun[1]) - 2, speed * (ended[1] - begun[0]) + 2
        told = f"{float(least):.0f} to {float(most):.0f} steps"
        is_right = least <= last - first <= most
        session.expect(is_right, "MN4-CMD-Y-01", told, last - first, f"in a second at Y{speed}")


@check("MN4-IO-02", safety=MOTION_RIG, needs=("rig:pause", "rig:stop"))
def the_panel_pauses_and_stops(session: Session) -> None:
    """Pause works like { and then }, Stop like Q; where the manual names the switches alone."""
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


@check("MN4-CMD-T-01", "MN4-CMD-T-02", "MN4-CMD-T-03", safety=MOTION_RIG,
       needs=("rig:pulses", "rig:index"))  # fmt: skip
def a_thread_follows_its_pulses(session: Session) -> None:
    """START and DONE at once; after the index and the offset the axes go in proportion to the
    pulses, in both modes; Q ends it while it waits."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(60, "these threads")
    driver = motion.driver
    for is_absolute in (False, True):
        motion.ready(motion.mode(is_absolute=is_absolute))
        driver.command("L10,0,0,5" if is_absolute else "L0,0,0,0")
        text = "T40,,,-55,120,8" if is_absolute else "T30,,,-60,120,8"
        start = (10, 0, 0, 5) if is_absolute else (0, 0, 0, 0)
        driver.draws(text, DONE, "MN4-CMD-T-03")
        name = "MN4-CMD-T-02" if is_absolute else "MN4-CMD-T-01"
        _feed(motion, start, name)
        driver.draws(text, DONE, "MN4-CMD-T-03")
        driver.draws("Q", DONE, "MN4-CMD-T-03")
        place = motion.rest()
        session.rig.work("index", True)
        session.rig.work("pulses", 130)
        came = driver.position()
        session.expect(came == place, "MN4-CMD-T-03", place, came, "after Q, with pulses")


def _feed(motion: BoardMotion, start: tuple[int, ...], name: str) -> None:
    """Index, offset, half of the pulses, all of them, and more."""
    rig = motion.session.rig
    begins_at_index = motion.driver.reading("threader_start") == "index"
    if begins_at_index:
        rig.work("index", True)
    fed = 0
    for pulses, share in ((8, 0.0), (60, 0.5), (60, 1.0), (20, 1.0)):
        rig.work("pulses", pulses)
        motion.target.wait(SOON_S)
        fed += pulses
        came = motion.driver.position()
        wanted = tuple(
            at + round(by * share) for at, by in zip(start, (30, 0, 0, -60), strict=True)
        )
        motion.session.expect(came == wanted, name, wanted, came, f"after {fed} pulses")
