"""Id, rate and configuration: what can make a board unreachable comes last, with the board alone on
its line, and is put back at once (CMD-ADDR, CMD-BAUD, NVM, DROP)."""

from __future__ import annotations

import itertools
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.checks.stored import judge_listing
from axistwin_conformance.families.mn400.driver import DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.persistence.address_recovery import (
    RateChange,
    brought_back,
    change_rate,
    has_rate,
    is_there,
    other_ids,
)
from axistwin_conformance.families.mn400.persistence.programs import (
    emptied_afterwards,
    end_program,
    enter_configuration,
    enter_program,
    fill_store,
    program_entry,
)
from axistwin_conformance.families.mn400.probes.destructive import ALONE, DESTRUCTIVE
from axistwin_conformance.families.mn400.probes.stored import EVERYTHING

ORDER = 270  # of this module in a run; see `Family.modules`

NEW_IDS: Final = (5, 127, 64, 26)  # 127: address byte FFh
FIXED: Final = "this board has one id for ever"
SOCKET: Final = "a plain socket carries bytes, not a rate"
CONFIGURED: Final = ("X1", "V2000", "B0,0,0,0")  # what power-on has anyway
PROGRAM: Final = ("V500", "X2")
LONG_LINE: Final = "L000000000000000001"  # longer than all of that program


# --- the id ---------------------------------------------------------------------------------------


@check("MN4-CMD-ADDR-01", "MN4-CMD-ADDR-04", "MN4-CMD-RTX-04", "MN4-DROP-11", "MN4-DROP-01",
       "MN4-CMD-POLL-02", safety=DESTRUCTIVE, needs=ALONE)  # fmt: skip
def the_id_can_be_set(session: Session) -> None:
    """= draws START from the old id and DONE from the new one, which & repeats; the old id is
    silent from then on, and id 0 reaches the board, which is the later to answer the greater its id
    is."""
    driver = BoardDriver(session)
    late_ns: dict[int, int] = {}
    with brought_back(driver, *NEW_IDS):
        for new in other_ids(driver, *NEW_IDS):
            _judge_new_id(driver, new, late_ns)
            if driver.reading("address_settable") == "true":
                driver = BoardDriver(session, new)
    rows = sorted(late_ns.items())
    for (board, before_ns), (other, after_ns) in itertools.pairwise(rows):
        told = f"a later reply of id {other} to a poll of all boards than of id {board}"
        came = f"{after_ns / 1e6:.1f} ms and {before_ns / 1e6:.1f} ms"
        session.expect(after_ns > before_ns, "MN4-CMD-POLL-02", told, came)


def _judge_new_id(driver: BoardDriver, new: int, late_ns: dict[int, int]) -> None:
    session, old = driver.session, driver.board
    exchange = driver.ask(f"={new}")
    after = BoardDriver(session, new)
    at_once = after.ask("&") if exchange.found[-1:] and exchange.found[-1].board == new else None
    is_settable = is_there(after, new)
    session.step(is_settable or is_there(driver, old), f"an answer at id {old} or {new}", "none")
    driver.follows("address_settable", "true" if is_settable else "false", "MN4-CMD-ADDR-01")
    if not is_settable:
        return
    wanted = codec.status(old, "=", 0x03) + codec.status(new, "=", 0x05)
    told, came = words.explain_reply(wanted), words.explain_reply(exchange.raw) or "nothing"
    names = ("MN4-CMD-ADDR-01", "MN4-DROP-11")
    session.expect(exchange.raw == wanted, names, told, came, f"to ={new}")
    after.command("Q")
    repeated = codec.status(new, "&", 0x05)
    for again in (at_once, after.ask("&")):
        if again is not None and driver.reading("retransmit_cmd") == "replaced":
            told, came = words.explain_reply(repeated), words.explain_reply(again.raw) or "nothing"
            session.expect(again.raw == repeated, "MN4-CMD-RTX-04", told, came)
    driver.judge(driver.client.seek(), (), "MN4-CMD-ADDR-04")
    exchange = after.client.ask_all("*", after.slots_s())
    after.judge(exchange, PRESENT, ("MN4-CMD-ADDR-04", "MN4-DROP-01"))
    ids = [packet.board for packet in exchange.found]
    session.expect(set(ids) == {new}, "MN4-CMD-ADDR-04", f"id {new}", f"ids {ids}")
    late_ns[new] = exchange.came_ns[0] - exchange.asked_ns


@check("MN4-DROP-08", safety=DESTRUCTIVE, needs=ALONE)
def an_id_for_all_boards_is_obeyed_or_refused(session: Session) -> None:
    """= sent to id 0 gives a lone board its new id, or is refused (MN4-AMB-69)."""
    driver = BoardDriver(session)
    if driver.reading("address_settable") == "false":
        session.skip(FIXED)
    (new, *_) = other_ids(driver, *NEW_IDS)
    with brought_back(driver, new):
        driver.client.ask_all(f"={new}", driver.slots_s())
        is_taken = is_there(driver, new)
        session.step(is_taken or is_there(driver, driver.board), "a board that answers", "none")
        driver.follows("broadcast_setaddr", "accepted" if is_taken else "refused", "MN4-DROP-08")


