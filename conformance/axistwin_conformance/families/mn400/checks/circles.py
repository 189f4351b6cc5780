"""Arcs and helices: on their circle, the right way round, to their end, in their time (A, +; ARC,
HEL)."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot, pi, remainder, tau
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion
from axistwin_conformance.families.mn400.planner.circle import STRAY

ORDER = 130

# Centre and end from the start, of arcs that go clockwise and back: an eighth (the manual's own), a
# quarter, a half, three quarters, small ones.
ARCS: Final = (
    (0, -500, -354, -146), (400, 0, 400, 400), (-400, 0, -800, 0), (0, 300, -300, 300),
    (250, 250, 500, 500), (0, -3, 3, -3), (-1, 0, -2, 0),
)  # fmt: skip
# On a circle of radius 250, in order, a point in each eighth: arcs begin there and end there.
EIGHTHS: Final = (
    (150, 200), (200, 150), (200, -150), (150, -200),
    (-150, -200), (-200, -150), (-200, 150), (-150, 200),
)  # fmt: skip
OF_EIGHTHS: Final = tuple(
    (-x, -y, EIGHTHS[at - 5][0] - x, EIGHTHS[at - 5][1] - y) for at, (x, y) in enumerate(EIGHTHS)
)
TABLE: Final = ("MN4-CMD-A-01", "MN4-CMD-A-02", "MN4-CMD-A-03", "MN4-CMD-A-05", "MN4-ARC-01",
                "MN4-ARC-03", "MN4-ARC-04", "MN4-ARC-08")  # fmt: skip
# Planes of X and Y, and a traverse motor, from 1.
PLANES: Final = ((1, 2, 3), (4, 1, 2), (2, 4, 1), (3, 1, 4))
# Centre and end from the start; the same points of the lattice, or the next, are nearest to both.
ENDS_BESIDE: Final = (
    (-60, -80, -1, -2), (-60, -80, 0, 2), (-60, -80, 2, 0), (-60, -80, -2, -1), (61, 31, -2, -1),
    (69, 1, 1, 0), (-60, -80, -121, -162), (-60, -80, -119, -158),
)  # fmt: skip
BESIDE: Final = 2.3  # steps by which radii may differ: rounding of a right arc gives 2.12
QUEUED: Final = 6  # places that are taken behind the motion that runs
ON_CIRCLE: Final = ("MN4-ARC-04", "MN4-ARC-08")
ALONG: Final = 3.5  # steps along a circle: more than rounding of an arc and its traverse gives
TRAVERSES: Final = (600, 540)  # along half a circle of 566 ticks
LONG_TURNS: Final = 28  # of radius 500, behind a half: 80600 ticks, more than 16 bits hold
LONG_LOOKS: Final = 61  # at other fractions of a step of the traverse, ever again
LARGE: Final = (18_000, 50_000, 70_000)  # radii whose squares 31 and 32 bits do not hold
SHORT, MOST_SPEED = 300, 20_000  # steps of an arc of these; of the way to its circle
OUTSIDE: Final = 9.0  # steps between radii: more than any rounding of a right arc gives


@check(*TABLE, safety=MOTION)
def arcs_run_on_their_circle(session: Session) -> None:
    """Motors 1 and 3 on the circle at any time, clockwise or not as asked, exactly at the end;
    also from each eighth of the circle and to each."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "these arcs")
    for centre_x, centre_y, x, y in ARCS + OF_EIGHTHS:
        for direction in (1, -1):
            motion.ready()
            motion.do(f"A{centre_x},{centre_y},{x},{y},{direction}", "MN4-CMD-A-01")
            path = (*ON_CIRCLE, "MN4-CMD-A-01", "MN4-CMD-A-03", "MN4-ARC-01", "MN4-CMD-A-05")
            rows = motion.follow(path, ("MN4-ARC-03", "MN4-CMD-A-02"), "MN4-CMD-A-05", samples=8)
            _judge_circle(session, rows, (0, 2), (centre_x, centre_y), (x, y))


