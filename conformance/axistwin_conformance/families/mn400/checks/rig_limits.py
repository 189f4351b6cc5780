"""Limit inputs, aux inputs and the shield while axes move (LIM, SHD, S, /, ;)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.checks.queue import needs_flags
from axistwin_conformance.families.mn400.driver import AXES, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import RIG_MOTION, BoardMotion
from axistwin_conformance.families.mn400.planner.circle import STRAY

ORDER = 300

LIMITS: Final = ("rig:limit_plus", "rig:limit_minus")
PULSES: Final = "pulses"
FED: Final = 20  # pulses, and steps that they would make
SLOW: Final = 500
FAR: Final = 900
RADIUS: Final = 200  # of an arc whose half takes about a second
SMALL, CRAWL = 20, 20  # radius of another, and a speed at which its steps are told from one another
AUX_8: Final = 32_768


def limit_value(axis: int, direction: int) -> int:
    """The ON value of a limit input (MN4-CMD-S-01): axis from 0, direction 1 or -1."""
    return 1 << (2 * axis + (direction > 0))


def limit_name(direction: int) -> str:
    """What a rig calls the limits of a direction."""
    return "limit_plus" if direction > 0 else "limit_minus"


def chosen(session: Session) -> list[tuple[int, int]]:
    """Which limits to work: all where that costs nothing, else two that are drawn."""
    every = [(axis, direction) for axis in range(AXES) for direction in (1, -1)]
    return every if session.rig.is_exact else session.random.sample(every, 2)


def alone(axis: int, steps: int) -> str:
    """The M of one axis."""
    return f"M{',' * axis}{steps}"


@check("MN4-LIM-01", "MN4-LIM-02", "MN4-LIM-03", "MN4-LIM-08", "MN4-CMD-EXIT-01",
       "MN4-CMD-EXIT-04", "MN4-CMD-S-01", safety=RIG_MOTION, needs=LIMITS)  # fmt: skip
def a_limit_ends_what_moves_towards_it(session: Session) -> None:
    """All axes halt, what waits is forgotten, / is the input's value; moving away is free and makes
    / 0 again."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(FAR, "these moves")
    for axis, direction in chosen(session):
        motion.ready("|", speed=SLOW)
        other = (axis + 1) % AXES
        by = [0] * AXES
        by[axis], by[other] = direction * FAR, 300
        motion.do(f"M{','.join(map(str, by))}", "MN4-LIM-01")
        if driver.reading("limit_halts") == "all":
            motion.do(alone(other, 200), "MN4-LIM-03")
        driver.target.wait(0.3)
        session.rig.work(limit_name(direction), True, number=axis + 1)
        here = motion.rest()
        is_between = 0 < abs(here[axis]) < FAR
        session.expect(is_between, "MN4-LIM-01", f"on the way to {by}", here)
        code, value = driver.exit_code(), limit_value(axis, direction)
        names = ("MN4-CMD-EXIT-01", "MN4-LIM-01")
        session.expect(code == value, names, value, code, "exit code")
        inputs = driver.inputs()
        session.expect(bool(inputs & value), "MN4-CMD-S-01", f"{value} in S", inputs)
        if driver.reading("limit_halts") == "all":
            _judge_all_halted(motion, here, by)
        after = motion.stays("MN4-LIM-03")
        session.expect(after == here, "MN4-LIM-08", here, after)
        if driver.reading("limit_direction") == "toward":
            motion.model.timeline.stop((motion.ends[0], motion.ends[0]))
            motion.model.observe(here)
            motion.run(alone(axis, -direction * 50), "MN4-LIM-02")
            code = driver.exit_code()
            session.expect(code == 0, "MN4-CMD-EXIT-04", 0, code, "exit code after a good move")
        session.rig.work(limit_name(direction), False, number=axis + 1)


