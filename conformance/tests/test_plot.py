"""Measured against predicted, drawn."""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

import pytest

from axistwin_conformance.report.plot import (
    BAND_POINTS,
    HEIGHT,
    WIDTH,
    is_inside,
    is_on_path,
    plot,
    plot_path,
    ticks,
)

MS = 1_000_000


def motion(*measured: tuple[int, int], band: list[tuple[int, int, int]] | None = None) -> Any:
    """A motion of a report: 10 increments per ms, known to ±1."""
    band = band or [(MS * n, 10 * n - 1, 10 * n + 1) for n in range(6)]
    return {"name": "move 1", "measured": list(measured), "predicted": band}


def places(shown: str, kind: str) -> list[tuple[float, float]]:
    """Where the lines of one class of a drawing go."""
    found: list[tuple[float, float]] = []
    for path in ElementTree.fromstring(shown).iter("path"):
        if path.attrib["class"] != kind:
            continue
        for letter, rest in re.findall(r"([a-zA-Z])([^a-zA-Z]*)", path.attrib["d"]):
            numbers = [float(one) for one in re.findall(r"-?[0-9]*\.?[0-9]+", rest)]
            assert letter in "Mlhz"
            for x, y in zip(numbers[::2], numbers[1::2], strict=letter != "h"):
                found.append((x, y) if letter == "M" else (found[-1][0] + x, found[-1][1] + y))
    return found


def test_readings_outside_their_band_are_red() -> None:
    """In both drawings, position and deviation; the edge still belongs to the band."""
    shown = plot(motion((1 * MS, 11), (2 * MS, 20), (4 * MS, 42)))
    assert len(places(shown, "reading")) == 4
    assert len(places(shown, "reading off")) == 2
    assert "3 readings, 1 outside the predicted band" in shown


@pytest.mark.parametrize(("place", "inside"), [(18, False), (19, True), (21, True), (22, False)])
def test_inside_is_what_was_judged(place: int, inside: bool) -> None:
    """Lowest and highest are admissible."""
    assert is_inside(motion((2 * MS, place))) is inside


def test_a_reading_between_two_points_has_the_wider_of_both() -> None:
    """A plot must not accuse where no band was computed."""
    assert is_inside(motion((MS // 2, 11)))
    assert not is_inside(motion((MS // 2, 12)))


def test_everything_lies_inside_the_drawing() -> None:
    """Whatever is measured; and the drawing is well-formed."""
    shown = str(plot(motion((1 * MS, -4000), (4 * MS, 900))))
    for kind in ("band", "reading", "reading off"):
        for x, y in places(shown, kind):
            assert 0 <= x <= WIDTH
            assert 0 <= y <= HEIGHT


def test_a_motion_of_one_reading_at_rest_can_be_drawn() -> None:
    """Nothing to scale by."""
    ElementTree.fromstring(plot(motion((0, 5), band=[(0, 5, 5)])))


def test_a_long_band_is_thinned_but_not_where_it_was_measured() -> None:
    """The page stays light; a reading stays in its own band."""
    band = [(MS * n, n - (n % 100 == 7), n + (n % 100 == 7)) for n in range(5000)]
    shown = str(plot(motion((1007 * MS, 1006), band=band)))
    assert len(places(shown, "band")) <= 4 * (BAND_POINTS + 3)
    assert "off" not in shown


def test_what_lies_on_a_line_is_left_out_and_what_does_not_stays() -> None:
    """A cruise is two points however long; a bend of one increment in it shows."""
    straight = [(MS * n, 10 * n, 10 * n + 4) for n in range(40)]
    bent = [*straight[:20], (MS * 20, 240, 244), *straight[21:]]
    assert len(places(plot(motion((0, 0), band=straight)), "band")) == 8
    # Three more points on either edge of the band of positions; its width is the same all along.
    assert len(places(plot(motion((0, 0), band=bent)), "band")) == 8 + 2 * 3


def test_a_name_cannot_break_out() -> None:
    """It is text."""
    assert "&lt;b&gt;" in plot({**motion((0, 0)), "name": "<b>"})


@pytest.mark.parametrize(
    ("low", "high", "about", "expected"),
    [
        (0, 100, 5, [0, 20, 40, 60, 80, 100]),
        (-1.5, 1.5, 3, [-1, 0, 1]),
        (3, 4, 2, [3, 3.5, 4]),
        (0, 0.006, 3, [0, 0.002, 0.004, 0.006]),
    ],
)
def test_axes_are_marked_in_round_numbers(
    low: float, high: float, about: int, expected: list[float]
) -> None:
    """1, 2 or 5 apart."""
    assert ticks(low, high, about) == pytest.approx(expected)


def path(*points: tuple[int, ...]) -> Any:
    """A path of a report: readings of two axes in their boxes."""
    return {"name": "path of axes 1 and 3", "axes": ["axis 1", "axis <3>"], "points": list(points)}


def test_a_path_is_one_axis_over_another_on_one_scale() -> None:
    """A circle stays one: as many steps are as long either way; what is off its box is red."""
    inside = [(0, 0, 0, -1, 1, -1, 1), (1, 100, 0, 99, 101, -1, 1), (2, 0, 100, -1, 1, 99, 101)]
    shown = str(plot_path(path(*inside, (3, 50, 50, 99, 101, 50, 50))))
    (start, right, top), (off,) = places(shown, "reading"), places(shown, "reading off")
    assert right[0] - start[0] == pytest.approx(start[1] - top[1], abs=0.2)
    assert off[0] - start[0] == pytest.approx((right[0] - start[0]) / 2, abs=0.2)
    assert "4 readings, 1 outside the predicted box" in shown
    assert "axis &lt;3&gt;" in shown
    assert all(0 <= x <= WIDTH and 0 <= y <= HEIGHT for x, y in (start, right, top, off))


@pytest.mark.parametrize(("x", "y", "is_on"), [(9, 5, True), (11, 5, True), (8, 5, False),
                                               (10, 6, False)])  # fmt: skip
def test_on_the_path_is_what_was_judged(x: int, y: int, is_on: bool) -> None:
    """Both axes within their windows."""
    assert is_on_path(path((0, x, y, 9, 11, 5, 5))) is is_on


def test_axes_that_stand_are_drawn_as_well() -> None:
    """A path of one place has a scale all the same."""
    ElementTree.fromstring(str(plot_path(path((0, 7, 7, 7, 7, 7, 7)))))
