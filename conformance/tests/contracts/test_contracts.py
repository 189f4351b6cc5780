"""Command line, texts, exit statuses, events, reports and profiles are as they were recorded.

The program is run as users run it, in a process and an empty folder of its own; what it said and
wrote is held against the files in `golden/`.  Virtual time only: how busy the machine is does not
matter.  What may differ (times, versions) is told in `golden.py`, and nothing else.

To record anew after a change that is meant, from the project's folder:

    AXISTWIN_RECORD_CONTRACTS=1 python -m pytest conformance/tests/contracts

Random sequences are drawn by Hypothesis: the versions of constraints.txt are taken for granted.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from contracts import planted
from contracts.golden import (
    FOLDER,
    HOW,
    as_lines,
    compare,
    difference,
    folded,
    steady,
    steady_lines,
    steady_text,
)

pytestmark = pytest.mark.strength

PROGRAM = (str(Path(sys.executable).with_name("axistwin")),)
# What a terminal or a user's settings would change.
FOREIGN = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR", "TERM", "PYTHONPATH")
TIME_LIMIT_S = 600.0  # of one command; only so that a hang ends


@dataclass(frozen=True, slots=True)
class Run:
    """A judged twin: the name of its record, what is typed behind `axistwin conform`, the exit
    status, and the zoo and name of the planted fault, if there is one."""

    name: str
    words: str
    status: int = 0
    fault: tuple[str, str] | None = None


HEALTHY = (
    Run("mac23-seed-1", "mac23 --seed 1 --level quick --json --detect profile.toml"),
    Run("mac23-can-seed-1", "mac23-can --seed 1 --level quick --json --detect profile.toml"),
    Run("msc-250-seed-1", "msc-250 --seed 1 --level quick --json --detect profile.toml"),
    Run(
        "mac23-seed-2",
        "mac23 --seed 2 --jobs 2 MACS-MULTI queries_are_answered_in_every_state"
        " when_the_fifo_runs_empty_the_axis_rests the_rate_can_be_programmed"
        " many_mixed_sequences_agree_with_the_model",
    ),
    Run(
        "mac23-can-seed-2",
        "mac23-can --seed 2 --jobs 1 MACC-GEN queries_are_answered_in_every_state"
        " other_lmt_services_are_ignored some_mixed_sequences_agree_with_the_model",
    ),
    Run(
        "msc-250-seed-2",
        "msc-250 --seed 2 --jobs 1 MSC-FLG each_flag_reads_alone_as_among_all"
        " a_flag_is_on_from_sflag_to_cflag some_mixed_sequences_agree_with_the_model",
    ),
)
FAULTY = (
    Run(
        "mac23-faulty",
        "mac23 --jobs 1 segments_run_at_their_own_constant_speed segment_steps_are_signed"
        " when_the_fifo_runs_empty_the_axis_rests some_mixed_sequences_agree_with_the_model",
        1,
        ("zoo", "the_last_step_of_a_segment_is_missing"),
    ),
    Run(
        "mac23-can-faulty",
        "mac23-can --jobs 1 f6_turns_counter_clockwise velocity_climbs_and_cruises_on_time"
        " the_first_parameter_byte_of_15h_is_ignored",
        1,
        ("zoo_can", "the_direction_is_the_first_byte"),
    ),
    Run(
        "mac23-can-faulty-sequences",
        "mac23-can --jobs 1 some_mixed_sequences_agree_with_the_model",
        1,
        ("zoo_can", "the_direction_is_the_first_byte"),
    ),
    Run(
        "msc-250-faulty",
        "msc-250 --jobs 1 MSC-SFLAG-02 some_mixed_sequences_agree_with_the_model",
        1,
        ("zoo_msc", "a_flag_that_is_set_again_goes_off"),
    ),
)

DECODED = {
    "mac23": "06 13 17\n02 30 31 34 30 30 32 30 30 30 30 30 30 30 30 30 30 30 41 32 03\n15\n",
    "mac23-can": "601#4000200000000000\n581#4200200000000000\n080#\n000#8101\n",
    "msc-250": "02 01 00 07 00 00 52 51 53 54 41 54 2C 02 13\n15\n",
}
# What is typed behind `axistwin`, by the name of the record; nothing of it opens a port.
TALKS = {
    "help": (
        "--help",
        "run --help",
        "models --help",
        "send --help",
        "decode --help",
        "doctor --help",
        "conform --help",
    ),
    "models": (
        "models",
        "models mac23",
        "models mac34-1",
        "models mac23-can",
        "models msc-250",
        "models msc-250 all",
        "models mac23 xon_byte",
        "models --json",
        "models msc-generic --json",
    ),
    "decode": tuple(f"decode {model}" for model in DECODED),
    "mistakes-of-options": (
        "conform mac23 --allow motoin",
        "conform mac23 --address 200",
        "conform mac23 --baud 12345",
        "conform mac23 --level slow",
        "conform mac23 --max-travel 0",
        "conform mac23 --duration 2h",
        "conform mac23 --can socketcan:can0",
        "conform mac23 --port 127.0.0.1:4001 --dry-run",
        "conform mac23 --nonsense",
    ),
    "mistakes-of-words": (
        "conform",
        "conform mac24",
        "conform mac23 MACS-LNE-01",
        "conform mac23 MACS-CMD-0Z",
        "conform mac23 --replay none.toml",
        "conform mac23 --profile none.toml",
        "conform mac23-can --port ./device",
        "conform mac23-can --can can0 --dry-run",
        "conform msc-250 --variables 5-1",
        "conform msc-250 --bench-program 240",
        "conform --compare old.json new.json",
        "run mac24",
        "run mac23:200",
        "run mac23 --quirk xon_byte=12h",
        "models mac24",
        "frobnicate",
    ),
    "plan-mac23": (
        "conform mac23 --list",
        "conform mac23 --port ./device --allow motion,stored --max-travel 500 --dry-run",
        "conform mac23 MACS-CMD-13 --port ./device --dry-run --json",
    ),
    "plan-mac23-can": (
        "conform mac23-can --list",
        "conform mac23-can --can socketcan:can0 --address 5 --allow motion --dry-run",
    ),
    "plan-msc-250": (
        "conform msc-250 --list",
        "conform msc-250 --port ./device --variables 2048-3071 --allow stored --dry-run",
    ),
}


def run_program(
    folder: Path, words: list[str], program: tuple[str, ...] = PROGRAM, typed: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run the program in a folder, whatever the settings of who runs the tests."""
    environment = {key: value for key, value in os.environ.items() if key not in FOREIGN}
    return subprocess.run(
        [*program, *words],
        cwd=folder,
        env=environment | {"LC_ALL": "C.UTF-8"},
        input=typed,
        capture_output=True,
        encoding="utf-8",
        check=False,
        timeout=TIME_LIMIT_S,
    )


