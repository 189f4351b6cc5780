"""What a check is handed: the target, its own randomness, its bounds, and words to judge with.

A judgement that holds is counted; one that does not is recorded as a finding and ends the check by
an internal `Stop`.  A requirement that a check names and never judges ends up *not run*: a check
that proves nothing must not look like a pass.
"""

from __future__ import annotations

import random
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NoReturn

from axistwin_conformance.errors import TargetError
from axistwin_conformance.events import MotionSampled
from axistwin_conformance.ledger import Ledger
from axistwin_conformance.registry import Check, Family, Identity, Model
from axistwin_conformance.rig import Rig
from axistwin_conformance.targets import Target
from axistwin_conformance.verdicts import Finding, Verdict

REPLY_TIMEOUT_S = 0.5  # MACS-REPLY-16: no reply time is specified; the ledger sets this for suites
# With one byte in 50 lost, an exchange of 42 bytes fails as often as not: 24 attempts leave 1 in
# 1 000 000 unsettled, and 8 times the same bad reply (mostly: silence) is the device, not the line.
ATTEMPTS = 24
ATTEMPTS_ALIKE = 8
MOTIONS_KEPT = 8  # per check: the first ones and the last, which is the one that failed, if any did
EXCERPT_RECORDS = 60  # of the transcript with a finding: enough for a sequence, still readable

Requirements = str | Sequence[str] | None


