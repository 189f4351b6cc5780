"""Faults of flags, status word and what follows the program (RFLAG, SFLAG, RQSTAT, FLG, STA)."""

from __future__ import annotations

from typing import Any

from axistwin.devices.msc.controller import MscController
from axistwin.devices.msc.flags import FLAGS, FlagKind, Flags
from axistwin.devices.msc.program import ProgramRunner
from axistwin.devices.msc.receiver import ACCEPTED, REFUSED
from axistwin.devices.msc.status import Status, StatusBit
from zoo_msc.planting import (
    MS,
    Any_,
    Commands,
    MonkeyPatch,
    around,
    bodies,
    msc_mutant,
    number_in,
    payloads,
)

ON = b"\0\1"
OF_THE_MACHINE = (FlagKind.INPUT, FlagKind.TIMER, FlagKind.MOTOR)


def _on(patch: MonkeyPatch, name: bytes, act: Any_) -> None:
    """Let one command be judged by `act(go, unit, number, body)`; `go(body)` judges it as it should
    be."""

    def judge(go: Any_, unit: Commands, now: int, body: bytes) -> Any:
        if not body.startswith(name + b","):
            return go()
        return act(lambda *others: go(now, *(others or (body,))), unit, number_in(body), body)

    bodies(patch, judge)


# --- reading flags -------------------------------------------------------------------------------


@msc_mutant("MSC-RFLAG-02", traps=(28,))
def a_flag_that_is_on_reads_ffffh(patch: MonkeyPatch) -> None:
    """RFLAG's reply has all sixteen bits set."""
    payloads(patch, lambda state: b"\xff\xff" if state == ON else state, "RFLAG")


@msc_mutant("MSC-RFLAG-02", "MSC-SFLAG-02", traps=(6,))
def a_flag_that_is_on_reads_0100h(patch: MonkeyPatch) -> None:
    """RFLAG's reply goes low byte first."""
    payloads(patch, lambda state: state[::-1], "RFLAG")


@msc_mutant("MSC-RFLAG-01", "MSC-FLG-01")
def only_the_hosts_flags_can_be_read(patch: MonkeyPatch) -> None:
    """RFLAG of an input, a timer or a motor's flag is refused."""

    def act(go: Any_, unit: Any, number: int, body: bytes) -> Any:
        is_own = number < FLAGS and unit._flags.may_host_write(number)
        return go() if is_own else REFUSED

    _on(patch, b"RFLAG", act)


@msc_mutant("MSC-FLG-01", "MSC-RFLAG-01")
def there_are_255_flags(patch: MonkeyPatch) -> None:
    """The number 255 is none."""
    _on(patch, b"RFLAG", lambda go, unit, number, body: REFUSED if number == 255 else go())


@msc_mutant("MSC-RFLAGS-01", "MSC-FLG-01")
def half_of_the_flags_are_told_at_once(patch: MonkeyPatch) -> None:
    """RFLAGS' reply has sixteen bytes."""
    payloads(patch, lambda states: states[:16], "RFLAGS")


@msc_mutant("MSC-RFLAGS-02", "MSC-RFLAGS-03", "MSC-PROP-11", traps=(6,))
def all_flags_are_one_big_number(patch: MonkeyPatch) -> None:
    """RFLAGS' 32 bytes go high byte first: flag 0 is the last bit of the last one."""
    payloads(patch, lambda states: states[::-1], "RFLAGS")


@msc_mutant("MSC-RFLAGS-02", "MSC-RFLAGS-03", "MSC-PROP-11")
def flags_begin_with_the_highest_bit(patch: MonkeyPatch) -> None:
    """In each byte of RFLAGS' reply the lowest flag is bit 7."""

    def change(states: bytes) -> bytes:
        return bytes(int(f"{one:08b}"[::-1], 2) for one in states)

    payloads(patch, change, "RFLAGS")


@msc_mutant("MSC-RFLAGS-02", "MSC-RFLAGS-03")
def bytes_of_flags_go_in_pairs(patch: MonkeyPatch) -> None:
    """The flags are sixteen words, each high byte first."""

    def change(states: bytes) -> bytes:
        pairs = zip(states[1::2], states[::2], strict=True)
        return bytes(one for pair in pairs for one in pair)

    payloads(patch, change, "RFLAGS")


