"""What a run found out: of each check, of each requirement, and as a whole."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from axistwin_conformance.base import events
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.ledger import Requirement
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.verdicts import Finding, Verdict, join_texts, merge
from axistwin_conformance.core.profile import Detection
from axistwin_conformance.engine.plan import Options, Plan


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What came of one check."""

    check: Check
    outcome: Outcome
    findings: tuple[Finding, ...]
    retries: tuple[str, ...]
    seconds: float
    trouble: str
    recording: Recording | None = None  # the operations that failed, if it plays any

    @property
    def verdict(self) -> Verdict:
        """The worst of its findings."""
        return merge(finding.verdict for finding in self.findings)

    def withdrawn(self, reason: str) -> CheckResult:
        """Return the result with every judgement withdrawn: the device was lost under it."""
        withdrawn = (
            replace(
                finding,
                verdict=Verdict.INCONCLUSIVE,
                text=join_texts(f"{finding.verdict}, but {reason}", finding.text),
                sentence=finding.sentence
                and f"{finding.verdict.capitalize()}, but {reason}. {finding.sentence}",
            )
            if finding.verdict.is_judgement
            else finding
            for finding in self.findings
        )
        return replace(
            self, findings=tuple(withdrawn), outcome=Outcome.TROUBLE, trouble=self.trouble or reason
        )

    def as_event(self, number: int, total: int, replay: str) -> events.CheckFinished:
        """Return the event that tells this."""
        return events.CheckFinished(
            number, total, self.check.name, self.outcome, self.verdict, self.findings,
            self.retries, self.seconds, self.trouble, replay,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class RequirementResult:
    """The verdict on one requirement, the reason in a line, and who spoke about it."""

    requirement: Requirement
    verdict: Verdict
    reason: str
    checks: tuple[str, ...]
    findings: tuple[tuple[str, Finding], ...]  # name of the check, what it said

    def as_event(self, armed: Mapping[str, tuple[str, ...]] | None) -> events.RequirementJudged:
        """Return the event that tells this; `armed` as `load_armed` returns it."""
        one = self.requirement
        return events.RequirementJudged(
            one.id, one.kind, tuple(sorted(one.safety)), one.source, one.text, one.not_on_wire,
            None if armed is None else armed.get(one.id, ()),
            self.verdict, self.reason, self.checks, one.where,
        )  # fmt: skip


@dataclass(slots=True)
class Result:
    """All that a run found out."""

    options: Options
    plan: Plan
    checks: list[CheckResult] = field(default_factory=list)
    requirements: tuple[RequirementResult, ...] = ()
    problems: list[str] = field(default_factory=list)
    readings: Mapping[str, str] = field(default_factory=dict)  # switch → the reading seen
    detections: Mapping[str, Detection] = field(default_factory=dict)  # what the probes told
    profile: events.ProfileJudged | None = None  # of the profile that the user gave
    lost: str = ""  # why nothing more was asked of the device before the plan was through
    refusal: str = ""  # why the device was not judged at all: unreachable, or not the model
    is_misused: bool = False  # it was refused for what the operator has named
    is_interrupted: bool = False
    exit_status: int = 0
    sentence: str = ""

    @property
    def has_ended_early(self) -> bool:
        """True if the user wants no more than one failure, and there is one."""
        failed = any(check.verdict is Verdict.FAIL for check in self.checks)
        return failed and self.options.is_exitfirst
