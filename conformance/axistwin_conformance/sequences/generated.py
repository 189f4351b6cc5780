"""Checks that play operations, whatever the family: drawn at random, by a machine, or recorded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from axistwin_conformance.base import events
from axistwin_conformance.base.check import Check
from axistwin_conformance.base.recording import Recording
from axistwin_conformance.core.session import Session
from axistwin_conformance.sequences import machine
from axistwin_conformance.sequences.failure import REPLAYS, Failure
from axistwin_conformance.sequences.machine import Device, Machine
from axistwin_conformance.sequences.runner import Mismatch, Runner
from axistwin_conformance.sequences.strategies import reproducible

RunnerOf = Callable[[Session], Runner]


@dataclass(frozen=True, slots=True)
class Amount:
    """How much to play: so many operations in a list, so many lists at each level."""

    operations: int
    examples: Mapping[str, int]


def run_generated(
    session: Session, level: str, runner_of: RunnerOf, free: Amount, real: Amount
) -> None:
    """Play drawn lists, as many as the device allows: `free` where time is, else `real`."""
    amount = free if session.transport.is_lossless else real
    run_lists(runner_of(session), amount.examples[level], amount.operations)


def run_lists(runner: Runner, examples: int, operations: int) -> None:
    """Play so many drawn lists of so many operations; ends the check with the verdict on one that
    fails.  A whole list is one draw, and drawn without Hypothesis: here it could only draw byte by
    byte, and on a noisy line it could not play the same list twice."""
    session, size = runner.session, operations * runner.operation_bytes
    lists = (runner.split(session.random.randbytes(size)) for _ in range(examples))
    results = (runner.run(one, is_counted=True) for one in lists)
    failed = next((result for result in results if result.mismatch), None)
    if failed is not None:
        Failure(runner, failed).conclude()
    runner.credit()


@reproducible()
def run_machine(
    runner: Runner,
    judged: Callable[[Any], Device],
    rules: type[Machine],
    examples: int,
    steps: int,
) -> None:
    """Let a machine run so many times; ends the check with the verdict on a run that fails."""
    session = runner.session
    if not session.transport.is_lossless:
        session.skip("on a noisy line Hypothesis could not draw the same run twice")
    begun, failing = machine.search(runner.begin, judged, examples, steps, session.random, rules)
    for one in begun:
        runner.tally.add(one)
    if failing is not None:
        data, mismatch, run = failing
        Failure(runner, runner.result_of(run, runner.split(data), mismatch)).conclude()
    runner.credit()


# --- recorded ones -------------------------------------------------------------------------------


def replay_of(recording: Recording, generating: Check, runner_of: RunnerOf) -> Check:
    """The check that plays recorded operations, as safely as the one that draws them."""

    def run(session: Session) -> None:
        _replay(session, recording, runner_of)

    return replace(
        generating, name="the_recorded_operations", function=run, level="quick", soaks=False,
        behaviour="What comes of the recorded operations is what the model admits.",
    )  # fmt: skip


def _replay(session: Session, recording: Recording, runner_of: RunnerOf) -> None:
    """Play recorded operations and judge them, as often as it takes on this line."""
    for text in _circumstances(session, recording):
        session.run.emit(events.Note(text))
    runner = runner_of(session)
    operations = runner.split(b"".join(recording.operations))
    session.is_replayed = True  # as often as it takes is the business of this check
    is_free = session.transport.is_lossless
    failed: list[Mismatch] = []
    for runner.is_fresh in (True, False) if is_free else (False,) * REPLAYS:
        result = runner.run(operations, is_counted=True, is_plotted=not failed)
        if result.mismatch is not None:
            failed.append(result.mismatch)
            if is_free:
                break
    if not failed:
        runner.credit()
        return
    mismatch = failed[-1]
    told = "" if is_free else f"failed {len(failed)} of {REPLAYS} times; "
    runner.credit(mismatch.requirement)
    session.fail(
        mismatch.requirement,
        mismatch.expected,
        mismatch.actual,
        f"{told}after: {'; '.join(mismatch.story)}",
    )


def _circumstances(session: Session, recording: Recording) -> Iterator[str]:
    """What is different from when it was recorded."""
    if not recording.check:  # nothing is known of that
        return
    for switch in sorted({*recording.readings, *session.readings}):
        try:
            default = session.run.ledger.ambiguity_of(switch).default_of(switch)
        except ValueError:  # a switch of another version of the ledger
            continue
        then, now = (_of(seen, switch, default) for seen in (recording.readings, session.readings))
        if then != now:
            yield f"recorded on a device with {switch}={then}; this one has {now}"


def _of(seen: Mapping[str, str], switch: str, default: str) -> str:
    return seen.get(switch, default)
