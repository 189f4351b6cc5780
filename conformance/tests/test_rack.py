"""What `scripts/run` prints at its end: one table for all twins, and what failed."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.report.json import fold

RACK = Path(__file__).parents[2] / "scripts" / "rack.py"


def rack_script() -> Any:
    """The script, as a module."""
    spec = importlib.util.spec_from_file_location("rack", RACK)
    assert spec is not None
    assert spec.loader is not None
    rack = sys.modules["rack"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(rack)
    return rack


def verdicts(*found: tuple[tuple[str, ...], Any]) -> list[str]:
    """The lines."""
    rack = rack_script()
    lines: list[str] = rack.verdicts(found)
    assert len(lines) <= rack.MOST_LINES - rack.LINES_AROUND
    assert max(map(len, lines)) <= rack.WIDTH
    return lines


def test_a_wrong_twin_is_told_with_what_failed_and_how_to_see_it_again(wrong_run: Any) -> None:
    """Its sentences, and its command."""
    report = fold(wrong_run)
    lines = verdicts((("conform", "toy", "--port", "./toy"), report))
    counts = report["finished"]["counts"]
    assert lines[0].split() == ["twin", "verdict", "judged", "failed", "inconclusive", "seconds"]
    assert lines[1].startswith("toy   does not conform")
    assert f"  {counts['fail']}  " in lines[1]
    text = " ".join(" ".join(lines).split())
    assert "_wrong: The letter Q: q; expected z or Z." in text
    assert "again: axistwin conform toy --port ./toy" in text
    assert "judged: pass, fail or quirk" in text


def test_many_failures_of_many_twins_stay_within_forty_lines(wrong_run: Any) -> None:
    """What finds no room is counted."""
    report = fold(wrong_run)
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    first = check["findings"][0]
    check["findings"] = [first | {"sentence": f"Sentence {n}. " * 20} for n in range(30)]
    for twins in (4, 5):
        found = [(("conform", f"toy-{n}", "--level", "quick " * 20), report) for n in range(twins)]
        lines = verdicts(*found)
        assert sum(line.startswith("  and ") or "failures" in line for line in lines) == twins
        assert [f"toy-{n}:" in lines for n in range(twins)] == [True] * twins


def test_each_of_a_few_failures_of_one_twin_is_told(wrong_run: Any) -> None:
    """A long one leaves room for the others, and a short one leaves it to them."""
    report = fold(wrong_run)
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    first = check["findings"][0]
    sentences = ("It went on. " * 100, "It stopped.", "It turned. " * 100)
    check["findings"] = [first | {"sentence": sentence} for sentence in sentences]
    lines = verdicts((("conform", "toy"), report))
    ends = [line for line in lines if line.endswith(" …")]
    assert len(ends) == 2
    assert "  _wrong: It stopped." in lines
    turned = [line for line in lines if "It turned." in line]
    assert len(turned) > sum("It went on." in line for line in lines)
    assert not any("more" in line for line in lines[-5:])


def test_the_first_failure_is_told_however_long_it_is(wrong_run: Any) -> None:
    """As far as there is room."""
    report = fold(wrong_run)
    [check] = [one for one in report["checks"] if one["name"] == "_wrong"]
    first = check["findings"][0]
    check["findings"] = [first | {"sentence": "It went on. " * 200}]
    lines = verdicts((("conform", "toy"), report), (("conform", "other"), report))
    assert sum("_wrong: It went on." in line for line in lines) == 2
    assert sum(line.endswith(" …") for line in lines) == 2


def test_a_twin_without_a_report_is_told_with_its_last_words() -> None:
    """It may have crashed."""
    lines = verdicts((("conform", "toy"), "first\nsecond\nthird\nlast"))
    assert lines[1].split() == ["toy", "no", "verdict"]
    assert lines[-1].strip() == "last"
    assert "first" not in " ".join(lines)


def test_a_fault_is_planted_in_the_twin_that_is_named() -> None:
    """Where only a part is judged, what the fault breaks is judged too."""
    rack = rack_script()
    places = rack.with_fault("msc-250:a_flag_above_255_can_be_written")
    [place] = [place for place in places if place.fault]
    assert place.judged == "msc-250"
    assert "zoo_msc" in place.serving()
    assert set(rack.OF_THE_MSC) < set(place.ids)
    [place] = [place for place in rack.with_fault("mac23:a_move_is_never_busy") if place.fault]
    assert (place.judged, place.ids) == ("mac23", ())


@pytest.mark.parametrize(
    ("told", "remedy"),
    [
        ("a_move_is_never_busy", "write TWIN:FAULT; TWIN is one of mac23, "),
        ("mac23:moves_are_never_busy", "did you mean .*a_move_is_never_busy"),
        ("mn400:%", "see conformance/tests/zoo_mn400"),
    ],
)
def test_a_fault_that_is_unknown_says_the_remedy(told: str, remedy: str) -> None:
    """One line."""
    with pytest.raises(ValueError, match=remedy) as raised:
        rack_script().with_fault(told)
    assert "\n" not in str(raised.value)


@pytest.mark.system
@pytest.mark.strength(seconds=40)
def test_with_one_wrong_twin_all_is_told_in_forty_lines_of_eighty_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Every twin on its port, judged at the same time; of each a few requirements."""
    rack = rack_script()
    few = {
        "mac": ("MACS-FRAME-03", "MACS-FRAME-04"),
        "mac34": ("MACS-FRAME-03", "MACS-FRAME-04"),
        "mac-can": ("MACC-Q-00",),
        "msc": ("MSC-RQSTAT",),
        "mn400": ("MN4-CMD-FW",),
    }
    places = tuple(replace(place, ids=few[place.link[2:]]) for place in rack.PLACES)
    monkeypatch.setattr(rack, "PLACES", places)
    monkeypatch.chdir(tmp_path)
    fault = "mac23:numbers_are_parsed_by_a_library"
    monkeypatch.setattr(sys, "argv", ["scripts/run", "--once", "--fault", fault])
    assert rack.main() == 1
    lines = capfd.readouterr().out.splitlines()
    assert len(lines) <= rack.MOST_LINES
    assert max(map(len, lines)) <= rack.WIDTH
    rows = {line.split()[0]: line for line in lines if "conform" in line and "  " in line[3:]}
    assert "does not conform" in rows["mac23"]
    assert all("  conforms  " in rows[place.judged] for place in places[1:])
    # On a busy machine not each check that sees it comes to a verdict.
    names = [
        check.name
        for check in find_family("mac23").checks()
        if not {"MACS-FRAME-03", "MACS-FRAME-04"}.isdisjoint(check.requirements)
    ]
    assert any(name in line for line in lines for name in names), lines
