"""Drawn motions of an MN400 and all they have to keep; and wrong motions, which are noticed.

``scripts/sweep_motions`` judges as many as one likes.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import pytest
from mn400_journeys import Journey, Kind, drawn
from mn400_travel_rules import judge

from axistwin.devices.mn400.motion import MoveSettings, arcs, moves, pace, timeline
from axistwin.devices.mn400.motion.arcs import ArcPath
from axistwin.devices.mn400.motion.lookahead import Limits
from axistwin.devices.mn400.motion.pace import TimedPace
from axistwin.devices.mn400.motion.paths import StraightPath
from axistwin.devices.mn400.motion.timeline import ONE, SECOND

SEED = 2018
SAMPLE = 300
"""Within so many any of the wrong motions is noticed."""

Plant = Callable[[pytest.MonkeyPatch], None]


@pytest.mark.strength
@pytest.mark.parametrize("part", range(4))
def test_drawn_motions_keep_every_rule(part: int) -> None:
    """Ends, limits, pauses, mirrors and new plans of 400 moves, contours, arcs and helices."""
    judge_all(drawn(SEED, number) for number in range(part * 100, part * 100 + 100))


def changed(owner: object, name: str, change: Callable[..., Any]) -> Plant:
    """Let ``change(original, *arguments)`` stand for a function."""

    def plant(monkeypatch: pytest.MonkeyPatch) -> None:
        original = getattr(owner, name)
        monkeypatch.setattr(owner, name, lambda *given, **named: change(original, *given, **named))

    return plant


def steeper(original: Callable[..., Any], own: TimedPace, *given: Any) -> Any:
    """Braking at four times the acceleration."""
    profile = own.settings.profile
    harder = replace(profile, acceleration=4 * profile.acceleration)
    return original(replace(own, settings=replace(own.settings, profile=harder)), *given)


def lopsided(original: Callable[..., StraightPath], way: Any, *given: Any, **named: Any) -> Any:
    """Another phase where the first axis goes back."""
    path = original(way, *given, **named)
    return replace(path, phase=0) if way[0] < 0 else path


def without_tail(original: Callable[..., Any], *given: Any) -> Any:
    """An arc that stays on its circle up to the end."""
    return given[2], StraightPath.over((0, 0, 0, 0), 0)


def from_rest(original: Callable[..., Any], own: TimedPace, x: int, speed: Any, feed: int) -> Any:
    """A plan that forgets how fast the motion is."""
    return original(own, x, None, feed)


def exchanged(original: Callable[..., Any], *given: Any, **named: Any) -> Any:
    """Clockwise for counter-clockwise."""
    return original(*given, **{**named, "is_clockwise": not named["is_clockwise"]})


def to_the_top(original: Callable[..., Limits], *given: Any) -> Limits:
    """Ends as fast as the segment may be."""
    limits = original(*given)
    return limits._replace(end=limits.cap)


PLANTED: dict[str, tuple[Plant, Kind, str]] = {
    "a pause skips a step": (
        changed(
            TimedPace, "going_on", lambda real, own, now, x, feed: real(own, now, x + ONE, feed)
        ),
        "move",
        "moves the axes",
    ),
    "braking is too hard": (changed(TimedPace, "_braking", steeper), "contour", "too steep"),
    "the top speed is exceeded": (
        changed(MoveSettings, "cap", lambda real, *given: real(*given) * 21 // 20 + 1),
        "contour",
        "too fast",
    ),
    "a tick of an arc is too short": (
        changed(MoveSettings, "cap", lambda real, *given: real(*given) * 21 // 20 + 1),
        "arc",
        "two steps in a tick",
    ),
    "the margin is three times as large": (
        changed(
            moves, "seam_between", lambda real, a, b, margin, *rest: real(a, b, 3 * margin, *rest)
        ),
        "contour",
        "beyond the margin",
    ),
    "the ends are faster than start speed": (
        changed(pace, "limits_of", to_the_top),
        "move",
        "above start speed",
    ),
    "backwards is not forwards mirrored": (
        changed(StraightPath, "over", lopsided),
        "move",
        "mirrored",
    ),
    "a new plan forgets the speed": (
        changed(TimedPace, "_plan", from_rest),
        "contour",
        "planning anew changes the end",
    ),
    "time runs slow by a millionth": (
        lambda monkeypatch: monkeypatch.setattr(timeline, "SECOND", SECOND + SECOND // 10**6),
        "long",
        "not as long as reckoned",
    ),
    "backlash is forgotten": (
        changed(moves, "compensation", lambda real, *given: []),
        "move",
        "backlash",
    ),
    "an arc ends beside its destination": (
        changed(arcs, "_tail_to", without_tail),
        "arc",
        "elsewhere",
    ),
    "an arc goes the other way round": (
        changed(arcs, "arc_path", exchanged),
        "arc",
        "beside the circle|another angle",
    ),
    "the traverse is done at half the way": (
        changed(ArcPath, "_place_of_traverse", lambda real, own, n: real(own, n) // 2),
        "helix",
        "two steps in a tick|not by the angle",
    ),
}


@pytest.mark.strength
@pytest.mark.parametrize("name", PLANTED)
def test_a_wrong_motion_is_noticed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One of the first motions of its kind breaks the rule that it should break."""
    plant, kind, words = PLANTED[name]
    journeys = (drawn(SEED, number) for number in range(SAMPLE))
    chosen = [journey for journey in journeys if journey.kind == kind]
    plant(monkeypatch)
    with pytest.raises(AssertionError, match=words):
        judge_all(chosen)


def judge_all(journeys: Iterable[Journey]) -> None:
    """One by one."""
    for journey in journeys:
        judge(journey)
