"""JUnit XML: what build servers make of a run."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import pytest

from axistwin_conformance.report.json import fold
from axistwin_conformance.report.junit import RUN_CASE, junit

# What the JUnit schema of the common build servers knows, with the attributes they read.
CHILDREN = {
    "testsuites": {"testsuite"},
    "testsuite": {"properties", "testcase", "system-out", "system-err"},
    "testcase": {"properties", "skipped", "error", "failure", "system-out", "system-err"},
    "properties": {"property"},
}
REQUIRED = {
    "testsuites": {"name", "tests", "failures", "errors", "time"},
    "testsuite": {"name", "tests", "failures", "errors", "skipped", "time", "timestamp"},
    "testcase": {"name", "classname", "time"},
    "property": {"name", "value"},
    "failure": {"message", "type"},
    "error": {"message", "type"},
    "skipped": {"message"},
}


def cases(wrong_run: list[dict[str, Any]]) -> dict[str, ElementTree.Element]:
    """The test cases of that run by name."""
    root = ElementTree.fromstring(junit(fold(wrong_run)).encode())
    return {case.attrib["name"]: case for case in root.iter("testcase")}


def test_the_document_follows_the_schema_that_build_servers_read(wrong_run: Any) -> None:
    """Only known elements where they are known, each with what is asked of it."""
    root = ElementTree.fromstring(junit(fold(wrong_run)).encode())
    assert root.tag == "testsuites"
    for element in root.iter():
        assert {child.tag for child in element} <= CHILDREN.get(element.tag, set())
        assert set(element.attrib) == REQUIRED.get(element.tag, set())


def test_the_numbers_are_those_of_the_cases(wrong_run: Any) -> None:
    """Tests, failures, errors, skipped."""
    root = ElementTree.fromstring(junit(fold(wrong_run)).encode())
    suite = root[0]
    assert int(suite.attrib["tests"]) == 136 == len(suite.findall("testcase"))
    for attribute, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        assert int(suite.attrib[attribute]) == len(suite.findall(f"testcase/{tag}")) > 0


def test_each_requirement_is_a_case_that_tells_its_ground(wrong_run: Any) -> None:
    """Id, kind, safety class and source are properties; the class is the requirement's group."""
    case = cases(wrong_run)["MACS-FRAME-01"]
    told = {one.attrib["name"]: one.attrib["value"] for one in case.iter("property")}
    assert case.attrib["classname"] == "toy.MACS-FRAME"
    assert told["requirement"] == "MACS-FRAME-01"
    assert (told["kind"], told["safety"], told["source"]) == ("must", "passive", "S II, III")
    assert told["verdict"] == "fail"


@pytest.mark.parametrize(
    ("requirement", "tag", "message"),
    [
        ("MACS-FRAME-01", "failure", "The letter Q: q; expected z or Z."),
        ("MACS-FRAME-03", "error", "3 of 10 times"),
        ("MACS-REPLY-16", "skipped", "recorded, not judged: takes 1 ms"),
        ("MACS-FRAME-04", "skipped", "not on the wire: a rule for the sending host"),
    ],
)
def test_verdicts_become_what_a_build_server_shows(
    wrong_run: Any, requirement: str, tag: str, message: str
) -> None:
    """A failure is a failure, not an error; what was not judged is no success."""
    [element] = [one for one in cases(wrong_run)[requirement] if one.tag != "properties"]
    assert element.tag == tag
    assert message in element.attrib["message"]


def test_a_failure_holds_the_bytes_and_the_command(wrong_run: Any) -> None:
    """What came, what the manual asks and where, exchange, replay."""
    failure = cases(wrong_run)["MACS-FRAME-01"].find("failure")
    assert failure is not None
    text = failure.text or ""
    assert failure.get("message") == "The letter Q: q; expected z or Z."
    assert "expected z or Z" not in text  # build servers show both
    for part in (
        "required: MACS-FRAME-01: A request has exactly 21 bytes",
        "(MAC23/34 V24 expert manual r5 (2006), chapter II, chapter III)",
        "replay: axistwin conform toy --seed 5 _wrong",
        "host     51  the letter Q",
    ):
        assert part in text


def test_passes_and_quirks_pass_and_the_quirk_is_named(wrong_run: Any) -> None:
    """A quirk is another admissible reading."""
    assert [one.tag for one in cases(wrong_run)["MACS-LINE-01"]] == ["properties"]
    out = cases(wrong_run)["MACS-REPLY-01"].find("system-out")
    assert out is not None
    assert "quirk: xon_byte=11h (MACS-AMB-01" in (out.text or "")


def test_a_run_that_cannot_be_trusted_is_red(wrong_run: Any) -> None:
    """An unreachable device would else be a page of skipped cases, which looks green."""
    report = fold(wrong_run)
    assert RUN_CASE not in cases(wrong_run)
    report["finished"] |= {"exit_status": 3, "sentence": "Not judged: nobody is there."}
    root = ElementTree.fromstring(junit(report).encode())
    [error] = root.findall(f"testsuite/testcase[@name='{RUN_CASE}']/error")
    assert error.attrib["message"] == "Not judged: nobody is there."


def test_control_characters_of_a_device_do_not_spoil_the_document(wrong_run: Any) -> None:
    """XML has no way to write them."""
    report = fold(wrong_run)
    [one] = [one for one in report["requirements"] if one["id"] == "MACS-FRAME-03"]
    one["reason"] = "it said \x02\x00 and \ud800"
    [error] = ElementTree.fromstring(junit(report).encode()).findall("testsuite/testcase/error")
    assert error.attrib["message"] == "it said \ufffd\ufffd and \ufffd"


def test_the_times_of_the_cases_are_those_of_the_checks(wrong_run: Any) -> None:
    """A check that judges several requirements is not counted several times."""
    report = fold(wrong_run)
    for check in report["checks"]:
        check["seconds"] = 3.0
    root = ElementTree.fromstring(junit(report).encode())
    total = sum(float(one.attrib["time"]) for one in root.iter("testcase"))
    assert total == pytest.approx(3.0 * len(report["checks"]))


def test_of_several_failures_the_first_is_the_message(wrong_run: Any) -> None:
    """With the number of the others, which the text tells whole."""
    again = [one for one in wrong_run if one.get("name") == "_wrong"]
    at = wrong_run.index(again[-1]) + 1
    more = [{**one, "name": "_wrong_too"} for one in again]
    failure = cases([*wrong_run[:at], *more, *wrong_run[at:]])["MACS-FRAME-01"].find("failure")
    assert failure is not None
    sentence = "The letter Q: q; expected z or Z."
    assert failure.get("message") == f"{sentence} (1 more failure of it below)"
    assert (failure.text or "").count(sentence) == 1
    assert "check: _wrong_too" in (failure.text or "")
