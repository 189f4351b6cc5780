"""Boards of other readings that checks or probes took for wrong ones, or did not read at all."""

from __future__ import annotations

from urllib.parse import quote

import pytest
from interfaces import PLAIN, judged_behind
from mn400_twin import AlteredTwin, failures, judged, session_of

from axistwin_conformance.base.check import Check
from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.core.session import Stop
from axistwin_conformance.families.mn400 import codec
from axistwin_conformance.families.mn400.driver import BoardDriver
from axistwin_conformance.families.mn400.family import Mn400
from axistwin_conformance.families.mn400.grammar import Refusal, read_command

pytestmark = pytest.mark.strength

TOGETHER: list[dict[str, str]] = [
    {
        "data_packet_trailer": "0500", "abs_mode_value": "0", "movepending_exempt": "K&Q",
        "cc_unsupported": "busy", "readcount_after_abort": "zero", "arc_rate": "tangential",
        "step_phase": "start", "backlash_speed": "start",
    },
    {
        "error_start_policy": "never", "cc_margin_scope": "per_axis_equal",
        "hold_after_release": "one_shot", "extra_params": "ignore", "omitted_param": "error",
        "readcount_sign": "magnitude", "pause_decel": "false", "accel_scale": "0.5",
        "queue_depth": "8",
    },
]  # fmt: skip
"""Readings of which many are told by where the axes are at what time."""

CHECKS = {one.name: one for one in Mn400().checks()}
PROBES = {one.switch: one for one in Mn400().probes()}
SOUND: list[tuple[str, dict[str, str]]] = [
    ("a_straight_way_in_pieces_takes_no_longer", {"cc_capacity": "8"}),
    ("a_contour_is_no_slower_than_separate_moves", {"cc_corner_speed": "margin"}),
    ("arcs_and_contours_are_compensated_before_they_begin", {"cc_corner_speed": "margin"}),
    ("at_a_negative_speed_pulses_pace_every_move", {"contour_pulses": "ignored"}),
    ("the_exit_code_is_that_of_the_last_move", {"limit_direction": "both"}),
    ("the_exit_code_is_that_of_the_last_move", {"limit_halts": "axis"}),
    ("a_limit_ends_what_moves_towards_it", {"limit_halts": "axis"}),
    ("a_helix_that_cannot_be_is_refused", {"omitted_param": "error"}),
    ("a_helix_that_cannot_be_is_refused", {"omitted_param": "zero", "plane_base": "0"}),
    ("axes_are_those_of_power_on", {"plane_base": "0"}),
    ("at_rest_every_command_is_served", {"cc_unsupported": "executed"}),
    ("while_a_contour_is_entered_little_is_served", {"cc_unsupported": "executed"}),
    ("a_full_queue_is_told", {"quit_flushes_queue": "false"}),
    ("quit_stops_and_forgets", {"quit_flushes_queue": "false", "queue_depth": "2"}),
    (
        "settings_are_served_and_refused_at_their_edges",
        {"speed_range_policy": "clip", "long_max": "2147000000", "long_min": "-2147000000"},
    ),
    (
        "settings_are_served_and_refused_at_their_edges",
        {"speed_range_policy": "clip", "negative_v": "minus_one_only"},
    ),
    ("in_a_configuration_every_command_is_a_line", {"prog_check": "run"}),
    *(
        (name, {"queue_depth": depth})
        for name in (
            "a_move_keeps_the_settings_of_its_time",
            "in_motion_commands_wait_or_are_served_at_once",
            "behind_a_queue_commands_wait_or_are_served_at_once",
            "in_a_contour_commands_wait_or_are_served_at_once",
        )
        for depth in ("2", "3")
    ),
]
# What a check told as another behaviour than the usual one, or left out.
JUDGED: list[tuple[str, dict[str, str]]] = [
    ("a_full_queue_is_told", {"queue_depth": "778"}),
    ("a_contour_has_room_for_256_segments", {"error_start_policy": "never"}),
    ("a_contour_has_room_for_256_segments", {"cc_capacity": "700"}),
    ("a_payload_may_be_as_long_as_the_longest_command", {"rx_payload_max": "966"}),
    ("a_payload_may_be_as_long_as_the_longest_command", {"error_start_policy": "always"}),
]
# In which nothing is left to be told, where the reading is known.
NOT_TOLD: list[tuple[str, dict[str, str]]] = [
    ("a_running_contour_can_be_paused_and_quit", {"readcount_sign": "magnitude"}),
    ("steps_left_of_an_arc_are_those_to_its_end", {"readcount_sign": "magnitude"}),
    ("settings_are_served_and_refused_at_their_edges", {"omitted_param": "error"}),
]
MEASURED = [("queue_depth", "778"), ("cc_capacity", "700"), ("rx_payload_max", "966")]


