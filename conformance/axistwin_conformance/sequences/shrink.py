"""Shrinking: from operations that fail to as few and as small ones as still fail.

Delta debugging over a recorded list.  It knows nothing of devices or operations: it asks `fails`
for each shorter or simpler list, and keeps what still fails.

    all ──▶ leave out halves, quarters, ... single ones ──▶ simplify each ──▶ again, until nothing
                                                                               helps any more

What is left when that ends by itself is *1-minimal*: leaving out any one operation, or making any
one simpler, was tried and does not fail.  On a real line every try costs motion and time, so there
is a budget of operations and of seconds.  It is never exceeded by a try that could be seen to; when
it is used up, the best list so far is the result, and that has failed, too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

Operation = TypeVar("Operation", bound=object)


@dataclass(frozen=True, slots=True)
class Budget:
    """What trying may cost: operations played in all, and seconds after which no try begins."""

    operations: int
    seconds: float
    clock: Callable[[], float] = time.monotonic

    def __str__(self) -> str:
        return f"{self.operations} operations, {self.seconds:g} s"


@dataclass(frozen=True, slots=True)
class Shrunk(Generic[Operation]):
    """What came of it: the operations left, what it took, and whether it ended by itself.

    `steps`: every list that failed on the way, each better than the one before; the first is what
    there was to shrink, the last is `operations`.
    """

    operations: tuple[Operation, ...]
    steps: tuple[tuple[Operation, ...], ...]
    tries: int
    performed: int
    seconds: float
    is_minimal: bool


@dataclass(slots=True)
class _Tries(Generic[Operation]):
    """Counts what is tried; what did not fail once is not tried again."""

    fails: Callable[[tuple[Operation, ...]], bool]
    budget: Budget
    tries: int = 0
    performed: int = 0
    started: float = 0.0
    _sound: set[tuple[Operation, ...]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.started = self.budget.clock()

    @property
    def seconds(self) -> float:
        return self.budget.clock() - self.started

    def __call__(self, candidate: tuple[Operation, ...]) -> bool:
        """Try a list; raises _Spent if the budget does not allow it."""
        if candidate in self._sound:
            return False
        is_dear = self.performed + len(candidate) > self.budget.operations
        if is_dear or self.seconds >= self.budget.seconds:
            raise _Spent
        self.tries += 1
        self.performed += len(candidate)
        if self.fails(candidate):
            return True
        self._sound.add(candidate)
        return False


class _Spent(Exception):  # noqa: N818 - control flow
    """The budget is used up."""


def shrink(
    operations: Iterable[Operation],
    fails: Callable[[tuple[Operation, ...]], bool],
    budget: Budget,
    simpler: Callable[[Operation], Iterable[Operation]] = lambda operation: (),
) -> Shrunk[Operation]:
    """Shrink operations that are known to fail.

    `fails(list)`: plays a list and tells whether it fails in the same way.  `simpler(operation)`:
    what to try in its place, the simplest first; each must be simpler in some order that has an
    end, or shrinking has none but the budget.
    """
    steps = [tuple(operations)]
    tries = _Tries(fails, budget)
    is_minimal = False
    try:
        for step in _better(steps[0], tries, simpler):
            steps.append(step)
        is_minimal = True
    except _Spent:
        pass
    return Shrunk(steps[-1], tuple(steps), tries.tries, tries.performed, tries.seconds, is_minimal)


def _better(
    kept: tuple[Operation, ...],
    fails: _Tries[Operation],
    simpler: Callable[[Operation], Iterable[Operation]],
) -> Iterator[tuple[Operation, ...]]:
    """Every list that fails, each better than the one before; ends at a minimal one."""
    before: tuple[Operation, ...] | None = None
    while kept != before:
        before = kept
        for shorter in _shorter(before, fails):
            kept = shorter
            yield kept
        for changed in _simplified(kept, fails, simpler):
            kept = changed
            yield kept


def _shorter(
    kept: tuple[Operation, ...], fails: _Tries[Operation]
) -> Iterator[tuple[Operation, ...]]:
    """Leave out ever smaller parts, the last ones first, until no single one can be spared."""
    size, has_helped = len(kept), False
    while size:
        end = len(kept)
        has_helped = False
        while end > 0:
            begin = max(0, end - size)
            fewer = kept[:begin] + kept[end:]
            if fails(fewer):
                kept, has_helped = fewer, True
                yield kept
            end = begin
        size = min(size, len(kept)) if size == 1 and has_helped else size // 2


def _simplified(
    kept: tuple[Operation, ...],
    fails: _Tries[Operation],
    simpler: Callable[[Operation], Iterable[Operation]],
) -> Iterator[tuple[Operation, ...]]:
    """Put simpler operations in the place of others, each as simple as it can be."""
    for place in range(len(kept)):
        has_helped = True
        while has_helped:
            has_helped = False
            for instead in simpler(kept[place]):
                changed = (*kept[:place], instead, *kept[place + 1 :])
                if fails(changed):
                    kept, has_helped = changed, True
                    yield kept
                    break


def towards_zero(operation: bytes, places: Iterable[int]) -> Iterator[bytes]:
    """Simpler operations: the bytes at these places 0, halved, or one less, each by itself."""
    for place in places:
        byte = operation[place]
        for smaller in dict.fromkeys((0, byte // 2, byte - 1)):
            if 0 <= smaller < byte:
                yield operation[:place] + bytes([smaller]) + operation[place + 1 :]
