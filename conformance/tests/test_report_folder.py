"""The folder of `--report`: it belongs to one run at a time, and holds that run and no other."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from axistwin_conformance.base import interrupts
from axistwin_conformance.cli import conform
from axistwin_conformance.families.mac.serial.family import FAMILY
from axistwin_conformance.report import html, terminal
from axistwin_conformance.report.folder import ReportFolder

ALL = {"report.html", "report.json", "junit.xml", "events.jsonl"}


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[ReportFolder]:
    """One that a run is filling."""
    filled = ReportFolder(tmp_path, FAMILY.explain)
    yield filled
    filled.close()


def judge(path: Path) -> Result:
    """Judge the built-in twin by one requirement and report there."""
    words = ["mac23", "--allow", "passive", "--report", str(path), "MACS-FRAME-12"]
    return CliRunner().invoke(conform, words)


def test_what_an_earlier_run_has_left_is_gone_when_the_next_one_begins(tmp_path: Path) -> None:
    """A run that is killed leaves no verdicts that were another's."""
    for name in ALL:
        (tmp_path / name).write_text("of yesterday")
    (tmp_path / "notes.txt").write_text("of the user")
    ReportFolder(tmp_path, FAMILY.explain).close()
    assert {one.name for one in tmp_path.iterdir()} == {"events.jsonl", "notes.txt"}
    assert (tmp_path / "events.jsonl").read_text() == ""


def test_a_folder_that_another_run_fills_is_refused_before_anything_is_done(
    folder: ReportFolder, tmp_path: Path
) -> None:
    """Two streams in one file would be neither's."""
    refused = judge(tmp_path)
    assert refused.exit_code == 2
    told = f"cannot write the report: another run is writing its report there: {tmp_path}"
    assert told in refused.output
    assert "target" not in refused.output
    folder.close()
    assert judge(tmp_path).exit_code == 0


@pytest.mark.parametrize("number", interrupts.ENDING, ids=lambda one: one.name)
@pytest.mark.parametrize(
    ("place", "name"),
    [(terminal.TerminalReport, "_verdict_table"), (html, "render")],
    ids=["while the verdicts are told", "while the page is made"],
)
def test_an_interrupt_at_the_very_end_loses_no_report(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int, place: object, name: str
) -> None:
    """The device is at rest by then, the verdict reached: it is told, and all four files are."""
    done = getattr(place, name)

    def interrupted(*given: object) -> object:
        os.kill(os.getpid(), number)
        return done(*given)

    monkeypatch.setattr(place, name, interrupted)
    result = judge(tmp_path)
    assert result.exit_code == 0, result.output
    assert "The device conforms to mac23" in result.output
    assert {one.name for one in tmp_path.iterdir()} == ALL
    assert json.loads((tmp_path / "report.json").read_text())["finished"]["exit_status"] == 0


@pytest.mark.parametrize(
    ("place", "name", "left"),
    [
        (terminal.TerminalReport, "_open", ALL),
        (ReportFolder, "_write", ALL),
        (ReportFolder, "__call__", {"events.jsonl"}),
    ],
    ids=["while the plan is told", "while its first line is written", "before all words"],
)
def test_an_interrupt_at_the_very_beginning_leaves_what_there_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, place: type, name: str, left: set[str]
) -> None:
    """Nothing was asked of anybody yet, and the report says so."""
    done, times = getattr(place, name), iter([True])

    def interrupted(*given: object) -> object:
        if next(times, False):
            os.kill(os.getpid(), signal.SIGINT)
        return done(*given)

    monkeypatch.setattr(place, name, interrupted)
    result = judge(tmp_path)
    assert result.exit_code == 130, result.output
    assert {one.name for one in tmp_path.iterdir()} == left
    if left == ALL:
        report = json.loads((tmp_path / "report.json").read_text())
        assert report["finished"]["sentence"].startswith("Interrupted; nothing failed so far, 0 of")


def test_whoever_insists_at_the_very_end_is_heard(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A terminal that takes no more bytes, or a disk far away, must not hold anybody."""
    monkeypatch.setattr(interrupts, "AGAIN_S", 0.0)

    def interrupted(*given: object) -> str:
        for _ in range(2):
            os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("the second one is heard")

    monkeypatch.setattr(html, "render", interrupted)
    result = judge(tmp_path)
    assert isinstance(result.exception, SystemExit | KeyboardInterrupt), result.output
    assert result.exit_code != 0
