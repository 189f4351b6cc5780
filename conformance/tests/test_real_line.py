"""What a run makes of a device on a real line, where time is not exact and nothing is given."""

from __future__ import annotations

from typing import Any

import pytest
from interfaces import PLAIN, judged_behind

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.result import Result

pytestmark = pytest.mark.strength

# What ends by 18h and stops, slowly and fast, and what has to come to rest before it.
STOPPING = (
    "MACS-CMD-18", "MACS-CMD-09-02", "MACS-CMD-00-01", "MACS-CMD-0D-02", "MACS-REPLY-04",
)  # fmt: skip

# What needs a speed of its own; the rest runs as slowly as --max-speed asks for.
MATTERS_OF_SPEED = {
    "long_ways_are_counted_in_full",
    "the_manuals_examples_get_their_printed_replies",
    "digits_printed_x_have_no_effect_in_commands",
    "neither_motion_nor_arm_ends_while_nobody_speaks",
    "what_was_stored_is_there_after_00h",
}


def judged(*words: str, query: str = "", **given: Any) -> Result:
    """Judge a MAC23 that may move and be written to, as a real device."""
    asked = {"allow": "motion,stored", "max_travel": None, **given}
    return judged_behind(PLAIN, *words, query=query, **asked).result


def failed(result: Result) -> list[tuple[str, str, object]]:
    """What is told against the device, or could not be settled."""
    return [
        (ran.check.name, one.requirement, one.expected or one.text)
        for ran in result.checks
        for one in ran.findings
        if one.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
    ]


def left_out(result: Result) -> dict[str, str]:
    """Which checks were begun and then left out, and why."""
    return {ran.check.name: ran.trouble for ran in result.checks if ran.trouble}


@pytest.mark.parametrize(
    ("query", "number", "plant"),
    [
        ("", "plant", "ideal"),
        ("&quirk.brake_increments=1", "1", None),
        ("&quirk.brake_increments=100", "100", None),
        ("&quirk.brake_increments=300", "300", None),
        ("&quirk.brake_increments=6&quirk.soft_stop_compare=equal", "6", None),
        ("&quirk.plant=inertial", "plant", "inertial"),
    ],
)
def test_an_axis_that_runs_on_after_a_stop_is_waited_for(
    query: str, number: str, plant: str | None
) -> None:
    """How far it runs on is asked first of all, and nothing is judged before it stands."""
    result = judged(*STOPPING, query=query)
    assert (failed(result), left_out(result)) == ([], {})
    assert result.exit_status == 0
    assert result.readings["brake_increments"] == number
    assert result.readings.get("plant") == plant


def test_an_axis_that_runs_on_for_long_is_held_to_what_it_was_measured() -> None:
    """At any speed, in segments and moves; nor is the slowest speed waited for."""
    names = (
        "segments_that_turn_round_end_on_the_stop_they_meet_first",
        "segments_run_at_their_own_constant_speed", "the_period_is_locked_in_motion",
        "brake_increments",  # not guessed: beyond 100 the guard takes it for gone astray
    )  # fmt: skip
    given = {"level": "full", "max_travel": 20_000}
    result = judged(*names, query="&quirk.brake_increments=900", **given)
    assert (failed(result), left_out(result), result.exit_status) == ([], {}, 0)


@pytest.mark.parametrize("query", ["&quirk.brake_increments=30", "&quirk.plant=inertial"])
def test_random_sequences_leave_out_an_axis_that_runs_on(query: str) -> None:
    """The ledger does not say when such an axis is at rest: no verdict, with the reason."""
    name = "many_mixed_sequences_agree_with_the_model"
    result = judged(name, level="full", query=query)
    told = {one.reason for one in result.requirements if one.verdict is Verdict.NOT_RUN}
    assert failed(result) == []
    assert any("no exact rule for an axis that runs on" in one for one in told)


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize("query", ["", "&quirk.brake_increments=100", "&quirk.plant=inertial"])
def test_a_healthy_device_on_a_real_line_conforms(query: str) -> None:
    """At level full, with everything allowed that needs no rig."""
    result = judged(level="full", query=query)
    assert (failed(result), result.exit_status) == ([], 0)


@pytest.mark.parametrize("max_speed", [125, 200, 500])
def test_a_device_that_may_only_move_slowly_is_judged_slowly(max_speed: int) -> None:
    """Everything takes longer; nothing is blamed for that, and little is left out."""
    result = judged(level="full", max_speed=max_speed)
    assert (failed(result), result.exit_status) == ([], 0)
    assert set(left_out(result)) <= MATTERS_OF_SPEED


def test_where_11h_is_refused_nothing_is_taken_for_armed() -> None:
    """A stop may leave the arm of 10h there, and 11h is refused where none is left."""
    query = "&quirk.preload_policy=refuse&quirk.sync_without_preload=refuse"
    result = judged(query=query)
    assert (result.exit_status, failed(result)) == (0, [])
