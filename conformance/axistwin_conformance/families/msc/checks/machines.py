"""The stateful machine against the model: chains that random operations seldom build.

In virtual time only: what a rule may do depends on the state, and on a real line the state depends
on the clock, so that Hypothesis could not draw the same run twice.
"""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import check
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.checks.sequences import NEEDS
from axistwin_conformance.families.msc.sequences.machine import ModelledUnit, UnitMachine
from axistwin_conformance.families.msc.sequences.runner import runner_of
from axistwin_conformance.families.msc.sequences.sequence import JUDGED
from axistwin_conformance.sequences.generated import run_machine

ORDER = 130  # of this module in a run; see `Family.modules`

STEPS: Final = 60
EXAMPLES: Final = {"quick": 4, "full": 25}


@check(*JUDGED, safety="stored", needs=(*NEEDS, "virtual"))
def some_runs_of_the_machine_agree_with_the_model(session: Session) -> None:
    """Everything that comes in a few runs of the stateful machine is what the model admits."""
    run_machine(runner_of(session), ModelledUnit, UnitMachine, EXAMPLES["quick"], STEPS)


@check(*JUDGED, safety="stored", needs=(*NEEDS, "virtual"), level="full", soaks=True)
def many_runs_of_the_machine_agree_with_the_model(session: Session) -> None:
    """Everything that comes in many runs of the stateful machine is what the model admits."""
    run_machine(runner_of(session), ModelledUnit, UnitMachine, EXAMPLES["full"], STEPS)
