"""Whether a module goes on with what it does while nobody speaks to it (CMD-15, EMCY)."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.client import AxisExchange
from axistwin_conformance.families.mac.axis.driver.limits import SLOWEST
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.families.mac.can.checks.messages import (
    LIFEBEAT_NS,
    NMT_START,
    is_free,
    messages_amid,
    silenced,
)
from axistwin_conformance.families.mac.can.collect_replies import slack_ns, unknown_addresses
from axistwin_conformance.families.mac.can.driver import CanDriver
from axistwin_conformance.transport.can import Arrival
from axistwin_conformance.transport.can_frame import Frame

ORDER = 65  # of this module in a run; see `Family.modules`

ALONE_S: Final = 13.0  # that an endless motion lasts at most while the module is left alone
SPOKEN: Final = ("MACC-EMCY-01", "MACC-EMCY-02", "MACC-EMCY-05")


@check("MACC-CMD-15-01", *SPOKEN, safety=MOVES, level="full")
def an_endless_motion_goes_on_while_nobody_speaks_to_it(session: Session) -> None:
    """2015h goes on through ten seconds without a request.  That 200Dh and 2013h are refused in it,
    is no error to be told; frames for others do not put the lifebeat off."""
    driver = CanDriver(session)
    driver.motion.ready()
    period = driver.limits.gentle(SLOWEST, ALONE_S)
    driver.client.target.take_spontaneous()
    forecast = driver.motion.turn(1, period)
    driver.client.command(0x0D, driver.motion.period)
    own = driver.client.command(0x13, forecast.timelines[0].origin)
    messages = messages_amid(driver, own.taken, *_for_others(driver))
    for _ in range(3):
        driver.motion.follow(forecast, "MACC-CMD-15-01", driver.limits.allowance(period))
        driver.client.wait(0.1)
    driver.motion.at_rest()
    if silenced(driver) or is_free(driver):
        for name in SPOKEN:
            session.not_run(name, "it sends no such message, or sends it in any case")
        return
    _judge_messages(driver, own, messages)


def _for_others(driver: CanDriver) -> list[Frame]:
    """Frames of every kind that are not for this module."""
    other = unknown_addresses(driver.session)[0]
    return [
        Frame(codec.REPLY + other, b"\x42\0\x20".ljust(codec.TRANSFER_BYTES, b"\0")),
        driver.client.request(0x20, address=other).frame(),
        Frame(codec.EMERGENCY + other, bytes(codec.EMERGENCY_BYTES)),
        codec.nmt(NMT_START, other),
    ]


def _judge_messages(driver: CanDriver, own: AxisExchange, messages: list[Arrival]) -> None:
    """Judge that the module says one thing, ten seconds after its last request."""
    session = driver.session
    due_ns = own.taken.earliest_ns + LIFEBEAT_NS - slack_ns(driver, LIFEBEAT_NS)
    early = [str(message.frame) for message in messages if message.time_ns < due_ns]
    session.expect(
        not early, ("MACC-EMCY-01", "MACC-EMCY-02"), "silence for ten seconds", " ".join(early)
    )
    names = ("MACC-EMCY-01", "MACC-EMCY-05")
    session.expect(bool(messages), names, "a lifebeat amid frames for others", "none")
