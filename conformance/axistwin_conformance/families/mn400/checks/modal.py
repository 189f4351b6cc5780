"""What settings do to the moves behind them: profile, coordinate mode, counters, backlash, plane;
and how moves are written (PKT, PAR, F, I, L, B, D, P)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.checks.queue import slow_board
from axistwin_conformance.families.mn400.driver import DONE, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import MOTION, BoardMotion

ORDER = 110

STEPS: Final = 60
MOVE_S: Final = 0.5
PROFILES: Final = ((100, 400, 800), (50, 400, 800), (100, 300, 800), (100, 400, 200))
LOADED: Final = "L100,200,-300,400"
LASH: Final = 50


@check("MN4-PKT-01", "MN4-CMD-M-02", safety=MOTION)
def a_request_is_built_as_the_manual_shows(session: Session) -> None:
    """Address, M and its digits, address, sum: the bytes of the manual for board 1."""
    motion, _ = slow_board(session, 2, 1000)
    steps = motion.within(1000)
    raw = motion.driver.client.request(f"M{steps}")
    own = codec.address_byte(motion.driver.board)
    body = bytes([own]) + f"M{steps}".encode() + bytes([own])
    exchange = motion.driver.client.ask_raw(body + bytes([sum(body) % 128]))
    motion.driver.judge(exchange, DONE, "MN4-PKT-01")
    session.step(exchange.request == raw, "the packet of the client", exchange.request.hex())
    motion.model.accept(f"M{steps}", motion.span(exchange))
    motion.follow("MN4-PKT-01", "MN4-CMD-M-02")


@check("MN4-PKT-12", safety=MOTION)
def a_space_moves_nothing(session: Session) -> None:
    """A move with a space in its parameters is refused, and one behind a space is no command."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    driver = motion.driver
    skips = driver.reading("space_policy") == "skip"
    for text in (f"M {steps}", f"M{steps}, 0", f"M{steps} "):
        if skips:
            motion.model.accept(text.replace(" ", ""), motion.span(driver.draws(text, DONE, None)))
            motion.follow("MN4-PKT-12")
        else:
            driver.draws(text, driver.errors("PARA_ERROR"), "MN4-PKT-12")
    if not skips:
        codes = driver.errors("INVALIDCOMMAND", is_recognised=False)
        driver.draws(f" M{steps}", codes, "MN4-PKT-12")
        position = motion.stays("MN4-PKT-12")
        session.expect(not any(position), "MN4-PKT-12", "counters of 0", position)


@check("MN4-PAR-06", "MN4-PAR-07", "MN4-PAR-10", "MN4-CMD-L-02", "MN4-CMD-I-01", safety=MOTION)
def axes_that_are_left_out_stand(session: Session) -> None:
    """In both modes: in front, in between, at the end, behind a comma; an absolute target counts
    from where L put the counters."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    half = steps // 2
    for text, name in (
        (f"M,,{-half}", "MN4-PAR-06"), (f"M{half},,{half}", "MN4-PAR-06"),
        (f"M{-half}", "MN4-PAR-07"), (f"M{half},{half}", "MN4-PAR-07"),
    ):  # fmt: skip
        motion.run(text, name)
    motion.set(LOADED)
    motion.do(motion.mode(is_absolute=True), "MN4-CMD-I-01")
    for text, name in (
        (f"M,,{-300 - half}", "MN4-PAR-06"), (f"M{100 + half},,-300", "MN4-PAR-06"),
        ("M100", "MN4-PAR-07"), (f"M100,{200 + half}", "MN4-PAR-07"), ("M,,,400", "MN4-CMD-L-02"),
        (f"M{100 - half},200", "MN4-CMD-L-02"),
    ):  # fmt: skip
        motion.run(text, name)
    _trailing_comma(motion, half)


def _trailing_comma(motion: BoardMotion, steps: int) -> None:
    """A comma behind the last parameter stands for one that is left out; where the manual is
    silent."""
    motion.set(motion.mode(is_absolute=False))
    text = f"M{steps},"
    exchange = motion.driver.ask(text)
    is_usual = exchange.says(*DONE)
    motion.driver.tells(is_usual, "MN4-PAR-10", "START and DONE", f"{exchange} to {text}")
    if is_usual:
        motion.model.accept(text, motion.span(exchange))
        motion.follow("MN4-PAR-10")


@check("MN4-CMD-I-01", "MN4-CMD-I-02", "MN4-CMD-I-03", safety=MOTION)
def the_two_modes_are_two(session: Session) -> None:
    """From counters of 5 a move to 10 ends at 10 in one mode and at 15 in the other; each mode
    stays until the next I."""
    motion = BoardMotion(BoardDriver(session))
    motion.needs_room(20, "these moves")
    motion.ready(speed=100)
    driver = motion.driver
    seen = {}
    for mode in (1, 0, 1, 0):
        driver.command("L5,0,0,0")
        driver.draws(f"I{mode}", DONE, "MN4-CMD-I-01")
        ends = []
        for _ in range(2):
            driver.command("M10")
            ends.append(motion.rest()[0])
        told = "10 and 10, or 15 and 25"
        session.expect(ends in ([10, 10], [15, 25]), "MN4-CMD-I-01", told, ends, f"after I{mode}")
        kind = seen.setdefault(mode, ends)
        session.expect(kind == ends, "MN4-CMD-I-03", kind, ends, f"after I{mode}")
        driver.command("L20,0,0,0" if ends[1] == 25 else "L5,0,0,0")
        driver.command("M5" if ends[1] == 10 else "M-20")
        motion.rest()
    session.expect(seen[0] != seen[1], "MN4-CMD-I-03", "two modes", seen)
    driver.follows("abs_mode_value", "1" if seen[1] == [10, 10] else "0", "MN4-CMD-I-02")


@check("MN4-CMD-I-01", "MN4-CMD-L-02", safety=MOTION)
def arcs_and_helices_obey_the_mode(session: Session) -> None:
    """A half circle and a helix to coordinates, from counters that L has put elsewhere."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    radius = max(1, steps // 4)
    motion.set("L1000,1000,1000,1000")
    motion.set(motion.mode(is_absolute=True))
    motion.run(f"A{1000 - radius},1000,{1000 - 2 * radius},1000,1", "MN4-CMD-I-01")
    text = f"+{1000 - radius},1000,1000,1000,1,5,0"
    if motion.driver.reading("helix_abs_fields") == "center_dest":
        motion.run(text, "MN4-CMD-L-02", "MN4-CMD-I-01")


