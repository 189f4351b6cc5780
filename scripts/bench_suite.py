"""Measures how fast the suite's random layers judge the built-in twin, in virtual time.

Four contestants in one process: the stateful machine with a device that computes nothing (the
limit that Hypothesis and the rules set), the same machine on the twin, one-draw sequences on the
twin, and such sequences with the twin's replies played back, which is what the suite alone costs.
All but the first are judged by the exact model, with everything the engine does to each frame on
its way out.  A fifth one plays one-draw sequences as a soak does, in as many processes as there are
usable cores (`--jobs`).

Their slices alternate, so that a noisy machine hits all alike, and what is counted of the four is
processor time of this process: quote the ratios, not the rates.  What several processes do is told
twice: by the clock, beside the stateful machine by the clock, which is what a user has of it and
means little while others use the cores; and by processor time, as if each had a core to itself.
A step is one rule of the machine, with its invariants, or one operation of a sequence.
"""

from __future__ import annotations

import argparse
import gc
import json
import multiprocessing
import os
import random
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

import psutil

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.events import Event, StatesCovered
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.jobs import Jobs
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.checks import machines, sequences
from axistwin_conformance.families.mac.axis.sequences.machine import AxisMachine
from axistwin_conformance.families.mac.axis.sequences.machine_devices import JudgedAxis, Trivial
from axistwin_conformance.families.mac.axis.sequences.runner import AxisRunner
from axistwin_conformance.families.mac.axis.sequences.sequence import BYTES_PER_OPERATION
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.options import usable_cores
from axistwin_conformance.sequences import machine
from axistwin_conformance.transport.serial import SerialTransport, open_target

MODEL = "mac23"
WRITES_ALLOWED = 1 << 40
SEQUENCE_BYTES = sequences.FREE.operations * BYTES_PER_OPERATION
STATEFUL_AIM = 0.5  # of the limit
# Hypothesis begins with the simplest example, the same step all the time: one in so many here.
SLICE_EXAMPLES = 12
SLICE_SEQUENCES = 12
SLICE_ROUNDS = 1  # of each process
DRAWN = "many_mixed_sequences_agree_with_the_model"


@dataclass
class Rates:
    """Steps per second of processor time of one contestant, slice by slice."""

    steps: int = 0
    rates: list[float] = field(default_factory=list)
    by_clock: list[float] = field(default_factory=list)

    def add(self, steps: int, seconds: float, clock_seconds: float) -> None:
        """Note a slice."""
        self.steps += steps
        self.rates.append(steps / seconds)
        self.by_clock.append(steps / clock_seconds)

    @property
    def median(self) -> float:
        """The middle rate."""
        return statistics.median(self.rates)

    def row(self) -> str:
        """Rate and spread as one line."""
        low, high = min(self.rates), max(self.rates)
        cost = 1e6 / self.median
        return f"{self.median:8.0f}/s  {cost:6.0f} µs each  (slices {low:.0f} to {high:.0f})"

    def as_json(self) -> dict[str, Any]:
        """The same for programs."""
        return {
            "steps": self.steps, "median_per_s": self.median, "slices_per_s": self.rates,
            "slices_by_clock_per_s": self.by_clock,
        }  # fmt: skip


