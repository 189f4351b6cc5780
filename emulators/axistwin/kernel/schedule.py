"""Deterministic event order.

Rules
-----
1. A *part* is anything that says when it next wants to be woken and can be woken.
2. The earliest event runs first; of two at the same nanosecond the part added first (lower rank).
3. A part that is touched from outside (bytes, an input) is re-asked with ``touch``.
4. Time never goes back, and a woken part moves on: both are asserted, loudly.

The schedule is a plain table of due times.  A line has a handful of parts (never more than its
addresses), so the smallest entry is found at C speed, a touch costs one store, and nothing piles up
however often an idle part is touched.
"""

from collections.abc import Sequence
from typing import Final, Protocol

from axistwin.kernel.time import Nanos

NEVER: Final[Nanos] = 1 << 100


class ScheduledPart(Protocol):
    """A state machine that is told the time."""

    def next_event(self) -> Nanos | None:
        """When to wake this part next, or None to let it sleep until it is touched."""

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``; afterwards ``next_event`` lies later than ``now``."""


class Schedule:
    """Runs parts in the order of (time, rank)."""

    def __init__(self, parts: Sequence[ScheduledPart], now: Nanos = 0) -> None:
        self.now = now
        self._parts = tuple(parts)
        self._due = [NEVER] * (len(self._parts) + 1)  # the last one is nobody's
        for rank in range(len(self._parts)):
            self.touch(rank)

    def touch(self, rank: int) -> Nanos:
        """Ask the part with this ``rank`` again when it wants to be woken: then, or ``NEVER``."""
        due = self._parts[rank].next_event()
        if due is None:
            due = NEVER
        elif due < self.now:
            due = self.now
        self._due[rank] = due
        return due

    def next_event(self) -> Nanos | None:
        """The time of the earliest event, or None when every part sleeps."""
        due = min(self._due)
        return None if due == NEVER else due

    def is_idle_until(self, now: Nanos, but: int = -1) -> bool:
        """Whether no event is due by ``now``, whatever the part of rank ``but`` wants."""
        if but < 0:
            return min(self._due) > now
        own, self._due[but] = self._due[but], NEVER
        due = min(self._due)
        self._due[but] = own
        return due > now

    def run_next(self, limit: Nanos) -> bool:
        """Run the earliest event that is due by ``limit``; False if there is none.

        Does not move ``now`` past that event.
        """
        due = min(self._due)
        if due > limit:
            return False
        rank = self._due.index(due)
        self.now = due
        self._parts[rank].run(due)
        asked = self._parts[rank].next_event()
        assert asked is None or asked > due, f"part {rank} stands still at {due} ns"
        self._due[rank] = NEVER if asked is None else asked
        return True

    def run_until(self, now: Nanos) -> None:
        """Run every event up to and including ``now``, then stand at ``now``."""
        assert now >= self.now, f"time went back from {self.now} to {now} ns"
        while self.run_next(now):
            pass
        self.now = now
