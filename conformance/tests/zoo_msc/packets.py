"""Faults of packets: their form, their sums, their unit and block numbers (PKT)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc import receiver as receiver_module
from axistwin.devices.msc.packets import concerned, is_sum_right
from axistwin.devices.msc.receiver import REFUSED
from zoo_msc.planting import (
    ACK,
    NAK,
    NEVER,
    STX,
    Any_,
    Commands,
    MonkeyPatch,
    Receiver,
    ReceiverState,
    Whom,
    accepts,
    around,
    bodies,
    hears,
    msc_mutant,
    packets_sent,
    payloads,
    replies,
    resummed,
    total,
)

CR = 0x0D
VALUES_AT = 14  # in a BWRITE or DWRITE: behind name and address

# --- the form of replies -------------------------------------------------------------------------


@msc_mutant("MSC-PKT-02", "MSC-PKT-17")
def a_flags_reply_begins_with_01h(patch: MonkeyPatch) -> None:
    """The packet behind RFLAG's ACK begins with a start of heading."""
    replies(patch, lambda raw: b"\x01" + raw[1:], "RFLAG")


@msc_mutant("MSC-PKT-01", "MSC-PKT-17")
def a_flags_reply_has_no_block_number(patch: MonkeyPatch) -> None:
    """What is not used at present is left out of it: its header has four bytes."""
    replies(patch, lambda raw: raw[:4] + raw[6:], "RFLAG")


@msc_mutant("MSC-PKT-06")
def the_length_of_a_flags_reply_counts_its_sum(patch: MonkeyPatch) -> None:
    """Its length is that of body and checksum."""
    replies(patch, lambda raw: resummed(raw[:3] + bytes([raw[3] + 2]) + raw[4:]), "RFLAG")


@msc_mutant("MSC-PKT-06")
def the_length_of_a_flags_reply_counts_its_header(patch: MonkeyPatch) -> None:
    """Its length is that of the whole packet."""
    replies(patch, lambda raw: resummed(raw[:3] + bytes([len(raw)]) + raw[4:]), "RFLAG")


@msc_mutant("MSC-PKT-08")
def the_length_of_a_block_goes_low_byte_first(patch: MonkeyPatch) -> None:
    """BREAD's reply announces 86 00."""
    replies(patch, lambda raw: raw[:2] + raw[3:1:-1] + raw[4:], "BREAD")


@msc_mutant("MSC-PKT-16")
def a_byte_follows_each_packet(patch: MonkeyPatch) -> None:
    """The transmitter sends one byte more than a packet has."""
    packets_sent(patch, lambda receiver, raw: raw + b"\0")


@msc_mutant("MSC-PKT-10", "MSC-PKT-16")
def a_block_has_64_values(patch: MonkeyPatch) -> None:
    """BREAD's reply has 263 bytes of body."""
    payloads(patch, lambda values: values + values, "BREAD")


@msc_mutant("MSC-PKT-07", "MSC-RFLAGS-01")
def all_flags_come_in_a_body_of_even_length(patch: MonkeyPatch) -> None:
    """RFLAGS' reply of 39 bytes is filled up to 40."""
    payloads(patch, lambda states: states + b"\0", "RFLAGS")


# --- bodies of requests --------------------------------------------------------------------------


@msc_mutant("MSC-PKT-07", "MSC-BWRITE-01", traps=(7,))
def the_buffer_has_136_bytes(patch: MonkeyPatch) -> None:
    """Who counts 32 values, an address and the name without its comma, refuses BWRITE."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        return REFUSED if len(body) > 136 else go()

    bodies(patch, act)


@msc_mutant("MSC-PKT-07", "MSC-BWRITE-01", traps=(7,))
def a_long_body_has_an_even_length(patch: MonkeyPatch) -> None:
    """Of a body of 137 bytes 136 are taken."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        length = receiver._packet[2] << 8 | receiver._packet[3]
        receiver._missing -= length > 100 and length % 2

    around(patch, Receiver, "_judge_header", act)
    hears(patch, lambda receiver, byte, now: False)


# --- checksums -----------------------------------------------------------------------------------


@msc_mutant("MSC-PKT-11")
def a_flags_reply_has_its_sum_low_byte_first(patch: MonkeyPatch) -> None:
    """Its last two bytes are exchanged."""
    replies(patch, lambda raw: raw[:-2] + raw[:-3:-1], "RFLAG")


