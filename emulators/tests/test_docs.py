"""The documentation tells what the code does."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from axistwin.cli.program import main as program

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "fixtures").rglob("*.md"),
    ]
)
SOURCES = sorted(
    path
    for folder in ("emulators", "conformance", "scripts")
    for path in (ROOT / folder).rglob("*.py")
)


def name_of(path: Path) -> str:
    """The path of a page, as a test's name."""
    return str(path.relative_to(ROOT))


def anchors_of(page: Path) -> set[str]:
    """The headings of a page as GitHub links to them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", each.lower()).replace(" ", "-") for each in headings}


def commands_of(page: Path) -> Iterator[list[str]]:
    """The words of every command that a page lets its reader type."""
    blocks = re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    for block in blocks:
        for line in re.findall(r"^\$ (.*)$", block.replace("\\\n", " "), re.MULTILINE):
            lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;")
            lexer.whitespace_split = True
            words: list[str] = []
            for word in [*lexer, "|"]:
                if set(word) <= set("|&;"):
                    yield words
                    words = []
                else:
                    words.append(word)


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
@pytest.mark.parametrize(
    "name", ["", "run", "rack", "ctl", "watch", "models", "conform", "doctor", "decode", "plot"]
)
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


@pytest.mark.parametrize("name", ["", *program.list_commands(click.Context(program))])
def test_no_help_is_wider_than_80_columns(name: str) -> None:
    """Nor are its examples, which click leaves as they are."""
    words = [name, "--help"] if name else ["--help"]
    shown = CliRunner().invoke(program, words, terminal_width=80).output
    assert "Usage: " in shown
    assert not [line for line in shown.splitlines() if len(line) > 80]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_link_inside_the_documentation_leads_somewhere(page: Path) -> None:
    """Relative links of the pages point to files that exist, and to headings in them."""
    text = page.read_text(encoding="utf-8")
    missing = []
    for target, anchor in re.findall(r"\]\(([^)#:]*)(?:#([^):]*))?\)", text):
        path = (page.parent / target) if target else page
        if not path.exists() or (anchor and anchor not in anchors_of(path)):
            missing.append(f"{target}#{anchor}" if anchor else target)
    assert not missing, f"{name_of(page)}: {missing}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_in_the_documentation_can_be_typed(page: Path) -> None:
    """Commands of the program, with options that they have, and scripts that exist."""
    context = click.Context(program)
    for words in commands_of(page):
        if words and words[0].startswith("scripts/"):
            assert (ROOT / words[0]).exists(), words
        if not words or words[0] != "axistwin":
            continue
        command = program.get_command(context, words[1])
        assert command is not None, words
        known = {name for option in command.params for name in option.opts} | {"-h", "--help"}
        unknown = {word for word in words if re.match(r"--?[a-z]", word)} - known
        assert not unknown, f"{shlex.join(words)}: {unknown}"


def test_every_page_is_in_the_index() -> None:
    """docs/README.md leads to each page of the documentation."""
    index = ROOT / "docs" / "README.md"
    links = re.findall(r"\]\(([^)#:]+)\)", index.read_text(encoding="utf-8"))
    linked = {(index.parent / link).resolve() for link in links}
    pages = {page for page in PAGES if page.is_relative_to(index.parent)} - {index}
    assert not {name_of(page) for page in pages - linked}


def test_the_pages_that_the_source_names_exist() -> None:
    """A docstring that leads to docs/... leads to a page."""
    named = {
        (path, found)
        for path in SOURCES
        for found in re.findall(r"\bdocs/[\w/-]+\.md\b", path.read_text(encoding="utf-8"))
    }
    assert named
    missing = [f"{name_of(path)}: {page}" for path, page in named if not (ROOT / page).exists()]
    assert not missing


def test_the_readme_names_every_command_and_both_scripts() -> None:
    """A newcomer meets scripts/run, scripts/test and each command of the program."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = (
        *("axistwin run", "rack", "ctl", "send", "decode", "plot", "tap", "replay"),
        *("models", "doctor", "conform"),
    )
    for words in ("scripts/run", "scripts/test", *commands):
        assert words in text, words
