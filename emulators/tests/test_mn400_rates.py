"""Step rates of the MN400: what is drawn of a motion beside its positions."""

from collections.abc import Callable
from math import pi, sqrt

import pytest
from mn400_bench import Mn400Bench
from mn400_motions import S, end, rules

from axistwin.devices.mn400.motion import (
    ContourSegment,
    MoveSettings,
    Plane,
    PulseTrain,
    SpeedProfile,
    VectorMotion,
    arc,
    contour,
    helix,
    straight,
    thread,
)

DEFAULT = SpeedProfile(1000, 5000, 10_000)


def settings(speed: int = 3000, **changed: object) -> MoveSettings:
    """Of a move with the default profile."""
    return MoveSettings(rules(**changed), DEFAULT, speed)


def travelled(motion: VectorMotion, axis: int, count: int = 1500) -> float:
    """What the rate of an axis adds up to, from the start to the end."""
    span_ns = end(motion) - motion.since_ns
    middles = ((2 * n + 1) * span_ns // (2 * count) + motion.since_ns for n in range(count))
    return sum(motion.rates_at(now)[axis] for now in middles) * span_ns / count / S


MOTIONS: dict[str, Callable[[], VectorMotion]] = {
    "a move": lambda: straight(0, settings(), (2000, -1234, 7, 0)),
    "a move of one step": lambda: straight(0, settings(), (0, 1, 0, 0)),
    "a multiplexed move": lambda: straight(
        0, MoveSettings(rules(), DEFAULT, 3000, 4), (900, -800, 0, 3)
    ),
    "an arc": lambda: arc(0, settings(), Plane(0, 2, 1), (0, -500), (-354, -146), False),
    "an arc at path speed": lambda: arc(
        0, settings(arc_rate="tangential"), Plane(0, 2, 1), (-700, 0), (-1400, 0), True
    ),
    "a helix": lambda: helix(
        0, settings(2000), Plane(0, 2, 1), (-500, 0), (-1000, 0), True, -250, 2
    ),
    "a contour": lambda: contour(
        0,
        settings(),
        [ContourSegment((500, 0, 300, 0), 3000), ContourSegment((0, -200, 400, 90), 2000)],
        20,
    ),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_rates_add_up_to_the_way(name: str) -> None:
    """Of every axis, whatever the path; arcs within what the mean slope loses at their ends."""
    motion = MOTIONS[name]()
    near = 6 if "arc" in name or "helix" in name else 1.5
    for axis, way in enumerate(motion.total):
        assert travelled(motion, axis) == pytest.approx(way, abs=max(near, abs(way) * 0.01))


def test_the_rate_of_a_ramp_is_that_of_the_formula() -> None:
    """From start speed to V and back, at every instant; minor axes in proportion."""
    motion = straight(0, settings(), (2000, -500, 0, 0))
    for now, rate in ((0, 1000), (0.1, 2000), (0.2, 3000), (0.5, 3000), (0.75, 1500)):
        first, second, third, fourth = motion.rates_at(round(now * S))
        assert first == pytest.approx(rate, rel=1e-6)
        assert second == pytest.approx(-rate / 4, rel=1e-6)
        assert (third, fourth) == (0, 0)
    assert motion.rates_at(end(motion)) == (0, 0, 0, 0)


def test_the_rate_on_an_arc_turns_with_the_path() -> None:
    """The dominant axis makes a step each tick, the other one its share of the circle."""
    motion = arc(0, settings(2000), Plane(0, 2, 1), (-1000, 0), (-2000, 0), True)
    radius = 1000
    for ticks in (200, 500, 650):
        first, _, third, _ = motion.rates_at(ticks * S // 2000)
        assert third == pytest.approx(-2000, rel=0.01)
        assert first == pytest.approx(-2000 * ticks / sqrt(radius**2 - ticks**2), rel=0.15)
    tangential = arc(
        0, settings(2000, arc_rate="tangential"), Plane(0, 2, 1), (-1000, 0), (-2000, 0), True
    )
    for share in (0.1, 0.3, 0.6, 0.9):
        rates = tangential.rates_at(round(share * pi * radius / 2000 * S))
        assert sqrt(rates[0] ** 2 + rates[2] ** 2) == pytest.approx(2000, rel=0.05)


def test_an_axis_that_waits_for_compensation_stands() -> None:
    """While the other one takes up its backlash."""
    lashed = MoveSettings(rules(), DEFAULT, 500, lash=(0, 50, 0, 0), lash_memory=(1, 1, 1, 1))
    motion = straight(0, lashed, (500, -500, 0, 0))
    assert motion.rates_at(S // 20) == (0, -500, 0, 0)
    assert motion.rates_at(S // 2) == (500, -500, 0, 0)


def test_what_has_paused_or_was_halted_stands() -> None:
    """It slows down before, and the other axes go on."""
    motion = straight(0, settings(), (6000, 3000, 0, 0))
    paused = motion.pause(S)
    assert paused.rates_at(S)[0] == pytest.approx(3000, rel=0.01)
    assert 1000 < paused.rates_at(S + S // 10)[0] < 2500
    assert paused.rates_at(2 * S) == (0, 0, 0, 0)
    assert paused.resume(3 * S).rates_at(7 * S // 2)[0] == pytest.approx(3000)
    halted = motion.halt_axis(S, 1)
    assert halted.rates_at(S + 1) == pytest.approx((3000, 0, 0, 0))


def test_the_rate_of_a_threaded_move_is_that_of_the_pulses() -> None:
    """From index and offset on, to the last pulse."""
    motion = thread(0, settings(), (400, -500, 0, 0), 1000, 50)
    driven = motion.paced_by(0, PulseTrain(1_000_000, 2000))
    for now, rates in ((1, (0, 0)), (2.04, (0, 0)), (2.5, (400, -500)), (3.06, (0, 0))):
        assert driven.rates_at(round(now * S))[:2] == rates
    assert motion.rates_at(S) == (0, 0, 0, 0)


def test_a_board_tells_the_rates_of_motions_and_of_jogging() -> None:
    """At its step outputs; zero at rest."""
    bench = Mn400Bench()
    assert bench.device.step_rates_at(bench.now) == [0, 0, 0, 0]
    bench.say("V500", "M1000,,-500")
    bench.wait(200)
    assert bench.device.step_rates_at(bench.now) == [500, 0, -250, 0]
    bench.wait(4000)
    bench.say("Y800", "J1")
    bench.switch("jog_m2_minus")
    bench.wait(1500)
    assert bench.device.step_rates_at(bench.now) == [0, pytest.approx(-800), 0, 0]
