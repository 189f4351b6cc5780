"""Faults of the checker itself: how they are declared, and what each of them has to bring about."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import pytest
from zoo.judge import failed, run

Patch = pytest.MonkeyPatch


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of the checker, and the check and requirement that must go wrong with it; one of the
    requirements, where what is drawn decides which."""

    plant: Callable[[Patch], None]
    check: str
    requirements: tuple[str, ...]


def fault(check: str, *requirements: str) -> Callable[[Callable[[Patch], None]], Fault]:
    """Declare the function below as a fault of the checker."""
    return lambda plant: Fault(plant, check, requirements)


def faults_in(names: Mapping[str, Any]) -> dict[str, Fault]:
    """Those that a module has declared, by name."""
    return {name: one for name, one in names.items() if isinstance(one, Fault)}


def judge_red(one: Fault, model: str, modules: Iterable[ModuleType]) -> None:
    """A healthy twin of that model is sound until the fault is planted, and then is not; nothing
    that was computed by a wrong checker stays in the caches of these modules."""
    computing = tuple(modules)
    claimed = set(one.requirements)
    assert not claimed & set(failed(run(one.check, model))), "red before anything was planted"
    try:
        with Patch.context() as patch:
            one.plant(patch)
            _forget(computing)
            result = run(one.check, model)
    finally:
        _forget(computing)
    told = [(f.requirement, f.verdict, f.text) for ran in result.checks for f in ran.findings]
    assert claimed & set(failed(result)), (result.refusal, told)


def _forget(modules: Iterable[ModuleType]) -> None:
    """Empty their caches: what they hold was computed by another checker."""
    for module in modules:
        for value in list(vars(module).values()):
            if callable(clear := getattr(value, "cache_clear", None)):
                clear()
