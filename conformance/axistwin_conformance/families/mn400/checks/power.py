"""What outlives the supply and what does not: programs and the configuration do, all else is as at
power-on (PWR, NVM, CMD-ADDR, CMD-BAUD)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.checks.destructive import FIXED
from axistwin_conformance.families.mn400.checks.stored import judge_listing
from axistwin_conformance.families.mn400.driver import AXES, DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.motion.board_motion import CLOCK_ERROR, BoardMotion
from axistwin_conformance.families.mn400.persistence.address_recovery import (
    brought_back,
    change_rate,
    has_rate,
    is_there,
)
from axistwin_conformance.families.mn400.persistence.programs import (
    PROFILE,
    emptied_afterwards,
    enter_configuration,
    enter_program,
    listing,
    relative_mode,
)
from axistwin_conformance.families.mn400.persistence.supply import (
    power_cycle,
    serves_again,
    switch_on,
)
from axistwin_conformance.families.mn400.probes.destructive import POWER
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 260  # of this module in a run; see `Family.modules`

STORED: Final = ("stored", "rig")
MOVED: Final = ("motion", "rig")
UNREACHABLE: Final = ("rig", "destructive")
ALONE: Final = ("alone", *POWER)
PROGRAM: Final = ("V500", "X2", "I0")
OTHER_PROGRAM: Final = ("Y500",)
FAST: Final = 4  # of ~: 115200 baud
STEPS: Final = 6
FIRST_SPEED: Final = 100  # steps/s
MOTION: Final = ("L0,0,0,0", PROFILE, f"V{FIRST_SPEED}")
TURNING: Final = (STEPS, STEPS, -STEPS, STEPS)  # a move, axis 3 of which goes back
LASH: Final = 80  # steps
UP_S: Final = 1.0  # by which a board should hear
SETTLE_S: Final = 0.3  # a move of 6 steps takes 0.06 s, one behind a compensation 0.4 s
SLOW_SPEED: Final = 20  # steps/s: those 6 steps take 0.3 s
AT_REST: Final = (0, 0, 0, 0)
# A configuration with bad lines between these two, and the counters behind the first.
FIRST_LINE: Final = "L1,2,3,4"
LAST_LINE: Final = "V500"
LOADED: Final = (1, 2, 3, 4)


# --- what is kept ---------------------------------------------------------------------------------


@check("MN4-NVM-03", safety=STORED, needs=POWER)
def a_program_outlives_the_supply(session: Session) -> None:
    """R lists after a power cycle what it did before."""
    driver = BoardDriver(session)
    for lines in (PROGRAM, ()):
        enter_program(driver, lines)
        power_cycle(driver)
        judge_listing(driver, lines, ("MN4-NVM-03",), "after a power cycle")


@check("MN4-NVM-03", safety=STORED, needs=POWER)
def a_program_that_is_cut_off_is_kept_line_by_line_or_not_at_all(session: Session) -> None:
    """A power cut in an entry leaves the program before, or the lines so far (MN4-AMB-70)."""
    driver = BoardDriver(session)
    enter_program(driver, PROGRAM)
    driver.command("Z")
    for line in OTHER_PROGRAM:
        driver.command(line)
    power_cycle(driver)
    seen = listing(driver.client)
    commits = {PROGRAM: "at_end", OTHER_PROGRAM: "per_line"}
    told = [", ".join(lines) for lines in commits]
    session.expect(seen in commits, "MN4-NVM-03", told, ", ".join(seen or ("nothing",)))
    assert seen is not None
    driver.follows("nvm_commit", commits[seen], "MN4-NVM-03")


# --- what is not ----------------------------------------------------------------------------------


@check("MN4-PWR-02", "MN4-RSP-14", safety="rig", needs=POWER)
@restoring("LVH;")
def states_and_flags_are_those_of_power_on(session: Session) -> None:
    """After a power cycle no hold, no contour entry, no steps left, exit code 0; counters and feed
    hold as this board has them; and nothing was said."""
    driver = BoardDriver(session)
    has_feed_hold = driver.reading("has_feedhold_cmds") == "true"
    driver.command("L5,6,7,8")
    driver.position()
    if has_feed_hold:
        usual = int(driver.reading("feedhold_power_on"))
        driver.command(f";{1 - usual}")
    if driver.reading("hold_takes_arg") == "true":
        driver.command("H1")
    driver.command("(")
    switch_on(driver)
    if session.target.is_virtual:  # a supply that is switched may put noise on a real line
        came = driver.client.listen(session.reply_timeout_s)
        session.expect(not came, "MN4-RSP-14", "nothing at power-up", came.hex(" ").upper())
    else:
        session.not_run("MN4-RSP-14", "switching the supply may put noise on the line")
    session.step(serves_again(driver), "a board that answers after power-up", "it does not")
    driver.draws("*", PRESENT, "MN4-PWR-02")
    position = driver.position()
    wanted = (int(driver.reading("power_on_position")),) * AXES
    session.expect(position == wanted, "MN4-PWR-02", wanted, position)
    left, code = driver.steps_left(), driver.exit_code()
    session.expect((left, code) == (AT_REST, 0), "MN4-PWR-02", "0 steps, code 0", (left, code))
    if has_feed_hold:
        flags = driver.flags()
        session.expect(flags["FeedHold"] == usual, "MN4-PWR-02", f"feed hold {usual}", flags)
        others = [flags[name] for name in ("PauseFlag", "PauseState", "AbortFlag")]
        session.expect(not any(others), "MN4-PWR-02", "no flag", flags)


@check("MN4-PWR-02", safety="rig", needs=POWER)
@restoring("L")
def what_was_said_last_does_not_outlive_the_supply(session: Session) -> None:
    """& behind a power cycle does not repeat the counters that E told before it."""
    driver = BoardDriver(session)
    driver.command("L5,6,7,8")
    driver.position()
    switch_on(driver)
    session.target.wait(UP_S)
    again = driver.ask("&")
    told = again.value.fields if again.value is not None else None
    session.step(serves_again(driver), "a board that answers after power-up", "it does not")
    session.expect(told != (5, 6, 7, 8), "MN4-PWR-02", "not the counters of before", told)


@check("MN4-PWR-01", "MN4-PWR-03", safety=MOVED, needs=POWER)
@restoring("VFBDPXIL")
def axes_are_those_of_power_on(session: Session) -> None:
    """After a power cycle backlash, directions, plane and multiplex are what they are at power-on,
    whatever was set before."""
    driver = BoardDriver(session)
    plane = BoardMotion(driver).plane(2, 4, 1)
    for text in ("B32,32,32,32", "D-1,-1,-1,-1", plane, "X4"):
        driver.command(text)
    power_cycle(driver)
    for text in MOTION:
        driver.command(text)
    _judge_defaults(driver, ("MN4-PWR-01", "MN4-PWR-03"))
    _judge_multiplex(driver, ("MN4-PWR-01", "MN4-PWR-03"))
    if session.transport.travel_guard is None:  # it would not know how far the axes have gone
        _judge_directions(driver, ("MN4-PWR-01", "MN4-PWR-03"))


def _judge_directions(driver: BoardDriver, names: tuple[str, ...]) -> None:
    """Judge by the backlash that a first move takes up which way axes remember: that of axis 3,
    which is less than that of the others."""
    driver.command("D-1,-1,-1,-1")
    power_cycle(driver)
    move = ",".join(map(str, TURNING))
    for text in (*MOTION, relative_mode(driver), f"B200,200,{LASH},200", f"M{move}"):
        driver.command(text)
    driver.target.wait(SETTLE_S)
    counted = LASH * (driver.reading("backlash_counts") == "true")
    wanted = (STEPS, STEPS, -STEPS - counted, STEPS)
    if driver.reading("backlash_speed") == "v":
        position = driver.position()
        told = f"not yet {wanted}: axis 3 takes up {LASH} steps"
        driver.session.expect(position != wanted, names, told, position, f"behind M{move}")
    driver.target.wait(1.5 * LASH / FIRST_SPEED - SETTLE_S)
    position = driver.position()
    told = f"behind M{move} and {LASH} steps of backlash"
    driver.session.expect(position == wanted, names, wanted, position, told)
    driver.command(f"B0,0,{LASH},0")  # so that no axis is elsewhere at the end
    driver.command(f"M{','.join(str(-by) for by in TURNING)}")
    driver.target.wait(1.5 * LASH / FIRST_SPEED)


def _judge_multiplex(driver: BoardDriver, names: tuple[str, ...]) -> None:
    """Judge by what E1 counts of a slow move of two axes that the multiplex is 1."""
    driver.command(f"V{SLOW_SPEED}")
    driver.command(f"M{STEPS},{STEPS}")
    exchange = driver.ask("E1")
    most = SLOW_SPEED // 5  # twice what a multiplex of 1 counts
    fields = (exchange.value.fields if exchange.value else None) or (most + 1,)
    is_right = fields[-1] <= most
    driver.session.expect(is_right, names, f"a count of at most {most}", exchange.observed)
    driver.target.wait(STEPS / SLOW_SPEED)
    driver.command(f"M-{STEPS},-{STEPS}")
    driver.target.wait(STEPS / SLOW_SPEED + SETTLE_S)


@check("MN4-PWR-02", "MN4-PWR-03", safety=MOVED, needs=POWER)
@restoring("VFHIL")
def speed_and_profile_are_those_of_power_on(session: Session) -> None:
    """After a power cycle a short move is as fast as by the settings of power-on, and not held."""
    driver = BoardDriver(session)
    hold = ("H1",) if driver.reading("hold_takes_arg") == "true" else ()
    for text in ("F2,2,1", "V2", *hold):
        driver.command(text)
    power_cycle(driver)
    driver.command("L0,0,0,0")
    _judge_defaults(driver, ("MN4-PWR-02", "MN4-PWR-03"))


def _judge_defaults(driver: BoardDriver, names: tuple[str, ...]) -> None:
    """Judge by a few short motions from 0 that settings are those of power-on."""
    driver.command(relative_mode(driver))
    # At 2 steps/s, or behind a compensation, these moves would last for longer.
    for text, wanted in (
        (f"M{STEPS}", (STEPS, 0, 0, 0)),
        (f"M-{STEPS},{STEPS}", (0, STEPS, 0, 0)),
        (f"M,-{STEPS}", AT_REST),
        # A quarter of a circle: X is axis 1 and Y is axis 3 (MN4-CMD-A-01).
        (f"A-{STEPS},0,-{STEPS},-{STEPS},1", (-STEPS, 0, -STEPS, 0)),
        (f"M{STEPS},,{STEPS}", AT_REST),
    ):
        driver.command(text)
        driver.target.wait(SETTLE_S)
        position = driver.position()
        told = f"{SETTLE_S} s after {text}"
        driver.session.expect(position == wanted, names, wanted, position, told)


@check("MN4-CMD-ADDR-03", "MN4-CMD-BAUD-03", "MN4-PWR-01", "MN4-PWR-03", "MN4-PHY-01",
       safety=UNREACHABLE, needs=ALONE)  # fmt: skip
def id_and_rate_are_those_of_power_on(session: Session) -> None:
    """With an empty configuration a board that was given another id and rate is back at id 1 and
    9600 baud after a power cycle."""
    driver = BoardDriver(session)
    new = 9 if driver.board != 9 else 10
    with emptied_afterwards(driver), brought_back(driver, new, codec.IDS[0]):
        enter_configuration(driver, ())
        if driver.reading("address_settable") == "true":
            driver.ask(f"={new}")
            driver = BoardDriver(session, new)
        if has_rate(driver):
            change_rate(driver, FAST)
        session.step(driver.is_present(), f"an answer at id {driver.board}", "none")
        _to_rate(driver, codec.RATES[0])
        switch_on(driver)
        names = ("MN4-CMD-ADDR-03", "MN4-CMD-BAUD-03", "MN4-PWR-01", "MN4-PWR-03", "MN4-PHY-01")
        told = f"id {codec.IDS[0]} at {codec.RATES[0]} baud after power-up"
        is_back = serves_again(BoardDriver(session, codec.IDS[0]))
        session.expect(is_back, names, told, "no answer there")


def _to_rate(driver: BoardDriver, rate: int) -> None:
    """Set our end of the line, if that has a rate."""
    if has_rate(driver) and driver.target.baud != rate:
        driver.target.baud = rate


# --- the configuration ----------------------------------------------------------------------------


@check("MN4-NVM-05", "MN4-NVM-07", "MN4-DROP-11", "MN4-PWR-01", safety=UNREACHABLE, needs=ALONE)
def a_configuration_runs_at_every_power_up(session: Session) -> None:
    """= and ~ in it act at each power-up, and draw there what they draw otherwise: START from the
    old id, DONE from the new one, START at the old rate, BAUDCHANGEOK at the new one."""
    driver = BoardDriver(session)
    if driver.reading("address_settable") == "false":
        session.skip(FIXED)
    new = 5
    with emptied_afterwards(driver), brought_back(driver, new, codec.IDS[0]):
        rate = FAST if has_rate(driver) else 0
        enter_configuration(driver, (f"={new}", "X2", f"~{rate}"))
        session.step(driver.is_present(), f"an answer at id {driver.board}", "none")
        for _ in range(2):
            _judge_power_up(driver, new, rate)


def _judge_power_up(driver: BoardDriver, new: int, number: int) -> None:
    """Judge what is said at power-up, and where the board is then."""
    session, client = driver.session, driver.client
    after, first = BoardDriver(session, new), codec.IDS[0]
    _to_rate(driver, codec.RATES[0])
    switch_on(driver)
    before = [codec.status(first, "=", 3), codec.status(new, "=", 5), codec.status(new, "X", 3),
              codec.status(new, "X", 5), codec.status(new, "~", 3)]  # fmt: skip
    found = []
    for _ in before:
        packet, _ = client.receive_packet(session.reply_timeout_s)
        found.append(b"" if packet is None else packet.raw)
    _to_rate(driver, codec.RATES[number])
    rest = client.listen(session.reply_timeout_s)
    has_null, has_more = (
        driver.reading(switch) == reading
        for switch, reading in (("outcome_null", "true"), ("baud_reply", "plus_done"))
    )
    last = codec.status(new, "~", 0x12, null=has_null)
    last += codec.status(new, "~", 0x05) if has_more else b""
    names = ("MN4-NVM-07", "MN4-DROP-11")
    if session.target.is_lossless:
        told, came = words.explain_reply(b"".join(before)), words.explain_reply(b"".join(found))
        session.expect(found == before, names, told, came or "nothing", "at power-up")
        told, came = words.explain_reply(last), words.explain_reply(rest) or "nothing"
        session.expect(rest == last, names, f"{told} at the new rate", came, "at power-up")
    else:
        session.not_run("MN4-NVM-07", "switching the supply may put noise on the line")
    is_there_now = is_there(after, new)
    session.expect(is_there_now, ("MN4-NVM-05", "MN4-PWR-01"), f"an answer at id {new}", "none")


@check("MN4-NVM-07", "MN4-NVM-05", "MN4-ERR-02", safety=UNREACHABLE, needs=ALONE)
def a_bad_line_of_a_configuration_is_answered(session: Session) -> None:
    """What is no command draws at power-up the error that it draws otherwise, and does nothing.
    Whether the line behind it is carried out is told (MN4-AMB-54)."""
    driver = BoardDriver(session)
    with emptied_afterwards(driver), brought_back(driver, codec.IDS[0]):
        replies = _enter_bad_lines(driver)
        _to_rate(driver, codec.RATES[0])
        switch_on(driver)
        at_power_on = BoardDriver(session, codec.IDS[0])
        raw = at_power_on.client.listen(UP_S + session.reply_timeout_s)
        if session.target.is_lossless:
            _judge_bad_lines(at_power_on, raw, replies)
        else:
            session.not_run("MN4-NVM-07", "switching the supply may put noise on the line")
        session.step(serves_again(at_power_on), "a board that answers after power-up", "none")
        position = at_power_on.position()
        session.expect(position == LOADED, ("MN4-ERR-02", "MN4-NVM-05"), LOADED, position)


def _enter_bad_lines(driver: BoardDriver) -> list[tuple[str, tuple[tuple[str, ...], ...]]]:
    """Store a configuration with lines that are no commands; of each line that was taken its
    letter, and what it may draw at power-up."""
    is_unknown = driver.errors("INVALIDCOMMAND", is_recognised=False)
    unknown = (is_unknown, driver.errors("INVALIDPROGCOMM"), driver.errors("INVALIDCOMMAND"))
    wrong = (driver.errors("PARA_ERROR"),)
    lines = (
        (FIRST_LINE, (DONE,)),
        ("X3", wrong),
        ("L9,x", wrong),
        ("W", unknown),
        (LAST_LINE, (DONE,)),
    )
    driver.command(".")
    try:
        # Where a board finds out when a line is entered, it refuses it there.
        return [(text[0], codes) for text, codes in lines if driver.ask(text).says(*DONE)]
    finally:
        driver.ask("Q")


def _judge_bad_lines(
    driver: BoardDriver, raw: bytes, replies: Sequence[tuple[str, Sequence[tuple[str, ...]]]]
) -> None:
    """Judge what was said at power-up, up to the first bad line, and further if it goes on."""
    found, strays = codec.packets(raw)
    wanted = " and ".join(f"{letter}: {', '.join(codes[0])}" for letter, codes in replies)
    came = words.explain_reply(raw) or "nothing"
    last, is_over = replies[-1], False
    for letter, codes in replies[:-1]:
        if is_over and not found:
            break  # the bad line has ended the configuration
        drawn = next((one for one in codes if _begins(found, letter, one)), None)
        is_right = drawn is not None and not strays
        driver.session.expect(is_right, "MN4-NVM-07", wanted, came, f"to {letter} at power-up")
        found, is_over = found[len(drawn or ()) :], DONE not in codes
    told = f"{wanted}: the line behind the bad ones carried out (MN4-AMB-54)"
    driver.tells(_begins(found, last[0], DONE), "MN4-NVM-05", told, came)


def _begins(found: Sequence[codec.BoardPacket], letter: str, codes: Sequence[str]) -> bool:
    """True if the first of these packets are the answer to a command, and say that."""
    first = found[: len(codes)]
    return codec.codes_of(first) == tuple(codes) and {one.command for one in first} == {letter}


@check("MN4-NVM-06", "MN4-NVM-05", safety=("motion", *UNREACHABLE), needs=ALONE)
def a_configuration_may_move(session: Session) -> None:
    """A move in the configuration is made at power-up, each time, and not before."""
    driver = BoardDriver(session)
    relative = relative_mode(driver)
    lines = (*MOTION, f"V{SLOW_SPEED}", relative, f"M{STEPS}", f"M,{STEPS}")
    names = ("MN4-NVM-06", "MN4-NVM-05")
    with emptied_afterwards(driver), brought_back(driver, codec.IDS[0]):
        enter_configuration(driver, lines)
        for _ in range(2):
            before_ns = switch_on(driver)
            at_power_on = BoardDriver(session, codec.IDS[0])
            session.step(serves_again(at_power_on), "a board that answers after power-up", "none")
            position = at_power_on.position()
            seconds = (driver.target.now_ns - before_ns) / 1e9
            most = SLOW_SPEED * seconds * (1 + CLOCK_ERROR) + 2
            told, when = f"at most {most:.1f} steps", f"{seconds:.2f} s after power-up"
            session.expect(sum(position) <= most, names, told, position, when)
            driver.target.wait(2 * STEPS / SLOW_SPEED + SETTLE_S)
            position = at_power_on.position()
            wanted = (STEPS, STEPS, 0, 0)
            session.expect(position == wanted, names, wanted, position)
            for text in (*MOTION[1:], relative):
                at_power_on.command(text)
            at_power_on.command(f"M-{STEPS},-{STEPS}")
            driver.target.wait(SETTLE_S)


@check("MN4-NVM-11", "MN4-NVM-03", safety=("stored", *UNREACHABLE), needs=ALONE)
def each_program_leaves_the_other_as_it_is(session: Session) -> None:
    """A new program changes nothing of what is done at power-up, and a configuration nothing of
    what R lists."""
    driver = BoardDriver(session)
    with emptied_afterwards(driver), brought_back(driver, codec.IDS[0]):
        enter_program(driver, PROGRAM)
        enter_configuration(driver, ("L1,2,3,4",))
        for lines in (PROGRAM, OTHER_PROGRAM, ()):
            enter_program(driver, lines)
            switch_on(driver)
            at_power_on = BoardDriver(session, codec.IDS[0])
            session.step(serves_again(at_power_on), "a board that answers after power-up", "none")
            _judge_both(at_power_on, lines)


def _judge_both(driver: BoardDriver, program: Sequence[str]) -> None:
    position = driver.position()
    driver.session.expect(position == (1, 2, 3, 4), "MN4-NVM-11", "1, 2, 3, 4", position)
    judge_listing(driver, program, ("MN4-NVM-11", "MN4-NVM-03"), "after a power cycle")
