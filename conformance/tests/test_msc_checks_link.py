"""The checks of packets, link, time-outs and shared lines: none accuses a sound unit, each sees
what it is there to see."""

from __future__ import annotations

import pytest
from msc_faults import (
    Make,
    answering,
    answering_for,
    at_bad_characters,
    confused,
    dropping_repeated_writes,
    flags_reversed,
    for_block_0,
    has_odd_body,
    length_swapped,
    no_xoff,
    only_low,
    packets_spoilt,
    refusing,
    repeating_what_is_over,
    repeats_differ,
    resummed,
    signs_spoilt,
    sound,
    summing,
    sums_to,
    swapped_sum,
    talking,
    twin,
    values_reversed,
    with_byte,
    with_fault,
)
from msc_judging import failed, judge, link_checks, troubles
from msc_twin import TwinPort
from zoo_msc import forms, leftovers, line, link, packets
from zoo_msc.planting import Receiver, ReceiverState, hears

from axistwin_conformance.base.verdicts import Verdict
from axistwin_conformance.families.msc import codec
from axistwin_conformance.families.msc.checks.golden import golden_exchanges
from axistwin_conformance.families.msc.checks.packets import WRONG_SUMS
from axistwin_conformance.families.msc.codec import ACK, NAK, STX

pytestmark = pytest.mark.strength


@pytest.mark.parametrize("name", link_checks())
def test_a_sound_unit_is_not_accused(name: str) -> None:
    """Every requirement that the check names is judged and holds."""
    check = link_checks()[name]
    findings = judge(name, sound(check))
    assert not troubles(findings)
    assert {one.requirement for one in findings} >= set(check.requirements)


@pytest.mark.parametrize("name", [one.name for one in link_checks().values() if one.soaks])
@pytest.mark.parametrize("seed", range(5))
def test_no_seed_accuses_a_sound_unit(name: str, seed: int) -> None:
    """Whatever is drawn."""
    check = link_checks()[name]
    assert not troubles(judge(name, sound(check), seed=seed))


@pytest.mark.parametrize("name", link_checks())
def test_a_dead_unit_passes_nothing_but_silence(name: str) -> None:
    """A unit that says nothing at all fails every check: silence alone proves none."""
    check = link_checks()[name]
    port = sound(check)
    port.spoil = lambda data: b""
    findings = judge(name, port)
    assert any(one.verdict is Verdict.FAIL for one in findings), findings


def restarting(patch: pytest.MonkeyPatch) -> TwinPort:
    """A unit that begins anew at any 02h (trap 2)."""
    states = (ReceiverState.HEADER, ReceiverState.BODY)

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_start = byte == STX[0] and receiver.state in states
        if is_start:
            receiver._begin_packet(now)
        return is_start

    hears(patch, takes)
    return TwinPort()


def summed_wrongly(how: str) -> Make:
    """A unit that computes its sum in one of the usual wrong ways, and takes the right one too."""
    wrong = WRONG_SUMS[how]

    def accepts(raw: bytes) -> bool:
        right = sums_to(raw, codec.checksum(raw[1:-2]))
        return right or sums_to(raw, wrong(raw[1:6], raw[6:-2]))

    return summing(accepts)


