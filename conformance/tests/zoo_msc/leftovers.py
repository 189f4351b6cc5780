"""Faults of what is left over: counts, errors and places that an earlier packet leaves behind."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc.commands import COMMANDS
from axistwin.devices.msc.packets import is_sum_right
from axistwin.devices.msc.receiver import ACCEPTED
from axistwin.devices.msc.status import StatusBit
from zoo_msc.planting import (
    ACK,
    NAK,
    STX,
    Any_,
    Commands,
    MonkeyPatch,
    Receiver,
    ReceiverState,
    around,
    bodies,
    hears,
    msc_mutant,
    name_of,
)

SCRATCH_END = 5120  # behind it are the bench program's variables
BLOCK_BYTES = 128

# --- packets -------------------------------------------------------------------------------------


@msc_mutant("MSC-PKT-15", traps=(2,))
def a_second_02h_is_the_start(patch: MonkeyPatch) -> None:
    """02h in the place of the unit number begins the packet anew."""

    def takes(receiver: Receiver, byte: int, now: int) -> bool:
        is_so = (
            byte == STX
            and receiver.state is ReceiverState.HEADER
            and bytes(receiver._packet) == bytes([STX])
        )
        if is_so:
            receiver._begin_packet(now)
        return is_so

    hears(patch, takes)


@msc_mutant("MSC-CMD-07", traps=(9,))
def what_stands_behind_a_name_does_no_harm(patch: MonkeyPatch) -> None:
    """A name that begins as one of the nine is that one, the longest that fits."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, comma, values = body.partition(b",")
        known = [command.name for command in COMMANDS if name.startswith(command.name)]
        return go(now, max(known, key=len) + comma + values) if known and comma else go()

    bodies(patch, act)


@msc_mutant("MSC-CMD-08", traps=(10,))
def commas_in_front_of_an_address_are_skipped(patch: MonkeyPatch) -> None:
    """What parts name and values may be there more than once."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        name, comma, values = body.partition(b",")
        return go(now, name + comma + values.lstrip(b","))

    bodies(patch, act)


# --- the status word -----------------------------------------------------------------------------


@msc_mutant("MSC-STA-02")
def a_wrong_sum_is_told_as_a_wrong_load(patch: MonkeyPatch) -> None:
    """Every packet under a wrong checksum puts bit 9 on."""

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        if not is_sum_right(raw):
            receiver._examine.__self__._status.set(StatusBit.LOAD_CHECKSUM)
        go()

    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-STA-02")
def a_block_is_told_as_a_load_out_of_sequence(patch: MonkeyPatch) -> None:
    """BWRITE puts bit 11 on."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if body.startswith(b"BWRITE,"):
            unit._status.set(StatusBit.LOAD_SEQUENCE)
        return go()

    bodies(patch, act)


# --- repeats and signs ---------------------------------------------------------------------------


def _carried_over(patch: MonkeyPatch) -> None:
    """Let a reply begin with `receiver.carried` repeats, which then is 0 again."""

    def reply(go: Any_, receiver: Any, now: int) -> None:
        go()
        receiver._repeats = min(getattr(receiver, "carried", 0), receiver._repeats_max)
        receiver.carried = 0

    around(patch, Receiver, "_send_reply", reply)


@msc_mutant("MSC-LNK-09", "MSC-LNK-13", traps=(19,))
def a_reply_that_was_given_up_leaves_its_count(patch: MonkeyPatch) -> None:
    """The next reply is not repeated at all, the one after that as any."""

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        if receiver._repeats >= receiver._repeats_max:
            receiver.carried = receiver._repeats_max
        go()

    _carried_over(patch)
    around(patch, Receiver, "_repeat", repeat)


@msc_mutant("MSC-LNK-09", "MSC-LNK-15", traps=(19,))
def a_nak_to_nothing_counts_for_the_next_reply(patch: MonkeyPatch) -> None:
    """Each 15h in idle is one repeat less."""

    def takes(receiver: Any, byte: int, now: int) -> bool:
        if byte == NAK and receiver.state is ReceiverState.IDLE:
            receiver.carried = getattr(receiver, "carried", 0) + 1
        return False

    _carried_over(patch)
    hears(patch, takes)


def _amid_a_wait(patch: MonkeyPatch, act: Any_) -> None:
    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)
    around(patch, Receiver, "_take_waiting", act)


@msc_mutant("MSC-LNK-09")
def another_byte_begins_the_count_anew(patch: MonkeyPatch) -> None:
    """A byte that is no sign, while one is awaited, gives the reply all its repeats again."""

    def act(go: Any_, receiver: Any, byte: int, now: int) -> None:
        if byte not in (ACK, NAK, STX):
            receiver._repeats = 0
        go()

    _amid_a_wait(patch, act)


def _is_late(receiver: Receiver, now: int) -> bool:
    return now > receiver._answer_due - receiver._answer_ns // 2


@msc_mutant("MSC-LNK-11", "MSC-LNK-08")
def an_ack_in_the_second_half_of_t2_is_not_heard(patch: MonkeyPatch) -> None:
    """The reply comes again all the same."""

    def act(go: Any_, receiver: Receiver, byte: int, now: int) -> None:
        if byte != ACK or not _is_late(receiver, now):
            go()

    _amid_a_wait(patch, act)