def twin(quirks: dict[str, str]) -> AlteredTwin:
    """A twin of these readings."""
    return AlteredTwin(quirks={name: quote(value) for name, value in quirks.items()})


@pytest.mark.parametrize(("name", "quirks"), SOUND)
def test_a_board_of_that_reading_does_not_fail(name: str, quirks: dict[str, str]) -> None:
    """Nothing that the check judges."""
    assert failures(CHECKS[name], twin(quirks), readings=quirks) == {}


@pytest.mark.parametrize(("name", "quirks"), JUDGED)
def test_a_board_of_that_reading_is_judged(name: str, quirks: dict[str, str]) -> None:
    """All that the check names."""
    found = verdicts(CHECKS[name], quirks)
    assert found.keys() == {*CHECKS[name].requirements}
    assert {*found.values()} <= {"pass", "quirk"}


@pytest.mark.parametrize(("name", "quirks"), NOT_TOLD)
def test_nothing_is_told_of_a_board_that_does_what_its_reading_says(
    name: str, quirks: dict[str, str]
) -> None:
    """Neither as a failure nor as what is merely unusual."""
    found = {one.verdict.value for one in judged(CHECKS[name], twin(quirks), readings=quirks)}
    assert found <= {"pass", "quirk", "not run"}


def verdicts(check: Check, quirks: dict[str, str]) -> dict[str, str]:
    """The last verdict of each requirement."""
    found = judged(check, twin(quirks), readings=quirks)
    return {one.requirement: one.verdict.value for one in found}


@pytest.mark.parametrize(("switch", "value"), MEASURED)
def test_a_large_number_is_measured(switch: str, value: str) -> None:
    """As exactly as a small one."""
    probe = PROBES[switch]
    assert probe.look(session_of(twin({switch: value}), probe.check)).readings == (value,)


@pytest.mark.parametrize(("switch", "value"), [("queue_depth", "9000"), ("cc_capacity", "9000")])
def test_a_number_that_is_too_large_to_be_measured_stays_open(switch: str, value: str) -> None:
    """The probe says so, and no check fails."""
    probe = PROBES[switch]
    with pytest.raises(Stop, match="no end of it"):
        probe.look(session_of(twin({switch: value}), probe.check))
    for name in ("a_full_queue_is_told", "a_contour_has_room_for_256_segments"):
        assert failures(CHECKS[name], twin({switch: value})) == {}


@pytest.mark.parametrize(
    ("trailer", "null", "left"),
    [("05", "true", ("empty_line",)), ("05", "false", ("done", "empty_line")),
     ("0500", "true", ("done", "empty_line")), ("06", "true", ("empty_line",))],
)  # fmt: skip
def test_a_line_without_text_may_look_like_a_done(
    trailer: str, null: str, left: tuple[str, ...]
) -> None:
    """A trailer of the same bytes hides it; one of others does not."""
    known = {"data_packet_trailer": trailer, "outcome_null": null}
    board, probe = twin(known | {"readprogram_end": "empty_line"}), PROBES["readprogram_end"]
    assert probe.look(session_of(board, probe.check, readings=known)).readings == left


