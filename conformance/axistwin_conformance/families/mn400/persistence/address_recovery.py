"""Where a board is to be found, its id and its rate, and how it is brought back there.

Whatever may change either works inside `brought_back`.  A board that is alone on its line is found
at any id, by the poll of all boards (MN4-DROP-12); beside others it is asked for at the ids named.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.client import BoardClient
from axistwin_conformance.families.mn400.codec import BoardPacket
from axistwin_conformance.families.mn400.driver import PRESENT, BoardDriver
from axistwin_conformance.families.mn400.persistence.programs import leave_entry


@dataclass(frozen=True, slots=True)
class RateChange:
    """What ~ has drawn: the packet at the rate before, and all that came at the new one, or what
    came at the rate before instead."""

    before: BoardPacket | None
    after: tuple[BoardPacket, ...]
    strays: bytes

    @property
    def codes(self) -> tuple[str, ...]:
        """What the packets say, in their order."""
        first = () if self.before is None else (self.before,)
        return codec.codes_of((*first, *self.after))


def has_rate(driver: BoardDriver) -> bool:
    """False behind a plain socket: it carries bytes, not a rate."""
    return not driver.target.description.startswith("socket:")


def other_ids(driver: BoardDriver, *wanted: int) -> tuple[int, ...]:
    """Those of the ids wanted that no board of this line has."""
    taken = {driver.session.address, driver.board, *driver.session.neighbours}
    return tuple(board for board in wanted if board not in taken)


def change_rate(driver: BoardDriver, number: int, *, is_late: bool = False) -> RateChange:
    """Send ~ and follow the board to its new rate with our end of the line; `is_late`: when all
    that it says has been heard at the rate before."""
    client, limit_s = driver.client, driver.session.reply_timeout_s
    driver.target.drain()
    client.send(client.request(f"~{number}"))
    before, strays = client.receive_packet(limit_s)
    if not is_late:
        driver.target.baud = codec.RATES[number]
    found, more = codec.packets(client.listen(limit_s))
    driver.target.baud = codec.RATES[number]
    return RateChange(before, found, strays + more)


def is_there(driver: BoardDriver, board: int) -> bool:
    """True if a board of that id answers a poll."""
    return BoardDriver(driver.session, board).is_found()


@contextmanager
def brought_back(driver: BoardDriver, *ids: int) -> Iterator[None]:
    """Bring the board back to the id and the rate it had, whatever was done to it meanwhile.

    `ids`: those that it may be given in the block.
    """
    home, baud = driver.board, driver.target.baud
    what = f"id {home}" + (f", {baud} baud" if has_rate(driver) else "")
    places = tuple(dict.fromkeys((home, *ids)))
    with driver.session.restore_on_exit(what, lambda: _bring_back(driver, places, baud)):
        yield


def _bring_back(driver: BoardDriver, ids: Sequence[int], baud: int) -> bool:
    """Find the board, give it its id and its rate; False if nobody answers there then."""
    home, found = ids[0], _find(driver, ids, baud)
    if found is None:
        driver.target.baud = baud
        return False
    if found != home:
        BoardDriver(driver.session, found).ask(f"={home}")
    if driver.target.baud != baud:
        change_rate(driver, codec.RATES.index(baud))
    return is_there(driver, home)


def _find(driver: BoardDriver, ids: Sequence[int], baud: int) -> int | None:
    """The id at which the board answers, with our end of the line at its rate; None: nowhere."""
    rates = dict.fromkeys((driver.target.baud, baud, *codec.RATES))
    places = tuple(rates) if has_rate(driver) else (driver.target.baud,)
    for rate in places * RETRY.recovery:
        if rate != driver.target.baud:
            driver.target.baud = rate
        driver.client.forget_frame()  # it may have taken what was said at another rate for one
        found = _found_here(driver, ids)
        if found is not None:
            return found
    return None


def _found_here(driver: BoardDriver, ids: Sequence[int]) -> int | None:
    """The same at the present rate; a board that stores what it is sent is made to end that."""
    for board in ids:
        client = BoardClient(driver.session, board)
        exchange = client.seek(most=1)  # what is lost of it is made up for by the next round
        if exchange.says(*PRESENT) or (exchange.is_sound and leave_entry(client)):
            return board
    if driver.session.neighbours:
        return None
    exchange = driver.client.ask_all("*", driver.poll_slot_s() * (codec.IDS[-1] + 1))
    return next((packet.board for packet in exchange.found if packet.is_sound), None)
