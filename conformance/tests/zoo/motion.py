"""Faults in point-to-point and endless motion, their ramps, stops, and the busy line."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.motion import ramp as ramp_module
from axistwin.motion.interpolator import Segment
from axistwin.motion.plant import Load, Plant
from axistwin.motion.ramp import Phase, Ramp, RampedMotion
from axistwin.motion.trajectory import Piece
from zoo.mutant import Any_, MonkeyPatch, answers, cells, everywhere, mutant, on, target_of, wrap

LOCK_NS = 10_000_000_000
AGAIN_NS = 30_000_000


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


# --- 13h, 14h ------------------------------------------------------------------------------------


@mutant("MACS-CMD-13-01", traps=(15,))
def a_move_is_relative(patch: MonkeyPatch) -> None:
    """13h adds its number to the position."""
    on(patch, 0x13, lambda go, axis, now, n: go(_signed(n) + axis.counter_at(now)))


@mutant("MACS-CMD-13-01", "MACS-CMD-13-05", traps=(27,))
def a_move_of_two_ramps_ends_one_increment_short(patch: MonkeyPatch) -> None:
    """At 239, 240 and 241 increments the last one is missing."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        distance = _signed(n) - axis.counter_at(now)
        short = (distance > 0) - (distance < 0) if 239 <= abs(distance) <= 241 else 0
        return bool(go(_signed(n) - short))

    on(patch, 0x13, act)


@mutant("MACS-CMD-13-02")
def a_move_is_taken_over_in_motion(patch: MonkeyPatch) -> None:
    """13h while running starts anew from where the axis is."""
    cells(patch, 0x13, (State.PO, State.VE, State.IN), "A")


@mutant("MACS-CMD-13-03")
def a_move_wants_19h_first(patch: MonkeyPatch) -> None:
    """13h is refused as long as the motor is unpowered."""
    on(patch, 0x13, lambda go, axis, now, n: axis.drive.powered and go())


@mutant("MACS-CMD-13-04", traps=(27,))
def a_move_of_no_length_stays_running(patch: MonkeyPatch) -> None:
    """13h to the present position locks the module for ever."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        if _signed(n) == axis.counter_at(now) and axis.drive.kind is None:
            return axis.drive.offer(now, Segment(0x7FFF, 0xFFFF, True), now)
        return bool(go())

    on(patch, 0x13, act)


@mutant("MACS-CMD-0B-01", "MACS-CMD-13-05")
def a_move_that_becomes_longer_keeps_the_speed_it_has(patch: MonkeyPatch) -> None:
    """0Bh on the ramp ends the climb: the rest is run at that level, and down from there."""
    plan = ramp_module.plan

    def planning(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
        held = remaining - counter
        if not 0 < counter < ramp.length or held <= 0:
            return plan(ramp, counter, remaining)
        cruise = Phase((Piece(held, ramp.period_at(counter)),), counter, 0, ramp)
        return (cruise, Phase(tuple(ramp.descend(counter)), counter, -1, ramp))

    everywhere(patch, plan, planning)


@mutant("MACS-CMD-13-05", traps=(27,))
def a_short_move_has_no_ramp(patch: MonkeyPatch) -> None:
    """A move that never reaches full speed runs at full speed all the way."""
    plan = ramp_module.plan

    def planning(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
        if counter or not 0 < remaining < 2 * ramp.length:
            return plan(ramp, counter, remaining)
        return (Phase((Piece(remaining, ramp.period_ticks),), 0, 0, ramp),)

    everywhere(patch, plan, planning)


@mutant("MACS-CMD-13-05")
def a_triangle_stops_climbing_at_half_speed(patch: MonkeyPatch) -> None:
    """A move shorter than two ramps climbs to level 8 at most."""
    plan = ramp_module.plan

    def planning(ramp: Ramp, counter: int, remaining: int) -> tuple[Phase, ...]:
        phases = plan(ramp, counter, remaining)
        if remaining >= 2 * ramp.length:
            return phases
        slowest = ramp.level_period(8)
        return tuple(
            phase._replace(
                pieces=tuple(Piece(n, max(period, slowest)) for n, period in phase.pieces)
            )
            for phase in phases
        )

    everywhere(patch, plan, planning)


@mutant("MACS-CMD-13-06")
def targets_out_of_range_are_the_end_of_the_range(patch: MonkeyPatch) -> None:
    """13h beyond 31 bits is refused and runs to the end of the range all the same."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        if go():
            return True
        if axis.drive.kind is None and not -(1 << 30) <= _signed(n) < 1 << 30:
            axis.drive.go_to(now, (1 << 30) - 1 if _signed(n) > 0 else -(1 << 30), now)
        return False

    on(patch, 0x13, act)


