"""What a check found wrong, in the words that terminal, page and build server share.

A check that fails breaks several requirements by one exchange more often than not: what was seen is
said once, and below it what the manual asks.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from axistwin_conformance.base.ledger import ELSEWHERE, LEFT_OPEN

NO_MANUAL: Final = "none"  # begins the source of what no manual asks
GROUNDS: Final = {
    "derived": "concluded from what is said there",
    "interpretation": "the suite's interpretation of it",
}
TAKEN_OVER: Final = "taken to hold for it as well"
REQUIRED: Final = "required"  # stands before what is asked of the device
OWN_RULE: Final = "a rule of the suite; the manual does not cover it"
# Whose rule it is, before anything else is said.
STATED: Final = "the manual demands"
CONCLUDED: Final = "concluded from the manual"
ELSEWHERE_STATED: Final = "concluded from the manual of another device"
INTERPRETED: Final = "the manual leaves it open; demanded by this suite"
OWN: Final = "demanded by this suite only"
TIMES: Final = (
    "time in ms: host lines when sending began, device lines at the last byte; 'N ms after' a"
    " request counts from the time of its line"
)
SHOWN: Final = ("fail", "inconclusive")
NUMBER: Final = re.compile(r"-?\b[0-9][0-9A-F.]*\b(?!h)")  # not the number of a command
ALSO: Final = "also fails, likely by the same cause"
LAST_PROBLEMS: Final = 3  # of a run that are told at once: the state it ended in
DECISIVE_RECORDS: Final = 3  # of a transcript: they led to the verdict


@dataclass(slots=True)
class Statement:
    """One thing that was seen: in a sentence, and what there is to add to it.

    `requirements`: what it breaks, or leaves open, the one that decides first.  `transcript`: the
    exchange that led there; `check`: by name; the others but `requirements`: see `Finding`.
    """

    verdict: str
    sentence: str
    remark: str
    transcript: Sequence[Mapping[str, Any]]
    decisive: Sequence[int] = ()
    by_hand: Sequence[int] = ()
    no_hand: str = ""
    before: Sequence[Mapping[str, Any]] = ()
    rule: str = ""
    check: str = ""
    requirements: list[str] = field(default_factory=list)

    @property
    def shown(self) -> list[int]:
        """The records that led to the verdict, by number, in the order of time."""
        if self.decisive:
            return list(self.decisive)
        return list(range(len(self.transcript) - last_lines(self.transcript), len(self.transcript)))

    @property
    def exchange(self) -> tuple[tuple[str, str], ...]:
        """What was said in the records that led to the verdict."""
        records = (self.transcript[number] for number in self.shown)
        return tuple((one["direction"], one["data"]) for one in records if one["data"])

    def required(self, known: Mapping[str, Mapping[str, Any]]) -> list[Required]:
        """What is asked of the device; `known`: requirements as they were judged, by their id."""
        rules = [self.rule, *[""] * len(self.requirements)]
        return [
            Required(name, _applied(rule, known[name]), place(known[name]))
            for name, rule in zip(self.requirements, rules, strict=False)
        ]

    @property
    def counted_too(self) -> str:
        """What the same exchange counts against beside the requirement that decides, by id."""
        return ", ".join(self.requirements[1:])

    def whose(self, known: Mapping[str, Mapping[str, Any]]) -> str:
        """Whose rule it is that was broken: the manual's, or how much of it is the suite's."""
        one = known[self.requirements[0]]
        where = one["where"] or one["source"]
        if where.startswith(NO_MANUAL):
            return OWN
        if self.rule.startswith(LEFT_OPEN) or one["kind"] == "interpretation":
            return INTERPRETED
        if where.endswith(ELSEWHERE):
            return ELSEWHERE_STATED
        return CONCLUDED if self.rule or one["kind"] == "derived" else STATED


def _applied(rule: str, requirement: Mapping[str, Any]) -> str:
    """The rule in the place of the requirement's text, or behind it where that is the suite's
    interpretation of what the rule calls open."""
    text: str = requirement["text"]
    if rule.startswith(LEFT_OPEN) and requirement["kind"] == "interpretation":
        return f"{text} {rule}"
    return rule or text


class Required(NamedTuple):
    """One thing that is asked of the device, in words, and where; empty: the words say it."""

    id: str
    text: str
    where: str

    def __str__(self) -> str:
        return f"{self.id}: {self.text}{f' ({self.where})' if self.where else ''}"


class Failed(NamedTuple):
    """A check that failed, and what it found; `also`: the checks that fail by the same cause, as
    far as can be seen."""

    check: Mapping[str, Any]
    found: Sequence[Statement]
    also: list[Failed]

    @property
    def requirements(self) -> list[str]:
        """What it fails, each once."""
        return list(dict.fromkeys(name for one in self.found for name in one.requirements))

    @property
    def traits(self) -> set[object]:
        """What failures of one cause have in common: the exchange, the requirement that decides, or
        the sentence but for its numbers."""
        first = self.found[0]
        traits = {first.exchange, first.requirements[0], NUMBER.sub("", first.sentence)} - {()}
        return {(first.verdict, trait) for trait in traits}


def failed(checks: Iterable[Mapping[str, Any]]) -> list[Failed]:
    """The checks that failed or settled nothing, in order, each with those behind it that have one
    of its traits."""
    groups: list[Failed] = []
    for check in checks:
        found = [one for one in statements(check) if one.verdict == check["verdict"]]
        if not found:
            continue
        new = Failed(check, found, [])
        alike = next((group for group in groups if group.traits & new.traits), None)
        (groups if alike is None else alike.also).append(new)
    return groups


def statements(check: Mapping[str, Any]) -> list[Statement]:
    """What a check that has finished found wrong or could not settle, the worst first."""
    found: dict[tuple[str, str], Statement] = {}
    for finding in check["findings"]:
        verdict = finding["verdict"]
        if verdict not in SHOWN:
            continue
        sentence = finding["sentence"] or finding["text"] or check["trouble"]
        said = finding["text"]
        # What fits into the sentence is part of it.
        remark = "" if said in sentence or said == "beside the checks" else said
        new = Statement(
            verdict, sentence, remark, finding["transcript"], finding.get("decisive", ()),
            finding.get("by_hand", ()), finding.get("no_hand", ""), finding.get("before", ()),
            finding.get("rule", ""), check["name"],
        )  # fmt: skip
        found.setdefault((verdict, sentence), new).requirements.append(finding["requirement"])
    return sorted(found.values(), key=lambda one: SHOWN.index(one.verdict))


def place(requirement: Mapping[str, Any]) -> str:
    """Title and chapter of the manual, or that the rule is the suite's own."""
    where: str = requirement["where"] or requirement["source"]
    if where.startswith(NO_MANUAL):
        return OWN_RULE
    ground = GROUNDS.get(requirement["kind"], TAKEN_OVER if where.endswith(ELSEWHERE) else "")
    return f"{where}; {ground}" if where and ground else where


def last_lines(transcript: Sequence[Mapping[str, Any]]) -> int:
    """How many records at the end of a transcript led to the verdict: the last request, and what
    came of it.  A receipt of one byte is no request."""
    requests = [
        number
        for number, one in enumerate(transcript)
        if one["direction"] == "host" and " " in one["data"].replace("#", " ")
    ]
    last = len(transcript) - requests[-1] if requests else 0
    count = last if 2 <= last <= DECISIVE_RECORDS + 1 else DECISIVE_RECORDS
    return min(count, len(transcript))
