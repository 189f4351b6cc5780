import ast
import graphlib
import re
import statistics
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TWINS = ROOT / "emulators" / "axistwin"
SUITE = ROOT / "conformance" / "axistwin_conformance"
TESTS = [ROOT / "emulators" / "tests", ROOT / "conformance" / "tests"]
SCRIPTS = ROOT / "scripts"

FUNCTION_LINES_MAX = 60
FUNCTION_LINES_MEDIAN_MAX = 8
FILE_LINES_MAX = 600
FOLDER_FILES_MAX = 14

PURE = sorted(
    [
        path
        for layer in ("kernel", "wire", "memory", "motion", "macroprogram", "devices")
        for path in (TWINS / layer).rglob("*.py")
        if path != TWINS / "devices" / "__init__.py"  # looks where else families are
    ]
    + [TWINS / "errors.py", TWINS / "runtime" / "network.py"]
    + [TWINS / "ports" / name for name in ("dialect.py", "slcan.py", "socketcand.py")]
)
"""What is told the time and handed bytes, and does nothing by itself."""

PURE_LIBRARIES = """
abc bisect collections contextlib dataclasses difflib enum fractions functools hashlib heapq
itertools json math operator re string struct types typing zlib
"""
"""Standard modules without clock, chance, threads or the outside world."""

IMPURE_NAMES = "open print input exec eval compile __import__ breakpoint globals id hash"
"""Built-ins that reach outside, or whose result differs from run to run."""

# Put together here, so that this file does not contain them itself.
MACHINE_PATHS = re.compile("|".join(f"/{name}/" for name in ("wo" + "rk", "ro" + "ot")))
LEFTOVERS = re.compile(
    r"\b(" + "|".join(["TO" + "DO", "FIX" + "ME", "XX" + "X", "HA" + "CK"]) + r")\b"
)

STATEMENTS = (ast.stmt, ast.excepthandler, ast.match_case)


def sources() -> list[Path]:
    """Every Python file of both packages, their tests and the scripts."""
    folders = (TWINS, SUITE, *TESTS, SCRIPTS)
    return sorted(path for folder in folders for path in folder.rglob("*.py"))


@cache
def functions(path: Path) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
    """All functions in a file, methods and inner ones included."""
    found = []
    left: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while left:
        node = left.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found.append(node)
        # Expressions hold none, and are most of the tree.
        left += [one for one in ast.iter_child_nodes(node) if isinstance(one, STATEMENTS)]
    return found