class Stop(Exception):  # noqa: N818 - control flow of a check, not an error
    """Ends a check whose findings are recorded already."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """The bounds of motion on this device: `max_travel` increments either way from where the run
    found the axis, `max_speed` increments per second."""

    max_travel: int
    max_speed: int


@dataclass(slots=True)
class Run:
    """What all checks of one run share."""

    target: Target
    family: Family
    model: Model
    ledger: Ledger
    address: int
    neighbours: tuple[int, ...]
    allowed: frozenset[str]
    envelope: Envelope
    seed: int
    identity: Identity | None = None
    rig: Rig | None = None
    memory: Any = None  # what the family's `remember` read; None in a run that is passive only
    readings: dict[str, str] = field(default_factory=dict)  # switch → the reading seen in this run


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
        self.passed: dict[str, int] = {}
        self.motion_count = 0  # sampled so far, kept or not
        self._motions: dict[str, MotionSampled] = {}
        self._started_at = run.target.transcript.position

    @property
    def target(self) -> Target:
        """The device."""
        return self.run.target

    @property
    def model(self) -> Model:
        """The model named by the user."""
        return self.run.model

    @property
    def address(self) -> int:
        """The device's address on its line."""
        return self.run.address

    @property
    def neighbours(self) -> tuple[int, ...]:
        """Addresses of further modules of the family on the same line."""
        return self.run.neighbours

    @property
    def seed(self) -> int:
        """The run's seed; `random` is already derived from it."""
        return self.run.seed

    @property
    def envelope(self) -> Envelope:
        """The bounds of motion."""
        return self.run.envelope

    @property
    def allowed(self) -> frozenset[str]:
        """The safety classes granted to this run."""
        return self.run.allowed

    @property
    def identity(self) -> Mapping[str, str]:
        """What the probe found out about the device."""
        return self.run.identity.values if self.run.identity else {}

    @property
    def memory(self) -> Any:
        """What the device held before anything was changed, as the family's `remember` read it."""
        return self.run.memory

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
        """How long to wait for a reply: the ledger's limit and the line's measured worst."""
        return REPLY_TIMEOUT_S + self.target.round_trip.max_ns / 1e9

    # Exchanges.

    def transact(
        self, request: bytes, missing: Callable[[bytes], int], timeout_s: float | None = None
    ) -> bytes:
        """Send once; return the reply, or what came of it before the time-out.

        `missing(received)` tells how many bytes are still to come, 0 when the reply is complete.
        """
        self.target.drain()
        self.target.send(request)
        timeout_s = self.reply_timeout_s if timeout_s is None else timeout_s
        received = b""
        while (count := missing(received)) > 0:
            arrived = self.target.receive(count, timeout_s)
            if not arrived:
                break
            received += arrived
        return received

    def query(
        self,
        request: bytes,
        missing: Callable[[bytes], int],
        is_good: Callable[[bytes], bool],
        timeout_s: float | None = None,
    ) -> bytes:
        """Like `transact`, for a request that may be repeated without harm.

        What is not good is asked again and each retry is recorded.  The same bad reply every time
        is the device's own and is returned for the check to judge; if the replies keep differing,
        the line is at fault and the check ends inconclusive.
        """
        replies: list[bytes] = []
        for _ in range(ATTEMPTS):
            reply = self.transact(request, missing, timeout_s)
            replies.append(reply)
            # In virtual time there is no noise: what came is what the device said.
            if is_good(reply) or self.target.is_virtual or _is_settled(replies):
                return reply
            self.record_retry(f"{request.hex(' ')} got {reply.hex(' ') or 'nothing'}")
        return self.inconclusive(None, f"{ATTEMPTS} attempts, differing replies: noise on the line")

    def record_retry(self, text: str) -> None:
        """Record trouble on the way that was overcome by asking again."""
        self.retries.append(text)
        self.target.mark(f"asked again: {text}")

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
        admissible, one thing or a list or tuple of them; `actual`: what came.  Raises TypeError
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
        names = self._names(requirement)
        admissible = tuple(
            str(item) for item in (expected if isinstance(expected, list | tuple) else (expected,))
        )
        if self.check is None:  # a hook of the family, between checks: there is nobody to judge
            raise TargetError(f"expected {' or '.join(admissible)}, got {actual}")
        for name in names:
            self._record(name, Verdict.FAIL, text, admissible, str(actual))
        raise Stop

    def info(self, requirement: Requirements, text: str) -> None:
        """Record a value that nobody prescribes; it is reported, not judged."""
        for name in self._names(requirement):
            self._record(name, Verdict.INFO, text)

    def quirk(self, requirement: Requirements, name: str, reading: str) -> None:
        """Record which admissible reading of ambiguity switch `name` the device follows.

        The default reading passes; another one is a quirk.  A device that shows two readings in
        one run follows none: that fails.  Raises ValueError for a switch or reading the ledger
        does not know (our mistake).
        """
        ambiguity = self.run.ledger.ambiguity_of(name)
        ambiguity.check_reading(name, reading)
        before = self.run.readings.setdefault(name, reading)
        self.expect(
            before == reading, requirement, f"{name}={before}, as seen earlier in this run",
            f"{name}={reading}", f"{ambiguity.id}: one reading, held for the whole run",
        )  # fmt: skip
        if reading != ambiguity.default_of(name):
            departs = f", against {', '.join(ambiguity.departs)}" if ambiguity.departs else ""
            text = f"{name}={reading} ({ambiguity.id}: {ambiguity.question}{departs})"
            for one in self._names(requirement):
                self._record(one, Verdict.QUIRK, text)

    def inconclusive(self, requirement: Requirements, text: str) -> NoReturn:
        """Give up: what was seen neither proves nor refutes; the check ends."""
        if self.check is None:
            raise TargetError(text)
        for name in self._names(requirement):
            self._record(name, Verdict.INCONCLUSIVE, text)
        raise Stop

    def not_run(self, requirement: Requirements, reason: str) -> None:
        """Say that this part cannot be shown here and why; the check goes on."""
        for name in self._names(requirement):
            self._record(name, Verdict.NOT_RUN, reason)

    def skip(self, reason: str) -> NoReturn:
        """Say that nothing of this check can be shown here and why; the check ends."""
        self.not_run(None, reason)
        raise Stop

    def note(self, text: str) -> None:
        """Write a line into the transcript, for the reader of a failure."""
        self.target.mark(text)

    def sample(
        self,
        name: str,
        measured: Iterable[tuple[int, int]] = (),
        predicted: Iterable[tuple[int, int, int]] = (),
    ) -> None:
        """Record where the axis was and where it had to be, for the plots of the report.

        `measured`: (time_ns, position), `predicted`: (time_ns, lowest, highest), both in the order
        of time on the target's clock.  Samples given under the same name belong to one motion.
        """
        before = self._motions.get(name)
        if before is None:
            self.motion_count += 1
            if len(self._motions) == MOTIONS_KEPT:
                self._motions.popitem()
        check = self.check.name if self.check else ""
        so_far = before or MotionSampled(check, name, (), ())
        self._motions[name] = MotionSampled(
            check, name, (*so_far.measured, *measured), (*so_far.predicted, *predicted)
        )

    @property
    def motions(self) -> tuple[MotionSampled, ...]:
        """The motions sampled in this check: the first ones and the last."""
        return tuple(self._motions.values())

    def conclude(
        self, trouble: str, verdict: Verdict = Verdict.INCONCLUSIVE
    ) -> tuple[Finding, ...]:
        """Return all findings, one at least for each requirement the check names.

        `trouble`: what befell the check, empty if it ended as it meant to.  After trouble nothing
        counts as passed: the judgements that were still to come might have failed; `verdict` is
        what is said instead.
        """
        said = [finding.requirement for finding in self.findings]
        named = self.check.requirements if self.check else ()
        if trouble:
            rest = [
                Finding(name, verdict, trouble)
                for name in dict.fromkeys([*named, *self.passed])
                if name not in said
            ]
            return tuple(self.findings + rest)
        passes = [
            Finding(name, Verdict.PASS, f"{count} judgements held" if count > 1 else "held")
            for name, count in self.passed.items()
        ]
        silent = [
            Finding(name, Verdict.NOT_RUN, "the check ended without judging it")
            for name in named
            if name not in said and name not in self.passed
        ]
        return tuple(self.findings + passes + silent)

    def _names(self, requirement: Requirements) -> Iterable[str]:
        if requirement is None:
            return self.check.requirements if self.check else ()
        names = (requirement,) if isinstance(requirement, str) else tuple(requirement)
        for name in names:
            if self.check is not None and name not in self.check.requirements:
                raise ValueError(f"{self.check.name} judges {name} but does not declare it")
        return names

    def _record(
        self,
        requirement: str,
        verdict: Verdict,
        text: str,
        expected: tuple[str, ...] = (),
        actual: str | None = None,
    ) -> None:
        excerpt = self.target.transcript.since(self._started_at, EXCERPT_RECORDS)
        wanted = verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.QUIRK)
        self.findings.append(
            Finding(requirement, verdict, text, expected, actual, excerpt if wanted else ())
        )


def _is_settled(replies: Sequence[bytes]) -> bool:
    return len(replies) >= ATTEMPTS_ALIKE and len(set(replies[-ATTEMPTS_ALIKE:])) == 1
