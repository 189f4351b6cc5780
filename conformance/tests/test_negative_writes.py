"""Writes that no unit may carry out: a real controller is sent them where the operator allows it,
and one that carries them out is found by them alone."""

from __future__ import annotations

import pytest
from interfaces import PLAIN, InterfaceRun, judged_behind
from zoo.mutant import Mutant
from zoo_msc.forms import (
    a_write_that_breaks_off_is_carried_out,
    writes_for_others_are_carried_out_silently,
)
from zoo_msc.link import a_refused_flag_is_turned, a_refused_value_is_stored

from axistwin_conformance.base.verdicts import Verdict

CARRIED_OUT = {
    a_refused_value_is_stored: "MSC-LNK-06",
    a_refused_flag_is_turned: "MSC-LNK-06",
    a_write_that_breaks_off_is_carried_out: "MSC-LNK-06",
    writes_for_others_are_carried_out_silently: "MSC-LNK-19",
}
pytestmark = pytest.mark.strength

WORDS = (
    "a_refused_write_stores_nothing", "a_refused_sflag_turns_nothing_on",
    "a_write_for_another_unit_stores_nothing_here",
    "bytes_of_a_refused_packet_are_not_looked_at_again",
)  # fmt: skip


def judged(*words: str, allow: str) -> InterfaceRun:
    """A controller on a real port."""
    return judged_behind(PLAIN, *words, model="msc-250", allow=allow)


@pytest.mark.parametrize("fault", CARRIED_OUT, ids=lambda fault: fault.name)
def test_a_controller_that_carries_out_a_wrong_write_is_found(
    fault: Mutant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under a wrong sum, cut short, or for another unit: behind a port as on the twin."""
    fault.alter(monkeypatch)
    run = judged(*WORDS, allow="stored,negative")
    assert run.verdicts[CARRIED_OUT[fault]] is Verdict.FAIL, run.result.sentence
    assert run.result.exit_status == 1


def test_a_sound_controller_passes_and_holds_what_it_held() -> None:
    """What is sent is aimed at what the operator has named, and put back."""
    run = judged(*WORDS, allow="stored,negative")
    assert run.result.exit_status == 0, run.result.sentence
    assert run.result.problems == []
    assert run.verdicts["MSC-LNK-06"] is Verdict.PASS


def test_without_the_class_no_such_write_is_sent() -> None:
    """The checks are told as not run, with what to allow."""
    left_out = judged(*WORDS, "MSC-RQSTAT-01", allow="stored").result.plan.left_out
    assert {check.name: reason for check, reason in left_out} == dict.fromkeys(
        WORDS, "not allowed: negative (--allow negative)"
    )


def test_a_requirement_that_only_such_writes_show_is_not_run_without_them() -> None:
    """It never looks like a pass."""
    (found,) = (
        one
        for one in judged("MSC-LNK-24", "MSC-RQSTAT-01", allow="stored").result.requirements
        if one.requirement.id == "MSC-LNK-24"
    )
    assert found.verdict is Verdict.NOT_RUN
    assert found.reason == "not allowed: negative (--allow negative)"
