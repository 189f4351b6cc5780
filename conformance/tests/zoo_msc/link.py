"""Faults of the link: signs, replies and their repeats, what is refused and what comes in between
(LNK)."""

from __future__ import annotations

from functools import partial
from typing import Any

from axistwin.devices.msc.packets import is_sum_right, packet
from zoo_msc.planting import (
    ACK,
    MS,
    NAK,
    NEVER,
    STX,
    Any_,
    MonkeyPatch,
    Receiver,
    ReceiverState,
    alarms,
    around,
    carry_out,
    hears,
    msc_mutant,
    name_of,
    resummed,
)

ACK_BYTE, NAK_BYTE = bytes([ACK]), bytes([NAK])
END_OF_TRANSMISSION = b"\x04"

# --- signs ---------------------------------------------------------------------------------------


def _signs(patch: MonkeyPatch, change: Any_) -> None:
    """Let the unit say `change(receiver, sign)` instead of each sign."""

    def act(go: Any_, receiver: Receiver, now: int, start_ns: int, sign: bytes, then: Any_) -> None:
        go(now, start_ns, change(receiver, sign), then)

    around(patch, Receiver, "_sign", act)


def _no_ack_to_the_status(patch: MonkeyPatch) -> None:
    def act(go: Any_, receiver: Receiver, now: int, start_ns: int, sign: bytes, then: Any) -> Any:
        if sign == ACK_BYTE and name_of(receiver._request) == "RQSTAT":
            return receiver._stay_busy(now, start_ns, then)
        return go()

    around(patch, Receiver, "_sign", act)


@msc_mutant("MSC-LNK-04")
def what_breaks_off_is_refused_without_end(patch: MonkeyPatch) -> None:
    """A packet that breaks off draws one NAK after the other."""

    def again(receiver: Receiver, now: int) -> None:
        receiver._sign(now, now + 10 * MS, NAK_BYTE, partial(again, receiver))

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go(now)
        if receiver.is_busy:
            receiver._then = partial(again, receiver)

    around(patch, Receiver, "_give_up_packet", act)


@msc_mutant("MSC-LNK-01", "MSC-LNK-07")
def the_status_comes_without_an_ack(patch: MonkeyPatch) -> None:
    """RQSTAT is answered by its packet alone."""

    _no_ack_to_the_status(patch)


@msc_mutant("MSC-LNK-01", "MSC-LNK-07")
def the_ack_comes_behind_the_status(patch: MonkeyPatch) -> None:
    """RQSTAT's packet is sent first, then that it was understood."""

    def send(go: Any_, receiver: Receiver, start_ns: int, data: bytes) -> Any:
        return go(start_ns, data + ACK_BYTE if name_of(data) == "RQSTAT" else data)

    _no_ack_to_the_status(patch)
    around(patch, Receiver, "_send", send)


@msc_mutant("MSC-LNK-02", "MSC-PROP-04")
def a_bad_packet_draws_nothing(patch: MonkeyPatch) -> None:
    """What is found invalid is dropped silently."""
    around(patch, Receiver, "_refuse", lambda go, receiver, now: receiver._rest(now))


@msc_mutant("MSC-LNK-02", "MSC-LNK-05")
def a_nak_is_a_packet(patch: MonkeyPatch) -> None:
    """A bad packet is answered by one with the body 15h."""
    _signs(
        patch,
        lambda receiver, sign: packet(receiver.unit, sign) if sign == NAK_BYTE else sign,
    )


@msc_mutant("MSC-LNK-04", "MSC-LNK-05", "MSC-PROP-04")
def a_nak_is_said_twice(patch: MonkeyPatch) -> None:
    """So that it is surely heard."""
    _signs(patch, lambda receiver, sign: sign * 2 if sign == NAK_BYTE else sign)


@msc_mutant("MSC-LNK-05")
def a_nak_has_a_checksum(patch: MonkeyPatch) -> None:
    """15h is followed by its sum, 00 15."""
    _signs(patch, lambda receiver, sign: sign + b"\0" + sign if sign == NAK_BYTE else sign)


