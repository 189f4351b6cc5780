"""The way home: a board at rest, and its axes back where the run found them.

Where that is the travel guard knows.  Without one nothing can be harmed: a twin, which is only
brought to rest.  The way is one relative move from counters of 0, which is the same in both
coordinate modes.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base import interrupts
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.motion.travel_guard import BoardTravelGuard

LOOK_S: Final = 0.1  # from one look at the axes to the next
STILL_LOOKS: Final = 3  # alike in a row: who takes steps is seen to, at 5 steps/s and more
MOST_LOOKS: Final = 3000
HOME_SPEED: Final = 1000
HOME_ACCELERATION: Final = 10_000
MOVE_PENDING: Final = ("START", "MOVEPENDING")
HOME_SETS: Final = "FVBH"  # what the way home sets


def wait_for_rest(driver: BoardDriver) -> tuple[int, ...]:
    """Look at the counters until they stay as they are, or somebody wants it to end."""
    seen, alike = driver.position(), 1
    for _ in range(MOST_LOOKS):
        if alike >= STILL_LOOKS or interrupts.is_hurried():
            break
        driver.target.wait(LOOK_S)
        before, seen = seen, driver.position()
        alike = alike + 1 if seen == before else 1
    return seen


def locate(session: Session, driver: BoardDriver) -> None:
    """Have the travel guard know where the axes are, before counters are loaded: what a stored
    program moves is only over for certain behind a Q."""
    guard = session.transport.travel_guard
    if isinstance(guard, BoardTravelGuard) and guard.way_to_start(driver.board) is None:
        _come_to_rest(session, driver)


def _come_to_rest(session: Session, driver: BoardDriver) -> None:
    limiter = session.transport.travel_guard
    guard = limiter if isinstance(limiter, BoardTravelGuard) else None
    for _ in range(1 if guard is None else guard.quits(driver.board)):
        ended = driver.ask("Q")
    wait_for_rest(driver) if driver.reading("quit_decel") == "true" else driver.position()
    if guard is not None and guard.way_to_start(driver.board) is None:
        wait_for_rest(driver)  # it may have a ramp all the same
    if codec.codes_of(ended.found)[-1:] == (codec.ReturnCode.MOVE_ABORT.name,):
        driver.ask("|")  # else no DONE comes until the next motion (MN4-AMB-51)


def turn_hold_off(driver: BoardDriver) -> None:
    """H0; or H, of a board whose H has no parameter and toggles, if hold is on (MN4-AMB-14): at
    rest, once speed and profile have been set."""
    if driver.reading("hold_takes_arg") == "true":
        driver.ask("H0")
        return
    driver.ask("J0")  # a board that jogs serves no M; one on hold may keep this until a K
    if _is_holding(driver) and _is_holding(driver):  # a K that ends hold has ended it by now
        driver.ask("H")


def _is_holding(driver: BoardDriver) -> bool:
    """Whether an M that moves nothing is kept; it is let go."""
    driver.ask("M")
    is_kept = driver.ask("?").codes == MOVE_PENDING
    if is_kept:
        driver.ask("K")
    return is_kept


def return_to_start(session: Session, driver: BoardDriver) -> str:
    """End any motion and go home; why that could not be, or nothing."""
    _come_to_rest(session, driver)
    guard = session.transport.travel_guard
    if not isinstance(guard, BoardTravelGuard):
        return ""
    away = guard.way_to_start(driver.board)
    if away is None:
        return "nobody knows exactly how far the axes are from where they were found"
    if not any(away):
        return ""
    if session.run.runaway:
        return f"the axes are {away} from where they were found"
    speed = min(HOME_SPEED, session.envelope.max_speed)
    back = ",".join(str(-one) for one in away)
    profile = f"F{speed},{speed},{HOME_ACCELERATION}"
    for text in (profile, f"V{speed}", "B0,0,0,0", "L0,0,0,0"):
        driver.ask(text)
    turn_hold_off(driver)
    driver.ask(f"M{back}")
    wanted = tuple(-one for one in away)
    came = wait_for_rest(driver)
    return "" if came == wanted else f"the axes went {came} where {wanted} leads home"
