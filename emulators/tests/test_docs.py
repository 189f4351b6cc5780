"""The documentation tells what the code does."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.system
def test_the_generated_reference_is_fresh() -> None:
    """docs/reference holds what scripts/reference writes now."""
    result = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / "reference.py"), "--check"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


@pytest.mark.system
@pytest.mark.parametrize("name", ["", "run", "models", "conform", "doctor", "decode"])
def test_the_reference_shows_how_help_is_asked_for(name: str) -> None:
    """As the program shows it: `-h` is known everywhere."""
    page = (ROOT / "docs" / "reference" / "commands.md").read_text(encoding="utf-8")
    part = page.partition(f"## axistwin {name}\n" if name else "# Commands\n")[2]
    command = [sys.executable, "-m", "axistwin", *([name] if name else []), "-h"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout
    for text in (shown, part.split("\n## ")[0]):
        options = [line for line in text.splitlines() if "--help " in line]
        assert options
        assert all(line.startswith("  -h, --help  ") for line in options), options


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_inside_the_documentation_leads_somewhere(page: Path) -> None:
    """Relative links of the pages point to files that exist."""
    targets = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing, f"{page.name}: {missing}"


def test_the_readme_names_every_command_and_both_scripts() -> None:
    """A newcomer meets scripts/run, scripts/test and each command of the program."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = ("axistwin run", "decode", "models", "doctor", "conform")
    for words in ("scripts/run", "scripts/test", *commands):
        assert words in text, words
