"""Faults in software stops."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis import stops as stops_module
from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.devices.mac.axis.stops import SOFTWARE, Stops
from zoo.mutant import Any_, MonkeyPatch, mutant, on, wrap


def _signed(number: int) -> int:
    return number - (1 << 32) if number >> 31 else number


@mutant("MACS-CMD-09-02", traps=(21,))
def a_software_stop_clips_the_target(patch: MonkeyPatch) -> None:
    """13h beyond a software stop ends on it, and no bit tells."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        values = axis.values
        if not values["stops"] & SOFTWARE:
            return bool(go())
        return bool(go(max(values["inferior_stop"], min(values["superior_stop"], _signed(n)))))

    on(patch, 0x13, act)


@mutant("MACS-CMD-18-03", "MACS-STOP-03")
def a_software_stop_leaves_the_preload(patch: MonkeyPatch) -> None:
    """What 18h drops, stays where a stop has ended the motion before it."""

    def make(obey: Any_) -> Any_:
        def obeying(axis: Axis, now: int) -> None:
            kept, is_met = (axis._armed, axis._preload), axis.drive.met_stop
            obey(axis, now)
            if is_met:
                axis._armed, axis._preload = kept

        return obeying

    wrap(patch, Axis, "_obey_stops", make)


def _without_stop(patch: MonkeyPatch, direction: int, kinds: tuple[State, ...]) -> None:
    """Let the software stop of `direction` not act in motions of `kinds`."""

    def make(first: Any_) -> Any_:
        def looking(stops: Any, way: int) -> int:
            ignored = way == direction and getattr(stops, "kind", None) in kinds
            return way << 40 if ignored else int(first(stops, way))

        return looking

    def make_start(start: Any_) -> Any_:
        def starting(drive: Any, now: int, owner: Any) -> None:
            drive.stops.kind = owner.kind
            start(drive, now, owner)

        return starting

    wrap(patch, Stops, "_first_forbidden", make)
    wrap(patch, Drive, "_start", make_start)


@mutant("MACS-CMD-09-02")
def the_superior_stop_is_not_watched(patch: MonkeyPatch) -> None:
    """Only the inferior stop ends a motion."""
    _without_stop(patch, 1, tuple(State))


@mutant("MACS-CMD-0A-02")
def the_inferior_stop_is_not_watched(patch: MonkeyPatch) -> None:
    """Only the superior stop ends a motion."""
    _without_stop(patch, -1, tuple(State))


@mutant("MACS-STOP-03")
def segments_pass_a_software_stop(patch: MonkeyPatch) -> None:
    """Software stops end 13h and 15h only."""
    _without_stop(patch, 1, (State.IN,))


@mutant("MACS-STOP-03")
def velocity_passes_a_software_stop(patch: MonkeyPatch) -> None:
    """Software stops do not end endless motion."""
    _without_stop(patch, 1, (State.VE,))


@mutant("MACS-STOP-03", "MACS-CMD-09-02")
def software_stops_stay_in_space(patch: MonkeyPatch) -> None:
    """0Bh shifts the stops with the counter, so that they stay where they were on the shaft."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        before = axis.counter_at(now)
        accepted = bool(go())
        axis.parameters.values["superior_stop"] -= before
        return accepted

    on(patch, 0x0B, act)


@mutant("MACS-CMD-09-02", traps=(20,))
def the_two_software_bits_are_exchanged(patch: MonkeyPatch) -> None:
    """ff bit 0 tells the superior stop, bit 1 the inferior one."""
    patch.setattr(stops_module, "SOFT_BITS", {1: 0x01, -1: 0x02})


@mutant("MACS-CMD-03-01", "MACS-CMD-09-02")
def software_stops_are_always_on(patch: MonkeyPatch) -> None:
    """03h with 1 enables the software stops as well."""
    patch.setattr(stops_module, "SOFTWARE", 0x09)


@mutant("MACS-STOP-03")
def the_superior_stop_is_noticed_late(patch: MonkeyPatch) -> None:
    """The superior stop is noticed three increments late, the inferior one at once."""
    wrap(
        patch,
        Stops,
        "_first_forbidden",
        lambda first: lambda stops, way: first(stops, way) + 3 * (way > 0),
    )


@mutant("MACS-Q-21-01")
def the_stop_bit_is_cleared_by_18h(patch: MonkeyPatch) -> None:
    """18h clears ff."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        accepted = bool(go())
        axis.drive.stops.bits = 0
        return accepted

    on(patch, 0x18, act)


@mutant("MACS-STOP-03")
def a_stop_is_not_looked_for_again_after_0bh(patch: MonkeyPatch) -> None:
    """A motion whose counter is cleared looks for its stops only where it expected them before."""

    def make(zero: Any_) -> Any_:
        def zeroing(drive: Drive, now: int, **how: Any) -> None:
            expected = drive._next
            zero(drive, now, **how)
            drive._next = expected

        return zeroing

    wrap(patch, Drive, "zero", make)


@mutant("MACS-CMD-0A-02", "MACS-STOP-03")
def only_the_superior_stop_is_looked_for_where_both_are_in_the_way(patch: MonkeyPatch) -> None:
    """Segments that would pass both software stops pass the inferior one, though they meet it
    first."""

    def make(meet: Any_) -> Any_:
        def meeting(stops: Stops, now: int, direction: int, set_point: Any) -> Any:
            superior = meet(stops, now, 1, set_point)
            if direction > 0 or superior is not None:
                return superior if direction > 0 else None
            return meet(stops, now, direction, set_point)

        return meeting

    wrap(patch, Stops, "_next_of", make)