def _judge_circle(
    session: Session,
    rows: Sequence[Sequence[int]],
    motors: tuple[int, int],
    centre: tuple[int, int],
    end: tuple[int, int],
) -> None:
    """Judge every position by its distance from the centre; other motors stand."""
    radius = hypot(*centre)
    most = STRAY + abs(hypot(end[0] - centre[0], end[1] - centre[1]) - radius)
    for row in rows:
        far = hypot(row[motors[0]] - centre[0], row[motors[1]] - centre[1])
        told = f"within {most:.2f} steps of radius {radius:.2f}"
        session.expect(abs(far - radius) <= most, "MN4-ARC-04", told, f"{far:.2f} at {row}")
        others = [one for at, one in enumerate(row) if at not in motors]
        session.expect(not any(others), "MN4-ARC-08", "the other motors at rest", row)


@check("MN4-ARC-05", "MN4-CMD-A-03", "MN4-ARC-01", safety=MOTION)
def a_clockwise_half_circle_goes_below(session: Session) -> None:
    """The manual's example, smaller: from the right end of a diameter to the left one, Y never
    above; counter-clockwise never below."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "these arcs")
    for direction in (1, -1):
        motion.ready(motion.plane(1, 2, 3))
        motion.do(f"A-500,0,-1000,0,{direction}", "MN4-CMD-A-03")
        rows = motion.follow(("MN4-ARC-05", "MN4-ARC-01", "MN4-CMD-A-03"), samples=9)
        sides = [row[1] * direction for row in rows]
        told = f"Y {'0 or less' if direction > 0 else '0 or more'}"
        is_right = max(sides) <= STRAY and min(sides) < -STRAY
        session.expect(is_right, "MN4-ARC-05", told, [row[1] for row in rows])


@check("MN4-CMD-P-01", "MN4-CMD-A-01", "MN4-CMD-A-02", "MN4-ARC-08", safety=MOTION)
def arcs_run_in_the_plane_that_was_set(session: Session) -> None:
    """X and Y are the motors of P in its order; in absolute mode centre and end are coordinates."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(300, "these arcs")
    for x, y, z in PLANES:
        motion.ready(motion.plane(x, y, z))
        path = ("MN4-CMD-P-01", "MN4-CMD-A-01", "MN4-ARC-08")
        motion.run("A0,-200,200,-200,1", "MN4-CMD-P-01", path, samples=4)
        motion.ready(motion.plane(x, y, z), motion.mode(is_absolute=True), "L100,200,300,400")
        base = dict(zip((1, 2, 3, 4), (100, 200, 300, 400), strict=True))
        text = f"A{base[x]},{base[y] + 100},{base[x] - 100},{base[y] + 100},-1"
        motion.run(text, "MN4-CMD-A-02", "MN4-CMD-A-02", samples=4)


@check("MN4-CMD-A-03", "MN4-CMD-A-05", "MN4-ARC-01", "MN4-ARC-02", "MN4-ARC-03", safety=MOTION)
def the_angle_says_how_far_an_arc_goes(session: Session) -> None:
    """Of ends beside the circle, a step or two from the start or from the point opposite: one way
    round the arc is over at once and the other way nearly whole, or either way about a half."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(250, "these arcs")
    if float(motion.driver.reading("arc_radius_tol")) < BESIDE:
        session.skip("this board takes no arc whose end is so far beside it (MN4-AMB-28)")
    for centre_x, centre_y, x, y in ENDS_BESIDE:
        for direction in (1, -1):
            motion.ready()
            text = f"A{centre_x},{centre_y},{x},{y},{direction}"
            motion.do(text, ("MN4-CMD-A-03", "MN4-ARC-02"))
            path = ("MN4-ARC-01", "MN4-CMD-A-03")
            motion.follow(path, "MN4-ARC-03", "MN4-CMD-A-05", samples=4)


@check("MN4-CMD-A-02", "MN4-CMD-A-04", "MN4-STM-01", "MN4-CMD-M-02", "MN4-CMD-I-01", safety=MOTION)
def an_arc_that_waits_begins_where_what_is_before_it_ends(session: Session) -> None:
    """In absolute mode, behind a move, a contour, a helix and an arc that wait as it does: it is
    taken, and runs to its end; a move behind it begins there."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(300, "these motions")
    if int(motion.driver.reading("queue_depth")) < QUEUED:
        session.skip("the queue of this board is too short (MN4-AMB-52)")
    names = ("MN4-CMD-A-02", "MN4-CMD-A-04")
    beside = int(float(motion.driver.reading("arc_radius_tol")))
    for before in (("M60,-40,20",), ("(", "M50,20", "M-30,,40", ")"), ("+-50,0,-100,0,1,70,1",)):
        motion.ready(speed=500)
        for text in ("M100", *before, motion.mode(is_absolute=True)):
            motion.do(text, "MN4-STM-01")
        for x, y, radius in ((1, 2, 40 - beside), (3, 2, 40 + beside)):  # a step off is refused
            motion.do(motion.plane(x, y, 4), "MN4-STM-01")
            at_x, at_y = (motion.end[motor - 1][0] for motor in (x, y))
            motion.do(f"A{at_x},{at_y - 40},{at_x - radius},{at_y - 40},-1", names)
        motion.follow(("MN4-STM-01", "MN4-CMD-A-02"), samples=8)
        motion.run("M10,20", ("MN4-CMD-M-02", "MN4-CMD-I-01"), samples=2)


