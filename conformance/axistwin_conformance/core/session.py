"""What a check is handed: the target, its own randomness, its bounds, and words to judge with.

A judgement that holds is counted; one that does not is recorded as a finding and ends the check by
an internal `Stop`.  A requirement that a check names and never judges ends up *not run*: a check
that proves nothing must not look like a pass.
"""

from __future__ import annotations

import random
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NoReturn, Protocol, cast

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.errors import AttemptVoid, TargetError
from axistwin_conformance.base.events import Listener
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.line_quality import SILENCE_LIMIT_S, LineQuality, SilenceLimit
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.transcript import Direction, Record
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.core.identity import Identity, Model
from axistwin_conformance.core.profile import Detection
from axistwin_conformance.core.readings import Readings
from axistwin_conformance.core.settings import Envelope as Envelope
from axistwin_conformance.core.travel import Motions
from axistwin_conformance.core.wording import (
    REQUEST,
    Exchange,
    Observation,
    asked_in,
    shown_exchange,
    telling,
)
from axistwin_conformance.transport.kinds import TransportKind
from axistwin_conformance.transport.rig import Rig
from axistwin_conformance.transport.serial import SerialTransport
from axistwin_conformance.transport.transport import Transport, TravelLimiter

REPLY_TIMEOUT_S = 0.5  # MACS-REPLY-16: no reply time is specified; the ledger sets this for suites
QUIET_WAIT_S = 0.1  # how long a line must be quiet before a request is sent again
EXCERPT_RECORDS = 60  # of the transcript with a finding: enough for a sequence, still readable

SHOWN = Observation(REQUEST, is_whole=False)  # by what was sent last

Requirements = str | Sequence[str] | None


@dataclass(frozen=True, slots=True, eq=False)
class Cleanup:
    """What was changed and the device is to get back, beside what the family remembers of it; no
    axis moves meanwhile.

    `what`: in words, as it was.  `restore`: does it from wherever the device has got to, as often
    as it is called, judging nothing; False if that did not work.
    """

    what: str
    restore: Callable[[], bool]


class Stop(Exception):  # noqa: N818 - control flow of a check, not an error
    """Ends a check whose findings are recorded already; its text is for whoever has no findings."""


class DeviceFamily(Protocol):
    """What a session, a check or a sequence may ask of the family; see `family.Family`."""

    @property
    def name(self) -> str:
        """Of the family, and of its ledger."""

    @property
    def models(self) -> Mapping[str, Model]:
        """By their names."""

    @property
    def addresses(self) -> range:
        """Those a device can have."""

    @property
    def rates(self) -> tuple[int, ...]:
        """Those a device can have; none named: any."""

    @property
    def default_rate(self) -> int | None:
        """Of the line or bus; None: as the interface is set."""

    @property
    def transport_kind(self) -> TransportKind:
        """How the devices are reached."""

    def open(self, url: str, rate: int | None, /, *, is_builtin: bool = False) -> Transport:
        """Open the way to a device; raises TargetError."""

    def twin_url(self, model: str, address: int, neighbours: tuple[int, ...]) -> str:
        """The URL of the built-in twin."""

    @property
    def glossary(self) -> Mapping[str, str]:
        """What the abbreviations of the manual stand for."""

    def in_words(self, request: bytes, reply: bytes, /) -> Exchange:
        """Put an exchange into the words of a failure."""

    def driver(self, session: Session, address: int | None = None) -> Any:
        """The device, or the one at an address, as checks and probes handle it."""

    def stop(self, session: Session) -> None:
        """Bring any motion to rest."""

    def remember(self, session: Session) -> Any:
        """Read what is to be put back."""

    def restore(self, session: Session, memory: Any) -> tuple[str, ...]:
        """Put back what differs; a sentence for each thing that could not be."""

    def travel_guard(self, run: Run) -> TravelLimiter | None:
        """What keeps the axes inside the envelope."""


