"""Every reading a device may follow is detected, written down, made again and conforms."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from click.testing import CliRunner
from quirk_twins import QuirkTwins, Readings, quirks_query

from axistwin.motion.ramp import RampedMotion, StopLaw
from axistwin_conformance.base.errors import UsageError
from axistwin_conformance.cli import conform, make_options
from axistwin_conformance.core.profile import load_profile, write_profile
from axistwin_conformance.engine.run import Engine

pytestmark = pytest.mark.strength

# Of a twin, not of a manual: `Ledger.configuration`.  And what no probe can tell, with the reason.
TWINS = QuirkTwins(
    model="mac23",
    ledger_name="mac_serial",
    prefix="axistwin://",
    hidden={
        "power_on_at_boot": "it takes a hand on the shaft",
        "position_overflow": "beyond any sensible envelope",
        "encoder_fault_locks": "a MAC23 tells no such fault",
    },
    values={
        "boot_time_ms": ("1700", "2300"),
        "imax_value": ("40h",),
        "version_word": ("00000703h",),
        "brake_increments": ("1", "10"),  # 0 is what an ideal plant does
    },
)
LEDGER = TWINS.ledger
OTHERS = TWINS.others
IDS = [f"{name}={reading}" for name, reading in OTHERS]
# Readings that act on one another, and the check that has to follow both.
MEETING = [
    ("torque_range=exclusive torque_over=clamp", "the_torque_limit_ends_at_imax"),
    ("torque_range=exclusive torque_over=mask", "the_torque_limit_ends_at_imax"),
    ("unknown_index=accept dont_care_digits=refuse", "unassigned_commands_are_refused"),
    ("unknown_index=silence dont_care_digits=refuse", "unassigned_commands_are_refused"),
    (
        "ref_edge=closing ref_retarget=remaining",
        "a_zeroed_move_ends_at_its_target_by_the_new_count",
    ),
    ("plant=inertial soft_stop_compare=equal", "beyond_a_software_stop_every_motion_ends"),
    ("plant=inertial target_range=accept", "the_fifo_has_three_stages"),
    ("running_until=profile busy_after_abort=true", "a_stopped_move_does_not_catch_up"),
    ("step_phase=start triangle_law=shared_peak", "the_ramp_has_120_increments_per_unit"),
    ("ramp_law=equal_increments triangle_law=shared_peak", "the_ramp_has_120_increments_per_unit"),
    ("brake_increments=7 soft_stop_compare=equal", "beyond_a_software_stop_every_motion_ends"),
    (
        "vel_f6_direction=positive vel_reverse_cmd=refuse",
        "the_direction_stays_whatever_the_next_15h_says",
    ),
]
# Readings of which the others hide the last one: the values that are left.
HIDING = [
    (
        {
            "vel_f6_direction": "positive", "vel_during_position": "refuse",
            "vel_reverse_cmd": "refuse",
        },
        ("ignore", "refuse"),
    ),
]  # fmt: skip


@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_reading_is_detected_written_and_made_again(
    switch: str, reading: str, tmp_path: Path
) -> None:
    """Twin → profile → twin of that profile → the same profile, with just that reading in it."""
    TWINS.goes_round({switch: reading}, tmp_path / "unit.toml")


def test_what_cannot_be_known_is_told_with_its_reason() -> None:
    """The default twin: every switch is known but the hidden ones, all of them the default."""
    TWINS.hides_what_it_hides()


def test_every_switch_of_the_ledger_has_a_probe_or_no_second_reading() -> None:
    """One place per switch; what has none is configuration, or has nothing to tell apart."""
    TWINS.asks_of_every_switch()


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_twin_of_each_reading_conforms_with_that_quirk_named(switch: str, reading: str) -> None:
    """Doubt has a name: another reading is neither failed nor overlooked, at level quick."""
    TWINS.conforms_with({switch: reading}, "quick")


@pytest.mark.soak
@pytest.mark.parametrize("readings", TWINS.sample(4, 1, seed=3), ids=str)
def test_a_sample_conforms_at_full_too(readings: Readings) -> None:
    """The whole suite on a twin of another reading."""
    TWINS.conforms_with(readings, "full")


@pytest.mark.strength(seconds=25)
@pytest.mark.parametrize("readings", [{"brake_increments": "100"}, {"nack_scope": "any"}], ids=str)
def test_what_lasts_longer_than_its_reply_is_waited_for(readings: Readings) -> None:
    """An axis that runs on after 18h, and Nacks of all modules, one behind the other: at full."""
    TWINS.conforms_with(readings, "full")


@pytest.mark.parametrize(("readings", "check"), MEETING)
def test_readings_that_act_on_one_another_conform(readings: str, check: str) -> None:
    """What one reading makes of another is neither failed nor taken for a third."""
    TWINS.conforms_with(dict(one.split("=") for one in readings.split()), "full", check)


@pytest.mark.parametrize(("readings", "left"), HIDING, ids=["reversal"])
def test_a_reading_that_others_hide_is_told_as_one_of_several(
    readings: Readings, left: tuple[str, ...]
) -> None:
    """None of those that the wire does not exclude is named alone."""
    engine, _ = TWINS.detected(quirks_query(readings))
    *known, hidden = readings
    found = {one.switch: one for one in engine.detections}
    assert [found[switch].reading for switch in known] == [readings[switch] for switch in known]
    assert (found[hidden].reading, tuple(found[hidden].candidates)) == (None, left)


def test_inertia_shows_in_virtual_time_where_nothing_may_go_fast() -> None:
    """How far it overruns a stop tells, as on a real line: no exact place is then asked of it."""
    url = "axistwin://mac23:0?time=virtual&quirk.plant=inertial"
    words = ["mac23", "--port", url, "--allow", "stored,motion", "--max-travel", "100000"]
    checks = ["some_mixed_sequences_agree_with_the_model", "a_hard_stop_stops_where_the_axis_is"]
    result = CliRunner().invoke(conform, [*words, "--max-speed", "10000", *checks])
    assert result.exit_code == 0
    assert "plant=inertial" in result.output


def test_a_profile_that_no_longer_fits_fails(tmp_path: Path) -> None:
    """A quirk that does not show any more is a failure of the quirk file, and told by its name."""
    path = tmp_path / "unit.toml"
    path.write_text('model = "mac23"\n[quirks]\nxon_byte = "11h"\n', "utf-8")
    result = CliRunner().invoke(conform, ["mac23", "--profile", str(path), "MACS-LINE-02"])
    assert result.exit_code == 1
    assert "xon_byte is 1Ah, the profile says 11h" in " ".join(result.output.split())


def test_a_reading_the_profile_does_not_name_is_a_deviation(tmp_path: Path) -> None:
    """What a profile leaves out is expected to be the default."""
    path = tmp_path / "unit.toml"
    path.write_text('model = "mac23"\n[quirks]\n', "utf-8")
    url = "axistwin://mac23:0?time=virtual&quirk.xon_byte=11h"
    words = ["mac23", "--port", url, "--profile", str(path), "MACS-LINE-02"]
    assert CliRunner().invoke(conform, words).exit_code == 1
    words = ["mac23", "--port", url, "MACS-LINE-02"]
    assert CliRunner().invoke(conform, words).exit_code == 0


def test_detect_alone_judges_nothing_and_writes_the_profile(tmp_path: Path) -> None:
    """--detect without ID and level: identity and detection only; exit 0."""
    path = tmp_path / "unit.toml"
    url = "axistwin://mac23:0?time=virtual&quirk.zero_catchup=refuse"
    words = ["mac23", "--port", url, "--allow", "stored", "--detect", str(path)]
    result = CliRunner().invoke(conform, words)
    assert result.exit_code == 0
    assert "zero_catchup=refuse" in result.output
    text = path.read_text("utf-8")
    assert load_profile(path, "mac23", LEDGER) == {"zero_catchup": "refuse"}
    assert '# xon_byte = "1Ah"  # MACS-AMB-01' in text  # confirmed, and why
    assert "# ramp_law: MACS-AMB-42: not allowed: motion (--allow motion)" in text
    assert f"--seed 0 --detect {path}\n" in text  # the command that asks again


def test_a_profile_that_cannot_be_written_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that fills up: exit 2 in a line; neither an empty file nor what was beside it."""
    path, before = tmp_path / "unit.toml", 'model = "mac23"\n'
    path.write_text(before, "utf-8")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    for name in (path, tmp_path / "new.toml"):
        words = ["mac23", "--allow", "passive", "--detect", str(name)]
        result = CliRunner().invoke(conform, words)
        assert result.exit_code == 2
        assert f"cannot write the profile {name}: No space left on device" in result.output
    assert [one.name for one in tmp_path.iterdir()] == ["unit.toml"]
    assert path.read_text("utf-8") == before