class Canned:
    """A port that notes what another one gives back, and gives it back again."""

    def __init__(self, port: Any) -> None:
        self._port, self._noted = port, list[Any]()
        self._again: Iterator[Any] | None = None
        self.write: Callable[[bytes], Any] = port.write
        if hasattr(port, "exchange"):
            self.exchange = self._exchange

    def note(self) -> None:
        """Note what comes from now on."""
        self._again = None
        self._noted.clear()
        self.write = self._port.write

    def play(self) -> None:
        """Give back what was noted, beginning with the first."""
        self._again = iter(self._noted)
        self.write = len

    def _tell(self, told: Any) -> Any:
        self._noted.append(told)
        return told

    def _exchange(self, data: bytes, size: int, timeout_s: float) -> Any:
        if self._again is not None:
            return next(self._again)
        return self._tell(self._port.exchange(data, size, timeout_s))

    def read(self, size: int = 1, /) -> Any:
        """Bytes of a reply."""
        return next(self._again) if self._again else self._tell(self._port.read(size))

    @property
    def virtual_time_ns(self) -> Any:
        """The clock."""
        return next(self._again) if self._again else self._tell(self._port.virtual_time_ns)

    @property
    def in_waiting(self) -> Any:
        """How many bytes have come."""
        return next(self._again) if self._again else self._tell(self._port.in_waiting)

    @property
    def timeout(self) -> float | None:
        """How long `read` waits."""
        timeout: float | None = self._port.timeout
        return timeout

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        if self._again is None:
            self._port.timeout = seconds

    @property
    def baudrate(self) -> int:
        """The rate, never changed here."""
        rate: int = self._port.baudrate
        return rate

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def open_runner(wrap: Callable[[Any], Any] | None = None) -> AxisRunner:
    """A player on a fresh twin, its frames guarded and counted as the engine does it; `wrap` puts
    something in front of its port."""
    family, budget = find_family(MODEL), WriteBudget(WRITES_ALLOWED)
    target = open_target(
        family.twin_url(MODEL, family.default_address, ()),
        family.default_rate or 38400,
        is_builtin=True,
    )
    if wrap is not None:
        target = SerialTransport(wrap(target._port), target.description, is_builtin=True)
    run = Run(
        target=target, family=family, model=family.models[MODEL],
        ledger=load_ledger(family.name), address=family.default_address, neighbours=(),
        allowed=frozenset(SAFETY_CLASSES), seed=0,
        envelope=Envelope(1 << 20, 5000, is_guarded=False),
    )  # fmt: skip
    run.memory = family.remember(Session(run))
    session = Session(run, machines.some_runs_of_the_machine_agree_with_the_model)

    def gate(data: bytes) -> None:
        assert family.forbid(session, data) is None
        budget.allow(family.stored_writes(data))

    target.gate = gate
    target.meter = lambda data: budget.note(family.stored_writes(data))
    return sequences.runner_of(session)


def machine_slice(begin: Callable[[], machine.Device], number: int) -> int:
    """Run the machine for a slice; return how many steps it took."""
    driven = machine.driven(begin, lambda operation: None, AxisMachine)
    steps: list[int] = []
    machine.run(driven, SLICE_EXAMPLES, machines.STEPS, number, steps.append)
    return sum(steps)


def sequence_slice(runner: AxisRunner, number: int) -> int:
    """Play one-draw sequences for a slice; return how many operations that were."""
    source = random.Random(number)
    for _ in range(SLICE_SEQUENCES):
        runner.begin().perform(source.randbytes(SEQUENCE_BYTES))
    return SLICE_SEQUENCES * sequences.FREE.operations


class CannedSlice:
    """One-draw sequences whose replies have been noted before."""

    def __init__(self) -> None:
        self.ports: list[Canned] = []
        self.runner = open_runner(self._wrapped)

    def _wrapped(self, port: Any) -> Canned:
        self.ports.append(Canned(port))
        return self.ports[-1]

    def _play(self, number: int) -> int:
        self.runner.driver.client.target.drain()  # so that the clock is looked at anew
        return sequence_slice(AxisRunner(self.runner.driver, self.runner.home), number)

    def prepare(self, number: int) -> None:
        """Note the replies."""
        self.ports[0].note()
        self._play(number)
        codec.answer_data.cache_clear()  # these very answers would all be known

    def run(self, number: int) -> int:
        """Play them back; return how many operations that were."""
        self.ports[0].play()
        return self._play(number)


class SharedSlice:
    """One-draw sequences in several processes, as a soak lets them play."""

    def __init__(self, count: int) -> None:
        self.count, self._told = count, list[Event]()
        self._run = open_runner().session.run
        self._run.emit = self._told.append
        self._check = next(one for one in find_family(MODEL).checks() if one.name == DRAWN)
        self._jobs = Jobs(count, self._lost)

    @staticmethod
    def _lost(text: str) -> None:
        raise SystemExit(text)

    @staticmethod
    def _not_here(run: Run, check: Check) -> CheckResult:
        raise AssertionError(f"{check.name} with seed {run.seed} came back to this process")

    def run(self, number: int) -> int:
        """Let each process play a few lists of sequences; return how many operations that were."""
        seeds = [number + at for at in range(SLICE_ROUNDS * self.count)]
        self._told.clear()
        for one in seeds:
            self._jobs.begin(self._run, self._check, one)
        for self._run.seed in seeds:
            self._jobs.judged(self._run, self._check, self._not_here)
        return sum(one.operations for one in self._told if isinstance(one, StatesCovered))

    def seconds(self) -> float:
        """Processor time of the processes so far, as if each had a core of its own."""
        times = [psutil.Process(one.pid).cpu_times() for one in multiprocessing.active_children()]
        return sum(one.user + one.system for one in times) / self.count

    def close(self) -> None:
        """End the processes."""
        self._jobs.close()


