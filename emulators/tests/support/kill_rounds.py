"""A daemon killed at any moment, again and again: what it acknowledged has to be there."""

import contextlib
import os
import random
import signal
import threading
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from typing import NamedTuple, TypeAlias

LATEST_KILL_S = 0.08
GONE = (OSError, EOFError)
"""How a client notices that the daemon is gone; pyserial's errors are OSErrors."""


class Memory(NamedTuple):
    """A daemon's stored values, as its client sees them.

    write: whether storing a value in a cell was acknowledged; raises one of ``GONE``.
    """

    pid: int
    read: Callable[[int], int]
    write: Callable[[int, int], bool]


Start: TypeAlias = Callable[[], AbstractContextManager[Memory]]
"""Starts the daemon, with what it has stored before, and kills it in the end."""


def survive_kills(start: Start, cells: Iterable[int], rounds: int, seed: int) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart."""
    rng = random.Random(seed)
    admissible: dict[int, set[int]] = {}
    acknowledged = 0
    for round_number in range(rounds):
        with start() as memory:
            now = {cell: memory.read(cell) for cell in cells}
            for cell, values in admissible.items():
                assert now[cell] in values, (round_number, cell, hex(now[cell]))
            delay_s = rng.uniform(0.0, LATEST_KILL_S)
            killer = threading.Timer(delay_s, os.kill, (memory.pid, signal.SIGKILL))
            killer.start()
            admissible = _write_until_killed(memory, rng, now)
            killer.join()
        acknowledged += sum(values != {now[cell]} for cell, values in admissible.items())
    assert acknowledged > rounds // 4, "the kills came before anything was written"


def _write_until_killed(
    memory: Memory, rng: random.Random, known: dict[int, int]
) -> dict[int, set[int]]:
    """Write random values until the daemon dies; the values each cell may hold afterwards."""
    admissible = {cell: {value} for cell, value in known.items()}
    with contextlib.suppress(*GONE):
        while True:
            cell = rng.choice(list(known))
            value = rng.getrandbits(31)  # positive, so that it reads back as written
            admissible[cell].add(value)
            if not memory.write(cell, value):
                break
            admissible[cell] = {value}
    return admissible
