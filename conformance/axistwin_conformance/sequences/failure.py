"""What is done about a sequence of operations that fails: how often it does, how few do, and where.

    a mismatch ─▶ stored at once ─▶ virtual time: shrunk right there
                                └─▶ a real line: played again, k of n times the same
                                      none ─▶ inconclusive
                                      some ─▶ fail; shrunk on the built-in twin with the readings of
                                              this device if it shows the same, and confirmed on the
                                              device; otherwise on the device, within a budget

Every list is played by the family's `Runner`, which does nothing that must not be done whatever the
bytes are: shrinking cannot leave that.
"""

from __future__ import annotations

import urllib.parse
from collections.abc import Callable
from importlib import metadata
from typing import Final, NoReturn

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.errors import AttemptVoid, TargetError, counted
from axistwin_conformance.base.events import FailureStored
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.session import Run, Session, Stop
from axistwin_conformance.sequences.runner import Mismatch, Operations, Runner, SequenceResult
from axistwin_conformance.sequences.shrink import Budget, Shrunk, shrink, towards_zero
from axistwin_conformance.transport.transport import Transport

REPLAYS: Final = 3  # on a line: of the list as found, and at most of the short one
TWIN_BUDGET: Final = Budget(operations=20_000, seconds=6.0)
LINE_BUDGET: Final = Budget(operations=400, seconds=120.0)
STORY_TOLD: Final = 16  # exchanges of a failure that are put into words; the record has them all

Simpler = Callable[[bytes], list[bytes]]


