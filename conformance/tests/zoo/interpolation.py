"""Faults in segments and their FIFO."""

from __future__ import annotations

from typing import Any

from axistwin.devices.mac.axis.acceptance import State
from axistwin.devices.mac.axis.axis import Axis
from axistwin.devices.mac.axis.drive import Drive
from axistwin.motion.interpolator import Interpolator, Segment
from zoo.mutant import Any_, MonkeyPatch, mutant, on, wrap

REAL, VIRTUAL = 0x16, 0x1E


def _word(steps: int, period: int) -> int:
    return (steps & 0xFFFF) << 16 | period & 0xFFFF


def _steps(n: int) -> int:
    return (n >> 16) - (0x10000 if n >> 31 else 0)


@mutant("MACS-CMD-16-01", traps=(15,))
def a_segment_is_absolute(patch: MonkeyPatch) -> None:
    """16h goes to the position DDDD."""

    def act(go: Any_, axis: Axis, now: int, n: int) -> bool:
        distance = _steps(n) - axis.counter_at(now)
        return bool(go(_word(max(-0x7FFF, min(0x7FFF, distance)), n)))

    on(patch, REAL, act)


@mutant("MACS-CMD-16-01", "MACS-CMD-1E-01", traps=(25,))
def segments_have_gaps(patch: MonkeyPatch) -> None:
    """Between two segments the axis rests for 20 µs."""

    def make(place: Any_) -> Any_:
        def placing(one: Interpolator, now_ns: int, *rest: Any) -> None:
            place(one, max(now_ns, one.end_ns + 20_000) if one._runs else now_ns, *rest)

        return placing

    wrap(patch, Interpolator, "_place", make)


@mutant("MACS-CMD-16-01")
def the_last_step_of_a_segment_is_missing(patch: MonkeyPatch) -> None:
    """A segment stops one step short."""

    def act(go: Any_, _: Axis, __: int, n: int) -> bool:
        steps = _steps(n)
        return bool(go(_word(steps - (steps > 1) + (steps < -1), n)))

    on(patch, REAL, act)


@mutant("MACS-CMD-16-03", traps=(26,))
def segments_obey_the_speed_limit(patch: MonkeyPatch) -> None:
    """A segment is not faster than 0Dh allows."""
    on(
        patch,
        REAL,
        lambda go, axis, now, n: go(
            _word(_steps(n), max(n & 0xFFFF, axis.values["period"])) if n & 0xFFFF else n
        ),
    )


