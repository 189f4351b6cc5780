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
from typing import NamedTuple, TypeAlias

from stored_values import StoredValues

KILLS = os.environ.get("AXISTWIN_KILLS", "")
"""How often each test kills, in place of its own number: ``AXISTWIN_KILLS=1000 pytest -s FILE``."""

LATEST_KILL_S = 0.08
GONE = (OSError, EOFError)
"""How a client notices that the daemon is gone; pyserial's errors are OSErrors."""


class Served(NamedTuple):
    """A daemon, and clients of what it stores: one for each of its lines, all busy at once."""

    pid: int
    memories: Sequence[StoredValues]


Start: TypeAlias = Callable[[], AbstractContextManager[Served]]
"""Starts the daemon, with what it has stored before, and kills it in the end."""
Values: TypeAlias = dict[int, set[int]]
"""Those that each cell of a memory may hold."""


def survive_kills(start: Start, sample: int, seed: int) -> None:
    """Every value whose write was acknowledged is read back after kill -9 and a restart.

    sample: how many rounds there are, unless ``AXISTWIN_KILLS`` asks for another number.
    """
    rounds = int(KILLS or sample)
    rng = random.Random(seed)
    admissible: list[Values] = []
    writes: Counter[int] = Counter()
    rounds_with_writes = 0
    for round_number in range(rounds):
        with start() as served:
            now = [{cell: memory.read(cell) for cell in memory.cells} for memory in served.memories]
            for found, values in zip(now, admissible, strict=bool(round_number)):
                for cell, value in found.items():
                    assert value in values[cell], (round_number, cell, hex(value))
            delay_s = rng.uniform(0.0, LATEST_KILL_S)
            killer = threading.Timer(delay_s, os.kill, (served.pid, signal.SIGKILL))
            draws = [random.Random(rng.getrandbits(64)) for _ in now]
            with ThreadPoolExecutor(len(now)) as clients:
                killer.start()
                ends = list(clients.map(_write_until_killed, served.memories, draws, now))
            killer.join()
        admissible = [values for values, _ in ends]
        acknowledged = {number: count for number, (_, count) in enumerate(ends)}
        writes.update(acknowledged)
        rounds_with_writes += any(acknowledged.values())
    told = ", ".join(str(writes[number]) for number in sorted(writes))
    print(f"{rounds} kills, writes acknowledged on each line: {told}")
    assert rounds_with_writes > rounds // 4, "the kills came before anything was written"


def _write_until_killed(
    memory: StoredValues, rng: random.Random, known: dict[int, int]
) -> tuple[Values, int]:
    """Write random values until the daemon dies.

    The values that each cell may hold afterwards, and how many writes were acknowledged.
    """
    admissible = {cell: {value} for cell, value in known.items()}
    acknowledged = 0
    with contextlib.suppress(*GONE):
        while True:
            cell = rng.choice(list(known))
            value = rng.getrandbits(31)  # positive, so that it reads back as written
            admissible[cell].add(value)
            if not memory.write(cell, value):
                break
            admissible[cell] = {value}
            acknowledged += 1
    return admissible, acknowledged
