"""scripts/mutate: which checks judge an automatic mutant, and in which order."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

WHOLE = (("mn400", "full", ()),)


@pytest.fixture
def mutate(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, as a module."""
    monkeypatch.syspath_prepend(Path(__file__).parents[2] / "scripts")
    return importlib.import_module("mutate")


def stages_of(mutate: ModuleType, folder: Path, checks: tuple[str, ...]) -> list[Any]:
    """What judges a mutation of a line that these checks execute."""
    told: list[Any] = []
    path = folder / mutate.PACKAGE.name / "lamp.py"
    path.parent.mkdir()
    path.write_text("ON = 1\n", encoding="utf-8")

    class Recording(mutate.Bench):  # type: ignore[misc, name-defined]
        def _run(self, stages: Any) -> dict[str, Any]:
            told.extend(stages)
            return {"outcome": "passed"}

    mutation = mutate.Mutation("lamp.py", 1, "ON = 1", "ON = (2)", "ON = (2)\n", checks=checks)
    assert Recording(folder).judge(mutation, WHOLE) == {"outcome": "passed", "stages": 1}
    return told


def test_the_few_checks_that_execute_a_line_judge_it_first(
    mutate: ModuleType, tmp_path: Path
) -> None:
    """What they let pass, the whole run judges."""
    checks = ("a_lamp_is_lit", "a_lamp_goes_out")
    assert stages_of(mutate, tmp_path, checks) == [("mn400", "full", checks), *WHOLE]


@pytest.mark.parametrize("number", [0, 41])
def test_where_no_check_or_most_execute_a_line_the_whole_run_judges(
    mutate: ModuleType, tmp_path: Path, number: int
) -> None:
    """A line of a table is executed at the import, one of the frames by every check."""
    checks = tuple(f"check_{one}" for one in range(number))
    assert stages_of(mutate, tmp_path, checks) == list(WHOLE)


def test_each_executed_line_has_its_checks(
    monkeypatch: pytest.MonkeyPatch, mutate: ModuleType
) -> None:
    """What is executed between the checks alone has none."""
    by_line = importlib.import_module("mutate_judge").by_line
    reached = {(7, "b"), (7, ""), (7, "a"), (9, "")}
    assert by_line(reached) == {7: ["a", "b"], 9: []}