@check("MN4-DROP-08", "MN4-CMD-ADDR-04", safety=DESTRUCTIVE, needs=("neighbour",))
def an_id_is_that_of_one_board(session: Session) -> None:
    """= to one board leaves all others at their ids."""
    driver = BoardDriver(session)
    if driver.reading("address_settable") == "false":
        session.skip(FIXED)
    (new, *_) = other_ids(driver, *NEW_IDS)
    with brought_back(driver, new):
        exchange = driver.ask(f"={new}")
        session.step(exchange.codes == DONE, "START and DONE", exchange.observed)
        for board in (new, *session.neighbours):
            BoardDriver(session, board).draws("*", PRESENT, "MN4-DROP-08")
        driver.judge(driver.client.seek(), (), "MN4-CMD-ADDR-04")


# --- the rate -------------------------------------------------------------------------------------


@check("MN4-CMD-BAUD-01", "MN4-DROP-11", "MN4-DROP-09", "MN4-PHY-01", "MN4-PKT-05", "MN4-ERR-05",
       safety=DESTRUCTIVE, needs=ALONE)  # fmt: skip
def the_rate_can_be_set(session: Session) -> None:
    """~ draws START at the old rate and BAUDCHANGEOK at the new one; the board then talks all five
    rates, whatever it refuses, and at the old one no more."""
    driver = BoardDriver(session)
    if not has_rate(driver):
        session.skip(SOCKET)
    with brought_back(driver):
        for number, rate in (*enumerate(codec.RATES), (0, codec.RATES[0]), (4, codec.RATES[4])):
            if rate != driver.target.baud:
                _judge_new_rate(driver, number)


def _judge_new_rate(driver: BoardDriver, number: int) -> None:
    session, old = driver.session, driver.target.baud
    is_lossless = session.target.is_lossless
    change = change_rate(driver, number, is_late=not is_lossless)
    names = ("MN4-CMD-BAUD-01", "MN4-DROP-11")
    came = "nothing" if change.before is None else words.packet_words(change.before)
    is_start = change.before is not None and change.codes[:1] == ("START",)
    session.expect(is_start, names, f"START at {old} baud", came, f"to ~{number}")
    usual = ("DONE",) if driver.reading("baud_reply") == "plus_done" else ()
    wanted = ("START", "BAUDCHANGEOK", *usual)
    told = f"{' and '.join(wanted[1:])} at {codec.RATES[number]} baud"
    if is_lossless:
        is_right = change.codes == wanted and not change.strays
        session.expect(is_right, names, told, _after(change), f"to ~{number}")
    else:  # what is said while our end changes its rate may be lost; & says it again
        said = codec.codes_of(packet for packet in change.after if packet.is_sound)
        is_right = "BAUDCHANGEOK" not in said
        came = f"{_after(change)} at {old} baud"
        session.expect(is_right, names, told, came, f"to ~{number}")
        driver.draws("&", wanted[-1:], names)
    driver.draws("*", PRESENT, "MN4-PHY-01")
    driver.ignores("*")
    for text in ("W", "~5"):
        driver.judge(driver.client.seek(), PRESENT, ("MN4-CMD-BAUD-01", "MN4-ERR-05"))
        driver.ask(text)
    driver.judge(driver.client.seek(), PRESENT, ("MN4-CMD-BAUD-01", "MN4-ERR-05"))
    driver.target.baud = old
    at_old = driver.client.seek()
    driver.target.baud = codec.RATES[number]
    driver.client.forget_frame()
    told = f"no PRESENT at {old} baud, the rate before"
    session.expect("PRESENT" not in at_old.codes, "MN4-DROP-09", told, at_old)


def _after(change: RateChange) -> str:
    raw = b"".join(packet.raw for packet in change.after) + change.strays
    return words.explain_reply(raw) or "nothing"


@check("MN4-DROP-09", safety=DESTRUCTIVE, needs=("neighbour",))
def a_rate_is_that_of_one_board(session: Session) -> None:
    """~ to one board leaves all others at the rate they have."""
    driver = BoardDriver(session)
    if not has_rate(driver):
        session.skip(SOCKET)
    old = driver.target.baud
    number = next(one for one, rate in enumerate(codec.RATES) if rate != old)
    with brought_back(driver):
        change_rate(driver, number)
        driver.draws("*", PRESENT, "MN4-DROP-09")
        driver.target.baud = old
        driver.target.wait(driver.client.frame_timeout_s)
        for board in session.neighbours:
            BoardDriver(session, board).draws("*", PRESENT, "MN4-DROP-09")


# --- the configuration ----------------------------------------------------------------------------


