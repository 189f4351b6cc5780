"""JUnit XML from a report: one test case per requirement, for the test page of a build server.

    verdict         becomes                 because
    pass, quirk     a passed test case      a quirk's name is its output
    fail            <failure>
    inconclusive    <error>                 neither success nor failure may be claimed
    not run, info   <skipped>               a value only recorded is no success either

With `--profile`, "the profile" is a test case, too: a device that is not what its profile says has
failed, whatever its requirements came to.

A run that cannot be trusted as a whole (device unreachable, interrupted, not put back) has one more
test case, "the run itself", with an error: a page of skipped cases alone would look green.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from axistwin_conformance.base.errors import counted
from axistwin_conformance.report.by_hand import in_lines
from axistwin_conformance.report.failures import REQUIRED, statements
from axistwin_conformance.report.json import Report

UNTRUSTED = (2, 3, 130)  # exit statuses: nothing judged, unreachable, interrupted
RUN_CASE = "the run itself"
PROFILE_CASE = "the profile"
ELEMENTS = {
    "fail": "failure",
    "inconclusive": "error",
    "not run": "skipped",
    "info": "skipped",
}

SUITE_PROPERTIES = (
    "suite_version", "model", "target", "carrier", "baud", "bitrate", "address", "level", "seed",
    "command",
)  # fmt: skip

# What XML 1.0 cannot hold, not even escaped.
UNSPEAKABLE = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit(report: Report) -> str:
    """Return the XML of a report."""
    run, finished = report["run"], report["finished"]
    name = f"axistwin conform {run['model']}"
    cases = [_case(report, one) for one in report["requirements"]]
    if report.get("profile"):
        cases.append(_profile_case(report))
    if finished["problems"] or finished["exit_status"] in UNTRUSTED:
        cases.append(_run_case(report))
    kinds = Counter(element.tag for case in cases for element in case)
    numbers = {
        "tests": str(len(cases)),
        "failures": str(kinds["failure"]),
        "errors": str(kinds["error"]),
        "skipped": str(kinds["skipped"]),
        "time": f"{finished['seconds']:.3f}",
    }
    # The schema knows no count of skipped cases up here.
    told = {key: value for key, value in numbers.items() if key != "skipped"}
    root = ElementTree.Element("testsuites", {"name": name, **told})
    # The schema wants a time without zone; it is UTC.
    suite = _element(root, "testsuite", name=name, timestamp=run["started_at"][:19], **numbers)
    _properties(suite, dict(_suite_properties(report)))
    suite.extend(cases)
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + _xml(root) + "\n"


def _suite_properties(report: Report) -> Iterator[tuple[str, str]]:
    run = report["run"]
    for key in SUITE_PROPERTIES:
        if run[key] is not None:
            yield key, str(run[key])
    yield "device", report["device"].get("summary", "")
    for key, value in report["device"].get("values", {}).items():
        yield f"device.{key}", value
    for one in report["readings"]:
        yield f"reading.{one['switch']}", one["reading"]


def _case(report: Report, judged: Mapping[str, Any]) -> ElementTree.Element:
    key, verdict, reason = judged["id"], judged["verdict"], judged["reason"]
    family = key.rpartition("-")[0]
    case = ElementTree.Element(
        "testcase",
        classname=f"{report['run']['model']}.{family}",
        name=key,
        time=f"{_seconds(report, key):.3f}",
    )
    told = {
        "requirement": key,
        "kind": judged["kind"],
        "safety": " ".join(judged["safety"]),
        "source": judged["source"],
        "verdict": verdict,
        "checks": " ".join(judged["checks"]),
    }
    if judged["armed"] is not None:
        told["armed"] = " ".join(judged["armed"])
    _properties(case, told)
    if verdict in ELEMENTS:
        words = f"recorded, not judged: {reason}" if verdict == "info" else reason
        element = _element(case, ELEMENTS[verdict], message=words)
        if ELEMENTS[verdict] != "skipped":
            element.set("type", verdict)
            _put_evidence(element, judged, report)
    elif reason:
        _element(case, "system-out").text = f"{verdict}: {reason}"
    return case


def _seconds(report: Report, key: str) -> float:
    """The time of its checks, shared among all the requirements they judge: the sum is right."""
    return sum(
        (
            check["seconds"] / len(check["requirements"])
            for check in report["checks"]
            if key in check["requirements"]
        ),
        0.0,
    )


def _put_evidence(element: ElementTree.Element, judged: Mapping[str, Any], report: Report) -> None:
    """What was seen, what is required, the exchange, and the command that does it again, check by
    check.  What the first one has seen is the message, which build servers show above the text."""
    known = {one["id"]: one for one in report["requirements"]}
    found = [
        (check, one)
        for check in report["checks"]
        for one in statements(check)
        if judged["id"] in one.requirements and one.verdict == judged["verdict"]
    ]
    if found[1:] and judged["verdict"] == "fail":
        others = counted(len(found) - 1, "more failure")
        element.set("message", f"{found[0][1].sentence} ({others} of it below)")
    lines: list[str] = []
    for number, (check, one) in enumerate(found):
        lines += ["", one.sentence] if number else []
        lines += [f"rule: {one.whose(known)}"] if one.verdict == "fail" else []
        lines += [f"{REQUIRED}: {each}" for each in one.required(known)]
        lines += [f"remark: {one.remark}"] if one.remark else []
        lines += [f"check: {check['name']}", f"replay: {check['replay']}"]
        lines += in_lines(report["run"], one)
        lines += transcript_lines(one.transcript)
    element.text = "\n".join(lines)


def transcript_lines(records: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """The records as lines: ms from the first one, who, hex, decoded."""
    for record in records:
        time_ms = (record["time_ns"] - records[0]["time_ns"]) / 1e6
        words = f"{record['data']}  {record['decoded']}" if record["data"] else record["text"]
        who = "" if record["direction"] == "note" else record["direction"]
        yield f"{time_ms:12.3f}  {who:7}  {words}"


def _profile_case(report: Report) -> ElementTree.Element:
    run, judged = report["run"], report["profile"]
    case = ElementTree.Element("testcase", classname=run["model"], name=PROFILE_CASE, time="0.000")
    _properties(case, {"profile": judged["profile"], "verdict": judged["verdict"]})
    if judged["verdict"] not in ELEMENTS:
        _element(case, "system-out").text = f"{judged['verdict']}: {judged['reason']}"
        return case
    element = _element(case, ELEMENTS[judged["verdict"]], message=judged["reason"])
    if judged["departures"]:
        element.set("type", judged["verdict"])
        lines = [f"asked: the readings of {judged['profile']}"]
        for one in judged["departures"]:
            lines += [
                "",
                f"switch: {one['switch']} ({one['ambiguity']}: {one['question']})",
                f"expected: {one['expected']}",
                f"found: {' or '.join(one['found'])}",
                f"evidence: {one['evidence']}",
            ]
        element.text = "\n".join([*lines, "", f"replay: {run['command']}"])
    return case


def _run_case(report: Report) -> ElementTree.Element:
    run, finished = report["run"], report["finished"]
    case = ElementTree.Element("testcase", classname=run["model"], name=RUN_CASE, time="0.000")
    element = _element(case, "error", message=finished["sentence"], type="run")
    element.text = "\n".join([*finished["problems"], f"replay: {run['command']}"])
    return case


def _element(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _properties(parent: ElementTree.Element, values: Mapping[str, str]) -> None:
    holder = _element(parent, "properties")
    for name, value in values.items():
        _element(holder, "property", name=name, value=value)


def _xml(root: ElementTree.Element) -> str:
    for element in root.iter():
        element.attrib = {key: _speakable(value) for key, value in element.attrib.items()}
        element.text = element.text and _speakable(element.text)
    return ElementTree.tostring(root, encoding="unicode")


def _speakable(text: str) -> str:
    return UNSPEAKABLE.sub("\ufffd", text)
