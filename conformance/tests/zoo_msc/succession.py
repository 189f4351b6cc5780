"""Faults of what comes before: the last command, a wait that was ended, a silence, a timer that
runs, a program that stands still, a power cut."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.flags import FLAGS
from axistwin.devices.msc.receiver import ACCEPTED, REFUSED
from axistwin.devices.msc.status import Status, StatusBit
from zoo_msc.planting import (
    ACK,
    STX,
    Any_,
    Commands,
    MonkeyPatch,
    Receiver,
    ReceiverState,
    S,
    around,
    bodies,
    carry_out,
    hears,
    msc_mutant,
    number_in,
)

SCRATCH = range(1024, 5120)  # what the suite may write of the twin's variables


def _name(body: bytes) -> bytes:
    return body.partition(b",")[0]


def _behind(patch: MonkeyPatch, before: bytes, name: bytes, act: Any_) -> None:
    """Let a command right behind another one be judged by `act(go, unit, now, body)`."""

    def judge(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        last, unit.last_name = getattr(unit, "last_name", b""), _name(body)
        if last == before and _name(body) == name:
            return act(go, unit, now, body)
        return go()

    bodies(patch, judge)


# --- the last command ----------------------------------------------------------------------------


@msc_mutant("MSC-DREAD-02")
def a_value_behind_a_flag_has_sixteen_bits(patch: MonkeyPatch) -> None:
    """The width of RFLAG's reply is left over: DREAD right behind it tells the low half."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        if build is None:
            return verdict
        return verdict._replace(reply=lambda when: build(when)[:6] + b"\0\0" + build(when)[8:])

    _behind(patch, b"RFLAG", b"DREAD", act)


@msc_mutant("MSC-DWRITE-02")
def a_value_behind_a_block_is_not_stored(patch: MonkeyPatch) -> None:
    """DWRITE right behind a BWRITE is acknowledged alone."""
    _behind(patch, b"BWRITE", b"DWRITE", lambda go, unit, now, body: ACCEPTED)


@msc_mutant("MSC-SFLAG-02")
def a_flag_behind_the_status_is_not_turned_on(patch: MonkeyPatch) -> None:
    """SFLAG right behind an RQSTAT is acknowledged alone."""
    _behind(patch, b"RQSTAT", b"SFLAG", lambda go, unit, now, body: ACCEPTED)


@msc_mutant("MSC-LNK-01")
def all_flags_behind_a_block_are_refused(patch: MonkeyPatch) -> None:
    """RFLAGS right behind a BREAD draws NAK."""
    _behind(patch, b"BREAD", b"RFLAGS", lambda go, unit, now, body: REFUSED)


@msc_mutant("MSC-BWRITE-02")
def a_block_of_equal_values_is_filled_by_a_byte(patch: MonkeyPatch) -> None:
    """BWRITE of 32 equal values fills their place with the last byte of them."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        data = body[9:]
        is_alike = _name(body) == b"BWRITE" and len(data) == 128 and data == data[:4] * 32
        return (
            go(now, body[:9] + data[-1:] * 128) if is_alike and number_in(body) in SCRATCH else go()
        )

    bodies(patch, act)


@msc_mutant("MSC-BWRITE-02")
def a_block_between_equal_ends_is_equal(patch: MonkeyPatch) -> None:
    """BWRITE looks at the first value and the last one to see whether all are alike."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        data = body[9:]
        is_alike = _name(body) == b"BWRITE" and len(data) == 128 and data[:4] == data[-4:]
        return (
            go(now, body[:9] + data[:4] * 32) if is_alike and number_in(body) in SCRATCH else go()
        )

    bodies(patch, act)


