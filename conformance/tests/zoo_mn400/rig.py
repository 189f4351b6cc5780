"""Faults of what a rig shows: limits, shield, panel, pulses (LIM, SHD, JOG, THR, SYN, IO)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from axistwin.devices.mn400 import jog
from axistwin.devices.mn400.commands import Interpreter
from axistwin.devices.mn400.inputs import LIMITS, Inputs
from axistwin.devices.mn400.jog import Jogger
from axistwin.devices.mn400.motion import MoveSettings, PulseTrain, VectorMotion, motion, straight
from axistwin.devices.mn400.motion.circle import LatticeCircle
from axistwin.devices.mn400.motion.moves import ENDLESS
from axistwin.devices.mn400.motion.pace import PulsedPace
from axistwin.devices.mn400.mover import Mover
from axistwin.devices.mn400.orders import AXES, MotionOrder
from axistwin.kernel.schedule import NEVER
from zoo_mn400.planting import Any_, MonkeyPatch, S, around, board_mutant, plans, values

# --- limits, shield, panel ------------------------------------------------------------------------


@board_mutant("MN4-LIM-01")
def limits_stop_nothing(patch: MonkeyPatch) -> None:
    """They are shown by S, and that is all."""
    around(patch, Inputs, "blocks", lambda go, inputs, axis, direction: False)
    patch.setattr(Inputs, "limits_on", property(lambda inputs: iter(())))


@board_mutant("MN4-LIM-02")
def a_limit_that_was_let_go_stops_its_axis_later(patch: MonkeyPatch) -> None:
    """Where the axis would have met it, had it stayed on."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        foreseen = mover._limit_ns
        go()
        mover._limit_ns = min(foreseen, mover._limit_ns)

    around(patch, Mover, "_watch", act)


@board_mutant("MN4-LIM-01", "MN4-LIM-02")
def limits_are_looked_at_when_a_motion_begins(patch: MonkeyPatch) -> None:
    """And when one is worked: an arc that turns towards one is not stopped."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        go()
        mover._limit_ns = NEVER

    around(patch, Mover, "_watch", act)


@board_mutant("MN4-LIM-01", "MN4-LIM-02")
def a_limit_is_too_late_a_step_before_a_turn(patch: MonkeyPatch) -> None:
    """One that goes on before the last step of an axis in its direction does not stop the arc."""
    around(patch, LatticeCircle, "last_alike", lambda go, circle, n: go(n + 1))


@board_mutant("MN4-LIM-06")
def a_single_step_is_made_towards_a_limit(patch: MonkeyPatch) -> None:
    """M1 with the limit on is a move like any other."""

    def act(go: Any_, mover: Mover) -> Any:
        is_single = mover._motion is not None and sum(map(abs, mover._motion.total)) == 1
        return [] if is_single else go()

    around(patch, Mover, "_blocked", act)


@board_mutant("MN4-LIM-06")
def pulses_drive_an_axis_past_its_limit(patch: MonkeyPatch) -> None:
    """A limit stops no motion at a negative speed."""

    def act(go: Any_, mover: Mover) -> Any:
        return [] if mover.is_waiting_for_pulses else go()

    around(patch, Mover, "_blocked", act)


@board_mutant("MN4-CMD-S-01")
def the_shield_has_a_value_in_s(patch: MonkeyPatch) -> None:
    """That of aux input 1."""
    status: Any_ = Inputs.__dict__["status"].fget
    patch.setattr(
        Inputs, "status", property(lambda inputs: status(inputs) | inputs.is_shield_open << 8)
    )


@board_mutant("MN4-CMD-EXIT-01", traps=(26,))
def the_exit_code_is_a_number_of_an_axis(patch: MonkeyPatch) -> None:
    """/ tells 1 to 4."""

    def change(text: str, readout: Any, now: int) -> str:
        code = int(text)
        return str((code.bit_length() + 1) // 2)

    values(patch, "/", change)


@board_mutant("MN4-CMD-EXIT-04", traps=(26,))
def an_exit_code_stays(patch: MonkeyPatch) -> None:
    """A good move leaves the code of the one before."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        before = mover.exit_code
        go()
        mover.exit_code = mover.exit_code or before

    around(patch, Mover, "_finish", act)


@board_mutant("MN4-SHD-01", "MN4-CMD-FH-01")
def the_shield_stops_nothing(patch: MonkeyPatch) -> None:
    """It is shown by [ and : alone."""
    around(patch, Mover, "shield_changed", lambda go, mover, now: None)


