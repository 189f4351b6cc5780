"""What a run tells while it goes: plain values, consumed by reporters and nobody else.

Order: RunStarted, [Identified], (CheckStarted, CheckFinished)*, RequirementJudged*, RunFinished;
Note anywhere between.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from axistwin_conformance.verdicts import Finding, Verdict


class Outcome(StrEnum):
    """How a check ended, whatever it found."""

    DONE = "done"  # it judged
    ERROR = "error"  # it crashed: a mistake of the suite
    TROUBLE = "trouble"  # the port or the device went away under it
    BLOCKED = "blocked"  # not started: the device was lost before
    LEFT_OUT = "left out"  # not started: not allowed, not asked for, or something is missing


@dataclass(frozen=True, slots=True)
class RunStarted:
    """The run begins; `left_out` gives the reason per check that will not run."""

    suite_version: str
    model: str
    target: str
    address: int
    neighbours: tuple[int, ...]
    allowed: tuple[str, ...]
    level: str
    seed: int
    max_travel: int
    max_speed: int
    checks: tuple[str, ...]
    left_out: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Identified:
    """The probe found the model; the idle line's round trip is measured."""

    summary: str
    values: Mapping[str, str]
    round_trip_median_ns: int
    round_trip_max_ns: int


@dataclass(frozen=True, slots=True)
class CheckStarted:
    """A check begins, `number` of `total`."""

    number: int
    total: int
    name: str
    behaviour: str
    requirements: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CheckFinished:
    """A check ended; `verdict` is the worst of its findings, `trouble` says what befell it."""

    number: int
    total: int
    name: str
    outcome: Outcome
    verdict: Verdict
    findings: tuple[Finding, ...]
    retries: tuple[str, ...]
    seconds: float
    trouble: str
    replay: str


@dataclass(frozen=True, slots=True)
class Note:
    """Something a reader should know that is no verdict: a retry, a parameter not put back."""

    text: str


@dataclass(frozen=True, slots=True)
class RequirementJudged:
    """All that is said about one requirement."""

    id: str
    kind: str
    text: str
    verdict: Verdict
    reason: str
    checks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RunFinished:
    """The run is over; `problems` are reasons not to trust it that belong to no requirement."""

    exit_status: int
    sentence: str
    counts: Mapping[Verdict, int]
    problems: tuple[str, ...]
    seconds: float


Event = (
    RunStarted | Identified | CheckStarted | CheckFinished | Note | RequirementJudged | RunFinished
)
Listener = Callable[[Event], None]
