"""What the benchmarks share: contestants that take turns, and processes that serve.

Slices of all contestants alternate, so a noisy machine hits them alike; quote the ratios, not the
rates.
"""

from __future__ import annotations

import contextlib
import json
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import psutil

HOST = "127.0.0.1"
SLICES = 5


@dataclass
class Samples:
    """Round-trip times of one contestant, in seconds, slice by slice."""

    rates: list[float] = field(default_factory=list)
    trips: list[float] = field(default_factory=list)

    def row(self) -> str:
        """Rate and latencies as one line."""
        ordered = sorted(self.trips)
        p50, p99 = (ordered[int(len(ordered) * share)] * 1e6 for share in (0.50, 0.99))
        return f"{statistics.median(self.rates):9.0f}/s   p50 {p50:6.1f} µs   p99 {p99:6.1f} µs"


Exchange = Callable[[], None]


def run_slice(exchange: Exchange, seconds: float, samples: Samples) -> None:
    """Exchange as fast as possible for ``seconds``."""
    trips: list[float] = []
    clock = time.perf_counter
    begin = before = clock()
    end = begin + seconds
    while before < end:
        exchange()
        after = clock()
        trips.append(after - before)
        before = after
    samples.rates.append(len(trips) / (before - begin))
    samples.trips += trips


def alternate(exchanges: Mapping[str, Exchange], seconds: float) -> dict[str, Samples]:
    """Let the contestants exchange in turn, ``seconds`` each time, after a warm-up."""
    results = {name: Samples() for name in exchanges}
    for exchange in exchanges.values():
        run_slice(exchange, seconds / 4, Samples())
    for _ in range(SLICES):
        for name, exchange in exchanges.items():
            run_slice(exchange, seconds, results[name])
    return results


def print_results(title: str, results: Mapping[str, Samples]) -> None:
    """A line for each contestant, and the ratio of each to the first."""
    print(f"\n{title}")
    for name, samples in results.items():
        print(f"  {name:<22}{samples.row()}")
    (bare_name, bare), *others = results.items()
    for name, samples in others:
        ratios = [own / echo for own, echo in zip(samples.rates, bare.rates, strict=True)]
        spread = f"slices {min(ratios):.2f} to {max(ratios):.2f}"
        print(f"  ratio to {bare_name}: {name} {statistics.median(ratios):.2f} ({spread})")


@contextlib.contextmanager
def child(*command: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server process and the first line it prints."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline()
        finally:
            process.terminate()
            process.wait(10)


def ready_url(line: str) -> str:
    """The client's address in a ready line."""
    event = json.loads(line)
    assert event["event"] == "ready", line
    return str(event["url"])


def print_idle(pid: int, seconds: float = 3.0) -> None:
    """CPU time that the daemon uses while nobody talks to it, and its memory."""
    process = psutil.Process(pid)
    before = process.cpu_times()
    time.sleep(seconds)
    after = process.cpu_times()
    used = after.user + after.system - before.user - before.system
    memory = process.memory_info().rss / 2**20
    print(f"  idle CPU            {100 * used / seconds:.2f} %   memory {memory:.1f} MiB")