def test_motors_are_numbered_where_no_parameter_may_be_omitted() -> None:
    """P is asked with all three of them."""
    board, probe = twin({"plane_base": "0", "omitted_param": "error"}), PROBES["plane_base"]
    session = session_of(board, probe.check, readings={"omitted_param": "error"})
    assert probe.look(session).readings == ("0",)


def test_a_number_is_read_at_any_length() -> None:
    """A board with room for it gets one of 9000 digits, more than Python reads as a number."""
    text = "L" + "1" * 9000
    driver = BoardDriver(session_of(twin({})))
    assert isinstance(read_command(text, driver.reading), Refusal)
    assert driver.client.limit_s(text) > driver.client.limit_s("L1")
    assert codec.number_in("-" + "0" * 9000 + "7") == -7


def test_a_measurement_asked_for_behind_a_space_is_waited_for() -> None:
    """A board that skips spaces takes E 2 for E2."""
    session = session_of(twin({"space_policy": "skip"}), readings={"space_policy": "skip"})
    driver = session.run.family.driver(session)
    assert driver.ask("E 2").codes == ("START", "data")


@pytest.mark.parametrize(
    ("switch", "reading"),
    [("quit_decel", "true"), ("quit_in_entry", "entry_only"), ("quit_flushes_queue", "false"),
     ("backlash_counts", "true")],
)  # fmt: skip
def test_a_board_of_another_reading_is_asked_on_a_port(switch: str, reading: str) -> None:
    """Its probes tell it, no axis is called a runaway, and all are home behind them."""
    run = judged_behind(
        PLAIN, model="mn400", level=None, detects=True, query=f"&quirk.{switch}={reading}"
    )
    assert (run.result.exit_status, run.result.problems) == (0, [])
    assert run.result.readings[switch] == reading
    assert not [name for name, one in run.result.detections.items() if "away" in one.evidence]


@pytest.mark.parametrize(
    ("name", "query"),
    [("in_motion_commands_wait_or_are_served_at_once", "&quirk.queue_modal=false"),
     ("in_motion_commands_wait_or_are_served_at_once",
      "&quirk.queue_modal=false&quirk.omitted_param=zero"),
     ("in_a_contour_commands_wait_or_are_served_at_once", "&quirk.queue_modal=false"),
     ("after_an_abort_every_command_is_served", "&quirk.quit_decel=true")],
)  # fmt: skip
def test_counters_are_loaded_where_the_axes_are_known_to_stand(name: str, query: str) -> None:
    """All that the check is about is judged, and the axes are put back."""
    run = judged_behind(PLAIN, name, model="mn400", level=None, query=query)
    assert (run.result.exit_status, run.result.problems) == (0, [])
    assert {one.verdict for one in run.result.requirements} <= {Verdict.PASS, Verdict.QUIRK}


@pytest.mark.parametrize("name", ["what_is_refused_moves_nothing", "helices_turn_and_traverse"])
def test_a_board_that_says_move_abort_is_no_failure_where_one_check_is_named(name: str) -> None:
    """Nobody has looked for that reading yet when the axes are brought to rest."""
    query = "&quirk.move_abort_use=while_aborted"
    run = judged_behind(PLAIN, name, model="mn400", level=None, query=query)
    assert (run.result.exit_status, run.result.problems) == (0, [])


@pytest.mark.parametrize("quirks", TOGETHER)
def test_a_board_of_many_other_readings_conforms_on_a_real_port(quirks: dict[str, str]) -> None:
    """Whose clock began days ago; each reading is told."""
    query = "".join(f"&quirk.{name}={quote(value)}" for name, value in quirks.items())
    run = judged_behind(PLAIN, model="mn400", query=query, level="full", allow="motion")
    assert run.result.exit_status == 0, (run.failed, run.result.sentence)
    assert run.wrong_readings == quirks
