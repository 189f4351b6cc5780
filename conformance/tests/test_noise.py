"""Noise: lost, late and corrupted bytes never make a wrong verdict."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from noise_verdict import judge_healthy, passed
from noisy_line import FATES, NoisyRun, noisy_run
from zoo import ZOO
from zoo.mutant import Mutant

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.line_quality import LEAST_ALIKE, LineQuality
from axistwin_conformance.base.verdicts import Finding, Verdict
from axistwin_conformance.engine import replays
from axistwin_conformance.engine.replays import Attempt, Replays
from axistwin_conformance.engine.result import CheckResult

pytestmark = pytest.mark.strength

KINDS = {"mixed": FATES, **{one: (one,) for one in FATES}}
LEAST_PASSED = {5000: 110, 500: 80, 50: 30}  # of 136: noise costs certainty, but not everything
# One or two of each family of faults.
MUTANTS = (
    "the_ramp_is_half_as_long",
    "a_nacked_command_is_executed",
    "positions_have_24_bits",
    "segments_obey_the_speed_limit",
    "the_stop_bit_is_cleared_by_18h",
    "sync_starts_nothing",
    "torque_limits_have_no_end",
    "the_stop_inputs_are_exchanged",
    "a_warning_refuses_motion",
    "the_period_is_not_stored",
    "the_whole_index_is_echoed",
    "a_pause_drops_the_frame",
    "the_top_bit_of_the_address_is_ignored",
)


def healthy(every: int, seed: int, kind: str, *words: str) -> NoisyRun:
    """A healthy twin behind a noisy line, judged."""
    run = judge_healthy(noisy_run(every, seed, *words, fates=KINDS[kind]))
    assert run.hits > 0, "there was noise"
    return run


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize(("every", "seed", "kind"), [(5000, 1, "mixed"), (500, 2, "mixed")])
def test_a_healthy_twin_never_fails_behind_a_noisy_line(every: int, seed: int, kind: str) -> None:
    """Lost, late and corrupted bytes cost time and certainty, never a verdict."""
    assert passed(healthy(every, seed, kind)) >= LEAST_PASSED[every]


@pytest.mark.parametrize("kind", KINDS)
def test_on_a_line_that_spoils_every_other_exchange_nothing_is_made_up(kind: str) -> None:
    """One byte in 50: segments that come late, faults made and acknowledged, moves, restarts."""
    healthy(
        50, 7, kind, "segments_follow_one_another_without_a_gap", "overheating_locks_motion",
        "after_00h_it_is_deaf_for_two_seconds", "just_after_two_seconds_it_listens",
        "a_move_to_where_it_is_does_nothing",
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["mixed", "lost", "corrupted"])
def test_a_device_is_found_behind_any_noise(kind: str) -> None:
    """One byte in 50 spoils the first exchanges too."""
    for seed in range(200, 212):
        healthy(50, seed, kind, "MACS-Q-24-01")


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", [50, 500, 5000])
@pytest.mark.parametrize("seed", range(100, 105))
def test_whatever_the_noise_a_healthy_twin_never_fails(every: int, kind: str, seed: int) -> None:
    """Lost, corrupted and late bytes, each alone and mixed, at three rates."""
    assert passed(healthy(every, seed, kind)) >= LEAST_PASSED[every]


@pytest.mark.soak
def test_what_could_not_be_settled_says_how_often_it_came() -> None:
    """One byte in 50: the run ends, what could not be settled is inconclusive, k of n is told."""
    result = healthy(50, 1, "mixed").result
    assert result.exit_status == 4
    texts = [one.reason for one in result.requirements if one.verdict is Verdict.INCONCLUSIVE]
    assert any("not settled in" in text for text in texts)


def judge_mutant(mutant: Mutant, every: int, seed: int) -> NoisyRun:
    """A faulty twin behind a noisy line, asked about what the fault breaks: killed by it or not
    settled, never found to conform, and nothing else is blamed."""
    with mutant.plant():
        run = noisy_run(every, seed, *mutant.claims, level="full", model=mutant.model)
    verdicts = {one.requirement.id: one.verdict for one in run.result.requirements}
    assert run.result.exit_status in (1, 4)
    assert {verdicts[claim] for claim in mutant.claims} & {Verdict.FAIL, Verdict.INCONCLUSIVE}
    return run


def named(*names: str) -> list[Mutant]:
    """Mutants of the zoo."""
    found = [one for one in ZOO if one.name in names]
    assert len(found) == len(names)
    return found


@pytest.mark.strength(seconds=30)
def test_noise_does_not_hide_a_fault() -> None:
    """One byte in 500: most faults are found all the same, none passes for conforming."""
    faults, seeds = named(*MUTANTS[:4]), range(1, 5)
    statuses = [judge_mutant(one, 500, seed).result.exit_status for one in faults for seed in seeds]
    assert statuses.count(1) >= 13  # 15 of these 16, the last one is not settled


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("every", "mutant"),
    [
        *((500, one) for one in named(*MUTANTS)),
        *((50, one) for one in named(*MUTANTS[:4])),
    ],
    ids=lambda one: getattr(one, "name", None),
)
def test_a_faulty_twin_never_conforms_behind_a_noisy_line(
    every: int, mutant: Mutant, seed: int
) -> None:
    """Killed by the right requirement, or inconclusive."""
    judge_mutant(mutant, every, seed)


@pytest.mark.parametrize("every", [500, 5000])
def test_noise_does_not_hide_another_reading(every: int) -> None:
    """A device that does not follow the default never passes for one that does."""
    for seed in range(3):
        result = noisy_run(every, seed, "MACS-REPLY-01", xon_byte="11h").result
        assert result.readings["xon_byte"] == "11h"
        assert all(one.verdict is not Verdict.FAIL for one in result.requirements)


# --- when a result is believed -------------------------------------------------------------------


def attempt(
    verdict: Verdict = Verdict.PASS,
    *,
    retries: tuple[str, ...] = (),
    disturbance: str = "",
    place: tuple[bytes, int] = (b"here", 1),
    corrupted: tuple[str, ...] = (),
    outcome: Outcome = Outcome.DONE,
) -> Callable[[bool], Attempt]:
    """One attempt of a check that ends like this."""

    def made(is_strict: bool) -> Attempt:
        said = Verdict.INCONCLUSIVE if disturbance else verdict
        finding = Finding("MACS-LINE-01", said, "text", ("7",), "8")
        trouble = disturbance or ("crash" if outcome is Outcome.ERROR else "")
        end = Outcome.TROUBLE if disturbance else outcome
        result = CheckResult(CHECK, end, (finding,), retries, 0.0, trouble)
        failed_at = place if said is Verdict.FAIL else (b"", 0)
        return Attempt(result, disturbance, {}, is_strict, corrupted, failed_at)

    return made


class FakeCheck:
    """As much of a check as judging its attempts needs."""

    requirements = ("MACS-LINE-01",)


CHECK: Any = FakeCheck()
PASSES, FAILS = attempt(), attempt(Verdict.FAIL)
RETRIED = attempt(retries=("20h: silence",))
VOID = attempt(disturbance="13h: silence")


def settled(
    *attempts: Callable[[bool], Attempt], quality: LineQuality | None = None
) -> tuple[Verdict, int, list[bool]]:
    """Play these attempts (the last one again and again); the verdict, how many were needed, and
    which of them were strict."""
    asked: list[bool] = []

    def one(is_strict: bool) -> Attempt:
        asked.append(is_strict)
        return attempts[min(len(asked), len(attempts)) - 1](is_strict)

    result = Replays(one, lambda: True, quality or LineQuality(10_000, 0)).conclude()
    return result.verdict, len(asked), asked


def test_a_clean_pass_is_believed_at_once() -> None:
    """No replay without a reason."""
    assert settled(PASSES) == (Verdict.PASS, 1, [False])


def test_a_failure_needs_three_of_three() -> None:
    """The same thing three times is the device's."""
    assert settled(FAILS)[:2] == (Verdict.FAIL, LEAST_ALIKE)


