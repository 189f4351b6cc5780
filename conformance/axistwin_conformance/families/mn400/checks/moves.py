"""Vector moves: where they end, on which way, in what time (M, I, L, V, F, X; MOT, PAR)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import (
    MOTION,
    NS,
    PROFILE,
    SPEED,
    BoardMotion,
    is_monotone,
)
from axistwin_conformance.families.mn400.planner.vector import major_length

ORDER = 120  # of this module in a run; see `Family.modules`

# Displacements of relative moves, each sent with its mirror image behind it.
LONG_NS: Final = 100_000_000  # a motion that is over later than any reply
MODES_QUEUED: Final = 4  # two I and the moves behind them
MOVES: Final = (
    (1, 0, 0, 0), (0, -7, 0, 0), (0, 0, 300, 0), (0, 0, 0, -300), (400, 400, 0, 0),
    (500, -377, 13, 1), (-3, 250, -249, 500), (123, 124, -124, -123),
)  # fmt: skip
# Profile and speed of moves: ramped, clipped to the end speed, too short for its ramps, just at the
# speed, below the start speed, at the start speed, with another profile.
TIMES: Final = (
    ((1000, 5000, 10_000), 2000, 2000), ((1000, 3000, 10_000), 4000, 2000),
    ((1000, 5000, 10_000), 5000, 500), ((1000, 5000, 10_000), 3000, 800),
    ((1000, 5000, 10_000), 500, 500), ((1000, 5000, 10_000), 1000, 1000),
    ((200, 5000, 2000), 1500, 2000), ((1000, 4000, 4000), 3000, 2000),
    ((1000, 5000, 80_000), 5000, 1600),
)  # fmt: skip
BESIDE_SPEED: Final = ((500, 1000), (3000, 5000), PROFILE[:2])  # V is not between the first two
CLIPPING: Final = (200, 400, 10_000)  # below the speed
PLAIN, RAMPED = (5000, 5000, 10_000), (500, 5000, 1000)
# What is refused, and a speed and a profile with which it would show.
REFUSED: Final = (
    (("V200000",), 1000, PLAIN), (("B150,-1,0,0",), 1000, PLAIN),
    (("F20,-1,1000", "F20,40,1a"), 2000, RAMPED), (("F2000,1000,1000",), 2000, RAMPED),
)  # fmt: skip
# The same where backlash is taken up; directions, backlash and motors but the last are right.
REFUSED_LASH, REFUSED_AT = "B60,60,60,60", 400
REFUSED_PARTS: Final = (
    "D-1,0,1,1", "D-1,-1,0,1", "D-1,-1,-1,0", "B200,200,-1,0", "B200,200,200,-1", "P2,5,1",
    "P2,1,5",
)  # fmt: skip
REFUSED_STEPS: Final = 400
# What is sent under a wrong sum, or to another board: each would show in the moves behind it.
IGNORED: Final = (
    "V1000", "F50,50,1000", "B200,200,0,0", "D-1,-1,1,1", "L9,9,9,9", "H1", "J1", "(",
)  # fmt: skip
IGNORED_STEPS: Final = 300  # at as many steps/s
# A profile, what F then says of it in part, and how far a move goes that reaches its end speed.
LEFT_OUT_PROFILE: Final = (500, 3000, 8000)
LEFT_OUT_OF_F: Final = ("F,2500", "F700", "F,,6000", "F,,")
LEFT_OUT_STEPS: Final = 1600
# Moves of more ticks than 16 bits hold: multiplex, displacements, and what goes farthest.
MANY, FAST = 80_000, 20_000
SPARE: Final = 500  # steps of room that are left for what backlash may have been taken up
FINE: Final = (4, (1, Fraction(-1, 3), Fraction(9999, 10_000), Fraction(1, 1000)))
LONG: Final = (1, (Fraction(-1, 3000), Fraction(1, 4), -1, Fraction(9999, 10_000)))
FAR_UP: Final = 2_147_483_640
BETWEEN: Final = (4800, 16_000, 30_000)  # steps/s; a move takes two seconds, or all the room
CAPPED: Final = 16_000, 50_000  # steps and a speed that X4 halves, but of one axis alone
# What no multiplex makes slower, and whose time that is: a multiplex, what is set, a motion.
MULTIPLEXED: Final = (
    (2, (), ("A-150,0,-300,0,1",), "MN4-CMD-A-05"), (4, (), ("A0,150,150,150,-1",), "MN4-CMD-A-05"),
    (4, (), ("+-50,0,-100,0,1,60,1",), "MN4-CMD-HEL-01"),
    (4, (), ("(", "M200,-100", "M200,-100,30", ")"), "MN4-CMD-CC-05"),
    (2, ("V50", "B10,10,0,0"), ("M-20,-15",), "MN4-BKL-01"),
)  # fmt: skip


def typed(displacements: Sequence[int]) -> str:
    """The M of these; axes that stand are left out at the end and between."""
    told = ",".join(str(one) if one else "" for one in displacements)
    return f"M{told.rstrip(',')}"


@check("MN4-CMD-M-01", "MN4-CMD-M-02", "MN4-CMD-M-03", "MN4-PKT-01", "MN4-RSP-05", "MN4-RSP-15",
       "MN4-MOT-03", "MN4-MEA-06", "MN4-PAR-07", safety=MOTION)  # fmt: skip
def moves_end_where_they_are_sent(session: Session) -> None:
    """One to four axes either way: all on their chord at any time, exactly there at the end; the
    mirror image leads back."""
    motion = BoardMotion(BoardDriver(session))
    motion.ready()
    for displacements in MOVES:
        motion.needs_room(major_length(displacements), "these moves")
        for by in (displacements, tuple(-one for one in displacements)):
            _judge_move(motion, by)


def _judge_move(motion: BoardMotion, by: tuple[int, ...]) -> None:
    session = motion.session
    exchange = motion.do(typed(by), "MN4-PKT-01")
    lasts_ns = round((motion.ends[0] - Fraction(exchange.asked_ns, NS)) * NS)
    took_ns = exchange.done_ns - exchange.asked_ns
    if lasts_ns > LONG_NS:
        told = f"DONE before the end of a motion of {lasts_ns // 10**6} ms"
        is_soon = took_ns < lasts_ns
        session.expect(is_soon, "MN4-RSP-05", told, f"after {took_ns // 10**6} ms")
    before = tuple(low for low, _ in motion.model.timeline.motions[0].base)
    rows = motion.follow("MN4-CMD-M-01", ("MN4-CMD-M-02", "MN4-CMD-M-03"), "MN4-CMD-M-01")
    session.expect(is_monotone(rows, by), "MN4-MEA-06", f"no way back on {by}", rows)
    session.expect(is_monotone(rows, by), "MN4-RSP-15", "all axes at one instant", rows)
    stood = [at for at, one in enumerate(by) if not one and rows[-1][at] != before[at]]
    session.expect(not stood, "MN4-MOT-03", "axes that were not named at rest", rows[-1])
    session.expect(not stood, "MN4-PAR-07", "what is left out at the end not moved", rows[-1])


@check("MN4-PAR-01", "MN4-PAR-06", "MN4-PAR-07", "MN4-PAR-10", "MN4-CMD-M-02", "MN4-CMD-I-01",
       "MN4-CMD-I-02", "MN4-CMD-I-03", "MN4-CMD-L-02", safety=MOTION)  # fmt: skip
def coordinates_are_those_of_the_mode(session: Session) -> None:
    """Relative sums and absolute places; an axis that is left out keeps its place in both; L moves
    the origin of absolute places."""
    motion = BoardMotion(BoardDriver(session))
    motion.ready("L30,-20,10,5")
    for text, requirement in (
        ("M40,,-15", "MN4-PAR-06"), ("m5", ("MN4-PAR-07", "MN4-PAR-01")), ("M,25,", "MN4-PAR-10"),
        ("M10,10,10,10", "MN4-CMD-M-02"),
    ):  # fmt: skip
        motion.run(text, requirement)
    for _ in range(2):  # it is a mode, no switch
        motion.do(motion.mode(is_absolute=True), "MN4-CMD-I-02")
    for text, names in (
        ("M50,40,30,20", ("MN4-CMD-M-02", "MN4-CMD-I-01", "MN4-CMD-L-02")),
        ("M,,-10", ("MN4-PAR-06", "MN4-CMD-I-03")), ("M60", ("MN4-PAR-07",)),
        ("M60,,-10", ("MN4-CMD-I-01",)), ("M70,", ("MN4-PAR-10",)),
        ("M0,0,0,0", ("MN4-CMD-I-02",)),
    ):  # fmt: skip
        motion.run(text, names)
    motion.do("L100,100,100,100", "MN4-CMD-L-02")
    motion.run("M120,90,100,110", "MN4-CMD-L-02")
    for _ in range(2):
        motion.do(motion.mode(is_absolute=False), "MN4-CMD-I-03")
    for text in ("M-20,10,0,-10", "M1"):
        motion.run(text, "MN4-CMD-I-03")


@check("MN4-CMD-V-01", "MN4-CMD-V-03", "MN4-CMD-F-01", "MN4-MOT-10", "MN4-MOT-11", "MN4-MOT-12",
       "MN4-MOT-14", safety=MOTION)  # fmt: skip
def moves_take_the_time_of_their_profile(session: Session) -> None:
    """Ramps from start speed and back, a lower peak where the way is short, end speed at most, no
    ramp below start speed.  A profile whose end is below V, or its start above, leaves V alone, and
    so does a motion by it."""
    motion = BoardMotion(BoardDriver(session))
    for profile, speed, steps in TIMES:
        motion.needs_speed(min(speed, profile[1]), "these moves")
        motion.needs_room(steps, "these moves")
        motion.ready(speed=speed, profile=profile)
        reached = motion.model.settings.motion(motion.driver.reading)
        names = ["MN4-CMD-V-01", "MN4-CMD-F-01", "MN4-MOT-14"]
        names += ["MN4-CMD-V-03", "MN4-MOT-12"] if not profile[0] < speed <= profile[1] else []
        names += ["MN4-MOT-11"] if steps < 2 * reached.profile.ramp_length(
            Fraction(profile[0]), Fraction(min(speed, profile[1]))
        ) else ["MN4-MOT-10"]  # fmt: skip
        for by in (steps, -steps):
            motion.run(f"M{by}", "MN4-CMD-V-01", names, "MN4-CMD-V-01", names, samples=8)
    motion.ready()
    for speeds in BESIDE_SPEED:
        start, end = map(motion.fast, speeds)
        motion.do(f"F{start},{end},{PROFILE[2]}", "MN4-CMD-F-01")
    motion.run("M2000", "MN4-CMD-F-01", samples=4)
    for texts in (("M40",), ("A-10,0,-20,0,1",), ("(", "M20", "M20", ")")):
        motion.ready(profile=CLIPPING)
        for text in texts:
            motion.do(text, "MN4-CMD-V-01")
        motion.follow("MN4-CMD-V-03", samples=1)
        motion.do(f"F{','.join(map(str, PROFILE))}", "MN4-CMD-F-01")
        motion.run("M-1000", "MN4-CMD-V-01", samples=3)


@check("MN4-ERR-02", safety=MOTION)
def what_is_refused_sets_nothing(session: Session) -> None:
    """V and B out of range, and B, F, D and P of which only the beginning is right: moves there and
    back, and an arc, are as before."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(REFUSED_STEPS, "these moves")
    for texts, speed, profile in REFUSED:
        motion.ready(speed=speed, profile=profile)
        if _are_refused(motion, texts):
            for by in (REFUSED_STEPS, -REFUSED_STEPS):
                motion.run(f"M{by}", "MN4-ERR-02", samples=4)
    motion.ready(REFUSED_LASH, speed=REFUSED_AT)
    if _are_refused(motion, REFUSED_PARTS):
        for text in ("M60,60,60,60", "M-60,-60,-60,-60"):
            motion.run(text, "MN4-ERR-02", samples=4)
        motion.do("B0,0,0,0", "MN4-ERR-02")  # in an arc it may be taken up otherwise (MN4-AMB-58)
        motion.run("A-20,0,-40,0,1", "MN4-ERR-02")