@check("MN4-ARC-04", "MN4-CMD-A-04", safety=MOTION, level="full")
def an_arc_may_be_of_a_large_circle(session: Session) -> None:
    """A short one each, of radii up to 70000 steps as far as there is room for the whole circle."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(LARGE[0] + 2 * SHORT, "a large circle around home")
    for radius in LARGE:
        if motion.room < radius + 2 * SHORT:
            session.note(f"a circle of radius {radius} needs --max-travel {radius + 2 * SHORT}")
            break
        motion.ready(speed=motion.fast(MOST_SPEED), profile=(1000, motion.fast(MOST_SPEED), 20_000))
        motion.run(f"M{radius}", "MN4-CMD-A-04", samples=1)
        motion.do("V500", "MN4-CMD-A-04")
        for way in (-1, 1):  # up from the end of the radius, and down again
            x, y = round(radius - (radius**2 - SHORT**2) ** 0.5), SHORT
            text = f"A{-radius},0,{-x},{y},-1" if way < 0 else f"A{x - radius},{-y},{x},{-y},1"
            motion.run(text, "MN4-CMD-A-04", "MN4-ARC-04", samples=8)


@check("MN4-ARC-06", "MN4-CMD-A-05", safety=MOTION)
def an_arc_to_its_start_is_a_full_circle(session: Session) -> None:
    """Both ways round, in the time of a whole circle."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(800, "this circle")
    for direction in (1, -1):
        motion.ready()
        motion.do(f"A-400,0,0,0,{direction}", "MN4-CMD-A-05")
        motion.follow(("MN4-ARC-06", "MN4-CMD-A-05"), samples=9)


@check("MN4-ARC-02", "MN4-ARC-07", "MN4-CMD-A-04", safety=MOTION)
def radii_must_agree(session: Session) -> None:
    """A rounded arc is served, of a helix, too; no radius, and an end off the circle, are refused
    and move nothing."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    motion.needs_room(1000, "these arcs")
    for text in ("A0,-500,-354,-146,-1", "+0,-500,-354,-146,-1,40,0"):
        motion.ready()
        motion.run(text, "MN4-ARC-02")
    motion.ready()
    for text, requirement in (
        ("A0,0,0,0,1", "MN4-ARC-07"), ("A0,0,10,0,-1", "MN4-ARC-07"), ("A0,0,2,0,1", "MN4-ARC-07"),
        ("A-100,0,-50,0,1", "MN4-CMD-A-04"), ("A0,100,0,300,-1", "MN4-CMD-A-04"),
        ("A-300,0,-610,0,1", "MN4-CMD-A-04"), ("+-300,0,-610,0,1,40,0", "MN4-ARC-02"),
        ("+0,100,0,190,-1,40,1", "MN4-ARC-02"), ("+0,0,10,0,1,40,0", "MN4-ARC-07"),
    ):  # fmt: skip
        driver.draws(text, driver.errors("PARA_ERROR"), requirement)
        motion.stays(requirement)
    driver.draws("A-100,0,-200,0,0", driver.errors("PARA_ERROR"), "MN4-CMD-A-04")
    motion.stays("MN4-CMD-A-04")


@check("MN4-MOT-13", "MN4-CMD-A-05", safety=MOTION)
def arcs_have_no_ramps(session: Session) -> None:
    """An arc above the start speed runs at its speed from the first step to the last, and not above
    the end speed."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "this circle")
    motion.needs_speed(3000, "this circle")
    for speed, profile in ((3000, (500, 5000, 5000)), (4000, (500, 3000, 5000))):
        motion.ready(speed=speed, profile=profile)
        motion.do("A-500,0,-1000,0,1", "MN4-CMD-A-05")
        motion.follow(("MN4-MOT-13", "MN4-CMD-A-05"), samples=8)