def test_a_failure_that_comes_and_goes_on_a_quiet_line_is_inconclusive() -> None:
    """Neither a pass nor a fail: the device does not hold still."""
    verdict, count, _ = settled(FAILS, PASSES)
    assert verdict is Verdict.INCONCLUSIVE
    assert count == replays.MOST_ATTEMPTS


def test_on_a_noisy_line_a_failure_that_does_not_come_again_was_noise() -> None:
    """Enough quiet passes outvote it."""
    noisy = LineQuality(10_000, 100)
    assert settled(FAILS, PASSES, quality=noisy)[0] is Verdict.PASS


def wandering(count: int, **given: Any) -> list[Callable[[bool], Attempt]]:
    """So many attempts that fail each at another place."""
    places = [(bytes([number]), 1) for number in range(count)]
    return [attempt(Verdict.FAIL, place=place, **given) for place in places]


def test_ten_attempts_that_fail_in_ten_ways_are_a_failure_on_a_sound_line() -> None:
    """Noise hits here and there, but seldom, and not this check alone."""
    verdict, count, _ = settled(*wandering(10))
    assert (verdict, count) == (Verdict.FAIL, replays.MOST_ATTEMPTS)
    spoilt = wandering(10, corrupted=("20h: U",))
    assert settled(*spoilt)[0] is Verdict.FAIL, "what the device says may be garbage"
    assert settled(*wandering(9), PASSES)[0] is Verdict.INCONCLUSIVE, "one has held"


