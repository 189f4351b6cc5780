"""Measures how fast the suite's random layers judge the built-in twin, in virtual time.

Three contestants in one process: the stateful machine with a device that computes nothing (the
limit that Hypothesis and the rules set), the same machine on the twin, and one-draw sequences on
the twin.  Both of the latter are judged by the exact model, with everything the engine does to each
frame on its way out.  Their slices alternate, so that a noisy machine hits all alike, and what is
counted is processor time of this process: quote the ratios, not the rates.  A step is one rule of
the machine, with its invariants, or one operation of a sequence.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import metadata
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from axistwin_conformance.budget import WriteBudget
from axistwin_conformance.ledger import load_ledger
from axistwin_conformance.mac_serial import checks_machines, checks_sequences, machines
from axistwin_conformance.mac_serial.failures import Player
from axistwin_conformance.mac_serial.sequences import BYTES_PER_OPERATION
from axistwin_conformance.registry import SAFETY_CLASSES, find_family
from axistwin_conformance.session import Envelope, Run, Session
from axistwin_conformance.targets import open_target

MODEL = "mac23"
WRITES_ALLOWED = 1 << 40
STATEFUL_AIM = 0.5  # of the limit
ONE_DRAW_AIM = 10.0  # times the stateful rate
# Hypothesis begins with the simplest example, the same step all the time: one in so many here.
SLICE_EXAMPLES = 12
SLICE_SEQUENCES = 12


@dataclass
class Rates:
    """Steps per second of processor time of one contestant, slice by slice."""

    steps: int = 0
    rates: list[float] = field(default_factory=list)

    def add(self, steps: int, seconds: float) -> None:
        """Note a slice."""
        self.steps += steps
        self.rates.append(steps / seconds)

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
        return {"steps": self.steps, "median_per_s": self.median, "slices_per_s": self.rates}


def open_player() -> Player:
    """A player on a fresh twin, its frames guarded and counted as the engine does it."""
    family, budget = find_family(MODEL), WriteBudget(WRITES_ALLOWED)
    target = open_target(
        family.twin_url(MODEL, family.default_address, ()), family.default_baud, is_builtin=True
    )
    run = Run(
        target=target, family=family, model=family.models[MODEL],
        ledger=load_ledger(family.ledger), address=family.default_address, neighbours=(),
        allowed=frozenset(SAFETY_CLASSES), seed=0,
        envelope=Envelope(1 << 20, 5000, is_fenced=False),
    )  # fmt: skip
    run.memory = family.remember(Session(run))
    session = Session(run, checks_machines.some_runs_of_the_machine_agree_with_the_model)

    def gate(data: bytes) -> None:
        assert family.guard(session, data) is None
        budget.allow(family.writes(data))

    target.gate = gate
    target.meter = lambda data: budget.note(family.writes(data))
    return checks_sequences.player_of(session)


def machine_slice(begin: Callable[[], machines.Device], number: int) -> int:
    """Run the machine for a slice; return how many steps it took."""
    driven = machines.driven(begin, lambda operation: None)
    steps: list[int] = []
    machines.run(driven, SLICE_EXAMPLES, checks_machines.STEPS, number, steps.append)
    return sum(steps)


def sequence_slice(player: Player, number: int) -> int:
    """Play one-draw sequences for a slice; return how many operations that were."""
    size = checks_sequences.SEQUENCE_BYTES
    played = []

    @seed(number)
    @settings(
        max_examples=SLICE_SEQUENCES, database=None, deadline=None, phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.binary(min_size=size, max_size=size))
    def example(data: bytes) -> None:
        player.begin().play(data)
        played.append(len(data) // BYTES_PER_OPERATION)

    example()
    return sum(played)


def measure(seconds: float) -> dict[str, Rates]:
    """Alternate slices of all three until the time is over."""
    player, source = open_player(), random.Random(0)
    contestants: dict[str, Callable[[int], int]] = {
        "machine, trivial device": lambda number: machine_slice(machines.Trivial, number),
        "machine, built-in twin": lambda number: machine_slice(
            lambda: machines.Judged(player.begin()), number
        ),
        "one-draw, built-in twin": lambda number: sequence_slice(player, number),
    }
    results = {name: Rates() for name in contestants}
    for contestant in contestants.values():  # warm up, not counted
        contestant(source.getrandbits(32))
    end = time.monotonic() + seconds
    while time.monotonic() < end or not all(one.rates for one in results.values()):
        for name, contestant in contestants.items():
            begin = time.process_time()
            steps = contestant(source.getrandbits(32))
            results[name].add(steps, time.process_time() - begin)
    return results


def ratios(results: dict[str, Rates]) -> list[tuple[str, float, float, float, float]]:
    """What is aimed at: name, median ratio, its spread over the slices, aim."""
    limit, stateful, one_draw = results.values()
    told = []
    for name, one, other, aim in (
        ("stateful / limit", stateful, limit, STATEFUL_AIM),
        ("one-draw / stateful", one_draw, stateful, ONE_DRAW_AIM),
    ):
        pairs = [mine / its for mine, its in zip(one.rates, other.rates, strict=True)]
        told.append((name, one.median / other.median, min(pairs), max(pairs), aim))
    return told


def main() -> None:
    """Measure, and tell."""
    parser = argparse.ArgumentParser(description=__doc__, prog="scripts/bench-suite")
    parser.add_argument("--seconds", type=float, default=20.0, help="in all (default 20)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead")
    arguments = parser.parse_args()
    results = measure(arguments.seconds)
    told = ratios(results)
    if arguments.json:
        aims = {
            name: {"ratio": ratio, "lowest": low, "highest": high, "aim": aim,
                   "is_reached": ratio >= aim}
            for name, ratio, low, high, aim in told
        }  # fmt: skip
        print(json.dumps({**{name: one.as_json() for name, one in results.items()}, **aims}))
        return
    version = metadata.version("axistwin")
    print(f"axistwin {version}, Python {sys.version.split()[0]}, {os.cpu_count()} cores\n")
    for name, one in results.items():
        print(f"  {name:<25}{one.row()}")
    print()
    for name, ratio, low, high, aim in told:
        word = "reached" if ratio >= aim else "missed"
        print(f"  {name:<25}{ratio:8.2f}  (slices {low:.2f} to {high:.2f}), aim {aim:g}: {word}")


if __name__ == "__main__":
    main()