@mutant("MACS-CMD-13-01")
def the_last_target_is_refused(patch: MonkeyPatch) -> None:
    """13h refuses the ends of its own range."""
    on(patch, 0x13, lambda go, axis, now, n: n not in (0x3FFFFFFF, 0xC0000000) and go())


@mutant("MACS-CMD-14-01")
def going_to_0_goes_to_its_parameter(patch: MonkeyPatch) -> None:
    """14h is 13h with the parameter it was given."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        return bool(axis.execute(now, 0x13, n, now) if n else go())

    on(patch, 0x14, act)


@mutant("MACS-CMD-14-01")
def going_to_0_begins_again(patch: MonkeyPatch) -> None:
    """14h is carried out a second time 30 ms later, though 18h has come between."""
    sent_ns: dict[int, int] = {}

    def go_to_0(go: Any_, axis: Axis, now: int, _: int) -> bool:
        sent_ns[id(axis)] = now
        return bool(go())

    def stop(go: Any_, axis: Axis, now: int, _: int) -> bool:
        accepted = bool(go())
        due_ns = sent_ns.pop(id(axis), -AGAIN_NS) + AGAIN_NS
        if now < due_ns:
            axis.drive.go_to(now, 0, due_ns)
        return accepted

    on(patch, 0x14, go_to_0)
    on(patch, 0x18, stop)


@mutant("MACS-CMD-14-01")
def going_to_0_clears_the_counter(patch: MonkeyPatch) -> None:
    """14h makes the present place 0 instead of going there."""
    on(patch, 0x14, lambda go, axis, now, n: axis.execute(now, 0x0B, 0, now))


# --- ramps ---------------------------------------------------------------------------------------


@mutant("MACS-CMD-0F-01", "MACS-CMD-13-01", traps=(28,))
def the_ramp_has_levels_of_equal_share(patch: MonkeyPatch) -> None:
    """All fifteen levels have 8·AA increments."""
    everywhere(
        patch,
        ramp_module.level_bounds,
        lambda length, law: tuple(length * k // 15 for k in range(1, 16)),
    )


@mutant("MACS-CMD-0F-01")
def the_ramp_is_half_as_long(patch: MonkeyPatch) -> None:
    """Ramps have 60·AA increments for even AA."""
    wrap(patch, Drive, "_ramp", lambda ramp: _with_coefficient(ramp, lambda aa: aa - aa // 2))


def _with_coefficient(ramp: Any_, change: Any_) -> Any_:
    def ramping(drive: Drive, period_ticks: int) -> Ramp:
        made = ramp(drive, period_ticks)
        return Ramp(made.period_ticks, change(made.aa), made.rules)

    return ramping


@mutant("MACS-CMD-0F-03", "MACS-CMD-13-01")
def no_ramp_is_the_shortest_ramp(patch: MonkeyPatch) -> None:
    """AA = 0 is taken as 1."""
    wrap(patch, Drive, "_ramp", lambda ramp: _with_coefficient(ramp, lambda aa: aa or 1))


@mutant("MACS-CMD-0F-03")
def without_ramp_it_moves_twice_as_fast(patch: MonkeyPatch) -> None:
    """AA = 0 halves the period too."""

    def make(ramp: Any_) -> Any_:
        def ramping(drive: Drive, period_ticks: int) -> Ramp:
            made = ramp(drive, period_ticks)
            halved = made.period_ticks if made.aa else max(1, made.period_ticks // 2)
            return Ramp(halved, made.aa, made.rules)

        return ramping

    wrap(patch, Drive, "_ramp", make)


# --- 15h -----------------------------------------------------------------------------------------


@mutant("MACS-CMD-15-01", traps=(12,))
def the_selector_of_15h_is_a_sign(patch: MonkeyPatch) -> None:
    """SS from 80h up turns counter-clockwise, as the sign of a signed byte would."""
    wrap(patch, Axis, "_direction_of", lambda _: lambda axis, n: -1 if n >> 16 & 0xFF > 0x7F else 1)


@mutant("MACS-CMD-15-01")
def velocity_motion_runs_at_the_speed_of_0dh(patch: MonkeyPatch) -> None:
    """15h from rest takes the period of 0Dh."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        at_rest = axis.drive.kind is None and n & 0xFFFF
        return bool(go(n & 0xFFFF0000 | axis.values["period"]) if at_rest else go())

    on(patch, 0x15, act)