def _are_refused(motion: BoardMotion, texts: Sequence[str]) -> bool:
    """Judge that what this board does not take is refused; whether there is any of that."""
    refused = [text for text in texts if motion.driver.refusal_of(text) is not None]
    for text in refused:
        motion.driver.draws(text, motion.driver.errors("PARA_ERROR"), "MN4-ERR-02")
    return bool(refused)


@check("MN4-PAR-09", safety=MOTION)
def what_a_setting_leaves_out_is_as_it_was(session: Session) -> None:
    """Of F, B, D and P: moves behind it are those of the values set before, none of which is that
    of power-on; or of 0 steps of backlash, if this board reads so what is left out
    (MN4-AMB-49)."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(LEFT_OUT_STEPS, "these moves")
    motion.needs_speed(LEFT_OUT_PROFILE[1], "these moves")
    for text in LEFT_OUT_OF_F:
        motion.ready(speed=4000, profile=LEFT_OUT_PROFILE)
        if _is_left_out(motion, text):
            motion.run(f"M{LEFT_OUT_STEPS}", "MN4-PAR-09", samples=4)
    motion.ready("B12,10,8,6", "D-1,-1,-1,-1", speed=50)  # what may be taken up adds up
    for text in ("B,9", "D,,1"):
        _is_left_out(motion, text)
    for text in ("M8", "M,8", "M,,8", "M,,,8"):
        motion.run(text, "MN4-PAR-09")
    if motion.driver.reading("omitted_param") == "keep":
        motion.ready(motion.plane(2, 1, 4))
        motion.do(motion.plane(1, 2), "MN4-PAR-09")
        motion.run("+-50,0,-100,0,1,-60,0", "MN4-PAR-09")


def _is_left_out(motion: BoardMotion, text: str) -> bool:
    """Set something but in part, unless this board refuses that (MN4-AMB-49)."""
    is_served = motion.driver.refusal_of(text) is None
    if is_served:
        motion.do(text, "MN4-PAR-09")
    return is_served


@check("MN4-MOT-01", "MN4-MOT-04", "MN4-MOT-05", "MN4-CMD-M-01", safety=MOTION)
def speed_is_that_of_the_axis_that_goes_farthest(session: Session) -> None:
    """A diagonal takes as long as its longest axis alone, at any multiplex; one that is too fast
    for its multiplex is slowed down, and one axis alone is not."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1600, "these moves")
    for multiplex in (1, 2, 4):
        for by in ("1600", "1600,1600,1600,1600", "-1600,-1200,7", "0,-1200,-1600,-1599"):
            motion.ready(f"X{multiplex}")
            names = ("MN4-CMD-M-01", "MN4-MOT-01", "MN4-MOT-05")
            motion.run(f"M{by}", "MN4-CMD-M-01", names, "MN4-MOT-05", names, samples=3)
    steps, speed = CAPPED
    if motion.room < steps or session.envelope.max_speed < speed:
        told = f"the limit of a multiplex takes {steps} steps at {speed} steps/s"
        session.not_run("MN4-MOT-04", told)
        return
    motion.ready("X4", speed=speed, profile=(20_000, speed, 1_000_000))
    motion.run(f"M{-steps}", "MN4-MOT-05")
    if motion.driver.reading("multiplex_cap") == "error":
        refused = motion.driver.errors("PARA_ERROR")
        motion.driver.draws(f"M{steps},{steps}", refused, "MN4-MOT-04")
        motion.stays("MN4-MOT-04")
        return
    motion.run(f"M{steps},{steps}", "MN4-CMD-M-01", "MN4-MOT-04")


