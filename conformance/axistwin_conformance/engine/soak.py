"""A soak: checks that draw at random, again and again with fresh seeds, until the time is over.

Each round has a seed of its own, derived from the run's seed and the number of the round; the
check then does what it does in any run with that seed.  So what a round finds is found again by
`--seed SEED CHECK`, without the rounds before it.

A round that finds nothing new is only counted; what is new is a result of its own.  At the end one
result per check tells in how many rounds each requirement held.  Time is real time, on a port and
on the built-in twin alike; a round that has begun is finished.
"""

from __future__ import annotations

import hashlib
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from axistwin_conformance.base import events
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import Event, Listener, Outcome, StatesCovered
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.engine.result import CheckResult

SEEDS_TOLD = 10

Begin = Callable[[Check, int], None]
WRONG = (Verdict.FAIL, Verdict.INCONCLUSIVE)


def round_seed(seed: int, number: int) -> int:
    """The seed of a round; 32 bits, so that it can be typed."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{number}".encode()).digest()[:4], "big")


@dataclass(slots=True)
class Soak:
    """The rounds of one run, and what came of them."""

    checks: Sequence[Check]
    seed: int
    duration_s: float
    emit: Listener
    clock: Callable[[], float] = time.monotonic
    rounds_done: int = 0
    started: float = 0.0
    _held: dict[str, Counter[str]] = field(default_factory=dict)  # check → requirement → rounds
    _wrong: list[int] = field(default_factory=list)  # seeds
    _known: set[tuple[str, str]] = field(default_factory=set)
    _covered: dict[str, StatesCovered] = field(default_factory=dict)

    def rounds(
        self, begin: Begin = lambda check, seed: None, ahead: int = 0
    ) -> Iterator[tuple[Check, int]]:
        """Give each check with the seed it is to be run with, until the time is over.

        `begin` is told of at least `ahead` checks before it is their turn; rounds that it has been
        told of are finished.
        """
        self.started = self.clock()
        begun: deque[int] = deque()  # seeds of rounds whose turn is still to come
        rounds_ahead = -(-ahead // max(1, len(self.checks)))
        number = latest = 0
        while True:
            elapsed_s = self._elapsed_s
            while len(begun) <= rounds_ahead and elapsed_s < self.duration_s:
                latest += 1
                begun.append(round_seed(self.seed, latest))
                for check in self.checks:
                    begin(check, begun[-1])
            if not begun:
                return
            number, seed = number + 1, begun.popleft()
            passed_s = min(elapsed_s, self.duration_s)
            self.emit(events.SoakProgress(number, seed, passed_s, self.duration_s))
            for check in self.checks:
                yield check, seed
            self.rounds_done = number

    @property
    def _elapsed_s(self) -> float:
        return self.clock() - self.started

    def hear(self, event: Event) -> None:
        """Take what is told in a round: what was covered is summed up, the rest is handed on."""
        if not isinstance(event, StatesCovered):
            self.emit(event)
            return
        before = self._covered.get(event.check)
        self._covered[event.check] = event if before is None else _sum(before, event)

    def add(self, result: CheckResult, seed: int) -> CheckResult | None:
        """Count a round; return it under a name of its own if it found something new."""
        outcomes = {
            (finding.requirement, finding.verdict.value)
            for finding in result.findings
            if finding.verdict in WRONG
        }
        if result.outcome is not Outcome.DONE:
            outcomes.add((result.check.name, result.outcome.value))
        if not outcomes:
            held = self._held.setdefault(result.check.name, Counter())
            held.update(
                finding.requirement for finding in result.findings if finding.verdict.is_judgement
            )
            return None
        self._wrong.append(seed)
        is_new = not outcomes <= self._known
        self._known |= outcomes
        name = f"{result.check.name}-seed-{seed}"
        return replace(result, check=replace(result.check, name=name)) if is_new else None

    def summary(self) -> Iterator[CheckResult]:
        """Tell all that was counted, and give one result per check."""
        for one in self._covered.values():
            self.emit(one)
        for check in self.checks:
            held = self._held.get(check.name)
            if held:
                findings = tuple(
                    Finding(key, Verdict.PASS, f"held in {count} rounds")
                    for key, count in held.items()
                )
                named = replace(check, name=f"{check.name}-soak")
                seconds = self._elapsed_s
                yield CheckResult(named, Outcome.DONE, findings, (), seconds, "")
        self.emit(events.Note(self._sentence()))

    def _sentence(self) -> str:
        seconds = self._elapsed_s
        words = f"soak: {self.rounds_done} rounds in {seconds:.0f} s, seeds from {self.seed}"
        if not self._wrong:
            return f"{words}, nothing found"
        seeds = ", ".join(map(str, self._wrong[:SEEDS_TOLD]))
        more = ", ..." if len(self._wrong) > SEEDS_TOLD else ""
        return f"{words}; {len(self._wrong)} went wrong: --seed {seeds}{more}"


def _sum(one: StatesCovered, other: StatesCovered) -> StatesCovered:
    states = {**one.counts, **other.counts}
    counts = {
        state: dict(Counter(one.counts.get(state, {})) + Counter(other.counts.get(state, {})))
        for state in states
    }
    return StatesCovered(
        one.check, one.sequences + other.sequences, one.operations + other.operations, counts
    )
