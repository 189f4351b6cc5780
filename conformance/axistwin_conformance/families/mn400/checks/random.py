"""Commands drawn by grammar, sound and with one fault, against the model: nothing that moves."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.model.board import BoardModel
from axistwin_conformance.families.mn400.model.draws import drawn_at_random
from axistwin_conformance.families.mn400.safety import danger
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 90

LETTERS: Final = tuple("/?SNE[:*VFBDPXGYI;L|Q")
AT_REST: Final = (Fraction(0), Fraction(0))
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
    model = driver.model()
    for _ in range(MANY[session.target.is_lossless]):
        text = drawn_at_random(session.random, LETTERS, 1000)
        if danger(text, driver.board, driver.target.baud) == "passive":
            _judge(driver, model, text)
    wanted = tuple(low for low, _ in model.timeline.end)
    came = driver.position()
    session.expect(came == wanted, "MN4-CMD-L-01", wanted, came)


def _judge(driver: BoardDriver, model: BoardModel, text: str) -> None:
    """Judge one answer, and take its effect over; at rest no time matters."""
    expected = model.expect(text, AT_REST)
    if expected.requirement not in REQUIREMENTS:
        expected = replace(expected, requirement="MN4-ERR-02")
    exchange = driver.meets(text, expected)
    if exchange.codes[-1:] != ("DONE",):
        return
    model.accept(text, AT_REST)
    if text[:1].upper() == "L" and expected.is_open:  # it was served where another board refuses
        model.load(driver.position())
