"""The judge: the black-box suite in virtual time, check by check, until every claim is refuted."""

from __future__ import annotations

import signal
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cache
from itertools import product
from types import FrameType
from typing import Any, Final

from small_scratch import small_scratch

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.events import CheckFinished, Event, Outcome
from axistwin_conformance.base.ledger import Ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.catalog import find_family
from zoo.mutant import Mutant

# What is random comes last: it names nearly everything and costs more than all the others.
LAST = frozenset(
    {
        "some_mixed_sequences_agree_with_the_model",
        "some_runs_of_the_machine_agree_with_the_model",
    }
)
NEVER = frozenset(
    {
        "many_mixed_sequences_agree_with_the_model",
        "many_runs_of_the_machine_agree_with_the_model",
    }
)
Flaw = tuple[str, str, str | None]
# Of one check, in processor time, however busy the machine is: many times what any needs.  A twin
# that never comes to an end is not killed by that.
LIMIT_S = 60.0
LEAST_S = 0.001  # of a limit that is over; 0 would be none
DEADLINES: Final[list[float]] = []  # of the limits that hold, by the clock of the process


class Overrun(BaseException):
    """A check took too long; no Exception, so that the engine does not take it for a crash."""


def is_over() -> bool:
    """Whether a limit that holds has passed: the timer comes late, or not while others are set."""
    return any(until_s <= time.process_time() for until_s in DEADLINES)


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Raise Overrun in this (the main) thread after so many seconds of processor time; what is left
    of a limit around it goes on."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise Overrun

    if is_over():
        raise Overrun
    around_s = DEADLINES[-1:]
    DEADLINES.append(time.process_time() + seconds)
    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        DEADLINES.pop()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
        for until_s in around_s:
            signal.setitimer(signal.ITIMER_PROF, max(until_s - time.process_time(), LEAST_S))


@cache
def checks_of(requirement: str, model: str = "mac23") -> tuple[Check, ...]:
    """The checks that name a requirement, in the order in which they are tried."""
    naming = [
        check
        for check in find_family(model).checks()
        if requirement in check.requirements and check.name not in NEVER
    ]
    # The more a check is about this requirement alone, the sooner it tells.
    return tuple(sorted(naming, key=lambda check: (check.name in LAST, len(check.requirements))))


def run(check: str, model: str = "mac23", address: int | None = None, **scratch: Any) -> Result:
    """Judge the built-in twin, as this process has it now, by one check."""
    options = make_options(model=model, ids=(check,), address=address, **scratch)
    return Engine(replace(options, shrinks=False)).run(lambda event: None)


def failed(result: Result) -> frozenset[str]:
    """The requirements on which the checks of a run have failed, by their own judgement."""
    return frozenset(
        finding.requirement
        for ran in result.checks
        if ran.outcome is Outcome.DONE
        for finding in ran.findings
        if finding.verdict is Verdict.FAIL and finding.requirement in ran.check.requirements
    )


class Settled(BaseException):
    """Every claim is refuted, or the run goes on for too long; ends it."""


def _together(mutant: Mutant, checks: Sequence[Check], claims: frozenset[str]) -> dict[str, str]:
    """Judge by all these checks in one run, which asks once for the readings of the twin, until
    every claim is refuted; return claim → check for those that are."""
    found: dict[str, str] = {}
    requirements = {check.name: frozenset(check.requirements) for check in checks}

    def hear(event: Event) -> None:
        if not isinstance(event, CheckFinished):
            return
        signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
        if event.outcome is Outcome.DONE:
            for finding in event.findings:
                name = finding.requirement
                # What is told beside the checks has a name of its own.
                is_own = name in requirements.get(event.name, frozenset()) & claims
                if is_own and finding.verdict is Verdict.FAIL:
                    found.setdefault(name, event.name)
        if found.keys() >= claims:
            raise Settled

    options = make_options(
        model=mutant.model,
        ids=tuple(requirements),
        address=mutant.address,
        **small_scratch(mutant.model),
    )
    with suppress(Overrun, Settled), limited(LIMIT_S):
        Engine(replace(options, shrinks=False)).run(hear)
    return found


def wrong(
    checks: Iterable[str], model: str, address: int | None = None, **scratch: Any
) -> list[Flaw]:
    """What these checks, which must all be done, find wrong with a twin that nobody has tampered
    with: check, requirement, what was seen."""
    names = set(checks)
    options = make_options(model=model, ids=tuple(sorted(names)), address=address, **scratch)
    result = Engine(options).run(lambda event: None)
    assert not NEVER & names
    found = [
        (ran.check.name, finding.requirement, finding.actual)
        for ran in result.checks
        for finding in ran.findings
        if finding.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.QUIRK)
    ]
    assert found or result.exit_status == 0, result.sentence
    return found


def judge_names(zoo: Sequence[Mutant], ledger: Ledger) -> None:
    """A mutant is told by its name; a claim is a requirement that some check names."""
    assert len({mutant.name for mutant in zoo}) == len(zoo)
    for mutant in zoo:
        assert mutant.description.endswith("."), mutant.name
        for claim in mutant.claims:
            assert claim in ledger.requirements, (mutant.name, claim)
            assert checks_of(claim, mutant.model), (mutant.name, claim)


def judge_armed(armed: Collection[str], ledger: Ledger) -> None:
    """Of what is stated or follows, and can be seen on the wire, nine in ten are proven."""
    visible = {
        one.id
        for one in ledger.requirements.values()
        if one.kind != "interpretation" and not one.not_on_wire
    }
    assert len(visible & set(armed)) >= 0.9 * len(visible), sorted(visible - set(armed))


def kills(mutant: Mutant) -> Mapping[str, str]:
    """Claimed requirement → the check that failed it; a claim that nobody refuted is missing.

    At first all that name a claim judge in one run, which a fault may end early; then, for what is
    left, each by itself; with a small scratch area, and only where that is not enough with all.
    """
    claims = frozenset(mutant.claims)
    small = small_scratch(mutant.model)
    with mutant.plant():
        first = [
            check
            for check in find_family(mutant.model).checks()
            if claims.intersection(check.requirements) and check.name not in LAST | NEVER
        ]
        found = _together(mutant, first, claims)
        for claim, scratch in product(mutant.claims, (small, {}) if small else ({},)):
            for check in checks_of(claim, mutant.model):
                if claim in found:
                    break
                with suppress(Overrun), limited(LIMIT_S):
                    result = run(check.name, mutant.model, mutant.address, **scratch)
                    fallen = failed(result) & claims
                    found |= dict.fromkeys(fallen - found.keys(), check.name)
    return found