def test_a_profile_is_written_through_a_link_and_keeps_its_permissions(tmp_path: Path) -> None:
    """What was there is replaced where it lies; a new file has those that any new file has."""
    real, link, new = tmp_path / "real.toml", tmp_path / "link.toml", tmp_path / "new.toml"
    real.write_text("old", "utf-8")
    real.chmod(0o640)
    link.symlink_to(real)
    write_profile(link, "text")
    write_profile(new, "text")
    (tmp_path / "plain").write_text("", "utf-8")
    assert link.is_symlink()
    assert real.read_text("utf-8") == "text"
    assert real.stat().st_mode & 0o777 == 0o640
    assert new.stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_device_that_is_not_there_leaves_no_profile(tmp_path: Path) -> None:
    """Nothing was detected, so nothing is written."""
    path = tmp_path / "unit.toml"
    words = ["mac23", "--port", str(tmp_path / "none"), "--detect", str(path)]
    assert CliRunner().invoke(conform, words).exit_code == 3
    assert not path.exists()


def test_detection_does_no_more_than_the_checks_asked_for() -> None:
    """Without --detect, a passive selection is preceded by passive questions only."""
    words = make_options(model="mac23", ids=("MACS-LINE-02",))
    plan = Engine(words).plan()
    assert {name for probe in plan.probes for name in probe.check.safety} == {"passive"}


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('model = "mac34-1"\n', "is of a mac34-1"),
        ("", 'is empty: it begins with the model it is of, model = "mac23"'),
        ("[quirks]\n", 'names no model: it begins with the model it is of, model = "mac23"'),
        ('model = "mac23"\n[quirk]\n', "has 'quirk', which no profile has: did you mean quirks?"),
        ('model = "mac23"\n[quirks]\nxon_bite = 1\n', "did you mean xon_byte?"),
        ('model = "mac23"\n[quirks]\nxon_byte = "12h"\n', "write 1Ah or 11h"),
        ("[quirks\n", "is not TOML"),
        ("a = " + "9" * 5000, "is not TOML"),
        ("a = " + "[" * 3000 + "]" * 3000, "is not TOML: nested too deep"),
        ('model = "mac23"\nquirks = 3\n', "a table of name = value"),
    ],
)
def test_a_profile_that_cannot_be_meant_is_refused_in_one_line(
    text: str, complaint: str, tmp_path: Path
) -> None:
    """The line names the file, what is wrong, and what could be written."""
    path = tmp_path / "unit.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(UsageError, match=complaint.replace("?", r"\?")) as caught:
        load_profile(path, "mac23", LEDGER)
    assert "\n" not in str(caught.value)


