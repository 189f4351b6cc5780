"""Effects that are forgotten, come of something else, or come in another state than they should."""

from __future__ import annotations

from collections.abc import Sequence

from axistwin.devices.mac.axis.acceptance import MOVING
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.parameters import Parameters
from axistwin.devices.mac.axis.stops import HARDWARE
from axistwin.motion.ramp import Ramp
from axistwin.motion.trajectory import Piece
from zoo.mutant import Any_, MonkeyPatch, State, answers, cells, mutant, on, wrap


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


def _with(axis: Axis, name: str, value: int, go: Any_) -> bool:
    """Do it while a parameter has another value."""
    kept, axis.values[name] = axis.values[name], value
    accepted = bool(go())
    axis.values[name] = kept
    return accepted


# --- parameters ----------------------------------------------------------------------------------


@mutant("MACS-CMD-02-02")
def torque_at_rest_is_free_in_segments(patch: MonkeyPatch) -> None:
    """02h is locked by moves and endless motion only."""
    cells(patch, 0x02, (State.IN,), "A")


@mutant("MACS-CMD-090A-03")
def the_inferior_stop_is_free_in_motion(patch: MonkeyPatch) -> None:
    """0Ah is accepted while running, 09h is not."""
    cells(patch, 0x0A, MOVING, "A")


@mutant("MACS-CMD-0F-02")
def a_refused_ramp_is_stored(patch: MonkeyPatch) -> None:
    """0Fh in motion is refused, but 26h shows the new value."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        return bool(go()) or not Parameters.set_ramp(axis.parameters, n)

    on(patch, 0x0F, act)


@mutant("MACS-CMD-0C-03")
def the_torque_limit_is_lost_in_motion(patch: MonkeyPatch) -> None:
    """0Ch in motion is accepted and forgotten."""
    on(patch, 0x0C, lambda go, axis, now, n: axis.drive.kind is not None or go())


@mutant("MACS-CMD-0D-01")
def a_new_period_holds_from_the_second_move_on(patch: MonkeyPatch) -> None:
    """25h shows the new period at once; the next move still has the old one."""
    owed: dict[Axis, int] = {}

    def store(go: Any_, axis: Axis, _: int, __: int) -> bool:
        before = axis.values["period"]
        accepted = bool(go())
        if accepted:
            owed[axis] = before
        return accepted

    on(patch, 0x0D, store)
    on(
        patch,
        0x13,
        lambda go, axis, now, n: _with(axis, "period", owed.pop(axis, axis.values["period"]), go),
    )


@mutant("MACS-CMD-02-01", "MACS-Q-26-01")
def half_torque_is_told_as_8(patch: MonkeyPatch) -> None:
    """K of 26h is 8 where it should be 1."""
    answers(patch, 0x26, lambda value, axis, now: value ^ 0x9000 if value & 0x1000 else value)


@mutant("MACS-CMD-03-01", "MACS-Q-26-01")
def stops_modes_are_told_as_numbers(patch: MonkeyPatch) -> None:
    """m of 26h is 2 and 3 where it should be 8 and 9."""
    answers(patch, 0x26, lambda value, axis, now: value ^ 0xA00 if value & 0x800 else value)


# --- the counter ---------------------------------------------------------------------------------


@mutant("MACS-CMD-0B-02")
def clearing_the_counter_is_lost_in_motion(patch: MonkeyPatch) -> None:
    """0Bh in motion is accepted and forgotten."""
    on(patch, 0x0B, lambda go, axis, now, n: axis.drive.kind is not None or go())


@mutant("MACS-CMD-0B-01")
def targets_count_from_the_old_zero(patch: MonkeyPatch) -> None:
    """0Bh clears what 20h tells; 13h goes where it would have gone before."""
    shifts: dict[Axis, int] = {}

    def zero(go: Any_, axis: Axis, now: int, _: int) -> bool:
        shifts[axis] = shifts.get(axis, 0) + axis.counter_at(now)
        return bool(go())

    on(patch, 0x0B, zero)
    on(patch, 0x13, lambda go, axis, now, n: go(n - shifts.get(axis, 0)))


@mutant("MACS-CMD-0B-02")
def clearing_the_counter_ends_endless_motion(patch: MonkeyPatch) -> None:
    """0Bh during 15h stops the axis."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        if axis.drive.kind is State.VE:
            axis.drive.hard_stop(now)
        return accepted

    on(patch, 0x0B, act)


