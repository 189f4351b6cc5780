"""How several sayings about one requirement become one."""

from __future__ import annotations

import itertools

import pytest

from axistwin_conformance.base.verdicts import Verdict, merge


def test_the_worst_saying_wins_in_the_documented_order() -> None:
    """Fail > inconclusive > quirk > pass > info > not run, for every pair."""
    order = [
        Verdict.FAIL,
        Verdict.INCONCLUSIVE,
        Verdict.QUIRK,
        Verdict.PASS,
        Verdict.INFO,
        Verdict.NOT_RUN,
    ]
    assert set(order) == set(Verdict)
    for worse, better in itertools.combinations(order, 2):
        assert merge([better, worse, better]) is worse


def test_nothing_said_is_not_run() -> None:
    """No saying at all is never a success."""
    assert merge([]) is Verdict.NOT_RUN


@pytest.mark.parametrize("verdict", [Verdict.NOT_RUN, Verdict.INFO, Verdict.INCONCLUSIVE])
def test_what_does_not_judge_the_device_is_no_judgement(verdict: Verdict) -> None:
    """Only pass, fail and quirk say something about the device."""
    assert not verdict.is_judgement
