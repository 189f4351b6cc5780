"""What changed between two runs."""

from __future__ import annotations

import copy
import io
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from rich.console import Console

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform
from axistwin_conformance.report import json as report_json
from axistwin_conformance.report.compare import (
    BEST_FIRST,
    Change,
    changes,
    circumstances,
    print_changes,
)
from axistwin_conformance.report.json import Report, fold


@pytest.fixture
def old(wrong_run: list[dict[str, Any]]) -> Report:
    """A report."""
    return fold(wrong_run)


@pytest.fixture
def new(old: Report) -> Report:
    """The same, to be changed."""
    return copy.deepcopy(old)


def judge(report: Report, key: str, verdict: str, reason: str = "") -> None:
    """Let a report say something else about a requirement."""
    [one] = [one for one in report["requirements"] if one["id"] == key]
    one |= {"verdict": verdict, "reason": reason}


def compare(tmp_path: Path, old: Report, new: Report, *more: str) -> Result:
    """Type the command."""
    paths = [tmp_path / "old.json", tmp_path / "new.json"]
    for path, report in zip(paths, (old, new), strict=True):
        path.write_text(report_json.to_text(report))
    return CliRunner().invoke(conform, ["--compare", *map(str, paths), *more])


@pytest.mark.parametrize("name", ["report.json", "events.jsonl"])
def test_the_folders_of_reports_are_compared(
    tmp_path: Path, old: Report, wrong_run: list[dict[str, Any]], name: str
) -> None:
    """By report.json, or, where the run was killed before it wrote that, by the events."""
    events = "".join(f"{json.dumps(event)}\n" for event in wrong_run)
    text = {"report.json": report_json.to_text(old), "events.jsonl": events}[name]
    folders = [tmp_path / "old", tmp_path / "new"]
    for folder in folders:
        folder.mkdir()
        (folder / name).write_text(text)
    result = CliRunner().invoke(conform, ["--compare", *map(str, folders)])
    assert (result.exit_code, result.output) == (0, "No verdict changed.\n")


def test_a_folder_without_a_report_is_named(tmp_path: Path) -> None:
    """With the file that is missing."""
    result = CliRunner().invoke(conform, ["--compare", str(tmp_path), str(tmp_path)])
    assert result.exit_code == 2
    assert f"cannot read {tmp_path / 'report.json'}" in result.output


def test_equal_runs_have_changed_nothing(tmp_path: Path, old: Report, new: Report) -> None:
    """Exit 0, whatever the verdicts are; times and bytes always differ."""
    new["run"]["started_at"] = "2031-01-01T00:00:00+00:00"
    new["checks"] = []
    result = compare(tmp_path, old, new)
    assert (result.exit_code, result.output) == (0, "No verdict changed.\n")


def test_only_changed_verdicts_are_told_with_the_reason(
    tmp_path: Path, old: Report, new: Report
) -> None:
    """One line each, old and new; exit 1 as one of them got worse."""
    judge(new, "MACS-LINE-01", "fail", "admissible: 1, came: 2")
    judge(new, "MACS-FRAME-01", "pass")
    result = compare(tmp_path, old, new)
    assert result.exit_code == 1
    assert result.output.splitlines() == [
        "MACS-LINE-01  pass → fail: admissible: 1, came: 2",
        "MACS-FRAME-01  fail → pass",
        "2 verdicts changed, 1 for the worse.",
    ]


def test_a_change_for_the_better_alone_exits_0(tmp_path: Path, old: Report, new: Report) -> None:
    """It is told all the same."""
    judge(new, "MACS-FRAME-01", "pass")
    result = compare(tmp_path, old, new)
    assert result.exit_code == 0
    assert "1 verdict changed, none for the worse." in result.output


@pytest.mark.parametrize("best", range(len(BEST_FIRST)))
@pytest.mark.parametrize("worst", range(len(BEST_FIRST)))
def test_worse_is_down_the_scale(best: int, worst: int) -> None:
    """Every verdict has a place; coverage that is lost is worse, too."""
    assert set(BEST_FIRST) == set(Verdict)
    change = Change("MACS-LINE-01", BEST_FIRST[best], BEST_FIRST[worst], "")
    assert change.is_worse is (worst > best)


def test_what_a_run_did_not_ask_about_is_not_run(old: Report, new: Report) -> None:
    """A pass that is no longer judged is a loss."""
    new["requirements"] = new["requirements"][1:]
    [gone] = changes(old, new)
    assert (gone.requirement, gone.new, gone.is_worse) == ("MACS-LINE-01", Verdict.NOT_RUN, True)
    [come] = changes(new, old)
    assert (come.old, come.new, come.is_worse) == (Verdict.NOT_RUN, Verdict.PASS, False)


def test_another_quirk_is_a_change(old: Report, new: Report) -> None:
    """The device has changed its reading; nobody can say for better or worse."""
    judge(new, "MACS-REPLY-01", "quirk", "xon_byte=12h")
    [one] = changes(old, new)
    assert (one.old, one.new, one.is_worse) == (Verdict.QUIRK, Verdict.QUIRK, False)


def test_other_circumstances_are_told_first(tmp_path: Path, old: Report, new: Report) -> None:
    """They may explain what changed."""
    new["run"]["level"] = "quick"
    new["run"]["allowed"] = ["passive"]
    new["device"]["summary"] = "another toy"
    assert "level: full → quick" in circumstances(old, new)
    result = compare(tmp_path, old, new)
    assert "note: not the same device: a toy → another toy" in result.output
    assert result.exit_code == 0


def test_the_comparison_is_one_json_object_for_programs(
    tmp_path: Path, old: Report, new: Report
) -> None:
    """The same, and the same exit status."""
    judge(new, "MACS-LINE-01", "inconclusive", "noise")
    result = compare(tmp_path, old, new, "--json")
    assert result.exit_code == 1
    assert json.loads(result.output) == {
        "changes": [
            {
                "requirement": "MACS-LINE-01",
                "old": "pass",
                "new": "inconclusive",
                "worse": True,
                "reason": "noise",
            }
        ],
        "differences": [],
    }


def test_on_a_terminal_it_is_a_table() -> None:
    """With a header, and verdicts in their colours."""
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=80)
    print_changes(console, [Change("MACS-LINE-01", Verdict.PASS, Verdict.FAIL, "late")], [])
    assert "requirement" in out.getvalue()
    assert "\x1b[1;31mfail" in out.getvalue()


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--compare", "missing.json", "missing.json"), "cannot read missing.json"),
        (("mac23", "--compare", "a", "b"), "--compare runs nothing: leave out 'mac23'"),
        ((), "name a MODEL to judge: mac23"),
    ],
)
def test_mistakes_get_one_line_and_exit_2(words: tuple[str, ...], complaint: str) -> None:
    """No traceback."""
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 2
    assert complaint in result.output
    assert len(result.output.splitlines()) == 1
