"""Faults in what one command leaves behind for the next, in what ends by itself, and in what the
software stops depend on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.shaft_control import Profile
from axistwin.devices.mac.axis.stops import Stops
from axistwin.motion import ramp as ramp_module
from axistwin.motion.ramp import Phase, Ramp, RampedMotion
from axistwin.motion.trajectory import Piece
from zoo.mutant import Any_, MonkeyPatch, everywhere, mutant, on, wrap

SECOND_NS = 1_000_000_000
TEN_SECONDS = 80_000_000  # ticks
SOME_MOVES = 16
NEVER = 1 << 40  # increments: a stop that no counter reaches
ENABLING = (0x03, 0x09, 0x0A)


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


def _goes(axis: Axis) -> Profile | None:
    """The profile that runs."""
    shaft = axis.drive._control
    return shaft if isinstance(shaft, Profile) else None


# --- busy ----------------------------------------------------------------------------------------


@mutant("MACS-CMD-0B-01")
def clearing_the_counter_at_rest_leaves_the_axis_busy(patch: MonkeyPatch) -> None:
    """0Bh behind a move clears the counter and not the target that busy is told by."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        here, drive = axis.counter_at(now), axis.drive
        accepted = bool(go())
        if drive._position_mode and drive.kind is None:
            drive._old_target = drive.plant.position_at(now) + here
        return accepted

    on(patch, 0x0B, act)


@mutant("MACS-CMD-15-02")
def endless_motion_is_busy_until_the_old_target(patch: MonkeyPatch) -> None:
    """15h during a move: 27h goes on to compare the place with the target of the move."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        shaft, drive = _goes(axis), axis.drive
        target = drive.plant.target if shaft is not None and shaft.number is not None else None
        accepted = bool(go())
        if target is not None and n & 0xFFFF:
            drive._old_target = target
        return accepted

    on(patch, 0x15, act)


# --- moves ---------------------------------------------------------------------------------------


@mutant("MACS-CMD-13-01")
def every_sixteenth_move_is_lost(patch: MonkeyPatch) -> None:
    """Each sixteenth 13h since start-up is acknowledged and not done."""

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.moves = getattr(axis, "moves", 0) + 1
        return True if axis.moves % SOME_MOVES == 0 and axis.drive.kind is None else bool(go())

    on(patch, 0x13, act)


@mutant("MACS-CMD-13-01")
def the_increments_of_a_level_have_8_bits(patch: MonkeyPatch) -> None:
    """k·AA is counted modulo 256: long levels are left early."""
    plan = ramp_module.plan

    def shortened(phase: Phase) -> tuple[list[Piece], int]:
        """The pieces that are left, and how many increments are missing."""
        kept, missing = [], 0
        for count, period in phase.pieces:
            counted = (count or 0) & 0xFF
            missing += (count or 0) - counted
            if counted:
                kept.append(Piece(counted, period))
        return kept, missing

    def planning(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
        phases = plan(ramp, counter, remaining)
        if counter or len(phases) < 2:
            return phases
        climb, more = shortened(phases[0])
        descent, less = shortened(phases[-1])
        if not (climb and descent and more and less):
            return phases
        climb.append(Piece(more, climb[-1].period_ticks))
        descent.insert(0, Piece(less, descent[0].period_ticks))
        return (
            phases[0]._replace(pieces=tuple(climb)),
            *phases[1:-1],
            phases[-1]._replace(pieces=tuple(descent)),
        )

    everywhere(patch, plan, planning)


@mutant("MACS-BUSY-01", "MACS-CMD-1C-01")
def a_move_within_the_tolerance_is_not_done(patch: MonkeyPatch) -> None:
    """13h to a place that is no further away than 1Ch says counts as done already."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        way = abs(_signed(n) - axis.counter_at(now))
        is_near = axis.drive.kind is None and way <= axis.values["tolerance"]
        return True if is_near and not axis._armed else bool(go())

    on(patch, 0x13, act)