@msc_mutant("MSC-LNK-10", "MSC-LNK-08")
def a_nak_in_the_second_half_of_t2_is_not_heard(patch: MonkeyPatch) -> None:
    """The reply comes again when its time is over, and not at once."""

    def act(go: Any_, receiver: Receiver, byte: int, now: int) -> None:
        if byte != NAK or not _is_late(receiver, now):
            go()

    _amid_a_wait(patch, act)


# --- what is stored ------------------------------------------------------------------------------


@msc_mutant("MSC-PKT-09")
def a_write_under_the_last_block_number_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """Where the packet before carried the same number, and not 0, a write is its repeat."""

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        before, block = getattr(receiver, "last_block", b""), raw[4:6]
        if is_sum_right(raw):
            receiver.last_block = block
            receiver.is_repeat = any(block) and block == before and "WRITE" in name_of(raw)
        go()

    def examine(go: Any_, receiver: Any, now: int, end_ns: int, sign: bytes, then: Any) -> None:
        if getattr(receiver, "is_repeat", False) and then == receiver._obey:
            receiver._verdict = ACCEPTED
        receiver.is_repeat = False
        go()

    around(patch, Receiver, "_judge", judge)
    around(patch, Receiver, "_sign", examine)


@msc_mutant("MSC-DREAD-04", "MSC-BREAD-04")
def a_refused_block_has_its_first_value_turned_round(patch: MonkeyPatch) -> None:
    """BREAD's reply is put together in place, and a NAK turns its first value round in memory."""

    def repeat(go: Any_, receiver: Any, now: int, start_ns: int) -> None:
        body = receiver._request[6:-2]
        place, data = int.from_bytes(body[6:8], "big"), receiver._examine.__self__._data
        if body.startswith(b"BREAD,") and place < SCRATCH_END:
            value = data.read(place).to_bytes(4, "little", signed=True)
            data.write(place, int.from_bytes(value, "big", signed=True))
        go()

    around(patch, Receiver, "_repeat", repeat)


@msc_mutant("MSC-BWRITE-02")
def a_second_block_goes_on_behind_the_first(patch: MonkeyPatch) -> None:
    """A BWRITE right behind one to the same address stores its values 32 further on."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        before, unit.last_place = getattr(unit, "last_place", None), None
        place = int.from_bytes(body[7:9], "big")
        if not body.startswith(b"BWRITE,") or place + 2 * BLOCK_BYTES > SCRATCH_END:
            return go()
        unit.last_place = place
        further = (place + BLOCK_BYTES).to_bytes(2, "big")
        return go(now, body[:7] + further + body[9:]) if before == place else go()

    bodies(patch, act)


@msc_mutant("MSC-PROP-13")
def a_look_at_all_flags_clears_those_from_184_on(patch: MonkeyPatch) -> None:
    """RFLAGS turns the flags 184 to 191 off behind its reply."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        if body != b"RFLAGS," or build is None:
            return verdict
        reply = build(now)
        for number in range(184, 192):
            unit._flags.set(number, False)
        return verdict._replace(reply=lambda when: reply)

    bodies(patch, act)


# --- between an ACK and its reply ----------------------------------------------------------------


def _in_the_gap(patch: MonkeyPatch, act: Any_) -> None:
    """Do `act(go, receiver, now, came)` when a reply is due, with what the host has said since the
    ACK; `go(now)` sends it."""

    def send_reply(go: Any_, receiver: Any, now: int) -> None:
        if receiver._verdict.reply is None:
            go()
            return
        begun, delay_ns = len(receiver._kept), receiver._reply_delay_ns

        def send(at: int) -> None:
            receiver._reply_delay_ns = 0
            go(at)
            receiver._reply_delay_ns = delay_ns

        def then(at: int) -> None:
            act(send, receiver, at, bytes(receiver._kept[begun:]))

        receiver._stay_busy(now, now + delay_ns, then)

    around(patch, Receiver, "_send_reply", send_reply)
    hears(patch, lambda receiver, byte, now: False)


@msc_mutant("MSC-LNK-07", "MSC-LNK-04", traps=(13,))
def an_ack_to_an_ack_ends_the_exchange(patch: MonkeyPatch) -> None:
    """Who acknowledges the ACK to a request gets no reply."""

    def act(go: Any_, receiver: Any, now: int, came: bytes) -> None:
        if ACK in came:
            receiver._kept.clear()
            receiver._rest(now)
        else:
            go(now)

    _in_the_gap(patch, act)


@msc_mutant("MSC-LNK-07", "MSC-LNK-04")
def a_byte_before_a_reply_is_refused(patch: MonkeyPatch) -> None:
    """What comes between an ACK and its reply, and is no sign, draws a NAK ahead of that."""

    def act(go: Any_, receiver: Any, now: int, came: bytes) -> None:
        is_noise = bool(came.strip(bytes([ACK, NAK])))
        go(receiver._send(now, bytes([NAK])) if is_noise else now)

    _in_the_gap(patch, act)