@check("MN4-CMD-F-01", safety=MOTION)
def each_part_of_the_profile_counts(session: Session) -> None:
    """Start, end and acceleration, changed by one at a time: durations and places on the way."""
    motion = BoardMotion(BoardDriver(session))
    steps = motion.within(300)
    motion.needs_speed(400, "these moves")
    for number, profile in enumerate(PROFILES):
        motion.ready(speed=motion.fast(400))
        start, end, acceleration = profile
        motion.do(f"F{start},{end},{acceleration}", "MN4-CMD-F-01")
        motion.run(f"M{steps if number % 2 else -steps}", "MN4-CMD-F-01")
    motion.do("F,,800", "MN4-CMD-F-01")
    motion.run(f"M{-steps}", "MN4-CMD-F-01")


@check("MN4-CMD-B-01", "MN4-CMD-D-02", "MN4-CMD-L-03", safety=MOTION)
def lash_is_made_up_for_by_direction(session: Session) -> None:
    """The first move against the remembered direction takes as much longer as its axis has lash;
    D sets that direction, L does not."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    motion.needs_room(steps + 2 * LASH, "these moves")
    driver = motion.driver
    if driver.reading("backlash_counts") == "true":
        session.skip("this board counts its compensation")
    motion.run(f"M{-steps}", "MN4-CMD-B-01")
    motion.do(f"B{LASH},{LASH},0,0", "MN4-CMD-B-01")
    motion.do("D1,-1,1,1", "MN4-CMD-D-02")
    motion.run(f"M{steps}", "MN4-CMD-D-02")
    motion.run(f"M,{steps}", "MN4-CMD-D-02")
    motion.run(f"M{-steps},{steps}", "MN4-CMD-B-01")
    motion.do("L1,2,3,4", "MN4-CMD-L-03")
    motion.run(f"M{-steps},{steps}", "MN4-CMD-L-03")
    motion.do("B0,0,0,0", "MN4-CMD-B-01")
    motion.run(f"M{3 * steps},{-3 * steps}", "MN4-CMD-B-01")


@check("MN4-CMD-L-03", safety=MOTION)
def loading_leaves_what_is_left_of_a_move(session: Session) -> None:
    """N after Q tells the same before and after L."""
    motion, steps = slow_board(session, 1, STEPS)
    driver = motion.driver
    motion.do(f"M{steps}", "MN4-CMD-L-03")
    driver.target.wait(0.4)
    motion.do("Q", "MN4-CMD-L-03")
    motion.rest()
    before = driver.steps_left()
    motion.do("L5,6,7,8", "MN4-CMD-L-03")
    after = driver.steps_left()
    session.expect(after == before, "MN4-CMD-L-03", before, after, "told by N")


@check("MN4-CMD-P-01", "MN4-CMD-P-03", safety=MOTION)
def the_plane_names_the_motors_of_an_arc(session: Session) -> None:
    """A moves the two motors of P and no other; z may be left out, even if it is Y then."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    radius = max(1, steps // 4)
    for motors in ((1, 3, 2), (1, 2, 3), (4, 1, 2), (2, 4, 1), (3, 1, 4)):
        motion.do(motion.plane(*motors), "MN4-CMD-P-01")
        motion.run(f"A{-radius},0,{-2 * radius},0,1", "MN4-CMD-P-01")
    if motion.driver.reading("plane_z_check") != "at_plane":
        motion.do(motion.plane(1, 3, 2), "MN4-CMD-P-03")
        motion.do(motion.plane(1, 2), "MN4-CMD-P-03")
        motion.run(f"A{-radius},0,{-2 * radius},0,-1", "MN4-CMD-P-03")
    else:
        motion.do(motion.plane(1, 2, 3), "MN4-CMD-P-03")
        motion.do(motion.plane(1, 4), "MN4-CMD-P-03")
        motion.run(f"A{-radius},0,{-2 * radius},0,-1", "MN4-CMD-P-03")


@check("MN4-STM-06", "MN4-CMD-CC-04", safety=MOTION)
def a_contour_that_was_quit_does_not_run(session: Session) -> None:
    """After Q neither ) nor a new, empty contour moves anything; the next move runs at the speed
    from before."""
    motion, steps = slow_board(session, MOVE_S, STEPS)
    for text in ("(50", f"V{motion.fast(4000)}", f"M{steps}", f"M,{steps}"):
        motion.do(text, "MN4-CMD-CC-04")
    motion.do("Q", "MN4-CMD-CC-04")
    for texts in ((")",), ("(", ")")):
        for text in texts:
            motion.driver.draws(text, DONE, "MN4-STM-06")
        position = motion.stays("MN4-STM-06")
        session.expect(not any(position), "MN4-STM-06", "counters of 0", position)
    motion.run(f"M{steps}", "MN4-CMD-CC-04")