@dataclass(slots=True)
class Run:
    """What all checks of one run share."""

    target: Transport
    family: DeviceFamily
    model: Model
    ledger: Ledger
    address: int
    neighbours: tuple[int, ...]
    allowed: frozenset[str]
    envelope: Envelope
    seed: int
    identity: Identity | None = None
    rig: Rig | None = None
    doubted: set[bytes] = field(default_factory=set)  # requests of which an answer has failed
    memory: Any = None  # what the family's `remember` read; None in a run that is passive only
    answered_wrongly: set[bytes] = field(default_factory=set)  # of the questions between checks
    # What a hook of the family has seen fail, and goes on without: requirement, expected, came.
    violations: list[tuple[str, str, str]] = field(default_factory=list)
    cleanups: list[Cleanup] = field(default_factory=list)  # the last one is to be given back first
    readings: Readings = field(default_factory=Readings)
    detections: dict[str, Detection] = field(default_factory=dict)  # what the probes found out
    # Switch → the end of the transcript when its reading was seen.
    shown: dict[str, tuple[Record, ...]] = field(default_factory=dict)
    budget: WriteBudget = field(default_factory=WriteBudget)
    quality: LineQuality = field(default_factory=LineQuality)
    silence_limit: SilenceLimit = field(default_factory=SilenceLimit)
    emit: Listener = lambda event: None  # who is told of what cannot wait for a check's end
    shrunk: set[str] = field(default_factory=set)  # requirements of which a short failure is known
    unshrunk: str = ""  # why what fails is not shrunk here; empty: it is
    is_interrupted: bool = False  # a check has told what it knew first: now the run is to end
    settings: Any = None  # what the family's options have been set to, beside the envelope
    replied_at: int = -1  # where the transcript was when a device had said all it was asked for
    unasked_starts: int = 0  # how often a device has started anew that nobody had made do so
    # While something is put back: the check that is run right after that, if one is.
    next_check: Check | None = None
    late_s: float = 0.0  # how long a device takes to reply that is slow, or may be

    @property
    def runaway(self) -> str:
        """Why the axes must not be moved any more; empty: they may."""
        travel_guard = self.target.travel_guard
        return "" if travel_guard is None else travel_guard.runaway