def test_what_fails_alike_now_and_then_is_a_failure_where_no_noise_was_ever_seen() -> None:
    """A device that is wrong in one reply of twenty; a trace of noise, or of haste, is a doubt."""
    row = [FAILS, PASSES] * 5
    assert settled(*row)[:2] == (Verdict.FAIL, replays.MOST_ATTEMPTS)
    assert settled(*row, quality=LineQuality(10_000, 1))[0] is Verdict.INCONCLUSIVE
    assert settled(*row, quality=LineQuality(10_000, 0, late=1))[0] is Verdict.INCONCLUSIVE
    assert settled(*row[:9], RETRIED)[0] is Verdict.INCONCLUSIVE
    assert settled(*row[:4], *[PASSES] * 6)[0] is Verdict.INCONCLUSIVE, "two of ten"


def test_on_a_noisy_line_failures_at_different_places_are_not_the_device() -> None:
    """Whether it was noisy before, or becomes so meanwhile."""
    assert settled(*wandering(10), quality=LineQuality(1000, 42))[0] is Verdict.INCONCLUSIVE
    line, row = LineQuality(10_000, 0), wandering(10)

    def tidy() -> bool:
        line.note(is_corrupted=True)
        return True

    def one(is_strict: bool) -> Attempt:
        return row.pop()(is_strict)

    result = Replays(one, tidy, line).conclude()
    assert result.verdict is Verdict.INCONCLUSIVE


def test_what_breaks_off_elsewhere_each_time_is_judged_as_it_comes_on_a_sound_line() -> None:
    """A device that answers 13h with other garbage each time is no noisy line."""
    void = [attempt(disturbance=f"13h: garbage {number}") for number in range(3)]
    verdict, _, strict = settled(*void, FAILS)
    assert verdict is Verdict.FAIL
    assert strict == [False] * 3 + [True] * 3


def test_the_noisier_the_line_the_more_must_agree() -> None:
    """Three of three mean nothing where every other exchange is spoilt."""
    assert settled(FAILS, quality=LineQuality(1000, 50))[:2] == (Verdict.FAIL, 5)
    assert settled(FAILS, quality=LineQuality(1000, 750))[0] is Verdict.INCONCLUSIVE


def test_while_every_attempt_fails_it_is_replayed_longer() -> None:
    """Where more must agree than there usually are attempts; one that holds ends that."""
    noisy = LineQuality(1000, 400)
    assert settled(FAILS, quality=noisy)[:2] == (Verdict.FAIL, noisy.alike_needed)
    assert noisy.alike_needed > replays.MOST_ATTEMPTS
    verdict, count, _ = settled(RETRIED, *[FAILS] * 30, quality=noisy)
    assert (verdict, count) == (Verdict.INCONCLUSIVE, replays.MOST_ATTEMPTS)


def test_a_failure_without_any_noise_is_waited_for_to_come_again() -> None:
    """Few attempts at a long check are quiet: as many are made as it takes, if none holds."""
    line = LineQuality(1000, 42)
    hit = [attempt(Verdict.FAIL, corrupted=(f"20h, time {number}: ",)) for number in range(60)]
    row = [FAILS if number % 3 == 2 else one for number, one in enumerate(hit)]
    assert settled(*row, quality=line)[:2] == (Verdict.FAIL, 21)
    assert settled(*hit, quality=line)[:2] == (Verdict.INCONCLUSIVE, replays.MOST_ATTEMPTS)
    twice = [FAILS, *hit[:5], FAILS, *hit[5:]]
    longest = replays.MOST_WHILE_QUIET * replays.MOST_ATTEMPTS
    assert settled(*twice, quality=line)[:2] == (Verdict.INCONCLUSIVE, longest)
    verdict, count, _ = settled(*row[:12], RETRIED, *hit, quality=line)
    assert (verdict, count) == (Verdict.INCONCLUSIVE, 13)


