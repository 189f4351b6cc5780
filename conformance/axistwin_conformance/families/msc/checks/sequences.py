"""Long mixed sequences against the model: what single properties do not meet."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.base.check import Check, check
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.core.session import Session
from axistwin_conformance.families.msc.sequences.runner import runner_of
from axistwin_conformance.families.msc.sequences.sequence import JUDGED
from axistwin_conformance.sequences.generated import Amount, replay_of, run_generated

ORDER = 120  # of this module in a run; see `Family.modules`

FREE: Final = Amount(120, {"quick": 4, "full": 40})
REAL: Final = Amount(30, {"quick": 1, "full": 5})
NEEDS: Final = ("variables", "flags")


@check(*JUDGED, safety="stored", needs=(*NEEDS, "virtual"))
def some_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Everything that comes of a few random sequences is what the model admits."""
    run_generated(session, "quick", runner_of, FREE, REAL)


@check(*JUDGED, safety="stored", needs=NEEDS, level="full", soaks=True)
def many_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Everything that comes of many random sequences is what the model admits."""
    run_generated(session, "full", runner_of, FREE, REAL)


def replay_check(recording: Recording) -> Check:
    """The check that plays recorded operations."""
    return replay_of(recording, many_mixed_sequences_agree_with_the_model, runner_of)