class Session:
    """One check's view of the run."""

    def __init__(self, run: Run, check: Check | None = None) -> None:
        self.run = run
        self.check = check
        name = check.name if check else ""
        # Seeded by name, so that a check replayed alone draws what it drew in the whole run.
        self.random = random.Random(run.seed << 32 | zlib.crc32(name.encode()))
        self.findings: list[Finding] = []
        self.retries: list[str] = []
        self.is_strict = run.target.is_lossless  # True: replies are handed on as they come
        self.corrupted: list[str] = []  # what came wrong and was handed on all the same
        self._asked: Counter[bytes] = Counter()
        self._late_count = run.target.lateness.count  # of all that came late before
        self._repeated_count = run.target.lateness.repeated_count  # of these, what came twice
        self.failed_after = (b"", 0)  # what was sent last before the first failure, which time
        self.has_failed = False
        self.recording: Recording | None = None  # the operations that failed, if the check has any
        self.is_replayed = False  # True: the check itself has found out how often they fail
        self.is_reproduced = False  # True: the last reply was wrong, and too often so for noise
        self.passed: dict[str, int] = {}
        self.motions = Motions(name)  # for the plots of the report
        self._named: set[tuple[str, str]] = set()  # requirement, switch: said already
        self._started_at = run.target.transcript.position

    @property
    def transport(self) -> Transport:
        """The way to the device, whatever it carries."""
        return self.run.target

    @property
    def target(self) -> SerialTransport:
        """The device on a byte line, for the families whose devices are on one."""
        return cast(SerialTransport, self.run.target)

    @property
    def address(self) -> int:
        """The device's address on its line."""
        return self.run.address

    @property
    def neighbours(self) -> tuple[int, ...]:
        """Addresses of further modules of the family on the same line."""
        return self.run.neighbours

    @property
    def envelope(self) -> Envelope:
        """The bounds of motion."""
        return self.run.envelope

    @property
    def rig(self) -> Rig:
        """What works inputs, supply and shaft, for a check that needs one."""
        assert self.run.rig is not None, "a check that works the rig names what it needs of it"
        return self.run.rig

    @property
    def readings(self) -> Mapping[str, str]:
        """The readings (switch → value) the device has shown so far in this run."""
        return self.run.readings

    @property
    def reply_timeout_s(self) -> float:
        """How long to wait for a reply: the ledger's limit and the line's measured worst, or until
        that is measured what is known of a slow device."""
        return REPLY_TIMEOUT_S + max(self.transport.round_trip.max_ns / 1e9, self.run.late_s)

    def is_believed(self, bad: list[bytes], reply: bytes, *, is_good: bool) -> bool:
        """True if the reply is the device's own: good, or bad too often for noise.

        `bad`: the earlier bad replies to the same request; this one is added.  Without noise
        (`is_strict`) every reply is the device's own.  Raises TargetError for a device that has
        said nothing right for too long.
        """
        quality = self.run.quality
        self.is_reproduced = False
        if self.transport.is_lossless:
            return True
        if not is_good:
            self._count_bad(reply)
        elif reply:
            if self.run.silence_limit.is_patient:
                took_s = self.transport.transcript.since_sent_s(self.transport.now_ns)
                self.run.late_s = took_s if took_s > REPLY_TIMEOUT_S else 0.0
            self.run.silence_limit.good()
        if not bad:  # a device that never answers right must not make the line look noisy
            # What came twice was hit on its way.
            is_hit = self.transport.lateness.repeated_count > self._repeated_count
            is_late = not is_hit and self.transport.lateness.count > self._late_count
            quality.note(is_corrupted=is_hit or not is_good, is_late=is_late)
        self._late_count = self.transport.lateness.count
        self._repeated_count = self.transport.lateness.repeated_count
        bad.append(reply)
        self._asked[self.transport.last_sent] += 1
        if self.is_strict and not is_good:
            self.corrupted.append(self._numbered(reply))
        self.is_reproduced = not is_good and quality.is_reproduced(bad)
        if self.is_reproduced:
            quality.note_wrong()
        return is_good or self.is_strict or self.is_reproduced

    def _count_bad(self, reply: bytes) -> None:
        """Count a bad reply.  Of a device that would be given up, what came while nobody listened
        shows that it may be slow: it is waited for longer; a silent one is left alone once."""
        limit, transport = self.run.silence_limit, self.transport
        try:
            limit.tried(transport.now_ns, self.run.quality.bad_when_lost, is_silence=not reply)
        except TargetError:
            if limit.may_be_slow and transport.transcript.has_come(limit.since_ns):
                limit.patient_tries -= 1
                self.run.late_s = SILENCE_LIMIT_S
            elif limit.leaves_alone():
                transport.wait(SILENCE_LIMIT_S)
            else:
                self.run.late_s = 0.0 if limit.is_patient else self.run.late_s
                raise

    def note_broken_reply(self, heard: bytes) -> None:
        """Take note of what came broken and cannot be asked for again: the attempt is void, or,
        strictly, it is part of what attempts are compared by.  Raises Disturbed."""
        if self.transport.is_lossless:
            return
        if self.is_strict:
            self.corrupted.append(self._numbered(heard))
        elif self.check is not None:
            self.void_attempt("what came by itself was broken")

    def _numbered(self, reply: bytes) -> str:
        """A bad reply with its number: what is polled all the time is hit by noise now and then,
        but a device is wrong the same time again."""
        asked = self.transport.last_sent
        return f"{asked.hex()}, time {self._asked[asked]}: {reply.hex()}"

    @contextmanager
    def restore_on_exit(self, what: str, restore: Callable[[], bool]) -> Iterator[None]:
        """Restore something at the end of the block (see `Cleanup`).  If the block or the restoring
        is interrupted, or the restoring fails, the device guard does it, and lets nothing come
        between.  What is read meanwhile is read again where noise may be in it, however strict
        the session is: nothing is judged by it."""

        def patiently() -> bool:
            with strictly(self, is_strict=self.run.target.is_lossless):
                return restore()

        cleanup = Cleanup(what, patiently)
        self.run.cleanups.append(cleanup)
        is_interrupted = False
        try:
            yield
        except KeyboardInterrupt:
            is_interrupted = True
            raise
        finally:
            if not is_interrupted and patiently():
                self.run.cleanups.remove(cleanup)

    def records(self, limit: int | None = None) -> tuple[Record, ...]:
        """All that was exchanged in this session, or the end of it."""
        return self.transport.transcript.since(self._started_at, limit)

    def void_attempt(self, text: str) -> NoReturn:
        """Give the attempt up: what was corrupted must not be repeated; the check is replayed."""
        self.transport.mark(f"given up: {text}")
        raise AttemptVoid(text)

    def record_retry(self, text: str) -> None:
        """Record trouble on the way that is overcome by asking again, once the line is quiet:
        a reply that comes late must not be taken for the next one."""
        self.retries.append(text)
        self.transport.mark(f"asked again: {text}")
        self.transport.wait_until_quiet(max(QUIET_WAIT_S, self.run.late_s))

    # Judgements.

    def expect(
        self,
        condition: bool,
        requirement: Requirements,
        expected: object,
        actual: object,
        text: str = "",
    ) -> None:
        """Judge: `condition` holds, or the requirement fails and the check ends.

        `requirement`: an id, several, or None for the one the check names.  `expected`: what is
        admissible, one thing or a list or tuple of them; `actual`: what came, or what gives it in
        words (an `Observation`) once it has failed.  Raises TypeError
        for None in a check that names several: what it shows of which must be said (our mistake).
        """
        if requirement is None and self.check is not None and len(self.check.requirements) > 1:
            raise TypeError(f"{self.check.name} names several requirements: say which is judged")
        names = self._names(requirement)
        if condition:
            for name in names:
                self.passed[name] = self.passed.get(name, 0) + 1
            return
        self.fail(requirement, expected, actual, text)

    def step(self, condition: bool, expected: object, actual: object, text: str = "") -> None:
        """Go on only if a step on the way has worked: one that fails leaves all that the check
        names unmet, one that works proves none of it."""
        if not condition:
            self.fail(None, expected, actual, text)

    def fail(
        self, requirement: Requirements, expected: object, actual: object, text: str = ""
    ) -> NoReturn:
        """Judge that something came which is not admissible; None blames all the check names."""
        self.has_failed = True
        # What only another family's ledger asks is a step here.
        names = tuple(self._names(requirement)) or tuple(self._names(None))
        seen = actual() if callable(actual) else actual
        admissible = tuple(
            str(item) for item in (expected if isinstance(expected, list | tuple) else (expected,))
        )
        if self.check is None:  # a hook of the family, between checks: there is nobody to judge
            raise TargetError(f"expected {' or '.join(admissible)}, got {seen}")
        if not self.failed_after[0]:
            self.failed_after = self.transport.last_sent, self._asked[self.transport.last_sent]
        if names:
            found = failure(self, names[0], admissible, seen, text)
            self.findings += [replace(found, requirement=name) for name in names]
        raise Stop(f"expected {' or '.join(admissible)}, got {seen}")

    def info(self, requirement: Requirements, text: str) -> None:
        """Record a value that nobody prescribes; it is reported, not judged."""
        for name in self._names(requirement):
            self._record(name, Verdict.INFO, text)

    def reading(self, switch: str) -> str:
        """The reading of an ambiguity this device is held to: the detected one, or the default."""
        default = self.run.ledger.ambiguity_of(switch).default_of(switch)
        return str(self.run.readings.get(switch, default))

    def quirk(
        self,
        requirement: Requirements,
        name: str,
        reading: str | Sequence[str],
        shown: Observation = SHOWN,
    ) -> None:
        """Judge which admissible reading of ambiguity switch `name` the device follows here.

        `reading`: the one seen, or all that explain what was seen.  It must be the one detected
        at the beginning of the run, or, if none was, the first one a check saw: a device that
        shows two readings follows none, and that fails.  Another reading than the default is named
        as a quirk, once per requirement.  A question that only the ledger asks which this one
        covers from, has one reading here, the default.  `shown`: what the device did, and by which
        requests, if not by the last one.  Raises ValueError for a switch or reading that no ledger
        knows (our mistake).
        """
        ambiguity = self.run.ledger.ambiguity_of(name)
        seen = (reading,) if isinstance(reading, str) else tuple(reading)
        for one in seen:
            ambiguity.check_reading(name, one)
        held = self._held(name, seen)
        if not set(held) & set(seen):
            self.fail(
                requirement,
                [f"{name}={one}, as it has been in this run so far" for one in held],
                self._other_reading(name, seen, held, shown),
            )
        self.expect(True, requirement, held, seen)
        if ambiguity.default_of(name) in held:
            return
        departs = f", against {', '.join(ambiguity.departs)}" if ambiguity.departs else ""
        text = f"{name}={' or '.join(held)} ({ambiguity.id}: {ambiguity.question}{departs})"
        for one in self._names(requirement):
            if (one, name) not in self._named:
                self._named.add((one, name))
                self._record(one, Verdict.QUIRK, text)

    def _other_reading(
        self, name: str, seen: Sequence[str], held: Sequence[str], shown: Observation
    ) -> Observation:
        """A device that shows two readings of one switch, in words."""
        ambiguity = self.run.ledger.ambiguity_of(name)
        came, before = (
            " or ".join(ambiguity.in_words(name, one) for one in readings)
            for readings in (seen, held)
        )
        value, clause = f"{name}={' or '.join(seen)}", f"{shown.clause}: the device {came}"
        if not self.run.ledger.asks(name):
            return replace(shown, clause=clause, value=value, wanted=f"that it {before}")
        held_to = earlier(self, name)
        held_for = "earlier in this run" if held_to else "by its profile, or all it has shown,"
        clause += f", but {held_for} it {before}"
        return replace(
            shown, value=value, wanted="the same each time", earlier=held_to,
            clause=clause + asked_in(held_to, self.run.family.in_words), rule=ambiguity.rule(name),
        )  # fmt: skip

    def no_reading(
        self,
        requirement: Requirements,
        name: str,
        readings: Iterable[str],
        came: str,
        shown: Observation = SHOWN,
    ) -> NoReturn:
        """Judge that no reading of ambiguity switch `name` explains what came."""
        ambiguity, known = self.run.ledger.ambiguity_of(name), tuple(readings)
        clause = shown.clause if shown is not SHOWN else f"{shown.clause}: {came}"
        wanted = f"that the device {ambiguity.either(name)}"
        seen = replace(shown, clause=clause, value=came, wanted=wanted, rule=ambiguity.rule(name))
        self.fail(requirement, [f"{name}={reading}" for reading in known], seen)

    def _held(self, switch: str, seen: tuple[str, ...]) -> tuple[str, ...]:
        """The readings the device may still follow; what is seen first is held from then on."""
        if not self.run.ledger.asks(switch):
            return (self.run.ledger.ambiguity_of(switch).default_of(switch),)
        known = self.run.readings.get(switch)
        if known is not None:
            return (known,)
        detection = self.run.detections.get(switch)
        left = tuple(detection.candidates) if detection else ()
        fitting = tuple(one for one in left if one in seen) if left else seen
        if len(fitting) == 1:
            self.run.readings[switch] = fitting[0]
            self.run.shown[switch] = self.records(EXCERPT_RECORDS)
        return fitting or left

    def inconclusive(self, requirement: Requirements, text: str) -> NoReturn:
        """Give up: what was seen neither proves nor refutes; the check ends."""
        if self.check is None:
            raise TargetError(text)
        for name in self._names(requirement):
            self._record(name, Verdict.INCONCLUSIVE, text)
        raise Stop(text)

    def not_run(self, requirement: Requirements, reason: str) -> None:
        """Say that this part cannot be shown here and why; the check goes on."""
        for name in self._names(requirement):
            self._record(name, Verdict.NOT_RUN, reason)

    def skip(self, reason: str) -> NoReturn:
        """Say that nothing of this check can be shown here and why; the check ends."""
        self.not_run(None, reason)
        raise Stop(reason)

    def note(self, text: str) -> None:
        """Write a line into the transcript, for the reader of a failure."""
        self.transport.mark(text)

    def conclude(
        self, trouble: str, verdict: Verdict = Verdict.INCONCLUSIVE
    ) -> tuple[Finding, ...]:
        """Return all findings, one at least for each requirement the check names.

        `trouble`: what befell the check, empty if it ended as it meant to.  After trouble nothing
        counts as passed: the judgements that were still to come might have failed; `verdict` is
        what is said instead.
        """
        # A pass is taken back by any trouble, a quirk only by a failure.
        judged = [
            finding.requirement
            for finding in self.findings
            if verdict is not Verdict.FAIL or finding.verdict is Verdict.FAIL
        ]
        transcript = self.records(EXCERPT_RECORDS) if verdict is Verdict.FAIL and trouble else ()
        named = self.check.requirements if self.check else ()
        if trouble:
            rest = [
                Finding(name, verdict, trouble, transcript=transcript)
                for name in dict.fromkeys([*named, *self.passed])
                if name not in judged
            ]
            return tuple(self.findings + rest)
        passes = [
            Finding(name, Verdict.PASS, f"{count} judgements held" if count > 1 else "held")
            for name, count in self.passed.items()
        ]
        silent = [
            Finding(name, Verdict.NOT_RUN, "the check ended without judging it")
            for name in named
            if name not in judged and name not in self.passed
        ]
        return tuple(self.findings + passes + silent)

    def _names(self, requirement: Requirements) -> Iterable[str]:
        if requirement is None:
            return self.check.requirements if self.check else ()
        given = (requirement,) if isinstance(requirement, str) else tuple(requirement)
        names = self.run.ledger.own(given)
        for name in (*names, *(one for one in given if not self.run.ledger.knows(one))):
            if self.check is not None and name not in self.check.requirements:
                raise ValueError(f"{self.check.name} judges {name} but does not declare it")
        return names

    def _record(self, requirement: str, verdict: Verdict, text: str) -> None:
        wanted = verdict in (Verdict.INCONCLUSIVE, Verdict.QUIRK)
        excerpt = self.records(EXCERPT_RECORDS) if wanted else ()
        self.findings.append(Finding(requirement, verdict, text, transcript=excerpt))


