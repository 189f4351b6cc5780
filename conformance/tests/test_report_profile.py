"""A device that is not what its profile says is red wherever a run is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result

from axistwin_conformance.cli import conform
from axistwin_conformance.families.mac.axis.exchanges import signed
from axistwin_conformance.families.mac.serial import codec
from axistwin_conformance.families.mac.serial.codec import SerialReply
from axistwin_conformance.report.json import Report, load
from axistwin_conformance.report.junit import PROFILE_CASE, junit

WORDS = ("mac23", "MACS-LINE-02", "MACS-FRAME-01", "reply28_length")
DEPARTS = 'model = "mac23"\n[quirks]\nxon_byte = "11h"\nreply28_length = "014"\n'
HOLDS = 'model = "mac23"\n[quirks]\nxon_byte = "1Ah"\nramp_law = "equal_increments"\n'


def judge(folder: Path, profile: str | None) -> Result:
    """A run on the default twin, passive, with its report in `folder`."""
    folder.mkdir()
    more: list[str] = []
    if profile is not None:
        (folder / "unit.toml").write_text(profile, "utf-8")
        more = ["--profile", str(folder / "unit.toml")]
    words = [*WORDS, "--allow", "passive", *more, "--report", str(folder)]
    return CliRunner().invoke(conform, words)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Reports of the same twin without a profile, with one that it holds, with one it does not."""
    base = tmp_path_factory.mktemp("runs")
    exits = {"none": 0, "holds": 0, "departs": 1}
    profiles = {"none": None, "holds": HOLDS, "departs": DEPARTS}
    for name, status in exits.items():
        result = judge(base / name, profiles[name])
        assert result.exit_code == status, result.output
    return {name: base / name for name in exits}


def report_of(folder: Path) -> Report:
    """The report there."""
    return load(folder / "report.json")


def profile_case(folder: Path) -> tuple[ElementTree.Element, ElementTree.Element]:
    """The suite and its case of the profile."""
    suite = ElementTree.parse(folder / "junit.xml").getroot()[0]
    (case,) = (one for one in suite.iter("testcase") if one.attrib["name"] == PROFILE_CASE)
    return suite, case


def test_junit_has_a_failed_case_that_names_every_reading(folders: dict[str, Path]) -> None:
    """Expected and found, switch by switch; the numbers of the suite count it."""
    suite, case = profile_case(folders["departs"])
    failure = case.find("failure")
    assert failure is not None
    assert failure.text is not None
    assert suite.attrib["failures"] == "1"
    for switch, expected, found in (("xon_byte", "11h", "1Ah"), ("reply28_length", "014", "011")):
        assert f"{switch} is {found}, the profile says {expected}" in failure.attrib["message"]
        _, _, told = failure.text.partition(f"switch: {switch} (MACS-AMB-")
        assert told.splitlines()[1:3] == [f"expected: {expected}", f"found: {found}"]


def test_a_profile_that_holds_is_a_passed_case_which_names_what_was_not_seen(
    folders: dict[str, Path],
) -> None:
    """Green, but the switch that nobody may ask for without motion is no success."""
    suite, case = profile_case(folders["holds"])
    told = case.findtext("system-out") or ""
    assert suite.attrib["failures"] == "0"
    assert "all as it says" in told
    assert "not seen: ramp_law" in told


def test_without_a_profile_nothing_is_said_of_one(folders: dict[str, Path]) -> None:
    """No case, no event, no row."""
    report = report_of(folders["none"])
    assert report["profile"] == {}
    assert PROFILE_CASE not in junit(report)
    assert 'id="row-profile"' not in (folders["none"] / "report.html").read_text("utf-8")


