"""The operations of a sequence: what four bytes can mean.

An operation is (what, first, second, pause): `what` picks a line of `OPERATIONS`, `first` and
`second` its arguments, and `pause` a wait after it.  Any four bytes are an operation; what the
state of the model does not allow is replaced by a stop or a query.  Lines are only ever appended:
a recorded sequence keeps its meaning as long as the table is not longer than what it names.

Left out because the ledger does not say what happens: 15h while segments run and 10h while
anything runs (each has a check of its own); segments while armed; 0Bh in a move (AMB-53).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from axistwin_conformance.families.mac.axis.driver.driver import AxisDriver
from axistwin_conformance.families.mac.axis.driver.motion import segment_parameter, velocity
from axistwin_conformance.families.mac.axis.exchanges import ReplyKind
from axistwin_conformance.families.mac.axis.model.axis_model import DROPPING, MOTIONS, SEGMENTS
from axistwin_conformance.families.mac.axis.sequences.sequence import (
    COEFFICIENTS,
    PERIODS,
    AxisOperation,
    AxisSequence,
)

Choices = tuple[int, ...]
Act = Callable[[AxisSequence, int, int], None]

TOLERANCES: Final = (0, 0, 1, 10, 100)
# What a target may lie beside; an offset of 80h is right there.
ANCHORS: Final = (
    "here",
    "superior stop",
    "inferior stop",
    "home",
    "end of motion",
    "counter 0",
    "far above",
    "far below",
)
# How far before or after the predicted end of something the next request is taken over.
OFFSETS_NS: Final = (0, -1_000_000, 1_000_000, -3_000_000, 3_000_000, -300_000, 300_000, 10_000_000)

# Where a device follows another reading than the default and the ledger gives no exact rule for
# it, the operations that would need one are left out.
UNRULED_SEGMENTS: Final = ("fifo_underrun", "abort_flush", "segment_zero_steps")
UNRULED_SYNC: Final = (
    "preload_policy",
    "abort_flush",
    "sync_arm_lifetime",
    "arm_after_segment",
)
UNRULED_CHANGES: Final = ("vel_change_law", "ramp_law", "vel_reverse_cmd")
UNRULED_RAMPED_STOPS: Final = ("stop_ramp_law", "ramp_law")
UNRULED_STOPS: Final = ("soft_stop_compare", "soft_stop_blocks")
UNRULED_RESTARTS: Final = ("persist_modes",)
UNASSIGNED: Final = (0x04, 0x05, 0x06, 0x12, 0x1D, 0x1F, 0x2A, 0x2F)  # on every face
TO_COMMANDS: Final = (ReplyKind.ACCEPTED, ReplyKind.REFUSED)


def _direction(run: AxisSequence, byte: int) -> int:
    """A direction, among those the device has."""
    return 1 if run.known("vel_f6_direction") else -1 if byte & 1 else 1


def _choice(run: AxisSequence, values: Choices, legal: Choices, byte: int) -> int:
    """One of the values; only a legal one if the device takes others somehow (AMB-60)."""
    chosen = values if run.follows("param_range_policy") else legal
    return chosen[byte % len(chosen)]


def _period(run: AxisSequence, byte: int) -> int:
    """A period for 0Dh, now and then 0."""
    if not byte and run.follows("zero_period_0d"):
        return 0
    return max(PERIODS[byte % len(PERIODS)], run.fastest)


def _torque(run: AxisSequence, byte: int) -> int:
    """A torque limit, legal or not."""
    imax = run.model.parameters.imax
    values = (1, 0x40, imax - 1, 0, imax, imax + 1, 0xFF)
    plain = run.follows("torque_range", "torque_over")
    return min(0xFF, values[byte % (len(values) if plain else 3)])


def _catch_up(run: AxisSequence, byte: int) -> int:
    """A speed for 0Eh; never 0 if the device refuses that (MACS-AMB-47)."""
    return max(byte, 0 if run.follows("zero_catchup") else 1) << 8


def _stops(run: AxisSequence, byte: int) -> int:
    """A mode for 03h."""
    if run.model.law.step != "end" or not run.follows(*UNRULED_STOPS):
        return byte & 1
    return _choice(run, (0, 8, 9, 1, 2, 8), (0, 8, 9, 1, 0, 8), byte)


def _move(run: AxisSequence, first: int, second: int) -> None:
    run.command(0x13, run.place(first))


def _nudge(run: AxisSequence, first: int, second: int) -> None:
    run.command(0x13, run.here() + first % 21 - 10)


def _home(run: AxisSequence, first: int, second: int) -> None:
    is_near = abs(run.home - run.offset) <= run.room
    is_ruled = run.is_resting or run.follows("motion_lock_set")
    run.command(0x14) if is_near and is_ruled else run.query(0x20)


def _turn(run: AxisSequence, first: int, second: int) -> None:
    _turn_at(run, first, max(PERIODS[second % len(PERIODS)], run.fastest))


def _turn_at(run: AxisSequence, first: int, period: int) -> None:
    if run.has_segments or not (run.is_resting or run.follows(*UNRULED_CHANGES)):
        run.command(0x18)
        return
    if not run.may_change() or not run.has_room(period):
        run.command(0x18)
        return
    run.command(0x15, velocity(_direction(run, first), period))


def _turn_off(run: AxisSequence, first: int, second: int) -> None:
    is_ruled = run.is_resting or run.follows(*UNRULED_RAMPED_STOPS, "vel_reverse_cmd")
    if run.has_segments or run.is_held or not is_ruled or not run.may_change():
        run.command(0x18)
        return
    run.command(0x15, velocity(_direction(run, first), 0))


def _ramped_stop(run: AxisSequence, first: int, second: int) -> None:
    if run.is_resting:
        run.command(0x17)
        return
    is_ruled = run.follows(*UNRULED_RAMPED_STOPS)
    is_ruled &= not run.has_segments or run.known("stop17_in_interp") < 2
    run.command(0x17 if is_ruled and run.may_change() else 0x18)


def _segment(index: int) -> Act:
    def send(run: AxisSequence, first: int, second: int) -> None:
        is_ruled = run.follows(*UNRULED_SEGMENTS)
        is_ruled &= run.is_resting or run.known("interp_during_profile") < 2
        if run.is_held or not is_ruled:
            run.query(0x20)
            return
        period = max(PERIODS[second % len(PERIODS)], run.fastest)
        is_zero = second == 0xFF and run.follows("segment_zero_period")
        steps = first % 65 - 32
        steps = abs(steps) if run.known("segment_signed") else steps
        run.command(index, segment_parameter(steps, 0 if is_zero else period))

    return send


def _sync(index: int) -> Act:
    def send(run: AxisSequence, first: int, second: int) -> None:
        is_ruled = run.is_resting and run.follows(*UNRULED_SYNC)
        run.command(index if is_ruled else 0x18)

    return send


def _sync_frame(run: AxisSequence, first: int, second: int) -> None:
    """What 11h does, told to all at once; it is not answered, so it must be clear what it does."""
    if run.is_resting and run.follows(*UNRULED_SYNC, "sync_without_preload"):
        run.synchronise()
    else:
        run.command(0x18)


def _set(index: int, value: Callable[[AxisSequence, int], int]) -> Act:
    def send(run: AxisSequence, first: int, second: int) -> None:
        if not run.is_resting and not run.follows("motion_lock_set"):
            run.query(0x20)  # what a new speed or ramp does to a running motion is not said
            return
        run.command(index, value(run, first))

    return send


def _clear(run: AxisSequence, first: int, second: int) -> None:
    if run.is_guarded:
        run.command(0x18)  # so that the place is known exactly, and the envelope stays where it is
    run.query(0x20)
    if not run.is_resting or abs(run.home) > run.room:
        return
    before = run.here()
    run.command(0x0B)
    run.offset += before


def _at_rest(index: int) -> Act:
    def send(run: AxisSequence, first: int, second: int) -> None:
        run.command(index if run.is_resting else 0x18)

    return send


def _query(run: AxisSequence, first: int, second: int) -> None:
    answered = run.client.face.answered
    run.query(answered[first % len(answered)])


def _unassigned(run: AxisSequence, first: int, second: int) -> None:
    face = run.client.face
    indices = UNASSIGNED + face.missing
    index = indices[first % len(indices)]
    if face.unassigned[run.known("unknown_index")][index >= 0x20] in TO_COMMANDS:
        run.command(index, second if run.follows("dont_care_digits") else 0)


def _corrupted(run: AxisSequence, first: int, second: int) -> None:
    index = (*MOTIONS, *SEGMENTS, *DROPPING, 0x0B, 0x0D, 0x20)[first % 11]
    # A module that obeyed it would stay inside.
    parameter = run.place(second) if index == 0x13 else 0x00101000
    corrupted = run.client.corrupted(index, parameter, second)
    if corrupted is not None:
        run.lost(*corrupted, "MACS-REPLY-02")


def _misaddressed(run: AxisSequence, first: int, second: int) -> None:
    session = run.driver.session
    taken = {session.address, *session.neighbours}
    addresses = session.run.family.addresses
    other = next(
        number
        for number in range(first % 0x70, 0x80)
        if number in addresses and number not in taken
    )
    index = (*DROPPING, 0x13, 0x20)[second % 5]
    if session.envelope.is_guarded and index == 0x13:
        index = 0x20  # a module that nobody has named might be there and move
    run.lost(run.client.request(index, 0, address=other), ReplyKind.SILENCE, "MACS-FRAME-07")


def _restart(run: AxisSequence, first: int, second: int) -> None:
    is_cheap = run.client.target.is_virtual and first < 0x40
    run.restart() if is_cheap and run.follows(*UNRULED_RESTARTS) else run.query(0x26)


def _wait(run: AxisSequence, first: int, second: int) -> None:
    run.pause(first / 1000)


def _wait_for_instant(run: AxisSequence, first: int, second: int) -> None:
    """Let the next request be taken over about the end of the motion or of a stage of it."""
    run.pause_until_taken(first, OFFSETS_NS[second % len(OFFSETS_NS)])


def _stop_near(index: int, sign: int) -> Act:
    def send(run: AxisSequence, first: int, second: int) -> None:
        if not run.is_resting and not run.follows("motion_lock_set"):
            run.query(0x20)
            return
        run.command(index, run.here() + sign * (first % 0x40))

    return send


def _move_to_stop(run: AxisSequence, first: int, second: int) -> None:
    limits = run.model.parameters.limits
    if limits is None:
        run.command(0x13, run.place(first))
        return
    target = limits[first & 1] + second % 5 - 2
    is_near = abs(run.shaft(target) - run.home) <= run.room
    run.command(0x13, target if is_near else run.place(second))


def _anchor(run: AxisSequence, name: str) -> int:
    """Where an anchor is, as far as the model knows."""
    parameters, forecast = run.model.parameters, run.model.forecast
    match name:
        case "superior stop":
            return parameters.superior
        case "inferior stop":
            return parameters.inferior
        case "home":
            return run.home - run.offset
        case "end of motion":
            end = forecast.timelines[0].final
            return run.here() if end is None else end
        case "counter 0":
            return 0
        case "far above" | "far below":
            return run.place(0xFF if name == "far above" else 0)
    return run.here()


def _move_beside(run: AxisSequence, first: int, second: int) -> None:
    """13h to an anchor, or up to 128 increments beside it."""
    target = _anchor(run, ANCHORS[first % len(ANCHORS)]) + second - 0x80
    is_near = abs(run.shaft(target) - run.home) <= run.room
    run.command(0x13, target if is_near else run.place(second))


def _put_stop_beside(run: AxisSequence, first: int, second: int) -> None:
    """09h (an odd first) or 0Ah at an anchor, or up to 128 increments beside it."""
    index = 0x09 if first & 1 else 0x0A
    name = ANCHORS[(first >> 1) % len(ANCHORS)]
    _set(index, lambda run, _: _anchor(run, name) + second - 0x80)(run, first, second)


def _any_period(run: AxisSequence, byte: int) -> int:
    """One of 256 periods, spread over all that the slowest and the fastest axis here run at."""
    return max(PERIODS[0], run.fastest, byte << 8 | byte)


def _turn_at_any_speed(run: AxisSequence, first: int, second: int) -> None:
    _turn_at(run, first, _any_period(run, second))


def _send(index: int) -> Act:
    return lambda run, first, second: run.command(index)


def _ask_position(run: AxisSequence, first: int, second: int) -> None:
    run.query(0x20)


OPERATIONS: Final[tuple[AxisOperation, ...]] = (
    AxisOperation("ask the position", _ask_position),
    AxisOperation("move", _move),
    AxisOperation("wait", _wait),
    AxisOperation("turn", _turn),
    AxisOperation("segment", _segment(0x16)),
    AxisOperation("ramped stop", _ramped_stop),
    AxisOperation("stop", _send(0x18)),
    AxisOperation("virtual segment", _segment(0x1E)),
    AxisOperation("nudge", _nudge),
    AxisOperation("arm", _sync(0x10)),
    AxisOperation("trigger", _sync(0x11)),
    AxisOperation("turn at speed 0", _turn_off),
    AxisOperation("ask", _query),
    AxisOperation("move", _move),
    AxisOperation("segment", _segment(0x16)),
    AxisOperation("ask the position", _ask_position),
    AxisOperation("set the period", _set(0x0D, _period)),
    AxisOperation("set the ramp", _set(0x0F, lambda run, first: COEFFICIENTS[first % 7])),
    AxisOperation("set the tolerance", _set(0x1C, lambda run, first: TOLERANCES[first % 5])),
    AxisOperation("set the catch-up", _set(0x0E, _catch_up)),
    AxisOperation("set the torque", _set(0x0C, _torque)),
    AxisOperation(
        "set the standby", _set(0x02, lambda run, first: _choice(run, (0, 0, 2, 0x10), (0,), first))
    ),
    AxisOperation("enable the stops", _set(0x03, _stops)),
    AxisOperation("set the superior stop", _set(0x09, lambda run, first: run.place(first))),
    AxisOperation("set the inferior stop", _set(0x0A, lambda run, first: run.place(first))),
    AxisOperation("clear the counter", _clear),
    AxisOperation("power off", _at_rest(0x1A)),
    AxisOperation("power on", _send(0x19)),
    AxisOperation("move to 0", _home),
    AxisOperation("send an unassigned index", _unassigned),
    AxisOperation("spoil a frame", _corrupted),
    AxisOperation("call another address", _misaddressed),
    AxisOperation("restart", _restart),
    AxisOperation("wait for an instant", _wait_for_instant),
    AxisOperation("set the superior stop near", _stop_near(0x09, 1)),
    AxisOperation("set the inferior stop near", _stop_near(0x0A, -1)),
    AxisOperation("move to a stop", _move_to_stop),
    AxisOperation("move beside", _move_beside),
    AxisOperation("put a stop beside", _put_stop_beside),
    AxisOperation("turn at any speed", _turn_at_any_speed),
    AxisOperation("set any period", _set(0x0D, _any_period)),
)
# Beside them, where a face has such a frame.
WITH_SYNC: Final = (*OPERATIONS, AxisOperation("trigger by SYNC", _sync_frame))

WHAT: Final = {operation.name: number for number, operation in reversed(list(enumerate(WITH_SYNC)))}


def operations_of(driver: AxisDriver) -> tuple[AxisOperation, ...]:
    """The table for a module on this face."""
    return WITH_SYNC if driver.client.face.has_sync else OPERATIONS
