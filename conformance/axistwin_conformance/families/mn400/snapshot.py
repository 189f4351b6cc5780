"""What the engine must know of a board: who is there, whether it answers, how to bring it to rest,
what to remember of it and put back.

Of the modal state a board tells the counters and the feed hold; speed, profile, plane and so on
cannot be read.  Of what it stores it tells the program, and not the configuration (see `programs`).
  They are volatile: what a check has set is put back to what it is at power-on,
unless a configuration program has set something else, which nobody can see.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final
from weakref import WeakKeyDictionary

from axistwin_conformance.base.check import CheckFunction
from axistwin_conformance.base.errors import TargetError, WrongDevice
from axistwin_conformance.core.identity import Identity
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mn400 import codec, words
from axistwin_conformance.families.mn400.client import QUIET_S, BoardExchange
from axistwin_conformance.families.mn400.driver import AXES, DATA, DONE, PRESENT, BoardDriver
from axistwin_conformance.families.mn400.motion.return_to_start import (
    HOME_SETS,
    locate,
    return_to_start,
)
from axistwin_conformance.families.mn400.persistence.programs import (
    leave_entry,
    listing,
    put_program_back,
)
from axistwin_conformance.families.mn400.safety import MOVING, danger, texts
from axistwin_conformance.transport.transport import Transport

ENTERING: Final = "(Zz."
MOVED_BY: Final = frozenset({*MOVING, "J"})  # after these the axes are brought home
# What commands set that cannot be read, as at power-on (MN4-PWR-01, MN4-PWR-02).
POWER_ON: Final[Mapping[str, str]] = {
    "V": "V2000", "F": "F1000,5000,10000", "B": "B0,0,0,0", "D": "D1,1,1,1", "P": "P1,3,2",
    "X": "X1", "G": "G2000,1000,100,10,8000", "Y": "Y1000", "H": "H0", "J": "J0",
}  # fmt: skip


@dataclass(slots=True)
class BoardSnapshot:
    """Counters, feed hold and program of a board, and which commands have set something since."""

    counters: tuple[int, ...]
    feed_hold: int | None  # None: this board does not tell it (MN4-AMB-38)
    program: tuple[str, ...] | None = ()  # None: this board does not list it
    touched: set[str] = field(default_factory=set)

    def as_object(self) -> dict[str, Any]:
        """The same as a file keeps it."""
        program = None if self.program is None else [*self.program]
        return {"counters": [*self.counters], "feed_hold": self.feed_hold, "program": program}

    @classmethod
    def from_object(cls, kept: Mapping[str, Any]) -> BoardSnapshot:
        """All of it to be put back; raises ValueError, KeyError or TypeError for what is none."""
        counters = tuple(map(int, kept["counters"]))
        if len(counters) != AXES:
            raise ValueError(f"{len(counters)} counters; a board has {AXES}")
        feed_hold = None if kept["feed_hold"] is None else int(kept["feed_hold"])
        program = None if kept["program"] is None else tuple(map(str, kept["program"]))
        return cls(counters, feed_hold, program, {"L", ";", "I", "Z", *POWER_ON})

    def __str__(self) -> str:
        told = f"counters {', '.join(map(str, self.counters))}"
        return told if self.feed_hold is None else f"{told}; feed hold {self.feed_hold}"


# --- who is there ---------------------------------------------------------------------------------


def identify(session: Session) -> Identity:
    """Poll the board and ask for its firmware."""
    driver = BoardDriver(session)
    exchange = driver.ask("*")
    if not exchange.found:
        raise TargetError(
            f"no board answers as id {driver.board} at {session.target.baud} baud:"
            f" {_came(driver, exchange)}; try --baud with one of"
            f" {', '.join(map(str, codec.RATES))}, or another --address"
        )
    if not exchange.says(*PRESENT):
        raise TargetError(f"no MN400 answers so to a poll: {_came(driver, exchange)}")
    firmware = driver.ask("?").value
    told = "unknown" if firmware is None else firmware.value
    if firmware is not None and not told.startswith("MN"):
        raise WrongDevice(f"not an MN400: it says it is {told!r}")
    return Identity(f"{told}, id {driver.board}", {"firmware": told})


def _came(driver: BoardDriver, exchange: BoardExchange) -> str:
    """What came instead of an answer, with what follows it."""
    raw = exchange.raw + driver.client.listen(QUIET_S)
    return words.hex_words(raw) if raw else "nothing comes"


# --- between checks -------------------------------------------------------------------------------


def sanity(session: Session) -> bool:
    """A poll that is answered; again once the board has given up what it took for a frame.  Beyond
    the first id a poll waits for its slot, and would tell a long way: there / is asked."""
    driver = BoardDriver(session)
    text, codes = ("*", PRESENT) if driver.board == codec.IDS[0] else ("/", DATA)
    for _ in range(2):
        if driver.ask(text).says(*codes):
            return True
        driver.client.forget_frame()
    return bool(driver.ask("E").found)


_opened: WeakKeyDictionary[Transport, set[str]] = WeakKeyDictionary()


def note_sent(session: Session, data: bytes) -> None:
    """Remember of what is sent what `stop` has to end: motion, and entries."""
    for text in texts(data):
        is_open = text[:1] in ENTERING or danger(text, session.address, session.target.baud)
        if is_open and is_open != "passive":
            _opened.setdefault(session.transport, set()).add(text[:1].upper())


def stop(session: Session) -> None:
    """Q, if what was sent since the last one may have moved something or opened an entry; an entry
    that Q does not end is ended before it.  Nothing else: a machine that moves is not ours.

    A move on hold is only ended once it is released (MN4-AMB-16), and behind a contour's entry a
    board may move on (MN4-AMB-74): there a second Q follows.  Then the travel guard learns where
    the axes stand, before anything can clear the counters.
    """
    opened = _opened.pop(session.transport, set())
    client = BoardDriver(session).client
    if "Z" in opened and not client.ask("*").says(*PRESENT):
        leave_entry(client)
    came = b""
    for text in (*(["Q"] if opened else []), *(["Q"] if "(" in opened else [])):
        client.send(client.request(text))
        came = client.listen(session.reply_timeout_s)
    if "MOVEPENDING" in codec.codes_of(codec.packets(came)[0]):
        for text in ("K", "Q"):
            client.send(client.request(text))
            client.listen(QUIET_S)
    if opened & MOVED_BY and session.transport.travel_guard is not None:
        client.ask("E")


# --- what to put back -----------------------------------------------------------------------------


def remember(session: Session) -> BoardSnapshot:
    """Read what can be read."""
    driver = BoardDriver(session)
    memory = _volatile(driver)
    memory.program = listing(driver.client)
    return memory


def _volatile(driver: BoardDriver) -> BoardSnapshot:
    """Counters and feed hold."""
    counters = driver.position()
    flags = driver.ask(":").value
    fields = None if flags is None else flags.fields
    return BoardSnapshot(counters, fields[1] if fields and len(fields) > 1 else None)


def restore(session: Session, memory: BoardSnapshot, board: int | None = None) -> tuple[str, ...]:
    """Put back what was touched; a sentence for each thing that could not be.  Axes that were moved
    go home first."""
    driver = BoardDriver(session, board)
    not_home = return_to_start(session, driver) if memory.touched & MOVED_BY else ""
    if "L" in memory.touched:
        locate(session, driver)
    if memory.touched & MOVED_BY:
        memory.touched |= {"L", *HOME_SETS}
    if "H" in memory.touched and driver.reading("hold_takes_arg") == "false":
        memory.touched.discard("H")  # there is no H0: who has turned hold on turns it off
    wanted = [POWER_ON[letter] for letter in sorted(memory.touched & {*POWER_ON})]
    if "I" in memory.touched:
        is_absolute = driver.reading("power_on_mode") == "absolute"
        absolute = driver.reading("abs_mode_value")
        wanted.append(f"I{absolute if is_absolute else 1 - int(absolute)}")
    if ";" in memory.touched and memory.feed_hold is not None:
        wanted.append(f";{memory.feed_hold}")
    if "L" in memory.touched:
        wanted.append("L" + ",".join(map(str, memory.counters)))
    failed = [f"{text}: {came}" for text in wanted if (came := _refused(driver, text))]
    program = memory.program if "Z" in memory.touched else None
    if program is not None and not put_program_back(driver, program):
        failed.append(f"the stored program, which was {', '.join(program) or 'empty'}")
    memory.touched.clear()
    return (not_home, *failed) if not_home else tuple(failed)


@contextmanager
def put_back(session: Session, letters: str, board: int | None = None) -> Iterator[None]:
    """Put back at the end what commands of these letters set in the block, whatever becomes of it:
    a run that is passive only remembers nothing else."""
    memory = _volatile(BoardDriver(session, board))

    def restored() -> bool:
        memory.touched = {*letters}
        return not restore(session, memory, board)

    with session.restore_on_exit(str(memory), restored):
        yield


def restoring(letters: str) -> Callable[[CheckFunction], CheckFunction]:
    """Have a check put back what its commands of these letters set; see `put_back`."""

    def decorate(function: CheckFunction) -> CheckFunction:
        @functools.wraps(function)
        def kept(session: Session) -> None:
            with put_back(session, letters):
                function(session)

        return kept

    return decorate


def would_lose(session: Session, data: bytes) -> str:
    """Why a program must not be stored: nobody knows which one that replaces; empty: it may be."""
    memory = session.run.memory
    is_unknown = isinstance(memory, BoardSnapshot) and memory.program is None
    stores = is_unknown and any(text[:1].upper() == "Z" for text in texts(data))
    return "the stored program could not be read, so it is not replaced" if stores else ""


def _refused(driver: BoardDriver, text: str) -> str:
    """What came instead of DONE; empty if that came."""
    exchange = driver.ask(text)
    return "" if exchange.says(*DONE) else str(exchange)
