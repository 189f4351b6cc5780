"""Long mixed sequences against the exact model: what single properties do not meet."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from hypothesis import given, seed
from hypothesis import strategies as st
from hypothesis.errors import FlakyFailure

from axistwin_conformance import events
from axistwin_conformance.drawing import no_folder, only_drawing
from axistwin_conformance.mac_axis.bench import SAFE_PERIOD, bench_of
from axistwin_conformance.mac_axis.failures import REPLAYS, Failure, Played, Player
from axistwin_conformance.mac_axis.probing import MOVES
from axistwin_conformance.mac_axis.sequences import (
    BLAME,
    BLAME_MODE,
    BLAME_OTHERWISE,
    BYTES_PER_OPERATION,
    Mismatch,
)
from axistwin_conformance.recording import Recording
from axistwin_conformance.registry import Check, check
from axistwin_conformance.session import Session

SEQUENCE_BYTES: Final = 200 * BYTES_PER_OPERATION  # long ones spend less on beginning and end
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
    player = player_of(session)
    if session.carrier.is_lossless:
        failed = _searched(player, EXAMPLES[level])
    else:
        lists = (
            player.split(session.random.randbytes(REAL_OPERATIONS * BYTES_PER_OPERATION))
            for _ in range(REAL_EXAMPLES[level])
        )
        played = (player.play(one, is_counted=True) for one in lists)
        failed = next((one for one in played if one.mismatch), None)
    if failed is not None:
        Failure(player, failed).settle()
    player.credit()


@no_folder()
def _searched(player: Player, examples: int) -> Played | None:
    """Let Hypothesis draw; give the first list that fails."""
    failing: list[Played] = []

    @seed(player.bench.session.random.getrandbits(32))
    @only_drawing(examples)
    @given(st.binary(min_size=SEQUENCE_BYTES, max_size=SEQUENCE_BYTES))
    def example(data: bytes) -> None:
        played = player.play(player.split(data), is_counted=True)
        if played.mismatch is not None:
            failing.append(played)
            raise played.mismatch

    try:
        example()
    except (Mismatch, FlakyFailure):
        return failing[-1]
    return None


# --- recorded ones -------------------------------------------------------------------------------


def replay_check(recording: Recording) -> Check:
    """The check that plays recorded operations, as safely as those of any other check."""

    def play(session: Session) -> None:
        _replay(session, recording)

    behaviour = "Every reply to the recorded operations is one that the model admits."
    return Check("the_recorded_operations", play, JUDGED, MOVES, "quick", (), behaviour, __name__)


def _replay(session: Session, recording: Recording) -> None:
    for text in _circumstances(session, recording):
        session.run.tell(events.Note(text))
    player = player_of(session)
    operations = player.split(b"".join(recording.operations))
    session.is_replayed = True  # as often as it takes is the business of this check
    is_free = session.carrier.is_lossless
    failed: list[Mismatch] = []
    for player.is_fresh in (True, False) if is_free else (False,) * REPLAYS:
        played = player.play(operations, is_counted=True, is_plotted=not failed)
        if played.mismatch is not None:
            failed.append(played.mismatch)
            if is_free:
                break
    if not failed:
        player.credit()
        return
    mismatch = failed[-1]
    told = "" if is_free else f"failed {len(failed)} of {REPLAYS} times; "
    player.credit(mismatch.requirement)
    session.fail(
        mismatch.requirement,
        mismatch.expected,
        mismatch.actual,
        f"{told}after: {'; '.join(mismatch.story)}",
    )


def _circumstances(session: Session, recording: Recording) -> Iterator[str]:
    """What is different from when it was recorded."""
    if recording.check:  # otherwise nothing is known of that
        for switch in sorted({*recording.readings, *session.readings}):
            try:
                default = session.run.ledger.ambiguity_of(switch).default_of(switch)
            except ValueError:  # a switch of another version of the ledger
                continue
            then = recording.readings.get(switch, default)
            now = session.readings.get(switch, default)
            if then != now:
                yield f"recorded on a device with {switch}={then}; this one has {now}"