# What is wrong with the unit, the check that must see it, the requirement it breaks.
LIES: dict[str, tuple[str, Make, str]] = {
    # packets
    "its packets begin with 01h": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: b"\x01" + raw[1:]), "MSC-PKT-02",
    ),
    "its packets begin with 03h, then with 02h": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: b"\x03" + raw), "MSC-PKT-02",
    ),
    "its number is 0": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: with_byte(raw, 1, 0)), "MSC-PKT-03",
    ),
    "its number is another one": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: with_byte(raw, 1, 4)), "MSC-PKT-18",
    ),
    "its length counts the checksum": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: resummed(with_byte(raw, 3, raw[3] + 2))), "MSC-PKT-06",
    ),
    "its length goes low byte first": (
        "the_longest_body_is_served_and_its_reply_tells_134",
        packets_spoilt(length_swapped), "MSC-PKT-08",
    ),
    "its sum goes low byte first": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(swapped_sum), "MSC-PKT-11",
    ),
    "it sums its 02h": (
        "every_reply_is_a_packet_as_the_manual_draws_it",
        packets_spoilt(lambda raw: codec.with_wrong_checksum(raw, 2)), "MSC-PKT-12",
    ),
    "its number is a character": (
        "on_rs232_replies_carry_unit_1",
        packets_spoilt(lambda raw: with_byte(raw, 1, 0x31)), "MSC-PKT-04",
    ),
    "odd lengths are refused": (
        "bodies_of_odd_and_of_even_length_are_served",
        refusing(has_odd_body), "MSC-PKT-07",
    ),
    "137 bytes are too many for it": (
        "the_longest_body_is_served_and_its_reply_tells_134",
        refusing(lambda raw: len(raw) > 136), "MSC-PKT-07",
    ),
    "it looks at block numbers": (
        "any_block_number_is_served_alike", refusing(for_block_0), "MSC-PKT-09",
    ),
    "its block numbers follow nothing": (
        "any_block_number_is_served_alike",
        packets_spoilt(lambda raw: with_byte(raw, 5, raw[-1])), "MSC-PKT-19",
    ),
    "it restarts at 02h in a header": (
        "any_block_number_is_served_alike",
        with_fault(packets.a_02h_in_a_block_number_starts_a_packet), "MSC-PKT-15",
    ),
    "it restarts at 02h in a checksum": (
        "bytes_02h_06h_and_15h_of_body_and_checksum_are_no_signs",
        restarting, "MSC-PKT-15",
    ),
    "it answers for unit 3 as well": (
        "on_rs232_other_unit_numbers_are_not_its_own",
        answering_for(3), "MSC-PKT-04",
    ),
    "it answers for unit 16 as well": (
        "on_rs232_other_unit_numbers_are_not_its_own",
        answering_for(16), "MSC-PKT-03",
    ),
    "it obeys unit 0 and tells": (
        "unit_0_is_no_broadcast", answering_for(0), "MSC-PKT-03",
    ),
    "the low byte of a sum is enough": (
        "every_other_checksum_is_refused", summing(only_low), "MSC-PKT-12",
    ),
    **{
        f"its sum has {how}": (
            "every_other_checksum_is_refused", summed_wrongly(how), "MSC-PKT-12",
        )
        for how in WRONG_SUMS
    },
    "it refuses by two signs": (
        "every_other_checksum_is_refused", signs_spoilt(NAK, NAK + NAK), "MSC-LNK-02",
    ),
    "its sum is signed": (
        "sums_above_32767_are_still_sums",
        refusing(lambda raw: codec.checksum(raw[1:-2]) > 0x7FFF), "MSC-PKT-12",
    ),
    "values go low byte first": (
        "numbers_go_high_byte_first", packets_spoilt(values_reversed), "MSC-PKT-14",
    ),
    "XON and XOFF are swallowed": (
        "no_byte_of_a_value_is_special", packets_spoilt(no_xoff), "MSC-PHY-05",
    ),
    "a packet in a value is served": (
        "a_packet_inside_a_packet_is_data",
        with_fault(packets.a_packet_inside_a_packet_is_served_too), "MSC-PKT-15",
    ),
    "noise draws an ACK": (
        "bytes_that_start_no_packet_are_ignored", answering({b"\xff": ACK}), "MSC-PKT-20",
    ),
    "some noise draws a NAK": (
        "bytes_that_start_no_packet_are_ignored", answering({b"R": NAK}), "MSC-PKT-20",
    ),
    "the manual's example is refused": (
        "the_manuals_example_is_a_valid_packet",
        refusing(lambda raw: b"DWRITE" in raw), "MSC-PKT-21",
    ),
    "a written reply has a block number": (
        "the_written_exchanges_of_variables_come_byte_for_byte",
        packets_spoilt(lambda raw: with_byte(raw, 5, 1)), "MSC-PKT-12",
    ),
    "RFLAGS is one big number": (
        "the_written_exchanges_of_flags_and_status_come_byte_for_byte",
        packets_spoilt(flags_reversed),
        "MSC-PKT-12",
    ),
    # link
    "two ACKs": ("each_packet_draws_one_sign", signs_spoilt(ACK, ACK + ACK), "MSC-LNK-04"),
    "a NAK with something behind it": (
        "each_packet_draws_one_sign", signs_spoilt(NAK, NAK + b"\r"), "MSC-LNK-05",
    ),
    "no ACK before a reply": ("each_packet_draws_one_sign", signs_spoilt(ACK, b""), "MSC-LNK-01"),
    "ACK to everything": (
        "each_packet_draws_one_sign", summing(lambda raw: True), "MSC-LNK-02",
    ),
    "two ACKs to a write": (
        "a_write_draws_the_ack_and_nothing_else", signs_spoilt(ACK, ACK + ACK), "MSC-LNK-14",
    ),
    "two ACKs to a write of a flag": (
        "a_flag_that_is_turned_draws_the_ack_and_nothing_else", signs_spoilt(ACK, ACK + ACK),
        "MSC-LNK-14",
    ),
    "a stray ACK is answered": (
        "a_write_draws_the_ack_and_nothing_else", answering({ACK: NAK}), "MSC-LNK-14",
    ),
    "a reply that was given up leaves its count": (
        "whatever_went_before_a_reply_has_all_its_repeats",
        with_fault(leftovers.a_reply_that_was_given_up_leaves_its_count), "MSC-LNK-13",
    ),
    "a late ACK is not heard": ("a_sign_counts_whenever_it_comes",
        with_fault(leftovers.an_ack_in_the_second_half_of_t2_is_not_heard), "MSC-LNK-11"),
    "a late NAK is not heard": ("a_sign_counts_whenever_it_comes",
        with_fault(leftovers.a_nak_in_the_second_half_of_t2_is_not_heard), "MSC-LNK-10"),
    "T2 goes on amid an exchange": ("a_packet_counts_whenever_it_comes",
        with_fault(link.t2_goes_on_while_a_packet_is_carried_out), "MSC-LNK-16"),
    "a second 02h is the start": ("an_02h_in_the_place_of_the_unit_is_a_number",
        with_fault(leftovers.a_second_02h_is_the_start), "MSC-PKT-15"),
    "a refused write is stored": ("a_refused_write_stores_nothing",
        with_fault(link.a_refused_value_is_stored), "MSC-LNK-06"),
    "a refused SFLAG is carried out": ("a_refused_sflag_turns_nothing_on",
        with_fault(link.a_refused_flag_is_turned), "MSC-LNK-06"),
    "a refused packet is searched": (
        "bytes_of_a_refused_packet_are_not_looked_at_again",
        with_fault(link.a_refused_packet_is_searched_for_another), "MSC-LNK-24",
    ),
    "six repeats": (
        "a_refused_reply_comes_again_up_to_five_times",
        with_fault(link.a_reply_is_repeated_six_times), "MSC-LNK-09",
    ),
    "three repeats": (
        "a_refused_reply_comes_again_up_to_five_times",
        with_fault(link.a_reply_is_repeated_three_times), "MSC-LNK-09",
    ),
    "a count that is not reset": (
        "a_refused_reply_comes_again_up_to_five_times",
        with_fault(link.the_count_of_repeats_is_kept), "MSC-LNK-09",
    ),
    "an ACK before a repeat": (
        "a_refused_reply_comes_again_up_to_five_times",
        with_fault(link.an_ack_is_said_before_a_repeat), "MSC-LNK-10",
    ),
    "a repeat with other bytes": (
        "a_refused_reply_comes_again_up_to_five_times",
        repeats_differ(), "MSC-LNK-10",
    ),
    "T2 outlives the ACK": (
        "no_time_out_outlives_its_exchange",
        with_fault(link.the_hosts_ack_stops_no_timer), "MSC-LNK-11",
    ),
    "an idle unit answers ACK": (
        "signs_outside_an_exchange_are_ignored", answering({ACK: NAK}), "MSC-LNK-15",
    ),
    "an idle unit answers NAK with a sign": (
        "signs_outside_an_exchange_are_ignored", answering({NAK: ACK}), "MSC-LNK-15",
    ),
    "the old reply comes behind the new one": (
        "a_new_packet_ends_the_wait_for_the_hosts_sign",
        with_fault(link.the_hosts_ack_stops_no_timer), "MSC-LNK-16",
    ),
    "another byte draws a sign": ("another_byte_is_no_sign", confused(), "MSC-LNK-08"),
    "signs are lost while it talks": (
        "a_sign_that_comes_while_it_talks_counts_when_it_ends",
        twin(rx_while_busy="drop"), "MSC-LNK-08",
    ),
    "three signs for two packets": (
        "packets_behind_one_another_are_each_served", signs_spoilt(NAK, NAK + NAK), "MSC-LNK-04",
    ),
    "a packet during a repeat is lost": (
        "a_packet_that_comes_during_a_repeat_is_served_after_it",
        twin(rx_while_busy="drop"), "MSC-LNK-16",
    ),
    "a repeat is neither old nor new": (
        "a_repeat_carries_the_data_of_the_first_reply",
        repeats_differ(), "MSC-LNK-10",
    ),
    "the old reply comes behind the NAK to a bad packet": (
        "a_bad_packet_ends_the_wait_for_the_hosts_sign_as_well",
        repeating_what_is_over(), "MSC-LNK-16",
    ),
    "the old reply comes behind the ACK to a write": (
        "a_write_ends_the_wait_for_the_hosts_sign", repeating_what_is_over(), "MSC-LNK-16",
    ),
    "the reply that takes its place is repeated four times": (
        "a_reply_served_amid_a_wait_has_repeats_of_its_own",
        twin(retransmit_limit="5_total"), "MSC-LNK-09",
    ),
    "each write draws two ACKs": (
        "a_packet_right_behind_a_write_is_served", signs_spoilt(ACK, ACK + ACK), "MSC-LNK-04",
    ),
    "a repeated SFLAG is dropped": (
        "a_repeated_write_is_carried_out_again", dropping_repeated_writes(), "MSC-LNK-18",
    ),
    # time
    "characters have a second stop bit": (
        "a_character_takes_ten_bits_of_9600_baud",
        with_fault(line.a_second_stop_bit_is_sent), "MSC-PHY-01",
    ),
    "it talks by itself": (
        "an_idle_unit_says_nothing", talking(40_000_000_000), "MSC-PHY-03",
    ),
    "T1 is short": (
        "a_packet_broken_off_is_refused_when_its_time_is_over",
        twin(packet_timeout_ms=990), "MSC-LNK-03",
    ),
    "T1 is long": (
        "a_packet_broken_off_is_refused_when_its_time_is_over",
        twin(packet_timeout_ms=1015), "MSC-LNK-03",
    ),
    "two NAKs to what broke off": (
        "a_packet_broken_off_is_refused_when_its_time_is_over",
        with_fault(line.a_packet_broken_off_is_refused_twice), "MSC-LNK-03",
    ),
    "a lone 02h draws an ACK": (
        "a_lone_start_is_refused_on_rs232", signs_spoilt(NAK, ACK), "MSC-LNK-03",
    ),
    "everybody refuses a lone 02h, and then again": (
        "a_lone_start_is_nobodys_on_rs485",
        talking(1_120_000_000, others=(2, 3), timeout_before_unit="nak"),
        "MSC-LNK-03",
    ),
    "T1 is far too short for the longest packet": (
        "the_longest_packet_has_time_enough", twin(packet_timeout_ms=200), "MSC-LNK-17",
    ),
    "T1 ends a little early": (
        "the_longest_packet_has_time_enough", twin(packet_timeout_ms=990), "MSC-LNK-03",
    ),
    "T1 begins with noise": (
        "the_time_limit_begins_with_each_packet",
        with_fault(line.the_time_limit_begins_with_noise), "MSC-LNK-03",
    ),
    "T2 is long": (
        "a_reply_without_answer_comes_again", twin(ack_timeout_ms=1040), "MSC-LNK-12",
    ),
    "T2 is short": (
        "a_reply_without_answer_comes_again", twin(ack_timeout_ms=980), "MSC-LNK-12",
    ),
    "six repeats by time-out": (
        "a_reply_without_answer_comes_again",
        with_fault(link.a_reply_is_repeated_six_times), "MSC-LNK-09",
    ),
    "time-outs count apart from NAKs": (
        "refusals_and_time_outs_share_one_limit",
        with_fault(link.a_reply_is_repeated_six_times), "MSC-LNK-09",
    ),
    "what is refused at T1 by a pause is served": (
        "the_time_limit_is_for_the_whole_packet",
        twin(packet_timeout_mode="interbyte"),
        "MSC-LNK-03",
    ),
    "what a wrong length leaves over is served": (
        "a_length_that_is_wrong_is_found_at_t1_at_the_latest",
        with_fault(link.a_refused_packet_is_searched_for_another), "MSC-LNK-04",
    ),
    "a wrong length is found too late": (
        "a_length_that_is_wrong_is_found_at_t1_at_the_latest",
        twin(packet_timeout_ms=1500), "MSC-LNK-03",
    ),
    # line
    "it refuses packets for others": (
        "packets_for_others_are_followed_by_their_length",
        answering_for(15), "MSC-PKT-15",
    ),
    "it refuses what breaks off for others": (
        "what_breaks_off_for_others_draws_nothing",
        with_fault(line.what_breaks_off_for_others_is_refused), "MSC-LNK-19",
    ),
    "it carries out what is written to others": (
        "a_write_for_another_unit_stores_nothing_here",
        with_fault(forms.writes_for_others_are_carried_out_silently), "MSC-LNK-19",
    ),
    "it answers inside another unit's packet": (
        "the_rest_of_another_units_packet_is_counted_off",
        twin(other_unit_framing="hunt_stx"), "MSC-LNK-19",
    ),
    "it answers for an absent unit": (
        "each_unit_answers_its_own_number_only", answering_for(9, others=(2, 3)), "MSC-PKT-05",
    ),
    "it answers for its neighbour": (
        "each_unit_answers_its_own_number_only", answering_for(3, others=(2, 3)), "MSC-PKT-05",
    ),
    "it refuses what is broken for its neighbour": (
        "broken_packets_for_one_unit_concern_it_alone",
        with_fault(line.a_wrong_sum_for_others_is_refused, others=(2, 3)), "MSC-LNK-19",
    ),
    "it meddles among units": (
        "each_unit_behaves_as_if_alone",
        with_fault(line.a_wrong_sum_for_others_is_refused, others=(2, 3)), "MSC-PROP-14",
    ),
    "it hunts among units": (
        "each_unit_behaves_as_if_alone",
        twin(others=(2, 3), other_unit_framing="hunt_stx"), "MSC-PROP-14",
    ),
    "a body of 240 bytes is refused at its header": (
        "a_body_of_any_size_is_taken_to_its_end",
        with_fault(packets.a_body_of_240_bytes_is_too_long), "MSC-PKT-10",
    ),
    "it refuses packets for others amid a wait": (
        "a_packet_for_another_unit_amid_a_wait_draws_nothing",
        with_fault(line.a_packet_for_others_amid_a_wait_is_refused), "MSC-LNK-19",
    ),
    "the time limit of others runs on": (
        "what_breaks_off_for_others_draws_nothing",
        with_fault(line.the_time_limit_outlives_a_packet_for_others), "MSC-LNK-19",
    ),
    "an ACK before a reply ends the exchange": (
        "a_sign_that_comes_while_it_talks_counts_when_it_ends",
        with_fault(leftovers.an_ack_to_an_ack_ends_the_exchange), "MSC-LNK-07",
    ),
    # on a bench
    "a length above 240 draws two NAKs": (
        "a_header_that_announces_too_much_is_refused",
        with_fault(line.a_packet_broken_off_is_refused_twice), "MSC-LNK-20",
    ),
    "the length of others has eight bits": (
        "more_than_255_bytes_for_another_unit_are_counted_off",
        with_fault(line.the_length_of_others_has_eight_bits), "MSC-LNK-19",
    ),
    "the high byte of a length counts half": (
        "a_header_that_announces_too_much_is_refused",
        with_fault(line.the_high_byte_of_a_length_counts_half), "MSC-LNK-20",
    ),
    "an empty body draws two NAKs": (
        "an_empty_body_is_no_command", signs_spoilt(NAK, NAK + NAK), "MSC-LNK-04",
    ),
    "it is deaf after a framing error": (
        "a_character_without_its_stop_bit_spoils_its_packet", at_bad_characters(
            lambda unit, now: setattr(unit, "receive", lambda chunk: None)
        ), "MSC-LNK-02",
    ),
    "it answers a framing error": (
        "a_character_without_its_stop_bit_spoils_its_packet", at_bad_characters(
            lambda unit, now: unit._sign(now, now, NAK, unit._rest)
        ), "MSC-LNK-02",
    ),
    "another unit's packet ends where a character is spoilt": (
        "a_spoilt_character_for_another_unit_is_counted",
        twin(uart_error="drop_byte"), "MSC-LNK-19",
    ),
    "a spoilt character ends its reply": (
        "a_spoilt_character_while_it_talks_is_ignored", at_bad_characters(
            lambda unit, now: setattr(unit, "_repeats", unit._repeats_max)
        ), "MSC-LNK-10",
    ),
    "power-up greets": (
        "power_up_says_nothing", with_fault(line.it_says_nak_at_power_up), "MSC-PHY-04",
    ),
    "a reply outlives the power": (
        "power_up_says_nothing",
        with_fault(line.a_power_cut_leaves_a_reply_to_be_acknowledged), "MSC-PHY-04",
    ),
    # drawn
    "every reply comes twice": (
        "any_reply_is_sound_and_fits_its_request",
        packets_spoilt(lambda raw: raw[:-1] + b"\x00"), "MSC-PROP-01",
    ),
    "a block number changes the reply": (
        "block_numbers_change_no_reply", refusing(for_block_0), "MSC-PROP-02",
    ),
    "a pause of 0.5 s ends a packet": (
        "packets_may_come_in_pieces", twin(packet_timeout_ms=500), "MSC-PROP-03",
    ),
    "some bits are not summed": (
        "any_bit_turned_is_found", summing(only_low), "MSC-PROP-04",
    ),
    "the sum knows places": (
        "the_sum_does_not_see_bytes_exchanged",
        refusing(lambda raw: raw[4] > raw[5]), "MSC-PROP-05",
    ),
    "a beginning draws two NAKs": (
        "any_beginning_of_a_read_draws_one_nak",
        with_fault(line.a_packet_broken_off_is_refused_twice), "MSC-PROP-06",
    ),
    "a beginning is refused before it is over": (
        "any_beginning_of_a_read_draws_one_nak", twin(packet_timeout_ms=3), "MSC-PROP-06",
    ),
    "three repeats at most": (
        "each_nak_draws_one_repeat_up_to_the_limit",
        with_fault(link.a_reply_is_repeated_three_times), "MSC-PROP-07",
    ),
    "some byte draws an ACK": (
        "bytes_without_02h_draw_nothing", answering({b"\x41": ACK}), "MSC-PROP-15",
    ),
    "junk makes it restart for ever": (
        "after_any_junk_it_serves_again", restarting, "MSC-PROP-16",
    ),
}  # fmt: skip

