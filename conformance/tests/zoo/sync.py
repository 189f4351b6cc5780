"""Faults in synchronous mode."""

from __future__ import annotations

from axistwin.devices.mac.axis.axis import Axis
from zoo.mutant import MOVING, Any_, MonkeyPatch, State, answers, cells, mutant, on, wrap

ARM, START = 0x10, 0x11


@mutant("MACS-CMD-10-01")
def arming_does_nothing(patch: MonkeyPatch) -> None:
    """10h is accepted, and the next motion starts directly."""
    on(patch, ARM, lambda go, axis, now, n: True)


@mutant("MACS-CMD-10-01")
def arming_is_locked_in_motion(patch: MonkeyPatch) -> None:
    """10h is refused while running."""
    cells(patch, ARM, MOVING, "R")


@mutant("MACS-CMD-10-02", traps=(23,))
def arming_is_for_good(patch: MonkeyPatch) -> None:
    """After 11h the module is armed again."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        was_loaded = axis._preload is not None
        accepted = bool(go())
        axis._armed = axis._armed or was_loaded
        return accepted

    on(patch, START, act)


@mutant("MACS-CMD-11-02")
def the_preloaded_motion_can_be_started_again(patch: MonkeyPatch) -> None:
    """Each further 11h goes on by as much as the first."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis._preload is None and axis.drive.kind is None and axis.drive._position_mode:
            axis.drive.go_to(now, axis.counter_at(now) + 30, now)
            return True
        return bool(go())

    on(patch, START, act)


@mutant("MACS-CMD-10-03", traps=(23,))
def segments_are_held_back_too(patch: MonkeyPatch) -> None:
    """16h after 10h is accepted and waits for a start that never comes."""
    on(patch, (0x16, 0x1E), lambda go, axis, now, n: axis._armed or go())


@mutant("MACS-CMD-11-01")
def sync_starts_nothing(patch: MonkeyPatch) -> None:
    """11h is accepted and the preloaded motion stays where it is."""
    on(patch, START, lambda go, axis, now, n: True)


@mutant("MACS-CMD-11-01")
def sync_starts_50_ms_late(patch: MonkeyPatch) -> None:
    """The preloaded motion starts 50 ms after 11h."""
    on(patch, START, lambda go, axis, now, n: go(later_ns=50_000_000))


@mutant("MACS-CMD-11-02", traps=(23,))
def sync_moves_without_a_motion(patch: MonkeyPatch) -> None:
    """10h, 11h repeats a move of 100 increments."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        if axis._armed and axis._preload is None and axis.drive.kind is None:
            axis._armed = False
            axis.drive.go_to(now, axis.counter_at(now) + 100, now)
            return True
        return bool(go())

    on(patch, START, act)


@mutant("MACS-CMD-10-02")
def both_preloaded_targets_add_up(patch: MonkeyPatch) -> None:
    """A second motion while one is preloaded shifts its target by one."""

    def make(held: Any_) -> Any_:
        def holding(axis: Axis, index: int, parameters: int) -> bool:
            return bool(held(axis, index, parameters + (axis._preload is not None)))

        return holding

    wrap(patch, Axis, "_held_back", make)


@mutant("MACS-STATE-01")
def a_preloaded_module_is_busy(patch: MonkeyPatch) -> None:
    """27h tells busy while a motion waits for 11h."""
    answers(patch, 0x27, lambda value, axis, now: value & ~0x0800 if axis._preload else value)


@mutant("MACS-CMD-11-01")
def a_preloaded_speed_is_lost_in_segments(patch: MonkeyPatch) -> None:
    """11h while segments run forgets a 15h held back."""

    def act(go: Any_, axis: Axis, _: int, __: int) -> bool:
        held = axis._preload
        if held is not None and held[0] == 0x15 and axis.drive.kind is State.IN:
            axis._preload = None
            return True
        return bool(go())

    on(patch, 0x11, act)


@mutant("MACS-CMD-13-02")
def an_arm_in_motion_opens_the_lock(patch: MonkeyPatch) -> None:
    """Whether 10h holds a move back is looked at before the lock: armed, 13h passes in motion."""

    def make(is_locked: Any_) -> Any_:
        def locking(axis: Axis, index: int, number: int) -> bool:
            return bool(is_locked(axis, index, number)) and not (index == 0x13 and axis._armed)

        return locking

    wrap(patch, Axis, "is_locked", make)


@mutant("MACS-STATE-01")
def what_11h_starts_locks_nothing(patch: MonkeyPatch) -> None:
    """The lock is set by 13h and 15h where they start a motion, and not by 11h."""
    is_free = [False]

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        is_taken = bool(go())
        is_free[0] = axis.drive.kind is not None
        return is_taken

    def make(is_locked: Any_) -> Any_:
        def locking(axis: Axis, index: int, number: int) -> bool:
            is_free[0] = is_free[0] and axis.drive.kind is not None
            return bool(is_locked(axis, index, number)) and not is_free[0]

        return locking

    on(patch, START, act)
    wrap(patch, Axis, "is_locked", make)
