"""The front page: every command runs as printed, and its pictures are current."""

import importlib
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from axistwin import testing
from axistwin.cli.program import main

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
PICTURES = ROOT / "docs" / "pictures"
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = "".join(
    (ROOT / "docs" / "how-to" / f"{name}.md").read_text(encoding="utf-8")
    for name in ("drive-a-contour", "use-the-panel")
)

BLOCKS = re.findall(r"```console\n(.*?)```", README, re.DOTALL)
LINES = [line for block in BLOCKS for line in re.findall(r"^\$ (.*)$", block, re.MULTILINE)]
COMMANDS = [words for line in LINES if (words := shlex.split(line, comments=True))[0] == "axistwin"]
AT_THE_PORTS = re.findall(r"^\| `(\./[\w-]+)`.*`axistwin (send [^`]+)` \|$", README, re.MULTILINE)
ASKING = ("send", "decode", "replay", "plot", "models", "doctor")
ELSEWHERE = ("scripts/run", "scripts/test")
"""What other tests run."""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder like a clone: with the files that the page names, and no other."""
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def chosen(*names: str) -> list[Any]:
    """The commands of these names, each as a parameter."""
    found = [words for words in COMMANDS if words[1] in names]
    return [pytest.param(words[1:], id=shlex.join(words[1:])) for words in found]


def test_every_command_is_run_by_one_of_these_tests() -> None:
    """Or by one that is named."""
    here = [*chosen("run"), *chosen(*ASKING), *chosen("conform")]
    assert len(here) == len(COMMANDS) >= 14
    others = {shlex.split(line, comments=True)[0] for line in LINES} - {"axistwin"}
    assert others == set(ELSEWHERE)


@pytest.mark.parametrize("words", chosen("run"))
def test_twins_are_started_as_printed(words: list[str], folder: Path) -> None:
    """They tell that they are ready, and end cleanly."""
    command = [sys.executable, "-m", "axistwin", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(f"ready {words[1].partition(':')[0]}:")
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


@pytest.mark.parametrize("words", chosen(*ASKING))
def test_what_looks_and_asks_runs_as_printed(words: list[str], folder: Path) -> None:
    """Beside a line with two modules."""
    with testing.start("mac23:0", "mac34-1:5", time=20) as line:
        Path("line").symlink_to(line.port)
        Path("mac23").symlink_to(line.port)
        result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    assert result.output


def test_every_port_of_scripts_run_answers_as_the_table_says(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Started as there, asked as printed."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    rack: Any = importlib.import_module("rack")
    tries = {link: shlex.split(words) for link, words in AT_THE_PORTS}
    assert set(tries) == {place.link for place in rack.PLACES}
    for place in rack.PLACES:
        with rack.running(place, folder / f"state-{place.judged}"):
            result = CliRunner().invoke(main, tries[place.link])
        assert result.exit_code == 0, result.output
        assert "\n< " in result.output


@pytest.mark.parametrize("words", chosen("conform"))
def test_judging_is_planned_as_printed(words: list[str], folder: Path) -> None:
    """The plan needs no device; how devices are judged other tests show."""
    result = CliRunner().invoke(main, list(dict.fromkeys([*words, "--dry-run"])))
    assert result.exit_code == 0, result.output


def test_every_picture_is_shown_and_there() -> None:
    """The front page and the pages on contours and on the panel have no other."""
    shown = set(re.findall(r"!\[[^\]]+\]\(docs/pictures/([\w.-]+)\)", README))
    shown |= set(re.findall(r"!\[[^\]]+\]\(../pictures/([\w.-]+)\)", PAGES))
    assert shown == {path.name for path in PICTURES.glob("*.[ps][nv]g")}
    assert (PICTURES / "failing-page.png").stat().st_size < 200_000


def test_the_pictures_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    """What they are made from is what it was; else run scripts/pictures."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    pictures: Any = importlib.import_module("pictures")
    made_from = pictures.contents()
    recorded = (PICTURES / "made-from.txt").read_text(encoding="utf-8")
    assert pictures.digests(made_from) == recorded, "stale: run scripts/pictures"
    for name in ("plot.svg", "failing-test.svg"):
        assert (PICTURES / name).read_text(encoding="utf-8") == made_from[name]
