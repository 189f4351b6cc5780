"""Modules of either face in a state of the ledgers' tables, and values that commands take."""

from typing import TypeVar

from mac_bench import MS, MacBench

SHARED_VALUES = {
    0x03: 1,
    0x07: 1,
    0x09: 0x1000,
    0x0A: 0xFFFFF000,
    0x0C: 0x40,
    0x0D: 0x400,
    0x0E: 0x0600,
    0x0F: 2,
    0x13: 500,
    0x15: 0x320,
    0x16: 0x00640400,
    0x1C: 3,
    0x1E: 0x00640400,
}
"""By command: a value that it takes; of all others 0."""

STEPS: dict[str, list[tuple[int, int]]] = {
    "BT": [(0x00, 0)],
    "HD": [(0x19, 0)],
    "PO": [(0x13, 1_000_000)],
    "VE": [(0x15, 0x320)],
    "IN": [(0x16, 0x7FFF0400)],
    "AR": [(0x10, 0)],
    "PL": [(0x10, 0), (0x13, 1000)],
    "powered AR": [(0x19, 0), (0x10, 0)],
    "powered PL": [(0x19, 0), (0x10, 0), (0x13, 1000)],
}
CODES = {"AR": "OF+AR", "PL": "OF+PL", "powered AR": "HD+AR", "powered PL": "HD+PL"}

Bench = TypeVar("Bench", bound=MacBench)


def brought(bench: Bench, state: str) -> Bench:
    """``bench`` with its module in ``state``, by commands, the reset input or heat."""
    for index, parameters in STEPS.get(state, []):
        bench.do(index, parameters)
    if state == "RI":
        bench.input("reset", True)
    if state == "DJ":
        bench.take(bench.device.set_temperature(bench.now, 100_000))
        bench.advance(MS)  # on a bus an emergency leaves
    assert bench.state() == CODES.get(state, state)
    return bench
