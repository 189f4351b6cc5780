"""Every reading an MSC unit may follow is detected, written down, made again and conforms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from interfaces import PLAIN, judged_behind
from quirk_twins import QuirkTwins, Readings, quirks_query

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.cli import conform
from axistwin_conformance.core.profile import load_profile

pytestmark = pytest.mark.strength

TWINS = QuirkTwins(
    model="msc-250",
    ledger_name="msc",
    prefix="axistwin://",
    hidden={
        "ack_order": "it takes an output and an eye on it",
        "overlength": "nak_after_packet or accept",
        "reply_unit": "it answers its own number only",
        "rflags_unsupported": "this model has RFLAGS",
        "rs485_mode": "look at the cable",
        "write_visibility": "its scans are too short",
    },
    values={
        "packet_timeout_ms": ("400", "2501"),
        "ack_timeout_ms": ("299", "1700"),
        "reply_delay_ms": ("0", "37"),
        "timeout_before_unit": ("nak",),  # silence is what a unit on four wires of RS-485 has too
    },
    always="&program=bench",
)
OTHERS = TWINS.others
IDS = [f"{name}={reading}" for name, reading in OTHERS]

# What hides in a unit that follows the defaults otherwise, and shows in one that does not.
TOGETHER: list[dict[str, str]] = [
    {"overlength": "nak_after_header"},
    {"overlength": "timeout_only"},
    {"overlength": "accept", "malformed_body": "lenient"},
    {"overlength": "accept", "unknown_command": "silent"},
    {"reply_unit": "echo", "rs232_unit_check": "ignore"},
    {"ack_timeout_action": "abandon", "ack_timeout_ms": "650"},
    {"ack_timeout_action": "wait", "retransmit_limit": "5_total"},
    {"junk_while_waiting": "abandon", "stray_nak": "resend_last"},
    {"junk_while_waiting": "abandon", "ack_timeout_action": "abandon"},
    {"retransmit_content": "fresh", "stray_nak": "resend_last"},
    {"write_visibility": "immediate"},
    {"stx_while_waiting": "ignore", "ack_timeout_action": "wait", "junk_while_waiting": "as_nak"},
    {"noise_in_idle": "nak", "rx_while_busy": "drop"},
    {"packet_timeout_mode": "after_header", "packet_timeout_ms": "2000"},
    {"rs232_unit_check": "nak", "timeout_before_unit": "silent"},
    {"packet_timeout_mode": "interbyte", "timeout_before_unit": "nak"},
    {"data_address_stride": "2", "data_misaligned": "round_down"},
    {"data_address_stride": "2", "data_out_of_range": "wrap", "block_overrun": "wrap"},
    {"data_out_of_range": "zero", "block_overrun": "partial"},
    {"unknown_command": "silent", "empty_body": "ack"},
    {"rs232_unit_check": "nak", "invalid_unit": "nak", "timeout_before_unit": "nak"},
]
# Three questions that have nothing to do with each other.
THREE = {"reply_block": "counter", "stray_nak": "resend_last", "data_address_stride": "2"}


@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_reading_is_detected_written_and_made_again(
    switch: str, reading: str, tmp_path: Path
) -> None:
    """Twin → profile → twin of that profile → the same profile, with just that reading in it."""
    TWINS.goes_round({switch: reading}, tmp_path / "unit.toml")


@pytest.mark.parametrize("readings", TOGETHER, ids=str)
def test_readings_that_touch_each_other_are_told_apart(readings: Readings, tmp_path: Path) -> None:
    """The same for readings of which one changes how the other shows."""
    TWINS.goes_round(readings, tmp_path / "unit.toml")


def test_rflags_of_a_model_without_it_is_detected(tmp_path: Path) -> None:
    """What another model cannot be asked."""
    QuirkTwins("msc-generic", "msc", "axistwin://", {}, always="&program=bench").goes_round(
        {"rflags_unsupported": "ack_no_reply"}, tmp_path / "unit.toml"
    )


def test_visibility_of_writes_shows_where_scans_are_long(tmp_path: Path) -> None:
    """With scans of 50 ms a pulse falls between two of them, or is seen all the same."""
    slow = QuirkTwins("msc-250", "msc", "axistwin://", {}, always="&program=bench&quirk.scan_ms=50")
    _, result = slow.detected("")
    assert result.readings["write_visibility"] == "next_scan"
    slow.goes_round({"write_visibility": "immediate"}, tmp_path / "unit.toml")


def test_what_cannot_be_known_is_told_with_its_reason() -> None:
    """The default twin: every switch is known but the hidden ones, all of them the default."""
    TWINS.hides_what_it_hides()


def test_every_switch_of_the_ledger_has_a_probe_or_no_second_reading() -> None:
    """What has no probe is configuration, or has nothing to tell apart."""
    TWINS.asks_of_every_switch()


def test_passive_detection_writes_nothing_and_names_what_it_would_take(tmp_path: Path) -> None:
    """Without --allow only what needs no write is asked; the rest is told with the remedy."""
    path = tmp_path / "unit.toml"
    url = "axistwin://msc-250:1?time=virtual&quirk.reply_block=echo&quirk.write_reply=empty_packet"
    result = CliRunner().invoke(conform, ["msc-250", "--port", url, "--detect", str(path)])
    assert result.exit_code == 0, result.output
    text = path.read_text("utf-8")
    assert load_profile(path, "msc-250", TWINS.ledger) == {"reply_block": "echo"}
    assert "# write_reply: MSC-AMB-36: not allowed: stored (--allow stored)" in text
    assert "# unknown_command: MSC-AMB-04: not allowed: rig (--allow rig)" in text


def test_three_readings_at_once_conform_with_those_three_named() -> None:
    """A unit that differs in three ways is told in three names."""
    TWINS.conforms_with(THREE, "quick")


@pytest.mark.parametrize(
    ("readings", "names"),
    [
        (
            "response_delay_ms=3000 invalid_unit=nak",
            "on_rs232_other_unit_numbers_are_not_its_own",
        ),
        (
            "response_delay_ms=1864 status_tail=4",
            "the_written_exchanges_of_flags_and_status_come_byte_for_byte",
        ),
        (
            "response_delay_ms=0 transport=rs485",
            "a_sign_that_comes_while_it_talks_counts_when_it_ends",
        ),
        (
            "response_delay_ms=444 noise_in_idle=nak",
            "bytes_that_start_no_packet_are_ignored",
        ),
        ("response_delay_ms=444 noise_in_idle=nak", "bytes_without_02h_draw_nothing"),
        ("response_delay_ms=444 noise_in_idle=nak", "after_any_junk_it_serves_again"),
        (
            "packet_timeout_ms=266 uart_error=drop_byte",
            "a_character_without_its_stop_bit_spoils_its_packet",
        ),
        ("ack_timeout_ms=100 write_reply=empty_packet", "a_write_draws_the_ack_and_nothing_else"),
        (
            "ack_timeout_ms=110 reply_delay_ms=132 rx_while_busy=drop",
            "a_sign_that_comes_while_it_talks_counts_when_it_ends",
        ),
        ("packet_timeout_ms=260", "a_header_that_announces_too_much_is_refused"),
        ("packet_timeout_ms=260", "a_new_packet_ends_the_wait_for_the_hosts_sign"),
        ("ack_timeout_ms=100", "another_byte_is_no_sign"),
        ("ack_timeout_ms=100", "a_spoilt_character_while_it_talks_is_ignored"),
        ("reply_delay_ms=900", "another_byte_is_no_sign"),
        ("response_delay_ms=300", "a_new_packet_ends_the_wait_for_the_hosts_sign"),
    ],
)
def test_times_at_the_edge_of_what_is_allowed_fail_no_check(readings: str, names: str) -> None:
    """The suite listens for as long as the unit was measured to take, within its time limits."""
    query = quirks_query(dict(one.split("=") for one in readings.split()))
    engine = TWINS.engine_for(query, names, level="full")
    result = engine.run(lambda event: None)
    failed = [
        finding
        for ran in result.checks
        for finding in ran.findings
        if finding.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
    ]
    assert (result.exit_status, failed) == (0, [])


def test_a_time_limit_as_long_as_a_packet_tells_nothing_of_overlength() -> None:
    """T1 of 260 ms runs out while a packet of 249 characters ends: no reading is excluded."""
    _, result = TWINS.detected("&quirk.packet_timeout_ms=260")
    assert "overlength" not in result.readings


@pytest.mark.parametrize("reading", ["serve", "as_nak", "ignore"])
def test_what_a_unit_makes_of_02h_shows_however_late_it_speaks(reading: str) -> None:
    """It takes a second, and T1 is 260 ms: whether the reply comes again, and when, tells it."""
    quirks = {"packet_timeout_ms": "260", "response_delay_ms": "1084"}
    _, result = TWINS.detected(quirks_query(quirks | {"stx_while_waiting": reading}))
    assert result.readings["stx_while_waiting"] == reading


@pytest.mark.soak
def test_a_line_at_9600_baud_shows_the_same(tmp_path: Path) -> None:
    """All that can be asked over a pty, with times told in steps that the line does not blur."""
    readings = {"packet_timeout_ms": "400", "reply_delay_ms": "40", "reply_block": "echo"}
    quirks = [word for one in readings.items() for word in ("--quirk", "=".join(one))]
    pty, path = tmp_path / "msc", tmp_path / "unit.toml"
    twin = [sys.executable, "-m", "axistwin", "run", "msc-250", "--program", "bench", *quirks]
    scratch = ["--variables", "1024-5119", "--flags", "128-191", "--bench-program", "240:6144"]
    words = ["msc-250", "--port", str(pty), "--allow", "stored,motion,rig", *scratch]
    with subprocess.Popen(
        [*twin, "--pty", str(pty)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as served:
        assert served.stdout is not None
        try:
            assert "ready msc-250:1" in served.stdout.readline()
            result = CliRunner().invoke(conform, [*words, "--detect", str(path)])
        finally:
            served.terminate()
    assert result.exit_code == 0, result.output
    assert load_profile(path, "msc-250", TWINS.ledger) == readings


@pytest.mark.soak
@pytest.mark.parametrize(("switch", "reading"), OTHERS, ids=IDS)
def test_a_twin_of_each_reading_conforms_with_that_quirk_named(switch: str, reading: str) -> None:
    """Doubt has a name: another reading is neither failed nor overlooked, at level full."""
    TWINS.conforms_with({switch: reading}, "full")


@pytest.mark.soak
@pytest.mark.parametrize("readings", [THREE, *TOGETHER, *TWINS.sample(5, 3, seed=11)], ids=str)
def test_several_readings_at_once_conform_with_those_named(readings: Readings) -> None:
    """Readings that have to do with each other, or not."""
    TWINS.conforms_with(readings, "full")


def test_a_unit_that_takes_long_to_answer_is_listened_to_for_both_of_two_packets() -> None:
    """The second sign comes twice the delay after both packets: it was not lost."""
    run = judged_behind(
        PLAIN, "packets_behind_one_another_are_each_served",
        "a_packet_right_behind_a_write_is_served", model="msc-250",
        query="&quirk.response_delay_ms=300",
    )  # fmt: skip
    assert (run.failed, run.wrong_readings, run.result.exit_status) == ([], {}, 0)
