"""On a bus that loses frames, delays or repeats them: never a wrong verdict."""

from __future__ import annotations

import pytest
from bus_in_front import FATES, NoisyRun, noisy_run
from noise_verdict import judge_healthy, passed

from axistwin_conformance.base.verdicts import Verdict

pytestmark = pytest.mark.strength

KINDS = {"mixed": FATES, **{one: (one,) for one in FATES}}
LEAST_PASSED = {500: 40, 50: 30}  # noise costs certainty, but not everything


def healthy(every: int, seed: int, kind: str, *words: str) -> NoisyRun:
    """A healthy twin behind a noisy bus, judged."""
    return judge_healthy(noisy_run(every, seed, *words, fates=KINDS[kind]))


def test_a_healthy_twin_never_fails_on_a_bus_that_loses_frames() -> None:
    """One in 500, either way: it costs time and certainty, never a verdict."""
    assert passed(healthy(500, 1, "lost")) >= LEAST_PASSED[500]


@pytest.mark.parametrize("kind", KINDS)
def test_where_every_25th_exchange_is_spoilt_nothing_is_made_up(kind: str) -> None:
    """One frame in 50: segments, faults made and acknowledged, moves, restarts."""
    run = healthy(
        50, 7, kind, "segments_follow_one_another_without_a_gap", "overheating_locks_motion",
        "a_move_to_where_it_is_does_nothing",
    )  # fmt: skip
    assert run.hits > 0, "there was noise"


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_is_found_behind_any_noise(kind: str) -> None:
    """One frame in 20 spoils the first exchanges too."""
    hits = [healthy(20, seed, kind, "MACC-Q-04-01").hits for seed in range(200, 206)]
    assert sum(hits) > 0, "there was noise"


def test_a_frame_that_comes_twice_now_and_then_is_not_held_against_the_device() -> None:
    """Checks that listen for more than one reply fail by it each time, each time elsewhere."""
    for seed in range(100, 104):
        run = healthy(
            50, seed, "twice", "any_sub_index_is_repeated_and_selects_nothing",
            "objects_outside_the_area_are_refused", "a_short_request_gets_no_reply",
        )  # fmt: skip
        assert run.hits > 0, "there was noise"


def test_a_device_that_says_everything_twice_fails_by_it() -> None:
    """It is no noise if it comes each time."""
    run = noisy_run(1, 0, "a_short_request_gets_no_reply", fates=("twice",))
    assert run.result.exit_status == 1, run.result.sentence


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", [50, 500])
@pytest.mark.parametrize("seed", range(100, 104))
def test_whatever_the_noise_a_healthy_twin_never_fails(every: int, kind: str, seed: int) -> None:
    """Each kind alone, and mixed, at two rates."""
    assert passed(healthy(every, seed, kind)) >= LEAST_PASSED[every]


def test_noise_does_not_hide_another_reading() -> None:
    """A device that does not follow the default never passes for one that does."""
    for seed in range(3):
        result = noisy_run(500, seed, "MACC-SDO-03", "MACC-Q-04-01", upload_scs="43h").result
        assert result.readings["upload_scs"] == "43h"
        assert all(one.verdict is not Verdict.FAIL for one in result.requirements)
