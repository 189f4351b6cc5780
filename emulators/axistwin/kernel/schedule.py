"""Deterministic event order.

Rules
-----
1. A *part* is anything that says when it next wants to be woken and can be woken.
2. The earliest event runs first; of two at the same nanosecond the part added first (lower rank).
3. A part that is touched from outside (bytes, an input) is re-asked with ``touch``.
4. Time never goes back, loudly.

The queue is a heap of (time, rank, generation).  An entry is stale when the part's generation has
moved on; stale entries are dropped when they surface, so a touch costs O(log n) and an idle part
nothing.
"""

from collections.abc import Sequence
from heapq import heappop, heappush
from typing import Protocol

from axistwin.kernel.time import Nanos


class Part(Protocol):
    """A state machine that is told the time."""

    def next_event(self) -> Nanos | None:
        """When to wake this part next, or None to let it sleep until it is touched."""

    def run(self, now: Nanos) -> None:
        """Do what is due at ``now``; afterwards ``next_event`` lies later than ``now``."""


class Schedule:
    """Runs parts in the order of (time, rank)."""

    def __init__(self, parts: Sequence[Part], now: Nanos = 0) -> None:
        self.now = now
        self._parts = tuple(parts)
        self._generation = [0] * len(self._parts)
        self._heap: list[tuple[Nanos, int, int]] = []
        for rank in range(len(self._parts)):
            self.touch(rank)

    def touch(self, rank: int) -> None:
        """Ask the part with this ``rank`` again when it wants to be woken."""
        generation = self._generation[rank] = self._generation[rank] + 1
        due = self._parts[rank].next_event()
        if due is not None:
            heappush(self._heap, (max(due, self.now), rank, generation))

    def next_event(self) -> Nanos | None:
        """The time of the earliest event, or None when every part sleeps."""
        heap = self._heap
        while heap and self._generation[heap[0][1]] != heap[0][2]:
            heappop(heap)
        return heap[0][0] if heap else None

    def run_next(self, limit: Nanos) -> bool:
        """Run the earliest event that is due by ``limit``; False if there is none.

        Does not move ``now`` past that event.
        """
        due = self.next_event()
        if due is None or due > limit:
            return False
        _, rank, _ = heappop(self._heap)
        self.now = due
        self._parts[rank].run(due)
        self.touch(rank)
        return True

    def run_until(self, now: Nanos) -> None:
        """Run every event up to and including ``now``, then stand at ``now``."""
        assert now >= self.now, f"time went back from {self.now} to {now} ns"
        while self.run_next(now):
            pass
        self.now = now
