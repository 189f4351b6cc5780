"""Long mixed sequences against the exact model: what single properties do not meet."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import Check, check
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.mac.axis.driver.driver import driver_of
from axistwin_conformance.families.mac.axis.probing import MOVES
from axistwin_conformance.families.mac.axis.sequences.runner import AxisRunner
from axistwin_conformance.families.mac.axis.sequences.sequence import (
    DIAGNOSIS,
    DIAGNOSIS_OF_MODE,
    DIAGNOSIS_OTHERWISE,
)
from axistwin_conformance.sequences.generated import Amount, replay_of, run_generated

ORDER = 200  # of this module in a run; see `Family.modules`

FREE: Final = Amount(200, {"quick": 5, "full": 60})  # long ones spend less on beginning and end
REAL: Final = Amount(30, {"quick": 1, "full": 10})

DIAGNOSES_BESIDE: Final = ("MACS-Q-XX-01", "MACS-REPLY-02", "MACS-FRAME-07")
JUDGED: Final = tuple(
    dict.fromkeys(
        [*DIAGNOSIS.values(), *DIAGNOSIS_OF_MODE.values(), DIAGNOSIS_OTHERWISE, *DIAGNOSES_BESIDE]
    )
)


@check(*JUDGED, safety=MOVES, needs=("virtual",))
def some_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Every reply of a few random sequences is one that the model admits."""
    run_generated(session, "quick", runner_of, FREE, REAL)


@check(*JUDGED, safety=MOVES, level="full", soaks=True)
def many_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Every reply of many random sequences is one that the model admits."""
    run_generated(session, "full", runner_of, FREE, REAL)


def runner_of(session: Session) -> AxisRunner:
    """Somebody who plays on the module under test; ends the check where nobody can judge that."""
    for switch in ("plant", "brake_increments"):
        session.reading(switch)  # no guess will do where random operations are judged
    return _replayer_of(session)


def _replayer_of(session: Session) -> AxisRunner:
    """The same for what is recorded: hardly of an axis on which it could not be judged."""
    driver = driver_of(session)
    if not driver.limits.has_ideal_plant or driver.limits.brake_increments not in ("plant", "0"):
        session.skip("the ledger gives no exact rule for an axis that runs on after a stop")
    return AxisRunner(driver, driver.motion.ready())


def replay_check(recording: Recording) -> Check:
    """The check that plays recorded operations."""
    return replay_of(recording, many_mixed_sequences_agree_with_the_model, _replayer_of)
