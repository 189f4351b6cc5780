"""The checks of CAN's own on modules that each do one thing wrong."""

from __future__ import annotations

import pytest
from lying_bus import (
    RESET,
    Turn,
    also,
    changed,
    every_second,
    failed,
    instead,
    is_boot_up,
    is_download,
    is_lmt,
    is_reply_of,
    judge,
    never,
    replies_changed,
    to_all_frames,
    twice,
)

from axistwin_conformance.families.mac.can import codec
from axistwin_conformance.transport.can_frame import Frame

# What the twin is made to do: who says it, the check that must see it, the requirement it breaks.
Lie = tuple[str, dict[str, Turn], str]
LIES: dict[str, Lie] = {
    # identifiers
    "another module's address is answered": (
        "requests_to_other_addresses_get_no_reply",
        {"hears": instead(lambda one: one.identifier == 0x641, lambda one: Frame(0x601, one.data))},
        "MACC-ID-02",
    ),
    "another module's address is obeyed": (
        "downloads_to_other_addresses_do_nothing",
        {
            "hears": also(
                lambda one: is_download(one, 0x0C, 0x633), codec.request(1, 0x0C, 9).frame()
            )
        },
        "MACC-ID-02",
    ),
    "an identifier of another service is answered": (
        "no_other_identifier_reaches_a_module",
        {"hears": instead(lambda one: one.identifier == 0x681, lambda one: Frame(0x601, one.data))},
        "MACC-ID-01",
    ),
    "the reply comes under another identifier": (
        "it_answers_once_on_the_identifier_of_its_address",
        {"says": instead(lambda one: one.identifier == 0x581, lambda one: Frame(0x585, one.data))},
        "MACC-ID-01",
    ),
    "eleven bits of an extended identifier are enough": (
        "extended_frames_are_ignored",
        {"hears": instead(
            lambda one: one.is_extended, lambda one: Frame(one.identifier & 0x7FF, one.data)
        )},
        "MACC-ID-03",
    ),
    "a remote frame is taken for an upload": (
        "remote_frames_are_ignored",
        {"hears": instead(
            lambda one: one.is_remote and one.identifier == 0x601,
            lambda one: codec.request(1, 0x20).frame(),
        )},
        "MACC-ID-03",
    ),
    "module 2 answers what all are told": (
        "module_1_alone_answers_what_all_are_asked",
        {"injects": to_all_frames(
            lambda one: one.identifier == 0x600,
            Frame(0x582, bytes.fromhex("42 00 20 00 00 00 00 00")),
        )},
        "MACC-GEN-02",
    ),
    "the answer to all comes from nowhere known": (
        "module_1_alone_answers_what_all_are_asked",
        {"says": instead(lambda one: one.identifier == 0x581, lambda one: Frame(0x5A1, one.data))},
        "MACC-GEN-03",
    ),
    "only module 1 obeys what all are told": (
        "a_setting_for_all_is_taken_by_all",
        {"hears": instead(lambda one: one.identifier == 0x600, lambda one: Frame(0x601, one.data))},
        "MACC-GEN-01",
    ),
    "only module 1 moves when all are told": (
        "a_motion_for_all_moves_all_and_one_stop_ends_it",
        {"hears": instead(lambda one: one.identifier == 0x600, lambda one: Frame(0x601, one.data))},
        "MACC-GEN-01",
    ),
    "module 1 answers for everybody": (
        "module_1_answers_for_itself_only",
        {"says": replies_changed(0, 0x80, 0x60)},
        "MACC-GEN-02",
    ),
    # transfers
    "an acceptance carries something": (
        "accepted_downloads_are_answered_with_60h_and_zeros",
        {"says": replies_changed(7, 0x01, 0x60)},
        "MACC-SDO-01",
    ),
    "an acceptance names another index": (
        "accepted_downloads_are_answered_with_60h_and_zeros",
        {"says": replies_changed(1, 0x00, 0x60)},
        "MACC-SDO-01",
    ),
    "an acceptance comes twice": (
        "accepted_downloads_are_answered_with_60h_and_zeros",
        {"says": twice(lambda one: is_reply_of(one, 0x60))},
        "MACC-SDO-01",
    ),
    "a refusal forgets the sub-index": (
        "refused_downloads_are_answered_with_80h_and_zeros",
        {"says": replies_changed(3, 0x00, 0x80)},
        "MACC-SDO-02",
    ),
    "an answer tells its size": (
        "uploads_are_answered_with_42h_and_four_bytes",
        {"says": replies_changed(0, 0x4F, 0x42)},
        "MACC-SDO-03",
    ),
    "an answer comes twice": (
        "it_answers_once_on_the_identifier_of_its_address",
        {"says": twice(lambda one: is_reply_of(one, 0x42))},
        "MACC-SDO-06",
    ),
    "an answer forgets the sub-index": (
        "any_sub_index_is_repeated_and_selects_nothing",
        {"says": replies_changed(3, 0x00, 0x42)},
        "MACC-SDO-09",
    ),
    "a sub-index selects": (
        "any_sub_index_is_repeated_and_selects_nothing",
        {"says": instead(
            lambda one: is_reply_of(one, 0x42) and one.data[3] == 0x7F,
            lambda one: changed(one, 7, one.data[7] ^ 1),
        )},
        "MACC-SDO-09",
    ),
    "the two middle bytes change places": (
        "every_byte_of_a_number_keeps_its_place",
        {"hears": instead(
            lambda one: is_download(one, 0x09),
            lambda one: Frame(
                0x601, one.data[:5] + bytes([one.data[6], one.data[5]]) + one.data[7:]
            ),
        )},
        "MACC-SDO-04",
    ),
    "one parameter is little-endian": (
        "numbers_travel_most_significant_byte_first",
        {"hears": instead(
            lambda one: is_download(one, 0x0F),
            lambda one: Frame(0x601, one.data[:4] + one.data[:3:-1]),
        )},
        "MACC-SDO-04",
    ),
    "reading 2000h restarts": (
        "reading_an_index_does_not_do_what_writing_it_does",
        {"hears": also(lambda one: one.data[:3] == b"\x40\x00\x20", RESET)},
        "MACC-SDO-05",
    ),
    "reading 200Bh clears the counter": (
        "download_and_upload_of_an_index_are_two_things",
        {"hears": instead(
            lambda one: one.data[:3] == b"\x40\x0b\x20",
            lambda one: codec.request(1, 0x0B).frame(),
        )},
        "MACC-SDO-05",
    ),
    "a filler matters": (
        "the_filler_of_an_upload_does_not_matter",
        {"hears": instead(
            lambda one: one.data[:1] == b"\x40" and one.data[4:] == b"\xff\xff\xff\xff",
            lambda one: changed(one, 1, 0x0F),
        )},
        "MACC-SDO-07",
    ),
    "a don't-care byte counts": (
        "bytes_without_a_meaning_may_hold_anything",
        {"hears": instead(
            lambda one: is_download(one, 0x0F) and any(one.data[4:7]),
            lambda one: changed(one, 7, one.data[6]),
        )},
        "MACC-SDO-08",
    ),
    "2Bh is a download and 22h is not": (
        "any_other_first_byte_is_refused",
        {"hears": instead(
            lambda one: one.data[:2] == b"\x2b\x0c", lambda one: changed(one, 0, 0x23)
        )},
        "MACC-SDO-10",
    ),
    "the high byte of the index is not looked at": (
        "downloads_outside_the_area_set_nothing",
        {"hears": instead(
            lambda one: one.data[:3] == b"\x23\x0c\x21", lambda one: changed(one, 2, 0x20)
        )},
        "MACC-SDO-10",
    ),
    "the high byte of the index is not repeated": (
        "objects_outside_the_area_are_refused",
        {"says": replies_changed(2, 0x20, 0x80)},
        "MACC-SDO-10",
    ),
    "the low byte of the index is masked": (
        "unassigned_uploads_are_refused",
        {"hears": instead(
            lambda one: one.data[:2] == b"\x40\x10", lambda one: changed(one, 1, 0x00)
        )},
        "MACC-SDO-10",
    ),
    "one unassigned download is accepted": (
        "unassigned_downloads_are_refused",
        {"says": instead(
            lambda one: is_reply_of(one, 0x80) and one.data[1] == 0x1B,
            lambda one: changed(one, 0, 0x60),
        )},
        "MACC-CMD-XX-01",
    ),
    "seven bytes are enough": (
        "a_short_download_sets_nothing",
        {"hears": instead(
            lambda one: one.data[:1] == b"\x23" and len(one.data) == 7,
            lambda one: Frame(0x601, one.data + b"\x05"),
        )},
        "MACC-SDO-11",
    ),
    "the end of a move is told": (
        "a_motion_is_answered_when_it_is_taken_over",
        {"says": twice(lambda one: is_reply_of(one, 0x60) and one.data[1] == 0x13)},
        "MACC-SDO-06",
    ),
    # messages
    "boot-up comes twice": (
        "a_reset_is_answered_and_ends_with_one_boot_up_message",
        {"says": twice(is_boot_up)},
        "MACC-BOOT-01",
    ),
    "no boot-up comes": (
        "a_reset_is_answered_and_ends_with_one_boot_up_message",
        {"says": never(is_boot_up)},
        "MACC-BOOT-01",
    ),
    "boot-up has another byte": (
        "a_reset_is_answered_and_ends_with_one_boot_up_message",
        {"says": instead(is_boot_up, lambda one: Frame(one.identifier, b"\x7f"))},
        "MACC-BOOT-02",
    ),
    "a reset resets all": (
        "a_reset_is_answered_and_ends_with_one_boot_up_message",
        {"hears": also(lambda one: one == RESET, codec.request(2, 0x00).frame())},
        "MACC-BOOT-01",
    ),
    "a reset is refused": (
        "a_reset_is_answered_and_ends_with_one_boot_up_message",
        {"says": replies_changed(0, 0x80, 0x60)},
        "MACC-CMD-00-02",
    ),
    "every second reset comes to nothing": (
        "the_boot_up_message_comes_two_seconds_after_the_reset",
        {"hears": every_second(lambda one: one == RESET)},
        "MACC-BOOT-04",
    ),
    "it answers while it boots": (
        "until_its_boot_up_message_it_serves_nothing",
        {"injects": to_all_frames(
            lambda one: is_download(one, 0x12), Frame(0x581, bytes.fromhex("8012200000000000"))
        )},
        "MACC-BOOT-04",
    ),
    "every second lifebeat is lost": (
        "a_lifebeat_comes_every_ten_seconds_of_silence",
        {"says": every_second(lambda one: one.identifier == 0x081)},
        "MACC-EMCY-01",
    ),
    "a lifebeat has seven bytes": (
        "a_lifebeat_comes_every_ten_seconds_of_silence",
        {"says": instead(
            codec.is_emergency, lambda one: Frame(one.identifier, one.data[:7])
        )},
        "MACC-EMCY-03",
    ),
    "the lifebeat does not know of stops": (
        "the_lifebeat_repeats_the_status",
        {"says": instead(codec.is_emergency, lambda one: changed(one, 4, 0x01))},
        "MACC-EMCY-03",
    ),
    "a refused request does not put the lifebeat off": (
        "requests_to_it_put_the_lifebeat_off",
        {
            "hears": never(lambda one: is_download(one, 0x12)),
            "injects": to_all_frames(
                lambda one: is_download(one, 0x12), Frame(0x581, bytes.fromhex("8012200000000000"))
            ),
        },
        "MACC-EMCY-05",
    ),
    "requests to others put the lifebeat off": (
        "what_is_not_for_it_does_not_put_the_lifebeat_off",
        {
            "hears": instead(
                lambda one: one.identifier == 0x603, lambda one: codec.request(1, 0x20).frame()
            ),
            "says": never(lambda one: False),
        },
        "MACC-EMCY-05",
    ),
    "network management stops it for good": (
        "network_management_neither_hinders_nor_restarts_it",
        {"says": every_second(lambda one: is_reply_of(one, 0x42))},
        "MACC-BOOT-04",
    ),
    # SYNC
    "SYNC starts nothing": (
        "sync_starts_a_preloaded_move",
        {"hears": never(lambda one: one.identifier == codec.SYNC)},
        "MACC-SYNC-01",
    ),
    "every second SYNC is lost": (
        "sync_starts_velocity_and_homing_too",
        {"hears": every_second(lambda one: one.identifier == codec.SYNC)},
        "MACC-SYNC-01",
    ),
    "SYNC is answered": (
        "sync_is_not_answered",
        {"injects": to_all_frames(
            lambda one: one.identifier == codec.SYNC,
            Frame(0x581, bytes.fromhex("6011200000000000")),
        )},
        "MACC-SYNC-02",
    ),
    "SYNC arms": (
        "sync_neither_arms_nor_spends_what_is_armed",
        {"hears": also(
            lambda one: one.identifier == codec.SYNC, codec.request(1, 0x10).frame()
        )},
        "MACC-SYNC-04",
    ),
    "SYNC of two bytes is another one": (
        "data_of_a_sync_frame_are_ignored",
        {"hears": never(lambda one: one.identifier == codec.SYNC and len(one.data) == 2)},
        "MACC-SYNC-05",
    ),
    "lifebeats of others are taken for SYNC": (
        "no_other_frame_is_taken_for_sync",
        {"hears": also(lambda one: one.identifier == 0x0A5, codec.sync())},
        "MACC-SYNC-01",
    ),
    "a remote SYNC starts": (
        "no_other_frame_is_taken_for_sync",
        {"hears": instead(lambda one: one.is_remote, lambda one: codec.sync())},
        "MACC-ID-03",
    ),
    "one module starts late": (
        "one_sync_starts_all_modules_together",
        {"hears": instead(
            lambda one: one.identifier == codec.SYNC, lambda one: codec.request(1, 0x11).frame()
        )},
        "MACC-SYNC-01",
    ),
    # LMT
    "entering is answered": (
        "the_address_is_given_in_three_steps",
        {"injects": to_all_frames(
            lambda one: is_lmt(one, 4, 1), Frame(codec.LMT_REPLY, b"\x04\x01".ljust(8, b"\0"))
        )},
        "MACC-LMT-02",
    ),
    "the reply says something more": (
        "the_address_is_given_in_three_steps",
        {"says": instead(
            lambda one: one.identifier == codec.LMT_REPLY, lambda one: changed(one, 3, 0x2A)
        )},
        "MACC-LMT-02",
    ),
    "the address holds at once": (
        "the_address_is_given_in_three_steps",
        {"hears": also(lambda one: is_lmt(one, 0x11), codec.lmt_leave())},
        "MACC-LMT-03",
    ),
    "the boot-up names the old address": (
        "the_address_is_given_in_three_steps",
        {"says": instead(is_boot_up, lambda one: codec.boot_up(1))},
        "MACC-BOOT-03",
    ),
    "7Fh cannot be had": (
        "addresses_at_the_bounds_can_be_had",
        {"hears": never(lambda one: is_lmt(one, 0x11, 0x7F))},
        "MACC-LMT-01",
    ),
    "seven bytes are too few": (
        "lmt_frames_may_be_shorter_and_hold_anything",
        {"hears": never(lambda one: is_lmt(one) and len(one.data) < 8)},
        "MACC-LMT-01",
    ),
    "a restart does not end the procedure": (
        "an_abandoned_procedure_leaves_the_old_address",
        {"hears": lambda one: (codec.lmt_enter(), one) if is_lmt(one, 0x11) else (one,)},
        "MACC-LMT-06",
    ),
    "80h is an address": (
        "addresses_out_of_range_are_refused",
        {"says": instead(
            lambda one: one.identifier == codec.LMT_REPLY,
            lambda one: Frame(codec.LMT_REPLY, b"\x11".ljust(8, b"\0")),
        )},
        "MACC-LMT-05",
    ),
    "FFh is taken for 7Fh": (
        "addresses_out_of_range_are_refused",
        {
            "hears": instead(
                lambda one: is_lmt(one, 0x11, 0xFF), lambda one: codec.lmt_address(0x7F)
            )
        },
        "MACC-LMT-05",
    ),
    "no entering is needed": (
        "without_entering_no_address_is_taken",
        {"hears": lambda one: (codec.lmt_enter(), one) if is_lmt(one, 0x11) else (one,)},
        "MACC-LMT-06",
    ),
    "extended frames enter": (
        "without_entering_no_address_is_taken",
        {"hears": instead(
            lambda one: one.is_extended and one.data[:2] == b"\x04\x01",
            lambda one: codec.lmt_enter(),
        )},
        "MACC-ID-03",
    ),
    "leaving leaves nothing": (
        "leaving_without_an_address_does_nothing_else",
        {"hears": never(lambda one: is_lmt(one, 4, 0))},
        "MACC-LMT-07",
    ),
    "only downloads are served meanwhile": (
        "requests_are_served_at_the_old_address_meanwhile",
        {"says": every_second(lambda one: is_reply_of(one, 0x42))},
        "MACC-LMT-08",
    ),
    "an unknown service is answered like a transfer": (
        "other_lmt_services_are_ignored",
        {"injects": to_all_frames(
            lambda one: is_lmt(one, 0x17), Frame(0x581, bytes.fromhex("8000000000000000"))
        )},
        "MACC-LMT-09",
    ),
    "module 42 answers all": (
        "a_lone_module_other_than_1_obeys_all_in_silence",
        {"injects": to_all_frames(
            lambda one: one.identifier == 0x600, Frame(0x5AA, bytes.fromhex("600C200000000000"))
        )},
        "MACC-GEN-02",
    ),
    "a factory reset keeps the address": (
        "a_factory_reset_brings_the_factory_values",
        {"hears": never(lambda one: is_download(one, 0x01, 0x62A))},
        "MACC-CMD-01-01",
    ),
    # with a rig
    "an emergency is not told": (
        "a_supply_warning_is_told_when_it_comes_and_goes",
        {"says": never(lambda one: codec.is_emergency(one) and any(one.data[:2]))},
        "MACC-EMCY-02",
    ),
    "an emergency is told twice": (
        "overheating_is_told",
        {"says": twice(codec.is_emergency)},
        "MACC-EMCY-02",
    ),
    "an emergency has another code": (
        "a_micro_cut_is_told",
        {"says": instead(codec.is_emergency, lambda one: changed(one, 0, 0x21))},
        "MACC-EMCY-04",
    ),
    "under-voltage hides a micro-cut": (
        "of_two_errors_the_graver_has_the_code",
        {"says": instead(
            lambda one: codec.is_emergency(one) and one.data[3] == 0x21,
            lambda one: Frame(one.identifier, b"\x20\x32" + one.data[2:]),
        )},
        "MACC-EMCY-04",
    ),
    "the lifebeat goes on while reset is held": (
        "held_in_reset_it_says_nothing",
        {"injects": to_all_frames(lambda one: one == RESET, Frame(0x081, bytes(8)))},
        "MACC-STATE-02",
    ),
    "power-up is told twice": (
        "at_power_up_it_says_so_once",
        {"says": twice(is_boot_up)},
        "MACC-BOOT-01",
    ),
    "the address is lost with the supply": (
        "the_address_outlives_the_supply_once_it_holds",
        {"says": instead(is_boot_up, lambda one: codec.boot_up(1))},
        "MACC-PERS-01",
    ),
}  # fmt: skip


@pytest.mark.parametrize("words", LIES)
def test_a_module_that_does_something_wrong_fails_by_the_right_requirement(words: str) -> None:
    """Each wrong in one way, seen by the check that is there for it."""
    name, turns, requirement = LIES[words]
    assert requirement in failed(judge(name, **turns))
