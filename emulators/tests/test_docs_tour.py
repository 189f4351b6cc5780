"""CONTRIBUTING.md leads to files and names that exist, and shows the layers as they are."""

import ast
import re
import tomllib
from pathlib import Path

import pytest

from axistwin_conformance.families.catalog import find_family

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "CONTRIBUTING.md"
TEXT = PAGE.read_text(encoding="utf-8")
MENTIONED = sorted(set(re.findall(r"`((?:emulators|conformance|scripts|docs)/[^`\s]+)`", TEXT)))
REMEDY = "find where it has gone and correct CONTRIBUTING.md"


def names_in(source: str) -> set[str]:
    """What a module defines: classes, functions, values, and the members of its classes."""
    found = set()

    def collect(body: list[ast.stmt], prefix: str) -> None:
        for node in body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found.add(prefix + node.name)
            if isinstance(node, ast.ClassDef):
                collect(node.body, f"{prefix}{node.name}.")
            targets = node.targets if isinstance(node, ast.Assign) else []
            targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
            found.update(prefix + each.id for each in targets if isinstance(each, ast.Name))

    collect(ast.parse(source).body, "")
    return found


@pytest.mark.parametrize("mentioned", MENTIONED)
def test_what_the_tour_names_exists(mentioned: str) -> None:
    """`path` or `path:name`: the file is there, and the name is defined in it."""
    path, _, name = mentioned.partition(":")
    assert (ROOT / path).exists(), f"there is no {path}; {REMEDY}"
    if not name:
        return
    text = (ROOT / path).read_text(encoding="utf-8")
    known = names_in(text) if path.endswith(".py") else re.findall(r"[\w-]+", text)
    assert name in known, f"{path} has no {name}; {REMEDY}"


def test_the_tour_is_a_walk() -> None:
    """It has its four ways, each with several stations."""
    ways = re.split(r"^### ", TEXT.partition("## A tour of the house")[2], flags=re.MULTILINE)[1:]
    assert [way.splitlines()[0] for way in ways] == [
        "A 13h frame becomes motion",
        "MACS-FRAME-03 is judged",
        "A new quirk",
        "A new family",
    ]
    assert all(way.count(".py") >= 3 for way in ways)


def test_the_check_of_the_tour_judges_its_requirement() -> None:
    """MACS-FRAME-03 is judged where the tour says, by a check of that name."""
    (name,) = re.findall(r"checks/frames\.py:(\w+)`", TEXT)
    checks = {check.name: check for check in find_family("mac23").checks()}
    assert "MACS-FRAME-03" in checks[name].requirements


@pytest.mark.parametrize(
    ("package", "heading"),
    [("axistwin.", "**The twins**"), ("axistwin_conformance.", "**The suite**")],
)
def test_the_tables_of_layers_are_the_contracts(package: str, heading: str) -> None:
    """Same layers, same order as import-linter enforces; correct the table in CONTRIBUTING.md."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    (layers,) = (
        contract["layers"]
        for contract in contracts
        if contract["type"] == "layers" and contract["layers"][0].startswith(package)
    )
    table = TEXT.partition(heading)[2].partition("| --- | --- |\n")[2].partition("\n\n")[0]
    shown = [set(re.findall(r"`(\w+)`", row.split("|")[1])) for row in table.splitlines()]
    assert shown == [
        {module.strip().removeprefix(package) for module in layer.split("|")} for layer in layers
    ]
