"""What a run tells while it goes: plain values, consumed by reporters and nobody else.

Order: RunStarted, [Identified], (CheckStarted, FailureStored*, MotionSampled*, PathSampled*,
CheckFinished)*,
ReadingSeen*, ReadingUnknown*, [ProfileJudged], RequirementJudged*, RunFinished; Note, RigQuestion,
QuestionAsked, StatesCovered and SoakProgress anywhere between.  In a soak a round that finds
nothing has no CheckFinished.
A check numbered 0 is none of the plan: it tells what the device failed while no check was judging,
and may stand before `Identified` and between two others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from axistwin_conformance.base.recording import Recording
from axistwin_conformance.base.verdicts import Finding, Verdict


class Outcome(StrEnum):
    """How a check ended, whatever it found."""

    DONE = "done"  # it judged
    ERROR = "error"  # it crashed: a mistake of the suite
    TROUBLE = "trouble"  # the port or the device went away under it
    BLOCKED = "blocked"  # not started: the device was lost before
    LEFT_OUT = "left out"  # not started: not allowed, not asked for, or something is missing


@dataclass(frozen=True, slots=True)
class RunStarted:
    """The run begins; `left_out` gives the reason per check that will not run.

    `started_at`: UTC, ISO 8601.  `command`: starts this run again.
    `carrier`: line or bus; `baud`: of our end of the line, None on a bus; `bitrate`: of the bus in
    bit/s, None on a line and where its interface has one of its own.  `max_travel`, `max_speed`:
    None where the suite drives no axis.  `grounds`: what of a controller is the suite's to use, by
    the name of the option that says so.  `questions`: how many the device is asked about its
    readings.
    """

    suite_version: str
    started_at: str
    command: str
    model: str
    target: str
    carrier: str
    baud: int | None
    bitrate: int | None
    address: int
    neighbours: tuple[int, ...]
    allowed: tuple[str, ...]
    level: str
    seed: int
    max_travel: int | None
    max_speed: int | None
    checks: tuple[str, ...]
    left_out: Mapping[str, str]
    grounds: Mapping[str, str] = field(default_factory=dict)
    questions: int = 0


@dataclass(frozen=True, slots=True)
class Identified:
    """The probe found the model; the round trip is measured while nothing else is said."""

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
class MotionSampled:
    """A motion under a check: where the axis was, and where it had to be.

    `measured`: (time_ns, position).  `predicted`: (time_ns, lowest, highest), the band outside of
    which a measurement fails.  Times are the target's clock, positions the device's increments.
    """

    check: str
    name: str
    measured: tuple[tuple[int, int], ...]
    predicted: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True, slots=True)
class PathSampled:
    """Where two axes of a motion under a check were at one time, and where they had to be.

    `points`: (time_ns, x, y, lowest x, highest x, lowest y, highest y), in the order of time;
    `axes`: what x and y are.
    """

    check: str
    name: str
    axes: tuple[str, str]
    points: tuple[tuple[int, ...], ...]


@dataclass(frozen=True, slots=True)
class FailureStored:
    """Operations after which a device failed, told at once; told again when they are fewer."""

    check: str
    recording: Recording


@dataclass(frozen=True, slots=True)
class StatesCovered:
    """What random operations have met: state of the model → operation → how often it was answered
    in it."""

    check: str
    sequences: int
    operations: int
    counts: Mapping[str, Mapping[str, int]]

    @property
    def text(self) -> str:
        """That in a line."""
        states = [
            f"{state} {sum(operations.values())}"
            for state, operations in sorted(self.counts.items())
        ]
        pairs = sum(map(len, self.counts.values()))
        return (
            f"{self.check}: {self.operations} operations in {self.sequences} sequences; answered"
            f" in {', '.join(states)}; different pairs of state and operation: {pairs}"
        )


@dataclass(frozen=True, slots=True)
class SoakProgress:
    """A round of a soak begins."""

    round: int
    seed: int
    elapsed_s: float
    duration_s: float


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
class ReadingSeen:
    """The reading of an ambiguity that the device follows; `departs`: requirements it goes against
    if the reading is not the default; `evidence`: what was done and came."""

    switch: str
    reading: str
    default: str
    ambiguity: str
    question: str
    departs: tuple[str, ...]
    evidence: str = ""


@dataclass(frozen=True, slots=True)
class ReadingUnknown:
    """An ambiguity of which nobody knows how the device reads it, and why."""

    switch: str
    ambiguity: str
    question: str
    reason: str


@dataclass(frozen=True, slots=True)
class Departure:
    """A switch that the device does not read as its profile says; `found`: several readings where
    they were not told apart."""

    switch: str
    expected: str
    found: tuple[str, ...]
    ambiguity: str
    question: str
    evidence: str

    @property
    def text(self) -> str:
        """That in a line."""
        found = " or ".join(self.found)
        return f"{self.switch} is {found}, the profile says {self.expected}"


@dataclass(frozen=True, slots=True)
class ProfileJudged:
    """What came of holding the device to a profile that the user gave, in the file `profile`.

    `unseen`: switches that it names and of which nobody knows how the device reads them.
    """

    profile: str
    verdict: Verdict
    reason: str
    departures: tuple[Departure, ...]
    unseen: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RigQuestion:
    """Somebody is being asked at the terminal (`is_open`), or has answered."""

    is_open: bool
    text: str


@dataclass(frozen=True, slots=True)
class QuestionAsked:
    """One more question is put to the device: which reading of a switch it follows."""

    switch: str


@dataclass(frozen=True, slots=True)
class RequirementJudged:
    """All that is said about one requirement.

    `not_on_wire`: why no exchange can show it.  `armed`: the planted firmware faults that checks
    naming this requirement have found; empty: not armed; None: nobody has looked.  `where`: title
    and chapter of the source.
    """

    id: str
    kind: str
    safety: tuple[str, ...]
    source: str
    text: str
    not_on_wire: str
    armed: tuple[str, ...] | None
    verdict: Verdict
    reason: str
    checks: tuple[str, ...]
    where: str = ""


@dataclass(frozen=True, slots=True)
class RunFinished:
    """The run is over; `problems` are reasons not to trust it that belong to no requirement.

    `eeprom_writes`: how many the run asked for and the device has not refused, all it put back
    included; `eeprom_budget`: how many it was given, None for any number.  `counts`: of the
    requirements, and of the profile if one was given.
    """

    exit_status: int
    sentence: str
    counts: Mapping[Verdict, int]
    problems: tuple[str, ...]
    seconds: float
    eeprom_writes: int = 0
    eeprom_budget: int | None = None


Event = (
    RunStarted
    | Identified
    | CheckStarted
    | MotionSampled
    | PathSampled
    | FailureStored
    | StatesCovered
    | SoakProgress
    | CheckFinished
    | Note
    | RigQuestion
    | QuestionAsked
    | ReadingSeen
    | ReadingUnknown
    | ProfileJudged
    | RequirementJudged
    | RunFinished
)
Listener = Callable[[Event], None]
