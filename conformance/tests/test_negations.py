"""The tables of negations: which wrong firmwares break each requirement, and what stands for them.

`negations/<family>.toml` is written from the ledger, not from the planted faults: what it has and
the zoo has not is a hole.  An entry is

    [[negation]]
    requirement = "MSC-PKT-12"
    kind = "wrong content"                      # one of KINDS
    firmware = "The sum of a reply leaves the unit out."
    shows = "any reply of a unit other than 0: its sum is wrong"
    faults = ["a_sum_without_the_unit"]         # of the family's zoo, each of which claims this
    reason = "..."                              # or, or beside it: why there is no (other) fault

`faults`, `reason` or both.  A requirement that one fault alone arms has a reason in some entry.
What a ledger `covers` of another one's need not be written twice: those entries count here too,
with the faults that this family's zoo shares.
"""

from __future__ import annotations

import importlib
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest
from zoo import armed_by
from zoo.mutant import Mutant

from axistwin_conformance.base.ledger import Ledger, RequirementKind, load_ledger

TABLES = Path(__file__).parent / "negations"
KINDS = frozenset(
    {
        "off by one",
        "wrong width",
        "wrong sign",
        "wrong moment",
        "wrong state",
        "forgotten effect",
        "surplus effect",
        "lasts too long",
        "lasts too short",
        "wrong order",
        "wrong content",
    }
)
ZOOS = {"mac_serial": "zoo", "mac_can": "zoo_can", "msc": "zoo_msc", "mn400": "zoo_mn400"}
# Family whose requirements another's ledger covers → that family.
COVERED = {"mac_can": "mac_serial"}
FAMILIES = sorted(ZOOS)


@dataclass(frozen=True, slots=True)
class Negation:
    """One wrong firmware; the fields are those of the table."""

    requirement: str
    kind: str
    firmware: str
    shows: str
    faults: tuple[str, ...] = ()
    reason: str = ""


def parse(text: str) -> tuple[Negation, ...]:
    """The entries of a table, each with its form checked."""
    found = []
    for row in tomllib.loads(text)["negation"]:
        one = Negation(**{**row, "faults": tuple(row.get("faults", ()))})
        assert one.kind in KINDS, one
        assert one.firmware.endswith("."), one
        assert one.shows, one
        assert one.faults or one.reason, one
        found.append(one)
    return tuple(found)


@cache
def own_table(family: str) -> tuple[Negation, ...]:
    """What the family's own file holds."""
    return parse((TABLES / f"{family}.toml").read_text(encoding="utf-8"))


def zoo_of(family: str) -> tuple[Mutant, ...]:
    """The planted faults of a family."""
    zoo: tuple[Mutant, ...] = importlib.import_module(ZOOS[family]).ZOO
    return zoo


def table_of(family: str) -> tuple[Negation, ...]:
    """The family's own entries, and those of the ledger that its own one covers from."""
    own = own_table(family)
    if family not in COVERED:
        return own
    ledger, armed = load_ledger(family), armed_by(zoo_of(family))
    shared = []
    for one in own_table(COVERED[family]):
        for here in ledger.own([one.requirement]):
            faults = tuple(name for name in one.faults if name in armed.get(here, ()))
            if faults or one.reason:
                shared.append(replace(one, requirement=here, faults=faults))
    return (*own, *shared)


def thin(
    table: Sequence[Negation], armed: Mapping[str, Sequence[str]], ledger: Ledger
) -> dict[str, str]:
    """Requirements of the manual that the table does not cover, each with what it lacks."""
    lacking: dict[str, str] = {}
    for one in ledger.requirements.values():
        if one.kind is RequirementKind.INTERPRETATION:
            continue
        entries = [entry for entry in table if entry.requirement == one.id]
        has_reason = bool(one.not_on_wire) or any(entry.reason for entry in entries)
        if not entries:
            lacking[one.id] = "no entry"
        elif len({entry.kind for entry in entries}) < 2 and not has_reason:
            lacking[one.id] = "one kind of negation only, and no reason"
        elif len(armed.get(one.id, ())) < 2 and not has_reason:
            lacking[one.id] = "fewer than two faults, and no reason"
    return lacking


@pytest.mark.strength
@pytest.mark.parametrize("family", FAMILIES)
def test_every_requirement_of_the_manual_has_its_negations(family: str) -> None:
    """Two kinds of wrong firmware and two planted faults, or the reason why not."""
    assert thin(table_of(family), armed_by(zoo_of(family)), load_ledger(family)) == {}


@pytest.mark.parametrize("family", FAMILIES)
def test_every_fault_that_is_named_is_planted_and_claims_the_requirement(family: str) -> None:
    """A table that names what is not there tells nothing."""
    armed = armed_by(zoo_of(family))
    stale = [
        (one.requirement, name)
        for one in own_table(family)
        for name in one.faults
        if name not in armed.get(one.requirement, ())
    ]
    assert stale == []


@pytest.mark.parametrize("family", FAMILIES)
def test_every_planted_fault_is_a_negation_of_something(family: str) -> None:
    """What somebody thought of and planted is in the table."""
    named = {name for one in table_of(family) for name in one.faults}
    assert sorted({mutant.name for mutant in zoo_of(family) if mutant.claims} - named) == []


@pytest.mark.parametrize("family", FAMILIES)
def test_every_entry_is_of_the_ledger_and_stands_once(family: str) -> None:
    """A requirement that is none would be covered for nobody."""
    table = own_table(family)
    known = load_ledger(family).requirements
    assert [one for one in table if one.requirement not in known] == []
    assert len({(one.requirement, one.firmware) for one in table}) == len(table)


def test_what_the_table_lacks_is_told() -> None:
    """No entry, one kind only, one fault only: each is seen, and a reason excuses the last two."""
    ledger = load_ledger("mac_serial")
    name = "MACS-LINE-01"
    armed = {name: ("autobaud", "deaf")}
    one = Negation(name, "wrong content", "It listens at every rate.", "any", ("autobaud",))
    other = replace(one, kind="wrong moment", faults=("deaf",))
    assert thin([], armed, ledger)[name] == "no entry"
    assert "one kind" in thin([one], armed, ledger)[name]
    assert "two faults" in thin([one, other], {name: ("autobaud",)}, ledger)[name]
    assert name not in thin([one, other], armed, ledger)
    assert name not in thin([replace(one, reason="no other can be")], {}, ledger)


def test_an_entry_that_is_spelt_wrong_is_refused() -> None:
    """A kind out of the list, and faults or a reason."""
    head = '[[negation]]\nrequirement = "X"\nfirmware = "F."\nshows = "S"\n'
    assert parse(f'{head}kind = "off by one"\nreason = "R"\n')[0].reason == "R"
    for rest in ('kind = "off by two"\nreason = "R"', 'kind = "off by one"'):
        with pytest.raises(AssertionError):
            parse(f"{head}{rest}\n")
