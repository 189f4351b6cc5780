"""Every planted firmware fault is found by the check that has to find it."""

from __future__ import annotations

import pytest
from zoo import ZOO, armed_by
from zoo.judge import checks_of, judge_armed, judge_names, kills, wrong
from zoo.mutant import Mutant

from axistwin_conformance.base.armed import load_armed
from axistwin_conformance.base.ledger import load_ledger

pytestmark = pytest.mark.strength

LEDGER = load_ledger("mac_serial")
# Traps of the ledger's §8 that no twin can fall into: 5 (the host's tty) and 42 (the suite itself)
# are the other side's; 3, 7 and 23 have parts that are readings of the manual.
NOT_THE_TWINS = {5, 42}


@pytest.mark.parametrize("mutant", ZOO, ids=lambda mutant: mutant.name)
def test_every_mutant_is_killed_by_what_it_claims_to_break(mutant: Mutant) -> None:
    """Each claimed requirement fails, by the judgement of a check that names it."""
    killers = kills(mutant)
    assert set(mutant.claims) == set(killers), f"{mutant.description} Seen by: {dict(killers)}"


def test_the_healthy_twin_passes_all_that_kills() -> None:
    """The same checks find nothing wrong with a twin that nobody has tampered with."""
    claims = {claim for mutant in ZOO for claim in mutant.claims}
    names = {check.name for claim in claims for check in checks_of(claim)}
    assert wrong(names, "mac23") == []


def test_mutants_have_names_of_their_own_and_claim_what_the_ledger_asks() -> None:
    """A mutant is told by its name; a claim is a requirement that some check names."""
    judge_names(ZOO, LEDGER)


def test_every_trap_of_the_twins_has_its_mutant() -> None:
    """Who falls into a trap of the ledger is found out."""
    assert {trap for mutant in ZOO for trap in mutant.traps} == set(range(1, 43)) - NOT_THE_TWINS


def test_what_is_shipped_as_armed_is_what_the_zoo_kills() -> None:
    """armed.toml names the claims of these mutants and no others; scripts/zoo writes it anew."""
    assert load_armed("mac_serial") == armed_by(ZOO), "stale: run scripts/zoo"


def test_nine_in_ten_requirements_of_the_manual_are_armed() -> None:
    """Of what is stated or follows, and can be seen on the wire, little stays unproven."""
    judge_armed(armed_by(ZOO), LEDGER)