@msc_mutant("MSC-RFLAGS-03", "MSC-PROP-11")
def flags_of_the_machine_are_not_told_at_once(patch: MonkeyPatch) -> None:
    """RFLAGS has 0 for what the host cannot write."""

    def act(go: Any_, flags: Flags, now: int) -> bytes:
        own = sum(1 << number for number in range(FLAGS) if flags.may_host_write(number))
        return (int.from_bytes(go(), "little") & own).to_bytes(32, "little")

    around(patch, Flags, "snapshot", act)


@msc_mutant("MSC-RFLAG-02", "MSC-FLG-03")
def a_flag_of_the_machine_is_told_upside_down(patch: MonkeyPatch) -> None:
    """RFLAG of an input is 1 while nothing is there."""

    def act(go: Any_, unit: Any, number: int, body: bytes) -> Any:
        verdict = go()
        build = verdict.reply
        if build is None or unit._flags.kind(number) is not FlagKind.INPUT:
            return verdict
        return verdict._replace(reply=lambda now: _turned_over(build(now)))

    _on(patch, b"RFLAG", act)


def _turned_over(reply: bytes) -> bytes:
    return reply[:-1] + bytes([1 - reply[-1]])


# --- writing flags -------------------------------------------------------------------------------


@msc_mutant("MSC-SFLAG-02")
def a_flag_that_is_set_again_goes_off(patch: MonkeyPatch) -> None:
    """SFLAG turns a flag over."""

    def act(go: Any_, unit: Any, number: int, body: bytes) -> Any:
        is_on = number < FLAGS and bool(unit._flags._on >> number & 1)
        return go(b"C" + body[1:]) if is_on else go()

    _on(patch, b"SFLAG", act)


@msc_mutant("MSC-CFLAG-02")
def eight_flags_go_off_together(patch: MonkeyPatch) -> None:
    """CFLAG clears the byte in which its flag is."""

    def act(go: Any_, unit: Any, number: int, body: bytes) -> Any:
        verdict = go()
        for other in range(number & ~7, number | 7):
            if verdict.act is not None and number < 240 and unit._flags.may_host_write(other):
                unit._flags.set(other, False)
        return verdict

    _on(patch, b"CFLAG", act)


@msc_mutant("MSC-SFLAG-02", "MSC-PROP-10")
def a_flag_has_seven_bits(patch: MonkeyPatch) -> None:
    """SFLAG of flag 128 turns flag 0 on, or tries to."""
    _on(
        patch,
        b"SFLAG",
        lambda go, unit, number, body: go(b"SFLAG," + bytes([body[6], body[7] & 0x7F])),
    )


