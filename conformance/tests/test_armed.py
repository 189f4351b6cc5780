"""Which requirements are armed: data of the run over the mutants."""

from __future__ import annotations

import pytest

from axistwin_conformance.base.armed import load_armed, parse_table
from axistwin_conformance.base.ledger import load_ledger


def test_the_table_gives_the_mutants_of_each_requirement() -> None:
    """An empty list is a requirement that nothing has armed."""
    text = '[armed]\nMACS-LINE-01 = ["slow_line", "deaf"]\nMACS-LINE-02 = []\n'
    assert parse_table(text, "armed") == {"MACS-LINE-01": ("slow_line", "deaf"), "MACS-LINE-02": ()}


@pytest.mark.parametrize(
    "text", ["", "armed = 3", "[armed]\nMACS-LINE-01 = 'deaf'", "[armed]\nMACS-LINE-01 = [3]"]
)
def test_a_file_that_holds_something_else_is_refused(text: str) -> None:
    """It is made by us: a mistake in it is ours."""
    with pytest.raises(ValueError, match=r"armed\.toml"):
        parse_table(text, "armed")


def test_a_family_without_the_file_is_unknown() -> None:
    """Nobody has looked: that is not the same as not armed."""
    assert load_armed("mac_axis") is None


@pytest.mark.parametrize("family", ["mac_serial", "mac_can"])
def test_what_is_armed_is_in_the_ledger(family: str) -> None:
    """A requirement that is none would arm nothing."""
    armed = load_armed(family)
    assert armed, "shipped beside the checks"
    assert set(armed) <= set(load_ledger(family).requirements)
