"""Faults that one way of beginning, changing or ending a motion has and the others do not."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis import stops as stops_module
from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.shaft_control import Profile
from axistwin.devices.mac.axis.stops import Stops
from axistwin.motion import ramp as ramp_module
from axistwin.motion.ramp import Phase, Ramp
from axistwin.motion.trajectory import Piece
from zoo.mutant import Any_, MonkeyPatch, everywhere, motion_of, mutant, on, wrap

REAL, VIRTUAL = 0x16, 0x1E


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


def _steps(n: int) -> int:
    return (n >> 16) - (0x10000 if n >> 31 else 0)


def _word(steps: int, n: int) -> int:
    """The parameter of a segment of so many steps instead."""
    return (steps & 0xFFFF) << 16 | n & 0xFFFF


def _is_stopping(axis: Axis) -> bool:
    motion = motion_of(axis.drive)
    return motion is not None and motion.stopping


# --- on the way down -----------------------------------------------------------------------------


@mutant("MACS-CMD-13-02", "MACS-STATE-01")
def a_stopping_axis_counts_as_at_rest(patch: MonkeyPatch) -> None:
    """13h is accepted as soon as 17h, or 15h with 0000, has begun to slow the axis down."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        if not _is_stopping(axis):
            return bool(go())
        axis.drive.go_to(now, _signed(n), now)
        return True

    on(patch, 0x13, act)


@mutant("MACS-CMD-15-02")
def a_stopping_axis_only_acknowledges_15h(patch: MonkeyPatch) -> None:
    """15h while 17h slows the axis down is accepted and changes nothing."""
    on(patch, 0x15, lambda go, axis, now, n: (_is_stopping(axis) and n & 0xFFFF > 0) or go())


@mutant("MACS-CMD-18-01")
def a_stopping_axis_only_acknowledges_18h(patch: MonkeyPatch) -> None:
    """18h while 17h slows the axis down is accepted and changes nothing."""
    on(patch, 0x18, lambda go, axis, now, n: _is_stopping(axis) or go())


def _blinded(patch: MonkeyPatch, name: str) -> None:
    """Let no software stop be watched from that method of a drive on until a motion begins."""

    def make(act: Any_) -> Any_:
        def acting(drive: Any, *rest: Any) -> None:
            drive.stops.is_blind = isinstance(drive._control, Profile)
            act(drive, *rest)

        return acting

    def make_start(start: Any_) -> Any_:
        def starting(drive: Any, now: int, owner: Any) -> None:
            drive.stops.is_blind = False
            start(drive, now, owner)

        return starting

    def make_first(first: Any_) -> Any_:
        def looking(stops: Any, way: int) -> int:
            return way << 40 if getattr(stops, "is_blind", False) else int(first(stops, way))

        return looking

    wrap(patch, Drive, name, make)
    wrap(patch, Drive, "_start", make_start)
    wrap(patch, Stops, "_first_forbidden", make_first)


@mutant("MACS-STOP-03", "MACS-CMD-09-02")
def a_stopping_axis_passes_software_stops(patch: MonkeyPatch) -> None:
    """Software stops are not watched while 17h slows the axis down."""
    _blinded(patch, "ramped_stop")


@mutant("MACS-STOP-03", "MACS-CMD-09-02")
def after_a_change_of_speed_software_stops_are_passed(patch: MonkeyPatch) -> None:
    """Software stops are looked for when a motion begins, and not when 15h changes it."""
    _blinded(patch, "run_at")


@mutant("MACS-CMD-03-01")
def stops_mode_9_enables_the_inputs_only(patch: MonkeyPatch) -> None:
    """03h with 9 is 03h with 1."""

    def make(first: Any_) -> Any_:
        def looking(stops: Any, way: int) -> int:
            return way << 40 if stops._values["stops"] == 9 else int(first(stops, way))

        return looking

    assert stops_module.HARDWARE | stops_module.SOFTWARE == 9
    wrap(patch, Stops, "_first_forbidden", make)


# --- from an unpowered motor, and to one ---------------------------------------------------------


@mutant("MACS-CMD-13-01")
def the_first_move_has_no_ramp(patch: MonkeyPatch) -> None:
    """13h that has to power the motor runs at full speed from the first increment on."""

    def make(go_to: Any_) -> Any_:
        def going(drive: Any, *rest: Any) -> None:
            drive.is_first = not drive.powered
            go_to(drive, *rest)
            drive.is_first = False

        return going

    def make_ramp(ramp: Any_) -> Any_:
        def ramping(drive: Any, period_ticks: int) -> Ramp:
            made: Ramp = ramp(drive, period_ticks)
            return Ramp(period_ticks, 0, made.rules) if getattr(drive, "is_first", False) else made

        return ramping

    wrap(patch, Drive, "go_to", make)
    wrap(patch, Drive, "_ramp", make_ramp)


