"""On which readings a check depends is data, the data is true, and a run asks by it."""

from __future__ import annotations

from typing import Any

import pytest
from interfaces import PLAIN, cost_behind, judged_behind
from recorded_reads import MODELS, on_the_twin, recorded

from axistwin_conformance.base.armed import load_reads
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine import plan as plan_module
from axistwin_conformance.engine.plan import NOT_NEEDED, Options, Plan
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family

PASSIVE = "every_other_checksum_is_nacked"
PLAIN_MOVE = "a_move_powers_the_motor"
RAMPED_MOVE = "moves_take_the_time_of_the_closed_form"
MOST_WRITES, MOST_S, MOST_REPLAY_S = 15, 15, 10
TWO_OPERATIONS = "030002ff05000000"


def plan_of(*words: str, **given: Any) -> Plan:
    """The plan of a MAC23 on a real port."""
    asked = {"port": PLAIN.url, "allow": "motion,stored", **given}
    return Engine(make_options(model="mac23", ids=words, **asked)).plan()


def asked(plan: Plan) -> set[str]:
    """The switches that would be asked for."""
    return {probe.switch for probe in plan.probes}


def undeclared(found: dict[str, set[str]], model: str) -> dict[str, set[str]]:
    """What was looked up that the table does not tell."""
    table = load_reads(find_family(model).name)
    beyond = {name: switches - set(table.get(name, ())) for name, switches in found.items()}
    return {name: switches for name, switches in beyond.items() if switches}


# --- the data -------------------------------------------------------------------------------------


@pytest.mark.strength(seconds=120)
@pytest.mark.parametrize("model", MODELS.values())
def test_nothing_is_looked_up_that_is_not_declared(model: str) -> None:
    """On the twin and behind a port; `scripts/reads` records it anew."""
    found = {name: set(switches) for name, switches in recorded(model).items()}
    assert undeclared(found, model) == {}


def test_a_check_that_looks_up_what_it_has_not_declared_is_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Or the test above could not fail."""
    found = on_the_twin("mac23", PASSIVE)
    assert undeclared(found, "mac23") == {}
    table = dict(load_reads("mac_serial"))
    table[PASSIVE] = tuple(one for one in table[PASSIVE] if one != "nack_scope")
    monkeypatch.setitem(globals(), "load_reads", lambda name: table)
    assert undeclared(found, "mac23") == {PASSIVE: {"nack_scope"}}


@pytest.mark.parametrize("model", MODELS.values())
def test_every_name_of_the_table_is_a_check_or_a_probe(model: str) -> None:
    """And every switch one of the ledger's."""
    family = find_family(model)
    names = {check.name for check in family.checks()} | {"the_recorded_operations"}
    names |= {probe.check.name for probe in family.probes()}
    assert set(load_reads(family.name)) <= names


# --- what is asked --------------------------------------------------------------------------------


def test_one_check_asks_what_it_depends_on_and_what_that_rests_on() -> None:
    """The rest is left out, with the reason."""
    plan = plan_of(PLAIN_MOVE)
    assert asked(plan) >= {"xon_byte", "abort_flush", "step_phase"}
    assert asked(plan).isdisjoint({"ramp_law", "brake_increments", "reset_in_motion"})
    reasons = {probe.switch: reason for probe, reason in plan.unprobed}
    assert reasons["ramp_law"] == NOT_NEEDED


def test_a_whole_run_asks_everything() -> None:
    """Its report tells how the device reads the manual."""
    assert not plan_of().unneeded
    assert not plan_of(is_detection=True).unneeded


def test_a_check_of_which_nothing_is_recorded_is_asked_everything_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A family of one's own needs no table."""
    narrow = asked(plan_of(PLAIN_MOVE))
    monkeypatch.setattr(plan_module, "load_reads", lambda name: {})
    assert narrow < asked(plan_of(PLAIN_MOVE))


def undeclaring(monkeypatch: pytest.MonkeyPatch, check: str) -> None:
    """Let the table tell nothing of a check."""
    monkeypatch.setattr(plan_module, "load_reads", lambda name: {check: ()})


def on_a_twin_of(query: str, check: str) -> Engine:
    """A run of one check on a twin made with that."""
    url = f"axistwin://mac23,mac23:1?time=virtual&{query}"
    options = make_options(
        model="mac23", port=url, ids=(check,), allow="motion,stored", neighbours=(1,)
    )
    return Engine(options)


