"""Faults that the table of negations had and nobody had planted: of the line, packets and link."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc import receiver as receiver_module
from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.packets import is_sum_right
from axistwin.devices.msc.receiver import ACCEPTED, REFUSED
from axistwin.kernel.effects import Transmit
from axistwin.wire.framing import LineFormat
from zoo_msc.planting import (
    ACK,
    LINE_FORMAT,
    MS,
    NAK,
    NEVER,
    Any_,
    Commands,
    MonkeyPatch,
    Receiver,
    ReceiverState,
    Whom,
    alarms,
    around,
    bodies,
    carry_out,
    hears,
    listens_to_others,
    msc_mutant,
    name_of,
    packets_sent,
    payloads,
    replies,
    resummed,
    total,
)

ACK_BYTE, NAK_BYTE = bytes([ACK]), bytes([NAK])
XON, CR = 0x11, 0x0D
WRITES = ("BWRITE", "CFLAG", "DWRITE", "SFLAG")
ETX = 0x03

# --- the line ------------------------------------------------------------------------------------


def _spread(patch: MonkeyPatch, line: LineFormat) -> None:
    """Let the unit send its characters at the pace of another line."""

    def act(go: Any_, receiver: Receiver, start_ns: int, data: bytes) -> int:
        for at in range(len(data)):
            go(start_ns + line.span_ns(at), data[at : at + 1])
        return start_ns + line.span_ns(len(data))

    around(patch, Receiver, "_send", act)


@msc_mutant("MSC-PHY-01")
def its_characters_take_a_twentieth_longer(patch: MonkeyPatch) -> None:
    """The transmitter's clock is that of 9143 baud."""
    _spread(patch, LineFormat(9143))


@msc_mutant("MSC-PHY-02")
def units_from_2_on_send_a_second_stop_bit(patch: MonkeyPatch) -> None:
    """On a shared line a character takes eleven bits."""
    line = LineFormat(9600, stop_half_bits=4)

    def act(go: Any_, receiver: Receiver, start_ns: int, data: bytes) -> int:
        if receiver._is_rs232:
            return int(go())
        for at in range(len(data)):
            go(start_ns + line.span_ns(at), data[at : at + 1])
        return start_ns + line.span_ns(len(data))

    around(patch, Receiver, "_send", act)


@msc_mutant("MSC-PHY-03", "MSC-PHY-04")
def it_tells_its_status_at_power_up(patch: MonkeyPatch) -> None:
    """A packet that nobody has asked for, a second after the supply has come."""

    def act(go: Any_, unit: Any, now: int) -> Any:
        body = b"RQSTAT," + unit._commands._status_reply(now)
        raw = resummed(bytes([2, unit._receiver.unit, 0, len(body), 0, 0]) + body + b"\0\0")
        return [*go(), Transmit(now + 1000 * MS, raw)]

    around(patch, MscController, "power_on", act)


@msc_mutant("MSC-PHY-05")
def xon_is_swallowed_in_blocks(patch: MonkeyPatch) -> None:
    """11h among the values of a BWRITE does not reach the receiver."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        return byte == XON and receiver.state is ReceiverState.BODY and len(receiver._packet) > 14

    hears(patch, takes)


# --- the form of replies -------------------------------------------------------------------------


@msc_mutant("MSC-PKT-01", "MSC-PKT-11")
def all_flags_have_a_sum_of_one_byte(patch: MonkeyPatch) -> None:
    """RFLAGS' reply ends with the low byte of its sum."""
    replies(patch, lambda raw: raw[:-2] + raw[-1:], "RFLAGS")


@msc_mutant("MSC-PKT-02")
def a_block_begins_with_a_03h(patch: MonkeyPatch) -> None:
    """The packet behind BREAD's ACK begins with an end of text."""
    replies(patch, lambda raw: bytes([ETX]) + raw[1:], "BREAD")


@msc_mutant("MSC-PKT-08")
def the_length_of_a_block_keeps_the_sign_of_its_low_byte(patch: MonkeyPatch) -> None:
    """BREAD's reply announces FF 86."""
    replies(patch, lambda raw: resummed(raw[:2] + b"\xff" + raw[3:]), "BREAD")


