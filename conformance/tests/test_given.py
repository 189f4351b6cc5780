"""What is typed and could only be dropped, or is empty, is a mistake that is told in a line."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from axistwin_conformance.cli import conform


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to be in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(words: list[str], folder: Path) -> str:
    """The line of a mistake; nothing is left in the folder that it was made in."""
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 2, result.output
    assert not list(folder.iterdir())
    return result.output.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "lost"),
    [
        ("mac23 --list --dry-run", "--dry-run"),
        ("mac23 --list --report out", "--report"),
        ("mac23 --list --detect out.toml", "--detect"),
        ("mac23 --list --replay 0102", "--replay"),
        ("mac23 --list -x", "--exitfirst"),
        ("--compare a b --report out", "--report"),
        ("--compare a b --level quick", "--level"),
        ("--compare a b --list", "--list"),
    ],
)
def test_an_option_that_would_be_dropped_is_refused(words: str, lost: str, folder: Path) -> None:
    """It names the one that runs nothing, and the one to leave out."""
    option = "--compare" if "--compare" in words else "--list"
    assert f"{option} runs nothing: leave out {lost}" in refused(words.split(), folder)


def test_what_goes_together_is_taken() -> None:
    """A list as JSON, and the plan of a whole command as it will be run."""
    for more in (["--list", "--json"], ["--dry-run", "--report", "out", "--seed", "3"]):
        result = CliRunner().invoke(conform, ["mac23", "MACS-LINE-02", *more])
        assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    "words",
    [
        ["mac23", ""],
        ["mac23", "MACS-LINE-02", " "],
        ["mac23", "--port", ""],
        ["mac23-can", "--can", ""],
        ["mac23", "--report", ""],
        ["mac23", "--replay", ""],
        ["mac23", "--profile", ""],
        ["mac23", "--detect", ""],
        ["mac23", "--rig", "command", "--rig-command", ""],
        ["--compare", "", "new"],
    ],
    ids=" ".join,
)
def test_an_empty_word_is_a_mistake(words: list[str], folder: Path) -> None:
    """A variable of the shell that is not set neither chooses everything nor the folder here."""
    assert "it is empty: write something, or leave it out" in refused(words, folder)


@pytest.mark.parametrize("span", ["-", "5-", "-5"])
def test_half_a_span_is_told_how_a_whole_one_is_written(span: str, folder: Path) -> None:
    """Not half of it as an address that is none."""
    told = refused(["msc-250", f"--variables={span}"], folder)
    assert f"'{span}' is no span: write FIRST-LAST within 0-65535" in told


@pytest.mark.parametrize("option", ["--report", "--detect", "--port", "--profile", "--replay"])
def test_a_name_that_is_not_utf_8_is_refused_before_the_run(option: str, folder: Path) -> None:
    """It could be written into no report, and was found out when the run was over."""
    told = refused(["mac23", option, "out\udcff"], folder)
    assert told.endswith(f"'{option}': out\\xff is not UTF-8: give it another name")
