"""Long mixed sequences against the exact model: what single properties do not meet."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from hypothesis import HealthCheck, Phase, configuration, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import FlakyFailure

from axistwin_conformance.mac_serial.bench import SAFE_PERIOD, Bench
from axistwin_conformance.mac_serial.forecast import Forecast
from axistwin_conformance.mac_serial.model import AxisModel
from axistwin_conformance.mac_serial.probes import MOVES
from axistwin_conformance.mac_serial.sequences import (
    BLAME,
    BLAME_MODE,
    BLAME_OTHERWISE,
    BYTES_PER_OPERATION,
    Mismatch,
    begin,
    read_parameters,
)
from axistwin_conformance.noise import Disturbed
from axistwin_conformance.registry import check
from axistwin_conformance.session import Session

SEQUENCE_BYTES: Final = 40 * BYTES_PER_OPERATION
EXAMPLES: Final = {"quick": 25, "full": 300}
REAL_EXAMPLES: Final = {"quick": 1, "full": 10}
REAL_OPERATIONS: Final = 30
SEQUENCE_ATTEMPTS: Final = 4  # further ones, on a noisy line

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


@check(*JUDGED, safety=MOVES, level="full")
def many_mixed_sequences_agree_with_the_model(session: Session) -> None:
    """Every reply of many random sequences is one that the model admits."""
    _play(session, "full")


def _play(session: Session, level: str) -> None:
    bench = Bench(session)
    if bench.braking(SAFE_PERIOD) and session.target.is_virtual:
        session.skip("the ledger gives no exact rule for an axis with inertia")
    home = bench.ready()
    try:
        if session.target.is_lossless:
            _search(bench, home, EXAMPLES[level])
        else:
            for _ in range(REAL_EXAMPLES[level]):
                data = session.random.randbytes(REAL_OPERATIONS * BYTES_PER_OPERATION)
                _once_undisturbed(bench, home, data)
    except Mismatch as mismatch:
        for line in mismatch.story:
            session.note(line)
        session.fail(
            mismatch.requirement,
            mismatch.expected,
            mismatch.actual,
            "after: " + "; ".join(mismatch.story),
        )
    session.expect(True, JUDGED, "", "")


def _once_undisturbed(bench: Bench, home: int, data: bytes) -> None:
    """Play a sequence; one that noise broke off begins anew, so that the others are not lost."""
    for number in range(SEQUENCE_ATTEMPTS, -1, -1):
        try:
            _one(bench, home, data)
            return
        except Disturbed:
            if not number:
                raise
            bench.session.retries.append("a sequence was broken off by noise and begins anew")


@contextmanager
def _no_folder() -> Iterator[None]:
    """Hypothesis keeps notes in a folder where it is started: not in the user's."""
    before = vars(configuration)["__hypothesis_home_directory"]
    with tempfile.TemporaryDirectory() as folder:
        configuration.set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            configuration.set_hypothesis_home_dir(before)


@_no_folder()
def _search(bench: Bench, home: int, examples: int) -> None:
    """Let Hypothesis draw.  Its shrinker knows nothing of operations and would need thousands of
    runs; leaving out operations one by one needs forty."""
    failing: list[tuple[bytes, Mismatch]] = []

    @seed(bench.session.random.getrandbits(32))
    @settings(
        max_examples=examples,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
        print_blob=False,
        report_multiple_bugs=False,
    )
    @given(st.binary(min_size=SEQUENCE_BYTES, max_size=SEQUENCE_BYTES))
    def example(data: bytes) -> None:
        try:
            _one(bench, home, data)
        except Mismatch as mismatch:
            failing.append((data, mismatch))
            raise

    try:
        example()
    except (Mismatch, FlakyFailure):
        data, mismatch = failing[-1]
        raise _shortened(bench, home, data, mismatch) from None


def _shortened(bench: Bench, home: int, data: bytes, mismatch: Mismatch) -> Mismatch:
    """Leave out every operation, then every pause, that the mismatch does not need."""
    operations = [
        data[at : at + BYTES_PER_OPERATION] for at in range(0, len(data), BYTES_PER_OPERATION)
    ]
    for number in reversed(range(len(operations))):
        for instead in ([], [operations[number][:-1] + b"\0"]):
            fewer = operations[:number] + instead + operations[number + 1 :]
            try:
                _one(bench, home, b"".join(fewer))
            except Mismatch as again:
                if again.requirement == mismatch.requirement:
                    operations, mismatch = fewer, again
                    break
    return mismatch


def _one(bench: Bench, home: int, data: bytes) -> None:
    for index, parameter in ((0x09, 0x3FFFFFFF), (0x0A, 0xC0000000), (0x0E, 0x0500), (0x0C, 0x40)):
        bench.command(index, parameter)
    begin(bench, home, _model).play(data)


def _model(bench: Bench) -> AxisModel:
    ledger, seen = bench.session.run.ledger, bench.session.readings
    readings = {
        switch: ledger.ambiguity_of(switch).switches[switch].index(reading)
        for switch, reading in seen.items()
        if reading in ledger.ambiguity_of(switch).switches[switch]
    }
    return AxisModel(read_parameters(bench), Forecast.rest(0), readings, bench.law)
