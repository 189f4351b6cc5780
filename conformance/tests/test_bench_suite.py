"""scripts/bench-suite: what it reports."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.strength

SCRIPT = Path(__file__).parents[2] / "scripts" / "bench_suite.py"


def test_the_benchmark_tells_five_rates_and_their_ratios() -> None:
    """Each contestant has run; the ratio of the only slices stands beside its aim."""
    ran = subprocess.run(
        [sys.executable, SCRIPT, "--seconds", "0", "--jobs", "2", "--json"],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    told = json.loads(ran.stdout)
    limit, stateful, one_draw, canned, shared = (
        told[name]
        for name in (
            "machine, trivial device", "machine, built-in twin", "one-draw, built-in twin",
            "one-draw, canned replies", "one-draw, all cores",
        )
    )  # fmt: skip
    assert min(one["steps"] for one in (limit, stateful, one_draw, canned)) > 100
    assert shared["steps"] == 2 * 60 * 200, "two processes, a check each"
    assert canned["median_per_s"] > one_draw["median_per_s"], "without the twin"
    for name, one, other, aim, key in (
        ("stateful / limit", stateful, limit, 0.5, "slices_per_s"),
        ("one-draw / stateful", one_draw, stateful, None, "slices_per_s"),
        ("all cores / stateful", shared, stateful, None, "slices_per_s"),
        ("the same by the clock", shared, stateful, None, "slices_by_clock_per_s"),
    ):
        (mine,), (its,) = one[key], other[key]
        ratio = mine / its
        assert told[name]["ratio"] == ratio
        assert told[name]["aim"] == aim
