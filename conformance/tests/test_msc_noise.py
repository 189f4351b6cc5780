"""On a line that loses, turns or delays bytes on their way to an MSC: never a wrong verdict, and no
flag set twice."""

from __future__ import annotations

import pytest
from noisy_line import FATES, NoisyPort, NoisyRun, noisy_run

from axistwin_conformance.msc.family import TWIN_GROUNDS
from axistwin_conformance.verdicts import Verdict

KINDS = {"mixed": FATES, **{one: (one,) for one in FATES}}
HONEST = (0, 4)  # conforms, or nothing failed and something stayed inconclusive
LEAST_PASSED = {2000: 100, 500: 60}  # noise costs certainty, but not everything


class NoisyMsc(NoisyPort):
    """A line to controllers; what they hold is asked of the twins themselves."""

    def _stored(self) -> tuple[object, ...]:
        return tuple(
            (
                tuple(twin.variables[address] for address in TWIN_GROUNDS.variables[::4]),
                tuple(twin.flags[number] for number in TWIN_GROUNDS.flags),
            )
            for twin in self.twins
        )


def judge_healthy(every: int, seed: int, kind: str, *words: str) -> NoisyRun:
    """A healthy twin behind a noisy line: no failure, no quirk, everything as it was."""
    run = noisy_run(every, seed, *words, fates=KINDS[kind], model="msc-250", port=NoisyMsc)
    told = [
        (one.requirement.id, one.verdict, one.reason)
        for one in run.result.requirements
        if one.verdict in (Verdict.FAIL, Verdict.QUIRK)
    ]
    assert told == []
    assert run.result.exit_status in HONEST, run.result.sentence
    assert run.is_put_back
    return run


def passed(run: NoisyRun) -> int:
    """How many requirements passed."""
    return sum(one.verdict is Verdict.PASS for one in run.result.requirements)


@pytest.mark.slow
@pytest.mark.parametrize("every", [2000])
def test_a_healthy_twin_never_fails_behind_a_noisy_line(every: int) -> None:
    """It costs time and certainty, never a verdict."""
    assert passed(judge_healthy(every, 1, "mixed")) >= LEAST_PASSED[every]


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_where_many_exchanges_are_spoilt_nothing_is_made_up(kind: str) -> None:
    """One byte in 500: values, blocks, flags, replies refused, packets cut short."""
    run = judge_healthy(500, 7, kind, "MSC-DWRITE-02", "MSC-CFLAG-02", "MSC-LNK-10", "MSC-LNK-03")
    assert run.hits > 0, "there was noise"


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_is_found_behind_any_noise(kind: str) -> None:
    """One byte in 200 spoils the first exchanges too."""
    hits = [judge_healthy(200, seed, kind, "MSC-RQSTAT-02").hits for seed in range(200, 202)]
    assert sum(hits) > 0, "there was noise"


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", LEAST_PASSED)
@pytest.mark.parametrize("seed", range(100, 104))
def test_whatever_the_noise_a_healthy_twin_never_fails(every: int, kind: str, seed: int) -> None:
    """Each kind alone, and mixed, at two rates."""
    assert passed(judge_healthy(every, seed, kind)) >= LEAST_PASSED[every]