@msc_mutant("MSC-PKT-06")
def the_length_of_a_value_leaves_its_comma_out(patch: MonkeyPatch) -> None:
    """DREAD's reply announces nine bytes and has ten."""
    replies(patch, lambda raw: resummed(raw[:3] + bytes([raw[3] - 1]) + raw[4:]), "DREAD")


@msc_mutant("MSC-PKT-12", "MSC-PROP-01")
def bytes_above_7fh_count_negative_in_the_sum_of_a_value(patch: MonkeyPatch) -> None:
    """The sum of DREAD's reply is one of signed characters."""

    def change(raw: bytes) -> bytes:
        short = sum(256 for one in raw[1:-2] if one > 0x7F)
        return raw[:-2] + (sum(raw[1:-2]) - short & 0xFFFF).to_bytes(2, "big")

    replies(patch, change, "DREAD")


@msc_mutant("MSC-PKT-12")
def a_request_with_bytes_above_7fh_is_summed_with_their_sign(patch: MonkeyPatch) -> None:
    """A write whose values have bit 7 in an odd number of bytes is found wrong."""

    def is_right(raw: bytes) -> bool:
        return is_sum_right(raw) and sum(one > 0x7F for one in raw[8:-2]) % 2 == 0

    patch.setattr(receiver_module, "is_sum_right", is_right)


