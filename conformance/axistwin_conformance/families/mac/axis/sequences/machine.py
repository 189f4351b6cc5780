"""A stateful machine for the axis: rules that are tried where they mean something.

One-draw sequences (`sequences.py`) take any operation in any state and are fast; most of them stop
what they have begun. The rules here have preconditions, read from the model's state (`AxisView`),
so that long chains get built: a full FIFO behind a motion, a speed changed just before its target,
a stop enabled just ahead of the axis, a start that is held, replaced and triggered. Hypothesis
draws the rules and, by what they mean, their arguments; what a step does is an operation of four
bytes, seldom a few, judged by the same exact model and recorded, so that `AxisSequence.perform`
plays a failing run again.

    rules + preconditions ─▶ operation ─▶ Device ─▶ module and model ─▶ View ─▶ preconditions

Invariants ask the module between the steps: busy and status agree with the model, and with stops
enabled the counter is where they let it be.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hypothesis import strategies as st
from hypothesis.stateful import invariant, precondition, rule

from axistwin_conformance.families.mac.axis.model.axis_model import FIFO_STAGES
from axistwin_conformance.families.mac.axis.sequences.machine_devices import AxisView
from axistwin_conformance.families.mac.axis.sequences.operations import (
    ANCHORS,
    OFFSETS_NS,
    TOLERANCES,
    WHAT,
)
from axistwin_conformance.families.mac.axis.sequences.sequence import COEFFICIENTS, PERIODS
from axistwin_conformance.sequences.machine import Machine

ASK_EVERY: Final = 9  # steps: an invariant that asked after each would leave no time for chains
ASK: Final = {0x20: 0, 0x21: 1, 0x27: 7}  # the first argument of the operation "ask"


# Arguments are drawn by what they mean: the edges of the manual and what the state makes
# interesting as often as anything else.
BYTES: Final = st.integers(0, 0xFF)
# The pause byte of an operation: above 80h, what is beyond it in ms.  Mostly none, so that one
# command follows another as fast as the line allows.
PAUSES: Final = st.one_of(
    st.just(0), st.sampled_from((0, 0, 0x82, 0x88, 0x98)), st.integers(0, 0xFF)
)
SIDES: Final = st.integers(0, 1)
# Targets: an anchor (the last one of them: anywhere), and how far beside it, 80h being there.
ANYWHERE: Final = len(ANCHORS)
TARGETS: Final = st.one_of(st.just(ANYWHERE), st.integers(0, ANYWHERE))
BESIDE: Final = st.one_of(st.sampled_from((0x80, 0x81, 0x7F, 0x82, 0x7E, 0, 0xFF)), BYTES)
# Periods: the fastest and the slowest there is as often as those between.
EDGES: Final = st.sampled_from((0, len(PERIODS) - 1))
SPEEDS: Final = st.one_of(
    st.tuples(st.just("turn"), EDGES),
    st.tuples(st.just("turn"), st.integers(0, len(PERIODS) - 1)),
    st.tuples(st.just("turn at any speed"), BYTES),
)
# Segments long enough to be met by the next commands, and the shortest: up to 32 steps of 1 to 8
# ms either way, none at all included.
LONG_STEPS: Final = st.one_of(st.sampled_from((0, 64)), st.integers(0, 16), st.integers(48, 64))
STEPS: Final = st.one_of(LONG_STEPS, st.sampled_from((24, 31, 32, 33, 40)))
SLOW: Final = st.sampled_from((4, 5, 6))
INSTANTS: Final = st.integers(0, 7)
OFFSETS: Final = st.integers(0, len(OFFSETS_NS) - 1)

SETTINGS_IN_MOTION: Final = st.one_of(
    st.tuples(st.just("set the catch-up"), st.one_of(st.sampled_from((0, 1, 5, 0xFF)), BYTES)),
    st.tuples(st.just("set the torque"), st.integers(0, 6)),
    st.tuples(st.just("set the tolerance"), st.integers(0, len(TOLERANCES) - 1)),
)
LOCKED_SETTINGS: Final = st.one_of(
    st.tuples(st.just("set the period"), st.one_of(EDGES, st.integers(0, len(PERIODS) - 1))),
    st.tuples(st.just("set any period"), BYTES),
    st.tuples(st.just("set the ramp"), st.integers(0, len(COEFFICIENTS) - 1)),
    st.tuples(st.just("set the standby"), st.integers(0, 3)),
    st.tuples(st.sampled_from(("set the superior stop", "set the inferior stop")), BYTES),
)
Setting = tuple[str, int]
DISTURBANCES: Final = st.one_of(
    st.tuples(st.just("send an unassigned index"), st.integers(0, 7), BYTES),
    st.tuples(st.just("spoil a frame"), BYTES, st.one_of(st.sampled_from((0, 0xFE)), BYTES)),
    st.tuples(st.just("call another address"), st.integers(0, 0x6F), st.integers(0, 4)),
)


def if_(allowed: Callable[[AxisView], bool]) -> Callable[[object], bool]:
    """A precondition on the state after the last step."""
    return lambda machine: allowed(machine.device.view)  # type: ignore[attr-defined]


is_free = precondition(if_(lambda view: view.is_free))
is_at_rest = precondition(if_(lambda view: view.mode == "HD"))
is_moving = precondition(if_(lambda view: view.is_moving))
is_armed = precondition(if_(lambda view: view.is_armed))


class AxisMachine(Machine):
    """The rules of the axis."""

    what = WHAT

    def _move(self, anchor: int, beside: int, pause: int = 0) -> None:
        if anchor == ANYWHERE:
            self.do("move", beside, 0, pause)
        else:
            self.do("move beside", anchor, beside, pause)

    # --- starts at rest ---------------------------------------------------------------------------

    @is_free
    @rule(anchor=TARGETS, beside=BESIDE, pause=PAUSES)
    def move(self, anchor: int, beside: int, pause: int) -> None:
        """13h to or beside a place that means something, or anywhere in the span."""
        self._move(anchor, beside, pause)

    @is_free
    @rule(first=BYTES, pause=PAUSES)
    def nudge(self, first: int, pause: int) -> None:
        """13h to a place nearby."""
        self.do("nudge", first, 0, pause)

    @is_free
    @rule(pause=PAUSES)
    def move_to_0(self, pause: int) -> None:
        """14h."""
        self.do("move to 0", 0, 0, pause)

    @precondition(if_(lambda view: view.is_free and view.has_stops))
    @rule(side=SIDES, offset=st.integers(0, 4), pause=PAUSES)
    def move_to_a_stop(self, side: int, offset: int, pause: int) -> None:
        """13h to an enabled stop, or an increment or two beside it."""
        self.do("move to a stop", side, offset, pause)

    @is_free
    @rule(way=SIDES, speed=SPEEDS, pause=PAUSES)
    def turn(self, way: int, speed: Setting, pause: int) -> None:
        """15h from rest."""
        name, period = speed
        self.do(name, way, period, pause)

    # --- changes under way ------------------------------------------------------------------------

    @is_moving
    @rule(anchor=TARGETS, beside=BESIDE)
    def move_in_motion(self, anchor: int, beside: int) -> None:
        """13h, which motion locks."""
        self._move(anchor, beside)

    @precondition(if_(lambda view: view.mode in ("PO", "VE") and not view.waiting))
    @rule(way=SIDES, speed=SPEEDS, pause=PAUSES)
    def change_the_speed(self, way: int, speed: Setting, pause: int) -> None:
        """15h in a move or an endless motion."""
        name, period = speed
        self.do(name, way, period, pause)

    @precondition(if_(lambda view: view.mode in ("PO", "VE") and not view.waiting))
    @rule(pause=PAUSES)
    def turn_at_speed_0(self, pause: int) -> None:
        """15h with period 0."""
        self.do("turn at speed 0", 0, 0, pause)

    @is_moving
    @rule(pause=PAUSES)
    def stop_on_the_ramp(self, pause: int) -> None:
        """17h."""
        self.do("ramped stop", 0, 0, pause)

    @is_moving
    @rule(pause=PAUSES)
    def stop_dead(self, pause: int) -> None:
        """18h."""
        self.do("stop", 0, 0, pause)

    @is_at_rest
    @rule(is_dead=st.booleans())
    def stop_at_rest(self, is_dead: bool) -> None:
        """17h or 18h where nothing moves: what is armed or held goes."""
        self.do("stop" if is_dead else "ramped stop")

    # --- segments ---------------------------------------------------------------------------------

    @precondition(if_(lambda view: view.is_free or (view.mode == "IN" and not view.waiting)))
    @rule(steps=STEPS, period=SLOW, is_virtual=st.booleans(), pause=PAUSES)
    def begin_a_row(self, steps: int, period: int, is_virtual: bool, pause: int) -> None:
        """16h or 1Eh at rest, or when the last segment is being executed."""
        self.do("virtual segment" if is_virtual else "segment", steps, period, pause)

    @precondition(if_(lambda view: view.mode == "IN" and view.waiting < FIFO_STAGES))
    @rule(steps=LONG_STEPS, period=SLOW, is_virtual=st.booleans())
    def prolong_a_row(self, steps: int, period: int, is_virtual: bool) -> None:
        """16h or 1Eh while there is room in the FIFO."""
        self.do("virtual segment" if is_virtual else "segment", steps, period)

    @precondition(if_(lambda view: view.is_moving and view.waiting < FIFO_STAGES))
    @rule(steps=LONG_STEPS, period=SLOW)
    def fill_the_fifo(self, steps: int, period: int) -> None:
        """16h until there is no room left: the state that random steps hardly ever come to."""
        for _ in range(FIFO_STAGES - self.device.view.waiting):
            self.do("segment", steps, period)

    @precondition(if_(lambda view: view.waiting >= FIFO_STAGES))
    @rule(steps=BYTES, is_virtual=st.booleans())
    def overfill_the_fifo(self, steps: int, is_virtual: bool) -> None:
        """16h or 1Eh where there is none."""
        self.do("virtual segment" if is_virtual else "segment", steps, 1)

    @precondition(if_(lambda view: view.mode in ("PO", "VE")))
    @rule(steps=LONG_STEPS, period=SLOW, is_virtual=st.booleans())
    def queue_behind_a_motion(self, steps: int, period: int, is_virtual: bool) -> None:
        """16h or 1Eh that waits for the axis to come to rest."""
        self.do("virtual segment" if is_virtual else "segment", steps, period)

    # --- synchronised starts ----------------------------------------------------------------------

    @is_free
    @rule(pause=PAUSES)
    def wait_for_synchro(self, pause: int) -> None:
        """10h."""
        self.do("arm", 0, 0, pause)

    @is_armed
    @rule(anchor=TARGETS, beside=BESIDE)
    def hold_a_move(self, anchor: int, beside: int) -> None:
        """13h that waits for 11h, in place of what waits already."""
        self._move(anchor, beside)

    @is_armed
    @rule(way=SIDES, speed=SPEEDS)
    def hold_a_turn(self, way: int, speed: Setting) -> None:
        """15h that waits for 11h, in place of what waits already."""
        name, period = speed
        self.do(name, way, period)

    @precondition(if_(lambda view: view.is_held))
    @rule(pause=PAUSES)
    def trigger(self, pause: int) -> None:
        """11h: what is held starts."""
        self.do("trigger", 0, 0, pause)

    @precondition(if_(lambda view: view.mode == "HD" and not view.is_held))
    @rule(pause=PAUSES)
    def trigger_nothing(self, pause: int) -> None:
        """11h where nothing is held."""
        self.do("trigger", 0, 0, pause)

    # --- parameters -------------------------------------------------------------------------------

    @is_at_rest
    @rule(setting=st.one_of(LOCKED_SETTINGS, SETTINGS_IN_MOTION))
    def set_at_rest(self, setting: Setting) -> None:
        """Any parameter."""
        self.do(*setting)

    @is_moving
    @rule(setting=LOCKED_SETTINGS)
    def set_what_motion_locks(self, setting: Setting) -> None:
        """A parameter that motion locks."""
        self.do(*setting)

    @is_moving
    @rule(setting=SETTINGS_IN_MOTION)
    def set_what_stays_free(self, setting: Setting) -> None:
        """A parameter that stays free in motion."""
        self.do(*setting)

    @precondition(if_(lambda view: view.mode == "HD" and not view.has_stops))
    @rule(mode=st.integers(1, 2), pause=PAUSES)
    def enable_the_stops(self, mode: int, pause: int) -> None:
        """03h with 8 or 9."""
        self.do("enable the stops", mode, 0, pause)

    @precondition(if_(lambda view: view.has_stops))
    @rule(mode=st.sampled_from((0, 3, 4)), pause=PAUSES)
    def disable_the_stops(self, mode: int, pause: int) -> None:
        """03h with 0, 1, or a mode there is not; in motion, too."""
        self.do("enable the stops", mode, 0, pause)

    @is_at_rest
    @rule(
        is_superior=st.booleans(),
        distance=st.one_of(st.sampled_from((0, 1, 2)), st.integers(0, 0x3F)),
    )
    def put_a_stop_near(self, is_superior: bool, distance: int) -> None:
        """09h or 0Ah just ahead of the axis."""
        self.do(f"set the {'superior' if is_superior else 'inferior'} stop near", distance)

    @is_at_rest
    @rule(side=SIDES, anchor=st.integers(0, len(ANCHORS) - 1), beside=BESIDE)
    def put_a_stop_beside(self, side: int, anchor: int, beside: int) -> None:
        """09h or 0Ah at or beside a place that means something."""
        self.do("put a stop beside", anchor << 1 | side, beside)

    @precondition(if_(lambda view: view.is_away))
    @rule(pause=PAUSES)
    def clear_the_counter(self, pause: int) -> None:
        """0Bh, where that changes something."""
        self.do("clear the counter", 0, 0, pause)

    # --- the line and the rest --------------------------------------------------------------------

    @rule(which=st.integers(0, 9), pause=PAUSES)
    def ask(self, which: int, pause: int) -> None:
        """Any query."""
        self.do("ask", which, 0, pause)

    @rule(disturbance=DISTURBANCES)
    def disturb(self, disturbance: tuple[str, int, int]) -> None:
        """A frame that is not obeyed: an index that means nothing, a wrong checksum, a call of
        somebody else."""
        self.do(*disturbance)

    @is_at_rest
    @rule(is_on=st.booleans())
    def switch_the_power(self, is_on: bool) -> None:
        """19h or 1Ah."""
        self.do("power on" if is_on else "power off")

    @precondition(if_(lambda view: view.is_held or view.waiting > 1))
    @rule()
    def restart(self) -> None:
        """00h, which drops whatever is stored."""
        self.do("restart")

    @rule(milliseconds=st.one_of(st.sampled_from((0, 1, 2, 5)), BYTES))
    def wait(self, milliseconds: int) -> None:
        """Let some time pass."""
        self.do("wait", milliseconds)

    @is_moving
    @rule(which=INSTANTS, offset=OFFSETS)
    def wait_for_an_instant(self, which: int, offset: int) -> None:
        """Wait until just before, at or after the end of a motion or of a stage of it."""
        self.do("wait for an instant", which, offset)

    # --- what always holds ------------------------------------------------------------------------

    def _is_due(self, turn: int) -> bool:
        return self.steps % ASK_EVERY == turn

    @invariant()
    def busy_agrees_with_the_model(self) -> None:
        """27h: busy as long as a move is further from its target than the tolerance."""
        self.steps += 1
        if self._is_due(0):
            self.do("ask", ASK[0x27])

    @invariant()
    def status_agrees_with_the_model(self) -> None:
        """21h: which stop ended the motion."""
        if self._is_due(2):
            self.do("ask", ASK[0x21])

    @precondition(if_(lambda view: view.has_stops))
    @invariant()
    def the_counter_is_where_the_stops_let_it_be(self) -> None:
        """20h: no further than the model, which knows the stops, lets the axis go."""
        if self._is_due(1):
            self.do("ask", ASK[0x20])
