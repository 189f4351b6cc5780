"""Readings of an MN400 that change how everything else is told are detected, and hide nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from quirk_twins import QuirkTwins, Readings, quirks_query

from axistwin_conformance.base.verdicts import Verdict

pytestmark = pytest.mark.strength

TWINS = QuirkTwins(
    model="mn400",
    ledger_name="mn400",
    prefix="axistwin://",
    hidden={"plane_z_check": "at_helix or none"},
)
# What no line shows, with what it takes.
UNPROBED = {
    "reply_transport": "both ports at once",
    "usb_error_form": "a USB port",
    "usb_outcome_codes": "a USB port",
    "output_on_state": "an eye on the outputs",
    "power_on_outputs": "an eye on the outputs",
    "dir_level_positive": "an eye on the direction pins",
    "panel_start": "a stored program: a check tells it",
}
DETECTED: list[dict[str, str]] = [
    {"arc_radius_tol": "2.01"},
    {"backlash_arc": "quadrants"},
    {"dda_phase": "zero"},
    {"dda_phase": "full"},
    {"cc_capacity": "255"},
]
# Readings that other questions have to know of.
IN_THE_WAY: list[dict[str, str]] = [
    {"step_phase": "start"},
    {"limit_halts": "axis"},
    {"limit_halts": "axis", "abort_exit_code": "keep"},
    {"limit_direction": "both"},
    {"nvm_line_overhead": "13"},
]
# Readings in which nearly every reply is another one.
EVERYWHERE: list[dict[str, str]] = [
    {"data_value_encoding": "dot_nul"},
    {"data_value_encoding": "dot_nul", "data_packet_trailer": "00"},
    {"move_abort_use": "while_aborted"},
    {"has_feedhold_cmds": "false"},
    {"retransmit_in_entry": "store"},
    {"hold_takes_arg": "false", "hold_bare_arg": "toggle"},
]


@pytest.mark.parametrize("readings", [*DETECTED, *EVERYWHERE], ids=str)
def test_a_reading_is_detected_written_and_made_again(readings: Readings, tmp_path: Path) -> None:
    """Twin → profile → twin of that profile → the same profile, with just that reading in it."""
    TWINS.goes_round(readings, tmp_path / "unit.toml")


@pytest.mark.parametrize("readings", IN_THE_WAY, ids=str)
def test_one_reading_hides_no_other(readings: Readings) -> None:
    """Every switch is told, or between which readings it is, and no other reading is named."""
    engine, result = TWINS.detected(quirks_query(readings))
    assert [one.switch for one in engine.detections if not one.candidates] == []
    assert TWINS.named(result) == readings


def test_what_cannot_be_known_is_told_with_its_reason() -> None:
    """The default twin: every switch is known but the hidden ones, all of them the default."""
    TWINS.hides_what_it_hides()


def test_every_switch_has_a_probe_or_a_reason_why_not() -> None:
    """Both ways: what has a probe needs no reason."""
    probed = {probe.switch for probe in TWINS.engine_for("").family.probes()}
    switches = {
        switch
        for ambiguity in TWINS.ledger.ambiguities.values()
        for switch, readings in ambiguity.switches.items()
        if len(readings) > 1
    }
    assert switches - probed == UNPROBED.keys()


@pytest.mark.strength(seconds=90)
@pytest.mark.parametrize("readings", EVERYWHERE, ids=str)
def test_what_changes_every_reply_hides_no_requirement(readings: Readings) -> None:
    """The whole suite: nothing fails, and no more is left unjudged than what such a board lacks."""
    engine = TWINS.engine_for(quirks_query(readings), level="full")
    result = engine.run(lambda event: None)
    assert result.exit_status == 0
    assert result.readings.items() >= readings.items()
    shown = [one for one in result.requirements if not one.requirement.not_on_wire]
    judged = [one for one in shown if one.verdict in (Verdict.PASS, Verdict.QUIRK)]
    assert len(judged) >= 0.95 * len(shown)
