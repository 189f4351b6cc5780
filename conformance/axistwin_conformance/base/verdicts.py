"""Verdicts: what a run may say about a requirement, and how several sayings become one.

Several checks speak about one requirement.  The worst saying wins, in this order:

    fail > inconclusive > quirk > pass > info > not run

*Fail* dominates *inconclusive*: one proven breach is a breach, however noisy the rest was.
*Inconclusive* dominates every success: what could not be settled must not be hidden by a pass.
*Not run* is the bottom: it never turns a judged requirement into something else, and it is never a
success by itself.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from axistwin_conformance.base.transcript import Record


class Verdict(StrEnum):
    """What is said about one requirement."""

    PASS = "pass"
    FAIL = "fail"
    QUIRK = "quirk"
    INFO = "info"
    NOT_RUN = "not run"
    INCONCLUSIVE = "inconclusive"

    @property
    def rank(self) -> int:
        """How much this verdict weighs against others; the highest one wins."""
        return _RANK[self]

    @property
    def is_judgement(self) -> bool:
        """True if the device was judged: a value only recorded, or nothing run, is no judgement."""
        return self in (Verdict.PASS, Verdict.FAIL, Verdict.QUIRK)


_RANK = {
    Verdict.NOT_RUN: 0,
    Verdict.INFO: 1,
    Verdict.PASS: 2,
    Verdict.QUIRK: 3,
    Verdict.INCONCLUSIVE: 4,
    Verdict.FAIL: 5,
}


def merge(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict that stands for all; nothing said at all is *not run*."""
    return max(verdicts, key=lambda verdict: verdict.rank, default=Verdict.NOT_RUN)


def join_texts(*texts: str) -> str:
    """The texts that say anything, as one."""
    return "; ".join(text for text in texts if text)


@dataclass(frozen=True, slots=True)
class Finding:
    """One saying of one check about one requirement.

    `expected` lists every admissible outcome, `actual` is what came; `transcript` holds the
    exchange that led here, for verdicts a reader will want to follow.  `sentence` says of a failure
    what the device did and what is expected.  Of the transcript, by number: `decisive`, the lines
    that decided; `by_hand`, the requests that show it again, and what was done to the rig between
    them.  `no_hand`: why sending them is not enough.  `before`: what brings a device to the state
    in which the check found it.  `rule`: what is asked of the device, where the requirement does
    not say it.
    """

    requirement: str
    verdict: Verdict
    text: str
    expected: tuple[str, ...] = ()
    actual: str | None = None
    transcript: tuple[Record, ...] = ()
    sentence: str = ""
    decisive: tuple[int, ...] = ()
    by_hand: tuple[int, ...] = ()
    no_hand: str = ""
    before: tuple[Record, ...] = ()
    rule: str = ""