def _program_goes_on(patch: MonkeyPatch, method: str) -> None:
    """Let the next line of a program be carried out behind what such a method ends."""

    def act(go: Any_, mover: Mover, *given: Any) -> None:
        go()
        mover.was_flushed = False

    around(patch, Mover, method, act)


@board_mutant("MN4-LIM-03")
def a_program_goes_on_behind_a_limit(patch: MonkeyPatch) -> None:
    """A limit ends its move, and the next line is carried out."""
    _program_goes_on(patch, "_trip")


@board_mutant("MN4-SHD-01")
def a_program_goes_on_behind_an_open_shield(patch: MonkeyPatch) -> None:
    """The shield ends its move, and the next line is carried out."""
    _program_goes_on(patch, "abort")


@board_mutant("MN4-SHD-02")
def feed_hold_is_no_pause(patch: MonkeyPatch) -> None:
    """With ;1 an open shield ends the motion."""

    def act(go: Any_, mover: Mover, now: int) -> None:
        kept, mover.has_feed_hold = mover.has_feed_hold, False
        go()
        mover.has_feed_hold = kept

    around(patch, Mover, "shield_changed", act)


@board_mutant("MN4-JOG-07", "MN4-CMD-J-01")
def the_panel_jogs_in_run_mode(patch: MonkeyPatch) -> None:
    """Jog inputs are heard whatever J says."""

    def act(go: Any_, jogger: Jogger, now: int, axis: int, direction: int) -> None:
        kept, jogger.is_on = jogger.is_on, True
        go()
        jogger.is_on = kept

    around(patch, Jogger, "press", act)


@board_mutant("MN4-JOG-07")
def a_jog_outlasts_jog_mode(patch: MonkeyPatch) -> None:
    """J0 is heard by inputs that are turned on later: one that is held moves on."""

    def act(go: Any_, one: Interpreter, now: int, is_on: bool) -> None:
        one._jogger.is_on = is_on

    around(patch, Interpreter, "set_jog", act)


@board_mutant("MN4-JOG-08")
def a_jog_begins_towards_a_limit(patch: MonkeyPatch) -> None:
    """One that comes on ends it; one that is on before is not looked at."""

    def act(go: Any_, jogger: Jogger, *given: Any) -> None:
        inputs = jogger._inputs
        kept, inputs._on = inputs._on, inputs._on - {*LIMITS}
        go()
        inputs._on = kept

    around(patch, Jogger, "press", act)


@board_mutant("MN4-JOG-03", traps=(28,))
def a_tap_drops_its_remainder(patch: MonkeyPatch) -> None:
    """What is less than a step is not kept for the next tap."""
    from axistwin.devices.mn400.motion import JogTaps

    def act(go: Any_, taps: Any, *given: Any) -> Any:
        steps, _ = go()
        return steps, JogTaps()

    around(patch, JogTaps, "tap", act)


@board_mutant("MN4-BKL-01")
def a_jog_takes_up_the_backlash_of_every_axis(patch: MonkeyPatch) -> None:
    """Also of those that stand."""

    def act(go: Any_, now: int, settings: MoveSettings, axis: int, direction: int) -> Any:
        first, second, third, fourth = (
            direction * (ENDLESS if axis == other else 1) for other in range(AXES)
        )
        return straight(now, settings, (first, second, third, fourth))

    around(patch, jog, "jog", act)


@board_mutant("MN4-BKL-02")
def a_jog_is_not_remembered(patch: MonkeyPatch) -> None:
    """What an axis remembers is the direction of its last move."""

    def act(go: Any_, mover: Mover, *given: Any) -> None:
        kept = mover._memory
        go()
        mover._memory = kept

    around(patch, Mover, "count", act)


@board_mutant("MN4-THR-01", "MN4-THR-02", "MN4-CMD-T-01", traps=(43,))
def a_thread_takes_twice_its_pulses(patch: MonkeyPatch) -> None:
    """T over 10 pulses ends with the 20th."""

    def act(go: Any_, now: int, settings: MoveSettings, way: Any, pulses: int, offset: int) -> Any:
        return go(now, settings, way, 2 * pulses, offset)

    plans(patch, "thread", act)


