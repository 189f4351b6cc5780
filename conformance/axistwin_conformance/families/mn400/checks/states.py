"""What commands draw in the states that a board can be brought into without a step (STM).

The table of commands and states says what must come; where it is an interpretation, another answer
is told and fails nobody.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.model.board import BoardModel
from axistwin_conformance.families.mn400.snapshot import restoring

ORDER = 40

# Commands that change nothing that would not be put back, and no state.
STEADY: Final = (
    "/", "?", "S", "N", "E", "[", ":", "*", "K", "|", ";0", "V2000", "X1", "P1,3,2", "L1,2,3,4",
    "B0,0,0,0", "D1,1,1,1", "G2000,1000,100,10,8000", "Y1000", "F1000,5000,10000", "V", "X3",
    "\x04", "W",
)  # fmt: skip
SET: Final = "LVXPBDGYF;H"
REQUIREMENTS: Final = (
    "MN4-RSP-03", "MN4-RSP-04", "MN4-RSP-07", "MN4-CMD-POLL-01", "MN4-ERR-01", "MN4-ERR-04",
    "MN4-PAR-09", "MN4-CMD-X-01",
)  # fmt: skip


@check(*REQUIREMENTS)
@restoring(SET)
def at_rest_commands_draw_what_the_table_says(session: Session) -> None:
    """Reads, settings and errors of a board that is ready."""
    driver = BoardDriver(session)
    _meets_all(driver, driver.model())


@check("MN4-CMD-H-02", *REQUIREMENTS)
@restoring(SET)
def on_hold_commands_draw_what_the_table_says(session: Session) -> None:
    """The same with hold on and nothing pending; K still tells that nothing is."""
    driver = BoardDriver(session)
    text = "H1" if driver.reading("hold_takes_arg") == "true" else "H"
    model = driver.model()
    exchange = driver.draws(text, ("START", "DONE"), "MN4-CMD-H-02")
    model.accept(text, driver.span(exchange))
    _meets_all(driver, model)
    if text == "H" and driver.reading("hold_bare_arg") == "toggle":
        driver.command("H")


@check("MN4-CMD-CC-01", "MN4-CMD-CC-03", "MN4-ERR-01", "MN4-PAR-09")
@restoring(SET)
def in_a_contour_commands_draw_what_the_table_says(session: Session) -> None:
    """Of all of them only V is taken; what is refused there has no effect."""
    driver = BoardDriver(session)
    if driver.reading("cc_unsupported") == "executed":
        session.skip("this board executes what a contour does not support")
    model = driver.model()
    before = driver.position()
    with driver.entered("("):
        model.accept("(", driver.span(driver.ask("*")))
        for text in STEADY:
            if text[:1] != "V":
                _meets(driver, model, text)
    position = driver.position()
    session.expect(position == before, "MN4-CMD-CC-03", before, position)
    session.expect(driver.is_present(), "MN4-CMD-CC-01", "START and PRESENT after Q", "none")


def _meets_all(driver: BoardDriver, model: BoardModel) -> None:
    for text in STEADY:
        _meets(driver, model, text)


def _meets(driver: BoardDriver, model: BoardModel, text: str) -> None:
    """Judge one answer, and take its effect over."""
    now = driver.span(driver.ask("&"))  # a board at rest stays in its state
    exchange = driver.meets(text, model.expect(text, now))
    if exchange.codes[-1:] == ("DONE",):
        model.accept(text, driver.span(exchange))
