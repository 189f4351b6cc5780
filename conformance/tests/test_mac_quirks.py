"""A twin that follows another reading is named by the suite, not failed (only tests see both)."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from click.testing import CliRunner

from axistwin.devices.mac.axis.stops import Stops
from axistwin_conformance.cli import conform

pytestmark = pytest.mark.strength

ALLOWED = ("--allow", "motion,stored,destructive")

# switch, reading, the check that has to notice
SEEN = [
    ("xon_byte", "11h", "xoff_and_xon_arrive_as_bytes_of_the_reply"),
    ("xonerror_byte", "18h", "refusals_change_nothing"),
    ("status_reply_digit", "2", "every_answer_has_the_form_of_the_manual"),
    ("reply23_digit", "2", "every_answer_has_the_form_of_the_manual"),
    ("reply28_length", "014", "every_answer_has_the_form_of_the_manual"),
    ("bad_frame_reply", "nack", "another_length_field_drops_the_frame"),
    ("lowercase_hex", "accept", "digits_are_read_in_upper_case"),
    ("subindex_policy", "refuse", "the_sub_index_matters_only_to_memory_queries"),
    ("dont_care_digits", "refuse", "digits_printed_x_have_no_effect_in_commands"),
    ("unknown_index", "accept", "unassigned_commands_are_refused"),
    ("unknown_index", "silence", "queries_end_at_29h"),
    ("unknown_index", "zero_answer", "unassigned_indices_are_refused_in_every_state"),
    ("param_range_policy", "mask", "values_outside_the_printed_sets_are_refused"),
    ("general_echo", "own_address", "the_general_address_is_answered_by_module_00"),
    ("addr_prog_requires_ff", "true", "addresses_from_80_up_are_refused"),
    ("addr_effective", "at_restart", "the_address_can_be_programmed"),
    ("addr_range", "mask", "addresses_from_80_up_are_refused"),
    ("reset_reply", "silence", "after_00h_it_is_deaf_for_two_seconds"),
    ("baud_reply_rate", "new", "the_rate_can_be_programmed"),
    ("factory_reset_scope", "no_restart", "a_factory_reset_brings_the_factory_values"),
    ("persist_modes", "volatile", "after_00h_parameters_and_position_are_kept"),
    ("cmd_1b_supported", "false", "the_rate_can_be_programmed"),
    ("cmd_1c_supported", "false", "the_tolerance_reads_back"),
    ("motion_lock_set", "serial_list", "the_period_is_locked_in_motion"),
    ("preload_locks", "true", "a_preloaded_move_waits_for_11h"),
    ("torque_range", "exclusive", "the_torque_limit_ends_at_imax"),
    ("torque_over", "clamp", "the_torque_limit_ends_at_imax"),
    ("torque_over", "mask", "the_torque_limit_ends_at_imax"),
    ("zero_period_0d", "as_one", "a_period_of_zero_is_no_period"),
    ("zero_catchup", "refuse", "the_catch_up_speed_reads_back"),
    ("catchup_low_byte", "refuse", "the_catch_up_speed_reads_back"),
    ("ramp_law", "equal_increments", "the_ramp_has_120_increments_per_unit"),
    ("vel_f6_direction", "positive", "f6_turns_counter_clockwise"),
    ("vel_reverse_cmd", "refuse", "the_direction_stays_whatever_the_next_15h_says"),
    ("vel_during_position", "refuse", "velocity_takes_over_from_a_move"),
    ("vel_during_interp", "refuse", "velocity_takes_over_from_a_segment"),
    ("vel_change_law", "constant_acceleration", "a_speed_change_takes_one_ramp"),
    ("vel_change_law", "step", "a_speed_change_takes_one_ramp"),
    ("stop_ramp_law", "ramp_length", "a_ramped_stop_on_the_ramp_descends_what_was_climbed"),
    ("busy_after_abort", "true", "a_hard_stop_stops_where_the_axis_is"),
    ("sync_without_preload", "refuse", "without_a_preloaded_motion_11h_moves_nothing"),
    ("sync_arm_lifetime", "lost", "arming_in_motion_concerns_the_next_motion"),
    ("arm_after_segment", "lost", "segments_are_not_held_by_10h"),
    ("busy_after_17h", "true", "a_ramped_stop_in_full_motion_takes_one_ramp"),
    ("preload_policy", "refuse", "a_second_motion_replaces_the_preloaded_one"),
    ("preload_policy", "keep", "stops_and_power_off_drop_a_preloaded_motion"),
    ("armed_zero_velocity", "spend", "velocity_0_while_armed_at_rest"),
    ("armed_zero_velocity", "refuse", "velocity_0_while_armed_at_rest"),
    ("sync_during_interp", "now", "a_preloaded_move_started_during_segments"),
    ("sync_during_interp", "drop", "a_preloaded_move_started_during_segments"),
    ("fifo_counts_executing", "true", "the_fifo_has_three_stages"),
    ("segment_signed", "false", "segment_steps_are_signed"),
    ("segment_zero_period", "fastest", "segments_of_zero_period_or_zero_steps"),
    ("segment_zero_period", "65536", "segments_of_zero_period_or_zero_steps"),
    ("segment_zero_steps", "65536", "segments_of_zero_period_or_zero_steps"),
    ("fifo_underrun", "decelerate", "when_the_fifo_runs_empty_the_axis_rests"),
    ("fifo_underrun", "error", "when_the_fifo_runs_empty_the_axis_rests"),
    ("interp_during_profile", "refuse", "segments_sent_during_a_move"),
    ("interp_during_profile", "preempt", "segments_sent_during_a_move"),
    ("stop17_in_interp", "refuse", "a_ramped_stop_does_not_interrupt_segments"),
    ("stop17_in_interp", "after_segment", "a_ramped_stop_does_not_interrupt_segments"),
    ("stop17_in_interp", "now", "a_ramped_stop_does_not_interrupt_segments"),
    ("soft_stop_compare", "equal", "beyond_a_software_stop_every_motion_ends"),
    ("soft_stop_blocks", "both", "from_beyond_a_software_stop_one_can_return"),
    ("ff_lifetime", "live", "the_stop_bit_stays_until_the_next_motion"),
    ("ff_lifetime", "until_reset", "the_stop_bit_stays_until_the_next_motion"),
    ("status_ff_layout", "shifted", "beyond_a_software_stop_every_motion_ends"),
    ("reset_in_motion", "remaining", "clearing_the_counter_during_a_move"),
    ("target_range", "accept", "targets_beyond_the_counter_are_refused"),
]


def judge(quirk: str, *words: str, devices: str = "mac23:0") -> tuple[int, list[dict[str, Any]]]:
    """Judge a twin with one quirk, in virtual time; give the exit status and all findings."""
    url = f"axistwin://{devices}?time=virtual&quirk.{quirk}"
    result = CliRunner().invoke(conform, ["mac23", "--port", url, *ALLOWED, *words, "--json"])
    events = [json.loads(line) for line in result.stdout.splitlines()]
    findings = [
        finding for one in events if one["event"] == "check_finished" for finding in one["findings"]
    ]
    return result.exit_code, findings


@pytest.mark.parametrize(
    ("switch", "reading", "check"), SEEN, ids=[f"{one[0]}={one[1]}" for one in SEEN]
)
def test_another_reading_is_named_and_not_failed(switch: str, reading: str, check: str) -> None:
    """The check that looks at an ambiguity records the reading the twin follows."""
    status, findings = judge(f"{switch}={reading}", check)
    quirks = [one["text"] for one in findings if one["verdict"] == "quirk"]
    failed = [one for one in findings if one["verdict"] == "fail"]
    assert any(text.startswith(f"{switch}={reading}") for text in quirks), findings
    assert (status, failed) == (0, [])


@pytest.mark.parametrize("latency_us", [125, 685])
def test_a_reply_that_comes_at_once_collides_with_no_byte_sent_before_it(latency_us: int) -> None:
    """What is sent at a request's heels ends before this device replies, or nothing is judged."""
    _, findings = judge(
        f"reply_latency_us={latency_us}", "what_comes_during_a_reply_is_kept_or_lost"
    )
    told = {one["verdict"] for one in findings}
    assert told <= ({"quirk", "pass"} if latency_us > 300 else {"not run"}), findings
    assert told, findings


