"""What drives a motion along its path: the clock, or external pulses.

Rules
-----
1. A pace drives a range of x.  It is immutable; a change gives the pace from then on.
2. On the clock the speeds come from the look-ahead.  Every change of speed under way (pause,
   resume, feed rate) is a new plan from the present place and speed.  Where that is faster than
   the new plan, the motion brakes at the profile's acceleration until it meets the plan; at or
   below start speed it changes at once, and so do unramped arcs (MN4-MOT-13).
3. On pulses each pulse is one tick (MN4-SYN-01, MN4-THR-01).  Pulses during a pause are lost.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from math import isqrt
from typing import Protocol

from axistwin.devices.mn400.motion.lookahead import Seam, SpeedPlan, Stretch, limits_of
from axistwin.devices.mn400.motion.pulses import PulseTrain
from axistwin.devices.mn400.motion.rules import MoveSettings
from axistwin.devices.mn400.motion.timeline import FINE, ONE, GlideShape, Timeline
from axistwin.kernel.time import Nanos

NEAR = ONE >> 16
"""A stop so near before a tick is at the tick; a speed so near to start speed is that."""


class Pace(Protocol):
    """Places and times from ``x0`` to ``x1``; ``start_ns`` None: not known yet."""

    @property
    def x0(self) -> int:
        """Where the pace takes over."""

    @property
    def x1(self) -> int:
        """Where its range ends."""

    @property
    def start_ns(self) -> Nanos | None:
        """When it takes over."""

    @property
    def rest_ns(self) -> Nanos | None:
        """When it comes to rest, at its end or before; None: not known."""

    @property
    def end_ns(self) -> Nanos | None:
        """When it reaches its end; None: it does not, as planned now."""

    def time_of(self, x: int) -> Nanos | None:
        """When ``x`` is reached; None: it is not."""

    def x_at(self, now_ns: Nanos) -> int:
        """Where the motion is."""

    def speed_at(self, now_ns: Nanos) -> int:
        """How much of x it drives in a second."""

    def starting(self, start_ns: Nanos | None) -> "Pace":
        """The same pace with that start."""

    def stopped(self, now_ns: Nanos, x: int, ramped: bool) -> "Pace":
        """It stops, after braking if ``ramped``; steps up to ``x`` are made already."""

    def going_on(self, now_ns: Nanos, x: int, feed_permille: int) -> "Pace":
        """It goes on from where it is, at that share of the speed."""

    def after_pulses(
        self, now_ns: Nanos, pulses: int, has_index: bool, train: PulseTrain | None
    ) -> "Pace":
        """It got pulses by hand or an index pulse, or another train."""


@dataclass(frozen=True)
class TimedPace:
    """Stretches on the clock."""

    settings: MoveSettings
    x0: int
    stretches: tuple[Stretch, ...]
    seams: tuple[Seam | None, ...]
    feed_permille: int
    bounds: tuple[int, ...]
    """Where each stretch ends."""
    timeline: Timeline
    start_ns: Nanos | None = None

    @classmethod
    def of(
        cls,
        settings: MoveSettings,
        x0: int,
        stretches: Sequence[Stretch],
        seams: Sequence[Seam | None],
    ) -> "TimedPace":
        """The pace from rest to rest."""
        bounds = tuple(accumulate((one.length * one.multiplex for one in stretches), initial=x0))
        nothing = Timeline(x0, ())
        pace = cls(
            settings,
            x0,
            tuple(stretches),
            tuple(seams),
            settings.feed_permille,
            bounds[1:],
            nothing,
        )
        return replace(pace, timeline=pace._plan(x0, None, settings.feed_permille))

    @property
    def x1(self) -> int:
        """Where the last stretch ends."""
        return self.bounds[-1]

    @property
    def rest_ns(self) -> Nanos | None:
        """When the timeline ends."""
        return None if self.start_ns is None else self.start_ns + self.timeline.duration_ns

    @property
    def end_ns(self) -> Nanos | None:
        """When the end is reached."""
        return self.rest_ns if self.timeline.x1 >= self.x1 else None

    def time_of(self, x: int) -> Nanos | None:
        """When ``x`` is reached."""
        elapsed_ns = self.timeline.time_of(x)
        if self.start_ns is None or elapsed_ns is None:
            return None
        return self.start_ns + elapsed_ns

    def x_at(self, now_ns: Nanos) -> int:
        """Where the motion is."""
        if self.start_ns is None or now_ns < self.start_ns:
            return self.timeline.x0
        return self.timeline.x_at(now_ns - self.start_ns)

    def speed_at(self, now_ns: Nanos) -> int:
        """The speed of the timeline."""
        return self._state_at(now_ns)[1]

    def starting(self, start_ns: Nanos | None) -> "TimedPace":
        """The same pace with that start."""
        return replace(self, start_ns=start_ns)

    def stopped(self, now_ns: Nanos, x: int, ramped: bool) -> "TimedPace":
        """Brakes to start speed if ``ramped``, and rests."""
        place, speed = self._state_at(now_ns)
        x = max(x, place)
        pieces: list[GlideShape] = []
        if ramped and speed:
            index, rest = self._rest(x)
            slow = self.settings.profile.start << FINE
            target = [[GlideShape(stretch.length, slow, slow)] for stretch in rest]
            entry = speed // rest[0].multiplex
            for part, stretch in zip(self._braking(entry, target, index)[0], rest, strict=False):
                pieces += [_in_ticks(piece, stretch) for piece in part]
        return replace(self, timeline=self._timeline(x, pieces), start_ns=now_ns)

    def going_on(self, now_ns: Nanos, x: int, feed_permille: int) -> "TimedPace":
        """A new plan from the present place and speed."""
        if self.start_ns is None:
            timeline = self._plan(self.x0, None, feed_permille)
            return replace(self, timeline=timeline, feed_permille=feed_permille)
        place, speed = self._state_at(now_ns)
        timeline = self._plan(max(x, place), speed or None, feed_permille)
        return replace(self, timeline=timeline, start_ns=now_ns, feed_permille=feed_permille)

    def after_pulses(
        self, now_ns: Nanos, pulses: int, has_index: bool, train: PulseTrain | None
    ) -> "TimedPace":
        """Pulses do not matter."""
        return self

    def _state_at(self, now_ns: Nanos) -> tuple[int, int]:
        if self.start_ns is None or now_ns < self.start_ns:
            return self.timeline.x0, 0
        return self.timeline.state_at(now_ns - self.start_ns)

    def _rest(self, x: int) -> tuple[int, list[Stretch]]:
        """(index, stretches) from ``x`` on, the first one cut."""
        index = min(bisect_right(self.bounds, x), len(self.bounds) - 1)
        first = self.stretches[index]
        left = max(0, self.bounds[index] - x) // first.multiplex
        return index, [first._replace(length=left), *self.stretches[index + 1 :]]

    def _plan(self, x: int, speed: int | None, feed_permille: int) -> Timeline:
        """The plan from ``x`` on; ``speed``: in ticks, None from rest."""
        index, rest = self._rest(x)
        entry = None if speed is None else speed // rest[0].multiplex
        limits = [limits_of(stretch, self.settings, feed_permille) for stretch in rest]
        plan = SpeedPlan(limits, self.seams[index:], entry)
        planned = [
            limit.pieces(plan.entries[k], plan.exits[k], rest[k].length)
            for k, limit in enumerate(limits)
        ]
        if entry is not None and entry > plan.entries[0]:
            braking, met = self._braking(entry, planned, index)
            planned = [*braking[:-1], [*braking[-1], *met], *planned[len(braking) :]]
        pieces = [
            _in_ticks(piece, stretch)
            for stretch, part in zip(rest, planned, strict=True)
            for piece in part
        ]
        return self._timeline(x, pieces)

    def _timeline(self, x: int, pieces: list[GlideShape]) -> Timeline:
        """The timeline of ``pieces``; at the end, or behind a ramp at a tick, if it is near."""
        timeline = Timeline.of(x, pieces)
        missing = self.x1 - timeline.x1
        if pieces and missing > 0:
            missing = min(missing, -timeline.x1 % ONE)
        if not 0 < missing < NEAR:
            return timeline
        distance, v0, v1 = pieces[-1] if pieces else GlideShape(0, ONE, ONE)
        return Timeline.of(x, [*pieces[:-1], GlideShape(distance + missing, v0, v1)])

    def _braking(
        self, speed: int, planned: Sequence[Sequence[GlideShape]], index: int
    ) -> tuple[list[list[GlideShape]], list[GlideShape]]:
        """Brake from ``speed`` until ``planned`` is met, stretch by stretch from ``index`` on.

        The pieces of the braking, and what follows of the plan in the stretch where they meet.
        """
        braking: list[list[GlideShape]] = []
        for offset, part in enumerate(planned):
            braking.append([])
            if offset:
                seam = self.seams[index + offset - 1]
                # Down to start speed it passes hard seams, too, rounding apart: there lo, which
                # is that of a soft seam, says nothing, and the plan is met at once.
                is_braking = speed > (self.settings.profile.start << FINE) + NEAR
                slowest = seam.lowest_entry(speed) if seam and is_braking else 0
                speed = max(slowest, part[0].v0)
            if not self.stretches[index + offset].is_ramped:
                return braking, list(part)
            for number, piece in enumerate(part):
                distance = self._braking_distance(speed, piece)
                if distance < piece.distance:
                    left = _cut(piece, distance)
                    lowest = max(piece.v0, self.settings.profile.start << FINE)
                    if distance:
                        end = max(left.v0, min(lowest, speed))
                        braking[-1].append(GlideShape(distance, speed, end))
                    return braking, [left, *part[number + 1 :]]
                loss = self.settings.twice_acceleration * piece.distance << FINE
                end = isqrt(max(1, speed * speed - loss))
                braking[-1].append(GlideShape(piece.distance, speed, end))
                speed = end
        return braking, []

    def _braking_distance(self, speed: int, piece: GlideShape) -> int:
        """How far into ``piece`` braking meets it, or start speed; its distance: not in it."""
        start = self.settings.profile.start << FINE
        v0, v1 = max(piece.v0, start), max(piece.v1, start)
        excess = speed * speed - v0 * v0
        if excess <= 0:
            return 0
        closing = v1 * v1 - v0 * v0 + (self.settings.twice_acceleration * piece.distance << FINE)
        if closing <= 0:
            return piece.distance
        return min(piece.distance, excess * piece.distance // closing)


def _in_ticks(piece: GlideShape, stretch: Stretch) -> GlideShape:
    m = stretch.multiplex
    return GlideShape(piece.distance * m, piece.v0 * m, piece.v1 * m)


def _cut(piece: GlideShape, distance: int) -> GlideShape:
    """What is left of ``piece`` behind ``distance``."""
    distance_all, v0, v1 = piece
    if v0 != v1:
        v0 = isqrt(v0 * v0 + (v1 * v1 - v0 * v0) * distance // distance_all)
    return GlideShape(distance_all - distance, v0, v1)


@dataclass(frozen=True, slots=True)
class PulsedPace:
    """One tick for each pulse, on the index pulse and some pulses later if so wished."""

    x0: int
    x1: int
    needs_index: bool = False
    offset: int = 0
    """Pulses to let pass first."""
    train: PulseTrain | None = None
    start_ns: Nanos | None = None
    used_before: int = 0
    """Pulses used before ``start_ns``, and at it."""
    used: int = 0
    is_halted: bool = False

    @property
    def end_ns(self) -> Nanos | None:
        """When the last pulse comes."""
        return self.time_of(self.x1)

    @property
    def rest_ns(self) -> Nanos | None:
        """When the last pulse comes, or now that it is halted."""
        return self.start_ns if self.is_halted else self.end_ns

    def time_of(self, x: int) -> Nanos | None:
        """When the pulse of ``x`` comes."""
        needed = -((self.x0 - x) // ONE) - self.used
        if self.start_ns is None or needed <= 0:
            return self.start_ns
        if self.is_halted or self.train is None:
            return None
        origin = self._origin()
        return None if origin is None else self.train.time_of(origin + self.offset + needed)

    def x_at(self, now_ns: Nanos) -> int:
        """Where the motion is."""
        if self.start_ns is None or now_ns < self.start_ns:
            return self.x0 + (self.used_before << FINE)
        return min(self.x1, self.x0 + (self._at(now_ns).used << FINE))

    def speed_at(self, now_ns: Nanos) -> int:
        """That of the train, from the first pulse that is used to the last."""
        first_ns, end_ns = self.time_of(self.x0 + ONE), self.end_ns
        if self.train is None or first_ns is None or end_ns is None:
            return 0
        is_driven = first_ns <= now_ns < end_ns
        return (self.train.rate_millihertz << FINE) // 1000 if is_driven else 0

    def starting(self, start_ns: Nanos | None) -> "PulsedPace":
        """The same pace with that start."""
        return replace(self, start_ns=start_ns)

    def stopped(self, now_ns: Nanos, x: int, ramped: bool) -> "PulsedPace":
        """Lets all pulses pass."""
        return replace(self._at(now_ns), is_halted=True)

    def going_on(self, now_ns: Nanos, x: int, feed_permille: int) -> "PulsedPace":
        """Heeds pulses again; the feed rate does not matter (MN4-THR-06)."""
        return self if self.start_ns is None else replace(self._at(now_ns), is_halted=False)

    def after_pulses(
        self, now_ns: Nanos, pulses: int, has_index: bool, train: PulseTrain | None
    ) -> "PulsedPace":
        """Uses pulses given by hand, and hears the index."""
        if self.start_ns is None:
            return replace(self, train=train)
        pace = replace(self._at(now_ns), train=train)
        if pace.is_halted:
            return pace
        if has_index:
            return replace(pace, needs_index=False)
        return pace._using(pulses)

    def _origin(self) -> int | None:
        """Number of the pulse behind which the train's pulses count; None: no index comes."""
        assert self.train is not None
        assert self.start_ns is not None
        heard = self.train.count_at(self.start_ns)
        return self.train.index_after(heard) if self.needs_index else heard

    def _at(self, now_ns: Nanos) -> "PulsedPace":
        """The same pace as seen from ``now_ns`` on."""
        pace = replace(self, start_ns=now_ns, used_before=self.used)
        if self.train is None or self.start_ns is None or self.is_halted:
            return pace
        origin = self._origin()
        count = self.train.count_at(max(now_ns, self.start_ns))
        if origin is None or count < origin:
            return pace
        pace = replace(pace, needs_index=False)._using(count - origin)
        return replace(pace, used_before=pace.used)

    def _using(self, pulses: int) -> "PulsedPace":
        """It got that many pulses more."""
        if self.needs_index:
            return self
        skipped = min(self.offset, pulses)
        return replace(self, offset=self.offset - skipped, used=self.used + pulses - skipped)