def test_configuration_in_a_profile_is_passed_over(tmp_path: Path) -> None:
    """Factory values make a twin; nobody is judged by them."""
    path = tmp_path / "unit.toml"
    text = 'model = "mac23"\n[quirks]\nfactory_ramp = 3\nabort_flush = false\n'
    path.write_text(text, "utf-8")
    assert load_profile(path, "mac23", LEDGER) == {"abort_flush": "false"}


@pytest.mark.soak
@pytest.mark.parametrize("readings", TWINS.sample(5, 3, seed=11), ids=str)
def test_three_readings_at_once_conform_with_those_three_named(readings: Readings) -> None:
    """A device that differs in three ways is told in three names."""
    TWINS.conforms_with(readings, "quick")


def _candidates(query: str, switch: str) -> tuple[str, ...]:
    """What a detection leaves open, or has told, of a switch."""
    engine, _ = TWINS.detected(query)
    return next(one.candidates for one in engine.detections if one.switch == switch)


def test_a_lone_module_that_keeps_silent_to_ff_is_told_as_either_of_two(tmp_path: Path) -> None:
    """Silence of a module that is not 00 fits addr00_only as it fits none."""
    path = tmp_path / "unit.toml"
    words = ["mac23", "--address", "5", "--port", "axistwin://mac23:5?time=virtual"]
    result = CliRunner().invoke(conform, [*words, "--detect", str(path)])
    assert result.exit_code == 0, result.output
    text = path.read_text("utf-8")
    assert "# general_reply_policy: MACS-AMB-16: addr00_only or none" in text
    # A query with filled digits says nothing of a command.
    assert "# dont_care_digits: MACS-AMB-62: ignore or refuse" in text


