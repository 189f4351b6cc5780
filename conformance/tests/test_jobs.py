"""Processes beside the run find what the run would have found, and none survives it."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import psutil
import pytest

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.classes import SAFETY_CLASSES
from axistwin_conformance.base.events import Event, Outcome, StatesCovered
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Envelope, Run, Session
from axistwin_conformance.engine.attempts import Attempts
from axistwin_conformance.engine.jobs import Jobs, RunSetup, judge
from axistwin_conformance.engine.result import CheckResult
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.options import make_options

pytestmark = pytest.mark.system

FAMILY = find_family("mac23")
DRAWN = "some_mixed_sequences_agree_with_the_model"
WALKED = "some_runs_of_the_machine_agree_with_the_model"
ODD = "&quirk.sync_without_preload=refuse"  # a reading that the run has not been told of
SPARE_S = 300.0  # a process needs a hundredth of it on an idle machine


class Unkept:
    """Nobody looks after the twin of a test."""

    def guard(self, session: Session, data: bytes) -> None:
        """Let everything pass."""

    def restore(self, run: Run) -> None:
        """Leave it."""

    def is_sane(self, run: Run) -> bool:
        """Believe it."""
        return True


@dataclass
class Bench:
    """A run on a twin of its own, and what was told meanwhile."""

    events: list[Event] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)

    def run(self, seed: int = 7, more: str = "") -> Run:
        """A run, as the engine makes it."""
        url = FAMILY.twin_url("mac23", 0, ()) + more
        run = Run(
            target=FAMILY.open(url, None, is_builtin=True), family=FAMILY,
            model=FAMILY.models["mac23"], ledger=load_ledger(FAMILY.name), address=0,
            neighbours=(), allowed=frozenset(SAFETY_CLASSES),
            envelope=Envelope(1 << 20, 1 << 20, is_guarded=False), seed=seed,
            emit=self.events.append,
        )  # fmt: skip
        run.target.meter = lambda data: run.budget.note(FAMILY.stored_writes(data))
        run.memory = FAMILY.remember(Session(run))
        self.runs.append(run)
        return run

    def here(self, run: Run, check: Check) -> CheckResult:
        """Run a check in this process."""
        return Attempts(self.events.append, Unkept()).believed(run, check)

    def jobs(self, count: int = 1) -> Jobs:
        """Workers."""
        return Jobs(count, self.notes.append)


@pytest.fixture
def bench() -> Iterator[Bench]:
    """A bench whose twins are closed in the end."""
    one = Bench()
    yield one
    for run in one.runs:
        run.target.close()


def check_of(name: str) -> Check:
    """The check of that name."""
    return next(one for one in FAMILY.checks() if one.name == name)


def not_here(run: Run, check: Check) -> CheckResult:
    """Nobody may run it here."""
    raise AssertionError(f"{check.name} ran in this process")


def eventually(holds: Callable[[], bool]) -> bool:
    """Whether it comes to hold."""
    end = time.monotonic() + SPARE_S
    while not holds() and time.monotonic() < end:
        time.sleep(0.02)
    return holds()


def is_gone(number: int) -> bool:
    """Whether a process has ended."""
    try:
        return bool(psutil.Process(number).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize("name", [DRAWN, WALKED])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_worker_judges_what_the_run_would_judge(bench: Bench, name: str, seed: int) -> None:
    """The same judgements as often, the same operations in the same states, the same writes."""
    run = bench.run(seed)
    begun = run.budget.spent
    own = bench.here(run, check_of(name))
    told = judge(RunSetup.of(run), name, seed)
    assert own.outcome is told.outcome is Outcome.DONE
    assert own.findings == told.findings
    assert [one.verdict for one in told.findings].count(Verdict.PASS) > 3
    covered = [one for one in told.events if isinstance(one, StatesCovered)]
    assert covered == bench.events
    assert covered[0].operations > 100
    assert told.writes == run.budget.spent - begun > 0


def test_what_a_process_beside_the_run_has_judged_is_taken_over(bench: Bench) -> None:
    """Its findings, its events and its writes, one check after the other, none of them here."""
    run, jobs, drawn, walked = bench.run(), bench.jobs(), check_of(DRAWN), check_of(WALKED)
    try:
        for seed in (1, 2):
            for check in (drawn, walked):
                jobs.begin(run, check, seed)
        for run.seed in (1, 2):
            for check in (drawn, walked):
                spent = run.budget.spent
                result = jobs.judged(run, check, not_here)
                assert run.budget.spent > spent
                if check is drawn:
                    again = judge(RunSetup.of(run), check.name, run.seed)
                    assert result.findings == again.findings
                else:  # what Hypothesis draws depends on the modules that a process has loaded
                    assert {one.requirement for one in result.findings} <= set(check.requirements)
                    assert all(one.verdict in (Verdict.PASS, Verdict.NOT_RUN)
                               for one in result.findings)  # fmt: skip
        assert len({json.dumps(one.counts) for one in bench.events}) == 4  # type: ignore[union-attr]
        assert bench.notes == []
    finally:
        jobs.close()
    assert multiprocessing.active_children() == []


def test_what_nobody_has_begun_is_run_here(bench: Bench) -> None:
    """Without workers, for another seed, or when the device has shown a reading since."""
    run, none, one = bench.run(), bench.jobs(0), bench.jobs(1)
    check, ran = check_of(DRAWN), []

    def here(run: Run, check: Check) -> CheckResult:
        ran.append(run.seed)
        return CheckResult(check, Outcome.DONE, (), (), 0.0, "")

    try:
        none.begin(run, check, run.seed)
        none.judged(run, check, here)
        one.begin(run, check, run.seed)
        run.readings["vel_change_law"] = "step"
        one.judged(run, check, here)
        run.seed = 8
        one.judged(run, check, here)
    finally:
        one.close()
    assert ran == [7, 7, 8]


def test_what_a_worker_finds_wrong_is_looked_into_here(bench: Bench) -> None:
    """The run's own result counts: it is the one that is shrunk and can be replayed."""
    run, jobs, check = bench.run(3, ODD), bench.jobs(), check_of(DRAWN)
    try:
        jobs.begin(run, check, 3)
        result = jobs.judged(run, check, bench.here)
    finally:
        jobs.close()
    assert result.recording is not None
    assert len(result.recording.operations) < 10
    failed = [one for one in result.findings if one.verdict is Verdict.FAIL]
    assert [one.requirement for one in failed] == ["MACS-CMD-11-01"]
    assert "shrunk from" in failed[0].text
    assert bench.notes == []