@mutant("MACS-CMD-16-03", traps=(26,))
def segments_are_ramped(patch: MonkeyPatch) -> None:
    """With AA above 0 a segment is the slower for it."""
    on(
        patch,
        REAL,
        lambda go, axis, now, n: go(
            _word(_steps(n), min(0xFFFF, (n & 0xFFFF) * 5 // 4)) if axis.values["ramp"] else n
        ),
    )


def _depth(patch: MonkeyPatch, depth: int) -> None:
    def make(init: Any_) -> Any_:
        def initialising(one: Interpolator, **options: Any) -> None:
            init(one, **{**options, "depth": depth})

        return initialising

    wrap(patch, Interpolator, "__init__", make)


def _squeeze_in(drive: Drive, now_ns: int, segment: Segment) -> None:
    """Run ``segment`` behind all others, whether there is a stage for it or not."""
    drive.interpolator._place(now_ns, segment, ())
    drive.replan(now_ns)


@mutant("MACS-CMD-16-02", traps=(24,))
def the_fifo_has_one_stage(patch: MonkeyPatch) -> None:
    """The third segment of a burst is refused."""
    _depth(patch, 1)


@mutant("MACS-CMD-16-02", traps=(24,))
def the_fifo_has_four_stages(patch: MonkeyPatch) -> None:
    """The fifth segment of a burst is accepted."""
    _depth(patch, 4)


@mutant("MACS-CMD-16-02")
def a_full_fifo_swallows(patch: MonkeyPatch) -> None:
    """A segment for which there is no room is accepted and lost."""
    on(patch, REAL, lambda go, axis, now, n: bool(go()) or axis.drive.kind is State.IN)


@mutant("MACS-CMD-16-02", traps=(18,))
def a_refused_segment_is_stored_all_the_same(patch: MonkeyPatch) -> None:
    """A segment for which there is no room is refused, and runs."""

    def make(offer: Any_) -> Any_:
        def offering(one: Drive, now_ns: int, segment: Segment, *rest: Any) -> bool:
            accepted = bool(offer(one, now_ns, segment, *rest))
            if not accepted and segment.steps and one.kind is State.IN:
                _squeeze_in(one, now_ns, segment)
            return accepted

        return offering

    wrap(patch, Drive, "offer", make)


@mutant("MACS-CMD-1E-01", traps=(25,))
def virtual_segments_are_one_period_longer(patch: MonkeyPatch) -> None:
    """1Eh waits DDDD + 1 periods."""
    on(patch, VIRTUAL, lambda go, axis, now, n: go(_word(abs(_steps(n)) + 1, n) if n >> 16 else n))


@mutant("MACS-CMD-1E-01")
def virtual_segments_move(patch: MonkeyPatch) -> None:
    """1Eh is 16h, as its printed frame line has it."""
    on(patch, VIRTUAL, lambda go, axis, now, n: axis.execute(now, REAL, n, now))


@mutant("MACS-CMD-16-02")
def virtual_segments_need_no_stage(patch: MonkeyPatch) -> None:
    """1Eh is never refused."""

    def make(offer: Any_) -> Any_:
        def offering(one: Drive, now_ns: int, segment: Segment, *rest: Any) -> bool:
            if not offer(one, now_ns, segment, *rest):
                if not segment.virtual or one.kind is not State.IN:
                    return False
                _squeeze_in(one, now_ns, segment)
            return True

        return offering

    wrap(patch, Drive, "offer", make)


@mutant("MACS-CMD-17-02", traps=(30,))
def a_ramped_stop_cuts_what_is_stored(patch: MonkeyPatch) -> None:
    """17h lets the segment in execution end and runs half of the one behind it."""

    def act(go: Any_, axis: Axis, now: int, _: int) -> bool:
        interpolator = axis.drive.interpolator
        if axis.drive.kind is State.IN and interpolator.stored_at(now):
            interpolator.drop_stored(now)
            axis.drive.offer(now, Segment(15, 0x2000), now)
        return bool(go())

    on(patch, 0x17, act)


@mutant("MACS-CMD-16-01")
def an_empty_fifo_loses_a_step(patch: MonkeyPatch) -> None:
    """The first segment after the FIFO ran empty starts with a step less."""

    def act(go: Any_, axis: Axis, _: int, n: int) -> bool:
        has_run = axis.drive.interpolator._end_ns > 0 and axis.drive.kind is None
        steps = _steps(n)
        return bool(go(_word(steps - 1, n) if has_run and steps > 1 else n))

    on(patch, REAL, act)


@mutant("MACS-REPLY-05")
def a_segment_of_no_period_empties_the_fifo(patch: MonkeyPatch) -> None:
    """16h or 1Eh with VVVV = 0 is refused, and what is stored is dropped."""

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        if number & 0xFFFF == 0 and axis.drive.kind is State.IN:
            axis.drive.stop_segments(now, after_this_one=True)
        return bool(go())

    on(patch, (0x16, 0x1E), act)


@mutant("MACS-STATE-01")
def a_virtual_segment_locks_nothing(patch: MonkeyPatch) -> None:
    """02h and 13h are accepted as long as no real segment runs."""
    is_free = [False]

    def act(go: Any_, axis: Axis, now: int, number: int) -> bool:
        is_free[0] = axis.drive.kind is None
        return bool(go())

    def act_real(go: Any_, axis: Axis, now: int, number: int) -> bool:
        is_free[0] = False
        return bool(go())

    def make(is_locked: Any_) -> Any_:
        def locking(axis: Axis, index: int, number: int) -> bool:
            is_open = is_free[0] and axis.drive.kind is State.IN and index < 0x14
            return bool(is_locked(axis, index, number)) and not is_open

        return locking

    on(patch, 0x1E, act)
    on(patch, REAL, act_real)
    wrap(patch, Axis, "is_locked", make)
