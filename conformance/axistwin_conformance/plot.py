"""Measured against predicted motion as inline SVG: position over time, and the deviation.

    position  |        ..--o--''          the band is a few increments wide, it looks a line;
              |   .o--''
              |-o'                        below, everything is drawn against the middle of the band:
    deviation | ------------------------  there its width shows, and by how much a reading is off
              |   o      o      o
              +-------------------------> ms

Colours come from the page: classes `band`, `reading`, `reading off`, `grid`, `axis`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from markupsafe import Markup, escape

WIDTH: Final = 560
LEFT, RIGHT, TOP = 62, 12, 10
HEIGHT_POSITION, GAP, HEIGHT_DEVIATION, BOTTOM = 150, 20, 64, 36
HEIGHT: Final = TOP + HEIGHT_POSITION + GAP + HEIGHT_DEVIATION + BOTTOM
BAND_POINTS: Final = 48  # drawn of the predicted band, at most


@dataclass(frozen=True, slots=True)
class Scale:
    """Maps [low, high] of a value to [start, end] of the drawing."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> str:
        """The coordinate, short."""
        share = (value - self.low) / (self.high - self.low)
        return f"{self.start + share * (self.end - self.start):.1f}".removesuffix(".0")


def is_inside(motion: Mapping[str, Any]) -> bool:
    """True if no reading lies outside the band it was judged by."""
    return not any(off for _, _, _, off in _readings(motion))


def plot(motion: Mapping[str, Any]) -> Markup:
    """Draw one motion of a report; it has one reading and one point of the band at least."""
    readings = _readings(motion)
    band = _thinned(motion["predicted"], {time_ns for time_ns, *_ in readings})
    origin_ns = min(band[0][0], readings[0][0])
    times = [(point[0] - origin_ns) / 1e6 for point in (*band, *readings)]
    places = [place for _, low, high in band for place in (low, high)]
    across = Scale(0, max(times) or 1, LEFT, WIDTH - RIGHT)
    floor = TOP + HEIGHT_POSITION
    up = _scale([*places, *(place for _, place, _, _ in readings)], floor, TOP)
    middles = [(time_ns, low + high) for time_ns, low, high in band]
    wide = [((high - low) / 2, (low - high) / 2) for _, low, high in band]
    offs = [place - middle for _, place, middle, _ in readings]
    bottom = floor + GAP + HEIGHT_DEVIATION
    aside = _scale([one for pair in wide for one in pair] + offs, bottom, floor + GAP)

    def at(time_ns: int) -> str:
        return across((time_ns - origin_ns) / 1e6)

    assert len(middles) == len(band)
    parts = [
        *_grid(up, across, floor, "increments"),
        *_grid(aside, across, bottom, "deviation"),
        *_time_axis(across, bottom),
        _polygon(
            [(at(time), up(high)) for time, _, high in band],
            [(at(time), up(low)) for time, low, _ in band],
        ),
        _polygon(
            [(at(one[0]), aside(top)) for one, (top, _) in zip(band, wide, strict=True)],
            [(at(one[0]), aside(low)) for one, (_, low) in zip(band, wide, strict=True)],
        ),
    ]
    for (time_ns, place, _, is_off), off in zip(readings, offs, strict=True):
        name = "reading off" if is_off else "reading"
        for y in (up(place), aside(off)):
            parts.append(f'<circle class="{name}" cx="{at(time_ns)}" cy="{y}" r="3.5"/>')
    words = f"{motion['name']}: {_count(readings)}"
    return Markup(  # numbers of ours, and one word, which is escaped
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(words)}">'
        + "".join(parts)
        + "</svg>"
    )


def _count(readings: Sequence[tuple[int, int, float, bool]]) -> str:
    outside = sum(is_off for *_, is_off in readings)
    return f"{len(readings)} readings, {outside or 'none'} outside the predicted band"


def _readings(motion: Mapping[str, Any]) -> list[tuple[int, int, float, bool]]:
    """Each reading with the middle of its band, and whether it lies outside."""
    edges: dict[int, tuple[int, int]] = {}
    for time_ns, low, high in motion["predicted"]:
        edges[time_ns] = (low, high)
    found = []
    for time_ns, place in motion["measured"]:
        low, high = edges.get(time_ns) or _between(motion["predicted"], time_ns)
        found.append((time_ns, place, (low + high) / 2, not low <= place <= high))
    return found


def _between(band: Sequence[Sequence[int]], time_ns: int) -> tuple[int, int]:
    """The widest band of the two points around a time that has none of its own."""
    before = max((one for one in band if one[0] <= time_ns), default=band[0], key=_time)
    after = min((one for one in band if one[0] >= time_ns), default=band[-1], key=_time)
    return min(before[1], after[1]), max(before[2], after[2])


def _time(point: Sequence[int]) -> int:
    return point[0]


def _thinned(band: Sequence[Sequence[int]], kept: set[int]) -> list[tuple[int, int, int]]:
    """Not more points than can be told apart, those of readings among them."""
    step = max(1, math.ceil(len(band) / BAND_POINTS))
    return [
        (one[0], one[1], one[2])
        for number, one in enumerate(band)
        if number % step == 0 or one[0] in kept or number == len(band) - 1
    ]


def _scale(values: Sequence[float], start: float, end: float) -> Scale:
    low, high = min(values), max(values)
    margin = max((high - low) * 0.08, 1)
    return Scale(low - margin, high + margin, start, end)


def _polygon(upper: list[tuple[str, str]], lower: list[tuple[str, str]]) -> str:
    points = " ".join(f"{x},{y}" for x, y in [*upper, *reversed(lower)])
    return f'<polygon class="band" points="{points}"/>'


def _grid(vertical: Scale, across: Scale, floor: float, title: str) -> Iterable[str]:
    x1, x2 = across(across.low), across(across.high)
    for tick in ticks(vertical.low, vertical.high, 4 if vertical.start - vertical.end > 100 else 2):
        y = vertical(tick)
        yield f'<path class="grid" d="M{x1} {y}H{x2}"/>'
        yield f'<text class="y" x="{LEFT - 6}" y="{y}" dy=".35em">{_number(tick)}</text>'
    middle = (vertical.start + vertical.end) / 2
    yield f'<text class="title" transform="translate(12 {middle:.0f}) rotate(-90)">{title}</text>'
    yield f'<path class="axis" d="M{x1} {floor:.0f}H{x2}"/>'


def _time_axis(across: Scale, floor: float) -> Iterable[str]:
    for tick in ticks(across.low, across.high, 6):
        x = across(tick)
        yield f'<path class="axis" d="M{x} {floor:.0f}v4"/>'
        yield f'<text class="x" x="{x}" y="{floor + 16:.0f}">{_number(tick)}</text>'
    x, y = across((across.low + across.high) / 2), f"{floor + 31:.0f}"
    yield f'<text class="title" x="{x}" y="{y}">ms since the start of the motion</text>'


def ticks(low: float, high: float, about: int) -> list[float]:
    """Round numbers inside [low, high], `about` that many, 1, 2 or 5 apart by a power of ten."""
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(unit * power for unit in (1, 2, 5, 10) if unit * power >= raw)
    first = math.ceil(low / step)
    return [number * step for number in range(first, math.floor(high / step) + 1)]


def _number(value: float) -> str:
    return f"{value:.6g}".replace("-", "\u2212")
