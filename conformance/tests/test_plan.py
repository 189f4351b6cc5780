"""What will run, in which order, and why the rest will not."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.core.session import Session
from axistwin_conformance.engine.plan import Plan, make_plan


def passive(session: Session) -> None:
    """It is looked at."""


def moving(session: Session) -> None:
    """It moves."""


def storing(session: Session) -> None:
    """It stores."""


def destroying(session: Session) -> None:
    """It forgets its address."""


@pytest.fixture
def bench(toy: Any) -> Any:
    """Four checks, declared with the worst first."""
    toy.add(destroying, "MACS-CMD-08-01", safety="destructive", needs=("alone",))
    toy.add(storing, "MACS-CMD-0D-01", safety=("stored", "motion"), level="full")
    toy.add(moving, "MACS-CMD-13-01", "MACS-CMD-13-05", safety="motion", needs=("neighbour",))
    toy.add(passive, "MACS-LINE-01")
    return toy


def plan_of(bench: Any, **changes: Any) -> Plan:
    """The plan under changed options."""
    options = bench.options(**changes)
    return make_plan(options, load_ledger("mac_serial"), bench.family.checks())


def names(plan: Plan) -> list[str]:
    """The checks that will run."""
    return [one.name for one in plan.to_run]


def reasons(plan: Plan) -> dict[str, str]:
    """Why the others will not."""
    return {one.name: reason for one, reason in plan.left_out}


def test_the_order_is_from_harmless_to_destructive(bench: Any) -> None:
    """Whatever the order of declaration."""
    assert names(plan_of(bench)) == ["passive", "moving", "storing", "destroying"]


def test_what_is_not_allowed_is_left_out_and_says_what_to_grant(bench: Any) -> None:
    """All classes of a check must be granted."""
    plan = plan_of(bench, allowed=frozenset({"passive", "motion"}))
    assert names(plan) == ["passive", "moving"]
    assert "--allow stored" in reasons(plan)["storing"]
    assert "--allow destructive" in reasons(plan)["destroying"]
    nothing = reasons(plan_of(bench, allowed=frozenset({"passive"})))
    # In one order, however a check names its classes.
    assert nothing["storing"] == "not allowed: motion, stored (--allow motion,stored)"


def test_a_quick_run_leaves_out_what_belongs_to_full(bench: Any) -> None:
    """And says so."""
    plan = plan_of(bench, level="quick")
    assert reasons(plan) == {"storing": "only at --level full"}


def test_a_missing_neighbour_is_named(bench: Any) -> None:
    """A check for two modules waits for --neighbour."""
    plan = plan_of(bench, endpoint="/dev/null", neighbours=())
    assert "--neighbour" in reasons(plan)["moving"]
    assert "alone" not in reasons(plan)["destroying"]


def test_a_check_that_must_be_alone_does_not_run_beside_a_neighbour(bench: Any) -> None:
    """On a real line; the built-in twin gets a line of its own."""
    assert "destroying" in reasons(plan_of(bench, endpoint="/dev/null"))
    assert "destroying" in names(plan_of(bench))


@pytest.mark.parametrize(
    ("word", "requirements", "checks"),
    [
        ("MACS-CMD-13", 6, ["moving"]),
        ("macs-line-01", 1, ["passive"]),
        ("MACS-CMD-13-01", 1, ["moving"]),
        ("moving", 2, ["moving"]),
    ],
)
def test_ids_prefixes_and_names_select(
    bench: Any, word: str, requirements: int, checks: list[str]
) -> None:
    """A check's name asks about all it judges."""
    plan = plan_of(bench, words=(word,))
    assert len(plan.requirements) == requirements
    assert names(plan) == checks


def test_a_word_that_selects_nothing_is_an_error_with_the_nearest(bench: Any) -> None:
    """A typing error must not end as a run of nothing."""
    with pytest.raises(UsageError, match="did you mean MACS-FRAME-01"):
        plan_of(bench, words=("MACS-LINE-01", "MACS-FRMAE-01"))


def test_the_replay_command_repeats_port_bounds_and_seed(bench: Any) -> None:
    """One command, ready to paste."""
    check = bench.family.checks()[2]
    assert bench.options().replay(check) == "axistwin conform toy --seed 5 moving"
    replay = bench.options(endpoint="/dev/tty S", address=3).replay(check)
    assert replay.startswith("axistwin conform toy --port '/dev/tty S' --baud 9600 --allow ")
    for part in ("--max-travel 1000", "--max-speed 1000", "--neighbour 1", "--address 3"):
        assert part in replay


@pytest.mark.parametrize(
    ("port", "is_met"),
    [("axistwin://mac23?time=virtual", True), ("axistwin://mac23?time=real", False), ("x", False)],
)
def test_virtual_time_is_a_matter_of_the_url(bench: Any, port: str, is_met: bool) -> None:
    """A twin named by URL counts as one too."""
    assert ("virtual" in bench.options(endpoint=port).provided) is is_met


def test_on_a_port_destructive_checks_run_only_if_named(bench: Any) -> None:
    """Allowing the class is not enough, nor is a prefix: the check's name, or a whole ID."""
    given = {"endpoint": "/dev/null", "neighbours": ()}
    for words in ((), ("MACS-CMD",)):
        assert "only if named" in reasons(plan_of(bench, words=words, **given))["destroying"]
    for words in (("destroying",), ("MACS-CMD-08-01",)):
        assert names(plan_of(bench, words=words, **given)) == ["destroying"]