class Failure:
    """A list that failed once on the player's module, and what is found out about it."""

    def __init__(self, runner: Runner, result: SequenceResult) -> None:
        self.runner, self.session = runner, runner.session
        self.found = self.result = result
        self.history: list[str] = []

    @property
    def mismatch(self) -> Mismatch:
        """What did not fit."""
        assert self.result.mismatch is not None, "a failure has one"
        return self.result.mismatch

    def conclude(self) -> NoReturn:
        """Store it, find out what can be found out, and end the check with the verdict.

        An interrupt ends what is still to be found out, and then the run: what is known is told."""
        self._store()
        is_counted, is_cut = self.session.transport.is_lossless, False
        try:
            # Attempts in which replies are handed on as they come are compared with one another:
            # there it is the engine that plays the whole check again.
            if not is_counted and not self.session.is_strict:
                self._count()
                self.session.is_replayed = is_counted = True
            if is_counted:
                self._shrink_once()
        except KeyboardInterrupt:
            is_cut = True
        if is_cut:  # what is raised here, has no interrupt behind it
            self._cut_short(is_counted)
        self._store()
        self._fail()

    def _cut_short(self, is_counted: bool) -> None:
        """The run is to end; raises Stop where nobody knows yet whether the failure comes again."""
        self.session.run.is_interrupted = self.session.is_replayed = True
        if is_counted:
            self.history.append("interrupted before it was as short as can be")
            return
        requirement = self.mismatch.requirement
        self.runner.credit(requirement)
        text = f"{self.mismatch}; interrupted before it was played again"
        self.session.inconclusive(requirement, text)

    def _store(self) -> None:
        session, mismatch = self.session, self.mismatch
        recording = session.recording = Recording(
            session.run.model.name,
            self.result.operations,
            check=session.check.name if session.check else "",
            seed=session.run.seed,
            requirement=", ".join(session.run.ledger.own((mismatch.requirement,))),
            expected=mismatch.expected,
            actual=mismatch.actual,
            words=self.result.words,
            readings=dict(session.readings),
            suite_version=metadata.version("axistwin"),
            found=b"".join(self.found.operations),
            history=tuple(self.history),
        )
        session.run.emit(FailureStored(recording.check, recording))

    def _fail(self) -> NoReturn:
        mismatch = self.mismatch
        told = (
            ("...", *mismatch.story[-STORY_TOLD:])
            if len(mismatch.story) > STORY_TOLD
            else (mismatch.story)
        )
        self.runner.credit(mismatch.requirement)
        self.session.fail(
            mismatch.requirement,
            mismatch.expected,
            mismatch.actual,
            "; ".join([*self.history, f"after: {'; '.join(told)}"]),
        )

    # On a line: how often.

    def _count(self) -> None:
        """Play it again; raises Stop with an inconclusive verdict if that is not enough to say."""
        session, quality = self.session, self.session.run.quality
        needed = quality.alike_needed - 1 if quality.is_noisy else 1
        wanted = max(REPLAYS, 2 * needed) if quality.is_noisy else REPLAYS
        times = self._times(self.result.operations, wanted)
        self.history.append(f"reproduced {times} of {wanted}")
        if times >= needed:
            return
        text = f"{self.mismatch}; it came again in {times} of {wanted} replays"
        if quality.is_noisy and not times:
            session.void_attempt(f"{text}: taken for noise ({quality})")
        session.is_replayed = True
        self._store()
        self.runner.credit(self.mismatch.requirement)
        session.inconclusive(self.mismatch.requirement, text)

    def _times(self, operations: Operations, wanted: int) -> int:
        times = 0
        for _ in range(wanted):
            try:
                times += self._is_same(self.runner.run(operations))
            except AttemptVoid:  # told as not reproduced: nobody has seen it
                continue
        return times

    def _is_same(self, result: SequenceResult) -> bool:
        same = result.mismatch
        return same is not None and same.requirement == self.mismatch.requirement

    # How few.

    def _shrink_once(self) -> None:
        """Once in a run for each requirement: a soak may meet the same failure a thousand times."""
        run = self.session.run
        if run.unshrunk:
            self.history.append(f"not shrunk: {run.unshrunk}")
            return
        if self.mismatch.requirement in run.shrunk:
            self.history.append("not shrunk: the same requirement has failed before in this run")
            return
        run.shrunk.add(self.mismatch.requirement)
        self._shrink()

    def _shrink(self) -> None:
        """Make it as short as can be; what is kept has failed on this device, and is played last,
        with its motion recorded for the report."""
        if self.session.transport.is_lossless:
            self._refresh()
            shorter = self._shrunk(
                self.runner, self.found.operations, TWIN_BUDGET, "in virtual time", self._simpler
            )[-1:]
        else:
            if any(self._confirmed(one) for one in self._shrunk_on_twin()):
                return
            # What fails now and then shrinks to what fails once: then a longer list may fail more.
            steps = self._shrunk(
                self.runner, self.found.operations, LINE_BUDGET, "on the device", _without_pause
            )
            shorter = tuple(dict.fromkeys((steps[-1], steps[len(steps) // 2])))
        if not any(self._confirmed(one) for one in (*shorter, self.found.operations)):
            self.history.append("told as found")

    def _refresh(self) -> None:
        """Play from a fresh start from now on, if the list fails then."""
        self.runner.is_fresh = True
        if not self._is_same(self.runner.run(self.found.operations)):
            self.runner.is_fresh = False
            words = f"it does not fail after {self.runner.beginning}"
            self.history.append(f"{words}: what came before has a part in it")

    def _confirmed(self, operations: Operations) -> bool:
        """Play the short list until it fails; the only playing whose motion is recorded."""
        tries = 1 if self.session.transport.is_lossless else REPLAYS
        for number in range(1, tries + 1):
            try:
                result = self.runner.run(operations, is_plotted=True)
            except AttemptVoid:
                continue
            if self._is_same(result):
                self.result = result
                if tries > 1:
                    words = f"{len(operations)} operations failed in run {number} of {tries}"
                    self.history.append(f"on the device the {words}")
                return True
        runs = counted(tries, "run")
        self.history.append(f"{len(operations)} operations did not fail again in {runs}")
        return False

    def _shrunk(
        self, runner: Runner, operations: Operations, budget: Budget, where: str, simpler: Simpler
    ) -> tuple[Operations, ...]:
        """Shrink with this player, give all that failed on the way, the shortest last; what cannot
        be played any more ends it."""
        trouble: list[str] = []

        def fails(operations: Operations) -> bool:
            try:
                return not trouble and self._is_same(runner.run(operations))
            except AttemptVoid:
                return False
            except (TargetError, Stop) as error:
                trouble.append(str(error))
                return False

        short = shrink(operations, fails, budget, simpler)
        self.history.append(_told(operations, short, budget, where))
        self.history += [f"shrinking met trouble: {one}" for one in trouble]
        return short.steps

    def _shrunk_on_twin(self) -> tuple[Operations, ...]:
        """Shrink on a twin with the readings of this device: what is as small as can be, and, since
        the device may be slower, what has its pauses and places as found.  Nothing if it does not
        fail alike."""
        try:
            twin = open_twin(self.session)
        except TargetError as error:
            self.history.append(f"no twin to shrink on: {error}")
            return ()
        try:
            other = self.runner.on(twin_session(self.session, twin))
            other.is_fresh = True
            if not self._is_same(other.run(self.found.operations)):
                self.history.append("the built-in twin, read alike, does not fail")
                return ()
            where = "on the built-in twin, which fails alike"
            fewer = self._shrunk(other, self.found.operations, TWIN_BUDGET, where, _as_it_is)[-1]
            where = "with smaller arguments"
            return self._shrunk(other, fewer, TWIN_BUDGET, where, self._simpler)[-1], fewer
        except (TargetError, Stop) as error:
            self.history.append(f"the twin could not play it: {error}")
            return ()
        finally:
            twin.close()

    def _simpler(self, operation: bytes) -> list[bytes]:
        return list(towards_zero(operation, self.runner.arguments))


def _as_it_is(operation: bytes) -> list[bytes]:
    return []


def _without_pause(operation: bytes) -> list[bytes]:
    return [operation[:-1] + b"\0"] if operation[-1] else []


def _told(found: Operations, short: Shrunk[bytes], budget: Budget, where: str) -> str:
    end = "" if short.is_minimal else f", ended by its budget ({budget})"
    return (
        f"shrunk from {len(found)} to {len(short.operations)} operations {where}:"
        f" {short.tries} runs, {short.performed} operations, {short.seconds:.1f} s{end}"
    )


# --- the twin of this device ---------------------------------------------------------------------


def open_twin(session: Session) -> Transport:
    """The built-in twin, made with the readings this device has shown; raises TargetError."""
    run = session.run
    url = run.family.twin_url(run.model.name, run.address, run.neighbours)
    for switch, reading in sorted(session.readings.items()):
        if reading != run.ledger.ambiguity_of(switch).default_of(switch):
            url += f"&quirk.{switch}={urllib.parse.quote(reading, safe='+')}"
    rate = session.transport.rate
    if rate is not None and rate != run.family.default_rate:
        url += f"&{run.family.transport_kind.rate_parameter}={rate}"
    return run.family.open(url, rate, is_builtin=True)


def twin_session(session: Session, twin: Transport) -> Session:
    """A session with that twin, as bounded as with the device."""
    run = session.run
    other = Run(
        target=twin, family=run.family, model=run.model, ledger=run.ledger, address=run.address,
        neighbours=run.neighbours, allowed=frozenset(SAFETY_CLASSES), envelope=run.envelope,
        settings=run.settings,
        seed=run.seed, readings=Readings(run.readings), detections=dict(run.detections),
    )  # fmt: skip
    if run.envelope.is_guarded:
        twin.travel_guard = run.family.travel_guard(other)
    alone = Session(other)
    other.memory = run.family.remember(alone)
    return alone
