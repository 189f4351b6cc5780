"""Every reading a device may follow is detected, written down, made again and conforms."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from axistwin.catalog import models
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.engine import Engine, Result
from axistwin_conformance.errors import UsageError
from axistwin_conformance.ledger import load_ledger
from axistwin_conformance.profile import as_toml, load_profile
from axistwin_conformance.verdicts import Verdict

LEDGER = load_ledger("mac_serial")
Readings = Mapping[str, str]

# Of a twin, not of a manual: `Ledger.configuration`.  And what no probe can tell, with the reason.
HIDDEN = {
    "power_on_at_boot": "it takes a hand on the shaft",
    "position_overflow": "beyond any sensible envelope",
    "encoder_fault_locks": "a MAC23 tells no such fault",
}
# Readings that are values of the unit's own.
VALUES = {
    "boot_time_ms": ("1700", "2300"),
    "imax_value": ("40h",),
    "version_word": ("00000703h",),
    "brake_increments": ("1", "10"),  # 0 is what an ideal plant does
}


def others() -> list[tuple[str, str]]:
    """Every reading other than the default that a probe can tell and the twin can follow."""
    found = []
    for name, quirk in models()["mac23"].quirks.items():
        if name in LEDGER.configuration or name in HIDDEN:
            continue
        readings = LEDGER.ambiguity_of(name).switches[name]
        found += [(name, one) for one in VALUES.get(name, readings[1:]) if one != "*"]
        assert str(quirk.default) == readings[0], f"{name}: two defaults"
    return found


OTHERS = others()
IDS = [f"{name}={reading}" for name, reading in OTHERS]


def engine_for(query: str, *, only_detection: bool = False, level: str = "quick") -> Engine:
    """An engine for the built-in twin made with these words in its URL."""
    options = make_options(model="mac23", level=level)

    def twin_url(model: str, address: int, neighbours: tuple[int, ...]) -> str:
        devices = ",".join(f"{model}:{one}" for one in (address, *neighbours))
        return f"axistwin://{devices}?time=virtual{query}"

    family = replace(options.family, twin_url=twin_url)
    return Engine(
        replace(
            options, family=family, is_detection=only_detection, is_only_detection=only_detection
        )
    )


def quirks_query(readings: Readings) -> str:
    """Those readings as words of a URL."""
    return "".join(f"&quirk.{name}={reading}" for name, reading in readings.items())


def named(result: Result) -> dict[str, str]:
    """The readings seen that are not the default."""
    return {
        switch: reading
        for switch, reading in result.readings.items()
        if reading != LEDGER.ambiguity_of(switch).default_of(switch)
    }


def detected(query: str) -> tuple[Engine, Result]:
    """Detect a twin."""
    engine = engine_for(query, only_detection=True)
    return engine, engine.run(lambda event: None)


@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_reading_is_detected_written_and_made_again(
    switch: str, reading: str, tmp_path: Path
) -> None:
    """Twin → profile → twin of that profile → the same profile, with just that reading in it."""
    engine, first = detected(quirks_query({switch: reading}))
    path = tmp_path / "unit.toml"
    path.write_text(as_toml("mac23", LEDGER, engine.detections, "a unit"), "utf-8")
    assert load_profile(path, "mac23", LEDGER) == {switch: reading}
    _, second = detected(f"&profile={path}")
    assert (first.exit_status, second.exit_status) == (0, 0)
    assert second.readings == first.readings


def test_what_cannot_be_known_is_told_with_its_reason() -> None:
    """The default twin: every switch is known but the hidden ones, all of them the default."""
    engine, result = detected("")
    unknown = {one.switch: one.evidence for one in engine.detections if one.reading is None}
    assert set(unknown) == set(HIDDEN)
    assert all(HIDDEN[switch] in reason for switch, reason in unknown.items())
    assert named(result) == {}


def test_every_switch_of_the_ledger_has_a_probe_or_no_second_reading() -> None:
    """One place per switch; what has none is configuration, or has nothing to tell apart."""
    probed = {probe.switch for probe in engine_for("").family.probes()}
    for ambiguity in LEDGER.ambiguities.values():
        for switch, readings in ambiguity.switches.items():
            is_open = len(readings) > 1 and switch not in LEDGER.configuration
            assert (switch in probed) is is_open, switch


def conforms_with(readings: Readings, level: str) -> None:
    """Judge the twin that follows these readings: nothing but them is named."""
    result = engine_for(quirks_query(readings), level=level).run(lambda event: None)
    failed = [
        (ran.check.name, finding.requirement, finding.expected, finding.actual)
        for ran in result.checks
        for finding in ran.findings
        if finding.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
    ]
    assert failed == []
    assert (result.exit_status, named(result)) == (0, dict(readings))


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_twin_of_each_reading_conforms_with_that_quirk_named(switch: str, reading: str) -> None:
    """Doubt has a name: another reading is neither failed nor overlooked, at level quick."""
    conforms_with({switch: reading}, "quick")


def sample(count: int, size: int, seed: int) -> list[dict[str, str]]:
    """Sets of readings of `size` different switches, drawn with a seed."""
    draw = random.Random(seed)
    sets: list[dict[str, str]] = []
    while len(sets) < count:
        chosen = dict(draw.sample(OTHERS, size))
        if len(chosen) == size:
            sets.append(chosen)
    return sets


@pytest.mark.soak
@pytest.mark.parametrize("readings", sample(4, 1, seed=3), ids=str)
def test_a_sample_conforms_at_full_too(readings: Readings) -> None:
    """The whole suite on a twin of another reading."""
    conforms_with(readings, "full")


@pytest.mark.parametrize("readings", [{"brake_increments": "100"}, {"nack_scope": "any"}], ids=str)
def test_what_lasts_longer_than_its_reply_is_waited_for(readings: Readings) -> None:
    """An axis that runs on after 18h, and Nacks of all modules, one behind the other: at full."""
    conforms_with(readings, "full")


def test_a_profile_that_no_longer_fits_fails(tmp_path: Path) -> None:
    """A quirk that does not show any more is a failure of the quirk file, and told by its name."""
    path = tmp_path / "unit.toml"
    path.write_text('model = "mac23"\n[quirks]\nxon_byte = "11h"\n', "utf-8")
    result = CliRunner().invoke(conform, ["mac23", "--profile", str(path), "MACS-LINE-02"])
    assert result.exit_code == 1
    assert "xon_byte is 1Ah, the profile says 11h" in " ".join(result.output.split())


def test_a_reading_the_profile_does_not_name_is_a_deviation(tmp_path: Path) -> None:
    """What a profile leaves out is expected to be the default."""
    path = tmp_path / "unit.toml"
    path.write_text('model = "mac23"\n[quirks]\n', "utf-8")
    url = "axistwin://mac23:0?time=virtual&quirk.xon_byte=11h"
    words = ["mac23", "--port", url, "--profile", str(path), "MACS-LINE-02"]
    assert CliRunner().invoke(conform, words).exit_code == 1
    words = ["mac23", "--port", url, "MACS-LINE-02"]
    assert CliRunner().invoke(conform, words).exit_code == 0


def test_detect_alone_judges_nothing_and_writes_the_profile(tmp_path: Path) -> None:
    """--detect without ID and level: identity and detection only; exit 0."""
    path = tmp_path / "unit.toml"
    url = "axistwin://mac23:0?time=virtual&quirk.zero_catchup=refuse"
    words = ["mac23", "--port", url, "--allow", "stored", "--detect", str(path)]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 0
    assert "zero_catchup=refuse" in result.output
    text = path.read_text("utf-8")
    assert load_profile(path, "mac23", LEDGER) == {"zero_catchup": "refuse"}
    assert '# xon_byte = "1Ah"  # MACS-AMB-01' in text  # confirmed, and why
    assert "# ramp_law: MACS-AMB-42: not allowed: motion (--allow motion)" in text


def test_detection_does_no_more_than_the_checks_asked_for() -> None:
    """Without --detect, a passive selection is preceded by passive questions only."""
    words = make_options(model="mac23", ids=("MACS-LINE-02",))
    plan = Engine(words).plan()
    assert {name for probe in plan.probes for name in probe.check.safety} == {"passive"}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('model = "mac34-1"\n', "is of a mac34-1"),
        ("[quirks]\nxon_bite = 1\n", "did you mean xon_byte?"),
        ('[quirks]\nxon_byte = "12h"\n', "write 1Ah or 11h"),
        ("[quirks\n", "is not TOML"),
        ("quirks = 3\n", "a table of name = value"),
    ],
)
def test_a_profile_that_cannot_be_meant_is_refused_in_one_line(
    text: str, complaint: str, tmp_path: Path
) -> None:
    """The line names the file, what is wrong, and what could be written."""
    path = tmp_path / "unit.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(UsageError, match=complaint.replace("?", r"\?")) as caught:
        load_profile(path, "mac23", LEDGER)
    assert "\n" not in str(caught.value)


def test_configuration_in_a_profile_is_passed_over(tmp_path: Path) -> None:
    """Factory values make a twin; nobody is judged by them."""
    path = tmp_path / "unit.toml"
    path.write_text("[quirks]\nfactory_ramp = 3\nabort_flush = false\n", "utf-8")
    assert load_profile(path, "mac23", LEDGER) == {"abort_flush": "false"}


@pytest.mark.soak
@pytest.mark.parametrize("readings", sample(5, 3, seed=11), ids=str)
def test_three_readings_at_once_conform_with_those_three_named(readings: Readings) -> None:
    """A device that differs in three ways is told in three names."""
    conforms_with(readings, "quick")
