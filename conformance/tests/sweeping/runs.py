"""One run of the suite on a twin, and what came of it as a row."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from family_variants import vary
from interfaces import ALL, judged_behind
from small_scratch import small_scratch
from zoo.judge import Overrun, limited

from axistwin_conformance.base.events import CheckStarted, Event, Identified, Outcome
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.engine.eta import PLAIN_TRIP_NS
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine

INTERFACES = {one.name: one for one in ALL}
VIRTUAL = "virtual"  # no interface: the built-in twin, in a time that the suite knows
# No second device can be beside these; one that hunts talks into the packets of its neighbours.
ALONE = ("address_settable=false", "transport=rs232", "other_unit_framing=hunt_stx")
NEIGHBOURS = {"mac23": (1,), "mac23-can": (2,)}
TRAVEL = 20_000
# On a bench, with exchanges as long as those of a plain line: twice the most of a full run.
LONGEST_S = 2 * 20 * 60.0
JUDGED = (Verdict.PASS, Verdict.FAIL, Verdict.QUIRK)
Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Setting:
    """How a sweep judges: a model, behind what, how much of the suite, and with which patience.

    `limit_s`: of processor time.  `is_exitfirst`: not beyond the first failure, which is cheaper,
    and does not show what would hang or go too far after it.
    """

    model: str
    interface: str
    level: str
    limit_s: float
    is_exitfirst: bool = False


def judge(setting: Setting, seed: int, query: str = "", *, detects: bool = False) -> Row:
    """Judge a twin that is made with these words in its URL."""
    return judged_within(setting, lambda hear: _run(setting, seed, query, hear, detects))


def judged_within(setting: Setting, run: Callable[[Callable[[Event], None]], Row]) -> Row:
    """What comes of a run, or why it was ended."""
    current, slower = [""], [1.0]

    def hear(event: Event) -> None:
        if isinstance(event, CheckStarted):
            current[0] = event.name
        if isinstance(event, Identified):
            slower[0] = max(1.0, event.round_trip_median_ns / PLAIN_TRIP_NS)

    began = time.process_time()
    row: Row = {"hang": ""}
    try:
        with limited(setting.limit_s):
            row |= run(hear)
    except Overrun:
        row["hang"] = f"{setting.limit_s:.0f} s of processor time, in {current[0] or 'no check'}"
    except Exception as error:  # nothing may come out of an engine
        row["errors"] = [f"out of the engine: {type(error).__name__}: {error}"]
    if row.get("bench_s", 0) > LONGEST_S * slower[0]:
        row["hang"] = f"{row['bench_s']} s on a bench"
    return row | {"cpu_s": round(time.process_time() - began, 1)}


def _run(
    setting: Setting, seed: int, query: str, hear: Callable[[Event], None], detects: bool
) -> Row:
    if setting.interface == VIRTUAL:
        return told(_virtual(setting, seed, query, hear, detects))
    run = judged_behind(
        INTERFACES[setting.interface], model=setting.model, level=setting.level, seed=seed,
        query=query, neighbours=NEIGHBOURS.get(setting.model, ()), detects=detects, hear=hear,
        exitfirst=setting.is_exitfirst,
    )  # fmt: skip
    left = [
        {name: (before.get(name), after.get(name)) for name in before.keys() | after.keys()
         if before.get(name) != after.get(name)}
        for before, after in zip(run.way.found, run.way.left, strict=True)
    ]  # fmt: skip
    return told(run.result) | {"bench_s": round(run.seconds), "left": left}


def _virtual(
    setting: Setting, seed: int, query: str, hear: Callable[[Event], None], detects: bool
) -> Result:
    options = make_options(
        model=setting.model, level=setting.level, seed=seed, is_detection=detects,
        exitfirst=setting.is_exitfirst,         **small_scratch(setting.model),
    )  # fmt: skip
    if any(reading in query for reading in ALONE):
        options = replace(options, neighbours=())
    url = options.family.twin_url
    # The long random sequences are half of the time, and judge what the short ones judge.
    checks = [one for one in options.family.checks() if not (one.soaks and one.level == "full")]

    def other_url(*given: Any) -> str:
        return url(*given) + query

    family = vary(options.family, twin_url=other_url, checks=lambda: checks)
    return Engine(replace(options, family=family)).run(hear)


def told(result: Result) -> Row:
    """What a run has found out, as a row."""
    ledger = load_ledger(result.options.family.name)
    troubles = [one.trouble for one in result.checks] + result.problems
    return {
        "status": result.exit_status,
        "sentence": result.refusal or result.sentence,
        "failed": sorted({
            one.requirement.id for one in result.requirements if one.verdict is Verdict.FAIL
        }),
        "evidence": [
            f"{ran.check.name}: {finding.requirement}: {finding.text} expected"
            f" {' or '.join(finding.expected)}, got {finding.actual}"
            for ran in result.checks for finding in ran.findings
            if finding.verdict is Verdict.FAIL
        ][:3],
        "open": {
            one.requirement.id: one.reason for one in result.requirements
            if one.verdict is Verdict.INCONCLUSIVE
        },
        "judged": sorted(
            one.requirement.id for one in result.requirements if one.verdict in JUDGED
        ),
        "named": {
            switch: reading for switch, reading in result.readings.items()
            if reading != ledger.ambiguity_of(switch).default_of(switch)
        },
        "detected": {
            switch: [one.reading, list(one.candidates)]
            for switch, one in result.detections.items()
        },
        "untold": {
            switch: one.evidence
            for switch, one in result.detections.items()
            if one.reading is None and not one.candidates
        },
        "problems": list(result.problems),
        "left_out": {
            ran.check.name: ran.trouble for ran in result.checks
            if ran.trouble and ran.outcome is not Outcome.DONE
        },
        "errors": sorted({text for text in troubles if "error in the suite" in text}),
    }  # fmt: skip