@check("MN4-ARC-09", safety=MOTION)
def steps_left_of_an_arc_are_those_to_its_end(session: Session) -> None:
    """N is the end less the present place of each motor, or the way along the path
    (MN4-AMB-39)."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(800, "this arc")
    motion.ready(speed=500)
    motion.do("A-400,0,-800,0,1", "MN4-ARC-09")
    motion.driver.target.wait(0.2)
    motion.do("{", "MN4-ARC-09")
    here = motion.rest()
    left = motion.driver.steps_left()
    net = motion.driver.counted((-800 - here[0], 0, -here[2], 0))
    if motion.driver.reading("readcount_arc") == "net":
        motion.driver.tells(left == net, "MN4-ARC-09", str(net), left)
    else:
        is_path = abs(left[0]) >= abs(net[0]) and abs(left[2]) >= abs(net[2])
        motion.driver.tells(is_path, "MN4-ARC-09", f"{net} or more", left)


# --- helices --------------------------------------------------------------------------------------


@check("MN4-CMD-HEL-01", "MN4-CMD-HEL-02", "MN4-CMD-HEL-03", "MN4-HEL-01", "MN4-HEL-02",
       safety=MOTION)  # fmt: skip
def helices_turn_and_traverse(session: Session) -> None:
    """Whole turns and the arc, the traverse in proportion and either way, on the motors of P, in
    both coordinate modes."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(600, "these helices")
    for plane, traverse, turns in (
        ((1, 3, 2), -250, 2), ((1, 3, 2), 40, 0), ((4, 2, 3), 500, 1), ((2, 1, 4), -3, 3),
    ):  # fmt: skip
        for is_absolute in (False, True):
            motion.ready(motion.plane(*plane), motion.mode(is_absolute=is_absolute))
            motion.do(f"+-100,0,-200,0,1,{traverse},{turns}", "MN4-CMD-HEL-01")
            path = ("MN4-HEL-02", "MN4-CMD-HEL-02", "MN4-CMD-HEL-03")
            end = ("MN4-CMD-HEL-01", "MN4-CMD-HEL-02")
            motion.follow(path, end, ("MN4-HEL-01", "MN4-CMD-HEL-01"), samples=8)
    for steps in TRAVERSES:
        _judge_long_traverse(motion, steps)


def _judge_long_traverse(motion: BoardMotion, traverse: int) -> None:
    """A helix whose traverse makes more steps than its arc, or nearly as many: at any time it is as
    far as the arc has turned."""
    radius = 200
    motion.ready(motion.plane(1, 2, 3))
    motion.do(f"+-{radius},0,-{2 * radius},0,1,{traverse},0", "MN4-CMD-HEL-01")
    for x, y, z, _ in motion.follow("MN4-HEL-02", samples=8):
        ahead = remainder(atan2(-y, x + radius) - pi * z / traverse, tau) * radius
        told = f"the arc within {ALONG} steps of where it is at {z} of {traverse} steps"
        is_even = abs(ahead) <= ALONG
        motion.session.expect(is_even, "MN4-HEL-02", told, f"{ahead:.2f} at {(x, y, z)}")


