"""Faults of the line: characters, time limits, and packets that are for others (PHY, LNK)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc import receiver as receiver_module
from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.packets import ACK, is_sum_right
from axistwin.devices.msc.receiver import REFUSED
from axistwin.kernel.effects import Transmit
from axistwin.wire.framing import Chunk, LineFormat
from zoo_msc.planting import (
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
    hears,
    listens_to_others,
    msc_mutant,
    name_of,
    replies,
)

TWO_STOP_BITS = LineFormat(9600, stop_half_bits=4)
XON, XOFF = 0x11, 0x13
NAK_BYTE = bytes([NAK])

# --- characters ----------------------------------------------------------------------------------


@msc_mutant("MSC-PHY-01")
def a_second_stop_bit_is_sent(patch: MonkeyPatch) -> None:
    """Its characters are read all the same, but take eleven bits each."""

    def act(go: Any_, receiver: Receiver, start_ns: int, data: bytes) -> int:
        for at in range(len(data)):
            go(start_ns + TWO_STOP_BITS.span_ns(at), data[at : at + 1])
        return start_ns + TWO_STOP_BITS.span_ns(len(data))

    around(patch, Receiver, "_send", act)


@msc_mutant("MSC-PHY-02")
def units_from_2_on_run_at_19200(patch: MonkeyPatch) -> None:
    """What is set on RS-232 is not what is set for a shared line."""

    def line_format(controller: Any) -> LineFormat:
        return LineFormat(19200) if controller._receiver.unit > 1 else LINE_FORMAT

    patch.setattr(MscController, "line_format", property(line_format))


@msc_mutant("MSC-PHY-03")
def it_says_something_when_nobody_asks(patch: MonkeyPatch) -> None:
    """Twenty seconds after an exchange a unit sends a NUL, to be heard of."""

    def rest(go: Any_, receiver: Any, now: int) -> None:
        go()
        receiver.alarm_ns = now + 20_000 * MS

    def act(receiver: Receiver, now: int) -> None:
        receiver._send(now, b"\0")

    alarms(patch, act)
    around(patch, Receiver, "_rest", rest)


@msc_mutant("MSC-PHY-04", "MSC-PHY-03")
def it_says_nak_at_power_up(patch: MonkeyPatch) -> None:
    """What the transmitter makes of its first edge is a NAK."""
    around(
        patch,
        MscController,
        "power_on",
        lambda go, unit, now: [*go(), Transmit(now + 100 * MS, NAK_BYTE)],
    )


@msc_mutant("MSC-PHY-04")
def a_power_cut_leaves_a_reply_to_be_acknowledged(patch: MonkeyPatch) -> None:
    """The link's memory is kept by the battery: after power-up it repeats an old reply."""

    def act(go: Any_, receiver: Any) -> None:
        waits = getattr(receiver, "state", None) is ReceiverState.WAIT
        kept = [(name, getattr(receiver, name)) for name in _OF_A_REPLY] if waits else []
        go()
        for name, value in kept:
            setattr(receiver, name, value)

    around(patch, Receiver, "reset", act)


_OF_A_REPLY = ("state", "_reply", "_repeats", "_rebuild", "_answer_due")


@msc_mutant("MSC-PHY-05")
def xoff_is_swallowed_in_replies(patch: MonkeyPatch) -> None:
    """13h in the reply to a DREAD is left out by a driver that keeps it for itself."""
    replies(patch, lambda raw: raw.replace(bytes([XOFF]), b""), "DREAD")


@msc_mutant("MSC-PHY-05")
def values_with_xon_or_xoff_are_refused(patch: MonkeyPatch) -> None:
    """A write whose value holds 11h or 13h is none."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        is_held = bool({XON, XOFF} & set(body[9:])) and body.startswith(b"DWRITE")
        return REFUSED if is_held else go()

    bodies(patch, act)


@msc_mutant("MSC-PKT-15")
def two_of_10h_in_a_row_count_as_one(patch: MonkeyPatch) -> None:
    """Its receiver takes stuffing out that nobody has put in: the body comes out short."""
    bodies(patch, lambda go, unit, now, body: REFUSED if b"\x10\x10" in body else go())


# --- T1 ------------------------------------------------------------------------------------------


@msc_mutant("MSC-LNK-03", "MSC-PROP-06", traps=(31,))
def there_is_no_packet_time_limit(patch: MonkeyPatch) -> None:
    """A packet that broke off waits for its end for ever."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        receiver._packet_due = NEVER

    around(patch, Receiver, "_begin_packet", act)


