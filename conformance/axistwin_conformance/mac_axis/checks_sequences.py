"""Long mixed sequences against the exact model: what single properties do not meet."""

from __future__ import annotations

from typing import Final

from axistwin_conformance.drawn import play_lists, replay
from axistwin_conformance.mac_axis.bench import SAFE_PERIOD, bench_of
from axistwin_conformance.mac_axis.player import Player
from axistwin_conformance.mac_axis.probing import MOVES
from axistwin_conformance.mac_axis.sequences import BLAME, BLAME_MODE, BLAME_OTHERWISE
from axistwin_conformance.recording import Recording
from axistwin_conformance.registry import Check, check
from axistwin_conformance.session import Session

OPERATIONS_PLAYED: Final = 200  # long ones spend less on beginning and end
EXAMPLES: Final = {"quick": 5, "full": 60}
REAL_EXAMPLES: Final = {"quick": 1, "full": 10}
REAL_OPERATIONS: Final = 30

JUDGED: Final = tuple(
    dict.fromkeys(
        [*BLAME.values(), *BLAME_MODE.values(), BLAME_OTHERWISE, "MACS-Q-XX-01", "MACS-REPLY-02",
         "MACS-FRAME-07"]
    )
)  # fmt: skip


@check(*JUDGED, safety=MOVES, needs=("virtual",))
def some_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Every reply of a few random sequences is one that the model admits."""
    _play(session, "quick")


@check(*JUDGED, safety=MOVES, level="full", soaks=True)
def many_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Every reply of many random sequences is one that the model admits."""
    _play(session, "full")


def player_of(session: Session) -> Player:
    """Somebody who plays on the module under test; ends the check where nobody can judge that."""
    bench = bench_of(session)
    if bench.braking(SAFE_PERIOD) and session.carrier.is_virtual:
        session.skip("the ledger gives no exact rule for an axis with inertia")
    return Player(bench, bench.ready())


def _play(session: Session, level: str) -> None:
    if session.carrier.is_lossless:
        play_lists(player_of(session), EXAMPLES[level], OPERATIONS_PLAYED)
    else:
        play_lists(player_of(session), REAL_EXAMPLES[level], REAL_OPERATIONS)


def replay_check(recording: Recording) -> Check:
    """The check that plays recorded operations, as safely as those of any other check."""

    def play(session: Session) -> None:
        replay(session, recording, player_of)

    behaviour = "Every reply to the recorded operations is one that the model admits."
    return Check("the_recorded_operations", play, JUDGED, MOVES, "quick", (), behaviour, __name__)