@msc_mutant("MSC-PKT-09", "MSC-PROP-02")
def a_block_number_above_255_is_refused(patch: MonkeyPatch) -> None:
    """A number of one byte is enough for everybody."""

    def act(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        if raw[4]:
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-PKT-09")
def a_block_number_that_comes_again_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """A read with the block number of the one before, if it is not 0, draws no reply."""

    def act(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        block = raw[4:6]
        is_again = any(block) and block == getattr(receiver, "block_before", b"")
        receiver.block_before = block
        if is_again and is_sum_right(raw):
            receiver._sign(now, now + receiver._delay_ns, ACK_BYTE, receiver._rest)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-PKT-18", "MSC-PKT-05")
def replies_carry_the_number_before(patch: MonkeyPatch) -> None:
    """Units from 2 on count themselves from 0."""

    def change(receiver: Receiver, raw: bytes) -> bytes:
        return resummed(raw[:1] + bytes([max(1, receiver.unit - 1)]) + raw[2:])

    packets_sent(patch, change)


@msc_mutant("MSC-PKT-21", "MSC-DWRITE-01")
def a_sum_of_a_value_has_nine_bits(patch: MonkeyPatch) -> None:
    """A DWRITE is right under a sum of 511 at most."""

    def is_right(raw: bytes) -> bool:
        return is_sum_right(raw) and (name_of(raw) != "DWRITE" or raw[-2] < 2)

    patch.setattr(receiver_module, "is_sum_right", is_right)


# --- the link ------------------------------------------------------------------------------------


def _of_a_write(receiver: Receiver, sign: bytes) -> bool:
    return sign == ACK_BYTE and name_of(receiver._request) in WRITES


@msc_mutant("MSC-LNK-01")
def a_flag_is_turned_without_a_word(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG are carried out and draw no ACK."""

    def act(go: Any_, receiver: Receiver, now: int, start_ns: int, sign: bytes, then: Any) -> Any:
        if sign == ACK_BYTE and name_of(receiver._request) in ("SFLAG", "CFLAG"):
            return receiver._stay_busy(now, start_ns, then)
        return go()

    around(patch, Receiver, "_sign", act)


@msc_mutant("MSC-LNK-14")
def the_ack_of_a_write_is_followed_by_a_nul(patch: MonkeyPatch) -> None:
    """It is a string, and its end is sent with it."""

    def act(go: Any_, receiver: Receiver, now: int, start_ns: int, sign: bytes, then: Any) -> Any:
        return go(now, start_ns, sign + b"\0" if _of_a_write(receiver, sign) else sign, then)

    around(patch, Receiver, "_sign", act)


@msc_mutant("MSC-LNK-14", "MSC-DWRITE-03")
def the_ack_of_a_write_waits_for_one(patch: MonkeyPatch) -> None:
    """A write's ACK comes again after T2, if the host has said nothing."""

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        receiver.alarm_ns = NEVER
        if is_sum_right(raw) and name_of(raw) in WRITES:
            receiver.alarm_ns = now + receiver._answer_ns
        go()

    def act(receiver: Receiver, now: int) -> None:
        receiver._send(now, ACK_BYTE)

    alarms(patch, act)
    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-LNK-06")
def a_write_that_breaks_off_is_carried_out(patch: MonkeyPatch) -> None:
    """At T1 a write that lacks its checksum alone is stored, and refused."""

    def act(go: Any_, receiver: Any, now: int) -> None:
        raw = bytes(receiver._packet)
        if len(raw) > 6 and len(raw) >= 6 + raw[3] and receiver._whom_of[raw[1]] is Whom.OWN:
            name = raw[6:].partition(b",")[0]
            if name.decode("latin-1") in WRITES:
                carry_out(receiver._examine.__self__, now, raw[6 : 6 + raw[3]])
        go()

    around(patch, Receiver, "_give_up_packet", act)


@msc_mutant("MSC-LNK-06")
def a_refused_read_is_answered_all_the_same(patch: MonkeyPatch) -> None:
    """A DREAD under a wrong sum draws NAK, and behind it the value."""

    def act(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        if name_of(raw) == "DREAD" and not is_sum_right(raw):
            verdict = receiver._examine(now, raw[6:-2])
            if verdict.reply is not None:
                receiver._request, receiver._verdict = raw, verdict
                receiver._sign(now, now + receiver._delay_ns, NAK_BYTE, receiver._send_reply)
                return
        go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-LNK-17")
def a_packet_has_255_ms(patch: MonkeyPatch) -> None:
    """The time limit is a byte of milliseconds: 3 ms too little for the longest packet."""

    def act(go: Any_, receiver: Any, *arguments: Any) -> None:
        go()
        receiver._packet_ns = 255 * MS
        receiver._packet_bytes = LINE_FORMAT.characters_within(receiver._packet_ns)

    around(patch, Receiver, "__init__", act)


@msc_mutant("MSC-LNK-19")
def writes_for_others_are_carried_out_silently(patch: MonkeyPatch) -> None:
    """A unit stores whatever is written to any other, and says nothing."""

    def act(receiver: Any, raw: bytes, now: int) -> bool:
        if is_sum_right(raw) and name_of(raw) in WRITES:
            carry_out(receiver._examine.__self__, now, raw[6:-2])
        return False

    listens_to_others(patch, act)


@msc_mutant("MSC-LNK-21")
def a_second_repeat_is_built_anew(patch: MonkeyPatch) -> None:
    """The first repeat is the packet that was sent, those behind it have the values of now and a
    block number of their own."""

    def act(go: Any_, receiver: Receiver, now: int, start_ns: int) -> None:
        if receiver._repeats:
            raw = receiver._reply
            receiver._reply = resummed(raw[:5] + bytes([receiver._repeats]) + raw[6:])
        go()

    around(patch, Receiver, "_repeat", act)


@msc_mutant("MSC-PROP-03", "MSC-LNK-03")
def a_pause_before_the_checksum_ends_a_packet(patch: MonkeyPatch) -> None:
    """Behind the body, the checksum has 40 ms to come."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        receiver.heard_ns = now
        return False

    def counted(go: Any_, receiver: Any, chunk: Any, at: int) -> Any:
        end = go()
        if receiver.state is ReceiverState.BODY and not receiver.is_busy and receiver._missing == 2:
            receiver._packet_due = receiver.heard_ns + 40 * MS
        return end

    hears(patch, takes)
    around(patch, Receiver, "_take_counted", counted)


@msc_mutant("MSC-PROP-15", "MSC-PKT-20")
def a_carriage_return_in_idle_is_refused(patch: MonkeyPatch) -> None:
    """0Dh ends a line that nobody understands."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_so = byte == CR and receiver.state is ReceiverState.IDLE
        if is_so:
            receiver._sign(now, now + receiver._delay_ns, NAK_BYTE, receiver._rest)
        return is_so

    hears(patch, takes)


@msc_mutant("MSC-PROP-16")
def noise_fills_the_receiver_up(patch: MonkeyPatch) -> None:
    """Of bytes that start no packet 48 fit in; then a start is no longer found for ten seconds."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        if receiver.state is not ReceiverState.IDLE:
            return False
        if now < getattr(receiver, "deaf_until", 0):
            return True
        receiver.noise = 0 if byte == 2 else getattr(receiver, "noise", 0) + 1
        if receiver.noise > 48:
            receiver.noise, receiver.deaf_until = 0, now + 20_000 * MS
        return False

    hears(patch, takes)


# --- commands ------------------------------------------------------------------------------------


@msc_mutant("MSC-CMD-01")
def what_parts_a_name_and_an_address_is_not_looked_at(patch: MonkeyPatch) -> None:
    """DREAD is known by its first five bytes; the sixth may be anything."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return go(now, b"DREAD," + body[6:]) if body[:5] == b"DREAD" and len(body) == 8 else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-02")
def all_flags_come_without_a_comma(patch: MonkeyPatch) -> None:
    """RFLAGS' reply is its name and 32 bytes."""
    replies(
        patch,
        lambda raw: resummed(raw[:3] + bytes([raw[3] - 1]) + raw[4:12] + raw[13:]),
        "RFLAGS",
    )


@msc_mutant("MSC-PKT-12")
def the_sum_of_a_value_leaves_its_comma_out(patch: MonkeyPatch) -> None:
    """DREAD's reply is summed without 2Ch."""
    replies(patch, lambda raw: raw[:-2] + total(raw[1:11] + raw[12:-2]), "DREAD")


@msc_mutant("MSC-CMD-05", "MSC-LNK-14")
def a_flag_that_is_set_is_told(patch: MonkeyPatch) -> None:
    """SFLAG draws its ACK, and a packet with its name."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        verdict = go()
        if body.startswith(b"SFLAG,") and verdict.act is not None:
            return verdict._replace(reply=lambda when: b"SFLAG," + body[6:])
        return verdict

    bodies(patch, act)


@msc_mutant("MSC-BWRITE-05", "MSC-CMD-05", "MSC-LNK-14")
def a_block_that_is_written_is_told(patch: MonkeyPatch) -> None:
    """BWRITE draws its ACK, and a packet with its name and address."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        verdict = go()
        if body.startswith(b"BWRITE,") and verdict.act is not None:
            return verdict._replace(reply=lambda when: body[:9])
        return verdict

    bodies(patch, act)


@msc_mutant("MSC-CMD-09")
def lower_case_letters_behind_the_first_are_refused_silently(patch: MonkeyPatch) -> None:
    """A name with a lower-case letter draws nothing, as a packet for another unit does."""

    def act(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        name = name_of(raw)
        if name != name.upper() and is_sum_right(raw):
            receiver._rest(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-CFLAG-01", "MSC-CMD-11")
def a_flag_in_one_byte_is_turned_off(patch: MonkeyPatch) -> None:
    """CFLAG takes a number of one byte as well."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        is_short = body.startswith(b"CFLAG,") and len(body) == 7
        return go(now, b"CFLAG,\0" + body[6:]) if is_short else go()

    bodies(patch, act)


@msc_mutant("MSC-MOD-01", "MSC-RFLAGS-01", model="msc-850-32")
def the_other_model_that_has_rflags_only_acknowledges_it(patch: MonkeyPatch) -> None:
    """The MSC-850/32 knows the name and has nothing to tell."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return ACCEPTED if body == b"RFLAGS," else go()

    bodies(patch, act)


@msc_mutant("MSC-MOD-02", model="msc-generic")
def another_model_says_nothing_to_rflags(patch: MonkeyPatch) -> None:
    """Other unknown names are refused, this one draws neither sign nor reply."""

    def act(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        if name_of(raw) == "RFLAGS" and is_sum_right(raw):
            receiver._rest(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-RFLAGS-01", "MSC-PKT-07")
def all_flags_are_told_with_their_number(patch: MonkeyPatch) -> None:
    """RFLAGS' reply begins with 01 00, the number of flags."""
    payloads(patch, lambda states: b"\x01\0" + states, "RFLAGS")


@msc_mutant("MSC-CMD-06")
def bwrite_is_not_known(patch: MonkeyPatch) -> None:
    """Values are written one by one."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return REFUSED if body.startswith(b"BWRITE,") else go()

    bodies(patch, act)