@dataclass(frozen=True)
class Contestant:
    """Runs a slice and returns its steps; what `prepare` does is not counted."""

    run: Callable[[int], int]
    prepare: Callable[[int], None] = lambda number: None
    seconds: Callable[[], float] = time.process_time


def measure(seconds: float, jobs: int) -> dict[str, Rates]:
    """Alternate slices of all contestants until the time is over."""
    shared = SharedSlice(jobs)
    try:
        return _measured(seconds, shared)
    finally:
        shared.close()


def _measured(seconds: float, shared: SharedSlice) -> dict[str, Rates]:
    runner, canned, source = open_runner(), CannedSlice(), random.Random(0)
    contestants = {
        "machine, trivial device": Contestant(lambda number: machine_slice(Trivial, number)),
        "machine, built-in twin": Contestant(
            lambda number: machine_slice(lambda: JudgedAxis(runner.begin()), number)
        ),
        "one-draw, built-in twin": Contestant(lambda number: sequence_slice(runner, number)),
        "one-draw, canned replies": Contestant(canned.run, canned.prepare),
        "one-draw, all cores": Contestant(shared.run, seconds=shared.seconds),
    }
    results = {name: Rates() for name in contestants}
    for contestant in contestants.values():  # warm up, not counted
        number = source.getrandbits(32)
        contestant.prepare(number)
        contestant.run(number)
    end = time.monotonic() + seconds
    while time.monotonic() < end or not all(one.rates for one in results.values()):
        for name, contestant in contestants.items():
            number = source.getrandbits(32)
            contestant.prepare(number)
            # Each slice pays for its own garbage, not for searching through what all the others
            # have left.
            gc.collect()
            gc.freeze()
            begin, begin_s = contestant.seconds(), time.perf_counter()
            steps = contestant.run(number)
            passed_s = time.perf_counter() - begin_s
            results[name].add(steps, contestant.seconds() - begin, passed_s)
    return results


def ratios(results: dict[str, Rates]) -> list[tuple[str, float, float, float, float | None]]:
    """What to compare: name, the median of the ratios of slices that ran one behind the other, the
    spread of these ratios, and the aim, if there is one."""
    limit, stateful, one_draw, _, shared = results.values()
    told = []
    for name, one, other, aim in (
        ("stateful / limit", stateful.rates, limit.rates, STATEFUL_AIM),
        ("one-draw / stateful", one_draw.rates, stateful.rates, None),
        ("all cores / stateful", shared.rates, stateful.rates, None),
        ("the same by the clock", shared.by_clock, stateful.by_clock, None),
    ):
        pairs = [mine / its for mine, its in zip(one, other, strict=True)]
        told.append((name, statistics.median(pairs), min(pairs), max(pairs), aim))
    return told


def main() -> None:
    """Measure, and tell."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/bench-suite")
    parser.add_argument("--seconds", type=float, default=20.0, help="in all (default 20)")
    parser.add_argument(
        "--jobs", type=int, default=usable_cores(), help="processes (default: the usable cores)"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead")
    arguments = parser.parse_args()
    results = measure(arguments.seconds, max(1, arguments.jobs))
    told = ratios(results)
    if arguments.json:
        aims = {
            name: {"ratio": ratio, "lowest": low, "highest": high, "aim": aim}
            for name, ratio, low, high, aim in told
        }
        print(json.dumps({**{name: one.as_json() for name, one in results.items()}, **aims}))
        return
    version = metadata.version("axistwin")
    python = sys.version.split()[0]
    cores = f"{os.cpu_count()} cores, {arguments.jobs} used at once"
    print(f"axistwin {version}, Python {python}, {cores}\n")
    for name, one in results.items():
        print(f"  {name:<25}{one.row()}")
    print()
    for name, ratio, low, high, aim in told:
        word = "" if aim is None else f", aim {aim:g}: {'reached' if ratio >= aim else 'missed'}"
        print(f"  {name:<25}{ratio:8.2f}  (slices {low:.2f} to {high:.2f}){word}")


if __name__ == "__main__":
    main()