@msc_mutant("MSC-LNK-22")
def a_packet_right_behind_a_nak_is_refused(patch: MonkeyPatch) -> None:
    """Once it has refused a packet a unit refuses the next one too."""

    def act(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        is_good = is_sum_right(raw)
        had, receiver.had_bad = getattr(receiver, "had_bad", False), not is_good
        if had and is_good:
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_judge", act)


# --- what is refused -----------------------------------------------------------------------------


def _refused(patch: MonkeyPatch, act: Any_) -> None:
    """Do `act(receiver, raw, now)` before a packet under a wrong sum is refused."""

    def judge(go: Any_, receiver: Receiver, raw: bytes, now: int) -> None:
        if not is_sum_right(raw):
            act(receiver, raw, now)
        go()

    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-LNK-06")
def a_refused_value_is_stored(patch: MonkeyPatch) -> None:
    """DWRITE and BWRITE are carried out before their sum is looked at."""

    def act(receiver: Any, raw: bytes, now: int) -> None:
        if name_of(raw) in ("DWRITE", "BWRITE"):
            carry_out(receiver._examine.__self__, now, raw[6:-2])

    _refused(patch, act)


@msc_mutant("MSC-LNK-06")
def a_refused_flag_is_turned(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG are carried out before their sum is looked at."""

    def act(receiver: Any, raw: bytes, now: int) -> None:
        if name_of(raw) in ("SFLAG", "CFLAG"):
            carry_out(receiver._examine.__self__, now, raw[6:-2])

    _refused(patch, act)


@msc_mutant("MSC-LNK-24", "MSC-LNK-04", traps=(2,))
def a_refused_packet_is_searched_for_another(patch: MonkeyPatch) -> None:
    """After a wrong sum the receiver looks for a start among the bytes that it has."""

    def act(receiver: Receiver, raw: bytes, now: int) -> None:
        at = raw.find(raw[:2], 1)
        inner = raw[at : at + 8 + raw[at + 3]] if 0 < at < len(raw) - 8 else b""
        if inner and is_sum_right(inner):
            receiver._kept += inner

    _refused(patch, act)


# --- the host's answer ---------------------------------------------------------------------------


def _waiting(patch: MonkeyPatch, act: Any_) -> None:
    """Let what is made of a byte while the host's answer is awaited be `act(go, receiver, byte,
    now)`."""
    around(patch, Receiver, "_take_waiting", act)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-08", "MSC-LNK-09", "MSC-LNK-10", "MSC-PROP-07")
def no_answer_of_the_host_is_awaited(patch: MonkeyPatch) -> None:
    """Once its reply has left, a unit is through with it."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        receiver._rest(now)

    around(patch, Receiver, "_await_answer", act)


@msc_mutant("MSC-LNK-11", traps=(13,))
def the_hosts_ack_is_acknowledged(patch: MonkeyPatch) -> None:
    """06h is answered by 06h."""

    def act(go: Any_, receiver: Receiver, byte: int, now: int) -> None:
        go()
        if byte == ACK:
            receiver._sign(now, now + receiver._delay_ns, ACK_BYTE, receiver._rest)

    _waiting(patch, act)


@msc_mutant("MSC-LNK-11", traps=(20,))
def the_hosts_ack_stops_no_timer(patch: MonkeyPatch) -> None:
    """A reply that was acknowledged comes again when the time for that is over."""

    def wait(go: Any_, receiver: Any, byte: int, now: int) -> None:
        due_ns = receiver._answer_due
        go()
        if byte == ACK:
            receiver.alarm_ns = due_ns

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        receiver.alarm_ns = NEVER
        go()

    def act(receiver: Receiver, now: int) -> None:
        receiver._send(now, receiver._reply)

    alarms(patch, act)
    _waiting(patch, wait)
    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-LNK-09", "MSC-PROP-07", traps=(18,))
def a_reply_is_repeated_six_times(patch: MonkeyPatch) -> None:
    """The count is looked at before it is raised."""
    around(patch, Receiver, "__init__", _with("_repeats_max", 6))


@msc_mutant("MSC-LNK-09", traps=(18,))
def a_reply_is_repeated_three_times(patch: MonkeyPatch) -> None:
    """Neither five repeats nor five sendings."""
    around(patch, Receiver, "__init__", _with("_repeats_max", 3))


def _with(name: str, value: int) -> Any_:
    def act(go: Any_, receiver: Receiver, *arguments: Any) -> None:
        go()
        setattr(receiver, name, value)

    return act


@msc_mutant("MSC-LNK-09", "MSC-PROP-07", traps=(19,))
def the_count_of_repeats_is_kept(patch: MonkeyPatch) -> None:
    """It belongs to the unit, not to a reply, and begins anew when a unit has given up."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        before = receiver._repeats
        go()
        receiver._repeats = before

    def repeat(go: Any_, receiver: Receiver, now: int, start_ns: int) -> None:
        is_over = receiver._repeats >= receiver._repeats_max
        go()
        if is_over:
            receiver._repeats = 0

    around(patch, Receiver, "_send_reply", act)
    around(patch, Receiver, "_repeat", repeat)


def _repeats(patch: MonkeyPatch, change: Any_) -> None:
    """Let the unit send `change(receiver, raw)` as a repeat."""

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        receiver.is_repeating = True
        go()
        receiver.is_repeating = False

    def send(go: Any_, receiver: Any, start_ns: int, data: bytes) -> Any:
        is_so = getattr(receiver, "is_repeating", False) and data[:1] == b"\x02"
        return go(start_ns, change(receiver, data) if is_so else data)

    around(patch, Receiver, "_repeat", repeat)
    around(patch, Receiver, "_send", send)


@msc_mutant("MSC-LNK-10", traps=(16,))
def an_ack_is_said_before_a_repeat(patch: MonkeyPatch) -> None:
    """The repeat is sent by what sends a reply, ACK included."""
    _repeats(patch, lambda receiver, raw: ACK_BYTE + raw)


@msc_mutant("MSC-LNK-21")
def a_repeat_counts_in_its_block_number(patch: MonkeyPatch) -> None:
    """It is the same packet, but for the number of the repeat."""
    _repeats(
        patch,
        lambda receiver, raw: resummed(raw[:5] + bytes([receiver._repeats]) + raw[6:]),
    )


@msc_mutant("MSC-LNK-10", traps=(17,))
def a_repeat_has_new_values_under_its_old_sum(patch: MonkeyPatch) -> None:
    """The values are looked at again, the packet around them is kept."""

    def change(receiver: Any, raw: bytes) -> Any:
        return raw[:6] + receiver._rebuild(receiver.now_ns) + raw[-2:]

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        receiver.now_ns = now
        go()

    _repeats(patch, change)
    around(patch, Receiver, "_repeat", repeat)


@msc_mutant("MSC-LNK-21")
def a_repeat_has_the_flags_of_now(patch: MonkeyPatch) -> None:
    """Values are repeated as they were; flags as they are."""

    def repeat(go: Any_, receiver: Receiver, now: int, start_ns: int) -> None:
        if name_of(receiver._reply) in ("RFLAG", "RFLAGS"):
            body = receiver._rebuild(now)
            receiver._reply = packet(receiver._reply_unit, body, receiver._block)
        go()

    around(patch, Receiver, "_repeat", repeat)


@msc_mutant("MSC-LNK-10")
def a_repeat_lacks_its_start(patch: MonkeyPatch) -> None:
    """The pointer stands behind the first byte when the packet is sent again."""
    _repeats(patch, lambda receiver, raw: raw[1:])


@msc_mutant("MSC-LNK-13")
def giving_up_is_said(patch: MonkeyPatch) -> None:
    """A second after the last NAK comes an end of transmission."""

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        if receiver._repeats >= receiver._repeats_max:
            receiver.alarm_ns = now + 1000 * MS
        go()

    def act(receiver: Receiver, now: int) -> None:
        receiver._send(now, END_OF_TRANSMISSION)

    alarms(patch, act)
    around(patch, Receiver, "_repeat", repeat)


@msc_mutant("MSC-LNK-13")
def who_has_given_up_refuses_the_next_packet(patch: MonkeyPatch) -> None:
    """What comes behind a reply that was never acknowledged draws a NAK."""

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        receiver.has_given_up = receiver._repeats >= receiver._repeats_max
        go()

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        had, receiver.has_given_up = getattr(receiver, "has_given_up", False), False
        if had:
            receiver._refuse(now)
        else:
            go()

    around(patch, Receiver, "_repeat", repeat)
    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-LNK-12")
def the_time_to_a_repeat_doubles(patch: MonkeyPatch) -> None:
    """Each repeat is awaited twice as long as the one before."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        receiver._answer_due += receiver._answer_ns * ((1 << receiver._repeats) - 1)

    around(patch, Receiver, "_await_answer", act)


@msc_mutant("MSC-LNK-09")
def a_repeat_by_time_out_does_not_count(patch: MonkeyPatch) -> None:
    """Only NAKs use the five repeats up; behind the first of them, time-outs give seven more."""

    def act(go: Any_, receiver: Any, now: int) -> None:
        before = receiver._repeats
        receiver.by_time = getattr(receiver, "by_time", 0) + 1
        go()
        if 0 < before < receiver._repeats_max and receiver.by_time < 8:
            receiver._repeats = before

    def reply(go: Any_, receiver: Any, now: int) -> None:
        receiver.by_time = 0
        go()

    around(patch, Receiver, "_give_up_waiting", act)
    around(patch, Receiver, "_send_reply", reply)


# --- what comes in between -----------------------------------------------------------------------


def _acknowledged_again(patch: MonkeyPatch, name: str) -> None:
    def act(go: Any_, receiver: Receiver, now: int) -> None:
        if receiver._verdict.sign == ACK_BYTE and name_of(receiver._request) == name:
            receiver._sign(now, now + MS, ACK_BYTE, receiver._rest)
        else:
            go()

    around(patch, Receiver, "_send_reply", act)


@msc_mutant("MSC-LNK-14", "MSC-DWRITE-03")
def a_dwrite_is_acknowledged_again_when_it_is_done(patch: MonkeyPatch) -> None:
    """One ACK says that it was understood, another one that it has been carried out."""
    _acknowledged_again(patch, "DWRITE")


@msc_mutant("MSC-LNK-14", "MSC-LNK-04", "MSC-BWRITE-05")
def a_bwrite_is_acknowledged_again_when_it_is_done(patch: MonkeyPatch) -> None:
    """One ACK says that it was understood, another one that its values are stored."""
    _acknowledged_again(patch, "BWRITE")


def _in_idle(patch: MonkeyPatch, byte: int, sign: bytes) -> None:
    def takes(receiver: Receiver, heard: int, now: int) -> bool:
        is_so = heard == byte and receiver.state is ReceiverState.IDLE and receiver.unit == 1
        if is_so:
            receiver._sign(now, now + receiver._delay_ns, sign, receiver._rest)
        return is_so

    hears(patch, takes)


@msc_mutant("MSC-LNK-15", "MSC-LNK-11", "MSC-LNK-14", traps=(13,))
def an_ack_to_nothing_is_refused(patch: MonkeyPatch) -> None:
    """06h sent to unit 1 while it is idle draws NAK."""
    _in_idle(patch, ACK, NAK_BYTE)


@msc_mutant("MSC-LNK-15")
def a_nak_to_nothing_is_acknowledged(patch: MonkeyPatch) -> None:
    """15h sent to unit 1 while it is idle draws ACK."""
    _in_idle(patch, NAK, ACK_BYTE)


@msc_mutant("MSC-LNK-16")
def the_old_reply_comes_behind_the_new_one(patch: MonkeyPatch) -> None:
    """A packet sent instead of the ACK is served, and the reply that nobody has acknowledged comes
    again all the same, when it is its time."""

    def wait(go: Any_, receiver: Any, byte: int, now: int) -> None:
        if byte == STX:
            receiver.alarm_ns, receiver.old = receiver._answer_due, receiver._reply
        go()

    def act(receiver: Any, now: int) -> None:
        receiver._send(now, receiver.old)

    alarms(patch, act)
    _waiting(patch, wait)


def _wait_survives(patch: MonkeyPatch, name: str, act: Any_) -> None:
    """Let `act(go, receiver, now)` be done instead of that method amid a packet that came while the
    host's sign was awaited."""

    def begin(go: Any_, receiver: Any, now: int) -> None:
        receiver.was_waiting = receiver.state is ReceiverState.WAIT
        go()

    def method(go: Any_, receiver: Any, now: int) -> None:
        if getattr(receiver, "was_waiting", False):
            act(go, receiver, now)
        else:
            go()

    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)
    around(patch, Receiver, "_begin_packet", begin)
    around(patch, Receiver, name, method)


@msc_mutant("MSC-LNK-16")
def a_wrong_sum_does_not_end_the_wait(patch: MonkeyPatch) -> None:
    """Behind the NAK for what came instead of the host's sign, the old reply is awaited again."""

    def act(_: Any_, receiver: Receiver, now: int) -> None:
        receiver._sign(now, now + receiver._delay_ns, NAK_BYTE, receiver._await_answer)

    _wait_survives(patch, "_refuse", act)


@msc_mutant("MSC-LNK-16")
def a_packet_that_breaks_off_does_not_end_the_wait(patch: MonkeyPatch) -> None:
    """Behind the NAK at T1, the old reply is awaited again."""

    def act(_: Any_, receiver: Receiver, now: int) -> None:
        receiver._packet_due = NEVER
        receiver._sign(now, now, NAK_BYTE, receiver._await_answer)

    _wait_survives(patch, "_give_up_packet", act)


@msc_mutant("MSC-LNK-16", "MSC-LNK-14")
def a_write_does_not_end_the_wait(patch: MonkeyPatch) -> None:
    """Behind the ACK to a write that came instead of the host's sign, the old reply is awaited."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        go()
        if receiver._verdict.reply is None:
            receiver._await_answer(now)

    _wait_survives(patch, "_obey", act)


@msc_mutant("MSC-LNK-16")
def t2_goes_on_while_a_packet_is_carried_out(patch: MonkeyPatch) -> None:
    """T2 runs out, and the reply is repeated, amid the exchange that has ended the wait for it."""

    def act(go: Any_, receiver: Receiver, chunk: Any) -> None:
        is_amid = receiver.state is ReceiverState.WAIT and chunk.data[0] == STX
        old_due = receiver._answer_due
        go()
        if is_amid and receiver._busy_until != NEVER and is_sum_right(chunk.data):
            receiver._answer_due = old_due

    around(patch, Receiver, "receive", act)


@msc_mutant("MSC-LNK-04")
def what_comes_behind_a_write_is_left_lying(patch: MonkeyPatch) -> None:
    """What has come while a write was ACKed is looked at after the next exchange."""

    def act(go: Any_, receiver: Receiver, now: int) -> None:
        if receiver._verdict.reply is not None:
            go()

    around(patch, Receiver, "_send_reply", act)


@msc_mutant("MSC-LNK-09", traps=(19,))
def a_reply_amid_a_wait_takes_the_count_over(patch: MonkeyPatch) -> None:
    """The repeats of the old reply count for the one that takes its place."""

    def begin(go: Any_, receiver: Any, now: int) -> None:
        receiver.counted = receiver._repeats if receiver.state is ReceiverState.WAIT else 0
        go()

    def reply(go: Any_, receiver: Any, now: int) -> None:
        go()
        receiver._repeats = receiver.counted

    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)
    around(patch, Receiver, "_begin_packet", begin)
    around(patch, Receiver, "_send_reply", reply)


@msc_mutant("MSC-LNK-08", "MSC-LNK-12")
def another_byte_than_a_sign_garbles_the_repeat(patch: MonkeyPatch) -> None:
    """What is heard while the host's answer is awaited is written over the reply."""

    def wait(go: Any_, receiver: Receiver, byte: int, now: int) -> None:
        if byte not in (ACK, NAK, STX):
            receiver._reply = receiver._reply[:8] + bytes([byte]) + receiver._reply[9:]
        go()

    _waiting(patch, wait)