@mutant("MACS-CMD-15-02", "MACS-CMD-15-03", traps=(13,))
def the_next_15h_may_reverse(patch: MonkeyPatch) -> None:
    """15h with the other direction turns the running motor around."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        running = axis.drive.direction_at(now) if axis.drive.kind is State.VE else 0
        wanted = axis._direction_of(n)
        if running and n & 0xFFFF and wanted != running:
            axis.drive.hard_stop(now)
            axis.drive.run(now)
            axis.drive.run_at(now, n & 0xFFFF, wanted, now)
            return True
        return bool(go())

    on(patch, 0x15, act)


@mutant("MACS-CMD-15-02")
def the_speed_overshoots_while_it_changes(patch: MonkeyPatch) -> None:
    """On the way from one speed to another the axis is four times as fast as at either."""
    change_pieces = ramp_module.change_pieces

    def changing(*speeds: Any, **rules: Any) -> tuple[Piece, ...]:
        pieces = change_pieces(*speeds, **rules)
        return tuple(Piece(one.increments, max(1, one.period_ticks // 4)) for one in pieces)

    everywhere(patch, change_pieces, changing)


def _out_of_segments(patch: MonkeyPatch, phases_of: Any_) -> None:
    """Let 15h during segments lead on by `phases_of(step, change)`: the phase of the step under
    way, and those of the change."""

    def taking_over(start_ns: int, direction: int, ticks: int, ramp: Ramp) -> RampedMotion:
        sound = go(start_ns, direction, ticks, ramp)
        phases = phases_of(sound.phases[0], sound.phases[1:])
        trajectory = replace(sound.trajectory, pieces=ramp_module.joined(phases))
        return replace(sound, trajectory=trajectory, phases=phases)

    go = RampedMotion.taking_over
    patch.setattr(RampedMotion, "taking_over", taking_over)


@mutant("MACS-CMD-15-02")
def a_segment_is_left_amid_its_step(patch: MonkeyPatch) -> None:
    """15h during a segment does not let the step under way come to its end."""
    _out_of_segments(patch, lambda step, change: change)


@mutant("MACS-CMD-15-02")
def out_of_a_segment_the_speed_jumps(patch: MonkeyPatch) -> None:
    """15h during a segment knows no ramp: the new speed is there with the next step."""
    _out_of_segments(patch, lambda step, change: (step, change[-1]))


@mutant("MACS-CMD-15-02")
def the_next_15h_is_only_acknowledged(patch: MonkeyPatch) -> None:
    """15h in velocity motion is accepted and changes nothing."""
    on(
        patch,
        0x15,
        lambda go, axis, now, n: (axis.drive.kind is State.VE and n & 0xFFFF > 0) or go(),
    )


@mutant("MACS-CMD-15-04", traps=(11,))
def velocity_0_is_full_speed(patch: MonkeyPatch) -> None:
    """15h with 0000 runs at the shortest period it knows."""
    on(patch, 0x15, lambda go, axis, now, n: go(n if n & 0xFFFF else n | 0x0640))


@mutant("MACS-CMD-15-04", traps=(29,))
def velocity_0_stops_dead(patch: MonkeyPatch) -> None:
    """15h with 0000 is 18h."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        if n & 0xFFFF or axis.drive.kind is None:
            return bool(go())
        axis.drive.hard_stop(now)
        return True

    on(patch, 0x15, act)


@mutant("MACS-CMD-15-04")
def velocity_0_leaves_segments_alone(patch: MonkeyPatch) -> None:
    """15h with 0000 during segments is accepted and changes nothing."""
    on(
        patch,
        0x15,
        lambda go, axis, now, n: (axis.drive.kind is State.IN and not n & 0xFFFF) or go(),
    )