def lines_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Its length from ``def`` to its end, without the docstring."""
    length = (function.end_lineno or 0) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function) is not None:
        length -= (first.end_lineno or 0) - first.lineno + 1
    return length


def place(path: Path, line: int) -> str:
    """Where something is, for a message."""
    return f"{path.relative_to(ROOT)}:{line}"


def impurities(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and name of everything that pure code must not use."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or "."]
        else:
            if isinstance(node, ast.Name) and node.id in IMPURE_NAMES.split():
                yield node.lineno, node.id
            continue
        for name in names:
            package = name.partition(".")[0]
            if package != "axistwin" and package not in PURE_LIBRARIES.split():
                yield node.lineno, name


@pytest.mark.system
def test_the_layers_import_one_another_in_one_direction_only() -> None:
    """The contracts of pyproject.toml hold; twins and suite never import one another."""
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run(
        [program, "--no-cache", "--no-logo"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "0 broken" in done.stdout


@pytest.mark.parametrize("path", PURE, ids=lambda path: str(path.relative_to(TWINS)))
def test_pure_code_has_no_clock_no_chance_no_threads_and_no_files(path: Path) -> None:
    """It imports only its own layers and harmless libraries, and calls nothing that reaches out."""
    found = list(impurities(ast.parse(path.read_text(encoding="utf-8"))))
    assert not found, [f"{place(path, line)} uses {name}" for line, name in found]


@pytest.mark.parametrize(
    "text",
    [
        "import time",
        "import os.path",
        "from random import Random",
        "import math, asyncio",
        "from threading import Lock",
        "print('x')",
        "data = open('x')",
        "import logging",
    ],
)
def test_the_search_for_impurities_finds_them(text: str) -> None:
    """Clocks, chance, loops, threads, files and output are seen."""
    assert list(impurities(ast.parse(text)))


def imports_of(root: Path) -> dict[str, set[str]]:
    """What each module of a package imports of it, at the top, in functions and for types."""
    files = {
        ".".join(path.relative_to(root.parent).with_suffix("").parts).removesuffix(
            ".__init__"
        ): path
        for path in root.rglob("*.py")
    }
    graph: dict[str, set[str]] = {name: set() for name in files}
    for name, path in files.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                wanted = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = [f"{node.module}.{alias.name}" for alias in node.names]
                wanted = [each if each in files else node.module for each in inner]
            else:
                continue
            graph[name] |= {each for each in wanted if each in files and each != name}
    return graph


@pytest.mark.strength
@pytest.mark.parametrize("root", [TWINS, SUITE], ids=["twins", "suite"])
def test_no_files_import_one_another_in_a_circle(root: Path) -> None:
    """Imports within functions and for types included."""
    graph = imports_of(root)
    assert len(graph) > 100
    list(graphlib.TopologicalSorter(graph).static_order())  # raises CycleError, which names them


def test_families_of_devices_never_import_one_another() -> None:
    """Two of them may stand on one core, such as the axis of the MAC."""
    graph = imports_of(TWINS)
    families = [name.removesuffix(".family") for name in graph if name.endswith(".family")]
    families.remove("axistwin.devices")  # where it says what a family is
    assert len(families) >= 3
    crossing = [
        f"{name} imports {other}"
        for name, imported in graph.items()
        for family in families
        if name.startswith(f"{family}.")
        for other in imported
        if any(other.startswith(f"{each}.") for each in families if each != family)
    ]
    assert not crossing


def test_a_circle_would_be_found(tmp_path: Path) -> None:
    """One import within a function closes it."""
    root = tmp_path / "house"
    root.mkdir()
    (root / "__init__.py").write_text("")
    (root / "first.py").write_text("from house import second\n")
    (root / "second.py").write_text("def late():\n    from house.first import anything\n")
    with pytest.raises(graphlib.CycleError):
        list(graphlib.TopologicalSorter(imports_of(root)).static_order())


def test_no_folder_of_the_twins_has_more_than_fourteen_files() -> None:
    """Whoever opens one sees all of it at once."""
    folders = {path.parent for path in TWINS.rglob("*.py")}
    sizes = {str(folder): len(list(folder.glob("*.py"))) for folder in folders}
    assert not {folder: size for folder, size in sizes.items() if size > FOLDER_FILES_MAX}


@pytest.mark.strength
def test_class_names_are_unique() -> None:
    """A word stands for one thing, in all families and floors."""
    counts = Counter(
        node.name
        for path in TWINS.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert len(counts) > 300
    assert not [name for name, count in counts.items() if count > 1]


def test_functions_fit_a_screen() -> None:
    """At most 60 lines each, and half of them not more than 8."""
    lengths = {
        f"{place(path, function.lineno)} {function.name}": lines_of(function)
        for path in sources()
        for function in functions(path)
    }
    long = {name: length for name, length in lengths.items() if length > FUNCTION_LINES_MAX}
    assert not long
    assert statistics.median(lengths.values()) <= FUNCTION_LINES_MEDIAN_MAX


def test_files_stay_readable() -> None:
    """At most 600 lines each."""
    lengths = {str(path): path.read_text(encoding="utf-8").count("\n") for path in sources()}
    assert lengths
    assert not {path: length for path, length in lengths.items() if length > FILE_LINES_MAX}


@pytest.mark.strength
def test_every_test_says_in_one_line_what_it_shows() -> None:
    """The docstring is the behaviour."""
    tests = [
        (path, function)
        for folder in TESTS
        for path in sorted(folder.rglob("test_*.py"))
        for function in functions(path)
        if function.name.startswith("test_")
    ]
    assert len(tests) > 100
    silent = [
        f"{place(path, function.lineno)} {function.name}"
        for path, function in tests
        if len((ast.get_docstring(function) or "").splitlines()) != 1
    ]
    assert not silent


@pytest.mark.system
def test_no_file_speaks_of_a_machine_or_of_work_left_undone() -> None:
    """Neither absolute paths of where it was written, nor markers for later."""
    listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True)
    paths = [ROOT / name for name in listed.split("\0") if name]
    assert ROOT / "pyproject.toml" in paths
    found = []
    for path in paths:
        content = path.read_bytes() if path.is_file() else b""  # removed, and not committed yet
        if b"\0" in content:  # a picture or a font: no text to read
            continue
        for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
            if MACHINE_PATHS.search(line) or LEFTOVERS.search(line):
                found.append(f"{place(path, number)}: {line.strip()}")
    assert not found
