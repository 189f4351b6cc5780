"""However few variables are named, and wherever they begin: what needs more is not run and says how
many, and nothing ends in an error."""

from __future__ import annotations

import re

import pytest
from msc_judging import judge
from msc_twin import TwinPort

from axistwin_conformance.base.events import Outcome
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.msc.family import FAMILY
from axistwin_conformance.families.msc.options import ScratchArea

pytestmark = pytest.mark.strength

DRAWN = "axistwin_conformance.families.msc.checks.random"
QUICK = tuple(one for one in FAMILY.checks() if one.level == "quick")
CONCERNED = tuple(one.name for one in QUICK if "variables" in one.needs or one.module == DRAWN)
ON_A_SMALL_UNIT = tuple(
    one.name
    for one in QUICK
    if "variables" in one.needs and not {"bench", "program", "alone", "virtual"} & {*one.needs}
    and not one.rig_needs
)  # fmt: skip
TOLD = re.compile(
    r"^needs \d+ .*\(--variables|may not be written \(--variables|^address 2008 is not"
)


@pytest.mark.parametrize("first", [2048, 2049, 2050, 2051])
def test_a_check_that_needs_more_variables_than_are_named_says_how_many(first: int) -> None:
    """Of 0 to 24 addresses, aligned or not, each check passes or is not run on a sound unit."""
    for count in range(25):
        scratch = ScratchArea(range(first, first + count), range(128, 136))
        for name in ON_A_SMALL_UNIT:
            for one in judge(name, TwinPort(), settings=scratch) if count else ():
                assert one.verdict in (Verdict.PASS, Verdict.NOT_RUN), (count, name, one)
                if one.verdict is Verdict.NOT_RUN:
                    assert TOLD.search(one.text), one.text


def test_a_bench_program_that_could_not_be_read_is_not_used() -> None:
    """A unit that refuses one of its addresses: the run drops the program, and no check falls."""
    scratch = ScratchArea(range(2048, 2112), range(128, 136), program=None)
    for name in (one.name for one in QUICK if "program" in one.needs):
        findings = judge(name, TwinPort(), settings=scratch)
        assert {(one.verdict, one.text) for one in findings} == {
            (Verdict.NOT_RUN, "what the bench program uses could not all be read")
        }, name


@pytest.mark.parametrize("named", [range(5, 6), range(2048, 2049), range(2051, 2057)])
def test_a_run_with_hardly_a_variable_judges_the_rest(named: range) -> None:
    """The built-in twin, everything allowed: sequences, the machine and rig checks among them."""
    options = make_options(model="msc-250", variables=named, level="quick", ids=CONCERNED)
    result = Engine(options).run(lambda event: None)
    assert {one.check.name for one in result.checks} == set(CONCERNED)
    assert [one for one in result.checks if one.outcome is not Outcome.DONE] == []
    assert (result.exit_status, result.problems) == (0, [])
    stayed = {one.requirement.id for one in result.requirements if one.verdict is Verdict.NOT_RUN}
    assert "MSC-BWRITE-02" in stayed
    asked_for = result.detections["data_address_stride"]
    assert asked_for.reading is None
    assert "needs 128 variables in a row" in asked_for.evidence
