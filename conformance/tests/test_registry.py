"""Declaring checks and finding families; every requirement is accounted for."""

from __future__ import annotations

import sys
import types
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from family_variants import vary

from axistwin_conformance.base.check import check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.family import Family
from axistwin_conformance.core.probing import Seen
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.catalog import families, find_family


def documented(session: Session) -> None:
    """It behaves."""


def undocumented(session: Session) -> None:  # noqa: D103
    pass


@pytest.mark.parametrize(
    ("ids", "declared", "function", "complaint"),
    [
        ((), {}, documented, "requirements"),
        (("A", "A"), {}, documented, "each once"),
        (("A",), {}, undocumented, "docstring"),
        (("A",), {"safety": "daring"}, documented, "'daring'.*passive"),
        (("A",), {"safety": ()}, documented, "needs a class"),
        (("A",), {"level": "slow"}, documented, "'slow'.*quick"),
        (("A",), {"needs": ("luck",)}, documented, "'luck'.*neighbour"),
    ],
)
def test_a_declaration_that_cannot_be_meant_is_refused_with_the_remedy(
    ids: tuple[str, ...],
    declared: dict[str, Any],
    function: Callable[[Session], None],
    complaint: str,
) -> None:
    """Mistakes show at import, not in the middle of a run."""
    with pytest.raises(TypeError, match=complaint):
        check(*ids, **declared)(function)


def test_a_check_keeps_name_behaviour_and_the_worst_of_its_dangers() -> None:
    """The declaration is all the engine needs."""
    one = check("A-1", safety=("stored", "motion"))(documented)
    assert (one.name, one.behaviour) == ("documented", "It behaves.")
    assert one.danger == SAFETY_CLASSES.index("stored")


def test_two_checks_of_one_name_are_refused(toy: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A name selects and replays exactly one check."""
    twice = types.ModuleType("toy_checks_again")
    monkeypatch.setitem(sys.modules, twice.__name__, twice)
    toy.add(documented, "MACS-LINE-01")
    vars(twice)["documented"] = replace(toy.module.documented, module=twice.__name__)
    family = vary(toy.family, modules=(toy.module.__name__, twice.__name__))
    with pytest.raises(TypeError, match="documented"):
        family.checks()


def test_a_check_imported_from_elsewhere_belongs_to_its_own_module_only(toy: Any) -> None:
    """Importing a check does not run it twice."""
    foreign = check("MACS-LINE-01")(documented)
    vars(toy.module)["documented"] = foreign
    assert toy.family.checks() == ()


def test_what_no_rig_works_of_a_family_is_refused_with_the_remedy(toy: Any) -> None:
    """A controller's battery is no need of an axis, neither of its checks nor of its probes."""
    toy.add(documented, "MACS-LINE-01", safety="rig", needs=("rig:battery",))
    with pytest.raises(TypeError, match=r"documented.*'battery'.*hold"):
        toy.family.checks()
    toy.probe("cmd_1c_supported", lambda session: Seen((), ""), ("rig",), ("rig:battery",))
    with pytest.raises(TypeError, match=r"cmd_1c_supported.*'battery'.*hold"):
        toy.family.probes()


def test_an_unknown_model_is_answered_with_the_nearest_name() -> None:
    """The user reads what to type instead."""
    with pytest.raises(UsageError, match=r"mac-23.*did you mean mac23\?"):
        find_family("mac-23")


FAMILIES = pytest.mark.parametrize("family", families(), ids=lambda family: family.name)


@FAMILIES
def test_every_check_names_requirements_that_exist(family: Family) -> None:
    """From the checks to the ledger."""
    known = set(load_ledger(family.name).requirements)
    for one in family.checks():
        assert set(one.requirements) <= known, one.name


@FAMILIES
def test_every_requirement_has_a_check_or_a_reason(family: Family) -> None:
    """From the ledger to the checks: covered, or not on the wire."""
    covered = {key for one in family.checks() for key in one.requirements}
    missing = [
        key
        for key, one in load_ledger(family.name).requirements.items()
        if key not in covered and not one.not_on_wire
    ]
    assert missing == []
