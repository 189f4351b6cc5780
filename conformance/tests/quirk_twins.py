"""Twins made with readings other than the default, and what a run makes of them."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

from family_variants import vary
from small_scratch import small_scratch

from axistwin.catalog import models
from axistwin_conformance.base.ledger import Ledger, load_ledger
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import make_options
from axistwin_conformance.core.profile import as_toml, load_profile
from axistwin_conformance.engine.result import Result
from axistwin_conformance.engine.run import Engine

Readings = Mapping[str, str]


@dataclass(frozen=True)
class QuirkTwins:
    """The twins of a model, one per set of readings.

    `prefix`: what stands before the devices in the twin's URL, `always`: what every twin is made
    with beside the readings.  `hidden`: switches that no probe can tell, with the reason.
    `values`: what to ask of those whose readings are values of the unit's own.
    """

    model: str
    ledger_name: str
    prefix: str
    hidden: Readings
    values: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    always: str = ""

    @cached_property
    def ledger(self) -> Ledger:
        """What the model is judged by."""
        return load_ledger(self.ledger_name)

    @cached_property
    def others(self) -> list[tuple[str, str]]:
        """Every reading other than the default that a probe can tell and the twin can follow."""
        found = []
        for name, quirk in models()[self.model].quirks.items():
            if name in self.ledger.configuration or name in self.hidden:
                continue
            readings = self.ledger.ambiguity_of(name).switches[name]
            others = self.values.get(name, readings[1:])
            found += [(name, one) for one in others if one != "*"]
            assert str(quirk.default) == readings[0], f"{name}: two defaults"
        return found

    def engine_for(
        self,
        query: str,
        *words: str,
        only_detection: bool = False,
        level: str = "quick",
    ) -> Engine:
        """An engine for the built-in twin made with these words in its URL; `words`: what to run
        of the suite, all of it without."""
        options = make_options(
            model=self.model, ids=words, level=level, **small_scratch(self.model)
        )

        def twin_url(model: str, address: int, neighbours: tuple[int, ...]) -> str:
            devices = ",".join(f"{model}:{one}" for one in (address, *neighbours))
            return f"{self.prefix}{devices}?time=virtual{self.always}{query}"

        return Engine(
            replace(
                options,
                family=vary(options.family, twin_url=twin_url),
                is_detection=only_detection,
                is_only_detection=only_detection,
            )
        )

    def detected(self, query: str) -> tuple[Engine, Result]:
        """Detect a twin."""
        engine = self.engine_for(query, only_detection=True)
        return engine, engine.run(lambda event: None)

    def named(self, result: Result) -> dict[str, str]:
        """The readings seen that are not the default."""
        return {
            switch: reading
            for switch, reading in result.readings.items()
            if reading != self.ledger.ambiguity_of(switch).default_of(switch)
        }

    def goes_round(self, readings: Readings, path: Path) -> None:
        """Judge that twin → profile → twin of that profile → profile gives the same twice, with
        just those readings in it."""
        engine, first = self.detected(quirks_query(readings))
        path.write_text(as_toml(self.model, self.ledger, engine.detections, "a unit"), "utf-8")
        assert load_profile(path, self.model, self.ledger) == dict(readings)
        _, second = self.detected(f"&profile={path}")
        assert (first.exit_status, second.exit_status) == (0, 0)
        assert second.readings == first.readings

    def hides_what_it_hides(self) -> None:
        """Judge that of the default twin all is known but what is hidden, each for its reason."""
        engine, result = self.detected("")
        unknown = {one.switch: one.evidence for one in engine.detections if one.reading is None}
        assert set(unknown) == set(self.hidden)
        assert all(self.hidden[switch] in reason for switch, reason in unknown.items())
        assert self.named(result) == {}

    def asks_of_every_switch(self) -> None:
        """Judge that every switch with a second reading has a probe, and no other."""
        probed = {probe.switch for probe in self.engine_for("").family.probes()}
        for ambiguity in self.ledger.ambiguities.values():
            for switch, readings in ambiguity.switches.items():
                is_open = len(readings) > 1 and switch not in self.ledger.configuration
                assert (switch in probed) is is_open, switch

    def conforms_with(self, readings: Readings, level: str, *words: str) -> None:
        """Judge that the twin of these readings conforms, with nothing named but them; where checks
        are named in `words`, those on which they depend."""
        engine = self.engine_for(quirks_query(readings), *words, level=level)
        result = engine.run(lambda event: None)
        failed = [
            (ran.check.name, finding.requirement, finding.expected, finding.actual)
            for ran in result.checks
            for finding in ran.findings
            if finding.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
        ]
        assert failed == []
        unneeded = {probe.switch for probe in engine.plan().unneeded} - self.named(result).keys()
        due = {switch: one for switch, one in readings.items() if switch not in unneeded}
        assert (result.exit_status, self.named(result)) == (0, due)

    def sample(self, count: int, size: int, seed: int) -> list[dict[str, str]]:
        """Sets of readings of `size` different switches, drawn with a seed."""
        draw = random.Random(seed)
        sets: list[dict[str, str]] = []
        while len(sets) < count:
            chosen = dict(draw.sample(self.others, size))
            if len(chosen) == size:
                sets.append(chosen)
        return sets


def quirks_query(readings: Readings) -> str:
    """Those readings as words of a URL."""
    return "".join(f"&quirk.{name}={quote(reading)}" for name, reading in readings.items())
