"""A daemon killed at any moment, again and again: what it acknowledged has to be there."""

import contextlib
import os
import random
import signal
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from typing import NamedTuple, TypeAlias

from stored_values import StoredValues

KILLS = os.environ.get("AXISTWIN_KILLS", "")
"""How often each test kills, in place of its own number: ``AXISTWIN_KILLS=1000 pytest -s FILE``."""
TELL_EACH = 100

MOST_WRITES = 40
LATEST_KILL_S = 0.004
"""A kill comes after so many acknowledged writes, at most, and so much later."""

GONE = (OSError, EOFError)
"""How a client notices that the daemon is gone; pyserial's errors are OSErrors."""


class Served(NamedTuple):
    """A daemon, and clients of what it stores: one for each of its lines, all busy at once.

    processes: one of them is killed; what others serve goes on.
    """

    processes: Sequence[int]
    memories: Sequence[StoredValues]


Start: TypeAlias = Callable[[], AbstractContextManager[Served]]
"""Starts the daemon, with what it has stored before, and kills it in the end."""
Values: TypeAlias = dict[int, set[int]]
"""Those that each cell of a memory may hold."""


class Killer:
    """Kills a process a moment after so many writes, or replies, as it draws.

    By the clock alone, a kill on a busy machine would come before anything was written.
    """

    def __init__(self, pid: int, rng: random.Random) -> None:
        self.has_killed = False
        delay_s = rng.uniform(0.0, LATEST_KILL_S)
        self._timer = threading.Timer(delay_s, self._kill, (pid,))
        self._left = rng.randrange(MOST_WRITES)
        self._lock = threading.Lock()
        if not self._left:
            self._timer.start()

    def count(self) -> None:
        """A write was acknowledged, or a reply came."""
        with self._lock:
            self._left -= 1
            if not self._left:
                self._timer.start()

    def join(self) -> None:
        """Wait until it has killed."""
        assert self._left <= 0, "a write was refused, though nothing was killed"
        self._timer.join()

    def _kill(self, pid: int) -> None:
        os.kill(pid, signal.SIGKILL)
        self.has_killed = True


def survive_kills(start: Start, sample: int, seed: int) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart.

    sample: how many rounds there are, unless ``AXISTWIN_KILLS`` asks for another number.
    """
    rounds = int(KILLS or sample)
    rng = random.Random(seed)
    admissible: list[Values] = []
    writes: Counter[int] = Counter()
    for round_number in range(rounds):
        with start() as served:
            now = [{cell: memory.read(cell) for cell in memory.cells} for memory in served.memories]
            for found, values in zip(now, admissible, strict=bool(round_number)):
                for cell, value in found.items():
                    assert value in values[cell], (round_number, cell, hex(value))
            draws = [random.Random(rng.getrandbits(64)) for _ in now]
            killer = Killer(rng.choice(served.processes), rng)
            begin = partial(_write_until_killed, killer=killer)
            with ThreadPoolExecutor(len(now)) as clients:
                ends = list(clients.map(begin, served.memories, draws, now))
            killer.join()
        admissible = [values for values, _ in ends]
        writes.update({number: count for number, (_, count) in enumerate(ends)})
        if (round_number + 1) % TELL_EACH == 0 or round_number + 1 == rounds:
            told = ", ".join(str(writes[number]) for number in sorted(writes))
            print(f"{round_number + 1} kills, writes acknowledged on each line: {told}", flush=True)


def _write_until_killed(
    memory: StoredValues,
    rng: random.Random,
    known: dict[int, int],
    killer: Killer,
) -> tuple[Values, int]:
    """Write random values until the process that serves this dies, or another one has been killed.

    The values that each cell may hold afterwards, and how many writes were acknowledged.
    """
    admissible = {cell: {value} for cell, value in known.items()}
    count = 0
    with contextlib.suppress(*GONE):
        while not killer.has_killed:
            cell = rng.choice(list(known))
            value = rng.getrandbits(31)  # positive, so that it reads back as written
            admissible[cell].add(value)
            if not memory.write(cell, value):
                break
            admissible[cell] = {value}
            count += 1
            killer.count()
    return admissible, count
