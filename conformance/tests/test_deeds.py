"""What `--dry-run` tells that a plan would do to the device."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine.impact import Impact, impacts
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.families.mac.axis.exchanges import COMMAND_NAMES
from axistwin_conformance.families.mac.axis.safety import SAFETY_OF


def told(*ids: str, model: str = "mac23", **given: Any) -> dict[str, Impact]:
    """The deeds of a plan, by class."""
    options = make_options(model=model, ids=ids, **given)
    return {one.safety: one for one in impacts(Engine(options).plan(), options)}


def test_every_command_of_a_class_is_named_with_its_index() -> None:
    """Who reads it knows what will be written, and what may move."""
    told_of = find_family("mac23").impact
    assert set(told_of) == {*SAFETY_CLASSES, "end"} - {"negative"}
    for index, safety in SAFETY_OF.items():
        assert f"{COMMAND_NAMES[index]} ({index:02X}h)" in told_of[safety]


def test_on_a_port_motion_and_writes_are_told_with_their_bounds() -> None:
    """As they are enforced."""
    given = told(port="/dev/ttyX", allow="motion,stored", max_travel=500, eeprom_budget=70)
    assert "500 increments" in given["motion"].within
    assert "10000 per second" in given["motion"].within
    assert "at most 70 EEPROM writes" in given["stored"].within
    assert "maximum-speed period (0Dh)" in given["stored"].what
    assert set(given) == {"passive", "motion", "stored"}


def test_what_is_not_allowed_is_not_told() -> None:
    """A passive run changes nothing, and says so."""
    assert told(port="/dev/ttyX").keys() == {"passive"}
    assert told(port="/dev/ttyX")["passive"].within == "nothing is changed"


def test_a_twin_has_no_bounds() -> None:
    """It cannot be harmed."""
    given = told()
    assert "without bounds" in given["motion"].within
    assert "any number of EEPROM writes" in given["stored"].within
    assert set(given) == set(SAFETY_CLASSES) - {"negative"}


@pytest.mark.parametrize("model", ["mac23", "mac23-can", "msc-250", "mn400"])
def test_every_class_is_told_with_its_bounds(model: str) -> None:
    """Whatever would be done, of every family; the MN400's stored program is put back."""
    given = told(model=model)
    assert all(one.what and one.within for one in given.values() if one.safety != "passive")
    if model == "mn400":
        assert given["stored"].within == "read first and put back"


def test_of_a_controller_what_the_operator_has_named_is_told() -> None:
    """There is no axis to be driven and no EEPROM to be written."""
    given = told(
        model="msc-250", port="/dev/ttyX", allow="motion,stored", variables=range(1024, 1100),
        flags=range(128, 130), bench_program=(240, 6144),
    )  # fmt: skip
    assert given["stored"].within == (
        "read first and put back; variables 1024 to 1099 (--variables), flags 128 to 129 (--flags)"
    )
    assert given["motion"].within == (
        "no axis is driven; the bench program works at flag 240, address 6144 (--bench-program)"
    )
    assert "DWRITE" in given["stored"].what


@pytest.mark.parametrize(("checks", "questions", "who"), [
    (("a",), 0, "1 check"), (("a", "b"), 1, "2 checks, 1 question"), ((), 2, "2 questions"),
])  # fmt: skip
def test_who_would_do_it_is_counted(checks: tuple[str, ...], questions: int, who: str) -> None:
    """Checks and questions before them."""
    assert Impact("motion", checks, questions, "", "").who == who


def test_a_dry_run_tells_it_to_people_and_programs() -> None:
    """Destructive checks by their names; the same as JSON."""
    words = ["mac23", "--port", "/dev/ttyX", "--allow", "motion,stored,destructive", "--dry-run"]
    words += ["--level", "quick", "MACS-CMD-01-01"]
    shown = CliRunner().invoke(conform, words)
    assert shown.exit_code == 0
    assert "EEPROM init (01h)" in shown.output
    assert "→ a_factory_reset_brings_the_factory_values" in shown.output
    seen = json.loads(CliRunner().invoke(conform, [*words, "--json"]).output)
    last = seen["deeds"][-1]
    assert last["safety"] == "destructive"
    assert last["checks"] == ["a_factory_reset_brings_the_factory_values"]


IN_VAIN = "--allow destructive changes nothing: no check of an msc-250 is of that class"


def test_a_class_of_which_there_is_no_check_is_told_beforehand() -> None:
    """To people and programs."""
    words = ["msc-250", "--port", "/dev/ttyX", "--allow", "stored,destructive", "--dry-run"]
    shown = CliRunner().invoke(conform, words)
    assert shown.exit_code == 0
    assert IN_VAIN in shown.output.splitlines()
    assert json.loads(CliRunner().invoke(conform, [*words, "--json"]).output)["note"] == IN_VAIN


def test_a_class_of_which_there_is_no_check_is_told_by_the_run() -> None:
    """It is no error."""
    words = ["msc-250", "--port", "axistwin://msc-250?time=virtual", "--allow", "destructive"]
    result = CliRunner().invoke(conform, [*words, "MSC-RQSTAT-01"])
    assert result.exit_code == 0, result.output
    assert result.output.count(IN_VAIN) == 1


@pytest.mark.parametrize("words", [
    ("msc-250",),
    ("msc-250", "--port", "/dev/ttyX", "--allow", "motion,stored,rig"),
    ("mac23", "--port", "/dev/ttyX", "--allow", "destructive"),
])  # fmt: skip
def test_what_has_checks_or_was_not_asked_for_is_not_told(words: tuple[str, ...]) -> None:
    """The built-in twin may be done anything to without a word."""
    assert "changes nothing: no" not in CliRunner().invoke(conform, [*words, "--dry-run"]).output
