"""What changed between two runs: verdicts only, since times and bytes always differ.

A change for the worse is one down this scale:

    pass > quirk > info > not run > inconclusive > fail

A requirement that one of the runs did not ask about counts as not run there.  A quirk that has
become another quirk has changed, for better or worse nobody can say.  A switch that is not read as
the profile says has failed, under the name `profile SWITCH`; in a run without one it is not run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.report.json import Report
from axistwin_conformance.report.terminal import STYLE

BEST_FIRST = (
    Verdict.PASS, Verdict.QUIRK, Verdict.INFO, Verdict.NOT_RUN, Verdict.INCONCLUSIVE, Verdict.FAIL,
)  # fmt: skip
OF_PROFILE = "profile "
NOT_ASKED = "the run did not ask about it"

# Of a run: what makes two of them hard to compare if it differs.
CIRCUMSTANCES = {
    "model": "model",
    "suite_version": "suite",
    "level": "level",
    "allowed": "allowed",
    "max_travel": "travel",
    "max_speed": "speed",
    "grounds": "grounds",
}


@dataclass(frozen=True, slots=True)
class Change:
    """A requirement, or a switch of the profile, whose verdict is not what it was.

    `reason` is the new verdict's.
    """

    requirement: str
    old: Verdict
    new: Verdict
    reason: str

    @property
    def is_worse(self) -> bool:
        """True if the device, or what is known of it, has got worse."""
        return BEST_FIRST.index(self.new) > BEST_FIRST.index(self.old)


def changes(old: Report, new: Report) -> list[Change]:
    """Return the changes from one report to the other, in the order of the newer one's ledger."""
    before, after = _verdicts(old), _verdicts(new)
    found = []
    for key in [*after, *(key for key in before if key not in after)]:
        verdict, reason = after.get(key) or _unsaid(new, key)
        past, past_reason = before.get(key) or _unsaid(old, key)
        is_other_quirk = verdict is Verdict.QUIRK and reason != past_reason
        if verdict is not past or is_other_quirk:
            found.append(Change(key, past, verdict, reason))
    return found


def _verdicts(report: Report) -> dict[str, tuple[Verdict, str]]:
    """What is said, first of the switches that are not read as the profile says."""
    said = {
        f"{OF_PROFILE}{one['switch']}": (
            Verdict.FAIL, f"expected {one['expected']}, found {' or '.join(one['found'])}"
        )
        for one in _profile(report).get("departures", ())
    }  # fmt: skip
    requirements = report["requirements"]
    return said | {
        requirement["id"]: (Verdict(requirement["verdict"]), requirement["reason"])
        for requirement in requirements
    }


def _unsaid(report: Report, key: str) -> tuple[Verdict, str]:
    """The verdict on what a report does not name."""
    judged, switch = _profile(report), key.removeprefix(OF_PROFILE)
    if switch == key:
        return Verdict.NOT_RUN, NOT_ASKED
    if not judged:
        return Verdict.NOT_RUN, "the run was held to no profile"
    if not any(one["switch"] == switch for one in report["readings"]):
        return Verdict.NOT_RUN, "the run has not seen how the device reads it"
    return Verdict.PASS, "as the profile says"


def _profile(report: Report) -> Mapping[str, Any]:
    """What came of the profile; empty if none was given, and in reports of former versions."""
    judged: Mapping[str, Any] = report.get("profile") or {}
    return judged


def circumstances(old: Report, new: Report) -> list[str]:
    """Say what else was different between the runs and may explain a change."""
    pairs = [
        (word, old["run"].get(key) or None, new["run"].get(key) or None)
        for key, word in CIRCUMSTANCES.items()
    ]
    pairs.append(("device", old["device"].get("summary", ""), new["device"].get("summary", "")))
    if _profile(old) or _profile(new):
        names = (_profile(one).get("profile", "none") for one in (old, new))
        pairs.append(("profile", *names))
    return [f"{word}: {_words(a)} → {_words(b)}" for word, a, b in pairs if a != b]


def _words(value: object) -> str:
    if isinstance(value, dict):
        value = [f"{name} {text}" for name, text in value.items()]
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value or "unknown")


def as_object(found: Sequence[Change], notes: Sequence[str]) -> Mapping[str, Any]:
    """Return the comparison for programs."""
    return {
        "changes": [
            {
                "requirement": change.requirement,
                "old": change.old.value,
                "new": change.new.value,
                "worse": change.is_worse,
                "reason": change.reason,
            }
            for change in found
        ],
        "differences": list(notes),
    }


def print_changes(console: Console, found: Sequence[Change], notes: Sequence[str]) -> None:
    """Show the comparison: a table on a terminal, one line per change in a pipe."""
    for note in notes:
        console.print(f"note: not the same {note}", style="yellow", markup=False, soft_wrap=True)
    if console.is_terminal and found:
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
        for title in ("requirement", "was", "is", "reason"):
            table.add_column(title, no_wrap=title != "reason")
        for change in found:
            was, now = (Text(each.value, STYLE[each]) for each in (change.old, change.new))
            table.add_row(change.requirement, was, now, change.reason)
        console.print(table)
    else:
        for change in found:
            reason = f": {change.reason}" if change.reason else ""
            line = f"{change.requirement}  {change.old.value} → {change.new.value}{reason}"
            console.print(line, markup=False, soft_wrap=True)
    worse = sum(change.is_worse for change in found)
    count = f"{len(found)} verdict{'' if len(found) == 1 else 's'} changed"
    console.print(f"{count}, {worse or 'none'} for the worse." if found else "No verdict changed.")