@check("MN4-CMD-HEL-01", "MN4-HEL-02", safety=MOTION, level="full")
def a_long_helix_keeps_its_proportion(session: Session) -> None:
    """One of more than 65535 ticks, and one of more than 255 turns: on its circle and as far along
    as it has turned, to the end."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(1000, "this helix")
    motion.ready(speed=motion.fast(5000))
    motion.do(f"+-500,0,-1000,0,1,-900,{LONG_TURNS}", "MN4-CMD-HEL-01")
    motion.follow("MN4-HEL-02", "MN4-CMD-HEL-01", "MN4-CMD-HEL-01", samples=LONG_LOOKS)
    motion.run("+-2,0,-4,0,1,300,300", "MN4-CMD-HEL-01", "MN4-HEL-02", "MN4-CMD-HEL-01")


@check("MN4-HEL-03", safety=MOTION)
def the_traverse_is_a_distance_in_both_modes(session: Session) -> None:
    """From counters that are not 0, in absolute mode: centre and end are coordinates, the traverse
    is not (MN4-AMB-30)."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(300, "this helix")
    if motion.driver.reading("helix_abs_fields") != "center_dest":
        session.skip("this board reads the fields of a helix otherwise (MN4-AMB-30)")
    motion.ready(motion.mode(is_absolute=True), "L100,50,100,0")
    motion.run("+0,100,-100,100,1,-70,1", "MN4-HEL-03", samples=4)


@check("MN4-HEL-04", safety=MOTION)
def a_helix_to_its_start_turns_once_more(session: Session) -> None:
    """Two turns and a final arc of no length are three turns, or two (MN4-AMB-30)."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(300, "this helix")
    motion.ready()
    motion.do("+-100,0,0,0,-1,90,2", "MN4-HEL-04")
    motion.follow("MN4-HEL-04", samples=9)


@check("MN4-HEL-05", "MN4-CMD-HEL-04", "MN4-CMD-P-03", "MN4-ERR-02", safety=MOTION)
def a_helix_that_cannot_be_is_refused(session: Session) -> None:
    """Less than no turns, no direction, and a traverse motor that is one of the plane; that is not
    the plane's fault, in which an arc still runs."""
    motion = BoardMotion(BoardDriver(session))
    driver = motion.driver
    refused = driver.errors("PARA_ERROR")
    motion.needs_room(300, "these helices")
    motion.ready()
    driver.draws("+-10,0,-20,0,1,5,-1", refused, "MN4-HEL-05")
    driver.draws("+-10,0,-20,0,0,5,1", refused, "MN4-ERR-02")
    motion.stays("MN4-HEL-05")
    if driver.reading("plane_z_check") != "at_helix":
        session.not_run("MN4-CMD-HEL-04", "this board refuses such a plane at once, or never")
        session.not_run("MN4-CMD-P-03", "this board refuses such a plane at once, or never")
        return
    crossed = motion.plane(1, 2)
    driver.draws(crossed, DONE, "MN4-CMD-P-03")
    exchange = driver.ask("+-10,0,-20,0,1,5,0")
    if exchange.says(*DONE):
        driver.follows("plane_z_check", "none", "MN4-CMD-HEL-04")
        return
    driver.tells(exchange.says(*refused), "MN4-CMD-HEL-04", " and ".join(refused), exchange)
    if exchange.says(*refused):
        driver.follows("plane_z_check", "at_helix", "MN4-CMD-HEL-04")
        motion.stays("MN4-CMD-HEL-04")
        motion.model.accept(crossed, motion.span(exchange))
        motion.run("A-100,0,-200,0,1", "MN4-CMD-P-03")


@check("MN4-PKT-13", "MN4-CMD-HEL-01", safety=MOTION)
def the_longest_request_is_served(session: Session) -> None:
    """A helix of 69 characters, its numbers filled up with zeros."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(200, "this helix")
    motion.ready()
    text = "+-0000000050,00000000000,-0000000100,00000000000,-1,-0000000020,00001"
    assert len(text) == 69, "the longest legal payload"
    exchange = motion.driver.ask(text)
    is_whole = "SLAVEBUFFOV" not in exchange.codes
    session.expect(is_whole, "MN4-PKT-13", "START and DONE", exchange.observed)
    motion.driver.judge(exchange, DONE, "MN4-PKT-13")
    motion.model.accept(text, motion.span(exchange))
    motion.follow("MN4-CMD-HEL-01")
