"""Faults that only a rig can show: inputs, the reference, the shaft, the reset input."""

from __future__ import annotations

from axistwin.devices.mac.axis import drive as drive_module
from axistwin.devices.mac.axis import stops as stops_module
from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.counter import Counter
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.module import MacModule
from axistwin.devices.mac.axis.stops import HARDWARE, Stops
from axistwin.motion.plant import Plant
from zoo.mutant import Any_, MonkeyPatch, answers, motion_of, mutant, wrap


@mutant("MACS-Q-27-02", traps=(20,))
def inputs_show_only_if_enabled(patch: MonkeyPatch) -> None:
    """27h shows stop inputs only while 03h enables them."""
    answers(
        patch,
        0x27,
        lambda value, axis, now: value if axis.values["stops"] & HARDWARE else value & ~0x2040,
    )


@mutant("MACS-Q-27-02", "MACS-Q-27-01", traps=(20,))
def both_stop_inputs_are_in_one_byte(patch: MonkeyPatch) -> None:
    """27h shows the positive stop input in dd, as bit 5."""

    def change(value: int, axis: Axis, _: int) -> int:
        moved = 0x20 if axis.inputs["positive_stop"] else 0
        return value & ~0x2000 | moved

    answers(patch, 0x27, change)


@mutant("MACS-STOP-01")
def the_stop_inputs_are_exchanged(patch: MonkeyPatch) -> None:
    """The positive input ends negative motion."""
    wrap(patch, Stops, "is_blocked_hard", lambda blocked: lambda stops, way: blocked(stops, -way))


@mutant("MACS-STOP-01")
def a_stop_input_blocks_both_ways(patch: MonkeyPatch) -> None:
    """An active hardware stop ends motion of either sign."""
    wrap(
        patch,
        Stops,
        "is_blocked_hard",
        lambda blocked: lambda stops, way: blocked(stops, way) or blocked(stops, -way),
    )


@mutant("MACS-STOP-01", traps=(20,))
def the_two_hardware_bits_are_exchanged(patch: MonkeyPatch) -> None:
    """ff bit 2 tells the positive input, bit 3 the negative one."""
    patch.setattr(stops_module, "HARD_BITS", {1: 0x04, -1: 0x08})


@mutant("MACS-STOP-02", "MACS-CMD-03-01")
def stop_inputs_act_though_disabled(patch: MonkeyPatch) -> None:
    """03h does not disable the hardware stops."""
    wrap(patch, Stops, "is_blocked_hard", lambda blocked: lambda stops, way: stops.inputs[way])


@mutant("MACS-REF-01", traps=(22,))
def the_reference_acts_in_negative_motion(patch: MonkeyPatch) -> None:
    """The counter is zeroed in either direction."""

    def edge(axis: Axis, now: int) -> None:
        if axis._reference_enabled and axis.drive.direction_at(now):
            axis.drive.zero(now, keeps_remaining=False)

    patch.setattr(Axis, "_reference_edge", edge)


@mutant("MACS-REF-01")
def the_reference_ends_the_motion(patch: MonkeyPatch) -> None:
    """The axis stops where the counter is zeroed."""

    def make(edge: Any_) -> Any_:
        def edging(axis: Axis, now: int) -> None:
            edge(axis, now)
            if axis._reference_enabled and axis.drive.direction_at(now) > 0:
                axis.drive.hard_stop(now)

        return edging

    wrap(patch, Axis, "_reference_edge", make)


@mutant("MACS-REF-01", traps=(22,))
def the_reference_acts_on_both_edges(patch: MonkeyPatch) -> None:
    """Closing the contact zeroes the counter as well as opening it."""

    def make(set_input: Any_) -> Any_:
        def setting(axis: Axis, now: int, name: str, active: bool) -> None:
            was = axis.inputs.get(name)
            set_input(axis, now, name, active)
            if name == "reference" and active and not was:
                axis._reference_edge(now)

        return setting

    wrap(patch, Axis, "set_input", make)


@mutant("MACS-CMD-07-01")
def the_reference_needs_no_enable(patch: MonkeyPatch) -> None:
    """The counter is zeroed whatever 07h said."""

    def make(edge: Any_) -> Any_:
        def edging(axis: Axis, now: int) -> None:
            enabled, axis._reference_enabled = axis._reference_enabled, True
            edge(axis, now)
            axis._reference_enabled = enabled

        return edging

    wrap(patch, Axis, "_reference_edge", make)


@mutant("MACS-IO-01")
def the_reset_input_is_an_edge(patch: MonkeyPatch) -> None:
    """Held low, the module starts once and then talks again."""

    def set_reset(module: MacModule, now: int, held: bool) -> None:
        if held and module._powered:
            module._take_over_at = 1 << 62
            module._begin_boot(now)

    patch.setattr(MacModule, "_set_reset_input", set_reset)


