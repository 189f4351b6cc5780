"""Processes that judge beside this one: checks that draw at random, begun before their turn.

    engine ── (place, check, seed) ──▶ worker: a fresh built-in twin, read and bounded like the
           ◀── findings, events ────── run's own; the very check, with the very seed

What a check draws follows from its name and the seed, and each begins on a twin at rest, so that
what is found does not depend on how many processes there are.  What a worker has found wrong is
played again here, the usual way, which shrinks it and writes it down; only what does not come again
here is told as the worker has seen it.

Only the built-in twin in virtual time can be judged so: there are as many of it as one likes.

A worker never hears an interrupt: it ends when the process that began it does, by whatever death.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import Event, FailureStored, Outcome
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.identity import Identity
from axistwin_conformance.core.profile import Detection
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.attempts import Attempts, describe
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.transport.transport import RoundTrip

WRONG = (Verdict.FAIL, Verdict.INCONCLUSIVE)

Judge = Callable[[Run, Check], CheckResult]


@dataclass(frozen=True, slots=True)
class RunSetup:
    """What a worker has to know of a run to judge as the run itself would."""

    model: str
    url: str
    rate: int | None
    address: int
    neighbours: tuple[int, ...]
    allowed: frozenset[str]
    envelope: Envelope
    identity: Identity | None
    round_trip: RoundTrip
    readings: Mapping[str, str]
    detections: Mapping[str, Detection]
    settings: Any

    @classmethod
    def of(cls, run: Run) -> RunSetup:
        """The place of a run on the built-in twin."""
        return cls(
            run.model.name, run.target.description, run.target.rate, run.address, run.neighbours,
            run.allowed, run.envelope, run.identity, run.target.round_trip, dict(run.readings),
            dict(run.detections), run.settings,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class WorkerResult:
    """What a worker has to say of a check; `writes`: to the EEPROM, that it has asked for."""

    outcome: Outcome
    findings: tuple[Finding, ...]
    retries: tuple[str, ...]
    seconds: float
    trouble: str
    recording: Recording | None
    events: tuple[Event, ...]
    writes: int

    def as_result(self, check: Check) -> CheckResult:
        """The same as of a check that has run here."""
        return CheckResult(
            check, self.outcome, self.findings, self.retries, self.seconds, self.trouble,
            self.recording,
        )  # fmt: skip


def _is_clean(result: CheckResult) -> bool:
    """True if there is nothing to look into."""
    done = result.outcome is Outcome.DONE
    return done and not any(finding.verdict in WRONG for finding in result.findings)


# --- in a worker ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Guard:
    """Who looks after a twin that is thrown away afterwards: nothing needs putting back."""

    family: Family

    def guard(self, session: Session, data: bytes) -> None:
        """Raise AssertionError for what the check has not declared."""
        reason = self.family.forbid(session, data)
        assert reason is None, f"held back {data.hex(' ')}: {reason}"

    def restore(self, run: Run) -> None:
        """Nothing: nobody uses this twin again."""

    def is_sane(self, run: Run) -> bool:
        """A twin that has crashed is told by the check."""
        return True


def judge(setup: RunSetup, name: str, seed: int) -> WorkerResult:
    """Run the check of that name on a twin of one's own."""
    family = find_family(setup.model)
    check = next(one for one in family.checks() if one.name == name)
    target = family.open(setup.url, setup.rate, is_builtin=True)
    events: list[Event] = []
    try:
        target.round_trip = setup.round_trip
        run = Run(
            target=target, family=family, model=family.models[setup.model],
            ledger=load_ledger(family.name), address=setup.address, neighbours=setup.neighbours,
            allowed=setup.allowed, envelope=setup.envelope, seed=seed, identity=setup.identity,
            readings=Readings(setup.readings), detections=dict(setup.detections),
            budget=WriteBudget(), emit=events.append, settings=setup.settings,
            unshrunk="found in a process beside the run",
        )  # fmt: skip
        target.meter = lambda data: run.budget.note(family.stored_writes(data))
        if run.envelope.is_guarded:
            target.travel_guard = family.travel_guard(run)
        run.memory = family.remember(Session(run))
        one = Attempts(events.append, _Guard(family)).believed(run, check)
    finally:
        target.close()
    return WorkerResult(
        one.outcome, one.findings, one.retries, one.seconds, one.trouble, one.recording,
        tuple(event for event in events if not isinstance(event, FailureStored)), run.budget.spent,
    )  # fmt: skip


