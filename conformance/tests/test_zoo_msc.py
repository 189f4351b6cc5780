"""Every planted firmware fault of the MSC controllers is found by the check that has to find it."""

from __future__ import annotations

from typing import Any

import pytest
from small_scratch import small_scratch
from zoo import armed_by
from zoo.judge import checks_of, judge_armed, judge_names, kills, wrong
from zoo.mutant import Mutant
from zoo_msc import ZOO

from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.ledger import load_ledger

pytestmark = pytest.mark.strength

LEDGER = load_ledger("msc")
# Traps of the ledger's §7 that no controller can fall into: 5 gives the same result on every legal
# packet; 12, 14, 32, 36 and 38 are the host's; 24, 26 and 34 the suite's own; 39 is what a faithful
# unit does.
NOT_THE_TWINS = {5, 12, 14, 24, 26, 32, 34, 36, 38, 39}
MODELS = sorted({mutant.model for mutant in ZOO})


@pytest.mark.parametrize("mutant", ZOO, ids=lambda mutant: mutant.name)
def test_every_mutant_is_killed_by_what_it_claims_to_break(mutant: Mutant) -> None:
    """Each claimed requirement fails, by the judgement of a check that names it."""
    killers = kills(mutant)
    assert set(mutant.claims) == set(killers), f"{mutant.description} Seen by: {dict(killers)}"


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("scratch", [{}, small_scratch("msc-250")], ids=["all", "few"])
def test_the_healthy_twin_passes_all_that_kills(model: str, scratch: dict[str, Any]) -> None:
    """The same checks find nothing wrong with a sound twin, whatever they may write of it."""
    claims = {claim for mutant in ZOO if mutant.model == model for claim in mutant.claims}
    names = {check.name for claim in claims for check in checks_of(claim, model)}
    assert wrong(names, model, **scratch) == []


def test_mutants_have_names_of_their_own_and_claim_what_the_ledger_asks() -> None:
    """A mutant is told by its name; a claim is a requirement that some check names."""
    judge_names(ZOO, LEDGER)
    assert all(mutant.claims for mutant in ZOO)


def test_mutants_are_of_all_families_of_the_ledger() -> None:
    """Line, packets, link, commands, status, models, data, flags and properties have some."""
    families = {claim.split("-")[1] for mutant in ZOO for claim in mutant.claims}
    assert families == {one.id.split("-")[1] for one in LEDGER.requirements.values()}


def test_every_trap_of_the_twins_has_its_mutant() -> None:
    """Who falls into a trap of the ledger is found out."""
    assert {trap for mutant in ZOO for trap in mutant.traps} == set(range(1, 41)) - NOT_THE_TWINS


def test_what_is_shipped_as_armed_is_what_the_zoo_kills() -> None:
    """armed.toml names the claims of these mutants and no others; scripts/zoo writes it anew."""
    assert load_armed("msc") == armed_by(ZOO), "stale: run scripts/zoo msc"


def test_nine_in_ten_requirements_of_the_manual_are_armed() -> None:
    """Of what is stated or follows, and can be seen on the wire, little stays unproven."""
    judge_armed(armed_by(ZOO), LEDGER)
