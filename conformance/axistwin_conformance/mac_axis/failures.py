"""What is done about a sequence of operations that fails: how often it does, how few do, and where.

    a mismatch ─▶ stored at once ─▶ virtual time: shrunk right there
                                └─▶ a real line: played again, k of n times the same
                                      none ─▶ inconclusive
                                      some ─▶ fail; shrunk on the built-in twin with the readings of
                                              this device if it shows the same, and confirmed on the
                                              device; otherwise on the device, within a budget

Every list is played by `sequences`, which keeps the axis inside the envelope whatever the bytes
are: shrinking cannot leave it.
"""

from __future__ import annotations

import urllib.parse
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import metadata
from typing import Final, NoReturn

from axistwin_conformance.carrier import Carrier
from axistwin_conformance.errors import TargetError
from axistwin_conformance.events import StatesCovered
from axistwin_conformance.mac_axis.bench import Bench, Sample, bench_of
from axistwin_conformance.mac_axis.forecast import Forecast
from axistwin_conformance.mac_axis.model import AxisModel
from axistwin_conformance.mac_axis.operations import OPERATIONS, operations_of
from axistwin_conformance.mac_axis.sequences import (
    BYTES_PER_OPERATION,
    OPEN_STOPS,
    Mismatch,
    Sequence,
    begin,
    read_parameters,
)
from axistwin_conformance.noise import Disturbed
from axistwin_conformance.recording import Recording
from axistwin_conformance.registry import SAFETY_CLASSES
from axistwin_conformance.session import Run, Session, Stop
from axistwin_conformance.shrink import Budget, Shrunk, shrink, towards_zero

REPLAYS: Final = 3  # on a line: of the list as found, and at most of the short one
PLAY_ATTEMPTS: Final = 5  # of one list that noise breaks off
TWIN_BUDGET: Final = Budget(operations=20_000, seconds=6.0)
LINE_BUDGET: Final = Budget(operations=400, seconds=120.0)
ARGUMENTS: Final = (3, 1, 2)  # the bytes that shrinking makes smaller: the pause first
STORY_TOLD: Final = 16  # exchanges of a failure that are put into words; the record has them all

Operations = tuple[bytes, ...]
Simpler = Callable[[bytes], list[bytes]]


def split(data: bytes, kinds: int = len(OPERATIONS)) -> Operations:
    """Cut bytes into operations, each told by its lowest number: one that stays when there are
    more kinds of operations than these."""
    whole = range(0, len(data) - BYTES_PER_OPERATION + 1, BYTES_PER_OPERATION)
    return tuple(
        bytes([data[at] % kinds]) + data[at + 1 : at + BYTES_PER_OPERATION] for at in whole
    )


@dataclass(slots=True)
class Tally:
    """What sequences have judged and met."""

    judged: Counter[str] = field(default_factory=Counter)  # requirement → judgements
    operated: Counter[tuple[str, str]] = field(default_factory=Counter)  # state, operation
    sequences: int = 0

    def add(self, run: Sequence) -> None:
        """Count a sequence that has been played."""
        self.judged += run.judged
        self.operated += run.operated
        self.sequences += 1


@dataclass(frozen=True, slots=True)
class Played:
    """One playing of a list: what did not fit, if anything, and what each operation did."""

    operations: Operations  # those that were begun
    mismatch: Mismatch | None
    words: tuple[str, ...]


class Player:
    """Plays operations on one module, always from the same beginning."""

    def __init__(self, bench: Bench, home: int) -> None:
        self.bench, self.home = bench, home
        self.tally = Tally()
        # Beginning with 00h, a list cannot fail by what another one has left behind.  It costs 2 s
        # of deafness, so only where time is free.
        self.is_fresh = False
        self._last: Sequence | None = None
        bench.is_plotting = False  # or the ways home of all sequences would fill the report

    def play(
        self, operations: Operations, *, is_counted: bool = False, is_plotted: bool = False
    ) -> Played:
        """Play a list; one that noise breaks off begins anew, and raises Disturbed in the end."""
        for attempt in range(PLAY_ATTEMPTS, 0, -1):
            try:
                return self._once(operations, is_counted, is_plotted)
            except Disturbed:
                if attempt == 1:
                    raise
                self.bench.session.retries.append(
                    "a sequence was broken off by noise and begins anew"
                )
        raise AssertionError("the last attempt returns or raises")

    def split(self, data: bytes) -> Operations:
        """Cut bytes into operations of this module's table."""
        return split(data, len(operations_of(self.bench)))

    def begin(self) -> Sequence:
        """A sequence that begins where every sequence begins."""
        again = None if self.is_fresh or self._last is None else self._last.again()
        if again is None:
            if self.is_fresh:
                self.bench.reinitialise()
            for index, parameter in OPEN_STOPS:
                self.bench.command(index, parameter)
            again = begin(self.bench, self.home, model_of)
        self._last = again
        return again

    def _once(self, operations: Operations, is_counted: bool, is_plotted: bool) -> Played:
        run = self.begin()
        if is_plotted:
            run.watch = self._plot
            self.bench.session.note(f"here {len(operations)} operations begin")
        mismatch = None
        try:
            run.play(b"".join(operations))
        except Mismatch as found:
            mismatch = found
        if is_counted:
            self.tally.add(run)
        words = () if mismatch is None else _words(run)
        return Played(operations[: len(run.marks)], mismatch, words)

    def _plot(self, forecast: Forecast, sample: Sample, slack: int) -> None:
        self.bench.is_plotting = True
        self.bench.plot(forecast, sample, slack)
        self.bench.is_plotting = False

    def credit(self, failed: str = "") -> None:
        """Let count as held what was really judged, and tell what was met; `failed` does not."""
        session, tally = self.bench.session, self.tally
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
        session.run.tell(StatesCovered(name, tally.sequences, total, counts))