@board_mutant("MN4-THR-01")
def a_thread_takes_pulses_for_its_backlash(patch: MonkeyPatch) -> None:
    """As many as the steps of the compensation before it: it ends so many pulses later."""

    def act(go: Any_, now: int, settings: MoveSettings, way: Any, pulses: int, offset: int) -> Any:
        turns = [
            lash
            for lash, by, was in zip(settings.lash, way, settings.lash_memory, strict=True)
            if by * was < 0
        ]
        return go(now, settings, way, pulses + max(turns, default=0), offset)

    plans(patch, "thread", act)


@board_mutant("MN4-THR-01")
def pulses_are_counted_twice_at_a_high_rate(patch: MonkeyPatch) -> None:
    """Both edges, above 2000 a second: a thread is over in half its time."""

    def act(go: Any_, motion: Any, now: int, train: Any) -> Any:
        is_fast = train is not None and train.rate_millihertz > 2_000_000
        return go(
            now, replace(train, rate_millihertz=2 * train.rate_millihertz) if is_fast else train
        )

    around(patch, VectorMotion, "paced_by", act)


@board_mutant("MN4-THR-03")
def a_thread_begins_half_a_turn_too_early(patch: MonkeyPatch) -> None:
    """On a spindle that turns by itself; an index by hand is heard."""

    def act(go: Any_, train: Any, n: int) -> Any:
        index = go()
        return index and index - train.pulses_per_turn // 2

    around(patch, PulseTrain, "index_after", act)


@board_mutant("MN4-CMD-T-01")
def a_thread_whose_spindle_stood_is_over_late(patch: MonkeyPatch) -> None:
    """A second behind its last pulse, with its steps made: what follows waits."""
    ends: Any_ = PulsedPace.__dict__["end_ns"].fget

    def late(pace: PulsedPace) -> int | None:
        end_ns: int | None = ends(pace)
        return end_ns and end_ns + S * bool(pace.used and pace.train)

    patch.setattr(PulsedPace, "end_ns", property(late))


@board_mutant("MN4-SYN-01", "MN4-CMD-V-02")
def a_negative_speed_is_a_speed(patch: MonkeyPatch) -> None:
    """V-1 runs without pulses."""
    patch.setattr(MotionOrder, "is_paced", property(lambda order: order.letter == "T"))

    def act(go: Any_, now: int, settings: MoveSettings, *rest: Any) -> Any:
        return go(
            now, replace(settings, speed=settings.speed if settings.speed > 0 else 500), *rest
        )

    plans(patch, "straight", act)


@board_mutant("MN4-IO-01")
def the_feedrate_pot_scales_by_its_half(patch: MonkeyPatch) -> None:
    """At 50 % a motion has a quarter of its speed."""

    def act(inputs: Inputs) -> int:
        is_used = "feedrate_enable" in inputs._on
        return inputs.feed_pot_permille**2 // 1000 if is_used else 1000

    patch.setattr(Inputs, "feed_permille", property(act))


@board_mutant("MN4-CMD-V-02")
def a_contour_goes_on_without_its_pulses(patch: MonkeyPatch) -> None:
    """What is behind a segment that pulses pace begins with that segment."""

    def laid(paces: Any, start_ns: int | None) -> Any:
        found = lay(paces, start_ns)
        return (*found[:2], *(pace.starting(found[0].end_ns) for pace in found[2:]))

    lay = motion._laid
    patch.setattr(motion, "_laid", laid)


@board_mutant("MN4-CMD-V-02")
def pulses_before_a_segment_are_kept_for_it(patch: MonkeyPatch) -> None:
    """Those that come while the segment before it runs make its first steps."""

    def act(go: Any_, motion: VectorMotion, now: int, pulses: int) -> VectorMotion:
        fed: VectorMotion = go()
        paces = [
            replace(pace, used=pace.used + pulses) if number and isinstance(pace, PulsedPace)
            else pace
            for number, pace in enumerate(fed.paces)
        ]  # fmt: skip
        return replace(fed, paces=tuple(paces))

    around(patch, VectorMotion, "feed", act)


@board_mutant("MN4-STM-01")
def a_move_behind_a_thread_stays(patch: MonkeyPatch) -> None:
    """The last pulse ends a motion, and nothing begins by it."""

    def change_paced(mover: Mover, now: int, change: Any_) -> None:
        if mover._motion is not None and mover.is_waiting_for_pulses:
            mover._motion = change(mover._motion)
            mover._watch(now)
            mover._finish_if_over(now)

    patch.setattr(Mover, "_change_paced", change_paced)
