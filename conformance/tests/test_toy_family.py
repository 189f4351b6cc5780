"""A fifth family, added by one folder on each side and nothing else; what such a family costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from axistwin_conformance.families.catalog import families

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
SUITE_SIDE = ROOT / "conformance" / "tests" / "toy"
TWIN_SIDE = ROOT / "emulators" / "tests" / "support" / "toy_twin"
FAMILY = SUITE_SIDE / "axistwin_conformance" / "families" / "toy"
MOST_LINES = 220  # of the suite's side
TIME_LIMIT_S = 120.0
UNLIKE = "axistwin://toy?time=virtual&quirk.acknowledge=A&quirk.keeps_level=false"
GRANTED = ("--allow", "stored,rig")


def conform(
    folder: Path, *words: str, sides: tuple[Path, ...] = (SUITE_SIDE, TWIN_SIDE)
) -> subprocess.CompletedProcess[str]:
    """Run the command with both folders on Python's path."""
    return subprocess.run(
        [sys.executable, "-m", "axistwin", "conform", "toy", *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sides))},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIME_LIMIT_S,
    )


def report(folder: Path) -> Any:
    """The report that a run has written there."""
    return json.loads((folder / "report" / "report.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run over the built-in lamp."""
    folder = tmp_path_factory.mktemp("toy")
    done = conform(folder, "--report", "report")
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert "The device conforms to toy" in done.stdout
    return folder


def test_it_is_a_family_by_its_folder_alone(tmp_path: Path) -> None:
    """Without the folder nobody has heard of it."""
    assert "toy" not in {family.name for family in families()}
    done = conform(tmp_path, sides=())
    assert (done.returncode, "unknown model 'toy'" in done.stderr) == (2, True)


def test_the_built_in_lamp_is_judged_and_reported(judged: Path) -> None:
    """Identity, checks, readings and verdicts are in the report, in the page as well."""
    told = report(judged)
    assert told["device"]["summary"] == "a lamp at level 0"
    assert {one["id"]: one["verdict"] for one in told["requirements"]} == dict.fromkeys(
        ("TOY-ASK-01", "TOY-SET-01", "TOY-SET-02", "TOY-MEM-01", "TOY-BTN-01"), "pass"
    )
    assert {one["switch"]: one["reading"] for one in told["readings"]} == {
        "acknowledge": "K", "keeps_level": "true"
    }  # fmt: skip
    assert (told["run"]["max_travel"], told["run"]["grounds"]) == (None, {})
    assert "TOY-MEM-01" in (judged / "report" / "report.html").read_text("utf-8")
    assert "TOY-MEM-01" in (judged / "report" / "junit.xml").read_text("utf-8")


def test_a_lamp_with_other_readings_shows_them(tmp_path: Path) -> None:
    """Behind its URL, as a device: quirks are named, and its profile is written."""
    done = conform(
        tmp_path, "--port", UNLIKE, *GRANTED, "--level", "quick", "--report", "report",
        "--detect", "lamp.toml",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    verdicts = {one["id"]: one["verdict"] for one in report(tmp_path)["requirements"]}
    assert [verdicts["TOY-SET-02"], verdicts["TOY-MEM-01"]] == ["quirk", "quirk"]
    profile = (tmp_path / "lamp.toml").read_text("utf-8")
    assert 'acknowledge = "A"' in profile
    assert 'keeps_level = "false"' in profile
    expected = conform(tmp_path, "--port", UNLIKE, *GRANTED, "--profile", "lamp.toml")
    assert expected.returncode == 0, expected.stdout
    other = conform(tmp_path, "--profile", "lamp.toml", "TOY-SET-02")
    assert other.returncode == 1, other.stdout


def test_a_port_gets_passive_tests_only(tmp_path: Path) -> None:
    """What is not allowed is not run, and the plan says why; the command starts the run again."""
    done = conform(tmp_path, "--port", "axistwin://toy?time=virtual", "--report", "report")
    assert done.returncode == 0, done.stdout
    told = report(tmp_path)
    assert set(told["run"]["left_out"]) == {
        "a_level_that_is_set_is_told",
        "the_level_outlives_the_supply",
        "the_button_turns_it_off",
    }
    assert told["run"]["command"] == (
        "axistwin conform toy --port 'axistwin://toy?time=virtual' --baud 9600 --seed 0"
    )


def test_what_it_does_not_have_is_refused_in_a_line(tmp_path: Path) -> None:
    """Options of other families, recordings, addresses and rates."""
    for words, told in (
        (("--max-travel", "5"), "--max-travel 5: the suite drives no axis of a toy"),
        (("--flags", "1-2"), "--flags: a toy has no variables and no flags to be named"),
        (("--eeprom-budget", "5"), "--eeprom-budget 5: toy has no EEPROM that the suite writes"),
        (("--replay", "01020304"), "nothing records operations of a toy"),
        (("--address", "1"), "address 1 is out of range"),
        (("--baud", "19200"), "--baud 19200: a toy knows 9600"),
    ):
        done = conform(tmp_path, *words)
        assert (done.returncode, told in done.stderr) == (2, True), done.stderr


def test_its_plan_is_shown(tmp_path: Path) -> None:
    """What would be done, and what is asked of it."""
    plan = conform(tmp_path, "--dry-run").stdout
    assert "cuts the supply" in plan
    assert "→ read first and put back" in plan
    listed = conform(tmp_path, "--list").stdout
    assert "TOY-AMB" not in listed
    assert listed.count("→ ") == 5


def test_a_rig_works_what_only_this_family_has(tmp_path: Path) -> None:
    """A row in its own folder: a command is asked for it, and is told of it in the row's words."""
    rig = ("--port", "axistwin://toy?time=virtual", *GRANTED, "--report", "report", "TOY-BTN-01")
    command = "sh -c 'echo $0 $1 $2 >> said' {verb} {name} {value}"
    conform(tmp_path, *rig, "--rig-command", command)  # its lamp was not pressed
    said = (tmp_path / "said").read_text("utf-8").splitlines()
    assert {"can power -", "can press -", "press button on"} <= {*said}
    conform(tmp_path, *rig, "--rig-command", "sh -c 'exit 3' {verb} {name} {value}")
    assert report(tmp_path)["run"]["left_out"]["the_button_turns_it_off"] == (
        "needs a rig that presses the button (--rig)"
    )


def test_what_a_family_costs() -> None:
    """All of the suite's side, its ledger included."""
    files = [one for one in FAMILY.rglob("*") if one.suffix in (".py", ".toml")]
    assert sum(len(one.read_text("utf-8").splitlines()) for one in files) <= MOST_LINES