def test_a_whole_ramp_while_slowing_down_is_a_reading_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """MACS-AMB-45 does not say that its second reading ends where the axis slows down anyway."""
    monkeypatch.setattr(
        RampedMotion,
        "_stops_on_whole_ramp",
        lambda self, at: (
            self.ramp.rules.stop_law is StopLaw.RAMP_LENGTH and at.counter < at.ramp.length
        ),
    )
    check = "a_ramped_stop_while_slowing_down_changes_nothing"
    TWINS.conforms_with({"stop_ramp_law": "ramp_length"}, "full", check)


@pytest.mark.parametrize(
    ("query", "switch", "readings"),
    [
        # Speeds change as much more slowly as replies take longer; from FFFFh no more than that.
        (
            "&quirk.reply_latency_us=152162&quirk.vel_change_law=constant_acceleration",
            "vel_change_law",
            ("constant_acceleration",),
        ),
        ("&quirk.reply_latency_us=152162", "vel_change_law", ("ramp_length",)),
        ("&quirk.reply_latency_us=450000", "vel_change_law", ("ramp_length", "step")),
        # A ramp of equal increments has no formula.
        (
            "&quirk.reply_latency_us=20000&quirk.ramp_law=equal_increments",
            "vel_change_law",
            ("ramp_length", "constant_acceleration"),
        ),
        ("&quirk.reply_latency_us=20000&quirk.vel_change_law=step", "vel_change_law", ("step",)),
        (
            "&quirk.reply_latency_us=20000&quirk.sync_during_interp=now",
            "sync_during_interp",
            ("now",),
        ),
    ],
)
def test_a_probe_tells_only_what_excludes_every_other_reading(
    query: str, switch: str, readings: tuple[str, ...]
) -> None:
    """Where a look fits several readings, all of them are named."""
    assert _candidates(query, switch) == readings


def test_a_segment_that_disarms_says_nothing_of_what_11h_starts() -> None:
    """MACS-AMB-71 comes before MACS-AMB-69: with nothing held back nothing can be dropped."""
    _, result = TWINS.detected("&quirk.arm_after_segment=lost")
    assert TWINS.named(result) == {"arm_after_segment": "lost"}


def test_a_counter_cleared_on_a_ramp_is_judged_under_either_ramp_law() -> None:
    """A ramp of equal increments takes longer, and so does the way to where it slows down."""
    check = "a_move_whose_counter_is_cleared_on_the_ramp_keeps_to_it"
    TWINS.conforms_with({"ramp_law": "equal_increments"}, "full", check)
