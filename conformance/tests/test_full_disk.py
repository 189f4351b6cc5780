"""A disk without room, and what becomes of a run: what was judged is told, what could not be
written is named, and the exit status is no verdict's."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from axistwin_conformance.base import events
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.families.mac.serial.family import FAMILY
from axistwin_conformance.report.folder import ReportFolder

pytestmark = pytest.mark.system

RUN = """
import resource, sys
limit = int(sys.argv.pop(1))
from axistwin_conformance.cli import conform
if limit >= 0:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
conform()
"""
JUDGED = "The device conforms to msc-250 in all that was judged: 2 of 3 requirements judged."
WORDS = ("msc-250", "MSC-RQSTAT", "--level", "quick")
FULL = Path("/dev/full")
NO_SPACE = "No space left on device"


def run(
    *words: str, limit: int = -1, stdout: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """The command in a process of its own; no file of it may be longer than `limit` bytes."""
    command = [sys.executable, "-c", RUN, str(limit), *WORDS, *words]
    with (stdout or Path("/dev/null")).open("w") as sink:
        return subprocess.run(
            command, stdout=sink if stdout else subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, timeout=120, check=False,
        )  # fmt: skip


def files(folder: Path) -> set[str]:
    """What is in a folder."""
    return {one.name for one in folder.iterdir()}


@pytest.mark.parametrize("name", ["report.html", "report.json", "junit.xml"])
def test_a_report_without_room_costs_no_verdict(tmp_path: Path, name: str) -> None:
    """The summary, the closing sentence, the other files; the one that is missing is named."""
    (tmp_path / name).symlink_to(FULL)
    ended = run("--report", str(tmp_path))
    assert ended.returncode == 2
    assert JUDGED in ended.stdout.splitlines()
    assert f"cannot write {tmp_path / name}: {NO_SPACE}; make room, or" in ended.stderr
    assert "--help" not in ended.stderr
    assert files(tmp_path) == {"report.html", "report.json", "junit.xml", "events.jsonl"} - {name}
    assert f"{tmp_path / name}" not in ended.stdout


def test_a_disk_that_fills_up_amid_a_run_is_told_and_the_run_goes_on(tmp_path: Path) -> None:
    """The events end with a whole line; nothing half is left, nor anything of an earlier run."""
    folder = tmp_path / "out"
    assert run("--report", str(folder)).returncode == 0
    ended = run("--report", str(folder), limit=5000)
    assert ended.returncode == 2
    assert JUDGED in ended.stdout.splitlines()
    assert f"cannot write {folder / 'events.jsonl'}: File too large; the run goes on" in (
        " ".join(ended.stdout.split())
    )
    (line,) = ended.stderr.splitlines()
    for name in ("events.jsonl", "report.json", "report.html"):
        assert f"{folder / name}" in line
    assert files(folder) == {"events.jsonl", "junit.xml"}
    told = [json.loads(one) for one in (folder / "events.jsonl").read_text().splitlines()]
    assert told[0]["event"] == "run_started"
    assert told[-1]["event"] != "run_finished"


def test_a_disk_that_is_full_before_the_run_is_told_before_it(tmp_path: Path) -> None:
    """With the file and the reason, and nothing is asked of the device."""
    (tmp_path / "events.jsonl").symlink_to(FULL)
    ended = run("--report", str(tmp_path))
    assert ended.returncode == 2
    assert f"cannot write the report: {NO_SPACE}: {tmp_path / 'events.jsonl'}" in ended.stderr
    assert "msc-250" not in ended.stdout


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_a_terminal_that_takes_nothing_leaves_the_report_whole(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    """The run goes on for the report's sake; the exit status tells that it was not heard."""
    ended = run("--report", str(tmp_path), *words, stdout=FULL)
    assert ended.returncode == 2
    assert f"cannot write the output: {NO_SPACE}" in ended.stderr
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["finished"]["sentence"] == JUDGED
    assert files(tmp_path) == {"report.html", "report.json", "junit.xml", "events.jsonl"}


@pytest.mark.parametrize("words", [(), ("--json",)])
def test_without_a_standard_output_the_verdict_is_the_exit_status(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    """As under `>&-`, or started by a service that gives it none."""
    command = [sys.executable, "-c", RUN, "-1", *WORDS, "--report", str(tmp_path), *words]
    ended = subprocess.run(
        ["sh", "-c", f"{shlex.join(command)} >&-"],
        stderr=subprocess.PIPE, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert "Traceback" not in ended.stderr
    assert ended.returncode == 0, ended.stderr
    assert files(tmp_path) == {"report.html", "report.json", "junit.xml", "events.jsonl"}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_the_characters_shows_others(encoding: str) -> None:
    """Arrows and degrees are missing in a C locale; JSON is UTF-8 wherever it is written."""
    told = {**os.environ, "PYTHONIOENCODING": encoding}
    for words in ((), ("--json",), ("--list",), ("--dry-run",)):
        command = [sys.executable, "-c", RUN, "-1", *WORDS, *words]
        ended = subprocess.run(command, capture_output=True, timeout=120, check=False, env=told)
        assert ended.returncode == 0, ended.stderr
        shown = ended.stdout.decode("utf-8" if words == ("--json",) else encoding)
        assert words or JUDGED in shown.splitlines()
        if words == ("--json",):
            last = json.loads(shown.splitlines()[-1])
            assert (last["event"], last["sentence"]) == ("run_finished", JUDGED)


def test_operations_without_room_are_named_and_cost_no_report(tmp_path: Path) -> None:
    """What plays a failure again is a file of its own."""
    (tmp_path / "operations").write_text("in the way")
    folder = ReportFolder(tmp_path, FAMILY.explain)
    folder(events.Note("it begins"))
    recording = Recording("mac23", (bytes(4),), check="some_check")
    folder(events.FailureStored("some_check", recording))
    folder.close()
    path = tmp_path / "operations" / recording.file_name
    assert folder.lost == {path: "File exists"}
    assert len((tmp_path / "events.jsonl").read_text().splitlines()) == 2