@pytest.mark.parametrize("latency_ms", [60, 150, 300])
def test_a_device_that_takes_long_to_reply_is_listened_to_for_as_long(latency_ms: int) -> None:
    """Its replies are no silence, and what it does meanwhile is no other reading."""
    names = (
        "xoff_and_xon_arrive_as_bytes_of_the_reply", "refusals_change_nothing",
        "queries_end_at_29h", "the_fifo_has_three_stages", "the_stops_mode_is_locked_in_motion",
        "opening_the_reference_contact_zeroes_the_counter",
        "just_after_two_seconds_it_listens",
    )  # fmt: skip
    status, findings = judge(
        f"reply_latency_us={latency_ms}000", *names, "--allow", f"{ALLOWED[1]},rig"
    )
    bad = [one for one in findings if one["verdict"] in ("fail", "inconclusive")]
    assert (bad, status) == ([], 0)


@pytest.mark.parametrize(
    ("quirks", "names"),
    [
        # at 450 ms no sample is sharp enough to tell inertia, and no fixed wait is long enough
        (
            {"reply_latency_us": "450000", "plant": "inertial"},
            (
                "noise_through_a_reply_does_not_deafen_it", "in_motion_00h_drops_the_motion",
                "a_software_stop_drops_the_stored_segments",
            ),
        ),
        # nor is any motion or deafness of a fixed length
        (
            {"reply_latency_us": "450000", "busy_after_abort": "true", "reset_reply": "silence"},
            (
                "a_hard_stop_stops_where_the_axis_is", "the_rate_can_be_programmed",
                "a_factory_reset_brings_the_factory_values",
                "the_counter_is_cleared_in_velocity_motion",
                "segments_that_turn_round_end_on_the_stop_they_meet_first",
                "a_move_whose_counter_is_cleared_on_the_ramp_keeps_to_it",
                "a_move_whose_counter_is_cleared_while_it_lags_ends_where_it_should",
            ),
        ),
        # a ramp is as much slower as replies take longer; what cannot be told apart is not played
        (
            {"reply_latency_us": "450000", "stop_ramp_law": "ramp_length"},
            (
                "some_mixed_sequences_agree_with_the_model",
                "a_ramped_stop_while_slowing_down_changes_nothing",
            ),
        ),
        (
            {"reply_latency_us": "450000", "ramp_law": "equal_increments"},
            ("some_mixed_sequences_agree_with_the_model",),
        ),
        (
            {"reply_latency_us": "450000", "vel_change_law": "constant_acceleration"},
            ("many_mixed_sequences_agree_with_the_model",),
        ),
        # a ramp of equal increments takes longer, and so does a stop that goes down all of it
        (
            {"ramp_law": "equal_increments", "stop_ramp_law": "ramp_length"},
            (
                "a_ramped_stop_in_full_motion_takes_one_ramp",
                "a_ramped_stop_on_the_ramp_descends_what_was_climbed",
                "a_hard_stop_stops_where_the_axis_is",
            ),
        ),
        # so slow a module takes what comes behind the move: no command may then move it back
        (
            {"reply_latency_us": "450000", "cmd_1b_supported": "false"},
            ("queries_disturb_nothing",),
        ),
        # whether an increment counts when it begins cannot be told by one that takes longer
        (
            {"reply_latency_us": "152162", "step_phase": "start"},
            ("some_mixed_sequences_agree_with_the_model",),
        ),
        # a move is as much slower as it takes longer to look where the reference clears its counter
        (
            {"reply_latency_us": "152162", "ref_retarget": "remaining"},
            ("a_zeroed_move_ends_at_its_target_by_the_new_count",),
        ),
        # nor can it be told any more what an axis on its last increments to its target refuses
        (
            {"reply_latency_us": "152162", "running_until": "exact"},
            ("a_held_axis_is_busy_until_it_is_near_its_target",),
        ),
        # what is left of a torque above Imax may be above it, too
        (
            {"torque_over": "mask", "imax_value": "104"},
            ("the_torque_limit_ends_at_imax",),
        ),
        # what a restart brings may be what was written
        (
            {"persist_modes": "volatile", "factory_stops": "8"},
            ("some_mixed_sequences_agree_with_the_model",),
        ),
        # ones that mean nothing beside those that mean a stop, or an over-voltage
        (
            {"reserved_bits": "1", "status_ff_layout": "shifted", "status_hh_bit": "6-0"},
            (
                "the_stop_bit_stays_until_the_next_motion", "an_over_voltage_is_remembered",
                "the_status_of_a_sound_module_shows_no_fault",
            ),
        ),
    ],
    ids=[
        "late", "later", "late stop", "late ramp", "late change", "long ramps", "late query",
        "late step", "late edge", "late end", "masked", "kept", "ones",
    ],
)  # fmt: skip
def test_two_readings_do_not_hide_one_another(
    quirks: dict[str, str], names: tuple[str, ...]
) -> None:
    """Each by itself is read rightly; so they are together."""
    query = "&quirk.".join(f"{name}={reading}" for name, reading in quirks.items())
    status, findings = judge(query, *names, "--allow", f"{ALLOWED[1]},rig")
    bad = [one for one in findings if one["verdict"] in ("fail", "inconclusive")]
    assert (bad, status) == ([], 0)