def test_what_does_not_come_again_here_is_told_as_it_was_seen(bench: Bench) -> None:
    """A failure is never dropped because the twin of this process does not show it."""
    run, other, jobs = bench.run(3, ODD), bench.run(3), bench.jobs()
    check = check_of(DRAWN)
    try:
        jobs.begin(run, check, 3)
        result = jobs.judged(other, check, bench.here)
    finally:
        jobs.close()
    failed = [one for one in result.findings if one.verdict is Verdict.FAIL]
    assert [one.requirement for one in failed] == ["MACS-CMD-11-01"]
    assert "not shrunk: found in a process beside the run" in failed[0].text
    assert bench.notes == [f"{DRAWN}: what a worker process found did not come again in this one"]


def test_a_lost_worker_is_told_and_its_work_done_here(bench: Bench) -> None:
    """Once: from then on nothing is begun elsewhere."""
    run, jobs, check = bench.run(), bench.jobs(), check_of(DRAWN)
    try:
        jobs.begin(run, check, run.seed)
        (worker,) = multiprocessing.active_children()
        os.kill(worker.pid or 0, signal.SIGKILL)
        result = jobs.judged(run, check, bench.here)
        assert [one.verdict for one in result.findings].count(Verdict.PASS) > 3
        (note,) = bench.notes
        assert note.startswith("a worker process was lost, what it was to do is done here: ")
        jobs.begin(run, check, 8)
        assert multiprocessing.active_children() == []
    finally:
        jobs.close()
    assert len(bench.notes) == 1


def test_workers_are_ended_in_the_middle_of_their_work(bench: Bench) -> None:
    """Closing does not wait for what nobody will ask for any more."""
    run, jobs, check = (
        bench.run(),
        bench.jobs(),
        check_of("many_runs_of_the_machine_agree_with_the_model"),
    )
    for seed in range(20):
        jobs.begin(run, check, seed)
    (worker,) = multiprocessing.active_children()
    jobs.close()
    assert worker.exitcode is not None
    assert bench.notes == []


SOAK = (sys.executable, "-m", "axistwin", "conform", "mac23", "--level", "soak", "--duration", "1h",
        "--jobs", "2", "--json", "many_mixed_sequences_agree_with_the_model")  # fmt: skip


def workers_of(process: psutil.Process) -> list[int]:
    """The processes that a run has begun."""
    return [one.pid for one in process.children(recursive=True)]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=lambda one: one.name)
def test_nothing_survives_the_run(number: signal.Signals) -> None:
    """Of all processes of a terminal Ctrl-C ends the run's own; workers of one killed find out."""
    with subprocess.Popen(
        SOAK, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        for line in process.stdout:
            if json.loads(line)["event"] == "soak_progress" and json.loads(line)["round"] == 2:
                break
        workers = workers_of(psutil.Process(process.pid))
        assert len(workers) >= 2
        if number is signal.SIGKILL:
            process.kill()
        else:
            os.killpg(process.pid, number)
        rest, trouble = process.communicate(timeout=SPARE_S)
        assert eventually(lambda: all(map(is_gone, workers)))
    if number is signal.SIGINT:
        assert trouble == ""
        assert process.returncode == 130
        assert "nothing found" in rest


@pytest.mark.strength(seconds=40)
def test_a_soak_finds_the_same_with_any_number_of_processes() -> None:
    """The rounds have the same seeds, and each holds the same, however many are under way."""
    options = make_options(
        model="mac23", ids=("many_mixed_sequences_agree_with_the_model",), level="soak",
        duration=0.01,
    )  # fmt: skip
    told: list[list[Event]] = []
    for jobs in (1, 2, 3):
        events: list[Event] = []
        result = Engine(replace(options, jobs=jobs)).run(events.append)
        assert result.exit_status == 0
        told.append([one for one in events if isinstance(one, StatesCovered)])
    for others in told[1:]:
        assert others[0] == told[0][0]
