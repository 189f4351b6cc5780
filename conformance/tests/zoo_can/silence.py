"""Faults that ten seconds without a request bring out, and what is told for no error (EMCY)."""

from __future__ import annotations

from typing import Any

from zoo.mutant import MOVING, Any_, MonkeyPatch, State

from axistwin.devices.mac.can.device import MacCan
from zoo_can.planting import REFUSED, around, can_mutant, hears


def _with_a_lifebeat(patch: MonkeyPatch, act: Any_) -> None:
    """Let a lifebeat do `act(module, now)` beside what it does."""

    def beat(go: Any_, module: MacCan, now: int) -> None:
        go()
        act(module, now)

    around(patch, "_lifebeat", beat)


@can_mutant("MACC-CMD-10-01")
def a_lifebeat_disarms(patch: MonkeyPatch) -> None:
    """Who has said nothing for ten seconds has forgotten what he armed."""

    def act(module: MacCan, _: int) -> None:
        if module.axis._preload is None:
            module.axis._armed = False

    _with_a_lifebeat(patch, act)


@can_mutant("MACC-EMCY-01")
def a_lifebeat_sets_the_tolerance_to_0(patch: MonkeyPatch) -> None:
    """2006h tells no tolerance after ten seconds of silence."""
    _with_a_lifebeat(patch, lambda module, _: module.axis.parameters._set("tolerance", 0))


@can_mutant("MACC-CMD-16-01")
def a_lifebeat_empties_the_fifo(patch: MonkeyPatch) -> None:
    """The segment in progress is ended, those stored behind it are dropped."""

    def act(module: MacCan, now: int) -> None:
        if module.axis.drive.kind is State.IN:
            module.axis.drive.stop_segments(now, after_this_one=True)

    _with_a_lifebeat(patch, act)


@can_mutant("MACC-CMD-15-01")
def a_lifebeat_stops_an_endless_motion(patch: MonkeyPatch) -> None:
    """Nobody is there to end it, and so the module does."""

    def act(module: MacCan, now: int) -> None:
        if module.axis.drive.kind is State.VE:
            module.axis.drive.ramped_stop(now)

    _with_a_lifebeat(patch, act)


@can_mutant("MACC-Q-01-01")
def a_lifebeat_clears_the_stop_bits(patch: MonkeyPatch) -> None:
    """What a lifebeat has told is taken for read."""

    def act(module: MacCan, _: int) -> None:
        module.axis.drive.stops.bits = 0

    _with_a_lifebeat(patch, act)


@can_mutant("MACC-EMCY-01")
def switched_off_the_motor_has_no_lifebeat(patch: MonkeyPatch) -> None:
    """From 201Ah until the motor is powered again the module says nothing."""

    def note(go: Any_, module: Any, request: bytes) -> Any:
        reply = go()
        if request[:3] == b"\x23\x1a\x20":
            module.is_switched_off = True
        return reply

    def beat(go: Any_, module: Any, now: int) -> None:
        module.is_switched_off = (
            getattr(module, "is_switched_off", False) and not module.axis.drive.powered
        )
        if module.is_switched_off:
            module._restart_lifebeat(now)
        else:
            go()

    around(patch, "_serve", note)
    around(patch, "_lifebeat", beat)


@can_mutant("MACC-EMCY-01", "MACC-EMCY-05")
def any_frame_puts_the_lifebeat_off(patch: MonkeyPatch) -> None:
    """The ten seconds are of silence on the bus."""
    hears(
        patch, lambda module, frame: True, lambda module, _: module._restart_lifebeat(module._now)
    )
    for service in ("_general_request", "_sync"):

        def act(go: Any_, module: MacCan, data: bytes) -> None:
            module._restart_lifebeat(module._now)
            go()

        around(patch, service, act)


@can_mutant("MACC-EMCY-02")
def a_refusal_in_motion_is_an_emergency(patch: MonkeyPatch) -> None:
    """What is refused for the motion is told as an error."""

    def act(go: Any_, module: MacCan, request: bytes) -> bytes | None:
        reply: bytes | None = go()
        if reply is not None and reply[0] == REFUSED and module.axis.state in MOVING:
            module._send_emergency(module._now, module.axis.query(module._now, 0x21))
        return reply

    around(patch, "_serve", act)
