"""A motion: a chain of paths, the paces that drive it, and what a host may do to it meanwhile."""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import attrgetter

from axistwin.devices.mn400.motion.pace import Pace
from axistwin.devices.mn400.motion.paths import MotorStep, PathChain
from axistwin.devices.mn400.motion.pulses import PulseTrain
from axistwin.devices.mn400.motion.rules import AXES, MoveSettings, Quad
from axistwin.devices.mn400.motion.timeline import ONE
from axistwin.kernel.time import Nanos

NANOSECOND = ONE >> 11
"""More than any motion moves in a nanosecond: 400 000 ticks/s with a multiplex of 4."""

RATE_STEPS = 8
"""To either side of an instant, whose mean slope is that of the path there."""


@dataclass(frozen=True)
class VectorMotion:
    """A motion as planned now; the interface is told in the package's docstring."""

    settings: MoveSettings
    chain: PathChain
    paces: tuple[Pace, ...]
    """One behind the other along x, the first one the active one at ``since_ns``."""
    since_ns: Nanos
    feed_permille: int = 1000
    train: PulseTrain | None = None
    is_paused: bool = False
    is_aborted: bool = False
    halted_at: tuple[int | None, ...] = (None, None, None, None)
    """Axes that halted alone, and their last step."""
    known_from: int = -1
    """x at ``since_ns``: steps up to there were made before."""

    @classmethod
    def starting(
        cls,
        now_ns: Nanos,
        settings: MoveSettings,
        chain: PathChain,
        paces: Sequence[Pace],
    ) -> "VectorMotion":
        """The motion that starts at ``now_ns``."""
        laid = _laid(paces, now_ns)
        return cls(settings, chain, laid, now_ns, settings.feed_permille)

    # What it answers

    @cached_property
    def end_ns(self) -> Nanos | None:
        """When it is over; None: not as planned now."""
        if not self.paces:
            return self.since_ns
        return self.paces[0].rest_ns if self.is_aborted else self.paces[-1].end_ns

    @property
    def rest_ns(self) -> Nanos | None:
        """When a paused or aborted motion stands; None for others."""
        if not (self.is_paused or self.is_aborted):
            return None
        return self.paces[0].rest_ns if self.paces else self.since_ns

    def is_over_at(self, now_ns: Nanos) -> bool:
        """Whether it has ended by ``now_ns``."""
        return self.end_ns is not None and now_ns >= self.end_ns

    @property
    def total(self) -> Quad:
        """The commanded displacement, in steps."""
        return _quad(self.chain.net)

    def position_at(self, now_ns: Nanos) -> Quad:
        """The displacement so far, in steps."""
        chain, x, counts = self.chain, self._x_at(now_ns), self.settings.rules.backlash_counts
        first, second, third, fourth = [
            chain.displacement(axis, self._taken(axis, now_ns, x), counts) for axis in AXES
        ]
        return first, second, third, fourth

    def remaining_at(self, now_ns: Nanos) -> Quad:
        """Commanded steps that are left, net and signed."""
        return _quad(
            lambda axis: (
                self.chain.net(axis)
                - self.chain.displacement(axis, self._taken(axis, now_ns), False)
            )
        )

    def path_left_at(self, now_ns: Nanos) -> Quad:
        """Commanded steps that are left, counted along the path."""
        chain = self.chain
        return _quad(
            lambda axis: (
                chain.commanded(axis, chain.total(axis))
                - chain.commanded(axis, self._taken(axis, now_ns))
            )
        )

    def made_at(self, now_ns: Nanos) -> Quad:
        """Steps made so far in either direction, compensation included: pulses at the outputs."""
        return _quad(lambda axis: self._taken(axis, now_ns))

    def phantom_at(self, now_ns: Nanos) -> int:
        """Ticks of commanded moves of more than one axis so far (MN4-MEA-01)."""
        return self.chain.phantoms(self._x_at(now_ns))

    def rates_at(self, now_ns: Nanos) -> tuple[float, ...]:
        """Steps per second of each axis, with the sign of its direction, compensation included.

        The speed along the path now, times the mean slope of some steps around: the steps of a
        minor axis do not come evenly.
        """
        x, speed = self._x_at(now_ns), 0
        for pace in self.paces:
            if pace.start_ns is None or pace.start_ns > now_ns:
                break
            speed = pace.speed_at(now_ns)
        return tuple(self._rate(axis, now_ns, x, speed) for axis in AXES)

    def headings_at(self, now_ns: Nanos) -> Quad:
        """The direction of each axis' next step, be its pulse known or not; 0: none comes."""
        return _quad(lambda axis: self._heading(axis, now_ns))

    def step_time_ns(self, axis: int, n: int) -> Nanos | None:
        """When the ``n``-th commanded step [>= 1] of ``axis`` comes; None: never.

        A step that was made before ``since_ns`` counts as made then.
        """
        number = self.chain.number_of(axis, n)
        if number is None or self._is_beyond_halt(axis, number):
            return None
        return self._time_of(axis, number)

    def steps(self, axis: int, from_ns: Nanos, until_ns: Nanos) -> Iterator[MotorStep]:
        """All steps of ``axis`` with from_ns < t <= until_ns."""
        last = self._taken(axis, until_ns)
        for n in range(self._taken(axis, from_ns) + 1, last + 1):
            yield self._step(axis, n)

    def next_step(self, axis: int, after_ns: Nanos, direction: int = 0) -> MotorStep | None:
        """The first step of ``axis`` behind ``after_ns`` in ``direction`` (0: any)."""
        n = self.chain.next_in_direction(axis, self._taken(axis, after_ns) + 1, direction)
        if n is None or self._is_beyond_halt(axis, n) or self._time_of(axis, n) is None:
            return None
        return self._step(axis, n)

    def lash_memory_at(self, now_ns: Nanos) -> Quad:
        """The direction of each axis' last motion (MN4-BKL-02, MN4-BKL-05)."""
        return _quad(lambda axis: self._memory(axis, self._taken(axis, now_ns)))

    # What changes it

    def pause(self, now_ns: Nanos) -> "VectorMotion":
        """Stop, to be resumed; without effect on a motion that is over or paused."""
        if self.is_paused or self.is_over_at(now_ns):
            return self
        ramped = self.settings.rules.pause_decel
        changed = self._changed(now_ns, lambda pace, x: pace.stopped(now_ns, x, ramped))
        return replace(changed, is_paused=True)

    def resume(self, now_ns: Nanos) -> "VectorMotion":
        """Go on, from rest or from a speed that is still left."""
        if not self.is_paused or self.is_over_at(now_ns):
            return self
        feed = self.feed_permille
        changed = self._changed(now_ns, lambda pace, x: pace.going_on(now_ns, x, feed))
        return replace(changed, is_paused=False)

    def quit(self, now_ns: Nanos, ramped: bool = False) -> "VectorMotion":
        """Stop for good; what is not done stays in ``remaining_at``."""
        if self.is_aborted or self.is_over_at(now_ns):
            return self
        changed = self._changed(now_ns, lambda pace, x: pace.stopped(now_ns, x, ramped))
        return replace(changed, paces=changed.paces[:1], is_aborted=True, is_paused=False)

    def halt_axis(self, now_ns: Nanos, axis: int) -> "VectorMotion":
        """Stop one axis; the others go on to their ends."""
        last = list(self.halted_at)
        last[axis] = self._taken(axis, now_ns)
        return replace(self, halted_at=tuple(last))

    def override(self, now_ns: Nanos, feed_permille: int) -> "VectorMotion":
        """Another share of the programmed speed [0..1000], from now on (MN4-IO-01)."""
        if self.is_aborted or self.is_over_at(now_ns) or feed_permille == self.feed_permille:
            return self
        if self.is_paused:
            return replace(self, feed_permille=feed_permille)
        changed = self._changed(now_ns, lambda pace, x: pace.going_on(now_ns, x, feed_permille))
        later = [pace.going_on(now_ns, 0, feed_permille) for pace in changed.paces[1:]]
        paces = _laid([changed.paces[0], *(pace.starting(None) for pace in later)], None)
        return replace(changed, paces=paces, feed_permille=feed_permille)

    def feed(self, now_ns: Nanos, pulses: int) -> "VectorMotion":
        """External pulses, all at ``now_ns``."""
        return self._pulsed(now_ns, pulses, False, self.train)

    def index(self, now_ns: Nanos) -> "VectorMotion":
        """The index pulse of the threader."""
        return self._pulsed(now_ns, 0, True, self.train)

    def paced_by(self, now_ns: Nanos, train: PulseTrain | None) -> "VectorMotion":
        """Other pulses from ``now_ns`` on, with the train's own phase; None: only those by hand."""
        return replace(self._pulsed(now_ns, 0, False, train), train=train)

    # How

    def _pulsed(
        self, now_ns: Nanos, pulses: int, has_index: bool, train: PulseTrain | None
    ) -> "VectorMotion":
        if self.is_aborted or self.is_over_at(now_ns):
            return self
        changed = self._changed(
            now_ns, lambda pace, x: pace.after_pulses(now_ns, pulses, has_index, train)
        )
        later = [pace.after_pulses(now_ns, 0, False, train) for pace in changed.paces[1:]]
        return replace(changed, paces=_laid([changed.paces[0], *later], None))

    def _changed(self, now_ns: Nanos, change: Callable[[Pace, int], Pace]) -> "VectorMotion":
        """The motion behind ``change`` of the active pace, which is told what is done."""
        active = next(
            (k for k, pace in enumerate(self.paces) if pace.end_ns is None or pace.end_ns > now_ns),
            len(self.paces) - 1,
        )
        x = self._x_at(now_ns)
        for axis in AXES:
            if taken := self._taken(axis, now_ns):
                x = max(x, self.chain.place(axis, taken))
        pace = self.paces[active]
        paces = _laid([change(pace, min(x, pace.x1)), *self.paces[active + 1 :]], None)
        return replace(self, paces=paces, since_ns=now_ns, known_from=x)

    def _x_at(self, now_ns: Nanos) -> int:
        """Where the motion is along its path."""
        x = self.known_from
        for pace in self.paces:
            if pace.start_ns is None or pace.start_ns > now_ns:
                break
            reached = pace.x_at(now_ns)
            if reached > x:
                x = reached
        return x

    def _taken(self, axis: int, now_ns: Nanos, x: int | None = None) -> int:
        """How many steps of ``axis`` have been made by ``now_ns``, compensation included.

        x: where the motion is then, if that is known.
        """
        chain = self.chain
        x = self._x_at(now_ns) if x is None else x
        n = made = self._known[axis]
        if made != chain.total(axis):
            n = max(made, chain.taken(axis, x + NANOSECOND))
        if n > made and chain.place(axis, n) > x - NANOSECOND:
            n = self._taken_near(axis, now_ns, max(made, chain.taken(axis, x)), made)
        last = self.halted_at[axis]
        return n if last is None else min(n, last)

    @cached_property
    def _known(self) -> Quad:
        """How many steps were made before ``since_ns``."""
        return _quad(lambda axis: self.chain.taken(axis, self.known_from))

    def _taken_near(self, axis: int, now_ns: Nanos, n: int, made: int) -> int:
        """How many of about ``n`` steps, of which ``made`` are known, have been made."""
        total = self.chain.total(axis)
        # A step counts at the nanosecond nearest to it, so x may be half of one before it.
        while n < total and (at_ns := self._time_of(axis, n + 1)) is not None and at_ns <= now_ns:
            n += 1
        while n > made and (at_ns := self._time_of(axis, n)) is not None and at_ns > now_ns:
            n -= 1
        return n

    def _time_of(self, axis: int, n: int) -> Nanos | None:
        """When step ``n`` of ``axis``, compensation included, comes."""
        x = self.chain.place(axis, n)
        if x <= self.known_from or not self.paces:
            return self.since_ns
        index = bisect_left(self.paces, x, key=attrgetter("x1"))
        return self.paces[index].time_of(x) if index < len(self.paces) else None

    def _is_beyond_halt(self, axis: int, n: int) -> bool:
        last = self.halted_at[axis]
        return last is not None and n > last

    def _step(self, axis: int, n: int) -> MotorStep:
        at_ns = self._time_of(axis, n)
        assert at_ns is not None, "a step that has no time"
        return MotorStep(at_ns, *self.chain.step(axis, n))

    def _heading(self, axis: int, now_ns: Nanos) -> int:
        n = self._taken(axis, now_ns) + 1
        if n > self.chain.total(axis) or self._is_beyond_halt(axis, n):
            return 0
        stands = self.is_paused or self.is_aborted
        if stands and self._time_of(axis, n) is None:
            return 0
        return self.chain.step(axis, n)[0]

    def _rate(self, axis: int, now_ns: Nanos, x: int, speed: int) -> float:
        following = self._taken(axis, now_ns) + 1
        if not speed or self._is_beyond_halt(axis, following):
            return 0.0
        return speed * self.chain.slope(axis, following, x, RATE_STEPS)

    def _memory(self, axis: int, taken: int) -> int:
        if not self.chain.total(axis):
            return self.settings.lash_memory[axis]
        return self.chain.step(axis, max(1, taken))[0]


def _quad(of_axis: Callable[[int], int]) -> Quad:
    first, second, third, fourth = (of_axis(axis) for axis in AXES)
    return first, second, third, fourth


def _laid(paces: Sequence[Pace], start_ns: Nanos | None) -> tuple[Pace, ...]:
    """``paces`` each starting where the one before ends; None: the first keeps its start."""
    laid: list[Pace] = []
    for pace in paces:
        if laid or start_ns is not None:
            pace = pace.starting(laid[-1].end_ns if laid else start_ns)
        laid.append(pace)
    return tuple(laid)