def test_the_more_attempts_there_are_the_more_must_agree() -> None:
    """Among many attempts noise hits one place again and again."""
    line = LineQuality(1000, 42)
    hit = [attempt(Verdict.FAIL, corrupted=(f"20h, time {number}: ",)) for number in range(60)]
    seldom = [FAILS if number % 7 == 0 else one for number, one in enumerate(hit)]
    assert sum(one is FAILS for one in seldom[:40]) > line.alike_needed
    assert settled(*seldom, quality=line)[0] is Verdict.INCONCLUSIVE


def test_what_goes_wrong_in_another_way_says_nothing_for_the_device() -> None:
    """A failure that ends a check early hides the later one; only a pass contradicts it."""
    line = LineQuality(1000, 42)
    other = attempt(Verdict.FAIL, place=(b"elsewhere", 1))
    assert settled(FAILS, other, *[FAILS] * 30, quality=line)[0] is Verdict.FAIL
    assert settled(FAILS, PASSES, *[FAILS] * 30, quality=line)[0] is Verdict.INCONCLUSIVE


def test_on_a_noisy_line_the_same_failure_behind_the_same_frame_another_time_is_noise() -> None:
    """What is asked a hundred times is hit now and then; a quiet line need not ask as often."""
    wandering = [attempt(Verdict.FAIL, place=(b"here", number)) for number in range(1, 41)]
    assert settled(*wandering, quality=LineQuality(1000, 20))[0] is Verdict.INCONCLUSIVE
    assert settled(*wandering, quality=LineQuality(1000, 0))[0] is Verdict.FAIL


def test_a_device_is_given_up_later_than_a_reply_is_believed() -> None:
    """It is asked thousands of times whether it is there; on a quiet line the answer comes soon."""
    for corrupted in (0, 50, 450):
        quality = LineQuality(1000, corrupted)
        assert quality.rate**quality.bad_when_lost < 1e-8
    assert LineQuality(1000, 0).bad_when_lost <= 4
    assert LineQuality(1000, 450).bad_when_lost > LineQuality(1000, 450).alike_needed


def test_a_void_attempt_is_replayed() -> None:
    """It tells nothing either way."""
    assert settled(VOID, VOID, PASSES)[:2] == (Verdict.PASS, 3)


def test_what_is_polled_all_the_time_is_not_wrong_the_same_time_twice_by_noise() -> None:
    """The same frame spoilt in each strict attempt, but another time: the pass stands."""
    hits = [attempt(Verdict.FAIL, corrupted=(f"20h, time {number}: ",)) for number in (7, 90, 31)]
    assert settled(RETRIED, *hits)[0] is Verdict.PASS


def test_what_breaks_off_at_one_place_every_time_is_then_judged_as_it_comes() -> None:
    """A device that never answers 13h is no noisy line."""
    strictly_silent = attempt(Verdict.FAIL, corrupted=("13h: ",))
    verdict, count, strict = settled(VOID, VOID, VOID, strictly_silent)
    assert (verdict, count) == (Verdict.FAIL, 6)
    assert strict == [False] * 3 + [True] * 3


def test_a_pass_by_asking_again_is_checked_without_asking_again() -> None:
    """A device whose fault is cured by asking again must not pass for noise."""
    cured = attempt(Verdict.FAIL, corrupted=("20h: 15",))
    assert settled(RETRIED, cured)[:2] == (Verdict.FAIL, 4)
    assert settled(RETRIED, PASSES)[:2] == (Verdict.PASS, 2)


def test_strict_attempts_that_fail_each_in_its_own_way_leave_the_pass_standing() -> None:
    """That is what noise looks like."""
    wandering = [attempt(Verdict.FAIL, corrupted=(str(number),)) for number in range(3)]
    assert settled(RETRIED, *wandering)[:2] == (Verdict.PASS, 4)


def test_a_crash_over_spoilt_bytes_is_void_and_one_without_is_told() -> None:
    """A mistake of the suite is only believed when nothing else explains it."""
    assert settled(attempt(outcome=Outcome.ERROR, corrupted=("x",)), PASSES)[0] is Verdict.PASS
    assert settled(attempt(outcome=Outcome.ERROR))[1] == 1


def test_a_device_that_is_lost_between_attempts_is_not_replayed() -> None:
    """The engine finds out and says so."""
    asked = []

    def one(is_strict: bool) -> Attempt:
        asked.append(is_strict)
        return FAILS(is_strict)

    result = Replays(one, lambda: False, LineQuality()).conclude()
    assert len(asked) == 1
    assert result.verdict is Verdict.FAIL, "for the engine to withdraw"