def _be_led(leash: Connection) -> None:
    """Be deaf to interrupts, and end with the process at the other end of the leash."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(leash,), daemon=True).start()


def _end_with(leash: Connection) -> None:
    with contextlib.suppress(EOFError, OSError):
        leash.recv_bytes()  # nothing is ever sent: it ends with the far end
    os._exit(0)


# --- in the run ----------------------------------------------------------------------------------


class Jobs:
    """Workers, `count` of them at most, started as they are needed.

    `emit`: takes a sentence about what did not go as it should.
    """

    def __init__(self, count: int, emit: Callable[[str], None]) -> None:
        self.count = count
        self._tell = emit
        self._pool: ProcessPoolExecutor | None = None
        self._leash: Connection | None = None
        self._begun: dict[tuple[str, int], tuple[dict[str, str], Future[WorkerResult]]] = {}
        self._is_lost = False

    @property
    def ahead(self) -> int:
        """How many checks to begin before their turn so that no worker is ever idle."""
        return self.count + 1 if self.count else 0

    def begin(self, run: Run, check: Check, seed: int) -> None:
        """Let a worker run that check with that seed; nothing where that cannot be."""
        is_mended = run.target.mender is not None  # which a worker would have to find out anew
        if not self.count or self._is_lost or is_mended or "alone" in check.needs:
            return
        with _deaf():  # from the first: a worker that still starts would die of an interrupt
            if self._pool is None:
                self._pool = self._started()
            try:
                future = self._pool.submit(judge, RunSetup.of(run), check.name, seed)
            except BrokenProcessPool as error:
                self._lose(error)
                return
        self._begun[check.name, seed] = dict(run.readings), future

    def judged(self, run: Run, check: Check, here: Judge) -> CheckResult:
        """The result of a check with the run's seed: a worker's if it has one and found nothing
        wrong, else that of `here`, which runs it in this process."""
        told = self._told(run, check)
        if told is None:
            return here(run, check)
        result = told.as_result(check)
        if not _is_clean(result):
            again = here(run, check)
            if not _is_clean(again):
                return again
            self._tell(f"{check.name}: what a worker process found did not come again in this one")
        for event in told.events:
            run.emit(event)
        run.budget.note(told.writes)
        return result

    def _told(self, run: Run, check: Check) -> WorkerResult | None:
        """What a worker says; None if it has to be run here: nobody has begun it, the device has
        shown more of itself since, or the worker was lost."""
        readings, future = self._begun.pop((check.name, run.seed), (None, None))
        if future is None or readings != dict(run.readings):
            return None
        try:
            return future.result()
        except BrokenProcessPool as error:
            self._lose(error)
        except Exception as error:
            self._tell(f"a worker process could not run {check.name}: {describe(error)}")
        return None

    def _started(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")  # nobody forks what has threads
        far_end, self._leash = context.Pipe(duplex=False)
        return ProcessPoolExecutor(
            self.count, mp_context=context, initializer=_be_led, initargs=(far_end,)
        )

    def _lose(self, error: Exception) -> None:
        if not self._is_lost:
            self._is_lost = True
            self._tell(f"a worker process was lost, what it was to do is done here: {error}")

    def close(self) -> None:
        """End the workers, whatever they are doing."""
        if self._pool is None or self._leash is None:
            return
        self._is_lost = True  # nobody need hear of it: they are ended
        with _deaf():
            self._leash.close()
            self._pool.shutdown(cancel_futures=True)
        self._pool = None


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Hold interrupts back for a moment; a process started meanwhile never hears one."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