def test_what_turns_out_to_be_needed_is_asked_and_the_check_run_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The device is judged by its own readings all the same."""
    undeclaring(monkeypatch, RAMPED_MOVE)
    engine = on_a_twin_of("quirk.ramp_law=equal_increments", RAMPED_MOVE)
    assert asked(engine.plan()) == set()
    result = engine.run(lambda event: None)
    assert result.exit_status == 0, result.sentence
    assert result.readings["ramp_law"] == "equal_increments"


def test_what_was_guessed_is_asked_before_a_failure_is_believed() -> None:
    """An axis that runs on after a stop is none that fails to stop."""
    check = "a_hard_stop_stops_where_the_axis_is"
    engine = on_a_twin_of("quirk.brake_increments=100", check)
    assert "brake_increments" not in asked(engine.plan())
    result = engine.run(lambda event: None)
    assert result.exit_status == 0, result.sentence
    assert result.readings["brake_increments"] == "100"


# --- what that saves ------------------------------------------------------------------------------


@pytest.mark.strength(seconds=30)
@pytest.mark.parametrize("check", [PASSIVE, PLAIN_MOVE])
def test_one_check_costs_few_writes_and_seconds(
    check: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside what it costs where everything is asked."""
    writes, seconds, run = cost_behind(PLAIN, check)
    monkeypatch.setattr(plan_module, "load_reads", lambda name: {})
    writes_of_all, seconds_of_all, _ = cost_behind(PLAIN, check)
    print(f"{check}: {writes} writes, {seconds:.1f} s; all asked: {writes_of_all},"
          f" {seconds_of_all:.1f} s")  # fmt: skip
    assert run.result.exit_status == 0, run.result.sentence
    assert writes <= min(MOST_WRITES, writes_of_all)
    assert seconds <= min(MOST_S, seconds_of_all)


@pytest.mark.strength(seconds=30)
def test_two_operations_are_replayed_within_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same of a recording."""
    _, seconds, run = cost_behind(PLAIN, replay=TWO_OPERATIONS, level=None)
    monkeypatch.setattr(plan_module, "load_reads", lambda name: {})
    _, seconds_of_all, _ = cost_behind(PLAIN, replay=TWO_OPERATIONS, level=None)
    print(f"{seconds:.1f} s; all asked: {seconds_of_all:.1f} s")
    assert run.result.exit_status == 0, run.result.sentence
    assert seconds < MOST_REPLAY_S < seconds_of_all


# --- destructive questions ------------------------------------------------------------------------

ALL = "motion,stored,destructive"


def test_a_destructive_question_is_asked_by_its_switch() -> None:
    """Of a real device, with what it rests on, and nothing else."""
    plan = plan_of("lock_08_1b", allow=ALL)
    assert "lock_08_1b" in asked(plan)
    assert "addr_prog_requires_ff" in asked(plan)
    assert plan.to_run == ()
    assert plan.requirements == ()
    assert "factory_reset_scope" not in asked(plan)


def test_a_profile_has_the_destructive_questions_that_are_allowed() -> None:
    """--detect asks everything that --allow names."""
    assert "lock_08_1b" in asked(plan_of(is_detection=True, allow=ALL))
    assert "lock_08_1b" not in asked(plan_of(is_detection=True))
    assert "lock_08_1b" not in asked(plan_of(allow=ALL))


def test_a_destructive_question_without_the_class_says_what_to_allow() -> None:
    """The plan and the report tell it."""
    reasons = {probe.switch: reason for probe, reason in plan_of("lock_08_1b").unprobed}
    assert reasons["lock_08_1b"] == "not allowed: destructive (--allow destructive)"


def only_detects(**given: Any) -> bool:
    """Whether such a command judges nothing."""
    options: Options = make_options(model="mac23", **given)
    return options.is_only_detection


def test_words_that_are_all_switches_judge_nothing() -> None:
    """One that is a check or a requirement is judged."""
    assert only_detects(ids=("lock_08_1b", "xon_byte"))
    assert not only_detects(ids=("lock_08_1b", PASSIVE))
    assert not only_detects()


@pytest.mark.strength(seconds=20)
def test_a_real_device_tells_a_destructive_reading() -> None:
    """And is put back; the sentence says what was found."""
    run = judged_behind(PLAIN, "lock_08_1b", level=None, allow=ALL)
    assert run.result.exit_status == 0, run.result.sentence
    assert run.result.readings["lock_08_1b"]
    assert "answered, none differs from the default; " in run.result.sentence
