"""What may be true of the axes of one board, for the travel guard: where each is and may go, and
where its counters say that it is."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeVar

from axistwin_conformance.families.mn400.planner.vector import AXES, Window

STILL: Final = (0, 0)
MOST_ALTERNATIVES: Final = 8
TURN: Final = 1 << 32  # of a counter
Box = tuple[Window, ...]  # of all axes
Value = TypeVar("Value")


def join(*windows: Window) -> Window:
    """The smallest window around all of them."""
    return min(low for low, _ in windows), max(high for _, high in windows)


def joined_boxes(*boxes: Box) -> Box:
    """The smallest box around all of them."""
    return tuple(join(*row) for row in zip(*boxes, strict=True))


def alternatives(*known: tuple[Box, ...]) -> tuple[Box, ...]:
    """One thing or another; where there are too many, all that lies between them."""
    found = tuple(dict.fromkeys(box for boxes in known for box in boxes))
    return found if len(found) <= MOST_ALTERNATIVES else (joined_boxes(*found),)


def shift(window: Window, by: Window) -> Window:
    """Add two windows."""
    return window[0] + by[0], window[1] + by[1]


def shared(one: Window, other: Window) -> Window | None:
    """What is within both windows; None: nothing."""
    low, high = max(one[0], other[0]), min(one[1], other[1])
    return (low, high) if low <= high else None


@dataclass(frozen=True, slots=True)
class BoardReach:
    """Places are steps of each axis from where the run found it.

    `reach`: where it is or may still go.  `tip`: where the last motion asked for ends.  `offsets`:
    what may have to be added to the counters, one thing or another.  `motions`: how many may be
    under way or waiting.
    `slack`: steps of backlash compensation, which no counter tells; `slack_reach`: all that it may
    have been since the axes were at rest; `memory`: the direction that the board remembers.
    `is_absolute`, `plane` (motors from 0), `speed`, `end_speed`, `jog_speed`, `program`,
    `configuration`: as they were set; None: unknown.  `entry`: the command whose entry is open.
    `lines`: of that entry.  `holds`: motion may be kept until it is released.  `is_jogging`: in jog
    mode; `jogs_since_ns`: since when a jog input may have been on.  `begun_by`: what asked for the
    last motion.  `seen`: the counters read last, if nothing was asked since.
    """

    reach: Box = (STILL,) * AXES
    tip: Box = (STILL,) * AXES
    offsets: tuple[Box, ...] = ((STILL,) * AXES,)
    motions: int = 0
    slack: Box = (STILL,) * AXES
    slack_reach: Box = (STILL,) * AXES
    memory: tuple[int | None, ...] = (None,) * AXES
    lash: tuple[int, ...] = (0,) * AXES
    is_absolute: bool | None = None
    plane: tuple[int, int, int] | None = None
    speed: int | None = None
    end_speed: int | None = None
    jog_speed: int | None = None
    entry: str = ""
    lines: tuple[str, ...] = ()
    program: tuple[str, ...] | None = None
    configuration: tuple[str, ...] | None = None
    holds: bool = False
    is_jogging: bool = False
    jogs_since_ns: int | None = None
    begun_by: str = "M"
    seen: tuple[int, ...] | None = None

    @property
    def offset(self) -> Box:
        """All that may have to be added to the counters."""
        return joined_boxes(*self.offsets)

    @property
    def far(self) -> Box:
        """The reach, wider by what backlash may have added."""
        return tuple(map(shift, self.reach, self.slack_reach))

    @property
    def place(self) -> tuple[int, ...] | None:
        """Where the axes are; None: not known exactly, or they may move."""
        is_known = not self.motions and all(low == high for low, high in self.reach)
        return tuple(low for low, _ in self.reach) if is_known else None

    @property
    def jog_rate(self) -> int:
        """Steps per second at which a jog input may be moving an axis; 0: none is."""
        return (self.jog_speed or 0) if self.jogs_since_ns is not None else 0

    def grown(self, now_ns: int) -> BoardReach:
        """The same with jogging accounted for up to now."""
        if self.jogs_since_ns is None:
            return self
        far = self.jog_rate * max(0, now_ns - self.jogs_since_ns) // 1_000_000_000 + 1
        reach = tuple((low - far, high + far) for low, high in self.reach)
        return replace(self, reach=reach, tip=reach, jogs_since_ns=now_ns)

    def cut_short(self) -> BoardReach:
        """The same if what is under way may end, or has ended, anywhere on its way."""
        return replace(self, tip=self.reach)

    def finished(self) -> BoardReach:
        """The same behind an N with nothing left: a lone move, that nothing has ended or kept, is
        over (MN4-CMD-N-02)."""
        is_alone = self.motions == 1 and self.begun_by == "M" and not (self.holds or self.entry)
        return replace(self, reach=self.tip, motions=0) if is_alone else self

    def sent_to(
        self, tip: Box, letter: str, passed: Box | None = None, *, is_kept: bool = False
    ) -> BoardReach:
        """The same with one more motion that ends in that box, and stays within `passed`; one of
        more segments of a contour.  `is_kept`: it is made, too, where what it waits for was cut
        short."""
        way = joined_boxes(tip, *([passed] if passed is not None else []))
        if is_kept and self.motions > (self.entry == "("):
            way = tuple(map(_from_anywhere, way, self.tip, self.reach))
        reach = joined_boxes(self.reach, tip, way)
        rows = [self._turned(axis, tip[axis], passed) for axis in range(AXES)]
        slack = tuple(row[0] for row in rows)
        return replace(
            self,
            reach=reach,
            tip=tip,
            slack=slack,
            slack_reach=joined_boxes(self.slack_reach, slack),
            memory=tuple(row[1] for row in rows),
            motions=self.motions + (self.entry != "("),
            begun_by=self.entry or letter,
        )

    def _turned(self, axis: int, tip: Window, passed: Box | None) -> tuple[Window, int | None]:
        """The slack of an axis, and the direction that it remembers, once it has gone there.  A
        contour is compensated before its first segment only (see `entered`), an arc by a direction
        that nobody knows here."""
        before, slack, lash = self.tip[axis], self.slack[axis], self.lash[axis]
        memory = self.memory[axis]
        if self.entry or (before == tip and passed is None and tip[0] == tip[1]):
            return slack, memory
        sign = 1 if tip[0] > before[1] else -1 if tip[1] < before[0] else 0
        if not sign or passed is not None:
            return (slack[0] - lash, slack[1] + lash), None
        turned = shift(slack, (sign * lash, sign * lash))
        if memory is None:
            turned = join(slack, turned)
        return (slack if memory == sign else turned), sign

    def turned(self, axes: Collection[int]) -> BoardReach:
        """The same if these axes may have turned, or have not."""
        lash = tuple(by if axis in axes else 0 for axis, by in enumerate(self.lash))
        slack = tuple(map(_wider, self.slack, lash))
        memory = tuple(None if axis in axes else was for axis, was in enumerate(self.memory))
        slack_reach = joined_boxes(self.slack_reach, slack)
        return replace(self, slack=slack, slack_reach=slack_reach, memory=memory)

    def counting(self, before: BoardReach) -> BoardReach:
        """The same if what has been made up for backlash since is in the counters."""
        rows = zip(self.slack, before.slack, strict=True)
        turns = [(new[0] - old[0], new[1] - old[1]) for new, old in rows]
        return replace(
            self,
            reach=joined_boxes(self.reach, tuple(map(shift, self.reach, turns))),
            tip=tuple(map(shift, self.tip, turns)),
            slack=before.slack,
            slack_reach=before.slack_reach,
        )

    def entered(self, letter: str) -> BoardReach:
        """The same with an entry open; a contour is one motion, and may turn every axis."""
        entered = replace(self, entry=letter, lines=())
        if letter == "(":
            entered = replace(entered, motions=self.motions + 1, begun_by="(")
            return entered.turned(range(AXES))
        if letter == "Z":
            return replace(entered, program=None)
        return replace(entered, configuration=None)

    def joined(self, other: BoardReach) -> BoardReach:
        """Either of two, the second of them later; nobody knows which."""
        return replace(
            other,
            reach=joined_boxes(self.reach, other.reach),
            tip=joined_boxes(self.tip, other.tip),
            offsets=alternatives(self.offsets, other.offsets),
            motions=max(self.motions, other.motions),
            slack=joined_boxes(self.slack, other.slack),
            slack_reach=joined_boxes(self.slack_reach, other.slack_reach),
            memory=tuple(map(_same, self.memory, other.memory)),
            lash=tuple(map(max, self.lash, other.lash)),
            is_absolute=_same(self.is_absolute, other.is_absolute),
            plane=_same(self.plane, other.plane),
            speed=_larger(self.speed, other.speed),
            end_speed=_larger(self.end_speed, other.end_speed),
            jog_speed=_larger(self.jog_speed, other.jog_speed),
            program=_same(self.program, other.program),
            configuration=_same(self.configuration, other.configuration),
            holds=self.holds or other.holds,
            is_jogging=self.is_jogging or other.is_jogging,
            jogs_since_ns=self.jogs_since_ns
            if other.jogs_since_ns is None
            else other.jogs_since_ns,
            seen=None,
        )


def planes(plane: tuple[int, int, int] | None) -> Sequence[tuple[int, int, int]]:
    """The planes that may be meant, by their motors."""
    if plane is not None:
        return (plane,)
    return [(x, y, z) for x in range(AXES) for y in range(AXES) for z in range(AXES) if x != y]


def _place(offset: Window, counter: int, reach: Window) -> Window:
    """Where an axis of that counter is, which goes round at 32 bits (MN4-MOT-06): of all places the
    nearest to where it may be."""
    places = [shift(offset, (counter + round_, counter + round_)) for round_ in (0, TURN, -TURN)]
    return min(places, key=lambda place: max(0, place[0] - reach[1], reach[0] - place[1]))


def axes_elsewhere(
    offset: Box, counters: Sequence[int], reach: Box, swing: int
) -> list[tuple[int, Window]]:
    """The axes that would be outside of their reach by more than that, and where."""
    rows = enumerate(zip(offset, counters, reach, strict=True))
    found = ((axis, _place(*row), row[2]) for axis, row in rows)
    return [
        (axis, place)
        for axis, place, (low, high) in found
        if shared(place, (low - swing, high + swing)) is None
    ]


def places_of(offset: Box, counters: Sequence[int], reach: Box) -> Box:
    """Where the axes of these counters are, none of which is elsewhere."""
    rows = zip(offset, counters, reach, strict=True)
    return tuple(shared(_place(*row), row[2]) or row[2] for row in rows)


def _from_anywhere(way: Window, tip: Window, reach: Window) -> Window:
    """A way that begins at the tip, or as far on from any place of the reach."""
    return way[0] + reach[0] - tip[1], way[1] + reach[1] - tip[0]


def _wider(window: Window, by: int) -> Window:
    return window[0] - by, window[1] + by


def _same(one: Value | None, other: Value | None) -> Value | None:
    return one if one == other else None


def _larger(one: int | None, other: int | None) -> int | None:
    return None if one is None or other is None else max(one, other)
