"""The motion of one board: what runs, what waits in the queue, what hold keeps, and why it ended.

::

    accept --- pending (hold) --- queue --- running --- counters, N, exit code
               K releases         Q flushes   { } limits, shield, pulses, pots

Rules
-----
1. Motions run one at a time, in the order of their acceptance; settings wait among them, so that
   each changes the later motions only (MN4-STM-01).
2. A motion that ends by itself leaves exit code 0 and nothing to go; one that is ended leaves the
   steps not taken and the ON values of the limits that ended it (MN4-CMD-EXIT-01, MN4-CMD-N-02).
   Either overwrites what the one before has left.
3. A limit blocks the direction that it is named after; the step that it blocks is not made
   (MN4-LIM-02, MN4-LIM-06).  What a limit, the shield or Q has ended flushes the queue.
4. While there is a reason for a pause nothing starts: a motion then waits where it would begin.
   Each reason (a command or the panel, the shield) is taken back by itself (MN4-SHD-02).
5. Jogging has one motion per axis, apart from the queue.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, NamedTuple, TypeAlias

from axistwin.devices.mn400.inputs import Inputs
from axistwin.devices.mn400.motion import MotionRules, PulseTrain, VectorMotion
from axistwin.devices.mn400.orders import (
    AXES,
    ZERO,
    BoardSettings,
    Four,
    MotionOrder,
    MoveStart,
    added,
    loaded,
    wrapped,
)
from axistwin.devices.mn400.quirks import Mn400Quirks
from axistwin.kernel.schedule import NEVER
from axistwin.kernel.time import Nanos

PauseReason: TypeAlias = Literal["command", "shield"]
MotionOutcome: TypeAlias = Literal["completed", "aborted", "quit"]
Change: TypeAlias = Callable[[BoardSettings], BoardSettings]

FULL_FEED: Final = 1000


@dataclass(frozen=True, slots=True)
class Waiting:
    """What waits in the queue beside motions: a change of the settings, or an act, or both."""

    change: Change | None = None
    act: Callable[[Nanos], None] | None = None
    moves_counters_to: Sequence[int | None] | None = None


class EndedMotion(NamedTuple):
    """A motion that is over, or was dropped from the queue, and how."""

    order: MotionOrder
    outcome: MotionOutcome


class QueueFullError(Exception):
    """The queue has no place: SLAVEBUFFOV."""


class Mover:
    """The axes of one board, at rest at ``power_on_position``.

    ``ended`` tells what is over, to be taken by who answers.
    """

    def __init__(self, quirks: Mn400Quirks, inputs: Inputs) -> None:
        self._quirks = quirks
        self._inputs = inputs
        self.rules = MotionRules.of(quirks)
        self.train: PulseTrain | None = None
        self.reset()

    def reset(self) -> None:
        """As at power-up."""
        quirks = self._quirks
        is_absolute = quirks.power_on_mode == "absolute"
        self.settings = self.accepted = BoardSettings(is_absolute=is_absolute)
        self._base: Four = (quirks.power_on_position,) * AXES
        self._memory: Four = (1, 1, 1, 1)
        self._phantom = 0
        self._made: Four = ZERO
        self._left: Four = ZERO
        self._path_left: Four = ZERO
        self.exit_code = 0
        self.is_aborted = False
        self.queue: deque[MotionOrder | Waiting] = deque()
        self.order: MotionOrder | None = None
        self._motion: VectorMotion | None = None
        self._limit_ns: Nanos = NEVER
        self._ended_by: int | None = None
        self._halted_code = 0
        self._cut: MotionOutcome = "aborted"
        self.ended: list[EndedMotion] = []
        self._reasons: set[PauseReason] = set()
        self.is_latched = False
        self.has_feed_hold = bool(quirks.feedhold_power_on)
        self.was_flushed = False

    # -- what can be seen --

    @property
    def is_busy(self) -> bool:
        """Whether a motion runs, is paused, or waits to begin."""
        return self.order is not None

    @property
    def is_paused(self) -> bool:
        """Whether a pause is in force (PauseFlag)."""
        return self.is_busy and bool(self._reasons)

    def is_paused_by(self, reason: PauseReason) -> bool:
        """Whether ``reason`` is one of the reasons for the pause."""
        return self.is_busy and reason in self._reasons

    def stands_at(self, now: Nanos) -> bool:
        """Whether it has come to rest for a pause (PauseState)."""
        if not self.is_paused:
            return False
        rest_ns = None if self._motion is None else self._motion.rest_ns
        return self._motion is None or (rest_ns is not None and rest_ns <= now)

    @property
    def is_waiting_for_pulses(self) -> bool:
        """Whether external pulses pace it."""
        return self.order is not None and self.order.is_paced

    def position_at(self, now: Nanos) -> Four:
        """The counters (E)."""
        if self._motion is None:
            return wrapped(self._base)
        return wrapped(added(self._base, self._motion.position_at(now)))

    def memory_at(self, now: Nanos) -> Four:
        """The remembered direction of each axis."""
        return self._memory if self._motion is None else self._motion.lash_memory_at(now)

    def left_at(self, now: Nanos) -> Four:
        """The steps that remain (N)."""
        quirks, motion = self._quirks, self._motion
        is_path = self.order is not None and self.order.letter in "A+"
        is_path = is_path and quirks.readcount_arc == "path"
        if motion is not None:
            left = motion.path_left_at(now) if is_path else motion.remaining_at(now)
        elif self.order is not None:
            plan = self._plan(now, self.order)
            left = plan.path_left_at(now) if is_path else plan.total
        else:
            left = self._left
        if quirks.readcount_sign == "magnitude":
            return abs(left[0]), abs(left[1]), abs(left[2]), abs(left[3])
        return left

    def made_at(self, now: Nanos) -> Four:
        """Pulses at the step outputs since power-up, those of compensation included."""
        return self._made if self._motion is None else added(self._made, self._motion.made_at(now))

    def rates_at(self, now: Nanos) -> tuple[float, ...]:
        """Steps per second at the step outputs, with the sign of the direction."""
        return (0.0,) * AXES if self._motion is None else self._motion.rates_at(now)

    def phantom_at(self, now: Nanos) -> int:
        """Phantom steps since power-up (E1, E2)."""
        return self._phantom + (0 if self._motion is None else self._counted(self._motion, now))

    def _counted(self, motion: VectorMotion, now: Nanos) -> int:
        """Phantom steps of one motion (MN4-CMD-E-03, MN4-CMD-E-04)."""
        if self._quirks.measure_single_axis == "major" and sum(map(bool, motion.total)) == 1:
            return sum(map(abs, motion.position_at(now)))
        return motion.phantom_at(now)

    def motion_at(self, now: Nanos) -> VectorMotion | None:
        """The motion that runs or is paused."""
        return self._motion

    # -- acceptance --

    def expected(self, now: Nanos) -> Four:
        """Where the counters will stand when all that is accepted is over."""
        position = self.position_at(now)
        if self._motion is not None:
            position = wrapped(added(self._base, self._motion.total))
        elif self.order is not None:
            position = self.order.end(position, self._quirks)
        for item in self.queue:
            if isinstance(item, MotionOrder):
                position = item.end(position, self._quirks)
            elif item.moves_counters_to is not None:
                position = loaded(position, item.moves_counters_to)
        return position

    def check(self, now: Nanos, order: MotionOrder) -> None:
        """Raises ParameterError if ``order`` cannot run behind all that is accepted."""
        order.check(self.expected(now), self.rules, self._quirks)

    def make_room(self) -> None:
        """Raises QueueFullError if nothing more can be queued (MN4-STM-03)."""
        if len(self.queue) >= self._quirks.queue_depth:
            raise QueueFullError

    def take(self, now: Nanos, order: MotionOrder) -> None:
        """Run ``order`` now, or behind what runs."""
        self.was_flushed = False
        self.queue.append(order)
        self._go_on(now)

    def set(self, now: Nanos, waiting: Waiting) -> None:
        """Do it now, or behind what runs."""
        if waiting.change is not None:
            self.accepted = waiting.change(self.accepted)
        if self._quirks.queue_modal or not self.is_busy:
            self.queue.append(waiting)
            self._go_on(now)
        else:
            self._obey(now, waiting)

    def load(self, now: Nanos, values: Sequence[int | None], jogged: Four = ZERO) -> None:
        """Load the counters; what moves or jogs goes on (MN4-CMD-L-01, MN4-CMD-L-03)."""
        position = wrapped(added(self.position_at(now), jogged))
        moved = [new - old for new, old in zip(loaded(position, values), position, strict=True)]
        self._base = wrapped(added(self._base, moved))

    def remember(self, now: Nanos, directions: Sequence[int | None]) -> None:
        """Set the remembered directions (MN4-CMD-D-01)."""
        self._memory = loaded(self._memory, directions)

    def count(self, now: Nanos, motion: VectorMotion) -> None:
        """Take over what ``motion``, a jog that is over, has moved (rule 5)."""
        self._base = wrapped(added(self._base, motion.position_at(now)))
        self._made = added(self._made, motion.made_at(now))
        moved = motion.lash_memory_at(now)
        was = zip(self._memory, moved, motion.position_at(now), strict=True)
        self._memory = loaded(self._memory, [new if way else old for old, new, way in was])

    def _obey(self, now: Nanos, waiting: Waiting) -> None:
        if waiting.change is not None:
            self.settings = waiting.change(self.settings)
        if waiting.act is not None:
            waiting.act(now)

    # -- time --

    def next_event(self) -> Nanos:
        """When a motion ends, or meets a limit."""
        if self._motion is None:
            return NEVER
        end_ns = self._motion.end_ns
        return min(NEVER if end_ns is None else end_ns, self._limit_ns)

    def wake(self, now: Nanos) -> None:
        """Do what is due by ``now``, event after event."""
        while (due := self.next_event()) <= now:
            motion = self._motion
            assert motion is not None
            if self._limit_ns <= due and (motion.end_ns is None or due <= motion.end_ns):
                self._meet_limits(due)
            else:
                self._finish(due)
                self._go_on(due)

    def _go_on(self, now: Nanos) -> None:
        """Whatever can be done at once of what waits."""
        while self.queue and not self.is_busy:
            item = self.queue.popleft()
            if isinstance(item, Waiting):
                self._obey(now, item)
            else:
                self._begin(now, item)

    def _begin(self, now: Nanos, order: MotionOrder) -> None:
        """Start a motion (rules 2 to 4)."""
        self.order = order
        self.is_aborted = False
        self._left = self._path_left = ZERO
        self._ended_by, self._halted_code, self._cut = None, 0, "aborted"
        if self.is_latched:
            self._reasons.add("command")
            self.is_latched = False
        if self._inputs.is_shield_open:
            if not self.has_feed_hold:
                self._start(now)
                self.abort(now)
                return
            self._reasons.add("shield")
        if not self._reasons:
            self._start(now)

    def _plan(self, now: Nanos, order: MotionOrder) -> VectorMotion:
        position = self.position_at(now)
        start = MoveStart(now, position, self._memory, self._inputs.feed_permille)
        motion = order.plan(start, self.rules, self._quirks)
        if self.rules.step_phase == "start" and self._blocked():
            # Towards a limit no step is made, not even that of the very start (MN4-LIM-06).
            late = order.plan(start, replace(self.rules, step_phase="end"), self._quirks)
            motion = late if self._met(late, now) else motion
        if self.train is not None and order.is_paced:
            motion = motion.paced_by(now, self.train)
        return motion

    def _start(self, now: Nanos) -> None:
        """Let the motion whose turn it is move."""
        assert self.order is not None
        self._motion = self._plan(now, self.order)
        self._watch(now)
        self._finish_if_over(now)

    def _finish_if_over(self, now: Nanos) -> None:
        """What ``_watch`` leaves of a motion may be over at once."""
        if self._motion is not None and self._motion.is_over_at(now):
            self._finish(now)

    def _finish(self, now: Nanos) -> None:
        """The motion is over: by itself, or ended before."""
        motion, order = self._motion, self.order
        assert motion is not None
        assert order is not None
        self._phantom += self._counted(motion, now)
        self._made = added(self._made, motion.made_at(now))
        self._memory = motion.lash_memory_at(now)
        if self._ended_by is None:
            self.exit_code = self._halted_code
        else:
            self.exit_code = self._ended_by
        if self._ended_by is not None or self._halted_code:
            self.is_aborted = True
            if self._quirks.readcount_after_abort == "kept":
                self._left = self.left_at(now)
        self._base = wrapped(added(self._base, motion.position_at(now)))
        self.ended.append(EndedMotion(order, self._cut if self.is_aborted else "completed"))
        self._forget()

    def _forget(self) -> None:
        self._motion, self.order, self._limit_ns = None, None, NEVER
        self._reasons.discard("command")
        if not self._inputs.is_shield_open:
            self._reasons.discard("shield")

    # -- limits (rule 3) --

    def _blocked(self) -> list[tuple[int, int, int]]:
        """Axis, direction and ON value of what the limits block."""
        is_both = self._quirks.limit_direction == "both"
        return [
            (axis, way, value)
            for axis, direction, value in self._inputs.limits_on
            for way in ((direction, -direction) if is_both else (direction,))
        ]

    def _met(self, motion: VectorMotion, now: Nanos) -> list[tuple[int, int]]:
        """Axis and ON value of the limits that block its next steps."""
        headings = motion.headings_at(now)
        return [(axis, value) for axis, way, value in self._blocked() if headings[axis] == way]

    def _watch(self, now: Nanos) -> None:
        """Halt what moves towards a limit, and foresee when it will."""
        motion = self._motion
        self._limit_ns = NEVER
        if motion is None or self._ended_by is not None:
            return
        if self._met(motion, now):
            self._trip(now, now)
            return
        for axis, way, _ in self._blocked():
            step = motion.next_step(axis, now, way)
            if step is not None:
                self._limit_ns = min(self._limit_ns, step.at_ns)

    def _meet_limits(self, now: Nanos) -> None:
        """The next step would be towards a limit: it is not made."""
        self._limit_ns = NEVER
        self._trip(now, now - 1)

    def _trip(self, now: Nanos, last_ns: Nanos) -> None:
        """Halt for the limits that block what comes behind ``last_ns``."""
        motion = self._motion
        assert motion is not None
        met = self._met(motion, last_ns)
        if self._quirks.multi_limit_exit == "first":
            code = self._halted_code or met[0][1]
        else:
            code = self._halted_code | sum(value for _, value in met)
        if self._quirks.limit_halts == "axis":
            self._halted_code = code
            for axis, _ in met:
                motion = motion.halt_axis(last_ns, axis)
            self._motion = motion
            self._watch(now)
            self._finish_if_over(now)
            self._go_on(now)
            return
        self._end(now, last_ns, code, is_ramped=self._quirks.limit_ramp)

    # -- ends --

    def _end(self, now: Nanos, last_ns: Nanos, code: int, *, is_ramped: bool) -> None:
        """End the motion and drop what waits (rule 3)."""
        self._flush()
        self._ended_by = code
        self._limit_ns = NEVER
        if self._motion is None:
            assert self.order is not None
            self._motion = self._plan(now, self.order)
        self._motion = self._motion.quit(last_ns, ramped=is_ramped)
        self.was_flushed = True
        if self._motion.is_over_at(now):
            self._finish(now)

    def _flush(self) -> None:
        """Drop what waits, settings included."""
        dropped = (item for item in self.queue if isinstance(item, MotionOrder))
        self.ended += [EndedMotion(order, self._cut) for order in dropped]
        self.queue.clear()
        self.accepted = self.settings

    def abort(self, now: Nanos) -> None:
        """End the motion for the shield: at once, exit code 0 (MN4-SHD-03)."""
        if self.is_busy:
            self._end(now, now, self._abort_code(), is_ramped=False)

    def _abort_code(self) -> int:
        text = self._quirks.abort_exit_code
        return self.exit_code if text == "keep" else int(text)

    def quit(self, now: Nanos) -> None:
        """Q: end the motion, and drop what waits (MN4-CMD-Q-01, MN4-CMD-Q-02)."""
        kept: list[MotionOrder | Waiting] = []
        accepted = self.accepted
        if not self._quirks.quit_flushes_queue:
            kept += self.queue
            self.queue.clear()
        if self.is_busy:
            self._cut = "quit"
            is_ramped = self._quirks.quit_decel and not self.is_paused
            self._end(now, now, self._abort_code(), is_ramped=is_ramped)
        self._reasons.discard("command")
        if not self._quirks.quit_flushes_queue:
            self.queue.extend(kept)
            self.accepted = accepted
            self._go_on(now)

    # -- pauses (rule 4) --

    def pause(self, now: Nanos, reason: PauseReason = "command") -> None:
        """Pause the motion; without one see MN4-AMB-61."""
        if not self.is_busy:
            self.is_latched = reason == "command" and self._quirks.pause_idle == "latch"
            return
        was_free = not self._reasons
        self._reasons.add(reason)
        if was_free and self._motion is not None and self._ended_by is None:
            self._motion = self._motion.pause(now)
            self._watch(now)

    def resume(self, now: Nanos, reason: PauseReason = "command") -> None:
        """Take a reason for the pause back; without any left the motion goes on."""
        if reason == "command":
            self.is_latched = False
        if reason not in self._reasons:
            return
        self._reasons.discard(reason)
        if self._reasons or not self.is_busy:
            return
        if self._motion is None:
            self._start(now)
            self._go_on(now)
        elif self._ended_by is None:
            self._motion = self._motion.resume(now)
            self._watch(now)

    # -- inputs and pulses --

    def limits_changed(self, now: Nanos) -> None:
        """A limit has gone on or off."""
        self._watch(now)

    def shield_changed(self, now: Nanos) -> None:
        """The shield was opened or shut (MN4-SHD-01)."""
        if not self._inputs.is_shield_open:
            self.resume(now, "shield")
        elif self.has_feed_hold:
            if self.is_busy:
                self.pause(now, "shield")
        else:
            self.abort(now)

    def feed_changed(self, now: Nanos) -> None:
        """The feedrate potentiometer has another effect."""
        if self._motion is not None and self._ended_by is None:
            self._motion = self._motion.override(now, self._inputs.feed_permille)
            self._watch(now)

    def _change_paced(self, now: Nanos, change: Callable[[VectorMotion], VectorMotion]) -> None:
        if self._motion is None or not self.is_waiting_for_pulses:
            return
        self._motion = change(self._motion)
        self._watch(now)
        self._finish_if_over(now)
        self._go_on(now)

    def index(self, now: Nanos) -> None:
        """The threader's index pulse."""
        self._change_paced(now, lambda motion: motion.index(now))

    def feed(self, now: Nanos, pulses: int) -> None:
        """External pulses; one by one where a limit may come in the way of a path that turns."""
        order = self.order
        turns = order is not None and order.letter in "A+)" and any(self._inputs.limits_on)
        for count in [1] * pulses if turns else [pulses]:
            self._take_pulses(now, count)
            if self.order is not order:
                break

    def _take_pulses(self, now: Nanos, count: int) -> None:
        self._change_paced(now, lambda motion: motion.feed(now, count))

    def follow(self, now: Nanos, train: PulseTrain | None) -> None:
        """Pulses come by themselves from now on, or no more."""
        self.train = train
        self._change_paced(now, lambda motion: motion.paced_by(now, train))
