"""Units that read the manual otherwise: the checks of the link hold them to that, and name it."""

from __future__ import annotations

from typing import Any

import pytest
from msc_faults import needed_by
from msc_judging import failed, judge, link_checks, troubles
from msc_twin import TwinPort

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.msc.checks.packets import block_readings

# Another reading of the manual: the switch, the reading, the checks that meet it.
READINGS: list[tuple[str, str, tuple[str, ...]]] = [
    ("retransmit_limit", "5_total", (
        "a_refused_reply_comes_again_up_to_five_times", "a_reply_without_answer_comes_again",
        "refusals_and_time_outs_share_one_limit", "each_nak_draws_one_repeat_up_to_the_limit",
    )),
    ("packet_timeout_mode", "interbyte", (
        "a_packet_broken_off_is_refused_when_its_time_is_over",
        "the_time_limit_is_for_the_whole_packet", "the_longest_packet_has_time_enough",
        "the_time_limit_begins_with_each_packet", "packets_may_come_in_pieces",
    )),
    ("packet_timeout_ms", "700", (
        "a_packet_broken_off_is_refused_when_its_time_is_over",
        "the_time_limit_is_for_the_whole_packet", "the_longest_packet_has_time_enough",
    )),
    ("ack_timeout_ms", "300", (
        "a_reply_without_answer_comes_again", "refusals_and_time_outs_share_one_limit",
        "no_time_out_outlives_its_exchange",
    )),
    ("ack_timeout_action", "wait", (
        "a_reply_without_answer_comes_again", "another_byte_is_no_sign",
    )),
    ("ack_timeout_action", "abandon", (
        "a_reply_without_answer_comes_again", "another_byte_is_no_sign",
    )),
    ("reply_block", "counter", (
        "any_block_number_is_served_alike", "block_numbers_change_no_reply",
        "the_written_exchanges_of_variables_come_byte_for_byte",
        "every_reply_is_a_packet_as_the_manual_draws_it",
    )),
    ("stray_nak", "resend_last", (
        "signs_outside_an_exchange_are_ignored", "bytes_without_02h_draw_nothing",
        "a_refused_reply_comes_again_up_to_five_times", "another_byte_is_no_sign",
    )),
    ("rx_while_busy", "drop", (
        "a_sign_that_comes_while_it_talks_counts_when_it_ends",
        "no_time_out_outlives_its_exchange",
    )),
    ("uart_error", "use_byte", (
        "a_character_without_its_stop_bit_spoils_its_packet",
    )),
    ("uart_error", "drop_byte", (
        "a_character_without_its_stop_bit_spoils_its_packet",
    )),
    ("retransmit_content", "fresh", (
        "a_repeat_carries_the_data_of_the_first_reply",
    )),
    ("other_unit_framing", "hunt_stx", (
        "packets_for_others_are_followed_by_their_length",
    )),
]  # fmt: skip


@pytest.mark.parametrize(
    ("switch", "reading", "name"),
    [
        pytest.param(switch, reading, name, id=f"{switch}={reading}-{name}")
        for switch, reading, names in READINGS
        for name in names
    ],
)
def test_another_reading_is_no_failure(switch: str, reading: str, name: str) -> None:
    """A unit that was seen to read the manual otherwise is held to that; it is named, at most."""
    how: dict[str, Any] = {**needed_by(link_checks()[name]), switch: reading}
    findings = judge(name, TwinPort(**how), readings={switch: reading})
    assert not failed(findings), troubles(findings)
    quirks = [one.text for one in findings if one.verdict is Verdict.QUIRK]
    assert all(f"{switch}={reading}" in one for one in quirks)


@pytest.mark.parametrize(
    ("sent", "got", "readings"),
    [
        ((0, 0x1234, 1), (0, 0, 0), ("zero",)),
        ((0, 0x1234, 1), (0, 0x1234, 1), ("echo",)),
        ((0, 0x1234, 1), (7, 8, 9), ("counter",)),
        ((0, 0x1234, 1), (0xFFFF, 0, 1), ("counter",)),
        ((0, 1, 2), (0, 1, 2), ("echo", "counter")),
        ((0, 0x1234, 1), (0x1234, 0, 1), ()),
    ],
)
def test_block_numbers_tell_their_reading(
    sent: tuple[int, ...], got: tuple[int, ...], readings: tuple[str, ...]
) -> None:
    """Zeros, the request's, a counter, or none of these."""
    assert block_readings(sent, got) == readings
