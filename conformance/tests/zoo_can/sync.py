"""Faults in what SYNC starts (SYNC)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import Any_, MonkeyPatch, State, on, wrap

from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.can.device import MacCan
from zoo_can.planting import around, can_mutant, hears

SYNC = 0x080


@can_mutant("MACC-SYNC-01", traps=(13,))
def every_lifebeat_is_a_sync(patch: MonkeyPatch) -> None:
    """The lower seven bits of the identifier are not looked at: 081h to 0FFh are SYNC as well."""
    hears(
        patch,
        lambda module, frame: SYNC < frame.identifier < 0x100 and not frame.is_extended,
        lambda module, frame: module._sync(b""),
    )


@can_mutant("MACC-SYNC-01", "MACC-ID-02")
def network_management_is_a_sync(patch: MonkeyPatch) -> None:
    """Bit 7 of the identifier is masked in the filter of SYNC: 000h starts what is preloaded."""
    hears(
        patch,
        lambda module, frame: frame.identifier == 0 and not frame.is_extended,
        lambda module, frame: module._sync(b""),
    )


@can_mutant("MACC-SYNC-01")
def its_own_emergency_identifier_is_a_sync(patch: MonkeyPatch) -> None:
    """080h plus the own address starts what is preloaded, as 080h does."""
    hears(
        patch,
        lambda module, frame: frame.identifier == SYNC + module.address and not frame.is_extended,
        lambda module, frame: module._sync(b""),
    )


@can_mutant("MACC-SYNC-04")
def a_sync_without_a_preload_ends_endless_motion(patch: MonkeyPatch) -> None:
    """The empty record of the preload reads as 2015h with VVVV 0000: the axis comes to rest."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        axis = module.axis
        if axis._preload is None and axis.state is State.VE:
            axis.drive.ramped_stop(module._now)
        go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-02", traps=(11,))
def sync_is_acknowledged(patch: MonkeyPatch) -> None:
    """SYNC is answered like the download of 2011h that it stands for."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        go()
        module._answer(0x580 + module.address, b"\x60\x11\x20\0\0\0\0\0")

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-02", traps=(11,))
def a_sync_that_starts_something_is_acknowledged(patch: MonkeyPatch) -> None:
    """SYNC is answered by those in whom something was preloaded."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        had = module.axis._preload is not None
        go()
        if had:
            module._answer(0x580 + module.address, b"\x60\x11\x20\0\0\0\0\0")

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-04", traps=(12,))
def sync_arms(patch: MonkeyPatch) -> None:
    """Where nothing is preloaded SYNC holds the next motion back."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        had = module.axis._preload is not None
        go()
        if not had:
            module.axis._armed = True

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-04", traps=(12,))
def sync_moves_who_was_not_armed(patch: MonkeyPatch) -> None:
    """At rest and powered, SYNC without a preload goes on by ten increments."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        axis = module.axis
        if axis._preload is None and axis.drive.kind is None and axis.drive._position_mode:
            axis.drive.go_to(module._now, axis.counter_at(module._now) + 10, module._now)
        go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-04")
def sync_disarms(patch: MonkeyPatch) -> None:
    """SYNC drops an arm that has no motion yet."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        if module.axis._preload is None:
            module.axis._armed = False
        go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-01", "MACC-SYNC-03", traps=(12,))
def sync_starts_moves_only(patch: MonkeyPatch) -> None:
    """A preloaded 2015h waits for 2011h; SYNC does not start it."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        held = module.axis._preload
        if held is None or held[0] != 0x15:
            go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-03")
def sync_turns_endless_motions_up(patch: MonkeyPatch) -> None:
    """A preloaded 2015h goes clockwise when SYNC starts it, whatever its SS."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        held = module.axis._preload
        if held is not None and held[0] == 0x15:
            module.axis._preload = (0x15, held[1] & 0xFFFF)
        go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-03")
def sync_counts_at_rest_only(patch: MonkeyPatch) -> None:
    """A speed that is preloaded in motion waits for 2011h."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        if module.axis.drive.kind is None:
            go()

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-03")
def only_sync_starts_what_is_preloaded(patch: MonkeyPatch) -> None:
    """2011h is accepted and starts nothing."""
    on(patch, 0x11, lambda go, axis, now, n: True)

    def act(_: Any_, module: MacCan, __: bytes) -> None:
        if module.axis._preload is not None:
            module.axis._synchronise(module._now, 0, module._now)

    around(patch, "_sync", act)


@can_mutant("MACC-SYNC-01")
def sync_is_ignored(patch: MonkeyPatch) -> None:
    """Only 2011h starts what is preloaded."""
    around(patch, "_sync", lambda go, module, data: None)


@can_mutant("MACC-SYNC-01")
def sync_concerns_module_1_only(patch: MonkeyPatch) -> None:
    """The other modules wait for a 2011h of their own."""
    around(patch, "_sync", lambda go, module, data: go() if module.address == 1 else None)


@can_mutant("MACC-SYNC-01")
def sync_starts_20_ms_late(patch: MonkeyPatch) -> None:
    """The preloaded motion starts 20 ms after SYNC, and at once after 2011h."""

    def act(go: Any_, module: MacCan, data: bytes) -> None:
        axis: Any = module.axis
        axis.later_ns = 20_000_000
        go()
        axis.later_ns = 0

    def make(start: Any_) -> Any_:
        def starting(axis: Any, now: int, held: Any, start_ns: int) -> Any:
            return start(axis, now, held, start_ns + getattr(axis, "later_ns", 0))

        return starting

    around(patch, "_sync", act)
    wrap(patch, Axis, "_start_held", make)


@can_mutant("MACC-SYNC-05")
def a_sync_of_eight_bytes_is_none(patch: MonkeyPatch) -> None:
    """SYNC may have a counter behind it, but no more."""
    around(patch, "_sync", lambda go, module, data: go() if len(data) < 2 else None)
