"""What a check found wrong, in the words that terminal, page and build server share.

A check that fails breaks several requirements by one exchange more often than not: what was seen is
said once, and below it what the manual asks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

NO_MANUAL: Final = "none"  # begins the source of what no manual asks
GROUNDS: Final = {
    "derived": "derived",
    "interpretation": "the suite's interpretation",
}
OWN_RULE: Final = "a rule of the suite; the manual does not cover it"
TIMES: Final = "time in ms: host lines when sending began, device lines at the last byte"
SHOWN: Final = ("fail", "inconclusive")
DECISIVE_RECORDS: Final = 3  # of a transcript: they led to the verdict


@dataclass(slots=True)
class Statement:
    """One thing that was seen: in a sentence, and what there is to add to it.

    `requirements`: what it breaks, or leaves open, the one that decides first.  `transcript`: the
    exchange that led there; `decisive`, `by_hand`, `no_hand`: see `Finding`.
    """

    verdict: str
    sentence: str
    remark: str
    transcript: Sequence[Mapping[str, Any]]
    decisive: Sequence[int] = ()
    by_hand: Sequence[int] = ()
    no_hand: str = ""
    requirements: list[str] = field(default_factory=list)

    @property
    def shown(self) -> list[int]:
        """The records that led to the verdict, by number, in the order of time."""
        if self.decisive:
            return list(self.decisive)
        return list(range(len(self.transcript) - last_lines(self.transcript), len(self.transcript)))


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
            finding.get("by_hand", ()), finding.get("no_hand", ""),
        )  # fmt: skip
        found.setdefault((verdict, sentence), new).requirements.append(finding["requirement"])
    return sorted(found.values(), key=lambda one: SHOWN.index(one.verdict))


def manual(requirements: Iterable[Mapping[str, Any]]) -> list[str]:
    """What the manual asks, and where, of requirements as they were judged."""
    return [f"{one['id']}: {one['text']}{source(one)}" for one in requirements]


def source(requirement: Mapping[str, Any]) -> str:
    """Where the manual asks for it, to be put behind what it asks; or that no manual does."""
    where = place(requirement)
    return f" ({where})" if where else ""


def place(requirement: Mapping[str, Any]) -> str:
    """Title and chapter of the manual, or that the rule is the suite's own."""
    where: str = requirement["where"] or requirement["source"]
    if where.startswith(NO_MANUAL):
        return OWN_RULE
    ground = GROUNDS.get(requirement["kind"], "")
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