def test_the_stream_and_the_counts_tell_it(folders: dict[str, Path]) -> None:
    """One event with expected and found; a failure is counted."""
    lines = (folders["departs"] / "events.jsonl").read_text("utf-8").splitlines()
    told: list[dict[str, Any]] = [json.loads(line) for line in lines]
    (judged,) = (one for one in told if one["event"] == "profile_judged")
    assert judged["verdict"] == "fail"
    assert judged["profile"] == str(folders["departs"] / "unit.toml")
    found = {one["switch"]: (one["expected"], one["found"]) for one in judged["departures"]}
    assert found == {"xon_byte": ("11h", ["1Ah"]), "reply28_length": ("014", ["011"])}
    assert told[-1]["counts"]["fail"] == 1
    held = report_of(folders["holds"])
    assert held["profile"]["unseen"] == ["ramp_law"]
    assert held["finished"]["counts"]["fail"] == 0


@pytest.mark.parametrize(("old", "was"), [("none", "not run"), ("holds", "pass")])
def test_a_comparison_names_the_profile_and_exits_1(
    folders: dict[str, Path], old: str, was: str
) -> None:
    """Switch by switch, for the worse; the other profile is named as a difference."""
    words = ["--compare", str(folders[old]), str(folders["departs"])]
    words = [f"{one}/report.json" if one != "--compare" else one for one in words]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 1
    assert f"profile xon_byte  {was} → fail: expected 11h, found 1Ah" in result.output
    assert "note: not the same profile: " in result.output
    assert "2 verdicts changed, 2 for the worse." in result.output


def test_a_comparison_of_the_same_departures_has_no_change(folders: dict[str, Path]) -> None:
    """What was wrong before is no news."""
    path = str(folders["departs"] / "report.json")
    result = CliRunner().invoke(conform, ["--compare", path, path])
    assert (result.exit_code, result.output) == (0, "No verdict changed.\n")


def test_a_comparison_back_is_for_the_better(folders: dict[str, Path]) -> None:
    """Failed before, as the profile says now."""
    paths = [str(folders[name] / "report.json") for name in ("departs", "none")]
    result = CliRunner().invoke(conform, ["--compare", *paths])
    assert result.exit_code == 0
    assert "profile xon_byte  fail → not run: the run was held to no profile" in result.output


def test_a_report_of_a_former_version_can_be_compared(
    folders: dict[str, Path], tmp_path: Path
) -> None:
    """It has no word of profiles at all."""
    old = report_of(folders["none"])
    del old["profile"]
    (tmp_path / "old.json").write_text(json.dumps(old), "utf-8")
    words = ["--compare", str(tmp_path / "old.json"), str(folders["departs"] / "report.json")]
    assert CliRunner().invoke(conform, words).exit_code == 1


def test_the_page_is_red_at_its_top_and_leads_to_the_readings(folders: dict[str, Path]) -> None:
    """Banner, an article with expected and found, a red row to click."""
    text = (folders["departs"] / "report.html").read_text("utf-8")
    head, _, body = text.partition('<section id="requirements">')
    assert '<div class="banner fail">' in head
    assert 'aria-label="1 fail, ' in head
    assert '<tr id="row-profile" class="fail">' in body
    article = head.partition('<article id="profile" class="fail">')[2].partition("</article>")[0]
    for cells in ("<td>11h</td><td>1Ah</td>", "<td>014</td><td>011</td>"):
        assert cells in article


def test_the_terminal_names_expected_and_found(tmp_path: Path) -> None:
    """Beside the closing sentence, which stands alone."""
    result = judge(tmp_path / "run", DEPARTS)
    assert "  xon_byte  expected 11h, found 1Ah\n" in result.output
    assert "1 fail · " in result.output


def test_failed_requirements_do_not_hide_the_profile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A device that is wrong in both ways is told so in one sentence."""

    def parse(data: bytes) -> SerialReply:
        reply = sound(data)
        if reply.digit != 0 or reply.data is None or signed(reply.data) <= 50:
            return reply
        return replace(reply, data=reply.data + 7)

    sound = codec.parse
    monkeypatch.setattr(codec, "parse", parse)
    (tmp_path / "unit.toml").write_text(DEPARTS, "utf-8")
    words = ["mac23", "MACS-CMD-13-01", "--profile", str(tmp_path / "unit.toml")]
    result = CliRunner().invoke(conform, words)
    last = result.output.splitlines()[-1]
    assert result.exit_code == 1
    assert "requirements judged; nor is it what its profile says: xon_byte is 1Ah" in last