def test_speed_changes_are_not_judged_by_a_law_that_nothing_tells() -> None:
    """At 450 ms a change in one step looks like one on a ramp."""
    status, findings = judge(
        "reply_latency_us=450000&quirk.vel_change_law=step", "speed_changes_follow_the_closed_form"
    )
    told = {(one["verdict"], one["text"]) for one in findings}
    reason = "its replies take too long to tell by which law it changes speeds and stops"
    assert (told, status) == ({("not run", reason)}, 2)


@pytest.mark.parametrize("reading", ["fifo_underrun=error", "cmd_1c_supported=false"])
def test_what_is_refused_in_another_reading_is_no_failure_of_a_reply(reading: str) -> None:
    """A segment after a single one, where the store errs when it is empty; or 1Ch."""
    status, findings = judge(reading, "nothing_follows_an_acceptance")
    assert {one["verdict"] for one in findings if one["requirement"]} == {"pass"}, findings
    assert status == 0


def test_modules_that_all_reply_at_once_are_let_finish_before_the_next_frame() -> None:
    """Replies of several to one frame garble one another; what is sent meanwhile, nobody hears."""
    status, findings = judge(
        "general_reply_policy=all", "general_commands_are_executed_by_all", "--neighbour", "1",
        devices="mac23:0,mac23:1",
    )  # fmt: skip
    assert {one["verdict"] for one in findings if one["requirement"] == "MACS-MULTI-02"} == {"pass"}
    assert status == 0


