"""What every journey of an MN400 has to keep, from its steps alone and by the ledger's formulas.

Nothing here asks the twin how it planned.  Between two steps only the mean speed is known, so each
bound has the room that its quantisation needs, and no more:

    a step comes at the nearest ns              an interval may be 1 ns short
    a mean speed over T, acceleration a         the speed at either end is within a·T/2 of it
    start speed comes and goes at once          below it, changes are not limited
    a lattice point lies beside the circle      1.5 steps, and what the two radii differ by
    ticks of a helix are those of its circle    the traverse goes by the angle, which a tick sweeps
        or its traverse, whichever are more     unevenly: up to 4/π of its mean speed; and where
                                                the traverse has more, up to π/(2√2) for the circle
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import atan2, floor, hypot, pi, sin, sqrt, tau
from random import Random

from mn400_journeys import Four, Journey, Travel, Turn, travelled
from mn400_motions import S, end

from axistwin.devices.mn400.motion import MotorStep, MoveSettings, VectorMotion

ROUNDING_NS = 1
NEAR = 1e-6
"""Of a speed, what floats may cost the judge."""


def judge(journey: Journey) -> None:
    """All properties of one journey; raises AssertionError."""
    if journey.kind == "long":
        judge_long(journey)
        return
    travel = travelled(journey)
    judge_end(travel)
    if journey.turn is None:
        judge_speeds(travel)
    else:
        judge_arc(travel, journey.turn)
    judge_duration(travel)
    judge_mirror(travel)


# ---- ends ----


def judge_end(travel: Travel) -> None:
    """Exactly at the target, each step made once and in order (MN4-CMD-PAU-02, MN4-ARC-03)."""
    motion, at_ns = travel.recorder.motion, travel.recorder.since_ns
    assert motion.total == travel.journey.total, "it is to go elsewhere"
    assert motion.position_at(at_ns) == travel.journey.total, "it ends elsewhere"
    assert motion.remaining_at(at_ns) == (0, 0, 0, 0), "something is left at the end"
    for axis, steps in enumerate(travel.recorder.steps):
        moved = sum(step.direction for step in steps if step.is_commanded)
        assert moved == travel.journey.total[axis], "the steps lead elsewhere"
        assert len(steps) == motion.made_at(at_ns)[axis], "steps are lost or doubled"
        assert all(one.at_ns <= other.at_ns for one, other in pairwise(steps)), "out of order"
    own = travel.journey.settings
    directions = first_directions(travel)
    for axis in range(4):
        is_turned = directions[axis] * own.lash_memory[axis] < 0
        made = sum(not step.is_commanded for step in travel.recorder.steps[axis])
        assert made == is_turned * own.lash[axis], "backlash is not taken up as it should be"


def first_directions(travel: Travel) -> Four:
    """The direction of each axis' first commanded step, 0 without one."""
    first, second, third, fourth = (
        next((step.direction for step in steps if step.is_commanded), 0)
        for steps in travel.recorder.steps
    )
    return first, second, third, fourth


def judge_mirror(travel: Travel) -> None:
    """The same journey with all axes the other way: the same steps at the same times."""
    other = travelled(travel.journey.mirrored())
    assert other.end_ns == travel.end_ns, "the mirrored journey takes another time"
    for here, there in zip(travel.recorder.steps, other.recorder.steps, strict=True):
        mirrored = [step._replace(direction=-step.direction) for step in there]
        assert here == mirrored, "the mirrored journey goes another way"


# ---- limits of speed ----