@msc_mutant("MSC-LNK-03", "MSC-PROP-06")
def a_packet_broken_off_is_dropped_silently(patch: MonkeyPatch) -> None:
    """When its time is over the receiver begins anew and says nothing."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        receiver._packet_due = NEVER
        receiver._rest(now)

    around(patch, Receiver, "_give_up_packet", act)


@msc_mutant("MSC-LNK-03", "MSC-PROP-06")
def a_packet_broken_off_is_refused_twice(patch: MonkeyPatch) -> None:
    """Once for its body, and once for its checksum."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        if len(receiver._packet) > 1 and receiver._whom_of[receiver._packet[1]] is Whom.OWN:
            receiver._packet_due = NEVER
            receiver._sign(now, now, NAK_BYTE * 2, receiver._rest)
        else:
            go()

    around(patch, Receiver, "_give_up_packet", act)


@msc_mutant("MSC-LNK-03", "MSC-PROP-06", "MSC-PROP-16")
def an_unfinished_header_waits_for_ever(patch: MonkeyPatch) -> None:
    """The time limit begins with the body."""

    def begin(go: Any_, receiver: Any, now: int) -> None:
        go()
        receiver.begun_ns, receiver._packet_due = receiver._packet_due, NEVER

    def judge(go: Any_, receiver: Any, now: int) -> None:
        receiver._packet_due = receiver.begun_ns
        go()

    around(patch, Receiver, "_begin_packet", begin)
    around(patch, Receiver, "_judge_header", judge)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-03", traps=(21,))
def the_time_limit_begins_with_noise(patch: MonkeyPatch) -> None:
    """The first byte of anything starts it, be it a packet's or not."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        if receiver.state is ReceiverState.IDLE and getattr(receiver, "noise_ns", None) is None:
            receiver.noise_ns = now
        return False

    def begin(go: Any_, receiver: Any, now: int) -> None:
        go()
        noise_ns, receiver.noise_ns = getattr(receiver, "noise_ns", None), None
        receiver._packet_due -= now - noise_ns if noise_ns is not None else 0
        receiver._packet_due = max(receiver._packet_due, now + MS)

    hears(patch, takes)
    around(patch, Receiver, "_begin_packet", begin)


@msc_mutant("MSC-LNK-11", "MSC-LNK-04", traps=(20,))
def the_packet_time_limit_outlives_the_packet(patch: MonkeyPatch) -> None:
    """It is not stopped by the last byte: a NAK comes a second after each start."""

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        receiver.alarm_ns = now - LINE_FORMAT.span_ns(len(raw) - 1) + receiver._packet_ns
        go()

    def act(receiver: Receiver, now: int) -> None:
        receiver._sign(now, now, NAK_BYTE, receiver._rest)

    alarms(patch, act)
    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-LNK-03")
def a_sign_in_a_packet_begins_its_time_anew(patch: MonkeyPatch) -> None:
    """A byte 06h or 15h in the header or the body starts T1 again."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        if receiver.state in (ReceiverState.HEADER, ReceiverState.BODY) and byte in (ACK, NAK):
            receiver._packet_due = now + receiver._packet_ns
        return False

    hears(patch, takes)


@msc_mutant("MSC-LNK-17")
def a_packet_has_200_ms(patch: MonkeyPatch) -> None:
    """Enough for every command, and too little for the longest body that is allowed."""

    def act(go: Any_, receiver: Any, *arguments: Any) -> None:
        go()
        receiver._packet_ns = 200 * MS
        receiver._packet_bytes = LINE_FORMAT.characters_within(receiver._packet_ns)

    around(patch, Receiver, "__init__", act)


