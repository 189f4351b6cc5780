"""What `scripts/run` prints at its end: one table for all twins, and what failed."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

from axistwin_conformance.report.json import fold

RACK = Path(__file__).parents[2] / "scripts" / "rack.py"


def verdicts(*found: tuple[tuple[str, ...], Any]) -> list[str]:
    """The lines."""
    spec = importlib.util.spec_from_file_location("rack", RACK)
    assert spec is not None
    assert spec.loader is not None
    rack = sys.modules["rack"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(rack)
    lines: list[str] = rack.verdicts(found)
    assert len(lines) <= rack.MOST_LINES - rack.LINES_AROUND
    assert max(map(len, lines)) <= rack.WIDTH
    return lines


def test_a_wrong_twin_is_told_with_what_failed_and_how_to_see_it_again(wrong_run: Any) -> None:
    """Its sentences, and its command."""
    report = fold(wrong_run)
    lines = verdicts((("conform", "toy", "--port", "./toy"), report))
    counts = report["finished"]["counts"]
    assert lines[0].split() == ["twin", "verdict", "judged", "failed", "open", "seconds"]
    assert lines[1].startswith("toy   does not conform")
    assert f"  {counts['fail']}  " in lines[1]
    text = " ".join(" ".join(lines).split())
    assert "_wrong: The letter Q: q; expected z or Z." in text
    assert "again: axistwin conform toy --port ./toy" in text
    assert "judged: requirements with a verdict" in text
    assert "open: inconclusive." in text


def test_many_failures_of_many_twins_stay_within_forty_lines(wrong_run: Any) -> None:
    """What finds no room is counted."""
    report = fold(wrong_run)
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    first = check["findings"][0]
    check["findings"] = [first | {"sentence": f"Sentence {n}. " * 20} for n in range(30)]
    lines = verdicts(*[(("conform", f"toy-{n}"), report) for n in range(4)])
    assert sum(line.startswith("  and ") and line.endswith(" more") for line in lines) == 4


def test_the_first_failure_is_told_however_long_it_is(wrong_run: Any) -> None:
    """As far as there is room."""
    report = fold(wrong_run)
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    first = check["findings"][0]
    check["findings"] = [first | {"sentence": "It went on. " * 200}]
    lines = verdicts((("conform", "toy"), report), (("conform", "other"), report))
    assert sum("_wrong: It went on." in line for line in lines) == 2
    assert sum(line.endswith(" …") for line in lines) == 2


def test_a_twin_without_a_report_is_told_with_its_last_words() -> None:
    """It may have crashed."""
    lines = verdicts((("conform", "toy"), "first\nsecond\nthird\nlast"))
    assert lines[1].split() == ["toy", "no", "verdict"]
    assert lines[-1].strip() == "last"
    assert "first" not in " ".join(lines)