@mutant("MACS-CMD-16-01")
def the_first_segment_does_not_move(patch: MonkeyPatch) -> None:
    """16h that has to power the motor takes its time and moves nothing."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        return bool(go() if axis.drive.powered else axis.execute(now, VIRTUAL, n, now))

    on(patch, REAL, act)


@mutant("MACS-CMD-15-01")
def endless_motion_wants_19h_first(patch: MonkeyPatch) -> None:
    """15h with the motor unpowered is accepted and moves nothing."""
    on(patch, 0x15, lambda go, axis, now, n: not axis.drive.powered or go())


@mutant("MACS-CMD-1A-01")
def power_off_ends_moves_only(patch: MonkeyPatch) -> None:
    """1Ah in endless motion is accepted and changes nothing."""
    on(patch, 0x1A, lambda go, axis, now, n: axis.drive.kind is State.VE or go())


# --- widths --------------------------------------------------------------------------------------


@mutant("MACS-CMD-0F-01", "MACS-CMD-13-01")
def the_ramp_counts_its_coefficient_on_seven_bits(patch: MonkeyPatch) -> None:
    """AA from 80h on makes the ramp of AA - 80h; 26h tells it as it was sent."""

    def make(ramp: Any_) -> Any_:
        def ramping(drive: Drive, period_ticks: int) -> Ramp:
            made: Ramp = ramp(drive, period_ticks)
            return Ramp(made.period_ticks, made.aa & 0x7F, made.rules)

        return ramping

    wrap(patch, Drive, "_ramp", make)


@mutant("MACS-CMD-15-01")
def endless_motion_ends_after_32768_increments(patch: MonkeyPatch) -> None:
    """15h counts its increments at full speed down from 8000h."""
    plan_endless = ramp_module.plan_endless

    def planning(ramp: Ramp, counter: int = 0) -> tuple[Phase, ...]:
        climb, cruise = plan_endless(ramp, counter)
        return climb, cruise._replace(pieces=(Piece(0x8000, ramp.period_ticks),))

    everywhere(patch, plan_endless, planning)


@mutant("MACS-CMD-13-01")
def a_move_counts_full_speed_on_16_bits(patch: MonkeyPatch) -> None:
    """Of what a move runs at full speed only the lower 16 bits are run."""
    plan = ramp_module.plan

    def planning(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
        climb, held, *rest = plan(ramp, counter, remaining)
        count = held.increments or 0
        if count > 0xFFFF:
            held = held._replace(pieces=(Piece(count & 0xFFFF, held.pieces[0].period_ticks),))
        return (climb, held, *rest)

    everywhere(patch, plan, planning)


# --- segments ------------------------------------------------------------------------------------


@mutant("MACS-CMD-16-02")
def a_move_swallows_the_fourth_segment(patch: MonkeyPatch) -> None:
    """A segment for which there is no room behind a move is accepted and lost."""
    on(patch, REAL, lambda go, axis, now, n: bool(go()) or axis.drive.kind is State.PO)


@mutant("MACS-CMD-16-01", "MACS-CMD-16-03")
def segments_longer_than_two_ramps_are_ramped(patch: MonkeyPatch) -> None:
    """A segment of more than 240·AA steps is the slower for its ramps."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        ramps, steps = 240 * axis.values["ramp"], abs(_steps(n))
        is_ramped = 0 < ramps < steps
        period = (n & 0xFFFF) * (steps + ramps) // steps if is_ramped else n
        return bool(go(_word(_steps(n), min(0xFFFF, period)) if is_ramped else n))

    on(patch, REAL, act)


@mutant("MACS-CMD-1E-01")
def virtual_segments_are_one_period_shorter(patch: MonkeyPatch) -> None:
    """1Eh waits DDDD - 1 periods."""
    on(patch, VIRTUAL, lambda go, axis, now, n: go(_word(_steps(n) - (_steps(n) > 1), n)))


@mutant("MACS-CMD-1E-01")
def virtual_segments_count_their_ticks_on_24_bits(patch: MonkeyPatch) -> None:
    """1Eh of more than 2.1 s lasts so much less."""

    def act(go: Any_, _: Axis, __: int, n: int) -> bool:
        ticks = abs(_steps(n)) * (n & 0xFFFF)
        return bool(go(n if ticks < 1 << 24 else _word(1 + (ticks & 0xFFFFFF) // (n & 0xFFFF), n)))

    on(patch, VIRTUAL, act)