@mutant("MACS-CMD-0B-02")
def clearing_the_counter_drops_what_waits(patch: MonkeyPatch) -> None:
    """0Bh during segments lets the one in execution be the last."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        if axis.drive.kind is State.IN:
            axis.drive.stop_segments(now, after_this_one=True)
        return accepted

    on(patch, 0x0B, act)


def _clears(patch: MonkeyPatch, index: int) -> None:
    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        axis.drive.counter.set(now, 0)
        return accepted

    on(patch, index, act)


@mutant("MACS-CMD-18-01")
def a_hard_stop_clears_the_counter(patch: MonkeyPatch) -> None:
    """After 18h the position is 0."""
    _clears(patch, 0x18)


@mutant("MACS-CMD-1A-01")
def power_off_clears_the_counter(patch: MonkeyPatch) -> None:
    """After 1Ah the position is 0."""
    _clears(patch, 0x1A)


# --- synchronous mode ----------------------------------------------------------------------------


def _starts_directly(patch: MonkeyPatch, index: int) -> None:
    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        armed, axis._armed = axis._armed, False
        accepted = bool(go())
        axis._armed = armed
        return accepted

    on(patch, index, act)


@mutant("MACS-CMD-10-01")
def going_to_0_is_not_held_back(patch: MonkeyPatch) -> None:
    """10h holds 13h and 15h back, not 14h."""
    _starts_directly(patch, 0x14)


@mutant("MACS-CMD-10-01")
def endless_motion_is_not_held_back(patch: MonkeyPatch) -> None:
    """10h holds 13h and 14h back, not 15h."""
    _starts_directly(patch, 0x15)


@mutant("MACS-CMD-10-01")
def the_arm_is_over_after_a_second(patch: MonkeyPatch) -> None:
    """A motion that comes more than a second after 10h starts directly."""
    armed_at: dict[Axis, int] = {}

    def arm(go: Any_, axis: Axis, now: int, _: int) -> bool:
        armed_at[axis] = now
        return bool(go())

    def start(go: Any_, axis: Axis, now: int, _: int) -> bool:
        axis._armed = axis._armed and now - armed_at.get(axis, now) <= 1_000_000_000
        return bool(go())

    on(patch, 0x10, arm)
    on(patch, (0x13, 0x14, 0x15), start)


@mutant("MACS-CMD-10-01", "MACS-Q-XX-01")
def a_query_disarms(patch: MonkeyPatch) -> None:
    """20h between 10h and the motion lets the motion start directly."""

    def change(value: int, axis: Axis, _: int) -> int:
        axis._armed = False
        return value

    answers(patch, 0x20, change)


@mutant("MACS-CMD-10-03")
def virtual_segments_are_held_back(patch: MonkeyPatch) -> None:
    """1Eh after 10h is accepted and never runs; 16h runs."""
    on(patch, 0x1E, lambda go, axis, now, n: axis._armed or go())


# --- motion --------------------------------------------------------------------------------------


@mutant("MACS-CMD-13-03")
def a_move_without_power_is_lost(patch: MonkeyPatch) -> None:
    """13h while the motor is unpowered is accepted and forgotten."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        is_lost = not axis.drive.powered and not axis.faults.disjuncted
        return is_lost or bool(go())

    on(patch, 0x13, act)


@mutant("MACS-CMD-13-04")
def a_move_of_no_length_is_refused(patch: MonkeyPatch) -> None:
    """13h to the present place is refused."""
    on(patch, 0x13, lambda go, axis, now, n: _signed(n) != axis.counter_at(now) and go())


@mutant("MACS-CMD-14-01")
def going_to_0_has_no_ramp(patch: MonkeyPatch) -> None:
    """14h runs at full speed all the way."""
    on(patch, 0x14, lambda go, axis, now, n: _with(axis, "ramp", 0, go))


@mutant("MACS-CMD-14-02")
def a_refused_14h_ends_the_running_motion(patch: MonkeyPatch) -> None:
    """14h in motion is refused and stops the axis."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        if not accepted and axis.drive.kind is not None:
            axis.drive.hard_stop(now)
        return accepted

    on(patch, 0x14, act)


@mutant("MACS-CMD-15-01")
def endless_motion_begins_without_a_ramp(patch: MonkeyPatch) -> None:
    """15h from rest is at full speed at once."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        from_rest = axis.drive.kind is None
        return _with(axis, "ramp", 0 if from_rest else axis.values["ramp"], go)

    on(patch, 0x15, act)


