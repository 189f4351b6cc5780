"""On a line that loses, turns or delays bytes on their way to an MSC: never a wrong verdict, and no
flag set twice."""

from __future__ import annotations

import pytest
from noise_verdict import judge_healthy, passed
from noisy_line import FATES, NoisyPort, NoisyRun, noisy_run
from small_scratch import FLAGS, VARIABLES

pytestmark = pytest.mark.strength

KINDS = {"mixed": FATES, **{one: (one,) for one in FATES}}
LEAST_PASSED = {2000: 100, 500: 60}  # noise costs certainty, but not everything


class NoisyMsc(NoisyPort):
    """A line to controllers; what they hold is asked of the twins themselves."""

    def _stored(self) -> tuple[object, ...]:
        return tuple(
            (
                tuple(twin.variables[address] for address in VARIABLES[::4]),
                tuple(twin.flags[number] for number in FLAGS),
            )
            for twin in self.twins
        )


def healthy(every: int, seed: int, kind: str, *words: str) -> NoisyRun:
    """A healthy twin behind a noisy line, judged."""
    run = noisy_run(every, seed, *words, fates=KINDS[kind], model="msc-250", port=NoisyMsc)
    return judge_healthy(run)


@pytest.mark.strength(seconds=30)
@pytest.mark.parametrize("every", [2000])
def test_a_healthy_twin_never_fails_behind_a_noisy_line(every: int) -> None:
    """It costs time and certainty, never a verdict."""
    assert passed(healthy(every, 1, "mixed")) >= LEAST_PASSED[every]


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize("kind", KINDS)
def test_where_many_exchanges_are_spoilt_nothing_is_made_up(kind: str) -> None:
    """One byte in 500: values, blocks, flags, replies refused, packets cut short."""
    run = healthy(500, 7, kind, "MSC-DWRITE-02", "MSC-CFLAG-02", "MSC-LNK-10", "MSC-LNK-03")
    assert run.hits > 0, "there was noise"


@pytest.mark.parametrize("kind", KINDS)
def test_a_device_is_found_behind_any_noise(kind: str) -> None:
    """One byte in 200 spoils the first exchanges too."""
    hits = [healthy(200, seed, kind, "MSC-RQSTAT-02").hits for seed in range(200, 202)]
    assert sum(hits) > 0, "there was noise"


@pytest.mark.soak
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("every", LEAST_PASSED)
@pytest.mark.parametrize("seed", range(100, 104))
def test_whatever_the_noise_a_healthy_twin_never_fails(every: int, kind: str, seed: int) -> None:
    """Each kind alone, and mixed, at two rates."""
    assert passed(healthy(every, seed, kind)) >= LEAST_PASSED[every]


@pytest.mark.parametrize("seed", [5, 8])
def test_sequences_on_a_noisy_line_make_nothing_up(seed: int) -> None:
    """One byte in 1000 spoils every seventh block; what comes is believed if it comes again."""
    judge_healthy(
        noisy_run(
            1000, seed, "many_mixed_sequences_agree_with_the_model", level="full",
            model="msc-250", port=NoisyMsc,
        )
    )  # fmt: skip
