"""Long mixed sequences against the model: what single properties do not meet."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.drawn import play_lists, replay
from axistwin_conformance.msc.player import player_of
from axistwin_conformance.msc.sequences import JUDGED
from axistwin_conformance.recording import Recording
from axistwin_conformance.registry import Check, check
from axistwin_conformance.session import Session

OPERATIONS_PLAYED: Final = 120
EXAMPLES: Final = {"quick": 4, "full": 40}
REAL_EXAMPLES: Final = {"quick": 1, "full": 6}
REAL_OPERATIONS: Final = 30
NEEDS: Final = ("variables", "flags")


@check(*JUDGED, safety="stored", needs=(*NEEDS, "virtual"))
def some_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Everything that comes of a few random sequences is what the model admits."""
    _play(session, "quick")


@check(*JUDGED, safety="stored", needs=NEEDS, level="full", soaks=True)
def many_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Everything that comes of many random sequences is what the model admits."""
    _play(session, "full")


def _play(session: Session, level: str) -> None:
    if session.carrier.is_lossless:
        play_lists(player_of(session), EXAMPLES[level], OPERATIONS_PLAYED)
    else:
        play_lists(player_of(session), REAL_EXAMPLES[level], REAL_OPERATIONS)


def replay_check(recording: Recording) -> Check:
    """The check that plays recorded operations, as safely as those of any other check."""

    def play(session: Session) -> None:
        replay(session, recording, player_of)

    behaviour = "Everything that comes of the recorded operations is what the model admits."
    return Check(
        "the_recorded_operations", play, JUDGED, ("stored",), "quick", NEEDS, behaviour, __name__
    )