# What had been seen of the unit before.
HELD: dict[str, dict[str, str]] = {
    "what is refused at T1 by a pause is served": {"packet_timeout_mode": "total"},
    "signs are lost while it talks": {"rx_while_busy": "buffer"},
}


@pytest.mark.parametrize("what", LIES)
def test_what_is_wrong_is_seen(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The check that is there for it fails the requirement that is broken."""
    name, make, requirement = LIES[what]
    findings = judge(name, make(monkeypatch), readings=dict(HELD.get(what, {})))
    assert requirement in failed(findings), troubles(findings)


def test_a_unit_of_which_nothing_is_known_may_lose_signs_while_it_talks() -> None:
    """One that is known to keep what comes then may not; see above."""
    name = "a_sign_that_comes_while_it_talks_counts_when_it_ends"
    findings = judge(name, TwinPort(rx_while_busy="drop"))
    assert not failed(findings), troubles(findings)


def test_every_check_has_a_unit_that_fails_it() -> None:
    """No check of these modules is without one."""
    refused = {"a_refused_write_stores_nothing", "a_refused_sflag_turns_nothing_on"}
    assert set(link_checks()) | refused == {name for name, _, _ in LIES.values()}


def test_a_program_that_ran_before_the_power_was_cut_runs_after_it() -> None:
    """Power-up does not start it."""
    check = link_checks()["power_up_says_nothing"]
    port = sound(check)
    judge(check.name, port)
    assert port.status & 1


def test_the_unit_6_of_the_ledger_is_unit_1_readdressed() -> None:
    """Readdressing changes the number and what it adds to the sum, and nothing else."""
    rows = {one.name: one for one in golden_exchanges()}
    one, six = rows["DREAD 2008, holding 1234"], rows["unit 6 on RS-485, DREAD 2008"]
    assert one.readdressed(6) == six.said
    assert six.readdressed(1) == one.said
    refused = rows["a refused packet, its repeat, and a reply that the host refuses once"]
    assert refused.readdressed(6)[0][1] == codec.with_wrong_checksum(six.said[0][1])


def test_every_written_packet_is_sound_but_the_refused_one() -> None:
    """What is shipped parses, and sums up."""
    packets = [
        codec.parse(data) for row in golden_exchanges() for _, data in row.said if len(data) > 1
    ]
    assert sum(one is None or not one.is_sound for one in packets) == 1
    assert {one.name for one in packets if one} == set(codec.NAMES)