@mutant("MACS-CMD-1A-02")
def without_power_nothing_is_counted(patch: MonkeyPatch) -> None:
    """Turning the shaft by hand counts only while the motor is powered."""
    wrap(
        patch,
        Drive,
        "push",
        lambda push: lambda drive, now, n: push(drive, now, n) if drive.powered else None,
    )


@mutant("MACS-BUSY-02")
def only_moves_are_ever_busy(patch: MonkeyPatch) -> None:
    """A held axis in endless or interpolated motion is not busy."""
    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: drive.kind not in (State.VE, State.IN) and busy(drive, now),
    )


@mutant("MACS-BUSY-02")
def endless_motion_is_always_busy(patch: MonkeyPatch) -> None:
    """Whatever runs is busy."""
    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: drive.kind in (State.VE, State.IN) or busy(drive, now),
    )


@mutant("MACS-BUSY-02")
def an_axis_that_turns_back_is_never_busy(patch: MonkeyPatch) -> None:
    """An axis that is held in endless motion is busy only if it turns the positive way."""

    def is_back(drive: Drive, now: int) -> bool:
        course = drive.plant._set_point if drive.kind is State.VE else None
        return course is not None and course.leg_at(now).direction < 0

    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: not is_back(drive, now) and busy(drive, now),
    )


def _is_profile_over(drive: Drive, now: int) -> bool:
    motion = motion_of(drive)
    return motion is not None and motion.is_over(now)


@mutant("MACS-BUSY-01")
def a_held_move_is_over_with_its_profile(patch: MonkeyPatch) -> None:
    """Once the profile is over, an axis that is held back is not busy any more."""
    wrap(
        patch,
        Drive,
        "is_busy",
        lambda busy: lambda drive, now: busy(drive, now) and not _is_profile_over(drive, now),
    )


@mutant("MACS-CMD-0E-01", traps=(8,))
def catching_up_takes_half_as_long(patch: MonkeyPatch) -> None:
    """One unit of 0Eh is 100 µs."""
    patch.setattr(drive_module, "CATCH_UP_TICKS", 800)


@mutant("MACS-CMD-18-01")
def after_a_hard_stop_the_place_is_held(patch: MonkeyPatch) -> None:
    """18h leaves the position regulation on: a shaft turned by hand comes back."""

    def make(hard_stop: Any_) -> Any_:
        def stopping(drive: Drive, now: int, **options: bool) -> None:
            place = drive.counter.at(now)
            hard_stop(drive, now, **options)
            drive.run(now)
            if drive.kind is None:
                drive.go_to(now, place, now)

        return stopping

    wrap(patch, Drive, "hard_stop", make)


# --- a shaft that is not on its set-point --------------------------------------------------------


@mutant("MACS-CMD-0B-01")
def the_set_point_is_cleared_instead_of_the_counter(patch: MonkeyPatch) -> None:
    """0Bh makes the set-point 0, so that a shaft that lags behind reads its lag."""

    def setting(counter: Counter, now: int, number: int) -> None:
        counter._origin = number - counter._plant.set_point_at(now)
        counter.settled = True

    patch.setattr(Counter, "set", setting)


@mutant("MACS-CMD-0B-01")
def a_cleared_move_counts_its_way_from_the_shaft(patch: MonkeyPatch) -> None:
    """0Bh in a move whose shaft lags takes the way that is left for that of the shaft, and adds it
    to where the set-point is."""
    patch.setattr(Counter, "of_set_point", lambda counter, now: counter._unfolded(now))


@mutant("MACS-CMD-0E-01")
def catching_up_knows_no_0eh(patch: MonkeyPatch) -> None:
    """0Eh is stored and read back, and the axis catches up as fast as ever."""
    patch.setattr(Plant, "set_catch_up", lambda *_: None)


@mutant("MACS-CMD-0E-02")
def the_catch_up_begins_anew_with_every_0eh(patch: MonkeyPatch) -> None:
    """0Eh drops the time that has passed of the increment under way."""

    def make(change: Any_) -> Any_:
        def changing(plant: Plant, now: int, period_ticks: int) -> None:
            change(plant, now, period_ticks)
            plant._shaft = plant._shaft._replace(step_due_ns=None)

        return changing

    wrap(patch, Plant, "set_catch_up", make)


@mutant("MACS-STOP-01")
def a_catch_up_has_the_sign_of_its_move(patch: MonkeyPatch) -> None:
    """What is left of a move up is ended by the positive stop though it counts down."""

    def make(catch_up: Any_) -> Any_:
        def heading(drive: Drive, now: int) -> int:
            motion = motion_of(drive)
            direction = int(catch_up(drive, now))
            return motion.trajectory.direction if direction and motion else direction

        return heading

    wrap(patch, Drive, "_catch_up_direction", make)