def _judge_all_halted(motion: BoardMotion, here: tuple[int, ...], by: list[int]) -> None:
    """Judge that the axes have stopped together, and what N says is left of the move."""
    session, driver = motion.session, motion.driver
    major = max(range(AXES), key=lambda axis: abs(by[axis]))
    for axis, whole in enumerate(by):
        share = abs(here[major]) * abs(whole) / abs(by[major])
        is_on = abs(abs(here[axis]) - share) <= 1
        session.expect(is_on, "MN4-LIM-03", f"{share:.1f} steps of axis {axis + 1}", here)
    if driver.reading("readcount_after_abort") == "kept":
        left = tuple(map(abs, driver.steps_left()))
        rest = tuple(abs(whole - at) for whole, at in zip(by, here, strict=True))
        session.expect(left == rest, "MN4-LIM-08", rest, left, "steps left")


@check("MN4-LIM-04", "MN4-LIM-05", "MN4-LIM-06", "MN4-LIM-02", "MN4-BKL-01", safety=RIG_MOTION,
       needs=LIMITS)  # fmt: skip
def a_limit_that_is_on_holds_back_its_direction_alone(session: Session) -> None:
    """That of an axis that stands stops nothing, nor does one behind an axis that takes up its
    backlash; a move towards it makes no step and sets /, towards two of them the sum; so does one
    that pulses pace."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(300, "these moves")
    for axis, direction in chosen(session):
        motion.ready("|")
        session.rig.work(limit_name(direction), True, number=axis + 1)
        other = (axis + 1) % AXES
        motion.run(alone(other, 100), "MN4-LIM-04")
        if driver.reading("limit_direction") == "toward":
            motion.run(alone(axis, -direction * 30), "MN4-LIM-02")
            for text in ("B4,4,4,4", f"D{','.join([str(direction)] * AXES)}"):
                motion.do(text, "MN4-BKL-01")
            motion.run(alone(axis, -direction * 30), ("MN4-LIM-02", "MN4-BKL-01"))
            motion.do("B0,0,0,0", "MN4-BKL-01")
        before, _ = motion.read()
        value = limit_value(axis, direction)
        for steps in (50, 1):
            driver.command("|")
            driver.command(alone(axis, direction * steps))
            after = motion.stays("MN4-LIM-06")
            session.expect(after == before, "MN4-LIM-06", before, after)
            code = driver.exit_code()
            session.expect(code == value, "MN4-LIM-06", value, code, "exit code")
        if PULSES in session.rig.capabilities:
            _judge_paced(motion, alone(axis, direction * FED), value)
        session.rig.work("limit_plus", True, number=other + 1)
        by = [0] * AXES
        by[axis], by[other] = direction * 50, 50
        driver.command(f"M{','.join(map(str, by))}")
        motion.rest()
        code, both = driver.exit_code(), value + limit_value(other, 1)
        if driver.reading("multi_limit_exit") == "sum":
            session.expect(code == both, "MN4-LIM-05", both, code, "exit code of two limits")
        else:
            parts = [value, limit_value(other, 1)]
            session.expect(code in parts, "MN4-LIM-05", parts, code, "exit code of two limits")
        session.rig.work("limit_plus", False, number=other + 1)
        session.rig.work(limit_name(direction), False, number=axis + 1)


def _judge_paced(motion: BoardMotion, text: str, value: int) -> None:
    """Judge a move towards a limit that is on, once all pulses that it would take have come."""
    session, driver = motion.session, motion.driver
    before, _ = motion.read()
    for setting in ("|", "V-1", text):
        driver.command(setting)
    session.rig.work(PULSES, FED)
    after, told = motion.stays("MN4-LIM-06"), f"behind {FED} pulses"
    session.expect(after == before, "MN4-LIM-06", before, after, told)
    code = driver.exit_code()
    session.expect(code == value, "MN4-LIM-06", value, code, f"exit code {told}")
    driver.command(f"V{motion.model.settings.speed}")


@check("MN4-LIM-01", "MN4-LIM-02", "MN4-LIM-03", "MN4-CMD-EXIT-01", safety=RIG_MOTION,
       needs=LIMITS)  # fmt: skip
def a_limit_meets_an_arc_where_it_turns_round(session: Session) -> None:
    """A limit that is on ends an arc where an axis turns towards it, behind a pause too, and not
    before, that of an axis which sets out from its end too, and one that goes on shortly before;
    one that was let go by then stops nothing."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(2 * RADIUS, "these arcs")
    if motion.driver.reading("limit_direction") != "toward":
        session.skip("a limit of this board holds back both directions (MN4-AMB-47)")
    for direction in (1, -1):  # of axis 3, once it has turned round
        for meanwhile in ("let go", "paused", ""):
            motion.ready("|", speed=SLOW)
            session.rig.work(limit_name(direction), True, number=3)
            motion.do(f"A{-RADIUS},0,{-2 * RADIUS},0,{direction}", "MN4-LIM-02")
            motion.target.wait(0.2)
            if meanwhile == "let go":
                session.rig.work(limit_name(direction), False, number=3)
                motion.follow("MN4-LIM-02")
                continue
            if meanwhile == "paused":
                motion.do("{", "MN4-LIM-02")
                motion.target.wait(1.0)
                motion.do("}", "MN4-LIM-02")
            here = _judge_turn(motion, 3, direction, -direction * RADIUS)
            if motion.driver.reading("limit_halts") == "all":
                is_short = -2 * RADIUS < here[0] < 0
                session.expect(is_short, "MN4-LIM-03", "axis 1 on its way", here)
            session.rig.work(limit_name(direction), False, number=3)
    motion.ready("|", speed=SLOW)
    session.rig.work("limit_plus", True, number=1)
    motion.do(f"A{-RADIUS},0,{-RADIUS},{RADIUS},1", "MN4-LIM-02")
    _judge_turn(motion, 1, 1, -2 * RADIUS)
    session.rig.work("limit_plus", False, number=1)
    if "pulses" in session.rig.capabilities:
        motion.ready("|", "V-1")
        session.rig.work("limit_plus", True, number=3)
        motion.do(f"A{-RADIUS},0,{-2 * RADIUS},0,1", "MN4-LIM-02")
        session.rig.work("pulses", 4 * RADIUS)  # more than the arc has ticks
        _judge_turn(motion, 3, 1, -RADIUS)
        session.rig.work("limit_plus", False, number=3)
    if session.rig.is_exact:
        _judge_last_moment(motion)


