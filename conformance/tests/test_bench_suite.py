"""scripts/bench-suite: what it reports."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "scripts" / "bench_suite.py"


def test_the_benchmark_tells_four_rates_and_two_ratios() -> None:
    """Each contestant has run; the ratio of the only slices stands beside its aim."""
    ran = subprocess.run(
        [sys.executable, SCRIPT, "--seconds", "0", "--json"],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    told = json.loads(ran.stdout)
    limit, stateful, one_draw, canned = (
        told[name]
        for name in (
            "machine, trivial device", "machine, built-in twin", "one-draw, built-in twin",
            "one-draw, canned replies",
        )
    )  # fmt: skip
    assert min(one["steps"] for one in (limit, stateful, one_draw, canned)) > 100
    assert canned["median_per_s"] > one_draw["median_per_s"], "without the twin"
    for name, one, other, aim in (
        ("stateful / limit", stateful, limit, 0.5),
        ("one-draw / stateful", one_draw, stateful, 10),
    ):
        (mine,), (its,) = one["slices_per_s"], other["slices_per_s"]
        ratio = mine / its
        assert told[name]["ratio"] == ratio
        assert (told[name]["aim"], told[name]["is_reached"]) == (aim, ratio >= aim)