@msc_mutant("MSC-SFLAG-02")
def a_flag_is_written_to_by_the_number_behind_it(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG count the flags from 1."""
    for name in (b"SFLAG", b"CFLAG"):
        _on(
            patch,
            name,
            lambda go, unit, number, body: go(body[:6] + ((number + 1) % FLAGS).to_bytes(2, "big")),
        )


@msc_mutant("MSC-CFLAG-03", "MSC-FLG-03")
def a_flag_of_the_machine_is_refused_while_it_is_off(patch: MonkeyPatch) -> None:
    """SFLAG of an input draws NAK, CFLAG of one that is on ACK and no effect."""

    def act(go: Any_, unit: Any, number: int, body: bytes) -> Any:
        return REFUSED if unit._flags.kind(number) in OF_THE_MACHINE else go()

    _on(patch, b"SFLAG", act)


@msc_mutant("MSC-SFLAG-03", "MSC-FLG-03")
def a_flag_of_the_machine_is_refused_and_turned(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG of an input draw NAK, and work."""

    def act(on: bool) -> Any_:
        def judged(go: Any_, unit: Any, number: int, body: bytes) -> Any:
            if number >= FLAGS or unit._flags.kind(number) not in OF_THE_MACHINE:
                return go()
            unit._flags.set(number, on)
            return REFUSED

        return judged

    _on(patch, b"SFLAG", act(True))
    _on(patch, b"CFLAG", act(False))


@msc_mutant("MSC-SFLAG-03", "MSC-FLG-03")
def the_host_turns_flags_of_the_machine(patch: MonkeyPatch) -> None:
    """SFLAG and CFLAG work on inputs and motors as on the host's own, for good."""
    around(patch, Flags, "may_host_write", lambda go, flags, number: True)


@msc_mutant("MSC-FLG-02")
def a_flag_above_255_can_be_written(patch: MonkeyPatch) -> None:
    """RFLAG of it is refused; SFLAG and CFLAG take its low byte."""
    for name in (b"SFLAG", b"CFLAG"):
        _on(patch, name, lambda go, unit, number, body: go(body[:6] + b"\0" + body[7:]))


@msc_mutant("MSC-FLG-02")
def flags_above_511_are_acknowledged(patch: MonkeyPatch) -> None:
    """RFLAG of flag 256 to 511 is refused, of one above that it draws an ACK."""
    _on(patch, b"RFLAG", lambda go, unit, number, body: ACCEPTED if number > 511 else go())


@msc_mutant("MSC-FLG-03")
def a_timers_flag_stays_on(patch: MonkeyPatch) -> None:
    """A timer's flag is on for ten seconds more than the timer runs."""

    def act(go: Any_, flags: Flags, now: int, number: int, duration_ns: int) -> None:
        go(now, number, duration_ns + 10_000 * MS)

    around(patch, Flags, "start_timer", act)


# --- the status word -----------------------------------------------------------------------------


def _told(patch: MonkeyPatch, change: Any_) -> None:
    """Let RQSTAT tell `change(word)`."""
    around(patch, Status, "read", lambda go, status: change(go()))


@msc_mutant("MSC-RQSTAT-01")
def the_status_is_alone(patch: MonkeyPatch) -> None:
    """Nothing follows the status word."""
    payloads(patch, lambda status: status[:2], "RQSTAT")


@msc_mutant("MSC-RQSTAT-01")
def the_status_is_followed_by_five_bytes(patch: MonkeyPatch) -> None:
    """FF has one byte and AAAA four."""
    payloads(patch, lambda status: status[:7], "RQSTAT")


@msc_mutant("MSC-RQSTAT-02", "MSC-STA-01")
def the_status_goes_low_byte_first(patch: MonkeyPatch) -> None:
    """A running program is told by 256."""
    payloads(patch, lambda status: status[1::-1] + status[2:], "RQSTAT")


@msc_mutant("MSC-RQSTAT-02")
def the_status_stands_behind_what_carries_nothing(patch: MonkeyPatch) -> None:
    """AAAA comes first, then FF, then SS."""
    payloads(patch, lambda status: status[2:] + status[:2], "RQSTAT")


@msc_mutant("MSC-STA-01", "MSC-STA-02")
def a_program_that_has_run_is_told_as_running(patch: MonkeyPatch) -> None:
    """Bit 0 goes on with the first start and never off."""

    change = Status.set

    def set_bits(status: Status, bits: StatusBit, on: bool = True) -> None:
        change(status, bits if on else bits & ~StatusBit.RUNNING, on)

    patch.setattr(Status, "set", set_bits)


@msc_mutant("MSC-STA-01", "MSC-RQSTAT-02")
def a_running_program_is_not_told(patch: MonkeyPatch) -> None:
    """Bit 0 is always off."""
    _told(patch, lambda word: word & ~1)


@msc_mutant("MSC-STA-02")
def load_errors_change_places(patch: MonkeyPatch) -> None:
    """Bits 8 and 9 are exchanged."""
    _told(patch, lambda word: word & ~0x300 | (word & 0x100) << 1 | (word & 0x200) >> 1)


@msc_mutant("MSC-STA-02")
def stack_underflow_is_told_as_overflow(patch: MonkeyPatch) -> None:
    """Bit 13 stands for both."""
    _told(patch, lambda word: word & ~0x4000 | (word & 0x4000) >> 1)


@msc_mutant("MSC-STA-03")
def one_error_at_a_time_is_told(patch: MonkeyPatch) -> None:
    """Of the bits from 8 up, the highest one that is on hides the others."""

    def change(word: int) -> int:
        errors = word & 0xFF00
        return word & 0xFF | (1 << errors.bit_length() - 1 if errors else 0)

    _told(patch, change)


@msc_mutant("MSC-STA-03", traps=(33,))
def a_status_is_a_number(patch: MonkeyPatch) -> None:
    """With more than one condition beside a running program, the program is not told."""
    _told(patch, lambda word: word & ~1 if bin(word).count("1") > 3 else word)


@msc_mutant("MSC-STA-04")
def an_error_is_told_at_every_other_look(patch: MonkeyPatch) -> None:
    """Reading hides the errors from the next look."""

    def act(go: Any_, status: Any) -> int:
        status.looks = getattr(status, "looks", 0) + 1
        return int(go()) & (0xFFFF if status.looks % 2 else 0x00FF)

    around(patch, Status, "read", act)


@msc_mutant("MSC-STA-01", "MSC-STA-02", traps=(40,))
def a_program_starts_at_power_up_unasked(patch: MonkeyPatch) -> None:
    """Whether bit 6 is on or not."""

    def act(go: Any_, controller: Any, now: int) -> None:
        go()
        if controller._runner.has_program and not controller._runner.is_running:
            controller._runner.start(now)

    around(patch, MscController, "_end_test", act)


@msc_mutant("MSC-STA-02")
def memory_is_lost_silently(patch: MonkeyPatch) -> None:
    """After a power cut all variables are 0, and no bit tells it."""

    def act(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        controller.data.lose()
        return effects

    around(patch, MscController, "power_off", act)


@msc_mutant("MSC-STA-02")
def an_empty_battery_is_not_told(patch: MonkeyPatch) -> None:
    """Bit 1 follows nothing."""
    around(
        patch,
        MscController,
        "set_battery",
        lambda go, controller, now, level: [] if level == "low" else _quietly(go, controller),
    )


def _quietly(go: Any_, controller: Any) -> Any:
    effects = go()
    controller.status.set(StatusBit.BATTERY_LOW, False)
    return effects


@msc_mutant("MSC-STA-02")
def an_empty_battery_is_not_told_after_power_up(patch: MonkeyPatch) -> None:
    """Bit 1 follows the battery while there is supply, and begins at 0."""
    around(patch, MscController, "power_on", lambda go, controller, now: _quietly(go, controller))


@msc_mutant("MSC-STA-02")
def every_battery_is_low_at_power_up(patch: MonkeyPatch) -> None:
    """Bit 1 follows the battery while there is supply, and begins at 1."""

    def act(go: Any_, controller: Any, now: int) -> Any:
        effects = go()
        controller.status.set(StatusBit.BATTERY_LOW)
        return effects

    around(patch, MscController, "power_on", act)


@msc_mutant("MSC-DWRITE-02")
def a_stopped_unit_acknowledges_and_does_nothing(patch: MonkeyPatch) -> None:
    """Writes of values have no effect while no program runs."""

    def act(go: Any_, unit: Any, now: int, body: bytes) -> Any:
        is_running = unit._status.has(StatusBit.RUNNING)
        return go() if is_running or not body.startswith(b"DWRITE,") else ACCEPTED

    bodies(patch, act)


# --- the program ---------------------------------------------------------------------------------


@msc_mutant("MSC-SFLAG-02", "MSC-DREAD-02")
def a_flag_is_seen_in_two_scans(patch: MonkeyPatch) -> None:
    """What the program has cleared is still on in its next scan."""

    def act(go: Any_, runner: Any, now: int) -> None:
        was = runner._flags._on
        go()
        kept, runner.kept = was & ~runner._flags._on, getattr(runner, "kept", 0)
        runner._flags._on |= kept & ~runner.kept
        runner.kept = kept

    around(patch, ProgramRunner, "_perform_scan", act)
