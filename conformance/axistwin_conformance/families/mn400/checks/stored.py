"""The stored program: what is entered, what R lists of it, and what U makes of it (NVM, STM, CMD).

The program that was there before is put back by the snapshot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.core.wording import REQUEST, Observation
from axistwin_conformance.families.mn400.checks.queue import needs_flags
from axistwin_conformance.families.mn400.driver import DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.motion.return_to_start import wait_for_rest
from axistwin_conformance.families.mn400.persistence.programs import (
    PROFILE,
    end_program,
    enter_program,
    fill_store,
    listing,
    program_entry,
    relative_mode,
)
from axistwin_conformance.families.mn400.probes.stored import RUNNING, STORED
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 250  # of this module in a run; see `Family.modules`

# Lines that would show if they were carried out, and those that end other entries or say something.
LINES: Final = ("V1500", "x4", "L5,-6,7,8", "E", "Q", "*", "s", "?", "(", "V1")
OTHER_LINES: Final = ("X2", "Y500")
STEPS: Final = 10
SLOW_SPEED, FAST_SPEED = 20, 200  # steps/s, both below the start speed: no ramps
THERE_AND_BACK: Final = (f"V{SLOW_SPEED}", f"m{STEPS}", f"v{FAST_SPEED}", f"M-{STEPS}")
LAST_SPEED: Final = f"V{SLOW_SPEED}"
ONE_BY_ONE: Final = (f"V{SLOW_SPEED}", f"M{STEPS}", f"M,{STEPS}")
# Lines that lead axes 1, 2 and 4 there and back but for a few steps, in the plane of power-on.
MOTIONS: Final = (
    "M6,,,8", "(", "M4", "m3,5", ")", "A-2,0,-4,0,1", "+-2,0,-4,0,1,3,0",
)  # fmt: skip
MOTIONS_END: Final = (5, 8, 0, 8)
MANY_LINES: Final = 260  # more than a byte counts
MOVE_S: Final = STEPS / SLOW_SPEED
LATE_S: Final = 0.2  # what a board may take for a line of a program
AT_REST: Final = (0, 0, 0, 0)
BAD_LINE: Final = "M5,6x"
LAST_LINE: Final = f"M,{STEPS}"
LOAD: Final = "L7,7,7,7"


# --- what is entered ------------------------------------------------------------------------------


@check("MN4-NVM-01", "MN4-NVM-02", "MN4-STM-04", "MN4-STM-05", "MN4-CMD-Q-04",
       "MN4-CMD-RTX-01", safety=STORED)  # fmt: skip
@restoring("VXL")
def a_program_is_kept_and_not_carried_out(session: Session) -> None:
    """Whatever is sent behind Z draws START and DONE, does nothing, and is listed by R as sent; &
    repeats the last packet of that."""
    driver = BoardDriver(session)
    driver.command("L1,2,3,4")
    with program_entry(driver):
        for line in LINES:
            # A Q that has ended the entry shows by what follows it.
            names = ("MN4-STM-04", *(("MN4-CMD-Q-04",) if line in ("Q", "*") else ()))
            driver.draws(line, DONE, names)
        driver.judge(end_program(driver), DONE, "MN4-NVM-01")
    driver.draws("*", PRESENT, "MN4-NVM-01")
    position = driver.position()
    session.expect(position == (1, 2, 3, 4), "MN4-NVM-01", "1, 2, 3, 4", position)
    judge_listing(driver, LINES, ("MN4-NVM-02", "MN4-STM-04"))
    driver.repeats(driver.ask("R"), "MN4-CMD-RTX-01")


def judge_listing(
    driver: BoardDriver, lines: Sequence[str], names: tuple[str, ...], context: str = ""
) -> None:
    """Judge that R lists these lines, in one case or the other; that it keeps the case is told."""
    session, exchange = driver.session, driver.ask("R")
    seen = listing(driver.client, exchange)
    session.step(seen is not None, "a listing by R", exchange.observed)
    assert seen is not None
    in_capitals = [line.upper() for line in seen]
    wanted = [line.upper() for line in lines]
    surplus = [line for line in in_capitals if line not in wanted]
    text = Observation(
        f"{REQUEST} listed {', '.join(seen) or 'nothing'}",
        value=", ".join(seen) or "nothing",
        wanted=f"{', '.join(lines) or 'nothing'} and no other line",
        causes=tuple(f"{line} (" for line in surplus),
        is_whole=False,
    )
    session.expect(in_capitals == wanted, names, list(lines), text, context)
    if session.check is not None and "MN4-STM-05" in session.check.declared:
        driver.tells(list(seen) == list(lines), "MN4-STM-05", "lines as sent", ", ".join(seen))
    count = sum(packet.code is None and packet.value != "" for packet in exchange.found)
    if len(lines) > 1 and "MN4-NVM-02" in names:
        framing = "packet_per_line" if count == len(lines) else "single"
        session.expect(count in (1, len(lines)), "MN4-NVM-02", "a packet for each line", count)
        driver.follows("readprogram_framing", framing, "MN4-NVM-02")


@check("MN4-NVM-03", "MN4-NVM-02", "MN4-CMD-U-02", safety=RUNNING)
@restoring("L")
def a_new_program_takes_the_place_of_the_old_one(session: Session) -> None:
    """R lists the last one alone; an empty one lists nothing, and U then does nothing."""
    driver = BoardDriver(session)
    enter_program(driver, LINES)
    enter_program(driver, OTHER_LINES)
    judge_listing(driver, OTHER_LINES, ("MN4-NVM-03", "MN4-NVM-02"))
    enter_program(driver, ())
    judge_listing(driver, (), ("MN4-NVM-03",))
    driver.command("L5,6,7,8")
    exchange = driver.ask("U")
    driver.tells(exchange.says(*DONE), "MN4-CMD-U-02", "START and DONE", exchange)
    position = driver.position()
    session.expect(position == (5, 6, 7, 8), "MN4-CMD-U-02", "5, 6, 7, 8", position)


@check("MN4-STM-04", "MN4-NVM-02", "MN4-PKT-05", "MN4-ERR-01", safety=STORED)
def what_is_no_line_is_not_stored(session: Session) -> None:
    """Unknown commands and Z are refused when entered or when run; a line with a wrong sum is
    refused, and none of them is listed that was."""
    driver = BoardDriver(session)
    is_refused_at_once = driver.reading("prog_check") == "entry"
    kept = ["V500"]
    with program_entry(driver):
        driver.command("V500")
        for text in ("W", "Z"):
            exchange = driver.ask(text)
            at_once = exchange.says(*driver.errors("INVALIDPROGCOMM"))
            session.expect(
                at_once or exchange.says(*DONE), "MN4-ERR-01", "INVALIDPROGCOMM or DONE", exchange
            )
            driver.follows("prog_check", "entry" if at_once else "run", "MN4-STM-04")
            kept += [] if is_refused_at_once else [text]
        driver.ignores("V700")
        driver.command("X1")
        session.step(end_program(driver).says(*DONE), "START and DONE to Ctrl-D", "none")
    judge_listing(driver, (*kept, "X1"), ("MN4-STM-04", "MN4-PKT-05"))
    session.expect(True, "MN4-NVM-02", "", "")


@check("MN4-STM-04", safety=STORED)
def a_repeat_in_an_entry_is_served_or_stored(session: Session) -> None:
    """& between Z and Ctrl-D repeats the last message, or is a line like any other."""
    driver = BoardDriver(session)
    with program_entry(driver):
        driver.command("V500")
        exchange = driver.ask("&")
        is_stored = exchange.says(*DONE)
        session.step(
            is_stored or exchange.says("DONE"), "DONE, with START or without", exchange.observed
        )
        driver.follows("retransmit_in_entry", "store" if is_stored else "retransmit", "MN4-STM-04")
        session.step(end_program(driver).says(*DONE), "START and DONE to Ctrl-D", "none")
    judge_listing(driver, ("V500", "&") if is_stored else ("V500",), ("MN4-STM-04",))


@check("MN4-NVM-09", "MN4-NVM-08", "MN4-NVM-02", "MN4-NVM-01", "MN4-STM-04",
       safety=STORED, level="full")  # fmt: skip
def what_does_not_fit_is_refused(session: Session) -> None:
    """Lines are taken until MEMORY_FULL, which ends no entry; all that were answered with DONE are
    listed, and no more than the memory holds."""
    driver = BoardDriver(session)
    size = int(driver.reading("nvm_size"))
    enter_program(driver, ())
    with program_entry(driver):
        filled = fill_store(driver, most_bytes=size)
        exchange = filled.refusal
        is_told = exchange is not None and exchange.says(*driver.errors("MEMORY_FULL"))
        came = exchange or f"DONE to {len(filled.lines)} lines"
        driver.tells(is_told, "MN4-NVM-09", "MEMORY_FULL", came)
        if filled.poll is not None:
            told = "no answer to a poll before Ctrl-D"
            names = ("MN4-NVM-01", "MN4-STM-04")
            session.expect(not filled.is_over, names, told, filled.poll, "behind a refused line")
        is_ended = filled.is_over or end_program(driver).says(*DONE)
        session.step(is_ended, "START and DONE to Ctrl-D", "none")
    judge_listing(driver, filled.lines, ("MN4-NVM-09", "MN4-NVM-02"))
    told = f"at most {size} bytes"
    session.expect(filled.text_bytes <= size, "MN4-NVM-08", told, filled.text_bytes)


# --- what runs ------------------------------------------------------------------------------------


@check("MN4-CMD-U-01", "MN4-NVM-10", "MN4-NVM-01", safety=RUNNING)
@restoring("IVFL")
def a_program_runs_line_by_line(session: Session) -> None:
    """U draws START and DONE at once; a V in the program is that of the moves behind it, and of
    those behind the program.  Each U begins with the first line, and the end is no abort."""
    driver = BoardDriver(session)
    if driver.reading("program_replies") == "true":
        session.skip("the replies of a running program fall into the reading of positions")
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    first, *others = THERE_AND_BACK
    enter_program(driver, (first, relative_mode(driver), *others, LAST_SPEED))
    driver.target.wait(MOVE_S)
    position = driver.position()
    session.expect(position == AT_REST, "MN4-NVM-01", "no motion", position)
    exchange = driver.draws("U", DONE, "MN4-CMD-U-01")
    _judge_at(driver, exchange.asked_ns, MOVE_S / 2, range(STEPS // 2 - 3, STEPS // 2 + 3))
    _judge_at(driver, exchange.asked_ns, MOVE_S + STEPS / FAST_SPEED + LATE_S, range(1))
    driver.target.wait(MOVE_S)
    position = driver.position()
    session.expect(position == AT_REST, "MN4-CMD-U-01", AT_REST, position, "at the end")
    if driver.reading("has_feedhold_cmds") == "true":
        flags = driver.flags()
        session.expect(not flags["AbortFlag"], "MN4-CMD-U-01", "no AbortFlag", flags, "at the end")
    exchange = driver.command(f"M{STEPS}")
    _judge_at(driver, exchange.asked_ns, MOVE_S / 2, range(STEPS // 2 - 3, STEPS // 2 + 3))
    driver.target.wait(MOVE_S)
    position = driver.position()
    driver.command(f"V{FAST_SPEED}")  # the first line takes that back
    exchange = driver.draws("U", DONE, "MN4-CMD-U-01")
    wanted = range(STEPS + STEPS // 2 - 3, STEPS + STEPS // 2 + 3)
    _judge_at(driver, exchange.asked_ns, MOVE_S / 2, wanted)
    driver.target.wait(2 * MOVE_S)
    end = driver.position()
    session.expect(end == position, "MN4-CMD-U-01", position, end, "behind a second U")


def _judge_at(driver: BoardDriver, begun_ns: int, after_s: float, wanted: range) -> None:
    """Judge where the first axis is so long after the program was started."""
    session, target = driver.session, driver.target
    target.wait(max(0.0, after_s - (target.now_ns - begun_ns) / 1e9))
    steps = driver.position()[0]
    late_s = (target.now_ns - begun_ns) / 1e9 - after_s
    if late_s > LATE_S:
        session.inconclusive("MN4-NVM-10", f"E was answered {late_s:.2f} s late")
    told = f"{wanted[0]} to {wanted[-1]} steps"
    session.expect(
        steps in wanted, ("MN4-NVM-10", "MN4-CMD-U-01"), told, steps, f"{after_s:.2f} s after U"
    )


@check("MN4-ERR-02", "MN4-NVM-02", "MN4-CMD-U-01", safety=RUNNING)
@restoring("IVFL")
def a_bad_line_of_a_program_does_nothing(session: Session) -> None:
    """A move with a letter in a number is stored as sent, or refused at once; no axis moves by it
    when the program comes to it.  Whether the program ends there is told (MN4-AMB-54)."""
    driver = BoardDriver(session)
    if driver.reading("program_replies") == "true":
        session.skip("the replies of a running program fall into the reading of positions")
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    lines = [relative_mode(driver), f"V{FAST_SPEED}", f"M{STEPS}"]
    with program_entry(driver):
        for line in lines:
            driver.command(line)
        exchange = driver.ask(BAD_LINE)
        is_stored = exchange.says(*DONE)
        refused = [driver.errors(code) for code in ("PARA_ERROR", "INVALIDPROGCOMM")]
        is_right = is_stored or exchange.codes in refused
        session.step(is_right, "START and DONE, or a refusal", exchange.observed)
        driver.command(LAST_LINE)
        session.step(end_program(driver).says(*DONE), "START and DONE to Ctrl-D", "none")
    judge_listing(driver, (*lines, *[BAD_LINE] * is_stored, LAST_LINE), ("MN4-NVM-02",))
    driver.draws("U", DONE, "MN4-CMD-U-01")
    driver.target.wait(2 * STEPS / FAST_SPEED + 5 * LATE_S)
    position = driver.position()
    whole, ended = (STEPS, STEPS, 0, 0), (STEPS, 0, 0, 0)
    told = f"{ended} or {whole}, whatever stands in {BAD_LINE}"
    session.expect(position in (ended, whole), "MN4-ERR-02", told, position, "behind the program")
    if is_stored:
        told = f"the program at its end with {BAD_LINE} (MN4-AMB-54)"
        driver.tells(position == ended, "MN4-CMD-U-01", told, position)
    else:
        session.expect(position == whole, "MN4-CMD-U-01", whole, position, "behind the program")


@check("MN4-NVM-13", "MN4-RSP-14", safety=RUNNING)
@restoring("IVFL")
def a_running_program_says_nothing(session: Session) -> None:
    """Behind START and DONE of U the line is quiet, or every line is answered (MN4-AMB-53)."""
    driver = BoardDriver(session)
    enter_program(driver, ("V500", "E", "X1"))
    driver.command("U")
    came = driver.client.listen(MOVE_S + session.reply_timeout_s)
    seen = "true" if came else "false"
    driver.follows("program_replies", seen, "MN4-NVM-13")
    if driver.reading("program_replies") == "false":
        session.expect(not came, "MN4-RSP-14", "nothing", came.hex(" ").upper())


@check("MN4-NVM-10", "MN4-CMD-U-01", "MN4-CC-01", safety=RUNNING)
@restoring("IVFLP")
def a_program_may_hold_every_motion(session: Session) -> None:
    """A move, a contour, an arc and a helix: the counters are those at the end of
    all of them, one behind the other."""
    driver = BoardDriver(session)
    if driver.reading("program_replies") == "true":
        session.skip("the replies of a running program fall into the reading of positions")
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    base = int(driver.reading("plane_base"))
    plane = f"P{base},{base + 2},{base + 1}"  # that of power-on
    enter_program(driver, (relative_mode(driver), f"V{FAST_SPEED}", plane, *MOTIONS))
    driver.draws("U", DONE, ("MN4-CMD-U-01", "MN4-NVM-10"))
    driver.target.wait(MOVE_S + len(MOTIONS) * LATE_S)
    position, names = driver.position(), ("MN4-CMD-U-01", "MN4-NVM-10", "MN4-CC-01")
    session.expect(position == MOTIONS_END, names, MOTIONS_END, position, "behind the program")


@check("MN4-CMD-U-01", safety=RUNNING, level="full")
@restoring("IVFL")
def a_program_of_many_lines_runs_to_its_end(session: Session) -> None:
    """Each line moves an axis by a step."""
    driver = BoardDriver(session)
    if driver.reading("program_replies") == "true":
        session.skip("the replies to its lines would be what takes the time (MN4-AMB-53)")
    for text in ("L0,0,0,0", PROFILE, f"V{FAST_SPEED}"):
        driver.command(text)
    enter_program(driver, (relative_mode(driver), *["M1", "M,-1"] * (MANY_LINES // 2)))
    driver.draws("U", DONE, "MN4-CMD-U-01")
    driver.target.wait(MANY_LINES / FAST_SPEED + LATE_S)
    position, wanted = wait_for_rest(driver), (MANY_LINES // 2, -MANY_LINES // 2, 0, 0)
    session.expect(position == wanted, "MN4-CMD-U-01", wanted, position, "behind the program")


@check("MN4-CMD-Q-05", "MN4-CMD-U-01", "MN4-NVM-02", safety=RUNNING)
@restoring("IVFL")
def quit_ends_a_running_program(session: Session) -> None:
    """Q during the first move: the axis stands, and the second move never comes; R lists all of it
    still, and U begins with the first line again."""
    driver = BoardDriver(session)
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    enter_program(driver, (relative_mode(driver), *ONE_BY_ONE))
    driver.draws("U", DONE, "MN4-CMD-U-01")
    driver.target.wait(MOVE_S / 2)
    driver.draws("Q", DONE, "MN4-CMD-Q-05")
    first = driver.position()
    driver.target.wait(3 * MOVE_S)
    last = driver.position()
    session.expect(first == last, "MN4-CMD-Q-05", first, last, f"{3 * MOVE_S} s after Q")
    is_cut = 0 < last[0] < STEPS and last[1:] == AT_REST[1:]
    session.expect(is_cut, "MN4-CMD-Q-05", f"less than {STEPS} steps of axis 1 alone", last)
    judge_listing(driver, (relative_mode(driver), *ONE_BY_ONE), ("MN4-NVM-02",))
    driver.draws("U", DONE, "MN4-CMD-U-01")
    driver.target.wait(2 * MOVE_S + 2 * LATE_S)
    end, wanted = driver.position(), (last[0] + STEPS, STEPS, 0, 0)
    session.expect(end == wanted, "MN4-CMD-U-01", wanted, end, "behind a second U")


@check("MN4-CMD-PAU-03", safety=RUNNING)
@restoring("IVFL")
def a_running_program_can_be_paused(session: Session) -> None:
    """{ during the first move holds the program, } lets it go on to its end, no step lost."""
    driver = BoardDriver(session)
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    enter_program(driver, (relative_mode(driver), *ONE_BY_ONE))
    driver.command("U")
    driver.target.wait(MOVE_S / 2)
    driver.draws("{", DONE, "MN4-CMD-PAU-03")
    driver.target.wait(LATE_S)
    first = driver.position()
    driver.target.wait(3 * MOVE_S)
    last = driver.position()
    session.expect(first == last, "MN4-CMD-PAU-03", first, last, f"{3 * MOVE_S} s after {{")
    session.expect(0 < last[0] < STEPS, "MN4-CMD-PAU-03", f"less than {STEPS} steps", last)
    driver.draws("}", DONE, "MN4-CMD-PAU-03")
    driver.target.wait(2 * MOVE_S + 2 * LATE_S)
    end = driver.position()
    wanted = (STEPS, STEPS, 0, 0)
    session.expect(end == wanted, "MN4-CMD-PAU-03", wanted, end, "after }")


@check("MN4-NVM-12", safety=(*RUNNING, "rig"), needs=("rig:start",))
@restoring("IVFL")
def the_start_switch_runs_the_program(session: Session) -> None:
    """Start on the panel does what U does, or nothing at all (MN4-AMB-56); Jog Res does not."""
    driver = BoardDriver(session)
    for text in ("L0,0,0,0", PROFILE):
        driver.command(text)
    enter_program(driver, (relative_mode(driver), *THERE_AND_BACK))
    if "jog_res" in session.rig.capabilities:
        for is_on in (True, False):
            session.rig.work("jog_res", is_on, number=1)
        driver.target.wait(MOVE_S / 2)
        position = driver.position()
        told = "behind Jog Res 1 on and off"
        session.expect(position == AT_REST, "MN4-NVM-12", AT_REST, position, told)
    begun_ns, done_ns = session.rig.work("start", True)
    session.rig.work("start", False)
    driver.target.wait(MOVE_S / 2)
    steps = driver.position()[0]
    late = round((done_ns - begun_ns) / 1e9 * SLOW_SPEED)
    driver.follows("panel_start", "run_program" if steps else "none", "MN4-NVM-12")
    if driver.reading("panel_start") == "none":
        return
    wanted = range(STEPS // 2 - 3, STEPS // 2 + 3 + late)
    told = f"{wanted[0]} to {wanted[-1]} steps"
    is_right = steps in wanted or late > 0
    session.expect(is_right, "MN4-NVM-12", told, steps, f"{MOVE_S / 2:.2f} s after Start")
    driver.target.wait(MOVE_S)
    position = driver.position()
    session.expect(position == AT_REST, "MN4-NVM-12", AT_REST, position, "at the end")


@check("MN4-SHD-01", "MN4-LIM-03", safety=(*RUNNING, "rig"), needs=("rig:shield", "rig:limit_plus"))
@restoring("IVFL")
def what_ends_a_move_of_a_program_ends_that_too(session: Session) -> None:
    """An open shield without feed hold and a limit, which comes on under way or is on before: no
    line behind the move is carried out."""
    driver = BoardDriver(session)
    needs_flags(session)
    if driver.reading("program_replies") == "true":
        session.skip("the replies of a running program fall into the reading of positions")
    is_halted_whole = driver.reading("limit_halts") == "all" and "limit_halts" in session.readings
    for text in (";0", "L0,0,0,0", PROFILE):
        driver.command(text)
    enter_program(driver, (relative_mode(driver), "V2", f"M{STEPS}", LOAD))
    for name, number, requirement, is_on_before in (
        ("shield", None, "MN4-SHD-01", False),
        ("limit_plus", 1, "MN4-LIM-03", False),
        ("limit_plus", 1, "MN4-LIM-03", True),
    ):
        if number and not is_halted_whole:
            session.not_run(
                requirement, "a limit of this board may halt its axis alone (MN4-AMB-47)"
            )
            return
        if is_on_before:
            session.rig.work(name, True, number=number)
        driver.command("|")
        begun_ns = driver.command("U").asked_ns
        driver.target.wait(MOVE_S)
        if not is_on_before:
            _, done_ns = session.rig.work(name, True, number=number)
            if done_ns - begun_ns > STEPS / 2 * 1e9 - 1e9:
                session.skip("the move was over before the rig had ended it")
        driver.target.wait(STEPS / 2)
        session.rig.work(name, False, number=number)
        position = driver.position()
        is_right = position[1:] == AT_REST[1:]
        told = f"0 of axes 2 to 4: {LOAD} behind that move not carried out"
        noun = name.replace("_", " ")
        when = f"behind a move that the {noun} has ended"
        session.expect(is_right, requirement, told, position, when)