@msc_mutant("MSC-PROP-03", "MSC-LNK-03")
def a_pause_of_100_ms_in_a_body_ends_a_packet(patch: MonkeyPatch) -> None:
    """From the third byte of a body on, the limit is one for each pause."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        receiver.heard_ns = now
        return False

    def counted(go: Any_, receiver: Any, chunk: Chunk, at: int) -> Any:
        end = go()
        if (
            receiver.state is ReceiverState.BODY
            and not receiver.is_busy
            and len(receiver._packet) > 8
        ):
            receiver._packet_due = receiver.heard_ns + 100 * MS
        return end

    hears(patch, takes)
    around(patch, Receiver, "_take_counted", counted)


@msc_mutant("MSC-LNK-22", "MSC-LNK-03")
def it_is_deaf_after_a_packet_broke_off(patch: MonkeyPatch) -> None:
    """For half a second after the NAK for it nothing is heard."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        return bool(
            now < getattr(receiver, "deaf_until", 0) and receiver.state is ReceiverState.IDLE
        )

    def act(go: Any_, receiver: Any, now: int) -> None:
        receiver.deaf_until = now + 500 * MS
        go()

    hears(patch, takes)
    around(patch, Receiver, "_give_up_packet", act)


# --- lengths that cannot be ----------------------------------------------------------------------


@msc_mutant("MSC-LNK-20", "MSC-PKT-10", traps=(30, 31))
def a_length_above_240_starts_no_packet(patch: MonkeyPatch) -> None:
    """A header that announces too much is noise."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver.state is ReceiverState.DISCARD:
            receiver._packet_due = NEVER
            receiver._rest(now)

    around(patch, Receiver, "_judge_header", act)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-20", traps=(30,))
def a_length_has_eight_bits(patch: MonkeyPatch) -> None:
    """The high byte of the length is not looked at; so it is 255 at most."""
    patch.setattr(receiver_module, "body_length", lambda raw: raw[3])
    patch.setattr(receiver_module, "BODY_MAX", 255)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-20", traps=(30,))
def the_high_byte_of_a_length_counts_half(patch: MonkeyPatch) -> None:
    """It is shifted by one bit too few: of 256 bytes the last 128 are left over."""
    patch.setattr(receiver_module, "body_length", lambda raw: raw[2] << 7 | raw[3])
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-02", traps=(30,))
def a_length_of_0_is_65536(patch: MonkeyPatch) -> None:
    """The loop counts down before it looks."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver.state is ReceiverState.BODY and receiver._missing == 2:
            receiver._missing += 0x10000

    around(patch, Receiver, "_judge_header", act)
    hears(patch, lambda receiver, byte, now: False)


# --- packets for others --------------------------------------------------------------------------


@msc_mutant("MSC-LNK-19", traps=(31,))
def the_length_of_others_has_eight_bits(patch: MonkeyPatch) -> None:
    """Of a packet for another unit the low byte of the length alone is counted off."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver.state is ReceiverState.SKIP:
            receiver._missing = receiver._packet[3] + 2

    around(patch, Receiver, "_judge_header", act)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-19", traps=(22,))
def a_wrong_sum_for_others_is_refused(patch: MonkeyPatch) -> None:
    """A unit says NAK to each bad packet that it hears."""

    def act(receiver: Receiver, raw: bytes, now: int) -> bool:
        is_bad = not is_sum_right(raw)
        if is_bad:
            receiver._refuse(now)
        return is_bad

    listens_to_others(patch, act)


@msc_mutant("MSC-LNK-19", "MSC-LNK-04", traps=(22,))
def what_breaks_off_for_others_is_refused(patch: MonkeyPatch) -> None:
    """A unit says NAK when the time of a packet is over, whoever it was for."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        if len(receiver._packet) > 1:
            receiver._packet_due = NEVER
            receiver._sign(now, now, NAK_BYTE, receiver._rest)
        else:
            go()

    around(patch, Receiver, "_give_up_packet", act)


@msc_mutant("MSC-PROP-14", traps=(23,))
def whoever_is_asked_for_a_flag_all_answer(patch: MonkeyPatch) -> None:
    """The unit number of an RFLAG, which is also what another unit's answer to it looks like, is
    not compared on a shared line."""

    def act(receiver: Receiver, raw: bytes, now: int) -> bool:
        is_taken = name_of(raw) == "RFLAG" and not receiver._is_rs232
        if is_taken:
            receiver._whom = Whom.OWN
            receiver._judge(raw, now)
        return is_taken

    listens_to_others(patch, act)


