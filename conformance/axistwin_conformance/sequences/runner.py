"""Lists of operations run on a device and held against a model, whatever the family.

An operation is some bytes.  A family says what they mean (`OperationSequence.perform`), how a
sequence begins, and how the same is done on the built-in twin.  The runner counts what was judged
and met, and begins anew what noise has broken off.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

from axistwin_conformance.base.errors import AttemptVoid
from axistwin_conformance.base.events import StatesCovered
from axistwin_conformance.base.retry import RETRY
from axistwin_conformance.core.session import Session

Operations = tuple[bytes, ...]


class Mismatch(Exception):  # noqa: N818 - a finding, not an error
    """A reply outside the admissible set."""

    def __init__(self, requirement: str, expected: str, actual: str) -> None:
        super().__init__(f"{requirement}: admissible {expected}, came {actual}")
        self.requirement, self.expected, self.actual = requirement, expected, actual
        self.story: tuple[str, ...] = ()


class OperationSequence(Protocol):
    """One run of operations on one device.

    `judged`: requirement → how many replies were held against it, counted only where some other
    reply would not have done.  `operated`: state of the model and name of the operation → how often
    it was done there.  `marks`: where in the story each operation begins.
    """

    judged: Counter[str]
    operated: Counter[tuple[str, str]]
    marks: list[int]

    @property
    def story(self) -> list[str]:
        """What was sent, said and waited, in words."""

    def perform(self, data: bytes, /) -> None:
        """Run all operations and compare everything at the end; raises Mismatch."""


class Steps(ABC):
    """The steps of a `OperationSequence`; a family's sequence says what an operation does."""

    operation_bytes: ClassVar[int]

    def perform(self, data: bytes) -> None:
        """Run all operations, then compare everything readable."""
        size = self.operation_bytes
        try:
            for at in range(0, len(data) - size + 1, size):
                self.operate(*data[at : at + size])
            self.conclude()
        finally:
            self.leave()

    @abstractmethod
    def operate(self, what: int, first: int, second: int, pause: int) -> None:
        """Run one operation.  Raises Mismatch for what is not admissible."""

    @abstractmethod
    def conclude(self) -> None:
        """Compare everything readable.  Raises Mismatch."""

    @abstractmethod
    def leave(self) -> None:
        """Leave the device as it was found."""


def split(data: bytes, kinds: int, size: int) -> Operations:
    """Cut bytes into operations of `size`, each told by its lowest number: one that stays when
    there are more kinds of operations than these."""
    whole = range(0, len(data) - size + 1, size)
    return tuple(bytes([data[at] % kinds]) + data[at + 1 : at + size] for at in whole)


@dataclass(slots=True)
class Tally:
    """What sequences have judged and met."""

    judged: Counter[str] = field(default_factory=Counter)  # requirement → judgements
    operated: Counter[tuple[str, str]] = field(default_factory=Counter)  # state, operation
    sequences: int = 0

    def add(self, run: OperationSequence) -> None:
        """Count a sequence that has been played."""
        self.judged += run.judged
        self.operated += run.operated
        self.sequences += 1


@dataclass(frozen=True, slots=True)
class SequenceResult:
    """One playing of a list: what did not fit, if anything, and what each operation did."""

    operations: Operations  # those that were begun
    mismatch: Mismatch | None
    words: tuple[str, ...]


class Runner(ABC):
    """Plays operations on one device, always from the same beginning.

    `operation_bytes`: of one operation.  `arguments`: which of them shrinking makes smaller, the
    pause first.  `beginning`: in words, what `is_fresh` begins with.
    """

    operation_bytes: ClassVar[int]
    arguments: ClassVar[tuple[int, ...]]
    beginning: ClassVar[str]

    def __init__(self, session: Session) -> None:
        self.session = session
        self.tally = Tally()
        # Beginning anew, a list cannot fail by what another one has left behind.  That costs time,
        # so only where time is free.
        self.is_fresh = False

    # --- what a family brings ---------------------------------------------------------------------

    @property
    @abstractmethod
    def kinds(self) -> int:
        """How many operations there are on this device."""

    @abstractmethod
    def begin(self) -> OperationSequence:
        """A sequence that begins where every sequence begins."""

    @abstractmethod
    def on(self, session: Session) -> Runner:
        """The same on another device: the twin of this one."""

    def watched(self, run: OperationSequence) -> None:
        """Have what this run does told to the report, where there is more to tell than replies."""
        assert run.marks == [], "before it is played"

    # --- what is the same for all -----------------------------------------------------------------

    def run(
        self, operations: Operations, *, is_counted: bool = False, is_plotted: bool = False
    ) -> SequenceResult:
        """Play a list; one that noise breaks off begins anew, and raises AttemptVoid in the end."""
        for attempt in range(RETRY.sequence, 0, -1):
            try:
                return self._once(operations, is_counted, is_plotted)
            except AttemptVoid:
                if attempt == 1:
                    raise
                self.session.retries.append("a sequence was broken off by noise and begins anew")
        raise AssertionError("the last attempt returns or raises")

    def split(self, data: bytes) -> Operations:
        """Cut bytes into operations of this device's table."""
        return split(data, self.kinds, self.operation_bytes)

    def _once(self, operations: Operations, is_counted: bool, is_plotted: bool) -> SequenceResult:
        run = self.begin()
        if is_plotted:
            self.watched(run)
            self.session.note(f"operations begin here: {len(operations)}")
        mismatch = None
        try:
            run.perform(b"".join(operations))
        except Mismatch as found:
            mismatch = found
        if is_counted:
            self.tally.add(run)
        return self.result_of(run, operations, mismatch)

    @staticmethod
    def result_of(
        run: OperationSequence, operations: Operations, mismatch: Mismatch | None
    ) -> SequenceResult:
        """What came of a run, whoever had it do these operations."""
        words = () if mismatch is None else _words(run)
        return SequenceResult(operations[: len(run.marks)], mismatch, words)

    def credit(self, failed: str = "") -> None:
        """Let count as held what was really judged, and tell what was met; `failed` does not."""
        session, tally = self.session, self.tally
        named = session.check.requirements if session.check else ()
        judged, own = Counter[str](), session.run.ledger.own
        for name, count in tally.judged.items():
            for one in own((name,)):
                judged[one] += count
        for name, count in judged.items():
            if name in named and name not in own((failed,)):
                session.passed[name] = session.passed.get(name, 0) + count
        for name in named if not failed else ():
            if not judged[name]:
                session.not_run(name, "nothing that was played came to judge it")
        counts: dict[str, dict[str, int]] = {}
        for (state, operation), count in sorted(tally.operated.items()):
            counts.setdefault(state, {})[operation] = count
        name = session.check.name if session.check else ""
        total = tally.operated.total()
        session.run.emit(StatesCovered(name, tally.sequences, total, counts))


def _words(run: OperationSequence) -> tuple[str, ...]:
    """What each operation sent, heard and waited."""
    story = run.story
    ends = [*run.marks[1:], len(story)]
    return tuple("; ".join(story[begun:end]) for begun, end in zip(run.marks, ends, strict=False))
