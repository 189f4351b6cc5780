"""Drawn sequences of motions on an MN400, and boards that confuse them, which are noticed.

``scripts/sweep_motions --sequences`` judges as many as one likes.
"""

from collections.abc import Callable
from typing import Any

import pytest
from mn400_sequences import drawn_sequence, judge_sequence

from axistwin.devices.mn400.mover import Mover

SEED = 2018
SAMPLE = 60
"""Within so many any of the wrong boards is noticed."""


@pytest.mark.strength
@pytest.mark.parametrize("part", range(2))
def test_drawn_sequences_keep_every_rule(part: int) -> None:
    """Each motion is as if it were alone, from where and when the one before has ended."""
    assert sum(judge_sequence(drawn_sequence(SEED, part * 60 + n)) for n in range(60)) > 300


@pytest.mark.strength
@pytest.mark.parametrize(
    "quirks",
    [
        {"queue_modal": False},
        {"quit_flushes_queue": False},
        {"pause_idle": "latch"},
        {"backlash_counts": True},
        {"power_on_mode": "absolute"},
        {"hold_scope": "M"},
        {"readcount_after_abort": "zero"},
        {"backlash_arc": "quadrants"},
    ],
    ids=",".join,
)
def test_another_reading_is_noticed(quirks: dict[str, Any]) -> None:
    """One of the first sequences goes otherwise than the default reading says."""
    with pytest.raises(AssertionError):
        judge_first(**quirks)


def judge_first(**quirks: Any) -> None:
    """Judge as many as need be."""
    for number in range(SAMPLE):
        judge_sequence(drawn_sequence(SEED, number), **quirks)


def forgetful(real: Callable[..., Any], mover: Any, now: int) -> None:
    """The end of a motion that does not remember its directions."""
    before = mover._memory
    real(mover, now)
    mover._memory = before


def hasty(real: Callable[..., Any], mover: Any, now: int) -> None:
    """The end of a motion that loses a step of the counters."""
    real(mover, now)
    mover._base = (mover._base[0] + (now % 7 == 0), *mover._base[1:])


def greedy(real: Callable[..., Any], mover: Any, now: int) -> None:
    """The end of a motion that lets the next pause go."""
    real(mover, now)
    mover._reasons.add("command")


@pytest.mark.strength
@pytest.mark.parametrize("fault", [forgetful, hasty, greedy])
def test_a_board_that_confuses_its_motions_is_noticed(
    fault: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What each motion leaves to the next one."""
    real = Mover._finish
    monkeypatch.setattr(Mover, "_finish", lambda mover, now: fault(real, mover, now))
    with pytest.raises(AssertionError):
        judge_first()