@msc_mutant("MSC-LNK-11", "MSC-LNK-16", traps=(8,))
def it_hears_its_own_flag_reply(patch: MonkeyPatch) -> None:
    """The receiver is not off while the transmitter is on: its own reply to RFLAG, byte for byte an
    RFLAG of flag 0 or 1, is served as one when the host has acknowledged it."""

    def act(go: Any_, receiver: Any, byte: int, now: int) -> None:
        own, receiver.heard_itself = getattr(receiver, "heard_itself", False), True
        if byte == ACK and name_of(receiver._reply) == "RFLAG" and not own:
            receiver._answer_due = NEVER
            receiver._whom = Whom.OWN
            receiver._judge(receiver._reply, now)
        else:
            receiver.heard_itself = False
            go()

    around(patch, Receiver, "_take_waiting", act)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-19")
def the_sum_of_others_is_not_skipped(patch: MonkeyPatch) -> None:
    """Of a packet for another unit the body is counted off, and its checksum is looked at for a
    start."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver.state is ReceiverState.SKIP:
            receiver._missing -= 2

    around(patch, Receiver, "_judge_header", act)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-PROP-14")
def a_refused_reply_of_a_neighbour_is_repeated_by_all(patch: MonkeyPatch) -> None:
    """A unit on a shared line that has once been asked something says it again at a NAK for the
    others; alone it does not."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        is_so = (
            byte == NAK and receiver.state is ReceiverState.IDLE and not receiver._is_rs232
            and bool(receiver._reply) and getattr(receiver, "is_others", False)
        )  # fmt: skip
        if is_so:
            receiver._repeat(now, now + receiver._delay_ns)
        return is_so

    def judge(go: Any_, receiver: Any, now: int) -> None:
        go()
        receiver.is_others = receiver._whom is Whom.OTHER

    hears(patch, takes)
    around(patch, Receiver, "_judge_header", judge)


def _untimed(patch: MonkeyPatch, is_so: Any_) -> None:
    """Let no time limit run in a packet for which `is_so(receiver)` when its header is over."""

    def judge(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if is_so(receiver):
            receiver._packet_due = NEVER

    around(patch, Receiver, "_judge_header", judge)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-03", "MSC-LNK-02")
def a_body_above_100_bytes_has_no_time_limit(patch: MonkeyPatch) -> None:
    """The limit would not be enough for it, somebody has thought."""
    _untimed(
        patch,
        lambda receiver: receiver.state is ReceiverState.BODY and receiver._missing > 102,
    )


@msc_mutant("MSC-LNK-20", "MSC-PKT-10", traps=(31,))
def what_is_discarded_has_no_time_limit(patch: MonkeyPatch) -> None:
    """A header that announces too much is refused when all of that has come, and not before."""
    _untimed(patch, lambda receiver: receiver.state is ReceiverState.DISCARD)


@msc_mutant("MSC-LNK-19", traps=(20, 22))
def the_time_limit_outlives_a_packet_for_others(patch: MonkeyPatch) -> None:
    """It is not stopped by the end of what is counted off: a NAK comes a second after its start."""

    def begin(go: Any_, receiver: Any, now: int) -> None:
        receiver.alarm_ns = NEVER
        go()

    def end(go: Any_, receiver: Any, now: int) -> None:
        due_ns, is_others = receiver._packet_due, receiver.state is ReceiverState.SKIP
        go()
        receiver.alarm_ns = due_ns if is_others else NEVER

    def act(receiver: Receiver, now: int) -> None:
        receiver._sign(now, now, NAK_BYTE, receiver._rest)

    alarms(patch, act)
    hears(patch, lambda receiver, byte, now: False)
    around(patch, Receiver, "_begin_packet", begin)
    around(patch, Receiver, "_end_packet", end)


@msc_mutant("MSC-LNK-19", "MSC-LNK-16", traps=(22,))
def a_packet_for_others_amid_a_wait_is_refused(patch: MonkeyPatch) -> None:
    """Who awaits the host's sign says NAK to whatever else is no packet of its own."""

    def begin(go: Any_, receiver: Any, now: int) -> None:
        receiver.is_amid = receiver.state is ReceiverState.WAIT
        go()

    def end(go: Any_, receiver: Any, now: int) -> None:
        if receiver.state is ReceiverState.SKIP and receiver.is_amid:
            receiver._packet_due = NEVER
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_begin_packet", begin)
    around(patch, Receiver, "_end_packet", end)
    hears(patch, lambda receiver, byte, now: False)
