"""The checks and probes of the MN400 that move axes, on its twin: a sound one passes each of them,
a wrong one fails."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from mn400_board import LEDGER
from mn400_twin import EVERYTHING, URL, AlteredTwin, failures, judged, session_of

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.engine.run import Engine
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.options import make_options
from axistwin_conformance.report.html import render
from axistwin_conformance.report.json import event_object, fold
from axistwin_conformance.report.plot import is_on_path
from axistwin_conformance.transport.rig import Act, TwinRig
from axistwin_conformance.transport.serial import SerialTransport

FAMILY = Mn400()
MODULES = ("moves", "circles", "contours", "pauses", "backlash", "measuring", "rig_limits",
           "rig_pulses", "rig_jog")  # fmt: skip
CHECKS = {
    one.name: one for one in FAMILY.checks() if one.module.rpartition(".")[2] in MODULES
}  # fmt: skip
PROBES = [one for one in FAMILY.probes() if one.check.module.endswith("probes.motion")]
Make = Callable[[], AlteredTwin]


def hears(*changes: tuple[str, str]) -> Make:
    """A twin that takes one text for another; what ends with * begins so, and its rest is kept."""

    def heard(text: str) -> str:
        for old, new in changes:
            if old.endswith("*") and text.startswith(old[:-1]):
                return new.replace("*", text[len(old) - 1 :])
            if text == old:
                return new
        return text

    return lambda: AlteredTwin(heard)


def is_read_as(**quirks: str) -> Make:
    """A twin of another reading, which nobody has asked for."""
    return lambda: AlteredTwin(quirks=quirks)


def says(command: str, change: Callable[[list[int]], list[int]]) -> Make:
    """A twin that tells other numbers."""

    def said(raw: bytes) -> bytes:
        packet = codec.parse(raw)
        if packet is None or packet.command != command or not packet.fields:
            return raw
        told = ",".join(map(str, change(list(packet.fields))))
        return codec.data(packet.board, command, told, packet.trailer)

    return lambda: AlteredTwin(says=said)


def replies(command: str, code: int) -> Make:
    """A twin that says another code than DONE to a command."""

    def said(raw: bytes) -> bytes:
        packet = codec.parse(raw)
        is_done = packet is not None and packet.command == command and packet.code == 5
        return codec.status(1, command, code) if is_done else raw

    return lambda: AlteredTwin(says=said)


@pytest.mark.strength
@pytest.mark.parametrize("name", CHECKS)
def test_a_sound_twin_passes(name: str) -> None:
    """Every requirement that the check names is judged."""
    found = judged(CHECKS[name])
    verdicts = {one.requirement: one.verdict for one in found}
    assert verdicts == dict.fromkeys(CHECKS[name].requirements, Verdict.PASS)


# Of each check a wrong twin, and a requirement that it fails.
WRONG: dict[str, tuple[Make, str]] = {
    "moves_end_where_they_are_sent": (hears(("M,,300", "M,,301")), "MN4-CMD-M-02"),
    "coordinates_are_those_of_the_mode": (hears(("I1", "I0")), "MN4-CMD-M-02"),
    "moves_take_the_time_of_their_profile": (hears(("V1500", "V1450")), "MN4-CMD-V-01"),
    "speed_is_that_of_the_axis_that_goes_farthest": (hears(("X4", "V1900")), "MN4-MOT-01"),
    "what_another_board_is_told_moves_nothing": (hears(("B60,60,0,0", "B0,0,0,0")), "MN4-PKT-06"),
    "an_arc_may_be_of_a_large_circle": (hears(("V500", "V900")), "MN4-ARC-04"),
    "a_multiplex_leaves_every_motion_its_time": (hears(("X4", "V700")), "MN4-MOT-05"),
    "long_moves_keep_their_proportion": (
        hears(("M20000,-6667,19998,20", "M20000,-6667,19990,20")), "MN4-CMD-M-02",
    ),
    "the_slowest_and_the_fastest_rate_are_kept": (hears(("V2", "V3")), "MN4-MOT-02"),
    "a_move_keeps_the_settings_of_its_time": (hears(("I1", "|")), "MN4-CMD-I-04"),
    "what_is_refused_moves_nothing": (lambda: AlteredTwin(ignores_sums=True), "MN4-PKT-05"),
    "what_is_refused_sets_nothing": (hears(("V200000", "V2000")), "MN4-ERR-02"),
    "what_a_setting_leaves_out_is_as_it_was": (hears(("F700", "F700,5000")), "MN4-PAR-09"),
    "a_positive_speed_ends_external_sync": (hears(("V2000", "V1900")), "MN4-SYN-02"),
    "arcs_run_on_their_circle": (hears(("A400,0,400,400,1", "A400,0,400,400,-1")), "MN4-ARC-01"),
    "a_clockwise_half_circle_goes_below": (
        hears(("A-500,0,-1000,0,1", "A-500,0,-1000,0,-1")), "MN4-ARC-05",
    ),
    "arcs_run_in_the_plane_that_was_set": (hears(("P4,1,2", "P1,4,2")), "MN4-CMD-P-01"),
    "the_angle_says_how_far_an_arc_goes": (
        hears(("A-60,-80,-1,-2,1", "A-60,-80,-1,-2,-1")), "MN4-ARC-01",
    ),
    "an_arc_that_waits_begins_where_what_is_before_it_ends": (
        hears(("A160,-80,122,-80,-1", "A160,-80,122,-80,1")), "MN4-CMD-A-02",
    ),
    "an_arc_to_its_start_is_a_full_circle": (is_read_as(arc_zero_sweep="none"), "MN4-ARC-06"),
    "radii_must_agree": (hears(("A-100,0,-50,0,1", "A-100,0,-200,0,1")), "MN4-CMD-A-04"),
    "arcs_have_no_ramps": (is_read_as(arc_ramp="true"), "MN4-MOT-13"),
    "helices_turn_and_traverse": (hears(("+-100,0,-200,0,1,40,0", "+-100,0,-200,0,1,-40,0")),
                                  "MN4-CMD-HEL-02"),
    "a_long_helix_keeps_its_proportion": (
        hears(("+-500,0,-1000,0,1,-900,28", "+-500,0,-1000,0,1,-850,28")), "MN4-HEL-02",
    ),
    "the_traverse_is_a_distance_in_both_modes": (
        hears(("+0,100,-100,100,1,-70,1", "+0,100,-100,100,1,-120,1")), "MN4-HEL-03",
    ),
    "a_helix_to_its_start_turns_once_more": (is_read_as(helix_zero_final="none"), "MN4-HEL-04"),
    "a_helix_that_cannot_be_is_refused": (
        hears(("+-10,0,-20,0,1,5,-1", "+-10,0,-20,0,1,5,1")), "MN4-HEL-05",
    ),
    "the_longest_request_is_served": (replies("+", 0x15), "MN4-PKT-13"),
    "the_example_takes_the_time_of_its_margin": (hears(("(50", "(")), "MN4-CC-04"),
    "a_contour_waits_until_it_is_closed": (hears(("(", "|")), "MN4-CMD-CC-02"),
    "a_contour_that_waits_begins_where_what_is_before_it_ends": (
        hears(("M280,-20", "M270,-20")), "MN4-CC-01",
    ),
    "a_straight_way_in_pieces_takes_no_longer": (
        hears(("M200,-100", "M200,-101")), "MN4-CC-02",
    ),
    "a_corner_is_taken_at_start_speed": (is_read_as(cc_corner_speed="margin"), "MN4-CC-07"),
    "every_segment_keeps_its_own_speed": (hears(("V800", "V3000")), "MN4-CC-06"),
    "a_contour_is_no_slower_than_separate_moves": (hears(("V3000", "V900")), "MN4-CC-09"),
    "a_contour_has_room_for_256_segments": (hears(("M,,1", "M,,2")), "MN4-CC-01"),
    "a_running_contour_can_be_paused_and_quit": (hears(("}", "|")), "MN4-CMD-CC-06"),
    "a_move_stands_where_it_is_paused": (is_read_as(pause_decel="false"), "MN4-PAU-01"),
    "pauses_anywhere_lose_no_step": (hears(("}", "Q")), "MN4-PAU-03"),
    "pauses_end_as_they_should": (is_read_as(pause_idle="latch"), "MN4-CMD-PAU-04"),
    "a_pause_ends_before_the_axes_stand": (hears(("}", "|")), "MN4-CMD-PAU-02"),
    "a_pause_makes_no_step": (hears(("M2", "M3")), "MN4-CMD-N-01"),
    "a_resume_without_a_pause_changes_nothing": (hears(("}", "Q")), "MN4-CMD-PAU-04"),
    "what_is_set_in_a_pause_is_for_later_moves": (hears(("}", "|")), "MN4-CMD-V-05"),
    "quit_stops_and_forgets": (is_read_as(quit_flushes_queue="false"), "MN4-CMD-Q-02"),
    "quit_leaves_nothing_of_what_it_drops": (hears(("M40,0,20", "M40,0,21")), "MN4-QUIT-02"),
    "reads_in_motion_tell_of_the_present": (says("/", lambda told: [2]), "MN4-CMD-EXIT-02"),
    "a_turn_costs_the_steps_of_the_backlash": (hears(("D-1,1,1,1", "D1,1,1,1")), "MN4-CMD-D-02"),
    "a_move_begins_from_rest_behind_its_compensation": (
        hears(("B100*", "B150*")), "MN4-BKL-01"),
    "a_contour_begins_from_rest_behind_its_compensation": (
        hears(("B100*", "B150*")), "MN4-BKL-07"),
    "a_pause_in_the_compensation_loses_none_of_it": (
        hears(("B60,0,0,0", "B80,0,0,0")), "MN4-BKL-01"),
    "the_memory_is_of_the_last_motion": (hears(("L5,5,5,5", "D1,-1,1,1")), "MN4-CMD-L-03"),
    "what_quit_drops_is_not_remembered": (
        hears(("M40,40,40,40", "M40,40,40,41")), "MN4-BKL-02"),
    "arcs_and_contours_are_compensated_before_they_begin": (
        hears(("A-300,-300,-600,-600,1", "A-300,-300,-600,-600,-1")), "MN4-BKL-06",
    ),
    "a_measurement_counts_ticks": (hears(("X4", "X2")), "MN4-CMD-E-03"),
    "a_measurement_counts_what_is_left_of_a_move": (
        hears(("M500,-167", "M480,-167")), "MN4-MEA-01"),
    "a_limit_ends_what_moves_towards_it": (says("/", lambda told: [told[0] ^ 3]),
                                           "MN4-CMD-EXIT-01"),
    "a_limit_meets_an_arc_where_it_turns_round": (says("/", lambda told: [told[0] ^ 3]),
                                                  "MN4-CMD-EXIT-01"),
    "a_limit_that_is_on_holds_back_its_direction_alone": (
        is_read_as(multi_limit_exit="first"), "MN4-LIM-05",
    ),
    "aux_inputs_are_shown_and_stop_nothing": (is_read_as(limit_status_signed="true"),
                                              "MN4-CMD-S-02"),
    "without_feed_hold_the_shield_aborts": (hears((";0", ";1")), "MN4-SHD-01"),
    "with_feed_hold_the_shield_pauses": (hears((";1", ";0")), "MN4-SHD-02"),
    "a_threading_move_follows_its_pulses": (
        hears(("T100,-53,0,7,400,10", "T100,-53,0,7,380,10")), "MN4-THR-02",
    ),
    "a_thread_keeps_step_with_its_spindle": (
        hears(("T100,-53,0,7,1000,0", "T100,-53,0,7,1050,0")), "MN4-THR-01"),
    "a_thread_waits_for_a_spindle_that_stands": (
        hears(("T100,-53,0,7,2000", "T100,-53,0,7,1500")), "MN4-THR-01"),
    "a_move_waits_for_the_last_pulse_of_a_thread": (hears(("M0,50", "M0,51")), "MN4-STM-01"),
    "threading_knows_no_speed": (hears(("Q", "|")), "MN4-CMD-T-03"),
    "threading_waits_and_bounds_its_steps": (hears(("T100,0,0,0,200", "M100")), "MN4-CMD-T-03"),
    "at_a_negative_speed_pulses_pace_every_move": (hears(("V-1", "V500")), "MN4-CMD-V-02"),
    "a_contour_waits_for_the_pulses_of_a_segment": (hears(("V-1", "V500")), "MN4-CMD-V-02"),
    "taps_move_in_jog_mode_alone": (hears(("J0", "J1")), "MN4-JOG-07"),
    "taps_add_up_to_whole_steps": (hears(("G10,10,10,10,8", "G10,10,10,10,9")), "MN4-JOG-03"),
    "a_held_input_runs_at_the_jog_speed": (hears(("Y400", "Y440")), "MN4-JOG-05"),
    "jogging_turns_only_the_axis_that_it_moves": (
        hears(("D-1,-1,-1,-1", "D1,1,1,1")), "MN4-BKL-02"),
}  # fmt: skip
# Checks of what the manual leaves open: another behaviour is told and fails nobody.
OPEN: dict[str, Make] = {
    "counters_go_round": hears(("M20,-20", "M19,-20")),
    "steps_left_of_an_arc_are_those_to_its_end": is_read_as(readcount_arc="path"),
    "a_contour_has_room_for_256_segments": is_read_as(cc_capacity="100"),
    "a_pause_in_the_compensation_loses_none_of_it": says("N", lambda told: [-60, 0, 0, 0]),
    "quit_in_the_compensation_leaves_the_whole_move": hears(("B*", "B0,0,0,0")),
    "a_measurement_disturbs_nothing": is_read_as(measure_position_sample="start"),
}


@pytest.mark.strength
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_twin_fails(name: str) -> None:
    """By the requirement that it breaks, among others perhaps."""
    make, requirement = WRONG[name]
    assert requirement in failures(CHECKS[name], make())


@pytest.mark.strength
@pytest.mark.parametrize("name", OPEN)
def test_another_choice_than_the_usual_is_told(name: str) -> None:
    """And nothing fails by it."""
    verdicts = {one.verdict for one in judged(CHECKS[name], OPEN[name]())}
    assert Verdict.INFO in verdicts
    assert Verdict.FAIL not in verdicts


class DeafRig(TwinRig):
    """A rig whose limits and shield are not connected."""

    def _work(self, act: Act) -> None:
        if act.control.capability not in ("limit_plus", "shield"):
            super()._work(act)


def test_a_board_that_jogs_on_past_a_limit_fails() -> None:
    """As one without that wire does."""
    port: Any = AlteredTwin()
    session = session_of(port)
    rig = DeafRig(session.transport, 1, FAMILY.rig_controls)
    check = CHECKS["limits_and_shield_end_jogging"]
    assert "MN4-JOG-08" in failures(check, port, target=session.transport, rig=rig)


def test_every_check_has_a_wrong_twin() -> None:
    """Of those of motion none is without."""
    assert {*WRONG, *OPEN, "limits_and_shield_end_jogging"} == {*CHECKS}


READINGS = [
    (one, reading)
    for one in PROBES
    for reading in LEDGER.ambiguity_of(one.switch).switches[one.switch]
    if reading != "*"
]


@pytest.mark.strength
@pytest.mark.parametrize(
    ("probe", "reading"), READINGS, ids=[f"{one.switch}={reading}" for one, reading in READINGS]
)
def test_a_probe_of_motion_tells_every_reading(probe: Any, reading: str) -> None:
    """Of a twin that follows it, that one alone."""
    session = session_of(AlteredTwin(quirks={probe.switch: reading}), probe.check)
    assert probe.look(session).readings == (reading,)


def test_a_run_may_do_what_these_checks_do() -> None:
    """Each declares what it needs."""
    for check in CHECKS.values():
        assert {*check.safety} <= EVERYTHING
        assert "motion" in check.safety


@pytest.mark.strength
def test_the_path_of_a_wrong_arc_is_in_the_report() -> None:
    """An arc that goes the other way round: both axes of its plane, off their boxes."""
    port = hears(("A-500,0,-1000,0,1", "A-500,0,-1000,0,-1"))()
    options = make_options(
        model="mn400", port=URL, allow="motion", ids=("a_clockwise_half_circle_goes_below",)
    )
    told: list[dict[str, Any]] = []
    engine = Engine(options, lambda neighbours: SerialTransport(port, URL))
    assert (
        engine.run(lambda event: told.append(event_object(event, FAMILY.explain))).exit_status == 1
    )
    report = fold(told)
    (check,) = [one for one in report["checks"] if one["motions"]]
    (path,) = check["paths"]
    assert path["axes"] == ["axis 1", "axis 2"]
    assert not is_on_path(path)
    assert "axis 2 over axis 1, outside the predicted box" in render(report)
