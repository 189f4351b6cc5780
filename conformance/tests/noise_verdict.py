"""How a run of a healthy twin behind noise is judged, whatever is in between."""

from __future__ import annotations

from typing import Protocol, TypeVar

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.result import Result

HONEST = (0, 4)  # conforms, or nothing failed and something stayed inconclusive


class Noisy(Protocol):
    """What came of it."""

    @property
    def result(self) -> Result:
        """The run's result."""

    @property
    def is_put_back(self) -> bool:
        """True if the twins hold at the end what they held before."""


Run = TypeVar("Run", bound=Noisy)


def judge_healthy(run: Run) -> Run:
    """No failure, no quirk, everything as it was."""
    told = [
        (one.requirement.id, one.verdict, one.reason)
        for one in run.result.requirements
        if one.verdict in (Verdict.FAIL, Verdict.QUIRK)
    ]
    assert told == [], told
    assert run.result.exit_status in HONEST, run.result.sentence
    assert run.is_put_back
    return run


def passed(run: Noisy) -> int:
    """How many requirements passed."""
    return sum(one.verdict is Verdict.PASS for one in run.result.requirements)