def _judge_last_moment(motion: BoardMotion) -> None:
    """Judge a limit that goes on a step before an axis turns towards it."""
    motion.ready("|", speed=CRAWL)
    motion.do(f"A{-SMALL},0,{-2 * SMALL},0,1", "MN4-LIM-02")
    while motion.read()[0][2] > 1 - SMALL and motion.now[0] < motion.ends[1]:
        pass
    motion.session.rig.work("limit_plus", True, number=3)
    _judge_turn(motion, 3, 1, -SMALL)
    motion.session.rig.work("limit_plus", False, number=3)


def _judge_turn(motion: BoardMotion, axis: int, direction: int, turn: int) -> tuple[int, ...]:
    """Judge that an axis, from 1, stands where the arc would turn round, and what the exit code
    says; give the counters."""
    session, here = motion.session, motion.rest()
    is_there = abs(here[axis - 1] - turn) <= STRAY
    told = f"axis {axis} within {STRAY} steps of {turn}, where it turns round"
    session.expect(is_there, ("MN4-LIM-01", "MN4-LIM-02"), told, here)
    code, value = motion.driver.exit_code(), limit_value(axis - 1, direction)
    session.expect(code == value, "MN4-CMD-EXIT-01", value, code, "exit code")
    return here


@check("MN4-LIM-07", "MN4-CMD-S-01", "MN4-CMD-S-02", safety=RIG_MOTION, needs=("rig:aux",))
def aux_inputs_are_shown_and_stop_nothing(session: Session) -> None:
    """Each in S by its value, the eighth as 32768; a move runs through all of them."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(FAR, "this move")
    motion.ready(speed=SLOW)
    resting = driver.inputs()
    motion.do(f"M{FAR}", "MN4-LIM-07")
    for port in range(1, 9):
        session.rig.work("aux", True, number=port)
        shown = driver.inputs() - resting
        value = 128 << port
        if value == AUX_8 and driver.reading("limit_status_signed") == "true":
            session.not_run("MN4-CMD-S-02", "this board reads S as a signed number (MN4-AMB-35)")
        else:
            name = "MN4-CMD-S-02" if value == AUX_8 else "MN4-CMD-S-01"
            session.expect(shown == value, name, value, shown, f"S with aux {port} on")
        session.rig.work("aux", False, number=port)
    motion.follow("MN4-LIM-07")


# --- the shield -----------------------------------------------------------------------------------


@check("MN4-SHD-01", "MN4-SHD-03", "MN4-CMD-FH-01", safety=RIG_MOTION, needs=("rig:shield",))
def without_feed_hold_the_shield_aborts(session: Session) -> None:
    """Its switch closed during a move ends that, / is 0, : tells of the abort; with it closed
    nothing more runs."""
    needs_flags(session)
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(FAR, "this move")
    motion.ready("|", ";0", speed=SLOW)
    motion.do(f"M{FAR}", "MN4-SHD-01")
    driver.target.wait(0.3)
    session.rig.work("shield", True)
    here = motion.rest()
    names = ("MN4-SHD-01", "MN4-CMD-FH-01")
    session.expect(0 < here[0] < FAR, names, f"on the way to {FAR}", here)
    flags, code = driver.flags(), driver.exit_code()
    session.expect(flags["ShieldFlag"] == 0, "MN4-SHD-01", "ShieldFlag 0", flags)
    driver.tells(flags["AbortFlag"] == 1, "MN4-SHD-03", "AbortFlag 1", flags)
    if driver.reading("abort_exit_code") == "0":
        driver.tells(code == 0, "MN4-SHD-03", "exit code 0", code)
    session.rig.work("shield", False)
    after = motion.stays("MN4-SHD-01")
    session.expect(after == here, "MN4-SHD-01", f"{here}, nothing resumed", after)


@check("MN4-SHD-01", "MN4-SHD-02", "MN4-SHD-04", "MN4-CMD-FH-01", safety=RIG_MOTION,
       needs=("rig:shield",))  # fmt: skip
def with_feed_hold_the_shield_pauses(session: Session) -> None:
    """Its switch closed pauses, opened goes on to the exact end; a { beside it wants its } too; ;0
    in such a pause does not abort."""
    needs_flags(session)
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(FAR, "these moves")
    end = (FAR, -300, 0, 0)
    for brace, mode in (("", ""), ("{", ""), ("", ";0")):
        motion.ready(";1", speed=SLOW)
        motion.do(f"M{FAR},-300", "MN4-SHD-01")
        driver.target.wait(0.3)
        session.rig.work("shield", True)
        here = motion.rest_paused()
        names = ("MN4-SHD-01", "MN4-CMD-FH-01")
        session.expect(0 < here[0] < FAR, names, f"on the way to {end}", here)
        left = tuple(map(abs, driver.steps_left()))
        rest = tuple(abs(whole - at) for whole, at in zip(end, here, strict=True))
        session.expect(left == rest, "MN4-SHD-02", rest, left, "steps left")
        for text in (brace, mode):
            if text:
                driver.command(text)
        after = motion.rest_paused()
        name = "MN4-SHD-04" if mode else "MN4-SHD-01"
        session.expect(after == here, name, here, after, "while the shield is open")
        session.rig.work("shield", False)
        if brace:
            after = motion.rest_paused()
            driver.tells(after == here, "MN4-SHD-02", f"{here} until }}", after)
            driver.command("}")
        after = motion.rest()
        name = "MN4-SHD-04" if mode else "MN4-SHD-02"
        session.expect(after == end, name, end, after, "once the shield is shut")