@contextmanager
def strictly(session: Session, *, is_strict: bool = True) -> Iterator[None]:
    """Have `session` hand on each reply as it comes in this block, or not; then as before."""
    before, session.is_strict = session.is_strict, is_strict
    try:
        yield
    finally:
        session.is_strict = before


def failure(
    session: Session, requirement: str, expected: Sequence[str], actual: object, text: str = ""
) -> Finding:
    """What failed, in words (see `wording`), with the end of the transcript, and of what was before
    it the lines that matter."""
    records, family = session.records(), session.run.family
    history = partial(session.transport.transcript.since, 0)
    told = telling(records, family.in_words, expected, actual, text, family.glossary, history)
    return told.finding(requirement, expected, actual, text, records, EXCERPT_RECORDS)


def earlier(session: Session, switch: str, *causes: str, did: str = "") -> tuple[Record, ...]:
    """The exchange by which the device has shown its reading of a switch, under a note that says
    so, or what it `did`; `causes`: see `Observation`.  Nothing if that is not known here."""
    run, reading = session.run, session.run.readings.get(switch)
    records = shown_exchange(run.shown.get(switch, ()), run.family.in_words, causes)
    if not records or reading is None:  # several readings explain it
        return ()
    did = did or run.ledger.ambiguity_of(switch).in_words(switch, reading)
    note = f"earlier in this run, the device {did}:"
    return (Record(records[0].time_ns, Direction.NOTE, text=note), *records)
