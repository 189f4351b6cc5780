"""What is drawn: where the axes were at some instants, and how fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from axistwin.errors import UsageError, nearest

MARGIN = 0.02
"""Of the time in motion, shown before and behind it."""


@dataclass(frozen=True, slots=True)
class MotionTrack:
    """Positions and rates of all axes, one row for each instant.

    times_s: rising.  rates: units per second.  is_read_out: the device was asked, so nothing is
    known between the instants.
    """

    names: tuple[str, ...]
    unit: str
    times_s: list[float]
    positions: list[tuple[int, ...]]
    rates: list[tuple[float, ...]]
    is_read_out: bool = False

    def trimmed(self) -> MotionTrack:
        """The part with motion, a margin around it, counted from its beginning.

        Raises UsageError if nothing moves.
        """
        moving = [
            index
            for index, (before, after) in enumerate(
                zip(self.positions, self.positions[1:], strict=False)
            )
            if before != after or any(self.rates[index])
        ]
        if not moving:
            raise UsageError("nothing has moved, so there is nothing to draw; see the replies")
        first, last = moving[0], moving[-1] + 1
        begin_s, end_s = self.times_s[first], self.times_s[last]
        margin_s = MARGIN * (end_s - begin_s)
        kept = [
            index
            for index, time_s in enumerate(self.times_s)
            if begin_s - margin_s <= time_s <= end_s + margin_s
        ]
        chosen = slice(kept[0], kept[-1] + 1)
        return MotionTrack(
            self.names,
            self.unit,
            [time_s - begin_s for time_s in self.times_s[chosen]],
            self.positions[chosen],
            self.rates[chosen],
            self.is_read_out,
        )

    @property
    def span_s(self) -> float:
        """From the first step to the last, of a trimmed track."""
        changes = zip(self.positions, self.positions[1:], self.times_s[1:], strict=False)
        return max((time_s for before, after, time_s in changes if before != after), default=0.0)

    @property
    def moved(self) -> list[str]:
        """The axes that are not always at the same place."""
        return [name for axis, name in enumerate(self.names) if len(set(self.places(axis))) > 1]

    def axis(self, name: str) -> int:
        """The place of the axis with that name, in any case.  Raises UsageError."""
        for axis, known in enumerate(self.names):
            if known.lower() == name.strip().lower():
                return axis
        raise UsageError(f"axis {name!r}: {nearest(name, self.names)}")

    def places(self, axis: int) -> list[int]:
        """Positions of one axis."""
        return [row[axis] for row in self.positions]

    def speeds(self, axis: int) -> list[float]:
        """Rates of one axis."""
        return [row[axis] for row in self.rates]


def chosen_axes(track: MotionTrack, text: str | None) -> list[int]:
    """The axes that ``M1,M3`` names, else those that have moved.  Raises UsageError."""
    names = track.moved if text is None else text.split(",")
    return [track.axis(name) for name in names]


def chosen_planes(
    track: MotionTrack, text: str | None, axes: Sequence[int]
) -> list[tuple[int, int]]:
    """The planes that ``M1-M3,M1-M2`` names, else those of the first three of ``axes``.

    Raises UsageError.
    """
    if text is None:
        return [(first, second) for first in axes[:3] for second in axes[:3] if first < second]
    planes = []
    for plane in text.split(","):
        first, dash, second = plane.partition("-")
        if not dash:
            raise UsageError(f"plane {plane!r}: write two axes, such as M1-M3")
        planes.append((track.axis(first), track.axis(second)))
    return planes
