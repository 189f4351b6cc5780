"""Which texts a board takes for a command, and which parameters (ERR, PAR, ranges of CMD).

Nothing here moves: of commands that move only those are sent that name no motion.  What is set is
put back afterwards: counters and feed hold to what they were, the rest to what it is at power-on.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.boundaries import (
    CONTROLS,
    COUNTER_BOUNDS,
    SPELLINGS,
    edges,
)
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.grammar import OPEN_REFUSALS, UNASSIGNED, Refusal
from axistwin_conformance.families.mn400.safety import danger
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 20

SETTERS: Final = "VFBDPXGYI;"
READERS: Final = "/?SN[:"
OTHERS: Final = "|KRQ"
MARK: Final = (11, -12, 13, -14)  # counters that nothing else has
MARKED: Final = "L11,-12,13,-14"
PRINTED: Final = (DONE, DATA)
# The requirements that a refusal may name, by which the table below is judged.
REFUSALS: Final = (
    "MN4-ERR-02", "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-04", "MN4-PAR-05", "MN4-PAR-09",
    "MN4-CMD-X-01", "MN4-CMD-V-04", "MN4-CMD-F-02", "MN4-CMD-P-02", "MN4-CMD-B-02",
    "MN4-CMD-D-01", "MN4-CMD-G-02", "MN4-CMD-ADDR-02", "MN4-CMD-BAUD-02",
)  # fmt: skip


@check("MN4-ERR-01", "MN4-ERR-03", "MN4-ERR-05", "MN4-RSP-13")
def unknown_commands_are_refused(session: Session) -> None:
    """Every unassigned character, alone and with parameters, draws INVALIDCOMMAND; a poll works
    after each."""
    driver = BoardDriver(session)
    codes = driver.errors("INVALIDCOMMAND", is_recognised=False)
    for letter in UNASSIGNED:
        for text in (letter, f"{letter}1,2"):
            exchange = driver.draws(text, codes, ("MN4-ERR-01", "MN4-ERR-03"))
            _judge_form(driver, exchange.found)
        driver.draws("*", PRESENT, "MN4-ERR-05")


def _judge_form(driver: BoardDriver, found: Iterable[codec.BoardPacket]) -> None:
    """Errors have the form of a status packet, with the null that this board's outcomes have."""
    wanted = driver.reading("outcome_null") == "true"
    for packet in found:
        is_usual = packet.code is not None and packet.has_null is wanted
        driver.session.expect(is_usual, "MN4-RSP-13", "a status packet", str(packet.raw.hex(" ")))


@check("MN4-ERR-04", "MN4-ERR-03")
@restoring("H")
def release_with_nothing_pending_is_told(session: Session) -> None:
    """K draws START and NOMOVEPENDING, hold off and on."""
    driver = BoardDriver(session)
    texts = ("H0", "H1") if driver.reading("hold_takes_arg") == "true" else ()
    for text in (None, *texts):
        if text is not None:
            driver.command(text)
        driver.draws("K", ("START", "NOMOVEPENDING"), ("MN4-ERR-04", "MN4-ERR-03"))


@check("MN4-PAR-01", "MN4-RSP-11")
@restoring("VXP")
def letters_have_no_case(session: Session) -> None:
    """Reads and orders in lower case are served, and refused, like the others."""
    driver = BoardDriver(session)
    for text in ("e", "n", "s", "v2000", "x1", "q", "p1,3,2", "x3", "k"):
        upper = driver.ask(text.upper())
        lower = driver.ask(text)
        session.expect(lower.codes == upper.codes, "MN4-PAR-01", upper, lower)
        wanted = text[:1] if driver.reading("echo_case") == "as_sent" else text[:1].upper()
        came = {packet.command for packet in lower.found}
        session.expect(came == {wanted}, "MN4-RSP-11", wanted, sorted(came))


@check(*REFUSALS)
@restoring("VFBDPXGYI;")
def settings_are_served_and_refused_at_their_edges(session: Session) -> None:
    """Each setting at all edges of its grammar and its ranges."""
    _at_edges(BoardDriver(session), SETTERS)