@check("MN4-MOT-05", "MN4-CMD-A-05", "MN4-CMD-HEL-01", "MN4-CMD-CC-05", "MN4-BKL-01",
       safety=MOTION)  # fmt: skip
def a_multiplex_leaves_every_motion_its_time(session: Session) -> None:
    """It is the resolution of linear interpolation: an arc, a helix, a contour and a compensation
    of backlash take as long with it as without."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(400, "these motions")
    for multiplex, settings, (*before, text), requirement in MULTIPLEXED:
        motion.ready(f"X{multiplex}", *settings, speed=800)
        for one in before:
            motion.do(one, requirement)
        names = (requirement, "MN4-MOT-05")
        motion.run(text, requirement, names, requirement, names, samples=4)


@check("MN4-CMD-M-01", "MN4-CMD-M-02", "MN4-MOT-01", "MN4-MOT-05", "MN4-CC-01", safety=MOTION,
       level="full")  # fmt: skip
def long_moves_keep_their_proportion(session: Session) -> None:
    """There as a move and back as a contour, of more than 65535 ticks and of more than 65535 steps
    where there is room for them: all axes on their chord at any time, and at their ends."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(2000, "these moves")
    ticks, steps = (MANY // (2 * multiplex) + SPARE for multiplex, _ in (FINE, LONG))
    has_room = motion.room >= steps
    _judge_long(motion, *FINE, ("MN4-MOT-05",) if has_room else ("MN4-MOT-05", "MN4-MOT-01"))
    if not has_room:
        lacking = f"{ticks} for more than 65535 ticks, " if motion.room < ticks else ""
        told = f"--max-travel {lacking}{steps} for more than 65535 steps"
        session.note(f"the longest of these moves need {told}")
        return
    _judge_long(motion, *LONG, ("MN4-MOT-01",))


def _judge_long(
    motion: BoardMotion, multiplex: int, shares: tuple[Fraction | int, ...], names: tuple[str, ...]
) -> None:
    """From one side of home to the other, and back."""
    length = min(MANY // multiplex, 2 * (motion.room - SPARE))
    by = [round(length * share) for share in shares]
    aside = [-one // 2 for one in by]
    motion.ready(f"X{multiplex}", speed=FAST, profile=(PROFILE[0], FAST, PROFILE[2]))
    motion.run(typed(aside), "MN4-CMD-M-01", samples=2)
    path = ("MN4-CMD-M-01", *names)
    motion.run(typed(by), "MN4-CMD-M-01", path, "MN4-CMD-M-02", names, samples=12)
    motion.set("(")
    motion.set(typed([-one for one in by]))
    motion.do(")", "MN4-CC-01")
    motion.follow(path, "MN4-CC-01", names, samples=12)


@check("MN4-MOT-02", safety=MOTION)
def the_slowest_and_the_fastest_rate_are_kept(session: Session) -> None:
    """2 steps/s, and up to 100000 as far as the envelope lets it."""
    motion = BoardMotion(BoardDriver(session))
    motion.ready("V2")
    motion.run("M3,-1", "MN4-MOT-02")
    for speed in BETWEEN:
        steps = motion.within(2 * speed)
        if session.envelope.max_speed < speed:
            break
        motion.ready(speed=speed, profile=(speed, 2 * speed, 1_000_000))
        for by in (steps, -steps):
            motion.run(f"M{by}", "MN4-MOT-02", samples=4)
    if motion.room < 50_000 or session.envelope.max_speed < 100_000:
        return
    motion.ready(speed=100_000, profile=(100_000, 100_000, 1_000_000))
    motion.run("M50000", "MN4-MOT-02")


@check("MN4-CMD-V-05", "MN4-CMD-F-03", "MN4-MOT-15", "MN4-STM-01", "MN4-CMD-I-04", "MN4-RSP-06",
       safety=MOTION)  # fmt: skip
def a_move_keeps_the_settings_of_its_time(session: Session) -> None:
    """V, F, I, P, B and X that come during a motion are for those behind it, and a move of no
    steps takes nothing from them; each move ramps by itself."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1400, "these moves")
    for text, requirement in (
        ("V500", "MN4-CMD-V-05"), ("F400,400,1000", "MN4-CMD-F-03"), ("V2000", "MN4-MOT-15"),
    ):  # fmt: skip
        motion.ready()
        motion.do("M1000", "MN4-RSP-06")
        motion.do(text, requirement)
        motion.do("M400", "MN4-RSP-06")
        motion.follow(requirement, "MN4-STM-01", requirement, samples=8)
    for settings, runs, sent, waits in (
        ((), "A-200,0,-400,0,1", motion.plane(1, 2, 4), "A100,0,200,0,-1"),
        (("V100", "B50,50,0,0"), "M-30,-10", "B4,4,0,0", "M20,10"),  # sent within 0.5 s
        ((), "A-200,0,-400,0,1", "X2", "M40,-30"),
        ((), "+-200,0,-400,0,1,-30,0", "M", "M40,-30"),
        ((), "M400", "V-1", "V2000"),
        ((), "M400", "M0", "M,50"),
        ((), "M400", "M,,,", "+-50,0,-100,0,1,30,0"),
    ):
        motion.ready(*settings)
        for text in (runs, sent, waits):
            motion.do(text, "MN4-STM-01")
        motion.follow("MN4-STM-01", samples=8)
    if int(motion.driver.reading("queue_depth")) < MODES_QUEUED:
        session.not_run("MN4-CMD-I-04", "the queue of this board is too short (MN4-AMB-52)")
        return
    motion.ready()
    motion.do("M800", "MN4-RSP-06")
    motion.do(motion.mode(is_absolute=True), "MN4-CMD-I-04")
    motion.do("M700", "MN4-RSP-06")
    motion.do(motion.mode(is_absolute=False), "MN4-CMD-I-04")
    motion.do("M-300", "MN4-RSP-06")
    names = ("MN4-STM-01", "MN4-CMD-I-04")
    motion.follow(names, "MN4-CMD-I-04", "MN4-STM-01", samples=8)


@check("MN4-MOT-06", safety=MOTION)
def counters_go_round(session: Session) -> None:
    """Behind the greatest counter comes the least, and the other way."""
    motion = BoardMotion(BoardDriver(session))
    bounds = [abs(int(motion.driver.reading(name))) for name in ("long_max", "long_min")]
    if min(bounds) < FAR_UP:
        session.skip(f"this board loads no counter of {FAR_UP} (MN4-AMB-48)")
    motion.ready(f"L{FAR_UP},{-FAR_UP},0,0")
    motion.set("M20,-20")
    came = motion.rest()
    up, down = FAR_UP + 20 - 2**32, 2**32 - FAR_UP - 20
    told = f"{up}, {down}, 0, 0"
    motion.driver.tells(came == (up, down, 0, 0), "MN4-MOT-06", told, came)
    motion.ready()


@check("MN4-PKT-05", "MN4-PKT-12", "MN4-ERR-02", "MN4-PAR-07", safety=MOTION)
def what_is_refused_moves_nothing(session: Session) -> None:
    """M with a wrong sum, with a letter in a number, with a space in it; settings, what opens and
    what ends with a wrong sum: motions are as if it had not been sent."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.ready()
    driver.ignores("M100")
    motion.stays("MN4-PKT-05")
    driver.draws("M10a", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    motion.stays("MN4-ERR-02")
    if driver.reading("space_policy") == "skip":
        session.not_run("MN4-PKT-12", "this board leaves spaces out (MN4-AMB-68)")
    else:
        for text in ("M 10", "M10 ", "M10, 20"):
            driver.draws(text, driver.errors("PARA_ERROR"), "MN4-PKT-12")
            motion.stays("MN4-PKT-12")
    counters, _ = motion.read()
    session.expect(not any(counters), "MN4-PKT-05", "0, 0, 0, 0", counters)
    driver.ignores("M5,7,9,11")
    motion.run("M5", ("MN4-PKT-05", "MN4-PAR-07"))
    driver.draws("M5,7,9,1a", driver.errors("PARA_ERROR"), "MN4-ERR-02")
    motion.run("M,5", ("MN4-ERR-02", "MN4-PAR-07"))
    _judge_ignored_settings(motion, driver.ignores, "MN4-PKT-05")
    _judge_ignored_ends(motion, driver.ignores, "MN4-PKT-05")


@check("MN4-PKT-06", safety=MOTION, needs=("alone",))
def what_another_board_is_told_moves_nothing(session: Session) -> None:
    """Settings, what opens and what ends, to another id: motions are as if it had not been sent."""
    motion = BoardMotion(BoardDriver(session))
    other = motion.driver.board % 127 + 1

    def passes(text: str) -> None:
        if text != "}":  # of another board nobody knows where that leads
            motion.driver.client.send(codec.request(other, text))

    _judge_ignored_settings(motion, passes, "MN4-PKT-06")
    _judge_ignored_ends(motion, passes, "MN4-PKT-06")


def _judge_ignored_settings(motion: BoardMotion, ignores: Callable[[str], None], name: str) -> None:
    """What sets, holds or opens and is not taken: moves there and back, and an arc, are as
    before."""
    steps = motion.within(IGNORED_STEPS)
    motion.ready("B60,60,0,0", speed=steps)
    plane, mode = motion.plane(2, 1, 3), motion.mode(is_absolute=True)
    for text in (*IGNORED, plane, mode):
        ignores(text)
    for text in (f"M{steps},5", f"M{-steps},-5"):
        motion.run(text, name)
    motion.do("B0,0,0,0", name)  # in an arc it may be taken up otherwise (MN4-AMB-58)
    motion.run("A-20,0,-40,0,1", name)


def _judge_ignored_ends(motion: BoardMotion, ignores: Callable[[str], None], name: str) -> None:
    """What ends, pauses, resumes or runs and is not taken: a move, its pause, and a contour that
    is entered go on."""
    steps = motion.within(IGNORED_STEPS)
    motion.ready(speed=steps)
    motion.do(f"M{steps}", name)
    for text in "Q{":
        ignores(text)
    motion.follow(name)
    motion.do(f"M{-steps}", name)
    motion.do("{", name)
    motion.rest_paused()
    for text in "}Q":
        ignores(text)
    motion.stays(name)
    motion.do("}", name)
    motion.follow(name)
    motion.set("(")
    motion.do(f"M{steps}", name)
    for text in ("V50", "Q", ")"):
        ignores(text)
    motion.do(")", name)
    motion.follow(name)


@check("MN4-SYN-02", "MN4-CMD-T-02", "MN4-CMD-T-03", safety=MOTION)
def a_positive_speed_ends_external_sync(session: Session) -> None:
    """Behind V-1 a move waits for pulses, and Q ends it; behind V2000 one runs in its time.  T
    waits as well, and N tells how far it will go."""
    motion = BoardMotion(BoardDriver(session))
    motion.ready("V-1")
    motion.do("M100", "MN4-SYN-02")
    counters, _ = motion.read()
    motion.set("Q")
    session.note(f"without pulses the counters were {counters}")
    motion.ready()
    motion.run(f"M{motion.within(SPEED)}", "MN4-SYN-02")
    for is_absolute, x, y, loaded in ((False, 20, -10, 0), (True, 120, -40, 100)):
        motion.ready(motion.mode(is_absolute=is_absolute), f"L{loaded},{-loaded},0,0")
        motion.driver.draws(f"T{x},{y},0,0,1000,0", DONE, "MN4-CMD-T-03")
        left = motion.driver.steps_left()
        wanted = motion.driver.counted((x - loaded, y + loaded, 0, 0))
        # In some readings a step comes before the first pulse (MN4-AMB-71).
        is_right = all(abs(one - other) <= 1 for one, other in zip(left, wanted, strict=True))
        session.expect(is_right, "MN4-CMD-T-02", wanted, left, "left while T waits")
        motion.driver.draws("Q", DONE, "MN4-CMD-T-03")
        motion.rest()
        motion.run("M130,-60", "MN4-CMD-T-03", samples=2)
