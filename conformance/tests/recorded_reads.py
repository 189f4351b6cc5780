"""Which readings checks and probes look up: runs that are watched, and what comes of them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from interfaces import PLAIN, judged_behind
from small_scratch import small_scratch

from axistwin_conformance.base.check import Check
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.probing import Probe
from axistwin_conformance.core.session import Run
from axistwin_conformance.engine.attempts import Attempts
from axistwin_conformance.engine.device import detection
from axistwin_conformance.engine.run import Engine

Reads = dict[str, set[str]]

TRAVEL: dict[str, dict[str, Any]] = {
    "mac23": {"max_travel": 10**6}, "mac23-can": {"max_travel": 10**6},
}  # fmt: skip
MODELS = {
    "mac_serial": "mac23", "mac_can": "mac23-can", "msc": "msc-850-32", "mn400": "mn400",
}  # fmt: skip
HEAD = """\
# Written by scripts/reads: which switches each check and probe looks up, that is, on which readings
# of the manual it depends.  Do not edit.

[reads]
"""


def watched(act: Callable[[], object]) -> Reads:
    """What is looked up by each check and probe while this is done."""
    found: Reads = defaultdict(set)

    def run_check(go: Any, attempts: Attempts, run: Run, check: Check, **how: Any) -> Any:
        return _noting(found, run, check.name, lambda: go(attempts, run, check, **how))

    def ask(go: Any, run: Run, probe: Probe, *others: Any) -> Any:
        return _noting(found, run, probe.check.name, lambda: go(run, probe, *others))

    with pytest.MonkeyPatch.context() as patch:
        attempt, question = Attempts._attempt, detection._ask
        patch.setattr(Attempts, "_attempt", lambda *a, **how: run_check(attempt, *a, **how))
        patch.setattr(detection, "_ask", lambda *a: ask(question, *a))
        act()
    return found


def _noting(found: Reads, run: Run, name: str, act: Callable[[], Any]) -> Any:
    before = set(run.readings.looked_up)
    run.readings.looked_up.clear()
    try:
        return act()
    finally:
        found[name] |= run.readings.looked_up
        run.readings.looked_up |= before


def on_the_twin(model: str, *words: str) -> Reads:
    """Of the built-in twin, which can be asked everything."""
    options = make_options(model=model, ids=words, level="full", **small_scratch(model))
    return watched(lambda: Engine(options).run(lambda event: None))


def behind_a_port(model: str, *words: str) -> Reads:
    """Of a real device."""
    return watched(
        lambda: judged_behind(PLAIN, *words, model=model, level="full", **TRAVEL.get(model, {}))
    )


def of_a_replay(model: str) -> Reads:
    """Of recorded operations: what every list of them depends on."""
    size = make_options(model=model).family.operation_bytes
    word = bytes(size).hex()
    how = {"replay": word, "level": None, **TRAVEL.get(model, {})}
    return watched(lambda: judged_behind(PLAIN, model=model, **how)) if size else {}


def recorded(model: str) -> Mapping[str, tuple[str, ...]]:
    """All that is known of a model, in one order."""
    found: Reads = defaultdict(set)
    for reads in (on_the_twin(model), behind_a_port(model), of_a_replay(model)):
        for name, switches in reads.items():
            found[name] |= switches
    return {name: tuple(sorted(found[name])) for name in sorted(found)}


def as_toml(reads: Mapping[str, tuple[str, ...]]) -> str:
    """The table as it is shipped."""
    rows = []
    for name, switches in reads.items():
        line = f"{name} = [{', '.join(repr(one) for one in switches)}]".replace("'", '"')
        if len(line) > 100:
            line = f"{name} = [\n" + "".join(f'    "{one}",\n' for one in switches) + "]"
        rows.append(line)
    return HEAD + "\n".join(rows) + "\n"