@check("MN4-NVM-04", "MN4-CMD-Q-04", "MN4-DROP-11", "MN4-NVM-06", safety=EVERYTHING, needs=ALONE)
def a_configuration_is_kept_and_not_carried_out(session: Session) -> None:
    """Between . and Q every line draws START and DONE and does nothing; Ctrl-D does not end it,
    Q does."""
    driver = BoardDriver(session)
    (new, *_) = other_ids(driver, *NEW_IDS)
    with emptied_afterwards(driver), brought_back(driver, new):
        driver.command("L1,2,3,4")
        driver.draws(".", DONE, "MN4-NVM-04")
        for line in (f"={new}", "L9,9,9,9", "~4", "*", "E"):
            driver.draws(line, DONE, ("MN4-NVM-04", "MN4-DROP-11"))
        for text in (codec.END_OF_PROGRAM, "Z", "."):
            exchange = driver.ask(text)
            at_once = exchange.says(*driver.errors("INVALIDPROGCOMM"))
            told = "INVALIDPROGCOMM or DONE"
            session.expect(at_once or exchange.says(*DONE), "MN4-NVM-06", told, exchange.observed)
        driver.draws("X1", DONE, "MN4-NVM-04")
        driver.draws("q", DONE, ("MN4-NVM-04", "MN4-CMD-Q-04"))
        driver.draws("*", PRESENT, ("MN4-CMD-Q-04", "MN4-DROP-11"))
        position = driver.position()
        session.expect(position == (1, 2, 3, 4), "MN4-NVM-04", "1, 2, 3, 4", position)


@check("MN4-NVM-11", safety=EVERYTHING, needs=ALONE)
def a_configuration_leaves_the_program_as_it_is(session: Session) -> None:
    """R lists the same before and after . and Q, with many lines between and without."""
    driver = BoardDriver(session)
    with emptied_afterwards(driver):
        enter_program(driver, PROGRAM)
        for lines in (CONFIGURED * 4, ()):
            enter_configuration(driver, lines)
            judge_listing(driver, PROGRAM, ("MN4-NVM-11",))


@check("MN4-NVM-08", "MN4-NVM-04", "MN4-NVM-11", safety=EVERYTHING, needs=ALONE, level="full")
def both_programs_share_one_memory(session: Session) -> None:
    """What the configuration takes is missing to the program, to the byte, until . and Q replace
    it; neither entry changes what the other has stored."""
    driver = BoardDriver(session)
    overhead = int(driver.reading("nvm_line_overhead"))
    few, many = (sum(len(line) + overhead for line in one) for one in (PROGRAM, CONFIGURED * 20))
    with emptied_afterwards(driver):
        enter_configuration(driver, ())
        enter_program(driver, PROGRAM)
        whole = few + _filled_bytes(driver, overhead)
        judge_listing(driver, PROGRAM, ("MN4-NVM-11",), "beside a configuration")
        _judge_full(driver, 1 + (few + overhead) // (len(LONG_LINE) + overhead))
        enter_program(driver, ())
        enter_configuration(driver, CONFIGURED * 20)
        with program_entry(driver):
            filled = fill_store(driver)
            end_program(driver)
        enter_program(driver, ())
    lost = whole - filled.text_bytes - overhead * len(filled.lines)
    # Too much is what was stored beside the lines.
    names = ("MN4-NVM-08", *(("MN4-NVM-04",) if lost > many else ()))
    session.expect(abs(lost - many) <= overhead, names, f"{many} bytes less", lost)
    size = int(driver.reading("nvm_size"))
    is_right = whole <= size <= whole + overhead
    session.expect(is_right, "MN4-NVM-08", f"{size} bytes in all", whole)


def _filled_bytes(driver: BoardDriver, overhead: int) -> int:
    """Fill the configuration until no line fits any more; the bytes that it takes."""
    driver.command(".")
    try:
        filled = fill_store(driver)
    finally:
        driver.ask("Q")
    return filled.text_bytes + overhead * len(filled.lines)


def _judge_full(driver: BoardDriver, long_lines: int) -> None:
    """Judge that a program longer than the last one, of so many long lines, fits only when a
    configuration that fills the rest has been replaced by an empty one, however many programs are
    entered before."""
    for lines, name, is_full in (
        ((), "MN4-NVM-08", True),
        (PROGRAM, "MN4-NVM-11", True),
        ((), "MN4-NVM-11", True),
        ((), "MN4-NVM-04", False),
    ):
        if not is_full:
            enter_configuration(driver, ())
        with program_entry(driver):
            for line in lines:  # they have fitted beside it while it was entered
                driver.draws(line, DONE, "MN4-NVM-04")
            for _ in range(long_lines):
                exchange = driver.ask(LONG_LINE)
                if not (is_taken := exchange.says(*DONE)):
                    break
            told = "a refusal" if is_full else "START and DONE"
            driver.session.expect(is_taken is not is_full, name, told, exchange.observed)