def told_of(quirk: str, check: str) -> dict[str, Any]:
    """The failure of that check on a twin with one quirk."""
    return next(one for one in judge(quirk, check)[1] if one["verdict"] == "fail")


@pytest.mark.parametrize(
    ("boot_time_ms", "begin"),
    [
        (900, r"20h \(position\), sent 9\d\d ms .*was answered; expected no .* less than 1500 ms"),
        (3500, r"No query sent less than 35\d\d ms .*was answered; expected an .* sent 2500 ms"),
    ],
)
def test_a_start_of_the_wrong_length_is_told_by_the_query_that_shows_it(
    boot_time_ms: int, begin: str
) -> None:
    """One that is answered too early, or those that are not."""
    found = told_of(f"boot_time_ms={boot_time_ms}", "after_00h_it_is_deaf_for_two_seconds")
    assert re.match(begin, found["sentence"])


@pytest.mark.parametrize("reading", ["strict", "equal"])
def test_how_far_a_stop_was_overrun_is_one_number(
    reading: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the sentence, and above the exchange that shows it, where it can be counted."""
    stands = Stops._first_forbidden
    monkeypatch.setattr(
        Stops, "_first_forbidden", lambda stops, way: stands(stops, way) - 2 * (way < 0)
    )
    found = told_of(
        f"soft_stop_compare={reading}&quirk.brake_increments=5",
        "beyond_a_software_stop_every_motion_ends",
    )
    lines = [f"{one['text']} {one['decoded']}" for one in found["transcript"]]
    earlier = " ".join(lines[: lines.index("in this check: ")])
    [stop] = re.findall(r"superior software stop (\d+)", earlier)
    *_, place = re.findall(r"(\d+) increments", earlier)
    beyond = f"{int(place) - int(stop)} increments beyond the superior"
    assert f"earlier in this run {beyond}" in found["sentence"]
    assert f"came to rest {beyond}" in earlier