def told(line: str, done: subprocess.CompletedProcess[str]) -> str:
    """A command, and all that came of it."""
    parts = [f"$ axistwin {line}\n", done.stdout]
    if done.stderr:
        parts += ["--- standard error\n", done.stderr]
    return steady_text("".join([*parts, f"--- exit status {done.returncode}\n\n"]))


def judge(run: Run, folder: Path) -> None:
    """Judge, and hold exit status, texts, events and report against the record."""
    words = ["conform", *run.words.split(), "--report", "report"]
    fault = run.fault and (sys.executable, planted.__file__, *run.fault)
    done = run_program(folder, words, fault or PROGRAM)
    assert done.returncode == run.status, done.stdout + done.stderr
    judge_report(run, folder / "report", done)
    compare(f"{run.name}/told.txt", told(shlex.join(words), done))


def judge_report(run: Run, folder: Path, done: subprocess.CompletedProcess[str]) -> None:
    """Hold the events, and the report made of them, against the record."""
    stream = (folder / "events.jsonl").read_text("utf-8")
    if "--json" in run.words:
        assert done.stdout == stream, "--json tells something else than events.jsonl"
        done.stdout = "(the events)\n"
    events = steady_lines(stream)
    compare(f"{run.name}/events.jsonl", as_lines(events))
    report = steady(json.loads((folder / "report.json").read_text("utf-8")))
    due, came = (json.dumps(one, ensure_ascii=False, indent=1) for one in (folded(events), report))
    assert came == due, f"report.json is not made of its events\n{difference(due, came)}\n{HOW}"


@pytest.mark.parametrize("run", HEALTHY, ids=lambda run: run.name)
def test_a_healthy_twin_is_judged_as_recorded(run: Run, tmp_path: Path) -> None:
    """Every event and every field of it, their order, the report, the profile, the exit status."""
    judge(run, tmp_path)
    if "--detect" in run.words:
        profile = (tmp_path / "profile.toml").read_text("utf-8")
        compare(f"{run.name}/profile.toml", steady_text(profile))


@pytest.mark.parametrize("run", FAULTY, ids=lambda run: run.name)
def test_a_faulty_twin_is_judged_as_recorded(run: Run, tmp_path: Path) -> None:
    """Failures are told as recorded to people, programs and build servers."""
    judge(run, tmp_path)
    report = tmp_path / "report"
    compare(f"{run.name}/junit.xml", steady_text((report / "junit.xml").read_text("utf-8")))
    stored = (f"=== {one.name}\n{one.read_text('utf-8')}" for one in operations_in(report))
    compare(f"{run.name}/operations.txt", steady_text("".join(stored)))


def operations_in(report: Path) -> list[Path]:
    """The files of operations in a report; there is no folder where there are none."""
    return sorted(report.glob("operations/*"))


def converse(lines: tuple[str, ...], folder: Path) -> tuple[str, set[int]]:
    """Type these commands; return what was said, and the exit statuses."""
    said, statuses = [], set()
    for line in lines:
        done = run_program(folder, line.split(), typed=DECODED.get(line.split()[-1], ""))
        said.append(told(line, done))
        statuses.add(done.returncode)
    return "".join(said), statuses


@pytest.mark.parametrize("name", TALKS)
def test_what_is_typed_is_answered_as_recorded(name: str, tmp_path: Path) -> None:
    """Help, models, bytes in words, lists and plans; a mistake gets its text and exit status 2."""
    said, statuses = converse(TALKS[name], tmp_path)
    assert statuses == ({2} if name.startswith("mistakes") else {0}), said
    compare(f"words/{name}.txt", said)
    assert not list(tmp_path.iterdir()), "none of this writes anything"


def test_nothing_recorded_tells_where_it_was_recorded() -> None:
    """No path of a machine, no module of the suite, and no mistake of the suite."""
    strange = re.compile(
        r"axistwin_conformance|error in the suite|\.venv|site-packages"
        r"|(?<![\w.])/(?:home|root|Users|tmp|var|private|usr|opt|mnt|srv|work)\b"
    )
    files = [one for one in FOLDER.rglob("*") if one.is_file()]
    found = {
        f"{one.relative_to(FOLDER)}: {match[0]}"
        for one in files
        for match in strange.finditer(one.read_text("utf-8"))
    }
    assert files
    assert found == set()


def test_every_record_has_its_test() -> None:
    """What nobody compares any more is deleted."""
    known = {run.name for run in (*HEALTHY, *FAULTY)}
    assert {one.name for one in FOLDER.iterdir()} == known | {"words", "failures"}
    assert {one.stem for one in (FOLDER / "words").iterdir()} == {*TALKS}
