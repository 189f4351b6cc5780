"""Journeys of an MN400: a drawn motion, what is done to it on its way, and every step it made.

A journey is drawn from a seed and a number, and with both it is the same again.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from random import Random
from typing import Literal, NamedTuple, TypeAlias

from mn400_motions import Recorder, end, negated, rules

from axistwin.devices.mn400.motion import (
    ContourSegment,
    MoveSettings,
    Plane,
    SpeedProfile,
    VectorMotion,
    contour,
    helix,
)

Four: TypeAlias = tuple[int, int, int, int]
Kind: TypeAlias = Literal["move", "long", "contour", "arc", "helix"]
KINDS: tuple[Kind, ...] = ("move", "long", "contour", "arc", "helix")
_WEIGHTS = (30, 3, 37, 15, 15)
RADIUS_MIN = 5
"""A smaller circle is all corners: its points do not tell which way round it goes."""


class Change(NamedTuple):
    """What is done when ``share`` per mille of what is left in time is over.

    pause: for ``value`` ns.  feed: the pot is turned to ``value`` per mille.  again: the pot is
    turned away and back within one instant.
    """

    share: int
    what: Literal["pause", "feed", "again"]
    value: int


class Turn(NamedTuple):
    """What A and + are told."""

    plane: Plane
    center: tuple[int, int]
    destination: tuple[int, int]
    is_clockwise: bool
    traverse: int
    turns: int


@dataclass(frozen=True)
class Journey:
    """One motion and its changes; of ``segments`` and ``turn`` it has one."""

    kind: Kind
    start_ns: int
    settings: MoveSettings
    segments: tuple[ContourSegment, ...]
    margin: int
    turn: Turn | None
    changes: tuple[Change, ...]

    @property
    def total(self) -> Four:
        """Where it is to end, by the command alone."""
        moved = [0, 0, 0, 0]
        if self.turn is None:
            for segment in self.segments:
                moved = [a + b for a, b in zip(moved, segment.displacement, strict=True)]
        else:
            x, y, z = self.turn.plane
            moved[x], moved[y] = self.turn.destination
            moved[z] = self.turn.traverse
        first, second, third, fourth = moved
        return first, second, third, fourth

    def motion(self) -> VectorMotion:
        """As it is planned at first."""
        if self.turn is None:
            return contour(self.start_ns, self.settings, self.segments, self.margin)
        plane, center, destination, is_clockwise, traverse, turns = self.turn
        return helix(
            self.start_ns,
            self.settings,
            plane,
            center,
            destination,
            is_clockwise,
            traverse,
            turns,
        )

    def mirrored(self) -> "Journey":
        """All axes the other way, the backlash too."""
        turn = self.turn
        if turn is not None:
            turn = turn._replace(
                center=(-turn.center[0], -turn.center[1]),
                destination=(-turn.destination[0], -turn.destination[1]),
                traverse=-turn.traverse,
            )
        return replace(
            self,
            settings=replace(self.settings, lash_memory=negated(self.settings.lash_memory)),
            segments=tuple(
                ContourSegment(negated(one.displacement), one.speed) for one in self.segments
            ),
            turn=turn,
        )


@dataclass
class Travel:
    """What came of a journey: every plan, every step, each pause and each turn of the pot."""

    journey: Journey
    recorder: Recorder
    plans: list[VectorMotion]
    pauses: list[tuple[int, int]] = field(default_factory=list)
    feeds: list[tuple[int, int]] = field(default_factory=list)
    """(from when on, per mille)."""

    @property
    def end_ns(self) -> int:
        """When it was over."""
        return end(self.recorder.motion)

    def change(self, now_ns: int, act: Callable[[VectorMotion], VectorMotion]) -> None:
        """Do something to the motion; where it is at that instant stays the same."""
        before = self.recorder.until(now_ns)
        after = self.recorder.motion = act(before)
        self.plans.append(after)
        assert after.position_at(now_ns) == before.position_at(now_ns), "a change moves the axes"
        assert after.remaining_at(now_ns) == before.remaining_at(now_ns), "a change alters the rest"


def travelled(journey: Journey, *, is_recorded: bool = True) -> Travel:
    """Run a journey to its end; not ``is_recorded``: without its steps, for long ones."""
    motion = journey.motion()
    recorder = Recorder(motion, is_recorded=is_recorded)
    travel = Travel(journey, recorder, [motion])
    travel.feeds.append((motion.since_ns, journey.settings.feed_permille))
    for change in journey.changes:
        until_ns = recorder.motion.end_ns
        assert until_ns is not None, "a motion that was resumed never ends"
        if until_ns <= recorder.since_ns:
            break
        now_ns = max(recorder.since_ns, recorder.motion.since_ns)
        _perform(travel, now_ns + (until_ns - now_ns) * change.share // 1000, change)
    recorder.until(max(travel.end_ns, recorder.since_ns))
    return travel


def _perform(travel: Travel, now_ns: int, change: Change) -> None:
    """Do to the motion what the change says."""
    if change.what == "pause":
        travel.change(now_ns, lambda motion: motion.pause(now_ns))
        resumed_ns = now_ns + change.value
        travel.change(resumed_ns, lambda motion: motion.resume(resumed_ns))
        travel.pauses.append((now_ns, resumed_ns))
    elif change.what == "feed":
        travel.change(now_ns, lambda motion: motion.override(now_ns, change.value))
        travel.feeds.append((now_ns, change.value))
    else:
        _plan_again(travel, now_ns)


def _plan_again(travel: Travel, now_ns: int) -> None:
    """Turn the pot away and back: the new plan is what was left of the old one."""
    before = travel.recorder.motion
    permille = before.feed_permille
    away = permille - 1 if permille else 1
    travel.change(now_ns, lambda motion: motion.override(now_ns, away).override(now_ns, permille))
    after = travel.recorder.motion
    assert abs(end(after) - end(before)) <= 20 + (end(before) - before.since_ns) // 10**9, (
        "planning anew changes the end",
        end(after) - end(before),
    )
    middle_ns = (now_ns + end(before)) // 2
    for here, there in zip(
        after.position_at(middle_ns), before.position_at(middle_ns), strict=True
    ):
        assert abs(here - there) <= 1, "planning anew changes the way"


# ---- drawing ----


def drawn(seed: int, number: int) -> Journey:
    """The journey with that number."""
    rng = Random(f"{seed}/{number}")
    kind = rng.choices(KINDS, _WEIGHTS)[0]
    settings = _settings(rng)
    segments: tuple[ContourSegment, ...] = ()
    turn = None
    if kind in ("arc", "helix"):
        turn = drawn_turn(rng, kind)
    elif kind == "contour":
        segments = drawn_segments(rng)
    else:
        reach = 2**31 - 1 if kind == "long" else rng.choice((5, 60, 400))
        segments = (ContourSegment(_vector(rng, reach), settings.speed),)
    margin = rng.choice((0, 1, 20, 50, 200, 1000)) if kind == "contour" else 0
    changes = tuple(_change(rng) for _ in range(rng.choice((0, 0, 1, 1, 2, 4))))
    return Journey(kind, rng.randrange(10**12), settings, segments, margin, turn, changes)


def _settings(rng: Random) -> MoveSettings:
    start = rng.randrange(2, rng.choice((50, 1000, 3000)))
    profile = SpeedProfile(
        start,
        start + rng.randrange(rng.choice((1, 2000, 20_000, 97_000))),
        rng.randrange(1, rng.choice((300, 20_000, 300_000))),
    )
    has_lash = rng.random() < 0.2
    return MoveSettings(
        rules(
            dda_phase=rng.choice(("half", "half", "zero", "full")),
            accel_scale=rng.choice(("1.0", "1.0", "0.5")),
        ),
        profile,
        rng.randrange(2, rng.choice((1000, 6000, 100_001))),
        multiplex=rng.choice((1, 1, 2, 4)),
        lash=_four(rng.randrange(15) * has_lash for _ in range(4)),
        lash_memory=_four(rng.choice((1, -1)) for _ in range(4)),
        feed_permille=rng.choice((1000, 1000, 1000, 500)),
    )


def _four(values: Iterable[int]) -> Four:
    first, second, third, fourth = values
    return first, second, third, fourth


def _vector(rng: Random, reach: int) -> Four:
    return _four(
        rng.choice((0, rng.randint(-reach, reach), rng.randint(-reach, reach))) for _ in range(4)
    )


def drawn_segments(rng: Random) -> tuple[ContourSegment, ...]:
    """A few that go on much in one direction, with a corner or a reversal now and then."""
    reach, speed = rng.choice((8, 40, 120)), rng.randrange(2, 12_000)
    way = _vector(rng, reach)
    found = []
    for _ in range(rng.randint(1, 8)):
        if rng.random() < 0.2:
            way = _vector(rng, reach)
        if rng.random() < 0.3:
            speed = rng.randrange(2, 12_000)
        jitter = rng.choice((0, 1, reach // 8 + 1))
        step = _four(value + rng.randint(-jitter, jitter) * bool(value) for value in way)
        found.append(ContourSegment(step, speed))
    return tuple(found)


def drawn_turn(rng: Random, kind: Kind) -> Turn:
    """An arc whose ends are rounded, as a host does."""
    reach = rng.choice((12, 60, 150))
    while True:
        center = rng.randint(-reach, reach), rng.randint(-reach, reach)
        radius = (center[0] ** 2 + center[1] ** 2) ** 0.5
        if radius >= RADIUS_MIN:
            break
    is_full = rng.random() < 0.1
    goal = rng.randint(-reach, reach), rng.randint(-reach, reach)
    length = (goal[0] ** 2 + goal[1] ** 2) ** 0.5
    if is_full or not length:
        destination = (0, 0)
    else:
        destination = (
            round(center[0] + goal[0] * radius / length),
            round(center[1] + goal[1] * radius / length),
        )
    x, y, z = rng.sample(range(4), 3)
    is_helix = kind == "helix"
    return Turn(
        Plane(x, y, z),
        center,
        destination,
        rng.random() < 0.5,
        rng.randint(-400, 400) if is_helix else 0,
        rng.randrange(3) if is_helix else 0,
    )


def _change(rng: Random) -> Change:
    share = rng.choice((rng.randint(0, 1000), rng.randint(0, 100), rng.randint(900, 1000)))
    what = rng.choice(("pause", "pause", "feed", "again"))
    if what == "pause":
        return Change(share, "pause", rng.choice((0, 1000, rng.randrange(10**8), 10**10)))
    if what == "feed":
        return Change(share, "feed", rng.choice((0, 1, 300, 750, 999, 1000, 1000)))
    return Change(share, "again", 0)
