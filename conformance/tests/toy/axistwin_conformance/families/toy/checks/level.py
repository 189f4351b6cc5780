"""The level: asked, set, and kept."""

from __future__ import annotations

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session

from ..family import Lamp


@check("TOY-ASK-01")
def the_level_is_a_digit(session: Session) -> None:
    """`?` draws a digit and a line feed."""
    level = Lamp(session).level()
    is_digit = level[:1].isdigit() and level[1:] == "\n"
    session.expect(is_digit, None, "a digit and a line feed", repr(level))


@check("TOY-SET-01", "TOY-SET-02", safety="stored")
def a_level_that_is_set_is_told(session: Session) -> None:
    """Every level reads as it was set, and each is acknowledged alike."""
    lamp = Lamp(session)
    for level in range(10):
        answer = lamp.set_level(level)
        session.expect(answer in ("K", "A"), "TOY-SET-02", ("K", "A"), repr(answer))
        session.quirk("TOY-SET-02", "acknowledge", answer)
        came = lamp.level()
        session.expect(came == f"{level}\n", "TOY-SET-01", f"level {level}", repr(came))


@check("TOY-MEM-01", safety=("stored", "rig"), needs=("rig:power",))
def the_level_outlives_the_supply(session: Session) -> None:
    """After the supply was off the level is what it was, or 0."""
    lamp = Lamp(session)
    lamp.set_level(7)
    lamp.switch_off_and_on()
    came = lamp.level()
    session.expect(came in ("7\n", "0\n"), None, ("level 7", "level 0"), repr(came))
    session.quirk(None, "keeps_level", "true" if came == "7\n" else "false")


@check("TOY-BTN-01", safety=("stored", "rig"), needs=("rig:press",))
def the_button_turns_it_off(session: Session) -> None:
    """After the button was pressed the level is 0."""
    lamp = Lamp(session)
    lamp.set_level(7)
    session.rig.work("press", True)
    came = lamp.level()
    session.expect(came == "0\n", None, "level 0", repr(came))