@msc_mutant("MSC-DWRITE-05")
def a_write_inside_a_value_means_the_value(patch: MonkeyPatch) -> None:
    """DWRITE takes the address down to a multiple of 4, DREAD does not."""

    def act(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if _name(body) != b"DWRITE" or number_in(body) not in SCRATCH:
            return go()
        return go(now, body[:7] + (number_in(body) & ~3).to_bytes(2, "big") + body[9:])

    bodies(patch, act)


@msc_mutant("MSC-DWRITE-05")
def a_high_write_lands_2048_lower_as_well(patch: MonkeyPatch) -> None:
    """A line of the address is not looked at when something is stored from 4096 on."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict, place = go(), number_in(body)
        store = verdict.act
        if _name(body) != b"DWRITE" or place not in range(4096, SCRATCH.stop) or store is None:
            return verdict

        def both(when: int) -> Any:
            unit._data.write(place - 2048, int.from_bytes(body[9:13], "big", signed=True))
            return store(when)

        return verdict._replace(act=both)

    bodies(patch, act)


# --- signs and waits -----------------------------------------------------------------------------


@msc_mutant("MSC-LNK-14")
def an_ack_behind_a_write_carries_it_out_again(patch: MonkeyPatch) -> None:
    """06h in idle right behind a write does what the write did, in silence."""

    def keep(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        unit.last_write = body if verdict.act is not None else b""
        return verdict

    def takes(receiver: Any, byte: int, now: int) -> bool:
        unit = receiver._examine.__self__
        body: bytes = getattr(unit, "last_write", b"")
        if byte == ACK and receiver.state is ReceiverState.IDLE and body:
            unit.last_write = b""
            carry_out(unit, now, body)
        return False

    bodies(patch, keep)
    hears(patch, takes)


def _amid_waits(patch: MonkeyPatch, act: Any_) -> None:
    """Let `act(receiver)` be done whenever a packet begins instead of a sign."""
    patch.setattr(Receiver, "quiet_prefix", lambda receiver, data: 0)
    patch.setattr(Receiver, "_whole_packet_at", lambda receiver, data: -1)

    def take(go: Any_, receiver: Any, byte: int, now: int) -> None:
        go()
        if byte == STX:
            act(receiver)

    around(patch, Receiver, "_take_waiting", take)


@msc_mutant("MSC-LNK-16", "MSC-LNK-01")
def every_second_wait_that_is_ended_swallows_the_packet(patch: MonkeyPatch) -> None:
    """The second time in a row that a packet replaces a wait nothing answers it."""

    def act(receiver: Any) -> None:
        receiver.ended = getattr(receiver, "ended", 0) + 1
        receiver.is_mute = receiver.ended % 2 == 0

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        is_mute, receiver.is_mute = getattr(receiver, "is_mute", False), False
        receiver._rest(now) if is_mute else go()

    def acknowledged(go: Any_, receiver: Any, now: int) -> None:
        if receiver.state is ReceiverState.WAIT:
            receiver.ended = 0
        go()

    _amid_waits(patch, act)
    around(patch, Receiver, "_judge", judge)
    around(patch, Receiver, "_rest", acknowledged)


@msc_mutant("MSC-SFLAG-02")
def a_flag_is_taken_from_the_reply_that_waits(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG instead of a sign to RFLAG's reply are about the flag of that."""

    def act(receiver: Any) -> None:
        body = receiver._request[6:-2]
        receiver._examine.__self__.waiting = body[6:8] if _name(body) == b"RFLAG" else b""

    def judge(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        number, unit.waiting = getattr(unit, "waiting", b""), b""
        is_turned = bool(number) and _name(body) in (b"SFLAG", b"CFLAG")
        return go(now, body[:6] + number) if is_turned else go()

    _amid_waits(patch, act)
    bodies(patch, judge)


# --- silence -------------------------------------------------------------------------------------


def _after_silence(patch: MonkeyPatch, seconds: int, takes: Any_) -> None:
    """Let `takes(receiver)` have the first byte after so long a silence; true: it is lost."""

    def act(receiver: Any, byte: int, now: int) -> bool:
        before, receiver.heard_ns = getattr(receiver, "heard_ns", now), now
        return now - before > seconds * S and bool(takes(receiver))

    hears(patch, act)


@msc_mutant("MSC-LNK-01")
def after_30_s_the_first_byte_only_wakes_it(patch: MonkeyPatch) -> None:
    """A receiver that sleeps loses the byte that wakes it."""
    _after_silence(patch, 30, lambda receiver: True)


@msc_mutant("MSC-SFLAG-02")
def after_20_s_of_silence_the_hosts_flags_go_off(patch: MonkeyPatch) -> None:
    """Who has no host any more has its outputs and its user flags off."""

    def takes(receiver: Any) -> None:
        flags = receiver._examine.__self__._flags
        for number in range(FLAGS):
            if flags.may_host_write(number):
                flags.set(number, False)

    _after_silence(patch, 20, takes)


@msc_mutant("MSC-DWRITE-02")
def after_20_s_of_silence_values_are_as_before_them(patch: MonkeyPatch) -> None:
    """Who has no host any more takes back what it wrote last."""

    def write(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if _name(body) == b"DWRITE" and number_in(body) in SCRATCH:
            unit.last_place = number_in(body)
        return go()

    def takes(receiver: Any) -> None:
        unit = receiver._examine.__self__
        if place := getattr(unit, "last_place", 0):
            unit._data.write(place, 0)

    bodies(patch, write)
    _after_silence(patch, 20, takes)


# --- while a timer runs --------------------------------------------------------------------------


def _while_a_timer_runs(patch: MonkeyPatch, act: Any_, *names: bytes) -> None:
    def judge(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        unit._catch_up(now)
        runs = unit._flags.next_expiry(now) is not None
        return act(go, unit, now, body) if runs and _name(body) in names else go()

    bodies(patch, judge)


@msc_mutant("MSC-SFLAG-02")
def a_flag_is_not_turned_on_while_a_timer_runs(patch: MonkeyPatch) -> None:
    """SFLAG is acknowledged alone then."""
    _while_a_timer_runs(patch, lambda go, unit, now, body: ACCEPTED, b"SFLAG")


@msc_mutant("MSC-LNK-01")
def a_write_is_refused_while_a_timer_runs(patch: MonkeyPatch) -> None:
    """DWRITE and BWRITE draw NAK then."""
    _while_a_timer_runs(patch, lambda go, unit, now, body: REFUSED, b"DWRITE", b"BWRITE")


@msc_mutant("MSC-FLG-03")
def a_flag_that_is_cleared_ends_the_timers(patch: MonkeyPatch) -> None:
    """CFLAG of any flag of the host's stops what runs."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        for number in range(32, 40):
            unit._flags.stop_timer(number)
        return go()

    _while_a_timer_runs(patch, act, b"CFLAG")


@msc_mutant("MSC-STA-02")
def a_timer_that_runs_is_told_as_a_self_test(patch: MonkeyPatch) -> None:
    """Bit 7 is on then."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        return verdict._replace(
            reply=lambda when: build(when)[:8] + bytes([build(when)[8] | 0x80]) + build(when)[9:]
        )

    _while_a_timer_runs(patch, act, b"RQSTAT")


# --- a program that stands still, and power ------------------------------------------------------


@msc_mutant("MSC-STA-02")
def auto_start_is_told_only_of_a_program_that_runs(patch: MonkeyPatch) -> None:
    """Bit 6 goes off with bit 0."""

    def act(go: Any_, status: Any) -> int:
        told = int(go())
        return told if told & StatusBit.RUNNING else told & ~StatusBit.AUTO_START

    around(patch, Status, "read", act)


@msc_mutant("MSC-SFLAG-02")
def a_stopped_unit_turns_no_flag_on(patch: MonkeyPatch) -> None:
    """SFLAG has no effect while no program runs."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        is_running = unit._status.has(StatusBit.RUNNING)
        return go() if is_running or _name(body) != b"SFLAG" else ACCEPTED

    bodies(patch, act)


@msc_mutant("MSC-BWRITE-02")
def a_stopped_unit_stores_no_block(patch: MonkeyPatch) -> None:
    """BWRITE has no effect while no program runs."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        is_running = unit._status.has(StatusBit.RUNNING)
        return go() if is_running or _name(body) != b"BWRITE" else ACCEPTED

    bodies(patch, act)


@msc_mutant("MSC-STA-02")
def a_program_is_told_as_cleared_after_power_up(patch: MonkeyPatch) -> None:
    """Bit 3 is on although the program is there and runs."""

    def act(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        controller.status.set(StatusBit.PROGRAM_CLEARED)
        return effects

    around(patch, MscController, "power_on", act)


@msc_mutant("MSC-PHY-04", "MSC-LNK-01")
def the_first_packet_after_power_up_is_refused(patch: MonkeyPatch) -> None:
    """The register of the sum is not cleared by power-up."""

    def act(go: Any_, controller: Any, now: int) -> Any:
        controller._receiver.is_fresh = True
        return go()

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        is_fresh, receiver.is_fresh = getattr(receiver, "is_fresh", False), False
        receiver._refuse(now) if is_fresh else go()

    around(patch, MscController, "power_on", act)
    around(patch, Receiver, "_judge", judge)


@msc_mutant("MSC-STA-02")
def an_error_is_told_after_power_up(patch: MonkeyPatch) -> None:
    """Bit 12 is on though nothing is wrong with the program."""

    def act(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        controller.status.set(StatusBit.BAD_OPCODE)
        return effects

    around(patch, MscController, "power_on", act)


@msc_mutant("MSC-STA-02")
def a_block_is_not_kept_without_supply(patch: MonkeyPatch) -> None:
    """What BWRITE has stored is 0 after a power cut, and no bit tells it."""

    def write(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        if _name(body) == b"BWRITE" and number_in(body) in SCRATCH:
            unit.last_block = number_in(body)
        return go()

    def act(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        if place := getattr(controller._commands, "last_block", 0):
            for step in range(32):
                controller.data.write(place + 4 * step, 0)
        return effects

    bodies(patch, write)
    around(patch, MscController, "power_off", act)


@msc_mutant("MSC-LNK-14")
def an_ack_behind_a_flag_loses_the_next_packet(patch: MonkeyPatch) -> None:
    """06h in idle right behind SFLAG or CFLAG makes it deaf to one packet."""

    def keep(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        unit.is_flag = _name(body) in (b"SFLAG", b"CFLAG")
        return go()

    def takes(receiver: Any, byte: int, now: int) -> bool:
        if byte == ACK and receiver.state is ReceiverState.IDLE:
            receiver.is_deaf = getattr(receiver._examine.__self__, "is_flag", False)
        return False

    def judge(go: Any_, receiver: Any, raw: bytes, now: int) -> None:
        is_deaf, receiver.is_deaf = getattr(receiver, "is_deaf", False), False
        receiver._rest(now) if is_deaf else go()

    bodies(patch, keep)
    hears(patch, takes)
    around(patch, Receiver, "_judge", judge)
