"""The requirement ledger as data."""

from __future__ import annotations

import re

import pytest

from axistwin_conformance.ledger import Kind, load_ledger, parse_ledger
from axistwin_conformance.registry import families

LEDGERS = sorted({family.ledger for family in families()})
ENTRY = """
[requirement.A-1]
kind = "must"
safety = "passive"
source = "S II"
text = "It answers."
quirks = ["AMB-1"]
[ambiguity.AMB-1]
question = "how"
detect = "look"
switches.manner = ["kindly", "rudely"]
"""


@pytest.mark.parametrize("name", LEDGERS)
def test_a_shipped_ledger_says_all_it_must_of_every_requirement(name: str) -> None:
    """Each requirement has text and source, and is either observable or says why not."""
    for one in load_ledger(name).requirements.values():
        assert one.text.endswith("."), one.id
        assert one.source, one.id
        assert one.safety, one.id
        assert one.observable or one.not_on_wire, one.id


@pytest.mark.parametrize("name", LEDGERS)
def test_an_ambiguity_named_in_a_reason_exists(name: str) -> None:
    """Prose that points at an ambiguity points at one the ledger has."""
    ledger = load_ledger(name)
    for one in ledger.requirements.values():
        assert set(re.findall(r"MAC\w-AMB-\d\d", one.not_on_wire)) <= set(ledger.ambiguities)


def test_the_mac_serial_ledger_is_complete_in_number() -> None:
    """136 requirements, 70 ambiguities and 4 more: a lost entry is noticed."""
    ledger = load_ledger("mac_serial")
    assert len(ledger.requirements) == 136
    assert len(ledger.ambiguities) == 74


def test_entries_are_read() -> None:
    """Kind, safety and switches arrive as values."""
    ledger = parse_ledger("toy", ENTRY)
    assert ledger.requirements["A-1"].kind is Kind.MUST
    assert ledger.requirements["A-1"].safety == {"passive"}
    assert ledger.ambiguity_of("manner").default_of("manner") == "kindly"


@pytest.mark.parametrize(
    ("good", "bad", "complaint"),
    [
        ('kind = "must"', 'kind = "maybe"', "A-1"),
        ('safety = "passive"', 'safety = "daring"', "daring"),
        ('source = "S II"', "", "source"),
        ('quirks = ["AMB-1"]', 'quirks = ["AMB-2"]', "AMB-2"),
        ('["kindly", "rudely"]', "[]", "AMB-1"),
        ('detect = "look"', 'detect = "look"\ndeparts = ["A-9"]', "A-9"),
        ('detect = "look"', "", "detect"),
    ],
)
def test_an_entry_that_contradicts_itself_is_refused(good: str, bad: str, complaint: str) -> None:
    """The message names the entry or the word that is wrong."""
    with pytest.raises(ValueError, match=complaint):
        parse_ledger("toy", ENTRY.replace(good, bad))


def test_an_unknown_switch_or_reading_is_our_mistake() -> None:
    """Checks cannot invent readings."""
    ledger = parse_ledger("toy", ENTRY)
    with pytest.raises(ValueError, match="mood"):
        ledger.ambiguity_of("mood")
    with pytest.raises(ValueError, match="loudly"):
        ledger.ambiguity_of("manner").check_reading("manner", "loudly")


def test_a_star_admits_any_reading() -> None:
    """A measured value need not be listed."""
    ledger = parse_ledger("toy", ENTRY.replace('"rudely"', '"*"'))
    ledger.ambiguity_of("manner").check_reading("manner", "1.5 s")