@mutant("MACS-CMD-15-05", traps=(14,))
def velocity_overwrites_the_period(patch: MonkeyPatch) -> None:
    """15h stores its period as 0Dh does."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        accepted = bool(go())
        if accepted and n & 0xFFFF:
            axis.parameters.set_period(n)
        return accepted

    on(patch, 0x15, act)


@mutant("MACS-CMD-15-06")
def the_first_byte_of_15h_slows_it_down(patch: MonkeyPatch) -> None:
    """A first parameter byte other than 00 doubles the period."""
    on(
        patch,
        0x15,
        lambda go, axis, now, n: go(
            n & 0xFFFF0000 | min(0xFFFF, (n & 0xFFFF) * 2) if n >> 24 else n
        ),
    )


# --- stops and power -----------------------------------------------------------------------------


@mutant("MACS-CMD-17-01", traps=(29,))
def a_ramped_stop_stops_dead(patch: MonkeyPatch) -> None:
    """17h is 18h."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis.drive.kind not in (State.PO, State.VE):
            return bool(go())
        axis.drive.hard_stop(now)
        return True

    on(patch, 0x17, act)


@mutant("MACS-CMD-17-01", traps=(29,))
def after_a_ramped_stop_it_creeps_on(patch: MonkeyPatch) -> None:
    """When 17h has stopped a move, the axis goes on to the old target."""

    def act(go: Any_, axis: Any, now: int, _: int) -> bool:
        drive = axis.drive
        if drive.kind is State.PO:
            drive.creeps_to = target_of(drive)
        return bool(go())

    def make(finish: Any_) -> Any_:
        def finishing(drive: Any, now: int) -> None:
            finish(drive, now)
            target = getattr(drive, "creeps_to", None)
            if target is not None and drive.kind is None:
                drive.creeps_to = None
                drive.go_to(now, target, now)

        return finishing

    on(patch, 0x17, act)
    wrap(patch, Drive, "_finish", make)


@mutant("MACS-CMD-18-01", traps=(29,))
def a_hard_stop_ramps(patch: MonkeyPatch) -> None:
    """18h in a move is 17h."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis.drive.kind not in (State.PO, State.VE):
            return bool(go())
        axis.drive.ramped_stop(now)
        return True

    on(patch, 0x18, act)


@mutant("MACS-CMD-18-01", "MACS-CMD-18-03")
def a_hard_stop_is_a_pause(patch: MonkeyPatch) -> None:
    """A tenth of a second after 18h the move goes on."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        drive = axis.drive
        target = target_of(drive)
        accepted = bool(go())
        if target is not None:
            drive.go_to(now, target, now + 100_000_000)
        return accepted

    on(patch, 0x18, act)


@mutant("MACS-CMD-18-02")
def a_hard_stop_wants_a_motion(patch: MonkeyPatch) -> None:
    """18h at rest is refused."""
    on(patch, 0x18, lambda go, axis, now, n: axis.drive.kind is not None and go())


@mutant("MACS-CMD-1A-01")
def power_off_waits_for_rest(patch: MonkeyPatch) -> None:
    """1Ah in motion is accepted and does nothing."""
    on(patch, 0x1A, lambda go, axis, now, n: axis.drive.kind is not None or go())


@mutant("MACS-CMD-1A-01")
def power_off_is_locked_in_motion(patch: MonkeyPatch) -> None:
    """1Ah in motion is refused."""
    cells(patch, 0x1A, (State.PO, State.VE, State.IN), "R")


@mutant("MACS-CMD-02-03")
def in_standby_it_swings_two_increments(patch: MonkeyPatch) -> None:
    """With half torque at rest the shaft swings by two increments."""

    def change(value: int, axis: Axis, now: int) -> int:
        swings = axis.values["standby"] and axis.drive.kind is None and axis.drive._position_mode
        return value + (2 if swings and now // 8_000_000 % 2 else 0)

    answers(patch, 0x20, change)


# --- busy, running -------------------------------------------------------------------------------


def _judged(patch: MonkeyPatch, change: Any_) -> None:
    """Let the busy line be `change(is_busy, drive, now)`."""
    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: change(busy(drive, now), drive, now),
    )