def _words(run: Sequence) -> tuple[str, ...]:
    """What each operation sent, heard and waited."""
    story = run.story
    ends = [*run.marks[1:], len(story)]
    return tuple("; ".join(story[begun:end]) for begun, end in zip(run.marks, ends, strict=False))


def model_of(bench: Bench) -> AxisModel:
    """The model of a module at rest, held to the readings it has shown."""
    ledger, seen = bench.session.run.ledger, bench.session.readings
    readings = {
        switch: ledger.ambiguity_of(switch).switches[switch].index(reading)
        for switch, reading in seen.items()
        if reading in ledger.ambiguity_of(switch).switches[switch]
    }
    parameters = read_parameters(bench)
    return AxisModel(parameters, Forecast.rest(0), readings, bench.law, bench.acceptance)


# --- a failure -----------------------------------------------------------------------------------


class Failure:
    """A list that failed once on the player's module, and what is found out about it."""

    def __init__(self, player: Player, played: Played) -> None:
        self.player, self.session = player, player.bench.session
        self.found = self.played = played
        self.history: list[str] = []

    @property
    def mismatch(self) -> Mismatch:
        """What did not fit."""
        assert self.played.mismatch is not None, "a failure has one"
        return self.played.mismatch

    def settle(self) -> NoReturn:
        """Store it, find out what can be found out, and end the check with the verdict."""
        self._store()
        # Attempts in which replies are handed on as they come are compared with one another: there
        # it is the engine that plays the whole check again.
        if self.session.carrier.is_lossless:
            self._shrink_once()
        elif not self.session.is_strict:
            self._count()
            self.session.is_replayed = True
            self._shrink_once()
        self._store()
        self._fail()

    def _store(self) -> None:
        session, mismatch = self.session, self.mismatch
        session.record(
            Recording(
                session.model.name,
                self.played.operations,
                check=session.check.name if session.check else "",
                seed=session.seed,
                requirement=", ".join(session.run.ledger.own((mismatch.requirement,))),
                expected=mismatch.expected,
                actual=mismatch.actual,
                words=self.played.words,
                readings=dict(session.readings),
                suite_version=metadata.version("axistwin"),
                found=b"".join(self.found.operations),
                history=tuple(self.history),
            )
        )

    def _fail(self) -> NoReturn:
        mismatch = self.mismatch
        told = (
            ("...", *mismatch.story[-STORY_TOLD:])
            if len(mismatch.story) > STORY_TOLD
            else (mismatch.story)
        )
        self.player.credit(mismatch.requirement)
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
        times = self._times(self.played.operations, wanted)
        self.history.append(f"reproduced {times} of {wanted}")
        if times >= needed:
            return
        text = f"{self.mismatch}; it came again in {times} of {wanted} replays"
        if quality.is_noisy and not times:
            session.disturbed(f"{text}: taken for noise ({quality})")
        session.is_replayed = True
        self._store()
        self.player.credit(self.mismatch.requirement)
        session.inconclusive(self.mismatch.requirement, text)

    def _times(self, operations: Operations, wanted: int) -> int:
        times = 0
        for _ in range(wanted):
            try:
                times += self._is_same(self.player.play(operations))
            except Disturbed:  # told as not reproduced: nobody has seen it
                continue
        return times

    def _is_same(self, played: Played) -> bool:
        same = played.mismatch
        return same is not None and same.requirement == self.mismatch.requirement

    # How few.

    def _shrink_once(self) -> None:
        """Once in a run for each requirement: a soak may meet the same failure a thousand times."""
        run = self.session.run
        if not run.shrinks:
            self.history.append("not shrunk: found in a process beside the run")
            return
        if self.mismatch.requirement in run.shrunk:
            self.history.append("not shrunk: the same requirement has failed before in this run")
            return
        run.shrunk.add(self.mismatch.requirement)
        self._shrink()

    def _shrink(self) -> None:
        """Make it as short as can be; what is kept has failed on this device, and is played last,
        with its motion recorded for the report."""
        if self.session.carrier.is_lossless:
            self._refresh()
            shorter = self._shrunk(
                self.player, self.found.operations, TWIN_BUDGET, "in virtual time", _simpler
            )[-1:]
        else:
            if any(self._confirmed(one) for one in self._shrunk_on_twin()):
                return
            # What fails now and then shrinks to what fails once: then a longer list may fail more.
            steps = self._shrunk(
                self.player, self.found.operations, LINE_BUDGET, "on the device", _without_pause
            )
            shorter = tuple(dict.fromkeys((steps[-1], steps[len(steps) // 2])))
        if not any(self._confirmed(one) for one in (*shorter, self.found.operations)):
            self.history.append("told as found")

    def _refresh(self) -> None:
        """Play from a fresh start from now on, if the list fails then."""
        self.player.is_fresh = True
        if not self._is_same(self.player.play(self.found.operations)):
            self.player.is_fresh = False
            self.history.append("it does not fail after 00h: what came before has a part in it")

    def _confirmed(self, operations: Operations) -> bool:
        """Play the short list until it fails; the only playing whose motion is recorded."""
        tries = 1 if self.session.carrier.is_lossless else REPLAYS
        for number in range(1, tries + 1):
            try:
                played = self.player.play(operations, is_plotted=True)
            except Disturbed:
                continue
            if self._is_same(played):
                self.played = played
                if tries > 1:
                    words = f"{len(operations)} operations failed in run {number} of {tries}"
                    self.history.append(f"on the device the {words}")
                return True
        self.history.append(f"{len(operations)} operations did not fail again in {tries} runs")
        return False

    def _shrunk(
        self, player: Player, operations: Operations, budget: Budget, where: str, simpler: Simpler
    ) -> tuple[Operations, ...]:
        """Shrink with this player, give all that failed on the way, the shortest last; what cannot
        be played any more ends it."""
        trouble: list[str] = []

        def fails(operations: Operations) -> bool:
            try:
                return not trouble and self._is_same(player.play(operations))
            except Disturbed:
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
            other = twin_player(self.session, twin)
            other.is_fresh = True
            if not self._is_same(other.play(self.found.operations)):
                self.history.append("the built-in twin, read alike, does not fail")
                return ()
            where = "on the built-in twin, which fails alike"
            fewer = self._shrunk(other, self.found.operations, TWIN_BUDGET, where, _as_it_is)[-1]
            where = "with smaller arguments"
            return self._shrunk(other, fewer, TWIN_BUDGET, where, _simpler)[-1], fewer
        except (TargetError, Stop) as error:
            self.history.append(f"the twin could not play it: {error}")
            return ()
        finally:
            twin.close()


def _as_it_is(operation: bytes) -> list[bytes]:
    return []


def _simpler(operation: bytes) -> list[bytes]:
    return list(towards_zero(operation, ARGUMENTS))


def _without_pause(operation: bytes) -> list[bytes]:
    return [operation[:-1] + b"\0"] if operation[-1] else []


def _told(found: Operations, short: Shrunk[bytes], budget: Budget, where: str) -> str:
    end = "" if short.is_minimal else f", ended by its budget ({budget})"
    return (
        f"shrunk from {len(found)} to {len(short.operations)} operations {where}:"
        f" {short.tries} runs, {short.played} operations, {short.seconds:.1f} s{end}"
    )


# --- the twin of this device ---------------------------------------------------------------------


def open_twin(session: Session) -> Carrier:
    """The built-in twin, made with the readings this device has shown; raises TargetError."""
    run = session.run
    url = run.family.twin_url(run.model.name, run.address, run.neighbours)
    for switch, reading in sorted(session.readings.items()):
        if reading != run.ledger.ambiguity_of(switch).default_of(switch):
            url += f"&quirk.{switch}={urllib.parse.quote(reading, safe='+')}"
    rate = session.carrier.rate
    if rate is not None and rate != run.family.default_rate:
        url += f"&{run.family.way.rate_parameter}={rate}"
    return run.family.open(url, rate, is_builtin=True)


def twin_player(session: Session, twin: Carrier) -> Player:
    """Somebody who plays on that twin, as bounded as on the device."""
    run = session.run
    other = Run(
        target=twin, family=run.family, model=run.model, ledger=run.ledger, address=run.address,
        neighbours=run.neighbours, allowed=frozenset(SAFETY_CLASSES), envelope=run.envelope,
        grounds=run.grounds,
        seed=run.seed, readings=dict(run.readings), detections=dict(run.detections),
    )  # fmt: skip
    if run.family.fence is not None and run.envelope.is_fenced:
        twin.fence = run.family.fence(other)
    alone = Session(other)
    other.memory = run.family.remember(alone)
    bench = bench_of(alone)
    return Player(bench, bench.ready())


def settle(player: Player, data: bytes, mismatch: Mismatch) -> NoReturn:
    """End the check with the verdict on a mismatch that came of these operations, whoever has
    played them."""
    Failure(player, Played(player.split(data), mismatch, ())).settle()
