"""Which readings boards follow that share a line, in what they answer to all of them at once."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.core.probing import Measured, Outcome, probe
from axistwin_conformance.families.mn400.driver import LONGEST_VALUE, BoardDriver

ORDER = 20  # of this module in a run; see `Family.modules`

LONGEST_SLOT_S: Final = 0.1  # that is listened for
ROUNDED_MS: Final = 0.6  # by how far a slot measured may miss the one of the ledger


@probe(needs=("neighbour",), switch="broadcast_reply")
def broadcast_reply_of_several(driver: BoardDriver) -> Outcome:
    """S to all boards: whether each is heard, in its turn."""
    exchange = driver.client.ask_all("S", driver.slots_s(LONGEST_VALUE))
    if exchange.is_silence:
        return 2
    heard = {packet.board for packet in exchange.found if packet.code is None}
    everybody = {driver.board, *driver.session.neighbours}
    return 0 if exchange.is_sound and heard == everybody else 1


@probe(needs=("neighbour",), switch="poll_slot_ms")
def poll_slot_ms_of_several(driver: BoardDriver) -> Outcome:
    """A poll of all boards: how much later each is than the one before it."""
    farthest = max(driver.board, *driver.session.neighbours)
    exchange = driver.client.ask_all("*", LONGEST_SLOT_S * farthest)
    firsts: dict[int, int] = {}
    for packet, came_ns in zip(exchange.found, exchange.came_ns, strict=True):
        firsts.setdefault(packet.board, came_ns)
    if len(firsts) < 2:
        return str(exchange)
    low, high = min(firsts), max(firsts)
    return slot_reading(driver, (firsts[high] - firsts[low]) / (high - low) / 1e6)


def slot_reading(driver: BoardDriver, slot_ms: float) -> Outcome:
    """The reading of a slot that was measured: that of the ledger, if it is near enough."""
    usual_ms = driver.client.usual_slot_s() * 1e3
    return Measured("auto" if abs(slot_ms - usual_ms) < ROUNDED_MS else str(round(slot_ms)))