@check("MN4-ERR-02", "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-04", "MN4-PAR-05", "MN4-PAR-09")
def commands_without_parameters_have_none(session: Session) -> None:
    """Reads and orders of no parameter refuse any."""
    _at_edges(BoardDriver(session), READERS + OTHERS)


@check("MN4-ERR-02", "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-05", "MN4-PAR-09", "MN4-CMD-L-01")
@restoring("L")
def counters_are_loaded_at_their_edges(session: Session) -> None:
    """L at all edges; what is refused leaves every counter as it was (trap 31)."""
    driver = BoardDriver(session)
    for text in edges("L"):
        driver.command(MARKED)
        refusal = driver.refusal_of(text)
        judge_text(driver, text, refusal)
        position = driver.position()
        if refusal is not None and refusal.requirement not in OPEN_REFUSALS:
            session.expect(position == MARK, "MN4-ERR-02", MARK, position, f"after {text}")


def _at_edges(driver: BoardDriver, letters: str) -> None:
    """Send every text of the table that is harmless, and judge what it draws."""
    for letter in driver.known(letters):
        for text in edges(letter):
            if danger(text, driver.board, driver.target.baud) == "passive":
                judge_text(driver, text, driver.refusal_of(text))


def judge_text(driver: BoardDriver, text: str, refusal: Refusal | None) -> None:
    """Judge that a text is carried out, or refused as it must be."""
    session, exchange = driver.session, driver.ask(text)
    told = repr(text)
    if refusal is None:
        is_right = exchange.codes in (DONE, DATA, ("START", "NOMOVEPENDING"), ("START",))
        session.expect(is_right, "MN4-ERR-02", "its being carried out", exchange, told)
        return
    name = refusal.requirement if refusal.requirement in session_names(session) else "MN4-ERR-02"
    codes = driver.errors("PARA_ERROR")
    if name in OPEN_REFUSALS:
        driver.tells(exchange.says(*codes), name, " and ".join(codes), f"{exchange} to {told}")
        return
    session.expect(
        exchange.says(*codes), name, " and ".join(codes), exchange, f"to {told}: {refusal.reason}"
    )


def session_names(session: Session) -> tuple[str, ...]:
    """What the running check judges."""
    return session.check.declared if session.check else ()


@check("MN4-PAR-02", needs=("alone",))
@restoring("LV")
def control_characters_are_no_digits(session: Session) -> None:
    """L and V with control characters in a parameter are refused."""
    driver = BoardDriver(session)
    for text in CONTROLS:
        for letter in "LV":
            driver.draws(f"{letter}{text}", driver.errors("PARA_ERROR"), "MN4-PAR-02")


@check("MN4-PAR-08", "MN4-RSP-10")
@restoring("L")
def numbers_may_be_spelt_with_zeros(session: Session) -> None:
    """Leading zeros and -0 are accepted, and come back as plain numbers."""
    driver = BoardDriver(session)
    for text, value in SPELLINGS:
        driver.draws(f"L{text},1,2,3", DONE, "MN4-PAR-08")
        came = driver.value("E").value
        session.expect(
            came == f"{value},1,2,3", ("MN4-PAR-08", "MN4-RSP-10"), f"{value},1,2,3", came
        )


@check("MN4-CMD-L-01", "MN4-PAR-05", "MN4-RSP-10")
@restoring("L")
def counters_come_back_as_they_were_loaded(session: Session) -> None:
    """Each axis at small, large and negative values; beyond the bounds nothing changes."""
    driver = BoardDriver(session)
    values = (0, 1, -1, 50, -50, 32767, 32768, -32768, 65536, 1_000_000_000, *COUNTER_BOUNDS)
    for value in values:
        for axis in range(AXES):
            before = driver.position()
            row = tuple(value if one == axis else one + 1 for one in range(AXES))
            text = "L" + ",".join(map(str, row))
            refused = driver.refusal_of(text)
            codes = driver.errors("PARA_ERROR") if refused else DONE
            driver.draws(text, codes, "MN4-PAR-05" if refused else "MN4-CMD-L-01")
            wanted, came = before if refused else row, driver.position()
            name = "MN4-PAR-05" if refused else "MN4-CMD-L-01"
            session.expect(came == wanted, (name, "MN4-RSP-10"), wanted, came, f"after {text}")


