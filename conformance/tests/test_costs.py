"""What one check costs on a paced MAC, and which may cost more, with the reason: `costs.toml`."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

import pytest
from interfaces import PLAIN, cost_behind, judged_behind

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import CheckStarted, Event
from axistwin_conformance.base.write_budget import WriteBudget
from axistwin_conformance.families.catalog import find_family

MODELS = {"mac23": 1, "mac23-can": 2}  # and the address of a neighbour, for checks that need one
CLASSES = {"passive", "motion", "stored"}
MOST_WRITES, MOST_S = 15, 15
TABLE = Path(__file__).with_name("costs.toml")
KINDS = ("writes", "seconds")


def more_costly(model: str) -> dict[str, dict[str, int]]:
    """By kind: the checks that may cost more, and how much."""
    rows = tomllib.loads(TABLE.read_text(encoding="utf-8"))[find_family(model).name]
    assert all(row["why"] for row in rows)
    found: dict[str, dict[str, int]] = {kind: {} for kind in KINDS}
    for row in rows:
        for kind in KINDS:
            assert not found[kind].keys() & row.get(kind, {}).keys(), "named twice"
            found[kind] |= row.get(kind, {})
    return found


def limited(model: str) -> list[Check]:
    """The checks that are passive or move, and can be run on a real device."""
    return [
        check
        for check in find_family(model).checks()
        if set(check.safety) <= CLASSES
        and check.safety != ("stored",)
        and "virtual" not in check.needs
    ]


def cost(model: str, check: Check) -> Mapping[str, float]:
    """What it costs alone, by kind; the device is put back."""
    needs_other = "neighbour" in check.needs
    others = {"neighbours": (MODELS[model],)} if needs_other else {}
    writes, seconds, run = cost_behind(PLAIN, check.name, model=model, **others)
    assert run.way.is_put_back, check.name
    return {"writes": writes, "seconds": seconds}


def excess(costs: Mapping[str, float], name: str, table: Mapping[str, Mapping[str, int]]) -> str:
    """In what a check goes beyond what it may cost, or no longer needs to; empty if in nothing."""
    told = []
    for kind, usual in zip(KINDS, (MOST_WRITES, MOST_S), strict=True):
        most = table[kind].get(name, usual)
        if costs[kind] > most:
            told.append(f"{costs[kind]:.1f} {kind}, not {most}")
        elif name in table[kind] and costs[kind] <= usual:
            told.append(f"{costs[kind]:.1f} {kind}: nothing to excuse")
    return "; ".join(told)


@pytest.mark.strength(seconds=90)
@pytest.mark.parametrize("model", MODELS)
def test_a_check_alone_costs_at_most_15_writes_and_15_seconds(model: str) -> None:
    """Questions, the check itself and putting back; what may cost more is named in the table."""
    table, beyond = more_costly(model), {}
    for check in limited(model):
        if told := excess(cost(model, check), check.name, table):
            beyond[check.name] = told
    assert beyond == {}


@pytest.mark.parametrize("model", MODELS)
def test_only_checks_that_are_limited_are_excused(model: str) -> None:
    """Or the table tells of nothing."""
    table = more_costly(model)
    names = {check.name for check in limited(model)}
    assert set().union(*table.values()) <= names


def test_what_costs_more_is_found() -> None:
    """Or the test above could not fail."""
    table = {"writes": {"excused": 20}, "seconds": {}}
    assert excess({"writes": 16, "seconds": 1.0}, "another", table) == "16.0 writes, not 15"
    assert excess({"writes": 1, "seconds": 15.5}, "another", table) == "15.5 seconds, not 15"
    assert excess({"writes": 21, "seconds": 1.0}, "excused", table) == "21.0 writes, not 20"
    assert excess({"writes": 20, "seconds": 1.0}, "excused", table) == ""
    assert "nothing to excuse" in excess({"writes": 3, "seconds": 1.0}, "excused", table)


# --- where nothing is written twice, nor counted without need -------------------------------------


def test_what_a_device_refuses_has_worn_nothing() -> None:
    """One write for one device; of several in one, others may have been obeyed."""
    budget = WriteBudget()
    budget.note(1)
    budget.replied(is_refusal=True)
    assert budget.spent == 0
    budget.replied(is_refusal=True)  # of something else that stores nothing
    assert budget.spent == 0
    budget.note(1)
    budget.replied(is_refusal=False)
    budget.note(2)
    budget.replied(is_refusal=True)
    assert budget.spent == 3


@pytest.mark.parametrize("model", MODELS)
def test_a_refused_write_is_not_counted(model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On its way out it may be one too many; refused, it gives its place back."""
    asked: list[int] = []
    note = WriteBudget.note

    def noting(budget: WriteBudget, writes: int) -> None:
        asked.append(writes)
        note(budget, writes)

    monkeypatch.setattr(WriteBudget, "note", noting)
    writes, _, run = cost_behind(PLAIN, "the_period_is_locked_in_motion", model=model)
    assert run.result.exit_status == 0, run.result.sentence
    assert sum(asked) == writes + 3  # 0Dh in a move, a turn and a segment


def test_what_a_check_sets_itself_is_not_put_back_before_it() -> None:
    """Three settings once for the questions, two for the check, three at the end."""
    writes, _, run = cost_behind(PLAIN, "a_move_powers_the_motor")
    assert run.result.exit_status == 0, run.result.sentence
    assert writes < 10


def test_a_run_that_ends_before_its_check_puts_back_what_the_questions_have_set() -> None:
    """What stays for the check stays no longer."""

    def hear(event: Event) -> None:
        if isinstance(event, CheckStarted):
            raise KeyboardInterrupt

    run = judged_behind(
        PLAIN, "a_move_powers_the_motor", allow="motion,stored", level="full", hear=hear
    )
    assert run.result.exit_status == 130
    assert run.way.is_put_back
