"""What is asked of a shaft most often is answered the short way; the answers are the same."""

from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from axistwin.motion.inertia import Mechanics
from axistwin.motion.plant import Load, Plant
from axistwin.motion.ramp import Ramp, RampedMotion

pytestmark = pytest.mark.strength

MS = 1_000_000
HELD, FREE = Load(held=True), Load()
MAC23 = Mechanics(increments_per_turn=2000, rotor_inertia_kgcm2=Fraction(44, 100))
MECHANICS = st.sampled_from([None, MAC23])
EVENTS = st.lists(
    st.tuples(
        st.sampled_from(["move", "run", "brake", "hold", "push", "load", "free", "stop", "wait"]),
        st.integers(0, 40 * MS),
        st.integers(-40, 40),
    ),
    max_size=12,
)


def _happen(shaft: Plant, event: str, now: int, number: int) -> None:
    """Let ``event`` happen to the shaft at ``now``."""
    direction = -1 if number < 0 else 1
    ramp = Ramp(300 + number, 0)
    match event:
        case "move":
            motion = RampedMotion.to_target(now, direction, abs(number), ramp)
            shaft.follow(now, motion.trajectory, number)
        case "run":
            shaft.follow(now, RampedMotion.endless(now, direction, ramp).trajectory)
        case "brake":
            shaft.brake(now, max(0, number))
        case "hold":
            shaft.hold(now)
        case "push":
            shaft.push(now, number)
        case "load" | "free":
            shaft.set_load(now, HELD if event == "load" else FREE)
        case "stop":
            shaft.cut_power(now)


@settings(max_examples=300)
@given(MECHANICS, EVENTS, st.integers(-60, 60))
def test_the_short_way_to_a_span_leads_to_the_same_answers(
    mechanics: Mechanics | None, events: list[tuple[str, int, int]], place: int
) -> None:
    """What is asked most is answered without looking at the whole future; it is what lies there."""
    short, long = (Plant(mechanics=mechanics, torque_nm=Fraction(14, 10)) for _ in range(2))
    long._simple_span_at = lambda now_ns: None  # type: ignore[method-assign]
    now = 0
    for event, pause_ns, number in events:
        now += pause_ns
        answers = []
        for shaft in (short, long):
            _happen(shaft, event, now, number)
            for later in (now, now + 777, now + 20 * MS):
                settles = shaft.is_regulating and shaft.settle_ns(later, abs(number) % 3)
                answers.append(
                    (
                        shaft.position_at(later),
                        shaft.speed_at(later),
                        shaft.rest_ns(later),
                        shaft.reach_ns(place, later),
                        shaft.is_busy(later, 1),
                        settles,
                    )
                )
        assert answers[:3] == answers[3:]