@mutant("MACS-BUSY-01")
def busy_ignores_the_tolerance(patch: MonkeyPatch) -> None:
    """A move is busy up to its exact end."""
    _judged(patch, lambda busy, drive, now: busy or drive.kind is State.PO)


@mutant("MACS-BUSY-01")
def a_move_is_never_busy(patch: MonkeyPatch) -> None:
    """Only a held axis is busy."""
    _judged(patch, lambda busy, drive, now: False)


@mutant("MACS-STATE-01", "MACS-CMD-13-01")
def the_lock_outlives_the_motion(patch: MonkeyPatch) -> None:
    """After a move the axis stays locked for 10 s, or until 18h."""

    def make(finish: Any_) -> Any_:
        def finishing(drive: Drive, now: int) -> None:
            was_position = drive.kind is State.PO
            finish(drive, now)
            if was_position and drive.kind is None and drive.powered:
                drive.offer(now, Segment(LOCK_NS // 8_191_875, 0xFFFF, True), now)

        return finishing

    wrap(patch, Drive, "_finish", make)


@mutant("MACS-STATE-01")
def the_lock_ends_early(patch: MonkeyPatch) -> None:
    """In the last 200 ms of a motion nothing is locked any more."""

    def act(go: Any_, axis: Any, now: int, n: int) -> bool:
        end_ns = axis.drive.next_event()
        if go():
            return True
        if end_ns is None or end_ns - now > 200_000_000 or axis.drive.kind is None:
            return False
        return bool(axis.parameters.set_standby(n))

    on(patch, 0x02, act)


@mutant("MACS-STATE-01")
def a_stopped_endless_motion_waits_for_its_shaft(patch: MonkeyPatch) -> None:
    """After 17h in velocity mode a held axis stays locked until it is where its ramp has ended."""

    def make(end: Any_) -> Any_:
        def ending(drive: Drive, now: int) -> int | None:
            end_ns: int | None = end(drive, now)
            if end_ns is None or drive.kind is not State.VE or drive.plant.target is None:
                return end_ns
            return drive.plant.settle_ns(end_ns, drive._values["tolerance"])

        return ending

    wrap(patch, Drive, "_end_ns", make)


@mutant("MACS-BUSY-01")
def a_shaft_let_go_in_a_move_leaps_to_its_set_point(patch: MonkeyPatch) -> None:
    """What was missed while the shaft was held is made up at once, if the profile still runs."""

    def make(set_load: Any_) -> Any_:
        def loading(plant: Plant, now: int, load: Load) -> None:
            was_held = plant.load.held
            set_load(plant, now, load)
            if was_held and not load.held and plant._set_point is not None:
                base = Fraction(plant._base + plant._set_point.displacement_at(now))
                plant._shaft = plant._shaft._replace(exact=base, offset=plant._base)

        return loading

    wrap(patch, Plant, "set_load", make)


@mutant("MACS-STATE-03")
def a_fault_of_the_start_up_stays(patch: MonkeyPatch) -> None:
    """What goes wrong while the module starts is kept, though it is over when the start is."""
    wrap(
        patch,
        Axis,
        "start",
        lambda start: lambda axis, now: None if axis.faults.disjuncted else start(axis, now),
    )


@mutant("MACS-CMD-17-01")
def a_ramped_stop_before_segments_lets_the_shaft_go(patch: MonkeyPatch) -> None:
    """17h drops a segment that waits, and then the place of rest is no longer held."""

    def make(stop: Any_) -> Any_:
        def stopping(drive: Drive, now: int) -> None:
            stop(drive, now)
            if drive._segments_wait:
                drive._end_segments(now)

        return stopping

    wrap(patch, Drive, "ramped_stop", make)


@mutant("MACS-STOP-01")
def a_catch_up_counts_as_clockwise(patch: MonkeyPatch) -> None:
    """Catching up is taken for motion in the positive direction, whatever way it leads."""
    wrap(patch, Drive, "_catch_up_direction", lambda way: lambda drive, now: abs(way(drive, now)))


@mutant("MACS-STOP-01")
def a_catch_up_knows_no_stop(patch: MonkeyPatch) -> None:
    """Stops look at the profile: with that over, what is left of a move leads nowhere for them."""
    wrap(patch, Drive, "_catch_up_direction", lambda way: lambda drive, now: 0)