@msc_mutant("MSC-PKT-11", "MSC-LNK-02")
def a_sum_may_go_low_byte_first(patch: MonkeyPatch) -> None:
    """Either order of a request's checksum is right."""
    accepts(patch, lambda raw: total(raw[1:-2]) == raw[:-3:-1])


@msc_mutant("MSC-PKT-12", "MSC-LNK-02", traps=(4,))
def a_sum_may_count_the_start(patch: MonkeyPatch) -> None:
    """A checksum that counts the 02h is right as well."""
    accepts(patch, lambda raw: total(raw[:-2]) == raw[-2:])


@msc_mutant("MSC-PKT-12", "MSC-LNK-02", traps=(4,))
def a_sum_may_leave_the_unit_out(patch: MonkeyPatch) -> None:
    """A checksum that begins with the length is right as well."""
    accepts(patch, lambda raw: total(raw[2:-2]) == raw[-2:])


@msc_mutant("MSC-PKT-12", "MSC-LNK-02", traps=(4,))
def a_sum_may_leave_the_length_out(patch: MonkeyPatch) -> None:
    """A checksum without the length is right as well."""
    accepts(patch, lambda raw: total(raw[1:2] + raw[4:-2]) == raw[-2:])


@msc_mutant("MSC-PKT-12", "MSC-LNK-02", traps=(4,))
def a_sum_may_leave_the_block_number_out(patch: MonkeyPatch) -> None:
    """A checksum without the block number is right as well."""
    accepts(patch, lambda raw: total(raw[1:4] + raw[6:-2]) == raw[-2:])


@msc_mutant("MSC-PKT-12", "MSC-LNK-02", "MSC-PROP-04", traps=(4,))
def the_low_byte_of_a_sum_decides(patch: MonkeyPatch) -> None:
    """A checksum is right if its low byte is."""
    accepts(patch, lambda raw: total(raw[1:-2])[1] == raw[-1])


@msc_mutant("MSC-PKT-12", "MSC-PROP-04")
def no_sum_is_looked_at(patch: MonkeyPatch) -> None:
    """Every packet that is complete is served."""
    accepts(patch, lambda raw: True)


@msc_mutant("MSC-PKT-12", "MSC-PKT-11")
def a_sum_above_32767_is_wrong(patch: MonkeyPatch) -> None:
    """The checksum is kept in fifteen bits."""
    patch.setattr(receiver_module, "is_sum_right", lambda raw: raw[-2] < 0x80 and is_sum_right(raw))


@msc_mutant("MSC-PKT-12", traps=(4,))
def the_sum_of_a_flags_reply_has_eight_bits(patch: MonkeyPatch) -> None:
    """Its high byte is always 0."""
    replies(patch, lambda raw: raw[:-2] + bytes([0, raw[-1]]), "RFLAG")


@msc_mutant("MSC-PKT-12", "MSC-PROP-01", traps=(29,))
def the_block_number_is_echoed_into_the_sum_alone(patch: MonkeyPatch) -> None:
    """A reply is summed with the block number of its request, which its header does not have."""

    def change(receiver: Receiver, raw: bytes) -> bytes:
        return raw[:-2] + total(raw[1:-2] + receiver._request[4:6])

    packets_sent(patch, change)


@msc_mutant("MSC-PKT-12", traps=(29,))
def the_block_number_is_echoed_into_the_header_alone(patch: MonkeyPatch) -> None:
    """A reply has the block number of its request, which its sum does not count."""
    packets_sent(patch, lambda receiver, raw: raw[:4] + receiver._request[4:6] + raw[6:])


# --- unit and block numbers ----------------------------------------------------------------------


@msc_mutant("MSC-PKT-03", "MSC-PKT-04", traps=(37,))
def a_flags_reply_carries_its_unit_as_text(patch: MonkeyPatch) -> None:
    """Unit 1 is 31h there."""
    replies(patch, lambda raw: resummed(raw[:1] + bytes([raw[1] | 0x30]) + raw[2:]), "RFLAG")


@msc_mutant("MSC-PKT-03", traps=(37,))
def four_bits_of_a_unit_number_count(patch: MonkeyPatch) -> None:
    """31h, the character 1, is unit 1 as well."""

    def masked(unit: int, quirks: Any, *, is_rs232: bool) -> tuple[Whom, ...]:
        whom = concerned(unit, quirks, is_rs232=is_rs232)
        return tuple(whom[byte & 0x0F] for byte in range(256))

    patch.setattr(receiver_module, "concerned", masked)


