"""Commands drawn by grammar, sound and with one fault, against the model: nothing that moves."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.draws import drawn_at_random
from axistwin_conformance.families.mn400.driver import DATA, DONE, BoardDriver
from axistwin_conformance.families.mn400.grammar import OPEN_REFUSALS
from axistwin_conformance.families.mn400.safety import danger
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 90

LETTERS: Final = tuple("/?SNE[:*VFBDPXGYI;L|Q")
MANY: Final = {True: 400, False: 60}  # by whether time is free
REQUIREMENTS: Final = (
    "MN4-ERR-01", "MN4-ERR-02", "MN4-PAR-02", "MN4-PAR-03", "MN4-PAR-04", "MN4-PAR-05",
    "MN4-PAR-09", "MN4-RSP-03", "MN4-RSP-04", "MN4-CMD-X-01", "MN4-CMD-D-01", "MN4-CMD-L-01",
)  # fmt: skip


@check(*REQUIREMENTS, soaks=True)
@restoring("VFBDPXGYI;L")
def drawn_commands_are_served_or_refused(session: Session) -> None:
    """Each drawn text is carried out or refused as the grammar says, and the counters are those
    that were loaded last."""
    driver = BoardDriver(session)
    counters = list(driver.position())
    for _ in range(MANY[session.target.is_lossless]):
        text = drawn_at_random(session.random, LETTERS, 1000)
        if danger(text, driver.board, driver.target.baud) == "passive":
            _judge(driver, text, counters)
    came = driver.position()
    session.expect([*came] == counters, "MN4-CMD-L-01", tuple(counters), came)


def _judge(driver: BoardDriver, text: str, counters: list[int]) -> None:
    refusal = driver.refusal_of(text)
    exchange = driver.ask(text)
    told = f"to {text!r}"
    if refusal is not None and refusal.is_unknown:
        codes = driver.errors("INVALIDCOMMAND", is_recognised=False)
        driver.judge(exchange, codes, "MN4-ERR-01")
    elif refusal is not None:
        if refusal.requirement not in OPEN_REFUSALS:
            name = refusal.requirement if refusal.requirement in REQUIREMENTS else "MN4-ERR-02"
            codes = driver.errors("PARA_ERROR")
            driver.session.expect(exchange.says(*codes), name, " and ".join(codes), exchange, told)
        elif text[:1].upper() == "L":
            counters[:] = driver.position()
    else:
        _judge_served(driver, text, exchange.codes, counters)


def _judge_served(
    driver: BoardDriver, text: str, codes: tuple[str, ...], counters: list[int]
) -> None:
    letter = text[:1].upper()
    wanted = {"*": ("START", "PRESENT")}.get(letter, DATA if letter in "/?SNE[:" else DONE)
    name = "MN4-RSP-04" if wanted == DATA else "MN4-RSP-03"
    driver.session.expect(codes == wanted, name, " and ".join(wanted), codes, f"to {text!r}")
    if letter == "L":
        counters[:] = driver.model().loaded(text, tuple(counters))