@mutant("MACS-CMD-15-02")
def endless_motion_can_only_become_faster(patch: MonkeyPatch) -> None:
    """A slower 15h in motion is accepted and changes nothing."""
    periods: dict[Axis, int] = {}

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        period = n & 0xFFFF
        if axis.drive.kind is State.VE and period > periods.get(axis, 0xFFFF):
            return True
        periods[axis] = period or 0xFFFF
        return bool(go())

    on(patch, 0x15, act)


@mutant("MACS-CMD-16-02")
def a_full_fifo_stays_full_until_it_is_empty(patch: MonkeyPatch) -> None:
    """After a refusal segments are refused until the last one is done."""
    full: set[Axis] = set()

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        if axis.drive.kind is not State.IN:
            full.discard(axis)
        accepted = axis not in full and bool(go())
        if not accepted and axis.drive.kind is State.IN:
            full.add(axis)
        return accepted

    on(patch, (0x16, 0x1E), act)


@mutant("MACS-CMD-17-01")
def a_ramped_stop_takes_twice_as_long(patch: MonkeyPatch) -> None:
    """The increments of the way down after 17h last twice as long as those of the way up."""
    slow: list[bool] = []

    def make(descend: Any_) -> Any_:
        def descending(ramp: Ramp, counter: int) -> Sequence[Piece]:
            factor = 1 + bool(slow)
            return [Piece(n, period * factor) for n, period in descend(ramp, counter)]

        return descending

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        slow.append(True)
        accepted = bool(go())
        slow.pop()
        return accepted

    wrap(patch, Ramp, "descend", make)
    on(patch, 0x17, act)


@mutant("MACS-CMD-17-01")
def a_ramped_stop_of_endless_motion_stops_dead(patch: MonkeyPatch) -> None:
    """17h during 15h is 18h."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis.drive.kind is not State.VE:
            return bool(go())
        axis.drive.hard_stop(now)
        return True

    on(patch, 0x17, act)


@mutant("MACS-CMD-18-01")
def a_hard_stop_leaves_segments_alone(patch: MonkeyPatch) -> None:
    """18h during segments is accepted and changes nothing."""
    on(patch, 0x18, lambda go, axis, now, n: axis.drive.kind is State.IN or go())


# --- faults and inputs ---------------------------------------------------------------------------


@mutant("MACS-Q-21-03")
def an_over_voltage_locks_motion(patch: MonkeyPatch) -> None:
    """13h and 15h are refused as long as hh bit 7 is set."""
    on(patch, (0x13, 0x15), lambda go, axis, now, n: not axis.faults.over_voltage_seen and go())


@mutant("MACS-STATE-04")
def a_warning_ends_the_motion(patch: MonkeyPatch) -> None:
    """A supply that is too low or too high stops the axis."""

    def make(obey: Any_) -> Any_:
        def obeying(axis: Axis, now: int) -> None:
            obey(axis, now)
            if axis.drive.kind is not None and axis.faults.model.warnings(axis.faults.raw_supply):
                axis.drive.hard_stop(now)

        return obeying

    wrap(patch, Axis, "_obey_faults", make)


@mutant("MACS-STOP-02")
def a_disabled_stop_input_refuses_motion(patch: MonkeyPatch) -> None:
    """13h and 15h are refused while an input is grounded, though 03h is 0."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        is_off = not axis.values["stops"] & HARDWARE
        return not (is_off and any(axis.drive.stops.inputs.values())) and bool(go())

    on(patch, (0x13, 0x15), act)


@mutant("MACS-CMD-07-02")
def the_reference_is_enabled_at_the_start(patch: MonkeyPatch) -> None:
    """The reference input acts after a start, until 07h disables it."""

    def make(start: Any_) -> Any_:
        def starting(axis: Axis, now: int) -> None:
            start(axis, now)
            axis._reference_enabled = True

        return starting

    wrap(patch, Axis, "start", make)


@mutant("MACS-Q-27-02")
def the_reference_input_is_inverted(patch: MonkeyPatch) -> None:
    """dd bit 5 of 27h is 1 while the contact is open."""
    answers(patch, 0x27, lambda value, axis, now: value ^ 0x20)


@mutant("MACS-Q-27-03", "MACS-BUSY-01")
def busy_is_never_told(patch: MonkeyPatch) -> None:
    """cc bit 3 of 27h is always 1."""
    answers(patch, 0x27, lambda value, axis, now: value | 0x0800)
