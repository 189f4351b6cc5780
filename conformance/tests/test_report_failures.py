"""Failures of one cause are one block, in every form of the report."""

from __future__ import annotations

from typing import Any

import pytest

from axistwin_conformance.report.failures import Failed, failed

RULES = {
    "A-01": {"text": "It answers.", "where": "the manual", "source": "", "kind": "derived"},
    "A-02": {"text": "It obeys.", "where": "", "source": "none: our definition", "kind": "must"},
    "A-03": {
        "text": "It stops.",
        "where": "another; not in this device's own manual",
        "source": "",
        "kind": "must",
    },
}


def finding(requirement: str, sentence: str, *said: str, **more: Any) -> dict[str, Any]:
    """What a check found, with what was said on the wire: first by the host, then by the device."""
    records = [
        {"time_ns": number, "direction": who, "data": data, "decoded": "", "text": ""}
        for number, (who, data) in enumerate(zip(("host", "device"), said, strict=False))
    ]
    return {
        "requirement": requirement, "verdict": "fail", "text": "", "sentence": sentence,
        "transcript": records, "decisive": list(range(len(records))), **more,
    }  # fmt: skip


def check(name: str, *findings: dict[str, Any]) -> dict[str, Any]:
    """A check that has failed."""
    return {"name": name, "verdict": "fail", "trouble": "", "findings": list(findings)}


def names(groups: list[Failed]) -> list[list[str]]:
    """The names of the checks, group by group."""
    return [[one.check["name"] for one in (group, *group.also)] for group in groups]


FIRST = finding("A-01", "After 13h, 20h read 7; expected 9.", "01 02", "03 04")


@pytest.mark.parametrize(
    "other",
    [
        finding("A-02", "Something else.", "01 02", "03 04"),
        finding("A-01", "Something else.", "01 02", "03 05"),
        finding("A-02", "After 13h, 20h read -88.5; expected 1000.", "01 02", "03 05"),
    ],
    ids=["exchange", "requirement", "sentence"],
)
def test_failures_that_have_one_thing_in_common_are_one_block(other: dict[str, Any]) -> None:
    """The exchange, the requirement that decides, or the sentence apart from its numbers."""
    alone = finding("A-03", "Not that.", "01 03", "03 04")
    groups = failed([check("first", FIRST), check("alone", alone), check("other", other)])
    assert names(groups) == [["first", "other"], ["alone"]]


@pytest.mark.parametrize(
    "other",
    [
        finding("A-02", "After 14h, 20h read 7; expected 9.", "01 02", "03 05"),
        finding("A-02", "Something else."),
    ],
    ids=["another command", "no exchange"],
)
def test_failures_that_have_nothing_in_common_stay_apart(other: dict[str, Any]) -> None:
    """The number of a command is no number, and two that show no exchange do not show the same."""
    silent = finding("A-03", "Nothing was said.")
    groups = failed([check("first", FIRST), check("silent", silent), check("other", other)])
    assert names(groups) == [["first"], ["silent"], ["other"]]


def test_what_is_open_is_never_in_the_block_of_a_failure() -> None:
    """Its verdict is another one."""
    unsettled = check("open", {**FIRST, "verdict": "inconclusive"}) | {"verdict": "inconclusive"}
    assert names(failed([check("first", FIRST), unsettled])) == [["first"], ["open"]]


def test_what_is_required_says_on_what_ground() -> None:
    """Stated, concluded, taken over from another device, or the suite's own."""
    found = [finding(name, "It did not.") for name in RULES]
    [group] = failed([check("first", *found)])
    assert [str(one) for one in group.found[0].required(RULES)] == [
        "A-01: It answers. (the manual; concluded from what is said there)",
        "A-02: It obeys. (a rule of the suite; the manual does not cover it)",
        "A-03: It stops. (another; not in this device's own manual; taken to hold for it as well)",
    ]
    assert group.requirements == ["A-01", "A-02", "A-03"]


@pytest.mark.parametrize(
    ("requirement", "rule", "whose"),
    [
        ("A-01", "", "concluded from the manual"),
        ("A-02", "", "demanded by this suite only"),
        ("A-03", "", "concluded from the manual of another device"),
        ("A-04", "", "the manual demands"),
        ("A-04", "It stops, so it stands.", "concluded from the manual"),
        (
            "A-04",
            "The manual leaves this open.",
            "the manual leaves it open; demanded by this suite",
        ),
    ],
)
def test_a_failure_says_whose_rule_was_broken(requirement: str, rule: str, whose: str) -> None:
    """Of the requirement that decides, which comes first."""
    rules = {**RULES, "A-04": {**RULES["A-03"], "where": "the manual"}}
    found = [finding(name, "It did not.", rule=rule) for name in (requirement, "A-02")]
    [group] = failed([check("first", *found)])
    assert group.found[0].whose(rules) == whose


def test_a_rule_that_was_applied_takes_the_place_of_the_requirements_text() -> None:
    """Of the requirement that decides; the others keep theirs."""
    left_open = "The manual leaves this open. Each time the same."
    found = [finding(name, "It did not.", rule=left_open) for name in ("A-02", "A-01")]
    [group] = failed([check("first", *found)])
    first, second = (str(one) for one in group.found[0].required(RULES))
    assert first == f"A-02: {left_open} (a rule of the suite; the manual does not cover it)"
    assert second.startswith("A-01: It answers. (")
