"""The suite and the twin of the MAC23 on CAN meet on the bus: only tests may see both."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import pytest
from click.testing import CliRunner

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.ledger import load_ledger
from axistwin_conformance.cli import conform
from axistwin_conformance.families.catalog import find_family
from axistwin_conformance.transport.can import CanTransport
from axistwin_conformance.transport.can_frame import Frame

pytestmark = pytest.mark.strength

FAMILY, LEDGER = find_family("mac23-can"), load_ledger("mac_can")
TWIN = "axistwin:mac23-can:1,mac23-can:3?time=virtual"
# 08h and 1Bh, which act on the serial line, are unassigned here (MACC-CMD-XX-01).
ACTING = {*range(0x04), 0x09, 0x0A, *range(0x0C, 0x11), *range(0x13, 0x1B), 0x1C, 0x1E}
SERIAL_ONLY = ("MACS-LINE", "MACS-CMD-08", "MACS-CMD-1B", "MACS-Q-28", "MACS-Q-29")


def run(*words: str) -> tuple[int, list[dict[str, Any]]]:
    """Type a command; return its exit status and its events."""
    result = CliRunner().invoke(conform, ["mac23-can", *words, "--json"])
    return result.exit_code, [json.loads(line) for line in result.stdout.splitlines()]


def of_kind(events: Iterable[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    """The events of one kind."""
    return [one for one in events if one["event"] == kind]


def troubles(events: Iterable[dict[str, Any]]) -> list[tuple[str, ...]]:
    """What stands in the way of a plain pass, check by check."""
    return [
        (one["name"], finding["requirement"], finding["verdict"], finding["text"])
        for one in of_kind(events, "check_finished")
        for finding in one["findings"]
        if finding["verdict"] in ("fail", "inconclusive", "quirk")
        or finding["text"] == "the check ended without judging it"
    ]


def shared_checks() -> list[Check]:
    """The checks that the family takes over from the axis."""
    return [one for one in FAMILY.checks() if one.shared]


@pytest.mark.parametrize("level", ["quick", "full"])
def test_the_built_in_twin_conforms_and_every_check_judges_what_it_names(level: str) -> None:
    """Default readings on both sides: two readings of one manual agree in all that was judged."""
    status, events = run("--level", level)
    assert troubles(events) == []
    assert status == 0, events[-1]
    ran = set(of_kind(events, "run_started")[0]["checks"])
    wanted = {key for one in FAMILY.checks() if one.name in ran for key in one.requirements}
    judged = of_kind(events, "requirement_judged")
    assert wanted - {one["id"] for one in judged if one["verdict"] == "pass"} == set()
    shown = {key for one in FAMILY.checks() for key in one.requirements}
    told = {key for key, one in LEDGER.requirements.items() if one.not_on_wire}
    assert level != "full" or {one["id"] for one in judged if one["verdict"] == "not run"} <= (
        (set(LEDGER.requirements) - shown) | told
    )


def test_a_twin_with_three_other_readings_of_the_axis_conforms_with_them_named() -> None:
    """What the manual of the axis leaves open is no fault on this face either."""
    quirks = {
        "motion_lock_set": "serial_list",
        "ramp_law": "equal_increments",
        "ff_lifetime": "live",
    }
    options = "".join(f"&quirk.{switch}={reading}" for switch, reading in quirks.items())
    words = ("--can", TWIN + options, "--neighbour", "3", "--allow", "motion,stored,rig")
    status, events = run(*words, "--level", "quick")
    assert status == 0, troubles(events)
    seen = {one["switch"]: one["reading"] for one in of_kind(events, "reading_seen")}
    assert quirks.items() <= seen.items()
    named = " ".join(one["reason"] for one in of_kind(events, "requirement_judged"))
    for switch, reading in quirks.items():
        assert f"{switch}={reading} (MACS-AMB" in named


def test_what_the_axis_is_judged_by_on_the_line_judges_it_on_the_bus_too() -> None:
    """Every shared check is taken over, and every probe of a question that both ask."""
    serial = find_family("mac23")
    on_axis = {one.name for one in serial.checks() if ".mac.axis." in one.module}
    assert {one.name for one in shared_checks()} == on_axis
    asked = {one.switch for one in serial.probes() if LEDGER.asks(one.switch)}
    assert {one.switch for one in serial.probes()} - asked
    shared = {one.switch for one in serial.probes() if ".mac.axis." in one.check.module}
    assert shared & asked <= {one.switch for one in FAMILY.probes()}
    assert all(LEDGER.asks(one.switch) for one in FAMILY.probes())


def test_a_check_taken_over_keeps_the_names_it_was_written_with() -> None:
    """And judges by those of this family."""
    one = next(one for one in shared_checks() if one.name == "the_period_is_locked_in_motion")
    assert one.requirements == ("MACC-CMD-0D-01", "MACC-STATE-01")
    assert one.declared == ("MACS-CMD-0D-02", "MACS-STATE-01")
    serial = {other.name: other for other in find_family("mac23").checks()}
    assert serial[one.name].requirements == serial[one.name].declared == one.declared


def test_nothing_that_is_the_serial_line_s_own_is_covered_by_a_requirement_here() -> None:
    """Address, rate and memory reading are not on this bus."""
    assert [key for key in LEDGER.covering if key.startswith(SERIAL_ONLY)] == []


def test_a_passive_run_sends_no_frame_that_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    """What goes to a bus without --allow: nothing that moves or is stored, and no address."""
    sent: list[Frame] = []
    plain = CanTransport.send

    def spy(target: CanTransport, frame: Frame) -> int:
        sent.append(frame)
        return plain(target, frame)

    monkeypatch.setattr(CanTransport, "send", spy)
    status, events = run("--can", TWIN, "--neighbour", "3")
    assert (status, troubles(events)) == (0, [])
    assert len(sent) > 50
    downloads = {
        frame.data[1]
        for frame in sent
        if frame.is_plain and frame.identifier & 0x780 == 0x600 and frame.length == 8
        and frame.data[0] == 0x23 and frame.data[2] == 0x20
    }  # fmt: skip
    assert downloads & ACTING == set()
    assert 0x7E5 not in {frame.identifier for frame in sent}


def test_the_same_seed_gives_the_same_frames_at_the_same_times(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Everything is replayable on the bus too."""
    sent: list[tuple[int, bytes]] = []
    plain = CanTransport.send

    def spy(target: CanTransport, frame: Frame) -> int:
        sent.append((target.now_ns, frame.pack()))
        return plain(target, frame)

    monkeypatch.setattr(CanTransport, "send", spy)

    def frames(seed: int) -> list[tuple[int, bytes]]:
        sent.clear()
        status, _ = run("--seed", str(seed), "segments_follow_one_another_without_a_gap")
        assert status == 0
        return list(sent)

    assert frames(7) == frames(7)
    assert frames(7) != frames(8)


@pytest.mark.strength(seconds=15)
@pytest.mark.parametrize(("travel", "speed"), [(300, 3000), (3000, 10_000)])
def test_behind_the_fence_the_twin_conforms_in_what_is_left(travel: int, speed: int) -> None:
    """Nothing fails for being held back, all is put back, and what needs more says how much."""
    status, events = run("--max-travel", str(travel), "--max-speed", str(speed))
    assert troubles(events) == []
    assert (status, events[-1]["problems"]) == (0, [])
    judged = of_kind(events, "requirement_judged")
    left = [one for one in judged if one["verdict"] == "not run"]
    assert len(left) < len(judged) // 20, [one["reason"] for one in left]
    assert all("needs --max-" in one["reason"] for one in left)
