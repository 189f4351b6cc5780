"""Faults that depend on how a motion began, on what came before, on power, or on single bytes."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.module import MacModule
from axistwin.devices.mac.axis.stops import Stops
from axistwin.devices.mac.serial.device import MacSerial
from zoo.mutant import (
    Any_,
    MonkeyPatch,
    answers,
    frames,
    mutant,
    on,
    replies,
    target_of,
    wrap,
)

FASTEST_TICKS = 0x64
PARAMETER_LOCK = (0x02, 0x03, 0x09, 0x0A, 0x0D, 0x0F)


def _began_by(patch: MonkeyPatch, indices: tuple[int, ...]) -> None:
    """Let `axis.drive.began_by` tell which of these commands came last."""

    def make(execute: Any_) -> Any_:
        def executing(axis: Any, now: int, index: int, *rest: Any) -> bool:
            if index in indices:
                axis.drive.began_by = index
            return bool(execute(axis, now, index, *rest))

        return executing

    wrap(patch, Axis, "execute", make)


# --- busy ----------------------------------------------------------------------------------------


def _judged(patch: MonkeyPatch, change: Any_) -> None:
    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: change(bool(busy(drive, now)), drive, now),
    )


@mutant("MACS-BUSY-01")
def a_move_down_is_never_busy(patch: MonkeyPatch) -> None:
    """The way that is left is compared with the tolerance as a signed number."""

    def change(busy: bool, drive: Drive, now: int) -> bool:
        target = target_of(drive)
        return busy and (target is None or target > drive.counter.at(now))

    _judged(patch, change)


@mutant("MACS-BUSY-01")
def a_move_that_11h_begins_is_never_busy(patch: MonkeyPatch) -> None:
    """Busy is told of moves that 13h or 14h itself begins."""
    _began_by(patch, (0x11, 0x13, 0x14))
    _judged(patch, lambda busy, drive, now: busy and getattr(drive, "began_by", 0) != 0x11)


# --- stops, power --------------------------------------------------------------------------------


@mutant("MACS-CMD-17-01")
def a_ramped_stop_leaves_a_move_of_14h_alone(patch: MonkeyPatch) -> None:
    """17h ends what 13h and 15h have begun, not what 14h has."""
    _began_by(patch, (0x11, 0x13, 0x14, 0x15))

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        is_own = axis.drive.kind is State.PO and getattr(axis.drive, "began_by", 0) == 0x14
        return True if is_own else bool(go())

    on(patch, 0x17, act)


@mutant("MACS-CMD-19-01")
def power_drops_what_is_stored(patch: MonkeyPatch) -> None:
    """19h amid segments empties the FIFO."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis.drive.kind is State.IN:
            axis.drive.interpolator.drop_stored(now)
            axis.drive.replan(now)
        return bool(go())

    on(patch, 0x19, act)