@check("MN4-PAR-09", "MN4-CMD-L-01")
@restoring("L")
def what_is_left_out_keeps_its_value(session: Session) -> None:
    """L,5 and L in every combination of given and omitted counters."""
    driver = BoardDriver(session)
    for given in range(1 << AXES):
        driver.command(MARKED)
        parts = ["7" if given >> axis & 1 else "" for axis in range(AXES)]
        text = "L" + ",".join(parts)
        exchange = driver.ask(text)
        if driver.reading("omitted_param") == "error" and not all(parts):
            driver.tells(
                exchange.says(*driver.errors("PARA_ERROR")), "MN4-PAR-09", "PARA_ERROR", exchange
            )
            continue
        is_kept = driver.reading("omitted_param") == "keep"
        wanted = tuple(
            7 if part else (was if is_kept else 0) for part, was in zip(parts, MARK, strict=True)
        )
        came = driver.position()
        name = "MN4-CMD-L-01" if all(parts) else "MN4-PAR-09"
        driver.tells(came == wanted, name, str(wanted), f"{came} after {text}")


@check("MN4-CMD-ADDR-02", "MN4-CMD-BAUD-02", "MN4-CMD-BAUD-04")
def no_address_and_no_rate_beyond_those_there_are(session: Session) -> None:
    """=0, =128 and more, ~5 and ~-1 are refused, and the board is where it was; ~ with the rate it
    has is served."""
    driver = BoardDriver(session)
    codes = driver.errors("PARA_ERROR")
    for name, texts in (
        ("MN4-CMD-ADDR-02", ("=0", "=128", "=129", "=255", "=256", "=257", "=-1", "=32767")),
        ("MN4-CMD-BAUD-02", ("~5", "~6", "~9", "~-1", "~255", "~256", "~9600")),
    ):
        for text in texts:
            driver.draws(text, codes, name)
            driver.draws("*", PRESENT, name)
    rate = codec.RATES.index(driver.target.baud)
    more = ("DONE",) if driver.reading("baud_reply") == "plus_done" else ()
    driver.draws(f"~{rate}", ("START", "BAUDCHANGEOK", *more), "MN4-CMD-BAUD-04")


@check("MN4-PKT-14", "MN4-PKT-13", "MN4-ERR-03", "MN4-CMD-RTX-01", "MN4-ERR-05", "MN4-PKT-05")
@restoring("L")
def a_payload_may_be_as_long_as_the_longest_command(session: Session) -> None:
    """69 characters are looked at, 200 draw SLAVEBUFFOV, or one more than there is room for, and
    behind those 69 draw what they drew before.  200 under a wrong sum do nothing; & and a poll
    work after all."""
    driver = BoardDriver(session)
    longest = "L" + "0" * 68
    first = driver.ask(longest)
    session.expect("SLAVEBUFFOV" not in first.codes, "MN4-PKT-13", "no SLAVEBUFFOV", first.observed)
    most = max(200, int(driver.reading("rx_payload_max")))
    exchange = driver.ask("L" + "1" * most)
    codes = driver.errors("SLAVEBUFFOV", is_recognised=False)
    driver.tells(exchange.says(*codes), "MN4-PKT-14", " and ".join(codes), exchange)
    for _ in range(2):
        driver.draws(longest, first.codes, "MN4-ERR-05")
    driver.command(MARKED)
    raw = codec.with_wrong_checksum(driver.client.request("L" + "0" * most))
    exchange = driver.client.ask_raw(raw)
    session.expect("DONE" not in exchange.codes, "MN4-PKT-05", "no DONE", exchange.observed)
    if exchange.is_sound:
        driver.repeats(exchange, "MN4-CMD-RTX-01")
    position = driver.position()
    session.expect(position == MARK, "MN4-PKT-05", MARK, position, "after L under a wrong sum")
    driver.draws("*", PRESENT, "MN4-ERR-03")
