"""A device that is slow, or silent to one command alone, is no silent one."""

from __future__ import annotations

import pytest
from interfaces import PLAIN, judged_behind
from sweeping.faults import Fault, When
from sweeping.runs import Setting
from sweeping.sweeps import FaultSweep
from zoo.commands import what_comes_while_it_starts_begins_the_time_anew

from axistwin_conformance.base.line_quality import LineQuality
from axistwin_conformance.transport.kinds import BUS, LINE

MS = 1_000_000
EXCHANGES = 100


def judged(fault: Fault, model: str = "mac23") -> tuple[int, str]:
    """The exit status and the sentence of a quick run with a device that has this fault."""
    sweep = FaultSweep(Setting(model, "a plain port", "quick", 300.0), seed=1)
    row = sweep.judge_fault(fault, sweep.setting)
    assert row["hits"], "the fault was never met"
    return row["status"], row["sentence"]


@pytest.mark.parametrize(
    "fault",
    [
        Fault("reply", "late", kinds=("20",), amount=600 * MS),
        Fault("reply", "late", when=When(first=200), amount=600 * MS),
    ],
    ids=str,
)
def test_who_replies_late_is_waited_for(fault: Fault) -> None:
    """Each was given up as one that does not answer: in six attempts nothing had come in time."""
    status, sentence = judged(fault)
    assert status in (1, 4), sentence
    assert "unreachable" not in sentence


def test_replies_that_stop_in_their_midst_are_no_other_protocol() -> None:
    """What came was the end of one and the beginning of the next; now that is what fails."""
    status, sentence = judged(Fault("reply", "broken by a pause", amount=1200 * MS))
    assert status == 1, sentence


def test_what_a_bus_corrupts_comes_right_within_a_few_attempts() -> None:
    """A controller sends a corrupted frame again; a line may corrupt every other reply."""
    needed = [
        LineQuality(EXCHANGES, corrupted=70, most_noise=way.most_noise).alike_needed
        for way in (BUS, LINE)
    ]
    assert needed == [6, 27]


def test_replies_exchanged_two_by_two_fail_on_a_bus() -> None:
    """They were taken for corrupted ones until the time of the run was over."""
    status, sentence = judged(Fault("reply", "before the one that is due"), "mac23-can")
    assert status == 1, sentence


def test_who_is_silent_to_one_command_alone_fails_on_a_bus_too() -> None:
    """What others say unasked meanwhile was taken for its reply, and it for one that was lost."""
    status, sentence = judged(Fault("effect", "none, no reply", kinds=("d18",)), "mac23-can")
    assert status == 1, sentence


def test_who_answers_behind_a_silence_only_is_not_lost() -> None:
    """Polled, it never gets out of its start: left alone it does, and the rest of it is judged."""
    with what_comes_while_it_starts_begins_the_time_anew.plant():
        names = ("after_00h_it_is_deaf_for_two_seconds", "MACS-FRAME-05")
        run = judged_behind(PLAIN, *names, level="full")
    failed = {one.requirement.id for one in run.result.requirements if one.verdict == "fail"}
    assert run.result.exit_status == 1, run.result.sentence
    assert failed == {"MACS-CMD-00-02"}
    assert not run.result.problems
