"""Every planted firmware fault of the MN400 is found by the check that has to find it."""

from __future__ import annotations

import pytest
from zoo import armed_by
from zoo.judge import checks_of, judge_names, kills, wrong
from zoo.mutant import Mutant
from zoo_mn400 import ZOO

from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.ledger import load_ledger

pytestmark = pytest.mark.strength

LEDGER = load_ledger("mn400")
NOT_ON_THE_LINE = {"USB"}
# Traps of the ledger's section 8 that no fault of this zoo is: 16, 20 and 24 are readings, which
# are named, not failed; 34 and 35 are of USB (test_mn400_usb.py).
NOT_IN_THIS_ZOO = {16, 20, 24, 34, 35}


@pytest.mark.parametrize("mutant", ZOO, ids=lambda mutant: mutant.name)
def test_every_mutant_is_killed_by_what_it_claims_to_break(mutant: Mutant) -> None:
    """Each claimed requirement fails, by the judgement of a check that names it."""
    killers = kills(mutant)
    assert set(mutant.claims) == set(killers), f"{mutant.description} Seen by: {dict(killers)}"


@pytest.mark.strength(seconds=60)
def test_the_healthy_twin_passes_all_that_kills() -> None:
    """The same checks find nothing wrong with a sound twin."""
    claims = {claim for mutant in ZOO for claim in mutant.claims}
    names = {check.name for claim in claims for check in checks_of(claim, "mn400")}
    assert wrong(names, "mn400") == []


def test_mutants_have_names_of_their_own_and_claim_what_the_ledger_asks() -> None:
    """A mutant is told by its name; a claim is a requirement that some check names."""
    judge_names(ZOO, LEDGER)
    assert all(mutant.claims for mutant in ZOO)


def test_mutants_are_of_all_groups_of_the_serial_line() -> None:
    """Only what is said of USB has none: the zoo is judged on a line."""
    groups = {claim.split("-")[1] for mutant in ZOO for claim in mutant.claims}
    assert (
        groups >= {one.id.split("-")[1] for one in LEDGER.requirements.values()} - NOT_ON_THE_LINE
    )


def test_every_trap_of_the_boards_has_its_mutant() -> None:
    """Who falls into a trap of the ledger is found out."""
    assert {trap for mutant in ZOO for trap in mutant.traps} == set(range(1, 47)) - NOT_IN_THIS_ZOO


def test_what_is_shipped_as_armed_is_what_the_zoo_kills() -> None:
    """armed.toml names the claims of these mutants and no others; scripts/zoo writes it anew."""
    assert load_armed("mn400") == armed_by(ZOO), "stale: run scripts/zoo mn400"
