"""The built-in controllers under the checks of the link: three on a line, and unit 6."""

from __future__ import annotations

import itertools
import time

import pytest
from msc_judging import link_checks

from axistwin_conformance.base.events import CheckFinished
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine

pytestmark = pytest.mark.strength

SHARED = [name for name, one in link_checks().items() if "neighbour" in one.needs]
WRITTEN = [name for name in link_checks() if name.startswith("the_written_exchanges")]


def run(address: int, neighbours: tuple[int, ...], names: list[str], seed: int = 0) -> Result:
    """Judge twins with these numbers on one line."""
    options = make_options(
        model="msc-250", address=address, neighbours=neighbours, ids=tuple(names), seed=seed
    )
    return Engine(options).run(lambda event: None)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_three_units_on_one_line_behave_as_if_alone(seed: int) -> None:
    """Interleaved exchanges, broken packets for one of them included."""
    result = run(1, (2, 3), SHARED, seed)
    assert {one.check.name for one in result.checks} == set(SHARED)
    assert not [one for one in result.checks if one.verdict is not Verdict.PASS]
    assert result.exit_status == 0


def test_the_written_exchanges_hold_for_unit_6() -> None:
    """Byte for byte, the one that the ledger writes for unit 6 among them."""
    result = run(6, (1,), WRITTEN)
    assert {one.check.name for one in result.checks} == set(WRITTEN)
    assert not [one for one in result.checks if one.verdict is not Verdict.PASS]


def test_the_checks_of_the_link_take_seconds_of_virtual_time_and_little_of_the_processor() -> None:
    """None of them takes long of the processor's time, however busy the machine is."""
    ends_s = [time.process_time()]
    options = make_options(model="msc-250", ids=tuple(link_checks()))
    Engine(options).run(
        lambda event: (
            ends_s.append(time.process_time()) if isinstance(event, CheckFinished) else None
        )
    )
    assert len(ends_s) == 1 + len(link_checks())
    # Of the first, with what is asked before it, too.
    assert max(end_s - start_s for start_s, end_s in itertools.pairwise(ends_s)) < 20