@msc_mutant("MSC-PKT-05", "MSC-LNK-19")
def the_third_switch_is_not_read(patch: MonkeyPatch) -> None:
    """On RS-485 a unit answers the number 4 above or below its own too."""

    def masked(unit: int, quirks: Any, *, is_rs232: bool) -> tuple[Whom, ...]:
        whom = concerned(unit, quirks, is_rs232=is_rs232)
        if is_rs232:
            return whom
        return tuple(Whom.OWN if byte == unit ^ 4 else one for byte, one in enumerate(whom))

    patch.setattr(receiver_module, "concerned", masked)


@msc_mutant("MSC-PKT-18", "MSC-PKT-05")
def replies_carry_unit_1(patch: MonkeyPatch) -> None:
    """Whatever the switch says."""
    packets_sent(patch, lambda receiver, raw: resummed(raw[:1] + b"\1" + raw[2:]))


@msc_mutant("MSC-PKT-04")
def on_rs232_another_number_is_answered_in_part(patch: MonkeyPatch) -> None:
    """A packet for another unit draws NAK if its number is even, and nothing if it is odd."""

    def mixed(unit: int, quirks: Any, *, is_rs232: bool) -> tuple[Whom, ...]:
        whom = concerned(unit, quirks, is_rs232=is_rs232)
        if not is_rs232:
            return whom
        return tuple(
            Whom.REFUSED if 1 < byte < 16 and byte % 2 == 0 else one
            for byte, one in enumerate(whom)
        )

    patch.setattr(receiver_module, "concerned", mixed)


@msc_mutant("MSC-PKT-09", "MSC-PROP-02")
def a_block_number_has_to_be_0(patch: MonkeyPatch) -> None:
    """What is not used at present is refused if it is there."""

    def act(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        if raw[4] or raw[5]:
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-PKT-19")
def a_reply_has_the_low_byte_of_the_block_number(patch: MonkeyPatch) -> None:
    """Neither 0 nor the request's number: the low byte of that."""

    def change(receiver: Receiver, raw: bytes) -> bytes:
        return resummed(raw[:5] + receiver._request[5:6] + raw[6:])

    packets_sent(patch, change)


# --- bytes of values -----------------------------------------------------------------------------


@msc_mutant("MSC-PKT-14", "MSC-DREAD-02", "MSC-DWRITE-02", traps=(6,))
def a_value_is_read_low_byte_first(patch: MonkeyPatch) -> None:
    """DREAD's reply has the four bytes the other way round."""
    payloads(patch, lambda value: value[::-1], "DREAD")


@msc_mutant("MSC-PKT-14", "MSC-DWRITE-01", traps=(6,))
def an_address_is_written_to_low_byte_first(patch: MonkeyPatch) -> None:
    """DWRITE takes the high byte of its address for the low one."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, _, values = body.partition(b",")
        if name != b"DWRITE":
            return go()
        return go(now, b"DWRITE," + values[1::-1] + values[2:])

    bodies(patch, act)


@msc_mutant("MSC-PKT-14", "MSC-DREAD-02", traps=(6,))
def values_go_low_byte_first_both_ways(patch: MonkeyPatch) -> None:
    """What the host writes it reads, but the program sees another number, and the host the
    program's."""

    def swapped(values: bytes) -> bytes:
        return b"".join(values[at : at + 4][::-1] for at in range(0, len(values), 4))

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, _, values = body.partition(b",")
        if name in (b"DWRITE", b"BWRITE"):
            return go(now, name + b"," + values[:2] + swapped(values[2:]))
        return go()

    bodies(patch, act)
    payloads(patch, swapped, "DREAD", "BREAD")


def _in_a_body(receiver: Receiver) -> bool:
    """Whether the next byte is one of a body, not of the checksum."""
    return receiver.state is ReceiverState.BODY and receiver._missing > 2


@msc_mutant("MSC-PKT-15", traps=(2,))
def a_02h_in_a_body_starts_a_packet(patch: MonkeyPatch) -> None:
    """The receiver begins anew at any 02h of a body."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_start = byte == STX and _in_a_body(receiver)
        if is_start:
            receiver._begin_packet(now)
        return is_start

    hears(patch, takes)


@msc_mutant("MSC-PKT-15", traps=(2,))
def a_02h_in_a_block_number_starts_a_packet(patch: MonkeyPatch) -> None:
    """The receiver begins anew at a 02h behind the length."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_start = (
            byte == STX and receiver.state is ReceiverState.HEADER and len(receiver._packet) > 3
        )
        if is_start:
            receiver._begin_packet(now)
        return is_start

    hears(patch, takes)


