"""scripts/soak: a conversation over faulty wires in virtual time."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from axistwin.kernel.time import NS_PER_S
from axistwin.motion.plant import Plant

pytestmark = pytest.mark.strength

HOURS = 0.02
Soak = Callable[[str, int, float], bool]
MODELS = ("mac23", "mac23-can", "mn400", "msc-250")


@pytest.fixture
def soak(monkeypatch: pytest.MonkeyPatch) -> Soak:
    """The soak of one model; prints what came of it."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "scripts")
    found: Soak = importlib.import_module("soak").soak
    return found


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize("model", MODELS)
def test_the_same_seed_has_the_same_trace(
    soak: Soak, model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also the same faults; another seed has another trace."""
    told = []
    for seed in (17, 17, 19):
        assert soak(model, seed, HOURS)
        report = re.sub(r"memory [\d. ]+ MiB", "", capsys.readouterr().out)
        assert int(re.findall(r"(\d+) messages, .* [1-9]\d* faults", report)[0]) > 1000
        told.append(report)
    assert told[0] == told[1]
    assert len({digest for report in told for digest in re.findall(r"digest (\w+)", report)}) == 2


@pytest.mark.parametrize(
    ("slips_at_s", "told"), [(20, "held in no round"), (60, " in many_mixed_sequences")]
)
def test_a_twin_that_departs_from_the_model_is_told(
    soak: Soak,
    slips_at_s: int,
    told: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Its shaft slips by an increment, before or after the suite has asked for its readings."""
    right = Plant.position_at

    def slipped(plant: Plant, now_ns: int) -> int:
        return right(plant, now_ns) + (now_ns > slips_at_s * NS_PER_S)

    monkeypatch.setattr(Plant, "position_at", slipped)
    assert not soak("mac23", 17, 0.05)
    assert told in capsys.readouterr().out