def cap_of(settings: MoveSettings, speed: int, permille: int, axes: int) -> int:
    """The top speed for a programmed one (MN4-CMD-V-03, MN4-MOT-04, MN4-IO-01)."""
    capped = min(max(2, speed * permille // 1000), settings.profile.end)
    multiplex = settings.multiplex if axes > 1 else 1
    return min(capped, 100_000 // multiplex) if multiplex > 1 else capped


def acceleration_of(settings: MoveSettings) -> float:
    """Effective acceleration (MN4-AMB-25)."""
    return settings.profile.acceleration * float(settings.rules.accel_scale)


@dataclass(frozen=True)
class Rung:
    """From one step of a segment's major axis to the next."""

    segment: int
    from_ns: int
    to_ns: int

    @property
    def span_s(self) -> float:
        """How long it lasts."""
        return (self.to_ns - self.from_ns) / S

    @property
    def speed(self) -> float:
        """The mean, steps/s; a span is as long as it can be for its two times."""
        return S / (self.to_ns - self.from_ns + ROUNDING_NS)


def major_of(displacement: Four) -> int:
    """The lowest axis among those with most steps."""
    return max(range(4), key=lambda axis: (abs(displacement[axis]), -axis))


def rungs_of(travel: Travel) -> list[Rung]:
    """All steps of the major axes, from the end of the compensation on."""
    commanded = [[one for one in steps if one.is_commanded] for steps in travel.recorder.steps]
    extra = [one.at_ns for steps in travel.recorder.steps for one in steps if not one.is_commanded]
    before_ns = max([travel.journey.start_ns, *extra])
    made, rungs = [0, 0, 0, 0], []
    for index, segment in enumerate(travel.journey.segments):
        if not any(segment.displacement):
            continue
        major = major_of(segment.displacement)
        count = abs(segment.displacement[major])
        for step in commanded[major][made[major] : made[major] + count]:
            assert step.direction * segment.displacement[major] > 0, "a step the wrong way"
            rungs.append(Rung(index, before_ns, step.at_ns))
            before_ns = step.at_ns
        made = [a + abs(b) for a, b in zip(made, segment.displacement, strict=True)]
    return rungs


class SpeedJudge:
    """Judges the rungs of a journey of straight segments."""

    def __init__(self, travel: Travel) -> None:
        self._travel = travel
        self._segments = travel.journey.segments
        self._settings = travel.journey.settings
        self._start = self._settings.profile.start
        self._rate = acceleration_of(self._settings)
        self._starts: list[int] = []

    def judge(self) -> None:
        """Speed, acceleration and margin of every rung."""
        rungs = rungs_of(self._travel)
        self._starts = [
            after.from_ns for before, after in pairwise(rungs) if before.segment != after.segment
        ]
        for rung in rungs:
            top = self._top(rung)
            assert rung.speed <= top * (1 + NEAR), ("too fast", rung.speed, top)
        for before, after in pairwise(rungs):
            if before.segment == after.segment:
                self._judge_gain(before, after)
            else:
                self._judge_junction(before, after)
        for rung in (*rungs[:1], *rungs[-1:]):
            assert self._is_at_start(rung), ("an end above start speed", rung.speed)

    def _cap(self, segment: int, permille: int) -> int:
        way, speed = self._segments[segment]
        return cap_of(self._settings, speed, permille, sum(map(bool, way)))

    def _top(self, rung: Rung) -> float:
        """The fastest that the pot allows or, where it was turned down, did until it had braked."""
        feeds, now = self._travel.feeds, self._cap(rung.segment, self._feed_at(rung.from_ns))
        fastest = now
        for (_, permille), (ended_ns, _) in pairwise([*feeds, (rung.to_ns, 0)]):
            highest = max(self._cap(each, permille) for each in range(len(self._segments)))
            grace_ns = max(0, highest - now) / self._rate * S
            until_ns = ended_ns + grace_ns + self._paused_ns(ended_ns)
            for start_ns in self._starts:  # the margin may lift it when it has braked in part
                if start_ns <= until_ns:
                    until_ns = max(until_ns, start_ns + grace_ns)
            if rung.from_ns <= until_ns:
                fastest = max(fastest, self._cap(rung.segment, permille))
        return fastest

    def _feed_at(self, now_ns: int) -> int:
        return next(value for at_ns, value in reversed(self._travel.feeds) if at_ns <= now_ns)

    def _paused_ns(self, from_ns: int) -> int:
        """How long it has paused from then on."""
        return sum(last - first for first, last in self._travel.pauses if last > from_ns)

    def _broken_s(self, rung: Rung) -> float:
        """How much of it is within pauses, in which it brakes, stands or both."""
        pauses = self._travel.pauses
        within = [min(last, rung.to_ns) - max(one, rung.from_ns) for one, last in pauses]
        return sum(max(0, span_ns) for span_ns in within) / S

    def _is_broken(self, rung: Rung) -> bool:
        pauses = self._travel.pauses
        return any(one <= rung.to_ns and rung.from_ns <= last for one, last in pauses)

    def _room(self, rung: Rung) -> float:
        """How far the speed at its end may be from the mean."""
        return self._rate * rung.span_s / 2 + 2 * rung.speed**2 / S + NEAR * rung.speed

    def _is_at_start(self, rung: Rung) -> bool:
        return self._is_broken(rung) or rung.speed <= self._start + self._room(rung)

    def _judge_gain(self, before: Rung, after: Rung) -> None:
        slow, fast = sorted((before, after), key=lambda rung: rung.speed)
        lowest, below = max(slow.speed, self._start), self._room(slow)
        if self._is_at_start(slow):  # in it, start speed was passed at the earliest at once
            below = max(below, self._rate / self._start)
        room = self._room(fast) + below + NEAR
        if self._is_broken(slow):
            lowest = max(lowest, 1 / max(NEAR, slow.span_s - self._broken_s(slow)))
        assert fast.speed - lowest <= room, ("too steep", slow.speed, fast.speed, room)

    def _judge_junction(self, before: Rung, after: Rung) -> None:
        """Within the margin for each of three axes, or both at start speed (MN4-CC-04, -07)."""
        if self._is_broken(before) or self._is_broken(after):
            return
        if self._is_at_start(before) and self._is_at_start(after):
            return
        margin = self._travel.journey.margin
        for axis in range(3):
            leave = [self._ratio(before, axis) * speed for speed in self._speeds(before)]
            enter = [self._ratio(after, axis) * speed for speed in self._speeds(after)]
            jump = max(min(enter) - max(leave), min(leave) - max(enter))
            room = abs(self._ratio(after, axis)) * self._room(after)
            room += abs(self._ratio(before, axis)) * self._room(before)
            assert jump <= margin + room, ("beyond the margin", jump, margin, room)

    def _speeds(self, rung: Rung) -> tuple[float, float]:
        """Those that it may have had at a junction: up to start speed it changes at once."""
        return rung.speed, max(rung.speed, self._start)

    def _ratio(self, rung: Rung, axis: int) -> float:
        way = self._segments[rung.segment].displacement
        return way[axis] / max(map(abs, way))


def judge_speeds(travel: Travel) -> None:
    """Never above speed, acceleration or margin (MN4-CC-04, MN4-CC-06, MN4-MOT-10)."""
    SpeedJudge(travel).judge()


# ---- durations ----


def straight_s(settings: MoveSettings, cap: int, steps: int) -> float:
    """How long a move of its own takes (ledger §5.2)."""
    start, rate = settings.profile.start, acceleration_of(settings)
    if cap <= start:
        return steps / cap
    ramp = (cap**2 - start**2) / (2 * rate)
    if 2 * ramp <= steps:
        return 2 * (cap - start) / rate + (steps - 2 * ramp) / cap
    return 2 * (sqrt(start**2 + rate * steps) - start) / rate


def lash_s(travel: Travel) -> float:
    """How long the compensation takes, which is a move of its own (ledger §5.6)."""
    settings, directions = travel.journey.settings, first_directions(travel)
    taken = [
        lash * (direction * memory < 0)
        for lash, direction, memory in zip(
            settings.lash, directions, settings.lash_memory, strict=True
        )
    ]
    moving = (segment.speed for segment in travel.journey.segments if any(segment.displacement))
    cap = cap_of(
        settings, next(moving, settings.speed), settings.feed_permille, sum(map(bool, taken))
    )
    return straight_s(settings, cap, max(taken))


def judge_duration(travel: Travel) -> None:
    """Undisturbed, as long as the ledger says; of contours the bounds of MN4-CC-09."""
    journey, settings = travel.journey, travel.journey.settings
    if travel.pauses or len(travel.feeds) > 1:
        return
    taken = (travel.end_ns - journey.start_ns) / S - lash_s(travel)
    if journey.turn is not None:
        cap = cap_of(settings, settings.speed, settings.feed_permille, 1)
        ticks, room = arc_ticks(journey.turn)
        ticks = max(ticks, abs(journey.turn.traverse))
        assert abs(taken * cap - ticks) <= room, ("an arc of other ticks", taken * cap, ticks)
        return
    alone, fastest = 0.0, 0.0
    for way, speed in journey.segments:
        steps = max(map(abs, way))
        cap = cap_of(settings, speed, settings.feed_permille, sum(map(bool, way)))
        alone += straight_s(settings, cap, steps)
        fastest += steps / cap
    near = 10 / S + 1e-9 * alone
    assert taken <= alone + near, ("slower than move by move", taken, alone)
    assert taken >= fastest - near, ("faster than its speeds", taken, fastest)
    if journey.kind == "move":
        assert abs(taken - alone) <= near, ("not as long as reckoned", taken, alone)


# ---- arcs ----


def sweep_of(turn: Turn) -> float:
    """The angle from start to end, turns included, positive clockwise (ledger §5.3, §5.4)."""
    x, y = -turn.center[0], -turn.center[1]
    goal_x, goal_y = turn.destination[0] + x, turn.destination[1] + y
    if x * goal_y == y * goal_x and x * goal_x + y * goal_y > 0:
        last = tau
    else:
        last = (atan2(y, x) - atan2(goal_y, goal_x)) % tau
        last = last if turn.is_clockwise else tau - last
    return (last + tau * turn.turns) * (1 if turn.is_clockwise else -1)


def arc_ticks(turn: Turn) -> tuple[float, float]:
    """(steps of the axis that is dominant at each moment, what rounding may change of them)."""
    radius, sweep = hypot(*turn.center), sweep_of(turn)
    begin = atan2(-turn.center[1], -turn.center[0])

    def way(angle: float) -> float:
        """∫ max(|sin|, |cos|) from 0 on: over each quarter from a diagonal on it is √2."""
        quarters, inner = divmod(angle + pi / 4, pi / 2)
        return quarters * sqrt(2) + sin(inner - pi / 4) + sin(pi / 4)

    ticks = radius * abs(way(begin - sweep) - way(begin))
    return ticks, 5 + abs(sweep) / (pi / 4)


def points_of(travel: Travel, turn: Turn) -> Iterator[tuple[int, int, int, int]]:
    """(time, x, y, z) from the start on, at each instant with a step."""
    plane = turn.plane
    steps = [
        (step.at_ns, place, step.direction)
        for place, axis in enumerate(plane)
        for step in travel.recorder.steps[axis]
        if step.is_commanded
    ]
    at, now_ns = [0, 0, 0], travel.journey.start_ns
    for at_ns, place, direction in sorted(steps):
        if at_ns != now_ns:
            yield now_ns, at[0], at[1], at[2]
            now_ns = at_ns
        at[place] += direction
    yield now_ns, at[0], at[1], at[2]


def judge_arc(travel: Travel, turn: Turn) -> None:
    """On the circle, the right way round, no axis too fast, the traverse by the angle."""
    _judge_ticks(travel, turn)
    x, y = turn.center
    radius, other = hypot(x, y), hypot(turn.destination[0] - x, turn.destination[1] - y)
    tolerance = 1.5 + abs(radius - other) + NEAR
    sweep = sweep_of(turn)
    room = 1 + abs(turn.traverse) * 2.5 / radius / abs(sweep)
    swept, last = 0.0, atan2(-y, -x)
    for _, at_x, at_y, at_z in points_of(travel, turn):
        away = abs(hypot(at_x - x, at_y - y) - radius)
        assert away <= tolerance, ("beside the circle", away, tolerance)
        angle = atan2(at_y - y, at_x - x)
        swept += (last - angle + pi) % tau - pi
        last = angle
        expected = turn.traverse * swept / sweep
        assert abs(at_z - expected) <= room, ("a traverse not by the angle", at_z, expected)
    assert abs(swept - sweep) < 1e-6, ("another angle", swept, sweep)


def _judge_ticks(travel: Travel, turn: Turn) -> None:
    """No axis makes two steps within a tick (MN4-ARC-04), also where the pot is turned."""
    settings = travel.journey.settings
    for axis in turn.plane:
        uneven = _unevenness(turn, is_traverse=axis == turn.plane.z)
        steps = [step for step in travel.recorder.steps[axis] if step.is_commanded]
        for before, after in pairwise(steps):
            fastest = max(
                cap_of(settings, settings.speed, permille, 1)
                for permille in _feeds_within(travel, before, after)
            )
            least_ns = S / fastest / uneven - ROUNDING_NS
            assert after.at_ns - before.at_ns >= least_ns, ("two steps in a tick", fastest)


def _unevenness(turn: Turn, *, is_traverse: bool) -> float:
    """How much faster than V an axis of a helix may be at a place."""
    radius, sweep, steps = hypot(*turn.center), abs(sweep_of(turn)), abs(turn.traverse)
    ticks, _ = arc_ticks(turn)
    is_led = steps > max(0, ticks - 5)
    share = 0.0
    if is_traverse and steps <= ticks + 5:
        share = steps * sqrt(2) / (sweep * radius)
    elif not is_traverse and is_led:
        share = radius * sweep / steps
    return max(1.0, share * (1 + 2 / radius + 3 / ticks) if share else 1.0)


def _feeds_within(travel: Travel, before: MotorStep, after: MotorStep) -> Iterator[int]:
    feeds: Sequence[tuple[int, int]] = [*travel.feeds, (after.at_ns + 1, 0)]
    for (from_ns, permille), (until_ns, _) in pairwise(feeds):
        if from_ns <= after.at_ns and until_ns >= before.at_ns:
            yield permille


# ---- long moves ----


def judge_long(journey: Journey) -> None:
    """Up to 2 147 483 647 steps: the end, the duration, and speeds at a few places."""
    travel = travelled(journey, is_recorded=False)
    motion, total = travel.recorder.motion, journey.total
    assert motion.position_at(travel.end_ns) == total, "it ends elsewhere"
    other = travelled(journey.mirrored(), is_recorded=False)
    assert other.end_ns == travel.end_ns, "the mirrored journey takes another time"
    major = major_of(total)
    steps = abs(total[major])
    if not steps:
        return
    settings = journey.settings
    axes = sum(map(bool, total))
    first = travel.plans[0]
    cap = cap_of(settings, settings.speed, settings.feed_permille, axes)
    rng = Random(steps)
    for n in (rng.randint(1, steps) for _ in range(6)):
        _judge_place(first, major, n, total)
        times = [first.step_time_ns(major, m) for m in (n, n + 1) if m <= steps]
        gaps = [b - a for a, b in pairwise(times) if a is not None and b is not None]
        assert all(gap >= floor(S / cap) - ROUNDING_NS for gap in gaps), ("too fast", gaps)
    if not any(settings.lash):
        reckoned = straight_s(settings, cap, steps)
        taken = (end(first) - journey.start_ns) / S
        near = 10 / S + 1e-9 * reckoned
        assert abs(taken - reckoned) <= near, ("not as long as reckoned", taken, reckoned)


def _judge_place(motion: VectorMotion, major: int, n: int, total: Four) -> None:
    """At the time of a step it has been made, a nanosecond before it has not, all on the chord."""
    at_ns = motion.step_time_ns(major, n)
    assert at_ns is not None, "a step that never comes"
    place, before = motion.position_at(at_ns), motion.position_at(at_ns - 1)
    assert abs(place[major]) == n > abs(before[major]), "a step at another time"
    for axis in range(4):
        chord = total[axis] * place[major] / total[major]
        assert abs(place[axis] - chord) <= 1 + 1e-6 * n / abs(total[major]), "off the chord"