@msc_mutant("MSC-PKT-15", traps=(3,))
def signs_are_taken_out_of_values(patch: MonkeyPatch) -> None:
    """06h and 15h among values are somebody's answer and belong to no packet."""
    hears(
        patch,
        lambda receiver, byte, now: (
            byte in (ACK, NAK) and _in_a_body(receiver) and len(receiver._packet) > VALUES_AT
        ),
    )


@msc_mutant("MSC-PKT-15", "MSC-PKT-21", traps=(1,))
def a_carriage_return_ends_a_header(patch: MonkeyPatch) -> None:
    """A line editor stands in front of the receiver, and 0Dh is also DWRITE's length."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_end = byte == CR and receiver.state is ReceiverState.HEADER
        if is_end:
            receiver._rest(now)
        return is_end

    hears(patch, takes)


@msc_mutant("MSC-PKT-15", "MSC-LNK-04", traps=(2,))
def a_packet_inside_a_packet_is_served_too(patch: MonkeyPatch) -> None:
    """A served packet is searched for another one."""

    def act(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        at = raw.find(raw[:2], 1)
        inner = raw[at : at + 8 + raw[at + 3]] if 0 < at < len(raw) - 8 else b""
        if inner and is_sum_right(raw) and is_sum_right(inner):
            receiver._kept += inner
        go()

    around(patch, Receiver, "_judge", act)


@msc_mutant("MSC-PKT-20", "MSC-PROP-15")
def a_byte_above_7fh_in_idle_is_acknowledged(patch: MonkeyPatch) -> None:
    """Unit 1 says 06h to it; other bytes that start no packet are ignored."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_so = byte > 0x7F and receiver.state is ReceiverState.IDLE and receiver.unit == 1
        if is_so:
            receiver._sign(now, now + receiver._delay_ns, bytes([ACK]), receiver._rest)
        return is_so

    hears(patch, takes)


# --- sizes ---------------------------------------------------------------------------------------


def _headers(patch: MonkeyPatch, act: Any_) -> None:
    """Do `act(receiver, size, now)` when a header is judged that announces so many bytes."""

    def judge(go: Any_, receiver: Receiver, now: int) -> None:
        size = receiver._packet[2] << 8 | receiver._packet[3]
        go()
        act(receiver, size, now)

    around(patch, Receiver, "_judge_header", judge)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-PKT-10", "MSC-PKT-15", "MSC-LNK-04")
def a_body_of_240_bytes_is_too_long(patch: MonkeyPatch) -> None:
    """Its header is refused, and what it announced is noise, or packets."""

    def act(receiver: Receiver, size: int, now: int) -> None:
        if receiver.state is ReceiverState.BODY and size == 240:
            receiver._packet_due = NEVER
            receiver._refuse(now)

    _headers(patch, act)


@msc_mutant("MSC-PKT-15", "MSC-LNK-04", traps=(30,))
def an_empty_body_has_a_byte(patch: MonkeyPatch) -> None:
    """The loop over a body looks behind its first byte whether it is over."""

    def act(receiver: Receiver, size: int, now: int) -> None:
        receiver._missing += receiver.state is ReceiverState.BODY and not size

    _headers(patch, act)


@msc_mutant("MSC-PKT-15", "MSC-LNK-22")
def a_body_of_more_than_138_bytes_lacks_its_last(patch: MonkeyPatch) -> None:
    """What no command has is counted by a buffer that is one byte smaller."""

    def act(receiver: Receiver, size: int, now: int) -> None:
        receiver._missing -= receiver.state is ReceiverState.BODY and size > 138

    _headers(patch, act)


@msc_mutant("MSC-LNK-19", traps=(30,))
def an_empty_body_of_others_has_a_byte(patch: MonkeyPatch) -> None:
    """The same in what is counted off for another unit alone."""

    def act(receiver: Receiver, size: int, now: int) -> None:
        receiver._missing += receiver.state is ReceiverState.SKIP and not size

    _headers(patch, act)