@mutant("MACS-CMD-0C-01")
def without_power_a_torque_limit_is_lost(patch: MonkeyPatch) -> None:
    """0Ch after 1Ah is acknowledged and not stored."""

    def off(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.is_cut = True
        return bool(go())

    def begin(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.is_cut = False
        return bool(go())

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        return True if getattr(axis, "is_cut", False) else bool(go())

    on(patch, 0x1A, off)
    on(patch, (0x13, 0x14, 0x15, 0x16, 0x19), begin)
    on(patch, 0x0C, act)


# --- what a command leaves behind ----------------------------------------------------------------


@mutant("MACS-STATE-01")
def clearing_the_counter_lifts_the_lock(patch: MonkeyPatch) -> None:
    """0Bh in motion unlocks the parameters until the axis rests."""

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.is_open = axis.drive.kind is not None
        return bool(go())

    def make(locked: Any_) -> Any_:
        def locking(axis: Any, index: int, number: int) -> bool:
            if axis.drive.kind is None:
                axis.is_open = False
            is_free = index in PARAMETER_LOCK and getattr(axis, "is_open", False)
            return not is_free and bool(locked(axis, index, number))

        return locking

    on(patch, 0x0B, act)
    wrap(patch, Axis, "is_locked", make)


@mutant("MACS-REPLY-05")
def a_refused_software_stop_acts_until_the_axis_rests(patch: MonkeyPatch) -> None:
    """09h refused in motion is what the counter is compared with as long as that lasts."""

    def make(locked: Any_) -> Any_:
        def locking(axis: Any, index: int, number: int) -> bool:
            is_refused = bool(locked(axis, index, number))
            if is_refused and index == 0x09:
                axis.drive.stops.refused = number - (number >> 31 << 32)
                axis.drive.is_to_replan = True
            return is_refused

        return locking

    def look(first: Any_) -> Any_:
        def looking(stops: Any, way: int) -> int:
            place = int(first(stops, way))
            refused = getattr(stops, "refused", None)
            if way < 0 or refused is None:
                return place
            return int(place - stops._values["superior_stop"] + refused)

        return looking

    def make_replan(call: Any_) -> Any_:
        def calling(axis: Any, now: int, *rest: Any) -> Any:
            if getattr(axis.drive, "is_to_replan", False):
                axis.drive.is_to_replan = False
                axis.drive.replan(now)
            return call(axis, now, *rest)

        return calling

    def make_begin(start: Any_) -> Any_:
        def starting(drive: Any, *rest: Any) -> None:
            drive.stops.refused = None
            start(drive, *rest)

        return starting

    wrap(patch, Axis, "is_locked", make)
    wrap(patch, Axis, "query", make_replan)
    wrap(patch, Axis, "execute", make_replan)
    wrap(patch, Stops, "_first_forbidden", look)
    wrap(patch, Drive, "_start", make_begin)


@mutant("MACS-CMD-00-02")
def the_second_start_is_short(patch: MonkeyPatch) -> None:
    """After the second 00h the module is there again in a fifth of a second."""

    def make(begin: Any_) -> Any_:
        def beginning(module: Any, now: int) -> None:
            module.starts = getattr(module, "starts", 0) + 1
            own_ns = module._boot_ns
            module._boot_ns = own_ns // 10 if module.starts == 2 else own_ns
            begin(module, now)
            module._boot_ns = own_ns

        return beginning

    wrap(patch, MacModule, "_begin_boot", make)


@mutant("MACS-CMD-07-01")
def the_reference_enable_is_a_bit_of_the_stops_mode(patch: MonkeyPatch) -> None:
    """07h 01 sets bit 0 of what 03h has set as well."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        accepted = bool(go())
        if accepted and number & 1:
            axis.parameters.values["stops"] |= 1
        return accepted

    on(patch, 0x07, act)


@mutant("MACS-Q-25-01")
def the_zero_byte_shows_the_end_of_0eh(patch: MonkeyPatch) -> None:
    """The second byte of 25h is the fourth one of the last 0Eh."""

    def act(go: Any_, axis: Any, now: int, number: int) -> bool:
        axis.low_byte = number & 0xFF
        return bool(go())

    on(patch, 0x0E, act)
    answers(patch, 0x25, lambda value, axis, now: value | getattr(axis, "low_byte", 0) << 16)


@mutant("MACS-REPLY-09")
def the_digit_of_a_refusal_stays(patch: MonkeyPatch) -> None:
    """The answer behind a refused command has the digit of that command."""

    def act(go: Any_, module: Any, frame: bytes, request: Any) -> None:
        module.queried = frame[7:8]
        go()

    def change(data: bytes, module: Any) -> bytes:
        if data == b"\x06\x13\x17":
            module.kept = module.queried
        digit = getattr(module, "kept", b"")
        if len(data) != 21 or not digit:
            return data
        module.kept = b""
        summed = data[6:8] + digit + data[9:17]
        return data[:6] + summed + b"%02X" % (sum(summed) & 0xFF) + data[19:]

    frames(patch, act)
    replies(patch, change)


# --- motions -------------------------------------------------------------------------------------


@mutant("MACS-CMD-15-02")
def the_speed_changes_four_times(patch: MonkeyPatch) -> None:
    """From the fifth speed change of a motion on 15h has no effect."""

    def act(go: Any_, axis: Any, now: int, number: int) -> bool:
        is_change = axis.drive.kind is State.VE and number & 0xFFFF
        axis.changes = getattr(axis, "changes", 0) + 1 if is_change else 0
        return True if axis.changes > 4 else bool(go())

    on(patch, 0x15, act)


@mutant("MACS-CMD-14-01", "MACS-CMD-11-01")
def a_preloaded_14h_goes_where_13h_went(patch: MonkeyPatch) -> None:
    """14h behind 10h is held with the target of the last 13h."""

    def go_to(go: Any_, axis: Any, now: int, number: int) -> bool:
        axis.last_target = number
        return bool(go())

    def go_to_zero(go: Any_, axis: Any, now: int, _: int) -> bool:
        if axis._armed and axis.drive.kind is None:
            return bool(axis._go_to(now, getattr(axis, "last_target", 0), now))
        return bool(go())

    on(patch, 0x13, go_to)
    on(patch, 0x14, go_to_zero)


@mutant("MACS-CMD-10-02")
def a_move_of_no_way_is_not_held(patch: MonkeyPatch) -> None:
    """13h behind 10h to where the axis is leaves it armed."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        is_none = number == axis.counter_at(now) & 0xFFFFFFFF
        return True if axis._armed and axis._preload is None and is_none else bool(go())

    on(patch, 0x13, act)


@mutant("MACS-CMD-1E-01")
def segments_have_a_shortest_period(patch: MonkeyPatch) -> None:
    """VVVV below 64h is taken as 64h."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        period = number & 0xFFFF
        return bool(go(number - period + max(period, FASTEST_TICKS)) if period else go())

    on(patch, (0x16, 0x1E), act)


@mutant("MACS-CMD-16-01", "MACS-FRAME-05")
def negative_steps_lose_their_carry(patch: MonkeyPatch) -> None:
    """DDDD is negated byte by byte: multiples of -100h lose 100h steps."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        steps = number >> 16
        is_lost = steps & 0x8000 and not steps & 0xFF and steps != 0x8000
        return bool(go(number + 0x01000000) if is_lost else go())

    on(patch, 0x16, act)


@mutant("MACS-CMD-1B-01", "MACS-Q-20-02")
def a_new_rate_clears_the_position(patch: MonkeyPatch) -> None:
    """1Bh starts up with a counter of 0."""

    def make(set_rate: Any_) -> Any_:
        def setting(module: Any, *rest: Any) -> Any:
            module.is_cleared = True
            return set_rate(module, *rest)

        return setting

    def make_down(shut_down: Any_) -> Any_:
        def shutting(module: Any, now: int) -> None:
            shut_down(module, now)
            if getattr(module, "is_cleared", False):
                module.is_cleared = False
                module.axis.drive.counter.set(now, 0)

        return shutting

    from axistwin.devices.mac.serial import device

    patch.setitem(device._FACE_COMMANDS, 0x1B, make(MacSerial._set_rate))
    wrap(patch, MacModule, "_begin_boot", make_down)
