"""The stateful machine against the exact model: chains that random operations seldom build.

In virtual time only: what a rule may do depends on the state, and on a real line the state depends
on the clock, so that Hypothesis could not draw the same run twice.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.checks.sequences import JUDGED, runner_of
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.axis.sequences.machine import AxisMachine
from axistwin_conformance.families.mac.axis.sequences.machine_devices import JudgedAxis
from axistwin_conformance.families.mac.axis.sequences.machine_sync import SyncMachine
from axistwin_conformance.sequences.generated import run_machine

ORDER = 210  # of this module in a run; see `Family.modules`

STEPS: Final = 100
EXAMPLES: Final = {"quick": 4, "full": 30}


@check(*JUDGED, safety=MOVES, needs=("virtual",))
def some_runs_of_the_machine_agree_with_the_model(session: Session) -> None:
    """Every reply in a few runs of the stateful machine is one that the model admits."""
    _run(session, "quick")


@check(*JUDGED, safety=MOVES, needs=("virtual",), level="full", soaks=True)
def many_runs_of_the_machine_agree_with_the_model(session: Session) -> None:
    """Every reply in many runs of the stateful machine is one that the model admits."""
    _run(session, "full")


def _run(session: Session, level: str) -> None:
    runner = runner_of(session)
    rules = SyncMachine if runner.driver.client.face.has_sync else AxisMachine
    run_machine(runner, JudgedAxis, rules, EXAMPLES[level], STEPS)
