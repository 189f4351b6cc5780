"""Measured against predicted motion as inline SVG: position over time, and the deviation.

    position  |        ..--o--''          the band is a few increments wide, it looks a line;
              |   .o--''
              |-o'                        below, everything is drawn against the middle of the band:
    deviation | ------------------------  there its width shows, and by how much a reading is off
              |   o      o      o
              +-------------------------> ms

A path is one axis over another, on one scale; each reading lies in the box of both predictions:

    axis 3  |   []o[]
            | []
            +------------> axis 1

Colours come from the page: classes `band`, `reading`, `reading off`, `grid`, `axis`.  A report may
hold hundreds of these: one path for all that looks alike, relative coordinates, no point on a line
between its neighbours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from markupsafe import Markup, escape

WIDTH: Final = 560
LEFT, RIGHT, TOP = 62, 26, 10
HEIGHT_POSITION, GAP, HEIGHT_DEVIATION, BOTTOM = 150, 20, 64, 22
HEIGHT: Final = TOP + HEIGHT_POSITION + GAP + HEIGHT_DEVIATION + BOTTOM
BAND_POINTS: Final = 48  # drawn of the predicted band, at most
STRAIGHT: Final = 0.3  # closer than that to the line between its neighbours, a point adds nothing

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Scale:
    """Maps [low, high] of a value to [start, end] of the drawing."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        """The coordinate, to a tenth."""
        share = (value - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 1)


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

    def at(time_ns: int) -> float:
        return across((time_ns - origin_ns) / 1e6)

    assert len(middles) == len(band)
    parts = [
        *_axes(across, up, aside),
        _area(
            [(at(time), up(high)) for time, _, high in band],
            [(at(time), up(low)) for time, low, _ in band],
        ),
        _area(
            [(at(one[0]), aside(top)) for one, (top, _) in zip(band, wide, strict=True)],
            [(at(one[0]), aside(low)) for one, (_, low) in zip(band, wide, strict=True)],
        ),
        *_dots(
            [
                ((at(time_ns), y), is_off)
                for (time_ns, place, _, is_off), off in zip(readings, offs, strict=True)
                for y in (up(place), aside(off))
            ]
        ),
    ]
    words = f"{motion['name']}: {_count(readings)}"
    return Markup(  # numbers of ours, and one word, which is escaped
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(words)}">'
        + "".join(parts)
        + "</svg>"
    )


def is_on_path(path: Mapping[str, Any]) -> bool:
    """True if no reading of two axes lies outside of its box."""
    return all(_is_boxed(point) for point in path["points"])


def _is_boxed(point: Sequence[int]) -> bool:
    _, x, y, left, right, low, high = point
    return left <= x <= right and low <= y <= high


def plot_path(path: Mapping[str, Any]) -> Markup:
    """Draw one path of a report; it has one point at least."""
    points = path["points"]
    across, up = _square(
        [one for _, x, _, left, right, _, _ in points for one in (x, left, right)],
        [one for _, _, y, _, _, low, high in points for one in (y, low, high)],
    )
    boxes = "".join(
        f"M{_short(across(left))} {_short(up(high))}H{_short(across(right))}"
        f"V{_short(up(low))}H{_short(across(left))}z"
        for _, _, _, left, right, low, high in points
    )
    parts = [
        *_path_axes(across, up, path["axes"]),
        f'<path class="band" d="{boxes}"/>',
        *_dots([((across(one[1]), up(one[2])), not _is_boxed(one)) for one in points]),
    ]
    outside = sum(not _is_boxed(one) for one in points)
    words = f"{path['name']}: {len(points)} readings, {outside or 'none'} outside the predicted box"
    return Markup(  # numbers of ours, and words, which are escaped
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(words)}">'
        + "".join(parts)
        + "</svg>"
    )


def _square(xs: Sequence[float], ys: Sequence[float]) -> tuple[Scale, Scale]:
    """Scales of both axes, on which a step is as long either way."""
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM - GAP
    middles = [(min(one) + max(one)) / 2 for one in (xs, ys)]
    step = max((max(xs) - min(xs)) / wide, (max(ys) - min(ys)) / high, 2 / high) * 1.16
    half_x, half_y = step * wide / 2, step * high / 2
    return (
        Scale(middles[0] - half_x, middles[0] + half_x, LEFT, WIDTH - RIGHT),
        Scale(middles[1] - half_y, middles[1] + half_y, TOP + high, TOP),
    )


def _path_axes(across: Scale, up: Scale, names: Sequence[str]) -> list[str]:
    """Grid, axes, numbers and the names of both axes."""
    left, right, bottom = across.start, across.end, up.start
    axis, grid, labels = f"M{left:g} {bottom:g}H{right:g}", "", ""
    for tick in ticks(up.low, up.high, 5):
        y = _short(up(tick))
        grid += f"M{left:g} {y}H{right:g}"
        labels += f'<text class="y" x="{left - 6:g}" y="{y}">{_number(tick)}</text>'
    for tick in ticks(across.low, across.high, 6):
        x = _short(across(tick))
        axis += f"M{x} {bottom:g}v4"
        labels += f'<text class="x" x="{x}" y="{bottom + 16:g}">{_number(tick)}</text>'
    middle = (up.start + up.end) / 2
    labels += f'<text class="title" transform="translate(12 {middle:g})rotate(-90)">'
    labels += f"{escape(names[1])}</text>"
    labels += f'<text class="x" x="{(left + right) / 2:g}" y="{bottom + 32:g}">'
    labels += f"{escape(names[0])}</text>"
    return [f'<path class="grid" d="{grid}"/><path class="axis" d="{axis}"/>', labels]


def _count(readings: Sequence[tuple[int, int, float, bool]]) -> str:
    outside = sum(is_off for *_, is_off in readings)
    many = "1 reading" if len(readings) == 1 else f"{len(readings)} readings"
    return f"{many}, {outside or 'none'} outside the predicted band"


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


def _area(upper: list[Point], lower: list[Point]) -> str:
    """The band between two lines over the same times."""
    outline = [*_straightened(upper), *reversed(_straightened(lower))]
    return f'<path class="band" d="{_line(outline)}z"/>'


def _straightened(line: list[Point]) -> list[Point]:
    """The line without the points that lie on it anyway."""
    kept, since = line[:1], 0
    for number in range(1, len(line) - 1):
        between = line[since + 1 : number + 1]
        if any(_distance(one, line[since], line[number + 1]) > STRAIGHT for one in between):
            kept.append(line[number])
            since = number
    return kept + line[max(1, len(line) - 1) :]


def _distance(point: Point, first: Point, last: Point) -> float:
    """How far, upward or downward, a point is from the line through two others."""
    (x, y), (x1, y1), (x2, y2) = point, first, last
    return abs(y - (y1 + y2) / 2) if x1 == x2 else abs(y - y1 - (y2 - y1) * (x - x1) / (x2 - x1))


def _dots(places: Sequence[tuple[Point, bool]]) -> list[str]:
    """All readings inside, then, on top of them, those outside; a dot is a line of no length."""
    return [
        f'<path class="{name}" d="{"".join(f"M{_short(x)} {_short(y)}h0" for x, y in chosen)}"/>'
        for name, wanted in (("reading", False), ("reading off", True))
        if (chosen := [place for place, is_off in places if is_off is wanted])
    ]


def _axes(across: Scale, up: Scale, aside: Scale) -> list[str]:
    """Grid, axes, numbers and titles of both panels."""
    left, right, bottom = across.start, across.end, aside.start
    grid, labels = "", ""
    for scale, count in ((up, 4), (aside, 2)):
        for tick in ticks(scale.low, scale.high, count):
            y = _short(scale(tick))
            grid += f"M{left:g} {y}H{right:g}"
            labels += f'<text class="y" x="{left - 6:g}" y="{y}">{_number(tick)}</text>'
    axis = f"M{left:g} {up.start:g}H{right:g}M{left:g} {bottom:g}H{right:g}"
    times = ticks(across.low, across.high, 6)
    for tick in times:
        x, unit = _short(across(tick)), " ms" if tick == times[-1] else ""
        axis += f"M{x} {bottom:g}v4"
        labels += f'<text class="x" x="{x}" y="{bottom + 16:g}">{_number(tick)}{unit}</text>'
    for scale, title in ((up, "increments"), (aside, "deviation")):
        middle = (scale.start + scale.end) / 2
        labels += f'<text class="title" transform="translate(12 {middle:g})rotate(-90)">'
        labels += f"{title}</text>"
    return [f'<path class="grid" d="{grid}"/><path class="axis" d="{axis}"/>', labels]


def _line(points: Sequence[Point]) -> str:
    """A path through the points: the first where it is, the others from the one before."""
    tenths = [(round(x * 10), round(y * 10)) for x, y in points]
    (x, y), parts = tenths[0], [f"M{_short(points[0][0])} {_short(points[0][1])}l"]
    for next_x, next_y in tenths[1:]:
        across, up = _short((next_x - x) / 10), _short((next_y - y) / 10)
        parts.append(f"{across}{'' if up.startswith('-') else ' '}{up} ")
        x, y = next_x, next_y
    return "".join(parts).rstrip()


def _short(value: float) -> str:
    """A coordinate in as few characters as it takes."""
    return f"{value + 0.0:.1f}".removesuffix(".0").replace("-0.", "-.").removeprefix("0") or "0"


def ticks(low: float, high: float, about: int) -> list[float]:
    """Round numbers inside [low, high], `about` that many, 1, 2 or 5 apart by a power of ten."""
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(unit * power for unit in (1, 2, 5, 10) if unit * power >= raw)
    first = math.ceil(low / step)
    return [number * step for number in range(first, math.floor(high / step) + 1)]


def _number(value: float) -> str:
    return f"{value:.6g}".replace("-", "\u2212")