@mutant("MACS-CMD-0E-02")
def a_move_goes_on_at_the_catch_up_speed(patch: MonkeyPatch) -> None:
    """0Eh during a move without a ramp makes the rest of it run at the new catch-up speed."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted, shaft, drive = bool(go()), _goes(axis), axis.drive
        if accepted and shaft is not None and shaft.number is not None:
            ramp = drive._ramp(_catch_up_ticks(axis))
            drive._begin(now, Profile(drive._move_to(now, shaft.number, now, ramp), shaft.number))
        return accepted

    on(patch, 0x0E, act)


@mutant("MACS-CMD-0E-02")
def endless_motion_goes_on_at_the_catch_up_speed(patch: MonkeyPatch) -> None:
    """0Eh during 15h makes it run at the new catch-up speed."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted, shaft = bool(go()), _goes(axis)
        if accepted and shaft is not None and shaft.number is None:
            axis.drive.run_at(now, _catch_up_ticks(axis), 1, now)
        return accepted

    on(patch, 0x0E, act)


def _catch_up_ticks(axis: Axis) -> int:
    return int(min(0xFFFF, max(1, axis.values["catchup"]) * 1600))


# --- what ends by itself -------------------------------------------------------------------------


@mutant("MACS-CMD-15-01")
def endless_motion_ends_after_ten_seconds(patch: MonkeyPatch) -> None:
    """A motion of 15h ends by itself, with its ramp, after ten seconds at its speed."""

    def endless(start_ns: int, direction: int, ramp: Ramp) -> RampedMotion:
        return RampedMotion.to_target(start_ns, direction, TEN_SECONDS // ramp.period_ticks, ramp)

    patch.setattr(RampedMotion, "endless", staticmethod(endless))


@mutant("MACS-CMD-10-01")
def an_arm_lasts_half_a_minute(patch: MonkeyPatch) -> None:
    """What 10h has begun is dropped after thirty seconds."""

    def arm(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.armed_ns = now
        return bool(go())

    def make(held: Any_) -> Any_:
        def holding(axis: Any, now: int, *rest: Any) -> bool:
            def begin(index: int, parameters: int) -> bool:
                if now - getattr(axis, "armed_ns", now) > 30 * SECOND_NS:
                    axis._armed, axis._preload = False, None
                return bool(held_back(index, parameters))

            held_back = axis._held_back
            axis._held_back = begin
            try:
                return bool(held(axis, now, *rest))
            finally:
                del axis._held_back

        return holding

    on(patch, 0x10, arm)
    wrap(patch, Axis, "execute", make)


# --- 17h -----------------------------------------------------------------------------------------


@mutant("MACS-CMD-17-02")
def a_ramped_stop_amid_segments_is_kept_for_the_next_motion(patch: MonkeyPatch) -> None:
    """17h during segments is remembered, and ends the 13h or 15h behind them."""

    def stop(go: Any_, axis: Any, _: int, __: int) -> bool:
        axis.owes_stop = axis.drive.kind is State.IN
        return bool(go())

    def begin(go: Any_, axis: Any, now: int, _: int) -> bool:
        was_resting = axis.drive.kind is None
        accepted = bool(go())
        if was_resting and getattr(axis, "owes_stop", False) and axis.drive.kind is not None:
            axis.owes_stop = False
            axis.drive.ramped_stop(now)
        return accepted

    on(patch, 0x17, stop)
    on(patch, (0x13, 0x15), begin)


@mutant("MACS-CMD-17-01", "MACS-CMD-15-04")
def a_second_ramped_stop_is_a_hard_one(patch: MonkeyPatch) -> None:
    """17h, or 15h with 0000, while such a stop slows the axis down stops it dead."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        shaft = _goes(axis)
        slows = shaft is not None and shaft.motion.stopping and not shaft.motion.is_over(now)
        if slows and not n & 0xFFFF:
            axis.drive.hard_stop(now)
            return True
        return bool(go())

    on(patch, (0x15, 0x17), act)


# --- software stops ------------------------------------------------------------------------------

Look = Callable[[Any, int, int], int]


def _looking(patch: MonkeyPatch, look: Look) -> None:
    """Let a software stop act at `look(stops, direction, as it should)`."""
    wrap(
        patch,
        Stops,
        "_first_forbidden",
        lambda first: lambda stops, way: look(stops, way, first(stops, way)),
    )


@mutant("MACS-CMD-09-02", "MACS-STOP-03")
def a_software_stop_at_0_is_none(patch: MonkeyPatch) -> None:
    """A software stop whose number is 0 counts as not set."""

    def look(stops: Any, way: int, place: int) -> int:
        return way * NEVER if place == way * stops._beyond else place

    _looking(patch, look)


@mutant("MACS-CMD-0A-02", "MACS-STOP-03")
def the_inferior_stop_is_none_at_0(patch: MonkeyPatch) -> None:
    """An inferior stop whose number is 0 counts as not set; the superior one acts there."""

    def look(stops: Any, way: int, place: int) -> int:
        return way * NEVER if way < 0 and place == -stops._beyond else place

    _looking(patch, look)


@mutant("MACS-CMD-09-02")
def only_the_size_of_a_software_stop_counts(patch: MonkeyPatch) -> None:
    """A superior stop below 0 acts above it, and an inferior one above 0 below it."""
    _looking(patch, lambda _, way, place: way * abs(place))


@mutant("MACS-CMD-09-02", "MACS-CMD-00-01")
def software_stops_want_to_be_set_after_a_restart(patch: MonkeyPatch) -> None:
    """After start-up the software stops act only when 03h, 09h or 0Ah has been sent."""

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        axis.drive.stops.is_told = True
        accepted = bool(go())
        axis.drive.replan(now)
        return accepted

    def make(shut_down: Any_) -> Any_:
        def shutting(axis: Any, now: int) -> None:
            axis.drive.stops.is_told = False
            shut_down(axis, now)

        return shutting

    def look(stops: Any, way: int, place: int) -> int:
        return place if getattr(stops, "is_told", True) else way * NEVER

    on(patch, ENABLING, act)
    wrap(patch, Axis, "shut_down", make)
    _looking(patch, look)


@mutant("MACS-STOP-03", "MACS-CMD-09-02")
def a_chain_watches_the_stop_it_sets_out_to(patch: MonkeyPatch) -> None:
    """Among segments that turn round only the stop ahead of the first one acts."""

    def make(offer: Any_) -> Any_:
        def offering(drive: Any, now: int, segment: Any, start_ns: int) -> bool:
            if drive.kind is not State.IN:
                drive.stops.ahead = 1 if segment.steps > 0 else -1
            return bool(offer(drive, now, segment, start_ns))

        return offering

    def make_start(start: Any_) -> Any_:
        def starting(drive: Any, now: int, shaft: Any) -> None:
            drive.stops.is_chain = shaft.kind is State.IN
            start(drive, now, shaft)

        return starting

    def look(stops: Any, way: int, place: int) -> int:
        is_chain = getattr(stops, "is_chain", False)
        return way * NEVER if is_chain and way != getattr(stops, "ahead", way) else place

    wrap(patch, Drive, "offer", make)
    wrap(patch, Drive, "_start", make_start)
    _looking(patch, look)


@mutant("MACS-CMD-09-02", "MACS-STOP-03")
def a_tolerance_shifts_the_software_stops(patch: MonkeyPatch) -> None:
    """A software stop acts as many increments later as 1Ch says."""
    _looking(patch, lambda stops, way, place: place + way * stops._values["tolerance"])


@mutant("MACS-CMD-09-02", "MACS-STOP-03")
def software_stops_out_of_order_are_none(patch: MonkeyPatch) -> None:
    """With the superior stop below the inferior one neither acts."""

    def look(stops: Any, way: int, place: int) -> int:
        values = stops._values
        return way * NEVER if values["superior_stop"] < values["inferior_stop"] else place

    _looking(patch, look)
